"""How many poles a table of frequency responses holds: left out one by one, and weighed by evidence."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy

from modal.estimation.responses.fit import ResponseFit, ResponseLines, Start, losses, refined, without_pole
from modal.estimation.responses.noise import Noise, lines_joined, noise_of
from okid.arrays import TINY, ComplexArray, FloatArray

LARGEST_ORDER = 64
"""Try model orders up to this one."""
MOST_GROWN = 4
"""Look for so many modes in what a model leaves. Where more seem to be it is no noise with a few modes in it, but what
exact or rounded numbers leave of a model, in which any pole gains; then none of them is taken."""
WITHOUT_GAIN = 4
"""Try no higher orders once so many in a row were worse than the best by evidence."""
WEAKEST = 3
"""Try to leave out one of so many of the weakest poles before a loss is taken."""
PASSES = 3
"""Choose the order, or a force's dips, again with the noise that the model leaves, at most so often; it repeats itself
after two."""
WIDTHS = (1, 4, 16)
"""Look for resonances of so many lines on either side: one of half or twice the width keeps 8/9 of what it explains."""
FLANKS = 4
"""Follow the flanks of a resonance for so many of its widths: they hold 6/7 of its power."""
QUICK = 5
"""Refine candidates and reruns by so many steps: from their realisation they stand still by then."""


def weight_of(table: ResponseLines, noise: Noise) -> FloatArray:
    """(n_lines, n_outputs, n_inputs) one over the deviation of each value, 0 where it was not measured."""
    return np.where(table.known, 1 / np.sqrt(noise.variance), 0.0)


def most_states(table: ResponseLines) -> int:
    """States whose numbers are at most half of the independent values: what is left has to tell the noise.

    A model with as many numbers as there are values leaves nothing, and would pass for certain whatever it says.
    """
    _, n_outputs, n_inputs = table.values.shape
    half = int(table.known.sum()) / lines_joined(table)
    return int((half - n_outputs * n_inputs) / (n_outputs + n_inputs))


def evidence_of(table: ResponseLines, fit: ResponseFit) -> float:
    """Schwarz's criterion: twice the squared error in standard deviations, and log N a parameter.

    Both count independent values: a window joins neighbouring lines, and its correlations add up to that many.
    """
    return schwarz(table, fit.error, fit.n_parameters)


def schwarz(table: ResponseLines, error: float, n_parameters: int) -> float:
    """Schwarz's criterion of a squared error in standard deviations, with so many parameters."""
    joined = lines_joined(table)
    return 2 * error / joined + n_parameters * float(np.log(2 * int(table.known.sum()) / joined))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class WithNoise:
    """A model of a table with the noise that it leaves.

    Attributes:
        fit: the model.
        noise: of `noise_of`.
        criterion: Schwarz's, the least of the likeliest: twice the negative logarithm of the likelihood with that
            noise, and log N a parameter.
    """

    fit: ResponseFit
    noise: Noise
    criterion: float


def with_own_noise(table: ResponseLines, fit: ResponseFit) -> WithNoise:
    """A model with its own noise, judged by both: under noise that leaks everything no pole is missed."""
    noise = noise_of(table, fit)
    criterion = schwarz(table, -likelihood_of(table, fit, noise), fit.n_parameters)
    return WithNoise(fit=fit, noise=noise, criterion=criterion)


def with_fewer(table: ResponseLines, fit: ResponseFit, weight: FloatArray) -> Iterator[ResponseFit]:
    """The fit without the pole that is missed least, then without the next one, and so on.

    Where the evidence loses, the next ones by that estimate are tried as well, and the best is kept.
    """
    while fit.poles.size > 1:
        states, least = np.where(fit.is_pair, 2, 1), evidence_of(table, fit)
        trials: list[ResponseFit] = []
        for pole in np.argsort(losses(fit) / states)[:WEAKEST]:
            trials.append(without_pole(table, fit, int(pole), weight, n_steps=QUICK))
            if evidence_of(table, trials[-1]) < least:
                break
        fit = min(trials, key=lambda trial: evidence_of(table, trial))
        yield fit


