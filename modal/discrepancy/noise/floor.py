"""How much of each output is noise: the mean square that no model can explain, from the records alone.

Everything that the workflow decides is a ratio to this number, so it comes with the way it was found and with its
standard error. In order of trust:

1. repeated records: the same input twice. The difference of the two responses holds twice the variance of all that does
   not repeat, whatever its spectrum. It begins with a transient, since the states at the start were not the same; that
   part is left out: it is the model's to explain, not noise.
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
(`pytest -m slow -s tests/modal/discrepancy/noise/test_noise_floor.py` prints it):

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
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy

from modal.discrepancy.noise.spectral import FEWEST_ROWS, SpectralFloor, smallest_variance, spectral_floor
from modal.localisation.lines import input_period, measure_lines
from modal.simulation import UNLIKELY
from okid.arrays import ROUNDED, FloatArray, frozen_with_gaps
from okid.display import Displayed
from okid.errors import InvalidDataError
from okid.record import Record
from okid.rows import as_records

SAME_NUMBER = 1e-6
"""Take numbers for the same that differ by less than this share, as after a way through a text file."""
_SAME_PERIOD = 1e-7
"""Take an input for periodic where periods differ by less than this share of the mean square: the response to that
stays below a tenth of noise of 0.1 %."""
_N_BLOCKS = 24
"""Look for the end of a transient in so many blocks."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Scatter:
    """What does not repeat.

    Attributes:
        variance: (n_outputs,) of one response [unit^2].
        standard_error: (n_outputs,) relative.
        memory: (n_outputs,) samples that are as sure as one of white noise; large for a narrow band.
        n_rows: differences behind it, after the transient.
        n_dropped: samples left out as transient.
    """

    variance: FloatArray
    standard_error: FloatArray
    memory: FloatArray
    n_rows: int
    n_dropped: int


def repeated_records(records: Sequence[Record]) -> tuple[tuple[int, ...], ...]:
    """Groups of records that had the same input, sample by sample, and are not copies of each other.

    Records of different lengths belong together when the shorter holds half of the longer at least; an input that never
    moves makes no repeats (free decays from different starts).

    Example:
        >>> u, e = np.sin(np.arange(100.0)), np.cos(np.arange(100.0) ** 2)
        >>> records = [Record(u, u + 0.1 * e, 0.1), Record(u, u - 0.1 * e, 0.1), Record(2 * u, 2 * u, 0.1)]
        >>> repeated_records(records)
        ((0, 1),)
    """
    groups: list[list[int]] = []
    for number, record in enumerate(records):
        for group in groups:
            if _same_input(records[group[0]], record) and not any(_copies(records[i], record) for i in group):
                group.append(number)
                break
        else:
            groups.append([number])
    return tuple(tuple(group) for group in groups if len(group) > 1)


def exact_period(record: Record) -> int | None:
    """Period [samples] at which the inputs repeat so well that the response to what differs is nothing beside noise.

    An input that was measured with noise of its own has a period (`input_period`), but no exact one.

    Example:
        >>> force = np.tile(np.random.default_rng(0).standard_normal(50), 3)
        >>> exact_period(Record(force, force, 0.1))
        50
        >>> measured = force + 0.01 * np.cos(np.arange(150.0) ** 2)
        >>> exact_period(Record(measured, force, 0.1)) is None
        True
    """
    period = input_period(record)
    if period is None:
        return None
    difference = record.inputs[period:] - record.inputs[:-period]
    largest = 2.0 * _SAME_PERIOD * record.inputs.var(axis=0)
    return period if bool((np.mean(difference**2, axis=0) <= largest).all()) else None


def repeat_scatter(responses: Sequence[FloatArray]) -> Scatter | None:
    """Scatter of responses to the same input; None where they never settle to the same response, or too few are left.

    Args:
        responses: (n_samples, n_outputs) each, the same input from the first sample on; NaN where missing.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> scatter = repeat_scatter([rng.standard_normal((2000, 1)) for _ in range(3)])
        >>> print(f"{scatter.variance[0]:.2f} {scatter.standard_error[0]:.3f}")
        1.01 0.022
    """
    n_rows = min(len(response) for response in responses)
    parts = np.stack([response[:n_rows] for response in responses])
    there = ~np.isnan(parts)
    counts = there.sum(axis=0)
    apart = np.where(there, parts - np.where(there, parts, 0.0).sum(axis=0) / np.maximum(counts, 1), 0.0)
    return _settled((apart**2).sum(axis=0), np.maximum(counts - 1, 0), memory=_memory(apart[0]))


