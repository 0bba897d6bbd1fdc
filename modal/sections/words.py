"""The plain words for what the numbers of a result mean, and the columns of its mode table.

Each sentence comes from a rule and says no more than the rule carries. The report, the Markdown page and the terminal
all take their words from here, so that they cannot disagree.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from modal.identification.result import Identification
from modal.identification.words import Judgement, trust_of
from modal.modes.extraction import NYQUIST_MARGIN
from modal.modes.mode import Mode
from modal.verdict.judgement import DOUBTED, FOUND_AGAIN, LEAST_PART, SYSTEM_FROM
from modal.verdict.probability import SPREAD
from modal.verdict.ring_down import RINGS
from modal.wording.text import (
    GOOD_FIT,
    IN_TIME,
    LEAST_FIT,
    MOST_NAMED,
    NONLINEAR,
    WITH_LEVEL,
    counted,
    hertz,
    listed,
    shorten,
)
from okid.errors import visible

if TYPE_CHECKING:
    from modal.acceptance.check import LimitOutcome
    from modal.preparation.channel import Finding
    from modal.quality import DataQuality


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


def next_sentences(result: Identification, quality: "DataQuality | None" = None) -> tuple[str, ...]:
    """What to do first, by the rules of `modal.identification.words.trust_of`: a later step waits for the earlier one.

    Data that are bad are mended before anything is measured again or quoted; without a mode there is nothing to quote.
    """
    if bad := _bad(result, quality):
        what = f"{bad[0].what}, {visible(bad[0].where)}"
        return (f"Mend or replace the data ({what}) and identify again; until then all modes are provisional.",)
    if not result.modes.system:
        if any(one.what == RINGS for one in result.choices):
            return ("Quote no damping: each level has its own; `modal-report gap` finds what a linear model lacks.",)
        return ("Quote nothing; measure longer, drive harder or in a broader band, then identify again.",)
    said = []
    if result.warnings:
        what = "the warning" if len(result.warnings) == 1 else f"the {counted(len(result.warnings))} warnings"
        said.append(f"Read {what} before you quote a number.")
    said += _for_the_damping(result)
    if not said:
        said.append("You can quote these modes, with their 95 % intervals (±).")
    if any(_more_may_settle(mode, result) for mode in result.modes):
        more = "A second record of this test, identified together with it," if result.records else "More averages"
        said.append(f"{more} may settle the doubtful poles.")
    return (*said, *_for_the_forces(result))


def _bad(result: Identification, quality: "DataQuality | None") -> "list[Finding]":
    """The faults that spoil what the modes were identified from; a dead output is left out and spoils nothing."""
    used = {*result.channels.input_names, *result.channels.output_names}
    found = () if quality is None else quality.findings
    return [one for one in found if one.level == "bad" and (not one.channels or used & set(one.channels))]


def judgement_of(result: Identification, quality: "DataQuality | None") -> Judgement:
    """What `trust_of` says, and no more than care where the data are to be mended before anything is quoted."""
    judgement = trust_of(result)
    if judgement.trust != "carried" or not _bad(result, quality):
        return judgement
    return replace(judgement, trust="with care", label="Use with care")


def _more_may_settle(mode: Mode, result: Identification) -> bool:
    """Whether a doubtful pole may be a vibration mode: below the Nyquist frequency, and near none of its images."""
    nyquist = 0.5 / result.modes.dt
    return mode.verdict == "doubtful" and mode.kind == "oscillatory" and mode.frequency < (1 - NYQUIST_MARGIN) * nyquist


def _for_the_damping(result: Identification) -> tuple[str, ...]:
    """How much more data the damping that must not be quoted takes: deviations fall with the root of the amount."""
    unresolved = [mode for mode in result.modes.system if not mode.damping_resolved and mode.kind == "oscillatory"]
    spreads = [mode.damping_ratio_std / mode.damping_ratio for mode in unresolved]
    if not spreads or not all(spread > SPREAD for spread in spreads):  # not known, or another reason than its spread
        return ()
    times = math.ceil((max(spreads) / SPREAD) ** 2)
    which = listed([hertz(mode.frequency) for mode in unresolved[:MOST_NAMED]])
    more = " and others" if len(unresolved) > MOST_NAMED else ""
    changes = [mode.reason for mode in unresolved]
    if any(words.startswith(NONLINEAR) for words in result.warnings) or any(WITH_LEVEL in words for words in changes):
        return (f"For the damping at {which} Hz{more} keep to one level of motion: each has its own.",)
    if any(IN_TIME in words for words in changes):
        return (f"For the damping at {which} Hz{more} identify early and late parts by themselves: each has its own.",)
    if times > MOST_TIMES:
        return (f"For the damping at {which} Hz{more} drive harder there or measure it better, not only longer.",)
    amount = {"response": "as many averages", "decay": "as many decays", "transient": "as many blows"}
    measure = amount.get(result.record_kind or "", "as long a record")
    return (f"For the damping at {which} Hz{more} measure about {counted(times)} times {measure}.",)


def _for_the_forces(result: Identification) -> tuple[str, ...]:
    """What a measured force would add where none was measured, or where those measured explain little."""
    if not result.channels.n_inputs or result.record_kind == "decay":  # whose inputs are the releases
        return ("For modal masses and frequency responses measure a force as well.",)
    if result.response is None and result.fit.mean < LEAST_FIT:
        return ("Measure what else drives it, where you can.",)
    return ()


def remark_of(mode: Mode) -> str:
    """What the reason says besides how well the mode was found again, where the shares of that are known."""
    parts = mode.reason.split("; ")
    return "; ".join(part for part in parts if not (mode.reappears and part.startswith(FOUND_AGAIN)))


def data_sentences(result: Identification) -> tuple[str, ...]:
    """What kind of record it is, unless driven, and what the inputs cannot show, as far as no warning says it.

    Where there are none, a warning or the kind says so.
    """
    told = [one for one in result.choices if one.what == "record kind" and one.value != "driven"]
    kind = tuple(f"Record kind: {one.value} ({one.reason})." for one in told)
    messages = () if result.excitation is None or not result.channels.n_inputs else result.excitation.messages
    return (*kind, *(message for message in messages if message not in result.warnings))


MOST_TIMES = 12
"""Advise so many times as much data at most: beyond a dozen nobody measures on, and something else must change."""


def limits_sentence(outcomes: "Sequence[LimitOutcome]") -> str:
    """How many limits are met, and which are not; "" where no limit was set."""
    if not outcomes:
        return ""
    missed = [one for one in outcomes if one.state == "not met"]
    unknown = [one for one in outcomes if one.state == "cannot be told"]
    if not missed and not unknown:
        return (
            "The acceptance limit is met." if len(outcomes) == 1 else f"All {len(outcomes)} acceptance limits are met."
        )
    parts = [f"Of {len(outcomes)} acceptance limit{'s' * (len(outcomes) > 1)}"]
    if missed:
        parts.append(f" {len(missed)} {'is' if len(missed) == 1 else 'are'} not met ({_names(missed)})")
    if unknown:
        also = " and" if missed else ""
        parts.append(f"{also} {len(unknown)} cannot be told ({_names(unknown)})")
    return "".join(parts) + "."


def limits_short(outcomes: "Sequence[LimitOutcome]") -> str:
    """For the row of facts, e.g. "2 of 3"."""
    return f"{sum(one.state == 'met' for one in outcomes)} of {len(outcomes)}"


def limits_class(state: str) -> str:
    """The colour that a state has in the tables: that of a system mode, a doubtful one, or a fault."""
    return {"met": "system", "cannot be told": "doubtful"}.get(state, "fault")


def _names(outcomes: "Sequence[LimitOutcome]") -> str:
    names = [shorten(one.what, 60) for one in outcomes[:MOST_NAMED]]  # the table has the whole of it
    rest = f" and {len(outcomes) - MOST_NAMED} more" if len(outcomes) > MOST_NAMED else ""
    return ", ".join(names) + rest


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
