"""TDMS, LVM and WAV files, written by hand or by other libraries, and readers that other packages offer."""

import struct
import sys
import wave
from importlib.metadata import EntryPoint

import numpy as np
import pytest

import okid
from okid.errors import InvalidDataError, UnreadableFileError
from okid.readers import dispatch, read_record


def lvm(*, x_columns="One", decimal=".", separator="\t", samples=50, units=("Newtons", "g"), tail=""):
    time = 0.002 * np.arange(50)
    values = np.column_stack([np.sin(np.arange(50)), np.cos(np.arange(50))])
    name = {"\t": "Tab", ",": "Comma"}[separator]
    rows = [
        ["LabVIEW Measurement", ""],
        ["Writer_Version", "2"],
        ["Separator", name],
        ["Decimal_Separator", decimal],
        ["Multi_Headings", "Yes"],
        ["X_Columns", x_columns],
        ["***End_of_Header***", ""],
        [""],
        ["Channels", "2", "", ""],
        ["Samples", str(samples), str(samples), ""],
        ["Y_Unit_Label", *units, ""],
        ["X0", "1.0E+0", "1.0E+0", ""],
        ["Delta_X", "0.002", "0.002", ""],
        ["***End_of_Header***", "", "", ""],
    ]
    rows = [[cell.replace(".", decimal) if k else cell for k, cell in enumerate(row)] for row in rows]
    if x_columns == "Multi":
        rows.append(["X_Value", "force", "X_Value", "tip", "Comment"])
        cells = [[t, a, t, b] for t, (a, b) in zip(1.0 + time, values, strict=True)]
    else:
        rows.append(["X_Value", "force", "tip", "Comment"])
        cells = [[t if x_columns == "One" else "", *pair] for t, pair in zip(1.0 + time, values.tolist(), strict=True)]
    rows += [[cell if cell == "" else f"{cell:.9f}".replace(".", decimal) for cell in row] for row in cells]
    return "\r\n".join(separator.join(row) for row in rows) + "\r\n" + tail, values


@pytest.mark.parametrize(
    "layout", [{}, {"x_columns": "No"}, {"x_columns": "Multi"}, {"decimal": ","}, {"separator": ",", "x_columns": "No"}]
)
def test_measurement_files_of_labview(tmp_path, layout):
    text, values = lvm(**layout)
    (tmp_path / "run.lvm").write_text(text, newline="")
    record = okid.read_record(tmp_path / "run.lvm", inputs="force")
    assert (record.dt, record.start_time) == (0.002, 1.0)
    assert (record.input_units, record.output_units) == (("N",), ("m/s^2",))
    np.testing.assert_allclose(record.inputs[:, 0], values[:, 0], atol=1e-8)
    np.testing.assert_allclose(record.outputs[:, 0], 9.80665 * values[:, 1], atol=1e-7)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("time,tip\n0,1\n", "LabVIEW Measurement"),
        (lvm()[0][:140], "1 of two headers"),
        (lvm(samples=80)[0], "promises 80 samples, it has 50"),
        (lvm(tail="***End_of_Header***\r\n")[0], "2 segments"),
        (lvm(tail="x\ty\tz\r\n")[0], "damaged"),
    ],
)
def test_damaged_measurement_files_are_one_sentence(tmp_path, text, match):
    (tmp_path / "run.lvm").write_text(text, newline="")
    with pytest.raises(UnreadableFileError, match=match) as caught:
        okid.read_record(tmp_path / "run.lvm")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("width", "rounding"), [(1, 2**-7), (2, 2**-15), (3, 2**-23), (4, 2**-31)])
