"""The numbers of a diagnosis as report and recording show them.

Names and values as written: effects without underscores, values to the digits they have. The gap before, in between and
after, cut once by output, band and level for every page that shows it, the spectra of gap, measured output and noise,
and the modes against level.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from modal.discrepancy.results import (
    Calibrated,
    DetectionLimit,
    Diagnosis,
    Finding,
    Hypothesis,
    LawCurve,
    Parameter,
    Step,
    changed_masses,
    masses_text,
)
from modal.effects.catalogue import CATALOGUE, effect_name
from modal.effects.effect import InputEffect
from modal.localisation.gap import Gap, measure_gap
from modal.localisation.levels import LevelMode, LevelModes
from modal.simulation import NEAR_FLOOR
from modal.simulation.assembly import MOST
from modal.wording.text import NINETY_FIVE, listed, number
from okid.arrays import FloatArray
from okid.record import Record

NAMED_WITHIN = math.sqrt(NEAR_FLOOR)
"""Times the noise floor (root mean square) within which a model explains the data and an effect may be named."""

effect_text = effect_name


def hypothesis_text(hypothesis: Hypothesis) -> str:
    """What a hypothesis has that the calibrated model has not: effects and other masses, or "no effect"."""
    masses = masses_text(hypothesis.masses)
    if not hypothesis.effects:
        return masses or effects_text(())
    return f"{effects_text(hypothesis.effects)}{f' and {masses}' if masses else ''}"


def effects_text(effects: Sequence[tuple[str, str]]) -> str:
    """A set of effects, each with its place, said once where it is the same; "no effect" for the empty one.

    Example:
        >>> effects_text([("cubic_stiffness", "element_1"), ("input_delay", "force")]), effects_text([])
        ('cubic stiffness at element_1 and input delay at force', 'no effect')
        >>> effects_text([("cubic_stiffness", "element_1"), ("coulomb_friction", "element_1")])
        'cubic stiffness and Coulomb friction at element_1'
    """
    if not effects:
        return "no effect"
    places = {where for _, where in effects}
    if len(places) == 1:
        return f"{listed([effect_text(effect) for effect, _ in effects])} at {places.pop()}"
    return listed([f"{effect_text(effect)} at {where}" for effect, where in effects])


def step_text(name: str) -> str:
    """The name of a step in words.

    Example:
        >>> step_text("cubic_stiffness at element_1"), step_text("as given")
        ('+ cubic stiffness at element_1', 'as given')
    """
    effect, _, where = name.partition(" at ")
    return f"+ {effect_text(effect)} at {where}" if where else name


def times_floor(level: float) -> float:
    """Root mean square over that of the noise, from a mean square in units of the floor; nan where it is not known."""
    return math.sqrt(level) if 0.0 <= level < math.inf else math.nan


def times_text(size: float) -> str:
    """Times the noise floor, to three digits; a dash where it is not known.

    Example:
        >>> times_text(1.0236), times_text(425.37), times_text(61234.0), times_text(float("nan"))
        ('1.02', '425', '61200', '–')
    """
    if not math.isfinite(size):
        return "–"
    if size >= 100.0:
        return f"{float(f'{size:.3g}'):.0f}"
    return f"{size:#.3g}" if size >= 0.01 else f"{size:.1g}"


def value_text(value: float, std: float = math.nan) -> str:
    """Value ± standard deviation, to the second digit of the deviation; a common power of ten where that is shorter.

    Example:
        >>> value_text(0.2481, 0.0011), value_text(403000.0, 4100.0), value_text(0.009998, 4.6e-6)
        ('0.2481 ± 0.0011', '(4.030 ± 0.041)e5', '(9.9980 ± 0.0046)e-3')
        >>> value_text(0.0), value_text(12.3456)
        ('0', '12.35')
    """
    if not math.isfinite(value):
        return "–"
    if not (math.isfinite(std) and std > 0.0):
        return number(value, 4)
    power, digits = _written(value, std)
    if power == 0:
        return f"{value:.{digits}f} ± {std:.{digits}f}"
    return f"({value / 10.0**power:.{digits}f} ± {std / 10.0**power:.{digits}f})e{power}"


def _written(value: float, std: float) -> tuple[int, int]:
    """Power of ten, 0 for a plain number, and decimals to the second digit of the deviation."""
    power = math.floor(math.log10(max(abs(value), std)))
    digits = max(0, 1 - math.floor(math.log10(std)))
    if -4 < power < 5 and digits <= 6:  # more stand after a power of ten
        return 0, digits
    return power, max(0, 1 - math.floor(math.log10(std / 10.0**power)))


def found_value(one: Parameter) -> str:
    """A parameter as found; one without a deviation was held, unless each record has a value of its own.

    Example:
        >>> found_value(Parameter(name="k_in", value=0.0, std=math.nan, unit="N/m"))
        '0, held'
        >>> found_value(Parameter(name="Fc", value=0.2, std=0.01, unit="N"))
        '0.200 ± 0.010'
        >>> found_value(Parameter(name="a", value=0.0, std=0.0, unit="N/m"))  # a fit that went to nothing
        '0'
    """
    held = math.isnan(one.std) and "over the records" not in one.meaning
    return f"{value_text(one.value)}, held" if held else value_text(one.value, one.std)


def beside_text(value: float, fitted: float, std: float) -> str:
    """A value as it was given, written as the fitted one beside it is.

    Example:
        >>> beside_text(0.00093, 0.0012406, 7e-7), beside_text(400.0, 403.21, 0.6), beside_text(0.0, 2e-7, 1e-9)
        ('0.93e-3', '400', '0')
    """
    if not (math.isfinite(std) and std > 0.0 and math.isfinite(fitted)):
        return number(value, 4)
    power, _ = _written(fitted, std)
    scaled = value / 10.0**power
    text = f"{scaled:.6f}".rstrip("0").rstrip(".") if 1e-3 <= abs(scaled) < 1e6 else number(value, 4)
    return f"{text}e{power}" if power and 1e-3 <= abs(scaled) < 1e6 else text


def interval_text(value: float, std: float) -> str:
    """The 95 % interval of a value, a dash where its deviation is not known.

    Example:
        >>> interval_text(0.2481, 0.0011), interval_text(403000.0, 4100.0)
        ('0.2459 to 0.2503', '(3.950 to 4.110)e5')
    """
    if not (math.isfinite(value) and math.isfinite(std) and std > 0.0):
        return "–"
    power, digits = _written(value, std)
    text = " to ".join(f"{(value + side * std) / 10.0**power:.{digits}f}" for side in (-NINETY_FIVE, NINETY_FIVE))
    return f"({text})e{power}" if power else text


def size_text(value: float) -> str:
    """A size in the unit of its channel, to three digits; "unbounded" where the model ran away.

    Example:
        >>> size_text(0.0042071), size_text(1.2e-5), size_text(float("inf"))
        ('0.00421', '1.20e-5', 'unbounded')
    """
    return number(value) if math.isfinite(value) else "unbounded"


def closed_share(closed: float) -> float:
    """Share of the gap above the noise that is gone, as a root mean square, from that of the mean square.

    Example:
        >>> closed_share(0.75), closed_share(-3.0)
        (0.5, 0.0)
    """
    return 1.0 - math.sqrt(1.0 - min(max(closed, 0.0), 1.0)) if math.isfinite(closed) else math.nan


def levels_in_words(hypothesis: Hypothesis) -> str:
    """What a hypothesis leaves on held-out data, in words."""
    size = times_floor(hypothesis.held_out_level)
    if not math.isfinite(size):
        return "does not run through the held-out records"
    return f"leaves {times_text(size)} times the noise floor on held-out data"


def found_hypothesis(diagnosis: Diagnosis) -> Hypothesis | None:
    """The hypothesis that the diagnosis settled on, among those that were fitted; None where it settled on none.

    A hypothesis lists all effects of its model, those that the given model had already among them; the shortest one is
    the given model itself.
    """
    if not diagnosis.findings and diagnosis.status != "none":
        return None
    known = min((one.effects for one in diagnosis.hypotheses), key=len, default=())
    found = sorted([*known, *((finding.effect, finding.where) for finding in diagnosis.findings)])
    masses = sorted(changed_masses(diagnosis))
    alike = [one for one in diagnosis.hypotheses if sorted(one.effects) == found]
    return next((one for one in alike if sorted(one.masses) == masses), None)


def found_word(diagnosis: Diagnosis) -> str:
    """What to call the hypothesis that the diagnosis settled on."""
    return {"named": "found", "none": "enough", "unresolved": "best guess"}[diagnosis.status]


def law_against(law: LawCurve) -> str:
    """What a law is drawn against, with its unit: "displacement [m]"."""
    return f"{law.against} [{law.motion_unit}]" if law.motion_unit else law.against


def law_gives(law: LawCurve) -> str:
    """What a law gives, with its unit: "force [N]"; of an input or a sensor the changed signal."""
    if law.against == "time" and law.effect.startswith("sensor"):
        what = "added to the reading"
    else:
        what = {"input": "input after the effect", "output": "reading"}.get(law.against, "force")
    return f"{what} [{law.force_unit}]" if law.force_unit else what


def signed_change(item: Calibrated) -> float:
    """Relative change of a calibrated parameter, nan where the nominal value is 0."""
    return item.value / item.nominal - 1.0 if item.nominal else math.nan


def value_with_unit(text: str, item: Parameter | Calibrated | DetectionLimit) -> str:
    """A value and its unit."""
    return f"{text} {item.unit}" if item.unit else text


def parameters_text(finding: Finding) -> str:
    """All parameters of a finding: "k3 = (4.03 ± 0.04)e5 N/m^3"."""
    return ", ".join(f"{one.name} = {value_with_unit(found_value(one), one)}" for one in finding.parameters)


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
