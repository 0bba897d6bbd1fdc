"""The page "Discrepancy": spectrum of the gap, hypotheses, laws over the data, all drawn, and the verdict in words.

Modes against level in the recording: change of frequency and damping ratio, drawn where they tell something.

The pages of a diagnosis in words and tables, as Markdown.

The page "Step by step": the gap of one output, its spectrum, and the gap of each part, one row a step: they play.
"""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from modal.discrepancy.results import Diagnosis, Finding, LawCurve
from modal.localisation.gap import Gap
from modal.recording.discrepancy.series import STAGE_COLOURS, DiscrepancyPlan, log_histories, log_tables, stage_part
from modal.recording.figure import (
    BLUE,
    CYCLE,
    DIM_BLUE,
    FRAME,
    GOLD,
    GREEN,
    GREY,
    ORANGE,
    PALE,
    Axis,
    Colour,
    Figure,
    Pane,
    linear_axis,
    log_axis,
)
from modal.recording.plan import cell, label, name_with_unit
from modal.recording.series import TIMELINE, bucket_length, positions, reduced
from modal.recording.tables import UNKNOWN, bullets, log_table, table
from modal.sections import discrepancy_words as words
from modal.sections.discrepancy_stages import GapDensity, LevelLine, Row, Stage, gap_density, level_lines, rows_of
from modal.sections.discrepancy_values import (
    NAMED_WITHIN,
    effect_text,
    effects_text,
    found_hypothesis,
    found_value,
    interval_text,
    law_against,
    law_gives,
    size_text,
    step_text,
    times_floor,
    times_text,
)
from okid.arrays import FloatArray

if TYPE_CHECKING:
    import rerun

__all__ = [
    "GAP_TEXT",
    "HYPOTHESES",
    "LAW_TEXT",
    "LEVEL_DAMPING",
    "LEVEL_FREQUENCY",
    "STEP_GAP",
    "STEP_PARTS",
    "STEP_SPECTRUM",
    "STEP_TEXT",
    "VERDICT_TEXT",
    "gap_text",
    "law_panes",
    "law_text",
    "level_panes",
    "log_discrepancy_page",
    "log_level_modes",
    "log_steps_page",
    "spectrum_pane",
    "step_document",
    "verdict_text",
]

LEVEL_FREQUENCY: Final = Pane("discrepancy/levels/frequency/plot", 700.0, 520.0)
LEVEL_DAMPING: Final = Pane("discrepancy/levels/damping/plot", 700.0, 520.0)
NINETY_FIVE: Final = 1.96

Values = Callable[[LevelLine], tuple[FloatArray, FloatArray]]


def level_panes(diagnosis: Diagnosis) -> tuple[Pane, ...]:
    """The plots that there is something to draw in."""
    lines = level_lines(diagnosis)
    damped = any(np.isfinite(line.damping).any() for line in lines)
    return (*([LEVEL_FREQUENCY] if lines else []), *([LEVEL_DAMPING] if damped else []))


def log_level_modes(diagnosis: Diagnosis, recording: "rerun.RecordingStream") -> None:
    """Both plots; nothing where nothing is known of how modes move with level."""
    lines = level_lines(diagnosis)
    panes = level_panes(diagnosis)
    if LEVEL_FREQUENCY in panes:
        title = "change of frequency [%]"
        _draw(recording, LEVEL_FREQUENCY, lines, title, lambda line: (line.change, line.change_std))
    if LEVEL_DAMPING in panes:
        _draw(recording, LEVEL_DAMPING, lines, "damping ratio [%]", lambda line: (line.damping, line.damping_std))


