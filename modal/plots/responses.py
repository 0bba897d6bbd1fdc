"""Over frequency and lag: spectra, frequency responses and pulse responses, measured and of the model."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from era.realisation import Realisation
from modal.names import plot_label
from modal.plots.spectra import power_spectra
from modal.plots.style import LIGHT, Theme, head, key, new_panels
from modal.synthesis import MeasuredFrf, frf
from okid.arrays import FloatArray
from okid.markov import MarkovParameters
from okid.record import Record

__all__ = ["frequency_responses", "markov_parameters", "output_spectra"]

LEAST_COHERENCE = 0.5
"""Multiple coherence below which a measured response is drawn pale."""


def frequency_responses(
    measured: MeasuredFrf,
    realisation: Realisation,
    *,
    output_names: Sequence[str] = (),
    input_names: Sequence[str] = (),
    n_pairs: int = 6,
    theme: Theme = LIGHT,
) -> Figure:
    """Magnitude of the frequency response from inputs to outputs, as measured and of the model.

    Args:
        measured: quotient of the spectra of the records.
        realisation: the model, in the units of the records.
        output_names: one an output.
        input_names: one an input.
        n_pairs: how many pairs to show, strongest first.
        theme: colours.
    """
    size = np.abs(measured.frf)
    frequencies = np.linspace(measured.frequencies[1], measured.frequencies[-1], 900)
    model = np.abs(frf(realisation, frequencies))
    strength = np.nan_to_num(np.nanmean(np.log1p(np.nan_to_num(size) / _typical(size)), axis=0))
    pairs = _strongest_pairs(strength, n_pairs)
    figure, axes = new_panels(len(pairs), most_columns=3, width=10.4, height=2.3, theme=theme)
    for axis, (output, input_) in zip(axes, pairs, strict=True):
        values = size[1:, output, input_]
        trusted = np.nan_to_num(measured.multiple_coherence[1:, output]) >= LEAST_COHERENCE
        axis.semilogy(measured.frequencies[1:], values, color=theme.measured, lw=1.1, alpha=0.3)
        axis.semilogy(
            measured.frequencies[1:],
            np.where(trusted, values, np.nan),
            color=theme.measured,
            lw=1.7,
            alpha=0.85,
            label="measured",
        )
        axis.semilogy(frequencies, model[:, output, input_], color=theme.model, lw=1.0, label="model")
        head(axis, _pair_name(output, input_, output_names, input_names), theme=theme, where="left")
        axis.set_xlabel("frequency [Hz]")
        axis.set_xlim(0, measured.frequencies[-1])
    key(axes[0], theme=theme, where="lower left")
    return figure


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
