"""The pages of a diagnosis: gap over frequency, hypotheses, laws over the data, modes against level, and the words.

"Step by step" plays: the gap of one output, its spectrum, and the gap of each part, one row a step.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from modal.discrepancy.results import Diagnosis, Finding, LawCurve
from modal.localisation.gap import Gap
from modal.plots.discrepancy import draw_gap_spectrum, draw_laws, hypothesis_bars, modes_against_level
from modal.plots.layout import one_panel
from modal.plots.panels import STYLE
from modal.plots.responses import density_label
from modal.recording.discrepancy.series import DiscrepancyPlan, log_histories, log_tables, stage_part
from modal.recording.figure import Palette, Pane, RecordingStream, log_chart, rr, seen_at
from modal.recording.plan import cell, label, name_with_unit
from modal.recording.series import TIMELINE, bucket_length, positions, reduced
from modal.recording.tables import WordLimits, bullets, log_table, log_text, table, unit_cell
from modal.sections import discrepancy_words as words
from modal.sections.discrepancy_stages import Row, Stage, gap_density, level_lines, rows_of
from modal.sections.discrepancy_values import (
    effect_text,
    found_hypothesis,
    found_value,
    size_text,
    step_text,
    times_floor,
    times_text,
)
from okid.arrays import FloatArray

LEVELS: Final = Pane("discrepancy/levels/plot", 1400.0, 520.0)


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
            cell(effect_text(finding.effect)),
            cell(finding.where, 28),
            cell(one.name),
            f"**{found_value(one)}**",
            unit_cell(one.unit, 16),
        ]
        for finding in findings
        for one in finding.parameters
    ]
    return table(["effect", "place", "", "value ± std", "unit"], rows)


def _before_after(plan: DiscrepancyPlan) -> str:
    """The gap by output, in times of the noise floor."""
    rows = [[cell(row.name, 28), *map(times_text, row.sizes)] for row in rows_of(plan.stages) if row.part == "output"]
    heads = ["output, × noise", *(stage.name for stage in plan.stages)]
    return (
        table(heads, rows[: WordLimits.LISTED])
        if rows
        else "The model as given does not run through the held-out records."
    )


VERDICT_TEXT: Final = "discrepancy/verdict"
LAW_TEXT: Final = "discrepancy/law/text"
GAP_TEXT: Final = "discrepancy/gap_text"
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
    strips = [_known(strip) for frame in frames for strip in frame]
    columns = [
        *rr.LineStrips2D.columns(
            strips=strips, colors=colours, radii=[rr.Radius.ui_points(width)] * len(strips)
        ).partition(counts)
    ]
    _send(recording, path, plan, columns)
    recording.log(path, rr.LineStrips2D.from_fields(draw_order=8.0), static=True, strict=True)


def _known(strip: FloatArray) -> FloatArray:
    """A strip without the points that are not known."""
    return strip[np.isfinite(strip).all(axis=1)]


def _send(recording: RecordingStream, path: str, plan: DiscrepancyPlan, columns: Any) -> None:
    index = [
        rr.TimeColumn(STEP, sequence=list(plan.step_numbers)),
        rr.TimeColumn(TIMELINE, duration=list(plan.step_times)),
    ]
    recording.send_columns(path, index, columns, strict=True)
