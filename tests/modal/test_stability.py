import numpy as np
import pytest
from systems import markov, random_system
from textbook_modal import textbook_era

from era.realisation import HankelFactors, Realisation
from modal.extraction import extract_modes
from modal.stability import stabilisation


@pytest.fixture
def nested():
    """Orders 1 to 30 of one textbook singular value decomposition, 1 % noise, and the truth."""
    rng = np.random.default_rng(3)
    truth = random_system(rng, weak_mode=None)
    h = markov(truth, 80)
    h = h + 0.01 * h.std() * rng.standard_normal(h.shape)
    full = textbook_era(h, 40, 40, 30)
    return truth, [cut(full, order) for order in range(1, 31)]


def cut(full, order):
    factors = HankelFactors(
        observability=full.observability[:, :order],
        controllability=full.controllability[:order],
        n_block_rows=full.n_rows,
        n_block_columns=full.n_columns,
        input_scale=np.ones(2),
        output_scale=np.ones(3),
        observer_order=None,
    )
    D = np.zeros((3, 2))
    return Realisation(full.A[:order, :order], full.B[:order], full.C[:, :order], D, 0.01, factors=factors)


def test_every_pole_of_every_order_is_a_point(nested):
    _, realisations = nested
    points = stabilisation(realisations)
    for realisation in realisations:
        modes = extract_modes(realisation)
        here = [point for point in points if point.order == realisation.order]
        np.testing.assert_allclose([point.frequency for point in here], [mode.frequency for mode in modes])
        np.testing.assert_allclose([point.damping_ratio for point in here], [mode.damping_ratio for mode in modes])
        np.testing.assert_allclose([point.emac for point in here], [mode.emac for mode in modes])


def test_system_poles_stand_still_and_noise_poles_do_not(nested):
    truth, realisations = nested
    near, far = [], []
    for point in stabilisation(realisations):
        if point.order > truth.order + 1:
            distance = min(abs(point.frequency - truth.frequencies) / truth.frequencies)
            (near if distance < 1e-3 else far).append(point.overlap)
    assert len(near) >= 3 * 20
    assert np.mean(np.array(near) > 0.99) > 0.9
    assert np.mean(np.array(far) > 0.99) < 0.2


def test_the_lowest_order_and_new_poles_continue_nothing(nested):
    _, realisations = nested
    points = stabilisation(realisations)
    assert all(point.overlap == 0 for point in points if point.order == 1)
    for order in range(2, 31):
        here = [point for point in points if point.order == order]
        below = [point for point in points if point.order == order - 1]
        assert sum(point.overlap > 0 for point in here) <= len(below)


def test_the_order_in_which_they_come_does_not_matter(nested):
    _, realisations = nested
    assert [p.overlap for p in stabilisation(realisations)] == [p.overlap for p in stabilisation(realisations[::-1])]


def test_the_unit_of_a_channel_does_not_matter(nested):
    _, realisations = nested
    other = []
    for model in realisations:
        units, drive = np.array([1e3, 1, 1e-3]), np.array([5.0, 0.1])
        factors = HankelFactors(
            observability=model.factors.observability,
            controllability=model.factors.controllability,
            n_block_rows=40,
            n_block_columns=40,
            input_scale=drive,
            output_scale=units,
            observer_order=None,
        )
        other.append(Realisation(model.A, model.B / drive, model.C * units[:, None], model.D, 0.01, factors=factors))
    np.testing.assert_allclose(
        [point.overlap for point in stabilisation(realisations)],
        [point.overlap for point in stabilisation(other)],
        atol=1e-9,
    )


def test_models_that_hold_no_factors_give_points_without_emac():
    truth = random_system(np.random.default_rng(0))
    points = stabilisation([Realisation(truth.A, truth.B, truth.C, truth.D, truth.dt)])
    assert len(points) == 3
    assert all(np.isnan(point.emac) for point in points)


def test_no_models_give_no_points():
    assert stabilisation([]) == ()
