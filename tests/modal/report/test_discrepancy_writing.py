import csv
import json
from dataclasses import replace

import numpy as np
import pytest

import modal.recording
from modal.report import write_report
from modal.report.discrepancy_writing import DIAGNOSIS_SCHEMA, diagnosis_csv, diagnosis_json
from modal.sections.validation import Provenance
from modal.structure.structural_model import StructuralModel


@pytest.fixture
def quick(monkeypatch):
    """A recording and pictures that cost nothing."""
    monkeypatch.setattr(modal.recording, "save_recording", lambda _result, path, **_options: path.write_bytes(b"rrd"))
    monkeypatch.setattr("modal.report.discrepancy_writing.draw_diagnosis", lambda _diagnosis: {})


def test_the_updated_model_can_be_read_again(diagnosis, tmp_path, quick):
    files = write_report(diagnosis, tmp_path / "gap")
    again = StructuralModel.load(files.model)
    assert again.output_names == diagnosis.model.output_names
    assert (again.stiffness == diagnosis.model.stiffness).all()


def test_a_model_that_is_a_function_has_no_file(make_gap, tmp_path, quick):
    files = write_report(make_gap(n_effects=1, model=lambda record: record), tmp_path / "gap")
    assert files.model is None
    assert sorted(path.name for path in (tmp_path / "gap").iterdir()) == sorted(path.name for path in files)
    assert len(list(files)) == 5
    assert "model.json" not in files.html.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def document(diagnosis):
    return json.loads(diagnosis_json(diagnosis, Provenance(command="c", sources=("s",))))


def test_json_states_its_schema_and_how_it_was_made(document):
    assert document["schema"] == DIAGNOSIS_SCHEMA
    assert (document["command"], document["sources"]) == ("c", ["s"])


def test_json_holds_every_number(document, diagnosis):
    for finding, row in zip(diagnosis.findings, document["findings"], strict=True):
        assert (row["effect"], row["where"]) == (finding.effect, finding.where)
        for one, found in zip(finding.parameters, row["parameters"], strict=True):
            assert (found["value"], found["std"], found["unit"]) == (one.value, one.std, one.unit)
    assert document["findings"][0]["evidence"]["margin"] == 812.0
    assert document["findings"][1]["evidence"]["margin"] is None  # infinite
    np.testing.assert_array_equal(document["gap_before"], diagnosis.gap_before)
    np.testing.assert_array_equal(document["gap_after"], diagnosis.gap_after)
    np.testing.assert_array_equal(document["noise_floor"]["variance"], diagnosis.noise_floor.variance)
    for law, row in zip(diagnosis.laws, document["laws"], strict=True):
        np.testing.assert_array_equal(row["force"], law.force)
        np.testing.assert_array_equal(row["points_deviation"], law.points_deviation)
    for step, row in zip(diagnosis.steps, document["steps"], strict=True):
        assert row == {"name": step.name, "fit_level": step.fit_level, "held_out_level": step.held_out_level}
    assert len(document["hypotheses"]) == len(diagnosis.hypotheses)
    assert [one["value"] for one in document["calibrated"]] == [one.value for one in diagnosis.calibrated]
    assert document["closed"] == diagnosis.closed


def test_json_keeps_names_and_leaves_histories_out(make_gap):
    name = '<script>alert("1")</script>'
    text = diagnosis_json(make_gap(names=(name, "b"), n_effects=1), Provenance())
    assert json.loads(text)["held_out"][0]["outputs"][0]["name"] == name
    assert text.isascii()
    assert len(text) < 200_000


def test_csv_has_a_row_a_parameter(diagnosis):
    rows = list(csv.DictReader(diagnosis_csv(diagnosis).splitlines()))
    parameters = [(one, finding) for finding in diagnosis.findings for one in finding.parameters]
    assert len(rows) == len(parameters)
    for row, (one, finding) in zip(rows, parameters, strict=True):
        assert (row["effect"], row["where"], row["parameter"], row["unit"]) == (
            finding.effect,
            finding.where,
            one.name,
            one.unit,
        )
        assert (float(row["value"]), float(row["std"])) == (one.value, one.std)
        assert float(row["high_95"]) - float(row["low_95"]) == pytest.approx(3.92 * one.std)
        assert None not in row
    assert rows[1]["margin"] == rows[1]["runner_up"] == ""


def test_csv_of_nothing_found_is_its_header(diagnosis_of):
    assert len(diagnosis_csv(diagnosis_of("none", 0)).splitlines()) == 1


def test_an_effect_without_parameters_has_a_row_all_the_same(diagnosis):
    bare = replace(diagnosis, findings=(replace(diagnosis.findings[0], parameters=()),))
    (row,) = csv.DictReader(diagnosis_csv(bare).splitlines())
    assert (row["effect"], row["value"], row["closed"]) == ("cubic_stiffness", "", "0.981")
    assert None not in row
