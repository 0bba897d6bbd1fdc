"""Feedback is found where it is, and nowhere else."""

import numpy as np
import pytest
from noise_families import noise_record

from modal.identification.feedback import FALSE_ALARMS, feedback_p_value
from okid.record import Record


def p_value(case):
    return feedback_p_value([Record(case.inputs, case.outputs, case.system.dt)])


def test_loops_that_matter_are_found():
    cases = [noise_record("loop", system=system, record=0) for system in range(3000, 3012)]
    strong = [case for case in cases if case.fed_back > 0.3]
    assert len(strong) > 2
    assert all(p_value(case) < FALSE_ALARMS for case in strong)


def test_a_share_too_small_to_matter_is_not_called_feedback_in_a_long_record():
    rng = np.random.default_rng(5)
    n = 60_000
    r, e, u, y = *rng.standard_normal((2, n)), np.zeros(n), np.zeros(n)
    p_values = []
    for gain in (0.02, 0.3):  # explains 0.04 % and 8 % of the input
        for k in range(1, n):
            u[k] = r[k] - gain * y[k - 1]
            y[k] = 0.5 * y[k - 1] + 0.1 * u[k - 1] + e[k]
        p_values.append(feedback_p_value([Record(u, y, 0.1)]))
    assert p_values[0] > 0.5
    assert p_values[1] < 1e-6


@pytest.mark.parametrize("kind", ["white", "coloured", "wind", "hidden"])
def test_open_records_are_left_alone(kind):
    cases = [noise_record(kind, system=system, record=0) for system in range(2000, 2004)]
    assert all(p_value(case) > FALSE_ALARMS / 10 for case in cases)


def test_an_input_that_its_own_past_foretells_is_not_asked():
    time = np.arange(2000) * 0.01
    tone = np.sin(2 * np.pi * 3.0 * time)
    rng = np.random.default_rng(1)
    assert np.isnan(feedback_p_value([Record(tone, tone + rng.standard_normal(2000), 0.01)]))
    assert np.isnan(feedback_p_value([Record([], rng.standard_normal(2000), 0.01)]))
