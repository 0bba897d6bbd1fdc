"""Model order and number of refinement steps, chosen together by the free run on held-out rows.

On each fold the model that its training rows gave is refined on these rows by output error, and scored on the rows held
out after every step. Run to convergence a refinement may follow what is not linear in the training rows and lose on the
others, so the number of steps is a choice like the order (early stopping), and both are made together: a refined model
needs fewer states than one that must make up for its observer's bias.

Two observers start it, the best and the best of another order or ridge: what Gauss-Newton steps reach depends on where
they start. The chosen model is refined on all rows, as a state-space model in the units of the records.

Where a refinement may run until it stands still and leaves white noise, its last steps weigh each output by the noise
that it has: then it is the maximum-likelihood estimate for noise on the outputs, and reaches the Cramer-Rao bound.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice

import numpy as np

from era.realisation import Realisation
from modal.estimation.cross_validation import (
    GAIN,
    WITHIN,
    Folds,
    Ground,
    GrownModel,
    Trial,
    corner,
    scaled_model,
    scaled_record,
    training_decomposition,
    trial_of,
)
from modal.estimation.force_noise import LikelyForces, by_turns, forces_told, likely_forces
from modal.estimation.free_run import begins_at_rest, filled
from modal.estimation.modal_parameters import (
    Proposal,
    in_units,
    nothing_yet,
    starting_parameters,
    with_weak_mode,
    with_weak_modes,
)
from modal.estimation.modal_states import blocks_by_turns, blocks_of, blocks_of_answers
from modal.estimation.output_error import (
    GROWS_AFTER,
    GROWS_ON,
    SMALLEST_GAIN,
    OutputError,
    RefinementStep,
    refine,
    step_at,
    without_what_moves_between_samples,
)
from modal.estimation.prediction_error import NOISE_FREE
from modal.estimation.weights import UNTIL_STILL, beside_blows, set_aside, weighted, whiteness_ratio
from modal.identification.order_search import (
    FURTHER_ORDERS,
    MODEL_ORDERS,
    MOST_STEPS,
    Search,
    chosen_refined,
    estimation_share,
    significantly_worse,
)
from okid.arrays import BoolArray, FloatArray
from okid.record import Record
from okid.scaling import ChannelScaling, channel_scaling

SCOUT_STEPS = 3
STANDS_STILL = 1e-5
"""Relative decrease of the squared error by a step below which a refinement of a fold ends."""
ORDER_SHARES = (0.2, 0.3, 0.45, 0.7, 1.0, 1.3)
"""Of the model order that was best without refinement, and of that in the grid: mostly smaller ones."""
HOPELESS = 1.5
"""Error after the first steps, relative to the best so far, from which on a candidate is given up."""
PATIENCE = 2
"""End after so many orders without gain, once refinement has paid or the order chosen without it is passed."""
MOST_WEAK_MODES = 4
"""Modes looked for in what the chosen model leaves; beyond the grid so many together must take more than `WITHIN`."""
ROUNDS_BETWEEN = 3
"""Looks around the best order, more than one only while it is the smallest tried."""
FEW = 8
"""Orders up to here are tried odd and even."""


@dataclass(slots=True, eq=False)
class _Workshop:
    """Refinements done so far."""

    ground: Ground
    data: OutputError
    largest_order: int
    steps: dict[tuple[int, float, int, int], list[RefinementStep]] = field(default_factory=dict)
    errors: dict[tuple[int, float, int, int], list[FloatArray]] = field(default_factory=dict)
    still: set[tuple[int, float, int, int]] = field(default_factory=set)
    refined: dict[tuple[int, float, int], list[Trial]] = field(default_factory=dict)
    grown: dict[tuple[int, float, int], list[Trial]] = field(default_factory=dict)


def output_error_data(ground: Ground) -> OutputError:
    """The scored stretches with their complete rows, cut into the blocks of the folds."""
    rows = tuple(held_out | trained for held_out, trained in zip(ground.held_out[0], ground.trained[0], strict=True))
    if ground.by == "rows":
        blocks = blocks_by_turns(ground.scaled, len(ground.folds), first_rows=ground.first_rows)
    else:
        blocks = blocks_of(ground.scaled, ground.blocks)
    return OutputError(records=ground.scaled, rows=rows, blocks=blocks, measured=ground.measured)


def refined_search(
    found: Search,
    *,
    acting: Sequence[BoolArray] = (),
    at_rest: FloatArray | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> Search:
    """The search with its best candidates refined; the refined trials stand beside those without refinement.

    Args:
        found: observers and model orders by their free runs without refinement.
        acting: (n_samples,) a record, True where one of a few blows acts.
        at_rest: (n_records, n_inputs) variances of the inputs' noise where a force window took it off.
        progress: called with the share done.
    """
    (first, *others), orders = _observers(found), _orders(found)
    shop = _Workshop(ground=found.ground, data=output_error_data(found.ground), largest_order=max(orders) + 2)
    refined = shop.refined
    resting = found.ground.by == "rows" and all(begins_at_rest(record, FEW) for record in found.ground.scaled)
    of_forces = _noise_of_forces(shop.data, found.ground.scaling, acting, at_rest)
    pairs = zip(acting, found.ground.first_rows, found.ground.scaled, strict=False)  # of a long one a stretch is scored
    seen = [rows[first : first + record.n_samples] for rows, first, record in pairs]
    beside = beside_blows(seen)
    following = shop.data if shop.data.measured or not seen else set_aside(shop.data, beside)
    turns = partial(by_turns, data=following, aside=beside, variances=of_forces, least_gain=GROWS_ON)
    pursued = _pursued(shop, first, found.limits.model_orders, following, turns) if resting else []
    best = min(found.trials[0].error, _least_error(pursued))
    grown = _rising(shop, found, orders, best, lambda share: progress(0.6 * share))
    best = min(best, _least_error(grown), *(_least_error(row) for row in refined.values()))
    for _ in range(ROUNDS_BETWEEN if len(orders) > 1 else 0):
        for n in _between(sorted(n for *_, n in refined), _best_order(refined)):
            refined[*first, n] = _trials(shop, (*first, n), hopeless=HOPELESS * best)
        if _best_order(refined) > min(n for *_, n in refined):
            break
    progress(0.8)
    for observer in others:
        n = _best_order(refined)
        refined[*observer, n] = _trials(shop, (*observer, n), hopeless=HOPELESS * best)
    trials = [*pursued, *grown, *(trial for row in refined.values() for trial in row)]
    everything = sorted((*trials, *found.trials), key=lambda t: (t.error, t.model_order))
    candidates = _comparable(everything, found.ground)
    if not trials or not candidates:
        return found
    chosen = chosen_refined(candidates, partial(estimation_share, found.ground))
    if found.ground.by == "rows":  # a fold that went astray late is no reason to leave all rows half-way
        chosen = replace(chosen, refinement_steps=MOST_STEPS)
    elif len(orders) > 1 and not chosen.weak_modes:
        grown = _grown(shop, chosen)
        everything = sorted((*everything, *grown), key=lambda t: (t.error, t.model_order))
        chosen = grown[-1] if grown else chosen
    progress(1.0)
    return replace(found, trials=tuple(everything), chosen=chosen)


def _pursued(
    shop: _Workshop,
    observer: tuple[int, float],
    model_orders: Sequence[int],
    data: OutputError,
    turns: Callable[[RefinementStep], tuple[RefinementStep, OutputError, tuple[FloatArray, ...]]],
) -> list[Trial]:
    """Trials of models that grow from nothing by the strongest mode of what is left, as long as held-out rows gain.

    An answer to a blow is over before an observer has seen enough of it, and its weak modes lie far below the others;
    but each takes its own part of the squared error. All rows find where each fold starts, which then fits its own.

    What the sensor of a force erred by makes an answer of its own of every blow, which no mode is to follow: as soon as
    what is left is no larger than that, the likeliest forces take its place.

    Args:
        shop: of the refinements.
        observer: (order, ridge) whose evidence the models keep.
        model_orders: of the grid, or the one that was given.
        data: of the workshop, less the rows in which a blow acts or a filter rings by it: no mode is of these.
        turns: the model and the likeliest forces by turns, and data with those.
    """
    trials: list[Trial] = []
    following, step = data, nothing_yet(data)
    best, without_gain = None, 0
    most = FURTHER_ORDERS[-1] if len(model_orders) > 1 else model_orders[0]
    while 2 * len(trials) + 2 <= most and without_gain < PATIENCE:
        larger = with_weak_mode(step, data, by="blow")
        if larger is None:
            break
        step = refine(larger, data, n_steps=GROWS_AFTER, least_gain=GROWS_ON)[-1]
        step, data, _ = turns(step)
        errors = []
        for fold in range(len(shop.ground.folds)):
            start = step_at(step.parameters, data, held_out=fold)
            last = refine(start, data, held_out=fold, n_steps=1, least_gain=GROWS_ON)[-1]
            errors.append(last.block_errors())
        n = len(trials) + 1
        made = trial_of(*observer, 2 * n, errors, shop.ground.power, refinement_steps=MOST_STEPS, weak_modes=n)
        trials.append(replace(made, grown=GrownModel(parameters=step.parameters, data=following, told=data)))
        gains = best is None or significantly_worse(best, made)
        if made.model_order > max(model_orders):  # the last few together take more than what counts as equal
            gains = gains and trials[-1 - MOST_WEAK_MODES :][0].error > WITHIN * made.error
        best, without_gain = (made, 0) if gains else (best, without_gain + 1)
    return trials if len(model_orders) > 1 else [trial for trial in trials if trial.model_order in model_orders]


def _rising(
    shop: _Workshop, found: Search, orders: Sequence[int], best: float, progress: Callable[[float], None]
) -> list[Trial]:
    """Refine cuts of the first observer by rising orders until that pays no more, and give what grew in place of one.

    A mode that the best cut lacks is found in what it leaves, by fewer and smaller models than those of larger cuts,
    which hold more of the noise besides. So beyond the grid, and the order that was best without refinement, a cut is
    tried only where nothing more is found in that way.
    """
    first, without_gain = _observers(found)[0], 0
    for i, n in enumerate(orders):
        so_far = sorted((trial for row in shop.refined.values() for trial in row), key=lambda trial: trial.error)
        if so_far and n > max(found.trials[0].model_order, MODEL_ORDERS[-1]) and found.ground.by == "blocks":
            grown = _grown(shop, chosen_refined(so_far, partial(estimation_share, shop.ground)))
            if grown:
                return grown
        own = shop.refined[*first, n] = _trials(shop, (*first, n), hopeless=HOPELESS * best)
        progress((i + 1) / len(orders))
        without_gain = 0 if _least_error(own) < GAIN * best else without_gain + 1
        best = min(best, _least_error(own))
        if without_gain >= PATIENCE and (best < GAIN * found.trials[0].error or n >= found.chosen.model_order):
            break
    return []


def _grown(shop: _Workshop, cut: Trial) -> list[Trial]:
    """Trials with up to `MOST_WEAK_MODES` more than one that was cut and refined until it stood still, else none."""
    if cut.refinement_steps < MOST_STEPS:
        return []
    key = (cut.observer_order, cut.ridge, cut.model_order)
    if key not in shop.grown:
        steps = [shop.steps[*key, fold][-1] for fold in range(len(shop.ground.folds))]
        shop.grown[key] = [trial for trial, _ in islice(growing(shop.ground, shop.data, steps, cut), MOST_WEAK_MODES)]
    return shop.grown[key]


def growing(
    ground: Ground, data: OutputError, steps: Sequence[RefinementStep], chosen: Trial
) -> Iterator[tuple[Trial, list[RefinementStep]]]:
    """Trials with one weak mode more each, and their models, as long as held-out rows gain.

    They are found by an observer, then by answers.

    Args:
        ground: of the trials.
        data: of the ground.
        steps: the model of each fold.
        chosen: their trial.
    """
    steps = list(steps)
    by: Proposal = "observer"
    while True:
        larger = [with_weak_mode(step, data, held_out=fold, by=by) for fold, step in enumerate(steps)]
        trial = None
        if any(larger):
            there = [  # a fold that has nothing to find keeps what it has found before the others
                refine(step, data, held_out=fold, n_steps=MOST_STEPS, least_gain=STANDS_STILL)[-1] if step else own
                for fold, (own, step) in enumerate(zip(steps, larger, strict=True))
            ]
            errors = [step.block_errors() for step in there]
            trial = trial_of(
                chosen.observer_order,
                chosen.ridge,
                chosen.model_order + 2,
                errors,
                ground.power,
                refinement_steps=MOST_STEPS,
                weak_modes=chosen.weak_modes + 1,
                answers=chosen.answers + (by == "answer"),
            )
        if trial is not None and significantly_worse(chosen, trial):
            chosen, steps = trial, there
            yield chosen, steps
        elif by == "observer":
            by = "answer"
        else:
            return


def _observers(found: Search) -> list[tuple[int, float]]:
    """The best observer and the best other one."""
    pairs = list(dict.fromkeys((trial.observer_order, trial.ridge) for trial in found.trials))
    return pairs[:2]


def _orders(found: Search) -> list[int]:
    if len(found.limits.model_orders) == 1:
        return list(found.limits.model_orders)
    grid = [trial.model_order for trial in found.trials if trial.model_order <= MODEL_ORDERS[-1]]
    best, within = found.trials[0].model_order, grid[0] if grid else found.trials[0].model_order
    shares = {max(1, round(share * within)) for share in ORDER_SHARES}
    shares |= {n for share in ORDER_SHARES if (n := round(share * best)) > max(shares)}
    return sorted({_even(n) for n in shares | {found.chosen.model_order}})


def _between(orders: Sequence[int], best: int) -> list[int]:
    """Orders next to the best and half-way to its neighbours, as far as they were not tried."""
    at = list(orders).index(best)
    lower = (best + orders[at - 1]) // 2 if at > 0 else best
    upper = (best + orders[at + 1]) // 2 if at + 1 < len(orders) else best
    near = {best - 2, best + 2, lower, upper} if best > FEW else {best - 1, best + 1, upper}
    return sorted({_even(n) for n in near if n > 0} - set(orders))


def _even(n: int) -> int:
    """Above a few states whole pairs only: an odd order cuts one."""
    return n if n <= FEW else n + n % 2


def _least_error(trials: Sequence[Trial]) -> float:
    return min((trial.error for trial in trials), default=np.inf)


def _best_order(refined: dict[tuple[int, float, int], list[Trial]]) -> int:
    return min(refined, key=lambda candidate: _least_error(refined[candidate]))[-1]


def _trials(shop: _Workshop, candidate: tuple[int, float, int], *, hopeless: float) -> list[Trial]:
    """The candidate refined on every fold, one trial after each number of steps; none where it cannot start.

    Where its error after a few steps is still above `hopeless` it gets no more.
    """
    trials: list[Trial] = []
    for n_steps in (SCOUT_STEPS, MOST_STEPS):
        errors = [_fold_errors(shop, candidate, fold, n_steps) for fold in range(len(shop.ground.folds))]
        if not all(errors):
            return []
        trials = []
        for k in range(n_steps + 1):
            blocks = [fold[min(k, len(fold) - 1)] for fold in errors]
            trials.append(trial_of(*candidate, blocks, shop.ground.power, refinement_steps=k))
        if _least_error(trials) > hopeless:
            break
    return trials


def _fold_errors(shop: _Workshop, candidate: tuple[int, float, int], fold: int, n_steps: int) -> list[FloatArray]:
    """(n_blocks, n_outputs) squared errors after each step; empty where the candidate has no stable start."""
    key = (*candidate, fold)
    if key not in shop.errors:
        start = _start(shop, candidate, fold)
        shop.steps[key] = [] if start is None else [start]
        shop.errors[key] = [] if start is None else [start.block_errors()]
    done = len(shop.errors[key]) - 1
    if shop.steps[key] and done < n_steps and key not in shop.still:
        last = shop.steps[key][-1]
        steps = refine(last, shop.data, held_out=fold, n_steps=n_steps - done, least_gain=STANDS_STILL)
        shop.errors[key] += [step.block_errors() for step in steps[1:]]
        shop.steps[key] = [steps[-1]]
        if len(steps) <= n_steps - done:
            shop.still.add(key)
    return shop.errors[key]


def _start(shop: _Workshop, candidate: tuple[int, float, int], fold: int) -> RefinementStep | None:
    p, ridge, n = candidate
    found = training_decomposition(shop.ground, p, ridge, fold, shop.largest_order)
    realisation = None if found is None else corner(found, n)
    return None if realisation is None else starting_parameters(realisation, shop.data, held_out=fold)


def _comparable(trials: Sequence[Trial], ground: Ground) -> list[Trial]:
    """All; where samples were filled, by a model of all rows, those that do not know by them what was held out."""
    return [trial for trial in trials if trial.refinement_steps == MOST_STEPS or not ground.measured]


N_BLOCKS = 40
"""Blocks of rows whose sums are kept apart, for a covariance that holds for noise of any colour."""
PARTS_A_POLE = 4
"""Cut each record of what is struck so that what it tells of a pole lies in about so many blocks: longer ones see noise
that remembers as long as the mode does, more of them say better how large it is."""
WHITE = 1.3
"""Whiteness statistic over its degrees of freedom up to which what is left counts as white noise."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RefinedModel:
    """A refined model and what its covariance needs.

    Attributes:
        realisation: in the units of the records; its Hankel factors are those of the data before refinement.
        step: the last one, scaled channels.
        data: what it was fitted to.
        scaling: of the channels.
        weights: (n_outputs, n_outputs) of the squared errors.
        whiteness_ratio: of what the free run leaves; nan where it leaves nothing.
        n_rest: rows that hold no noise.
        n_parts: blocks of the data among which lies what they tell of a pole.
        record_scale: (n_records,) that all channels of a record were divided by, beside their scaling.
        at_rest: (n_records, n_inputs) variances of what inputs showed where a force window made them zero, of the data.
        forces_erred: (n_samples, n_inputs) a record, by as much as far as what follows tells, in the units of the
            records; none where that tells nothing.
        acting: (n_samples,) a record, True where a blow acts.
    """

    realisation: Realisation
    step: RefinementStep
    data: OutputError
    scaling: ChannelScaling
    weights: FloatArray
    whiteness_ratio: float
    n_rest: int
    n_parts: int
    record_scale: FloatArray
    at_rest: FloatArray
    forces_erred: tuple[FloatArray, ...] = ()
    acting: tuple[BoolArray, ...] = ()

    @property
    def leaves_white_noise(self) -> bool:
        """Whether what the free run leaves is white."""
        return self.whiteness_ratio <= WHITE

    def with_forces(self, records: Sequence[Record]) -> tuple[Record, ...]:
        """The records with the likeliest forces."""
        pairs = zip(records, self.forces_erred, strict=True) if self.forces_erred else ()
        return tuple(replace(one, inputs=one.inputs - own) for one, own in pairs) or tuple(records)

    def likely_forces(self, variances: FloatArray, *, late: float = 0.0) -> LikelyForces | None:
        """What the forces erred by, with (n_records, n_inputs) variances of the data where their sensors rest.

        Args:
            variances: as large as they err.
            late: share of what follows a blow that has passed before it is asked as if the blow had just ended.
        """
        sizes = self.scaling.input_scale * self.record_scale[:, np.newaxis]
        known = self.forces_erred or tuple(np.zeros_like(record.inputs) for record in self.data.records)
        erred = [own / size for own, size in zip(known, sizes, strict=True)]
        apart = [~rows[:, 0] for rows in self.data.measured]
        own = np.where(self.at_rest > 0.0, variances, 0.0)
        return likely_forces(self.step, self.data, erred, apart or beside_blows(self.acting), own, late=late)

    def told_at_rest(self, variances: FloatArray) -> "RefinedModel":
        """The model that knows (n_records, n_inputs) variances of its inputs' noise, in the units of the records."""
        return replace(self, at_rest=variances / np.square(self.scaling.input_scale * self.record_scale[:, np.newaxis]))

    def as_fitted(self, records: Sequence[Record]) -> tuple[Record, ...]:
        """The records of the model without what their inputs, moving between samples, do beside it."""
        return tuple(
            replace(
                record,
                outputs=own.outputs * size * self.scaling.output_scale
                + self.scaling.output_mean
                + np.where(np.isnan(record.outputs), np.nan, 0.0),
            )
            for record, own, size in zip(records, self.data.records, self.record_scale, strict=True)
        )


