"""Modes of many records: frequencies against time or number of the record."""

from collections.abc import Sequence

import numpy as np

from modal.plots.layout import Chart, grid_of
from modal.plots.panels import STYLE, Role
from okid.arrays import FloatArray

__all__ = ["DOT", "frequencies_of_records", "places_of_records"]

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
    places: FloatArray, frequencies: FloatArray, verdicts: Sequence[str], *, along: str, alarms: Sequence[float] = ()
) -> Chart:
    """A dot a mode and record.

    Args:
        places: (n_modes,) along.
        frequencies: (n_modes,) [Hz].
        verdicts: (n_modes,) "system" or "doubtful"; noise is not drawn.
        along: what the places are.
        alarms: places to mark.
    """
    figure = grid_of(1, 1, size=(STYLE.page, 4.2))
    panel = figure.panels[0]
    kinds = np.asarray(verdicts, dtype=np.str_)
    drawn: tuple[tuple[Role, str], ...] = (("doubtful", "doubtful"), ("system", "of the system"))
    for role, name in drawn:
        chosen = kinds == role
        if chosen.any():
            panel.dots(places[chosen], frequencies[chosen], role, dot=DOT, label=name)
    for place in alarms:
        panel.upright(place, "residual", width=STYLE.stroke)
    panel.x.label, panel.y.label = along, "frequency [Hz]"
    panel.key = "best" if panel.keyed else None
    return figure
