"""The continuous-time system that a discrete-time state space samples, and its real modal form.

With the zero-order hold the sampled matrices stand in one exponential, exp([[A, B], [0, 0]] dt) = [[Ad, Bd], [0, I]],
so A and B in its logarithm. With straight lines between samples (triangle hold; Franklin, Powell, Workman 1998, section
6.3.2) Bd = (P1 + Ad P2 - P2) B and Dd = D + C P2 B, where P1 is the integral of exp(A s) over a step and P2 that of
exp(A (dt - s)) s / dt. A band-limited input has no hold: sampled input and output are in the relation of the
continuous-time frequency response itself, so B and D are those that come nearest to it below half the sampling
frequency, with the poles as they are.

In real modal form A becomes block diagonal: [[s, w], [-w, s]] for a pair of poles s +- i w, s for a real pole. Each s
and w is one number that A depends on linearly, shapes and participations stay. Where poles coincide so that there are
no independent shapes (a free mass: two poles at zero) the real Schur form stands in: the same blocks, with couplings
above them. States are scaled so that each block's rows of B and columns of C are of one size.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from modal.simulation import UNDAMPED_DEVIATION
from modal.simulation.plant import LinearParameter
from okid.arrays import ROUNDED, ComplexArray, FloatArray, frozen, time_step
from okid.errors import InvalidDataError, NumericalError
from okid.record import InputHold

_ROUNDING = 1e-8
"""Refuse a result that, sampled again, differs from the given matrices by more than this share."""

UNDAMPED = 1e-6
"""Count a mode as undamped below this damping ratio."""

_BAND = 0.8
"""Match a band-limited relation up to this share of the Nyquist frequency."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ContinuousSystem:
    """x' = A x + B u, y = C x + D u.

    Attributes:
        A: (n_states, n_states) [1/s].
        B: (n_states, n_inputs).
        C: (n_outputs, n_states).
        D: (n_outputs, n_inputs).
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray

    def response(self, angular_frequencies: FloatArray) -> ComplexArray:
        """(n_frequencies, n_outputs, n_inputs) C (i w - A)^-1 B + D at angular frequencies [rad/s]."""
        return _response(self.A, self.B, self.C, self.D, 1j * np.asarray(angular_frequencies, dtype=np.complex128))


def continuous_system(system: Any, *, input_hold: InputHold, dt: float | None = None) -> ContinuousSystem:
    """The continuous-time matrices of a state space, converted under the hold where it is discrete.

    Args:
        system: With matrices A, B, C, D and a time step dt: `era.Realisation` or `control.StateSpace`; a step of 0 or
            None is continuous time, True discrete time with the step of the record.
        input_hold: Of the record's input between samples; it does not matter to a continuous-time system.
        dt: Time step of the records [s], to be checked against that of the system.

    Raises:
        InvalidDataError: No state space, a time step that is not that of the records, or a system that no
            continuous-time one samples to: a pole at zero or on the negative real axis.
        NumericalError: The logarithm is not exact.

    Example:
        >>> import control
        >>> given = control.ss([[0.5]], [[1.0]], [[2.0]], [[0.0]], 0.1)
        >>> continuous_system(given, input_hold="zero_order").A.round(4)
        array([[-6.9315]])
    """
    missing = [name for name in ("A", "B", "C", "D", "dt") if not hasattr(system, name)]
    if missing:
        raise InvalidDataError(
            f"a state space has matrices A, B, C, D and dt, but {type(system).__name__} lacks {', '.join(missing)}; "
            "pass control.StateSpace (control.ss(...) makes one) or era.Realisation."
        )
    D = frozen(system.D, name="D", shape=(None, None))
    n_states = np.shape(system.A)[0]
    A = frozen(system.A, name="A", shape=(n_states, n_states))
    B = frozen(system.B, name="B", shape=(n_states, D.shape[1]))
    C = frozen(system.C, name="C", shape=(D.shape[0], n_states))
    step = _step(system.dt, dt)
    if step is None or n_states == 0:
        return ContinuousSystem(A=A, B=B, C=C, D=D)
    _check_poles(A, step)
    if input_hold == "zero_order":
        found = _from_zero_order(A, B, C, D, step)
    elif input_hold == "linear":
        found = _from_linear(A, B, C, D, step)
    else:
        found = _from_band_limited(A, B, C, D, step)
    return found


def _step(own: Any, dt: float | None) -> float | None:
    """The time step of the system [s]; None in continuous time."""
    if own is None or (not isinstance(own, bool) and own == 0):
        return None
    if isinstance(own, bool):
        if dt is None:
            raise InvalidDataError(
                "a discrete system needs a time step in seconds, but this one has dt=True; give it that of the record."
            )
        return time_step(dt)
    step = time_step(own)
    if dt is not None and abs(step - dt) > 1e-6 * dt:
        raise InvalidDataError(
            f"the model and the records must have one time step, but the model has {step:.6g} s and the records "
            f"{dt:.6g} s; convert the model to continuous time, or decimate the records."
        )
    return step


def _check_poles(Ad: FloatArray, dt: float) -> None:
    poles = np.linalg.eigvals(Ad)
    n_delays = int((np.abs(poles) < ROUNDED).sum())
    if n_delays:
        raise InvalidDataError(
            f"a continuous-time model has no discrete pole at 0, but this one has {n_delays} (a "
            "delay of whole samples, or more states than the data hold); leave them out and give a delay as an effect."
        )
    negative = poles[(np.abs(poles.imag) <= ROUNDED * np.abs(poles)) & (poles.real < 0)]
    if negative.size:
        raise InvalidDataError(
            f"a continuous-time model has no discrete pole on the negative real axis, but this one has one at "
            f"{negative[0].real:.4g}, at the Nyquist frequency of {0.5 / dt:.4g} Hz; leave that mode out, or sample "
            "faster."
        )


def _from_zero_order(Ad: FloatArray, Bd: FloatArray, C: FloatArray, D: FloatArray, dt: float) -> ContinuousSystem:
    n_states, n_inputs = Bd.shape
    block = np.eye(n_states + n_inputs)
    block[:n_states] = np.hstack([Ad, Bd])
    rates = _logarithm(block) / dt
    return ContinuousSystem(A=rates[:n_states, :n_states], B=rates[:n_states, n_states:], C=C, D=D)


def _from_linear(Ad: FloatArray, Bd: FloatArray, C: FloatArray, Dd: FloatArray, dt: float) -> ContinuousSystem:
    n_states = len(Ad)
    A = _logarithm(Ad) / dt
    block = np.zeros((3 * n_states,) * 2)
    block[:n_states, : 2 * n_states] = np.hstack([A, np.eye(n_states)]) * dt
    block[n_states : 2 * n_states, 2 * n_states :] = np.eye(n_states)
    flow = scipy.linalg.expm(block)[:n_states]
    first, second = flow[:, n_states : 2 * n_states], flow[:, 2 * n_states :]
    B = np.linalg.solve(first + Ad @ second - second, Bd)
    return ContinuousSystem(A=A, B=B, C=C, D=Dd - C @ second @ B)


def _from_band_limited(Ad: FloatArray, Bd: FloatArray, C: FloatArray, Dd: FloatArray, dt: float) -> ContinuousSystem:
    """B and D of the frequency response, by least squares over lines that crowd at the resonances."""
    A = _logarithm(Ad) / dt
    limit = _BAND * np.pi / dt
    poles = np.linalg.eigvals(A)
    near = np.abs(poles.imag)[:, None] + np.abs(poles.real)[:, None] * np.linspace(-3.0, 3.0, 13)
    angular = np.concatenate([np.linspace(0.0, limit, 400), near.ravel()])
    angular = np.unique(angular[(angular >= 0) & (angular <= limit)])
    wanted = _response(Ad, Bd, C, Dd, np.exp(1j * angular * dt))
    n_outputs, n_inputs = Dd.shape
    # with A and C fixed the response is linear in [B; D]
    rows = _response(A, np.eye(len(A)), C, np.zeros((n_outputs, len(A))), 1j * angular)
    rows = np.concatenate([rows, np.broadcast_to(np.eye(n_outputs), (len(angular), n_outputs, n_outputs))], axis=2)
    stacked = rows.reshape(-1, len(A) + n_outputs)
    right = wanted.reshape(-1, n_inputs)
    scale = np.linalg.norm(stacked, axis=0)
    scale[scale == 0] = 1.0
    both = np.vstack([stacked.real, stacked.imag]) / scale
    solution = np.linalg.lstsq(both, np.vstack([right.real, right.imag]), rcond=None)[0] / scale[:, None]
    return ContinuousSystem(A=A, B=solution[: len(A)], C=C, D=solution[len(A) :])


def _logarithm(matrix: FloatArray) -> FloatArray:
    """The principal logarithm, real.

    Raises:
        NumericalError: It is not real, or its exponential is another matrix.
    """
    balanced, (sizes, _) = scipy.linalg.matrix_balance(matrix, permute=False, separate=True)
    found = np.asarray(scipy.linalg.logm(balanced))
    real = np.ascontiguousarray(found.real)
    error = float(np.abs(scipy.linalg.expm(real) - balanced).max())
    largest = float(np.abs(balanced).max(initial=1.0))
    if np.abs(found.imag).max() > _ROUNDING * np.abs(found).max() or error > _ROUNDING * largest:
        raise NumericalError(
            f"the state matrix has no exact real logarithm (error {error:.1e}); give the model in continuous time, or "
            "leave out modes near the Nyquist frequency."
        )
    return real * sizes[:, None] / sizes


def _response(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, points: ComplexArray) -> ComplexArray:
    """(n_points, n_outputs, n_inputs) C (s - A)^-1 B + D at complex points s."""
    shifted = points[:, None, None] * np.eye(len(A)) - A
    return np.asarray(C @ np.linalg.solve(shifted, np.broadcast_to(B, (len(points), *B.shape)).astype(complex)) + D)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ModalCoordinates:
    """A state space in real modal form.

    Attributes:
        system: In the new states.
        parameters: Real and imaginary part of each pair of poles, each real pole; not of poles at zero.
        slopes: (n_parameters, n_states, n_states) derivative of A by each.
    """

    system: ContinuousSystem
    parameters: tuple[LinearParameter, ...]
    slopes: FloatArray


def in_modal_coordinates(
    system: ContinuousSystem, *, frequency_tolerance: float, damping_tolerance: float
) -> ModalCoordinates:
    """Bring a system to real modal form.

    Args:
        system: A stable system with at least one state.
        frequency_tolerance: Standard deviation of the prior on an imaginary part, as a share of |pole|; hard bounds at
            3 of them.
        damping_tolerance: Relative standard deviation of the prior on a real part; it stays within a factor
            1 + 3 damping_tolerance of the nominal one, so the pole stays stable.

    Example:
        >>> pair = ContinuousSystem(A=np.array([[0.0, 1.0], [-4.0, -0.4]]), B=np.array([[0.0], [1.0]]),
        ...     C=np.array([[1.0, 0.0]]), D=np.zeros((1, 1)))
        >>> form = in_modal_coordinates(pair, frequency_tolerance=0.1, damping_tolerance=0.5)
        >>> form.system.A.round(3), [parameter.name for parameter in form.parameters]
        (array([[-0.2 ,  1.99],
               [-1.99, -0.2 ]]), ['real part of pole pair 1 (0.3183 Hz)', 'imaginary part of pole pair 1 (0.3183 Hz)'])
    """
    # states in mixed units would look dependent, and rounding would follow the largest
    balanced, (sizes, _) = scipy.linalg.matrix_balance(system.A, permute=False, separate=True)
    matrix, states = _block_diagonal(balanced)
    states = sizes[:, None] * states
    B = np.asarray(np.linalg.solve(states, system.B), dtype=np.float64)
    C = system.C @ states
    blocks = _blocks(matrix)
    scale = np.concatenate([np.full(len(block), _balance(B[block], C[:, block])) for block in blocks])
    matrix = matrix * scale / scale[:, None]
    largest = float(np.abs(np.linalg.eigvals(matrix)).max(initial=0.0))
    parameters: list[LinearParameter] = []
    slopes: list[FloatArray] = []
    tolerances = frequency_tolerance, damping_tolerance
    for number, block in enumerate(blocks, start=1):
        for parameter, slope in _block_parameters(matrix, block, number, largest, tolerances):
            parameters.append(parameter)
            slopes.append(slope)
    return ModalCoordinates(
        system=ContinuousSystem(A=matrix, B=B / scale[:, None], C=C * scale, D=system.D),
        parameters=tuple(parameters),
        slopes=np.array(slopes).reshape(len(slopes), *matrix.shape),
    )


def _block_diagonal(A: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The blocks by rising |pole|, and the columns of the states in them."""
    poles, vectors = np.linalg.eig(A)
    columns, chosen = [], []
    for index in np.argsort(np.abs(poles), kind="stable"):
        if poles[index].imag > 0:
            columns += [vectors[:, index].real, vectors[:, index].imag]
        elif poles[index].imag == 0:
            columns.append(vectors[:, index].real)
        chosen.append(index)
    states = np.array(columns).T
    states = states / np.linalg.norm(states, axis=0)
    if len(columns) < len(A) or np.linalg.cond(states) * _ROUNDING > 1.0:
        schur, rotation = scipy.linalg.schur(A, output="real")
        return schur, rotation
    # pairs share one scale, or their blocks would lose their form
    states = np.array(columns).T
    matrix = np.zeros_like(A)
    row = 0
    for index in chosen:
        pole = poles[index]
        if pole.imag > 0:
            matrix[row : row + 2, row : row + 2] = [[pole.real, pole.imag], [-pole.imag, pole.real]]
            row += 2
        elif pole.imag == 0:
            matrix[row, row] = pole.real
            row += 1
    return matrix, states


