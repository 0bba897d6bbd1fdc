"""The plant of a state space: transfer function, displacement rows, directions of force, against chains in M, C, K."""

import numpy as np
import pytest
from containers import realisation_of
from systems import chain_matrices, random_system

from modal.simulation.plant import Plant, PlantMatrices, plant_matrices
from modal.structure.state_space_plant import state_space_plant
from okid.errors import InvalidDataError

MASSES, SPRINGS, DAMPERS = [1.5, 0.8, 1.1], [900.0, 700.0, 400.0], [0.9, 0.4, 0.3]


class StateSpace:
    """What the plant reads of a control.StateSpace."""

    def __init__(self, A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, dt: float = 0.0) -> None:
        self.A, self.B, self.C, self.D, self.dt = A, B, C, D, dt


def first_order_chain(
    kinds: list[str], dofs: list[int], *, mix: np.ndarray | None = None, feedback: float = 0.0
) -> StateSpace:
    """The chain in states [x; v], driven at DOF 1, seen in other states z = mix [x; v].

    A force on DOF 0 by the displacement of DOF 2 alone, `feedback`, is what no spring gives.
    """
    mass, damping, stiffness = chain_matrices(MASSES, SPRINGS, DAMPERS)
    stiffness[0, 2] += feedback
    lower = -np.linalg.solve(mass, np.hstack([stiffness, damping]))
    A = np.vstack([np.hstack([np.zeros((3, 3)), np.eye(3)]), lower])
    B = np.concatenate([np.zeros(3), np.linalg.solve(mass, [0.0, 1.0, 0.0])])[:, None]
    rows = {"displacement": np.eye(6)[:3], "velocity": np.eye(6)[3:], "acceleration": lower}
    C = np.array([rows[kind][dof] for kind, dof in zip(kinds, dofs, strict=True)])
    D = np.array([[B[3 + dof, 0] if kind == "acceleration" else 0.0] for kind, dof in zip(kinds, dofs, strict=True)])
    mix = np.eye(6) if mix is None else mix
    return StateSpace(mix @ A @ np.linalg.inv(mix), mix @ B, C @ np.linalg.inv(mix), D)


def nominal(plant: Plant) -> PlantMatrices:
    return plant_matrices(plant, plant.nominal)


def response(
    m: PlantMatrices, s: complex, right: np.ndarray | None = None, left: np.ndarray | None = None
) -> np.ndarray:
    """left (s - A)^-1 right, without direct terms."""
    right, left = (m.B if right is None else right), (m.C if left is None else left)
    return left @ np.linalg.solve(s * np.eye(len(m.A)) - m.A, right.astype(complex))


@pytest.mark.parametrize("seed", range(5))
def test_transfer_function_of_random_systems(seed: int) -> None:
    truth = random_system(np.random.default_rng(seed), n_real_poles=seed % 2, feedthrough=0.4)
    system = realisation_of(truth)
    plant = state_space_plant(system, sensor_kind="velocity", input_hold="zero_order", dt=truth.dt)
    m = nominal(plant)
    # one exponential samples it again: the pulse response must be that of the discrete system
    import scipy

    n = plant.n_states
    block = np.zeros((n + 2, n + 2))
    block[:n] = np.hstack([m.A, m.B]) * truth.dt
    flow = scipy.linalg.expm(block)
    np.testing.assert_allclose(m.D, truth.D, rtol=1e-10)
    for lag in range(20):
        found = m.C @ np.linalg.matrix_power(flow[:n, :n], lag) @ flow[:n, n:]
        exact = truth.C @ np.linalg.matrix_power(truth.A, lag) @ truth.B
        np.testing.assert_allclose(found, exact, atol=1e-9 * np.abs(truth.C @ truth.B).max())


def test_transfer_function_in_continuous_time() -> None:
    mix = np.linalg.qr(np.random.default_rng(1).standard_normal((6, 6)))[0]
    system = first_order_chain(["acceleration", "displacement"], [0, 2], mix=mix)
    m = nominal(state_space_plant(system, sensor_kind=("acceleration", "displacement")))
    for s in (1j, 0.5 + 20j, 45j):
        exact = system.C @ np.linalg.solve(s * np.eye(6) - system.A, system.B.astype(complex)) + system.D
        np.testing.assert_allclose(response(m, s) + m.D, exact, rtol=1e-10, atol=1e-13)


