"""System or noise: a mode is judged by whether it is found again, and told why in words.

After OKID the Markov parameters *are* a sum of exponentials, so the classical indicators test how well a mode repeats
the observer, not the data. Repeatability asks the data: identify again with half of them, with another observer order
and ridge, with other model orders, and take the mean overlap of the mode's pulse response with its continuation
(`modal.modes.shape_comparison`). The three kinds of change have equal weight, however many runs each has.

Found again is not enough: hum is, and so is what describes coloured noise. `modal.verdict.probability` weighs r
together with how much of the outputs the mode's answer to the inputs explains.

A line that the input does not drive (hum), and a pole in the edge of a decimation filter, are never more than doubtful.

A structure that is not quite linear, or whose resonance wanders during the record, is fitted best by two or three poles
side by side with the same shape. How the response is shared among them is chance, so none of them is found again alone;
their sum is. Modes within each other's half-power bandwidth that have the same shape form a group, led by the one with
the most energy, and the group's summed pulse response is compared with the sum of the same band in the other runs.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from modal.estimation.responses.force_dips import NARROW
from modal.modes.extraction import NOT_JUDGED, cannot_be_a_mode, remarks
from modal.modes.mode import Choice, ModalModel, Mode, Verdict
from modal.modes.shape_comparison import (
    Pulses,
    Repeatability,
    assurance,
    energies,
    inner_products,
    pulses,
    repeatability,
)
from modal.verdict.constancy import sums_of_stronger
from modal.verdict.excitation import BetweenLines, beyond_doubt, line_doubt, undriven_doubt
from modal.verdict.probability import (
    HARDLY_DRIVEN,
    clipping_doubt,
    damping_doubt,
    drift_doubt,
    edge_doubt,
    excitation_doubt,
    f_ratio,
    folded_doubt,
    free_doubt,
    heavy_doubt,
    peak_doubt,
    pole_doubts,
    poor_fit_doubt,
    probability,
    unanswered_doubt,
    unexcited_doubt,
)
from modal.wording.text import NINETY_FIVE, hertz, listed, times, with_interval
from okid.arrays import BoolArray, FloatArray
from okid.excitation import Excitation

LEAST_BAND = 0.01
"""Poles closer than this share of the frequency belong to one resonance whatever their damping."""
LARGEST_BAND = 0.05
"""Poles further apart than this never do: a heavily damped pole would swallow its neighbours."""
SAME_SHAPE = 0.95


def groups(modes: Sequence[Mode], reference: Pulses, *, n_steps: int) -> dict[int, tuple[int, ...]]:
    """Leader and members (leader included) of each group of at least two oscillatory modes.

    Args:
        modes: of one model.
        reference: their pulse responses.
        n_steps: length of the pulse responses in samples.
    """
    found: dict[int, tuple[int, ...]] = {}
    free = {i for i, mode in enumerate(modes) if mode.kind == "oscillatory"}
    size = np.nan_to_num(energies(reference, n_steps=n_steps))
    for leader in sorted(free, key=lambda i: -size[i]):
        if leader not in free:
            continue
        near = _in_band(modes[leader], reference, leader, modes, reference)
        members = tuple(i for i in range(len(modes)) if near[i] and i in free)
        free -= set(members)
        if len(members) > 1:
            found[leader] = members
    return found


def group_overlaps(
    leader: int,
    members: Sequence[int],
    modes: Sequence[Mode],
    reference: Pulses,
    runs: Sequence[tuple[Sequence[Mode], Pulses]],
    *,
    n_steps: int,
) -> FloatArray:
    """(n_runs,) overlap of the group's summed pulse response with that of the same band and shape in each run."""
    group = np.array(members, dtype=np.intp)
    own = inner_products(reference, reference, n_steps=n_steps)[np.ix_(group, group)].sum()
    overlaps = np.zeros(len(runs))
    for i, (again, pulses_again) in enumerate(runs):
        if not again:
            continue
        near = np.flatnonzero(_in_band(modes[leader], reference, leader, again, pulses_again))
        theirs = inner_products(pulses_again, pulses_again, n_steps=n_steps)[np.ix_(near, near)].sum()
        both = inner_products(reference, pulses_again, n_steps=n_steps)[np.ix_(group, near)].sum()
        largest = max(own, theirs)
        overlaps[i] = np.clip(np.nan_to_num(both / largest), 0.0, 1.0) if largest > 0 else 0.0
    return overlaps


