"""What drives a simulation under each hold, against the signal that was sampled."""

import numpy as np
import pytest

from modal.simulation.drive import drive_of
from okid.record import Record

DT = 0.01
N = 400


def tone(cycles, n=N, upsampling=1, phase=0.4):
    return np.sin(2 * np.pi * cycles * np.arange((n - 1) * upsampling + 1) / upsampling + phase)


def record(u, hold, **options):
    return Record(u, options.pop("outputs", np.zeros((len(u), 1))), DT, input_hold=hold, **options)


def test_a_zero_order_hold_keeps_each_sample_to_the_next():
    u = np.random.default_rng(0).standard_normal((9, 2))
    drive = drive_of([record(u, "zero_order")], 3)
    assert drive.n_times == 25
    assert drive.dt == pytest.approx(DT / 3)
    for k in range(25):
        assert np.array_equal(drive.start[k], u[k // 3])
        assert np.array_equal(drive.end[k], u[k // 3])
        assert np.array_equal(drive.sample[k], u[k // 3])


def test_a_linear_hold_joins_the_samples():
    u = np.random.default_rng(0).standard_normal((9, 2))
    drive = drive_of([record(u, "linear")], 4)
    for k in range(32):
        share = k % 4 / 4
        line = (1 - share) * u[k // 4] + share * u[k // 4 + 1]
        assert np.allclose(drive.sample[k], line, atol=1e-14)
        assert np.allclose(drive.start[k], line, atol=1e-14)
    assert np.array_equal(drive.end[:-1], drive.start[1:])
    assert np.array_equal(drive.sample[drive.rows], u)


@pytest.mark.parametrize("cycles", [0.02, 0.1, 0.25, 0.4])
@pytest.mark.parametrize("upsampling", [1, 4])
def test_a_band_limited_tone_is_found_between_the_samples(cycles, upsampling):
    drive = drive_of([record(tone(cycles)[:, None], "band_limited")], upsampling)
    middle = slice(80 * upsampling, -80 * upsampling)
    assert np.abs(drive.sample[:, 0] - tone(cycles, upsampling=upsampling))[middle].max() < 1e-4


@pytest.mark.parametrize("cycles", [0.02, 0.1])
def test_the_line_of_a_band_limited_input_has_its_mean_and_its_rise(cycles):
    """Against the integral of the sine; the ends of the step alone would miss (w dt)^2 / 12 of it."""
    drive = drive_of([record(tone(cycles)[:, None], "band_limited")], 2)
    w = np.pi * cycles  # a step
    k = np.arange(drive.n_times)
    mean = (np.cos(w * k + 0.4) - np.cos(w * (k + 1) + 0.4)) / w
    rise = np.sin(w * (k + 1) + 0.4) - np.sin(w * k + 0.4)
    middle = slice(160, -160)
    line_mean, line_rise = (drive.start + drive.end)[middle, 0] / 2, (drive.end - drive.start)[middle, 0]
    assert np.abs(line_mean - mean[middle]).max() < max(1e-4, w**4 / 1000)
    assert np.abs(line_rise - rise[middle]).max() < 2e-4
    ends = (drive.sample[:-1] + drive.sample[1:])[160:-159, 0] / 2
    assert np.abs(ends - mean[middle]).max() > w**2 / 13


def test_records_lie_end_to_end():
    rng = np.random.default_rng(2)
    first, second = rng.standard_normal((30, 1)), 3.0 * rng.standard_normal((20, 1))
    outputs = rng.standard_normal((20, 2))
    outputs[4, 1] = np.nan
    records = [record(first, "linear", outputs=np.ones((30, 2))), record(second, "linear", outputs=outputs)]
    drive = drive_of(records, 3)
    assert drive.firsts == (0, 88, 146)
    assert drive.row_firsts == (0, 30, 50)
    assert np.array_equal(drive.rows, np.r_[np.arange(0, 88, 3), np.arange(88, 146, 3)])
    assert np.allclose(drive.time[88:], np.arange(58) * DT / 3, atol=1e-12)
    assert np.array_equal(drive.sample[drive.rows[30:], 0], second[:, 0])
    assert np.array_equal(np.argwhere(~drive.present), [[34, 1]])
    assert drive.outputs[34, 1] == 0.0
    assert np.array_equal(np.delete(drive.outputs[30:].ravel(), 9), np.delete(outputs.ravel(), 9))


def test_levels_are_relative_to_the_records_together():
    rng = np.random.default_rng(2)
    u = rng.standard_normal((50, 1))
    drive = drive_of([record(u, "linear"), record(3 * u, "linear")])
    assert drive.level[60] / drive.level[0] == pytest.approx(3.0)
    assert np.mean([drive.level[0] ** 2, drive.level[60] ** 2]) == pytest.approx(1.0)
    other = drive_of([record(3 * u, "linear")], reference=drive.reference)
    assert np.allclose(other.level, drive.level[60])


def test_free_decays_have_the_level_of_their_outputs():
    decay = np.exp(-np.arange(40) / 10.0)[:, None]
    empty = np.zeros((40, 0))
    drive = drive_of([Record(empty, decay, DT), Record(empty, 2 * decay, DT)], 2)
    assert drive.start.shape == (158, 0)
    assert drive.level[-1] / drive.level[0] == pytest.approx(2.0)


@pytest.mark.parametrize("upsampling", [1, 3])
def test_a_window_is_the_drive_of_a_part(upsampling):
    rng = np.random.default_rng(5)
    u, y = rng.standard_normal((2, 30, 1))
    y[10] = np.nan
    records = [record(u, "linear", outputs=y), record(u[:12], "linear", outputs=y[:12] * 2)]
    drive = drive_of(records, upsampling)
    begin, end = 8 * upsampling, 15 * upsampling
    window, index, which = drive.window(begin, end)
    second = drive.firsts[1]
    expected = np.r_[begin:end, second + begin : min(second + end, drive.n_times)]
    assert np.array_equal(index, expected)
    assert np.array_equal(which, [0, 1])
    assert window.firsts == (0, end - begin, len(expected))
    for name in ("start", "end", "sample", "time", "level"):
        assert np.array_equal(getattr(window, name), getattr(drive, name)[index])
    assert np.allclose(window.time[window.rows[:7]], np.arange(8, 15) * DT, atol=1e-12)
    assert np.array_equal(
        window.outputs[:, 0], np.r_[y[8:10, 0], 0.0, y[11:15, 0], 2 * y[8:10, 0], 0.0, 2 * y[11:12, 0]]
    )
    assert np.array_equal(np.flatnonzero(~window.present), [2, 9])
    assert window.row_firsts == (0, 7, 11)
    _, index, which = drive.window(12 * upsampling, 400)
    assert np.array_equal(which, [0])
    assert np.array_equal(index, np.arange(12 * upsampling, drive.firsts[1]))


def test_a_silent_record_counts_as_one_of_the_common_level():
    """A decay from an initial deflection: with the level of its input, zero, friction could not be smoothed."""
    u = np.random.default_rng(5).standard_normal((30, 1))
    drive = drive_of([record(u, "linear"), record(0 * u, "linear")])
    assert np.allclose(drive.level[30:], 1.0)
    assert np.all(np.isfinite(drive.level))
    assert np.allclose(drive_of([record(0 * u, "linear")]).level, 1.0)
