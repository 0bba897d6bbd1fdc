"""The pages "Observer fit", what the model makes of what was measured and what is left over, and "Validation".

The twin of the first is the page "Responses", where no record was identified but a table of frequency responses.

"Validation" sets the model against what was measured, over frequency and over time, output by output. Over time the
model runs freely: it sees the inputs alone. Over frequency its response is set against the quotient of the spectra,
which knows nothing of the model, with the coherence that says where that quotient can be believed. Without inputs the
spectrum of the outputs takes the place of the response.
"""

from collections.abc import Iterable
from typing import Any, Final

import numpy as np

from modal.identification.result import Identification
from modal.modes.response_synthesis import tabled_frf
from modal.plots.chart import grid_of, one_panel
from modal.plots.histories import residual_autocorrelation
from modal.plots.panels import IN_TURN, STYLE, Panel
from modal.plots.responses import density_label
from modal.plots.results import measured_responses
from modal.recording.figure import (
    Colour,
    Palette,
    Pane,
    RecordingStream,
    document_view,
    log_chart,
    plot_view,
    rrb,
    series_view,
    tabs,
)
from modal.recording.plan import (
    DataPlan,
    Gathered,
    Plan,
    Views,
    WordLimits,
    cell,
    choices_text,
    fit_page_text,
    known,
    label,
    log_table,
    log_text,
    name_with_unit,
    table,
    unit_cell,
)
from modal.recording.series import Line, log_lines, log_sequence, time_axis
from modal.sections.words import modes_headline
from modal.wording.text import fit_text
from okid.arrays import ComplexArray, FloatArray
from okid.frequency_response import FrequencyResponse

FIT_TEXT: Final = "fit/text"
MARKOV: Final = Pane("fit/markov/plot", 480.0, 290.0)
WHITENESS: Final = Pane("fit/whiteness/plot", 400.0, 220.0)
PREDICTED: Final[Colour] = (120, 205, 200)
ONE_STEP: Final[Colour] = (250, 170, 160)
"""Draw what is predicted one step ahead, and what that leaves, in these colours."""


def log_fit_page(identification: Identification, recording: RecordingStream, plan: Plan) -> None:
    """Predicted and simulated outputs with their residuals, fit table, Markov parameters, whiteness."""
    times = time_axis(identification.records, plan.data)
    for output, path in enumerate(plan.fit_paths):
        _log_output(identification, recording, plan, times=times, output=output, path=path)
    log_text(recording, FIT_TEXT, fit_page_text(identification, plan))
    _log_numbers(identification, recording)
    _log_markov(identification, recording)
    _log_whiteness(identification, recording)


def _log_output(
    identification: Identification,
    recording: RecordingStream,
    plan: Plan,
    *,
    times: FloatArray,
    output: int,
    path: str,
) -> None:
    measured = [record.outputs[:, output] for record in identification.records]
    predicted = [record.outputs[:, output] for record in identification.predicted]
    simulated = [record.outputs[:, output] for record in identification.simulated]
    driven = identification.channels.n_inputs > 0
    colour, width = (PREDICTED, 1.0) if driven else (Palette.ORANGE, 1.3)
    models = [Line(channels=predicted, name="one step ahead", colour=colour, width=width)]
    residuals = [
        Line(channels=_less(measured, predicted), name="measured - one step ahead", colour=ONE_STEP, width=1.0)
    ]
    if driven:  # without inputs nothing runs freely: what is called simulated is one step
        models.append(Line(channels=simulated, name="simulated", colour=Palette.ORANGE, width=1.3))
        left = _less(measured, simulated)
        residuals.insert(0, Line(channels=left, name="measured - simulated", colour=Palette.RED, width=1.0))
    log_lines(recording, f"{path}/model", times, models, plan=plan.data)
    log_lines(recording, f"{path}/residual", times, residuals, plan=plan.data)


