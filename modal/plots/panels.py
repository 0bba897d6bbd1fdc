"""A panel as numbers: two axes with their scales and ticks, and the curves, areas, pieces and words between them.

Lengths are points (1/72 inch) from the left upper corner of the chart; values beyond an axis, infinite ones too, are
drawn as far as its edge. Colours have a meaning, the same in every picture.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike

from okid.arrays import ROUNDED, FloatArray

Role = Literal["paper", "ink", "muted", "grid", "measured", "model", "residual", "system", "doubtful", "noise"]
"""What a colour means: background, text, text of second rank, lines behind the data, what was measured, what the model
says, what is left over, and modes that are of the system, may be, and are not."""

IN_TURN: Final[tuple[Role, ...]] = ("measured", "model", "system", "residual", "doubtful", "muted")
"""Draw channels and modes that stand side by side in these colours, in turn."""

COLOURS: Final[dict[Role, str]] = {
    "paper": "#ffffff",
    "ink": "#1c2430",
    "muted": "#5c6675",
    "grid": "#e1e5ea",
    "measured": "#2b6cd4",
    "model": "#e2761b",
    "residual": "#b83142",
    "system": "#0d7a52",
    "doubtful": "#8f5f0a",
    "noise": "#a3abb5",
}
"""Draw in these on light paper; a page exchanges each for its own by name."""


@dataclass(frozen=True, slots=True)
class Style:
    """Sizes in points, 1/72 inch, but for the page.

    Attributes:
        tick: letters of ticks and keys.
        label: letters of the names of axes.
        head: letters above a panel.
        line: height of a line of words over the size of its letters.
        grid: width of grid and axes.
        gap: between words and what they stand beside.
        sample: length of the piece of line in a key.
        margin: share of the range of the data that stays free at both ends of an axis.
        across: least distance of ticks along, wide enough for a number.
        down: least distance of ticks upwards.
        ground: opacity of the paper behind a key.
        thin: width of a line that another is to be seen over, or that only marks a place.
        stroke: width of a line.
        thick: width of the line that matters most.
        under: width of a measured line that a model is drawn over, so that it is seen on both sides of it.
        dot: diameter of a dot.
        faint: opacity of an area behind everything.
        pale: opacity of a band that means something, and of a line that is not to be trusted.
        half: opacity of what another line is drawn over.
        strong: opacity of a line that lets what is behind it shine through.
        page: width of a picture as wide as its page [in].
    """

    tick: float = 8.5
    label: float = 9.0
    head: float = 9.5
    line: float = 1.25
    grid: float = 0.7
    gap: float = 4.0
    sample: float = 18.0
    margin: float = 0.05
    across: float = 36.0
    down: float = 25.0
    ground: float = 0.85
    thin: float = 0.8
    stroke: float = 1.2
    thick: float = 1.7
    under: float = 3.2
    dot: float = 4.8
    faint: float = 0.12
    pale: float = 0.25
    half: float = 0.5
    strong: float = 0.8
    page: float = 10.4


STYLE: Final = Style()
"""Draw every picture in these sizes."""

_WIDTHS: Final = (("iljtfrI|!.,:;'()[] ·", 0.38), ("mwMW@%—…", 0.92), ("ABCDEFGHKNOPQRUVXYZ&+±−=<>≥≤→", 0.72))
"""Take letters as this wide, as a share of their size: those of the widest of the usual fonts of browsers."""


def text_width(text: str, size: float) -> float:
    """About how wide a line of words is [pt], on the safe side: the reader's browser has the font, not we."""
    kinds = {letter: width for letters, width in _WIDTHS for letter in letters}
    return size * sum(kinds.get(letter, 0.62) for letter in text)


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


Tick = tuple[float, str]

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def ticks_between(low: float, high: float, *, most: int, log: bool = False) -> list[Tick]:
    """Round values from `low` to `high` with their texts, about `most` of them.

    Example:
        >>> ticks_between(-0.3, 1.1, most=4)
        [(0.0, '0.0'), (0.5, '0.5'), (1.0, '1.0')]
        >>> ticks_between(2e-4, 30.0, most=3, log=True)
        [(0.001, '10⁻³'), (0.1, '10⁻¹'), (10.0, '10¹')]
        >>> ticks_between(0.5, 30.0, most=3, log=True)
        [(1.0, '1'), (10.0, '10')]
    """
    if not (math.isfinite(low) and math.isfinite(high) and high > low):
        return []
    if log:
        return _powers(low, high, most)
    step = _step((high - low) / most)
    values = step * np.arange(math.ceil(low / step - ROUNDED), math.floor(high / step + ROUNDED) + 1)
    largest = float(np.abs(values).max(initial=step))
    power = math.floor(math.log10(largest))
    scaled = power > 4 or power < -3
    digits = max(0, (power if scaled else 0) - math.floor(math.log10(step) + ROUNDED))
    unit = 10.0**power if scaled else 1.0
    tail = f"·{_power(power)}" if scaled else ""
    return [(float(value), f"{value / unit:.{digits}f}{tail if value else ''}".replace("-", "−")) for value in values]