def test_sound_files_are_shares_of_full_scale(tmp_path, width, rounding):
    values = 0.9 * np.column_stack([np.sin(np.arange(300)), np.cos(0.3 * np.arange(300))])
    whole = np.round(values / rounding).astype(np.int64) + (128 if width == 1 else 0)
    data = b"".join(int(one).to_bytes(width, "little", signed=width > 1) for one in whole.ravel())
    with wave.open(str(tmp_path / "run.wav"), "wb") as file:
        file.setnchannels(2)
        file.setsampwidth(width)
        file.setframerate(8000)
        file.writeframes(data)
    record = okid.read_record(tmp_path / "run.wav", inputs="channel_0")
    assert (record.dt, record.output_names, record.output_units) == (1 / 8000, ("channel_1",), ("",))
    np.testing.assert_allclose(np.hstack([record.inputs, record.outputs]), values, atol=rounding)


def test_sound_files_of_floats(tmp_path):
    data = np.linspace(-2.0, 2.0, 100).astype("<f4").tobytes()
    chunk = (
        b"fmt " + struct.pack("<IHHIIHH", 16, 3, 1, 1000, 4000, 4, 32) + b"data" + struct.pack("<I", len(data)) + data
    )
    (tmp_path / "run.wav").write_bytes(b"RIFF" + struct.pack("<I", 4 + len(chunk)) + b"WAVE" + chunk)
    np.testing.assert_allclose(okid.read_record(tmp_path / "run.wav").outputs[:, 0], np.linspace(-2, 2, 100), atol=1e-6)
    (tmp_path / "cut.wav").write_bytes((tmp_path / "run.wav").read_bytes()[:200])
    (tmp_path / "text.wav").write_text("time,tip\n0,1\n")
    for name in ("cut", "text"):
        with pytest.raises(UnreadableFileError, match=f"{name}.wav is damaged, cut off or no WAV file"):
            okid.read_record(tmp_path / f"{name}.wav")


def read_for_others(path):
    return {"dt": np.array(0.01), "tip": np.array([float(word) for word in path.read_text().split()])}


def test_other_packages_offer_readers(tmp_path, monkeypatch):
    (tmp_path / "run.abc").write_text("1 2 4 8")
    with pytest.raises(UnreadableFileError, match=r"type \.abc, which is not read.*okid\.readers"):
        okid.read_record(tmp_path / "run.abc")
    point = EntryPoint(name="abc", value=f"{__name__}:read_for_others", group="okid.readers")
    monkeypatch.setattr(EntryPoint, "load", lambda _self: read_for_others)
    monkeypatch.setattr(
        dispatch, "entry_points", lambda group, name: [point] if (group, name) == (dispatch.OTHERS, "abc") else []
    )
    record = okid.read_record(tmp_path / "run.abc")
    assert (record.dt, record.outputs[:, 0].tolist()) == (0.01, [1.0, 2.0, 4.0, 8.0])
    (tmp_path / "bad.abc").write_text("1 two")
    with pytest.raises(UnreadableFileError, match=r"bad\.abc is damaged"):
        okid.read_record(tmp_path / "bad.abc")


def series(name, values, **time):
    return {"name": name, "data": values, "unit_str": "g" if name == "tip" else "N", **time}


def sep005_of(path):
    return [series(name, np.arange(float(path.read_text())), fs=50.0) for name in ("tip", "force")]


def test_series_of_sep005_are_records(tmp_path, monkeypatch):
    values = np.arange(6.0)
    for time in ({"fs": 50.0}, {"time": list(0.02 * values)}):
        channels = [series("force", values, **time), series("tip", 2 * values, **time)]
        record = okid.Record.from_frame(channels, inputs="force", outputs="tip")
        assert (record.dt, record.output_units) == (pytest.approx(0.02), ("m/s^2",))
        np.testing.assert_allclose(record.outputs[:, 0], 2 * 9.80665 * values)
    (tmp_path / "run.dxd").write_text("6")
    monkeypatch.setattr(EntryPoint, "load", lambda _self: sep005_of)
    point = EntryPoint(name="dxd", value=f"{__name__}:sep005_of", group="okid.readers")
    monkeypatch.setattr(dispatch, "entry_points", lambda group, name: [point] if name == "dxd" else [])
    assert okid.read_record(tmp_path / "run.dxd", inputs="force").output_names == ("tip",)
    for wrong, words in (
        ([series("a", values, fs=50.0), series("b", values, fs=25.0)], "different time axes"),
        ([series("a", values, fs=50.0), series("b", values[1:], fs=50.0)], "different time axes"),
        ([series("a", values)], "none of SEP 005"),
        ([{"data": values, "fs": 50.0}], "none of SEP 005"),
        ([series("a", values, time=[0.0] * 6)], "none of SEP 005"),
    ):
        with pytest.raises(UnreadableFileError, match=words) as caught:
            okid.Record.from_frame(wrong, inputs=(), outputs="a")
        assert "\n" not in str(caught.value)