def _less(first: list[FloatArray], second: list[FloatArray]) -> list[FloatArray]:
    return [a - b for a, b in zip(first, second, strict=True)]


def _log_numbers(identification: Identification, recording: RecordingStream) -> None:
    fit, first = identification.fit, identification.channels
    outputs: dict[str, Iterable[object]] = {
        "name": first.output_names,
        "unit": first.output_units,
        "cross_validated": fit.cross_validated,
        "whole": fit.whole,
        "one_step": fit.one_step,
    }
    log_table(recording, "fit/outputs", "output", np.arange(1, first.n_outputs + 1), outputs)


def _log_markov(identification: Identification, recording: RecordingStream) -> None:
    """All of them as numbers, the strongest of each of a few outputs as lines, scaled by the size of the channels."""
    markov, first = identification.markov, identification.channels
    lags = np.arange(markov.n_lags + 1.0)
    if markov.n_inputs:
        system, into = markov.system, first.input_names
        scaled = system * markov.input_scale / markov.output_scale[:, np.newaxis]
        title = "response to a pulse of one sample"
    elif markov.gain is not None:
        system, into = markov.gain, tuple(f"residual of {name}" for name in first.output_names)
        scaled = system * markov.output_scale / markov.output_scale[:, np.newaxis]
        title = "response to a pulse of the residual"
    else:
        return
    out = first.output_names
    names = [f"{label(y, 60)} / {label(u, 60)}" for y in out for u in into]
    numbers = system.reshape(lags.size, -1)
    log_sequence(recording, "fit/markov/numbers", timeline="lag", index=lags, values=numbers, names=names)
    strength = np.abs(scaled[1:]).max(axis=0)
    pairs = [(i, int(strength[i].argmax())) for i in np.argsort(-strength.max(axis=1), kind="stable")[:4]]
    chart, panel = one_panel(STYLE.page, STYLE.page)
    for (i, j), role in zip(pairs, IN_TURN, strict=False):
        panel.line(lags * markov.dt, scaled[:, i, j], role, label=f"{label(out[i], 11)} / {label(into[j], 11)}")
    panel.x.label, panel.y.label, panel.key = "time [s]", title, "best"
    panel.x.limits = (0.0, float(lags[-1] * markov.dt))
    log_chart(recording, MARKOV, chart)


def _log_whiteness(identification: Identification, recording: RecordingStream) -> None:
    residuals, first = identification.residuals, identification.channels
    if residuals is None:
        return
    correlation = residuals.autocorrelation
    lags = np.arange(float(correlation.shape[0]))
    names = [label(name, 60) for name in first.output_names]
    log_sequence(recording, "fit/whiteness/numbers", timeline="lag", index=lags, values=correlation, names=names)
    if correlation[1:].size:
        short = [label(name, 14) for name in first.output_names]
        chart = residual_autocorrelation(residuals, output_names=short, n_outputs=Views.OUTPUTS)
        log_chart(recording, WHITENESS, chart)


def fit_page(identification: Identification, plan: Plan) -> Any:
    """Series to the left, a tab for all outputs and one for each; words, Markov parameters, whiteness to the right."""
    left: list[Any] = [_all_runs(identification, plan)]
    if len(plan.data.shown_outputs) > 1:
        left += [_one_run(identification, plan, i) for i in plan.data.shown_outputs]
    series = tabs(left, "Outputs")
    words = [document_view(FIT_TEXT, "Fit")]
    if identification.markov.n_inputs or identification.markov.gain is not None:
        words.append(plot_view(MARKOV, "Markov parameters"))
    words.append(plot_view(WHITENESS, "Whiteness"))
    right = rrb.Vertical(*words, row_shares=[1.2, 1.0, 0.9][: len(words)], name="Fit in words")
    return rrb.Horizontal(series, right, column_shares=[2.15, 1.0], name="Observer fit")


