"""Model and records that belong together, or one sentence that says why they do not."""

from collections.abc import Sequence

import numpy as np

from modal.simulation.plant import Plant, plant_matrices
from modal.simulation.tolerances import ROUNDING
from okid.arrays import TINY, FloatArray
from okid.errors import InsufficientDataError, InvalidDataError
from okid.record import Record

__all__ = ["check_long_enough", "check_plant", "check_records", "fewest_samples"]

SAME_LEVEL = 1.25
"""Records whose inputs differ by less than this factor are of one level."""

RADIUS = 1e-6
FEWEST_PER_UNKNOWN = 5
FEWEST_SAMPLES, FEWEST_PER_STATE = 64, 10
"""Samples that every record must have: a shorter one proves nothing, its initial state alone fits it."""


def check_records(
    fit: Record | Sequence[Record], held_out: Record | Sequence[Record]
) -> tuple[tuple[Record, ...], tuple[Record, ...], tuple[str, ...]]:
    """The records as tuples, and what the reader must know of them.

    Args:
        fit: Records to fit.
        held_out: Held-out records.

    Returns:
        Records to fit, held-out records, notes.

    Raises:
        InvalidDataError: If there is none of either, or they do not share channels and time step.
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
        unknown = int(np.isnan(record.inputs).any(axis=1).sum())
        if unknown:
            raise InvalidDataError(
                f"the inputs of record {record.name or 'without a name'} are missing (NaN) at {unknown} of "
                f"{record.n_samples} samples, so no model can be simulated along it; cut the record there, or fill them"
            )
    for held in helds:
        if any(held is record or _same(held, record) for record in fits):
            raise InvalidDataError(
                f"held-out record {held.name or 'without a name'} is also among the records to fit, so it proves "
                "nothing; hold out another one"
            )
    return fits, helds, _level_notes(fits, helds)


def _same(one: Record, other: Record) -> bool:
    if one.outputs.shape != other.outputs.shape or not np.array_equal(one.inputs, other.inputs):
        return False
    return np.array_equal(one.outputs, other.outputs, equal_nan=True)


def _check_alike(records: Sequence[Record]) -> None:
    first = records[0]
    for record in records[1:]:
        if (record.n_inputs, record.n_outputs) != (first.n_inputs, first.n_outputs):
            raise InvalidDataError(
                f"records differ in channels: {first.n_inputs} inputs and {first.n_outputs} outputs against "
                f"{record.n_inputs} and {record.n_outputs}; pass the same channels of each"
            )
        if abs(record.dt / first.dt - 1.0) > RADIUS:
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

    Args:
        plant: The plant.
        linear: Values of its linear parameters.
        records: Records to compare it with.

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
        if growth > RADIUS * max(1.0 / (first.dt * first.n_samples), TINY) + ROUNDING / first.dt:
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

    Args:
        plant: The plant.
        records: Records to fit and held out.

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