def _draw(recording: "rerun.RecordingStream", pane: Pane, lines: Sequence[LevelLine], title: str, of: Values) -> None:
    shown = [(line, *of(line)) for line in lines if np.isfinite(of(line)[0]).any()]
    ends = [values + side * NINETY_FIVE * np.nan_to_num(std) for _, values, std in shown for side in (-1.0, 1.0)]
    low, high = min(0.0, float(np.min(np.concatenate(ends)))), max(0.0, float(np.max(np.concatenate(ends))))
    margin = 0.08 * (high - low) or 1.0
    figure = Figure(
        recording=recording, pane=pane, x=_level_axis(lines), y=linear_axis(title, low - margin, high + margin)
    )
    figure.frame()
    span = [10.0**figure.x.low, 10.0**figure.x.high]
    figure.bars("0_zero", [[[span[0], 0.0], [span[1], 0.0]]], FRAME, width=0.6, order=2.0)
    entries = []
    for k, (line, values, std) in enumerate(shown):
        colour, width = CYCLE[k % len(CYCLE)], NINETY_FIVE * np.nan_to_num(std)
        figure.line(f"1_line/{k}", line.levels, values, colour, width=1.2, order=5.0)
        stack = zip(line.levels.tolist(), (values - width).tolist(), (values + width).tolist(), strict=True)
        figure.bars(f"2_bars/{k}", [[[x, a], [x, b]] for x, a, b in stack], colour, width=0.8, order=6.0)
        figure.points(f"3_points/{k}", line.levels, values, colour, radius=4.0)
        entries.append((label(line.name, 24), colour))
    figure.legend_row(entries)


def _level_axis(lines: Sequence[LevelLine]) -> Axis:
    """A logarithmic axis with a tick at each level: nothing is known between them."""
    levels = sorted({level for line in lines for level in line.levels.tolist()})
    places = tuple(float(np.log10(level)) for level in levels)
    margin = max(0.08 * (places[-1] - places[0]), 0.03)
    return Axis(
        title="level of the excitation, relative to the loudest record",
        low=places[0] - margin,
        high=places[-1] + margin,
        ticks=places,
        texts=tuple(f"{level:.2g}" for level in levels),
        scale="log10",
    )


MOST_ROWS = 40


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
    parts += ["**Next**", *bullets(words.next_sentences(diagnosis))]
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
            cell(record.output_units[j], 12) if record.output_units[j] else UNKNOWN,
        ]
        for i, record in enumerate(diagnosis.held_out)
        for j, name in enumerate(record.output_names)
    ]
    parts = ["### Held-out gap, root mean square"]
    parts.append(table(["record", "output", "as given", "updated model", "noise", "unit"], rows[:MOST_ROWS]))
    if plan.stages:
        heads = ["by", "part", *(stage.name for stage in plan.stages)]
        sizes = [[row.part, cell(row.name, 40), *map(times_text, row.sizes)] for row in rows_of(plan.stages)]
        parts += ["### The same in times of the noise floor", table(heads, sizes[:MOST_ROWS])]
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
            cell(one.unit, 16) if one.unit else UNKNOWN,
            interval_text(one.value, one.std),
        ]
        for finding in findings
        for one in finding.parameters
    ]
    return table(["effect", "place", "", "value ± std", "unit", "95 %"], rows)


def _before_after(plan: DiscrepancyPlan) -> str:
    """The gap by output, in times of the noise floor."""
    rows = [[cell(row.name, 28), *map(times_text, row.sizes)] for row in rows_of(plan.stages) if row.part == "output"]
    heads = ["output, × noise", *(stage.name for stage in plan.stages)]
    return table(heads, rows[:MOST_ROWS]) if rows else "The model as given does not run through the held-out records."


VERDICT_TEXT: Final = "discrepancy/verdict"
LAW_TEXT: Final = "discrepancy/law/text"
GAP_TEXT: Final = "discrepancy/gap_text"
HYPOTHESES: Final = Pane("discrepancy/hypotheses/plot", 520.0, 400.0)

SHOWN_HYPOTHESES: Final = 6
SHOWN_LAWS: Final = 6


def spectrum_pane(output: int) -> Pane:
    """Where the spectrum of an output's gap is drawn."""
    return Pane(f"discrepancy/spectrum/{output + 1:02d}/plot", 520.0, 400.0)


