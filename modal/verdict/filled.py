"""Does a mode show in the samples that were measured? What was filled is no evidence.

Missing outputs are filled by a model of the others (`modal.preparation.filling`), and hold no noise there. The few
samples of a slow sensor then stand up beside nothing: poles that die out within two or three of them are found again in
every half, and poles whose images fall together there share what nobody measured among them. Halves and deviations
count filled samples as if they told the same. So a mode whose answer was mostly filled is asked once more in what was
measured alone, by Schwarz's criterion: without it, all others free to take its part, the squared error must grow by
more than its numbers cost; in each output by more than a shape does, or that output is none of its.

Where nothing drives throughout, only the outputs tell a line from its images, by the frequencies at which rows were
measured: one that all outputs see at their own rates stands at each of them as well as at its own frequency.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from modal.modes.modal_form import discrete_poles
from modal.modes.mode import ModalModel
from modal.preparation.filling import holds_filled, measured_instead
from modal.verdict.excitation import answer_from_rest
from modal.verdict.judgement import doubted
from okid.arrays import TINY, BoolArray, ComplexArray, FloatArray
from okid.record import Record

MOSTLY = 0.45
"""Ask where more than this share of what a mode does was filled, each output in units of its noise."""
ALIKE_SIZE = 10.0
"""Take what is larger than so many times its image for the line itself, and what decays faster for no image of it."""
MOST_TURNS = 64
"""Take rows to come by turns of no more: a line of the spectrum tells their number."""
STANDS_ALONE = 100.0
"""Take a line of the rows for one of turns where it is so many times what stands beside it."""
RARE = 1e-3
"""Let the rows that chance chooses show a line no more often."""
ALIKE = 1e-9
"""Take columns for one where their products cannot be told apart below this share."""
OF_IMAGES = "an image of it fits outputs measured in so different rows as well"
WHY = "most of what shows it was filled, and in the samples that were measured it may be chance"


def told_where_measured(
    modes: ModalModel,
    records: Sequence[Record],
    left: Sequence[FloatArray],
    measured: Sequence[BoolArray],
    *,
    is_driven: bool,
) -> ModalModel:
    """The modes, doubtful where what was measured does not tell them, or not from each other.

    Args:
        modes: judged.
        records: that they were identified from; the pulse of a release is an input.
        left: (n_samples, n_outputs) a record, what the model's free run leaves.
        measured: the same shape, False where a sample was filled.
        is_driven: throughout; what rings down after a blow or a release is fitted as well by the images of its lines.
    """
    if not holds_filled(records, measured) or not modes.system:
        return modes
    if not records[0].n_inputs:
        return _apart_from_each_other(modes, records, measured)
    there = [own & np.isfinite(errors) for own, errors in zip(measured, left, strict=True)]
    modes = modes if is_driven else _apart_from_images(modes, records, left, there, _shifts(measured))
    gained, share, counts = _gained(modes, records, left, there)
    told = []
    for i, mode in enumerate(modes.modes):
        of_one = 2 if mode.pole.imag else 1
        beyond = np.maximum(gained[i] - of_one * np.log(np.maximum(counts, 1)), 0.0).sum()
        shows = beyond > of_one * mode.participation.size * np.log(counts.sum())
        told.append(mode if shows or share[i] <= MOSTLY else doubted(mode, WHY))
    return replace(modes, modes=tuple(told))


def _apart_from_each_other(modes: ModalModel, records: Sequence[Record], measured: Sequence[BoolArray]) -> ModalModel:
    """The modes, doubtful where they stand at the image of one that is not far smaller."""
    shifts = _shifts(measured) / records[0].dt
    sizes, rate = _sizes(modes, records), 1.0 / records[0].dt
    resolution = 2.0 / max(record.duration for record in records)
    told = list(modes.modes)
    decays = np.array([abs(mode.damping_ratio) * mode.frequency for mode in told])
    for i, one in enumerate(modes.modes):
        for j, other in enumerate(modes.modes):
            alike = max(sizes[i] / sizes[j], decays[j] / decays[i]) <= ALIKE_SIZE  # an image decays as its line does
            if i == j or one.verdict != "system" or other.verdict == "noise" or not alike:
                continue
            width = resolution + 2.0 * decays[i]
            far = shifts[shifts > width]
            images = np.abs(np.concatenate([other.frequency + far, other.frequency - far]))
            images = np.minimum(images % rate, rate - images % rate)
            if (np.abs(images - one.frequency) <= width).any():
                why = f"outputs measured in so different rows do not tell it from an image of {other.frequency:.4g} Hz"
                told[i] = doubted(one, why)
    return replace(modes, modes=tuple(told))


def _apart_from_images(
    modes: ModalModel,
    records: Sequence[Record],
    left: Sequence[FloatArray],
    there: Sequence[BoolArray],
    shifts: FloatArray,
) -> ModalModel:
    """The modes, doubtful where an image fits what was measured as well: in its place, all shapes free, by Schwarz."""
    poles, is_pair = discrete_poles(modes.modes, modes.dt)
    turned = np.concatenate([poles * np.exp(sign * 2j * np.pi * one) for one in shifts for sign in (1.0, -1.0)] or [[]])
    asked = np.array([mode.verdict == "system" for mode in modes.modes]) & is_pair
    whose = np.tile(np.arange(poles.size), 2 * shifts.size)
    turned, whose = turned[asked[whose]], whose[asked[whose]]
    if not whose.size:
        return modes
    images = np.where(turned.imag < 0.0, turned.conj(), turned)
    both = replace(modes, modes=(*modes.modes, *(modes.modes[i] for i in whose)))
    poles, is_pair = np.concatenate([poles, images]), np.concatenate([is_pair, is_pair[whose]])
    at_once = np.full(records[0].n_inputs, -1)
    owner = np.concatenate([np.arange(poles.size), np.flatnonzero(is_pair), at_once])
    sums = _sums(both, poles, is_pair, records, left, there=there, n_shown=len(modes.modes), direct=True)
    n_outputs, known = records[0].n_outputs, owner < len(modes.modes)
    price, told = 2 * n_outputs * np.log(sums.counts.sum()), list(modes.modes)
    for k, i in enumerate(whose):
        with_image = (known & (owner != i)) | (owner == len(modes.modes) + k)
        lost = 0.0
        for own, cross, power, count in zip(sums.own, sums.cross, sums.power, sums.counts, strict=True):
            least = _explained(own, cross, known)
            lost += (least - _explained(own, cross, with_image)) / max((power - least) / max(1.0, count), TINY)
        if lost <= price:
            told[i] = doubted(told[i], OF_IMAGES)
    return replace(modes, modes=tuple(told))


def _shifts(measured: Sequence[BoolArray]) -> FloatArray:
    """[1 / sample] at which lines have images in all outputs that no other was measured instead of."""
    together = np.vstack(measured)
    alone = [i for i in range(together.shape[1]) if not measured_instead(together, i)]
    lines = [_lines(own[:, i]).round(9) for own in measured for i in alone]
    return np.unique(np.concatenate(lines)) if lines else np.empty(0)


def _lines(there: BoolArray) -> FloatArray:
    """Frequencies [1 / sample] of the turns by which rows were measured: beyond chance, and nothing beside them."""
    share, n = float(there.mean()), there.size
    power = np.abs(np.fft.rfft((there - share) * np.hanning(n))) ** 2 / (0.375 * n)
    beside = np.maximum(np.pad(power, (4, 0))[: power.size], np.pad(power, (0, 4))[4:])  # beyond the window's lobe
    least = share * (1.0 - share) * np.log(power.size / RARE)
    lines, slowest = np.fft.rfftfreq(n), 1.0 / MOST_TURNS - 1.0 / n  # a gap, or rest in front, is no turn
    found = lines[(power > least) & (power > STANDS_ALONE * beside) & (lines >= slowest)].tolist()
    exact = [float(Fraction(one).limit_denominator(MOST_TURNS)) for one in found]
    return np.array([other if abs(other - one) <= 1.0 / n else one for one, other in zip(found, exact, strict=True)])


def _sizes(modes: ModalModel, records: Sequence[Record]) -> FloatArray:
    """(n_modes,) power within the half-power bandwidth of each, every output over its own."""
    sizes = np.zeros(len(modes.modes))
    for record in records:
        motion = record.outputs - record.outputs.mean(axis=0)
        power = np.square(np.abs(np.fft.rfft(motion / np.maximum(motion.std(axis=0), TINY), axis=0))).sum(axis=1)
        frequencies = np.fft.rfftfreq(record.n_samples, record.dt)
        for i, mode in enumerate(modes.modes):
            width = max(abs(mode.damping_ratio) * mode.frequency, 2.0 / record.duration)
            sizes[i] += power[np.abs(frequencies - mode.frequency) <= width].sum()
    return sizes


def _gained(
    modes: ModalModel, records: Sequence[Record], left: Sequence[FloatArray], there: Sequence[BoolArray]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What each mode does in each output.

    Returns:
        (n_modes, n_outputs) by how much it lowers the squared error of what was measured, in variances, the shapes of
        all free; (n_modes,) share of its answer that was filled; (n_outputs,) how many samples were measured.
    """
    poles, is_pair = discrete_poles(modes.modes, modes.dt)
    owner = np.concatenate([np.arange(poles.size), np.flatnonzero(is_pair)])
    n, n_outputs = owner.size, records[0].n_outputs
    sums = _sums(modes, poles, is_pair, records, left, there=there, n_shown=len(modes.modes))
    own, cross, whole, sizes, power, counts = sums.own, sums.cross, sums.whole, sums.shapes, sums.power, sums.counts
    gained, every, seen = (np.zeros((poles.size, n_outputs)) for _ in range(3))
    for o in range(n_outputs):
        least = _explained(own[o], cross[o], np.ones(n, dtype=np.bool_))
        variance = max((power[o] - least) / max(1.0, counts[o] - n), TINY)
        for i in range(poles.size):
            mine = owner == i
            gained[i, o] = (least - _explained(own[o], cross[o], ~mine)) / variance
            shape = sizes[o, mine]
            every[i, o] = shape @ whole[np.ix_(mine, mine)] @ shape / variance
            seen[i, o] = shape @ own[o][np.ix_(mine, mine)] @ shape / variance
    return gained, 1.0 - seen.sum(axis=1) / np.maximum(every.sum(axis=1), TINY), counts


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Sums:
    """Products of the answers of modes with each other and with what was measured.

    Attributes:
        own: (n_outputs, n, n) of answers, where each output was measured.
        cross: (n_outputs, n) with that output.
        whole: (n, n) of answers over all rows.
        shapes: (n_outputs, n) that the model has.
        power: (n_outputs,) squares of each output.
        counts: (n_outputs,) how many samples were measured.
    """

    own: FloatArray
    cross: FloatArray
    whole: FloatArray
    shapes: FloatArray
    power: FloatArray
    counts: FloatArray


