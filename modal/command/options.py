"""What all commands share: options that mean the same everywhere, and errors as one sentence and an exit status."""

import contextlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from modal.wording.names import visible
from okid.errors import IdentificationError, InsufficientDataError
from okid.record import InputHold

__all__ = ["Dt", "Hold", "Inputs", "Outputs", "Overwrite", "Traceback", "complain", "examples", "faults"]

Inputs = Annotated[
    list[str] | None,
    typer.Option(metavar="NAMES", help="Names of the inputs, with commas between; output only unless given."),
]
Outputs = Annotated[
    list[str] | None, typer.Option(metavar="NAMES", help="Names of the outputs; all others unless given.")
]
Dt = Annotated[float | None, typer.Option(metavar="SECONDS", help="Time step in seconds, where the file has no time.")]
Hold = Annotated[
    InputHold,
    typer.Option(
        help="Input between samples: measured behind an anti-alias filter (band_limited), or held by a converter."
    ),
]
Overwrite = Annotated[bool, typer.Option("--overwrite", metavar="", help="Replace a report that is there already.")]
Traceback = Annotated[bool, typer.Option("--traceback", metavar="", help="Show where a fault of this program arose.")]
Records = Annotated[
    list[Path],
    typer.Argument(
        metavar="FILE",
        help="CSV, NPY, NPZ, MAT, UFF 58, Parquet or TDMS; several files are several records of one system, or the "
        "channels of one record.",
    ),
]


def examples(*commands: str) -> str:
    r"""The last lines of a help text: commands to copy, each after what it does where that is said as "what: command".

    Example:
        >>> examples("one file: run test.csv")
        'Examples\n\none file\n\n  [bold]modal-report run test.csv[/bold]'
    """
    parts = ["Examples"]
    for text in commands:
        what, _, command = text.partition(": ")
        parts += [what, f"  [bold]modal-report {command}[/bold]"]
    return "\n\n".join(parts)


@contextlib.contextmanager
def faults(*, show: bool, poor_data: int = 2) -> Iterator[None]:
    """Turn an error into one sentence and an exit status; `poor_data` where the data are not enough."""
    try:
        yield
    except InsufficientDataError as error:
        complain(str(error))
        raise typer.Exit(poor_data) from error
    except IdentificationError as error:
        complain(str(error))
        raise typer.Exit(2) from error
    except (typer.Exit, typer.Abort):
        raise
    except Exception as error:
        if show:
            raise
        kind = type(error).__name__
        complain(f"a fault in modal-report stopped the work ({kind}: {error}); add --traceback to see where.")
        raise typer.Exit(3) from error


def complain(sentence: str) -> None:
    """One line on stderr."""
    typer.echo(f"modal-report: {re.sub(' +', ' ', visible(sentence))}", err=True)
