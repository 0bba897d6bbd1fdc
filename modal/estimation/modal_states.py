"""Modal states of a driven model, their sensitivities, and the one Gram matrix that a refinement step needs.

Each pole has one complex state in each record, driven by all inputs and by what it starts from:

    x_i(k+1) = lambda_i x_i(k) + b_i' u(k),   x_i(0) = x0_i,   y(k) = sum over i of Re(c_i x_i(k)) + D u(k) + level

Sensitivities of a state run through the same pole: to lambda_i the state once more filtered, to b_ij the filtered input
u_j, to x0_i the power lambda_i^k. All sums over rows that a Gauss-Newton step and its linear part need are products of
these signals, so a record is passed once and only its Gram matrices are kept: of all of them over the rows that train,
of those that are linear over each block of rows.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from era.state_recursion import PoleRecursion
from modal.estimation.free_run import powers_of
from okid.arrays import BoolArray, ComplexArray, FloatArray
from okid.record import Record
from okid.rows import runs_of

PARTS = 10
"""Parts of all records whose sums are kept apart where rows take turns, at least one a record."""
IndexArray = npt.NDArray[np.intp]

CHUNK = 1024
"""Hold so many rows of signals at a time: they stay in cache."""
FEWEST_ROWS = 256
"""Let sums follow from each other over runs of at least so many rows in the mean: those over fewer are made sooner."""
FEWEST_SIGNALS = 120
"""Let sums follow from each other where so many sensitivities are to be multiplied: few are multiplied sooner."""
NONE = -2
"""Hold no block out: none has this label."""
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
    to the inputs' participations, to the initial states. Last the outputs. `drives` are the inputs that move in each
    record, as many everywhere, where not all do: the signals of an input that stands at zero are zero.
    """

    n_poles: int
    n_inputs: int
    n_outputs: int
    n_records: int
    n_direct: int
    drives: tuple[tuple[int, ...], ...] = ()

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
        """Of the signals that one record has: what drives it, its own level, its own initial states."""
        if not self.drives:
            return replace(self, n_records=1)
        own = self.drives[0]
        n_direct = sum(j < self.n_direct for j in own)
        return replace(self, n_records=1, n_inputs=len(own), n_direct=n_direct, drives=())

    def inputs_of(self, record: int) -> IndexArray:
        """(alone.n_inputs,) inputs whose signals one record has."""
        return np.array(self.drives[record] if self.drives else range(self.n_inputs), dtype=np.intp)

    def places(self, record: int) -> IndexArray:
        """(alone.size,) places among all signals of those that one record has."""
        return _places(self, record)


@lru_cache(maxsize=1024)
def _places(layout: SignalLayout, record: int) -> IndexArray:
    """See `SignalLayout.places`: asked for at every step of a refinement, the same each time."""
    n_poles, inputs = layout.n_poles, layout.inputs_of(record)
    families = np.concatenate([[0], 1 + inputs, [1 + layout.n_inputs + record]])
    own = (n_poles * families[:, np.newaxis] + np.arange(n_poles)).ravel()
    direct, level = 2 * n_poles + inputs[inputs < layout.n_direct], 2 * n_poles + layout.n_direct + record
    outputs = layout.outputs.start + np.arange(layout.n_outputs)
    places = np.concatenate(
        [np.arange(2 * n_poles), direct, [level], layout.real.start + own, layout.imaginary.start + own, outputs]
    )
    places.flags.writeable = False
    return places


def _layout(parameters: ModalParameters, records: Sequence[Record], n_direct: int) -> SignalLayout:
    """Of all signals of the records."""
    n_inputs = records[0].n_inputs
    moving = [np.flatnonzero(record.inputs[:, :n_direct].any(axis=0)) for record in records]
    most = max(own.size for own in moving)
    padded = [[*own, *(j for j in range(n_direct) if j not in own)][:most] for own in map(np.ndarray.tolist, moving)]
    return SignalLayout(
        n_poles=parameters.poles.size,
        n_inputs=n_inputs,
        n_outputs=records[0].n_outputs,
        n_records=len(records),
        n_direct=n_direct,
        drives=tuple((*sorted(own), *range(n_direct, n_inputs)) for own in padded) if most < n_direct else (),
    )


