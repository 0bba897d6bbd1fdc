"""A named law over the data: the force that the found effect makes, and the force that the data ask for without it."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from modal.discrepancy.diagnosis import LawCurve
from modal.names import plot_label
from modal.plots.style import LIGHT, Theme, head, key, new_panels
from modal.report.discrepancy_values import effect_text, law_against, law_gives

__all__ = ["law_curves"]

NINETY_FIVE = 1.96
"""Standard deviations of a 95 % interval."""


def law_curves(laws: Sequence[LawCurve], *, theme: Theme = LIGHT) -> Figure:
    """Each law with its 95 % band, over the force in bins of the motion that the data give free of any law.

    A law with memory has no single force at a motion: it is drawn as the loop that it ran through along the loudest
    record, and dashed as it loads from rest.

    Args:
        laws: of the found effects.
        theme: colours.
    """
    figure, panels = new_panels(
        len(laws), most_columns=2, width=10.4 if len(laws) > 1 else 6.4, height=3.6, theme=theme
    )
    for axis, law in zip(panels, laws, strict=True):
        _law(axis, law, theme)
    return figure


def _law(axis: Axes, law: LawCurve, theme: Theme) -> None:
    if law.loop_motion.size:
        axis.plot(law.loop_motion, law.loop_force, color=theme.system, lw=1.4, label="law as found, along the record")
        axis.plot(law.motion, law.force, "--", color=theme.muted, lw=1.2, label="loaded from rest")
    else:
        width = NINETY_FIVE * law.deviation
        low, high = law.force - width, law.force + width
        axis.fill_between(law.motion, low, high, color=theme.system, alpha=0.22, lw=0, label="95 % of the law")
        axis.plot(law.motion, law.force, color=theme.system, lw=1.8, label="law as found")
    if law.points_motion.size:
        axis.errorbar(
            law.points_motion,
            law.points_force,
            yerr=NINETY_FIVE * law.points_deviation,
            fmt="o",
            ms=4.2,
            mew=0,
            elinewidth=1.0,
            color=theme.measured,
            label="from the data, 95 %",
            zorder=4,
        )
    axis.axhline(0.0, color=theme.muted, lw=0.8)
    if law.motion.size and law.motion.min() < 0.0 < law.motion.max():
        axis.axvline(0.0, color=theme.muted, lw=0.8)
    axis.set_xlabel(plot_label(law_against(law), limit=40))
    axis.set_ylabel(plot_label(law_gives(law), limit=44))
    axis.set_ylim(*_span(law))
    head(axis, f"{effect_text(law.effect)} at {plot_label(law.where)}", theme=theme, where="left")
    key(axis, theme=theme, where="best")


def _span(law: LawCurve) -> tuple[float, float]:
    """Room for law and points; a point whose bar is wider than all the rest may stick out."""
    parts = [law.force, law.points_force, law.loop_force]
    values = np.concatenate([part[np.isfinite(part)] for part in parts])
    if not values.size:
        return -1.0, 1.0
    low, high = float(values.min()), float(values.max())
    margin = 0.12 * (high - low) or 0.1 * abs(high) or 1.0
    return low - margin, high + margin
