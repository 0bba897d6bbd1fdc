"""The work shown in a running viewer while it goes on; without one asked for, or to be had, nothing happens."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from modal.recording.live import live_recording, log_progress, log_records, log_result
from okid.record import Record

if TYPE_CHECKING:
    from modal.geometry.sensors import Geometry
    from modal.identification.result import Identification

__all__ = ["LiveView", "live_view"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LiveView:
    """A viewer that is told of the work.

    Attributes:
        recording: stream to the viewer, None where there is none.
    """

    recording: Any = None

    def show_records(self, records: Sequence[Record]) -> None:
        """The page of the records, as soon as they are read."""
        if self.recording is not None:
            log_records(records, self.recording)

    def show_progress(self, what: str, share: float) -> None:
        """What is being done, and the share that is behind."""
        if self.recording is not None:
            log_progress(self.recording, what, share)

    def show_result(self, result: "Identification", geometry: "Geometry | None") -> None:
        """All pages of the result."""
        if self.recording is not None:
            log_result(result, self.recording, geometry=geometry)


@contextlib.contextmanager
def live_view(*, wanted: bool, tell: Callable[[str], None]) -> Iterator[LiveView]:
    """A viewer for the time of the work.

    Args:
        wanted: whether one was asked for.
        tell: gets one sentence where no viewer can be had.

    Example:
        >>> with live_view(wanted=False, tell=print) as view:
        ...     view.show_progress("reading", 0.0)
    """
    if not wanted:
        yield LiveView()
        return
    with live_recording(tell=tell) as recording:
        yield LiveView(recording=recording)
