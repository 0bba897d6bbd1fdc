"""Over frequency and lag: spectra, frequency responses and pulse responses, measured and of the model."""

from collections.abc import Sequence

import numpy as np

from era.realisation import Realisation
from modal.modes.response_synthesis import MeasuredFrf, frf
from modal.plots.chart import Chart, Key, grid_of, row_of
from modal.plots.panels import STYLE, Panel, Role
from modal.sections.discrepancy_stages import power_spectra
from modal.wording.text import plot_label
from okid.arrays import ComplexArray, FloatArray
from okid.markov import MarkovParameters
from okid.record import Record

N_GRID = 900
"""Synthesise a response at so many frequencies."""

LEAST_COHERENCE = 0.5
"""Draw a measured response pale where the multiple coherence is lower."""


def response_chart(
    measured: MeasuredFrf,
    realisation: Realisation,
    *,
    modes: ComplexArray | None = None,
    output_names: Sequence[str] = (),
    input_names: Sequence[str] = (),
    n_pairs: int = 6,
) -> Chart:
    """Magnitude of the frequency response from inputs to outputs, as measured and synthesised, above its coherence.

    Args:
        measured: quotient of the spectra of the records.
        realisation: the model, in the units of the records.
        modes: (N_GRID, n_outputs, n_inputs) synthesised at `model_grid(measured)` from the modes of the system alone.
        output_names: one an output.
        input_names: one an input.
        n_pairs: how many pairs to show, strongest first.
    """
    size = np.abs(measured.frf)
    model = np.abs(frf(realisation, model_grid(measured)))
    strength = np.nan_to_num(np.nanmean(np.log1p(np.nan_to_num(size) / _typical(size)), axis=0))
    pairs = _strongest_pairs(strength, n_pairs)
    figure, panels = _pairs_with_coherence(len(pairs))
    for (panel, strip), (output, input_) in zip(panels, pairs, strict=True):
        _draw_response(panel, measured, output, input_)
        if modes is not None:
            alone = np.abs(modes[:, output, input_])
            panel.line(
                model_grid(measured), alone, "system", width=STYLE.thin, dash="dashed", label="modes of the system"
            )
        panel.line(model_grid(measured), model[:, output, input_], "model", width=STYLE.thin, label="model")
        panel.head = _pair_name(output, input_, output_names, input_names)
        coherence = measured.multiple_coherence[1:, output]
        strip.line(
            measured.frequencies[1:], coherence, "measured", width=STYLE.thin, opacity=STYLE.strong, label="coherence"
        )
        strip.across(LEAST_COHERENCE, "muted", width=STYLE.thin, dash="dotted")
        strip.x.label = "frequency [Hz]"
        strip.x.limits = panel.x.limits
    figure.key = Key(panel=panels[0][0])
    return figure


def model_grid(measured: MeasuredFrf) -> FloatArray:
    """(N_GRID,) frequencies at which a synthesised response is drawn over a measured one [Hz]."""
    return np.linspace(measured.frequencies[1], measured.frequencies[-1], N_GRID)


