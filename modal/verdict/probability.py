"""The probability that a mode belongs to the system, from two pieces of evidence.

Found again: the repeatability r (`modal.verdict.judgement`). Driven: how much of the outputs the mode's answer to the
inputs explains for the k numbers that the mode brings; with g its gain (`modal.verdict.excitation`) on N measured
values, F = (N / k) g / (1 - g), the ratio that analysis of variance would test.

    p = 1 / (1 + exp(11.5 - 14.1 r - 0.95 log10 F)),   F clipped to [0.1, 1e6]

so that a tenfold F counts as much as 0.07 of r. Without inputs there is no F: p = 1 / (1 + exp(12.0 - 17.5 r)). The
numbers are by maximum likelihood on simulated structures; `modal/docs/verdict.md` has the reliability table and the
command.

What keeps a mode that was found again from being called a mode of the system, each in one function and one sentence.

Existence is one statement, damping another: when a mode's damping ratio is not to be quoted, and why.

Nearly all modes that are accepted in error are true modes with a damping ratio that is far too high: smeared by a short
observer, by a ridge, or by noise.
"""

import math
from collections.abc import Sequence

import numpy as np

from modal.modes.extraction import NYQUIST_MARGIN
from modal.modes.mode import Mode
from modal.preparation.band import FOLLOWS
from modal.wording.text import LEAST_FIT
from okid.excitation import Excitation

LEAST_RATIO, LARGEST_RATIO = 0.1, 1e6
"""Beyond these F ratios nothing more is learnt."""


def f_ratio(mode: Mode, gain: float, n_values: int) -> float:
    """(N / k) g / (1 - g) for the k numbers of a mode: its pole, its participation and its shape up to their scale.

    Example:
        >>> mode = Mode(pole=-1 + 9j, kind="oscillatory", frequency=1.44, damping_ratio=0.11,
        ...             shape=np.ones(2), participation=np.ones(1))
        >>> f_ratio(mode, 0.02, 6000)
        20.408163265306122
    """
    k = (mode.shape.size + mode.participation.size) * (2 if mode.pole.imag else 1)
    return n_values / k * gain / max(1 - gain, np.finfo(float).eps)


def probability(r: float, ratio: float = np.nan) -> float:
    """That a mode of repeatability r belongs to the system, its F ratio being known or not (nan).

    Example:
        >>> [round(probability(0.8, ratio), 2) for ratio in (1.0, 100.0, 10000.0)]
        [0.45, 0.84, 0.97]
    """
    if np.isnan(ratio):
        return float(1 / (1 + np.exp(12.0 - 17.5 * r)))
    evidence = np.log10(np.clip(ratio, LEAST_RATIO, LARGEST_RATIO))
    return float(1 / (1 + np.exp(11.5 - 14.1 * r - 0.95 * evidence)))


HARDLY_DRIVEN = 5.0
"""Below this F ratio what inputs make a mode do may be chance: in all rows, beside lines, or after a blow."""
MOST_MISSED = 0.5
"""Doubt all modes of a model that leaves more of what the inputs explain than it explains."""
LARGEST_UNDRIVEN_DAMPING = 0.05
"""Damping ratio above which, without an input, a pole cannot be told from the colour of what drives the system."""
LEAST_HEIGHT = 2.0
"""Doubt a pole without an input that has no more than so many times the power beside it, where a resonance has six: of
313 true modes in 80 records of ambient motion all had more, of 34 false ones behind steep filters one."""
MOST_HEIGHT = 100.0
"""Doubt it from so many times on: of 230 true modes of the same records none had more than 47."""
RESOLVED = 2
"""Tell no peak from its sides within so many frequencies: the main lobe of the window (Hann)."""
CLEAR_GAIN = 0.03
"""Gain from which a mode is excited beyond doubt: of 93 such poles that the rule without it doubted, 91 were true."""
FILTER_EDGE = 0.85
"""Share of the Nyquist frequency of a decimated record above which its anti-alias filter makes poles of its own."""
LEAST_MEMORY = 0.3
"""Magnitude of a discrete pole below which nine tenths of its response are over after two samples."""


MOST_MADE = 0.1
"""Doubt a mode from this share of its band's power that clipping makes: modes of the system show their own share of
distortion there, a hundredth at 13 % clipped samples; sums and differences show nothing else."""


