"""The recursion x(k+1) = A x(k) + B u(k), y(k) = C x(k) + D u(k) over many samples, by matrix products.

Over a block of samples the outputs are one product with the block's inputs and one with the state at its start, and the
states at the starts of blocks are themselves a recursion that is blocked again. What is left for a Python loop is one
small product every few hundred samples. No eigenvectors are used, so defective and nearly defective models are as exact
as any; a state that grows without bound ends in infinite values, without a warning.

A squared power of A is known to eps |A^k|^2 only. Where |A^k| grows by orders before it decays (the companion form of
poles that lie close together, as of a transfer function of oversampled data) that error outgrows the power itself, and
a stable model would diverge. Such models are run sample by sample; which they are is asked in coordinates balanced by
powers of two, so that the units of the states do not count.

The innovation form run over an array forwards, and its adjoint backwards: the two passes behind a gain.

    forwards    e(k) = v(k) - C x(k),  x(k+1) = A x(k) + K e(k)
    backwards   s(k-1) = Abar' s(k) + C' W e(k),  Abar = A - K C,  s(last) = 0

The forward run forecasts v from its own past; where a sample is missing the state is not corrected by it, e counts as
zero. s(k) says how much the sum of e' W e falls for a push of the state at k + 1.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from okid.arrays import ComplexArray, FloatArray
from okid.errors import InvalidDataError
from okid.rows import runs_of

CHUNK_SAMPLES = 1 << 15
"""Samples that are worked on at a time, so that intermediate arrays stay in cache and mapped inputs on disk."""
POLE_BLOCK = 16
"""Multiply that many samples of a recursion with one pole at a time: the quickest of 8, 16 and 32 for any length."""
TRUSTED = 500.0
"""Rounding errors that a squared power of A may have, |A^k|^2 relative to |A^2k| or to that of a rotation."""


def simulate_array(
    A: FloatArray,
    B: FloatArray,
    C: FloatArray,
    D: FloatArray,
    inputs: FloatArray,
    *,
    initial_state: FloatArray | None = None,
) -> FloatArray:
    """Outputs of x(k+1) = A x(k) + B u(k), y(k) = C x(k) + D u(k).

    Args:
        A: (order, order).
        B: (order, n_inputs).
        C: (n_outputs, order).
        D: (n_outputs, n_inputs).
        inputs: (n_samples, n_inputs), finite.
        initial_state: (order,), zero unless given.

    Returns:
        (n_samples, n_outputs); infinite or NaN where an unstable model leaves the range of numbers.

    Example:
        >>> one = np.ones((1, 1))
        >>> simulate_array(0.5 * one, one, one, 0 * one, np.ones((4, 1))).ravel()
        array([0.  , 1.  , 1.5 , 1.75])
    """
    return run_from(A, B, C, D, inputs, state=checked_state(A.shape[0], initial_state))[0]


def run_from(
    A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, inputs: FloatArray, *, state: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """As `simulate_array`, returning the outputs and the state after the last sample."""
    n_samples, n_outputs = inputs.shape[0], C.shape[0]
    if A.shape[0] == 0:
        return inputs @ D.T, state
    outputs = np.empty((n_samples, n_outputs))
    balanced, (size, _) = scipy.linalg.matrix_balance(A, permute=False, separate=True)
    blocks = _Blocks.of(balanced, B / size[:, np.newaxis], C * size, D, n_samples)
    state = state / size
    with np.errstate(over="ignore", invalid="ignore"):
        for start in range(0, n_samples, CHUNK_SAMPLES):
            rows = slice(start, min(start + CHUNK_SAMPLES, n_samples))
            state = blocks.run(inputs[rows], state, outputs[rows])
    return outputs, state * size


def lifted(A: FloatArray, C: FloatArray, length: int) -> tuple[FloatArray, FloatArray]:
    """Observability matrix [C; C A; ...] of `length` block rows, and A^length; length a power of two.

    By doubling, or power by power where squares of A lose digits.
    """
    observability, power = C, A
    with np.errstate(over="ignore", invalid="ignore"):
        if _trusted_length(A, length) < length:
            rows = [C]
            for _ in range(length - 1):
                rows.append(rows[-1] @ A)
                power = power @ A
            return np.vstack(rows), power
        while observability.shape[0] < length * C.shape[0]:
            observability = np.vstack([observability, observability @ power])
            power = power @ power
    return observability, power


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PoleRecursion:
    """Several recursions x(k+1) = pole x(k) + drive(k), each with one pole inside the unit circle, over many samples.

    A block of samples is one product with its drive and the state at its start; the states at the starts of blocks are
    a recursion of the same form with the power of the pole.

    Attributes:
        poles: (n_poles,).
        kernel: (n_poles, 2, 2 block + 2, block) real and imaginary part of the states of a block, by imaginary and real
            part of its drive and by those of the state at its start.
        reach: (n_poles, 2 block, 2) state after a block by its drive, likewise.
        starts: of the blocks; None where there are too few of them.
    """

    poles: ComplexArray
    kernel: FloatArray
    reach: FloatArray
    starts: "PoleRecursion | None"

    @classmethod
    def of(cls, poles: ComplexArray, n_samples: int) -> "PoleRecursion":
        """Products for (n_poles,) poles and up to `n_samples` samples at a time.

        Example:
            >>> poles = np.array([0.5j])
            >>> states, after = PoleRecursion.of(poles, 3).run(np.ones((1, 3)), np.zeros(1))
            >>> states, after
            (array([[0.+0.j , 1.+0.j , 1.+0.5j]]), array([0.75+0.5j]))
        """
        powers = poles[:, np.newaxis] ** np.arange(POLE_BLOCK + 1)
        lags = np.arange(POLE_BLOCK) - 1 - np.arange(POLE_BLOCK)[:, np.newaxis]  # [sample of the drive, of the state]
        driven = np.where(lags >= 0, powers[:, np.maximum(lags, 0)], 0.0)
        free = powers[:, np.newaxis, :POLE_BLOCK]
        by_all = np.concatenate([1j * driven, driven, free, 1j * free], axis=1)
        after = powers[:, POLE_BLOCK - 1 :: -1]
        by_drive = np.concatenate([1j * after, after], axis=1)
        return cls(
            poles=poles,
            kernel=np.stack([by_all.real, by_all.imag], axis=1),
            reach=np.stack([by_drive.real, by_drive.imag], axis=2),
            starts=cls.of(powers[:, POLE_BLOCK], n_samples // POLE_BLOCK) if n_samples > POLE_BLOCK else None,
        )

    def run(self, drive: FloatArray | ComplexArray, state: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """States (n_poles, n_samples), and (n_poles,) the state after the last sample.

        Args:
            drive: (n_poles, n_samples) of each pole, or (1, n_samples) of all.
            state: (n_poles,) at the first sample.
        """
        parts = (drive.imag, drive.real) if np.iscomplexobj(drive) else (drive,)
        states = np.empty((self.poles.size, 2, drive.shape[1]))
        after = self.fill(states, np.stack(parts, axis=1), state)
        return states[:, 0] + 1j * states[:, 1], after

    def fill(self, states: FloatArray, drive: FloatArray, state: ComplexArray) -> ComplexArray:
        """Fill in the states, and give (n_poles,) that after the last sample.

        Args:
            states: (n_poles, 2, n_samples) room for real and imaginary parts.
            drive: (n_poles or 1, 2, n_samples) imaginary and real parts, or (n_poles or 1, 1, n_samples) real ones.
            state: (n_poles,) at the first sample.
        """
        n_poles, (_, n_parts, n_samples) = self.poles.size, drive.shape
        n_blocks = 0 if self.starts is None else n_samples // POLE_BLOCK
        whole, width = n_blocks * POLE_BLOCK, n_parts * POLE_BLOCK
        kernel = self.kernel[:, :, -width - 2 :]
        if self.starts is not None and n_blocks:
            stacked = np.empty((n_poles, n_blocks, width + 2))
            of_blocks = stacked[:, :, :width].reshape(n_poles, n_blocks, n_parts, POLE_BLOCK)
            of_blocks[:] = drive[:, :, :whole].reshape(-1, n_parts, n_blocks, POLE_BLOCK).swapaxes(1, 2)
            added = np.matmul(stacked[:, :, :width], self.reach[:, -width:])
            starts, state = self.starts.run(added.view(np.complex128)[:, :, 0], state)
            stacked[:, :, width:] = starts.view(np.float64).reshape(n_poles, n_blocks, 2)
            into = states[:, :, :whole].reshape(n_poles, 2, n_blocks, POLE_BLOCK)
            np.matmul(stacked[:, np.newaxis], kernel, out=into)
        if n_rest := n_samples - whole:  # not a block, or the only one
            rest = np.zeros((n_poles, width + 2))
            rest[:, :width].reshape(n_poles, n_parts, POLE_BLOCK)[:, :, :n_rest] = drive[:, :, whole:]
            rest[:, width], rest[:, width + 1] = state.real, state.imag
            last = np.matmul(rest[:, np.newaxis, np.newaxis], kernel)[:, :, 0, :n_rest]
            states[:, :, whole:] = last
            drives = drive[:, 0, -1] if n_parts == 1 else drive[:, 1, -1] + 1j * drive[:, 0, -1]
            state = self.poles * (last[:, 0, -1] + 1j * last[:, 1, -1]) + drives
        return state


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Blocks:
    """Products over blocks of `length` samples, and over `n_inner` such blocks for the states at their starts."""

    length: int
    n_inner: int
    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    both: FloatArray  # (length q, length m + n): outputs of a block from its inputs and from the state at its start
    reach: FloatArray  # (n, length m): state after a block from its inputs
    inner_power: FloatArray  # (n_inner n, n): states at the starts of blocks from the state at the first of them
    inner_pulses: FloatArray  # (n_inner n, n_inner n): the same from what each block adds to the state
    outer_power: FloatArray  # (n, n): A^(length n_inner)
    outer_reach: FloatArray  # (n, n_inner n)

    @classmethod
    def of(cls, A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, n_samples: int) -> "_Blocks":
        order, (n_outputs, n_inputs) = A.shape[0], D.shape
        longest = _trusted_length(A, max(1, n_samples // 4))
        length, n_inner = _block_lengths(order, n_outputs, n_inputs, n_samples, longest=longest)
        with np.errstate(over="ignore", invalid="ignore"):
            observability, power = lifted(A, C, length)
            pulses, reach = _response_to_inputs(A, B, D, observability, length)
            inner_power, outer_power = lifted(power, np.eye(order), n_inner)
            inner_pulses, outer_reach = _response_to_inputs(
                power, np.eye(order), np.zeros((order, order)), inner_power, n_inner
            )
        return cls(
            length=length,
            n_inner=n_inner,
            A=A,
            B=B,
            C=C,
            D=D,
            both=np.hstack([pulses, observability]),
            reach=reach,
            inner_power=inner_power,
            inner_pulses=inner_pulses,
            outer_power=outer_power,
            outer_reach=outer_reach,
        )

    def run(self, inputs: FloatArray, state: FloatArray, outputs: FloatArray) -> FloatArray:
        """Fill the outputs of a chunk; the state after it."""
        n_samples, n_inputs = inputs.shape
        n_blocks = n_samples // self.length
        whole = n_blocks * self.length
        if n_blocks:
            stacked = np.ascontiguousarray(inputs[:whole]).reshape(n_blocks, self.length * n_inputs)
            states, state = self._starts(stacked @ self.reach.T, state)
            np.matmul(np.hstack([stacked, states]), self.both.T, out=outputs[:whole].reshape(n_blocks, -1))
        for k in range(whole, n_samples):
            outputs[k] = self.C @ state + self.D @ inputs[k]
            state = self.A @ state + self.B @ inputs[k]
        return state

    def _starts(self, added: FloatArray, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """States at the starts of blocks, and after the last, from what each block adds."""
        n_blocks, order = added.shape
        n_outer = n_blocks // self.n_inner
        whole = n_outer * self.n_inner
        states = np.empty_like(added)
        if n_outer:
            stacked = added[:whole].reshape(n_outer, self.n_inner * order)
            steps = stacked @ self.outer_reach.T
            outer = np.empty((n_outer, order))
            for j in range(n_outer):
                outer[j] = state
                state = self.outer_power @ state + steps[j]
            inner = stacked @ self.inner_pulses.T
            inner += outer @ self.inner_power.T
            states[:whole] = inner.reshape(whole, order)
        block_power = self.inner_power[order : 2 * order] if self.n_inner > 1 else self.outer_power
        for j in range(whole, n_blocks):
            states[j] = state
            state = block_power @ state + added[j]
        return states, state


def _trusted_length(A: FloatArray, longest: int) -> int:
    """Length of block up to which powers of A may be used: `longest`, or 1 where squaring any of them loses digits."""
    power, squares = A, float(np.square(A).sum())
    reached = 1
    with np.errstate(over="ignore", invalid="ignore"):
        while reached < longest:
            power = power @ power
            above = float(np.square(power).sum())
            if not np.isfinite(above):
                return longest  # unstable: what overflows is not looked at, or said by the caller
            # As sums of squares: |A^k|^2 against |A^2k|, which grows as fast where A itself is unstable.
            if squares > TRUSTED * max(float(A.shape[0]), np.sqrt(above)):
                return 1
            reached, squares = 2 * reached, above
    return longest


def _block_lengths(order: int, n_outputs: int, n_inputs: int, n_samples: int, *, longest: int) -> tuple[int, int]:
    """Powers of two with the least estimated cost a sample: 25 flops a ns, 1.5 us a step of the loop over blocks."""
    best, choice = np.inf, (1, 1)
    for length in (1, 2, 4, 8, 16, 32, 64):
        for n_inner in (1, 2, 4, 8, 16, 32):
            if length * n_inner > min(longest, max(1, n_samples // 4)):
                continue
            flops = 2.0 * (length * n_outputs * n_inputs + order * (n_outputs + n_inputs))
            flops += (2 * order * order * (n_inner + 2)) / length if n_inner > 1 else 0.0
            loop = (1500.0 + order * order / 4) / (length * n_inner)
            setup = (length * n_outputs + n_inner * order) * (length * n_inputs + n_inner * order) * 1.0
            cost = flops / 25 + loop + setup / max(1, n_samples)
            if cost < best:
                best, choice = cost, (length, n_inner)
    return choice


def _response_to_inputs(
    A: FloatArray, B: FloatArray, D: FloatArray, observability: FloatArray, length: int
) -> tuple[FloatArray, FloatArray]:
    """Block Toeplitz matrix of the pulse response, and the reachability matrix [A^(length-1) B ... A B  B]."""
    n_outputs, n_inputs = D.shape
    pulse = np.vstack([D, observability[: (length - 1) * n_outputs] @ B]).reshape(length, n_outputs, n_inputs)
    pulses = np.zeros((length, n_outputs, length, n_inputs))
    reach, column = np.empty((A.shape[0], length, n_inputs)), B
    for j in range(length):
        pulses[j:, :, j] = pulse[: length - j]
        reach[:, length - 1 - j] = column
        column = A @ column
    return pulses.reshape(length * n_outputs, length * n_inputs), reach.reshape(A.shape[0], length * n_inputs)


def checked_state(order: int, initial_state: FloatArray | None) -> FloatArray:
    """The initial state as an array, zeros for None; an InvalidDataError unless it is `order` finite numbers."""
    if initial_state is None:
        return np.zeros(order)
    try:
        state = np.asarray(initial_state, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidDataError(f"the initial state must be {order} finite numbers ({error}).") from error
    if state.shape != (order,) or not np.isfinite(state).all():
        raise InvalidDataError(
            f"the initial state must be {order} finite numbers, one for each state, but has shape {state.shape}."
        )
    return state


def innovation_run(
    A: FloatArray, C: FloatArray, K: FloatArray, values: FloatArray, *, state: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Innovations of a series, zero where a sample is missing, and the state after it.

    Args:
        A: (order, order).
        C: (n_outputs, order).
        K: (order, n_outputs).
        values: (n_samples, n_outputs), NaN where missing.
        state: (order,) at the first sample.

    Returns:
        (n_samples, n_outputs) innovations, (order,) state; infinite or NaN where A - K C makes them grow without bound.

    Example:
        >>> one = np.ones((1, 1))
        >>> e, x = innovation_run(0.5 * one, one, 0.1 * one, np.array([[1.0], [np.nan], [1.0]]), state=np.zeros(1))
        >>> e.ravel(), x.round(4)
        (array([1.  , 0.  , 0.95]), array([0.12]))
    """
    B, D, none = (np.empty((rows, 0)) for rows in (A.shape[0], C.shape[0], values.shape[0]))
    predicted, state = one_step(A, B, C, D, K, inputs=none, outputs=values, state=state)
    return np.where(np.isnan(values), 0.0, values - predicted), state


