"""The whole check: every look at the records, and what it says: the findings sorted, the numbers of each channel."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from modal.modes.mode import Choice
from modal.modes.response_synthesis import MeasuredFrf, measured_frf_of
from modal.preparation.amplitude import (
    clipping_findings,
    constant_findings,
    repeat_findings,
    resolution_findings,
    resolution_of,
    stuck_findings,
)
from modal.preparation.channel import (
    BLOCK,
    LEVELS,
    NEARLY_ALL,
    Channel,
    Finding,
    Level,
    Role,
    channels_of,
    gap_findings,
    length_findings,
    missing_findings,
    sharp_samples,
    spike_findings,
    spikes_of,
    without_spikes,
)
from modal.quality.channels import (
    HumLines,
    alias_findings,
    drift_findings,
    hum_findings,
    is_steady,
    level_findings,
    mains_lines,
    most_white_noise,
    offset_findings,
    period_findings,
    white_findings,
)
from modal.quality.coherence import Shares, coherence_findings, explained_share, modelled_share
from modal.quality.inputs import (
    copy_findings,
    excitation_findings,
    skew_findings,
    timing_findings,
    together_findings,
)
from okid.arrays import BoolArray, FloatArray, with_numbers
from okid.display import Displayed, table_of_columns
from okid.frequency_response import FEWEST_AVERAGES, AveragedSpectra, averaged_spectra, segment_length
from okid.record import Record
from okid.rows import as_records, refuse_copies
from okid.scaling import channel_scaling

if TYPE_CHECKING:
    import pyarrow as pa


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
        return _worst(self.findings)


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
        return _worst(self.findings)

    def to_table(self) -> "pa.Table":
        """A channel a row, for pandas, polars or a file: `.to_pandas()`, `polars.from_arrow(table)`.

        Returns:
            Columns name, role, unit, level, the numbers of `ChannelStatistics` (in the unit of their row), and
            findings: a list of sentences, the worst first.
        """
        rows = self.channels
        columns: dict[str, tuple[Any, str]] = {
            name: ([getattr(row, name) for row in rows], "") for name in ("name", "role", "unit", "level")
        }
        for each in fields(ChannelStatistics):
            unit = "dB" if each.name == "signal_to_noise" else ""
            columns[each.name] = ([getattr(row.statistics, each.name) for row in rows], unit)
        columns["findings"] = ([[finding.sentence for finding in row.findings] for row in rows], "")
        return table_of_columns(columns)

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


def _worst(findings: Sequence[Finding]) -> Level | Literal["good"]:
    levels = {finding.level for finding in findings}
    return "bad" if "bad" in levels else "doubtful" if "doubtful" in levels else "good"


def _number(count: int, what: str) -> str:
    return f"{count} {what}{'s' * (count != 1)}"


SECONDS_A_VALUE = (4e-7, 1.5e-6)
"""Expect so many CPU seconds a value: 5 s at 1e6 x 8, 31 s at 1e7 x 8."""
FIRST_MODEL = (0.2, 4.0)
"""Expect so many CPU seconds beside them, for a first model of at most 65 536 rows: 0.3 s of 3, 3 s of 16 outputs."""
COPIES, BEFORE_RECORDS = 1.5, 0.25 * 2**30
"""Expect so many copies of the records, and so many bytes beside them: 0.9 GiB at 1e7 x 8."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Spectra:
    """What the records show line by line; empty where they are too short.

    Attributes:
        averaged: the sums; None where no segment is whole.
        frf: None without inputs or with too few segments.
        shares: what the inputs explain of each output.
    """

    averaged: AveragedSpectra | None
    frf: MeasuredFrf | None
    shares: Shares

    @property
    def frequencies(self) -> FloatArray:
        return np.empty(0) if self.averaged is None else self.averaged.frequencies

    def densities(self, n_channels: int) -> FloatArray:
        if self.averaged is None:
            return np.empty((0, n_channels))
        return np.asarray(self.averaged.power * self.averaged.to_density, dtype=np.float64)


@dataclass(slots=True, eq=False)
class _Inputs:
    """What an output's findings need to know of the inputs, filled as these are looked at."""

    sharp: tuple[BoolArray, ...]
    lines: list[HumLines]
    steady: list[bool]


