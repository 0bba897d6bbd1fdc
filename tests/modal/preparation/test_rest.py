"""Rest before a blow: believed only where the record shows it, and the release that stands for a decay."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import cheby1, sosfilt

from modal.preparation.rest import released, with_rest
from modal.preparation.steps import prepare
from okid.record import Record

RING = 0.99 ** np.arange(2000.0) * np.cos(0.7 * np.arange(2000.0))


def struck(at, *, level=0.0, noise=0.0, before=0.0, seed=0):
    """A blow in row `at`, which rings; `before` the size of motion that was there when the record began."""
    rng = np.random.default_rng(seed)
    blow = np.zeros(2000)
    blow[at : at + 3] = [0.5, 1.0, 0.5]
    ring = np.convolve(blow, RING)[:2000] + before * RING
    return Record(blow + 4.0, ring + level + noise * rng.standard_normal(2000), 0.01)


@pytest.mark.parametrize("at", [0, 3, 30, 700])
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_rest_is_put_in_front(at, noise):
    found = with_rest([struck(at, level=5.0, noise=noise)])
    (n_rest,), (record,) = found.n_rest, found.records
    assert n_rest > 100
    assert record.n_samples == 2000 + n_rest
    assert not record.inputs[:n_rest].any()
    assert not record.outputs[:n_rest].any()
    np.testing.assert_allclose(record.inputs[n_rest + at + 1], 1.0)
    answer = np.convolve([0.5, 1.0, 0.5], RING)[:1000]
    np.testing.assert_allclose(record.outputs[n_rest + at :][:1000, 0], answer, atol=5 * noise + 1e-4)


@pytest.mark.parametrize("at", [1, pytest.param(2, marks=pytest.mark.slow), 4, 10])
def test_a_few_rows_of_noise_are_rest(at):
    """One value of noise in twenty is beyond two deviations: a tenth of all records with a blow in row 1 or 2."""
    resting = [with_rest([struck(at, noise=0.03, seed=seed)]).n_rest[0] > 0 for seed in range(300)]
    moving = [with_rest([struck(at, noise=0.03, before=0.3, seed=seed)]).n_rest[0] > 0 for seed in range(300)]
    assert np.mean(resting) > 0.98
    assert np.mean(moving) < 0.05


def test_a_few_rows_that_hum_are_no_rest():
    """What hums throughout is no louder before the blow than anywhere, but it is not white."""
    rows = np.arange(2000)[:, np.newaxis]
    moving = []
    for seed in range(50):
        rng = np.random.default_rng(seed)
        record = struck(16)
        hum = 0.05 * np.sin(0.9 * rows + rng.uniform(0.0, 2.0 * np.pi, 3))
        noise = 0.01 * rng.standard_normal((2000, 3))
        moving.append(with_rest([Record(record.inputs, record.outputs + hum + noise, record.dt)]).n_rest[0])
    assert np.mean(np.array(moving) > 0) < 0.1


@pytest.mark.parametrize("noise", [0.001, 0.01])
def test_motion_before_the_blow_is_no_rest(noise):
    moving, resting = struck(200, noise=noise, before=0.3), struck(200, noise=noise, seed=1)
    assert with_rest([moving]).n_rest == (0,)
    assert with_rest([moving]).choices[0].value == "not used"
    both = with_rest([moving, resting])
    assert both.n_rest[0] == 0 < both.n_rest[1]
    assert both.choices[0].value == "used in part"


def filtered_blow(*, noise, seed=0, size=1.0):
    """A blow of two samples behind a filter that rings on for a hundred, far above the noise of the force's sensor."""
    rng = np.random.default_rng(seed)
    fine = np.zeros(16 * 2000)
    fine[16 * 300 + 5 : 16 * 300 + 37] = size * np.sin(np.pi * (np.arange(32) + 0.5) / 32)
    force = sosfilt(cheby1(8, 0.1, 0.8 / 16, output="sos"), fine)[::16]
    ring = np.convolve(force, RING)[:2000]
    return Record(force + noise * rng.standard_normal(2000), ring + 0.01 * rng.standard_normal(2000), 0.01), force


@pytest.mark.parametrize("noise", [1e-4, 1e-3])
def test_what_a_filter_rings_on_above_the_noise_is_force(noise):
    """A hundredth of a blow is a hundred times its noise: set to zero, it left errors of nineteen deviations."""
    record, force = filtered_blow(noise=noise)
    found = with_rest([record])
    assert [choice.value for choice in found.choices if choice.what == "force window"] == ["used"]
    kept = found.records[0].inputs[found.n_rest[0] :, 0]
    assert (kept[np.abs(force) > 10 * noise] != 0.0).all()
    assert np.count_nonzero(kept) < 200


@pytest.mark.parametrize("n_points", [3, 12])
def test_each_record_of_a_roving_hammer_tells_the_noise_of_its_own_force(n_points):
    """Pooled with the zeros of records in which another point is struck, all of the noise became force."""
    records = []
    for point in range(n_points):
        one, _ = filtered_blow(noise=1e-3, seed=point)
        own = np.zeros((2000, n_points))
        own[:, [point]] = one.inputs
        records.append(replace(one, inputs=own, input_names=None, input_units=None))
    found = with_rest(records)
    assert [choice.value for choice in found.choices if choice.what == "force window"] == ["used"]
    assert max(int(record.inputs.any(axis=1).sum()) for record in found.records) < 100


