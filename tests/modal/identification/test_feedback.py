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
