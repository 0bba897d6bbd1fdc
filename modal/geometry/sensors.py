"""Where a structure is measured: nodes, the lines between them, and which way each sensor looks.

A geometry knows nothing of a record; names tie the two together. A channel belongs to the sensor of its name, or, where
there is none, to the node and axis that its name states (`modal.geometry.dof_names`: `12X+`).

Motion is drawn where it was seen and nowhere else. At a node, the sensors' directions d_i and readings y_i give the
motion of least size that repeats them, v = D^+ y; across their span it is not known and stays zero. Only what the
geometry itself declares is carried further: nodes of one rigid body (`modal.geometry.node_motion`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from modal.geometry.dof_names import Motion, dof_of
from modal.geometry.node_motion import motion_of
from modal.wording.names import shorten, visible
from okid.arrays import ComplexArray, FloatArray, frozen
from okid.errors import InvalidDataError

__all__ = ["MOST_NODES", "Geometry", "Sensor", "node_numbers"]

MOST_NODES: Final = 50_000
MOST_PLACES: Final = 400_000
"""Places in all lines, surfaces and bodies together."""
MOST_SENSORS: Final = 8192
FURTHEST: Final = 1e9
"""Largest coordinate [m]: beyond it, numbers are no positions of one structure."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Sensor:
    """One channel's place and direction.

    Args:
        name: of the channel.
        node: index of the node.
        direction: (3,) in the axes of the geometry, any length but zero; kept as a unit vector.
        motion: "along" the direction, or "about" it for a rotation.

    Raises:
        InvalidDataError: a direction that is not three finite numbers, or is zero.
    """

    name: str
    node: int
    direction: FloatArray
    motion: Motion = "along"

    def __post_init__(self) -> None:
        direction = frozen(self.direction, name=f"the direction of sensor {_quoted(self.name)}", shape=(3,))
        largest = float(np.abs(direction).max())
        if not largest > 0:
            raise InvalidDataError(
                f"sensor {_quoted(self.name)} has the direction (0, 0, 0); give the way it looks, such as [1, 0, 0]."
            )
        if self.motion not in ("along", "about"):
            raise InvalidDataError(f"a sensor sees motion 'along' or 'about' its direction, but not {self.motion!r}.")
        scaled = direction / largest  # against overflow of the squares
        object.__setattr__(self, "direction", frozen(scaled / np.linalg.norm(scaled), name="direction"))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Geometry:
    """Nodes, lines and sensors of a structure.

    Args:
        node_names: one a node, all different.
        positions: (n_nodes, 3) [m].
        lines: indices of the nodes along each line.
        surfaces: indices of the corners of each surface, in turn.
        sensors: explicit ones; a channel named like `12X+` needs none.
        fixed: indices of nodes that are known to stand still.
        rigid: indices of the nodes of each body that moves as one.
        axes: (n_nodes, 3, 3) directions of the local X, Y and Z at each node, one a row; None: those of the geometry.

    Raises:
        InvalidDataError: names or positions that do not fit together, an index of no node, a sensor's name twice.

    Example:
        >>> line = Geometry(node_names=("1", "2"), positions=[[0, 0, 0], [0, 0, 3]], lines=((0, 1),))
        >>> line.deflection(np.array([1.0, -2.0]), ["2X+", "2Y-"]).real.tolist()
        [[0.0, 0.0, 0.0], [1.0, 2.0, 0.0]]
    """

    node_names: tuple[str, ...]
    positions: FloatArray
    lines: tuple[tuple[int, ...], ...] = ()
    surfaces: tuple[tuple[int, ...], ...] = ()
    sensors: tuple[Sensor, ...] = ()
    fixed: tuple[int, ...] = ()
    rigid: tuple[tuple[int, ...], ...] = ()
    axes: FloatArray | None = None

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        set_(self, "node_names", tuple(self.node_names))
        _check_names(self.node_names)
        set_(self, "positions", _positions(self.positions, self.node_names))
        for field in ("lines", "surfaces", "rigid"):
            set_(self, field, tuple(tuple(int(node) for node in part) for part in getattr(self, field)))
        set_(self, "sensors", tuple(self.sensors))
        set_(self, "fixed", tuple(int(node) for node in self.fixed))
        _check_parts(self)
        _check_sensors(self)
        if self.axes is not None:
            set_(self, "axes", frozen(self.axes, name="axes", shape=(len(self.node_names), 3, 3)))

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return len(self.node_names)

    @property
    def size(self) -> float:
        """Largest extent along X, Y or Z [m]; 1 where all nodes stand in one place."""
        extent = float(np.ptp(self.positions, axis=0).max())
        return extent if extent > 0 else 1.0

    def sensors_of(self, output_names: Sequence[str]) -> tuple[Sensor | None, ...]:
        """The sensor of each of `output_names`: by its name, else by the node and axis that it states, else None."""
        explicit = {sensor.name: sensor for sensor in self.sensors}
        numbers = node_numbers(self.node_names)
        return tuple(explicit.get(name) or self._stated(name, numbers) for name in output_names)

    def _stated(self, name: str, numbers: dict[str, int]) -> Sensor | None:
        dof = dof_of(name)
        if dof is None:
            return None
        node = numbers.get(dof.node, numbers.get(_plain_number(dof.node)))
        if node is None and ":" in dof.node:  # plate:3 is node 3 of the component plate
            last = dof.node.rpartition(":")[2]
            node = numbers.get(last, numbers.get(_plain_number(last)))
        if node is None:
            return None
        axes = np.eye(3) if self.axes is None else self.axes[node]
        return Sensor(name=name, node=node, direction=dof.sign * axes[dof.axis], motion=dof.motion)

    def deflection(self, shape: ComplexArray, output_names: Sequence[str]) -> ComplexArray:
        """Motion of every node in one shape; zero where no sensor saw it.

        Args:
            shape: (n_outputs,) real or complex, components that can be compared (`modal.geometry.placement` makes them so).
            output_names: of the channels.

        Returns:
            (n_nodes, 3), in the unit of the shape.

        Raises:
            InvalidDataError: the shape has not one component a name.
        """
        return motion_of(self, self.sensors_of(output_names)).deflection(shape)


