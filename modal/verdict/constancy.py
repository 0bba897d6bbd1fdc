"""Is a mode the same early and late, and at low and high level? Dry friction and a stiffness that drifts say no.

What the model leaves, e, is compared with what a small change of one pole would do: with T the derivatives of the
mode's answer to the inputs by decay rate and angular frequency, and by the size of that answer, which noise in the
inputs and their gains change,

    delta = (T'T)^-1 T'e

is the change there (one Gauss-Newton step). *In time* a line goes through the changes of blocks of rows. *With the
level* the rows in which the mode moves much have a change of their own, those in which it moves little another; either
hold half of its energy, and so about as much of what is known of its pole. The ends differ beyond chance where the
scatter of the blocks does not explain it, whatever the colour of the noise. Few blocks may hold a mode (a sweep passes
it once): how sure their scatter is counts what each of them weighs. A force that was not measured makes errors that
last as long as the mode rings: of blocks of L seconds, and products of T and e that are forgotten as exp(-t / m), the
sum has so many times the variance that independent ones have (an Ornstein-Uhlenbeck process, integrated):

    (L / m) / (L / m - 1 + exp(-L / m)),        m = 1 / (2 decay rate)

or (1 + r) / (1 - r) times, where neighbouring blocks are alike by r and that is more: waves are, and slow drifts.
Where the ends differ notably, no interval about their mean is one of the pole: its deviation holds both.

What a model leaves that is too small, or has no poles for the edge of a filter, follows the inputs linearly at low and
high level alike, and T of the rows of one level follows it too. So what is linear in the inputs of the last samples is
taken off e before; what a mode that changes leaves is no such answer, but for the mean of its changes.

After blows nothing drives, and a linear structure moves freely, whatever they were: what is left beside free motion
from a state of its own after each blow is noise, and noise does not know when a blow was. Where it is larger soon after
blows than late, beyond what the last thirds scatter, something moves that is no sum of these modes, or they are not
all. How long that lasts is not known: the first block, the first two, four, ... of all blows together are asked. An
exponential window lets noise die away as well, but along one line in its logarithm, to the end.

What rings down and is not quite linear shows products of its modes, x_i x_j and x_i x_j x_k or their conjugates: these
ring down as well, with the sums of the poles for poles (Rugh, Nonlinear System Theory, 1981, section 3.2). One record
fits them as well as modes, and so does every part of it.

References:
    Bell, McCaffrey, Survey Methodology 28(2), 2002, 169-181 (bias and freedom of the scatter of few unequal clusters).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from typing import Any

import numpy as np
import scipy

from era.realisation import Realisation
from era.state_recursion import PoleRecursion
from modal.estimation.fits import model_runs
from modal.modes.modal_form import discrete_poles
from modal.modes.mode import ModalModel, Mode, Uncertainty
from modal.preparation.amplitude import resolution_of
from modal.preparation.channel import channels_of
from modal.preparation.kind import acting_rows, widened
from modal.verdict.probability import SPREAD
from modal.wording.text import IN_TIME, NINETY_FIVE, WITH_LEVEL, hertz, percent
from okid.arrays import TINY, BoolArray, FloatArray
from okid.record import Record
from okid.rows import runs_of
from okid.scaling import channel_scaling

N_BLOCKS, LEAST_BLOCKS = 60, 8
"""Cut all records together into at most so many blocks, and ask nothing of fewer: they do not tell their scatter."""
LEAST_DECAYS = 1.0
"""Let a mode decay so often within a block: what is left of a shorter one's memory is more than can be allowed for."""
N_TOLD = 3
"""Tell so many numbers at either end: changes of decay rate, of angular frequency, and of the answer's size."""
CHANCE = 0.01
"""Believe in a change where chance makes as large a one in this share of records, however many are asked."""
REACH, ROWS_EACH = 64, 20
"""Take off what is linear in the inputs of so many samples, or of fewer where each has not so many rows."""
ROWS_AT_ONCE = 4096
"""Sum so many rows at once: a long record has no copy a sample."""
NOTABLE = 0.1
"""Speak of a change of the pole by this share of its decay rate: the spread at which damping is not to be quoted."""
NO_INTERVAL = 3.0
"""Give no interval where noise makes deviations larger by more: what is not seen of it may be as much again."""
N_PARTS = 10
"""Compare so many parts of a record without inputs,"""
UNSTEADY = 3.0
"""and say that what drives it is not steady where one has so many times the rms of another: wind and traffic stay
within it, and chance does over a hundred samples."""

