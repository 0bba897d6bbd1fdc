"""`modal-report gap`: what a simulation is missing, where, and what to do next."""

import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from rich.console import Console
from rich.table import Table

from modal.command.options import Dt, Overwrite, Traceback, examples, faults, folder_path, name_list, plain_name
from modal.command.run import (
    FileSource,
    Pdf,
    Reading,
    own_warnings,
    refuse_other_report,
    refuse_pdf,
    refuse_sources,
    sizes,
)
from modal.command.terminal import Screen, listing, plain, progress_bar, say_beforehand, show_paths
from modal.discrepancy.diagnosis import diagnose, expected_diagnosis_work
from modal.discrepancy.results import Diagnosis, Finding, in_words
from modal.effects.catalogue import CATALOGUE
from modal.effects.effect import Effect
from modal.report.discrepancy_writing import DiagnosisFiles, write_diagnosis
from modal.report.folder import refuse_names, standing, write_pdf
from modal.report.pages import hold_text
from modal.sections import discrepancy_words as words
from modal.sections.discrepancy_stages import (
    Stage,
    effect_text,
    found_value,
    interval_text,
    rows_of,
    stages_of,
    times_text,
)
from modal.sections.validation import Provenance, fingerprints
from modal.structure.model_file import read_model
from modal.wording.text import listed
from okid.errors import InvalidDataError
from okid.readers.guard import Existing
from okid.record import InputHold, Record

_TRUST = {"carried": "bold green", "with care": "bold yellow", "not carried": "bold red"}
_STAGES = {"before": "red", "linear": "yellow", "after": "green"}

READ, DIAGNOSED, WRITTEN = 0.03, 0.92, 0.97
"""Share of the work that is behind, about, when a step has ended."""


def show_diagnosis(console: Console, diagnosis: Diagnosis, *, remarks: Sequence[str] = ()) -> None:
    """Verdict, findings, where, before and after, runner-up, what could still hide, what to do next, warnings."""
    diagnosis = in_words(diagnosis)
    judgement = words.judge_diagnosis(diagnosis)
    console.print()
    console.print(plain(words.diagnosis_headline(diagnosis), "bold"))
    console.print(plain(f"{judgement.label}. ", _TRUST[judgement.trust]) + plain(" ".join(judgement.reasons)))
    width = max([len(found_value(one)) for finding in diagnosis.findings for one in finding.parameters], default=0)
    for finding in diagnosis.findings:
        console.print()
        console.print(plain(effect_text(finding.effect), "bold green") + plain(f" at {finding.where}"))
        console.print(_findings(finding, width))
    listing(console, "Why", [_why(finding) for finding in diagnosis.findings], "")
    listing(console, "Where they disagreed, before any effect was tried", words.where_sentences(diagnosis), "")
    stages = stages_of(diagnosis)
    if stages:
        console.print()
        console.print(plain("Held-out gap, times the noise floor", "bold"))
        console.print(_before_after(stages))
    limits = words.hidden_sentence(diagnosis)
    hidden = words.capital(limits.removeprefix(words.COULD_HIDE))
    listing(console, "What the data could still hide", [hidden] if limits else [], "")
    listing(console, "Next", words.next_steps(diagnosis), "cyan")
    listing(console, "Warnings", words.read_first(diagnosis), "yellow")
    listing(console, "Data", (*_holds(diagnosis), *words.floor_summary(diagnosis), *remarks), "")


def show_diagnosis_files(console: Console, files: DiagnosisFiles, *, pdf: Path | None = None) -> None:
    """Where the report is, one line a file that one opens next."""
    folder, others = files.recording.parent, (files.markdown, files.json, files.csv)
    show_paths(
        console,
        (files.html, "the report"),
        (pdf, "the same on paper"),
        (files.recording, f"to look at: modal-report view {shlex.quote(str(folder))}"),
        (files.model, "the updated model, to go on with"),
        (folder, f"also {', '.join(path.name for path in others)}"),
    )


def _holds(diagnosis: Diagnosis) -> list[str]:
    """What the inputs were taken to do between samples, and how that was said."""
    ways: dict[InputHold, list[str]] = {}
    for record in diagnosis.held_out:
        ways.setdefault(record.input_hold, []).extend(record.input_names)
    return [
        f"Input {listed(list(dict.fromkeys(names)))}: {hold_text(way)} (--hold {way})."
        for way, names in ways.items()
        if names
    ]


