"""Prove what was found with the callable itself, and model what it leaves.

The residual of a linear simulation that lacks linear dynamics is itself the output of a linear system with the same
inputs, so it is identified like any record, by OKID and ERA: a mode that it lacks shows without any catalogue. The
order is chosen on the records to fit, the proof is the free run on held-out ones.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from era.balanced import decompose, order_choice, realise_from
from era.realisation import Realisation
from era.simulation import estimate_initial_state, simulate
from modal.discrepancy.fitting.estimation import Estimate
from modal.discrepancy.fitting.nodes import SMALLEST_FALL, Node
from modal.discrepancy.programs.program import CorrectedCallable, Simulator, run_callable
from modal.effects.effect import Effect, ForceEffect, SensorEffect
from modal.identification.order_search import choose_orders
from modal.structure.given import Given, PlantModel, returned_model
from modal.structure.placed import PlacedEffect
from okid.arrays import TINY, FloatArray
from okid.errors import IdentificationError, quiet
from okid.markov import recover_markov
from okid.observer import fit_observer
from okid.record import Record


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
    if before <= 0.0 or after > (1.0 - SMALLEST_FALL) * before:
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
    with quiet():  # a residual may be narrow or near zero in a channel; the held-out run is the judge
        try:
            choice = choose_orders(fit)
            observer = fit_observer(fit, order=choice.observer_order, ridge=choice.ridge)
            found = decompose(recover_markov(observer, n_lags=choice.n_lags))
        except IdentificationError:
            return []
    highest = min(found.rank, found.max_order, 12)
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


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Runs:
    """A callable and the records.

    Attributes:
        simulator: The callable.
        fit: Records to fit.
        held_out: Held-out records.
        own: All of them, in this order, with the callable's outputs.
        floor: (n_records, n_outputs) noise variance, in this order.
        catalogue: The effects.
    """

    simulator: Simulator
    fit: tuple[Record, ...]
    held_out: tuple[Record, ...]
    own: tuple[Record, ...]
    floor: FloatArray
    catalogue: Mapping[str, Effect]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Proof:
    """A corrected callable along the records.

    Attributes:
        model: The callable.
        simulated: (n_samples, n_outputs) of each record, to fit and held out.
        simulated_held_out: Of the held-out ones.
        fit_level: Mean square of the residual on the records to fit, in units of the floor.
        held_out_level: Likewise on the held-out ones.
        rmse: (n_held_out, n_outputs).
    """

    model: CorrectedCallable
    simulated: tuple[FloatArray, ...]
    simulated_held_out: tuple[FloatArray, ...]
    fit_level: float
    held_out_level: float
    rmse: FloatArray

    @staticmethod
    def of(runs: Runs, model: CorrectedCallable, simulated: tuple[FloatArray, ...]) -> "Proof":
        """From the simulated outputs of all records."""
        n_fit = len(runs.fit)
        squares = mean_squares((*runs.fit, *runs.held_out), simulated)
        levels = squares / runs.floor
        return Proof(
            model=model,
            simulated=simulated,
            simulated_held_out=simulated[n_fit:],
            fit_level=float(np.nanmean(levels[:n_fit])),
            held_out_level=float(np.nanmean(levels[n_fit:])),
            rmse=np.sqrt(squares[n_fit:]),
        )


def unproved(runs: Runs, realisation: Realisation | None) -> Proof:
    """The callable as it was given, with the free motion of its linear part that each record began with."""
    records = (*runs.fit, *runs.held_out)
    simulated = tuple(
        with_start(realisation, record, run.outputs) for record, run in zip(records, runs.own, strict=True)
    )
    return Proof.of(runs, CorrectedCallable(runs.simulator, catalogue=runs.catalogue), simulated)


def prove(runs: Runs, plant: PlantModel, realisation: Realisation, node: Node) -> Proof:
    """Run the callable with what was found.

    Three corrections are tried where they make sense: the callable alone with changed inputs and outputs, with the
    forces in its linear part as it was identified, and with calibrated linear parameters too. The first that leaves
    hardly more on the records to fit than the best is taken.
    """
    proofs = [_proof(runs, plant, realisation, node, linear) for linear in _choices(runs, plant, node)]
    known = [proof for proof in proofs if proof is not None]
    if not known:
        return unproved(runs, realisation)
    enough = (1.0 + SMALLEST_FALL) * min(proof.fit_level for proof in known)
    return next(proof for proof in known if proof.fit_level <= enough)


def _choices(runs: Runs, plant: PlantModel, node: Node) -> list[FloatArray | None]:
    """Linear parameters of the correction, None for none, the simplest first."""
    calibrated = node.fitted.unknowns.common[: len(plant.linear)]
    choices: list[FloatArray | None] = []
    if not any(isinstance(runs.catalogue[key], ForceEffect) for key, _ in node.effects):
        choices.append(None)
    if node.effects:
        choices.append(plant.linear)
    return [*choices, calibrated]


def _proof(
    runs: Runs, plant: PlantModel, realisation: Realisation, node: Node, linear: FloatArray | None
) -> Proof | None:
    """None where the correction escapes, or the callable refuses the changed inputs."""
    n_fit = len(runs.fit)
    simulated = []
    try:
        for number, (record, run) in enumerate(zip((*runs.fit, *runs.held_out), runs.own, strict=True)):
            side, at = _side(node, number, n_fit, len(runs.held_out))
            model = _corrected(runs, plant, _placed(plant, side, at), linear)
            changed = model.changed_inputs(record)
            outputs = run.outputs if changed is record else run_callable(runs.simulator, changed).outputs
            simulated.append(with_start(realisation, record, model.completed(record, changed, outputs)))
    except IdentificationError:
        return None
    return Proof.of(runs, _corrected(runs, plant, _placed(plant, node.fitted, None), linear), tuple(simulated))


def _side(node: Node, number: int, n_fit: int, n_held_out: int) -> tuple[Estimate, int | None]:
    """The estimate that knows a record's own values, and where; none does where the search left records out."""
    held = node.held_out
    if number < n_fit:
        return node.fitted, number if node.fitted.trajectory.drive.n_records == n_fit else None
    if held is None or held.trajectory.drive.n_records != n_held_out:
        return node.fitted, None
    return held, number - n_fit


def _corrected(
    runs: Runs, plant: PlantModel, effects: tuple[PlacedEffect, ...], linear: FloatArray | None
) -> CorrectedCallable:
    inside = tuple(one for one in effects if not isinstance(runs.catalogue[one.effect], SensorEffect))
    return CorrectedCallable(
        runs.simulator,
        effects=effects,
        linear=plant,
        correction=None if linear is None else replace(plant, linear=linear, effects=inside),
        catalogue=runs.catalogue,
    )


def _placed(plant: PlantModel, fitted: Estimate, record: int | None) -> tuple[PlacedEffect, ...]:
    """The effects with their values; of one record, where a record has values of its own."""
    given = Given(model=plant, plant=plant.plant, linear=plant.linear, effects=())
    effects = returned_model(given, fitted.assembly, fitted.unknowns, np.full(fitted.assembly.n_common, np.nan)).effects
    if record is None:
        return tuple(effects)
    return tuple(
        replace(
            one,
            values=tuple(
                own[record] if own else value for value, own in zip(one.values, one.local_values, strict=True)
            ),
            local_values=((),) * len(one.values),
        )
        for one in effects
    )
