"""One trial against a computation by plain least squares, loops and the textbook ERA."""

from dataclasses import replace

import numpy as np
import pytest
from signals import random_inputs, with_noise
from systems import initial_state, modal_system, simulate

from era.hankel import block_sizes
from modal.estimation.cross_validation import (
    hankel_shape,
    make_trials,
    markov_lags,
    prepare_ground,
    scaled_record,
    training_decomposition,
    training_gram,
)
from okid.record import Record


def a_record(seed, n_samples=400, *, noise=0.05, n_inputs=2, n_outputs=2, frequencies=(5.0, 21.0)):
    rng = np.random.default_rng(seed)
    system = modal_system(
        rng, frequencies=frequencies, damping_ratios=[0.03] * len(frequencies), n_inputs=n_inputs, n_outputs=n_outputs
    )
    inputs = random_inputs(rng, n_samples, n_inputs)
    outputs = simulate(system, inputs, initial_state=initial_state(rng, system, inputs))
    return system, Record(inputs, with_noise(rng, outputs, noise), system.dt).detrended()


NOTHING_DONE = {"grams": {}, "decompositions": {}, "scores": {}}


# --- a naive twin ----------------------------------------------------------------------------------------------------


def naive_fit(u, y, rows, order, ridge):
    """D, alphas, betas by an augmented least-squares problem over the given rows."""
    names = [k for k in np.flatnonzero(rows) if k >= order]
    regressors = np.array([np.r_[1.0, u[k], *(np.r_[u[k - i], y[k - i]] for i in range(1, order + 1))] for k in names])
    c, m = u.shape[1] + y.shape[1], u.shape[1]
    penalty = np.r_[0.0, np.ones(m), np.repeat(np.arange(2.0, order + 2.0), c)] * ridge * len(names)
    left = np.vstack([regressors, np.diag(np.sqrt(penalty))])
    right = np.vstack([y[names], np.zeros((penalty.size, y.shape[1]))])
    solution = np.linalg.lstsq(left, right, rcond=None)[0].T
    past = [solution[:, 1 + m + i * c : 1 + m + (i + 1) * c] for i in range(order)]
    return solution[:, 1 : 1 + m], [part[:, :m] for part in past], [part[:, m:] for part in past]


def naive_pulse(D, alphas, betas, n_lags):
    pulse = [D]
    for k in range(1, n_lags + 1):
        value = alphas[k - 1].copy() if k <= len(alphas) else np.zeros_like(D)
        for i in range(1, min(k, len(betas)) + 1):
            value += betas[i - 1] @ pulse[k - i]
        pulse.append(value)
    return pulse


def naive_era(pulse, n_states):
    q, m = pulse[0].shape
    a, b = block_sizes(len(pulse) - 1, q, m, n_block_rows=None, n_block_columns=None)
    now = np.block([[pulse[1 + i + j] for j in range(b)] for i in range(a)])
    later = np.block([[pulse[2 + i + j] for j in range(b)] for i in range(a)])
    left, values, right = np.linalg.svd(now)
    left, root, right = left[:, :n_states], np.sqrt(values[:n_states]), right[:n_states]
    A = (left.T @ later @ right.T) / np.outer(root, root)
    return A, (root[:, None] * right)[:, :m], (left * root)[:q], pulse[0]


def naive_run(model, record, rows):
    """Free run, state and levels by least squares on the rows."""
    (A, B, C, D), (u, y) = model, record
    n, q = A.shape[0], C.shape[0]
    forced, columns = np.zeros_like(y), np.zeros((len(y), q, n + q))
    state, power = np.zeros(n), np.eye(n)
    for k in range(len(y)):
        forced[k] = C @ state + D @ u[k]
        state = A @ state + B @ u[k]
        columns[k] = np.hstack([C @ power, np.eye(q)])
        power = A @ power
    solution = np.linalg.lstsq(columns[rows].reshape(-1, n + q), (y - forced)[rows].ravel(), rcond=None)[0]
    return forced + columns @ solution


@pytest.mark.parametrize("ridge", [0.0, 1e-3])
def test_a_trial_is_what_the_textbook_computes(ridge):
    _, record = a_record(1)
    ground = prepare_ground([record])
    trials = make_trials(ground, [3, 6], ridge, [2, 4], [0, 1, 2])
    assert [(t.observer_order, t.ridge, t.model_order) for t in trials] == [
        (3, ridge, 2),
        (3, ridge, 4),
        (6, ridge, 2),
        (6, ridge, 4),
    ]
    u, y = record.inputs / record.inputs.std(axis=0), record.outputs / record.outputs.std(axis=0)
    for trial in trials:
        squares, power = np.zeros((3, 2)), np.zeros((3, 2))
        for fold, (held_out,) in enumerate(ground.folds):
            pulse = naive_pulse(*naive_fit(u, y, ~held_out, trial.observer_order, ridge), ground.n_lags)
            run = naive_run(naive_era(pulse, trial.model_order), (u, y), ~held_out)
            squares[fold] = np.square(y - run)[held_out].sum(axis=0)
            power[fold] = np.square(y)[held_out].sum(axis=0)
        np.testing.assert_allclose(trial.squared_errors, squares, rtol=1e-6)
        np.testing.assert_allclose(ground.power, power, rtol=1e-10)
        expected = np.sqrt(squares.sum(axis=0) / power.sum(axis=0)).mean()
        assert trial.error == pytest.approx(expected, rel=1e-6)
        # nine blocks of ten are held out once; their errors add up to the whole
        assert trial.block_errors.shape == (9,)
        assert trial.block_errors.sum() == pytest.approx((squares.sum(axis=0) / power.sum(axis=0)).mean(), rel=1e-6)