def poor_fit_doubt(fit: float, missed: float = np.nan) -> tuple[str, ...]:
    """The model leaves more than it explains of what can be explained (nan: not known, no doubt).

    Low fit is not error: noise and forces that were not measured lower it, and say nothing against a mode that was
    found again. With inputs it is asked what the free run leaves of what follows them, of a table what it repeats of
    its lines. Without inputs nothing is asked: one step ahead no model tells the forces to come.

    Args:
        fit: of a table, to the other half of its averages; nan of records.
        missed: share of what the inputs explain that the model leaves (`modal.preparation.band.missed_share`).

    Example:
        >>> poor_fit_doubt(0.319)
        ('the model repeats only 31 % of the responses of the other half of the averages: no mode of it is certain',)
    """
    if missed > MOST_MISSED:
        return (f"the model leaves {100 * missed:.0f} % of what the inputs explain: no mode of it is certain",)
    if not fit < LEAST_FIT:
        return ()
    share = "nothing" if fit < 0.01 else f"only {np.floor(100 * fit):.0f} %"
    return (f"the model repeats {share} of the responses of the other half of the averages: no mode of it is certain",)


def excitation_doubt(n_states: int, excitation: Excitation | None, gain: float = np.nan) -> tuple[str, ...]:
    """The inputs move in fewer ways than the model has states (None: no inputs, or not known).

    A sweep or a multisine that ends below half the sampling frequency moves in few ways, and yet shows every mode in
    its band. A mode whose gain is clear is excited, whatever the rest of the band may hold.
    """
    if gain >= CLEAR_GAIN or excitation is None:
        return ()
    if excitation.persistency_order >= min(n_states, excitation.needed_order):
        return ()
    words = f"the inputs excite order {excitation.persistency_order} only, too few for a model of {n_states} states"
    return (f"{words}: what they leave open is not in the data",)


def colour_doubt(mode: Mode) -> tuple[str, ...]:
    """Without an input, a heavily damped pole may describe the spectrum of what drives the system."""
    if mode.participation.size or mode.damping_ratio <= LARGEST_UNDRIVEN_DAMPING:
        return ()
    return (f"damping {100 * mode.damping_ratio:.0f} % and no input: may be the colour of what drives the system",)


def peak_doubt(mode: Mode, height: float, duration: float) -> tuple[str, ...]:
    """Without an input, a pole that makes no peak may describe a filter; one with too high a peak is none of its width.

    Args:
        mode: from the whole record.
        height: times the power beside it (`modal.verdict.resonance.standing_out`); nan where unknown.
        duration: of the longest record [s], which tells no peak narrower than a few times 1 / duration.
    """
    if height < LEAST_HEIGHT:
        words = (
            f"no peak stands at {mode.frequency:.4g} Hz (at most {height:.2g} times the power beside it; a resonance"
        )
        return (f"{words} has six): may be the edge of a filter or the colour of what drives the system",)
    if height > MOST_HEIGHT and mode.damping_ratio * mode.frequency * duration >= RESOLVED:
        words = (
            f"the peak at {mode.frequency:.4g} Hz has {height:.0f} times the power beside it, where its damping makes"
        )
        return (f"{words} six: much narrower, an undamped line or another mode",)
    return ()


def folded_doubt(mode: Mode, dt: float) -> tuple[str, ...]:
    """Without an input, samples do not tell a mode beside the Nyquist frequency from one as far above it.

    A filter of finite order passes both nearly alike: one of order 6 at 0.4 fs leaves at 0.51 fs 0.8 of the amplitude
    that it leaves at 0.49 fs. What is measured of an input passes the same filter, and its phase tells them apart, but
    of an input that moves between its samples part is folded as well.

    Example:
        >>> one = np.ones(1)
        >>> pole = complex(-1.0, 2 * np.pi * 49)
        >>> mode = Mode(
        ...     pole=pole, kind="oscillatory", frequency=49.0, damping_ratio=0.003, shape=one, participation=one
        ... )
        >>> folded_doubt(mode, 0.01)[0].split(":")[0], folded_doubt(mode, 0.009)
        ('51 Hz folded at the Nyquist frequency would look the same', ())
    """
    frequency, nyquist = abs(mode.pole.imag) / (2.0 * np.pi), 0.5 / dt
    if mode.kind != "oscillatory" or frequency < (1.0 - NYQUIST_MARGIN) * nyquist:
        return ()
    words = f"{2.0 * nyquist - frequency:.4g} Hz folded at the Nyquist frequency would look the same"
    return (f"{words}: sample faster, or behind a filter that ends well below {nyquist:.4g} Hz",)


def delay_doubt(mode: Mode, dt: float, ahead: int = 0) -> tuple[str, ...]:
    """A pole that dies within two samples may describe a delay, or what happens between samples.

    Where the model looks `ahead` by so many samples it may describe what the inputs do up to then.
    """
    left = float(np.exp(mode.pole.real * dt))
    if left >= LEAST_MEMORY ** (2 / (2 + ahead)):
        return ()
    gone = "two samples" if not ahead else f"the {ahead} samples that inputs are ahead and two more"
    what = "a delay" if not ahead else "what inputs do between their samples"
    return (f"dies within {gone} ({100 * left:.0f} % are left after one): may be {what}, not a mode",)


