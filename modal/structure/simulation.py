"""Simulate a model with its effects: the inputs of a record in, a record with simulated outputs out."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from modal.discrepancy.fitting.estimation import Problem, simulate_at
from modal.effects.catalogue import CATALOGUE
from modal.effects.effect import Effect
from modal.simulation.drive import drive_of
from modal.simulation.steps import steps_per_sample
from modal.structure.given import given_model, placed_assembly
from modal.structure.structural_model import SensorKind
from okid.arrays import FloatArray
from okid.errors import InvalidDataError, NumericalError
from okid.record import InputHold, Record

__all__ = ["simulate"]


def simulate(
    model: Any,
    record_or_inputs: Record | npt.ArrayLike,
    *,
    dt: float | None = None,
    input_hold: InputHold = "zero_order",
    initial_state: npt.ArrayLike | None = None,
    sensor_kind: SensorKind | Sequence[SensorKind] | None = None,
    catalogue: Mapping[str, Effect] = CATALOGUE,
) -> Record:
    """Simulate a model in free run.

    Args:
        model: `StructuralModel`, a model with effects, `control.StateSpace`, `era.Realisation`, or a callable that
            takes a Record and returns one.
        record_or_inputs: A record, whose inputs are used, or inputs (n_samples, n_inputs).
        dt: Sampling interval [s]; needed with plain inputs, taken from a record otherwise.
        input_hold: How plain inputs go on between samples; a record knows its own.
        initial_state: (n_states,) displacements then velocities of a structural model; at rest by default.
        sensor_kind: What the outputs of a state space are (it matters to effects only).
        catalogue: Where the model's effects are found.

    Returns:
        A record with the same inputs and simulated outputs.

    Raises:
        InvalidDataError: If the model and the inputs do not match.
        NumericalError: If the motion grows without bound or no simulation was found.

    Example:
        >>> import numpy as np
        >>> from modal.structure.structural_model import StructuralModel
        >>> model = StructuralModel.chain([1.0], [100.0], [0.4], force_dofs=[0], sensor_dofs=[0])
        >>> push = np.ones((4000, 1))
        >>> simulate(model, push, dt=0.01).outputs[-1].round(4)
        array([0.01])
        >>> stiffer = model.with_effect("cubic_stiffness", "element_0", k3=1e6)
        >>> simulate(stiffer, push, dt=0.01).outputs[-1].round(4)
        array([0.0068])
    """
    record = _record(record_or_inputs, dt, input_hold)
    if callable(model) and not hasattr(model, "A"):
        return _called(model, record)
    given = given_model(model, [record], sensor_kind=sensor_kind)
    plant = given.plant
    if record.n_inputs != plant.n_inputs:
        raise InvalidDataError(
            f"the model has {plant.n_inputs} inputs and the record has {record.n_inputs}; pass the same ones in the "
            f"same order ({', '.join(plant.input_names)})"
        )
    blank = replace(
        record,
        outputs=np.zeros((record.n_samples, plant.n_outputs)),
        output_names=plant.output_names,
        output_units=plant.output_units,
    )
    drive = drive_of([blank], steps_per_sample(plant, given.linear, [blank]))
    initial = None if initial_state is None else _state(initial_state, plant.n_states)[np.newaxis]
    assembly, unknowns = placed_assembly(plant, given.linear, given.effects, drive, catalogue, initial=initial)
    found = simulate_at(assembly, unknowns, Problem(drive=drive, floor=np.ones((1, plant.n_outputs))))
    if found is None or not np.isfinite(found.trajectory.outputs).all():
        raise NumericalError(
            "the model could not be simulated: its motion grows without bound under these inputs; lower the level, or "
            "check the signs of its effects"
        )
    return replace(blank, outputs=found.trajectory.outputs)


def _record(given: Record | npt.ArrayLike, dt: float | None, input_hold: InputHold) -> Record:
    if isinstance(given, Record):
        return given
    inputs = np.asarray(given, dtype=float)
    if dt is None:
        raise InvalidDataError("plain inputs need a time step; pass dt in seconds, or a Record")
    return Record(inputs, np.zeros((len(inputs), 1)), dt, input_hold=input_hold)


def _called(model: Any, record: Record) -> Record:
    found = model(record)
    if not isinstance(found, Record) or found.n_samples != record.n_samples:
        raise InvalidDataError(
            f"a callable model takes a Record and returns one of as many samples ({record.n_samples}); "
            f"it returned {type(found).__name__}"
        )
    return found


def _state(given: npt.ArrayLike, n_states: int) -> FloatArray:
    state = np.asarray(given, dtype=float).reshape(-1)
    if len(state) != n_states:
        raise InvalidDataError(f"the model has {n_states} states and {len(state)} initial values were given")
    return state
