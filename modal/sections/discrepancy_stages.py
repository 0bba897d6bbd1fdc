"""The gap of a diagnosis before, in between and after, cut once by output, band and level for every page that shows it.

With it the spectra of gap, measured output and noise, and the modes against level, as report and recording draw them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from modal.discrepancy.results import Diagnosis, Step
from modal.effects.catalogue import CATALOGUE
from modal.effects.effect import InputEffect
from modal.localisation.gap import Gap, measure_gap
from modal.localisation.levels import LevelMode, LevelModes
from modal.simulation.assembly import MOST
from modal.wording.text import number
from okid.arrays import FloatArray
from okid.record import Record

Part = Literal["output", "record", "band"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Stage:
    """The held-out gap of one state of the model.

    Attributes:
        name: as a reader calls it: "as given", "calibrated", "with cubic stiffness".
        kind: "before" (the model as given), "linear" (calibrated, no effect added), or "after".
        step: its number among the steps, from 0.
        gap: on the held-out records.
    """

    name: str
    kind: Literal["before", "linear", "after"]
    step: int
    gap: Gap


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Row:
    """A part of the held-out data, before and after; each number is a root mean square over the noise floor's.

    Attributes:
        part: what it is a part by.
        name: which one.
        sizes: one a stage.
    """

    part: Part
    name: str
    sizes: tuple[float, ...]


def held_out_floor(diagnosis: Diagnosis) -> FloatArray:
    """(n_held_out, n_outputs) variance of the noise of the held-out records."""
    variance: FloatArray = np.asarray(diagnosis.noise_floor.variance)[len(diagnosis.fit) :]
    return variance


def stages_of(diagnosis: Diagnosis) -> tuple[Stage, ...]:
    """The model as given, calibrated, and as found, each with its gap; those that did not run through are left out."""
    last = len(diagnosis.steps) - 1
    chosen = {0: "before", last: "after"}
    for index, step in enumerate(diagnosis.steps):
        if step.name == "calibrated" and index not in chosen:
            chosen[index] = "linear"
    return tuple(
        Stage(name=_stage_name(diagnosis, index), kind=kind, step=index, gap=gap_of(diagnosis, step))  # type: ignore[arg-type]  # kind is one of the three words above
        for index, kind in sorted(chosen.items())
        if ran_through(step := diagnosis.steps[index])
    )


def ran_through(step: Step) -> bool:
    """Whether every simulated sample is a number: a model that escapes has none from some time on, or no run at all."""
    return bool(step.simulated) and all(bool(np.isfinite(values).all()) for values in step.simulated)


def gap_of(diagnosis: Diagnosis, step: Step) -> Gap:
    """The held-out gap of a step, where the drive that the outputs answer lies within the record."""
    simulated = [
        replace(record, outputs=values) for record, values in zip(diagnosis.held_out, step.simulated, strict=True)
    ]
    return measure_gap([_heard(diagnosis, one) for one in diagnosis.held_out], simulated, held_out_floor(diagnosis))


def _heard(diagnosis: Diagnosis, record: Record) -> Record:
    """The record without the outputs that answer a drive before its start or after its end, for what delays it."""
    outputs, n = record.outputs.copy(), record.n_samples
    for one in diagnosis.findings:
        effect = CATALOGUE.get(one.effect)
        if isinstance(effect, InputEffect):
            early, late = (
                min(count, n // MOST) for count in effect.unheard([p.value for p in one.parameters], record.dt)
            )
            outputs[:early] = outputs[n - late :] = np.nan
    return replace(record, outputs=outputs)


def worst_outputs(gap: Gap, most: int) -> list[int]:
    """The outputs with the greatest gap in units of the floor, at most so many, in the order of the record."""
    size = np.nan_to_num(gap.in_floors.mean(axis=0))
    return sorted(np.argsort(-size, kind="stable")[:most].tolist())


def rows_of(stages: Sequence[Stage]) -> tuple[Row, ...]:
    """The gap by output, by record (quiet ones first) and by frequency band, all in units of the floor."""
    if not stages:
        return ()
    first = stages[0].gap
    rows = [
        Row(part="output", name=name, sizes=tuple(_root(stage.gap.in_floors[:, i].mean()) for stage in stages))
        for i, name in enumerate(first.output_names)
    ]
    for i in np.argsort(first.levels, kind="stable").tolist():
        name = record_name(first.measured[i], i)
        rows.append(
            Row(part="record", name=name, sizes=tuple(_root(stage.gap.in_floors[i].mean()) for stage in stages))
        )
    for i, band in enumerate(first.bands.bands):
        if (first.bands.n_lines[:, i] > 0).any():
            rows.append(Row(part="band", name=band.name, sizes=tuple(_band_size(stage.gap, i) for stage in stages)))
    return tuple(rows)


def record_name(record: Record, number: int) -> str:
    """What a held-out record is called."""
    return record.name or f"held-out record {number + 1}"


def _stage_name(diagnosis: Diagnosis, number: int) -> str:
    name = diagnosis.steps[number].name
    if number == len(diagnosis.steps) - 1 and diagnosis.findings:
        return "with the effect" if len(diagnosis.findings) == 1 else "with the effects"
    return name


def _band_size(gap: Gap, band: int) -> float:
    """Over all records and outputs, each output in units of its own floor in the band."""
    power, floor = gap.bands.power[:, band], gap.bands.floor[:, band]
    there = np.isfinite(power) & (floor > 0.0)
    return _root(float(np.mean(power[there] / floor[there]))) if there.any() else float("nan")


def _root(value: float) -> float:
    return float(np.sqrt(value)) if value >= 0.0 else float("nan")


def power_spectra(records: Sequence[Record], *, n_segment: int | None = None) -> tuple[FloatArray, FloatArray]:
    """One-sided power spectral density of each output, averaged over records (Welch, doi 10.1109/TAU.1967.1161901).

    Args:
        records: of one system, one time step; a missing sample counts as the mean of its channel.
        n_segment: samples in a window; an eighth of the longest record, 64 to 2048, unless given.

    Returns:
        (n_frequencies,) [Hz] and (n_frequencies, n_outputs) [unit^2/Hz].
    """
    dt = records[0].dt
    longest = max(record.n_samples for record in records)
    size = n_segment or int(np.clip(longest // 8, 64, 2048))
    size = min(size, *(record.n_samples for record in records))
    window = np.hanning(size + 2)[1:-1]
    power = np.zeros((size // 2 + 1, records[0].n_outputs))
    n_windows = 0
    for record in records:
        mean = np.nan_to_num(np.nanmean(record.outputs, axis=0))
        for start in range(0, record.n_samples - size + 1, max(1, size // 2)):
            segment = np.nan_to_num(record.outputs[start : start + size] - mean)
            power += np.abs(np.fft.rfft(segment * window[:, None], axis=0)) ** 2
            n_windows += 1
    power *= 2.0 * dt / (n_windows * np.sum(window**2))
    return np.asarray(np.fft.rfftfreq(size, dt), dtype=np.float64), power


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class GapDensity:
    """One-sided power spectral densities, mean over the held-out records, without the line at zero frequency.

    Attributes:
        frequency: (n_frequencies,) [Hz].
        measured: (n_frequencies, n_outputs) of the measured outputs [unit^2/Hz].
        gaps: one (n_frequencies, n_outputs) a state of the model.
        noise: (n_outputs,) of white noise of the floor's variance.
    """

    frequency: FloatArray
    measured: FloatArray
    gaps: tuple[FloatArray, ...]
    noise: FloatArray

    def span(self, output: int) -> tuple[float, float]:
        """What the axis of an output's density should reach: from below the noise to above all there is."""
        parts = [self.measured[:, output], *(gap[:, output] for gap in self.gaps)]
        top = max([float(self.noise[output]), *(float(part.max(initial=0.0)) for part in parts)])
        return float(self.noise[output]) / 12.0, 4.0 * top


