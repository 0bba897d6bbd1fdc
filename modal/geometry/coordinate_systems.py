"""Coordinate systems of a universal file: an origin, three axes, straight or around the third of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from modal.geometry.uff_fields import numbers, whole_numbers
from okid.arrays import FloatArray
from okid.errors import InvalidDataError

__all__ = ["CoordinateSystem", "systems_of_set_18", "systems_of_set_2420"]

KINDS: Final[tuple[Literal["cartesian", "cylindrical"], ...]] = ("cartesian", "cylindrical")
ROUND: Final = 1e-3
"""How far three axes may be from right angles and unit length before they count as damaged."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CoordinateSystem:
    """Where a system stands in the global one.

    Attributes:
        kind: "cartesian" or "cylindrical".
        origin: (3,).
        axes: (3, 3) directions of X, Y and Z, one a row.

    Example:
        >>> around = CoordinateSystem(kind="cylindrical", origin=np.zeros(3), axes=np.eye(3))
        >>> around.position(np.array([2.0, 90.0, 1.0])).round(12).tolist()
        [0.0, 2.0, 1.0]
        >>> around.axes_at(np.array([0.0, 2.0, 1.0]))[0].round(12).tolist()
        [0.0, 1.0, 0.0]
    """

    kind: Literal["cartesian", "cylindrical"]
    origin: FloatArray
    axes: FloatArray

    def position(self, place: FloatArray) -> FloatArray:
        """Global position of x, y, z, or of radius, angle [deg] and height."""
        if self.kind == "cylindrical":
            angle = np.deg2rad(place[1])
            place = np.array([place[0] * np.cos(angle), place[0] * np.sin(angle), place[2]])
        return np.asarray(self.origin + place @ self.axes, dtype=np.float64)

    def axes_at(self, position: FloatArray) -> FloatArray:
        """(3, 3) the directions in which displacements are counted at a global position, one a row."""
        if self.kind == "cartesian":
            return self.axes
        x, y, _ = self.axes @ (position - self.origin)
        angle = np.arctan2(y, x)  # 0 on the axis itself, where no radius has a direction
        turn = np.array([[np.cos(angle), np.sin(angle), 0.0], [-np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
        return np.asarray(turn @ self.axes, dtype=np.float64)


def systems_of_set_18(lines: Sequence[str], known: Mapping[int, CoordinateSystem]) -> dict[int, CoordinateSystem]:
    """Systems given by an origin, a point on X and a point in the plane of X and Z.

    Args:
        lines: of the data set: four a system.
        known: systems that these may refer to.

    Raises:
        InvalidDataError: a system that is neither cartesian nor cylindrical, or whose axes are none.
        ValueError: a line without its numbers.
    """
    filled = [line for number, line in enumerate(lines) if number % 4 == 1 or line.strip()]
    found = dict(known)
    for start in range(0, len(filled) - 3, 4):
        label, kind, reference = whole_numbers(filled[start], 3)[:3]
        values = numbers(filled[start + 2], 6, width=13) + numbers(filled[start + 3], 3, width=13)
        points = np.array(values).reshape(3, 3)
        if reference in found:
            points = np.array([found[reference].position(point) for point in points])
        along, beside = points[1] - points[0], points[2] - points[0]
        across = np.cross(beside, along)  # Z x X = Y
        with np.errstate(invalid="ignore", divide="ignore"):
            x, y = along / np.linalg.norm(along), across / np.linalg.norm(across)
        found[label] = _system(label, kind, points[0], np.array([x, y, np.cross(x, y)]))
    return found


def systems_of_set_2420(lines: Sequence[str]) -> dict[int, CoordinateSystem]:
    """Systems given by three rows of axes and one of the origin.

    Args:
        lines: of the data set: two for the part, then six a system.

    Raises:
        InvalidDataError: a system that is neither cartesian nor cylindrical, or whose axes are none.
        ValueError: a line without its numbers.
    """
    found = {}
    for start in range(2, len(lines) - 5, 6):
        label, kind = whole_numbers(lines[start], 2)[:2]
        rows = np.array([numbers(line, 3, width=25) for line in lines[start + 2 : start + 6]])
        found[label] = _system(label, kind, rows[3], rows[:3])
    return found


def _system(label: int, kind: int, origin: FloatArray, axes: FloatArray) -> CoordinateSystem:
    if kind not in (0, 1):
        raise InvalidDataError(
            f"coordinate system {label} is of kind {kind}, and only cartesian (0) and cylindrical (1) ones are read; "
            "export the displacements in one of these."
        )
    if not np.abs(axes @ axes.T - np.eye(3)).max() < ROUND:
        raise InvalidDataError(
            f"the axes of coordinate system {label} are not of unit length and at right angles; export it again."
        )
    return CoordinateSystem(kind=KINDS[kind], origin=origin, axes=axes)
