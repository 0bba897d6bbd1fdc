"""The ground of a diagnosis: records and model that belong together, floor, drives, the model before any effect."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from modal.discrepancy.fitting.estimation import Estimate, Problem, estimate, simulate_at
from modal.discrepancy.fitting.nodes import (
    FINE_STEPS,
    Node,
    Task,
    calibrated_node,
    counts,
    node_of,
    on_other_floor,
    polished,
)
from modal.discrepancy.noise.floor import SAME_NUMBER, NoiseFloor, lowered_floor, noise_floor, raised_floor
from modal.discrepancy.noise.spectral import colours_of, lead_of_forces, most_heard, rings, whitening_filter
from modal.discrepancy.results import worst_left
from modal.discrepancy.selection.beam import search_effects
from modal.discrepancy.selection.lack_of_fit import lack_of_fit, only_noise
from modal.effects.ambiguity import Circumstance
from modal.effects.catalogue import by_form
from modal.effects.effect import Effect
from modal.localisation.evidence import Location, locate
from modal.localisation.gap import measure_gap
from modal.localisation.levels import LevelModes, level_modes
from modal.localisation.lines import measure_lines
from modal.simulation import AT_FLOOR, FOLLOWED, NEAR_FLOOR
from modal.simulation.drive import drive_of, steps_per_sample
from modal.simulation.plant import Plant, plant_matrices
from modal.simulation.scheme import Budget
from modal.structure.given import Given, placed_assembly, refuse_missing_inputs
from modal.wording.text import quantity, times_floor_text
from okid.arrays import ROUNDED, TINY, FloatArray
from okid.errors import InsufficientDataError, InvalidDataError, NumericalError
from okid.readers.guard import MEMORY_SHARE, memory_budget
from okid.record import Record
from okid.rows import refuse_copies, same_samples, stretch_of

SAME_LEVEL = 1.25
"""Say that records are of one level whose inputs differ by less than this factor."""

FEWEST_PER_UNKNOWN = 5
"""Refuse records with fewer measured values for each unknown than this."""
FEWEST_SAMPLES, FEWEST_PER_STATE = 64, 10
"""Refuse a record of fewer samples, in all or for each state: its initial state alone fits it."""
MOST_STATES = 40_000
"""Look at so many states in all rows to fit, and as many held out: each of a thousand candidates is simulated there."""
BYTES_A_STATE, BEFORE_RECORDS = 20_000, 0.25 * 2**30
"""Expect a peak of so many for each state in each row, and so many beside them: 9 kB were seen at 27 000 and 11 kB at
80 000 states; with what stands beside them it looks like 31 kB in short records."""
SECONDS_A_STATE = (5e-4, 1e-2)
"""Expect so many CPU seconds for each: 36 s were seen at 27 000 and 81 s at 80 000; slow laws take ten times that."""


def check_records(
    fit: Record | Sequence[Record], held_out: Record | Sequence[Record]
) -> tuple[tuple[Record, ...], tuple[Record, ...], tuple[str, ...]]:
    """The records as tuples, and what the reader must know of them.

    Raises:
        InvalidDataError: If there is none of either, they do not share channels and time step, or two are copies.
    """
    fits = (fit,) if isinstance(fit, Record) else tuple(fit)
    helds = (held_out,) if isinstance(held_out, Record) else tuple(held_out)
    for record in (*fits, *helds):
        if not isinstance(record, Record):
            raise InvalidDataError(
                f"records to fit and held-out records are okid.Record objects; a {type(record).__name__} was given"
            )
    if not fits:
        raise InvalidDataError("there is no record to fit; pass at least one")
    if not helds:
        raise InvalidDataError(
            "there is no held-out record, so nothing could be proved; keep one record, best of another level, out of "
            "the fit"
        )
    _check_alike([*fits, *helds])
    for record in (*fits, *helds):
        if np.isnan(record.outputs).all(axis=0).any():
            raise InvalidDataError(
                f"an output of record {record.name or 'without a name'} is missing throughout; leave the channel out"
            )
        refuse_missing_inputs(record)
        still = np.nanmax(record.outputs, axis=0) == np.nanmin(record.outputs, axis=0)
        if still.all() and not np.ptp(record.inputs, axis=0).any():
            raise InvalidDataError(
                f"nothing moves in record {record.name or 'without a name'}: all its channels stand still through its "
                f"{record.n_samples} samples; leave it out"
            )
    for held in helds:
        if any(held is record or same_samples(held, record) for record in fits):
            raise InvalidDataError(
                f"held-out record {held.name or 'without a name'} is also among the records to fit, so it proves "
                "nothing; hold out another one."
            )
    refuse_copies(fits)
    refuse_copies(helds)
    return fits, helds, _level_notes(fits, helds)


def searched_parts(
    fits: Sequence[Record], helds: Sequence[Record], n_states: int
) -> tuple[tuple[Record, ...], tuple[Record, ...], tuple[str, ...]]:
    """The records, or a stretch of each where they are too long to be searched; the notes name the stretches.

    Raises:
        InvalidDataError: more than `MEMORY_SHARE` of the memory would be needed.
    """
    most = MOST_STATES // min(max(n_states, 1), 6)  # more parameters need no fewer rows
    kept = [tuple(_strong_part(record, side, most) for record in side) for side in (fits, helds)]
    pairs = zip((*kept[0], *kept[1]), (*fits, *helds), strict=True)
    named = ", ".join(part.name for part, record in pairs if part is not record)
    n_rows, (budget, whose) = sum(part.n_samples for part in (*kept[0], *kept[1])), memory_budget()
    need = BYTES_A_STATE * n_rows * n_states
    if need > MEMORY_SHARE * budget:
        raise InvalidDataError(
            f"a search along {n_rows} rows with {n_states} states needs about {need / 2**30:.1f} GiB, more than "
            f"{MEMORY_SHARE:.0%} of the {budget / 2**30:.1f} GiB that {whose}; give shorter records."
        )
    note = (
        f"of records this long a stretch each is looked at ({named}): a search along more than {most} rows to fit, and "
        "as many held out, would take hours and gigabytes; give the stretch that matters"
    )
    return kept[0], kept[1], (note,) if named else ()


def expected_search(
    fits: Sequence[Record], helds: Sequence[Record], n_states: int
) -> tuple[tuple[float, float], float]:
    """CPU seconds, least and most, and bytes that a diagnosis will take, about; stretches of what is too long.

    Example:
        >>> record = Record(np.zeros((500, 1)), np.zeros((500, 1)), 0.01)
        >>> seconds, n_bytes = expected_search([record], [record], 2)
        >>> seconds, f"{n_bytes / 2**30:.2f} GiB"
        ((1.0, 20.0), '0.29 GiB')
    """
    most = MOST_STATES // min(max(n_states, 1), 6)
    work = n_states * sum(min(most, sum(record.n_samples for record in side)) for side in (fits, helds))
    return (SECONDS_A_STATE[0] * work, SECONDS_A_STATE[1] * work), BEFORE_RECORDS + BYTES_A_STATE * work


def _strong_part(record: Record, side: Sequence[Record], most: int) -> Record:
    """The record, or its share of so many rows: the first stretch with half the power of the strongest."""
    total = sum(one.n_samples for one in side)
    if total <= most:
        return record
    length = max(record.n_inputs, record.n_outputs, record.n_samples * most // total)
    starts = range(0, record.n_samples - length + 1, length)
    powers = [_level(record.samples(first, first + length)) ** 2 for first in starts]
    return stretch_of(record, starts[int(np.argmax(np.array(powers) >= 0.5 * max(powers)))], length)


def _check_alike(records: Sequence[Record]) -> None:
    first = records[0]
    for record in records[1:]:
        if (record.n_inputs, record.n_outputs) != (first.n_inputs, first.n_outputs):
            raise InvalidDataError(
                f"records differ in channels: {first.n_inputs} inputs and {first.n_outputs} outputs against "
                f"{record.n_inputs} and {record.n_outputs}; pass the same channels of each"
            )
        if abs(record.dt / first.dt - 1.0) > SAME_NUMBER:
            raise InvalidDataError(
                f"records differ in time step: {first.dt:g} s against {record.dt:g} s; resample one of them"
            )
        if record.input_hold != first.input_hold:
            raise InvalidDataError(
                f"records differ in what inputs do between samples: {first.input_hold} against {record.input_hold}; "
                "declare the same hold for all"
            )
        for kind in ("input", "output"):
            names, others = getattr(first, f"{kind}_names"), getattr(record, f"{kind}_names")
            if names != others and sorted(names) == sorted(others):
                raise InvalidDataError(
                    f"records hold their {kind}s in another order: {', '.join(names)} against {', '.join(others)}; "
                    "select the channels in the same order"
                )
            ours, theirs = getattr(first, f"{kind}_units"), getattr(record, f"{kind}_units")
            if any(a and b and a != b for a, b in zip(ours, theirs, strict=False)):
                raise InvalidDataError(
                    f"records differ in the units of their {kind}s: {', '.join(ours)} against {', '.join(theirs)}; "
                    "convert one of them"
                )


def _level_notes(fits: Sequence[Record], helds: Sequence[Record]) -> tuple[str, ...]:
    sizes = [_level(record) for record in (*fits, *helds)]
    if min(sizes) > 0.0 and max(sizes) / min(sizes) >= SAME_LEVEL:
        return ()
    note = (
        "all records are of one level, at which friction and drag, stops and cubic stiffness, saturation and a gain, "
        "a missing mode and a disturbance look much the same"
    )
    return (note,)


def _level(record: Record) -> float:
    signals = record.inputs if record.n_inputs else record.outputs
    return float(np.sqrt(np.nansum(np.nanmean(signals**2, axis=0))))


def check_plant(plant: Plant, linear: FloatArray, records: Sequence[Record]) -> None:
    """Whether a plant fits records.

    Raises:
        InvalidDataError: Other numbers of inputs or outputs, other units, an unstable plant.
        InsufficientDataError: Records too short for the plant.
    """
    first = records[0]
    if (plant.n_inputs, plant.n_outputs) != (first.n_inputs, first.n_outputs):
        raise InvalidDataError(
            f"the model has {plant.n_inputs} inputs and {plant.n_outputs} outputs, the records have {first.n_inputs} "
            f"and {first.n_outputs}; choose the channels that the model knows"
        )
    for kind in ("input", "output"):
        ours, theirs = getattr(plant, f"{kind}_units"), getattr(first, f"{kind}_units")
        different = [(a, b) for a, b in zip(ours, theirs, strict=False) if a and b and _plain(a) != _plain(b)]
        if different:
            raise InvalidDataError(
                f"the model's {kind} is in {different[0][0]} and the record's in {different[0][1]}; convert one of them"
            )
    if plant.n_states:
        slowest = float(np.abs(np.linalg.eigvals(plant_matrices(plant, linear).A)).min()) / (2.0 * np.pi)
        if slowest > 0.5 / first.dt:
            raise InvalidDataError(
                f"the slowest pole of the model is at {slowest:.4g} Hz, above half the sampling frequency of the "
                f"records ({0.5 / first.dt:.4g} Hz); check the time step, {first.dt:g} s"
            )
        growth = float(np.linalg.eigvals(plant_matrices(plant, linear).A).real.max())
        if growth > SAME_NUMBER * max(1.0 / (first.dt * first.n_samples), TINY) + ROUNDED / first.dt:
            raise InvalidDataError(
                f"the model is unstable (a pole with real part {growth:.3g} 1/s), so it cannot run freely; check its "
                "signs"
            )
    unknowns = len(plant.parameters) + plant.n_states * len(records)
    values = sum(int(np.count_nonzero(~np.isnan(record.outputs))) for record in records)
    if values < FEWEST_PER_UNKNOWN * unknowns:
        raise InsufficientDataError(
            f"{values} measured values are too few for {unknowns} linear parameters and initial states; pass at least "
            f"{FEWEST_PER_UNKNOWN * unknowns}"
        )


def fewest_samples(plant: Plant) -> int:
    """Samples that a record must have for a plant."""
    return max(FEWEST_SAMPLES, FEWEST_PER_STATE * plant.n_states)


def check_long_enough(plant: Plant, records: Sequence[Record]) -> None:
    """Whether each record is long enough to prove anything.

    Raises:
        InsufficientDataError: A record that is too short.
    """
    least = fewest_samples(plant)
    for record in records:
        if record.n_samples < least:
            raise InsufficientDataError(
                f"record {record.name or 'without a name'} has {record.n_samples} samples; a diagnosis with "
                f"{plant.n_states} states needs at least {least} in each record"
            )


def _plain(unit: str) -> str:
    return unit.replace(" ", "").replace("^", "").replace("**", "").replace("²", "2").replace("*", "")


MOST_WORK = 3.2e8
"""End a search that has cost so much work, about 70 CPU seconds whatever the model."""

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
        said: What the reader must know of the floor.
    """

    given: Given
    fit: tuple[Record, ...]
    held_out: tuple[Record, ...]
    floor: NoiseFloor
    task: Task
    said: tuple[str, ...] = ()


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
    """Noise floor and drives of records that a model fits; a floor or a budget of an earlier search goes on.

    Raises:
        InvalidDataError: Model and records that do not match, an unstable model.
        InsufficientDataError: Records too short for the model.
    """
    check_plant(given.plant, given.linear, [*fit, *held_out])
    check_long_enough(given.plant, [*fit, *held_out])
    report("noise floor", 0.0)
    known = _followed(noise_floor([*fit, *held_out]) if floor is None else floor, [*fit, *held_out])
    steps = steps_per_sample(given.plant, given.linear, [*fit, *held_out])
    drive = drive_of(fit, steps)
    n_fit = len(fit)

    named, free = by_form(catalogue)

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
        catalogue=named,
        form_free=free,
        report=report,
        whole=whole,
        budget=Budget(MOST_WORK) if budget is None else budget,
    )
    return Setup(given=given, fit=fit, held_out=held_out, floor=known, task=task)


