"""From discrete to continuous time: against systems that were sampled by textbook formulas."""

from types import SimpleNamespace

import numpy as np
import pytest
import scipy
from containers import realisation_of
from hypothesis import given, settings
from hypothesis import strategies as st
from systems import TruthSystem, random_chain, random_system, sampled

from era.realisation import Realisation
from modal.structure.continuous_time import ContinuousSystem, continuous_system, in_modal_coordinates
from okid.errors import InvalidDataError


def poles_of(A: np.ndarray) -> np.ndarray:
    values = np.linalg.eigvals(A)
    return np.sort_complex(values[values.imag >= 0])


@pytest.mark.parametrize("hold", ["zero_order", "linear"])
@pytest.mark.parametrize("seed", range(6))
def test_recovers_the_system_that_was_sampled(hold: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((5, 5)) * 3 - 7 * np.eye(5)
    B, C, D = rng.standard_normal((5, 2)), rng.standard_normal((3, 5)), rng.standard_normal((3, 2))
    truth = sampled(A, B, C, D, dt=0.02, hold=hold)
    found = continuous_system(Realisation(truth.A, truth.B, truth.C, truth.D, 0.02), input_hold=hold)
    for name, exact in (("A", A), ("B", B), ("C", C), ("D", D)):
        np.testing.assert_allclose(getattr(found, name), exact, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_poles_of_random_systems(seed: int) -> None:
    truth: TruthSystem = random_system(np.random.default_rng(seed), n_real_poles=1)
    found = continuous_system(realisation_of(truth), input_hold="zero_order")
    np.testing.assert_allclose(poles_of(found.A), np.sort_complex(truth.poles), rtol=1e-8)


def test_an_integrator_is_no_obstacle() -> None:
    A, B = np.array([[0.0, 1.0], [0.0, -0.5]]), np.array([[0.0], [2.0]])
    truth = sampled(A, B, np.eye(2), np.zeros((2, 1)), dt=0.1)
    found = continuous_system(Realisation(truth.A, truth.B, truth.C, truth.D, 0.1), input_hold="zero_order")
    np.testing.assert_allclose(np.hstack([found.A, found.B]), np.hstack([A, B]), atol=1e-10)


def test_band_limited_relation_is_the_frequency_response_itself() -> None:
    """A discrete model fitted to H(i w) below half the sampling frequency must give H back."""
    dt = 0.01
    truth = random_chain(np.random.default_rng(5), n_masses=2, highest_share=0.12, dt=dt, sensor_kinds="acceleration")
    zero_order = continuous_system(Realisation(truth.A, truth.B, truth.C, truth.D, dt), input_hold="zero_order")
    angular = np.linspace(0.0, 0.8 * np.pi / dt, 300)
    wanted = zero_order.response(angular)
    # same poles, numerators of a discrete model that come nearest to H
    shifted = np.exp(1j * angular * dt)[:, None, None] * np.eye(4) - truth.A
    rows = np.concatenate([truth.C @ np.linalg.inv(shifted), np.broadcast_to(np.eye(2), (300, 2, 2))], axis=2)
    stacked, right = rows.reshape(-1, 6), wanted.reshape(-1, 2)
    solution = np.linalg.lstsq(np.vstack([stacked.real, stacked.imag]), np.vstack([right.real, right.imag]), rcond=None)
    Bd, Dd = solution[0][:4], solution[0][4:]
    found = continuous_system(Realisation(truth.A, Bd, truth.C, Dd, dt), input_hold="band_limited")
    near = angular < 0.5 * np.pi / dt
    miss = np.abs(found.response(angular) - wanted)[near].max() / np.abs(wanted).max()
    as_held = continuous_system(Realisation(truth.A, Bd, truth.C, Dd, dt), input_hold="zero_order")
    miss_as_held = np.abs(as_held.response(angular) - wanted)[near].max() / np.abs(wanted).max()
    assert miss < 0.01 < miss_as_held


def test_continuous_systems_pass_untouched() -> None:
    import control

    given = control.ss([[-1.0, 2.0], [-2.0, -1.0]], [[1.0], [0.5]], [[1.0, 0.0]], [[0.3]])
    for hold in ("zero_order", "linear", "band_limited"):
        found = continuous_system(given, input_hold=hold, dt=0.01)
        np.testing.assert_array_equal(found.A, given.A)
        np.testing.assert_array_equal(found.D, given.D)


def test_an_unspecified_step_is_that_of_the_records() -> None:
    given = SimpleNamespace(A=[[0.5]], B=[[1.0]], C=[[1.0]], D=[[0.0]], dt=True)
    assert continuous_system(given, input_hold="zero_order", dt=0.1).A[0, 0] == pytest.approx(np.log(0.5) / 0.1)
    with pytest.raises(InvalidDataError, match=r"dt=True; give it that of the record\.$"):
        continuous_system(given, input_hold="zero_order")


@pytest.mark.parametrize(
    ("pole", "words"),
    [(-0.4, r"negative real axis, but this one has one at -0\.4"), (0.0, "no discrete pole at 0, but this one has 1")],
)
def test_poles_that_no_continuous_system_has(pole: float, words: str) -> None:
    with pytest.raises(InvalidDataError, match=words):
        continuous_system(Realisation([[pole]], [[1.0]], [[1.0]], [[0.0]], 0.1), input_hold="zero_order")


def test_refuses_another_time_step_and_what_is_no_state_space() -> None:
    with pytest.raises(InvalidDataError, match=r"the model has 0\.1 s and the records 0\.2 s"):
        continuous_system(Realisation([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.1), input_hold="linear", dt=0.2)
    with pytest.raises(InvalidDataError, match="str lacks A, B, C, D, dt"):
        continuous_system("model", input_hold="linear")


def test_static_gain_of_all_holds_agrees() -> None:
    """A constant input is held, straight and band-limited at once: H(0) must be the same."""
    truth = random_chain(np.random.default_rng(2), n_masses=2, sensor_kinds="displacement", highest_share=0.2)
    given = realisation_of(truth)
    exact = truth.C @ np.linalg.solve(np.eye(4) - truth.A, truth.B) + truth.D
    for hold, tolerance in (("zero_order", 1e-8), ("linear", 1e-8), ("band_limited", 0.05)):
        found = continuous_system(given, input_hold=hold)
        static = found.D - found.C @ np.linalg.solve(found.A, found.B)
        np.testing.assert_allclose(static, exact, atol=tolerance * np.abs(exact).max())


def test_step_response_is_that_of_the_discrete_system() -> None:
    truth = random_system(np.random.default_rng(8), feedthrough=0.5)
    found = continuous_system(realisation_of(truth), input_hold="zero_order")
    n = len(truth.A)
    block = np.zeros((n + 2, n + 2))
    block[:n] = np.hstack([found.A, found.B])
    state = np.zeros(n)
    for k in range(1, 6):
        state = truth.A @ state + truth.B @ [1.0, -0.5]
        flow = scipy.linalg.expm(block * truth.dt * k)
        np.testing.assert_allclose(flow[:n, n:] @ [1.0, -0.5], state, rtol=1e-7, atol=1e-9 * np.abs(state).max())


def system_of(A: np.ndarray, rng: np.random.Generator) -> ContinuousSystem:
    return ContinuousSystem(
        A=A, B=rng.standard_normal((len(A), 2)), C=rng.standard_normal((3, len(A))), D=rng.standard_normal((3, 2))
    )


@given(seed=st.integers(0, 10**6), n_states=st.integers(1, 7))
@settings(max_examples=40, deadline=None)
def test_keeps_the_transfer_function(seed: int, n_states: int) -> None:
    rng = np.random.default_rng(seed)
    given_system = system_of(rng.standard_normal((n_states, n_states)) - 3 * np.eye(n_states), rng)
    form = in_modal_coordinates(given_system, frequency_tolerance=0.1, damping_tolerance=0.5)
    angular = np.array([0.0, 0.7, 3.0])
    wanted = given_system.response(angular)
    np.testing.assert_allclose(form.system.response(angular), wanted, atol=1e-8 * np.abs(wanted).max())
    assert len(form.parameters) == n_states == len(form.slopes)


@given(seed=st.integers(0, 10**6))
@settings(max_examples=25, deadline=None)
def test_blocks_stand_on_the_diagonal_and_states_are_balanced(seed: int) -> None:
    rng = np.random.default_rng(seed)
    form = in_modal_coordinates(
        system_of(rng.standard_normal((6, 6)) - 3 * np.eye(6), rng), frequency_tolerance=0.1, damping_tolerance=0.5
    )
    whole = np.tensordot([one.nominal for one in form.parameters], form.slopes, axes=(0, 0))
    np.testing.assert_allclose(whole, form.system.A, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(form.system.B), np.linalg.norm(form.system.C), rtol=1e-9)


def test_bad_scaling_of_the_given_states_does_no_harm() -> None:
    rng = np.random.default_rng(0)
    scale = np.array([1e6, 1e-4, 1.0, 1e3])
    A = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-500.0, 200, -0.3, 0.2], [100, -100, 0.1, -0.1]])
    plain = system_of(A, rng)
    scaled = ContinuousSystem(A=A * scale[:, None] / scale, B=plain.B * scale[:, None], C=plain.C / scale, D=plain.D)
    form = in_modal_coordinates(scaled, frequency_tolerance=0.1, damping_tolerance=0.5)
    angular = np.array([1.0, 8.0, 23.0])
    np.testing.assert_allclose(form.system.response(angular), plain.response(angular), rtol=1e-8)
    np.testing.assert_allclose(np.linalg.norm(form.system.B[:2]), np.linalg.norm(form.system.C[:, :2]), rtol=1e-9)


