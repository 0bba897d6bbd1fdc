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
from era.simulation import simulate
from modal.discrepancy.noise.floor import NoiseFloor, noise_floor, stacked_floors
from modal.discrepancy.programs.program import (
    CorrectedCallable,
    IdentifiedPart,
    Simulator,
    along_plant,
    check_deterministic,
    identify_callable,
    quietest,
    relative_miss,
    run_callable,
)
from modal.discrepancy.programs.proof import Proof, Runs, prove, residual_model, unproved, with_start
from modal.discrepancy.results import Diagnosis, Step
from modal.discrepancy.selection.decision import Decision, search_and_decide
from modal.discrepancy.setup import (
    Progress,
    prepare_setup,
    roots,
    simulated_outputs,
)
from modal.discrepancy.validation.summary import diagnosis_of
from modal.effects.catalogue import effects_at
from modal.effects.effect import Effect
from modal.localisation.evidence import Location, locate
from modal.localisation.gap import measure_gap
from modal.localisation.levels import level_modes
from modal.localisation.lines import measure_lines
from modal.simulation import NEAR_FLOOR, explained
from modal.structure.given import Given, PlantModel, given_model
from modal.structure.structural_model import SensorKind
from modal.wording.text import times_floor_text
from okid.arrays import FloatArray
from okid.errors import IdentificationError, InvalidDataError
from okid.record import Record


def proved(
    found: Diagnosis, runs: Runs, proof: Proof, *, realisation: Realisation, decision: Decision, between: Sequence[Step]
) -> Diagnosis:
    """What was found in the linear part, with the callable's own figures.

    Returns:
        "named" and "none" stand only where the callable itself comes within 1.5 of the noise floor on held-out data;
        where the linear part alone was too rough for that but the callable comes there, the name is firm after all.
    """
    before = unproved(runs, realisation)
    status, warnings = decision.status, found.warnings
    enough = explained(proof.held_out_level)
    if status != "unresolved" and not enough:
        status = "unresolved"
        said = (
            f"the callable itself, with what was found, leaves {times_floor_text(proof.held_out_level)} times the "
            f"noise floor on held-out data (limit {times_floor_text(NEAR_FLOOR)}), while its linear part left "
            f"{times_floor_text(decision.node.held_out_level)}"
        )
        warnings = (*warnings, said)
    elif status == "unresolved" and enough and _only_rough(decision):
        status = "named"
        warnings = tuple(one for one in warnings if one not in decision.reasons)
    last = found.steps[-1].name if len(found.steps) > 1 else "calibrated"
    result = replace(
        found,
        status=status,
        model=proof.model,
        gap_before=before.rmse,
        gap_after=proof.rmse,
        closed=_closed(before, proof, runs),
        fit=runs.fit,
        held_out=runs.held_out,
        steps=(_step(before, "as given"), *between, _step(proof, last)),
        advice=(*_how_to_build_in(proof), *found.advice),
        warnings=warnings,
    )
    return result if status != "unresolved" or enough else _with_residual(result, runs, before, proof, realisation)


