"""The share of a step's end: a line for what is soft, all for a wall, and no level that falls where it should rise."""

import numpy as np
import pytest
from differences import central
from hypothesis import given
from hypothesis import strategies as st

from modal.effects.effect import WALL, share_of_end

stiffness = st.floats(0.0, 1e9)


def left_of(z):
    """What a step leaves of a level above the brim."""
    share, _ = share_of_end(z)
    return (1.0 - (1.0 - share) * z) / (1.0 + share * z)


@given(z=st.floats(0.0, 1e4))
def test_the_slope_is_that_of_the_share(z):
    assert share_of_end(z)[1] == pytest.approx(central(lambda at: share_of_end(at)[0], z), abs=1e-9)


@given(z=stiffness)
def test_the_start_of_a_step_takes_no_more_than_half_a_level(z):
    """So the level at the end rises with that at the start, as long as the plant keeps half of it."""
    share, _ = share_of_end(z)
    assert 0.5 <= share <= 1.0
    assert z * (1.0 - share) <= 0.5 + 1e-6


def test_soft_steps_are_of_second_order():
    z = np.array([0.1, 0.05, 0.025])
    error = np.abs(left_of(z) - np.exp(-z))
    assert np.all(error[:-1] / error[1:] > 7.0)  # of third order in one step
    assert error[0] < 3e-4


def test_a_wall_leaves_nothing():
    """A line between both ends would leave -1, and ring for ever."""
    assert abs(left_of(WALL)) < 2.0 / WALL
    assert np.all(left_of(np.geomspace(1e-3, 1e8, 300)) >= -1e-8)
