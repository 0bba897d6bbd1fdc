"""What is drawn on a panel: curves, areas, separate pieces and words, and the scale of an axis."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from modal.plots.style import STYLE, Role
from modal.plots.ticks import Tick
from okid.arrays import FloatArray

__all__ = ["Anchor", "Area", "Curve", "Dash", "Mark", "Scale", "Segments", "Word", "runs"]

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
