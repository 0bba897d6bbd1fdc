"""Simulated trajectories against exact linear ones, a Runge-Kutta loop and SciPy's integrators."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.integrate
import scipy.signal
from engine_plants import VALUES, imposed_motion, moved, some_records, two_masses, with_effects
from nonlinear_chain import run_chain

from modal.effects.catalogue import CATALOGUE
from modal.simulation.assembly import Unknowns, assemble, initial_unknowns, place_effect
from modal.simulation.drive import drive_of
from modal.simulation.plant import plant_matrices
from modal.simulation.scheme import scheme_and_slopes
from modal.simulation.trajectory import Source, force_response, respond, resting_states, sensitivity, simulate_states
from modal.structure.structural_model import StructuralModel
from modal.structure.structural_plant import structural_plant
from okid.record import Record

MASS, STIFFNESS, DAMPING, DT = 1.0, 100.0, 1.0, 0.04
"""1.6 Hz, 5 % damped, 16 samples a period."""


def oscillator(
    key,
    values,
    inputs,
    upsampling=1,
    *,
    scale=(0.1, 1.0),
    masses=(MASS,),
    start=None,
    hold="zero_order",
    mass_port="element_0",
):
    """One mass on a spring with an effect: simulate it; None where that fails."""
    model = StructuralModel.chain(
        masses, [STIFFNESS] * len(masses), [DAMPING] * len(masses), force_dofs=[0], sensor_dofs=[0]
    )
    plant = structural_plant(model)
    record = Record(inputs, np.zeros((len(inputs), 1)), DT, input_hold=hold)
    drive = drive_of([record], upsampling)
    item = place_effect(plant, CATALOGUE[key], mass_port, displacement_scale=scale[0], velocity_scale=scale[1])
    assembly = assemble(plant, [item])
    unknowns = initial_unknowns(assembly, 1)
    common, local = unknowns.common.copy(), unknowns.local.copy()
    common[assembly.common_of(0)] = values
    if start is not None:
        local[0, : plant.n_states] = start
    scheme, _ = scheme_and_slopes(plant, common[: assembly.n_linear], drive.dt)
    return simulate_states(
        assembly, Unknowns(common=common, local=local), drive, scheme, resting_states(assembly, drive)
    )


def slow_noise(n, seed, size):
    """Held noise below half the resonance and about it, (n, 1)."""
    rng = np.random.default_rng(seed)
    noise = np.convolve(rng.standard_normal(n + 20), np.hanning(9), mode="same")[10 : n + 10]
    return size * (noise / noise.std())[:, None]


# --- linear ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("upsampling", [1, 4])
@pytest.mark.parametrize("hold", ["zero_order", "linear"])
def test_a_linear_plant_is_exact(hold, upsampling):
    plant = two_masses()
    records = some_records(plant, lengths=(70, 53), dt=0.05, hold=hold)
    drive = drive_of(records, upsampling)
    assembly, unknowns = with_effects(plant, [], 2)
    linear = np.array([97.0, 1.3])
    unknowns = replace(unknowns, common=linear)
    scheme, _ = scheme_and_slopes(plant, linear, drive.dt)
    found = simulate_states(assembly, unknowns, drive, scheme, resting_states(assembly, drive))
    m = plant_matrices(plant, linear)
    for record, rows in zip(records, (drive.rows_of(0), drive.rows_of(1)), strict=True):
        i = 0 if rows.start == 0 else 1
        t = np.arange(record.n_samples) * record.dt
        _, y, x = scipy.signal.lsim((m.A, m.B, m.C, m.D), record.inputs, t, unknowns.local[i], interp=hold == "linear")
        size = np.abs(y).max()
        assert np.abs(found.outputs[rows] - y).max() < 1e-10 * size
        assert np.abs(found.states[drive.rows[rows]] - x).max() < 1e-10 * size


def test_an_observer_follows_its_own_recursion():
    plant = two_masses()
    drive = drive_of(some_records(plant, missing=0.2), 3)
    assembly, unknowns = with_effects(plant, [], 2)
    scheme, _ = scheme_and_slopes(plant, unknowns.common, drive.dt)
    gain = np.random.default_rng(0).standard_normal((4, 3)) * [0.05, 0.02, 0.0005]
    found = simulate_states(assembly, unknowns, drive, scheme, resting_states(assembly, drive), gain=gain)
    rows = {int(k): r for r, k in enumerate(drive.rows)}
    for record in range(2):
        x = unknowns.local[record].copy()
        for k in range(drive.firsts[record], drive.firsts[record + 1]):
            assert np.allclose(found.states[k], x, atol=1e-11)
            correction = np.zeros(4)
            if k in rows:
                y = scheme.C @ x + scheme.D @ drive.sample[k]
                assert np.allclose(found.outputs[rows[k]], y, atol=1e-10)
                correction = gain @ np.where(drive.present[rows[k]], drive.outputs[rows[k]] - y, 0.0)
            x = scheme.Ad @ x + scheme.B0 @ drive.start[k] + scheme.B1 @ drive.end[k] + correction


# --- nonlinear -------------------------------------------------------------------------------------------------------

SMOOTH = {
    "cubic_stiffness": ((1500.0,), lambda d, v, t: 1500.0 * d**3),
    "quadratic_stiffness": ((150.0,), lambda d, v, t: 150.0 * d**2),
    "sine_softening": ((0.3,), lambda d, v, t: STIFFNESS * (0.3 * np.sin(d / 0.3) - d)),
    "time_varying_stiffness": ((6.0,), lambda d, v, t: 6.0 * t * d),
    "periodic_disturbance": (None, lambda d, v, t: 2.0 * np.sin(2 * np.pi * 1.1 * t) + 0 * d),
}


@pytest.mark.parametrize("key", list(SMOOTH))
def test_smooth_laws_converge_with_the_fourth_power_of_the_step(key):
    values, law = SMOOTH[key]
    inputs = slow_noise(120, 4, 4.0)
    if values is None:
        values = (2.0, 1.1)
    truth = run_chain([MASS], [STIFFNESS], [DAMPING], inputs.T, DT, law=law, n_steps=60)[0, :, 0]
    errors = []
    for upsampling in (1, 2, 4):
        found = oscillator(key, values, inputs, upsampling)
        errors.append(np.sqrt(np.mean((found.outputs[:, 0] - truth) ** 2)) / truth.std())
    assert errors[0] < 3e-3
    assert errors[0] / errors[1] > 2**3.5, errors
    assert errors[1] / errors[2] > 2**3.5, errors


def test_drag_converges_with_the_third_power_at_least():
    """c v |v| bends where the velocity is zero."""
    inputs = slow_noise(120, 4, 4.0)
    truth = run_chain([MASS], [STIFFNESS], [DAMPING], inputs.T, DT, law=lambda d, v, t: 3.0 * v * np.abs(v), n_steps=60)
    errors = [
        np.abs(oscillator("quadratic_drag", (3.0,), inputs, n).outputs[:, 0] - truth[0, :, 0]).max() for n in (1, 2, 4)
    ]
    assert errors[0] < 2e-3 * truth.std()
    assert errors[0] / errors[2] > 4**2.5


def test_an_absorber_is_a_second_mass():
    ratio, frequency, damping = 0.1, 1.8, 0.05
    hung, w = ratio * MASS, 2 * np.pi * frequency
    inputs = slow_noise(150, 7, 3.0)
    truth = run_chain(
        [MASS, hung], [STIFFNESS, hung * w**2], [DAMPING, 2 * hung * damping * w], inputs.T, DT, n_steps=40
    )
    found = oscillator("missing_mode", (ratio, frequency, damping), inputs, 4)
    assert np.abs(found.outputs[:, 0] - truth[0, :, 0]).max() < 1e-4 * truth[0, :, 0].std()


def test_hysteresis_against_scipy():
    a, limit, n = 60.0, 0.05, 1.6
    inputs = slow_noise(60, 5, 4.0)

    def slope(t, s, u):
        d, v, z = s
        turn = 1.0 - (1.0 + np.sign(v * z)) / 2 * np.abs(z / limit) ** n
        return [v, (u - STIFFNESS * d - DAMPING * v - a * z) / MASS, v * turn]

    s, truth = np.zeros(3), []
    for u in inputs[:, 0]:
        truth.append(s[0])
        s = scipy.integrate.solve_ivp(slope, (0, DT), s, args=(u,), rtol=1e-9, atol=1e-11).y[:, -1]
    found = oscillator("bouc_wen_hysteresis", (a, limit, n), inputs, 4)
    assert np.abs(found.outputs[:, 0] - truth).max() < 2e-3 * np.std(truth)


def test_a_pinned_cubic_against_scipy():
    """Free decay from a large deflection, no input at all that could hide a fault of the law."""
    truth = scipy.integrate.solve_ivp(
        lambda t, s: [s[1], -STIFFNESS * s[0] - DAMPING * s[1] - 4000.0 * s[0] ** 3],
        (0, 3.96), [0.3, 0.0], t_eval=np.arange(100) * DT, rtol=1e-10, atol=1e-12,
    ).y[0]  # fmt: skip
    found = oscillator("cubic_stiffness", (4000.0,), np.zeros((100, 1)), 8, start=[0.3, 0.0])
    assert np.abs(found.outputs[:, 0] - truth).max() < 1e-3 * np.abs(truth).max()


# --- convergence -----------------------------------------------------------------------------------------------------


CUBIC = STIFFNESS / 0.17**2
"""As stiff as the spring at one standard deviation of the linear motion."""
COLD = {
    "stops": ("gap_spring", (0.0, 3 * STIFFNESS, 0.05), lambda d, v, t: 3 * STIFFNESS * (d - np.clip(d, -0.05, 0.05))),
    "freeplay": ("gap_spring", (-STIFFNESS, 0.0, 0.03), lambda d, v, t: -STIFFNESS * np.clip(d, -0.03, 0.03)),
    "k3 sigma^2 = k": ("cubic_stiffness", (CUBIC,), lambda d, v, t: CUBIC * d**3),
    "strong friction": ("coulomb_friction", (4.0,), lambda d, v, t: 4.0 * v / np.hypot(v, 0.0025)),
}


@pytest.mark.parametrize("name", list(COLD))
def test_strong_laws_converge_from_rest(name):
    """Every step's defect is gone, and the start of the motion, before chaos can part them, is the true one."""
    key, values, law = COLD[name]
    inputs = slow_noise(500, 11, 6.0)
    found = oscillator(key, values, inputs, 3)
    assert found is not None
    assert np.abs(found.linearisation.defect).max() < 1e-7 * np.abs(found.states).max()
    truth = run_chain([MASS], [STIFFNESS], [DAMPING], inputs[:40].T, DT, law=law, n_steps=400)[0, :, 0]
    assert np.abs(found.outputs[:40, 0] - truth).max() < 0.05 * truth.std(), name


