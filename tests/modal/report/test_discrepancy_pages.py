"""The pages: what they say, and that names from files change nothing but words."""

import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from page_reader import Skeleton

from modal.report.discrepancy_writing import diagnosis_html, diagnosis_markdown, draw_diagnosis
from modal.sections.validation import Provenance


def page_of(diagnosis, name="plain"):
    provenance = Provenance(command=f"modal-report gap '{name}'", sources=(name,), remarks=(name,))
    return diagnosis_html(diagnosis, provenance, draw_diagnosis(diagnosis), model_file="model.json")


def test_the_page_says_what_was_found_and_how_sure(gap_texts):
    assert not any("<script" in page for page, *_ in gap_texts.values())
    text = " ".join(" ".join(Skeleton(gap_texts["plain"][0]).words).split())
    for words in (
        "The simulation lacks cubic stiffness and Coulomb friction at element_1.",
        "(2.013 ± 0.019)e5",
        "(1.976 to 2.050)e5",
        "cannot be told from sine softening",
        "Runner-up: gap spring at element_1",
        "The gap lies in upper.",
        "Look at lower.",
        "Add a record at twice the level",
        "Damping of element_1 sits on its bound",
        "model.json",
    ):
        assert words in text, words


def test_the_first_page_has_the_answer_how_sure_what_next_and_both_pictures(gap_texts):
    first = gap_texts["plain"][0].partition("<main>")[0]
    parts = ("<h1>The simulation lacks", "Proved", "k3 = ", "Next:", "Before: ", "After: ")
    places = [first.index(part) for part in parts]
    assert places == sorted(places)


def test_lines_of_a_block_stay_lines(gap_texts):
    block = gap_texts["plain"][0].split("result = modal.discrepancy.diagnose")[1]
    assert block.splitlines()[1].startswith("result.model")


@pytest.mark.parametrize(
    ("status", "n_effects", "there", "missing"),
    [
        (
            "named",
            1,
            ("What is missing", "Simulate with the updated", "with the effect found it is 100 %"),
            ("The best guess", "What could still hide"),
        ),
        (
            "unresolved",
            1,
            ("The best guess", "Not proved", "Do not build on the named effect yet"),
            ("What is missing", "Simulate with the updated"),
        ),
        ("none", 0, ("What could still hide", "Go on with the calibrated"), ("What is missing", "What else was tried")),
        ("unresolved", 0, ("no effect that was tried explains",), ("What is missing", "The best guess")),
    ],
)
def test_each_status_has_its_page(diagnosis_of, status, n_effects, there, missing):
    diagnosis = diagnosis_of(status, n_effects)
    skeleton = Skeleton(diagnosis_html(diagnosis, Provenance(), {}))
    markdown = diagnosis_markdown(diagnosis, Provenance())
    text = skeleton.text
    for words in there:
        assert words in text
        assert words in markdown
    for words in missing:
        assert words not in text
        assert words not in markdown
    links = {value[1:] for tag, name, value in skeleton.attributes if tag == "a" and name == "href"}
    assert links <= {value for _, name, value in skeleton.attributes if name == "id"}


def test_a_model_without_equations_and_without_a_file_is_no_hole_in_the_page(diagnosis):
    bare = replace(diagnosis, model=lambda record: record, calibrated=())
    text = diagnosis_html(bare, Provenance(), {})
    assert "The updated model</h3>" not in text
    assert "model.json" not in text
    assert "None was free." in text


def test_pictures_say_which_outputs_and_records_they_show(diagnosis, monkeypatch):
    captions = {name: picture.caption for name, picture in draw_diagnosis(diagnosis).items()}
    assert set(captions) == {"before", "after", "histories", "spectra", "before_after", "steps", "hypotheses", "laws"}
    for name in ("before", "histories"):
        assert "Held-out record 'held out, 1.8 N'." in captions[name]
    assert "largest gap" not in captions["histories"]
    assert "with the effects (green)" in captions["spectra"]
    assert "drawn as the loop" not in captions["laws"]
    monkeypatch.setattr("modal.report.discrepancy_writing.GapPageLimits.MOST_OUTPUTS", 1)
    assert "Shown: the output with the largest gap." in draw_diagnosis(diagnosis)["histories"].caption


def test_missing_samples_are_no_hole_in_the_page(diagnosis):
    outputs = np.array(diagnosis.held_out[0].outputs)
    outputs[100:300, 0] = np.nan
    gappy = replace(diagnosis, held_out=(replace(diagnosis.held_out[0], outputs=outputs), diagnosis.held_out[1]))
    text = page_of(gappy)
    assert not re.search(r"\bnan\b", " ".join(Skeleton(text).words))
    assert text.count("<svg") == 8


def test_a_model_that_ran_away_is_told(diagnosis):
    first = replace(diagnosis.steps[0], simulated=(), held_out_level=np.inf, fit_level=np.inf)
    lost = replace(diagnosis.hypotheses[-1], held_out_level=np.inf, log_likelihood=-np.inf)
    found = replace(
        diagnosis,
        steps=(first, *diagnosis.steps[1:]),
        hypotheses=(*diagnosis.hypotheses[:-1], lost),
        gap_before=np.full_like(diagnosis.gap_before, np.inf),
    )
    words = " ".join(Skeleton(page_of(found)).words)
    assert "unbounded with the model as given" in " ".join(words.split())
    assert not re.search(r"\b(nan|inf)\b", words)
    assert not re.search(r"\b(nan|inf)\b", diagnosis_markdown(found, Provenance()))


def test_pictures_of_nothing_found(diagnosis_of):
    assert set(draw_diagnosis(diagnosis_of("none", 0))) == {
        "before",
        "after",
        "histories",
        "spectra",
        "before_after",
        "steps",
    }


@pytest.mark.skipif(shutil.which("chromium") is None, reason="chromium is not installed")
def test_a_browser_has_nothing_to_complain_about(gap_texts, tmp_path):
    page = tmp_path / "page.html"
    page.write_text(gap_texts["nasty"][0], encoding="utf-8")
    command = ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"]
    command += ["--disable-background-networking", "--disable-component-update", "--disable-sync"]
    command += ["--enable-logging=stderr", f"--user-data-dir={tmp_path / 'profile'}", "--dump-dom", page.as_uri()]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    assert "CONSOLE" not in run.stderr
    assert run.stdout.count("<svg") == gap_texts["nasty"][0].count("<svg")


def test_masses_that_were_not_released_have_no_deviation_of_their_own(make_gap):
    found = make_gap()
    mass = replace(found.calibrated[0], name="mass of dof_0", nominal=1.2, value=1.2, std=0.12, unit="kg")
    other = replace(mass, name="mass of dof_1", value=1.5, std=0.01)
    page = page_of(replace(found, calibrated=(*found.calibrated, mass, other)))
    starts = [re.search(f"mass of (dof_{k}|{name})", page).start() for k, name in enumerate(("lower", "upper"))]
    row_of_mass, row_of_other = (page[start : page.index("</tr>", start)] for start in starts)
    assert "taken as given" in row_of_mass
    assert "±" not in row_of_mass
    assert "1.500 ± 0.010" in row_of_other


def test_the_two_pictures_on_top_explain_each_line_once(gap_texts):
    top = gap_texts["plain"][0].partition("<main>")[0]
    keys = [word.strip() for word in re.findall(r"<text[^>]*>([^<]*)</text>", top)]
    shown = [word for word in keys if word.startswith(("measured", "simulated"))]
    assert len(shown) == len(set(shown)) == 3