PARTS_OF_BLOW = 6
"""Cut what follows a blow into so many blocks at least, and ask nothing of shorter ones than"""
LEAST_ROWS = 8
"""so many rows."""
FADES = 1e-4
"""Say that what is left dies away after blows where chance makes as much of it less often,"""
LARGER_SOON = 1.3
"""and it is so many times as large soon after them as late."""
DIGITS = 1e-4
"""Take what is this share of the largest motion for rounding: values written with four digits err by as much."""

LEAST_LEFT = 1e-6
"""Take what a line leaves of a block for nothing below this share: the block alone has drawn the line."""
ALIKE = 0.9
"""Take neighbouring blocks for alike by no more: beyond, sixty tell nothing."""
QUARTILES = (0.25, 0.75)
"""Compare the mode at these shares of the time."""

PARENTS = 8
"""Look at sums of so many of the strongest modes: products of strong ones are what stands out."""
PRODUCT = 0.1
"""Take for a product what has at most this share of the power of each mode that it is a product of."""
NEARER = 0.01
"""Believe in a product whose pole lies nearer to a sum of poles than chance puts this share of them,"""
FURTHEST = 4.0
"""and that is no further from it than so many stated deviations: chance puts one in three thousand there."""
DECADES = 2.0
"""Expect a decay rate anywhere within so many decades."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Look:
    """The changes of one mode at two ends, in time or over its level.

    Attributes:
        mode: that was looked at.
        how: over what.
        groups: what the two ends are.
        ends: (2, 2) changes of decay rate and angular frequency at either end.
        t: (2,) their differences, by their deviations.
        chance: (2,) of differences as large.
    """

    mode: Mode
    how: str
    groups: tuple[str, str]
    ends: FloatArray
    t: FloatArray
    chance: FloatArray

    def notable(self, n_looks: int) -> BoolArray:
        """(2,) whether decay rate and frequency change notably, and beyond chance for so many looks."""
        beyond, decay = self.chance < CHANCE / (2 * n_looks), -self.mode.pole.real
        beyond[0] &= np.abs(self.ends[:, 0]).max() < decay  # no step of first order reaches so far
        return np.asarray(beyond & (np.abs(np.diff(self.ends, axis=0)[0]) > NOTABLE * decay))


def drifting_modes(
    modes: tuple[Mode, ...], records: Sequence[Record], left: Sequence[FloatArray], *, output_scale: FloatArray
) -> tuple[Mode, ...]:
    """Modes that change during the records, beyond chance and notably.

    Args:
        modes: of the model that ran.
        records: with inputs, that it ran through; missing inputs count as zero.
        left: (n_samples, n_outputs) a record, NaN where an output is missing.
        output_scale: (n_outputs,) sizes of the outputs.
    """
    looks = [look for look in _looks(modes, records, left, output_scale) if look.how == IN_TIME]
    return tuple(look.mode for look in looks if look.notable(len(looks)).any())


def with_changes(
    model: ModalModel,
    known: Uncertainty,
    records: Sequence[Record],
    left: Sequence[FloatArray],
    *,
    output_scale: FloatArray,
    times: float = 1.0,
) -> tuple[ModalModel, Uncertainty, tuple[str, ...]]:
    """Modes of the system that change in time or with their level, with deviations that hold both ends, and in words.

    Args:
        model: judged modes of the model that ran.
        known: their deviations.
        records: that it ran through, missing inputs count as zero; of none, and without inputs, nothing is told.
        left: (n_samples, n_outputs) a record, NaN where an output is missing.
        output_scale: (n_outputs,) sizes of the outputs.
        times: as large as late what is left is soon after blows (`fading`), and all deviations are.
    """
    model, known = _less_sure(model, known, times)
    looks = _looks(model.system, records, left, output_scale) if records and records[0].n_inputs else []
    told = [(look, look.notable(len(looks))) for look in looks if look.notable(len(looks)).any()]
    modes = list(model.modes)
    for look, notable in told:
        (i,) = (k for k, mode in enumerate(model.modes) if mode is look.mode)
        modes[i] = _widened(modes[i], look, notable)
    known = replace(
        known,
        frequency_std=np.array([mode.frequency_std for mode in modes]),
        damping_ratio_std=np.array([mode.damping_ratio_std for mode in modes]),
    )
    return replace(model, modes=tuple(modes)), known, _sentences(told)


def _less_sure(model: ModalModel, known: Uncertainty, times: float) -> tuple[ModalModel, Uncertainty]:
    """Modes with deviations so many times larger, and all of these; no interval of a pole where that is too much."""
    poles = times if times <= NO_INTERVAL else np.nan
    by = {"frequency_std": poles, "damping_ratio_std": poles, "shape_std": times, "mass_std": times}

    def wider(one: Any) -> Any:
        return replace(
            one, **{name: k * getattr(one, name) for name, k in by.items() if getattr(one, name) is not None}
        )

    modes = tuple(wider(mode) for mode in model.modes)
    return replace(model, modes=modes), replace(wider(known), markov_std=times * known.markov_std)


def _widened(mode: Mode, look: _Look, notable: BoolArray) -> Mode:
    """The mode with intervals that hold both ends of what is notable, and with these in its reason."""
    of_damping, of_frequency = np.abs(look.ends).max(axis=0) / NINETY_FIVE * notable
    spread = float(np.hypot(mode.damping_ratio_std, of_damping / abs(mode.pole)))
    return replace(
        mode,
        frequency_std=float(np.hypot(mode.frequency_std, of_frequency / (2.0 * np.pi))),
        damping_ratio_std=spread,
        damping_resolved=mode.damping_resolved and not (notable[0] and spread > SPREAD * mode.damping_ratio),
        reason=f"{mode.reason}; it changes {look.how}: {' and '.join(_in_words(look, notable))}",
    )


def _looks(
    modes: tuple[Mode, ...], records: Sequence[Record], left: Sequence[FloatArray], output_scale: FloatArray
) -> list[_Look]:
    poles, _ = discrete_poles(modes, records[0].dt)
    shortest = max(1, sum(record.n_samples for record in records) // N_BLOCKS)
    left = _not_linear_in_inputs(records, left)
    looks = []
    for mode, pole in zip(modes, poles, strict=True):
        if mode.kind == "oscillatory" and mode.pole.real < 0.0:
            length = max(shortest, int(np.ceil(LEAST_DECAYS / (-mode.pole.real * records[0].dt))))
            memories = -2.0 * mode.pole.real * length * records[0].dt
            lasting = memories / (memories - 1.0 + np.exp(-memories))
            for how, groups, blocks in _blocks(mode, complex(pole), (records, left), output_scale, length):
                if len(blocks.scores) >= LEAST_BLOCKS:
                    ends, t, chance = _ends(blocks, lasting)
                    looks.append(_Look(mode=mode, how=how, groups=groups, ends=ends, t=t, chance=chance))
    return looks


def _not_linear_in_inputs(records: Sequence[Record], left: Sequence[FloatArray]) -> list[FloatArray]:
    """(n_samples, n_outputs) a record: what is left beside an answer to the inputs of the last samples."""
    n_whole = sum(int(np.isfinite(part).all(axis=1).sum()) for part in left)
    reach = min(REACH, n_whole // (ROWS_EACH * records[0].n_inputs))
    if not reach:
        return list(left)
    size = reach * records[0].n_inputs
    moments, products = np.zeros((size, size)), np.zeros((size, left[0].shape[1]))
    for record, part in zip(records, left, strict=True):
        for rows, inputs in _of_last(record, reach):
            whole = np.isfinite(part[rows]).all(axis=1)
            moments += inputs[whole].T @ inputs[whole]
            products += inputs[whole].T @ part[rows][whole]
    answer = np.linalg.pinv(moments, hermitian=True) @ products
    return [
        np.vstack([part[rows] - inputs @ answer for rows, inputs in _of_last(record, reach)])
        for record, part in zip(records, left, strict=True)
    ]


def _of_last(record: Record, reach: int) -> Iterator[tuple[slice, FloatArray]]:
    """Rows, some at a time, and (n_rows, reach n_inputs) inputs of the last samples, 0 where there are none."""
    padded = np.pad(np.nan_to_num(record.inputs), ((reach - 1, 0), (0, 0)))
    for first in range(0, record.n_samples, ROWS_AT_ONCE):
        n = min(ROWS_AT_ONCE, record.n_samples - first)
        yield slice(first, first + n), np.hstack([padded[first + k : first + k + n] for k in range(reach)])


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Blocks:
    """What tells the changes of a mode at two ends, each by `N_TOLD` numbers, in blocks of rows.

    Attributes:
        scores: (n_blocks, m) T'e by m columns of T.
        products: (n_blocks, m, m) T'T.
        basis: (n_blocks, m, 2 N_TOLD) how much of each number each column takes.
    """

    scores: FloatArray
    products: FloatArray
    basis: FloatArray


def _blocks(
    mode: Mode,
    pole: complex,
    runs: tuple[Sequence[Record], Sequence[FloatArray]],
    output_scale: FloatArray,
    length: int,
) -> list[tuple[str, tuple[str, str], _Blocks]]:
    """Over what, its ends, and the blocks that tell them, for time and for the level."""
    dt = runs[0][0].dt
    recursions = [PoleRecursion.of(np.array([pole]), record.n_samples) for record in runs[0]]
    rest = np.zeros(1, dtype=np.complex128)
    moved = [
        recursion.run((np.nan_to_num(record.inputs) @ mode.participation)[np.newaxis], rest)[0]
        for recursion, record in zip(recursions, runs[0], strict=True)
    ]
    energy = np.sort(np.abs(np.concatenate([states[0] for states in moved])) ** 2)
    middle = energy[np.searchsorted(np.cumsum(energy), 0.5 * energy.sum())]
    scores, products = [], []
    for recursion, states, errors in zip(recursions, moved, runs[1], strict=True):
        answers = []  # of the mode, by decay rate, angular frequency and size: of all rows, then of the high ones
        for part in (states, np.where(np.abs(states) ** 2 > middle, states, 0.0)):
            slope = recursion.run(part, rest)[0][0] * pole * dt
            answers += [slope, 1j * slope, part[0] / -mode.pole.real]
        shape = 2.0 * mode.shape / output_scale
        for k in range(len(errors) // length):
            rows = slice(k * length, (k + 1) * length)
            there, remainder = np.isfinite(errors[rows]), errors[rows] / output_scale
            columns = np.array([(one[rows, np.newaxis] * shape).real[there] for one in answers])
            scores.append(columns @ remainder[there])
            products.append(columns @ columns.T)
    by, each = np.array(scores).reshape(-1, 2 * N_TOLD), np.array(products).reshape(-1, 2 * N_TOLD, 2 * N_TOLD)
    low, high = np.quantile(np.arange(len(by)), QUARTILES) if len(by) else (0.0, 1.0)
    late = ((np.arange(len(by)) - low) / max(high - low, 1.0))[:, np.newaxis, np.newaxis]
    in_time = np.concatenate([(1.0 - late) * np.eye(N_TOLD), late * np.eye(N_TOLD)], axis=2)
    more_where_high = np.array([[1.0, 0.0], [-1.0, 1.0]])  # than in all rows, which have the change of the low ones
    of_halves = np.kron(more_where_high, np.eye(N_TOLD))
    return [
        (IN_TIME, ("early", "late"), _Blocks(scores=by[:, :N_TOLD], products=each[:, :N_TOLD, :N_TOLD], basis=in_time)),
        (
            WITH_LEVEL,
            ("where it is low", "where it is high"),
            _Blocks(scores=by, products=each, basis=np.broadcast_to(of_halves, each.shape)),
        ),
    ]


def _ends(blocks: _Blocks, lasting: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Both changes by weighted least squares, and how sure it is that they differ, with `lasting` times the variance.

    With x = P^(-1/2) s of the scores s and products P of a block, the fit leaves e, of covariance (I - H) per unit of
    noise; each block's own e is divided by (I - H)^(1/2), so that one that draws the fit to itself is no surer for it,
    and the freedom of the sum of their squares is that of its first two moments. A sweep passes a mode in two blocks of
    sixty: through these there is a line, and no freedom.

    Returns:
        (2, 2) end by decay rate and angular frequency; (2,) t of their difference; (2,) its chance.
    """
    m = blocks.scores.shape[1]
    values, vectors = np.linalg.eigh(blocks.products)
    size = np.sqrt(np.maximum(values, 0.0))
    told = size > np.sqrt(np.finfo(float).eps) * size.max()  # a mode at rest tells nothing
    rows = np.einsum("bi,bji,bjp->bip", size * told, vectors, blocks.basis).reshape(-1, 2 * N_TOLD)
    seen = np.einsum("bi,bji,bj->bi", np.where(told, 1.0 / np.where(told, size, 1.0), 0.0), vectors, blocks.scores)
    inverse = np.linalg.pinv(rows.T @ rows, hermitian=True)
    found = inverse @ rows.T @ seen.ravel()
    kept = np.eye(len(rows)) - rows @ inverse @ rows.T
    left = (kept @ seen.ravel()).reshape(-1, m)
    own, directions = np.linalg.eigh(np.stack([kept[k : k + m, k : k + m] for k in range(0, len(rows), m)]))
    t, chance = np.zeros(2), np.ones(2)
    for i in range(2):
        pull = (rows @ (inverse[:, N_TOLD + i] - inverse[:, i])).reshape(-1, m)
        along = np.einsum("bij,bi->bj", directions, pull)
        if (np.abs(along[own < LEAST_LEFT]) > LEAST_LEFT * np.abs(along).max()).any():
            continue
        fair = np.einsum("bij,bj->bi", directions, along / np.sqrt(np.maximum(own, LEAST_LEFT)))
        each = np.zeros((len(rows), len(fair)))
        for k, weights in enumerate(fair):
            each[:, k] = kept[:, m * k : m * (k + 1)] @ weights
        parts = np.einsum("bi,bi->b", fair, left)
        power = float(parts @ parts)
        alike = min(max(0.0, float(parts[1:] @ parts[:-1])) / max(power, TINY), ALIKE)
        variance = max(lasting, (1.0 + alike) / (1.0 - alike)) * power
        moments = each.T @ each
        freedom = np.trace(moments) ** 2 / max(float(np.sum(moments**2)), TINY)
        t[i] = (found[N_TOLD + i] - found[i]) / np.sqrt(max(variance, TINY))
        chance[i] = 2.0 * scipy.special.stdtr(freedom, -abs(t[i]))
    return found.reshape(2, N_TOLD)[:, :2], t, chance