BY_MODEL = (
    "the records do not show their noise apart from the motion, so it was taken for what the best model leaves: only "
    "whether that depends on anything was tested; records of many cycles, or of some rest, would show it"
)


def _followed(floor: NoiseFloor, records: Sequence[Record]) -> NoiseFloor:
    """The floor, but no lower than a simulation can follow: data without noise are those of another integrator."""
    sizes = np.array([np.nanvar(record.outputs, axis=0) for record in records])
    return replace(floor, variance=np.maximum(floor.variance, FOLLOWED**2 * sizes))


def with_uncovered_floor(setup: Setup, nodes: tuple[Node, ...], as_given: Node) -> tuple[Setup, tuple[Node, ...], Node]:
    """The floor, lower where the best model's residual shows less noise than the records did; then the search goes on.

    Accelerometers under friction or impacts hide their noise below what the motion does; only a model that explains
    the motion uncovers it. And no model leaves less than the noise: where one leaves far less than the floor, the floor
    was none, as that of records of a cycle or two.
    """
    best = min(nodes, key=lambda node: node.held_out_level)
    if best.held_out is None:
        return setup, nodes, as_given
    records = (*setup.fit, *setup.held_out)
    outputs = (*simulated_outputs(best.fitted, setup.fit), *simulated_outputs(best.held_out, setup.held_out))
    left = [record.outputs - simulated for record, simulated in zip(records, outputs, strict=True)]
    lower = lowered_floor(setup.floor, records, left)
    powers = np.array([np.nanmean(errors**2, axis=0) for errors in left])
    below = powers < lower.variance / NEAR_FLOOR
    lower = _followed(replace(lower, variance=np.where(below, powers, lower.variance)), records)
    ratio = setup.floor.variance / lower.variance
    if float(ratio.max()) <= 1.0:
        return setup, nodes, as_given
    task = setup.task
    found = prepare_setup(
        setup.given, setup.fit, setup.held_out, task.every_effect, task.report, floor=lower, budget=task.budget
    )
    n_fit = len(setup.fit)
    scaled = tuple(on_other_floor(node, ratio[:n_fit], ratio[n_fit:]) for node in nodes)
    given = on_other_floor(as_given, ratio[:n_fit], ratio[n_fit:])
    alone = (below | np.isnan(powers)).all(axis=0).any()  # an output whose other records do not show it
    found = replace(found, said=(*setup.said, BY_MODEL) if alone else setup.said)
    return found, search_effects(scaled[0], found.task, scaled), given


