"""`modal-report run`: from measured files to modes, a report and a recording; `demo`: the same of an embedded example.

What would stop the work is looked at before it begins: a report that is there, a file that cannot be read, no browser.
"""

import contextlib
import itertools
import shlex
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.console import Console

from modal.acceptance.check import LimitOutcome, all_met, check_limits
from modal.acceptance.test_file import Specification, read_specification
from modal.command.options import (
    Dt,
    Hold,
    Inputs,
    Kind,
    Outputs,
    Overwrite,
    Records,
    Traceback,
    examples,
    faults,
    folder_path,
    name_list,
    number_or_auto,
    plain_name,
    whole_or_auto,
)
from modal.command.terminal import (
    Screen,
    live_view,
    plain,
    progress_bar,
    say_beforehand,
    show_comparison,
    show_files,
    show_result,
)
from modal.examples.demo import compare_with_truth, demo_geometry, demo_record, demo_truth
from modal.examples.files import write_files
from modal.geometry.file import read_geometry
from modal.geometry.sensors import Geometry, same_dof
from modal.identification.more_modes import with_modal_mass
from modal.identification.pipeline import expected_work, identify, used_rows
from modal.identification.result import Identification
from modal.identification.words import trust_of
from modal.modes.modal_mass import driving_point_of
from modal.preparation.kind import GivenKind
from modal.quality.check import check_quality
from modal.recording.live import log_progress, log_records, log_result
from modal.report import ReportFiles, write_report
from modal.report.folder import NoBrowserError, find_browser, refuse_names, standing, write_pdf
from modal.sections.validation import Provenance, fingerprints
from modal.wording.text import shorten
from okid.errors import IdentificationWarning, InvalidDataError, visible
from okid.frequency_response import FrequencyResponse
from okid.readers import read_described
from okid.readers.guard import Existing
from okid.readers.response import holds_responses, read_response
from okid.record import InputHold, Record


def read_setup(job: "Job") -> tuple[Specification | None, Geometry | None]:
    """What the test file says and the geometry, once all is refused that can be before the work begins.

    Raises:
        InvalidDataError: a report that could not be written, or a test file or geometry that is none.
        NoBrowserError: a PDF was asked for, and nothing prints it.
    """
    refuse_names(job.folder, ReportFiles.in_folder(job.folder).names, job.existing)
    if job.pdf is not None:
        refuse_pdf(job.pdf, job.existing)
    specification = None if job.test is None else read_specification(job.test)
    if job.geometry is not None:
        return specification, read_geometry(job.geometry)
    return specification, None if specification is None else specification.geometry


def refuse_pdf(pdf: Path, existing: Existing) -> None:
    """Raise before any work is done when a report could not be printed.

    Raises:
        InvalidDataError: the file exists already, or its folder cannot be written.
        NoBrowserError: there is no browser that prints.
    """
    refuse_names(pdf.parent, [pdf.name], existing)
    if find_browser() is None:
        raise NoBrowserError(
            "--pdf prints with Chromium, Chrome or Edge, and none is installed here; leave it out and print "
            "report.html by hand."
        )


def refuse_sources(written: Iterable[Path], sources: Iterable[Path]) -> None:
    """Raise where a file that would be written is one that is read: replacing it would lose what was measured.

    Raises:
        InvalidDataError: the first such file.

    Example:
        >>> refuse_sources([Path("report/report.html")], [Path("test.csv")])
    """
    targets = list(written)
    for source in sources:
        for target in targets:
            if target.exists() and source.exists() and target.samefile(source):
                raise InvalidDataError(
                    f"{shorten(visible(str(target)), 200)!r} would replace a file that is read; choose another place."
                )


