"""Recordings of unusual results: hostile names, gaps, several records, no mode, no input, one output, very many."""

import re
from dataclasses import replace

import numpy as np
import pytest
from page_reader import views

from modal.recording import save_recording
from modal.recording.plan import WordLimits, bullets, gather, planned
from modal.recording.stream import GLOBAL_AXIS, blueprint
from okid.errors import InvalidDataError
from okid.record import Record

HOSTILE = [
    "<script>alert(1)</script>",
    "",
    "x" * 5000,
    "\u202egnp.exe",
    "مرحبا بالعالم",
    "a/b/../c",
    "__properties",
    "|`*[x](http://y)\n#",
]


@pytest.fixture(scope="module")
def hostile(build, tmp_path_factory, read):
    found = build(n_outputs=8, output_names=HOSTILE, input_names=["\x00\x1b[2J", '𝕏 \\ "'], units=["位", "°"] * 4)
    return found, read(save_recording(found, tmp_path_factory.mktemp("hostile") / "run.rrd"))


def test_hostile_names_are_harmless_and_nothing_is_lost(hostile):
    found, stored = hostile
    measured = {path for path in stored.entities("Scalars:scalars") if path.startswith("/data/output/")}
    assert len(measured) == 8
    values = {stored.series(path)[1][:5].tobytes() for path in measured}
    assert values == {found.records[0].outputs[:5, i].tobytes() for i in range(8)}
    assert all(len(path) < 600 for path in measured)
    own = [path for path in stored.entities("Scalars:scalars") if "__" in path and "name__" not in path]
    assert own == []
    text = stored.static("/fit/text", "TextDocument:text")[0]
    assert "<script" not in text
    assert "\u202e" not in text
    assert not re.search(r"(?<!\\)\]\(http", text)
    assert len(text) < 5000
    # as data they stand as they were
    assert stored.table("/fit/outputs", "output")["name"] == HOSTILE


def drawn_by_the_viewer(text):
    """Not the code's own table: Latin, Greek, Cyrillic and a few signs that were seen in pictures."""
    return re.fullmatch(r"[\n -~\u00a0-\u017f\u0384-\u03cf\u0401-\u045c–…□±²°≤≥−]*", text)


def test_nothing_is_shown_that_a_viewer_without_fonts_cannot_draw(hostile):
    # Rerun 0.41 stops with "No glyph for ..." when a character is in none of its own fonts nor of the machine's
    found, stored = hostile
    plan = planned(found)
    shown = [view.name for view in views(blueprint(found, plan, gather(found)).root_container)]
    for component in ("SeriesLines:names", "Points2D:labels", "Points3D:labels", "TextDocument:text"):
        for path in stored.entities(component):
            shown += stored.every(path, component)
    assert len(shown) > 100
    assert [text for text in shown if not drawn_by_the_viewer(text)] == []
    assert any("X" in text and "\\" in text for text in shown)
    assert any("□" in text for text in shown)


def test_missing_samples_stay_gaps(build, tmp_path, read):
    found = build(missing=True)
    stored = read(save_recording(found, tmp_path / "run.rrd"))
    values = stored.series("/data/output/floor_1")[1]
    np.testing.assert_array_equal(values, found.records[0].outputs[:, 0])
    assert np.isnan(values[1000:1500]).all()
    assert np.isnan(stored.series("/fit/output/floor_1/residual")[1][1000:1500]).all()
    assert np.isfinite(stored.series("/fit/output/floor_1/model", 1)[1]).all()


def test_channels_that_miss_different_samples_are_stored_apart(build, tmp_path, read):
    found = build()
    run = found.predicted[0]
    outputs = run.outputs.copy()
    outputs[:50] = np.nan
    found = replace(found, predicted=(replace(run, outputs=outputs),))
    stored = read(save_recording(found, tmp_path / "run.rrd"))
    predicted = stored.series("/fit/output/floor_1/model/1")[1]
    np.testing.assert_array_equal(predicted, outputs[:, 0])
    np.testing.assert_array_equal(stored.series("/fit/output/floor_1/model/2")[1], found.simulated[0].outputs[:, 0])


