"""Plots with axes of their own, drawn from lines and points, for all that is not a function of time.

Rerun's plots run over a timeline and have no logarithmic axis; so singular values, stabilisation diagrams and spectra
are drawn in a 2-D view: frame, grid, ticks, legend. One unit of the view is about one point of the screen.

Several frames may stand one below the other in one pane, each a band of its height: they share the horizontal axis and
zoom together, which separate views do not.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from modal.recording.axis import Axis
from modal.recording.palette import FRAME, GREY, GRID, PALE, Colour
from okid.arrays import FloatArray

if TYPE_CHECKING:
    import rerun

__all__ = ["Figure", "Pane", "legend_share"]

LEFT, RIGHT, TOP, BOTTOM = 62.0, 24.0, 40.0, 58.0
"""Margins around the frame for ticks and titles, in view units."""

PLAIN_BOTTOM: Final = 8.0
"""The same below a frame whose horizontal axis carries no texts."""

LETTER: Final = 7.0
"""Width of a letter of a label, about, in view units."""

BUBBLE: Final = 19.0
"""A label hangs below its point by this much, in view units: its middle is to stand where it is asked for."""


@dataclass(frozen=True, slots=True)
class Pane:
    """Where a plot is stored and how large it is; the blueprint makes a view of the same shape.

    Attributes:
        path: the entity above all parts of the plot, which is the view's origin.
        width: of the whole plot, margins included, in view units.
        height: likewise.
    """

    path: str
    width: float
    height: float


def legend_share(pane: Pane, texts: Sequence[str]) -> float:
    """Share of the frame's width to leave free for a legend inside it, at most half.

    Example:
        >>> legend_share(Pane("fit/markov/plot", 500.0, 200.0), ["tip / force"])
        0.256...
    """
    return min(0.5, (LETTER * max(map(len, texts), default=0) + 29.0) / (pane.width - LEFT - RIGHT))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Figure:
    """A plot in a 2-D view: draws into `recording` below the pane's path, everything static.

    Attributes:
        recording: the stream.
        pane: where and how large.
        x: horizontal axis.
        y: vertical axis.
        band: where the plot begins and ends in the height of the pane, as shares of it.
        part: what its entities are called below the pane's, where there are several plots in it.
    """

    recording: "rerun.RecordingStream"
    pane: Pane
    x: Axis
    y: Axis
    band: tuple[float, float] = (0.0, 1.0)
    part: str = ""

    @property
    def path(self) -> str:
        """The entity above all parts."""
        return f"{self.pane.path}/{self.part}" if self.part else self.pane.path

    @property
    def is_lowest(self) -> bool:
        """Whether the horizontal axis carries its numbers and its title: in the lowest band alone."""
        return self.band[1] >= 1.0

    @property
    def top(self) -> float:
        """Of the frame, in view units."""
        return self.band[0] * self.pane.height + TOP

    @property
    def width(self) -> float:
        """Of the frame, in view units."""
        return self.pane.width - LEFT - RIGHT

    @property
    def height(self) -> float:
        """Of the frame, in view units."""
        below = BOTTOM if self.is_lowest else PLAIN_BOTTOM
        return (self.band[1] - self.band[0]) * self.pane.height - TOP - below

    def place(self, x: npt.ArrayLike, y: npt.ArrayLike) -> FloatArray:
        """(n, 2) view coordinates of values; the view's second axis points down."""
        shares = np.broadcast_arrays(self.x.share(x), self.y.share(y))
        return np.column_stack([LEFT + self.width * shares[0], self.top + self.height * (1.0 - shares[1])])

    def frame(self) -> None:
        """Grid, axes, ticks, and titles."""
        right, bottom = LEFT + self.width, self.top + self.height
        x_ticks = LEFT + self.width * (np.array(self.x.ticks) - self.x.low) / (self.x.high - self.x.low)
        y_ticks = bottom - self.height * (np.array(self.y.ticks) - self.y.low) / (self.y.high - self.y.low)
        grid = [[[t, self.top], [t, bottom]] for t in x_ticks] + [[[LEFT, t], [right, t]] for t in y_ticks]
        self._strips("0_grid", grid, GRID, 0.6, order=0.0)
        self._strips("1_frame", [[[LEFT, self.top], [LEFT, bottom], [right, bottom]]], FRAME, 1.0, order=1.0)
        places = [[LEFT - 26, t] for t in y_ticks]
        texts = list(self.y.texts)
        titles, named = [[24 + LETTER * len(self.y.title) / 2, self.top - 22]], [self.y.title]
        if self.is_lowest:
            places += [[t, bottom + 16] for t in x_ticks]
            texts += self.x.texts
            titles.append([LEFT + self.width / 2, bottom + 40])
            named.append(self.x.title)
        self._texts("2_ticks", places, texts, PALE)
        self._texts("3_titles", titles, named, PALE)

    def line(
        self, name: str, x: npt.ArrayLike, y: npt.ArrayLike, colour: Colour, *, width: float = 1.2, order: float = 5.0
    ) -> None:
        """A line through values, broken where they are nan, cut at the frame."""
        points = self.place(x, y)
        points[:, 1] = np.clip(points[:, 1], self.top, self.top + self.height)
        inside = (
            np.isfinite(points).all(axis=1) & (points[:, 0] >= LEFT - 0.5) & (points[:, 0] <= LEFT + self.width + 0.5)
        )
        edges = np.flatnonzero(np.diff(np.concatenate([[0], inside.astype(int), [0]])))
        strips = [points[a:b] for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a > 1]
        self._strips(name, strips, colour, width, order=order)

    def points(
        self,
        name: str,
        x: npt.ArrayLike,
        y: npt.ArrayLike,
        colours: Colour | npt.NDArray[np.uint8],
        *,
        radius: float = 3.0,
        order: float = 10.0,
        texts: Sequence[str] = (),
    ) -> None:
        """A dot a value within the frame; `texts` show when the pointer rests on one."""
        import rerun as rr

        points = self.place(x, y)
        edge = 0.5  # half a screen point, against rounding
        low, high = [LEFT - edge, self.top - edge], [LEFT + self.width + edge, self.top + self.height + edge]
        shown = ((points >= low) & (points <= high)).all(axis=1)  # nan is outside as well
        if not shown.any():
            return
        self.recording.log(
            f"{self.path}/{name}",
            rr.Points2D(
                points[shown],
                radii=rr.Radius.ui_points(radius),
                colors=colours[shown] if isinstance(colours, np.ndarray) else colours,
                labels=[texts[i] for i in np.flatnonzero(shown).tolist()] if texts else None,
                show_labels=False,
                draw_order=order,
            ),
            static=True,
            strict=True,
        )

    def bars(
        self, name: str, ends: Sequence[Sequence[Sequence[float]]], colour: Colour, *, width: float, order: float = 5.0
    ) -> None:
        """Straight strokes between pairs of values [[x, y], [x, y]], cut at the frame; those with nan are left out."""
        strips = []
        for pair in ends:
            points = self.place([x for x, _ in pair], [y for _, y in pair])
            if np.isfinite(points).all():
                low, high = [LEFT, self.top], [LEFT + self.width, self.top + self.height]
                strips.append(np.clip(points, low, high))
        self._strips(name, strips, colour, width, order=order)

    def text_from(self, name: str, x: float, y: float, text: str, colour: Colour = GREY) -> None:
        """One text that begins at a value."""
        ((left, middle),) = self.place([x], [y]).tolist()
        self._texts(f"5_text/{name}", [[left + LETTER * len(text) / 2 + 6.0, middle]], [text], colour)

    def legend(self, entries: Sequence[tuple[str, Colour]]) -> None:
        """Texts in the colours of what they name, in one row above the frame, to the right."""
        right = self.pane.width - RIGHT
        for i, (text, colour) in reversed(list(enumerate(entries))):
            width = LETTER * len(text) + 22.0
            self._texts(f"4_legend/{i}", [[right - width / 2, self.top - 22]], [text], colour)
            right -= width

    def legend_row(self, entries: Sequence[tuple[str, Colour]]) -> None:
        """`legend`, as many entries as fit beside the title of the vertical axis; the last says how many more."""
        room = self.width - LETTER * len(self.y.title) - 20.0
        widths = np.cumsum([LETTER * len(text) + 22.0 for text, _ in entries])
        n_fit = int(np.searchsorted(widths, room, side="right"))
        if n_fit < len(entries):
            n_fit = int(np.searchsorted(widths, room - 9 * LETTER, side="right"))
            self.legend([*entries[:n_fit], (f"{len(entries) - n_fit} more", GREY)])
        else:
            self.legend(entries)

    def legend_inside(self, entries: Sequence[tuple[str, Colour]]) -> None:
        """The same for long texts: one below the other in the upper right corner of the frame."""
        for i, (text, colour) in enumerate(entries):
            at = [self.pane.width - RIGHT - LETTER * len(text) / 2 - 12, self.top + 12 + 23 * i]
            self._texts(f"4_legend/{i}", [at], [text], colour)

    def text(self, name: str, x: float, y: float, text: str, colour: Colour = GREY) -> None:
        """One text whose middle stands at a value."""
        self._texts(f"5_text/{name}", self.place([x], [y]).tolist(), [text], colour)

    def _strips(self, name: str, strips: Sequence[object], colour: Colour, width: float, *, order: float) -> None:
        import rerun as rr

        if not len(strips):
            return
        archetype = rr.LineStrips2D(strips, radii=rr.Radius.ui_points(width), colors=colour, draw_order=order)
        self.recording.log(f"{self.path}/{name}", archetype, static=True, strict=True)

    def _texts(self, name: str, places: Sequence[Sequence[float]], texts: Sequence[str], colour: Colour) -> None:
        import rerun as rr

        if not texts:
            return
        self.recording.log(
            f"{self.path}/{name}",
            rr.Points2D(
                np.asarray(places, dtype=np.float64) - [0.0, BUBBLE],
                radii=rr.Radius.ui_points(0.0),
                colors=colour,
                labels=list(texts),
                show_labels=True,
                draw_order=30.0,
            ),
            static=True,
            strict=True,
        )