def refuse_other_report(folder: Path, mark: str) -> None:
    """Raise where a folder holds a report of the other kind: replaced in part, it would be two reports in one.

    Args:
        folder: for the report.
        mark: name of a file that only the other kind of report has.

    Raises:
        InvalidDataError: it is there, beside a report.json.
    """
    if (folder / mark).is_file() and (folder / "report.json").is_file():
        raise InvalidDataError(
            f"{shorten(visible(str(folder)), 200)!r} holds a report of another kind ({mark}); choose another folder."
        )


def unknown_sensors(
    specification: Specification | None, records: tuple[Record, ...] | FrequencyResponse
) -> tuple[str, ...]:
    """A sentence on sensors whose channel no record has: a misspelt name would otherwise be lost in silence."""
    if specification is None:
        return ()
    read = [records] if isinstance(records, FrequencyResponse) else records
    known = {name for one in read for name in (*one.input_names, *one.output_names)}
    missing = [shorten(visible(note.channel), 60) for note in specification.sensors if note.channel not in known]
    if not missing:
        return ()
    named = ", ".join(map(repr, missing[:5])) + " and more" * (len(missing) > 5)
    return (f"the test file describes {named}, which the records as read do not have; check its channel names.",)


Auto = Literal["auto"]
Reading = tuple[tuple[Record, ...], tuple[str, ...]]
"""Records, and remarks on what was done to their units."""

