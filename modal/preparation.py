"""What is done to the records before anything is fitted: means off, decimation to the band they speak about."""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from modal.band import coherent_band
from modal.identification import Choice
from okid.errors import InsufficientDataError
from okid.record import Record

__all__ = ["prepare"]


def prepare(
    records: Sequence[Record], *, decimation: int | Literal["auto"] = "auto"
) -> tuple[tuple[Record, ...], tuple[Choice, ...]]:
    """Records ready for the observer fit, and the choices made.

    Args:
        records: of one system.
        decimation: factor, or "auto" for the band in which the outputs follow the inputs.

    Raises:
        InsufficientDataError: a channel that never moves.
    """
    for record in records:
        _check_moves(record)
    centred = tuple(record.detrended() for record in records)
    mean = Choice(what="mean", value="removed", reason="the model describes motion about the mean of each channel")
    if decimation == "auto":
        band = coherent_band(centred)
        factor, reason = band.factor, band.reason
    else:
        factor, reason = decimation, "given as an argument"
    if factor > 1:
        centred = tuple(record.decimated(factor).detrended() for record in centred)
    nyquist = 0.5 / centred[0].dt
    chosen = Choice(what="frequency band", value=f"0 to {nyquist:.4g} Hz", reason=reason)
    return centred, (mean, chosen)


def _check_moves(record: Record) -> None:
    for kind, array, names in (
        ("input", record.inputs, record.input_names),
        ("output", record.outputs, record.output_names),
    ):
        for values, name in zip(array.T, names, strict=True):
            low, high = np.nanmin(values), np.nanmax(values)
            if low == high:
                where = f" of record {record.name!r}" if record.name else ""
                raise InsufficientDataError(
                    f"{kind} {name!r}{where} is {low:.6g} in all {record.n_samples} samples, so nothing can be learnt "
                    "from it; leave it out."
                )