def _findings(finding: Finding, width: int) -> Table:
    """The parameters of an effect, the value in a column of a width that all effects share."""
    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
    table.add_column(no_wrap=True, min_width=max([len(one.name) for one in finding.parameters], default=0))
    table.add_column(justify="right", no_wrap=True, min_width=width)
    table.add_column(no_wrap=True)
    table.add_column(no_wrap=True)
    for one in finding.parameters:
        interval = interval_text(one.value, one.std)
        known = "" if interval == "–" else f"95 %: {interval}"
        table.add_row(plain(one.name), plain(found_value(one), "bold"), plain(one.unit), plain(known, "bright_black"))
    return table


def _why(finding: Finding) -> str:
    name = words.capital(effect_text(finding.effect))
    evidence = words.as_sentence(finding.evidence.words)
    law = f"{finding.effect}: {finding.law}"
    return f"{name} at {finding.where} ({law}): {evidence} {words.runner_up_sentence(finding)}"


def _before_after(stages: Sequence[Stage]) -> Table:
    """By output and by record; the report has the bands of frequency too."""
    table = Table(box=None, pad_edge=False, header_style="bright_black", padding=(0, 2, 0, 0))
    table.add_column("by", no_wrap=True)
    table.add_column("")
    for stage in stages:
        table.add_column(stage.name, justify="right", no_wrap=True)
    for row in [row for row in rows_of(stages) if row.part != "band"][:12]:  # the report has all
        cells = [plain(times_text(size), _STAGES[stage.kind]) for stage, size in zip(stages, row.sizes, strict=True)]
        table.add_row(plain(row.part, "bright_black"), plain(row.name), *cells)
    return table


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class GapJob:
    """What to do, and with which files."""

    model: Path
    fit: tuple[Path, ...]
    held_out: tuple[Path, ...]
    inputs: list[str] | None
    outputs: list[str] | None
    dt: float | None
    hold: InputHold
    catalogue: list[str] | None
    folder: Path
    existing: Existing
    printed: bool = False
    budget: float | None = None

    @property
    def pdf(self) -> Path | None:
        """Where the printed report goes."""
        return self.folder / "report.pdf" if self.printed else None

    def provenance(self) -> Provenance:
        """How to do the same again; without the folder, so that it does not change the report."""
        words = ["modal-report", "gap", str(self.model), "--fit", *map(str, self.fit)]
        words += ["--held-out", *map(str, self.held_out)]
        for option, names in (("--inputs", self.inputs), ("--outputs", self.outputs), ("--catalogue", self.catalogue)):
            words += [option, ",".join(names)] if names else []
        words += ["--dt", repr(self.dt)] if self.dt is not None else []
        words += ["--budget", repr(self.budget)] if self.budget is not None else []
        words += ["--hold", self.hold] if self.hold != "band_limited" else []
        sources = (self.model, *self.fit, *self.held_out)
        return Provenance(command=shlex.join(words), sources=tuple(map(str, sources)), dt=self.dt)


def carry_out_gap(job: GapJob) -> tuple[Diagnosis, DiagnosisFiles, Console]:
    """Read, diagnose, write, print what was found; the report is complete before a word of it is printed.

    Raises:
        InvalidDataError: files that cannot be read or do not belong together, or a report that could not be written.
        InsufficientDataError: records that are too short or too poor.
    """
    refuse_names(job.folder, DiagnosisFiles.in_folder(job.folder).names, job.existing)
    if job.pdf is not None:
        refuse_pdf(job.pdf, job.existing)
    refuse_other_report(job.folder, "modes.csv")
    refuse_sources(
        (*DiagnosisFiles.in_folder(job.folder), *([] if job.pdf is None else [job.pdf])),
        (job.model, *job.fit, *job.held_out),
    )
    catalogue = chosen_effects(job.catalogue)
    _check_apart(job)
    with standing(job.folder), progress_bar() as tell, own_warnings() as heard:
        tell("reading the model", 0.0)
        model = read_model(job.model)
        tell("reading the records", READ / 2)
        fit, held_out, remarks = read_sides(job, model)
        files_read = fingerprints((job.model, *job.fit, *job.held_out))
        (least, most), n_bytes = expected_diagnosis_work(model, fit, held_out)
        end = most if job.budget is None else job.budget
        say_beforehand(*sizes((*fit, *held_out)), (min(least, end), min(most, end)), n_bytes)
        found = diagnose(
            model,
            fit,
            held_out,
            catalogue=catalogue,
            budget=job.budget,
            progress=lambda what, share: tell(what, READ + (DIAGNOSED - READ) * share),
        )
        tell("writing the report and the recording", DIAGNOSED)
        told = {text.rstrip(".") for text in found.warnings}
        remarks = (*remarks, *(text for text in heard if text.rstrip(".") not in told))
        provenance = replace(job.provenance(), remarks=remarks, files=files_read)
        files = write_diagnosis(found, job.folder, existing=job.existing, provenance=provenance)
        if job.pdf is not None:
            tell("printing the report", WRITTEN)
            write_pdf(files.html, job.pdf)
    console = Screen(highlight=False)
    show_diagnosis(console, found, remarks=remarks)
    return found, files, console


