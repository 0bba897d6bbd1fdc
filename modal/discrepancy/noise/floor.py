"""How much of each output is noise: the mean square that no model can explain, from the records alone.

Everything that the workflow decides is a ratio to this number, so it comes with the way it was found and with its
standard error. In order of trust:

1. repeated records: the same input twice; what differs after the transient is noise, whatever its spectrum.
2. repeated periods: the same within a record.
3. quiet band: the level of the spectrum where neither inputs nor response carry anything; the noise is taken to be
   white.
4. incoherent part: where the inputs excite everything, what smooth response functions leave of the spectrum, in the
   stretch where they leave least. Distortion of a nonlinear response that reaches that far is counted as noise, and
   the standard error says how far that can be.

Quantisation of an output is noise too: its step squared over 12 is the least that a floor can be.

A displacement rolls off, so that the top of its spectrum shows the noise even under broad-band inputs. An acceleration
does not: friction and impacts fill its whole spectrum, and no record of a single realisation tells them from noise.
There the floor is an upper limit with a wide standard error, until the residual of a model shows a lower one
(`lowered_floor`): no noise is larger than what a model leaves.

Estimate over truth, 60 of each law: one mass, 30 to 60 samples a period, 2048 samples, noise of 0.5 to 5 %, multisines
and random steps, random starts; quantiles 5, 25, 50, 75 and 95 %, and the share with a standard error below 0.15
(`pytest -m slow -s tests/modal/discrepancy/test_noise_floor.py` prints it):

    displacement, six laws, from 0.90 0.97 1.00 1.03  1.07  0.58
                              to 0.93 0.98 1.01 1.05  1.09  0.97
    acceleration, none           0.92 0.97 1.00 1.03  1.08  0.98
    acceleration, cubic          0.90 0.98 1.02 1.06  1.10  0.30
    acceleration, drag           0.92 0.97 1.01 1.06  1.22  0.65
    acceleration, bilinear       0.91 1.00 1.08 1.23  1.57  0.28
    acceleration, stops          1.15 1.27 1.69 3.49 13.20  0.00
    acceleration, coulomb        1.19 1.56 3.44 6.48 30.00  0.05

Of the 720 floors, 3 with a standard error below 0.15 were more than 1.3 times too high, all from accelerations.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from modal.discrepancy.noise.repeats import Scatter, exact_period, period_scatter, repeat_scatter, repeated_records
from modal.discrepancy.noise.spectral import SpectralFloor, smallest_variance, spectral_floor
from modal.localisation.lines import measure_lines
from okid.arrays import FloatArray, frozen_with_gaps
from okid.errors import InvalidDataError
from okid.record import Record
from okid.rows import as_records

__all__ = ["FloorMethod", "NoiseFloor", "lowered_floor", "noise_floor"]

FloorMethod = Literal["repeated records", "repeated periods", "quiet band", "incoherent part"]

_SAME_LEVEL = 1.25
"""Scatter over level of the spectrum up to which both are the same noise."""
_NARROW = 25.0
"""Samples that are as sure as one of white noise (6 to 10 in noise that is ten times as strong at low frequencies)
above which a scatter beyond that level is motion at a resonance: a response that has not settled, or never repeats."""
_NO_NOISE = 30.0
"""Scatter over level above which it is motion whatever its spectrum."""
_DRIVEN = 0.3
"""Share of a band's level from which on the inputs drive it."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class NoiseFloor:
    """Variance of the noise of every output of every record.

    Attributes:
        variance: (n_records, n_outputs) [unit^2].
        method: one a record.
        reason: one a record, in words: from what, and how sure.
        standard_error: (n_records, n_outputs) relative standard deviation of `variance`; above about 0.3 the floor is
            rather an upper limit.
        random: (n_records, n_outputs) what differs from one repeat to the next; nan where nothing repeats.
        distortion: (n_records, n_outputs) mean square at the lines that a periodic input leaves out, the least that
            the nonlinearity makes; nan where no period shows it.
    """

    variance: FloatArray
    method: tuple[FloorMethod, ...]
    reason: tuple[str, ...]
    standard_error: FloatArray
    random: FloatArray
    distortion: FloatArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Floor:
    """One record's row of a `NoiseFloor`."""

    variance: FloatArray
    method: FloorMethod
    reason: str
    standard_error: FloatArray
    random: FloatArray
    distortion: FloatArray


