"""Over time: what was measured, what the model says from the inputs alone, and whether what is left is white."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from modal.names import plot_label
from modal.plots.style import LIGHT, Theme, envelope, head, new_figure
from modal.report.words import fit_text
from okid.arrays import FloatArray
from okid.record import Record
from okid.residuals import ResidualCheck

__all__ = ["measured_against_simulated", "residual_autocorrelation"]


def measured_against_simulated(
    measured: Record,
    simulated: Record,
    *,
    outputs: Sequence[int] | None = None,
    fits: FloatArray | None = None,
    detail: float | None = None,
    theme: Theme = LIGHT,
) -> Figure:
    """One row an output: the whole record on the left, the strongest moment of it on the right.

    Args:
        measured: record.
        simulated: free run of the model on its inputs; of a record without inputs, its one-step prediction.
        outputs: which outputs, all unless given.
        fits: (n_outputs,) written beside each.
        detail: length of the window on the right [s], a twelfth of the record unless given.
        theme: colours.
    """
    chosen = range(measured.n_outputs) if outputs is None else outputs
    figure, axes = new_figure(len(chosen), 2, size=(10.4, 0.5 + 1.45 * len(chosen)), theme=theme, ratios=(2.1, 1.0))
    window = _strongest(measured, detail)
    time = measured.time
    modelled = "model, from the inputs alone" if measured.n_inputs else "model, one step ahead"
    for row, (output, (whole, part)) in enumerate(zip(chosen, axes, strict=True)):
        signals = (
            (measured.outputs[:, output], theme.measured, "measured", 2.4, 0.6),
            (simulated.outputs[:, output], theme.model, modelled, 0.9, 1.0),
        )
        for values, colour, label, width, alpha in signals:
            whole.plot(*envelope(time, values), color=colour, lw=width * 0.75, alpha=alpha, label=label)
            part.plot(time[window], values[window], color=colour, lw=width, alpha=alpha)
        name = plot_label(measured.output_names[output])
        unit = plot_label(measured.output_units[output], limit=12)
        fit = "" if fits is None or not np.isfinite(fits[output]) else f"   fit {fit_text(fits[output])}"
        head(whole, f"{name}{f' [{unit}]' if unit else ''}{fit}", theme=theme, where="left")
        whole.axvspan(time[window][0], time[window][-1], color=theme.muted, alpha=0.10, lw=0)
        whole.set_xlim(time[0], time[-1])
        part.set_xlim(time[window][0], time[window][-1])
        for axis in (whole, part):
            axis.tick_params(labelbottom=row == len(chosen) - 1)
    axes[-1][0].set_xlabel("time [s]")
    axes[-1][1].set_xlabel("time [s], the strongest moment")
    handles, labels = axes[0][0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside upper right", ncols=2, frameon=False, fontsize=8.5, labelcolor=theme.muted
    )
    return figure


def residual_autocorrelation(
    residuals: ResidualCheck, *, output_names: Sequence[str] = (), n_outputs: int = 8, theme: Theme = LIGHT
) -> Figure:
    """Autocorrelation of the one-step residual of each output, with the band in which white noise would stay."""
    figure, axes = new_figure(1, 1, size=(10.4, 2.7), theme=theme)
    axis = axes[0][0]
    lags = np.arange(residuals.autocorrelation.shape[0])
    shown = min(n_outputs, residuals.autocorrelation.shape[1])
    colours = (theme.measured, theme.model, theme.system, theme.residual, theme.doubtful, theme.muted)
    for output in range(shown):
        name = plot_label(output_names[output]) if output_names else f"output {output}"
        offset = 0.7 * (output - (shown - 1) / 2) / shown
        values = residuals.autocorrelation[1:, output]
        axis.vlines(lags[1:] + offset, 0, values, color=colours[output % 6], lw=1.4, label=name)
    limit = residuals.confidence_limit
    axis.axhspan(-limit, limit, color=theme.muted, alpha=0.16, lw=0, label="95 % of white noise")
    axis.axhline(0, color=theme.muted, lw=0.8)
    axis.set_xlabel("lag [samples]")
    axis.set_ylabel("autocorrelation")
    axis.set_xlim(0.3, lags[-1] + 0.7)
    axis.legend(frameon=False, fontsize=8.5, labelcolor=theme.muted, loc="upper right", ncols=4)
    return figure


def _strongest(record: Record, detail: float | None) -> slice:
    length = int(np.clip((detail or record.duration / 12) / record.dt, min(40, record.n_samples), record.n_samples))
    spread = np.nanstd(record.outputs, axis=0)
    spread[spread == 0] = 1.0
    energy = np.nan_to_num((record.outputs - np.nanmean(record.outputs, axis=0)) / spread)
    sums = np.concatenate([[0.0], np.cumsum((energy**2).sum(axis=1))])
    start = int(np.argmax(sums[length:] - sums[:-length]))
    return slice(start, start + length)
