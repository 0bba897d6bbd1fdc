"""How a live view opens, before there is a result; called by `modal.recording.live`."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from modal.quality.findings import DataQuality
from modal.recording.blueprint import show_whole_record, whole_blueprint
from modal.recording.identification.record_blueprint import record_page
from modal.recording.plan import DataPlan
from modal.recording.views_blueprint import document_view
from okid.record import Record

if TYPE_CHECKING:
    import rerun.blueprint

__all__ = ["live_blueprint"]


def live_blueprint(records: Sequence[Record], plan: DataPlan, quality: DataQuality) -> "rerun.blueprint.Blueprint":
    """The records, and what the work is at."""
    import rerun.blueprint as rrb

    record = record_page(records, plan, quality)
    show_whole_record(record, plan)
    progress = rrb.Horizontal(
        document_view("progress/text", "What is being done"),
        rrb.TextLogView(origin="progress/log", name="Log"),
        column_shares=[1.0, 1.0],
        name="Progress",
    )
    return whole_blueprint([record, progress], plan)