def test_a_motion_that_escapes_gives_none():
    inputs = slow_noise(200, 3, 8.0)
    assert oscillator("cubic_stiffness", (-STIFFNESS / 0.1**2,), inputs) is None


def test_it_is_deterministic_and_independent_of_the_start():
    plant = two_masses()
    drive = drive_of(some_records(plant), 2)
    keys = ["cubic_stiffness", "bouc_wen_hysteresis", "coulomb_friction", "input_delay"]
    assembly, unknowns = with_effects(plant, keys, 2)
    scheme, _ = scheme_and_slopes(plant, unknowns.common[: assembly.n_linear], drive.dt)
    rest = resting_states(assembly, drive)
    first, second = (simulate_states(assembly, unknowns, drive, scheme, rest) for _ in range(2))
    assert np.array_equal(first.states, second.states)
    elsewhere = 0.1 * np.random.default_rng(0).standard_normal(rest.shape)
    third = simulate_states(assembly, unknowns, drive, scheme, elsewhere)
    near = simulate_states(assembly, unknowns, drive, scheme, first.states, start="near")
    size = np.abs(first.states).max()
    assert np.abs(third.states - first.states).max() < 1e-7 * size
    assert np.abs(near.states - first.states).max() < 1e-7 * size
    assert not rest.any()


