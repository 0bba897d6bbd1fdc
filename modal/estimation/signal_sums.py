"""The one Gram matrix that a refinement step needs: products of modal states, sensitivities, inputs and outputs.

All sums over rows that a Gauss-Newton step and its linear part need are products of the signals of
`modal.estimation.modal_states`, so a record is passed once and only its Gram matrices are kept: of all signals over the
rows that train, of those that are linear over each block of rows that is held out; of several choices of the rows where
outputs were not all measured in the same ones. Many sensitivities are not multiplied with each other, but follow from
what drives them.
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
    """Gram matrices: of all signals over the rows that train, of what is linear over those of each block held out.

    Args:
        parameters: of the model.
        records: without NaN in the inputs; outputs of rows that do not count may be anything finite.
        rows: (n_samples,) a record, True where a row counts.
        blocks: in the order of their rows, each record whole.
        n_direct: the first so many inputs act on the outputs at once.
        held_out: blocks with this label do not train.

    Returns:
        Layout of all signals, the (size, size) Gram matrix, and those of the own regressors and outputs of each block
        that is held out, (n_held_out, n, n): thirty records have thirty levels, of which a block has one.
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
    apart = [block for block in blocks if block.label == held_out]
    parts = np.zeros((len(choices), len(apart), *2 * (layout.alone.n_regressors + layout.n_outputs,)))
    beside: Driven | None = None
    for r, record in enumerate(records):
        beside = driven = Driven.of(layout, parameters, r, record, beside=beside)
        training = [block for block in blocks if block.record == r and block.label != held_out]
        totals = [
            _Total.of(driven, rows[r], training, [one for one in zip(apart, part, strict=True) if one[0].record == r])
            for rows, part in zip(choices, parts, strict=True)
        ]
        for start, signals, after in driven.signals():
            for total in totals:
                total.add(start, signals, after)
        places = layout.places(r)
        for whole, total in zip(wholes, totals, strict=True):
            whole[_all_of(places, layout.size)] += total.all_products()
    at = driven.places[np.r_[layout.alone.regressors, layout.alone.outputs]] - driven.known.start
    return layout, [(whole, part[:, at[:, np.newaxis], at]) for whole, part in zip(wholes, parts, strict=True)]


