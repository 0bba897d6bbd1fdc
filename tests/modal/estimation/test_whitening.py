"""Noise as an autoregression, on noise and systems made here and in tests/reference."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import scipy.signal
from noise_families import noise_record
from nonlinear_chain import run_chain
from systems import modal_system, simulate

from modal.estimation.whitening import all_filtered, common_filter, filtered, output_filters, stretches
from modal.identification import pipeline
from okid.errors import InvalidDataError
from okid.record import Record

RED = np.array([1.0, -0.95])
GIVEN = {"observer_order": 20, "ridge": 0.0, "input_delay": 0}
"""What a search would take about the same; modes may be added where the order of the model is left open."""


def red_noise(rng, shape):
    return scipy.signal.lfilter([1.0], RED, rng.standard_normal(shape), axis=0)


def test_the_filter_of_an_autoregression_is_found_and_leaves_its_innovations():
    rng = np.random.default_rng(1)
    a = np.array([1.0, -1.2, 0.8])
    white = rng.standard_normal((20000, 2)) * [1.0, 30.0]
    noise = scipy.signal.lfilter([1.0], a, white, axis=0)
    found, share = common_filter([noise[:9000], noise[9000:]])
    np.testing.assert_allclose(found, a, atol=0.03)
    assert share == pytest.approx((white.var(axis=0) / noise.var(axis=0)).mean(), rel=0.05)
    for one, filter_ in enumerate(output_filters([noise])):
        assert np.convolve(noise[:, one], filter_, "valid").var() == pytest.approx(1.0, rel=0.02)


def test_white_noise_needs_no_filter():
    found, share = common_filter([np.random.default_rng(2).standard_normal((3000, 3))])
    assert found.tolist() == [1.0]
    assert share == 1.0


def test_a_filtered_record_is_of_the_same_system():
    rng = np.random.default_rng(3)
    system = modal_system(rng, frequencies=(4.0, 11.0), damping_ratios=(0.01, 0.02), n_inputs=2, n_outputs=3)
    inputs = rng.standard_normal((600, 2))
    inputs[:10] = 0.0  # the filter forgets rest
    record = Record(inputs, simulate(system, inputs), system.dt)
    other = filtered(record, RED)
    assert other.n_samples == 599
    np.testing.assert_allclose(other.outputs, simulate(system, other.inputs), atol=1e-12)


def test_gaps_grow_by_the_memory_of_the_filter():
    outputs = np.ones((50, 1))
    outputs[20:23] = np.nan
    record = filtered(Record(np.ones((50, 1)), outputs, 0.01), RED)
    assert np.flatnonzero(~record.complete_rows()).tolist() == [19, 20, 21, 22]
    assert [len(one) for one in stretches([record.outputs], [record.complete_rows()])] == [19, 26]


def test_a_record_shorter_than_the_filter_has_no_row_behind_it():
    a = np.array([1.0, -0.5, 0.2, 0.1])
    for n in (1, 2, 3):
        with pytest.raises(InvalidDataError):
            filtered(Record(np.ones((n, 1)), np.ones((n, 1)), 0.01), a)


def test_between_gaps_the_filter_remembers_what_half_of_the_rows_have_before_them():
    noise = red_noise(np.random.default_rng(4), (900, 1))
    for length, longest in ((1, 0), (2, 1), (3, 1), (4, 2), (6, 3)):
        runs = [noise[k : k + length] for k in range(0, 900 - length, length + 1)]
        assert output_filters(runs)[0].size <= longest + 1
        assert common_filter(runs)[0].size <= longest + 1


@pytest.fixture(scope="module")
def drowned():
    """Three modes, of which two are weak, in red noise of a fifth of the outputs."""
    rng = np.random.default_rng(41)
    frequencies, ratios = (6.0, 24.0, 38.0), (0.01, 0.006, 0.005)
    system = modal_system(
        rng, frequencies=frequencies, damping_ratios=ratios, n_inputs=1, n_outputs=2, mode_sizes=(1.0, 0.03, 0.03)
    )
    inputs = rng.standard_normal((3000, 1))
    outputs = simulate(system, inputs)
    noise = red_noise(rng, outputs.shape)
    outputs += 0.2 * outputs.std(axis=0) * noise / noise.std(axis=0)
    return frequencies, Record(inputs, outputs, system.dt)


def found_of(result, frequencies):
    certain = np.array([mode.frequency for mode in result.modes.system])
    return [one for one in frequencies if certain.size and abs(certain - one).min() < 0.005 * one]


def test_weak_modes_far_above_the_noise_beside_them_are_found(drowned):
    frequencies, record = drowned
    result = pipeline.identify(record, **GIVEN)
    assert found_of(result, frequencies) == list(frequencies)
    assert len(result.modes.system) == 3
    assert result.fitted_model.order <= 12  # six of the modes, as many again of the noise at most
    assert [choice.what for choice in result.choices].count("noise filter") == 1
    assert result.records[0].n_samples == record.n_samples
    for mode in result.modes.system:
        true = min(frequencies, key=lambda one: abs(one - mode.frequency))
        assert abs(mode.frequency - true) < 4 * mode.frequency_std


def test_a_stub_of_a_record_is_left_out_of_the_search(drowned):
    """Two rows hold fewer rows than a predictor has channels, inputs and the past of the outputs."""
    frequencies, record = drowned
    outputs = record.outputs[:90].copy()
    outputs[::2] = np.nan
    holed = Record(record.inputs[:90], outputs, record.dt)
    for length, expected in ((2, [2999]), (3, [2, 2999])):  # a row cannot hold two outputs
        stub = Record(record.inputs[:length], record.outputs[:length], record.dt)
        assert [one.n_samples for one in all_filtered([stub, record, holed], RED)] == expected
    result = pipeline.identify([record, replace(stub, inputs=stub.inputs[:2], outputs=stub.outputs[:2])], **GIVEN)
    assert found_of(result, frequencies) == list(frequencies)
    assert [one.n_samples for one in result.records] == [3000, 2]


def test_an_observer_order_that_is_given_is_kept_and_progress_rises(drowned):
    shares = []
    result = pipeline.identify(drowned[1], observer_order=30, progress=lambda _what, share: shares.append(share))
    assert shares == sorted(shares)
    assert result.observer.order == 30
    assert "noise filter" in [choice.what for choice in result.choices]


def test_missing_rows_make_no_false_mode(drowned):
    frequencies, record = drowned
    outputs = record.outputs.copy()
    outputs[1500:1520, 0] = np.nan
    result = pipeline.identify(replace(record, outputs=outputs), **GIVEN)
    assert 6.0 in found_of(result, frequencies)
    assert len(result.modes.system) == len(found_of(result, frequencies))


def test_modes_that_the_first_model_holds_are_judged_behind_the_filter():
    """One output: the model of system and noise holds all three modes, of which red noise hides two from its halves."""
    rng = np.random.default_rng(1)
    frequencies = (7.07, 27.5, 33.44)
    system = modal_system(
        rng,
        frequencies=frequencies,
        damping_ratios=(0.0116, 0.0065, 0.0074),
        n_inputs=1,
        n_outputs=1,
        mode_sizes=(1.0, 0.03, 0.03),
    )
    inputs = rng.standard_normal((3000, 1))
    outputs = simulate(system, inputs)
    noise = red_noise(rng, outputs.shape)
    record = Record(inputs, outputs + 0.2 * outputs.std(axis=0) * noise / noise.std(axis=0), system.dt)
    result = pipeline.identify(record, **GIVEN)
    assert found_of(result, frequencies) == list(frequencies)
    assert len(result.modes.system) == 3
    given = pipeline.identify(record, order=6, **GIVEN)
    assert given.fitted_model.order == 6
    assert "noise filter" in [choice.what for choice in given.choices]


def heated_bodies(rng):
    """Two bodies in line between a heater that is switched on and off and a room; their real poles [Hz] and the record.

    The sensors wander by 8 % of the motion.
    """
    exchange = np.array([[-0.095, 0.095], [0.018, -0.035]])
    step = scipy.linalg.expm(np.block([[exchange, np.array([[0.09], [0.0]])], [np.zeros((1, 3))]]))
    heat = np.repeat(rng.choice([0.0, 1.0], 334), 3)[:1000]
    states = np.zeros((1000, 2))
    for k in range(999):
        states[k + 1] = step[:2, :2] @ states[k] + step[:2, 2] * heat[k]
    wander = scipy.signal.lfilter([1.0], [1.0, -0.98], rng.standard_normal((1500, 2)), axis=0)[500:]
    wander *= 0.08 * states.std(axis=0) / wander.std(axis=0)
    white = 0.001 * states.std(axis=0) * rng.standard_normal(states.shape)
    return np.sort(-np.linalg.eigvals(exchange).real / (2 * np.pi)), Record(heat, states + wander + white, 1.0)


def test_slow_real_poles_of_a_model_with_its_noise_are_found_again_behind_the_filter():
    """The likeliest model came from no refinement, but what it is found again by behind the filter does."""
    poles, record = heated_bodies(np.random.default_rng(0))
    result = pipeline.identify(record)
    assert "noise filter" in [choice.what for choice in result.choices]
    assert [mode.kind for mode in result.modes.system] == ["real", "real"]
    for mode, true in zip(result.modes.system, poles, strict=True):
        assert abs(mode.frequency - true) < 3 * mode.frequency_std


def cubic_chain():
    """Two masses, the first on a spring that hardens, driven by a slow force; 1e-4 of sensor noise."""
    rng = np.random.default_rng(1)
    force = scipy.signal.lfilter([1.0], [1.0, -0.9], rng.standard_normal((1, 3000)), axis=1)
    force *= 3.0 / force.std()
    motion = run_chain([1.0, 1.0], [400.0, 900.0], [0.8, 0.8], force, 0.02, law=lambda d, _v, _t: 4e4 * d**3)[0, :, :1]
    return Record(force.T, motion + 1e-4 * motion.std() * rng.standard_normal(motion.shape), 0.02)


def wind_chain():
    case = noise_record("wind", system=51002, record=0)
    return Record(case.inputs, case.outputs, case.system.dt)


@pytest.mark.parametrize("make", [cubic_chain, wind_chain])
def test_what_is_no_noise_of_sensors_is_not_filtered(make):
    """What a spring that is not linear leaves, or hidden forces do, is coloured, and no short filter makes it white."""
    assert "noise filter" not in [choice.what for choice in pipeline.identify(make(), order=8, **GIVEN).choices]


def test_nothing_is_added_where_nothing_answers_any_more():
    rng = np.random.default_rng(42)
    system = modal_system(rng, frequencies=(6.0,), damping_ratios=(0.01,), n_inputs=1, n_outputs=2)
    inputs = rng.standard_normal((2000, 1))
    outputs = simulate(system, inputs)
    noise = red_noise(rng, outputs.shape)
    record = Record(inputs, outputs + 0.1 * outputs.std(axis=0) * noise / noise.std(axis=0), system.dt)
    result = pipeline.identify(record, observer_order=179, ridge=0.0)
    assert found_of(result, [6.0]) == [6.0]
    assert len(result.modes.system) == 1
    assert result.fitted_model.order == 2


@pytest.mark.parametrize("seed", [5, pytest.param(9, marks=pytest.mark.slow)])
def test_a_mode_that_spoilt_the_filter_is_found_behind_the_next_one(seed):
    """Its own motion is more than the innovations of the slow noise, and the first filter took it for noise."""
    rng = np.random.default_rng(seed)
    force, outputs = rng.standard_normal(4000), np.zeros((4000, 2))
    for frequency, shape in ((3.0, [1.0, 0.7]), (17.0, [0.05, -0.05])):
        pole = np.exp((-0.01 + 1j) * 2 * np.pi * frequency * 0.01)
        moved = scipy.signal.lfilter([0, 1], [1, -2 * pole.real, abs(pole) ** 2], force)
        outputs += np.outer(moved / moved.std(), shape)
    slow = scipy.signal.lfilter([1.0], [1.0, -0.99], rng.standard_normal((4000, 2)), axis=0)
    record = Record(force, outputs + 0.3 * slow / slow.std(axis=0), 0.01)
    found = pipeline.identify(record, observer_order=128, ridge=0.0).modes.system
    assert [round(mode.frequency, 1) for mode in found] == [3.0, 17.0]
    for mode, frequency in zip(found, (3.0, 17.0), strict=True):
        assert abs(mode.frequency - frequency) < 4 * mode.frequency_std
