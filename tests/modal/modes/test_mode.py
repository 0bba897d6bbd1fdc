"""The type that carries standard deviations: shapes, intervals, refusals."""

import csv
import json
import re
from dataclasses import replace

import numpy as np
import pytest

from modal.identification.words import frequency_text
from modal.modes.mode import Uncertainty, numbered
from modal.recording.plan import planned
from modal.report.machine import csv_text, json_text
from modal.report.pages import html_text, markdown_text
from modal.sections.validation import Provenance
from okid.errors import InvalidDataError


def make(**changes):
    fields = {
        "method": "propagation",
        "frequency_std": np.array([0.1, 0.2]),
        "damping_ratio_std": np.array([0.01, np.nan]),
        "shape_std": np.zeros((2, 3)),
        "markov_std": np.ones((5, 3, 1)),
    }
    return Uncertainty(**(fields | changes))


def test_arrays_are_frozen():
    known = make()
    for name in ("frequency_std", "damping_ratio_std", "shape_std", "markov_std"):
        assert not getattr(known, name).flags.writeable


@pytest.mark.parametrize(
    "changes",
    [
        {"damping_ratio_std": np.zeros(3)},
        {"shape_std": np.zeros((1, 3))},
        {"markov_std": np.zeros((5, 3))},
        {"degrees_of_freedom": 0.0},
        {"degrees_of_freedom": np.nan},
    ],
)
def test_parts_that_do_not_fit_together_are_refused(changes):
    with pytest.raises(InvalidDataError):
        make(**changes)


def test_interval_factors_are_those_of_the_tables():
    """Two-sided quantiles of the normal distribution and of Student's t (Abramowitz, Stegun, table 26.10)."""
    assert make().interval_factor() == pytest.approx(1.959964, abs=1e-6)
    assert make().interval_factor(0.99) == pytest.approx(2.575829, abs=1e-6)
    assert make(degrees_of_freedom=10.0).interval_factor(0.95) == pytest.approx(2.228, abs=5e-4)
    assert make(degrees_of_freedom=1.0).interval_factor(0.5) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("level", [0.0, 1.0, 95.0, np.nan])
def test_a_level_that_is_no_probability_is_refused(level):
    with pytest.raises(InvalidDataError, match="between 0 and 1"):
        make().interval_factor(level)


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
