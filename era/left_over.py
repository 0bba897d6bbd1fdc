"""What the free run of a model leaves of a record: noise through the model's own poles, v = C x + e, x+ = A x + K e.

The forced response from rest and a constant in each output are taken off; the state at the first sample stays in, as an
unknown that later stages move.
"""

from dataclasses import dataclass, replace

import numpy as np

from era.initial_state import estimate_initial_state
from era.realisation import Realisation
from era.simulation import simulate
from okid.arrays import FloatArray
from okid.record import Record

__all__ = ["NoisePart", "left_over"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class NoisePart:
    """What the free run leaves of one record, and the state that it starts from.

    Attributes:
        values: (n_samples, n_outputs), NaN where missing.
        state: (order,) at the first sample.
    """

    values: FloatArray
    state: FloatArray


def left_over(model: Realisation, record: Record) -> tuple[NoisePart, FloatArray]:
    """What the free run leaves of a record.

    Args:
        model: its gain is not looked at.
        record: of the model's channels and time step.

    Returns:
        The part, and (n_samples, n_outputs) what the free decay from its state leaves too.

    Raises:
        InsufficientDataError: no output sample to tell the state from.
        NumericalError: the free run grows beyond all numbers.
    """
    noise = replace(
        record,
        inputs=np.empty((record.n_samples, 0)),
        outputs=record.outputs - simulate(model, record).outputs,
        input_names=(),
        input_units=(),
    )
    undriven = Realisation(model.A, np.empty((model.order, 0)), model.C, np.empty((model.n_outputs, 0)), model.dt)
    level, state, left = np.zeros(model.n_outputs), np.zeros(model.order), noise.outputs
    there = ~np.isnan(noise.outputs)
    for _ in range(2 if there.any() else 0):  # level and free decay hardly share a direction
        state = estimate_initial_state(undriven, replace(noise, outputs=noise.outputs - level))
        left = noise.outputs - simulate(undriven, noise, initial_state=state).outputs
        level = np.where(there, left, 0.0).sum(axis=0) / np.maximum(there.sum(axis=0), 1)
    return NoisePart(values=noise.outputs - level, state=state), left - level
