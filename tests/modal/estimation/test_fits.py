import numpy as np
import pytest
from signals import random_inputs
from systems import initial_state, modal_system, simulate

from era.realisation import Realisation
from modal.estimation.cross_validation import Trial
from modal.estimation.fits import fit_of, measure_fit, model_runs
from okid.errors import NumericalError
from okid.record import Record


def records_of(*outputs):
    return [Record(np.zeros((len(y), 0)), y, 0.1) for y in outputs]


def test_fit_is_the_formula_of_measures():
    rng = np.random.default_rng(1)
    y, model = rng.standard_normal((2, 50, 3)) + 4.0
    expected = [1 - np.linalg.norm(y[:, i] - model[:, i]) / np.linalg.norm(y[:, i] - y[:, i].mean()) for i in range(3)]
    np.testing.assert_allclose(fit_of(records_of(y), records_of(model)), expected, rtol=1e-12)


def test_several_records_are_scored_about_their_own_means_together():
    rng = np.random.default_rng(2)
    first, second = rng.standard_normal((40, 1)) + 100.0, rng.standard_normal((60, 1)) - 100.0
    wrong = 0.1 * rng.standard_normal((60, 1))
    power = np.square(first - first.mean()).sum() + np.square(second - second.mean()).sum()
    expected = 1 - np.sqrt(np.square(wrong).sum() / power)
    assert fit_of(records_of(first, second), records_of(first, second + wrong)) == pytest.approx(expected, rel=1e-9)


def test_missing_rows_are_not_scored_and_an_output_at_rest_has_no_fit():
    y = np.array([[0.0, 5.0], [1.0, 5.0], [2.0, 5.0], [np.nan, 5.0], [4.0, 5.0]])
    model = np.array([[0.0, 5.0], [1.0, 5.0], [2.0, 5.0], [1e9, 5.0], [4.0, 5.0]])
    fit = fit_of(records_of(y), records_of(model))
    assert fit[0] == 1.0
    assert np.isnan(fit[1])


def test_the_mean_of_the_record_fits_with_zero():
    y = np.array([[0.0], [1.0], [5.0]])
    assert fit_of(records_of(y), records_of(np.full((3, 1), 2.0))) == pytest.approx(0.0, abs=1e-12)


# --- runs ------------------------------------------------------------------------------------------------------------


def a_case(levels=((4.0, -20.0, 300.0), (-1.0, 0.0, 7.0))):
    rng = np.random.default_rng(3)
    system = modal_system(rng, frequencies=[4.0, 19.0], damping_ratios=[0.02, 0.01])
    records = []
    for level in levels:
        inputs = random_inputs(rng, 400, 2)
        outputs = simulate(system, inputs, initial_state=initial_state(rng, system, inputs))
        records.append(Record(inputs, outputs + np.asarray(level), system.dt))
    return rng, system, records


def model_of(system, **options):
    return Realisation(system.A, system.B, system.C, system.D, system.dt, **options)


def test_each_record_has_its_own_state_and_its_own_level():
    _, system, records = a_case()
    runs = model_runs(model_of(system), records)
    for record, levelled, simulated, level in zip(
        records, runs.records, runs.simulated, ((4.0, -20.0, 300.0), (-1.0, 0.0, 7.0)), strict=True
    ):
        size = np.abs(record.outputs - level).max()
        np.testing.assert_allclose(levelled.outputs, record.outputs - level, atol=1e-5 * size)
        np.testing.assert_allclose(simulated.outputs, record.outputs - level, atol=1e-5 * size)
    assert runs.predicted[0].outputs.tolist() == runs.simulated[0].outputs.tolist()  # no gain: the free run


def test_gaps_stay_gaps_and_do_not_disturb():
    _, system, (record, _) = a_case()
    outputs = record.outputs.copy()
    outputs[100:130, 1] = np.nan
    runs = model_runs(model_of(system), [Record(record.inputs, outputs, record.dt)])
    np.testing.assert_array_equal(np.isnan(runs.records[0].outputs), np.isnan(outputs))
    truth = record.outputs - np.array([4.0, -20.0, 300.0])
    np.testing.assert_allclose(runs.simulated[0].outputs, truth, atol=1e-5 * np.abs(truth).max())


