"""`modal-report run`: from measured files to modes, a report and a recording."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from modal.acceptance.check import all_met
from modal.command.command_options import name_list, number_or_auto, plain_name, whole_or_auto
from modal.command.job import FileSource, Finished, Job, carry_out
from modal.command.options import Dt, Hold, Inputs, Outputs, Overwrite, Records, Traceback, examples, faults
from modal.command.terminal import show_files
from modal.identification.trust import trust_of

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["EXAMPLES", "exit_status", "extras_of", "run"]

EXAMPLES = examples(
    "a measured file: run test.csv --inputs force -o result",
    "two records of one system: run day1.mat day2.mat --inputs f1,f2 --outputs a1,a2,a3 --dt 0.001",
    "with acceptance limits and a geometry: run test.uff --test test.toml --geometry frame.toml",
)

Live = Annotated[bool, typer.Option("--live", metavar="", help="Show the work in the Rerun viewer while it goes on.")]
Pdf = Annotated[
    bool, typer.Option("--pdf", metavar="", help="Print the report into report.pdf too (needs an installed browser).")
]
Test = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE", help="TOML with article, sensors, operator and limits of acceptance (modal/docs/test_file.md)."
    ),
]
GeometryFile = Annotated[
    Path | None, typer.Option("--geometry", metavar="FILE", help="Nodes, lines and sensors: TOML or UFF 15/2411/82.")
]


def run(
    files: Records,
    *,
    inputs: Inputs = None,
    outputs: Outputs = None,
    dt: Dt = None,
    hold: Hold = "band_limited",
    folder: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="FOLDER", help="Folder for the report; modal-report-NAME unless given."),
    ] = None,
    test: Test = None,
    geometry: GeometryFile = None,
    observer_order: Annotated[str, typer.Option(metavar="N", help="Past samples the observer uses, or auto.")] = "auto",
    ridge: Annotated[str, typer.Option(metavar="NUMBER", help="Regularisation of the observer fit, or auto.")] = "auto",
    order: Annotated[str, typer.Option(metavar="N", help="Model order (number of states), or auto.")] = "auto",
    live: Live = False,
    pdf: Pdf = False,
    overwrite: Overwrite = False,
    traceback: Traceback = False,
) -> None:
    """Identify the modes in measured FILES and write a report and a Rerun recording.

    Exit status: 0 done; 1 done, but the data do not carry the result
    or a limit of --test is not surely met; 2 wrong use or unreadable input.
    """
    with faults(show=traceback):
        job = Job(
            folder=folder or Path(f"modal-report-{plain_name(files[0].stem)}"),
            existing="replace" if overwrite else "refuse",
            observer_order=whole_or_auto(observer_order, "observer order"),
            ridge=number_or_auto(ridge, "ridge"),
            order=whole_or_auto(order, "model order"),
            test=test,
            geometry=geometry,
            extras=extras_of(live=live, pdf=pdf),
        )
        source = FileSource(
            files=files, inputs=name_list(inputs, "inputs"), outputs=name_list(outputs, "outputs"), dt=dt, hold=hold
        )
        finished = carry_out(job, source.read, provenance=source.provenance(job))
        show_files(finished.console, finished.files, pdf=finished.pdf)
        raise typer.Exit(exit_status(finished))


def extras_of(*, live: bool, pdf: bool) -> frozenset[Literal["live", "pdf"]]:
    """What was asked for beside the report."""

    def wanted() -> "Iterator[Literal['live', 'pdf']]":
        if live:
            yield "live"
        if pdf:
            yield "pdf"

    return frozenset(wanted())


def exit_status(finished: Finished) -> int:
    """0 where the data carry the result and every limit is surely met, 1 otherwise."""
    return 0 if trust_of(finished.result).trust != "not carried" and all_met(finished.limits) else 1