@pytest.mark.parametrize("kind", ["displacement", "velocity", "acceleration"])
def test_rows_are_the_true_displacement_and_velocity(kind: str) -> None:
    mix = np.random.default_rng(2).standard_normal((6, 6))
    plant = state_space_plant(first_order_chain([kind] * 3, [0, 1, 2], mix=mix), sensor_kind=kind)
    m = nominal(plant)
    mass, damping, stiffness = chain_matrices(MASSES, SPRINGS, DAMPERS)
    s = 0.2 + 13j
    exact = np.linalg.solve(mass * s**2 + damping * s + stiffness, [0.0, 1.0, 0.0])
    wanted = {f"output_{i}": exact[i] for i in range(3)}
    wanted |= {f"output_{i}-output_{j}": exact[i] - exact[j] for i, j in ((0, 1), (0, 2), (1, 2))}
    assert [port.name for port in plant.ports] == list(wanted)
    for port in plant.ports:
        for row, true in ((port.displacement, wanted[port.name]), (port.velocity, s * wanted[port.name])):
            found = response(m, s, left=row[None, :6])[0, 0] + row[6]
            assert found == pytest.approx(true, rel=1e-8, abs=1e-12)


@pytest.mark.parametrize("kind", ["displacement", "velocity", "acceleration"])
def test_without_symmetry_directions_hold_every_physical_force_and_nothing_else(kind: str) -> None:
    """With all three DOFs measured the directions at a port span the accelerations M^-1 b of the chain."""
    mix = np.random.default_rng(3).standard_normal((6, 6))
    system = first_order_chain([kind] * 3, [0, 1, 2], mix=mix, feedback=150.0)
    plant = state_space_plant(system, sensor_kind=kind)
    m = nominal(plant)
    mass, damping, stiffness = chain_matrices(MASSES, SPRINGS, DAMPERS)
    stiffness[0, 2] += 150.0
    power = {"displacement": 0, "velocity": 1, "acceleration": 2}[kind]
    for port in plant.ports:
        columns = list(port.columns)
        assert len(columns) == 3
        for s in (3j, 1 + 40j):
            forces = s**power * np.linalg.inv(mass * s**2 + damping * s + stiffness)  # by force on each DOF
            found = response(m, s, right=m.E[:, columns]) + m.G[:, columns]
            weights = np.linalg.lstsq(forces, found, rcond=None)[0]
            if s == 3j:
                first = weights
        np.testing.assert_allclose(weights, first, atol=1e-6 * np.abs(first).max())  # the same forces at any s
        assert np.abs(weights.imag).max() < 1e-6 * np.abs(weights).max()
        assert np.linalg.matrix_rank(weights.real, tol=1e-6) == 3


@pytest.mark.parametrize("kind", ["displacement", "velocity", "acceleration"])
def test_the_first_direction_opposes_and_the_others_leave_the_place_alone(kind: str) -> None:
    plant = state_space_plant(first_order_chain([kind] * 2, [0, 2]), sensor_kind=kind)
    m = nominal(plant)
    for port in plant.ports:
        E = m.E[:, list(port.columns)]
        assert E.shape == (6, 4)  # two displacements are measured, four directions stay
        np.testing.assert_allclose(port.displacement[:6] @ E, 0.0, atol=1e-9)
        np.testing.assert_allclose(port.velocity[:6] @ E, [-1.0, 0.0, 0.0, 0.0], atol=1e-9)
        np.testing.assert_allclose(np.linalg.norm(E[:, 1:], axis=0), np.linalg.norm(E[:, 0]), rtol=1e-9)
        assert port.accepts == ({"motion", "force"} if "-" in port.name else {"motion", "force", "mass"})


