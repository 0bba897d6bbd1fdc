"""Find what a simulation lacks against measured records: floor, calibration, location, search, decision in one call."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from modal.discrepancy.fitting.nodes import Node
from modal.discrepancy.fitting.observer_form import LostMotion
from modal.discrepancy.results import Calibrated, Diagnosis, Step
from modal.discrepancy.selection.beam import search_effects
from modal.discrepancy.selection.decision import Decision, covariance, decide_nodes
from modal.discrepancy.setup import (
    Progress,
    Setup,
    check_records,
    fewest_samples,
    locate_gap,
    prepare_setup,
    roots,
    simulated_outputs,
    with_uncovered_floor,
)
from modal.discrepancy.stages import calibrated_parameters
from modal.discrepancy.validation.cautions import doubted_units, grid_error, with_cautions
from modal.discrepancy.validation.findings import advise, circumstances_of, detection_limits, findings_of, hypothesis_of
from modal.discrepancy.validation.law_curves import law_curves
from modal.discrepancy.validation.other_hold import (
    by_the_better_hold,
    cut_into_spans,
    floor_of_spans,
    half_a_sample,
    span_words,
)
from modal.effects.ambiguity import Circumstance
from modal.effects.catalogue import CATALOGUE, effect_name
from modal.effects.effect import Effect
from modal.estimation.modal_states import one_blas_thread
from modal.localisation.evidence import Location
from modal.localisation.levels import LevelModes
from modal.simulation.plant import Plant
from modal.structure.given import given_model, returned_model
from modal.structure.structural_model import SensorKind
from modal.wording.numbers import listed, quantity
from okid.arrays import FloatArray
from okid.errors import InvalidDataError
from okid.record import Record

__all__ = ["Progress", "diagnose", "diagnosis_of"]


def _silent(what: str, share: float) -> None:
    del what, share


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
    with one_blas_thread():
        found = _diagnosed(model, fit, held_out, catalogue=catalogue, sensor_kind=sensor_kind, report=report)

        def otherwise(
            fits: Sequence[Record], helds: Sequence[Record], tried: Mapping[str, Effect]
        ) -> Diagnosis:  # modes are those of the samples, whatever the inputs do between them
            return _diagnosed(
                model,
                fits,
                helds,
                catalogue=tried,
                sensor_kind=sensor_kind,
                report=report,
                modes=found.location.modes,
            )

        return with_cautions(by_the_better_hold(found, otherwise, catalogue))


def _diagnosed(
    model: Any,
    fit: Record | Sequence[Record],
    held_out: Record | Sequence[Record],
    *,
    catalogue: Mapping[str, Effect],
    sensor_kind: SensorKind | Sequence[SensorKind] | None,
    report: Progress,
    modes: LevelModes | None = None,
) -> Diagnosis:
    if not isinstance(catalogue, Mapping):
        raise InvalidDataError(
            f"the catalogue is a mapping from keys to effects and a {type(catalogue).__name__} was given; pass e.g. "
            "{key: CATALOGUE[key] for key in keys}"
        )
    fits, helds, notes = check_records(fit, held_out)
    if callable(model) and not hasattr(model, "A"):
        from modal.discrepancy.programs.black_box import diagnose_callable

        return diagnose_callable(
            model, fits, helds, catalogue=catalogue, sensor_kind=sensor_kind, progress=report, notes=notes
        )
    given = given_model(model, fits, sensor_kind=sensor_kind)
    whole = prepare_setup(given, fits, helds, catalogue, report, whole=True)
    try:
        return _searched(whole, notes, modes)
    except LostMotion:
        cut = _in_spans(whole)
        return _searched(cut, (*notes, span_words(cut.fit)), None)


def _in_spans(whole: Setup) -> Setup:
    """The same on spans of the records."""
    fewest = fewest_samples(whole.given.plant)
    spans, origin = cut_into_spans((*whole.fit, *whole.held_out), whole.floor.variance, fewest=2 * fewest)
    n_fit = sum(position < len(whole.fit) for position in origin)
    task, floor = whole.task, floor_of_spans(whole.floor, origin)
    task.report("once more on spans of the records", 0.05)
    return prepare_setup(whole.given, spans[:n_fit], spans[n_fit:], task.catalogue, task.report, floor=floor)


def _searched(setup: Setup, notes: tuple[str, ...], modes: LevelModes | None) -> Diagnosis:
    """Everything from calibration to the words.

    Args:
        setup: Model, records and floor.
        notes: What the reader must know of the records.
        modes: Of the records to fit at each level, where they are known.

    Raises:
        LostMotion: The records are whole, and the motion cannot be followed along them.
    """
    as_given, root = roots(setup)
    nodes = search_effects(root, setup.task)
    location = locate_gap(setup, root, modes)
    setup, nodes, as_given = with_uncovered_floor(setup, nodes, as_given)
    circumstances = circumstances_of(setup.given.plant, setup.fit, root)
    setup.task.report("deciding", 0.9)
    decision = doubted_units(decide_nodes(nodes, setup.task, circumstances=circumstances))
    return diagnosis_of(setup, as_given, nodes, decision, location=location, circumstances=circumstances, notes=notes)


def diagnosis_of(
    setup: Setup,
    as_given: Node,
    nodes: Sequence[Node],
    decision: Decision,
    *,
    location: Location,
    circumstances: frozenset[Any],
    notes: tuple[str, ...],
) -> Diagnosis:
    """Put a decision into words, numbers and an updated model.

    Args:
        setup: Model, records and floor.
        as_given: The model as given along the records.
        nodes: All models that were fitted, the calibrated one first.
        decision: What was decided.
        location: Where the two disagree.
        circumstances: For the table of ambiguities.
        notes: What the reader must know of the records.

    Returns:
        The diagnosis.
    """
    root, best, task = nodes[0], decision.node, setup.task
    circumstances = circumstances | _of_the_delay(best, setup.fit[0].dt)
    problem = task.fine_fit if best.fitted.trajectory.drive.dt < task.fit.drive.dt else task.fit
    spread = covariance(best.fitted, problem)
    chance = np.sqrt(np.maximum(np.diag(spread)[: best.fitted.assembly.n_common], 0.0))
    deviations = np.hypot(chance, grid_error(best))
    calibrated = calibrated_parameters(best.fitted, deviations)
    hits = tuple(item.name for item in calibrated if item.at_bound)
    found = nodes if any(node is best for node in nodes) else [*nodes, best]
    ranked = sorted(found, key=lambda node: node.held_out_level)
    before, after = _rmse(as_given, setup), _rmse(best, setup)
    return Diagnosis(
        status=decision.status,
        findings=findings_of(
            decision, root, task, setup.given.plant, deviations=deviations, circumstances=circumstances
        ),
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
        laws=law_curves(best.fitted, problem, setup.given.plant, spread),
        fit=setup.fit,
        held_out=setup.held_out,
        warnings=(
            *notes,
            *_bound_words(hits),
            *_beyond_words(calibrated, setup.given.plant),
            *_gain_words(decision, circumstances),
            *decision.reasons,
        ),
    )


def _beyond_words(calibrated: Sequence[Calibrated], plant: Plant) -> tuple[str, ...]:
    """Linear parameters that came out beyond the tolerance of the model that was given."""
    beyond = [
        f"{one.name} ({quantity(one.nominal, one.unit)} given, {quantity(one.value, one.unit)} found)"
        for one, given in zip(calibrated, plant.parameters, strict=True)
        if not given.lower <= one.value <= given.upper
    ]
    if not beyond:
        return ()
    return (f"{listed(beyond)} lies beyond the tolerance of the model that was given: check the nominal values",)


def _of_the_delay(best: Node, dt: float) -> frozenset[Circumstance]:
    """What a delay that was found adds to the circumstances."""
    assembly, common = best.coarse.assembly, best.coarse.unknowns.common
    delays = [
        common[assembly.common_of(i).start]
        for i, item in enumerate(assembly.placements)
        if item.effect.key == "input_delay"
    ]
    return frozenset({"half_a_sample"}) if any(half_a_sample(delay, dt) for delay in delays) else frozenset()


def _gain_words(decision: Decision, circumstances: frozenset[Any]) -> tuple[str, ...]:
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
    return tuple(
        Step(
            name=name,
            fit_level=node.fit_level,
            held_out_level=node.held_out_level,
            simulated=() if node.held_out is None else simulated_outputs(node.held_out, held_out),
        )
        for name, node in path
    )
