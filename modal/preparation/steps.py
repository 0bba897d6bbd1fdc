"""What is done to the records before anything is fitted: gaps, means, band, integrators, input delays, drift."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from era.realisation import Realisation
from modal.modes.mode import Choice, ModalModel
from modal.modes.skew import Skew, on_time, rows_on_time, turned_back
from modal.preparation.band import coherent_band
from modal.preparation.delay import (
    InputDelay,
    acting_at_once,
    check_delay_word,
    choose_input_delay,
    given_input_delay,
    late_and_early,
    late_inputs,
    with_input_delay,
    with_lead,
)
from modal.preparation.drift import (
    FreedTrials,
    choose_drift,
    given_drift,
    integrator_drift,
    summed_inputs,
    without_drift,
)
from modal.preparation.faults import Mended, mended, no_finer_than_sensors
from modal.preparation.filling import Filling, fill_where_needed, holds_filled
from modal.preparation.hum import lines_beside_blows, lines_beside_forces
from modal.preparation.integrators import choose_integrators, driven_by_inputs, given_integrators, with_integrators
from modal.preparation.kind import RecordKind, acts
from modal.preparation.lines import MachineLines, machine_lines
from modal.preparation.quick_model import choose_skew
from modal.preparation.rest import Rested, with_rest
from okid.arrays import BoolArray, FloatArray, whole_number
from okid.errors import InsufficientDataError, InvalidDataError
from okid.record import Record, filter_half_length
from okid.rows import runs_of

FEWEST_SAMPLES = 40
"""One block that always trains and one for each of three folds."""
SHORTEST = 50
"""Samples between two input gaps from which on a stretch is worth an initial state of its own."""
SHORTEST_SHARE = 0.02
"""Of the record's longest stretch: a shorter one tells next to nothing, but would limit decimation."""
_MEAN = Choice(what="mean", value="removed", reason="the model describes motion about the mean of each channel")
MOSTLY_KEPT = 0.5
"""Decimate where so large a share of what is left of each output is made of measured samples alone."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Preparation:
    """Records ready for the observer fit, and what the model needs back to be driven by the inputs as they were.

    Attributes:
        mended: the records that came, without what is no measurement.
        records: what is fitted: inputs late, summed and free of drift where that was chosen.
        as_measured: the same rows with the inputs as they came, less mean and drift: what `complete` is driven by.
        input_delay: (n_inputs,) samples by which each input acts late, below zero early.
        n_integrators: how often the system sums its inputs.
        n_slow_functions: what was taken off each channel besides its mean.
        skew: how late outputs of `records` were, of which whole samples were taken off.
        choices: all of it, with reasons.
        warnings: what the user must read before believing a number.
        measured: (n_samples, n_outputs) of each of the records, False where a sample was filled.
        measured_share: of the output samples given that are used; the others were filled.
        n_rest: rows of rest in front of each of the records, which were not measured.
        at_rest: (n_records, n_inputs) variances of the inputs' noise where a force window took it off; else zeros.
    """

    mended: tuple[Record, ...]
    records: tuple[Record, ...]
    as_measured: tuple[Record, ...]
    input_delay: tuple[int, ...]
    n_integrators: int
    n_slow_functions: int
    skew: Skew
    choices: tuple[Choice, ...]
    warnings: tuple[str, ...]
    measured: tuple[BoolArray, ...]
    measured_share: float
    n_rest: tuple[int, ...]
    at_rest: FloatArray

    @property
    def measured_if_filled(self) -> tuple[BoolArray, ...]:
        """`measured` if samples of driven outputs were filled, which tell nothing; else nothing."""
        driven = self.records[0].n_inputs > 0
        return self.measured if driven and holds_filled(self.records, self.measured) else ()

    @property
    def white_at_rest(self) -> FloatArray:
        """`at_rest` where that noise is white and nothing stands in other rows; not decimated, nor less a drift."""
        white = self.records[0].dt < 1.5 * self.mended[0].dt and not self.n_slow_functions
        return self.at_rest if white else np.zeros_like(self.at_rest)

    @property
    def n_values(self) -> int:
        """Output samples that a model is fitted to: in whole rows, or where they were measured; none of rest."""
        there = self.measured_if_filled or [
            np.repeat(one.complete_rows()[:, np.newaxis], one.n_outputs, axis=1) for one in self.records
        ]
        return sum(int(own[n:].sum()) for own, n in zip(there, self.n_rest, strict=True))

    def complete(self, realisation: Realisation) -> Realisation:
        """The model fitted to `records` with integrators and delays as states, driven by the inputs as measured.

        The first states stay those of the model; without integrators and delays it is the model itself.
        """
        return with_input_delay(with_integrators(realisation, self.n_integrators), self.input_delay)

    def modes_of(self, modes: ModalModel) -> ModalModel:
        """Modes fitted to `records`, driven by the inputs as measured, with shapes as of outputs on time."""
        return turned_back(
            acting_at_once(driven_by_inputs(modes, self.n_integrators), self.input_delay), self.skew.rest
        )


def prepare(
    records: Sequence[Record],
    *,
    decimation: int | Literal["auto"] = "auto",
    missing: Literal["fill", "leave"] = "fill",
    integrators: int | Literal["auto"] = "auto",
    input_delay: int | Sequence[int] | Literal["auto"] = "auto",
    drift: int | Literal["auto", "none", "linear"] = "auto",
    kind: RecordKind = "driven",
    mend: Mended | None = None,
) -> Preparation:
    """Everything that is done to records before a model is fitted to them, chosen by the data and explained.

    Args:
        records: of one system.
        decimation: factor, or "auto" for the band in which the outputs follow the inputs.
        missing: "fill" missing outputs by a model of the rest where they leave too few whole rows, or "leave" them.
        integrators: number of times that the system sums its inputs (0, 1 or 2).
        input_delay: samples of the records given by which inputs act late (below zero early), one number or one an
            input.
        drift: "none", "linear", or a number of slow functions (1 a line, 2 a parabola, more: half-waves).
        kind: of the records; what was struck gets its level from rest, and rows of rest in front. A ring-down has
            neither integrators nor input delays, and no drift unless it is given.
        mend: what `mended` makes of them, where that is known.

    Raises:
        InsufficientDataError: an output that never moves in some record, an input that moves in none, or records too
            short for the delay.
        InvalidDataError: an argument outside its range.

    Example:
        >>> rng = np.random.default_rng(1)
        >>> force = rng.standard_normal(1500)
        >>> late = np.convolve(force, np.r_[np.zeros(6), 1.0, 0.5])[:1500] + np.linspace(0.0, 2.0, 1500)
        >>> found = prepare([Record(force, late + 0.01 * rng.standard_normal(1500), 0.01)])
        >>> found.input_delay, found.n_integrators, found.n_slow_functions
        ((6,), 0, 1)
    """
    first = records[0]
    level_given = drift != "auto"
    if kind == "decay":  # what a release does is neither late nor summed, and its end is its level
        integrators, input_delay, drift = 0, 0, drift if level_given else "none"
    slow_functions_given = _slow_functions_given(drift)
    given = None if integrators == "auto" else given_integrators(integrators)
    check_delay_word(input_delay)
    if missing not in ("fill", "leave"):
        raise InvalidDataError(f'missing must be "fill" or "leave", but is {missing!r}.')
    mend = mended(records, driven=kind == "driven" and first.n_inputs > 0) if mend is None else mend
    parts, gaps = _parts(mend.records)
    lines, rested, floor = _about_rest_without_lines(parts, kind)
    lines, filling, trials = _filled_without_lines(lines, kind, missing)
    integrating = choose_integrators(filling.records, trials=trials) if given is None else given
    number = integrating.number
    n_rest: tuple[int, ...] = (0,) * len(parts) if rested is None else rested.n_rest
    measured = tuple(one.samples(n) for one, n in zip(filling.records, n_rest, strict=True))
    if kind == "decay":  # nobody measured a release
        measured = tuple(one.select(inputs=[]) for one in measured)
    there = filling.measured if holds_filled(filling.records, filling.measured) else ()
    banded, factor, band = _to_band(filling.records, decimation, number, measured, there=there)
    lost = filter_half_length(factor) if factor > 1 else 0
    centring: tuple[Choice, ...] = (_MEAN,) if rested is None else rested.choices
    if rested is None:
        banded = tuple(one.detrended() for one in banded) if factor > 1 else banded
    else:
        n_rest = tuple(max(0, -(-(n - lost) // factor)) for n in n_rest)
    looks_ahead = not number and (kind == "driven" or (rested is not None and rested.looks_ahead))
    delays = partial(_delays, given=input_delay, looks_ahead=looks_ahead, struck=rested is not None, factor=factor)
    delay, skew = delays(banded, measured), Skew()
    as_tried = trials if factor == 1 and not any(delay.samples) else None
    if kind != "decay" and not number:
        skew = _skew(late_inputs(banded, delay.samples), factor, as_tried)
    if any(skew.whole):
        banded, n_rest = on_time(banded, skew.whole), tuple(max(0, n + min(0, *skew.whole)) for n in n_rest)
        delay = delays(banded, on_time(measured, [factor * whole for whole in skew.whole]))
    summed = tuple(summed_inputs(record, number) for record in banded)
    if slow_functions_given is not None:
        drifting = given_drift(max(number, slow_functions_given), banded[0])
    elif number:
        drifting = integrator_drift(number, banded[0])
    else:
        as_tried = None if any(skew.whole) else as_tried
        drifting = choose_drift(late_inputs(summed, delay.samples), trials=as_tried)
    freed = tuple(without_drift(record, n) if (n := drifting.n_functions) else record for record in summed)
    own = [_own_inputs(*three, number) for three in zip(banded, summed, freed, strict=True)]
    late, early = late_and_early(delay.samples)
    return Preparation(
        mended=mend.records,
        records=late_inputs(freed, delay.samples),
        as_measured=tuple(record.samples(late, record.n_samples - early) for record in own),
        input_delay=delay.samples,
        n_integrators=number,
        n_slow_functions=drifting.n_functions,
        skew=skew,
        choices=(
            *gaps,
            *floor,
            *lines.choices,
            *filling.choices,
            *centring,
            band,
            *skew.choices,
            *(_of_a_release(one) if kind == "decay" else one for one in (integrating.choice, delay.choice)),
            drifting.choice if level_given or kind != "decay" else _of_a_release(drifting.choice),
        ),
        warnings=(
            *mend.warnings,
            *_gap_warnings(gaps),
            *lines.warnings,
            *skew.warnings,
            *([drifting.warning] if drifting.warning else []),
        ),
        measured=tuple(
            _measured_on_time(seen, factor, skew)[late : record.n_samples - early]
            for seen, record in zip(filling.measured, own, strict=True)
        ),
        measured_share=_measured_share(filling, rested),
        n_rest=tuple(max(0, n - late) for n in n_rest),
        at_rest=np.zeros((len(own), first.n_inputs)) if rested is None or number else rested.at_rest / factor,
    )


def _skew(records: Sequence[Record], factor: int, trials: FreedTrials | None) -> Skew:
    if not records[0].n_inputs:  # nothing to make a model of
        return Skew()
    return choose_skew(records, factor, known=None if trials is None else (trials.records, trials.model(0, 0)))


def _delays(
    records: Sequence[Record],
    measured: Sequence[Record],
    *,
    given: int | Sequence[int] | str,
    looks_ahead: bool,
    struck: bool,
    factor: int,
) -> InputDelay:
    """How late inputs act: given, or as the records show, with a lead where one is looked for.

    Args:
        records: that are to be fitted.
        measured: the same before they were decimated by `factor`.
        given: by the caller, in samples of those, or "auto".
        looks_ahead: whether inputs may be taken early.
        struck: whether they act in blows.
        factor: of decimation.
    """
    if not isinstance(given, str):
        return given_input_delay(given, records[0], decimation=factor)
    delay = choose_input_delay(records)
    if not (records[0].n_inputs and looks_ahead):
        return delay
    before = min(row for row, _ in acts(records)) if struck else None
    return with_lead(delay, records, measured, before=before)


def _about_rest_without_lines(
    records: tuple[Record, ...], kind: RecordKind
) -> tuple[MachineLines, Rested | None, tuple[Choice, ...]]:
    """Records about their mean or level at rest, less lines that are told so far; what rests; the sensors' floor."""
    if kind in ("transient", "decay"):
        none = MachineLines(records=records, frequencies=np.empty(0))
        lines = lines_beside_blows(records) if kind == "transient" else none
        rested = with_rest(lines.records)
        return replace(lines, records=rested.records), rested, ()
    centred, floor = tuple(one.detrended() for one in records), tuple[Choice, ...]()
    if kind == "ambient":
        centred, floor = no_finer_than_sensors(centred)
    return machine_lines(centred), None, floor


