"""The page "Record": the data, their faults in words and on the time axis, spectra, coherence, all as numbers too."""

from dataclasses import replace

import numpy as np
import pytest

from modal.modes.response_synthesis import MeasuredFrf
from modal.preparation.channel import Finding
from modal.quality import check_quality
from modal.quality.check import ChannelQuality, ChannelStatistics, DataQuality
from modal.recording import save_recording
from modal.recording.identification.record import RecordLimits, marked
from modal.recording.plan import gather, planned
from modal.recording.stream import blueprint

HOSTILE = "<script>alert(1)</script> |x| [y](http://z) \u202e"


def statistics(**changes):
    values = dict.fromkeys(
        ("mean", "std", "smallest", "largest", "resolution", "noise_floor", "signal_to_noise", "explained"), 1.0
    )
    return ChannelStatistics(**({"n_samples": 3000, "n_missing": 0} | values | changes))


def make_quality(findings=(), *, n_inputs=2, n_outputs=4, n_lines=40):
    """A look at the data made up by hand."""
    names = [(f"shaker_{i + 1}", "input") for i in range(n_inputs)] + [
        (f"floor_{i + 1}", "output") for i in range(n_outputs)
    ]
    rng = np.random.default_rng(1)
    frequencies = np.linspace(0.0, 50.0, n_lines)
    coherence = rng.uniform(0, 1, (n_lines, n_outputs))
    return DataQuality(
        channels=tuple(
            ChannelQuality(name=name, role=role, unit="N", statistics=statistics(), findings=()) for name, role in names
        ),
        findings=tuple(findings),
        coherence=MeasuredFrf(
            frequencies=frequencies,
            frf=np.ones((n_lines, n_outputs, n_inputs), dtype=complex),
            ordinary_coherence=np.ones((n_lines, n_outputs, n_inputs)),
            multiple_coherence=coherence,
            n_averages=9,
        ),
        frequencies=frequencies,
        densities=rng.uniform(1e-6, 1.0, (n_lines, n_inputs + n_outputs)),
    )


def finding(level="bad", what="clipped", spans=((0, 5.0, 6.0),), channels=("floor_1",), sentence="It is clipped."):
    return Finding(
        level=level, what=what, where=", ".join(channels), sentence=sentence, channels=channels, spans=tuple(spans)
    )


@pytest.fixture(scope="module")
def quality():
    return make_quality(
        [
            finding(spans=((0, 5.0, 6.0), (0, 9.0, 9.0))),
            finding("doubtful", "drift", (), ("floor_2",), "It drifts."),
            finding("note", "hum", ((0, 20.0, 25.0),), ("floor_1", "floor_3"), "It hums."),
        ]
    )


@pytest.fixture(scope="module")
def stored(identification, quality, tmp_path_factory, read):
    path = tmp_path_factory.mktemp("record") / "run.rrd"
    return read(save_recording(identification, path, quality=quality))


def test_findings_lie_on_the_time_axis_where_they_are(stored, identification):
    times, values = stored.series("/data/quality/mark/01")
    dt = identification.records[0].dt
    assert times[[0, 1]].tolist() == [5.0, 6.0]
    assert times[3] == 9.0
    assert 9.0 + dt <= times[4] < 9.0 + 0.01 * 30.0  # long enough to be seen
    assert np.isnan(values).tolist() == [False, False, True] * 2
    assert stored.static("/data/quality/mark/01", "SeriesLines:names") == ["1. clipped: floor_1"]
    # the second finding concerns the whole record: no mark; the third keeps its number in the words
    assert stored.static("/data/quality/mark/02", "SeriesLines:names") == ["3. hum: floor_1, floor_3"]
    colours = [stored.static(f"/data/quality/mark/0{k}", "SeriesLines:colors") for k in (1, 2)]
    assert colours[0] != colours[1]
    assert not any("mark/03" in path for path in stored.entities("Scalars:scalars"))


def test_marks_of_a_later_record_are_moved_with_it(build, tmp_path, read):
    found = build(n_records=2)
    quality = make_quality([finding(spans=((1, 5.0, 6.0),))])
    stored = read(save_recording(found, tmp_path / "run.rrd", quality=quality))
    start = planned(found).data.starts[1]
    np.testing.assert_allclose(stored.series("/data/quality/mark/01")[0][:2], [start + 5.0, start + 6.0], atol=1e-8)


