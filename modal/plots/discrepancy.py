"""Where simulation and measurement disagree, and how the gap shrinks: over time, over frequency, by part, by step."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import XAxis, YAxis
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from modal.discrepancy.diagnosis import Hypothesis, Step
from modal.discrepancy.gap import Gap
from modal.names import plot_label
from modal.plots.style import LIGHT, Theme, envelope, head, key, new_figure, new_panels, style_axes
from modal.report.discrepancy_spectra import gap_density
from modal.report.discrepancy_stages import Row, Stage
from modal.report.discrepancy_values import NAMED_WITHIN, effect_text, effects_text, times_floor, times_text
from okid.record import Record

__all__ = ["before_and_after", "gap_histories", "gap_spectra", "hypothesis_bars", "shrinking_gap"]

MOST_BARS = 8

_PARTS = (("output", "by output"), ("record", "by record and level"), ("band", "by frequency band"))


def stage_colour(stage: Stage, theme: Theme) -> str:
    """Red before, amber for the calibrated linear model, green after."""
    return {"before": theme.residual, "linear": theme.doubtful, "after": theme.system}[stage.kind]


def gap_histories(
    stages: Sequence[Stage], *, record: int = 0, outputs: Sequence[int] | None = None, theme: Theme = LIGHT
) -> Figure:
    """Measured minus simulated, one row an output: the whole record on the left, its worst moment on the right.

    Args:
        stages: states of the model, the earliest first; drawn one over the other.
        record: number of the held-out record.
        outputs: which, all unless given.
        theme: colours.
    """
    measured = stages[0].gap.measured[record]
    chosen = list(range(measured.n_outputs)) if outputs is None else list(outputs)
    figure, axes = new_figure(len(chosen), 2, size=(10.4, 0.6 + 1.5 * len(chosen)), theme=theme, ratios=(2.1, 1.0))
    window = _worst_moment(stages[0].gap, record)
    time = measured.time
    for row, (output, (whole, part)) in enumerate(zip(chosen, axes, strict=True)):
        band = 2.0 * float(np.sqrt(stages[0].gap.floor[record, output]))
        for axis in (whole, part):
            axis.axhspan(-band, band, color=theme.muted, alpha=0.22, lw=0, label="noise floor, ±2 deviations")
            axis.tick_params(labelbottom=row == len(chosen) - 1)
        for stage in stages:
            values, colour = stage.gap.residuals[record][:, output], stage_colour(stage, theme)
            whole.plot(*envelope(time, values), color=colour, lw=0.8, label=stage.name)
            part.plot(time[window], values[window], color=colour, lw=1.2)
        whole.axvspan(time[window][0], time[window][-1], color=theme.muted, alpha=0.10, lw=0)
        whole.set_xlim(time[0], time[-1])
        part.set_xlim(time[window][0], time[window][-1])
        head(whole, _named(measured, output), theme=theme, where="left")
    axes[-1][0].set_xlabel("time [s]")
    axes[-1][1].set_xlabel("time [s], the worst moment")
    _shared_key(figure, axes[0][0], theme)
    return figure


def gap_spectra(stages: Sequence[Stage], *, outputs: Sequence[int] | None = None, theme: Theme = LIGHT) -> Figure:
    """Power spectral density of the gap of each output over that of the measured output, with the noise floor.

    Args:
        stages: states of the model, the earliest first.
        outputs: which, all unless given.
        theme: colours.
    """
    records = stages[0].gap.measured
    chosen = list(range(records[0].n_outputs)) if outputs is None else list(outputs)
    figure, panels = new_panels(len(chosen), most_columns=2, width=10.4, height=2.9, theme=theme)
    density = gap_density([stage.gap for stage in stages])
    for axis, output in zip(panels, chosen, strict=True):
        low, high = density.span(output)
        measured = density.measured[:, output]
        axis.fill_between(density.frequency, low, measured, color=theme.measured, alpha=0.12, lw=0)
        axis.loglog(density.frequency, measured, color=theme.measured, lw=0.9, alpha=0.6, label="measured output")
        for stage, gap in zip(stages, density.gaps, strict=True):
            positive = np.where(gap[:, output] > 0, gap[:, output], np.nan)
            colour = stage_colour(stage, theme)
            axis.loglog(density.frequency, positive, color=colour, lw=1.3, label=f"gap {stage.name}")
        axis.axhline(density.noise[output], color=theme.muted, lw=1.1, ls=(0, (4, 3)), label="noise floor")
        axis.set_ylim(low, high)
        axis.set_xlim(density.frequency[0], density.frequency[-1])
        unit = plot_label(records[0].output_units[output], limit=12)
        axis.set_ylabel(f"({unit})²/Hz" if unit else "power / Hz")
        axis.set_xlabel("frequency [Hz]")
        head(axis, plot_label(records[0].output_names[output]), theme=theme, where="left")
    _shared_key(figure, panels[0], theme)
    return figure


def before_and_after(rows: Sequence[Row], stages: Sequence[Stage], *, theme: Theme = LIGHT) -> Figure:
    """Each part of the held-out data as a line from before to after, in times of the noise floor, on a log axis.

    Args:
        rows: by output, record and band.
        stages: states of the model that the rows give the sizes of.
        theme: colours.
    """
    groups = [(title, [row for row in rows if row.part == part]) for part, title in _PARTS]
    groups = [(title, group) for title, group in groups if group]
    heights = [0.55 + 0.27 * len(group) for _, group in groups]
    figure = Figure(figsize=(10.4, 0.7 + sum(heights)), layout="constrained", facecolor=theme.paper)
    axes = figure.subplots(len(groups), 1, squeeze=False, sharex=True, height_ratios=heights)[:, 0]
    for axis, (title, group) in zip(axes, groups, strict=True):
        _dumbbells(axis, group, stages, theme)
        head(axis, title, theme=theme, where="left")
    axes[-1].set_xlabel("root mean square of the gap, times the noise floor")
    sizes = [size for row in rows for size in row.sizes if np.isfinite(size) and size > 0]
    axes[-1].set_xlim(min(0.5, *sizes) * 0.85, max(3.0, *sizes) * 1.35)
    _shared_key(figure, axes[0], theme)
    return figure


def hypothesis_bars(
    hypotheses: Sequence[Hypothesis], *, chosen: Hypothesis | None = None, theme: Theme = LIGHT
) -> Figure:
    """What each set of effects leaves on held-out data, in times of the noise floor, the best first.

    Args:
        hypotheses: best first; the first eight are shown.
        chosen: the one that the diagnosis found.
        theme: colours.
    """
    shown = list(hypotheses[:MOST_BARS])
    figure, axes = new_figure(1, 1, size=(10.4, 0.95 + 0.34 * max(len(shown), 1)), theme=theme)
    axis = axes[0][0]
    sizes = [times_floor(one.held_out_level) for one in shown]
    highest = max([3.0, *(size for size in sizes if np.isfinite(size))])
    start = min([0.7, *(0.8 * size for size in sizes if np.isfinite(size))])
    for place, (one, size) in enumerate(zip(shown, sizes, strict=True)):
        colour = theme.system if one is chosen else theme.noise
        width = (size if np.isfinite(size) else 1.6 * highest) - start
        axis.barh(place, width, left=start, height=0.62, color=colour, lw=0)
        text = times_text(float(size)) if np.isfinite(size) else "did not run through"
        axis.text(start + width, place, f" {text}", va="center", fontsize=8.5, color=theme.ink)
    _plain_log(axis.xaxis)
    axis.set_xlim(start, highest * 2.2)
    axis.set_yticks(range(len(shown)), [plot_label(effects_text(one.effects), limit=64) for one in shown])
    axis.invert_yaxis()
    axis.grid(visible=False, axis="y")
    _limits(axis, theme)
    axis.set_xlabel("left on held-out data (root mean square), times the noise floor")
    return figure


def shrinking_gap(steps: Sequence[Step], *, theme: Theme = LIGHT) -> Figure:
    """What is left after each step, on the records fitted to and on the held-out ones, in times of the noise floor."""
    figure, axes = new_figure(1, 1, size=(10.4, 3.2), theme=theme)
    axis = axes[0][0]
    place = np.arange(len(steps))
    for levels, colour, label, style in (
        ([step.fit_level for step in steps], theme.measured, "on the records fitted to", "--o"),
        ([step.held_out_level for step in steps], theme.system, "on held-out records", "-o"),
    ):
        sizes = np.array([times_floor(level) for level in levels])
        axis.semilogy(place, sizes, style, color=colour, lw=1.6, ms=5.5, label=label)
    for number, step in enumerate(steps):
        size = times_floor(step.held_out_level)
        if np.isfinite(size):
            axis.annotate(
                times_text(float(size)),
                (number, size),
                textcoords="offset points",
                xytext=(7, 6),
                fontsize=8.5,
                color=theme.system,
            )
    axis.set_xticks(place, [_step_label(step.name) for step in steps])
    axis.tick_params(axis="x", labelsize=9, labelcolor=theme.ink)
    axis.margins(x=0.09, y=0.16)
    _plain_log(axis.yaxis)
    axis.axhline(1.0, color=theme.muted, lw=1.1, ls=(0, (4, 3)), label="noise floor")
    axis.set_ylabel("times the noise floor")
    key(axis, theme=theme, where="upper right")
    return figure


def _dumbbells(axis: Axes, group: Sequence[Row], stages: Sequence[Stage], theme: Theme) -> None:
    style_axes(axis, theme)
    _plain_log(axis.xaxis)
    for place, row in enumerate(group):
        known = [size for size in row.sizes if np.isfinite(size)]
        if known:
            axis.plot([min(known), max(known)], [place, place], color=theme.grid, lw=3.2, solid_capstyle="round")
    for index, stage in enumerate(stages):
        sizes = [row.sizes[index] for row in group]
        ms = 5.0 if stage.kind == "linear" else 7.5
        axis.plot(sizes, range(len(group)), "o", ms=ms, mew=0, color=stage_colour(stage, theme), label=stage.name)
    axis.axvline(1.0, color=theme.muted, lw=1.1, ls=(0, (4, 3)), label="noise floor")
    axis.set_yticks(range(len(group)), [plot_label(row.name, limit=30) for row in group])
    axis.tick_params(axis="y", labelcolor=theme.ink)
    axis.set_ylim(len(group) - 0.4, -0.6)
    axis.grid(visible=False, axis="y")


def _plain_log(axis: XAxis | YAxis) -> None:
    """A logarithmic axis whose ticks read 0.1, 1, 10."""
    (axis.axes.set_xscale if isinstance(axis, XAxis) else axis.axes.set_yscale)("log")
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def _limits(axis: Axes, theme: Theme) -> None:
    axis.axvline(1.0, color=theme.muted, lw=1.1, ls=(0, (4, 3)))
    axis.axvline(NAMED_WITHIN, color=theme.doubtful, lw=1.1, ls=":")
    top = axis.get_ylim()[1]
    axis.text(1.0, top, "noise floor ", fontsize=8, color=theme.muted, ha="right", va="bottom")
    axis.text(
        NAMED_WITHIN, top, f" {NAMED_WITHIN:.2f}: named only within", fontsize=8, color=theme.doubtful, va="bottom"
    )


def _shared_key(figure: Figure, axis: Axes, theme: Theme) -> None:
    handles, labels = axis.get_legend_handles_labels()
    figure.legend(
        handles,
        labels,
        loc="outside upper right",
        ncols=len(labels),
        frameon=False,
        fontsize=8.5,
        labelcolor=theme.muted,
    )


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
