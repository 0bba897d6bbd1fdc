"""What is done to a fitted model, on made-up estimates: when it is polished, or sought again."""

from types import SimpleNamespace

import pytest
from made_up_estimates import estimate_of, node_with

from modal.discrepancy import held_out as held_out_module
from modal.discrepancy import nodes as module
from modal.discrepancy.nodes import polished


@pytest.fixture
def task():
    return SimpleNamespace(fit="fit", held_out="held", fine_fit="fine fit", fine_held_out="fine held")


@pytest.mark.parametrize(("cost", "taken"), [(99.0, True), (101.0, False), (None, False)])
def test_a_finer_fit_is_taken_only_where_it_is_better(task, monkeypatch, cost, taken):
    finer = None if cost is None else estimate_of(1.0, "coulomb_friction", cost=cost)
    monkeypatch.setattr(module, "_finer", lambda *_args: finer)
    node = node_with(1.5, "coulomb_friction")
    assert (polished(node, task) is not node) == taken


@pytest.mark.parametrize(
    ("key", "polishes"),
    [
        ("coulomb_friction", True),
        ("overflow", True),
        ("gap_spring", True),
        ("slack_in_hysteresis", True),
        ("bilinear_stiffness", True),
        ("cubic_stiffness", False),
        ("input_saturation", False),
    ],
)
def test_only_laws_that_jump_or_have_corners_are_polished(task, monkeypatch, key, polishes):
    monkeypatch.setattr(module, "_finer", lambda *_args: estimate_of(1.0, key, cost=1.0))
    node = node_with(1.5, key)
    assert (polished(node, task) is not node) == polishes


@pytest.mark.parametrize(
    ("level", "twice", "blurred"),
    [
        (20.0, 20.5, False),
        (20.0, 23.0, True),
        (20.0, None, True),
        (50.0, 60.0, False),  # impacts change a little with anything
        (50.0, 120.0, True),
        (50.0, None, False),
    ],
)
def test_a_gap_that_smoothing_does_not_change_is_not_taken_for_smoothing(monkeypatch, level, twice, blurred):
    """A level in times of the floor, and what twice the smoothing makes of it."""
    monkeypatch.setattr(module, "simulate_at", lambda *_a, **_k: None if twice is None else estimate_of(twice))
    assert module._blurred(estimate_of(level, "coulomb_friction"), "fit") == blurred


def test_near_the_floor_smoothing_is_always_doubted(monkeypatch):
    monkeypatch.setattr(module, "simulate_at", lambda *_a, **_k: estimate_of(1.9))
    assert module._blurred(estimate_of(1.9, "coulomb_friction"), "fit")


@pytest.mark.parametrize(
    ("fit", "held_out", "doubtful"),
    [(1.0, 1.05, False), (1.0, 1.2, True), (1.0, 2700.0, True), (50.0, 60.0, True), (50.0, 6000.0, False)],
)
def test_held_out_records_in_another_basin(fit, held_out, doubtful):
    """At the floor on the records to fit, any excess on held-out ones may be a matter of their initial states."""
    assert held_out_module._doubtful(estimate_of(held_out), estimate_of(fit)) == doubtful
