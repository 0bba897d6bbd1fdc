"""Diagnose a simulation program of which nothing is known but what it returns: a callable, Record in, Record out.

It is run along every record, and its linear part is identified from its own outputs. The search works with this linear
part on records from which the rest is taken off, y - (f(u) - L(u)): what a model then has to explain is exactly what
the callable itself leaves, also where the linear part does not quite reproduce it. The result is proved with the
callable: changed inputs and outputs by running it again, forces by the difference that they make in the linear part.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from era.realisation import Realisation
from modal.discrepancy.advice import circumstances_of
from modal.discrepancy.callable_identification import LinearPart, identify_callable, quietest, relative_miss
from modal.discrepancy.callable_model import Simulator, check_deterministic, run_callable
from modal.discrepancy.corrected_callable import CorrectedCallable, along_plant
from modal.discrepancy.decision import NEAR_FLOOR, decide_nodes
from modal.discrepancy.diagnosis import Diagnosis, Step
from modal.discrepancy.effects.effect import Effect
from modal.discrepancy.gap import measure_gap
from modal.discrepancy.given import Given, given_model
from modal.discrepancy.level_modes import level_modes
from modal.discrepancy.lines import measure_lines
from modal.discrepancy.locate import Location, locate
from modal.discrepancy.noise_floor import NoiseFloor, noise_floor
from modal.discrepancy.plant_model import PlantModel
from modal.discrepancy.proof import Proof, Runs, prove, unproved
from modal.discrepancy.residual_model import residual_model
from modal.discrepancy.search import search
from modal.discrepancy.workflow import Progress, _diagnosis, prepare_setup, roots, simulated_outputs
from modal.structure import SensorKind
from okid.arrays import FloatArray
from okid.errors import IdentificationError, InvalidDataError
from okid.record import Record

__all__ = ["diagnose_callable"]

LINEAR = 0.02
"""Share of its output's rms that the linear part of a callable may miss before the callable is called nonlinear."""
USEFUL = 0.3
"""Share on the quietest records up to which the search with the linear part is worth its while."""


def diagnose_callable(
    model: Simulator,
    fits: tuple[Record, ...],
    helds: tuple[Record, ...],
    *,
    catalogue: Mapping[str, Effect],
    sensor_kind: SensorKind | Sequence[SensorKind] | None,
    progress: Progress,
    notes: tuple[str, ...],
) -> Diagnosis:
    """Find what a callable lacks.

    Args:
        model: Takes a Record and returns one with simulated outputs; started from rest, deterministic.
        fits: Records to fit.
        helds: Held-out records.
        catalogue: The effects to try.
        sensor_kind: What the outputs are, as in `diagnose`.
        progress: Called with a sentence and the share that is done.
        notes: What is known of the records already; they lead the warnings.

    Returns:
        The diagnosis; its `model` is a `CorrectedCallable`, its gaps are those of the callable itself.

    Raises:
        InvalidDataError: No input, or a callable that fails, is not deterministic, or returns no record or one that does
            not match.
        NumericalError: Its linear part cannot be simulated along the records.
    """
    records = (*fits, *helds)
    if fits[0].n_inputs == 0:
        raise InvalidDataError(
            "a callable is identified from its answer to inputs, but the records have none; pass the model's matrices "
            "instead (StructuralModel, control.StateSpace), or records with inputs."
        )
    progress(f"running the callable along {len(records)} records", 0.0)
    own = tuple(run_callable(model, record) for record in records)
    check_deterministic(model, fits[0], own[0].outputs)
    floor = noise_floor(records)
    runs = Runs(simulator=model, fit=fits, held_out=helds, own=own, floor=floor.variance, catalogue=catalogue)
    progress("identifying the linear part of the callable", 0.01)
    part, given = _identified(runs, sensor_kind)
    if part is None or given is None or part.miss > USEFUL:
        return _without_search(runs, floor, (*notes, _unidentified(part, own[: len(fits)])))
    plant = _plant_of(given)
    rest = [run.outputs - along_plant(plant, record) for run, record in zip(own, records, strict=True)]
    shifted = tuple(replace(record, outputs=record.outputs - one) for record, one in zip(records, rest, strict=True))
    setup = prepare_setup(given, shifted[: len(fits)], shifted[len(fits) :], catalogue, progress, floor)
    as_given, root = roots(setup)
    progress("locating the gap", 0.05)
    found = zip(simulated_outputs(root.fitted, fits), rest[: len(fits)], strict=True)
    location = _located(fits, [simulated + one for simulated, one in found], floor)
    nodes = search(root, setup.task)
    progress("deciding", 0.9)
    circumstances = circumstances_of(setup.given.plant, setup.fit, root)
    decision = decide_nodes(nodes, setup.task, circumstances=circumstances)
    first = _diagnosis(setup, as_given, nodes, decision, location, circumstances, notes)
    progress("proving it with the callable itself", 0.95)
    proof = prove(runs, plant, part.realisation, decision.node)
    words = _nonlinear(part.realisation, own, len(fits))
    return _proved(_unshifted(first, runs, rest[len(fits) :]), runs, proof, part.realisation, words)


