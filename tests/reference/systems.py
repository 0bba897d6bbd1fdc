"""Systems whose truth is known exactly, and data from them, made by textbook formulas and plain loops.

Nothing here imports okid, era or modal: data that the code under test made itself prove nothing. Every system has what
hides faults when it is absent: C B != 0, D != 0, close modes, a weakly driven mode, several inputs and outputs. Arrays
are time-major: (n_samples, n_channels). `tests/conftest.py` puts this folder on the path:
`from systems import random_system, simulate`, `from signals import random_inputs, with_noise`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy
from structures import OfPoles

Hold = Literal["zero_order", "linear"]
SensorKind = Literal["displacement", "velocity", "acceleration"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TruthSystem(OfPoles):
    """x(k+1) = A x(k) + B u(k), y(k) = C x(k) + D u(k), and the continuous-time modes that it samples.

    A has no deadbeat or negative real pole, and no pole of it is aliased. `poles` holds one of each conjugate pair
    (imaginary part >= 0) by rising |pole|; `shapes` (n_outputs, n_modes) are C psi with the largest component 1;
    `participation` (n_inputs, n_modes) completes the residue: system Markov parameter k is the sum over pairs of
    2 Re(shape participation' lambda^(k-1)), over real poles without the 2 Re.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    dt: float
    hold: Hold
    poles: np.ndarray
    shapes: np.ndarray
    participation: np.ndarray

    @property
    def order(self) -> int:
        return self.A.shape[0]

    @property
    def n_inputs(self) -> int:
        return self.B.shape[1]

    @property
    def n_outputs(self) -> int:
        return self.C.shape[0]

    @property
    def discrete_poles(self) -> np.ndarray:
        """(n_modes,) exp(pole dt), one of each pair."""
        return np.exp(self.poles * self.dt)


# --- systems ---------------------------------------------------------------------------------------------------------


def sampled(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, *, dt: float, hold: Hold = "zero_order"
) -> TruthSystem:
    """Exact sampling of a continuous-time system for an input held ("zero_order") or joined by lines ("linear")."""
    n_states, n_inputs = B.shape
    if hold == "zero_order":
        block = np.zeros((n_states + n_inputs,) * 2)
        block[:n_states] = np.hstack([A, B]) * dt
        exact = scipy.linalg.expm(block)
        Ad, Bd, Dd = exact[:n_states, :n_states], exact[:n_states, n_states:], np.array(D)
    else:
        # Franklin, Powell, Workman: triangle hold, the state shifted by the share of the present sample
        block = np.zeros((n_states + 2 * n_inputs,) * 2)
        block[:n_states, : n_states + n_inputs] = np.hstack([A, B]) * dt
        block[n_states : n_states + n_inputs, n_states + n_inputs :] = np.eye(n_inputs)
        exact = scipy.linalg.expm(block)
        Ad = exact[:n_states, :n_states]
        first, second = exact[:n_states, n_states : n_states + n_inputs], exact[:n_states, n_states + n_inputs :]
        Bd, Dd = first + Ad @ second - second, D + C @ second
    poles, vectors = np.linalg.eig(A)
    keep = [i for i in np.argsort(np.abs(poles)) if poles[i].imag >= 0]
    poles, columns = poles[keep], vectors[:, keep]
    rows = np.linalg.inv(vectors)[keep]
    shapes, participation = C @ columns, (rows @ Bd).T
    for i in range(len(keep)):
        largest = shapes[np.argmax(np.abs(shapes[:, i])), i]
        shapes[:, i] /= largest
        participation[:, i] *= largest
    if np.abs(poles.imag).max() >= np.pi / dt:
        raise ValueError("a pole lies above half the sampling frequency: the truth would be aliased")
    return TruthSystem(
        A=Ad, B=Bd, C=np.array(C), D=Dd, dt=dt, hold=hold, poles=poles, shapes=shapes, participation=participation
    )


def chain_matrices(
    masses: Sequence[float], stiffnesses: Sequence[float], dampings: Sequence[float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mass, damping and stiffness matrix of a chain: element e joins mass e - 1 and mass e, element 0 the ground."""
    n_dofs = len(masses)
    damping, stiffness = np.zeros((n_dofs, n_dofs)), np.zeros((n_dofs, n_dofs))
    for matrix, values in ((damping, dampings), (stiffness, stiffnesses)):
        for e, value in enumerate(values):
            matrix[e, e] += value
            if e > 0:
                matrix[e - 1, e - 1] += value
                matrix[e - 1, e] -= value
                matrix[e, e - 1] -= value
    return np.diag(np.asarray(masses, dtype=float)), damping, stiffness


def structure(
    mass: np.ndarray,
    damping: np.ndarray,
    stiffness: np.ndarray,
    *,
    force_dofs: Sequence[int],
    sensor_dofs: Sequence[int],
    sensor_kinds: SensorKind | Sequence[SensorKind],
    dt: float,
    hold: Hold = "zero_order",
) -> TruthSystem:
    """M x'' + C x' + K x = F with forces at some degrees of freedom and a sensor of any kind at others."""
    n_dofs = mass.shape[0]
    kinds = [sensor_kinds] * len(sensor_dofs) if isinstance(sensor_kinds, str) else list(sensor_kinds)
    force = np.eye(n_dofs)[:, list(force_dofs)]
    lower = np.hstack([-np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, damping)])
    A = np.vstack([np.hstack([np.zeros((n_dofs, n_dofs)), np.eye(n_dofs)]), lower])
    B = np.vstack([np.zeros_like(force), np.linalg.solve(mass, force)])
    C, D = np.zeros((len(kinds), 2 * n_dofs)), np.zeros((len(kinds), force.shape[1]))
    for i, (dof, kind) in enumerate(zip(sensor_dofs, kinds, strict=True)):
        if kind == "acceleration":
            C[i], D[i] = A[n_dofs + dof], B[n_dofs + dof]
        else:
            C[i, dof + n_dofs * (kind == "velocity")] = 1.0
    return sampled(A, B, C, D, dt=dt, hold=hold)


def random_chain(
    rng: np.random.Generator,
    *,
    n_masses: int = 3,
    n_inputs: int = 2,
    sensor_kinds: SensorKind | Sequence[SensorKind] = "acceleration",
    highest_share: float = 0.35,
    damping_ratio: float = 0.02,
    dt: float = 0.01,
    hold: Hold = "zero_order",
) -> TruthSystem:
    """A random chain with a sensor on every mass, damped in its springs; its highest mode at a share of 1/dt."""
    masses = rng.uniform(0.7, 1.4, n_masses)
    springs = rng.uniform(0.7, 1.4, n_masses)
    mass, _, stiffness = chain_matrices(masses, springs, springs)
    squares = scipy.linalg.eigh(stiffness, mass, eigvals_only=True)
    springs = springs * (2 * np.pi * highest_share / dt) ** 2 / squares[-1]
    middle = 2 * np.pi * highest_share / dt * np.sqrt(squares[n_masses // 2] / squares[-1])
    mass, damping, stiffness = chain_matrices(masses, springs, springs * 2 * damping_ratio / middle)
    return structure(
        mass,
        damping,
        stiffness,
        force_dofs=rng.permutation(n_masses)[:n_inputs],
        sensor_dofs=range(n_masses),
        sensor_kinds=sensor_kinds,
        dt=dt,
        hold=hold,
    )


def modal_system(
    rng: np.random.Generator,
    *,
    frequencies: Sequence[float],
    damping_ratios: Sequence[float],
    real_poles: Sequence[float] = (),
    n_inputs: int = 2,
    n_outputs: int = 3,
    mode_sizes: Sequence[float] | None = None,
    feedthrough: float = 0.5,
    dt: float = 0.01,
    hold: Hold = "zero_order",
) -> TruthSystem:
    """Random complex shapes and participations on given modes [Hz]; each mode gives pulse responses of like size.

    `mode_sizes` (one a mode, oscillatory then real) makes modes weak; `feedthrough` is the size of D relative to the
    largest entry of C B.
    """
    sizes = np.ones(len(frequencies) + len(real_poles)) if mode_sizes is None else np.asarray(mode_sizes)
    n_states = 2 * len(frequencies) + len(real_poles)
    A, B, C = np.zeros((n_states, n_states)), np.zeros((n_states, n_inputs)), np.zeros((n_outputs, n_states))
    for i, (frequency, ratio) in enumerate(zip(frequencies, damping_ratios, strict=True)):
        natural = 2 * np.pi * frequency
        decay, damped = ratio * natural, natural * np.sqrt(1 - ratio**2)
        A[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [[-decay, damped], [-damped, -decay]]
        B[2 * i : 2 * i + 2] = sizes[i] * rng.uniform(0.5, 1.0, (2, n_inputs)) * rng.choice([-1, 1], (2, n_inputs))
        C[:, 2 * i : 2 * i + 2] = rng.uniform(0.3, 1.0, (n_outputs, 2)) * rng.choice([-1, 1], (n_outputs, 2))
    for i, pole in enumerate(real_poles):
        row = 2 * len(frequencies) + i
        A[row, row] = pole
        B[row] = sizes[len(frequencies) + i] * rng.uniform(0.5, 1.0, n_inputs)
        C[:, row] = rng.uniform(0.3, 1.0, n_outputs) * rng.choice([-1, 1], n_outputs)
    B /= dt
    first = sampled(A, B, C, np.zeros((n_outputs, n_inputs)), dt=dt, hold=hold)
    D = feedthrough * np.abs(first.C @ first.B).max() * rng.uniform(-1, 1, (n_outputs, n_inputs))
    return sampled(A, B, C, D, dt=dt, hold=hold)


def three_modes(
    seed: int, *, real_poles: Sequence[float] = (), n_inputs: int = 2, n_outputs: int = 3
) -> tuple[np.random.Generator, TruthSystem]:
    """A generator, and a system that it made: two modes that are close and one apart, 6, 6.6 and 21 Hz."""
    rng = np.random.default_rng(seed)
    frequencies, damping_ratios = (6.0, 6.6, 21.0), (0.01, 0.015, 0.02)
    return rng, modal_system(
        rng,
        frequencies=frequencies,
        damping_ratios=damping_ratios,
        real_poles=real_poles,
        n_inputs=n_inputs,
        n_outputs=n_outputs,
    )


def random_system(
    rng: np.random.Generator,
    *,
    n_modes: int = 3,
    n_inputs: int = 2,
    n_outputs: int = 3,
    n_real_poles: int = 0,
    close_pair: float | None = 0.05,
    weak_mode: float | None = 0.1,
    damping_range: tuple[float, float] = (0.005, 0.03),
    feedthrough: float = 0.5,
    dt: float = 0.01,
    hold: Hold = "zero_order",
) -> TruthSystem:
    """Random modes from 0.03 to 0.4 of the sampling frequency.

    `close_pair` puts mode 1 that share above mode 0 in frequency (None: no close pair), `weak_mode` makes the last mode
    smaller by that factor.
    """
    edges = np.geomspace(0.03, 0.4, n_modes + 1) / dt
    frequencies = edges[:-1] * (edges[1:] / edges[:-1]) ** rng.uniform(0.3, 0.7, n_modes)
    if close_pair is not None and n_modes > 1:
        frequencies[1] = frequencies[0] * (1 + close_pair)
    sizes = np.ones(n_modes + n_real_poles)
    if weak_mode is not None and n_modes > 1:
        sizes[n_modes - 1] = weak_mode
    return modal_system(
        rng,
        frequencies=frequencies,
        damping_ratios=rng.uniform(*damping_range, n_modes),
        real_poles=-rng.uniform(0.05, 0.3, n_real_poles) / dt,
        n_inputs=n_inputs,
        n_outputs=n_outputs,
        mode_sizes=sizes,
        feedthrough=feedthrough,
        dt=dt,
        hold=hold,
    )


# --- data ------------------------------------------------------------------------------------------------------------


def simulate(
    system: TruthSystem,
    inputs: np.ndarray,
    *,
    initial_state: np.ndarray | None = None,
    process_noise: np.ndarray | None = None,
) -> np.ndarray:
    """(n_samples, n_outputs), one sample after the other; `process_noise` (n_samples, order) joins the state."""
    states = np.zeros((len(inputs) + 1, system.order))
    if initial_state is not None:
        states[0] = initial_state
    driven = inputs @ system.B.T + (0.0 if process_noise is None else process_noise)
    for k, push in enumerate(driven):
        states[k + 1] = system.A @ states[k] + push
    return states[:-1] @ system.C.T + inputs @ system.D.T


def markov(system: TruthSystem, n_lags: int) -> np.ndarray:
    """(n_lags + 1, n_outputs, n_inputs): D, C B, C A B, ..., one power after the other."""
    result = np.empty((n_lags + 1, system.n_outputs, system.n_inputs))
    result[0] = system.D
    columns = system.B
    for k in range(1, n_lags + 1):
        result[k] = system.C @ columns
        columns = system.A @ columns
    return result


def initial_state(rng: np.random.Generator, system: TruthSystem, inputs: np.ndarray) -> np.ndarray:
    """A state of the size that the inputs give: the one after the first samples of the record played once more."""
    state = np.zeros(system.order)
    for u in inputs[: min(len(inputs), 500)]:
        state = system.A @ state + system.B @ u
    return state * rng.uniform(0.5, 1.5, system.order) + 0.1 * np.abs(state).max() * rng.standard_normal(system.order)


def pulse_response(model, n_lags, drive=None):
    """D, C B, C A B, ... by repeated multiplication."""
    response, columns = [model.D], model.B if drive is None else drive
    for _ in range(n_lags):
        response.append(model.C @ columns)
        columns = model.A @ columns
    return response if drive is not None else np.array(response)


def pole_distance(one, other):
    return np.abs(np.subtract.outer(one, other)).min(axis=1).max()
