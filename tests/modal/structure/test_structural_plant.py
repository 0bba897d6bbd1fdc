"""The plant of a structure against the textbook: dynamic stiffness, sampled reference, exact derivatives."""

import numpy as np
import pytest
import scipy
from systems import chain_matrices, structure

from modal.simulation.plant import Plant, PlantMatrices, plant_matrices, with_masses
from modal.structure.given import PlantModel
from modal.structure.structural_model import StructuralModel
from modal.structure.structural_plant import Element, place_name, structural_plant
from okid.errors import InvalidDataError

MASSES, SPRINGS, DAMPERS = [1.5, 0.8, 1.1], [900.0, 700.0, 400.0], [0.9, 0.4, 0.3]


def nominal(plant: Plant) -> PlantMatrices:
    return plant_matrices(plant, plant.nominal)


def response(matrices: PlantMatrices, s: complex, *, forces: bool = False) -> np.ndarray:
    right, direct = (matrices.E, matrices.G) if forces else (matrices.B, matrices.D)
    return matrices.C @ np.linalg.solve(s * np.eye(len(matrices.A)) - matrices.A, right.astype(complex)) + direct


def dynamic_stiffness(mass: np.ndarray, damping: np.ndarray, stiffness: np.ndarray, s: complex) -> np.ndarray:
    return mass * s**2 + damping * s + stiffness


@pytest.mark.parametrize("kind", ["displacement", "velocity", "acceleration"])
def test_transfer_function_is_that_of_the_dynamic_stiffness(kind: str) -> None:
    model = StructuralModel.chain(MASSES, SPRINGS, DAMPERS, force_dofs=[2, 0], sensor_dofs=[0, 1, 2], sensor_kind=kind)
    matrices = nominal(structural_plant(model))
    power = {"displacement": 0, "velocity": 1, "acceleration": 2}[kind]
    mass, damping, stiffness = chain_matrices(MASSES, SPRINGS, DAMPERS)
    for s in (0.3 + 2.0j, 30j, -0.5 + 55j):
        exact = s**power * np.linalg.inv(dynamic_stiffness(mass, damping, stiffness, s))
        np.testing.assert_allclose(response(matrices, s), exact[:, [2, 0]], rtol=1e-9, atol=1e-14)


@pytest.mark.parametrize("kind", ["displacement", "velocity", "acceleration"])
def test_a_port_force_pulls_both_ends_of_its_element_together(kind: str) -> None:
    model = StructuralModel.chain(MASSES, SPRINGS, DAMPERS, force_dofs=0, sensor_dofs=[0, 1, 2], sensor_kind=kind)
    plant = structural_plant(model)
    assert [port.name for port in plant.ports] == ["element_0", "element_1", "element_2", "dof_1", "dof_2"]
    joins = np.array([[1, 0, 0], [-1, 1, 0], [0, -1, 1], [0, 1, 0], [0, 0, 1]]).T
    power = {"displacement": 0, "velocity": 1, "acceleration": 2}[kind]
    mass, damping, stiffness = chain_matrices(MASSES, SPRINGS, DAMPERS)
    s = 0.2 + 17j
    exact = -(s**power) * np.linalg.solve(dynamic_stiffness(mass, damping, stiffness, s), joins)
    np.testing.assert_allclose(response(nominal(plant), s, forces=True), exact, rtol=1e-9, atol=1e-14)
    state = np.random.default_rng(3).standard_normal(6)
    for index, port in enumerate(plant.ports):
        assert port.columns == (index,)
        np.testing.assert_allclose(port.displacement[:6] @ state, joins[:, index] @ state[:3])
        np.testing.assert_allclose(port.velocity[:6] @ state, joins[:, index] @ state[3:])


