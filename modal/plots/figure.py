"""A figure as numbers: panels with axes, lines, areas and words; where each panel lies; nothing is drawn here.

A figure is made once and read twice: `modal.plots.vector` draws it, `modal.plots.charts` tells its numbers to the
page's script. Lengths are points (1/72 inch) from the left upper corner; values beyond an axis, infinite ones too, are
drawn as far as its edge.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from modal.plots.style import STYLE, Role, text_width
from modal.plots.ticks import Tick, ticks_between
from okid.arrays import FloatArray

__all__ = ["Area", "Axis", "Figure", "Key", "Line", "Mark", "Panel", "Segments", "Word", "grid_of", "row_of"]

Dash = Literal["", "dashed", "dotted"]
Where = Literal["upper left", "upper right", "lower left", "lower right", "best"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Line:
    """Points joined by a line, marked by dots, or both; nan breaks it.

    Attributes:
        x: (n,).
        y: (n,).
        role: its colour.
        width: of the line, 0 for dots alone.
        opacity: 1 hides what is behind.
        dash: of the line.
        dot: diameter of the dots, 0 for none.
        square: dots are squares.
        label: for the key, "" for none.
        follows: shown and hidden with the line of this label, without an entry of its own.
    """

    x: FloatArray
    y: FloatArray
    role: Role
    width: float
    opacity: float
    dash: Dash
    dot: float
    square: bool
    label: str
    follows: str

    @property
    def corners(self) -> FloatArray:
        """(n, 2) all that it needs room for."""
        return np.stack([self.x, self.y], axis=1)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Area:
    """Filled polygons of one colour.

    Attributes:
        polygons: each (n, 2).
        role: colour.
        opacity: 1 hides what is behind.
        label: for the key.
    """

    polygons: tuple[FloatArray, ...]
    role: Role
    opacity: float
    label: str

    @property
    def corners(self) -> FloatArray:
        """(n, 2) all that it needs room for."""
        return np.concatenate([*self.polygons, np.empty((0, 2))])


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Segments:
    """Many separate pieces of one style.

    Attributes:
        ends: (n, 2, 2) start and end of each, (x, y).
        role: colour.
        width: of the lines.
        opacity: 1 hides what is behind.
        label: for the key.
        arrows: each has a head at its end.
    """

    ends: FloatArray
    role: Role
    width: float
    opacity: float
    label: str
    arrows: bool

    @property
    def corners(self) -> FloatArray:
        """(n, 2) all that it needs room for."""
        return self.ends.reshape(-1, 2)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Word:
    """A line of words at a place of the panel.

    Attributes:
        x: of the place.
        y: of the place; infinity is the upper edge.
        text: the words.
        role: colour.
        size: of the letters.
        anchor: which part of the words stands there.
        shift: right and down from the place.
    """

    x: float
    y: float
    text: str
    role: Role
    size: float
    anchor: Literal["start", "middle", "end"]
    shift: tuple[float, float]


Mark = Line | Area | Segments


@dataclass(slots=True, eq=False, kw_only=True)
class Axis:
    """One side of a panel.

    Attributes:
        label: what it shows, the unit in brackets.
        limits: first and last value, from the data unless given; the first may be the greater.
        log: logarithmic.
        ticks: (value, text), even ones unless given.
        labelled: the ticks have their numbers.
        grid: lines across the panel.
        upright: the words of the ticks stand on end.
        margin: share of the range that stays free at both ends where the limits come from the data.
        role: colour of the words of the ticks.
    """

    label: str = ""
    limits: tuple[float, float] | None = None
    log: bool = False
    ticks: Sequence[Tick] | None = None
    labelled: bool = True
    grid: bool = True
    upright: bool = False
    margin: float = STYLE.margin
    role: Role = "muted"

    def fitted(self, values: FloatArray) -> tuple[float, float]:
        """The limits, from (n,) values unless they are given."""
        if self.limits is not None:
            return self.limits
        seen = values[np.isfinite(values) & ((values > 0) | (not self.log))]
        if not seen.size:
            return (0.1, 1.0) if self.log else (0.0, 1.0)
        low, high = float(seen.min()), float(seen.max())
        if self.log:
            room = self.margin * math.log(high / low) if high > low else math.log(2.0)
            return low * math.exp(-room), high * math.exp(room)
        room = self.margin * (high - low) if high > low else self.margin * abs(high) or self.margin
        return low - room, high + room


@dataclass(slots=True, eq=False, kw_only=True)
class Panel:
    """Axes with what is drawn on them.

    Attributes:
        x: axis along.
        y: axis upwards.
        head: words above, one or more lines.
        centred: the head stands over the middle, not over the left end.
        frame: axes and grid are drawn.
        edges: "both", the line "below" alone, or "none".
        equal: one unit is as long along as upwards.
        rows_above: lines of words that stand between the panel and its head.
        key: corner for the key of the lines, None without one.
        marks: lines, areas and segments, the first behind.
        words: over all of them.
        box: left, top, width and height, once the figure is arranged.
    """

    x: Axis = field(default_factory=Axis)
    y: Axis = field(default_factory=Axis)
    head: str = ""
    centred: bool = False
    frame: bool = True
    edges: Literal["both", "below", "none"] = "both"
    equal: bool = False
    rows_above: int = 0
    key: Where | None = None
    marks: list[Mark] = field(default_factory=list)
    words: list[Word] = field(default_factory=list)
    box: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 1.0)

    def line(
        self,
        x: ArrayLike,
        y: ArrayLike,
        role: Role,
        *,
        width: float = 1.2,
        opacity: float = 1.0,
        dash: Dash = "",
        dot: float = 0.0,
        square: bool = False,
        label: str = "",
        follows: str = "",
    ) -> None:
        """Add a line through (n,) points, see `Line`."""
        along, up = (np.asarray(values, dtype=np.float64) for values in (x, y))
        self.marks.append(
            Line(
                x=along,
                y=up,
                role=role,
                width=width,
                opacity=opacity,
                dash=dash,
                dot=dot,
                square=square,
                label=label,
                follows=follows,
            )
        )

    def dots(
        self, x: ArrayLike, y: ArrayLike, role: Role, *, dot: float, square: bool = False, label: str = ""
    ) -> None:
        """Add dots of a diameter at (n,) points."""
        self.line(x, y, role, width=0.0, dot=dot, square=square, label=label)

    def bars(self, x: FloatArray, y: FloatArray, half: FloatArray, role: Role) -> None:
        """Add upright bars of half a height about (n,) points; those that are not finite are left out."""
        ends = np.stack([np.stack([x, y - half], axis=-1), np.stack([x, y + half], axis=-1)], axis=1)
        self.segments(ends[np.isfinite(ends).all(axis=(1, 2))], role, width=1.0)

    def across(self, y: float, role: Role, *, width: float = 1.0, dash: Dash = "", label: str = "") -> None:
        """Add a line over the whole width."""
        self.line([-math.inf, math.inf], [y, y], role, width=width, dash=dash, label=label)

    def upright(
        self, x: float, role: Role, *, width: float = 1.0, dash: Dash = "", opacity: float = 1.0, label: str = ""
    ) -> None:
        """Add a line over the whole height."""
        self.line([x, x], [-math.inf, math.inf], role, width=width, dash=dash, opacity=opacity, label=label)

    def area(
        self, x: ArrayLike, low: ArrayLike, high: ArrayLike, role: Role, *, opacity: float, label: str = ""
    ) -> None:
        """Fill between two curves over (n,) places; nan breaks it."""
        along, below, above = np.broadcast_arrays(*(np.asarray(part, dtype=np.float64) for part in (x, low, high)))
        known = ~(np.isnan(along) | np.isnan(below) | np.isnan(above))
        there = np.flatnonzero(np.diff(np.pad(known, 1)))
        polygons = tuple(
            np.concatenate([np.stack([along, below], axis=1)[i:j], np.stack([along, above], axis=1)[i:j][::-1]])
            for i, j in zip(there[::2], there[1::2], strict=True)
        )
        self.polygons(polygons, role, opacity=opacity, label=label)

    def box_of(
        self, x: tuple[float, float], y: tuple[float, float], role: Role, *, opacity: float = 1.0, label: str = ""
    ) -> None:
        """Fill a rectangle; infinite ends reach the edges."""
        self.area(x, y[0], y[1], role, opacity=opacity, label=label)

    def polygons(
        self, polygons: Sequence[FloatArray] | FloatArray, role: Role, *, opacity: float, label: str = ""
    ) -> None:
        """Fill polygons, each (n, 2)."""
        self.marks.append(Area(polygons=tuple(polygons), role=role, opacity=opacity, label=label))

    def segments(
        self,
        ends: ArrayLike,
        role: Role,
        *,
        width: float,
        opacity: float = 1.0,
        label: str = "",
        arrows: bool = False,
    ) -> None:
        """Add separate pieces, (n, 2, 2)."""
        pieces = np.asarray(ends, dtype=np.float64).reshape(-1, 2, 2)
        self.marks.append(Segments(ends=pieces, role=role, width=width, opacity=opacity, label=label, arrows=arrows))

    def word(
        self,
        x: float,
        y: float,
        text: str,
        role: Role,
        *,
        size: float = STYLE.tick,
        anchor: Literal["start", "middle", "end"] = "start",
        shift: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """Add words at a place."""
        self.words.append(Word(x=float(x), y=float(y), text=text, role=role, size=size, anchor=anchor, shift=shift))

    @property
    def lines(self) -> list[Line]:
        """The lines alone."""
        return [mark for mark in self.marks if isinstance(mark, Line)]

    @property
    def keyed(self) -> list[Mark]:
        """What has an entry in a key."""
        return [mark for mark in self.marks if mark.label]

    def fix_limits(self) -> None:
        """Take the limits that are not given from what is drawn."""
        corners = np.concatenate([*(mark.corners for mark in self.marks), np.empty((0, 2))])
        self.x.limits, self.y.limits = self.x.fitted(corners[:, 0]), self.y.fitted(corners[:, 1])

    def x_ticks(self) -> Sequence[Tick]:
        """Ticks along, as many as its width has room for."""
        return _ticks(self.x, self.box[2] / STYLE.across)

    def y_ticks(self) -> Sequence[Tick]:
        """Ticks upwards, as many as its height has room for."""
        return _ticks(self.y, self.box[3] / STYLE.down)

    def place(self, points: FloatArray) -> FloatArray:
        """(..., 2) places in the figure of (..., 2) values; what is beyond an axis lies a little beyond its edge."""
        left, top, width, height = self.box
        x, y = _share(self.x, points[..., 0]), _share(self.y, points[..., 1])
        return np.stack([left + x * width, top + (1.0 - y) * height], axis=-1)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Key:
    """A key outside of all panels.

    Attributes:
        panel: whose lines it names.
        below: it stands below the panels, in the middle; else above them, on the right.
        title: words over it.
    """

    panel: Panel
    below: bool = False
    title: str = ""

    @property
    def height(self) -> float:
        """Room that it takes [pt]."""
        return STYLE.line * STYLE.tick * (2.0 if self.title else 1.0) + STYLE.gap


@dataclass(eq=False, kw_only=True)
class Figure:
    """Panels in rows and columns.

    Attributes:
        width: [pt].
        height: [pt].
        rows: panels of each row, None where there is none.
        across: widths of the columns, relative.
        down: heights of the rows, relative.
        key: outside of the panels.
        title: above all.
    """

    width: float
    height: float
    rows: list[list[Panel | None]]
    across: Sequence[float] = ()
    down: Sequence[float] = ()
    key: Key | None = None
    title: str = ""

    @cached_property
    def panels(self) -> list[Panel]:
        """All panels, row by row."""
        return [panel for row in self.rows for panel in row if panel is not None]

    def arrange(self) -> None:
        """Give every panel its box and its limits; doing it again changes nothing."""
        for panel in self.panels:
            panel.fix_limits()
        columns = list(zip(*self.rows, strict=True))
        top = STYLE.gap + (STYLE.line * STYLE.head if self.title else 0.0)
        below = STYLE.gap
        if self.key is not None:
            top, below = top + (not self.key.below) * self.key.height, below + self.key.below * self.key.height
        tops, heights = _spread(
            (top, self.height - below), [(_most(_above, row), _most(_below, row)) for row in self.rows], self.down
        )
        for row, upper, height in zip(self.rows, tops, heights, strict=True):
            for one in row:
                if one is not None:
                    one.box = (0.0, upper, 0.0, height)
        lefts, widths = _spread(
            (0.0, self.width), [(_most(_left, column), _most(_right, column)) for column in columns], self.across
        )
        for column, left, width in zip(columns, lefts, widths, strict=True):
            for one in column:
                if one is not None:
                    one.box = _equal_box(one, (left, one.box[1], width, one.box[3]))


def grid_of(
    n_rows: int, n_columns: int, *, size: tuple[float, float], across: Sequence[float] = (), down: Sequence[float] = ()
) -> Figure:
    """A figure of `size` inches with a panel in each of `n_rows` times `n_columns` places."""
    rows: list[list[Panel | None]] = [[Panel() for _ in range(n_columns)] for _ in range(n_rows)]
    return Figure(width=72.0 * size[0], height=72.0 * size[1], rows=rows, across=across, down=down)


def row_of(n_panels: int, *, most_columns: int, width: float, height: float) -> Figure:
    """As many panels as are asked for, `most_columns` in a row of `height` inches."""
    n_columns = min(most_columns, max(1, n_panels))
    n_rows = max(1, -(-n_panels // n_columns))
    figure = grid_of(n_rows, n_columns, size=(width, 0.3 + height * n_rows))
    for number in range(max(1, n_panels), n_rows * n_columns):
        figure.rows[number // n_columns][number % n_columns] = None
    return figure


def _ticks(axis: Axis, room: float) -> Sequence[Tick]:
    if axis.ticks is not None:
        return axis.ticks
    low, high = sorted(axis.limits or (0.0, 1.0))
    return ticks_between(low, high, most=int(np.clip(room, 2, 9)), log=axis.log)


def _share(axis: Axis, values: FloatArray) -> FloatArray:
    """Place along an axis, 0 at its first end and 1 at its last, a length beyond it at most."""
    low, high = axis.limits or (0.0, 1.0)
    if axis.log:
        with np.errstate(divide="ignore", invalid="ignore"):
            values = np.log(np.where(values > 0, values, np.where(values == -np.inf, 0.0, np.nan)))
        low, high = math.log(low), math.log(high)
    return np.clip((values - low) / (high - low), -1.0, 2.0)


def _spread(
    room: tuple[float, float], margins: Sequence[tuple[float, float]], ratios: Sequence[float]
) -> tuple[list[float], list[float]]:
    """Start and length of each cell between the two ends of the room, when each needs margins before and behind."""
    shares = np.asarray(ratios or [1.0] * len(margins))
    free = room[1] - room[0] - sum(before + behind for before, behind in margins)
    lengths = (max(free, 1.0) * shares / shares.sum()).tolist()
    starts, at = [], room[0]
    for (before, behind), length in zip(margins, lengths, strict=True):
        starts.append(at + before)
        at += before + length + behind
    return starts, lengths


def _most(need: Callable[[Panel], float], panels: Sequence[Panel | None]) -> float:
    return max([need(panel) for panel in panels if panel is not None], default=0.0)


def _above(panel: Panel) -> float:
    head = STYLE.line * STYLE.head * (panel.head.count("\n") + 1) + STYLE.gap if panel.head else STYLE.gap
    return head + STYLE.line * STYLE.tick * panel.rows_above


def _below(panel: Panel) -> float:
    if not panel.frame:
        return STYLE.gap
    deep = STYLE.gap
    if panel.x.labelled:
        texts = [text for _, text in panel.x.ticks or ()]
        lines = 1 + max([text.count("\n") for text in texts], default=0)
        long = max([text_width(text, STYLE.tick) for text in texts], default=0.0)
        deep += STYLE.gap + (long if panel.x.upright else STYLE.line * STYLE.tick * lines)
    return deep + (STYLE.line * STYLE.label if panel.x.label else 0.0)


def _left(panel: Panel) -> float:
    if not panel.frame:
        return STYLE.gap
    texts = [text for _, text in panel.y_ticks()] if panel.y.labelled else []
    wide = max([text_width(text, STYLE.tick) for text in texts], default=0.0)
    return 2.0 * STYLE.gap + wide + (STYLE.line * STYLE.label if panel.y.label else 0.0)


def _right(panel: Panel) -> float:
    return 2.0 * STYLE.gap if panel.frame else STYLE.gap


def _equal_box(panel: Panel, box: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    """The box, made smaller in one direction where one unit is to be as long along as upwards."""
    if not panel.equal:
        return box
    left, top, width, height = box
    (x0, x1), (y0, y1) = panel.x.limits or (0.0, 1.0), panel.y.limits or (0.0, 1.0)
    unit = min(width / abs(x1 - x0), height / abs(y1 - y0))
    wide, high = unit * abs(x1 - x0), unit * abs(y1 - y0)
    return left + 0.5 * (width - wide), top + 0.5 * (height - high), wide, high


def runs(there: FloatArray) -> Iterator[tuple[int, int]]:
    """First and behind-last index of each run of finite rows of (n, 2) points."""
    edges = np.flatnonzero(np.diff(np.pad(np.isfinite(there).all(axis=1), 1)))
    yield from list(pairwise(edges.tolist()))[::2]
