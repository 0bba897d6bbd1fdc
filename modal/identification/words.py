"""The reasons behind the automatic choices, in words with numbers, and the warnings that a user must read.

Each sentence follows from one rule, stated beside it.
"""

from collections.abc import Sequence

import numpy as np

from era.balanced import HankelDecomposition, order_choice, realise_from
from era.gain import GainEstimate
from modal.estimation.stretches import is_long, stretches_of
from modal.estimation.trials import Trial
from modal.identification.order_search import WITHIN, Search
from modal.identification.refined_search import MOST_STEPS
from modal.identification.result import Choice, Fit, OrderEvidence
from modal.modes.mode import ModalModel
from modal.verdict.judgement import Reruns
from modal.verdict.stabilisation import stabilisation
from okid.excitation import Excitation
from okid.record import Record
from okid.residuals import ResidualCheck

__all__ = ["EXPLAINS", "explain_gain", "explain_scoring", "explain_search", "order_evidence", "warnings_in_words"]

EXPLAINS = 0.5
"""Cross-validated fit below which the model does not explain the records and no mode is certain."""
FOLLOWS_INPUT = 3.0
"""Ratio of the input-correlation statistic to its degrees of freedom above which the observer misses something."""
LEAST_EXCITED = 0.5
"""Share of the band in which an input must move for its response not to be called narrow."""
FOLDS_APART = 0.25
"""Spread of the folds' fits above which the record is not of one piece (not stationary, or not linear)."""


def order_evidence(
    decomposition: HankelDecomposition, order: int, found: Search, *, reruns: Reruns | None = None
) -> OrderEvidence:
    """Singular values, gap, held-out fits and the poles of all orders.

    Args:
        decomposition: of the Hankel matrix that the model was cut from.
        order: the order chosen.
        found: the search that chose it.
        reruns: the same identified again, for the repeatability of each pole; None leaves it nan.
    """
    chosen = found.chosen
    best: dict[int, float] = {}  # of each order, whatever the number of refinement steps
    for trial in found.trials:
        if (trial.observer_order, trial.ridge) == (chosen.observer_order, chosen.ridge):
            best[trial.model_order] = min(best.get(trial.model_order, np.inf), trial.error)
    tried = sorted(best)
    highest = realise_from(decomposition, min(decomposition.rank, decomposition.max_order))
    return OrderEvidence(
        singular_values=decomposition.singular_values,
        order=order,
        gap_order=order_choice(decomposition).order,
        candidate_orders=np.array(tried, dtype=np.float64),
        candidate_fits=np.array([1.0 - best[n] for n in tried]),
        stabilisation=stabilisation(highest, reruns=reruns),
    )


def explain_search(found: Search, *, wanted: Trial) -> tuple[Choice, ...]:
    """Why this observer order, this ridge and this model order.

    Args:
        found: with the trial that was taken.
        wanted: the trial that the search chose; another one is taken where it is unstable on all rows.
    """
    chosen, limits = found.chosen, found.limits
    best = found.trials[0]
    measure = f"free run on held-out rows: fit {1.0 - chosen.error:.3f}"
    choices = [
        Choice(
            what="observer order",
            value=str(chosen.observer_order),
            reason="given as an argument"
            if len(limits.observer_orders) == 1
            else f"{measure}; {_runners_up(found.trials, 'observer_order')}",
        ),
        Choice(
            what="ridge",
            value=f"{chosen.ridge:.3g}",
            reason="given as an argument"
            if len(limits.ridges) == 1
            else f"{measure}; {_runners_up(found.trials, 'ridge')}",
        ),
    ]
    if len(limits.model_orders) == 1:
        reason = "given as an argument"
    elif wanted is not chosen:
        first = f"the first choice ({wanted.model_order} states)"
        reason = f"{measure}; {first} is unstable, or worse than on its folds, when fitted to all rows"
    elif chosen.error == best.error:
        reason = f"{measure}, the best of {len(found.trials)} models tried"
    else:
        reason = (
            f"{measure}; the smallest that is not worse than the best ({best.model_order} states, fit "
            f"{1.0 - best.error:.3f}) by more than one standard error over the held-out blocks"
        )
    if chosen.weak_modes:
        n_weak = chosen.weak_modes
        found_so = (
            f"{n_weak} weak mode{'s' * (n_weak > 1)} found in what {chosen.model_order - 2 * n_weak} states leave"
        )
        reason = f"{measure}; with {found_so}, held-out rows gain significantly"
    choices.append(Choice(what="model order", value=str(chosen.model_order), reason=reason))
    return (*choices, *_refinement(found))


