"""How far the effects of a model are from none, in deviations of the noise.

An effect is none in many ways: a brim without a flow over it, at whatever limit, or a limit that no level reaches, at
whatever rate. Its distance from none cannot be that of one parameter from its neutral value: of a hard limit any large
rate does, and the deviation of the rate is as large as itself. What counts is what the effect does to the outputs. With
delta the outputs with it less those without it, in deviations of the noise, and J what all else in the model could do
instead,

    z^2 = delta' (I - J (J' J + prior)^-1 J') delta

For an effect in proportion to one parameter this is the parameter over its standard deviation (Wald's test); it is the
same however the parameters are chosen; and z^2 is what 2 ln L would lose at first order without the effect. The
effect's own shapes count as what could be done instead, as in Wald's test, its amplitudes do not; of an effect that has
no amplitude (a delay, the limit of a drive) nothing of its own does.
"""

import numpy as np
import scipy

from modal.discrepancy.fitting.estimation import Estimate, Problem, score_equations, sensitivity_of, weights_along
from modal.discrepancy.fitting.nodes import Node, Task
from modal.discrepancy.selection.covariance import held_unknowns
from modal.discrepancy.selection.smaller_models import run_without
from modal.simulation.assembly import Assembly
from modal.simulation.sensitivity import Sensitivity
from okid.arrays import TINY, FloatArray

__all__ = ["sureness"]


def sureness(node: Node, task: Task) -> list[float]:
    """How many deviations each effect of a model is from none.

    Args:
        node: A fitted model.
        task: Records.

    Returns:
        One number an effect; infinite where the model without it escapes.
    """
    current, problem = node.coarse, task.fit
    slopes = sensitivity_of(current, problem)
    gram, _ = score_equations(current, problem, slopes)
    held = held_unknowns(current)
    found = []
    for i in range(len(current.assembly.placements)):
        change = _change(current, problem, i)
        if change is None:
            found.append(np.inf)
            continue
        others = np.ones(len(gram), dtype=bool)
        others[held] = False
        others[_own(current.assembly, i)] = False
        seen = _against(problem, current, slopes, change)[others]
        left = float(np.sum(change**2)) - float(seen @ _solved(gram[np.ix_(others, others)], seen))
        found.append(float(np.sqrt(max(left, 0.0) / max(1.0, current.level))))
    return found


def _change(current: Estimate, problem: Problem, placement: int) -> FloatArray | None:
    """(n_rows, n_outputs) what an effect does to the outputs, all else as it is, in deviations of the noise."""
    off = run_without(current, placement, problem, smoothing=current.smoothing)
    if off is None:
        return None
    change = (current.trajectory.outputs - off.trajectory.outputs) * weights_along(problem, current.trajectory)
    return change if np.isfinite(np.sum(change**2)) else None


def _own(assembly: Assembly, placement: int) -> list[int]:
    """Where the amplitudes of an effect stand, or all that it has where it has none."""
    item, begin = assembly.placements[placement], assembly.common_of(placement).start
    roles = [item.effect.parameters[j].role for j in item.common]
    found = [begin + position for position, role in enumerate(roles) if role == "amplitude"]
    return found or [begin + position for position in range(len(roles))]


def _against(problem: Problem, current: Estimate, slopes: Sensitivity, change: FloatArray) -> FloatArray:
    """What each unknown's effect on the outputs has in common with a change, in the order of the normal equations."""
    drive, weights = problem.drive, weights_along(problem, current.trajectory)
    found = [np.sum(slopes.common * weights * change, axis=(1, 2))]
    for record in range(drive.n_records):
        rows = drive.rows_of(record)
        found.append(np.sum(slopes.local[:, rows] * weights[rows] * change[rows], axis=(1, 2)))
    return np.concatenate(found)


def _solved(gram: FloatArray, right: FloatArray) -> FloatArray:
    scale = np.sqrt(np.maximum(np.diag(gram), TINY))
    return np.asarray(scipy.linalg.pinvh(gram / np.outer(scale, scale)) @ (right / scale) / scale)
