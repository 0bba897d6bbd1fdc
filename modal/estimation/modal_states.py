"""Modal states of a driven model and their sensitivities, chunk by chunk.

Each pole has one complex state in each record, driven by all inputs and by what it starts from:

    x_i(k+1) = lambda_i x_i(k) + b_i' u(k),   x_i(0) = x0_i,   y(k) = sum over i of Re(c_i x_i(k)) + D u(k) + level

Sensitivities of a state run through the same pole: to lambda_i the state once more filtered, to b_ij the filtered input
u_j, to x0_i the power lambda_i^k. Their products are what a refinement step needs (`modal.estimation.signal_sums`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from era.state_recursion import PoleRecursion
from modal.estimation.free_run import powers_of
from okid.arrays import BoolArray, ComplexArray, FloatArray
from okid.record import Record
from okid.scaling import ROUNDING

PARTS = 10
"""Parts of all records whose sums are kept apart where rows take turns, at least one a record."""
IndexArray = npt.NDArray[np.intp]

CHUNK = 2048
"""Hold so many rows of signals at a time: the fewer turns the quicker while they stay in cache, as of 30 poles."""
NONE = -2
"""Hold no block out: none has this label."""
DIED_OUT = ROUNDING**2
"""Free responses below this are set to zero: even their products with what does not die out are rounding."""


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


def layout_of(parameters: ModalParameters, records: Sequence[Record], n_direct: int) -> SignalLayout:
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


def signals_of(
    layout: SignalLayout, parameters: ModalParameters, index: int, record: Record
) -> Iterator[tuple[int, FloatArray]]:
    """First row and (n_rows, n_signals) signals that one record has, chunk by chunk; free responses at rest too."""
    driven = Driven.of(layout, parameters, index, record)
    driven = replace(driven, alive=_rows_alive(parameters.poles))
    for first, signals, _ in driven.signals():
        yield first, signals[driven.places].T


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Driven:
    """The model driven by one record.

    Its signals stand in an order of their own: sensitivities to initial states, to participations, to the poles, real
    parts of all poles before imaginary ones; then what else they are multiplied by, and last the states.

    Attributes:
        layout: of the signals of this record.
        poles: (n_poles,).
        participations: (n_poles, n_inputs) of its own inputs.
        start: (n_poles,) initial states.
        partners: (n_inputs + 1 + n_outputs, n_samples) inputs, those that act at once last, one, and outputs.
        recursion: of the poles, over a chunk.
        powers: (n_rows, n_poles) of the poles, over a chunk.
        alive: (n_poles,) rows before what rings down from a start has died out: none where a record begins at rest.
    """

    layout: SignalLayout
    poles: ComplexArray
    participations: ComplexArray
    start: ComplexArray
    partners: FloatArray
    recursion: PoleRecursion
    powers: ComplexArray
    alive: FloatArray

    @classmethod
    def of(
        cls,
        layout: SignalLayout,
        parameters: ModalParameters,
        index: int,
        record: Record,
        *,
        beside: "Driven | None" = None,
    ) -> "Driven":
        """By the inputs whose signals it has; what its poles do is known of the one beside if that is as long."""
        own, poles, longest = layout.inputs_of(index), parameters.poles, min(record.n_samples, CHUNK)
        if beside is None or len(beside.powers) < longest:
            recursion, powers = PoleRecursion.of(poles, longest), powers_of(poles, longest)
        else:
            recursion, powers = beside.recursion, beside.powers
        inputs = record.inputs[:, np.roll(own, -layout.alone.n_direct)].T
        start = parameters.states[index]
        return cls(
            layout=layout.alone,
            poles=poles,
            participations=parameters.inputs[:, own],
            start=start,
            partners=np.vstack([inputs, np.ones((1, record.n_samples)), record.outputs.T]),
            recursion=recursion,
            powers=powers,
            alive=_rows_alive(poles) if start.any() else np.zeros(poles.size),
        )

    @property
    def n_families(self) -> int:
        """Sensitivities of a pole."""
        return 2 + self.layout.n_inputs

    @property
    def others(self) -> slice:
        """What the sensitivities are multiplied by."""
        first = 2 * self.n_families * self.poles.size
        return slice(first, first + len(self.partners))

    @property
    def known(self) -> slice:
        """Inputs that act at once, one, outputs and states."""
        return slice(self.others.start + self.layout.n_inputs - self.layout.n_direct, None)

    @property
    def n_signals(self) -> int:
        """Real ones."""
        return self.others.stop + 2 * self.poles.size

    def n_over(self, first: int) -> int:
        """Signals, the first ones, that are zero from a row on."""
        return 0 if first < self.alive.max(initial=0.0) else 2 * self.poles.size

    @property
    def places(self) -> IndexArray:
        """(layout.size,) where the signals of the layout stand."""
        layout, n, at = self.layout, self.poles.size, self.n_families
        rows = np.arange(2 * at * n).reshape(at, 2, n)[[-1, *range(1, at - 1), 0]]
        known = self.known.start + np.arange(layout.n_direct + 1 + layout.n_outputs)
        states, sensitivities = self.others.stop + np.arange(2 * n), rows.swapaxes(0, 1).ravel()
        return np.concatenate([states, known[: layout.n_direct + 1], sensitivities, known[layout.n_direct + 1 :]])

    def signals(self) -> Iterator[tuple[int, FloatArray, ComplexArray]]:
        """Chunk by chunk the first row, (n_signals, n_rows) signals, and the sensitivities after the last row.

        These are (2 + n_inputs, n_poles): to initial states, to participations, to the poles. A chunk is overwritten by
        the next one.
        """
        poles, n, m, n_samples = self.poles, self.poles.size, self.layout.n_inputs, self.partners.shape[1]
        longest, recursion, powers = min(n_samples, CHUNK), self.recursion, self.powers
        inputs = np.roll(self.partners[:m], self.layout.n_direct, axis=0)[:, np.newaxis]
        memory = np.zeros((2 + m, n), dtype=np.complex128)
        memory[0] = self.alive > 0.0
        drives = np.vstack([self.start, self.participations.T]).T[:, :, np.newaxis] * np.array([1.0, 1j])
        drives = drives.reshape(n, 2 * (1 + m))  # of the state, by real and imaginary parts of sensitivities
        times = poles[:, np.newaxis] * drives  # of what drives the one to the pole, imaginary part first there
        to_state = np.stack([drives.real, drives.imag], axis=1)
        to_drive = np.stack([times.imag, times.real], axis=1)
        whole, drive = np.zeros((self.n_signals, longest)), np.empty((n, 2, longest))
        for first in range(0, n_samples, longest):
            n_rows = min(longest, n_samples - first)
            signals = whole[:, :n_rows]
            s = signals[: self.others.start].reshape(2 + m, 2, n, n_rows).transpose(2, 1, 0, 3)
            if not self.n_over(first - longest):  # else set to zero in the last chunk
                free = (powers[:n_rows] * memory[0]).T
                for response, n_alive in zip(free, self.alive - first, strict=True):
                    if n_alive < n_rows:
                        response[max(0, int(n_alive)) :] = 0.0
                s[:, 0, 0], s[:, 1, 0] = free.real, free.imag
            for j in range(m):
                memory[1 + j] = recursion.fill(s[:, :, 1 + j], inputs[[j], :, first : first + n_rows], memory[1 + j])
            acting = slice(2 if self.n_over(first) else 0, 2 * (1 + m))
            moving = signals[: 2 * n * (1 + m)].reshape(2 * (1 + m), n, n_rows).swapaxes(0, 1)[:, acting]
            state = signals[self.others.stop :].reshape(2, n, n_rows).swapaxes(0, 1)
            np.matmul(to_state[:, :, acting], moving, out=state)
            np.matmul(to_drive[:, :, acting], moving, out=drive[..., :n_rows])
            memory[-1] = recursion.fill(s[:, :, -1], drive[..., :n_rows], memory[-1])
            signals[self.others] = self.partners[:, first : first + n_rows]
            memory[0] *= powers[n_rows - 1] * poles
            yield first, signals, memory.copy()


def _rows_alive(poles: ComplexArray) -> FloatArray:
    """(n_poles,) rows before a free response has died out."""
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 + np.floor(np.log(DIED_OUT) / np.log(np.abs(poles))))


def blocks_of_answers(
    layout: SignalLayout, parameters: ModalParameters, records: Sequence[Record], n_parts: int
) -> tuple[Block, ...]:
    """Blocks that hold equal parts of what the rows tell of the poles, `n_parts` a pole and record.

    What a blow tells of a mode lies within the mode's memory, a short one for a mode that is soon over: even blocks
    would hold it all. The squares of a state's sensitivity to its pole say where it lies; poles count alike.
    """
    n, alone = layout.n_poles, layout.alone
    told = []
    for index, record in enumerate(records):
        parts = signals_of(layout, parameters, index, record)
        real, imaginary = (slice(part.start, part.start + n) for part in (alone.real, alone.imaginary))
        told.append(np.vstack([rows[:, real] ** 2 + rows[:, imaginary] ** 2 for _, rows in parts]))
    total = np.maximum(np.sum([one.sum(axis=0) for one in told], axis=0), np.finfo(float).tiny)
    blocks: list[Block] = []
    for index, one in enumerate(told):
        share = np.cumsum((one / total).sum(axis=1))
        number = np.floor(n_parts * len(told) * share).astype(int)
        edges = [0, *(np.flatnonzero(np.diff(number)) + 1).tolist(), len(one)]
        blocks += [Block(record=index, first=first, last=last, label=-1) for first, last in pairwise(edges)]
    return tuple(blocks)
