"""The number of a mode is the same wherever it is shown."""

import csv
import json
import re
from dataclasses import replace

import pytest

from modal.identification.words import frequency_text
from modal.modes.mode import numbered
from modal.recording.plan import planned
from modal.report.machine import csv_text, json_text
from modal.report.pages import html_text, markdown_text
from modal.sections.provenance import Provenance


@pytest.fixture
def mixed(identification, make_result):
    """A noise pole below every mode of the system and a doubtful one between them, as records have them."""
    first, second, third, doubtful, noise, *_ = identification.modes.modes
    modes = (replace(noise, frequency=0.1), first, replace(doubtful, frequency=5.0), second, third)
    return make_result(modes=replace(identification.modes, modes=modes))


def test_system_first_then_doubtful_then_noise_each_by_frequency(mixed):
    found = [(number, mode.verdict, mode.frequency) for number, mode in numbered(mixed.modes)]
    assert found == [(number, mode.verdict, mode.frequency) for number, mode in numbered(reversed(mixed.modes.modes))]
    assert found == [
        (1, "system", 3.67),
        (2, "system", 11.1),
        (3, "system", 16.6),
        (4, "doubtful", 5.0),
        (5, "noise", 0.1),
    ]


def test_every_page_has_the_same_numbers(mixed):
    expected = {number: mode.frequency for number, mode in numbered(mixed.modes)}
    table = csv.DictReader(csv_text(mixed).splitlines())
    assert {int(row["mode"]): float(row["frequency"]) for row in table} == expected
    stored = json.loads(json_text(mixed, Provenance()))["modes"]["table"]
    assert {row["number"]: row["frequency"] for row in stored} == expected
    assert dict(enumerate((mode.frequency for mode in planned(mixed).modes), start=1)) == expected
    html = html_text(mixed, Provenance(), {})
    markdown = markdown_text(mixed, Provenance())
    for number, mode in numbered(mixed.modes):
        text = re.escape(frequency_text(mode))
        assert re.search(rf'<td class="n">{number}</td><td class="n">{text}</td>', html)
        assert re.search(rf"^\| {number} \| {text} \|", markdown, re.MULTILINE)
