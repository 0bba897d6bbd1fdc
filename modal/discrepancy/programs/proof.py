"""Prove what was found with the callable itself, on the records to fit and on the held-out ones."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from era.realisation import Realisation
from modal.discrepancy.fitting.estimation import Estimate
from modal.discrepancy.fitting.nodes import Node
from modal.discrepancy.programs.corrected import CorrectedCallable
from modal.discrepancy.programs.program import Simulator, run_callable
from modal.discrepancy.programs.residual_model import mean_squares, with_start
from modal.effects.effect import Effect, ForceEffect, SensorEffect
from modal.structure.given import Given, returned_model
from modal.structure.placed import PlacedEffect
from modal.structure.plant_model import PlantModel
from okid.arrays import FloatArray
from okid.errors import IdentificationError
from okid.record import Record

__all__ = ["Proof", "Runs", "prove", "unproved"]

AS_GOOD = 1.1
"""A simpler correction is preferred to one that leaves less than a tenth less on the records to fit."""


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
    """The callable as it was given.

    Args:
        runs: The callable and the records.
        realisation: Its linear part, by which the free motion that a record began with is fitted; None: none is.

    Returns:
        The same as for a corrected one.
    """
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

    Args:
        runs: The callable and the records.
        plant: Its linear part as it was identified.
        realisation: The same, discrete.
        node: The effects found in it, fitted.

    Returns:
        The proof.
    """
    proofs = [_proof(runs, plant, realisation, node, linear) for linear in _choices(runs, plant, node)]
    known = [proof for proof in proofs if proof is not None]
    if not known:
        return unproved(runs, realisation)
    enough = AS_GOOD * min(proof.fit_level for proof in known)
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