def _filled_without_lines(
    lines: MachineLines, kind: RecordKind, missing: Literal["fill", "leave"]
) -> tuple[MachineLines, Filling, FreedTrials]:
    """Records filled, of driven ones less the lines beside their forces, and first models of them."""
    filling = _filling(lines.records, missing)
    trials = FreedTrials.of(filling.records)
    if kind == "driven" and lines.records[0].n_inputs:
        lines = lines_beside_forces(filling.records, trials)
        if lines.frequencies.size:
            filling, trials = replace(filling, records=lines.records), FreedTrials.of(lines.records)
    return lines, filling, trials


def _measured_share(filling: Filling, rested: Rested | None) -> float:
    """Of the output samples that are there, without rest: what a filter makes of filled ones is still that share."""
    n_rest = (0,) * len(filling.records) if rested is None else rested.n_rest
    there = [np.isfinite(record.outputs[n:]) for record, n in zip(filling.records, n_rest, strict=True)]
    own = [one & seen[n:] for one, seen, n in zip(there, filling.measured, n_rest, strict=True)]
    return sum(int(one.sum()) for one in own) / max(1, sum(int(one.sum()) for one in there))


def _gap_warnings(gaps: tuple[Choice, ...]) -> tuple[str, ...]:
    return tuple(f"Input gaps: {gap.value}: {gap.reason}." for gap in gaps)


