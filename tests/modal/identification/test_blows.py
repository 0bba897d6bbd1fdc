"""A structure that is struck: what a blow does beside its samples, and what the sensor of its force errs by."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import scipy
from scipy.signal import lfilter
from systems import simulate, three_modes

from era.realisation import Realisation
from modal.identification.covariance import judged_deviations
from modal.identification.order_search import MOST_STEPS, search
from modal.identification.pipeline import identify
from modal.identification.refined_search import refined_model, refined_search
from modal.modes.extraction import extract_modes
from okid.record import Record


def exact(truth):
    return Realisation(truth.A, truth.B, truth.C, truth.D, truth.dt)


def struck(rng, truth, *, loud, n_records=4, n=1500, noise=0.01):
    """Blows of three rows, while which and two rows beyond the outputs err by `loud` beside the noise of sensors."""
    records, acting = [], []
    for _ in range(n_records):
        u = np.zeros((n, truth.n_inputs))
        first = int(rng.integers(40, 80))
        u[first : first + 3] = np.outer([0.5, 1.0, 0.4], rng.uniform(0.5, 1.5, truth.n_inputs))
        y = simulate(truth, u)
        y += noise * rng.standard_normal(y.shape)
        y[first - 2 : first + 5] += loud * rng.standard_normal((7, truth.n_outputs))
        records.append(Record(u, y, truth.dt))
        acting.append(u.any(axis=1))
    return records, acting


def errors_in_deviations(model, truth):
    modes = extract_modes(model.realisation).modes
    known, *_ = judged_deviations(model, modes, n_lags=1, fed_back=False)
    order = np.argsort([mode.frequency for mode in modes])
    own = np.array([[modes[k].frequency, modes[k].damping_ratio] for k in order])
    deviations = np.stack([known.frequency_std, known.damping_ratio_std], axis=1)[order]
    true = extract_modes(exact(truth)).modes
    return (own - sorted((mode.frequency, mode.damping_ratio) for mode in true)) / deviations, deviations


def test_what_a_blow_does_beyond_its_samples_moves_no_pole():
    """Errors that end with a blow leave poles to the free motion: as near, and as sure, as without them."""
    squares, wider, without = [], [], []
    for seed in range(4):
        rng, truth = three_modes(seed, n_inputs=1)
        records, acting = struck(rng, truth, loud=2.0)
        fit = partial(refined_model, records, exact(truth), MOST_STEPS, by="rows")
        apart, plain = fit(acting=acting), fit()
        assert 0.0 < apart.data.elsewhere < 1e-3
        # the rows beside the blow in which it errs as much are found
        assert all(own.any(axis=1).sum() <= 1500 - 7 for own in apart.data.measured)
        errors, deviations = errors_in_deviations(apart, truth)
        squares.append(errors**2)
        without.append(errors_in_deviations(plain, truth)[1] / deviations)
        quiet, _ = struck(np.random.default_rng(seed), truth, loud=0.0)
        wider.append(
            deviations / errors_in_deviations(refined_model(quiet, exact(truth), MOST_STEPS, by="rows"), truth)[1]
        )
        assert apart.leaves_white_noise
        told = np.sqrt(sum(float(np.square(one.inputs).sum()) for one in records))
        assert (np.abs(apart.realisation.D - truth.D) < 5.0 * 2.0 / told).all()
    assert np.mean(squares) == pytest.approx(1.0, abs=0.5)
    assert np.median(wider) < 1.2
    assert np.nanmedian(without) > 3.0


@pytest.mark.parametrize("n_rows", [3, pytest.param(20, marks=pytest.mark.slow)])
def test_errors_that_go_on_after_a_blow_are_not_put_apart(n_rows):
    """As of what is not linear; a blow may act for as long as the structure remembers it."""
    rng, truth = three_modes(3, n_inputs=1)
    records, acting = [], []
    for _ in range(4):
        u = np.zeros((1500, 1))
        u[60 : 60 + n_rows, 0] = np.sin(np.pi * (np.arange(n_rows) + 0.5) / n_rows)
        y = simulate(truth, u)
        size = np.where(np.arange(1500) < 60, 0.0, np.exp(-(np.arange(1500) - 60.0) / 100.0))
        y += (0.01 + 0.5 * size[:, np.newaxis]) * rng.standard_normal(y.shape)
        records.append(Record(u, y, truth.dt))
        acting.append(u[:, 0] != 0.0)
    assert not refined_model(records, exact(truth), MOST_STEPS, by="rows", acting=acting).data.measured


def test_a_record_with_loud_sensors_is_no_blow():
    """Noise of all rows of one record, ten times that of others, is no noise of those in which it is struck."""
    apart = 0
    for seed in range(20):
        rng, truth = three_modes(seed, n_inputs=1)
        records, acting = struck(rng, truth, loud=0.0)
        records[0] = replace(
            records[0], outputs=records[0].outputs + 0.1 * rng.standard_normal(records[0].outputs.shape)
        )
        apart += bool(refined_model(records, exact(truth), MOST_STEPS, by="rows", acting=acting).data.measured)
    assert apart <= 2


def test_feedthrough_is_as_sure_as_errors_of_blows_let_it_be():
    """By what a model leaves that these rows have not drawn: one that they have leaves the others loud, too."""
    rng, truth = three_modes(2, n_inputs=1)
    records, acting = struck(rng, truth, loud=2.0)
    data = refined_model(records, exact(truth), MOST_STEPS, by="rows", acting=acting).data
    assert 1.0 / np.sqrt(data.elsewhere) == pytest.approx(2.0 / 0.01, rel=0.3)


@pytest.mark.parametrize(("noise", "own_noise"), [(0.01, 0.01), (0.01, 1e-4)])
def test_what_a_sensor_of_force_errs_by_is_told_with_what_follows(noise, own_noise):
    """Each blow's answer is off by a little of its own: with the likeliest forces white noise of outputs is left.

    Where outputs are quiet what follows tells forces far better than their sensor, and deviations are those of what is
    left of its errors.
    """
    squares, ratios = [], []
    for seed in range(8 if own_noise == noise else 3):
        rng, truth = three_modes(seed, n_inputs=1)
        records, acting = struck(rng, truth, loud=0.0, noise=own_noise)
        erred = [noise * rng.standard_normal(one.inputs.shape) * (one.inputs != 0.0) for one in records]
        records = [replace(one, inputs=one.inputs + own) for one, own in zip(records, erred, strict=True)]
        fit = partial(refined_model, records, exact(truth), MOST_STEPS, by="rows", acting=acting)
        at_rest = np.full((4, 1), noise**2)
        told, plain = fit(at_rest=at_rest).told_at_rest(at_rest), fit()
        assert np.linalg.norm(np.array(told.forces_erred) - erred) < np.linalg.norm(erred)
        squares.append(errors_in_deviations(told, truth)[0] ** 2)
        ratios.append((told.whiteness_ratio, plain.whiteness_ratio))
    assert np.mean(squares) == pytest.approx(1.0, abs=0.5)
    (median, of_plain), (most, _) = np.median(ratios, axis=0), np.max(ratios, axis=0)
    assert median < 1.1
    assert most < 1.5
    assert of_plain > 3.0


def test_what_a_filter_rings_on_after_a_short_blow_is_of_the_blow():
    """It ends while the motion goes on, which what is not linear would follow; longer than the blow all the same."""
    found = []
    for seed in range(6):
        rng, truth = three_modes(seed, n_inputs=1)
        records, acting = struck(rng, truth, loud=2.0)
        for k, rows in enumerate(acting):
            last = int(np.flatnonzero(rows)[-1]) + 1
            moved = records[k].outputs.copy()
            size = 3.0 * np.exp(-np.arange(12) / 2.0)[:, np.newaxis]
            moved[last : last + 12] += size * rng.standard_normal((12, truth.n_outputs))
            records[k] = replace(records[k], outputs=moved)
        model = refined_model(records, exact(truth), MOST_STEPS, by="rows", acting=acting)
        found.append(bool(model.data.measured))
        assert not found[-1] or model.leaves_white_noise
        assert not found[-1] or max((~own[:, 0]).sum() for own in model.data.measured) < 60
    assert sum(found) >= 5


@pytest.mark.parametrize(("scatter", "wind"), [(0.0, 0.0), (0.05, 0.0), (0.0, 0.03)])
def test_blows_that_are_answered_each_in_its_own_way_are_told_from_noise_of_the_force(scatter, wind):
    """Struck a little beside the point each time: no sensor errs so. Wind moves it as far late as soon after."""
    said = 0
    for seed in range(1 if scatter else 3):
        rng = np.random.default_rng(seed)
        n, firsts = 1500, range(40, 1500, 300)
        force, moved = np.zeros(n), np.zeros((n, 2))
        poles = np.exp((-0.01 + 1j) * np.array([0.35, 0.8]))
        for first in firsts:
            blow = np.zeros(n)
            blow[first : first + 6] = rng.uniform(0.5, 1.5) * np.sin(np.pi * (np.arange(6) + 0.5) / 6) ** 2
            force += blow
            gains = 1.0 + scatter * rng.standard_normal(2)
            for pole, gain, shape in zip(poles, gains, ([1.0, 0.6], [0.7, -1.0]), strict=True):
                answer = lfilter([0.0, pole.imag], [1.0, -2.0 * pole.real, abs(pole) ** 2], blow)
                moved += gain * np.outer(answer, shape)
        for pole, shape in zip(poles, ([1.0, 0.6], [0.7, -1.0]), strict=True):
            blown = lfilter([0.0, pole.imag], [1.0, -2.0 * pole.real, abs(pole) ** 2], rng.standard_normal(n))
            moved += wind * np.outer(blown, shape)
        moved += 0.001 * moved.std(axis=0) * rng.standard_normal(moved.shape)
        record = Record(force[:, np.newaxis] + 0.003 * rng.standard_normal((n, 1)), moved, 0.005)
        result = identify(record, observer_order=100, ridge=1e-4, order=12 if scatter else 4)
        told = [words for words in result.warnings if words.startswith("Each blow is answered in its own way")]
        said += len(told)
        assert scatter or wind or not result.warnings
    assert said == (1 if scatter else 0)


def test_no_mode_follows_what_a_filter_rings_on():
    """Of short blows it lets through what no sample shows: modes about its corner explained that, some certain."""
    often, n, corner = 16, 4000, scipy.signal.butter(8, 0.8 / 16, output="sos")
    for seed in range(2):
        rng = np.random.default_rng(seed)
        force = np.zeros(n * often)
        for first in (3000, 30_000):
            length = int(rng.integers(40, 60))
            force[first : first + length] = np.sin(np.pi * np.arange(length) / length) ** 2
        pole = np.exp((-0.012 + 1j) * rng.uniform(0.9, 1.1) / often)
        moved = lfilter([1.0, -2.0, 1.0], [1.0, -2.0 * pole.real, abs(pole) ** 2], force)
        force, moved = (scipy.signal.sosfilt(corner, one)[::often, np.newaxis] for one in (force, moved))
        moved += 0.002 * moved.std() * rng.standard_normal(moved.shape)
        record = Record(force + 0.002 * force.max() * rng.standard_normal(force.shape), moved, 0.001)
        result = identify(record, observer_order=46, ridge=0.0)
        assert len(result.modes.system) == 1
        assert result.realisation.order <= 4


def test_no_mode_follows_what_a_sensor_of_force_erred_by():
    """Each blow's own answer looked like a mode or more, from which each held-out row gained."""
    orders = []
    for seed in range(2):
        rng = np.random.default_rng(seed)
        force = np.zeros((3000, 1))
        for first in range(40, 3000, 600):
            force[first : first + 6, 0] = rng.uniform(0.5, 1.5) * np.sin(np.pi * (np.arange(6) + 0.5) / 6) ** 2
        pole = np.exp((-0.01 + 1j) * rng.uniform(0.6, 0.9))
        moved = lfilter([1.0, -2.0, 1.0], [1.0, -2.0 * pole.real, abs(pole) ** 2], force, axis=0)
        moved += 0.002 * moved.max() * rng.standard_normal(moved.shape)
        record = Record(force + 0.005 * rng.standard_normal(force.shape), moved, 0.005)
        result = identify(record, observer_order=64, ridge=1e-4)
        assert [c.value for c in result.choices if c.what == "force while a blow acts"] == ["told with what follows"]
        orders.append(result.realisation.order)
    assert max(orders) <= 4


