"""The page "Observer fit": what the model makes of what was measured, and what is left over."""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Final

import numpy as np

from modal.identification.result import Identification
from modal.recording.axis import linear_axis
from modal.recording.figure import Figure, Pane, legend_share
from modal.recording.names import label
from modal.recording.palette import BLUE, CYCLE, GREY, ORANGE, PALE, RED, Colour
from modal.recording.plan import SHOWN_OUTPUTS, Plan
from modal.recording.series import Line, log_lines, log_sequence, time_axis
from modal.recording.tables import log_table
from modal.recording.words import fit_page_text
from okid.arrays import FloatArray

if TYPE_CHECKING:
    import rerun

__all__ = ["FIT_TEXT", "MARKOV", "WHITENESS", "log_fit_page"]

FIT_TEXT: Final = "fit/text"
MARKOV: Final = Pane("fit/markov/plot", 480.0, 235.0)
WHITENESS: Final = Pane("fit/whiteness/plot", 480.0, 175.0)
PREDICTED: Final[Colour] = (120, 205, 200)
ONE_STEP: Final[Colour] = (250, 170, 160)
DRAWN_PAIRS: Final = 4


def log_fit_page(identification: Identification, recording: "rerun.RecordingStream", plan: Plan) -> None:
    """Predicted and simulated outputs with their residuals, fit table, Markov parameters, whiteness."""
    import rerun as rr

    times = time_axis(identification.records, plan.data)
    for output, path in enumerate(plan.fit_paths):
        _log_output(identification, recording, plan, times=times, output=output, path=path)
    document = rr.TextDocument(fit_page_text(identification, plan), media_type=rr.MediaType.MARKDOWN)
    recording.log(FIT_TEXT, document, static=True, strict=True)
    _log_numbers(identification, recording)
    _log_markov(identification, recording)
    _log_whiteness(identification, recording)


def _log_output(
    identification: Identification,
    recording: "rerun.RecordingStream",
    plan: Plan,
    *,
    times: FloatArray,
    output: int,
    path: str,
) -> None:
    measured = [record.outputs[:, output] for record in identification.records]
    predicted = [record.outputs[:, output] for record in identification.predicted]
    simulated = [record.outputs[:, output] for record in identification.simulated]
    driven = identification.records[0].n_inputs > 0
    colour, width = (PREDICTED, 1.0) if driven else (ORANGE, 1.3)
    models = [Line(channels=predicted, name="one step ahead", colour=colour, width=width)]
    residuals = [
        Line(channels=_less(measured, predicted), name="less one step ahead", colour=ONE_STEP, width=1.0),
    ]
    if driven:  # without inputs nothing runs freely: what is called simulated is one step
        models.append(Line(channels=simulated, name="simulated", colour=ORANGE, width=1.3))
        left = _less(measured, simulated)
        residuals.insert(0, Line(channels=left, name="less simulated", colour=RED, width=1.0))
    log_lines(recording, f"{path}/model", times, models, plan=plan.data)
    log_lines(recording, f"{path}/residual", times, residuals, plan=plan.data)


def _less(first: list[FloatArray], second: list[FloatArray]) -> list[FloatArray]:
    return [a - b for a, b in zip(first, second, strict=True)]


def _log_numbers(identification: Identification, recording: "rerun.RecordingStream") -> None:
    fit, first = identification.fit, identification.records[0]
    outputs: dict[str, Iterable[object]] = {
        "name": first.output_names,
        "unit": first.output_units,
        "cross_validated": fit.cross_validated,
        "whole": fit.whole,
        "one_step": fit.one_step,
    }
    log_table(recording, "fit/outputs", "output", np.arange(1, first.n_outputs + 1), outputs)


def _log_markov(identification: Identification, recording: "rerun.RecordingStream") -> None:
    """All of them as numbers, the strongest of each of a few outputs as lines, scaled by the size of the channels."""
    markov, first = identification.markov, identification.records[0]
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
    pairs = [(i, int(strength[i].argmax())) for i in np.argsort(-strength.max(axis=1), kind="stable")[:DRAWN_PAIRS]]
    drawn = np.stack([scaled[:, i, j] for i, j in pairs], axis=1)
    colours = (BLUE, ORANGE, *CYCLE[1:])
    entries = [(f"{label(out[i], 11)} / {label(into[j], 11)}", colours[k]) for k, (i, j) in enumerate(pairs)]
    seconds = lags * markov.dt
    low, high = float(min(drawn.min(), 0.0)), float(max(drawn.max(), 0.0))
    figure = Figure(
        recording=recording,
        pane=MARKOV,
        x=linear_axis(
            "time [s]", 0.0, float(seconds[-1]) / (1.0 - legend_share(MARKOV, [text for text, _ in entries]))
        ),
        y=linear_axis(title, low, high + 0.05 * (high - low)),
    )
    figure.frame()
    for k in reversed(range(len(pairs))):
        figure.line(f"line/{k}", seconds, drawn[:, k], colours[k], width=1.0, order=6.0 - 0.1 * k)
    figure.legend_inside(entries)


def _log_whiteness(identification: Identification, recording: "rerun.RecordingStream") -> None:
    residuals, first = identification.residuals, identification.records[0]
    correlation, limit = residuals.autocorrelation, residuals.confidence_limit
    lags = np.arange(float(correlation.shape[0]))
    names = [label(name, 60) for name in first.output_names]
    log_sequence(recording, "fit/whiteness/numbers", timeline="lag", index=lags, values=correlation, names=names)
    shown = correlation[1:, :SHOWN_OUTPUTS]
    if not shown.size:
        return
    height = float(np.nanmax(np.abs(shown), initial=2.0 * limit)) * 1.15
    figure = Figure(
        recording=recording,
        pane=WHITENESS,
        x=linear_axis("lag [samples]", 0.0, float(lags[-1])),
        y=linear_axis("autocorrelation of the residual", -height, height),
    )
    figure.frame()
    for side in (-limit, limit):
        figure.line(f"limit/{'low' if side < 0 else 'high'}", [0.0, lags[-1]], [side, side], GREY, width=0.5, order=4.0)
    colours = (BLUE, ORANGE, *CYCLE[1:], PALE)
    for i in range(shown.shape[1]):
        figure.line(f"line/{i}", lags[1:], shown[:, i], colours[i % len(colours)], width=0.9)
    figure.text("limit", 0.93 * lags[-1], limit + 0.12 * height, "95 %", GREY)
