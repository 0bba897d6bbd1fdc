"""Frequency responses: of a realisation, of its modes one by one, and as estimated from the records themselves.

All are responses of output to the sampled input, G(z) = C (z I - A)^-1 B + D at z = exp(2 pi j f dt), so they compare
with one another and with the quotient of the spectra of a record, whatever the input did between samples.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
import numpy.typing as npt
import scipy

from era.realisation import Realisation
from modal.modes.modal_form import discrete_poles
from modal.modes.mode import Mode
from okid.arrays import ComplexArray, FloatArray, whole_number
from okid.display import Displayed
from okid.errors import InsufficientDataError, InvalidDataError
from okid.frequency_response import (
    AveragedSpectra,
    FrequencyResponse,
    averaged_spectra,
    coherent_response,
    segment_length,
)
from okid.record import InputHold, Record
from okid.rows import as_records, runs_of


def frf(realisation: Realisation, frequencies: npt.ArrayLike) -> ComplexArray:
    """Frequency response of a realisation.

    One Schur decomposition A = Q T Q^H serves all frequencies; z I - T is solved by back substitution, so nearly equal
    poles do no harm.

    Args:
        realisation: in the units of the record.
        frequencies: (n_frequencies,) [Hz], up to half the sampling frequency.

    Returns:
        (n_frequencies, n_outputs, n_inputs), output unit per input unit.

    Example:
        >>> model = Realisation(np.array([[0.5]]), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1)), 0.1)
        >>> frf(model, [0.0]).real.tolist()
        [[[2.0]]]
    """
    z = _on_circle(frequencies, realisation.dt)
    n_inputs, order = realisation.B.shape[1], realisation.order
    if order == 0:
        return realisation.D * z[:, np.newaxis, np.newaxis] ** realisation.lead
    triangular, unitary = scipy.linalg.schur(realisation.A, output="complex")
    drive = unitary.conj().T @ realisation.B
    state = np.empty((order, z.size, n_inputs), dtype=np.complex128)
    for i in reversed(range(order)):
        rest = np.tensordot(triangular[i, i + 1 :], state[i + 1 :], axes=1)
        state[i] = (drive[i] + rest) / (z - triangular[i, i])[:, np.newaxis]
    response = np.einsum("qn,nfm->fqm", realisation.C @ unitary, state) + realisation.D
    return cast("ComplexArray", response * z[:, np.newaxis, np.newaxis] ** realisation.lead)


def modal_frf(modes: Sequence[Mode], frequencies: npt.ArrayLike, *, dt: float) -> ComplexArray:
    """Frequency response of each mode by itself: R / (z - lambda), for a pair with its conjugate.

    Summed over all modes of a realisation without deadbeat poles, and with the feedthrough added, it is `frf`.

    Args:
        modes: any, e.g. `model.system`.
        frequencies: (n_frequencies,) [Hz].
        dt: time step of the model [s].

    Returns:
        (n_modes, n_frequencies, n_outputs, n_inputs).
    """
    z = _on_circle(frequencies, dt)
    modes = tuple(modes)
    if not modes:
        return np.zeros((0, z.size, 0, 0), dtype=np.complex128)
    poles, is_pair = discrete_poles(modes, dt)
    residues = np.array([np.outer(mode.shape, mode.participation) for mode in modes])[:, np.newaxis]
    direct = residues / (z - poles[:, np.newaxis])[:, :, np.newaxis, np.newaxis]
    mirrored = residues.conj() / (z - poles.conj()[:, np.newaxis])[:, :, np.newaxis, np.newaxis]
    return direct + np.where(is_pair[:, np.newaxis, np.newaxis, np.newaxis], mirrored, 0.0)


def continuous_residue(mode: Mode, dt: float, *, hold: InputHold = "zero_order") -> ComplexArray:
    """Residue R of the continuous frequency response R / (s - s_r).

    The pulse response of the samples is shape participation' lambda^(k-1). An input held over each sample makes it
    R (lambda - 1) / s_r, straight lines R (lambda - 1)^2 / (s_r^2 dt), and a band-limited input R lambda dt, as the
    responses of the samples and of time agree at the pole. All go to R dt for a slow pole; taking that for the factor
    turns the phase of a residue by up to a sample.

    Args:
        mode: of a realisation with time step dt.
        dt: time step [s].
        hold: what the inputs did between samples.

    Returns:
        (n_outputs, n_inputs).
    """
    exponent = mode.pole * dt
    held = 1.0 if exponent == 0 else np.expm1(exponent) / exponent
    factor = {"zero_order": held, "linear": held**2, "band_limited": np.exp(exponent)}[hold] * dt
    return cast("ComplexArray", np.outer(mode.shape, mode.participation) / factor)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class MeasuredFrf(Displayed):
    """Frequency response as the records show it, without a model.

    Attributes:
        frequencies: (n_frequencies,) [Hz].
        frf: (n_frequencies, n_outputs, n_inputs) H1 estimate, all inputs at once; nan where the inputs have no power or
            cannot be told apart.
        ordinary_coherence: (n_frequencies, n_outputs, n_inputs) of each output with each input by itself, in [0, 1].
        multiple_coherence: (n_frequencies, n_outputs) share of each output's power that all inputs together explain.
        n_averages: number of segments that were averaged.
    """

    frequencies: FloatArray
    frf: ComplexArray
    ordinary_coherence: FloatArray
    multiple_coherence: FloatArray
    n_averages: int


def measured_frf(records: Record | Sequence[Record], *, n_per_segment: int | None = None) -> MeasuredFrf:
    """H1 estimate of the frequency response with its coherences, by Welch's method over one or several records.

    G = S_yu S_uu^-1 from segments with half overlap, mean removed, Hann window. A segment never spans two records or a
    missing sample. Noise on the inputs biases H1 low, a resonance narrower than 1 / segment length is smeared.

    Args:
        records: of one system, with equal channels and time step.
        n_per_segment: samples a segment; unless given, the power of two that leaves about 15 half-overlapping segments.

    Raises:
        InvalidDataError: no input, or records that do not fit together.
        InsufficientDataError: fewer segments than inputs + 1: their spectra could not be told apart.

    References:
        Bendat, Piersol, Random Data, 4th edition, 2010, chapters 7 and 9, doi 10.1002/9781118032428.
    """
    several = as_records(records)
    n_inputs = several[0].n_inputs
    if n_inputs == 0:
        raise InvalidDataError(
            "a measured frequency response needs records with at least one input; name it among the channels."
        )
    runs = [run for record in several for run in runs_of(record.complete_rows())]
    length = (
        segment_length(several) if n_per_segment is None else whole_number(n_per_segment, name="n_per_segment", least=2)
    )
    n_segments = sum(max(0, (stop - start - length) // max(1, length // 2) + 1) for start, stop in runs)
    if n_segments < n_inputs + 1:
        raise InsufficientDataError(
            f"a measured frequency response of {n_inputs} inputs needs at least {n_inputs + 1} segments; the records "
            f"hold {n_segments} of {length} complete samples. Use a smaller n_per_segment or a longer record."
        )
    return measured_frf_of(averaged_spectra(several, n_per_segment=length))


def tabled_frf(response: FrequencyResponse) -> MeasuredFrf:
    """A table of responses in the form of those that are measured here; coherence is nan where it is not known."""
    coherence, shape = response.coherence, response.response.shape
    single = np.full(shape, np.nan) if coherence is None or coherence.ndim == 2 else coherence
    multiple = np.full(shape[:2], np.nan) if coherence is None else coherence
    return MeasuredFrf(
        frequencies=response.frequencies,
        frf=response.response,
        ordinary_coherence=single,
        multiple_coherence=multiple if multiple.ndim == 2 else multiple.min(axis=2),
        n_averages=response.n_averages or 0,
    )


def measured_frf_of(spectra: AveragedSpectra) -> MeasuredFrf:
    """H1 estimate and coherences of spectra that were summed already; as `measured_frf`."""
    response, ordinary, multiple = coherent_response(spectra)
    return MeasuredFrf(
        frequencies=spectra.frequencies,
        frf=response,
        ordinary_coherence=ordinary,
        multiple_coherence=multiple,
        n_averages=spectra.n_averages,
    )


def _on_circle(frequencies: npt.ArrayLike, dt: float) -> ComplexArray:
    hertz: FloatArray = np.atleast_1d(np.asarray(frequencies, dtype=np.float64))
    return cast("ComplexArray", np.exp(2j * np.pi * dt * hertz))
