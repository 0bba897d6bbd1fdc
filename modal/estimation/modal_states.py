"""Modal states of a driven model, their sensitivities, and the one Gram matrix that a refinement step needs.

Each pole has one complex state in each record, driven by all inputs and by what it starts from:

    x_i(k+1) = lambda_i x_i(k) + b_i' u(k),   x_i(0) = x0_i,   y(k) = sum over i of Re(c_i x_i(k)) + D u(k) + level

Sensitivities of a state run through the same pole: to lambda_i the state once more filtered, to b_ij the filtered input
u_j, to x0_i the power lambda_i^k. All sums over rows that a Gauss-Newton step and its linear part need are products of
these signals, so a record is passed once and only its Gram matrix is kept, one for each block of rows.

One BLAS thread while we work.

Our matrices have a few hundred rows. For them a second thread gains nothing, and on a busy machine the threads wait for
each other: an identification took 42 s of processor time instead of 5 s on two cores with a load of eight.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from era.state_recursion import PoleRecursion
from modal.estimation.free_run import powers_of
from okid.arrays import BoolArray, ComplexArray, FloatArray
from okid.record import Record

PARTS = 10
"""Parts of all records whose sums are kept apart where rows take turns, at least one a record."""
IndexArray = npt.NDArray[np.intp]

LONGEST_CHUNK = 8192
"""Rows of signals that are held at a time."""
SHORT_CHUNK = 1024
"""Rows that are held where sums follow from each other: in cache."""
FEWEST_DRIVES = 4
"""Let sums follow from each other from so many inputs on."""
FEWEST_ROWS = 256
"""Let sums follow from each other over at least so many rows: those over fewer are made sooner."""
APART = 0.05
"""Sum up what two poles give whose product is no further from one: rounding of the rest grows with its third power."""
DIED_OUT = 1e-100
"""Free responses below this are set to zero: their squares would be too small for a normal number, and so slow."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ModalParameters:
    """The nonlinear parameters of a model in modal form; C, D and levels follow from them by least squares.

    Attributes:
        poles: (n_poles,) discrete poles inside the unit circle, one of each conjugate pair, imaginary part >= 0.
        is_pair: (n_poles,) False for a pole on the real axis, whose inputs and states are real.
        inputs: (n_poles, n_inputs) b.
        states: (n_records, n_poles) x0.
    """

    poles: ComplexArray
    is_pair: BoolArray
    inputs: ComplexArray
    states: ComplexArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Block:
    """Consecutive rows of one record whose sums are kept apart.

    Attributes:
        record: index of the record.
        first: first row.
        last: one past the last row.
        label: the fold that holds these rows out, -1 for none.
        step: between two of its rows; above 1 blocks of other folds have the rows between.
    """

    record: int
    first: int
    last: int
    label: int
    step: int = 1

    @property
    def rows(self) -> slice:
        """Its rows among those of its record."""
        return slice(self.first, self.last, self.step)


def blocks_of(records: Sequence[Record], held_out: Sequence[Sequence[Sequence[tuple[int, int]]]]) -> tuple[Block, ...]:
    """The records cut into the runs of rows that each fold holds out, and what lies between them.

    Args:
        records: to be cut.
        held_out: [fold][record] runs (first row, one past the last row); no row in two folds.

    Example:
        >>> record = Record([], np.arange(6.0), 0.1)
        >>> [(block.first, block.last, block.label) for block in blocks_of([record], [[[(2, 4)]]])]
        [(0, 2, -1), (2, 4, 0), (4, 6, -1)]
    """
    blocks = []
    for r, record in enumerate(records):
        runs = sorted((first, last, label) for label, fold in enumerate(held_out) for first, last in fold[r])
        done = 0
        for first, last, label in (*runs, (record.n_samples, record.n_samples, -1)):
            if first > done:
                blocks.append(Block(record=r, first=done, last=first, label=-1))
            if last > first:
                blocks.append(Block(record=r, first=first, last=last, label=label))
            done = last
    return tuple(blocks)