def chosen_effects(keys: list[str] | None) -> Mapping[str, Effect]:
    """The part of the catalogue with these keys, all of it unless they are given.

    Raises:
        InvalidDataError: a key that the catalogue does not have.
    """
    if keys is None:
        return CATALOGUE
    unknown = [key for key in keys if key not in CATALOGUE]
    if unknown:
        raise InvalidDataError(f"there is no effect {unknown[0]!r} in the catalogue; it holds {', '.join(CATALOGUE)}.")
    return {key: CATALOGUE[key] for key in keys}


def read_sides(job: GapJob, model: Any) -> tuple[tuple[Record, ...], tuple[Record, ...], tuple[str, ...]]:
    """The records to fit, the held-out ones, and remarks on what was done to the units of their channels."""
    inputs = job.inputs or _own_names(model, "inputs", job)
    outputs = job.outputs or _own_names(model, "outputs", job)
    fit, remarks = _read(job, job.fit, inputs, outputs)
    held_out, more = _read(job, job.held_out, list(fit[0].input_names), list(fit[0].output_names))
    return fit, held_out, tuple(dict.fromkeys((*remarks, *more)))


def _read(job: GapJob, files: tuple[Path, ...], inputs: list[str] | None, outputs: list[str] | None) -> Reading:
    return FileSource(files=list(files), inputs=inputs, outputs=outputs, dt=job.dt, hold=job.hold).read()


def _own_names(model: Any, what: Literal["inputs", "outputs"], job: GapJob) -> list[str] | None:
    """Names that the model gives its channels; None where it has no say.

    Raises:
        InvalidDataError: it numbers them only, so which columns they are must be said.
    """
    word = what[:-1]
    names = [str(name) for name in getattr(model, f"{word}_names", ())]
    if names and all(re.fullmatch(rf"{word}_\d+", name) for name in names):
        raise InvalidDataError(
            f"the model in {job.model.name} does not name its {what}, so their columns must be named: add --{what} "
            f"with {len(names)} column name{'s' * (len(names) > 1)} in the order of the model."
        )
    if not names and what == "inputs":
        raise InvalidDataError(
            f"the model in {job.model.name} does not name its inputs; name their columns with --inputs."
        )
    return names or None


def _check_apart(job: GapJob) -> None:
    fitted = {path.resolve() for path in job.fit}
    both = sorted({str(path) for path in job.held_out if path.resolve() in fitted})
    if both:
        raise InvalidDataError(
            f"{', '.join(both)} is given to fit and as held out; the proof needs records that were not fitted to."
        )


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
    budget: Annotated[
        float | None,
        typer.Option(
            metavar="S",
            help="CPU seconds after which nothing new is tried, one to two minutes unless given; what is open then is "
            "unresolved, and said.",
        ),
    ] = None,
    folder: Annotated[
        Path | None,
        typer.Option(
            "-o", "--out", metavar="FOLDER", parser=folder_path, help="Folder; modal-report-gap-NAME unless given."
        ),
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
            printed=pdf,
            budget=budget,
        )
        found, written, console = carry_out_gap(job)
        show_diagnosis_files(console, written, pdf=job.pdf)
        raise typer.Exit(1 if found.status == "unresolved" else 0)
