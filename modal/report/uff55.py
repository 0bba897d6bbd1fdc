"""The modes for other programs of the field: a universal file with one dataset 55 a mode of the system.

Every dataset 55 is "data at nodes" of analysis type 3, complex eigenvalue: the pole s [1/s] and one complex vector
(x, y, z) a node. With a geometry, datasets 164 (SI units), 15 (nodes) and 82 (lines) come first, so that the file shows
the shapes by itself. Without one, nodes and directions are those that the channel names state (`12X+`); a channel whose
name states none has a node of its own and is written along X.

Shapes are scaled to a largest component of 1, not to unit modal A: that would need a driving point. Modal A and B are
written as 0, not known. Numbers have six digits, as the format has it. Readers that know normal modes only are served
by `form="normal"`: analysis type 2, the shape turned to its most real phase, the imaginary rest left out.

References:
    SDRC I-DEAS Universal File Datasets 15, 55, 82, 164, as kept by the University of Cincinnati SDRL.

Nodes of a universal file: their numbers, which outputs move them, and the datasets that describe them.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from modal.geometry.sensors import Geometry, Motions, Sensor, dof_of, motion_of
from modal.identification.result import Identification
from modal.modes.mode import Mode, numbered
from okid.arrays import ComplexArray
from okid.errors import InvalidDataError
from okid.readers.uff import DATA_TYPES

if TYPE_CHECKING:
    from modal.geometry.sensors import Geometry

_MOST_DIGITS = 9
_NODES_A_LINE = 8


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class NodePlan:
    """How the outputs move the nodes of a file.

    Attributes:
        labels: number of each node in the file.
        motions: from a shape to the motion of the nodes.
        remark: what a reader of the file must know of the nodes; "" where nothing.
    """

    labels: tuple[int, ...]
    motions: Motions
    remark: str


def node_plan(output_names: Sequence[str], geometry: Geometry | None) -> NodePlan:
    """Nodes of the geometry, or those that the names of the outputs state."""
    nodes = geometry or _named_nodes(output_names)
    motions = motion_of(nodes, nodes.sensors if geometry is None else nodes.sensors_of(output_names))
    n_outputs, n_lost = len(output_names), len(output_names) - len(motions.used)
    n_assumed = sum(dof_of(name) is None for name in output_names) if geometry is None else 0
    remarks = [f"{n_lost} of {n_outputs} outputs move no node"] if n_lost else []
    remarks += [f"direction not known for {n_assumed} of {n_outputs} outputs: written as X"] if n_assumed else []
    return NodePlan(labels=node_labels(nodes.node_names), motions=motions, remark="; ".join(remarks))


def node_labels(names: Sequence[str]) -> tuple[int, ...]:
    """A number for each node: its own where its name is one, else the next ones above.

    Example:
        >>> node_labels(["12", "tip", "3", "012"])
        (12, 13, 3, 14)
    """
    own: dict[int, str] = {}
    for name in names:
        if name.isascii() and name.isdigit() and len(name) <= _MOST_DIGITS and int(name) > 0:
            own.setdefault(int(name), name)
    by_name = {name: number for number, name in own.items()}
    following = itertools.count(max(own, default=0) + 1)
    return tuple(by_name[name] if name in by_name else next(following) for name in names)


def geometry_datasets(geometry: Geometry, plan: NodePlan) -> list[str]:
    """Datasets 164 (SI units), 15 (nodes) and 82 (one a line) of a geometry."""
    units = f"{1:10d}{'SI: Meter (newton)':20s}{2:10d}"
    factors = "".join(f"{value:25.17E}".replace("E", "D") for value in (1.0, 1.0, 1.0)) + f"\n{273.15:25.17E}"
    nodes = [
        f"{label:10d}{0:10d}{0:10d}{1:10d}" + "".join(f"{value:13.5E}" for value in position)
        for label, position in zip(plan.labels, geometry.positions + 0.0, strict=True)
    ]
    lines = [_line(number, [plan.labels[node] for node in line]) for number, line in enumerate(_lines(geometry), 1)]
    return [
        dataset(164, [units, factors.replace("E", "D")]),
        dataset(15, nodes),
        *(dataset(82, rows) for rows in lines),
    ]


def dataset(number: int, lines: Sequence[str]) -> str:
    """A dataset of a universal file between its delimiters.

    Example:
        >>> dataset(164, ["         1"]).splitlines()
        ['    -1', '   164', '         1', '    -1']
    """
    return "\n".join(["    -1", f"{number:6d}", *lines, "    -1"]) + "\n"


def _lines(geometry: Geometry) -> list[tuple[int, ...]]:
    """Lines, and the closed outline of each surface."""
    return [*geometry.lines, *((*surface, surface[0]) for surface in geometry.surfaces)]


def _line(number: int, labels: Sequence[int]) -> list[str]:
    rows = [f"{number:10d}{len(labels):10d}{8:10d}", f"line {number}"]
    starts = range(0, len(labels), _NODES_A_LINE)
    return rows + ["".join(f"{label:10d}" for label in labels[start : start + _NODES_A_LINE]) for start in starts]


def _named_nodes(output_names: Sequence[str]) -> Geometry:
    """Nodes as the names state them, all in one place: where they stand is not known and is not written."""
    names: list[str] = []
    sensors = []
    for number, name in enumerate(output_names, start=1):
        dof = dof_of(name)
        node = dof.node if dof is not None else f"output {number} {name}"
        if node not in names:
            names.append(node)
        direction = np.eye(3)[0] if dof is None else dof.sign * np.eye(3)[dof.axis]
        motion = "along" if dof is None else dof.motion
        sensors.append(Sensor(name=name, node=names.index(node), direction=direction, motion=motion))
    return Geometry(node_names=tuple(names), positions=np.zeros((len(names), 3)), sensors=tuple(sensors))


Form = Literal["complex", "normal"]

_DERIVATIVES = {"m": 0, "m/s": 1, "m/s^2": 2}
"""Write these units by the data type of their motion; every other one is 0, unknown."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Quantity:
    """What the components of the shapes are.

    Attributes:
        data_type: specific data type of record 6.
        derivatives: one an output: by how many powers of the pole its component is divided.
    """

    data_type: int
    derivatives: tuple[int, ...]


