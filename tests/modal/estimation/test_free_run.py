"""Free runs against plain loops: the state and the level come from the training rows, and from nothing else."""

from dataclasses import replace

import numpy as np
import pytest
from signals import random_inputs
from systems import initial_state, modal_system, simulate

from era.realisation import Realisation
from modal.estimation.free_run import ModalForm, driven_by_outputs, filled, free_run, modal_form, one_step_predictor
from okid.record import Record

LEVEL = np.array([3.0, -0.4, 20.0])


def a_system(seed=0, **options):
    rng = np.random.default_rng(seed)
    options = {"frequencies": [3.0, 3.2, 17.0], "damping_ratios": [0.01, 0.02, 0.03], "real_poles": [-8.0], **options}
    return rng, modal_system(rng, **options)


def model_of(system):
    return Realisation(system.A, system.B, system.C, system.D, system.dt)


def a_case(seed=0, n_samples=600, **options):
    rng, system = a_system(seed, **options)
    inputs = random_inputs(rng, n_samples, system.n_inputs)
    outputs = simulate(system, inputs, initial_state=initial_state(rng, system, inputs))
    return rng, model_of(system), Record(inputs, outputs + LEVEL, system.dt)


def some_rows(n_samples, *runs):
    rows = np.zeros(n_samples, dtype=bool)
    for first, last in runs:
        rows[first:last] = True
    return rows


def check_equal(found, truth, tolerance=1e-6):
    np.testing.assert_allclose(found, truth, rtol=0, atol=tolerance * np.abs(truth - truth.mean(axis=0)).max())


@pytest.mark.parametrize(
    "runs", [[(0, 600)], [(0, 60)], [(0, 40), (90, 91), (100, 300), (420, 600)], [(7, 90)]], ids=str
)
@pytest.mark.parametrize("seed", range(3))
def test_free_run_repeats_exact_data_whatever_rows_train(seed, runs):
    _, model, record = a_case(seed)
    run = free_run(modal_form(model), record, some_rows(600, *runs))
    # the regularisation of the state (1e-9 of its energy over the record) is all that keeps it from being exact
    check_equal(run.outputs, record.outputs, 2e-6)
    np.testing.assert_allclose(run.level, LEVEL, atol=2e-6 * np.abs(record.outputs).max())


def test_rows_that_do_not_train_are_not_looked_at():
    rng, model, record = a_case(4)
    rows = some_rows(600, (0, 150), (300, 420))
    spoilt = record.outputs.copy()
    spoilt[~rows] += 1e6 * rng.standard_normal(spoilt[~rows].shape)
    untouched = free_run(modal_form(model), record, rows)
    run = free_run(modal_form(model), replace(record, outputs=spoilt), rows)
    np.testing.assert_array_equal(run.outputs, untouched.outputs)
    np.testing.assert_array_equal(run.level, untouched.level)


def test_the_state_is_the_least_squares_one_on_noisy_rows():
    rng, model, record = a_case(5, n_samples=200)
    noisy = record.outputs + 0.3 * record.outputs.std(axis=0) * rng.standard_normal(record.outputs.shape)
    rows = some_rows(200, (0, 80), (120, 200))
    n, q = model.order, 3
    # textbook: y - forced = C A^k x0 + level, stacked over the rows
    forced = np.zeros_like(noisy)
    columns = np.zeros((200, q, n + q))
    state, power = np.zeros(n), np.eye(n)
    for k in range(200):
        forced[k] = model.C @ state + model.D @ record.inputs[k]
        state = model.A @ state + model.B @ record.inputs[k]
        columns[k] = np.hstack([model.C @ power, np.eye(q)])
        power = model.A @ power
    solution, *_ = np.linalg.lstsq(columns[rows].reshape(-1, n + q), (noisy - forced)[rows].ravel(), rcond=None)
    run = free_run(modal_form(model), replace(record, outputs=noisy), rows)
    check_equal(run.outputs, forced + columns @ solution, 1e-5)


