"""Text tables as programs write them: every dialect gives the numbers that were written."""

import csv

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from okid.errors import IdentificationWarning, UnreadableFileError
from okid.readers import describe_file, read_record
from okid.readers.text import read_text


@pytest.fixture
def table(tmp_path):
    """Write text (or bytes) to a file and read it as a table."""

    def read(content):
        path = tmp_path / "record.csv"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return read_text(path)

    return read


NUMBERS = [[0.0, 1.5, 2.0], [0.1, -2.5, 3e5]]
DIALECTS = {
    "comma": "time,u,y\n0,1.5,2\n0.1,-2.5,3e5\n",
    "blanks around": "time , u , y\n0 , 1.5 , 2\n 0.1,  -2.5 ,3E+5\n",
    "semicolon and decimal comma": "time;u;y\n0,0;1,5;2\n0,1;-2,5;3e5\n",
    "semicolon": "time;u;y\n0;1.5;2\n0.1;-2.5;3e5\n",
    "tab": "time\tu\ty\n0\t1.5\t2\n0.1\t-2.5\t3e5\n",
    "tab and decimal comma": "time\tu\ty\n0\t1,5\t2\n0,1\t-2,5\t3e5\n",
    "bar": "time|u|y\n0|1.5|2\n0.1|-2.5|3e5\n",
    "blanks": "time u y\n 0.0   1.5 2.\n 0.1  -2.5 3e5\n",
    "numpy": "# time, u, y\n0.0e+00 1.5e+00 2.0e+00\n1.0e-01 -2.5e+00 3.0e+05\n",
    "quotes": '"time","u","y"\n"0","1.5","2"\n0.1,-2.5,3e5\n',
    "quoted decimal comma": '"time","u","y"\n"0,0","1,5","2,0"\n"0,1","-2,5","3e5"\n',
    "windows": "time,u,y\r\n0,1.5,2\r\n0.1,-2.5,3e5\r\n",
    "old mac": "time,u,y\r0,1.5,2\r0.1,-2.5,3e5\r",
    "no last line end": "time,u,y\n0,1.5,2\n0.1,-2.5,3e5",
    "byte order mark": "\ufefftime,u,y\n0,1.5,2\n0.1,-2.5,3e5\n",
    "ends with delimiter": "time;u;y;\n0;1.5;2;\n0.1;-2.5;3e5;\n",
    "rows end with delimiter": "time;u;y\n0;1.5;2;\n0.1;-2.5;3e5;\n",
    "blank lines": "\ntime,u,y\n\n0,1.5,2\n0.1,-2.5,3e5\n\n\n",
    "remarks": "# by a logger, version 2\nOperator: me\nRate;1000;Hz\n12\n\ntime,u,y\n0,1.5,2\n0.1,-2.5,3e5\n",
    "remarks marked by percent": "% one\n%two\n% time,u,y\n0,1.5,2\n0.1,-2.5,3e5\n",
}


@pytest.mark.parametrize("content", DIALECTS.values(), ids=DIALECTS.keys())
def test_dialects(table, content):
    found = table(content)
    assert found.names == ("time", "u", "y")
    np.testing.assert_array_equal(found.values, NUMBERS)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "cp1252"])
def test_encodings(table, encoding):
    text = "time [s],Öl [°C],d [µm]\n0,1,2\n1,2,3\n"
    mark = b"\xff\xfe" if encoding == "utf-16-le" else b""
    found = table(mark + text.encode(encoding))
    assert [(column.name, column.unit) for column in found.columns] == [("time", "s"), ("Öl", "°C"), ("d", "µm")]


def test_a_row_of_units_below_the_names(table):
    found = table("time,u,y\ns,kN,m/s2\n0,1,2\n1,2,3\n")
    assert [column.unit for column in found.columns] == ["s", "kN", "m/s2"]
    found = table("force\tdisp\n(kN)\t(mm)\n0\t1\n1\t2\n")
    assert [(column.name, column.unit) for column in found.columns] == [("force", "kN"), ("disp", "mm")]


