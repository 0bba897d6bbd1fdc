"""The chosen candidate fitted to all rows and refined; where it becomes unstable, the next best that stays stable.

Every candidate was stable on each fold, but a pole at the edge (an integrator, an undamped line) may fall on either
side of the unit circle when all rows are used. An unstable model cannot run freely, so it is never the answer.

Standard deviations of its modes: of the model of its noise, else of its refinement, else propagated through OKID and
ERA.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Literal

import numpy as np

from era.balanced import HankelDecomposition, decompose, realise_from
from era.gain import GainEstimate, estimate_gain
from era.realisation import Realisation
from modal.estimation.cross_validation import (
    Folds,
    Ground,
    Trial,
    corner,
    hankel_limits,
    markov_lags,
    prepare_ground,
    scaled_model,
    training_decomposition,
    trial_of,
)
from modal.estimation.fits import fit_of, model_runs
from modal.estimation.free_run import modal_form, one_step_predictor
from modal.estimation.modal_parameters import in_data_states, in_units, starting_parameters
from modal.estimation.output_error import OutputError, RefinementStep, refine
from modal.estimation.prediction_error import NOISE_FREE
from modal.estimation.propagation import propagated
from modal.estimation.whitening import all_filtered, common_filter, stretches
from modal.identification.covariance import NOT_UNDERSTOOD, judged_deviations
from modal.identification.information import innovation_uncertainty
from modal.identification.noise_model import NoiseModel, noise_model
from modal.identification.order_search import Search
from modal.identification.refined_search import (
    MOST_STEPS,
    STANDS_STILL,
    RefinedModel,
    growing,
    output_error_data,
    refined_model,
    whiteness_ratio,
)
from modal.modes.extraction import extract_modes
from modal.modes.modal_form import discrete_poles
from modal.modes.mode import ModalModel, Uncertainty
from modal.verdict.repeatability import ORDER_SHARES
from okid.arrays import BoolArray, FloatArray
from okid.errors import IdentificationError, InsufficientDataError, NumericalError, quiet
from okid.markov import MarkovParameters, recover_markov
from okid.observer import ObserverFit, fit_observer
from okid.record import Record
from okid.residuals import NOT_WHITE

Feedback = Literal["none", "harmless", "biasing"]

BROKEN_PROMISE = 0.1
"""Fit to all rows below that to held-out rows from which on a model is not taken."""
COLOURED = 0.5
"""Look behind the filter that makes the noise white where that leaves less than this share of its power."""
NEARLY_WHITE = 5.0
"""Take a filter that leaves a whiteness ratio of no more: in simulated red noise, with modes missing that spoil the
filter, it was at most 3.4; with hidden forces at least 10, with springs that are not linear at least 200."""
MOST_MADE = 8
"""Models made of all rows before the first one is taken for want of a better."""
LARGEST_ORDER = 64
"""Model orders up to which the order evidence reaches."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FinalModel:
    """Observer, Markov parameters, decomposition and realisation of all rows.

    Attributes:
        observer: the observer fit.
        markov: recovered from it.
        decomposition: of their block Hankel matrix.
        cut: the realisation of the chosen order.
        refined: the same refined by output error, None where no refinement was chosen.
        noise: the same with a model of its noise; None where white noise on the outputs is as likely.
        why: in words, why there is a model of the noise or none.
        gain: of the model, from its innovations; None where the model has the gain that it was cut with.
        realisation: the likeliest, the refined one, its gain estimated from its innovations, or the one that was cut.
        feedback: of the outputs into the inputs; harmless where it moves no mode of the refined model noticeably.
    """

    observer: ObserverFit
    markov: MarkovParameters
    decomposition: HankelDecomposition
    cut: Realisation
    refined: RefinedModel | None
    noise: NoiseModel | None
    why: str
    gain: GainEstimate | None
    realisation: Realisation
    feedback: Feedback = "none"

    @property
    def leaves_white_noise(self) -> bool:
        """Whether white noise on the outputs is all there is."""
        return self.noise is None and self.refined is not None and self.refined.leaves_white_noise

    @property
    def leaves_nearly_white(self) -> bool:
        """Whether what the refined model leaves of the samples that were measured is not called coloured."""
        return self.refined is not None and not self.refined.whiteness_ratio > NOT_WHITE


