"""The free run of a model in modal form, and how well it repeats held-out rows: the score by which all is chosen.

    x(k+1) = lambda x(k) + b' u(k),   y(k) = Re(c (w x(k))) + D u(k)

A block of samples takes two products: what its inputs and the states at its start make of its outputs, and what its
inputs add to the states after it. The states at the starts of blocks are the same diagonal recursion with lambda^L,
solved by pairing blocks until one is left. Rounding errors are those of the eigenvectors, eps times their condition.

An initial state shows in the starts of blocks as lambda^(L i) x(0), so its response, and the product of that response
with anything else, are one product each and no power of a pole is taken sample by sample.

That state and a constant level of each output come from the training samples by least squares; fitted on the scored
rows they would favour models that are too large. With x = a + j b per pole the free response is Re(w c lambda^k x), so
all sums follow from those of lambda_i^k lambda_j^k and conj(lambda_i)^k lambda_j^k, which have a closed form.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import scipy

from era.realisation import Realisation
from okid.arrays import BoolArray, ComplexArray, FloatArray
from okid.record import Record
from okid.rows import runs_of

TrainingPattern = tuple[npt.NDArray[np.int64], Sequence[tuple[int, int]], int]
"""Outputs, and the runs (first, one past last) of the rows on which these outputs train, every so-manieth of a run."""
MANY_RUNS = 64
"""Ask whether rows take turns where they make more runs than this."""
STATE_REGULARISATION = 1e-9
"""Of each free response's energy over the whole record: keeps a response that no training row shows from growing."""


