import numpy as np
import pytest
from containers import realisation_of
from signals import random_inputs, with_noise
from systems import initial_state, modal_system, random_chain, simulate

import era
from era.simulation import estimate_initial_state
from modal.estimation.free_run import free_runs
from modal.preparation.quick_model import quick_model
from modal.preparation.steps import SHORTEST, prepare, split_at_input_gaps
from okid.errors import InsufficientDataError, InvalidDataError
from okid.record import Record, filter_half_length


def a_record(n_samples=900, *, name="", seed=0):
    rng = np.random.default_rng(seed)
    inputs, outputs = rng.standard_normal((n_samples, 2)) + 5.0, rng.standard_normal((n_samples, 3)) - 300.0
    return Record(inputs, outputs, 0.01, input_names=["shaker", "wind"], output_names=["a", "b", "c"], name=name)


def changed(record, *, inputs=(), outputs=()):
    """The record with some values set, each as (rows, channel, value)."""
    into, out = record.inputs.copy(), record.outputs.copy()
    for array, changes in ((into, inputs), (out, outputs)):
        for rows, channel, value in changes:
            array[rows, channel] = value
    return Record(
        into, out, record.dt, input_names=record.input_names, output_names=record.output_names, name=record.name
    )


ALL = slice(None)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"outputs": [(ALL, ALL, 0.25)]}, "output 'a' of record 'run 7' is 0.25 in all 900 samples"),
        ({"inputs": [(ALL, 1, 3.0)]}, "input 'wind' of record 'run 7' is 3 in all 900 samples"),
    ],
)
def test_a_channel_that_never_moves_is_named(changes, words):
    with pytest.raises(InsufficientDataError, match=words) as error:
        prepare([changed(a_record(name="run 7"), **changes)])
    assert "leave it out" in str(error.value)


def test_an_input_may_rest_in_one_record_but_an_output_may_not():
    """Two tests with one shaker each: the other is at rest."""
    first = changed(a_record(), inputs=[(ALL, 0, 0.0)])
    second = changed(a_record(seed=1), inputs=[(ALL, 1, 0.0)])
    prepared = prepare([first, second]).records
    assert len(prepared) == 2
    with pytest.raises(InsufficientDataError, match="input 'shaker'"):
        prepare([first, first])
    with pytest.raises(InsufficientDataError, match="output 'b'"):
        prepare([a_record(), changed(a_record(seed=1), outputs=[(ALL, 1, 0.0)])])


def test_means_go_and_nothing_else():
    record = a_record()
    found = prepare([record])
    (prepared,), choices = found.records, found.choices
    np.testing.assert_allclose(prepared.inputs, record.inputs - record.inputs.mean(axis=0), atol=1e-10)
    np.testing.assert_allclose(prepared.outputs, record.outputs - record.outputs.mean(axis=0), atol=1e-9)
    assert [choice.what for choice in choices] == ["mean", "frequency band", "integrators", "input delay", "drift"]
    assert choices[1].value == "0 to 50 Hz"


def test_missing_outputs_stay_missing_and_do_not_move_the_mean():
    gaps = changed(a_record(), outputs=[(slice(100, 130), 0, np.nan)])
    (prepared,) = prepare([gaps]).records
    np.testing.assert_array_equal(np.isnan(prepared.outputs), np.isnan(gaps.outputs))
    assert np.nanmean(prepared.outputs[:, 0]) == pytest.approx(0.0, abs=1e-12)


def test_an_input_gap_makes_two_records():
    record = a_record(name="run 7")
    found = prepare([changed(record, inputs=[(slice(400, 410), 1, np.nan)]), a_record(seed=1)])
    prepared, choices = found.records, found.choices
    assert [part.n_samples for part in prepared] == [400, 490, 900]
    assert prepared[1].name == "run 7, part 2"
    assert prepared[1].start_time == pytest.approx(4.1)
    stretch = record.outputs[410:]
    np.testing.assert_allclose(prepared[1].outputs, stretch - stretch.mean(axis=0), atol=1e-9)
    assert [choice.what for choice in choices] == [
        *("input gaps", "mean", "frequency band", "integrators", "input delay", "drift")
    ]
    assert choices[0].value == "3 records from 2"


def test_stretches_too_short_for_a_state_of_their_own_are_dropped():
    gaps = changed(
        a_record(),
        inputs=[(300, 0, np.nan), (300 + SHORTEST, 1, np.nan), (360, 0, np.nan), (360 + SHORTEST + 1, 0, np.nan)],
    )
    lengths = [part.n_samples for part in split_at_input_gaps(gaps)]
    assert lengths == [300, SHORTEST, 900 - 360 - SHORTEST - 2]  # the stretch of 9 samples is gone


def test_a_stretch_that_is_nothing_beside_the_longest_is_dropped():
    gaps = changed(a_record(8000), inputs=[(6000, 0, np.nan), (6100, 0, np.nan)])
    assert [part.n_samples for part in split_at_input_gaps(gaps)] == [6000, 1899]