def expected_check(records: Sequence[Record]) -> tuple[tuple[float, float], float]:
    """CPU seconds, least and most, and bytes that a check with a first model will take, about.

    Example:
        >>> seconds, n_bytes = expected_check([Record([], np.zeros((4000, 2)), 0.01)])
        >>> seconds[1] < 5, f"{n_bytes / 2**30:.2f} GiB"
        (True, '0.25 GiB')
    """
    values = sum(one.n_samples for one in records) * (records[0].n_inputs + records[0].n_outputs)
    least, most = (beside + seconds * values for beside, seconds in zip(FIRST_MODEL, SECONDS_A_VALUE, strict=True))
    return (least, most), BEFORE_RECORDS + COPIES * values * np.dtype(float).itemsize


def check_quality(records: Record | Sequence[Record], *, choices: Sequence[Choice] = ()) -> DataQuality:
    """Look at the records as a test engineer would before anything is fitted to them.

    Every channel is looked at by itself (dead, stuck, clipped, coarse, spikes, gaps, offset, hum, level), then the
    channels against each other (copies, coherence, delays, drift, inputs that cannot be told apart). Nothing has to be
    set; a few neighbouring channels are in memory at a time, a mapped file stays where it is.

    Args:
        records: one record or several of one system.
        choices: what was chosen for them (`Identification.choices`): of outputs that are late by parts of a sample only
            a first model tells, which `modal-report check` makes, too.

    Raises:
        InvalidDataError: records that do not belong together, or copies of one another.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> force = rng.standard_normal(4000)
        >>> tip = np.convolve(force, [0.0, 1.0, 1.6, 1.5, 0.8])[:4000]
        >>> record = Record(force, np.clip(tip, -3.0, 3.0), 0.01, input_names=["force"], output_names=["tip"])
        >>> quality = check_quality(record)
        >>> quality.level, [(finding.what, finding.channels) for finding in quality.findings]
        ('bad', [('clipped', ('tip',))])
    """
    several = as_records(records)
    refuse_copies(several)
    first = several[0]
    scaling = channel_scaling(several)
    standing = _standing(several)
    spectra = _spectra(standing)
    densities = spectra.densities(first.n_inputs + first.n_outputs)
    n_samples = [record.n_samples for record in several]
    known = _Inputs(tuple(np.zeros(n, dtype=np.bool_) for n in n_samples), [], [])
    findings: list[Finding] = []
    statistics: list[ChannelStatistics] = []
    for number, channel in enumerate(channels_of(several, scaling)):
        resolution = resolution_of(channel)
        density = densities[:, number]
        findings += _channel_findings(channel, several, known, resolution=resolution)
        explained = float(spectra.shares.explained[channel.index]) if channel.role == "output" else float("nan")
        statistics.append(_statistics(channel, resolution, spectra.frequencies, density, explained))
    findings += _findings_together(standing, spectra, densities, findings)
    findings += skew_findings(first, choices)
    findings.sort(key=lambda finding: LEVELS.index(finding.level))
    return DataQuality(
        channels=_channels(first, statistics, findings),
        findings=tuple(findings),
        coherence=spectra.frf,
        frequencies=spectra.frequencies,
        densities=densities,
    )


def _standing(records: Sequence[Record]) -> list[Record]:
    """The records with outputs that none of them measured at 0, as dead ones stand: they are no gaps of others."""
    seen = np.any([with_numbers(record.outputs) for record in records], axis=0)
    if seen.all():
        return list(records)
    return [replace(record, outputs=np.where(seen, record.outputs, 0.0)) for record in records]


def _channel_findings(
    channel: Channel, records: Sequence[Record], known: _Inputs, *, resolution: float
) -> list[Finding]:
    """Of one channel by itself; what an input shows is kept for the outputs, which come after all inputs."""
    lines = mains_lines(channel)
    found = [
        *constant_findings(channel),
        *missing_findings(channel),
        *stuck_findings(channel, records, resolution),
    ]
    limited = without_spikes(channel, spikes_of(channel, resolution, known.sharp)[0])
    clipped = clipping_findings(limited)
    if clipped:  # the runs at the limit are those
        found = [finding for finding in found if finding.what != "stuck"]
    found += [*repeat_findings(channel), *clipped, *resolution_findings(channel, resolution)]
    found += spike_findings(channel, resolution, known.sharp)
    found += [*offset_findings(channel), *hum_findings(channel, lines, known.lines)]
    found += level_findings(channel, known.steady)
    if channel.role == "input":
        known.lines.append(lines)
        known.steady.append(is_steady(channel))
        sharp = sharp_samples(channel)
        known.sharp = tuple(mask | more for mask, more in zip(known.sharp, sharp, strict=True))
    return found


