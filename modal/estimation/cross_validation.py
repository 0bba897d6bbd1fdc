"""What every candidate is fitted to and scored on, and what the fits made so far can give again.

A candidate is fitted on the rows outside a fold: the Gram matrix of these rows serves all ridges of an observer order,
the decomposition of its Hankel matrix all model orders. Its model runs freely, and the squared error counts on the
fold's rows only. Without inputs the one-step prediction of the reduced model takes the place of the free run.

Every row counts in the fit. A free run through a million samples for each of a thousand candidates would take hours and
say no more than one through thirty thousand, so long records are scored on stretches spread evenly over them. Each
stretch holds ten blocks; its first block never counts in the score, so that the initial state, which is fitted there
too, is known before the first row that does.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from era.balanced import HankelDecomposition, decompose
from era.hankel import block_sizes
from era.realisation import Realisation
from modal.estimation.free_run import (
    ModalForm,
    begins_at_rest,
    block_errors,
    driven_by_outputs,
    filled,
    modal_form,
    modal_form_of,
    moving_inputs,
    one_step_predictor,
)
from modal.estimation.modal_states import ModalParameters, parts_of
from modal.estimation.output_error import OutputError
from okid.arrays import BoolArray, FloatArray
from okid.display import Displayed
from okid.gram import LagGram, lag_gram, turn_gram
from okid.least_squares import ObserverCoefficients, solve
from okid.markov import MarkovParameters, recover_arrays, recover_system
from okid.record import Record
from okid.rows import interleaved_folds, runs_of, whole_record_folds
from okid.scaling import ChannelScaling, channel_scaling

LONGEST_SCORED = 30_000
"""Samples that are run freely for each candidate; shorter data are run whole."""
STRETCH = 10_000
"""Samples of one stretch."""
BLOCKS = 10
MANY_RECORDS = 4
"""Records from which on whole ones are held out,"""
ALIKE = 0.5
"""if the shortest is at least this share of the longest,"""
LEAST_TRAINED = 0.01
"""and if each input keeps this share of its size, at each frequency, when what a fold holds out is left out."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Stretch:
    """Some consecutive rows of one record.

    Attributes:
        record: index of the record.
        first: first row.
        last: one past the last row.
        n_lead: rows at the start that are never scored; 0 for a whole record, whose first block always trains.
    """

    record: int
    first: int
    last: int
    n_lead: int

    def held_out(self, fold: Sequence[BoolArray]) -> BoolArray:
        """(n_rows,) rows of the stretch that the fold scores."""
        rows = fold[self.record][self.first : self.last].copy()
        rows[: self.n_lead] = False
        return rows


def is_long(records: Sequence[Record]) -> bool:
    """Whether the records are scored on stretches."""
    return sum(record.n_samples for record in records) > LONGEST_SCORED


Masks = tuple[tuple[BoolArray, ...], ...]
"""[fold][record] (n_samples,) rows held out."""
Folds = Literal["blocks", "rows"]
"""Hold out blocks of rows, or rows by turns: what is struck once has one answer, of which each fold needs a part."""
N_TURNS = 3
WHOLE = -1
"""Stands for the fold that holds nothing out."""


