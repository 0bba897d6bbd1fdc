"""The pages of a diagnosis: histories, gap over frequency, hypotheses, laws, modes against level, words and tables.

The held-out records share the timeline "time" as the records of an identification do. The timeline "step" counts the
states of the model, from the model as given (0) on. What changes from step to step is stored on both: on "time" the
steps are spread evenly from the beginning to the end, so that the page "step by step" (the gap of one output, its
spectrum, and the gap of each part, one row a step) plays on either.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from modal.discrepancy.results import Diagnosis, Finding, Hypothesis, LawCurve, Step
from modal.localisation.gap import Gap
from modal.plots.chart import one_panel
from modal.plots.discrepancy import STAGE_ROLES, draw_gap_spectrum, draw_laws, hypothesis_bars, modes_against_level
from modal.plots.panels import STYLE
from modal.plots.responses import density_label
from modal.recording.figure import COLOURS, Palette, Pane, RecordingStream, log_chart, rr, seen_at
from modal.recording.plan import (
    Views,
    WordLimits,
    bullets,
    cell,
    label,
    log_table,
    log_text,
    name_with_unit,
    path_parts,
    table,
    unit_cell,
)
from modal.recording.series import (
    TIMELINE,
    Line,
    StoredRecords,
    bucket_length,
    laid_out,
    log_lines,
    positions,
    reduced,
    row_budget,
    stored_levels,
    time_axis,
)
from modal.sections import discrepancy_words as words
from modal.sections.discrepancy_stages import (
    Row,
    Stage,
    effect_text,
    found_hypothesis,
    found_value,
    gap_density,
    gap_of,
    hypothesis_text,
    level_lines,
    ran_through,
    rows_of,
    size_text,
    stages_of,
    step_text,
    times_floor,
    times_text,
    worst_outputs,
)
from okid.arrays import FloatArray


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
    made = (
        _table("findings", "Parameters found", "parameter", _findings(diagnosis)),
        _table("evidence", "Evidence", "finding", _evidence(diagnosis)),
        NumberTable(path="discrepancy/steps", title="Steps", timeline="step", first=0, columns=_steps(diagnosis)),
        _table("hypotheses", "Hypotheses", "hypothesis", _hypotheses(diagnosis)),
        _table("gaps", "Gap by record and output", "gap", _gaps(diagnosis)),
        _table("parts", "Gap by part", "part", _parts(plan)),
        _table("level_modes", "Modes against level", "mode_at_level", _level_modes(diagnosis)),
        _table("calibrated", "Linear parameters", "linear_parameter", _fields(diagnosis.calibrated, _CALIBRATED)),
        _table("detection_limits", "What could still hide", "limit", _fields(diagnosis.detection_limits, _LIMIT)),
    )
    return tuple(one for one in made if one.n_rows)


def log_tables(diagnosis: Diagnosis, recording: RecordingStream, plan: DiscrepancyPlan) -> None:
    """Every table of the diagnosis as numbers and words."""
    for one in diagnosis_tables(diagnosis, plan):
        log_table(recording, one.path, one.timeline, np.arange(one.first, one.first + one.n_rows), one.columns)


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
    return _fields(diagnosis.steps, ("name",)) | _levels(diagnosis.steps)


def _levels(of: tuple[Step, ...] | tuple[Hypothesis, ...]) -> Columns:
    return _fields(of, ("fit_level", "held_out_level")) | {
        "fit_times_floor": [times_floor(one.fit_level) for one in of],
        "held_out_times_floor": [times_floor(one.held_out_level) for one in of],
    }


def _findings(diagnosis: Diagnosis) -> Columns:
    rows = [(k, finding, one) for k, finding in enumerate(diagnosis.findings, 1) for one in finding.parameters]
    named: Columns = {
        "finding": [k for k, _, _ in rows],
        "effect": [finding.effect for _, finding, _ in rows],
        "where": [finding.where for _, finding, _ in rows],
        "parameter_name": [one.name for _, _, one in rows],
    }
    return named | _fields((one for _, _, one in rows), ("value", "std", "unit"))


def _evidence(diagnosis: Diagnosis) -> Columns:
    found = diagnosis.findings
    evidence = _fields((one.evidence for one in found), ("closed", "log_likelihood", "margin"))
    others = [one.runner_up for one in found]
    return (
        _fields(found, ("effect", "where", "law"))
        | evidence
        | {
            "runner_up": [hypothesis_text(other) if other else "none" for other in others],
            "ambiguous_with": [", ".join(one.ambiguous_with) or "nothing" for one in found],
        }
    )


def _hypotheses(diagnosis: Diagnosis) -> Columns:
    tried = diagnosis.hypotheses
    effects: Columns = {"effects": [hypothesis_text(one) for one in tried]}
    return effects | _levels(tried) | _fields(tried, ("log_likelihood",))


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


def verdict_text(diagnosis: Diagnosis, plan: DiscrepancyPlan) -> str:
    """The verdict, the numbers found, before and after, what it cannot be told from, and what to do next."""
    judgement = words.judge_diagnosis(diagnosis)
    parts = [f"### {cell(words.diagnosis_headline(diagnosis))}", f"**{judgement.label}.**"]
    parts += [f"**Read this:** {cell(warning)}" for warning in words.read_first(diagnosis)]
    if diagnosis.findings:
        parts.append(_parameters(diagnosis.findings))
    parts.append(_before_after(plan))
    runners_up = [words.runner_up_sentence(finding) for finding in diagnosis.findings if finding.runner_up]
    parts += bullets(judgement.reasons, runners_up)
    parts += ["**Next**", *bullets(words.next_steps(diagnosis))]
    limits = words.hidden_sentence(diagnosis)
    return "\n\n".join([*parts, *([cell(limits)] if limits else [])])


def law_text(diagnosis: Diagnosis) -> str:
    """Every finding with its law, its signature and what speaks for it; then where the two disagree."""
    parts = []
    for number, finding in enumerate(diagnosis.findings, start=1):
        name = f"{words.capital(effect_text(finding.effect))} at {finding.where}"
        parts += [f"### {number}. {cell(name)}", f"Law: **{cell(finding.law)}** (`{cell(finding.effect)}`)"]
        parts += bullets(
            [
                f"How it shows: {words.as_sentence(finding.signature)}",
                words.as_sentence(finding.evidence.words),
                words.runner_up_sentence(finding),
            ]
        )
    where = words.where_sentences(diagnosis)
    if where:
        parts += ["### Where they disagree, before any effect was tried", *bullets(where)]
    return "\n\n".join(parts) or "No effect was found."


def gap_text(diagnosis: Diagnosis, plan: DiscrepancyPlan) -> str:
    """The gap part by part and output by output, and from what the noise floor was found."""
    floor = np.sqrt(np.asarray(diagnosis.noise_floor.variance)[len(diagnosis.fit) :])
    rows = [
        [
            cell(record.name or f"held-out record {i + 1}", 40),
            cell(name, 28),
            size_text(float(diagnosis.gap_before[i, j])),
            f"**{size_text(float(diagnosis.gap_after[i, j]))}**",
            size_text(float(floor[i, j])),
            unit_cell(record.output_units[j]),
        ]
        for i, record in enumerate(diagnosis.held_out)
        for j, name in enumerate(record.output_names)
    ]
    parts = ["### Held-out gap, root mean square"]
    parts.append(table(["record", "output", "as given", "updated model", "noise", "unit"], rows[: WordLimits.LISTED]))
    if plan.stages:
        heads = ["by", "part", *(stage.name for stage in plan.stages)]
        sizes = [[row.part, cell(row.name, 40), *map(times_text, row.sizes)] for row in rows_of(plan.stages)]
        parts += ["### The same in times of the noise floor", table(heads, sizes[: WordLimits.LISTED])]
    return "\n\n".join([*parts, *bullets(words.floor_sentences(diagnosis))])


def step_document(diagnosis: Diagnosis, number: int) -> str:
    """One step: what it added, and what is left after it and after each of the others."""
    step = diagnosis.steps[number]
    rows = [
        [
            f"**{cell(step_text(one.name))}**" if k == number else cell(step_text(one.name)),
            times_text(times_floor(one.fit_level)),
            times_text(times_floor(one.held_out_level)),
        ]
        for k, one in enumerate(diagnosis.steps)
    ]
    left = times_text(times_floor(step.held_out_level))
    return "\n\n".join(
        [
            f"### Step {number} of {len(diagnosis.steps) - 1}: {cell(step_text(step.name))}",
            f"On held-out data **{left}** times the noise floor are left (1 is noise and no more).",
            table(["step", "fitted to", "held out"], rows),
            "Play the timeline `step` (or `time`): the gap shrinks.",
        ]
    )


def _parameters(findings: tuple[Finding, ...]) -> str:
    rows = [
        [
            cell(effect_text(of.effect)),
            cell(of.where, 28),
            cell(one.name),
            f"**{found_value(one)}**",
            unit_cell(one.unit, 16),
        ]
        for of in findings
        for one in of.parameters
    ]
    return table(["effect", "place", "", "value ± std", "unit"], rows)


def _before_after(plan: DiscrepancyPlan) -> str:
    """The gap by output, in times of the noise floor."""
    rows = [[cell(row.name, 28), *map(times_text, row.sizes)] for row in rows_of(plan.stages) if row.part == "output"]
    if not rows:
        return "The model as given does not run through the held-out records."
    return table(["output, × noise", *(stage.name for stage in plan.stages)], rows[: WordLimits.LISTED])


VERDICT_TEXT: Final = "discrepancy/verdict"
LAW_TEXT: Final = "discrepancy/law/text"
GAP_TEXT: Final = "discrepancy/gap_text"
LEVELS: Final = Pane("discrepancy/levels/plot", 1400.0, 520.0)
HYPOTHESES: Final = Pane("discrepancy/hypotheses/plot", 520.0, 400.0)


class GapLimits:
    """How much of a diagnosis is drawn."""

    SHOWN: Final = 6
    """Draw so many hypotheses and so many laws, the best first."""


def spectrum_pane(output: int) -> Pane:
    """Where the spectrum of an output's gap is drawn."""
    return Pane(f"discrepancy/spectrum/{output + 1:02d}/plot", 520.0, 400.0)


