"""Several files: records where the channels are the same, one record where they are all different."""

import numpy as np
import pytest

from okid.errors import IdentificationWarning, InvalidDataError
from okid.readers import describe_file, read_described, read_records

RNG = np.random.default_rng(4)


@pytest.fixture
def write(tmp_path):
    def written(name, header, *, n_samples=40, dt=0.1, start=0.0, seed=0):
        names = header.split(",")
        values = np.random.default_rng(seed).standard_normal((n_samples, len(names)))
        if dt:
            names, values = ["time", *names], np.column_stack([start + dt * np.arange(n_samples), values])
        path = tmp_path / name
        np.savetxt(path, values, delimiter=",", header=",".join(names), comments="", fmt="%.17g")
        return path

    return written


def test_records_are_matched_by_name_not_by_place(write):
    one, two = write("one.csv", "u,y,z"), write("two.csv", "z,y,u", n_samples=60, seed=1)
    first, second = read_records([one, two], inputs="u")
    assert first.output_names == second.output_names == ("y", "z")
    assert (first.name, second.name) == ("one", "two")
    assert second.n_samples == 60
    raw = np.loadtxt(two, delimiter=",", skiprows=1)
    np.testing.assert_array_equal(second.outputs, raw[:, [2, 1]])
    np.testing.assert_array_equal(second.inputs, raw[:, [3]])


def test_records_and_descriptions_in_one_reading(write):
    paths = [write("one.csv", "u [N],y [g]"), write("two.csv", "u [N],y [g]", n_samples=60)]
    records, descriptions = read_described(paths, inputs="u")
    for record, description, path in zip(records, descriptions, paths, strict=True):
        (alone,) = read_records(path, inputs="u")
        np.testing.assert_array_equal(record.outputs, alone.outputs)
        assert description == describe_file(path)


def test_channels_not_chosen_need_not_match(write):
    paths = [write("one.csv", "u,y,extra"), write("two.csv", "u,y,other")]
    assert [record.output_names for record in read_records(paths, inputs="u", outputs="y")] == [("y",), ("y",)]
    set_ups = read_records(paths, inputs="u")
    assert [record.output_names for record in set_ups] == [("y", "extra", "other")] * 2
    assert [np.isnan(record.outputs).all(axis=0).tolist() for record in set_ups] == [[0, 0, 1], [0, 1, 0]]


def test_one_file_is_one_record(write):
    path = write("one.csv", "u,y")
    assert len(read_records(path, inputs="u")) == len(read_records([path], inputs="u")) == 1
    assert len(read_records(str(path))) == 1


@pytest.mark.parametrize("dt", [0.1, None])
def test_files_with_different_channels_are_joined(write, dt):
    paths = [write("a.csv", "u", dt=dt), write("b.csv", "y,w", dt=dt, seed=1), write("c.csv", "z", dt=dt, seed=2)]
    given = {} if dt else {"dt": 0.1}
    (record,) = read_records(paths, inputs="u", outputs=["z", "y"], **given)
    assert (record.input_names, record.output_names, record.name) == (("u",), ("z", "y"), "a+b+c")
    raw = [np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2) for path in paths]
    first = 1 if dt else 0
    np.testing.assert_array_equal(record.outputs, np.column_stack([raw[2][:, first], raw[1][:, first]]))
    np.testing.assert_array_equal(record.inputs[:, 0], raw[0][:, first])
    (record,) = read_records(paths, **given)
    assert record.output_names == ("u", "y", "w", "z")


@pytest.mark.parametrize(
    ("other", "message"),
    [
        ({"n_samples": 41}, r"not on one time grid: 40 samples of 0\.1 s from 0 s and 41 samples"),
        ({"dt": 0.2}, r"of 0\.2 s from 0 s"),
        ({"start": 1.0}, r"from 1 s"),
        ({"dt": None}, r"and 40 samples;"),
    ],
)
def test_joined_files_need_one_time_grid(write, other, message):
    with pytest.raises(InvalidDataError, match=message):
        read_records([write("a.csv", "u"), write("b.csv", "y", **other)])


def test_a_file_with_none_of_the_channels(write):
    paths = [write("a.csv", "u,y"), write("b.csv", "v,w")]
    with pytest.raises(InvalidDataError, match=r"no channel 'u' in b\.csv; .*channels are v, w"):
        read_records(paths, inputs="u", outputs="y")


def test_a_misspelt_name_is_said_of_the_file(write):
    with pytest.raises(InvalidDataError, match=r"no channel 'v' in a\.csv"):
        read_records([write("a.csv", "u,y"), write("b.csv", "u,y")], inputs="v", outputs="y")