def noise_floor(records: Record | Sequence[Record]) -> NoiseFloor:
    """Estimate the noise of each output: from repeats where there are any, else from the quiet part of the spectrum.

    Args:
        records: one or several of one system; lengths may differ, outputs may miss samples.

    Raises:
        InvalidDataError: records that do not belong together.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> force = rng.standard_normal(4000)
        >>> moved = np.convolve(force, 0.9 ** np.arange(60))[:4000] + 0.05 * rng.standard_normal(4000)
        >>> floor = noise_floor(Record(force, moved, 0.01))
        >>> print(f"{floor.method[0]}, {floor.variance[0, 0]:.4f}")
        incoherent part, 0.0025
    """
    several = as_records(records)
    spectral = [spectral_floor(record) for record in several]
    repeated: dict[int, tuple[Scatter | None, str]] = {}
    for group in repeated_records(several):
        scatter = repeat_scatter([several[i].outputs for i in group])
        repeated |= {i: (scatter, f"{len(group)} records of the same input") for i in group}
    found = []
    for number, (record, spectrum) in enumerate(zip(several, spectral, strict=True)):
        if number in repeated:
            scatter, words = repeated[number]
            found.append(_repeated(record, spectrum, scatter, words, "repeated records"))
            continue
        period = exact_period(record)
        if period is None:
            found.append(_of_spectrum(record, spectrum))
            continue
        words = f"{record.n_samples / period:.3g} periods of {period} samples"
        found.append(_repeated(record, spectrum, period_scatter(record.outputs, period), words, "repeated periods"))
    return _stacked(found)


def lowered_floor(floor: NoiseFloor, records: Record | Sequence[Record], residuals: Sequence[FloatArray]) -> NoiseFloor:
    """The floor, lower where the residual of a model shows less noise than the records alone did.

    Noise is in the residual of any model; a model that explains part of a distortion uncovers the noise below it. The
    residual's own quiet band is taken where it is both lower and surer; a floor from repeats stays as it is.

    Args:
        floor: of these records.
        records: measured.
        residuals: (n_samples, n_outputs) a record, measured minus simulated; NaN where either is missing. A model
            fitted to these very samples with many parameters takes some of the noise away: few for many samples.

    Raises:
        InvalidDataError: other numbers of records, samples or outputs than the floor and the records have.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> force = rng.standard_normal(3000)
        >>> measured = force + np.sign(np.sin(0.1 * np.arange(3000))) + 0.01 * rng.standard_normal(3000)
        >>> floor = noise_floor(Record(force, measured, 0.01))
        >>> left = measured - force - np.sign(np.sin(0.1 * np.arange(3000)))
        >>> lower = lowered_floor(floor, Record(force, measured, 0.01), [left[:, np.newaxis]])
        >>> print(f"{floor.variance[0, 0]:.1e} sure to {floor.standard_error[0, 0]:.1f}, {lower.variance[0, 0]:.1e}")
        9.3e-03 sure to 1.7, 9.8e-05
    """
    several = as_records(records)
    shapes = [record.outputs.shape for record in several]
    if [np.shape(residual) for residual in residuals] != shapes or floor.variance.shape != (len(shapes), shapes[0][1]):
        raise InvalidDataError(
            f"residuals and floor must be those of the {len(shapes)} records, (n_samples, n_outputs) {shapes}, but the "
            f"residuals are {[np.shape(residual) for residual in residuals]} and the floor is {floor.variance.shape}."
        )
    variance, error = np.array(floor.variance), np.array(floor.standard_error)
    reasons = list(floor.reason)
    for i, (record, residual) in enumerate(zip(several, residuals, strict=True)):
        if floor.method[i] not in ("quiet band", "incoherent part"):
            continue
        left = spectral_floor(record, residual)
        lower = (left.variance < variance[i]) & (left.standard_error < error[i])
        variance[i, lower], error[i, lower] = left.variance[lower], left.standard_error[lower]
        if lower.any():
            reasons[i] += f" Lower by the residual of a model: {left.words(record, lower)}."
    return NoiseFloor(
        variance=frozen_with_gaps(variance, name="variance"),
        method=floor.method,
        reason=tuple(reasons),
        standard_error=frozen_with_gaps(error, name="standard_error"),
        random=floor.random,
        distortion=floor.distortion,
    )


