"""How many steps of the simulation a sample needs."""

from collections.abc import Sequence

import numpy as np

from modal.simulation.plant import Plant, plant_matrices
from okid.arrays import FloatArray
from okid.record import Record

__all__ = ["steps_per_sample"]

STEPS_PER_PERIOD = 16.0
"""A force that is taken as a straight line over each step is off by (2 pi / steps)^2 / 12 of itself at the highest
resonance: 1.3 % at 16 steps."""

BAND_LIMITED_STEPS = 30.0
MOST_STEPS = 6


def steps_per_sample(plant: Plant, linear: FloatArray, records: Sequence[Record]) -> int:
    """Steps a sample, so that every resonance below the Nyquist frequency gets enough steps a period.

    Args:
        plant: The plant.
        linear: Values of its linear parameters.
        records: Records to simulate, of one time step.

    Returns:
        1 to 6.
    """
    dt = records[0].dt
    wanted = BAND_LIMITED_STEPS if records[0].input_hold == "band_limited" else STEPS_PER_PERIOD
    poles = np.linalg.eigvals(plant_matrices(plant, linear).A) if plant.n_states else np.zeros(0)
    frequencies = np.abs(poles) / (2.0 * np.pi)
    inside = frequencies[frequencies < 0.5 / dt]
    highest = float(inside.max(initial=0.0))
    return int(np.clip(np.ceil(wanted * highest * dt), 1, MOST_STEPS))
