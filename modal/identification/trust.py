"""How far a result can be trusted, in plain words: each sentence comes from a rule, and says no more than it carries.

The report, the recording and the terminal all take these words, and a limit of acceptance is weighed by them, so that
they cannot disagree.
"""

import math
from dataclasses import dataclass
from typing import Literal

from modal.identification.result import Identification
from modal.modes.mode import Mode
from modal.wording.names import shorten
from modal.wording.numbers import GOOD_FIT, LEAST_FIT, counted, fit_text, hertz, ratio_text, with_interval

__all__ = [
    "Judgement",
    "caution_sentence",
    "damping_sentence",
    "damping_shown",
    "damping_text",
    "doubtful_sentence",
    "fit_sentence",
    "frequency_text",
    "trust_of",
]

MOST_CAUTION = 0.3
"""Say that the classical indicators test the observer rather than the data where n / (p q) is greater."""


LONGEST_NAME = 40
"""Write at most so many letters of a channel name into a sentence; the tables have the whole of it."""


Trust = Literal["carried", "with care", "not carried"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Judgement:
    """How far the result as a whole can be trusted.

    Attributes:
        trust: "not carried" when the fit is below 0.5 or no mode belongs to the system; "with care" when it is
            between 0.5 and 0.8, a fit is not known, or there are warnings; otherwise "carried".
        label: the same in two or three words.
        reasons: sentences, the weightiest first.
    """

    trust: Trust
    label: str
    reasons: tuple[str, ...]


def trust_of(result: Identification) -> Judgement:
    """Whether the data carry the result; the command's exit status is 1 exactly when they do not."""
    fit = result.fit.mean
    n_system = len(result.modes.system)
    reasons = [fit_sentence(result)]
    if not n_system:
        reasons.append("No pole of the model is accepted as a mode of the system, so there is nothing to quote.")
    if n_system and (damping := damping_sentence(result)):
        reasons.append(damping)
    reasons += [sentence for sentence in (doubtful_sentence(result), caution_sentence(result)) if sentence]
    if fit < LEAST_FIT or not n_system:
        return Judgement(trust="not carried", label="The data do not carry it", reasons=tuple(reasons))
    if result.warnings or not fit >= GOOD_FIT:
        return Judgement(trust="with care", label="To be used with care", reasons=tuple(reasons))
    return Judgement(trust="carried", label="The data carry it", reasons=tuple(reasons))


def fit_sentence(result: Identification) -> str:
    """What the cross-validated fit says about the model."""
    fit = result.fit.mean
    if not math.isfinite(fit):
        return "No fit on held-out data is known, so nothing here has been tested against data the model had not seen."
    if fit < LEAST_FIT:
        return (
            f"The model does not explain the record: its fit on rows that it was not fitted to is {fit_text(fit)}, "
            f"below {LEAST_FIT}, so no mode of it is certain."
        )
    names = result.records[0].output_names
    fits = result.fit.cross_validated
    worst = int(fits.argmin())
    word = "well" if fit >= GOOD_FIT else "in the main"
    how = "Fed with the inputs alone" if result.records[0].n_inputs else "No input was measured; one step ahead"
    least, mean = fit_text(fits[worst]), fit_text(fit)
    sentence = f"{how}, the model explains the outputs {word}: its fit on rows that it was not fitted to is {mean}"
    return sentence + (f" (least for {shorten(names[worst], LONGEST_NAME)}: {least})." if least != mean else ".")


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
        return f"The classical indicators are not known: {result.modes.indicators_missing}"
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
    if mode.kind == "real" or not mode.damping_resolved:
        return ratio_text(mode.damping_ratio)
    return ratio_text(mode.damping_ratio, mode.damping_ratio_std)


def frequency_text(mode: Mode) -> str:
    """Frequency in Hz, with its 95 % interval where that is known."""
    if not math.isfinite(mode.frequency_std):
        return hertz(mode.frequency)
    return with_interval(mode.frequency, 1.96 * mode.frequency_std)
