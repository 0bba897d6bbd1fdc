"""A first model of one level, whose modes are then followed to the others; and what is done to every model.

The smallest order that comes near the best one is taken: a nonlinear law is never fitted whole, and the states that a
larger order spends on it are no modes.
"""

from collections.abc import Sequence

import numpy as np

from era.balanced import decompose, realise_from
from era.realisation import Realisation
from modal.estimation.cross_validation import hankel_limits
from modal.estimation.free_run import free_runs, modal_form
from modal.estimation.output_error import SMALLEST_GAIN
from modal.identification.refined_model import RefinedModel, refined_model
from modal.identification.refined_search import MOST_STEPS
from modal.localisation.free_decay import decay_markov
from modal.preparation.filling import fill_where_needed
from modal.preparation.quick_model import observer_markov
from okid.arrays import FloatArray
from okid.markov import MarkovParameters
from okid.record import Record

__all__ = ["NEGLIGIBLE", "Start", "decay_start", "driven_start", "refined", "unexplained"]

ORDERS = (1, 2, 3, 4, 6, 8, 10, 12, 16, 20, 24)
WITHIN = 1.25
"""A smaller order stands in for one whose error is at most this much smaller: a nonlinear law is never fitted whole."""
NEGLIGIBLE = 1e-4
"""Error relative to the outputs that no measurement would show."""
DECAY_ORDERS = (1, 2, 3, 4, 6, 8, 10)
DECAY_WITHIN = 2.0
"""The same for windows of a free decay, through which a resonance sweeps."""

Start = tuple[float, Realisation | None]
"""Error of a first model relative to the outputs, and the model."""


def driven_start(records: Sequence[Record]) -> Start:
    """Of driven records: cut from a long observer, the smallest whose error is within a quarter of the least.

    The observer needs whole rows, so missing outputs are filled; all that is refined and judged later is measured
    samples only.

    Args:
        records: of one level.
    """
    markov = observer_markov(fill_where_needed(records).records)
    candidates = [] if markov is None else _candidates(markov, ORDERS)
    return _smallest([(_error(model, records), model) for model in candidates], WITHIN)


def decay_start(windows: Sequence[Record]) -> Start:
    """Of windows of free decays: cut from the outputs themselves and refined.

    Frequency and damping move within a window already, and ERA spreads that over all its states, so that candidates are
    compared after refinement.

    Args:
        windows: of one level.
    """
    candidates = _candidates(decay_markov(windows), DECAY_ORDERS)
    better = [refined(windows[:1], model) for model in candidates]
    models = [model if one is None else one.realisation for one, model in zip(better, candidates, strict=True)]
    return _smallest([(_error(model, windows[:1]), model) for model in models], DECAY_WITHIN)


def _candidates(markov: MarkovParameters, orders: Sequence[int]) -> list[Realisation]:
    """The stable ones of these orders."""
    decomposition = decompose(markov, max_order=min(max(orders), *hankel_limits(markov)))
    largest = min(decomposition.rank, decomposition.max_order)
    models = [realise_from(decomposition, order) for order in orders if order <= largest]
    return [model for model in models if modal_form(model) is not None]


def _smallest(tried: Sequence[tuple[float, Realisation]], within: float) -> Start:
    least = min((error for error, _ in tried), default=np.inf)
    limit = max(within * least, NEGLIGIBLE)
    return next(((error, model) for error, model in tried if error <= limit), (np.inf, None))


def _error(model: Realisation, records: Sequence[Record]) -> float:
    return float(np.sqrt(unexplained(model, records).mean()))


def refined(records: Sequence[Record], start: Realisation, *, least_gain: float = SMALLEST_GAIN) -> RefinedModel | None:
    """The model refined until it stands still; None where it is noise-free, unstable or does not see its modes.

    Args:
        records: of one level.
        start: the model to refine.
        least_gain: relative decrease of the error by a step below which it stands still.
    """
    # a part of a record may not show a mode at all: then its parameters have no curvature, and their step no end
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        try:
            return refined_model(records, start, MOST_STEPS, least_gain=least_gain)
        except np.linalg.LinAlgError:
            return None


def unexplained(model: Realisation, records: Sequence[Record]) -> FloatArray:
    """(n_outputs,) mean square of the free run's error over the variance of the outputs; infinite where it grows.

    Args:
        model: whose initial states are fitted.
        records: means removed.
    """
    form = modal_form(model)
    if form is None:
        return np.full(model.n_outputs, np.inf)
    runs = free_runs(form, records)
    errors = np.concatenate([record.outputs - run for record, run in zip(records, runs, strict=True)])
    outputs = np.concatenate([record.outputs for record in records])
    variance = np.nanmean(np.square(outputs), axis=0)
    result: FloatArray = np.nanmean(np.square(errors), axis=0) / np.where(variance > 0.0, variance, 1.0)
    return result
