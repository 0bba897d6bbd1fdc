"""The one Gram matrix that a refinement step needs: products of modal states, sensitivities, inputs and outputs.

All sums over rows that a Gauss-Newton step and its linear part need are products of the signals of
`modal.estimation.modal_states`, so a record is passed once and only its Gram matrices are kept: of all signals over the
rows that train, of those that are linear over each block of rows; of several choices of the rows where outputs were not
all measured in the same ones. Many sensitivities are not multiplied with each other, but follow from what drives them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from modal.estimation.modal_states import NONE, Block, Driven, IndexArray, ModalParameters, SignalLayout, layout_of
from okid.arrays import BoolArray, ComplexArray, FloatArray
from okid.record import Record
from okid.rows import runs_of

FEWEST_ROWS = 256
"""Let sums follow from each other over runs of at least so many rows in the mean: those over fewer are made sooner."""
FEWEST_SIGNALS = 120
"""Let sums follow from each other where so many sensitivities are to be multiplied: few are multiplied sooner."""
APART = 0.05
"""Sum up what two poles give whose product is no further from one: rounding of the rest grows with its third power."""


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
    layout, ((whole, parts),) = signal_grams_over(
        parameters, records, [rows], blocks, n_direct=n_direct, held_out=held_out
    )
    return layout, whole, parts


def signal_grams_over(
    parameters: ModalParameters,
    records: Sequence[Record],
    choices: Sequence[Sequence[BoolArray]],
    blocks: Sequence[Block],
    *,
    n_direct: int,
    held_out: int = NONE,
) -> tuple[SignalLayout, list[tuple[FloatArray, FloatArray]]]:
    """`signal_grams` for several choices of the rows that count, in one pass."""
    layout = layout_of(parameters, records, n_direct)
    wholes = [np.zeros((layout.size, layout.size)) for _ in choices]
    parts = np.zeros((len(choices), len(blocks), *2 * (layout.alone.n_regressors + layout.n_outputs,)))
    beside: Driven | None = None
    for r, record in enumerate(records):
        beside = driven = Driven.of(layout, parameters, r, record, beside=beside)
        own = [i for i, block in enumerate(blocks) if block.record == r]
        totals = [
            _Total.of(driven, rows[r], [(blocks[i], part[i]) for i in own], held_out)
            for rows, part in zip(choices, parts, strict=True)
        ]
        for start, signals, after in driven.signals():
            for total in totals:
                total.add(start, signals, after)
        places = layout.places(r)
        for whole, total in zip(wholes, totals, strict=True):
            whole[np.ix_(places, places)] += total.all_products()
    at = driven.places[np.r_[layout.alone.regressors, layout.alone.outputs]] - driven.known.start
    return layout, [(whole, part[:, at[:, np.newaxis], at]) for whole, part in zip(wholes, parts, strict=True)]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Total:
    """Products of all signals over the rows of a record that count and train, added up.

    Attributes:
        driven: the record's model.
        rows: (n_samples,) that count.
        all_count: whether all of them do.
        counted: (n_samples,) those of them that train.
        runs: of `counted`, first row and one past the last.
        blocks: and the products of what is known of each, over its rows that count.
        gram: (n_signals, n_signals) in the order of `driven`.
        sums: in its place, where products follow from each other.
        held_out: the label of blocks that do not train.
    """

    driven: Driven
    rows: BoolArray
    all_count: bool
    counted: BoolArray
    runs: Sequence[tuple[int, int]]
    blocks: Sequence[tuple[Block, FloatArray]]
    gram: FloatArray
    sums: "_Sums | None"
    held_out: int

    @classmethod
    def of(cls, driven: Driven, rows: BoolArray, blocks: Sequence[tuple[Block, FloatArray]], held_out: int) -> "_Total":
        """Nothing added up yet but what `blocks` hold."""
        counted = np.zeros(rows.size, dtype=np.bool_)
        for block, _ in blocks:
            if block.label != held_out:
                counted[block.rows] = rows[block.rows]
        runs = runs_of(counted)
        many = driven.known.start >= FEWEST_SIGNALS and counted.sum() >= FEWEST_ROWS * len(runs)
        return cls(
            driven=driven,
            rows=rows,
            all_count=bool(rows.all()),
            counted=counted,
            runs=runs,
            blocks=blocks,
            gram=np.zeros((driven.n_signals, driven.n_signals)),
            sums=_Sums.of(driven, near, runs) if many and 2 * (near := _near(driven.poles)).sum() < near.size else None,
            held_out=held_out,
        )

    def add(self, start: int, signals: FloatArray, after: ComplexArray) -> None:
        """A chunk of signals from row `start` on, and the sensitivities after it."""
        linear, stop = signals[self.driven.known], start + signals.shape[1]
        for block, total in self.blocks:
            first, last = max(start, block.first), min(stop, block.last)
            first += (block.first - first) % block.step
            if first < last:
                own = linear[:, first - start : last - start : block.step]
                own = own if self.all_count else own[:, self.rows[first : last : block.step]]
                own = np.ascontiguousarray(own) if block.step > 1 else own  # BLAS takes no steps within a signal
                total += own @ own.T  # noqa: PLW2901
        if len(self.runs) <= len(self.blocks):
            pieces = [
                (max(start, first), min(stop, last)) for first, last in self.runs if first < stop and last > start
            ]
            chosen = [signals[:, first - start : last - start] for first, last in pieces]
        else:  # rows are missing or take turns, and are copied together
            chosen = [signals[:, self.counted[start:stop]]]
        for one in chosen:
            if self.sums is None:
                self.gram[:] += one @ one.T
            else:
                self.sums.add(one)
        if self.sums is not None:
            self.sums.end(start, signals, after)

    def all_products(self) -> FloatArray:
        """(size, size) in the order of the layout."""
        gram = self.gram
        if self.sums is not None:
            gram = self.sums.gram(np.sum([own for block, own in self.blocks if block.label != self.held_out], axis=0))
        return gram[np.ix_(self.driven.places, self.driven.places)]


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
        reach: (n_poles,) one past the last that is near to each, zero where none is.
        runs: first row and one past the last.
        partners: (n_sensitivities, n_partners) sums of real signals with their partners, added up.
        squares: (n_inputs, n_inputs) products of the inputs.
        ends: (2, n_runs, 2 + n_inputs, n_poles) sensitivities at the first row of a run, and after its last.
        direct: (n_sensitivities, n_sensitivities) of real signals, where near.
    """

    driven: Driven
    near: BoolArray
    reach: IndexArray
    runs: Sequence[tuple[int, int]]
    partners: FloatArray
    squares: FloatArray
    ends: ComplexArray
    direct: FloatArray

    @classmethod
    def of(cls, driven: Driven, near: BoolArray, runs: Sequence[tuple[int, int]]) -> "_Sums":
        """Nothing added up yet."""
        n, m = driven.poles.size, driven.layout.n_inputs
        size = n * driven.n_families
        return cls(
            driven=driven,
            near=near,
            reach=np.where(near.any(axis=1), n - near[:, ::-1].argmax(axis=1), 0),
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