def law_panes(diagnosis: Diagnosis) -> tuple[Pane, ...]:
    """Where each law is drawn, in the shape that its view will have on a common screen."""
    n_laws = len(diagnosis.laws[:SHOWN_LAWS])
    width, height = {1: (900.0, 720.0), 2: (900.0, 370.0)}.get(n_laws, (480.0, 390.0))
    return tuple(Pane(f"discrepancy/law/{k + 1:02d}/plot", width, height) for k in range(n_laws))


def log_discrepancy_page(diagnosis: Diagnosis, recording: "rerun.RecordingStream", plan: DiscrepancyPlan) -> None:
    """Series, spectra, hypotheses, laws, words and tables."""
    import rerun as rr

    log_histories(diagnosis, recording, plan)
    log_tables(diagnosis, recording, plan)
    _log_spectra(diagnosis, recording, plan)
    _draw_hypotheses(diagnosis, recording)
    log_level_modes(diagnosis, recording)
    for number, law in enumerate(diagnosis.laws):
        _log_law(recording, law, number)
    for pane, law in zip(law_panes(diagnosis), diagnosis.laws, strict=False):
        _draw_law(recording, pane, law)
    documents = (
        (VERDICT_TEXT, verdict_text(diagnosis, plan)),
        (LAW_TEXT, law_text(diagnosis)),
        (GAP_TEXT, gap_text(diagnosis, plan)),
    )
    for path, text in documents:
        recording.log(path, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True, strict=True)


def _log_spectra(diagnosis: Diagnosis, recording: "rerun.RecordingStream", plan: DiscrepancyPlan) -> None:
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
    x_axis = log_axis("frequency [Hz]", float(density.frequency[0]), float(density.frequency[-1]))
    for output in plan.shown_outputs:
        pane = spectrum_pane(output)
        figure = Figure(recording=recording, pane=pane, x=x_axis, y=density_axis(density, output, diagnosis))
        figure.frame()
        figure.line("0_measured", density.frequency, density.measured[:, output], DIM_BLUE, width=1.0, order=3.0)
        ends = [float(density.frequency[0]), float(density.frequency[-1])]
        figure.line("8_noise", ends, [density.noise[output]] * 2, GREY, width=0.9, order=4.0)
        for k, (stage, gap) in enumerate(zip(plan.stages, density.gaps, strict=True)):
            colour = STAGE_COLOURS[stage.kind]
            figure.line(f"1_{stage_part(stage)}", density.frequency, gap[:, output], colour, order=5.0 + k)
        entries = [(f"gap {stage.name}", STAGE_COLOURS[stage.kind]) for stage in plan.stages]
        figure.legend_inside([*entries, ("measured output", DIM_BLUE), ("noise floor", GREY)])


def _draw_hypotheses(diagnosis: Diagnosis, recording: "rerun.RecordingStream") -> None:
    shown = diagnosis.hypotheses[:SHOWN_HYPOTHESES]
    if not shown:
        return
    found = found_hypothesis(diagnosis)
    sizes = [times_floor(one.held_out_level) for one in shown]
    known = [size for size in sizes if np.isfinite(size) and size > 0]
    low, high = min([0.7, *(0.8 * size for size in known)]), max([3.0, *known])
    n_rows = len(shown)
    rows = Axis(title="what was tried, the best first", low=0.0, high=n_rows + 0.1, ticks=(), texts=())
    figure = Figure(
        recording=recording,
        pane=HYPOTHESES,
        x=log_axis("left on held-out data, times the noise floor", low, high * 2.0),
        y=rows,
    )
    figure.frame()
    start = 10.0**figure.x.low
    figure.bars("limits/0_floor", [[[1.0, 0.0], [1.0, n_rows]]], GREY, width=0.9, order=3.0)
    figure.bars("limits/1_named", [[[NAMED_WITHIN, 0.0], [NAMED_WITHIN, n_rows]]], GOLD, width=0.7, order=3.0)
    for k, (one, size) in enumerate(zip(shown, sizes, strict=True)):
        height = n_rows - k - 0.68
        colour = GREEN if one is found else DIM_BLUE
        end = size if np.isfinite(size) and size > 0 else high * 2.0
        figure.bars(f"bar/{k}", [[[start, height], [end, height]]], colour, width=7.0)
        figure.text_from(f"name/{k}", start, height + 0.42, label(effects_text(one.effects), 58), PALE)
        words = times_text(size) if np.isfinite(size) else "does not run through"
        figure.text_from(f"size/{k}", end, height, words, GREEN if one is found else PALE)
    figure.legend([("noise floor", GREY), (f"named only within {NAMED_WITHIN:.2f}", GOLD)])


