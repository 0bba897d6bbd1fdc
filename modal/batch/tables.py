"""The tables of a batch: one row a mode, one row a record; made from the results that are kept, in the order of names.

They follow from the results alone, so whatever executor worked, the bytes are the same (but for the seconds).

Beside them stands one page: what to look at first, frequencies against time, records that failed or differ.
"""

import contextlib
import json
import math
import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from modal.batch.task import RESULT, Outcome, kept_modes
from modal.identification.result import Identification, load
from modal.plots.histories import frequencies_of_records, places_of_records
from modal.report.pages import environment, inline
from modal.report.pictures import drawn
from modal.sections.validation import installed_version
from modal.wording.text import listed, shorten
from okid.display import Displayed
from okid.errors import InvalidDataError, UnreadableFileError, visible
from okid.readers.guard import complete_file

MODE_TABLE, RECORD_TABLE, MODE_CSV = "modes.parquet", "records.parquet", "modes.csv"
PLACES = "records"
"""Folder of the folders of all records."""
OUTPUTS = b"outputs"
"""Name of the list of channels in the description of the column "shape"."""


class TableLimits:
    """How tables and pages of many records are written."""

    SHORT: Final = 0.9
    """Name a record that is shorter than this share of the usual length: its file may be cut off."""
    ROWS_AT_ONCE: Final = 500
    """Write the modes of so many records at once: some ten megabytes."""
    MOST_LISTED: Final = 200
    """List so many records that failed or differ; records.parquet has all."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Batch(Displayed):
    """The results of many records, in a folder; read when asked for.

    Args:
        folder: that `modal.identify_batch` or `modal-report batch` filled.

    Raises:
        UnreadableFileError: there is no batch in the folder.
    """

    folder: Path

    def __post_init__(self) -> None:
        object.__setattr__(self, "folder", Path(self.folder))
        if not all((self.folder / name).is_file() for name in (MODE_TABLE, RECORD_TABLE)):
            shown = f"{shorten(visible(str(self.folder)), 200)!r}"
            what = (
                f"{shown} holds no {MODE_TABLE} and {RECORD_TABLE}" if self.folder.is_dir() else f"there is no {shown}"
            )
            raise UnreadableFileError(f"{what}; give the folder of a finished modal-report batch.")

    def __repr__(self) -> str:
        status = self.records.column("status").to_pylist()
        return f"Batch({str(self.folder)!r}: {len(status)} records, {status.count('failed')} failed)"

    @property
    def records(self) -> Any:
        """pyarrow.Table, one row a record: record, path, hash, status, message, seconds."""
        return read_written(self.folder / RECORD_TABLE)

    @property
    def modes(self) -> Any:
        """pyarrow.Table, one row a pole and record, by record and number.

        Columns: record, start_time [s], mode, frequency [Hz], frequency_std, damping_ratio, damping_ratio_std,
        probability, verdict, shape (a list of real and imaginary parts over the channels of all records, which the
        column's metadata names; nan where a record lacks the channel).
        """
        return read_written(self.folder / MODE_TABLE)

    def results(self) -> Iterator[Identification]:
        """Every result that is done, by name of the record, read one by one.

        Raises:
            UnreadableFileError: a result that is damaged or gone, or one so large that its file keeps a summary alone.
        """
        outcomes = self.records.select(["status", "folder"]).to_pylist()
        for one in outcomes:
            if one["status"] == "done":
                yield load(self.folder / PLACES / one["folder"] / RESULT)


def read_written(path: Path) -> Any:
    """A Parquet file as a pyarrow.Table.

    Raises:
        UnreadableFileError: it cannot be read.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        return pq.read_table(path)
    except (OSError, pa.ArrowException) as error:
        words = " ".join(str(error).split())[:200]
        raise UnreadableFileError(f"{path} is damaged or no table ({words}); run modal-report batch again.") from error


def with_oddities(outcomes: Sequence[Outcome]) -> tuple[Outcome, ...]:
    """The same, with a sentence on each record whose time step, channels or units are not those of most, or is shorter.

    A length is usual where more than half of the records have it, or nearly so.
    """
    done = [one for one in outcomes if one.status == "done"]
    if not done:
        return tuple(outcomes)
    step = Counter(_step(one) for one in done).most_common(1)[0][0]
    inputs = Counter(one.inputs for one in done).most_common(1)[0][0]
    outputs = Counter(one.outputs for one in done).most_common(1)[0][0]
    lengths = np.array([one.n_samples for one in done])
    middle = int(np.median(lengths))
    length = (
        middle
        if np.mean((lengths >= TableLimits.SHORT * middle) & (TableLimits.SHORT * lengths <= middle)) > 0.5
        else 0
    )
    usual = replace(next(one for one in done if _step(one) == step), inputs=inputs, outputs=outputs, n_samples=length)
    return tuple(replace(one, message=_oddity(one, usual)) if one.status == "done" else one for one in outcomes)


def _oddity(one: Outcome, usual: Outcome) -> str:
    differs = [] if _step(one) == _step(usual) else [f"time step {_step(one)} (most: {_step(usual)})"]
    if one.n_samples < TableLimits.SHORT * usual.n_samples:
        differs.append(f"{one.n_samples} samples (most: {usual.n_samples}), so its file may be cut off")
    for role, own, common in (("input", one.inputs, usual.inputs), ("output", one.outputs, usual.outputs)):
        dead = [name for name in common if name in one.left_out]
        several = [
            (f"without {role}", [name for name in common if name not in own and name not in dead]),
            (f"with a dead {role}", dead),
            (f"with {role}", [name for name in own if name not in common]),
        ]
        told = [f"{what}{'s' * (len(names) > 1)} {shorten(listed(names), 120)}" for what, names in several if names]
        differs += told or ([f"{role}s in another order"] if own != common else [])
    return f"unlike most records: {'; '.join(differs)}; compare its modes with care." if differs else ""


def _step(one: Outcome) -> str:
    return f"{one.dt:.6g} s"


def write_tables(outcomes: Sequence[Outcome], places: Sequence[Path], folder: Path) -> None:
    """Write both tables, and the modes without their shapes as CSV; each appears when it is complete.

    Raises:
        InvalidDataError: the folder cannot be written.
        UnreadableFileError: a result that is damaged or gone.
    """
    import pyarrow as pa
    import pyarrow.csv as pa_csv
    import pyarrow.parquet as pq

    with part_file(folder / RECORD_TABLE) as part:
        told = [_record_row(one, place) for one, place in zip(outcomes, places, strict=True)]
        pq.write_table(pa.Table.from_pylist(told, schema=_record_schema()), part)
    channels = list(dict.fromkeys(name for one in outcomes for name in one.outputs))
    schema = _mode_schema(channels)
    without_shape = pa.schema([field for field in schema if field.name != "shape"])
    done = [(one, place) for one, place in zip(outcomes, places, strict=True) if one.status == "done"]
    with (
        part_file(folder / MODE_TABLE) as part,
        part_file(folder / MODE_CSV) as plain,
        pq.ParquetWriter(part, schema) as writer,
        pa_csv.CSVWriter(plain, without_shape) as lines,
    ):
        for first in range(0, len(done), TableLimits.ROWS_AT_ONCE):
            rows = [
                row
                for one, place in done[first : first + TableLimits.ROWS_AT_ONCE]
                for row in _mode_rows(one, kept_modes(place), channels)
            ]
            table = pa.Table.from_pylist(rows, schema=schema)
            writer.write_table(table)
            lines.write_table(table.select(without_shape.names).replace_schema_metadata(None))


def _record_schema() -> Any:
    import pyarrow as pa

    texts = ("record", "path", "hash", "status", "message")
    return pa.schema([*((name, pa.string()) for name in texts), ("seconds", pa.float64()), ("folder", pa.string())])


def _record_row(one: Outcome, place: Path) -> dict[str, object]:
    return {
        "record": one.record,
        "path": os.pathsep.join(one.paths),
        "hash": one.hash,
        "status": one.status,
        "message": one.message,
        "seconds": one.seconds,
        "folder": place.name,
    }


def _mode_schema(channels: Sequence[str]) -> Any:
    import pyarrow as pa

    number, text = pa.float64(), pa.string()
    part = pa.struct([("real", number), ("imag", number)])
    return pa.schema(
        [
            pa.field("record", text),
            pa.field("start_time", number, metadata={"unit": "s"}),
            pa.field("mode", pa.int32()),
            *(pa.field(name, number, metadata={"unit": "Hz"}) for name in ("frequency", "frequency_std")),
            *(pa.field(name, number) for name in ("damping_ratio", "damping_ratio_std", "probability")),
            pa.field("verdict", text),
            pa.field("shape", pa.list_(part), metadata={OUTPUTS: json.dumps(list(channels)).encode()}),
        ]
    )


def _mode_rows(
    one: Outcome, modes: Sequence[Mapping[str, Any]], channels: Sequence[str]
) -> Iterator[dict[str, object]]:
    where = [channels.index(name) for name in one.outputs]
    for mode in modes:
        shape: list[dict[str, float]] = [{"real": math.nan, "imag": 0.0}] * len(channels)
        for at, (real, imaginary) in zip(where, mode["shape"], strict=True):
            shape[at] = {"real": real, "imag": imaginary}
        yield {**mode, "record": one.record, "start_time": one.start_time, "shape": shape}


@contextlib.contextmanager
def part_file(target: Path) -> Iterator[Path]:
    """A file beside the target to write to, which takes its place when the block ends well.

    Raises:
        InvalidDataError: the folder cannot be written.
    """
    try:
        with complete_file(target) as part:
            yield part
    except OSError as error:
        raise InvalidDataError(
            f"{shorten(visible(str(target)), 200)!r} cannot be written ({error.strerror or error}); the results of all "
            "records are kept, so make room and give the same command again."
        ) from error


PAGE = "batch.html"


def batch_headline(outcomes: Sequence[Outcome]) -> str:
    """What became of the batch, in one sentence.

    Example:
        >>> batch_headline([Outcome(record="a", paths=("a.csv",), hash="", status="failed")])
        '0 of 1 record identified; 1 failed.'
    """
    n_failed = sum(one.status == "failed" for one in outcomes)
    records = f"{len(outcomes)} record{'s' * (len(outcomes) != 1)}"
    if not n_failed:
        return f"{'All ' * (len(outcomes) > 1)}{records} identified."
    return f"{len(outcomes) - n_failed} of {records} identified; {n_failed} failed."


def first_looks(outcomes: Sequence[Outcome]) -> tuple[str, ...]:
    """What to look at first, the worst first; empty where nothing stands out."""
    poor = [one.record for one in outcomes if one.trust == "not carried"]
    odd = [one.record for one in outcomes if one.status == "done" and one.message]
    failed = [one.record for one in outcomes if one.status == "failed"]
    groups = (
        (failed, "failed: see why below"),
        (poor, "identified, but the result is not reliable"),
        (odd, "not like the others in time step, length, channels or units"),
    )
    return tuple(f"{len(names)} {what}: {_few(names)}" for names, what in groups if names)


def _few(names: Sequence[str]) -> str:
    more = f" and {len(names) - 5} more" if len(names) > 5 else ""
    return ", ".join(names[:5]) + more


def _modes_of_each(done: Sequence[Outcome], modes: Any) -> list[int]:
    """Modes of the system in each record."""
    system = zip(modes.column("record").to_pylist(), modes.column("verdict").to_pylist(), strict=True)
    found = Counter(name for name, verdict in system if verdict == "system")
    return [found[one.record] for one in done]


def _caption(along: str) -> str:
    counted = " Records are counted by name from 1, those that failed included." if along == "record" else ""
    return f"A dot for each mode in each record.{counted} Poles judged as noise are not drawn; modes.parquet has them."


def write_page(outcomes: Sequence[Outcome], modes: Any, folder: Path) -> Path:
    """Write batch.html: one page that needs nothing but itself.

    Raises:
        InvalidDataError: the folder cannot be written.
    """
    numbers = [number for number, one in enumerate(outcomes, start=1) if one.status == "done"]
    done = [outcomes[number - 1] for number in numbers]
    along, label = places_of_records(np.array([one.start_time for one in done]), numbers)
    place = {one.record: float(where) for one, where in zip(done, along, strict=True)}
    verdicts = modes.column("verdict").to_pylist()
    chart = frequencies_of_records(
        np.array([place[name] for name in modes.column("record").to_pylist()], dtype=np.float64),
        modes.column("frequency").to_numpy(zero_copy_only=False),
        verdicts,
        along=label,
    )
    told = [one for one in outcomes if one.message]
    text = (
        environment(html=True)
        .get_template("batch.html.j2")
        .render(
            headline=batch_headline(outcomes),
            state="carried" if len(done) == len(outcomes) else "with-care" if done else "not-carried",
            facts=(
                ("records", str(len(outcomes))),
                ("identified", str(len(done))),
                ("failed", str(len(outcomes) - len(done))),
                ("modes a record, median", f"{np.median(_modes_of_each(done, modes)):g}" if done else "–"),
                ("time of all workers", f"{sum(one.seconds for one in outcomes):.0f} s"),
            ),
            first_looks=first_looks(outcomes),
            pictures={"frequencies": inline(drawn(chart, "frequencies", _caption(label)))} if done else {},
            rows=[(one.record, one.status, one.message) for one in told[: TableLimits.MOST_LISTED]],
            n_more=max(0, len(told) - TableLimits.MOST_LISTED),
            version=installed_version(),
        )
    )
    with part_file(folder / PAGE) as part:
        part.write_bytes((text + "\n").encode("utf-8"))
    return folder / PAGE
