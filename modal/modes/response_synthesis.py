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
from okid.errors import InsufficientDataError, InvalidDataError
from okid.record import Record
from okid.rows import as_records, runs_of

__all__ = [
    "AveragedSpectra",
    "MeasuredFrf",
    "averaged_spectra",
    "continuous_residue",
    "frf",
    "measured_frf",
    "measured_frf_of",
    "modal_frf",
    "segment_length",
]

FEWEST_AVERAGES = 8
"""Independent segments that the automatic segment length leaves, about: coherence needs several to mean something."""


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
        return np.tile(realisation.D + 0j, (z.size, 1, 1))
    triangular, unitary = scipy.linalg.schur(realisation.A, output="complex")
    drive = unitary.conj().T @ realisation.B
    state = np.empty((order, z.size, n_inputs), dtype=np.complex128)
    for i in reversed(range(order)):
        rest = np.tensordot(triangular[i, i + 1 :], state[i + 1 :], axes=1)
        state[i] = (drive[i] + rest) / (z - triangular[i, i])[:, np.newaxis]
    return cast("ComplexArray", np.einsum("qn,nfm->fqm", realisation.C @ unitary, state) + realisation.D)


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


def continuous_residue(mode: Mode, dt: float) -> ComplexArray:
    """Residue R of the continuous frequency response R / (s - s_r), for an input held over each sample.

    R = shape participation' s_r / (lambda - 1), which goes to 1 / dt for a slow pole; leaving the factor at 1 / dt
    turns the phase of a residue by half a sample.

    Args:
        mode: of a realisation with time step dt.
        dt: time step [s].

    Returns:
        (n_outputs, n_inputs).
    """
    exponent = mode.pole * dt
    factor = 1 / dt if exponent == 0 else mode.pole / np.expm1(exponent)
    return cast("ComplexArray", np.outer(mode.shape, mode.participation) * factor)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MeasuredFrf:
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
        raise InvalidDataError("a measured frequency response needs records with at least one input; these have none.")
    runs = [run for record in several for run in _complete_runs(record)]
    length = (
        segment_length(several) if n_per_segment is None else whole_number(n_per_segment, name="n_per_segment", least=2)
    )
    n_segments = sum(max(0, (stop - start - length) // max(1, length // 2) + 1) for _, start, stop in runs)
    if n_segments < n_inputs + 1:
        raise InsufficientDataError(
            f"a measured frequency response of {n_inputs} inputs needs at least {n_inputs + 1} segments; the records "
            f"hold {n_segments} of {length} complete samples. Use a smaller n_per_segment or a longer record."
        )
    return measured_frf_of(averaged_spectra(several, n_per_segment=length))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class AveragedSpectra:
    """Sums over half-overlapping Hann segments; the spectra of inputs with everything, of outputs with themselves.

    Attributes:
        frequencies: (n_frequencies,) [Hz].
        inputs: (n_frequencies, n_inputs, n_inputs).
        cross: (n_frequencies, n_outputs, n_inputs) of outputs with inputs.
        power: (n_frequencies, n_inputs + n_outputs) of each channel with itself.
        n_averages: number of segments.
        to_density: factor that makes a power spectral density [unit^2/Hz] of `power`.
    """

    frequencies: FloatArray
    inputs: ComplexArray
    cross: ComplexArray
    power: FloatArray
    n_averages: int
    to_density: float


def averaged_spectra(records: Record | Sequence[Record], *, n_per_segment: int) -> AveragedSpectra:
    """Welch's sums, one segment in memory at a time; a segment never spans two records or a missing sample.

    Args:
        records: of one system.
        n_per_segment: samples a segment.
    """
    several = as_records(records)
    length, n_inputs, dt = n_per_segment, several[0].n_inputs, several[0].dt
    window = np.hanning(length + 1)[:length]
    n_lines = length // 2 + 1
    inputs = np.zeros((n_inputs, n_inputs, n_lines), dtype=np.complex128)
    cross = np.zeros((several[0].n_outputs, n_inputs, n_lines), dtype=np.complex128)
    power = np.zeros((n_inputs + several[0].n_outputs, n_lines))
    n_averages = 0
    for record, start, stop in [run for each in several for run in _complete_runs(each)]:
        for first in range(start, stop - length + 1, max(1, length // 2)):
            rows = slice(first, first + length)
            segment = np.concatenate([record.inputs[rows].T, record.outputs[rows].T])
            spectrum: ComplexArray = np.fft.rfft(window * (segment - segment.mean(axis=1, keepdims=True)))
            power += spectrum.real**2 + spectrum.imag**2
            for i in range(n_inputs):
                against = spectrum[i].conj()
                inputs[:, i] += spectrum[:n_inputs] * against
                cross[:, i] += spectrum[n_inputs:] * against
            n_averages += 1
    return AveragedSpectra(
        frequencies=np.arange(n_lines) / (length * dt),
        inputs=inputs.transpose(2, 0, 1),
        cross=cross.transpose(2, 0, 1),
        power=power.T,
        n_averages=n_averages,
        to_density=2.0 * dt / (float(np.square(window).sum()) * max(1, n_averages)),
    )


def measured_frf_of(spectra: AveragedSpectra) -> MeasuredFrf:
    """H1 estimate and coherences of spectra that were summed already; as `measured_frf`."""
    n_inputs = spectra.inputs.shape[1]
    power = spectra.power
    input_power, output_power = power[:, :n_inputs], power[:, n_inputs:]
    # Unit diagonal first, so that a rank test does not depend on units; a line without power gives nan below.
    with np.errstate(divide="ignore", invalid="ignore"):
        unit = 1 / np.sqrt(input_power)
        uu = spectra.inputs * unit[:, :, np.newaxis] * unit[:, np.newaxis]
        yu = spectra.cross * unit[:, np.newaxis]
        ordinary = np.abs(yu) ** 2 / output_power[:, :, np.newaxis]
        response = np.full(yu.shape, np.nan + 0j)
        lines = np.flatnonzero(
            np.isfinite(uu).all(axis=(1, 2)) & (input_power > 1e-24 * power.max(axis=0)[:n_inputs]).all(1)
        )
        lines = lines[np.linalg.eigvalsh(uu[lines])[:, 0] > 1e-10] if lines.size else lines
        response[lines] = np.linalg.solve(uu[lines].transpose(0, 2, 1), yu[lines].transpose(0, 2, 1)).transpose(0, 2, 1)
        multiple = np.einsum("fqm,fqm->fq", response, yu.conj()).real / output_power
        response = response * unit[:, np.newaxis]
    return MeasuredFrf(
        frequencies=spectra.frequencies,
        frf=np.asarray(response, dtype=np.complex128),
        ordinary_coherence=np.clip(ordinary, 0.0, 1.0),
        multiple_coherence=np.clip(multiple, 0.0, 1.0),
        n_averages=spectra.n_averages,
    )


def _complete_runs(record: Record) -> list[tuple[Record, int, int]]:
    return [(record, start, stop) for start, stop in runs_of(record.complete_rows())]


def segment_length(records: Sequence[Record], *, averages: int = FEWEST_AVERAGES) -> int:
    """Samples a segment: the power of two, 16 at least, that leaves so many segments without overlap, about."""
    lengths = [stop - start for record in records for _, start, stop in _complete_runs(record)]
    n_rows, longest = sum(lengths), max(lengths, default=0)
    return int(max(16, 2 ** int(np.log2(max(16, min(n_rows // averages, longest))))))


def _on_circle(frequencies: npt.ArrayLike, dt: float) -> ComplexArray:
    hertz: FloatArray = np.atleast_1d(np.asarray(frequencies, dtype=np.float64))
    return cast("ComplexArray", np.exp(2j * np.pi * dt * hertz))
