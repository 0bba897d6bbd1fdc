"""The page "Validation": the model against what was measured, over frequency and over time, output by output.

Over time the model runs freely: it sees the inputs alone. Over frequency its response is set against the quotient of
the spectra, which knows nothing of the model, with the coherence that says where that quotient can be believed. Without
inputs the spectrum of the outputs takes the place of the response.

How the page "Validation" opens; called by `modal.recording.stream`.

Where the page "Validation" draws what: a pane for each output, and one for each pair of output and input.

The page "Validation" in words: what was run on which rows, and how much of each output is left over.
"""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from modal.identification.result import Identification
from modal.recording.figure import (
    BLUE,
    GREY,
    ORANGE,
    PALE,
    SHARE_AXIS,
    Axis,
    Figure,
    Pane,
    document_view,
    linear_axis,
    log_axis,
    plot_view,
    series_view,
)
from modal.recording.identification.fit import run_view
from modal.recording.plan import SHOWN_INPUTS, Gathered, Plan, cell, label
from modal.recording.tables import UNKNOWN, log_table, table
from okid.arrays import ComplexArray, FloatArray

if TYPE_CHECKING:
    import rerun

__all__ = [
    "DECADES",
    "VALIDATION_TEXT",
    "density_pane",
    "drawn_inputs",
    "log_validation_page",
    "magnitude_pane",
    "overview_columns",
    "response_pane",
    "two_line_axis",
    "validation_page",
    "validation_text",
]