def _in_words(look: _Look, notable: BoolArray) -> list[str]:
    """What is notable of the ends."""
    decay, angular = -look.mode.pole.real, abs(look.mode.pole)
    values = (
        [f"{percent((decay - delta) / angular)} damping" for delta in look.ends[:, 0]],
        [f"{hertz(look.mode.frequency + delta / (2 * np.pi))} Hz" for delta in look.ends[:, 1]],
    )
    return [
        ", ".join(f"{value} {group}" for value, group in zip(values[i], look.groups, strict=True))
        for i in (1, 0)
        if notable[i]
    ]


def _sentences(told: Sequence[tuple[_Look, BoolArray]]) -> tuple[str, ...]:
    """One for time and one for the level, with every mode."""
    sentences = []
    for how in dict.fromkeys(look.how for look, _ in told):
        modes = [
            (f"{hertz(look.mode.frequency)} Hz", "; ".join(_in_words(look, notable)), np.abs(look.t[notable]).max())
            for look, notable in told
            if look.how == how
        ]
        (first, ends, t), *others = modes
        also = "".join(f"; that at {at}: {words} ({far:.1f})" for at, words, far in others)
        sentences.append(
            f"The mode at {first} changes {how}: about {ends} ({t:.1f} standard deviations apart){also}. One linear "
            "model is an average of these, and intervals that are given hold both ends; `modal-report gap` tells "
            "friction, gaps and changing stiffness apart."
        )
    return tuple(sentences)


