"""The recording of modes through time, read back and compared with the table it was made from, number by number."""

import numpy as np
import pyarrow as pa
import pytest
from bridge_year import DAY, HOUR, as_table, bridge_year

import modal
from modal.recording.series import DiskBudget
from modal.tracking.page import alarm_text, moment_text, write_tracks
from okid.errors import InvalidDataError

N_RECORDS = 960  # the change at half of it begins a day, as an alarm does


def year_of(seed, *, n_records=N_RECORDS, n_modes=4):
    """A bridge that feels its temperature at once and in proportion, which forty days tell."""
    return bridge_year(
        np.random.default_rng(seed),
        n_records=n_records,
        loss=0.04,
        change_at=0.5,
        error=2e-3,
        sensor=0.02,
        slow=0.0,
        curved=0.0,
        n_modes=n_modes,
    )


def temperature_of(year, table):
    """Of the records that the table names."""
    return year.temperature[np.unique(np.round(table.column("start_time").to_numpy() / HOUR).astype(int))]


def moved(table, add, *, scale=1.0):
    """The table with other start times."""
    times = add + scale * table.column("start_time").to_numpy()
    return table.set_column(table.column_names.index("start_time"), "start_time", pa.array(times))


@pytest.fixture(scope="module")
def tracks():
    """Forty days, every hour; the last mode is seen from the tenth day on, the first until then."""
    year = year_of(31)
    late = year.columns["start_time"] >= 10 * DAY
    kept = ~(((year.truth == 3) & ~late) | ((year.truth == 0) & late))
    table = as_table(year).filter(pa.array(kept))
    return modal.track(table, causes={"temperature": temperature_of(year, table)})


@pytest.fixture(scope="module")
def stored(tracks, tmp_path_factory, read):
    return read(write_tracks(tracks, tmp_path_factory.mktemp("tracks")).recording)


def rows_of(tracks, number):
    """Of the table of one mode, by time."""
    rows = tracks.modes.filter(pa.array(tracks.modes.column("track").to_numpy() == number)).sort_by("start_time")
    return {name: rows.column(name).to_numpy() for name in rows.column_names if name != "shape"}


def strokes(stored, path):
    """Times, and the two ends of every upright line."""
    times, values = stored.series(path)
    assert np.isnan(values[2::3]).all()
    assert (times[::3] == times[1::3]).all()
    return times[::3], values[::3], values[1::3]


def test_every_mode_in_every_record_is_stored_with_its_interval(tracks, stored):
    assert len(tracks.tracks) == 4
    for one in tracks.tracks:
        rows = rows_of(tracks, one.number)
        for path, name, unit in (("frequency", "frequency", 1.0), ("damping", "damping_ratio", 100.0)):
            times, values = stored.series(f"/{path}/{one.number}/1_found")
            np.testing.assert_allclose(times, rows["start_time"])
            np.testing.assert_allclose(values, unit * rows[name], rtol=1e-14)
            times, low, high = strokes(stored, f"/{path}/{one.number}/0_interval")
            np.testing.assert_allclose(times, rows["start_time"])
            half = 1.96 * rows[f"{name}_std"]
            np.testing.assert_allclose(low, unit * np.maximum(rows[name] - half, 0.0), rtol=1e-12)
            np.testing.assert_allclose(high, unit * (rows[name] + half), rtol=1e-12)
        times, values = stored.series(f"/all/frequency/{one.number}")
        np.testing.assert_allclose(values, rows["frequency"], rtol=1e-14)


def test_what_causes_and_levels_explain_errs_as_much_as_the_records_do(tracks, stored):
    """Also after the change: the deviations of the table are the truth that the frequencies were made with."""
    for one in tracks.tracks:
        rows = rows_of(tracks, one.number)
        _, explained = stored.series(f"/frequency/{one.number}/2_explained")
        z = (rows["frequency"] - explained) / rows["frequency_std"]
        for part in np.array_split(z, 4):
            chance = 4.5 / np.sqrt(part.size)
            assert abs(part.mean()) < chance + 0.1
            assert abs(np.sqrt(np.mean(part**2)) - 1.0) < chance / np.sqrt(2) + 0.1