def _blocks(matrix: FloatArray) -> list[list[int]]:
    """States of each diagonal block of a quasi-triangular matrix."""
    blocks, row = [], 0
    while row < len(matrix):
        size = 2 if row + 1 < len(matrix) and matrix[row + 1, row] != 0 else 1
        blocks.append(list(range(row, row + size)))
        row += size
    return blocks


def _balance(B: FloatArray, C: FloatArray) -> float:
    """Scale of the states at which the rows of B and the columns of C have one size."""
    into, out = float(np.linalg.norm(B)), float(np.linalg.norm(C))
    if into > 0 and out > 0:
        return float(np.sqrt(into / out))
    return into or (1 / out if out > 0 else 1.0)


def _block_parameters(
    matrix: FloatArray, block: list[int], number: int, largest: float, tolerances: tuple[float, float]
) -> list[tuple[LinearParameter, FloatArray]]:
    frequency_tolerance, damping_tolerance = tolerances
    first, last = block[0], block[-1]
    pole = complex(matrix[first, first], 0.0)
    if len(block) == 2:
        pole = complex(matrix[first, first], np.sqrt(-matrix[first, last] * matrix[last, first]))
    size = abs(pole)
    if size <= ROUNDED * largest:
        return []
    pair = f"of pole pair {number} ({size / (2 * np.pi):.4g} Hz)"
    by_real = np.zeros_like(matrix)
    by_real[block, block] = 1.0
    factor = 1 + 3 * damping_tolerance
    deviation, lower, upper = damping_tolerance * abs(pole.real), factor * pole.real, pole.real / factor
    if abs(pole.real) <= UNDAMPED * size:
        deviation = UNDAMPED_DEVIATION * size
        lower, upper = pole.real - 3 * deviation, max(pole.real, 0.0)
    real = LinearParameter(
        name=f"real part {pair}" if len(block) == 2 else f"real pole {number} ({pole.real:.4g} 1/s)",
        unit="1/s",
        nominal=pole.real,
        deviation=deviation,
        lower=lower,
        upper=upper,
    )
    if len(block) == 1:
        return [(real, by_real)]
    by_imaginary = np.zeros_like(matrix)
    by_imaginary[first, last] = matrix[first, last] / pole.imag
    by_imaginary[last, first] = matrix[last, first] / pole.imag
    deviation = frequency_tolerance * size
    imaginary = LinearParameter(
        name=f"imaginary part {pair}",
        unit="1/s",
        nominal=pole.imag,
        deviation=deviation,
        lower=max(pole.imag - 3 * deviation, 1e-3 * pole.imag),
        upper=pole.imag + 3 * deviation,
    )
    return [(real, by_real), (imaginary, by_imaginary)]
