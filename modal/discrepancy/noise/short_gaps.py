"""Missing samples, bridged so that a spectrum can be taken.

A missing sample gets the value that the samples beside it foretell: the regression of a sample of this output on its
neighbours before and after and on the inputs at the same times, learnt from the rows where all of them are there. That
follows a smooth response and the jumps that an input makes alike. Smooth as it is, it brings hardly any noise to
high frequencies: there the level of the noise falls by the share of bridged samples. A long gap is not bridged.
"""

import numpy as np

from modal.simulation.tolerances import ROUNDING
from okid.arrays import BoolArray, FloatArray
from okid.rows import runs_of

__all__ = ["bridgeable_runs", "bridged"]

_LONGEST_GAP = 6
_REACHES = (6, 4, 3, 2)
"""Neighbours on either side: fewer where missing samples leave too few whole rows to learn from."""
_FEWEST_ROWS = 4
"""Whole rows for each neighbour and input, without which nothing is learnt."""


def bridgeable_runs(there: BoolArray) -> list[tuple[int, int]]:
    """(start, stop) of stretches that begin and end with a sample and hold no gap longer than 6 samples.

    Args:
        there: (n_samples,) False where a sample is missing.

    Example:
        >>> there = np.ones(20, dtype=bool)
        >>> there[[0, 5, 6]] = False
        >>> there[10:18] = False
        >>> bridgeable_runs(there)
        [(1, 10), (18, 20)]
    """
    runs: list[tuple[int, int]] = []
    for start, stop in runs_of(there):
        if runs and start - runs[-1][1] <= _LONGEST_GAP:
            runs[-1] = (runs[-1][0], stop)
        else:
            runs.append((start, stop))
    return runs


def bridged(values: FloatArray, inputs: FloatArray) -> FloatArray:
    """The values with what is missing foretold from the samples and inputs beside it.

    Args:
        values: (n_samples,) of one output, NaN where missing.
        inputs: (n_samples, n_inputs) without gaps.

    Example:
        >>> wave = np.sin(0.2 * np.arange(400.0))
        >>> holed = wave.copy()
        >>> holed[50::37] = np.nan
        >>> bool(np.abs(bridged(holed, np.empty((400, 0))) - wave).max() < 1e-3)
        True
    """
    missing = np.flatnonzero(np.isnan(values))
    if missing.size == 0:
        return values
    there = ~np.isnan(values)
    straight = np.interp(np.arange(values.size), np.flatnonzero(there), values[there])
    centre, scale = float(straight.mean()), float(straight.std()) or 1.0
    spread = inputs.std(axis=0)
    channels = np.empty((values.size, 1 + inputs.shape[1]))
    channels[:, 0] = (values - centre) / scale
    channels[:, 1:] = (inputs - inputs.mean(axis=0)) / np.where(spread > 0.0, spread, 1.0)
    for reach in _REACHES:
        rows = _neighbourhoods(channels, reach)
        whole = rows[~np.isnan(rows).any(axis=1)]
        if len(whole) >= _FEWEST_ROWS * rows.shape[1]:
            filled = np.array(straight)
            filled[missing] = centre + scale * _foretold(rows[missing], whole, reach)
            return filled
    return straight


def _neighbourhoods(channels: FloatArray, reach: int) -> FloatArray:
    """(n_samples, n_channels (2 reach + 1)) every channel from `reach` samples before to `reach` after, NaN outside."""
    padded = np.full((len(channels) + 2 * reach, channels.shape[1]), np.nan)
    padded[reach : len(padded) - reach] = channels
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, axis=0)
    return windows.reshape(len(channels), -1)


def _foretold(rows: FloatArray, whole: FloatArray, centre: int) -> FloatArray:
    """The centre of each row from what is known of it, by the second moments of whole rows."""
    gram = whole.T @ whole
    gram[np.diag_indices_from(gram)] += ROUNDING * np.trace(gram) / len(gram)
    known = ~np.isnan(rows)
    result = np.zeros(len(rows))
    for pattern in np.unique(known, axis=0):
        same = (known == pattern).all(axis=1)
        beside = np.flatnonzero(pattern)
        if beside.size:
            weight = np.linalg.solve(gram[np.ix_(beside, beside)], gram[beside, centre])
            result[same] = rows[np.ix_(same, beside)] @ weight
    return result
