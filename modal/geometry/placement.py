"""Outputs on a geometry: which of them move it, on which scale, and in words which do not.

One picture needs one kind of quantity. For a mode with pole s, velocity is s and acceleration s^2 times displacement;
so outputs in m/s are divided by s and outputs in m/s^2 by s^2 where a picture holds both, and phases come out right as
well. Rotations turn rigid bodies and are never drawn as translation. What is no motion (forces, strains) is left out.

Where no geometry is known, names that count rows and columns (p11, p12, ... p34; x1y2; r1c2) and fill a whole grid are
drawn as one, and it is said that this is a guess. Names such as `12X+` still say which channels share a node and which
way they look. Then the nodes stand in a row in the order of the record, along an axis in which nothing was measured if
there is one: upright like a tower for motion in X and Y, lying like a beam for motion in Z. Otherwise every output has
a place of its own in the order of the record and moves up and down; outputs of different units cannot share one scale,
so each unit has a line of its own, one behind the other. Between two sensors a line is straight: nothing was measured
there.
"""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from modal.geometry.sensors import Dof, Geometry, Motions, Sensor, dof_of, motion_of
from modal.modes.mode import Mode
from modal.wording.text import shorten
from okid.arrays import ComplexArray, FloatArray
from okid.errors import InvalidDataError, visible
from okid.readers.units import convert_unit

_UP: Final = (0.0, 0.0, 1.0)


def stick_geometry(output_names: Sequence[str], output_units: Sequence[str] = ()) -> Geometry:
    """Nodes in a row, with one sensor an output.

    Args:
        output_names: of the channels.
        output_units: of the channels; all alike unless given.

    Example:
        >>> stick_geometry(["1X+", "1Y+", "2X+", "2Y+"]).positions.tolist()
        [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]
        >>> stick_geometry(["left", "right"]).positions.tolist()
        [[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
    """
    if dofs := stated_dofs(output_names):
        return _named(output_names, dofs)
    return _unnamed(output_names, output_units or [""] * len(output_names))


_PAIR: Final = re.compile(
    r"(?P<what>\D*)(?:(?P<a>\d)(?P<b>\d)|(?P<first>\d{1,3})(?P<between>\D+)(?P<second>\d{1,3}))\D*"
)
FULL_COUNT: Final = 10
"""Names that use all ten last digits count channels, not columns."""


def guessed_grid(output_names: Sequence[str], output_units: Sequence[str] = ()) -> Geometry | None:
    """A plane of sensors that look up, where the names count its rows and columns; None where they do not.

    Every place of the grid must have one name, both counts begin alike, and the outputs have one unit.

    Example:
        >>> grid = guessed_grid(["p11", "p12", "p21", "p22"])
        >>> grid.positions[:, :2].tolist(), len(grid.lines)
        ([[-1.0, 1.0], [1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]], 4)
        >>> guessed_grid(["ch01", "ch02", "ch03"]) is None, guessed_grid(["p11", "p12", "p21"]) is None
        (True, True)
    """
    found = [_PAIR.fullmatch(name.strip()[: 2 * FULL_COUNT]) for name in output_names]
    known = [one for one in found if one is not None]
    if not known or len(known) < len(found) or len(set(output_units)) > 1 or stated_dofs(output_names):
        return None
    if len({(one["what"], one["between"]) for one in known}) > 1:
        return None
    places = np.array([[int(one["a"] or one["first"]), int(one["b"] or one["second"])] for one in known])
    start, size = int(places.min()), np.ptp(places, axis=0) + 1
    whole = {(start + i, start + j) for i in range(size[0]) for j in range(size[1])}
    if start > 1 or min(size) < 2 or max(size) >= FULL_COUNT or sorted(map(tuple, places.tolist())) != sorted(whole):
        return None
    count = places - start
    across, up = (0, 1) if known[0]["what"][-1:].lower() == "x" else (1, 0)
    scale = 2.0 / (max(size) - 1)
    plane = scale * (count[:, (across, up)] - 0.5 * (size[[across, up]] - 1))
    plane[:, 1] *= 1.0 if across == 0 else -1.0  # rows are counted from the top
    number = {(i, j): k for k, (i, j) in enumerate(count.tolist())}
    lines = [tuple(number[i, j] for j in range(size[1])) for i in range(size[0])]
    lines += [tuple(number[i, j] for i in range(size[0])) for j in range(size[1])]
    return Geometry(
        node_names=tuple(output_names),
        positions=np.column_stack([plane, np.zeros(len(plane))]),
        lines=tuple(lines),
        sensors=tuple(Sensor(name=name, node=k, direction=np.array(_UP)) for k, name in enumerate(output_names)),
    )


