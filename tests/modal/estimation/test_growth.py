"""Weak modes in what a refined model leaves, on systems of tests/reference."""

from dataclasses import replace

import numpy as np
import pytest
import scipy
from systems import modal_system, simulate

from era.realisation import Realisation
from modal.estimation.cross_validation import GrownModel
from modal.estimation.modal_parameters import (
    errors_of,
    nothing_yet,
    starting_parameters,
    with_weak_mode,
    with_weak_modes,
)
from modal.estimation.modal_states import blocks_of
from modal.estimation.output_error import OutputError, refine, step_at
from okid.record import Record


@pytest.fixture(scope="module")
def case():
    """Two strong modes and a weak one, 5 % noise, and the refined model of the strong ones alone."""
    rng = np.random.default_rng(12)
    both = {"frequencies": (6.0, 14.0, 31.0), "damping_ratios": (0.02, 0.015, 0.01)}
    system = modal_system(rng, **both, n_inputs=1, n_outputs=2, mode_sizes=(1.0, 1.0, 0.05))
    inputs = rng.standard_normal((4000, 1))
    outputs = simulate(system, inputs)
    outputs = outputs + 0.05 * outputs.std(axis=0) * rng.standard_normal(outputs.shape)
    record = Record(inputs, outputs / outputs.std(axis=0), system.dt)
    held_out = [[[(1000, 2000)]]]  # [fold][record] runs
    data = OutputError(records=(record,), rows=(np.ones(4000, dtype=bool),), blocks=blocks_of((record,), held_out))
    scale = outputs.std(axis=0)[:, np.newaxis]
    strong = Realisation(system.A[:4, :4], system.B[:4], system.C[:, :4] / scale, system.D / scale, system.dt)
    if not np.allclose(system.A[:4, 4:], 0.0):
        pytest.fail("the reference system is no longer block diagonal")
    step = refine(starting_parameters(strong, data), data, n_steps=10)[-1]
    return system, data, step


@pytest.mark.parametrize("by", ["observer", "answer", "blow"])
def test_the_weak_mode_is_found_in_the_error(case, by):
    system, data, step = case
    grown = refine(with_weak_mode(step, data, by=by), data, n_steps=15)[-1]
    assert grown.parameters.poles.size == step.parameters.poles.size + 1
    added = grown.parameters.poles[-1]
    weak = np.exp(system.poles[-1] * system.dt)
    assert abs(np.log(added) - np.log(weak)) < 0.005 * abs(np.log(weak))
    assert grown.error < 0.95 * step.error


def test_it_starts_beside_the_others_without_moving_them(case):
    _, data, step = case
    larger = with_weak_mode(step, data)
    np.testing.assert_array_equal(larger.parameters.poles[:-1], step.parameters.poles)
    assert larger.error <= step.error  # one more regressor for the same rows


def test_held_out_rows_are_not_looked_at(case):
    _, data, step = case
    record = data.records[0]
    spoilt = record.outputs.copy()
    spoilt[1000:2000] = 1e3
    other = OutputError(records=(Record(record.inputs, spoilt, record.dt),), rows=data.rows, blocks=data.blocks)
    for by in ("observer", "answer"):
        here, there = (with_weak_mode(step, which, held_out=0, by=by) for which in (data, other))
        np.testing.assert_allclose(here.parameters.poles, there.parameters.poles, atol=1e-12)


def test_errors_are_those_of_the_run_and_hidden_where_held_out(case):
    _, data, step = case
    (error,), (every,) = errors_of(step, data, held_out=0), errors_of(step, data)
    assert np.isnan(error[1000:2000]).all()
    np.testing.assert_array_equal(error[np.r_[:1000, 2000:4000]], every[np.r_[:1000, 2000:4000]])
    np.testing.assert_allclose((every**2).sum(axis=0), step.linear.squared_errors, rtol=1e-8)


def test_what_grew_on_the_same_rows_before_is_taken_as_it_is_and_on_others_grows_anew(case):
    _, data, _ = case
    record = data.records[0]
    other = replace(data, records=(replace(record, outputs=record.outputs[::-1].copy()),))
    ways = ["answer", "answer"]
    plain, told = with_weak_modes(nothing_yet(data), data, ways, lambda step: (step, data, ()))
    assert plain.parameters.poles.size == 2
    grown = GrownModel(parameters=plain.parameters, data=data, told=told)
    again, _ = with_weak_modes(nothing_yet(data), data, [], lambda step: (step, data, ()), grown)
    np.testing.assert_array_equal(again.parameters.poles, plain.parameters.poles)
    np.testing.assert_allclose(again.error, plain.error, rtol=1e-12)
    anew, _ = with_weak_modes(nothing_yet(other), other, ways, lambda step: (step, other, ()), grown)
    expected, _ = with_weak_modes(nothing_yet(other), other, ways, lambda step: (step, other, ()))
    np.testing.assert_array_equal(anew.parameters.poles, expected.parameters.poles)