def _log_law(recording: "rerun.RecordingStream", law: LawCurve, number: int) -> None:
    """The curve, the points and the loop as tables."""
    path = f"discrepancy/law/{number + 1:02d}"
    for name, timeline, columns in (
        ("curve", "grid", {"motion": law.motion, "force": law.force, "std": law.deviation}),
        ("points", "bin", {"motion": law.points_motion, "force": law.points_force, "std": law.points_deviation}),
        ("loop", "loop_point", {"motion": law.loop_motion, "force": law.loop_force}),
    ):
        log_table(recording, f"{path}/{name}", timeline, np.arange(1, columns["motion"].size + 1), columns)


def _draw_law(recording: "rerun.RecordingStream", pane: Pane, law: LawCurve) -> None:
    low, high = _span([law.motion, law.points_motion, law.loop_motion])
    bottom, top = _span([law.force, law.points_force, law.loop_force])
    figure = Figure(
        recording=recording,
        pane=pane,
        x=linear_axis(label(law_against(law), 44), low, high),
        y=linear_axis(label(law_gives(law), 44), bottom, top),
    )
    figure.frame()
    figure.bars("zero", [[[low, 0.0], [high, 0.0]], [[0.0, bottom], [0.0, top]]], FRAME, width=0.5, order=2.0)
    entries = [("law as found", GREEN)]
    if law.loop_motion.size:
        figure.line("1_loading", law.motion, law.force, PALE, width=0.8, order=5.0)
        figure.line("2_loop", law.loop_motion, law.loop_force, GREEN, width=1.3, order=6.0)
        entries = [("law as found, along the record", GREEN), ("loaded from rest", PALE)]
    else:
        for side, name in ((-1.96, "low"), (1.96, "high")):
            figure.line(f"1_band/{name}", law.motion, law.force + side * law.deviation, GREEN, width=0.5, order=4.0)
        figure.line("2_law", law.motion, law.force, GREEN, width=1.6, order=6.0)
        entries = [("law as found, thin: 95 %", GREEN)]
    if law.points_motion.size:
        width = 1.96 * law.points_deviation
        stack = zip(law.points_motion, law.points_force - width, law.points_force + width, strict=True)
        figure.bars("3_bars", [[[x, a], [x, b]] for x, a, b in stack], BLUE, width=0.8, order=7.0)
        figure.points("4_points", law.points_motion, law.points_force, BLUE, radius=3.5)
        entries.append(("from the data, bars 95 %", BLUE))
    figure.legend(entries)


def density_axis(density: GapDensity, output: int, diagnosis: Diagnosis) -> Axis:
    """The axis of the spectral density of an output."""
    unit = diagnosis.held_out[0].output_units[output]
    title = f"gap of {label(diagnosis.held_out[0].output_names[output])}"
    return log_axis(f"{title} [({label(unit, 12)})²/Hz]" if unit else title, *density.span(output))


def law_title(law: LawCurve) -> str:
    """What a law's view is called."""
    return f"{effect_text(law.effect)} at {label(law.where)}"