def test_a_spring_as_a_port_force_is_a_stiffer_element() -> None:
    """w = k d fed back at a port must give the plant whose element has k more."""
    softer = StructuralModel.chain(
        MASSES, SPRINGS, DAMPERS, force_dofs=1, sensor_dofs=[0, 2], sensor_kind="acceleration"
    )
    springs = [900.0, 700.0 + 55.0, 400.0]
    stiffer = StructuralModel.chain(
        MASSES, springs, DAMPERS, force_dofs=1, sensor_dofs=[0, 2], sensor_kind="acceleration"
    )
    plant, matrices = structural_plant(softer), nominal(structural_plant(softer))
    port = plant.port("element_1")
    column = list(port.columns)
    row = 55.0 * port.displacement[None, :6]
    wanted = nominal(structural_plant(stiffer))
    np.testing.assert_allclose(matrices.A + matrices.E[:, column] @ row, wanted.A, rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(matrices.C + matrices.G[:, column] @ row, wanted.C, rtol=1e-12, atol=1e-9)


def test_agrees_with_the_sampled_reference_system() -> None:
    mass, damping, stiffness = chain_matrices(MASSES, SPRINGS, DAMPERS)
    truth = structure(
        mass, damping, stiffness, force_dofs=[1], sensor_dofs=[0, 2], sensor_kinds=["velocity", "displacement"], dt=0.01
    )
    model = StructuralModel(
        mass,
        damping,
        stiffness,
        force_map=np.eye(3)[:, [1]],
        sensor_map=np.eye(3)[[0, 2]],
        sensor_kind=("velocity", "displacement"),
    )
    matrices = nominal(structural_plant(model))
    block = np.zeros((7, 7))
    block[:6] = np.hstack([matrices.A, matrices.B]) * 0.01
    sampled = scipy.linalg.expm(block)
    for lag in range(1, 30):
        powers = np.linalg.matrix_power(sampled[:6, :6], lag - 1)
        exact = truth.C @ np.linalg.matrix_power(truth.A, lag - 1) @ truth.B
        np.testing.assert_allclose(matrices.C @ powers @ sampled[:6, 6:], exact, rtol=1e-9, atol=1e-12)


def test_consistent_mass_matrix() -> None:
    mass = np.array([[2.0, 0.5], [0.5, 1.0]])
    _, damping, stiffness = chain_matrices([1.0, 1.0], [300.0, 200.0], [0.2, 0.1])
    model = StructuralModel(
        mass, damping, stiffness, force_map=np.eye(2), sensor_map=np.eye(2), sensor_kind="acceleration"
    )
    s = 4j
    exact = s**2 * np.linalg.inv(dynamic_stiffness(mass, damping, stiffness, s))
    np.testing.assert_allclose(response(nominal(structural_plant(model)), s), exact, rtol=1e-12)


def test_base_motion_relative_displacement_absolute_acceleration() -> None:
    """Against the same chain with the ground as a DOF of its own, moved by a prescribed acceleration."""
    mass, damping, stiffness = chain_matrices(MASSES, SPRINGS, DAMPERS)
    model = StructuralModel.chain(
        MASSES,
        SPRINGS,
        DAMPERS,
        force_dofs=(),
        sensor_dofs=[0, 2, 0, 2],
        sensor_kind=("displacement", "velocity", "acceleration", "acceleration"),
        base_motion=np.ones((3, 1)),
    )
    assert model.input_units == ("m/s^2",)
    s = 0.1 + 12j
    relative = -np.linalg.solve(dynamic_stiffness(mass, damping, stiffness, s), mass @ np.ones(3))
    absolute = s**2 * relative + 1.0
    exact = np.array([relative[0], s * relative[2], absolute[0], absolute[2]])[:, None]
    matrices = nominal(structural_plant(model))
    np.testing.assert_allclose(response(matrices, s), exact, rtol=1e-10)
    assert not matrices.D.any()


def test_a_shaft_has_a_velocity_only() -> None:
    shaft = StructuralModel(
        [[2e-4]], [[1e-3]], [[0.0]], force_map=[[0.02]], sensor_map=[[1.0]], sensor_kind="velocity", length_unit="rad"
    )
    plant = structural_plant(shaft)
    matrices = nominal(plant)
    assert plant.n_states == 1
    np.testing.assert_allclose([matrices.A[0, 0], matrices.B[0, 0], matrices.C[0, 0]], [-5.0, 100.0, 1.0])
    (port,) = plant.ports
    assert port.name == "element_0"
    assert port.displacement is None
    np.testing.assert_array_equal(port.velocity, [1.0, 0.0])
    np.testing.assert_allclose(matrices.E, [[-5000.0]])
    assert [parameter.name for parameter in plant.parameters] == ["damping of element_0"]


def test_a_displacement_sensor_keeps_the_integrator() -> None:
    shaft = StructuralModel(
        [[2.0]], [[0.1]], [[0.0]], force_map=[[1.0]], sensor_map=[[1.0]], sensor_kind="displacement"
    )
    plant = structural_plant(shaft)
    assert plant.n_states == 2
    np.testing.assert_array_equal(plant.ports[0].displacement, [1.0, 0.0, 0.0])


def test_a_free_chain_keeps_what_its_springs_need() -> None:
    model = StructuralModel.chain(
        [1.0, 2.0, 1.0], [0.0, 50.0, 0.0], [0.0, 0.1, 0.1], force_dofs=0, sensor_dofs=[0, 2], sensor_kind="velocity"
    )
    plant = structural_plant(model)
    assert plant.n_states == 5  # mass 2 hangs on a damper alone
    assert plant.port("element_2").displacement is None
    assert plant.port("element_1").displacement is not None
    mass, damping, stiffness = chain_matrices([1.0, 2.0, 1.0], [0.0, 50.0, 0.0], [0.0, 0.1, 0.1])
    exact = 3j * np.linalg.inv(dynamic_stiffness(mass, damping, stiffness, 3j))[[0, 2]][:, [0]]
    np.testing.assert_allclose(response(nominal(plant), 3j), exact, rtol=1e-9)


def test_ground_elements_are_the_port_of_their_dof() -> None:
    model = StructuralModel.chain(MASSES, SPRINGS, DAMPERS, force_dofs=0, sensor_dofs=0)
    assert place_name(model, "dof_0") == "element_0"
    assert place_name(model, "dof_1") == "dof_1"
    anchored = StructuralModel(
        *(np.array(matrix) for matrix in chain_matrices(MASSES, SPRINGS, DAMPERS)),
        force_map=np.eye(3),
        sensor_map=np.eye(3),
        sensor_kind="displacement",
        elements=(Element(name="guy", start=2), (0, 1), (0, 2)),
    )
    assert [port.name for port in structural_plant(anchored).ports] == [
        "guy",
        "element_1",
        "element_0-2",
        "dof_0",
        "dof_1",
    ]


def test_only_a_single_dof_carries_an_absorber() -> None:
    plant = structural_plant(StructuralModel.chain(MASSES, SPRINGS, DAMPERS, force_dofs=0, sensor_dofs=0))
    assert [port.name for port in plant.ports if "mass" in port.accepts] == ["element_0", "dof_1", "dof_2"]
    assert plant.port("element_1").stiffness == pytest.approx(700.0)
    assert plant.port("dof_1").mass == pytest.approx(0.8)


def test_released_masses_give_the_plant_of_the_heavier_structure() -> None:
    """Base motion and accelerometers too: everything that a mass enters."""
    mass = np.diag(MASSES) + 0.1 * (np.eye(3, k=1) + np.eye(3, k=-1))
    _, damping, stiffness = chain_matrices(MASSES, SPRINGS, DAMPERS)

    def plant_of(mass: np.ndarray) -> Plant:
        return structural_plant(
            StructuralModel(
                mass,
                damping,
                stiffness,
                force_map=[[1.0, 0.0], [0.0, 0.0], [0.0, 0.0]],
                sensor_map=np.eye(3),
                sensor_kind=("acceleration", "displacement", "acceleration"),
                base_motion=[[0.0, 1.0]] * 3,
            )
        )

    released = with_masses(plant_of(mass), ["mass of dof_2", "mass of dof_0"])
    assert [one.name for one in released.parameters[-2:]] == ["mass of dof_0", "mass of dof_2"]
    found = plant_matrices(released, np.append(released.nominal[:-2], [1.7, 0.9]))
    wanted = nominal(plant_of(mass + np.diag([0.2, 0.0, -0.2])))
    for name in "ABCDEG":
        np.testing.assert_allclose(getattr(found, name), getattr(wanted, name), rtol=1e-12, atol=1e-10)
    back = with_masses(released, [])
    assert [one.parameter.name for one in back.masses] == [f"mass of dof_{i}" for i in range(3)]
    np.testing.assert_allclose(nominal(back).A, nominal(plant_of(mass)).A, rtol=1e-12, atol=1e-10)


class System:
    """Two masses, both displacements measured."""

    dt = 0.0
    A = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-500.0, 200, -0.3, 0.2], [100, -100, 0.1, -0.1]])
    B = np.array([[0.0], [0.0], [1.0], [0.0]])
    C = np.eye(4)[:2]
    D = np.zeros((2, 1))


