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

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import count, pairwise

import numpy as np

from modal.estimation.modal_parameters import errors_of
from modal.estimation.output_error import ROUND_OFF, OutputError, RefinementStep, refine, step_at
from modal.estimation.prediction_error import SMALLEST_NOISE
from okid.arrays import TINY, BoolArray, FloatArray
from okid.residuals import WHITENESS_LAGS, centred, whiteness, whiteness_of_each
from okid.rows import runs_of

UNTIL_STILL = 30
"""Steps of a refinement that may run until it stands still."""
WEIGHTINGS = 4
"""Rounds in which outputs' weights and the model settle."""
BESIDE = 2
"""Ask so many rows more on either side of a blow, or a part of it that takes `WEIGHTINGS` rounds, then twice
that, and so on."""
ASIDE = 1e-6
"""Squared weight of rows that are set aside: enough to tell what nothing else does, and no more."""
MOVES = 0.5
"""What errs while a motion falls by less does not follow it."""


@dataclass(frozen=True, slots=True, eq=False)
class Weighted:
    """A refined model and whose noise counts how much in it.

    Attributes:
        step: the model.
        data: that it is fitted to.
        weights: (n_outputs, n_outputs) of the outputs.
        record_scale: (n_records,) what divides each record.
    """

    step: RefinementStep
    data: OutputError
    weights: FloatArray
    record_scale: FloatArray

    @property
    def errors(self) -> list[FloatArray]:
        """(n_samples, n_outputs) a record: what is left, also where rows count for little."""
        return errors_of(self.step, replace(self.data, measured=(), elsewhere=0.0))

    def apart(self, loud: Sequence[BoolArray], least_gain: float) -> "Weighted":
        """With these rows weighed by their errors over those of the others."""
        times = _size(self.errors, loud, than=[~rows for rows in loud])[1]
        data = set_aside(self.data, loud, counting=min(1.0, float(np.exp(-np.log(times).mean()))))
        now = weighted(step_at(self.step.parameters, data), data, least_gain)
        return replace(now, record_scale=self.record_scale * now.record_scale)


def set_aside(data: OutputError, rows: Sequence[BoolArray], *, counting: float = ASIDE) -> OutputError:
    """Rows as if they were not measured, with a squared weight by which they tell what no other row does: feedthrough.

    Args:
        data: all of which was measured, or has other rows set aside.
        rows: (n_samples,) a record.
        counting: that weight.
    """
    n_outputs = data.records[0].n_outputs
    measured = tuple(np.repeat(~own[:, np.newaxis], n_outputs, axis=1) for own in rows)
    return replace(data, measured=measured, elsewhere=counting)


def weighted(step: RefinementStep, data: OutputError, least_gain: float) -> Weighted:
    """Refined with each output and each record weighted by its own noise, settled in a few rounds.

    An unweighted fit spreads the error of a noisy output over the quiet ones, where it looks like coloured noise, so
    the weights come before the test for whiteness. A whole record in other units has the same model, so a record
    counts by its own noise where all its channels are divided by that.
    """
    weights, scale = np.eye(step.layout.n_outputs), np.ones(len(data.records))
    for _ in range(WEIGHTINGS):
        if step.linear.squared_errors.max() == 0.0:
            break
        if len(data.records) > 1:
            step, data, size = _alike(step, data)
            scale = scale * size
        counts = np.sum([(share > 0.0).sum(axis=0) for share in data.shares], axis=0)
        variance = step.linear.squared_errors / np.maximum(counts, 1)
        largest = variance.max()
        weights = np.diag(largest / np.maximum(variance, SMALLEST_NOISE**2 * largest))
        step = refine(step, data, n_steps=UNTIL_STILL, least_gain=least_gain, weights=weights)[-1]
    return Weighted(step, data, weights, scale)