def test_a_plant_without_states_is_its_law():
    from engine_plants import VALUES, imposed_motion

    plant = imposed_motion()
    records = some_records(plant)
    drive = drive_of(records)
    assembly, unknowns = with_effects(plant, ["cubic_stiffness"], 2)
    scheme, _ = scheme_and_slopes(plant, unknowns.common[:1], drive.dt)
    found = simulate_states(assembly, unknowns, drive, scheme, resting_states(assembly, drive))
    u = np.concatenate([record.inputs for record in records])
    expected = 3.0 * u[:, 0] + 0.5 * u[:, 1] + 0.2 * u[:, 2] + VALUES["cubic_stiffness"][0] * u[:, 0] ** 3
    assert np.allclose(found.outputs[:, 0], expected)


# --- dry friction under an accelerometer ------------------------------------------------------------------------------


def accelerations_with_dry_friction(load, friction, n_steps=400):
    """Implicit Euler steps with the sharp law (Moreau), `n_steps` a sample: velocities and accelerations at samples."""
    dt = DT / n_steps
    displacement, velocity = 0.0, 0.0
    velocities, accelerations = [], []
    for k in range(len(load) - 1):
        velocities.append(velocity)
        for j in range(n_steps):
            force = load[k] + (load[k + 1] - load[k]) * (j + 1) / n_steps
            free = velocity + dt * (force - STIFFNESS * (displacement + dt * velocity) - DAMPING * velocity) / MASS
            after = np.sign(free) * max(abs(free) - dt * friction / MASS, 0.0)
            if j == 0:
                accelerations.append((after - velocity) / dt)
            velocity = after
            displacement += dt * velocity
    return np.array(velocities), np.array(accelerations)


