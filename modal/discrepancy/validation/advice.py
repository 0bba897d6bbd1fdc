"""What cannot be told apart in these data, and the experiment that would tell."""

from collections.abc import Sequence

import numpy as np

from modal.discrepancy.checks import SAME_LEVEL
from modal.discrepancy.fitting.nodes import Node
from modal.discrepancy.selection.decision import Decision
from modal.discrepancy.validation.findings import even_rivals
from modal.effects.ambiguity import Circumstance, ambiguous_with
from modal.effects.effect_names import effect_name, one_of
from modal.simulation.plant import Plant
from okid.record import Record

__all__ = ["advise", "circumstances_of"]


def circumstances_of(plant: Plant, fits: Sequence[Record], root: Node) -> frozenset[Circumstance]:
    """What holds of the plant and its records, for the table of ambiguities.

    Args:
        plant: The plant.
        fits: Records to fit.
        root: The calibrated model along them.

    Returns:
        The circumstances.
    """
    found: set[Circumstance] = set()
    if plant.n_states <= 2 and plant.n_outputs == 1 and plant.n_inputs <= 1:
        found.add("one_dof")
    per_mass = [port for port in plant.ports if port.mass is not None and port.force_unit == f"{port.length_unit}/s^2"]
    if per_mass and "one_dof" not in found:
        found.add("unknown_masses")  # forces are counted per effective mass
    if plant.n_outputs == 1:
        found.add("one_output")
    sizes = [float(np.sqrt(np.nansum(np.nanvar(r.inputs if r.n_inputs else r.outputs, axis=0)))) for r in fits]
    if min(sizes) <= 0.0 or max(sizes) / min(sizes) < SAME_LEVEL:
        found.add("one_level")
    n = plant.n_states
    states = root.coarse.trajectory.states[:, :n]
    drive = root.coarse.trajectory.drive
    speeds = [
        states @ port.velocity[:n] + drive.sample @ port.velocity[n:]
        for port in plant.ports
        if port.velocity is not None
    ]
    if speeds and all(min(-speed.min(), speed.max()) < 0.01 * np.abs(speed).max() for speed in speeds):
        found.add("one_way")
    return frozenset(found)


def advise(decision: Decision, fits: Sequence[Record], circumstances: frozenset[Circumstance]) -> tuple[str, ...]:
    """What to measure next.

    Args:
        decision: What was decided.
        fits: Records to fit.
        circumstances: From `circumstances_of`.

    Returns:
        Sentences, the most useful first.
    """
    words: list[str] = []
    by_level = False
    for i, ((effect, where), runner) in enumerate(zip(decision.node.effects, decision.runners, strict=False)):
        rows = ambiguous_with(effect, circumstances=circumstances, even_with=even_rivals(decision, i))
        by_level |= any(row.circumstance == "one_level" for row in rows)
        words += [_apart(effect, where, row.others(effect), row.separates) for row in rows]
        if runner is not None and decision.status == "unresolved":
            rest = [row for row in ambiguous_with(effect, circumstances=_ANY_RECORDS) if row not in rows]
            near = sorted({key for key, _ in runner.effects} - {key for key, _ in decision.node.effects})
            words += [
                _apart(effect, where, (key,), row.separates) for key in near for row in rest if key in row.effects
            ]
    if "one_level" in circumstances and not by_level:
        words.append("Measure at a second level, two or three times as strong: most effects are told apart by level.")
    if decision.status == "unresolved" and not decision.node.effects:
        words.append(
            "Nothing in the catalogue explains the gap: measure at more places, look at the time windows and bands in "
            "which it is greatest, or register an effect of your own."
        )
    if decision.status == "none":
        highest = max(fits, key=lambda record: float(np.nanvar(record.inputs)) if record.n_inputs else 0.0)
        words.append(
            f"A stronger level than that of {highest.name or 'the loudest record'} would show effects that these data "
            "hide."
        )
    return tuple(dict.fromkeys(words))


def _apart(effect: str, where: str, others: Sequence[str], separates: str) -> str:
    return f"To tell {effect_name(effect)} at {where} from {one_of(others)} you need {separates}."


_ANY_RECORDS: frozenset[Circumstance] = frozenset({"one_level", "one_way", "small_motion", "large_motion"})
"""What other records would change; the plant stays what it is."""
