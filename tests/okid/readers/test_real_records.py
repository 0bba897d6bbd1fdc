"""Measured records read as their descriptions say; the numbers compared are read again by numpy alone."""

import numpy as np
import pytest

from okid.errors import InvalidDataError, UnreadableFileError
from okid.readers import describe_file, read_record, read_records


def raw(path):
    return np.genfromtxt(path, delimiter=",", skip_header=1)


def test_shake_table(shared_data):
    path = shared_data / "mini_shake_table" / "flexible_northridge.csv"
    record = read_record(path, inputs="ground")
    assert record.output_names == ("floor_1", "floor_2", "floor_3")
    assert (record.n_samples, set(record.output_units)) == (12114, {"m/s^2"})
    assert record.dt == pytest.approx(0.008333, rel=1e-9)
    np.testing.assert_array_equal(record.outputs, raw(path)[:, 2:])


def test_bridge_in_centimetres(shared_data):
    path = shared_data / "bridge_rio_dell_2012" / "acceleration.csv"
    record = read_record(path, inputs=["ch_17", "ch_3", "ch_20"], outputs=["ch_9", "ch_7", "ch_4"])
    assert record.input_units == record.output_units == ("m/s^2",) * 3
    np.testing.assert_allclose(record.outputs, 0.01 * raw(path)[:, [9, 7, 4]], rtol=1e-14)
    (remark,) = describe_file(path).remarks
    assert remark == "ch_1, ch_2, ch_3, ch_4 and 13 more: cm/s^2 -> m/s^2, times 0.01"


def test_friction_damper_in_inches_and_kips(shared_data):
    folder = shared_data / "friction_damper"
    records = read_records(sorted(folder.glob("*.csv")), inputs=["displacement", "velocity"])
    assert [record.n_samples for record in records] == [28673, 14337, 7169]
    for record in records:
        assert (record.input_units, record.output_units) == (("m", "m/s"), ("N",))
        assert record.dt == pytest.approx(1 / 1024, rel=1e-9)
    np.testing.assert_allclose(
        records[2].outputs[:, 0], 4448.2216152605 * raw(folder / "1Hz_36lb_1in.csv")[:, 3], rtol=1e-12
    )


def test_pendulum_in_degrees_starts_late(shared_data):
    path = shared_data / "pendulum_decay" / "wooden_bob.csv"
    record = read_record(path)
    assert (record.n_inputs, record.output_units) == (0, ("rad",))
    assert record.start_time == 0.86665351
    np.testing.assert_allclose(record.outputs[:, 0], np.radians(raw(path)[:, 1]), rtol=1e-14)


@pytest.mark.parametrize("name", ["0500", "1200", "1500", "increasing"])
def test_thrust_steps_are_sampled_irregularly(shared_data, name):
    with pytest.raises(InvalidDataError, match=r"not uniform: .* lies 0\.\d+ steps off the grid"):
        read_record(shared_data / "motor_propeller" / f"thrust_step_{name}.csv")


def test_no_time_but_a_counter(shared_data):
    path = shared_data / "cd_player_arm" / "cd_player_arm.csv"
    with pytest.raises(InvalidDataError, match="--dt"):
        read_record(path, inputs=["u_1", "u_2"])
    assert read_record(path, inputs=["u_1", "u_2"], dt=1.0).output_names == ("y_1", "y_2")


def test_counts_are_kept(shared_data):
    paths = sorted((shared_data / "flexible_robot").glob("sweep_*.csv"))
    records = read_records(paths, inputs="v", outputs=["theta", "a"])
    assert len(records) == 5
    assert records[0].output_units == ("counts", "counts")
    assert describe_file(paths[0]).remarks == (
        "u, v, theta, a: 'counts' is not a unit that converts to SI; kept as it is",
    )


def test_universal_files_of_analysers(shared_data):
    folder = shared_data / "uff_samples"
    path = next(folder.glob("MPSTD*.uff"))
    record = read_record(path)
    assert (record.n_samples, record.n_outputs, record.dt) == (222_400, 4, 1 / 3200)
    assert record.output_names == tuple(f"MPS set1 Dof{number}" for number in (1, 2, 3, 4))
    assert set(record.output_units) == {"m/s^2"}
    whole = path.read_bytes()
    end = whole.rindex(b"\r\n    -1")
    last = whole[end - 4 * 222_400 : end]
    np.testing.assert_array_equal(record.outputs[:, 3], np.frombuffer(last, "<f4"))
    microphone = read_record(folder / "Sample_UFF58b_bin.uff")
    assert (microphone.output_names, microphone.output_units) == (("Mic 01",), ("Pa",))
    assert microphone.dt == pytest.approx(1 / 65536, rel=1e-5)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("sample_dataset58_psd.uff", "power spectral density"),
        ("TestLab 161 164 18 15 82.uff", r"no data set 58 \(its sets: 15, 18, 82, 151, 164\)"),
        ("meas_point_1.txt", "no row of numbers"),
    ],
)
def test_files_without_time_histories(shared_data, name, message):
    with pytest.raises(UnreadableFileError, match=message):
        read_record(shared_data / "uff_samples" / name)


@pytest.mark.parametrize(
    "folder", ["building_mass_damper", "bridge_meloland_2010", "servo_motor", "silverbox", "cascaded_tanks"]
)
def test_the_others_are_read_whole(shared_data, folder):
    for path in sorted((shared_data / folder).glob("*.csv")):
        record, values = read_record(path), raw(path)
        assert record.n_samples == len(values)
        assert record.n_outputs == values.shape[1] - 1
        scale = 0.01 if folder.startswith("bridge") else 1.0
        np.testing.assert_allclose(record.outputs, scale * values[:, 1:], rtol=1e-14)
