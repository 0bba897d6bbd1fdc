"""Is a mode the same early and late, and at low and high level? Dry friction and a stiffness that drifts say no.

A record is cut into blocks. In each, what the model leaves is compared with what a small change of one pole would do:
with T the derivative of the mode's answer to the inputs by decay rate and angular frequency, and e what is left,

    delta = (T'T)^-1 T'e

is the change of that pole there (one Gauss-Newton step). A line through the changes of all blocks, over time or over
the logarithm of the mode's level, is beyond chance when its slope exceeds what the scatter of the blocks about it
explains, whatever the colour of the noise. Few blocks may hold a mode (a sweep passes it once): how sure their scatter
is counts what each of them weighs.

What rings down and is not quite linear shows products of its modes, x_i x_j and x_i x_j x_k or their conjugates: these
ring down as well, with the sums of the poles for poles (Rugh, Nonlinear System Theory, 1981, section 3.2). One record
fits them as well as modes, and so does every part of it.

References:
    Bell, McCaffrey, Survey Methodology 28(2), 2002, 169-181 (bias and freedom of the scatter of few unequal clusters).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
import scipy

from era.state_recursion import PoleRecursion
from modal.modes.modal_form import discrete_poles
from modal.modes.mode import ModalModel, Mode
from modal.wording.text import hertz, percent
from okid.arrays import BoolArray, FloatArray
from okid.record import Record

N_BLOCKS = 20
"""Cut all records together into about so many blocks: enough to tell their own scatter."""
CHANCE = 0.01
"""Believe in a slope where chance makes as steep a one in this share of records, however many slopes each has."""
NOTABLE = 0.1
"""Speak of a change of the pole by this share of its decay rate: the spread at which damping is not to be quoted."""
LEAST_DECAYS = 1.0
"""Ask that a mode decays so often within a block: else a block remembers the one before."""
UNSTEADY = 3.0
"""Say that what drives a record without inputs is not steady where a tenth of it has so many times the rms of another:
wind and traffic stay within it, and chance does over a hundred samples."""

LEAST_LEFT = 1e-6
"""Take what a line leaves of a block for nothing below this share: the block alone has drawn the line."""
IN_TIME = "during the record"
QUARTILES = (0.25, 0.75)
"""Compare the mode where time or level are at these quantiles of the blocks."""

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
    """A line through the changes of one mode: (2, 2) its ends by decay rate and frequency; (2,) t and chance of both.

    `how` and `groups` say over what, and what its ends are.
    """

    mode: Mode
    how: str
    groups: tuple[str, str]
    ends: FloatArray
    t: FloatArray
    chance: FloatArray

    def notable(self, n_looks: int) -> BoolArray:
        """(2,) whether decay rate and frequency change notably, and beyond chance for so many lines."""
        beyond = self.chance < CHANCE / (2 * n_looks)
        return np.asarray(beyond & (np.abs(np.diff(self.ends, axis=0)[0]) > -NOTABLE * self.mode.pole.real))


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


def changing_modes(
    model: ModalModel, records: Sequence[Record], left: Sequence[FloatArray], *, output_scale: FloatArray
) -> tuple[str, ...]:
    """A sentence for each mode of the system that changes in time or with its level; nothing without inputs.

    Args:
        model: judged modes of the model that ran.
        records: that it ran through; missing inputs count as zero.
        left: (n_samples, n_outputs) a record, NaN where an output is missing.
        output_scale: (n_outputs,) sizes of the outputs.
    """
    if not records[0].n_inputs:
        return ()
    looks = _looks(model.system, records, left, output_scale)
    return tuple(words for look in looks for words in _sentence(look, look.notable(len(looks))))


def _looks(
    modes: tuple[Mode, ...], records: Sequence[Record], left: Sequence[FloatArray], output_scale: FloatArray
) -> list[_Look]:
    poles, _ = discrete_poles(modes, records[0].dt)
    length = max(1, sum(record.n_samples for record in records) // N_BLOCKS)
    looks = []
    for mode, pole in zip(modes, poles, strict=True):
        decays = -mode.pole.real * length * records[0].dt
        if mode.kind == "oscillatory" and decays >= LEAST_DECAYS:
            blocks = _blocks(mode, complex(pole), (records, left), output_scale, length)
            if len(blocks.level) < 8:  # too few for a trend
                continue
            level = np.log(np.maximum(blocks.level, np.finfo(float).tiny))
            for over, how, groups in (
                (np.arange(level.size, dtype=np.float64), IN_TIME, ("early", "late")),
                (level, "with the level of motion", ("where it is low", "where it is high")),
            ):
                if np.diff(np.quantile(over, QUARTILES))[0] > 0.0:  # else it is at rest in most blocks
                    ends, t, chance = _ends(blocks, over)
                    looks.append(_Look(mode=mode, how=how, groups=groups, ends=ends, t=t, chance=chance))
    return looks


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Blocks:
    """(n_blocks, 2) T'e, (n_blocks, 2, 2) T'T and (n_blocks,) energy of the mode in each block."""

    scores: FloatArray
    products: FloatArray
    level: FloatArray


def _blocks(
    mode: Mode,
    pole: complex,
    runs: tuple[Sequence[Record], Sequence[FloatArray]],
    output_scale: FloatArray,
    length: int,
) -> _Blocks:
    scores, products, level = [], [], []
    dt = runs[0][0].dt
    for record, errors in zip(*runs, strict=True):
        recursion = PoleRecursion.of(np.array([pole]), record.n_samples)
        drive = np.nan_to_num(record.inputs) @ mode.participation
        states, _ = recursion.run(drive[np.newaxis], np.zeros(1, dtype=np.complex128))
        slopes, _ = recursion.run(states, np.zeros(1, dtype=np.complex128))
        shape = 2.0 * mode.shape / output_scale
        slope = (slopes[0] * pole * dt)[:, np.newaxis] * shape
        there = np.isfinite(errors)
        rest = np.where(there, errors / output_scale, 0.0)
        tangents = np.stack([np.where(there, slope.real, 0.0), np.where(there, -slope.imag, 0.0)])
        n_blocks = record.n_samples // length
        for k in range(n_blocks):
            rows = slice(k * length, (k + 1) * length)
            part = tangents[:, rows].reshape(2, -1)
            scores.append(part @ rest[rows].ravel())
            products.append(part @ part.T)
            level.append(float(np.mean(np.abs(states[0, rows]) ** 2)))
    return _Blocks(scores=np.array(scores), products=np.array(products), level=np.array(level))


def _ends(blocks: _Blocks, over: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Changes at the lower and upper quartile of `over`, by weighted least squares, and how sure their slope is.

    With x = P^(-1/2) s of the scores s and products P of a block, the line leaves e, of covariance (I - H) per unit of
    noise; each block's own e is divided by (I - H)^(1/2), so that one that draws the line to itself is no surer for it,
    and the freedom of the sum of their squares is that of its first two moments. A sweep passes a mode in two blocks of
    twenty: through these there is a line, and no freedom.

    Returns:
        (2, 2) quartile by decay rate and angular frequency; (2,) t of the slopes; (2,) their chance.
    """
    low, high = np.quantile(over, QUARTILES)
    x = (over - low) / (high - low)  # 0 and 1 there
    values, vectors = np.linalg.eigh(blocks.products)
    size = np.sqrt(np.maximum(values, 0.0))
    told = size > np.sqrt(np.finfo(float).eps) * size.max()  # a mode at rest tells nothing
    basis = np.stack([np.ones_like(x), x], axis=1)
    rows = np.einsum("bi,ba,bji->biaj", size * told, basis, vectors).reshape(-1, 4)
    seen = np.einsum("bi,bji,bj->bi", np.where(told, 1.0 / np.where(told, size, 1.0), 0.0), vectors, blocks.scores)
    inverse = np.linalg.pinv(rows.T @ rows, hermitian=True)
    found = inverse @ rows.T @ seen.ravel()
    kept = np.eye(len(rows)) - rows @ inverse @ rows.T
    left = (kept @ seen.ravel()).reshape(-1, 2)
    own, directions = np.linalg.eigh(np.stack([kept[k : k + 2, k : k + 2] for k in range(0, len(rows), 2)]))
    t, chance = np.zeros(2), np.ones(2)
    for i in range(2):
        pull = (rows @ inverse[:, 2 + i]).reshape(-1, 2)
        along = np.einsum("bij,bi->bj", directions, pull)
        if (np.abs(along[own < LEAST_LEFT]) > LEAST_LEFT * np.abs(along).max()).any():
            continue
        fair = np.einsum("bij,bj->bi", directions, along / np.sqrt(np.maximum(own, LEAST_LEFT)))
        each = np.zeros((len(rows), len(fair)))
        for k, weights in enumerate(fair):
            each[:, k] = kept[:, 2 * k : 2 * k + 2] @ weights
        variance = float(np.sum(np.einsum("bi,bi->b", fair, left) ** 2))
        moments = each.T @ each
        freedom = np.trace(moments) ** 2 / max(float(np.sum(moments**2)), np.finfo(float).tiny)
        t[i] = found[2 + i] / np.sqrt(max(variance, np.finfo(float).tiny))
        chance[i] = 2.0 * scipy.special.stdtr(freedom, -abs(t[i]))
    return np.stack([found[:2], found[:2] + found[2:]]), t, chance


def _sentence(look: _Look, notable: BoolArray) -> list[str]:
    mode, t = look.mode, look.t
    decay, angular = -mode.pole.real, abs(mode.pole)
    shown = []
    if notable[1]:
        values = [f"{hertz(mode.frequency + delta / (2 * np.pi))} Hz {group}" for delta, group in
                  zip(look.ends[:, 1], look.groups, strict=True)]  # fmt: skip
        shown.append(f"{values[0]}, {values[1]} ({abs(t[1]):.1f} standard deviations apart)")
    if notable[0]:
        values = [f"{percent(max(0.0, (decay - delta) / angular))} damping {group}" for delta, group in
                  zip(look.ends[:, 0], look.groups, strict=True)]  # fmt: skip
        shown.append(f"{values[0]}, {values[1]} ({abs(t[0]):.1f} standard deviations apart)")
    if not shown:
        return []
    sentence = (
        f"The mode at {hertz(mode.frequency)} Hz changes {look.how}: about {'; '.join(shown)}. One linear model is an "
        "average of these; `modal-report gap` tells friction, gaps and changing stiffness apart."
    )
    return [sentence]


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
        tenths = [np.nanmean(np.square(part / sizes)) for part in np.array_split(errors, N_BLOCKS // 2)]
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
