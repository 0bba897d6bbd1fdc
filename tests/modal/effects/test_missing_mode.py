from dataclasses import replace

import numpy as np
import pytest
import scipy.integrate
from differences import by_value, central, disagreement, force_disagreement, shifted
from hypothesis import given, settings
from hypothesis import strategies as st

from modal.effects.effect import Motion, Situation
from modal.effects.outside_forces import FreeVibration, MissingMode

seeds = st.integers(0, 2**31)
frequencies = st.floats(0.2, 40.0)
dampings = st.floats(0.0, 0.9)


def motion(displacement, velocity, memory, *, mass=1.7):
    return Motion(
        displacement=displacement,
        velocity=velocity,
        time=np.arange(float(len(displacement))),
        memory=memory,
        displacement_scale=1.0,
        velocity_scale=1.0,
        mass=mass,
    )


def random_motion(seed, n=8):
    rng = np.random.default_rng(seed)
    return motion(rng.standard_normal(n), rng.standard_normal(n), rng.standard_normal((n, 2)))


def hermite(before, after, dt, s):
    """The textbook cubic through values and slopes at both ends, with its slope, at the share s of the step."""
    d0, v0, d1, v1 = before.displacement[0], before.velocity[0], after.displacement[0], after.velocity[0]
    value = (
        (1 + 2 * s) * (1 - s) ** 2 * d0
        + s * (1 - s) ** 2 * dt * v0
        + s**2 * (3 - 2 * s) * d1
        + s**2 * (s - 1) * dt * v1
    )
    slope = (6 * s**2 - 6 * s) * (d0 - d1) / dt + (3 * s**2 - 4 * s + 1) * v0 + (3 * s**2 - 2 * s) * v1
    return value, slope


@settings(max_examples=25)
@given(seed=seeds, frequency=frequencies, damping=dampings)
def test_one_step_is_the_solution_of_the_absorber_on_a_place_that_moves_by_a_cubic(seed, frequency, damping):
    before, after, dt = random_motion(seed, 1), random_motion(seed + 1, 1), 0.02
    w = 2 * np.pi * frequency

    def rate(t, z):
        d, v = hermite(before, after, dt, t / dt)
        return [z[1], w**2 * (d - z[0]) + 2 * damping * w * (v - z[1])]

    exact = scipy.integrate.solve_ivp(rate, (0.0, dt), before.memory[0], method="DOP853", rtol=1e-11, atol=1e-12)
    found = MissingMode().advance([0.1, frequency, damping], before, after, dt).value[0]
    np.testing.assert_allclose(found, exact.y[:, -1], rtol=1e-8, atol=1e-8 * max(w, 1.0))


@settings(max_examples=30)
@given(seed=seeds, frequency=frequencies, damping=st.floats(0.01, 0.9), ratio=st.floats(0.01, 2.0))
def test_derivatives_agree_with_differences(seed, frequency, damping, ratio):
    effect, values, dt = MissingMode(), [ratio, frequency, damping], 0.02
    before, after = random_motion(seed), random_motion(seed + 1)
    assert max(force_disagreement(effect, values, before).values()) < 1e-5
    memory = effect.advance(values, before, after, dt)
    for moved in ("displacement", "velocity"):
        from_before = central(lambda s, m=moved: effect.advance(values, shifted(before, m, s), after, dt).value, 0.0)
        from_after = central(lambda s, m=moved: effect.advance(values, before, shifted(after, m, s), dt).value, 0.0)
        assert disagreement(getattr(memory, f"by_{moved}_before"), from_before) < 1e-6
        assert disagreement(getattr(memory, f"by_{moved}_after"), from_after) < 1e-6
    for m in range(2):
        difference = central(lambda s, m=m: effect.advance(values, shifted(before, m, s), after, dt).value, 0.0)
        assert disagreement(memory.by_memory[:, :, m], difference) < 1e-6
    for j in range(3):
        difference = by_value(lambda changed: effect.advance(changed, before, after, dt).value, values, j)
        assert disagreement(memory.by_parameter[:, :, j], difference) < 1e-5


def steady_state(frequency, damping, driven_at, dt, n, *, mass=2.0, ratio=0.3):
    """Force on a place that moves as sin(2 pi driven_at t), marched from the closed form's start, and that form.

    Den Hartog: z / d = (w^2 + 2 i damping w W) / (w^2 - W^2 + 2 i damping w W), and the force is m z''.
    """
    w, W = 2 * np.pi * frequency, 2 * np.pi * driven_at
    transmitted = (w**2 + 2j * damping * w * W) / (w**2 - W**2 + 2j * damping * w * W)
    t = dt * np.arange(n)
    z = transmitted * np.exp(1j * W * t)
    closed = np.imag(-(W**2) * ratio * mass * z)
    whole = motion(np.sin(W * t), W * np.cos(W * t), np.zeros((n, 2)), mass=mass)
    state, states = np.array([np.imag(z[0]), np.imag(1j * W * z[0])]), []
    for k in range(n):
        states.append(state)
        here = replace(whole, displacement=whole.displacement[k : k + 1], velocity=whole.velocity[k : k + 1])
        here = replace(here, time=whole.time[k : k + 1], memory=state[np.newaxis])
        if k + 1 < n:
            there = replace(
                here, displacement=whole.displacement[k + 1 : k + 2], velocity=whole.velocity[k + 1 : k + 2]
            )
            state = MissingMode().advance([ratio, frequency, damping], here, there, dt).value[0]
    force = MissingMode().force([ratio, frequency, damping], replace(whole, memory=np.array(states))).value
    return whole, force, closed


