"""The diagnosis of a callable: the figures of its linear part replaced by those of the callable itself."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from era.realisation import Realisation
from era.simulation import simulate
from modal.discrepancy.noise.floor import NoiseFloor
from modal.discrepancy.programs.corrected import CorrectedCallable
from modal.discrepancy.programs.proof import Proof, Runs, unproved
from modal.discrepancy.programs.residual_model import residual_model, with_start
from modal.discrepancy.results import Diagnosis, Step
from modal.discrepancy.selection.decision import Decision
from modal.effects.effect_names import effects_at
from modal.localisation.evidence import Location
from modal.simulation.tolerances import NEAR_FLOOR
from modal.wording.statements import times_floor_text
from okid.arrays import FloatArray

__all__ = ["proved", "without_search"]

FOLLOWS = 0.3
"""Share of an output's deviation that a callable may leave where nothing but the noise floor speaks for it."""


def proved(
    found: Diagnosis,
    runs: Runs,
    proof: Proof,
    *,
    realisation: Realisation,
    decision: Decision,
    between: Sequence[Step],
) -> Diagnosis:
    """What was found in the linear part, with the callable's own figures.

    Args:
        found: The diagnosis of the linear part.
        runs: The callable and the records.
        proof: The callable with what was found.
        realisation: The linear part.
        decision: What was decided of the linear part.
        between: Steps between the callable as given and the proof.

    Returns:
        "named" and "none" stand only where the callable itself comes within 1.5 of the noise floor on held-out data;
        where the linear part alone was too rough for that but the callable comes there, the name is firm after all.
    """
    before = unproved(runs, realisation)
    status, warnings = decision.status, found.warnings
    enough = proof.held_out_level <= NEAR_FLOOR
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

    Args:
        runs: The callable and the records.
        floor: Noise floor of the records.
        location: Where callable and records disagree.
        warnings: Why no effect was tried.

    Returns:
        "none" where the callable explains the records as it is, else "unresolved".
    """
    before = unproved(runs, None)
    # the floor of a nonlinear system without repeats counts motion as noise
    spread = np.array([np.nanstd(record.outputs, axis=0) for record in runs.held_out])
    follows = bool((before.rmse <= FOLLOWS * spread).all())
    fits = follows and max(before.fit_level, before.held_out_level) <= NEAR_FLOOR
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
    return len(decision.reasons) == 1 and decision.node.held_out_level > NEAR_FLOOR and bool(decision.runners)


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
