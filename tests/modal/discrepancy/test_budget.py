"""A budget in CPU seconds: kept, and what is left untried is said."""

import time

import pytest
from everyday_mistakes import mistake

import modal
import okid
from modal.discrepancy import CATALOGUE, diagnose
from okid.errors import InvalidDataError


def given(catalogue=("cubic_stiffness", "quadratic_drag", "missing_mode", "gap_spring")):
    """A record that none of these effects explains."""
    case = mistake("record_offset", 1002)
    model = modal.StructuralModel.chain(
        case.masses, case.stiffnesses, case.dampings, force_dofs=[0], sensor_dofs=[0], sensor_kind="displacement"
    )
    records = [okid.Record(u, y, case.dt) for u, y in case.records]
    return (model, records[:-1], records[-1]), {key: CATALOGUE[key] for key in catalogue}


def test_a_search_ends_with_its_budget_and_says_so():
    road, catalogue = given()
    start = time.process_time()
    found = diagnose(*road, catalogue=catalogue, budget=1.0)
    assert time.process_time() - start < 6.0
    assert found.status == "unresolved"
    assert any("ended before every effect was tried" in words for words in found.warnings)


def test_a_budget_is_a_positive_number():
    road, catalogue = given()
    with pytest.raises(InvalidDataError, match="positive number of CPU seconds"):
        diagnose(*road, catalogue=catalogue, budget=0.0)
