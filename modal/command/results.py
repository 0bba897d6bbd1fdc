"""Kept results: `modal-report diff` says what changed between two, `modal-report view` opens a recording.

A difference is one row a mode, what is lost or new, and what else differs; where no viewer can open, the exact command
stands there that opens the recording elsewhere.
"""

import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from modal.command.options import Overwrite, Traceback, complain, examples, faults, folder_path
from modal.command.terminal import Screen, listing, plain, show_paths
from modal.comparison import words
from modal.comparison.changes import Comparison, Difference, ModePair, compare_results
from modal.comparison.shifts import Shift, read_result
from modal.report.comparison import ComparisonFiles, write_comparison
from modal.report.folder import refuse_names
from modal.wording.text import hertz, shorten
from okid.errors import InvalidDataError, UnreadableFileError, visible
from okid.readers.guard import Existing

_MARKS = {"beyond chance": "*", "perhaps chance": "~", "within its interval": " ", "not known": "?"}
_COLOURS = {
    "beyond chance": "bold red",
    "perhaps chance": "yellow",
    "within its interval": "green",
    "not known": "bright_black",
}


def show_difference(console: Console, comparison: Comparison) -> None:
    """All of a comparison that a terminal has room for."""
    before, after = comparison.before.name, comparison.after.name
    console.print()
    console.print(plain(f"{before} → {after}", "bright_black"))
    console.print(plain(words.comparison_headline(comparison), "bold"))
    if comparison.pairs:
        console.print()
        console.print(_table(comparison.pairs))
        told = {shift.verdict for pair in comparison.pairs for shift in pair.shifts}
        legend = [f"{mark} {verdict}" for verdict, mark in _MARKS.items() if verdict in told and mark.strip()]
        console.print(plain("   ".join(legend) or "all within their intervals", "bright_black"))
    lost = [words.unmatched_sentence(one, present=before, absent=after) for one in comparison.lost]
    new = [words.unmatched_sentence(one, present=after, absent=before) for one in comparison.new]
    listing(console, "Lost", lost, "yellow")
    listing(console, "New", new, "yellow")
    listing(console, "Differs as well", [_difference(one) for one in comparison.differences], "")
    listing(console, "Read with care", words.caution_sentences(comparison), "yellow")
    console.print()
    console.print(plain(words.how_sentence(comparison), "bright_black"))


def _table(pairs: Sequence[ModePair]) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bright_black", padding=(0, 2, 0, 0))
    for heading in ("", "Hz before", "after", "frequency", "damping ratio", "MAC"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("")
    for pair in pairs:
        verdicts = (pair.before.verdict, pair.after.verdict)
        table.add_row(
            plain(str(pair.number_before), "bright_black"),
            plain(hertz(pair.before.frequency)),
            plain(hertz(pair.after.frequency)),
            _marked(words.percent_text(pair.frequency), pair.frequency),
            _marked(words.percent_text(pair.damping), pair.damping),
            _marked(words.assurance_text(pair.shape), pair.shape),
            plain(" → ".join(verdicts) if len(set(verdicts)) > 1 else "", "yellow"),
        )
    return table


def _marked(text: str, shift: Shift) -> Text:
    return plain(f"{text} {_MARKS[shift.verdict]}", _COLOURS[shift.verdict])


def _difference(one: Difference) -> str:
    return f"{one.what}: {one.before or 'not there'} → {one.after or 'not there'}"


DIFF_EXAMPLES = examples(
    "two results: diff before after",
    "with a page to keep: diff before after -o change",
    "saved results: diff monday.npz tuesday.npz",
)

_RESULT = "Folder that run wrote, or a saved result (.npz)."


def diff(
    before: Annotated[Path, typer.Argument(metavar="A", help=_RESULT)],
    after: Annotated[Path, typer.Argument(metavar="B", help="The same of the second result.")],
    *,
    folder: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--out",
            metavar="FOLDER",
            parser=folder_path,
            help="Write the comparison as HTML, Markdown and JSON too.",
        ),
    ] = None,
    overwrite: Overwrite = False,
    traceback: Traceback = False,
) -> None:
    """Say what changed from result A to result B: modes matched, shifts against their intervals, modes lost and new.

    Exit status: 0 compared, whatever was found; 1 compared, but a result
    has no mode of the system or is not reliable; 2 wrong use or
    unreadable input.
    """
    with faults(show=traceback):
        existing: Existing = "replace" if overwrite else "refuse"
        if folder is not None:
            refuse_names(folder, ComparisonFiles.in_folder(folder).names, existing)
        comparison = compare_results(read_result(before), read_result(after))
        files = None if folder is None else write_comparison(comparison, folder, existing=existing)
        console = Screen(highlight=False)
        show_difference(console, comparison)
        if files is not None:
            pages = ((files.html, "to read"), (files.markdown, "the same as Markdown"), (files.json, "every number"))
            show_paths(console, *pages)
        sides = (comparison.before, comparison.after)
        carried = all(
            side.trust != "not carried" and any(mode.verdict == "system" for mode in side.modes) for side in sides
        )
        raise typer.Exit(0 if carried else 1)


