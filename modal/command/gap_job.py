"""One run of `modal-report gap`: read model and records, diagnose, write everything, then print what was found."""

import re
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from rich.console import Console

from modal.command.job import FileSource, Reading, own_warnings, progress_bar
from modal.command.job_setup import refuse_other_report, refuse_pdf, refuse_sources
from modal.command.terminal_discrepancy import show_diagnosis
from modal.discrepancy.diagnosis import diagnose
from modal.effects.catalogue import CATALOGUE
from modal.report.discrepancy_writing import DiagnosisFiles, refuse_existing_diagnosis, write_diagnosis
from modal.report.pdf import write_pdf
from modal.sections.provenance import Provenance, fingerprints
from modal.structure.model_file import read_model
from okid.errors import InvalidDataError
from okid.record import InputHold, Record

if TYPE_CHECKING:
    from modal.discrepancy.results import Diagnosis
    from modal.effects.effect import Effect

__all__ = ["GapJob", "carry_out_gap"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class GapJob:
    """What to do, and with which files.

    Attributes:
        model: file of the model.
        fit: files of the records to fit.
        held_out: files of the held-out records.
        inputs: names of the input columns; the model's own names unless given.
        outputs: names of the output columns; the model's own names unless given.
        dt: time step [s] where the files have none.
        hold: what the inputs did between samples.
        catalogue: keys of the effects to try; all unless given.
        folder: for the report.
        existing: "refuse" to touch a report that is there, or "replace" it.
        extras: "pdf" prints the report into a file too.
    """

    model: Path
    fit: tuple[Path, ...]
    held_out: tuple[Path, ...]
    inputs: list[str] | None
    outputs: list[str] | None
    dt: float | None
    hold: InputHold
    catalogue: list[str] | None
    folder: Path
    existing: Literal["refuse", "replace"]
    extras: frozenset[Literal["live", "pdf"]] = frozenset()

    @property
    def pdf(self) -> Path | None:
        """Where the printed report goes."""
        return self.folder / "report.pdf" if "pdf" in self.extras else None

    def provenance(self) -> Provenance:
        """How to do the same again; without the folder, so that it does not change the report."""
        words = ["modal-report", "gap", str(self.model), "--fit", *map(str, self.fit)]
        words += ["--held-out", *map(str, self.held_out)]
        for option, names in (("--inputs", self.inputs), ("--outputs", self.outputs), ("--catalogue", self.catalogue)):
            words += [option, ",".join(names)] if names else []
        words += ["--dt", repr(self.dt)] if self.dt is not None else []
        words += ["--hold", self.hold] if self.hold != "band_limited" else []
        sources = (self.model, *self.fit, *self.held_out)
        return Provenance(command=shlex.join(words), sources=tuple(map(str, sources)), dt=self.dt)


def carry_out_gap(job: GapJob) -> "tuple[Diagnosis, DiagnosisFiles, Console]":
    """Read, diagnose, write, print what was found; the report is complete before a word of it is printed.

    Raises:
        InvalidDataError: files that cannot be read or do not belong together, or a report that could not be written.
        InsufficientDataError: records that are too short or too poor.
    """
    refuse_existing_diagnosis(job.folder, job.existing)
    if job.pdf is not None:
        refuse_pdf(job.pdf, job.existing)
    refuse_other_report(job.folder, "modes.csv")
    refuse_sources(
        (*DiagnosisFiles.in_folder(job.folder), *([] if job.pdf is None else [job.pdf])),
        (job.model, *job.fit, *job.held_out),
    )
    catalogue = chosen_effects(job.catalogue)
    _check_apart(job)
    with progress_bar() as tell, own_warnings() as heard:
        tell("reading the model", 0.0)
        model = read_model(job.model)
        tell("reading the records", 0.01)
        fit, held_out, remarks = read_sides(job, model)
        files_read = fingerprints((job.model, *job.fit, *job.held_out))
        found = diagnose(
            model,
            fit,
            held_out,
            catalogue=catalogue,
            progress=lambda what, share: tell(what, 0.03 + 0.89 * share),
        )
        tell("writing the report and the recording", 0.92)
        remarks = (*remarks, *(text for text in heard if text not in found.warnings))
        provenance = replace(job.provenance(), remarks=remarks, files=files_read)
        files = write_diagnosis(found, job.folder, existing=job.existing, provenance=provenance)
        if job.existing == "replace":  # what an earlier report left and this one does not have
            (job.folder / "report.pdf").unlink(missing_ok=True)
            if files.model is None:
                (job.folder / "model.json").unlink(missing_ok=True)
        if job.pdf is not None:
            tell("printing the report", 0.97)
            write_pdf(files.html, job.pdf)
    console = Console(highlight=False)
    show_diagnosis(console, found, remarks=remarks)
    return found, files, console


def chosen_effects(keys: list[str] | None) -> "Mapping[str, Effect]":
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