def checked_parts(records: Sequence[Record]) -> tuple[Record, ...]:
    """The stretches of all records in which no input is missing.

    Raises:
        InsufficientDataError: an output that never moves in some record, an input that moves in none, or records that
            are too short.
    """
    _check_long_enough(records)
    _check_channels_move(records)
    return tuple(part for record in records for part in split_at_input_gaps(record))


def _parts(records: Sequence[Record]) -> tuple[tuple[Record, ...], tuple[Choice, ...]]:
    """Records cut where an input is missing."""
    parts = checked_parts(records)
    if len(parts) == len(records):
        return parts, ()
    gaps = Choice(
        what="input gaps",
        value=f"{len(parts)} records from {len(records)}",
        reason="samples of an input are missing; no model can run over them, so a record ends at each gap",
    )
    return parts, (gaps,)


def _of_a_release(choice: Choice) -> Choice:
    """The choice that a ring-down makes, which has no input that could be late, and why."""
    return replace(choice, reason="a release is neither late nor summed, and the end of the record is its level")


def _to_band(
    records: Sequence[Record],
    decimation: int | Literal["auto"],
    n_integrators: int,
    measured: Sequence[Record],
    *,
    there: Sequence[BoolArray],
) -> tuple[tuple[Record, ...], int, Choice]:
    """Decimated records, the factor and why; outputs that integrate are compared by what they integrate.

    They are compared as measured: rows of rest that stand in front are quieter than the record's own rest. `there`,
    (n_samples, n_outputs) where samples were filled, says which were measured: most of what is left is to be of these.

    Raises:
        InvalidDataError: with a factor that was given they do not.
    """
    if decimation == "auto":
        compared = [replace(record, outputs=_differences(record.outputs, n_integrators)) for record in measured]
        band = coherent_band(compared)
        factor, reason = band.factor, band.reason
    else:
        factor, reason = decimation, "given as an argument"
    if factor > 1 and there:
        kept = np.sum([_made_of_measured(own, factor).sum(axis=0) for own in there], axis=0)
        shares = factor * kept / np.maximum(1, np.sum([own.sum(axis=0) for own in there], axis=0))
        least = int(shares.argmin())
        if shares[least] < MOSTLY_KEPT:
            reason = (
                f"decimation by {factor} would leave {100 * shares[least]:.2g} % of what was measured of "
                f"{records[0].output_names[least]} without what was filled, where {100 * MOSTLY_KEPT:.0f} % are needed"
            )
            if decimation != "auto":
                raise InvalidDataError(f"{reason}; leave decimation out.")
            factor = 1
    if factor > 1:
        records = tuple(record.decimated(factor) for record in records)
    nyquist = 0.5 / records[0].dt
    return tuple(records), factor, Choice(what="frequency band", value=f"0 to {nyquist:.4g} Hz", reason=reason)