def law_panes(diagnosis: Diagnosis) -> tuple[Pane, ...]:
    """Where each law is drawn, in the shape that its view will have on a common screen."""
    n_laws = len(diagnosis.laws[: GapLimits.SHOWN])
    width, height = {1: (900.0, 720.0), 2: (900.0, 370.0)}.get(n_laws, (480.0, 390.0))
    return tuple(Pane(f"discrepancy/law/{k + 1:02d}/plot", width, height) for k in range(n_laws))


def log_discrepancy_page(diagnosis: Diagnosis, recording: RecordingStream, plan: DiscrepancyPlan) -> None:
    """Series, spectra, hypotheses, laws, words and tables."""
    log_histories(diagnosis, recording, plan)
    log_tables(diagnosis, recording, plan)
    _log_spectra(diagnosis, recording, plan)
    shown = diagnosis.hypotheses[: GapLimits.SHOWN]
    if shown:
        log_chart(recording, HYPOTHESES, hypothesis_bars(shown, chosen=found_hypothesis(diagnosis)))
    levels = level_lines(diagnosis)
    if levels:
        log_chart(recording, LEVELS, modes_against_level(levels))
    for number, law in enumerate(diagnosis.laws):
        _log_law(recording, law, number)
    for pane, law in zip(law_panes(diagnosis), diagnosis.laws, strict=False):
        log_chart(recording, pane, draw_laws([law]))
    log_text(recording, VERDICT_TEXT, verdict_text(diagnosis, plan))
    log_text(recording, LAW_TEXT, law_text(diagnosis))
    log_text(recording, GAP_TEXT, gap_text(diagnosis, plan))