def _in_band(mode: Mode, reference: Pulses, index: int, others: Sequence[Mode], their_pulses: Pulses) -> BoolArray:
    """Which of the others lie within the half-power bandwidth of the mode (or it in theirs), with its shape."""
    frequency = np.array([other.frequency for other in others])
    damping = np.array([max(0.0, other.damping_ratio) for other in others])
    oscillatory = np.array([other.kind == "oscillatory" for other in others])
    band = np.clip(0.5 * (damping + max(0.0, mode.damping_ratio)), LEAST_BAND, LARGEST_BAND)
    same = assurance(reference.outputs[:, [index]], their_pulses.outputs)[0] >= SAME_SHAPE
    near: BoolArray = (np.abs(frequency - mode.frequency) <= band * mode.frequency) & same & oscillatory
    return near


Change = Literal["data", "observer", "lower order", "higher order"]
"""What a rerun changed: the rows it saw, observer order and ridge, or the model order."""

SYSTEM_FROM = 0.8
"""Probability from which a mode is called one of the system."""
NOISE_BELOW = 0.05
DOUBTED = 0.55
"""Largest probability of a pole with a doubt about what drives it: about the share of such poles that were true."""
LEAST_PART = 0.42
"""Overlap that every kind of change must leave of a mode of the system."""
NOT_FOUND_BELOW = 0.1
"""Overlap that counts as not found at all."""
SAME_FREQUENCY = 0.01
CLEARLY_DRIVEN = 10.0 * HARDLY_DRIVEN
"""Say that a half did not drive a mode where its F ratio is below the former and the other half's above this."""

UNEVEN = (
    "Near {where} Hz what does not follow the inputs is {times} what blocks of this length leave of a linear "
    "structure under even forces: the measured forces fall there, as those of shakers do which the structure loads, "
    "their sensors are noisy, other forces act, or it is not linear. Average over longer blocks{or_one}."
)
SCATTERED = (
    "Near {where} Hz what does not follow the inputs is {times} what blocks of this length and the sensors' "
    "noise leave of a linear structure: it is not linear, changed during the test, or other forces act. The modes are "
    "those of this level of force. Test at half of it and compare them."
)
RUNS_ON = (
    "Near {where} Hz what the model leaves of the responses runs on from line to line, as noise does not: it "
    "is not linear there (its answer depends on the level) or changed during the test, or modes are missing."
)

FOUND_AGAIN = "found again: "
"""Begin the reason of a mode of the system with this, before the overlap under each change."""

GROUPS: dict[str, tuple[Change, ...]] = {
    "halves of the data": ("data",),
    "other observer order and ridge": ("observer",),
    "other model orders": ("lower order", "higher order"),
}


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Rerun:
    """The modes found after one change.

    Attributes:
        label: for a reader, e.g. "first half", "observer order 80, ridge 0.01", "order 14".
        change: what was changed.
        modes: what was found.
        gain: (n_modes,) gain of each of them on the rows that this run did not see (`modal.verdict.excitation`), None
            where all rows were used.
        evidence: (n_judged,) F ratio of each mode of the judged model on the rows that this run saw, None where that
            was not asked.
    """

    label: str
    change: Change
    modes: ModalModel
    gain: FloatArray | None = None
    evidence: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Reruns:
    """All reruns, with what makes pulse responses comparable.

    Attributes:
        runs: at least one; usually two of the data, one of the observer, two or more of the order.
        n_steps: length of the pulse responses in samples: Hankel block rows + columns of the judged realisation.
        output_scale: (n_outputs,) standard deviations of the outputs.
        input_scale: (n_inputs,) standard deviations of the inputs.
    """

    runs: tuple[Rerun, ...]
    n_steps: int
    output_scale: FloatArray
    input_scale: FloatArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Answer:
    """Modes as they stand after a question that only records of one kind allow, what to say, and how much less sure."""

    modes: ModalModel
    warnings: tuple[str, ...] = ()
    choices: tuple[Choice, ...] = ()
    times: float = 1.0


