"""What the sensor of a force erred by while a blow acted, as far as what followed tells.

Between blows a force window makes the force zero: nothing acts. Within a blow the sensor errs as much, and all that
follows is the answer to what acted, not to what it showed: each blow's answer is then off by a little of its own, many
times the noise of the outputs where that is small. With x what a force lacked, white, of the variance Q that it shows
at rest, what is left is

    r = T x + n,   T = the answers to unit pulses,   var n = s W^-1,   var x = Q

The model moves with x: P projects on all that its parameters explain. So with

    H = T'W (I - P) T,   b = T'W (I - P) r,   var b = s H + H Q H

the likeliest x is (H + s Q^-1)^-1 b (Gauss-Markov, with what the sensor is known by as the prior), s (H + s Q^-1)^-1 is
how far it may be off, and s is the likeliest for r: noise of the outputs alone, not the answers to what is looked for.
Added to the force, and refined again, the model is the likeliest for both noises. Rows in which a blow acts are not
asked, only what follows: what a blow does beyond half the sampling rate ends with it.

What is left may say no: errors larger than the sensor's are of something else (a structure that is not linear answers
each blow as differently), and the force stays as it was measured.

References:
    Van Huffel and Vandewalle, The Total Least Squares Problem, SIAM, 1991, doi:10.1137/1.9781611971002, chapter 8;
    Golub and Pereyra, SIAM Journal on Numerical Analysis 10(2), 1973, 413-432, doi:10.1137/0710036 (projection);
    Harville, Journal of the American Statistical Association 72(358), 1977, 320-338, doi:10.2307/2286796 (likeliest
    variances).
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from modal.estimation.free_run import powers_of
from modal.estimation.modal_parameters import errors_of
from modal.estimation.modal_states import CHUNK, IndexArray, signals_of
from modal.estimation.output_error import (
    OutputError,
    RefinementStep,
    Span,
    refine,
    step_at,
)
from modal.estimation.weights import UNTIL_STILL, Weighted, beside_blows, set_aside, struck_apart, weighted
from okid.arrays import TINY, BoolArray, ComplexArray, FloatArray
from okid.rows import runs_of

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
UNEXPLAINED = 1e-4
"""Ask nothing of answers of which the model explains all but such a share of the power: rows aside tell that."""
ROUNDING = 1e-10
"""Take no smaller share of the squares for noise of the outputs: it is rounding."""
MOST_TOGETHER = 3000
"""Errors of all records' forces up to which they are told together."""


def forces_told(
    model: Weighted, data: OutputError, *, acting: Sequence[BoolArray], variances: FloatArray, least_gain: float
) -> tuple[Weighted, tuple[FloatArray, ...]]:
    """The likeliest forces by turns with the model until neither moves, and rows weighed by what is left then.

    Rows in which a blow errs by itself, or what a filter rings on does, are no longer asked once they are known.

    Args:
        model: with forces as they were measured, or the likeliest ones so far.
        data: with forces as they were measured.
        acting: (n_samples,) a record, True where a blow acts.
        variances: (n_records, n_inputs) of the noise of the forces, of the data.
        least_gain: relative decrease of the error by a step below which it is the last.

    Returns:
        The model, and (n_samples, n_inputs) a record, what the forces of the data erred by; none where what is left is
        larger than noise of the sensors makes it, and then forces are as they were measured.
    """
    first, erred = _told_to(model, data, beside_blows(acting), variances, least_gain)
    apart = struck_apart(first, acting, least_gain)
    if not (apart.data.measured and variances.any()):
        return apart, erred
    return _told_to(apart, data, [~rows[:, 0] for rows in apart.data.measured], variances, least_gain)


def _told_to(
    model: Weighted, data: OutputError, aside: Sequence[BoolArray], variances: FloatArray, least_gain: float
) -> tuple[Weighted, tuple[FloatArray, ...]]:
    """As `forces_told`, beside the rows that are given."""
    if not variances.any():
        return model, ()
    triples = zip(model.data.records, data.records, model.record_scale, strict=True)
    measured = replace(model.data, records=tuple(replace(one, inputs=own.inputs / k) for one, own, k in triples))
    own_variances = variances / np.square(model.record_scale)[:, np.newaxis]
    step, now, errors = by_turns(model.step, measured, aside, own_variances, least_gain, weights=model.weights)
    if not errors:
        step = step_at(step.parameters, now, weights=model.weights)
    settled = weighted(step, now, least_gain)
    settled = replace(settled, record_scale=model.record_scale * settled.record_scale)
    return settled, tuple(own * k for own, k in zip(errors, model.record_scale, strict=False))