def test_held_out_rows_do_not_reach_the_model():
    """A block's rows are spoilt, but for the last ones, which are the past of training rows."""
    order = 4
    _, record = a_record(2, n_samples=600)
    ground = prepare_ground([record])
    first, last = ground.blocks[0][0][1]
    spoilt = record.outputs.copy()
    spoilt[first : last - order] += 30.0 * record.outputs.std(axis=0)
    changed = replace(record, outputs=spoilt)
    again = replace(ground, records=(changed,), scaled=(scaled_record(changed, ground.scaling),), **NOTHING_DONE)
    (before,) = make_trials(ground, [order], 1e-4, [4], [0])
    (after,) = make_trials(again, [order], 1e-4, [4], [0])
    assert after.block_errors[1] > 100 * before.block_errors[1]
    others = [0, 2]
    np.testing.assert_allclose(after.block_errors[others], before.block_errors[others], rtol=1e-6)
    # the same rows train in another fold: there the change must be seen
    (before,) = make_trials(ground, [order], 1e-4, [4], [1])
    (after,) = make_trials(again, [order], 1e-4, [4], [1])
    assert (np.abs(after.block_errors - before.block_errors) > 0.1 * before.block_errors).any()


def test_missing_rows_are_neither_fitted_nor_scored():
    _, record = a_record(3, n_samples=600)
    outputs = record.outputs.copy()
    outputs[130:140, 0] = np.nan  # in a held-out block
    ground = prepare_ground([replace(record, outputs=outputs)])
    complete = ~np.isnan(outputs).any(axis=1)
    for fold, held_out, trained in zip(ground.folds, ground.held_out, ground.trained, strict=True):
        np.testing.assert_array_equal(held_out[0], fold[0] & complete)
        np.testing.assert_array_equal(trained[0], ~fold[0] & complete)
    assert np.isfinite(ground.scaled[0].outputs).all()
    bridge = replace(ground.scaled[0], outputs=np.where(complete[:, None], ground.scaled[0].outputs, 1e6))
    grounds = [replace(ground, scaled=scaled, **NOTHING_DONE) for scaled in (ground.scaled, (bridge,))]
    trials = [make_trials(each, [8], 0.0, [4], [0, 1, 2]) for each in grounds]
    np.testing.assert_array_equal(trials[0][0].squared_errors, trials[1][0].squared_errors)


def test_exact_data_have_no_error_at_the_true_order():
    _, record = a_record(4, noise=0.0)
    ground = prepare_ground([record])
    trials = {t.model_order: t for t in make_trials(ground, [8], 0.0, [2, 4], [0, 1, 2])}
    assert trials[4].error < 1e-6
    assert trials[2].error > 1e-2


def test_orders_beyond_the_rank_are_left_out():
    _, record = a_record(5, noise=0.0)
    assert [t.model_order for t in make_trials(prepare_ground([record]), [8], 0.0, [4, 12], [0])] == [4]


def test_what_was_computed_is_given_again_and_a_larger_order_is_decomposed_anew():
    _, record = a_record(7)
    ground = prepare_ground([record])
    small = training_decomposition(ground, 6, 1e-3, 1, 2)
    assert training_decomposition(ground, 6, 1e-3, 1, 2) is small
    assert training_decomposition(ground, 6, 1e-3, 1, 1) is small
    assert training_gram(ground, 6, 1) is training_gram(ground, 6, 1)
    larger = training_decomposition(ground, 6, 1e-3, 1, 8)
    assert (small.max_order, larger.max_order) == (2, 8)
    # other candidates share nothing with it
    alone = prepare_ground([record])
    for p, ridge, fold in ((6, 1e-3, 0), (5, 1e-3, 1), (6, 1e-2, 1)):
        again = training_decomposition(ground, p, ridge, fold, 8)
        expected = training_decomposition(alone, p, ridge, fold, 8)
        np.testing.assert_array_equal(again.singular_values, expected.singular_values)
        assert np.abs(again.singular_values - larger.singular_values).max() > 1e-6
    (first,) = make_trials(ground, [6], 1e-3, [4], [0, 1, 2])
    (apart,) = make_trials(prepare_ground([record]), [6], 1e-3, [4], [0, 1, 2])
    assert first.error == pytest.approx(apart.error, rel=1e-5)  # the randomised decomposition of 8 orders, and of 4


def test_without_inputs_the_one_step_prediction_is_scored():
    """White noise through a known filter: one step ahead, the error of the true predictor is the noise itself."""
    rng = np.random.default_rng(6)
    noise = rng.standard_normal(4000)
    y = np.zeros(4000)
    for k in range(2, 4000):
        y[k] = 1.6 * y[k - 1] - 0.81 * y[k - 2] + noise[k]
    ground = prepare_ground([Record([], y, 0.1).detrended()])
    (trial,) = make_trials(ground, [2], 0.0, [2], [0, 1, 2])
    held_out = np.logical_or.reduce([fold[0] for fold in ground.folds])
    floor = np.sqrt(np.square(noise[held_out]).sum() / np.square(y[held_out]).sum())
    assert trial.error == pytest.approx(floor, rel=0.02)


@pytest.mark.parametrize(("n_inputs", "n_outputs"), [(0, 1), (1, 1), (2, 3), (4, 64)])
def test_lags_give_a_hankel_matrix_of_bounded_size(n_inputs, n_outputs):
    lags = markov_lags(n_inputs, n_outputs)
    assert 120 <= lags <= 400
    rows, columns = hankel_shape(lags, n_inputs, n_outputs)
    assert rows // n_outputs + columns // (n_inputs or n_outputs) == lags