def judge(
    model: ModalModel,
    reruns: Reruns,
    *,
    fit: float = np.nan,
    missed: float = np.nan,
    observer_order: int | None = None,
    ridge: float = 0.0,
    refinement_steps: int = 0,
    duration: float = np.nan,
    excitation: Excitation | None = None,
    gain: FloatArray | None = None,
    lines: BetweenLines | None = None,
    beyond: tuple[FloatArray, npt.NDArray[np.intp]] | None = None,
    n_values: int = 0,
    edge: float = np.inf,
    chance: FloatArray | None = None,
    clipped: FloatArray | None = None,
    height: FloatArray | None = None,
    ringing: FloatArray | None = None,
    chance_line: BoolArray | None = None,
    rings_down: bool = False,
    is_table: bool = False,
    ahead: int = 0,
) -> ModalModel:
    """The same modes with repeatability, probability, verdict, damping resolved or not, and the reason in words.

    Rules, in this order: a growing pole and a pole at half the sampling frequency are noise; a mode is "system" for p
    >= 0.8 where no kind of change leaves less than 0.42, "noise" for p < 0.05, else "doubtful". At most doubtful are:
    a second pole within 1 % of a mode's frequency and with its shape, and every mode with a doubt of
    `modal.verdict.probability` or `modal.verdict.excitation`; what is doubtful already is noise where nothing follows
    the inputs. Poles side by side that share one resonance are judged
    together (`modal.verdict.judgement`). A real pole is judged like the others but named as what it is.

    Whether the damping of an oscillatory mode is resolved: see `modal.verdict.probability`.

    Args:
        model: from `modal.extract_modes`.
        reruns: the same identified again.
        fit: of a table, to the responses of the other half of its averages, mean over outputs; nan of records.
        missed: share of what the inputs explain that the model leaves; nan where unknown.
        observer_order: samples that the observer spans; None for measured Markov parameters.
        ridge: of the observer fit.
        refinement_steps: output-error refinement steps made after the observer fit.
        duration: of the longest record [s]; nan where unknown: undamped lines are then not looked for.
        excitation: what the inputs allow; None without inputs.
        gain: (n_modes,) share of the free-run error that each mode removes (`modal.verdict.excitation`); None where
            unknown.
        lines: what inputs of a few lines tell of each mode; None where they are no lines.
        beyond: of `modal.verdict.excitation.beyond_inputs`, None where that was not asked.
        n_values: measured values, rows times outputs, that the gain was taken on.
        edge: frequency [Hz] from which a pole may belong to the filter of a decimated record.
        chance: (n_modes,) how often outputs that know nothing of the inputs follow them as well at each mode; None
            where unknown.
        clipped: (n_modes, n_outputs) share of the power in each mode's band that clipping makes; None where unknown.
        height: (n_modes,) times the power beside it that a mode has without inputs (`modal.verdict.resonance`); None
            where unknown.
        chance_line: (n_modes,) whether inputs explain an undamped line no better than chance; None where not asked.
        ringing: (n_modes,) F ratio of what each mode does when the inputs are over (`modal.verdict.excitation`); None
            where the records are no answers to blows or releases.
        rings_down: whether the records are decays, in which nothing that was measured drives.
        is_table: whether frequency responses were measured, whose lines say nothing of what lies beyond them.
        ahead: samples by which the model looks ahead in its inputs.

    Example:
        >>> mode = Mode(pole=-1 + 9j, kind="oscillatory", frequency=1.44, damping_ratio=0.11,
        ...             shape=np.ones(2), participation=np.ones(1))
        >>> model = ModalModel(modes=(mode,), dt=0.01, indicator_caution=0.1)
        >>> runs = tuple(Rerun(label=half, change="data", modes=model) for half in ("first half", "second half"))
        >>> same = Reruns(runs=runs, n_steps=200, output_scale=np.ones(2), input_scale=np.ones(1))
        >>> [(judged.verdict, judged.reason) for judged in judge(model, same)]
        [('system', 'found again: halves of the data 1.00')]
    """
    if not model.modes:
        return model
    scales = {"output_scale": reruns.output_scale, "input_scale": reruns.input_scale}
    reference = pulses(model.modes, dt=model.dt, **scales)
    again = [pulses(run.modes.modes, dt=model.dt, **scales) for run in reruns.runs]
    found = repeatability(reference, again, n_steps=reruns.n_steps)
    changes = tuple(run.change for run in reruns.runs)
    found, resonance = _with_resonances(found, model, reference, reruns, again)
    parts = _group_means(found.parts, changes)
    r = np.mean(list(parts.values()), axis=0) if parts else np.full(len(model), np.nan)
    primary = _primary(model.modes, reference, r, reruns.n_steps)
    n_states = sum(2 if mode.kind in ("oscillatory", "unstable") and mode.pole.imag else 1 for mode in model.modes)
    modes = []
    made_of = ("",) * len(model) if ringing is None or gain is None else sums_of_stronger(model, gain)
    for i, mode in enumerate(model.modes):
        numbers = {group: float(values[i]) for group, values in parts.items()}
        own_gain = np.nan if gain is None else float(gain[i])
        ratio = f_ratio(mode, own_gain, n_values)
        beside = np.nan if lines is None else f_ratio(mode, float(lines.gain[i]), int(lines.n_values[i]))
        own_band = np.nan if beyond is None else f_ratio(mode, float(beyond[0][i]), int(beyond[1][i]))
        ratio = float(
            np.fmin(np.fmin(ratio, beside), own_band)
        )  # no more certain than the excitation at its frequency allows
        never = cannot_be_a_mode(mode, model.dt)
        p = 0.0 if never else probability(float(r[i]), ratio)
        held_out = _mean_gain(found, reruns, i)
        unanswered = unanswered_doubt(mode, 0.0 if chance is None else float(chance[i]), held_out)
        driven = own_gain if np.isnan(held_out) else held_out
        lucky = rings_down or (chance_line is not None and bool(chance_line[i]))  # a release fits what never ends, too
        line = undriven_doubt(mode, min(driven, 0.0) if lucky else driven, duration, free=rings_down)
        heavy = heavy_doubt(mode) if is_table or ringing is not None else ()
        undriven = (
            *line,
            *edge_doubt(mode, edge),
            *(slow for slow in drift_doubt(mode, model.modes, duration) if rings_down and slow not in line),
            *(() if ringing is None else free_doubt(mode, float(ringing[i]), made_of[i])),
            *heavy,
            *(unexcited_doubt(mode, excitation) or unanswered),
            *line_doubt(lines, beside),
            *beyond_doubt(mode, own_band),
            *(() if clipped is None else clipping_doubt(mode, _shown_share(mode, clipped[i], reruns.output_scale))),
        )
        worst = {
            "halves of the data": _worse_half(reruns, i),
            "other observer order and ridge": "depends on the observer order and ridge",
            "other model orders": _worse_order(found.parts[:, i], changes),
        }
        verdict, words = ("noise", ()) if never else _verdict(p, ratio, numbers, worst)
        words = (*resonance.get(i, ()), *words)
        if primary[i] != i and mode.kind == "oscillatory":
            words = (f"second pole of the mode at {model.modes[primary[i]].frequency:.4g} Hz", *words)
            verdict = "doubtful" if verdict == "system" else verdict
        doubts = (
            *poor_fit_doubt(fit, missed),
            *excitation_doubt(n_states, excitation, own_gain),
            *undriven,
            *pole_doubts(mode, model.dt, ahead),
            *(() if height is None else peak_doubt(mode, float(height[i]), duration)),
            *(folded_doubt(mode, model.dt) if ahead or height is not None else ()),
        )
        deciding: tuple[tuple[str, str], ...] = ()
        if verdict == "system" and doubts:
            verdict, words = "doubtful", (*doubts, *words)
            of_pole = (*line, *pole_doubts(mode, model.dt, ahead))
            deciding = tuple(("pole" if doubt in of_pole else "data", doubt) for doubt in doubts)
        elif verdict == "doubtful" and unanswered:  # neither sure to come back nor an answer: nothing speaks for it
            verdict, words, p = "noise", (*unanswered, *words), min(p, NOISE_BELOW)
        elif verdict == "doubtful":  # true however often it is found again
            words = (*heavy, *words)
        if undriven or (p >= SYSTEM_FROM and verdict != "system"):  # p and verdict say one thing
            p = min(p, DOUBTED)
        doubt = damping_doubt(
            mode,
            span=np.inf if observer_order is None else observer_order * model.dt * mode.frequency,
            ridge=ridge if refinement_steps == 0 else 0.0,
            halves=_damping_again(found, reruns, i, "data"),
            observers=_damping_again(found, reruns, i, "observer"),
        )
        modes.append(
            replace(
                mode,
                repeatability=float(r[i]),
                reappears=tuple(numbers.items()),
                gain=own_gain,
                probability=p,
                verdict=verdict,
                doubts=deciding,
                damping_resolved=not doubt,
                reason="; ".join((*remarks(mode, model.dt), *words, *doubt)),
            )
        )
    return replace(model, modes=_placed(modes))