def by_turns(
    step: RefinementStep,
    data: OutputError,
    aside: Sequence[BoolArray],
    variances: FloatArray,
    least_gain: float,
    *,
    weights: FloatArray | None = None,
) -> tuple[RefinementStep, OutputError, tuple[FloatArray, ...]]:
    """The model and the likeliest forces by turns until neither moves.

    Args:
        step: the model.
        data: with forces as they were measured.
        aside: (n_samples,) a record, True where a blow acts, or errs by itself, and is not asked.
        variances: (n_records, n_inputs) of the noise of the forces, of the data.
        least_gain: relative decrease of the error by a step below which it is the last.
        weights: (n_outputs, n_outputs) of the squared errors.

    Returns:
        The model, data with the likeliest forces, and what those that were measured erred by; as it was and none where
        what is left is larger than noise of the sensors makes it.
    """
    now, told = step, data
    errors = tuple(np.zeros_like(record.inputs) for record in data.records)
    turns = TURNS if variances.any() and step.layout.n_poles else 0
    for _ in range(turns):
        likely = likely_forces(now, told, errors, aside, variances)
        if likely is None or not likely.chance > CHANCE:
            return step, data, ()
        errors = likely.errors(data)
        pairs = zip(data.records, errors, strict=True)
        told = replace(data, records=tuple(replace(one, inputs=one.inputs - own) for one, own in pairs))
        begun = step_at(now.parameters, told, weights=weights)
        now = refine(begun, told, n_steps=UNTIL_STILL, least_gain=least_gain, weights=weights)[-1]
        if now.error > (1.0 - STANDS_STILL) * begun.error:
            break
    return now, told, errors if turns else ()


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LikelyForces:
    """What the forces of records erred by: the likeliest, and how far it may be off.

    Attributes:
        row: (n,) a record, of each error.
        which: (n,) a record, its input.
        deviation: (n,) a record, of the sensor.
        directions: (n, n_told) a record, combinations of errors, of unit deviation, that what follows tells of alone.
        vectors: (n_told of all records, n_told) combinations of those that are independent of each other.
        power: (n_told,) of the answer to each, beside what the model explains, over that of the noise.
        likeliest: (n_told,) of each, in deviations of the sensor.
        chance: of errors as large as those that are left by noise of the sensors.
    """

    row: tuple[IndexArray, ...]
    which: tuple[IndexArray, ...]
    deviation: tuple[FloatArray, ...]
    directions: tuple[FloatArray, ...]
    vectors: FloatArray
    power: FloatArray
    likeliest: FloatArray
    chance: float

    @property
    def times(self) -> float:
        """How many times as large as by noise of the sensors and of the outputs what is left is."""
        return float(np.sqrt(np.mean(self.likeliest**2 * (1.0 + self.power) / self.power)))

    def errors(self, data: OutputError) -> tuple[FloatArray, ...]:
        """(n_samples, n_inputs) a record, the likeliest."""
        found = tuple(np.zeros_like(record.inputs) for record in data.records)
        told = self._of_each(self.vectors @ self.likeliest)
        for own, row, which, size, one in zip(found, self.row, self.which, self.deviation, told, strict=True):
            own[row, which] = size * one
        return found

    def drawn(self, rng: np.random.Generator, n_draws: int) -> list[FloatArray]:
        """(n, n_draws) a record, what else they may have erred by: as the sensor errs where nothing follows."""
        free = [rng.standard_normal((size.size, n_draws)) for size in self.deviation]
        alone = self.vectors.T @ np.vstack([own.T @ one for own, one in zip(self.directions, free, strict=True)])
        told = rng.standard_normal(alone.shape) / np.sqrt(1.0 + self.power)[:, np.newaxis]
        parts = self._of_each(self.vectors @ (told - alone))
        return [size[:, np.newaxis] * (one + part) for size, one, part in zip(self.deviation, free, parts, strict=True)]

    def _of_each(self, told: FloatArray) -> list[FloatArray]:
        """(n, ...) a record, errors in deviations of the sensor, of (n_told of all records, ...) told combinations."""
        ends = np.cumsum([own.shape[1] for own in self.directions])[:-1]
        return [own @ part for own, part in zip(self.directions, np.split(told, ends), strict=True)]


