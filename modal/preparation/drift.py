"""Slow drift of the sensors: found in what a model leaves of the outputs, and taken off.

A linear system answers slow functions of time with slow functions of time. So what spans the drift (a straight line, a
parabola, slow half-waves over the record) is taken off the inputs as well as off the outputs, and the relation between
the two stays what it was (partial regression: Frisch, Waugh, Econometrica 1(4), 1933, doi 10.2307/1907330); only what
the record says about these few frequencies next to zero is given up.

Two quick models decide, one of the records as they are and one of the records without any slow motion. Each runs freely
with the inputs as they are. If the second, with a few slow functions of time beside it, is nearer to rows that those
functions were not fitted to, there is a drift; if the first is as near, its own slow poles explain the motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from modal.estimation.free_run import ModalForm, free_run, free_runs, run_from_rest
from modal.modes.mode import Choice
from modal.preparation.quick_model import QuickModel, quick_model
from okid.arrays import FloatArray
from okid.record import Record

CANDIDATES = (0, 1, 2, 3, 4, 6, 8, 12)
"""Numbers of slow functions besides the constant: a straight line, a parabola, then half-waves over the record."""
SAMPLES_PER_FUNCTION = 40
"""A record shorter than this many samples a function gets fewer functions."""
N_FOLDS = 5
HELD_OUT = 4
"""Blocks side by side that are held out together."""
SIGNIFICANT = 4.0
"""Believe in a drift, or an integrator, where the held-out error falls by so many standard errors."""
AS_GOOD = 2.0
"""Standard errors within which fewer functions stand in for the best number."""
LEAST_SHARE = 0.01
"""Of what all slow functions explain: more functions for less than this are not worth their frequencies."""
LEAST_GAIN = 0.1
"""Part of the slow motion that is left without it by which a drift must lower the held-out error."""
MOST_EXPLAINED = 0.97
"""Part of the slow motion that the largest number of functions must explain; else no drift moves the sensor."""


SLOW_INPUTS = 20.0
"""Power of an input in the slow functions, in that of white noise, from which a drift cannot be told from its doing; a
first-order colour of 0.9 from sample to sample has 19."""

_WANDERS = (
    "The outputs wander in a way that neither the inputs nor a slow drift explains, so the fit stays low and nothing "
    "is known of motion that slow; where a sensor jumped, cut the record there and give the parts as several records."
)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Drift:
    """What is taken off each channel of each record.

    Attributes:
        n_functions: slow functions besides the mean: 0 none, 1 a straight line, 2 a parabola too, more: half-waves too.
        choice: what was chosen and why.
        warning: a sentence where slow motion is left that no number of functions explains, else empty.
    """

    n_functions: int
    choice: Choice
    warning: str = ""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SlowMotion:
    """Means of a record over blocks: fast noise goes, drift stays.

    Attributes:
        means: (n_blocks, n_outputs), nan where nothing of a block was measured.
        n_samples: of the record.
    """

    means: FloatArray
    n_samples: int


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FreedTrials:
    """Quick models of the same records, their inputs summed and slow functions taken off; each is made once.

    Attributes:
        records: means off, outputs divided by their size over all records, so that each counts alike.
        size: (n_outputs,) of each.
        models: made so far, by the number of sums and of slow functions.
        remainders: of their free runs, likewise.
    """

    records: tuple[Record, ...]
    size: FloatArray
    models: dict[tuple[int, int], QuickModel | None] = field(default_factory=dict)
    remainders: dict[tuple[int, int], tuple[SlowMotion, ...]] = field(default_factory=dict)

    @classmethod
    def of(cls, records: Sequence[Record]) -> "FreedTrials":
        """No model made yet."""
        squares = sum(np.nansum(np.square(r.outputs - np.nanmean(r.outputs, axis=0)), axis=0) for r in records)
        size = np.sqrt(squares / sum(record.n_samples for record in records))
        size = np.where(size > 0.0, size, 1.0)
        sized = (replace(record, outputs=record.outputs / size) for record in records)
        return cls(records=tuple(without_drift(record, 0) for record in sized), size=size)

    def freed(self, number: int, n_functions: int) -> tuple[Record, ...]:
        """The records with their inputs summed so often, then freed of slow functions (as many as sums, at least)."""
        n_functions = max(number, n_functions)
        if n_functions == 0:
            return self.records
        return tuple(without_drift(summed_inputs(record, number), n_functions) for record in self.records)

    def model(self, number: int, n_functions: int) -> QuickModel | None:
        """The quick model of these records; None where none is stable."""
        key = number, max(number, n_functions)
        if key not in self.models:
            self.models[key] = quick_model(self.freed(*key))
        return self.models[key]

    def left(self, number: int, n_functions: int) -> tuple[SlowMotion, ...] | None:
        """The slow motion that the free run of this model leaves of its records; None without a model."""
        key = number, max(number, n_functions)
        model = self.model(*key)
        if model is None:
            return None
        if key not in self.remainders:
            freed = self.freed(*key)
            runs = zip(freed, free_runs(model.form, freed), strict=True)
            self.remainders[key] = slow_motion([record.outputs - run for record, run in runs])
        return self.remainders[key]


def choose_drift(records: Sequence[Record], *, trials: FreedTrials | None = None) -> Drift:
    """The fewest slow functions that are needed beside a model's free run on held-out rows.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> force = rng.standard_normal(2000)
        >>> tip = np.convolve(force, [0.0, 1.0, 0.5])[:2000] + np.linspace(0.0, 1.0, 2000)
        >>> choose_drift([Record(force, tip, 0.01)]).n_functions
        1
    """
    first = records[0]
    if first.n_inputs == 0:
        return _explained(0, first, "without inputs a drift cannot be told from slow motion of the system")
    most = max(record.n_samples for record in records) // SAMPLES_PER_FUNCTION
    candidates = [n for n in CANDIDATES if n <= most] or [0]
    share = _slow_share(records, candidates[-1])
    if share > SLOW_INPUTS:
        return _explained(
            0,
            first,
            f"the inputs move as slowly themselves ({share:.3g} times as much as white noise does), so slow motion of "
            "the outputs may be their doing",
        )
    trials = FreedTrials.of(records) if trials is None else trials
    explains_nothing = _explained(0, first, "slow functions of time explain nothing that a model does not explain")
    own = trials.left(0, 0)
    if own is not None and lasting_share(own) <= LEAST_GAIN:
        return explains_nothing
    slow_free = trials.model(0, candidates[-1])
    if slow_free is None or candidates[-1] == 0:
        return _explained(0, first, "no model to tell a drift by")
    left = slow_motion([_remainder(slow_free.form, record, candidates[-1]) for record in trials.freed(0, 0)])
    errors = {n: held_out_squares(left, n) for n in candidates}
    best = min(candidates, key=lambda n: float(errors[n].sum()))
    worth = LEAST_SHARE * float((errors[0] - errors[best]).sum())
    chosen = next(
        n
        for n in candidates
        if (errors[n] - errors[best]).sum() <= worth or not is_significant(errors[n] - errors[best], AS_GOOD)
    )
    without = errors[0]
    if own is not None:
        explained = held_out_squares(own, 0)
        without = explained if explained.sum() < without.sum() else without
    gain = without - errors[chosen]
    worth_it = chosen > 0 and is_significant(gain, SIGNIFICANT) and gain.sum() >= LEAST_GAIN * without.sum()
    confirmed = trials.left(0, chosen) if worth_it else None
    # a model of the records without these functions must leave clearly less slow motion than one with them
    if confirmed is None or held_out_squares(confirmed, chosen).sum() >= 0.5 * without.sum():
        return explains_nothing
    share = float(gain.sum() / without.sum())
    return _explained(
        chosen,
        first,
        f"explains {100 * share:.4g} % of the slow motion that a model without it leaves on "
        "held-out rows; taken off inputs and outputs alike, so that their relation stays what it is",
        warning=_WANDERS if chosen == candidates[-1] and share < MOST_EXPLAINED else "",
    )


def _slow_share(records: Sequence[Record], n_functions: int) -> float:
    """Largest power of an input in the slow functions, relative to that of white noise of the same size."""
    slow, whole, white = 0.0 * records[0].inputs[0], 0.0 * records[0].inputs[0], 0.0
    for record in records:
        inputs = record.inputs - record.inputs.mean(axis=0)
        functions = slow_functions(record.n_samples, min(n_functions, record.n_samples // SAMPLES_PER_FUNCTION))
        slow = slow + np.square(functions @ _coefficients(inputs, functions)).sum(axis=0)
        whole = whole + np.square(inputs).sum(axis=0)
        white += functions.shape[1] - 1
    n_samples = sum(record.n_samples for record in records)
    return float((slow / np.maximum(whole, np.finfo(float).tiny)).max() * n_samples / max(white, 1.0))


def given_drift(n_functions: int, record: Record) -> Drift:
    """So many slow functions as the caller chose."""
    return _explained(n_functions, record, "given as an argument")


def integrator_drift(n_integrators: int, record: Record) -> Drift:
    """What unknown states and input means make of integrators; more drift than that cannot be told from them."""
    return _explained(n_integrators, record, "the unknown start of the integrators; more cannot be told from them")


def without_drift(record: Record, n_functions: int) -> Record:
    """Every channel less its mean and slow functions, by least squares over the samples that are there.

    Args:
        record: to be freed of its drift.
        n_functions: 0 takes off the mean, 1 a straight line too, 2 a parabola, more: half-waves. A short record gets
            fewer.

    Example:
        >>> line = Record([0.0, 1.0] * 40, np.arange(80.0), 0.1)
        >>> bool(abs(without_drift(line, 1).outputs).max() < 1e-12)
        True
    """
    functions = slow_functions(record.n_samples, min(n_functions, record.n_samples // SAMPLES_PER_FUNCTION))
    return replace(record, inputs=_less(record.inputs, functions), outputs=_less(record.outputs, functions))


def slow_functions(n_samples: int, n_functions: int) -> FloatArray:
    """(n_samples, 1 + n_functions): a constant, a straight line, a parabola, then 1, 2, ... half-waves."""
    if n_functions == 0:
        return np.ones((n_samples, 1))
    time = (np.arange(n_samples) + 0.5) / n_samples
    waves = [np.cos(np.pi * k * time) for k in range(1, n_functions - 1)]
    line = 2.0 * time - 1.0
    return np.vstack([np.ones(n_samples), line, 1.5 * line**2 - 0.5, *waves])[: 1 + n_functions].T


def _less(values: FloatArray, functions: FloatArray) -> FloatArray:
    return values - functions @ _coefficients(values, functions)


def _coefficients(values: FloatArray, functions: FloatArray) -> FloatArray:
    """(n_functions, n_channels) by least squares over the samples of each channel that are there."""
    found = np.zeros((functions.shape[1], values.shape[1]))
    complete = ~np.isnan(values.sum(axis=0))
    if complete.any():
        # normal equations: a hundredth of the cost on a million samples
        products = functions.T @ functions, functions.T @ values[:, complete]
        found[:, complete] = np.linalg.lstsq(*products, rcond=None)[0]
    for i in np.flatnonzero(~complete):
        rows = ~np.isnan(values[:, i])
        found[:, i] = np.linalg.lstsq(functions[rows], values[rows, i], rcond=None)[0]
    return found


def _remainder(model: ModalForm, record: Record, n_functions: int) -> FloatArray:
    """What the free run with the record's own inputs leaves, the initial state fitted beside all slow functions."""
    there = ~np.isnan(record.outputs)
    functions = slow_functions(record.n_samples, min(n_functions, record.n_samples // SAMPLES_PER_FUNCTION))
    slow = functions @ _coefficients(record.outputs - run_from_rest(model, record.inputs), functions)
    run = free_run(model, replace(record, outputs=record.outputs - slow), there)
    left: FloatArray = record.outputs - run.outputs + run.level
    return left


def summed_inputs(record: Record, number: int) -> Record:
    """The record with each input summed so many times: s(k) = u(0) + ... + u(k), u about its mean.

    Example:
        >>> summed_inputs(Record([2.0, 0.0, 1.0], [0.0, 0.0, 0.0], 0.1), 1).inputs.ravel().tolist()
        [1.0, 0.0, 0.0]
    """
    inputs = record.inputs
    for _ in range(number):
        inputs = np.cumsum(inputs - inputs.mean(axis=0), axis=0)
    return replace(record, inputs=inputs) if number else record


def slow_motion(left: Sequence[FloatArray]) -> tuple[SlowMotion, ...]:
    """Block means of (n_samples, n_outputs) a record; of many short ones the longest still holds two groups."""
    lengths = [len(one) for one in left]
    n_rows = max(1, min(sum(lengths) // 600, max(lengths) // (2 * HELD_OUT)))  # fast noise goes, drift stays
    motion = []
    for values in left:
        n_blocks = len(values) // n_rows
        blocks = values[: n_blocks * n_rows].reshape(n_blocks, n_rows, values.shape[1])
        counts = (~np.isnan(blocks)).sum(axis=1)
        means = np.where(counts > 0, np.nansum(blocks, axis=1) / np.maximum(counts, 1), np.nan)
        motion.append(SlowMotion(means=means, n_samples=len(values)))
    return tuple(motion)


def held_out_squares(left: Sequence[SlowMotion], n_functions: int) -> FloatArray:
    """Squared errors of groups of held-out block means, predicted by slow functions fitted to the other blocks."""
    groups = []
    for one in left:
        blocks = one.means
        functions = slow_functions(len(blocks), min(n_functions, one.n_samples // SAMPLES_PER_FUNCTION))
        group = np.arange(len(blocks)) // HELD_OUT
        squares = np.zeros(blocks.shape)
        for fold in range(N_FOLDS):
            held = group % N_FOLDS == fold
            if held.any() and not held.all():
                coefficients = _coefficients(blocks[~held], functions[~held])
                squares[held] = np.nan_to_num(np.square(blocks[held] - functions[held] @ coefficients))
        if len(blocks):
            groups.append(np.bincount(group, weights=squares.sum(axis=1)))
    return np.concatenate(groups)


def lasting_share(left: Sequence[SlowMotion]) -> float:
    """Part of the mean square of the block means that lasts from one block to the next.

    Half the mean square of the differences of neighbours is what does not last: all of white noise, next to nothing of
    slow motion (von Neumann, Annals of Mathematical Statistics 12(4), 1941, doi 10.1214/aoms/1177731677). What slow
    functions or sums of the inputs explain lasts, so they explain no larger part.

    Example:
        >>> alternating, rising = np.array([[1.0], [-1.0]] * 4), np.arange(-9.0, 10.0)[:, np.newaxis]
        >>> [round(lasting_share(slow_motion([values])), 3) for values in (alternating, rising)]
        [-0.75, 0.984]
    """
    whole = sum(float(np.nansum(np.square(one.means))) for one in left)
    passing = sum(0.5 * float(np.nansum(np.square(np.diff(one.means, axis=0)))) for one in left)
    return 1.0 - passing / whole if whole > 0.0 else 0.0


def is_significant(gain: FloatArray, limit: float) -> bool:
    """Whether the sum of the differences exceeds so many of its standard errors."""
    shares = gain / max(float(np.abs(gain).max(initial=0.0)), np.finfo(float).tiny)  # squares of squares overflow
    return bool(shares.sum() > limit * np.sqrt(gain.size) * shares.std(ddof=1))


def _explained(n_functions: int, record: Record, reason: str, *, warning: str = "") -> Drift:
    n_waves = n_functions - 2
    value = {0: "none", 1: "a straight line", 2: "a parabola"}.get(
        n_functions, f"a parabola and {n_waves} half-waves: up to {n_waves / (2.0 * record.duration):.2g} Hz"
    )
    return Drift(n_functions=n_functions, choice=Choice(what="drift", value=value, reason=reason), warning=warning)
