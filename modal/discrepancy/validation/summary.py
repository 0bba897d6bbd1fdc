"""A diagnosis put together from what the search found: steps, closed share, findings, limits, and what must be said."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from modal.discrepancy.fitting.estimation import Estimate, Problem, covariance
from modal.discrepancy.fitting.nodes import Node, Task
from modal.discrepancy.results import Calibrated, Diagnosis, Step
from modal.discrepancy.selection.decision import Decision
from modal.discrepancy.selection.form_free import unsettled
from modal.discrepancy.setup import (
    Setup,
    circumstances_of,
    simulated_outputs,
)
from modal.discrepancy.validation.cautions import grid_error
from modal.discrepancy.validation.findings import (
    advise,
    detection_limits,
    findings_of,
    hypothesis_of,
)
from modal.discrepancy.validation.law_curves import law_curves
from modal.discrepancy.validation.other_hold import (
    half_a_sample,
)
from modal.effects.ambiguity import Circumstance
from modal.effects.catalogue import effect_name
from modal.effects.effect import is_form_free
from modal.localisation.evidence import Location
from modal.simulation.plant import Plant, with_masses
from modal.structure.given import returned_model
from modal.wording.numbers import listed, number, quantity
from okid.arrays import FloatArray
from okid.record import Record

__all__ = ["calibrated_parameters", "diagnosis_of", "with_findings"]


def diagnosis_of(
    setup: Setup,
    as_given: Node,
    nodes: Sequence[Node],
    decision: Decision,
    *,
    location: Location,
    notes: tuple[str, ...],
) -> Diagnosis:
    """Put a decision into words, numbers and an updated model."""
    root, best, task = nodes[0], decision.node, setup.task
    decision = with_findings(decision, root, setup)
    circumstances = _circumstances(best, setup)
    _, _, deviations = _spread(best, task)
    calibrated = calibrated_parameters(best.fitted, deviations)
    known = with_masses(setup.given.plant, best.masses)
    hits = tuple(item.name for item in calibrated if item.at_bound)
    found = nodes if any(node is best for node in nodes) else [*nodes, best]
    ranked = sorted(found, key=lambda node: node.held_out_level)
    before, after = _rmse(as_given, setup), _rmse(best, setup)
    return Diagnosis(
        status=decision.status,
        findings=decision.findings,
        model=returned_model(setup.given, best.fitted.assembly, best.fitted.unknowns, deviations),
        noise_floor=setup.floor,
        gap_before=before,
        gap_after=after,
        closed=_closed(as_given, best),
        calibrated=calibrated,
        bounds_hit=hits,
        detection_limits=detection_limits(best.coarse, task, setup.given.plant),
        advice=advise(decision, setup.fit, circumstances),
        location=location,
        steps=_steps(as_given, root, nodes, best, setup.held_out),
        hypotheses=tuple(hypothesis_of(node, root, task) for node in ranked),
        laws=decision.laws,
        fit=setup.fit,
        held_out=setup.held_out,
        warnings=(
            *notes,
            *_bound_words(hits),
            *_beyond_words(calibrated, known),
            *_mass_words(calibrated, best),
            *_gain_words(decision, circumstances),
            *decision.notes,
            *decision.reasons,
        ),
        lack_of_fit=decision.lack_of_fit,
    )


def with_findings(decision: Decision, root: Node, setup: Setup) -> Decision:
    """The decision with the effects that it found beyond those of a first model, and all laws of the model."""
    best, plant = decision.node, setup.given.plant
    problem, spread, deviations = _spread(best, setup.task)
    laws = law_curves(best.fitted, problem, plant, spread)
    if laws and is_form_free(best.fitted.assembly.placements[-1].effect):
        moves = unsettled(best, setup.task, laws[-1].motion)
        laws = (*laws[:-1], replace(laws[-1], deviation=np.hypot(laws[-1].deviation, moves)))
    found = findings_of(
        decision,
        root,
        setup.task,
        plant,
        deviations=deviations,
        circumstances=_circumstances(best, setup),
        laws=laws,
    )
    return replace(decision, findings=found, laws=laws)


def _circumstances(best: Node, setup: Setup) -> frozenset[Circumstance]:
    """What holds of the plant and its records, by the motion of the model chosen."""
    return circumstances_of(setup.given.plant, setup.fit, best) | _of_the_delay(best, setup.fit[0].dt)


def _spread(best: Node, task: Task) -> tuple[Problem, FloatArray, FloatArray]:
    """The records on the grid of the fit, the covariance of all unknowns, and deviations of the common ones."""
    problem = task.fine_fit if best.fitted.trajectory.drive.dt < task.fit.drive.dt else task.fit
    spread = covariance(best.fitted, problem)
    chance = np.sqrt(np.maximum(np.diag(spread)[: best.fitted.assembly.n_common], 0.0))
    return problem, spread, np.hypot(chance, grid_error(best))


def calibrated_parameters(fitted: Estimate, deviations: FloatArray) -> tuple[Calibrated, ...]:
    """The linear parameters of an estimate, then the masses that it takes as right, with the user's tolerance.

    Args:
        fitted: The estimate.
        deviations: (n_common,) standard deviations of its common unknowns.
    """
    held = [one.parameter for one in fitted.assembly.plant.masses]
    found = tuple(
        Calibrated(
            name=parameter.name,
            unit=parameter.unit,
            nominal=parameter.nominal,
            value=float(fitted.unknowns.common[j]),
            std=float(deviations[j]),
            at_bound=bool(fitted.at_bounds[j]),
        )
        for j, parameter in enumerate(fitted.assembly.plant.parameters)
    )
    return found + tuple(
        Calibrated(
            name=one.name, unit=one.unit, nominal=one.nominal, value=one.nominal, std=one.deviation, at_bound=False
        )
        for one in held
    )


def _beyond_words(calibrated: Sequence[Calibrated], plant: Plant) -> tuple[str, ...]:
    """Linear parameters that came out beyond the tolerance of the model that was given."""
    beyond = [
        f"{one.name} ({quantity(one.nominal, one.unit)} given, {quantity(one.value, one.unit)} found)"
        for one, given in zip(calibrated, plant.parameters, strict=False)
        if not given.lower <= one.value <= given.upper
    ]
    if not beyond:
        return ()
    return (f"{listed(beyond)} lies beyond the tolerance of the model that was given: check the nominal values",)


def _mass_words(calibrated: Sequence[Calibrated], best: Node) -> tuple[str, ...]:
    """Masses that the records say are wrong, to as many digits as it takes to see it."""
    words = []
    for one in calibrated:
        if one.name in best.masses:
            alike = (digits for digits in range(3, 9) if number(one.value, digits) != number(one.nominal, digits))
            digits = next(alike, 3)
            found, given = (f"{number(value, digits)} {one.unit}".rstrip() for value in (one.value, one.nominal))
            words.append(f"the {one.name} is {found}, not the {given} of the model that was given")
    return tuple(words)


def _of_the_delay(best: Node, dt: float) -> frozenset[Circumstance]:
    """What a delay that was found adds to the circumstances."""
    assembly, common = best.coarse.assembly, best.coarse.unknowns.common
    delays = [
        common[assembly.common_of(i).start]
        for i, item in enumerate(assembly.placements)
        if item.effect.key == "input_delay"
    ]
    return frozenset({"half_a_sample"}) if any(half_a_sample(delay, dt) for delay in delays) else frozenset()


def _gain_words(decision: Decision, circumstances: frozenset[Circumstance]) -> tuple[str, ...]:
    """A gain that stands for the scale of the whole model scales every force found beside it."""
    gains = [key for key, _ in decision.node.effects if key in {"input_gain", "sensor_gain"}]
    if not gains or "one_dof" not in circumstances:
        return ()
    words = (
        f"{effect_name(gains[0])} cannot be told from a wrong mass or inertia: forces and stiffnesses found beside it "
        "are right only up to that factor; check the mass"
    )
    return (words,)


def _bound_words(hits: tuple[str, ...]) -> tuple[str, ...]:
    if not hits:
        return ()
    words = (
        f"{', '.join(hits)} sits on its bound: the model that was given is further off than its tolerances allow, or "
        "what is missing is not in the catalogue; check the nominal values"
    )
    return (words,)


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
    if path[-1][1] is not best and best.masses:
        path.append((listed(list(best.masses)), best))
    return tuple(
        Step(
            name=name,
            fit_level=node.fit_level,
            held_out_level=node.held_out_level,
            simulated=() if node.held_out is None else simulated_outputs(node.held_out, held_out),
        )
        for name, node in path
    )