def inputs_view(plan: DataPlan) -> list[Any]:
    """The inputs in one view; nothing where there is none."""
    if not plan.input_paths:
        return []
    n_inputs = len(plan.input_paths)
    name = "Input" if n_inputs == 1 else "Inputs"
    if n_inputs > Views.INPUTS:
        name = f"Inputs, the first {Views.INPUTS} of {n_inputs}"
    return [series_view(f"{plan.root}/input", name, list(plan.input_paths[: Views.INPUTS]))]


def run_view(identification: Identification, plan: Plan, output: int, *, legend: bool = True) -> Any:
    """One output over the whole time, and what the model leaves of it: simulated over measured would hide it."""
    fit = identification.fit.cross_validated[output]
    first = identification.channels
    name = name_with_unit(first.output_names[output], first.output_units[output])
    title = f"{name}: fit {fit_text(fit)}" if np.isfinite(fit) else name
    lines = [plan.data.output_paths[output], "$origin/residual/**"]
    return series_view(plan.fit_paths[output], title, lines, legend=legend)


def _all_runs(identification: Identification, plan: Plan) -> Any:
    """Inputs over all outputs: a few with their windows, many in two columns."""
    outputs = plan.data.shown_outputs
    if len(outputs) == 1:
        return _one_run(identification, plan, 0)
    rows: list[Any] = inputs_view(plan.data)
    shares = [0.8] * len(rows)
    if len(outputs) <= 4:
        for i in outputs:
            pair = (run_view(identification, plan, i, legend=i == 0), _window(identification, plan, i))
            rows.append(rrb.Horizontal(*pair, column_shares=[1.5, 1.0], name=label(_name(identification, i))))
        shares += [1.0] * len(outputs)
    else:
        views = [run_view(identification, plan, i, legend=i == 0) for i in outputs]
        rows.append(rrb.Grid(*views, grid_columns=2, name="Outputs"))
        shares = [0.5] * len(shares) + [0.75 * -(-len(outputs) // 2)]
    return rrb.Vertical(*rows, row_shares=shares, name="All outputs")


def _one_run(identification: Identification, plan: Plan, output: int) -> Any:
    rows = [*inputs_view(plan.data), run_view(identification, plan, output), _window(identification, plan, output)]
    shares = [0.7, 1.2, 1.8][-len(rows) :]
    return rrb.Vertical(*rows, row_shares=shares, name=label(_name(identification, output), 18))


def _window(identification: Identification, plan: Plan, output: int) -> Any:
    """The same close by: a window that follows the cursor."""
    at = rrb.TimeRangeBoundary
    ends = (at.cursor_relative(seconds=-0.15 * plan.window), at.cursor_relative(seconds=0.85 * plan.window))
    title = f"{label(_name(identification, output))} at the cursor, measured and simulated"
    lines = [plan.data.output_paths[output], "$origin/model/**"]
    view = series_view(plan.fit_paths[output], title, lines)
    view.properties["TimeAxis"] = rrb.TimeAxis(link="Independent", view_range=rrb.TimeRange(start=ends[0], end=ends[1]))
    return view


def _name(identification: Identification, output: int) -> str:
    return identification.channels.output_names[output]


RESPONSES: Final = Pane("responses/plot", 1100.0, 820.0)
TEXT: Final = "responses/text"


def log_response_page(identification: Identification, response: FrequencyResponse, recording: RecordingStream) -> None:
    """The responses with the model over them, and what was found and chosen in words."""
    log_chart(recording, RESPONSES, measured_responses(identification, tabled_frf(response)))
    flat = response.response.reshape(response.n_lines, -1)
    columns: dict[str, Iterable[object]] = {
        "frequency": response.frequencies,
        "real": flat.real.tolist(),
        "imaginary": flat.imag.tolist(),
    }
    log_table(recording, "responses/lines", "frequency_line", np.arange(1, response.n_lines + 1), columns)
    parts = [f"### {modes_headline(identification)}"]
    parts += [f"**Read this:** {cell(warning)}" for warning in identification.warnings]
    parts.append(choices_text(identification))
    log_text(recording, TEXT, "\n\n".join(parts))


def response_page() -> Any:
    """The page: responses on the left, words on the right."""
    views = plot_view(RESPONSES, "Measured and synthesised"), document_view(TEXT, "Found and chosen")
    return rrb.Horizontal(*views, column_shares=[2.2, 1.0], name="Responses")


class ValidationLimits:
    """How much of a validation is drawn."""

    DECADES: Final = 5.0
    """Show so many decades of a magnitude; of a power spectrum, which is its square, twice as many."""


def response_pane(output: int, source: int) -> Pane:
    """Where magnitude, phase and coherence of an output to an input are drawn."""
    return Pane(f"validation/response/{output + 1:02d}/{source + 1:02d}/plot", 470.0, 740.0)


def overview_columns(n_outputs: int) -> int:
    """Columns in which the outputs stand side by side."""
    return 1 if n_outputs < 3 else 2 if n_outputs < 7 else 3


def magnitude_pane(output: int, n_outputs: int) -> Pane:
    """Where the magnitude of an output's response, or its spectrum, is drawn beside those of the others.

    As large as its place on a common screen, or texts would be too large for it.
    """
    n_columns = overview_columns(n_outputs)
    n_rows = -(-n_outputs // n_columns)
    return Pane(f"validation/overview/{output + 1:02d}/plot", 1040.0 / n_columns, max(150.0, 780.0 / n_rows - 30.0))


def density_pane(output: int) -> Pane:
    """Where the spectrum of an output is drawn by itself, when there are no inputs."""
    return Pane(f"validation/spectrum/{output + 1:02d}/plot", 470.0, 740.0)


def drawn_inputs(evidence: Gathered, plan: Plan, output: int) -> tuple[int, ...]:
    """Inputs whose response at this output is drawn, the one that moves it most first; at least one, not too many.

    How much an input moves an output is told by its ordinary coherence, mean over the lines.
    """
    if evidence.measured is None:
        return ()
    n_drawn = min(Views.INPUTS, max(1, 16 // len(plan.data.shown_outputs)))  # pairs, shared by the outputs
    strength = np.nan_to_num(evidence.measured.ordinary_coherence[:, output]).mean(axis=0)
    return tuple(np.argsort(-strength, kind="stable")[:n_drawn].tolist())


def two_line_limits(
    seen: FloatArray, made: FloatArray, *, decades: float = ValidationLimits.DECADES
) -> tuple[float, float]:
    """Down to what was measured, as a zero of the model goes down to nothing; up to the peaks of both.

    A pole on the unit circle has no peak: the model may rise by some decades above what was measured, and no more.
    """
    known = [values[np.isfinite(values) & (values > 0)] for values in (seen, made)]
    first = next((values for values in known if values.size), np.array([0.1, 10.0]))
    high = float(first.max())
    # a peak of the model may rise to so many times the largest measured value
    high = max(high, min(100.0 * high, max(float(values.max(initial=0.0)) for values in known)))
    return max(float(first.min()), high * 10.0**-decades), high


def validation_text(identification: Identification, evidence: Gathered) -> str:
    """What the pictures beside it show, on which rows, and the numbers of each output."""
    first = identification.channels
    if first.n_inputs:
        title = "### Free run on all rows"
        meaning = (
            "The lines show a free run: the model sees the inputs alone and never the outputs. It runs over **all "
            "rows**, which the final model was fitted to as well. The honest score is beside it: **cross-validated**, "
            "of models that were not fitted to the rows they are scored on."
        )
    else:
        title = "### One step ahead, on all rows"
        meaning = (
            "No input was measured, so nothing can run freely: the lines show the prediction **one step ahead**, over "
            "all rows. The pictures over frequency set the spectrum of each output against that of the model, driven "
            "by its own one-step errors."
        )
    sizes = "Left over: root mean square of what the lines leave of an output. Output: its standard deviation."
    parts = [title, meaning, table(*_table(identification)), sizes]
    measured = evidence.measured
    if measured is not None:
        parts.append(
            f"Response: H1 from {measured.n_averages} segments of {measured.frequencies[1]:.4g} Hz resolution; "
            "a narrower resonance is smeared. Where the coherence is low, the measured line is not to be "
            "trusted, and the two need not agree."
        )
    elif first.n_inputs:
        parts.append("The records are too short for a measured response.")
    return "\n\n".join(parts)


def _table(identification: Identification) -> tuple[list[str], list[list[str]]]:
    first, fit = identification.channels, identification.fit
    driven = bool(first.n_inputs)
    head = ["output", "unit", "cross-validated", "all rows" if driven else "one step", "left over", "output"]
    rows = []
    for i in range(min(first.n_outputs, WordLimits.LISTED)):
        left, whole = _sizes(identification, i)
        rows.append(
            [
                cell(first.output_names[i], 24),
                unit_cell(first.output_units[i]),
                f"**{known(100 * fit.cross_validated[i], '.1f', ' %')}**",
                known(100 * (fit.whole[i] if driven else fit.one_step[i]), ".1f", " %"),
                known(left, ".3g"),
                known(whole, ".3g"),
            ]
        )
    return head, rows


def _sizes(identification: Identification, output: int) -> tuple[float, float]:
    """Root mean square of what the run leaves of an output, and the output's deviation; nan where nothing is known."""
    measured = np.concatenate([record.outputs[:, output] for record in identification.records])
    simulated = np.concatenate([record.outputs[:, output] for record in identification.simulated])
    left = measured - simulated
    there = np.isfinite(left)
    if not there.any():
        return np.nan, np.nan
    return float(np.sqrt(np.mean(left[there] ** 2))), float(np.std(measured[there]))


VALIDATION_TEXT: Final = "validation/text"


def log_validation_page(
    identification: Identification, recording: RecordingStream, plan: Plan, evidence: Gathered
) -> None:
    """Responses or spectra of the shown outputs as pictures, those of all as numbers, and what they say."""
    log_text(recording, VALIDATION_TEXT, validation_text(identification, evidence))
    _log_responses(recording, plan, evidence)
    _log_densities(recording, plan, evidence)
    for output in plan.data.shown_outputs:
        sources = drawn_inputs(evidence, plan, output)
        for source in sources:
            _draw_response(identification, recording, evidence, output=output, source=source)
        pane = magnitude_pane(output, len(plan.data.shown_outputs))
        if sources:
            _draw_magnitude(identification, recording, evidence, pane, output=output, source=sources[0])
        elif evidence.model_density.size:
            for where in (pane, density_pane(output)):
                _draw_density(identification, recording, evidence, where, output=output)


def _log_responses(recording: RecordingStream, plan: Plan, evidence: Gathered) -> None:
    """Of all outputs; one value an input in each cell, none where the inputs cannot be told apart."""
    if evidence.measured is None:
        return
    measured = evidence.measured
    lines = np.arange(1, measured.frequencies.size + 1)
    for output in range(len(plan.fit_paths)):
        columns: dict[str, Iterable[object]] = {
            "frequency": measured.frequencies,
            "measured_real": measured.frf[:, output].real,
            "measured_imaginary": measured.frf[:, output].imag,
            "synthesised_real": evidence.synthesised[:, output].real,
            "synthesised_imaginary": evidence.synthesised[:, output].imag,
            # an input without power at a line explains nothing there
            "ordinary_coherence": np.nan_to_num(measured.ordinary_coherence[:, output]),
            "multiple_coherence": measured.multiple_coherence[:, output],
        }
        log_table(recording, f"validation/response/{output + 1:02d}/numbers", "frequency_line", lines, columns)
        if evidence.fine_frequencies.size > measured.frequencies.size:
            between: dict[str, Iterable[object]] = {
                "frequency": evidence.fine_frequencies,
                "synthesised_real": evidence.fine[:, output].real,
                "synthesised_imaginary": evidence.fine[:, output].imag,
            }
            at = np.arange(1, evidence.fine_frequencies.size + 1)
            log_table(recording, f"validation/response/{output + 1:02d}/model", "frequency_line", at, between)


def _log_densities(recording: RecordingStream, plan: Plan, evidence: Gathered) -> None:
    density = evidence.model_density
    if not density.size:
        return
    n_inputs = len(plan.data.input_paths)
    columns: dict[str, Iterable[object]] = {
        "frequency": evidence.density_frequencies,
        "measured": evidence.quality.densities[: density.shape[0], n_inputs:],
        "model": density,
    }
    lines = np.arange(1, density.shape[0] + 1)
    log_table(recording, "validation/spectrum/numbers", "frequency_line", lines, columns)


def _draw_response(
    identification: Identification, recording: RecordingStream, evidence: Gathered, *, output: int, source: int
) -> None:
    """Magnitude over phase over coherence, one axis of frequency."""
    measured = evidence.measured
    if measured is None:
        return
    chart = grid_of(3, 1, size=(STYLE.page, STYLE.page), down=(2.0, 1.2, 1.0))
    magnitude, phase, coherence = chart.panels
    _fill_magnitude(magnitude, identification, evidence, output=output, source=source)
    seen, made = measured.frf[:, output, source], evidence.fine[:, output, source]
    phase.line(measured.frequencies, _phase(seen), "measured", width=STYLE.under, label="measured")
    phase.line(evidence.fine_frequencies, _phase(made), "model", width=STYLE.thin, label="synthesised")
    phase.y.label, phase.y.limits = "phase [°]", (-190.0, 190.0)
    phase.y.ticks = [(float(angle), f"{angle}".replace("-", "−")) for angle in (-180, -90, 0, 90, 180)]
    several = measured.ordinary_coherence.shape[2] > 1
    if several:
        ordinary = measured.ordinary_coherence[:, output, source]
        coherence.line(measured.frequencies, ordinary, "muted", width=STYLE.thin, label="with this input")
    name = "with all inputs" if several else "with the input"
    coherence.line(measured.frequencies, measured.multiple_coherence[:, output], "ink", label=name)
    coherence.y.label, coherence.y.limits, coherence.key = "coherence", (0.0, 1.04), "best"
    for panel in chart.panels:
        panel.x.limits, panel.x.labelled = magnitude.x.limits, panel is coherence
    magnitude.x.label, coherence.x.label = "", magnitude.x.label
    log_chart(recording, response_pane(output, source), chart)


def _fill_magnitude(
    panel: Panel, identification: Identification, evidence: Gathered, *, output: int, source: int
) -> None:
    first, measured = identification.channels, evidence.measured
    if measured is None:
        return
    units = (first.output_units[output], first.input_units[source])
    panel.y.label = f"magnitude [{label(units[0], 9)} per {label(units[1], 7)}]" if all(units) else "magnitude"
    seen, made = np.abs(measured.frf[:, output, source]), np.abs(evidence.fine[:, output, source])
    _fill_pair(panel, (measured.frequencies, seen), (evidence.fine_frequencies, made), "synthesised")


def _draw_magnitude(
    identification: Identification,
    recording: RecordingStream,
    evidence: Gathered,
    pane: Pane,
    *,
    output: int,
    source: int,
) -> None:
    chart, panel = one_panel(STYLE.page, STYLE.page)
    _fill_magnitude(panel, identification, evidence, output=output, source=source)
    log_chart(recording, pane, chart)


def _draw_density(
    identification: Identification, recording: RecordingStream, evidence: Gathered, pane: Pane, *, output: int
) -> None:
    first, model = identification.channels, evidence.model_density[:, output]
    seen = evidence.quality.densities[: model.size, first.n_inputs + output]
    chart, panel = one_panel(STYLE.page, STYLE.page)
    frequencies = evidence.density_frequencies
    _fill_pair(panel, (frequencies, seen), (frequencies, model), "of the model", decades=2 * ValidationLimits.DECADES)
    panel.y.label = f"spectrum [{density_label(first.output_units[output])}]"
    log_chart(recording, pane, chart)


def _fill_pair(
    panel: Panel,
    seen: tuple[FloatArray, FloatArray],
    made: tuple[FloatArray, FloatArray],
    made_by: str,
    *,
    decades: float = ValidationLimits.DECADES,
) -> None:
    """Two lines, each of its frequencies and values."""
    panel.y.log = True
    panel.y.limits = panel.y.fitted(np.array(two_line_limits(seen[1], made[1], decades=decades)))
    panel.line(*seen, "measured", width=STYLE.under, label="measured")
    panel.line(*made, "model", width=STYLE.thin, label=made_by)
    panel.x.limits, panel.x.label, panel.key = (0.0, float(seen[0][-1])), "frequency [Hz]", "best"


def _phase(values: ComplexArray) -> FloatArray:
    """In degrees, broken where it wraps round so that no line runs across the picture."""
    degrees = np.where(np.isfinite(values), np.angle(values, deg=True), np.nan)
    jumps = np.flatnonzero(np.abs(np.diff(degrees)) > 180.0)
    degrees[jumps] = np.nan
    return np.asarray(degrees)


def validation_page(identification: Identification, plan: Plan, evidence: Gathered) -> Any:
    """All outputs over frequency, then each over time and frequency; the words to the right."""
    outputs = plan.data.shown_outputs
    views = [_one_output(identification, plan, evidence, i) for i in outputs]
    if len(outputs) > 1:
        views = [_everything(identification, plan, evidence), *views]
    left = tabs(views, "Outputs")
    words = document_view(VALIDATION_TEXT, "Validation in words")
    return rrb.Horizontal(left, words, column_shares=[2.4, 1.0], name="Validation")


def _everything(identification: Identification, plan: Plan, evidence: Gathered) -> Any:
    views = [_overview(identification, plan, evidence, i) for i in plan.data.shown_outputs]
    return rrb.Grid(*views, grid_columns=overview_columns(len(views)), name="All outputs")


def _overview(identification: Identification, plan: Plan, evidence: Gathered, output: int) -> Any:
    sources = drawn_inputs(evidence, plan, output)
    name = label(_output(identification, output), 20)
    pane = magnitude_pane(output, len(plan.data.shown_outputs))
    if sources:
        return plot_view(pane, f"{name} / {_input(identification, sources[0], 20)}")
    if evidence.model_density.size:
        return plot_view(pane, f"Spectrum of {name}")
    return run_view(identification, plan, output, legend=output == 0)


def _one_output(identification: Identification, plan: Plan, evidence: Gathered, output: int) -> Any:
    """Over time to the left, with what is left over; over frequency to the right, a tab an input."""
    name = label(_output(identification, output), 18)
    series = rrb.Vertical(
        run_view(identification, plan, output),
        series_view(plan.fit_paths[output], "Residual", ["$origin/residual/**"]),
        row_shares=[1.3, 1.0],
        name="Over time",
    )
    responses = [
        plot_view(response_pane(output, source), f"{name} / {_input(identification, source, 18)}")
        for source in drawn_inputs(evidence, plan, output)
    ]
    if evidence.model_density.size:
        responses = [plot_view(density_pane(output), f"Spectrum of {name}")]
    if not responses:
        return rrb.Vertical(series, name=name)
    right = tabs(responses, "Over frequency")
    return rrb.Horizontal(series, right, column_shares=[1.25, 1.0], name=name)


def _output(identification: Identification, output: int) -> str:
    return identification.channels.output_names[output]


def _input(identification: Identification, source: int, longest: int) -> str:
    return label(identification.channels.input_names[source], longest)