@pytest.mark.parametrize("upsampling", [2, 4])
def test_an_accelerometer_on_a_mass_that_sticks_reads_what_holds_it(upsampling):
    """The law at a sample is that of a numerical creep there; the output has to hear the force that holds the mass."""
    friction, scale = 6.0, 0.3
    load = slow_noise(300, 4, 7.0)
    velocities, wanted = accelerations_with_dry_friction(load[:, 0], friction)
    model = StructuralModel.chain(
        [MASS], [STIFFNESS], [DAMPING], force_dofs=[0], sensor_dofs=[0], sensor_kind="acceleration"
    )
    plant = structural_plant(model)
    drive = drive_of([Record(load, np.zeros((len(load), 1)), DT, input_hold="linear")], upsampling)
    item = place_effect(plant, CATALOGUE["coulomb_friction"], "element_0", displacement_scale=0.1, velocity_scale=scale)
    assembly = assemble(plant, [item])
    unknowns = initial_unknowns(assembly, 1)
    unknowns.common[assembly.common_of(0)] = [friction]
    scheme, _ = scheme_and_slopes(plant, unknowns.common[: assembly.n_linear], drive.dt)
    found = simulate_states(assembly, unknowns, drive, scheme, resting_states(assembly, drive))
    assert found is not None
    rests = np.abs(velocities) < 1e-9
    inside = rests[1:-1] & rests[:-2] & rests[2:]
    assert inside.sum() > 30
    miss = (found.outputs[:-1, 0] - wanted)[1:-1]
    assert np.abs(miss[inside]).max() < 0.15 * friction
    assert np.sqrt(np.mean(miss[inside] ** 2)) < 0.05 * friction
    assert np.median(np.abs(miss[~inside])) < 0.03 * friction


@pytest.mark.parametrize("start", ["far", "near"])
@pytest.mark.parametrize("softening", [-3e3, *(pytest.param(one, marks=pytest.mark.slow) for one in (-3e4, -3e5))])
def test_a_motion_that_escapes_beside_a_law_with_memory_is_no_simulation(start, softening):
    plant = two_masses()
    drive = drive_of(some_records(plant, lengths=(900,), levels=(30.0,), missing=0.0))
    assembly, unknowns = with_effects(plant, ["quadratic_stiffness", "bouc_wen_hysteresis"], 1)
    unknowns.common[assembly.common_of(0)] = [softening]
    scheme, _ = scheme_and_slopes(plant, unknowns.common[: assembly.n_linear], drive.dt)
    states = np.random.default_rng(3).standard_normal(resting_states(assembly, drive).shape)
    assert simulate_states(assembly, unknowns, drive, scheme, states, start=start) is None


SMOOTHING = 0.3


