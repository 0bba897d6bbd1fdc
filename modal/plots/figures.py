"""A chart as a matplotlib figure, for whoever wants to change it or put it beside others.

Reports and recordings never come here: they draw a `Chart` themselves. Nothing else imports matplotlib, and this file
only does when a figure is asked for.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final, Literal, cast

import numpy as np

from modal.plots.layout import INCH, Chart
from modal.plots.panels import COLOURS, STYLE, Area, Curve, Mark, Panel
from okid.errors import InvalidDataError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["figure_of"]

_DASHES: Final = {"": "-", "dashed": "--", "dotted": ":"}
_ALONG: Final = {"start": "left", "middle": "center", "end": "right"}


def figure_of(chart: Chart, *, axes: "Axes | Sequence[Axes] | None" = None) -> "Figure":
    """Draw a chart with matplotlib, by its object interface: no window opens and no global state changes.

    Args:
        chart: of a function of `modal.plots`.
        axes: to draw on, one a panel, row by row; unless given, a figure of the size of the chart is made.

    Returns:
        The figure of the axes.

    Raises:
        InvalidDataError: there are not as many axes as panels.

    Example:
        >>> from modal.plots.layout import grid_of
        >>> chart = grid_of(1, 1, size=(4.0, 3.0))
        >>> chart.panels[0].line([0, 1, 2], [3, 4, 5], "measured", label="measured")
        >>> figure_of(chart).axes[0].lines[0].get_ydata().tolist()
        [3.0, 4.0, 5.0]
    """
    chart.arrange()
    given = _own_axes(chart) if axes is None else list(np.ravel(np.asarray(axes, dtype=object)))
    if len(given) != len(chart.panels):
        raise InvalidDataError(
            f"each panel needs axes of its own: the chart has {len(chart.panels)} panels, but {len(given)} axes are "
            "given; give one a panel, row by row, or none."
        )
    for panel, one in zip(chart.panels, given, strict=True):
        _draw(panel, one)
    figure = cast("Figure", given[0].figure)
    if chart.title:
        figure.suptitle(chart.title, fontsize=STYLE.head)
    if chart.key is not None:
        keyed = given[chart.panels.index(chart.key.panel)]
        handles, names = keyed.get_legend_handles_labels()
        figure.legend(
            handles,
            names,
            loc="lower center" if chart.key.below else "upper right",
            ncols=len(names),
            borderaxespad=0.0,
            frameon=False,
            title=chart.key.title or None,
            fontsize=STYLE.tick,
            title_fontsize=STYLE.tick,
        )
    return figure


def _own_axes(chart: Chart) -> "list[Axes]":
    """Axes of a new figure, where the chart has its panels."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(chart.width / INCH, chart.height / INCH))
    size = np.array([chart.width, chart.height])
    boxes = [np.reshape(panel.box, (2, 2)) / size for panel in chart.panels]
    return [figure.add_axes((left, 1.0 - top - high, wide, high)) for (left, top), (wide, high) in boxes]


def _draw(panel: Panel, axes: "Axes") -> None:
    sides: tuple[Literal["x", "y"], ...] = ("x", "y")
    for side in sides:
        axis, ticks = (panel.x, panel.x_ticks()) if side == "x" else (panel.y, panel.y_ticks())
        scale = "log" if axis.log else "linear"
        axes.set(**{f"{side}scale": scale, f"{side}lim": axis.limits})
        (axes.set_xlabel if side == "x" else axes.set_ylabel)(axis.label, fontsize=STYLE.label, labelpad=1)
        texts = [text if axis.labelled else "" for _, text in ticks]
        numbers = axes.xaxis if side == "x" else axes.yaxis
        numbers.set_ticks([place for place, _ in ticks], texts, rotation=90 if axis.upright else 0)
        numbers.set_ticks([], minor=True)
        axes.tick_params(axis=side, pad=2, labelsize=STYLE.tick, labelcolor=COLOURS[axis.role])
        if axis.grid:
            axes.grid(visible=True, axis=side, color=COLOURS["grid"])
    axes.set_axisbelow(True)
    axes.set_aspect("equal" if panel.equal else "auto")
    axes.set_title(panel.head, loc="center" if panel.centred else "left", fontsize=STYLE.head)
    if not panel.frame:
        axes.set_axis_off()
    for mark in panel.marks:
        _mark(panel, mark, axes)
    for word in panel.words:
        axes.annotate(
            word.text,
            tuple(panel.within(np.array([word.x, word.y])).tolist()),
            xytext=(word.shift[0], -word.shift[1]),
            textcoords="offset points",
            color=COLOURS[word.role],
            fontsize=word.size,
            horizontalalignment=_ALONG[word.anchor],
        )
    if panel.key is not None and panel.keyed:
        axes.legend(loc=panel.key, fontsize=STYLE.tick)


def _mark(panel: Panel, mark: Mark, axes: "Axes") -> None:
    """A line, areas or pieces, in the order and the colours of the chart."""
    from matplotlib.collections import LineCollection, PolyCollection

    colour, name = COLOURS[mark.role], mark.label or None
    if isinstance(mark, Curve):
        axes.plot(
            *panel.within(mark.corners).T,
            color=colour,
            alpha=mark.opacity,
            linewidth=mark.width,
            linestyle=_DASHES[mark.dash] if mark.width else "",
            marker=("s" if mark.square else "o") if mark.dot else "",
            markersize=mark.dot,
            label=name,
        )
    elif isinstance(mark, Area):
        faces = [panel.within(polygon) for polygon in mark.polygons]
        axes.add_collection(PolyCollection(faces, facecolor=colour, alpha=mark.opacity, label=name), autolim=False)
    elif mark.arrows:
        for start, end in mark.ends.tolist():
            axes.annotate("", end, start, arrowprops={"arrowstyle": "->", "color": colour, "linewidth": mark.width})
    else:
        ends = [panel.within(pair) for pair in mark.ends]
        pieces = LineCollection(ends, colors=colour, linewidths=mark.width, alpha=mark.opacity, label=name)
        axes.add_collection(pieces, autolim=False)