def _identified(
    runs: Runs, sensor_kind: SensorKind | Sequence[SensorKind] | None
) -> tuple[LinearPart | None, Given | None]:
    """The smallest linear part that is a plant too."""

    def as_plant(realisation: Realisation) -> Given | None:
        try:
            return given_model(realisation, runs.fit, sensor_kind=sensor_kind)
        except IdentificationError:
            return None

    part = identify_callable(
        runs.simulator, runs.own[: len(runs.fit)], usable=lambda realisation: as_plant(realisation) is not None
    )
    return part, None if part is None else as_plant(part.realisation)


def _plant_of(given: Given) -> PlantModel:
    if isinstance(given.model, PlantModel):
        return given.model
    return PlantModel(given.plant, linear=given.linear)


def _located(fits: Sequence[Record], simulated: Sequence[FloatArray], floor: NoiseFloor) -> Location:
    runs = [replace(record, outputs=one) for record, one in zip(fits, simulated, strict=True)]
    gap = measure_gap(fits, runs, floor.variance[: len(fits)])
    return locate(gap, level_modes(fits), measure_lines(fits))


def _nonlinear(realisation: Realisation, own: Sequence[Record], n_fit: int) -> tuple[str, ...]:
    """What to say where the linear part does not reproduce the callable."""
    misses = [float(np.max(relative_miss(realisation, run))) for run in own]
    if max(misses) <= LINEAR:
        return ()
    worst = own[int(np.argmax(misses))]
    least = min(misses[:n_fit])
    return (
        f"the callable is itself nonlinear: its linear part, identified at the lowest level, misses {100.0 * least:.2g} % "
        f"of its output there and {100.0 * max(misses):.2g} % in {worst.name or 'the worst record'}; the search saw the "
        "callable's own output, but the forces and delays that it tried act on the linear part only",
    )


def _unidentified(part: LinearPart | None, own: Sequence[Record]) -> str:
    at = quietest(own)[0].name or "the quietest record"
    how = "no linear model at all" if part is None else f"a linear model misses {100.0 * part.miss:.0f} % of its output"
    return (
        f"the callable could not be identified as a linear model with ports ({how} in {at}, limit "
        f"{100.0 * USEFUL:.0f} %), so no effect was tried: the callable is itself nonlinear at every level, holds a delay "
        "of its own, or answers hardly to the inputs; add a record of a lower level, or pass the model's matrices"
    )


def _unshifted(found: Diagnosis, runs: Runs, rest: Sequence[FloatArray]) -> Diagnosis:
    """The diagnosis in the records as they were measured."""
    return replace(
        found,
        fit=runs.fit,
        held_out=runs.held_out,
        steps=tuple(
            replace(
                step,
                simulated=tuple(one + other for one, other in zip(step.simulated, rest, strict=True))
                if step.simulated
                else (),
            )
            for step in found.steps
        ),
    )


