import csv
import json
from dataclasses import replace

import jsonschema
import numpy as np
import pytest

from modal.acceptance.test_file import AcceptanceLimit, SensorNote, Specification
from modal.modes.mode import Uncertainty
from modal.report.machine import SCHEMA, csv_text, document_schema, json_text, schema_file, schema_text, type_schema
from modal.sections.validation import Provenance, SourceFile


@pytest.fixture(scope="module")
def document(make_result):
    result = make_result()
    return result, json.loads(json_text(result, Provenance(command="c", sources=("s",))))


def test_json_states_its_schema(document):
    assert document[1]["schema"] == SCHEMA
    assert document[1]["command"] == "c"


def test_json_holds_every_mode_with_every_number(document):
    result, parsed = document
    assert len(parsed["modes"]["table"]) == len(result.modes)
    for mode, row in zip(result.modes, parsed["modes"]["table"], strict=True):
        assert row["frequency"] == mode.frequency
        assert row["pole"] == [mode.pole.real, mode.pole.imag]
        assert row["frequency_std"] is None
        np.testing.assert_array_equal(np.array(row["shape"]) @ [1, 1j], mode.shape)
        assert (row["verdict"], row["reason"]) == (mode.verdict, mode.reason)


def test_json_holds_the_model(document):
    result, parsed = document
    for name in "ABCDK":
        np.testing.assert_array_equal(parsed["realisation"][name], getattr(result.realisation, name))
    assert parsed["markov"]["n_lags"] == result.markov.n_lags
    assert "system" not in parsed["markov"]  # what grows with the square of the channels is in result.npz
    assert parsed["order_evidence"]["candidate_fits"][9] is None


def test_json_keeps_names_as_they_are(nasty, nasty_files):
    parsed = json.loads(nasty_files.json.read_text(encoding="ascii"))
    names = tuple(channel["name"] for channel in parsed["records"][0]["outputs"])
    assert names == nasty.records[0].output_names


def test_csv_has_a_row_a_mode_and_equal_columns(make_result):
    result = make_result()
    rows = list(csv.DictReader(csv_text(result).splitlines()))
    assert [float(row["frequency"]) for row in rows] == [mode.frequency for mode in result.modes]
    assert [row["verdict"] for row in rows] == [mode.verdict for mode in result.modes]
    assert float(rows[1]["shape floor_2 imaginary"]) == result.modes.modes[1].shape[1].imag
    assert rows[0]["frequency_std"] == ""
    assert rows[0]["damping_resolved"] == "yes"
    assert None not in rows[0]


@pytest.fixture(scope="module")
def validator():
    schema = json.loads(schema_file().read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


@pytest.fixture
def written(identification):
    return json.loads(json_text(identification, Provenance()))


def test_the_file_in_the_package_is_the_schema_of_the_types():
    """Where a type gained a field: `schema_file().write_text(schema_text())` and look at the difference."""
    assert schema_file().read_text(encoding="utf-8") == schema_text()


def test_a_plain_report_is_valid(validator, written):
    validator.validate(written)


def test_a_report_with_everything_is_valid(validator, identification):
    known = Uncertainty(
        method="propagation",
        frequency_std=np.zeros(1),
        damping_ratio_std=np.zeros(1),
        shape_std=np.zeros((1, 3)),
        markov_std=np.zeros((1, 3, 1)),
    )
    modes = tuple(replace(mode, shape_std=np.full(3, 0.1)) for mode in identification.modes)
    result = replace(
        identification,
        uncertainty=known,
        warnings=("careful",),
        modes=replace(identification.modes, modes=modes),
        residuals=replace(identification.residuals, input_correlation_ratio=None),
    )
    files = (SourceFile(name="a.csv", size=3, sha256="ab"),)
    specification = Specification(
        article="frame", sensors=(SensorNote(channel="x"),), limits=(AcceptanceLimit(kind="no_mode", frequency=(1, 2)),)
    )
    parsed = json.loads(json_text(result, Provenance(files=files), specification=specification))
    validator.validate(parsed)
    assert parsed["test"]["article"] == "frame"
    assert parsed["limits"][0]["state"] == "cannot be told"  # the deviations of its frequencies are not known
    assert parsed["uncertainty"] == {"method": "propagation", "degrees_of_freedom": None}
    assert parsed["files"] == [{"name": "a.csv", "size": 3, "sha256": "ab"}]


def test_every_number_of_a_mode_is_described():
    row = document_schema()["properties"]["modes"]["properties"]["table"]["items"]
    assert "[Hz]" in row["properties"]["frequency"]["description"]
    assert not [name for name, one in row["properties"].items() if "description" not in one]


def _no_longer(written, *path):
    for key in path[:-1]:
        written = written[key]
    del written[path[-1]]


def _another(written, value, *path):
    for key in path[:-1]:
        written = written[key]
    written[path[-1]] = value


WRONG = [
    lambda one: _no_longer(one, "modes", "table", 0, "frequency"),
    lambda one: _no_longer(one, "version"),
    lambda one: _another(one, "modal-report/0", "schema"),
    lambda one: _another(one, "maybe", "modes", "table", 0, "verdict"),
    lambda one: _another(one, "5 Hz", "modes", "table", 0, "frequency"),
    lambda one: _another(one, [1.0], "modes", "table", 0, "pole"),
    lambda one: _another(one, 0, "modes", "table", 0, "number"),
    lambda one: _another(one, 1, "modes", "table", 0, "colour"),
    lambda one: _another(one, 1, "more"),
    lambda one: _another(one, "x", "realisation", "A", 0, 0),
    lambda one: _another(one, {}, "records", 0, "outputs", 0),
]


@pytest.mark.parametrize("spoil", WRONG)
def test_a_document_that_is_wrong_is_not_valid(validator, written, spoil):
    assert validator.is_valid(written)
    spoil(written)
    assert not validator.is_valid(written)


def test_a_type_without_a_schema_is_an_error():
    with pytest.raises(TypeError, match="no schema"):
        type_schema(dict)