def stated_dofs(output_names: Sequence[str]) -> tuple[Dof, ...]:
    """Node and direction of every output, where every name states them and there are several nodes; else nothing."""
    found = [dof_of(name) for name in output_names]
    known = tuple(dof for dof in found if dof is not None)
    return known if len(known) == len(found) and len({dof.node for dof in known}) > 1 else ()


def rows_by_unit(units: Sequence[str]) -> tuple[tuple[int, ...], ...]:
    """Outputs of each unit, in the order in which units first appear.

    Example:
        >>> rows_by_unit(["m", "rad", "m"])
        ((0, 2), (1,))
    """
    return tuple(tuple(i for i, unit in enumerate(units) if unit == kind) for kind in dict.fromkeys(units))


def _visible_names(names: Sequence[str]) -> tuple[str, ...]:
    """The names of the outputs; a channel whose name shows nothing is a node with a number."""
    made: list[str] = []
    for number, name in enumerate(names, start=1):
        shown = name if name.strip() else f"unnamed {number}"
        while shown != name and shown in names:
            shown += "'"
        made.append(shown)
    return tuple(made)


def _named(names: Sequence[str], dofs: Sequence[Dof]) -> Geometry:
    nodes = tuple(dict.fromkeys(dof.node for dof in dofs))
    seen = [sum(dof.axis == axis and dof.motion == "along" for dof in dofs) for axis in range(3)]
    # along Z where nothing moves in Z, else along X, else along Y, else along the axis with the fewest sensors
    axis = min((2, 0, 1), key=lambda one: seen[one])
    if seen[0] == seen[1] == 0:
        axis = 0
    positions = np.zeros((len(nodes), 3))
    positions[:, axis] = np.linspace(-1.0, 1.0, len(nodes))
    sensors = tuple(
        Sensor(name=name, node=nodes.index(dof.node), direction=dof.sign * np.eye(3)[dof.axis], motion=dof.motion)
        for name, dof in zip(names, dofs, strict=True)
    )
    return Geometry(node_names=nodes, positions=positions, lines=(tuple(range(len(nodes))),), sensors=sensors)


def _unnamed(names: Sequence[str], units: Sequence[str]) -> Geometry:
    rows = rows_by_unit(units)
    positions = np.zeros((len(names), 3))
    if len(names) > 1:
        positions[:, 0] = np.linspace(-1.0, 1.0, len(names))
    for k, row in enumerate(rows):
        positions[list(row), 1] = 0.7 * (k - (len(rows) - 1) / 2)  # a line is 2 long
    return Geometry(
        node_names=_visible_names(names),
        positions=positions,
        lines=tuple(row for row in rows if len(row) > 1),
        sensors=tuple(Sensor(name=name, node=node, direction=np.array(_UP)) for node, name in enumerate(names)),
    )


TRANSLATION: Final = {"m": 0, "m/s": 1, "m/s^2": 2}
ROTATION: Final = {"rad": 0, "rad/s": 1, "rad/s^2": 2}
"""Number of times that each unit of motion is derived by time."""

