"""What the numbers mean, in plain words: each sentence comes from a rule, and says no more than the rule carries.

The report, the Markdown page and the terminal all take their words from here, so that they cannot disagree.
"""

import math

from modal.identification.result import Identification
from modal.wording.numbers import GOOD_FIT, LEAST_FIT, counted, hertz

__all__ = [
    "data_sentences",
    "fit_word",
    "modes_headline",
]


def modes_headline(result: Identification) -> str:
    """How many modes there are, in one sentence; an overdamped pole is no vibration mode and is counted apart."""
    system = result.modes.system
    modes = [mode for mode in system if mode.kind == "oscillatory"]
    n_others = len(system) - len(modes)
    others = f"{counted(n_others)} overdamped pole{'s' if n_others > 1 else ''}"
    if not system:
        return "No mode of the system was found."
    if not modes:
        return f"No vibration mode was found, but {others} of the system."
    also = f", and {others}" if n_others else ""
    if len(modes) == 1:
        return f"One mode of the system was found, at {hertz(modes[0].frequency)} Hz{also}."
    return (
        f"{counted(len(modes)).capitalize()} modes of the system were found, "
        f"between {hertz(modes[0].frequency)} and {hertz(modes[-1].frequency)} Hz{also}."
    )


def fit_word(fit: float) -> str:
    """One word for a fit: good, fair, poor or not known."""
    if not math.isfinite(fit):
        return "not known"
    return "good" if fit >= GOOD_FIT else "fair" if fit >= LEAST_FIT else "poor"


def data_sentences(result: Identification) -> tuple[str, ...]:
    """What the inputs cannot show, as far as it is not among the warnings already."""
    return tuple(message for message in result.excitation.messages if message not in result.warnings)