def model() -> PlantModel:
    return PlantModel.from_state_space(
        System(), sensor_kind="displacement", output_names=["low", "high"], output_units=["mm", "mm"], dt=0.01
    )


def test_matrices_at_the_nominal_and_at_other_parameters() -> None:
    plain = model()
    s = 3j
    m = plain.matrices
    exact = System.C @ np.linalg.solve(s * np.eye(4) - System.A, System.B.astype(complex))
    np.testing.assert_allclose(m.C @ np.linalg.solve(s * np.eye(4) - m.A, m.B.astype(complex)), exact, rtol=1e-10)
    moved = PlantModel(
        plain.plant, linear=plain.linear + 0.01 * np.array([p.deviation for p in plain.plant.parameters])
    )
    change = np.tensordot(moved.linear - plain.linear, plain.plant.system[1:, :4, :4], axes=(0, 0))
    np.testing.assert_allclose(moved.matrices.A, m.A + change, rtol=1e-10, atol=1e-10)
    assert not moved.linear.flags.writeable


def test_effects_are_added_to_a_copy() -> None:
    plain = model()
    found = plain.with_effect("coulomb_friction", "low-high", Fc=0.1).with_effect("sensor_gain", "high", gain=0.9)
    assert plain.effects == ()
    assert [one.where for one in found.effects] == ["low-high", "high"]
    assert repr(found) == (
        "PlantModel(4 states, inputs ['input_0'], outputs ['low', 'high'], with coulomb_friction at low-high, "
        "sensor_gain at high)"
    )
    assert "Fc = 0.1 mm/s^2" in found.equations()


def test_refuses() -> None:
    with pytest.raises(InvalidDataError, match=r"linear parameters must have shape \(6\), but has \(1,\)"):
        PlantModel(model().plant, linear=np.ones(1))
    with pytest.raises(
        InvalidDataError, match="there is no place 'roof'; cubic_stiffness can act at low, high, low-high"
    ):
        model().with_effect("cubic_stiffness", "roof", k3=1.0)
