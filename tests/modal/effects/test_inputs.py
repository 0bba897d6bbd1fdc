import numpy as np
import pytest
from differences import by_value, disagreement
from hypothesis import given
from hypothesis import strategies as st

from modal.effects.effect import Motion, Situation
from modal.effects.inputs import DelayedInput, InputGain, InputSaturation
from modal.effects.sensors import SensorBias, SensorGain

GAUSS = np.polynomial.legendre.leggauss(3)  # exact for the squares that a line times (s - 1/2) makes
delays = st.floats(-7.0, 7.0)
seeds = st.integers(0, 2**31)


def value(start, end, time):
    """A drive that is linear within each step of length 1, its first value before the start, its last after the end."""
    if time < 0.0:
        return start[0]
    if time >= len(start):
        return end[-1]
    k = int(np.floor(time))
    return start[k] + (time - k) * (end[k] - start[k])


def moments(start, end, tau, k):
    """Mean and first moment about the middle of the delayed drive over step k, by quadrature of its two pieces."""
    split = tau - np.floor(tau)
    mean = moment = 0.0
    for low, high in ((0.0, split), (split, 1.0)):
        for node, weight in zip(*GAUSS, strict=True):
            s = low + 0.5 * (high - low) * (node + 1.0)
            u = value(start, end, k + s - tau) * weight * 0.5 * (high - low)
            mean, moment = mean + u, moment + (s - 0.5) * u
    return mean, moment


@given(tau=delays, seed=seeds, held=st.booleans())
def test_each_step_has_the_mean_and_the_first_moment_of_the_delayed_drive(tau, seed, held):
    rng = np.random.default_rng(seed)
    start = rng.standard_normal(12)
    end = start if held else rng.standard_normal(12)
    begun, ended = DelayedInput().apply([tau * 0.3], start, end, 0.3)
    for k in range(12):
        mean, moment = moments(start, end, tau, k)
        assert (begun[k] + ended[k]) / 2 == pytest.approx(mean, abs=1e-5)  # a whole number to 1e-6 counts as whole
        assert (ended[k] - begun[k]) / 12 == pytest.approx(moment, abs=1e-5)


def test_a_held_drive_has_the_slope_of_its_jump():
    u = np.array([1.0, 3.0, 3.0])
    begun, ended = DelayedInput().apply([0.25], u, u, 1.0)
    np.testing.assert_allclose((begun + ended) / 2, [1.0, 0.25 * 1.0 + 0.75 * 3.0, 3.0])
    np.testing.assert_allclose(ended - begun, [0.0, 6 * 0.25 * 0.75 * 2.0, 0.0])


@pytest.mark.parametrize("lag", [-(10**9), -5, -4, -1, 0, 1, 3, 5, 9, 10**9])
def test_whole_delays_shift_and_hold_the_first_and_the_last_value(lag):
    rng = np.random.default_rng(1)
    start, end = rng.standard_normal(5), rng.standard_normal(5)
    begun, ended = DelayedInput().apply([lag * 0.1], start, end, 0.1)
    for k in range(5):
        inside = 0 <= k - lag < 5
        outside = start[0] if lag > 0 else end[-1]
        assert begun[k] == (start[k - lag] if inside else outside)
        assert ended[k] == (end[k - lag] if inside else outside)


@given(lag=st.integers(-6, 6), seed=seeds)
def test_the_line_is_continuous_across_whole_steps(lag, seed):
    u = np.random.default_rng(seed).standard_normal(10)
    at = [DelayedInput().apply([(lag + side) * 0.02], u, u, 0.02) for side in (-1e-4, 0.0, 1e-4)]
    for side in (at[0], at[2]):
        np.testing.assert_allclose(side[0], at[1][0], atol=1e-4 * 10 * np.ptp(u))
        np.testing.assert_allclose(side[1], at[1][1], atol=1e-4 * 10 * np.ptp(u))


@given(tau=st.floats(-3.0, 3.0), slope=st.floats(-5.0, 5.0))
def test_a_ramp_stays_a_ramp(tau, slope):
    t = np.arange(10.0)
    begun, ended = DelayedInput().apply([tau], slope * t, slope * (t + 1.0), 1.0)
    sample = DelayedInput().at_samples([tau], slope * t, slope * t, slope * (t + 1.0), 1.0)
    later = (t >= 3.0) & (t < 7.0)
    np.testing.assert_allclose(begun[later], slope * (t - tau)[later], atol=1e-4)
    np.testing.assert_allclose(ended[later], slope * (t + 1.0 - tau)[later], atol=1e-4)
    np.testing.assert_allclose(sample[later], slope * (t - tau)[later], atol=1e-4)


