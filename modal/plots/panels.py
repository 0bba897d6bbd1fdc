"""A panel as numbers: two axes, and what is drawn between them.

Lengths are points (1/72 inch) from the left upper corner of the chart; values beyond an axis, infinite ones too, are
drawn as far as its edge.
"""

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from modal.plots.marks import Anchor, Area, Curve, Dash, Mark, Scale, Segments, Word
from modal.plots.style import STYLE, Role
from modal.plots.ticks import Tick, ticks_between
from okid.arrays import FloatArray

__all__ = ["Panel", "Where"]

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
