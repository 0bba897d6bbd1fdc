"""A law through points: where its cubics meet, and where they are one."""

import numpy as np
import pytest

from modal.effects.smooth_law import SmoothDamping, SmoothStiffness


def values_of(law, force):
    """The law's parameters for a force that it can follow."""
    low, high = law.span
    grid = np.linspace(low, high, 400)
    basis = np.column_stack([law.curve((low, high, *unit), grid) for unit in np.eye(len(law.parameters) - 2)])
    return np.array([low, high, *np.linalg.lstsq(basis, force(grid))[0]])


@pytest.mark.parametrize("n_points", [9, 15])
@pytest.mark.parametrize("n_pairs", [1, 2])
def test_one_cubic_has_no_jump_at_any_point(n_points, n_pairs):
    law = SmoothStiffness(n_points=n_points, span=(-1.0, 1.4))
    values = values_of(law, lambda d: 5.0 * d**2 + 30.0 * d**3)
    jumps = law.bends(values, n_pairs)
    assert jumps.shape == (2 * n_pairs, len(law.parameters))
    assert np.abs(jumps @ values).max() < 1e-9 * np.abs(jumps).max()


def test_a_bend_is_the_jump_of_the_third_derivative():
    law = SmoothDamping(span=(-1.0, 1.0))
    values = np.array([-1.0, 1.0, *np.random.default_rng(3).standard_normal(len(law.parameters) - 2)])
    point, h = 0.25**1.5, 1e-3  # of nine points, nearer together about rest
    third = [
        np.diff(law.curve(values, at + h * np.arange(4)), 3)[0] / h**3
        for side in (-1, 1)
        for at in (side * point - 4 * h, side * point + h)
    ]
    np.testing.assert_allclose(law.bends(values, 1) @ values, [third[1] - third[0], third[3] - third[2]], rtol=1e-5)


def test_where_the_motion_does_not_pass_rest_no_point_is_next_to_it():
    law = SmoothStiffness(span=(0.2, 1.0))
    assert law.bends(law.neutral, 2).shape == (0, len(law.parameters))