def fit_initial_state(
    poles: ComplexArray,
    shapes: ComplexArray,
    products: ComplexArray,
    totals: FloatArray,
    *,
    patterns: Sequence[TrainingPattern],
    n_samples: int,
) -> tuple[ComplexArray, FloatArray]:
    """Least squares of what the inputs do not explain on the free responses and a constant.

    Args:
        poles: (n_poles,) one of each conjugate pair.
        shapes: (n_outputs, n_poles) w c, with the weights.
        products: (n_poles,) sum over training samples of what is to be explained times w c lambda^k.
        totals: (n_outputs,) sum over training samples of what is to be explained.
        patterns: every output in one of them.
        n_samples: of the record.

    Returns:
        (n_poles,) initial state and (n_outputs,) level.
    """
    n_poles, n_outputs = poles.size, totals.size
    plain, conjugate = np.zeros((2, n_poles, n_poles), dtype=np.complex128)
    to_level = np.empty((n_poles, n_outputs), dtype=np.complex128)
    n_rows = np.empty(n_outputs)
    same, crossed = np.outer(poles, poles), np.outer(poles.conj(), poles)
    for outputs, runs, step in patterns:
        edges = np.array(runs, dtype=np.int64).reshape(-1, 2)
        own, n_trained = shapes[outputs], float((edges[:, 1] - edges[:, 0]).sum() // step)
        first, last = poles[:, np.newaxis] ** edges[:, 0], poles[:, np.newaxis] ** edges[:, 1]
        ends, crossed_ends = first @ first.T - last @ last.T, first.conj() @ first.T - last.conj() @ last.T
        plain += _series(ends, same**step, n_trained) * (own.T @ own)
        conjugate += _series(crossed_ends, crossed**step, n_trained) * (own.conj().T @ own)
        to_level[:, outputs] = _series((first - last).sum(axis=1), poles**step, n_trained)[:, np.newaxis] * own.T
        n_rows[outputs] = max(1.0, n_trained)

    size = 2 * n_poles + n_outputs
    matrix = np.zeros((size, size))
    a, b, c = slice(0, n_poles), slice(n_poles, 2 * n_poles), slice(2 * n_poles, size)
    matrix[a, a] = 0.5 * (conjugate.real + plain.real)
    matrix[b, b] = 0.5 * (conjugate.real - plain.real)
    matrix[a, b] = -0.5 * (conjugate.imag + plain.imag)
    matrix[b, a] = matrix[a, b].T
    matrix[a, c], matrix[b, c] = to_level.real, -to_level.imag
    matrix[c, a], matrix[c, b] = to_level.real.T, -to_level.imag.T
    matrix[c, c] = np.diag(n_rows)
    vector = np.concatenate([products.real, -products.imag, totals])

    energy = 0.5 * _energies(poles, n_samples) * np.square(np.abs(shapes)).sum(axis=0)
    scale = np.concatenate([energy, energy, n_rows])
    scale = np.sqrt(np.where(scale > 0.0, scale, 1.0))
    scaled = matrix / np.outer(scale, scale)
    scaled[np.diag_indices(size)] += STATE_REGULARISATION
    solution = _solved(scaled, vector / scale) / scale
    return solution[a] + 1j * solution[b], solution[c]


def _solved(matrix: FloatArray, right: FloatArray) -> FloatArray:
    _, solution, info = scipy.linalg.lapack.dposv(matrix, right)
    if info:  # rounding of the sums beyond the regularisation: poles at the edge of stability
        solution = scipy.linalg.lstsq(matrix, right, cond=1e-13, check_finite=False)[0]
    result: FloatArray = solution
    return result


def _series(ends: ComplexArray, ratio: ComplexArray, n_rows: float) -> ComplexArray:
    """Sum of ratio^k over the runs' rows, from the sum of ratio^first - ratio^last over the runs."""
    # a ratio of 1 (an integrator): every term of the series is 1
    one = np.abs(1.0 - ratio) < 1e-12
    return np.where(one, n_rows, ends / np.where(one, 1.0, 1.0 - ratio))


def _energies(poles: ComplexArray, n_samples: int) -> FloatArray:
    """(n_poles,) sum of |pole|^(2 k) over the samples."""
    ratio = np.square(np.abs(poles))
    one = 1.0 - ratio < 1e-12
    result: FloatArray = np.where(one, float(n_samples), (1.0 - ratio**n_samples) / np.where(one, 1.0, 1.0 - ratio))
    return result


BLOCK = 16
"""Samples of a block: longer ones multiply more, shorter ones leave more starts to solve for."""
DIED_OUT = 1e-12
"""Of a free response's first value: what is smaller is not followed any further."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ModalRecursion:
    """Products over blocks of `BLOCK` samples; a complex number is two neighbouring reals.

    Attributes:
        steps: (n_poles,) lambda^BLOCK.
        reach: (BLOCK n_inputs, 2 n_poles) states after a block from its inputs.
        free: (2 n_poles, BLOCK n_outputs) outputs of a block from the states at its start.
        forced: (BLOCK n_inputs, BLOCK n_outputs) outputs of a block from its inputs.
    """

    steps: ComplexArray
    reach: FloatArray
    free: FloatArray
    forced: FloatArray

    @classmethod
    def of(
        cls, poles: ComplexArray, participations: ComplexArray, weighted_shapes: ComplexArray, D: FloatArray
    ) -> "ModalRecursion":
        """The products of one model.

        Args:
            poles: (n_poles,).
            participations: (n_poles, n_inputs) b.
            weighted_shapes: (n_outputs, n_poles) w c.
            D: (n_outputs, n_inputs).
        """
        (n_outputs, n_inputs), n_poles = D.shape, poles.size
        powers = powers_of(poles, BLOCK + 1)
        reach = powers[BLOCK - 1 :: -1, np.newaxis, :] * participations.T
        response = np.conj(powers[:BLOCK, np.newaxis, :] * weighted_shapes)
        free = _as_reals(response.reshape(BLOCK * n_outputs, n_poles)).T
        pulse = np.empty((BLOCK, n_outputs, n_inputs))
        pulse[0] = D
        pulse[1:] = (free[:, : (BLOCK - 1) * n_outputs].T @ _as_reals(participations.T).T).reshape(BLOCK - 1, *D.shape)
        forced = np.zeros((BLOCK, n_inputs, BLOCK, n_outputs))
        for i in range(BLOCK):
            forced[i, :, i:] = pulse[: BLOCK - i].transpose(2, 0, 1)
        return cls(
            steps=powers[BLOCK],
            reach=_as_reals(reach.reshape(BLOCK * n_inputs, n_poles)),
            free=free,
            forced=forced.reshape(BLOCK * n_inputs, BLOCK * n_outputs),
        )

    @classmethod
    def of_model(cls, model: "ModalForm") -> "ModalRecursion":
        """The products of a model in modal form."""
        return cls.of(model.poles, model.participations, model.weights * model.shapes, model.feedthrough)

    def from_rest(self, inputs: FloatArray) -> FloatArray:
        """(n_samples, n_outputs) outputs for (n_samples, n_inputs) inputs."""
        blocks = _in_blocks(inputs)
        starts = _starts(_as_complex(blocks @ self.reach), self.steps)
        outputs = blocks @ self.forced
        outputs += _as_reals(starts) @ self.free
        return outputs.reshape(blocks.shape[0] * BLOCK, -1)[: inputs.shape[0]]

    def n_alive(self, n_samples: int) -> int:
        """Samples, of so many, until the slowest free response has died out."""
        slowest = float(np.abs(self.steps).max(initial=0.0))
        if slowest >= 1.0 - BLOCK * DIED_OUT:
            return n_samples
        n_blocks = 1 + int(np.ceil(np.log(DIED_OUT) / np.log(max(slowest, 1e-300))))
        return min(n_samples, n_blocks * BLOCK)

    def free_response(self, state: ComplexArray, n_samples: int) -> FloatArray:
        """(n_samples, n_outputs) outputs from an initial state without inputs."""
        starts = powers_of(self.steps, -(-n_samples // BLOCK)) * state
        outputs = _as_reals(starts) @ self.free
        return outputs.reshape(starts.shape[0] * BLOCK, -1)[:n_samples]

    def products(self, signals: FloatArray) -> ComplexArray:
        """(n_poles,) sums over rows and outputs of signals (n_samples, n_outputs) times w c lambda^k."""
        blocks = _in_blocks(signals)
        each = _as_complex(blocks @ self.free.T)
        return (powers_of(self.steps, blocks.shape[0]) * each.conj()).sum(axis=0)


def powers_of(poles: ComplexArray, count: int) -> ComplexArray:
    """(count, n_poles) poles^k for k = 0 ... count - 1, by doubling.

    Example:
        >>> powers_of(np.array([0.5 + 0j]), 4).real.ravel().tolist()
        [1.0, 0.5, 0.25, 0.125]
    """
    powers = np.empty((count, poles.size), dtype=np.complex128)
    powers[:1] = 1.0
    done, step = 1, poles
    while done < count:
        take = min(done, count - done)
        np.multiply(powers[:take], step, out=powers[done : done + take])
        done, step = done + take, step * step
    return powers


def _starts(added: ComplexArray, step: ComplexArray) -> ComplexArray:
    """States at the starts of blocks, x_0 = 0 and x_(i+1) = step x_i + added_i; pairs of blocks make longer ones."""
    n_blocks = added.shape[0]
    starts = np.zeros_like(added)
    if n_blocks > 1:
        n_pairs = n_blocks // 2
        first, second = added[: 2 * n_pairs : 2], added[1 : 2 * n_pairs : 2]
        pairs = _starts(step * first + second, step * step)
        starts[: 2 * n_pairs : 2] = pairs
        starts[1 : 2 * n_pairs : 2] = step * pairs + first
        if n_blocks % 2:
            starts[-1] = step * starts[-2] + added[-2]
    return starts


def _in_blocks(signals: FloatArray) -> FloatArray:
    """(n_blocks, BLOCK n_channels), zeros after the end."""
    n_samples, n_channels = signals.shape
    n_blocks = -(-n_samples // BLOCK)
    if n_samples < n_blocks * BLOCK:
        signals = np.vstack([signals, np.zeros((n_blocks * BLOCK - n_samples, n_channels))])
    return np.ascontiguousarray(signals).reshape(n_blocks, BLOCK * n_channels)


def _as_reals(values: ComplexArray) -> FloatArray:
    """(n, 2 m) real and imaginary parts side by side."""
    n_rows, n_columns = values.shape
    return np.ascontiguousarray(values).view(np.float64).reshape(n_rows, 2 * n_columns)


def _as_complex(values: FloatArray) -> ComplexArray:
    n_rows, n_columns = values.shape
    return values.view(np.complex128).reshape(n_rows, n_columns // 2)


LARGEST_EIGENVECTOR_CONDITION = 1e10
"""Frobenius norm of the eigenvectors times that of their inverse: at least the condition number in the 2-norm."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ModalForm:
    """A stable model with the free responses of its poles, one of each conjugate pair.

    Attributes:
        poles: (n_poles,) discrete-time poles with imaginary part >= 0.
        weights: (n_poles,) 2 for a pair, 1 for a real pole: y = Re(shapes @ (weights * state)) + D u.
        shapes: (n_outputs, n_poles).
        participations: (n_poles, n_inputs), so that state(k+1) = poles * state(k) + participations @ u(k).
        feedthrough: (n_outputs, n_inputs) D.
    """

    poles: ComplexArray
    weights: FloatArray
    shapes: ComplexArray
    participations: ComplexArray
    feedthrough: FloatArray

    @property
    def order(self) -> int:
        """Number of real states."""
        return int(self.weights.sum())


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FreeRun:
    """A free run through one record.

    Attributes:
        outputs: (n_samples, n_outputs) simulated, the constant level included.
        level: (n_outputs,) constant that was added to each output.
    """

    outputs: FloatArray
    level: FloatArray


def modal_form(realisation: Realisation) -> ModalForm | None:
    """The model in modal form, or None when it is unstable or its eigenvectors are too close to dependent."""
    return modal_form_of(realisation.A, realisation.B, realisation.C, realisation.D)


def modal_form_of(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray) -> ModalForm | None:
    """As `modal_form`, from the matrices: a search has hundreds of candidates, and checks none of their numbers."""
    poles, vectors = np.linalg.eig(A)
    if np.abs(poles).max(initial=0.0) >= 1.0:
        return None
    # Real coordinates, 2 Re v and -2 Im v for a pair: the two states of a pair cannot differ by rounding.
    upper, lower = poles.imag > 0.0, poles.imag < 0.0
    coordinates = np.where(upper, 2.0 * vectors.real, np.where(lower, 2.0 * vectors.imag, vectors.real))
    try:
        inverse = np.linalg.inv(coordinates)
    except np.linalg.LinAlgError:
        return None
    with np.errstate(over="ignore", invalid="ignore"):  # of an inverse that is nothing but rounding
        condition = np.linalg.norm(coordinates) * np.linalg.norm(inverse)
    if not condition <= LARGEST_EIGENVECTOR_CONDITION:
        return None
    participations = (inverse @ B).astype(np.complex128)
    participations[upper] += 1j * participations[lower]  # LAPACK keeps pairs together, in the same order
    one_of_each = ~lower
    return ModalForm(
        poles=poles[one_of_each].astype(np.complex128),
        weights=np.where(upper[one_of_each], 2.0, 1.0),
        shapes=(C @ vectors[:, one_of_each]).astype(np.complex128),
        participations=participations[one_of_each],
        feedthrough=D,
    )


def free_run(model: ModalForm, record: Record, training: BoolArray) -> FreeRun:
    """Run the model through the whole record, its initial state and the outputs' level fitted to what trains.

    Args:
        model: from `modal_form`.
        record: no input missing (see `filled`).
        training: (n_samples,) rows or (n_samples, n_outputs) samples, True where the initial state may look: never
            at a sample that is missing or was filled.

    Example:
        >>> model = modal_form(Realisation([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.1))
        >>> record = Record([0.0, 0.0, 1.0, 0.0], [11.0, 10.5, 10.25, 11.125], 0.1)  # starts at 1, rests at 10
        >>> run = free_run(model, record, np.ones(4, dtype=bool))
        >>> run.outputs.ravel().round(6).tolist(), run.level.round(6).tolist()
        ([11.0, 10.5, 10.25, 11.125], [10.0])
    """
    recursion = ModalRecursion.of_model(model)
    rests = begins_at_rest(record, model.order)
    outputs = recursion.from_rest(record.inputs)
    state, level = _start_and_level(model, recursion, record.outputs - outputs, training, rests=rests)
    n_alive = recursion.n_alive(record.n_samples)
    outputs[:n_alive] += recursion.free_response(state, n_alive)
    outputs += level
    return FreeRun(outputs=outputs, level=level)


def block_errors(
    model: ModalForm, record: Record, training: BoolArray, held_out: BoolArray, blocks: Sequence[tuple[int, int]]
) -> FloatArray:
    """(n_blocks, n_outputs) squared error of the free run on the held-out rows of each block.

    Args:
        model: from `modal_form`.
        record: nothing missing (see `filled`).
        training: (n_samples,) rows that the initial state may look at.
        held_out: (n_samples,) rows that count, or (n_samples, n_outputs).
        blocks: (first, one past last) row of each; none of their rows trains.
    """
    recursion, left = _left_from_rest(model, record)
    rests = begins_at_rest(record, model.order)
    scored = [left[first:last].copy() for first, last in blocks]  # before what does not train is set to zero
    state, level = _start_and_level(model, recursion, left, training, rests=rests)
    n_alive = recursion.n_alive(record.n_samples)
    free = recursion.free_response(state, n_alive)
    errors = np.empty((len(blocks), record.n_outputs))
    for i, ((first, last), missed) in enumerate(zip(blocks, scored, strict=True)):
        alive = free[first:last]
        missed[: len(alive)] -= alive
        np.subtract(missed, level, out=missed)
        counted = held_out[first:last]
        kept = missed if counted.all() else missed[counted] if counted.ndim == 1 else np.where(counted, missed, 0.0)
        errors[i] = np.einsum("ij,ij->j", kept, kept)
    return errors


def _start_and_level(
    model: ModalForm, recursion: "ModalRecursion", left: FloatArray, training: BoolArray, *, rests: bool
) -> tuple[ComplexArray, FloatArray]:
    """Initial state and level of each output from what the run from rest leaves, which is overwritten."""
    n_samples, n_outputs = left.shape
    patterns = _patterns(training, n_outputs)
    training = training if training.ndim == 2 else np.broadcast_to(training[:, np.newaxis], left.shape)
    if len(patterns) == 1 and len(patterns[0][1]) <= MANY_RUNS and patterns[0][2] == 1:
        edges = [0, *(edge for run in patterns[0][1] for edge in run), n_samples]
        for first, last in zip(edges[::2], edges[1::2], strict=True):
            left[first:last] = 0.0
    else:
        left[~training] = 0.0
    if rests:
        return np.zeros(model.poles.size, dtype=np.complex128), left.sum(axis=0) / np.maximum(training.sum(axis=0), 1)
    return fit_initial_state(
        model.poles,
        model.weights * model.shapes,
        recursion.products(left[: recursion.n_alive(n_samples)]),
        np.ones(n_samples) @ left,
        patterns=patterns,
        n_samples=n_samples,
    )


def initial_state(model: ModalForm, record: Record, training: BoolArray) -> ComplexArray:
    """(n_poles,) modal state at the first sample that `free_run` would start from."""
    if begins_at_rest(record, model.order):
        return np.zeros(model.poles.size, dtype=np.complex128)
    return _start_and_level(model, *_left_from_rest(model, record), training, rests=False)[0]


def begins_at_rest(record: Record, n_states: int) -> bool:
    """Whether nothing acts and no output moves over the first rows, one more than a model has states.

    An observable state that leaves outputs at one level for so long is zero: it is known, and one to fit would let a
    model begin in the past what a blow does.

    Args:
        record: of measured or scaled channels.
        n_states: of the model.

    Example:
        >>> struck = Record(np.r_[0.0, 0.0, 1.0, 0.0], np.r_[5.0, 5.0, 5.0, 6.0], 0.1)
        >>> begins_at_rest(struck, 1), begins_at_rest(struck, 2)
        (True, False)
    """
    if not 0 < n_states < record.n_samples or record.inputs[: n_states + 1].any():
        return False
    return bool((record.outputs[: n_states + 1] == record.outputs[0]).all())


def n_at_rest(record: Record) -> int:
    """Rows at the start in which nothing acts and no output moves."""
    moves = record.inputs.any(axis=1) | (record.outputs != record.outputs[:1]).any(axis=1)
    return int(moves.argmax()) if moves.any() else record.n_samples


def _left_from_rest(model: ModalForm, record: Record) -> tuple["ModalRecursion", FloatArray]:
    """What the run from rest leaves of the outputs, and the products for it, of the inputs that are not zero."""
    moving = record.inputs.any(axis=0)
    weighted = model.weights * model.shapes
    recursion = ModalRecursion.of(model.poles, model.participations[:, moving], weighted, model.feedthrough[:, moving])
    inputs = record.inputs if moving.all() else record.inputs[:, moving]
    return recursion, record.outputs - recursion.from_rest(inputs)


def moving_inputs(records: Sequence[Record]) -> tuple[Record, ...]:
    """With zeros for inputs that stand still in a record: a constant one makes a level and a start, its record's own.

    One that stands still in all records (a step at the start of each) is left as it is: nothing else tells of it.

    Example:
        >>> one, other = Record([[1.0, 2.0], [0.0, 2.0]], [0.0, 1.0], 0.1), Record(np.eye(2), [0.0, 1.0], 0.1)
        >>> moving_inputs([one, other])[0].inputs.tolist(), moving_inputs([one])[0].inputs.tolist()
        ([[1.0, 0.0], [0.0, 0.0]], [[1.0, 2.0], [0.0, 2.0]])
    """
    still = np.array([(record.inputs == record.inputs[:1]).all(axis=0) for record in records])
    still &= ~still.all(axis=0)
    changed = [own & record.inputs[:1].any(axis=0) for own, record in zip(still, records, strict=True)]
    return tuple(
        replace(record, inputs=np.where(own, 0.0, record.inputs)) if own.any() else record
        for own, record in zip(changed, records, strict=True)
    )


def free_runs(model: ModalForm, records: Sequence[Record]) -> list[FloatArray]:
    """(n_samples, n_outputs) run through each record, its start and level fitted to every sample that was measured.

    Example:
        >>> model = modal_form(Realisation([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.1))
        >>> (run,) = free_runs(model, [Record([0.0, 0.0, 1.0, 0.0], [11.0, 10.5, np.nan, 11.125], 0.1)])
        >>> run.ravel().round(6).tolist()
        [11.0, 10.5, 10.25, 11.125]
    """
    return [free_run(model, record, ~np.isnan(record.outputs)).outputs for record in records]


def run_from_rest(model: ModalForm, inputs: FloatArray) -> FloatArray:
    """(n_samples, n_outputs) response to (n_samples, n_inputs) inputs, none missing."""
    return ModalRecursion.of_model(model).from_rest(inputs)


def _patterns(training: BoolArray, n_outputs: int) -> list[TrainingPattern]:
    """Outputs that train on the same rows, and the runs of these rows."""
    if training.ndim == 1 or training.all():
        rows = training if training.ndim == 1 else training[:, 0]
        return [(np.arange(n_outputs), *_runs(rows))]
    together: dict[bytes, list[int]] = {}
    for i, samples in enumerate(training.T):
        together.setdefault(np.packbits(samples).tobytes(), []).append(i)
    return [(np.array(outputs), *_runs(training[:, outputs[0]])) for outputs in together.values()]


def _runs(rows: BoolArray) -> tuple[list[tuple[int, int]], int]:
    """Runs of rows, and 1; of rows that take turns one run for each turn that trains, and the number of turns."""
    runs = runs_of(rows)
    for step in (2, 3) if len(runs) > MANY_RUNS else ():
        if np.array_equal(rows[step:], rows[:-step]):
            turns = np.flatnonzero(rows[:step]).tolist()
            return [(turn, turn + step * (1 + (rows.size - 1 - turn) // step)) for turn in turns], step
    return runs, 1


def filled(records: Sequence[Record]) -> tuple[Record, ...]:
    """Gaps bridged by straight lines, a channel without any sample by zeros, for simulation only.

    No row of a gap is ever fitted or scored.

    Example:
        >>> filled([Record([], [1.0, np.nan, 3.0], 0.1)])[0].outputs.ravel().tolist()
        [1.0, 2.0, 3.0]
    """
    return tuple(
        record
        if record.complete_rows().all()
        else replace(record, inputs=_bridged(record.inputs), outputs=_bridged(record.outputs))
        for record in records
    )


def _bridged(values: FloatArray) -> FloatArray:
    bridged = np.array(values)
    rows = np.arange(values.shape[0])
    for channel in bridged.T:
        there = ~np.isnan(channel)
        channel[:] = np.interp(rows, rows[there], channel[there]) if there.any() else 0.0
    return bridged


def one_step_predictor(realisation: Realisation) -> Realisation:
    """The predictor as a system driven by [inputs, measured outputs]: x+ = (A - K C) x + (B - K D) u + K y.

    Raises:
        ValueError: the realisation has no gain.
    """
    if realisation.K is None:
        raise ValueError("a one-step predictor needs the gain K.")
    A, B, C, D, K = realisation.A, realisation.B, realisation.C, realisation.D, realisation.K
    n_outputs = C.shape[0]
    return Realisation(
        A - K @ C, np.hstack([B - K @ D, K]), C, np.hstack([D, np.zeros((n_outputs, n_outputs))]), realisation.dt
    )


def can_be_foretold(record: Record) -> bool:
    """Whether the record has as many rows as `one_step_predictor` has channels: fewer hold nothing of the noise."""
    return record.n_samples >= record.n_inputs + record.n_outputs


def driven_by_outputs(record: Record) -> Record:
    """The record with its outputs among its inputs, for `one_step_predictor`; gaps are bridged."""
    twin = replace(
        record,
        inputs=np.hstack([record.inputs, record.outputs]),
        input_names=(*record.input_names, *(f"past of {name}" for name in record.output_names)),
        input_units=(*record.input_units, *record.output_units),
    )
    return filled([twin])[0]