def _refinement(found: Search) -> tuple[Choice, ...]:
    """How far the model was refined by output error, and what held-out rows made of it."""
    chosen = found.chosen
    tried = [trial for trial in found.trials if trial.refinement_steps]
    if not tried:
        return ()
    without = [1.0 - trial.error for trial in found.trials if not trial.refinement_steps]
    compared = f"held-out fit {1.0 - chosen.error:.3f}, the best without refinement {max(without):.3f}"
    if chosen.refinement_steps == 0:
        value, why = "none", f"held-out rows gain nothing by it: {compared}"
    elif chosen.refinement_steps == MOST_STEPS:
        value, why = "until it stands still", f"output error, held-out rows do not lose by any step: {compared}"
    else:
        value, why = f"{chosen.refinement_steps} steps", f"output error, stopped where held-out rows lose: {compared}"
    return (Choice(what="refinement", value=value, reason=why),)


def explain_gain(gain: GainEstimate | None) -> tuple[Choice, ...]:
    """Why the refined model has the gain that it has; nothing where it has the one that it was cut with."""
    if gain is None:
        return ()
    return (Choice(what="gain", value="estimated" if gain.gain.any() else "zero", reason=gain.reason),)


def _runners_up(trials: Sequence[Trial], name: str) -> str:
    """Best fit for each other value of one setting, in the order of the value."""
    best: dict[float, float] = {}
    for trial in trials:
        value = getattr(trial, name)
        best[value] = max(best.get(value, -np.inf), 1.0 - trial.error)
    shown = [f"{value:.3g}: {fit:.3f}" for value, fit in sorted(best.items())]
    return f"best fits by {name.replace('_', ' ')}: {', '.join(shown)}" if len(shown) > 1 else "no other came close"


def explain_scoring(records: Sequence[Record]) -> tuple[Choice, ...]:
    """What was scored where the records are too long to be run whole for each candidate."""
    if not is_long(records):
        return ()
    stretches = stretches_of(records)
    n_scored = sum(one.last - one.first for one in stretches)
    n_samples = sum(record.n_samples for record in records)
    return (
        Choice(
            what="scored rows",
            value=f"{len(stretches)} stretches, {n_scored} samples",
            reason=f"each candidate is run freely through these; all {n_samples} samples count in its fit",
        ),
    )


def warnings_in_words(
    records: Sequence[Record],
    *,
    fit: Fit,
    modes: ModalModel,
    excitation: Excitation,
    residuals: ResidualCheck,
    found: Search,
) -> tuple[str, ...]:
    """What the user must read before believing a number; empty when all is well."""
    words = []
    driven = records[0].n_inputs > 0
    if fit.mean < EXPLAINS:
        share = max(0, int(np.floor(100 * fit.mean)))
        what = "a free run of the model" if driven else "one-step prediction"
        words.append(
            f"The model does not explain the data: {what} explains {share} % of the outputs' motion on held-out rows, "
            "so no mode is certain."
        )
    else:
        poor = [
            f"{name} ({value:.2f})"
            for name, value in zip(records[0].output_names, fit.cross_validated, strict=True)
            if value < EXPLAINS
        ]
        if poor:
            words.append(f"The model does not explain these outputs (held-out fit): {', '.join(poor)}.")
    spread = float(fit.folds.max() - fit.folds.min())
    if spread > FOLDS_APART:
        words.append(
            f"Parts of the data fit very differently ({fit.folds.min():.2f} to {fit.folds.max():.2f} over the folds): "
            "the system is not linear, changes in time, or something that was not measured drives it."
        )
    if not driven:
        words.append(
            "No input was given: damping and shapes hold if what drives the system is broad-band, and the fit is that "
            "of one-step prediction."
        )
    if not modes.system and fit.mean >= EXPLAINS:
        words.append("No mode was found again often enough to be called a mode of the system.")
    if _wants_a_longer_observer(found):
        words.append(
            f"The largest observer order that the data allow ({found.chosen.observer_order}) was the best: a longer "
            "record may carry more."
        )
    if residuals.input_correlation_ratio > FOLLOWS_INPUT:
        words.append(
            "What the observer leaves over still follows the inputs (statistic over degrees of freedom "
            f"{residuals.input_correlation_ratio:.1f}, 1 is none): the system is not linear, changes in time, or "
            "answers for longer than the observer looks back, so expect damping ratios to be off."
        )
    return (*words, *(_excitation_words(excitation) if driven else ()))


def _wants_a_longer_observer(found: Search) -> bool:
    """The largest order was taken, and every lower one that was tried is clearly worse."""
    orders = found.limits.observer_orders
    if len(orders) == 1 or found.chosen.observer_order < max(orders):
        return False
    lower = min((t.error for t in found.trials if t.observer_order < max(orders)), default=np.inf)
    return lower > WITHIN * found.chosen.error


def _excitation_words(excitation: Excitation) -> tuple[str, ...]:
    """Lack of excitation that the fit cannot have overcome; what a ridge can is told with the data's quality."""
    lacking = excitation.persistency_order < excitation.needed_order
    narrow = bool((excitation.excited_share < LEAST_EXCITED).any())
    return excitation.messages if lacking or narrow else ()
