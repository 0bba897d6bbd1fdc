from dataclasses import replace

import numpy as np
import pytest
from containers import realisation_of
from signals import random_inputs, with_noise
from systems import markov, modal_system, random_chain, simulate

import era
import modal.preparation.delay
from era.realisation import Realisation
from modal.modes.extraction import extract_modes
from modal.modes.mode import ModalModel, Mode
from modal.preparation.delay import (
    choose_input_delay,
    delay_between,
    delay_of_phases,
    given_input_delay,
    late_inputs,
    with_input_delay,
)
from okid.errors import InsufficientDataError, InvalidDataError
from okid.record import Record


def two_modes(rng, n_inputs):
    return modal_system(rng, frequencies=[6.0, 21.0], damping_ratios=[0.02, 0.015], n_inputs=n_inputs, n_outputs=2)


def late(inputs, delays):
    result = np.zeros_like(inputs)
    for j, d in enumerate(delays):
        result[d:, j] = inputs[: len(inputs) - d, j]
    return result


def ahead(inputs, lead):
    return np.vstack([inputs[lead:], np.zeros((lead, inputs.shape[1]))])


def record_of(rng, system, delays, *, n_samples=3000, noise=0.03, kind="white"):
    inputs = random_inputs(rng, n_samples, system.n_inputs, kind=kind)
    outputs = with_noise(rng, simulate(system, late(inputs, delays)), noise)
    return Record(inputs, outputs, system.dt).detrended()


@pytest.mark.parametrize("delays", [(3,), (20,), (80,), (200,), (5, 40), (0, 25), (0, 0)])
def test_delays_are_found_each_by_itself(delays):
    rng = np.random.default_rng(sum(delays) + 40)
    assert choose_input_delay([record_of(rng, two_modes(rng, len(delays)), delays)]).samples == delays


@pytest.mark.parametrize("seed", range(6))
def test_a_structure_that_acts_at_once_has_none(seed):
    """Displacements rise slowly from nothing: that is no delay, however noisy."""
    rng = np.random.default_rng(seed)
    system = random_chain(rng, sensor_kinds="displacement", highest_share=rng.uniform(0.1, 0.3), n_inputs=1)
    record = record_of(rng, system, (0,), noise=[0.01, 0.3][seed % 2], kind=["white", "coloured", "steps"][seed % 3])
    assert choose_input_delay([record]).samples == (0,)


def test_an_input_that_drives_nothing_has_none():
    rng = np.random.default_rng(3)
    record = record_of(rng, two_modes(rng, 1), (7,))
    idle = Record(np.column_stack([record.inputs, rng.standard_normal(3000)]), record.outputs, record.dt)
    assert choose_input_delay([idle]).samples == (7, 0)


def test_several_records_are_one():
    rng = np.random.default_rng(4)
    system = two_modes(rng, 1)
    found = choose_input_delay([record_of(rng, system, (9,), n_samples=n) for n in (900, 700)])
    assert found.samples == (9,)
    assert found.choice.value == "input_0: 9 samples (0.09 s)"
    assert "pulse response of a long observer is empty" in found.choice.reason


def test_late_inputs_keep_rows_together():
    rng = np.random.default_rng(5)
    inputs, outputs = rng.standard_normal((60, 2)), rng.standard_normal((60, 1))
    (shifted,) = late_inputs([Record(inputs, outputs, 0.1)], [4, 1])
    np.testing.assert_array_equal(shifted.outputs, outputs[4:])
    np.testing.assert_array_equal(shifted.inputs, late(inputs, [4, 1])[4:])
    assert shifted.start_time == pytest.approx(0.4)
    (shifted,) = late_inputs([Record(inputs, outputs, 0.1)], [-3, 2])
    np.testing.assert_array_equal(shifted.outputs, outputs[2:57])
    np.testing.assert_array_equal(shifted.inputs, np.column_stack([inputs[5:, 0], inputs[:55, 1]]))


def test_a_record_shorter_than_the_delay_is_refused():
    record = Record(np.arange(20.0), np.arange(20.0), 0.1)
    with pytest.raises(InsufficientDataError, match="delay of 20 samples leaves nothing of a record of 20"):
        late_inputs([record], [20])


@pytest.mark.parametrize("delays", [(0, 0), (1, 0), (3, 7), (-2, -2), (-3, 1)])
def test_the_model_with_delays_is_the_late_system(delays):
    rng = np.random.default_rng(6)
    system = two_modes(rng, 2)
    gain = 1e-3 * rng.standard_normal((system.order, 2))
    model = with_input_delay(realisation_of(system, gain), delays)
    inputs = random_inputs(rng, 200, 2)
    lead = max(0, -min(delays))
    truth = simulate(system, ahead(late(inputs, [d + lead for d in delays]), lead))
    record = Record(inputs, truth, system.dt)
    known = len(truth) - lead
    ringing = era.estimate_initial_state(model, record)  # what acted before the record rings on
    for run in (era.simulate, era.predict):
        found = run(model, record, initial_state=ringing).outputs
        np.testing.assert_allclose(found[:known], truth[:known], atol=1e-10)
        assert np.isnan(found[known:]).all()
    ahead_of = era.forecast(model, record, innovation_covariance=np.eye(2), initial_state=ringing)
    np.testing.assert_allclose(ahead_of.means[:known], truth[:known], atol=1e-10)
    assert (model.order, model.lead) == (system.order + sum(d + lead for d in delays), lead)
    found = extract_modes(model)
    np.testing.assert_allclose([mode.frequency for mode in found.modes], system.frequencies, rtol=1e-10)
    np.testing.assert_allclose([mode.damping_ratio for mode in found.modes], system.damping_ratios, rtol=1e-8)


