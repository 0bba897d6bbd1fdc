"""The gallery in the docs: its scripts run, its pictures are there, its figures are those of the truth."""

import importlib
import re

import pytest

from modal.examples import many_records, three_storey_frame
from modal.examples.loose_joint import Frame
from modal.examples.motor_propeller import Motor
from modal.examples.struck_mass import StruckMass


@pytest.fixture(scope="module")
def page(repository):
    return (repository / "modal" / "docs" / "gallery.md").read_text(encoding="utf-8")


def test_the_five_stories_can_be_run(page):
    modules = set(re.findall(r"python -m (modal\.examples\.\w+)", page))
    assert len(modules) == 5
    assert all(callable(importlib.import_module(module).main) for module in modules)


def test_every_section_has_a_small_picture_and_every_link_a_target(page, repository):
    pictures = re.findall(r"!\[[^\]]+\]\((pictures/\w+\.png)\)", page)
    assert len(pictures) == len(set(pictures)) == page.count("\n## ") == 6
    for link in [*pictures, *re.findall(r"\]\(([\w./]+)\)", page)]:
        assert (repository / "modal" / "docs" / link).is_file(), link
    for picture in pictures:
        file = repository / "modal" / "docs" / picture
        assert file.read_bytes()[:4] == b"\x89PNG"
        assert file.stat().st_size < 150_000
    titles = {re.sub(r"[^\w-]", "", title.lower().replace(" ", "-")) for title in re.findall(r"\n## (.+)", page)}
    assert set(re.findall(r"\]\(#([\w-]+)\)", page)) == titles


def test_the_frame_of_the_page_is_the_frame_of_the_truth(page):
    truth = three_storey_frame.truth()
    rows = re.findall(r"^ +(\d) +([\d.]+) +([\d.]+) +([\d.]+) % +([\d.]+) % +([\d.]+)$", page, re.MULTILINE)
    assert len(rows) == 4
    for number, found, frequency, damping, _, assurance in rows:
        assert float(frequency) == pytest.approx(truth.frequencies[int(number) - 1], abs=6e-5)
        assert float(found) == pytest.approx(float(frequency), rel=1e-3)
        assert float(damping) == pytest.approx(0.8, rel=0.1)
        assert float(assurance) > 0.999


def test_the_shifts_of_the_page_hold_the_true_ones(page):
    true = 100 * (many_records.modules(loss=many_records.ROW.loss).modes()[0] / many_records.modules().modes()[0] - 1)
    rows = re.findall(r"\| ([+-][\d.]+) ± ([\d.]+) % \| (.+) \|", page)
    assert len(rows) == many_records.ROW.n_modules
    for (shift, width, verdict), expected in zip(rows, true, strict=True):
        assert float(shift) == pytest.approx(expected, abs=2 * float(width))
        assert (verdict == "beyond chance") == (expected < -0.1)


def test_what_the_page_calls_hidden_is_hidden(page):
    motor, frame, mass = Motor(), Frame(), StruckMass()
    hidden = {float(value) for value in re.findall(r"hidden ([\d.]+)", page)}
    expected = {1e7 * motor.drag, 1e3 * motor.loss, 766, 1e3 * frame.play, frame.brace / 1e3, 60}
    assert {round(value, 4) for value in expected} == {round(value, 4) for value in hidden}
    assert f"(true {mass.frequency:.4f})" in page
    assert f"(true {mass.damping_ratio:.4f})" in page
    assert f"hidden: joint {many_records.ROW.loosened + 1}, {100 * many_records.ROW.loss:.2f} %" in page
