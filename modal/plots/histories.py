"""Over time: what was measured and what the model says; the modes of many records against time or number."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import numpy.typing as npt

from modal.plots.chart import INCH, Chart, Key, grid_of, one_panel
from modal.plots.panels import IN_TURN, STYLE, Panel, Role, envelope
from modal.wording.text import fit_text, hertz, plot_label
from okid.arrays import FloatArray
from okid.readers.clock import DAY
from okid.record import Record
from okid.residuals import ResidualCheck


def measured_against_simulated(
    measured: Record,
    simulated: Record,
    *,
    outputs: Sequence[int] | None = None,
    fits: FloatArray | None = None,
    detail: float | None = None,
) -> Chart:
    """One row an output: the whole record with what the model leaves on the left, its strongest moment on the right.

    The model is drawn at the strongest moment alone: over a whole record it would hide what was measured.

    Args:
        measured: record.
        simulated: free run of the model on its inputs; of a record without inputs, its one-step prediction.
        outputs: which outputs, all unless given.
        fits: (n_outputs,) written beside each.
        detail: length of the window on the right [s], a twelfth of the record unless given.
    """
    chosen = range(measured.n_outputs) if outputs is None else outputs
    figure = grid_of(len(chosen), 2, size=(STYLE.page, 0.5 + 1.45 * len(chosen)), across=(2.1, 1.0))
    window = _strongest(measured, detail)
    time = measured.time
    modelled = "model, from the inputs alone" if measured.n_inputs else "model, one step ahead"
    for row, (output, whole, part) in enumerate(zip(chosen, figure.panels[::2], figure.panels[1::2], strict=True)):
        signals: tuple[tuple[FloatArray, Role, float, float], ...] = (
            (measured.outputs[:, output], "measured", 2.4, 0.6),
            (simulated.outputs[:, output], "model", 0.9, 1.0),
        )
        left = measured.outputs[:, output] - simulated.outputs[:, output]
        whole.line(*envelope(time, measured.outputs[:, output]), "measured", label="measured")
        whole.line(*envelope(time, left), "residual", width=STYLE.thin, label="measured less model")
        whole.line(time[:1], [np.nan], "model", label=modelled)  # for the key
        for values, role, width, opacity in signals:
            part.line(time[window], values[window], role, width=width, opacity=opacity)
        name = plot_label(measured.output_names[output])
        unit = plot_label(measured.output_units[output], limit=12)
        fit = "" if fits is None or not np.isfinite(fits[output]) else f", fit {fit_text(fits[output])}"
        whole.head = f"{name}{f' [{unit}]' if unit else ''}{fit}"
        mark_moment(whole, part, time, window)
        for panel in (whole, part):
            panel.x.labelled = row == len(chosen) - 1
    figure.panels[-2].x.label = "time [s]"
    figure.panels[-1].x.label = "time [s], the strongest moment"
    figure.key = Key(panel=figure.panels[0])
    return figure


def mark_moment(whole: Panel, part: Panel, time: FloatArray, window: slice) -> None:
    """Show all of the time in one panel and a moment of it in the other, and where the moment lies in the first."""
    moment = time[window]
    whole.x.limits, part.x.limits = (float(time[0]), float(time[-1])), (float(moment[0]), float(moment[-1]))
    whole.box_of(part.x.limits, (-np.inf, np.inf), "muted", opacity=STYLE.faint)


def residual_autocorrelation(
    residuals: ResidualCheck, *, output_names: Sequence[str] = (), n_outputs: int = 8
) -> Chart:
    """Autocorrelation of the one-step residual of each output, with the band in which white noise would stay."""
    figure, panel = one_panel(STYLE.page, 2.9)
    lags = np.arange(residuals.autocorrelation.shape[0])
    shown = min(n_outputs, residuals.autocorrelation.shape[1])
    limit = residuals.confidence_limit
    panel.box_of((-np.inf, np.inf), (-limit, limit), "muted", opacity=STYLE.faint, label="95 % of white noise")
    panel.across(0.0, "muted", width=STYLE.thin)
    for output in range(shown):
        name = plot_label(output_names[output]) if output_names else f"output {output}"
        offset = 0.7 * (output - (shown - 1) / 2) / shown
        values = residuals.autocorrelation[1:, output]
        foot, tip = (np.stack([lags[1:] + offset, ends], axis=-1) for ends in (np.zeros_like(values), values))
        panel.segments(np.stack([foot, tip], axis=1), IN_TURN[output % len(IN_TURN)], label=name)
    panel.x.label, panel.y.label = "lag [samples]", "autocorrelation"
    panel.x.limits = (0.3, float(lags[-1]) + 0.7)
    figure.key = Key(panel=panel)
    return figure


def _strongest(record: Record, detail: float | None) -> slice:
    length = int(np.clip((detail or record.duration / 12) / record.dt, min(40, record.n_samples), record.n_samples))
    spread = np.nanstd(record.outputs, axis=0)
    spread[spread == 0] = 1.0
    energy = np.nan_to_num((record.outputs - np.nanmean(record.outputs, axis=0)) / spread)
    sums = np.concatenate([[0.0], np.cumsum((energy**2).sum(axis=1))])
    start = int(np.argmax(sums[length:] - sums[:-length]))
    return slice(start, start + length)


DOT = 2.6
"""Draw a mode of one record this large [pt], twice of few records: a year of hourly records is a line of them."""
_SPANS = ((2 * DAY, DAY, "days"), (2 * 3600.0, 3600.0, "h"), (120.0, 60.0, "min"), (0.0, 1.0, "s"))
"""Count time in the unit of which the whole span holds two."""


def places_of_records(start_times: FloatArray, numbers: npt.ArrayLike) -> tuple[FloatArray, str]:
    """(n_records,) places along and what they are: time since the first where all start at times of their own.

    Args:
        start_times: (n_records,) [s].
        numbers: (n_records,) their numbers among all records, also those that failed.

    Example:
        >>> places_of_records(np.array([0.0, 3600.0, 10800.0]), [1, 2, 3])
        (array([0., 1., 3.]), 'time since the first record [h]')
        >>> places_of_records(np.array([0.0, 0.0]), [1, 3])
        (array([1., 3.]), 'record')
    """
    if start_times.size < 2 or np.unique(start_times).size < start_times.size:
        return np.asarray(numbers, dtype=np.float64), "record"
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
    figure, panel = one_panel(STYLE.page, 4.2)
    kinds = np.asarray(verdicts, dtype=np.str_)
    drawn: tuple[tuple[Role, str], ...] = (("doubtful", "doubtful"), ("system", "of the system"))
    dot = _dot(np.unique(places).size)
    for role, name in drawn:
        chosen = kinds == role
        if chosen.any():
            panel.dots(places[chosen], frequencies[chosen], role, dot=dot)
            panel.dots(places[chosen][:1], np.array([np.nan]), role, dot=2 * DOT, label=name)  # for the key
    panel.x.label, panel.y.label = along, "frequency [Hz]"
    figure.key = Key(panel=panel) if len(panel.keyed) > 1 else None
    return figure


def _dot(n_records: int) -> float:
    """Diameter of a dot [pt]: a quarter of the distance of two records, within DOT and its double."""
    return float(np.clip(INCH * STYLE.page / (4 * n_records), DOT, 2 * DOT)) if n_records else DOT


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


def neighbour_means(x: FloatArray, values: FloatArray) -> FloatArray:
    """(n_means, 2) means of `MEANS` neighbours, of the places and of the values; of fewer where there are few.

    Example:
        >>> neighbour_means(np.array([0.0, 1.0]), np.array([2.0, 3.0])).tolist()
        [[0.0, 2.0], [1.0, 3.0]]
    """
    n_means = max(-(-x.size // MEANS), min(x.size, MEANS))
    parts = np.array_split(np.arange(x.size), n_means) if n_means else []
    return np.array([(x[part].mean(), values[part].mean()) for part in parts]).reshape(-1, 2)


def levels_between(x: FloatArray, times: FloatArray, changes: Sequence[tuple[float, float]]) -> FloatArray:
    """(n_levels, 3) from which place to which on which level of ln f; none where nothing changed.

    Args:
        x: (n_found,) places.
        times: (n_found,) rising.
        changes: since when, by which relative change, nan where it is not known.

    Example:
        >>> x = np.arange(4.0)
        >>> levels_between(x, x, [(2.0, np.expm1(0.25))]).tolist()
        [[0.0, 1.0, 0.0], [2.0, 3.0, 0.25]]
    """
    levels = np.cumsum([0.0, *(np.nan_to_num(np.log1p(shift)) for _, shift in changes)])
    stretches = np.split(np.arange(x.size), np.searchsorted(times, [time for time, _ in changes])) if changes else []
    ends = [(x[part[0]], x[part[-1]], level) for part, level in zip(stretches, levels, strict=False) if part.size]
    return np.array(ends).reshape(-1, 3)


def frequencies_in_time(
    tracks: Sequence[TrackLine], changes: Sequence[tuple[float, FloatArray]], *, clock: bool
) -> Chart:
    """Frequencies of all modes, and what is left of each without the causes, with the changes as upright lines.

    Where there are changes, what is left is faint and the levels that they lead to stand out.

    Args:
        tracks: in the order of their numbers.
        changes: since when, and (n_tracks,) the relative change of each frequency, nan where it is not known.
        clock: times are seconds.
    """
    figure = grid_of(2, 1, size=(STYLE.page, 7.0), down=(1.5, 1.0))
    above, below = figure.panels
    since = [time for time, _ in changes]
    every = np.unique(np.concatenate([*(one.times for one in tracks), since]))
    along, label = places_of_records(every, every) if clock else (every, "record")
    dot = _dot(every.size)
    for number, one in enumerate(tracks):
        role = IN_TURN[number % len(IN_TURN)]
        x = along[np.searchsorted(every, one.times)]
        above.dots(x, one.frequency, role, dot=dot)
        above.line(x[:1], [np.nan], role, width=STYLE.thick, label=f"{hertz(float(np.median(one.frequency)))} Hz")
        means = neighbour_means(x, 100 * one.left)
        below.line(means[:, 0], means[:, 1], role, width=STYLE.thin, opacity=STYLE.pale if changes else 1.0)
        for first, last, level in levels_between(x, one.times, [(time, shifts[number]) for time, shifts in changes]):
            below.line([first, last], [100 * level, 100 * level], role, width=STYLE.thick)
    for time in since:
        for panel in (above, below):
            panel.upright(float(along[np.searchsorted(every, time)]), "residual", width=STYLE.thick)
    above.x.labelled, above.x.limits = False, above.x.fitted(along)
    above.y.label, below.y.label = "frequency [Hz]", "frequency without the causes [%]"
    below.x.label, below.x.limits = label, above.x.limits
    figure.key = Key(panel=above) if 0 < len(tracks) <= len(IN_TURN) else None
    return figure
