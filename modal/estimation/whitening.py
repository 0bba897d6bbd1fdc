"""Noise as an autoregression, and records filtered until it is white.

Least squares hears noise where it is loudest: in what is left of a record whose noise is all low frequencies, a weak
mode among high ones counts for nothing, however far it stands above the noise beside it. An autoregression of the noise

    a(q) e = w,   w white,   a(q) = 1 + a1 q^-1 + ... + ap q^-p

says how loud it is at each frequency. Filtered by a(q) inputs and outputs belong to the same system, y = G u + e
becomes a y = G (a u) + w, only the initial state is another; w are the innovations of both.

References:
    Ljung, System Identification: Theory for the User, 2nd edition, 1999, sections 7.2 and 14.4 (prefilters are noise
    models). Schwarz, Annals of Statistics 6(2), 1978, doi 10.1214/aos/1176344136 (the order).
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
import scipy

from okid.arrays import TINY, BoolArray, FloatArray
from okid.errors import InvalidDataError
from okid.record import Record
from okid.rows import runs_of

LONGEST_MEMORY = 3
"""Take noise for an autoregression of at most this order: a longer one would take a weak mode for noise."""


def stretches(errors: Sequence[FloatArray], rows: Sequence[BoolArray]) -> list[FloatArray]:
    """The runs of rows that count."""
    return [error[first:last] for error, there in zip(errors, rows, strict=True) for first, last in runs_of(there)]


def output_filters(errors: Sequence[FloatArray]) -> list[FloatArray]:
    """(1 to `LONGEST_MEMORY` + 1,) an output: the filter that leaves white noise of unit power.

    Between gaps it remembers no more than half of the rows have before them.

    Args:
        errors: (n_rows, n_outputs) each, without gaps.
    """
    n_rows = sum(len(error) for error in errors)
    filters = []
    for r in _correlations(errors).T:
        one, power = _autoregression(r / n_rows, n_rows)
        filters.append(one / np.sqrt(power))
    return filters


def common_filter(errors: Sequence[FloatArray]) -> tuple[FloatArray, float]:
    """a(q) of all outputs together, each over its power, and the share of the power that is left behind it.

    Args:
        errors: (n_rows, n_outputs) each, without gaps.

    Example:
        >>> white = np.random.default_rng(0).standard_normal(5000)
        >>> red = np.convolve(white, 0.9 ** np.arange(100))[:5000, np.newaxis]
        >>> a, share = common_filter([red])
        >>> a.round(1).tolist(), round(share, 1)
        ([1.0, -0.9], 0.2)
    """
    r = _correlations(errors)
    together = (r / r[0]).mean(axis=1)
    return _autoregression(together, sum(error.size for error in errors))


def all_filtered(records: Sequence[Record], a: FloatArray) -> tuple[Record, ...]:
    """Those of the records, behind the filter, of which enough is left there; see `filtered`."""
    found = []
    for record in records:
        with suppress(InvalidDataError):
            found.append(filtered(record, a))
    return tuple(found)


def filtered(record: Record, a: FloatArray) -> Record:
    """The record behind the filter, from the first row on that has a whole past; gaps grow by its memory.

    Raises:
        InvalidDataError: no such row is left, fewer than channels, or all of them miss an output.
    """
    last = max(0, record.n_samples - a.size + 1)
    inputs, outputs = (
        sum(one * channels[a.size - 1 - k :][:last] for k, one in enumerate(a))
        for channels in (record.inputs, record.outputs)
    )
    return replace(record, inputs=inputs, outputs=outputs)


def _correlations(errors: Sequence[FloatArray]) -> FloatArray:
    """(1 to `LONGEST_MEMORY` + 1, n_outputs) sums of e(k + lag) e(k), of lags that half of the rows reach back."""
    n_rows = sum(len(one) for one in errors)
    lags = [n for n in range(LONGEST_MEMORY + 1) if 2 * sum(max(0, len(one) - n) for one in errors) >= n_rows]
    r = np.array([sum((one[lag:] * one[: -lag or None]).sum(axis=0) for one in errors) for lag in lags])
    r[0] += TINY + np.finfo(np.float64).eps * r[0]
    return r


def _autoregression(r: FloatArray, n_values: int) -> tuple[FloatArray, float]:
    """The monic filter of least criterion (Yule, Walker; Schwarz), and the power behind it."""
    tails = [scipy.linalg.solve_toeplitz(r[:order], -r[1 : order + 1]) for order in range(1, r.size)]
    candidates = [np.ones(1), *(np.r_[1.0, tail] for tail in tails)]
    power = [max(float(one @ r[: one.size]), TINY) for one in candidates]
    best = int(np.argmin([n_values * np.log(left) + order * np.log(n_values) for order, left in enumerate(power)]))
    return candidates[best], power[best]
