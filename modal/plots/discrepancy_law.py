"""A named law over the data: the force that the found effect makes, and the force that the data ask for without it."""

from collections.abc import Sequence

import numpy as np

from modal.discrepancy.results import LawCurve
from modal.plots.layout import Chart, row_of
from modal.plots.panels import Panel
from modal.plots.style import NINETY_FIVE, STYLE
from modal.sections.discrepancy_values import effect_text, law_against, law_gives
from modal.wording.names import plot_label

__all__ = ["draw_laws"]


def draw_laws(laws: Sequence[LawCurve]) -> Chart:
    """Each law with its 95 % band, over the force in bins of the motion that the data give free of any law.

    A law with memory has no single force at a motion: it is drawn as the loop that it ran through along the loudest
    record, and dashed as it loads from rest.

    Args:
        laws: of the found effects.
    """
    figure = row_of(len(laws), most_columns=2, width=STYLE.page if len(laws) > 1 else 6.4, height=3.6)
    for panel, law in zip(figure.panels, laws, strict=True):
        _law(panel, law)
    return figure


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
