"""The columns of the mode table: what each number is called, what it means, and from where on it speaks for a mode."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from modal.modes.mode import Mode
from modal.verdict.judgement import DOUBTED, LEAST_PART, SYSTEM_FROM

__all__ = ["INDICATORS", "IndicatorColumn", "shown"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class IndicatorColumn:
    """One indicator.

    Attributes:
        key: attribute of `Mode`.
        label: heading.
        limit: usual limit, None where there is none worth the name.
        better: "high" or "low" values speak for the mode; "" for neither.
        meaning: one sentence.
        format: of a finite value.
    """

    key: str
    label: str
    limit: float | None
    better: str
    meaning: str
    format: Callable[[float], str] = "{:.2f}".format

    def value(self, mode: Mode) -> float:
        """The number itself."""
        return float(getattr(mode, self.key))

    def text(self, mode: Mode) -> str:
        """The number as it is shown; a dash for nan."""
        return shown(self.value(mode), self.format)

    def beyond(self, mode: Mode) -> bool:
        """True when the number is known and stands on the wrong side of its usual limit."""
        value = self.value(mode)
        if self.limit is None or not math.isfinite(value):
            return False
        return value < self.limit if self.better == "high" else value > self.limit


def shown(value: float, form: Callable[[float], str] = "{:.3g}".format) -> str:
    """A number as text, a dash for nan."""
    return form(value) if math.isfinite(value) else "–"


INDICATORS = (
    IndicatorColumn(
        key="repeatability",
        label="repeatability",
        limit=None,
        better="high",
        meaning="Overlap with the same mode found again from other data, another observer and other orders, their "
        f"mean; of a mode of the system none of the three is below {LEAST_PART}.",
    ),
    IndicatorColumn(
        key="probability",
        label="probability",
        limit=SYSTEM_FROM,
        better="high",
        meaning="That the mode belongs to the system, from the repeatability and from how far its answer to the "
        f"inputs stands above chance, at most {DOUBTED} where it is in doubt what drives it. A mode of the system has "
        "this much, and no doubt against it.",
    ),
    IndicatorColumn(
        key="emac_output",
        label="EMAC out",
        limit=0.5,
        better="high",
        meaning="Extended modal amplitude coherence over outputs: does the mode still follow its pole at the end "
        "of the Hankel matrix?",
    ),
    IndicatorColumn(key="emac_input", label="EMAC in", limit=None, better="high", meaning="The same over inputs."),
    IndicatorColumn(
        key="emac",
        label="EMAC",
        limit=0.35,
        better="high",
        meaning="Product of the two; low for modes that die out early.",
    ),
    IndicatorColumn(
        key="amplitude_coherence",
        label="amplitude coherence",
        limit=0.95,
        better="high",
        meaning="Juang and Pappa: agreement of the mode's history in the data with its own exponential. Close to 1 for "
        "noise that decays quickly as well.",
    ),
    IndicatorColumn(
        key="phase_collinearity",
        label="phase collinearity",
        limit=None,
        better="high",
        meaning="MPC: 1 for a real shape. Says little with three sensors or fewer; complex modes score low.",
    ),
    IndicatorColumn(
        key="cmi",
        label="CMI",
        limit=0.1,
        better="high",
        meaning="Consistent-mode indicator: EMAC times phase collinearity; a ranking rather than a limit.",
    ),
    IndicatorColumn(
        key="mpd",
        label="phase deviation",
        limit=None,
        better="low",
        meaning="Mean deviation of the shape's phase from one line.",
        format="{:.0f}°".format,
    ),
    IndicatorColumn(
        key="msv",
        label="MSV",
        limit=None,
        better="high",
        meaning="Mode singular value over the largest: how strongly the mode contributes to the pulse response.",
        format="{:.2g}".format,
    ),
)
