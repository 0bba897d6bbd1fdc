"""Where a structure is measured: nodes, the lines between them, and which way each sensor looks.

A geometry knows nothing of a record; names tie the two together. A channel belongs to the sensor of its name, or, where
there is none, to the node and axis that its name states, as test engineers write them: a node, an axis, a sign.

    12X+  12+X  12X  12x-  plate:3:+Z  plate:3Z  tip Z  tip_z+  tip.Z-  3RX+ (a rotation)  12X+ Acceleration

The node comes first, then the axis: X, Y or Z, after an R for a rotation about it. The sign stands right before the
axis or right after it, never both; without one it is plus. A minus before the axis is always a sign: `12-X` looks along
negative X. After a node that ends in a letter, one of `: . _` or a space or a sign parts it from the axis, so that
`max` and `flux` name no direction; after a digit none is needed. Words after a space, as the universal file reader adds
them to tell channels apart, are passed over where the name before them has a sign.

Motion is drawn where it was seen and nowhere else. A node with sensors of directions d_i and readings y_i moves by v
with d_i' v = y_i: the least-squares solution of least size, v = D^+ y, so nothing is made up across the span of the
directions. Directions within about 6 degrees of one another count as one: their difference would be mostly noise. Only
what the geometry itself declares is carried further: a rigid body moves by t + r x (p - c), and readings at its nodes
p_i give

    d_i' t + ((p_i - c) x d_i)' r = y_i    and, for a rotation about d_i,    d_i' r = y_i .

Translation comes first: of all solutions that fit equally well, the one with the least rotation r (so one sensor in X
and one in Y, wherever they are, move the body without turning it), and of these the one with the least t.
With A t + B r = y and the projection P = 1 - A A^+:  r = (P B)^+ P y,  t = A^+ (y - B r).
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from modal.wording.text import shorten
from okid.arrays import ROUNDED, ComplexArray, FloatArray, frozen
from okid.display import Displayed
from okid.errors import InvalidDataError, visible

Motion = Literal["along", "about"]
"""What a sensor sees: translation along its direction, or rotation about it."""


class GeometryLimits:
    """How large a geometry may be."""

    MOST_NODES: Final = 50_000
    """Refuse a geometry of more nodes: no viewer turns it smoothly."""
    MOST_PLACES: Final = 400_000
    """Refuse more places in all lines, surfaces and bodies together."""
    MOST_SENSORS: Final = 8192
    """Refuse more sensors."""
    FURTHEST: Final = 1e9
    """Refuse a larger coordinate [m]: beyond it, numbers are no positions of one structure."""


_AXES: Final = "XYZ"
_NAME: Final = re.compile(
    r"""(?P<node>[^\s](?:.*?[^\s:._+-])??)      # what the axis belongs to
        (?:(?<=\d)|(?=[:._\s+-]))               # a digit needs nothing between
        [:._\s]?\s*
        (?P<before>[+-]?)
        (?P<turning>[Rr]?)(?P<axis>[XYZxyz])
        (?P<after>[+-]?)""",
    re.VERBOSE,
)


@dataclass(frozen=True, slots=True)
class Dof:
    """What a name says.

    Attributes:
        node: its name, as written.
        axis: 0, 1 or 2 for X, Y or Z.
        sign: +1 or -1.
        motion: "along" the axis, or "about" it for a rotation.
    """

    node: str
    axis: int
    sign: int
    motion: Motion


def dof_of(name: str) -> Dof | None:
    """Node and direction that a channel name states; None where it states none.

    Example:
        >>> dof_of("12-X"), dof_of("flux")
        (Dof(node='12', axis=0, sign=-1, motion='along'), None)
        >>> dof_of("plate:3:+Z").node, dof_of("3RX+").motion
        ('plate:3', 'about')
    """
    text = name.strip()
    if len(text) > 200:  # names no degree of freedom
        return None
    found = _NAME.fullmatch(text)
    if found is None:
        head, _, rest = text.partition(" ")
        found = _NAME.fullmatch(head) if rest else None
        if found is None or not (found["before"] or found["after"]):
            return None
    if found["before"] and found["after"]:
        return None
    return Dof(
        node=found["node"].strip(),
        axis=_AXES.index(found["axis"].upper()),
        sign=-1 if "-" in (found["before"], found["after"]) else 1,
        motion="about" if found["turning"] else "along",
    )


def same_dof(one: str, other: str) -> bool:
    """Whether two names state one place and one direction, whatever else stands before or after it.

    Example:
        >>> same_dof("12Z+", "force 12Z+"), same_dof("12Z+", "hammer 2Z+"), same_dof("12Z+", "force 12Z-")
        (True, False, False)
    """
    stated = [{dof_of(part) for part in (name, *name.split())} - {None} for name in (one, other)]
    return bool(stated[0] & stated[1])


RESOLVED: Final = 0.05
"""Leave out singular values below this share of the largest: two directions less than 5.7 degrees apart are one."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Block:
    """Nodes (m,) that move by matrix (m, 3, k) times the readings of outputs (k,)."""

    nodes: npt.NDArray[np.intp]
    outputs: npt.NDArray[np.intp]
    matrix: FloatArray
    is_body: bool


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Motions:
    """How the nodes of a geometry follow the outputs.

    Attributes:
        n_nodes: of the geometry.
        n_outputs: of the records.
        blocks: nodes, outputs and the matrix between them.
        used: indices of the outputs that move something.
    """

    n_nodes: int
    n_outputs: int
    blocks: tuple[_Block, ...]
    used: tuple[int, ...]

    def deflection(self, shape: ComplexArray) -> ComplexArray:
        """(n_nodes, 3) motion of every node in a shape (n_outputs,).

        Raises:
            InvalidDataError: the shape has not one component an output.
        """
        values = np.asarray(shape, dtype=np.complex128)
        if values.shape != (self.n_outputs,):
            raise InvalidDataError(
                f"a shape must have one component an output, ({self.n_outputs},), but has {values.shape}."
            )
        moved = np.zeros((self.n_nodes, 3), dtype=np.complex128)
        for block in self.blocks:
            moved[block.nodes] = block.matrix @ values[block.outputs]
        return moved

    @property
    def moving(self) -> npt.NDArray[np.intp]:
        """Nodes that can move, in rising order."""
        nodes = [block.nodes for block in self.blocks]
        return np.unique(np.concatenate(nodes)) if nodes else np.zeros(0, dtype=np.intp)

    @property
    def directions_seen(self) -> dict[int, int]:
        """Number of directions, 1 to 3, that sensors see at each measured node outside rigid bodies."""
        return {
            int(block.nodes[0]): int(np.linalg.matrix_rank(block.matrix[0], tol=ROUNDED))
            for block in self.blocks
            if not block.is_body
        }


