"""What the grid of time leaves in the parameters."""

from types import SimpleNamespace

import numpy as np
import pytest

from modal.discrepancy.grid_error import grid_error


def fitted(value, dt, *, at_bound=False):
    return SimpleNamespace(
        unknowns=SimpleNamespace(common=np.array([value])),
        trajectory=SimpleNamespace(drive=SimpleNamespace(dt=dt)),
        at_bounds=np.array([at_bound]),
    )


@pytest.mark.parametrize("ratio", [2.0, 4.0, 8.0])
def test_an_error_in_proportion_to_the_step_is_told_exactly(ratio):
    """With value(dt) = 5 + 3 dt the fine grid is off by 3 dt."""
    fine, coarse = (fitted(5.0 + 3.0 * dt, dt) for dt in (0.1, 0.1 * ratio))
    node = SimpleNamespace(fitted=fine, coarse=coarse)
    np.testing.assert_allclose(grid_error(node), [0.3], rtol=1e-12)


def test_one_grid_only_tells_nothing():
    only = fitted(5.0, 0.1)
    np.testing.assert_array_equal(grid_error(SimpleNamespace(fitted=only, coarse=only)), [0.0])


def test_where_only_the_smoothing_was_sharpened_the_whole_change_counts():
    node = SimpleNamespace(fitted=fitted(5.0, 0.1), coarse=fitted(5.2, 0.1))
    np.testing.assert_allclose(grid_error(node), [0.2])


def test_what_is_held_at_a_bound_has_no_error():
    """The rate of a wall is four times as large for steps a quarter as long: no error of the rate."""
    node = SimpleNamespace(fitted=fitted(400.0, 0.1, at_bound=True), coarse=fitted(100.0, 0.4, at_bound=True))
    np.testing.assert_array_equal(grid_error(node), [0.0])