def period_scatter(outputs: FloatArray, period: int) -> Scatter | None:
    """Scatter of one period against the next, for the whole record; None as for `repeat_scatter`.

    Args:
        outputs: (n_samples, n_outputs), NaN where missing.
        period: of the input [samples].

    Example:
        >>> noisy = np.tile(np.arange(200.0), 10)[:, np.newaxis] + np.random.default_rng(0).standard_normal((2000, 1))
        >>> print(f"{period_scatter(noisy, 200).variance[0]:.2f}")
        1.01
    """
    difference = outputs[period:] - outputs[:-period]
    there = ~np.isnan(difference)
    apart = np.where(there, difference, 0.0)
    # neighbouring differences share a period, so that n of them are as sure as 2 n / 3 independent ones
    shared = 1.5 if len(outputs) >= 3 * period else 1.0
    return _settled(0.5 * apart**2, there.astype(np.int_), memory=shared * _memory(apart))


def _memory(apart: FloatArray) -> FloatArray:
    """(n_outputs,) samples for which a mean square is as sure as for one sample of white noise, from the last third.

    The variance of the mean square of n Gaussian samples of spectrum S is 2 / n times mean(S^2) / mean(S)^2, and the
    mean square of a periodogram is twice S^2.
    """
    late = apart[-max(len(apart) // 3, 1) :]
    power = np.abs(np.fft.rfft(late, axis=0)[1:]) ** 2
    mean = power.mean(axis=0) if len(power) else np.zeros(apart.shape[1])
    spread = (power**2).mean(axis=0) / np.where(mean > 0.0, mean, 1.0) ** 2 if len(power) else mean
    return np.maximum(0.5 * spread, 1.0)


def _settled(squares: FloatArray, freedom: np.ndarray, *, memory: FloatArray) -> Scatter | None:
    """Mean square over the rows after the transient; freedom per row and output."""
    n_rows = len(squares)
    if n_rows < FEWEST_ROWS:
        return None
    edges = np.linspace(0, n_rows, _N_BLOCKS + 1).astype(int)
    total = np.add.reduceat(squares, edges[:-1], axis=0)
    count = np.add.reduceat(freedom, edges[:-1], axis=0).astype(np.float64)
    start = _onset(total, count, memory)
    if start is None:
        return None
    first = int(edges[start])
    kept = freedom[first:].sum(axis=0)
    if n_rows - first < FEWEST_ROWS or (kept < FEWEST_ROWS).any():
        return None
    return Scatter(
        variance=squares[first:].sum(axis=0) / kept,
        standard_error=np.sqrt(2.0 * memory / kept),
        memory=memory,
        n_rows=int(n_rows - first),
        n_dropped=first,
    )


def _onset(total: FloatArray, count: FloatArray, memory: FloatArray) -> int | None:
    """First block after the transient: from there on no block stands out, and the end is not quieter than the start."""
    mean, latest = total / np.maximum(count, 1.0), _N_BLOCKS - _N_BLOCKS // 4  # the last quarter is settled
    late = np.median(mean[latest:], axis=0)
    freedom = np.maximum(count.min(axis=0) / memory, 1.0)
    limit = late * scipy.special.gammainccinv(freedom / 2.0, UNLIKELY) * 2.0 / freedom
    loud = np.flatnonzero((mean[:latest] > limit).any(axis=1))
    start = 0 if loud.size == 0 else int(loud[-1]) + 1
    start += min(max(1, start // 2), latest - start) if start else 0  # what is below the limit fades for a while yet
    third = (_N_BLOCKS - start) // 3
    before, after = (
        total[part].sum(axis=0) / np.maximum(count[part].sum(axis=0), 1.0)
        for part in (slice(start, start + third), slice(-third, None))
    )
    spread = np.sqrt(4.0 / (third * freedom))
    return None if (before > (1.0 + 3.0 * spread) * after).any() else start


def _same_input(one: Record, other: Record) -> bool:
    n_rows = min(one.n_samples, other.n_samples)
    if one.n_inputs == 0 or 2 * n_rows < max(one.n_samples, other.n_samples):
        return False
    a, b = one.inputs[:n_rows], other.inputs[:n_rows]
    if np.isnan(a).any() or np.isnan(b).any():
        return False
    moves = np.ptp(a, axis=0)
    return bool(
        moves.max() > 0.0
        and (np.abs(a - b).max(axis=0) <= SAME_NUMBER * np.maximum(moves, np.abs(a).max(axis=0))).all()
    )


def _copies(one: Record, other: Record) -> bool:
    n_rows = min(one.n_samples, other.n_samples)
    a, b = one.outputs[:n_rows], other.outputs[:n_rows]
    both = ~(np.isnan(a) | np.isnan(b))
    size = np.where(both, np.abs(a), 0.0).max(axis=0)
    return bool((np.where(both, np.abs(a - b), 0.0) <= ROUNDED * size).all())


FloorMethod = Literal["repeated records", "repeated periods", "quiet band", "incoherent part"]

_SAME_LEVEL = 1.25
"""Take scatter and level of the spectrum for the same noise up to this ratio."""
_NARROW = 25.0
"""Call a scatter beyond that level motion at a resonance where so many samples are as sure as one of white noise (6 to
10 in noise that is ten times as strong at low frequencies)."""
_NO_NOISE = 30.0
"""Call a scatter motion above this ratio to the level, whatever its spectrum."""
_DRIVEN = 0.3
"""Call a band driven where the inputs explain more than this share of its level."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class NoiseFloor(Displayed):
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

    def of_records(self, chosen: Sequence[int]) -> "NoiseFloor":
        """The rows of some records, in this order; a record may come several times."""
        return stacked_floors([(self, i) for i in chosen])


def stacked_floors(rows: Sequence[tuple[NoiseFloor, int]]) -> NoiseFloor:
    """A floor of records of several floors, each by its floor and its number there."""

    def of(name: Literal["variance", "standard_error", "random", "distortion"]) -> FloatArray:
        return frozen_with_gaps([getattr(floor, name)[i] for floor, i in rows], name=name)

    return NoiseFloor(
        variance=of("variance"),
        method=tuple(floor.method[i] for floor, i in rows),
        reason=tuple(floor.reason[i] for floor, i in rows),
        standard_error=of("standard_error"),
        random=of("random"),
        distortion=of("distortion"),
    )


def _one_floor(
    variance: FloatArray,
    method: FloorMethod,
    reason: str,
    standard_error: FloatArray,
    *,
    random: FloatArray | None = None,
    distortion: FloatArray | None = None,
) -> NoiseFloor:
    """Of one record, from (n_outputs,) each; nan for what nothing shows."""
    unknown = np.full(len(variance), np.nan)
    return NoiseFloor(
        variance=variance[np.newaxis],
        method=(method,),
        reason=(reason,),
        standard_error=standard_error[np.newaxis],
        random=(unknown if random is None else random)[np.newaxis],
        distortion=(unknown if distortion is None else distortion)[np.newaxis],
    )


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
    return stacked_floors([(one, 0) for one in found])


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
            reasons[i] += f" What a fitted model leaves is less and counts instead: {left.words(record, lower)}."
    return replace(
        floor,
        variance=frozen_with_gaps(variance, name="variance"),
        reason=tuple(reasons),
        standard_error=frozen_with_gaps(error, name="standard_error"),
    )


def raised_floor(floor: NoiseFloor, left: FloatArray) -> NoiseFloor:
    """The floor, raised to what a model leaves that depends on nothing: noise that is not as white as its quiet band.

    Args:
        floor: of some records; from repeats it stays as it is.
        left: (n_records, n_outputs) mean square of the model's residual [unit^2].

    Example:
        >>> rng = np.random.default_rng(0)
        >>> force = rng.standard_normal(3000)
        >>> floor = noise_floor(Record(force, force + 0.1 * rng.standard_normal(3000), 0.01))
        >>> raised_floor(floor, np.array([[0.04]])).variance[0, 0]
        np.float64(0.04)
    """
    variance, reasons = np.array(floor.variance), list(floor.reason)
    for i, method in enumerate(floor.method):
        higher = left[i] > variance[i]
        if method in ("quiet band", "incoherent part") and higher.any():
            variance[i, higher] = left[i, higher]
            reasons[i] += " What the model leaves is more, but coloured noise and nothing else, and counts instead."
    return replace(floor, variance=frozen_with_gaps(variance, name="variance"), reason=tuple(reasons))


def _of_spectrum(record: Record, spectrum: SpectralFloor, *, why: str = "") -> NoiseFloor:
    method: FloorMethod = "incoherent part" if (spectrum.driven_share > _DRIVEN).any() else "quiet band"
    reason = f"{why}{spectrum.words(record)}; taken to be white."
    return _one_floor(spectrum.variance, method, reason, spectrum.standard_error)


def _repeated(
    record: Record, spectrum: SpectralFloor, scatter: Scatter | None, words: str, method: FloorMethod
) -> NoiseFloor:
    """The scatter of repeats where it is noise; the spectrum where the responses have not settled to repeating."""
    if scatter is None:
        return _of_spectrum(record, spectrum, why=f"{words}, but the transient never dies out or too few are left: ")
    ratio = scatter.variance / np.maximum(spectrum.variance, smallest_variance(record))
    coloured = ratio > _SAME_LEVEL + 2.0 * spectrum.standard_error
    if ((ratio > _NO_NOISE) | (coloured & (scatter.memory > _NARROW))).any():
        why = f"{words}, but the responses differ by up to {ratio.max():.2g} times the level of the quiet band: "
        return _of_spectrum(record, spectrum, why=why)
    away = np.where(coloured, 1.0 - 1.0 / np.maximum(ratio, 1.0), 0.0)  # exact repeats have a ratio of zero
    error = np.maximum(scatter.standard_error, away)
    dropped = f" after a transient of {scatter.n_dropped} samples" if scatter.n_dropped else ""
    more = (
        f"; that is up to {ratio.max():.2g} times the level of the quiet band, so it is not white, or not only noise"
        if coloured.any()
        else ""
    )
    return _one_floor(
        np.maximum(scatter.variance, smallest_variance(record)),
        method,
        f"{words} differ{dropped}: {scatter.n_rows} samples, known to {50 * error.max():.2g} %{more}.",
        error,
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
