"""Standard deviations against the Cramer-Rao bound, an explicit Jacobian of all parameters, and many realisations."""

from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from crb import cramer_rao_bound
from systems import initial_state, modal_system, simulate
from textbook_output_error import LoopModel, differences, loop_run, parameter_places

from era.realisation import Realisation
from modal.estimation.modal_parameters import errors_of
from modal.estimation.modal_states import Block
from modal.estimation.output_error import step_at
from modal.identification.covariance import chance_of_leaving, judged_deviations, output_error_uncertainty
from modal.identification.order_search import MOST_STEPS
from modal.identification.refined_search import RefinedModel, refined_model
from modal.modes.extraction import extract_modes
from okid.record import Record

N_LAGS = 6
N_REALISATIONS = 60


def truth_of(seed, *, real_poles=(), n_inputs=2, n_outputs=2):
    rng = np.random.default_rng(seed)
    return rng, modal_system(
        rng,
        frequencies=(6.0, 17.0),
        damping_ratios=(0.02, 0.03),
        real_poles=real_poles,
        n_inputs=n_inputs,
        n_outputs=n_outputs,
    )


def data_of(rng, truth, lengths):
    """Inputs, clean outputs and initial states of records."""
    inputs = [rng.standard_normal((n, truth.n_inputs)) for n in lengths]
    states = [initial_state(rng, truth, u) for u in inputs]
    return inputs, [simulate(truth, u, initial_state=x) for u, x in zip(inputs, states, strict=True)], states


def refined_of(truth, inputs, outputs) -> RefinedModel:
    records = [Record(u, y, truth.dt) for u, y in zip(inputs, outputs, strict=True)]
    model = refined_model(records, Realisation(truth.A, truth.B, truth.C, truth.D, truth.dt), MOST_STEPS)
    assert model is not None
    return model


def loop_model_of(model: RefinedModel) -> LoopModel:
    """The refined model as the loop has it, scaled channels."""
    step = model.step
    n, m = step.layout.n_poles, step.layout.n_inputs
    return LoopModel(
        poles=step.parameters.poles,
        is_pair=step.parameters.is_pair,
        b=step.parameters.inputs,
        starts=step.parameters.states,
        c=step.linear.shapes,
        D=step.linear.coefficients[2 * n : 2 * n + m].T,
        levels=step.linear.coefficients[2 * n + m :],
    )


def frequencies_and_damping(model: LoopModel, dt):
    s = np.log(model.poles.astype(complex)) / dt
    return np.concatenate([np.abs(s) / (2 * np.pi), -s.real / np.abs(s)])


def shapes_of(model: LoopModel, output_scale, largest):
    """Real and imaginary parts of shapes in units of the records, component `largest` of each mode 1."""
    c = model.c * output_scale[:, np.newaxis]
    shapes = (c / c[largest, np.arange(c.shape[1])]).T
    return np.stack([shapes.real, shapes.imag])


def pulses_of(model: LoopModel, scale):
    powers = [(model.c * model.poles**k) @ model.b for k in range(N_LAGS)]
    return np.array([model.D, *(power.real for power in powers)]) * scale


def block_owners(model: RefinedModel):
    """The block of each row of each record."""
    owners = [np.empty(record.n_samples, dtype=int) for record in model.data.records]
    for i, block in enumerate(model.data.blocks):
        owners[block.record][block.first : block.last] = i
    return owners


def by_explicit_jacobian(model: RefinedModel, variance):
    """Standard deviations from least squares in every parameter at once, and the delta method by differences.

    White noise of this variance on each output; without one, the scores of the model's blocks of rows.
    """
    loop, places = loop_model_of(model), parameter_places(loop_model_of(model))
    inputs, rows = [record.inputs for record in model.data.records], model.data.rows

    def run(one):
        return np.vstack([loop_run(one, r, u)[rows[r]] for r, u in enumerate(inputs)])

    J = differences(run, loop, places)  # (n_parameters, n_rows, n_outputs)
    weighted = J * np.diag(model.weights)
    bread = np.linalg.inv(np.einsum("ako,bko->ab", weighted, J))
    if variance is None:  # the scores of each block of rows
        error = np.vstack([record.outputs[there] for record, there in zip(model.data.records, rows, strict=True)])
        scores = (weighted * (error - run(loop))).sum(axis=2).T
        owner = np.concatenate([owners[there] for owners, there in zip(block_owners(model), rows, strict=True)])
        n_blocks = len(model.data.blocks)
        summed = np.array([scores[owner == block].sum(axis=0) for block in range(n_blocks)])
        meat = summed.T @ summed * n_blocks / (n_blocks - 1)
    else:
        meat = np.einsum("ako,bko->ab", weighted * variance, weighted)
    covariance = bread @ meat @ bread
    out, into = model.scaling.output_scale, model.scaling.input_scale
    largest = np.abs(loop.c * out[:, np.newaxis]).argmax(axis=0)

    def deviation(function):
        slopes = differences(function, loop, places)
        return np.sqrt(np.einsum("a...,ab,b...->...", slopes, covariance, slopes))

    of_poles = deviation(lambda one: frequencies_and_damping(one, model.realisation.dt))
    n = loop.poles.size
    shape = np.sqrt(np.square(deviation(lambda one: shapes_of(one, out, largest))).sum(axis=0))
    return of_poles[:n], of_poles[n:], shape, deviation(lambda one: pulses_of(one, out[:, np.newaxis] / into))