def likely_forces(
    step: RefinementStep,
    told: OutputError,
    erred: Sequence[FloatArray],
    aside: Sequence[BoolArray],
    variances: FloatArray,
    *,
    late: float = 0.0,
) -> LikelyForces | None:
    """The likeliest errors of the forces beside all that the model can explain; None where there are none or too many.

    Args:
        step: the model, fitted to the data.
        told: data with forces less what they are thought to have erred by.
        erred: (n_samples, n_inputs) a record, by that.
        aside: (n_samples,) a record, True where a blow acts, or errs by itself, and is not asked.
        variances: (n_records, n_inputs) of the noise of the forces; zero where there is none.
        late: share of the rows after a blow that have passed before the same errors are asked as if it had just ended:
            of motion that no blow made they are as large there, and of what a blow made they have faded.
    """
    moves, quiet = [], []
    for record, wrong, rows, variance in zip(told.records, erred, aside, variances, strict=True):
        forces = record.inputs + wrong  # a force window leaves no noise elsewhere
        moves.append((forces != np.median(forces, axis=0)) & (variance > 0.0))
        quiet.append(~(rows | moves[-1].any(axis=1)))
    counts = [int(own.sum()) for own in moves]
    if max(counts) > MOST or sum(counts) > MOST_TOGETHER:
        return None
    places = [np.nonzero(own) for own in moves]
    deviations = [np.sqrt(variance[which]) for (_, which), variance in zip(places, variances, strict=True)]
    parts = zip(places, deviations, quiet, strict=True)
    left = [_LeftBehind.by(step, row, which, size, rows, late=late) for (row, which), size, rows in parts]
    beside = _Beside.blows(step, told, [own.of_those(rows) for own, rows in zip(left, quiet, strict=True)])
    model = beside.span
    lengths = np.concatenate([own.asked for own in left])
    grams = _free_grams(step.parameters.poles, model.step.linear.shapes, model.weights, lengths)
    answers = [_told(own, model, told, number, grams) for number, own in enumerate(left)]
    before = [
        own.directions.T @ (-wrong[at] / size)
        for own, wrong, at, size in zip(answers, erred, places, deviations, strict=True)
    ]
    z, power = np.concatenate(before), np.concatenate([one.power for one in answers])
    explained = np.vstack([one.explained for one in answers])
    b = np.concatenate([one.product for one in answers]) - explained[:, model.n_linear :] @ model.pull
    size = np.sqrt(power)[:, np.newaxis]
    share, axes = np.linalg.eigh(np.eye(power.size) - (explained / size) @ (explained / size).T)
    free = share > UNEXPLAINED  # what the model explains to rounding tells nothing
    H = (size * axes[:, free] * share[free]) @ (size * axes[:, free]).T
    b = size[:, 0] * (axes[:, free] @ (axes[:, free].T @ (b / size[:, 0])))
    g, X = np.linalg.eigh(H)
    seen = g > TOLD
    if not seen.any():
        return None
    squares = beside.squares - float(model.pull @ model.pull) + float(z @ (2.0 * b + H @ z))
    g, X = g[seen], X[:, seen]
    products = X.T @ b + g * (X.T @ z)
    noise = _noise(g, products, squares, beside.n_values - explained.shape[1])
    return LikelyForces(
        row=tuple(row for row, _ in places),
        which=tuple(which for _, which in places),
        deviation=tuple(deviations),
        directions=tuple(one.directions for one in answers),
        vectors=X,
        power=g / noise,
        likeliest=-products / (noise + g),  # too much is what was not missing
        chance=float(scipy.special.chdtrc(g.size, (products**2 / (g * (noise + g))).sum())),
    )


