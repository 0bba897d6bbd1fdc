"""Plots with axes of their own, drawn from lines and points, for all that is not a function of time.

Rerun's plots run over a timeline and have no logarithmic axis; so singular values, stabilisation diagrams and spectra
are drawn in a 2-D view: frame, grid, ticks, legend. One unit of the view is about one point of the screen.

Several frames may stand one below the other in one pane, each a band of its height: they share the horizontal axis and
zoom together, which separate views do not.

Axes of drawn plots: a range of values, and ticks where a person would put them.

The colours of every page: few, bright on near-black, one meaning each.

The views that several pages are made of: series over time, drawn plots, words.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np
import numpy.typing as npt

from okid.arrays import FloatArray

if TYPE_CHECKING:
    import rerun

__all__ = [
    "BACKGROUND",
    "BLUE",
    "CYCLE",
    "DIM_BLUE",
    "DIM_GREEN",
    "FRAME",
    "GOLD",
    "GREEN",
    "GREY",
    "GRID",
    "ORANGE",
    "PALE",
    "RED",
    "SHARE_AXIS",
    "WHITE",
    "Axis",
    "Colour",
    "Figure",
    "Pane",
    "by_share",
    "document_view",
    "legend_share",
    "linear_axis",
    "log_axis",
    "plot_view",
    "series_view",
]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Axis:
    """A range of values, its ticks, and what it is.

    Attributes:
        title: quantity and unit.
        low: value at the start (its logarithm for a logarithmic axis, as for the others below).
        high: value at the end.
        ticks: values that carry a grid line and a text.
        texts: one a tick.
        scale: "linear" or "log10".
    """

    title: str
    low: float
    high: float
    ticks: tuple[float, ...]
    texts: tuple[str, ...]
    scale: Literal["linear", "log10"] = "linear"

    def share(self, values: npt.ArrayLike) -> FloatArray:
        """Where values lie on the axis: 0 at its start, 1 at its end; nan for those that a log axis cannot show."""
        given = np.asarray(values, dtype=np.float64)
        if self.scale == "log10":
            given = np.log10(np.where(given > 0, given, np.nan))
        return np.asarray((given - self.low) / (self.high - self.low))


SHARE_AXIS: Final = Axis(title="coherence", low=0.0, high=1.04, ticks=(0.0, 0.5, 1.0), texts=("0", "0.5", "1"))
"""Of a coherence, in a low frame."""


def linear_axis(title: str, low: float, high: float, *, whole: bool = False) -> Axis:
    """An axis from `low` to `high` with ticks at round steps.

    Args:
        title: quantity and unit.
        low: start.
        high: end; a range without width is widened.
        whole: ticks at whole numbers only.

    Example:
        >>> linear_axis("order", 0, 42).texts
        ('0', '10', '20', '30', '40')
    """
    if not high > low:
        low, high = low - 0.5 - abs(low) / 2, low + 0.5 + abs(low) / 2
    raw = (high - low) / 5
    power = 10.0 ** np.floor(np.log10(raw))
    step = power * min((1, 2, 5, 10), key=lambda m: abs(np.log(m * power / raw)))
    if whole:
        step = max(1.0, np.round(step))
    first = np.ceil(low / step - 1e-9)
    ticks = step * np.arange(first, np.floor(high / step + 1e-9) + 1)
    ticks = np.where(np.abs(ticks) < step * 1e-9, 0.0, ticks)
    texts = tuple(f"{tick:.6g}" for tick in ticks)
    return Axis(title=title, low=low, high=high, ticks=tuple(ticks.tolist()), texts=texts)


def log_axis(title: str, low: float, high: float) -> Axis:
    """A logarithmic axis a little wider than `low` to `high`, both positive, with ticks at decades.

    Example:
        >>> log_axis("singular value", 0.03, 20).texts
        ('0.1', '1', '10')
    """
    start, stop = np.log10(low), np.log10(high)
    margin = max(0.08 * (stop - start), 0.15)
    start, stop = start - margin, stop + margin
    first, last = int(np.ceil(start)), int(np.floor(stop))
    if last <= first:  # at least two decades, or nothing can be read off
        first, last = min(first, last), max(first, last) + (first == last)
        start, stop = min(start, first), max(stop, last)
    step = max(1, -(-(last - first) // 7))
    decades = np.arange(first, last + 1, step)
    texts = tuple(f"{10.0**d:g}" if -4 < d < 5 else f"1e{d}" for d in decades.tolist())
    return Axis(title=title, low=start, high=stop, ticks=tuple(map(float, decades)), texts=texts, scale="log10")


Colour = tuple[int, int, int]

BACKGROUND: Final[Colour] = (13, 14, 17)
FRAME: Final[Colour] = (120, 124, 134)
GRID: Final[Colour] = (38, 41, 48)
GREY: Final[Colour] = (112, 116, 126)
PALE: Final[Colour] = (196, 200, 210)
WHITE: Final[Colour] = (240, 242, 248)
BLUE: Final[Colour] = (86, 156, 255)  # measured
DIM_BLUE: Final[Colour] = (58, 88, 140)
ORANGE: Final[Colour] = (255, 160, 77)  # simulated from the inputs alone
GREEN: Final[Colour] = (72, 207, 140)  # kept, stable, system
GOLD: Final[Colour] = (245, 196, 84)  # inputs, choices
RED: Final[Colour] = (240, 96, 96)  # what is left over
CYCLE: Final[tuple[Colour, ...]] = (
    GOLD,
    (150, 130, 255),
    (86, 210, 220),
    (240, 130, 190),
    (190, 210, 90),
    (210, 160, 120),
)
"""For channels of equal rank, in this order, again from the start when there are more."""

DIM_GREEN: Final[Colour] = (38, 84, 62)

_KNOTS: Final = np.array([0.0, 0.5, 0.8, 0.95, 1.0])
_STOPS: Final = np.array([(84, 88, 98), (104, 98, 90), GOLD, GREEN, GREEN], dtype=np.float64)


def by_share(share: npt.ArrayLike) -> npt.NDArray[np.uint8]:
    """Colour of a share in [0, 1]: grey to 0.5, gold at 0.8, green from 0.95 on; nan is grey.

    Args:
        share: (n,) values; those outside [0, 1] take the colour of the nearer end.

    Returns:
        (n, 3) red, green, blue.

    Example:
        >>> by_share([0.0, 1.0]).tolist()
        [[84, 88, 98], [72, 207, 140]]
    """
    position = np.clip(np.nan_to_num(np.atleast_1d(np.asarray(share, dtype=np.float64))), 0.0, 1.0)
    channels = [np.interp(position, _KNOTS, _STOPS[:, c]) for c in range(3)]
    return np.round(np.column_stack(channels)).astype(np.uint8)


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


def series_view(origin: str, name: str, contents: Sequence[str], *, legend: bool = True) -> Any:
    """The view of series over time, linked with all others."""
    import rerun.blueprint as rrb

    return rrb.TimeSeriesView(
        origin=origin,
        contents=[f"+ {path if path.startswith('$') else '/' + path}" for path in contents],
        name=name,
        axis_x=rrb.TimeAxis(link="LinkToGlobal"),
        plot_legend=rrb.PlotLegend("RightTop", visible=legend),
    )


def plot_view(pane: Pane, name: str) -> Any:
    """The view of a drawn plot, in the shape of its pane."""
    import rerun.blueprint as rrb

    return rrb.Spatial2DView(
        origin=pane.path,
        name=name,
        background=rrb.Background(BACKGROUND),
        visual_bounds=rrb.VisualBounds2D(x_range=(0.0, pane.width), y_range=(0.0, pane.height)),
    )


def document_view(path: str, name: str) -> Any:
    """The view of words."""
    import rerun.blueprint as rrb

    return rrb.TextDocumentView(origin=path, name=name)