DEMO_SEED = 2
READ, IDENTIFIED, WRITTEN = 0.03, 0.75, 0.95
"""Share of the work that is behind, about, when a step has ended: with a record of a minute, writing is half of it."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Job:
    """What to do with the records, wherever they come from."""

    folder: Path
    existing: Existing
    observer_order: int | Auto = "auto"
    ridge: float | Auto = "auto"
    order: int | Auto = "auto"
    kind: GivenKind = "auto"
    test: Path | None = None
    geometry: Path | None = None
    driving_point: tuple[str, ...] = ()
    live: bool = False
    printed: bool = False

    @property
    def pdf(self) -> Path | None:
        """Where the printed report goes."""
        return self.folder / "report.pdf" if self.printed else None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FileSource:
    """Which files, and which of their channels."""

    files: list[Path]
    inputs: list[str] | None
    outputs: list[str] | None
    dt: float | None
    hold: InputHold

    def read_any(self) -> tuple[tuple[Record, ...] | FrequencyResponse, tuple[str, ...]]:
        """As `read`, or the one table of frequency responses that the file holds."""
        tables = [file for file in self.files if holds_responses(file)]
        if tables:
            if len(self.files) > 1:
                raise InvalidDataError(
                    f"{tables[0]} holds frequency responses, which are identified by themselves; give that file alone."
                )
            return read_response(tables[0], inputs=self.inputs, outputs=self.outputs), ()
        return self.read()

    def read(self) -> Reading:
        """Records, and remarks on what was done to the units of their channels."""
        with own_warnings() as unseen:
            records, descriptions = read_described(
                self.files, inputs=self.inputs, outputs=self.outputs, dt=self.dt, input_hold=self.hold
            )
        used = {name for record in records for name in (*record.input_names, *record.output_names)}
        remarks: dict[str, None] = dict.fromkeys(unseen)  # in order, once each: several files of one test say the same
        every = (channel for description in descriptions for channel in description.channels if channel.channel in used)
        channels = tuple({(one.channel, str(one)): one for one in every}.values())
        for number, description in enumerate(descriptions):  # channels treated alike share one sentence
            remarks |= dict.fromkeys(replace(description, channels=() if number else channels).remarks)
        return records, tuple(remarks)

    def provenance(self, job: Job) -> Provenance:
        """How to do the same again; without the folder, so that it does not change the report."""
        words = ["modal-report", "run", *(str(file) for file in self.files)]
        for option, names in (("--inputs", self.inputs), ("--outputs", self.outputs)):
            words += [option, ",".join(names)] if names else []
        words += ["--dt", repr(self.dt)] if self.dt is not None else []
        words += ["--hold", self.hold] if self.hold != "band_limited" else []
        for option, value in (
            ("--observer-order", job.observer_order),
            ("--ridge", job.ridge),
            ("--order", job.order),
            ("--kind", job.kind),
        ):
            words += [option, str(value)] if value != "auto" else []
        words += ["--driving-point", ",".join(job.driving_point)] if job.driving_point else []
        for option, path in (("--test", job.test), ("--geometry", job.geometry)):
            words += [option, str(path)] if path is not None else []
        besides = tuple(str(path) for path in (job.test, job.geometry) if path is not None)
        sources = tuple(map(str, self.files))
        return Provenance(command=shlex.join(words), sources=sources, besides=besides, dt=self.dt)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Finished:
    """What a run came to."""

    result: Identification
    files: ReportFiles
    pdf: Path | None
    limits: tuple[LimitOutcome, ...]
    console: Console


def read_demo() -> Reading:
    """The embedded example, always the same."""
    import numpy as np

    return (demo_record(np.random.default_rng(DEMO_SEED)),), ()


def carry_out(
    job: Job,
    read: Callable[[], tuple[tuple[Record, ...] | FrequencyResponse, tuple[str, ...]]],
    *,
    provenance: Provenance,
    geometry: Geometry | None = None,
) -> Finished:
    """Read, identify, write, print what was found; the report is complete before a word of it is printed.

    Args:
        job: what to do.
        read: gives the records, or a table of frequency responses.
        provenance: where they come from; hashes of its sources and remarks are added.
        geometry: of the structure, where the job names no file of one.

    Raises:
        InvalidDataError: files that cannot be read or do not belong together, or a report that could not be written.
        InsufficientDataError: records that are too short or too poor.
    """
    specification, named = read_setup(job)
    geometry = geometry if named is None else named
    refuse_other_report(job.folder, "findings.csv")
    refuse_sources(
        (*ReportFiles.in_folder(job.folder), *([] if job.pdf is None else [job.pdf])),
        map(Path, (*provenance.sources, *provenance.besides)),
    )
    unseen: list[str] = []
    with (
        standing(job.folder),
        progress_bar() as tell,
        own_warnings() as heard,
        live_view(wanted=job.live, tell=unseen.append) as viewer,
    ):
        tell("reading", 0.0)
        records, remarks = read()
        point = chosen_point(records, job.driving_point)
        files_read = fingerprints((*provenance.sources, *provenance.besides))
        if viewer is not None and not isinstance(records, FrequencyResponse):
            log_records(records, viewer)

        if not isinstance(records, FrequencyResponse):
            say_beforehand(*sizes(records), *expected_work(records))

        def progress(what: str, share: float) -> None:
            tell(what, READ + (IDENTIFIED - READ) * share)
            if viewer is not None:
                log_progress(viewer, what, share)

        result = identify(
            records,
            observer_order=job.observer_order,
            ridge=job.ridge,
            order=job.order,
            kind=job.kind,
            progress=progress,
        )
        if point is not None and result.modes.system:
            result = with_modal_mass(result, driving_point=point)
        tell("looking at the quality of the data", IDENTIFIED)
        quality = None
        if not isinstance(records, FrequencyResponse):
            quality = check_quality(used_rows(records, result.record_kind), choices=result.choices)
        if viewer is not None:
            log_result(result, viewer, geometry=geometry)
        tell("writing the report and the recording", IDENTIFIED)
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
        if job.pdf is not None:
            tell("printing the report", WRITTEN)
            write_pdf(files.html, job.pdf)
        limits = () if specification is None else check_limits(result, specification)
    console = Screen(highlight=False)
    show_result(console, result, remarks=(*remarks, *unseen), limits=limits, quality=quality)
    return Finished(result=result, files=files, pdf=job.pdf, limits=limits, console=console)


def chosen_point(records: tuple[Record, ...] | FrequencyResponse, given: Sequence[str]) -> tuple[str, str] | None:
    """The output and the input of the driving point: those given, in either order, else two that name one place.

    Raises:
        InvalidDataError: what is given is no output and an input that make one.
    """
    channels = records if isinstance(records, FrequencyResponse) else records[0]
    if given:
        if len(given) != 2:
            raise InvalidDataError(
                f"a driving point is one output and one input, but {len(given)} channels are named; write OUTPUT,INPUT."
            )
        one, other = given if given[0] in channels.output_names else given[::-1]
        driving_point_of(channels, (one, other))
        return one, other
    pairs = itertools.product(channels.output_names, channels.input_names)
    found = [pair for pair in pairs if same_dof(*pair)]
    with contextlib.suppress(InvalidDataError):  # volts, or strains beside them
        for pair in found:
            driving_point_of(channels, pair)
            return pair
    return None


@contextlib.contextmanager
def own_warnings() -> Iterator[list[str]]:
    """Our own warnings as sentences for the report; those of libraries are not for the user."""
    texts: list[str] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", IdentificationWarning)
        warnings.showwarning = lambda message, *_args, **_options: texts.append(str(message))
        yield texts


def sizes(records: Sequence[Record]) -> tuple[int, int]:
    """Samples of all records, and channels of each.

    Example:
        >>> sizes(read_demo()[0])
        (9000, 8)
    """
    return sum(record.n_samples for record in records), records[0].n_inputs + records[0].n_outputs


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


DrivingPoint = Annotated[
    list[str] | None,
    typer.Option(
        metavar="OUTPUT,INPUT",
        help="A sensor and a force at one place and in one direction, for modal masses; found where names say it.",
    ),
]


def run(
    files: Records,
    *,
    inputs: Inputs = None,
    outputs: Outputs = None,
    dt: Dt = None,
    hold: Hold = "band_limited",
    kind: Kind = "auto",
    folder: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--out",
            metavar="FOLDER",
            parser=folder_path,
            help="Folder for the report; modal-report-NAME unless given.",
        ),
    ] = None,
    test: Test = None,
    geometry: GeometryFile = None,
    driving_point: DrivingPoint = None,
    observer_order: Annotated[str, typer.Option(metavar="N", help="Past samples the observer uses, or auto.")] = "auto",
    ridge: Annotated[str, typer.Option(metavar="NUMBER", help="Regularisation of the observer fit, or auto.")] = "auto",
    order: Annotated[str, typer.Option(metavar="N", help="Model order (number of states), or auto.")] = "auto",
    live: Live = False,
    pdf: Pdf = False,
    overwrite: Overwrite = False,
    traceback: Traceback = False,
) -> None:
    """Identify the modes in measured FILES and write a report and a Rerun recording.

    Exit status: 0 done; 1 done, but the result is not reliable
    or a limit of --test is not surely met; 2 wrong use or unreadable input.
    """
    with faults(show=traceback):
        job = Job(
            folder=folder or Path(f"modal-report-{plain_name(files[0].stem)}"),
            existing="replace" if overwrite else "refuse",
            observer_order=whole_or_auto(observer_order, "observer order"),
            ridge=number_or_auto(ridge, "ridge"),
            order=whole_or_auto(order, "model order"),
            kind=kind,
            test=test,
            geometry=geometry,
            driving_point=tuple(name_list(driving_point, "channels of the driving point") or ()),
            live=live,
            printed=pdf,
        )
        source = FileSource(
            files=files, inputs=name_list(inputs, "inputs"), outputs=name_list(outputs, "outputs"), dt=dt, hold=hold
        )
        finished = carry_out(job, source.read_any, provenance=source.provenance(job))
        show_files(finished.console, finished.files, pdf=finished.pdf)
        raise typer.Exit(exit_status(finished))


def exit_status(finished: Finished) -> int:
    """0 where the result can be relied on and every limit is surely met, 1 otherwise."""
    return 0 if trust_of(finished.result).trust != "not carried" and all_met(finished.limits) else 1


DEMO_EXAMPLES = examples(
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
