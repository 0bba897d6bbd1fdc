"""Frequency and damping of each mode at each level: how the best linear model moves with the size of the motion.

A spring that hardens raises the frequency with level, one that softens, yields or slips lowers it; dry friction lowers
the damping ratio, drag raises it.

One model order serves all levels: that of the level which a linear model fits best, the smallest whose free run comes
within a quarter of the nearest, because the states that a larger order spends on a nonlinear law are no modes. That
level's model is refined by output error; from there the neighbouring levels are refined one after the other, each from
the model of the level before it, so that a mode is followed and not found anew.

The curvature of the output error takes what is left over for noise, but what a nonlinear law leaves over moves with
the motion. So every level is also refined on its quarters, from its own model, and the larger of the two deviations
counts.

In free decays the level is the motion itself, and falls within one record. A record that no input drives is cut into
windows; each is the answer to a pulse at its first sample and to its own initial state, so that ERA takes its outputs
for Markov parameters and the refinement for any other record.

References:
    Kerschen, Worden, Vakakis, Golinval, Past, present and future of nonlinear system identification in structural
    dynamics, Mechanical Systems and Signal Processing 20(3), 2006, 505-592, doi 10.1016/j.ymssp.2005.04.008.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from era.balanced import decompose, realise_from
from era.realisation import Realisation
from modal.estimation.cross_validation import hankel_limits
from modal.estimation.free_run import free_runs, modal_form
from modal.estimation.output_error import SMALLEST_GAIN
from modal.identification.covariance import output_error_uncertainty
from modal.identification.order_search import MOST_STEPS
from modal.identification.refined_search import STANDS_STILL, RefinedModel, refined_model
from modal.localisation.gap import BEYOND_CHANCE, excitation_levels
from modal.modes.extraction import extract_modes
from modal.modes.mode import Mode, ModeKind
from modal.modes.shape_comparison import IndexArray, assurance, pair_greatest_first
from modal.preparation.filling import fill_where_needed
from modal.preparation.quick_model import observer_markov
from modal.preparation.steps import split_at_input_gaps
from okid.arrays import FloatArray, one_blas_thread
from okid.display import Displayed
from okid.errors import IdentificationError
from okid.markov import MarkovParameters
from okid.record import Record
from okid.rows import as_records


def decay_windows(records: Sequence[Record]) -> tuple[Record, ...]:
    """Windows of equal length, each with a pulse for an input; those with missing samples are left out.

    Example:
        >>> decay = np.exp(-0.01 * np.arange(600)) * np.cos(np.arange(600))
        >>> windows = decay_windows([Record([], decay, 0.1)])
        >>> len(windows), windows[1].n_samples, windows[1].start_time
        (6, 100, 10.0)
    """
    windows = []
    for record in records:
        count = int(np.clip(record.n_samples // 80, 1, 6))  # fewer samples hold too little of a slow mode
        bare = replace(record, inputs=np.empty((record.n_samples, 0)), input_names=(), input_units=())
        for part in bare.split(*[1.0 / count] * count):
            if np.isfinite(part.outputs).all() and np.ptp(part.outputs, axis=0).all():
                pulse = np.zeros((part.n_samples, 1))
                pulse[0] = 1.0
                windows.append(replace(part, inputs=pulse, input_names=("pulse",), input_units=("",)))
    return tuple(windows)


def decay_markov(windows: Sequence[Record]) -> MarkovParameters:
    """The outputs of the first window, as those of a pulse one sample before it."""
    answer = windows[0].outputs[:800, :, np.newaxis]  # its cost grows with their cube
    return MarkovParameters(system=np.concatenate([np.zeros_like(answer[:1]), answer]), dt=windows[0].dt)


ORDERS = (1, 2, 3, 4, 6, 8, 10, 12, 16, 20, 24)
"""Try these model orders."""
WITHIN = 1.25
"""Take a smaller order whose error is at most this many times the least."""
NEGLIGIBLE = 1e-4
"""Call an error negligible below this share of the outputs: no measurement would show it."""
DECAY_ORDERS = (1, 2, 3, 4, 6, 8, 10)
"""Try these orders for a window of a free decay."""
DECAY_WITHIN = 2.0
"""Allow more in windows of a free decay, through which a resonance sweeps."""

Start = tuple[float, Realisation | None]
"""Error of a first model relative to the outputs, and the model."""


def driven_start(records: Sequence[Record]) -> Start:
    """Of driven records: cut from a long observer, the smallest whose error is within a quarter of the least.

    The observer needs whole rows, so missing outputs are filled; all that is refined and judged later is measured
    samples only.
    """
    markov = observer_markov(fill_where_needed(records).records)
    candidates = [] if markov is None else _candidates(markov, ORDERS)
    return _smallest([(_error(model, records), model) for model in candidates], WITHIN)


def decay_start(windows: Sequence[Record]) -> Start:
    """Of windows of free decays: cut from the outputs themselves and refined.

    Frequency and damping move within a window already, and ERA spreads that over all its states, so that candidates are
    compared after refinement.
    """
    candidates = _candidates(decay_markov(windows), DECAY_ORDERS)
    better = [refined_level(windows[:1], model) for model in candidates]
    models = [model if one is None else one.realisation for one, model in zip(better, candidates, strict=True)]
    return _smallest([(_error(model, windows[:1]), model) for model in models], DECAY_WITHIN)


def _candidates(markov: MarkovParameters, orders: Sequence[int]) -> list[Realisation]:
    """The stable ones of these orders."""
    decomposition = decompose(markov, max_order=min(max(orders), *hankel_limits(markov)))
    largest = min(decomposition.rank, decomposition.max_order)
    models = [realise_from(decomposition, order) for order in orders if order <= largest]
    return [model for model in models if modal_form(model) is not None]


def _smallest(tried: Sequence[tuple[float, Realisation]], within: float) -> Start:
    least = min((error for error, _ in tried), default=np.inf)
    limit = max(within * least, NEGLIGIBLE)
    return next(((error, model) for error, model in tried if error <= limit), (np.inf, None))


def _error(model: Realisation, records: Sequence[Record]) -> float:
    return float(np.sqrt(unexplained(model, records).mean()))


def refined_level(
    records: Sequence[Record], start: Realisation, *, least_gain: float = SMALLEST_GAIN
) -> RefinedModel | None:
    """The model refined until it stands still; None where it is noise-free, unstable or does not see its modes."""
    # a part of a record may not show a mode at all: then its parameters have no curvature, and their step no end
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        try:
            return refined_model(records, start, MOST_STEPS, least_gain=least_gain)
        except np.linalg.LinAlgError:
            return None


def unexplained(model: Realisation, records: Sequence[Record]) -> FloatArray:
    """(n_outputs,) mean square of the free run's error over the variance of the outputs; infinite where it grows."""
    form = modal_form(model)
    if form is None:
        return np.full(model.n_outputs, np.inf)
    runs = free_runs(form, records)
    errors = np.concatenate([record.outputs - run for record, run in zip(records, runs, strict=True)])
    outputs = np.concatenate([record.outputs for record in records])
    variance = np.nanmean(np.square(outputs), axis=0)
    result: FloatArray = np.nanmean(np.square(errors), axis=0) / np.where(variance > 0.0, variance, 1.0)
    return result