def test_a_force_that_what_follows_tells_worse_than_its_sensor_stays_as_it_was_measured():
    rng, truth = three_modes(4, n_inputs=1)
    records, acting = struck(rng, truth, loud=0.0)
    at_rest = np.full((4, 1), 1e-4**2)
    told = refined_model(records, exact(truth), MOST_STEPS, by="rows", acting=acting, at_rest=at_rest).forces_erred
    assert 0.0 < max(np.abs(own).max() for own in told) < 0.5e-4


def test_errors_of_force_larger_than_its_sensor_makes_are_of_something_else():
    """A structure that is not linear answers each blow as differently."""
    rng, truth = three_modes(3, n_inputs=1)
    records, acting = struck(rng, truth, loud=0.0)
    records = [
        replace(one, inputs=one.inputs * size) for one, size in zip(records, (0.97, 1.0, 1.0, 1.03), strict=True)
    ]
    for size, told in ((0.05, True), (0.002, False)):
        at_rest = np.full((4, 1), size**2)
        model = refined_model(records, exact(truth), MOST_STEPS, by="rows", acting=acting, at_rest=at_rest)
        assert bool(model.forces_erred) is told


def test_rows_beside_one_blow_are_told_however_many_outputs_there_are():
    """Two rows on either side tell sizes of three outputs."""
    for seed in range(4):
        rng, truth = three_modes(seed, n_inputs=1)
        records, acting = struck(rng, truth, loud=2.0, n_records=1)
        (there,) = refined_model(records, exact(truth), MOST_STEPS, by="rows", acting=acting).data.measured
        first = int(acting[0].argmax())
        assert not there[first - 2 : first + 5].any()