def test_a_remark_of_as_many_words_is_no_header(table):
    found = table("Operator,Miller,Bay 3\nt,u,y\n0,1,2\n1,2,3\n")
    assert found.names == ("t", "u", "y")


def test_no_header(table):
    found = table("1,2.5\n3,4\n")
    assert found.names == ("column_0", "column_1")
    assert found.time_column() is None
    assert found.counter_column() is None
    np.testing.assert_array_equal(found.values, [[1, 2.5], [3, 4]])


def test_one_column(table):
    np.testing.assert_array_equal(table("y\n1,5\n2,5\n").values, [[1.5], [2.5]])
    np.testing.assert_array_equal(table("tip (left)\n1.5\n2\n").values, [[1.5], [2.0]])
    np.testing.assert_array_equal(table("1.5\n2\n").values, [[1.5], [2.0]])


@pytest.mark.parametrize("missing", ["", " ", "   ", "nan", "NaN", " nan", "NA", "null", "#N/A", "-nan(ind)", '""'])
def test_missing_cells_are_nan(table, missing):
    found = table(f"a,b,c\n1,2,3\n4,{missing},6\n7,8,9\n")
    np.testing.assert_array_equal(found.values, [[1, 2, 3], [4, np.nan, 6], [7, 8, 9]])


def test_missing_cells_in_the_first_row(table):
    np.testing.assert_array_equal(table("a,b\n,2\n4,\n").values, [[np.nan, 2], [4, np.nan]])


def test_channels_called_by_numbers(table):
    assert table("time,1,2\n0,5,6\n1,6,7\n").names == ("time", "1", "2")


@pytest.mark.parametrize("counter", ["sample", "Index", "", "no"])
def test_a_counter_of_samples_is_no_channel(table, counter):
    found = table(f"{counter},u,y\n0,5,6\n1,6,7\n2,6,7\n")
    assert found.counter_column() == 0
    assert found.channels() == [1, 2]
    assert table(f"{counter},u,y\n0,5,6\n1,6,7\n3,6,7\n").counter_column() is None


@pytest.mark.parametrize(
    ("header", "is_time"),
    [
        *[(name, True) for name in ("time", "Time [ms]", "t", "t (s)", "T [s]", "Timestamp", "elapsed_time")],
        *[(name, False) for name in ("T", "T [N m]", "t [kg]", "torque", "times_ten")],
    ],
)
def test_which_column_is_the_time(table, header, is_time):
    assert (table(f"{header},y\n0,1\n1,2\n").time_column() == 0) is is_time


@settings(max_examples=40, deadline=None)
@given(
    values=st.integers(1, 5).flatmap(
        lambda width: st.lists(
            st.lists(st.floats(allow_nan=True, allow_infinity=False), min_size=width, max_size=width),
            min_size=2,
            max_size=12,
        )
    ),
    delimiter=st.sampled_from([",", ";", "\t"]),
)
def test_any_numbers_come_back_to_the_last_bit(values, delimiter, tmp_path_factory):
    if all(np.isnan(row).all() for row in values) or not np.isfinite(values[0]).any():
        return  # a first row without any number is a row of a table only by what follows it
    path = tmp_path_factory.mktemp("text") / "record.csv"
    with path.open("w", newline="") as file:
        writer = csv.writer(file, delimiter=delimiter)
        writer.writerow([f"c{index}" for index in range(len(values[0]))])
        writer.writerows([["" if np.isnan(cell) and len(row) > 1 else repr(cell) for cell in row] for row in values])
    np.testing.assert_array_equal(read_text(path).values, values)


@pytest.mark.parametrize("delimiter", [",", "\t", " "])
def test_many_rows_in_many_blocks(tmp_path, monkeypatch, delimiter):
    monkeypatch.setattr("okid.readers.text.TextLimits.BLOCK_BYTES", 4096)
    values = np.random.default_rng(1).standard_normal((5000, 4))
    path = tmp_path / "record.txt"
    np.savetxt(path, values, delimiter=delimiter, header=delimiter.join("abcd"), fmt="%.17g")
    record = read_record(path, inputs="b", dt=0.1)
    np.testing.assert_array_equal(record.inputs[:, 0], values[:, 1])
    np.testing.assert_array_equal(record.outputs, values[:, [0, 2, 3]])