class Whole:
    """A simulation as a function of the unknowns."""

    def __init__(
        self,
        plant,
        keys,
        *,
        upsampling=1,
        hold="linear",
        missing=0.15,
        gain=0.0,
        port=None,
        seed=0,
        smoothing=SMOOTHING,
    ):
        self.drive = drive_of(some_records(plant, missing=missing, hold=hold), upsampling)
        self.assembly, self.unknowns = with_effects(plant, keys, self.drive.n_records, port=port, seed=seed)
        rng = np.random.default_rng(8)
        self.gain = gain * rng.standard_normal((4, 3)) * [1.0, 0.3, 0.01] if gain else None
        self.smoothing = smoothing
        self.start = resting_states(self.assembly, self.drive)
        self.trajectory = self.at(self.unknowns)
        self.start = self.trajectory.states

    def at(self, unknowns):
        self.scheme, self.slopes = scheme_and_slopes(
            self.assembly.plant, unknowns.common[: self.assembly.n_linear], self.drive.dt
        )
        found = simulate_states(
            self.assembly, unknowns, self.drive, self.scheme, self.start, smoothing=self.smoothing, gain=self.gain
        )
        assert found is not None
        return found

    def analytic(self, **options):
        self.at(self.unknowns)
        return sensitivity(
            self.assembly,
            self.unknowns,
            self.drive,
            self.trajectory,
            self.scheme,
            slopes=self.slopes,
            gain=self.gain,
            **options,
        )

    def by_difference(self, step=1e-6, **which):
        above, below = (self.at(moved(self.unknowns, by=sign * step, **which)) for sign in (1.0, -1.0))
        return tuple((a - b) / (2 * step) for a, b in ((above.outputs, below.outputs), (above.states, below.states)))


def check(whole, tolerance=1e-5):
    found = whole.analytic()
    drive, wrong = whole.drive, {}
    for j in range(whole.assembly.n_common):
        outputs, states = whole.by_difference(common=j)
        wrong[f"common {j}"] = max(error(found.common[j], outputs), error(found.common_states[j], states))
    for record in range(drive.n_records):
        rows, times = drive.rows_of(record), drive.times_of(record)
        for j in range(whole.assembly.n_local):
            outputs, states = whole.by_difference(local=(record, j))
            wrong[f"local {record} {j}"] = max(
                error(found.local[j, rows], outputs[rows]), error(found.local_states[j, times], states[times])
            )
            others = np.delete(outputs, np.r_[rows], axis=0)
            assert not others.any()
    assert len(found.common) == whole.assembly.n_common
    assert len(found.local) == whole.assembly.n_local
    assert max(wrong.values()) < tolerance, {name: value for name, value in wrong.items() if value >= tolerance}


def error(ours, difference):
    if not difference.size:
        return 0.0
    size = np.abs(difference).max()
    assert np.abs(difference).any() or not np.abs(ours).any()
    return np.abs(ours - difference).max() / max(size, 1e-12)


def tolerance_of(key):
    """The line of a jump is a series where the velocity hardly changes over the step, good to 1e-4."""
    return 1e-4 if key == "coulomb_friction" else 1e-5


@pytest.mark.parametrize("key", list(VALUES))
def test_by_everything_in_free_run(key):
    check(Whole(two_masses(), [key]), tolerance=tolerance_of(key))


@pytest.mark.parametrize("key", list(VALUES))
def test_by_everything_in_observer_form(key):
    check(Whole(two_masses(), [key], gain=0.05), tolerance=tolerance_of(key))


@pytest.mark.parametrize(
    "key", ["cubic_stiffness", "missing_mode", "bouc_wen_hysteresis", "periodic_disturbance", "coulomb_friction"]
)
@pytest.mark.parametrize("port", ["between", "anywhere"])
def test_other_places_and_free_directions(key, port):
    check(Whole(two_masses(), [key], port=port, upsampling=2), tolerance=tolerance_of(key))


@pytest.mark.parametrize("hold", ["zero_order", "linear", "band_limited"])
@pytest.mark.parametrize(
    "chain",
    [
        ("input_gain", "input_saturation", "input_delay"),
        ("input_saturation", "input_gain", "input_delay"),
        ("input_delay", "input_saturation", "input_gain"),
    ],
)
def test_chains_at_an_input(chain, hold):
    check(Whole(two_masses(), list(chain), hold=hold), tolerance=1e-4)


def test_chains_at_two_inputs():
    check(
        Whole(
            two_masses(),
            [("input_gain", "other"), ("input_delay", "push"), ("input_gain", "push"), ("input_delay", "other")],
        )
    )


