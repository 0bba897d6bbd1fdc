"""Find what a simulation lacks against measured records: floor, calibration, location, search, decision, in one call."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from modal.discrepancy.advice import advise, circumstances_of
from modal.discrepancy.catalogue import CATALOGUE
from modal.discrepancy.checks import check_plant, check_records
from modal.discrepancy.decision import Decision, decide_nodes
from modal.discrepancy.diagnosis import Diagnosis, Step
from modal.discrepancy.drive import drive_of
from modal.discrepancy.effects.effect import Effect
from modal.discrepancy.estimation import Estimate, Problem, covariance, estimate, simulate_at
from modal.discrepancy.findings import findings_of, hypothesis_of
from modal.discrepancy.gap import measure_gap
from modal.discrepancy.given import Given, given_model, placed_assembly, returned_model
from modal.discrepancy.law import law_curves
from modal.discrepancy.limits import detection_limits
from modal.discrepancy.locate import Location, locate
from modal.discrepancy.noise_floor import NoiseFloor, lowered_floor, noise_floor
from modal.discrepancy.search import FINER, Node, Task, calibrated_node, node_of, on_other_floor, search
from modal.discrepancy.stages import calibrated_parameters
from modal.discrepancy.steps import steps_per_sample
from modal.structure import SensorKind
from okid.arrays import FloatArray
from okid.errors import NumericalError
from okid.record import Record

__all__ = ["Progress", "diagnose"]

Progress = Callable[[str, float], None]
"""Called with what is being done and the share that is done (0 to 1)."""


def _silent(what: str, share: float) -> None:
    del what, share


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Setup:
    """Everything that the stages work on.

    Attributes:
        given: The model.
        fit: Records to fit.
        held_out: Held-out records.
        floor: Noise floor of both, in this order.
        task: The search's task.
    """

    given: Given
    fit: tuple[Record, ...]
    held_out: tuple[Record, ...]
    floor: NoiseFloor
    task: Task


def diagnose(
    model: Any,
    fit: Record | Sequence[Record],
    held_out: Record | Sequence[Record],
    *,
    catalogue: Mapping[str, Effect] = CATALOGUE,
    sensor_kind: SensorKind | Sequence[SensorKind] | None = None,
    progress: Progress | None = None,
) -> Diagnosis:
    """Find where a simulation and measured records disagree, name the missing effect, and add it to the model.

    Deterministic: the same model and records give the same diagnosis.

    Args:
        model: `modal.StructuralModel`, `control.StateSpace`, `era.Realisation`, a model that an earlier diagnosis
            returned, or a callable that takes a Record and returns one with simulated outputs.
        fit: Records to fit, of several levels if there are any.
        held_out: Records to prove it on: another realisation, best at another level too.
        catalogue: The effects to try; `register` adds one of your own.
        sensor_kind: What the outputs of a state space are ("displacement", "velocity", "acceleration", one word or one
            an output); by default from the units of the records' outputs, "displacement" where they say nothing.
        progress: Called with a sentence and the share that is done.

    Returns:
        What is missing, where, how sure that is, and the updated model.

    Raises:
        InvalidDataError: Model and records that do not match, no held-out record, an unstable model.
        InsufficientDataError: Records too short for the model.
        NumericalError: The model cannot be simulated along the records.

    References:
        Kerschen, Worden, Vakakis, Golinval, Past, present and future of nonlinear system identification in structural
        dynamics, Mech. Syst. Signal Process. 20, 2006, https://doi.org/10.1016/j.ymssp.2005.04.008; Noel, Kerschen,
        Nonlinear system identification in structural dynamics: 10 more years of progress, Mech. Syst. Signal Process.
        83, 2017, https://doi.org/10.1016/j.ymssp.2016.07.020
    """
    report = _silent if progress is None else progress
    fits, helds, notes = check_records(fit, held_out)
    if callable(model) and not hasattr(model, "A"):
        from modal.discrepancy.black_box import diagnose_callable

        return diagnose_callable(
            model, fits, helds, catalogue=catalogue, sensor_kind=sensor_kind, progress=report, notes=notes
        )
    setup = prepare_setup(given_model(model, fits, sensor_kind=sensor_kind), fits, helds, catalogue, report)
    as_given, root = roots(setup)
    location = locate_gap(setup, root)
    nodes = search(root, setup.task)
    setup, nodes, as_given = uncovered(setup, nodes, as_given)
    report("deciding", 0.9)
    circumstances = circumstances_of(setup.given.plant, fits, root)
    decision = decide_nodes(nodes, setup.task, circumstances=circumstances)
    return _diagnosis(setup, as_given, nodes, decision, location, circumstances, notes)


def prepare_setup(
    given: Given,
    fit: tuple[Record, ...],
    held_out: tuple[Record, ...],
    catalogue: Mapping[str, Effect],
    report: Progress,
    floor: NoiseFloor | None = None,
) -> Setup:
    """Noise floor and drives."""
    check_plant(given.plant, given.linear, [*fit, *held_out])
    report("noise floor", 0.0)
    known = noise_floor([*fit, *held_out]) if floor is None else floor
    steps = steps_per_sample(given.plant, given.linear, [*fit, *held_out])
    drive = drive_of(fit, steps)
    n_fit = len(fit)

    def held(upsampling: int) -> Problem:
        return Problem(
            drive=drive_of(held_out, upsampling, reference=drive.reference),
            floor=known.variance[n_fit:],
            free_common=False,
        )

    task = Task(
        fit=Problem(drive=drive, floor=known.variance[:n_fit]),
        held_out=held(steps),
        fine_fit=Problem(drive=drive_of(fit, FINER * steps), floor=known.variance[:n_fit]),
        fine_held_out=held(FINER * steps),
        upsampling=steps,
        catalogue=catalogue,
        report=report,
    )
    return Setup(given=given, fit=fit, held_out=held_out, floor=known, task=task)


def uncovered(setup: Setup, nodes: tuple[Node, ...], as_given: Node) -> tuple[Setup, tuple[Node, ...], Node]:
    """The floor, lower where the best model's residual shows less noise than the records did; then the search goes on.

    Accelerometers under friction or impacts hide their noise below what the motion does; only a model that explains
    the motion uncovers it.
    """
    best = min(nodes, key=lambda node: node.held_out_level)
    if best.held_out is None:
        return setup, nodes, as_given
    records = (*setup.fit, *setup.held_out)
    outputs = (*simulated_outputs(best.fitted, setup.fit), *simulated_outputs(best.held_out, setup.held_out))
    left = [record.outputs - simulated for record, simulated in zip(records, outputs, strict=True)]
    lower = lowered_floor(setup.floor, records, left)
    ratio = setup.floor.variance / lower.variance
    if float(ratio.max()) <= 1.0:
        return setup, nodes, as_given
    found = prepare_setup(setup.given, setup.fit, setup.held_out, setup.task.catalogue, setup.task.report, lower)
    n_fit = len(setup.fit)
    scaled = tuple(on_other_floor(node, ratio[:n_fit], ratio[n_fit:]) for node in nodes)
    given = on_other_floor(as_given, ratio[:n_fit], ratio[n_fit:])
    return found, search(scaled[0], found.task, scaled), given


def roots(setup: Setup) -> tuple[Node, Node]:
    """The model as given, only initial states fitted; and calibrated.

    Raises:
        NumericalError: If the model cannot be simulated along the records.
    """
    given, task = setup.given, setup.task
    task.report("calibrating the linear parameters", 0.02)
    assembly, unknowns = placed_assembly(given.plant, given.linear, given.effects, task.fit.drive, task.catalogue)
    start = simulate_at(assembly, unknowns, task.fit)
    if start is None:
        raise NumericalError(
            "the model could not be simulated along the records to fit: its motion grows without bound; check the units "
            "of the inputs and the signs of its effects"
        )
    still = Problem(drive=task.fit.drive, floor=task.fit.floor, free_common=False)
    return node_of(estimate(start, still, iterations=6), task), calibrated_node(start, task)


def locate_gap(setup: Setup, root: Node) -> Location:
    """Where the calibrated linear model and the records disagree."""
    from modal.discrepancy.level_modes import level_modes
    from modal.discrepancy.lines import measure_lines

    setup.task.report("locating the gap", 0.05)
    gap = measure_gap(setup.fit, simulated_records(setup.fit, root.fitted), setup.floor.variance[: len(setup.fit)])
    return locate(gap, level_modes(setup.fit), measure_lines(setup.fit))


def simulated_records(records: Sequence[Record], fitted: Estimate) -> list[Record]:
    """The records with the model's outputs."""
    return [
        Record(
            record.inputs,
            outputs,
            record.dt,
            input_names=record.input_names,
            output_names=record.output_names,
            input_units=record.input_units,
            output_units=record.output_units,
            input_hold=record.input_hold,
            name=record.name,
        )
        for record, outputs in zip(records, simulated_outputs(fitted, records), strict=True)
    ]