@given(tau=st.floats(-4.99, 4.99), seed=seeds)
def test_a_held_drive_reaches_the_outputs_with_the_value_of_the_step_before(tau, seed):
    u = np.random.default_rng(seed).standard_normal(12)
    sample = DelayedInput().at_samples([tau * 0.1], u, u, u, 0.1)
    lag = round(tau) if abs(tau - round(tau)) < 1e-6 else int(np.ceil(tau))
    np.testing.assert_allclose(sample, [u[min(max(k - lag, 0), 11)] for k in range(12)], atol=1e-12)


@pytest.mark.parametrize("f", [0.2, 0.5, 0.9])
def test_a_plant_s_state_is_right_to_the_second_order_of_the_step(f):
    """x' = -p x + u(t - tau), held u: exact by its two pieces, against one line a step (its mean alone is worse)."""
    u = np.random.default_rng(2).standard_normal(400)
    errors = []
    for p_dt in (0.2, 0.1):
        decay = np.exp(-p_dt)
        begun, ended = DelayedInput().apply([f], u, u, 1.0)
        exact, found, worst = 0.0, 0.0, 0.0
        for k in range(1, 400):
            first = np.exp(-p_dt * (1 - f)) - decay  # the piece [0, f] of the value before, p times its integral
            exact = decay * exact + first * u[k - 1] + (1 - np.exp(-p_dt * (1 - f))) * u[k]
            ramp = 1.0 - (1.0 - decay) / p_dt  # p times the integral of s exp(-p (1 - s))
            found = decay * found + (1 - decay) * begun[k] + ramp * (ended[k] - begun[k])
            worst = max(worst, abs(found - exact))
        errors.append(worst / np.ptp(u))
    # each step is right to (p dt)^3, of which 1 / (p dt) steps add up at worst
    assert errors[0] < 0.2**2 / 12
    assert errors[1] < errors[0] / 2.5


@given(tau=delays, seed=seeds, held=st.booleans())
def test_derivatives_agree_with_differences_between_whole_steps(tau, seed, held):
    tau = np.floor(tau) + np.clip(tau % 1.0, 0.01, 0.99)
    rng = np.random.default_rng(seed)
    start = rng.standard_normal(12)
    end, dt, effect = start if held else rng.standard_normal(12), 0.3, DelayedInput()

    def changed(values):
        return np.stack([*effect.apply(values, start, end, dt), effect.at_samples(values, start, start, end, dt)])

    found = np.concatenate(effect.by_parameter([tau * dt], start, start, end, dt))
    assert disagreement(found, by_value(changed, [tau * dt], 0)) < 1e-5


@given(lag=st.integers(-6, 6), seed=seeds, held=st.booleans())
def test_derivatives_at_whole_steps_are_those_of_one_side(lag, seed, held):
    rng = np.random.default_rng(seed)
    start = rng.standard_normal(12)
    end = start if held else rng.standard_normal(12)
    side = lag - 1e-5 if lag > 0 else lag + 1e-5
    for at, near in zip(
        DelayedInput().by_parameter([lag * 0.1], start, start, end, 0.1),
        DelayedInput().by_parameter([side * 0.1], start, start, end, 0.1),
        strict=True,
    ):
        np.testing.assert_allclose(at, near, atol=1e-4 * 100 * max(np.ptp(start), np.ptp(end)))


def test_starts_lie_between_whole_samples_within_a_tenth_of_the_record():
    motion = Motion(
        displacement=np.ones(4),
        velocity=np.zeros(4),
        time=np.arange(4.0),
        memory=np.zeros((4, 0)),
        displacement_scale=1.0,
        velocity_scale=1.0,
    )
    for longest in (0.02, 1.0, 1000.0):
        starts = DelayedInput().starts(Situation(motion=motion, residual_frequencies=(), dt=0.01, longest=longest))
        assert starts
        assert all(abs(tau / 0.01 % 1.0 - 0.5) < 1e-9 for (tau,) in starts)
        assert all(tau <= max(0.1 * longest, 0.005) for (tau,) in starts)


def test_an_empty_record_stays_empty():
    empty = np.empty(0)
    assert DelayedInput().apply([0.1], empty, empty, 0.1)[0].size == 0
    assert DelayedInput().at_samples([0.1], empty, empty, empty, 0.1).size == 0
    assert DelayedInput().by_parameter([0.1], empty, empty, empty, 0.1)[0].shape == (1, 0)


drives = st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=20).map(np.array)


def situation(drive):
    motion = Motion(
        displacement=drive,
        velocity=np.zeros_like(drive),
        time=np.arange(float(drive.size)),
        memory=np.zeros((drive.size, 0)),
        displacement_scale=float(np.std(drive)),
        velocity_scale=0.0,
    )
    return Situation(motion=motion, residual_frequencies=(), dt=1.0, longest=float(drive.size))


@given(drive=drives, limit=st.floats(0.0, 1e6))
def test_each_end_is_cut_at_the_limit_and_kept_below_it(drive, limit):
    start, end = InputSaturation().apply([limit], drive, -drive[::-1], 0.1)
    for cut, given_ in ((start, drive), (end, -drive[::-1])):
        assert np.all(np.abs(cut) <= limit)
        within = np.abs(given_) <= limit
        np.testing.assert_array_equal(cut[within], given_[within])
        np.testing.assert_array_equal(cut[~within], limit * np.sign(given_[~within]))