def _span(parts: Sequence[np.ndarray]) -> tuple[float, float]:
    values = np.concatenate([part[np.isfinite(part)] for part in parts])
    if not values.size:
        return -1.0, 1.0
    low, high = min(float(values.min()), 0.0), max(float(values.max()), 0.0)
    margin = 0.08 * (high - low) or 1.0
    return low - margin, high + margin


STEP: Final = "step"
STEP_GAP: Final = Pane("discrepancy/steps/gap/plot", 1400.0, 335.0)
STEP_SPECTRUM: Final = Pane("discrepancy/steps/spectrum/plot", 520.0, 400.0)
STEP_PARTS: Final = Pane("discrepancy/steps/parts/plot", 520.0, 400.0)
STEP_TEXT: Final = "discrepancy/steps/text"
DIM_RED: Final[Colour] = (120, 56, 58)
DRAWN_SAMPLES: Final = 4000
SHOWN_PARTS: Final = 7


def log_steps_page(diagnosis: Diagnosis, recording: "rerun.RecordingStream", plan: DiscrepancyPlan) -> None:
    """Frames once, and what changes once a step; nothing where no step ran through."""
    import rerun as rr

    if not plan.step_gaps:
        return
    _draw_gap(diagnosis, recording, plan)
    _draw_spectrum(diagnosis, recording, plan)
    _draw_parts(recording, plan)
    texts = [step_document(diagnosis, number) for number in plan.step_numbers]
    columns = rr.TextDocument.columns(text=texts, media_type=[rr.MediaType.MARKDOWN] * len(texts))
    _send(recording, STEP_TEXT, plan, columns)


def _draw_gap(diagnosis: Diagnosis, recording: "rerun.RecordingStream", plan: DiscrepancyPlan) -> None:
    record = diagnosis.held_out[plan.record]
    bucket = bucket_length(record.n_samples, DRAWN_SAMPLES)
    times = record.start_time + record.dt * positions(record.n_samples, bucket)
    curves = [reduced(gap.residuals[plan.record][:, plan.output], bucket) for gap in plan.step_gaps]
    noise = 2.0 * float(np.sqrt(plan.step_gaps[0].floor[plan.record, plan.output]))
    reach = max(1.05 * max(float(np.nanmax(np.abs(curve))) for curve in curves), 1.5 * noise)
    name = name_with_unit(record.output_names[plan.output], record.output_units[plan.output])
    figure = Figure(
        recording=recording,
        pane=STEP_GAP,
        x=linear_axis("time [s]", float(times[0]), float(times[-1])),
        y=linear_axis(f"gap of {name}, held out", -reach, reach),
    )
    figure.frame()
    figure.line("1_first", times, curves[0], DIM_RED, width=0.6, order=3.0)
    for side in (-noise, noise):
        ends = [float(times[0]), float(times[-1])]
        figure.line(f"2_noise/{'low' if side < 0 else 'high'}", ends, [side, side], GREY, width=0.6, order=4.0)
    _play_lines(recording, plan, f"{STEP_GAP.path}/3_now", [[figure.place(times, curve)] for curve in curves])
    figure.legend([("as given", DIM_RED), ("this step", ORANGE), ("the last", GREEN), ("noise, ±2 deviations", GREY)])


def _draw_spectrum(diagnosis: Diagnosis, recording: "rerun.RecordingStream", plan: DiscrepancyPlan) -> None:
    density = gap_density(plan.step_gaps)
    frequency, output = density.frequency, plan.output
    figure = Figure(
        recording=recording,
        pane=STEP_SPECTRUM,
        x=log_axis("frequency [Hz]", float(frequency[0]), float(frequency[-1])),
        y=density_axis(density, output, diagnosis),
    )
    figure.frame()
    figure.line("0_measured", frequency, density.measured[:, output], DIM_BLUE, width=0.9, order=2.0)
    figure.line("1_first", frequency, density.gaps[0][:, output], DIM_RED, width=0.9, order=3.0)
    ends = [float(frequency[0]), float(frequency[-1])]
    figure.line("2_noise", ends, [float(density.noise[output])] * 2, GREY, width=0.9, order=4.0)
    low, high = 10.0**figure.y.low, 10.0**figure.y.high
    strips = [[figure.place(frequency, np.clip(gap[:, output], low, high))] for gap in density.gaps]
    _play_lines(recording, plan, f"{STEP_SPECTRUM.path}/3_now", strips, width=1.3)
    figure.legend_inside([("measured output", DIM_BLUE), ("gap as given", DIM_RED), ("gap now", ORANGE)])


