"""A result while it is being made: streamed to a Rerun viewer that is open, or that is opened for it.

The viewer is company, not part of the work: where there is none, where it cannot be opened or where it is closed on the
way, one sentence says so and the work goes on. Nothing here waits longer than a second or two, and nothing raises.

Rerun waits without end for a viewer that has stopped answering (a machine asleep, a network gone), when a stream is
closed and again when the program ends. Bytes that pass through a socket of our own can be stopped there: Rerun then
sees a broken connection, and gives up at once.
"""

import contextlib
import importlib.util
import os
import secrets
import socket
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

from modal.geometry.sensors import Geometry
from modal.identification.result import Identification
from modal.modes.mode import ModalModel
from modal.quality.check import DataQuality, check_quality
from modal.recording.figure import Blueprint, RecordingStream, document_view, rr, rrb
from modal.recording.identification.record import log_record_page, record_page
from modal.recording.plan import DataPlan, cell, label, log_text, planned_data
from modal.recording.stream import APPLICATION, log_identification, show_whole_record, strict_errors, whole_blueprint
from okid.errors import IdentificationWarning, InvalidDataError
from okid.record import Record


def live_blueprint(records: Sequence[Record], plan: DataPlan, quality: DataQuality) -> Blueprint:
    """The records, and what the work is at."""
    record = record_page(records, plan, quality)
    show_whole_record(record, plan)
    progress = rrb.Horizontal(
        document_view("progress/text", "What is being done"),
        rrb.TextLogView(origin="progress/log", name="Log"),
        column_shares=[1.0, 1.0],
        name="Progress",
    )
    return whole_blueprint([record, progress], plan)


PIECE = 1 << 18


class Relay:
    """Passes bytes between a port of this machine and one elsewhere until it is cut.

    Attributes:
        port: of this machine, on which it listens.
    """

    def __init__(self, host: str, port: int) -> None:
        """Listen; the other side is called when somebody calls here."""
        self._other = (host, port)
        self._listening = socket.create_server(("127.0.0.1", 0))
        self._sockets = [self._listening]
        self._is_cut, self._lock = False, threading.Lock()
        self.port: int = self._listening.getsockname()[1]
        threading.Thread(target=self._answer, daemon=True).start()

    def cut(self) -> None:
        """Close both sides of every connection, whatever is on its way."""
        with self._lock:
            self._is_cut = True
        for one in self._sockets:
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
            one.close()

    def _answer(self) -> None:
        with contextlib.suppress(OSError):  # cut, or the other side is gone
            while True:
                here = self._kept(self._listening.accept()[0])
                there = self._kept(socket.create_connection(self._other))
                for pair in ((here, there), (there, here)):
                    threading.Thread(target=_pass_on, args=pair, daemon=True).start()

    def _kept(self, one: socket.socket) -> socket.socket:
        """The socket, which `cut` will close; at once where it has cut already."""
        with self._lock:
            if not self._is_cut:
                self._sockets.append(one)
                return one
        one.close()
        raise OSError


def _pass_on(giver: socket.socket, taker: socket.socket) -> None:
    with contextlib.suppress(OSError):
        while piece := giver.recv(PIECE):
            taker.sendall(piece)
    for one in (giver, taker):  # what is broken on one side is broken on the other
        with contextlib.suppress(OSError):
            one.shutdown(socket.SHUT_RDWR)


HOST: Final = "127.0.0.1"
PORT: Final = 9876
"""Where a Rerun viewer listens unless it is told otherwise."""

SETTINGS: Final = b"\x00\x00\x00\x04\x00\x00\x00\x00\x00"
"""A frame of HTTP/2 without content: its length, its type, flags, stream 0."""


class Wait:
    """How long a viewer is waited for [s]."""

    PATIENCE: Final = 1.0
    """Seconds to wait for an answer when the viewer is sought."""
    OPENING: Final = 2.0
    """Seconds to wait for a viewer that was opened."""
    CLOSING: Final = 2.0
    """Seconds to wait until the viewer has taken everything."""


def host_and_port(address: str | None) -> tuple[str, int]:
    """Of an address host:port or rerun+http://host:port/proxy; the usual one of this machine for None.

    Raises:
        InvalidDataError: it is none.
    """
    if address is None:
        return HOST, PORT
    parts = urlsplit(address if "://" in address else f"//{address}")
    try:
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port = None, None
    if not host or (parts.scheme and not parts.scheme.startswith("rerun")):
        raise InvalidDataError(
            f"the address of a viewer is host:port or rerun+http://host:port/proxy, but is {label(address, 80)!r}."
        )
    return host, port or PORT


def listens(host: str, port: int) -> bool:
    """Whether anybody takes a connection there."""
    try:
        socket.create_connection((host, port), timeout=Wait.PATIENCE).close()
    except OSError:
        return False
    return True


