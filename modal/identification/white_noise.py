"""The model refined, and grown by its weak modes, in records that are filtered until their noise is white.

Where noise is loud at other frequencies than the modes', it drowns the weak ones in all that is judged by squares. A
short filter of all channels leaves poles and shapes as they are, and noise that is white.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from era.gain import estimate_gain
from era.realisation import Realisation
from modal.estimation.cross_validation import Ground, Trial, prepare_ground, scaled_model, trial_of
from modal.estimation.fits import fit_of, model_runs
from modal.estimation.modal_parameters import in_units, starting_parameters
from modal.estimation.output_error import OutputError, RefinementStep, refine
from modal.estimation.prediction_error import NOISE_FREE
from modal.estimation.weights import whiteness_ratio
from modal.estimation.whitening import all_filtered, common_filter, stretches
from modal.identification.final_model import FinalModel, keeps_promise, largest_model, with_noise, with_observer
from modal.identification.order_search import MOST_STEPS, Search
from modal.identification.refined_search import STANDS_STILL, growing, output_error_data, refined_model
from okid.arrays import BoolArray, FloatArray
from okid.errors import IdentificationError
from okid.record import Record

COLOURED = 0.5
"""Look behind the filter that makes the noise white where that leaves less than this share of its power."""
MOST_FILTERS = 2
"""Estimate the filter so often: again where modes were found in what it was estimated from."""
NEARLY_WHITE = 5.0
"""Take a filter that leaves a whiteness ratio of no more: in simulated red noise, with modes missing that spoil the
filter, it was at most 3.4; with hidden forces at least 10, with springs that are not linear at least 200."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class White:
    """Records filtered until their noise is white.

    Attributes:
        records: (n_samples - p, ...) filtered inputs and outputs; without those too short for the filter.
        filter: (p + 1,) a(q), monic.
        share: of the noise's power that is left behind it.
        measured: (n_samples - p, n_outputs) a record, False where a sample is made of one that was filled; none where
            all were measured.
        found: the search; chosen is the model that stands, scored on the held-out rows of the records as they came.
    """

    records: tuple[Record, ...]
    filter: FloatArray
    share: float
    measured: tuple[BoolArray, ...]
    found: Search


def in_white(
    records: Sequence[Record],
    found: Search,
    final: FinalModel,
    *,
    grows: bool,
    measured: Sequence[BoolArray] = (),
    progress: Callable[[float], None] = lambda _share: None,
) -> tuple[White, FinalModel] | None:
    """The records in which the noise of the model is white, and the model that is refined there, by its weak modes too.

    Where noise is loud at other frequencies, weak modes count for nothing in the records as they came; whoever asks for
    modes, asks the filtered ones. There the model is refined, and weak modes are added as long as held-out rows gain; a
    likeliest model of system and noise that misses none stays as it is.

    None where the noise is nearly white as it is, and where no short filter makes it so: what is left is no noise of
    sensors then, but the answers to hidden forces, or what is not linear.

    Args:
        records: as the search saw them.
        found: by the search, with the trial that was taken.
        final: its model of all rows.
        grows: whether modes may be added.
        measured: (n_samples, n_outputs) a record, False where a sample was filled; none where all were measured.
        progress: called with the share done.
    """
    start, grown = final.realisation, 0
    for turn in range(MOST_FILTERS):
        behind = _behind_filter(records, start, found, measured)
        best, larger = (None, None) if behind is None else _better_in_white(behind, start, grows=grows, grown=grown)
        if best is not None or behind is None or larger is None or turn + 1 == MOST_FILTERS:
            break
        spoilt = refined_model(
            behind.records,
            start,
            MOST_STEPS,
            weak_modes=larger.weak_modes,
            answers=larger.answers,
            measured=behind.measured,
        )
        if spoilt is None:
            break
        start, grown = spoilt.realisation, grown + larger.weak_modes
    if behind is None or best is None:
        return None
    progress(0.5)
    trial, as_it_came = best
    if final.noise is not None and not grown + trial.weak_modes:  # the likeliest estimate as it is
        return behind, final

    def own(done: float) -> None:
        progress(0.5 + 0.5 * done)

    model = _refined_in_white(behind, records, final, start, trial, progress=own)
    return None if model is None else (replace(behind, found=replace(found, chosen=as_it_came)), model)


