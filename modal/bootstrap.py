"""Bootstrap of an identification: refit it with reweighted blocks of rows and see how far its modes move.

Gram matrices of disjoint rows add, so each contiguous block of rows gives one, and a replica is their sum with random
weights: nothing is read or simulated again. All blocks stay in every replica (Bayesian bootstrap: weights of a
Dirichlet distribution, mean 1), so that no replica has fewer rows than unknowns. Residuals may be coloured or of
changing size: nothing is assumed of them beyond blocks that are long against their memory and that of the modes.

References:
    Rubin, "The Bayesian bootstrap", The Annals of Statistics 9(1), 1981, 130-134, doi 10.1214/aos/1176345338.
    Kuensch, "The jackknife and the bootstrap for general stationary observations", The Annals of Statistics 17(3),
    1989, 1217-1241, doi 10.1214/aos/1176347265.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from era.balanced import realise_from
from era.decomposition import decompose
from era.realisation import Realisation
from modal.extraction import extract_modes
from modal.ground import hankel_limits, markov_lags
from modal.mode import Mode
from modal.overlap import overlap_matrix, pair_greatest_first, pulses
from modal.uncertainty import Uncertainty
from okid.arrays import ComplexArray, FloatArray
from okid.block_grams import FEWEST_BLOCKS, block_grams
from okid.coefficient_covariance import coefficient_covariance
from okid.errors import NumericalError
from okid.gram import LagGram, weighted_sum
from okid.markov import MarkovParameters
from okid.observer import observer_fit
from okid.record import Record
from okid.recovery import recover_markov
from okid.regression import solve
from okid.rows import as_records
from okid.scalars import whole_number
from okid.scaling import ChannelScaling, channel_scaling

__all__ = ["bootstrap"]

CONCENTRATION = 4.0
"""Of the Dirichlet weights: they scatter by half their mean, and the deviations are doubled. At 1 (Rubin) a replica is
worth half the rows, and where these hardly suffice the refit is no longer linear in the weights."""
FOUND = 0.1
"""Overlap with a replica's mode from which on it counts as found: an unrelated neighbour has less."""


def bootstrap(
    records: Record | Sequence[Record],
    *,
    modes: Sequence[Mode],
    observer_order: int,
    ridge: float,
    order: int,
    rng: np.random.Generator,
    n_replicas: int = 100,
    n_blocks: int = 2 * FEWEST_BLOCKS,
    n_lags: int | None = None,
) -> Uncertainty:
    """Standard deviations of modes and Markov parameters from refits with reweighted blocks.

    Args:
        records: as the model was identified from.
        modes: of the model, whose uncertainty is asked for.
        observer_order: of the model's observer.
        ridge: of the model's observer.
        order: of the model.
        rng: draws the weights.
        n_replicas: number of refits, at least 2.
        n_blocks: contiguous blocks over all records, at least 20. Few and long where residuals are coloured.
        n_lags: Markov parameters that are recovered and realised; as `modal.identify` unless given.

    Returns:
        `found` tells in what share of the replicas each mode was found; where it was not, or where the replica
        diverged, the replica counts for nothing else.

    Raises:
        InvalidDataError: fewer than 2 replicas or than 20 blocks.
        InsufficientDataError: fewer than two blocks have a row to fit.
        NumericalError: fewer than two replicas gave a model at all.

    Example:
        >>> from okid.observer import fit_observer
        >>> from era.balanced import realise
        >>> from modal.extraction import extract_modes
        >>> rng = np.random.default_rng(1)
        >>> force, tip = rng.standard_normal(2000), np.zeros(2000)
        >>> for k in range(2, 2000):
        ...     tip[k] = 1.6 * tip[k - 1] - 0.9 * tip[k - 2] + force[k - 1] + 0.1 * rng.standard_normal()
        >>> record = Record(force, tip, 0.01)
        >>> observer = fit_observer(record, order=2)
        >>> markov = recover_markov(observer)
        >>> model = realise(markov, order=2)
        >>> modes = extract_modes(model).modes
        >>> again = bootstrap(record, modes=modes, observer_order=2, ridge=0.0, order=2, rng=rng, n_replicas=20)
        >>> print(f"{modes[0].frequency:.2f} Hz, std {again.frequency_std[0]:.3f} Hz, found in {again.found[0]:.0%}")
        9.07 Hz, std 0.008 Hz, found in 100%
    """
    several = as_records(records)
    n_replicas = whole_number(n_replicas, name="n_replicas", least=2)
    n_blocks = whole_number(n_blocks, name="n_blocks", least=FEWEST_BLOCKS)
    lags = markov_lags(several[0].n_inputs, several[0].n_outputs) if n_lags is None else n_lags
    recipe = _Recipe(scaling=channel_scaling(several), dt=several[0].dt, ridge=ridge, order=order, n_lags=lags)
    parts = block_grams(several, observer_order, scaling=recipe.scaling, n_blocks=n_blocks)
    systems, found = [], []
    for _ in range(n_replicas):
        weights = rng.dirichlet(np.full(len(parts), CONCENTRATION))
        replica = _refitted(weighted_sum(parts, weights), recipe)
        if replica is not None:
            systems.append(replica[0].system)
            found.append(_found_again(modes, extract_modes(replica[1]).modes, recipe))
    if len(found) < 2:
        raise NumericalError(
            f"a bootstrap needs two replicas that give a model, but {len(found)} of {n_replicas} did: the others "
            "diverged; use a ridge (1e-3) or another observer order."
        )
    factor = _correction(parts, ridge)
    again = np.array(found)
    return Uncertainty(
        method="bootstrap",
        frequency_std=factor * _deviation(again[:, :, 0]),
        damping_ratio_std=factor * _deviation(again[:, :, 1]),
        shape_std=factor * _deviation(again[:, :, 2:]),
        markov_std=factor * _deviation(np.array(systems)),
        degrees_of_freedom=float(len(parts) - 1),
        found=np.isfinite(again[:, :, 0]).sum(axis=0) / n_replicas,
    )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Recipe:
    """How a model is made from a Gram matrix."""

    scaling: ChannelScaling
    dt: float
    ridge: float
    order: int
    n_lags: int


