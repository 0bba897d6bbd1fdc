"""Modes against the level of the excitation: frequency and damping of the best linear model of each level."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from modal.names import plot_label
from modal.plots.style import LIGHT, Theme, head, key, new_figure
from modal.report.discrepancy_levels import LevelLine
from okid.arrays import FloatArray

__all__ = ["modes_against_level"]

NINETY_FIVE = 1.96
APART = 0.012
"""Of the width, by which the bars of two modes stand apart."""


def modes_against_level(lines: Sequence[LevelLine], *, theme: Theme = LIGHT) -> Figure:
    """Change of each frequency on the left, damping ratio on the right, both with 95 % bars.

    Args:
        lines: from `modal.report.discrepancy_levels.level_lines`.
        theme: colours.
    """
    damped = [line for line in lines if np.isfinite(line.damping).any()]
    n_panels = 2 if damped else 1
    figure, axes = new_figure(1, n_panels, size=(10.4, 3.1), theme=theme)
    colours = (theme.measured, theme.model, theme.system, theme.residual, theme.doubtful)
    for place, line in enumerate(lines):
        colour, shift = colours[place % len(colours)], 1.0 + APART * (place - 0.5 * (len(lines) - 1))
        _bars(axes[0][0], line, line.change, line.change_std, colour=colour, shift=shift)
        if n_panels > 1 and np.isfinite(line.damping).any():
            _bars(axes[0][1], line, line.damping, line.damping_std, colour=colour, shift=shift)
    axes[0][0].axhline(0.0, color=theme.muted, lw=0.8)
    for axis, title in zip(axes[0], ("change of frequency [%]", "damping ratio [%]"), strict=False):
        axis.set_xscale("log")
        _ticks(axis, lines)
        axis.set_xlabel("level of the excitation, relative to the loudest record")
        head(axis, title, theme=theme, where="left")
    if n_panels > 1:
        axes[0][1].set_ylim(bottom=min(0.0, axes[0][1].get_ylim()[0]))
    key(axes[0][0], theme=theme, where="best")
    return figure


def _bars(
    axis: Axes, line: LevelLine, values: FloatArray, deviations: FloatArray, *, colour: str, shift: float
) -> None:
    axis.errorbar(
        line.levels * shift,
        values,
        yerr=NINETY_FIVE * np.nan_to_num(deviations),
        fmt="-o",
        ms=5.0,
        mew=0,
        lw=1.4,
        elinewidth=1.0,
        capsize=2.5,
        color=colour,
        label=plot_label(line.name),
    )


def _ticks(axis: Axes, lines: Sequence[LevelLine]) -> None:
    """One at each level: there are few, and nothing is known between them."""
    levels = sorted({level for line in lines for level in line.levels.tolist()})
    axis.set_xticks(levels, [f"{level:.2g}" for level in levels])
    axis.set_xticks([], minor=True)
    axis.margins(x=0.08)
