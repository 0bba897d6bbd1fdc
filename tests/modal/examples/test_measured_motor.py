"""The script for a measured motor, on files of a motor that an own integrator turns, and on those of a real bench."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import okid
from modal.examples import measured_motor
from modal.examples.measured_motor import FirstOrder, by_hand, first_order, halves, lost_in_words, motor_record

DT, RATE, GAIN, DEAD, LATE = 0.02, 26.0, 2.8, 0.22, 8e-3
"""Time constant 38 ms, 2.8 rad/s for a volt, 0.22 V lost in friction, 8 ms late."""


def counted_file(path, middle, *, n_samples, seed, friction=True):
    """Voltages that jump about a working point, and the counts of an encoder with 0.03 rad/s of noise.

    Between jumps a + b exp(-RATE t), exactly; the angle is its integral, and the counted speed its differences.
    """
    rng = np.random.default_rng(seed)
    volts = np.repeat(middle + 0.6 * rng.choice([-1.0, 1.0], n_samples // 8 + 1), 8)[:n_samples]
    fine = 250
    late = round(LATE / DT * fine)
    drive = np.concatenate([np.full(late, volts[0]), np.repeat(volts, fine)])[: n_samples * fine]
    steady = GAIN * (drive - DEAD * friction)
    keep = np.exp(-RATE * DT / fine)
    speed = np.empty(n_samples * fine + 1)
    speed[0] = steady[0]
    for k, target in enumerate(steady):
        speed[k + 1] = target + (speed[k] - target) * keep
    # the mean of a + b exp over a step, exactly
    means = steady + (speed[:-1] - steady) * (1 - keep) / (RATE * DT / fine)
    over = means.reshape(n_samples, fine).mean(axis=1)
    shown = np.concatenate([[speed[0]], over[:-1]]) + 0.03 * rng.standard_normal(n_samples)
    rows = "".join(f"{k * DT:.2f},{u:.4f},{w:.6f}\n" for k, (u, w) in enumerate(zip(volts, shown, strict=True)))
    path.write_text("time [s],u [V],speed [rad/s]\n" + rows)
    return path


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bench")
    return [
        counted_file(folder / f"bench_{k}.csv", middle, n_samples=800, seed=k) for k, middle in enumerate((1.4, 2.6))
    ]


@pytest.fixture(scope="module")
def fitted(files):
    """The first halves of both files, and the motor that they show."""
    records = [halves(motor_record(path, drive="u", speed="speed", counts=True))[0] for path in files]
    return records, first_order(records)


def test_the_script_finds_friction_delay_and_time_constant(files, capsys):
    assert measured_motor.main([*map(str, files), "--inputs", "u", "--outputs", "speed", "--counts"]) in (0, 1)
    told = capsys.readouterr().out
    rows = {line.split("  ")[0]: line for line in told.splitlines()}

    def number(word):
        (line,) = [line for name, line in rows.items() if name.startswith(word)]
        return float(line.removeprefix(word).replace("J/b", "").split()[0])

    assert abs(number("time constant") - 1e3 / RATE) < 0.05 * 1e3 / RATE
    assert abs(number("delay") - 1e3 * LATE) < 0.5
    assert abs(number("by hand") - DEAD) < 0.02
    lost = [line for line in told.splitlines() if "lost before it turns" in line]
    assert len(lost) == 1
    assert abs(float(lost[0].split("+-")[0].split()[-1]) - DEAD) < 0.05 * DEAD
    assert "one by one, for no torque was measured" in told
    assert "always turned one way" in told


def test_the_stages_are_those_of_a_first_order_motor(files, fitted):
    records = [motor_record(path, drive="u", speed="speed", counts=True) for path in files]
    _, found = fitted
    assert abs(found.rate - RATE) < 0.1 * RATE
    assert abs(found.gain - GAIN) < 0.1 * GAIN
    hand = by_hand(records, FirstOrder(rate=RATE, gain=GAIN))
    assert abs(hand.gain - GAIN) < 0.01 * GAIN
    assert hand.n_speeds == 3  # 0.8, 2.0 and 3.2 V
    assert records[0].input_hold == "linear"
    first, second = halves(records[0])
    assert first.n_samples == second.n_samples == 400
    np.testing.assert_array_equal(second.outputs, records[0].outputs[400:])


def test_counts_are_the_mean_over_the_last_sample(files):
    plain, counted = (motor_record(files[0], drive="u", speed="speed", counts=counts) for counts in (False, True))
    assert plain.input_hold == "zero_order"
    np.testing.assert_array_equal(counted.inputs[1:], plain.inputs[:-1])


def test_a_file_that_is_not_there_or_says_nothing_is_one_sentence(tmp_path, capsys):
    def refused(*arguments):
        assert measured_motor.main([*map(str, arguments), "--inputs", "u", "--outputs", "speed"]) == 2
        told = capsys.readouterr().out.strip()
        assert "\n" not in told
        return told

    assert "nowhere.csv" in refused(tmp_path / "nowhere.csv")
    still = tmp_path / "still.csv"
    noise = np.random.default_rng(1).standard_normal(400)
    still.write_text("time [s],u [V],speed [rad/s]\n" + "".join(f"{k / 50},{k % 2},{w}\n" for k, w in enumerate(noise)))
    assert "no first-order model" in refused(still)


def test_a_reading_by_hand_of_a_motor_that_turns_both_ways():
    """Speeds GAIN (u - DEAD sign(u)); at 0.1 V it stands still, and one cell of the speed is empty."""
    volts = np.repeat([-2.6, -1.4, 0.1, 1.4, 2.6], 40)
    speed = np.where(np.abs(volts) > DEAD, GAIN * (volts - DEAD * np.sign(volts)), 0.0)
    speed[35] = np.nan
    hand = by_hand([okid.Record(volts, speed, DT)], FirstOrder(rate=RATE, gain=GAIN))
    assert hand.gain == pytest.approx(GAIN)
    assert hand.dead == pytest.approx(DEAD)
    assert hand.n_speeds == 4


def test_an_empty_cell_of_the_speed_is_left_out(fitted):
    whole, before = fitted
    holed = [replace(record, outputs=record.outputs.copy()) for record in whole]
    holed[0].outputs.setflags(write=True)
    holed[0].outputs[100, 0] = np.nan
    found = first_order(holed)
    assert found.gain == pytest.approx(before.gain, rel=0.01)
    assert found.gain == pytest.approx(GAIN, rel=0.1)


def test_an_empty_cell_of_the_voltage_is_one_sentence(files, tmp_path, capsys):
    rows = files[0].read_text().splitlines()
    rows[41] = ",".join("" if k == 1 else cell for k, cell in enumerate(rows[41].split(",")))
    holed = tmp_path / "holed.csv"
    holed.write_text("\n".join(rows) + "\n")
    assert measured_motor.main([str(holed), "--inputs", "u", "--outputs", "speed", "--counts"]) == 2
    told = capsys.readouterr().out.strip()
    assert "missing" in told
    assert "\n" not in told


@pytest.mark.parametrize(
    ("gain", "deviation", "told"),
    [
        (0.5, 0.01, "friction            0.2200 +- 0.0100 V, lost before it turns"),
        (1.0, 9.0, "these records do not fix"),
    ],
)
def test_a_loss_is_told_in_volts_of_the_gain_that_was_found(gain, deviation, told):
    """A torque of friction over the torque of a volt, which is what the gain makes of it."""
    torque = RATE * GAIN * gain
    loss = SimpleNamespace(name="Fc", value=DEAD * torque, std=deviation * torque)
    findings = [
        SimpleNamespace(effect="coulomb_friction", parameters=[loss]),
        SimpleNamespace(effect="input_gain", parameters=[SimpleNamespace(name="gain", value=gain, std=0.01)]),
    ]
    (line,) = lost_in_words(findings, FirstOrder(rate=RATE, gain=GAIN), "V")
    assert line.endswith(told)


@pytest.mark.slow
def test_friction_of_a_real_motor_is_what_a_reading_by_hand_gives(shared_data):
    """Two working points of a bench motor, 300 rows of each half."""
    folder = shared_data / "dc_motor_bench"
    records = [motor_record(folder / f"prbs_{k}.csv", drive="u", speed="speed", counts=True) for k in (3, 4)]
    motor, diagnosis = measured_motor.study([record.samples(0, 600) for record in records])
    hand = by_hand(records, motor)
    (lost,) = [
        one.value / (motor.rate * motor.gain)
        for finding in diagnosis.findings
        for one in finding.parameters
        if finding.effect in ("coulomb_friction", "constant_force")
    ]
    assert abs(lost - hand.dead) < 0.05 * hand.dead
    assert not any("gain" in finding.effect for finding in diagnosis.findings)
    assert diagnosis.gap_after.max() < 0.5 * diagnosis.gap_before.min()