def test_a_stretch_without_one_of_the_outputs_is_dropped():
    gaps = changed(a_record(), inputs=[(400, 1, np.nan)], outputs=[(slice(0, 400), 2, np.nan)])
    assert [part.n_samples for part in split_at_input_gaps(gaps)] == [499]


def test_nothing_left_between_gaps_is_an_error():
    gaps = changed(a_record(), inputs=[(slice(None, None, 30), 0, np.nan)])
    with pytest.raises(InsufficientDataError, match=r"missing in 30 of 900 samples.*stretch of 50 samples"):
        split_at_input_gaps(gaps)


def test_a_record_without_gaps_is_passed_on():
    record = a_record()
    assert split_at_input_gaps(record) == (record,)


@pytest.mark.parametrize("factor", [1, 3])
def test_a_given_decimation_is_kept(factor):
    record = a_record()
    found = prepare([record], decimation=factor)
    (prepared,), choices = found.records, found.choices
    expected = record.detrended().decimated(factor).detrended()
    np.testing.assert_allclose(prepared.outputs, expected.outputs, atol=1e-12)
    assert prepared.dt == pytest.approx(0.01 * factor)
    assert choices[1].reason == "given as an argument"
    assert choices[1].value == f"0 to {50 / factor:.4g} Hz"


def test_an_oversampled_record_is_decimated_with_its_reason():
    rng = np.random.default_rng(1)
    system = random_chain(rng, sensor_kinds="displacement", highest_share=0.04, damping_ratio=0.03)
    inputs = rng.standard_normal((4000, 2))
    outputs = simulate(system, inputs)
    noisy = outputs + 0.02 * outputs.std(axis=0) * rng.standard_normal(outputs.shape)
    found = prepare([Record(inputs, noisy, system.dt)])
    (prepared,), choices = found.records, found.choices
    factor = round(prepared.dt / system.dt)
    assert factor > 1
    assert 0.5 / prepared.dt > 1.2 * system.frequencies.max()
    assert f"decimated by {factor}" in choices[1].reason
    np.testing.assert_allclose(prepared.outputs.mean(axis=0), 0.0, atol=1e-12)


@pytest.mark.parametrize("n_samples", [39, 40])
def test_too_short_a_record_is_refused_with_the_number_it_needs(n_samples):
    values = np.random.default_rng(0).standard_normal((n_samples, 2))
    record = Record(values[:, 0], values[:, 1], 0.01)
    if n_samples == 40:
        prepare([record])
        return
    with pytest.raises(InsufficientDataError, match=r"at least 40 samples in one record .* the longest has 39"):
        prepare([record])


def a_system(rng, n_samples=3000, *, delays=(0, 0), noise=0.03):
    """A record of two modes whose inputs act late, and the system."""
    system = modal_system(rng, frequencies=[6.0, 21.0], damping_ratios=[0.02, 0.015], n_outputs=2)
    inputs = random_inputs(rng, n_samples, 2)
    acting = np.zeros_like(inputs)
    for j, d in enumerate(delays):
        acting[d:, j] = inputs[: n_samples - d, j]
    return system, Record(inputs, with_noise(rng, simulate(system, acting), noise), system.dt)


def completed(system, prepared):
    return prepared.complete(realisation_of(system))


def fit_of_true_model(system, prepared):
    """Fit of the true model, made complete, to what it is said to be driven by."""
    model = completed(system, prepared)
    (record,) = prepared.as_measured
    run = era.simulate(model, record, initial_state=estimate_initial_state(model, record)).outputs
    return 1.0 - np.linalg.norm(run - record.outputs, axis=0) / np.linalg.norm(record.outputs, axis=0)


def test_nothing_to_do_is_said_and_leaves_the_records_alone():
    _, record = a_system(np.random.default_rng(1))
    prepared = prepare([record])
    assert (prepared.input_delay, prepared.n_integrators, prepared.n_slow_functions) == ((0, 0), 0, 0)
    np.testing.assert_allclose(prepared.records[0].outputs, record.detrended().outputs, atol=1e-10)
    np.testing.assert_allclose(prepared.as_measured[0].inputs, prepared.records[0].inputs, atol=1e-10)
    assert [c.what for c in prepared.choices] == ["mean", "frequency band", "integrators", "input delay", "drift"]
    assert prepared.warnings == ()


def test_delay_and_drift_together():
    system, record = a_system(np.random.default_rng(2), delays=(5, 20))
    line = np.linspace(-1.0, 1.0, 3000)[:, np.newaxis] * record.outputs.std(axis=0)
    prepared = prepare([Record(record.inputs, record.outputs + line, record.dt)])
    assert prepared.input_delay == (5, 20)
    assert prepared.n_slow_functions == 1
    assert prepared.records[0].n_samples == prepared.as_measured[0].n_samples == 2980
    assert (fit_of_true_model(system, prepared) > 0.965).all()  # 3 % noise


