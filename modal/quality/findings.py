"""What a check of the data says: every finding, and the numbers of each channel."""

from dataclasses import dataclass, field
from typing import Literal

from modal.modes.response_synthesis import MeasuredFrf
from modal.preparation.channel import LEVELS, Finding, Level, Role
from okid.arrays import FloatArray
from okid.display import Displayed


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class ChannelStatistics(Displayed):
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


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class ChannelQuality(Displayed):
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


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class DataQuality(Displayed):
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
        return "No fault was found in the data."


def _number(count: int, what: str) -> str:
    return f"{count} {what}{'s' * (count != 1)}"