@pytest.mark.parametrize("pattern", ["by turns", "scattered", "one output silent for long"])
def test_outputs_missing_sample_by_sample_give_the_least_squares_run_of_the_others(pattern):
    """The textbook twin: one equation for each sample that was measured, the ridge of the engine beside them."""
    rng, model, record = a_case(6, n_samples=200)
    n, q, n_samples = model.order, 3, 200
    there = np.ones((n_samples, q), dtype=bool)
    if pattern == "by turns":
        there = np.arange(n_samples)[:, np.newaxis] % q == np.arange(q)
    elif pattern == "scattered":
        there = rng.random((n_samples, q)) > 0.3
    else:
        there[20:150, 1] = False
    noisy = record.outputs + 0.3 * record.outputs.std(axis=0) * rng.standard_normal(record.outputs.shape)
    form = modal_form(model)
    forced = np.zeros((n_samples, q))
    state = np.zeros(n)
    for k in range(n_samples):
        forced[k] = model.C @ state + model.D @ record.inputs[k]
        state = model.A @ state + model.B @ record.inputs[k]
    free = (form.weights * form.shapes) * form.poles ** np.arange(n_samples)[:, np.newaxis, np.newaxis]
    levels = np.broadcast_to(np.eye(q), (n_samples, q, q))
    columns = np.concatenate([free.real, -free.imag, levels], axis=2)
    energy = 0.5 * np.square(np.abs(free)).sum(axis=(0, 1))
    ridge = np.diag(1e-9 * np.concatenate([energy, energy, there.sum(axis=0)]))
    left = np.where(there, noisy - forced, 0.0)
    seen = columns[there]
    solution = np.linalg.solve(seen.T @ seen + ridge, seen.T @ left[there])
    run = free_run(form, replace(record, outputs=np.where(there, noisy, np.nan)), there)
    check_equal(run.outputs, forced + columns @ solution, 1e-10)
    np.testing.assert_allclose(run.level, solution[-q:], rtol=1e-8)


@pytest.mark.parametrize(("first", "largest"), [(20, 5e3), (40, 1.0)])
def test_a_state_that_no_training_row_shows_stays_small(first, largest):
    """|pole|^20 = 1e-6: without regularisation the noise of the training rows would give a state of 1e6."""
    rng = np.random.default_rng(1)
    model = Realisation([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.1)
    outputs = rng.standard_normal(300)
    run = free_run(modal_form(model), Record(np.zeros(300), outputs, 0.1), some_rows(300, (first, 300)))
    assert np.abs(run.outputs).max() < largest


def test_a_pole_at_the_edge_of_stability():
    """The state of an integrator and the level are the same thing; their sum is what must be right."""
    model = Realisation([[1 - 1e-13]], [[1.0]], [[1.0]], [[0.5]], 0.1)
    inputs = np.sin(np.arange(200.0))
    outputs, state = np.empty(200), 2.0
    for k in range(200):
        outputs[k] = state + 0.5 * inputs[k] + 7.0
        state = (1 - 1e-13) * state + inputs[k]
    record = Record(inputs, outputs, 0.1)
    rows = some_rows(200, (0, 30), (60, 90))
    check_equal(free_run(modal_form(model), record, rows).outputs[:, 0], outputs)
    exactly_one = ModalForm(
        poles=np.ones(1, complex),
        weights=np.ones(1),
        shapes=np.ones((1, 1), complex),
        participations=np.ones((1, 1), complex),
        feedthrough=np.array([[0.5]]),
    )
    check_equal(free_run(exactly_one, record, rows).outputs[:, 0], outputs)


def test_a_model_without_states_is_its_feedthrough():
    model = Realisation(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[2.0]], 0.1)
    record = Record([1.0, -1.0, 3.0, 0.0], [7.0, 3.0, 11.0, 5.0], 0.1)
    run = free_run(modal_form(model), record, np.ones(4, bool))
    np.testing.assert_allclose(run.outputs, record.outputs, atol=1e-7)
    np.testing.assert_allclose(run.level, [5.0], atol=1e-7)


def test_modal_form_holds_one_of_each_pair():
    _, system = a_system()
    form = modal_form(model_of(system))
    assert form.poles.size == len(system.poles)
    for pole in system.discrete_poles:
        assert np.abs(form.poles - pole).min() < 1e-12
    np.testing.assert_array_equal(form.weights, np.where(form.poles.imag > 0, 2.0, 1.0))


