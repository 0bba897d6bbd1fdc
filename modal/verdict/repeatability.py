"""The same identification made again with a small change each time, for the verdict: which modes are found again?

Two halves of the rows, one other observer order and ridge, and model orders around the chosen one from the same
decomposition. The Gram matrices of the two halves add up to the whole, so a half costs one factorisation and one SVD.
Halves are interleaved blocks, or pairs of rows that take turns: every second row alone is explained by the negative of
a pole as well, and a mode would be lost to its alias.
"""

import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import Literal, NamedTuple

import numpy as np

from era.balanced import HankelDecomposition, decompose, realise_from
from era.realisation import Realisation
from modal.estimation.cross_validation import (
    Folds,
    Masks,
    hankel_limits,
    markov_lags,
    scaled_model,
    scaled_record,
    shared_blocks,
    turns_of,
)
from modal.estimation.fits import model_runs
from modal.estimation.free_run import filled
from modal.estimation.modal_parameters import in_units, starting_parameters, with_weak_mode
from modal.estimation.modal_states import NONE, Block, blocks_by_turns, blocks_of
from modal.estimation.output_error import GROWS_AFTER, GROWS_ON, OutputError, RefinementStep, refine
from modal.estimation.prediction_error import STILL, CanonicalVariates, n_rows_of
from modal.modes.extraction import extract_modes
from modal.modes.mode import ModalModel
from modal.verdict.excitation import driven_gain
from modal.verdict.judgement import Change, Rerun, Reruns
from modal.verdict.probability import HARDLY_DRIVEN, f_ratio
from okid.arrays import BoolArray, FloatArray
from okid.errors import NumericalError
from okid.gram import LagGram, lag_gram, turn_gram
from okid.least_squares import solve
from okid.markov import recover_markov
from okid.observer import observer_fit
from okid.record import Record
from okid.rows import runs_of
from okid.scaling import ChannelScaling, channel_scaling

ROWS_AN_UNKNOWN = 3
"""Rows of a half for each unknown of its observer, as in the search."""
ORDER_SHARES = (0.85, 1.2, 1.4)
"""More above than below: the chosen order is the smallest that explains the data, so a lower one must lose a mode."""
OBSERVER_SHARE = 0.7
SMALLEST_RIDGE = 1e-6
GROWN = 4
"""Find so many modes of a model that grew again in what the others leave."""
Grown = Literal["", "half", "all"]
"""How many modes a rerun may find so, at most: where noise is loud a cut holds it in the place of weak modes."""