EXPLAINS_NOTHING = 0.9
"""Call outputs unrelated to the inputs from this error on, relative to them."""
FREQUENCY_WIDTH = 0.3
"""Let two modes be one within this width of the logarithm of their frequency ratio; a damping ratio adds to it."""
LEAST_PAIRING = 0.4
"""Pair no modes below this product of assurance and nearness in frequency."""
N_PARTS = 4
"""Refine a level on so many parts by themselves."""
FEWEST_PARTS = N_PARTS - 1
"""Believe no deviation from fewer parts."""
LEAST_DAMPING = 1e-6
"""Drop an oscillatory pole below this damping ratio: the refinement has run into its bound."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LevelFit:
    """The linear model of one level.

    Attributes:
        model: refined on the records of the level.
        modes: oscillatory and real ones, by rising frequency.
        frequency_stds: (n_modes,) [Hz].
        damping_ratio_stds: (n_modes,).
        left_over: (n_outputs,) mean square of what its free run leaves, over the variance of the output.
    """

    model: Realisation
    modes: tuple[Mode, ...]
    frequency_stds: FloatArray
    damping_ratio_stds: FloatArray
    left_over: FloatArray


def follow_levels(
    levels: Sequence[Sequence[Record]], start: Callable[[Sequence[Record]], Start]
) -> tuple[int, tuple[LevelFit | None, ...]] | None:
    """The model of every level, and the index of the level that a linear model fits best; None without any."""
    starts = [start(records) for records in levels]
    best = min(range(len(levels)), key=lambda i: starts[i][0])
    model = starts[best][1]
    if model is None or starts[best][0] > EXPLAINS_NOTHING:
        return None
    fits: list[LevelFit | None] = [None] * len(levels)
    fits[best] = fit = _fitted(levels[best], model)
    for walk in (range(best + 1, len(levels)), range(best - 1, -1, -1)):
        last = model if fit is None else fit.model
        for i in walk:
            fits[i] = found = _fitted(levels[i], last)
            last = last if found is None else found.model
    return best, tuple(fits)


def _fitted(records: Sequence[Record], start: Realisation) -> LevelFit | None:
    """The model refined on one level, with the deviations of its modes; None where it cannot be refined."""
    better = refined_level(records, start)
    left = unexplained(start if better is None else better.realisation, records)
    if better is None:
        # noise-free data leave nothing to refine; anything else does not belong to this level
        if left.mean() > np.square(NEGLIGIBLE):
            return None
        modes = _own_modes(start)
        nothing = np.zeros(len(modes))
        return LevelFit(model=start, modes=modes, frequency_stds=nothing, damping_ratio_stds=nothing, left_over=left)
    if left.mean() > EXPLAINS_NOTHING**2:
        return None
    modes = _own_modes(better.realisation)
    known = output_error_uncertainty(better, modes, n_lags=1)
    scatter = _scatter(records, better.realisation, modes)
    return LevelFit(
        model=better.realisation,
        modes=modes,
        frequency_stds=np.fmax(known.frequency_std, scatter[0]),
        damping_ratio_stds=np.fmax(known.damping_ratio_std, scatter[1]),
        left_over=left,
    )


def _scatter(records: Sequence[Record], model: Realisation, modes: Sequence[Mode]) -> FloatArray:
    """(2, n_modes) deviation of the mean frequency and damping ratio over parts of the records; nan where unknown.

    A few parts know a deviation to a third of itself: each is refined to a tenth of its own, sqrt(n STANDS_STILL).
    """
    found = []
    for part in _parts(records):
        better = refined_level(part, model, least_gain=STANDS_STILL)
        if better is not None:
            others = _own_modes(better.realisation)
            partner = partners(modes, others)
            found.append([_numbers(others, i) for i in partner.tolist()])
    if len(found) < FEWEST_PARTS:
        return np.full((2, len(modes)), np.nan)
    values = np.array(found).reshape(len(found), len(modes), 2)
    there = np.isfinite(values)
    count = there.sum(axis=0)
    mean = np.where(there, values, 0.0).sum(axis=0) / np.maximum(count, 1)
    squares = np.square(np.where(there, values - mean, 0.0)).sum(axis=0)
    deviation = np.sqrt(squares / np.maximum(count - 1, 1) / np.maximum(count, 1))
    return np.where(count >= FEWEST_PARTS, deviation, np.nan).T


def _numbers(modes: Sequence[Mode], index: int) -> tuple[float, float]:
    return (modes[index].frequency, modes[index].damping_ratio) if index >= 0 else (np.nan, np.nan)


def _parts(records: Sequence[Record]) -> list[tuple[Record, ...]]:
    """About four parts of equal length: whole records where there are enough, else pieces of each."""
    if len(records) >= N_PARTS:
        return [tuple(records[i::N_PARTS]) for i in range(N_PARTS)]
    pieces = -(-N_PARTS // len(records))
    shortest = max(len(records[0].output_names), len(records[0].input_names), 100)
    return [
        (part.detrended(),)
        for record in records
        if record.n_samples >= pieces * shortest
        for part in record.split(*[1.0 / pieces] * pieces)
        if np.isfinite(part.outputs).any(axis=0).all()
    ]


def partners(first: Sequence[Mode], second: Sequence[Mode]) -> IndexArray:
    """(n_first,) index of the same mode among `second` by kind, shape and frequency, -1 where there is none.

    Paired one to one, the greatest product of assurance and nearness in frequency first.
    """
    if not first or not second:
        return np.full(len(first), -1, dtype=np.intp)
    alike = assurance(np.array([mode.shape for mode in first]).T, np.array([mode.shape for mode in second]).T)
    one, other = (np.log([mode.frequency for mode in modes]) for modes in (first, second))
    # the more a mode is damped the less is its frequency a property: a real pole moves by factors
    damped = (np.array([mode.damping_ratio for mode in modes]) for modes in (first, second))
    width = FREQUENCY_WIDTH + np.minimum(*np.meshgrid(*damped, indexing="ij"))
    near = np.exp(-np.square((one[:, np.newaxis] - other) / width))
    same_kind = np.array([[a.kind == b.kind for b in second] for a in first])
    likeness = alike * near * same_kind
    return pair_greatest_first(np.where(likeness > LEAST_PAIRING, likeness, 0.0))


def _own_modes(model: Realisation) -> tuple[Mode, ...]:
    """Oscillatory and real ones, but for what the refinement has left on its bound."""
    return tuple(
        mode
        for mode in extract_modes(model)
        if mode.kind == "real" or (mode.kind == "oscillatory" and mode.damping_ratio > LEAST_DAMPING)
    )


Tendency = Literal["rises", "falls", "stays", "mixed", "unknown"]
"""With rising level; "mixed" where it rises and falls, "unknown" where the deviations are too large to tell."""

FREQUENCY_THAT_COUNTS = 2e-3
"""Say nothing of a smaller relative change of a frequency."""
DAMPING_THAT_COUNTS = 0.05
"""Say nothing of a smaller relative change of a damping ratio."""
STAYS_WITHIN = 5.0
"""Say that a mode stays within so many times the change that counts."""
HEAVY = 0.5
"""Leave a mode above this damping ratio, beside lighter ones, to the model's order: it is none of the structure's."""
FASTEST_SEEN = 0.95
"""Drop a mode above this share of the Nyquist frequency, wherever its pole is."""
KNOWN_TO = 0.05
"""Call a mode not found at a level where its frequency has a larger relative deviation."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class LevelMode(Displayed):
    """One mode at every level, nan where it was not found.

    Attributes:
        number: by rising frequency, from 1; oscillatory modes and first-order poles are counted apart.
        kind: "oscillatory", or "real" for a first-order pole.
        frequencies: (n_levels,) |pole| / 2 pi [Hz].
        frequency_stds: (n_levels,) their standard deviations [Hz].
        damping_ratios: (n_levels,).
        damping_ratio_stds: (n_levels,).
        assurances: (n_levels,) of the shape with that of the level which a linear model fits best.
        frequency_tendency: with rising level.
        damping_tendency: with rising level; "unknown" for a real pole.
    """

    number: int
    kind: ModeKind
    frequencies: FloatArray
    frequency_stds: FloatArray
    damping_ratios: FloatArray
    damping_ratio_stds: FloatArray
    assurances: FloatArray
    frequency_tendency: Tendency
    damping_tendency: Tendency


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class LevelModes(Displayed):
    """The modes of the best linear model of each level.

    Attributes:
        levels: (n_levels,) mean size of the excitation (free decays: of the motion) of the records of a level, relative
            to the loudest record.
        modes: by rising frequency, those found at two levels at least.
        left_over: (n_levels, n_outputs) mean square that the level's own linear model leaves, over the variance.
        order: of the linear models, 0 where there is none.
        reason: why there are no modes to compare, "" when there are.
    """

    levels: FloatArray
    modes: tuple[LevelMode, ...]
    left_over: FloatArray
    order: int
    reason: str