def motion_of(geometry: "Geometry", sensors: "Sequence[Sensor | None]") -> Motions:
    """Solve every node and every rigid body once, for any shape.

    Args:
        geometry: the nodes.
        sensors: one an output; None for those that are not to be used.
    """
    at: dict[int, list[int]] = {}
    for output, sensor in enumerate(sensors):
        if sensor is not None:
            at.setdefault(sensor.node, []).append(output)
    bodies = [sorted(set(body)) for body in geometry.rigid]
    in_body = {node for body in bodies for node in body}
    fixed = set(geometry.fixed)
    blocks = []
    for node in sorted(set(at) - in_body - fixed):
        seen = [(output, one) for output in at[node] if (one := sensors[output]) is not None and one.motion == "along"]
        if seen:
            directions = np.array([one.direction for _, one in seen])
            matrix = np.linalg.pinv(directions, rcond=RESOLVED)[np.newaxis]
            blocks.append(_block([node], [output for output, _ in seen], matrix, is_body=False))
    for body in bodies:
        seen = [(output, one) for node in body for output in at.get(node, ()) if (one := sensors[output]) is not None]
        if seen:
            matrix = _body_matrix(geometry.positions, body, [one for _, one in seen])
            blocks.append(_block(body, [output for output, _ in seen], matrix, is_body=True))
    used = sorted(int(output) for block in blocks for output in block.outputs)
    return Motions(n_nodes=geometry.n_nodes, n_outputs=len(sensors), blocks=tuple(blocks), used=tuple(used))


def _block(nodes: Sequence[int], outputs: Sequence[int], matrix: FloatArray, *, is_body: bool) -> _Block:
    return _Block(
        nodes=np.array(nodes, dtype=np.intp), outputs=np.array(outputs, dtype=np.intp), matrix=matrix, is_body=is_body
    )


def _body_matrix(positions: FloatArray, body: Sequence[int], sensors: "Sequence[Sensor]") -> FloatArray:
    """(n_body_nodes, 3, n_sensors); rotations are counted in units of the body's size, so that all numbers compare."""
    centre = np.mean([positions[one.node] for one in sensors], axis=0)
    arms = positions[list(body)] - centre
    size = float(np.linalg.norm(arms, axis=1).max()) or 1.0
    along = np.array([one.motion == "along" for one in sensors])
    directions = np.array([one.direction for one in sensors])
    lever = (np.array([positions[one.node] for one in sensors]) - centre) / size
    to_translation = np.where(along[:, np.newaxis], directions, 0.0)
    to_rotation = np.where(along[:, np.newaxis], np.cross(lever, directions), directions)
    gain = np.where(along, 1.0, size)  # d' r = y becomes d' (size r) = size y
    inverse = np.linalg.pinv(to_translation, rcond=RESOLVED)
    left_over = np.eye(len(sensors)) - to_translation @ inverse
    seen = left_over @ to_rotation
    # what is left of a lever after translation has taken its part is judged against the whole body, not against itself
    rotation = _inverse_above(seen, RESOLVED) @ left_over
    translation = inverse @ (np.eye(len(sensors)) - to_rotation @ rotation)
    # r x arm, as a matrix that acts on r: rows of the cross product
    turn = np.cross(np.eye(3)[np.newaxis], arms[:, np.newaxis, :] / size).transpose(0, 2, 1)
    return np.asarray((translation[np.newaxis] + turn @ rotation) * gain, dtype=np.float64)


