"""A picture where no geometry is known: the sensors in a row.

Names such as `12X+` still say which channels share a node and which way they look. Then the nodes stand in a row in the
order of the record, along an axis in which nothing was measured if there is one: upright like a tower for motion in X
and Y, lying like a beam for motion in Z. Otherwise every output has a place of its own in the order of the record and
moves up and down; outputs of different units cannot share one scale, so each unit has a line of its own, one behind the
other. Between two sensors a line is straight: nothing was measured there.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from modal.geometry.dof_names import Dof, dof_of
from modal.geometry.sensors import Geometry, Sensor

__all__ = ["SPACING", "rows_by_unit", "stated_dofs", "stick_geometry"]

SPACING: Final = 0.7
"""Between the lines of two units; a line is 2 long."""

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
        positions[list(row), 1] = SPACING * (k - (len(rows) - 1) / 2)
    return Geometry(
        node_names=_visible_names(names),
        positions=positions,
        lines=tuple(row for row in rows if len(row) > 1),
        sensors=tuple(Sensor(name=name, node=node, direction=np.array(_UP)) for node, name in enumerate(names)),
    )