FAULTS = {
    "text in a cell": ("time,u\n0,1\n1,x\n2,3\n", "line 3, column 'u' of .* holds 'x'"),
    "text in the first row": ("time,u,y\nabc,1,2\n1,2,3\n2,3,4\n", "line 2, column 'time' .* holds 'abc'"),
    "hexadecimal": ("a,b\n1,2\n1,0x10\n", "line 3, column 'b' .* '0x10'"),
    "other decimal sign": ('a,b\n1,2.5\n1,"2,5"\n', "line 3, column 'b' .* decimal sign"),
    "long text is cut": (f"a,b\n1,2\n1,{'x' * 500}\n", "'x{37}...'"),
    "short row": ("time,u,y\n0,1,2\n1,2,3\n2,3\n", "line 4 of .* holds 2 cells, but the table has 3 columns"),
    "long row": ("time,u\n0,1\n1,2\n1,2,3\n", "line 4 of .* holds 3 cells, .* 2 columns"),
    "short first row": ("time,u,y\n0,1\n1,2,3\n2,3,4\n", "line 2 of .* holds 2 cells, but the rows below it hold 3"),
    "short second row": ("time,u,y\n0,1,2\n1,2\n2,3,4\n", "line 3 of .* holds 2 cells"),
    "header of other length": ("time,u,y\n0,1\n1,2\n", "line 1 of .* names 3 columns, but .* 2 numbers"),
    "no numbers": ("hello\nworld\n", "no row of numbers among its first 2 lines .*'hello'"),
    "one line": ("hello\n", "no row of numbers in its only line .*'hello'"),
    "complex numbers": ("(1+2j)\n(3+4j)\n", "no row of numbers"),
    "binary": (b"\x00\x01\x02\xff" * 10, "binary data, not text"),
    "one long line": (b"1" * (1 << 21), "longer than 1048576 bytes"),
    "broken utf-16": (b"\xff\xfe\x00\xd8\x00", "utf-16"),
    "blank": (" \n\n \n", "no row of numbers"),
}


@pytest.mark.parametrize(("content", "message"), FAULTS.values(), ids=FAULTS.keys())
def test_faults_are_named(table, content, message):
    with pytest.raises(UnreadableFileError, match=message):
        table(content)


def test_a_fault_far_down_is_found_at_its_line(table, monkeypatch):
    monkeypatch.setattr("okid.readers.text.TextLimits.BLOCK_BYTES", 4096)
    rows = [f"{index},{index / 7}" for index in range(20_000)]
    rows[15_000] = "15000,oops"
    with pytest.raises(UnreadableFileError, match=r"line 15002, column 'b' .* 'oops'"):
        table("a,b\n" + "\n".join(rows) + "\n")


@pytest.mark.parametrize("header", ["time [s],force [N]", "force [N],tip [m],"])
def test_a_header_one_name_short_is_refused(tmp_path, header):
    """Which column lacks its name the file does not say: numbered rows shift every name by one."""
    path = tmp_path / "short.csv"
    path.write_text(header + "\n" + "".join(f"{k / 100},{k % 7},{k % 5}\n" for k in range(50)))
    with pytest.raises(UnreadableFileError, match="names 2 columns, but its rows hold 3 numbers"):
        read_record(path)


@pytest.mark.parametrize("encoding", ["utf-8", "cp1252"])
def test_a_cell_is_shown_as_it_is_written(table, encoding):
    text = "time,u\n" + "".join(f"{k},1\n" for k in range(30)) + "30,größer als 5 µm\n"
    with pytest.raises(UnreadableFileError, match="holds 'größer als 5 µm' where a number is expected"):
        table(text.encode(encoding))