def repeat(
    records: Sequence[Record],
    *,
    observer_order: int,
    ridge: float,
    model_order: int,
    decomposition: HankelDecomposition,
    refinement_steps: int = 0,
    folds: Folds = "blocks",
    refined: Realisation | None = None,
    past: int = 0,
    grown: Grown = "",
    measured: Sequence[BoolArray] = (),
) -> Reruns:
    """Identify again from halves of the data, with another observer and with other model orders.

    Where the model was refined its reruns are refined too, on their own rows, with as many steps: what they have in
    common is then the system, not the bias of an observer.

    Args:
        records: as the model was identified from.
        observer_order: of the model's observer.
        ridge: of the model's observer.
        model_order: of the model.
        decomposition: that the model was cut from; gives the other model orders.
        refinement_steps: of the model.
        folds: halves of interleaved "blocks", or every second pair of the "rows".
        refined: the model; rows that take turns hold too little of a short answer for an observer, so each half starts
            from the model as well and keeps what suits its own rows better. A half of blocks does so where its own cut
            explains its rows worse than the model, beyond chance: not driven evenly, it lost what its rows tell.
        past: samples whose canonical variates the model started from, where it did; its reruns do, too.
        grown: how many modes may be found in what others leave, as some of the model were: reruns start with so many
            less, and find them so again, or from a cut of all: the one that a refinement takes further counts.
        measured: (n_samples, n_outputs) a record, False where a sample was filled: refinements leave it out.
    """
    scaling = channel_scaling(records)
    if past:
        return _canonical_reruns(records, scaling, past, model_order)
    whole = lag_gram(records, observer_order, scaling=scaling)
    if folds == "rows":
        n_turns = turns_of(measured, 4, 2)
        first_half = tuple(2 * (np.arange(record.n_samples) % n_turns) < n_turns for record in records)
        turns = (
            turn_gram(records, observer_order, scaling=scaling, n_turns=n_turns, turn=turn)
            for turn in range(n_turns // 2)
        )
        one = reduce(operator.add, turns)
    else:
        first_half = _first_half(records)
        one = lag_gram(records, observer_order, scaling=scaling, rows=first_half)
    other_order = _other_observer(observer_order, model_order, records[0].n_outputs)
    other_ridge = max(SMALLEST_RIDGE, 3.0 * ridge)
    dt = records[0].dt
    sizes = _starts(model_order, grown)
    runs = []
    second_half = tuple(~rows for rows in first_half)
    if folds == "rows":
        halves = blocks_by_turns(records, n_turns)
        blocks = tuple(replace(block, label=2 * block.label // n_turns) for block in halves)
    else:
        blocks = blocks_of(records, [[runs_of(rows) for rows in half] for half in (first_half, second_half)])
    again = _refinement(records, scaling, blocks, refinement_steps, measured)
    for half, (label, gram, unseen) in enumerate(
        (("first half", one, second_half), ("second half", whole - one, first_half))
    ):
        cuts = [_model(_carried(gram, model_order), ridge, scaling, dt, n) for n in sizes]
        models = [model for model in cuts if model is not None]
        if models:
            starts = models if folds == "blocks" or refined is None else [refined, *models]
            found = _refined(starts, again, held_out=1 - half, grown_to=model_order if grown else 0)
            whole_model = None if folds == "rows" else refined
            better = None if whole_model is None else _from_whole(whole_model, found, again, 1 - half)
            run = _judged_elsewhere(label, found.model, better, records, unseen)
            runs.append(replace(run, evidence=_evidence(whole_model, records, [~rows for rows in unseen])))
    largest = min(decomposition.rank, decomposition.max_order)
    is_longer = other_order > observer_order
    other = lag_gram(records, other_order, scaling=scaling) if is_longer else whole.truncated(other_order)
    cuts = [_model(other, other_ridge, scaling, dt, n) for n in sizes]
    models = [model for model in cuts if model is not None]
    if models:
        label = f"observer order {other_order}, ridge {other_ridge:.2g}"
        modes = extract_modes(_refined(models, again, grown_to=model_order if grown else 0).model)
        runs.append(Rerun(label=label, change="observer", modes=modes))
    others = _other_orders(model_order, 2 * largest if grown else largest)
    asked = _nearest(model_order, others) if grown else [(n, 1) for n in others]
    tried = {
        n: _refined(
            [realise_from(decomposition, min(size, largest)) for size in _starts(n, grown)],
            again,
            grown_to=n if grown else 0,
        )
        for n, _ in asked
    }
    if refined is not None and _off(tried, refined, again):
        tried = _cut_otherwise(tried, again, grown, lambda n: _model(other, other_ridge, scaling, dt, n))
    for n, count in asked:
        modes = extract_modes(tried[n].model)
        change: Change = "lower order" if n < model_order else "higher order"
        runs += count * [Rerun(label=f"order {n}", change=change, modes=modes)]
    return Reruns(
        runs=tuple(runs),
        n_steps=decomposition.n_block_rows + decomposition.n_block_columns,
        output_scale=scaling.output_scale,
        input_scale=scaling.input_scale,
    )


def _canonical_reruns(records: Sequence[Record], scaling: ChannelScaling, past: int, model_order: int) -> Reruns:
    """The same from canonical variates of the outputs' past: halves, a longer past, other orders."""
    longer = round(past / OBSERVER_SHARE)
    whole = lag_gram(records, past, scaling=scaling)
    first_half = _first_half(records)
    one = lag_gram(records, past, scaling=scaling, rows=first_half)
    runs = []

    def add(gram: LagGram, order: int, label: str, change: Change) -> None:
        found = CanonicalVariates.of_gram(gram, scaling, records[0].dt)
        model = None if found is None else found.predictor(order)
        if model is not None:
            runs.append(Rerun(label=label, change=change, modes=extract_modes(model)))

    add(one, model_order, "first half", "data")
    add(whole - one, model_order, "second half", "data")
    add(lag_gram(records, longer, scaling=scaling), model_order, f"past of {longer} samples", "observer")
    for n in _other_orders(model_order, past * records[0].n_outputs):
        add(whole, n, f"order {n}", "lower order" if n < model_order else "higher order")
    return Reruns(
        runs=tuple(runs), n_steps=2 * past, output_scale=scaling.output_scale, input_scale=scaling.input_scale
    )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Refinement:
    """What reruns are refined on: the scaled rows of both halves; no steps where the model was not refined."""

    scaling: ChannelScaling
    data: OutputError
    n_steps: int


def _refinement(
    records: Sequence[Record],
    scaling: ChannelScaling,
    blocks: tuple[Block, ...],
    n_steps: int,
    measured: Sequence[BoolArray],
) -> _Refinement:
    scaled = tuple(scaled_record(record, scaling) for record in filled(records))
    rows = tuple(record.complete_rows() for record in records)
    data = OutputError(records=scaled, rows=rows, blocks=blocks, measured=tuple(measured))
    return _Refinement(scaling=scaling, data=data, n_steps=n_steps if records[0].n_inputs else 0)


def _starts(n_states: int, grown: Grown) -> list[int]:
    """Sizes of the cuts that a rerun of so many states starts from: all, and but for at most `GROWN` modes, in pairs.

    Example:
        >>> _starts(10, ""), _starts(10, "half"), _starts(10, "all")
        ([10], [6, 10], [2, 10])
    """
    least = {"": n_states, "half": 2 * -(-n_states // 4), "all": 2}[grown]
    return sorted({min(n_states, max(least, n_states - 2 * GROWN)), n_states})


class _Found(NamedTuple):
    """A model, and its squared error on the rows that it was refined on; infinite where it was not."""

    model: Realisation
    error: float


def _refined(models: Sequence[Realisation], again: _Refinement, *, held_out: int = NONE, grown_to: int = 0) -> _Found:
    """The best of the models after a few steps on the rows that are not held out, and grown to so many states.

    The last as it is without steps, or where none is stable and grows so far; after a blow what is over needs no more.
    """
    best: tuple[RefinementStep, Realisation] | None = None
    struck = any(block.step > 1 for block in again.data.blocks)
    least = STILL / (n_rows_of(again.data) * again.data.records[0].n_outputs)
    for model in models if again.n_steps else ():
        start = starting_parameters(scaled_model(model, again.scaling), again.data, held_out=held_out)
        if start is not None:
            last = refine(start, again.data, held_out=held_out, n_steps=again.n_steps, least_gain=least)[-1]
            while last.order < grown_to:
                larger = with_weak_mode(last, again.data, held_out=held_out, by="blow" if struck else "answer")
                if larger is None:
                    break
                last = refine(larger, again.data, held_out=held_out, n_steps=GROWS_AFTER, least_gain=GROWS_ON)[-1]
            if last.order < grown_to and not struck:
                continue
            if grown_to:
                last = refine(last, again.data, held_out=held_out, n_steps=again.n_steps, least_gain=least)[-1]
            best = (last, model) if best is None or last.error < best[0].error else best
    return _Found(models[-1], np.inf) if best is None else _Found(in_units(*best, again.scaling), best[0].error)


def _error_of(whole: Realisation, again: _Refinement, *, held_out: int = NONE) -> float:
    """Squared error of the whole record's model on these rows, shapes fitted to them; infinite where it is none."""
    start = starting_parameters(scaled_model(whole, again.scaling), again.data, held_out=held_out)
    return np.inf if start is None else start.error


def _from_whole(whole: Realisation, found: _Found, again: _Refinement, held_out: int) -> Realisation | None:
    """The whole record's model refined on one half, where that explains the half's own rows better beyond chance.

    Where the inputs move in a part of the band only, or in one block here and the next one there, the observer of a
    half is hardly determined: its cut holds what no input drove, and the modes are lost though the half's rows tell
    them. What explains them worse than another model of the same order is not what they say.
    """
    if not again.n_steps or not _error_of(whole, again, held_out=held_out) < found.error:
        return None
    better = _refined([whole], again, held_out=held_out)
    return better.model if better.error * (1.0 + _by_chance(whole, 0.5 * n_rows_of(again.data))) < found.error else None


def _by_chance(whole: Realisation, n_rows: float) -> float:
    """Share of the squared error that the numbers of one mode explain of noise, F times as much as that."""
    return HARDLY_DRIVEN * 2 * (whole.n_outputs + whole.n_inputs) / (n_rows * whole.n_outputs)


def _judged_elsewhere(
    label: str,
    found: Realisation,
    better: Realisation | None,
    records: Sequence[Record],
    unseen: Sequence[BoolArray],
) -> Rerun:
    """The rerun of a half, its modes' gains taken on the rows of the other.

    A model that started from all rows says "found again" of those modes only whose answer to the inputs explains rows
    that they were not refined on: noise has no such answer.
    """
    model = found if better is None else better
    modes = extract_modes(model)
    gain = _gain(model, modes, records, unseen)
    if better is None or gain is None:
        return Rerun(label=label, change="data", modes=modes, gain=gain)
    kept = np.flatnonzero(_ratios(modes, gain, records, unseen) >= HARDLY_DRIVEN)
    answering = replace(modes, modes=tuple(modes.modes[i] for i in kept.tolist()))
    return Rerun(label=label, change="data", modes=answering, gain=gain[kept])


def _evidence(whole: Realisation | None, records: Sequence[Record], rows: Sequence[BoolArray]) -> FloatArray | None:
    """(n_modes,) F ratio of each mode of the whole record's model on these rows: did they drive it?"""
    if whole is None:
        return None
    modes = extract_modes(whole)
    gain = _gain(whole, modes, records, rows)
    return None if gain is None else _ratios(modes, gain, records, rows)


def _ratios(modes: ModalModel, gain: FloatArray, records: Sequence[Record], rows: Sequence[BoolArray]) -> FloatArray:
    n_values = sum(int(np.isfinite(record.outputs[own]).sum()) for record, own in zip(records, rows, strict=True))
    return np.array([f_ratio(mode, float(one), n_values) for mode, one in zip(modes.modes, gain, strict=True)])


def _off(tried: Mapping[int, _Found], whole: Realisation, again: _Refinement) -> bool:
    """Whether a larger model than the whole record's explains less, beyond chance: its cut held what no input drove."""
    larger = [one.error for n, one in tried.items() if n > whole.order and np.isfinite(one.error)]
    most = _error_of(whole, again) * (1.0 + _by_chance(whole, n_rows_of(again.data)))
    return bool(again.n_steps and larger) and max(larger) > most


def _gain(
    model: Realisation, modes: ModalModel, records: Sequence[Record], unseen: Sequence[BoolArray]
) -> FloatArray | None:
    """Gain of the modes on rows that the model has not seen; None where it cannot run freely."""
    if not model.n_inputs:
        return None
    try:
        runs = model_runs(replace(model, K=None), records)
    except NumericalError:
        return None
    return driven_gain(modes, records, runs.left, rows=unseen)


def _first_half(records: Sequence[Record]) -> tuple[BoolArray, ...]:
    """(n_samples,) a record, True in every second block; blocks in which both halves are driven at all frequencies."""

    def halves(n_blocks: int) -> Masks:
        edges = [np.linspace(0, record.n_samples, n_blocks + 1).round() for record in records]
        blocks = [np.searchsorted(own[1:], np.arange(own[-1]), side="right") for own in edges]
        return tuple(own % 2 == 0 for own in blocks), tuple(own % 2 == 1 for own in blocks)

    return halves(shared_blocks(records, halves))[0]


def _carried(gram: LagGram, model_order: int) -> LagGram:
    """The Gram of an observer with `ROWS_AN_UNKNOWN` for each unknown: a half holds half the rows.

    With the whole record's observer a half of a short record has little more rows than unknowns, and its noise hides
    weak modes: on 60 simulated records with long observers 180 of 190 true modes were called "system" without this
    rule and 185 with it, and the same number of noise poles (none).
    """
    n_channels = gram.n_inputs + gram.n_outputs
    order = max(_fewest(model_order, gram.n_outputs), gram.n_rows // (ROWS_AN_UNKNOWN * n_channels))
    return gram.truncated(min(gram.order, order))


def _fewest(model_order: int, n_outputs: int) -> int:
    """The order of an observer that holds modes which all outputs see at once, as they see most.

    One lag tells of as many modes as there are outputs where they are, and a second where they go.
    """
    return 2 * -(-model_order // (2 * n_outputs))


def _other_observer(order: int, model_order: int, n_outputs: int) -> int:
    """A shorter observer, or a longer one where a shorter holds no such model.

    Example:
        >>> _other_observer(20, 6, 3), _other_observer(2, 2, 2)
        (14, 3)
    """
    shorter = max(_fewest(model_order, n_outputs), round(OBSERVER_SHARE * order))
    return shorter if shorter < order else max(order + 1, round(order / OBSERVER_SHARE))


def _other_orders(model_order: int, largest: int) -> list[int]:
    """Orders around the chosen one, even where it is even, so that no conjugate pair is cut.

    None at all where the data have no higher order (noise-free data): a lower one alone would say nothing.
    """
    step = 2 if model_order % 2 == 0 else 1
    orders = {step * round(share * model_order / step) for share in ORDER_SHARES}
    orders |= {model_order + step}
    others = sorted(n for n in orders if 0 < n <= largest and n != model_order)
    return others if others and others[-1] > model_order else []


def _cut_otherwise(
    tried: Mapping[int, _Found], again: _Refinement, grown: Grown, cut: Callable[[int], Realisation | None]
) -> dict[int, _Found]:
    """Each of the models, or the one of the same order that starts from another cut, whichever explains more."""
    better = {}
    for n, found in tried.items():
        models = [model for model in map(cut, _starts(n, grown)) if model is not None]
        other = _refined(models, again, grown_to=n if grown else 0) if models else found
        better[n] = min(found, other, key=lambda one: one.error)
    return better


def _nearest(model_order: int, others: Sequence[int]) -> list[tuple[int, int]]:
    """The order below and the one above, and how many of the others each stands for.

    What grows finds the same modes on its way to any other, at their price. They count alike all the same: a lower
    order must lose a mode, and against one other run that would be half of what is asked of the weakest.

    Example:
        >>> _nearest(10, [8, 12, 14])
        [(8, 1), (12, 2)]
    """
    below, above = [n for n in others if n < model_order], [n for n in others if n > model_order]
    return [(side[near], len(side)) for side, near in ((below, -1), (above, 0)) if side]


def _model(gram: LagGram, ridge: float, scaling: ChannelScaling, dt: float, order: int) -> Realisation | None:
    """The model of this order from these rows; None where there are too few rows or the recovery diverges."""
    if gram.n_rows < 2:
        return None
    try:
        observer = observer_fit(solve(gram, ridge), scaling, dt)
        markov = recover_markov(observer, n_lags=markov_lags(observer.n_inputs, observer.n_outputs))
    except NumericalError:
        return None
    with np.errstate(over="ignore", invalid="ignore"):  # what grows without bound says nothing
        if not np.isfinite(np.square(markov.system).sum()):
            return None
    found = decompose(markov, max_order=min(order, *hankel_limits(markov)))
    return realise_from(found, min(order, found.rank, found.max_order))
