"""Single numbers: what is one, what is a count, and one sentence for the rest."""

import numpy as np
import pytest

from okid.arrays import listener, real_number, time_step, whole_number
from okid.errors import InvalidDataError


@pytest.mark.parametrize("value", [3, 3.0, np.int64(3), np.float32(3), np.array(3)])
def test_a_count_of_any_type_is_an_int(value):
    count = whole_number(value, name="n_lags", least=1)
    assert type(count) is int
    assert count == 3


@pytest.mark.parametrize("value", [0, -1, 2.5, True, None, "3", [3], np.array([3]), np.nan, np.inf, 1 + 0j, b"3"])
def test_what_is_no_count(value):
    with pytest.raises(InvalidDataError, match=r"^n_lags must be a whole number of at least 1, but is .*\.$"):
        whole_number(value, name="n_lags", least=1)


def test_a_count_beyond_the_digits_of_a_float_stays_exact():
    assert whole_number(2**53 + 1, name="n", least=0) == 2**53 + 1


def test_the_other_choice_is_named():
    with pytest.raises(InvalidDataError, match='of at least 0 or "auto", but is -1'):
        whole_number(-1, name="order", least=0, otherwise='or "auto"')


@pytest.mark.parametrize("value", [0, -0.1, np.nan, np.inf, None, "0.01", [0.01], True, 10**400])
def test_what_is_no_time_step(value):
    with pytest.raises(InvalidDataError, match=r"^dt must be a positive time step in seconds, but is "):
        time_step(value)


def test_a_number_is_a_float():
    assert real_number(np.float32(0.5)) == 0.5
    assert np.isnan(real_number(None))


def test_progress_is_told_to_a_function_or_to_nobody():
    told = []
    listener(lambda *said: told.append(said))("fit", 0.5)
    listener(None)("fit", 0.5)
    assert told == [("fit", 0.5)]
    with pytest.raises(InvalidDataError, match=r"progress must be a function .*, but 3 was given"):
        listener(3)
