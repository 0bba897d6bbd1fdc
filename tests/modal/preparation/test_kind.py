"""What kind of record is it: told from data that the product has not made, and never wrong in silence."""

import numpy as np
import pytest
from field_records import KINDS, random_records

from modal.preparation.kind import find_kind, given_kind
from okid.errors import InvalidDataError
from okid.record import Record


def made(kind, seed):
    truth = random_records(kind, seed)
    return [Record(u, y, truth.dt) for u, y in truth.records]


@pytest.mark.parametrize("kind", KINDS)
def test_kinds_are_told(kind):
    found = [find_kind(made(kind, seed)) for seed in range(500, 540)]
    assert all(one.kind == kind or one.warnings for one in found)
    assert sum(one.kind == kind and not one.warnings for one in found) >= 39


@pytest.mark.parametrize("noise", [0.0, 1e-3, 3e-2])
@pytest.mark.parametrize("count", [1, 3, 14])
def test_blows_under_noise(count, noise):
    rng = np.random.default_rng(count)
    force = noise * rng.standard_normal(5000)
    for start in rng.integers(0, 4990, count):
        force[start : start + 6] += np.sin(np.pi * np.arange(1, 7) / 7)
    found = find_kind([Record(force + 7.0, rng.standard_normal(5000), 0.01)])
    assert found.kind == "transient"
    assert found.choice.what == "record kind"


@pytest.mark.parametrize("draw", ["standard_normal", "laplace", "standard_t", "uniform"])
def test_heavy_tails_are_no_blows(draw):
    rng = np.random.default_rng(3)
    force = getattr(rng, draw)(*([3] if draw == "standard_t" else []), size=5000)
    assert find_kind([Record(force, rng.standard_normal(5000), 0.01)]).kind == "driven"


def test_undecided_says_so():
    rng = np.random.default_rng(0)
    force = np.where(np.arange(2000) % 500 < 62, rng.standard_normal(2000), 0.0)
    found = find_kind([Record(force, rng.standard_normal(2000), 0.01)])
    assert found.kind == "driven"
    assert "does not decide" in found.choice.reason
    assert 'kind="transient"' in found.warnings[0]


def test_records_without_inputs_must_be_alike():
    with pytest.raises(InvalidDataError, match="of one kind"):
        find_kind([Record([], one.outputs[:, :1], 0.01) for kind in ("decay", "ambient") for one in made(kind, 501)])


def test_what_the_caller_says():
    blow, free = made("transient", 500), made("decay", 500)
    assert find_kind(blow, "driven").choice.reason == "given as an argument"
    assert find_kind(free, "ambient").kind == "ambient"
    for records, kind in (
        (free, "driven"),
        (free, "transient"),
        (blow, "decay"),
        (blow, "ambient"),
        (blow, "response"),
    ):
        with pytest.raises(InvalidDataError, match=kind):
            find_kind(records, kind)
    with pytest.raises(InvalidDataError, match="kind must be one of"):
        given_kind("struck")
