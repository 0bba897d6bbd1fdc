"""Colours by meaning, the same in every picture, and axes with nothing on them that says nothing."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from okid.arrays import FloatArray

__all__ = ["DARK", "LIGHT", "Theme", "envelope", "head", "house_style", "key", "new_figure", "new_panels", "style_axes"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Theme:
    """One colour a meaning, as #rrggbb; all different, so that a page can exchange each for its own.

    Attributes:
        paper: background.
        ink: text and axes.
        muted: text of second rank.
        grid: lines behind the data.
        measured: what was measured.
        model: what the model says.
        residual: what is left over.
        system: modes of the system.
        doubtful: modes that may be.
        noise: modes that are not.
    """

    paper: str
    ink: str
    muted: str
    grid: str
    measured: str
    model: str
    residual: str
    system: str
    doubtful: str
    noise: str

    def verdict(self, verdict: str) -> str:
        """Colour of "system", "doubtful" or "noise"."""
        return {"system": self.system, "doubtful": self.doubtful}.get(verdict, self.noise)


LIGHT = Theme(
    paper="#ffffff",
    ink="#1c2430",
    muted="#667080",
    grid="#e1e5ea",
    measured="#2b6cd4",
    model="#e2761b",
    residual="#c63c4d",
    system="#12875c",
    doubtful="#b67a12",
    noise="#a3abb5",
)
DARK = Theme(
    paper="#0d0e11",
    ink="#e8ebf0",
    muted="#98a2b0",
    grid="#2a2f38",
    measured="#569cff",
    model="#ffa04d",
    residual="#f06060",
    system="#48cf8c",
    doubtful="#f5c454",
    noise="#70747e",
)


@contextmanager
def house_style() -> Iterator[None]:
    """Within it matplotlib forgets the user's own settings, so that the same result gives the same bytes."""
    with mpl.rc_context():
        mpl.rcdefaults()
        yield


def new_figure(
    n_rows: int, n_columns: int, *, size: tuple[float, float], theme: Theme, ratios: tuple[float, ...] | None = None
) -> tuple[Figure, list[list[Axes]]]:
    """A figure of `size` inches and its axes, styled: `n_rows` lists of `n_columns`."""
    figure = Figure(figsize=size, layout="constrained", facecolor=theme.paper)
    axes = figure.subplots(n_rows, n_columns, squeeze=False, width_ratios=ratios)
    for axis in axes.flat:
        style_axes(axis, theme)
    return figure, axes.tolist()


def new_panels(
    n_panels: int, *, most_columns: int, width: float, height: float, theme: Theme
) -> tuple[Figure, list[Axes]]:
    """As many panels as are asked for, `most_columns` in a row of `height` inches."""
    n_columns = min(most_columns, max(1, n_panels))
    n_rows = max(1, -(-n_panels // n_columns))
    figure, axes = new_figure(n_rows, n_columns, size=(width, 0.3 + height * n_rows), theme=theme)
    panels = [axis for row in axes for axis in row]
    for idle in panels[n_panels:]:
        idle.set_visible(False)
    return figure, panels[:n_panels]


def style_axes(axis: Axes, theme: Theme) -> None:
    """Thin ink on the left and below, a light grid behind the data."""
    axis.set_facecolor("none")
    axis.set_axisbelow(True)
    axis.grid(visible=True, color=theme.grid, linewidth=0.7)
    axis.tick_params(which="both", labelsize=8.5, colors=theme.muted, left=False, bottom=False)
    for side, spine in axis.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(theme.grid)
    axis.xaxis.label.set(color=theme.ink, fontsize=9)
    axis.yaxis.label.set(color=theme.ink, fontsize=9)


def head(axis: Axes, text: str, *, theme: Theme, where: Literal["left", "center"]) -> None:
    """A line of words above the axes."""
    axis.set_title(text, loc=where, color=theme.ink, fontsize=9.5)


def key(axis: Axes, *, theme: Theme, where: str, columns: int = 1) -> None:
    """What each line is, on a ground that keeps it readable where lines pass behind."""
    axis.legend(
        loc=where,
        ncols=columns,
        fontsize=8.5,
        labelcolor=theme.muted,
        facecolor=theme.paper,
        edgecolor="none",
        framealpha=0.85,
        borderpad=0.3,
    )


def envelope(time: FloatArray, values: FloatArray, *, n_points: int = 1200) -> tuple[FloatArray, FloatArray]:
    """Least and greatest value of each of `n_points / 2` stretches: a long record drawn small, its peaks kept.

    Example:
        >>> import numpy as np
        >>> envelope(np.arange(8.0), np.array([0, 5.0, 1, 1, 1, -2, 0, 0]), n_points=4)[1].tolist()
        [0.0, 5.0, -2.0, 1.0]
    """
    if values.size <= n_points:
        return time, values
    step = -(-values.size // (n_points // 2))
    n_whole = values.size // step
    blocks = values[: n_whole * step].reshape(n_whole, step)
    empty = np.asarray(np.isnan(blocks).all(axis=1))
    filled = np.where(empty[:, None], 0.0, blocks)
    pairs = np.stack([np.nanmin(filled, axis=1), np.nanmax(filled, axis=1)], axis=1)
    pairs[empty] = np.nan
    times = time[: n_whole * step].reshape(n_whole, step)[:, [0, step // 2]]
    return times.ravel(), pairs.ravel()
