"""Parquet written by pyarrow."""

import datetime as dt

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from okid.errors import InvalidDataError, UnreadableFileError
from okid.readers import describe_file, read_record

RNG = np.random.default_rng(9)
TIME, FORCE, TIP = 0.01 * np.arange(100), RNG.standard_normal(100), RNG.standard_normal(100)


def test_units_from_metadata_and_names(tmp_path):
    fields = [
        pa.field("time", pa.float64(), metadata={"unit": "ms"}),
        pa.field("force [kip]", pa.float64()),
        pa.field("tip", pa.float32(), metadata={"units": "in"}),
    ]
    columns = [pa.array(TIME * 1e3), pa.array(FORCE), pa.array(TIP, pa.float32())]
    pq.write_table(pa.table(columns, schema=pa.schema(fields)), tmp_path / "a.parquet")
    record = read_record(tmp_path / "a.parquet", inputs="force")
    assert record.dt == pytest.approx(0.01)
    assert (record.input_units, record.output_units) == (("N",), ("m",))
    np.testing.assert_allclose(record.inputs[:, 0], FORCE * 4448.2216152605, rtol=1e-12)
    np.testing.assert_allclose(record.outputs[:, 0], TIP.astype(np.float32).astype(float) * 0.0254, rtol=1e-14)


def test_missing_values_and_kinds_of_numbers(tmp_path):
    columns = {
        "a": pa.array([1.0, None, 3.0, float("nan")]),
        "b": pa.array([1, 2, None, 4], pa.int16()),
        "c": pa.array([True, False, True, True]),
        "label": pa.array(["x", "y", "z", "w"]),
    }
    pq.write_table(pa.table(columns), tmp_path / "a.pq")
    record = read_record(tmp_path / "a.pq", dt=1.0)
    np.testing.assert_array_equal(record.outputs, [[1, 1, 1], [np.nan, 2, 0], [3, np.nan, 1], [np.nan, 4, 1]])
    assert any("label left out: it holds string" in remark for remark in describe_file(tmp_path / "a.pq").remarks)
    with pytest.raises(InvalidDataError, match=r"'label' .* string, not numbers"):
        read_record(tmp_path / "a.pq", dt=1.0, outputs="label")


@pytest.mark.parametrize("unit", ["ms", "us", "ns"])
def test_time_stamps_are_seconds_after_the_first(tmp_path, unit):
    start = dt.datetime(2026, 11, 21, tzinfo=dt.UTC)
    stamps = [start + dt.timedelta(milliseconds=8 * index) for index in range(100)]
    table = pa.table({"time": pa.array(stamps, pa.timestamp(unit, tz="UTC")), "tip": TIP})
    pq.write_table(table, tmp_path / "a.parquet")
    record = read_record(tmp_path / "a.parquet")
    assert record.dt == pytest.approx(0.008, rel=1e-12)
    assert record.start_time == 0.0


@pytest.mark.parametrize("share", [0.3, 0.9, 0.999])
def test_cut_off(tmp_path, share):
    pq.write_table(pa.table({"tip": TIP}), tmp_path / "a.parquet")
    whole = (tmp_path / "a.parquet").read_bytes()
    (tmp_path / "a.parquet").write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(UnreadableFileError, match=r"a\.parquet is damaged, cut off or no Parquet file"):
        read_record(tmp_path / "a.parquet", dt=1.0)


def test_no_numbers_and_no_rows(tmp_path):
    pq.write_table(pa.table({"label": ["x"]}), tmp_path / "a.parquet")
    with pytest.raises(UnreadableFileError, match="no column of numbers"):
        read_record(tmp_path / "a.parquet", dt=1.0)
    pq.write_table(pa.table({"tip": pa.array([], pa.float64())}), tmp_path / "b.parquet")
    with pytest.raises(UnreadableFileError, match="no samples"):
        read_record(tmp_path / "b.parquet", dt=1.0)
