import io
from dataclasses import replace

import pytest
from rich.console import Console

from modal.command.gap import show_diagnosis, show_diagnosis_files
from modal.report.writing import DiagnosisFiles


def printed(show, *arguments, **options):
    file = io.StringIO()
    show(Console(file=file, width=110, force_terminal=False, color_system=None), *arguments, **options)
    return file.getvalue()


def test_the_verdict_comes_first_then_values_with_their_deviations(diagnosis):
    text = printed(show_diagnosis, diagnosis)
    assert text.split("\n")[1] == "The simulation lacks cubic stiffness and Coulomb friction at the link lower-upper."
    assert "\ncubic stiffness at the link lower-upper\nk3  (2.013 ± 0.019)e5  N/m^3  95 %: (1.976 to 2.050)e5" in text
    assert "0.05960 ± 0.00060" in text
    assert "Runner-up: gap spring" in text
    assert "Add a record at twice the level" in text


def test_the_gap_stands_before_and_after(diagnosis):
    lines = printed(show_diagnosis, diagnosis).splitlines()
    (heading,) = (line for line in lines if "as given" in line and "calibrated" in line and "by" in line)
    assert heading.rstrip().endswith("with the effects")
    (row,) = (line for line in lines if line.startswith("output  upper"))
    first, _, last = (float(word) for word in row.split()[2:])
    assert first > 20.0
    assert last < 1.1


@pytest.mark.parametrize(
    ("status", "n_effects", "there", "missing"),
    [
        ("none", 0, ("Nothing missing.", "What the data could still hide", "k3 = 3100 N/m^3"), ("Why", "value ± std")),
        ("unresolved", 1, ("Not proved.", "Do not build on"), ("could still hide", "Simulate with")),
        ("unresolved", 0, ("no effect of the catalogue explains it",), ("Why",)),
    ],
)
def test_each_status_prints_its_parts(diagnosis_of, status, n_effects, there, missing):
    text = printed(show_diagnosis, diagnosis_of(status, n_effects))
    assert all(words in text for words in there)
    assert not any(words in text for words in missing)


@pytest.mark.parametrize("warnings", [(), ("One level only.",)])
def test_warnings_and_remarks_are_printed_when_there_are_any(diagnosis, warnings):
    text = printed(show_diagnosis, replace(diagnosis, warnings=warnings), remarks=("tip: g -> m/s^2",))
    assert ("One level only." in text) == ("Warnings" in text) == bool(warnings)
    assert "tip: g -> m/s^2" in text


def test_names_are_not_obeyed_by_the_terminal(make_gap):
    name = "\x1b[2J[bold red]x[/bold red]"
    text = printed(show_diagnosis, make_gap(names=(name, "b"), where=name, n_effects=1))
    assert "\x1b" not in text
    assert "[bold red]x[/bold red]" in text


def test_paths_stay_on_one_line_and_a_missing_model_is_not_named(tmp_path):
    folder = tmp_path / ("long" * 40)
    text = printed(show_diagnosis_files, DiagnosisFiles.in_folder(folder))
    assert str(folder / "report.html") in text
    assert "model.json" in text
    assert "model" not in printed(show_diagnosis_files, DiagnosisFiles.in_folder(tmp_path / "x", model=None)).replace(
        str(tmp_path), ""
    )
