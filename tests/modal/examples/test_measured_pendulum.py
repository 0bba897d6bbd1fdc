"""The script for a measured swing, on files of a pendulum in closed form, and on those of a real one."""

import numpy as np
import pytest

from modal.examples import measured_pendulum
from modal.examples.measured_pendulum import read_peaks, study, swing_record, turns

DT, FREQUENCY, RATIO, FRICTION, START = 0.002, 1.27, 0.003, 0.0025, 0.07
"""Dry friction as 2.5 mrad of gravity, let go at 70 mrad."""


def swing(times, *, friction=FRICTION, ratio=RATIO):
    """Angle from turning point to turning point, each half a wave about +-friction."""
    w = 2 * np.pi * FREQUENCY
    turning = w * np.sqrt(1 - ratio**2)
    angles, at, t = np.full(len(times), np.nan), START, 0.0
    while abs(at) > friction and t < times[-1]:
        centre = np.sign(at) * friction
        rows = (times >= t) & (times < t + np.pi / turning)
        since = times[rows] - t
        wave = np.cos(turning * since) + ratio * w / turning * np.sin(turning * since)
        angles[rows] = centre + (at - centre) * np.exp(-ratio * w * since) * wave
        at, t = centre - (at - centre) * np.exp(-ratio * w * np.pi / turning), t + np.pi / turning
    angles[times >= t] = at
    return angles


def swing_file(path, *, seed=1, level=0.02, seconds=9.0, **law):
    """An encoder of 0.05 mrad that shows the angle from some zero of its own."""
    times = DT * np.arange(round(seconds / DT))
    seen = level + swing(times, **law) + 2e-5 * np.random.default_rng(seed).standard_normal(len(times))
    path.write_text(
        "time [s],angle [rad]\n"
        + "".join(f"{t:.4f},{5e-5 * round(y / 5e-5):.6f}\n" for t, y in zip(times, seen, strict=True))
    )
    return path


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return swing_file(tmp_path_factory.mktemp("swing") / "swing.csv", seconds=5.5)


def test_the_peaks_tell_friction_from_damping(path):
    _, angles = turns(swing_record(path, angle="angle"))
    read = read_peaks(angles)
    assert read.friction == pytest.approx(FRICTION, rel=0.02)
    assert read.damping_ratio == pytest.approx(RATIO, rel=0.2)
    damping, dry, both = read.left
    assert damping > 10 * dry > 10 * both


def test_the_peaks_of_damping_alone_are_no_friction(tmp_path):
    path = swing_file(tmp_path / "damped.csv", friction=0.0, ratio=0.02)
    _, angles = turns(swing_record(path, angle="angle"))
    read = read_peaks(angles)
    assert read.friction < 0.02 * FRICTION
    assert read.left[0] < 0.1 * read.left[1]


def test_turning_points_lie_half_a_period_apart(path):
    times, angles = turns(swing_record(path, angle="angle"))
    assert np.diff(times[:8]) == pytest.approx(0.5 / FREQUENCY, rel=0.005)
    assert (np.sign(angles[1:]) == -np.sign(angles[:-1])).all()


def test_the_whole_motion_names_friction_and_its_size(path, capsys):
    assert measured_pendulum.main([str(path), "--outputs", "angle"]) == 0
    told = capsys.readouterr().out
    assert "Coulomb friction" in told.splitlines()[0]
    (line,) = [line for line in told.splitlines() if line.startswith("friction")]
    assert float(line.split()[1]) == pytest.approx(FRICTION, rel=0.05)
    assert "damping alone leaves" in told
    assert "for no torque was measured" in told