def test_changes_are_marks_with_their_sentences_in_a_log(tracks, stored):
    (alarm,) = tracks.alarms
    assert alarm.since == pytest.approx(HOUR * N_RECORDS / 2, abs=DAY)
    for path in ("all/frequency", "all/left", "frequency/2", "damping/2"):
        name = "2_changes" if path.startswith("all") else "3_changes"
        times, low, high = strokes(stored, f"/{path}/{name}")
        np.testing.assert_array_equal(times, [alarm.since])
        assert low < high
    (row,) = stored.rows("/changes", "changes_row").values()
    assert (row["since"], row["seen"], row["p_value"]) == ([alarm.since], [alarm.time], [alarm.p_value])
    shifts = stored.table("/shifts", "shifts_row")
    known = np.flatnonzero(np.isfinite(alarm.shifts))
    assert (shifts["change"], shifts["track"]) == ([0] * known.size, known.tolist())
    np.testing.assert_array_equal(shifts["shift"], alarm.shifts[known])
    np.testing.assert_array_equal(shifts["shift_std"], alarm.shifts_std[known])
    log = stored.rows("/log", "time")
    assert list(log) == sorted(log)
    said = [(row["TextLog:text"][0], row["TextLog:level"][0]) for row in log.values()]
    assert (alarm_text(0, tracks), "WARN") in said
    assert alarm.reason in alarm_text(0, tracks)
    text = stored.static("/words", "TextDocument:text")[0]
    assert "4 modes followed; 1 change beyond chance" in text
    assert "temperature" in text


def test_births_and_deaths_are_marks_and_words(tracks, stored):
    first, *_, last = sorted(tracks.tracks, key=lambda one: (one.died is None, one.born is not None))
    assert (first.born, last.died) == (None, None)
    said = [row["TextLog:text"][0] for row in stored.rows("/log", "time").values()]
    assert len(said) == 1 + sum(one.born is not None or one.died is not None for one in tracks.tracks) == 3
    for one, time, word in ((first, first.died, "last seen"), (last, last.born, "first seen")):
        assert any(f"track {one.number} (" in text and f"{word} {moment_text(time, tracks)}" in text for text in said)
        times, values = stored.series(f"/frequency/{one.number}/4_first_or_last")
        rows = rows_of(tracks, one.number)
        np.testing.assert_array_equal(times, [time])
        np.testing.assert_allclose(values, rows["frequency"][rows["start_time"] == time], rtol=1e-14)


def test_levels_are_what_the_alarms_say(tracks, stored):
    """Those of the picture on the page: none before the change, the shift in percent of ln f after it."""
    (alarm,) = tracks.alarms
    for one in tracks.tracks:
        if one.times[-1] < alarm.since:
            continue
        times, levels = stored.series(f"/all/left/1_levels/{one.number}")
        after = times >= alarm.since
        assert (levels[~after] == 0.0).all()
        np.testing.assert_allclose(levels[after], 100 * np.log1p(alarm.shifts[one.number]), rtol=1e-12)


def test_causes_and_the_table_of_modes_are_stored(tracks, stored):
    _, values = stored.series("/causes/temperature")
    np.testing.assert_array_equal(values, temperature_of(year_of(31), tracks.modes))
    table = stored.table("/modes", "modes_row")
    assert table["track"] == [0, 1, 2, 3]
    assert table["n_found"] == [one.frequency.size for one in tracks.tracks]
    np.testing.assert_array_equal(table["frequency_median"], [np.median(one.frequency) for one in tracks.tracks])
    np.testing.assert_array_equal(table["explained"], [one.explained for one in tracks.tracks])


