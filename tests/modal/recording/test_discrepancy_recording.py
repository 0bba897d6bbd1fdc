"""The recording of a diagnosis: what is drawn is stored, the gap shrinks on the timeline "step", names are harmless."""

import re
from dataclasses import replace

import numpy as np
import pytest
from levels_by_hand import HARDENS, POLE, RESTS, VAGUE, with_levels
from page_reader import views

from modal.discrepancy.results import in_words
from modal.recording import log_diagnosis, save_recording
from modal.recording.discrepancy import planned_diagnosis
from modal.recording.stream import diagnosis_blueprint, diagnosis_id
from okid.errors import InvalidDataError

HOSTILE = ("<script>alert(1)</script>", "مرحبا |`*[x](http://y)\n#\u202e")


@pytest.fixture(scope="module")
def stored(diagnosis, tmp_path_factory, read):
    return read(save_recording(diagnosis, tmp_path_factory.mktemp("recording") / "gap.rrd"))


def there(series):
    _, values = series
    return values[~np.isnan(values)]


def test_every_series_is_the_held_out_records_one_after_the_other(stored, diagnosis):
    for j, name in enumerate(("lower", "upper")):
        path = f"/discrepancy/output/{name}"
        measured = np.concatenate([record.outputs[:, j] for record in diagnosis.held_out])
        np.testing.assert_array_equal(there(stored.series(f"{path}/run/0_measured")), measured)
        for part, step in (("0_as_given", 0), ("1_calibrated", 1), ("2_updated", -1)):
            simulated = np.concatenate([run[:, j] for run in diagnosis.steps[step].simulated])
            np.testing.assert_array_equal(there(stored.series(f"{path}/run/1_{part}")), simulated)
            np.testing.assert_array_equal(there(stored.series(f"{path}/gap/{part}")), measured - simulated)
        band = there(stored.series(f"{path}/gap/9_noise/upper"))
        np.testing.assert_allclose(band, np.repeat(2 * np.sqrt(diagnosis.noise_floor.variance[2:, j]), 2))


def test_every_line_over_time_is_drawn_by_its_extremes(stored):
    lines = stored.entities("SeriesLines:names")
    assert len(lines) == 2 * (4 + 3 + 2)
    assert set(lines) == set(stored.entities("SeriesLines:aggregation_policy"))


def test_the_gap_shrinks_on_the_timeline_step(stored, diagnosis):
    table = stored.table("/discrepancy/steps", "step")
    assert table["step"] == [0, 1, 2, 3]
    assert table["name"] == [step.name for step in in_words(diagnosis).steps]
    assert table["held_out_level"] == [step.held_out_level for step in diagnosis.steps]
    for path, way in (("gap/plot/3_now", "height"), ("spectrum/plot/3_now", "height"), ("parts/plot/2_now", "length")):
        rows = stored.rows(f"/discrepancy/steps/{path}", "step")
        assert list(rows) == [0, 1, 2, 3]
        sizes = []
        for row in rows.values():
            points = np.concatenate([np.array(strip) for strip in row["LineStrips2D:strips"]])
            sizes.append(np.ptp(points[:, 1 if way == "height" else 0]))
            assert np.isfinite(points).all()
        assert sizes == sorted(sizes, reverse=True)
        assert sizes[-1] < 0.5 * sizes[0]
    texts = [row["TextDocument:text"][0] for row in stored.rows("/discrepancy/steps/text", "step").values()]
    assert [text.split("\n")[0] for text in texts][::3] == [
        "### Step 0 of 3: as given",
        "### Step 3 of 3: + Coulomb friction at the link lower-upper",
    ]


def test_the_steps_play_on_the_records_time_too(stored, diagnosis):
    plan = planned_diagnosis(diagnosis)
    rows = stored.rows("/discrepancy/steps/text", "time")
    assert len(rows) == 4
    assert plan.step_times[0] == plan.start
    assert plan.step_times[-1] == plan.stop


