"""A diagnosis: where simulation and measurement disagree, how the gap shrinks, laws over data, modes against level."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from modal.discrepancy.results import Diagnosis, Hypothesis, LawCurve, Step, in_words
from modal.localisation.gap import Gap
from modal.plots.chart import Chart, Key, grid_of, one_panel, row_of
from modal.plots.histories import mark_moment
from modal.plots.panels import IN_TURN, STYLE, Panel, Role, envelope
from modal.plots.responses import density_label
from modal.sections.discrepancy_stages import (
    NAMED_WITHIN,
    GapDensity,
    LevelLine,
    Row,
    Stage,
    effect_text,
    gap_density,
    hypothesis_text,
    law_against,
    law_gives,
    times_floor,
    times_text,
)
from modal.wording.text import NINETY_FIVE, plot_label
from okid.arrays import FloatArray
from okid.record import Record

MOST_BARS = 8
"""Show so many hypotheses, the best first."""

_PARTS = (("output", "by output"), ("record", "by record and level"), ("band", "by frequency band"))


STAGE_ROLES: Final[dict[str, Role]] = {"before": "residual", "linear": "doubtful", "after": "system"}
"""Draw red before, amber for the calibrated linear model, green after."""


def gap_histories(stages: Sequence[Stage], *, record: int = 0, outputs: Sequence[int] | None = None) -> Chart:
    """Measured minus simulated, one row an output: the whole record on the left, its worst moment on the right.

    Args:
        stages: states of the model, the earliest first; drawn one over the other.
        record: number of the held-out record.
        outputs: which, all unless given.
    """
    measured = stages[0].gap.measured[record]
    chosen = list(range(measured.n_outputs)) if outputs is None else list(outputs)
    figure = grid_of(len(chosen), 2, size=(STYLE.page, 0.6 + 1.5 * len(chosen)), across=(2.1, 1.0))
    window = _worst_moment(stages[0].gap, record)
    time = measured.time
    for row, (output, whole, part) in enumerate(zip(chosen, figure.panels[::2], figure.panels[1::2], strict=True)):
        band = 2.0 * float(np.sqrt(stages[0].gap.floor[record, output]))
        for panel in (whole, part):
            everywhere = (-np.inf, np.inf)
            panel.box_of(everywhere, (-band, band), "muted", opacity=STYLE.pale, label="noise floor, ±2 deviations")
            panel.x.labelled = row == len(chosen) - 1
        for stage in stages:
            values, role = stage.gap.residuals[record][:, output], STAGE_ROLES[stage.kind]
            whole.line(*envelope(time, values), role, width=STYLE.thin, label=stage.name)
            part.line(time[window], values[window], role)
        mark_moment(whole, part, time, window)
        whole.head = _named(measured, output)
    figure.panels[-2].x.label = "time [s]"
    figure.panels[-1].x.label = "time [s], the worst moment"
    figure.key = Key(panel=figure.panels[0])
    return figure


def answer_charts(stages: Sequence[Stage], *, record: int, output: int) -> tuple[Chart, ...]:
    """One output as measured and as simulated, by the model as given and as found, where that as given is worst.

    The measured line is the wide one, so that no simulated one hides it.
    """
    measured = stages[0].gap.measured[record]
    window = _worst_moment(stages[0].gap, record)
    time, seen = measured.time[window], measured.outputs[window, output]
    name, unit = plot_label(measured.output_names[output]), plot_label(measured.output_units[output], limit=12)
    shown = stages[:: max(1, len(stages) - 1)]
    simulated = [seen - stage.gap.residuals[record][window, output] for stage in shown]
    low, high = (float(end(np.stack([seen, *simulated]))) for end in (np.nanmin, np.nanmax))
    charts: list[Chart] = []
    for stage, values in zip(shown, simulated, strict=True):
        figure, panel = one_panel(0.5 * STYLE.page, 2.6)
        key = "" if charts else "measured"  # the charts stand side by side: each line is explained once
        panel.line(time, seen, "measured", width=STYLE.under, opacity=STYLE.half, label=key)
        panel.line(time, values, STAGE_ROLES[stage.kind], label=f"simulated {stage.name}")
        size = times_text(float(np.sqrt(stage.gap.in_floors.mean())))
        panel.head = f"{stage.name.capitalize()}: {size} times the noise"
        panel.x.limits, panel.x.label = (float(time[0]), float(time[-1])), "time [s]"
        panel.y.limits = (low - 0.05 * (high - low), high + 0.05 * (high - low) or 1.0)
        panel.y.label = f"{name} [{unit}]" if unit else name
        figure.key = Key(panel=panel)
        charts.append(figure)
    return tuple(charts)


def gap_spectra(stages: Sequence[Stage], *, outputs: Sequence[int] | None = None) -> Chart:
    """Power spectral density of the gap of each output over that of the measured output, with the noise floor."""
    records = stages[0].gap.measured
    chosen = list(range(records[0].n_outputs)) if outputs is None else list(outputs)
    figure = row_of(len(chosen), most_columns=2, width=STYLE.page, height=2.9)
    density = gap_density([stage.gap for stage in stages])
    for panel, output in zip(figure.panels, chosen, strict=True):
        draw_gap_spectrum(panel, density, stages, output)
        panel.y.label = density_label(records[0].output_units[output])
        panel.head = plot_label(records[0].output_names[output])
    figure.key = Key(panel=figure.panels[0])
    return figure


def draw_gap_spectrum(panel: Panel, density: GapDensity, stages: Sequence[Stage], output: int) -> None:
    """The gap of one output in each of the stages that the density is of, over the measured output and the floor."""
    low, high = density.span(output)
    measured = density.measured[:, output]
    panel.x.log = panel.y.log = True
    panel.area(density.frequency, low, measured, "measured", opacity=STYLE.faint)
    panel.line(density.frequency, measured, "measured", width=STYLE.thin, opacity=STYLE.half, label="measured output")
    for stage, gap in zip(stages, density.gaps, strict=True):
        positive = np.where(gap[:, output] > 0, gap[:, output], np.nan)
        panel.line(density.frequency, positive, STAGE_ROLES[stage.kind], label=f"gap {stage.name}")
    panel.across(density.noise[output], "muted", dash="dashed", label="noise floor")
    panel.y.limits = (low, high)
    panel.x.limits = (float(density.frequency[0]), float(density.frequency[-1]))
    panel.x.label = "frequency [Hz]"


def before_and_after(rows: Sequence[Row], stages: Sequence[Stage]) -> Chart:
    """Each part of the held-out data as a line from before to after, in times of the noise floor, on a log axis.

    Args:
        rows: by output, record and band.
        stages: states of the model that the rows give the sizes of.
    """
    groups = [(title, [row for row in rows if row.part == part]) for part, title in _PARTS]
    groups = [(title, group) for title, group in groups if group]
    heights = [0.55 + 0.27 * len(group) for _, group in groups]
    figure = grid_of(len(groups), 1, size=(STYLE.page, 0.7 + sum(heights)), down=heights)
    sizes = [size for row in rows for size in row.sizes if np.isfinite(size) and size > 0]
    for panel, (title, group) in zip(figure.panels, groups, strict=True):
        _dumbbells(panel, group, stages)
        panel.head, panel.x.log, panel.x.labelled = title, True, False
        panel.x.limits = (min(0.5, *sizes) * 0.85, max(3.0, *sizes) * 1.35)
    figure.panels[-1].x.label = "root mean square of the gap, times the noise floor"
    figure.panels[-1].x.labelled = True
    figure.key = Key(panel=figure.panels[0])
    return figure


def hypothesis_bars(hypotheses: Sequence[Hypothesis], *, chosen: Hypothesis | None = None) -> Chart:
    """What each set of effects leaves on held-out data, in times of the noise floor, the best first."""
    shown = list(hypotheses[:MOST_BARS])
    figure, panel = one_panel(STYLE.page, 0.95 + 0.34 * max(len(shown), 1))
    sizes = [times_floor(one.held_out_level) for one in shown]
    highest = max([3.0, *(size for size in sizes if np.isfinite(size))])
    start = min([0.7, *(0.8 * size for size in sizes if np.isfinite(size))])
    for place, (one, size) in enumerate(zip(shown, sizes, strict=True)):
        end = size if np.isfinite(size) else 1.6 * highest
        panel.box_of((start, end), (place - 0.31, place + 0.31), "system" if one is chosen else "noise")
        text = times_text(float(size)) if np.isfinite(size) else "did not run through"
        panel.word(end, place, text, "ink", shift=(STYLE.gap, STYLE.tick / 3))
    panel.x.log, panel.x.limits = True, (start, highest * 2.2)
    panel.y.ticks = [(float(place), plot_label(hypothesis_text(one), limit=64)) for place, one in enumerate(shown)]
    panel.y.limits, panel.y.grid = (len(shown) - 0.5, -0.5), False
    panel.upright(1.0, "muted", dash="dashed", label="noise floor")
    panel.upright(NAMED_WITHIN, "doubtful", dash="dotted", label=f"named only within {NAMED_WITHIN:.2f}")
    figure.key = Key(panel=panel)
    panel.x.label = "left on held-out data (root mean square), times the noise floor"
    return figure


def shrinking_gap(steps: Sequence[Step]) -> Chart:
    """What is left after each step, on the records fitted to and on the held-out ones, in times of the noise floor."""
    figure, panel = one_panel(STYLE.page, 3.2)
    place = np.arange(len(steps))
    fitted, held_out = (
        np.array([times_floor(level) for level in levels])
        for levels in ([step.fit_level for step in steps], [step.held_out_level for step in steps])
    )
    panel.line(place, fitted, "measured", width=STYLE.thick, dash="dashed", dot=6.5, label="on the records fitted to")
    panel.line(place, held_out, "system", width=STYLE.thick, dot=6.5, label="on held-out records")
    for number, size in enumerate(held_out.tolist()):
        if np.isfinite(size):
            panel.word(number, size, times_text(size), "system", shift=(7.0, -6.0))
    panel.x.ticks = [(float(number), _step_label(step.name)) for number, step in enumerate(steps)]
    panel.x.margin, panel.y.margin, panel.x.role = 0.09, 0.16, "ink"
    panel.y.log = True
    panel.across(1.0, "muted", dash="dashed", label="noise floor")
    panel.y.label = "times the noise floor"
    panel.key = "upper right"
    return figure


def _dumbbells(panel: Panel, group: Sequence[Row], stages: Sequence[Stage]) -> None:
    for place, row in enumerate(group):
        known = [size for size in row.sizes if np.isfinite(size)]
        if known:
            panel.line([min(known), max(known)], [place, place], "grid", width=3.2)
    for index, stage in enumerate(stages):
        sizes = [row.sizes[index] for row in group]
        dot = 5.0 if stage.kind == "linear" else 7.5
        panel.dots(sizes, range(len(group)), STAGE_ROLES[stage.kind], dot=dot, label=stage.name)
    panel.upright(1.0, "muted", dash="dashed", label="noise floor")
    panel.y.ticks = [(float(place), plot_label(row.name, limit=30)) for place, row in enumerate(group)]
    panel.y.limits, panel.y.grid, panel.y.role = (len(group) - 0.4, -0.6), False, "ink"


def _worst_moment(gap: Gap, record: int) -> slice:
    """A twelfth of the record, where the gap in units of the floor is greatest."""
    residual = gap.residuals[record]
    length = int(np.clip(len(residual) // 12, min(40, len(residual)), len(residual)))
    energy = (np.nan_to_num(residual) ** 2 / gap.floor[record]).sum(axis=1)
    sums = np.concatenate([[0.0], np.cumsum(energy)])
    start = int(np.argmax(sums[length:] - sums[:-length]))
    return slice(start, start + length)


def _named(record: Record, output: int) -> str:
    unit = plot_label(record.output_units[output], limit=12)
    name = plot_label(record.output_names[output])
    return f"{name} [{unit}], measured − simulated" if unit else f"{name}, measured − simulated"


def _step_label(name: str) -> str:
    """The step on two lines: what, where."""
    what, _, where = name.partition(" at ")
    return f"+ {plot_label(effect_text(what))}\nat {plot_label(where, limit=20)}" if where else plot_label(what)


def draw_laws(laws: Sequence[LawCurve]) -> Chart:
    """Each law with its 95 % band, over the force in bins of the motion that the data give free of any law.

    A law with memory has no single force at a motion: it is drawn as the loop that it ran through along the loudest
    record, and dashed as it loads from rest.
    """
    figure = row_of(len(laws), most_columns=2, width=STYLE.page if len(laws) > 1 else 6.4, height=3.6)
    for panel, law in zip(figure.panels, laws, strict=True):
        _law(panel, law)
    return figure


def laws_found(diagnosis: Diagnosis, most: int) -> Chart:
    """`draw_laws` of the first laws of a diagnosis, their places as they are told."""
    return draw_laws(in_words(diagnosis).laws[:most])


def _law(panel: Panel, law: LawCurve) -> None:
    if law.loop_motion.size:
        panel.line(law.loop_motion, law.loop_force, "system", label="law as found, along the record")
        panel.line(law.motion, law.force, "muted", dash="dashed", label="loaded from rest")
    else:
        width = NINETY_FIVE * law.deviation
        low, high = law.force - width, law.force + width
        panel.area(law.motion, low, high, "system", opacity=STYLE.pale, label="95 % of the law")
        panel.line(law.motion, law.force, "system", width=STYLE.thick, label="law as found")
    if law.points_motion.size:
        panel.bars(law.points_motion, law.points_force, NINETY_FIVE * law.points_deviation, "measured")
        panel.dots(law.points_motion, law.points_force, "measured", dot=STYLE.dot, label="from the data, 95 %")
    panel.across(0.0, "muted", width=STYLE.thin)
    if law.motion.size and law.motion.min() < 0.0 < law.motion.max():
        panel.upright(0.0, "muted", width=STYLE.thin)
    panel.x.label, panel.y.label = plot_label(law_against(law), limit=40), plot_label(law_gives(law), limit=44)
    panel.y.limits = _span(law)
    panel.head = f"{effect_text(law.effect)} at {plot_label(law.where)}"
    panel.key = "best"


def _span(law: LawCurve) -> tuple[float, float]:
    """Room for law and points; a point whose bar is wider than all the rest may stick out."""
    parts = [law.force, law.points_force, law.loop_force]
    values = np.concatenate([part[np.isfinite(part)] for part in parts])
    if not values.size:
        return -1.0, 1.0
    low, high = float(values.min()), float(values.max())
    margin = 0.12 * (high - low) or 0.1 * abs(high) or 1.0
    return low - margin, high + margin


def modes_against_level(lines: Sequence[LevelLine]) -> Chart:
    """Change of each frequency on the left, damping ratio on the right, both with 95 % bars."""
    damped = [line for line in lines if np.isfinite(line.damping).any()]
    figure = grid_of(1, 2 if damped else 1, size=(STYLE.page, 3.1))
    for place, line in enumerate(lines):
        # two bars side by side
        role, shift = IN_TURN[place % len(IN_TURN)], 1.0 + 0.012 * (place - 0.5 * (len(lines) - 1))
        _bars(figure.panels[0], (line.levels * shift, line.change, line.change_std), role, line.name)
        if line in damped:
            _bars(figure.panels[1], (line.levels * shift, line.damping, line.damping_std), role, line.name)
    for panel, title in zip(figure.panels, ("change of frequency [%]", "damping ratio [%]"), strict=False):
        panel.across(0.0, "muted", width=STYLE.thin)  # a damping ratio is seen from nothing
        panel.x.ticks = _ticks(lines)
        panel.x.log, panel.x.margin = True, 0.08
        panel.x.label = "level of the excitation, relative to the loudest record"
        panel.head = title
    figure.panels[0].key = "best"
    return figure


def _bars(panel: Panel, points: tuple[FloatArray, FloatArray, FloatArray], role: Role, name: str) -> None:
    """Draw (n,) places, values and their standard deviations."""
    levels, values, deviations = points
    panel.bars(levels, values, NINETY_FIVE * np.nan_to_num(deviations), role)
    panel.line(levels, values, role, dot=STYLE.dot, label=plot_label(name))


def _ticks(lines: Sequence[LevelLine]) -> list[tuple[float, str]]:
    """One at each level: there are few, and nothing is known between them."""
    levels = sorted({level for line in lines for level in line.levels.tolist()})
    return [(level, f"{level:.2g}") for level in levels]
