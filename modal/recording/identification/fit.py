"""The page "Observer fit": what the model makes of what was measured, and what is left over.

Its twin is the page "Responses", where no record was identified but a table of frequency responses.
"""

from collections.abc import Iterable
from typing import Any, Final

import numpy as np

from modal.identification.result import Identification
from modal.modes.response_synthesis import tabled_frf
from modal.plots.histories import residual_autocorrelation
from modal.plots.layout import one_panel
from modal.plots.panels import IN_TURN, STYLE
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
from modal.recording.plan import DataPlan, Plan, Views, cell, label, name_with_unit
from modal.recording.series import Line, log_lines, log_sequence, time_axis
from modal.recording.tables import choices_text, fit_page_text, log_table, log_text
from modal.sections.words import modes_headline
from modal.wording.text import fit_text
from okid.arrays import FloatArray
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
    left: list[Any] = [_everything(identification, plan)]
    if len(plan.data.shown_outputs) > 1:
        left += [_one_output(identification, plan, i) for i in plan.data.shown_outputs]
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


def _everything(identification: Identification, plan: Plan) -> Any:
    """Inputs over all outputs: a few with their windows, many in two columns."""
    outputs = plan.data.shown_outputs
    if len(outputs) == 1:
        return _one_output(identification, plan, 0)
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


def _one_output(identification: Identification, plan: Plan, output: int) -> Any:
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