def pole_doubts(mode: Mode, dt: float, ahead: int = 0) -> tuple[str, ...]:
    """What a pole raises by its damping alone, whatever was measured."""
    return (*colour_doubt(mode), *delay_doubt(mode, dt, ahead))


def edge_doubt(mode: Mode, edge: float) -> tuple[str, ...]:
    """A pole in the edge of the anti-alias filter of a decimated record, `edge` [Hz] and above."""
    if not mode.frequency > edge:
        return ()
    return (f"above {edge:.4g} Hz, in the edge of the filter of the decimated record: may belong to the filter",)


def clipping_doubt(mode: Mode, made: float) -> tuple[str, ...]:
    """The share `made` of what moves at the mode's frequency is made by limits or coarse levels of the outputs.

    Where it is not known (nan) because what drives them is not steady, they may make all of it.
    """
    if np.isnan(made):
        words = "what drives the outputs is not steady, so nothing tells what their limits or coarse levels make"
        return (f"{words} at {mode.frequency:.4g} Hz",)
    if not made > MOST_MADE:
        return ()
    return (f"clipping or rounding alone makes {100 * min(made, 1.0):.0f} % of what moves at {mode.frequency:.4g} Hz",)


def unexcited_doubt(mode: Mode, excitation: Excitation | None) -> tuple[str, ...]:
    """No input moves at the mode's frequency, within 60 dB of where it moves most (None: no inputs, or not known)."""
    if excitation is None or not any(excitation.excited_bands):
        return ()
    if any(low <= mode.frequency <= high for bands in excitation.excited_bands for low, high in bands):
        return ()
    return (f"no input moves at {mode.frequency:.4g} Hz: what is seen there is leakage or a disturbance",)


def unanswered_doubt(mode: Mode, chance: float, driven: float = np.nan) -> tuple[str, ...]:
    """Nothing that the outputs do at the mode's frequency follows the inputs beyond chance.

    Short segments see little of a long answer and miss it every now and then; a mode whose answer makes more than it
    leaves of held-out rows (its gain there, `driven`) was seen to follow.
    """
    if not chance > FOLLOWS or mode.kind != "oscillatory" or driven > 1.0 - MOST_MISSED:
        return ()
    return (f"nothing follows the inputs at {mode.frequency:.4g} Hz beyond chance: noise, leakage or a disturbance",)


COMES_BACK = 0.5
"""Doubt a mode of what rings down, or of a table, from this damping ratio on: in one period it falls below 3 %."""


def heavy_doubt(mode: Mode) -> tuple[str, ...]:
    """A pole of more than half critical damping, where filters or motion beyond the lines add terms as broad.

    Example:
        >>> heavy_doubt(Mode(pole=-6 + 5j, kind="oscillatory", frequency=1.24, damping_ratio=0.77,
        ...                  shape=np.ones(1), participation=np.ones(1)))
        ('damping 77 %: does not come back once; filters of sensors and amplifiers answer so, too',)
    """
    if not mode.damping_ratio > COMES_BACK or mode.kind not in ("oscillatory", "real"):
        return ()
    share = f"damping {100 * mode.damping_ratio:.0f} %"
    return (f"{share}: does not come back once; filters of sensors and amplifiers answer so, too",)


def free_doubt(mode: Mode, ringing: float, made_of: str) -> tuple[str, ...]:
    """What follows a blow or a release and is no ringing of a structure, or that of two modes at once.

    Args:
        mode: of what rings down.
        ringing: F ratio, see `modal.verdict.excitation.ringing`.
        made_of: see `modal.verdict.constancy.sums_of_stronger`.

    Example:
        >>> mode = Mode(pole=-1 + 9j, kind="oscillatory", frequency=1.44, damping_ratio=0.11,
        ...             shape=np.ones(1), participation=np.ones(1))
        >>> free_doubt(mode, 100.0, "2.1 - 0.66")
        ('its pole is a sum of stronger ones (2.1 - 0.66 Hz): what is not quite linear makes such a one',)
    """
    doubts = []
    if ringing < HARDLY_DRIVEN:
        where = f"nothing rings at {mode.frequency:.4g} Hz beyond chance"
        doubts.append(f"{where}: what seems to answer is over with the blow")
    if made_of:
        doubts.append(f"its pole is a sum of stronger ones ({made_of} Hz): what is not quite linear makes such a one")
    return tuple(doubts)


FEWEST_TURNS = 2.0
"""Doubt a pole of a decay that turns less often within the record, where another turns more often: a drifting sensor
makes a half-wave or two."""


