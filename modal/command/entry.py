"""The first lines of `modal-report`: requests to stop are noted before anything else is imported."""

import contextlib
import io
import os
import sys
from typing import Any

from modal.command.stopping import Requests

LEAST_ADDRESSES, WITH_RECORDING = 2**30, 3 * 2**30
"""Begin nothing where less may be mapped [bytes]: BLAS and the viewer's library wait for ever for memory, or abort."""

LEAST_FILES = 16
"""Begin nothing where fewer files may be open: the recording's library ends the process where it gets none."""

WITHOUT_RECORDING = frozenset(["check", "diff", "view", "-h", "--help", "--version"])


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