def fading(model: Realisation, records: Sequence[Record], left: Sequence[FloatArray]) -> float:
    """How many times as large soon after blows as late what is left beside free motion is; 1 where chance makes that.

    Args:
        model: that ran freely.
        records: with blows, nan where a sample was not measured.
        left: (n_samples, n_outputs) a record, by it.
    """
    after = [
        part
        for record, errors, acting in zip(records, left, acting_rows(records), strict=True)
        for part in after_blows(record, errors, acting, least=max(PARTS_OF_BLOW * LEAST_ROWS, model.order))
    ]
    if not after:
        return 1.0
    rest = [own[np.isfinite(own).all(axis=1)] for own in model_runs(model, after).left]
    outputs = [one for one in channels_of(records, channel_scaling(records)) if one.role == "output"]
    steps, digits = np.array([(resolution_of(one), DIGITS * max(one.largest, -one.smallest)) for one in outputs]).T
    floor = np.square(np.nan_to_num(steps)) + np.square(digits)
    n_rows = sum(map(len, rest))
    power = np.maximum(sum(np.square(own).sum(axis=0) for own in rest) / n_rows + floor, TINY)
    length = max(LEAST_ROWS, min(n_rows // N_BLOCKS, min(map(len, rest)) // PARTS_OF_BLOW))
    blocks = []
    for own in rest:
        size = ((np.square(own) + floor) / power).mean(axis=1)
        n = len(own) // length
        blocks.append(np.log(size[: n * length].reshape(n, length).mean(axis=1)))
    times, chance = _larger_first(blocks)
    return times if chance < FADES and times > LARGER_SOON else 1.0


def after_blows(record: Record, values: FloatArray, acting: BoolArray, *, least: int) -> list[Record]:
    """Values (n_samples, n_outputs) after each blow as a record of free motion, where more than `least` rows are whole.

    Rows in which all outputs stand still to the end of the record are none: nothing was measured there.
    """
    strikes = widened(acting).any(axis=1)
    there = np.where(np.isfinite(record.outputs), values, np.nan)
    whole: BoolArray = np.asarray(np.isfinite(there).all(axis=1))
    moves = np.flatnonzero((np.diff(np.nan_to_num(record.outputs), axis=0) != 0.0).any(axis=1))
    quiet = ~strikes & (np.arange(strikes.size) <= moves.max(initial=-1) + 1)
    quiet[: strikes.argmax()] = False
    least = max(least, record.n_outputs + record.n_inputs)
    rows = [slice(*run) for run in runs_of(quiet) if whole[slice(*run)].sum() > least]
    return [Record(np.zeros_like(record.inputs[own]), there[own], record.dt) for own in rows]


def _larger_first(blocks: Sequence[FloatArray]) -> tuple[float, float]:
    """How many times as large as in last thirds the first blocks are, and how often chance makes as much of it.

    Last thirds are asked as they are, and along the line that goes through them: an exponential window, which lets
    noise die away as well, makes one line of all. The lesser is told.

    Args:
        blocks: (n_blocks,) a series, logarithms of powers.
    """
    early, late = zip(*(np.split(own, [2 * len(own) // 3]) for own in blocks), strict=True)
    scatter = np.concatenate([own - own.mean() for own in late])
    lags = np.concatenate([np.arange(len(own)) - 0.5 * (len(own) - 1) for own in late])
    n_late, sloped = len(scatter), float(lags @ scatter) / max(1.0, float(lags @ lags))
    freedom = n_late - len(late)
    if freedom < LEAST_BLOCKS or not scatter.any():
        return 1.0, 1.0
    ends, told = np.cumsum([len(own) for own in late])[:-1], []
    for slope, own in ((0.0, scatter), (sloped, scatter - sloped * lags)):
        lasting = _lasting(np.split(own, ends))
        variance = lasting * float(own @ own) / freedom
        of_slope = variance / max(1.0, float(lags @ lags)) if slope else 0.0
        told.append(_first(early, late, slope, variance, of_slope, freedom=freedom / lasting))
    return min(one for one, _ in told), max(chance for _, chance in told)


def _lasting(series: Sequence[FloatArray]) -> float:
    """How many times the variance of a mean is that of independent values, where neighbours are alike."""
    squares, n = sum(float(own @ own) for own in series), sum(map(len, series))
    # a mean that is taken off makes neighbours look unlike by one over their number
    alike = sum(float(own[1:] @ own[:-1]) for own in series) / max(squares, TINY) + len(series) / n
    alike = min(max(0.0, alike), ALIKE)
    return (1.0 + alike) / (1.0 - alike)


def _first(
    early: Sequence[FloatArray],
    late: Sequence[FloatArray],
    slope: float,
    variance: float,
    of_slope: float,
    *,
    freedom: float,
) -> tuple[float, float]:
    """How many times as large as late ones, carried on along a slope, the first blocks are; and its chance."""
    firsts = 2 ** np.arange(int(np.log2(max(map(len, early)))) + 1)
    found = (1.0, 1.0)
    for n_first in firsts.tolist():
        first = [own[:n_first] for own in early]
        weights = np.array([1.0 / (1.0 / len(one) + 1.0 / len(other)) for one, other in zip(first, late, strict=True)])
        larger = [one.mean() - other.mean() for one, other in zip(first, late, strict=True)]
        sooner = [len(own) + 0.5 * (len(other) - len(one)) for own, one, other in zip(early, first, late, strict=True)]
        mean, ahead = (float(np.average(values, weights=weights)) for values in (larger, sooner))
        mean += slope * ahead
        t = mean / np.sqrt(max(variance / weights.sum() + of_slope * ahead**2, TINY))
        chance = min(1.0, len(firsts) * float(scipy.special.stdtr(max(1.0, freedom), -t)))
        found = min(found, (float(np.exp(0.5 * mean)), chance), key=lambda one: one[1])
    return found


def unsteady_drive(records: Sequence[Record], left: Sequence[FloatArray]) -> tuple[str, ...]:
    """A sentence where what drives records without inputs is far from steady: an event of which the input is missing.

    Args:
        records: of one system; with inputs nothing is said.
        left: (n_samples, n_outputs) a record: errors of the one-step prediction, NaN where an output is missing.
    """
    if records[0].n_inputs:
        return ()
    sizes = np.sqrt(np.mean([np.nanmean(np.square(part), axis=0) for part in left], axis=0))
    worst = 1.0
    for errors in left:
        tenths = [np.nanmean(np.square(part / sizes)) for part in np.array_split(errors, N_PARTS)]
        worst = max(worst, float(np.sqrt(max(tenths) / max(min(tenths), np.finfo(float).tiny))))
    if worst < UNSTEADY:
        return ()
    sentence = (
        f"What drives the record is not steady (its strongest tenth has {worst:.3g} times the rms of its weakest): an "
        "event whose input was not measured, such as an earthquake or a passing train, shapes the spectrum, and its "
        "peaks may be the event's; give the input, or a stretch of ambient motion."
    )
    return (sentence,)


def sums_of_stronger(model: ModalModel, gain: FloatArray) -> tuple[str, ...]:
    """For each mode of what rings down the sum of two or three stronger ones that its pole is, "" where it is none.

    Poles spread evenly over the frequencies, and over the logarithm of decay, lie as near to any of the sums s as d by
    chance this often:

        sum over s of pi d^2 / (pi / dt  |Re s| ln 10^DECADES)

    A sum with a mode and its own conjugate turns as the third does: that is told by other means. Where the pole of one
    that is too strong for a product is such a sum all the same, of none that could be its own product, poles do not
    spread by chance: those of a string, a rod or a shaft of one damping ratio are multiples of each other, and no sum
    tells anything.

    Args:
        model: modes of records that ring down.
        gain: (n_modes,) as `modal.verdict.excitation.driven_gain`.

    Example:
        >>> modes = tuple(
        ...     Mode(pole=s, kind="oscillatory", frequency=abs(s) / 2 / np.pi, damping_ratio=-s.real / abs(s),
        ...          shape=np.ones(1), participation=np.ones(1))
        ...     for s in (-0.5 + 40j, -0.7 + 97j, -1.2 + 57.01j, -1.2 + 62.0j)
        ... )
        >>> model = ModalModel(modes=modes, dt=0.01, indicator_caution=0.1)
        >>> sums_of_stronger(model, np.array([0.99, 0.99, 0.5, 0.5]))
        ('', '', '15.4 - 6.37', '')
    """
    power = np.nan_to_num(gain / np.maximum(1.0 - gain, np.finfo(float).eps))
    order = np.argsort(-power, kind="stable")
    vibrating = [i for i in order.tolist() if model.modes[i].kind == "oscillatory" and model.modes[i].pole.real < 0.0]
    words, harmonic = [""] * len(model), False
    for i, mode in enumerate(model.modes):
        others = [j for j in vibrating[:PARENTS] if j != i]
        parents = [j for j in others if power[i] <= PRODUCT * power[j]]
        if mode.kind in ("oscillatory", "real") and parents:
            words[i] = _sum_of(mode, [model.modes[j] for j in parents], model.dt)
        alike = [j for j in others if power[j] > PRODUCT * power[i]]  # no product of this one, so no sum of it
        if i in vibrating[:PARENTS] and alike and not words[i]:
            harmonic = harmonic or bool(_sum_of(mode, [model.modes[j] for j in alike], model.dt))
    return ("",) * len(model) if harmonic else tuple(words)


def _sum_of(mode: Mode, parents: Sequence[Mode], dt: float) -> str:
    """The sum of two or three poles of the parents that the mode's pole is, in words; "" where it is none."""
    n, half = len(parents), np.pi / dt
    both = np.array([parent.pole for parent in parents] + [parent.pole.conjugate() for parent in parents])
    for count in (2, 3):
        terms = np.array(list(combinations_with_replacement(range(2 * n), count)))
        against = (terms[:, :, np.newaxis] == terms[:, np.newaxis] + n).any(axis=(1, 2))
        sums = both[terms].sum(axis=1)
        kept = (sums.imag >= 0.0) & ~(against & (count > 2))
        terms, sums = terms[kept], sums[kept]
        sums = sums.real + 1j * np.abs((sums.imag + half) % (2.0 * half) - half)  # what is too fast is folded back
        distance = np.abs(mode.pole - sums)
        chance = np.pi * distance.min() ** 2 / (half * -sums.real * np.log(10.0) * DECADES)
        nearest = terms[distance.argmin()]
        deviation = np.sqrt(_variance(mode) + sum(_variance(parents[k % n]) for k in nearest))
        if chance.sum() < NEARER and not distance.min() > FURTHEST * deviation:  # nan where none is stated
            shown = [("- " if k >= n else "+ ") + f"{parents[k % n].frequency:.3g}" for k in sorted(nearest.tolist())]
            return " ".join(shown).removeprefix("+ ")
    return ""


def _variance(mode: Mode) -> float:
    """Of each part of a pole [1/s^2]: a pole is known as well along the real axis as along the imaginary one."""
    return 2.0 * np.pi**2 * (mode.frequency_std**2 + (mode.frequency * mode.damping_ratio_std) ** 2)
