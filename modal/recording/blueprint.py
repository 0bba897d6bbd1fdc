"""How a recording opens: pages, views and panels.

All blueprint code is here and in `modal.recording.discrepancy_blueprint`: Rerun calls its blueprint types unstable.

A page is a container with a name. A further page (the record, validation, a discrepancy) is one function more in
`_pages`.
"""

import uuid
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from modal.identification import Identification
from modal.recording.figure import Pane
from modal.recording.fit_page import FIT_TEXT, MARKOV, WHITENESS
from modal.recording.modes_page import ASSURANCE, CHOICES_TEXT, FIELDS, MODES_TABLE, MODES_TEXT
from modal.recording.names import label, with_unit
from modal.recording.order_page import ORDER_FIT, SINGULAR_VALUES, STABILISATION
from modal.recording.palette import BACKGROUND
from modal.recording.plan import SHOWN_INPUTS, Plan, Span
from modal.recording.series import TIMELINE
from modal.recording.shapes import HALF_LENGTH, PERIODS, SPACING, deflection, shape_path
from modal.report.words import damping_text, fit_text, hertz

if TYPE_CHECKING:
    import rerun.blueprint

__all__ = ["blueprint", "document_view", "plot_view", "series_view", "show_whole_record"]

LINES: Final = ("$origin/measured", "$origin/predicted", "$origin/simulated")

GLOBAL_AXIS: Final = uuid.UUID("5c0dca6a-e63f-9cf7-f657-2602590474cc")
"""The view whose time range all linked views share, by its fixed identity in Rerun's viewer (`GLOBAL_VIEW_ID`)."""

DETAILED_OUTPUTS: Final = 4
"""Up to so many outputs, each has its window beside it on the first page."""

HALF_VIEW: Final = 0.52
"""Half the height that a 3-D view shows, at a distance of 1."""

SECONDS_A_PERIOD: Final = 2.0


