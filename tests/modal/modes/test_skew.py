"""Delays between outputs out of the shapes of modes, and nothing where there are none."""

import numpy as np
import pytest

from modal.modes.mode import ModalModel, Mode
from modal.modes.skew import MeasuredShapes, on_time, rows_on_time, skew_of_shapes, turned_back
from okid.record import Record


def measured(seed, late, *, n_modes=5, noise=0.01, complexity=0.0, n_of_noise=0):
    """Real shapes, each turned as a whole, less what their outputs are late by; some poles have random shapes."""
    rng = np.random.default_rng(seed)
    late = np.asarray(late)
    real = rng.choice([-1.0, 1.0], (n_modes, late.size)) * rng.uniform(0.2, 1.0, (n_modes, late.size))
    shapes = real * np.exp(2j * np.pi * rng.random((n_modes, 1)))
    size = np.sqrt(np.square(real).mean(axis=1, keepdims=True))
    shapes = shapes + complexity * size * (rng.standard_normal(real.shape) + 1j * rng.standard_normal(real.shape))
    angular = rng.uniform(0.1, 2.4, n_modes)
    shapes = shapes * np.exp(-1j * np.outer(angular, late))
    wrong = rng.standard_normal((n_of_noise, late.size)) + 1j * rng.standard_normal((n_of_noise, late.size))
    shapes = np.vstack([shapes, wrong])
    error = noise * (rng.standard_normal(shapes.shape) + 1j * rng.standard_normal(shapes.shape))
    angular = np.concatenate([angular, rng.uniform(0.1, 3.0, n_of_noise)])
    return MeasuredShapes(angular=angular, shapes=shapes + error, variance=np.full(shapes.shape, noise**2))


@pytest.mark.parametrize(
    "late",
    [(0.0, 0.0, 0.3, 0.0), (0.0, 2.5, 0.0), (0.0, -0.9, 0.0, 0.0, -0.9), (1.3, 1.3, 0.0, 0.0, 0.0, 0.0)],
    ids=["a part", "some samples", "a group early", "a second logger"],
)
@pytest.mark.parametrize("n_of_noise", [0, 4])
def test_late_outputs_are_found_among_poles_of_noise(late, n_of_noise):
    for seed in range(2):
        found = skew_of_shapes(measured([1, seed], late, n_modes=6, n_of_noise=n_of_noise))
        np.testing.assert_allclose(found, late, atol=0.06)
        assert (found != 0).tolist() == [bool(one) for one in late]


def test_a_multiplexer_is_found_against_any_of_its_channels():
    late = np.arange(5) * 0.2
    found = skew_of_shapes(measured(3, late, n_modes=6))
    np.testing.assert_allclose(found - found[0], late, atol=0.05)
    assert abs(np.median(found)) < 0.05


@pytest.mark.parametrize("complexity", [0.0, 0.02, 0.1, 0.3])
def test_nothing_is_late_where_shapes_are_only_complex(complexity):
    named = [
        skew_of_shapes(measured([2, seed], np.zeros(4), complexity=complexity, n_of_noise=3)).any() for seed in range(8)
    ]
    assert sum(named) == 0


def test_random_shapes_name_nothing():
    named = [skew_of_shapes(measured([4, seed], np.zeros(4), n_modes=1, n_of_noise=8)).any() for seed in range(8)]
    assert sum(named) == 0


def test_another_derivative_of_motion_is_no_delay_where_units_are_not_known():
    for seed in range(3):
        found = measured([5, seed], np.zeros(4))
        shapes = found.shapes.copy()
        shapes[:, 3] *= 1j
        turned = MeasuredShapes(angular=found.angular, shapes=shapes, variance=found.variance)
        assert not skew_of_shapes(turned).any()


def test_one_mode_and_one_output_tell_nothing():
    assert skew_of_shapes(measured(0, [0.0, 0.5], n_modes=1)).tolist() == [0.0, 0.0]
    assert skew_of_shapes(measured(0, [0.0], n_modes=4)).tolist() == [0.0]


def test_rows_are_those_that_all_columns_have():
    rows = np.arange(10)[:, np.newaxis] - [0, 2, -1]  # column 1 two rows late, column 2 one early
    made = rows_on_time(rows, [0, 2, -1])
    assert made.tolist() == [[k, k, k] for k in range(1, 8)]
    record = Record(np.arange(10.0), rows.astype(float), 0.5, start_time=3.0)
    (kept,) = on_time([record], [0, 2, -1])
    assert kept.inputs.ravel().tolist() == list(range(1, 8))
    assert kept.start_time == 3.5
    np.testing.assert_array_equal(kept.outputs, made)


def test_shapes_turn_back_and_what_they_answer_stays():
    pole, shape, late = -0.5 + 20.0j, np.array([0.4, -1.0, 0.7]), np.array([0.0, 0.4, 0.0])
    turned = shape * np.exp(-1j * pole.imag * 0.01 * late)
    scale = turned[1]  # as modes are told: the largest component is 1
    mode = Mode(
        pole=pole, kind="oscillatory", frequency=3.2, damping_ratio=0.02, shape=turned / scale, emac=0.9,
        participation=np.array([2.0 + 1.0j]) * scale, phase_collinearity=0.5, cmi=0.45, mpd=9.0,
    )  # fmt: skip
    (made,) = turned_back(ModalModel(modes=(mode,), dt=0.01, indicator_caution=""), late).modes
    np.testing.assert_allclose(np.outer(made.shape, made.participation), np.outer(shape, [2.0 + 1.0j]), atol=1e-12)
    assert made.shape[1] == pytest.approx(1.0)
    assert (made.phase_collinearity, made.cmi, made.mpd) == pytest.approx((1.0, 0.9, 0.0), abs=1e-6)