LOGGERS = {  # what stands above the rows of three numbers, the numbers' delimiter and sign, and names and units below
    "oscilloscope": ("x-axis,1,2\nsecond,Volt,Volt\n", ",", ".", {"1": "V", "2": "V"}),
    "units in parentheses": ("Zeit;Kanal A;Kanal B\n(s);(mV);(V)\n\n", ";", ",", {"Kanal A": "V", "Kanal B": "V"}),
    "names of sensors below the units": (
        "SAMPLE RATE\t1000 Hz\n\nTime  1\tKraft\tBeschl\ns\tkN\tm/s²\nT0\tU10M\tB12\n",
        "\t",
        ",",
        {"Kraft": "N", "Beschl": "m/s^2"},
    ),
    "a row that says it holds units": ("Time;Kraft;Weg\nEinheit;N;mm\n", ";", ",", {"Kraft": "N", "Weg": "m"}),
    "a comment beside the rows": (
        "X_Value\tUntitled\tUntitled 1\tComment\n",
        "\t",
        ".",
        {"Untitled": "", "Untitled 1": ""},
    ),
    **{
        f"{titles} / {units}": (
            f"{titles}\n{units}\n",
            sep,
            sign,
            {titles.split(sep)[1]: "m/s^2", titles.split(sep)[2]: "N"},
        )
        for sep, sign, titles, units in (
            *(
                (";", ",", "Zeit;a;F", "s;g;kN"),
                (";", ",", "Zeit;a;F", "[s];[g];[kN]"),
                (";", ",", "Zeit;A;B", "s;g;kN"),
            ),
            *((";", ".", "Time;acc;force", "Seconds;g;kN"), ("\t", ".", "Temps\ta\tF", "s\tg\tN")),
            *((",", ".", "time,acc,force", "SEC,g,N"),),
        )
    },
    "units above the names": ("s,kN,g\ntime,force,a1\n", ",", ".", {"force": "N", "a1": "m/s^2"}),
    "units above, in a remark": ("# units: s, g, kN\n# time, a, F\n", ",", ".", {"a": "m/s^2", "F": "N"}),
    "units above, said to be": ("Einheit: s;V;N\nZeit;a;F\n", ";", ",", {"a": "V", "F": "N"}),
    "units in a remark further up": (
        *("# units: s, g, kN\n# by a logger, on Monday\n#\ntime,a,F\n", ",", "."),
        {"a": "m/s^2", "F": "N"},
    ),
    "units above and beside": ("s,N,g\ntime [s],force [N],a1\n", ",", ".", {"force": "N", "a1": "m/s^2"}),
    "names of sensors below names with units": (
        *("Zeit [s];Beschl [g];Kraft [kN]\n;Sensor 1;Sensor 2\n", ";", ","),
        {"Beschl": "m/s^2", "Kraft": "N"},
    ),
    "names of one letter below titles": ("Zeit;Kanal;Kanal\nt;A;F\n", ";", ",", {"A": "", "F": ""}),
    "places in arrays": ("time [s],gyro[0],gyro[1]\n", ",", ".", {"gyro[0]": "", "gyro[1]": ""}),
}


@pytest.mark.parametrize(("head", "delimiter", "sign", "units"), LOGGERS.values(), ids=LOGGERS.keys())
def test_heads_of_loggers(tmp_path, head, delimiter, sign, units):
    rows = "".join(f"{k / 1000:.4f}{delimiter}{k % 7}.5{delimiter}{k % 5}.25\n".replace(".", sign) for k in range(60))
    (tmp_path / "a.csv").write_text(head + rows)
    record = read_record(tmp_path / "a.csv")
    assert record.dt == pytest.approx(1e-3)
    assert dict(zip(record.output_names, record.output_units, strict=True)) == units


@pytest.mark.parametrize("when", ["first", "once", "always"])
def test_a_column_of_messages_is_left_out_and_named(tmp_path, when):
    said = {"first": (0,), "once": (40,), "always": range(60)}[when]
    rows = "".join(f"{k / 100:.2f},{'text' if k in said else ''},{k % 7}\n" for k in range(60))
    path = tmp_path / "a.csv"
    path.write_text("Time (s),App message,Thrust (N)\n" + rows)
    record = read_record(path)
    assert (record.output_names, record.dt) == (("Thrust",), pytest.approx(0.01))
    np.testing.assert_array_equal(record.outputs[:, 0], np.arange(60) % 7)
    assert describe_file(path).remarks == ("App message left out: it holds text",)


