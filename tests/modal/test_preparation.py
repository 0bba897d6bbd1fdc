import numpy as np
import pytest
from systems import random_chain, simulate

from modal.preparation import SHORTEST, prepare, split_at_input_gaps
from okid.errors import InsufficientDataError
from okid.record import Record


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
        ({"outputs": [(ALL, 1, 0.25)]}, "output 'b' of record 'run 7' is 0.25 in all 900 samples"),
        ({"inputs": [(ALL, 1, 3.0)]}, "input 'wind' of record 'run 7' is 3 in all 900 samples"),
        ({"outputs": [(slice(0, 899), 2, np.nan)]}, "output 'c' of record 'run 7'"),  # a single sample is left
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
    prepared, _ = prepare([first, second])
    assert len(prepared) == 2
    with pytest.raises(InsufficientDataError, match="input 'shaker'"):
        prepare([first, first])
    with pytest.raises(InsufficientDataError, match="output 'b'"):
        prepare([a_record(), changed(a_record(seed=1), outputs=[(ALL, 1, 0.0)])])


def test_means_go_and_nothing_else():
    record = a_record()
    (prepared,), choices = prepare([record])
    np.testing.assert_allclose(prepared.inputs, record.inputs - record.inputs.mean(axis=0), atol=1e-10)
    np.testing.assert_allclose(prepared.outputs, record.outputs - record.outputs.mean(axis=0), atol=1e-9)
    assert [choice.what for choice in choices] == ["mean", "frequency band"]
    assert choices[1].value == "0 to 50 Hz"


def test_missing_outputs_stay_missing_and_do_not_move_the_mean():
    gaps = changed(a_record(), outputs=[(slice(100, 130), 0, np.nan)])
    (prepared,), _ = prepare([gaps])
    np.testing.assert_array_equal(np.isnan(prepared.outputs), np.isnan(gaps.outputs))
    assert np.nanmean(prepared.outputs[:, 0]) == pytest.approx(0.0, abs=1e-12)


def test_an_input_gap_makes_two_records():
    record = a_record(name="run 7")
    prepared, choices = prepare([changed(record, inputs=[(slice(400, 410), 1, np.nan)]), a_record(seed=1)])
    assert [part.n_samples for part in prepared] == [400, 490, 900]
    assert prepared[1].name == "run 7, part 2"
    assert prepared[1].start_time == pytest.approx(4.1)
    stretch = record.outputs[410:]
    np.testing.assert_allclose(prepared[1].outputs, stretch - stretch.mean(axis=0), atol=1e-9)
    assert [choice.what for choice in choices] == ["input gaps", "mean", "frequency band"]
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
    (prepared,), choices = prepare([record], decimation=factor)
    expected = record.detrended().decimated(factor).detrended()
    np.testing.assert_allclose(prepared.outputs, expected.outputs, atol=1e-12)
    assert prepared.dt == pytest.approx(0.01 * factor)
    assert choices[-1].reason == "given as an argument"
    assert choices[-1].value == f"0 to {50 / factor:.4g} Hz"


def test_an_oversampled_record_is_decimated_with_its_reason():
    rng = np.random.default_rng(1)
    system = random_chain(rng, sensor_kinds="displacement", highest_share=0.04, damping_ratio=0.03)
    inputs = rng.standard_normal((4000, 2))
    outputs = simulate(system, inputs)
    noisy = outputs + 0.02 * outputs.std(axis=0) * rng.standard_normal(outputs.shape)
    (prepared,), choices = prepare([Record(inputs, noisy, system.dt)])
    factor = round(prepared.dt / system.dt)
    assert factor > 1
    assert 0.5 / prepared.dt > 1.2 * system.frequencies.max()
    assert f"decimated by {factor}" in choices[-1].reason
    np.testing.assert_allclose(prepared.outputs.mean(axis=0), 0.0, atol=1e-12)


@pytest.mark.parametrize("n_samples", [39, 40])
def test_too_short_a_record_is_refused_with_the_number_it_needs(n_samples):
    values = np.random.default_rng(0).standard_normal((n_samples, 2))
    record = Record(values[:, 0], values[:, 1], 0.01)
    if n_samples == 40:
        prepare([record])
        return
    with pytest.raises(InsufficientDataError, match=r"at least 40 samples in one record, .* the longest has 39"):
        prepare([record])
