"""A first model, good enough to judge the data by: one observer, one ridge, the order whose free run is nearest.

What is done to records before the search (filling gaps, taking off drift) is decided by what a model leaves of them.
This one costs a few hundredths of a second for each ten thousand samples; it is never the answer.
"""

from collections.abc import Sequence

import numpy as np

from era.balanced import decompose, realise_from
from era.initial_state import estimate_initial_state
from era.realisation import Realisation
from era.simulation import simulate_array
from modal.ground import LARGEST_PULSE, hankel_limits, markov_lags
from okid.arrays import FloatArray
from okid.gram import lag_gram
from okid.markov import MarkovParameters
from okid.record import Record
from okid.recovery import recover_system
from okid.regression import solve
from okid.scaling import channel_scaling

__all__ = ["best_model", "free_runs", "observer_markov", "quick_model"]

LONGEST_OBSERVER = 128
MOST_UNKNOWNS = 600
"""An output's equation has no more, so that many channels cost no more than few."""
ROWS_PER_UNKNOWN = 4
RIDGE = 1e-4
MODEL_ORDERS = (1, 2, 4, 6, 8, 12, 16, 24, 32, 40)
WITHIN = 1.02
"""A smaller model stands in for one whose error is at most this much smaller."""


def quick_model(records: Sequence[Record]) -> tuple[Realisation | None, float]:
    """The model, None where none is stable, and the root mean square of what its free run leaves.

    Args:
        records: of one system with inputs, none of them missing; channels of like size.

    Example:
        >>> force = np.random.default_rng(0).standard_normal(600)
        >>> model, error = quick_model([Record(force, np.convolve(force, [0.0, 1.0, 0.5])[:600], 0.01)])
        >>> error < 0.01
        True
    """
    markov = observer_markov(records)
    return (None, np.inf) if markov is None else best_model(markov, records)


def observer_markov(records: Sequence[Record]) -> MarkovParameters | None:
    """Markov parameters of one observer; None where they diverge or too few rows are whole."""
    n_channels = records[0].n_inputs + records[0].n_outputs
    n_samples = sum(record.n_samples for record in records)
    longest = max(record.n_samples for record in records)
    rows = n_samples // ROWS_PER_UNKNOWN
    order = max(1, min(LONGEST_OBSERVER, min(MOST_UNKNOWNS, rows) // n_channels, longest // 4))
    scaling = channel_scaling(records)
    if scaling.constant_inputs or scaling.constant_outputs:
        return None
    gram = lag_gram(records, order, scaling=scaling)
    if gram.n_rows <= gram.matrix.shape[0]:
        return None
    fit = solve(gram, RIDGE)
    n_lags = markov_lags(records[0].n_inputs, records[0].n_outputs)
    with np.errstate(over="ignore", invalid="ignore"):
        pulse = recover_system(fit.feedthrough, fit.input_coefficients, fit.output_coefficients, n_lags)
    if not np.abs(pulse).max() < LARGEST_PULSE:  # nan is not below either
        return None
    size = scaling.output_scale[:, np.newaxis] / scaling.input_scale
    return MarkovParameters(system=pulse * size, dt=records[0].dt)


def best_model(markov: MarkovParameters, records: Sequence[Record]) -> tuple[Realisation | None, float]:
    """The smallest stable model whose free run is within 2 % of the nearest to the measured samples; and its error.

    Args:
        markov: without gain.
        records: whose outputs are compared with the free run.
    """
    decomposition = decompose(markov, max_order=min(max(MODEL_ORDERS), *hankel_limits(markov)))
    tried: list[tuple[float, Realisation]] = []
    for order in MODEL_ORDERS:
        if order > min(decomposition.rank, decomposition.max_order):
            break
        model = realise_from(decomposition, order)
        if np.abs(np.linalg.eigvals(model.A)).max() < 1.0:
            tried.append((_distance(records, free_runs(model, records)), model))
    if not tried:
        return None, np.inf
    least = min(error for error, _ in tried)
    error, model = next((error, model) for error, model in tried if error <= WITHIN * least)
    return model, error


def free_runs(model: Realisation, records: Sequence[Record]) -> tuple[FloatArray, ...]:
    """(n_samples, n_outputs) a record: the inputs' response from the best initial state, at the best level."""
    runs = []
    for record in records:
        state = estimate_initial_state(model, record)
        run = np.array(simulate_array(model.A, model.B, model.C, model.D, record.inputs, initial_state=state))
        left = record.outputs - run
        there = ~np.isnan(left)
        level = np.where(there, left, 0.0).sum(axis=0) / np.maximum(there.sum(axis=0), 1)
        runs.append(run + level)
    return tuple(runs)


def _distance(records: Sequence[Record], runs: Sequence[FloatArray]) -> float:
    """Root mean square over the measured samples."""
    squares = [np.square(record.outputs - run) for record, run in zip(records, runs, strict=True)]
    measured = sum(int(np.isfinite(one).sum()) for one in squares)
    return float(np.sqrt(sum(float(np.nansum(one)) for one in squares) / max(1, measured)))