def _sums(
    modes: ModalModel,
    poles: ComplexArray,
    is_pair: BoolArray,
    records: Sequence[Record],
    left: Sequence[FloatArray],
    *,
    there: Sequence[BoolArray],
    n_shown: int,
    direct: bool = False,
) -> _Sums:
    """Of modes with these poles, of which the first so many are those of the model that leaves the errors.

    Inputs that act at once come after them, where what the model says of these is to be free as well.
    """
    n_direct = records[0].n_inputs if direct else 0
    n, n_outputs = poles.size + int(is_pair.sum()) + n_direct, records[0].n_outputs
    own, cross, whole = np.zeros((n_outputs, n, n)), np.zeros((n_outputs, n)), np.zeros((n, n))
    power, counts = np.zeros(n_outputs), np.zeros(n_outputs)
    shown = np.array([mode.shape for mode in modes.modes]).T * (np.arange(poles.size) < n_shown)
    shapes = np.hstack([shown.real, shown.imag[:, is_pair], np.zeros((n_outputs, n_direct))])
    for record, errors, rows in zip(records, left, there, strict=True):
        columns = np.hstack([_answers(modes, poles, is_pair, record), record.inputs[:, :n_direct]])
        whole += columns.T @ columns
        for o in range(n_outputs):
            part = columns[rows[:, o]]
            wanted = part @ shapes[o] + errors[rows[:, o], o]
            own[o] += part.T @ part
            cross[o] += part.T @ wanted
            power[o] += wanted @ wanted
            counts[o] += wanted.size
    return _Sums(own=own, cross=cross, whole=whole, shapes=shapes, power=power, counts=counts)


