"""What is done to the records before anything is fitted: means off, decimation to the band they speak about."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from modal.band import coherent_band
from modal.identification import Choice
from okid.arrays import FloatArray
from okid.errors import InsufficientDataError
from okid.record import Record
from okid.rows import runs_of

__all__ = ["prepare", "split_at_input_gaps"]

FEWEST_SAMPLES = 40
"""One block that always trains and one for each of three folds."""
SHORTEST = 50
"""Samples between two input gaps from which on a stretch is worth an initial state of its own."""
SHORTEST_SHARE = 0.02
"""Of the record's longest stretch: a shorter one tells next to nothing, but would limit decimation."""


def prepare(
    records: Sequence[Record], *, decimation: int | Literal["auto"] = "auto"
) -> tuple[tuple[Record, ...], tuple[Choice, ...]]:
    """Records ready for the observer fit, and the choices made.

    Args:
        records: of one system.
        decimation: factor, or "auto" for the band in which the outputs follow the inputs.

    Raises:
        InsufficientDataError: an output that never moves in some record, or an input that moves in none.
    """
    _check_long_enough(records)
    _check_channels_move(records)
    parts = tuple(part for record in records for part in split_at_input_gaps(record))
    centred = tuple(record.detrended() for record in parts)
    mean = Choice(what="mean", value="removed", reason="the model describes motion about the mean of each channel")
    if decimation == "auto":
        band = coherent_band(centred)
        factor, reason = band.factor, band.reason
    else:
        factor, reason = decimation, "given as an argument"
    if factor > 1:
        centred = tuple(record.decimated(factor).detrended() for record in centred)
    nyquist = 0.5 / centred[0].dt
    band_choice = Choice(what="frequency band", value=f"0 to {nyquist:.4g} Hz", reason=reason)
    if len(parts) == len(records):
        return centred, (mean, band_choice)
    gaps = Choice(
        what="input gaps",
        value=f"{len(parts)} records from {len(records)}",
        reason="where an input is missing the state is lost: what follows starts a record of its own",
    )
    return centred, (gaps, mean, band_choice)


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
    whole = [(first, last) for first, last in stretches if np.isfinite(record.outputs[first:last]).any(axis=0).all()]
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
            f"the automatic choice needs at least {FEWEST_SAMPLES} samples in one record, four blocks of ten; the "
            f"longest has {longest}; give a longer record, or call okid.fit_observer with an order of your own."
        )


def _check_channels_move(records: Sequence[Record]) -> None:
    """An output that rests in one record has failed there; an input may rest in some records, but not in all."""
    for record in records:
        _refuse_constant("output", record.outputs, record.output_names, record)
    for i, name in enumerate(records[0].input_names):
        if all(np.nanmin(record.inputs[:, i]) == np.nanmax(record.inputs[:, i]) for record in records):
            _refuse_constant("input", records[0].inputs[:, [i]], (name,), records[0])


def _refuse_constant(kind: str, array: FloatArray, names: Sequence[str], record: Record) -> None:
    for values, name in zip(array.T, names, strict=True):
        low, high = np.nanmin(values), np.nanmax(values)
        if low == high:
            where = f" of record {record.name!r}" if record.name else ""
            raise InsufficientDataError(
                f"{kind} {name!r}{where} is {low:.6g} in all {record.n_samples} samples, so nothing can be learnt "
                "from it; leave it out."
            )