def parts_of(n_samples: int, n_records: int) -> list[tuple[int, int]]:
    """(first, one past last) row of the parts of one of so many records in which rows that take turns are summed.

    Example:
        >>> parts_of(40, 5)
        [(0, 20), (20, 40)]
    """
    n_parts = min(-(-PARTS // n_records), max(1, n_samples // PARTS))
    return list(pairwise(np.linspace(0, n_samples, n_parts + 1).round().astype(int).tolist()))


def blocks_by_turns(
    records: Sequence[Record], n_turns: int, *, first_rows: Sequence[int] | None = None
) -> tuple[Block, ...]:
    """The records in some parts of consecutive rows, of which row k goes to the fold k mod `n_turns`.

    Args:
        records: to be cut.
        n_turns: number of folds.
        first_rows: number that each record's first row has; 0 unless given.

    Example:
        >>> [(block.first, block.last, block.label) for block in blocks_by_turns([Record([], np.arange(5.0), 0.1)], 2)]
        [(0, 5, 0), (1, 5, 1)]
    """
    blocks = []
    for r, record in enumerate(records):
        offset = 0 if first_rows is None else first_rows[r]
        for first, last in parts_of(record.n_samples, len(records)):
            for turn in range(n_turns):
                start = first + (turn - offset - first) % n_turns
                if start < last:
                    blocks.append(Block(record=r, first=start, last=last, label=turn, step=n_turns))
    return tuple(blocks)


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalLayout:
    """Where each signal stands in the Gram matrix; complex signals as real part, imaginary part.

    Regressors of the linear part: states, the first `n_direct` inputs, one level a record. Sensitivities: to the poles,
    to the inputs' participations, to the initial states. Last the outputs.
    """

    n_poles: int
    n_inputs: int
    n_outputs: int
    n_records: int
    n_direct: int

    @property
    def n_regressors(self) -> int:
        """States (real and imaginary part), inputs, levels."""
        return 2 * self.n_poles + self.n_direct + self.n_records

    @property
    def n_sensitivities(self) -> int:
        """Complex ones."""
        return self.n_poles * (1 + self.n_inputs + self.n_records)

    @property
    def regressors(self) -> slice:
        """All regressors of the linear part."""
        return slice(0, self.n_regressors)

    @property
    def real(self) -> slice:
        """Real parts of the sensitivities."""
        return slice(self.n_regressors, self.n_regressors + self.n_sensitivities)

    @property
    def imaginary(self) -> slice:
        """Imaginary parts of the sensitivities."""
        return slice(self.real.stop, self.real.stop + self.n_sensitivities)

    @property
    def outputs(self) -> slice:
        """Measured outputs."""
        return slice(self.imaginary.stop, self.imaginary.stop + self.n_outputs)

    @property
    def size(self) -> int:
        """Number of real signals."""
        return self.outputs.stop

    @property
    def owners(self) -> IndexArray:
        """(n_sensitivities,) the pole that each sensitivity belongs to."""
        return np.tile(np.arange(self.n_poles), 1 + self.n_inputs + self.n_records)

    @property
    def alone(self) -> "SignalLayout":
        """Of the signals that one record has: its own level, its own initial states."""
        return replace(self, n_records=1)

    def places(self, record: int) -> IndexArray:
        """(alone.size,) places among all signals of those that one record has."""
        return _places(self, record)


@lru_cache(maxsize=1024)
def _places(layout: SignalLayout, record: int) -> IndexArray:
    """See `SignalLayout.places`: asked for at every step of a refinement, the same each time."""
    n_poles, regressors = layout.n_poles, 2 * layout.n_poles + layout.n_direct
    shared = n_poles * (1 + layout.n_inputs)
    own = np.r_[:shared, shared + n_poles * record : shared + n_poles * (record + 1)]
    real, imaginary = layout.real.start + own, layout.imaginary.start + own
    outputs = layout.outputs.start + np.arange(layout.n_outputs)
    places = np.concatenate([np.arange(regressors), [regressors + record], real, imaginary, outputs])
    places.flags.writeable = False
    return places


def signal_grams(
    parameters: ModalParameters,
    records: Sequence[Record],
    rows: Sequence[BoolArray],
    blocks: Sequence[Block],
    *,
    n_direct: int,
) -> tuple[SignalLayout, FloatArray]:
    """Gram matrices of all signals over the counted rows of each block.

    Args:
        parameters: of the model.
        records: without NaN in the inputs; outputs of rows that do not count may be anything finite.
        rows: (n_samples,) a record, True where a row counts.
        blocks: in the order of their rows, each record whole.
        n_direct: the first so many inputs act on the outputs at once.

    Returns:
        Layout of all signals, and (n_blocks, alone.size, alone.size) Gram matrices of each block's own ones: the others
        are zero in it, and thirty records have thirty times as many.
    """
    first = records[0]
    layout = SignalLayout(
        n_poles=parameters.poles.size,
        n_inputs=first.n_inputs,
        n_outputs=first.n_outputs,
        n_records=len(records),
        n_direct=n_direct,
    )
    size = layout.alone.size
    grams = np.zeros((len(blocks), size, size))
    for r, record in enumerate(records):
        own = [i for i, block in enumerate(blocks) if block.record == r]
        part = grams[own[0] : own[-1] + 1]
        _add_grams(part, parameters, record, rows[r], [blocks[i] for i in own], n_direct=n_direct)
    return layout, grams


def whole_gram(layout: SignalLayout, grams: FloatArray, blocks: Sequence[Block], chosen: Sequence[int]) -> FloatArray:
    """(size, size) Gram matrix of all signals over the rows of the chosen blocks.

    Args:
        layout: of all signals.
        grams: of each block's own signals, from `signal_grams`.
        blocks: of the Gram matrices.
        chosen: indices of blocks.
    """
    if layout.n_records == 1:
        gram: FloatArray = grams[list(chosen)].sum(axis=0)
        return gram
    gram = np.zeros((layout.size, layout.size))
    for r in range(layout.n_records):
        places = layout.places(r)
        gram[np.ix_(places, places)] += grams[[i for i in chosen if blocks[i].record == r]].sum(axis=0)
    return gram


def _add_grams(
    grams: FloatArray,
    parameters: ModalParameters,
    record: Record,
    rows: BoolArray,
    blocks: Sequence[Block],
    *,
    n_direct: int,
) -> None:
    """Add one record's products to the Gram matrices of its blocks."""
    complete = bool(rows.all())
    long = all(block.step == 1 and block.last - block.first >= FEWEST_ROWS for block in blocks)
    if complete and long and record.n_inputs >= FEWEST_DRIVES:
        near = _near(parameters.poles)
        if 2 * near.sum() < near.size:
            _add_by_recursion(grams, parameters, record, blocks, n_direct=n_direct, near=near)
            return
    for start, signals in signals_of(parameters, blocks[0].record, record, n_direct=n_direct):
        stop = start + signals.shape[0]
        for i, block in enumerate(blocks):
            first, last = max(start, block.first), min(stop, block.last)
            first += (block.first - first) % block.step
            if first < last:
                part = signals[first - start : last - start : block.step]
                if block.step > 1:  # BLAS takes no steps within a signal
                    part = np.ascontiguousarray(part.T).T
                chosen = part if complete else part[rows[first : last : block.step]]
                grams[i] += chosen.T @ chosen


def signals_of(
    parameters: ModalParameters, index: int, record: Record, *, n_direct: int
) -> Iterator[tuple[int, FloatArray]]:
    """First row and (n_rows, n_signals) signals of one record, chunk by chunk."""
    for first, state, s, _ in _responses(parameters, index, record, LONGEST_CHUNK):
        yield first, _stacked(record, first, state, s, n_direct)


def _stacked(record: Record, first: int, state: ComplexArray, s: ComplexArray, n_direct: int) -> FloatArray:
    """(n_rows, n_signals) in the order of the layout."""
    rows, one, flat = slice(first, first + state.shape[1]), np.ones((1, state.shape[1])), s.reshape(-1, state.shape[1])
    inputs, outputs = record.inputs[rows, :n_direct].T, record.outputs[rows].T
    return np.vstack([state.real, state.imag, inputs, one, flat.real, flat.imag, outputs]).T


def _responses(
    parameters: ModalParameters, index: int, record: Record, longest: int
) -> Iterator[tuple[int, ComplexArray, ComplexArray, ComplexArray]]:
    """Chunk by chunk the first row, the states, their sensitivities, and what these are after the last row.

    The states are (n_poles, n_rows), sensitivities to poles, to participations, to initial states (2 + n_inputs,
    n_poles, n_rows), and after the last row (2 + n_inputs, n_poles).
    """
    poles, n_inputs = parameters.poles, record.n_inputs
    n_poles, longest = poles.size, min(record.n_samples, longest)
    recursion, powers = PoleRecursion.of(poles, longest), powers_of(poles, longest)
    with np.errstate(divide="ignore"):
        alive = 1.0 + np.floor(np.log(DIED_OUT) / np.log(np.abs(poles)))
    memory = np.zeros((2 + n_inputs, n_poles), dtype=np.complex128)
    memory[-1] = 1.0
    scale = np.vstack([poles, np.ones((1 + n_inputs, n_poles))])
    for first in range(0, record.n_samples, longest):
        inputs = record.inputs[first : first + longest].T
        n_rows = inputs.shape[1]
        s = np.empty((2 + n_inputs, n_poles, n_rows), dtype=np.complex128)
        for j in range(n_inputs):
            s[1 + j], memory[1 + j] = recursion.run(inputs[[j]], memory[1 + j])
        s[-1] = (powers[:n_rows] * memory[-1]).T
        for response, n_alive in zip(s[-1], alive - first, strict=True):
            if n_alive < n_rows:
                response[max(0, int(n_alive)) :] = 0.0
        state = parameters.states[index][:, np.newaxis] * s[-1]
        for j in range(n_inputs):
            state += parameters.inputs[:, [j]] * s[1 + j]
        s[0], memory[0] = recursion.run(state, memory[0])
        s[0] *= poles[:, np.newaxis]
        memory[-1] *= powers[n_rows - 1] * poles
        yield first, state, s, scale * memory


def _near(poles: ComplexArray) -> BoolArray:
    """(n_poles, n_poles) which two, a pole and itself among them, hardly die out in their product."""
    distance = np.minimum(abs(1.0 - np.multiply.outer(poles, poles)), abs(1.0 - np.multiply.outer(poles, poles.conj())))
    return np.asarray(distance < APART)


def _add_by_recursion(
    grams: FloatArray,
    parameters: ModalParameters,
    record: Record,
    blocks: Sequence[Block],
    *,
    n_direct: int,
    near: BoolArray,
) -> None:
    """As `_add_grams`, the products of sensitivities with each other from those with what drives them.

    Signals that run through poles a and b, driven by d and e, z(k+1) = a z(k) + d(k) and v(k+1) = b v(k) + e(k), have

        (1 - a b) sum z v = a sum z e + b sum d v + sum d e - [z v]

    over consecutive rows, because the sum over the rows one later differs by what is at the ends. Each sensitivity has
    as many drives as there are inputs, and n_poles times as many others. What is `near` is summed up as it is.
    """
    m, n, q = record.n_inputs, parameters.poles.size, record.n_outputs
    layout = SignalLayout(n_poles=n, n_inputs=m, n_outputs=q, n_records=1, n_direct=n_direct)
    linear, known = np.r_[layout.regressors, layout.outputs], np.r_[2 * n : layout.n_regressors, layout.outputs]
    owners = np.tile(np.arange(n), 2 * (2 + m))
    summed = [(np.flatnonzero(owners == i), np.flatnonzero(near[i][owners])) for i in range(n) if near[i].any()]
    whole = np.zeros((len(blocks), owners.size, owners.size))
    sums = np.zeros((len(blocks), layout.n_sensitivities, m + 1 + q), dtype=np.complex128)
    ends = np.zeros((len(blocks), 2, 2 + m, n), dtype=np.complex128)
    drives = np.zeros((len(blocks), m, m))
    for start, state, s, after in _responses(parameters, blocks[0].record, record, SHORT_CHUNK):
        stop = start + state.shape[1]
        inputs, one = record.inputs[start:stop].T, np.ones((1, stop - start))
        partners = np.vstack([inputs, one, record.outputs[start:stop].T])
        phi = np.vstack([state.real, state.imag, inputs[:n_direct], partners[m:]])
        flat = s.reshape(-1, stop - start)
        every = np.concatenate([flat.real, flat.imag])
        for i, block in enumerate(blocks):
            first, last = max(start, block.first), min(stop, block.last)
            rows = slice(first - start, last - start)
            if first < last:
                with_partners = every[:, rows] @ partners[:, rows].T
                sums[i] += with_partners[: len(flat)] + 1j * with_partners[len(flat) :]
                drives[i] += inputs[:, rows] @ inputs[:, rows].T
                grams[i][np.ix_(linear, linear)] += phi[:, rows] @ phi[:, rows].T
                for own, others in summed:
                    whole[i][np.ix_(own, others)] += every[own, rows] @ every[others, rows].T
            if start <= block.first < stop:
                ends[i, 0] = s[:, :, block.first - start]
            if start < block.last <= stop:
                ends[i, 1] = after if block.last == stop else s[:, :, block.last - start]
    driven = np.vstack([parameters.inputs.T, parameters.states[[blocks[0].record]]])
    both, re, im = slice(layout.real.start, layout.imaginary.stop), layout.real, layout.imaginary
    for gram, with_drives, at_ends, squares, direct in zip(grams, sums, ends, drives, whole, strict=True):
        products_of = partial(
            _products,
            parameters.poles,
            driven,
            sums=with_drives[:, :m].reshape(2 + m, n, m),
            ends=at_ends,
            squares=squares,
            near=near,
        )
        rr, ri, ir, ii = (part for half in np.split(direct, 2) for part in np.split(half, 2, axis=1))
        turned = products_of(direct=(rr + ii) + 1j * (ir - ri), turn=np.conjugate)
        plain = products_of(direct=(rr - ii) + 1j * (ir + ri), turn=np.positive)
        upper, lower = 0.5 * (turned + plain), 0.5 * (turned - plain)
        for part, with_real, with_imaginary in ((re, upper.real, -lower.imag), (im, upper.imag, lower.real)):
            gram[part, :n], gram[part, n : 2 * n] = with_real[:, :n], with_imaginary[:, :n]
            gram[part, re], gram[part, im] = with_real[:, n:], with_imaginary[:, n:]
        with_known = with_drives[:, np.r_[:n_direct, m : m + 1 + q]]
        gram[re, known], gram[im, known] = with_known.real, with_known.imag
        gram[linear, both] = gram[both, linear].T


def _products(
    poles: ComplexArray,
    driven: ComplexArray,
    *,
    sums: ComplexArray,
    ends: ComplexArray,
    squares: FloatArray,
    direct: ComplexArray,
    near: BoolArray,
    turn: Callable[[ComplexArray], ComplexArray],
) -> ComplexArray:
    """(n_sensitivities, n_poles + n_sensitivities) products of sensitivities with states and with sensitivities.

    Args:
        poles: (n_poles,).
        driven: (n_inputs + 1, n_poles) how far each input, and a start at one, drive a state.
        sums: (2 + n_inputs, n_poles, n_inputs) products of sensitivities with inputs.
        ends: (2, 2 + n_inputs, n_poles) sensitivities at the first row, and after the last.
        squares: (n_inputs, n_inputs) products of the inputs.
        direct: (n_sensitivities, n_sensitivities) products of sensitivities, where they are summed up.
        near: (n_poles, n_poles) where they are.
        turn: of the second factor: its conjugate or itself.
    """
    m, n = squares.shape[0], poles.size
    other, both_poles = turn(poles), np.multiply.outer(poles, turn(poles))
    left, direct = np.where(near, 1.0, 1.0 - both_poles), direct.reshape(2 + m, n, 2 + m, n)
    sums = np.pad(sums, ((0, 0), (0, 0), (0, 1)))  # nothing drives what rings down from its start
    first, last = ends
    # the others than those to the poles, among each other
    base = poles[:, np.newaxis, np.newaxis] * sums[1:, :, :, np.newaxis]
    base = base + (turn(sums[1:]).transpose(2, 0, 1) * other)[:, np.newaxis]
    base += np.pad(squares, (0, 1))[:, np.newaxis, :, np.newaxis]
    base += np.multiply.outer(first[1:], turn(first[1:])) - np.multiply.outer(last[1:], turn(last[1:]))
    base = np.where(near[:, np.newaxis], direct[1:, :, 1:], base / left[:, np.newaxis])
    with_states = np.einsum("aibk,bk->aik", base, turn(driven))
    states = np.einsum("ai,aik->ik", driven, with_states)
    # the sensitivities to the poles are driven by poles times states
    drives = turn(np.einsum("bk,bkl->lk", driven, sums[1:]) + sums[0].T)
    to_poles = other * (poles[:, np.newaxis] * with_states + drives[:, np.newaxis])
    to_poles += np.multiply.outer(first[1:], turn(first[0])) - np.multiply.outer(last[1:], turn(last[0]))
    to_poles = np.where(near, direct[1:, :, 0], to_poles / left)
    ahead = np.einsum("ai,aik->ik", driven, to_poles)
    behind = turn(ahead).T
    twice = both_poles * (ahead + behind + states)
    twice += np.multiply.outer(first[0], turn(first[0])) - np.multiply.outer(last[0], turn(last[0]))
    found = np.empty((2 + m, n, 3 + m, n), dtype=np.complex128)
    found[0, :, 0], found[1:, :, 0] = behind, with_states
    found[0, :, 1], found[1:, :, 1] = np.where(near, direct[0, :, 0], twice / left), to_poles
    found[0, :, 2:], found[1:, :, 2:] = turn(to_poles).transpose(2, 0, 1), base
    return found.reshape((2 + m) * n, -1)


def one_blas_thread() -> AbstractContextManager[object]:
    """A context in which numpy and scipy use one thread; what was set before is restored at its end.

    Example:
        >>> with one_blas_thread():
        ...     pass
    """
    import scipy.linalg  # noqa: F401  # scipy brings a BLAS of its own, which must be loaded before it can be limited
    from threadpoolctl import threadpool_limits

    limits: AbstractContextManager[object] = threadpool_limits(limits=1, user_api="blas")
    return limits