def _powers(low: float, high: float, most: int) -> list[Tick]:
    """Powers of ten, every second, third ... of many; round values between them where there are few."""
    first, last = math.ceil(math.log10(low) - ROUNDED), math.floor(math.log10(high) + ROUNDED)
    if last - first < 1:
        between = [10.0**power * m for power in range(first - 1, last + 1) for m in (1, 2, 5)]
        kept = [value for value in between if low <= value <= high]
        return [(value, f"{value:.3g}") for value in kept] if len(kept) > 1 else ticks_between(low, high, most=most)
    every = max(1, -(-(last - first) // most))
    powers = range(first, last + 1, every)
    plain = powers[0] > -4 and powers[-1] < 5 and powers[-1] - powers[0] < 4
    return [(10.0**power, f"{10.0**power:g}" if plain else _power(power)) for power in powers]


def _power(power: int) -> str:
    return f"10{str(power).translate(_SUPERSCRIPTS)}"


def _step(least: float) -> float:
    """The smallest of 1, 2 and 5 times a power of ten that is at least `least`."""
    unit = 10.0 ** math.floor(math.log10(least))
    return next(unit * m for m in (1, 2, 5, 10) if unit * m >= least * (1.0 - ROUNDED))


Dash = Literal["", "dashed", "dotted"]
Anchor = Literal["start", "middle", "end"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Curve:
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
    """Filled polygons of one colour."""

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
    """Many separate pieces of one style."""

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
    """A line of words at a place of the panel."""

    x: float
    y: float
    text: str
    role: Role
    size: float
    anchor: Anchor
    shift: tuple[float, float]


Mark = Curve | Area | Segments


class Scale:
    """One side of a panel; like a sheet of paper, it changes until it is drawn.

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

    __slots__ = ("grid", "label", "labelled", "limits", "log", "margin", "role", "ticks", "upright")

    def __init__(self) -> None:
        self.label = ""
        self.limits: tuple[float, float] | None = None
        self.log = False
        self.ticks: Sequence[Tick] | None = None
        self.labelled = True
        self.grid = True
        self.upright = False
        self.margin = STYLE.margin
        self.role: Role = "muted"

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


def runs(there: FloatArray) -> Iterator[tuple[int, int]]:
    """First and behind-last index of each run of finite rows of (n, 2) points."""
    edges = np.flatnonzero(np.diff(np.pad(np.isfinite(there).all(axis=1), 1)))
    yield from list(pairwise(edges.tolist()))[::2]


Where = Literal["upper left", "upper right", "lower left", "lower right", "best"]


class Panel:
    """Axes with what is drawn on them; like a sheet of paper, it changes until it is drawn.

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

    __slots__ = ("box", "centred", "edges", "equal", "frame", "head", "key", "marks", "rows_above", "words", "x", "y")

    def __init__(self) -> None:
        self.x = Scale()
        self.y = Scale()
        self.head = ""
        self.centred = False
        self.frame = True
        self.edges: Literal["both", "below", "none"] = "both"
        self.equal = False
        self.rows_above = 0
        self.key: Where | None = None
        self.marks: list[Mark] = []
        self.words: list[Word] = []
        self.box = (0.0, 0.0, 1.0, 1.0)

    def line(
        self,
        x: ArrayLike,
        y: ArrayLike,
        role: Role,
        *,
        width: float = STYLE.stroke,
        opacity: float = 1.0,
        dash: Dash = "",
        dot: float = 0.0,
        square: bool = False,
        label: str = "",
        follows: str = "",
    ) -> None:
        """Add a line through (n,) points, see `Curve`."""
        along, up = (np.asarray(values, dtype=np.float64) for values in (x, y))
        self.marks.append(
            Curve(
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
        self.segments(ends[np.isfinite(ends).all(axis=(1, 2))], role)

    def across(self, y: float, role: Role, *, width: float = STYLE.stroke, dash: Dash = "", label: str = "") -> None:
        """Add a line over the whole width."""
        self.line([-math.inf, math.inf], [y, y], role, width=width, dash=dash, label=label)

    def upright(
        self,
        x: float,
        role: Role,
        *,
        width: float = STYLE.stroke,
        dash: Dash = "",
        opacity: float = 1.0,
        label: str = "",
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
        width: float = STYLE.stroke,
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
        anchor: Anchor = "start",
        shift: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """Add words at a place."""
        self.words.append(Word(x=float(x), y=float(y), text=text, role=role, size=size, anchor=anchor, shift=shift))

    @property
    def lines(self) -> list[Curve]:
        """The lines alone."""
        return [mark for mark in self.marks if isinstance(mark, Curve)]

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

    def within(self, points: FloatArray) -> FloatArray:
        """(..., 2) values of which the infinite ones stand at the edges, once the limits are known."""
        limits = np.array([self.x.limits, self.y.limits], dtype=np.float64)
        return np.where(np.isinf(points), np.where(points > 0, limits[:, 1], limits[:, 0]), points)

    def place(self, points: FloatArray) -> FloatArray:
        """(..., 2) places in the figure of (..., 2) values; what is beyond an axis lies a little beyond its edge."""
        left, top, width, height = self.box
        x, y = _share(self.x, points[..., 0]), _share(self.y, points[..., 1])
        return np.stack([left + x * width, top + (1.0 - y) * height], axis=-1)


def _ticks(axis: Scale, room: float) -> Sequence[Tick]:
    if axis.ticks is not None:
        return axis.ticks
    low, high = sorted(axis.limits or (0.0, 1.0))
    return ticks_between(low, high, most=int(np.clip(room, 2, 9)), log=axis.log)


def _share(axis: Scale, values: FloatArray) -> FloatArray:
    """Place along an axis, 0 at its first end and 1 at its last, a length beyond it at most."""
    low, high = axis.limits or (0.0, 1.0)
    if axis.log:
        with np.errstate(divide="ignore", invalid="ignore"):
            values = np.log(np.where(values > 0, values, np.where(values == -np.inf, 0.0, np.nan)))
        low, high = math.log(low), math.log(high)
    return np.clip((values - low) / (high - low), -1.0, 2.0)