def struck_apart(plain: Weighted, acting: Sequence[BoolArray], least_gain: float) -> Weighted:
    """The rows in which a blow acts weighed by what is left there, too, where that ends with the blow.

    Then they count as not measured, and with so little weight that they tell only what no other row does: feedthrough.
    What a filter rings on belongs to them, for as long as the blow acts, or the motion goes on, at most; errors that go
    on beyond are of something else, and all rows count alike.

    Each question is asked of the model that is likeliest by the weights so far: what a noisy record does to the
    feedthrough would be an error of the others' blows.

    Args:
        plain: the model, and the data that it is fitted to, all of it measured.
        acting: (n_samples,) a record, True where a blow acts.
        least_gain: relative decrease of the error by a step below which it is the last.
    """
    now, loud = plain, list(acting)
    if not _louder(plain.errors, loud, than=[~rows for rows in loud]):
        return plain
    n_beside, farthest = max(BESIDE, _longest(acting) // WEIGHTINGS), _while_it_moves(plain, acting)
    for turn in count(1):
        now = now.apart(loud, least_gain)
        behind, ahead, wider = _beside(loud, n_beside)
        quiet, errors = [~rows for rows in wider], now.errors
        if not (_louder(errors, behind, than=quiet) or _louder(errors, ahead, than=quiet)):  # one may hide the other
            return now.apart(loud, least_gain)  # by what a model leaves that these rows have not drawn
        before, loud = loud, [own & most for own, most in zip(wider, farthest, strict=True)]
        if all((own == one).all() for own, one in zip(loud, before, strict=True)):
            break
        n_beside *= 1 if turn % WEIGHTINGS else 2
    return plain


def beside_blows(acting: Sequence[BoolArray]) -> list[BoolArray]:
    """(n_samples,) a record: rows in which a blow acts, or a filter may ring by it: for as long at most."""
    *_, farthest = _beside(acting, max(BESIDE, _longest(acting)))
    return farthest


def _while_it_moves(model: Weighted, acting: Sequence[BoolArray]) -> list[BoolArray]:
    """Besides, what follows a blow until the motion falls to `MOVES` of what it was.

    What is not linear follows the motion, so what is over while that goes on is not of it.
    """
    parameters = model.step.parameters
    poles, of_shapes = parameters.poles, np.diag(model.weights) @ np.abs(model.step.linear.shapes) ** 2
    there = beside_blows(acting)
    for own, rows, record, start in zip(there, acting, model.data.records, parameters.states, strict=True):
        state, begun = start, 0
        for (first, last), (until, _) in pairwise([*runs_of(rows), (len(rows), len(rows))]):
            past = poles ** np.arange(last - 1 - first, -1, -1)[:, np.newaxis]
            driven = past * (record.inputs[first:last] @ parameters.inputs.T)
            state, begun = poles ** (last - begun) * state + driven.sum(axis=0), last
            power = of_shapes * np.abs(state) ** 2
            least, fading = MOVES**2 * power.sum(), np.abs(poles) ** 2
            own[last : last + _rows_above(least, power, fading, until - last)] = True
    return there


def _rows_above(least: float, power: FloatArray, fading: FloatArray, most: int) -> int:
    """Rows, of at most so many, until a sum of powers that fade at rates of their own falls below the least."""
    return bisect_left(range(most), True, key=lambda k: bool(power @ fading**k < least))


def _longest(acting: Sequence[BoolArray]) -> int:
    return max((last - first for rows in acting for first, last in runs_of(rows)), default=0)


def _beside(rows: Sequence[BoolArray], n: int) -> tuple[list[BoolArray], list[BoolArray], list[BoolArray]]:
    """(n_samples,) a record: `n` rows behind each run, as many ahead of it, and all of them with the runs."""
    behind = [_next(own, n) for own in rows]
    ahead = [_next(own[::-1], n)[::-1] for own in rows]
    return behind, ahead, [own | one | two for own, one, two in zip(rows, behind, ahead, strict=True)]


def _next(rows: BoolArray, n: int) -> BoolArray:
    """(n_samples,) the `n` rows behind each run, that are in none."""
    there = np.zeros_like(rows)
    for _, last in runs_of(rows):
        there[last : last + n] = True
    return np.asarray(there & ~rows)


def _louder(errors: Sequence[FloatArray], rows: Sequence[BoolArray], *, than: Sequence[BoolArray]) -> bool:
    """Whether noise of another, larger size there is likelier than of one size there and in the others (Schwarz)."""
    (n, times), n_others = _size(errors, rows, than=than), sum(int(there.sum()) for there in than)
    if not (n and n_others):
        return False
    pooled = (n * times + n_others) / (n + n_others)
    gain = (n + n_others) * np.log(pooled) - n * np.log(times)
    return bool(gain.mean() > np.log(n + n_others) and np.log(times).mean() > 0.0)


def _size(
    errors: Sequence[FloatArray], rows: Sequence[BoolArray], *, than: Sequence[BoolArray]
) -> tuple[int, FloatArray]:
    """Number of these rows, and (n_outputs,) mean squares of the errors there, over those of others of the record."""
    chosen = []
    for error, there, others in zip(errors, rows, than, strict=True):
        noise = np.nansum(np.square(error[others]), axis=0) / max(1, others.sum())
        chosen.append(np.square(error[there]) / np.maximum(noise, TINY))
    squares = np.vstack(chosen)
    n = int(np.isfinite(squares).all(axis=1).sum())
    return n, np.nansum(squares, axis=0) / max(1, n) + TINY


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
