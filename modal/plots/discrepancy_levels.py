"""Modes against the level of the excitation: frequency and damping of the best linear model of each level."""

from collections.abc import Sequence

import numpy as np

from modal.plots.histories import APART as ROLES
from modal.plots.layout import Chart, grid_of
from modal.plots.panels import Panel
from modal.plots.style import NINETY_FIVE, STYLE, Role
from modal.sections.discrepancy_levels import LevelLine
from modal.wording.names import plot_label
from okid.arrays import FloatArray

__all__ = ["modes_against_level"]

APART = 0.012
"""Stand the bars of two modes apart by this share of the level."""


def modes_against_level(lines: Sequence[LevelLine]) -> Chart:
    """Change of each frequency on the left, damping ratio on the right, both with 95 % bars.

    Args:
        lines: from `modal.sections.discrepancy_levels.level_lines`.
    """
    damped = [line for line in lines if np.isfinite(line.damping).any()]
    figure = grid_of(1, 2 if damped else 1, size=(STYLE.page, 3.1))
    for place, line in enumerate(lines):
        role, shift = ROLES[place % len(ROLES)], 1.0 + APART * (place - 0.5 * (len(lines) - 1))
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
