"""Modes against level: drawn where something is known, in numbers that are those of the modes."""

import numpy as np
import pytest
from levels_by_hand import HARDENS, LEVELS, POLE, RESTS, VAGUE, with_levels

from modal.plots.discrepancy import modes_against_level
from modal.report.discrepancy_pages import draw_diagnosis
from modal.sections.discrepancy_stages import level_lines, telling


def test_a_mode_tells_something_when_it_is_known_to_move_or_to_stay():
    assert [telling(mode) for mode in (HARDENS, RESTS, VAGUE, POLE)] == [True, True, False, True]


@pytest.mark.parametrize(
    ("modes", "agrees", "names"),
    [
        ((HARDENS, RESTS, VAGUE), False, ["mode 1, 3.00 Hz", "mode 2, 8.00 Hz"]),
        ((VAGUE,), False, []),
        ((HARDENS,), True, []),
        ((POLE,), False, ["pole 1, 0.500 Hz"]),
        ((), False, []),
    ],
)
def test_lines_are_those_of_modes_that_tell(diagnosis, modes, agrees, names):
    found = with_levels(diagnosis, *modes, agrees=agrees)
    assert [line.name for line in level_lines(found)] == names
    assert ("levels" in draw_diagnosis(found)) == bool(names)


def test_without_a_location_nothing_is_drawn(diagnosis):
    assert level_lines(diagnosis) == ()


def test_the_numbers_are_changes_from_the_lowest_level_in_percent(diagnosis):
    first, second = level_lines(with_levels(diagnosis, HARDENS, RESTS))
    np.testing.assert_allclose(first.change, [0.0, 2.0, 10.0])
    np.testing.assert_allclose(first.change_std, 100 * 0.001 * np.array([1.0, 1.02, 1.1]))
    np.testing.assert_allclose(first.damping, [1.0, 1.2, 1.1])
    np.testing.assert_allclose(second.levels, LEVELS[[0, 2]])  # not found at the middle one
    np.testing.assert_allclose(second.damping_std, [0.1, 0.1])


def test_the_picture_draws_the_numbers_and_a_tick_at_each_level(diagnosis):
    lines = level_lines(with_levels(diagnosis, HARDENS, RESTS))
    figure = modes_against_level(lines)
    left, right = figure.panels
    np.testing.assert_allclose(left.lines[0].y, lines[0].change)
    np.testing.assert_allclose(right.lines[1].y, lines[1].damping)
    np.testing.assert_allclose([value for value, _ in left.x_ticks()], LEVELS)
    assert [mark.label for mark in left.keyed] == [line.name for line in lines]


def test_poles_of_first_order_have_no_panel_of_damping(diagnosis):
    assert len(modes_against_level(level_lines(with_levels(diagnosis, POLE))).panels) == 1
    assert len(modes_against_level(level_lines(with_levels(diagnosis, POLE, HARDENS))).panels) == 2