def _log_spectra(diagnosis: Diagnosis, recording: RecordingStream, plan: DiscrepancyPlan) -> None:
    """All as numbers, those of the shown outputs as lines."""
    if not plan.stages:
        return
    density = gap_density([stage.gap for stage in plan.stages])
    lines = np.arange(1, density.frequency.size + 1)
    for output in range(diagnosis.held_out[0].n_outputs):
        columns = {
            "frequency": density.frequency,
            "measured": density.measured[:, output],
            "noise": np.full(density.frequency.size, density.noise[output]),
        }
        columns |= {
            f"gap_{stage_part(stage)[2:]}": gap[:, output] for stage, gap in zip(plan.stages, density.gaps, strict=True)
        }
        log_table(recording, f"discrepancy/spectrum/{output + 1:02d}/numbers", "frequency_line", lines, columns)
    for output in plan.shown_outputs:
        chart, panel = one_panel(STYLE.page, STYLE.page)
        draw_gap_spectrum(panel, density, plan.stages, output)
        panel.y.label, panel.key = _density_title(diagnosis, output), "best"
        log_chart(recording, spectrum_pane(output), chart)


def _log_law(recording: RecordingStream, law: LawCurve, number: int) -> None:
    """The curve, the points and the loop as tables."""
    path = f"discrepancy/law/{number + 1:02d}"
    for name, timeline, columns in (
        ("curve", "grid", {"motion": law.motion, "force": law.force, "std": law.deviation}),
        ("points", "bin", {"motion": law.points_motion, "force": law.points_force, "std": law.points_deviation}),
        ("loop", "loop_point", {"motion": law.loop_motion, "force": law.loop_force}),
    ):
        log_table(recording, f"{path}/{name}", timeline, np.arange(1, columns["motion"].size + 1), columns)