def _refitted(gram: LagGram, recipe: _Recipe) -> tuple[MarkovParameters, Realisation] | None:
    """Markov parameters and model of one replica; None where it diverges."""
    try:
        observer = observer_fit(solve(gram, recipe.ridge), recipe.scaling, recipe.dt)
        markov = recover_markov(observer, n_lags=recipe.n_lags)
    except NumericalError:
        return None
    found = decompose(markov, max_order=min(recipe.order, *hankel_limits(markov)))
    return markov, realise_from(found, min(recipe.order, found.rank, found.max_order))


def _found_again(modes: Sequence[Mode], replica: Sequence[Mode], recipe: _Recipe) -> ComplexArray:
    """(n_modes, 2 + n_outputs) frequency, damping ratio and shape of each mode in a replica; nan where missing."""
    scaling = recipe.scaling
    first, second = (
        pulses(some, dt=recipe.dt, output_scale=scaling.output_scale, input_scale=scaling.input_scale)
        for some in (modes, replica)
    )
    overlaps = overlap_matrix(first, second, n_steps=recipe.n_lags)
    overlaps[overlaps < FOUND] = 0.0
    again = np.full((len(modes), 2 + scaling.output_scale.size), np.nan, dtype=np.complex128)
    for place, partner in enumerate(pair_greatest_first(overlaps).tolist()):
        if partner >= 0:
            other = replica[partner]
            # a shape is compared at the component that is largest in the leader
            shape = other.shape / other.shape[np.abs(modes[place].shape).argmax()]
            again[place] = np.concatenate([[other.frequency, other.damping_ratio], shape])
    return again


def _correction(parts: Sequence[LagGram], ridge: float) -> float:
    """From the scatter of replicas to a standard deviation.

    The weights' own variance is (n - 1) / (concentration n + 1), and residuals are smaller than the noise by the share
    of the unknowns (as the correction HC1 of robust covariances has it).
    """
    n_parts, n_rows = len(parts), sum(part.n_rows for part in parts)
    weights = (n_parts - 1) / (CONCENTRATION * n_parts + 1)
    unknowns = coefficient_covariance(weighted_sum(parts, np.ones(n_parts)), ridge).effective_unknowns
    return float(np.sqrt(n_rows / max(n_rows - unknowns, 1.0) / weights))


def _deviation(values: ComplexArray | FloatArray) -> FloatArray:
    """Root mean square distance from the mean over the replicas (first axis), missing ones left out."""
    there = np.isfinite(values)
    count = there.sum(axis=0)
    total = np.where(there, values, 0.0)
    mean = total.sum(axis=0) / np.maximum(count, 1)
    squares = (np.abs(np.where(there, values - mean, 0.0)) ** 2).sum(axis=0)
    deviation: FloatArray = np.where(count > 1, np.sqrt(squares / np.maximum(count - 1, 1)), np.nan)
    return deviation