def with_coloured_floor(setup: Setup, nodes: tuple[Node, ...], as_given: Node) -> tuple[Setup, tuple[Node, ...], Node]:
    """The floor, higher where the best model leaves more than the floor says, and nothing but noise.

    The quiet band is taken for white, and noise of another colour is stronger where the motion is.
    """
    root, task = nodes[0], setup.task
    best = min(nodes, key=lambda node: node.held_out_level)
    if not any(counts(root, node, task) for node in nodes[1:]) and _from_sensors(root, task):
        best = root
    elif not only_noise(best, root, task):
        return setup, nodes, as_given
    if best.held_out is None or best.held_out_level <= AT_FLOOR:
        return setup, nodes, as_given
    left = np.concatenate([best.fitted.mean_square, best.held_out.mean_square]) * setup.floor.variance
    higher = raised_floor(setup.floor, np.nan_to_num(left))
    said = _noise_or_force(best, setup, float(np.max(higher.variance / setup.floor.variance)))
    ratio, n_fit = setup.floor.variance / higher.variance, len(setup.fit)
    found = prepare_setup(
        setup.given, setup.fit, setup.held_out, task.every_effect, task.report, floor=higher, budget=task.budget
    )
    scaled = tuple(on_other_floor(node, ratio[:n_fit], ratio[n_fit:]) for node in nodes)
    return (
        replace(found, said=(*setup.said, *said)),
        scaled,
        on_other_floor(as_given, ratio[:n_fit], ratio[n_fit:]),
    )


