"""The views that several pages are made of: series over time, drawn plots, words."""

from collections.abc import Sequence
from typing import Any

from modal.recording.figure import Pane
from modal.recording.palette import BACKGROUND

__all__ = ["document_view", "plot_view", "series_view"]


def series_view(origin: str, name: str, contents: Sequence[str], *, legend: bool = True) -> Any:
    """The view of series over time, linked with all others."""
    import rerun.blueprint as rrb

    return rrb.TimeSeriesView(
        origin=origin,
        contents=[f"+ {path if path.startswith('$') else '/' + path}" for path in contents],
        name=name,
        axis_x=rrb.TimeAxis(link="LinkToGlobal"),
        plot_legend=rrb.PlotLegend("RightTop", visible=legend),
    )


def plot_view(pane: Pane, name: str) -> Any:
    """The view of a drawn plot, in the shape of its pane."""
    import rerun.blueprint as rrb

    return rrb.Spatial2DView(
        origin=pane.path,
        name=name,
        background=rrb.Background(BACKGROUND),
        visual_bounds=rrb.VisualBounds2D(x_range=(0.0, pane.width), y_range=(0.0, pane.height)),
    )


def document_view(path: str, name: str) -> Any:
    """The view of words."""
    import rerun.blueprint as rrb

    return rrb.TextDocumentView(origin=path, name=name)
