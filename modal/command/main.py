"""The command `modal-report`: from measured files to modes, a report and a recording.

Exit status: 0 done; 1 done, but the result is not reliable (no mode of the system,
or a gap that no effect is proved to explain) or a limit of acceptance is not surely met; 2 wrong use or unreadable
input, one sentence on stderr, nothing written; 3 a fault of ours; 130 stopped.
"""

import atexit
import contextlib
import os
import sys
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from modal.command import check, gap, many, results, run
from modal.command.options import complain, spread_files
from modal.command.stopping import STOPPED, Requests
from modal.command.terminal import plain_streams
from modal.report.folder import clear_away
from modal.sections.validation import installed_version

app = typer.Typer(
    add_completion=True,
    no_args_is_help=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def leave() -> None:
    """Run the command and leave with its exit status; requests to stop are noted already."""
    if "--traceback" not in sys.argv:  # what a library's finaliser meets, where memory ran out, is nothing to read
        sys.unraisablehook = lambda _met: None
    number = status(sys.argv[1:])
    Requests.ignore()
    _end(number)


def _end(number: int) -> NoReturn:
    """End the process with what Python does at its end, without the finalisers of its libraries.

    The readers' threads (pyarrow) may still run then, and where they do, these abort a process that has done its work.
    """
    atexit._run_exitfuncs()  # noqa: SLF001 - there is no public way to run them and no more
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):  # gone, closed, or None from the start
            stream.flush()
    os._exit(number)


def status(arguments: list[str]) -> int:
    """Exit status for the arguments; whatever goes wrong is one sentence on stderr."""
    Requests.clear_away = clear_away
    plain_streams()
    if arguments[:1] == ["gap"]:
        arguments = ["gap", *spread_files(arguments[1:], ("--fit", "--held-out"))]
    try:
        Requests.check()
        found = app(arguments, prog_name="modal-report", standalone_mode=False)
    except (KeyboardInterrupt, typer.Abort):
        found = STOPPED
    except Exception as error:
        explain = getattr(error, "format_message", None)  # wrong use, as typer found it
        if explain is None:
            raise
        text = explain() or "no command was given."
        complain(_with_help(text.replace("Value error, ", "").rstrip("."), arguments))
        found = 2
    if found == STOPPED:
        complain("stopped; nothing was left half-written.")
    return found if isinstance(found, int) else 0


def _with_help(text: str, arguments: list[str]) -> str:
    """The sentence of typer, and where the help for it is."""
    known = {command.name or getattr(command.callback, "__name__", "") for command in app.registered_commands}
    command = "".join(f" {word}" for word in arguments[:1] if word in known)
    return f"{text}{' See' if text.endswith('?') else '; see'} modal-report{command} --help."


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"modal-report {installed_version()} (modal from {Path(__file__).parents[1]})")
        raise typer.Exit


@app.callback(
    epilog="Every command has examples: [bold]modal-report run --help[/bold]. "
    "Completion of commands, options and file names: [bold]modal-report --install-completion[/bold]."
)
def _root(
    *,
    version: Annotated[
        bool,
        typer.Option(
            "--version",
            metavar="",
            callback=_version,
            is_eager=True,
            help="Print version and the path of modal in use.",
        ),
    ] = False,
) -> None:
    """Modes of a machine or structure from measured inputs and outputs, with a verdict on every mode."""


app.command(epilog=run.EXAMPLES)(run.run)
app.command(epilog=run.DEMO_EXAMPLES)(run.demo)
app.command(epilog=many.BATCH_EXAMPLES)(many.batch)
app.command(epilog=check.EXAMPLES)(check.check)
app.command(epilog=gap.EXAMPLES)(gap.gap)
app.command(epilog=results.DIFF_EXAMPLES)(results.diff)
app.command(epilog=many.TRACK_EXAMPLES)(many.track)
app.command(epilog=many.LIVE_EXAMPLES)(many.live)
app.command(epilog=results.VIEW_EXAMPLES)(results.view)