def _noise_or_force(best: Node, setup: Setup, raised: float) -> tuple[str, ...]:
    """How large a force nobody measured could be what is taken for noise of the sensors: nothing tells the two apart.

    At each line that force makes up for what is left above the quiet band, where that is more than the band has.
    """
    found: dict[str, float] = {}
    floors = iter(setup.floor.variance)
    for run, problem in ((best.fitted, setup.task.fit), (best.held_out, setup.task.held_out)):
        drive = problem.drive
        if run is None or run.trajectory.outputs.shape != drive.outputs.shape:
            return ()
        step = int(drive.rows[1] - drive.rows[0])
        for record, floor in zip(range(drive.n_records), floors, strict=False):
            rows = drive.rows_of(record)
            left = np.where(drive.present, drive.outputs - run.trajectory.outputs, 0.0)[rows]
            taps = [whitening_filter(one, there)[0] for one, there in zip(left.T, drive.present[rows].T, strict=True)]
            heard, colours = most_heard(run.scheme, len(left), step), colours_of(taps, len(left))
            above = np.where(colours > 2.0 * floor, colours - floor, 0.0).sum(axis=1)
            for port in run.assembly.plant.ports:
                reply = heard[:, :, list(port.columns)].sum(axis=(1, 2))
                size = float(np.sqrt(np.mean(above / np.maximum(reply, TINY))))
                found[port.name] = max(found.get(port.name, 0.0), size)
    units = {port.name: port.force_unit for port in setup.given.plant.ports}
    where = min(found, key=lambda name: found[name], default="")
    sized = where and found[where] > 0.0  # no line may stand out of the band by itself
    force = f", of {quantity(found[where], units[where])} at {where} or more elsewhere," if sized else ""
    words = (
        f"what is left, {times_floor_text(raised)} times what the sensors' quiet band says, depends on nothing and is "
        f"taken for noise of the sensors; a force that nobody measured{force} would look the same: another sensor, "
        "which shows such a force too and has noise of its own, would tell"
    )
    return (words,)