@pytest.mark.parametrize(
    "A",
    [
        np.array([[-1.0, 1.0, 0.0], [0.0, -1.0, 0.5], [0.0, 0.0, -1.0]]),
        np.kron(np.eye(2), [[-0.1, 2.0], [-2.0, -0.1]]) + np.diag([1.0, 1.0], 2),
    ],
)
def test_coinciding_poles_without_independent_shapes(A: np.ndarray) -> None:
    given_system = system_of(A, np.random.default_rng(1))
    form = in_modal_coordinates(given_system, frequency_tolerance=0.1, damping_tolerance=0.5)
    angular = np.array([0.3, 2.5])
    np.testing.assert_allclose(form.system.response(angular), given_system.response(angular), rtol=1e-6)
    assert len(form.parameters) == len(A)
    first = form.parameters[0]
    moved = form.system.A + 0.3 * first.deviation * form.slopes[0]
    shifted = np.linalg.eigvals(moved).real - np.linalg.eigvals(form.system.A).real.mean()
    assert shifted.max() == pytest.approx(0.3 * first.deviation, rel=0.01, abs=1e-4)


def test_bounds_keep_poles_stable() -> None:
    rng = np.random.default_rng(3)
    form = in_modal_coordinates(
        system_of(np.array([[-0.02, 5.0, 0.0], [-5.0, -0.02, 0.0], [0.0, 0.0, -0.7]]), rng),
        frequency_tolerance=0.1,
        damping_tolerance=0.5,
    )
    by_name = {one.name: one for one in form.parameters}
    real = by_name["real pole 1 (-0.7 1/s)"]
    np.testing.assert_allclose([real.nominal, real.lower, real.upper], [-0.7, -1.75, -0.28])
    pair = by_name["real part of pole pair 2 (0.7958 Hz)"]
    np.testing.assert_allclose([pair.lower, pair.upper, pair.deviation], [-0.05, -0.008, 0.01])
    imaginary = by_name["imaginary part of pole pair 2 (0.7958 Hz)"]
    np.testing.assert_allclose([imaginary.lower, imaginary.upper], [5 - 1.5, 5 + 1.5], rtol=1e-3)