def speaks(host: str, port: int) -> bool:
    """Whether the protocol of a viewer is spoken there: Rerun itself would wait for an answer without end.

    References:
        RFC 9113, HTTP/2, section 3.4: both sides begin with a SETTINGS frame. doi 10.17487/RFC9113
    """
    try:
        with socket.create_connection((host, port), timeout=Wait.PATIENCE) as one:
            one.sendall(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + SETTINGS)
            answer = one.recv(len(SETTINGS))
    except OSError:
        return False
    return len(answer) == len(SETTINGS) and answer[3] == SETTINGS[3]


def open_viewer(port: int) -> str:
    """Open a viewer on this machine and wait a moment for it; in words why there is none, "" where there is."""
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return f"No Rerun viewer listens at port {port}, and this machine has no display to open one on."
    package = importlib.util.find_spec("rerun_cli")
    if package is None or package.origin is None:
        return "The Rerun viewer is not installed beside rerun-sdk."
    program = Path(package.origin).parent / ("rerun.exe" if os.name == "nt" else "rerun")
    try:
        subprocess.Popen(  # noqa: S603 - the viewer that came with rerun-sdk, and a number
            [program, "--port", str(port), "--hide-welcome-screen"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
    except OSError as error:
        return f"A Rerun viewer could not be opened ({label(str(error), 80)})."
    end = time.perf_counter() + Wait.OPENING
    while time.perf_counter() < end:
        if listens(HOST, port):
            return ""
        time.sleep(0.05)
    return f"The Rerun viewer that was opened did not answer at port {port} within {Wait.OPENING:g} s."


READ: Final = "read"
"""Above the channels as they were read; those of the result lie elsewhere."""

PROGRESS_TEXT: Final = "progress/text"
PROGRESS_LOG: Final = "progress/log"


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

    def __init__(self, *, stream: RecordingStream, wire: Relay, tell: Callable[[str], None]) -> None:
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


def log_records(records: Sequence[Record], live: LiveRecording | None) -> None:
    """The page "Record", as soon as the records are read."""

    def log(recording: LiveRecording) -> None:
        plan = planned_data(records, root=READ)
        recording.start = plan.start
        found = check_quality(records)
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
    geometry: Geometry | None = None,
    quality: DataQuality | None = None,
) -> None:
    """All pages, in place of what was shown while the work went on."""
    _attempt(
        live, lambda recording: log_identification(identification, recording.stream, geometry=geometry, quality=quality)
    )


@contextmanager
def estimate_recording(path: Path) -> Iterator[RecordingStream]:
    """A recording of windowed modes in a file, readable while it grows."""
    stream = rr.RecordingStream(APPLICATION, recording_id=f"live-{secrets.token_hex(8)}")
    stream.set_log_time_enabled(False)
    stream.save(path)
    try:
        yield stream
    finally:
        stream.disconnect()


def log_estimate(
    time_in_middle: float, modes: ModalModel, warnings_of_it: Sequence[str], stream: RecordingStream
) -> None:
    """The oscillatory modes of one window against time: frequencies, damping ratios, and what must be said of it."""
    seen = [mode for mode in modes if mode.kind == "oscillatory"]
    stream.set_time("time", duration=time_in_middle)
    for path, values in (
        (["modes", "frequency [Hz]"], [mode.frequency for mode in seen]),
        (["modes", "damping ratio [%]"], [100.0 * mode.damping_ratio for mode in seen]),
    ):
        stream.log(path, rr.SeriesPoints(marker_sizes=3.0), static=True)
        if values:
            stream.log(path, rr.Scalars(values))
    for text in warnings_of_it:
        stream.log("log", rr.TextLog(text, level="WARN"))
    stream.flush(timeout_sec=Wait.CLOSING)


def _log_steps(live: LiveRecording, *, share: float = 0.0) -> None:
    """The steps so far as one text, which shows whatever timeline is in front."""
    done = "■" * round(24 * min(max(share, 0.0), 1.0))  # in Rerun's own fonts, as few of its kind are
    now = cell(live.steps[-1][1]) if live.steps else "reading"
    lines = [f"- {seconds:.1f} s: {cell(what)}" for seconds, what in live.steps]
    bar = f"`{done}{'□' * (24 - len(done))}` {100 * share:.0f} %"
    text = "\n\n".join([f"### {now}", bar, "\n".join(lines)])
    log_text(live.stream, PROGRESS_TEXT, text)


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
    stream = rr.RecordingStream(APPLICATION, recording_id=f"live-{secrets.token_hex(8)}")
    stream.set_log_time_enabled(False)  # its timelines are "time" and "work"
    wire = Relay(host, port)
    stream.connect_grpc(f"rerun+http://{HOST}:{wire.port}/proxy")
    return LiveRecording(stream=stream, wire=wire, tell=tell)


def _close(live: LiveRecording) -> None:
    if not live.is_lost:
        try:
            live.stream.flush(timeout_sec=Wait.CLOSING)
        except Exception:  # noqa: BLE001 - the viewer was closed on the way, or is slow; what counts is in the folder
            live.tell("The Rerun viewer went away or fell behind; the recording in the folder shows the whole.")
            live.wire.cut()  # or Rerun waits for it without end
    leaving = threading.Thread(target=live.stream.disconnect, daemon=True)
    leaving.start()
    leaving.join(Wait.PATIENCE)
    live.wire.cut()
