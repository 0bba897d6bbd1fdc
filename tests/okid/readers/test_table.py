"""The table of a file: its time step over the whole span, on a uniform grid; names that choose its channels."""

from datetime import UTC, datetime

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from okid.errors import IdentificationWarning, InsufficientDataError, InvalidDataError, UnreadableFileError
from okid.readers import describe_file, read_record

N_SAMPLES = 200
TIME = 0.01 * np.arange(N_SAMPLES)


@pytest.fixture
def file_with_time(tmp_path):
    def write(time, header="time [s]"):
        path = tmp_path / "record.csv"
        rows = "".join(f"{float(each)!r},{index % 7}\n" for index, each in enumerate(time))
        path.write_text(f"{header},y\n{rows}")
        return path

    return write


@pytest.mark.parametrize(
    ("unit", "scale"), [("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("µs", 1e-6), ("min", 60.0), ("sec", 1.0)]
)
@pytest.mark.parametrize("brackets", ["[]", "()"])
def test_any_unit_of_time(file_with_time, unit, scale, brackets):
    record = read_record(file_with_time(5.0 + TIME, f"Time {brackets[0]}{unit}{brackets[1]}"))
    assert record.dt == pytest.approx(0.01 * scale, rel=1e-12)
    assert record.start_time == pytest.approx(5.0 * scale, rel=1e-12)


@settings(max_examples=30, deadline=None)
@given(dt=st.floats(1e-6, 1e3), decimals=st.integers(2, 6))
def test_rounded_stamps_give_the_mean_step(dt, decimals, tmp_path_factory):
    """Stamps written with few digits jitter, but the step over the span is right to a rounding of its ends."""
    quantum = dt * 10.0**-decimals * 5
    time = np.round(dt * np.arange(N_SAMPLES) / quantum) * quantum
    path = tmp_path_factory.mktemp("time") / "a.csv"
    path.write_text("t [s],y\n" + "".join(f"{each!r},1.0\n" for each in time.tolist()))
    assert abs(read_record(path).dt - dt) <= quantum / (N_SAMPLES - 1) * 1.0001


@pytest.mark.parametrize(("off", "fails"), [(0.09, False), (-0.09, False), (0.12, True), (-0.4, True)])
def test_samples_off_the_grid(file_with_time, off, fails):
    time = TIME.copy()
    time[70] += off * 0.01
    path = file_with_time(time)
    if fails:
        with pytest.raises(InvalidDataError, match=rf"row 71 of 200 lies {abs(off):.3g} steps off .*at most 0\.1"):
            read_record(path)
    else:
        assert read_record(path).dt == pytest.approx(0.01)


def test_lost_samples(file_with_time):
    with pytest.raises(InvalidDataError, match=r"not uniform: .*put the lost rows back"):
        read_record(file_with_time(np.delete(TIME, [100, 101])))


@pytest.mark.parametrize(
    ("time", "message"),
    [
        (np.r_[TIME[:50], TIME[49:]], r"must increase, but goes from 0\.49 s to 0\.49 s at row 51"),
        (np.r_[TIME[:50], TIME[:50]], r"must increase, but goes from 0\.49 s to 0 s at row 51 .*one file a record"),
        (TIME[::-1], r"must increase, .* at row 2"),
        (
            1.7e9 + np.round(TIME / 50),
            r"from 1700000000 s to 1700000000 s at row 2 .*too few digits: .*\(dt\)",
        ),
        (np.where(np.arange(N_SAMPLES) == 3, np.nan, TIME), r"missing in 1 of 200 rows, the first of them row 4"),
    ],
)
def test_stamps_that_are_no_time(file_with_time, time, message):
    with pytest.raises(InvalidDataError, match=message):
        read_record(file_with_time(time))


def test_one_sample_is_no_time_axis(file_with_time):
    with pytest.raises(InsufficientDataError, match="at least 2"):
        read_record(file_with_time([0.0]))


def test_a_given_step_wins_and_a_contradiction_is_said(file_with_time):
    path = file_with_time(TIME)
    assert read_record(path, dt=0.010005).dt == 0.010005
    with pytest.warns(IdentificationWarning, match=r"dt = 0\.0102 s was given and is used, but .* 2\.00% off"):
        assert read_record(path, dt=0.0102).dt == 0.0102
    assert read_record(file_with_time(np.delete(TIME, [100, 101])), dt=0.02).dt == 0.02
    for dt in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(InvalidDataError, match="positive time step"):
            read_record(path, dt=dt)


@pytest.mark.parametrize("dt", [1e-320, 1e-13, 1e10, 1e300])
def test_a_step_that_no_experiment_has(file_with_time, dt):
    with pytest.raises(InvalidDataError, match=r"between 1e-12 and 1e\+09 s"):
        read_record(file_with_time(TIME, "position"), dt=dt)


def test_no_time_and_no_step(file_with_time):
    path = file_with_time(TIME, "position")
    with pytest.raises(InvalidDataError, match=r"no time column \(its columns are position, y\).*--dt"):
        read_record(path)
    record = read_record(path, dt=0.5)
    assert (record.dt, record.start_time, record.output_names) == (0.5, 0.0, ("position", "y"))


def test_a_time_column_in_another_unit(file_with_time):
    with pytest.raises(InvalidDataError, match="is in 'kg', which is no unit of time"):
        read_record(file_with_time(TIME, "time [kg]"))


@pytest.mark.parametrize(
    "header",
    [
        *(
            "t",
            "Time",
            "TIME [s]",
            "TIME [S]",
            "Zeit",
            "Zeit [s]",
            "Zeit in s",
            "Zeitstempel",
            "Temps",
            "Temps (s)",
            "sec",
            "Seconds",
        ),
        *("X_Value", "x value", "time_s", "t_s", "Time, s", "Time / s", "Relative Time", "Elapsed Time (s)", "Tiempo"),
        *("Time (seconds)", "Datetime", "Date Time", "Elapsed", "Czas", "Время", "時間"),
    ],
)
def test_time_columns_of_loggers(file_with_time, header):
    header = f'"{header}"' if "," in header else header
    assert read_record(file_with_time(TIME, header)).dt == pytest.approx(0.01, rel=1e-12)


@pytest.mark.parametrize("further", ["Time [ms]", "Zeit [ms]", "Timestamp", "Elapsed [h]", "millis"])
def test_a_further_time_is_no_channel(tmp_path, further):
    """It would be an output that no structure makes, or an input that drives it."""
    rows = "".join(f"{each:.2f},{1000 * each:.0f},{k % 7}\n" for k, each in enumerate(TIME))
    (tmp_path / "a.csv").write_text(f"Time [s],{further},y\n{rows}")
    assert read_record(tmp_path / "a.csv").output_names == ("y",)
    name = further.partition(" [")[0] if not further.startswith("Time [") else further
    said = describe_file(tmp_path / "a.csv").remarks
    assert f"{name} left out: it gives the time of the record once more" in said
    with pytest.raises(InvalidDataError, match="is a time axis, not a channel"):
        read_record(tmp_path / "a.csv", inputs=name)
    rows = "".join(f"{each:.2f},{k * k % 7},{k % 7}\n" for k, each in enumerate(TIME))
    (tmp_path / "a.csv").write_text(f"Time [s],delay [ms],y\n{rows}")
    assert read_record(tmp_path / "a.csv").output_names == ("delay", "y")


@pytest.mark.parametrize("header", ["time_ms", "Time (ms)", "Zeit [ms]", "t_ms", "Zeit in ms", "Temps ms"])
def test_time_columns_in_milliseconds(file_with_time, header):
    assert read_record(file_with_time(TIME, header)).dt == pytest.approx(1e-5, rel=1e-12)


@pytest.mark.parametrize("head", ["Timestamp,tip", "Datum,tip", "DAQ,tip", "Uhrzeit,tip\n[hh:mm:ss],[g]"])
@pytest.mark.parametrize(
    "stamp",
    [
        "2026-05-04T23:59:{}",
        "2026-05-04 23:59:{}Z",
        '"2026-05-04T23:59:{}+02:00"',
        "04.05.2026 23:59:{}",
        "2026/05/04 23:59:{}",
        "23:59:{}",
    ],
)
def test_stamps_of_a_clock(tmp_path, head, stamp):
    path = tmp_path / "clock.csv"
    rows = [f"{stamp.format(f'{t:06.3f}')},{k}" for k, t in enumerate(np.arange(100) / 128.0)]
    path.write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    record = read_record(path)
    assert record.dt == pytest.approx(1 / 128, rel=1e-3)
    assert record.outputs[:, 0].tolist() == pytest.approx(np.arange(100.0) * (9.80665 if "[g]" in head else 1.0))


def clock_file(tmp_path, header, stamp, cut):
    """A second and a half around a quarter past twelve, 4 May 2026, then the last column is the row's number."""
    rows = []
    for k in range(192):
        t = k / 128.0
        point = f"{t % 1.0:.4f}"[1:].replace(".", "," if cut != "," else ".")
        rows.append(f"{stamp}{cut}{k}".replace("SS", f"{41 + int(t):02d}").replace(".f", point))
    path = tmp_path / "clock.csv"
    path.write_text("\n".join([*([header] if header else []), *rows]) + "\n", encoding="utf-8")
    return path


NOON = datetime(2026, 5, 4, 12, 15, 41, tzinfo=UTC).timestamp()
"""4 May 2026, 12:15:41 UTC [s since 1970]."""


@pytest.mark.parametrize(
    ("header", "stamp", "cut", "start"),
    [
        ("Date,Time,tip", "2026-05-04,00:15:SS.f", ",", NOON - 43200),
        ("Date,Time,tip", "2026-05-04,12:15:SS.f", ",", NOON),
        ("Date,Time,tip", "05/14/2026,12:15:SS.f PM", ",", NOON + 10 * 86400),
        ("Date,Time,tip", "14/05/2026,12:15:SS.f", ",", NOON + 10 * 86400),
        ("Date,Time,tip", "05/04/2026,12:15:SS.f", ",", 44141.0),  # of April or of May: as without a date
        ("Datum;Uhrzeit;tip", "04.05.2026;12:15:SS.f", ";", NOON),
        ("Datum;Zeit;tip", "04.05.26;12:15:SS.f", ";", NOON),
        ("Datum;Zeit;tip", "26.05.04;12:15:SS.f", ";", 44141.0),  # of 2026 or of 2004: as without a date
        ("Datum;Zeit;tip", "26.05.2026;12:15:SS.f", ";", NOON + 22 * 86400),
        ("Datum;Zeit;tip\n[TT.MM.JJJJ];[hh:mm:ss];[]", "04.05.2026;12:15:SS.f", ";", NOON),
        ("Datum;Zeit;tip\nTT.MM.JJJJ;hh:mm:ss;mm", "04.05.2026;12:15:SS.f", ";", NOON),
        ("Datum;Zeit;tip", "04.05.2026 00:00:00;12:15:SS.f", ";", NOON),
        ("Heure;Date;tip", "12:15:SS.f;04/05/2026", ";", 44141.0),
        ("Date;Heure;tip", "4 mai 2026;12:15:SS.f", ";", NOON),
        ("Date;Heure;tip", "4 août 2026;12:15:SS.f", ";", NOON + 92 * 86400),
        ("Datum\tZeit\ttip", "4. März 2026\t12:15:SS.f", "\t", NOON - 61 * 86400),
        ("Date Time tip", "2026-05-04 12:15:SS.f", " ", NOON),
        ("# Stamp tip", "2026-05-04T12:15:SS.f", " ", NOON),
        ("Time,tip", "04-May-2026 12:15:SS.f", ",", NOON),
        ("index,Timestamp,tip", "7,2026-05-04 12:15:SS.fZ", ",", NOON),
        ('"Date","Time","tip"', '"2026-05-04","12:15:SS.f"', ",", NOON),
        ("", "2026-05-04 12:15:SS.f", ",", NOON),
        ("", "2026-05-04,12:15:SS.f", ",", NOON),
        ("Time,tip", "5/14/2026 12:15:SS.f PM", ",", NOON + 10 * 86400),
        ("Time,tip", "15:SS.f", ",", 941.0),
        ("Zeit;tip", "15:SS.f", ";", 941.0),
        ("Time;tip", "12:15:SS.f", ";", 44141.0),
    ],
)
def test_dates_and_clocks_of_loggers(tmp_path, header, stamp, cut, start):
    path = clock_file(tmp_path, header, stamp, cut)
    record = read_record(path, outputs="tip" if header else None)
    assert record.dt == pytest.approx(1 / 128, rel=1e-6)
    assert record.start_time == pytest.approx(start, abs=1e-6)
    scale = 1e-3 if header.endswith("mm") else 1.0
    assert record.outputs[:, 0].tolist() == pytest.approx(scale * np.arange(192.0))


def test_milliseconds_behind_a_colon(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("Time,x\n" + "".join(f"12:00:{k // 100:02d}:{10 * (k % 100):03d},{k % 7}\n" for k in range(300)))
    assert read_record(path).dt == pytest.approx(0.01, rel=1e-9)


@pytest.mark.parametrize(
    ("stamp", "turns"), [("{:02d}:{:02d}:{:04.1f}", 86400), ("{1:02d}:{2:04.1f}", 3600), ("{1}:{2:04.1f}", 3600)]
)
def test_a_clock_goes_round_more_than_once(tmp_path, stamp, turns):
    """A spreadsheet leaves minutes and seconds of a clock; each hour, or each midnight, it begins again."""
    time = 0.25 * turns + turns / 50 * np.arange(120)
    rows = [f"{stamp.format(int(t) // 3600 % 24, int(t) // 60 % 60, t % 60)},{k}" for k, t in enumerate(time)]
    (tmp_path / "a.csv").write_text("Time,x\n" + "\n".join(rows) + "\n")
    assert read_record(tmp_path / "a.csv").dt == pytest.approx(turns / 50, rel=1e-9)


def test_a_date_that_only_its_neighbour_tells(tmp_path):
    rows = [f"{'05/04' if k < 4 else '05/05'}/2026,{(23, 59, 56 + k) if k < 4 else (0, 0, k - 4)}" for k in range(9)]
    rows = [row.replace("(", "").replace(")", "").replace(", ", ":") for row in rows]
    (tmp_path / "a.csv").write_text("Date,Time,x\n" + "".join(f"{_two(row)},{k}\n" for k, row in enumerate(rows)))
    record = read_record(tmp_path / "a.csv")
    assert (record.dt, record.start_time) == (1.0, NOON - 41 + 11 * 3600 + 44 * 60 + 56)


def _two(row):
    day, clock = row.split(",")
    return f"{day}," + ":".join(f"{int(each):02d}" for each in clock.split(":"))


@pytest.mark.parametrize(
    ("rate", "n_samples", "digits", "within"), [(78.0, 7800, 0, 1.4e-4), (78.0, 46800, 0, 3e-5), (128.0, 1000, 3, 1e-5)]
)
def test_rounded_times_tell_the_step_between_two_bounds(tmp_path, rate, n_samples, digits, within):
    """Many rows under one stamp of whole seconds: the edges tell the step, and how well they do is said."""
    time = np.floor((0.3417 + np.arange(n_samples) / rate) * 10**digits) / 10**digits
    rows = "".join(f"2026-05-04 12:{int(t) // 60:02d}:{t % 60:0{digits + 3 if digits else 2}.{digits}f},{k % 7}\n"
                   for k, t in enumerate(time))  # fmt: skip
    path = tmp_path / "stamps.csv"
    path.write_text("Timestamp,x\n" + rows)
    said = describe_file(path)
    assert abs(said.dt * rate - 1.0) <= min(within, 1.001 * said.dt_within * rate)
    assert abs(said.dt * rate - 1.0) < 1e-6
    assert any("times are rounded" in remark for remark in said.remarks) == (within > 1e-5)
    if within > 1e-4:
        with pytest.warns(IdentificationWarning, match=r"rounded.*known to 0\.01% only; .*\(--dt\)"):
            read_record(path)
    assert read_record(path, dt=1.0 / rate).dt == 1.0 / rate


def test_a_clock_past_midnight_and_one_with_a_comma(tmp_path):
    path = tmp_path / "night.csv"
    path.write_text("t;x\n2026-12-31 23:59:59,5;1,5\n2027-01-01 00:00:00,0;2\n2027-01-01 00:00:00,5;3\n")
    assert read_record(path).dt == 0.5
    path.write_text("t;x\n23:59:59.5;1,5\n24:00:00.0;2,5\n24:00:00.5;3,5\n")
    assert read_record(path).outputs.ravel().tolist() == [1.5, 2.5, 3.5]
    path.write_text("t,x,y\n00:00:01,5,1\n00:00:02,6,1\n00:00:03,7,1\n00:00:04,8,1\n")
    assert read_record(path).dt == 1.0  # between commas, a comma is no decimal sign


def test_a_clock_without_a_date_past_midnight(tmp_path):
    path = tmp_path / "night.csv"
    path.write_text("Uhrzeit,x\n23:59:59.0,1\n23:59:59.5,2\n00:00:00.0,3\n00:00:00.5,4\n")
    assert read_record(path).dt == 0.5


def test_a_change_of_the_offset_to_utc_is_none_of_the_time(tmp_path):
    """At the end of summer time a clock goes back one hour, and its offset with it."""
    path = tmp_path / "autumn.csv"
    path.write_text(
        "time,x\n2026-10-25T02:59:59.0+02:00,1\n2026-10-25T02:59:59.5+02:00,2\n"
        "2026-10-25T02:00:00.0+0100,3\n2026-10-25T02:00:00.5+01:00,4\n"
    )
    assert read_record(path).dt == 0.5
    path.write_text(
        "time,x\n" + "".join(f"2026-10-25T02:00:0{k}{'+01:00' if k < 2 else '-00:30'},1\n" for k in range(4))
    )
    with pytest.raises(InvalidDataError, match="not uniform"):
        read_record(path)


def test_a_stamp_that_is_no_date(tmp_path):
    path = tmp_path / "clock.csv"
    path.write_text("t,x\n2026-02-28 00:00:00,1\n2026-02-31 00:00:01,2\n")
    with pytest.raises(UnreadableFileError, match="no date"):
        read_record(path)


@pytest.mark.parametrize(
    ("header", "scale"),
    [
        *(
            ("Messzeit [s]", 1.0),
            ("Temps relatif [ms]", 1e-3),
            ("Zeit  1 - Standardmessrate [s]", 1.0),
            ("millis", 1e-3),
        ),
        *(("micros", 1e-6), ("uptime_ms", 1e-3), ("rel. time [s]", 1.0), ("Abtastzeit", 1.0), ("ramp [s]", 1.0)),
    ],
)
def test_a_ramp_that_speaks_of_time_is_the_time(file_with_time, header, scale):
    """Also where the step is given: the ramp must not become an output."""
    path = file_with_time(TIME, header)
    assert read_record(path).dt == pytest.approx(0.01 * scale)
    assert read_record(path, dt=0.01 * scale).output_names == ("y",)


@pytest.mark.parametrize(
    ("header", "first", "step", "seconds"),
    [
        ("timestamp", 1_600_000_000, 0.01, 0.01),  # Unix time, and its thousandths, millionths, billionths
        ("timestamp", 1_600_000_000_000, 10, 0.01),
        ("t", 1_600_000_000_000_000, 10_000, 0.01),
        ("%time", 1_600_000_000_000_000_000, 10_000_000, 0.01),
        ("Date/Time", 46349.4166667, 0.01 / 86400, 0.01),  # days of a spreadsheet
        ("Datum", 46349.0, 600 / 86400, 600.0),
        ("Time", 46349.0, 0.01 / 86400, 0.01),
        ("Time", 740000.0, 0.1 / 86400, 0.1),  # days since the year 0
        ("Time", 46349.0, 0.01, 0.01),  # late in a day
        ("timeMs", 0, 10, 0.01),
        ("TimeUS", 112_233_445, 10_000, 0.01),
    ],
)
def test_stamps_that_give_a_date_tell_their_unit(tmp_path, header, first, step, seconds):
    rows = "".join(f"{first + step * k!r},{k % 7}\n" for k in range(N_SAMPLES))
    (tmp_path / "a.csv").write_text(f"{header},y\n{rows}")
    record = read_record(tmp_path / "a.csv")
    assert record.dt == pytest.approx(seconds, rel=1e-3)
    since = {46349: 25_569, 740_000: 719_529}.get(int(first), 0) if seconds != step else 0
    assert record.start_time == pytest.approx((first - since) * seconds / step, abs=1e-3)


@pytest.mark.parametrize("step", [1, 4000])
def test_whole_numbers_without_a_unit_are_taken_for_seconds_and_it_is_said(tmp_path, step):
    rows = "".join(f"{1000 + step * k},{k % 7}\n" for k in range(N_SAMPLES))
    (tmp_path / "a.csv").write_text(f"timestamp,y\n{rows}")
    with pytest.warns(IdentificationWarning, match=r"'timestamp' of a.csv has no unit .* taken for seconds.*--dt"):
        assert read_record(tmp_path / "a.csv").dt == step
    assert read_record(tmp_path / "a.csv", dt=float(step)).dt == step
    (tmp_path / "a.csv").write_text(f"seconds,y\n{rows}")
    assert read_record(tmp_path / "a.csv").dt == step


@pytest.mark.parametrize(("thousand", "unit"), [(1e3, "milliseconds"), (1e6, "microseconds")])
def test_stamps_in_seconds_that_are_dates_of_today_in_less_are_named(tmp_path, thousand, unit):
    """A day of 2026 in milliseconds, under a header that says seconds, would be a day of the year 57 000."""
    rows = "".join(f"{1.79e9 * thousand + k:.0f},{k % 7}\n" for k in range(N_SAMPLES))
    (tmp_path / "a.csv").write_text(f"timestamp [s],y\n{rows}")
    with pytest.warns(IdentificationWarning, match=f"is in s but as seconds.* as {unit} since 1970 they do"):
        assert read_record(tmp_path / "a.csv").dt == 1.0
    (tmp_path / "a.csv").write_text("timestamp [s],y\n" + "".join(f"{k},{k % 7}\n" for k in range(N_SAMPLES)))
    assert read_record(tmp_path / "a.csv").dt == 1.0  # a slow logger is believed


@pytest.mark.parametrize("header", ["loop time", "delay [ms]"])
def test_what_is_no_ramp_is_a_channel(file_with_time, header):
    values = np.random.default_rng(1).standard_normal(N_SAMPLES)
    assert read_record(file_with_time(values, header), dt=0.01).n_outputs == 2


@pytest.mark.parametrize("header", ["T", "tip_ms", "times", "dt", "x", "timer_h"])
def test_columns_that_are_no_time(file_with_time, header):
    with pytest.raises(InvalidDataError, match="no time column"):
        read_record(file_with_time(TIME, header))


@pytest.mark.parametrize(("rate", "digits"), [(1024.0, 3), (48.0, 2), (2000.0 / 3.0, 3), (5000.0, 4), (3333.0, 3)])
def test_stamps_rounded_to_their_digits(file_with_time, rate, digits):
    path = file_with_time(np.round(np.arange(4000) / rate, digits))
    assert read_record(path).dt == pytest.approx(1.0 / rate, rel=1e-4)


@pytest.mark.parametrize("lost", [[40], [40, 90], [3, 4, 5, 120], [10, 30, 50, 52, 130]])
def test_lost_samples_are_no_rounding(file_with_time, lost):
    with pytest.raises(InvalidDataError, match="not uniform"):
        read_record(file_with_time(np.round(np.delete(TIME, lost), 2)))


@pytest.mark.parametrize("empty", ["1.5", ""])
def test_rows_that_all_stand_twice_are_refused(tmp_path, empty):
    """Rounded times would make them a record of half the step."""
    path = tmp_path / "record.csv"
    rows = [f"{each:.2f},{empty if k % 5 == 0 else 7 * k % 13}\n" for k, each in enumerate(TIME)]
    path.write_text("time [s],y\n" + "".join(row * 2 for row in rows))
    for dt in (None, 0.01):
        with pytest.raises(InvalidDataError, match=r"200 of the 400 rows of record\.csv repeat the row before them"):
            read_record(path, dt=dt)
    path.write_text("time [s],y\n" + "".join(f"{each:.2f},{k}\n" for k, each in enumerate(0.5 * TIME)))
    assert read_record(path).dt == pytest.approx(0.005, rel=1e-3)
    path.write_text("time [s],y\n" + "".join([*rows[:1], *rows]))
    with pytest.raises(InvalidDataError, match="must increase"):
        read_record(path)


HEADER = "sample,time [s],shaker [kN],tip [mm],root [mm],mid (left)"
VALUES = np.column_stack([np.arange(30), 0.1 * np.arange(30), np.random.default_rng(3).standard_normal((30, 4))])


@pytest.fixture
def path(tmp_path):
    np.savetxt(tmp_path / "run.csv", VALUES, delimiter=",", header=HEADER, comments="", fmt="%.17g")
    return tmp_path / "run.csv"


@pytest.mark.parametrize(
    ("inputs", "outputs", "expected"),
    [
        (None, None, ((), ("shaker", "tip", "root", "mid (left)"))),
        (["shaker"], None, (("shaker",), ("tip", "root", "mid (left)"))),
        ("shaker", None, (("shaker",), ("tip", "root", "mid (left)"))),
        ([], None, ((), ("shaker", "tip", "root", "mid (left)"))),
        (None, ["root", "tip"], ((), ("root", "tip"))),
        (["root", "shaker"], ["mid (left)"], (("root", "shaker"), ("mid (left)",))),
        (["shaker [kN]"], ["tip [mm]"], (("shaker",), ("tip",))),
    ],
)
def test_choice(path, inputs, outputs, expected):
    record = read_record(path, inputs=inputs, outputs=outputs)
    assert (record.input_names, record.output_names) == expected
    scale = {"shaker": 1e3, "tip": 1e-3, "root": 1e-3, "mid (left)": 1.0}
    column = {"shaker": 2, "tip": 3, "root": 4, "mid (left)": 5}
    for name, values in zip(record.output_names, record.outputs.T, strict=True):
        np.testing.assert_allclose(values, scale[name] * VALUES[:, column[name]], rtol=1e-14)


@pytest.mark.parametrize(
    ("inputs", "outputs", "message"),
    [
        (
            "shakr",
            None,
            r"no channel 'shakr' in run\.csv; did you mean 'shaker'\? Its channels are shaker, tip, root, mid",
        ),
        ("Tip", None, r"did you mean 'tip'\?"),
        ("xyz", None, r"no channel 'xyz' in run\.csv; its channels are shaker"),
        (None, ["tip", "nothing"], r"no channel 'nothing'"),
        ("time", None, r"'time' of run\.csv is a time axis"),
        (None, "sample", r"'sample' of run\.csv is a counter"),
        ("tip", ["tip", "root"], r"'tip' cannot be both input and output"),
        (["tip", "tip"], None, r"'tip' is named more than once"),
        (["shaker", "tip", "root", "mid (left)"], None, r"no output is left in run\.csv"),
        (["shaker"], [], r"no output is left"),
    ],
)
def test_wrong_choice(path, inputs, outputs, message):
    with pytest.raises(InvalidDataError, match=message):
        read_record(path, inputs=inputs, outputs=outputs)


def test_input_hold_is_band_limited_unless_said(path):
    assert read_record(path, inputs="shaker").input_hold == "band_limited"
    assert read_record(path, inputs="shaker", input_hold="zero_order").input_hold == "zero_order"
    with pytest.raises(InvalidDataError, match=r"run\.csv: input_hold must be one of"):
        read_record(path, input_hold="zoh")


def test_misspelt_options_are_refused(path):
    with pytest.raises(TypeError):
        read_record(path, input="shaker")
    with pytest.raises(TypeError):
        read_record(path, ["shaker"])


def test_a_time_that_nobody_called_so_is_no_silent_channel(tmp_path):
    """A table without a header, its time step given by hand: the first column was an output."""
    rows = "".join(f"{each:.2f},{k % 7}\n" for k, each in enumerate(TIME))
    (tmp_path / "a.csv").write_text(rows)
    with pytest.warns(IdentificationWarning, match=r"'column_0' of a\.csv grows by the time step .*--outputs"):
        read_record(tmp_path / "a.csv", dt=0.01)
    assert read_record(tmp_path / "a.csv", dt=0.01, outputs="column_0").n_outputs == 1
    assert read_record(tmp_path / "a.csv", dt=0.02).n_outputs == 2


def test_whole_times_of_a_product_of_floats_are_whole(tmp_path):
    np.savez(tmp_path / "a.npz", t=1000.0 * TIME, y=np.sin(TIME))
    assert not np.array_equal(1000.0 * TIME, np.rint(1000.0 * TIME))
    with pytest.warns(IdentificationWarning, match="taken for seconds"):
        read_record(tmp_path / "a.npz")