def test_several_records_follow_one_another_with_a_pause(build, tmp_path, read):
    found = build(n_records=3)
    stored = read(save_recording(found, tmp_path / "run.rrd"))
    times, values = stored.series("/data/output/floor_2")
    assert (np.diff(times) > 0).all()
    gaps = np.flatnonzero(np.isnan(values))
    assert gaps.tolist() == [3000, 6001]
    expected = [record.outputs[:, 1] for record in found.records]
    np.testing.assert_array_equal(values[~np.isnan(values)], np.concatenate(expected))
    table = stored.table("/data/records", "record")
    for start, first in zip(table["shown_from"], (0, 3001, 6002), strict=True):
        assert times[first] == pytest.approx(start, abs=1e-8)


def test_records_cut_from_one_measurement_keep_their_times(build):
    found = build()
    whole = found.records[0]
    parts = (whole.samples(0, 1000), whole.samples(1200, 3000))
    plan = planned(replace(found, records=parts, simulated=parts))
    assert plan.data.shifts == (0.0, 0.0)
    assert plan.data.starts == pytest.approx((0.0, 12.0))
    swapped = planned(replace(found, records=parts[::-1], simulated=parts[::-1])).data
    assert swapped.starts[1] > swapped.stops[0]


def test_without_a_system_mode_the_words_say_so(without_modes, tmp_path, read):
    stored = read(save_recording(without_modes, tmp_path / "run.rrd"))
    assert "No mode of the system was found." in stored.static("/fit/text", "TextDocument:text")[0]
    assert stored.static("/modes/text", "TextDocument:text")[0].count("| noise |") == 2
    assert not [path for path in stored.entities("Points3D:positions") if path.startswith("/modes")]
    nothing = replace(without_modes, modes=replace(without_modes.modes, modes=()))
    stored = read(save_recording(nothing, tmp_path / "nothing.rrd"))
    assert "no mode" in stored.static("/modes/text", "TextDocument:text")[0]


def test_an_overdamped_pole_has_no_damping_to_quote(identification, tmp_path, read):
    modes = identification.modes.modes
    changed = (replace(modes[0], kind="real", damping_ratio=1.0), *modes[1:])
    found = replace(identification, modes=replace(identification.modes, modes=changed))
    stored = read(save_recording(found, tmp_path / "run.rrd"))
    assert "one overdamped pole" in stored.static("/fit/text", "TextDocument:text")[0]
    assert "| overdamped |" in stored.static("/modes/text", "TextDocument:text")[0]
    page = blueprint(found, planned(found), gather(found)).root_container.contents[3]
    titles = str([view.name for view in page.contents[0].contents[0].contents])
    assert "6.667 Hz, overdamped" in titles


def test_without_inputs_nothing_is_said_to_run_freely(build, tmp_path, read):
    stored = read(save_recording(build(n_inputs=0), tmp_path / "run.rrd"))
    text = stored.static("/fit/text", "TextDocument:text")[0]
    assert "inputs alone" not in text
    assert "one step ahead" in text
    assert stored.static("/fit/output/floor_1/model", "SeriesLines:names") == ["one step ahead"]
    assert stored.static("/fit/output/floor_1/residual", "SeriesLines:names") == ["measured - one step ahead"]
    assert "free run" not in stored.static("/validation/text", "TextDocument:text")[0]


def test_a_record_of_ages_is_refused_in_one_sentence(build, tmp_path):
    with pytest.raises(InvalidDataError, match=r"up to 9\.2e\+09 s \(292 years\)"):
        save_recording(build(n_samples=400, dt=3e7), tmp_path / "run.rrd")
    assert list(tmp_path.iterdir()) == []


