"""The modes of many records as a Rerun recording: one page, and every number as a table."""

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from modal.plots.histories import frequencies_of_records, places_of_records
from modal.recording.figure import Pane, document_view, log_chart, plot_view, rrb
from modal.recording.plan import cell
from modal.recording.stream import write_stream
from modal.recording.tables import WordLimits, bullets, log_table, log_text, table

if TYPE_CHECKING:
    import rerun

FREQUENCIES: Final = Pane(path="batch/frequencies", width=1500.0, height=760.0)
WORDS: Final = "batch/words"
MODES: Final = "batch/modes"
RECORDS: Final = "batch/records"


def save_batch_recording(names: Sequence[str], modes: Any, records: Any, path: Path) -> Path:
    """Write the recording of a batch; the same tables give the same recording.

    Raises:
        OSError: the file cannot be written.
    """
    frequency, deviation, damping, probability = (
        modes.column(name).to_numpy(zero_copy_only=False)
        for name in ("frequency", "frequency_std", "damping_ratio", "probability")
    )
    verdicts, number = modes.column("verdict").to_pylist(), {name: place for place, name in enumerate(names)}
    row = np.array([number[name] for name in modes.column("record").to_pylist()], dtype=np.intp)
    starts = np.zeros(len(names))
    starts[row] = modes.column("start_time").to_numpy(zero_copy_only=False)
    seen = np.unique(row)
    along, label = places_of_records(starts[seen], seen + 1)
    places = np.full(len(names), np.nan)
    places[seen] = along
    digest = hashlib.blake2b(repr(names).encode("utf-8", "backslashreplace"), digest_size=12)
    digest.update(frequency.tobytes() + deviation.tobytes())

    def log(recording: "rerun.RecordingStream") -> None:
        chart = frequencies_of_records(places[row], frequency, verdicts, along=label)
        log_chart(recording, FREQUENCIES, chart)
        log_table(
            recording,
            MODES,
            "mode_row",
            np.arange(row.size),
            {
                "record": modes.column("record").to_pylist(),
                "frequency": frequency,
                "frequency_std": deviation,
                "damping_ratio": damping,
                "probability": probability,
                "verdict": verdicts,
            },
        )
        told = {name: records.column(name).to_pylist() for name in ("record", "path", "hash", "status", "message")}
        log_table(recording, RECORDS, "record_row", np.arange(len(names)), told)
        log_text(recording, WORDS, _words(told))
        views = [plot_view(FREQUENCIES, "Frequencies"), document_view(WORDS, "Records")]
        for entity, timeline in ((MODES, "mode_row"), (RECORDS, "record_row")):
            query = rrb.archetypes.DataframeQuery(timeline=timeline)
            views.append(rrb.DataframeView(origin=entity, name=entity.rpartition("/")[2].capitalize(), query=query))
        page = rrb.Vertical(views[0], rrb.Tabs(*views[1:], active_tab=0), row_shares=[1.4, 1.0], name="Batch")
        recording.send_blueprint(
            rrb.Blueprint(page, rrb.TimePanel(state="hidden"), auto_views=False, auto_layout=False)
        )

    return write_stream(path, digest.hexdigest(), "batch", log)


def _words(told: dict[str, list[str]]) -> str:
    failed = [row for row in zip(told["record"], told["status"], told["message"], strict=True) if row[2]]
    n_failed = told["status"].count("failed")
    head = f"### {len(told['record'])} records, {n_failed} failed"
    if not failed:
        return head
    rows = [[cell(name, 60), status, cell(message)] for name, status, message in failed[: WordLimits.LISTED]]
    more = (
        bullets([f"and {len(failed) - WordLimits.LISTED} more in the table"]) if len(failed) > WordLimits.LISTED else []
    )
    return "\n\n".join([head, table(["record", "status", "message"], rows), *more])
