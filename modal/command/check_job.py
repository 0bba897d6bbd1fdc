"""One run of `modal-report check`: read, look at the data, write the numbers if asked, then print what was found."""

import contextlib
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from modal.command.job import FileSource, own_warnings, progress_bar
from modal.command.job_setup import refuse_sources
from modal.command.terminal_check import show_quality
from modal.quality.check import check_quality
from modal.quality.findings import ChannelQuality, DataQuality, Finding
from okid.errors import InvalidDataError

if TYPE_CHECKING:
    from okid.record import Record

__all__ = ["CheckJob", "carry_out_check", "check_status", "quality_json"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CheckJob:
    """What to look at.

    Attributes:
        source: files, channels, time step.
        json: file for the numbers and findings; None writes none. One that is there is replaced.
    """

    source: FileSource
    json: Path | None = None


def carry_out_check(job: CheckJob) -> tuple[DataQuality, Console]:
    """Read, check, write, print what was found; the file is complete before a word is printed.

    Raises:
        InvalidDataError: files that cannot be read or do not belong together, or numbers that could not be written, or
            not without losing a measured file.
    """
    if job.json is not None:
        refuse_sources([job.json], job.source.files)
    with progress_bar() as tell, own_warnings() as heard:
        tell("reading", 0.0)
        records, remarks = job.source.read()
        tell("looking at the data", 0.3)
        quality = check_quality(records)
        if job.json is not None:
            _write(job.json, quality_json(quality, records))
    console = Console(highlight=False)
    show_quality(console, quality, records, remarks=(*remarks, *heard))
    return quality, console


def check_status(quality: DataQuality) -> int:
    """Exit status: 1 where something bad was found, else 0."""
    return 1 if quality.level == "bad" else 0


def quality_json(quality: DataQuality, records: "Sequence[Record]") -> str:
    """Everything that was found as JSON; what is not known is null. The same records give the same bytes.

    Args:
        quality: of the records.
        records: as they were read.
    """
    document = {
        "level": quality.level,
        "verdict": quality.verdict,
        "records": [
            {"name": record.name, "samples": record.n_samples, "dt": record.dt, "start_time": record.start_time}
            for record in records
        ],
        "findings": [_finding(finding) for finding in quality.findings],
        "channels": [_channel(channel) for channel in quality.channels],
    }
    return json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _finding(finding: Finding) -> dict[str, object]:
    return {
        "level": finding.level,
        "what": finding.what,
        "where": finding.where,
        "sentence": finding.sentence,
        "channels": list(finding.channels),
        "spans": [{"record": record, "from": start, "to": stop} for record, start, stop in finding.spans],
        "share": _known(finding.share),
    }


def _channel(channel: ChannelQuality) -> dict[str, object]:
    numbers = {name: _known(value) for name, value in asdict(channel.statistics).items()}
    return {"name": channel.name, "role": channel.role, "unit": channel.unit, "level": channel.level, **numbers}


def _known(number: float) -> float | None:
    return number if math.isfinite(number) else None


def _write(path: Path, text: str) -> None:
    """The whole file or none of it."""
    beside = path.with_name(f".{path.name}.part")
    try:
        try:
            beside.write_text(text, encoding="utf-8")
            beside.replace(path)
        except BaseException:
            with contextlib.suppress(OSError):
                beside.unlink(missing_ok=True)
            raise
    except OSError as error:
        raise InvalidDataError(f"{path} could not be written ({error.strerror}); choose another place.") from error
