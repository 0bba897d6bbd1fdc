"""Requests to stop a run: noted at once, heeded between two of its steps.

A first Ctrl-C (or a polite kill, or a closed terminal) sets a flag, at which the work stops between two of its steps;
nothing is raised in the middle of one, where a library's finaliser could swallow it. A second one ends the process at
once, cleared away. Once a result stands in its folder, the run ends as one that is done.
"""

import os
import signal
from collections.abc import Callable
from types import FrameType

STOPPED = 130
"""Exit status of shells for a program that Ctrl-C stopped."""

_NAMES = ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")


class Requests:
    """Requests to stop this process, of which there is one set.

    Class attributes:
        asked: How many came.
        clear_away: Called before the process ends at once.
    """

    asked = 0
    clear_away: Callable[[], None] | None = None

    @classmethod
    def note(cls, _number: int, _frame: FrameType | None) -> None:
        """Set the flag; at the second request end the process."""
        cls.asked += 1
        if cls.asked == 1:
            if os.isatty(2):
                _say("stopping after this step; once more stops at once.")
            return
        cls.ignore()
        if cls.clear_away is not None:
            cls.clear_away()
        _say("stopped; nothing was left half-written.")
        os._exit(STOPPED)

    @classmethod
    def listen(cls) -> None:
        """Note requests from here on; what nohup ignores stays ignored."""
        cls.asked = 0
        for number in _signals():
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, cls.note)

    @classmethod
    def ignore(cls) -> None:
        """Ignore requests from here on: only the exit status is left."""
        for number in _signals():
            signal.signal(number, signal.SIG_IGN)

    @classmethod
    def check(cls) -> None:
        """Raise between two steps if a request came.

        Raises:
            KeyboardInterrupt: one came.
        """
        if cls.asked:
            raise KeyboardInterrupt


def _signals() -> list[int]:
    return [number for name in _NAMES if (number := getattr(signal, name, None)) is not None]


def _say(sentence: str) -> None:
    """One line on stderr, past every buffer; the bar's cursor is shown again."""
    shown = b"\x1b[?25h\n" if os.isatty(2) else b""
    try:
        os.write(2, shown + f"modal-report: {sentence}\n".encode())
    except OSError:  # the terminal is closed
        return
