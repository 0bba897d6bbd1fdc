"""Markov parameters given by hand."""

import numpy as np
import pytest

from okid.errors import InvalidDataError
from okid.markov import MarkovParameters


@pytest.mark.parametrize("shape", [(), (5,), (5, 2), (5, 1, 1, 1)])
def test_a_pulse_of_another_number_of_axes_is_refused_with_the_way_out(shape):
    with pytest.raises(InvalidDataError, match=r"shape \(n_lags \+ 1, n_outputs, n_inputs\), .*reshape\(-1, 1, 1\)"):
        MarkovParameters(system=np.ones(shape), dt=0.1)


@pytest.mark.parametrize("dt", [0.0, -1.0, np.nan, np.inf, None, "0.1"])
def test_a_time_step_that_is_none(dt):
    with pytest.raises(InvalidDataError, match="positive time step"):
        MarkovParameters(system=np.ones((3, 1, 1)), dt=dt)


def test_a_gain_must_have_the_same_lags_and_outputs():
    with pytest.raises(InvalidDataError, match="gain Markov parameters"):
        MarkovParameters(system=np.ones((4, 2, 1)), dt=0.1, gain=np.ones((3, 2, 2)))