def test_mdf_needs_its_extra(tmp_path, monkeypatch):
    (tmp_path / "run.mf4").write_bytes(b"MDF     4.10")
    monkeypatch.setitem(sys.modules, "asammdf", None)
    with pytest.raises(
        UnreadableFileError, match=r'asammdf, which is not installed; run: pip install "okid-modal\[mdf\]"'
    ):
        okid.read_record(tmp_path / "run.mf4")


def test_channels_of_an_mdf_file(tmp_path):
    asammdf = pytest.importorskip("asammdf")
    time = 5.0 + np.arange(500) / 1000.0
    with asammdf.MDF(version="4.10") as file:
        fast = [("tip", "g", np.sin(time)), ("force", "kN", np.cos(time).astype("f4")), ("count", "", np.arange(500))]
        file.append([asammdf.Signal(samples=x, timestamps=time, name=name, unit=unit) for name, unit, x in fast])
        file.append([asammdf.Signal(samples=np.arange(50.0), timestamps=time[::10], name="oil", unit="degC")])
        file.save(tmp_path / "run.mf4")
    record = okid.read_record(tmp_path / "run.mf4", inputs="force", outputs=["tip"])
    assert (record.dt, record.start_time) == (pytest.approx(1e-3), pytest.approx(5.0))
    assert (record.input_units, record.output_units) == (("N",), ("m/s^2",))
    np.testing.assert_allclose(record.outputs[:, 0], 9.80665 * np.sin(time))
    np.testing.assert_allclose(record.inputs[:, 0], 1000 * np.cos(time), rtol=1e-6)
    (left,) = dispatch.describe_file(tmp_path / "run.mf4").left_out
    assert (left.name, "50 samples" in left.reason) == ("oil", True)
    (tmp_path / "cut.mf4").write_bytes((tmp_path / "run.mf4").read_bytes()[:700])
    for name, words in (("cut.mf4", "damaged"), ("oil.mf4", "damaged")):
        if name == "oil.mf4":
            (tmp_path / name).write_text("time,tip\n0,1\n")
        with pytest.raises(UnreadableFileError, match=words):
            okid.read_record(tmp_path / name)


nptdms = pytest.importorskip("nptdms")
VALUES = np.random.default_rng(6).standard_normal((40, 2))


def write(path, channels):
    with nptdms.TdmsWriter(str(path)) as writer:
        writer.write_segment(
            [nptdms.ChannelObject(group, name, values, properties=given) for group, name, values, given in channels]
        )
    return path


def test_channels_units_and_step(tmp_path):
    channels = [
        ("run", "shaker", VALUES[:, 0], {"wf_increment": 0.01, "unit_string": "kN"}),
        ("run", "tip", VALUES[:, 1], {"wf_increment": 0.01, "unit_string": "g"}),
    ]
    record = read_record(write(tmp_path / "a.tdms", channels), inputs="shaker")
    assert (record.dt, record.input_units, record.output_names) == (0.01, ("N",), ("tip",))
    np.testing.assert_allclose(record.outputs[:, 0], 9.80665 * VALUES[:, 1])