def test_a_touch_long_before_a_blow_is_no_beginning_of_it():
    """Between it and the blow the structure moves: rest is asked of all rows before the blow."""
    rng = np.random.default_rng(7)
    moving = struck(300, noise=0.001, before=0.3)
    force = moving.inputs + 1e-3 * rng.standard_normal((2000, 1))
    force[5] += 0.008
    assert with_rest([replace(moving, inputs=force)]).n_rest == (0,)


def test_a_filter_without_noise_leaves_nothing_to_take():
    record, force = filtered_blow(noise=0.0)
    found = with_rest([record])
    kept = found.records[0].inputs[found.n_rest[0] :, 0]
    np.testing.assert_allclose(kept[np.abs(force) > 1e-9], force[np.abs(force) > 1e-9], atol=1e-9)


def test_a_loud_sensor_of_one_record_is_no_ringing_before_the_blow():
    """Records are compared with their own noise; 158 values of which one record makes most are not as many."""
    records = [filtered_blow(noise=noise, seed=seed)[0] for seed, noise in enumerate([3e-2, 1e-4, 1e-4, 1e-4, 1e-4])]
    for shift in (40, 90, 140, 190):
        moved = [one.samples(shift) for one in records[:1]] + records[1:]
        assert "ring before" not in str(with_rest(moved).choices)


def test_motion_that_begins_with_the_blow_is_no_motion_before_it():
    """A blow stands above 1 % of its peak a row or two after it has begun to act."""
    heavy = struck(300)
    force = heavy.inputs - 4.0
    slow = np.convolve(force[:, 0], [0.008, 0.05, 0.3, 1.0, 0.3])[:2000]
    made = Record(
        slow, 60.0 * np.convolve(slow, RING)[:2000] + 0.2 * np.random.default_rng(2).standard_normal(2000), 0.01
    )
    assert with_rest([made]).n_rest[0] > 0


def test_a_release_for_each_of_the_strongest():
    rng = np.random.default_rng(0)
    sizes = [1.0, 0.1, 3.0, 2.0, 5.0]
    made = released([Record([], size * RING + 7.0, 0.01, name=str(i)) for i, size in enumerate(sizes)])
    assert made[0].input_names == tuple(f"release of record {i}" for i in (1, 3, 4, 5))
    assert [record.n_samples for record in made] == [2001, 2000, 2001, 2001, 2001]
    np.testing.assert_array_equal([record.inputs.sum() for record in made], [1, 0, 1, 1, 1])
    np.testing.assert_allclose(made[4].outputs[:2].ravel(), [7.0, 12.0], atol=1e-3)
    gap = np.where(rng.random(2000) < 0.1, np.nan, RING)
    assert np.isfinite(released([Record([], gap, 0.01)])[0].outputs[0]).all()


def test_a_gap_hides_no_rest():
    """The quietest part is looked for where there are samples, without a word about those where there are none."""
    rng = np.random.default_rng(5)
    force = np.zeros(2000)
    force[150:154] = 1.0
    outputs = np.convolve(force, np.exp(-0.02 * np.arange(400)) * np.sin(0.4 * np.arange(400)))[:2000]
    outputs += 1e-3 * rng.standard_normal(2000)
    outputs[900:1300] = np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert with_rest([Record(force, outputs, 0.01)]).choices[0].value == "used"


@pytest.mark.parametrize("at", [0, 700])
def test_what_the_sensor_shows_between_blows_is_no_force(at):
    rng = np.random.default_rng(2)
    record = struck(at, noise=0.001)
    record = replace(record, inputs=record.inputs + 0.01 * rng.standard_normal((2000, 1)))
    found = with_rest([record])
    force = found.records[0].inputs[found.n_rest[0] :, 0]
    assert [choice.value for choice in found.choices] == ["used", "used"]
    np.testing.assert_allclose(force[at : at + 3], [0.5, 1.0, 0.5], atol=0.05)
    assert not force[at + 10 :].any()


def test_a_force_between_the_blows_that_explains_more_is_kept():
    """A shaker holds the structure between its bursts: what little it pushes is real."""
    rng = np.random.default_rng(3)
    force = struck(700).inputs[:, 0] - 4.0 + 0.002 * rng.standard_normal(2000)
    outputs = np.convolve(force, RING)[:2000] + 1e-4 * rng.standard_normal(2000)
    found = with_rest([Record(force, outputs, 0.01)])
    assert found.choices[1].value == "not used"
    np.testing.assert_allclose(found.records[0].inputs[found.n_rest[0] :, 0], force, atol=1e-3)


@pytest.mark.filterwarnings("error")
def test_a_sensor_that_is_moved_after_the_blow_hides_no_rest():
    """Of what nothing was measured before the blow the mean was taken, with a warning of numpy."""
    record = struck(400, level=0.0, noise=1e-3)
    later = np.where(np.arange(record.n_samples) < 900, np.nan, record.outputs[:, 0])
    both = Record(record.inputs, np.column_stack([record.outputs[:, 0], later]), record.dt)
    assert with_rest([both]).n_rest[0] > 100


@pytest.mark.parametrize(("how", "white"), [({}, True), ({"decimation": 2}, False), ({"drift": 1}, False)])
def test_noise_of_a_force_is_white_within_its_window_but_behind_a_filter_or_less_a_drift(how, white):
    record, _ = filtered_blow(noise=1e-3)
    prepared = prepare([record], kind="transient", **{"decimation": 1, **how})
    assert prepared.at_rest.all()
    assert bool(prepared.white_at_rest.any()) is white