def test_bars_that_touch_never_go_back_in_time(build, tmp_path, read):
    spans = [(0, 1.0 + 0.01 * k, 1.005 + 0.01 * k) for k in range(150)]
    found = build()
    stored = read(save_recording(found, tmp_path / "run.rrd", quality=make_quality([finding(spans=spans)])))
    assert (np.diff(stored.series("/data/quality/mark/01")[0]) > 0).all()


def test_marks_are_bounded_in_number_and_findings_are_not(build, tmp_path, read):
    quality = make_quality([finding(what=f"fault {k}") for k in range(30)])
    assert len(marked(quality)) == RecordLimits.MOST_MARKS
    stored = read(save_recording(build(), tmp_path / "run.rrd", quality=quality))
    assert stored.table("/data/quality/findings", "finding")["what"] == [f"fault {k}" for k in range(30)]
    assert "10 findings more" in stored.static("/data/quality/text", "TextDocument:text")[0]


def test_numbers_of_findings_channels_spectra_and_coherence_are_stored(stored, quality):
    rows = stored.rows("/data/quality/findings", "finding")
    assert [row["severity"] for row in rows.values()] == [["bad"], ["doubtful"], ["note"]]
    assert rows[1]["span_from"] == [5.0, 9.0]
    assert rows[1]["span_record"] == [1.0, 1.0]
    channels = stored.table("/data/quality/channels", "channel")
    assert channels["name"] == [one.name for one in quality.channels]
    spectra = stored.rows("/data/spectra/numbers", "frequency_line")
    np.testing.assert_array_equal([row["density"] for row in spectra.values()], quality.densities)
    np.testing.assert_array_equal([row["frequency"][0] for row in spectra.values()], quality.frequencies)
    coherence = stored.rows("/data/coherence/numbers", "frequency_line")
    np.testing.assert_array_equal(
        [row["multiple_coherence"] for row in coherence.values()], quality.coherence.multiple_coherence
    )


def test_the_words_carry_the_verdict_and_every_finding(stored, quality):
    text = stored.static("/data/quality/text", "TextDocument:text")[0]
    assert text.startswith(f"### {quality.verdict}")
    for number, one in enumerate(quality.findings, start=1):
        assert f"{number}. **{one.level}**" in text
        assert one.sentence in text


def test_without_faults_nothing_is_marked_and_there_is_no_view_for_it(identification, tmp_path, read):
    quality = make_quality()
    stored = read(save_recording(identification, tmp_path / "run.rrd", quality=quality))
    assert not any("/mark/" in path for path in stored.entities("Scalars:scalars"))
    page = blueprint(identification, planned(identification), gather(identification, quality)).root_container.contents[
        0
    ]
    assert [view.name for view in page.contents[0].contents][:1] == ["Inputs"]
    assert "What was found, and when" not in [getattr(view, "name", "") for view in page.contents[0].contents]


def test_hostile_text_of_findings_is_harmless(build, tmp_path, read):
    quality = make_quality([finding(what=HOSTILE, channels=(HOSTILE,), sentence=HOSTILE)])
    stored = read(save_recording(build(), tmp_path / "run.rrd", quality=quality))
    text = stored.static("/data/quality/text", "TextDocument:text")[0]
    assert "<script" not in text
    assert "](http" not in text.replace("\\](http", "")
    assert "\u202e" not in text
    assert stored.table("/data/quality/findings", "finding")["sentence"] == [HOSTILE]


def test_the_identification_looks_at_the_data_itself_where_nobody_has(build):
    found = build(missing=True)
    quality = gather(found).quality
    assert len(quality.channels) == 6
    assert any(one.spans for one in quality.findings)


def test_data_that_were_read_without_the_release_of_a_decay_are_drawn(build, tmp_path):
    """A decay is identified with an input of its own, which no file holds."""
    found = build(n_inputs=1)
    (record,) = found.records
    read = check_quality(replace(record, inputs=np.empty((record.n_samples, 0)), input_names=(), input_units=()))
    assert save_recording(found, tmp_path / "decay.rrd", quality=read).stat().st_size > 0