def level_modes(records: Record | Sequence[Record]) -> LevelModes:
    """Identify every level by itself and follow each mode from level to level.

    Args:
        records: measured, of one system, of as many levels as there are; records of one level are fitted together.
            Records that no input drives are free decays: their windows are the levels.

    Raises:
        InvalidDataError: records that do not belong together.

    Example:
        >>> force = np.random.default_rng(1).standard_normal(1500)
        >>> tip = np.zeros(1500)
        >>> for k in range(2, 1500):
        ...     tip[k] = 1.6 * tip[k - 1] - 0.9 * tip[k - 2] + force[k - 1]
        >>> noise = 0.01 * np.random.default_rng(2).standard_normal((2, 1500))
        >>> found = level_modes([Record(force, tip + noise[0], 0.01), Record(3 * force, 3 * tip + noise[1], 0.01)])
        >>> [(mode.frequencies.round(2).tolist(), mode.frequency_tendency) for mode in found.modes]
        [([9.07, 9.07], 'stays')]
    """
    several = as_records(records)
    driven = any((np.nanmax(r.inputs, axis=0) > np.nanmin(r.inputs, axis=0)).any() for r in several)
    if not driven:
        several = decay_windows(several) or several
    own, numbers = _levels(several, driven=driven)
    n_levels = int(numbers.max())
    levels = np.array([own[numbers == number].mean() for number in range(1, n_levels + 1)])

    def nothing(reason: str) -> LevelModes:
        left = np.full((n_levels, several[0].n_outputs), np.nan)
        return LevelModes(levels=levels, modes=(), left_over=left, order=0, reason=reason)

    if n_levels < 2:
        return nothing("all records are of one level, so nothing can be followed from level to level")
    groups = [[r for r, own_ in zip(several, numbers.tolist(), strict=True) if own_ == n + 1] for n in range(n_levels)]
    with one_blas_thread():
        try:
            prepared = [_prepared(group) for group in groups]
            found = follow_levels(prepared, driven_start if driven else decay_start)
        except IdentificationError as error:
            return nothing(f"a level could not be identified: {error}".rstrip("."))
    if found is None:
        return nothing("at no level do the outputs follow the inputs as those of a stable linear model")
    best, fits = found
    left = np.array([np.full(several[0].n_outputs, np.nan) if fit is None else fit.left_over for fit in fits])
    reference = fits[best]
    if reference is None:
        return nothing("the model of the most linear level could not be refined")
    modes = _paired(best, fits, reference, dt=several[0].dt)
    reason = "" if modes else "no mode was found again at a second level"
    return LevelModes(levels=levels, modes=modes, left_over=left, order=reference.model.order, reason=reason)