def _density_title(diagnosis: Diagnosis, output: int) -> str:
    first = diagnosis.held_out[0]
    return f"gap of {label(first.output_names[output])} [{density_label(first.output_units[output])}]"


def law_title(law: LawCurve) -> str:
    """What a law's view is called."""
    return f"{effect_text(law.effect)} at {label(law.where)}"


STEP: Final = "step"
STEP_GAP: Final = Pane("discrepancy/steps/gap/plot", 1400.0, 335.0)
STEP_SPECTRUM: Final = Pane("discrepancy/steps/spectrum/plot", 520.0, 400.0)
STEP_PARTS: Final = Pane("discrepancy/steps/parts/plot", 520.0, 400.0)
STEP_TEXT: Final = "discrepancy/steps/text"


def log_steps_page(diagnosis: Diagnosis, recording: RecordingStream, plan: DiscrepancyPlan) -> None:
    """Frames once, and what changes once a step; nothing where no step ran through."""
    if not plan.step_gaps:
        return
    _draw_gap(diagnosis, recording, plan)
    _draw_spectrum(diagnosis, recording, plan)
    _draw_parts(recording, plan)
    texts = [step_document(diagnosis, number) for number in plan.step_numbers]
    columns = rr.TextDocument.columns(text=texts, media_type=[rr.MediaType.MARKDOWN] * len(texts))
    _send(recording, STEP_TEXT, plan, columns)


def _draw_gap(diagnosis: Diagnosis, recording: RecordingStream, plan: DiscrepancyPlan) -> None:
    record = diagnosis.held_out[plan.record]
    bucket = bucket_length(record.n_samples, 4000)
    times = record.start_time + record.dt * positions(record.n_samples, bucket)
    curves = [reduced(gap.residuals[plan.record][:, plan.output], bucket) for gap in plan.step_gaps]
    noise = 2.0 * float(np.sqrt(plan.step_gaps[0].floor[plan.record, plan.output]))
    reach = max(1.05 * max(float(np.nanmax(np.abs(curve))) for curve in curves), 1.5 * noise)
    name = name_with_unit(record.output_names[plan.output], record.output_units[plan.output])
    chart, panel = one_panel(STYLE.page, STYLE.page)
    panel.line(times, curves[0], "residual", width=STYLE.thin, opacity=STYLE.half, label="as given")
    panel.line([], [], "model", label="this step")
    panel.line([], [], "system", label="the last")
    panel.box_of((-np.inf, np.inf), (-noise, noise), "muted", opacity=STYLE.half, label="noise, ±2 deviations")
    panel.x.limits, panel.y.limits = (float(times[0]), float(times[-1])), (-reach, reach)
    panel.x.label, panel.y.label, panel.key = "time [s]", f"gap of {name}, held out", "best"
    log_chart(recording, STEP_GAP, chart)
    _play_lines(recording, plan, f"{STEP_GAP.path}/3_now", [[seen_at(panel, times, curve)] for curve in curves])


