"""A structure as it is drawn: nodes around the middle, lines as segments, reach of motion, and from where to look.

Seen along the unit vector d, the plane of two axes i and j shows the share |d_k| of its area (k the third axis). With
weights w_k of the planes, the product of all shares to the power of their weights is largest at

    d_k^2 = w_k / (w_x + w_y + w_z),        w_x = s_y s_z,  w_y = s_z s_x,  w_z = s_x s_y

(Lagrange). s_i is how much of interest lies along axis i: extent and motion. A beam along X that moves in Z is so seen
from the front, a plate from above, a tower that moves in X and Y over its corner, a building like a box; a little less
from the right than that, since along a diagonal corners hide one another.

The components of a real mode lie on one line through 0: all sensors reach their extremes together. Phase collinearity
(1 on a line) and mean phase deviation (degrees from it) measure that; with few sensors both say little. For a mode with
pole s, velocity is s and acceleration s^2 times displacement: where the outputs are of several of these kinds, dividing
by that power makes displacements of all of them, so that an assurance does not hang on what was measured in which unit.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from modal.geometry.placement import ROTATION, TRANSLATION, Placement, derivatives_of, rows_by_unit, turned
from modal.modes.mode import Mode
from okid.arrays import ROUNDED, BoolArray, ComplexArray, FloatArray
from okid.readers.units import convert_unit


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """How a structure is looked at, and how far it is drawn to move.

    Attributes:
        motion: weight of the motion along an axis, as a share of that of the largest extent.
        least: weight of an axis without extent or motion: enough for a picture to look like one of space.
        aside: share of the way to the right that is gone: along a diagonal, corners and columns would hide one another.
        lowest: sine of the least height of the eye above the ground.
        highest: the same of the greatest height.
        reach: largest motion, in half the largest extent of the structure.
        slender_reach: the same for a structure that is a line, whose picture is low otherwise.
        slender: second largest extent over the largest, up to which a structure is a line.
    """

    motion: float = 0.45
    least: float = 0.07
    aside: float = 0.72
    lowest: float = 0.16
    highest: float = 0.62
    reach: float = 0.34
    slender_reach: float = 0.5
    slender: float = 0.25


VIEW: Final = View()


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Eye:
    """A direction of view.

    Attributes:
        towards: (3,) unit vector from the structure to the eye.
        right: (3,) unit vector that points right in the picture.
        up: (3,) unit vector that points up in the picture.
    """

    towards: FloatArray
    right: FloatArray
    up: FloatArray

    def seen(self, points: FloatArray) -> FloatArray:
        """(n, 2) places in the picture, right and up, of (n, 3) points; without perspective."""
        return np.asarray(points @ np.column_stack([self.right, self.up]), dtype=np.float64)


def chosen_eye(placement: Placement) -> Eye:
    """The direction that shows most: from the front right, above the ground.

    Example:
        >>> from modal.geometry.placement import placed
        >>> chosen_eye(placed(None, ["a", "b", "c"])).towards.round(2).tolist()  # right, front, above
        [0.17, -0.92, 0.36]
    """
    positions = placement.geometry.positions
    extent = np.ptp(positions, axis=0)
    largest = float(extent.max())
    of_extent = extent / largest if largest > 0 else np.zeros(3)
    seen = np.zeros(3)
    for block in placement.motions.blocks:
        # how far each axis moves when every sensor of the block reads 1
        seen = np.maximum(seen, np.linalg.norm(block.matrix, axis=2).max(axis=0))
    of_motion = VIEW.motion * np.minimum(seen, 1.0)
    size = np.maximum(np.hypot(of_extent, of_motion), VIEW.least)
    planes = np.array([size[1] * size[2], size[2] * size[0], size[0] * size[1]])
    return _eye(np.sqrt(planes / planes.sum()) * [VIEW.aside, -1.0, 1.0])


def _eye(towards: FloatArray) -> Eye:
    height = float(np.clip(towards[2], VIEW.lowest, VIEW.highest))
    level = towards[:2] / np.linalg.norm(towards[:2])
    towards = np.array([*(level * np.sqrt(1.0 - height**2)), height])
    right = np.array([-level[1], level[0], 0.0])
    return Eye(towards=towards, right=right, up=np.cross(towards, right))


IndexArray = npt.NDArray[np.intp]


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
        reach=VIEW.slender_reach if extent[1] <= VIEW.slender * extent[2] else VIEW.reach,
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
    side = np.where(np.abs(side) > ROUNDED * (motion.real**2 + motion.imag**2).sum(axis=1), side, -sideways)
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


REAL_COLLINEARITY: Final = 0.95
"""Call a shape nearly real from this phase collinearity."""

REAL_DEVIATION: Final = 10.0
"""Call a shape nearly real up to this mean phase deviation [deg]."""

MIXED_COLLINEARITY: Final = 0.5
"""Say that no phase is common below this one: a random shape of three sensors reaches it on average."""


def phasors(mode: Mode, output_units: Sequence[str]) -> ComplexArray:
    """Components of a shape, largest 1 in each unit, turned to the best real phase.

    Velocities and accelerations beside displacements are divided by the pole and its square, which brings their phases
    together.

    Returns:
        (n_outputs,).
    """
    derivatives = derivatives_of(output_units)
    divisor = np.array([mode.pole**power if mode.pole else 1.0 for power in derivatives])
    values = np.asarray(mode.shape / divisor, dtype=np.complex128)
    for row in rows_by_unit(output_units):
        largest = np.abs(values[list(row)]).max()
        if largest > 0:
            values[list(row)] /= largest
    return turned(values)


def complexity_words(mode: Mode) -> str:
    """What collinearity and phase deviation of a shape say; the numbers are given with it.

    Example:
        >>> shape = np.array([1.0, -0.5])
        >>> mode = Mode(pole=-1 + 9j, kind="oscillatory", frequency=1.4, damping_ratio=0.1, shape=shape,
        ...             participation=np.ones(1), phase_collinearity=0.99, mpd=1.2)
        >>> complexity_words(mode)
        'nearly real'
    """
    if mode.shape.size < 2:
        return "one sensor"
    if not (np.isfinite(mode.phase_collinearity) and np.isfinite(mode.mpd)):
        return "not known"
    if mode.phase_collinearity >= REAL_COLLINEARITY and mode.mpd <= REAL_DEVIATION:
        return "nearly real"
    if mode.phase_collinearity < MIXED_COLLINEARITY:
        return "no common phase"
    return "complex"


def comparable_shapes(modes: Sequence[Mode], output_names: Sequence[str], output_units: Sequence[str]) -> ComplexArray:
    """(n_outputs, n_modes) shapes as displacements where units differ and allow it, as they are otherwise.

    Example:
        >>> from types import SimpleNamespace
        >>> fast = SimpleNamespace(pole=10j, shape=np.array([1.0, -200.0]))
        >>> comparable_shapes([fast], ["a", "b"], ["m", "m/s^2"]).real.ravel().tolist()
        [1.0, 2.0]
    """
    if not modes:
        return np.empty((len(output_names), 0), dtype=np.complex128)
    shapes = np.column_stack([mode.shape for mode in modes]).astype(np.complex128)
    kinds = _kinds(output_names, output_units)
    if kinds is None:
        return shapes
    factors = np.array([factor for factor, _ in kinds])
    powers = np.array([order for _, order in kinds])
    poles = np.array([mode.pole or 1.0 for mode in modes], dtype=np.complex128)
    return np.asarray(shapes * factors[:, np.newaxis] / poles ** powers[:, np.newaxis], dtype=np.complex128)


def comparison_words(output_names: Sequence[str], output_units: Sequence[str]) -> str:
    """What was done to outputs of several units before shapes are compared; "" where they have one.

    Example:
        >>> comparison_words(["a", "b"], ["m", "m"])
        ''
    """
    if len(set(output_units)) < 2:
        return ""
    if _kinds(output_names, output_units) is None:
        return (
            "The assurance is that of the numbers as they are, so outputs in units with large numbers weigh more in it."
        )
    return (
        "The outputs have different units: for the MAC all are made displacements, velocities divided by the "
        "pole and accelerations by its square."
    )


def _kinds(names: Sequence[str], units: Sequence[str]) -> list[tuple[float, int]] | None:
    """SI units in one unit of each output and how often it is derived by time; None for one unit, or several kinds."""
    if len(set(units)) < 2:
        return None
    known = [convert_unit(name, unit) if unit else None for name, unit in zip(names, units, strict=True)]
    for kind in (TRANSLATION, ROTATION):
        if all(one is not None and one.unit in kind for one in known):
            return [(one.factor, kind[one.unit]) for one in known if one is not None]
    return None
