"""Over time: what was measured, what the model says from the inputs alone, and whether what is left is white."""

from collections.abc import Sequence

import numpy as np

from modal.plots.layout import Chart, Key, grid_of
from modal.plots.panels import IN_TURN, STYLE, Panel, Role, envelope
from modal.wording.names import plot_label
from modal.wording.numbers import fit_text
from okid.arrays import FloatArray
from okid.record import Record
from okid.residuals import ResidualCheck

__all__ = ["mark_moment", "measured_against_simulated", "residual_autocorrelation"]


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
    figure = grid_of(1, 1, size=(STYLE.page, 2.9))
    panel = figure.panels[0]
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