def _findings_together(
    records: Sequence[Record], spectra: _Spectra, densities: FloatArray, found: Sequence[Finding]
) -> list[Finding]:
    """Of channels against each other; what is dead or copied is not judged twice."""
    first = records[0]
    more = length_findings(records, has_coherence=spectra.frf is not None)
    more += [*gap_findings(records), *copy_findings(records), *excitation_findings(records)]
    useless = {finding.channel for finding in found if finding.what in {"constant", "white noise"}}
    more += [f for f in white_findings(records, spectra.shares.explained) if f.channel not in useless]
    useless |= {finding.channel for finding in more if finding.what == "white noise"}
    moving = [i for i, name in enumerate(first.output_names) if name not in useless]
    if spectra.averaged is not None:
        output_densities = densities[:, first.n_inputs :]
        more += alias_findings(first, spectra.frequencies, output_densities)
        more += period_findings(records)
        more += together_findings(first, spectra.averaged, spectra.frf)
        if spectra.frf is not None:
            power = spectra.averaged.power[:, first.n_inputs :]
            more += coherence_findings(records, spectra.frf, power, spectra.shares, moving)
    return [*more, *timing_findings(records, moving), *drift_findings(records)]


def _spectra(records: Sequence[Record]) -> _Spectra:
    """Of segments of two lengths those that explain more, and a pulse response where neither explains enough."""
    first = records[0]
    unknown = np.full(first.n_outputs, np.nan)
    best: _Spectra | None = None
    # without inputs there is no coherence to average for, and fine lines show more than smooth ones
    for averages in (32, FEWEST_AVERAGES) if first.n_inputs else (FEWEST_AVERAGES,):  # chance then gives 2 % an input
        length = min(8192, segment_length(records, averages=averages))  # its lines are finer than any mode
        if best is not None and best.averaged is not None and length <= 2 * (len(best.frequencies) - 1):
            continue
        averaged = averaged_spectra(records, n_per_segment=length)
        if averaged.n_averages == 0:
            continue
        frf, explained = None, unknown
        if first.n_inputs and averaged.n_averages >= max(FEWEST_AVERAGES, 4 * first.n_inputs):
            frf = measured_frf_of(averaged)
        if frf is not None and length >= BLOCK:
            explained = explained_share(frf, averaged.power[:, first.n_inputs :])
        found = _Spectra(averaged=averaged, frf=frf, shares=Shares(spectra=explained, modelled=unknown))
        too_coarse = best is not None and len(best.frequencies) <= BLOCK // 2
        if best is None or too_coarse or np.nansum(explained) > np.nansum(best.shares.spectra):
            best = found
        if length >= BLOCK and (first.n_inputs == 0 or (explained >= NEARLY_ALL).all()):
            break
    if best is None:
        return _Spectra(averaged=None, frf=None, shares=Shares(spectra=unknown, modelled=unknown))
    if first.n_inputs and not (best.shares.spectra >= NEARLY_ALL).all():
        shares = Shares(spectra=best.shares.spectra, modelled=modelled_share(records))
        return replace(best, shares=shares)
    return best


def _statistics(
    channel: Channel, resolution: float, frequencies: FloatArray, density: FloatArray, explained: float
) -> ChannelStatistics:
    floor = most_white_noise(frequencies, density) if frequencies.size else float("nan")
    with np.errstate(divide="ignore"):
        ratio = float(20.0 * np.log10(np.float64(channel.std) / floor)) if floor > 0.0 and channel.std > 0.0 else np.nan
    return ChannelStatistics(
        n_samples=channel.n_samples,
        n_missing=channel.n_missing,
        mean=channel.mean,
        std=channel.std,
        smallest=channel.smallest,
        largest=channel.largest,
        resolution=resolution,
        noise_floor=floor,
        signal_to_noise=max(0.0, ratio) if np.isfinite(ratio) else float("nan"),
        explained=explained,
    )


def _channels(
    record: Record, statistics: Sequence[ChannelStatistics], findings: Sequence[Finding]
) -> tuple[ChannelQuality, ...]:
    names = (*record.input_names, *record.output_names)
    units = (*record.input_units, *record.output_units)
    return tuple(
        ChannelQuality(
            name=name,
            role="input" if number < record.n_inputs else "output",
            unit=unit,
            statistics=numbers,
            findings=tuple(finding for finding in findings if name in finding.channels),
        )
        for number, (name, unit, numbers) in enumerate(zip(names, units, statistics, strict=True))
    )
