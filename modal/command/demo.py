"""`modal-report demo`: an embedded example whose truth is known."""

from pathlib import Path
from typing import Annotated

import typer

from modal.command.options import Overwrite, Traceback, examples, faults, folder_path
from modal.command.run import Job, Live, Pdf, carry_out, exit_status, read_demo
from modal.command.terminal import Screen, plain, show_comparison, show_files
from modal.examples.demo import compare_with_truth, demo_geometry, demo_truth
from modal.examples.files import write_files
from modal.sections.provenance import Provenance

EXAMPLES = examples(
    "report, recording and all: demo -o demo",
    "and look at it: view demo",
    "files to try every command with: demo --files -o .",
)


def demo(
    folder: Annotated[
        Path, typer.Option("-o", "--out", metavar="FOLDER", parser=folder_path, help="Folder for the report.")
    ] = Path("modal-report-demo"),
    *,
    files: Annotated[
        bool, typer.Option("--files", metavar="", help="Write only the files that the commands of README name.")
    ] = False,
    live: Live = False,
    pdf: Pdf = False,
    overwrite: Overwrite = False,
    traceback: Traceback = False,
) -> None:
    """Identify an embedded example whose true modes are known, and compare what is found with what is true.

    It takes seconds and needs no file. Exit status: 0 done; 1 done, but
    the result is not reliable; 2 wrong use.
    """
    with faults(show=traceback):
        if files:
            written = write_files(folder, existing="replace" if overwrite else "refuse")
            Screen(highlight=False).print(
                plain(f"{len(written)} files written to {folder}, for the commands of README")
            )
            return
        job = Job(folder=folder, existing="replace" if overwrite else "refuse", live=live, printed=pdf)
        provenance = Provenance(command="modal-report demo")
        finished = carry_out(job, read_demo, provenance=provenance, geometry=demo_geometry())
        show_comparison(finished.console, compare_with_truth(demo_truth(), finished.result.modes))
        show_files(finished.console, finished.files, pdf=finished.pdf)
        raise typer.Exit(exit_status(finished))