def _placed(modes: Sequence[Mode]) -> tuple[Mode, ...]:
    """The same, a mode doubtful whose 95 % interval is wider than its resonance and reaches the next mode."""
    system = [mode for mode in modes if mode.verdict == "system" and mode.kind == "oscillatory"]
    placed = []
    for mode in modes:
        half = NINETY_FIVE * mode.frequency_std
        reached = [one for one in system if one is not mode and abs(one.frequency - mode.frequency) <= half]
        if mode not in system or not reached or not half > 2.0 * mode.damping_ratio * mode.frequency:
            placed.append(mode)
            continue
        doubt = (
            f"its interval, {with_interval(mode.frequency, half)} Hz, is wider than its resonance and reaches the mode "
            f"at {hertz(reached[0].frequency)} Hz: which of the two these data show is open"
        )
        doubts, reason, p = (*mode.doubts, ("data", doubt)), f"{doubt}; {mode.reason}", min(mode.probability, DOUBTED)
        placed.append(replace(mode, verdict="doubtful", probability=p, doubts=doubts, reason=reason))
    return tuple(placed)


def blurred(modes: ModalModel, frequencies: FloatArray, what: str) -> ModalModel:
    """The same, resonances doubtful that are narrower than what windows mix, where it is not known what they mixed.

    Args:
        modes: judged.
        frequencies: lines of the table [Hz].
        what: that they are.
    """
    judged = []
    for mode in modes.modes:
        band = 2 * mode.damping_ratio * mode.frequency
        lines = float(np.interp(mode.frequency, frequencies[1:], np.diff(frequencies)))
        narrow = mode.kind == "oscillatory" and band < NARROW * lines
        judged.append(doubted(mode, f"its half-power band of {hertz(band)} Hz is {what}") if narrow else mode)
    return replace(modes, modes=tuple(judged))