def _from_sensors(root: Node, task: Task) -> bool:
    """Whether what the calibrated model leaves is noise of the sensors, of whatever colour.

    It depends on nothing, and does not ring as all that a force on a ringing structure leaves: of a structure that does
    not ring (a motor, a tank) nobody knows. Where white noise hides the ringing the spectra are compared: that of a
    white force at a place of the structure beside white noise must explain what is left worse than an autoregression.
    """
    parts = [(root.fitted, task.fit), (root.held_out, task.held_out)]
    poles = np.linalg.eigvals(root.fitted.scheme.Ad)
    if not rings(poles).all() or worst_left(lack_of_fit(root, task, known=len(root.effects))) is not None:
        return False
    lead = np.zeros(root.fitted.scheme.E0.shape[1] + root.fitted.scheme.B0.shape[1])
    for run, problem in parts:
        drive = problem.drive
        if run is None or run.trajectory.outputs.shape != drive.outputs.shape or not drive.present.all():
            return False
        step = int(drive.rows[1] - drive.rows[0])
        for record in range(drive.n_records):
            rows = drive.rows_of(record)
            left = drive.outputs[rows] - run.trajectory.outputs[rows]
            taps = [whitening_filter(one, np.ones(len(one), dtype=bool))[0] for one in left.T]
            if any(rings(np.roots(one)).any() for one in taps):
                return False
            lead += lead_of_forces(left, taps, root.fitted.scheme, step)
    return bool(np.max(lead, initial=0.0) <= 0.0)


