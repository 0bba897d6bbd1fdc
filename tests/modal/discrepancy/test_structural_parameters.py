"""Which stiffnesses and dampings may be wrong, by how much, and what they change in the plant."""

import numpy as np
import scipy
from systems import chain_matrices

from modal.discrepancy.plant import Plant, PlantMatrices, plant_matrices
from modal.discrepancy.structural_parameters import updated_structure
from modal.discrepancy.structural_plant import structural_plant
from modal.structure import StructuralModel

MASSES, SPRINGS, DAMPERS = [1.5, 0.8, 1.1], [900.0, 700.0, 400.0], [0.9, 0.4, 0.3]


def nominal(plant: Plant) -> PlantMatrices:
    return plant_matrices(plant, plant.nominal)


def response(matrices: PlantMatrices, s: complex, *, forces: bool = False) -> np.ndarray:
    right, direct = (matrices.E, matrices.G) if forces else (matrices.B, matrices.D)
    return matrices.C @ np.linalg.solve(s * np.eye(len(matrices.A)) - matrices.A, right.astype(complex)) + direct


def dynamic_stiffness(mass: np.ndarray, damping: np.ndarray, stiffness: np.ndarray, s: complex) -> np.ndarray:
    return mass * s**2 + damping * s + stiffness


def test_system_is_affine_in_the_elements_with_exact_derivatives() -> None:
    def model(springs: list[float], dampers: list[float]) -> StructuralModel:
        return StructuralModel.chain(
            MASSES,
            springs,
            dampers,
            force_dofs=[0, 2],
            sensor_dofs=[0, 1, 2],
            sensor_kind=("acceleration", "velocity", "displacement"),
        )

    plant = structural_plant(model(SPRINGS, DAMPERS))
    assert [parameter.name for parameter in plant.parameters] == [
        *(f"stiffness of element_{e}" for e in range(3)),
        *(f"damping of element_{e}" for e in range(3)),
    ]
    np.testing.assert_allclose(plant.nominal, SPRINGS + DAMPERS, rtol=1e-12)
    for index in range(6):
        moved = np.array(SPRINGS + DAMPERS)
        moved[index] *= 1.7  # any step: the plant is affine
        wanted = nominal(structural_plant(model(list(moved[:3]), list(moved[3:]))))
        found = plant_matrices(plant, moved)
        for name in "ABECDG":
            np.testing.assert_allclose(getattr(found, name), getattr(wanted, name), rtol=1e-10, atol=1e-10)


def test_priors_and_bounds() -> None:
    model = StructuralModel.chain(
        [2.0, 1.0],
        [800.0, 100.0],
        [3.0, 0.0],
        force_dofs=0,
        sensor_dofs=0,
        stiffness_tolerance=0.2,
        damping_tolerance=1.0,
    )
    by_name = {parameter.name: parameter for parameter in structural_plant(model).parameters}
    stiffness, damping = by_name["stiffness of element_0"], by_name["damping of element_0"]
    assert (stiffness.unit, damping.unit) == ("N/m", "N s/m")
    np.testing.assert_allclose([stiffness.deviation, stiffness.lower, stiffness.upper], [160.0, 500.0, 1280.0])
    np.testing.assert_allclose([damping.deviation, damping.lower, damping.upper], [3.0, 0.75, 12.0])
    undamped = by_name["damping of element_1"]
    critical = 2 * np.sqrt(100.0 * (2.0 * 1.0 / 3.0))  # of the reduced mass of the two ends
    np.testing.assert_allclose([undamped.deviation, undamped.lower], [0.02 * critical, 0.0])
    np.testing.assert_allclose(undamped.upper, 3 * undamped.deviation)