def _all_of(places: IndexArray, size: int) -> tuple[slice, slice] | tuple[IndexArray, ...]:
    """Of a matrix of that size the rows and columns at some places; all of them without a copy."""
    return (slice(None), slice(None)) if places.size == size else np.ix_(places, places)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Total:
    """Products of all signals over the rows of a record that count and train, added up.

    Attributes:
        driven: the record's model.
        rows: (n_samples,) that count.
        all_count: whether all of them do.
        counted: (n_samples,) those of them that train.
        runs: of `counted`, first row and one past the last.
        together: whether rows are copied together, because some are missing or they take turns.
        apart: blocks that are held out, and the products of what is known of each, over its rows that count.
        gram: (n_signals, n_signals) in the order of `driven`; empty where there are `sums`.
        sums: in its place, where products follow from each other.
    """

    driven: Driven
    rows: BoolArray
    all_count: bool
    counted: BoolArray
    runs: Sequence[tuple[int, int]]
    together: bool
    apart: Sequence[tuple[Block, FloatArray]]
    gram: FloatArray
    sums: "_Sums | None"

    @classmethod
    def of(
        cls, driven: Driven, rows: BoolArray, training: Sequence[Block], apart: Sequence[tuple[Block, FloatArray]]
    ) -> "_Total":
        """Nothing added up yet but what those `apart` hold."""
        counted = np.zeros(rows.size, dtype=np.bool_)
        for block in training:
            counted[block.rows] = rows[block.rows]
        runs = runs_of(counted)
        many = driven.others.start >= FEWEST_SIGNALS and counted.sum() >= FEWEST_ROWS * len(runs)
        near = _near(driven.poles)
        follow = many and 2 * near.sum() < near.size
        size = 0 if follow else driven.n_signals
        return cls(
            driven=driven,
            rows=rows,
            all_count=bool(rows.all()),
            counted=counted,
            runs=runs,
            together=len(runs) > len(training),
            apart=apart,
            gram=np.zeros((size, size)),
            sums=_Sums.of(driven, near, runs) if follow else None,
        )

    def add(self, start: int, signals: FloatArray, after: ComplexArray) -> None:
        """A chunk of signals from row `start` on, and the sensitivities after it."""
        linear, stop = signals[self.driven.known], start + signals.shape[1]
        for block, total in self.apart:
            first, last = max(start, block.first), min(stop, block.last)
            first += (block.first - first) % block.step
            if first < last:
                own = linear[:, first - start : last - start : block.step]
                own = own if self.all_count else own[:, self.rows[first : last : block.step]]
                own = np.ascontiguousarray(own) if block.step > 1 else own  # BLAS takes no steps within a signal
                total += own @ own.T  # noqa: PLW2901
        over = self.driven.n_over(start)
        moving = signals[over:]
        if self.together:
            chosen = [np.compress(self.counted[start:stop], moving, axis=1)]
        else:
            pieces = [
                (max(start, first), min(stop, last)) for first, last in self.runs if first < stop and last > start
            ]
            chosen = [moving[:, first - start : last - start] for first, last in pieces]
        for one in chosen:
            if self.sums is None:
                self.gram[over:, over:] += one @ one.T
            else:
                self.sums.add(one, over)
        if self.sums is not None:
            self.sums.end(start, signals, after)

    def all_products(self) -> FloatArray:
        """(size, size) in the order of the layout."""
        if self.sums is not None:
            return self.sums.gram()
        places = self.driven.places
        return self.gram[np.ix_(places, places)]


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
        near: (2, n_near) first and second pole of pairs that hardly die out, the first no later than the second.
        runs: first row and one past the last.
        partners: (n_sensitivities, n_partners) sums of real signals with their partners, added up.
        squares: (n_partners + 2 n_poles, same) products of partners and states.
        ends: (2, n_runs, 2 + n_inputs, n_poles) sensitivities at the first row of a run, and after its last.
        direct: (n_near, 2 n_families, 2 n_families) of real signals, where near.
    """

    driven: Driven
    near: IndexArray
    runs: Sequence[tuple[int, int]]
    partners: FloatArray
    squares: FloatArray
    ends: ComplexArray
    direct: FloatArray

    @classmethod
    def of(cls, driven: Driven, near: BoolArray, runs: Sequence[tuple[int, int]]) -> "_Sums":
        """Nothing added up yet."""
        n, m, n_own = driven.poles.size, driven.layout.n_inputs, 2 * driven.n_families
        pairs = np.array(np.nonzero(np.triu(near)))
        return cls(
            driven=driven,
            near=pairs,
            runs=runs,
            partners=np.zeros((n_own * n, len(driven.partners))),
            squares=np.zeros(2 * (driven.n_signals - driven.others.start,)),
            ends=np.zeros((2, len(runs), 2 + m, n), dtype=np.complex128),
            direct=np.zeros((pairs.shape[1], n_own, n_own)),
        )

    def add(self, signals: FloatArray, over: int) -> None:
        """Rows that train, of all signals but the first ones, which are zero."""
        n, size = self.driven.poles.size, len(self.partners) - over
        own, others = signals[:size], signals[size:]
        self.partners[over:] += own @ others[: self.partners.shape[1]].T
        self.squares[:] += others @ others.T
        alive = self.direct[:, over // n :, over // n :]
        for total, i, j in zip(alive, *self.near.tolist(), strict=True):
            total += own[i::n] @ own[j::n].T  # noqa: PLW2901

    def end(self, start: int, signals: FloatArray, after: ComplexArray) -> None:
        """What is at the ends of runs that lie in a chunk."""
        stop, n = start + signals.shape[1], self.driven.poles.size

        def at(row: int) -> ComplexArray:
            s = signals[: len(self.partners), row - start].reshape(-1, 2, n)
            return np.asarray(s[:, 0] + 1j * s[:, 1])

        for i, (first, last) in enumerate(self.runs):
            if start <= first < stop:
                self.ends[0, i] = at(first)
            if start < last <= stop:
                self.ends[1, i] = after if last == stop else at(last)

    def gram(self) -> FloatArray:
        """(size, size) all products in the order of the layout."""
        driven, layout, n, m = self.driven, self.driven.layout, self.driven.poles.size, self.driven.layout.n_inputs
        into = np.roll(np.arange(m), layout.n_direct)  # as in the layout: those that act at once first
        order = np.array([1 + m, *range(1, 1 + m), 0])  # families of the layout
        partners = self.partners.reshape(2 + m, 2, n, -1)[order].swapaxes(0, 1)
        d = self.direct.reshape(-1, 2 + m, 2, 2 + m, 2)[:, order][:, :, :, order]
        products_of = partial(
            _products,
            driven.poles,
            np.vstack([driven.participations.T, driven.start]),
            sums=(partners[0] + 1j * partners[1])[:, :, into],
            ends=self.ends[:, :, order],
            squares=self.squares[np.ix_(into, into)],
            near=self.near,
        )
        same, crossed = d[:, :, 0, :, 0] + 1j * d[:, :, 1, :, 0], d[:, :, 1, :, 1] - 1j * d[:, :, 0, :, 1]
        upper = products_of(direct=same + crossed, turn=np.conjugate)
        plain = products_of(direct=same - crossed, turn=np.positive)
        upper += plain
        upper *= 0.5
        lower = upper - plain
        gram = np.empty((layout.size, layout.size))
        states, sensitivities = (slice(0, n), slice(n, 2 * n)), (layout.real, layout.imaginary)
        for columns, own in ((states, slice(0, n)), (sensitivities, slice(n, None))):
            gram[layout.real, columns[0]] = upper[:, own].real
            gram[layout.imaginary, columns[0]] = upper[:, own].imag
            gram[layout.imaginary, columns[1]] = lower[:, own].real
            np.negative(lower[:, own].imag, out=gram[layout.real, columns[1]])
        both = slice(layout.real.start, layout.imaginary.stop)
        with_known = partners.reshape(both.stop - both.start, -1)[:, m - layout.n_direct :]
        gram[both, 2 * n : layout.n_regressors] = with_known[:, : layout.n_direct + 1]
        gram[both, layout.outputs] = with_known[:, layout.n_direct + 1 :]
        for rest in (layout.regressors, layout.outputs):
            gram[rest, both] = gram[both, rest].T
        known = np.r_[layout.regressors, layout.outputs]
        at = driven.places[known] - driven.others.start
        gram[np.ix_(known, known)] = self.squares[np.ix_(at, at)]
        return gram


def _products(
    poles: ComplexArray,
    driven: ComplexArray,
    *,
    sums: ComplexArray,
    ends: ComplexArray,
    squares: FloatArray,
    direct: ComplexArray,
    near: IndexArray,
    turn: Callable[[ComplexArray], ComplexArray],
) -> ComplexArray:
    """(n_sensitivities, n_poles + n_sensitivities) products of sensitivities with states and with sensitivities.

    Args:
        poles: (n_poles,).
        driven: (n_inputs + 1, n_poles) how far each input, and a start at one, drive a state.
        sums: (2 + n_inputs, n_poles, n_inputs) products of sensitivities with inputs.
        ends: (2, n_runs, 2 + n_inputs, n_poles) sensitivities at the first row of each run, and after its last.
        squares: (n_inputs, n_inputs) products of the inputs.
        direct: (n_near, 2 + n_inputs, 2 + n_inputs) products of sensitivities to two poles that are summed up.
        near: (2, n_near) which.
        turn: of the second factor: its conjugate or itself.
    """
    m, n = squares.shape[0], poles.size
    other, both_poles = turn(poles), np.multiply.outer(poles, turn(poles))
    first, second = np.hstack([near, near[::-1]])
    direct = np.concatenate([direct, turn(direct).swapaxes(1, 2)])
    left = 1.0 - both_poles
    left[first, second] = 1.0
    sums = np.pad(sums, ((0, 0), (0, 0), (0, 1)))  # nothing drives what rings down from its start

    def gone(one: int | slice, two: int | slice) -> ComplexArray:
        came, went = (np.tensordot(end[:, one], turn(end[:, two]), axes=(0, 0)) for end in ends)
        return np.asarray(came - went)

    others = slice(1, None)  # than those to the poles, first among each other
    base = gone(others, others)
    base += poles[:, np.newaxis, np.newaxis] * sums[1:, :, :, np.newaxis]
    base += (turn(sums[1:]).transpose(2, 0, 1) * other)[:, np.newaxis]
    base += np.pad(squares, (0, 1))[:, np.newaxis, :, np.newaxis]
    base /= left[:, np.newaxis]
    base[:, first, :, second] = direct[:, 1:, 1:]
    with_states = np.einsum("aibk,bk->aik", base, turn(driven))
    states = np.einsum("ai,aik->ik", driven, with_states)
    # the sensitivities to the poles are driven by poles times states
    drives = turn(np.einsum("bk,bkl->lk", driven, sums[1:]) + sums[0].T)
    to_poles = other * (poles[:, np.newaxis] * with_states + drives[:, np.newaxis]) + gone(others, 0)
    to_poles /= left
    to_poles[:, first, second] = direct[:, 1:, 0].T
    ahead = np.einsum("ai,aik->ik", driven, to_poles)
    behind = turn(ahead).T
    twice = (both_poles * (ahead + behind + states) + gone(0, 0)) / left
    twice[first, second] = direct[:, 0, 0]
    found = np.empty((2 + m, n, 3 + m, n), dtype=np.complex128)
    found[0, :, 0], found[1:, :, 0] = behind, with_states
    found[0, :, 1], found[1:, :, 1] = twice, to_poles
    found[0, :, 2:], found[1:, :, 2:] = turn(to_poles).transpose(2, 0, 1), base
    return found.reshape((2 + m) * n, -1)