def roots(setup: Setup) -> tuple[Node, Node]:
    """The model as given, only initial states fitted; and calibrated.

    Raises:
        NumericalError: If the model cannot be simulated along the records.
    """
    given, task = setup.given, setup.task
    task.report("calibrating the linear parameters", 0.02)
    assembly, unknowns = placed_assembly(given.plant, given.linear, given.effects, task.fit.drive, task.every_effect)
    start = simulate_at(assembly, unknowns, task.fit)
    if start is None:
        raise NumericalError(
            "the model could not be simulated along the records to fit: its motion grows without bound; check the "
            "units of the inputs and the signs of its effects"
        )
    still = Problem(drive=task.fit.drive, floor=task.fit.floor, free_common=False)
    return polished(node_of(estimate(start, still, iterations=6), task), task), calibrated_node(start, task)


def locate_gap(setup: Setup, root: Node, modes: LevelModes | None = None) -> Location:
    """Where the calibrated linear model and the records disagree."""
    setup.task.report("locating the gap", 0.04)
    gap = measure_gap(setup.fit, simulated_records(setup.fit, root.fitted), setup.floor.variance[: len(setup.fit)])
    return locate(gap, modes=level_modes(setup.fit) if modes is None else modes, lines=measure_lines(setup.fit))


def simulated_records(records: Sequence[Record], fitted: Estimate) -> list[Record]:
    """The records with the model's outputs."""
    runs = zip(records, simulated_outputs(fitted, records), strict=True)
    return [replace(record, outputs=outputs) for record, outputs in runs]


def simulated_outputs(fitted: Estimate, records: Sequence[Record]) -> tuple[FloatArray, ...]:
    """The model's outputs along each record."""
    firsts = np.concatenate([[0], np.cumsum([record.n_samples for record in records])])
    return tuple(fitted.trajectory.outputs[a:b] for a, b in pairwise(firsts))


def _scales(plant: Plant) -> bool:
    """Whether masses may be off that no input moves along with: then larger ones are a weaker drive."""
    inputs = slice(plant.n_states, plant.n_states + plant.n_inputs)
    return bool(plant.masses) and not any(one.system[:, inputs].any() for one in plant.masses)


def circumstances_of(plant: Plant, fits: Sequence[Record], node: Node) -> frozenset[Circumstance]:
    """What holds of the plant, its records and a model's motion along them, for the table of ambiguities."""
    found: set[Circumstance] = set()
    if plant.n_states <= 2 and plant.n_outputs == 1 and plant.n_inputs <= 1:
        found.add("one_dof")
    per_mass = [port for port in plant.ports if port.mass is not None and port.force_unit == f"{port.length_unit}/s^2"]
    if per_mass and "one_dof" not in found:
        found.add("unknown_masses")  # forces are counted per effective mass
    if node.masses and plant.n_inputs == 1:
        found.add("other_masses")
    if "other_masses" in found or (plant.n_inputs == 1 and _scales(plant)):
        found.add("one_drive")
    if plant.n_outputs == 1:
        found.add("one_output")
    sizes = [float(np.sqrt(np.nansum(np.nanvar(r.inputs if r.n_inputs else r.outputs, axis=0)))) for r in fits]
    if min(sizes) <= 0.0 or max(sizes) / min(sizes) < SAME_LEVEL:
        found.add("one_level")
    n = plant.n_states
    states = node.coarse.trajectory.states[:, :n]
    drive = node.coarse.trajectory.drive
    speeds = [
        states @ port.velocity[:n] + drive.sample @ port.velocity[n:]
        for port in plant.ports
        if port.velocity is not None
    ]
    if speeds and all(min(-speed.min(), speed.max()) < 0.01 * np.abs(speed).max() for speed in speeds):
        found.add("one_way")
    return frozenset(found)