def tendency(values: FloatArray, deviations: FloatArray, *, counts: float) -> Tendency:
    """How numbers with known deviations move from each level to the next.

    Args:
        values: (n_levels,) by rising level, nan where unknown.
        deviations: (n_levels,) standard deviations.
        counts: change relative to the mean from which on it counts.

    Returns:
        "rises" or "falls" when some change between two levels is above both `counts` and four standard deviations and
        none goes the other way; "mixed" when one does; "stays" when every change, two deviations added, is below
        five times `counts` among the levels, more than half of them, whose own two deviations are; else "unknown".

    Example:
        >>> tendency(np.array([5.0, 5.1, 5.3]), np.full(3, 0.01), counts=2e-3)
        'rises'
    """
    known = np.isfinite(values) & np.isfinite(deviations)
    value, deviation = values[known], deviations[known]
    if value.size < 2:
        return "unknown"
    change = value[np.newaxis, :] - value[:, np.newaxis]
    spread = np.sqrt(np.square(deviation)[np.newaxis, :] + np.square(deviation)[:, np.newaxis])
    least = counts * float(np.abs(value).mean())
    upward = np.triu(np.ones(change.shape, dtype=np.bool_), 1)
    up = bool(((change > np.maximum(BEYOND_CHANCE * spread, least)) & upward).any())
    down = bool(((-change > np.maximum(BEYOND_CHANCE * spread, least)) & upward).any())
    if up and down:
        return "mixed"
    if up or down:
        return "rises" if up else "falls"
    telling = 2.0 * deviation < STAYS_WITHIN * least  # a level known less could show no such change, nor refuse one
    between = upward & telling[np.newaxis, :] & telling[:, np.newaxis]
    small = np.abs(change) + 2.0 * spread < STAYS_WITHIN * least
    return "stays" if 2 * telling.sum() > max(telling.size, 2) and small[between].all() else "unknown"