def test_nothing_is_added_where_nothing_acts_or_no_row_counts(case):
    _, data, step = case
    for n_inputs in (0, 1):
        still = Record(np.zeros((4000, n_inputs)), data.records[0].outputs, data.records[0].dt)
        alone = OutputError(records=(still,), rows=data.rows, blocks=data.blocks)
        assert with_weak_mode(nothing_yet(alone), alone) is None
    none = OutputError(records=data.records, rows=(np.zeros(4000, dtype=bool),), blocks=data.blocks)
    assert with_weak_mode(step, none) is None


def test_the_weak_mode_is_found_in_rows_that_stand_alone(case):
    """Every 25th row: no observer has a past without a gap, and a correlation needs none."""
    system, data, step = case
    few = np.zeros(4000, dtype=bool)
    few[::25] = True
    found = with_weak_mode(step, OutputError(records=data.records, rows=(few,), blocks=data.blocks))
    weak = np.exp(system.poles[-1] * system.dt)
    assert abs(np.angle(found.parameters.poles[-1]) - np.angle(weak)) < 0.02


def test_long_records_are_looked_at_in_stretches(case, monkeypatch):
    _, data, step = case
    whole = with_weak_mode(step, data).parameters
    monkeypatch.setattr("modal.estimation.modal_parameters.MOST_LAGS", 256)  # four stretches of the 4000 rows
    cut = with_weak_mode(step, data).parameters
    assert abs(np.log(cut.poles[-1] / whole.poles[-1])) < 0.01
    np.testing.assert_array_equal(cut.poles[:-1], whole.poles[:-1])


def test_the_first_mode_of_nothing_is_the_one_that_a_free_run_of_its_own_explains_best(case):
    system, data, _ = case
    first = with_weak_mode(nothing_yet(data), data)
    frequencies = np.abs(np.log(first.parameters.poles)) / (2 * np.pi * system.dt)
    assert np.min(np.abs(frequencies - [[6.0], [14.0]])) < 0.1
    assert first.error < 0.75 * nothing_yet(data).error


def test_nothing_is_added_to_white_noise(case):
    _, data, _ = case
    for seed in range(5):
        noise = np.random.default_rng(seed).standard_normal((4000, 2))
        record = Record(data.records[0].inputs, noise, data.records[0].dt)
        alone = OutputError(records=(record,), rows=data.rows, blocks=data.blocks)
        assert with_weak_mode(nothing_yet(alone), alone, by="blow") is None


def red(rng, n_outputs, pole=0.95):
    """(4000, n_outputs) noise of unit power whose every value remembers the one before."""
    return scipy.signal.lfilter([np.sqrt(1 - pole**2)], [1, -pole], rng.standard_normal((4000, n_outputs)), axis=0)


def test_a_weak_mode_stands_above_the_noise_beside_it_and_not_above_all_of_it():
    """A quarter of a percent of the noise's power, most of which is elsewhere: over all of it noise stands higher."""
    rng = np.random.default_rng(3)
    system = modal_system(rng, frequencies=(31.0,), damping_ratios=(0.01,), n_inputs=1, n_outputs=2)
    inputs = rng.standard_normal((4000, 1))
    answer = simulate(system, inputs)
    record = Record(inputs, 0.05 * answer / answer.std(axis=0) + red(rng, 2), system.dt)
    data = OutputError(records=(record,), rows=(np.ones(4000, dtype=bool),), blocks=blocks_of((record,), [[[]]]))
    frequencies = [
        np.angle(with_weak_mode(nothing_yet(data), data, by=by).parameters.poles[0]) / (2 * np.pi * system.dt)
        for by in ("answer", "blow")
    ]
    assert abs(frequencies[0] - 31.0) < 0.3
    assert frequencies[1] < 10.0


