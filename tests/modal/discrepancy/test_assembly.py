"""The layout of everything unknown."""

import numpy as np
import pytest
from engine_plants import VALUES, two_masses, with_effects

from modal.discrepancy.assembly import assemble, initial_unknowns, place_effect
from modal.discrepancy.catalogue import CATALOGUE

KEYS = ["cubic_stiffness", "missing_mode", "periodic_disturbance", "input_delay", "bouc_wen_hysteresis", "sensor_bias"]


def test_every_unknown_has_one_place():
    assembly, _ = with_effects(two_masses(), KEYS, 2, port="anywhere")
    common = [np.arange(assembly.n_linear), *(np.r_[assembly.common_of(i)] for i in range(6))]
    assert np.array_equal(np.concatenate(common), np.arange(assembly.n_common))
    own = [np.arange(4), *(np.r_[assembly.own_of(i)] for i in range(6))]
    assert np.array_equal(np.concatenate(own), np.arange(assembly.n_local))
    assert assembly.n_common == 2 + (1 + 1) + (3 + 1) + (2 + 1) + 1 + (3 + 1) + 2
    assert assembly.n_local == 4 + 2 + 1 + 1
    assert assembly.n_memory == 3
    states = [np.arange(4), *(np.r_[assembly.memory_of(i)] for i in range(6))]  # the plant's, then the effects' own
    assert np.array_equal(np.concatenate(states), np.arange(4 + assembly.n_memory))
    assert assembly.initial == (0, 1, 2, 3, 4, 5, 7)
    assert (assembly.forces, assembly.inputs, assembly.sensors) == ((0, 1, 2, 4), (3,), (5,))


def test_values_come_back_where_they_were_put():
    assembly, unknowns = with_effects(two_masses(), KEYS, 2, port="anywhere")
    for i, key in enumerate(KEYS):
        found = unknowns.values(assembly, i)
        for j, value in enumerate(found):
            if key == "periodic_disturbance" and j == 2:
                assert np.allclose(value, [VALUES[key][2], VALUES[key][2] + 0.7])
            else:
                assert value == VALUES[key][j]
    assert np.allclose(unknowns.directions(assembly, 1), [1.0, 0.4])
    assert np.array_equal(unknowns.directions(assembly, 3), [1.0])


def test_bounds_and_priors_stand_in_the_same_order():
    assembly, _ = with_effects(two_masses(), KEYS, 2, port="anywhere")
    lower, upper = assembly.bounds()
    centre, deviation = assembly.prior()
    assert np.array_equal(lower[:2], [60.0, 0.0])
    assert np.array_equal(upper[:2], [120.0, 4.0])
    assert np.array_equal(centre[:2], [90.0, 0.8])
    assert np.array_equal(deviation[:2], [9.0, 0.4])
    assert np.isinf(deviation[2:]).all()
    assert lower[assembly.common_of(3)] == -np.inf  # a delay: the channels may be skewed
    assert np.array_equal(lower[assembly.common_of(1)], [0.0, 0.0, 0.0, -np.inf])
    assert upper[assembly.common_of(1)][2] == 1.0
    own = assembly.local_deviation()
    assert np.isinf(own[:4]).all()
    assert np.allclose(own[assembly.own_of(1)], [0.2, 1.5])
    assert np.isinf(own[assembly.local_of(2)]).all()


def test_a_place_must_exist():
    plant = two_masses()
    for key, where in (("cubic_stiffness", "nowhere"), ("input_gain", "ground"), ("sensor_gain", "push")):
        with pytest.raises(KeyError):
            place_effect(plant, CATALOGUE[key], where)
    item = place_effect(plant, CATALOGUE["sensor_gain"], "acceleration")
    assert (item.channel, item.port, item.n_directions, item.n_memory) == (2, None, 0, 0)
    assert item.sensor_effect is CATALOGUE["sensor_gain"]
    effect, port = place_effect(plant, CATALOGUE["cubic_stiffness"], "between").force_and_port
    assert effect is CATALOGUE["cubic_stiffness"]
    assert port is plant.ports[1]


def test_records_start_at_rest_with_nominal_parameters():
    assembly = assemble(two_masses())
    found = initial_unknowns(assembly, 3)
    assert np.array_equal(found.common, [90.0, 0.8])
    assert found.local.shape == (3, 4)
    assert not found.local.any()
