"""Effects at places: names, numbers, local values, directions, effects of one's own."""

import math
from dataclasses import dataclass

import numpy as np
import pytest

from modal.discrepancy.catalogue import CATALOGUE
from modal.discrepancy.effect_units import composed_unit, parameter_units
from modal.discrepancy.effects.cubic_stiffness import CubicStiffness
from modal.discrepancy.placed import PlacedEffect, placed_effect
from modal.discrepancy.state_space_plant import state_space_plant
from modal.discrepancy.structural_plant import structural_plant
from modal.structure import StructuralModel
from okid.errors import InvalidDataError

CHAIN = StructuralModel.chain([1.0, 2.0], [300.0, 200.0], [0.1, 0.2], force_dofs=0, sensor_dofs=[0, 1])


@dataclass(frozen=True, slots=True, kw_only=True)
class OwnEffect(CubicStiffness):
    """An effect that is not in the catalogue."""

    key = "own_effect"


class System:
    """Two masses with both displacements measured; one pushes the other by a feedback, so that directions are open."""

    dt = 0.0
    A = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-500.0, 200, -0.3, 0.0], [-100, -100, 0.0, -0.1]])
    B = np.array([[0.0], [0.0], [1.0], [0.0]])
    C = np.eye(4)[:2]
    D = np.zeros((2, 1))


def test_every_effect_of_the_catalogue_finds_a_place_or_says_that_there_is_none() -> None:
    plant = structural_plant(CHAIN)
    placed = []
    for key, effect in CATALOGUE.items():
        values = dict(zip([kind.name for kind in effect.parameters], effect.neutral, strict=True))
        where = {"input": "input_0", "sensor": "output_1"}.get(key.split("_")[0], "element_0")
        if key in {"power_law_flow", "overflow"}:
            with pytest.raises(InvalidDataError, match="can act at no place of this model"):
                placed_effect(plant, key, where, values)
        else:
            one = placed_effect(plant, key, where, values)
            assert one.values == tuple(float(value) for value in effect.neutral)
            placed.append(key)
    assert len(placed) == len(CATALOGUE) - 2


def test_local_values() -> None:
    plant = structural_plant(CHAIN)
    one = placed_effect(
        plant, "periodic_disturbance", "dof_1", {"amplitude": 2.0, "frequency": 5.0, "phase": [0.1, 0.4, 0.7]}
    )
    assert one.local_values == ((), (), (0.1, 0.4, 0.7))
    assert one.value("phase") == pytest.approx(0.4)
    shared = placed_effect(
        plant, "periodic_disturbance", "dof_1", {"amplitude": 2.0, "frequency": 5.0, "phase": np.float64(0.3)}
    )
    assert shared.local_values == ((), (), ())
    assert shared.values == (2.0, 5.0, 0.3)


def test_deviations() -> None:
    one = placed_effect(structural_plant(CHAIN), "cubic_stiffness", "element_1", {"k3": 5.0}, deviations={"k3": 0.2})
    assert one.deviations == (0.2,)
    plain = placed_effect(structural_plant(CHAIN), "cubic_stiffness", "element_1", {"k3": 5.0})
    assert math.isnan(plain.deviations[0])
    with pytest.raises(InvalidDataError, match="cubic_stiffness has no parameter k4"):
        placed_effect(structural_plant(CHAIN), "cubic_stiffness", "element_1", {"k3": 5.0}, deviations={"k4": 0.2})


def test_directions() -> None:
    plant = state_space_plant(System(), sensor_kind="displacement")
    n_columns = len(plant.port("output_1").columns)
    assert n_columns == 2
    one = placed_effect(plant, "cubic_stiffness", "output_1", {"k3": 5.0}, direction=[1.0, -0.5])
    assert one.direction == (1.0, -0.5)
    for wrong in ([1.0], [2.0, 1.0], [1.0, float("inf")]):
        with pytest.raises(InvalidDataError, match=r"output_1 has 2 finite components of which the first is 1, but \["):
            placed_effect(plant, "cubic_stiffness", "output_1", {"k3": 5.0}, direction=wrong)


def test_a_shaft_is_no_place_for_what_needs_a_displacement() -> None:
    shaft = StructuralModel([[1.0]], [[0.5]], [[0.0]], force_map=[[1.0]], sensor_map=[[1.0]], sensor_kind="velocity")
    with pytest.raises(InvalidDataError, match="cubic_stiffness can act at no place of this model"):
        shaft.with_effect("cubic_stiffness", "element_0", k3=1.0)
    shaft.with_effect("quadratic_drag", "element_0", c2=1.0)


def test_an_effect_of_ones_own() -> None:
    model = CHAIN.with_effect(OwnEffect(), "element_1", k3=4.0)
    assert model.effects[0].effect == "own_effect"


def test_counts_must_agree() -> None:
    with pytest.raises(InvalidDataError, match="has 2 parameters, but 1 values"):
        PlacedEffect(effect="gap_spring", where="element_0", names=("k_out", "gap"), values=(1.0,))
    with pytest.raises(KeyError):
        PlacedEffect(effect="cubic_stiffness", where="a", names=("k3",), values=(1.0,)).value("k2")


@pytest.mark.parametrize(
    ("dimension", "force", "length", "unit"),
    [
        ((1, -2, 2), "N", "m", "N s^2/m^2"),
        ((1, -1, -1), "N", "m", "N/(m s)"),
        ((0, 1, 0), "N", "m", "m"),
        ((0, 0, 0), "N", "m", ""),
        ((1, -2, 2), "N m", "rad", "N m s^2/rad^2"),
        ((1, -1, 0), "m/s^2", "m", "(m/s^2)/m"),
        ((1, 0, 0), "m/s^2", "m", "m/s^2"),
        ((1, 0, -1), "V", "", "V/s"),
        ((0, 0, 1), "N", "m", "s"),
        ((1, 0, 0), "", "m", ""),
    ],
)
def test_units(dimension: tuple[int, int, int], force: str, length: str, unit: str) -> None:
    assert composed_unit(dimension, force_unit=force, length_unit=length) == unit


def test_units_at_a_place() -> None:
    plant = structural_plant(
        StructuralModel.chain(
            [1.0], [1.0], [1.0], force_dofs=0, sensor_dofs=0, length_unit="rad", force_unit="N m", output_units=["deg"]
        )
    )
    assert parameter_units(plant, CATALOGUE["cubic_stiffness"], "element_0") == ("N m/rad^3",)
    assert parameter_units(plant, CATALOGUE["sensor_bias"], "output_0") == ("deg", "deg/s")
    assert parameter_units(plant, CATALOGUE["input_saturation"], "input_0") == ("N m",)
    with pytest.raises(KeyError):
        parameter_units(plant, CATALOGUE["cubic_stiffness"], "output_0")
