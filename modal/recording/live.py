"""A result while it is being made: streamed to a Rerun viewer that is open, or that is opened for it.

The viewer is company, not part of the work: where there is none, where it cannot be opened or where it is closed on the
way, one sentence says so and the work goes on. Nothing here waits longer than a second or two, and nothing raises.
"""

import secrets
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

from modal.identification.result import Identification
from modal.quality.check import check_quality
from modal.recording.identification.record import log_record_page
from modal.recording.live_blueprint import live_blueprint
from modal.recording.names import cell, label
from modal.recording.plan import planned_data
from modal.recording.relay import Relay
from modal.recording.stream import APPLICATION, log_identification, strict_errors
from modal.recording.viewer import HOST, PATIENCE, host_and_port, listens, open_viewer, speaks
from okid.errors import IdentificationWarning
from okid.record import Record

if TYPE_CHECKING:
    import rerun

    from modal.geometry.sensors import Geometry
    from modal.quality.findings import DataQuality

__all__ = ["LiveRecording", "live_recording", "log_progress", "log_records", "log_result"]

READ: Final = "read"
"""Above the channels as they were read; those of the result lie elsewhere."""

PROGRESS_TEXT: Final = "progress/text"
PROGRESS_LOG: Final = "progress/log"
CLOSING: Final = 2.0
"""Seconds to wait until the viewer has taken everything."""


class LiveRecording:
    """A stream to a viewer, and what was said on it so far; like an open file, it changes as it is used.

    Attributes:
        stream: Rerun's own.
        wire: on which it reaches the viewer.
        tell: takes the one sentence when the viewer is lost.
        began: when it was opened, by `time.perf_counter`.
        steps: what the work has been at, with the seconds since the beginning.
        start: where the records begin on the timeline [s].
        is_lost: whether the viewer went away; nothing more is sent then.
    """

    __slots__ = ("began", "is_lost", "start", "steps", "stream", "tell", "wire")

    def __init__(self, *, stream: "rerun.RecordingStream", wire: Relay, tell: Callable[[str], None]) -> None:
        self.stream = stream
        self.wire = wire
        self.tell = tell
        self.began = time.perf_counter()
        self.steps: list[tuple[float, str]] = []
        self.start = 0.0
        self.is_lost = False


def _warn(sentence: str) -> None:
    warnings.warn(sentence, IdentificationWarning, stacklevel=3)


@contextmanager
def live_recording(
    *, address: str | None = None, tell: Callable[[str], None] = _warn
) -> Iterator[LiveRecording | None]:
    """A stream to the viewer that is open, or to one that is opened; None, after one sentence, where there is none.

    Args:
        address: of the viewer, as host:port or rerun+http://host:port/proxy; unless given, the usual port of this
            machine, and a viewer is opened when none listens there.
        tell: takes the sentence; a warning unless given.

    Raises:
        InvalidDataError: the address is none.

    Example:
        >>> with live_recording() as live:  # doctest: +SKIP
        ...     log_records(records, live)
        ...     log_result(modal.identify(records, progress=lambda *step: log_progress(live, *step)), live)
    """
    live = _opened(*host_and_port(address), may_spawn=address is None, tell=tell)
    try:
        yield live
    finally:
        if live is not None:
            _close(live)


def log_records(records: Sequence[Record], live: LiveRecording | None, *, quality: "DataQuality | None" = None) -> None:
    """The page "Record", as soon as the records are read.

    Args:
        records: as read.
        live: from `live_recording`.
        quality: of the records; found here unless given.
    """

    def log(recording: LiveRecording) -> None:
        plan = planned_data(records, root=READ)
        recording.start = plan.start
        found = quality or check_quality(records)
        log_record_page(records, recording.stream, plan, found)
        recording.stream.send_recording_name(label(records[0].name, 60))
        recording.stream.send_blueprint(live_blueprint(records, plan, found))
        _log_steps(recording)

    _attempt(live, log)


