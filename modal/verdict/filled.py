"""Does a mode show in the samples that were measured? What was filled is no evidence.

Missing outputs are filled by a model of the others (`modal.preparation.filling`), and hold no noise there. The few
samples of a slow sensor then stand up beside nothing: poles that die out within two or three of them are found again in
every half, and poles whose images fall together there share what nobody measured among them. Halves and deviations
count filled samples as if they told the same. So a mode whose answer was mostly filled is asked once more in what was
measured alone, by Schwarz's criterion: without it, all others free to take its part, the squared error must grow by
more than its numbers cost; in each output by more than a shape does, or that output is none of its.

Which of a line and its images it is, `modal.verdict.images` says where all moves all the time; what rings down is asked
here, with an image in the place of its line.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from modal.modes.modal_form import discrete_poles
from modal.modes.mode import ModalModel
from modal.preparation.filling import holds_filled
from modal.preparation.steps import Preparation
from modal.verdict.excitation import answer_from_rest
from modal.verdict.images import apart_in_spectra, poles_of_images, told_below
from modal.verdict.judgement import doubted
from okid.arrays import TINY, BoolArray, ComplexArray, FloatArray
from okid.record import Record

MOSTLY = 0.45
"""Ask where more than this share of what a mode does was filled, each output in units of its noise."""
ALIKE = 1e-9
"""Take columns for one where their products cannot be told apart below this share."""
OF_IMAGES = "an image of it fits outputs measured in so different rows as well"
OF_FILLED = "no model was fitted to measured samples alone, and errors of what was filled are found again"
WHY = "most of what shows it was filled, and in the samples that were measured it may be chance"


def seen_alone(records: Sequence[Record], measured: Sequence[BoolArray]) -> tuple[Record, ...]:
    """Without the outputs that were not measured there."""
    return tuple(
        replace(one, outputs=np.where(there, one.outputs, np.nan)) for one, there in zip(records, measured, strict=True)
    )


def filled_words(prepared: Preparation, *, of_measured: bool, is_driven: bool) -> tuple[str, ...]:
    """That outputs were filled, where they were, and what that does to modes and deviations."""
    dt = prepared.records[0].dt
    share = _measured_where_present(prepared)
    if share == 1.0:
        return ()
    said = f"{100 * (1.0 - share):.3g} % of the output samples were missing and have been filled by a model of the rest"
    if of_measured:
        said += "; modes and their deviations rest on the measured samples, residuals and pictures on all."
    else:
        said += (
            ", so the fits look better than what was measured allows; deviations have been widened by as much. "
            "Where a record can be repeated, sample all channels together."
        )
    rows = [own[n:] for own, n in zip(prepared.measured, prepared.n_rest, strict=True)]
    below = 0.5 / dt if is_driven else told_below(rows, dt)
    if below == 0.5 / dt:
        return (said,)
    images = (
        f"Lines above {below:.4g} Hz look like others below in the rows in which outputs were measured: the lower is "
        "taken where nothing tells which it is, as in every record sampled at that rate."
    )
    return said, images


def _measured_where_present(prepared: Preparation) -> float:
    """Share of the samples that were measured, of the outputs that a record has: set-ups lack the others by design."""
    here = [own.any(axis=0) for own in prepared.measured]
    if all(map(np.all, here)):
        return prepared.measured_share
    rows = zip(prepared.measured, prepared.n_rest, here, strict=True)
    return float(np.mean(np.concatenate([own[n:, has].ravel() for own, n, has in rows])))


def told_where_measured(
    modes: ModalModel,
    records: Sequence[Record],
    left: Sequence[FloatArray],
    measured: Sequence[BoolArray],
    *,
    is_driven: bool,
    is_fitted: bool,
) -> ModalModel:
    """The modes, doubtful where what was measured does not tell them, or not from each other.

    Args:
        modes: judged.
        records: that they were identified from; the pulse of a release is an input.
        left: (n_samples, n_outputs) a record, what the model's free run leaves.
        measured: the same shape, False where a sample was filled.
        is_driven: throughout; what rings down after a blow or a release is fitted as well by the images of its lines.
        is_fitted: to the outputs or their noise, not to what the filling made of them.
    """
    if not holds_filled(records, measured) or not modes.system:
        return modes
    if not records[0].n_inputs:
        return apart_in_spectra(modes, records, measured)
    if not is_fitted:
        told = [doubted(mode, OF_FILLED) if mode.verdict == "system" else mode for mode in modes.modes]
        return replace(modes, modes=tuple(told))
    there = [own & np.isfinite(errors) for own, errors in zip(measured, left, strict=True)]
    modes = modes if is_driven else _apart_from_images(modes, records, left, there)
    gained, share, counts = _gained(modes, records, left, there)
    told = []
    for i, mode in enumerate(modes.modes):
        of_one = 2 if mode.pole.imag else 1
        beyond = np.maximum(gained[i] - of_one * np.log(np.maximum(counts, 1)), 0.0).sum()
        shows = beyond > of_one * mode.participation.size * np.log(counts.sum())
        told.append(mode if shows or share[i] <= MOSTLY else doubted(mode, WHY))
    return replace(modes, modes=tuple(told))


def _apart_from_images(
    modes: ModalModel, records: Sequence[Record], left: Sequence[FloatArray], there: Sequence[BoolArray]
) -> ModalModel:
    """The modes, doubtful where an image fits what was measured as well: in its place, all shapes free, by Schwarz."""
    poles, is_pair = discrete_poles(modes.modes, modes.dt)
    n_inputs, n_outputs, n = records[0].n_inputs, records[0].n_outputs, len(modes.modes)
    sums = _sums(modes, records, left, there, n_direct=n_inputs)
    owner = np.concatenate([np.arange(n), np.flatnonzero(is_pair), np.full(n_inputs, -1)])
    every = np.ones(owner.size, dtype=np.bool_)
    least = np.array([_explained(own, cross, every) for own, cross in zip(sums.own, sums.cross, strict=True)])
    variance = np.maximum((sums.power - least) / np.maximum(1.0, sums.counts), TINY)
    price, told = 2 * n_outputs * np.log(sums.counts.sum()), list(modes.modes)
    second = n + np.cumsum(is_pair) - 1
    for i in np.flatnonzero(is_pair & [mode.verdict == "system" for mode in modes.modes]).tolist():
        alone, free = replace(modes, modes=(modes.modes[i],)), np.append(owner != i, [True, True])
        answers = [columns[:, i] - 1j * columns[:, second[i]] for columns in sums.columns]
        for image in poles_of_images(complex(poles[i]), answers, there):
            columns = [_answers(alone, np.array([image]), np.array([True]), record) for record in records]
            lost = 0.0
            for o in range(n_outputs):
                own, cross = _bordered(sums, columns, there, o)
                lost += (least[o] - _explained(own, cross, free)) / variance[o]
            if lost <= price:
                told[i] = doubted(told[i], OF_IMAGES)
                break
    return replace(modes, modes=tuple(told))


def _bordered(
    sums: "_Sums", columns: Sequence[FloatArray], there: Sequence[BoolArray], output: int
) -> tuple[FloatArray, FloatArray]:
    """Products of one output with further columns after all others: of columns, and with what was measured."""
    n, more = sums.cross.shape[1], columns[0].shape[1]
    own, cross = np.zeros((n + more, n + more)), np.zeros(n + more)
    own[:n, :n], cross[:n] = sums.own[output], sums.cross[output]
    for known, new, wanted, rows in zip(sums.columns, columns, sums.wanted, there, strict=True):
        part = new[rows[:, output]]
        own[:n, n:] += known[rows[:, output]].T @ part
        own[n:, n:] += part.T @ part
        cross[n:] += part.T @ wanted[rows[:, output], output]
    own[n:, :n] = own[:n, n:].T
    return own, cross


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
    sums = _sums(modes, records, left, there)
    own, cross, sizes, power, counts = sums.own, sums.cross, sums.shapes, sums.power, sums.counts
    whole = sum((columns.T @ columns for columns in sums.columns), np.zeros((n, n)))
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
    """Answers of modes, and their products with each other and with what was measured.

    Attributes:
        columns: (n_samples, n) a record, answers in all rows.
        wanted: (n_samples, n_outputs) a record, what was measured; what was filled means nothing.
        own: (n_outputs, n, n) of answers, where each output was measured.
        cross: (n_outputs, n) with that output.
        shapes: (n_outputs, n) that the model has.
        power: (n_outputs,) squares of each output.
        counts: (n_outputs,) how many samples were measured.
    """

    columns: tuple[FloatArray, ...]
    wanted: tuple[FloatArray, ...]
    own: FloatArray
    cross: FloatArray
    shapes: FloatArray
    power: FloatArray
    counts: FloatArray


def _sums(
    modes: ModalModel,
    records: Sequence[Record],
    left: Sequence[FloatArray],
    there: Sequence[BoolArray],
    *,
    n_direct: int = 0,
) -> _Sums:
    """Of all modes of the model that leaves the errors; so many inputs that act at once come after them, to be free."""
    poles, is_pair = discrete_poles(modes.modes, modes.dt)
    n, n_outputs = poles.size + int(is_pair.sum()) + n_direct, records[0].n_outputs
    own, cross = np.zeros((n_outputs, n, n)), np.zeros((n_outputs, n))
    power, counts = np.zeros(n_outputs), np.zeros(n_outputs)
    shown = np.array([mode.shape for mode in modes.modes]).T
    shapes = np.hstack([shown.real, shown.imag[:, is_pair], np.zeros((n_outputs, n_direct))])
    every, sought = [], []
    for record, errors, rows in zip(records, left, there, strict=True):
        columns = np.hstack([_answers(modes, poles, is_pair, record), record.inputs[:, :n_direct]])
        every.append(columns)
        sought.append(columns @ shapes.T + errors)
        for o in range(n_outputs):
            part, wanted = columns[rows[:, o]], sought[-1][rows[:, o], o]
            own[o] += part.T @ part
            cross[o] += part.T @ wanted
            power[o] += wanted @ wanted
            counts[o] += wanted.size
    return _Sums(
        columns=tuple(every),
        wanted=tuple(sought),
        own=own,
        cross=cross,
        shapes=shapes,
        power=power,
        counts=counts,
    )


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
