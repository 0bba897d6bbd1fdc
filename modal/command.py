"""The command `modal-report`: from measured files to modes, a report and a recording.

Exit status: 0 done; 1 done, but the data do not carry the result (cross-validated fit below 0.5, no mode of the system,
or a gap that no effect is proved to explain); 2 wrong use or unreadable input, one sentence on stderr, nothing written;
3 a fault of ours; 130 stopped.
"""

import contextlib
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from modal.command_options import name_list, number_or_auto, plain_name, spread_files, whole_or_auto
from modal.job import FileSource, Job, carry_out, read_demo
from modal.report.provenance import Provenance
from okid.errors import IdentificationError, InsufficientDataError
from okid.record import InputHold

if TYPE_CHECKING:
    from modal.identification import Identification

__all__ = ["main"]

app = typer.Typer(
    add_completion=True,
    no_args_is_help=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def main() -> None:
    """Run the command and leave with its exit status."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    sys.exit(_status(sys.argv[1:]))


def _status(arguments: list[str]) -> int:
    """Exit status for the arguments; whatever goes wrong is one sentence on stderr."""
    if arguments[:1] == ["gap"]:
        arguments = ["gap", *spread_files(arguments[1:], ("--fit", "--held-out"))]
    try:
        status = app(arguments, prog_name="modal-report", standalone_mode=False)
    except (KeyboardInterrupt, typer.Abort):
        status = 130
    except Exception as error:
        explain = getattr(error, "format_message", None)  # wrong use, as typer found it
        if explain is None:
            raise
        text = explain() or "no command was given."
        _complain(f"{text.replace('Value error, ', '').rstrip('.')}; see modal-report --help.")
        status = 2
    if status == 130:
        _complain("stopped; nothing was left half-written.")
    return status if isinstance(status, int) else 0


def _version(wanted: bool) -> None:
    if wanted:
        import modal
        from modal.report.provenance import installed_version

        typer.echo(f"modal-report {installed_version()} (modal from {Path(modal.__file__ or '').parent})")
        raise typer.Exit


@app.callback()
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


@app.command(
    epilog="Examples:  [bold]modal-report run test.csv --inputs force -o result[/bold]   ·   "
    "[bold]modal-report run day1.mat day2.mat --inputs f1,f2 --outputs a1,a2,a3 --dt 0.001[/bold]"
)
def run(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE",
            help="CSV, NPY, NPZ, MAT, UFF 58, Parquet or TDMS; several files are several records of one system, or the "
            "channels of one record.",
        ),
    ],
    *,
    inputs: Annotated[
        list[str] | None, typer.Option(metavar="NAMES", help="Names of the input channels, with commas between.")
    ] = None,
    outputs: Annotated[
        list[str] | None, typer.Option(metavar="NAMES", help="Names of the outputs; all others unless given.")
    ] = None,
    dt: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Time step in seconds, where the file has no time.")
    ] = None,
    hold: Annotated[
        InputHold,
        typer.Option(
            help="Input between samples: measured behind an anti-alias filter (band_limited), or held by a converter."
        ),
    ] = "band_limited",
    folder: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="FOLDER", help="Folder for the report; modal-report-NAME unless given."),
    ] = None,
    observer_order: Annotated[str, typer.Option(metavar="N", help="Past samples the observer uses, or auto.")] = "auto",
    ridge: Annotated[str, typer.Option(metavar="NUMBER", help="Regularisation of the observer fit, or auto.")] = "auto",
    order: Annotated[str, typer.Option(metavar="N", help="Model order (number of states), or auto.")] = "auto",
    overwrite: Annotated[
        bool, typer.Option("--overwrite", metavar="", help="Replace a report that is there already.")
    ] = False,
    traceback: Annotated[
        bool, typer.Option("--traceback", metavar="", help="Show where a fault of this program arose.")
    ] = False,
) -> None:
    """Identify the modes in measured FILES and write a report and a Rerun recording."""
    with _faults(show=traceback):
        from modal.terminal import show_files

        job = Job(
            folder=folder or Path(f"modal-report-{plain_name(files[0].stem)}"),
            existing="replace" if overwrite else "refuse",
            observer_order=whole_or_auto(observer_order, "observer order"),
            ridge=number_or_auto(ridge, "ridge"),
            order=whole_or_auto(order, "model order"),
        )
        source = FileSource(
            files=files, inputs=name_list(inputs, "inputs"), outputs=name_list(outputs, "outputs"), dt=dt, hold=hold
        )
        result, written, console = carry_out(job, source.read, provenance=source.provenance(job))
        show_files(console, written)
        raise typer.Exit(_exit_status(result))


@app.command(epilog="Example:  [bold]modal-report demo -o demo[/bold]")
def demo(
    folder: Annotated[Path, typer.Option("-o", "--out", metavar="FOLDER", help="Folder for the report.")] = Path(
        "modal-report-demo"
    ),
    *,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", metavar="", help="Replace a report that is there already.")
    ] = False,
    traceback: Annotated[
        bool, typer.Option("--traceback", metavar="", help="Show where a fault of this program arose.")
    ] = False,
) -> None:
    """Identify an embedded example whose true modes are known, and compare what is found with what is true."""
    with _faults(show=traceback):
        from modal.examples.demo import compare_with_truth, demo_truth
        from modal.terminal import show_comparison, show_files

        job = Job(folder=folder, existing="replace" if overwrite else "refuse")
        result, written, console = carry_out(job, read_demo, provenance=Provenance(command="modal-report demo"))
        show_comparison(console, compare_with_truth(demo_truth(), result.modes))
        show_files(console, written)
        raise typer.Exit(_exit_status(result))


@app.command(
    epilog="Examples:  [bold]modal-report gap frame.toml --fit low.csv high.csv --held-out middle.csv -o gap[/bold]   "
    "·   [bold]modal-report gap motor.json --fit a.npz --held-out b.npz --inputs voltage --outputs speed[/bold]"
)
def gap(
    model: Annotated[
        Path, typer.Argument(metavar="MODEL", help="The simulation: TOML, JSON or NPZ; or a .py file with `model`.")
    ],
    *,
    fit: Annotated[list[Path], typer.Option(metavar="FILE...", help="Records to fit, of several levels if possible.")],
    held_out: Annotated[
        list[Path], typer.Option(metavar="FILE...", help="Records for the proof: another excitation, another level.")
    ],
    inputs: Annotated[
        list[str] | None, typer.Option(metavar="NAMES", help="Input columns in the model's order; its own names else.")
    ] = None,
    outputs: Annotated[
        list[str] | None, typer.Option(metavar="NAMES", help="Output columns in the model's order; its own names else.")
    ] = None,
    dt: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Time step in seconds, where the files have no time.")
    ] = None,
    hold: Annotated[
        InputHold,
        typer.Option(
            help="Input between samples: measured behind an anti-alias filter (band_limited), or held by a converter; "
            "a wrong one looks like a delay."
        ),
    ] = "band_limited",
    catalogue: Annotated[
        list[str] | None, typer.Option(metavar="KEYS", help="Effects to try, with commas between; all unless given.")
    ] = None,
    folder: Annotated[
        Path | None, typer.Option("-o", "--out", metavar="FOLDER", help="Folder; modal-report-gap-NAME unless given.")
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", metavar="", help="Replace a report that is there already.")
    ] = False,
    traceback: Annotated[
        bool, typer.Option("--traceback", metavar="", help="Show where a fault of this program arose.")
    ] = False,
) -> None:
    """Find where MODEL and measurement disagree, name the missing effect, add it and show the gap shrink."""
    with _faults(show=traceback, poor_data=1):
        from modal.gap_job import GapJob, carry_out_gap
        from modal.terminal_discrepancy import show_diagnosis_files

        job = GapJob(
            model=model,
            fit=tuple(fit),
            held_out=tuple(held_out),
            inputs=name_list(inputs, "inputs"),
            outputs=name_list(outputs, "outputs"),
            dt=dt,
            hold=hold,
            catalogue=name_list(catalogue, "effects"),
            folder=folder or Path(f"modal-report-gap-{plain_name(model.stem)}"),
            existing="replace" if overwrite else "refuse",
        )
        found, written, console = carry_out_gap(job)
        show_diagnosis_files(console, written)
        raise typer.Exit(1 if found.status == "unresolved" else 0)


def _exit_status(result: "Identification") -> int:
    from modal.report.words import judge

    return 1 if judge(result).trust == "not carried" else 0


@contextlib.contextmanager
def _faults(*, show: bool, poor_data: int = 2) -> Iterator[None]:
    """Turn an error into one sentence and an exit status; `poor_data` where the data are not enough."""
    try:
        yield
    except InsufficientDataError as error:
        _complain(str(error))
        raise typer.Exit(poor_data) from error
    except IdentificationError as error:
        _complain(str(error))
        raise typer.Exit(2) from error
    except (typer.Exit, typer.Abort):
        raise
    except Exception as error:
        if show:
            raise
        kind = type(error).__name__
        _complain(f"a fault in modal-report stopped the work ({kind}: {error}); add --traceback to see where.")
        raise typer.Exit(3) from error


def _complain(sentence: str) -> None:
    from modal.names import visible

    typer.echo(f"modal-report: {visible(sentence)}", err=True)
