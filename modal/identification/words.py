"""The reasons behind the automatic choices, in words with numbers, and the warnings that a user must read.

Each sentence follows from one rule, stated beside it.

How far a result can be trusted, in plain words: each sentence comes from a rule, and says no more than it carries.

The report, the recording and the terminal all take these words, and a limit of acceptance is weighed by them, so that
they cannot disagree.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from era.balanced import HankelDecomposition, order_choice, realise_from
from era.gain import GainEstimate
from modal.estimation.cross_validation import WITHIN, Folds, Trial, is_long, stretches_of
from modal.identification.covariance import NOT_UNDERSTOOD
from modal.identification.noise_model import NoiseModel
from modal.identification.order_search import MOST_STEPS, Search
from modal.identification.result import Identification, OrderEvidence
from modal.modes.modal_mass import DERIVATIVES
from modal.modes.mode import Choice, Fit, ModalModel, Mode
from modal.verdict.constancy import NO_INTERVAL
from modal.verdict.excitation import BetweenLines
from modal.verdict.judgement import Reruns
from modal.verdict.linearity import Powers
from modal.verdict.probability import MOST_MISSED
from modal.verdict.stabilisation import stabilisation
from modal.wording.text import (
    GOOD_FIT,
    LEAST_FIT,
    NINETY_FIVE,
    NONLINEAR,
    counted,
    hertz,
    percent,
    ratio_text,
    reproduced,
    shorten,
    with_interval,
)
from okid.arrays import FloatArray
from okid.excitation import Excitation
from okid.record import Record
from okid.residuals import WHITENESS_LAGS, ResidualCheck, input_correlation_of_each

FOLLOWS_INPUT = 3.0
"""Ratio of the input-correlation statistic to its degrees of freedom above which the observer misses something."""
LEAST_EXCITED = 0.5
"""Share of the band in which an input must move for its response not to be called narrow."""
MUCH_LEFT, TIMES_BETTER = 0.05, 4.0
"""Say that records do not belong together where a model of all leaves more than a twentieth of the motion and models of
each by itself a quarter of that: with four rows an unknown such a model follows noise by a quarter of its power."""
NOISE_UNKNOWN = "Noise not understood"
WHITE_NOISE = "white on the outputs"
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
    observed = [trial for trial in found.trials if not trial.grew]
    of_observers = measure
    if chosen.grew:
        least = min(trial.error for trial in observed)
        of_observers = (
            f"free run on held-out rows: fit {1.0 - least:.3f}, less than that of the model, which grew mode by mode"
        )
    choices = [
        Choice(
            what="observer order",
            value=str(chosen.observer_order),
            reason="given as an argument"
            if len(limits.observer_orders) == 1
            else f"{of_observers}; {_runners_up(observed, 'observer_order')}",
        ),
        Choice(
            what="ridge",
            value=f"{chosen.ridge:.3g}",
            reason="given as an argument"
            if len(limits.ridges) == 1
            else f"{of_observers}; {_runners_up(observed, 'ridge')}",
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
    if chosen.grew:
        reason = f"{measure}; {n_weak} mode{'s' * (n_weak > 1)}, each found in what those before leave, as long as "
        reason += "held-out rows gain significantly"
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
        value, why = "none", f"data kept aside fit no better by it: {compared}"
    elif found.ground.by == "rows":
        value, why = "to convergence", f"output error; too few blows to stop earlier by data kept aside: {compared}"
    elif found.ground.measured:
        value, why = (
            "to convergence",
            f"output error of what was measured; what was filled says nothing of when to stop: {compared}",
        )
    elif chosen.refinement_steps == MOST_STEPS:
        value, why = "to convergence", f"output error; no step made data kept aside fit worse: {compared}"
    else:
        value, why = (
            f"{chosen.refinement_steps} steps",
            f"output error, stopped where data kept aside fit worse: {compared}",
        )
    return (Choice(what="refinement", value=value, reason=why),)


def explain_noise(noise: NoiseModel | None, why: str) -> tuple[Choice, ...]:
    """Whether the noise has a model of its own, and why; nothing where it is white or none was tried."""
    if not why:
        return ()
    value = WHITE_NOISE
    if noise is not None:
        value = "innovation form" + (f" with {noise.n_noise} states of the noise" if noise.n_noise else "")
    return (Choice(what="noise", value=value, reason=why),)


def has_noise_model(result: Identification) -> bool:
    """Whether the noise of the result has a model of its own."""
    return any(choice.what == "noise" and choice.value != WHITE_NOISE for choice in result.choices)


def explain_filter(a: FloatArray, share: float) -> tuple[Choice, ...]:
    """That modes were judged, and weak ones looked for, in filtered records, and by which filter."""
    terms = "".join(f" {'+' if one > 0 else '-'} {abs(one):.3g} q^-{k}" for k, one in enumerate(a) if k)
    reason = (
        f"behind it the noise is nearly white, with {100 * share:.2g} % of its power; noise at other frequencies does "
        "not drown weak modes there, so that they were looked for, and all modes judged, there"
    )
    return (Choice(what="noise filter", value=f"1{terms}", reason=reason),)


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


def explain_scoring(records: Sequence[Record], folds: Folds = "blocks") -> tuple[Choice, ...]:
    """What was scored where the records are too long to be run whole for each candidate."""
    if not is_long(records):
        return ()
    stretches = stretches_of(records, folds)
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
    missed: float,
    lines: BetweenLines | None,
    modes: ModalModel,
    excitation: Excitation | None,
    residuals: ResidualCheck,
    seen: Sequence[FloatArray] | None,
    found: Search,
    powers: Powers,
) -> tuple[str, ...]:
    """What the user must read before believing a number; empty when all is well.

    The residuals are those of what the model came from: its observer, or itself where it grew mode by mode. Where some
    samples were filled, both follow what filled them: in their place stands what the model leaves of the measured ones
    where that is nearly white, NaN elsewhere, else nothing.
    """
    driven = records[0].n_inputs > 0
    words = _fit_words(records[0], fit, missed, has_modes=bool(modes.system), powers=powers)
    if min(float(np.ptp(fit.folds)), float(np.ptp(_fits_to_all(found)))) > FOLDS_APART:
        words.append(
            f"Parts of the data fit very differently ({fit.folds.min():.2f} to {fit.folds.max():.2f} over the folds): "
            "the system is not linear, changes in time, or something that was not measured drives it."
        )
    if lines is not None:
        words.append(
            f"The inputs are hardly more than {lines.shown}: they fix the response there and nowhere else, so only a "
            "mode that shows beside them is accepted; drive the structure with a broad band."
        )
    if not driven:
        words.append(
            "No input was given: damping and shapes hold if what drives the system is broad-band, and the fit is that "
            "of one-step prediction."
        )
    if not modes.system and (not driven or fit.mean >= LEAST_FIT):
        doubted = any(mode.doubts for mode in modes.modes)
        words.append(
            "No mode is certain: of each that was found again the reason says what stands against it."
            if doubted
            else "No mode was found again often enough to be called a mode of the system."
        )
    if _wants_a_longer_observer(found):
        words.append(
            f"The largest observer order that the data allow ({found.chosen.observer_order}) was the best: a longer "
            "record may carry more."
        )
    follows = residuals.input_correlation_ratio
    if seen is not None:
        inputs = [one.inputs for one in records]
        follows = input_correlation_of_each(seen, inputs, last_lag=WHITENESS_LAGS) if seen else float("nan")
    words += _what_follows(follows, of_model=found.chosen.grew or seen is not None)
    return (*words, *(() if excitation is None else _excitation_words(excitation)))


def _fit_words(record: Record, fit: Fit, missed: float, *, has_modes: bool, powers: Powers) -> list[str]:
    """How little the model reproduces of such records, and why, where that is little."""
    words, driven = [], record.n_inputs > 0
    if fit.mean < LEAST_FIT or missed > MOST_MISSED:
        what = "a free run of the model" if driven else "one-step prediction"
        how = f"{what} reproduces {reproduced(fit.mean)} of data kept aside"
        if not driven:
            words.append(
                f"Noise of the sensors, or what drives them anew at each sample, makes most of the outputs: {how}. "
                "Each mode is judged by itself."
            )
        elif missed > MOST_MISSED or not has_modes:
            much = f" and leaves {100 * missed:.0f} % of what the inputs explain" if missed > MOST_MISSED else ""
            words.append(f"The model does not explain the data: {how}{much}, so no mode is certain.")
        elif not powers.told:
            words.append(
                f"Noise or forces that were not measured make most of the outputs: {how}, and what it leaves "
                "does not follow the inputs. The modes hold all the same: each is judged by itself."
            )
        else:
            words.append(f"{how[0].upper()}{how[1:]}; each mode is judged by itself.")
    else:
        poor = [
            f"{name} ({value:.2f})"
            for name, value in zip(record.output_names, fit.cross_validated, strict=True)
            if value < LEAST_FIT
        ]
        if poor:
            words.append(f"The model does not reproduce these outputs (fit to data kept aside): {', '.join(poor)}.")
    if powers.told:
        words.append(
            f"{NONLINEAR}: squares and cubes of the motion make {percent(powers.share)} of the prediction's errors, "
            "and as much by chance in less than one record of 10 000. Modes and damping are an average at this level "
            "of motion, and another level gives others; `modal-report gap` names the effect."
        )
    return words


def _what_follows(ratio: float, *, of_model: bool) -> tuple[str, ...]:
    """That what is left follows the inputs, where it does."""
    if not ratio > FOLLOWS_INPUT:
        return ()
    what, why = "observer", "changes in time, or answers for longer than the observer looks back"
    if of_model:
        what, why = "model", "or changes in time"
    text = (
        f"What the {what} leaves over still follows the inputs, {ratio:.1f} times as much "
        f"as chance would: the system is not linear, {why}, so expect damping "
        "ratios to be off."
    )
    return (text,)


def _fits_to_all(found: Search) -> FloatArray:
    """(n_folds,) fit of each fold by the motion of all: one fold at rest fits badly by its own, with the same noise."""
    shares = found.chosen.squared_errors / found.power.mean(axis=0)
    fits: FloatArray = (1.0 - np.sqrt(shares)).mean(axis=1)
    return fits


def noise_words(modes: ModalModel, inflation: FloatArray) -> tuple[str, ...]:
    """What the noise that no model of it explains does to the intervals of the system's modes.

    Args:
        modes: judged.
        inflation: (n_modes,) of each one's deviations, over those that white noise of all sensors makes.
    """
    own = [(mode, times) for mode, times in zip(modes, inflation.tolist(), strict=True) if mode.verdict == "system"]
    larger = [times for _, times in own if NOT_UNDERSTOOD < times <= NO_INTERVAL]
    lost = ", ".join(hertz(mode.frequency) for mode, times in own if times > NO_INTERVAL)
    words = []
    if larger:
        words.append(
            f"{NOISE_UNKNOWN}: what the model leaves makes the deviations of frequency and damping up to "
            f"{max(larger):.1f} times those that white noise of all sensors makes; the larger ones are stated."
        )
    if lost:
        words.append(
            f"{NOISE_UNKNOWN}: what the model leaves makes the deviations at {lost} Hz more than "
            f"{NO_INTERVAL:.0f} times those that white noise of all sensors makes: no interval is given there."
        )
    return tuple(words)


def blows_apart(times: float) -> tuple[str, ...]:
    """That blows are answered each in its own way, where they are.

    Args:
        times: how many times as far as noise of the force's sensor makes them their answers differ; 0 for no further.
    """
    if not times:
        return ()
    text = (
        f"Each blow is answered in its own way: what follows differs {times:.2g} times as far as noise of the force's "
        "sensor makes it, and as far by chance in less than one record of 10 000. Something is not linear, changes "
        "in time, or was not always struck at the same point in the same direction; modes and damping are an average."
    )
    return (text,)


def records_apart(alone: float, together: float) -> tuple[str, ...]:
    """That records do not belong to one system with the inputs where they are said to act; empty where they may.

    Args:
        alone: share of the outputs' power that models of each record by itself leave.
        together: the same of the model of all.
    """
    if not (together > MUCH_LEFT and alone < together / TIMES_BETTER):
        return ()
    said = (
        f"The records do not belong together: a model of each by itself leaves {percent(alone)} of its motion, the "
        f"model of all {percent(together)}. Where an input acted at another point in each, as a roving hammer does, "
        "name it after the point in each file (force p01, force p02) and give all names as inputs; where the "
        "structure changed between the records, identify them apart."
    )
    return (said,)


def _wants_a_longer_observer(found: Search) -> bool:
    """The largest order was taken, and every lower one that was tried is clearly worse.

    More rows of what was struck or let go are rest, and carry nothing.
    """
    orders = found.limits.observer_orders
    if found.ground.by == "rows" or len(orders) == 1 or found.chosen.observer_order < max(orders):
        return False
    lower = min((t.error for t in found.trials if t.observer_order < max(orders)), default=np.inf)
    return lower > WITHIN * found.chosen.error


def _excitation_words(excitation: Excitation) -> tuple[str, ...]:
    """Lack of excitation that the fit cannot have overcome; what a ridge can is told with the data's quality."""
    lacking = excitation.persistency_order < excitation.needed_order
    narrow = bool((excitation.excited_share < LEAST_EXCITED).any())
    return excitation.messages if lacking or narrow else ()