def log_progress(live: LiveRecording | None, what: str, share: float) -> None:
    """What the work is at, in words: on the page "Progress" at once, and kept as a log.

    Args:
        live: from `live_recording`.
        what: e.g. "refining the model".
        share: of the work that is done, from 0 to 1.
    """

    def log(recording: LiveRecording) -> None:
        import rerun as rr

        seconds = round(time.perf_counter() - recording.began, 3)
        if not recording.steps or recording.steps[-1][1] != what:
            recording.steps.append((seconds, what))
            stream = recording.stream
            stream.set_time("work", duration=seconds)
            stream.set_time("time", duration=recording.start)  # the timeline that is in front
            stream.log(PROGRESS_LOG, rr.TextLog(label(what, 200), level=rr.TextLogLevel.INFO))
            stream.reset_time()
        _log_steps(recording, share=share)

    _attempt(live, log)


def log_result(
    identification: Identification,
    live: LiveRecording | None,
    *,
    geometry: "Geometry | None" = None,
    quality: "DataQuality | None" = None,
) -> None:
    """All pages, in place of what was shown while the work went on.

    Args:
        identification: from `modal.identify`.
        live: from `live_recording`.
        geometry: where the sensors are.
        quality: of the records as read.
    """
    _attempt(
        live, lambda recording: log_identification(identification, recording.stream, geometry=geometry, quality=quality)
    )


def _log_steps(live: LiveRecording, *, share: float = 0.0) -> None:
    """The steps so far as one text, which shows whatever timeline is in front."""
    import rerun as rr

    done = "■" * round(24 * min(max(share, 0.0), 1.0))  # in Rerun's own fonts, as few of its kind are
    now = cell(live.steps[-1][1]) if live.steps else "reading"
    lines = [f"- {seconds:.1f} s: {cell(what)}" for seconds, what in live.steps]
    bar = f"`{done}{'□' * (24 - len(done))}` {100 * share:.0f} %"
    text = "\n\n".join([f"### {now}", bar, "\n".join(lines)])
    live.stream.log(PROGRESS_TEXT, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)


def _attempt(live: LiveRecording | None, log: Callable[[LiveRecording], None]) -> None:
    """Send something; whatever goes wrong with it, the work goes on, and it is said once."""
    if live is None or live.is_lost:
        return
    try:
        with strict_errors():
            log(live)
    except Exception as error:  # noqa: BLE001 - a picture that fails must not stop the measurement's evaluation
        live.is_lost = True
        live.tell(f"The live view stopped ({label(str(error), 120)}); the work goes on without it.")


def _opened(host: str, port: int, *, may_spawn: bool, tell: Callable[[str], None]) -> LiveRecording | None:
    if not listens(host, port):
        if not may_spawn:
            tell(
                f"No Rerun viewer listens at {host}:{port}; start one with `rerun --port {port}`. Going on without it."
            )
            return None
        problem = open_viewer(port)
        if problem:
            tell(f"{problem} Going on without a live view; the recording in the folder will show the same.")
            return None
    if not speaks(host, port):
        tell(f"What listens at {host}:{port} does not answer as a Rerun viewer would. Going on without a live view.")
        return None
    import rerun as rr

    stream = rr.RecordingStream(APPLICATION, recording_id=f"live-{secrets.token_hex(8)}")
    stream.set_log_time_enabled(False)  # its timelines are "time" and "work"
    wire = Relay(host, port)
    stream.connect_grpc(f"rerun+http://{HOST}:{wire.port}/proxy")
    return LiveRecording(stream=stream, wire=wire, tell=tell)


def _close(live: LiveRecording) -> None:
    if not live.is_lost:
        try:
            live.stream.flush(timeout_sec=CLOSING)
        except Exception:  # noqa: BLE001 - the viewer was closed on the way, or is slow; what counts is in the folder
            live.tell("The Rerun viewer went away or fell behind; the recording in the folder shows the whole.")
            live.wire.cut()  # or Rerun waits for it without end
    leaving = threading.Thread(target=live.stream.disconnect, daemon=True)
    leaving.start()
    leaving.join(PATIENCE)
    live.wire.cut()