def test_one_name_in_two_groups(tmp_path):
    channels = [("a", "tip", VALUES[:, 0], {}), ("b", "tip", VALUES[:, 1], {})]
    assert read_record(write(tmp_path / "a.tdms", channels), dt=1.0).output_names == ("a/tip", "b/tip")


def test_channels_of_different_rates(tmp_path):
    channels = [("a", "x", VALUES[:, 0], {"wf_increment": 0.1}), ("a", "y", VALUES[:, 1], {"wf_increment": 0.2})]
    with pytest.raises(UnreadableFileError, match=r"different time axes .*40 samples at 0\.1 s"):
        read_record(write(tmp_path / "a.tdms", channels))


def test_damage(tmp_path):
    (tmp_path / "a.tdms").write_bytes(b"hello" * 10)
    with pytest.raises(UnreadableFileError, match="damaged, cut off or no TDMS"):
        read_record(tmp_path / "a.tdms")


@pytest.mark.parametrize("layout", [{}, {"x_columns": "Multi"}, {"decimal": ","}])
def test_a_time_column_of_labview_that_contradicts_its_header_is_refused(tmp_path, layout):
    """The header alone was believed."""
    text, _ = lvm(**layout)
    point = layout.get("decimal", ".")
    (tmp_path / "run.lvm").write_text(text.replace(f"0{point}002\t", "1\t"), newline="")
    with pytest.raises(InvalidDataError, match=r"Delta_X says 1 s, X_Value says 0\.002 s\); .*--dt"):
        okid.read_record(tmp_path / "run.lvm")
    assert okid.read_record(tmp_path / "run.lvm", dt=0.002).dt == 0.002
    lines = [line for line in text.splitlines(keepends=True) if not line.startswith("Delta_X")]
    (tmp_path / "run.lvm").write_text("".join(lines), newline="")
    assert okid.read_record(tmp_path / "run.lvm").dt == pytest.approx(0.002, rel=1e-9)


@pytest.mark.parametrize(("n_rows", "digits", "header"), [(20, 3, 1 / 1024), (12, 4, 1 / 1024), (12, 4, 0.0013)])
def test_a_time_column_of_labview_contradicts_its_header_only_beyond_its_digits(tmp_path, n_rows, digits, header):
    text, _ = lvm()
    lines = text.splitlines()
    rows = [f"{k / 1024:.{digits}f}\t{k % 7}\t{k % 3}" for k in range(n_rows)]
    lines = [*lines[: -len(lvm()[1])], *rows]
    text = "\n".join(lines).replace("Samples\t50\t50", f"Samples\t{n_rows}\t{n_rows}") + "\n"
    text = text.replace("0.002\t0.002", f"{header:.10f}\t{header:.10f}")
    (tmp_path / "run.lvm").write_text(text, newline="")
    if header == 1 / 1024:
        assert read_record(tmp_path / "run.lvm").dt == pytest.approx(header, rel=1e-6)
    else:
        with pytest.raises(InvalidDataError, match=r"Delta_X says 0\.0013 s, X_Value says"):
            read_record(tmp_path / "run.lvm")


@pytest.mark.parametrize(("cell", "why"), [("1.091", "X_Value must increase, .*"), ("late", "it holds text")])
def test_why_a_time_column_of_labview_was_not_taken_is_said(tmp_path, cell, why):
    text, _ = lvm()
    (tmp_path / "run.lvm").write_text(text.replace("1.010000000", cell), newline="")
    assert read_record(tmp_path / "run.lvm").dt == 0.002
    text = "".join(line for line in text.splitlines(keepends=True) if not line.startswith("Delta_X"))
    (tmp_path / "run.lvm").write_text(text.replace("1.010000000", cell), newline="")
    with pytest.raises(InvalidDataError, match=f"'X_Value' was left out: {why}\\), so the time step must be given"):
        read_record(tmp_path / "run.lvm")
