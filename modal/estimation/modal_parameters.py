"""From a model in modal form to a state-space model in the units of the records, and from there to scaled channels.

A refined model keeps the evidence that it was cut from: its states are turned into the coordinates of the data's Hankel
factors, so that the accuracy indicators go on comparing the model with the data and not with itself.
"""

import numpy as np

from era.realisation import HankelFactors, Realisation
from era.state_recursion import lifted
from modal.estimation.output_error import Step
from okid.arrays import FloatArray
from okid.scaling import ChannelScaling

__all__ = ["in_units", "scaled_model"]

WORST_COORDINATES = 1e8
"""Condition number from which the data's states and the model's are no longer the same."""


def scaled_model(realisation: Realisation, scaling: ChannelScaling) -> Realisation:
    """The model of the scaled channels, without gain and factors."""
    into, out = scaling.input_scale, scaling.output_scale[:, np.newaxis]
    return Realisation(
        realisation.A, realisation.B * into, realisation.C / out, realisation.D * into / out, realisation.dt
    )


def in_units(step: Step, start: Realisation, scaling: ChannelScaling) -> Realisation:
    """The refined model in the units of the records and, where they fit, in the state coordinates of the data."""
    A, B, C = _real_modal_form(step)
    n = step.layout.n_poles
    D = step.linear.coefficients[2 * n : 2 * n + step.layout.n_inputs].T
    factors = start.factors
    if factors is not None:
        coordinates = _data_coordinates(A, C * (scaling.output_scale / factors.output_scale)[:, np.newaxis], factors)
        if coordinates is None:
            factors = None
        else:
            A, B = coordinates @ A @ np.linalg.inv(coordinates), coordinates @ B
            C = C @ np.linalg.inv(coordinates)
            factors = factors.truncated(A.shape[0])
    into, out = scaling.input_scale, scaling.output_scale[:, np.newaxis]
    return Realisation(
        A, B / into, C * out, D * out / into, start.dt, singular_values=start.singular_values, factors=factors
    )


def _real_modal_form(step: Step) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A, B, C with one state for a real pole and two, real and imaginary part, for a pair."""
    parameters, c = step.parameters, step.linear.shapes
    order = int(np.where(parameters.is_pair, 2, 1).sum())
    A, B = np.zeros((order, order)), np.zeros((order, step.layout.n_inputs))
    C = np.zeros((step.layout.n_outputs, order))
    row = 0
    for i, pole in enumerate(parameters.poles):
        if parameters.is_pair[i]:
            own = slice(row, row + 2)
            A[own, own] = [[pole.real, -pole.imag], [pole.imag, pole.real]]
            B[own] = [parameters.inputs[i].real, parameters.inputs[i].imag]
            C[:, own] = np.column_stack([c[:, i].real, -c[:, i].imag])
        else:
            A[row, row], B[row], C[:, row] = pole.real, parameters.inputs[i].real, c[:, i].real
        row += 2 if parameters.is_pair[i] else 1
    return A, B, C


def _data_coordinates(A: FloatArray, C: FloatArray, factors: HankelFactors) -> FloatArray | None:
    """(order, order) T with (data's observability) T close to the model's, None where T has no safe inverse."""
    order = A.shape[0]
    if order > factors.observability.shape[1]:
        return None
    measured = factors.truncated(order).observability
    length = 1 << (factors.n_block_rows - 1).bit_length()
    modelled = lifted(A, C, length)[0][: measured.shape[0]]
    T = np.asarray(np.linalg.lstsq(measured, modelled, rcond=None)[0], dtype=np.float64)
    return T if np.linalg.cond(T) < WORST_COORDINATES else None