@pytest.mark.parametrize("driven_at", [0.8, 2.0, 2.6])
def test_a_sine_calls_up_the_force_of_the_dynamic_absorber(driven_at):
    _, force, closed = steady_state(2.0, 0.05, driven_at, 0.01, 400)
    np.testing.assert_allclose(force, closed, atol=1e-4 * np.max(np.abs(closed)))
    _, coarse, again = steady_state(2.0, 0.05, driven_at, 0.02, 200)
    # the cubic errs by the fourth power of the step
    assert np.max(np.abs(force - closed)) < np.max(np.abs(coarse - again)) / 8


def test_a_closed_cycle_never_gives_energy():
    for damping in (0.0, 0.05, 0.5):
        whole, force, _ = steady_state(2.0, damping, 1.0, 0.01, 101)  # one period
        work = np.trapezoid(force * whole.velocity, dx=0.01)
        assert work > 1e-3 if damping else abs(work) < 1e-4


def test_a_stiff_absorber_is_an_added_mass():
    """Held by a stiff spring, the hung mass moves with its place: the force is m d''."""
    whole, force, _ = steady_state(60.0, 0.05, 1.0, 0.002, 500, mass=2.0, ratio=0.3)
    np.testing.assert_allclose(force, -0.6 * (2 * np.pi) ** 2 * whole.displacement, atol=0.02 * 0.6 * (2 * np.pi) ** 2)


@pytest.mark.parametrize("frequency", [0.0, 1e-9, 1e3, 1e6])
def test_extreme_frequencies_give_finite_steps(frequency):
    before, after = random_motion(1), random_motion(2)
    memory = MissingMode().advance([0.1, frequency, 0.02], before, after, 0.01)
    for part in (memory.value, memory.by_memory, memory.by_parameter, memory.by_displacement_after):
        assert np.all(np.isfinite(part))
    if frequency == 0.0:  # nothing holds the mass: it goes on as it was
        np.testing.assert_allclose(memory.value[:, 0], before.memory[:, 0] + 0.01 * before.memory[:, 1])


def test_starts_surround_the_peaks_of_the_residual():
    moved = random_motion(3)
    starts = MissingMode().starts(Situation(motion=moved, residual_frequencies=(3.0, 9.0), dt=0.01, longest=5.0))
    assert starts[0] == (1.0, 3.0, 0.02)
    for peak in (3.0, 9.0):
        near = [frequency for _, frequency, _ in starts if 0.85 * peak < frequency < 1.15 * peak]
        assert min(near) < peak < max(near)
    without = MissingMode().starts(Situation(motion=moved, residual_frequencies=(), dt=0.01, longest=5.0))
    assert without[0][1] == pytest.approx(1.0 / (2 * np.pi))  # scales of 1: the mean frequency of a narrow-band motion


def test_bounds_units_and_neutral():
    assert [kind.name for kind in MissingMode.parameters] == ["mass_ratio", "frequency", "damping"]
    assert [kind.dimension for kind in MissingMode.parameters] == [(0, 0, 0), (0, 0, -1), (0, 0, 0)]
    assert [kind.lower for kind in MissingMode.parameters] == [0.0] * 3
    assert np.all(MissingMode().force(MissingMode.neutral, random_motion(4)).value == 0.0)


@settings(max_examples=25)
@given(seed=seeds, frequency=frequencies, damping=dampings)
def test_a_free_vibration_has_the_derivatives_of_a_mass_whose_place_is_held(seed, frequency, damping):
    given, law, hung = random_motion(seed), FreeVibration(), MissingMode()
    held = replace(given, displacement=0.0 * given.displacement, velocity=0.0 * given.velocity)
    force, as_hung = law.force([frequency, damping], given), hung.force([1.0, frequency, damping], held)
    np.testing.assert_array_equal(force.by_memory, as_hung.by_memory)
    np.testing.assert_array_equal(force.by_parameter, as_hung.by_parameter[:, 1:])
    step = law.advance([frequency, damping], given, given, 0.02)
    as_hung = hung.advance([1.0, frequency, damping], held, held, 0.02)
    np.testing.assert_array_equal(step.by_memory, as_hung.by_memory)
    np.testing.assert_array_equal(step.by_parameter, as_hung.by_parameter[:, :, 1:])
    reached = (force.by_displacement, force.by_velocity, step.by_displacement_before, step.by_velocity_after)
    assert not any(np.any(one) for one in reached)


@settings(max_examples=25)
@given(seed=seeds, frequency=frequencies, damping=dampings)
def test_a_light_mass_with_a_wide_swing_comes_to_a_vibration_that_no_motion_drives(seed, frequency, damping):
    light, dt = 1e-9, 0.02
    before, after = random_motion(seed, 4), random_motion(seed + 1, 4)
    values = [light, frequency, damping]
    limit, kept, factor = MissingMode().undriven(values)
    wide = [replace(one, memory=one.memory / light) for one in (before, after)]
    assert factor == light
    np.testing.assert_allclose(
        MissingMode().force(values, wide[0]).value, limit.force(kept, before).value, rtol=1e-6, atol=1e-6 * frequency**2
    )
    np.testing.assert_allclose(
        factor * MissingMode().advance(values, *wide, dt).value, limit.advance(kept, before, after, dt).value,
        rtol=1e-6, atol=1e-6 * max(frequency, 1.0),
    )  # fmt: skip