def _draw_spectrum(diagnosis: Diagnosis, recording: RecordingStream, plan: DiscrepancyPlan) -> None:
    density = gap_density(plan.step_gaps)
    first = Stage(name="as given", kind="before", step=0, gap=plan.step_gaps[0])
    chart, panel = one_panel(STYLE.page, STYLE.page)
    draw_gap_spectrum(panel, replace(density, gaps=density.gaps[:1]), [first], plan.output)
    panel.line([], [], "model", label="gap now")
    panel.y.label, panel.key = _density_title(diagnosis, plan.output), "best"
    log_chart(recording, STEP_SPECTRUM, chart)
    strips = [[seen_at(panel, density.frequency, gap[:, plan.output])] for gap in density.gaps]
    _play_lines(recording, plan, f"{STEP_SPECTRUM.path}/3_now", strips, width=STYLE.stroke)


def _draw_parts(recording: RecordingStream, plan: DiscrepancyPlan) -> None:
    """A bar a part, as long as its gap is in times of the noise floor."""
    rows = _shown(plan.step_gaps)
    sizes = [size for row in rows for size in row.sizes if np.isfinite(size) and size > 0]
    chart, panel = one_panel(STYLE.page, STYLE.page)
    panel.x.log = True
    panel.x.limits = panel.x.fitted(np.array([0.7, 3.0, *sizes]))
    panel.x.label, panel.head = "times the noise floor", "gap by output, record and band"
    panel.y.ticks = [(float(k), f"{row.part}: {label(row.name, 40)}") for k, row in enumerate(rows)]
    panel.y.limits, panel.y.grid = (len(rows) - 0.5, -0.9), False
    panel.upright(1.0, "muted", label="noise floor")
    ends = [[[-np.inf, k], [row.sizes[0], k]] for k, row in enumerate(rows) if np.isfinite(row.sizes[0])]
    panel.segments(ends, "residual", width=3.0, opacity=STYLE.half)
    log_chart(recording, STEP_PARTS, chart)
    bars = [
        [seen_at(panel, [-np.inf, size if np.isfinite(size) else -np.inf], [k, k]) for k, size in enumerate(step)]
        for step in zip(*(row.sizes for row in rows), strict=True)
    ]
    _play_lines(recording, plan, f"{STEP_PARTS.path}/2_now", bars, width=5.0)


def _shown(gaps: Sequence[Gap]) -> list[Row]:
    """The outputs, records and bands with the largest gap at first, in their order."""
    stages = [Stage(name="", kind="after", step=k, gap=gap) for k, gap in enumerate(gaps)]
    rows = rows_of(stages)
    order = np.argsort([-np.nan_to_num(row.sizes[0]) for row in rows], kind="stable")[:7]
    return [rows[k] for k in sorted(order.tolist())]


def _play_lines(
    recording: RecordingStream,
    plan: DiscrepancyPlan,
    path: str,
    frames: Sequence[Sequence[FloatArray]],
    *,
    width: float = 1.0,
) -> None:
    """One row of line strips a step: orange on the way, green at the last."""
    counts = [len(strips) for strips in frames]
    last = len(frames) - 1
    colours = [Palette.GREEN if k == last else Palette.ORANGE for k, count in enumerate(counts) for _ in range(count)]
    known = [strip[np.isfinite(strip).all(axis=1)] for frame in frames for strip in frame]
    radii = [rr.Radius.ui_points(width)] * len(known)
    columns = [*rr.LineStrips2D.columns(strips=known, colors=colours, radii=radii).partition(counts)]
    _send(recording, path, plan, columns)
    recording.log(path, rr.LineStrips2D.from_fields(draw_order=8.0), static=True, strict=True)


def _send(recording: RecordingStream, path: str, plan: DiscrepancyPlan, columns: Any) -> None:
    index = [
        rr.TimeColumn(STEP, sequence=list(plan.step_numbers)),
        rr.TimeColumn(TIMELINE, duration=list(plan.step_times)),
    ]
    recording.send_columns(path, index, columns, strict=True)