def gap_density(gaps: Sequence[Gap]) -> GapDensity:
    """Densities by Welch's method with windows of a quarter of the longest record."""
    records = gaps[0].measured
    n_segment = int(np.clip(max(record.n_samples for record in records) // 4, 64, 4096))
    frequency, measured = power_spectra(records, n_segment=n_segment)
    densities = tuple(power_spectra(_as_records(gap), n_segment=n_segment)[1][1:] for gap in gaps)
    rows = np.array([record.n_samples for record in records], dtype=np.float64)
    return GapDensity(
        frequency=frequency[1:],
        measured=measured[1:],
        gaps=densities,
        noise=2.0 * records[0].dt * (rows @ gaps[0].floor) / rows.sum(),
    )


def _as_records(gap: Gap) -> list[Record]:
    return [Record(np.empty((len(values), 0)), values, gap.measured[0].dt) for values in gap.residuals]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LevelLine:
    """One mode over the levels at which it was found.

    Attributes:
        name: "mode 1, 3.18 Hz", or "pole 1, 2.64 Hz" for one of first order.
        levels: (n,) of the excitation, relative to the loudest record.
        change: (n,) of the frequency from the lowest of these levels [%].
        change_std: (n,) standard deviation of each frequency [%].
        damping: (n,) damping ratio [%]; nan for a pole of first order.
        damping_std: (n,) its standard deviation [%].
    """

    name: str
    levels: FloatArray
    change: FloatArray
    change_std: FloatArray
    damping: FloatArray
    damping_std: FloatArray


def level_lines(diagnosis: Diagnosis) -> tuple[LevelLine, ...]:
    """The modes of the records to fit that are known to move with level, or known to stay.

    Returns:
        None where measurement and simulation agree anyway, or no mode is known well enough.
    """
    location = diagnosis.location
    modes: LevelModes | None = getattr(location, "modes", None)
    if modes is None or location.agrees:
        return ()
    chosen = [mode for mode in modes.modes if telling(mode)]
    return tuple(_line(mode, modes.levels) for mode in chosen[:5])


def telling(mode: LevelMode) -> bool:
    """Whether something is known of how a mode moves with level."""
    return mode.frequency_tendency != "unknown" or mode.damping_tendency != "unknown"


def _line(mode: LevelMode, levels: FloatArray) -> LevelLine:
    found = np.isfinite(mode.frequencies)
    frequency, deviation = mode.frequencies[found], mode.frequency_stds[found]
    damping, spread = mode.damping_ratios[found], mode.damping_ratio_stds[found]
    real = mode.kind == "real"
    return LevelLine(
        name=f"{'pole' if real else 'mode'} {mode.number}, {number(float(frequency[0]))} Hz",
        levels=levels[found],
        change=100.0 * (frequency / frequency[0] - 1.0),
        change_std=100.0 * deviation / frequency[0],
        damping=np.full(damping.shape, np.nan) if real else 100.0 * damping,
        damping_std=np.full(damping.shape, np.nan) if real else 100.0 * spread,
    )