def one_step(
    A: FloatArray,
    B: FloatArray,
    C: FloatArray,
    D: FloatArray,
    K: FloatArray,
    *,
    inputs: FloatArray,
    outputs: FloatArray,
    state: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """One-step prediction: x(k+1) = A x + B u + K e, e = y - C x - D u, zero where an output is missing.

    Args:
        A: (order, order).
        B: (order, n_inputs).
        C: (n_outputs, order).
        D: (n_outputs, n_inputs).
        K: (order, n_outputs).
        inputs: (n_samples, n_inputs), none missing.
        outputs: (n_samples, n_outputs), NaN where missing.
        state: (order,) at the first sample.

    Returns:
        (n_samples, n_outputs) C x + D u at every sample, (order,) state after the last; infinite or NaN where A - K C
        makes them grow without bound.

    Example:
        >>> one = np.ones((1, 1))
        >>> outputs = np.array([[0.0], [2.5], [0.0]])
        >>> model = 0.5 * one, one, 2 * one, 0 * one, 0.1 * one
        >>> one_step(*model, inputs=np.eye(3, 1), outputs=outputs, state=np.zeros(1))[0].ravel()
        array([0. , 2. , 1.1])
    """
    predicted = np.empty_like(outputs, subok=False)
    closed, feed, through = A - K @ C, np.hstack([B - K @ D, K]), np.hstack([D, np.zeros((C.shape[0],) * 2)])
    done = 0
    with np.errstate(over="ignore", invalid="ignore"):
        for start, stop in [*runs_of(np.asarray(~np.isnan(outputs).any(axis=1))), (outputs.shape[0],) * 2]:
            if start < stop < start + min(200, outputs.shape[0]):  # below, a step at a time is faster
                continue
            rows = slice(done, start)
            predicted[rows], state = _sample_by_sample((A, B, C, D, K), inputs[rows], outputs[rows], state)
            both = np.hstack([inputs[start:stop], outputs[start:stop]])
            predicted[start:stop], state = run_from(closed, feed, C, through, both, state=state)
            done = stop
    return predicted, state


def backward_states(A: FloatArray, C: FloatArray, K: FloatArray, weighted: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The adjoint of `innovation_run`.

    Args:
        A: (order, order).
        C: (n_outputs, order).
        K: (order, n_outputs).
        weighted: (n_samples, n_outputs) W e(k).

    Returns:
        (n_samples, order) s(k), and (order,) s(-1), the slope with respect to the state at the first sample.

    Example:
        >>> one = np.ones((1, 1))
        >>> s, first = backward_states(0.5 * one, one, 0.0 * one, np.array([[1.0], [2.0], [4.0]]))
        >>> s.ravel(), first
        (array([4., 4., 0.]), array([3.]))
    """
    order = A.shape[0]
    reversed_time = np.ascontiguousarray(weighted[::-1])
    none = np.zeros((order, C.shape[0]))
    with np.errstate(over="ignore", invalid="ignore"):
        states, first = run_from((A - K @ C).T, C.T, np.eye(order), none, reversed_time, state=np.zeros(order))
    return states[::-1], first


def finite_gramian(A: FloatArray, weight: FloatArray, length: int) -> FloatArray:
    """Sum over l = 0 ... length - 1 of A'^l W A^l, by doubling.

    Args:
        A: (order, order).
        weight: (order, order) W, symmetric.
        length: number of terms.

    Example:
        >>> finite_gramian(np.array([[0.5]]), np.array([[1.0]]), 3)
        array([[1.3125]])
    """
    total, power = np.zeros_like(weight), np.eye(A.shape[0])
    part, step = weight, A
    while length:
        if length & 1:
            total, power = part + step.T @ total @ step, power @ step
        length >>= 1
        part, step = part + step.T @ part @ step, step @ step
    return 0.5 * (total + total.T)


def _sample_by_sample(
    model: tuple[FloatArray, ...], inputs: FloatArray, outputs: FloatArray, state: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """As `one_step`, for a few rows or rows with gaps."""
    A, B, C, D, K = model
    forced = inputs @ D.T
    values, drive = outputs - forced, inputs @ B.T
    there = ~np.isnan(values)
    closed, pushes = A - K @ C, drive + np.where(there, values, 0.0) @ K.T
    states = np.empty((values.shape[0], A.shape[0]))
    complete = np.asarray(there.all(axis=1))
    for k in range(values.shape[0]):
        states[k] = state
        if complete[k]:
            state = closed @ state + pushes[k]
        else:
            state = A @ state + drive[k] + K @ np.where(there[k], values[k] - C @ state, 0.0)
    return states @ C.T + forced, state