def signal_grams(
    parameters: ModalParameters,
    records: Sequence[Record],
    rows: Sequence[BoolArray],
    blocks: Sequence[Block],
    *,
    n_direct: int,
    held_out: int = NONE,
) -> tuple[SignalLayout, FloatArray, FloatArray]:
    """Gram matrices: of all signals over the rows that train, of what is linear over those of each block.

    Args:
        parameters: of the model.
        records: without NaN in the inputs; outputs of rows that do not count may be anything finite.
        rows: (n_samples,) a record, True where a row counts.
        blocks: in the order of their rows, each record whole.
        n_direct: the first so many inputs act on the outputs at once.
        held_out: blocks with this label do not train.

    Returns:
        Layout of all signals, the (size, size) Gram matrix, and those of each block's own regressors and outputs,
        (n_blocks, n, n): thirty records have thirty levels, of which a block has one.
    """
    layout = _layout(parameters, records, n_direct)
    parts = np.zeros((len(blocks), *2 * (layout.alone.n_regressors + layout.n_outputs,)))
    whole = np.zeros((layout.size, layout.size))
    for r, record in enumerate(records):
        own = [(block, part) for block, part in zip(blocks, parts, strict=True) if block.record == r]
        driven = _Driven.of(layout, parameters, r, record)
        gram = _record_gram(driven, rows[r], own, held_out)
        if gram.shape == whole.shape:
            whole = gram
        else:
            places = layout.places(r)
            whole[np.ix_(places, places)] += gram
    at = driven.places[np.r_[layout.alone.regressors, layout.alone.outputs]] - driven.known.start
    return layout, whole, parts[:, at[:, np.newaxis], at]


def _record_gram(
    driven: "_Driven", rows: BoolArray, blocks: Sequence[tuple[Block, FloatArray]], held_out: int
) -> FloatArray:
    """(size, size) products over the rows of a record that train; those of its blocks are added to theirs."""
    counted = np.zeros(rows.size, dtype=np.bool_)
    for block, _ in blocks:
        if block.label != held_out:
            counted[block.rows] = rows[block.rows]
    runs, complete = runs_of(counted), bool(rows.all())
    whole = len(runs) <= len(blocks)  # else rows are missing or take turns, and are copied together
    many = driven.known.start >= FEWEST_SIGNALS and counted.sum() >= FEWEST_ROWS * len(runs)
    sums = _Sums.of(driven, near, runs) if many and 2 * (near := _near(driven.poles)).sum() < near.size else None
    gram = np.zeros((driven.n_signals, driven.n_signals))
    for start, signals, after in driven.signals():
        linear, stop = signals[driven.known], start + signals.shape[1]
        for block, total in blocks:
            first, last = max(start, block.first), min(stop, block.last)
            first += (block.first - first) % block.step
            if first < last:
                own = linear[:, first - start : last - start : block.step]
                own = own if complete else own[:, rows[first : last : block.step]]
                own = np.ascontiguousarray(own) if block.step > 1 else own  # BLAS takes no steps within a signal
                total += own @ own.T  # noqa: PLW2901
        pieces = [(max(start, first), min(stop, last)) for first, last in runs if first < stop and last > start]
        chosen = [signals[:, first - start : last - start] for first, last in pieces if whole]
        for one in chosen if whole else [signals[:, counted[start:stop]]]:
            if sums is None:
                gram += one @ one.T
            else:
                sums.add(one)
        if sums is not None:
            sums.end(start, signals, after)
    if sums is not None:
        gram = sums.gram(np.sum([total for block, total in blocks if block.label != held_out], axis=0))
    return gram[np.ix_(driven.places, driven.places)]