def doubted(mode: Mode, reason: str) -> Mode:
    """A mode of the system as a doubtful one, for this reason; any other as it is."""
    if mode.verdict != "system":
        return mode
    return replace(
        mode,
        verdict="doubtful",
        probability=min(mode.probability, DOUBTED),
        damping_resolved=False,
        doubts=(("data", reason),),
        reason=f"{reason}; {mode.reason}",
    )


def told_by_dips(modes: ModalModel) -> ModalModel:
    """What was judged of a force with dips, no pole noise that its deviation places within its own resonance.

    What is identified again knows of no dips: its poles go to them, and a weak mode beside them is lost.
    """
    told = []
    for mode in modes.modes:
        placed = mode.kind == "oscillatory" and mode.frequency_std < mode.damping_ratio * mode.frequency
        again = mode.verdict == "noise" and placed
        reason = f"weak beside the dips of the force, of which what is identified again knows nothing; {mode.reason}"
        doubtful = replace(mode, verdict="doubtful", probability=max(mode.probability, NOISE_BELOW), reason=reason)
        told.append(doubtful if again else mode)
    return replace(modes, modes=tuple(told))


def scattered(
    modes: ModalModel,
    ratios: FloatArray,
    onward: BoolArray,
    beneath: BoolArray,
    frequencies: FloatArray,
    *,
    several_forces: bool,
) -> tuple[ModalModel, list[str]]:
    """The same, modes doubted where coherence is not what blocks leave of a linear structure; and why.

    A resonance that is not linear is described by several poles, of one shape or a broad one beneath: the strongest
    stands. So does what is distorted around it, by poles that answer less than that.

    Args:
        modes: judged.
        ratios: (n_modes,) of `modal.estimation.responses.noise.beyond_blocks`.
        onward: (n_modes,) of `runs_on` there.
        beneath: (n_modes,) of `beneath_distortion` there.
        frequencies: lines of the table [Hz].
        several_forces: whether the table has several references, whose falls are not described.
    """
    system = np.array([mode.verdict == "system" for mode in modes.modes], dtype=np.bool_)
    off, words = system & (ratios != 1), []
    if off.any():
        known = {
            "where": _where(modes, off),
            "times": " to ".join(dict.fromkeys(times(value) for value in (min(ratios[off]), max(ratios[off])))),
        }
        if several_forces or min(ratios[off]) < 1:
            or_one = ", or identify from one reference at a time" if several_forces else ""
            narrow = blurred(modes, frequencies, "narrower than what such forces blur")
            return narrow, [UNEVEN.format(or_one=or_one, **known)]
        words.append(SCATTERED.format(**known))
    if (system & onward).any():
        words.append(RUNS_ON.format(where=_where(modes, system & onward)))
    again = list(modes.modes)
    for i, k in itertools.permutations(np.flatnonzero(system & (off | onward)).tolist(), 2):
        one, other = modes.modes[i], modes.modes[k]
        apart = abs(one.frequency - other.frequency)
        alike = assurance(one.shape[:, np.newaxis], other.shape[:, np.newaxis])[0, 0] >= SAME_SHAPE
        within = apart < one.damping_ratio * one.frequency  # broad, with the other one in it
        if apart < LARGEST_BAND * other.frequency and one.gain < other.gain and (alike or within):
            again[i] = doubted(one, f"second pole of the mode at {hertz(other.frequency)} Hz, which is not linear")
    for i in np.flatnonzero(off & beneath).tolist():
        if again[i].verdict == "system":
            again[i] = doubted(
                again[i],
                "answers less than what does not follow the inputs beside a stronger resonance: may be part of it",
            )
    return replace(modes, modes=tuple(again)), words