MOST_RESPONSES: Final = 16
DECADES: Final = 5.0
"""Of a magnitude that are shown; of a power spectrum, which is its square, twice as many hold the same."""
HIGHEST: Final = 100.0
"""Times the largest measured value that a peak of the model may have in the picture."""


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
    n_drawn = min(SHOWN_INPUTS, max(1, MOST_RESPONSES // len(plan.data.shown_outputs)))
    strength = np.nan_to_num(evidence.measured.ordinary_coherence[:, output]).mean(axis=0)
    return tuple(np.argsort(-strength, kind="stable")[:n_drawn].tolist())


def two_line_axis(title: str, seen: FloatArray, made: FloatArray, *, decades: float = DECADES) -> Axis:
    """Down to what was measured, as a zero of the model goes down to nothing; up to the peaks of both.

    A pole on the unit circle has no peak: the model may rise by some decades above what was measured, and no more.
    """
    known = [values[np.isfinite(values) & (values > 0)] for values in (seen, made)]
    first = next((values for values in known if values.size), None)
    if first is None:
        return log_axis(title, 0.1, 10.0)
    high = float(first.max())
    highest = max(float(values.max()) for values in known if values.size)
    high = max(high, min(HIGHEST * high, highest))
    return log_axis(title, max(float(first.min()), high * 10.0**-decades), high)


LISTED_OUTPUTS: Final = 40


def validation_text(identification: Identification, evidence: Gathered) -> str:
    """What the pictures beside it show, on which rows, and the numbers of each output."""
    first = identification.records[0]
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
    first, fit = identification.records[0], identification.fit
    driven = bool(first.n_inputs)
    head = ["output", "unit", "cross-validated", "all rows" if driven else "one step", "left over", "output"]
    rows = []
    for i in range(min(first.n_outputs, LISTED_OUTPUTS)):
        left, whole = _sizes(identification, i)
        rows.append(
            [
                cell(first.output_names[i], 24),
                cell(first.output_units[i], 12) if first.output_units[i] else UNKNOWN,
                f"**{_percent(fit.cross_validated[i])}**",
                _percent(fit.whole[i] if driven else fit.one_step[i]),
                _figures(left),
                _figures(whole),
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


def _percent(value: float) -> str:
    return f"{100 * value:.1f} %" if np.isfinite(value) else UNKNOWN


def _figures(value: float) -> str:
    return f"{value:.3g}" if np.isfinite(value) else UNKNOWN


VALIDATION_TEXT: Final = "validation/text"


def log_validation_page(
    identification: Identification, recording: "rerun.RecordingStream", plan: Plan, evidence: Gathered
) -> None:
    """Responses or spectra of the shown outputs as pictures, those of all as numbers, and what they say."""
    import rerun as rr

    document = rr.TextDocument(validation_text(identification, evidence), media_type=rr.MediaType.MARKDOWN)
    recording.log(VALIDATION_TEXT, document, static=True, strict=True)
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


def _log_responses(recording: "rerun.RecordingStream", plan: Plan, evidence: Gathered) -> None:
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


def _log_densities(recording: "rerun.RecordingStream", plan: Plan, evidence: Gathered) -> None:
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
    identification: Identification,
    recording: "rerun.RecordingStream",
    evidence: Gathered,
    *,
    output: int,
    source: int,
) -> None:
    """Magnitude over phase over coherence, one axis of frequency."""
    measured = evidence.measured
    if measured is None:
        return
    pane = response_pane(output, source)
    x = linear_axis("frequency [Hz]", 0.0, float(measured.frequencies[-1]))
    seen, made = measured.frf[:, output, source], evidence.fine[:, output, source]
    magnitude = Figure(
        recording=recording,
        pane=pane,
        x=x,
        y=_magnitude_axis(identification, seen, made, output=output, source=source),
        band=(0.0, 0.46),
        part="0_magnitude",
    )
    _draw_pair(magnitude, (measured.frequencies, np.abs(seen)), (evidence.fine_frequencies, np.abs(made)))
    phase = Figure(
        recording=recording,
        pane=pane,
        x=x,
        y=Axis(
            title="phase [°]",
            low=-190.0,
            high=190.0,
            ticks=(-180.0, -90.0, 0.0, 90.0, 180.0),
            texts=("−180", "−90", "0", "90", "180"),
        ),
        band=(0.46, 0.74),
        part="1_phase",
    )
    phase.frame()
    phase.line("0_measured", measured.frequencies, _phase(seen), BLUE, width=1.3, order=5.0)
    phase.line("1_synthesised", evidence.fine_frequencies, _phase(made), ORANGE, width=1.0, order=6.0)
    coherence = Figure(
        recording=recording,
        pane=pane,
        x=x,
        y=SHARE_AXIS,
        band=(0.74, 1.0),
        part="2_coherence",
    )
    coherence.frame()
    several = measured.ordinary_coherence.shape[2] > 1
    if several:
        ordinary = measured.ordinary_coherence[:, output, source]
        coherence.line("0_ordinary", measured.frequencies, ordinary, GREY, width=0.8, order=5.0)
    coherence.line(
        "1_multiple", measured.frequencies, measured.multiple_coherence[:, output], PALE, width=1.0, order=6.0
    )
    coherence.legend([("with all inputs", PALE), ("with this one", GREY)] if several else [("with the input", PALE)])


def _draw_magnitude(
    identification: Identification,
    recording: "rerun.RecordingStream",
    evidence: Gathered,
    pane: Pane,
    *,
    output: int,
    source: int,
) -> None:
    measured = evidence.measured
    if measured is None:
        return
    seen, made = measured.frf[:, output, source], evidence.fine[:, output, source]
    figure = Figure(
        recording=recording,
        pane=pane,
        x=linear_axis("frequency [Hz]", 0.0, float(measured.frequencies[-1])),
        y=_magnitude_axis(identification, seen, made, output=output, source=source),
    )
    _draw_pair(figure, (measured.frequencies, np.abs(seen)), (evidence.fine_frequencies, np.abs(made)))


def _draw_density(
    identification: Identification,
    recording: "rerun.RecordingStream",
    evidence: Gathered,
    pane: Pane,
    *,
    output: int,
) -> None:
    first = identification.records[0]
    model = evidence.model_density[:, output]
    seen = evidence.quality.densities[: model.size, first.n_inputs + output]
    unit = first.output_units[output]
    title = f"spectrum [({label(unit, 10)})²/Hz]" if unit else "spectrum"
    figure = Figure(
        recording=recording,
        pane=pane,
        x=linear_axis("frequency [Hz]", 0.0, float(evidence.density_frequencies[-1])),
        y=two_line_axis(title, seen, model, decades=2 * DECADES),
    )
    _draw_pair(
        figure, (evidence.density_frequencies, seen), (evidence.density_frequencies, model), made_by="of the model"
    )


def _draw_pair(
    figure: Figure,
    seen: tuple[FloatArray, FloatArray],
    made: tuple[FloatArray, FloatArray],
    *,
    made_by: str = "synthesised",
) -> None:
    """Two lines, each of its frequencies and values; one that has left the frame is not drawn along its edge."""
    figure.frame()
    lowest = 10.0**figure.y.low
    for name, (frequencies, values), colour, width, order in (
        ("0_measured", seen, BLUE, 1.6, 5.0),
        ("1_synthesised", made, ORANGE, 1.0, 6.0),
    ):
        figure.line(name, frequencies, np.where(values > lowest, values, np.nan), colour, width=width, order=order)
    figure.legend([("measured", BLUE), (made_by, ORANGE)])


def _magnitude_axis(
    identification: Identification, seen: ComplexArray, made: ComplexArray, *, output: int, source: int
) -> Axis:
    first = identification.records[0]
    units = (first.output_units[output], first.input_units[source])
    title = f"magnitude [{label(units[0], 9)} per {label(units[1], 7)}]" if all(units) else "magnitude"
    return two_line_axis(title, np.abs(seen), np.abs(made))


def _phase(values: ComplexArray) -> FloatArray:
    """In degrees, broken where it wraps round so that no line runs across the picture."""
    degrees = np.where(np.isfinite(values), np.angle(values, deg=True), np.nan)
    jumps = np.flatnonzero(np.abs(np.diff(degrees)) > 180.0)
    degrees[jumps] = np.nan
    return np.asarray(degrees)


def validation_page(identification: Identification, plan: Plan, evidence: Gathered) -> Any:
    """All outputs over frequency, then each over time and frequency; the words to the right."""
    import rerun.blueprint as rrb

    outputs = plan.data.shown_outputs
    tabs = [_one_output(identification, plan, evidence, i) for i in outputs]
    if len(outputs) > 1:
        tabs = [_everything(identification, plan, evidence), *tabs]
    left = rrb.Tabs(*tabs, active_tab=0, name="Outputs") if len(tabs) > 1 else tabs[0]
    words = document_view(VALIDATION_TEXT, "Validation in words")
    return rrb.Horizontal(left, words, column_shares=[2.4, 1.0], name="Validation")


def _everything(identification: Identification, plan: Plan, evidence: Gathered) -> Any:
    import rerun.blueprint as rrb

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
    import rerun.blueprint as rrb

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
    right = rrb.Tabs(*responses, active_tab=0, name="Over frequency") if len(responses) > 1 else responses[0]
    return rrb.Horizontal(series, right, column_shares=[1.25, 1.0], name=name)


def _output(identification: Identification, output: int) -> str:
    return identification.records[0].output_names[output]


def _input(identification: Identification, source: int, longest: int) -> str:
    return label(identification.records[0].input_names[source], longest)