def signals_of(
    layout: SignalLayout, parameters: ModalParameters, index: int, record: Record
) -> Iterator[tuple[int, FloatArray]]:
    """First row and (n_rows, n_signals) signals that one record has, chunk by chunk."""
    driven = _Driven.of(layout, parameters, index, record)
    for first, signals, _ in driven.signals():
        yield first, signals[driven.places].T


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Driven:
    """The model driven by one record, its poles by rising angle.

    Its signals stand in an order of their own: each pole's sensitivities together, real parts before imaginary ones,
    so that those of neighbouring poles are; then what else they are multiplied by, and last the states.

    Attributes:
        layout: of the signals of this record.
        order: (n_poles,) of its poles among those of the parameters.
        poles: (n_poles,).
        participations: (n_poles, n_inputs) of its own inputs.
        start: (n_poles,) initial states.
        partners: (n_inputs + 1 + n_outputs, n_samples) inputs, those that act at once last, one, and outputs.
    """

    layout: SignalLayout
    order: IndexArray
    poles: ComplexArray
    participations: ComplexArray
    start: ComplexArray
    partners: FloatArray

    @classmethod
    def of(cls, layout: SignalLayout, parameters: ModalParameters, index: int, record: Record) -> "_Driven":
        """By the inputs whose signals it has."""
        own, order = layout.inputs_of(index), np.argsort(np.angle(parameters.poles))
        inputs = record.inputs[:, np.roll(own, -layout.alone.n_direct)].T
        return cls(
            layout=layout.alone,
            order=order,
            poles=parameters.poles[order],
            participations=parameters.inputs[np.ix_(order, own)],
            start=parameters.states[index, order],
            partners=np.vstack([inputs, np.ones((1, record.n_samples)), record.outputs.T]),
        )

    @property
    def n_families(self) -> int:
        """Real signals of the sensitivities of a pole."""
        return 2 * (2 + self.layout.n_inputs)

    @property
    def known(self) -> slice:
        """Inputs that act at once, one, outputs and states."""
        return slice(self.n_families * self.order.size + self.layout.n_inputs - self.layout.n_direct, None)

    @property
    def n_signals(self) -> int:
        """Real ones."""
        return (self.n_families + 2) * self.order.size + len(self.partners)

    @property
    def places(self) -> IndexArray:
        """(layout.size,) where the signals of the layout stand."""
        layout, n, back = self.layout, self.order.size, np.argsort(self.order)
        states = self.n_signals - 2 * n + np.concatenate([back, n + back])
        sensitivities = (back * self.n_families + np.arange(self.n_families)[:, np.newaxis]).ravel()
        known = self.known.start + np.arange(layout.n_direct + 1 + layout.n_outputs)
        return np.concatenate([states, known[: layout.n_direct + 1], sensitivities, known[layout.n_direct + 1 :]])

    def signals(self) -> Iterator[tuple[int, FloatArray, ComplexArray]]:
        """Chunk by chunk the first row, (n_signals, n_rows) signals, and the sensitivities after the last row.

        These are (n_poles, 2 + n_inputs): to the pole, to participations, to initial states. A chunk is overwritten by
        the next one.
        """
        poles, n, m, n_samples = self.poles, self.poles.size, self.layout.n_inputs, self.partners.shape[1]
        longest = min(n_samples, CHUNK)
        recursion, powers = PoleRecursion.of(poles, longest), powers_of(poles, longest)
        with np.errstate(divide="ignore"):
            alive = 1.0 + np.floor(np.log(DIED_OUT) / np.log(np.abs(poles)))
        inputs = np.roll(self.partners[:m], self.layout.n_direct, axis=0)[:, np.newaxis]
        memory = np.zeros((2 + m, n), dtype=np.complex128)
        memory[-1] = 1.0
        # the state, and poles times it, imaginary part first, which drives what is sensitive to them
        drives = np.vstack([self.participations.T, self.start])
        times = np.stack([drives.real, drives.imag, (poles * drives).imag, (poles * drives).real], axis=1).T
        turned = np.stack([-drives.imag, drives.real, (poles * drives).real, -(poles * drives).imag], axis=1).T
        whole, both = np.empty((self.n_signals, longest)), np.empty((2, n, 4, longest))
        for first in range(0, n_samples, longest):
            n_rows = min(longest, n_samples - first)
            signals = whole[:, :n_rows]
            s = signals[: self.n_families * n].reshape(n, 2, 2 + m, n_rows)
            free = (powers[:n_rows] * memory[-1]).T
            for response, n_alive in zip(free, alive - first, strict=True):
                if n_alive < n_rows:
                    response[max(0, int(n_alive)) :] = 0.0
            s[:, 0, -1], s[:, 1, -1] = free.real, free.imag
            for j in range(m):
                memory[1 + j] = recursion.fill(s[:, :, 1 + j], inputs[[j], :, first : first + n_rows], memory[1 + j])
            state, other = both[..., :n_rows]
            np.matmul(times, s[:, 0, 1:], out=state)
            np.matmul(turned, s[:, 1, 1:], out=other)
            state += other
            memory[0] = recursion.fill(s[:, :, 0], state[:, 2:], memory[0])
            signals[self.n_signals - 2 * n :].reshape(2, n, n_rows)[:] = state[:, :2].swapaxes(0, 1)
            signals[self.n_families * n : self.n_signals - 2 * n] = self.partners[:, first : first + n_rows]
            memory[-1] *= powers[n_rows - 1] * poles
            yield first, signals, memory.T.copy()


