"""One channel while it is looked at, what a look finds, and the numbers that several looks share.

Then the single samples: those far off the curve through their neighbours, those without a number, too few of all.
Each sample is compared with the cubic through its two neighbours on either side. A spike is off by six times what is
usual nearby (a normal variable is so with `FALSE_ALARM`), and with it taken out the neighbours lie as they usually do:
a hit, a step or the start of a ringing stays rough. Beside missing samples the curve is a guess, and a spike is off by
six deviations of the channel itself.

The smallest observer that holds one mode looks two samples back: of n_channels channels it has 2 n_channels + n_inputs
coefficients an output, and one row of the records gives one equation for them.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy

from modal.wording.text import percent, shorten
from okid.arrays import CHUNK_VALUES, BoolArray, FloatArray, with_numbers
from okid.display import Displayed
from okid.record import Record
from okid.rows import runs_of, usable_rows
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
                    smallest=float(np.fmin.reduce([np.fmin.reduce(part) for part in parts])),
                    largest=float(np.fmax.reduce([np.fmax.reduce(part) for part in parts])),
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


LEFT_OVER = 0.2
"""Ask that the neighbours of a spike lie within this share of it, or a third of the limit, once it is taken out."""

CROWDED = 0.75
"""Take this quantile of a block for what is usual where steps or hits may fill a third of it and are no spikes."""

PAST = 2
"""Count so many samples of the past for one mode."""

ROWS_PER_COEFFICIENT = 10
"""Doubt a record with fewer rows a coefficient: a fit follows the noise."""

OBSERVER_ORDER = 50
"""Count a row as usable where it and so many before it are complete, about what an observer uses."""

_REACH = 2


def spike_findings(channel: Channel, resolution: float, hits: Sequence[BoolArray]) -> list[Finding]:
    """Spikes of one channel.

    Args:
        channel: the channel.
        resolution: distance of neighbouring levels, nan where there is no grid.
        hits: (n_samples,) a record, True where an input moves sharply: an output's answer to it is no spike.
    """
    found, largest = spikes_of(channel, resolution, hits)
    if not found:
        return []
    spans = tuple(channel.span(number, k, k + 1) for number, k in found[:MOST_SPANS])
    share = len(found) / channel.n_samples
    what = "one sample" if len(found) == 1 else f"{len(found)} single samples ({percent(share)})"
    lies = "lies" if len(found) == 1 else "lie"
    return [
        channel.finding(
            level=_level(channel, share, largest),
            what="spikes",
            sentence=f"{channel.role} {named(channel.name)}: {what} {lies} up to {spoken(largest / channel.std)} "
            f"standard deviations off the curve through the neighbours (first at {spans[0][1]:.6g} s): electrical "
            "spikes or lost bits, look at cables and grounding; mark them as missing (empty cells).",
            spans=spans,
            share=share,
        )
    ]


def spikes_of(channel: Channel, resolution: float, hits: Sequence[BoolArray]) -> tuple[list[tuple[int, int]], float]:
    """Record and sample of each spike, and how far the largest is off; arguments as in `spike_findings`."""
    found: list[tuple[int, int]] = []
    largest = 0.0
    for number, part in enumerate(channel.parts if channel.std > 0.0 else ()):
        off = _off_curve(part)
        for k in _sharp(part, off, channel, resolution):
            if channel.role == "output" and hits[number][max(0, k - _REACH) : k + _REACH + 1].any():
                continue
            if channel.role == "input" and not _moves_nearby(part, k, channel):
                continue
            found.append((number, k))
            largest = max(largest, abs(float(off[k])))
    return found, largest


def without_spikes(channel: Channel, found: Sequence[tuple[int, int]]) -> Channel:
    """The channel with these samples missing, as `spikes_of` finds them: what lies beyond a limit hides it.

    A value that several of them share stays, for that is a limit at which peaks of one sample end.
    """
    values = np.array([channel.parts[number][k] for number, k in found])
    own, counts = np.unique(values, return_counts=True)
    alone = [place for place, value in zip(found, values, strict=True) if counts[np.searchsorted(own, value)] == 1]
    if not alone:
        return channel
    parts = [part.copy() for part in channel.parts]
    for number, k in alone:
        parts[number][k] = np.nan
    return replace(
        channel,
        parts=tuple(parts),
        smallest=float(np.fmin.reduce([np.fmin.reduce(part) for part in parts])),
        largest=float(np.fmax.reduce([np.fmax.reduce(part) for part in parts])),
        n_missing=channel.n_missing + len(alone),
    )


def _level(channel: Channel, share: float, largest: float) -> Level:
    if share >= SPOILED and channel.role == "output":
        return "bad"
    return "doubtful" if share >= SPOILED or largest >= channel.std else "note"


def sharp_samples(channel: Channel) -> tuple[BoolArray, ...]:
    """(n_samples,) a record, True where the channel is off the curve through its neighbours, spike or not.

    However coarse it is: a blow of one sample has two values, and one step of an input acts as any other.
    """
    masks = []
    for part in channel.parts:
        off = np.abs(_off_curve(part))
        limit = _limit(off, channel, np.nan, MOSTLY)  # the median, for steps and hits are looked for
        masks.append(np.asarray(off > limit, dtype=np.bool_))
    return tuple(masks)


def _off_curve(part: FloatArray) -> FloatArray:
    """Each sample less the cubic through two neighbours on either side; 0 at the ends, nan beside missing ones."""
    off = np.zeros(part.size)
    if part.size > 4:
        near, far = part[1:-3] + part[3:-1], part[:-4] + part[4:]
        off[2:-2] = part[2:-2] - (4.0 * near - far) / 6.0
    return off


def _bridged(part: FloatArray) -> FloatArray:
    """Straight lines across what is missing."""
    there = np.flatnonzero(~np.isnan(part))
    return np.interp(np.arange(part.size), there, part[there]) if there.size else part


def _limit(off: FloatArray, channel: Channel, resolution: float, quantile: float) -> FloatArray:
    """How far a sample may be off: six times what is usual in its block and the two beside it.

    Samples of which nothing is known take no part in what is usual; the blocks are of the others.
    """
    known = ~np.isnan(off)
    if not known.all():
        limit = np.full(off.size, np.inf)
        limit[known] = _limit(off[known], channel, resolution, quantile)
        return limit
    n_blocks = off.size // BLOCK
    floor = max(HARDLY * channel.std, 4.0 * resolution if np.isfinite(resolution) else 0.0)
    if n_blocks == 0:
        return np.full(off.size, np.inf)
    normal = float(scipy.special.ndtri(0.5 * (1.0 + quantile)))  # the quantile of the modulus of a normal variable
    place_of = int(quantile * BLOCK)
    blocks = np.abs(off[: n_blocks * BLOCK]).reshape(n_blocks, BLOCK)
    usual = np.partition(blocks, place_of, axis=1)[:, place_of] / normal
    padded = np.concatenate([usual[:1], usual, usual[-1:]])
    usual = np.maximum(np.maximum(padded[:-2], padded[1:-1]), padded[2:])
    every = np.repeat(usual, BLOCK)
    every = np.concatenate([every, np.full(off.size - every.size, usual[-1])])
    return np.asarray(np.maximum(-scipy.special.ndtri(FALSE_ALARM) * every, floor), dtype=np.float64)


def _sharp(part: FloatArray, off: FloatArray, channel: Channel, resolution: float) -> list[int]:
    """Samples that are far off while their neighbours are not once they are taken out."""
    limit = _limit(off, channel, resolution, CROWDED)
    unknown = np.isnan(off) & ~np.isnan(part)
    if unknown.any():
        off = np.where(unknown, _off_curve(_bridged(part)), off)
        limit = np.where(unknown, -scipy.special.ndtri(FALSE_ALARM) * channel.std, limit)
    size = np.abs(off)
    candidates = np.flatnonzero(size > limit)
    found = []
    for k in candidates[:100_000].tolist():
        nearby = part[max(0, k - 2 * _REACH) : k + 2 * _REACH + 1].copy()
        middle = min(k, 2 * _REACH)
        nearby[middle] -= off[k]
        if unknown[k]:
            nearby[middle] = np.nan
            nearby = _bridged(nearby)
        left = _off_curve(nearby)
        peak = size[k] >= np.nanmax(size[max(0, k - _REACH) : k + _REACH + 1])
        if (
            peak
            and _same_either_side(part, k, size[k])
            and np.nanmax(np.abs(left)) <= max(LEFT_OVER * size[k], limit[k] / 3.0)
        ):
            found.append(k)
    return found


def _same_either_side(part: FloatArray, k: int, size: float) -> bool:
    """Whether the channel goes on after the sample where it was before it: a step does not."""
    if k < 3 or k + 3 >= part.size:
        return True
    across = part[k + 1] - part[k - 1]
    beside = 0.5 * (part[k + 3] - part[k + 1] + part[k - 1] - part[k - 3])
    return not abs(across - beside) > 0.5 * size


def _moves_nearby(part: FloatArray, k: int, channel: Channel) -> bool:
    """Whether an input moves around the sample most of the time: a single pulse out of rest is a hit, not a spike."""
    nearby = np.concatenate([part[max(0, k - BLOCK) : max(0, k - 1)], part[k + 2 : k + BLOCK]])
    low, high = np.nanquantile(nearby, [0.25, 0.75])
    return bool(high - low > HARDLY * channel.std)


def missing_findings(channel: Channel) -> list[Finding]:
    """Missing samples of one channel; a record that did not measure it lacks none.

    An output counts where it was measured, so gaps cost no more than precision; what an input did moves all of them.
    """
    measured = [number for number, part in enumerate(channel.parts) if np.isfinite(part).any()]
    gaps = [(number, *run) for number in measured for run in runs_of(np.isnan(channel.parts[number]))]
    if not gaps:
        return []
    longest = max(stop - start for _, start, stop in gaps)
    spans = tuple(channel.span(*gap) for gap in gaps[:MOST_SPANS])
    share = sum(stop - start for _, start, stop in gaps) / sum(channel.parts[number].size for number in measured)
    several = f"{len(gaps)} gaps of at most" if len(gaps) > 1 else "one gap of"
    is_input = channel.role == "input"
    cost = "the rows they touch are left out" if is_input else "it counts where it was measured"
    more = "; leave the channel out if the others matter more." if is_input and share > SERIOUS else "."
    return [
        channel.finding(
            level="bad" if is_input and share > MOSTLY else "doubtful" if share > SERIOUS else "note",
            what="missing samples",
            sentence=f"{channel.role} {named(channel.name)} lacks {percent(share)} of its samples, in {several} "
            f"{spoken(longest * channel.dt)} s: {cost}{more}",
            spans=spans,
            share=share,
        )
    ]


def gap_findings(records: Sequence[Record]) -> list[Finding]:
    """Gaps of all inputs together, or of outputs that nothing measured drives, that leave few rows of a whole past."""
    n_usable = n_rows = 0
    for record in records:
        there = np.isfinite(record.outputs)
        whole = np.isfinite(record.inputs) if record.n_inputs else there | ~there.any(axis=0)
        complete = np.asarray(whole.all(axis=1), dtype=np.bool_)
        order = min(OBSERVER_ORDER, record.n_samples // 4)
        n_usable += int(usable_rows(complete, order).sum())
        n_rows += record.n_samples - order
    share = n_usable / max(1, n_rows)
    if share >= MOSTLY:
        return []
    return [
        Finding(
            level="bad" if share < HARDLY else "doubtful",
            what="missing samples",
            where=when((), len(records)),
            sentence=f"gaps leave {percent(share)} of the rows with {OBSERVER_ORDER} whole samples before them, which "
            "is what a fit can use: leave out the channels with the most gaps, or fill gaps of a few samples.",
            share=1.0 - share,
        )
    ]


def length_findings(records: Sequence[Record], *, has_coherence: bool) -> list[Finding]:
    """Too few samples for the smallest observer, or for the coherence of inputs and outputs.

    Example:
        >>> [finding.level for finding in length_findings([Record([], [0.0, 1.0, 0.0], 0.1)], has_coherence=False)]
        ['bad']
    """
    first = records[0]
    n_channels = first.n_inputs + first.n_outputs
    n_samples = sum(record.n_samples for record in records)
    n_rows = sum(max(0, record.n_samples - PAST) for record in records)
    n_coefficients = PAST * n_channels + first.n_inputs
    found = []
    if n_rows < ROWS_PER_COEFFICIENT * n_coefficients:
        needed = ROWS_PER_COEFFICIENT * n_coefficients + PAST
        found.append(
            Finding(
                level="bad" if n_rows < n_coefficients else "doubtful",
                what="few samples",
                where="all records",
                sentence=f"{n_samples} samples of {n_channels} channel{'s' * (n_channels > 1)} are "
                f"{'too few to fit anything' if n_rows < n_coefficients else 'few'}: an observer that holds one mode "
                f"has {n_coefficients} coefficients an output; record {needed} samples or more, or leave channels out.",
            )
        )
    if first.n_inputs and not has_coherence:
        n_whole = sum(bool(with_numbers(record.outputs).all()) for record in records)
        each = "" if n_whole == len(records) else "; check each set-up by itself for it"
        found.append(
            Finding(
                level="note",
                what="no coherence",
                where="all records",
                sentence=f"{_why_no_coherence(n_whole, len(records))}: how much of the outputs the inputs explain was "
                f"not looked at{each}.",
            )
        )
    return found


def _why_no_coherence(n_whole: int, n_records: int) -> str:
    """Coherence is that of the records with all outputs: none is there, or they are too short."""
    if n_whole == 0:
        return "no set-up measured every output, so coherence with all of them does not exist"
    if n_whole == n_records:
        return "the records are too short, or have too many gaps, for measured coherence"
    whole = f"{n_whole} set-up{'s' * (n_whole > 1)} of {n_records} measured every output"
    return f"{whole}, too briefly or with too many gaps for measured coherence"