def test_an_arm_that_is_held_before_it_is_let_go_swings_from_there(path, tmp_path, capsys):
    """It hangs, is lifted, held for two seconds and let go: the hold was fitted as if it swung."""
    rows = [float(row.split(",")[1]) for row in path.read_text().splitlines()[1:]]
    lifted = [rows[-1]] * 200 + list(np.linspace(rows[-1], rows[0], 300)) + [rows[0]] * 1000 + rows
    held = tmp_path / "held.csv"
    held.write_text("time [s],angle [rad]\n" + "".join(f"{k * DT:.4f},{y:.6f}\n" for k, y in enumerate(lifted)))
    assert measured_pendulum.main([str(held), "--outputs", "angle"]) == 0
    told = capsys.readouterr().out
    (line,) = [line for line in told.splitlines() if line.startswith("friction")]
    assert float(line.split()[1]) == pytest.approx(FRICTION, rel=0.05)


@pytest.mark.parametrize("growth", [0.0, 0.02])
@pytest.mark.parametrize("unit", [1.0, 1e-180, 1e180])
def test_peaks_that_do_not_fall_lose_nothing(growth, unit):
    read = read_peaks(0.05 * unit * np.exp(growth * np.arange(12.0)) * (-1.0) ** np.arange(12))
    assert read.friction <= 1e-6 * unit
    assert read.damping_ratio < 1e-5


def test_empty_cells_leave_what_the_peaks_say(path, tmp_path):
    rows = path.read_text().splitlines()
    holed = tmp_path / "holed.csv"
    empty = set(range(300, 340)) | {5, 901, 2000}
    holed.write_text("\n".join(row.split(",")[0] + "," if k in empty else row for k, row in enumerate(rows)) + "\n")
    whole, found = (swing_record(one, angle="angle") for one in (path, holed))
    assert found.n_samples == whole.n_samples
    assert np.nanmax(np.abs(found.outputs - whole.outputs)) < 1e-4
    assert read_peaks(turns(found)[1]).friction == pytest.approx(FRICTION, rel=0.03)


def test_a_file_without_a_swing_is_one_sentence(tmp_path, capsys):
    def refused(path):
        assert measured_pendulum.main([str(path), "--outputs", "angle"]) == 2
        told = capsys.readouterr().out.strip()
        assert "\n" not in told
        return told

    assert "nowhere.csv" in refused(tmp_path / "nowhere.csv")
    still = tmp_path / "still.csv"
    still.write_text("time [s],angle [rad]\n" + "".join(f"{k / 100},0.25\n" for k in range(200)))
    assert "never moves" in refused(still)
    assert "larger angle" in refused(swing_file(tmp_path / "short.csv", seconds=0.9))
    ramp = tmp_path / "ramp.csv"
    ramp.write_text("time [s],angle [rad]\n" + "".join(f"{k / 100},{k}\n" for k in range(200)))
    assert "turns 0 times" in refused(ramp)
    coarse = tmp_path / "coarse.csv"
    seen = 0.1 * np.exp(-0.02 * np.arange(90)) * np.cos(0.6 * np.arange(90))
    coarse.write_text("time [s],angle [rad]\n" + "".join(f"{k / 100},{y}\n" for k, y in enumerate(seen)))
    assert "sample it faster" in refused(coarse)
    other = tmp_path / "other.csv"
    other.write_text("time [s],speed [rad/s]\n" + "".join(f"{k / 100},{k % 7}\n" for k in range(200)))
    assert "angle" in refused(other)


@pytest.mark.slow
def test_the_friction_of_a_real_pendulum_is_what_its_peaks_say(shared_data):
    read, diagnosis = study([swing_record(shared_data / "pendulum_single" / "free_swing.csv", angle="angle")])
    damping, dry, both = read[0].left
    assert damping > 5 * dry > 5 * both
    (creeps,) = [finding for finding in diagnosis.findings if finding.effect == "bouc_wen_hysteresis"]
    values = {one.name: one.value for one in creeps.parameters}
    friction = values["a"] * values["yield_displacement"] / diagnosis.calibrated[0].value
    assert friction == pytest.approx(read[0].friction, rel=0.15)