def _where(modes: ModalModel, which: BoolArray) -> str:
    return listed([hertz(modes.modes[i].frequency) for i in np.flatnonzero(which)])


def _shown_share(mode: Mode, shares: FloatArray, scale: FloatArray) -> float:
    """Mean over the outputs as the mode shows in each."""
    return float(np.average(shares, weights=np.abs(mode.shape / scale) ** 2))


def _with_resonances(
    found: Repeatability, model: ModalModel, reference: Pulses, reruns: Reruns, again: Sequence[Pulses]
) -> tuple[Repeatability, dict[int, tuple[str, ...]]]:
    """Leaders of split resonances judged by the whole group where that is found again better than they are alone."""
    parts = found.parts.copy()
    words: dict[int, tuple[str, ...]] = {}
    runs = [(run.modes.modes, pulses_again) for run, pulses_again in zip(reruns.runs, again, strict=True)]
    for leader, members in groups(model.modes, reference, n_steps=reruns.n_steps).items():
        together = group_overlaps(leader, members, model.modes, reference, runs, n_steps=reruns.n_steps)
        if together.size and together.mean() > parts[:, leader].mean():
            parts[:, leader] = together
            others = ", ".join(f"{model.modes[i].frequency:.4g}" for i in members if i != leader)
            words[leader] = (f"one resonance with the poles at {others} Hz, judged together",)
    return replace(found, parts=parts), words