RECORDING = "recording.rrd"

_MAGIC = (b"RRF2", b"RRF0", b"RRF1")
"""First bytes of a recording."""

_FOOTER, _WITH_FOOTER = b"RRF2FOOT", (0, 41)
"""Last words of a recording that is whole, and the version of Rerun from which we know them."""


def recording_of(result: str | Path) -> Path:
    """The recording in the folder of a result, or the file itself.

    Raises:
        UnreadableFileError: there is no such file, no recording in the folder, or it holds something else.
    """
    path = Path(result)
    shown = repr(shorten(visible(str(path)), 200))
    try:
        if path.is_dir():
            path = _in_folder(path, shown)
        elif not path.is_file():
            raise UnreadableFileError(f"there is no {shown}; give a folder that modal-report run wrote.")
        with path.open("rb") as file:
            start = file.read(8)
            file.seek(max(0, path.stat().st_size - len(_FOOTER) - 4))
            end = file.read()
    except OSError as error:
        raise UnreadableFileError(f"{shown} cannot be read ({error.strerror or error}).") from error
    if start[:4] == _MAGIC[0] and tuple(start[4:6]) >= _WITH_FOOTER and _FOOTER not in end:
        raise UnreadableFileError(f"{shown} is cut off or damaged: its last part is missing; write it again.")
    if start[:4] not in _MAGIC:
        raise UnreadableFileError(f"{shown} is no Rerun recording; give a folder that modal-report run wrote.")
    return path


def find_viewer() -> Path | None:
    """The program `rerun`: the one beside this Python comes first, since it reads what this version wrote."""
    folder = str(Path(sys.executable).parent)
    found = shutil.which("rerun", path=folder) or shutil.which("rerun")
    return Path(found) if found else None


def open_recording(recording: Path) -> str:
    """Open the viewer and let it live on by itself.

    Returns:
        "" when it opened, else one sentence: why not, and what to do.

    Raises:
        InvalidDataError: the viewer is there but cannot be started.
    """
    viewer = find_viewer()
    command = shlex.join(["rerun", str(recording)])
    if viewer is None:
        return f"there is no Rerun viewer here; install it (pip install rerun-sdk), then: {command}."
    if not _has_display():
        in_browser = shlex.join([str(viewer), str(recording), "--web-viewer"])
        return f"there is no display here; on a machine with one: {command}, or here for a browser: {in_browser}."
    try:
        subprocess.Popen(  # noqa: S603 - no shell; the program was found by its name, the file is a path of its own
            [str(viewer), str(recording.absolute())],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # closing the terminal does not close the viewer
        )
    except OSError as error:
        raise InvalidDataError(f"{viewer} cannot be started ({error.strerror or error}); try: {command}.") from error
    return ""


def _in_folder(folder: Path, shown: str) -> Path:
    if (folder / RECORDING).is_file():
        return folder / RECORDING
    others = sorted(path for path in folder.glob("*.rrd") if path.is_file())
    if len(others) == 1:
        return others[0]
    if others:
        names = ", ".join(shorten(visible(path.name), 60) for path in others[:5])
        raise UnreadableFileError(f"{shown} holds {len(others)} recordings ({names}); name one of them.")
    raise UnreadableFileError(f"{shown} holds no {RECORDING}; give a folder that modal-report run, demo or gap wrote.")


def _has_display() -> bool:
    if sys.platform in ("win32", "darwin"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


VIEW_EXAMPLES = examples("what run or gap wrote: view result", "a recording by itself: view result/recording.rrd")


def view(
    result: Annotated[
        Path, typer.Argument(metavar="RESULT", help="Folder that run, demo or gap wrote, or a recording (.rrd).")
    ],
    *,
    traceback: Traceback = False,
) -> None:
    """Open the recording of RESULT in the Rerun viewer.

    Exit status: 0 the viewer is open; 1 there is no viewer or no display here
    (it says the command that opens it elsewhere); 2 wrong use or no recording.
    """
    with faults(show=traceback):
        problem = open_recording(recording_of(result))
        if problem:
            complain(problem)
        raise typer.Exit(1 if problem else 0)