def grown(table: ResponseLines, fit: ResponseFit, weight: FloatArray) -> ResponseFit:
    """The fit with a pole more wherever it leaves a resonance that the evidence gains by, the largest one first.

    A realisation ranks poles by how much of the pulse response they are, in the units of the table. One that stands far
    above the noise of its own lines is left out of all of them where the noise of others is larger than it.

    Args:
        table: to describe.
        fit: of it.
        weight: (n_lines, n_outputs, n_inputs) one over the deviation of each value, 0 where it was not measured.
    """
    n_outputs, n_inputs = table.values.shape[1:]
    fit = refined(table, fit, weight, n_steps=QUICK)
    larger = [fit]
    while fit.order + 2 <= min(LARGEST_ORDER, most_states(table)):
        gain, start = _resonance_left(table, fit, weight)
        if schwarz(table, fit.error - gain, fit.n_parameters + 2 * (n_outputs + n_inputs)) >= evidence_of(table, fit):
            break
        trial = refined(table, start, weight, n_steps=QUICK)
        if evidence_of(table, trial) >= evidence_of(table, fit):
            break
        if len(larger) > MOST_GROWN:
            return larger[0]
        fit = trial
        larger.append(fit)
    return fit


def _resonance_left(table: ResponseLines, fit: ResponseFit, weight: FloatArray) -> tuple[float, Start]:
    """About how much of the squared error one more pair would explain, the others held; and the poles with it."""
    left, angles = weight * fit.left, np.angle(table.z)
    best: tuple[float, int, int, ComplexArray] | None = None
    for width in WIDTHS:
        offsets = np.arange(-FLANKS * width, FLANKS * width + 1)
        shape = 1 / (1 + 1j * offsets / width)  # of 1 / (z - lambda) beside its peak
        answer = scipy.signal.oaconvolve(left, shape.conj()[::-1, np.newaxis, np.newaxis], mode="full", axes=0)
        size = scipy.signal.oaconvolve(table.known * 1.0, np.abs(shape[:, np.newaxis, np.newaxis]) ** 2, axes=0)
        own = slice(FLANKS * width, FLANKS * width + len(left))
        part = answer[own] / np.sqrt(np.maximum(size[own], 1.0))
        power = (np.abs(part) ** 2).sum(axis=(1, 2))
        line = int(power.argmax())
        if best is None or power[line] > best[0]:
            best = float(power[line]), line, width, part[line]
    assert best is not None
    gain, line, width, part = best
    residue = np.divide(part, weight[line], out=np.zeros_like(part), where=table.known[line])
    pole = np.exp(1j * angles[line] - width * float(np.median(np.diff(angles))))
    participation = np.linalg.svd(residue)[2][:1]
    return gain, (np.r_[fit.poles, pole], np.r_[fit.is_pair, True], np.vstack([fit.inputs, participation]))


def until_worse(table: ResponseLines, fit: ResponseFit, weight: FloatArray) -> Iterator[ResponseFit]:
    """The fit and those with fewer and fewer poles, until several in a row are less likely than the best."""
    best, worse = evidence_of(table, fit), 0
    yield fit
    for one in with_fewer(table, fit, weight):
        yield one
        evidence = evidence_of(table, one)
        best, worse = min(best, evidence), 0 if evidence < best else worse + 1
        if worse >= WITHOUT_GAIN:
            return


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class OrderPath:
    """The likeliest model of a table, and those of other orders that it was chosen among.

    Attributes:
        best: the model with its noise.
        evidence: of each order that was tried, under one noise for all.
        fits: of each, as in `lines_fit`, in the mean over outputs.
        fewer: what to begin with for models of fewer and fewer poles than the best one.
    """

    best: WithNoise
    evidence: dict[int, float]
    fits: dict[int, float]
    fewer: tuple[Start, ...]


