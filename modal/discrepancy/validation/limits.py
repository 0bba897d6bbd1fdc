"""The largest effects that the data could still hide."""

import numpy as np

from modal.discrepancy.fitting.estimation import Estimate
from modal.discrepancy.fitting.nodes import SMALLEST_FALL, SMALLEST_GAIN, Task
from modal.discrepancy.results import DetectionLimit
from modal.discrepancy.selection.screening import Candidate, screen_candidates
from modal.effects.effect_units import parameter_units
from modal.simulation.plant import Plant

__all__ = ["detection_limits"]


def detection_limits(current: Estimate, task: Task, plant: Plant) -> tuple[DetectionLimit, ...]:
    """The size of each effect at each place below which it would not count, beside the model as found.

    What counts takes away a tenth of what is left, and 30 of 2 ln L: of the two the larger amplitude. An effect with a
    shape (a gap, a frequency) is hidden best at its least visible shape; the limit is the largest over the shapes that
    the screen tries. Effects without an amplitude (a delay) are left out.

    Args:
        current: The model as found.
        task: Records and catalogue.
        plant: The plant.

    Returns:
        One limit an effect and place, in the order of the catalogue.
    """
    candidates = screen_candidates(current, task.fit, task.catalogue, signs="free")
    largest: dict[tuple[str, str], Candidate] = {}
    for candidate in candidates:
        known = largest.get((candidate.key, candidate.where))
        if np.isfinite(candidate.deviation) and (known is None or candidate.deviation > known.deviation):
            largest[candidate.key, candidate.where] = candidate
    n_values = int(task.fit.drive.present.sum())
    deviations = np.sqrt(max(SMALLEST_GAIN, SMALLEST_FALL * n_values))
    found = []
    for key, effect in task.catalogue.items():
        amplitudes = [j for j, kind in enumerate(effect.parameters) if kind.role == "amplitude"]
        for (other, where), candidate in largest.items():
            if other != key or not amplitudes:
                continue
            first = amplitudes[0]
            found.append(
                DetectionLimit(
                    effect=key,
                    where=where,
                    parameter=effect.parameters[first].name,
                    value=float(deviations * candidate.deviation),
                    unit=parameter_units(plant, effect, where)[first],
                )
            )
    return tuple(found)