def test_markov_parameters_of_the_late_model_start_later():
    rng = np.random.default_rng(7)
    system = two_modes(rng, 1)
    model = with_input_delay(realisation_of(system), [5])
    pulse = [model.D] + [model.C @ np.linalg.matrix_power(model.A, k) @ model.B for k in range(20)]
    np.testing.assert_allclose(pulse[:5], 0.0, atol=0.0)
    np.testing.assert_allclose(pulse[5:], markov(system, 15), atol=1e-12)


def test_a_given_delay_is_checked_and_decimated():
    record = Record(np.zeros((5, 2)), np.zeros((5, 1)), 0.1)
    assert given_input_delay([6, 9], record, decimation=3).samples == (2, 3)
    for four in (4, 4.0, np.int64(4), np.array([4, 4])):
        assert given_input_delay(four, record).samples == (4, 4)
    with pytest.raises(InvalidDataError, match="each of the 2 inputs, but has 1"):
        given_input_delay([3], record)
    assert given_input_delay([-1, -80], record, decimation=2).samples == (-1, -40)
    assert given_input_delay([-3, 0], record).choice.value == "input_0: 3 samples early (0.3 s)"
    with pytest.raises(InvalidDataError, match="at least -80, but is -81"):
        given_input_delay(-81, record, decimation=2)
    with pytest.raises(InvalidDataError, match="one delay for each of 0 inputs"):
        with_input_delay(Realisation([[0.5]], np.empty((1, 0)), [[1.0]], np.empty((1, 0)), 0.1), [1])


def test_a_fit_that_leaves_less_than_nothing_by_rounding_has_the_same_delay(monkeypatch):
    honest = modal.preparation.delay.solve

    def exact(gram, ridge):
        return replace(honest(gram, ridge), residual_covariance=-1e-20 * np.eye(2))

    monkeypatch.setattr(modal.preparation.delay, "solve", exact)
    rng = np.random.default_rng(0)
    assert choose_input_delay([record_of(rng, two_modes(rng, 1), (3,), noise=0.0)]).samples == (3,)


def _turned(delays, taken, *, seed=None):
    """Modes of unit mass whose residues are turned by what is left of the delays; noise where a seed is given."""
    dt, angular = 0.01, 2 * np.pi * np.array([2.0, 5.5, 8.5, 10.2])
    rng = np.random.default_rng(0)
    modes = []
    for size in angular:
        pole = size * complex(-0.01, 0.99995)
        left = np.exp(-pole * dt * (np.array(delays) - np.array(taken)))
        if seed is not None:
            left = np.exp(2j * np.pi * np.random.default_rng([seed, int(size)]).random(len(delays)))
        drive = rng.standard_normal(len(delays)) * left / (2j * pole.imag) * np.expm1(pole * dt) / pole
        modes.append(
            Mode(
                pole=pole,
                kind="oscillatory",
                frequency=abs(pole) / (2 * np.pi),
                damping_ratio=0.01,
                shape=np.array([1.0, -0.4]),
                participation=drive,
                verdict="system",
            )
        )
    return ModalModel(modes=tuple(modes), dt=dt, indicator_caution=0.1, output_units=("m", "m"))


@pytest.mark.parametrize("taken", [(0, 0, 0), (0, 3, 7), (2, 4, 6), (1, 3, 9)])
def test_the_phases_of_the_modes_tell_the_delays(taken):
    assert delay_of_phases(_turned((0, 3, 6), taken), taken, longest=60) == (0, 3, 6)


def test_phases_at_random_seldom_change_a_delay():
    """Of 600 inputs without a delay; where a delay was seen, 5 % may take it back."""
    found = [delay_of_phases(_turned((0, 3, 6), (0, 3, 0), seed=seed), (0, 3, 0), longest=60) for seed in range(300)]
    assert sum(delay != 0 for one in found for delay in one[::2]) <= 6
    assert sum(one[1] != 3 for one in found) <= 0.05 * 300 + 3 * (0.05 * 300) ** 0.5


def test_a_delay_and_a_gain_between_set_ups_are_told_by_the_same_modes():
    rng = np.random.default_rng(1)
    angular = np.array([0.13, 0.34, 0.53])
    for delay, gain in ((4, 2.0), (-3, -0.5), (0, 1.0)):
        noise = 0.01 * (rng.standard_normal((3, 2)) + 1j * rng.standard_normal((3, 2)))
        quotient = gain * np.exp(-1j * angular * delay)[:, np.newaxis] * (1.0 + noise)
        found, sign, level, spread = delay_between(quotient, np.full((3, 2), 1e-4), angular, longest=40)
        assert (found, sign) == (delay, np.sign(gain))
        assert (np.abs(level - np.log(abs(gain))) < 4 * spread).all()
        assert (spread < 0.02).all()
