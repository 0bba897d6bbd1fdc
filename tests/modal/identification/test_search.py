from dataclasses import replace

import numpy as np
import pytest
from signals import random_inputs, with_noise
from systems import initial_state, modal_system, simulate

import era
import modal
import okid
from modal.estimation.cross_validation import Trial
from modal.examples.demo import demo_record
from modal.identification.order_search import (
    ROUND_OFF,
    WITHIN,
    _chosen,
    _nothing_stable,
    _worth_trying,
    as_good,
    search,
    search_limits,
    untried_neighbours,
)
from okid.errors import InsufficientDataError, InvalidDataError
from okid.record import Record


def a_record(seed, n_samples=1000, *, noise=0.05, n_inputs=1, n_outputs=2):
    rng = np.random.default_rng(seed)
    system = modal_system(
        rng, frequencies=[5.0, 21.0], damping_ratios=[0.03, 0.02], n_inputs=n_inputs, n_outputs=n_outputs
    )
    inputs = random_inputs(rng, n_samples, n_inputs)
    outputs = simulate(system, inputs, initial_state=initial_state(rng, system, inputs))
    return Record(inputs, with_noise(rng, outputs, noise), system.dt).detrended()


def trial(error, *, model_order=4, observer_order=8, ridge=1e-3, block_errors=None):
    blocks = np.full(9, error**2 / 9) if block_errors is None else np.asarray(block_errors, float)
    return Trial(
        observer_order=observer_order,
        ridge=ridge,
        model_order=model_order,
        squared_errors=np.full((3, 1), error**2),
        block_errors=blocks,
        error=error,
    )


# --- the choice on data ----------------------------------------------------------------------------------------------


def test_noise_free_data_give_the_true_order_and_no_error():
    shares = []
    found = search([a_record(1, noise=0.0)], progress=shares.append)
    assert found.chosen.error < 1e-6
    assert found.chosen.model_order == 4
    assert found.chosen.ridge == 0.0
    assert shares == sorted(shares)
    assert shares[0] > 0.0
    assert shares[-1] == 1.0


def test_noisy_data_give_an_error_at_the_noise_and_a_ridge_or_order_between():
    record = a_record(2, noise=0.1)
    found = search([record], model_order=4)
    # fits cannot be better than the noise: its power is 0.01 / 1.01 of what was measured
    assert 0.09 < found.chosen.error < 0.12
    assert [t.error for t in found.trials] == sorted(t.error for t in found.trials)
    assert all(t.squared_errors.shape == (3, 2) and np.isfinite(t.squared_errors).all() for t in found.trials)


def test_what_the_caller_gives_is_kept():
    found = search([a_record(3)], observer_order=7, ridge=0.02, model_order=5)
    assert {(t.observer_order, t.ridge, t.model_order) for t in found.trials} == {(7, 0.02, 5)}
    found = search([a_record(3)], observer_order=7, model_order=4)
    assert {(t.observer_order, t.model_order) for t in found.trials} == {(7, 4)}
    assert len({t.ridge for t in found.trials}) > 1


def test_without_inputs_the_order_of_a_known_filter_is_found():
    rng = np.random.default_rng(4)
    noise, y = rng.standard_normal(3000), np.zeros(3000)
    for k in range(2, 3000):
        y[k] = 1.6 * y[k - 1] - 0.81 * y[k - 2] + noise[k]
    found = search([Record([], y, 0.1).detrended()])
    assert found.chosen.model_order == 2
    assert found.chosen.error == pytest.approx(noise.std() / y.std(), rel=0.03)


# --- the grid --------------------------------------------------------------------------------------------------------


def plain(n_samples, n_inputs=1, n_outputs=1):
    rng = np.random.default_rng(0)
    return Record(rng.standard_normal((n_samples, n_inputs)), rng.standard_normal((n_samples, n_outputs)), 0.1)


def limits_of(*records, **given):
    return search_limits(records, **{"observer_order": None, "ridge": None, "model_order": None, **given})