cases = pytest.mark.parametrize("case", ["two records", "real pole", "other weights", "missing rows"])


def refined_case(case, seed, lengths, *, noise, whiteness_ratio):
    """The truth of a case, a model refined on data with `noise(rng, clean)`, and its modes."""
    rng, truth = truth_of(seed, real_poles=(-8.0,) if case == "real pole" else ())
    inputs, clean, _ = data_of(rng, truth, lengths if case == "two records" else (250,))
    outputs = [y + y.std(axis=0) * noise(rng, y.shape) for y in clean]
    if case == "missing rows":
        outputs[0][100:130] = np.nan
    model = replace(refined_of(truth, inputs, outputs), whiteness_ratio=whiteness_ratio)
    if case == "other weights":
        model = replace(model, weights=np.diag([1.0, 5.0]))
    return truth, model, extract_modes(model.realisation).modes


@cases
def test_white_noise_gives_what_an_explicit_jacobian_of_all_parameters_gives(case):
    white = lambda rng, shape: np.array([0.02, 0.05]) * rng.standard_normal(shape)  # noqa: E731
    truth, model, modes = refined_case(case, 11, (150, 120), noise=white, whiteness_ratio=1.0)
    found = output_error_uncertainty(model, modes, n_lags=N_LAGS)
    n_rows = sum(int(rows.sum()) for rows in model.data.rows)
    loop = loop_model_of(model)
    fitted = len(parameter_places(loop)) / truth.n_outputs
    assert found.degrees_of_freedom == pytest.approx(n_rows - fitted, rel=0.01)
    variance = model.step.linear.squared_errors / found.degrees_of_freedom
    compare(found, modes, model, variance)


@cases
def test_blocks_give_what_the_scores_of_all_parameters_give(case):
    noise = lambda rng, shape: 0.05 * coloured(rng, shape)  # noqa: E731
    _, model, modes = refined_case(case, 14, (200, 120), noise=noise, whiteness_ratio=9.0)
    found = output_error_uncertainty(model, modes, n_lags=N_LAGS)
    assert found.degrees_of_freedom == len(model.data.blocks) - 1
    compare(found, modes, model, None)


