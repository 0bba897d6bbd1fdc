"""From a model in modal form to a state-space model in the units of the records, and from there to scaled channels.

A refined model keeps the evidence that it was cut from: its states are turned into the coordinates of the data's Hankel
factors, so that the accuracy indicators go on comparing the model with the data and not with itself.

Where a refinement starts: the modal form of a realisation, and the initial states that suit it best.

Weak modes that a refined model leaves over: found in its error, added, refined together with the others.

An observer of the whole record sees a mode that is far below the others only with the noise of the reduction on top;
the error of a refined model holds that mode and the noise, and nothing else. An observer of the error proposes a pole,
or the answer to an input that takes most of it; it is added, and the refinement of all poles together decides, on
held-out rows, whether it stays.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
import scipy

from era.realisation import HankelFactors, Realisation
from era.state_recursion import lifted
from modal.estimation.cross_validation import FIRST_RIDGE, GrownModel, corner, decompose_coefficients
from modal.estimation.free_run import ModalForm, ModalRecursion, begins_at_rest, initial_state
from modal.estimation.modal_states import NONE, ModalParameters
from modal.estimation.output_error import GROWS_AFTER, GROWS_ON, OutputError, RefinementStep, refine, step_at
from modal.estimation.whitening import output_filters
from modal.modes.modal_form import modal_basis
from okid.arrays import TINY, BoolArray, ComplexArray, FloatArray
from okid.errors import IdentificationError
from okid.gram import lag_gram
from okid.least_squares import solve
from okid.record import Record
from okid.scaling import ChannelScaling, channel_scaling

WORST_COORDINATES = 1e8
"""Condition number from which the data's states and the model's are no longer the same."""


def in_units(step: RefinementStep, start: Realisation, scaling: ChannelScaling) -> Realisation:
    """The refined model in the units of the records and, where they fit, in the state coordinates of the data."""
    A, B, C = real_modal_form(step)
    n = step.layout.n_poles
    D = step.linear.coefficients[2 * n : 2 * n + step.layout.n_inputs].T
    return in_data_states(Realisation(A, B, C, D, start.dt), start, scaling)


def in_data_states(model: Realisation, start: Realisation, scaling: ChannelScaling) -> Realisation:
    """A model of scaled channels in the units of the records and, where they fit, in the data's state coordinates."""
    A, B, C, D, K = model.A, model.B, model.C, model.D, model.K
    factors = start.factors
    if factors is not None:
        coordinates = _data_coordinates(A, C * (scaling.output_scale / factors.output_scale)[:, np.newaxis], factors)
        if coordinates is None:
            factors = None
        else:
            A, B = coordinates @ A @ np.linalg.inv(coordinates), coordinates @ B
            C = C @ np.linalg.inv(coordinates)
            K = None if K is None else coordinates @ K
            factors = factors.truncated(A.shape[0])
    into, out = scaling.input_scale, scaling.output_scale[:, np.newaxis]
    return Realisation(
        A,
        B / into,
        C * out,
        D * out / into,
        start.dt,
        K=None if K is None else K / scaling.output_scale,
        singular_values=start.singular_values,
        factors=factors,
    )