def _levels(records: Sequence[Record], *, driven: bool) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """Level and its number, of the inputs or, for free decays, of the motion."""
    levels, numbers, _ = excitation_levels(records if driven else [record.select(inputs=()) for record in records])
    return levels, numbers


def _prepared(records: Sequence[Record]) -> tuple[Record, ...]:
    return tuple(part.detrended() for record in records for part in split_at_input_gaps(record))


def _paired(best: int, fits: Sequence[LevelFit | None], reference: LevelFit, *, dt: float) -> tuple[LevelMode, ...]:
    """The modes of the reference level, each with its continuation at the others."""
    index = _continuations(best, fits, reference)
    table = np.full((5, len(fits), len(reference.modes)), np.nan)
    for i, fit in enumerate(fits):
        for k, own in enumerate(index[i].tolist()):
            if fit is None or own < 0 or not fit.frequency_stds[own] < KNOWN_TO * fit.modes[own].frequency:
                continue
            mode, first = fit.modes[own], reference.modes[k]
            alike = assurance(first.shape[:, np.newaxis], mode.shape[:, np.newaxis])[0, 0]
            table[:, i, k] = (
                mode.frequency,
                fit.frequency_stds[own],
                mode.damping_ratio,
                fit.damping_ratio_stds[own],
                alike,
            )
    kept = [k for k in measured_modes(reference.modes, dt) if np.isfinite(table[0, :, k]).sum() > 1]
    kinds = [reference.modes[k].kind for k in kept]
    numbers = [kinds[: i + 1].count(kind) for i, kind in enumerate(kinds)]
    return tuple(
        _level_mode(number, reference.modes[k], table[:, :, k]) for number, k in zip(numbers, kept, strict=True)
    )


