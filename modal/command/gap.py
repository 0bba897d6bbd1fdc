"""`modal-report gap`: what a simulation is missing."""

from pathlib import Path
from typing import Annotated

import typer

from modal.command.command_options import name_list, plain_name
from modal.command.gap_job import GapJob, carry_out_gap
from modal.command.options import Dt, Overwrite, Traceback, examples, faults
from modal.command.run import Pdf, extras_of
from modal.command.terminal import plain
from modal.command.terminal_discrepancy import show_diagnosis_files
from modal.effects.catalogue import CATALOGUE
from okid.record import InputHold

__all__ = ["EXAMPLES", "gap"]

EXAMPLES = examples(
    "a model and its records: gap frame.toml --fit low.csv high.csv --held-out middle.csv -o gap",
    "columns by name: gap motor.json --fit a.npz --held-out b.npz --inputs voltage --outputs speed",
    "some effects only: gap frame.toml --fit a.csv --held-out b.csv --catalogue gap_spring,coulomb_friction",
)


def _effects(incomplete: str) -> list[str]:
    """Keys of the catalogue that go on as what is typed so far; those before a comma are kept."""
    done, comma, rest = incomplete.rpartition(",")
    return [done + comma + key for key in CATALOGUE if key.startswith(rest)]


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
    dt: Dt = None,
    hold: Annotated[
        InputHold,
        typer.Option(
            help="Input between samples: measured behind an anti-alias filter (band_limited), or held by a converter; "
            "a wrong one looks like a delay."
        ),
    ] = "band_limited",
    catalogue: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEYS", help="Effects to try, with commas between; all unless given.", autocompletion=_effects
        ),
    ] = None,
    folder: Annotated[
        Path | None, typer.Option("-o", "--out", metavar="FOLDER", help="Folder; modal-report-gap-NAME unless given.")
    ] = None,
    pdf: Pdf = False,
    overwrite: Overwrite = False,
    traceback: Traceback = False,
) -> None:
    """Find where MODEL and measurement disagree, name the missing effect, add it and show the gap shrink.

    Exit status: 0 the effect is named and proved, or nothing is missing;
    1 nothing could be proved; 2 wrong use or unreadable input.
    """
    with faults(show=traceback, poor_data=1):
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
            extras=extras_of(live=False, pdf=pdf),
        )
        found, written, console = carry_out_gap(job)
        show_diagnosis_files(console, written)
        if job.pdf is not None:
            console.print(plain(str(job.pdf)) + plain("  the report on paper", "bright_black"), soft_wrap=True)
        raise typer.Exit(1 if found.status == "unresolved" else 0)