def refined_model(
    records: Sequence[Record],
    start: Realisation,
    n_steps: int,
    *,
    weak_modes: int = 0,
    answers: int = 0,
    grown: GrownModel | None = None,
    evidence: Realisation | None = None,
    least_gain: float = SMALLEST_GAIN,
    n_rest: int = 0,
    by: Folds = "blocks",
    measured: Sequence[BoolArray] = (),
    acting: Sequence[BoolArray] = (),
    at_rest: FloatArray | None = None,
) -> RefinedModel | None:
    """Refine a model on all rows of the records; None where it is noise-free, unstable or without a state.

    Args:
        records: as identified from.
        start: from OKID and ERA, with Hankel factors.
        n_steps: as chosen on held-out rows; `MOST_STEPS` means until it stands still.
        weak_modes: modes to add from what the refined model leaves over.
        answers: find the last so many of them by their answers.
        grown: the model that has grown so far from nothing; it does not grow again on the same rows.
        evidence: realisation of the order that includes them, whose Hankel factors the result keeps; `start` unless
            given.
        least_gain: relative decrease of the error by a step below which it is the last.
        n_rest: rows of rest among those of the records, which hold no noise.
        by: "rows" where a few blows drive the records: even blocks hold all of an answer or nothing.
        measured: (n_samples, n_outputs) a record, False where a sample was filled; none where all were measured.
        acting: (n_samples,) a record, True where one of a few blows acts.
        at_rest: (n_records, n_inputs) variances of the inputs' noise where a force window took it off, if it is white.
    """
    scaling = channel_scaling(records)
    scaled = tuple(scaled_record(record, scaling) for record in filled(records))
    rows = tuple(record.complete_rows() for record in records)
    blocks = blocks_of(scaled, _even_blocks(scaled))
    data = OutputError(records=scaled, rows=rows, blocks=blocks, measured=tuple(measured))
    first = starting_parameters(scaled_model(start, scaling), data) if start.order else nothing_yet(data)
    if first is None or n_steps == 0:
        return None
    power = sum(
        float(np.square(record.outputs[there]).sum()) for record, there in zip(scaled, data.counted, strict=True)
    )
    if first.error <= NOISE_FREE**2 * power:
        return None
    weights = np.eye(start.n_outputs)
    most = UNTIL_STILL if n_steps == MOST_STEPS else n_steps
    struck = bool(acting) and not measured and n_steps == MOST_STEPS
    of_forces = _noise_of_forces(data, scaling, acting if struck else (), at_rest)
    beside = beside_blows(acting) if struck else []
    following = set_aside(data, beside) if struck and by == "rows" else data  # no mode is of what a filter rings on
    turns = partial(by_turns, data=following, aside=beside, variances=of_forces, least_gain=GROWS_ON)
    last = refine(first, following, n_steps=most, least_gain=least_gain)[-1] if start.order else first
    driven: list[Proposal] = ["observer" if i < weak_modes - answers else "answer" for i in range(weak_modes)]
    ways: list[Proposal] = ["blow" for _ in driven] if by == "rows" else driven
    last, told = with_weak_modes(last, following, ways, turns, grown)
    told = replace(told, measured=data.measured, elsewhere=data.elsewhere)
    if weak_modes or following is not data:
        last = refine(step_at(last.parameters, told), told, n_steps=most, least_gain=least_gain)[-1]
    if n_steps == MOST_STEPS and records[0].input_hold == "band_limited":
        last, data, told = _held_or_not(last, data, told, least_gain)
    ratio, record_scale = whiteness_ratio(last, data), np.ones(len(records))
    forces_erred: tuple[FloatArray, ...] = ()
    if n_steps == MOST_STEPS and (start.n_outputs > 1 or len(records) > 1 or struck):
        likeliest = weighted(last, told, least_gain)
        if struck:
            likeliest, forces_erred = forces_told(
                likeliest, data, acting=acting, variances=of_forces, least_gain=least_gain
            )
        own_ratio = whiteness_ratio(likeliest.step, likeliest.data)
        if own_ratio <= WHITE or by == "rows":
            last, data, ratio = likeliest.step, likeliest.data, own_ratio
            weights, record_scale = likeliest.weights, likeliest.record_scale
    realisation = in_units(last, start if evidence is None else evidence, scaling)
    n_parts = len(data.blocks)
    if by == "rows" and not ratio <= WHITE:
        n_parts = PARTS_A_POLE * len(records)
        data = replace(data, blocks=blocks_of_answers(last.layout, last.parameters, data.records, PARTS_A_POLE))
        last = step_at(last.parameters, data, weights=weights)
    return RefinedModel(
        realisation=realisation,
        step=last,
        data=data,
        scaling=scaling,
        weights=weights,
        whiteness_ratio=ratio,
        n_rest=n_rest,
        n_parts=n_parts,
        record_scale=record_scale,
        at_rest=np.zeros((len(records), start.n_inputs)),
        forces_erred=tuple(own * scaling.input_scale for own in forces_erred),
        acting=tuple(acting),
    )


