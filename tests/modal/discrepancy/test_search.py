"""The beam on a made-up landscape of models."""

import pytest
from made_up_nodes import made_up, made_up_task

from modal.discrepancy import search as module
from modal.discrepancy.search import BEAM, MOST_EFFECTS, search_effects


def _held_out(level):
    return level[0] if isinstance(level, tuple) else level


def _fit(level):
    return level[1] if isinstance(level, tuple) else None


def landscape(levels):
    """`expand` on a table {effects: {effect added: level or (held-out, fit)}}, and what it was called with."""
    asked = []

    def expand(node, task):
        keys = tuple(key for key, _ in node.effects)
        asked.append(keys)
        return [made_up(_held_out(level), *keys, key, fit=_fit(level)) for key, level in levels.get(keys, {}).items()]

    return expand, asked


@pytest.fixture
def beam(monkeypatch):
    def run(levels, root=50.0, said=None):
        expand, asked = landscape(levels)
        monkeypatch.setattr(module, "expand", expand)
        start = made_up(root)
        found = search_effects(start, made_up_task(said))
        assert found[0] is start
        return [tuple(key for key, _ in node.effects) for node in found], asked

    return run


def test_it_stops_where_the_floor_is_reached(beam):
    found, asked = beam(
        {(): {"cubic_stiffness": 1.1, "quadratic_drag": 30.0}, ("cubic_stiffness",): {"gap_spring": 1.0}}
    )
    assert found == [(), ("cubic_stiffness",), ("quadratic_drag",)]
    assert asked == [()]


def test_a_pair_is_found_that_the_best_single_effect_is_not_part_of(beam):
    """The best of three comes first; the right pair starts from the third. Greedily it would be missed."""
    levels = {
        (): {"gap_spring": 10.0, "bilinear_stiffness": 12.0, "cubic_stiffness": 15.0, "constant_force": 20.0},
        ("gap_spring",): {"quadratic_drag": 9.5},
        ("cubic_stiffness",): {"quadratic_drag": 1.05},
        ("constant_force",): {"quadratic_drag": 1.0},
    }
    found, asked = beam(levels)
    assert ("cubic_stiffness", "quadratic_drag") in found
    assert asked == [(), ("gap_spring",), ("bilinear_stiffness",), ("cubic_stiffness",)]
    assert len(asked) == 1 + BEAM


def test_models_that_do_not_count_are_kept_but_not_followed(beam):
    found, asked = beam({(): {"cubic_stiffness": 49.0, "gap_spring": None}})
    assert found == [(), ("cubic_stiffness",), ("gap_spring",)]
    assert asked == [()]


def test_of_two_effects_that_counteract_the_right_one_is_followed_although_alone_it_is_worse(beam):
    levels = {
        (): {"cubic_stiffness": 20.0, "gap_spring": (60.0, 20.0), "input_gain": (55.0, 30.0)},
        ("gap_spring",): {"input_saturation": 1.0},
    }
    found, asked = beam(levels)
    assert ("gap_spring", "input_saturation") in found
    assert asked == [(), ("cubic_stiffness",), ("gap_spring",)]  # the gain takes away less than half


def test_the_beam_has_room_for_no_more_than_three(beam):
    levels = {
        (): {
            "cubic_stiffness": 20.0,
            "gap_spring": (60.0, 20.0),
            "quadratic_drag": (70.0, 20.0),
            "bilinear_stiffness": (80.0, 5.0),
        }
    }
    _, asked = beam(levels)
    assert asked == [(), ("cubic_stiffness",), ("gap_spring",), ("quadratic_drag",)]


def test_a_model_that_escapes_is_not_followed_however_well_it_fits(beam):
    _, asked = beam({(): {"cubic_stiffness": (None, 1.0)}})
    assert asked == [()]


def test_the_same_set_in_another_order_is_followed_once(beam):
    levels = {
        (): {"cubic_stiffness": 20.0, "quadratic_drag": 21.0},
        ("cubic_stiffness",): {"quadratic_drag": 5.0},
        ("quadratic_drag",): {"cubic_stiffness": 5.1},
    }
    _, asked = beam(levels)
    assert asked.count(("cubic_stiffness", "quadratic_drag")) == 1
    assert ("quadratic_drag", "cubic_stiffness") not in asked


def test_it_ends_at_the_most_effects(beam):
    keys = ("cubic_stiffness", "quadratic_drag", "gap_spring", "constant_force", "bilinear_stiffness", "input_gain")
    levels = {keys[:n]: {keys[n]: 1000.0 / 5.0 ** (n + 1)} for n in range(6)}
    found, asked = beam(levels, root=1000.0)
    assert max(len(effects) for effects in found) == MOST_EFFECTS
    assert len(asked) == MOST_EFFECTS


def test_a_model_at_the_floor_is_still_looked_at_once(beam):
    _, asked = beam({}, root=1.0)
    assert asked == [()]


def test_progress_is_told_in_words(beam):
    said = []
    beam({(): {"cubic_stiffness": 10.0}, ("cubic_stiffness",): {"quadratic_drag": 1.0}}, said=said)
    assert said[0] == ("looking for effect 1 beside the linear model", 0.0)
    assert said[1][0] == "looking for effect 2 beside cubic_stiffness at ground"
    assert 0.0 < said[1][1] < 1.0