def measured_modes(modes: Sequence[Mode], dt: float) -> list[int]:
    """Which modes may be the structure's: no faster than the sampling, not heavily damped beside lighter ones."""
    light = any(mode.kind == "oscillatory" and mode.damping_ratio <= HEAVY for mode in modes)
    return [
        k
        for k, mode in enumerate(modes)
        if mode.frequency <= FASTEST_SEEN * 0.5 / dt
        and not (light and mode.kind == "oscillatory" and mode.damping_ratio > HEAVY)
    ]


def _continuations(best: int, fits: Sequence[LevelFit | None], reference: LevelFit) -> IndexArray:
    """(n_levels, n_modes) index of each mode of the reference at every level, -1 where it has none."""
    n_modes = len(reference.modes)
    found = np.full((len(fits), n_modes), -1, dtype=np.intp)
    found[best] = np.arange(n_modes)
    for walk in (range(best + 1, len(fits)), range(best - 1, -1, -1)):
        last, index = reference, found[best]
        for i in walk:
            fit = fits[i]
            if fit is None:
                continue
            partner = np.append(partners(last.modes, fit.modes), -1)
            last, index = fit, partner[index]  # the appended -1 is what index -1 points at
            found[i] = index
    return found


def _level_mode(number: int, mode: Mode, table: FloatArray) -> LevelMode:
    frequencies, frequency_stds, damping_ratios, damping_ratio_stds, assurances = table
    real = mode.kind == "real"
    return LevelMode(
        number=number,
        kind=mode.kind,
        frequencies=frequencies,
        frequency_stds=frequency_stds,
        damping_ratios=damping_ratios,
        damping_ratio_stds=damping_ratio_stds,
        assurances=assurances,
        frequency_tendency=tendency(frequencies, frequency_stds, counts=FREQUENCY_THAT_COUNTS),
        damping_tendency="unknown"
        if real
        else tendency(damping_ratios, damping_ratio_stds, counts=DAMPING_THAT_COUNTS),
    )