@given(drive=drives)
def test_an_infinite_limit_changes_nothing_and_the_law_is_odd(drive):
    effect = InputSaturation()
    np.testing.assert_array_equal(effect.apply(effect.neutral, drive, drive, 0.1)[0], drive)
    np.testing.assert_array_equal(
        effect.apply([2.0], -drive, drive, 0.1)[0], -effect.apply([2.0], drive, drive, 0.1)[0]
    )


@given(drive=drives)
def test_what_reaches_the_outputs_directly_is_cut_too(drive):
    cut = InputSaturation().at_samples([1.5], drive, 0.9 * drive, 1.1 * drive, 0.1)
    np.testing.assert_array_equal(cut, np.clip(drive, -1.5, 1.5))


@given(seed=st.integers(0, 2**31), limit=st.floats(0.1, 2.0))
def test_derivatives_agree_with_differences(seed, limit):
    drive, effect = np.random.default_rng(seed).standard_normal(30), InputSaturation()

    def changed(values):
        ends = effect.apply(values, drive, 0.5 * drive, 0.1)
        return np.stack([*ends, effect.at_samples(values, 2.0 * drive, drive, 0.5 * drive, 0.1)])

    found = np.concatenate(effect.by_parameter([limit], 2.0 * drive, drive, 0.5 * drive, 0.1))
    assert disagreement(found, by_value(changed, [limit], 0)) < 1e-6


@given(drive=drives)
def test_every_start_clips_something(drive):
    starts = InputSaturation().starts(situation(drive))
    peak = np.max(np.abs(drive))
    assert bool(starts) == bool(peak > 0)
    assert all(0 < limit < peak for (limit,) in starts) or peak < 1e-300


def test_a_step_drive_has_starts_below_its_level():
    starts = InputSaturation().starts(situation(np.full(50, 12.0)))
    assert [round(limit, 6) for (limit,) in starts] == [10.8, 8.4, 6.0, 3.6]


signals = st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=20).map(np.array)
numbers = st.floats(-10.0, 10.0)


@given(drive=signals, gain=numbers)
def test_an_input_gain_is_the_factor_itself(drive, gain):
    start, end = InputGain().apply([gain], drive, 2.0 * drive, 0.1)
    np.testing.assert_array_equal(start, gain * drive)
    np.testing.assert_array_equal(end, gain * 2.0 * drive)
    np.testing.assert_array_equal(InputGain().at_samples([gain], drive, 3.0 * drive, drive, 0.1), gain * drive)
    for slope, part in zip(
        InputGain().by_parameter([gain], drive, 2.0 * drive, 3.0 * drive, 0.1), (2, 3, 1), strict=True
    ):
        np.testing.assert_array_equal(slope, part * drive[np.newaxis])


@given(output=signals, first=numbers, second=numbers)
def test_sensor_derivatives_agree_with_differences(output, first, second):
    time = 0.1 * np.arange(output.size)
    for effect, values in ((SensorGain(), [first]), (SensorBias(), [first, second])):

        def sensed(changed, effect=effect):
            return effect.gain(changed) * output + effect.offset(changed, time)

        derivative = effect.by_parameter(values, output, time)
        assert derivative.shape == (output.size, len(values))
        for j in range(len(values)):
            assert disagreement(derivative[:, j], by_value(sensed, values, j)) < 1e-6


@given(output=signals, gain=numbers, offset=numbers, slope=numbers)
def test_a_sensor_reads_by_the_law(output, gain, offset, slope):
    time = 0.1 * np.arange(output.size)
    bias = SensorBias()
    np.testing.assert_array_equal(SensorGain().gain([gain]) * output, gain * output)
    np.testing.assert_array_equal(SensorGain().offset([gain], time), 0.0)
    assert bias.gain([offset, slope]) == 1.0
    np.testing.assert_allclose(bias.offset([offset, slope], time), [offset + slope * t for t in time])


@given(signal=signals)
def test_neutral_values_change_nothing(signal):
    time = np.arange(float(signal.size))
    np.testing.assert_array_equal(InputGain().apply(InputGain.neutral, signal, signal, 0.1)[0], signal)
    for effect in (SensorGain(), SensorBias()):
        sensed = effect.gain(effect.neutral) * signal + effect.offset(effect.neutral, time)
        np.testing.assert_array_equal(sensed, signal)


def test_units_are_those_of_the_channel():
    assert [kind.dimension for kind in SensorBias.parameters] == [(1, 0, 0), (1, 0, -1)]
    assert [kind.dimension for kind in (*SensorGain.parameters, *InputGain.parameters)] == [(0, 0, 0)] * 2