def turns_of(measured: Sequence[BoolArray], wanted: int, n_parts: int | None = None) -> int:
    """The least number of turns, from the wanted one on, in which every output was measured in each of them.

    What a slow sensor measures at every third row has one turn of three: its modes would not be found in the others.

    Args:
        measured: (n_samples, n_outputs) a record; none where all were.
        wanted: number of turns.
        n_parts: of as many turns each, in which it was measured; each turn is one unless given.

    Example:
        >>> turns_of([np.arange(100)[:, np.newaxis] % 3 == 0], 3), turns_of([np.ones((100, 2), dtype=bool)], 4, 2)
        (4, 4)
    """
    for n in range(wanted, 4 * wanted) if measured else ():
        parts = n if n_parts is None else n_parts
        if n % parts:
            continue
        labels = [np.arange(len(own)) % n * parts // n for own in measured]
        counts = sum(
            np.array([np.bincount(label[there], minlength=parts) for there in own.T])
            for own, label in zip(measured, labels, strict=True)
        )
        if (2 * parts * np.min(counts, axis=1) >= np.sum(counts, axis=1)).all():  # half of an even share
            return n
    return wanted


def folds_of(records: Sequence[Record], folds: Folds = "blocks", n_turns: int = N_TURNS, *, n_blocks: int = 0) -> Masks:
    """[fold][record] held-out rows: by turns, or so many blocks of each record, those of `n_blocks_of` unless given."""
    if folds == "rows":
        return tuple(
            tuple(np.arange(record.n_samples) % n_turns == turn for record in records) for turn in range(n_turns)
        )
    n_blocks = n_blocks or n_blocks_of(records)
    return _blocks_held_out(records, n_blocks) if n_blocks else whole_record_folds(records)


def n_blocks_of(records: Sequence[Record]) -> int:
    """Blocks of each record that folds hold out; 0 where they hold out whole records.

    Whole records where there are enough that can stand for each other (a block of a sweep cannot stand for another
    one, but neither can a record stand for the only one in which an input moves); else ten blocks a record, ten
    blocks a stretch where the records are long, or as many more as `shared_blocks` asks for.
    """
    lengths = [record.n_samples for record in records]
    alike = len(records) >= MANY_RECORDS and min(lengths) >= ALIKE * max(lengths) and not is_long(records)
    if alike:  # the rows that a record keeps for its state are no other record's
        whole = [[np.full(rows.size, rows.any()) for rows in fold] for fold in whole_record_folds(records)]
        if _untrained(records, whole, BLOCKS) <= LEAST_TRAINED:
            return 0
    return shared_blocks(records, lambda n: _blocks_held_out(records, n), _fewest_blocks(records))


def _fewest_blocks(records: Sequence[Record]) -> int:
    return BLOCKS * -(-max(record.n_samples for record in records) // STRETCH) if is_long(records) else BLOCKS


def _blocks_held_out(records: Sequence[Record], n_blocks: int) -> Masks:
    fewest = _fewest_blocks(records)
    shortest = STRETCH // BLOCKS * fewest // n_blocks if fewest > BLOCKS else BLOCKS
    return interleaved_folds(records, n_blocks=n_blocks, min_block=shortest)


def shared_blocks(records: Sequence[Record], cut: Callable[[int], Masks], fewest: int = BLOCKS) -> int:
    """The least number of blocks a record, doubled as often as it takes, that leaves each fold all frequencies.

    A sweep passes each frequency once. Rows that are held out alone then answer at frequencies that no other row
    does: no model of the others foretells them, and a half of the rows cannot confirm a mode that the other half alone
    was driven at. Where the blocks are so short that the sweep passes less within one than it tells apart, what a
    frequency makes is shared: a sweep over F [Hz] in T [s] takes about sqrt(F T) of them, and has at least 2 F T
    samples, so there are never more blocks than samples in one. Where no number is enough, that which leaves most.

    Args:
        records: of one system.
        cut: the rows that each fold holds out, from a number of blocks a record.
        fewest: blocks a record, to begin with.
    """
    longest = max(record.n_samples for record in records)
    best, least, n = fewest, np.inf, fewest
    while least > LEAST_TRAINED and (n == fewest or n**2 <= longest):
        missed = _untrained(records, cut(n), n)
        if missed < least:
            best, least = n, missed
        n *= 2
    return best


def _untrained(records: Sequence[Record], folds: Sequence[Sequence[BoolArray]], n_blocks: int) -> float:
    """Largest share of an input's power at frequencies of whose size there a fold leaves less than `LEAST_TRAINED`."""
    edges = [np.linspace(0, record.n_samples, n_blocks + 1).round().astype(int) for record in records]
    n_window = 1 << int(max(np.diff(own).max() for own in edges)).bit_length()
    total = np.zeros((n_window // 2 + 1, records[0].n_inputs))
    trained = np.zeros((len(folds), *total.shape))
    for r, (record, own) in enumerate(zip(records, edges, strict=True)):
        inputs = np.nan_to_num(record.inputs - np.nanmean(record.inputs, axis=0))
        for first, last in itertools.pairwise(np.unique(own).tolist()):
            window = np.hanning(last - first)[:, np.newaxis]
            power = np.square(np.abs(np.fft.rfft(window * inputs[first:last], n_window, axis=0)))
            total += power
            kept = 1.0 - np.array([fold[r][first:last].mean() for fold in folds])
            trained += kept[:, np.newaxis, np.newaxis] * power
    missed = np.where(trained < LEAST_TRAINED**2 * total, total, 0.0).sum(axis=1)
    moves = total.sum(axis=0) > 0
    return float((missed[:, moves] / total.sum(axis=0)[moves]).max(initial=0.0))


def stretches_of(records: Sequence[Record], folds: Folds = "blocks") -> tuple[Stretch, ...]:
    """Whole records, or about `LONGEST_SCORED` samples of them: in stretches spread evenly, or from the first events.

    Example:
        >>> record = Record([], np.zeros(95_000) + np.arange(95_000.0), 0.01)
        >>> [(stretch.first, stretch.last) for stretch in stretches_of([record])]
        [(0, 9500), (38000, 47500), (85500, 95000)]
    """
    if not is_long(records):
        return tuple(Stretch(record=i, first=0, last=record.n_samples, n_lead=0) for i, record in enumerate(records))
    if folds == "rows":
        share = max(STRETCH // BLOCKS, LONGEST_SCORED // len(records))
        starts = [max(0, _first_event(record) - share // BLOCKS) for record in records]
        return tuple(
            Stretch(record=i, first=first, last=min(record.n_samples, first + share), n_lead=0)
            for i, (record, first) in enumerate(zip(records, starts, strict=True))
        )
    pieces = []
    for i, record in enumerate(records):
        n_pieces = max(1, -(-record.n_samples // STRETCH))
        edges = np.linspace(0, record.n_samples, n_pieces + 1).round().astype(int).tolist()
        pieces += [
            Stretch(record=i, first=first, last=last, n_lead=0 if first == 0 else (last - first) // BLOCKS)
            for first, last in itertools.pairwise(edges)
        ]
    n_kept = max(1, LONGEST_SCORED * len(pieces) // sum(record.n_samples for record in records))
    kept = np.unique(np.linspace(0, len(pieces) - 1, min(n_kept, len(pieces))).round().astype(int))
    return tuple(pieces[i] for i in kept)


def _first_event(record: Record) -> int:
    """Row at which an input first has half of its size."""
    size = np.abs(record.inputs)
    return int((size >= 0.5 * size.max(axis=0)).any(axis=1).argmax())


WITHIN = 1.02
"""Take the smaller of two models where its error is at most this many times that of the larger."""
GAIN = 0.99
"""Go on to larger models or another round only where the error falls below this share of the best so far."""
FIRST_RIDGE = 1e-4
"""Fit with this ridge where no search chooses one: a first model of the records, or of what a model leaves."""
LARGEST_PULSE = 1e4
"""A recovered pulse response (scaled channels) that grows beyond this has diverged and is not realised."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Ground(Displayed):
    """What every candidate is fitted to and scored on."""

    scaled: tuple[Record, ...]  # the stretches that are run freely, gaps bridged
    held_out: tuple[tuple[BoolArray, ...], ...]  # [fold][stretch] complete rows that count
    trained: tuple[tuple[BoolArray, ...], ...]  # [fold][stretch] complete rows that the initial state may look at
    blocks: tuple[tuple[list[tuple[int, int]], ...], ...]  # [fold][stretch] (first, one past last) row
    first_rows: tuple[int, ...]  # of each stretch in its record
    records: tuple[Record, ...]
    scaling: ChannelScaling
    folds: Masks
    n_blocks: int  # of each record, 0 where other rows are held out
    power: FloatArray
    n_lags: int
    by: Folds
    measured: tuple[BoolArray, ...]  # [stretch] (n_rows, n_outputs) False where filled; none where nothing was
    # what was computed so far, so that a search may ask for the same again
    grams: dict[tuple[int, int], LagGram]  # [observer order, fold]
    decompositions: dict[tuple[int, float, int], tuple[int, HankelDecomposition] | None]  # [observer, ridge, fold]
    scores: dict[tuple[int, float, int, int], FloatArray | None]  # [observer, ridge, model order, fold] block errors


def markov_lags(n_inputs: int, n_outputs: int) -> int:
    """Lags to recover: as many as keep the Hankel matrix of many channels at a size whose SVD takes milliseconds."""
    return int(np.clip(800 / np.sqrt(max(1, n_inputs) * n_outputs), 120, 400))


def prepare_ground(
    records: Sequence[Record],
    by: Folds = "blocks",
    *,
    measured: Sequence[BoolArray] = (),
    n_blocks: int = 0,
) -> Ground:
    """Folds, scaled channels and bridged gaps, once for all candidates; `records` are of one system, means removed.

    What was filled, (n_samples, n_outputs) of each record False in `measured`, trains observers and scores nothing.
    The number of blocks is that of another ground where the folds of both are compared.
    """
    scaling = channel_scaling(records)
    n_blocks = n_blocks or (n_blocks_of(records) if by == "blocks" else 0)
    folds = folds_of(records, by, turns_of(measured, N_TURNS), n_blocks=n_blocks)
    whole = tuple(scaled_record(record, scaling) for record in filled(records))
    if not records[0].n_inputs:
        whole = tuple(driven_by_outputs(record) for record in whole)
    stretches = stretches_of(records, by)
    scaled = moving_inputs([whole[one.record].samples(one.first, one.last) for one in stretches])
    complete = [records[one.record].complete_rows()[one.first : one.last] for one in stretches]
    if by == "rows":
        complete = [
            there & ~alone for there, alone in zip(complete, _alone(scaled, stretches, len(folds)), strict=True)
        ]
    counted = tuple(tuple(one.held_out(fold) for one in stretches) for fold in folds)
    held_out = tuple(tuple(rows & there for rows, there in zip(fold, complete, strict=True)) for fold in counted)
    own = tuple(measured[one.record][one.first : one.last] for one in stretches) if measured else ()
    return Ground(
        scaled=scaled,
        held_out=held_out,
        trained=tuple(tuple(~rows & there for rows, there in zip(fold, complete, strict=True)) for fold in counted),
        blocks=tuple(
            tuple(parts_of(rows.size, len(fold)) if by == "rows" else runs_of(rows) for rows in fold)
            for fold in counted
        ),
        first_rows=tuple(one.first for one in stretches),
        by=by,
        measured=own,
        records=tuple(records),
        scaling=scaling,
        folds=folds,
        n_blocks=n_blocks,
        power=np.array([_held_out_power(scaled, _samples(fold, own)) for fold in held_out]),
        n_lags=markov_lags(records[0].n_inputs, records[0].n_outputs),
        grams={},
        decompositions={},
        scores={},
    )


def _alone(scaled: Sequence[Record], stretches: Sequence[Stretch], n_turns: int) -> list[BoolArray]:
    """(n_rows,) a stretch, True where an input acts whose rows have one turn: held out, nothing tells what it does."""
    alone = [np.zeros(record.n_samples, dtype=np.bool_) for record in scaled]
    for j in range(scaled[0].n_inputs):
        acts = [np.flatnonzero(record.inputs[:, j]) for record in scaled]
        turns = np.concatenate([(own + one.first) % n_turns for own, one in zip(acts, stretches, strict=True)])
        if np.unique(turns).size == 1:
            for mask, own in zip(alone, acts, strict=True):
                mask[own] = True
    return alone


def scaled_record(record: Record, scaling: ChannelScaling) -> Record:
    """The record with every channel at zero mean and unit standard deviation.

    Where it begins at rest its inputs stay zero there, and so does the state of a model.
    """
    rest = 0.0 if begins_at_rest(record, 2) else scaling.input_mean
    return replace(
        record,
        inputs=(record.inputs - rest) / scaling.input_scale,
        outputs=(record.outputs - scaling.output_mean) / scaling.output_scale,
    )


def scaled_model(realisation: Realisation, scaling: ChannelScaling) -> Realisation:
    """The model of channels at unit standard deviation, without Hankel factors."""
    into, out = scaling.input_scale, scaling.output_scale[:, np.newaxis]
    K = realisation.K
    return Realisation(
        realisation.A,
        realisation.B * into,
        realisation.C / out,
        realisation.D * into / out,
        realisation.dt,
        K=None if K is None else K * scaling.output_scale,
    )


def _held_out_power(scaled: Sequence[Record], fold: Sequence[BoolArray]) -> FloatArray:
    power: FloatArray = np.sum(
        [
            np.square(record.outputs[rows] if rows.ndim == 1 else np.where(rows, record.outputs, 0.0)).sum(axis=0)
            for record, rows in zip(scaled, fold, strict=True)
        ],
        axis=0,
    )
    return np.maximum(power, np.finfo(np.float64).tiny)


def _samples(rows: Sequence[BoolArray], measured: Sequence[BoolArray]) -> Sequence[BoolArray]:
    """(n_rows,) a stretch that count; (n_rows, n_outputs) where samples were filled, which do not."""
    return [own[:, np.newaxis] & there for own, there in zip(rows, measured, strict=True)] if measured else rows


def training_gram(ground: Ground, observer_order: int, fold: int) -> LagGram:
    """Gram of the rows outside a fold, made once for each observer order.

    A Gram shared by all orders would drop the rows that only the largest cannot use, which a short record misses, and
    would save but a quarter of the work.
    """
    if (observer_order, fold) not in ground.grams:
        if ground.by == "rows":
            if (observer_order, WHOLE) not in ground.grams:
                ground.grams[observer_order, WHOLE] = lag_gram(ground.records, observer_order, scaling=ground.scaling)
            n_turns = len(ground.folds)
            held_out = turn_gram(ground.records, observer_order, scaling=ground.scaling, n_turns=n_turns, turn=fold)
            made = ground.grams[observer_order, WHOLE] - held_out
        else:
            rows = [~held_out for held_out in ground.folds[fold]]
            made = lag_gram(ground.records, observer_order, scaling=ground.scaling, rows=rows)
        ground.grams[observer_order, fold] = made
    return ground.grams[observer_order, fold]


def training_decomposition(
    ground: Ground, observer_order: int, ridge: float, fold: int, max_order: int
) -> HankelDecomposition | None:
    """Observer of the rows outside a fold, decomposed for models up to `max_order`, made once.

    None where its pulse response diverges.
    """
    observer = observer_order, ridge, fold
    found = ground.decompositions.get(observer)
    if observer not in ground.decompositions or (found is not None and found[0] < max_order):
        coefficients = solve(training_gram(ground, observer_order, fold), ridge)
        made = decompose_coefficients(coefficients, ground.n_lags, ground.scaled[0].dt, max_order)
        found = None if made is None else (max_order, made)
        ground.decompositions[observer] = found
    return None if found is None else found[1]


def decompose_coefficients(
    coefficients: ObserverCoefficients, n_lags: int, dt: float, max_order: int
) -> HankelDecomposition | None:
    """Markov parameters and SVD of an observer in scaled channels; None where the pulse response diverges."""
    arrays = (coefficients.feedthrough, coefficients.input_coefficients, coefficients.output_coefficients)
    gain: FloatArray | None = None
    with np.errstate(over="ignore", invalid="ignore"):
        if coefficients.feedthrough.shape[1]:
            system = recover_system(*arrays, n_lags)
        else:
            system, gain = recover_arrays(*arrays, n_lags)
    largest = np.abs(system if gain is None else gain).max()
    if not largest < LARGEST_PULSE:  # nan is not below either
        return None
    markov = MarkovParameters(system=system, gain=gain, dt=dt, observer_order=coefficients.order)
    return decompose(markov, max_order=min(max_order, *hankel_limits(markov)))


def corner(decomposition: HankelDecomposition, order: int) -> Realisation | None:
    """The model of one order without its Hankel factors, which a candidate does not need; None beyond the rank."""
    found = decomposition
    if order > min(found.rank, found.max_order):
        return None
    gain = None if found.K is None else found.K[:order]
    return Realisation(found.A[:order, :order], found.B[:order], found.C[:, :order], found.D, found.dt, K=gain)


def hankel_limits(markov: MarkovParameters) -> tuple[int, int]:
    """Rows and columns of the block Hankel matrix that `decompose` would make."""
    return hankel_shape(markov.n_lags, markov.n_inputs, markov.n_outputs)


def hankel_shape(n_lags: int, n_inputs: int, n_outputs: int) -> tuple[int, int]:
    """Rows and columns of the block Hankel matrix of so many lags; without inputs it is that of the gain.

    Example:
        >>> hankel_shape(9, 1, 2)
        (6, 6)
    """
    n_channels = n_inputs or n_outputs
    a, b = block_sizes(n_lags, n_outputs, n_channels, n_block_rows=None, n_block_columns=None)
    return a * n_outputs, b * n_channels


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class GrownModel:
    """A model that grew mode by mode from nothing.

    Attributes:
        parameters: of the model.
        data: that it grew on.
        told: the same with the likeliest forces.
    """

    parameters: ModalParameters
    data: OutputError
    told: OutputError


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Trial(Displayed):
    """One candidate that was fitted and scored.

    Attributes:
        observer_order: of the observer.
        ridge: of its fit.
        model_order: of the reduced model.
        squared_errors: (n_folds, n_outputs) on held-out rows, scaled channels; nan for folds not run.
        block_errors: (n_blocks,) squared error of each held-out block relative to the power of all of them, mean over
            outputs: what two trials are compared by.
        error: relative held-out error, mean over outputs: 1 - fit.
        refinement_steps: output-error steps made on each fold's training rows before scoring.
        weak_modes: modes of the model order that were added from what the refined model left over.
        answers: the last so many of these were found by their answers, the others by an observer.
        grown: the model of all scored rows, where it grew from nothing.
    """

    observer_order: int
    ridge: float
    model_order: int
    squared_errors: FloatArray
    block_errors: FloatArray
    error: float
    refinement_steps: int = 0
    weak_modes: int = 0
    answers: int = 0
    grown: GrownModel | None = field(default=None, repr=False)

    @property
    def grew(self) -> bool:
        """Whether the model grew mode by mode from nothing."""
        return 0 < self.model_order == 2 * self.weak_modes


def make_trials(
    ground: Ground,
    observer_orders: Sequence[int],
    ridge: float,
    model_orders: Sequence[int],
    fold_indices: Sequence[int],
) -> list[Trial]:
    """Fit every observer order with one ridge and score its models; what was done before is not done again.

    Args:
        ground: of all trials.
        observer_orders: to fit.
        ridge: of the fits.
        model_orders: rising.
        fold_indices: folds to score on.
    """
    trials = []
    power = ground.power[list(fold_indices)]
    for p in observer_orders:
        for n in model_orders:
            blocks = [_scored(ground, (p, ridge, n, i), max(model_orders)) for i in fold_indices]
            whole = [errors for errors in blocks if errors is not None]
            if len(whole) == len(blocks):
                trials.append(trial_of(p, ridge, n, whole, power))
    return trials


def _scored(ground: Ground, candidate: tuple[int, float, int, int], max_order: int) -> FloatArray | None:
    """Block errors of (observer order, ridge, model order, fold); None where the candidate cannot run."""
    if candidate not in ground.scores:
        observer_order, ridge, model_order, fold = candidate
        found = training_decomposition(ground, observer_order, ridge, fold, max_order)
        ground.scores[candidate] = None if found is None else _block_errors(ground, found, model_order, fold)
    return ground.scores[candidate]


def trial_of(
    observer_order: int,
    ridge: float,
    model_order: int,
    blocks: Sequence[FloatArray],
    power: FloatArray,
    *,
    refinement_steps: int = 0,
    weak_modes: int = 0,
    answers: int = 0,
) -> Trial:
    """A trial from the squared errors of each fold's blocks, (n_blocks, n_outputs) a fold."""
    squared = np.array([errors.sum(axis=0) for errors in blocks])
    whole = power.sum(axis=0)
    return Trial(
        observer_order=observer_order,
        ridge=ridge,
        model_order=model_order,
        squared_errors=squared,
        block_errors=(np.concatenate(blocks) / whole).mean(axis=1),
        error=float(np.sqrt(squared.sum(axis=0) / whole).mean()),
        refinement_steps=refinement_steps,
        weak_modes=weak_modes,
        answers=answers,
    )


def _block_errors(ground: Ground, decomposition: HankelDecomposition, model_order: int, fold: int) -> FloatArray | None:
    """(n_blocks, n_outputs) squared error of the free run on the fold's blocks; None when the model cannot run."""
    form = _form(decomposition, model_order)
    if form is None:
        return None
    held_out = _samples(ground.held_out[fold], ground.measured)
    each = zip(ground.scaled, ground.trained[fold], held_out, ground.blocks[fold], strict=True)
    return np.concatenate([block_errors(form, *one) for one in each if one[-1]])


def _form(decomposition: HankelDecomposition, order: int) -> ModalForm | None:
    """The model that runs: without inputs the one-step predictor; None beyond the rank or where it cannot run."""
    found = decomposition
    if found.D.shape[1] == 0:
        model = corner(found, order)
        return None if model is None else modal_form(one_step_predictor(model))
    if order > min(found.rank, found.max_order):
        return None
    return modal_form_of(found.A[:order, :order], found.B[:order], found.C[:, :order], found.D)
