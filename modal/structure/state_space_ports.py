"""The places of a state space at which a force can act: its outputs, and the differences of two of them.

The direction in which a force at a place changes the states is one number a place where the structure is known and all
of it is measured: along the sensor, by reciprocity. Elsewhere a port has several columns: the first gives the
displacement there an acceleration of -1 (the force opposes motion), the others add what a force at that place may do
elsewhere and give it none.
"""

from typing import Literal

import numpy as np
import scipy

from modal.simulation.plant import Port
from modal.simulation.tolerances import ROUNDING
from modal.structure.continuous_time import ContinuousSystem
from modal.structure.motion_rows import OutputMotion
from modal.structure.tank_levels import is_length, tank_levels
from okid.arrays import FloatArray

__all__ = ["ports_of"]

_MOST_PAIRED = 12
"""Outputs up to which every pair is a place; beyond, only neighbours in the order of the outputs are."""

_ACCEPTS = {
    "mechanical": frozenset({"motion", "force", "mass"}),
    "shaft": frozenset({"motion", "force"}),
    "flow": frozenset({"flow", "force"}),
}


def ports_of(
    system: ContinuousSystem,
    motions: tuple[OutputMotion, ...],
    names: tuple[str, ...],
    *,
    forces: FloatArray,
    directions: Literal["along_sensors", "any"],
) -> tuple[tuple[Port, ...], FloatArray, FloatArray]:
    """The ports with their E and G.

    Args:
        system: In real modal form.
        motions: What the outputs show.
        names: Of the outputs.
        forces: (n_states, n_forces) directions of the states in which forces can act; orthonormal, or those of unit
            forces on modes of unit mass, for then the shortest one that moves a place is that along its sensor.
        directions: "along_sensors": a force at a place has that direction; "any": any of them.

    Returns:
        The ports, E (n_states, n_columns) and G (n_outputs, n_columns).
    """
    n_states = len(system.A)
    levels = tank_levels(system, motions, names)
    places = [(name, one, _accepted(one, levels)) for name, one in zip(names, motions, strict=True)]
    for i, j in _pairs(motions):
        # an absorber hangs on one place; between two its force would have nothing to stand on
        places.append((f"{names[i]}-{names[j]}", motions[i].less(motions[j]), _accepted(motions[i], levels) - {"mass"}))
    places += [(name, one, frozenset({"flow"})) for name, one in levels]
    ports: list[Port] = []
    columns: list[FloatArray] = [np.zeros((n_states, 0))]
    n_columns = 0
    for name, motion, accepts in places:
        found = _opposing(np.eye(n_states) if motion.nature == "flow" else forces, motion.driven)
        if found is not None and directions == "along_sensors":
            found = found[:, :1]
        if found is not None:
            columns.append(found)
            ports.append(
                Port(
                    name=name,
                    displacement=motion.displacement,
                    velocity=motion.velocity,
                    columns=tuple(range(n_columns, n_columns + found.shape[1])),
                    stiffness=_static_stiffness(system.A, motion, found[:, 0]),
                    mass=1.0 if motion.nature == "mechanical" else None,
                    length_unit=motion.unit,
                    force_unit=motion.force_unit,
                    accepts=accepts,
                )
            )
            n_columns += found.shape[1]
    entering = np.hstack(columns)
    return tuple(ports), entering, np.array([motion.direct for motion in motions]) @ entering


def _accepted(motion: OutputMotion, levels: tuple[tuple[str, OutputMotion], ...]) -> frozenset[str]:
    """What may act where an output is; where it may be a level and its unit is no length, no mechanical law may."""
    if motion.nature == "mechanical" and levels and not is_length(motion.unit):
        return frozenset({"force"})
    return _ACCEPTS[motion.nature]


def _opposing(free: FloatArray, driven: FloatArray) -> FloatArray | None:
    """Columns of E for a force at a place, None where none of the free directions moves it.

    The first is the shortest direction e with driven e = -1; the others, of its length, have driven e = 0.
    """
    moves = free.T @ driven
    size = float(np.linalg.norm(moves))
    if size <= 1e-8 * float(np.linalg.norm(driven)) or size == 0:
        return None
    first = -moves / size**2
    others = scipy.linalg.null_space(moves[None] / size) / size
    return free @ np.hstack([first[:, None], others])


def _static_stiffness(A: FloatArray, motion: OutputMotion, opposing: FloatArray) -> float | None:
    """Constant force by the displacement that it gives at the place, per effective mass; k / m for one DOF."""
    if motion.nature != "mechanical" or motion.displacement is None or np.linalg.cond(A) > 1 / ROUNDING:
        return None
    compliance = float(motion.displacement[: len(A)] @ np.linalg.solve(A, opposing))
    return 1 / compliance if compliance > 0 else None


def _pairs(motions: tuple[OutputMotion, ...]) -> list[tuple[int, int]]:
    reach = len(motions) if len(motions) <= _MOST_PAIRED else 1
    return [
        (i, j)
        for i, first in enumerate(motions)
        for j, second in enumerate(motions[: i + reach + 1])
        if j > i and (first.nature, first.unit) == (second.nature, second.unit)
    ]