def _proved(found: Diagnosis, runs: Runs, proof: Proof, realisation: Realisation, words: tuple[str, ...]) -> Diagnosis:
    """The diagnosis with the callable's own figures in place of those of its linear part."""
    before = unproved(runs, realisation)
    status, reasons = found.status, ()
    if status != "unresolved" and proof.held_out_level > NEAR_FLOOR:
        status = "unresolved"
        reasons = (
            f"the callable itself, with what was found, leaves {proof.held_out_level:.2f} times the noise floor on "
            f"held-out data (limit {NEAR_FLOOR:g}), while its linear part left {found.steps[-1].held_out_level:.2f}",
        )
    steps = [_step(before, found.steps[0].name), *found.steps[1:-1], _step(proof, found.steps[-1].name)]
    result = replace(
        found,
        status=status,
        model=proof.model,
        gap_before=before.rmse,
        gap_after=proof.rmse,
        closed=_closed(before, proof, runs),
        steps=tuple(steps),
        advice=(*_how_to_build_in(proof), *found.advice),
        warnings=(*found.warnings, *words, *reasons),
    )
    return _with_residual(result, runs, before, proof) if status == "unresolved" and not found.findings else result


def _with_residual(found: Diagnosis, runs: Runs, before: Proof, proof: Proof) -> Diagnosis:
    """Where nothing of the catalogue explains the gap: a linear model of what is left, if it proves itself."""
    n_fit = len(runs.fit)
    records = (*runs.fit, *runs.held_out)
    left = [
        replace(record, outputs=record.outputs - simulated)
        for record, simulated in zip(records, proof.simulated, strict=True)
    ]
    linear = residual_model(left[:n_fit], left[n_fit:], runs.floor[:n_fit], runs.floor[n_fit:])
    if linear is None:
        return found
    model = replace(proof.model, residual=linear.realisation)
    simulated = tuple(
        one + replace(model, simulator=_still, effects=(), correction=None)(record).outputs
        for one, record in zip(proof.simulated, records, strict=True)
    )
    after = Proof.of(runs, model, simulated)
    return replace(
        found,
        model=model,
        gap_after=after.rmse,
        closed=_closed(before, after, runs),
        steps=(*found.steps, _step(after, "linear model of what is left")),
        warnings=(*found.warnings, linear.words),
        advice=(f"Look for what the model leaves out: {linear.words}.", *found.advice),
    )


def _still(record: Record) -> Record:
    return replace(record, outputs=np.zeros_like(record.outputs))


def _without_search(runs: Runs, floor: NoiseFloor, warnings: tuple[str, ...]) -> Diagnosis:
    """All that can be said of a callable that could not be identified."""
    before = unproved(runs, None)
    location = _located(runs.fit, before.simulated[: len(runs.fit)], floor)
    found = Diagnosis(
        status="unresolved",
        findings=(),
        model=before.model,
        noise_floor=floor,
        gap_before=before.rmse,
        gap_after=before.rmse,
        closed=0.0,
        calibrated=(),
        bounds_hit=(),
        detection_limits=(),
        advice=(
            "Add a record of a lower level, at which the callable is nearly linear, or pass the model's matrices.",
        ),
        location=location,
        steps=(_step(before, "as given"),),
        hypotheses=(),
        laws=(),
        fit=runs.fit,
        held_out=runs.held_out,
        warnings=warnings,
    )
    return _with_residual(found, runs, before, before)


def _step(proof: Proof, name: str) -> Step:
    return Step(
        name=name, fit_level=proof.fit_level, held_out_level=proof.held_out_level, simulated=proof.simulated_held_out
    )


def _closed(before: Proof, after: Proof, runs: Runs) -> float:
    """Share of the held-out mean square above the floor that is gone."""
    floor = runs.floor[len(runs.fit) :]
    gap, left = (float(np.nansum(np.maximum(one.rmse**2 / floor - 1.0, 0.0))) for one in (before, after))
    return 1.0 - left / gap if gap > 0.0 else 0.0


def _how_to_build_in(proof: Proof) -> tuple[str, ...]:
    if proof.model.correction is None:
        return ()
    return (
        "The returned model adds the difference that the correction makes in the linear part of the callable; build what "
        "was found into the simulation program itself, and diagnose again.",
    )
