"""One page on a batch: what to look at first, frequencies against time, records that failed or differ."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from modal.batch.tables import part_file
from modal.batch.task import Outcome
from modal.plots.records import frequencies_of_records, places_of_records
from modal.report.pages import environment, inline
from modal.report.pictures import drawn
from modal.sections.provenance import installed_version

__all__ = ["PAGE", "batch_headline", "write_page"]

PAGE = "batch.html"
MOST_LISTED = 200
"""List so many records that failed or differ; records.parquet has all."""


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

    Args:
        outcomes: by name of the record.
        modes: table of all modes.
        folder: of the batch.

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
            rows=[(one.record, one.status, one.message) for one in told[:MOST_LISTED]],
            n_more=max(0, len(told) - MOST_LISTED),
            version=installed_version(),
        )
    )
    with part_file(folder / PAGE) as part:
        part.write_bytes((text + "\n").encode("utf-8"))
    return folder / PAGE