def real_modal_form(step: RefinementStep) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A, B, C with one state for a real pole and two, real and imaginary part, for a pair."""
    parameters, c = step.parameters, step.linear.shapes
    order = step.order
    A, B = np.zeros((order, order)), np.zeros((order, step.layout.n_inputs))
    C = np.zeros((step.layout.n_outputs, order))
    row = 0
    for i, pole in enumerate(parameters.poles):
        if parameters.is_pair[i]:
            own = slice(row, row + 2)
            A[own, own] = [[pole.real, -pole.imag], [pole.imag, pole.real]]
            B[own] = [parameters.inputs[i].real, parameters.inputs[i].imag]
            C[:, own] = np.column_stack([c[:, i].real, -c[:, i].imag])
        else:
            A[row, row], B[row], C[:, row] = pole.real, parameters.inputs[i].real, c[:, i].real
        row += 2 if parameters.is_pair[i] else 1
    return A, B, C


def _data_coordinates(A: FloatArray, C: FloatArray, factors: HankelFactors) -> FloatArray | None:
    """(order, order) T with (data's observability) T close to the model's, None where T has no safe inverse."""
    order = A.shape[0]
    if order > factors.observability.shape[1]:
        return None
    measured = factors.truncated(order).observability
    length = 1 << (factors.n_block_rows - 1).bit_length()
    modelled = lifted(A, C, length)[0][: measured.shape[0]]
    T = np.asarray(np.linalg.lstsq(measured, modelled, rcond=None)[0], dtype=np.float64)
    return T if np.linalg.cond(T) < WORST_COORDINATES else None


def starting_parameters(realisation: Realisation, data: OutputError, *, held_out: int = NONE) -> RefinementStep | None:
    """Modal form of a stable model with initial states fitted to the training rows.

    None where it is unstable, or where all its poles are zero: a pulse response that ends is left to the observer.
    """
    basis = modal_basis(realisation)
    if not basis.poles.size or np.abs(basis.poles).max() >= 1.0:
        return None
    # unit size of each participation, so that shapes and states have comparable sizes
    size = np.linalg.norm(basis.inputs, axis=1)
    size = np.where(size > 0.0, size, 1.0)
    form = ModalForm(
        poles=basis.poles,
        weights=np.where(basis.is_pair, 2.0, 1.0),
        shapes=basis.outputs * size,
        participations=basis.inputs / size[:, np.newaxis],
        feedthrough=realisation.D,
    )
    training = _training_rows(data, held_out)
    states = [initial_state(form, record, rows) for record, rows in zip(data.records, training, strict=True)]
    start = ModalParameters(
        poles=form.poles,
        is_pair=basis.is_pair,
        inputs=_real_unless(form.participations, basis.is_pair[:, np.newaxis]),
        states=_real_unless(np.array(states), basis.is_pair),
    )
    return step_at(start, data, held_out=held_out)


def _training_rows(data: OutputError, held_out: int) -> list[BoolArray]:
    """(n_samples,) a record, True where a row counts and is not held out."""
    training = [rows.copy() for rows in data.rows]
    for block in data.blocks:
        if block.label == held_out:
            training[block.record][block.rows] = False
    return training


def _real_unless(values: ComplexArray, is_pair: BoolArray) -> ComplexArray:
    return np.where(is_pair, values, values.real).astype(np.complex128)


Proposal = Literal["observer", "answer", "blow"]
"""What a weak mode is found by."""
CANDIDATE_ORDER = 8
"""Give the model of the error so many states: the strongest of its poles is taken."""
LONGEST_OBSERVER = 64
ROWS_AN_UNKNOWN = 8
"""Ask for so many rows for each unknown of that observer."""
LARGEST_POLE = 0.9999
N_LAGS = 200
DECAYS_A_DECADE = 4
"""Look for a pole at so many decays: half a step beside its own a matched filter loses 2 % of what it gains."""
CHANCE = 0.01
"""Add no answer to a blow that white noise would show so often, at any frequency and decay that is looked at."""
FASTEST = 0.5
"""Decay per sample up to which a pole is looked for."""
MOST_LAGS = 1 << 14
"""Look for no pole that rings for longer [samples]: one that does is found as one that rings so long, and refined."""


def nothing_yet(data: OutputError) -> RefinementStep:
    """The model without a pole: levels, and what inputs do at once."""
    n_records, n_inputs = len(data.records), data.records[0].n_inputs
    nothing = ModalParameters(
        poles=np.empty(0, dtype=np.complex128),
        is_pair=np.empty(0, dtype=np.bool_),
        inputs=np.empty((0, n_inputs), dtype=np.complex128),
        states=np.empty((n_records, 0), dtype=np.complex128),
    )
    return step_at(nothing, data)


def with_weak_modes(
    step: RefinementStep,
    data: OutputError,
    ways: Sequence[Proposal],
    turns: Callable[[RefinementStep], tuple[RefinementStep, OutputError, tuple[FloatArray, ...]]],
    grown: GrownModel | None = None,
) -> tuple[RefinementStep, OutputError]:
    """The model with a weak mode more for each way to find one, and the data with the likeliest forces.

    Args:
        step: a refined model.
        data: that it was fitted to.
        ways: of finding each.
        turns: the model and the likeliest forces by turns, and data with those.
        grown: from nothing so far before; on the same rows it would grow just so again.
    """
    if grown is not None and _same_rows(grown.data, data):
        told = replace(grown.told, blocks=data.blocks)
        return step_at(grown.parameters, told), told
    step, told, _ = turns(step)
    for way in ways:
        larger = with_weak_mode(step, told, by=way)
        step = step if larger is None else refine(larger, told, n_steps=GROWS_AFTER, least_gain=GROWS_ON)[-1]
        step, told, _ = turns(step)
    return step, told


def _same_rows(one: OutputError, other: OutputError) -> bool:
    """Whether all samples are the same, and count as much."""
    own, others = (
        [*data.rows, *data.measured, *(part for record in data.records for part in (record.inputs, record.outputs))]
        for data in (one, other)
    )
    same = len(own) == len(others) and all(map(np.array_equal, own, others))
    return same and (one.n_direct, one.elsewhere) == (other.n_direct, other.elsewhere)


def with_weak_mode(
    step: RefinementStep, data: OutputError, *, held_out: int = NONE, by: Proposal = "answer"
) -> RefinementStep | None:
    """The model with the strongest mode of its error added, not refined yet; None where there is none to add.

    Args:
        step: a refined model.
        data: that it was fitted to.
        held_out: rows with this label are not looked at, unless rows take turns, which leaves no past without a gap:
            they help to find a mode, then, not to keep it.
        by: "observer": OKID and ERA on the inputs and the error, of whose poles the strongest is taken; they know how
            the noise and the inputs are coloured, and ask for rows without gaps. "answer": what stands highest above
            the noise beside it. "blow": what takes most of the squared error, and nothing that white noise would be
            taken for; what short events leave is mostly answers, with no noise beside them.
    """
    seen = NONE if any(block.step > 1 for block in data.blocks) else held_out
    measured = errors_of(step, data, held_out=seen)
    errors = [np.nan_to_num(error) for error in measured]
    inputs = [record.inputs for record in data.records]
    if not all(any(one.any() for one in each) for each in (errors, inputs)):
        return None
    left = replace(
        data, records=tuple(replace(one, outputs=error) for one, error in zip(data.records, errors, strict=True))
    )
    if by == "observer":
        several = tuple(
            replace(one, outputs=np.where(np.isnan(error).all(axis=1, keepdims=True), np.nan, np.nan_to_num(error)))
            for one, error in zip(data.records, measured, strict=True)
            if not np.isnan(error).all()  # a stub may lie within what is held out
        )
        proposed = _strongest_of_observer(several, left, held_out)
        joined = None if proposed is None else _joined(step.parameters, proposed.parameters)
        return None if joined is None else step_at(joined, data, held_out=held_out)
    n_lags = min(max(len(error) for error in errors), MOST_LAGS)
    cross, own = _correlations(errors, inputs, n_lags)
    length = scipy.fft.next_fast_len(2 * n_lags, real=True)
    noise = np.array([1.0 / np.abs(np.fft.rfft(one, length)) ** 2 for one in output_filters(errors)])
    power = np.mean(np.concatenate(errors) ** 2, axis=0)[:, np.newaxis]
    flat = np.broadcast_to(np.where(power > 0.0, power, 1.0), noise.shape)
    best, largest = None, 0.0
    for pole, acting in dict.fromkeys(_strongest_answers(cross, own, (flat,) if by == "blow" else (flat, noise))):
        found = _answer_alone(pole, acting, data, left, held_out)
        after = [np.nan_to_num(error) for error in errors_of(found, left, held_out=seen)]
        white = [np.ones(1) / np.sqrt(level[0]) for level in flat] if by == "blow" else output_filters(after)
        gain = 0.5 * (_energy(errors, white) - _energy(after, white))
        if gain > largest:
            best, largest = found, gain
    n_looked = _decays(n_lags).size * n_lags * len(own)
    if best is None or (by == "blow" and n_looked * scipy.special.gammaincc(len(flat), largest) >= CHANCE):
        return None
    return step_at(_joined(step.parameters, best.parameters), data, held_out=held_out)


def _strongest_of_observer(records: tuple[Record, ...], left: OutputError, held_out: int) -> RefinementStep | None:
    """The pole that takes most of the errors, of those that OKID and ERA find in them; NaN where no row counts."""
    found = _model_of_error(records)
    if found is None:
        return None
    candidates = starting_parameters(found, left, held_out=held_out)
    if candidates is None:
        return None
    every = candidates.parameters
    vibrating = np.flatnonzero(every.is_pair & (np.abs(every.poles) < LARGEST_POLE))
    alone = [
        ModalParameters(
            poles=every.poles[[i]],
            is_pair=every.is_pair[[i]],
            inputs=every.inputs[[i]],
            states=every.states[:, [i]],
        )
        for i in vibrating.tolist()
    ]
    steps = (step_at(one, left, held_out=held_out) for one in alone)
    return min(steps, key=lambda one: one.error, default=None)


def _model_of_error(records: tuple[Record, ...]) -> Realisation | None:
    scaling = channel_scaling(records)
    n_channels = records[0].n_inputs + records[0].n_outputs
    n_samples = sum(record.n_samples for record in records)
    longest = max(1, min(LONGEST_OBSERVER, n_samples // (ROWS_AN_UNKNOWN * n_channels)))
    try:
        gram = lag_gram(records, longest, scaling=scaling)
        coefficients = solve(gram, FIRST_RIDGE)
    except IdentificationError:
        return None
    found = decompose_coefficients(coefficients, N_LAGS, records[0].dt, CANDIDATE_ORDER)
    if found is None:
        return None
    order = min(CANDIDATE_ORDER, found.rank, found.max_order)
    model = corner(found, order)
    while model is not None and np.abs(np.linalg.eigvals(model.A)).max(initial=0.0) >= 1.0:
        order -= 1
        model = corner(found, order) if order > 0 else None
    if model is None:
        return None
    out = scaling.output_scale[:, np.newaxis]
    return Realisation(
        model.A, model.B / scaling.input_scale, model.C * out, model.D * out / scaling.input_scale, model.dt
    )


def _answer_alone(pole: complex, acting: int, data: OutputError, left: OutputError, held_out: int) -> RefinementStep:
    """The model of this one pole of what is left, with the start that each record asks for."""
    n_records, n_inputs = len(data.records), data.records[0].n_inputs
    from_rest = ModalParameters(
        poles=np.array([pole]),
        is_pair=np.ones(1, dtype=np.bool_),
        inputs=(np.arange(n_inputs) == acting).astype(np.complex128)[np.newaxis],
        states=np.zeros((n_records, 1), dtype=np.complex128),
    )
    alone = step_at(from_rest, left, held_out=held_out)
    form = ModalForm(
        poles=from_rest.poles,
        weights=np.ones(1),
        shapes=alone.linear.shapes,
        participations=from_rest.inputs,
        feedthrough=np.zeros((left.records[0].n_outputs, n_inputs)),
    )
    states = from_rest.states.copy()
    for i, rows in enumerate(_training_rows(data, held_out)):
        if not begins_at_rest(data.records[i], 2):
            states[i] = initial_state(form, left.records[i], rows)
    return step_at(replace(from_rest, states=states), left, held_out=held_out) if states.any() else alone


def _decays(n_lags: int) -> FloatArray:
    """(n_decays,) a sample, at which a pole is looked for."""
    return np.geomspace(1.0 / n_lags, FASTEST, max(2, round(DECAYS_A_DECADE * np.log10(FASTEST * n_lags))))


def _strongest_answers(cross: FloatArray, own: FloatArray, levels: Sequence[FloatArray]) -> list[tuple[complex, int]]:
    """The pole, and the input, whose answer from rest takes most of the errors over each level of noise.

    A state driven by u has the product with an error e that is the one-sided transform of their correlation, and the
    energy that is that of u's own:

        sum e(k) x*(k) = sum over m > 0 of r(m) (lambda*)^(m-1),   r(m) = sum e(k+m) u(k)
        sum |x(k)|^2 = (rho(0) + 2 Re sum over l > 0 of rho(l) lambda^l) / (1 - |lambda|^2)

    so one FFT a decay tells the gain |sum e x*|^2 / sum |x|^2 of all frequencies. Over the power of the noise there it
    is distributed as a sum of unit exponentials, one an output, and the largest of M is beyond g as often as M times
    one (Bonferroni).
    """
    n_lags = own.shape[1]
    length = scipy.fft.next_fast_len(2 * n_lags, real=True)
    lags, angle = np.arange(n_lags - 1), 2.0 * np.pi * np.arange(length // 2 + 1) / length
    least = np.finfo(np.float64).eps * own[:, :1] + TINY  # rounding, and an input that never moves
    best: list[tuple[float, complex, int]] = [(-1.0, 0j, 0) for _ in levels]
    shares = [1.0 / level for level in levels]
    for decay in _decays(n_lags):
        there = slice(np.searchsorted(angle, decay, side="right"), np.searchsorted(angle, np.pi - decay))
        if there.start >= there.stop:
            continue
        fading = np.exp(-decay * lags)
        products = scipy.fft.rfft(cross[..., 1:] * fading, length)[..., there]
        squares = products.real**2 + products.imag**2
        turned = scipy.fft.rfft(own[:, 1:] * fading, length)[:, there] * np.exp(-decay - 1j * angle[there])
        energy = np.maximum(own[:, :1] + 2.0 * turned.real, least) / -np.expm1(-2.0 * decay)
        for i, share in enumerate(shares):
            gains = np.einsum("jok,ok->jk", squares, share[:, there]) / energy
            j, k = np.unravel_index(int(gains.argmax()), gains.shape)
            if gains[j, k] > best[i][0]:
                best[i] = (float(gains[j, k]), complex(np.exp(-decay + 1j * angle[there][k])), int(j))
    return [(pole, acting) for _, pole, acting in best]


def _energy(errors: Sequence[FloatArray], filters: Sequence[FloatArray]) -> float:
    return float(
        sum(
            np.square(np.convolve(error[:, o], one, "valid")).sum()
            for error in errors
            for o, one in enumerate(filters)
            if len(error) >= one.size  # else none of its rows has a whole past
        )
    )


def _correlations(
    errors: Sequence[FloatArray], inputs: Sequence[FloatArray], n_lags: int
) -> tuple[FloatArray, FloatArray]:
    """(n_inputs, n_outputs, n_lags) r and (n_inputs, n_lags) rho, summed stretch by stretch (overlap-save)."""
    length = scipy.fft.next_fast_len(4 * n_lags, real=True)
    hop = length - n_lags + 1
    n_inputs, n_outputs = inputs[0].shape[1], errors[0].shape[1]
    cross = np.zeros((n_inputs, n_outputs, length // 2 + 1), dtype=np.complex128)
    own = np.zeros((n_inputs, length // 2 + 1), dtype=np.complex128)
    for error, given in zip(errors, inputs, strict=True):
        for first in range(0, len(error), hop):
            acting = scipy.fft.rfft(given[first : first + hop].T, length)
            later, answer = (scipy.fft.rfft(one[first : first + length].T, length) for one in (given, error))
            own += acting.conj() * later
            cross += acting.conj()[:, np.newaxis] * answer
    return scipy.fft.irfft(cross, length)[..., :n_lags], scipy.fft.irfft(own, length)[:, :n_lags]


def errors_of(step: RefinementStep, data: OutputError, *, held_out: int = NONE) -> list[FloatArray]:
    """(n_samples, n_outputs) a record: errors of the free run, NaN where a sample does not count."""
    errors = []
    parameters, coefficients = step.parameters, step.linear.coefficients
    layout = step.layout
    n_states, n_linear = 2 * layout.n_poles, 2 * layout.n_poles + layout.n_direct
    direct = np.zeros((layout.n_outputs, layout.n_inputs))
    direct[:, : layout.n_direct] = coefficients[n_states:n_linear].T
    recursion = ModalRecursion.of(parameters.poles, parameters.inputs, step.linear.shapes, direct)
    for index, (record, state, there) in enumerate(zip(data.records, parameters.states, data.counted, strict=True)):
        error = record.outputs - recursion.from_rest(record.inputs)
        n_alive = recursion.n_alive(record.n_samples)
        error[:n_alive] -= recursion.free_response(state, n_alive)
        error -= coefficients[n_linear + index]
        error[~there] = np.nan
        for block in data.blocks:
            if block.record == index and block.label == held_out:
                error[block.rows] = np.nan
        errors.append(error)
    return errors


def _joined(first: ModalParameters, second: ModalParameters) -> ModalParameters:
    return ModalParameters(
        poles=np.concatenate([first.poles, second.poles]),
        is_pair=np.concatenate([first.is_pair, second.is_pair]),
        inputs=np.vstack([first.inputs, second.inputs]),
        states=np.hstack([first.states, second.states]),
    )