def fit_all_rows(
    records: Sequence[Record],
    found: Search,
    *,
    n_rest: int = 0,
    noise_free: str = "",
    refinement: Literal["auto", "none"] = "auto",
    feedback: bool = False,
    measured: Sequence[BoolArray] = (),
    progress: Callable[[float], None] = lambda _share: None,
) -> tuple[Search, FinalModel]:
    """Fit the chosen trial, else the next best stable one, to all rows.

    A refinement of all rows that falls behind what its folds promised starts again from where the folds started.

    Args:
        records: that the search saw.
        found: by the search.
        n_rest: rows of rest among theirs, which hold no noise.
        noise_free: in words, which samples hold no noise; where some do, no model of the noise is asked for.
        refinement: "none" leaves the model as OKID and ERA give it.
        feedback: the outputs seem to be fed back into the inputs.
        measured: (n_samples, n_outputs) a record, False where a sample was filled; none where all were measured.
        progress: called with the share that is behind at most, before each step.

    Returns:
        The search with the trial that was taken as its chosen one, and the model.

    Raises:
        NumericalError: every trial is unstable on all rows.
    """
    done: dict[tuple[int, float], FinalModel | None] = {}
    fallback: tuple[Search, FinalModel] | None = None
    n_made = 0
    for trial in (found.chosen, *found.trials):
        trial, fitted = _with_observer(records, trial, found.trials, done)  # noqa: PLW2901
        model = None if fitted is None else _stable(fitted.decomposition, trial.model_order - 2 * trial.weak_modes)
        if fitted is None or model is None:
            continue
        for start in _starts(found, trial, model, of_folds=refinement == "auto" and not n_made):
            made = replace(found, chosen=trial), replace(fitted, cut=model, realisation=model)
            if refinement == "auto":
                refined = _refined(
                    records,
                    fitted,
                    model,
                    trial,
                    start=start,
                    n_rest=n_rest,
                    noise_free=noise_free,
                    by=found.ground.by,
                    feedback=feedback,
                    order_given=len(found.limits.model_orders) == 1,
                    measured=measured,
                    progress=progress,
                )
                made = made[0], refined
            if not model.n_inputs or _keeps_promise(made[1].realisation, records, trial):
                return made
            fallback = fallback or made
        n_made += 1
        if n_made == MOST_MADE:
            break
    if fallback is not None:
        return fallback
    raise NumericalError(
        f"all {len(found.trials)} models that were stable on parts of the data are unstable on the whole, so none can "
        "be trusted; give a longer record, or remove a drift from the outputs."
    )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class White:
    """Records filtered until their noise is white.

    Attributes:
        records: (n_samples - p, ...) filtered inputs and outputs; without those too short for the filter.
        filter: (p + 1,) a(q), monic.
        share: of the noise's power that is left behind it.
        found: the search; chosen is the model that stands, scored on the held-out rows of the records as they came.
    """

    records: tuple[Record, ...]
    filter: FloatArray
    share: float
    found: Search


