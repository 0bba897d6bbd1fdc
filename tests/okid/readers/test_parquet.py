"""Parquet written by pyarrow."""

import datetime as dt
import json

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
def test_time_stamps_count_from_1970(tmp_path, unit):
    start = dt.datetime(2026, 11, 21, tzinfo=dt.UTC)
    stamps = [start + dt.timedelta(milliseconds=8 * index) for index in range(100)]
    table = pa.table({"time": pa.array(stamps, pa.timestamp(unit, tz="UTC")), "tip": TIP})
    pq.write_table(table, tmp_path / "a.parquet")
    record = read_record(tmp_path / "a.parquet")
    assert record.dt == pytest.approx(0.008, rel=1e-12)
    assert record.start_time == start.timestamp()


@pytest.mark.parametrize("share", [0.3, 0.9, 0.999])
def test_cut_off(tmp_path, share):
    pq.write_table(pa.table({"tip": TIP}), tmp_path / "a.parquet")
    whole = (tmp_path / "a.parquet").read_bytes()
    (tmp_path / "a.parquet").write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(UnreadableFileError, match=r"a\.parquet is damaged, cut off or no Parquet file"):
        read_record(tmp_path / "a.parquet", dt=1.0)


def of_pandas(tmp_path, index, name="__index_level_0__"):
    """A file as pandas writes a frame whose rows are not counted from 0: the index is a column, marked as one."""
    table = pa.table({"force": FORCE, "tip": TIP, name: index})
    marked = {b"pandas": json.dumps({"index_columns": [name], "columns": []}).encode()}
    pq.write_table(table.replace_schema_metadata(marked), tmp_path / "a.parquet")
    return tmp_path / "a.parquet"


def test_the_numbers_of_the_rows_are_no_channel(tmp_path):
    path = of_pandas(tmp_path, np.arange(100, 100 + len(FORCE)))
    record = read_record(path, inputs="force", dt=0.1)
    assert record.output_names == ("tip",)
    assert any("__index_level_0__ left out: it is the index" in remark for remark in describe_file(path).remarks)
    assert read_record(of_pandas(tmp_path, np.arange(len(FORCE)), "b"), inputs="force", dt=0.1).output_names == (
        "tip",
        "b",
    )
    start = dt.datetime(2026, 1, 1, tzinfo=dt.UTC)
    times = pa.array([start + dt.timedelta(milliseconds=20 * k) for k in range(len(FORCE))])
    assert read_record(of_pandas(tmp_path, times), inputs="force").dt == pytest.approx(0.02)


def test_a_counter_of_many_digits_spoils_no_other_column(tmp_path):
    count = pa.array([2**60 + 1 + k for k in range(len(FORCE))])
    pq.write_table(pa.table({"tip": TIP, "count": count}), tmp_path / "a.parquet")
    record = read_record(tmp_path / "a.parquet", outputs=["tip", "count"], dt=0.1)
    np.testing.assert_array_equal(record.outputs[:, 1], np.array(count.to_pylist(), dtype=float))


def test_one_time_that_is_missing_is_one(tmp_path):
    start = dt.datetime(2026, 1, 1, tzinfo=dt.UTC)
    times = [None, *(start + dt.timedelta(milliseconds=20 * k) for k in range(1, len(FORCE)))]
    pq.write_table(pa.table({"time": pa.array(times), "tip": TIP}), tmp_path / "a.parquet")
    with pytest.raises(InvalidDataError, match=f"is missing in 1 of {len(FORCE)} rows, the first of them row 1"):
        read_record(tmp_path / "a.parquet")


def test_a_file_is_whole_or_refused_also_where_it_is_left_out(tmp_path):
    path = tmp_path / "a.parquet"
    pq.write_table(pa.table({"tip": TIP, "note": [f"row {k}" for k in range(len(TIP))]}), path, use_dictionary=False)
    assert read_record(path, dt=0.1).output_names == ("tip",)
    place = pq.ParquetFile(path).metadata.row_group(0).column(1).data_page_offset
    data = bytearray(path.read_bytes())
    data[place : place + 8] = b"\xff" * 8
    path.write_bytes(data)
    with pytest.raises(UnreadableFileError, match="is damaged, cut off or no Parquet file"):
        read_record(path, dt=0.1)


def test_texts_are_not_even_unpacked(tmp_path):
    """A hundred times the same text of a megabyte takes kilobytes in the file."""
    note = pa.array(["x" * 1_000_000] * len(FORCE))
    pq.write_table(pa.table({"tip": TIP, "note": note}), tmp_path / "a.parquet", compression="zstd", store_schema=False)
    del note
    usual, pool = pa.default_memory_pool(), pa.proxy_memory_pool(pa.default_memory_pool())
    pa.set_memory_pool(pool)
    try:
        assert read_record(tmp_path / "a.parquet", dt=0.1).output_names == ("tip",)
    finally:
        pa.set_memory_pool(usual)
    assert pool.max_memory() < 20_000_000
    with pytest.raises(InvalidDataError, match=r"'note'.* not numbers"):
        read_record(tmp_path / "a.parquet", outputs="note", dt=0.1)


def test_no_numbers_and_no_rows(tmp_path):
    pq.write_table(pa.table({"label": ["x"]}), tmp_path / "a.parquet")
    with pytest.raises(UnreadableFileError, match="no column of numbers"):
        read_record(tmp_path / "a.parquet", dt=1.0)
    pq.write_table(pa.table({"tip": pa.array([], pa.float64())}), tmp_path / "b.parquet")
    with pytest.raises(UnreadableFileError, match="no samples"):
        read_record(tmp_path / "b.parquet", dt=1.0)
