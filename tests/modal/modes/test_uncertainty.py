"""The type that carries standard deviations: shapes, intervals, refusals."""

import numpy as np
import pytest

from modal.modes.mode import Uncertainty
from okid.errors import InvalidDataError


def make(**changes):
    fields = {
        "method": "propagation",
        "frequency_std": np.array([0.1, 0.2]),
        "damping_ratio_std": np.array([0.01, np.nan]),
        "shape_std": np.zeros((2, 3)),
        "markov_std": np.ones((5, 3, 1)),
    }
    return Uncertainty(**(fields | changes))


def test_arrays_are_frozen():
    known = make()
    for name in ("frequency_std", "damping_ratio_std", "shape_std", "markov_std"):
        assert not getattr(known, name).flags.writeable


@pytest.mark.parametrize(
    "changes",
    [
        {"damping_ratio_std": np.zeros(3)},
        {"shape_std": np.zeros((1, 3))},
        {"markov_std": np.zeros((5, 3))},
        {"degrees_of_freedom": 0.0},
        {"degrees_of_freedom": np.nan},
    ],
)
def test_parts_that_do_not_fit_together_are_refused(changes):
    with pytest.raises(InvalidDataError):
        make(**changes)


def test_interval_factors_are_those_of_the_tables():
    """Two-sided quantiles of the normal distribution and of Student's t (Abramowitz, Stegun, table 26.10)."""
    assert make().interval_factor() == pytest.approx(1.959964, abs=1e-6)
    assert make().interval_factor(0.99) == pytest.approx(2.575829, abs=1e-6)
    assert make(degrees_of_freedom=10.0).interval_factor(0.95) == pytest.approx(2.228, abs=5e-4)
    assert make(degrees_of_freedom=1.0).interval_factor(0.5) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("level", [0.0, 1.0, 95.0, np.nan])
def test_a_level_that_is_no_probability_is_refused(level):
    with pytest.raises(InvalidDataError, match="between 0 and 1"):
        make().interval_factor(level)
