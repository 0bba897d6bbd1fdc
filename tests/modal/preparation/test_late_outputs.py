"""Outputs that a logger takes late: told from records of modes behind a real filter, and from nothing else.

Forces and accelerations are made at 16 times the rate of the records, pass the same Butterworth filter, and are then
sampled, each output so many of the fine steps late.
"""

import numpy as np
import pytest
import scipy
from hard_records import FAMILIES

import modal
from modal.command.check import carry_out_check
from modal.command.run import FileSource
from modal.preparation.quick_model import choose_skew
from modal.preparation.steps import prepare
from modal.quality.check import check_quality
from okid.record import Record

FINER = 16
LATE = [(0, 0, 5, 0), (0, 0, 0, 37), (0, -19, 0, -19), (0, 4, 8, 12)]
"""In sixteenths of a sample: a part, some samples, two early, a multiplexer."""


def recorded(seed, late, *, n_rows=4000, n_modes=4, missing=0):
    """A record of accelerations, and the real shapes (n_outputs, n_modes), frequencies and damping ratios."""
    rng = np.random.default_rng([91, seed])
    n_outputs, margin = len(late), 100 * FINER
    frequencies = 0.38 * (np.arange(1, n_modes + 1) / n_modes) ** 1.3 * rng.uniform(0.93, 1.0, n_modes)
    damping = rng.uniform(0.005, 0.02, n_modes)
    angular = 2 * np.pi * frequencies
    poles = angular * (-damping + 1j * np.sqrt(1 - damping**2))
    shapes = rng.choice([-1.0, 1.0], (n_outputs, n_modes)) * rng.uniform(0.3, 1.0, (n_outputs, n_modes))
    force = rng.standard_normal(n_rows * FINER + 2 * margin)
    motion = np.zeros((force.size, n_outputs))
    for pole, shape in zip(poles, shapes.T, strict=True):
        step = np.exp(pole / FINER)
        state = scipy.signal.lfilter([0.0, (step - 1) / pole], [1.0, -step], force)
        # acceleration: the second derivative of the answer of 1 / (2 i w (s - pole)), and the force itself
        motion += np.outer((state * pole**2 / (1j * pole.imag)).real + force, shape)
    keep = scipy.signal.butter(6, 0.75 / FINER, output="sos")
    force, motion = scipy.signal.sosfilt(keep, force), scipy.signal.sosfilt(keep, motion, axis=0)
    rows = margin + FINER * np.arange(n_rows)
    outputs = np.column_stack([motion[rows - steps, j] for j, steps in enumerate(late)])
    outputs += 0.005 * outputs.std(axis=0) * rng.standard_normal(outputs.shape)
    if missing:
        outputs[rng.choice(n_rows, missing, replace=False), 1] = np.nan
    return Record(force[rows], outputs, 0.01), shapes, frequencies / 0.01, damping


def relative(late):
    """Against the median, which is what a group that keeps time shares."""
    return np.asarray(late) - np.median(late)


def found_in(record):
    return np.array(prepare([record]).skew.late or np.zeros(record.n_outputs))


@pytest.mark.parametrize("late", LATE)
@pytest.mark.parametrize("seed", [1, 2])
def test_late_outputs_are_told_to_a_tenth_of_a_sample(seed, late):
    found = found_in(recorded(seed, late)[0])
    truth = np.array(late) / FINER
    assert min(np.abs((found - found[i]) - (truth - truth[i])).max() for i in range(4)) < 0.1
    assert found.any()


@pytest.mark.parametrize("seed", range(6))
def test_outputs_that_keep_time_are_left_alone(seed):
    prepared = prepare([recorded(seed, (0, 0, 0, 0))[0]])
    assert not prepared.skew.late
    assert not any("late against" in text for text in prepared.warnings)


