"""How a recording opens: pages, views and panels.

All blueprint code is here and in the modules named for their page (`..._blueprint`), and nowhere else: Rerun calls its
blueprint types unstable. A page is a container with a name; a further page is one function more in `_pages`.
"""

import uuid
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

from modal.identification.result import Identification
from modal.recording.evidence import Gathered
from modal.recording.identification.fit_blueprint import fit_page
from modal.recording.identification.modes_blueprint import modes_page
from modal.recording.identification.order import ORDER_FIT, SINGULAR_VALUES, STABILISATION
from modal.recording.identification.order_scrub import ORDER_TEXT
from modal.recording.identification.record_blueprint import record_page
from modal.recording.identification.shapes import PERIODS
from modal.recording.identification.validation_blueprint import validation_page
from modal.recording.plan import Plan
from modal.recording.series import TIMELINE
from modal.recording.tracks import Span
from modal.recording.views_blueprint import document_view, plot_view

if TYPE_CHECKING:
    import rerun.blueprint

__all__ = ["blueprint", "show_whole_record", "whole_blueprint"]

GLOBAL_AXIS: Final = uuid.UUID("5c0dca6a-e63f-9cf7-f657-2602590474cc")
"""The view whose time range all linked views share, by its fixed identity in Rerun's viewer (`GLOBAL_VIEW_ID`)."""

SECONDS_A_PERIOD: Final = 2.0
ORDERS_A_SECOND: Final = 4.0
"""Play the oscillating shapes and the growing order so fast."""


def blueprint(identification: Identification, plan: Plan, evidence: Gathered) -> "rerun.blueprint.Blueprint":
    """The whole layout for one identification."""
    return whole_blueprint(_pages(identification, plan, evidence), plan)


def whole_blueprint(pages: Sequence[Any], plan: Span) -> "rerun.blueprint.Blueprint":
    """The pages as tabs on the timeline "time", paused at its start, everything else out of the way."""
    import rerun.blueprint as rrb

    speed = max(plan.stop - plan.start, 1e-6) / (PERIODS * SECONDS_A_PERIOD)
    return rrb.Blueprint(
        rrb.Tabs(*pages, active_tab=0),
        rrb.TimePanel(
            timeline=TIMELINE,
            state="collapsed",
            play_state="paused",
            loop_mode="all",
            playback_speed=speed,
            fps=ORDERS_A_SECOND / speed,  # of the timeline "model_order", to which the speed applies as well
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )


def _pages(identification: Identification, plan: Plan, evidence: Gathered) -> list[Any]:
    pages = [
        record_page(identification.records, plan.data, evidence.quality),
        fit_page(identification, plan),
        _order_page(identification),
        modes_page(identification, plan),
        validation_page(identification, plan, evidence),
    ]
    show_whole_record(pages[0], plan)
    return pages


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

    left: list[Any] = [plot_view(SINGULAR_VALUES, "Hankel singular values")]
    if identification.order_evidence.candidate_orders.size:
        left.append(plot_view(ORDER_FIT, "Fit against order"))
    shares = [1.15, 1.0][: len(left)]
    column = rrb.Vertical(*left, row_shares=shares, name="How many states")
    return rrb.Horizontal(
        column,
        plot_view(STABILISATION, "Stabilisation"),
        document_view(ORDER_TEXT, "This order"),
        column_shares=[1.0, 1.75, 0.75],
        name="Order",
    )
