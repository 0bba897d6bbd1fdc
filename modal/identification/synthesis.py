"""The frequency responses of a result, in the motion that is wanted; modes as a state space model."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from era.realisation import Realisation
from era.simulation import predict
from modal.identification.result import Identification
from modal.modes.modal_form import continuous_poles, discrete_poles, modal_basis
from modal.modes.modal_mass import DERIVATIVES
from modal.modes.mode import ModalModel
from modal.modes.response_synthesis import frf
from okid.arrays import frozen, require
from okid.errors import InvalidDataError
from okid.frequency_response import FrequencyResponse
from okid.record import Record

Motion = Literal["as measured", "displacement", "velocity", "acceleration"]

_UNITS = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s^2"}
N_LINES = 1025
"""Give so many lines from 0 Hz to half the sampling frequency where nobody says which."""


def frequency_response(
    result: Identification | Realisation, frequencies: npt.ArrayLike | None = None, *, motion: Motion = "as measured"
) -> FrequencyResponse:
    """Responses of the identified model: receptance, mobility or accelerance where the outputs are motions.

    Args:
        result: of `modal.identify`, or any realisation.
        frequencies: (n_lines,) increasing [Hz], up to half the sampling frequency; unless given, those of the table
            that was identified, else 1025 from 0 Hz.
        motion: "as measured", or what every output is turned into by powers of 2 pi j f; its unit must be m, m/s, m/s^2
            or the same of rad.

    Returns:
        Exact responses (window "periodic": nothing to divide out); NaN at 0 Hz where a motion is divided by 0.

    Raises:
        InvalidDataError: another motion, an output that is no motion, or frequencies out of range.

    Example:
        >>> model = Realisation([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.1)
        >>> frequency_response(model, [0.0, 5.0]).response.real.ravel().round(9).tolist()
        [2.0, -0.666666667]
    """
    if motion not in get_args(Motion):
        raise InvalidDataError(f"motion must be one of {', '.join(get_args(Motion))}, but is {motion!r}.")
    if not isinstance(result, Realisation):
        require(result, Identification, where="frequency_response", made_by="modal.identify")
    names = None if isinstance(result, Realisation) else result.channels
    model = result if isinstance(result, Realisation) else result.realisation
    if not model.n_inputs:
        raise InvalidDataError("a frequency response needs an input, but this result has none.")
    nyquist = 0.5 / model.dt
    if frequencies is not None:
        lines = frozen(frequencies, name="frequencies", shape=(None,))
    elif isinstance(names, FrequencyResponse):
        lines = names.frequencies
    else:
        lines = np.linspace(0.0, nyquist, N_LINES)
    if not lines.size or lines.min() < 0 or lines.max() > nyquist * (1 + 1e-9):
        raise InvalidDataError(f"frequencies must lie between 0 and {nyquist:.6g} Hz, half the sampling frequency.")
    response = frf(model, lines)
    units = ("",) * model.n_outputs if names is None else names.output_units
    if motion != "as measured":
        unknown = [unit or "no unit" for unit in units if unit not in DERIVATIVES]
        if unknown:
            raise InvalidDataError(
                f"{motion} can be had of outputs in m, m/s, m/s^2 (or rad), but there are some in {unknown[0]}; take "
                "motion='as measured', or state the units of the records."
            )
        wanted = DERIVATIVES[_UNITS[motion]]
        turned = (2j * np.pi * lines)[:, np.newaxis]
        with np.errstate(divide="ignore", invalid="ignore"):
            response = response * (turned ** np.array([wanted - DERIVATIVES[unit] for unit in units]))[:, :, np.newaxis]
        response = np.where(np.isfinite(response), response, np.nan)
        units = tuple(_UNITS[motion].replace("m", "rad") if "rad" in unit else _UNITS[motion] for unit in units)
    return FrequencyResponse(
        response,
        lines,
        window="periodic",
        input_names=() if names is None else names.input_names,
        output_names=() if names is None else names.output_names,
        input_units=() if names is None else names.input_units,
        output_units=units,
        name="" if names is None else names.name,
    )


def output_model(modes: ModalModel) -> Realisation:
    """The modes as a state space model without inputs, two states a mode."""
    poles, _ = discrete_poles(modes.modes, modes.dt)
    n_states, n_outputs = 2 * len(poles), len(modes.output_names)
    A, C = np.zeros((n_states, n_states)), np.zeros((n_outputs, n_states))
    for r, (pole, mode) in enumerate(zip(poles, modes.modes, strict=True)):
        at = slice(2 * r, 2 * r + 2)
        A[at, at] = [[pole.real, pole.imag], [-pole.imag, pole.real]]
        C[:, at] = np.column_stack([mode.shape.real, mode.shape.imag])
    return Realisation(A, np.zeros((n_states, 0)), C, np.zeros((n_outputs, 0)), modes.dt)


def with_absent_outputs(
    result: Identification, modes: ModalModel, seen: Sequence[int]
) -> tuple[list[Record], list[Record]]:
    """The records of a set-up and their predictions, absent outputs from the states of the joined modes alone.

    Args:
        result: of the set-up, by its outputs alone.
        modes: of all set-ups, on all outputs.
        seen: which of these the set-up measured.
    """
    model, basis = result.realisation, modal_basis(result.realisation)
    n_outputs = len(modes.output_names)
    own, absent = list(seen), [o for o in range(n_outputs) if o not in seen]
    C, K = np.zeros((n_outputs, model.order)), np.zeros((model.order, n_outputs))
    C[own], K[:, own] = model.C, 0.0 if model.K is None else model.K
    poles = continuous_poles(basis.poles, model.dt)
    for mode in modes:
        at = int(np.abs(poles - mode.pole).argmin())
        here = basis.outputs[:, at]
        scale = np.vdot(mode.shape[own], here) / np.vdot(mode.shape[own], mode.shape[own])
        C[absent] += 2.0 * (mode.shape[absent, np.newaxis] * scale * basis.left[at]).real
    virtual = Realisation(model.A, np.zeros((model.order, 0)), C, np.zeros((len(C), 0)), model.dt, K=K)
    measured, predicted = [], []
    for record in result.records:
        outputs = np.zeros((record.n_samples, n_outputs))
        outputs[:, own] = record.outputs
        whole = replace(record, outputs=outputs, output_names=modes.output_names, output_units=modes.output_units)
        run = predict(virtual, whole).outputs
        outputs = outputs.copy()
        outputs[:, absent] = run[:, absent]
        measured.append(replace(whole, outputs=outputs))
        predicted.append(replace(whole, outputs=run))
    return measured, predicted