def test_records_need_one_unit_and_one_step(write):
    with pytest.raises(InvalidDataError, match="'y' is in m in a and V in b"):
        read_records([write("a.csv", "u,y [mm]"), write("b.csv", "u,y [V]")])
    a, b = read_records([write("a.csv", "u,y [mm]"), write("b.csv", "u,y [in]")])
    assert a.output_units == b.output_units == ("", "m")
    with pytest.raises(InvalidDataError, match=r"time step of 0\.1 s and b of 0\.2 s"):
        read_records([write("a.csv", "u"), write("b.csv", "u", dt=0.2)])


def test_no_file_and_one_file_twice(write):
    with pytest.raises(InvalidDataError, match="no file"):
        read_records([])
    path = write("a.csv", "u")
    with pytest.raises(InvalidDataError, match="more than once"):
        read_records([path, path])


def test_files_that_state_roles(tmp_path):
    values = RNG.standard_normal((30, 3))
    for name in ("a", "b"):
        np.savez(tmp_path / f"{name}.npz", inputs=values[:, :1], outputs=values[:, 1:], dt=0.1)
    records = read_records([tmp_path / "a.npz", tmp_path / "b.npz"])
    assert [(record.n_inputs, record.n_outputs) for record in records] == [(1, 2), (1, 2)]
    np.savez(tmp_path / "c.npz", outputs=values, output_names=["p", "q", "r"], dt=0.1)
    (record,) = read_records([tmp_path / "a.npz", tmp_path / "c.npz"])
    assert (record.input_names, record.output_names) == (("input_0",), ("output_0", "output_1", "p", "q", "r"))


def clock_file(path, date, name):
    rows = [f"{date}12:{k // 4680:02d}:{k // 78 % 60:02d},{k % 7}\n" for k in range(7800)]
    path.write_text(f"Timestamp,{name}\n{''.join(rows)}")
    return path


def test_rounded_times_are_warned_of_in_joined_files(tmp_path):
    paths = [clock_file(tmp_path / f"{name}.csv", "2026-05-04 ", name) for name in "ab"]
    with pytest.warns(IdentificationWarning, match=r"times of a\+b\.csv are rounded.*\(--dt\)"):
        (record,) = read_records(paths)
    assert record.output_names == ("a", "b")


@pytest.mark.parametrize(("dates", "said"), [(("2026-05-04 ", ""), "a and b"), (("", "2026-05-04 "), "b and a")])
def test_a_date_in_one_of_joined_files_is_said(tmp_path, dates, said):
    paths = [clock_file(tmp_path / f"{name}.csv", date, name) for name, date in zip("ab", dates, strict=True)]
    first, second = (f"{name}.csv" for name in said.split(" and "))
    with pytest.raises(InvalidDataError, match=f"{first} gives the date of its samples and {second} gives none"):
        read_records(paths)


def test_a_pattern_names_the_forces_of_a_roving_hammer(write):
    paths = [write("a.csv", "force p1,y,z"), write("b.csv", "force p2,y,z", seed=1)]
    records = read_records(paths, inputs="force p*")
    assert [record.input_names for record in records] == [("force p1", "force p2")] * 2
    assert [record.inputs.any(axis=0).tolist() for record in records] == [[True, False], [False, True]]
    assert [record.output_names for record in records] == [("y", "z")] * 2
    (record,) = read_records(paths[:1], inputs="force p1", outputs=["?"])
    assert record.output_names == ("y", "z")


def test_a_star_in_a_name_is_that_name_first(write):
    path = write("a.csv", "u*,u1,y")
    assert read_records(path, inputs="u*")[0].output_names == ("u1", "y")
    with pytest.raises(InvalidDataError, match="no channel 'force\\*'"):
        read_records(path, inputs="force*")


def test_patterns_give_no_channel_twice(write):
    path = write("a.csv", "force p1,force p2,y,z")
    for inputs in ("force*", ["force*", "force p1"], ["force p1", "force*"], ["force*", "*p?"]):
        (record,) = read_records(path, inputs=inputs, outputs="*")
        assert (record.input_names, record.output_names) == (("force p1", "force p2"), ("y", "z"))
    with pytest.raises(InvalidDataError, match="named more than once"):
        read_records(path, inputs=["force p1", "force p1"])
    with pytest.raises(InvalidDataError, match="cannot be both"):
        read_records(path, inputs="force*", outputs=["force p1", "y"])
    with pytest.raises(InvalidDataError, match="all of them are inputs"):
        read_records(path, inputs="*", outputs="*")
