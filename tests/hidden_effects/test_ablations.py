"""The ledger of mechanisms: each is a function of the product, is really taken out, and is put back."""

import importlib

import ablations
import pytest
from ablations import MECHANISMS, Mechanism, replaced, report, same, watched


def function_of(mechanism):
    module, _, name = mechanism.where.partition(":")
    return getattr(importlib.import_module(module), name)


@pytest.mark.parametrize("mechanism", MECHANISMS, ids=lambda one: one.name)
def test_a_mechanism_is_replaced_everywhere_and_put_back(mechanism):
    whole = function_of(mechanism)
    with replaced(mechanism, lambda original: (original, "instead")):
        assert function_of(mechanism) == (whole, "instead")
        holders = [importlib.import_module(name) for name in ("modal.discrepancy.selection.beam",)]
        assert all(value is not whole for holder in holders for value in vars(holder).values())
    assert function_of(mechanism) is whole


def test_a_watched_mechanism_counts_only_where_it_answers_otherwise(monkeypatch):
    from modal.discrepancy.selection import beam

    acting = Mechanism(says="", where="modal.discrepancy.selection.beam:_hopeful", off=lambda *_, **__: False)
    monkeypatch.setattr(beam, "_hopeful", lambda answer, _: answer)
    monkeypatch.setattr(ablations, "MECHANISMS", (acting,))
    acts = {}
    with watched(acts):
        answers = [beam._hopeful(answer, None) for answer in (True, False, True)]
    assert answers == [True, False, True]
    assert acts == {"hopeful": 2}


def test_answers_are_the_same_by_identity_or_plain_value():
    node, other = object(), object()
    assert same([node], (node,))
    assert not same([node], [other])
    assert not same([node], [])
    assert same(False, False)
    assert not same(None, node)
    assert same((["a"], []), (["a"], []))


def test_the_table_counts_what_is_lost():
    name = MECHANISMS[0].name
    cases = [["hidden", "tank", 1], ["hidden", "tank", 2], ["outside", "sinh", 1]]
    lines = [{"case": case, "without": "", "answer": "right", "seconds": 2.0, "acts": {name: 1}} for case in cases[:2]]
    lines.append({"case": cases[2], "without": "", "answer": "open", "seconds": 9.0, "acts": {}})
    lines.append({"case": cases[0], "without": name, "answer": "wrong", "seconds": 1.0})
    lines.append({"case": cases[1], "without": name, "answer": "right", "seconds": 1.0})
    table = report(lines).splitlines()
    assert table[0].startswith("3 cases, with all mechanisms: 2 right, 1 open, 0 wrong")
    assert "| 2 | 2 | 1; tank 1 | 0 | 1 | 0.50 |" in table[4]


@pytest.mark.parametrize(
    ("name", "kind", "seed", "answers"),
    [
        ("by_curve", "faint_quintic", 14000, ("right", "open")),
        ("found_as_known", "pendulum", 14000, ("right", "open")),
        ("cornered", "faint_quintic", 14010, ("open", "wrong")),
    ],
)
def test_a_mechanism_is_needed_by_its_case(name, kind, seed, answers):
    """The answers with it and without."""
    (mechanism,) = (one for one in MECHANISMS if one.name == name)
    assert ablations.answered("outside", kind, seed) == answers[0]
    with replaced(mechanism, lambda _: mechanism.off):
        assert ablations.answered("outside", kind, seed) == answers[1]