@pytest.mark.parametrize(
    "A",
    [
        [[1.0]],
        [[-1.02]],
        [[0.0, 1.0], [-1.01, 0.5]],
        [[0.5, 1.0], [0.0, 0.5]],  # a Jordan block: no two independent eigenvectors
    ],
    ids=["integrator", "growing and alternating", "growing oscillation", "defective"],
)
def test_what_cannot_run_freely_has_no_modal_form(A):
    n = len(A)
    assert modal_form(Realisation(A, np.ones((n, 1)), np.ones((1, n)), [[0.0]], 0.1)) is None


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_nearly_dependent_eigenvectors_cost_their_condition_only(sign):
    """Two poles 7e-8 apart, as of a deadbeat predictor: one pair, or two real ones."""
    A = np.array([[0.3, 1.0], [sign * 1e-15, 0.3]])
    model = Realisation(A, [[1.0], [2.0]], [[1.0, -1.0]], [[0.5]], 0.1)
    form = modal_form(model)
    assert form is not None
    inputs = np.random.default_rng(8).standard_normal(200)
    outputs, state = np.empty(200), np.zeros(2)
    for k in range(200):
        outputs[k] = model.C[0] @ state + 0.5 * inputs[k]
        state = A @ state + model.B[:, 0] * inputs[k]
    check_equal(free_run(form, Record(inputs, outputs, 0.1), np.ones(200, bool)).outputs[:, 0], outputs, 1e-5)


def test_participations_and_shapes_give_the_pulse_response():
    _, system = a_system(9)
    form = modal_form(model_of(system))
    power = np.eye(system.order)
    for k in range(6):
        pulse = ((form.shapes * form.weights * form.poles**k) @ form.participations).real
        np.testing.assert_allclose(pulse, system.C @ power @ system.B, rtol=0, atol=1e-10)
        power = system.A @ power


def test_the_one_step_predictor_is_the_innovation_loop():
    rng, system = a_system(7)
    gain = 0.1 * rng.standard_normal((system.order, system.n_outputs))
    model = Realisation(system.A, system.B, system.C, system.D, system.dt, K=gain)
    inputs, measured = rng.standard_normal((80, 2)), rng.standard_normal((80, 3))
    predicted, state = np.empty((80, 3)), np.zeros(system.order)
    for k in range(80):
        predicted[k] = system.C @ state + system.D @ inputs[k]
        state = system.A @ state + system.B @ inputs[k] + gain @ (measured[k] - predicted[k])
    twin = driven_by_outputs(Record(inputs, measured, system.dt))
    ours = one_step_predictor(model)
    found, state = np.empty((80, 3)), np.zeros(system.order)
    for k in range(80):
        found[k] = ours.C @ state + ours.D @ twin.inputs[k]
        state = ours.A @ state + ours.B @ twin.inputs[k]
    np.testing.assert_allclose(found, predicted, atol=1e-9 * np.abs(predicted).max())


def test_no_gain_no_predictor():
    with pytest.raises(ValueError, match="needs the gain K"):
        one_step_predictor(model_of(a_system()[1]))


def test_driven_by_outputs_takes_all_channels_as_inputs_and_bridges_gaps():
    record = Record([1.0, 2.0, 3.0], [[5.0], [np.nan], [9.0]], 0.1, output_names=["tip"], output_units=["m"])
    twin = driven_by_outputs(record)
    assert twin.input_names == ("input_0", "past of tip")
    assert twin.input_units == ("", "m")
    np.testing.assert_array_equal(twin.inputs, [[1.0, 5.0], [2.0, 7.0], [3.0, 9.0]])
    np.testing.assert_array_equal(twin.outputs, [[5.0], [7.0], [9.0]])


def test_filled_bridges_gaps_and_leaves_the_rest():
    whole = Record([1.0, 2.0], [1.0, 2.0], 0.1)
    gaps = Record([np.nan, 2.0, np.nan, 6.0], [1.0, np.nan, np.nan, 4.0], 0.1)
    same, bridged = filled([whole, gaps])
    assert same is whole
    np.testing.assert_array_equal(bridged.inputs[:, 0], [2.0, 2.0, 4.0, 6.0])
    np.testing.assert_array_equal(bridged.outputs[:, 0], [1.0, 2.0, 3.0, 4.0])
