"""A figure as a page takes it: the SVG, the words below it, and the numbers that a script reads off it."""

from collections.abc import Mapping
from dataclasses import dataclass

from modal.plots.charts import Notes, chart_text
from modal.plots.layout import Chart
from modal.plots.vector import svg_text

__all__ = ["Picture", "drawn", "readable"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Picture:
    """One picture for a page.

    Attributes:
        svg: the `<svg>` element.
        caption: what there is to see.
        chart: numbers behind the picture as JSON, "" where there is nothing to read off.
    """

    svg: str
    caption: str
    chart: str = ""


def drawn(figure: Chart, name: str, caption: str) -> Picture:
    """A picture that is looked at and no more."""
    return Picture(svg=svg_text(figure, name=name, description=caption), caption=caption)


def readable(figure: Chart, name: str, caption: str, *, notes: Mapping[str, Notes] | None = None) -> Picture:
    """A picture that a script can read values off and whose lines it can hide.

    Args:
        figure: of `modal.plots`.
        name: of the picture in its page.
        caption: what there is to see.
        notes: more on the points of the lines with these labels.
    """
    svg = svg_text(figure, name=name, description=caption)
    return Picture(svg=svg, caption=caption, chart=chart_text(figure, name, notes=notes))