def test_what_holds_a_number_anywhere_is_no_column_of_messages(tmp_path):
    rows = "".join(f"{k / 100:.2f},{'bad' if k != 30 else 4},{k % 7}\n" for k in range(60))
    (tmp_path / "a.csv").write_text("Time (s),speed,Thrust (N)\n" + rows)
    with pytest.raises(UnreadableFileError, match=r"line 31, column .* of a\.csv holds 'bad'"):
        read_record(tmp_path / "a.csv")


@pytest.mark.parametrize("cell", ["0.125 N", "1,234.5", "1.234,50", "-3.5e-3 m/s^2", "12 %", "0x1F"])
def test_a_number_that_is_written_otherwise_is_no_message(tmp_path, cell):
    """Left out, a force that was measured would be missing, and nothing would say so."""
    rows = "".join(f"{k / 100:.2f};{cell};{k % 7}.5\n" for k in range(60))
    (tmp_path / "a.csv").write_text("Time (s);force;tip\n" + rows)
    with pytest.raises(UnreadableFileError, match="where a number is expected"):
        read_record(tmp_path / "a.csv")


def test_numbers_far_below_messages_are_not_left_out(tmp_path, monkeypatch):
    monkeypatch.setattr("okid.readers.text.TextLimits.SAMPLE_BYTES", 1000)
    rows = "".join(f"{k / 100:.2f},{'wait' if k < 300 else 4.5},{k % 7}\n" for k in range(400))
    (tmp_path / "a.csv").write_text("Time (s),height,Thrust (N)\n" + rows)
    with pytest.raises(UnreadableFileError, match=r"column 2 of a\.csv begins with text, .* '4\.5' in line 302"):
        read_record(tmp_path / "a.csv")


@pytest.mark.parametrize(("head", "row"), [("t [s],,u,y", "{},,{},1.5"), ("t [s],u,y,,", "{},{},1.5,,")])
def test_columns_without_a_name_that_hold_nothing_are_none(tmp_path, head, row):
    (tmp_path / "a.csv").write_text("\n".join([head, *(row.format(k / 100, k % 7) for k in range(60))]))
    record = read_record(tmp_path / "a.csv")
    assert record.output_names == ("u", "y")
    np.testing.assert_array_equal(record.outputs[:, 0], np.arange(60) % 7)


def test_a_date_in_a_column_of_its_own_is_no_reason_to_cut_the_rows_otherwise(tmp_path):
    rows = "".join(f"23.11.2026;10:00;{k / 1000:06.3f};{k % 7}.5\n".replace(".", ",") for k in range(60))
    (tmp_path / "a.csv").write_text("Datum;Uhrzeit;t;ax\n" + rows.replace("23,11,2026", "23.11.2026"))
    record = read_record(tmp_path / "a.csv")
    assert (record.output_names, record.dt) == (("ax",), pytest.approx(0.001))
    said = describe_file(tmp_path / "a.csv").remarks
    assert [remark for remark in said if "it holds text" in remark] == [
        "Datum left out: it holds text",
        "Uhrzeit left out: it holds text",
    ]


def test_parentheses_that_hold_no_unit_are_spoken_of_where_the_others_do(tmp_path):
    rows = "".join(f"{k / 100:.2f},{k % 7},{k % 5}\n" for k in range(60))
    (tmp_path / "a.csv").write_text("Time (s),Thrust (N),Flow (blob)\n" + rows)
    with pytest.warns(IdentificationWarning, match=r"Flow \(blob\): no unit .*'blob' is no unit that is known"):
        read_record(tmp_path / "a.csv")
    (tmp_path / "a.csv").write_text("Time (s),tip (left),tip (right)\n" + rows)
    assert read_record(tmp_path / "a.csv").output_names == ("tip (left)", "tip (right)")