def _pairs_with_coherence(n_pairs: int) -> tuple[Chart, list[tuple[Panel, Panel]]]:
    """Panels for the pairs, three in a row, each with a strip for the coherence below it."""
    n_columns = min(3, max(1, n_pairs))
    n_rows = max(1, -(-n_pairs // n_columns))
    figure = grid_of(2 * n_rows, n_columns, size=(STYLE.page, 0.5 + 2.9 * n_rows), down=(3.6, 1.0) * n_rows)
    panels = []
    for number in range(n_rows * n_columns):
        row, column = 2 * (number // n_columns), number % n_columns
        if number >= n_pairs:
            figure.rows[row][column] = figure.rows[row + 1][column] = None
            continue
        above, below = Panel(), Panel()
        figure.rows[row][column], figure.rows[row + 1][column] = above, below
        above.x.labelled, above.y.log = False, True
        below.y.limits, below.y.ticks = (-0.03, 1.06), [(0.0, "0"), (1.0, "1")]
        below.y.label = "coherence" if column == 0 else ""
        panels.append((above, below))
    return figure, panels


def _draw_response(panel: Panel, measured: MeasuredFrf, output: int, input_: int) -> None:
    """The measured magnitude, pale where the coherence says that it is not to be trusted."""
    values = np.abs(measured.frf)[1:, output, input_]
    trusted = np.nan_to_num(measured.multiple_coherence[1:, output], nan=1.0) >= LEAST_COHERENCE
    frequencies = measured.frequencies[1:]
    panel.line(
        frequencies,
        np.where(trusted, values, np.nan),
        "measured",
        width=STYLE.under,
        opacity=STYLE.strong,
        label="measured",
    )
    panel.line(frequencies, values, "measured", opacity=STYLE.pale, follows="measured")
    panel.x.limits = (0.0, float(measured.frequencies[-1]))


def output_spectra(
    measured: Sequence[Record],
    simulated: Sequence[Record],
    *,
    frequencies: Sequence[float] = (),
    outputs: Sequence[int] | None = None,
) -> Chart:
    """Power spectral density of each output, measured and simulated; `frequencies` [Hz] are marked."""
    chosen = list(range(measured[0].n_outputs)) if outputs is None else list(outputs)
    figure = row_of(len(chosen), most_columns=3, width=STYLE.page, height=2.3)
    frequency, power = power_spectra(measured)
    _, power_simulated = power_spectra(simulated)
    for panel, output in zip(figure.panels, chosen, strict=True):
        spectra: tuple[tuple[FloatArray, Role, str, float], ...] = (
            (power[1:, output], "measured", "measured", STYLE.under),
            (power_simulated[1:, output], "model", "model", STYLE.thin),
        )
        for values, role, label, width in spectra:
            panel.line(frequency[1:], np.where(values > 0, values, np.nan), role, width=width, label=label)
        for mark in frequencies:
            panel.upright(mark, "system", width=STYLE.thin, opacity=STYLE.half)
        panel.head = plot_label(measured[0].output_names[output])
        panel.x.label, panel.y.label = "frequency [Hz]", density_label(measured[0].output_units[output])
        panel.x.limits, panel.y.log = (0.0, float(frequency[-1])), True
        top = float(np.nanmax(power[1:, output], initial=0.0))
        if top > 0:
            panel.y.limits = (top * 1e-7, top * 4)
    figure.panels[0].key = "lower left"
    return figure


def markov_parameters(
    markov: MarkovParameters,
    model: FloatArray,
    *,
    output_names: Sequence[str] = (),
    input_names: Sequence[str] = (),
) -> Chart:
    """Pulse responses of the six strongest pairs, relative to the scales of their channels.

    Args:
        markov: recovered from the observer.
        model: (n_lags + 1, n_outputs, n_inputs) of the realisation.
        output_names: one an output.
        input_names: one an input.
    """
    strength = np.linalg.norm(markov.system, axis=0) * markov.input_scale / markov.output_scale[:, np.newaxis]
    pairs = _strongest_pairs(strength, 6)
    figure = row_of(len(pairs), most_columns=3, width=STYLE.page, height=2.2)
    lag = np.arange(markov.n_lags + 1) * markov.dt
    for panel, (output, input_) in zip(figure.panels, pairs, strict=True):
        panel.line(
            lag,
            markov.system[:, output, input_],
            "measured",
            width=STYLE.thick,
            opacity=STYLE.strong,
            label="recovered",
        )
        panel.line(lag[: len(model)], model[: len(lag), output, input_], "model", width=STYLE.thin, label="model")
        panel.head = _pair_name(output, input_, output_names, input_names)
        panel.x.label, panel.x.limits = "lag [s]", (0.0, float(lag[-1]))
    figure.panels[0].key = "upper right"
    return figure


def density_label(unit: str) -> str:
    """What the axis of a power spectral density is called.

    Example:
        >>> density_label("m"), density_label("m/s^2"), density_label("")
        ('m²/Hz', '(m/s^2)²/Hz', 'power / Hz')
    """
    short = plot_label(unit, limit=12)
    if not short:
        return "power / Hz"
    return f"({short})²/Hz" if set(unit) & set("/ ^*") else f"{short}²/Hz"


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