def test_integrators_come_back():
    rng = np.random.default_rng(3)
    system = modal_system(rng, frequencies=[6.0], damping_ratios=[0.02], n_outputs=2)
    inputs = random_inputs(rng, 3000, 2)
    outputs = with_noise(rng, simulate(system, np.cumsum(inputs, axis=0)), 0.01)
    prepared = prepare([Record(inputs, outputs, system.dt)])
    assert prepared.n_integrators == 1
    assert (fit_of_true_model(system, prepared) > 0.985).all()


def test_outputs_at_half_the_rate_are_filled_and_said():
    _, record = a_system(np.random.default_rng(4))
    outputs = record.outputs.copy()
    outputs[1::2] = np.nan
    prepared = prepare([Record(record.inputs, outputs, record.dt)])
    assert np.isfinite(prepared.records[0].outputs).all()
    assert prepared.choices[0].what == "missing outputs"
    assert prepared.measured_share == pytest.approx(0.5, abs=0.01)
    left = prepare([Record(record.inputs, outputs, record.dt)], missing="leave", drift="none")
    assert np.isnan(left.records[0].outputs).sum() == 3000


@pytest.mark.parametrize(("decimation", "first"), [(1, 0), (2, filter_half_length(2))])
def test_which_samples_were_filled_is_kept_through_decimation_and_delay(decimation, first):
    _, record = a_system(np.random.default_rng(4))
    outputs = record.outputs.copy()
    outputs[np.arange(len(outputs)) % 40 < 4] = np.nan
    given = {"decimation": decimation, "input_delay": 3, "drift": "none", "integrators": 0}
    prepared = prepare([Record(record.inputs, outputs, record.dt)], **given)
    (there,), (ready,) = prepared.measured, prepared.records
    assert there.shape == ready.outputs.shape
    at = first + decimation * (np.arange(len(there)) + prepared.input_delay[0])
    around = at[:, np.newaxis] + np.arange(1 - decimation, decimation + (decimation > 1))  # the filter's main lobe
    np.testing.assert_array_equal(there, ~np.isnan(outputs[around]).any(axis=1))


def test_arguments_are_kept():
    _, record = a_system(np.random.default_rng(5))
    prepared = prepare([record], integrators=1, input_delay=[4, 0], drift="linear", decimation=1)
    assert (prepared.input_delay, prepared.n_integrators, prepared.n_slow_functions) == ((4, 0), 1, 1)
    assert [choice.reason for choice in prepared.choices[1:]] == ["given as an argument"] * 4
    sums = np.diff(prepared.records[0].inputs, axis=0)[10:, 1] - prepared.as_measured[0].inputs[11:, 1]
    np.testing.assert_allclose(sums, 0.0, atol=1e-9)
    with pytest.raises(InvalidDataError, match="drift must be"):
        prepare([record], drift="quadratic")


@pytest.mark.parametrize(
    ("argument", "words"),
    [
        ({"missing": "interpolate"}, 'missing must be "fill" or "leave", but is \'interpolate\''),
        ({"input_delay": "none"}, "input_delay must be \"auto\" or .* but is 'none'"),
        ({"input_delay": None}, "an input delay must be a whole number of at least -40, but is None"),
        ({"input_delay": 2.5}, "an input delay must be a whole number of at least -40, but is 2.5"),
    ],
)
def test_a_word_or_a_number_that_means_nothing_is_refused(argument, words):
    _, record = a_system(np.random.default_rng(7), 100)
    with pytest.raises(InvalidDataError, match=words):
        prepare([record], decimation=1, integrators=0, drift="none", **argument)


def test_a_jump_is_said():
    _, record = a_system(np.random.default_rng(6))
    jump = np.where(np.arange(3000) > 1700, 2.0, -2.0)[:, np.newaxis] * record.outputs.std(axis=0)
    prepared = prepare([Record(record.inputs, record.outputs + jump, record.dt)])
    assert "cut the record there" in prepared.warnings[-1]


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_it_finds_the_modes_and_leaves_the_noise(noise):
    rng = np.random.default_rng(1)
    system = modal_system(rng, frequencies=[6.0, 21.0], damping_ratios=[0.02, 0.015])
    inputs = random_inputs(rng, 2500, 2)
    clean = simulate(system, inputs, initial_state=initial_state(rng, system, inputs))
    record = Record(inputs, with_noise(rng, clean, noise) / clean.std(axis=0) + 3.0, system.dt)
    quick = quick_model([record])
    assert quick.error == pytest.approx(noise, rel=0.1, abs=2e-2)
    found = np.abs(np.log(quick.form.poles)) / (2 * np.pi * system.dt)
    for frequency in system.frequencies:
        assert np.abs(found - frequency).min() < 0.005 * frequency
    (run,) = free_runs(quick.form, [record])
    assert np.sqrt(np.mean(np.square(run - record.outputs))) == pytest.approx(quick.error)


def test_data_that_no_model_can_be_made_of_give_none():
    record = Record(np.zeros(100) + np.arange(100.0) % 2, np.where(np.arange(100) % 2, np.nan, 1.0), 0.1)
    assert quick_model([record]) is None
