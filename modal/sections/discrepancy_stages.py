"""The gap before, in between and after: what every page of a diagnosis shows, cut once by output, band and level."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from modal.discrepancy.results import Diagnosis, Step
from modal.localisation.gap import Gap, measure_gap
from okid.arrays import FloatArray
from okid.record import Record

__all__ = ["Row", "Stage", "held_out_floor", "rows_of", "stages_of", "worst_outputs"]

Part = Literal["output", "record", "band"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Stage:
    """The held-out gap of one state of the model.

    Attributes:
        name: as a reader calls it: "as given", "calibrated", "with cubic stiffness".
        kind: "before" (the model as given), "linear" (calibrated, no effect added), or "after".
        step: its number among the steps, from 0.
        gap: on the held-out records.
    """

    name: str
    kind: Literal["before", "linear", "after"]
    step: int
    gap: Gap


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Row:
    """A part of the held-out data, before and after; each number is a root mean square over the noise floor's.

    Attributes:
        part: what it is a part by.
        name: which one.
        sizes: one a stage.
    """

    part: Part
    name: str
    sizes: tuple[float, ...]


def held_out_floor(diagnosis: Diagnosis) -> FloatArray:
    """(n_held_out, n_outputs) variance of the noise of the held-out records."""
    variance: FloatArray = np.asarray(diagnosis.noise_floor.variance)[len(diagnosis.fit) :]
    return variance


def stages_of(diagnosis: Diagnosis) -> tuple[Stage, ...]:
    """The model as given, calibrated, and as found, each with its gap; those that did not run through are left out."""
    last = len(diagnosis.steps) - 1
    chosen = {0: "before", last: "after"}
    for number, step in enumerate(diagnosis.steps):
        if step.name == "calibrated" and number not in chosen:
            chosen[number] = "linear"
    return tuple(
        Stage(name=_stage_name(diagnosis, number), kind=kind, step=number, gap=gap_of(diagnosis, step))  # type: ignore[arg-type]  # kind is one of the three words above
        for number, kind in sorted(chosen.items())
        if ran_through(step := diagnosis.steps[number])
    )


def ran_through(step: Step) -> bool:
    """Whether every simulated sample is a number: a model that escapes has none from some time on, or no run at all."""
    return bool(step.simulated) and all(bool(np.isfinite(values).all()) for values in step.simulated)


def gap_of(diagnosis: Diagnosis, step: Step) -> Gap:
    """The held-out gap of a step."""
    simulated = [
        replace(record, outputs=values) for record, values in zip(diagnosis.held_out, step.simulated, strict=True)
    ]
    return measure_gap(diagnosis.held_out, simulated, held_out_floor(diagnosis))


def worst_outputs(gap: Gap, most: int) -> list[int]:
    """The outputs with the greatest gap in units of the floor, at most so many, in the order of the record."""
    size = np.nan_to_num(gap.in_floors.mean(axis=0))
    return sorted(np.argsort(-size, kind="stable")[:most].tolist())


def rows_of(stages: Sequence[Stage]) -> tuple[Row, ...]:
    """The gap by output, by record (quiet ones first) and by frequency band, all in units of the floor."""
    if not stages:
        return ()
    first = stages[0].gap
    rows = [
        Row(part="output", name=name, sizes=tuple(_root(stage.gap.in_floors[:, i].mean()) for stage in stages))
        for i, name in enumerate(first.output_names)
    ]
    for i in np.argsort(first.levels, kind="stable").tolist():
        name = record_name(first.measured[i], i)
        rows.append(
            Row(part="record", name=name, sizes=tuple(_root(stage.gap.in_floors[i].mean()) for stage in stages))
        )
    for i, band in enumerate(first.bands.bands):
        if (first.bands.n_lines[:, i] > 0).any():
            rows.append(Row(part="band", name=band.name, sizes=tuple(_band_size(stage.gap, i) for stage in stages)))
    return tuple(rows)


def record_name(record: Record, number: int) -> str:
    """What a held-out record is called."""
    return record.name or f"held-out record {number + 1}"


def _stage_name(diagnosis: Diagnosis, number: int) -> str:
    name = diagnosis.steps[number].name
    if number == len(diagnosis.steps) - 1 and diagnosis.findings:
        return "with the effect" if len(diagnosis.findings) == 1 else "with the effects"
    return name


def _band_size(gap: Gap, band: int) -> float:
    """Over all records and outputs, each output in units of its own floor in the band."""
    power, floor = gap.bands.power[:, band], gap.bands.floor[:, band]
    there = np.isfinite(power) & (floor > 0.0)
    return _root(float(np.mean(power[there] / floor[there]))) if there.any() else float("nan")


def _root(value: float) -> float:
    return float(np.sqrt(value)) if value >= 0.0 else float("nan")
