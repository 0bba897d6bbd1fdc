"""The gain of a model that has none, from what its free run leaves of the records: maximum likelihood for K alone.

    x(k+1) = A x(k) + K e(k),   v(k) = C x(k) + e(k),   v: measured outputs less the free run

With A and C given, the gain is found that makes the one-step errors e smallest, log det sum e e', by Fisher
scoring. It reaches what is asymptotically the best that any method can do, covariance W^-1 (x) R^-1 / N.

A step moves the gain and the states that the records start from. With Abar = A - K C, R the covariance of the
innovations e and s the backward run of R^-1 e,

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
import scipy

from era.realisation import Realisation
from era.simulation import check_channels, estimate_initial_state, simulate, spectral_radius
from era.state_recursion import backward_states, finite_gramian, innovation_run
from okid.arrays import ROUNDED, BoolArray, FloatArray
from okid.display import Displayed
from okid.errors import IdentificationError
from okid.record import Record
from okid.rows import as_records


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
    edge = max(1.0 - MEMORIES / longest, spectral_radius(A), spectral_radius(A - K @ C)) + EDGE
    share = 1.0
    while share > SMALLEST_SHARE and np.isfinite(change).all():
        gain = K + share * change
        if spectral_radius(A - gain @ C) < edge:
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
    radius, length = spectral_radius(A - gain @ C), errors.shape[0]
    if radius < 1.0:
        length = min(length, 2 * A.shape[0] + int(np.log(FORGOTTEN) / np.log(max(radius, FORGOTTEN))))
    _, slope = backward_states(A, C, gain, errors[:length] @ weight)
    push = inverse_of_information(information(A, C, gain, weight, length=length)) @ slope
    if not np.isfinite(push).all():
        return part, errors
    moved = replace(part, state=part.state + push)
    errors[:length], _ = innovation_run(A, C, gain, part.values[:length], state=moved.state)
    return moved, errors


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


def riccati_gain(A: FloatArray, C: FloatArray, Q: FloatArray, R: FloatArray, S: FloatArray) -> FloatArray:
    """Predictor gain (A P C' + S) (C P C' + R)^-1; zero where no solution P is stabilising.

    Args:
        A: (order, order).
        C: (n_outputs, order).
        Q: (order, order) covariance of the process noise.
        R: (n_outputs, n_outputs) covariance of the measurement noise.
        S: (order, n_outputs) covariance between the two.

    Example:
        >>> one = np.ones((1, 1))
        >>> riccati_gain(0.5 * one, one, 0.01 * one, one, 0.1 * one).round(6)
        array([[0.1]])
    """
    nothing = np.zeros_like(S)
    try:
        P = scipy.linalg.solve_discrete_are(A.T, C.T, (Q + Q.T) / 2, (R + R.T) / 2, s=S)
        stable = np.asarray(np.linalg.solve(C @ P @ C.T + R, (A @ P @ C.T + S).T).T, dtype=np.float64)
    except (np.linalg.LinAlgError, ValueError):  # no stabilising solution, or R singular
        return nothing
    if not np.isfinite(stable).all() or np.abs(np.linalg.eigvals(A - stable @ C)).max() >= 1.0:
        return nothing
    return stable


MOST_STEPS = 40
SMALLEST_RISE = 1e-2
"""Of the log likelihood, below which another step moves K by much less than its standard deviation."""
LARGEST_POLE = 0.999
"""Of a model whose free decays are given an energy."""
LARGEST_LOSS = 2.0
"""Growth of the innovations from starts of the free run, over those from the best starts, that a gain may have."""


def first_gain(A: FloatArray, C: FloatArray, length: int) -> FloatArray:
    """Gain for process noise that moves every state equally visibly.

    From a zero gain alone the climb can get stuck where records are so short that free decays pass for noise.
    """
    # of the same model with its largest pole well within the unit circle, for the energy of a growing decay is none
    shrunk = A * min(1.0, LARGEST_POLE / max(float(np.abs(np.linalg.eigvals(A)).max()), LARGEST_POLE))
    equal = inverse_of_information(finite_gramian(shrunk, C.T @ C, length))
    nothing = np.zeros((A.shape[0], C.shape[0]))
    # free decays that one sample's process noise starts have as much energy as an output's noise
    return riccati_gain(A, C, equal, np.eye(C.shape[0]), nothing)


def usable_gain(
    A: FloatArray, C: FloatArray, likeliest: ScoredGain, parts: Sequence[NoisePart], n_rows: int
) -> ScoredGain:
    """The likeliest gain, unless its predictions hang on starts that nobody can know beforehand.

    Noise without power at some frequency has its likeliest gain near the edge of stability. From the starts of the free
    run, which is all that a user has, such a gain predicts badly for long; then the one that is best from these starts
    is taken.
    """
    allowed = 2.0 * np.log(LARGEST_LOSS) * C.shape[0]
    kept = first_fit(A, C, likeliest.gain, parts, starts="kept")
    if kept is not None and kept.log_determinant - likeliest.log_determinant <= allowed:
        return likeliest
    other = first_fit(A, C, first_gain(A, C, n_rows), parts, starts="kept")
    if other is None:
        return likeliest
    other = climbed(A, C, other, n_rows, starts="kept")
    if kept is not None and kept.log_determinant - other.log_determinant <= allowed:
        return likeliest
    return other


def climbed(A: FloatArray, C: FloatArray, start: ScoredGain, n_rows: int, *, starts: Starts = "free") -> ScoredGain:
    """The fit after as many steps as are worth it."""
    best = start
    for _ in range(MOST_STEPS):
        moved = step(A, C, best, starts=starts)
        if moved is None:
            break
        rise = 0.5 * n_rows * (best.log_determinant - moved.log_determinant)
        best = moved
        if rise < SMALLEST_RISE:
            break
    return best


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class GainEstimate(Displayed):
    """A gain, how well it is known, and the covariance of the innovations that it leaves.

    Attributes:
        gain: (order, n_outputs) K of the one-step predictor, in the units of the records; zero where `reason` says so.
        gain_std: (order, n_outputs) standard deviation of each entry; zero where the gain is zero by decision.
        innovation_covariance: (n_outputs, n_outputs) R, degrees of freedom taken off.
        n_rows: complete rows that it was estimated from.
        likelihood_ratio: n_rows times the drop of log det R against a zero gain; nan where none was tried.
        reason: in words, why the gain is what it is.
    """

    gain: FloatArray
    gain_std: FloatArray
    innovation_covariance: FloatArray
    n_rows: int
    likelihood_ratio: float
    reason: str


def gain_from_innovations(realisation: Realisation, records: Record | Sequence[Record]) -> FloatArray:
    """(order, n_outputs) gain of `estimate_gain`, for those who need nothing else.

    Args:
        realisation: model; its own K, if any, is not looked at.
        records: one or several of the model's channels and time step.

    Raises:
        InvalidDataError: other channels or another time step than the model.

    Example:
        >>> model = Realisation([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.01)
        >>> gain_from_innovations(model, Record([1.0, 0.0, 0.0], [0.0, 1.0, 0.5], 0.01))  # noise-free
        array([[0.]])
    """
    return estimate_gain(realisation, records).gain


def estimate_gain(realisation: Realisation, records: Record | Sequence[Record]) -> GainEstimate:
    """Gain K and innovation covariance for the given A, B, C, D, by maximum likelihood.

    Needed after a model was reduced or refined: the gain found before is not that of the new model. Each record starts
    from its own unknown state and may have a constant offset in each output. A missing output sample corrects nothing.
    Where the data give no reason for a gain (noise-free, white measurement noise, too few rows) it is zero and `reason`
    says why: a gain must earn its order times n_outputs numbers by Schwarz's criterion. A gain that would never forget
    what it started from is not taken, however likely.

    Args:
        realisation: model; its own K, if any, is not looked at.
        records: one or several of the model's channels and time step.

    Returns:
        The gain, its standard deviations and the innovation covariance; A - K C is stable wherever A is.

    Raises:
        InvalidDataError: other channels or another time step than the model.

    References:
        Hannan, Deistler, The Statistical Theory of Linear Systems, Wiley, 1988, chapter 6 (likelihood of the
        innovations form); Schwarz, Annals of Statistics 6(2), 1978, 461-464, doi 10.1214/aos/1176344136 (criterion).

    Example:
        >>> rng = np.random.default_rng(0)
        >>> e, x, y = rng.standard_normal(4000), 0.0, np.empty(4000)
        >>> for k in range(4000):
        ...     y[k], x = x + e[k], 0.9 * x + 0.3 * e[k]
        >>> model = Realisation([[0.9]], np.empty((1, 0)), [[1.0]], np.empty((1, 0)), 0.01)
        >>> found = estimate_gain(model, Record([], y, 0.01))
        >>> bool(abs(found.gain[0, 0] - 0.3) < 3 * found.gain_std[0, 0]), found.innovation_covariance.round(1)
        (True, array([[1.]]))
    """
    model = realisation
    several = as_records(records)
    for record in several:
        check_channels(model, record)
    try:
        made = [left_over(model, record) for record in several]
    except IdentificationError as error:
        raw = np.vstack([record.outputs for record in several])
        return _none(model, raw, f"the free run cannot be made: {error}".rstrip("."))
    rest = np.vstack([left for _, left in made])
    active = _moves(rest, several)
    n_rows = int((~np.isnan(rest[:, active]).any(axis=1)).sum())
    if model.order == 0:
        return _none(model, rest, "the model has no state that a gain could correct")
    if not active.any():
        return _none(model, rest, "the free run explains the outputs to rounding, so there is no noise to learn from")
    if n_rows <= model.order + int(active.sum()) + 1:
        few = f"{n_rows} complete rows are too few for {model.order} states and {int(active.sum())} noisy outputs"
        return _none(model, rest, few)
    return _likeliest(model, [part for part, _ in made], rest, active, n_rows)


def _likeliest(
    model: Realisation, parts: Sequence[NoisePart], rest: FloatArray, active: BoolArray, n_rows: int
) -> GainEstimate:
    """The gain of greatest likelihood on the outputs that have noise, or zero where it does not earn its numbers."""
    size = np.sqrt(np.nanmean(rest[:, active] ** 2, axis=0))
    C = model.C[active] / size[:, np.newaxis]
    scaled = [replace(part, values=part.values[:, active] / size) for part in parts]
    free = first_fit(model.A, C, np.zeros((model.order, C.shape[0])), scaled)
    other = first_fit(model.A, C, first_gain(model.A, C, n_rows), scaled)
    start = min((fit for fit in (free, other) if fit is not None), key=lambda fit: fit.log_determinant, default=None)
    if start is None:
        return _none(model, rest, "every predictor that was tried grows beyond all numbers")
    likeliest = climbed(model.A, C, start, n_rows)
    best = usable_gain(model.A, C, likeliest, scaled, n_rows)
    ratio = np.inf if free is None else n_rows * (free.log_determinant - best.log_determinant)
    needed = np.log(n_rows) * C.size * n_rows / (n_rows - model.order - C.shape[0] - 1)
    if free is not None and ratio <= needed:
        best = free
        reason = f"a gain would predict no better than the free run does: likelihood ratio {ratio:.4g}, needed "
        reason += f"{needed:.4g} for {model.order} x {C.shape[0]} numbers"
    else:
        reason = f"maximum likelihood over {n_rows} rows: ratio to a zero gain {ratio:.4g}, needed {needed:.4g}"
        if best is not likeliest:
            reason += "; a likelier gain hangs on starts that nobody can know and was not taken"
    found = _in_units(model, best, active, size, n_rows=n_rows, ratio=ratio, reason=reason)
    if found.gain.any() and spectral_radius(model.A) < 1.0 <= spectral_radius(model.A - found.gain @ model.C):
        # states so unequal in size that the predictor's stability is lost to rounding
        return _none(model, rest, "the predictor of greatest likelihood is not stable to rounding")
    return found


def _moves(rest: FloatArray, records: Sequence[Record]) -> BoolArray:
    """(n_outputs,) True where the free run leaves more of an output than rounding."""
    left = np.nan_to_num(rest)
    size = np.nan_to_num(np.vstack([record.outputs for record in records]))
    moves: BoolArray = np.sqrt((left**2).sum(axis=0)) > ROUNDED * np.sqrt((size**2).sum(axis=0))
    return moves


def _in_units(
    model: Realisation, fit: ScoredGain, active: BoolArray, size: FloatArray, *, n_rows: int, ratio: float, reason: str
) -> GainEstimate:
    """The fit of scaled outputs in the units of the records; outputs without noise have a zero gain."""
    gain, spread = np.zeros((2, model.order, model.n_outputs))
    gain[:, active] = fit.gain / size
    if gain.any():
        weight = inverse(fit.covariance)
        seen = information(model.A, model.C[active] / size[:, np.newaxis], fit.gain, weight, length=n_rows)
        product = np.outer(np.diagonal(inverse_of_information(seen)), np.diagonal(weight)) / n_rows
        spread[:, active] = np.sqrt(np.maximum(product, 0.0)) / size
    freedom = n_rows - (model.order if gain.any() else 0)
    covariance = np.zeros((model.n_outputs, model.n_outputs))
    covariance[np.ix_(active, active)] = fit.covariance * np.outer(size, size) * n_rows / max(freedom, 1)
    return _closed(gain, spread, covariance, n_rows=n_rows, ratio=ratio, reason=reason)


def _none(model: Realisation, rest: FloatArray, reason: str) -> GainEstimate:
    """A zero gain that was not tried; the covariance is what the free run leaves."""
    nothing = np.zeros((model.order, model.n_outputs))
    complete = rest[~np.isnan(rest).any(axis=1)]
    covariance = complete.T @ complete / max(len(complete), 1)
    if not len(complete):
        counted = np.maximum((~np.isnan(rest)).sum(axis=0), 1)
        covariance = np.diag((np.nan_to_num(rest) ** 2).sum(axis=0) / counted)
    return _closed(nothing, nothing.copy(), covariance, n_rows=len(complete), ratio=np.nan, reason=reason)


def _closed(
    gain: FloatArray, spread: FloatArray, covariance: FloatArray, *, n_rows: int, ratio: float, reason: str
) -> GainEstimate:
    for array in (gain, spread, covariance):
        array.flags.writeable = False
    return GainEstimate(
        gain=gain,
        gain_std=spread,
        innovation_covariance=covariance,
        n_rows=n_rows,
        likelihood_ratio=float(ratio),
        reason=reason,
    )
