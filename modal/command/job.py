"""One run of the command: read, identify, write everything, then print what was found."""

import contextlib
import shlex
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from rich.console import Console

from modal.acceptance.check import check_limits
from modal.command.job_setup import clear_stale, prepare, refuse_other_report, refuse_sources, unknown_sensors
from modal.command.live_view import live_view
from modal.command.progress import Progress, progress_bar
from modal.command.terminal import show_result
from modal.examples.demo import demo_record
from modal.identification.pipeline import identify
from modal.quality.check import check_quality
from modal.report import ReportFiles, write_report
from modal.report.pdf import write_pdf
from modal.sections.provenance import Provenance, fingerprints
from okid.errors import IdentificationWarning
from okid.readers import read_described
from okid.record import InputHold, Record

if TYPE_CHECKING:
    from modal.acceptance.check import LimitOutcome
    from modal.geometry.sensors import Geometry
    from modal.identification.result import Identification

__all__ = [
    "FileSource",
    "Finished",
    "Job",
    "Progress",
    "Reading",
    "carry_out",
    "own_warnings",
    "progress_bar",
    "read_demo",
]

Auto = Literal["auto"]
Reading = tuple[tuple[Record, ...], tuple[str, ...]]
"""Records, and remarks on what was done to their units."""

DEMO_SEED = 2
WRITING_FROM = 0.75
"""Share of the work that reading and identification are, about: with a record of a minute, writing is half of it."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Job:
    """What to do with the records, wherever they come from.

    Attributes:
        folder: for the report.
        existing: "refuse" to touch a report that is there, or "replace" it.
        observer_order: past samples of the observer.
        ridge: of the observer fit.
        order: of the model.
        test: file of what no measured file knows; None where there is none.
        geometry: file of nodes, lines and sensors; None: that of the test file, if it has one.
        extras: "live" shows the work in a viewer while it goes on, "pdf" prints the report into a file too.
    """

    folder: Path
    existing: Literal["refuse", "replace"]
    observer_order: int | Auto = "auto"
    ridge: float | Auto = "auto"
    order: int | Auto = "auto"
    test: Path | None = None
    geometry: Path | None = None
    extras: frozenset[Literal["live", "pdf"]] = frozenset()

    @property
    def pdf(self) -> Path | None:
        """Where the printed report goes."""
        return self.folder / "report.pdf" if "pdf" in self.extras else None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FileSource:
    """Which files, and which of their channels."""

    files: list[Path]
    inputs: list[str] | None
    outputs: list[str] | None
    dt: float | None
    hold: InputHold

    def read(self) -> Reading:
        """Records, and remarks on what was done to the units of their channels."""
        records, descriptions = read_described(
            self.files, inputs=self.inputs, outputs=self.outputs, dt=self.dt, input_hold=self.hold
        )
        used = {name for record in records for name in (*record.input_names, *record.output_names)}
        remarks: dict[str, None] = {}  # in order, once each: several files of one test say the same
        for description in descriptions:
            channels = tuple(channel for channel in description.channels if channel.channel in used)
            remarks |= dict.fromkeys(replace(description, channels=channels).remarks)
        return records, tuple(remarks)

    def provenance(self, job: Job) -> Provenance:
        """How to do the same again; without the folder, so that it does not change the report."""
        words = ["modal-report", "run", *(str(file) for file in self.files)]
        for option, names in (("--inputs", self.inputs), ("--outputs", self.outputs)):
            words += [option, ",".join(names)] if names else []
        words += ["--dt", repr(self.dt)] if self.dt is not None else []
        words += ["--hold", self.hold] if self.hold != "band_limited" else []
        for option, value in (("--observer-order", job.observer_order), ("--ridge", job.ridge), ("--order", job.order)):
            words += [option, str(value)] if value != "auto" else []
        for option, path in (("--test", job.test), ("--geometry", job.geometry)):
            words += [option, str(path)] if path is not None else []
        besides = tuple(str(path) for path in (job.test, job.geometry) if path is not None)
        sources = tuple(map(str, self.files))
        return Provenance(command=shlex.join(words), sources=sources, besides=besides, dt=self.dt)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Finished:
    """What a run came to.

    Attributes:
        result: of `modal.identify`.
        files: of the report.
        pdf: the printed report, None where it was not asked for.
        limits: what became of each limit of the test file; empty where there is none.
        console: to go on printing to.
    """

    result: "Identification"
    files: "ReportFiles"
    pdf: Path | None
    limits: "tuple[LimitOutcome, ...]"
    console: Console


def read_demo() -> Reading:
    """The embedded example, always the same."""
    import numpy as np

    return (demo_record(np.random.default_rng(DEMO_SEED)),), ()


def carry_out(
    job: Job, read: Callable[[], Reading], *, provenance: Provenance, geometry: "Geometry | None" = None
) -> Finished:
    """Read, identify, write, print what was found; the report is complete before a word of it is printed.

    Args:
        job: what to do.
        read: gives the records.
        provenance: where they come from; hashes of its sources and remarks are added.
        geometry: of the structure, where the job names no file of one.

    Raises:
        InvalidDataError: files that cannot be read or do not belong together, or a report that could not be written.
        InsufficientDataError: records that are too short or too poor.
    """
    specification, named = prepare(job)
    geometry = geometry if named is None else named
    refuse_other_report(job.folder, "findings.csv")
    refuse_sources(
        (*ReportFiles.in_folder(job.folder), *([] if job.pdf is None else [job.pdf])),
        map(Path, (*provenance.sources, *provenance.besides)),
    )
    unseen: list[str] = []
    with (
        progress_bar() as tell,
        own_warnings() as heard,
        live_view(wanted="live" in job.extras, tell=unseen.append) as viewer,
    ):
        tell("reading", 0.0)
        records, remarks = read()
        files_read = fingerprints((*provenance.sources, *provenance.besides))
        viewer.show_records(records)
        result = identify(
            records,
            observer_order=job.observer_order,
            ridge=job.ridge,
            order=job.order,
            progress=_both(viewer.show_progress, lambda what, share: tell(what, 0.03 + (WRITING_FROM - 0.03) * share)),
        )
        tell("looking at the quality of the data", WRITING_FROM)
        quality = check_quality(records)
        viewer.show_result(result, geometry)
        tell("writing the report and the recording", WRITING_FROM)
        remarks = (*remarks, *heard, *unknown_sensors(specification, records))
        provenance = replace(provenance, remarks=remarks, files=files_read)
        files = write_report(
            result,
            job.folder,
            existing=job.existing,
            provenance=provenance,
            geometry=geometry,
            specification=specification,
            quality=quality,
        )
        clear_stale(job, files)
        if job.pdf is not None:
            tell("printing the report", 0.95)
            write_pdf(files.html, job.pdf)
        limits = () if specification is None else check_limits(result, specification)
    console = Console(highlight=False)
    show_result(console, result, remarks=(*remarks, *unseen), limits=limits)
    return Finished(result=result, files=files, pdf=job.pdf, limits=limits, console=console)


@contextlib.contextmanager
def own_warnings() -> Iterator[list[str]]:
    """Our own warnings as sentences for the report; those of libraries are not for the user."""
    texts: list[str] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", IdentificationWarning)
        warnings.showwarning = lambda message, *_args, **_options: texts.append(str(message))
        yield texts


def _both(first: Progress, second: Progress) -> Progress:
    def tell(what: str, share: float) -> None:
        first(what, share)
        second(what, share)

    return tell
