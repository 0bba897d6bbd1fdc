"""The integrator of the hidden truth against matrix exponentials, scipy's own integrators and closed forms."""

import numpy as np
import pytest
import scipy
from hidden_integrator import march
from hidden_laws import law_from
from hidden_truth import Absorber, TrueChain, TrueRotor, chain_matrices, chain_plant, outputs_of, rotor_plant

DT = 0.01
N = 150
ASKED = 70
"""So many of them are compared with a general integrator, which is slow."""


def chain(n_dofs=1, *, sensor_kind="displacement", damping=0.4):
    """10 to 20 samples a period of the fastest mode."""
    return TrueChain(
        masses=np.linspace(1.0, 1.3, n_dofs),
        stiffnesses=np.linspace(900.0, 700.0, n_dofs),
        dampings=np.full(n_dofs, damping),
        force_dofs=(n_dofs - 1,),
        sensor_dofs=tuple(range(n_dofs)),
        sensor_kind=sensor_kind,
    )


def inputs(rng, n_records=2, *, size=40.0):
    """Smooth random forces, another size in each record."""
    white = rng.standard_normal((n_records, N + 20, 1))
    smooth = scipy.signal.lfilter([0.2], [1, -0.8], white, axis=1)[:, 20:]
    return size * smooth * np.arange(1, n_records + 1)[:, np.newaxis, np.newaxis]


def reference(plant, law, u, start, *, hold, n):
    """The first n samples of a record by DOP853 at 1e-10, started anew at every sample; z joins the state."""
    x, z, states = np.array(start), np.zeros((1, 1, 1)), []

    def slope(t, s, before, rise, k):
        now = before + rise * (t - k * DT)
        at = (np.full((1, 1, 1), q) for q in (plant.displacement[0] @ s[:-1], plant.velocity[0] @ s[:-1], s[-1]))
        d, v, memory = at
        w = law.force(d, v, memory, t).item()
        return np.append(plant.A @ s[:-1] + plant.B @ now + plant.E[:, 0] * w, law.memory_rate(d, v, memory, t).item())

    for k in range(n):
        states.append(x)
        rise = (u[min(k + 1, len(u) - 1)] - u[k]) / DT if hold == "linear" else np.zeros(u.shape[1])
        end = scipy.integrate.solve_ivp(
            slope, (k * DT, (k + 1) * DT), np.append(x, z), method="DOP853", rtol=1e-10, atol=1e-13,
            args=(u[k], rise, k), max_step=DT / 4,
        ).y[:, -1]  # fmt: skip
        x, z = end[:-1], np.full((1, 1, 1), end[-1])
    return np.array(states)


@pytest.mark.parametrize("hold", ["zero_order", "linear"])
def test_without_effects_it_is_the_exact_sampled_system(hold):
    rng = np.random.default_rng(1)
    model = chain(3, sensor_kind="acceleration")
    plant, rows = chain_plant(model, [])
    u, start = inputs(rng), rng.standard_normal((2, 6))
    run = march(plant, [], u, dt=DT, hold=hold, initial_states=start, n_steps=3)
    found = outputs_of(run, rows, u)

    exact = scipy.signal.StateSpace(plant.A, plant.B, rows[0], rows[1])
    for r in range(2):
        _, y, _ = scipy.signal.lsim(exact, u[r], DT * np.arange(N), X0=start[r], interp=hold == "linear")
        np.testing.assert_allclose(found[r], y, atol=1e-9 * np.abs(y).max())


