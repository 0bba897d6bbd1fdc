"""What all commands share: options that mean the same, what is typed as the library takes it, one sentence a fault."""

import contextlib
import errno
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Literal

import typer

from modal.preparation.kind import GivenKind
from okid.errors import IdentificationError, InsufficientDataError, InvalidDataError, visible
from okid.readers.guard import first_line
from okid.record import InputHold

Inputs = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAMES",
        help="Names of the inputs, with commas between, or a pattern ('force*'); unless given what the file states, "
        "if no outputs are named either, else output only.",
    ),
]
Outputs = Annotated[
    list[str] | None,
    typer.Option(metavar="NAMES", help="Names of the outputs, or a pattern; all that are no inputs unless given."),
]


def _seconds(text: str | float) -> float:
    """A number as everybody writes it: Python alone would take "1_0" for ten."""
    try:
        return float(str(text).replace("_", "x"))
    except ValueError:
        raise typer.BadParameter(f"{text!r} is no number; write seconds such as 0.001") from None


Dt = Annotated[
    float | None,
    typer.Option(metavar="SECONDS", parser=_seconds, help="Time step in seconds, where the file has no time."),
]
Hold = Annotated[
    InputHold,
    typer.Option(
        help="Input between samples: measured behind an anti-alias filter (band_limited), or held by a converter."
    ),
]
Kind = Annotated[
    GivenKind,
    typer.Option(
        help="What was recorded: forces throughout, blows, a ring-down, or no input; the data say it unless given."
    ),
]
Overwrite = Annotated[bool, typer.Option("--overwrite", metavar="", help="Replace a report that is there already.")]
Traceback = Annotated[bool, typer.Option("--traceback", metavar="", help="Show where a fault of this program arose.")]
Records = Annotated[
    list[Path],
    typer.Argument(
        metavar="FILE",
        help="CSV, NPY, NPZ, MAT, UFF 58, Parquet, TDMS, LVM or WAV; several files are several records of one system, "
        "or the channels of one record.",
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
        no_room = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EPIPE)
        if isinstance(error, OSError) and error.errno in no_room:
            complain(f"what is printed or written finds no room ({first_line(error)}); make some, or print elsewhere.")
            raise typer.Exit(2) from error
        if isinstance(error, FileNotFoundError) and not _stands():
            complain("the folder that this runs in was removed; change to one that is there (cd).")
            raise typer.Exit(2) from error
        if _wants_memory(error):
            complain(
                f"there is not enough memory for this ({first_line(error)}); give shorter records or fewer channels, "
                "or a machine with more."
            )
            raise typer.Exit(2) from error
        kind = type(error).__name__
        complain(f"a fault in modal-report stopped the work ({kind}: {error}); add --traceback to see where.")
        raise typer.Exit(3) from error


def _stands() -> bool:
    """Whether the working folder is there."""
    try:
        return Path.cwd().is_dir()
    except OSError:
        return False


def _wants_memory(error: Exception) -> bool:
    """Whether memory ran out: a library that cannot be mapped or a thread that cannot begin says so in its own way."""
    said = ("failed to map segment", "cannot allocate memory", "can't start new thread", "failed to spawn")
    return isinstance(error, MemoryError) or (
        isinstance(error, ImportError | OSError | RuntimeError) and any(words in str(error).lower() for words in said)
    )


def complain(sentence: str) -> None:
    """One line on stderr."""
    typer.echo(f"modal-report: {re.sub(' +', ' ', visible(sentence))}", err=True)


def folder_path(given: str | Path) -> Path:
    """A folder as it is given; an empty name would be the folder that the user stands in.

    Raises:
        typer.BadParameter: no name.
    """
    if not str(given).strip():
        raise typer.BadParameter("the name of the folder is empty; give one, such as -o result")
    return Path(given)


Auto = Literal["auto"]


def name_list(given: list[str] | None, what: str) -> list[str] | None:
    """Names with commas between, from one option or several; None where it was not given.

    Example:
        >>> name_list(["a, b", "c"], "inputs")
        ['a', 'b', 'c']
    """
    if given is None:
        return None
    names = [name.strip() for text in given for name in text.split(",") if name.strip()]
    if not names:
        raise InvalidDataError(
            f"the {what} are given as {', '.join(given)!r}, which names no channel; name at least one, or leave the "
            "option out."
        )
    return names


def whole_or_auto(text: str, what: str) -> int | Auto:
    """A whole number of at least 1, or "auto"."""
    if text == "auto":
        return "auto"
    if not re.fullmatch(r"[0-9]{1,6}", text) or int(text) < 1:
        raise InvalidDataError(f"the {what} must be a whole number of at least 1 or auto, but is {text!r}.")
    return int(text)


def number_or_auto(text: str, what: str) -> float | Auto:
    """A number of at least 0, or "auto"."""
    if text == "auto":
        return "auto"
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 <= value < float("inf"):
        raise InvalidDataError(f"the {what} must be a number of at least 0 or auto, but is {text!r}.")
    return value


def plain_name(stem: str) -> str:
    """A name for a folder, from that of a file.

    Example:
        >>> plain_name("../test 1")
        'test_1'
    """
    return re.sub(r"[^\w.-]+", "_", stem)[:80].strip("._") or "result"


def spread_files(arguments: Sequence[str], options: Sequence[str]) -> list[str]:
    """Let an option take all the files that follow it: "--fit a b" becomes "--fit a --fit b".

    Only behind the first word that is no option's value; before it, an option takes the one file that follows, so that
    the first word cannot be taken for a file of the option.

    Example:
        >>> spread_files(["model.toml", "--fit", "a", "b", "--dt", "0.1"], ["--fit"])
        ['model.toml', '--fit', 'a', '--fit', 'b', '--dt', '0.1']
    """
    spread: list[str] = []
    taking, first_seen, is_value = "", False, False
    for word in arguments:
        if word.startswith("-") and len(word) > 1:
            taking = word if word in options else ""
            is_value = "=" not in word
            spread.append(word)
        elif is_value:
            is_value = False
            spread.append(word)
        elif taking and first_seen:
            spread += [taking, word]
        else:
            first_seen = True
            spread.append(word)
    return spread
