import csv
import json

import numpy as np
import pytest

from modal.report.machine import SCHEMA, csv_text, json_text
from modal.sections.provenance import Provenance


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


def test_csv_starts_no_formula(nasty_files):
    with nasty_files.csv.open(encoding="utf-8", newline="") as file:
        for row in csv.reader(file):
            for cell in row:
                if cell.startswith(("=", "+", "-", "@")):
                    float(cell)  # a negative number, not a formula
