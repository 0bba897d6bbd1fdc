"""Over frequency and lag: spectra, frequency responses and pulse responses, measured and of the model."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from era.realisation import Realisation
from modal.names import plot_label
from modal.plots.spectra import power_spectra
from modal.plots.style import LIGHT, Theme, head, key, new_panels, style_axes
from modal.synthesis import MeasuredFrf, frf
from okid.arrays import ComplexArray, FloatArray
from okid.markov import MarkovParameters
from okid.record import Record

__all__ = ["frequency_responses", "markov_parameters", "model_grid", "output_spectra"]

N_GRID = 900
"""Frequencies of a synthesised response."""

LEAST_COHERENCE = 0.5
"""Multiple coherence below which a measured response is drawn pale."""


def frequency_responses(
    measured: MeasuredFrf,
    realisation: Realisation,
    *,
    modes: ComplexArray | None = None,
    output_names: Sequence[str] = (),
    input_names: Sequence[str] = (),
    n_pairs: int = 6,
    theme: Theme = LIGHT,
) -> Figure:
    """Magnitude of the frequency response from inputs to outputs, as measured and synthesised, above its coherence.

    Args:
        measured: quotient of the spectra of the records.
        realisation: the model, in the units of the records.
        modes: (N_GRID, n_outputs, n_inputs) synthesised at `model_grid(measured)` from the modes of the system alone.
        output_names: one an output.
        input_names: one an input.
        n_pairs: how many pairs to show, strongest first.
        theme: colours.
    """
    size = np.abs(measured.frf)
    model = np.abs(frf(realisation, model_grid(measured)))
    strength = np.nan_to_num(np.nanmean(np.log1p(np.nan_to_num(size) / _typical(size)), axis=0))
    pairs = _strongest_pairs(strength, n_pairs)
    figure, panels = _pairs_with_coherence(len(pairs), theme)
    for (axis, strip), (output, input_) in zip(panels, pairs, strict=True):
        alone = None if modes is None else np.abs(modes[:, output, input_])
        _draw_response(axis, measured, output, input_, theme)
        if alone is not None:
            axis.semilogy(model_grid(measured), alone, color=theme.system, lw=0.9, ls="--", label="modes of the system")
        axis.semilogy(model_grid(measured), model[:, output, input_], color=theme.model, lw=1.0, label="model")
        head(axis, _pair_name(output, input_, output_names, input_names), theme=theme, where="left")
        strip.plot(
            measured.frequencies[1:],
            measured.multiple_coherence[1:, output],
            color=theme.measured,
            lw=0.8,
            alpha=0.8,
            label="coherence",
        )
        strip.axhline(LEAST_COHERENCE, color=theme.muted, lw=0.6, ls=":")
        strip.set_xlabel("frequency [Hz]")
    handles, labels = panels[0][0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside upper right", ncols=3, frameon=False, fontsize=8.5, labelcolor=theme.muted
    )
    return figure


def model_grid(measured: MeasuredFrf) -> FloatArray:
    """(N_GRID,) frequencies at which a synthesised response is drawn over a measured one [Hz]."""
    return np.linspace(measured.frequencies[1], measured.frequencies[-1], N_GRID)


def _pairs_with_coherence(n_pairs: int, theme: Theme) -> tuple[Figure, list[tuple[Axes, Axes]]]:
    """Panels for the pairs, three in a row, each with a strip for the coherence below it."""
    n_columns = min(3, max(1, n_pairs))
    n_rows = max(1, -(-n_pairs // n_columns))
    figure = Figure(figsize=(10.4, 0.5 + 2.9 * n_rows), layout="constrained", facecolor=theme.paper)
    axes = figure.subplots(
        2 * n_rows, n_columns, squeeze=False, sharex=True, height_ratios=(3.6, 1.0) * n_rows
    ).tolist()
    panels = []
    for number in range(n_rows * n_columns):
        row, column = 2 * (number // n_columns), number % n_columns
        above, below = axes[row][column], axes[row + 1][column]
        for axis in (above, below):
            style_axes(axis, theme)
            axis.set_visible(number < n_pairs)
        above.tick_params(labelbottom=False)
        below.tick_params(labelbottom=True)
        below.set_ylim(-0.03, 1.06)
        below.set_yticks([0, 1])
        below.set_ylabel("coherence" if column == 0 else "")
        panels.append((above, below))
    return figure, panels[:n_pairs]


def _draw_response(axis: Axes, measured: MeasuredFrf, output: int, input_: int, theme: Theme) -> None:
    """The measured magnitude, pale where the coherence says that it is not to be trusted."""
    values = np.abs(measured.frf)[1:, output, input_]
    trusted = np.nan_to_num(measured.multiple_coherence[1:, output]) >= LEAST_COHERENCE
    frequencies = measured.frequencies[1:]
    axis.semilogy(
        frequencies,
        np.where(trusted, values, np.nan),
        color=theme.measured,
        lw=1.7,
        alpha=0.85,
        label="measured",
    )
    axis.semilogy(frequencies, values, color=theme.measured, lw=1.1, alpha=0.3, label="_with measured")
    axis.set_xlim(0, measured.frequencies[-1])


def output_spectra(
    measured: Sequence[Record],
    simulated: Sequence[Record],
    *,
    frequencies: Sequence[float] = (),
    outputs: Sequence[int] | None = None,
    theme: Theme = LIGHT,
) -> Figure:
    """Power spectral density of each output, measured and simulated; `frequencies` [Hz] are marked."""
    chosen = list(range(measured[0].n_outputs)) if outputs is None else list(outputs)
    figure, axes = new_panels(len(chosen), most_columns=3, width=10.4, height=2.3, theme=theme)
    frequency, power = power_spectra(measured)
    _, power_simulated = power_spectra(simulated)
    for axis, output in zip(axes, chosen, strict=True):
        for values, colour, label, width in (
            (power[1:, output], theme.measured, "measured", 1.6),
            (power_simulated[1:, output], theme.model, "model", 1.0),
        ):
            axis.semilogy(frequency[1:], np.where(values > 0, values, np.nan), color=colour, lw=width, label=label)
        for mark in frequencies:
            axis.axvline(mark, color=theme.system, lw=0.8, alpha=0.5)
        unit = plot_label(measured[0].output_units[output], limit=12)
        head(axis, plot_label(measured[0].output_names[output]), theme=theme, where="left")
        axis.set_ylabel(f"({unit})²/Hz" if unit else "power / Hz")
        axis.set_xlabel("frequency [Hz]")
        axis.set_xlim(0, frequency[-1])
        top = float(np.nanmax(power[1:, output], initial=0.0))
        if top > 0:
            axis.set_ylim(top * 1e-7, top * 4)
    key(axes[0], theme=theme, where="lower left")
    return figure


def markov_parameters(
    markov: MarkovParameters,
    model: FloatArray | None = None,
    *,
    output_names: Sequence[str] = (),
    input_names: Sequence[str] = (),
    n_pairs: int = 6,
    theme: Theme = LIGHT,
) -> Figure:
    """Pulse responses: as recovered from the observer, and as the realisation has them.

    Args:
        markov: recovered.
        model: (n_lags + 1, n_outputs, n_inputs) of the realisation.
        output_names: one an output.
        input_names: one an input.
        n_pairs: how many pairs to show, strongest (relative to the scales of their channels) first.
        theme: colours.
    """
    strength = np.linalg.norm(markov.system, axis=0) * markov.input_scale / markov.output_scale[:, np.newaxis]
    pairs = _strongest_pairs(strength, n_pairs)
    figure, axes = new_panels(len(pairs), most_columns=3, width=10.4, height=2.2, theme=theme)
    lag = np.arange(markov.n_lags + 1) * markov.dt
    for axis, (output, input_) in zip(axes, pairs, strict=True):
        axis.plot(lag, markov.system[:, output, input_], color=theme.measured, lw=1.5, alpha=0.75, label="recovered")
        if model is not None:
            axis.plot(lag[: len(model)], model[: len(lag), output, input_], color=theme.model, lw=0.9, label="model")
        head(axis, _pair_name(output, input_, output_names, input_names), theme=theme, where="left")
        axis.set_xlabel("lag [s]")
        axis.set_xlim(0, lag[-1])
    key(axes[0], theme=theme, where="upper right")
    return figure


def _typical(size: FloatArray) -> FloatArray:
    """(n_outputs, 1) a size of each output's responses, so that no unit outweighs another."""
    typical = np.nanmax(np.nan_to_num(size), axis=(0, 2))[:, np.newaxis]
    return np.asarray(np.where(typical > 0, typical, 1.0))


def _strongest_pairs(strength: FloatArray, n_pairs: int) -> list[tuple[int, int]]:
    """(output, input) of the largest values of an (n_outputs, n_inputs) array, in the order of the channels."""
    order = np.argsort(-strength, axis=None, kind="stable")[:n_pairs]
    return sorted((int(index) // strength.shape[1], int(index) % strength.shape[1]) for index in order)


def _pair_name(output: int, input_: int, output_names: Sequence[str], input_names: Sequence[str]) -> str:
    into = plot_label(input_names[input_], limit=16) if input_names else f"input {input_}"
    out = plot_label(output_names[output], limit=16) if output_names else f"output {output}"
    return f"{into} → {out}"
