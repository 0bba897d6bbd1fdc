"""What the sensor of a force erred by while a blow acted, as far as what followed tells.

Between blows a force window makes the force zero: nothing acts. Within a blow the sensor errs as much, and all that
follows is the answer to what acted, not to what it showed: each blow's answer is then off by a little of its own, many
times the noise of the outputs where that is small. With errors e of the force, white, of the variance that it shows at
rest, what is left is

    r = T e + n,   T = the answers to unit pulses,   var n = R,   var e = Q

and the likeliest e, for a model, is (T' R^-1 T + Q^-1)^-1 T' R^-1 r (Gauss-Markov, with what the sensor is known by as
the prior). Less of that, and refined again, the model is the likeliest for both noises. Rows in which a blow acts are
not asked, only what follows: what a blow does beyond half the sampling rate ends with it.

What is left may say no: errors larger than the sensor's are of something else (a structure that is not linear answers
each blow as differently), and the force stays as it was measured.

References:
    Van Huffel and Vandewalle, The Total Least Squares Problem, SIAM, 1991, doi:10.1137/1.9781611971002, chapter 8.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import scipy

from modal.estimation.free_run import ModalRecursion
from modal.estimation.modal_parameters import errors_of
from modal.estimation.output_error import OutputError, RefinementStep, refine, step_at
from modal.estimation.weights import UNTIL_STILL, Weighted, weighted
from okid.arrays import TINY, BoolArray, FloatArray

CHUNK_VALUES = 1 << 21
"""Values of answers at a time."""
MOST = 1000
"""Errors of a record's forces up to which all of them are told together."""
CHANCE = 1e-3
"""Errors as large as those that are left are of the sensor unless so seldom by chance."""
TURNS = 10
"""Turns in which forces and model settle,"""
STANDS_STILL = 1e-3
"""or until a turn moves the error by no more than this share of it."""
TOLD = 1e-6
"""A combination of the force's errors is told by what follows from so much of the noise's power on."""


def forces_told(
    step: RefinementStep,
    data: OutputError,
    told: OutputError,
    *,
    acting: Sequence[BoolArray],
    variances: FloatArray,
    least_gain: float,
) -> tuple[Weighted, tuple[FloatArray, ...]]:
    """Weighted, with the likeliest forces by turns until neither moves.

    Args:
        step: the model.
        data: with forces as they were measured.
        told: the same with the likeliest ones so far, to which the model was fitted.
        acting: (n_samples,) a record, True where a blow acts.
        variances: (n_records, n_inputs) of the noise of the forces, of the data.
        least_gain: relative decrease of the error by a step below which it is the last.

    Returns:
        The model, and (n_samples, n_inputs) a record, what the forces of the data erred by; none where what is left is
        larger than noise of the sensors makes it, and then forces are as they were measured.
    """
    plain = weighted(step, told, least_gain)
    if not variances.any():
        return plain, ()
    triples = zip(plain.data.records, data.records, plain.record_scale, strict=True)
    records = tuple(replace(one, inputs=own.inputs / size) for one, own, size in triples)
    own_variances = variances / np.square(plain.record_scale)[:, np.newaxis]
    again, now, errors = by_turns(
        plain.step, replace(plain.data, records=records), acting, own_variances, least_gain, weights=plain.weights
    )
    if not errors:
        return weighted(step_at(step.parameters, data), data, least_gain), ()
    settled = weighted(again, now, least_gain)
    erred = tuple(own * size for own, size in zip(errors, plain.record_scale, strict=True))
    return replace(settled, record_scale=plain.record_scale * settled.record_scale), erred


def by_turns(
    step: RefinementStep,
    data: OutputError,
    acting: Sequence[BoolArray],
    variances: FloatArray,
    least_gain: float,
    *,
    weights: FloatArray | None = None,
) -> tuple[RefinementStep, OutputError, tuple[FloatArray, ...]]:
    """The model and the likeliest forces by turns until neither moves.

    Args:
        step: the model.
        data: with forces as they were measured.
        acting: (n_samples,) a record, True where a blow acts.
        variances: (n_records, n_inputs) of the noise of the forces, of the data.
        least_gain: relative decrease of the error by a step below which it is the last.
        weights: (n_outputs, n_outputs) of the squared errors.

    Returns:
        The model, data with the likeliest forces, and what those that were measured erred by; as it was and none where
        what is left is larger than noise of the sensors makes it.
    """
    now, told = step, data
    errors: tuple[FloatArray, ...] = ()
    for _ in range(TURNS if variances.any() and step.layout.n_poles else 0):
        errors = _errors(now, data, [~rows for rows in acting], variances)
        if not errors:
            return step, data, ()
        pairs = zip(data.records, errors, strict=True)
        told = replace(data, records=tuple(replace(one, inputs=one.inputs - own) for one, own in pairs))
        begun = step_at(now.parameters, told, weights=weights)
        now = refine(begun, told, n_steps=UNTIL_STILL, least_gain=least_gain, weights=weights)[-1]
        if now.error > (1.0 - STANDS_STILL) * begun.error:
            break
    return now, told, errors