def _inverse_above(matrix: FloatArray, least: float) -> FloatArray:
    """Pseudo-inverse without the singular values below `least`."""
    left, values, right = np.linalg.svd(matrix, full_matrices=False)
    kept = values > least
    return np.asarray((right[kept].T / values[kept]) @ left[:, kept].T, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Sensor(Displayed):
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
        direction = frozen(self.direction, name=f"the direction of sensor {quoted(self.name)}", shape=(3,))
        largest = float(np.abs(direction).max())
        if not largest > 0:
            raise InvalidDataError(
                f"sensor {quoted(self.name)} has the direction (0, 0, 0); give the way it looks, such as [1, 0, 0]."
            )
        if self.motion not in ("along", "about"):
            raise InvalidDataError(f"a sensor sees motion 'along' or 'about' its direction, but not {self.motion!r}.")
        scaled = direction / largest  # against overflow of the squares
        object.__setattr__(self, "direction", frozen(scaled / np.linalg.norm(scaled), name="direction"))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Geometry(Displayed):
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
            shape: (n_outputs,) real or complex, components that can be compared (`modal.geometry.placement` makes them
                so).
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


def quoted(name: object) -> str:
    """What a file says as it may stand in a sentence: on one line, short, in quotation marks."""
    return repr(shorten(visible(str(name)), 60))


def _check_names(names: tuple[str, ...]) -> None:
    if not names:
        raise InvalidDataError(
            "a geometry needs at least 1 node, but has none; name the nodes and give their positions."
        )
    if len(names) > GeometryLimits.MOST_NODES:
        raise InvalidDataError(
            f"a geometry may have {GeometryLimits.MOST_NODES} nodes, but has {len(names)}; keep those "
            "that carry sensors and lines."
        )
    if not all(str(name).strip() for name in names):
        raise InvalidDataError("every node needs a name of at least one visible letter; number them if they have none.")
    if len(set(names)) < len(names):
        twice = next(name for index, name in enumerate(names) if name in names[:index])
        raise InvalidDataError(f"node {quoted(twice)} is given twice; name each node once.")


def _positions(values: FloatArray, names: tuple[str, ...]) -> FloatArray:
    try:
        positions = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidDataError("positions must be numbers, three a node, in metres.") from error
    if positions.shape != (len(names), 3):
        raise InvalidDataError(
            f"positions must have shape (n_nodes, 3) = ({len(names)}, 3), but have {positions.shape}; give x, y and z."
        )
    wrong = np.flatnonzero(~(np.abs(positions) <= GeometryLimits.FURTHEST).all(axis=1))
    if wrong.size:
        shown = ", ".join(f"{value:.6g}" for value in positions[wrong[0]])
        raise InvalidDataError(
            f"coordinates must be finite and at most {GeometryLimits.FURTHEST:g} m, but node "
            f"{quoted(names[wrong[0]])} stands at "
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
    if total > GeometryLimits.MOST_PLACES:
        raise InvalidDataError(
            f"lines, surfaces and bodies may have {GeometryLimits.MOST_PLACES} places together, but "
            f"have {total}; keep fewer."
        )
    _check_indices(geometry.fixed, geometry.n_nodes, "fixed")
    held = [node for body in geometry.rigid for node in set(body)] + list(set(geometry.fixed))
    if len(set(held)) < len(held):
        twice = max(set(held), key=held.count)
        raise InvalidDataError(
            f"node {quoted(geometry.node_names[twice])} belongs to more than one rigid body, or to one and to fixed; "
            "put it into one of them."
        )


def _check_indices(nodes: Sequence[int], n_nodes: int, where: str) -> None:
    wrong = [node for node in nodes if not 0 <= node < n_nodes]
    if wrong:
        raise InvalidDataError(
            f"{where} names node index {wrong[0]}, but the geometry has indices 0 to {n_nodes - 1}; correct it."
        )


def _check_sensors(geometry: Geometry) -> None:
    if len(geometry.sensors) > GeometryLimits.MOST_SENSORS:
        raise InvalidDataError(
            f"a geometry may have {GeometryLimits.MOST_SENSORS} sensors, but has {len(geometry.sensors)}."
        )
    names: set[str] = set()
    for sensor in geometry.sensors:
        _check_indices([sensor.node], geometry.n_nodes, f"sensor {quoted(sensor.name)}")
        if sensor.name in names:
            raise InvalidDataError(
                f"channel {quoted(sensor.name)} has two sensors; a channel stands in one place, so remove one of them."
            )
        names.add(sensor.name)
