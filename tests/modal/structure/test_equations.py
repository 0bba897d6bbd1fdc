"""The printed equations say what the matrices hold: they are read back and compared."""

import re
from dataclasses import dataclass

import numpy as np
import pytest

from modal.discrepancy import register
from modal.effects.springs import CubicStiffness
from modal.structure.given import PlantModel, simulate
from modal.structure.placed import equations_of_plant, equations_of_structure, linear_sum
from modal.structure.structural_model import StructuralModel
from okid.errors import InvalidDataError

CHAIN = StructuralModel.chain(
    [1.5, 0.8], [900.0, 700.0], [0.9, 0.4], force_dofs=[1], sensor_dofs=[0, 1], sensor_kind=("displacement", "velocity")
)


def coefficients(text: str) -> dict[str, float]:
    """{name: coefficient} of a printed sum."""
    found = {}
    for sign, size, name in re.findall(r"([+-]?)\s*(?:([\d.]+(?:e[+-]?\d+)?) )?([a-z]\w*'*)", text):
        found[name] = float(size or 1.0) * (-1.0 if sign == "-" else 1.0)
    return found


def test_rows_are_those_of_the_matrices() -> None:
    lines = equations_of_structure(CHAIN).splitlines()
    for i in range(2):
        left, right = next(line for line in lines if f"DOF {i}:" in line).split(":")[1].split("=")
        wanted = {}
        for matrix, primes in ((CHAIN.mass, "''"), (CHAIN.damping, "'"), (CHAIN.stiffness, "")):
            wanted |= {f"x{j}{primes}": matrix[i, j] for j in range(2) if matrix[i, j] != 0}
        assert coefficients(left) == pytest.approx(wanted)
        assert right.strip() == ("input_0" if i == 1 else "0")
    assert lines[3:5] == ["  output_0 [m] = x0", "  output_1 [m/s] = x1'"]


def test_forces_stand_on_the_left_of_both_ends() -> None:
    model = CHAIN.with_effect("cubic_stiffness", "element_1", k3=2e5).with_effect("coulomb_friction", "dof_0", Fc=0.5)
    text = equations_of_structure(model)
    lines = text.splitlines()
    assert coefficients(lines[1].split(":")[1].split("=")[0])["f1"] == -1.0
    assert coefficients(lines[1].split(":")[1].split("=")[0])["f2"] == 1.0
    assert coefficients(lines[2].split(":")[1].split("=")[0])["f1"] == 1.0
    assert "f1 [N]: cubic_stiffness at element_1, f = k3 d^3; d = -x0 + x1, v = d'" in text
    assert "    k3 = 200000 N/m^3 (cubic stiffness)" in text
    assert "f2 [N]: coulomb_friction at element_0, f = Fc sign(v); d = x0, v = d'" in text


def test_base_motion_and_inputs_and_sensors() -> None:
    model = StructuralModel.chain(
        [2.0, 3.0],
        [5.0, 7.0],
        [0.1, 0.2],
        force_dofs=(),
        sensor_dofs=[1],
        sensor_kind="acceleration",
        base_motion=np.ones((2, 1)),
        input_names=["ground"],
    )
    text = model.with_effect("sensor_bias", "output_0", offset=0.1, slope=0.0).equations()
    assert "= -3 ground" in text
    assert "output_0 [m/s^2] = x1'' + ground" in text
    assert "  output_0: sensor_bias, y' = y + offset + slope t" in text
    assert "    offset = 0.1 m/s^2 (what is added at the start of a record)" in text


def test_a_shaft_has_a_velocity() -> None:
    shaft = StructuralModel(
        [[2e-4]],
        [[1e-3]],
        [[0.0]],
        force_map=[[0.02]],
        sensor_map=[[1.0]],
        sensor_kind="velocity",
        length_unit="rad",
        force_unit="N m",
    )
    text = shaft.with_effect("quadratic_drag", "element_0", c2=3e-6).equations()
    assert "DOF 0: 0.0002 x0'' + 0.001 x0' + f1 = 0.02 input_0" in text
    assert "v = x0'" in text
    assert "c2 = 3e-06 N m s^2/rad^2 (drag coefficient)" in text


def test_values_of_each_record() -> None:
    model = CHAIN.with_effect("periodic_disturbance", "dof_1", amplitude=1.0, frequency=3.0, phase=[0.25, 0.5])
    assert "phase = 0.25, 0.5 (one a record) (angle at the start of each record)" in model.equations()
    assert "frequency = 3 Hz" in model.equations()


def test_a_plant_prints_its_state_equations() -> None:
    class System:
        A, B = np.array([[0.0, 1.0], [-100.0, -0.4]]), np.array([[0.0], [1.0]])
        C, D, dt = np.array([[1.0, 0.0]]), np.zeros((1, 1)), 0.0

    model = PlantModel.from_state_space(System(), sensor_kind="displacement", output_units=["m"])
    model = model.with_effect("coulomb_friction", "output_0", Fc=0.02)
    lines = equations_of_plant(model).splitlines()
    matrices = model.matrices
    for i in range(2):
        found = coefficients(lines[1 + i].split("=")[1])
        wanted = [*matrices.A[i], matrices.B[i, 0], matrices.E[i, 0]]
        names = ["x0", "x1", "input_0", "f1"]
        assert [found.get(name, 0.0) for name in names] == pytest.approx(wanted, rel=1e-5, abs=1e-12)
    assert "Fc = 0.02 m/s^2 (friction force)" in lines[-1]


def test_sums() -> None:
    assert linear_sum([-1.0, 2.0], ["a", "b"]) == "-a + 2 b"
    assert linear_sum([], []) == "0"


@dataclass(frozen=True, slots=True, kw_only=True)
class Mine(CubicStiffness):
    key = "mine"


def test_an_effect_of_ones_own_needs_its_catalogue_and_that_is_said() -> None:
    mine, same = (
        CHAIN.with_effect(Mine(), "element_1", k3=2e5),
        CHAIN.with_effect("cubic_stiffness", "element_1", k3=2e5),
    )
    catalogue = register(Mine())
    assert mine.equations(catalogue=catalogue) == same.equations().replace("cubic_stiffness", "mine")
    drive = np.random.default_rng(1).standard_normal((200, 1))
    found = simulate(mine, drive, dt=0.01, catalogue=catalogue)
    np.testing.assert_array_equal(found.outputs, simulate(same, drive, dt=0.01).outputs)
    for call in (mine.equations, lambda: simulate(mine, drive, dt=0.01)):
        with pytest.raises(InvalidDataError, match=r"no effect 'mine' in the catalogue; pass catalogue=.*\.$"):
            call()
