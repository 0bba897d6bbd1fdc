"""Spectra of the gap, of the measured output and of the noise: the numbers of the picture in report and recording."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modal.localisation.gap import Gap
from modal.sections.spectra import power_spectra
from okid.arrays import FloatArray
from okid.record import Record

__all__ = ["GapDensity", "gap_density"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class GapDensity:
    """One-sided power spectral densities, mean over the held-out records, without the line at zero frequency.

    Attributes:
        frequency: (n_frequencies,) [Hz].
        measured: (n_frequencies, n_outputs) of the measured outputs [unit^2/Hz].
        gaps: one (n_frequencies, n_outputs) a state of the model.
        noise: (n_outputs,) of white noise of the floor's variance.
    """

    frequency: FloatArray
    measured: FloatArray
    gaps: tuple[FloatArray, ...]
    noise: FloatArray

    def span(self, output: int) -> tuple[float, float]:
        """What the axis of an output's density should reach: from below the noise to above all there is."""
        parts = [self.measured[:, output], *(gap[:, output] for gap in self.gaps)]
        top = max([float(self.noise[output]), *(float(part.max(initial=0.0)) for part in parts)])
        return float(self.noise[output]) / 12.0, 4.0 * top


def gap_density(gaps: Sequence[Gap]) -> GapDensity:
    """Densities by Welch's method with windows of a quarter of the longest record.

    Args:
        gaps: of the states of the model, on the same records; at least one.
    """
    records = gaps[0].measured
    n_segment = int(np.clip(max(record.n_samples for record in records) // 4, 64, 4096))
    frequency, measured = power_spectra(records, n_segment=n_segment)
    densities = tuple(power_spectra(_as_records(gap), n_segment=n_segment)[1][1:] for gap in gaps)
    rows = np.array([record.n_samples for record in records], dtype=np.float64)
    return GapDensity(
        frequency=frequency[1:],
        measured=measured[1:],
        gaps=densities,
        noise=2.0 * records[0].dt * (rows @ gaps[0].floor) / rows.sum(),
    )


def _as_records(gap: Gap) -> list[Record]:
    return [Record(np.empty((len(values), 0)), values, gap.measured[0].dt) for values in gap.residuals]
