"""Masses that may be wrong: a rival of every gain, absorber and missing mode, of as many numbers as masses are off.

A mass is right until the calibration without it does not explain the records; then all are released at once, and those
that the records do not ask for go back to what the model says (Schwarz 1978: ln n a number).
"""

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from modal.discrepancy.fitting.estimation import Estimate, covariance, simulate_at
from modal.discrepancy.fitting.nodes import Node, Task, fitted_either_way, node_of, polished
from modal.simulation.assembly import Unknowns
from modal.simulation.plant import released_masses, with_masses
from modal.simulation.tolerances import NEAR_FLOOR
from okid.arrays import FloatArray

__all__ = ["needed_masses", "with_released_masses"]

ITERATIONS = 12
"""End the fit of a model with other masses after so many iterations, as a calibration."""


def with_released_masses(node: Node, task: Task) -> Node | None:
    """The model with all its masses free, and only those that it needs where it explains the records.

    None where no mass may be wrong, or the model cannot be simulated so.
    """
    coarse = node.coarse
    names = [one.parameter.name for one in coarse.assembly.plant.masses]
    if not names:
        return None
    # a calibration without the masses has bent the stiffnesses: alone it starts from the model as given
    linear = None if node.effects else coarse.assembly.plant.nominal
    start = _rebuilt(coarse, (*released_masses(coarse.assembly.plant), *names), task, linear=linear)
    if start is None:
        return None
    found = node_of(fitted_either_way(start, task.fit, iterations=ITERATIONS), task)
    return needed_masses(found, task) if found.held_out_level <= NEAR_FLOOR else found


def needed_masses(node: Node, task: Task) -> Node:
    """The model with masses held again that the records do not ask for."""
    price = float(np.log(task.fit.drive.present.sum() + task.held_out.drive.present.sum()))
    while node.masses:
        assembly = node.coarse.assembly
        names = [one.name for one in assembly.plant.parameters]
        index = [names.index(name) for name in node.masses]
        spread = np.sqrt(np.diag(covariance(node.coarse, task.fit))[index])
        moved = np.abs(node.coarse.unknowns.common[index] - assembly.plant.nominal[index])
        sure = moved / np.where(spread > 0.0, spread, np.inf)
        weak = [name for name, z in zip(node.masses, sure, strict=True) if z**2 < price]
        smaller = _smaller(node, set(node.masses) - set(weak), task) if weak else None
        if smaller is None or smaller.coarse.cost > node.coarse.cost + price * len(weak):
            weak = [node.masses[int(np.argmin(sure))]]
            smaller = _smaller(node, set(node.masses) - set(weak), task)
        if smaller is None or smaller.coarse.cost > node.coarse.cost + price * len(weak):
            break
        node = smaller
    return polished(node, task)


def _smaller(node: Node, kept: Collection[str], task: Task) -> Node | None:
    start = _rebuilt(node.coarse, kept, task)
    return None if start is None else node_of(fitted_either_way(start, task.fit, iterations=ITERATIONS), task)


def _rebuilt(
    coarse: Estimate, masses: Collection[str], task: Task, *, linear: FloatArray | None = None
) -> Estimate | None:
    """The model with just these masses among its linear parameters, others at their nominal values."""
    before = coarse.assembly
    plant = with_masses(before.plant, masses)
    values = dict(zip([one.name for one in before.plant.parameters], coarse.unknowns.common, strict=False))
    if linear is not None:
        values |= dict(zip([one.name for one in before.plant.parameters], linear, strict=True))
    common = [values.get(one.name, one.nominal) for one in plant.parameters]
    assembly = replace(before, plant=plant)
    unknowns = Unknowns(
        common=np.concatenate([common, coarse.unknowns.common[before.n_linear :]]), local=coarse.unknowns.local
    )
    return simulate_at(assembly, unknowns, task.fit, states=coarse.trajectory.states, smoothing=coarse.smoothing)
