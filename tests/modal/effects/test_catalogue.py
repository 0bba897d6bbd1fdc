from dataclasses import dataclass

import numpy as np
import pytest

from modal.effects.catalogue import CATALOGUE, check_effect, register
from modal.effects.effect import ForceEffect, InputEffect, Motion, SensorEffect, Situation
from modal.effects.springs import CubicStiffness
from okid.errors import InvalidDataError

CONTRACT = {  # keys and parameter names that scripts outside read, in the order of the design
    "cubic_stiffness": ["k3"],
    "quadratic_stiffness": ["k2"],
    "bilinear_stiffness": ["kb"],
    "gap_spring": ["k_in", "k_out", "gap"],
    "coulomb_friction": ["Fc"],
    "quadratic_drag": ["c2"],
    "bouc_wen_hysteresis": ["a", "yield_displacement", "n"],
    "sine_softening": ["length_scale"],
    "slack_in_hysteresis": ["k", "yield_displacement", "slack"],
    "constant_force": ["offset"],
    "time_varying_stiffness": ["rate"],
    "missing_mode": ["mass_ratio", "frequency", "damping"],
    "input_delay": ["tau"],
    "input_saturation": ["limit"],
    "input_gain": ["gain"],
    "sensor_bias": ["offset", "slope"],
    "sensor_gain": ["gain"],
    "periodic_disturbance": ["amplitude", "frequency", "phase"],
    "power_law_flow": ["coefficient", "exponent", "linear"],
    "overflow": ["rate", "limit"],
    "stribeck_friction": ["Fc", "excess", "stribeck_velocity"],
    "smooth_stiffness": ["low", "high", *(f"force_{j}" for j in range(1, 8))],
    "smooth_damping": ["low", "high", *(f"force_{j}" for j in range(1, 8))],
    "actuator_lag": ["tau"],
    "sensor_lag": ["tau"],
    "record_offset": ["offset"],
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Quintic(CubicStiffness):
    key = "quintic_stiffness"


def random_situation():
    rng = np.random.default_rng(5)
    motion = Motion(
        displacement=rng.standard_normal(500),
        velocity=rng.standard_normal(500),
        time=0.01 * np.arange(500),
        memory=np.zeros((500, 0)),
        displacement_scale=1.0,
        velocity_scale=1.0,
    )
    return Situation(motion=motion, residual_frequencies=(3.0,), dt=0.01, longest=5.0)


def test_keys_their_order_and_the_names_of_parameters_are_a_contract():
    assert list(CATALOGUE) == list(CONTRACT)
    for key, effect in CATALOGUE.items():
        assert effect.key == key
        assert [kind.name for kind in effect.parameters] == CONTRACT[key]


@pytest.mark.parametrize("key", CONTRACT)
def test_every_effect_keeps_the_contract(key):
    effect = CATALOGUE[key]
    check_effect(effect)
    starts = effect.starts(random_situation())
    assert 1 <= len(starts) <= 12
    assert len(set(starts)) == len(starts)
    for start in starts:  # amplitudes enter linearly: one value will do
        assert all(v == 1.0 for v, kind in zip(start, effect.parameters, strict=True) if kind.role == "amplitude")


@pytest.mark.parametrize("key", CONTRACT)
def test_every_effect_says_what_it_is(key):
    effect = CATALOGUE[key]
    page = type(effect).__doc__
    assert "Confused with" in page
    assert "Reference" in page
    assert "Parameters:" in page
    for kind in effect.parameters:
        assert kind.name.rstrip("0123456789") in page
        assert kind.meaning


def test_the_catalogue_cannot_be_changed_in_place():
    with pytest.raises(TypeError):
        CATALOGUE["mine"] = Quintic()
    with pytest.raises(TypeError):
        del CATALOGUE["input_gain"]


def test_a_registered_effect_stands_in_a_new_catalogue_only():
    mine = register(Quintic())
    assert list(mine) == [*CATALOGUE, "quintic_stiffness"]
    assert "quintic_stiffness" not in CATALOGUE
    with pytest.raises(TypeError):
        mine["another"] = Quintic()
    with pytest.raises(InvalidDataError, match=r"already holds an effect 'quintic_stiffness'; give yours another key"):
        register(Quintic(), catalogue=mine)
    with pytest.raises(InvalidDataError, match="already holds"):
        register(CubicStiffness())
    assert list(register(Quintic(), catalogue={})) == ["quintic_stiffness"]


def test_every_effect_is_of_one_kind():
    kinds = {
        key: sum(isinstance(e, k) for k in (ForceEffect, InputEffect, SensorEffect)) for key, e in CATALOGUE.items()
    }
    assert set(kinds.values()) == {1}
    assert {key for key, e in CATALOGUE.items() if isinstance(e, InputEffect)} == {
        "input_delay",
        "input_saturation",
        "input_gain",
        "actuator_lag",
    }
    assert {key for key, e in CATALOGUE.items() if isinstance(e, SensorEffect)} == {
        "sensor_bias",
        "sensor_gain",
        "sensor_lag",
        "record_offset",
    }
