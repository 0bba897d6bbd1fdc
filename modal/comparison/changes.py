"""What changed between two results: matched modes, shifts against their intervals, new and lost modes, other settings.

The standard deviations of two independent results add in squares. A shift d of standard deviation s is tested by
Student's t with the degrees of freedom of both (Welch-Satterthwaite). Twenty modes make sixty tests, of which three
would "find" something in nothing; so the verdict "beyond chance" is Holm's: over all tests of the comparison together,
it is wrong in at most 5 % of comparisons of a thing with itself. A shift outside its own interval that does not pass is
said to be just that. One of the tests is of the frequencies of all matched modes together, as `modal.track` tests them:
what softens a structure moves many modes a little, and none need be remarkable by itself. Errors of different modes of
one result count as independent. All this asks whether a mode is where it was, so a pole that may itself be no mode, by
its own doubts and not those of the data, is matched and shown but not tested, as it is neither lost nor new.

A shape of complex components with standard deviations has no known correlation between these. The test takes the worst
one: with the squared distance Q of two shapes after the best complex scaling and the sum T of the variances, P(Q > q)
is at most P(chi^2_1 > q / T) where q / T > 1.54, whatever the correlation. It cannot cry wolf; it may miss.

References:
    Holm, "A simple sequentially rejective multiple test procedure", Scandinavian Journal of Statistics 6(2), 1979,
    65-70 (www.jstor.org/stable/4615733).
    Hotelling, The Annals of Mathematical Statistics 2(3), 1931, doi 10.1214/aoms/1177732979.
    Welch, Biometrika 34, 1947, doi 10.1093/biomet/34.1-2.28.
    Szekely, Bakirov, "Extremal probabilities for Gaussian quadratic forms", Probability Theory and Related Fields 126,
    2003, doi 10.1007/s00440-003-0262-6 (the bound on Q).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy

from modal.comparison.shifts import (
    LEVEL,
    ChannelName,
    ResultSummary,
    Shift,
    chance_together,
    damping_shift,
    frequency_shift,
    match_modes,
    of_modes,
    shape_shift,
    shared_shapes,
    summary_of,
    with_verdicts,
)
from modal.identification.result import Identification
from modal.modes.mode import Mode, numbered
from modal.wording.text import fit_text
from okid.display import Displayed
from okid.errors import InvalidDataError


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Difference(Displayed):
    """Something that is not the same in the two results.

    Attributes:
        kind: "channel", "unit", "sampling", "setting" or "fit".
        what: it is, e.g. "output tip" or "model order".
        before: in the first result, "" where it is not there.
        after: in the second.
    """

    kind: Literal["channel", "unit", "sampling", "setting", "fit"]
    what: str
    before: str
    after: str


def differences_of(before: ResultSummary, after: ResultSummary) -> tuple[Difference, ...]:
    """Everything that differs but the modes, in this order: channels, units, sampling, settings, fit."""
    found = [*_channels("input", before.inputs, after.inputs), *_channels("output", before.outputs, after.outputs)]
    if not math.isclose(before.dt, after.dt):
        found.append(_difference("sampling", "time step", f"{before.dt:.6g} s", f"{after.dt:.6g} s"))
    lengths = [", ".join(map(str, one.n_samples)) for one in (before, after)]
    if lengths[0] != lengths[1]:
        found.append(_difference("sampling", "samples", *lengths))
    settings = [{choice.what: choice.value for choice in one.choices} for one in (before, after)]
    for what in dict.fromkeys((*settings[0], *settings[1])):
        values = [one.get(what, "") for one in settings]
        if values[0] != values[1]:
            found.append(_difference("setting", what, *values))
    fits = [fit_text(one.fit) for one in (before, after)]
    if fits[0] != fits[1]:
        found.append(_difference("fit", "cross-validated fit", *fits))
    if before.trust != after.trust:
        found.append(_difference("fit", "trust", before.trust, after.trust))
    return tuple(found)


def _channels(role: str, before: Sequence[ChannelName], after: Sequence[ChannelName]) -> list[Difference]:
    units = [{channel.name: channel.unit for channel in one} for one in (before, after)]
    found = []
    for name in dict.fromkeys((*units[0], *units[1])):
        there = [name in one for one in units]
        if all(there) and units[0][name] != units[1][name]:
            found.append(_difference("unit", f"{role} {name}", units[0][name], units[1][name]))
        elif not all(there):
            words = ["measured" if one else "" for one in there]
            found.append(_difference("channel", f"{role} {name}", *words))
    return found


def _difference(
    kind: Literal["channel", "unit", "sampling", "setting", "fit"], what: str, before: str, after: str
) -> Difference:
    return Difference(kind=kind, what=what, before=before, after=after)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class ModePair(Displayed):
    """A mode that both results have.

    Attributes:
        number_before: its number on the pages of the first result.
        number_after: the same of the second.
        before: the mode of the first result.
        after: the mode of the second.
        assurance: of the two shapes over the outputs that both results have; nan with fewer than two.
        frequency: its shift.
        damping: its shift.
        shape: its change; before and after are 1 and the assurance.
    """

    number_before: int
    number_after: int
    before: Mode
    after: Mode
    assurance: float
    frequency: Shift
    damping: Shift
    shape: Shift

    @property
    def shifts(self) -> tuple[Shift, Shift, Shift]:
        """Frequency, damping ratio and shape."""
        return self.frequency, self.damping, self.shape

    @property
    def changed(self) -> bool:
        """Whether anything of it shifted beyond chance."""
        return any(shift.verdict == "beyond chance" for shift in self.shifts)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Unmatched(Displayed):
    """A mode, or a doubtful pole, that only one of the results has.

    Attributes:
        number: on the pages of its result.
        mode: itself.
        near: the pole of the other result that comes closest to it, a noise pole included, if it is within 5 % of the
            frequency and has no other partner: the mode may be there, but not as one that can be believed.
    """

    number: int
    mode: Mode
    near: Mode | None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Comparison(Displayed):
    """What changed between two results.

    Attributes:
        before: the first result.
        after: the second.
        pairs: modes of both, by frequency.
        lost: modes of the first result alone, doubtful poles included.
        new: modes of the second result alone, doubtful poles included.
        differences: channels, units, sampling and settings that are not the same.
        same_data: whether both come from the same measured data, so that their errors are not independent; None where
            that is not known.
        n_tests: tests of shifts, that of all frequencies together among them.
        together: chance of frequency shifts so large in all modes together where nothing changed; nan with fewer than
            two that are known.
        moved_together: whether that is beyond chance.
        level: chance of a false "beyond chance" in the whole comparison.
    """

    before: ResultSummary
    after: ResultSummary
    pairs: tuple[ModePair, ...]
    lost: tuple[Unmatched, ...]
    new: tuple[Unmatched, ...]
    differences: tuple[Difference, ...]
    same_data: bool | None
    n_tests: int
    together: float = math.nan
    moved_together: bool = False
    level: float = LEVEL

    @property
    def changed(self) -> bool:
        """Whether matched modes shifted beyond chance, one or all together, or a mode of the system is lost or new."""
        alone = (*self.lost, *self.new)
        shifted = self.moved_together or any(pair.changed for pair in self.pairs)
        return shifted or any(one.mode.verdict == "system" for one in alone)


def compare_results(before: Identification | ResultSummary, after: Identification | ResultSummary) -> Comparison:
    """Match the modes of two results and test what shifted.

    Args:
        before: a result in memory, or read by `modal.comparison.shifts.read_result`.
        after: the other one; shifts are those from `before` to `after`.

    Raises:
        InvalidDataError: something else.

    Example:
        >>> from modal.modes.mode import Choice
        >>> empty = ResultSummary(name="a", modes=(), inputs=(), outputs=(), dt=0.1, n_samples=(9,), choices=(), fit=0,
        ...                       trust="not carried", degrees_of_freedom=float("inf"), data=())
        >>> compare_results(empty, empty).changed
        False
    """
    first, second = _summary(before), _summary(after)
    matching = match_modes(first, second)
    shapes = shared_shapes(first, second)
    numbers = [{id(mode): number for number, mode in numbered(one.modes)} for one in (first, second)]
    pairs = []
    for i, j in matching.pairs:
        one, other = first.modes[i], second.modes[j]
        freedom = first.degrees_of_freedom, second.degrees_of_freedom
        found = (
            frequency_shift(one, other, freedom),
            damping_shift(one, other, freedom),
            shape_shift(first, second, (i, j), shapes, float(matching.assurance[i, j])),
        )
        frequency, damping, shape = of_modes(found, one, other)
        pairs.append(
            ModePair(
                number_before=numbers[0][id(one)],
                number_after=numbers[1][id(other)],
                before=one,
                after=other,
                assurance=float(matching.assurance[i, j]),
                frequency=frequency,
                damping=damping,
                shape=shape,
            )
        )
    together = _together([pair.frequency.p_value for pair in pairs])
    judged, moved = with_verdicts([pair.shifts for pair in pairs], together, level=LEVEL)
    return Comparison(
        before=first,
        after=second,
        pairs=tuple(
            replace(pair, frequency=shifts[0], damping=shifts[1], shape=shifts[2])
            for pair, shifts in zip(pairs, judged, strict=True)
        ),
        lost=_alone(first, matching.lost, second, {j for _, j in matching.pairs}),
        new=_alone(second, matching.new, first, {i for i, _ in matching.pairs}),
        differences=differences_of(first, second),
        same_data=_same_data(first.data, second.data),
        n_tests=sum(map(math.isfinite, [together, *(shift.p_value for pair in pairs for shift in pair.shifts)])),
        together=together,
        moved_together=moved,
    )


def _together(p_values: Sequence[float]) -> float:
    """Chance of all shifts together; each counts as the normal deviation that is as rare, whatever its freedom."""
    known = np.array([p for p in p_values if math.isfinite(p)])
    if known.size < 2:
        return math.nan
    scores = scipy.special.ndtri(np.maximum(known, np.finfo(np.float64).tiny) / 2.0)
    return chance_together(scores, np.eye(known.size), math.inf)


def _same_data(first: Sequence[str], second: Sequence[str]) -> bool | None:
    """Whether hashes are shared; None where there are none of one kind (of files, of samples) in both."""
    kinds = [{text.partition(" ")[0] for text in one} for one in (first, second)]
    return bool(set(first) & set(second)) if kinds[0] & kinds[1] else None


def _summary(result: Identification | ResultSummary) -> ResultSummary:
    if isinstance(result, ResultSummary):
        return result
    if isinstance(result, Identification):
        return summary_of(result)
    raise InvalidDataError(
        f"compare_results takes two results of modal.identify, but was given {type(result).__name__}; read a folder or "
        "file with modal.comparison.shifts.read_result."
    )


def _alone(
    own: ResultSummary, indices: tuple[int, ...], other: ResultSummary, taken: set[int]
) -> tuple[Unmatched, ...]:
    numbers = {id(mode): number for number, mode in numbered(own.modes)}
    free = [mode for index, mode in enumerate(other.modes) if index not in taken]
    return tuple(
        Unmatched(number=numbers[id(own.modes[index])], mode=own.modes[index], near=_nearest(own.modes[index], free))
        for index in indices
    )


def _nearest(mode: Mode, others: list[Mode]) -> Mode | None:
    same = [one for one in others if one.kind == mode.kind]
    best = min(same, key=lambda one: abs(one.pole - mode.pole), default=None)
    close = (
        best is not None and abs(best.frequency - mode.frequency) <= 0.05 * mode.frequency
    )  # as near as what is left of a lost mode
    return best if close else None
