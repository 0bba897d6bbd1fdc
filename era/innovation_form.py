"""One step of Fisher scoring on the gain and on the states that the records start from.

With Abar = A - K C, R the covariance of the innovations e and s the backward run of R^-1 e,

    W = sum Abar'^l C' R^-1 C Abar^l,   g = 1/N sum over k of s(k) e(k)',   dK = W^-1 g R^-1

g gathers the correlation of e with all of its own past, so a step stops where e is as white as the model allows. The
information matrix of K is N W (x) R, so that no matrix larger than the model is ever formed. A step that does not lower
log det R is halved. The start of each record is projected out: for every gain that is tried it is the best one,
W^-1 s(-1) away from any other.

What the free run of a model leaves of a record: noise through the model's own poles, v = C x + e, x+ = A x + K e.

The forced response from rest and a constant in each output are taken off; the state at the first sample stays in, as an
unknown that later stages move.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from era.realisation import Realisation
from era.simulation import estimate_initial_state, simulate
from era.state_recursion import backward_states, finite_gramian, innovation_run
from okid.arrays import FloatArray
from okid.record import Record

__all__ = [
    "NoisePart",
    "ScoredGain",
    "Starts",
    "first_fit",
    "information",
    "inverse",
    "inverse_of_information",
    "left_over",
    "settled",
    "step",
]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class NoisePart:
    """What the free run leaves of one record, and the state that it starts from.

    Attributes:
        values: (n_samples, n_outputs), NaN where missing.
        state: (order,) at the first sample.
    """

    values: FloatArray
    state: FloatArray


def left_over(model: Realisation, record: Record) -> tuple[NoisePart, FloatArray]:
    """What the free run leaves of a record.

    Args:
        model: its gain is not looked at.
        record: of the model's channels and time step.

    Returns:
        The part, and (n_samples, n_outputs) what the free decay from its state leaves too.

    Raises:
        InsufficientDataError: no output sample to tell the state from.
        NumericalError: the free run grows beyond all numbers.
    """
    noise = replace(
        record,
        inputs=np.empty((record.n_samples, 0)),
        outputs=record.outputs - simulate(model, record).outputs,
        input_names=(),
        input_units=(),
    )
    undriven = Realisation(model.A, np.empty((model.order, 0)), model.C, np.empty((model.n_outputs, 0)), model.dt)
    level, state, left = np.zeros(model.n_outputs), np.zeros(model.order), noise.outputs
    there = ~np.isnan(noise.outputs)
    for _ in range(2 if there.any() else 0):  # level and free decay hardly share a direction
        state = estimate_initial_state(undriven, replace(noise, outputs=noise.outputs - level))
        left = noise.outputs - simulate(undriven, noise, initial_state=state).outputs
        level = np.where(there, left, 0.0).sum(axis=0) / np.maximum(there.sum(axis=0), 1)
    return NoisePart(values=noise.outputs - level, state=state), left - level


Starts = Literal["free", "kept"]
"""Whether the state that each record starts from is made best for every gain, or kept as it was."""
SMALLEST_SHARE = 1e-3
"""Of a step, below which halving ends."""
FLOOR = 1e-8
"""Variance relative to an output's own that keeps the covariance of outputs that repeat each other invertible."""
MEMORIES = 20.0
"""Memories, 1 / (1 - largest pole of A - K C), that the longest record must hold, unless the model's own is longer.

Noise without power at some frequency (outputs far oversampled, or differentiated) has its likeliest gain on the edge of
stability, where the predictor never forgets what it started from: of no use on any other record."""
EDGE = 1e-9
"""By which the largest pole of A - K C may lie outside the unit circle, where no output shows it."""
FORGOTTEN = 1e-6
"""Part of a start that is left when rows no longer depend on it."""
LEAST_INFORMATION = 1e-12
"""Information on a direction of the state, relative to the largest, below which it is not moved."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ScoredGain:
    """A gain and starts, with the innovations that they leave.

    Attributes:
        gain: (order, n_outputs).
        parts: one a record.
        errors: (n_samples, n_outputs) innovations a record, zero where missing.
        covariance: (n_outputs, n_outputs) of the complete rows.
        log_determinant: of the covariance; infinite where the innovations are.
    """

    gain: FloatArray
    parts: tuple[NoisePart, ...]
    errors: tuple[FloatArray, ...]
    covariance: FloatArray
    log_determinant: float


def first_fit(
    A: FloatArray, C: FloatArray, gain: FloatArray, parts: Sequence[NoisePart], *, starts: Starts = "free"
) -> ScoredGain | None:
    """The fit to begin with, of this gain and its starts; None where it grows beyond all numbers."""
    if starts == "kept":
        fit = scored(A, C, gain, parts, None)
        return fit if np.isfinite(fit.log_determinant) else None
    fit = scored(A, C, gain, parts, np.eye(C.shape[0]))
    return scored(A, C, gain, fit.parts, inverse(fit.covariance)) if np.isfinite(fit.log_determinant) else None


def scored(
    A: FloatArray, C: FloatArray, gain: FloatArray, parts: Sequence[NoisePart], weight: FloatArray | None
) -> ScoredGain:
    """Innovations of a gain and their covariance; the starts made best for it by this weight, or kept where None."""
    n_outputs, n_rows = C.shape[0], 0
    total = np.zeros((n_outputs, n_outputs))
    runs = [
        (part, innovation_run(A, C, gain, part.values, state=part.state)[0])
        if weight is None
        else settled(A, C, gain, part, weight)
        for part in parts
    ]
    with np.errstate(over="ignore", invalid="ignore"):
        for part, e in runs:
            rows = ~np.isnan(part.values).any(axis=1)
            complete = e if rows.all() else e[rows]
            total += complete.T @ complete
            n_rows += complete.shape[0]
        covariance = total / n_rows + FLOOR * np.eye(n_outputs)
        finite = np.isfinite(covariance).all() and all(np.isfinite(e[-1]).all() for _, e in runs)
        size = float(np.linalg.slogdet(covariance)[1]) if finite else np.inf
    return ScoredGain(
        gain=gain,
        parts=tuple(part for part, _ in runs),
        errors=tuple(e for _, e in runs),
        covariance=covariance,
        log_determinant=size,
    )


def step(A: FloatArray, C: FloatArray, fit: ScoredGain, *, starts: Starts = "free") -> ScoredGain | None:
    """The fit after one step, halved until it is better and A - K C no less stable; None where no share of it is."""
    K = fit.gain
    weight = inverse(fit.covariance)
    n_rows = sum(e.shape[0] for e in fit.errors)
    slope = np.zeros_like(K)
    for e in fit.errors:
        slope += backward_states(A, C, K, e @ weight)[0].T @ e
    seen = information(A, C, K, weight, length=max(e.shape[0] for e in fit.errors))
    change = inverse_of_information(seen) @ slope @ weight / n_rows
    longest = max(e.shape[0] for e in fit.errors)
    edge = max(1.0 - MEMORIES / longest, _radius(A), _radius(A - K @ C)) + EDGE
    share = 1.0
    while share > SMALLEST_SHARE and np.isfinite(change).all():
        gain = K + share * change
        if _radius(A - gain @ C) < edge:
            trial = scored(A, C, gain, fit.parts, weight if starts == "free" else None)
            if trial.log_determinant < fit.log_determinant:
                return trial
        share /= 2.0
    return None


def settled(
    A: FloatArray, C: FloatArray, gain: FloatArray, part: NoisePart, weight: FloatArray
) -> tuple[NoisePart, FloatArray]:
    """The part with the start that is best for this gain, and its innovations, zero where missing.

    They are linear in the start, so one step is exact; rows by which A - K C has forgotten it say nothing about it.
    """
    errors, _ = innovation_run(A, C, gain, part.values, state=part.state)
    if not np.isfinite(errors).all():  # a gain that makes the predictor unstable
        return part, errors
    radius, length = _radius(A - gain @ C), errors.shape[0]
    if radius < 1.0:
        length = min(length, 2 * A.shape[0] + int(np.log(FORGOTTEN) / np.log(max(radius, FORGOTTEN))))
    _, slope = backward_states(A, C, gain, errors[:length] @ weight)
    push = inverse_of_information(information(A, C, gain, weight, length=length)) @ slope
    if not np.isfinite(push).all():
        return part, errors
    moved = replace(part, state=part.state + push)
    errors[:length], _ = innovation_run(A, C, gain, part.values[:length], state=moved.state)
    return moved, errors


def _radius(A: FloatArray) -> float:
    return float(np.abs(np.linalg.eigvals(A)).max(initial=0.0))


def information(A: FloatArray, C: FloatArray, K: FloatArray, weight: FloatArray, *, length: int) -> FloatArray:
    """(order, order) W over this many rows."""
    with np.errstate(over="ignore", invalid="ignore"):
        return finite_gramian(A - K @ C, C.T @ weight @ C, length)


def inverse(covariance: FloatArray) -> FloatArray:
    """Of a covariance of innovations; directions without variance get no weight."""
    return np.asarray(np.linalg.pinv(covariance, rcond=LEAST_INFORMATION, hermitian=True), dtype=np.float64)


def inverse_of_information(matrix: FloatArray) -> FloatArray:
    """Inverse on the directions of the state that the outputs show, zero on the others."""
    if not np.isfinite(matrix).all():
        return np.zeros_like(matrix)
    size = np.sqrt(np.maximum(np.diagonal(matrix), np.finfo(np.float64).tiny))
    values, vectors = np.linalg.eigh(matrix / np.outer(size, size))
    kept = values > LEAST_INFORMATION * values[-1]
    half = vectors[:, kept] / np.sqrt(values[kept]) / size[:, np.newaxis]
    inverse: FloatArray = half @ half.T
    return inverse