def chosen_order(table: ResponseLines, first: ResponseFit, best: WithNoise) -> OrderPath:
    """Leave out poles for as long as the evidence gains, and again under the noise that the chosen model leaves.

    Under one noise the orders of a path compare; paths compare by what table and noise together are likely. A noise of
    poles that hardly decay explains any table without a model: from it alone, tables of loaded shakers that differ by
    rounding had 10 states or 2 (seeds 341 and 71000 of the benchmark, Hann 1024).

    Args:
        table: to describe.
        first: a model with more poles than are needed.
        best: the likeliest model so far, whose noise is the first.
    """
    start, found = first.start, OrderPath(best=best, evidence={}, fits={}, fewer=())
    for number in range(PASSES):
        weight = weight_of(table, found.best.noise)
        path = list(until_worse(table, refined(table, start, weight, n_steps=QUICK), weight))
        evidence = [evidence_of(table, one) for one in path]
        at = int(np.argmin(evidence))
        one = with_own_noise(table, path[at])
        better = one.criterion < found.best.criterion
        repeats = one.fit.order == found.best.fit.order if better else number > 0
        if better or not found.evidence:
            found = OrderPath(
                best=one if better else found.best,
                evidence=dict(zip((each.order for each in path), evidence, strict=True)),
                fits={each.order: float(np.mean(lines_fit(each.left, table, weight))) for each in path},
                fewer=tuple(each.start for each in path[at + 1 :]),
            )
        if repeats:
            break
        start = path[max(0, at - 2)].start if better else found.best.fit.start
    return found


def complete_order(table: ResponseLines, first: ResponseFit, best: WithNoise) -> OrderPath:
    """`chosen_order`, and again from its model with the resonances that it leaves, as long as that is likelier.

    Args:
        table: to describe.
        first: a model with more poles than are needed.
        best: the likeliest model so far, whose noise is the first.
    """
    found = chosen_order(table, first, best)
    for _ in range(PASSES):
        fit = grown(table, found.best.fit, weight_of(table, found.best.noise))
        if fit.order == found.best.fit.order:
            break
        more = with_own_noise(table, fit)
        if more.criterion >= found.best.criterion:
            break
        found = chosen_order(table, fit, more)
    return found


def settled_noise(table: ResponseLines, fit: ResponseFit, noise: Noise) -> tuple[ResponseFit, Noise, float]:
    """The fit and its noise after each was made with the other a few times, and their log-likelihood."""
    for _ in range(2):
        fit = refined(table, fit, weight_of(table, noise))
        noise = noise_of(table, fit)
    fit = refined(table, fit, weight_of(table, noise))
    return fit, noise, likelihood_of(table, fit, noise)


def likelihood_of(table: ResponseLines, fit: ResponseFit, noise: Noise) -> float:
    """Logarithm of the likelihood of a table, less what is alike for all models."""
    variance = noise.variance[table.known]
    return -float((np.abs(fit.left[table.known]) ** 2 / variance + np.log(variance)).sum())


def first_weight(table: ResponseLines) -> FloatArray:
    """Before there is a model: by coherence where it is known, no value better than the median one, else all alike."""
    if table.noise is None:
        return np.where(table.known, 1.0, 0.0)
    variance = table.noise * np.abs(table.values) ** 2
    variance = variance + np.median(variance[table.known]) + np.finfo(float).eps
    return np.where(table.known, 1 / np.sqrt(variance), 0.0)


def lines_fit(left: ComplexArray, table: ResponseLines, weight: FloatArray) -> FloatArray:
    """(n_outputs,) 1 - |error| / |response| over lines and inputs, each in its standard deviations."""
    size = np.sqrt((np.abs(weight * table.values) ** 2).sum(axis=(0, 2)))
    error = np.sqrt((np.abs(weight * left) ** 2).sum(axis=(0, 2)))
    return np.asarray(1 - error / np.maximum(size, TINY), dtype=np.float64)