def compare(found, modes, model: RefinedModel, variance):
    """Every standard deviation against the explicit Jacobian's."""
    loop = loop_model_of(model)
    frequency, damping, shape, pulses = by_explicit_jacobian(model, variance)
    poles = np.exp(np.array([mode.pole for mode in modes]) * model.realisation.dt)
    order = np.abs(poles[:, np.newaxis] - loop.poles).argmin(axis=1)
    is_pair = loop.is_pair[order]
    np.testing.assert_allclose(found.frequency_std, frequency[order], rtol=1e-5)
    np.testing.assert_allclose(found.damping_ratio_std[is_pair], damping[order][is_pair], rtol=1e-5)
    assert np.all(found.damping_ratio_std[~is_pair] == 0)
    np.testing.assert_allclose(found.shape_std, shape[order], rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(found.markov_std, pulses, rtol=1e-5)


def test_white_noise_gives_the_cramer_rao_bound():
    rng, truth = truth_of(12)
    inputs, clean, states = data_of(rng, truth, (3000,))
    noise = np.array([0.02, 0.1]) * clean[0].std(axis=0)
    model = refined_of(truth, inputs, [clean[0] + noise * rng.standard_normal(clean[0].shape)])
    assert model.leaves_white_noise
    found = output_error_uncertainty(model, extract_modes(model.realisation).modes, n_lags=N_LAGS)
    bound = cramer_rao_bound(truth, inputs[0], initial_state=states[0], noise_std=noise, level="unknown")
    # the noise's size is estimated, from 3000 samples to 1.3 %; the model itself is another 1 % off
    np.testing.assert_allclose(found.frequency_std, bound.frequency_std, rtol=0.06)
    np.testing.assert_allclose(found.damping_ratio_std, bound.damping_ratio_std, rtol=0.06)


def coloured(rng, shape):
    """Noise of unit standard deviation whose neighbours correlate by 0.9."""
    noise, now = np.empty(shape), rng.standard_normal(shape[1])
    for k in range(shape[0]):
        noise[k] = now
        now = 0.9 * now + np.sqrt(1 - 0.81) * rng.standard_normal(shape[1])
    return noise


def realisations(noise_of):
    """Deviations said and estimates made, of many realisations of the noise on one system with one input."""
    rng, truth = truth_of(13)
    inputs, clean, _ = data_of(rng, truth, (1200,))
    size = np.array([0.03, 0.1]) * clean[0].std(axis=0)
    said, white, made, largest = [], [], [], None
    for _ in range(N_REALISATIONS):
        model = refined_of(truth, inputs, [clean[0] + size * noise_of(rng, clean[0].shape)])
        modes = extract_modes(model.realisation).modes
        found = output_error_uncertainty(model, modes, n_lags=N_LAGS)
        said.append(_in_line(found))
        as_white = output_error_uncertainty(replace(model, whiteness_ratio=1.0), modes, n_lags=N_LAGS)
        white.append(_in_line(as_white))
        loop = loop_model_of(model)
        order = np.argsort(np.angle(loop.poles))
        loop = replace(loop, poles=loop.poles[order], c=loop.c[:, order], b=loop.b[order])
        out, into = model.scaling.output_scale, model.scaling.input_scale
        largest = np.abs(loop.c * out[:, np.newaxis]).argmax(axis=0) if largest is None else largest
        estimates = (
            frequencies_and_damping(loop, truth.dt),
            shapes_of(loop, out, largest),
            pulses_of(loop, out[:, np.newaxis] / into),
        )
        made.append([values.ravel() for values in estimates])
    spread = [np.std([one[i] for one in made], axis=0, ddof=1) for i in range(3)]
    spread[1] = np.linalg.norm(spread[1].reshape(2, -1), axis=0)
    means = [[np.sqrt(np.mean(np.square([one[i] for one in row]), axis=0)) for i in range(3)] for row in (said, white)]
    return [*means, spread]


def _in_line(found):
    poles = np.concatenate([found.frequency_std, found.damping_ratio_std])
    return poles, found.shape_std.ravel(), found.markov_std.ravel()


def ratios_of(said, spread):
    """Root mean square of said over made, all numbers of one kind together; a component held at 1 has neither."""
    kept = [(a[a > 0], b[a > 0]) for a, b in zip(said, spread, strict=True)]
    return np.array([np.sqrt(np.mean(np.square(a / b))) for a, b in kept])


def test_what_is_said_is_what_scatters_under_white_noise():
    said, _, spread = realisations(lambda rng, shape: rng.standard_normal(shape))
    ratios = ratios_of(said, spread)
    assert np.all((ratios > 0.8) & (ratios < 1.25)), ratios
    # each single one: 60 realisations give a standard deviation to 9 %
    assert np.all(np.abs(np.log(said[0] / spread[0])) < 0.35)


def test_blocks_say_what_scatters_under_coloured_noise_where_the_white_formula_is_wrong():
    said, white, spread = realisations(coloured)
    ratios = ratios_of(said, spread)
    assert np.all((ratios > 0.8) & (ratios < 1.25)), ratios
    # the noise has more than its mean power at 6 Hz and less at 17 Hz, which the white formula cannot know
    wrong = white[0] / spread[0]
    assert np.all(wrong[[0, 2]] < 0.9), wrong
    assert np.all(wrong[[1, 3]] > 1.4), wrong


def test_a_pole_that_dies_at_once_leaves_the_others_as_sure_as_they_were():
    """What it does is a hundred thousand million times smaller: rounding of the rest must not become its own."""
    turn = 0.999 * np.exp(0.3j)
    A = np.array([[turn.real, turn.imag], [-turn.imag, turn.real]])
    start = Realisation(A, np.array([[1.0], [0.3]]), np.array([[1.0, 0.5]]), np.zeros((1, 1)), 0.01)
    force = np.zeros((12_000, 1))
    force[100:104, 0] = (0.5, 1.0, 1.0, 0.5)
    noise = 0.01 * np.random.default_rng(0).standard_normal(force.shape)
    refined = refined_model([Record(force, simulate(start, force) + noise, 0.01)], start, 2, by="rows")
    assert refined is not None
    own = refined.step.parameters
    larger = replace(
        own,
        poles=np.append(own.poles, [0.5, -1e-11]),
        is_pair=np.append(own.is_pair, [False, False]),
        inputs=np.vstack([own.inputs, np.ones((2, 1))]),
        states=np.hstack([own.states, np.full((1, 2), 300.0)]),
    )
    modes = extract_modes(refined.realisation).modes
    alone = output_error_uncertainty(refined, modes, n_lags=N_LAGS)
    beside = output_error_uncertainty(replace(refined, step=step_at(larger, refined.data)), modes, n_lags=N_LAGS)
    np.testing.assert_allclose(beside.frequency_std, alone.frequency_std, rtol=0.02)
    np.testing.assert_allclose(beside.damping_ratio_std, alone.damping_ratio_std, rtol=0.02)


def test_what_is_struck_while_other_forces_shake_it_is_no_more_certain_than_it_is():
    """One blow: noise with the mode's own memory makes errors many times those under white noise."""
    turn = 0.98 * np.exp(0.3j)
    A = np.array([[turn.real, turn.imag], [-turn.imag, turn.real]])
    start = Realisation(A, np.array([[1.0], [0.3]]), np.array([[1.0, 0.5]]), np.zeros((1, 1)), 0.01)
    force = np.zeros((1500, 1))
    force[100:104, 0] = (0.5, 1.0, 1.0, 0.5)
    rng = np.random.default_rng(4)
    over = []
    for _ in range(15):
        shaken = simulate(start, 0.01 * rng.standard_normal(force.shape))
        model = refined_model([Record(force, simulate(start, force) + shaken, 0.01)], start, MOST_STEPS, by="rows")
        (mode,) = extract_modes(model.realisation).modes
        as_white = output_error_uncertainty(replace(model, whiteness_ratio=1.0), [mode], n_lags=1)
        known = output_error_uncertainty(model, [mode], n_lags=1)
        error = mode.frequency - np.angle(turn) / (2 * np.pi * 0.01)
        over.append([error / as_white.frequency_std[0], error / known.frequency_std[0]])
    white, ours = np.sqrt(np.mean(np.square(over), axis=0))
    assert white > 3.0
    assert ours < 0.5 * white


def test_noise_of_measured_forces_is_stated_as_it_scatters():
    """The model runs on forces with their sensors' noise, which every mode answers to as to a force of its own."""
    rng, truth = truth_of(15)
    (force,), (clean,), _ = data_of(rng, truth, (4000,))
    wanted = np.concatenate([truth.frequencies, truth.damping_ratios])
    z, as_white = [], []
    for _ in range(16):
        recorded = force + 0.1 * rng.standard_normal(force.shape)
        outputs = clean + 0.01 * clean.std(axis=0) * rng.standard_normal(clean.shape)
        model = refined_of(truth, [recorded], [outputs])
        modes = sorted(extract_modes(model.realisation).modes, key=lambda mode: mode.frequency)
        known, *_ = judged_deviations(model, modes, n_lags=1, fed_back=False)
        white = output_error_uncertainty(replace(model, whiteness_ratio=1.0), modes, n_lags=1)
        error = np.array([m.frequency for m in modes] + [m.damping_ratio for m in modes]) - wanted
        z.append(error / np.concatenate([known.frequency_std, known.damping_ratio_std]))
        as_white.append(error / np.concatenate([white.frequency_std, white.damping_ratio_std]))
    stated, simple = (np.sqrt(np.nanmean(np.square(one), axis=0)) for one in (z, as_white))
    assert np.isfinite(z).all(axis=1).mean() > 0.8
    assert 0.75 < np.sqrt(np.mean(stated**2)) < 1.25
    assert simple.max() > 2.0


def test_what_the_true_model_leaves_more_is_what_noise_of_any_colour_makes():
    """Hausman's test: the truth is refused in no record, one that is several deviations off in all."""
    chances, of_others = [], []
    for seed in range(12):
        rng, truth = truth_of(seed)
        inputs, clean, _ = data_of(rng, truth, (2000,))
        noise = coloured(rng, clean[0].shape)
        model = refined_of(truth, inputs, [clean[0] + noise])
        size = model.scaling.output_scale
        best = np.vstack(errors_of(model.step, model.data))
        weights = len(best) / np.square(best).sum(axis=0)
        ends = np.linspace(0, 2000, 11).astype(int)
        blocks = tuple(Block(record=0, first=a, last=b, label=-1) for a, b in pairwise(ends.tolist()))
        ask = partial(chance_of_leaving, model.step, replace(model.data, blocks=blocks), weights)
        more = float(weights @ (np.square(noise / size).sum(axis=0) - np.square(best).sum(axis=0)))
        assert more > 0.0
        chances.append(ask(more))
        late = np.vstack([clean[0][:1], clean[0][:-1]])  # answers a sample late
        other = clean[0] + noise - late
        of_others.append(ask(float(weights @ (np.square(other / size).sum(axis=0) - np.square(best).sum(axis=0)))))
    assert min(chances) > 1e-4
    assert 0.1 < np.median(chances) < 0.95
    assert max(of_others) < 1e-4
