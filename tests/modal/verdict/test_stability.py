"""The diagram's points against extract_modes order by order, and its overlaps against sums over time."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from systems import markov, random_system
from textbook_modal import textbook_era

from era.realisation import HankelFactors, Realisation
from modal.modes.extraction import extract_modes
from modal.verdict.judgement import Rerun, Reruns
from modal.verdict.stabilisation import stabilisation
from okid.errors import InvalidDataError

HIGHEST = 30
N_STEPS = 80


def system_and_pulses(seed=3):
    rng = np.random.default_rng(seed)
    truth = random_system(rng, weak_mode=None)
    h = markov(truth, N_STEPS)
    return truth, h, rng


def balanced(h, order=HIGHEST, *, drive=(1.0, 1.0), units=(1.0, 1.0, 1.0)):
    """Textbook ERA; the channels of h are those of the scaled Hankel matrix."""
    full = textbook_era(h, 40, 40, order)
    drive, units = np.array(drive), np.array(units)
    factors = HankelFactors(
        observability=full.observability,
        controllability=full.controllability,
        n_block_rows=40,
        n_block_columns=40,
        input_scale=drive,
        output_scale=units,
        observer_order=None,
    )
    D = np.zeros((units.size, drive.size))
    return Realisation(full.A, full.B / drive, full.C * units[:, None], D, 0.01, factors=factors)


def noisy(h, rng, share=0.01):
    return h + share * h.std() * rng.standard_normal(h.shape)


@pytest.fixture(scope="module")
def case():
    """The truth, one model of 30 states from pulses with 1 % noise, and reruns on pulses with other noise."""
    truth, h, rng = system_and_pulses()
    model = balanced(noisy(h, rng))
    changes = ("data", "data", "observer", "higher order")
    runs = [
        Rerun(label=str(i), change=change, modes=extract_modes(balanced(noisy(h, rng, 0.014), 8)))
        for i, change in enumerate(changes)
    ]
    reruns = Reruns(runs=tuple(runs), n_steps=N_STEPS, output_scale=np.ones(3), input_scale=np.ones(2))
    return truth, model, reruns


def response(mode, n_steps, dt):
    """(n_steps, n_outputs, n_inputs) pulse response of one mode, sample by sample."""
    pole, residue = np.exp(mode.pole * dt), np.outer(mode.shape, mode.participation)
    is_pair = mode.pole.imag > 0 and mode.kind != "nyquist" and mode.pole.imag * dt < np.pi * (1 - 1e-9)
    result = np.empty((n_steps, *residue.shape))
    power = 1.0 + 0j
    for k in range(n_steps):
        result[k] = (2 if is_pair else 1) * (residue * power).real
        power = power * pole
    return result


def best_partners(first, second):
    """Overlap of each response with its partner, one to one, the greatest first, by search of the whole table."""
    table = np.array([[(a * b).sum() / max((a * a).sum(), (b * b).sum()) for b in second] for a in first])
    table = table.reshape(len(first), len(second))
    result = np.zeros(len(first))
    while table.size and table.max() > 0:
        i, j = np.unravel_index(np.argmax(table), table.shape)
        result[i] = table[i, j]
        table[i, :], table[:, j] = -1.0, -1.0
    return result


def test_every_pole_of_every_order_is_a_point(case):
    _, model, _ = case
    points = stabilisation(model)
    for order in range(1, HIGHEST + 1):
        modes = extract_modes(model.truncated(order))
        here = [point for point in points if point.order == order]
        for name in ("frequency", "damping_ratio", "emac"):
            np.testing.assert_allclose([getattr(p, name) for p in here], [getattr(m, name) for m in modes], rtol=1e-7)


def test_overlap_and_repeatability_are_sums_over_time(case):
    _, model, reruns = case
    points = stabilisation(model, reruns=reruns)
    runs = [[response(mode, N_STEPS, 0.01) for mode in run.modes] for run in reruns.runs[:3]]
    below = []
    for order in range(1, HIGHEST + 1, 1):
        here = [response(mode, N_STEPS, 0.01) for mode in extract_modes(model.truncated(order))]
        found = [point for point in points if point.order == order]
        np.testing.assert_allclose([point.overlap for point in found], best_partners(here, below), atol=1e-7)
        halves = (best_partners(here, runs[0]) + best_partners(here, runs[1])) / 2
        again = (halves + best_partners(here, runs[2])) / 2
        np.testing.assert_allclose([point.repeatability for point in found], again, atol=1e-7)
        below = here


def test_system_poles_stand_still_and_are_found_again_and_noise_poles_are_not(case):
    truth, model, reruns = case
    near, far = [], []
    for point in stabilisation(model, reruns=reruns):
        if point.order > truth.order + 1:
            distance = min(abs(point.frequency - truth.frequencies) / truth.frequencies)
            (near if distance < 1e-3 else far).append((point.overlap, point.repeatability))
    near, far = np.array(near), np.array(far)
    assert len(near) >= 3 * 20
    assert np.mean(near[:, 0] > 0.99) > 0.9
    assert np.mean(far[:, 0] > 0.99) < 0.2
    assert near[:, 1].min() > 0.9
    assert np.mean(far[:, 1] > 0.5) < 0.02


def test_only_some_orders_are_compared_with_the_next_lower_shown(case):
    _, model, _ = case
    points = stabilisation(model, orders=[12, 4, 4, 8])
    assert [point.order for point in points] == sorted(point.order for point in points)
    assert {point.order for point in points} == {4, 8, 12}
    assert all(point.overlap == 0 for point in points if point.order == 4)
    here = [response(mode, N_STEPS, 0.01) for mode in extract_modes(model.truncated(12))]
    below = [response(mode, N_STEPS, 0.01) for mode in extract_modes(model.truncated(8))]
    found = [point.overlap for point in points if point.order == 12]
    np.testing.assert_allclose(found, best_partners(here, below), atol=1e-7)


def test_repeatability_is_unknown_where_nobody_asked(case):
    _, model, reruns = case
    assert all(np.isnan(point.repeatability) for point in stabilisation(model, orders=[6]))
    other = Reruns(runs=reruns.runs[3:], n_steps=N_STEPS, output_scale=np.ones(3), input_scale=np.ones(2))
    assert all(np.isnan(point.repeatability) for point in stabilisation(model, orders=[6], reruns=other))


def test_a_rerun_that_found_nothing_counts_as_not_found(case):
    _, model, reruns = case
    nothing = Rerun(label="none", change="data", modes=extract_modes(model.truncated(0)))
    both = Reruns(runs=(nothing, reruns.runs[2]), n_steps=N_STEPS, output_scale=np.ones(3), input_scale=np.ones(2))
    alone = Reruns(runs=reruns.runs[2:3], n_steps=N_STEPS, output_scale=np.ones(3), input_scale=np.ones(2))
    half, whole = (stabilisation(model, orders=[6], reruns=runs) for runs in (both, alone))
    np.testing.assert_allclose([p.repeatability for p in half], [p.repeatability / 2 for p in whole], rtol=1e-12)


@settings(max_examples=10, deadline=None)
@given(st.lists(st.floats(1e-3, 1e3), min_size=5, max_size=5))
def test_the_unit_of_a_channel_does_not_matter(factors):
    _, h, rng = system_and_pulses()
    h, other = noisy(h, rng), noisy(h, rng)
    drive, units = factors[:2], factors[2:]
    found = []
    for into, out in (([1.0] * 2, [1.0] * 3), (drive, units)):
        run = Rerun(label="", change="data", modes=extract_modes(balanced(other, 6, drive=into, units=out)))
        reruns = Reruns(runs=(run,), n_steps=N_STEPS, output_scale=np.array(out), input_scale=np.array(into))
        points = stabilisation(balanced(h, 10, drive=into, units=out), reruns=reruns)
        found.append([(point.overlap, point.repeatability) for point in points])
    np.testing.assert_allclose(found[0], found[1], atol=1e-9)


def test_output_only_models_are_compared_by_their_free_responses(case):
    """Without inputs a rerun's modes have shapes but no participation; the model itself repeats fully."""
    truth = case[0]
    K = np.random.default_rng(1).standard_normal((truth.order, 3))
    model = Realisation(truth.A, np.zeros((truth.order, 0)), truth.C, np.zeros((3, 0)), truth.dt, K=K)
    run = Rerun(label="", change="data", modes=extract_modes(model))
    reruns = Reruns(runs=(run,), n_steps=N_STEPS, output_scale=np.array([2.0, 1.0, 0.1]), input_scale=np.zeros(0))
    points = stabilisation(model, reruns=reruns)
    assert len(points) == 3
    np.testing.assert_allclose([point.repeatability for point in points], 1.0, atol=1e-9)
    bare = Realisation(truth.A, np.zeros((truth.order, 0)), truth.C, np.zeros((3, 0)), truth.dt)
    assert [point.overlap for point in stabilisation(bare)] == [0.0] * 3


def test_a_model_that_holds_no_factors_shows_its_own_order_only(case):
    truth = case[0]
    model = Realisation(truth.A, truth.B, truth.C, truth.D, truth.dt)
    points = stabilisation(model)
    assert len(points) == 3
    assert all(np.isnan(point.emac) for point in points)
    with pytest.raises(InvalidDataError, match="only a balanced model can be truncated"):
        stabilisation(model, orders=[2, truth.order])


def test_orders_that_there_are_not_are_refused(case):
    _, model, _ = case
    with pytest.raises(InvalidDataError, match="can be truncated to orders 0 to 30, not to 31"):
        stabilisation(model, orders=[4, 31])
    with pytest.raises(InvalidDataError, match="an order of the diagram"):
        stabilisation(model, orders=[2.5])
    assert stabilisation(model, orders=[]) == () == stabilisation(model, orders=[0])