def in_white(
    records: Sequence[Record],
    found: Search,
    final: FinalModel,
    *,
    grows: bool,
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
        progress: called with the share done.
    """
    rows = [record.complete_rows() for record in records]
    runs = model_runs(replace(final.realisation, K=None), records)
    a, share = common_filter(stretches(runs.left, rows))
    if share > COLOURED or not (fit_of(runs.records, runs.simulated) < 1.0 - NOISE_FREE).all():
        return None
    white = all_filtered(records, a)
    if not white:
        return None
    judged = White(records=white, filter=a, share=share, found=found)
    best = _better_in_white(white, found, final.realisation, grows=grows)
    if best is None:
        return None
    progress(0.5)
    trial, as_it_came = best
    if final.noise is not None and not trial.weak_modes:  # the likeliest estimate as it is
        return judged, final

    def own(done: float) -> None:
        progress(0.5 + 0.5 * done)

    model = _refined_in_white(judged, records, final, trial, progress=own)
    return None if model is None else (replace(judged, found=replace(found, chosen=as_it_came)), model)


def _better_in_white(
    white: Sequence[Record], found: Search, model: Realisation, *, grows: bool
) -> tuple[Trial, Trial] | None:
    """The trial of the model refined, and grown, behind the filter: there, and on the records as they came."""
    try:
        here, there = found.ground, prepare_ground(white, found.ground.by)
    except IdentificationError:
        return None
    data = output_error_data(here), output_error_data(there)
    chosen = replace(found.chosen, refinement_steps=MOST_STEPS, weak_modes=0, answers=0)
    own = _of_folds(model, there, data[1])
    start = _trial(chosen, own, there, data[1])
    if start is None:
        return None
    best, ratio = None, np.inf
    for trial, steps in chain([(start, own)], growing(there, data[1], own, start) if grows else ()):
        before, ratio = ratio, whiteness_ratio(steps[0], data[1])
        if not ratio < max(before, NEARLY_WHITE):  # more modes make what is not linear no whiter
            break
        as_it_came = _trial(trial, _carried(steps, there, here, data[0]), here, data[0])
        if ratio <= NEARLY_WHITE and as_it_came is not None:
            best = trial, replace(as_it_came, weak_modes=found.chosen.weak_modes + trial.weak_modes)
    return best


def _refined_in_white(
    behind: White,
    records: Sequence[Record],
    final: FinalModel,
    trial: Trial,
    *,
    progress: Callable[[float], None],
) -> FinalModel | None:
    """The final model refined, and grown, in all rows behind the filter; its gain is that of the records as they came.

    None where that is worse than on its folds.
    """
    white, found = behind.records, behind.found
    _, fitted = _with_observer(white, found.chosen, found.trials, {})
    if fitted is None:
        return None
    cut = _largest(fitted, trial.model_order)
    refined = refined_model(
        white,
        final.realisation,
        trial.refinement_steps,
        weak_modes=trial.weak_modes,
        answers=trial.answers,
        evidence=cut,
    )
    if refined is None or not _keeps_promise(refined.realisation, white, trial):
        return None
    model = _with_noise(white, fitted, cut, refined, progress=progress)
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


def _trial(like: Trial, steps: Sequence[RefinementStep], ground: Ground, data: OutputError) -> Trial | None:
    """The trial of a model of each fold; None without them."""
    if not steps:
        return None
    errors = [
        step.block_errors([i for i, block in enumerate(data.blocks) if block.label == fold])
        for fold, step in enumerate(steps)
    ]
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


def _with_observer(
    records: Sequence[Record], trial: Trial, others: Sequence[Trial], done: dict[tuple[int, float], FinalModel | None]
) -> tuple[Trial, FinalModel | None]:
    """The trial and its observer on all rows, added to those `done`; None where it cannot be recovered.

    What grew mode by mode came from no observer, so the first of the others' that can be recovered will do.
    """
    for one in (trial, *others) if trial.grew else (trial,):
        own = trial if one is trial else replace(trial, observer_order=one.observer_order, ridge=one.ridge)
        observer = (own.observer_order, own.ridge)
        if observer not in done:
            done[observer] = _decomposed(records, own)
        if done[observer] is not None:
            return own, done[observer]
    return trial, None


def _starts(found: Search, trial: Trial, model: Realisation, *, of_folds: bool) -> Iterator[Realisation]:
    """The model cut from all rows, then those from which the trial's folds went where it was chosen."""
    yield model
    for fold in range(len(found.ground.folds) if of_folds and trial.refinement_steps and model.order else 0):
        decomposition = training_decomposition(found.ground, trial.observer_order, trial.ridge, fold, model.order)
        start = None if decomposition is None else corner(decomposition, model.order)
        if start is not None:
            yield in_data_states(start, start, found.ground.scaling)


def _keeps_promise(model: Realisation, records: Sequence[Record], trial: Trial) -> bool:
    """Whether the model explains the rows that it was fitted to about as well as its folds explained held-out rows.

    A fit to all rows that is worse than that has gone astray: the observer's recovery nearly diverged on them.
    """
    try:
        runs = model_runs(replace(model, K=None), records)
    except NumericalError:
        return False
    return float(np.nanmean(fit_of(runs.records, runs.simulated))) >= 1.0 - trial.error - BROKEN_PROMISE


def _decomposed(records: Sequence[Record], trial: Trial) -> FinalModel | None:
    with quiet():  # poor conditioning is told by the excitation check; what it does, the free run has judged
        observer = fit_observer(records, order=trial.observer_order, ridge=trial.ridge)
    try:
        markov = recover_markov(observer, n_lags=markov_lags(observer.n_inputs, observer.n_outputs))
    except NumericalError:
        return None
    # the orders above the chosen one that the verdict asks for must be there, even at the end of the search's grid
    largest = max(LARGEST_ORDER, int(np.ceil(max(ORDER_SHARES) * trial.model_order)))
    decomposition = decompose(markov, max_order=min(largest, *hankel_limits(markov)))
    nothing = realise_from(decomposition, 0)
    return FinalModel(
        observer=observer,
        markov=markov,
        decomposition=decomposition,
        cut=nothing,
        refined=None,
        noise=None,
        why="",
        gain=None,
        realisation=nothing,
    )


def _refined(
    records: Sequence[Record],
    fitted: FinalModel,
    model: Realisation,
    trial: Trial,
    *,
    start: Realisation,
    n_rest: int,
    noise_free: str,
    by: Folds,
    feedback: bool,
    order_given: bool,
    measured: Sequence[BoolArray],
    progress: Callable[[float], None],
) -> FinalModel:
    refined = None
    if model.n_inputs:
        refined = refined_model(
            records,
            start,
            trial.refinement_steps,
            weak_modes=trial.weak_modes,
            answers=trial.answers,
            evidence=_largest(fitted, trial.model_order),
            n_rest=n_rest,
            by=by,
            measured=measured,
        )
    return _with_noise(
        records,
        fitted,
        model,
        refined,
        noise_free=noise_free or ("rows of rest, which hold no noise, stand before the record" if n_rest else ""),
        filled_from=measured,
        feedback=feedback,
        order_given=order_given,
        progress=progress,
    )


def _largest(fitted: FinalModel, order: int) -> Realisation:
    """The realisation of this order, or of the largest that there is."""
    return realise_from(fitted.decomposition, min(order, fitted.decomposition.rank, fitted.decomposition.max_order))


def _with_noise(
    records: Sequence[Record],
    fitted: FinalModel,
    model: Realisation,
    refined: RefinedModel | None,
    *,
    noise_free: str = "",
    filled_from: Sequence[BoolArray] = (),
    feedback: bool = False,
    order_given: bool = False,
    progress: Callable[[float], None],
) -> FinalModel:
    """The model with its gain, and with a model of its noise where that is likelier."""
    # the gain that came with the observer is not that of the model cut from it, and may make it unstable
    driven = model if refined is None else refined.realisation
    gain = estimate_gain(driven, records) if model.n_inputs else None
    base = model if gain is None else replace(driven, K=gain.gain)
    harmless = feedback and refined is not None and not _biased(refined)
    found: Feedback = "none" if not feedback else "harmless" if harmless else "biasing"
    made = replace(fitted, cut=model, refined=refined, gain=gain, realisation=base, feedback=found)
    if base.K is None:
        return made
    if filled_from and made.leaves_nearly_white:
        noise_free = "nearly white where it was measured, and samples that were filled hold none"
    if noise_free:
        return replace(made, why=noise_free)
    evidence = base if base.factors is not None else model
    noise, why = noise_model(
        records,
        base,
        evidence=evidence,
        feedback=found == "biasing",
        order_given=order_given,
        progress=progress,
    )
    if noise is None:
        return replace(made, why=why)
    gain = None if noise.n_noise == 0 else estimate_gain(noise.realisation, records)
    likeliest = noise.realisation if gain is None else replace(noise.realisation, K=gain.gain)
    return replace(made, noise=noise, why=why, gain=gain, realisation=likeliest)


def _biased(model: RefinedModel) -> bool:
    """Whether what seems to be feedback moves a mode by more than its interval should bear without a word.

    That the past of the outputs foretells an input is no feedback yet: a smooth force moves between its samples, which
    outputs see, and a steep low-pass filter knows more of its past than the regression.
    """
    modes = extract_modes(model.realisation).modes
    *_, moved = judged_deviations(model, modes, n_lags=1, fed_back=True)
    return not (np.hypot(1.0, moved) <= NOT_UNDERSTOOD).all()


def _stable(decomposition: HankelDecomposition, order: int) -> Realisation | None:
    """The model of this order, or of the rank where that is lower (noise-free data).

    None where it is unstable or cannot be run as it was when it was scored (without inputs: its one-step predictor).
    """
    model = realise_from(decomposition, min(order, decomposition.rank, decomposition.max_order))
    if np.abs(np.linalg.eigvals(model.A)).max(initial=0.0) >= 1.0:
        return None
    runs = modal_form(model if model.n_inputs else one_step_predictor(model)) is not None
    return model if runs else None


def with_deviations(
    model: ModalModel, final: FinalModel, records: Sequence[Record], *, measured_share: float = 1.0
) -> tuple[ModalModel, Uncertainty, FloatArray, FloatArray]:
    """The modes with the standard deviations of frequency, damping ratio and shape, and all of them together.

    Args:
        model: modes of the final model's realisation.
        final: the final model.
        records: that it was fitted to.
        measured_share: of their samples. What was filled holds no noise, and counts in all deviations but those of a
            refinement: both the noise and one over the number of samples are too small by this share.

    Returns:
        The modes, their deviations, (n_modes,) how many times larger those of a mode are than noise that is understood
        makes them, and (n_modes,) how many of the stated ones feedback moves it by: none where the model is that of a
        predictor.
    """
    inflation, moved = np.ones(len(model)), np.zeros(len(model))
    if final.noise is not None:
        known = innovation_uncertainty(final.noise, model.modes, n_lags=final.markov.n_lags)
    elif final.refined is not None:
        known, inflation, moved = judged_deviations(
            final.refined, model.modes, n_lags=final.markov.n_lags, fed_back=final.feedback != "none"
        )
    else:
        known = _propagated(model, final, records)
    if final.noise is not None or final.refined is None:
        known = known.wider(1.0 / measured_share)
    known = _no_finer_than_rounding(known, model, final.realisation)
    modes = tuple(
        replace(
            mode,
            frequency_std=float(known.frequency_std[i]),
            damping_ratio_std=float(known.damping_ratio_std[i]),
            shape_std=known.shape_std[i],
            mass_std=None if known.mass_std is None else known.mass_std[i],
        )
        for i, mode in enumerate(model.modes)
    )
    return replace(model, modes=modes), known, inflation, moved


def _no_finer_than_rounding(known: Uncertainty, model: ModalModel, realisation: Realisation) -> Uncertainty:
    """With what rounding leaves of a pole: an eigenvalue of n states is known to n eps, and s dt = ln of it as well."""
    poles, _ = discrete_poles(model.modes, realisation.dt)
    rounding = realisation.order * np.finfo(np.float64).eps / np.abs(poles)
    moves = np.angle(poles) != 0.0  # else a real pole, whose damping ratio is one
    return replace(
        known,
        frequency_std=np.hypot(known.frequency_std, rounding / (2 * np.pi * realisation.dt)),
        damping_ratio_std=np.where(moves, np.hypot(known.damping_ratio_std, rounding / np.abs(np.log(poles))), 0.0),
    )


def _propagated(model: ModalModel, final: FinalModel, records: Sequence[Record]) -> Uncertainty:
    try:
        return propagated(
            records, observer=final.observer, markov=final.markov, realisation=final.cut, modes=model.modes
        )
    except InsufficientDataError:  # too short for two blocks
        return _unknown(model, final)


def _unknown(model: ModalModel, final: FinalModel) -> Uncertainty:
    n_modes, n_outputs = len(model), final.cut.n_outputs
    return Uncertainty(
        method="propagation",
        frequency_std=np.full(n_modes, np.nan),
        damping_ratio_std=np.full(n_modes, np.nan),
        shape_std=np.full((n_modes, n_outputs), np.nan),
        markov_std=np.full((final.markov.n_lags + 1, n_outputs, final.cut.n_inputs), np.nan),
    )
