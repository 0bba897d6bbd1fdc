import numpy as np
import pytest
from differences import force_disagreement
from hypothesis import given
from hypothesis import strategies as st

from modal.effects.effect import Motion, Situation
from modal.effects.outside_forces import ConstantForce, PeriodicDisturbance


def motion(*, seed=0, n=30, dt=0.01, scale=1.0):
    rng = np.random.default_rng(seed)
    return Motion(
        displacement=scale * rng.standard_normal(n),
        velocity=scale * rng.standard_normal(n),
        time=dt * np.arange(n),
        memory=np.zeros((n, 0)),
        displacement_scale=scale,
        velocity_scale=scale,
    )


@given(seed=st.integers(0, 2**31), offset=st.floats(-100.0, 100.0))
def test_a_constant_force_is_its_offset_whatever_the_motion(seed, offset):
    moved = motion(seed=seed, scale=1e3)
    np.testing.assert_array_equal(ConstantForce().force([offset], moved).value, offset)
    assert max(force_disagreement(ConstantForce(), [offset], moved).values()) < 1e-6


@given(
    seed=st.integers(0, 2**31),
    amplitude=st.floats(0.01, 10.0),
    frequency=st.floats(0.1, 50.0),
    phase=st.floats(-4.0, 4.0),
)
def test_a_disturbance_is_its_sine_and_its_derivatives_agree_with_differences(seed, amplitude, frequency, phase):
    values = [amplitude, frequency, phase]
    moved = motion(seed=seed)
    expected = [amplitude * np.sin(2 * np.pi * frequency * t + phase) for t in moved.time]
    np.testing.assert_allclose(PeriodicDisturbance().force(values, moved).value, expected, atol=1e-12 * amplitude)
    assert max(force_disagreement(PeriodicDisturbance(), values, moved).values()) < 1e-5


@given(amplitude=st.floats(0.01, 10.0), frequency=st.floats(0.1, 50.0), phase=st.floats(-3.1, 3.1))
def test_sine_and_cosine_of_the_screen_make_up_every_amplitude_and_phase(amplitude, frequency, phase):
    effect, moved = PeriodicDisturbance(), motion(n=200)
    columns = effect.screen_columns([1.0, frequency, 0.0], moved)
    force = effect.force([amplitude, frequency, phase], moved).value
    weights = np.array([amplitude * np.cos(phase), amplitude * np.sin(phase)])
    np.testing.assert_allclose(columns @ weights, force, atol=1e-9)
    assert effect.from_screen([1.0, frequency, 0.0], weights) == pytest.approx((amplitude, frequency, phase))


def test_each_record_may_have_a_phase_of_its_own():
    moved = motion(n=6)
    phases = np.array([0.0, 0.0, 0.0, 1.5, 1.5, 1.5])
    force = PeriodicDisturbance().force([2.0, 3.0, phases], moved)
    for part, phase in ((slice(0, 3), 0.0), (slice(3, 6), 1.5)):
        alone = PeriodicDisturbance().force([2.0, 3.0, phase], moved)
        np.testing.assert_array_equal(force.value[part], alone.value[part])
        np.testing.assert_array_equal(force.by_parameter[part], alone.by_parameter[part])
    assert [kind.local for kind in PeriodicDisturbance.parameters] == [False, False, True]


def test_a_sine_anywhere_within_the_line_of_the_highest_peak_is_met_by_a_start():
    """A screen over one record must keep at least 90 % of the power of a sine up to half a line off the peak."""
    effect, longest = PeriodicDisturbance(), 4.0
    moved = motion(n=800, dt=longest / 800)
    situation = Situation(motion=moved, residual_frequencies=(20.0, 31.0, 7.0, 55.0), dt=longest / 800, longest=longest)
    starts = effect.starts(situation)
    assert {frequency for _, frequency, _ in starts} >= {20.0, 31.0, 7.0}
    for off in np.linspace(-0.5, 0.5, 11):
        sine = np.sin(2 * np.pi * (20.0 + off / longest) * moved.time + 0.7)
        kept = []
        for start in starts:
            columns = effect.screen_columns(start, moved)
            left = sine - columns @ np.linalg.lstsq(columns, sine, rcond=None)[0]
            kept.append(1.0 - left @ left / (sine @ sine))
        assert max(kept) > 0.9


def test_what_has_hardly_three_periods_in_a_record_is_a_drift():
    situation = Situation(motion=motion(), residual_frequencies=(0.4, 0.8, 2.0), dt=0.01, longest=4.0)
    frequencies = [frequency for _, frequency, _ in PeriodicDisturbance().starts(situation)]
    assert min(frequencies) > 0.7
    assert 2.0 in frequencies


def test_without_peaks_there_is_no_start():
    situation = Situation(motion=motion(), residual_frequencies=(), dt=0.01, longest=1.0)
    assert PeriodicDisturbance().starts(situation) == ()
    assert ConstantForce().starts(situation) == ((1.0,),)


def test_no_motion_is_needed_and_any_port_that_takes_a_force_will_do():
    for effect in (ConstantForce(), PeriodicDisturbance()):
        assert effect.needs == frozenset()
        assert effect.acts_at == "force"
        assert np.all(effect.force(effect.neutral, motion()).value == 0.0)


def test_units():
    assert [kind.dimension for kind in ConstantForce.parameters] == [(1, 0, 0)]
    assert [kind.dimension for kind in PeriodicDisturbance.parameters] == [(1, 0, 0), (0, 0, -1), (0, 0, 0)]
