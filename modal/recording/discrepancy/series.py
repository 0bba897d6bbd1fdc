"""What the recording of a diagnosis will hold, and its held-out records over time: what is drawn, as numbers too.

The held-out records share the timeline "time" as the records of an identification do. The timeline "step" counts the
states of the model, from the model as given (0) on. What changes from step to step is stored on both: on "time" the
steps are spread evenly from the beginning to the end, so that the page plays on either.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from modal.discrepancy.results import Diagnosis
from modal.localisation.gap import Gap
from modal.plots.discrepancy import STAGE_ROLES
from modal.recording.figure import COLOURS, Palette, RecordingStream, rr
from modal.recording.plan import Views, name_with_unit, path_parts
from modal.recording.series import (
    TIMELINE,
    Line,
    StoredRecords,
    laid_out,
    log_lines,
    row_budget,
    stored_levels,
    time_axis,
)
from modal.recording.tables import log_table
from modal.sections.discrepancy_stages import Stage, gap_of, ran_through, rows_of, stages_of, worst_outputs
from modal.sections.discrepancy_values import hypothesis_text, times_floor


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DiscrepancyPlan(StoredRecords):
    """What is shown, where it is stored and when it plays.

    Attributes:
        stages: the model as given, calibrated and as found, with the gap of each.
        step_numbers: numbers of the steps that ran through; only these play.
        step_gaps: the gap of each of them.
        step_times: when each of them stands on the timeline "time" [s].
        output_paths: entity above the series of each output.
        shown_outputs: outputs that have views of their own, those with the largest gap.
        output: the one with the largest gap, which plays step by step.
        record: the held-out record with the largest gap, which plays step by step.
    """

    stages: tuple[Stage, ...]
    step_numbers: tuple[int, ...]
    step_gaps: tuple[Gap, ...]
    step_times: tuple[float, ...]
    output_paths: tuple[str, ...]
    shown_outputs: tuple[int, ...]
    output: int
    record: int


def planned_diagnosis(diagnosis: Diagnosis) -> DiscrepancyPlan:
    """The plan for one diagnosis.

    Raises:
        InvalidDataError: the records reach further than the time axis of a recording does.
    """
    records = diagnosis.held_out
    starts, stops = laid_out(records)
    stages = stages_of(diagnosis)
    numbers = tuple(k for k, step in enumerate(diagnosis.steps) if ran_through(step))
    gaps = {stage.step: stage.gap for stage in stages}
    size = stages[0].gap.in_floors if stages else np.ones((len(records), records[0].n_outputs))
    n_series = 8 * records[0].n_outputs  # measured, simulated and gap of up to three states, noise
    shown = worst_outputs(stages[0].gap, Views.OUTPUTS) if stages else list(range(min(Views.OUTPUTS, size.shape[1])))
    return DiscrepancyPlan(
        stages=stages,
        step_numbers=numbers,
        step_gaps=tuple(gaps[k] if k in gaps else gap_of(diagnosis, diagnosis.steps[k]) for k in numbers),
        step_times=tuple(np.linspace(starts[0], stops[-1], max(len(numbers), 1)).tolist()[: len(numbers)]),
        output_paths=tuple(f"discrepancy/output/{part}" for part in path_parts(records[0].output_names)),
        shown_outputs=tuple(shown),
        output=int(np.argmax(np.nan_to_num(size).mean(axis=0))),
        record=int(np.argmax(np.nan_to_num(size).mean(axis=1))),
        starts=starts,
        stops=stops,
        levels=stored_levels(records, row_budget(n_series, n_series)),
    )


Columns = dict[str, list[object]]


def stage_part(stage: Stage) -> str:
    """The part of an entity path that stands for a state of the model: lines are painted in the order of paths."""
    return {"before": "0_as_given", "linear": "1_calibrated", "after": "2_updated"}[stage.kind]


def log_histories(diagnosis: Diagnosis, recording: RecordingStream, plan: DiscrepancyPlan) -> None:
    """Measured and simulated outputs, the gap of each state of the model, and the band of the noise."""
    times = time_axis(diagnosis.held_out, plan)
    first = diagnosis.held_out[0]
    for output, path in enumerate(plan.output_paths):
        measured = [record.outputs[:, output] for record in diagnosis.held_out]
        name = name_with_unit(first.output_names[output], first.output_units[output])
        line = Line(channels=measured, name=f"{name} measured", colour=Palette.BLUE, width=3.0)
        log_lines(recording, f"{path}/run/0_measured", times, [line], plan=plan)
        for stage in plan.stages:
            colour = COLOURS[STAGE_ROLES[stage.kind]]
            simulated = [run.outputs[:, output] for run in stage.gap.simulated]
            gap = [residual[:, output] for residual in stage.gap.residuals]
            part = stage_part(stage)
            line = Line(channels=simulated, name=f"simulated {stage.name}", colour=colour)
            log_lines(recording, f"{path}/run/1_{part}", times, [line], plan=plan)
            line = Line(channels=gap, name=f"gap {stage.name}", colour=colour, width=1.0)
            log_lines(recording, f"{path}/gap/{part}", times, [line], plan=plan)
        _log_noise(diagnosis, recording, plan, output=output, path=path)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class NumberTable:
    """One table of a diagnosis."""

    path: str
    title: str
    timeline: str
    first: int
    columns: Columns

    @property
    def n_rows(self) -> int:
        """Number of its rows."""
        return max((len(values) for values in self.columns.values()), default=0)


def diagnosis_tables(diagnosis: Diagnosis, plan: DiscrepancyPlan) -> tuple[NumberTable, ...]:
    """Every table that has rows, each on a timeline that counts them from 1; steps count from 0."""
    limits = _fields(diagnosis.detection_limits, _LIMIT)
    made = (
        _table("findings", "Parameters found", "parameter", _findings(diagnosis)),
        _table("evidence", "Evidence", "finding", _evidence(diagnosis)),
        NumberTable(path="discrepancy/steps", title="Steps", timeline="step", first=0, columns=_steps(diagnosis)),
        _table("hypotheses", "Hypotheses", "hypothesis", _hypotheses(diagnosis)),
        _table("gaps", "Gap by record and output", "gap", _gaps(diagnosis)),
        _table("parts", "Gap by part", "part", _parts(plan)),
        _table("level_modes", "Modes against level", "mode_at_level", _level_modes(diagnosis)),
        _table("calibrated", "Linear parameters", "linear_parameter", _fields(diagnosis.calibrated, _CALIBRATED)),
        _table("detection_limits", "What could still hide", "limit", limits),
    )
    return tuple(table for table in made if table.n_rows)


def log_tables(diagnosis: Diagnosis, recording: RecordingStream, plan: DiscrepancyPlan) -> None:
    """Every table of the diagnosis as numbers and words."""
    for table in diagnosis_tables(diagnosis, plan):
        index = np.arange(table.first, table.first + table.n_rows)
        log_table(recording, table.path, table.timeline, index, table.columns)


def _table(name: str, title: str, timeline: str, columns: Columns) -> NumberTable:
    return NumberTable(path=f"discrepancy/{name}", title=title, timeline=timeline, first=1, columns=columns)


_CALIBRATED = ("name", "unit", "nominal", "value", "std", "at_bound")
_LIMIT = ("effect", "where", "parameter", "value", "unit")


def _log_noise(
    diagnosis: Diagnosis, recording: RecordingStream, plan: DiscrepancyPlan, *, output: int, path: str
) -> None:
    """Two deviations of the noise to either side, a straight line over each record."""
    variance = np.asarray(diagnosis.noise_floor.variance)[len(diagnosis.fit) :, output]
    for side, word in ((1.0, "upper"), (-1.0, "lower")):
        times: list[float] = []
        values: list[float] = []
        for start, stop, value in zip(plan.starts, plan.stops, variance, strict=True):
            times += [start, stop, stop + 0.5 * diagnosis.held_out[0].dt]
            values += [side * 2.0 * float(np.sqrt(value))] * 2
        entity = f"{path}/gap/9_noise/{word}"
        # an empty row after each record breaks the line there
        columns = rr.Scalars.columns(scalars=values).partition([1, 1, 0] * len(variance))
        recording.send_columns(entity, [rr.TimeColumn(TIMELINE, duration=times)], columns, strict=True)
        name = f"noise, {'+' if side > 0 else '−'}2 deviations"
        style = rr.SeriesLines(names=name, colors=Palette.GREY, widths=1.0, aggregation_policy="MinMax")
        recording.log(entity, style, static=True, strict=True)


def _steps(diagnosis: Diagnosis) -> Columns:
    return {
        "name": [step.name for step in diagnosis.steps],
        "fit_level": [step.fit_level for step in diagnosis.steps],
        "held_out_level": [step.held_out_level for step in diagnosis.steps],
        "fit_times_floor": [times_floor(step.fit_level) for step in diagnosis.steps],
        "held_out_times_floor": [times_floor(step.held_out_level) for step in diagnosis.steps],
    }


def _findings(diagnosis: Diagnosis) -> Columns:
    rows = [(k, finding, one) for k, finding in enumerate(diagnosis.findings, 1) for one in finding.parameters]
    return {
        "finding": [k for k, _, _ in rows],
        "effect": [finding.effect for _, finding, _ in rows],
        "where": [finding.where for _, finding, _ in rows],
        "parameter_name": [one.name for _, _, one in rows],
        "value": [one.value for _, _, one in rows],
        "std": [one.std for _, _, one in rows],
        "unit": [one.unit for _, _, one in rows],
    }


def _evidence(diagnosis: Diagnosis) -> Columns:
    found = diagnosis.findings
    others = [one.runner_up for one in found]
    return {
        "effect": [one.effect for one in found],
        "where": [one.where for one in found],
        "law": [one.law for one in found],
        "closed": [one.evidence.closed for one in found],
        "log_likelihood": [one.evidence.log_likelihood for one in found],
        "margin": [one.evidence.margin for one in found],
        "runner_up": [hypothesis_text(other) if other else "none" for other in others],
        "ambiguous_with": [", ".join(one.ambiguous_with) or "nothing" for one in found],
    }


def _hypotheses(diagnosis: Diagnosis) -> Columns:
    tried = diagnosis.hypotheses
    return {
        "effects": [hypothesis_text(one) for one in tried],
        "fit_level": [one.fit_level for one in tried],
        "held_out_level": [one.held_out_level for one in tried],
        "fit_times_floor": [times_floor(one.fit_level) for one in tried],
        "held_out_times_floor": [times_floor(one.held_out_level) for one in tried],
        "log_likelihood": [one.log_likelihood for one in tried],
    }


def _gaps(diagnosis: Diagnosis) -> Columns:
    cells = [(i, j) for i in range(len(diagnosis.held_out)) for j in range(diagnosis.held_out[0].n_outputs)]
    variance = np.asarray(diagnosis.noise_floor.variance)[len(diagnosis.fit) :]
    return {
        "record": [diagnosis.held_out[i].name for i, _ in cells],
        "output": [diagnosis.held_out[i].output_names[j] for i, j in cells],
        "unit": [diagnosis.held_out[i].output_units[j] for i, j in cells],
        "before": [diagnosis.gap_before[i, j] for i, j in cells],
        "after": [diagnosis.gap_after[i, j] for i, j in cells],
        "noise": [float(np.sqrt(variance[i, j])) for i, j in cells],
    }


def _parts(plan: DiscrepancyPlan) -> Columns:
    rows = rows_of(plan.stages)
    columns: Columns = {"by": [row.part for row in rows], "name": [row.name for row in rows]}
    for index, stage in enumerate(plan.stages):
        columns[f"times_floor_{stage_part(stage)[2:]}"] = [row.sizes[index] for row in rows]
    return columns


def _level_modes(diagnosis: Diagnosis) -> Columns:
    """Every mode at every level at which it was found, those that tell nothing as well."""
    modes = getattr(diagnosis.location, "modes", None)
    if modes is None:
        return {}
    cells = [(mode, i) for mode in modes.modes for i in np.flatnonzero(np.isfinite(mode.frequencies)).tolist()]
    return {
        "mode": [f"{'pole' if mode.kind == 'real' else 'mode'} {mode.number}" for mode, _ in cells],
        "level": [float(modes.levels[i]) for _, i in cells],
        "frequency": [float(mode.frequencies[i]) for mode, i in cells],
        "frequency_std": [float(mode.frequency_stds[i]) for mode, i in cells],
        "damping_ratio": [float(mode.damping_ratios[i]) for mode, i in cells],
        "damping_ratio_std": [float(mode.damping_ratio_stds[i]) for mode, i in cells],
    }


def _fields(items: Iterable[object], names: tuple[str, ...]) -> Columns:
    listed = tuple(items)
    return {name: [getattr(item, name) for item in listed] for name in names}