def _noise_of_forces(
    data: OutputError, scaling: ChannelScaling, acting: Sequence[BoolArray], at_rest: FloatArray | None
) -> FloatArray:
    """(n_records, n_inputs) variances, of scaled records; zero where no blow acts or a sample was filled."""
    if at_rest is None or not acting or data.measured:
        return np.zeros((len(data.records), data.records[0].n_inputs))
    return np.asarray(at_rest / np.square(scaling.input_scale))


def _held_or_not(
    step: RefinementStep, data: OutputError, told: OutputError, least_gain: float
) -> tuple[RefinementStep, OutputError, OutputError]:
    """The model and both data less what inputs do between samples; as they were where inputs were held after all."""
    between = without_what_moves_between_samples(step, told)
    other = refine(step_at(step.parameters, between), between, n_steps=UNTIL_STILL, least_gain=least_gain)[-1]
    if other.error >= step.error:
        return step, data, told
    pairs = zip(data.records, between.records, strict=True)
    records = tuple(replace(own, outputs=one.outputs) for own, one in pairs)
    return other, replace(data, records=records), between


def _even_blocks(records: Sequence[Record]) -> list[list[list[tuple[int, int]]]]:
    """Every second of the even blocks as runs of a fold of its own: what lies between is cut off as well."""
    total = sum(record.n_samples for record in records)
    fold = []
    for record in records:
        count = max(1, round(N_BLOCKS * record.n_samples / total))
        edges = np.linspace(0, record.n_samples, count + 1).round().astype(int).tolist()
        fold.append(list(zip(edges[1:-1:2], edges[2::2], strict=False)))
    return [fold]
