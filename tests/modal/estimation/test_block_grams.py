"""Blocks of rows: their sums, and what the weight of a pair does to the fit."""

import numpy as np
import pytest
import scipy
from systems import modal_system, simulate

from modal.estimation.propagation import block_deviations, block_grams, coefficient_covariance
from okid.gram import lag_gram
from okid.least_squares import solve
from okid.record import Record
from okid.scaling import channel_scaling


def two_modes(seed):
    rng = np.random.default_rng(seed)
    sizes = {"n_inputs": 1, "n_outputs": 2, "mode_sizes": [1.0, 0.4]}
    return rng, modal_system(rng, frequencies=[11.0, 23.0], damping_ratios=[0.05, 0.04], **sizes)


def innovations_record(rng, system, n_samples, noise):
    """One record whose residuals an observer of ten lags whitens: the observer's poles lie within 0.4."""
    gain = scipy.signal.place_poles(system.A.T, system.C.T, 0.4 * np.linspace(-1, 1, system.order)).gain_matrix.T
    u = rng.standard_normal((n_samples, 1))
    e = noise * simulate(system, u).std(axis=0) * rng.standard_normal((n_samples, 2))
    return Record(u, simulate(system, u, process_noise=e @ gain.T) + e, system.dt)


def test_blocks_of_several_records_with_gaps_add_up_to_the_whole():
    rng = np.random.default_rng(0)
    records = []
    for n_samples in (400, 7, 90):
        y = rng.standard_normal((n_samples, 2))
        y[3:5, 1] = np.nan
        records.append(Record(rng.standard_normal((n_samples, 1)), y, 0.1))
    scaling = channel_scaling(records)
    parts = block_grams(records, 4, scaling=scaling, n_blocks=20)
    whole = lag_gram(records, 4, scaling=scaling)
    assert 19 <= len(parts) <= 22
    assert sum(part.n_rows for part in parts) == whole.n_rows
    total = np.sum([part.matrix for part in parts], axis=0)
    assert np.abs(total - whole.matrix).max() < 1e-10 * np.abs(whole.matrix).max()


@pytest.mark.parametrize("ridge", [0.0, 1e-2])
def test_a_deviation_of_two_blocks_is_the_derivative_of_the_fit_with_respect_to_its_weight(ridge):
    rng, system = two_modes(1)
    record = innovations_record(rng, system, 600, 0.1)
    scaling = channel_scaling([record])
    parts = block_grams([record], 5, scaling=scaling, n_blocks=20)
    deviations = block_deviations(parts, ridge)
    counts = np.array([part.n_rows for part in parts])
    unknowns = coefficient_covariance(lag_gram([record], 5, scaling=scaling), ridge).effective_unknowns
    correction = np.sqrt(0.5 * 20 / 18 * counts.sum() / (counts.sum() - unknowns))

    def solution(step):
        masks = np.zeros(record.n_samples, dtype=bool)
        masks[5 + counts[0] : 5 + counts[:3].sum()] = True  # the second and the third block
        heavier = lag_gram([record], 5, scaling=scaling, rows=[masks])
        whole = lag_gram([record], 5, scaling=scaling)
        weighed = type(whole)(
            matrix=whole.matrix + step * heavier.matrix, n_rows=whole.n_rows, order=5, n_inputs=1, n_outputs=2
        )
        # the penalty grows with the weight of the rows, as that of a fit to more rows does
        fit = solve(weighed, ridge * (1 + step * heavier.n_rows / whole.n_rows))
        rows = [fit.offset[np.newaxis], fit.feedthrough.T]
        for alpha, beta in zip(fit.input_coefficients, fit.output_coefficients, strict=True):
            rows += [alpha.T, beta.T]
        return np.vstack(rows)

    slope = (solution(1e-4) - solution(-1e-4)) / 2e-4
    assert deviations.shape[0] == 21
    assert np.abs(deviations[2] / correction - slope).max() < 1e-6 * np.abs(slope).max()