@pytest.mark.parametrize("n_samples", [40, 100, 700, 5000, 40000])
def test_observers_are_carried_by_the_record(n_samples):
    largest = max(limits_of(plain(n_samples)).observer_orders)
    assert largest <= 256
    assert 3 * 2 * largest <= n_samples  # three rows an unknown
    assert 4 * largest <= n_samples  # at most a quarter of the record is start
    assert largest >= min(256, n_samples // 6) / 1.4  # and not much less


def test_many_channels_get_a_gram_that_fits_a_cache():
    assert max(limits_of(plain(100_000, 4, 64)).observer_orders) * 68 <= 1600


def test_a_short_record_among_long_ones_does_not_limit_the_observer():
    alone = max(limits_of(plain(4000)).observer_orders)
    assert max(limits_of(plain(4000), plain(60)).observer_orders) >= 0.9 * alone
    assert max(limits_of(*[plain(60)] * 50).observer_orders) <= 15


def test_a_given_observer_order_needs_its_rows():
    assert limits_of(plain(100), observer_order=30).observer_orders == (30,)
    with pytest.raises(InsufficientDataError, match="observer order 60 needs"):
        limits_of(plain(100), observer_order=60)


def test_a_given_model_order_must_fit_the_hankel_matrix():
    with pytest.raises(InsufficientDataError, match=r"model order 1000 was asked for.*use order <= 200"):
        search([plain(500)], model_order=1000)


def growing(n_samples=400):
    rng = np.random.default_rng(5)
    u, y = rng.standard_normal(n_samples), np.zeros(n_samples)
    for k in range(2, n_samples):
        y[k] = 1.6 * y[k - 1] - 1.01 * y[k - 2] + u[k - 1]
    return Record(u, y, 0.1).detrended()


def test_nothing_stable_is_said():
    words = (
        r"no model from observer order 2, ridge 0, model order 2 was stable on every fold of the data; leave .* at "
        r'"auto", or add a ridge'
    )
    with pytest.raises(InsufficientDataError, match=words):
        search([growing()], observer_order=2, ridge=0.0, model_order=2)


def test_nothing_stable_of_all_is_said():
    everything = limits_of(plain(1000))
    assert _nothing_stable(everything) == (
        "no model from observer orders 1 to 128, any ridge, any model order was stable on every fold of the data; "
        "give a longer record."
    )


def test_neighbours_lie_around_the_best_and_are_not_tried_twice():
    limits = limits_of(plain(5000))
    around = untried_neighbours([trial(0.2, observer_order=16, ridge=1e-3), trial(0.3)], limits, {(16, 1e-3)}, 3.0)
    assert set(around) == {(p, r) for p in (11, 16, 22) for r in (3e-4, 1e-3, 3e-3)} - {(16, 1e-3)}
    # a grid that ends at the best one extends, but not beyond what the record carries
    edge = untried_neighbours([trial(0.2, observer_order=256, ridge=0.1)], limits, set(), 3.0)
    assert {p for p, _ in edge} == {183, 256}
    assert max(r for _, r in edge) == 0.3
    given = limits_of(plain(5000), observer_order=16, ridge=1e-3)
    assert untried_neighbours([trial(0.2, observer_order=16, ridge=1e-3)], given, {(16, 1e-3)}, 3.0) == []


@pytest.mark.parametrize(
    ("errors", "expected"),
    [
        ({2: 0.9, 4: 0.5, 6: 0.3, 8: 0.31, 12: 0.35}, [5, 7]),  # the best is 6; 4 and 8 frame it
        ({2: 0.9, 4: 0.32, 6: 0.3, 8: 0.31}, [3, 5, 7]),  # 4 comes near, so what lies below it may stand in for 6
        ({4: 0.5, 6: 0.4, 8: 0.3}, [7, 9, 10, 11, 12, 14]),  # the end of what was tried is not the end of the grid
        ({1: 0.30, 2: 0.31}, []),
        ({4: 1e-9, 6: 3e-9}, [1, 2, 3, 5]),  # exact data: all below round-off are equal
    ],
)
def test_model_orders_are_refined_where_models_come_near_the_best(errors, expected):
    trials = [trial(error, model_order=n) for n, error in errors.items()]
    assert [n for n in _worth_trying(trials, range(1, 16)) if n not in (13, 15)] == expected


# --- which trial is taken --------------------------------------------------------------------------------------------

EVEN = np.full(9, 0.01)


def worse(by, spread):
    """Block errors that are worse than `EVEN` by `by` in the sum, with a standard error of the sum `spread`."""
    pattern = np.array([1, -1, 1, -1, 0, 1, -1, 1, -1], float)
    return EVEN + by / 9 + pattern * spread / (3 * pattern.std(ddof=1))


@pytest.mark.parametrize(
    ("by", "spread", "ratio", "good"),
    [
        (0.0010, 0.0011, 1.0, True),  # within one standard error
        (0.0010, 0.0009, 1.0, False),  # beyond: the mode that was left out helps in every block
        (0.0010, 0.0011, WITHIN - 1e-4, True),
        (0.0010, 0.0011, WITHIN + 1e-4, False),  # within the error, but the fit would suffer
        (-0.0010, 0.0, WITHIN - 1e-4, True),
    ],
)
def test_a_smaller_model_stands_in_only_if_it_isas_good(by, spread, ratio, good):
    best = trial(0.3, model_order=8, block_errors=EVEN)
    smaller = trial(0.3 * ratio, model_order=4, block_errors=worse(by, spread))
    assert as_good(smaller, best) is good
    assert _chosen([best, smaller]) is (smaller if good else best)


def test_of_equal_orders_the_better_is_taken():
    trials = [trial(0.300, model_order=8), trial(0.3001, model_order=6, ridge=0.1), trial(0.3002, model_order=6)]
    noisy = [replace(t, block_errors=worse(0.0001 * i, 0.01 * i)) for i, t in enumerate(trials)]
    assert _chosen(noisy) is noisy[1]


def test_rounding_error_chooses_nothing():
    """Exact data: errors of 1e-9 and 3e-9 are the same."""
    exact = trial(1e-9, model_order=9)
    smaller = trial(3e-9, model_order=4)
    assert 9 * ROUND_OFF > 9e-18
    assert _chosen([exact, smaller]) is smaller
    assert _chosen([exact, trial(1e-6, model_order=4)]) is exact


# --- the public door -------------------------------------------------------------------------------------------------


def test_the_stages_with_the_chosen_orders_give_what_identify_gives_before_it_refines():
    """Mode 1 of the demo: 1.2 % damping by either road (true 1.22 %)."""
    record = demo_record(np.random.default_rng(7), n_samples=2000)
    result = modal.identify(record, refinement="none", decimation=1, integrators=0, input_delay=0, drift="none")
    choice = modal.choose_orders(record)
    observer = okid.fit_observer(record, order=choice.observer_order, ridge=choice.ridge)
    assert (observer.order, observer.ridge) == (result.observer.order, result.observer.ridge)
    model = era.realise(okid.recover_markov(observer, n_lags=choice.n_lags), order=choice.order)
    assert model.order == result.fitted_model.order
    found = {mode.frequency: mode.damping_ratio for mode in modal.extract_modes(model).modes}
    for mode in result.modes.modes:
        frequency = min(found, key=lambda own: abs(own - mode.frequency))
        assert frequency == pytest.approx(mode.frequency, rel=1e-7)
        assert found[frequency] == pytest.approx(mode.damping_ratio, rel=1e-5)


def test_given_orders_are_kept_and_checked():
    record = a_record(3)
    choice = modal.choose_orders(record, observer_order=7, ridge=0.02, order=5)
    assert (choice.observer_order, choice.ridge, choice.order) == (7, 0.02, 5)
    assert "observer_order=7, ridge=0.02" in repr(choice)
    for given in ({"observer_order": 0}, {"order": 1.5}, {"ridge": -1.0}, {"order": "all"}):
        with pytest.raises(InvalidDataError):
            modal.choose_orders(record, **given)
