"""Outputs that are late against the others by parts of a sample, as behind a multiplexed converter or a second logger.

An output is late here that shows a motion late; a converter that takes it late shows it early.

An output that is tau late turns its component of every shape by -w tau, a phase that grows with the frequency of the
mode. Shapes of lightly damped structures are real, up to one turn of the whole mode:

    c_jr = a_jr exp(i (theta_r - w_r tau_j)) + noise,   a_jr real

A state space model of free order holds delays of parts of a sample too, in turned shapes, in D and in poles that no
structure has. So nothing in its fit tells of them; that all modes turn alike does. Real shapes are never quite real,
and poles of noise have shapes at random: of each mode any share of the shape may be complex, and what that share is
counts nothing. A mode that no delay makes real then is a mode that tells nothing, and the others decide.

References:
    Heylen, Lammens, Sas, Modal Analysis Theory and Testing, 1997, A.3 (real modes of proportional damping); Sivia,
    Skilling, Data Analysis: A Bayesian Tutorial, 2006, 8.3 (data of which some may be outliers).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
import scipy
from numpy.typing import NDArray

from modal.modes.extraction import mean_phase_deviation, phase_collinearity
from modal.modes.modal_form import largest_component
from modal.modes.mode import Choice, ModalModel
from modal.wording.text import shorten
from okid.arrays import ComplexArray, FloatArray
from okid.record import Record

Scalar = TypeVar("Scalar", bound=np.generic)

LATEST, STEP = 4.0, 0.05
"""Look for outputs that are so many samples late or early at most, in steps of which ten are one radian at Nyquist."""
FINER = 10
"""Look again beside the best of the steps in so many of each."""
USUAL = 1.0
"""Take a lateness for e times less likely with each so many samples: few modes do not tell those a period apart."""
COMPLEX = np.geomspace(1e-3, 1.0, 10)
"""Take each of these shares of a shape, none to all of it, for as likely to be complex."""
ODDS = 1e4
"""Call an output late where the shapes are so many times as likely as if it were not."""
LEAST = 0.05
"""Leave outputs that differ by no more samples as they are: anti-alias filters of one kind differ by as much."""
STARTS = 4
"""Climb from the delays against each of so many outputs that hear the modes best, and from none."""
ROUNDS = 20
"""Stop after so many rounds over all outputs, where most need three."""
SKEWED = "output skew"
"""Call the choice so."""
LIKE = "as behind a multiplexed converter (which shows early what it samples late), a second logger or another filter"
"""Say so what makes an output late."""
MOST_NAMED = 6
"""Name so many outputs in a sentence, which then counts the others."""


@dataclass(frozen=True, slots=True, eq=False)
class Skew:
    """Outputs that are late against most others.

    Attributes:
        late: (n_outputs,) samples of the records looked at, below zero early; nothing where none is.
        choices: what was found and why; nothing where nothing was.
        warnings: what the user must read.
    """

    late: tuple[float, ...] = ()
    choices: tuple[Choice, ...] = ()
    warnings: tuple[str, ...] = ()

    @classmethod
    def of(cls, late: Sequence[float], record: Record, *, factor: int = 1) -> "Skew":
        """In words, `factor` the samples that were made one.

        Example:
            >>> record = Record([], np.zeros((3, 2)), 0.01, output_names=["tip", "root"])
            >>> Skew.of([0.0, 0.5], record).warnings[0][38:89]
            "the motion shows in 'root' 0.50 samples late (0.005"
        """
        if not any(late):
            return cls()
        said = [
            f"{shorten(name)!r} {factor * abs(samples):.2f} samples {'late' if samples > 0 else 'early'} "
            f"({abs(samples) * record.dt:.3g} s)"
            for name, samples in zip(record.output_names, late, strict=True)
            if samples
        ]
        words = ", ".join(said[:MOST_NAMED]) + (f" and {len(said) - MOST_NAMED} more" if len(said) > MOST_NAMED else "")
        why = (
            "with it off, the shapes of all modes are real at once; whole samples were taken off the records, the rest "
            "off the shapes"
        )
        text = (
            f"Outputs are late against one another: the motion shows in {words}, {LIKE}; that was taken off. Check "
            "clocks and filters of these channels."
        )
        return cls(tuple(late), (Choice(what=SKEWED, value=words, reason=why),), (text,))

    @property
    def whole(self) -> tuple[int, ...]:
        """(n_outputs,) samples that are taken off the records."""
        return tuple(round(samples) for samples in self.late)

    @property
    def rest(self) -> tuple[float, ...]:
        """(n_outputs,) parts of samples that are left, and are taken off the shapes."""
        return tuple(samples - round(samples) for samples in self.late)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MeasuredShapes:
    """Shapes of the poles of a model, each output in a unit of its own size.

    Attributes:
        angular: (n_modes,) frequencies [rad/sample].
        shapes: (n_modes, n_outputs).
        variance: (n_modes, n_outputs) of the real part, and of the imaginary part, by noise.
    """

    angular: FloatArray
    shapes: ComplexArray
    variance: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Likelihood:
    """Of delays, for any share of each shape that may be complex.

    With v = variance + (share size)^2 and the turn theta of a mode at its best, a shape misses the real axis by

        sum_j |Im|^2 / v_j = (sum_j |c_j|^2 / v_j - |sum_j c_j^2 exp(2 i w tau_j) / v_j|) / 2

    Attributes:
        squares: (n_shares, n_modes, n_outputs) c^2 / v.
        base: (n_shares, n_modes) what no delay changes.
        angular: (n_modes,).
        turns: factors of c^2 that are tried: -1 for an output that is another derivative of motion.
    """

    squares: ComplexArray
    base: FloatArray
    angular: FloatArray
    turns: tuple[float, ...]

    @classmethod
    def of(cls, measured: MeasuredShapes, turns: tuple[float, ...]) -> "_Likelihood":
        power = np.abs(measured.shapes) ** 2
        n_outputs = power.shape[1]
        own = COMPLEX[:, np.newaxis, np.newaxis] ** 2 * power.mean(axis=1)[:, np.newaxis]
        variance = measured.variance + own
        size = np.log(variance).sum(axis=2) * (n_outputs - 1) / n_outputs  # one phase is the turn's
        base = -0.5 * ((power / variance).sum(axis=2) + size)
        return cls(measured.shapes**2 / variance, base, measured.angular, turns)

    def turned(self, late: FloatArray, turn: FloatArray) -> ComplexArray:
        """(n_shares, n_modes, n_outputs) the squares with these delays taken off."""
        return self.squares * (turn * np.exp(2j * np.outer(self.angular, late)))

    def of_sums(self, sums: ComplexArray) -> FloatArray:
        """Logarithms, of (..., n_shares, n_modes) sums over the outputs."""
        each = self.base + 0.5 * np.abs(sums)
        most = each.max(axis=-2, keepdims=True)
        return np.asarray((most[..., 0, :] + np.log(np.exp(each - most).sum(axis=-2))).sum(axis=-1))

    def best_of(self, rest: ComplexArray, output: int, tried: FloatArray, usual: float) -> tuple[float, float, float]:
        """The delay among those tried, the turn, and the logarithm, for one output beside the rest of the sum."""
        turning = np.exp(2j * np.outer(tried, self.angular))[:, np.newaxis] * self.squares[:, :, output]
        found = np.array([self.of_sums(rest + turn * turning) for turn in self.turns]) - np.abs(tried - usual) / USUAL
        turn, place = np.unravel_index(int(found.argmax()), found.shape)
        return float(tried[place]), self.turns[turn], float(found[turn, place])

    def climbed(self, late: FloatArray, turn: FloatArray, *, reach: float, step: float) -> float:
        """Move one output after the other to its best delay within reach, in place, until none moves."""
        around = _steps(reach, step)
        last = -np.inf
        for _ in range(ROUNDS):
            for j in range(late.size):
                squares = self.turned(late, turn)
                rest = squares.sum(axis=2) - squares[:, :, j]
                tried = around if reach == LATEST else late[j] + around
                late[j], turn[j], value = self.best_of(rest, j, tried, float(np.median(np.delete(late, j))))
            if not value > last:
                break
            last = value
        return float(self.of_sums(self.turned(late, turn).sum(axis=2))) - np.abs(late - np.median(late)).sum() / USUAL

    def gains(self, late: FloatArray, turn: FloatArray, at: float) -> tuple[FloatArray, FloatArray]:
        """(n_outputs,) how much likelier each output is with its own delay than with that of another, and the price.

        The price of a free delay is the logarithm of how much narrower its likelihood is than what was expected of it.
        """
        squares = self.turned(late, turn)
        total = squares.sum(axis=2)
        now, fine = float(self.of_sums(total)), _steps(STEP, STEP / FINER)
        gain, price = np.empty(late.size), np.empty(late.size)
        for j in range(late.size):
            rest = total - squares[:, :, j]
            gain[j] = now - self.best_of(rest, j, np.array([at]), at)[2]
            turning = np.exp(2j * np.outer(fine, self.angular))[:, np.newaxis] * squares[:, :, j]
            narrow = scipy.special.logsumexp(self.of_sums(rest + turning) - now) + np.log(STEP / FINER)
            price[j] = np.log(2.0 * USUAL) + abs(late[j] - at) / USUAL - narrow
        return gain, price


def skew_of_shapes(measured: MeasuredShapes, *, same_kind: bool = False) -> FloatArray:
    """By how many samples each output is late, so that most are not.

    Args:
        measured: shapes of all poles that ring, of noise too.
        same_kind: whether all outputs are known to be the same derivative of motion; else a quarter turn is no delay.

    Returns:
        (n_outputs,) [samples], below zero where an output is early, 0 where the shapes do not say it beyond chance.

    Example:
        >>> shapes = np.array([[1.0, 0.8, 0.5], [1.0, -0.3, -0.9], [0.6, -1.0, 0.7]])
        >>> angular = np.array([0.4, 1.1, 1.9])
        >>> turned = shapes * np.exp(-1j * np.outer(angular, [0.0, 0.0, 0.7]))
        >>> found = MeasuredShapes(angular=angular, shapes=turned, variance=np.full((3, 3), 1e-6))
        >>> skew_of_shapes(found).round(2).tolist()
        [0.0, 0.0, 0.7]
    """
    n_modes, n_outputs = measured.shapes.shape
    none = np.zeros(n_outputs)
    if n_modes < 2 or n_outputs < 2:
        return none
    asked = _Likelihood.of(measured, (1.0,) if same_kind else (1.0, -1.0))
    together, turn = np.zeros(n_outputs), np.ones(n_outputs)
    asked.climbed(together, turn, reach=0.0, step=STEP)
    at_once = float(asked.of_sums(asked.turned(together, turn).sum(axis=2)))
    heard = np.log1p(np.abs(measured.shapes) ** 2 / measured.variance).sum(axis=0)
    against = [_against(asked, one) for one in np.argsort(-heard)[:STARTS].tolist()]
    found = [_climbed_from(asked, start) for start in (none, *against)]
    late, turn, _ = max(found, key=lambda one: one[2])
    told = [np.subtract(*asked.gains(late, turn, at)) for at in late]
    beside = [one < np.log(ODDS) for one in told]
    # most keep time, and where as many do the others are least late
    keep = max(range(n_outputs), key=lambda i: (int(beside[i].sum()), -float(np.abs(late - late[i])[~beside[i]].sum())))
    price = asked.gains(late, turn, float(late[keep]))[1]
    late = np.where(beside[keep], 0.0, late - float(np.median(late[beside[keep]])))
    late[np.abs(late) < LEAST] = 0.0
    likelier = float(asked.of_sums(asked.turned(late, turn).sum(axis=2))) - at_once - float(price[late != 0.0].sum())
    return late if likelier > np.log(ODDS) else none


def _against(asked: _Likelihood, one: int) -> FloatArray:
    """(n_outputs,) delays of each output against one, as those two alone tell them."""
    late = [
        asked.best_of(asked.squares[:, :, one], j, _steps(LATEST, STEP), 0.0)[0] for j in range(asked.squares.shape[2])
    ]
    return np.array(late) - late[one]


def _steps(reach: float, step: float) -> FloatArray:
    return np.asarray(np.arange(-round(reach / step), round(reach / step) + 1) * step, dtype=np.float64)


def _climbed_from(asked: _Likelihood, start: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    late, turn = start.copy(), np.ones(start.size)
    asked.climbed(late, turn, reach=LATEST, step=STEP)
    value = asked.climbed(late, turn, reach=STEP, step=STEP / FINER)
    return late, turn, value


def rows_on_time(values: NDArray[Scalar], whole: Sequence[int]) -> NDArray[Scalar]:
    """(n_rows, n_outputs) each column from as many rows later; rows that some column lacks go.

    Example:
        >>> rows_on_time(np.array([[1.0, 0.0], [2.0, 1.0], [3.0, 2.0]]), [0, 1]).tolist()
        [[1.0, 1.0], [2.0, 2.0]]
    """
    first, last = _kept(len(values), whole)
    return np.column_stack([values[first + w : last + w, j] for j, w in enumerate(whole)])


def on_time(records: Sequence[Record], whole: Sequence[int]) -> tuple[Record, ...]:
    """The records with each output taken from as many samples later as it is late.

    Example:
        >>> record = Record([5.0, 6.0, 7.0], [[1.0, 0.0], [2.0, 1.0], [3.0, 2.0]], 1.0)
        >>> on_time([record], [0, 1])[0].inputs.ravel().tolist()
        [5.0, 6.0]
    """
    if not any(whole):
        return tuple(records)
    return tuple(
        replace(one.samples(*_kept(one.n_samples, whole)), outputs=rows_on_time(one.outputs, whole)) for one in records
    )


def _kept(n_rows: int, whole: Sequence[int]) -> tuple[int, int]:
    return max(0, -min(whole)), n_rows - max(0, *whole)


def turned_back(modes: ModalModel, rest: Sequence[float]) -> ModalModel:
    """Modes with shapes as of outputs on time: what parts of a sample turn does not belong to the structure.

    Args:
        modes: of outputs that are late.
        rest: (n_outputs,) samples by which they are; nothing where none is.
    """
    if not any(rest):
        return modes
    made = []
    for mode in modes.modes:
        turn = np.exp(1j * mode.pole.imag * modes.dt * np.asarray(rest))
        shapes = (mode.shape * turn)[:, np.newaxis]
        largest = complex(largest_component(shapes)[0])
        shapes = shapes * (abs(largest) / largest)
        collinear = float(phase_collinearity(shapes)[0])
        made.append(
            replace(
                mode,
                shape=shapes[:, 0],
                participation=mode.participation * (largest / abs(largest)),
                phase_collinearity=collinear,
                mpd=float(mean_phase_deviation(shapes)[0]),
                cmi=mode.emac * collinear,
            )
        )
    return replace(modes, modes=tuple(made))
