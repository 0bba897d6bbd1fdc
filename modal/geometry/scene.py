"""What is drawn of a structure, in lengths of the picture: nodes around the middle, lines as segments, reach of motion.

A picture must stay light whatever comes: of many segments, those that can move are kept first.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from modal.geometry.eye import Eye, chosen_eye
from modal.geometry.placement import Placement
from modal.modes.mode import Mode
from okid.arrays import BoolArray, ComplexArray, FloatArray

__all__ = ["Scene", "envelope_of", "scene_of"]

IndexArray = npt.NDArray[np.intp]

REACH: Final = 0.34
"""Largest motion, in half the largest extent of the structure."""

SLENDER_REACH: Final = 0.5
"""The same for a structure that is a line, whose picture is low otherwise."""

SLENDER: Final = 0.25
"""Second largest extent over the largest, up to which a structure is a line."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Scene:
    """A structure as it is drawn.

    Attributes:
        placement: outputs on the geometry.
        positions: (n_nodes, 3) around 0, half the largest extent 1.
        segments: (n_segments, 2) nodes at both ends of each piece of a line, each pair once.
        triangles: (n_triangles, 3) corners of the surfaces.
        moving: (n_nodes,) True where a node can move.
        reach: largest motion in the picture.
        eye: from where to look.
    """

    placement: Placement
    positions: FloatArray
    segments: IndexArray
    triangles: IndexArray
    moving: BoolArray
    reach: float
    eye: Eye

    def motion(self, mode: Mode) -> ComplexArray:
        """(n_nodes, 3) motion of every node in the picture's lengths."""
        return np.asarray(self.reach * self.placement.deflection(mode))

    def drawn_segments(self, most: int) -> IndexArray:
        """At most `most` segments: all that can move, as far as that goes, then evenly many of the others."""
        if len(self.segments) <= most:
            return self.segments
        can_move = self.moving[self.segments].any(axis=1)
        chosen = _evenly(np.flatnonzero(can_move), most)
        others = _evenly(np.flatnonzero(~can_move), most - len(chosen))
        return self.segments[np.sort(np.concatenate([chosen, others]))]


def scene_of(placement: Placement) -> Scene:
    """The scene for outputs on a geometry."""
    geometry = placement.geometry
    low, high = geometry.positions.min(axis=0), geometry.positions.max(axis=0)
    extent = np.sort(high - low)
    half = float(extent[-1]) / 2 or 1.0
    moving = np.zeros(geometry.n_nodes, dtype=np.bool_)
    moving[placement.motions.moving] = True
    return Scene(
        placement=placement,
        positions=(geometry.positions - (low + high) / 2) / half,
        segments=_segments(geometry.lines),
        triangles=_triangles(geometry.surfaces),
        moving=moving,
        reach=SLENDER_REACH if extent[1] <= SLENDER * extent[2] else REACH,
        eye=chosen_eye(placement),
    )


def envelope_of(motion: ComplexArray) -> FloatArray:
    """(n_nodes, 3) from rest to the furthest point of each node's path, on the side of the shape at its start.

    A node moves by Re(m exp(i phi)), on an ellipse; its longer half axis is Re(m exp(-i a / 2)), a = arg(m' m).

    Args:
        motion: (n_nodes, 3) complex.

    Example:
        >>> envelope_of(np.array([[0.0, 0.0, 0.6 + 0.8j], [-1j, 0.0, 0.0]])).round(12).tolist()
        [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]
    """
    phase = 0.5 * np.angle((motion**2).sum(axis=1))
    furthest = (motion * np.exp(-1j * phase)[:, np.newaxis]).real
    side = (furthest * motion.real).sum(axis=1)
    sideways = (furthest * motion.imag).sum(axis=1)
    side = np.where(np.abs(side) > 1e-9 * (motion.real**2 + motion.imag**2).sum(axis=1), side, -sideways)
    return np.asarray(np.where(side[:, np.newaxis] < 0, -furthest, furthest) + 0.0, dtype=np.float64)


def _segments(lines: tuple[tuple[int, ...], ...]) -> IndexArray:
    pairs = [np.column_stack([line[:-1], line[1:]]) for line in lines]
    if not pairs:
        return np.zeros((0, 2), dtype=np.intp)
    ends = np.sort(np.concatenate(pairs).astype(np.intp), axis=1)
    _, first = np.unique(ends, axis=0, return_index=True)
    kept = ends[np.sort(first)]
    return np.asarray(kept[kept[:, 0] != kept[:, 1]])


def _triangles(surfaces: tuple[tuple[int, ...], ...]) -> IndexArray:
    """Every surface as a fan around its first corner."""
    fans = [(surface[0], *pair) for surface in surfaces for pair in pairwise(surface[1:])]
    return np.array(fans, dtype=np.intp).reshape(len(fans), 3)


def _evenly(indices: IndexArray, most: int) -> IndexArray:
    if len(indices) <= most:
        return indices
    return indices[np.linspace(0, len(indices) - 1, max(most, 0)).astype(np.intp)]