def _group_means(parts: FloatArray, changes: tuple[Change, ...]) -> dict[str, FloatArray]:
    rows = {group: [i for i, change in enumerate(changes) if change in members] for group, members in GROUPS.items()}
    return {group: parts[chosen].mean(axis=0) for group, chosen in rows.items() if chosen}


def _worse_order(parts: FloatArray, changes: tuple[Change, ...]) -> str:
    lower = [part for part, change in zip(parts, changes, strict=True) if change == "lower order"]
    higher = [part for part, change in zip(parts, changes, strict=True) if change == "higher order"]
    if lower and (not higher or np.mean(lower) <= np.mean(higher)):
        return "appears only at high model order"
    return "is lost at higher model order"


def _worse_half(reruns: Reruns, index: int) -> str:
    driven = [run.evidence[index] for run in reruns.runs if run.evidence is not None]
    if driven and min(driven) < HARDLY_DRIVEN and max(driven) >= CLEARLY_DRIVEN:
        return "only one part of the record drives it, so that it repeats cannot be shown"
    return "the two halves of the data disagree about it"


def _verdict(
    p: float, ratio: float, numbers: dict[str, float], worst: dict[str, str]
) -> tuple[Verdict, tuple[str, ...]]:
    if np.isnan(p):
        return "doubtful", (NOT_JUDGED,)
    shown = ", ".join(f"{group} {value:.2f}" for group, value in numbers.items())
    if p >= SYSTEM_FROM and min(numbers.values()) >= LEAST_PART:
        return "system", (f"{FOUND_AGAIN}{shown}",)
    verdict: Verdict = "noise" if p < NOISE_BELOW else "doubtful"
    if ratio < HARDLY_DRIVEN and min(numbers.values()) >= 0.5:
        return verdict, (f"found again, but what the inputs make it do may be chance (F ratio {ratio:.1g})",)
    if max(numbers.values()) < NOT_FOUND_BELOW:
        return verdict, (f"not found again ({shown})",)
    smallest = min(numbers, key=lambda group: numbers[group])
    return verdict, (f"{worst[smallest]} ({shown})",)


def _mean_gain(found: Repeatability, reruns: Reruns, index: int) -> float:
    gains = [
        float(run.gain[found.continuation[i, index]])
        for i, run in enumerate(reruns.runs)
        if run.gain is not None and found.continuation[i, index] >= 0
    ]
    return float(np.nanmean(gains)) if np.isfinite(gains).any() else np.nan


def _primary(modes: tuple[Mode, ...], reference: Pulses, r: FloatArray, n_steps: int) -> list[int]:
    """Index of the mode that each one is a second pole of, its own where none; the most repeatable comes first."""
    frequency = np.array([mode.frequency for mode in modes])
    near = np.abs(frequency[:, np.newaxis] - frequency) <= SAME_FREQUENCY * frequency
    eligible: BoolArray = np.array([mode.kind == "oscillatory" for mode in modes])
    same = near & (assurance(reference.outputs, reference.outputs) >= SAME_SHAPE) & eligible & eligible[:, np.newaxis]
    primary = list(range(len(modes)))
    leaders: list[int] = []
    size = np.nan_to_num(energies(reference, n_steps=n_steps))
    for i in np.lexsort((-size, -np.nan_to_num(r))).tolist():
        first = next((leader for leader in leaders if same[i, leader]), None)
        if first is None:
            leaders.append(i)
        else:
            primary[i] = first
    return primary


def _damping_again(found: Repeatability, reruns: Reruns, index: int, change: Change) -> tuple[float, ...]:
    return tuple(
        run.modes.modes[found.continuation[i, index]].damping_ratio
        for i, run in enumerate(reruns.runs)
        if run.change == change and found.continuation[i, index] >= 0
    )
