"""The ground of a diagnosis: plant, noise floor, drives, and the model before any effect is tried."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from modal.discrepancy.checks import check_long_enough, check_plant
from modal.discrepancy.fitting.calibration import calibrated_node
from modal.discrepancy.fitting.estimation import Estimate, Problem, estimate, simulate_at
from modal.discrepancy.fitting.nodes import FINE_STEPS, Node, Task, node_of, on_other_floor, polished
from modal.discrepancy.noise.floor import NoiseFloor, lowered_floor, noise_floor
from modal.discrepancy.selection.beam import search_effects
from modal.effects.effect import Effect
from modal.localisation.evidence import Location, locate
from modal.localisation.gap import measure_gap
from modal.localisation.levels import LevelModes, level_modes
from modal.localisation.lines import measure_lines
from modal.simulation.budget import Budget, simulation_work
from modal.simulation.drive import drive_of
from modal.simulation.steps import steps_per_sample
from modal.structure.given import Given, placed_assembly
from okid.arrays import FloatArray
from okid.errors import NumericalError
from okid.record import Record

__all__ = [
    "Progress",
    "Setup",
    "locate_gap",
    "prepare_setup",
    "roots",
    "simulated_outputs",
    "simulated_records",
    "with_uncovered_floor",
]

MOST_WORK = 4000.0
"""A search may cost so many simulations along the records to fit: two effects were seen to take 200 to 1600."""

FOLLOWED = 1e-3
"""Share of an output, root mean square, that counts as noise in any case: steps and smoothed corners leave as much."""

Progress = Callable[[str, float], None]
"""Called with what is being done and the share that is done (0 to 1)."""


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


def prepare_setup(
    given: Given,
    fit: tuple[Record, ...],
    held_out: tuple[Record, ...],
    catalogue: Mapping[str, Effect],
    report: Progress,
    *,
    floor: NoiseFloor | None = None,
    whole: bool = False,
    budget: Budget | None = None,
) -> Setup:
    """Noise floor and drives.

    Args:
        given: The model.
        fit: Records to fit.
        held_out: Held-out records.
        catalogue: The effects to try.
        report: Called with a sentence and the share done.
        floor: Their noise floor; estimated unless given.
        whole: Whether the records may be cut into spans where their motion cannot be followed.
        budget: What is left of an earlier search; a new one unless given.
    """
    check_plant(given.plant, given.linear, [*fit, *held_out])
    check_long_enough(given.plant, [*fit, *held_out])
    report("noise floor", 0.0)
    known = _followed(noise_floor([*fit, *held_out]) if floor is None else floor, [*fit, *held_out])
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
        fine_fit=Problem(drive=drive_of(fit, max(steps, FINE_STEPS)), floor=known.variance[:n_fit]),
        fine_held_out=held(max(steps, FINE_STEPS)),
        upsampling=steps,
        catalogue=catalogue,
        report=report,
        whole=whole,
        budget=Budget(MOST_WORK * simulation_work(drive.n_times, given.plant.n_states)) if budget is None else budget,
    )
    return Setup(given=given, fit=fit, held_out=held_out, floor=known, task=task)


def _followed(floor: NoiseFloor, records: Sequence[Record]) -> NoiseFloor:
    """The floor, but no lower than a simulation can follow: data without noise are those of another integrator."""
    sizes = np.array([np.nanvar(record.outputs, axis=0) for record in records])
    return replace(floor, variance=np.maximum(floor.variance, FOLLOWED**2 * sizes))


def with_uncovered_floor(setup: Setup, nodes: tuple[Node, ...], as_given: Node) -> tuple[Setup, tuple[Node, ...], Node]:
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
    lower = _followed(lowered_floor(setup.floor, records, left), records)
    ratio = setup.floor.variance / lower.variance
    if float(ratio.max()) <= 1.0:
        return setup, nodes, as_given
    task = setup.task
    found = prepare_setup(
        setup.given, setup.fit, setup.held_out, task.catalogue, task.report, floor=lower, budget=task.budget
    )
    n_fit = len(setup.fit)
    scaled = tuple(on_other_floor(node, ratio[:n_fit], ratio[n_fit:]) for node in nodes)
    given = on_other_floor(as_given, ratio[:n_fit], ratio[n_fit:])
    return found, search_effects(scaled[0], found.task, scaled), given


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
            "the model could not be simulated along the records to fit: its motion grows without bound; check the "
            "units of the inputs and the signs of its effects"
        )
    still = Problem(drive=task.fit.drive, floor=task.fit.floor, free_common=False)
    return polished(node_of(estimate(start, still, iterations=6), task), task), calibrated_node(start, task)


def locate_gap(setup: Setup, root: Node, modes: LevelModes | None = None) -> Location:
    """Where the calibrated linear model and the records disagree.

    Args:
        setup: Model, records and floor.
        root: The calibrated model.
        modes: Of the records to fit at each level; found unless given.
    """
    setup.task.report("locating the gap", 0.85)
    gap = measure_gap(setup.fit, simulated_records(setup.fit, root.fitted), setup.floor.variance[: len(setup.fit)])
    return locate(gap, modes=level_modes(setup.fit) if modes is None else modes, lines=measure_lines(setup.fit))


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
    return tuple(fitted.trajectory.outputs[a:b] for a, b in pairwise(firsts))