def drift_doubt(mode: Mode, others: Sequence[Mode], duration: float) -> tuple[str, ...]:
    """In a decay nothing that was measured tells the slowest motion from a sensor that drifts beside what vibrates.

    Example:
        >>> import numpy as np
        >>> slow, fast = (
        ...     Mode(pole=pole, kind=kind, frequency=f, damping_ratio=0.5, shape=np.ones(1), participation=np.ones(1))
        ...     for pole, kind, f in ((-0.6, "real", 0.095), (-0.5 + 9j, "oscillatory", 1.4))
        ... )
        >>> drift_doubt(slow, [slow, fast], duration=10.0)
        ('so slow that a drifting sensor makes it as well: it turns 0.95 times within the record',)
    """
    vibrates = any(one.kind == "oscillatory" and one.frequency * duration >= FEWEST_TURNS for one in others)
    return (drifting(mode, duration),) if mode.frequency * duration < FEWEST_TURNS and vibrates else ()


def drifting(mode: Mode, duration: float) -> str:
    """What turns less often than `FEWEST_TURNS` within its record, in words."""
    turns = f"it turns {mode.frequency * duration:.2g} times within the record"
    return f"so slow that a drifting sensor makes it as well: {turns}"


SPREAD = 0.1
"""Relative standard deviation above which a damping ratio is not to be quoted."""
MOST_SPREAD = 1000
"""Per cent of a damping ratio, beyond which a standard deviation says nothing but that nothing is known."""
BIASING_RIDGE = 1e-2
"""Ridge that biases damping when no output-error refinement follows."""
HALVES_APART = 0.5
"""Difference of the two halves of the data, relative to the mode, that shows such a spread: 2.5 standard deviations of
a difference between halves of relative standard deviation sqrt(2) 0.1 each."""
OBSERVERS_APART = 0.3
"""Relative change with observer order and ridge that shows a bias by them. On 120 random systems (observer order 30 or
50, ridge 1e-5 to 1e-3, rerun with 0.7 of the order and 3 times the ridge) it marked 42 of the 50 damping ratios that
were off by more than half, and 22 of the 331 that were right to a quarter; the halves alone marked 12 and 30."""


def damping_doubt(
    mode: Mode, *, span: float, ridge: float, halves: tuple[float, ...], observers: tuple[float, ...]
) -> tuple[str, ...]:
    """The first reason not to quote the damping ratio of an oscillatory mode, in words; empty when there is none.

    Args:
        mode: its standard deviation is used where it is known.
        span: periods of the mode that the observer spans.
        ridge: of the observer fit, 0 when a refinement followed.
        halves: damping ratios of the same mode in halves of the data.
        observers: damping ratios of the same mode with other observer orders and ridges.

    Example:
        >>> import numpy as np
        >>> mode = Mode(pole=-1 + 9j, kind="oscillatory", frequency=1.44, damping_ratio=0.11,
        ...             shape=np.ones(1), participation=np.ones(1))
        >>> damping_doubt(mode, span=0.4, ridge=0.0, halves=(), observers=())
        ('damping not resolved: the observer spans only 0.4 of its period',)
    """
    if mode.kind != "oscillatory":
        return ()
    damping = mode.damping_ratio
    size = abs(damping)
    furthest = max(observers, key=lambda other: abs(other - damping), default=damping)
    if mode.damping_ratio_std > SPREAD * size:
        share = 100 * mode.damping_ratio_std / size if size else math.inf
        why = f"its standard deviation is {f'{share:.0f}' if share <= MOST_SPREAD else f'over {MOST_SPREAD}'} % of it"
    elif span < 1 and not _agree(damping, (*halves, *observers)):
        why = f"the observer spans only {span:.2g} of its period"
    elif ridge >= BIASING_RIDGE:
        why = f"a ridge of {ridge:.2g} without refinement biases it"
    elif len(halves) > 1 and max(halves) - min(halves) > HALVES_APART * size:
        why = f"the halves of the data give {_percent(min(halves))} and {_percent(max(halves))}"
    elif abs(furthest - damping) > OBSERVERS_APART * size:
        why = f"another observer order and ridge give {_percent(furthest)} instead of {_percent(damping)}"
    else:
        return ()
    return (f"damping not resolved: {why}",)


def _agree(damping: float, others: tuple[float, ...]) -> bool:
    """Found again with the same damping wherever it was looked for, so that even a short observer has resolved it."""
    return len(others) > 1 and all(abs(other - damping) <= SPREAD * abs(damping) for other in others)


def _percent(ratio: float) -> str:
    return f"{100 * ratio:.2g} %" if ratio < 0.995 else f"{100 * ratio:.0f} %"
