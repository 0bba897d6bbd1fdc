"""Machine lines in ambient motion are taken off and named, modes stay; records from `tests/reference`."""

import numpy as np
import pytest
from hard_records import FAMILIES

from modal.identification.pipeline import identify
from modal.preparation.lines import line_bins, machine_lines
from okid.record import Record


def ambient_record(family, seed):
    made = FAMILIES[family](seed)
    return made, Record(made.inputs, made.outputs, made.dt).detrended()


def test_lines_are_named_and_nothing_else_is():
    there = found = 0
    for seed in range(100, 112):
        made, record = ambient_record("machine_lines", seed)
        lines = machine_lines([record])
        named = [np.abs(lines.frequencies - line).min(initial=1.0) < 0.02 for line in made.lines]
        there, found = there + len(named), found + sum(named)
        assert lines.frequencies.size == sum(named)
        if all(named):  # what is left is the motion without them
            clean = FAMILIES["ambient"](seed).outputs
            left = lines.records[0].outputs - (clean - clean.mean(axis=0))
            assert (left.std(axis=0) < 0.05 * clean.std(axis=0)).all()
    assert found >= 0.95 * there


@pytest.mark.parametrize("family", ["ambient", "coloured_noise", "hidden_earthquake"])
def test_motion_without_lines_stays_the_very_same(family):
    for seed in range(100, 110):
        _, record = ambient_record(family, seed)
        found = machine_lines([record])
        assert found.records[0] is record
        assert found.warnings == ()


def test_multiples_are_named_as_a_family():
    rng, time = np.random.default_rng(0), 0.01 * np.arange(8000)
    machine = sum(np.sin(2 * np.pi * 6.1 * k * time) for k in (1, 2, 3))
    record = Record([], machine + rng.standard_normal(8000), 0.01)
    (warning,) = machine_lines([record]).warnings
    assert "6.1, 12.2 and 18.3 Hz are multiples of 6.1 Hz" in warning


def test_with_inputs_or_gaps():
    rng, time = np.random.default_rng(0), 0.01 * np.arange(8000)
    motion = np.sin(2 * np.pi * 6.1 * time) + rng.standard_normal(8000)
    driven = Record(rng.standard_normal(8000), motion, 0.01)
    assert machine_lines([driven]).records[0] is driven
    motion[1000:1200] = np.nan
    found = machine_lines([Record([], motion, 0.01)])
    assert np.isnan(found.records[0].outputs).sum() == 200
    assert np.nanstd(found.records[0].outputs) == pytest.approx(1.0, abs=0.03)


def test_a_machine_makes_no_mode_and_takes_none():
    made, record = ambient_record("machine_lines", 0)
    result = identify(record)
    found = np.array([mode.frequency for mode in result.modes.system])
    assert found.size == made.frequencies.size
    assert (np.abs(np.sort(found) - made.frequencies) < 0.01 * made.frequencies).all()


def test_white_noise_has_no_line():
    bins, power = line_bins(np.random.default_rng(0).standard_normal((20_000, 5)))
    assert not bins.any()
    np.testing.assert_allclose(power.sum(axis=0), 1.0)