def _errors(
    step: RefinementStep, data: OutputError, quiet: Sequence[BoolArray], variances: FloatArray
) -> tuple[FloatArray, ...]:
    """(n_samples, n_inputs) a record, the likeliest errors of the forces; none where what is left is not of them.

    Args:
        step: the model.
        data: with forces as they were measured.
        quiet: (n_samples,) a record, False where a blow acts.
        variances: (n_records, n_inputs) of the noise of the forces; zero where there is none.
    """
    pairs = zip(quiet, errors_of(step, data), strict=True)
    asked = [np.where(rows[:, np.newaxis], own, np.nan) for rows, own in pairs]
    counts = np.sum([np.isfinite(own).sum(axis=0) for own in asked], axis=0)
    noise = np.sqrt(np.sum([np.nansum(np.square(own), axis=0) for own in asked], axis=0) / np.maximum(counts, 1) + TINY)
    found, size, number = [], 0.0, 0
    for record, own, variance in zip(data.records, asked, variances, strict=True):
        moves = record.inputs != np.median(record.inputs, axis=0)  # a force window leaves no noise elsewhere
        row, which = np.nonzero(moves & (variance > 0.0))
        if row.size > MOST:
            return ()
        found.append(np.zeros_like(record.inputs))
        if not row.size:
            continue
        drives, kind = np.unique(which, return_inverse=True)
        gram, product = _told(_pulses(step, drives, record.n_samples) / noise, row, kind, own / noise)
        deviation = np.sqrt(variance[which])
        told, directions = scipy.linalg.eigh(gram * np.outer(deviation, deviation))
        told = np.maximum(told, 0.0)
        score = directions.T @ (deviation * product)
        seen = told > TOLD
        size += float((score[seen] ** 2 / (told[seen] * (1.0 + told[seen]))).sum())
        number += int(seen.sum())
        found[-1][row, which] = -deviation * (directions @ (score / (1.0 + told)))  # what was not there made no answer
    return tuple(found) if number and scipy.special.chdtrc(number, size) > CHANCE else ()


def _pulses(step: RefinementStep, drives: npt.NDArray[np.intp], n: int) -> FloatArray:
    """(n_drives, n_alive, n_outputs) answers to unit pulses of these inputs, until they have died out."""
    layout, first = step.layout, 2 * step.layout.n_poles
    direct = np.zeros((layout.n_outputs, layout.n_inputs))
    direct[:, : layout.n_direct] = step.linear.coefficients[first : first + layout.n_direct].T
    recursion = ModalRecursion.of(step.parameters.poles, step.parameters.inputs, step.linear.shapes, direct)
    answers = []
    for drive in drives:
        pulse = np.zeros((recursion.n_alive(n), layout.n_inputs))
        pulse[0, drive] = 1.0
        answers.append(recursion.from_rest(pulse))
    return np.array(answers)


def _told(
    pulses: FloatArray, row: npt.NDArray[np.intp], kind: npt.NDArray[np.intp], errors: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """T'T and T'r of pulses, each of one kind, in these rows."""
    gram, product = np.zeros((row.size, row.size)), np.zeros(row.size)
    chunk = max(1, CHUNK_VALUES // (row.size * errors.shape[1]))
    for first in range(0, len(errors), chunk):
        own = errors[first : first + chunk]
        since = np.arange(first, first + len(own))[:, np.newaxis] - row
        alive = ((since >= 0) & (since < pulses.shape[1]))[..., np.newaxis] & np.isfinite(own)[:, np.newaxis, :]
        answers = np.where(alive, pulses[kind, since.clip(0, pulses.shape[1] - 1)], 0.0)
        flat = answers.transpose(0, 2, 1).reshape(-1, row.size)
        gram += flat.T @ flat
        product += flat.T @ np.nan_to_num(own).ravel()
    return gram, product