def node_numbers(node_names: Sequence[str]) -> dict[str, int]:
    """Index of each node by name; whole numbers without leading zeros as well, since `012` means node 12."""
    numbers = {_plain_number(name): index for index, name in enumerate(node_names)}
    return numbers | {name: index for index, name in enumerate(node_names)}


def _plain_number(text: str) -> str:
    return text.lstrip("0") or "0" if text.isascii() and text.isdigit() else text


def _quoted(name: object) -> str:
    return repr(shorten(visible(str(name)), 60))


def _check_names(names: tuple[str, ...]) -> None:
    if not names:
        raise InvalidDataError(
            "a geometry needs at least 1 node, but has none; name the nodes and give their positions."
        )
    if len(names) > MOST_NODES:
        raise InvalidDataError(
            f"a geometry may have {MOST_NODES} nodes, but has {len(names)}; keep those that carry sensors and lines."
        )
    if not all(str(name).strip() for name in names):
        raise InvalidDataError("every node needs a name of at least one visible letter; number them if they have none.")
    if len(set(names)) < len(names):
        twice = next(name for index, name in enumerate(names) if name in names[:index])
        raise InvalidDataError(f"node {_quoted(twice)} is given twice; name each node once.")


def _positions(values: FloatArray, names: tuple[str, ...]) -> FloatArray:
    try:
        positions = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidDataError("positions must be numbers, three a node, in metres.") from error
    if positions.shape != (len(names), 3):
        raise InvalidDataError(
            f"positions must have shape (n_nodes, 3) = ({len(names)}, 3), but have {positions.shape}; give x, y and z."
        )
    wrong = np.flatnonzero(~(np.abs(positions) <= FURTHEST).all(axis=1))
    if wrong.size:
        shown = ", ".join(f"{value:.6g}" for value in positions[wrong[0]])
        raise InvalidDataError(
            f"coordinates must be finite and at most {FURTHEST:g} m, but node {_quoted(names[wrong[0]])} stands at "
            f"({shown}); correct it."
        )
    return frozen(positions, name="positions")


def _check_parts(geometry: Geometry) -> None:
    least = {"lines": 2, "surfaces": 3, "rigid": 2}
    total = 0
    for field, parts in (("lines", geometry.lines), ("surfaces", geometry.surfaces), ("rigid", geometry.rigid)):
        total += sum(map(len, parts))
        for number, part in enumerate(parts, start=1):
            if len(part) < least[field]:
                raise InvalidDataError(
                    f"part {number} of {field} has {len(part)} node{'s' * (len(part) != 1)}, but needs at least "
                    f"{least[field]}; add nodes or leave it out."
                )
            _check_indices(part, geometry.n_nodes, f"part {number} of {field}")
    if total > MOST_PLACES:
        raise InvalidDataError(
            f"lines, surfaces and bodies may have {MOST_PLACES} places together, but have {total}; keep fewer."
        )
    _check_indices(geometry.fixed, geometry.n_nodes, "fixed")
    held = [node for body in geometry.rigid for node in set(body)] + list(set(geometry.fixed))
    if len(set(held)) < len(held):
        twice = max(set(held), key=held.count)
        raise InvalidDataError(
            f"node {_quoted(geometry.node_names[twice])} belongs to more than one rigid body, or to one and to fixed; "
            "put it into one of them."
        )


def _check_indices(nodes: Sequence[int], n_nodes: int, where: str) -> None:
    wrong = [node for node in nodes if not 0 <= node < n_nodes]
    if wrong:
        raise InvalidDataError(
            f"{where} names node index {wrong[0]}, but the geometry has indices 0 to {n_nodes - 1}; correct it."
        )


def _check_sensors(geometry: Geometry) -> None:
    if len(geometry.sensors) > MOST_SENSORS:
        raise InvalidDataError(f"a geometry may have {MOST_SENSORS} sensors, but has {len(geometry.sensors)}.")
    names: set[str] = set()
    for sensor in geometry.sensors:
        _check_indices([sensor.node], geometry.n_nodes, f"sensor {_quoted(sensor.name)}")
        if sensor.name in names:
            raise InvalidDataError(
                f"channel {_quoted(sensor.name)} has two sensors; a channel stands in one place, so remove one of them."
            )
        names.add(sensor.name)
