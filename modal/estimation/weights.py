"""Whose noise counts how much: outputs and records weighed by what a refined model leaves of them.

Least squares hears the loudest: the error of a noisy output, or of a record under wind, is spread over the quiet ones,
where it looks like coloured noise. Weighed by their own noise, settled in a few rounds with the model, all count by
what they tell: the maximum of the likelihood for noise that is white in each (iteratively reweighted least squares).

So do the rows in which a blow acts. What it does between its samples, or beyond half the sampling rate, is in no sample
of it: errors of that end with the blow, many times as large as those of the sensors, and poles, which the free motion
tells, would follow them.

References:
    Green, Journal of the Royal Statistical Society B 46(2), 1984, 149-192 (iteratively reweighted least squares).
"""

from dataclasses import replace

import numpy as np

from modal.estimation.modal_parameters import errors_of
from modal.estimation.output_error import ROUND_OFF, OutputError, RefinementStep, refine, step_at
from modal.estimation.prediction_error import SMALLEST_NOISE
from okid.arrays import BoolArray, FloatArray
from okid.residuals import WHITENESS_LAGS, centred, whiteness, whiteness_of_each

UNTIL_STILL = 30
"""Steps of a refinement that may run until it stands still."""
WEIGHTINGS = 4
"""Rounds in which outputs' weights and the model settle."""


def weighted(
    step: RefinementStep, data: OutputError, least_gain: float
) -> tuple[RefinementStep, OutputError, FloatArray, FloatArray]:
    """Refined with each output and each record weighted by its own noise, settled in a few rounds.

    An unweighted fit spreads the error of a noisy output over the quiet ones, where it looks like coloured noise, so
    the weights come before the test for whiteness. A whole record in other units has the same model, so a record
    counts by its own noise where all its channels are divided by that.

    Returns:
        The model, the data it is fitted to, the weights of the outputs, and (n_records,) what divides each record.
    """
    weights, whole = np.eye(step.layout.n_outputs), np.ones(len(data.records))
    for _ in range(WEIGHTINGS):
        if step.linear.squared_errors.max() == 0.0:
            break
        if len(data.records) > 1:
            step, data, size = _alike(step, data)
            whole = whole * size
        counts = np.sum([there.sum(axis=0) for there in data.counted], axis=0)
        variance = step.linear.squared_errors / np.maximum(counts, 1)
        largest = variance.max()
        weights = np.diag(largest / np.maximum(variance, SMALLEST_NOISE**2 * largest))
        step = refine(step, data, n_steps=UNTIL_STILL, least_gain=least_gain, weights=weights)[-1]
    return step, data, weights, whole


def _alike(step: RefinementStep, data: OutputError) -> tuple[RefinementStep, OutputError, FloatArray]:
    """Records divided by their own noise, as far as all outputs have more or less of it together.

    The level and the state that a record starts from take away as many numbers of what is left of it: in their place
    stands the noise of all, which after some rounds is as good as its own; few rows are no measure of their noise.
    """
    squares = np.array([np.nansum(error**2, axis=0) for error in errors_of(step, data)])
    counted = np.array([there.sum(axis=0) for there in data.counted])
    rows = np.maximum(1, counted)
    parameters = step.parameters
    moves = parameters.states.any(axis=1) * (1 + parameters.is_pair).sum() / squares.shape[1]
    taken = np.minimum(rows, 1.0 + moves[:, np.newaxis])
    left = (squares + taken * squares.sum(axis=0) / np.maximum(1.0, (rows - taken).sum(axis=0))) / rows
    of_each = np.log(np.maximum(left, SMALLEST_NOISE**2 * left.max()))
    beyond = np.where(counted > 0, of_each - _of_outputs(of_each, counted > 0), np.nan)
    noise = np.exp(0.5 * np.nanmedian(beyond, axis=1))
    size = noise / np.exp(np.log(noise).mean())
    records = tuple(
        replace(record, inputs=record.inputs / own, outputs=record.outputs / own)
        for record, own in zip(data.records, size, strict=True)
    )
    states = step.parameters.states / size[:, np.newaxis]
    data = replace(data, records=records)
    return step_at(replace(step.parameters, states=states), data), data, size


def _of_outputs(values: FloatArray, there: BoolArray) -> FloatArray:
    """(n_outputs,) of the least-squares sum of a number a record and one an output, where outputs were measured.

    A record that lacks an output is compared with others by those that both have: what only loud ones measured is
    neither as loud nor as quiet for it.
    """
    share = there / there.sum(axis=1, keepdims=True)
    normal = np.diag(there.sum(axis=0)) - there.T @ share
    known = np.where(there, values, 0.0)
    wanted = known.sum(axis=0) - share.T @ known.sum(axis=1)
    return np.asarray(np.linalg.lstsq(normal, wanted, rcond=ROUND_OFF)[0])


def whiteness_ratio(step: RefinementStep, data: OutputError) -> float:
    """Of what the free run leaves of all rows; nan where it leaves nothing."""
    errors = errors_of(step, data)
    if data.measured:
        return whiteness_of_each(errors, n_lags=WHITENESS_LAGS)
    return whiteness(centred(errors), n_lags=WHITENESS_LAGS, n_fitted=0).ratio
