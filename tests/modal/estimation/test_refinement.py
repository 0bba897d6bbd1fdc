"""Output-error refinement against explicit Jacobians, differences and a general least-squares solver.

Every model, run and Jacobian here comes from loops over samples (`textbook_output_error`); of the product only what is
tested is used.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import scipy
from textbook_output_error import (
    LoopModel,
    changed,
    differences,
    loop_run,
    loop_sensitivities,
    projected_errors,
    random_loop_model,
    regressors,
)

from modal.estimation.modal_states import NONE, ModalParameters, blocks_of
from modal.estimation.output_error import OutputError, PolesAndParticipations, refine, step_at, step_equations
from okid.record import Record


def parameters_of(model):
    return ModalParameters(poles=model.poles, is_pair=model.is_pair, inputs=model.b, states=model.starts)


def problem(rng, model, lengths, *, noise=0.0, missing=0.0, held_out=()):
    """Data of a loop; `held_out` [fold][record] runs."""
    inputs = [rng.standard_normal((n, model.b.shape[1])) for n in lengths]
    clean = [loop_run(model, r, u) for r, u in enumerate(inputs)]
    outputs = [y + noise * rng.standard_normal(y.shape) for y in clean]
    records = tuple(Record(u, y, 0.1) for u, y in zip(inputs, outputs, strict=True))
    rows = tuple(rng.random(n) >= missing for n in lengths)
    return OutputError(records=records, rows=rows, blocks=blocks_of(records, held_out))


def arrays_of(data, held_out=NONE):
    """Inputs, outputs and counted rows of each record."""
    rows = [there.copy() for there in data.rows]
    for block in data.blocks:
        if block.label == held_out:
            rows[block.record][block.first : block.last] = False
    return [record.inputs for record in data.records], [record.outputs for record in data.records], rows


def disturbed(rng, model, size):
    """Another model near by: poles, participations and initial states moved."""

    def some(shape):
        values = 1 + size * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
        return np.where(model.is_pair, values, values.real)

    decay = -np.log(np.abs(model.poles)) * np.exp(10 * size * rng.standard_normal(model.poles.size))
    angle = np.angle(model.poles) * (1 + 0.1 * size * rng.standard_normal(model.poles.size))
    return replace(
        model,
        poles=np.where(model.is_pair, np.exp(-decay + 1j * angle), np.sign(model.poles.real) * np.exp(-decay)),
        b=model.b * some((model.b.shape[1], model.poles.size)).T,
        starts=model.starts * some(model.starts.shape),
    )


KINDS = {
    "one channel each": {"lengths": (120,), "n_pairs": 1, "n_outputs": 1},
    "two inputs, two records, real pole": {"lengths": (110, 80), "n_real": 1, "n_inputs": 2, "n_records": 2},
    "negative real pole": {"lengths": (120,), "n_pairs": 1, "n_real": 1, "n_inputs": 2, "negative": True},
    "close pair, three outputs": {"lengths": (200,), "n_outputs": 3, "close": 0.05, "n_inputs": 2},
}


def a_problem(seed, kind, **more):
    rng = np.random.default_rng(seed)
    options = dict(KINDS[kind])
    lengths, negative = options.pop("lengths"), options.pop("negative", False)
    model = random_loop_model(rng, **options)
    if negative:
        model = replace(model, poles=np.where(model.is_pair, model.poles, -model.poles))
    return rng, model, problem(rng, model, lengths, **more)


def held_out_runs(kind):
    return [[[(n // 3, n // 2)] for n in KINDS[kind]["lengths"]]]


# --- one step --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_error_and_linear_part_are_those_of_least_squares_on_a_loop(kind):
    rng, model, data = a_problem(1, kind, noise=0.1, missing=0.1, held_out=held_out_runs(kind))
    step = step_at(parameters_of(disturbed(rng, model, 0.02)), data, held_out=0)
    loop = replace(model, poles=step.parameters.poles, b=step.parameters.inputs, starts=step.parameters.states)
    expected = projected_errors(loop, *arrays_of(data, 0))
    np.testing.assert_allclose(step.linear.squared_errors, expected, rtol=1e-9)
    scored = [i for i, block in enumerate(data.blocks) if block.label == 0]
    n, m = model.poles.size, model.b.shape[1]
    theta = step.linear.coefficients
    fitted = replace(loop, c=step.linear.shapes, D=theta[2 * n : 2 * n + m].T, levels=theta[2 * n + m :])
    for i, error in zip(scored, step.block_errors(), strict=True):
        block = data.blocks[i]
        record, there = data.records[block.record], data.rows[block.record][block.first : block.last]
        missed = (record.outputs - loop_run(fitted, block.record, record.inputs))[block.first : block.last][there]
        np.testing.assert_allclose(error, np.square(missed).sum(axis=0), rtol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_gradient_is_that_of_the_projected_error(kind):
    rng, model, data = a_problem(2, kind, noise=0.2, missing=0.1, held_out=held_out_runs(kind))
    model = disturbed(rng, model, 0.02)
    weights = np.array([1.0, 3.0, 0.2])[: model.c.shape[0]]
    step = step_at(parameters_of(model), data, held_out=0, weights=np.diag(weights))
    found = step_equations(step, weights=np.diag(weights))
    arrays = arrays_of(data, 0)
    slopes = differences(lambda one: weights @ projected_errors(one, *arrays), model, free_places(model), step=3e-4)
    assert found.gradient.shape == slopes.shape
    np.testing.assert_allclose(found.gradient, -0.5 * slopes, rtol=0, atol=1e-6 * np.abs(slopes).max())


@pytest.mark.parametrize("kind", KINDS)
def test_normal_matrix_is_that_of_the_projected_jacobian(kind):
    rng, model, data = a_problem(3, kind, noise=0.2, missing=0.1, held_out=held_out_runs(kind))
    model = disturbed(rng, model, 0.02)
    weights = np.array([1.0, 3.0, 0.2])[: model.c.shape[0]]
    step = step_at(parameters_of(model), data, held_out=0, weights=np.diag(weights))
    found = step_equations(step, weights=np.diag(weights))
    inputs, _, rows = arrays_of(data, 0)
    model = replace(model, c=step.linear.shapes)
    phi = np.vstack([block[there] for block, there in zip(regressors(model, inputs), rows, strict=True)])
    projector = np.eye(phi.shape[0]) - phi @ np.linalg.pinv(phi)
    expected = 0.0
    for output, weight in enumerate(weights):
        slopes = np.vstack([jacobian(model, r, u, output)[rows[r]] for r, u in enumerate(inputs)])
        expected = expected + weight * slopes.T @ projector @ slopes
    np.testing.assert_allclose(found.matrix, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("kind", ["two inputs, two records, real pole", "close pair, three outputs"])
def test_outputs_count_where_each_was_measured(kind):
    """Error, shapes, blocks, gradient and normal matrix are sums over outputs, each with rows of its own."""
    rng, model, data = a_problem(6, kind, noise=0.2, missing=0.1, held_out=held_out_runs(kind))
    model, q = disturbed(rng, model, 0.02), model.c.shape[0]
    shares = np.array([0.9, 0.2, 0.2])[:q]  # few or many rows are missing; the last two are measured in the same
    seen = [np.repeat(rng.random((record.n_samples, 1)), q, axis=1) < shares for record in data.records]
    seen = [np.where(np.arange(q) == 0, rng.random((len(own), 1)) < 0.9, own) for own in seen]
    data, weights = replace(data, measured=tuple(seen)), np.array([1.0, 3.0, 0.2])[:q]
    step = step_at(parameters_of(model), data, held_out=0, weights=np.diag(weights))
    inputs, outputs, rows = arrays_of(data, 0)
    own = [[there & mask[:, o] for there, mask in zip(rows, seen, strict=True)] for o in range(q)]

    def errors(one):
        return np.array([projected_errors(one, inputs, outputs, own[o])[o] for o in range(q)])

    np.testing.assert_allclose(step.linear.squared_errors, errors(model), rtol=1e-9)
    assert step.error == pytest.approx(weights @ errors(model), rel=1e-9)
    found = step_equations(step, weights=np.diag(weights))
    slopes = differences(lambda one: weights @ errors(one), model, free_places(model), step=3e-4)
    np.testing.assert_allclose(found.gradient, -0.5 * slopes, rtol=0, atol=1e-6 * np.abs(slopes).max())
    fitted, expected = replace(model, c=step.linear.shapes), 0.0
    for o in range(q):
        phi = np.vstack([block[there] for block, there in zip(regressors(fitted, inputs), own[o], strict=True)])
        slopes = np.vstack([jacobian(fitted, r, u, o)[own[o][r]] for r, u in enumerate(inputs)])
        expected = expected + weights[o] * slopes.T @ (np.eye(len(phi)) - phi @ np.linalg.pinv(phi)) @ slopes
    np.testing.assert_allclose(found.matrix, expected, rtol=0, atol=1e-8 * np.abs(expected).max())
    theta, n, m = step.linear.coefficients, model.poles.size, model.b.shape[1]
    fitted = replace(fitted, D=theta[2 * n : 2 * n + m].T, levels=theta[2 * n + m :])
    scored = [i for i, block in enumerate(data.blocks) if block.label == 0]
    for i, error in zip(scored, step.block_errors(), strict=True):
        block = data.blocks[i]
        record, there = data.records[block.record], data.counted[block.record]
        missed = np.where(there, record.outputs - loop_run(fitted, block.record, record.inputs), 0.0)
        np.testing.assert_allclose(error, np.square(missed[block.first : block.last]).sum(axis=0), rtol=1e-8)


def free_places(model: LoopModel):
    """Places of the free parameters in the order of the sensitivities: real parts of all, then imaginary parts."""
    n, m = model.b.shape
    held = np.abs(model.b).argmax(axis=1)
    places = []
    for way in (1.0, 1j):
        chosen = [i for i in range(n) if way == 1.0 or model.is_pair[i]]
        places += [("poles", (i,), way) for i in chosen]
        places += [("b", (i, j), way) for j in range(m) for i in chosen if j != held[i]]
        places += [("starts", (r, i), way) for r in range(model.starts.shape[0]) for i in chosen]
    return places


def jacobian(model, r, inputs, output):
    """(n_samples, n_free) slopes of one output, shapes and levels held."""
    s = loop_sensitivities(model, r, inputs)
    m, columns = model.b.shape[1], []
    for field, where, way in free_places(model):
        pole = where[-1] if field == "starts" else where[0]
        place = {"poles": 0, "b": 1 + where[-1], "starts": 1 + m + where[0]}[field]
        factor = np.log(np.abs(model.poles[pole])) if (field, way) == ("poles", 1.0) else way
        columns.append((model.c[output, pole] * factor * s[:, place, pole]).real)
    return np.array(columns).T


def test_a_move_changes_each_parameter_by_what_it_says():
    rng, model, data = a_problem(4, "two inputs, two records, real pole", noise=0.1)
    step = step_at(parameters_of(model), data)
    chart, n_free = PolesAndParticipations(), step_equations(step, weights=np.eye(2)).gradient.size
    for i, place in enumerate(free_places(model)):
        expected = changed(model, place, 0.01)
        found = chart.moved(step.parameters, np.where(np.arange(n_free) == i, 0.01, 0.0))
        np.testing.assert_allclose(found.poles, expected.poles, rtol=1e-13)
        np.testing.assert_allclose(found.inputs, expected.b, rtol=1e-13)
        np.testing.assert_allclose(found.states, expected.starts, rtol=1e-13)
    for size in np.geomspace(0.1, 1e6, 50):
        wild = chart.moved(step.parameters, size * rng.standard_normal(n_free))
        assert np.all(np.abs(wild.poles) < 1)
        assert np.all(np.abs(wild.poles) > 0)
        assert np.all(wild.poles[model.is_pair].imag > 0)
        assert np.all(wild.poles[~model.is_pair].imag == 0)


# --- many steps ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("missing", [0.0, 0.15])
@pytest.mark.parametrize("kind", KINDS)
def test_noise_free_data_give_the_truth_back(kind, missing):
    rng, truth, data = a_problem(5, kind, missing=missing)
    steps = refine(step_at(parameters_of(disturbed(rng, truth, 0.02)), data), data, n_steps=40)
    last = steps[-1]
    power = sum(np.square(record.outputs).sum() for record in data.records)
    # the error is a difference of sums: rounding of 1e-16 of the power is 1e-8 of the amplitude
    assert last.error < 1e-13 * power
    np.testing.assert_allclose(last.parameters.poles, truth.poles, rtol=0, atol=1e-8)
    n, m = truth.b.shape
    found = replace(
        truth,
        poles=last.parameters.poles,
        b=last.parameters.inputs,
        c=last.linear.shapes,
        D=last.linear.coefficients[2 * n : 2 * n + m].T,
    )
    for k in range(60):
        np.testing.assert_allclose(pulse(found, k), pulse(truth, k), rtol=0, atol=5e-8)
    for r in range(truth.starts.shape[0]):
        # the initial state belongs to shapes that share a scale with b
        expected, got = truth.c * truth.starts[r], last.linear.shapes * last.parameters.states[r]
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-7)
        np.testing.assert_allclose(last.linear.coefficients[2 * n + m + r], truth.levels[r], rtol=0, atol=5e-8)


def pulse(model, k):
    if k == 0:
        return model.D
    return ((model.c * model.poles ** (k - 1)) @ model.b).real


@pytest.mark.parametrize("seed", range(3))
def test_the_end_is_that_of_a_general_least_squares_solver(seed):
    """Same minimum as scipy's `least_squares` in all parameters, started from the truth."""
    rng = np.random.default_rng(seed)
    truth = random_loop_model(rng, n_pairs=1, n_real=1, n_inputs=2, n_outputs=2)
    data = problem(rng, truth, (150,), noise=0.3)
    weights = np.array([1.0, 4.0])
    start = step_at(parameters_of(disturbed(rng, truth, 0.01)), data, weights=np.diag(weights))
    last = refine(start, data, n_steps=60, least_gain=1e-15, weights=np.diag(weights))[-1]
    places, (u,), (y,) = free_places(truth), *arrays_of(data)[:2]

    def residuals(values):
        model = truth
        for place, value in zip(places, values, strict=True):
            model = changed(model, place, value)
        (phi,) = regressors(model, [u])
        left = y - phi @ np.linalg.lstsq(phi, y, rcond=None)[0]
        return (left * np.sqrt(weights)).ravel()

    best = scipy.optimize.least_squares(residuals, np.zeros(len(places)), xtol=1e-12, ftol=1e-14, gtol=1e-12)
    np.testing.assert_allclose(last.error, 2 * best.cost, rtol=1e-8)
    poles = truth
    for place, value in zip(places, best.x, strict=True):
        poles = changed(poles, place, value)
    np.testing.assert_allclose(last.parameters.poles, poles.poles, rtol=0, atol=1e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_held_out_rows_do_not_count(kind):
    rng, model, data = a_problem(6, kind, noise=0.1, held_out=held_out_runs(kind))
    other = []
    for r, record in enumerate(data.records):
        outputs = record.outputs.copy()
        for block in data.blocks:
            if block.record == r and block.label == 0:
                outputs[block.first : block.last] += 100 * rng.standard_normal(outputs[block.first : block.last].shape)
        other.append(replace(record, outputs=outputs))
    start = parameters_of(disturbed(rng, model, 0.02))
    both = [data, replace(data, records=tuple(other))]
    first, second = (refine(step_at(start, one, held_out=0), one, held_out=0, n_steps=5)[-1] for one in both)
    np.testing.assert_array_equal(first.parameters.poles, second.parameters.poles)
    np.testing.assert_array_equal(first.linear.coefficients, second.linear.coefficients)
    assert first.error == second.error
    assert np.all(second.block_errors() > 10 * first.block_errors())
    # and without holding out they do
    third = refine(step_at(start, both[1]), both[1], n_steps=5)[-1]
    assert np.abs(third.parameters.poles - first.parameters.poles).max() > 1e-6


@pytest.mark.parametrize("seed", range(12))
def test_never_unstable_and_never_worse_whatever_the_data(seed):
    """Random starts; outputs that are noise, that grow, that ring without end, or that jump."""
    rng = np.random.default_rng(seed)
    n, n_records = 150, 1 + seed % 2
    start = random_loop_model(rng, n_pairs=3, n_real=1, n_inputs=2, n_outputs=2, n_records=n_records, decay=(1e-4, 1.0))
    k = np.arange(n)[:, np.newaxis]
    kinds = [
        rng.standard_normal((n, 2)),
        np.exp(0.02 * k) * np.sin(0.7 * k + np.arange(2)),
        np.sin(0.7 * k + np.arange(2)) + 0.1 * rng.standard_normal((n, 2)),
        np.cumsum(np.where(rng.random((n, 2)) < 0.02, 50.0, 0.0), axis=0),
    ]
    y = kinds[seed % 4]
    records = tuple(Record(rng.standard_normal((n, 2)), y + 0.01 * r, 0.1) for r in range(n_records))
    rows = tuple(np.ones(n, dtype=bool) for _ in records)
    data = OutputError(records=records, rows=rows, blocks=blocks_of(records, []))
    steps = refine(step_at(parameters_of(start), data), data, n_steps=25)
    assert len(steps) > 1
    for step in steps:
        assert np.all(np.abs(step.parameters.poles) < 1)
        assert np.all(np.isfinite(step.linear.coefficients))
    errors = [step.error for step in steps]
    assert np.all(np.diff(errors) < 0)


def test_no_step_is_made_where_none_helps():
    rng, model, data = a_problem(7, "one channel each", noise=0.1)
    done = refine(step_at(parameters_of(model), data), data, n_steps=60, least_gain=1e-13)
    again = refine(done[-1], data, n_steps=10)
    assert len(again) <= 2
    assert again[0].error == pytest.approx(done[-1].error, rel=1e-12)
    start = step_at(parameters_of(disturbed(rng, model, 0.05)), data)
    assert len(refine(start, data, n_steps=2)) == 3
    steps = refine(start, data, n_steps=30, least_gain=0.1)
    gains = [1 - later.error / earlier.error for earlier, later in pairwise(steps)]
    assert all(gain > 0.1 for gain in gains[:-1])
    assert gains[-1] <= 0.1


# --- what must not matter --------------------------------------------------------------------------------------------


def refined(model, data, weights=None):
    weights = None if weights is None else np.diag(weights)
    return refine(step_at(parameters_of(model), data, weights=weights), data, n_steps=40, weights=weights)[-1]


def test_exchanged_channels_and_records_exchange():
    rng, truth, data = a_problem(8, "two inputs, two records, real pole", noise=0.2)
    start = disturbed(rng, truth, 0.01)
    weights = np.array([1.0, 2.5])
    first = refined(start, data, weights)
    records = tuple(Record(r.inputs[:, ::-1], r.outputs[:, ::-1], r.dt) for r in data.records[::-1])
    turned = OutputError(records=records, rows=data.rows[::-1], blocks=blocks_of(records, []))
    start = replace(start, b=start.b[:, ::-1], starts=start.starts[::-1])
    second = refined(start, turned, weights[::-1])
    np.testing.assert_allclose(second.error, first.error, rtol=1e-8)
    np.testing.assert_allclose(second.parameters.poles, first.parameters.poles, rtol=1e-6)
    np.testing.assert_allclose(second.linear.shapes[::-1], first.linear.shapes, rtol=1e-5)
    np.testing.assert_allclose(second.parameters.inputs[:, ::-1], first.parameters.inputs, rtol=1e-5)
    np.testing.assert_allclose(second.parameters.states[::-1], first.parameters.states, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("size", [1e-6, 1e6])
def test_units_do_not_matter(size):
    rng, truth, data = a_problem(9, "two inputs, two records, real pole", noise=0.2)
    start = disturbed(rng, truth, 0.01)
    first = refined(start, data)
    inputs, outputs = np.array([1.0, size]), np.array([size, 1.0])
    records = tuple(Record(r.inputs * inputs, r.outputs * outputs, r.dt) for r in data.records)
    scaled = refined(replace(start, b=start.b / inputs), replace(data, records=records), 1 / outputs**2)
    np.testing.assert_allclose(scaled.error, first.error, rtol=1e-7)
    np.testing.assert_allclose(scaled.parameters.poles, first.parameters.poles, rtol=1e-5)


def test_steps_that_move_nothing_beyond_rounding_end_the_refinement(monkeypatch):
    """A filtered record of one slow pole left negative curvature only, and a least-squares solver that gave up."""
    rng = np.random.default_rng(2)
    model = random_loop_model(rng, n_pairs=1, n_real=0, n_inputs=1, n_outputs=1, n_records=1)
    data = problem(rng, model, [60], noise=0.1)
    start = step_at(parameters_of(model), data)
    normal = step_equations(start, weights=np.eye(1), coordinates=PolesAndParticipations())
    rounding = replace(normal, matrix=-np.abs(normal.matrix) * 1e-3)
    monkeypatch.setattr("modal.estimation.output_error.step_equations", lambda *_args, **_kwargs: rounding)
    assert len(refine(start, data, n_steps=5)) == 1