@pytest.mark.parametrize("n_dofs", [1, 3])
@pytest.mark.parametrize(
    ("effect", "values", "tolerance"),
    [
        ("cubic_stiffness", {"k3": 4e4}, 1e-5),
        ("quadratic_stiffness", {"k2": 1.5e3}, 1e-5),
        ("quadratic_drag", {"c2": 2.0}, 1e-5),
        ("sine_softening", {"k": 600.0, "length_scale": 0.06}, 1e-5),
        ("time_varying_stiffness", {"rate": 80.0}, 1e-5),
        ("periodic_disturbance", {"amplitude": 20.0, "frequency": 3.3, "phases": np.array([[[0.4]], [[2.0]]])}, 1e-5),
        ("constant_force", {"offset": 15.0}, 1e-9),
        ("bilinear_stiffness", {"kb": 300.0}, 2e-4),
        ("gap_spring", {"k_in": -200.0, "k_out": 900.0, "gap": 0.03}, 1e-3),
        ("bouc_wen_hysteresis", {"a": 400.0, "yield_displacement": 0.03, "n": 1.6}, 2e-4),
    ],
)
def test_sharp_laws_against_scipy(effect, values, tolerance, n_dofs):
    rng = np.random.default_rng(2)
    plant, _ = chain_plant(chain(n_dofs), [f"element_{n_dofs - 1}"])
    law = law_from(effect, **values)
    hold = "linear" if n_dofs == 1 else "zero_order"
    u, start = inputs(rng), 0.02 * rng.standard_normal((2, 2 * n_dofs))
    run = march(plant, [law], u, dt=DT, hold=hold, initial_states=start, n_steps=12)
    linear = march(
        plant, [law_from("constant_force", offset=0.0)], u, dt=DT, hold=hold, initial_states=start, n_steps=1
    )
    for r in (0, 1) if n_dofs == 1 else (1,):
        truth = reference(plant, law.for_record(r), u[r], start[r], hold=hold, n=ASKED)
        scale = truth.std(axis=0)
        assert np.all(np.abs(run.states[r, :ASKED] - truth).max(axis=0) < tolerance * scale)
        # the effect matters here, so that the comparison means something
        assert np.max(np.abs(linear.states[r, :ASKED] - truth).max(axis=0) / scale) > 0.1


def test_two_laws_at_two_places_against_scipy():
    rng = np.random.default_rng(3)
    plant, _ = chain_plant(chain(3), ["element_0", "element_2"])
    laws = [
        law_from("cubic_stiffness", k3=4e4),
        law_from("bouc_wen_hysteresis", a=300.0, yield_displacement=0.02, n=2.0),
    ]
    u = inputs(rng, 1)
    run = march(plant, laws, u, dt=DT, hold="zero_order", initial_states=np.zeros((1, 6)), n_steps=12)

    def slope(t, s, now):
        d, v = plant.displacement @ s[:6], plant.velocity @ s[:6]
        w = np.array([4e4 * d[0] ** 3, 300.0 * s[6]])
        rate = v[1] * (1 - (1 + np.sign(v[1] * s[6])) / 2 * abs(s[6] / 0.02) ** 2.0)
        return np.append(plant.A @ s[:6] + plant.B @ now + plant.E @ w, rate)

    state = np.zeros(7)
    for k in range(N):
        assert np.all(np.abs(run.states[0, k] - state[:6]) < 1e-4 * run.states[0].std(axis=0))
        state = scipy.integrate.solve_ivp(slope, (0, DT), state, rtol=1e-9, atol=1e-12, args=(u[0, k],)).y[:, -1]


def test_free_decay_under_coulomb_friction_loses_4_f_over_k_a_cycle():
    """m x'' + k x + F sign(x') = 0: peaks fall on a straight line and the mass sticks within F / k (Rao, 2.9)."""
    k, friction = 900.0, 2.0
    model = chain(damping=0.0)
    plant, _ = chain_plant(model, ["element_0"])
    run = march(
        plant, [law_from("coulomb_friction", Fc=friction)], np.zeros((1, 1400, 1)), dt=DT / 10, hold="zero_order",
        initial_states=np.array([[0.05, 0.0]]), n_steps=6,
    )  # fmt: skip
    x, v = run.states[0].T
    half_period = np.pi / np.sqrt(k)
    for i in range(1, 11):  # x at the i-th standstill
        at = np.interp(i * half_period, DT / 10 * np.arange(1400), x)
        assert at == pytest.approx((-1) ** i * (0.05 - 2 * i * friction / k), abs=1e-5)
    assert np.all(v[1300:] == 0)
    assert abs(x[-1]) <= friction / k
    assert run.forces[0, -1, 0] == pytest.approx(-k * x[-1], rel=1e-9)  # at rest friction holds the spring, no more