def test_units_do_not_weigh():
    """The state is fitted in scaled channels: micrometres beside kilonewtons change nothing."""
    rng, system, (record, _) = a_case()
    noisy = Record(record.inputs, record.outputs + rng.standard_normal(record.outputs.shape), record.dt)
    size, into = np.array([1e6, 1.0, 1e-6]), np.array([1e3, 1e-3])
    other = Realisation(system.A, system.B / into, system.C * size[:, None], system.D * size[:, None] / into, system.dt)
    one = model_runs(model_of(system), [noisy]).simulated[0].outputs
    two = model_runs(other, [Record(noisy.inputs * into, noisy.outputs * size, noisy.dt)]).simulated[0].outputs
    np.testing.assert_allclose(two / size, one, atol=1e-8 * np.abs(one).max())


def test_one_step_predictions_use_the_gain():
    rng, system, _ = a_case()
    gain = 0.05 * system.A @ system.C.T
    assert np.abs(np.linalg.eigvals(system.A - gain @ system.C)).max() < 1
    inputs, innovations = rng.standard_normal((400, 2)), 3.0 * rng.standard_normal((400, 3))
    outputs, state = np.empty((400, 3)), rng.standard_normal(system.order)
    for k in range(400):
        outputs[k] = system.C @ state + system.D @ inputs[k] + innovations[k]
        state = system.A @ state + system.B @ inputs[k] + gain @ innovations[k]
    record = Record(inputs, outputs + 40.0, system.dt)
    runs = model_runs(model_of(system, K=gain), [record])
    errors = [np.square(run.outputs - runs.records[0].outputs).sum() for run in (runs.predicted[0], runs.simulated[0])]
    floor = np.square(innovations - innovations.mean(axis=0)).sum()
    assert errors[0] == pytest.approx(floor, rel=0.02)
    assert errors[1] > 1.02 * floor


def test_a_predictor_that_cannot_run_gives_way_to_the_free_run():
    _, system, (record, _) = a_case()
    useless = 50.0 * np.ones((system.order, 3))  # A - K C is unstable
    runs = model_runs(model_of(system, K=useless), [record])
    assert runs.predicted[0].outputs.tolist() == runs.simulated[0].outputs.tolist()
    # deadbeat: A - K C = [[0, 1], [0, 0]] has no two independent eigenvectors
    A, C = np.array([[0.5, 1.0], [0.2, 0.0]]), np.array([[1.0, 0.0]])
    deadbeat = Realisation(A, np.ones((2, 1)), C, [[0.0]], 0.1, K=np.array([[0.5], [0.2]]))
    u = np.random.default_rng(1).standard_normal(100)
    y = np.random.default_rng(2).standard_normal(100)
    runs = model_runs(deadbeat, [Record(u, y, 0.1)])
    assert np.isfinite(runs.predicted[0].outputs).all()


def test_a_model_that_cannot_run_is_an_error():
    _, system, (record, _) = a_case()
    unstable = Realisation(1.1 * system.A, system.B, system.C, system.D, system.dt)
    with pytest.raises(NumericalError, match="needs a stable model"):
        model_runs(unstable, [record])


def test_measure_fit_takes_the_held_out_errors_of_the_chosen_trial():
    _, system, records = a_case()
    squared, power = np.array([[1.0, 4.0, 9.0], [4.0, 1.0, 0.0]]), np.array([[100.0, 100.0, 9.0], [25.0, 400.0, 16.0]])
    chosen = Trial(
        observer_order=4, ridge=0.0, model_order=4, squared_errors=squared, block_errors=np.ones(9), error=0.2
    )
    runs = model_runs(model_of(system), records)
    fit = measure_fit(chosen, power, runs)
    np.testing.assert_allclose(fit.cross_validated, [1 - np.sqrt(5 / 125), 1 - np.sqrt(5 / 500), 1 - np.sqrt(9 / 25)])
    np.testing.assert_allclose(fit.folds, [(0.9 + 0.8 + 0.0) / 3, (0.6 + 0.95 + 1.0) / 3])
    np.testing.assert_allclose(fit.whole, 1.0, atol=1e-5)