@pytest.mark.parametrize("chain", [("sensor_gain", "sensor_bias"), ("sensor_bias", "sensor_gain")])
def test_chains_at_a_sensor(chain):
    check(Whole(two_masses(), [*chain, ("sensor_gain", "place"), "cubic_stiffness"]))


def test_a_crowd_of_effects():
    keys = [
        "missing_mode",
        "coulomb_friction",
        "periodic_disturbance",
        "bouc_wen_hysteresis",
        ("cubic_stiffness", "anywhere"),
    ]
    check(Whole(two_masses(), [*keys, "input_delay", "sensor_gain"], upsampling=2, gain=0.05))


@pytest.mark.parametrize("key", [key for key in VALUES if not key.startswith("sensor")])
def test_plants_without_states(key):
    check(Whole(imposed_motion(), [key]))


@pytest.mark.parametrize("law", ["cubic_stiffness", "bouc_wen_hysteresis", "missing_mode", "coulomb_friction"])
@pytest.mark.parametrize("change", ["input_gain", "input_delay"])
def test_a_change_of_the_input_that_moves_a_port(law, change):
    check(Whole(imposed_motion(), [law, change]))


@pytest.mark.parametrize("law", ["cubic_stiffness", "bouc_wen_hysteresis", "missing_mode", "coulomb_friction"])
def test_a_change_of_the_input_that_moves_a_port_of_a_plant_with_states(law):
    """The input is also a motion of the ground, as where a displacement sensor reads part of the input."""
    plant = two_masses()
    ground = plant.ports[0]
    displacement, velocity = ground.displacement.copy(), ground.velocity.copy()
    displacement[4], velocity[5] = -0.05, 0.1
    plant = replace(plant, ports=(replace(ground, displacement=displacement, velocity=velocity), *plant.ports[1:]))
    check(Whole(plant, [law, "input_gain", ("input_delay", "other")], gain=0.03), tolerance=tolerance_of(law))


def test_the_slopes_of_a_direction_alone():
    whole = Whole(two_masses(), ["cubic_stiffness", "missing_mode"], port="anywhere")
    own = whole.analytic(common=False)
    everything = whole.analytic()
    assert np.array_equal(own.local, everything.local)
    assert len(own.common) == whole.assembly.n_linear


def test_the_response_to_a_force_is_that_of_a_linear_simulation():
    """With no nonlinear law the response to a force in a column is the difference of two simulations."""
    whole = Whole(two_masses(), [("sensor_gain", "speed")], gain=0.05)
    force = np.random.default_rng(1).standard_normal(whole.drive.n_times)
    source = force_response(whole.drive, whole.scheme, 1, force, 4)
    both = [source, Source()]
    states, outputs = respond(whole.assembly, whole.unknowns, whole.trajectory, both, 2, gain=whole.gain)
    assert not states[1].any()
    assert not outputs[1].any()
    # the same force as a third input
    plant = whole.assembly.plant
    system = np.insert(plant.system, 6, plant.system[:, :, 4 + 2 + 1], axis=2)
    wider = replace(plant, system=system, n_inputs=3, input_names=("push", "other", "force"), input_units=("N",) * 3)
    ports = tuple(
        replace(p, displacement=np.insert(p.displacement, 6, 0.0), velocity=np.insert(p.velocity, 6, 0.0))
        for p in plant.ports
    )
    wider = replace(wider, ports=ports)
    drive = whole.drive
    end = np.concatenate([force[1:], force[-1:]])
    assembly = replace(whole.assembly, plant=wider)
    scheme, _ = scheme_and_slopes(wider, whole.unknowns.common[:2], drive.dt)

    def run(size):
        columns = (
            np.column_stack([one, size * add])
            for one, add in ((drive.start, force), (drive.end, end), (drive.sample, force))
        )
        start, ends, sample = columns
        driven = replace(drive, start=start, end=ends, sample=sample)
        return simulate_states(assembly, whole.unknowns, driven, scheme, whole.start, gain=whole.gain)

    with_force, without = run(1.0), run(0.0)
    assert np.allclose(states[0], with_force.states - without.states, atol=1e-10)
    assert np.allclose(outputs[0], with_force.outputs - without.outputs, atol=1e-10)
