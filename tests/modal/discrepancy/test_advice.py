"""What cannot be told apart in these data, and the experiment that would tell."""

from dataclasses import replace
from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest
from engine_plants import two_masses
from engine_records import experiment, nominal

from modal.discrepancy.advice import advise, circumstances_of
from modal.discrepancy.ambiguity import Circumstance
from modal.discrepancy.catalogue import CATALOGUE
from modal.discrepancy.decision import Decision
from modal.discrepancy.drive import drive_of
from modal.discrepancy.structural_plant import structural_plant


def root_with(plant, records, states=None):
    drive = drive_of(records)
    if states is None:
        states = np.random.default_rng(0).standard_normal((drive.n_times, plant.n_states))
    trajectory = SimpleNamespace(states=states, drive=drive)
    return SimpleNamespace(coarse=SimpleNamespace(trajectory=trajectory))


def records():
    fit, _, _ = experiment(None, n_samples=100)
    return fit


def test_one_mass_with_one_sensor():
    plant = structural_plant(nominal())
    found = circumstances_of(plant, records(), root_with(plant, records()))
    assert {"one_dof", "one_output"} <= found
    assert not {"one_level", "one_way"} & found


def test_records_of_one_level():
    plant = structural_plant(nominal())
    first = records()[0]
    assert "one_level" in circumstances_of(plant, [first], root_with(plant, [first]))
    same = [first, replace(first, inputs=1.1 * first.inputs)]
    assert "one_level" in circumstances_of(plant, same, root_with(plant, same))


def test_a_shaft_that_turns_one_way():
    plant = structural_plant(nominal())
    drive = drive_of(records())
    forward = np.stack([np.zeros(drive.n_times), 3.0 + np.sin(np.arange(drive.n_times))], axis=1)
    assert "one_way" in circumstances_of(plant, records(), root_with(plant, records(), forward))


def test_the_masses_of_a_state_space_are_not_known():
    from chains import Chain

    from modal.discrepancy.state_space_plant import state_space_plant

    def given(chain):
        names = {name: getattr(chain.system, name) for name in "ABCD"}
        return state_space_plant(SimpleNamespace(**names, dt=0.0), sensor_kind="displacement")

    two, one, structure = given(Chain(1, 2, (0, 1), 0)), given(Chain(1, 1, (0,), 0)), structural_plant(nominal())
    assert "unknown_masses" in circumstances_of(two, records(), root_with(two, records()))
    # of one mass with one sensor all of that is one number
    assert "unknown_masses" not in circumstances_of(one, records(), root_with(one, records()))
    assert "unknown_masses" not in circumstances_of(structure, records(), root_with(structure, records()))


def test_two_masses_with_three_sensors_are_told_apart():
    from engine_plants import some_records

    plant = two_masses()
    found = circumstances_of(plant, some_records(plant), root_with(plant, some_records(plant)))
    assert not {"one_dof", "one_output"} & found


def decision(status, effects=(), runners=None, margins=None):
    node = SimpleNamespace(effects=effects)
    return Decision(
        status=status,
        node=node,
        runners=runners or (None,) * len(effects),
        margins=margins or (np.inf,) * len(effects),
        reasons=(),
    )


def test_ambiguous_effects_are_told_with_what_separates_them():
    one = decision("named", (("input_gain", "input_0"),))
    apart = advise(one, records(), frozenset())
    assert not [words for words in apart if "sensor gain" in words]
    together = advise(one, records(), frozenset({"one_dof"}))
    assert any("input gain at input_0 from sensor gain," in words and "second output" in words for words in together)


def test_a_runner_up_that_is_close_gets_its_experiment():
    runner = SimpleNamespace(effects=(("quadratic_drag", "element_0"),))
    one = decision("unresolved", (("coulomb_friction", "element_0"),), (runner,), (5.0,))
    assert any("from quadratic drag" in words and "level" in words for words in advise(one, records(), frozenset()))
    settled = decision("named", (("coulomb_friction", "element_0"),), (runner,), (5000.0,))
    assert not [words for words in advise(settled, records(), frozenset()) if "drag" in words]


def test_advice_has_no_keys():
    for status in ("named", "unresolved"):
        one = decision(status, (("coulomb_friction", "element_0"), ("sensor_bias", "output_0")))
        for words in advise(one, records(), frozenset(get_args(Circumstance))):
            assert not any(key in words for key in CATALOGUE if "_" in key)


def test_a_second_level_is_advised_once():
    told = frozenset({"one_level"})
    general = "Measure at a second level"
    friction = advise(decision("named", (("coulomb_friction", "element_0"),)), records(), told)
    assert len([words for words in friction if "level" in words]) == 1
    assert not [words for words in friction if words.startswith(general)]
    bias = advise(decision("named", (("sensor_bias", "output_0"),)), records(), told)
    assert len([words for words in bias if words.startswith(general)]) == 1


@pytest.mark.parametrize(("margin", "said"), [(1.0, True), (29.0, True), (31.0, False)])
def test_even_evidence_asks_for_what_separates(margin, said):
    runner = SimpleNamespace(effects=(("constant_force", "output_1"),))
    one = decision("named", (("sensor_bias", "output_0"),), (runner,), (margin,))
    words = advise(one, records(), frozenset())
    assert any("sensor bias at output_0 from constant force" in sentence for sentence in words) == said


@pytest.mark.parametrize(
    ("status", "words"),
    [("none", "stronger level than that of level 3"), ("unresolved", "register an effect of your own")],
)
def test_nothing_found(status, words):
    found = advise(decision(status), records(), frozenset())
    assert any(words in one for one in found)
    assert len(set(found)) == len(found)
    one_level = advise(decision(status), records(), frozenset({"one_level"}))
    assert any("second level" in one for one in one_level)