def _noise(power: FloatArray, products: FloatArray, squares: float, freedom: int) -> float:
    """Variance of the outputs' noise that is likeliest for what is left beside the model (restricted likelihood).

    Args:
        power: (n,) g of the answers to independent combinations of errors of unit variance.
        products: (n,) of what is left with each: of variance s g + g^2.
        squares: sum of those of what is left.
        freedom: dimensions that it has.
    """
    others = max(1, freedom - power.size)
    rest = max(squares - float((products**2 / power).sum()), ROUNDING * squares, TINY)

    def surprise(logarithm: float) -> float:
        s = np.exp(logarithm)
        own = np.log(s + power) + products**2 / (power * (s + power))
        return float(others * logarithm + rest / s + own.sum())

    bounds = np.log([0.5 * rest / (others + power.size), 4.0 * max(squares, rest) / others])
    return float(np.exp(scipy.optimize.minimize_scalar(surprise, bounds=bounds, method="bounded").x))


@dataclass(frozen=True, slots=True, eq=False)
class _Beside:
    """A model by the rows in which no blow acts, weighed by their noise.

    Attributes:
        span: what it explains.
        n_values: that are asked.
        squares: weighted sum of those of the errors.
    """

    span: Span
    n_values: int
    squares: float

    @classmethod
    def blows(cls, step: RefinementStep, told: OutputError, quiet: Sequence[BoolArray]) -> "_Beside":
        """The model with its linear part by these rows alone."""
        asked = set_aside(told, [~rows for rows in quiet])
        own = step_at(step.parameters, asked)
        errors = np.vstack(errors_of(own, asked))
        counts, squares = np.isfinite(errors).sum(axis=0), np.nansum(np.square(errors), axis=0)
        weights = counts / np.maximum(squares, TINY)
        return cls(Span.of(own, weights), int(counts.sum()), float((weights * squares).sum()))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Answers:
    """What follows the errors of one record's forces, in combinations whose answers are independent of each other.

    Attributes:
        directions: (n, n_told) combinations of errors, of unit deviation.
        power: (n_told,) of the answers.
        explained: (n_told, n_explained) of them by the model.
        product: (n_told,) with what is left.
    """

    directions: FloatArray
    power: FloatArray
    explained: FloatArray
    product: FloatArray


