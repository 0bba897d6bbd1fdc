"""Missing output samples filled by a model of the record itself, so that a long observer finds whole rows.

An observer of order p needs p + 1 whole rows in succession: 1 % of the samples missing at random leave 13 % of the rows
at order 200, and outputs sampled at different rates leave none. The regression of outputs on past INPUTS alone needs
only the outputs that are there. It gives a first model; its free run fills the gaps, what it leaves at the neighbouring
measured samples is interpolated by its own correlation (the smoothed estimate, which a Kalman smoother would give too),
an observer is fitted to the filled record, and so on while the free run comes nearer to the measured samples.

An output at every twentieth row cannot tell a frequency from its images, and a decay is its own pulse response: the
regression then leaves zeros between the rows. Outputs that are measured far more often know the poles; the others show
the states that these have.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from era.realisation import Realisation
from modal.estimation.cross_validation import GAIN, scaled_record
from modal.estimation.fits import model_runs
from modal.estimation.free_run import ModalForm, ModalRecursion, free_runs, initial_state
from modal.modes.mode import Choice
from modal.preparation.quick_model import QuickModel, best_model, observer_markov
from okid.arrays import BoolArray, FloatArray
from okid.markov import MarkovParameters
from okid.record import Record
from okid.rows import usable_rows
from okid.scaling import channel_scaling

LEAST_ROWS = 0.75
"""Share of the rows that gaps must leave at that order; below it they are filled."""
FIRST_RIDGE = 1e-3
FAR_MORE = 2.0
"""Let outputs that are measured so many times as often as another tell its poles."""
NEIGHBOURS = 6
"""Measured samples on either side that a missing one is interpolated from."""
NUGGET = 0.02
"""Of the variance, added where an estimated correlation need not be positive definite."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Filling:
    """Records without missing outputs, and what was done.

    Attributes:
        records: with every missing output filled; the records given where nothing was filled.
        measured: (n_samples, n_outputs) a record, False where a sample was filled.
        choices: empty where nothing was filled.
    """

    records: tuple[Record, ...]
    measured: tuple[BoolArray, ...]
    choices: tuple[Choice, ...]


def fill_where_needed(records: Sequence[Record]) -> Filling:
    """Fill missing outputs where they would leave too few whole rows; else leave them missing, which loses nothing.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> force = rng.standard_normal((800, 1))
        >>> moved = np.convolve(force[:, 0], [0.0, 1.0, 0.5, 0.2])[:800]
        >>> every_second = np.where(np.arange(800) % 2, np.nan, moved)
        >>> filling = fill_where_needed([Record(force, every_second, 0.01)])
        >>> bool(np.abs(filling.records[0].outputs[10:, 0] - moved[10:]).max() < 0.05 * moved.std())
        True
    """
    measured = tuple(~np.isnan(record.outputs) for record in records)
    share, order = _whole_rows(records)
    if share >= LEAST_ROWS:
        return Filling(records=tuple(records), measured=measured, choices=())
    scaling = channel_scaling(records)
    scaled = tuple(scaled_record(record, scaling) for record in records)
    done, how = _filled(scaled)
    filled = tuple(
        replace(
            record, outputs=np.where(there, record.outputs, one.outputs * scaling.output_scale + scaling.output_mean)
        )
        for record, there, one in zip(records, measured, done, strict=True)
    )
    n_missing = sum(int((~there).sum()) for there in measured)
    choice = Choice(
        what="missing outputs",
        value=f"{n_missing} samples filled",
        reason=f"an observer of order {order} would find {100 * share:.2g} % of its rows whole; {how}",
    )
    return Filling(records=filled, measured=measured, choices=(choice,))


def refilled(records: Sequence[Record], measured: Sequence[BoolArray], model: Realisation) -> tuple[Record, ...]:
    """The records with filled samples as a driven model makes them, with what it leaves of those beside.

    Args:
        records: with all outputs that are to be filled.
        measured: (n_samples, n_outputs) a record, False where a sample was filled, or is missing still.
        model: of the samples that were measured.
    """
    filled = [np.isfinite(record.outputs) & ~there for record, there in zip(records, measured, strict=True)]
    left = model_runs(replace(model, K=None), records).left
    runs = [record.outputs - errors for record, errors in zip(records, left, strict=True)]
    told = [there & np.isfinite(record.outputs) for record, there in zip(records, measured, strict=True)]
    gaps = [replace(one, outputs=np.where(own, one.outputs, np.nan)) for one, own in zip(records, told, strict=True)]
    bridged = _bridged(gaps, runs)
    return tuple(
        replace(record, outputs=np.where(own, new.outputs, record.outputs))
        for record, own, new in zip(records, filled, bridged, strict=True)
    )