def test_tables_hold_the_numbers(stored, diagnosis):
    found = stored.table("/discrepancy/findings", "parameter")
    parameters = [(finding, one) for finding in diagnosis.findings for one in finding.parameters]
    assert found["effect"] == [finding.effect for finding, _ in parameters]
    for name in ("value", "std", "unit"):
        assert found[name] == [getattr(one, name) for _, one in parameters]
    tried = stored.table("/discrepancy/hypotheses", "hypothesis")
    assert tried["held_out_level"] == [one.held_out_level for one in diagnosis.hypotheses]
    gaps = stored.table("/discrepancy/gaps", "gap")
    np.testing.assert_array_equal(gaps["before"], diagnosis.gap_before.ravel())
    np.testing.assert_array_equal(gaps["after"], diagnosis.gap_after.ravel())
    calibrated = stored.table("/discrepancy/calibrated", "linear_parameter")
    assert calibrated["at_bound"] == [one.at_bound for one in diagnosis.calibrated]
    law = stored.table("/discrepancy/law/01/curve", "grid")
    np.testing.assert_array_equal(law["force"], diagnosis.laws[0].force)
    points = stored.table("/discrepancy/law/02/points", "bin")
    np.testing.assert_array_equal(points["std"], diagnosis.laws[1].points_deviation)
    spectrum = stored.table("/discrepancy/spectrum/01/numbers", "frequency_line")
    assert {"frequency", "measured", "noise", "gap_as_given", "gap_updated"} <= set(spectrum)


def test_words_name_what_was_found(stored):
    text = stored.static("/discrepancy/verdict", "TextDocument:text")[0]
    assert text.startswith("### The simulation lacks cubic stiffness and Coulomb friction at the link lower-upper")
    assert "(2.013 ± 0.019)e5" in text.replace("\\", "")
    assert "Add a record at twice the level" in text


@pytest.mark.parametrize("kind", [("named", 2), ("named", 1), ("unresolved", 1), ("none", 0)])
def test_every_view_has_a_name_and_data_below_its_origin(diagnosis_of, tmp_path, read, exit_of, kind):
    found = diagnosis_of(*kind)
    path = save_recording(found, tmp_path / "gap.rrd")
    assert exit_of("rrd", "verify", path) == 0
    paths = {str(c.entity_path) for c in read(path).store.schema().component_columns()}
    layout = diagnosis_blueprint(found, planned_diagnosis(found))
    pages = layout.root_container.contents
    assert [page.name for page in pages] == ["Discrepancy", "Step by step", "Laws", "Outputs", "Numbers"]
    every = list(views(layout.root_container))
    assert len(every) > 10
    for view in every:
        assert view.name
        origin = "/" + view.origin.strip("/")
        assert any(path == origin or path.startswith(origin + "/") for path in paths), view.origin


def test_a_model_that_ran_away_is_left_out_and_the_rest_stands(diagnosis, tmp_path, read):
    lost = tuple(np.full_like(values, np.nan) for values in diagnosis.steps[0].simulated)
    steps = (replace(diagnosis.steps[0], simulated=lost, held_out_level=np.inf), *diagnosis.steps[1:])
    stored = read(save_recording(replace(diagnosis, steps=steps), tmp_path / "gap.rrd"))
    assert list(stored.rows("/discrepancy/steps/text", "step")) == [1, 2, 3]
    assert not any("as_given" in path for path in stored.entities("Scalars:scalars"))