def blueprint(identification: Identification, plan: Plan) -> "rerun.blueprint.Blueprint":
    """The whole layout for one identification."""
    import rerun.blueprint as rrb

    seconds = PERIODS * SECONDS_A_PERIOD
    return rrb.Blueprint(
        rrb.Tabs(*_pages(identification, plan), active_tab=0),
        rrb.TimePanel(
            timeline=TIMELINE,
            state="collapsed",
            play_state="paused",
            loop_mode="all",
            playback_speed=max(plan.stop - plan.start, 1e-6) / seconds,
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )


def _pages(identification: Identification, plan: Plan) -> list[Any]:
    return [_fit_page(identification, plan), _order_page(identification), _modes_page(identification, plan)]


def _fit_page(identification: Identification, plan: Plan) -> Any:
    import rerun.blueprint as rrb

    left: list[Any] = [_everything(identification, plan)]
    if len(plan.shown_outputs) > 1:
        left += [_one_output(identification, plan, i) for i in plan.shown_outputs]
    series = rrb.Tabs(*left, active_tab=0, name="Outputs") if len(left) > 1 else left[0]
    words = [document_view(FIT_TEXT, "Fit")]
    if identification.markov.n_inputs or identification.markov.gain is not None:
        words.append(plot_view(MARKOV, "Markov parameters"))
    words.append(plot_view(WHITENESS, "Whiteness"))
    right = rrb.Vertical(*words, row_shares=[1.6, 1.05, 0.85][: len(words)], name="Fit in words")
    page = rrb.Horizontal(series, right, column_shares=[2.15, 1.0], name="Observer fit")
    show_whole_record(page, plan)
    return page


def _everything(identification: Identification, plan: Plan) -> Any:
    """Inputs over all outputs: a few with their windows and one residual, many in two columns."""
    import rerun.blueprint as rrb

    outputs = plan.shown_outputs
    if len(outputs) == 1:
        return _one_output(identification, plan, 0)
    rows: list[Any] = _inputs(plan)
    shares = [0.8] * len(rows)
    if len(outputs) <= DETAILED_OUTPUTS:
        for i in outputs:
            pair = (_whole(identification, plan, i, legend=i == 0), _window(identification, plan, i))
            rows.append(rrb.Horizontal(*pair, column_shares=[1.5, 1.0], name=label(_name(identification, i))))
        shares += [1.0] * len(outputs)
    else:
        views = [_whole(identification, plan, i, legend=i == 0) for i in outputs]
        rows.append(rrb.Grid(*views, grid_columns=2, name="Outputs"))
        shares = [0.5] * len(shares) + [0.75 * -(-len(outputs) // 2)]
    return rrb.Vertical(*rows, row_shares=shares, name="All outputs")


def _one_output(identification: Identification, plan: Plan, output: int) -> Any:
    import rerun.blueprint as rrb

    rows = [
        *_inputs(plan),
        _whole(identification, plan, output),
        _window(identification, plan, output),
        series_view(f"{plan.output_paths[output]}/residual", "Residual", ["$origin/**"]),
    ]
    shares = [0.7, 1.2, 1.5, 0.8][-len(rows) :]
    return rrb.Vertical(*rows, row_shares=shares, name=label(_name(identification, output), 18))


def _inputs(plan: Plan) -> list[Any]:
    if not plan.input_paths:
        return []
    n_inputs = len(plan.input_paths)
    name = "Input" if n_inputs == 1 else "Inputs"
    if n_inputs > SHOWN_INPUTS:
        name = f"Inputs, the first {SHOWN_INPUTS} of {n_inputs}"
    return [series_view("fit/input", name, list(plan.input_paths[:SHOWN_INPUTS]))]


def _name(identification: Identification, output: int) -> str:
    return identification.records[0].output_names[output]


def _whole(identification: Identification, plan: Plan, output: int, *, legend: bool = True) -> Any:
    fit = identification.fit.cross_validated[output]
    first = identification.records[0]
    name = with_unit(first.output_names[output], first.output_units[output])
    title = f"{name}: fit {fit_text(fit)}" if np.isfinite(fit) else name
    return series_view(plan.output_paths[output], title, LINES, legend=legend)


def _window(identification: Identification, plan: Plan, output: int) -> Any:
    import rerun.blueprint as rrb

    at = rrb.TimeRangeBoundary
    ends = (at.cursor_relative(seconds=-0.15 * plan.window), at.cursor_relative(seconds=0.85 * plan.window))
    view = series_view(
        plan.output_paths[output], f"{label(_name(identification, output))}: at the cursor", LINES, legend=False
    )
    view.properties["TimeAxis"] = rrb.TimeAxis(link="Independent", view_range=rrb.TimeRange(start=ends[0], end=ends[1]))
    return view


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


def show_whole_record(page: Any, plan: Span) -> None:
    """Let all linked views open on the whole timeline: their common range is kept with one view of a fixed identity."""
    import rerun.blueprint as rrb

    views = [page]
    while not isinstance(views[0], rrb.TimeSeriesView):
        views = [*views[0].contents, *views[1:]] if isinstance(views[0], rrb.api.Container) else views[1:]
    margin = 0.004 * (plan.stop - plan.start)
    at = rrb.TimeRangeBoundary
    span = rrb.TimeRange(start=at.absolute(seconds=plan.start - margin), end=at.absolute(seconds=plan.stop + margin))
    views[0].id = GLOBAL_AXIS
    views[0].properties["TimeAxis"] = rrb.TimeAxis(link="LinkToGlobal", view_range=span)


def _order_page(identification: Identification) -> Any:
    import rerun.blueprint as rrb

    left = [plot_view(SINGULAR_VALUES, "Hankel singular values")]
    if identification.order_evidence.candidate_orders.size:
        left.append(plot_view(ORDER_FIT, "Fit against order"))
    shares = [1.15, 1.0][: len(left)]
    column = rrb.Vertical(*left, row_shares=shares, name="How many states")
    return rrb.Horizontal(column, plot_view(STABILISATION, "Stabilisation"), column_shares=[1.0, 1.75], name="Order")


def _modes_page(identification: Identification, plan: Plan) -> Any:
    import rerun.blueprint as rrb

    words = [document_view(MODES_TEXT, "Mode table"), document_view(CHOICES_TEXT, "Choices and warnings")]
    if plan.modes:
        columns = ["mode", *(f"/{MODES_TABLE}:{name}" for name in FIELDS)]
        query = rrb.archetypes.DataframeQuery(timeline="mode", select=columns)
        words.append(rrb.DataframeView(origin=MODES_TABLE, name="Numbers", query=query))
    below = rrb.Tabs(*words, active_tab=0, name="In words")
    if not plan.shapes:
        return rrb.Vertical(below, name="Modes")
    n_sticks = len(set(identification.records[0].output_units))
    views = [_shape(plan, number, n_sticks) for number in plan.shapes]
    n_columns, _ = _grid(len(views))
    above = rrb.Grid(*views, grid_columns=n_columns, name="Shapes")
    if plan.compared:
        above = rrb.Horizontal(above, _assurance(len(views)), column_shares=[2.3, 1.0], name="Shapes")
    return rrb.Vertical(above, below, row_shares=[1.45, 1.0], name="Modes")


def _grid(n_views: int) -> tuple[int, float]:
    """Columns of the grid of shapes, and how much wider than high each of its panes is on a common screen."""
    n_columns = min(n_views, 2 if n_views in (2, 4) else 3)
    return n_columns, 2.35 * -(-n_views // n_columns) / n_columns


def _shape(plan: Plan, number: int, n_sticks: int) -> Any:
    import rerun.blueprint as rrb

    mode = plan.modes[number - 1]
    title = f"Mode {number}: {hertz(mode.frequency)} Hz, {damping_text(mode).replace('not', 'damping not')}"
    if mode.verdict != "system":
        title = f"{mode.verdict.capitalize()} {number}: {hertz(mode.frequency)} Hz"
    return rrb.Spatial3DView(
        origin=shape_path(number),
        name=title,
        line_grid=rrb.LineGrid3D(visible=False),
        background=rrb.Background(BACKGROUND),
        eye_controls=_eye(len(plan.shapes), n_sticks),
    )


def _eye(n_views: int, n_sticks: int) -> Any:
    """From the front, a little from above and the right, as near as the pane's shape allows."""
    import rerun.blueprint as rrb

    _, aspect = _grid(n_views)
    distance = max((HALF_LENGTH + 0.25) / (HALF_VIEW * aspect), (deflection(n_views) + 0.3) / HALF_VIEW)
    distance += (n_sticks - 1) * SPACING / 2
    direction = np.array([0.22, -1.0, 0.32])
    position = distance * direction / np.linalg.norm(direction)
    return rrb.EyeControls3D(position=position, look_target=(0.0, 0.0, 0.0), eye_up=(0.0, 0.0, 1.0))


def _assurance(n_modes: int) -> Any:
    import rerun.blueprint as rrb

    margin = 0.16 * n_modes
    return rrb.Spatial2DView(
        origin=ASSURANCE,
        name="Assurance of the shapes",
        background=rrb.Background(BACKGROUND),
        visual_bounds=rrb.VisualBounds2D(
            x_range=(-margin, n_modes + 0.5 * margin), y_range=(-0.5 * margin, n_modes + margin)
        ),
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
