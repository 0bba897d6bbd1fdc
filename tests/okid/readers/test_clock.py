"""Clocks in text tables: when their stamps are the time, and when they are text."""

import numpy as np
import pytest

from okid.errors import IdentificationWarning, InvalidDataError
from okid.readers import describe_file, read_record, read_table
from okid.readers.text import more_rows


def elapsed(k):
    return f"{0.01 * k:.2f}"


def stamp_of(k):
    return f"2026-05-04 12:00:{k // 100:02d}"


def clock_of(k):
    return f"12:00:{k // 100:02d}"


NUMERIC_TIMES = {
    "a stamp of whole seconds": ("Elapsed [s];Timestamp;a [g]", lambda k: (elapsed(k), stamp_of(k))),
    "before it": ("Timestamp;Elapsed [s];a [g]", lambda k: (stamp_of(k), elapsed(k))),
    "date and clock": ("Date;Time;t [s];a", lambda k: ("2026-05-04", clock_of(k), elapsed(k))),
    "under one name": ("Date,Time,Elapsed Time,a", lambda k: ("2026-05-04", clock_of(k), elapsed(k))),
    "a unit without brackets": ("No,Timestamp,Time ms,a", lambda k: (k, stamp_of(k), 10 * k)),
    "a clock of laps": ("time,lap,a", lambda k: (elapsed(k), f"00:00:{k * 7 // 100 % 50:02d}")),
    "a constant stamp": ("time [s];started;a", lambda k: (elapsed(k), "2026-05-04 12:00:00")),
    "a constant stamp first": ("started;time [s];a", lambda k: ("2026-05-04 12:00:00", elapsed(k))),
    "degrees and minutes": ("time,lat,a", lambda k: (elapsed(k), f"48:12.{k // 10 % 7}")),
    "no date": ("time,serial,a", lambda k: (elapsed(k), "2026-02-31 12:00:00")),
}


BEYOND_THE_HEAD = ("a stamp of whole seconds", "date and clock", "a clock of laps")
"""Asked of 3000 rows too: more than is looked at to find the columns."""


@pytest.mark.parametrize(
    ("kind", "n_samples"), [*((key, 300) for key in NUMERIC_TIMES), *((key, 3000) for key in BEYOND_THE_HEAD)]
)
def test_stamps_beside_a_numeric_time_are_text(tmp_path, kind, n_samples):
    header, row = NUMERIC_TIMES[kind]
    path, cut = tmp_path / "a.csv", ";" if ";" in header else ","
    rows = [cut.join(map(str, (*row(k), k * k % 7))) for k in range(n_samples)]
    path.write_text("\n".join([header, *rows]) + "\n")
    record = read_record(path)
    assert (record.output_names, record.dt) == (("a",), pytest.approx(0.01, rel=1e-9))
    assert sum("it holds text" in remark for remark in describe_file(path).remarks) == (2 if "Date" in header else 1)
    lines = [line.encode() + b"\n" for line in (header, *rows)]
    more = more_rows(b"".join(lines[201:]), b"".join(lines[:201]), path, n_lines=201)
    np.testing.assert_array_equal(more, read_table(path).values[200:])


def test_a_column_that_a_clock_became_is_the_time(tmp_path):
    """A numeric time that is no grid is none; between blanks no text is left out, so the clock is read."""
    path = tmp_path / "a.csv"
    path.write_text("t,Timestamp,a\n" + "".join(f"{k * k % 7},{stamp_of(100 * k)},{k}\n" for k in range(30)))
    assert (read_record(path).dt, read_record(path).output_names) == (1.0, ("t", "a"))
    path.write_text(
        "Date Time t a\n" + "".join(f"2026-05-04 {clock_of(k)} {elapsed(k)} {k % 7}\n" for k in range(3000))
    )
    with pytest.warns(IdentificationWarning, match="times .* are rounded"):
        assert read_record(path).output_names == ("a",)
    path.write_text("started,Timestamp,a\n" + "".join(f"12:00:00,{stamp_of(100 * k)},{k}\n" for k in range(30)))
    assert (read_record(path).dt, read_record(path).output_names) == (1.0, ("a",))
    path.write_text("lat,a\n" + "".join(f"48:12.{k % 7},{k}\n" for k in range(30)))
    with pytest.raises(InvalidDataError, match=r"no time column .*'lat' was left out: it holds text"):
        read_record(path)
    path.write_text("time,millis,a\n" + "".join(f"1,{k},{k % 3}\n" for k in range(30)))
    with pytest.raises(InvalidDataError, match="must increase"):
        read_record(path)


@pytest.mark.parametrize("header", ["", "Time counts a\n"])
def test_a_number_behind_a_blank_is_no_zone(tmp_path, header):
    path = tmp_path / "a.txt"
    path.write_text(header + "".join(f"12:00:0{k}.010000 {-1234 - k} 0.126\n" for k in range(9)))
    record = read_record(path)
    assert (record.dt, record.outputs.tolist()) == (1.0, [[-1234.0 - k, 0.126] for k in range(9)])


def test_a_clock_has_sixty_minutes(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("ratio,a\n" + "".join(f"12:75:{k:02d},{k}\n" for k in range(30)))
    with pytest.raises(InvalidDataError, match=r"no time column .*'ratio' was left out: it holds text"):
        read_record(path)


@pytest.mark.parametrize("header", ["Timestamp,a", "Measured\r\rTimestamp,a", "Timestamp,Time [s],a"])
def test_stamps_in_lines_that_end_in_carriage_returns(tmp_path, header):
    path, own = tmp_path / "a.csv", "Time [s]" in header
    rows = [f"{stamp_of(100 * k)}{f',{0.5 * k}' if own else ''},{k}" for k in range(30)]
    path.write_bytes("\r".join([header, *rows, ""]).encode())
    record = read_record(path)
    assert (record.dt, record.output_names) == (0.5 if own else 1.0, ("a",))
    assert record.outputs.ravel().tolist() == list(range(30))