LISTED: Final = 8
"""List so many names in a sentence and count the others."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Placement:
    """Outputs on a geometry.

    Attributes:
        geometry: the nodes; sticks where none was given.
        is_given: whether the geometry was given.
        sensors: one an output, None for those that have no place or are not drawn.
        motions: how nodes follow the outputs.
        scales: outputs that share a scale, each of which has its own largest 1: all of them on a given geometry.
        factors: (n_outputs,) SI units in one unit of each output.
        derivatives: (n_outputs,) times that each output is derived by time, all 0 where they need not be compared.
        sentences: what is not drawn and why, and what was compared how.
    """

    geometry: Geometry
    is_given: bool
    sensors: tuple[Sensor | None, ...]
    motions: Motions
    scales: tuple[tuple[int, ...], ...]
    factors: FloatArray
    derivatives: tuple[int, ...]
    sentences: tuple[str, ...]

    def deflection(self, mode: Mode) -> ComplexArray:
        """(n_nodes, 3) motion of every node in a mode, largest 1 on every scale, turned to its best real phase.

        The output with the largest component in the mode's own numbers reads positive.
        """
        divisor = np.array([mode.pole**power if mode.pole else 1.0 for power in self.derivatives])
        values = mode.shape * self.factors / divisor
        moved = np.zeros((self.geometry.n_nodes, 3), dtype=np.complex128)
        for scale in self.scales:
            part = np.zeros_like(values)
            part[list(scale)] = values[list(scale)]
            of_scale = self.motions.deflection(part)
            largest = float(np.linalg.norm(of_scale, axis=1).max())
            if largest > 0:
                moved += of_scale / largest
        used = list(self.motions.used)
        if not used:
            return moved
        turn = np.exp(-1j * best_phase(moved))
        strongest = complex(values[used[int(np.abs(mode.shape[used]).argmax())]])
        return np.asarray(moved * (-turn if (strongest * turn).real < 0 else turn), dtype=np.complex128)


def turned(shape: ComplexArray) -> ComplexArray:
    """The shape times the phase that makes its real part as large as can be, its largest component positive.

    Example:
        >>> turned(np.array([1j, -2j])).round(12).real.tolist()
        [-1.0, 2.0]
    """
    result = shape * np.exp(-1j * best_phase(shape))
    if result.size and result.ravel()[np.abs(result).argmax()].real < 0:
        result = -result
    return np.asarray(result, dtype=np.complex128)


def best_phase(shape: ComplexArray) -> float:
    """The angle [rad] of the line through 0 that fits the components of a shape best; up to half a turn.

    Motion on circles has no such line; then it is the phase of the largest component.
    """
    squares = complex(np.sum(shape**2))
    total = float(np.sum(np.abs(shape) ** 2))
    if abs(squares) > 1e-6 * total:
        return float(0.5 * np.angle(squares))
    return float(np.angle(shape.ravel()[np.abs(shape).argmax()])) if shape.size else 0.0


def derivatives_of(output_units: Sequence[str]) -> tuple[int, ...]:
    """Powers of the pole by which outputs are divided to be compared: 0 for all where they have one unit.

    Example:
        >>> derivatives_of(["m", "m/s^2"]), derivatives_of(["m/s^2", "m/s^2"])
        ((0, 2), (0, 0))
    """
    orders = {**TRANSLATION, **ROTATION}
    found = tuple(orders.get(unit, 0) for unit in output_units)
    known = {orders[unit] for unit in output_units if unit in orders}
    return found if len(known) > 1 else (0,) * len(found)


def placed(geometry: Geometry | None, output_names: Sequence[str], output_units: Sequence[str] = ()) -> Placement:
    """Put outputs onto a geometry, or in a row where there is none.

    Raises:
        InvalidDataError: a geometry was given, and no output has a place in it.

    Example:
        >>> line = Geometry(node_names=("1", "2"), positions=[[0, 0, 0], [0, 0, 3]])
        >>> placed(line, ["2X+", "force"]).sentences[0]
        'Without a place in the geometry, so not drawn: force.'
    """
    units = list(output_units) or [""] * len(output_names)
    if geometry is None:
        return _row(output_names, units)
    sensors = geometry.sensors_of(output_names)
    if not any(sensors):
        raise InvalidDataError(
            f"none of the {len(sensors)} outputs ({_listed(output_names)}) has a place in the geometry, whose nodes "
            f'are {_listed(geometry.node_names)}; give their places under [sensors], such as tip = "'
            f'{shorten(visible(geometry.node_names[-1]), 20)}X+".'
        )
    return _on(geometry, sensors, output_names, units, is_given=True)


def at_rest(geometry: Geometry) -> Placement:
    """The geometry alone, without an output."""
    return Placement(
        geometry=geometry,
        is_given=True,
        sensors=(),
        motions=motion_of(geometry, ()),
        scales=(),
        factors=np.zeros(0),
        derivatives=(),
        sentences=(),
    )


def _row(names: Sequence[str], units: Sequence[str]) -> Placement:
    grid = guessed_grid(names, units)
    geometry = stick_geometry(names, units) if grid is None else grid
    if stated_dofs(names):
        found = _on(geometry, geometry.sensors_of(names), names, units, is_given=False)
        words = "No geometry is given: the nodes that the names of the outputs state stand in a row, in their order."
        return replace(found, sentences=(words, *found.sentences))
    rows = rows_by_unit(units)
    words = "No geometry is given: the sensors stand in a row, in the order of the record."
    if grid is not None:
        words = "No geometry is given: the grid is guessed from the names of the outputs, evenly spaced."
    if len(rows) > 1:
        words += " The outputs have different units: each unit has a line of its own, scaled to its own largest."
    sensors = geometry.sensors_of(names)
    return Placement(
        geometry=geometry,
        is_given=False,
        sensors=sensors,
        motions=motion_of(geometry, sensors),
        scales=rows,
        factors=np.ones(len(names)),
        derivatives=(0,) * len(names),
        sentences=(words,),
    )


def _on(
    geometry: Geometry, sensors: Sequence[Sensor | None], names: Sequence[str], units: Sequence[str], *, is_given: bool
) -> Placement:
    kept, factors, derivatives, words = _comparable(sensors, names, units)
    motions = motion_of(geometry, kept)
    everything = [i for i, one in enumerate(sensors) if one is None]
    sentences = (
        [f"Without a place in the geometry, so not drawn: {_names_of(everything, names)}."] if everything else []
    )
    used = set(motions.used)
    idle = [i for i, one in enumerate(kept) if one is not None and i not in used]
    turning = [i for i in idle if (one := kept[i]) is not None and one.motion == "about"]
    if turning:
        sentences.append(
            f"Rotations are not drawn as translations, and these turn no rigid body: {_names_of(turning, names)}."
        )
    if held := [i for i in idle if i not in turning]:
        sentences.append(f"At nodes that the geometry calls fixed, so not drawn: {_names_of(held, names)}.")
    sentences += words + _still(geometry, motions)
    return Placement(
        geometry=geometry,
        is_given=is_given,
        sensors=tuple(one if i in used else None for i, one in enumerate(kept)),
        motions=motions,
        scales=(tuple(range(len(names))),),
        factors=factors,
        derivatives=derivatives,
        sentences=tuple(sentences),
    )


def _comparable(
    sensors: Sequence[Sensor | None], names: Sequence[str], units: Sequence[str]
) -> tuple[list[Sensor | None], FloatArray, tuple[int, ...], list[str]]:
    """Sensors of one kind of quantity, the factors and derivatives that make them comparable, and words."""
    placed_ones = [i for i, one in enumerate(sensors) if one is not None]
    known = [convert_unit(names[i], units[i]) if units[i] else None for i in range(len(names))]
    si = ["" if one is None else one.unit for one in known]
    factors = np.array([1.0 if one is None else one.factor for one in known])
    kept: list[Sensor | None] = [None] * len(names)
    moving = [i for i in placed_ones if si[i] in TRANSLATION and _along(sensors[i])]
    turning = [i for i in placed_ones if si[i] in ROTATION]
    words: list[str] = []
    if moving or turning:
        drawn = moving + turning
    else:  # nothing in a unit of motion: the most common unit is drawn as if it were one
        counts = Counter(si[i] for i in placed_ones)
        common = counts.most_common(1)[0][0] if counts else ""
        drawn = [i for i in placed_ones if si[i] == common]
        words += [f"{_unit_words(common)} drawn as if it were motion along the sensors."] if drawn else []
    for i in drawn:
        sensor = sensors[i]
        kept[i] = replace(sensor, motion="about") if sensor is not None and i in turning else sensor
    orders = {**TRANSLATION, **ROTATION}
    derivatives = tuple(orders.get(si[i], 0) if i in drawn else 0 for i in range(len(names)))
    if len({derivatives[i] for i in drawn}) > 1:
        words.append(
            "Velocities are divided by the pole and accelerations by its square, so one picture shows displacements."
        )
    else:
        derivatives = (0,) * len(names)
    if left := [i for i in placed_ones if i not in drawn]:
        words.append(f"Not in a unit of the motion that is drawn, so left out: {_names_of(left, names)}.")
    return kept, factors, derivatives, words


def _along(sensor: Sensor | None) -> bool:
    return sensor is not None and sensor.motion == "along"


def _unit_words(unit: str) -> str:
    return (
        f"The unit {shorten(visible(unit), 20)} is none of motion; it is"
        if unit
        else "The outputs have no unit and are"
    )


def _still(geometry: Geometry, motions: Motions) -> list[str]:
    """What is drawn at rest because nothing is known of it."""
    words = []
    known = set(motions.moving.tolist()) | set(geometry.fixed)
    unseen = [node for node in range(geometry.n_nodes) if node not in known]
    if unseen:
        count = f"{len(unseen)} of {geometry.n_nodes} nodes" if geometry.n_nodes > 1 else "The node"
        words.append(f"Without a sensor, so drawn at rest: {count} ({_names_of(unseen, geometry.node_names)}).")
    bodies = [len(block.nodes) for block in motions.blocks if block.is_body]
    if bodies:
        words.append(
            f"The geometry declares rigid bodies: {sum(bodies)} nodes of {len(bodies)} "
            f"bod{'ies' if len(bodies) > 1 else 'y'} move as a whole, by as little rotation as the sensors allow."
        )
    seen = Counter(motions.directions_seen.values())
    if partly := [(count, seen[count]) for count in (1, 2) if seen[count]]:
        parts = " and ".join(f"{n} in {'one direction' if count == 1 else 'two directions'}" for count, n in partly)
        words.append(f"Nodes with sensors: {parts}; across these their motion is not known and drawn as none.")
    return words


def _names_of(indices: Sequence[int], names: Sequence[str]) -> str:
    return _listed([names[i] for i in indices])


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(shorten(visible(name), 24) for name in names[:LISTED])
    return shown + (f" and {len(names) - LISTED} more" if len(names) > LISTED else "")