@pytest.mark.parametrize(
    ("add", "scale", "kind"),
    [
        (1.7e9, 1.0, "datetime64[s]"),
        (5e8, 1.0, "timedelta64[s]"),
        (0.0, 0.0, "number"),
        (0.0, 1e8, "number"),  # farther apart than Rerun's 292 years
    ],
)
def test_the_timeline_is_that_of_the_records(add, scale, kind, tmp_path, read):
    """Dates, time since the first record, or numbers where the records have no time that can be shown."""
    table = moved(as_table(year_of(7, n_records=60)), add, scale=scale)
    tracks = modal.track(table)
    stored = read(write_tracks(tracks, tmp_path).recording)
    timeline = "record" if kind == "number" else "time"
    (batch,) = stored.batches("/all/frequency/0", static=False)
    index = batch.column(timeline)
    seen = sorted({int(name.removeprefix("hour_")) for name in table.column("record").to_pylist()})
    own = rows_of(tracks, 0)["record"]
    numbers = [seen.index(int(name.removeprefix("hour_"))) for name in own]
    if kind == "number":
        assert moment_text(float(tracks.times[-1]), tracks).startswith("day" if scale else "record")
        assert index.to_pylist() == [1 + number for number in numbers]
        return
    found = index.to_numpy(zero_copy_only=False).astype(kind).astype(float)
    began = add if kind.startswith("date") else 0.0
    np.testing.assert_array_equal(found, began + HOUR * (np.array(seen)[numbers] - seen[0]))


def test_a_table_of_frequencies_alone_and_an_empty_one_have_their_recording(tmp_path, read):
    """Without deviations and damping there are no intervals and no page of damping; hostile names do no harm."""
    year = year_of(5, n_records=60)
    table = as_table(year).select(["record", "start_time", "frequency", "verdict", "shape"])
    names = ("", "a/b", "<script>", "\N{ARABIC LETTER ALEF}" * 300)
    tracks = modal.track(table, causes=dict.fromkeys(names, year.causes["temperature"]))
    paths = read(write_tracks(tracks, tmp_path).recording).entities("Scalars:scalars")
    assert not [path for path in paths if "interval" in path or path.startswith("/damping")]
    assert len([path for path in paths if path.startswith("/causes/")]) == len(names)
    nothing = modal.track(table.slice(0, 0))
    stored = read(write_tracks(nothing, tmp_path).recording)
    assert stored.entities("Scalars:scalars") == []
    assert "0 modes followed" in stored.static("/words", "TextDocument:text")[0]


def test_the_same_tracks_give_the_same_recording_in_place_of_the_old_one(tracks, tmp_path, exit_of):
    written = []
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "tracks.rrd").write_text("an old one")
        written.append(write_tracks(tracks, tmp_path / name).recording)
    assert exit_of("rrd", "compare", "--unordered", *written) == 0


def test_what_fails_on_the_way_leaves_the_old_file_and_no_part(tracks, tmp_path, monkeypatch):
    old = tmp_path / "tracks.rrd"
    old.write_text("an old one")
    write = type(old).write_bytes

    def full(path, data):
        if ".rrd." in path.name:
            write(path, data[: len(data) // 2])
            raise OSError(28, "No space left on device")
        return write(path, data)

    monkeypatch.setattr(type(old), "write_bytes", full)
    with pytest.raises(InvalidDataError, match=r"tracks\.rrd' cannot be written \(No space left on device\)"):
        write_tracks(tracks, tmp_path)
    assert old.read_text() == "an old one"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["tracks.html", "tracks.parquet", "tracks.rrd"]


def test_many_records_stay_within_the_budget_and_keep_their_extremes(tracks, tmp_path, monkeypatch, read):
    """Where there is less room the smallest and the largest of each stretch are kept, and it is said."""
    whole = write_tracks(tracks, tmp_path).recording.stat().st_size
    rows = DiskBudget.BYTES_PER_ROW + DiskBudget.BYTES_PER_VALUE
    assert whole < 1.3 * rows * 12 * sum(one.times.size for one in tracks.tracks) + 500_000
    monkeypatch.setattr("modal.recording.tracks.row_budget", lambda *_: 100)
    stored = read(write_tracks(tracks, tmp_path).recording)
    for one in tracks.tracks:
        times, values = stored.series(f"/frequency/{one.number}/1_found")
        assert 50 <= values.size <= 100
        rows = rows_of(tracks, one.number)
        shown = rows["frequency"][np.searchsorted(rows["start_time"], times)]
        np.testing.assert_allclose(values, shown, rtol=1e-14)
        assert (shown.min(), shown.max()) == (rows["frequency"].min(), rows["frequency"].max())
        assert strokes(stored, f"/frequency/{one.number}/0_interval")[0].size == values.size
    assert "smallest and the largest" in stored.static("/words", "TextDocument:text")[0]
