"""Detrending and decimation of time-major arrays with missing samples; decimation in chunks, so maps stay on disk."""

import numpy as np

from okid.arrays import FloatArray, row_chunks

__all__ = ["decimated", "detrended", "filter_half_length"]

CUT_OFF = 0.75
"""Cut-off of the filter over the new Nyquist frequency: with this and the window, its stop band begins there."""

KAISER_BETA = 8.0
"""Window parameter: about 80 dB in the stop band."""

HALF_LENGTH = 10
"""Half the filter's length in new samples."""


def filter_half_length(factor: int) -> int:
    """Samples on either side that the anti-alias filter of `decimated` reaches to."""
    return HALF_LENGTH * factor


def detrended(array: FloatArray, degree: int) -> FloatArray:
    """Each channel less its least-squares polynomial over the samples that are there.

    Legendre polynomials over the whole span, so that the fit is well conditioned at any degree.

    Args:
        array: (n_samples, n_channels), NaN where missing.
        degree: of the polynomial.
    """
    basis = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, len(array)), degree)
    result = np.array(array, order="C")
    there = ~np.isnan(result)
    complete = there.all(axis=0)
    if complete.any():
        coefficients, *_ = np.linalg.lstsq(basis, result[:, complete], rcond=None)
        result[:, complete] -= basis @ coefficients
    for index in np.flatnonzero(~complete):
        rows = there[:, index]
        coefficients, *_ = np.linalg.lstsq(basis[rows], result[rows, index], rcond=None)
        result[rows, index] -= basis[rows] @ coefficients
    return result


def decimated(array: FloatArray, factor: int) -> FloatArray:
    """Every `factor`-th row of the low-passed array, without the rows at the ends that the filter does not fill.

    Args:
        array: (n_samples, n_channels), NaN where missing; a row within the filter's reach of a NaN becomes NaN.
        factor: of decimation, at least 2.

    Returns:
        (n_rows, n_channels): row r is centred at sample `filter_half_length(factor) + r * factor`.
    """
    import scipy

    half = filter_half_length(factor)
    taps = scipy.signal.firwin(2 * half + 1, CUT_OFF / factor, window=("kaiser", KAISER_BETA))
    n_samples, n_channels = array.shape
    n_rows = (n_samples - 2 * half - 1) // factor + 1
    result = np.empty((n_rows, n_channels))
    for rows in row_chunks(n_rows, n_channels * factor):
        part = array[rows.start * factor : (rows.stop - 1) * factor + 2 * half + 1]
        missing = np.isnan(part)
        touched = missing.any()
        # Output k of upfirdn is centred at k * factor - half: the first 2 HALF_LENGTH ones reach before the part.
        filtered = scipy.signal.upfirdn(taps, np.where(missing, 0.0, part) if touched else part, 1, factor, axis=0)
        result[rows] = filtered[2 * HALF_LENGTH : 2 * HALF_LENGTH + rows.stop - rows.start]
        if touched:
            count = np.cumsum(np.vstack([np.zeros((1, n_channels), dtype=np.intp), missing]), axis=0)
            first = np.arange(rows.stop - rows.start) * factor
            result[rows][count[first + 2 * half + 1] > count[first]] = np.nan
    return result
