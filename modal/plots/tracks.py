"""Modes through time: a year on one page, frequencies above, below what the causes leave of them."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from modal.plots.layout import Chart, grid_of
from modal.plots.panels import IN_TURN, STYLE
from modal.plots.records import DOT, places_of_records
from okid.arrays import FloatArray

__all__ = ["frequencies_in_time"]

MEANS = 24
"""Draw the mean of so many neighbours of what is left: a day of hourly records."""


class TrackLine(Protocol):
    """What is drawn of a mode; see `modal.tracking.Track`."""

    @property
    def frequency(self) -> FloatArray:
        """(n_found,) [Hz]."""
        ...

    @property
    def times(self) -> FloatArray:
        """(n_found,)."""
        ...

    @property
    def left(self) -> FloatArray:
        """(n_found,) relative."""
        ...


def frequencies_in_time(tracks: Sequence[TrackLine], alarms: Sequence[float], *, clock: bool) -> Chart:
    """Frequencies of all modes, and what is left of each without the causes, with the alarms as upright lines.

    Args:
        tracks: by frequency.
        alarms: their times.
        clock: times are seconds.
    """
    figure = grid_of(2, 1, size=(STYLE.page, 7.0), down=(1.5, 1.0))
    above, below = figure.panels
    every = np.unique(np.concatenate([np.empty(0), *(one.times for one in tracks), np.asarray(alarms)]))
    along, label = places_of_records(every) if clock else (every, "record")
    for number, one in enumerate(tracks):
        role = IN_TURN[number % len(IN_TURN)]
        x = along[np.searchsorted(every, one.times)]
        above.dots(x, one.frequency, role, dot=DOT)
        n_means = -(-x.size // MEANS)
        parts = np.array_split(np.arange(x.size), n_means) if n_means else []
        below.line([x[part].mean() for part in parts], [100 * one.left[part].mean() for part in parts], role)
    for time in alarms:
        for panel in (above, below):
            panel.upright(float(along[np.searchsorted(every, time)]), "residual", width=STYLE.thick)
    above.y.label, below.y.label = "frequency [Hz]", "left without the causes [%]"
    below.x.label = label
    return figure