def without_search(runs: Runs, floor: NoiseFloor, location: Location, warnings: tuple[str, ...]) -> Diagnosis:
    """All that can be said of a callable whose linear part could not be identified.

    "none" where the callable explains the records as it is, else "unresolved".
    """
    before = unproved(runs, None)
    # the floor of a nonlinear system without repeats counts motion as noise
    spread = np.array([np.nanstd(record.outputs, axis=0) for record in runs.held_out])
    follows = bool((before.rmse <= USEFUL * spread).all())
    fits = follows and explained(before.fit_level, before.held_out_level)
    found = Diagnosis(
        status="none" if fits else "unresolved",
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
    return found if fits else _with_residual(found, runs, before, before, None)


def _only_rough(decision: Decision) -> bool:
    """Whether nothing but the size of what the linear part leaves stands against the name."""
    return len(decision.reasons) == 1 and not explained(decision.node.held_out_level) and bool(decision.runners)


def _with_residual(
    found: Diagnosis, runs: Runs, before: Proof, proof: Proof, realisation: Realisation | None
) -> Diagnosis:
    """Where nothing of the catalogue explains the gap: a linear model of what is left, if it proves itself."""
    n_fit = len(runs.fit)
    records = (*runs.fit, *runs.held_out)
    # from rest: a free motion fitted to a wrong simulation is no answer to the inputs
    left = [replace(one, outputs=one.outputs - run.outputs) for one, run in zip(records, runs.own, strict=True)]
    linear = residual_model(left[:n_fit], left[n_fit:], runs.floor[:n_fit], runs.floor[n_fit:])
    if linear is None:
        return found
    model = CorrectedCallable(runs.simulator, residual=linear.realisation, catalogue=runs.catalogue)
    simulated = [run.outputs + simulate(linear.realisation, run).outputs for run in runs.own]
    started = [with_start(realisation, one, along) for one, along in zip(records, simulated, strict=True)]
    after = Proof.of(runs, model, tuple(started))
    advice = (f"Look for dynamics that the callable leaves out: {linear.words}.", *found.advice)
    if after.fit_level >= proof.fit_level:
        return replace(found, advice=advice)
    instead = f", in place of {effects_at([(x.effect, x.where) for x in found.findings])}" if found.findings else ""
    return replace(
        found,
        model=model,
        gap_after=after.rmse,
        closed=_closed(before, after, runs),
        steps=(*found.steps, _step(after, "linear model of what is left")),
        warnings=(*found.warnings, f"{linear.words}; the returned model has it{instead}, without a name"),
        advice=advice,
    )


def _step(proof: Proof, name: str) -> Step:
    return Step(
        name=name, fit_level=proof.fit_level, held_out_level=proof.held_out_level, simulated=proof.simulated_held_out
    )


def _closed(before: Proof, after: Proof, runs: Runs) -> float:
    """Share of the held-out mean square above the floor that is gone."""
    floor: FloatArray = runs.floor[len(runs.fit) :]
    gap, left = (float(np.nansum(np.maximum(one.rmse**2 / floor - 1.0, 0.0))) for one in (before, after))
    return 1.0 - left / gap if gap > 0.0 else 0.0


def _how_to_build_in(proof: Proof) -> tuple[str, ...]:
    if proof.model.correction is None:
        return ()
    said = (
        "The returned model adds the difference that the correction makes in the linear part of the callable; build "
        "what was found into the simulation program itself, and diagnose again."
    )
    return (said,)


LINEAR = 0.02
"""Call a callable nonlinear where its linear part misses more than this share of an output's rms."""
USEFUL = 0.3
"""Search with the linear part of a callable, and believe what it simulates, where it leaves at most this share of an
output's deviation."""


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

    The diagnosis; its `model` is a `CorrectedCallable`, its gaps are those of the callable itself.

    Raises:
        InvalidDataError: No input, or a callable that fails, is not deterministic, or returns no record that matches.
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
        location = _located(fits, [run.outputs for run in own[: len(fits)]], floor)
        return without_search(runs, floor, location, (*notes, _unidentified(part, own[: len(fits)])))
    misses = [float(np.max(relative_miss(part.realisation, run))) for run in own]
    plant = _plant_of(given)
    rest = [run.outputs - along_plant(plant, record) for run, record in zip(own, records, strict=True)]
    shifted = [replace(record, outputs=record.outputs - one) for record, one in zip(records, rest, strict=True)]
    to_fit, to_hold = _worth_searching(misses, len(fits))
    setup = prepare_setup(
        given,
        tuple(shifted[i] for i in to_fit),
        tuple(shifted[i] for i in to_hold),
        catalogue,
        progress,
        floor=floor.of_records([*to_fit, *to_hold]),
    )
    as_given, root = roots(setup)
    progress("locating the gap", 0.05)
    along = [one + rest[i] for i, one in zip(to_fit, simulated_outputs(root.fitted, setup.fit), strict=True)]
    location = _located([records[i] for i in to_fit], along, setup.floor)
    setup, nodes, as_given, decision = search_and_decide(setup, as_given, root)
    at = {record: row for row, record in enumerate([*to_fit, *to_hold])}
    floor = stacked_floors([(setup.floor, at[i]) if i in at else (floor, i) for i in range(len(records))])
    runs = replace(runs, floor=floor.variance)
    said = (*notes, *_nonlinear(misses, records, len(fits)))
    found = diagnosis_of(setup, as_given, nodes, decision, location=location, notes=said)
    progress("proving it with the callable itself", 0.95)
    return proved(
        replace(found, noise_floor=floor),
        runs,
        prove(runs, plant, part.realisation, decision.node),
        realisation=part.realisation,
        decision=decision,
        between=_between(found, rest[len(fits) :]) if len(to_hold) == len(helds) else (),
    )


def _identified(
    runs: Runs, sensor_kind: SensorKind | Sequence[SensorKind] | None
) -> tuple[IdentifiedPart | None, Given | None]:
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
    return locate(gap, modes=level_modes(fits), lines=measure_lines(fits))


def _worth_searching(misses: Sequence[float], n_fit: int) -> tuple[list[int], list[int]]:
    """Records to fit and held-out ones that the linear part reproduces well enough to search with."""
    to_fit = [i for i, miss in enumerate(misses[:n_fit]) if miss <= USEFUL]
    to_hold = [i for i, miss in enumerate(misses) if miss <= USEFUL and i >= n_fit]
    return to_fit, to_hold or list(range(n_fit, len(misses)))


def _between(found: Diagnosis, rest: Sequence[FloatArray]) -> list[Step]:
    """The steps between the first and the last, in the records as they were measured."""
    steps = []
    for step in found.steps[1:-1]:
        simulated = [one + other for one, other in zip(step.simulated, rest, strict=True)] if step.simulated else []
        steps.append(replace(step, simulated=tuple(simulated)))
    return steps


def _nonlinear(misses: Sequence[float], records: Sequence[Record], n_fit: int) -> tuple[str, ...]:
    """What to say where the linear part does not reproduce the callable."""
    if max(misses) <= LINEAR:
        return ()
    at = int(np.argmax(misses))
    left_out = sum(miss > USEFUL for miss in misses)
    without = f", but for {left_out} records that it misses too much of" if left_out else ""
    said = (
        f"the callable is itself nonlinear: its linear part, identified at the lowest level, misses "
        f"{100.0 * min(misses[:n_fit]):.2g} % of its output there and {100.0 * misses[at]:.2g} % in "
        f"{records[at].name or 'its worst record'}; effects were looked for about its own output{without}, with forces "
        "and delays acting on the linear part only"
    )
    return (said,)


def _unidentified(part: IdentifiedPart | None, own: Sequence[Record]) -> str:
    at = quietest(own)[0].name or "the quietest record"
    how = "no linear model at all" if part is None else f"a linear model misses {100.0 * part.miss:.0f} % of its output"
    return (
        f"the callable could not be identified as a linear model ({how} in {at}, limit {100.0 * USEFUL:.0f} %), so no "
        "effect was tried: it is itself nonlinear at every level, holds a delay of its own, or hardly answers to the "
        "inputs; add a record of a lower level, or pass the model's matrices"
    )