def simulated_outputs(fitted: Estimate, records: Sequence[Record]) -> tuple[FloatArray, ...]:
    """The model's outputs along each record."""
    firsts = np.concatenate([[0], np.cumsum([record.n_samples for record in records])])
    return tuple(fitted.trajectory.outputs[a:b] for a, b in zip(firsts[:-1], firsts[1:], strict=True))


def _diagnosis(
    setup: Setup,
    as_given: Node,
    nodes: Sequence[Node],
    decision: Decision,
    location: Location,
    circumstances: frozenset[Any],
    notes: tuple[str, ...],
) -> Diagnosis:
    root, best, task = nodes[0], decision.node, setup.task
    problem = task.fine_fit if best.fitted.trajectory.drive.dt < task.fit.drive.dt else task.fit
    spread = covariance(best.fitted, problem)
    deviations = np.sqrt(np.maximum(np.diag(spread)[: best.fitted.assembly.n_common], 0.0))
    calibrated = calibrated_parameters(best.fitted, deviations)
    hits = tuple(item.name for item in calibrated if item.at_bound)
    ranked = sorted(nodes, key=lambda node: node.held_out_level)
    before, after = _rmse(as_given, setup), _rmse(best, setup)
    return Diagnosis(
        status=decision.status,
        findings=findings_of(decision, root, task, setup.given.plant, deviations, circumstances),
        model=returned_model(setup.given, best.fitted.assembly, best.fitted.unknowns, deviations),
        noise_floor=setup.floor,
        gap_before=before,
        gap_after=after,
        closed=_closed(as_given, best),
        calibrated=calibrated,
        bounds_hit=hits,
        detection_limits=detection_limits(best.coarse, task, setup.given.plant),
        advice=advise(decision, setup.given.plant, setup.fit, circumstances),
        location=location,
        steps=_steps(as_given, root, nodes, best, setup.held_out),
        hypotheses=tuple(hypothesis_of(node, root, task) for node in ranked),
        laws=law_curves(best.fitted, problem, setup.given.plant, spread),
        fit=setup.fit,
        held_out=setup.held_out,
        warnings=(*notes, *_bound_words(hits), *decision.reasons),
    )


