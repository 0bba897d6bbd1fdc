"""The order choice on singular values and systems where the right answer is known."""

import numpy as np
import pytest
from systems import markov, modal_system

from era.balanced import decompose, order_choice
from era.hankel import choose_order
from okid.markov import MarkovParameters


def test_takes_the_largest_ratio():
    choice = choose_order(np.array([10.0, 9.0, 8.0, 7.0, 0.5, 0.4, 0.3]))
    assert choice.order == 4
    assert choice.ratio == pytest.approx(14.0)
    assert choice.sum_share == pytest.approx(34.0 / 35.2)
    assert choice.energy_share == pytest.approx(294.0 / 294.5)


def test_rounding_error_is_the_numerical_rank_not_a_gap_among_zeros():
    choice = choose_order(np.array([5.0, 4.0, 3.0, 1e-16, 1e-30, 0.0]))
    assert (choice.order, choice.rank) == (3, 3)
    assert "numerical rank" in choice.reason


def test_no_response_beyond_the_feedthrough_is_order_zero():
    choice = choose_order(np.zeros(4))
    assert choice.order == 0
    assert choice.energy_share == 1.0


def test_a_limit_holds():
    assert choose_order(np.array([9.0, 8.0, 7.0, 0.1, 0.09]), max_order=2).order <= 2


def test_energy_of_values_that_were_not_computed_counts():
    assert choose_order(np.array([2.0, 1.0, 0.1]), energy=10.0).energy_share == pytest.approx(0.5)


@pytest.mark.parametrize("n_real", [0, 1])
def test_noise_free_data_give_the_order_of_the_system(n_real):
    rng = np.random.default_rng(4)
    system = modal_system(
        rng, frequencies=[3.0, 3.3, 9.0], damping_ratios=[0.01, 0.02, 0.01], real_poles=[-8.0][:n_real]
    )
    parameters = MarkovParameters(system=markov(system, 80), dt=system.dt)
    for method in ("full", "randomised"):
        choice = order_choice(decompose(parameters, method=method))
        assert choice.order == 6 + n_real
        assert choice.energy_share == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_noisy_markov_parameters_give_the_order_of_the_system(seed):
    rng = np.random.default_rng(seed)
    system = modal_system(rng, frequencies=[2.0, 6.0, 14.0], damping_ratios=[0.02, 0.01, 0.01])
    h = markov(system, 200)
    h[1:] += 0.01 * h[1:].std() * rng.standard_normal(h[1:].shape)
    assert order_choice(decompose(MarkovParameters(system=h, dt=system.dt))).order == 6


def test_a_pair_is_kept_whole_where_the_gap_is_weak():
    turn = 0.95 * np.array([[np.cos(0.7), np.sin(0.7)], [-np.sin(0.7), np.cos(0.7)]])
    A = np.zeros((4, 4))
    A[:2, :2], A[2:, 2:] = turn, turn @ turn
    values = np.array([1.0, 0.9, 0.8, 0.5])
    assert choose_order(values, A=A).order == 4  # 0.8 / 0.5 is the largest ratio, but order 3 cuts the second pair
    assert choose_order(values).order == 3
    assert choose_order(np.array([1.0, 0.9, 0.8, 0.1]), A=A).order == 3  # a clear gap is believed


def test_the_reason_names_the_three_measures():
    reason = choose_order(np.array([3.0, 0.3, 0.1])).reason
    for part in ("order 1", "s1/s2 = 10", "88.2 % of their sum", "98.90 % of their energy"):
        assert part in reason


def test_the_last_values_of_a_noisy_matrix_are_no_gap():
    values = np.concatenate([[9.0, 8.0], np.linspace(1.0, 0.5, 20), [0.02]])
    assert choose_order(values, rank=values.size).order == 2