def test_a_spring_at_an_output_is_found_among_the_directions() -> None:
    """A stiffer ground spring on mass 0 equals w = k d at output_0 with one choice of direction."""
    system = first_order_chain(["acceleration"] * 3, [0, 1, 2], feedback=150.0)
    plant = state_space_plant(system, sensor_kind="acceleration")
    m, port = nominal(plant), plant.port("output_0")
    columns = list(port.columns)
    mass, damping, stiffness = chain_matrices(MASSES, SPRINGS, DAMPERS)
    # the directions of force, told by their accelerations at the three outputs: a force on DOF 0 moves output_0 alone
    direction = np.linalg.solve(m.G[:, columns], [-1.0 / MASSES[0], 0.0, 0.0])
    assert direction[0] == pytest.approx(1.0 / MASSES[0])  # the first component carries what happens at the place
    row = 55.0 * port.displacement[None, :6]
    A = m.A + m.E[:, columns] @ direction[:, None] @ row
    stiffness[0, 2] += 150.0
    stiffness[0, 0] += 55.0
    wanted = np.linalg.eigvals(
        np.block([[np.zeros((3, 3)), np.eye(3)], [-np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, damping)]])
    )
    np.testing.assert_allclose(np.sort_complex(np.linalg.eigvals(A)), np.sort_complex(wanted), rtol=1e-8)


def test_one_mode_seen_by_three_sensors_has_one_free_direction() -> None:
    A = np.array([[0.0, 1.0], [-400.0, -0.8]])
    C = np.outer([1.0, 0.6, -0.3], [1.0, 0.0])
    plant = state_space_plant(StateSpace(A, np.array([[0.0], [1.0]]), C, np.zeros((3, 1))), sensor_kind="displacement")
    assert [len(port.columns) for port in plant.ports] == [1] * 6
    noisy = C + 1e-3 * np.random.default_rng(0).standard_normal(C.shape)
    plant = state_space_plant(
        StateSpace(A, np.array([[0.0], [1.0]]), noisy, np.zeros((3, 1))), sensor_kind="displacement"
    )
    assert [len(port.columns) for port in plant.ports] == [1] * 6


def test_parameters_are_forces_that_move_no_displacement_at_once() -> None:
    plant = state_space_plant(first_order_chain(["displacement"] * 2, [0, 2]), sensor_kind="displacement")
    assert len(plant.parameters) == 4 * 6  # directions that leave two displacements where they are, by six states
    given, n = nominal(plant), plant.n_states
    rng = np.random.default_rng(3)
    moved = plant_matrices(plant, rng.standard_normal(24) * [one.deviation for one in plant.parameters])
    assert np.abs(moved.A - given.A).max() > 0.01 * np.abs(given.A).max()
    for port in plant.ports[:2]:
        np.testing.assert_allclose(
            port.displacement[:n] @ moved.A, port.velocity[:n], atol=1e-9 * np.abs(given.A).max()
        )
    np.testing.assert_array_equal(moved.C, given.C)  # displacements are read as before


@pytest.mark.parametrize("kind", ["displacement", "acceleration"])
def test_a_wrong_stiffness_anywhere_lies_within_the_parameters(kind: str) -> None:
    """The chain with one spring 4 % stiffer, found by least squares on the entries of K and C, exactly."""
    kinds, dofs = [kind] * 3, [0, 1, 2]
    plant = state_space_plant(first_order_chain(kinds, dofs), sensor_kind=kind)
    mass, damping, stiffness = chain_matrices(MASSES, [SPRINGS[0], 1.04 * SPRINGS[1], SPRINGS[2]], DAMPERS)
    at = [1j * omega for omega in (3.0, 8.0, 15.0, 22.0, 35.0, 50.0)]

    def wanted(s: complex) -> np.ndarray:
        motion = np.linalg.solve(mass * s**2 + damping * s + stiffness, np.array([[0.0], [1.0], [0.0]]))
        return motion * (s**2 if kind == "acceleration" else 1.0)

    def error(values: np.ndarray) -> np.ndarray:
        m = plant_matrices(plant, values)
        gap = np.array([(response(m, s) + m.D - wanted(s)) / np.abs(wanted(s)).max() for s in at]).ravel()
        return np.concatenate([gap.real, gap.imag])

    import scipy

    start = plant.nominal
    found = scipy.optimize.least_squares(error, start, x_scale=[one.deviation for one in plant.parameters], xtol=1e-15)
    assert np.abs(error(start)).max() > 0.02
    assert np.abs(error(found.x)).max() < 1e-7


def test_poles_are_the_parameters_of_a_plant_that_is_no_structure() -> None:
    motor = StateSpace(np.array([[-2.0]]), np.array([[3.0]]), np.array([[1.0]]), np.zeros((1, 1)))
    (pole,) = state_space_plant(motor, sensor_kind="velocity").parameters
    assert pole.nominal == pytest.approx(-2.0)
    assert pole.lower < pole.nominal < pole.upper <= 0.0