def _made_of_measured(there: BoolArray, factor: int) -> BoolArray:
    """Which samples that a decimation leaves are made of measured ones, as far as the main lobe of its filter reaches.

    `there` is (n_samples, n_outputs), True where an output was measured.
    """
    if factor == 1:
        return there
    reach, half = filter_half_length(factor), min(factor, filter_half_length(factor))
    around = np.asarray(np.lib.stride_tricks.sliding_window_view(there, 2 * half + 1, axis=0).all(axis=-1))
    return around[reach - half : len(there) - reach - half : factor]


def _measured_on_time(there: BoolArray, factor: int, skew: Skew) -> BoolArray:
    """The same for outputs that were taken from later samples."""
    made = _made_of_measured(there, factor)
    return rows_on_time(made, skew.whole) if any(skew.whole) else made


def _differences(values: FloatArray, number: int) -> FloatArray:
    """As many differences of each column, the first ones repeated so that no row is lost."""
    if number == 0:
        return values
    inner = np.diff(values, number, axis=0)
    return np.vstack([np.repeat(inner[:1], number, axis=0), inner])


def _own_inputs(banded: Record, summed: Record, freed: Record, number: int) -> Record:
    """The inputs whose sums are those of `freed`: as they came, less what of them drives the slow motion taken off."""
    slow = _differences(summed.inputs - freed.inputs, number)
    return replace(freed, inputs=banded.inputs - slow)


