"""What the records show without any model, looked at once for all pages: their quality and their response."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from era.realisation import Realisation
from modal.identification.result import Identification
from modal.modes.response_synthesis import FEWEST_AVERAGES, MeasuredFrf, frf, measured_frf
from modal.quality.check import check_quality
from modal.quality.findings import DataQuality
from okid.arrays import ComplexArray, FloatArray
from okid.errors import InsufficientDataError
from okid.record import Record

__all__ = ["Gathered", "gather", "response_of"]

LONGEST_SEGMENT: Final = 8192
"""Samples a segment: 4096 lines are more than a screen shows, and long segments cost time without end."""

FINE_LINES: Final = 800
"""Frequencies at which the response of a model is drawn, at least, as far as memory allows."""

MOST_NUMBERS: Final = 300_000
"""Lines of the response times its pairs of channels, at most."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Gathered:
    """What speaks for or against a model, beside the model.

    Attributes:
        quality: of the data.
        measured: frequency response of the records as used; None without inputs, or where they are too short.
        synthesised: (n_frequencies, n_outputs, n_inputs) response of the model at the frequencies of `measured`, empty
            where that is None; nan at a pole on the unit circle.
        fine_frequencies: (n_fine,) [Hz] those of `measured` with others between where they are few: a short record has
            coarse lines, and resonances of the model may lie between them.
        fine: (n_fine, n_outputs, n_inputs) response of the model there.
        density_frequencies: (n_lines,) [Hz] of `model_density`: those of the densities in `quality`, up to the model's
            highest.
        model_density: (n_lines, n_outputs) power spectral density of the outputs that the model's one-step errors
            drive; empty with inputs, or where the model has no gain.
    """

    quality: DataQuality
    measured: MeasuredFrf | None
    synthesised: ComplexArray
    fine_frequencies: FloatArray
    fine: ComplexArray
    density_frequencies: FloatArray
    model_density: FloatArray


def gather(identification: Identification, quality: DataQuality | None = None) -> Gathered:
    """Look at the records of an identification.

    Args:
        identification: whose records.
        quality: of the records as they were read; unless given, that of the records as used is found.
    """
    fine_frequencies, step = np.zeros(0), 1
    fine: ComplexArray = np.zeros((0, 0, 0), dtype=np.complex128)
    # a pole on the unit circle and squares of 1e200 give what is no number, and is left out of every picture
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        measured = response_of(identification.records)
        if measured is not None:
            n_lines, n_pairs = measured.frequencies.size, measured.frf[0].size
            step = max(1, min(-(-FINE_LINES // n_lines), MOST_NUMBERS // (n_lines * n_pairs)))
            fine_frequencies = np.linspace(0.0, measured.frequencies[-1], step * (n_lines - 1) + 1)
            fine = frf(identification.realisation, fine_frequencies)
            fine = np.where(np.isfinite(fine), fine, np.nan)
        quality = quality or check_quality(identification.records)
    frequencies = quality.frequencies[quality.frequencies <= 0.5 / identification.realisation.dt * (1 + 1e-9)]
    return Gathered(
        quality=quality,
        measured=measured,
        synthesised=fine[::step],
        fine_frequencies=fine_frequencies,
        fine=fine,
        density_frequencies=frequencies,
        model_density=_model_density(identification, frequencies),
    )


def _model_density(identification: Identification, frequencies: FloatArray) -> FloatArray:
    """One-sided spectrum 2 dt H R H* of the outputs, H from the one-step errors with covariance R to the outputs.

    References:
        Ljung, System Identification, 2nd edition, 1999, section 2.3 (spectra of innovations models).
    """
    model = identification.realisation
    if identification.records[0].n_inputs or model.K is None or not frequencies.size:
        return np.zeros((0, 0))
    covariance = identification.innovation_covariance
    if covariance is None:
        covariance = identification.observer.residual_covariance
    noise = Realisation(model.A, model.K, model.C, np.eye(model.C.shape[0]), model.dt)
    with np.errstate(divide="ignore", invalid="ignore"):
        response = frf(noise, frequencies)
        power = np.einsum("fij,jk,fik->fi", response, covariance, response.conj()).real
    density: FloatArray = 2.0 * model.dt * np.where(np.isfinite(power), power, np.nan)
    return density


def response_of(records: Sequence[Record]) -> MeasuredFrf | None:
    """Frequency response of the records with segments that suit a picture; None where there can be none."""
    first = records[0]
    if not first.n_inputs:
        return None
    n_rows = sum(record.n_samples for record in records)
    longest = min(LONGEST_SEGMENT, 2 * MOST_NUMBERS // (first.n_inputs * first.n_outputs), n_rows // FEWEST_AVERAGES)
    length = 2 ** int(np.log2(max(16, longest)))
    while length >= 16:
        try:
            return measured_frf(records, n_per_segment=length)
        except InsufficientDataError:  # too few stretches without a gap
            length //= 2
    return None
