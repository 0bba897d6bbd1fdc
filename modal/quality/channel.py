"""One channel of all records, in memory while it is looked at; and the words for when and how much."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from modal.quality.findings import Role, Span
from modal.wording.names import shorten
from okid.arrays import CHUNK_VALUES, FloatArray
from okid.record import Record
from okid.scaling import ChannelScaling

__all__ = ["MOST_SPANS", "Channel", "channels_of", "named", "spoken", "when", "where_found"]

MOST_SPANS = 200
"""Places that a finding lists; its sentence counts all of them."""
LONGEST_NAME = 40
_GROUP_VALUES = 4 * CHUNK_VALUES
"""Values of neighbouring channels that are copied at a time: 64 MiB, or one channel where that is longer."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Channel:
    """The samples of one channel.

    Attributes:
        name: of the channel.
        role: "input" or "output".
        unit: "" where unknown.
        index: among the inputs, or among the outputs.
        parts: (n_samples,) a record, contiguous; NaN where missing.
        starts: time of the first sample of each record [s].
        dt: time step [s].
        mean: over all records.
        std: over all records, 0 for a channel that moves by no more than its last digit.
        smallest: least value.
        largest: greatest value.
        n_missing: samples without a number.
    """

    name: str
    role: Role
    unit: str
    index: int
    parts: tuple[FloatArray, ...]
    starts: tuple[float, ...]
    dt: float
    mean: float
    std: float
    smallest: float
    largest: float
    n_missing: int

    @property
    def n_samples(self) -> int:
        """Rows over all records."""
        return sum(len(part) for part in self.parts)

    @property
    def extent(self) -> float:
        """Distance of the greatest from the least value."""
        return self.largest - self.smallest

    def span(self, record: int, start: int, stop: int) -> Span:
        """Samples `start` to `stop` of a record, as times."""
        return record, self.starts[record] + start * self.dt, self.starts[record] + stop * self.dt

    def value(self, number: float) -> str:
        """A number with the channel's unit."""
        return f"{number:.4g} {self.unit}".rstrip()


def channels_of(records: Sequence[Record], scaling: ChannelScaling) -> Iterator[Channel]:
    """Inputs, then outputs, one after the other; a few neighbours are copied at a time, so a mapped file stays there.

    Args:
        records: of one system.
        scaling: their means and sizes.
    """
    longest = sum(record.n_samples for record in records)
    step = max(1, min(8, _GROUP_VALUES // longest))
    first = records[0]
    for role, names, units, means, scales, constant in (
        ("input", first.input_names, first.input_units, scaling.input_mean, scaling.input_scale,
         scaling.constant_inputs),
        ("output", first.output_names, first.output_units, scaling.output_mean, scaling.output_scale,
         scaling.constant_outputs),
    ):  # fmt: skip
        for start in range(0, len(names), step):
            blocks = [
                np.ascontiguousarray((record.inputs if role == "input" else record.outputs)[:, start : start + step].T)
                for record in records
            ]
            for i in range(start, min(start + step, len(names))):
                parts = tuple(block[i - start] for block in blocks)
                yield Channel(
                    name=names[i],
                    role="input" if role == "input" else "output",
                    unit=units[i],
                    index=i,
                    parts=parts,
                    starts=tuple(record.start_time for record in records),
                    dt=first.dt,
                    mean=float(means[i]),
                    std=0.0 if i in constant else float(scales[i]),
                    smallest=min(float(np.fmin.reduce(part)) for part in parts),
                    largest=max(float(np.fmax.reduce(part)) for part in parts),
                    n_missing=sum(int(np.isnan(part).sum()) for part in parts),
                )


def named(names: str | Iterable[str]) -> str:
    """Channel names in quotes, at most four of them.

    Example:
        >>> named(["a", "b"]), named("tip")
        ("'a' and 'b'", "'tip'")
    """
    if isinstance(names, str):
        return repr(shorten(names, LONGEST_NAME))
    shown = [repr(shorten(name, LONGEST_NAME)) for name in names]
    if len(shown) > 4:
        return f"{', '.join(shown[:4])} and {len(shown) - 4} more"
    return shown[0] if len(shown) == 1 else f"{', '.join(shown[:-1])} and {shown[-1]}"


def spoken(number: float) -> str:
    """A number to three digits.

    Example:
        >>> spoken(12.3456), spoken(1500.0)
        ('12.3', '1500')
    """
    return f"{number:.0f}" if 1000 <= abs(number) < 1e6 else f"{number:.3g}"


def when(spans: Sequence[Span], n_records: int) -> str:
    """The first place in words, and how many more there are.

    Example:
        >>> when([(0, 1.0, 1.5), (0, 3.0, 3.5)], 1)
        '1 to 1.5 s and 1 more place'
    """
    if not spans:
        return "all records" if n_records > 1 else "whole record"
    record, start, stop = spans[0]
    text = f"{start:.6g} s" if f"{start:.6g}" == f"{stop:.6g}" else f"{start:.6g} to {stop:.6g} s"
    text += f" of record {record + 1}" if n_records > 1 else ""
    more = len(spans) - 1
    return text + (f" and {more} more place{'s' * (more > 1)}" if more else "")


def where_found(names: str | Iterable[str], spans: Sequence[Span], n_records: int) -> str:
    """Where something was found: channels and the first time."""
    return f"{named(names)}, {when(spans, n_records)}"
