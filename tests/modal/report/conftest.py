"""A report written once, of channels whose names are as bad as names get."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from page_reader import NASTY_INPUT, NASTY_NAMES


@pytest.fixture(scope="session")
def nasty(make_result):
    return make_result(names=NASTY_NAMES, input_name=NASTY_INPUT, warnings=(f"Look at {NASTY_NAMES[0]}.",))


@pytest.fixture(scope="session")
def plain(make_result):
    return make_result(warnings=("Look at floor_1.",))


@pytest.fixture(scope="session")
def nasty_files(nasty, tmp_path_factory):
    from modal.report import Provenance, write_report

    provenance = Provenance(
        command=f"modal-report run '{NASTY_INPUT}'", sources=(NASTY_NAMES[0],), remarks=(NASTY_INPUT,)
    )
    with pytest.MonkeyPatch.context() as patch:  # the recording has its own tests, with names of its own
        patch.setattr("modal.recording.save_recording", lambda _result, path, **_options: path.write_bytes(b"rrd"))
        return write_report(nasty, tmp_path_factory.mktemp("nasty") / "report", provenance=provenance)


@pytest.fixture(scope="session")
def plain_files(plain, tmp_path_factory):
    from modal.report import Provenance, write_report

    provenance = Provenance(command="modal-report run x", sources=("x",), remarks=("x",))
    return write_report(plain, tmp_path_factory.mktemp("plain") / "report", provenance=provenance)


@pytest.fixture(scope="session")
def gap_texts(make_gap):
    """{names: (page, Markdown, CSV)} of the same diagnosis with plain and with nasty names."""
    from modal.report.discrepancy_writing import diagnosis_csv, diagnosis_html, diagnosis_markdown, draw_diagnosis
    from modal.sections.validation import Provenance

    found = {}
    for key, names, input_name, where in (
        ("plain", ("lower", "upper"), "force", "element_1"),
        ("nasty", (NASTY_NAMES[0], NASTY_NAMES[1] + NASTY_NAMES[2]), NASTY_INPUT, "=1+1\x1b<script>"),
    ):
        one = make_gap(names=names, input_name=input_name, where=where, warnings=(f"Look at {names[0]}.",))
        one = replace(one, location=SimpleNamespace(sentences=(f"The gap lies in {names[1]}.",)))
        one = replace(one, held_out=tuple(replace(record, name=names[1]) for record in one.held_out))
        given = Provenance(command=f"modal-report gap '{input_name}'", sources=names, remarks=(input_name,))
        page = diagnosis_html(one, given, draw_diagnosis(one), model_file="model.json")
        found[key] = (page, diagnosis_markdown(one, given), diagnosis_csv(one))
    return found
