"""Each stage of the workflow by itself, for those who want to look before they go on."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from modal.discrepancy.fitting.estimation import Estimate, Problem, covariance, estimate, simulate_at
from modal.discrepancy.fitting.nodes import Node, fitted_either_way, node_of, polished
from modal.discrepancy.fitting.observer_form import observer_gain
from modal.discrepancy.noise.floor import noise_floor
from modal.discrepancy.results import Calibrated
from modal.discrepancy.selection.decision import Decision, decide_nodes
from modal.discrepancy.selection.screening import Candidate, screen_candidates
from modal.discrepancy.setup import check_plant, check_records, prepare_setup, simulated_outputs
from modal.discrepancy.validation.summary import calibrated_parameters, with_findings
from modal.effects.catalogue import CATALOGUE, by_form
from modal.effects.effect import Effect
from modal.simulation.drive import drive_of, steps_per_sample
from modal.structure.checks import SensorKind
from modal.structure.given import Given, given_model, placed_assembly, returned_model
from okid.arrays import FloatArray
from okid.display import Displayed
from okid.errors import InvalidDataError, NumericalError
from okid.record import Record

__all__ = ["Fitted", "calibrate", "decide", "fit", "screen"]

Records = Record | Sequence[Record]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Fitted(Displayed):
    """A model fitted to records.

    Attributes:
        model: The model with fitted parameters.
        level: Mean square of the residual in units of the noise floor, over all records and outputs alike.
        mean_square: (n_records, n_outputs) the same, one by one.
        calibrated: The linear parameters.
        simulated: (n_samples, n_outputs) of each record.
    """

    model: Any
    level: float
    mean_square: FloatArray
    calibrated: tuple[Calibrated, ...]
    simulated: tuple[FloatArray, ...]


def fit(
    model: Any,
    records: Records,
    *,
    floor: FloatArray | None = None,
    sensor_kind: SensorKind | Sequence[SensorKind] | None = None,
    catalogue: Mapping[str, Effect] = CATALOGUE,
) -> Fitted:
    """Fit the linear parameters, the initial states and the parameters of the effects that a model has.

    Args:
        model: As for `diagnose`, but no callable.
        records: Records to fit.
        floor: (n_records, n_outputs) noise variance; estimated by default.
        sensor_kind: What the outputs of a state space are.
        catalogue: Where the model's effects are found.

    Returns:
        The fitted model.

    Raises:
        InvalidDataError: Model and records that do not match.
        NumericalError: A model that cannot be simulated along the records.

    Example:
        >>> from modal.structure.given import simulate
        >>> from modal.structure.structural_model import StructuralModel
        >>> truth = StructuralModel.chain([1.0], [100.0], [0.4], force_dofs=[0], sensor_dofs=[0])
        >>> push = np.random.default_rng(1).standard_normal((800, 1))
        >>> record = simulate(truth, push, dt=0.02)
        >>> guess = StructuralModel.chain([1.0], [104.0], [0.5], force_dofs=[0], sensor_dofs=[0])
        >>> fit(guess, record, floor=np.array([[1e-10]])).model.stiffness.round(3)
        array([[100.]])
    """
    chosen = (records,) if isinstance(records, Record) else tuple(records)
    given, found, problem = _estimated(model, chosen, floor, sensor_kind, catalogue)
    spread = covariance(found, problem)
    deviations = np.sqrt(np.maximum(np.diag(spread)[: found.assembly.n_common], 0.0))
    return Fitted(
        model=returned_model(given, found.assembly, found.unknowns, deviations),
        level=found.level,
        mean_square=found.mean_square,
        calibrated=calibrated_parameters(found, deviations),
        simulated=simulated_outputs(found, chosen),
    )


def calibrate(
    model: Any,
    records: Records,
    *,
    floor: FloatArray | None = None,
    sensor_kind: SensorKind | Sequence[SensorKind] | None = None,
) -> Fitted:
    """Fit the linear parameters and the initial states of a model, taken without its effects.

    Args:
        model: As for `diagnose`, but no callable.
        records: Records to fit.
        floor: (n_records, n_outputs) noise variance; estimated by default.
        sensor_kind: What the outputs of a state space are.

    Returns:
        The calibrated linear model.

    Raises:
        InvalidDataError: Model and records that do not match.
    """
    linear = replace(model, effects=()) if getattr(model, "effects", ()) else model
    return fit(linear, records, floor=floor, sensor_kind=sensor_kind)


def screen(
    model: Any,
    records: Records,
    *,
    catalogue: Mapping[str, Effect] = CATALOGUE,
    floor: FloatArray | None = None,
    sensor_kind: SensorKind | Sequence[SensorKind] | None = None,
) -> tuple[Candidate, ...]:
    """Score every effect at every place against what a model leaves after its own fit.

    Args:
        model: As for `diagnose`, but no callable.
        records: Records to fit.
        catalogue: The effects to score.
        floor: (n_records, n_outputs) noise variance; estimated by default.
        sensor_kind: What the outputs of a state space are.

    Returns:
        Candidates, best first: `key`, `where`, `fall` (share of what is left that a first step would take away).

    Raises:
        InvalidDataError: Model and records that do not match.
    """
    chosen = (records,) if isinstance(records, Record) else tuple(records)
    _, found, problem = _estimated(model, chosen, floor, sensor_kind, CATALOGUE)
    gain = observer_gain(found, problem)
    observed = simulate_at(
        found.assembly, found.unknowns, problem, states=found.trajectory.states, gain=gain, smoothing=found.smoothing
    )
    return screen_candidates(found if observed is None else observed, problem, by_form(catalogue)[0])


def decide(
    models: Sequence[Any],
    fit: Records,
    held_out: Records,
    *,
    sensor_kind: SensorKind | Sequence[SensorKind] | None = None,
    catalogue: Mapping[str, Effect] = CATALOGUE,
) -> Decision:
    """Choose among models with different effects by held-out records.

    A model whose linear part explains the data may come back with a gain that its free calibration has taken up, and a
    law with its twin in its place (cubic stiffness, sine softening), as from `diagnose`.

    Args:
        models: The model without further effects first, then others with some (`with_effect`); all of them are fitted.
        fit: Records to fit.
        held_out: Held-out records.
        sensor_kind: What the outputs of a state space are.
        catalogue: Where the models' effects are found.

    Returns:
        The decision: status, findings, the chosen model as a node, margins, reasons, what it leaves.

    Raises:
        InvalidDataError: No model, or models and records that do not match.
    """
    if not models:
        raise InvalidDataError("there is no model to decide on; pass the plain one first, then those with effects")
    fits, helds, _ = check_records(fit, held_out)
    nodes: list[Node] = []
    floor = noise_floor([*fits, *helds])
    for model in models:
        given = given_model(model, fits, sensor_kind=sensor_kind)
        setup = prepare_setup(given, fits, helds, catalogue, lambda *_: None, floor=floor)
        assembly, unknowns = placed_assembly(given.plant, given.linear, given.effects, setup.task.fit.drive, catalogue)
        start = simulate_at(assembly, unknowns, setup.task.fit)
        if start is None:
            raise NumericalError(f"{model!r} could not be simulated along the records to fit; check its effects")
        nodes.append(polished(node_of(estimate(start, setup.task.fit, iterations=12), setup.task), setup.task))
    # among the models given: none of unknown form beside them
    return with_findings(decide_nodes(nodes, replace(setup.task, form_free={}), setup.fit), nodes[0], setup)


def _estimated(
    model: Any,
    records: tuple[Record, ...],
    floor: FloatArray | None,
    sensor_kind: SensorKind | Sequence[SensorKind] | None,
    catalogue: Mapping[str, Effect],
) -> tuple[Given, Estimate, Problem]:
    given = given_model(model, records, sensor_kind=sensor_kind)
    check_plant(given.plant, given.linear, records)
    variance = noise_floor(records).variance if floor is None else floor
    drive = drive_of(records, steps_per_sample(given.plant, given.linear, records))
    problem = Problem(drive=drive, floor=variance)
    assembly, unknowns = placed_assembly(given.plant, given.linear, given.effects, drive, catalogue)
    start = simulate_at(assembly, unknowns, problem)
    if start is None:
        raise NumericalError(
            "the model could not be simulated along the records: its motion grows without bound; check the units of "
            "the inputs and the signs of its effects"
        )
    return given, fitted_either_way(start, problem, iterations=15), problem
