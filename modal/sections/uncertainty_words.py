"""What the intervals of a result mean and what they rest on, in words that its numbers carry."""

import math

import numpy as np

from modal.identification.result import Identification
from modal.wording.numbers import GOOD_FIT, fit_text

__all__ = ["has_intervals", "uncertainty_sentences"]

NORMAL_FACTOR = 1.96
"""Standard deviations on either side of a value that make its 95 % interval, as the reports show it."""

FEW_FACTOR = 2.1
"""Student's factor of 95 % above which the degrees of freedom are called few (17 or fewer)."""

WHITE_RATIO = 2.0
"""Whiteness statistic over its degrees of freedom above which residuals are not white."""

_RESTS_ON = {
    "output error": (
        "They rest on how sharply the free-run error of the refined model rises when a parameter is moved, and on the "
        "noise that this model leaves."
    ),
    "propagation": (
        "They rest on the noise that the observer leaves, carried to first order through the observer, the Markov "
        "parameters and the realisation to the modes."
    ),
}


def has_intervals(result: Identification) -> bool:
    """True when the standard deviation of at least one mode's frequency is known."""
    return bool(np.isfinite([mode.frequency_std for mode in result.modes]).any())


def uncertainty_sentences(result: Identification) -> tuple[str, ...]:
    """What the intervals are, what they rest on, and what they leave out; one sentence where there are none."""
    known = result.uncertainty
    if known is None or not has_intervals(result):
        return ("No standard deviations are known for this result, so no interval is given.",)
    meaning = (
        f"± is half of a 95 % interval, {NORMAL_FACTOR} standard deviations: if the test were repeated with other "
        "noise, about 95 of 100 such intervals would hold the true value, as long as the model has the form of the "
        "system."
    )
    sentences = [meaning, _RESTS_ON[known.method]]
    factor = known.interval_factor(0.95)
    if factor > FEW_FACTOR:
        sentences.append(
            f"The noise is known from {known.degrees_of_freedom:.0f} degrees of freedom only: widen each interval by "
            f"{100 * (factor / NORMAL_FACTOR - 1):.0f} %."
        )
    elif math.isfinite(known.degrees_of_freedom):
        sentences.append(f"The noise is known from {known.degrees_of_freedom:,.0f} degrees of freedom.")
    sentences.append(_left_out(result))
    ratio = math.nan if result.innovations is None else result.innovations.whiteness_ratio
    if ratio > WHITE_RATIO:
        sentences.append(
            f"The one-step errors of the model are not white (statistic {ratio:.2g} times its degrees of freedom, "
            "where 1 is white): the noise has a memory, or the model lacks something."
        )
    return tuple(sentences)


def _left_out(result: Identification) -> str:
    fit = result.fit.mean
    calibration = "the calibration of the sensors, the clock, and what the article does on another day"
    if not math.isfinite(fit):
        return (
            "They leave out the error of the model itself, and no fit on held-out data tells how large that is. They "
            f"leave out {calibration} as well."
        )
    if fit < GOOD_FIT:
        return (
            f"They leave out the error of the model itself: its fit on held-out rows is {fit_text(fit)}, below "
            f"{GOOD_FIT}. As far as the rest is noise, they hold; as far as the model lacks something, they are too "
            f"narrow. They leave out {calibration} as well."
        )
    return f"They leave out {calibration}."