def test_what_is_no_spring_network_is_uncertain_by_mode() -> None:
    """Two elements of a cantilever beam: bending couples displacements and rotations with both signs."""
    element = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]], dtype=float)
    inertia = np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]]) / 420
    stiffness, mass = np.zeros((6, 6)), np.zeros((6, 6))
    for first in (0, 2):
        stiffness[first : first + 4, first : first + 4] += element
        mass[first : first + 4, first : first + 4] += inertia
    stiffness, mass = stiffness[2:, 2:], mass[2:, 2:]
    damping = 0.01 * mass + 0.002 * stiffness
    model = StructuralModel(
        mass, damping, stiffness, force_map=np.eye(4)[:, [2]], sensor_map=np.eye(4)[[2]], sensor_kind="displacement"
    )
    plant = structural_plant(model)
    squares = scipy.linalg.eigh(stiffness, mass, eigvals_only=True)
    np.testing.assert_allclose(plant.nominal, [*squares, *(0.01 + 0.002 * squares)], rtol=1e-9)
    assert {port.name for port in plant.ports} >= {"dof_0", "dof_1", "dof_2", "dof_3"}
    moved = plant.nominal.copy()
    moved[1] *= 1.1
    moved[4] *= 2.0
    poles = np.linalg.eigvals(plant_matrices(plant, moved).A)
    wanted = np.concatenate([np.roots([1, c, k]) for c, k in zip(moved[4:], moved[:4], strict=True)])
    np.testing.assert_allclose(np.sort_complex(poles), np.sort_complex(wanted), rtol=1e-7)
    np.testing.assert_allclose(
        response(nominal(plant), 0.5j),
        np.linalg.inv(dynamic_stiffness(mass, damping, stiffness, 0.5j))[[2]][:, [2]],
        rtol=1e-9,
    )


def test_modal_damping_on_a_spring_chain() -> None:
    mass, _, stiffness = chain_matrices(MASSES, SPRINGS, DAMPERS)
    squares, shapes = scipy.linalg.eigh(stiffness, mass)
    damping = mass @ shapes @ np.diag([0.2, 3.0, 0.4]) @ shapes.T @ mass
    model = StructuralModel(
        mass, damping, stiffness, force_map=np.eye(3)[:, [0]], sensor_map=np.eye(3), sensor_kind="displacement"
    )
    plant = structural_plant(model)
    assert [element.name for element in model.elements] == ["element_0", "element_1", "element_2"]
    np.testing.assert_allclose(plant.nominal, [*SPRINGS, 0.2, 3.0, 0.4], rtol=1e-9)
    assert plant.parameters[-1].name == f"modal damping of mode 3 ({np.sqrt(squares[2]) / (2 * np.pi):.4g} Hz)"
    np.testing.assert_allclose(model.natural_frequencies, np.sqrt(squares) / (2 * np.pi), rtol=1e-9)


def test_undamped_modes_may_find_damping() -> None:
    mass = np.array([[2.0, 0.0], [0.0, 1.0]])
    stiffness = np.array([[300.0, 100.0], [100.0, 200.0]])
    model = StructuralModel(
        mass, np.zeros((2, 2)), stiffness, force_map=np.eye(2), sensor_map=np.eye(2), sensor_kind="velocity"
    )
    parameters = structural_plant(model).parameters
    dampings = [parameter for parameter in parameters if "damping" in parameter.name]
    natural = np.sqrt(scipy.linalg.eigh(stiffness, mass, eigvals_only=True))
    np.testing.assert_allclose([one.deviation for one in dampings], 0.04 * natural, rtol=1e-9)
    assert all(one.lower == 0.0 for one in dampings)


def test_an_updated_structure_is_the_plant_at_those_parameters() -> None:
    model = StructuralModel.chain(
        MASSES, SPRINGS, DAMPERS, force_dofs=1, sensor_dofs=[0, 2], sensor_kind="acceleration"
    )
    model = model.with_effect("coulomb_friction", "element_1", Fc=0.3)
    plant = structural_plant(model)
    linear = plant.nominal * np.array([1.05, 0.97, 1.0, 1.4, 0.7, 1.1])
    updated = updated_structure(model, linear)
    again = structural_plant(updated)
    np.testing.assert_allclose(again.nominal, linear, rtol=1e-12)
    for name in "ABECDG":
        wanted = getattr(plant_matrices(plant, linear), name)
        np.testing.assert_allclose(getattr(nominal(again), name), wanted, rtol=1e-10, atol=1e-10)
    assert updated.effects == model.effects
    np.testing.assert_allclose(updated.elements[1].stiffness, 0.97 * 700.0)


def test_an_updated_structure_of_modes() -> None:
    mass = np.array([[2.0, 0.0], [0.0, 1.0]])
    stiffness, damping = np.array([[300.0, 100.0], [100.0, 200.0]]), np.array([[0.3, 0.1], [0.1, 0.2]])
    model = StructuralModel(mass, damping, stiffness, force_map=np.eye(2), sensor_map=np.eye(2), sensor_kind="velocity")
    plant = structural_plant(model)
    linear = plant.nominal * np.array([1.1, 0.95, 1.5, 0.6])
    wanted = plant_matrices(plant, linear)
    np.testing.assert_allclose(
        nominal(structural_plant(updated_structure(model, linear))).A, wanted.A, rtol=1e-9, atol=1e-9
    )
