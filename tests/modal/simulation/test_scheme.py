"""One step's matrices against SciPy, and their slopes against differences."""

import numpy as np
import pytest
import scipy.linalg
import scipy.signal
from engine_plants import imposed_motion, two_masses
from hypothesis import given, settings
from hypothesis import strategies as st

from modal.simulation.plant import plant_matrices
from modal.simulation.scheme import Recursion, scheme_and_slopes

DT = 0.03
LINEAR = np.array([95.0, 1.1])


def test_a_held_input_is_that_of_scipy():
    plant = two_masses()
    ours, _ = scheme_and_slopes(plant, LINEAR, DT)
    m = plant_matrices(plant, LINEAR)
    driven = np.hstack([m.B, m.E])
    Ad, Bd, *_ = scipy.signal.cont2discrete((m.A, driven, m.C, np.hstack([m.D, m.G])), DT)
    assert np.allclose(ours.Ad, Ad, atol=1e-13)
    assert np.allclose(np.hstack([ours.B0 + ours.B1, ours.E0 + ours.E1]), Bd, atol=1e-13)
    for name in "CDG":
        assert np.array_equal(getattr(ours, name), getattr(m, name))


def test_an_input_that_moves_in_a_straight_line_is_integrated_exactly():
    plant = two_masses()
    ours, _ = scheme_and_slopes(plant, LINEAR, DT)
    m = plant_matrices(plant, LINEAR)
    t = np.arange(8) * DT
    u = np.random.default_rng(0).standard_normal((8, 5))
    driven = np.hstack([m.B, m.E])
    _, _, expected = scipy.signal.lsim((m.A, driven, m.C, np.hstack([m.D, m.G])), u, t, interp=True)
    x, start, end = np.zeros(4), np.hstack([ours.B0, ours.E0]), np.hstack([ours.B1, ours.E1])
    for k in range(7):
        assert np.allclose(x, expected[k], atol=1e-12)
        x = ours.Ad @ x + start @ u[k] + end @ u[k + 1]


@pytest.mark.parametrize("j", [0, 1])
def test_slopes_by_a_linear_parameter(j):
    plant = two_masses()
    _, slopes = scheme_and_slopes(plant, LINEAR, DT)
    for name in ("Ad", "B0", "B1", "E0", "E1", "C", "D", "G"):
        above, below = (scheme_and_slopes(plant, LINEAR + s * 0.01 * np.eye(2)[j], DT)[0] for s in (1, -1))
        difference = (getattr(above, name) - getattr(below, name)) / 0.02
        size = max(np.abs(difference).max(), 1e-3)
        assert np.abs(getattr(slopes[j], name) - difference).max() < 1e-5 * size, name


def test_a_plant_without_states_has_only_its_direct_part():
    scheme, slopes = scheme_and_slopes(imposed_motion(), np.array([2.0]), DT)
    assert scheme.Ad.shape == (0, 0)
    assert scheme.B0.shape == (0, 3)
    assert np.array_equal(scheme.D, [[2.0, 0.5, 0.2]])
    assert np.allclose(slopes[0].D, [[1.0, 0.0, 0.0]])


def test_an_integrator_has_a_flow():
    """A singular A, where formulas with its inverse fail."""
    plant = two_masses()
    system = plant.system.copy()
    system[:, :4, :4] = 0.0
    system[0, 0, 2] = 1.0
    from dataclasses import replace

    scheme, _ = scheme_and_slopes(replace(plant, system=system), LINEAR, DT)
    assert np.allclose(scheme.Ad, scipy.linalg.expm(system[0, :4, :4] * DT))
    assert scheme.B0[0, 0] + scheme.B1[0, 0] == pytest.approx(DT**2 / 2)


def by_loop(transitions, forcing, firsts):
    found = np.zeros_like(forcing)
    for column, one in enumerate(forcing):
        state = np.zeros(forcing.shape[2])
        for k, added in enumerate(one):
            state = (0.0 if k in firsts else transitions[:, :, k - 1] @ state) + added
            found[column, k] = state
    return found


@settings(max_examples=60, deadline=None)
@given(
    sizes=st.tuples(st.integers(1, 12), st.integers(1, 200), st.integers(1, 4)),
    cut=st.floats(0, 1),
    steady=st.booleans(),
    seed=st.integers(0, 1000),
)
def test_it_is_the_recursion_of_each_record(sizes, cut, steady, seed):
    (n, n_times, n_columns), rng = sizes, np.random.default_rng(seed)
    transitions = rng.standard_normal((n, n, n_times)) / np.sqrt(n)
    if steady:
        transitions = np.broadcast_to(transitions[:, :, :1], transitions.shape)
    forcing = rng.standard_normal((n_columns, n_times, n))
    firsts = (0, *([int(cut * n_times)] if 0 < int(cut * n_times) < n_times else []), n_times)
    expected = by_loop(transitions, forcing, firsts)
    found = Recursion.of(transitions, firsts).solve(forcing)
    assert np.allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_steps_that_are_all_alike_go_on_from_piece_to_piece(monkeypatch):
    """A record of many pieces of the band that is kept: each goes on where the one before ended."""
    monkeypatch.setattr("modal.simulation.scheme.BAND_VALUES", 18 * 7)
    rng = np.random.default_rng(2)
    transitions = np.broadcast_to(0.5 * rng.standard_normal((3, 3, 1)), (3, 3, 50))
    forcing = rng.standard_normal((2, 50, 3))
    recursion = Recursion.of(transitions, (0, 20, 50))
    assert recursion.band.shape[1] == 3 * 7
    expected = by_loop(transitions, forcing, (0, 20, 50))
    assert np.allclose(recursion.solve(forcing), expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(("n", "n_columns"), [(0, 3), (2, 0), (0, 0), (9, 0)])
def test_nothing_to_solve(n, n_columns):
    found = Recursion.of(np.zeros((n, n, 5)), (0, 5)).solve(np.zeros((n_columns, 5, n)))
    assert found.shape == (n_columns, 5, n)


@pytest.mark.parametrize("n", [2, 7, 8])
def test_a_motion_that_grows_beyond_numbers_is_left_to_who_asked(n):
    with np.errstate(all="raise"):
        found = Recursion.of(np.broadcast_to(3.0 * np.eye(n)[:, :, None], (n, n, 1000)), (0, 1000)).solve(
            np.ones((1, 1000, n))
        )
    assert not np.isfinite(found).all()
