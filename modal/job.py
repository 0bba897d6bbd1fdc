"""One run of the command: read, identify, write everything, then print what was found."""

import contextlib
import shlex
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from rich.console import Console

from modal.report.provenance import Provenance
from okid.errors import IdentificationWarning
from okid.record import InputHold, Record

if TYPE_CHECKING:
    from modal.identification import Identification
    from modal.report import ReportFiles

__all__ = ["FileSource", "Job", "Reading", "carry_out", "own_warnings", "progress_bar", "read_demo"]

Auto = Literal["auto"]
Progress = Callable[[str, float], None]
Reading = tuple[tuple[Record, ...], tuple[str, ...]]
"""Records, and remarks on what was done to their units."""

DEMO_SEED = 2


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Job:
    """What to do with the records, wherever they come from."""

    folder: Path
    existing: Literal["refuse", "replace"]
    observer_order: int | Auto = "auto"
    ridge: float | Auto = "auto"
    order: int | Auto = "auto"


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
        from okid.readers import read_described

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
        return Provenance(command=shlex.join(words), sources=tuple(map(str, self.files)), dt=self.dt)


def read_demo() -> Reading:
    """The embedded example, always the same."""
    import numpy as np

    from modal.examples.demo import demo_record

    return (demo_record(np.random.default_rng(DEMO_SEED)),), ()


def carry_out(
    job: Job, read: Callable[[], Reading], *, provenance: Provenance
) -> "tuple[Identification, ReportFiles, Console]":
    """Read, identify, write, print what was found; the report is complete before a word of it is printed."""
    from modal.pipeline import identify
    from modal.report import write_report
    from modal.report.writing import refuse_existing
    from modal.terminal import show_result

    refuse_existing(job.folder, job.existing)
    with progress_bar() as tell, own_warnings() as heard:
        tell("reading", 0.0)
        records, remarks = read()
        result = identify(
            records,
            observer_order=job.observer_order,
            ridge=job.ridge,
            order=job.order,
            progress=lambda what, share: tell(what, 0.03 + 0.87 * share),
        )
        tell("writing the report and the recording", 0.9)
        remarks = (*remarks, *heard)
        provenance = replace(provenance, remarks=remarks)
        files = write_report(result, job.folder, existing=job.existing, provenance=provenance)
    console = Console(highlight=False)
    show_result(console, result, remarks=remarks)
    return result, files, console


@contextlib.contextmanager
def progress_bar() -> Iterator[Progress]:
    """A bar on stderr that is gone when the work is done; nothing where stderr is not a terminal."""
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("starting", total=1.0)
        yield lambda what, share: bar.update(task, description=what, completed=share)


@contextlib.contextmanager
def own_warnings() -> Iterator[list[str]]:
    """Our own warnings as sentences for the report; those of libraries are not for the user."""
    texts: list[str] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", IdentificationWarning)
        warnings.showwarning = lambda message, *_args, **_options: texts.append(str(message))
        yield texts
