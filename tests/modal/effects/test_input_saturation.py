import numpy as np
from differences import by_value, disagreement
from hypothesis import given
from hypothesis import strategies as st

from modal.effects.effect import Motion, Situation
from modal.effects.inputs import InputSaturation

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
