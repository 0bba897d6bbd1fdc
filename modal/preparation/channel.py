"""One channel while it is looked at, what a look finds, and the numbers that several looks share."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from modal.wording.text import shorten
from okid.arrays import CHUNK_VALUES, FloatArray
from okid.display import Displayed
from okid.record import Record
from okid.scaling import ChannelScaling

FALSE_ALARM = 1e-9
"""Name a sample or a line that chance alone would leave so far off with this probability: a record has up to 1e7."""

SPOILED = 1e-3
"""Call an output bad where a larger share of its samples is clipped or spiked."""

NOTABLE = 0.01
"""Speak of what holds a larger share of a channel's power, density or time; a fit at best tells a hundredth."""

SERIOUS = 0.05
"""Doubt a channel of which a larger share is missing, undriven or rounding noise."""

HARDLY = 0.1
"""Call what is explained, usable, or high in standard deviations, hardly anything up to this share."""

MOSTLY = 0.5
"""Call a larger share of the power, the samples or the lines most of it."""

ROUNDING = 1e-9
"""Take numbers that are closer, relative to their size, as one number that was rounded twice."""

MOST_ROWS = 1 << 16
"""Look at the first so many rows where more would say the same."""

FITTED_ROWS = 6000
"""Fit an observer to so many rows: hundredths of a second, and enough to tell what inputs explain."""

FEWEST_ROWS = 1000
"""Look for drift and changes of level over so many rows, or means of neighbouring rows, and in no shorter record."""

BLOCK = 64
"""Make a spectrum, or learn what is usual, of so many samples at least."""

NEARLY_ALL = 0.9
"""Call a larger share of the power, the runs or the band nearly all of it."""

MOST_SPANS = 200
"""List so many places in a finding; its sentence counts all of them."""

Level = Literal["bad", "doubtful", "note"]
"""bad: what is found spoils a result; doubtful: look at it before believing one; note: good to know."""

LEVELS: tuple[Level, ...] = ("bad", "doubtful", "note")

Role = Literal["input", "output"]

Span = tuple[int, float, float]
"""Index of a record, and from when to when in its own time [s]."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Finding(Displayed):
    """One thing that an engineer should know before the record is used.

    Attributes:
        level: "bad", "doubtful" or "note".
        what: a key such as "clipped", "spikes" or "mains hum".
        where: channels, record and time in words; "all records" where it concerns everything.
        sentence: what is there, how much of it, and what to do.
        channels: names of the channels concerned.
        spans: (index of record, from, to) [s] in that record's own time, for each place, at most 200 of them; empty
            where it concerns the whole of all records.
        share: of the samples or of the channel's power that is concerned, nan where neither has a meaning.
    """

    level: Level
    what: str
    where: str
    sentence: str
    channels: tuple[str, ...] = ()
    spans: tuple[Span, ...] = ()
    share: float = float("nan")

    @property
    def channel(self) -> str:
        """The channel where there is one only, "" otherwise."""
        return self.channels[0] if len(self.channels) == 1 else ""


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

    def finding(
        self, *, level: Level, what: str, sentence: str, spans: tuple[Span, ...] = (), share: float = float("nan")
    ) -> Finding:
        """What was found in this channel alone."""
        where = where_found(self.name, spans, len(self.parts))
        names = (self.name,)
        return Finding(level=level, what=what, where=where, sentence=sentence, channels=names, spans=spans, share=share)


def channels_of(records: Sequence[Record], scaling: ChannelScaling) -> Iterator[Channel]:
    """Inputs, then outputs, one after the other; a few neighbours are copied at a time: a mapped file stays there."""
    longest = sum(record.n_samples for record in records)
    step = max(1, min(8, 4 * CHUNK_VALUES // longest))  # 64 MiB
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
        return repr(shorten(names))
    shown = [repr(shorten(name)) for name in names]
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