def _behind_filter(
    records: Sequence[Record], model: Realisation, found: Search, measured: Sequence[BoolArray]
) -> White | None:
    """The records behind the filter of what a model leaves of them."""
    runs = model_runs(replace(model, K=None), records)
    a, share = common_filter(stretches(runs.left, [record.complete_rows() for record in records]))
    if share > COLOURED or not (fit_of(runs.records, runs.simulated) < 1.0 - NOISE_FREE).all():
        return None
    white = all_filtered(records, a)
    gaps = [
        replace(one, outputs=np.where(own, one.outputs, np.nan))
        for one, own in zip(records[: len(measured)], measured, strict=True)
    ]
    there = tuple(np.isfinite(one.outputs) for one in all_filtered(gaps, a))
    if not white or len(there) != (len(white) if measured else 0):
        return None
    return White(records=white, filter=a, share=share, measured=there, found=found)


def _better_in_white(
    behind: White, model: Realisation, *, grows: bool, grown: int
) -> tuple[tuple[Trial, Trial] | None, Trial | None]:
    """The model refined, and grown, behind the filter.

    Returns:
        The trial where the noise is nearly white, there and on the records as they came; and that of the largest model:
        the filter of what a model without its modes leaves is not that of the noise.
    """
    found = behind.found
    try:
        here = found.ground
        there = prepare_ground(behind.records, here.by, measured=behind.measured, n_blocks=here.n_blocks)
    except IdentificationError:
        return None, None
    data = output_error_data(here), output_error_data(there)
    chosen = replace(found.chosen, refinement_steps=MOST_STEPS, weak_modes=0, answers=0)
    own = _of_folds(model, there, data[1])
    start = _trial(chosen, own, there)
    if start is None:
        return None, None
    best, larger, ratio = None, None, np.inf
    for trial, steps in chain([(start, own)], growing(there, data[1], own, start) if grows else ()):
        before, ratio = ratio, whiteness_ratio(steps[0], data[1])
        larger = trial if trial.weak_modes else None
        if not ratio < max(before, NEARLY_WHITE):  # more modes make what is not linear no whiter
            break
        as_it_came = _trial(trial, _carried(steps, there, here, data[0]), here)
        if ratio <= NEARLY_WHITE and as_it_came is not None:
            best = trial, replace(as_it_came, weak_modes=found.chosen.weak_modes + grown + trial.weak_modes)
    return best, larger


def _refined_in_white(
    behind: White,
    records: Sequence[Record],
    final: FinalModel,
    start: Realisation,
    trial: Trial,
    *,
    progress: Callable[[float], None],
) -> FinalModel | None:
    """The model refined from its start, and grown, in all rows behind the filter; its gain is that of the records.

    None where that is worse than on its folds.
    """
    white, found = behind.records, behind.found
    _, fitted = with_observer(white, found.chosen, found.trials, {})
    if fitted is None:
        return None
    cut = largest_model(fitted, trial.model_order)
    refined = refined_model(
        white,
        start,
        trial.refinement_steps,
        weak_modes=trial.weak_modes,
        answers=trial.answers,
        evidence=cut,
        measured=behind.measured,
    )
    if refined is None or not keeps_promise(refined.realisation, white, trial):
        return None
    model = with_noise(white, fitted, cut, refined, measured=behind.measured, progress=progress)
    gain = estimate_gain(model.realisation, records)  # innovations are those of the filtered records, their gain is not
    return replace(
        model,
        observer=final.observer,
        markov=final.markov,
        gain=gain,
        realisation=replace(model.realisation, K=gain.gain),
    )


def _of_folds(model: Realisation, ground: Ground, data: OutputError) -> list[RefinementStep]:
    """The model of all rows refined in the training rows of each fold; none where it cannot run."""
    steps = []
    for fold in range(len(ground.folds)):
        start = starting_parameters(scaled_model(model, ground.scaling), data, held_out=fold)
        if start is None:
            return []
        steps.append(refine(start, data, held_out=fold, n_steps=MOST_STEPS, least_gain=STANDS_STILL)[-1])
    return steps


def _carried(steps: Sequence[RefinementStep], ground: Ground, other: Ground, data: OutputError) -> list[RefinementStep]:
    """The folds' models from one ground on the data of another; none where one cannot run."""
    nothing = Realisation(np.empty((0, 0)), np.empty((0, 0)), np.empty((0, 0)), np.empty((0, 0)), ground.records[0].dt)
    carried = []
    for fold, step in enumerate(steps):
        model = in_units(step, nothing, ground.scaling)
        start = starting_parameters(scaled_model(model, other.scaling), data, held_out=fold)
        if start is None:
            return []
        carried.append(start)
    return carried


def _trial(like: Trial, steps: Sequence[RefinementStep], ground: Ground) -> Trial | None:
    """The trial of a model of each fold; None without them."""
    if not steps:
        return None
    errors = [step.block_errors() for step in steps]
    return trial_of(
        like.observer_order,
        like.ridge,
        steps[0].order,
        errors,
        ground.power,
        refinement_steps=like.refinement_steps,
        weak_modes=like.weak_modes,
        answers=like.answers,
    )
