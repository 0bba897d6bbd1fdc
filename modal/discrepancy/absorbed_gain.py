"""A gain that a free calibration has taken up: the records do not tell, but how far the model had to move does.

Where any linear force inside a state space is free (`internal_changes`), a wrong gain of a sensor or an input is hardly
more than another set of such forces: both explain the records. The model as given tells them apart, because with the
gain it stays where it was.
"""

from dataclasses import replace

import numpy as np

from modal.discrepancy.assembly import Unknowns, place
from modal.discrepancy.calibration import fitted_either_way
from modal.discrepancy.estimation import Estimate, estimate, simulate_at
from modal.discrepancy.internal_changes import INTERNAL_FORCE
from modal.discrepancy.nodes import SMALLEST_GAIN, Node, Task, node_of

__all__ = ["absorbed_gain"]

ITERATIONS = 20
EXPLAINED = 1.5
"""Held-out mean square, in units of the floor, up to which the model with the gain explains the data."""


def absorbed_gain(root: Node, task: Task) -> tuple[Node, float] | None:
    """The calibrated model with the one gain that explains its calibration, where there is one.

    Args:
        root: The calibrated model; it explains the data.
        task: Records, catalogue.

    Returns:
        The model, and by how much its cost, the prior of the calibration included, is lower than without the gain (as
        2 ln L); None where no internal force is free, or no gain is worth 30.
    """
    if not any(one.name.startswith(INTERNAL_FORCE) for one in root.coarse.assembly.plant.parameters):
        return None
    if _moved(root) <= SMALLEST_GAIN:  # no gain saves more than the calibration has cost
        return None
    alone = _again(root, task)
    if alone is None:
        return None
    plant = root.coarse.assembly.plant
    channels = {"input_gain": plant.input_names, "sensor_gain": plant.output_names}
    found: tuple[Node, float] | None = None
    for key, names in channels.items():
        for where in names if key in task.catalogue else ():
            node = _with_gain(root, key, where, task)
            fall = -np.inf if node is None else alone.cost - node.coarse.cost
            if node is not None and fall > (SMALLEST_GAIN if found is None else found[1]):
                found = node, float(fall)
    return found


def _again(root: Node, task: Task) -> Estimate | None:
    """The calibrated model by the noise floor of now, which may be a lower one than it was fitted by."""
    coarse = root.coarse
    start = simulate_at(coarse.assembly, coarse.unknowns, task.fit, states=coarse.trajectory.states)
    return None if start is None else estimate(start, task.fit, iterations=ITERATIONS)


def _moved(root: Node) -> float:
    """What the calibration costs by the priors of the linear parameters."""
    assembly = root.coarse.assembly
    centre, deviation = assembly.prior()
    moved = (root.coarse.unknowns.common - centre)[: assembly.n_linear] / deviation[: assembly.n_linear]
    return float(np.sum(moved**2))


def _with_gain(root: Node, key: str, where: str, task: Task) -> Node | None:
    """The model with a gain, fitted from the linear parameters as given; None where it does not explain the data."""
    before = root.coarse.assembly
    effect = task.catalogue[key]
    assembly = replace(before, placements=(*before.placements, place(before.plant, effect, where)))
    common = np.concatenate([before.plant.nominal, root.coarse.unknowns.common[before.n_linear :], effect.neutral])
    unknowns = Unknowns(common=common, local=root.coarse.unknowns.local)
    start = simulate_at(assembly, unknowns, task.fit, states=root.coarse.trajectory.states)
    if start is None:
        return None
    node = node_of(fitted_either_way(start, task.fit, iterations=ITERATIONS), task)
    return node if max(node.fit_level, node.held_out_level) <= EXPLAINED else None