def _answers(modes: ModalModel, poles: ComplexArray, is_pair: BoolArray, record: Record) -> FloatArray:
    """(n_samples, n_columns) what the real parts of the modes' shapes multiply, then the imaginary ones of pairs."""
    every, inputs = np.ones(record.n_samples, dtype=np.bool_), np.nan_to_num(record.inputs)
    parts = np.array([1.0, 1j], dtype=np.complex128)
    answers = [
        answer_from_rest(inputs @ mode.participation, complex(pole), (2.0 if pair else 1.0) * parts, every)
        if mode.kind != "unstable"
        else np.zeros((record.n_samples, 2))
        for mode, pole, pair in zip(modes.modes, poles, is_pair, strict=True)
    ]
    both = np.stack(answers, axis=2)
    return np.hstack([both[:, 0], both[:, 1][:, is_pair]])


def _explained(own: FloatArray, cross: FloatArray, free: BoolArray) -> float:
    """Squared size of what some columns explain, from products of all of them and with what is wanted."""
    size = np.sqrt(np.maximum(np.diag(own)[free], TINY))
    scaled, wanted = own[np.ix_(free, free)] / np.outer(size, size), cross[free] / size
    return float(wanted @ np.linalg.pinv(scaled, rcond=ALIKE, hermitian=True) @ wanted)