def _bound_words(hits: tuple[str, ...]) -> tuple[str, ...]:
    if not hits:
        return ()
    return (
        f"{', '.join(hits)} sits on its bound: the model that was given is further off than its tolerances allow, or "
        "what is missing is not in the catalogue; check the nominal values",
    )


def _rmse(node: Node, setup: Setup) -> FloatArray:
    floor = setup.floor.variance[len(setup.fit) :]
    if node.held_out is None:
        return np.full(floor.shape, np.inf)
    return np.asarray(np.sqrt(node.held_out.mean_square * floor))


def _closed(before: Node, after: Node) -> float:
    """Share of the held-out mean square above the floor that is gone."""
    if before.held_out is None or after.held_out is None:
        return 1.0 if after.held_out is not None else 0.0
    gap = float(np.nansum(np.maximum(before.held_out.mean_square - 1.0, 0.0)))
    left = float(np.nansum(np.maximum(after.held_out.mean_square - 1.0, 0.0)))
    return 1.0 - left / gap if gap > 0.0 else 0.0


def _steps(
    as_given: Node, root: Node, nodes: Sequence[Node], best: Node, held_out: Sequence[Record]
) -> tuple[Step, ...]:
    path = [("as given", as_given), ("calibrated", root)]
    known = len(root.effects)
    for count in range(known + 1, len(best.effects) + 1):
        wanted = best.effects[:count]
        node = best if count == len(best.effects) else next((one for one in nodes if one.effects == wanted), None)
        if node is not None:
            path.append((f"{wanted[-1][0]} at {wanted[-1][1]}", node))
    return tuple(
        Step(
            name=name,
            fit_level=node.fit_level,
            held_out_level=node.held_out_level,
            simulated=() if node.held_out is None else simulated_outputs(node.held_out, held_out),
        )
        for name, node in path
    )