@pytest.mark.parametrize("seed", [2, 3])
def test_what_a_blow_does_beyond_its_samples_follows_no_input_in_coloured_noise_either(seed):
    """Neither are those rows asked, nor all others where one step ahead leaves colour, as if that were white."""
    rng = np.random.default_rng(seed)
    force, moved, firsts = np.zeros((3000, 1)), np.zeros((3000, 2)), range(40, 2500, 3000 // (1 + seed % 3))
    for first in firsts:
        force[first : first + 6, 0] = rng.uniform(0.5, 1.5) * np.sin(np.pi * (np.arange(6) + 0.5) / 6) ** 2
    for k in range(2):
        pole = np.exp((-0.01 + 1j) * rng.uniform(0.4, 0.7) * (1 + k))
        answer = lfilter([1.0, -2.0, 1.0], [1.0, -2.0 * pole.real, abs(pole) ** 2], force, axis=0)
        moved += answer * rng.uniform(-1.0, 1.0, 2)
    top = np.abs(moved).max()
    moved += 1e-3 * top * lfilter([1.0], [1.0, -0.9], rng.standard_normal(moved.shape), axis=0)
    for first in firsts:
        moved[first - 2 : first + 8] += 0.03 * top * rng.standard_normal((10, 2))
    record = Record(force + 1e-4 * rng.standard_normal(force.shape), moved, 0.005)
    result = identify(record, observer_order=32, ridge=3e-4, order=4)
    assert len(result.modes.system) == 2
    assert not [words for words in result.warnings if "follows the inputs" in words]


@pytest.mark.parametrize("colour", [0.0, 0.9])
def test_deviations_of_feedthrough_hold_the_errors_of_blows(colour):
    """Only while a blow acts do rows tell what it does at once, beside coloured noise of sensors, too."""
    squares = []
    for seed in range(5):
        rng, truth = three_modes(seed, n_inputs=1)
        records, acting = struck(rng, truth, loud=2.0)
        for i, one in enumerate(records):
            noise = lfilter([0.02], [1.0, -colour], rng.standard_normal(one.outputs.shape), axis=0)
            records[i] = replace(one, outputs=one.outputs + noise)
        model = refined_model(records, exact(truth), MOST_STEPS, by="rows", acting=acting)
        known, *_ = judged_deviations(model, extract_modes(model.realisation).modes, n_lags=1, fed_back=False)
        squares.append(np.square((model.realisation.D - truth.D) / known.markov_std[0]))
    assert np.mean(squares) == pytest.approx(1.0, abs=0.6)


def test_modes_grow_beyond_the_grid_of_orders(monkeypatch):
    monkeypatch.setattr("modal.identification.order_search.MODEL_ORDERS", (1, 2, 4))
    rng, truth = three_modes(5, n_inputs=1)
    records, acting = struck(rng, truth, loud=0.0)
    rest = [np.vstack([np.zeros((20, 4)), np.hstack([one.inputs, one.outputs])]) for one in records]
    records = [Record(one[:, :1], one[:, 1:], truth.dt) for one in rest]
    acting = [np.r_[np.zeros(20, dtype=bool), own] for own in acting]
    trials = refined_search(search(records, folds="rows"), acting=acting).trials
    grown = [trial for trial in trials if trial.weak_modes and trial.model_order == 2 * trial.weak_modes]
    assert min(grown, key=lambda trial: trial.error).model_order == 6