def _filling(records: Sequence[Record], missing: Literal["fill", "leave"]) -> Filling:
    if missing == "fill":
        return fill_where_needed(records)
    measured = tuple(~np.isnan(record.outputs) for record in records)
    return Filling(records=tuple(records), measured=measured, choices=())


def _slow_functions_given(drift: int | Literal["auto", "none", "linear"]) -> int | None:
    if isinstance(drift, str):
        words = {"auto": None, "none": 0, "linear": 1}
        if drift not in words:
            raise InvalidDataError(
                f'drift must be "auto", "none", "linear" or a number of slow functions, but is {drift!r}.'
            )
        return words[drift]
    return whole_number(drift, name="a number of slow functions", least=0)


def split_at_input_gaps(record: Record) -> tuple[Record, ...]:
    """The stretches of a record in which no input is missing.

    Those shorter than `SHORTEST` samples, or than `SHORTEST_SHARE` of the longest, are dropped.

    Raises:
        InsufficientDataError: no stretch is long enough.

    Example:
        >>> force = np.sin(np.arange(200.0))
        >>> force[80] = np.nan
        >>> [part.n_samples for part in split_at_input_gaps(Record(force, np.cos(force.size - np.arange(200.0)), 0.1))]
        [80, 119]
    """
    missing = np.asarray(np.isnan(record.inputs).any(axis=1))
    if not missing.any():
        return (record,)
    runs = runs_of(~missing)
    least = max(SHORTEST, SHORTEST_SHARE * max((last - first for first, last in runs), default=0))
    stretches = [(first, last) for first, last in runs if last - first >= least]
    measured = np.isfinite(record.outputs).any(axis=0)
    there = np.isfinite(record.outputs[:, measured])
    whole = [(first, last) for first, last in stretches if there[first:last].any(axis=0).all()]
    if not whole:
        raise InsufficientDataError(
            f"inputs are missing in {int(missing.sum())} of {record.n_samples} samples, which leaves no stretch of "
            f"{SHORTEST} samples with all channels; give a record with fewer gaps in its inputs."
        )
    return tuple(
        replace(record.samples(first, last), name=f"{record.name or 'record'}, part {number}")
        for number, (first, last) in enumerate(whole, 1)
    )


def _check_long_enough(records: Sequence[Record]) -> None:
    longest = max(record.n_samples for record in records)
    if longest < FEWEST_SAMPLES:
        raise InsufficientDataError(
            f"choosing a model's orders needs at least {FEWEST_SAMPLES} samples in one record (four blocks of ten); "
            f"the longest has {longest}: give a longer record."
        )


def _check_channels_move(records: Sequence[Record]) -> None:
    """An output that rests in one record has failed there; an input may rest in some records, but not in all.

    An output may be absent in some records (set-ups), but not in all.
    """
    seen = np.array([np.isfinite(record.outputs).any(axis=0) for record in records])
    for name, measured in zip(records[0].output_names, seen.T, strict=True):
        if not measured.any():
            raise InsufficientDataError(f"output {name!r} holds no number in any record; leave it out.")
    for record, there in zip(records, seen, strict=True):
        names = [name for name, measured in zip(record.output_names, there, strict=True) if measured]
        _refuse_constant("output", record.outputs[:, there], names, record)
    for i, name in enumerate(records[0].input_names):
        if all(np.nanmin(record.inputs[:, i]) == np.nanmax(record.inputs[:, i]) for record in records):
            _refuse_constant("input", records[0].inputs[:, [i]], (name,), records[0])


def _refuse_constant(kind: str, array: FloatArray, names: Sequence[str], record: Record) -> None:
    for values, name in zip(array.T, names, strict=True):
        low, high = np.nanmin(values), np.nanmax(values)
        if low == high:
            where = f" of record {record.name!r}" if record.name else ""
            raise InsufficientDataError(
                f"{kind} {name!r}{where} is {low + 0.0:.6g} in all {record.n_samples} samples, so nothing can be "
                "learnt from it; leave it out."
            )
