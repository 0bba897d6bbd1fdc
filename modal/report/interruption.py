"""Stopping on request: Ctrl-C, a polite kill and a closed terminal all stop the work, and none leaves it half done."""

import contextlib
import signal
import threading
import time
from collections.abc import Iterator
from types import FrameType

__all__ = ["stop_no_more", "stop_politely", "uninterrupted"]

_STOPS = tuple(
    number
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
    if (number := getattr(signal, name, None)) is not None
)
_AGAIN_AFTER = 3.0
"""Seconds within which a second request is taken for the same one: it must not stop the clearing up."""


def stop_politely() -> None:
    """Let every request to stop raise KeyboardInterrupt, so that what is half done is cleared away."""
    last = [-_AGAIN_AFTER]

    def stop(_number: int, _frame: FrameType | None) -> None:
        now = time.monotonic()
        if now - last[0] >= _AGAIN_AFTER:
            last[0] = now
            raise KeyboardInterrupt

    for number in _STOPS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # nohup
            signal.signal(number, stop)


def stop_no_more() -> None:
    """Ignore requests to stop from here on: the work has stopped and is cleared away, only the exit status is left."""
    for number in _STOPS:
        signal.signal(number, signal.SIG_IGN)


@contextlib.contextmanager
def uninterrupted() -> Iterator[None]:
    """Put requests to stop off until the block is done: for the few steps of which all or none must happen.

    Example:
        >>> with uninterrupted():
        ...     done = ["both files", "moved"]
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # Python hands signals to the main thread alone
        return
    asked: list[tuple[int, FrameType | None]] = []
    before = {number: signal.getsignal(number) for number in _STOPS}
    handled = {number: handler for number, handler in before.items() if handler is not None}
    for number in handled:
        signal.signal(number, lambda number, frame: asked.append((number, frame)))
    try:
        yield
    finally:
        for number, handler in handled.items():
            signal.signal(number, handler)
        if asked:
            signal.raise_signal(asked[0][0])