def test_the_system_is_affine_in_the_parameters() -> None:
    truth = random_system(np.random.default_rng(4), n_real_poles=1)
    plant = state_space_plant(realisation_of(truth), sensor_kind="velocity")
    step = 1e-3 * np.array([parameter.deviation for parameter in plant.parameters])
    for index in range(len(step)):
        shift = step[index] * np.eye(len(step))[index]
        above, below = (plant_matrices(plant, plant.nominal + sign * shift) for sign in (1, -1))
        slope = plant.system[1 + index, : plant.n_states, : plant.n_states]
        np.testing.assert_allclose((above.A - below.A) / (2 * step[index]), slope, atol=1e-8)
        np.testing.assert_array_equal(above.B, below.B)


def test_a_shaft_has_a_velocity_only() -> None:
    shaft = StateSpace(np.array([[-5.0]]), np.array([[100.0]]), np.array([[1.0]]), np.array([[0.0]]))
    plant = state_space_plant(shaft, sensor_kind="velocity", output_units=["rad/s"])
    (port,) = plant.ports
    assert port.displacement is None
    assert port.accepts == {"motion", "force"}
    assert (port.length_unit, port.force_unit) == ("rad", "rad/s^2")
    np.testing.assert_allclose(port.velocity[:1] @ nominal(plant).E, [-1.0])
    motor = StateSpace(
        np.array([[-400.0, -20.0], [50.0, -0.5]]), np.array([[300.0], [0.0]]), np.array([[0.0, 1.0]]), np.zeros((1, 1))
    )
    (port,) = state_space_plant(motor, sensor_kind="velocity").ports
    assert port.displacement is None
    assert len(port.columns) == 2


def test_a_tank_takes_flows() -> None:
    tank = StateSpace(np.array([[-0.2]]), np.array([[1.5]]), np.array([[1.0]]), np.array([[0.0]]))
    plant = state_space_plant(tank, sensor_kind="displacement")
    (port,) = plant.ports
    assert port.accepts == {"flow", "force"}
    assert port.velocity is None
    m = nominal(plant)
    np.testing.assert_allclose(port.displacement, [*m.C[0], 0.0])
    np.testing.assert_allclose(m.C @ m.E, [[-1.0]])
    two = StateSpace(
        np.array([[-0.2, 0.0], [0.2, -0.1]]), np.array([[1.0], [0.0]]), np.array([[0.0, 1.0]]), np.zeros((1, 1))
    )
    ports = {port.name: port for port in state_space_plant(two, sensor_kind="displacement").ports}
    assert ports["output_0 level"].accepts == {"flow"}
    assert len(ports["output_0 level"].columns) == 2
    assert "motion" in ports["output_0"].accepts
    in_volts = state_space_plant(two, sensor_kind="displacement", output_units=["V"]).ports
    assert next(port for port in in_volts if port.name == "output_0").accepts == {"force"}


def test_integrators() -> None:
    A, B = np.array([[0.0, 1.0], [0.0, -0.3]]), np.array([[0.0], [0.5]])
    position = state_space_plant(StateSpace(A, B, np.eye(2)[[0]], np.zeros((1, 1))), sensor_kind="displacement")
    assert position.ports[0].velocity is not None
    m = nominal(position)
    s = 0.7j
    for row, power in ((position.ports[0].displacement, 0), (position.ports[0].velocity, 1)):
        assert response(m, s, left=row[None, :2])[0, 0] == pytest.approx(s**power * 0.5 / (s**2 + 0.3 * s))
    speed = state_space_plant(StateSpace(A, B, np.eye(2)[[1]], np.zeros((1, 1))), sensor_kind="velocity")
    m = nominal(speed)  # the integrator is not observable, and still its row is the displacement
    found = response(m, s, left=speed.ports[0].displacement[None, :2])[0, 0]
    assert found == pytest.approx(0.5 / (s**2 + 0.3 * s))
    with pytest.raises(InvalidDataError, match="an integrator needs its displacement or velocity measured"):
        state_space_plant(StateSpace(A, B, np.array([[0.3, 0.0]]), np.zeros((1, 1))), sensor_kind="acceleration")


def test_a_free_mass_has_two_poles_at_zero() -> None:
    A, B = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [0.5]])
    plant = state_space_plant(StateSpace(A, B, np.eye(2)[[0]], np.zeros((1, 1))), sensor_kind="displacement")
    assert plant.parameters == ()
    m = nominal(plant)
    assert response(m, 2j)[0, 0] == pytest.approx(0.5 / (2j) ** 2)