def test_rest_before_a_blow_leaves_no_state_to_fit():
    """One would let a fast pole with a large state stand for what the blow does; the answers of both are exact."""
    force = np.r_[np.zeros(60), 1.0, 0.5, np.zeros(438)]
    pole = 0.98 * np.exp(0.6j)
    answer = 2.0 * np.real(np.convolve(force, np.r_[0.0, pole ** np.arange(499)])[:500])
    noise = 0.1 * np.random.default_rng(0).standard_normal(500) * (np.arange(500) >= 60)
    started = {}
    for name, outputs in (("rest", answer + noise), ("moving", answer + noise + 1e-3 * np.cos(np.arange(500)))):
        record = Record(force, outputs, 0.01)
        data = OutputError(records=(record,), rows=(np.ones(500, dtype=bool),), blocks=blocks_of((record,), [[[]]]))
        model = Realisation(
            np.array([[pole.real, -pole.imag], [pole.imag, pole.real]]), [[2.0], [0.0]], [[1.0, 0.0]], [[0.0]], 0.01
        )
        step = refine(starting_parameters(model, data), data, n_steps=5)[-1]
        started[name] = step.parameters.states.any()
        assert abs(step.parameters.poles[0] - pole) < 0.003
    assert started == {"rest": False, "moving": True}


def test_an_input_that_stands_still_in_all_records_is_kept_as_it_is():
    """Steps at the start of each record: with zeros instead nothing drove the model."""
    outputs = np.random.default_rng(0).standard_normal((2, 50, 1))
    steps = [Record(np.full(50, size), one, 0.1) for size, one in zip((1.0, 2.0), outputs, strict=True)]
    moving = Record(np.arange(50.0), outputs[0], 0.1)

    def kept(records):
        data = OutputError(
            records=tuple(records),
            rows=(np.ones(50, dtype=bool),) * len(records),
            blocks=blocks_of(records, [[[]] * len(records)]),
        )
        return [record.inputs[0, 0] for record in data.records]

    assert kept(steps) == [1.0, 2.0]
    assert kept([*steps, moving]) == [0.0, 0.0, 0.0]
    assert kept([moving, steps[1]]) == [0.0, 0.0]


def test_an_input_that_never_moves_hides_no_mode(case):
    """Nothing over nothing was the strongest answer of all, and no mode was added."""
    _, data, _ = case
    (record,) = data.records
    two = Record(np.hstack([0.0 * record.inputs, record.inputs]), record.outputs, record.dt)
    both = OutputError(records=(two,), rows=data.rows, blocks=data.blocks)
    found = with_weak_mode(nothing_yet(both), both)
    assert found is not None
    assert found.parameters.poles == with_weak_mode(nothing_yet(data), data).parameters.poles


def test_an_added_mode_starts_from_the_state_that_its_records_ask_for(case):
    """A record that begins in motion: from rest the input alone makes next to nothing of what the weak mode does."""
    system, data, _ = case
    rng = np.random.default_rng(3)
    inputs = rng.standard_normal((1500, 1))
    start = np.r_[np.zeros(4), 40.0 * np.abs(system.B[:2]).max() * np.array([1.0, -0.5])]
    outputs = simulate(system, inputs, initial_state=start)
    free = simulate(system, 0.0 * inputs, initial_state=start)
    record = Record(inputs, outputs + 0.01 * outputs.std(axis=0) * rng.standard_normal(outputs.shape), system.dt)
    data = OutputError(records=(record,), rows=(np.ones(1500, dtype=bool),), blocks=blocks_of((record,), [[[]]]))
    strong = Realisation(system.A[:4, :4], system.B[:4], system.C[:, :4], system.D, system.dt)
    step = starting_parameters(strong, data)
    larger = with_weak_mode(step, data)
    left = larger.error / step.error
    assert np.square(free).sum() > 0.5 * step.error  # it is most of what the strong modes leave
    assert left < 0.2
    resting = replace(larger.parameters, states=np.zeros_like(larger.parameters.states))
    assert step_at(resting, data).error > 2.0 * larger.error


def test_a_record_shorter_than_the_memory_of_the_noise_hides_no_mode(case):
    """A set-up cut to two rows ended the search in an error of numpy's."""
    _, data, _ = case
    (whole,) = data.records
    for n_rows in (2, 3):
        short = Record(whole.inputs[:n_rows], whole.outputs[:n_rows], whole.dt)
        records = (whole, short)
        rows = tuple(np.ones(record.n_samples, dtype=bool) for record in records)
        both = OutputError(records=records, rows=rows, blocks=blocks_of(records, [[[], []]]))
        found = with_weak_mode(nothing_yet(both), both)
        assert found.parameters.poles == with_weak_mode(nothing_yet(data), data).parameters.poles
