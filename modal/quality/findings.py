"""What a look at the data finds: one sentence a finding, one row a channel."""

from dataclasses import dataclass, field
from typing import Literal

from modal.modes.response_synthesis import MeasuredFrf
from okid.arrays import FloatArray

__all__ = ["LEVELS", "ChannelQuality", "ChannelStatistics", "DataQuality", "Finding", "Level", "Role", "Span"]

Level = Literal["bad", "doubtful", "note"]
"""bad: what is found spoils a result; doubtful: look at it before believing one; note: good to know."""

LEVELS: tuple[Level, ...] = ("bad", "doubtful", "note")

Role = Literal["input", "output"]

Span = tuple[int, float, float]
"""Index of a record, and from when to when in its own time [s]."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Finding:
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
class ChannelStatistics:
    """Numbers of one channel over all records, in its own unit.

    Attributes:
        n_samples: rows.
        n_missing: of them without a number.
        mean: of the samples that are there.
        std: their standard deviation.
        smallest: least value.
        largest: greatest value.
        resolution: distance of neighbouring levels where the values lie on a grid (a converter's or a file's last
            digit), nan where they do not.
        noise_floor: standard deviation that broadband noise can have at most: the spectrum nowhere lies below it; nan
            for a record that is too short.
        signal_to_noise: power of the channel over the power of that noise, at least [dB].
        explained: share of an output's power that the inputs explain (power-weighted multiple coherence); nan for an
            input, without inputs, or where it cannot be estimated.
    """

    n_samples: int
    n_missing: int
    mean: float
    std: float
    smallest: float
    largest: float
    resolution: float
    noise_floor: float
    signal_to_noise: float
    explained: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ChannelQuality:
    """One channel: its numbers and what was found in it.

    Attributes:
        name: of the channel.
        role: "input" or "output".
        unit: "" where unknown.
        statistics: over all records.
        findings: those that name this channel, the worst first.
    """

    name: str
    role: Role
    unit: str
    statistics: ChannelStatistics
    findings: tuple[Finding, ...]

    @property
    def level(self) -> Level | Literal["good"]:
        """The worst level among the findings; "good" where nothing but notes was found."""
        levels = {finding.level for finding in self.findings}
        return "bad" if "bad" in levels else "doubtful" if "doubtful" in levels else "good"


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DataQuality:
    """What records are good for, before anything is fitted to them.

    Attributes:
        channels: inputs, then outputs, in the order of the records.
        findings: all of them, the worst first.
        coherence: frequency response and coherences from the records alone; None without inputs, or where the records
            are too short for it.
        frequencies: (n_frequencies,) [Hz] of `densities`; empty where the records are too short.
        densities: (n_frequencies, n_channels) power spectral density, inputs first [unit^2/Hz].
    """

    channels: tuple[ChannelQuality, ...]
    findings: tuple[Finding, ...]
    coherence: MeasuredFrf | None
    frequencies: FloatArray = field(repr=False)
    densities: FloatArray = field(repr=False)

    @property
    def level(self) -> Level | Literal["good"]:
        """The worst level among the findings; "good" where nothing but notes was found."""
        levels = {finding.level for finding in self.findings}
        return "bad" if "bad" in levels else "doubtful" if "doubtful" in levels else "good"

    @property
    def verdict(self) -> str:
        """One sentence over all findings."""
        counts = {level: sum(finding.level == level for finding in self.findings) for level in LEVELS}
        if counts["bad"]:
            rest = f", and {_number(counts['doubtful'], 'doubtful point')}" if counts["doubtful"] else ""
            return f"The data have {_number(counts['bad'], 'bad fault')}{rest}: mend them before a result is believed."
        if counts["doubtful"]:
            return f"The data have no bad fault, but {_number(counts['doubtful'], 'doubtful point')} to look at."
        return "Nothing is wrong with the data as far as they show it themselves."


def _number(count: int, what: str) -> str:
    return f"{count} {what}{'s' * (count != 1)}"
