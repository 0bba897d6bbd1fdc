"""The free run against a plain loop, and the choice against the scores it was made on."""

import numpy as np
import pytest
from signals import random_inputs, with_noise
from systems import initial_state, random_system, simulate

from okid import free_run as free_run_module
from okid.errors import InsufficientDataError
from okid.folds import interleaved_folds
from okid.free_run import free_run, held_out_errors, prepare_free_runs
from okid.gram import lag_gram
from okid.order_choice import choose_observer
from okid.record import Record
from okid.regression import solve_nested
from okid.scaling import channel_scaling


def make(seed, n_samples, *, n_inputs=2):
    rng = np.random.default_rng(seed)
    system = random_system(rng, n_modes=2, n_inputs=n_inputs, n_outputs=2)
    u = random_inputs(rng, n_samples, n_inputs)
    y = simulate(system, u, initial_state=initial_state(rng, system, u))
    return Record(u, with_noise(rng, y, 0.05), system.dt)


def textbook_free_run(observer, u, y, first):
    """From row `first` on, one step after the other, with its own outputs in the place of the measured ones."""
    own = [*y[first - observer.order : first]]
    for k in range(first, len(u)):
        value = observer.offset + observer.feedthrough @ u[k]
        for i in range(1, observer.order + 1):
            value = value + observer.input_coefficients[i - 1] @ u[k - i]
            value = value + observer.output_coefficients[i - 1] @ own[-i]
        own.append(value)
    return np.array(own[observer.order :])


@pytest.mark.parametrize("longest", [10_000, 120])
@pytest.mark.parametrize("order", [1, 6])
def test_free_run_equals_the_loop(monkeypatch, longest, order):
    monkeypatch.setattr(free_run_module, "_LONGEST_RUN", longest)
    records = [make(1, 500), make(2, 133)]
    scaling = channel_scaling(records)
    observer = solve_nested(lag_gram(records, 6, scaling=scaling), [order], 1e-3)[0]
    runs = prepare_free_runs(records, scaling, 6)
    assert len(runs.places) == (2 if longest > 500 else 6)
    found = free_run(observer, runs)
    for run, (number, first) in enumerate(runs.places):
        u = (records[number].inputs - scaling.input_mean) / scaling.input_scale
        y = (records[number].outputs - scaling.output_mean) / scaling.output_scale
        n_steps = int((~np.isnan(runs.outputs[:, 0, run])).sum())
        expected = textbook_free_run(observer, u, y, first)[:n_steps]
        assert np.allclose(runs.outputs[:n_steps, :, run], y[first : first + n_steps], rtol=0, atol=1e-14)
        assert np.abs(found[:n_steps, :, run] - expected).max() < 1e-11


def test_held_out_error_counts_held_out_rows_only():
    record = make(3, 300)
    scaling = channel_scaling([record])
    observer = solve_nested(lag_gram([record], 4, scaling=scaling), [4], 0.0)[0]
    runs = prepare_free_runs([record], scaling, 4)
    mask = np.random.default_rng(4).random(300) < 0.3
    error, energy = held_out_errors(observer, runs, [mask])
    y = (record.outputs - scaling.output_mean) / scaling.output_scale
    u = (record.inputs - scaling.input_mean) / scaling.input_scale
    residual = textbook_free_run(observer, u, y, 4) - y[4:]
    assert error == pytest.approx((residual[mask[4:]] ** 2).sum(), rel=1e-10)
    assert energy == pytest.approx((y[4:][mask[4:]] ** 2).sum(), rel=1e-10)


def test_a_run_begins_after_the_missing_samples():
    record = make(5, 200)
    y = np.array(record.outputs)
    y[5] = np.nan
    y[150] = np.nan
    gap = Record(record.inputs, y, record.dt)
    runs = prepare_free_runs([gap], channel_scaling([gap]), 10)
    assert runs.places == ((0, 16),)
    assert prepare_free_runs([gap.samples(0, 12)], channel_scaling([gap]), 8) is None


def test_the_choice_is_the_least_held_out_error_and_uses_no_held_out_row():
    record = make(6, 700)
    scaling = channel_scaling([record])
    choice = choose_observer([record], scaling, orders=(1, 4, 8), ridges=(0.0, 1e-2))
    runs = prepare_free_runs([record], scaling, 8)
    errors, energy = np.zeros((3, 2)), 0.0
    for fold in interleaved_folds([record]):
        training = lag_gram([record], 8, scaling=scaling, rows=[~fold[0]])
        for column, ridge in enumerate((0.0, 1e-2)):
            for row, observer in enumerate(solve_nested(training, (1, 4, 8), ridge)):
                error, weight = held_out_errors(observer, runs, fold)
                errors[row, column] += error
        energy += weight
    assert np.allclose(choice.errors, errors / energy, rtol=1e-6)
    assert (
        choice.errors[choice.orders.index(choice.order), choice.ridges.index(choice.ridge)]
        <= 1.02 * errors.min() / energy
    )


def test_an_unstable_observer_scores_infinity():
    record = make(7, 2000, n_inputs=1)
    scaling = channel_scaling([record])
    observer = solve_nested(lag_gram([record], 2, scaling=scaling), [1], 0.0)[0]
    wild = type(observer)(
        **{name: getattr(observer, name) for name in observer.__slots__}
        | {"output_coefficients": 1.5 * np.eye(2)[None]}
    )
    runs = prepare_free_runs([record], scaling, 2)
    assert held_out_errors(wild, runs, [np.ones(2000, bool)])[0] == np.inf


def test_too_few_samples_to_choose():
    with pytest.raises(InsufficientDataError, match="takes an order and a ridge without folds"):
        choose_observer([make(8, 30)], channel_scaling([make(8, 30)]))
    short = make(9, 45)
    with pytest.raises(InsufficientDataError, match="but 45 samples are too few even for order 16"):
        choose_observer([short], channel_scaling([short]), orders=(16,))


@pytest.mark.parametrize("share", [0.01, 0.03, 0.1])
def test_scattered_missing_samples_leave_out_the_orders_that_they_leave_no_rows(share):
    record = make(5, 3000, n_inputs=1)
    outputs = np.array(record.outputs)
    outputs[np.random.default_rng(6).random(outputs.shape) < share] = np.nan
    with_gaps = Record(record.inputs, outputs, record.dt)
    choice = choose_observer([with_gaps], channel_scaling([with_gaps]))
    assert max(choice.orders) < 128
    assert float(choice.errors.min()) < 0.1
