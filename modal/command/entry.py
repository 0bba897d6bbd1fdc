"""The first lines of `modal-report`: requests to stop are noted before anything else is imported.

A first Ctrl-C (or a polite kill, or a closed terminal) sets a flag, at which the work stops between two of its steps;
nothing is raised in the middle of one, where a library's finaliser could swallow it. A second one ends the process at
once, cleared away. Once a result stands in its folder, the run ends as one that is done.
"""

import contextlib
import io
import os
import signal
import sys
from collections.abc import Callable
from types import FrameType
from typing import Any

STOPPED = 130
"""Exit status of shells for a program that Ctrl-C stopped."""

LEAST_ADDRESSES, WITH_RECORDING = 2**30, 3 * 2**30
"""Begin nothing where less may be mapped [bytes]: BLAS and the viewer's library wait for ever for memory, or abort."""

LEAST_FILES = 16
"""Begin nothing where fewer files may be open: the recording's library ends the process where it gets none."""

WITHOUT_RECORDING = frozenset(["check", "diff", "view", "-h", "--help", "--version"])

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


class _Unheard(io.FileIO):
    """A stream for what is only said: where it finds no room, or its terminal has gone, the work goes on."""

    def write(self, data: Any) -> int:
        """Write, and take what cannot be written for written."""
        with contextlib.suppress(OSError):
            return super().write(data) or memoryview(data).nbytes  # None where a pipe that does not wait is full
        return memoryview(data).nbytes


def main() -> None:
    """Run the command and leave with its exit status."""
    Requests.listen()
    if isinstance(sys.stderr, io.TextIOWrapper):
        raw = io.BufferedWriter(_Unheard(sys.stderr.fileno(), "w", closefd=False))
        sys.stderr = io.TextIOWrapper(raw, sys.stderr.encoding, sys.stderr.errors, line_buffering=True)
    if os.environ.get("COLUMNS", "").strip("0") == "":  # some programs that stand between say so where they do not know
        os.environ.pop("COLUMNS", None)
    refused = _not_to_load(sys.argv[1:])
    if refused:
        if sys.stderr is not None:  # closed by the shell
            sys.stderr.write(f"modal-report: {refused}\n")
        sys.exit(2)
    from modal.command.main import leave

    leave()


def _not_to_load(arguments: list[str]) -> str:
    """Why the libraries cannot even be loaded, "" where they can."""
    epoch = os.environ.get("SOURCE_DATE_EPOCH", "0")
    if not epoch.isdecimal():  # scipy loads a part of numpy that reads it
        return f"SOURCE_DATE_EPOCH must be a whole number of seconds, but is {epoch!a}; correct it, or unset it."
    try:
        import resource
    except ImportError:  # Windows
        return ""
    n_files, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if n_files != resource.RLIM_INFINITY and n_files < LEAST_FILES:
        return f"ulimit -n allows {n_files} open files, and the libraries need {LEAST_FILES}; raise it."
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    need = LEAST_ADDRESSES if WITHOUT_RECORDING & {*arguments[:1], *arguments[-1:]} else WITH_RECORDING
    if limit == resource.RLIM_INFINITY or limit >= need:
        return ""
    return (
        f"ulimit -v allows {limit / 2**30:.2g} GiB to be mapped, and the libraries map up to {need / 2**30:.0f} GiB, "
        "of which they use little; raise it, or limit the memory by a control group."
    )