def _told(
    left: "_LeftBehind", model: Span, told: OutputError, number: int, grams: Mapping[int, FloatArray]
) -> _Answers:
    layout = model.step.layout
    alone, places = layout.alone, layout.places(number)
    power, directions = np.linalg.eigh(left.gram(grams))
    told_of = power > TOLD
    power, directions = power[told_of], directions[:, told_of]
    signals = signals_of(layout, model.step.parameters, number, told.records[number])
    products = np.tensordot(directions.T, left.products(signals, alone.size, model.step.linear.shapes), axes=1)
    error = np.zeros((alone.size, alone.n_outputs))
    error[alone.regressors] = -model.step.linear.coefficients[places[alone.regressors]]
    error[alone.outputs] = np.eye(alone.n_outputs)
    whole = np.zeros((power.size, layout.size, layout.n_outputs))
    whole[:, places] = products
    return _Answers(
        directions=directions,
        power=power,
        explained=model.coordinates(whole),
        product=np.tensordot(products, error * model.weights, axes=2),
    )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _LeftBehind:
    """What errors of one record's forces leave behind: states at the end of a blow, which then move freely.

    Attributes:
        states: (n, n_poles) by an error of one deviation, at the end of its blow.
        blow: (n,) to which each error belongs.
        ends: (n_blows,) row from which each is asked.
        asked: (n_blows,) rows from there to the next one, or to the end of the record.
        passed: (n_blows,) rows between a blow and where it is asked.
        poles: (n_poles,).
    """

    states: ComplexArray
    blow: IndexArray
    ends: IndexArray
    asked: IndexArray
    passed: IndexArray
    poles: ComplexArray

    @classmethod
    def by(
        cls,
        step: RefinementStep,
        row: IndexArray,
        which: IndexArray,
        deviation: FloatArray,
        quiet: BoolArray,
        *,
        late: float,
    ) -> "_LeftBehind":
        """Errors of these deviations in rows of these inputs, none of which is quiet, asked so late."""
        runs = np.array(runs_of(~quiet), dtype=np.intp).reshape(-1, 2)
        ends, poles = runs[:, 1], step.parameters.poles
        blow = np.searchsorted(ends, row, side="right")
        past = poles ** (ends[blow] - 1 - row)[:, np.newaxis]
        states = past * step.parameters.inputs.T[which] * deviation[:, np.newaxis]
        asked = np.append(runs[1:, 0], len(quiet)) - ends if len(runs) else ends
        passed = (late * asked).astype(np.intp)
        return cls(states=states, blow=blow, ends=ends + passed, asked=asked - passed, passed=passed, poles=poles)

    def of_those(self, quiet: BoolArray) -> BoolArray:
        """(n_samples,) those of the quiet rows that are asked: none that has passed after a blow."""
        asked = quiet.copy()
        for end, n_passed in zip(self.ends, self.passed, strict=True):
            asked[end - n_passed : end] = False
        return asked

    @property
    def until(self) -> IndexArray:
        """(n_blows,) rows from the end of each blow to that of the next, or of the record."""
        return np.append(np.diff(self.ends), self.asked[-1:])

    def gram(self, grams: Mapping[int, FloatArray]) -> FloatArray:
        """(n, n) of the answers in the rows that are asked.

        Args:
            grams: (2 n_poles, 2 n_poles) of free motion in so many rows.
        """
        found = np.zeros((len(self.states), len(self.states)))
        now = np.zeros_like(self.states)
        for k, (n_asked, until) in enumerate(zip(self.asked.tolist(), self.until.tolist(), strict=True)):
            now[self.blow == k] = self.states[self.blow == k]
            real = np.hstack([now.real, now.imag])
            found += real @ grams[n_asked] @ real.T
            now *= self.poles**until
        return 0.5 * (found + found.T)

    def products(self, signals: Iterable[tuple[int, FloatArray]], size: int, shapes: ComplexArray) -> FloatArray:
        """(n, size, n_outputs) of the answers with signals, in the rows that are asked.

        Each stretch of rows adds to the sums over k of s(k) lambda^k, which are run through backwards.

        Args:
            signals: first row and (n_rows, size) of each chunk of rows, one after the other.
            size: number of signals.
            shapes: (n_outputs, n_poles).
        """
        powers = powers_of(self.poles, CHUNK)
        sums = np.zeros((len(self.ends), size, self.poles.size), dtype=np.complex128)
        for first, every in signals:
            for k, (end, n_asked) in enumerate(zip(self.ends, self.asked, strict=True)):
                start, stop = max(first, end), min(first + len(every), end + n_asked)
                if start < stop:
                    own = every[start - first : stop - first]
                    sums[k] += own.T @ powers[: len(own)] * self.poles ** (start - end)
        found = np.empty((len(self.states), size, len(shapes)))
        later = np.zeros((size, self.poles.size), dtype=np.complex128)
        for k in reversed(range(len(self.ends))):
            later = sums[k] + self.poles ** self.until[k] * later
            of_blow = np.flatnonzero(self.blow == k)
            for output, shape in enumerate(shapes):
                found[of_blow, :, output] = ((self.states[of_blow] * shape) @ later.T).real
        return found


def _free_grams(
    poles: ComplexArray, shapes: ComplexArray, weights: FloatArray, lengths: IndexArray
) -> dict[int, FloatArray]:
    """(2 n_poles, 2 n_poles) of free motion, weighted, in so many rows, by real and imaginary parts of where it starts.

    Row by row: where two real poles nearly coincide closed sums cancel.
    """
    n = poles.size
    found, total, first = {}, np.zeros((2 * n, 2 * n)), 0
    weighted = np.sqrt(weights)[:, np.newaxis] * shapes
    for length in np.unique(lengths):
        while first < length:
            n_rows = min(CHUNK, length - first)
            moved = (powers_of(poles, n_rows) * poles**first)[:, np.newaxis] * weighted
            flat = np.concatenate([moved.real, -moved.imag], axis=2).reshape(-1, 2 * n)
            total = total + flat.T @ flat
            first += n_rows
        found[int(length)] = total
    return found