def _stacked(found: Sequence[_Floor]) -> NoiseFloor:
    return NoiseFloor(
        variance=frozen_with_gaps([one.variance for one in found], name="variance"),
        method=tuple(one.method for one in found),
        reason=tuple(one.reason for one in found),
        standard_error=frozen_with_gaps([one.standard_error for one in found], name="standard_error"),
        random=frozen_with_gaps([one.random for one in found], name="random"),
        distortion=frozen_with_gaps([one.distortion for one in found], name="distortion"),
    )


def _of_spectrum(record: Record, spectrum: SpectralFloor, *, why: str = "") -> _Floor:
    unknown = np.full(record.n_outputs, np.nan)
    return _Floor(
        variance=spectrum.variance,
        method="incoherent part" if (spectrum.driven_share > _DRIVEN).any() else "quiet band",
        reason=f"{why}{spectrum.words(record)}; taken to be white.",
        standard_error=spectrum.standard_error,
        random=unknown,
        distortion=unknown,
    )


def _repeated(
    record: Record, spectrum: SpectralFloor, scatter: Scatter | None, words: str, method: FloorMethod
) -> _Floor:
    """The scatter of repeats where it is noise; the spectrum where the responses have not settled to repeating."""
    if scatter is None:
        return _of_spectrum(record, spectrum, why=f"{words}, but the transient never dies out or too few are left: ")
    ratio = scatter.variance / np.maximum(spectrum.variance, smallest_variance(record))
    coloured = ratio > _SAME_LEVEL + 2.0 * spectrum.standard_error
    if ((ratio > _NO_NOISE) | (coloured & (scatter.memory > _NARROW))).any():
        why = f"{words}, but the responses differ by up to {ratio.max():.2g} times the level of the quiet band: "
        return _of_spectrum(record, spectrum, why=why)
    error = np.where(coloured, np.maximum(scatter.standard_error, 1.0 - 1.0 / ratio), scatter.standard_error)
    dropped = f" after a transient of {scatter.n_dropped} samples" if scatter.n_dropped else ""
    more = (
        f"; that is up to {ratio.max():.2g} times the level of the quiet band, so it is not white, or not only noise"
        if coloured.any()
        else ""
    )
    return _Floor(
        variance=np.maximum(scatter.variance, smallest_variance(record)),
        method=method,
        reason=f"{words} differ{dropped}: {scatter.n_rows} samples, sure to {100 * error.max():.2g} %{more}.",
        standard_error=error,
        random=scatter.variance,
        distortion=_line_distortion(record),
    )


def _line_distortion(record: Record) -> FloatArray:
    """Mean square of the response at lines that the input leaves out, less its noise."""
    lines = measure_lines(record).records[0]
    if lines is None:
        return np.full(record.n_outputs, np.nan)
    above = np.where(lines.shows[1:], lines.power[1:] - lines.noise[1:], 0.0)
    result: FloatArray = np.array(lines.counts[1:], dtype=np.float64) @ above
    return result
