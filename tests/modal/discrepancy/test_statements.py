"""Numbers as a person writes them."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from modal.discrepancy.statements import number, times_floor_text


@given(st.floats(1e-12, 1e12), st.integers(2, 5), st.sampled_from([-1.0, 1.0]))
def test_a_number_reads_back_to_its_digits(value, digits, sign):
    text = number(sign * value, digits)
    assert float(text) == pytest.approx(sign * value, rel=0.51 * 10.0 ** (1 - digits))
    assert "e+" not in text
    assert "e-0" not in text
    assert len(text) <= digits + 7


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (float("nan"), "–"), (0.00099, "9.90e-4"), (0.0009999, "0.00100"), (99990.0, "1.00e5")],
)
def test_numbers_at_the_edges(value, text):
    assert number(value) == text


@pytest.mark.parametrize(("level", "text"), [(1.5, "1.22"), (1.0, "1.00"), (4e8, "20000"), (-1.0, "unbounded")])
def test_times_the_floor_are_root_mean_squares(level, text):
    assert times_floor_text(level) == text
