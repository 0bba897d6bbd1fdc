"""A linear model of what a simulation leaves, by OKID and ERA: a mode that it lacks shows here without any catalogue.

The residual of a linear simulation that lacks linear dynamics is itself the output of a linear system with the same
inputs, so it is identified like any record. The order is chosen on the records to fit, the proof is the free run on
held-out ones.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from era.balanced import order_choice, realise_from
from era.decomposition import decompose
from era.initial_state import estimate_initial_state
from era.realisation import Realisation
from era.simulation import simulate
from modal.identification.order_search import choose_orders
from okid.arrays import TINY, FloatArray
from okid.errors import IdentificationError
from okid.observer import fit_observer
from okid.record import Record
from okid.recovery import recover_markov

__all__ = ["ResidualModel", "mean_squares", "residual_model", "with_start"]

MOST_STATES = 12
SMALLEST_SHARE = 0.1
"""Share of the held-out gap above the floor that a model must take away to be one."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ResidualModel:
    """A linear model of what is left.

    Attributes:
        realisation: From the inputs to the residual.
        share: Share of the held-out mean square above the floor that its free run takes away.
        frequencies: Of its oscillatory modes below the Nyquist frequency [Hz], rising.
        damping_ratios: Of the same.
    """

    realisation: Realisation
    share: float
    frequencies: tuple[float, ...]
    damping_ratios: tuple[float, ...]

    @property
    def words(self) -> str:
        """The result in one sentence."""
        modes = " and ".join(
            f"{frequency:.4g} Hz ({100.0 * ratio:.2g} % damping)"
            for frequency, ratio in zip(self.frequencies, self.damping_ratios, strict=True)
        )
        what = f"modes at {modes}" if modes else "no oscillatory mode"
        return (
            f"what is left follows the inputs linearly: a model of order {self.realisation.order} with {what} takes "
            f"away {100.0 * self.share:.0f} % of the held-out gap"
        )


def residual_model(
    fit: Sequence[Record], held_out: Sequence[Record], floor_fit: FloatArray, floor_held_out: FloatArray
) -> ResidualModel | None:
    """Identify what is left, and prove it.

    Args:
        fit: The records to fit with what is left as outputs.
        held_out: The held-out records likewise.
        floor_fit: (n_fit, n_outputs) noise variance.
        floor_held_out: (n_held_out, n_outputs) noise variance.

    Returns:
        The model; None where none takes away a tenth of the held-out gap.

    Example:
        >>> rng = np.random.default_rng(1)
        >>> def left(n_samples: int) -> Record:
        ...     u, y = rng.standard_normal(n_samples), np.zeros(n_samples)
        ...     for k in range(2, n_samples):
        ...         y[k] = 1.6 * y[k - 1] - 0.98 * y[k - 2] + u[k - 1]
        ...     return Record(u, y + 0.1 * rng.standard_normal(n_samples), 0.1)
        >>> found = residual_model([left(800)], [left(800)], np.array([[0.01]]), np.array([[0.01]]))
        >>> found.realisation.order, found.share > 0.99, np.round(found.frequencies, 1)
        (2, True, array([1.]))
    """
    if fit[0].n_inputs == 0:
        return None
    candidates = _candidates(fit)
    if not candidates:
        return None
    best = min(candidates, key=lambda model: _criterion(model, fit, floor_fit))
    before = _excess([record.outputs for record in held_out], floor_held_out)
    try:
        after = _excess([_missed(best, record) for record in held_out], floor_held_out)
    except IdentificationError:
        return None
    if before <= 0.0 or after > (1.0 - SMALLEST_SHARE) * before:
        return None
    poles = np.log(np.linalg.eigvals(best.A).astype(complex)) / best.dt
    modes = sorted((abs(pole), -pole.real / abs(pole)) for pole in poles if 0.0 < pole.imag < 0.99 * np.pi / best.dt)
    return ResidualModel(
        realisation=best,
        share=1.0 - after / before,
        frequencies=tuple(float(size / (2.0 * np.pi)) for size, _ in modes),
        damping_ratios=tuple(float(ratio) for _, ratio in modes),
    )


def with_start(realisation: Realisation | None, measured: Record, simulated: FloatArray) -> FloatArray:
    """A simulation from rest plus the free motion that the record began with, fitted to what is left.

    Args:
        realisation: Linear part of what was simulated; None: nothing is added.
        measured: The record.
        simulated: (n_samples, n_outputs) from rest.

    Returns:
        (n_samples, n_outputs).
    """
    if realisation is None or realisation.order == 0:
        return simulated
    still = replace(measured, inputs=np.zeros_like(measured.inputs), outputs=measured.outputs - simulated)
    state = estimate_initial_state(realisation, still)
    return simulated + simulate(realisation, still, initial_state=state).outputs


def mean_squares(records: Sequence[Record], simulated: Sequence[FloatArray]) -> FloatArray:
    """(n_records, n_outputs) mean square of measured minus simulated."""
    return np.array(
        [np.nanmean((record.outputs - one) ** 2, axis=0) for record, one in zip(records, simulated, strict=True)]
    )


def _candidates(fit: Sequence[Record]) -> list[Realisation]:
    with warnings.catch_warnings():
        # a residual may be narrow or near zero in a channel; the held-out run is the judge
        warnings.simplefilter("ignore")
        try:
            choice = choose_orders(fit)
            observer = fit_observer(fit, order=choice.observer_order, ridge=choice.ridge)
            found = decompose(recover_markov(observer, n_lags=choice.n_lags))
        except IdentificationError:
            return []
    highest = min(found.rank, found.max_order, MOST_STATES)
    orders = {min(order_choice(found).order, highest), *range(1, highest + 1)}
    models = [realise_from(found, order) for order in sorted(orders)]
    return [model for model in models if np.abs(np.linalg.eigvals(model.A)).max(initial=0.0) < 1.0]


def _criterion(model: Realisation, fit: Sequence[Record], floor: FloatArray) -> float:
    """Bayesian information criterion of the free run."""
    values = [~np.isnan(record.outputs) for record in fit]
    count = float(sum(one.sum() for one in values))
    try:
        squares = sum(
            float(np.nansum(_missed(model, record) ** 2 / variance))
            for record, variance in zip(fit, floor, strict=True)
        )
    except IdentificationError:
        return np.inf
    n_unknowns = model.order * (model.n_inputs + model.n_outputs) + model.n_inputs * model.n_outputs
    return count * float(np.log(max(squares, TINY))) + n_unknowns * float(np.log(count))


def _missed(model: Realisation, record: Record) -> FloatArray:
    return record.outputs - simulate(model, record).outputs


def _excess(left: Sequence[FloatArray], floor: FloatArray) -> float:
    """Mean square above the floor, in units of it, summed over records and outputs."""
    return float(
        sum(
            np.maximum(np.nanmean(one**2, axis=0) / variance - 1.0, 0.0).sum()
            for one, variance in zip(left, floor, strict=True)
        )
    )