MOST_CAUTION = 0.3
"""Say that the classical indicators test the observer rather than the data where n / (p q) is greater."""


Trust = Literal["carried", "with care", "not carried"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Judgement:
    """How far the result as a whole can be trusted.

    Attributes:
        trust: "not carried" when no mode belongs to the system; "with care" when the fit is below 0.8 or not known, or
            there are warnings; otherwise "carried".
        label: the same in two or three words.
        reasons: sentences, the weightiest first.
    """

    trust: Trust
    label: str
    reasons: tuple[str, ...]


def trust_of(result: Identification) -> Judgement:
    """Whether the result can be relied on; the command's exit status is 1 exactly when no mode is accepted."""
    fit = result.fit.mean
    n_system = len(result.modes.system)
    reasons = [fit_sentence(result)]
    if not n_system:
        reasons.append("No pole of the model is accepted as a mode of the system.")
    if n_system and (damping := damping_sentence(result)):
        reasons.append(damping)
    reasons += [sentence for sentence in (doubtful_sentence(result),) if sentence]
    if not n_system:
        return Judgement(trust="not carried", label="Not reliable", reasons=tuple(reasons))
    if result.warnings or not fit >= GOOD_FIT:
        return Judgement(trust="with care", label="Use with care", reasons=tuple(reasons))
    return Judgement(trust="carried", label="Reliable", reasons=tuple(reasons))


def fit_sentence(result: Identification) -> str:
    """How much of the data kept aside the model reproduces, and of which output the least."""
    fit = result.fit.mean
    if not math.isfinite(fit):
        return "No data were kept aside, so nothing here has been tested on data that the model had not seen."
    if fit < LEAST_FIT:
        rest = "; the rest is noise or forces that were not measured." if result.modes.system else ", too little."
        return f"The model reproduces only {reproduced(fit)} of data kept aside{rest}"
    names, fits = result.channels.output_names, result.fit.cross_validated
    worst = int(fits.argmin())
    how = "From the inputs alone" if result.channels.n_inputs else "From the samples before (no input was measured)"
    how = "From the start of each record alone" if result.record_kind == "decay" else how
    what = "data kept aside"
    if result.response is not None:
        how, what = "In units of their standard deviations", "responses from the other half of the averages"
    sentence = f"{how}, the model reproduces {reproduced(fit)} of {what}"
    least = f" (worst channel {shorten(names[worst])}: {reproduced(fits[worst])})"
    return sentence + (least if reproduced(fits[worst]) != reproduced(fit) else "") + "."


def damping_sentence(result: Identification) -> str:
    """Which damping ratios are not to be quoted; "" when all are resolved."""
    unresolved = [mode for mode in result.modes.system if not mode.damping_resolved and mode.kind == "oscillatory"]
    if not unresolved:
        return ""
    which = ", ".join(hertz(mode.frequency) for mode in unresolved)
    modes = "mode exists" if len(unresolved) == 1 else "modes exist"
    return f"The {modes} at {which} Hz, but the damping is not resolved: do not quote it."


def doubtful_sentence(result: Identification) -> str:
    """Which poles the data do not settle, the most repeatable first; "" when there are none."""
    doubtful = [mode for mode in result.modes if mode.verdict == "doubtful"]
    if not doubtful:
        return ""
    best = sorted(doubtful, key=lambda mode: -(mode.repeatability if math.isfinite(mode.repeatability) else 0.0))[:3]
    which = ", ".join(hertz(mode.frequency) for mode in best)
    more = "more " if result.modes.system else ""
    if len(doubtful) == 1:
        return f"One {more}pole, at {which} Hz, is doubtful: the data do not settle whether it is a mode."
    rest = f" and {len(doubtful) - 3} more" if len(doubtful) > 3 else ""
    return (
        f"{counted(len(doubtful)).capitalize()} {more}poles are doubtful ({which} Hz{rest}): the data do not settle "
        "whether they are modes."
    )


def caution_sentence(result: Identification) -> str:
    """What n / (p q) says about the classical indicators; "" while it is small."""
    caution = result.modes.indicator_caution
    if result.modes.indicators_missing:
        return f"The classical indicators are not known: {result.modes.indicators_missing.rstrip('.')}."
    if not caution > MOST_CAUTION:
        return ""
    return (
        f"Model order over observer order times outputs, n / (p q), is {caution:.2f}, above {MOST_CAUTION}: amplitude "
        "coherence and EMAC then test how well a mode repeats the observer rather than the data; go by repeatability."
    )


def damping_text(mode: Mode) -> str:
    """Damping ratio in percent as it may be quoted.

    A standard deviation, where known, is shown as a 95 % interval.
    """
    if mode.kind == "real":
        return "overdamped"
    if not mode.damping_resolved:
        return "not resolved"
    return ratio_text(mode.damping_ratio, mode.damping_ratio_std)


def damping_shown(mode: Mode) -> str:
    """Damping ratio in percent for the table of all poles, where it stands even if it may not be quoted.

    Its 95 % interval is shown only where it may be.
    """
    if mode.kind in ("real", "nyquist") or not mode.damping_resolved:
        return ratio_text(mode.damping_ratio)
    return ratio_text(mode.damping_ratio, mode.damping_ratio_std)


def shown_frequency(mode: Mode) -> float:
    """The natural frequency [Hz]; half the sampling frequency for a pole on the negative real axis, which has none."""
    return mode.frequency if mode.kind != "nyquist" else abs(mode.pole.imag) / (2.0 * math.pi)


def mass_text(mode: Mode) -> str:
    """Modal mass in kg, with its 95 % interval where that is known; a dash without a driving point."""
    return "–" if math.isnan(mode.modal_mass) else with_interval(mode.modal_mass, NINETY_FIVE * mode.modal_mass_std)


def mass_sentence(result: Identification) -> str:
    """What the modal masses are of, or how to get them where a force was measured; "" where none was."""
    points = [choice.value for choice in result.choices if choice.what == "driving point"]
    if points:
        return f"Modal mass: of the shape whose largest component is 1, from the driving point {points[0]}."
    forces = [unit in ("", "N") for unit in result.channels.input_units]
    if not any(forces) or result.record_kind == "decay" or not set(result.channels.output_units) <= set(DERIVATIVES):
        return ""
    return (
        "No modal mass: no sensor is known to be where a force acts and in its direction; name the two with "
        "--driving-point OUTPUT,INPUT."
    )


def frequency_text(mode: Mode) -> str:
    """Frequency in Hz, with its 95 % interval where that is known."""
    if mode.kind == "nyquist" or not math.isfinite(mode.frequency_std):
        return hertz(shown_frequency(mode))
    return with_interval(mode.frequency, NINETY_FIVE * mode.frequency_std)