def uff55_text(result: Identification, geometry: "Geometry | None" = None, *, form: Form = "complex") -> str:
    """The modes of the system as a universal file; nodes and lines come first where a geometry is given.

    Args:
        result: of `modal.identify`.
        geometry: nodes, lines and sensors; None: nodes and directions as the channel names state them.
        form: "complex" shapes and poles, or "normal" ones: real shapes, frequency and damping ratio.

    Returns:
        ASCII text. Without a mode of the system it holds the geometry at most.

    Raises:
        InvalidDataError: another form.
    """
    if form not in get_args(Form):
        raise InvalidDataError(f"form must be complex or normal, but is {form!r}.")
    record = result.channels
    plan = node_plan(record.output_names, geometry)
    quantity = _quantity(record.output_units)
    parts = [] if geometry is None else geometry_datasets(geometry, plan)
    for number, mode in numbered(result.modes):
        if mode.verdict == "system":
            parts.append(_mode(mode, number, plan=plan, quantity=quantity, record=record.name, form=form))
    return "".join(parts)


def real_shape(shape: ComplexArray) -> ComplexArray:
    r"""A complex shape turned so that the sum of squares of its imaginary parts is least; its real part is kept.

    The angle is half that of sum_k shape_k^2: turned by it, Im sum shape^2 = 0 and Re sum shape^2 is greatest.

    Example:
        >>> real_shape(np.array([1j, -0.5j])).real.round(12).tolist()
        [1.0, -0.5]
    """
    turned = shape * np.exp(-0.5j * np.angle(np.sum(shape**2)))
    largest = turned[int(np.argmax(np.abs(turned)))] if turned.size else 1.0
    return np.asarray(turned.real * (np.sign(largest.real) or 1.0), dtype=np.complex128)


def _quantity(units: Sequence[str]) -> _Quantity:
    """One unit stays as it is; a mixture of motions becomes displacement, any other mixture is written as it is."""
    if len(set(units)) == 1:
        known = DATA_TYPES[units[0]] if units[0] in _DERIVATIVES else 0
        return _Quantity(data_type=known, derivatives=(0,) * len(units))
    if all(unit in _DERIVATIVES for unit in units):
        return _Quantity(data_type=8, derivatives=tuple(_DERIVATIVES[unit] for unit in units))
    return _Quantity(data_type=0, derivatives=(0,) * len(units))


def _mode(mode: Mode, number: int, *, plan: NodePlan, quantity: _Quantity, record: str, form: Form) -> str:
    shape = _largest_one(mode.shape / mode.pole ** np.array(quantity.derivatives))
    shape = real_shape(shape) if form == "normal" else shape
    moved = plan.motions.deflection(shape)
    frequency = f"{mode.frequency:.6g} Hz, damping {100 * mode.damping_ratio:.4g} %"
    lines = [
        _text(f"okid-modal, record {record}" if record else "okid-modal"),
        _text(f"mode {number}: {frequency}"),
        "NONE",
        _text(plan.remark or "NONE"),
        f"Mode no. {number:10d} frequency {mode.frequency:13.5E}",
    ]
    if form == "complex":
        lines += [_integers(1, 3, 2, quantity.data_type, 5, 3), _integers(2, 6, 1, number)]
        lines.append(_reals([mode.pole.real, mode.pole.imag, 0.0, 0.0, 0.0, 0.0]))
    else:
        lines += [_integers(1, 2, 2, quantity.data_type, 2, 3), _integers(2, 4, 1, number)]
        lines.append(_reals([mode.frequency, 0.0, mode.damping_ratio, 0.0]))
    for node in plan.motions.moving:
        values = moved[node] + 0.0  # no negative zero
        both = [part for value in values for part in (value.real, value.imag)]
        lines += [_integers(plan.labels[node]), _reals(both if form == "complex" else values.real)]
    return dataset(55, lines)


def _largest_one(shape: ComplexArray) -> ComplexArray:
    largest = shape[int(np.argmax(np.abs(shape)))] if shape.size else 0.0
    return shape / largest if largest else shape


def _integers(*values: int) -> str:
    return "".join(f"{value:10d}" for value in values)


def _reals(values: Sequence[float]) -> str:
    return "".join(f"{value:13.5E}" for value in values)


def _text(words: str) -> str:
    """An ID line: at most 80 plain letters, never blank."""
    return "".join(letter if " " <= letter <= "~" else "?" for letter in words)[:80].rstrip() or "NONE"
