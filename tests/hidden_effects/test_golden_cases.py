"""Sixty hidden cases from door to door: `diagnose` sees a wrong model and records, and finds what was hidden.

The cases are made by an integrator of their own, with sharp laws; models and records go in through public names only.
The seeds stand in no table of `modal/docs/discrepancy_confusion.md`. Nothing here is the product's own output: the
truth is the generator's.
"""

import warnings

import hidden_scoring
import numpy as np
import pytest
from hidden_cases import hidden_case
from hidden_kinds import KINDS

from modal.discrepancy import diagnose

NAMED = {
    "1dof_displacement": (*range(3000, 3013), *range(3014, 3018)),
    "1dof_accelerometer": (3001, 3004, 3005, 3006, 3007, 3010),
    "motor_propeller": (3000, 3001, 3002, 3003),
    "motor_friction": (3002,),
    "tank": (3000, 3001),
    "3dof_displacement": (3004,),
    "3dof_accelerometers": (3008,),
    "state_space": (3007,),
    "two_effects": (3004,),
    "weak_effects": (3000,),
}
"""Named firmly, at the right place, with the right parameters, and nothing left above the noise."""
NAMED_TOO = {
    "1dof_displacement": tuple(range(3019, 3023)),
    "1dof_accelerometer": (3022,),
    "motor_propeller": (3005, 3010, 3011, 3012, 3017),
    "tank": (3002, 3003, 3004, 3005, 3006, 3008, 3011),
    "3dof_accelerometers": (3002,),
}
"""Effects of the table above once more, with other sizes, records and sensors."""
NOTHING_HIDDEN = {"motor_propeller": (3004, 3009), "none": (3001, 3003, 3004, 3010)}
NEVER_WRONG = {"1dof_displacement": (3013,)}
"""Too weak to be named for certain: a sine of which the records show hardly more than the cubic term."""

DRAWN_AGAIN = {("tank", 3005)}
"""All others pass the guards of the generator at their first draw, so that nothing need be marched twice."""


def each(table, marks=()):
    return [
        pytest.param(kind, seed, id=f"{kind}-{seed}", marks=marks) for kind, seeds in table.items() for seed in seeds
    ]


def diagnosed(kind, seed):
    """(the line of the confusion benchmark, the case)."""
    case = hidden_case(kind, seed, guarded=(kind, seed) in DRAWN_AGAIN)
    fit, held_out = hidden_scoring.records_of(case)
    options = hidden_scoring.options_of(case, diagnose)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = diagnose(hidden_scoring.model_of(case), fit, held_out, **options)
    return hidden_scoring.outcome(case, found, seconds=0.0), case


def most_left(case):
    """Five deviations of a mean square of as many noise values as the held-out record has."""
    return 1 + 5 * np.sqrt(2 / case.held_out[0].outputs.size)


def test_there_are_sixty():
    assert sum(len(each(table)) for table in (NAMED, NAMED_TOO, NOTHING_HIDDEN, NEVER_WRONG)) == 60
    every = {kind for table in (NAMED, NOTHING_HIDDEN) for kind in table}
    assert every == set(KINDS)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "seed"), [*each(NAMED), *each(NAMED_TOO), *each(NOTHING_HIDDEN), *each(NEVER_WRONG)])
def test_a_case_without_its_guards_is_the_same(kind, seed):
    whole, quick = hidden_case(kind, seed), hidden_case(kind, seed, guarded=(kind, seed) in DRAWN_AGAIN)
    for one, two in zip(whole.fit + whole.held_out, quick.fit + quick.held_out, strict=True):
        np.testing.assert_array_equal(one.outputs, two.outputs)


@pytest.mark.parametrize(("kind", "seed"), [*each(NAMED), *each(NAMED_TOO, pytest.mark.slow)])
def test_what_is_hidden_is_named(kind, seed):
    line, case = diagnosed(kind, seed)
    assert line["named_right"], (line["hidden"], line["found"])
    assert line["place_right"], (line["hidden"], line["found"])
    assert line["status"] == "named"
    assert line["surplus"] == 0
    assert 2 - most_left(case) < line["held_out_to_floor"] < most_left(case)
    for score in line["parameters"]:
        assert score["relative_error"] < score["tolerance"], score


@pytest.mark.parametrize(("kind", "seed"), each(NOTHING_HIDDEN))
def test_nothing_is_named_where_nothing_is_hidden(kind, seed):
    line, case = diagnosed(kind, seed)
    assert (line["status"], line["found"]) == ("none", [])
    assert 2 - most_left(case) < line["held_out_to_floor"] < most_left(case)


@pytest.mark.parametrize(("kind", "seed"), each(NEVER_WRONG))
def test_no_firm_name_is_wrong(kind, seed):
    line, _ = diagnosed(kind, seed)
    assert not line["firm"] or (line["named_right"] and line["place_right"]), (line["hidden"], line["found"])