def _near(poles: ComplexArray) -> BoolArray:
    """(n_poles, n_poles) which two, a pole and itself among them, hardly die out in their product."""
    distance = np.minimum(abs(1.0 - np.multiply.outer(poles, poles)), abs(1.0 - np.multiply.outer(poles, poles.conj())))
    return np.asarray(distance < APART)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Sums:
    """Products of sensitivities with each other from those with what drives them, over runs of rows of one record.

    Signals that run through poles a and b, driven by d and e, z(k+1) = a z(k) + d(k) and v(k+1) = b v(k) + e(k), have

        (1 - a b) sum z v = a sum z e + b sum d v + sum d e - [z v]

    over consecutive rows, because the sum over the rows one later differs by what is at the ends. Each sensitivity has
    as many drives as there are inputs, and n_poles times as many others. What is `near` is summed up as it is.

    Attributes:
        driven: the record's model.
        near: (n_poles, n_poles) which two hardly die out in their product.
        reach: (n_poles,) one past the last that is near to each.
        runs: first row and one past the last.
        partners: (n_sensitivities, n_partners) sums of real signals with their partners, added up.
        squares: (n_inputs, n_inputs) products of the inputs.
        ends: (2, n_runs, 2 + n_inputs, n_poles) sensitivities at the first row of a run, and after its last.
        direct: (n_sensitivities, n_sensitivities) of real signals, where near.
    """

    driven: _Driven
    near: BoolArray
    reach: IndexArray
    runs: Sequence[tuple[int, int]]
    partners: FloatArray
    squares: FloatArray
    ends: ComplexArray
    direct: FloatArray

    @classmethod
    def of(cls, driven: _Driven, near: BoolArray, runs: Sequence[tuple[int, int]]) -> "_Sums":
        """Nothing added up yet."""
        n, m = driven.poles.size, driven.layout.n_inputs
        size = n * driven.n_families
        return cls(
            driven=driven,
            near=near,
            reach=n - near[:, ::-1].argmax(axis=1),
            runs=runs,
            partners=np.zeros((size, len(driven.partners))),
            squares=np.zeros((m, m)),
            ends=np.zeros((2, len(runs), 2 + m, n), dtype=np.complex128),
            direct=np.zeros((size, size)),
        )

    def add(self, signals: FloatArray) -> None:
        """Rows that train."""
        families, own = self.driven.n_families, slice(0, len(self.direct))
        partners = signals[own.stop : own.stop + self.partners.shape[1]]
        self.partners[:] += signals[own] @ partners.T
        self.squares[:] += partners[: len(self.squares)] @ partners[: len(self.squares)].T
        for i, reach in enumerate(self.reach.tolist()):
            one, others = slice(i * families, (i + 1) * families), slice(i * families, reach * families)
            self.direct[one, others] += signals[one] @ signals[others].T

    def end(self, start: int, signals: FloatArray, after: ComplexArray) -> None:
        """What is at the ends of runs that lie in a chunk."""
        stop, n = start + signals.shape[1], self.driven.poles.size

        def at(row: int) -> ComplexArray:
            s = signals[: len(self.direct), row - start].reshape(n, 2, -1)
            return np.asarray((s[:, 0] + 1j * s[:, 1]).T)

        for i, (first, last) in enumerate(self.runs):
            if start <= first < stop:
                self.ends[0, i] = at(first)
            if start < last <= stop:
                self.ends[1, i] = after.T if last == stop else at(last)

    def gram(self, known: FloatArray) -> FloatArray:
        """(n_signals, n_signals) all products; of what is known with each other those given."""
        driven, n, m, size = self.driven, self.driven.poles.size, len(self.squares), len(self.direct)
        into = np.roll(np.arange(m), driven.layout.n_direct)  # as in the layout, those that act at once first
        partners = self.partners.reshape(n, 2, 2 + m, -1).transpose(1, 2, 0, 3)
        direct = (np.triu(self.direct) + np.triu(self.direct, 1).T).reshape(n, 2, 2 + m, n, 2, 2 + m)
        rr, ri, ir, ii = (
            direct[:, i, :, :, j].transpose(1, 0, 3, 2).reshape((2 + m) * n, -1) for i in (0, 1) for j in (0, 1)
        )
        products_of = partial(
            _products,
            driven.poles,
            np.vstack([driven.participations.T, driven.start]),
            sums=(partners[0] + 1j * partners[1])[:, :, into],
            ends=self.ends,
            squares=self.squares[np.ix_(into, into)],
            near=self.near,
        )
        turned = products_of(direct=(rr + ii) + 1j * (ir - ri), turn=np.conjugate)
        plain = products_of(direct=(rr - ii) + 1j * (ir + ri), turn=np.positive)
        upper, lower = 0.5 * (turned + plain), 0.5 * (turned - plain)
        # rows: real, imaginary; columns: of states and of sensitivities, real, imaginary
        found = np.array([[upper.real, -lower.imag], [upper.imag, lower.real]])
        own = found[..., n:].reshape(2, 2, 2 + m, n, 2 + m, n).transpose(3, 0, 2, 5, 1, 4).reshape(size, size)
        states = found[..., :n].reshape(2, 2, 2 + m, n, n).transpose(3, 0, 2, 1, 4).reshape(size, 2 * n)
        gram = np.zeros((driven.n_signals, driven.n_signals))
        gram[:size, :size], gram[:size, size : -2 * n], gram[:size, -2 * n :] = own, self.partners, states
        gram[size:, :size] = gram[:size, size:].T
        gram[driven.known, driven.known] = known
        return gram


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
        ends: (2, n_runs, 2 + n_inputs, n_poles) sensitivities at the first row of each run, and after its last.
        squares: (n_inputs, n_inputs) products of the inputs.
        direct: (n_sensitivities, n_sensitivities) products of sensitivities, where they are summed up.
        near: (n_poles, n_poles) where they are.
        turn: of the second factor: its conjugate or itself.
    """
    m, n = squares.shape[0], poles.size
    other, both_poles = turn(poles), np.multiply.outer(poles, turn(poles))
    left, direct = np.where(near, 1.0, 1.0 - both_poles), direct.reshape(2 + m, n, 2 + m, n)
    sums = np.pad(sums, ((0, 0), (0, 0), (0, 1)))  # nothing drives what rings down from its start

    def gone(one: int | slice, two: int | slice) -> ComplexArray:
        came, went = (np.tensordot(end[:, one], turn(end[:, two]), axes=(0, 0)) for end in ends)
        return np.asarray(came - went)

    others = slice(1, None)  # than those to the poles, first among each other
    base = poles[:, np.newaxis, np.newaxis] * sums[1:, :, :, np.newaxis]
    base = base + (turn(sums[1:]).transpose(2, 0, 1) * other)[:, np.newaxis]
    base += np.pad(squares, (0, 1))[:, np.newaxis, :, np.newaxis]
    base += gone(others, others)
    base = np.where(near[:, np.newaxis], direct[1:, :, 1:], base / left[:, np.newaxis])
    with_states = np.einsum("aibk,bk->aik", base, turn(driven))
    states = np.einsum("ai,aik->ik", driven, with_states)
    # the sensitivities to the poles are driven by poles times states
    drives = turn(np.einsum("bk,bkl->lk", driven, sums[1:]) + sums[0].T)
    to_poles = other * (poles[:, np.newaxis] * with_states + drives[:, np.newaxis]) + gone(others, 0)
    to_poles = np.where(near, direct[1:, :, 0], to_poles / left)
    ahead = np.einsum("ai,aik->ik", driven, to_poles)
    behind = turn(ahead).T
    twice = both_poles * (ahead + behind + states) + gone(0, 0)
    found = np.empty((2 + m, n, 3 + m, n), dtype=np.complex128)
    found[0, :, 0], found[1:, :, 0] = behind, with_states
    found[0, :, 1], found[1:, :, 1] = np.where(near, direct[0, :, 0], twice / left), to_poles
    found[0, :, 2:], found[1:, :, 2:] = turn(to_poles).transpose(2, 0, 1), base
    return found.reshape((2 + m) * n, -1)
