"""Modes of many records: found in each, frequencies against time or number; followed, with what the causes leave."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from modal.plots.layout import Chart, grid_of
from modal.plots.panels import IN_TURN, STYLE, Role
from okid.arrays import FloatArray

__all__ = ["DOT", "frequencies_in_time", "frequencies_of_records", "places_of_records"]

DOT = 2.6
"""Draw a mode of one record this large [pt]: a year of hourly records is a line of them."""
_SPANS = ((2 * 86400.0, 86400.0, "days"), (2 * 3600.0, 3600.0, "h"), (120.0, 60.0, "min"), (0.0, 1.0, "s"))
"""Count time in the unit of which the whole span holds two."""


def places_of_records(start_times: FloatArray) -> tuple[FloatArray, str]:
    """(n_records,) places along and what they are: time since the first where all start at times of their own.

    Example:
        >>> places_of_records(np.array([0.0, 3600.0, 10800.0]))
        (array([0., 1., 3.]), 'time since the first record [h]')
        >>> places_of_records(np.array([0.0, 0.0]))
        (array([1., 2.]), 'record')
    """
    if start_times.size < 2 or np.unique(start_times).size < start_times.size:
        return np.arange(1.0, start_times.size + 1.0), "record"
    since = start_times - start_times.min()
    unit, name = next((unit, name) for least, unit, name in _SPANS if since.max() >= least)
    return since / unit, f"time since the first record [{name}]"


def frequencies_of_records(
    places: FloatArray, frequencies: FloatArray, verdicts: Sequence[str], *, along: str
) -> Chart:
    """A dot a mode and record.

    Args:
        places: (n_modes,) along.
        frequencies: (n_modes,) [Hz].
        verdicts: (n_modes,) "system" or "doubtful"; noise is not drawn.
        along: what the places are.
    """
    figure = grid_of(1, 1, size=(STYLE.page, 4.2))
    panel = figure.panels[0]
    kinds = np.asarray(verdicts, dtype=np.str_)
    drawn: tuple[tuple[Role, str], ...] = (("doubtful", "doubtful"), ("system", "of the system"))
    for role, name in drawn:
        chosen = kinds == role
        if chosen.any():
            panel.dots(places[chosen], frequencies[chosen], role, dot=DOT, label=name)
    panel.x.label, panel.y.label = along, "frequency [Hz]"
    panel.key = "best" if panel.keyed else None
    return figure


MEANS = 24
"""Draw the mean of so many neighbours of what is left, a day of hourly records, but at least as many means."""


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
        n_means = max(-(-x.size // MEANS), min(x.size, MEANS))
        parts = np.array_split(np.arange(x.size), n_means) if n_means else []
        below.line([x[part].mean() for part in parts], [100 * one.left[part].mean() for part in parts], role)
    for time in alarms:
        for panel in (above, below):
            panel.upright(float(along[np.searchsorted(every, time)]), "residual", width=STYLE.thick)
    above.y.label, below.y.label = "frequency [Hz]", "left without the causes [%]"
    below.x.label = label
    return figure
