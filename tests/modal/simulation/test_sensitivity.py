"""Outputs by everything unknown, against central differences of whole simulations."""

from dataclasses import replace

import numpy as np
import pytest
from engine_plants import VALUES, imposed_motion, moved, some_records, two_masses, with_effects

from modal.simulation.drive import drive_of
from modal.simulation.scheme import scheme_and_slopes
from modal.simulation.trajectory import Source, force_response, respond, resting_states, sensitivity, simulate_states

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
    states, outputs = respond(whole.assembly, whole.unknowns, whole.trajectory, [source, Source()], gain=whole.gain)
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