@pytest.mark.parametrize("n_dofs", [1, 3])
def test_sticking_and_sliding_against_scipy_with_events(n_dofs):
    """From reversal to reversal by DOP853 in a given regime, with events where it ends."""
    rng = np.random.default_rng(4)
    place = n_dofs // 2
    plant, _ = chain_plant(chain(n_dofs, damping=1.0), [f"element_{place}"])
    friction = 25.0
    u = inputs(rng, 1)
    run = march(
        plant, [law_from("coulomb_friction", Fc=friction)], u, dt=DT, hold="zero_order",
        initial_states=np.zeros((1, 2 * n_dofs)), n_steps=12,
    )  # fmt: skip
    V, E = plant.velocity[0], plant.E[:, 0]
    x, regime, stuck = np.zeros(2 * n_dofs), 0.0, 0
    for k in range(N):
        assert np.all(np.abs(run.states[0, k] - x) < 1e-6 * run.states[0].std(axis=0))
        t, force = k * DT, plant.B @ u[0, k]

        def holding(s, force=force):
            return -(V @ (plant.A @ s + force)) / (V @ E)

        while t < (k + 1) * DT - 1e-12:
            if regime == 0 and abs(holding(x)) > friction:
                regime = np.sign(holding(x))

            def slope(_, s, regime=regime, force=force):
                return plant.A @ s + force + E * (holding(s, force) if regime == 0 else regime * friction)

            def reversal(_, s, regime=regime, force=force):
                if regime == 0:
                    return friction + 1e-9 - abs(holding(s, force))
                return regime * (V @ s) + 1e-11

            reversal.terminal, reversal.direction = True, -1
            part = scipy.integrate.solve_ivp(
                slope, (t, (k + 1) * DT), x, method="DOP853", rtol=1e-10, atol=1e-13, events=reversal, max_step=DT / 8
            )
            x, t = part.y[:, -1], part.t[-1]
            if part.status == 1:
                if regime != 0:
                    x = x - E * (V @ x) / (V @ E)
                    regime = 0.0 if abs(holding(x)) <= friction else np.sign(holding(x))
                else:
                    regime = np.sign(holding(x))
        stuck += regime == 0
    assert 0.05 * N < stuck < 0.95 * N  # both happened


def test_slack_in_hysteresis_follows_the_loop_by_hand():
    """Slack, elastic, yielding at k times the yield displacement; back through twice the slack without force."""
    law = law_from("slack_in_hysteresis", k=10.0, yield_displacement=1.0, slack=0.5)
    z = np.zeros((1, 1, 1))
    path = [
        (0.4, 0.0),
        (1.0, 5.0),
        (1.5, 10.0),
        (3.0, 10.0),
        (2.5, 5.0),
        (2.0, 0.0),
        (1.0, 0.0),
        (0.5, -5.0),
        (-2.0, -10.0),
    ]
    for d, force in path:
        at = np.full((1, 1, 1), d)
        assert law.force(at, 0 * at, z, 0.0).item() == pytest.approx(force)
        z = law.slid(at, z)


def test_steps_hardly_matter_for_the_slack():
    plant, _ = chain_plant(chain(3), ["element_1"])
    law = law_from("slack_in_hysteresis", k=600.0, yield_displacement=0.01, slack=0.01)
    few, many = (
        march(plant, [law], inputs(np.random.default_rng(5)), dt=DT, hold="zero_order",
              initial_states=np.zeros((2, 6)), n_steps=n).states for n in (12, 60)
    )  # fmt: skip
    assert np.all(np.abs(few - many).max(axis=1) < 2e-3 * many.std(axis=1))


def test_bouc_wen_stays_within_its_yield_displacement():
    plant, _ = chain_plant(chain(), ["element_0"])
    law = law_from("bouc_wen_hysteresis", a=100.0, yield_displacement=0.01, n=1.3)
    u = inputs(np.random.default_rng(6))
    run = march(plant, [law], u, dt=DT, hold="zero_order", initial_states=np.zeros((2, 2)), n_steps=8)
    assert 0.0098 < np.abs(run.memory).max() <= 0.01 * (1 + 1e-6)


def test_energy_is_kept_by_a_spring_and_lost_by_drag_as_its_power_says():
    plant, _ = chain_plant(chain(damping=0.0), ["element_0"])
    start = np.array([[0.1, 0.0]])
    for effect, values in (("cubic_stiffness", {"k3": 4e4}), ("quadratic_drag", {"c2": 0.5})):
        run = march(
            plant, [law_from(effect, **values)], np.zeros((1, 4000, 1)), dt=DT / 10, hold="zero_order",
            initial_states=start, n_steps=4,
        )  # fmt: skip
        x, v = run.states[0].T
        energy = 0.5 * v**2 + 450.0 * x**2
        if effect == "cubic_stiffness":
            np.testing.assert_allclose(energy + 1e4 * x**4, energy[0] + 1e4 * x[0] ** 4, rtol=1e-8)
        else:
            lost = scipy.integrate.cumulative_simpson(0.5 * np.abs(v) ** 3, dx=DT / 10, initial=0)
            np.testing.assert_allclose(energy[0] - energy, lost, atol=1e-5 * energy[0])


