"""Does what rings down ring as a mode does? One frequency, one damping, whatever the level.

Dry friction lets a motion die away along a line and then stop, drag takes most at the start, and a spring that is not
linear, or a bearing that creeps before it slides, has another frequency at each level. No pole makes a line, but enough
poles side by side follow any curve: a decay under friction is fitted down to its noise by a linear model of some twenty
states, which are no modes and yet are found again in every part of it. So the oscillator of `modal.verdict.oscillator`
competes by Schwarz's criterion with linear models of as few numbers: with the one mode that it is where nothing depends
on its level, with two modes, free in every output, and with a few that are about to be certain. Two modes make any
beat, and no line. Of poles far from the line that is asked about, other modes, harmonics, hum and drift, all of them
may have as much as they like.

What still drives a mode while it rings down is noise of its own in each description (`modal.verdict.decay`).

Of several modes, few with an inner force compete with all that the linear model has (`modal.verdict.inner_forces`).

Where no such oscillator is near either, the poles side by side are still not found again one by one. Whoever is found
among them is no mode for that: modes that are certain are most of what rings down.

What a linear model leaves may also say that it is none (`modal.verdict.constancy.fading`). Then poles side by side
share one motion as they would at no other level: no mode is certain of whose energy another pole could take half.

References:
    Den Hartog, Mechanical Vibrations, 4th ed., 1956, section 8.6; Feldman, Hilbert transform in vibration analysis,
    Mech. Syst. Signal Process. 25, 2011, https://doi.org/10.1016/j.ymssp.2010.07.018; Schwarz, Annals of Statistics 6,
    1978, 461-464, https://doi.org/10.1214/aos/1176344136.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from modal.modes.mode import Choice, ModalModel, Mode
from modal.modes.shape_comparison import inner_products, pulses
from modal.verdict.constancy import NO_INTERVAL
from modal.verdict.decay import Decay, directions, strongest_line
from modal.verdict.inner_forces import EVIDENCE, inner_forces_of, told_of_inner_forces
from modal.verdict.judgement import FOUND_AGAIN, Answer, doubted
from modal.verdict.oscillator import (
    CLOSELY,
    FEWEST,
    Contender,
    at_level,
    exponentials,
    level_after,
    mode_of,
    modes_of,
    oscillator_of,
    two_modes_of,
)
from modal.verdict.probability import FEWEST_TURNS
from modal.wording.text import hertz, percent
from okid.arrays import TINY, BoolArray, FloatArray
from okid.record import Record

RINGS = "ring-down"
"""Name of the choice."""
MOST_ROWS = 4000
"""Take every so manieth row of longer records: a few dozen cycles and where they stop show as well in fewer,"""
A_CYCLE = 8
"""but no fewer rows a cycle,"""
MOST_CYCLES = 100
"""and no more cycles, the first ones."""
LEAST_LEFT = 1e-9
"""Weigh outputs by what the linear model leaves of each, but by no less than this share of it."""
BAND = 1.5
"""Ask about the line alone: poles above it by more than this factor, or below, stand beside everything."""
FEW = 3
"""Let so many modes that are about to be certain compete: more are no simpler than what they would refuse."""
LATER = 0.1
"""Say what damping and frequency are at this share of the level at the start, or, where the record ends or friction
stops it before, at that level and"""
MOVING = 2.0
"""at so many times that one."""
MANIFEST = 1.1
"""Tell how many times as closely it explains a decay above this."""
CARRIED = 0.5
"""Ask that modes of the system carry this share of what rings, before one of them is certain."""
HALF = 0.5
"""Doubt a mode of whose energy another pole could take so much, where what is left dies away after blows."""
HALF_OF_IT = "what the model leaves is not noise alone, and half of this motion may be"
REST = "most of what rings down is described only by poles that were not found again"


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RingDown:
    """An oscillator that explains decays better than two linear modes.

    Attributes:
        level: later level of which the others tell, over that at the start.
        frequency: at the start and at that level [Hz].
        damping_ratio: of one mode that would lose as much in a cycle, at the same levels.
        friction: force of dry friction over that of the spring at the start.
        drag: damping ratio that the level at the start adds.
        gain: rms that two modes leave over that which the oscillator leaves, one step ahead.
    """

    level: float
    frequency: tuple[float, float]
    damping_ratio: tuple[float, float]
    friction: float
    drag: float
    gain: float

    @property
    def sentence(self) -> str:
        """What was found, and what to do."""
        likely = {
            f"as under dry friction of {percent(self.friction)} of the spring's force at the start": _lost(
                self.friction, self.level
            ),
            "as under drag": self.drag,
            "as with a spring that is not linear": abs(self.frequency[0] / self.frequency[1] - 1.0),
        }
        like = max(likely, key=lambda words: likely[words])
        damping, later = (percent(ratio) for ratio in self.damping_ratio)
        first, last = (hertz(frequency) for frequency in self.frequency)
        return (
            f"What rings at {first} Hz does not die away as a mode does, but {like}: damping {damping} at the start, "
            f"{later} at {percent(self.level)} of that level, where it rings at {last} Hz. Such an oscillator explains "
            f"the decay {self._closer} two modes do, so no mode is certain; `modal-report gap` tells friction, drag "
            "and springs apart."
        )

    @property
    def choice(self) -> Choice:
        """That modes were asked whether they describe it, and do not."""
        reason = f"an oscillator whose damping and frequency depend on its level explains it {self._closer} two modes"
        return _no_modes(reason)

    @property
    def _closer(self) -> str:
        if self.gain > MANIFEST:
            return f"{self.gain:.2g} times as closely as"
        return "more closely than" if self.gain > 1.0 else "with fewer numbers than"

    @property
    def doubt(self) -> str:
        """The reason of each mode."""
        return f"what rings at {hertz(self.frequency[0])} Hz has another damping or frequency at each level"


def _lost(friction: float, level: float) -> float:
    """Damping ratio of what loses as much in a cycle, 4 F A = 2 pi zeta k A^2, as dry friction of F/k at level A."""
    return 2.0 * friction / (np.pi * level)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Contest:
    """How descriptions of the strongest line that rings down compare.

    Attributes:
        bent: the oscillator, where it is likelier than one mode, two modes and the few that are about to be certain.
        few: whether so few modes leave about what the linear model leaves.
        crowd: how many poles are about to be certain where more than a few gain no more than chance gives, else 0.
        frequency: of the line [Hz].
    """

    bent: RingDown | None
    few: bool
    crowd: int
    frequency: float


def told_of_ring_down(
    modes: ModalModel,
    records: Sequence[Record],
    left: Sequence[FloatArray],
    *,
    output_scale: FloatArray,
    is_decay: bool,
    times: float = 1.0,
) -> Answer:
    """Whether what rings down rings as modes do, and which of the modes that leaves certain.

    Args:
        modes: judged; of decays each release is a pulse at an input.
        records: that ring down once their inputs are zero, nan where a sample was not measured.
        left: (n_samples, n_outputs) a record, what the linear model with all its states leaves.
        output_scale: (n_outputs,) what the outputs are divided by.
        is_decay: whether nothing but the release ever drove them, so that modes have to carry them.
        times: as large soon after each blow as late what it leaves is beside free motion (`constancy.fading`).
    """
    n_steps = max(record.n_samples for record in records)
    rest = is_decay and bool(modes.system) and carried(modes, n_steps=n_steps, output_scale=output_scale) < CARRIED
    answer = _told_by_contest(modes, contest_of(records, left, modes.modes, whole=rest), rest=rest)
    if answer.choices:
        return answer
    inner = inner_forces_of(modes, records)
    if inner is not None:
        beside = told_of_inner_forces(answer.modes, inner)
        answer = replace(beside, warnings=(*answer.warnings, *beside.warnings))
    if times == 1.0:
        return answer
    shared = _shared(answer.modes, n_steps=n_steps, output_scale=output_scale)
    told = tuple(
        mode if other is None else doubted(mode, f"{HALF_OF_IT} of the pole at {hertz(other.frequency)} Hz")
        for mode, other in zip(answer.modes, shared, strict=True)
    )
    warnings = (*answer.warnings, _faded(times))
    return replace(answer, modes=replace(answer.modes, modes=told), warnings=warnings, times=times)


def _faded(times: float) -> str:
    less_sure = "all deviations are larger by that" if times <= NO_INTERVAL else "no interval is given"
    return (
        f"What the model leaves dies away after each blow, as the motion does: soon after it is {times:.2g} times as "
        "large as late, and steady noise is so by chance in less than one record of 10 000. Something is not linear or "
        "changes in time, or modes are missing (a given order may be too low): modes and damping are an average at "
        f"this level, {less_sure}, and poles side by side may be one mode; `modal-report gap` names the effect."
    )


def _told_by_contest(modes: ModalModel, contest: Contest | None, *, rest: bool) -> Answer:
    """What the contest says of modes of which the rest may carry most."""
    if contest is None:
        return Answer(modes=modes)
    bent = contest.bent
    if bent is not None:
        return Answer(modes=_doubted(modes, bent.doubt), warnings=(bent.sentence,), choices=(bent.choice,))
    if contest.crowd:
        what = f"what rings at {hertz(contest.frequency)} Hz"
        why = f"fewer modes explain {what} as closely as the {contest.crowd} poles that were found there"
        told = _doubted(modes, why, line=contest.frequency)
        return Answer(modes=told, warnings=(f"{why[0].upper()}{why[1:]}, so none of these is certain.",))
    if not rest or contest.few:
        return Answer(modes=modes)
    said = REST[0].upper() + REST[1:]
    return Answer(
        modes=_doubted(modes, REST),
        warnings=(f"{said}: it may be no sum of modes, and none of them is certain.",),
        choices=(_no_modes(REST),),
    )


def _shared(modes: ModalModel, *, n_steps: int, output_scale: FloatArray) -> list[Mode | None]:
    """For each mode the other one that could take most of its pulse response, if that is half of its energy.

    Of h, with p = |<h, g>| at the best phase, an answer g no larger than it is takes p^2 / |g|^2 where it need not be
    larger, p <= |g|^2, else 2 p - |g|^2.
    """
    turning = np.array([mode.kind == "oscillatory" for mode in modes], dtype=np.bool_)
    own = pulses(modes.modes, dt=modes.dt, output_scale=output_scale)
    turned = replace(own, outputs=1j * own.outputs)
    products = np.hypot(*(inner_products(own, other, n_steps=n_steps) for other in (own, turned)))
    products = np.nan_to_num(products) * turning
    energy = np.diag(products).copy()
    np.fill_diagonal(products, 0.0)
    taken = np.where(products > energy, 2.0 * products - energy, products**2 / np.maximum(energy, TINY))
    most = taken.argmax(axis=1)
    return [modes.modes[j] if taken[i, j] > HALF * energy[i] else None for i, j in enumerate(most.tolist())]


def _no_modes(reason: str) -> Choice:
    return Choice(what=RINGS, value="not as modes do", reason=reason)


def _doubted(modes: ModalModel, why: str, *, line: float = np.nan) -> ModalModel:
    """With a doubt of every mode, or of those near a line [Hz]."""
    near = [np.isnan(line) or 1 / BAND < mode.frequency / line < BAND for mode in modes.modes]
    told = (doubted(mode, why) if own else mode for mode, own in zip(modes.modes, near, strict=True))
    return replace(modes, modes=tuple(told))


def contest_of(
    records: Sequence[Record], left: Sequence[FloatArray], modes: Sequence[Mode] = (), *, whole: bool = True
) -> Contest | None:
    """How well an oscillator whose damping or frequency depends on its level, and few modes, explain decays.

    Args:
        records: as for `told_of_ring_down`.
        left: likewise.
        modes: of the linear model, judged.
        whole: whether to ask few modes where there is no such oscillator.

    Returns:
        The comparison, None where there is nothing to ask.

    Example:
        >>> from modal.verdict.oscillator import motion
        >>> x, _, _ = motion(np.array([2 * np.pi, 0.002, 0.3, 0.03, *np.zeros(6)]), 0.02 * np.arange(400))
        >>> noise = 1e-3 * np.random.default_rng(1).standard_normal((400, 1))
        >>> found = contest_of([Record([], x[:, np.newaxis] + noise, 0.02)], [noise])
        >>> round(found.bent.frequency[0], 2), round(found.bent.friction, 3)
        (1.0, 0.03)
    """
    asked = [_asked(record, errors, modes) for record, errors in zip(records, left, strict=True)]
    asked_of = [(*one, record.dt) for one, record in zip(asked, records, strict=True) if one is not None]
    if not asked_of:
        return None
    crowd = max(len(certain) for _, _, certain, _ in asked_of)
    misfits, totals, numbers, found = np.zeros(5), np.zeros(4), np.zeros(5), []
    for asked_decay, linear, certain, dt in asked_of:
        decay, one = mode_of(asked_decay)
        own = oscillator_of(decay, linear, one)
        if own is None and not whole and crowd <= FEW:
            return None
        two = two_modes_of(decay, one.parameters)
        few = modes_of(decay, certain) if 0 < len(certain) <= FEW else two
        fits = (one, two, few) if own is None else (own, one, two, few)
        n_values = decay.told.sum(axis=0)
        # sizes in every output: one of the oscillator, and of the mode that it is, whose phase all outputs share; two
        # of each mode that is free in every output
        free, sizes = np.array([0, 0, 0, 0, 2 * len(certain)]), np.array([1, 1, 4, few.n_free, 2 * len(certain)])
        totals[0], misfits[0] = (np.inf, np.inf) if own is None else (totals[0], misfits[0])
        free[4 - len(fits) : 4] = [fit.n_free for fit in fits]
        misfits[4 - len(fits) :] += [*(fit.white for fit in fits), decay.misfit(np.nan_to_num(linear), whole=True)]
        numbers += free + sizes * len(n_values)
        totals[4 - len(fits) :] += [fit.criterion(decay) for fit in fits]  # Schwarz's
        totals += sizes[:4] * np.log(n_values[decay.strong]).sum()
        closer = np.inf if own is None else two.misfit - own.misfit
        found.append((float(np.nanvar(decay.seen)), decay, own, closer, dt))
    # the end of what was cut may tell close modes apart
    cut = any(decay.turns * decay.times[-1] > 2 * np.pi * (MOST_CYCLES - 1) for _, decay, _, _, _ in found)
    by_chance = misfits + 2 * numbers  # Akaike's
    _, strongest, own, _, dt = max(found, key=lambda one: one[0])
    n_values = sum(int(decay.told.sum()) for _, decay, _, _, _ in found)
    n_strong = sum(int(decay.told[:, decay.strong].sum()) for _, decay, _, _, _ in found)
    likelier = bool(totals[0] + EVIDENCE < totals[1:].min())
    gain = float(np.exp(sum(closer for _, _, _, closer, _ in found) / (2 * n_strong))) if likelier else 1.0
    return Contest(
        bent=_ring_down(own, strongest.times, dt, gain) if likelier and own is not None else None,
        few=bool(misfits[1:4].min() <= misfits[4] + 2 * np.log(CLOSELY) * n_values),
        crowd=crowd if crowd > FEW and by_chance[1:4].min() < by_chance[4] and not cut else 0,
        frequency=strongest.turns / (2 * np.pi * dt),
    )


def _ring_down(own: Contender, times: FloatArray, dt: float, gain: float) -> RingDown:
    friction = float(own.parameters[3])
    level = min(1.0, max(LATER, MOVING * friction, level_after(own.parameters, times)))
    (first, ratio), (later, other) = (at_level(own.parameters, at) for at in (1.0, level))
    return RingDown(
        level=level,
        frequency=(first / (2 * np.pi * dt), later / (2 * np.pi * dt)),
        damping_ratio=(ratio + _lost(friction, 1.0), other + _lost(friction, level)),
        friction=friction,
        drag=abs(ratio - other),
        gain=gain,
    )


def _asked(record: Record, errors: FloatArray, modes: Sequence[Mode]) -> tuple[Decay, FloatArray, FloatArray] | None:
    """What is asked of a record, in outputs weighed by what the linear model leaves; that; and modes near the line.

    These are (n_modes, 2), angular frequency [rad/sample] and damping ratio, of what is about to be certain.
    """
    rows = _free_rows(record)
    if not len(rows):
        return None
    there = np.isfinite(record.outputs[rows]) & np.isfinite(errors[rows])
    told = there.sum(axis=0) >= FEWEST
    seen = np.where(there, record.outputs[rows], np.nan)[:, told]
    told[told] = np.nanmax(seen, axis=0) > np.nanmin(seen, axis=0)
    if not told.any():
        return None
    there, seen = there[:, told], np.where(there, record.outputs[rows], np.nan)[:, told]
    linear = np.where(there, errors[rows][:, told], np.nan)
    size = np.maximum(np.sqrt(np.nanmean(linear**2, axis=0)), LEAST_LEFT * np.nanstd(seen, axis=0))
    times = (rows - rows[0]).astype(np.float64)
    poles = np.array([mode.pole for mode in modes], dtype=np.complex128) * record.dt
    line = strongest_line(times, seen / size)
    near = (poles.imag != 0) & (np.abs(poles) < BAND * line) & (BAND * np.abs(poles) > line)
    certain = near & np.array([mode.verdict == "system" for mode in modes], dtype=np.bool_)
    few = np.column_stack([np.abs(poles), -poles.real / np.maximum(np.abs(poles), TINY)])[certain]
    beside = exponentials(poles[~near], times)
    along = directions(seen / size, beside)
    there = there[:, [int(np.argmax(np.abs(one))) for one in along.T]]  # those of one direction were measured together
    turned, left = (np.where(there, np.nan_to_num(values / size) @ along, np.nan) for values in (seen, linear))
    return Decay.of(times, turned, beside), left, few


def carried(modes: ModalModel, *, n_steps: int, output_scale: FloatArray) -> float:
    """Share of the energy of all that oscillates that modes which were found again carry together, pulse by pulse.

    What is doubted for something else, as hum is, and what hardly turns, as drift, counts on neither side. Poles that
    follow a curve which is no sum of modes cancel one another: alone each tells nothing, so what is told is what all
    the others leave of the sum, below zero where they are more than it. 1 where nothing oscillates.
    """
    turning = [
        mode
        for mode in modes.modes
        if mode.kind == "oscillatory" and not mode.doubts and mode.frequency * n_steps * modes.dt >= FEWEST_TURNS
    ]
    # the second pole of a resonance is not certain, and was found again
    others = np.array([mode.verdict != "system" and FOUND_AGAIN not in mode.reason for mode in turning], dtype=np.bool_)
    if not others.any():
        return 1.0
    poles = np.array([complex(min(mode.pole.real, 0.0), mode.pole.imag) for mode in turning])
    sizes = np.array([np.outer(mode.shape / output_scale, mode.participation).ravel() for mode in turning])
    steps = np.arange(0, n_steps, max(1, n_steps // MOST_ROWS))
    over_time = np.exp(poles * modes.dt * steps[:, np.newaxis])
    whole, rest = (over_time @ sizes).real, (over_time[:, others] @ sizes[others]).real
    return 1.0 - float(np.square(rest).sum() / max(np.square(whole).sum(), TINY))


def _free_rows(record: Record) -> NDArray[np.intp]:
    """Rows in which nothing drives, something moves and some output was measured."""
    seen: BoolArray = np.asarray(np.isfinite(record.outputs))
    free: BoolArray = np.asarray(seen.any(axis=1))
    free[: np.flatnonzero((record.inputs != 0.0).any(axis=1)).max(initial=-1) + 1] = False
    # a sensor that stands still tells nothing more
    free[max(_last_move(values, own) for values, own in zip(record.outputs.T, seen.T, strict=True)) + 1 :] = False
    rows = np.flatnonzero(free)
    if len(rows) < FEWEST:
        return rows[:0]
    turns = strongest_line(rows.astype(np.float64), record.outputs[rows])
    rows = rows[: max(FEWEST, int(MOST_CYCLES * 2 * np.pi / turns))] if turns else rows
    return rows[:: max(1, min(len(rows) // MOST_ROWS, int(2 * np.pi / (A_CYCLE * turns))))] if turns else rows[:0]


def _last_move(values: FloatArray, there: BoolArray) -> int:
    """Last row of an output that differs from the one before it."""
    rows = np.flatnonzero(there)
    return int(rows[1:][np.diff(values[rows]) != 0.0].max(initial=0))