def holds_filled(records: Sequence[Record], measured: Sequence[BoolArray]) -> bool:
    """Whether some sample was filled: it is there, and was not measured."""
    return any((np.isfinite(record.outputs) & ~own).any() for record, own in zip(records, measured, strict=True))


def _whole_rows(records: Sequence[Record]) -> tuple[float, int]:
    """Share of the rows that are whole with their past, of those there would be without gaps; and the order."""
    longest = max(record.n_samples for record in records)
    order = min(64, longest // 4)
    possible = sum(max(0, record.n_samples - order) for record in records)
    whole = sum(int(usable_rows(record.complete_rows(), order).sum()) for record in records)
    return whole / possible, order


def _filled(records: Sequence[Record]) -> tuple[tuple[Record, ...], str]:
    """Scaled records with their gaps filled, and how in words."""
    markov = _first_markov(records) if records[0].n_inputs else None
    tried = (None if markov is None else best_model(markov, records), _by_the_fuller(records))
    model = min((one for one in tried if one is not None), key=lambda one: one.error, default=None)
    if model is None:
        words = "by what other outputs show where they were measured, the rest interpolated by its own correlation"
        return _bridged(records, _beside_others(records)), words
    filled, rounds = _bridged(records, free_runs(model.form, records)), 1
    while rounds < 8:
        markov = observer_markov(filled)
        candidate = None if markov is None else best_model(markov, records)
        if candidate is None or candidate.error >= model.error:
            break
        filled, rounds = _bridged(records, free_runs(candidate.form, records)), rounds + 1
        small, model = candidate.error > GAIN * model.error, candidate
        if small:
            break
    words = f"filled by the free run of a model of the measured samples and what it left beside them, {rounds} rounds"
    return filled, words


def measured_instead(there: BoolArray, i: int) -> list[int]:
    """Outputs that were measured in most rows in which output i was not, and in most in which it was: these tell it.

    Args:
        there: (n_samples, n_outputs) True where an output was measured.
        i: the output.
    """
    own = there[:, i]
    if own.all() or not own.any():
        return []
    least = np.minimum(there[own].mean(axis=0), there[~own].mean(axis=0))
    return np.flatnonzero(least >= LEAST_ROWS).tolist()


def _beside_others(records: Sequence[Record]) -> tuple[FloatArray, ...]:
    """(n_samples, n_outputs) a record: each output by regression on those around that were measured where it was not.

    An output interpolated by itself dies out in a long gap, and at a low rate shows each line once more at its images;
    the others know which of them is true. Zero where no other was measured in most of the rows.
    """
    there = np.vstack([np.isfinite(record.outputs) for record in records])
    alone = _bridged(records, tuple(np.zeros_like(record.outputs) for record in records))
    runs = tuple(np.zeros_like(record.outputs) for record in records)
    for i in np.flatnonzero(~there.all(axis=0)):
        helpers = measured_instead(there, int(i))
        n_around = min(NEIGHBOURS, int(there[:, i].sum() // (8 * max(1, len(helpers)))))
        if not helpers or n_around < 1:
            continue
        around = [np.pad(record.outputs[:, helpers], ((n_around, n_around), (0, 0))) for record in alone]
        rows = [np.lib.stride_tricks.sliding_window_view(one, 2 * n_around + 1, axis=0) for one in around]
        columns = [one.reshape(len(one), -1) for one in rows]
        wanted = np.concatenate([record.outputs[:, i] for record in records])
        told = np.vstack(columns)[there[:, i]]
        weights = np.linalg.lstsq(told, wanted[there[:, i]], rcond=FIRST_RIDGE)[0]
        for run, one, itself in zip(runs, columns, alone, strict=True):
            run[:, i] = one @ weights
            for ends in (slice(0, n_around), slice(max(0, len(run) - n_around), None)):  # not all are around
                run[ends, i] = itself.outputs[ends, i]
    return runs


def _by_the_fuller(records: Sequence[Record]) -> QuickModel | None:
    """A model of the outputs that are measured far more often than others, and what the others show of its states.

    None where all are measured about as often, or no inputs were measured.
    """
    counts = sum(np.isfinite(record.outputs).sum(axis=0) for record in records)
    fuller = FAR_MORE * counts > counts.max()
    if fuller.all() or not records[0].n_inputs:
        return None
    own = tuple(record.select(outputs=np.flatnonzero(fuller).tolist()) for record in records)
    whole = own if _whole_rows(own)[0] >= LEAST_ROWS else _filled(own)[0]
    markov = observer_markov(whole)
    model = None if markov is None else best_model(markov, own)
    if model is None:
        return None
    form, n_outputs = model.form, records[0].n_outputs
    columns = [_answers(form, record) for record in own]
    shapes = np.zeros((n_outputs, form.poles.size), dtype=np.complex128)
    feedthrough = np.zeros((n_outputs, form.feedthrough.shape[1]))
    shapes[fuller], feedthrough[fuller] = form.shapes, form.feedthrough
    for i in np.flatnonzero(~fuller):
        there = [np.isfinite(record.outputs[:, i]) for record in records]
        rows = [np.column_stack([one[rows], np.ones(rows.sum())]) for one, rows in zip(columns, there, strict=True)]
        wanted = [record.outputs[rows, i] for record, rows in zip(records, there, strict=True)]
        found = np.linalg.lstsq(np.vstack(rows), np.concatenate(wanted), rcond=FIRST_RIDGE)[0]
        n = form.poles.size
        shapes[i], feedthrough[i] = found[:n] - 1j * found[n : 2 * n], found[2 * n : -1]
    form = replace(form, shapes=shapes, feedthrough=feedthrough)
    left = [record.outputs - run for record, run in zip(records, free_runs(form, records), strict=True)]
    error = float(np.sqrt(np.nanmean(np.square(np.vstack(left)))))
    return QuickModel(form=form, error=error, forgets=model.forgets)


def _answers(form: ModalForm, record: Record) -> FloatArray:
    """(n_samples, 2 n_poles + n_inputs) what an output may show: states times their weights, both parts, and inputs."""
    n = form.poles.size
    both = np.vstack([np.eye(n), -1j * np.eye(n)])
    seen = replace(form, shapes=both, feedthrough=np.zeros((2 * n, record.n_inputs)))
    recursion = ModalRecursion.of_model(seen)
    states = recursion.from_rest(record.inputs)
    n_alive = recursion.n_alive(record.n_samples)
    start = initial_state(form, record, np.isfinite(record.outputs))
    states[:n_alive] += recursion.free_response(start, n_alive)
    return np.column_stack([states, record.inputs])


def _first_markov(records: Sequence[Record]) -> MarkovParameters | None:
    """Pulse response by least squares of each output on past inputs, over the samples at which it was measured."""
    n_inputs, n_outputs = records[0].n_inputs, records[0].n_outputs
    present = min(sum(int((~np.isnan(record.outputs[:, i])).sum()) for record in records) for i in range(n_outputs))
    longest = max(record.n_samples for record in records)
    n_lags = min(128, present // (3 * n_inputs), longest // 4)
    if n_lags < 4:  # a Hankel matrix of two block rows and columns needs four lags
        return None
    width = (n_lags + 1) * n_inputs
    own, cross = np.zeros((n_outputs, width, width)), np.zeros((n_outputs, width))
    counts = np.zeros(n_outputs)
    patterns = _patterns(records)
    for record in records:
        if record.n_samples <= n_lags:
            continue
        for first in range(n_lags, record.n_samples, 4096):
            last = min(first + 4096, record.n_samples)
            lags = np.lib.stride_tricks.sliding_window_view(record.inputs[first - n_lags : last], n_lags + 1, axis=0)
            rows = lags[:, :, ::-1].transpose(0, 2, 1).reshape(last - first, width)
            for outputs in patterns:
                there = ~np.isnan(record.outputs[first:last, outputs[0]])
                part = rows[there]
                own[outputs] += part.T @ part
                cross[outputs] += (part.T @ record.outputs[first:last, outputs][there]).T
                counts[outputs] += there.sum()
    penalty = np.repeat(1.0 + np.arange(n_lags + 1.0), n_inputs) * FIRST_RIDGE
    pulse = np.empty((n_lags + 1, n_outputs, n_inputs))
    for i in range(n_outputs):
        pulse[:, i] = np.linalg.solve(own[i] + np.diag(penalty * counts[i]), cross[i]).reshape(n_lags + 1, n_inputs)
    return MarkovParameters(system=pulse, dt=records[0].dt)


def _patterns(records: Sequence[Record]) -> list[list[int]]:
    """Outputs that are missing together in all records."""
    together: dict[bytes, list[int]] = {}
    for i in range(records[0].n_outputs):
        key = b"".join(np.packbits(np.isnan(record.outputs[:, i])).tobytes() for record in records)
        together.setdefault(key, []).append(i)
    return list(together.values())


def _bridged(records: Sequence[Record], runs: Sequence[FloatArray]) -> tuple[Record, ...]:
    """The records with missing samples at the run plus what it leaves of their measured neighbours."""
    left = [record.outputs - run for record, run in zip(records, runs, strict=True)]
    filled = [np.array(record.outputs) for record in records]
    for i in range(records[0].n_outputs):
        correlation = _correlation([one[:, i] for one in left])
        for one, run, rest in zip(filled, runs, left, strict=True):
            missing = np.flatnonzero(np.isnan(rest[:, i]))
            if missing.size:
                one[missing, i] = run[missing, i] + _interpolated(rest[:, i], missing, correlation)
    return tuple(replace(record, outputs=one) for record, one in zip(records, filled, strict=True))


def _correlation(parts: Sequence[FloatArray]) -> FloatArray:
    """(4 NEIGHBOURS + 1,) autocovariance over the pairs that are there, tapered.

    A lag without a pair (outputs at every second row) gets the value of the next longer one: no more than is known.
    """
    n_lags = 4 * NEIGHBOURS
    sums, counts = np.zeros(n_lags + 1), np.zeros(n_lags + 1)
    for part in parts:
        there = ~np.isnan(part)
        values = np.where(there, part, 0.0)
        for lag in range(min(n_lags, part.size - 1) + 1):
            sums[lag] += values[lag:] @ values[: part.size - lag]
            counts[lag] += np.count_nonzero(there[lag:] & there[: part.size - lag])
    known = counts > 0
    lags = np.arange(n_lags + 1.0)
    longer = np.flatnonzero(known)[np.minimum(np.searchsorted(np.flatnonzero(known), lags), known.sum() - 1)]
    covariance = np.where(known[longer], sums[longer] / np.maximum(counts[longer], 1.0), 0.0)
    result: FloatArray = covariance * (1.0 - lags / (n_lags + 1.0))
    return result


def _interpolated(values: FloatArray, missing: np.ndarray, correlation: FloatArray) -> FloatArray:
    """Best linear estimate of missing values from their measured neighbours, for this autocovariance."""
    measured = np.flatnonzero(~np.isnan(values))
    if measured.size == 0 or correlation[0] <= 0.0:
        return np.zeros(missing.size)
    beside = np.searchsorted(measured, missing)[:, np.newaxis] + np.arange(-NEIGHBOURS, NEIGHBOURS)
    inside = (beside >= 0) & (beside < measured.size)
    places = measured[np.clip(beside, 0, measured.size - 1)]
    longest = correlation.size - 1
    padded = np.append(correlation, 0.0)

    def covariance(distance: np.ndarray) -> FloatArray:
        value: FloatArray = padded[np.minimum(np.abs(distance), longest + 1)]
        return value

    between = covariance(places[:, :, np.newaxis] - places[:, np.newaxis, :])
    both = inside[:, :, np.newaxis] & inside[:, np.newaxis, :]
    between = np.where(both, between, 0.0) + NUGGET * correlation[0] * np.eye(2 * NEIGHBOURS)
    between += np.where(inside, 0.0, correlation[0])[:, :, np.newaxis] * np.eye(2 * NEIGHBOURS)
    towards = np.where(inside, covariance(places - missing[:, np.newaxis]), 0.0)
    weights = np.linalg.solve(between, towards[:, :, np.newaxis])[:, :, 0]
    estimate: FloatArray = (weights * np.where(inside, values[places], 0.0)).sum(axis=1)
    return estimate