def _draw_parts(recording: "rerun.RecordingStream", plan: DiscrepancyPlan) -> None:
    """A bar a part, as long as its gap is in times of the noise floor."""
    rows = _shown(plan.step_gaps)
    sizes = [size for row in rows for size in row.sizes if np.isfinite(size) and size > 0]
    figure = Figure(
        recording=recording,
        pane=STEP_PARTS,
        x=log_axis("times the noise floor", min([0.7, *sizes]), max([3.0, *sizes])),
        y=Axis(title="gap by output, record and band", low=0.0, high=len(rows) + 0.1, ticks=(), texts=()),
    )
    figure.frame()
    figure.bars("0_floor", [[[1.0, 0.0], [1.0, len(rows)]]], GREY, width=0.9, order=3.0)
    start = 10.0**figure.x.low
    bars: list[list[FloatArray]] = [[] for _ in plan.step_gaps]
    for k, row in enumerate(rows):
        height = len(rows) - k - 0.75
        figure.text_from(f"name/{k}", start, height + 0.42, f"{row.part}: {label(row.name, 40)}", PALE)
        first = row.sizes[0] if np.isfinite(row.sizes[0]) else start
        figure.bars(f"1_first/{k}", [[[start, height], [first, height]]], DIM_RED, width=3.0, order=4.0)
        for strips, size in zip(bars, row.sizes, strict=True):
            end = size if np.isfinite(size) and size > start else start
            strips.append(figure.place([start, end], [height, height]))
    _play_lines(recording, plan, f"{STEP_PARTS.path}/2_now", bars, width=5.0)


def _shown(gaps: Sequence[Gap]) -> list[Row]:
    """The outputs, records and bands with the largest gap at first, in their order."""
    stages = [Stage(name="", kind="after", step=k, gap=gap) for k, gap in enumerate(gaps)]
    rows = rows_of(stages)
    order = np.argsort([-np.nan_to_num(row.sizes[0]) for row in rows], kind="stable")[:SHOWN_PARTS]
    return [rows[k] for k in sorted(order.tolist())]


def _play_lines(
    recording: "rerun.RecordingStream",
    plan: DiscrepancyPlan,
    path: str,
    frames: Sequence[Sequence[FloatArray]],
    *,
    width: float = 1.0,
) -> None:
    """One row of line strips a step: orange on the way, green at the last."""
    import rerun as rr

    counts = [len(strips) for strips in frames]
    last = len(frames) - 1
    colours = [GREEN if k == last else ORANGE for k, count in enumerate(counts) for _ in range(count)]
    strips = [_known(strip) for frame in frames for strip in frame]
    columns = [
        *rr.LineStrips2D.columns(
            strips=strips, colors=colours, radii=[rr.Radius.ui_points(width)] * len(strips)
        ).partition(counts),
    ]
    _send(recording, path, plan, columns)
    recording.log(path, rr.LineStrips2D.from_fields(draw_order=8.0), static=True, strict=True)


def _known(strip: FloatArray) -> FloatArray:
    """A strip without the points that are not known."""
    return strip[np.isfinite(strip).all(axis=1)]


def _send(recording: "rerun.RecordingStream", path: str, plan: DiscrepancyPlan, columns: Any) -> None:
    import rerun as rr

    index = [
        rr.TimeColumn(STEP, sequence=list(plan.step_numbers)),
        rr.TimeColumn(TIMELINE, duration=list(plan.step_times)),
    ]
    recording.send_columns(path, index, columns, strict=True)