def test_a_late_input_is_the_input_shifted_and_a_part_of_a_sample_is_exact():
    plant, _ = chain_plant(chain(), [])
    u = inputs(np.random.default_rng(7))
    settings = {"dt": DT, "hold": "zero_order", "initial_states": np.zeros((2, 2)), "n_steps": 1}
    prompt = march(plant, [], u, **settings).states
    whole = march(plant, [], u, delay=2 * DT, **settings).states
    np.testing.assert_allclose(whole[:, 2:], prompt[:, :-2], atol=1e-15)
    # a step of ten times finer samples, in which 1.3 samples are 13 whole ones
    fine = march(plant, [], np.repeat(u, 10, axis=1), delay=13 * DT / 10, **{**settings, "dt": DT / 10}).states
    part = march(plant, [], u, delay=1.3 * DT, **settings).states
    np.testing.assert_allclose(part, fine[:, ::10], atol=1e-12)


def test_an_absorber_splits_the_resonance_of_its_host():
    """Two undamped masses: frequencies from the quadratic in omega^2 of Den Hartog's absorber."""
    model = chain(damping=0.0)
    mass, _, stiffness = chain_matrices(model, Absorber(dof=0, mass=0.1, frequency=30 / (2 * np.pi), damping_ratio=0.0))
    squares = np.sort(np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real)
    p, ratio = 900.0, 0.1  # host and absorber tuned alike
    np.testing.assert_allclose(
        squares,
        p * np.array([1 + ratio / 2 - np.sqrt(ratio + ratio**2 / 4), 1 + ratio / 2 + np.sqrt(ratio + ratio**2 / 4)]),
    )
    assert np.diag(mass).tolist() == [1.0, 0.1]


def test_a_motor_under_square_drag_reaches_the_speed_of_the_closed_form():
    """J w' = T - c w^2 from rest: w = sqrt(T / c) tanh(t sqrt(T c) / J)."""
    rotor, torque, c2 = TrueRotor(J=0.02, b=0.0, kt=1.0), 0.5, 2e-3
    plant, _ = rotor_plant(rotor, 1)
    run = march(
        plant, [law_from("quadratic_drag", c2=c2)], np.full((1, 400, 1), torque), dt=DT, hold="zero_order",
        initial_states=np.zeros((1, 1)), n_steps=4,
    )  # fmt: skip
    t = DT * np.arange(400)
    np.testing.assert_allclose(
        run.states[0, :, 0], np.sqrt(torque / c2) * np.tanh(t * np.sqrt(torque * c2) / rotor.J), rtol=1e-6, atol=1e-9
    )


def test_a_tank_drains_by_torricelli_and_overflows_at_the_brim():
    """area h' = -c sqrt(h): sqrt(h) falls in a straight line."""
    tank = TrueRotor(J=2.0, b=0.3, kt=1.0)
    plant, _ = rotor_plant(tank, 1)
    law = law_from("power_law_flow", coefficient=0.2, exponent=0.5, linear=0.3)
    run = march(
        plant, [law], np.zeros((1, 200, 1)), dt=0.05, hold="zero_order", initial_states=np.array([[4.0]]), n_steps=4
    )
    root = 2.0 - 0.2 / (2 * 2.0) * 0.05 * np.arange(200)
    np.testing.assert_allclose(np.sqrt(run.states[0, :, 0]), root, rtol=1e-8)

    full, _ = rotor_plant(TrueRotor(J=2.0, b=0.3, kt=1.0, limit=1.5), 0)
    u = np.where(np.arange(2000) < 1000, 1.0, 0.0)[np.newaxis, :, np.newaxis]
    run = march(full, [], u, dt=0.05, hold="zero_order", initial_states=np.zeros((1, 1)), n_steps=4)
    level = run.states[0, :, 0]
    assert level.max() == 1.5
    assert level[999] == 1.5
    np.testing.assert_allclose(level[1000:], 1.5 * np.exp(-0.15 * 0.05 * np.arange(1000)), rtol=1e-9)
