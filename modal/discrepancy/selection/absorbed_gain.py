"""A gain that a calibration takes up.

Where any linear force inside a state space is free (`internal_changes`), a wrong gain of a sensor or an input is hardly
more than another set of such forces: both explain the records. The model as given tells them apart, because with the
gain it stays where it was.
"""

from dataclasses import dataclass, replace

import numpy as np

from modal.discrepancy.fitting.estimation import Estimate, estimate, simulate_at
from modal.discrepancy.fitting.nodes import SMALLEST_GAIN, Node, Task, fitted_either_way, node_of
from modal.discrepancy.selection.smaller_models import run_without
from modal.effects.catalogue import CATALOGUE
from modal.simulation.assembly import Unknowns, place_effect
from modal.simulation.tolerances import NEAR_FLOOR
from modal.simulation.trajectory import SHARP
from modal.structure.reciprocity import INTERNAL_FORCE

__all__ = ["AbsorbedGain", "absorbed_gain"]

ITERATIONS, LONGEST = 20, 60
"""End the fit that finds a gain after the first, and one to its end after the second number of iterations."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class AbsorbedGain:
    """A gain that explains a calibration.

    Attributes:
        node: The calibrated model with it.
        without: The same without it, calibrated anew.
        fall: By how much the cost of the first is lower, the priors of the calibration included, as 2 ln L.
    """

    node: Node
    without: Node
    fall: float


def absorbed_gain(root: Node, task: Task) -> AbsorbedGain | None:
    """The one gain that explains the calibration of a model, where there is one.

    The best one; None where no internal force is free, or no gain is worth 30.
    """
    plant = root.coarse.assembly.plant
    if not any(one.name.startswith(INTERNAL_FORCE) for one in plant.parameters):
        return None
    if _moved(root) <= SMALLEST_GAIN:  # no gain saves more than the calibration has cost
        return None
    alone = _alone(root, task)
    channels = {"input_gain": plant.input_names, "sensor_gain": plant.output_names}
    found: AbsorbedGain | None = None
    for key, names in channels.items():
        for where in names if task.catalogue.get(key) is CATALOGUE[key] else ():
            one = None if (key, where) in root.effects else _with_gain(root, alone, key, where, task)
            if one is not None and one.fall > (SMALLEST_GAIN if found is None else found.fall):
                found = one
    return found


def _moved(root: Node) -> float:
    """What the calibration costs by the priors of the linear parameters."""
    assembly = root.coarse.assembly
    centre, deviation = assembly.prior()
    moved = (root.coarse.unknowns.common - centre)[: assembly.n_linear] / deviation[: assembly.n_linear]
    return float(np.sum(moved**2))


def _alone(root: Node, task: Task) -> Estimate | None:
    """The calibration as it is, fitted to its end by the noise floor of now."""
    coarse = root.coarse
    start = simulate_at(coarse.assembly, coarse.unknowns, task.fit, states=coarse.trajectory.states)
    return None if start is None else _settled(start, task)


def _with_gain(root: Node, alone: Estimate | None, key: str, where: str, task: Task) -> AbsorbedGain | None:
    """The model with a gain, from the linear parameters as given; None where it does not explain the data or save 30.

    The calibration without it is fitted from there as well, and the better way counts.
    """
    before = root.coarse.assembly
    effect = CATALOGUE[key]
    assembly = replace(before, placements=(*before.placements, place_effect(before.plant, effect, where)))
    common = np.concatenate([before.plant.nominal, root.coarse.unknowns.common[before.n_linear :], effect.neutral])
    unknowns = Unknowns(common=common, local=root.coarse.unknowns.local)
    start = simulate_at(assembly, unknowns, task.fit, states=root.coarse.trajectory.states)
    if start is None:
        return None
    node = node_of(_settled(fitted_either_way(start, task.fit, iterations=ITERATIONS), task), task)
    if alone is None or max(node.fit_level, node.held_out_level) > NEAR_FLOOR:
        return None
    if alone.cost - node.coarse.cost <= SMALLEST_GAIN:
        return None
    start = run_without(node.coarse, len(assembly.placements) - 1, task.fit, smoothing=SHARP)
    other = alone if start is None else _settled(start, task)
    rival = other if other.cost < alone.cost else alone
    return AbsorbedGain(node=node, without=node_of(rival, task), fall=rival.cost - node.coarse.cost)


def _settled(start: Estimate, task: Task) -> Estimate:
    """Fitted until an iteration gains less than 1: the valley of the internal forces is long and flat."""
    return estimate(start, task.fit, iterations=LONGEST, standstill=1.0 / max(start.cost, 1.0))
