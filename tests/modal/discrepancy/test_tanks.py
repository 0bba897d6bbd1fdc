"""The whole workflow on a tank: a brim as hard as a wall, a soft one, a pump at its end, a free outlet, nothing."""

import control
import numpy as np
import pytest
from brim_tank import levels, staircase

from modal.discrepancy.diagnosis import diagnose
from okid.record import Record

P, DT, LIMIT, NOISE = 0.5, 0.05, 2.2, 0.01


def records(*, limit=np.inf, rate=np.inf, most=np.inf, outlet=None):
    """Two records to fit and one held out."""
    rng = np.random.default_rng(9)
    found = []
    for seed, low, high in ((0, 0.2, 1.0), (1, 0.3, 2.0), (2, 0.25, 1.7)):
        inflow = staircase(900, seed, low=low, high=high)
        acting = np.minimum(inflow, most)
        level = levels(acting, DT, p=P, limit=limit, rate=rate) if outlet is None else drained(acting, outlet)
        noisy = level + NOISE * rng.standard_normal(len(level))
        found.append(Record(inflow[:, None], noisy[:, None], DT, input_hold="zero_order"))
    return found[:2], found[2]


def drained(inflow, outlet, parts=200):
    """A tank that drains by outlet sqrt(h), in small Euler steps."""
    h, found = 1.0, []
    for q in inflow:
        found.append(h)
        for _ in range(parts):
            h += DT / parts * (q - outlet * np.sqrt(h))
    return np.array(found)


def found_in(**truth):
    model = control.ss([[-1.15 * P]], [[1.0]], [[1.0]], [[0.0]])
    fit, held_out = records(**truth)
    return diagnose(model, fit, held_out, sensor_kind="displacement")


@pytest.mark.parametrize("rate", [np.inf, 40.0, 2.0])
def test_a_brim_is_named_with_its_limit_however_hard_it_is(rate):
    found = found_in(limit=LIMIT, rate=rate)
    assert found.status == "named"
    (finding,) = found.findings
    assert finding.effect == "overflow"
    by_name = {one.name: one for one in finding.parameters}
    limit = by_name["limit"]
    assert abs(limit.value - LIMIT) < 3.0 * limit.std
    assert limit.std < 0.01
    if rate == 2.0:
        assert abs(by_name["rate"].value - rate) < 3.0 * by_name["rate"].std
    assert np.mean(found.gap_after**2) == pytest.approx(NOISE**2, rel=0.15)


@pytest.mark.parametrize(
    ("truth", "name"), [({"most": 1.2}, "input_saturation"), ({"outlet": 0.7}, "power_law_flow"), ({}, None)]
)
def test_what_is_no_brim_is_not_taken_for_one(truth, name):
    found = found_in(**truth)
    assert found.status == ("none" if name is None else "named")
    assert [finding.effect for finding in found.findings] == ([] if name is None else [name])