def test_whole_samples_are_taken_off_the_records_and_the_rest_stays():
    record = recorded(1, (0, 0, 0, 37))[0]  # 2 samples and 5 sixteenths
    prepared = prepare([record])
    assert prepared.skew.whole == (0, 0, 0, 2)
    assert prepared.skew.rest[3] == pytest.approx(5 / 16, abs=0.05)
    raw, made = record.detrended().outputs, prepared.records[0].outputs
    start = round((prepared.records[0].start_time - record.start_time) / record.dt)
    n_rows = len(made)
    np.testing.assert_allclose(made[:, 0], raw[start : start + n_rows, 0], atol=1e-9)
    np.testing.assert_allclose(made[:, 3], raw[start + 2 : start + 2 + n_rows, 3], atol=1e-9)


def test_what_was_measured_moves_with_the_samples():
    record = recorded(2, (0, 32, 0, 0), missing=40)[0]
    prepared = prepare([record])
    assert prepared.skew.whole == (0, 2, 0, 0)
    (there,), (made,) = prepared.measured, prepared.records
    assert there.shape == made.outputs.shape
    start = round((made.start_time - record.start_time) / record.dt)
    expected = np.isfinite(record.outputs[start + 2 : start + 2 + made.n_samples, 1])
    np.testing.assert_array_equal(there[:, 1], expected)
    assert there[:, 0].all()


def test_lateness_of_decimated_records_is_told_in_their_own_samples():
    record = recorded(3, (0, 0, 24, 0))[0]
    skew = choose_skew([record], factor=4)
    assert skew.late[2] == pytest.approx(1.5, abs=0.1)
    assert "6.0" in skew.warnings[0]
    assert "0.015 s" in skew.warnings[0]


@pytest.mark.parametrize("seed", [1, 4])
def test_a_multiplexer_of_held_forces_is_told(seed):
    """What it takes a quarter of a sample later than the last shows the motion as much earlier."""
    made = FAMILIES["skewed"](seed)
    found = relative(found_in(Record(made.inputs, made.outputs, made.dt)))
    np.testing.assert_allclose(found, relative(-np.arange(4) / 4), atol=0.1)


def test_identify_names_late_outputs_and_tells_modes_as_if_there_were_none():
    record, shapes, frequencies, damping = recorded(5, (0, 0, 27, 0), n_rows=3000)
    result = modal.identify(record, observer_order=16, ridge=3e-5, order=14)
    (words,) = [text for text in result.warnings if "late against" in text]
    assert "'output_2' 1.6" in words or "'output_2' 1.7" in words
    assert not any(f"'output_{other}'" in words for other in (0, 1, 3))
    assert "output skew" in [choice.what for choice in result.choices]
    for frequency, ratio, shape in zip(frequencies, damping, shapes.T, strict=True):
        mode = min(result.modes.system, key=lambda one, f=frequency: abs(one.frequency - f))
        assert abs(mode.frequency - frequency) < 4 * mode.frequency_std
        assert abs(mode.damping_ratio - ratio) < 4 * mode.damping_ratio_std
        turned = mode.shape / mode.shape[np.abs(shape).argmax()] * shape[np.abs(shape).argmax()]
        np.testing.assert_allclose(turned, shape, atol=0.05)
        assert mode.phase_collinearity > 0.99


def test_a_check_tells_what_is_late_with_the_channels_named(tmp_path, capsys):
    """A check said that it found no fault where the identification said that outputs are late."""
    record, *_ = recorded(1, (0, 0, 5, 0))
    table = np.column_stack([record.inputs, record.outputs])
    path = tmp_path / "skewed.csv"
    np.savetxt(path, table, delimiter=",", header="force,a,b,c,d", comments="")
    source = FileSource(files=[path], inputs=["force"], outputs=None, dt=0.01, hold="band_limited")
    asked = carry_out_check(source, None)
    assert " ".join(capsys.readouterr().out.split()).count("the motion shows in 'c' 0.3") == 1
    named = Record(record.inputs, record.outputs, 0.01, output_names=["a", "b", "c", "d"])
    told = check_quality(named, choices=prepare([named]).choices)
    for quality in (asked, told):
        assert [one.channels for one in quality.findings if one.what == "late"] == [("c",)]
        assert [channel.level for channel in quality.channels] == ["good", "good", "good", "doubtful", "good"]
    assert check_quality(named).level == "good"
