"""The drive behind the effects at its inputs."""

from dataclasses import replace

import numpy as np
import pytest
from engine_plants import VALUES, some_records, two_masses, with_effects

from modal.discrepancy.drive import drive_of
from modal.discrepancy.driven import drive_inputs, per_time


def situation(keys, lag=None):
    plant = two_masses()
    drive = drive_of(some_records(plant), 2)
    assembly, unknowns = with_effects(plant, keys, 2)
    if lag is not None:
        unknowns.common[assembly.common_of(keys.index("input_delay"))] = lag * drive.dt
    return drive, assembly, unknowns


def test_effects_act_one_after_the_other():
    gain, limit = VALUES["input_gain"][0], VALUES["input_saturation"][0]
    drive, assembly, unknowns = situation(["input_gain", "input_saturation"])
    found = drive_inputs(assembly, unknowns, drive)
    for name in ("start", "end", "sample"):
        assert np.allclose(getattr(found, name)[:, 0], np.clip(gain * getattr(drive, name)[:, 0], -limit, limit))
        assert np.array_equal(getattr(found, name)[:, 1], getattr(drive, name)[:, 1])
    drive, assembly, unknowns = situation(["input_saturation", "input_gain"])
    found = drive_inputs(assembly, unknowns, drive)
    assert np.allclose(found.start[:, 0], gain * np.clip(drive.start[:, 0], -limit, limit))
    only_second = drive_inputs(assembly, unknowns, drive, first=1)
    assert np.allclose(only_second.start[:, 0], gain * drive.start[:, 0])


def test_a_delay_does_not_leak_from_record_to_record():
    drive, assembly, unknowns = situation(["input_delay"], lag=5)
    found = drive_inputs(assembly, unknowns, drive)
    for record in range(2):
        times = drive.times_of(record)
        u = drive.sample[times, 0]
        assert np.allclose(found.sample[times, 0], np.r_[np.full(5, u[0]), u[:-5]])


@pytest.mark.parametrize(
    ("lag", "early", "late"),  # in steps, two of which make a sample
    [(4.0, 2, 0), (3.0, 2, 0), (4.2, 3, 0), (-3.0, 0, 2), (0.0, 0, 0), (70.0, 35, 0)],
)
def test_what_a_record_shows_before_its_own_drive_arrives_is_left_out(lag, early, late):
    drive, assembly, unknowns = situation(["input_delay"], lag=lag)
    found = drive_inputs(assembly, unknowns, drive).present
    rows = drive.rows_of(1)
    whole = drive.present[rows]
    early = min(early, (2 * len(whole) // 10 + 1) // 2)  # never more than a tenth
    assert not found[rows][:early].any()
    assert not found[rows][len(whole) - late :].any()
    assert np.array_equal(found[rows][early : len(whole) - late], whole[early : len(whole) - late])


def test_a_record_that_starts_without_a_drive_is_not_left_out():
    """There was none before either."""
    drive, assembly, unknowns = situation(["input_delay"], lag=5)
    start = drive.start.copy()
    start[drive.firsts[1], 0] = 0.005 * start[drive.times_of(1), 0].std()
    found = drive_inputs(assembly, unknowns, replace(drive, start=start)).present
    assert not found[:2].any()
    assert np.array_equal(found[drive.rows_of(1)], drive.present[drive.rows_of(1)])


def test_without_effects_it_is_the_drive_itself():
    drive, assembly, unknowns = situation(["cubic_stiffness", "sensor_gain"])
    assert drive_inputs(assembly, unknowns, drive) is drive


def test_values_of_records_are_spread_over_their_times():
    drive, _, _ = situation([])
    assert per_time(np.float64(2.5), drive) == 2.5
    spread = per_time(np.array([1.0, 2.0]), drive)
    assert len(spread) == drive.n_times
    assert spread[drive.firsts[1] - 1] == 1.0
    assert spread[drive.firsts[1]] == 2.0