def test_undamped_and_unstable() -> None:
    undamped = StateSpace(
        np.array([[0.0, 1.0], [-9.0, 0.0]]), np.array([[0.0], [1.0]]), np.eye(2)[[0]], np.zeros((1, 1))
    )
    poles = np.linalg.eigvals(nominal(state_space_plant(undamped, sensor_kind="displacement")).A)
    np.testing.assert_allclose(poles[np.argsort(poles.imag)], [-3j, 3j], atol=1e-9)
    unstable = StateSpace(np.array([[0.2]]), np.array([[1.0]]), np.array([[1.0]]), np.zeros((1, 1)))
    with pytest.raises(InvalidDataError, match=r"must be stable, but this one has a pole at 0\.2"):
        state_space_plant(unstable, sensor_kind="velocity")


def test_base_acceleration_seen_by_absolute_accelerometers() -> None:
    mass, damping, stiffness = chain_matrices(MASSES, SPRINGS, DAMPERS)
    lower = -np.linalg.solve(mass, np.hstack([stiffness, damping]))
    A = np.vstack([np.hstack([np.zeros((3, 3)), np.eye(3)]), lower])
    B = np.concatenate([np.zeros(3), -np.ones(3)])[:, None]
    plant = state_space_plant(StateSpace(A, B, lower, np.zeros((3, 1))), sensor_kind="acceleration")
    s = 0.1 + 9j
    relative = -np.linalg.solve(mass * s**2 + damping * s + stiffness, mass @ np.ones(3))
    for i in range(3):
        row = plant.port(f"output_{i}").displacement
        assert response(nominal(plant), s, left=row[None, :6])[0, 0] == pytest.approx(relative[i], rel=1e-8)


def test_stiffness_at_a_place_is_counted_per_effective_mass() -> None:
    oscillator = StateSpace(
        np.array([[0.0, 1.0], [-64.0, -0.3]]), np.array([[0.0], [0.5]]), np.eye(2), np.zeros((2, 1))
    )
    plant = state_space_plant(oscillator, sensor_kind=("displacement", "velocity"))
    assert [port.stiffness for port in plant.ports][:2] == [pytest.approx(64.0), pytest.approx(64.0)]
    shaft = StateSpace(np.array([[-5.0]]), np.array([[100.0]]), np.array([[1.0]]), np.array([[0.0]]))
    assert state_space_plant(shaft, sensor_kind="velocity").ports[0].stiffness is None


def test_control_state_space() -> None:
    import control

    given = control.ss([[0.0, 1.0], [-100.0, -0.4]], [[0.0], [1.0]], [[-100.0, -0.4]], [[1.0]])
    sampled = control.sample_system(given, 0.01, method="zoh")
    for system in (given, sampled):
        plant = state_space_plant(system, sensor_kind="acceleration", output_units=["m/s^2"], dt=0.01)
        port = plant.port("output_0")
        assert (port.length_unit, port.force_unit, port.mass) == ("m", "m/s^2", 1.0)
        np.testing.assert_allclose(nominal(plant).G, [[-1.0]], rtol=1e-8)
        time = np.arange(300) * 0.01
        forced = control.forced_response(sampled, T=time, U=np.sin(3 * time), X0=0)
        plain = control.ss(*(getattr(nominal(plant), name) for name in "ABCD"))
        again = control.forced_response(
            control.sample_system(plain, 0.01, method="zoh"), T=time, U=np.sin(3 * time), X0=0
        )
        np.testing.assert_allclose(again.outputs, forced.outputs, atol=1e-9)


def test_many_outputs_pair_with_their_neighbours_only() -> None:
    rng = np.random.default_rng(0)
    n = 14
    _, damping, stiffness = chain_matrices([1.0] * n, [500.0] * n, [0.5] * n)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness, -damping]])
    system = StateSpace(
        A, np.concatenate([np.zeros(n), rng.standard_normal(n)])[:, None], np.eye(2 * n)[:n], np.zeros((n, 1))
    )
    names = [port.name for port in state_space_plant(system, sensor_kind="displacement").ports]
    assert len(names) == n + n - 1
    assert "output_4-output_5" in names
    assert "output_4-output_6" not in names
