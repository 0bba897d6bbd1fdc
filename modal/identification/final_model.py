"""The chosen candidate fitted to all rows and refined; where it becomes unstable, the next best that stays stable.

Every candidate was stable on each fold, but a pole at the edge (an integrator, an undamped line) may fall on either
side of the unit circle when all rows are used. An unstable model cannot run freely, so it is never the answer.

Standard deviations of its modes: of the model of its noise, else of its refinement, else propagated through OKID and
ERA.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy

from era.balanced import HankelDecomposition, decompose, realise_from
from era.gain import GainEstimate, estimate_gain
from era.realisation import Realisation
from modal.estimation.cross_validation import (
    Folds,
    Trial,
    corner,
    hankel_limits,
    markov_lags,
    training_decomposition,
)
from modal.estimation.fits import fit_of, model_runs
from modal.estimation.free_run import modal_form, one_step_predictor
from modal.estimation.modal_parameters import in_data_states
from modal.estimation.propagation import propagated
from modal.identification.covariance import NOT_UNDERSTOOD, judged_deviations
from modal.identification.information import innovation_uncertainty
from modal.identification.noise_model import NoiseModel, noise_model
from modal.identification.order_search import Search
from modal.identification.refined_search import (
    RefinedModel,
    refined_model,
)
from modal.modes.extraction import extract_modes
from modal.modes.modal_form import discrete_poles
from modal.modes.mode import Choice, ModalModel, Uncertainty
from modal.preparation.steps import Preparation
from modal.verdict.filled import seen_alone
from modal.verdict.linearity import NOT_LINEAR
from modal.verdict.repeatability import ORDER_SHARES
from okid.arrays import TINY, BoolArray, FloatArray
from okid.errors import InsufficientDataError, NumericalError, quiet
from okid.markov import MarkovParameters, recover_markov
from okid.observer import ObserverFit, fit_observer
from okid.record import Record
from okid.residuals import NOT_WHITE, WHITENESS_LAGS, whiteness_of_each

Feedback = Literal["none", "harmless", "biasing"]

BROKEN_PROMISE = 0.1
"""Fit to all rows below that to held-out rows from which on a model is not taken."""
LATE = 0.75
"""Compare what follows a blow with what does when so much of the time to the next one has passed."""
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
        unlike: how many times as far as noise of the force's sensor makes them the answers to blows differ; 0 where
            chance makes as much.
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
    unlike: float = 0.0

    @property
    def leaves_white_noise(self) -> bool:
        """Whether white noise on the outputs is all there is."""
        return self.noise is None and self.refined is not None and self.refined.leaves_white_noise

    @property
    def apart(self) -> tuple[BoolArray, ...]:
        """(n_samples, n_outputs) a record, False while a blow errs by itself; none where all rows count alike."""
        struck = self.refined is not None and self.refined.data.elsewhere > 0.0
        return self.refined.data.measured if self.refined is not None and struck else ()

    def seen(
        self, left: Sequence[FloatArray], records: Sequence[Record], measured: Sequence[BoolArray]
    ) -> list[FloatArray] | None:
        """(n_samples, n_outputs) a record: white errors of samples that count alike; None where all do.

        Args:
            left: by the free run.
            records: of which it is left.
            measured: (n_samples, n_outputs) a record, False where a sample was filled; none where all were measured.

        Returns:
            NaN where a sample counts less or not at all: what the free run leaves where that is nearly white, else one
            step ahead. Nothing where that is coloured.
        """
        there = measured or self.apart
        if self.leaves_nearly_white and there:
            return [np.where(own, one, np.nan) for one, own in zip(left, there, strict=True)]
        if measured or self.refined is None or not there:
            return [] if measured else None
        runs = model_runs(self.realisation, self.refined.as_fitted(records))
        asked = zip(seen_alone(runs.records, self.apart), runs.predicted, strict=True)
        errors = [one.outputs - run.outputs for one, run in asked]
        return [] if whiteness_of_each(errors, n_lags=WHITENESS_LAGS) > NOT_WHITE else errors

    @property
    def leaves_nearly_white(self) -> bool:
        """Whether what the refined model leaves of the samples that were measured is not called coloured."""
        return self.refined is not None and not self.refined.whiteness_ratio > NOT_WHITE


def fit_all_rows(
    records: Sequence[Record],
    found: Search,
    *,
    n_rest: int = 0,
    refinement: Literal["auto", "none"] = "auto",
    feedback: bool = False,
    measured: Sequence[BoolArray] = (),
    acting: Sequence[BoolArray] = (),
    at_rest: FloatArray | None = None,
    progress: Callable[[float], None] = lambda _share: None,
) -> tuple[Search, FinalModel]:
    """Fit the chosen trial, else the next best stable one, to all rows.

    A refinement of all rows that falls behind what its folds promised starts again from where the folds started.

    Args:
        records: that the search saw.
        found: by the search.
        n_rest: rows of rest among theirs, which hold no noise.
        refinement: "none" leaves the model as OKID and ERA give it.
        feedback: the outputs seem to be fed back into the inputs.
        measured: (n_samples, n_outputs) a record, False where a sample was filled; none where all were measured.
        acting: (n_samples,) a record, True where one of a few blows acts.
        at_rest: (n_records, n_inputs) variances of the inputs' noise where a force window took it off.
        progress: called with the share that is behind at most, before each step.

    Returns:
        The search with the trial that was taken as its chosen one, and the model.

    Raises:
        NumericalError: every trial is unstable on all rows.
    """

    def ended(search: Search, fitted: FinalModel) -> tuple[Search, FinalModel]:
        if refinement == "none":
            return search, fitted
        return search, with_noise(
            records,
            fitted,
            fitted.cut,
            fitted.refined,
            measured=measured,
            feedback=feedback,
            order_given=len(found.limits.model_orders) == 1,
            progress=progress,
        )

    done: dict[tuple[int, float], FinalModel | None] = {}
    fallback: tuple[Search, FinalModel] | None = None
    n_made = 0
    for trial in (found.chosen, *found.trials):
        trial, fitted = with_observer(records, trial, found.trials, done)  # noqa: PLW2901
        model = None if fitted is None else _stable(fitted.decomposition, trial.model_order - 2 * trial.weak_modes)
        if fitted is None or model is None:
            continue
        for start in _starts(found, trial, model, of_folds=refinement == "auto" and not n_made):
            search, last = replace(found, chosen=trial), replace(fitted, cut=model, realisation=model)
            if refinement == "auto":
                last = _refined(
                    records,
                    last,
                    trial,
                    start=start,
                    n_rest=n_rest,
                    by=found.ground.by,
                    measured=measured,
                    acting=acting,
                    at_rest=at_rest,
                )
            # a free run follows no wind: the likelier model of what wind moves too explains less of it, and is right
            if not model.n_inputs or keeps_promise(last.realisation, records, trial):
                return ended(search, last)
            fallback = fallback or (search, last)
        n_made += 1
        if n_made == MOST_MADE:
            break
    if fallback is not None:
        return ended(*fallback)
    raise NumericalError(
        f"all {len(found.trials)} models that were stable on parts of the data are unstable on the whole, so none can "
        "be trusted; give a longer record, or remove a drift from the outputs."
    )


def with_observer(
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


def keeps_promise(model: Realisation, records: Sequence[Record], trial: Trial) -> bool:
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
    trial: Trial,
    *,
    start: Realisation,
    n_rest: int,
    by: Folds,
    measured: Sequence[BoolArray],
    acting: Sequence[BoolArray],
    at_rest: FloatArray | None,
) -> FinalModel:
    if not start.n_inputs:
        return fitted
    refined = refined_model(
        records,
        start,
        trial.refinement_steps,
        weak_modes=trial.weak_modes,
        answers=trial.answers,
        grown=trial.grown,
        evidence=largest_model(fitted, trial.model_order),
        n_rest=n_rest,
        by=by,
        measured=measured,
        acting=acting,
        at_rest=at_rest,
    )
    return fitted if refined is None else replace(fitted, refined=refined, realisation=refined.realisation)


def largest_model(fitted: FinalModel, order: int) -> Realisation:
    """The realisation of this order, or of the largest that there is."""
    return realise_from(fitted.decomposition, min(order, fitted.decomposition.rank, fitted.decomposition.max_order))


def with_noise(
    records: Sequence[Record],
    fitted: FinalModel,
    model: Realisation,
    refined: RefinedModel | None,
    *,
    measured: Sequence[BoolArray] = (),
    feedback: bool = False,
    order_given: bool = False,
    progress: Callable[[float], None],
) -> FinalModel:
    """The model with its gain, and with a model of its noise where that is likelier."""
    # the gain that came with the observer is not that of the model cut from it, and may make it unstable
    driven = model if refined is None else refined.realisation
    if refined is not None:  # what a force does between its samples, or errs by, is no noise
        records = refined.as_fitted(refined.with_forces(records))
    gain = estimate_gain(driven, records) if model.n_inputs else None
    base = model if gain is None else replace(driven, K=gain.gain)
    harmless = feedback and refined is not None and not _biased(refined)
    found: Feedback = "none" if not feedback else "harmless" if harmless else "biasing"
    made = replace(fitted, cut=model, refined=refined, gain=gain, realisation=base, feedback=found)
    if base.K is None:
        return made
    if measured and (made.leaves_nearly_white or lack_outputs(measured)):
        colour = "nearly white" if made.leaves_nearly_white else "told"
        return replace(made, why=f"{colour} where it was measured, and samples that were filled hold none")
    if made.leaves_nearly_white and refined is not None and refined.data.elsewhere > 0.0:
        times = 1.0 / np.sqrt(refined.data.elsewhere)
        why = f"nearly white; while a blow acts, which no sample tells whole, errors are {times:.3g} times as large"
        return replace(made, why=f"{why}, and count by that")
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


def _unlike_blows(refined: RefinedModel) -> float:
    """How many times as far as by noise of the force's sensor the answers to blows differ; 0 where no further.

    Wind and drifts move what follows a blow as well, but late as far as soon after it.
    """
    soon = refined.likely_forces(refined.at_rest)
    late = refined.likely_forces(refined.at_rest, late=LATE)
    if soon is None or late is None or not soon.chance < NOT_LINEAR:
        return 0.0
    ratio = (soon.times / max(1.0, late.times)) ** 2
    alike = scipy.special.fdtrc(soon.power.size, late.power.size, ratio)
    return soon.times if alike < NOT_LINEAR else 0.0


def with_forces(preparation: Preparation, final: FinalModel) -> tuple[Preparation, FinalModel]:
    """With the likeliest forces, where what follows a blow tells them; and told how their sensors err."""
    if final.refined is None:
        return preparation, final
    refined = final.refined.told_at_rest(preparation.at_rest)
    final = replace(final, refined=refined)
    if not refined.forces_erred:
        asked = refined.acting and preparation.white_at_rest.any()
        return preparation, replace(final, unlike=_unlike_blows(refined)) if asked else final
    errors, forces = (np.vstack(own) for own in (refined.forces_erred, [r.inputs for r in preparation.records]))
    size = np.sqrt(np.square(errors).sum(axis=0) / np.maximum(1, (errors != 0.0).sum(axis=0)))
    told = Choice(
        what="force while a blow acts",
        value="told with what follows",
        reason="its sensor errs then as it does at rest, so each blow's answer is off by a little of its own: the "
        "force that is likeliest for both differs by "
        f"{100.0 * (size / np.maximum(np.nanmax(np.abs(forces), axis=0), TINY)).max():.2g} % of its largest",
    )
    records = refined.with_forces(preparation.records)
    return replace(preparation, records=records, choices=(*preparation.choices, told)), final


def lack_outputs(measured: Sequence[BoolArray]) -> bool:
    """Whether some record holds no sample of an output that was measured; no model foretells its noise from others'."""
    return any(not there.any(axis=0).all() for there in measured)


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