def test_evidence_may_be_empty_or_all_unstable(identification, tmp_path, read):
    empty = replace(
        identification.order_evidence,
        singular_values=np.empty(0),
        candidate_orders=np.empty(0),
        candidate_fits=np.empty(0),
        stabilisation=(),
    )
    save_recording(replace(identification, order_evidence=empty), tmp_path / "empty.rrd")
    unstable = replace(
        identification.order_evidence, candidate_orders=np.array([2.0, 4.0]), candidate_fits=np.array([np.nan, np.nan])
    )
    stored = read(save_recording(replace(identification, order_evidence=unstable), tmp_path / "unstable.rrd"))
    assert "/order/fit/plot/unstable" in stored.entities("LineStrips2D:strips")


def test_a_constant_model_and_extreme_numbers_are_drawn(identification, tmp_path):
    tiny = tuple(
        Record(r.inputs * 1e-150, r.outputs * 1e150, r.dt, output_names=r.output_names, input_names=r.input_names)
        for r in identification.records
    )
    mode = replace(identification.modes.modes[0], shape=np.zeros(4, dtype=complex), frequency=0.0, damping_ratio=1.0)
    modes = replace(identification.modes, modes=(mode, *identification.modes.modes[1:]))
    values = np.array([1e-300, 0.0])
    evidence = replace(identification.order_evidence, singular_values=values, order=1)
    found = replace(identification, records=tiny, modes=modes, order_evidence=evidence)
    assert save_recording(found, tmp_path / "run.rrd").stat().st_size > 0


CASES = [
    {},
    {"n_outputs": 1, "n_inputs": 1, "n_modes": 1, "n_noise": 0},
    {"n_outputs": 1, "n_inputs": 0, "n_modes": 2},
    {"n_outputs": 2, "n_inputs": 0, "system": False},
    {"n_outputs": 40, "n_inputs": 9, "n_modes": 12, "n_noise": 20, "n_samples": 300},
    {"n_samples": 40, "n_noise": 0},
    {"units": ["m", "rad", "", "m"]},
]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_all_is_recorded_and_every_view_has_a_name_and_data_below_its_origin(build, tmp_path, read, case):
    found = build(**case)
    stored = read(save_recording(found, tmp_path / "run.rrd"))
    record = found.records[0]
    paths = {str(c.entity_path) for c in stored.store.schema().component_columns()}
    series = stored.entities("Scalars:scalars")
    assert sum(path.startswith("/data/input/") for path in series) == record.n_inputs
    assert sum(path.startswith("/data/output/") for path in series) == record.n_outputs
    assert len(stored.table("/modes/table", "mode")["mode"]) == len(found.modes.modes)
    shapes = {path.split("/")[3] for path in stored.entities("Points3D:positions") if path.startswith("/modes/shape/")}
    layout = blueprint(found, planned(found), gather(found))
    pages = layout.root_container.contents
    assert [page.name for page in pages] == ["Record", "Observer fit", "Order", "Modes", "Validation"]
    every = list(views(layout.root_container))
    assert len(every) < 150
    for view in every:
        assert view.name
        origin = "/" + view.origin.strip("/")
        assert any(path == origin or path.startswith(origin + "/") for path in paths), view.origin
    titles = [view.name for view in views(pages[3]) if view.class_identifier == "3D"]
    assert len(titles) == len(set(titles)) == len(shapes) == min(9, case.get("n_modes", 3))


def test_linked_plots_open_on_the_whole_record(build):
    found = build(n_records=2)
    plan = planned(found)
    layout = blueprint(found, plan, gather(found))
    holders = [view for view in views(layout.root_container) if view.id == GLOBAL_AXIS]
    assert len(holders) == 1
    assert holders[0].name == "Inputs"
    linked = [v for v in views(layout.root_container) if v.class_identifier == "TimeSeries" and "cursor" not in v.name]
    assert len(linked) > 5


def test_a_long_sentence_is_not_cut_in_its_middle():
    sentence = "Noise floor of held out: " + "by its level from 15 to 128 Hz, " * 30
    assert bullets([sentence])[0] == f"- {sentence.strip()}"


def test_a_hostile_one_is_bounded_and_harmless():
    (text,) = bullets(["<script>" + "x" * 10_000])
    assert "<script>" not in text
    assert len(text) < WordLimits.LONGEST_SENTENCE + 100
    assert bullets([]) == []