def test_a_unit_behind_a_name_is_warned_of(tmp_path):
    (tmp_path / "a.csv").write_text("time [s],speed_rpm\n" + "".join(f"{k / 100:.2f},{k % 7}\n" for k in range(60)))
    with pytest.warns(IdentificationWarning, match="speed_rpm: no unit .*ends in 'rpm'"):
        read_record(tmp_path / "a.csv")


def test_a_unit_in_brackets_that_is_not_read_is_warned_of_once(tmp_path):
    rows = "".join(f"{k / 100:.2f},{k % 7},{k % 5},{k % 3}\n" for k in range(60))
    (tmp_path / "a.csv").write_text("time [s],tip [MM/S2],root [MM/S2],level [counts]\n" + rows)
    with pytest.warns(IdentificationWarning, match=r"^tip, root: 'MM/S2' is not a unit") as said:
        assert read_record(tmp_path / "a.csv").output_units == ("MM/S2", "MM/S2", "counts")
    assert len(said) == 1


@pytest.mark.parametrize(
    ("head", "names", "units"),
    [
        ("time,acc [1],acc [2]\ns,g,g", ("acc [1]", "acc [2]"), ("m/s^2", "m/s^2")),
        ("time,gyro [x],gyro [y]\ns,deg/s,deg/s", ("gyro [x]", "gyro [y]"), ("rad/s", "rad/s")),
        ("A,C,V\nt,u,y", ("u", "y"), ("", "")),
        ("N,V,A\ntime,u,y", ("u", "y"), ("", "")),
        ("s,kN,g\ntime,force,a1", ("force", "a1"), ("N", "m/s^2")),
    ],
)
def test_rows_beside_the_names_are_units_where_they_can_be(head, names, units, tmp_path):
    """Brackets in a name may hold an index, and a row over the names may be a group."""
    (tmp_path / "a.csv").write_text(head + "\n" + "".join(f"{k / 100:.2f},{k % 7},{k % 5}\n" for k in range(60)))
    record = read_record(tmp_path / "a.csv")
    assert (record.output_names, record.output_units) == (names, units)


@pytest.mark.parametrize(("name", "rate", "is_time"), [("Time [ms]", 1e3, True), ("delay [ms]", 1.33, False)])
def test_a_ramp_is_a_further_time_only_where_it_grows_as_time_does(name, rate, is_time, tmp_path):
    rows = "".join(f"{k / 100:.2f},{1 + rate * k / 100:.6f},{k % 5}\n" for k in range(60))
    (tmp_path / "a.csv").write_text(f"time [s],{name},acc\n" + rows)
    assert read_record(tmp_path / "a.csv").output_names == (("acc",) if is_time else ("delay", "acc"))


@pytest.mark.parametrize("empty", [";;", '"";"";""', " ; ; "])
def test_lines_of_delimiters_below_a_table_are_no_rows(tmp_path, empty):
    rows = "".join(f"{k / 100:.2f};{k % 7};{k % 5}\n" for k in range(60))
    (tmp_path / "a.csv").write_text("t [s];u;y\n" + rows + f"{empty}\n" * 3)
    record = read_record(tmp_path / "a.csv")
    assert (record.n_samples, record.dt) == (60, pytest.approx(0.01))
    assert not np.isnan(record.outputs).any()


@pytest.mark.parametrize(("cut", "n_empty"), [(";", 0), (";", 2), (";", 3000), (" ", 2), ("", 0)])
def test_rows_of_written_nan_are_rows(table, cut, n_empty):
    """Samples are missing there; empty cells below them are what a sheet leaves."""
    cell = "{}" + cut + "{}" if cut else "{}"
    rows = [cell.format(k % 7, k % 5) for k in range(60)] + [cell.format("NaN", "NaN")] * 3
    values = table("\n".join([cell.format("u", "y"), *rows, *[cut or " "] * n_empty]) + "\n").values
    assert np.isnan(values).all(axis=1).tolist() == [False] * 60 + [True] * 3
