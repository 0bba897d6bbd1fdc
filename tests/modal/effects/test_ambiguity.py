from typing import get_args

import pytest

from modal.effects.ambiguity import AMBIGUOUS, Circumstance, ambiguous_with
from modal.effects.catalogue import CATALOGUE

PAIRS = [  # the table of what cannot be told apart, and the classes by structure
    ("coulomb_friction", "quadratic_drag", "one_level"),
    ("gap_spring", "cubic_stiffness", "one_level"),
    ("bilinear_stiffness", "quadratic_stiffness", "one_level"),
    ("input_saturation", "input_gain", "one_level"),
    ("missing_mode", "periodic_disturbance", "one_level"),
    ("sensor_gain", "input_gain", "one_dof"),
    ("coulomb_friction", "constant_force", "one_way"),
    ("sensor_bias", "constant_force", "one_output"),
]


@pytest.mark.parametrize(("one", "other", "circumstance"), PAIRS)
def test_a_pair_stands_under_its_circumstance_only_and_both_ways(one, other, circumstance):
    for key, twin in ((one, other), (other, one)):
        under = [found.others(key) for found in ambiguous_with(key, circumstances=[circumstance])]
        assert any(twin in others for others in under)
        rest = set(get_args(Circumstance)) - {circumstance}
        assert not any(twin in found.others(key) for found in ambiguous_with(key, circumstances=rest))


def test_every_member_is_in_the_catalogue_and_every_class_says_when_and_what_separates():
    for found in AMBIGUOUS:
        assert set(found.effects) <= set(CATALOGUE)
        assert len(found.effects) + len(found.besides) >= 2
        assert found.circumstance in get_args(Circumstance)
        assert found.when
        assert found.separates


def test_no_effect_is_listed_beside_itself():
    for key in CATALOGUE:
        for found in ambiguous_with(key, circumstances=get_args(Circumstance)):
            assert key in found.effects
            assert key not in found.others(key)


def test_half_a_sample_of_delay_is_a_question_of_the_hold():
    assert not ambiguous_with("input_delay")
    (found,) = ambiguous_with("input_delay", circumstances=["half_a_sample"])
    assert "half a sample" in found.others("input_delay")[0]


def test_a_sensor_of_a_state_space_may_sit_on_another_mass():
    (found,) = ambiguous_with("sensor_gain", circumstances=["unknown_masses"])
    assert "mass" in found.others("sensor_gain")[0]
    assert not ambiguous_with("input_gain", circumstances=["unknown_masses"])


def test_an_unknown_effect_is_in_no_class():
    assert ambiguous_with("mine", circumstances=get_args(Circumstance)) == ()