def test_hostile_names_are_harmless(make_gap, tmp_path, read):
    found = make_gap(names=HOSTILE, where=HOSTILE[1], input_name="\x00\x1b[2J", n_effects=1)
    found = replace(found, warnings=(f"Look at {HOSTILE[0]}.",))
    stored = read(save_recording(found, tmp_path / "gap.rrd"))
    plan = planned_diagnosis(found)
    shown = [view.name for view in views(diagnosis_blueprint(found, plan).root_container)]
    for component in ("SeriesLines:names", "Points2D:labels"):
        for path in stored.entities(component):
            shown += stored.static(path, component)
    texts = [stored.static(path, "TextDocument:text")[0] for path in ("/discrepancy/verdict", "/discrepancy/gap_text")]
    texts += [row["TextDocument:text"][0] for row in stored.rows("/discrepancy/steps/text", "step").values()]
    for text in texts:
        assert "<script" not in text
        assert not re.search(r"(?<!\\)\]\(http", text)
    for text in (*shown, *texts):
        # Latin, Greek and a few signs: a viewer without fonts stops at anything else
        assert re.fullmatch(r"[\n -~\u00a0-\u017f\u0384-\u03cf–…□±²°≤≥−×]*", text), text
    assert stored.table("/discrepancy/gaps", "gap")["output"] == list(HOSTILE) * 2  # as data they stand as they were


def test_the_identity_follows_the_content(diagnosis, diagnosis_of):
    assert diagnosis_id(diagnosis) == diagnosis_id(replace(diagnosis, advice=()))
    assert diagnosis_id(diagnosis) != diagnosis_id(diagnosis_of("named", 1))
    assert diagnosis_id(diagnosis) != diagnosis_id(replace(diagnosis, status="unresolved"))


def test_two_recordings_of_the_same_diagnosis_compare_equal(diagnosis_of, tmp_path, exit_of):
    found = diagnosis_of("none", 0)
    paths = [save_recording(found, tmp_path / name) for name in ("a.rrd", "b.rrd")]
    assert exit_of("rrd", "compare", "--unordered", *paths) == 0


def test_wrong_use_is_one_sentence(diagnosis, identification):
    import rerun as rr

    stream = rr.RecordingStream("survey", recording_id="today")
    with pytest.raises(InvalidDataError, match="'send' or 'leave'"):
        log_diagnosis(diagnosis, stream, layout="both")
    with pytest.raises(InvalidDataError, match="takes a Diagnosis, but was given Identification"):
        log_diagnosis(identification, stream)


@pytest.mark.parametrize(
    ("modes", "n_panels"), [((HARDENS, RESTS, VAGUE), 2), ((POLE,), 1), ((VAGUE,), 0)], ids=["modes", "pole", "vague"]
)
def test_modes_against_level_have_a_page_where_they_tell_something(diagnosis, tmp_path, read, modes, n_panels):
    found = with_levels(diagnosis, *modes)
    pages = diagnosis_blueprint(found, planned_diagnosis(found)).root_container.contents
    shown = [view.name for page in pages if page.name == "Levels" for view in views(page)]
    assert len(shown) == bool(n_panels)
    stored = read(save_recording(found, tmp_path / "levels.rrd"))
    drawn = [path for path in stored.entities("LineStrips2D:strips") if path.startswith("/discrepancy/levels/")]
    assert bool(drawn) == bool(n_panels)
    assert any("/plot/1/" in path for path in drawn) == (n_panels == 2)
    table = stored.table("/discrepancy/level_modes", "mode_at_level")
    n_cells = sum(int(np.isfinite(mode.frequencies).sum()) for mode in modes)
    assert len(table["frequency"]) == n_cells  # those that are not drawn as well
    expected = np.concatenate([mode.frequencies[np.isfinite(mode.frequencies)] for mode in modes])
    np.testing.assert_allclose(np.asarray(table["frequency"], dtype=float), expected)


def test_levels_of_hypotheses_are_stored_in_times_of_the_floor_too(stored, diagnosis):
    tried = stored.table("/discrepancy/hypotheses", "hypothesis")
    for part in ("fit", "held_out"):
        levels = [getattr(one, f"{part}_level") for one in diagnosis.hypotheses]
        np.testing.assert_allclose(tried[f"{part}_times_floor"], np.sqrt(levels))
