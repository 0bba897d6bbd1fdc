"""The page "Validation": the model against what was measured, over frequency and over time, output by output.

Over time the model runs freely: it sees the inputs alone. Over frequency its response is set against the quotient of
the spectra, which knows nothing of the model, with the coherence that says where that quotient can be believed. Without
inputs the spectrum of the outputs takes the place of the response.
"""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Final

import numpy as np

from modal.identification.result import Identification
from modal.recording.axis import SHARE_AXIS, Axis, linear_axis
from modal.recording.evidence import Gathered
from modal.recording.figure import Figure, Pane
from modal.recording.identification.validation_panes import (
    DECADES,
    density_pane,
    drawn_inputs,
    magnitude_pane,
    response_pane,
    two_line_axis,
)
from modal.recording.identification.validation_words import validation_text
from modal.recording.names import label
from modal.recording.palette import BLUE, GREY, ORANGE, PALE
from modal.recording.plan import Plan
from modal.recording.tables import log_table
from okid.arrays import ComplexArray, FloatArray

if TYPE_CHECKING:
    import rerun

__all__ = ["VALIDATION_TEXT", "log_validation_page"]

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
