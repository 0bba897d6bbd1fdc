"""Nodes of a universal file: their numbers, which outputs move them, and the datasets that describe them."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modal.geometry.dof_names import dof_of
from modal.geometry.node_motion import Motions, motion_of
from modal.geometry.sensors import Geometry, Sensor

__all__ = ["NodePlan", "dataset", "geometry_datasets", "node_labels", "node_plan"]

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
    """Nodes of the geometry, or those that the names of the outputs state.

    Args:
        output_names: of the channels.
        geometry: None where there is none.
    """
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
