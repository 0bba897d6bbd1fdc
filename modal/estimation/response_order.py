"""How many poles a table of frequency responses holds: left out one by one, and weighed by evidence."""

from collections.abc import Iterator

import numpy as np

from modal.estimation.response_fit import ResponseFit, ResponseLines, losses, refined, without_pole
from modal.estimation.response_noise import Noise, lines_joined, noise_of
from okid.arrays import TINY, ComplexArray, FloatArray

WITHOUT_GAIN = 4
"""Try no higher orders once so many in a row were worse than the best by evidence."""
WEAKEST = 3
"""Try to leave out one of so many of the weakest poles before a loss is taken."""
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
