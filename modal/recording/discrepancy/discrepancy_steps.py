"""The page "Step by step": the gap of one output, its spectrum, and the gap of each part, one row a step: they play."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from modal.discrepancy.results import Diagnosis
from modal.localisation.gap import Gap
from modal.recording.axis import Axis, linear_axis, log_axis
from modal.recording.discrepancy.discrepancy_plan import DiscrepancyPlan
from modal.recording.discrepancy.discrepancy_words import step_document
from modal.recording.discrepancy.page import density_axis
from modal.recording.figure import Figure, Pane
from modal.recording.levels import bucket_length, positions, reduced
from modal.recording.names import label, name_with_unit
from modal.recording.palette import DIM_BLUE, GREEN, GREY, ORANGE, PALE, Colour
from modal.recording.series import TIMELINE
from modal.sections.discrepancy_spectra import gap_density
from modal.sections.discrepancy_stages import Row, Stage, rows_of
from okid.arrays import FloatArray

if TYPE_CHECKING:
    import rerun

__all__ = ["STEP_GAP", "STEP_PARTS", "STEP_SPECTRUM", "STEP_TEXT", "log_steps_page"]

STEP: Final = "step"
STEP_GAP: Final = Pane("discrepancy/steps/gap/plot", 1400.0, 335.0)
STEP_SPECTRUM: Final = Pane("discrepancy/steps/spectrum/plot", 520.0, 400.0)
STEP_PARTS: Final = Pane("discrepancy/steps/parts/plot", 520.0, 400.0)
STEP_TEXT: Final = "discrepancy/steps/text"
DIM_RED: Final[Colour] = (120, 56, 58)
DRAWN_SAMPLES: Final = 4000
SHOWN_PARTS: Final = 7


def log_steps_page(diagnosis: Diagnosis, recording: "rerun.RecordingStream", plan: DiscrepancyPlan) -> None:
    """Frames once, and what changes once a step; nothing where no step ran through."""
    import rerun as rr

    if not plan.step_gaps:
        return
    _draw_gap(diagnosis, recording, plan)
    _draw_spectrum(diagnosis, recording, plan)
    _draw_parts(recording, plan)
    texts = [step_document(diagnosis, number) for number in plan.step_numbers]
    columns = rr.TextDocument.columns(text=texts, media_type=[rr.MediaType.MARKDOWN] * len(texts))
    _send(recording, STEP_TEXT, plan, columns)


def _draw_gap(diagnosis: Diagnosis, recording: "rerun.RecordingStream", plan: DiscrepancyPlan) -> None:
    record = diagnosis.held_out[plan.record]
    bucket = bucket_length(record.n_samples, DRAWN_SAMPLES)
    times = record.start_time + record.dt * positions(record.n_samples, bucket)
    curves = [reduced(gap.residuals[plan.record][:, plan.output], bucket) for gap in plan.step_gaps]
    noise = 2.0 * float(np.sqrt(plan.step_gaps[0].floor[plan.record, plan.output]))
    reach = max(1.05 * max(float(np.nanmax(np.abs(curve))) for curve in curves), 1.5 * noise)
    name = name_with_unit(record.output_names[plan.output], record.output_units[plan.output])
    figure = Figure(
        recording=recording,
        pane=STEP_GAP,
        x=linear_axis("time [s]", float(times[0]), float(times[-1])),
        y=linear_axis(f"gap of {name}, held out", -reach, reach),
    )
    figure.frame()
    figure.line("1_first", times, curves[0], DIM_RED, width=0.6, order=3.0)
    for side in (-noise, noise):
        ends = [float(times[0]), float(times[-1])]
        figure.line(f"2_noise/{'low' if side < 0 else 'high'}", ends, [side, side], GREY, width=0.6, order=4.0)
    _play_lines(recording, plan, f"{STEP_GAP.path}/3_now", [[figure.place(times, curve)] for curve in curves])
    figure.legend([("as given", DIM_RED), ("this step", ORANGE), ("the last", GREEN), ("noise, ±2 deviations", GREY)])


def _draw_spectrum(diagnosis: Diagnosis, recording: "rerun.RecordingStream", plan: DiscrepancyPlan) -> None:
    density = gap_density(plan.step_gaps)
    frequency, output = density.frequency, plan.output
    figure = Figure(
        recording=recording,
        pane=STEP_SPECTRUM,
        x=log_axis("frequency [Hz]", float(frequency[0]), float(frequency[-1])),
        y=density_axis(density, output, diagnosis),
    )
    figure.frame()
    figure.line("0_measured", frequency, density.measured[:, output], DIM_BLUE, width=0.9, order=2.0)
    figure.line("1_first", frequency, density.gaps[0][:, output], DIM_RED, width=0.9, order=3.0)
    ends = [float(frequency[0]), float(frequency[-1])]
    figure.line("2_noise", ends, [float(density.noise[output])] * 2, GREY, width=0.9, order=4.0)
    low, high = 10.0**figure.y.low, 10.0**figure.y.high
    strips = [[figure.place(frequency, np.clip(gap[:, output], low, high))] for gap in density.gaps]
    _play_lines(recording, plan, f"{STEP_SPECTRUM.path}/3_now", strips, width=1.3)
    figure.legend_inside([("measured output", DIM_BLUE), ("gap as given", DIM_RED), ("gap now", ORANGE)])


def _draw_parts(recording: "rerun.RecordingStream", plan: DiscrepancyPlan) -> None:
    """A bar a part, as long as its gap is in times of the noise floor."""
    rows = _shown(plan.step_gaps)
    sizes = [size for row in rows for size in row.sizes if np.isfinite(size) and size > 0]
    figure = Figure(
        recording=recording,
        pane=STEP_PARTS,
        x=log_axis("times the noise floor", min([0.7, *sizes]), max([3.0, *sizes])),
        y=Axis(title="gap by output, record and band", low=0.0, high=len(rows) + 0.1, ticks=(), texts=()),
    )
    figure.frame()
    figure.bars("0_floor", [[[1.0, 0.0], [1.0, len(rows)]]], GREY, width=0.9, order=3.0)
    start = 10.0**figure.x.low
    bars: list[list[FloatArray]] = [[] for _ in plan.step_gaps]
    for k, row in enumerate(rows):
        height = len(rows) - k - 0.75
        figure.text_from(f"name/{k}", start, height + 0.42, f"{row.part}: {label(row.name, 40)}", PALE)
        first = row.sizes[0] if np.isfinite(row.sizes[0]) else start
        figure.bars(f"1_first/{k}", [[[start, height], [first, height]]], DIM_RED, width=3.0, order=4.0)
        for strips, size in zip(bars, row.sizes, strict=True):
            end = size if np.isfinite(size) and size > start else start
            strips.append(figure.place([start, end], [height, height]))
    _play_lines(recording, plan, f"{STEP_PARTS.path}/2_now", bars, width=5.0)


def _shown(gaps: Sequence[Gap]) -> list[Row]:
    """The outputs, records and bands with the largest gap at first, in their order."""
    stages = [Stage(name="", kind="after", step=k, gap=gap) for k, gap in enumerate(gaps)]
    rows = rows_of(stages)
    order = np.argsort([-np.nan_to_num(row.sizes[0]) for row in rows], kind="stable")[:SHOWN_PARTS]
    return [rows[k] for k in sorted(order.tolist())]


def _play_lines(
    recording: "rerun.RecordingStream",
    plan: DiscrepancyPlan,
    path: str,
    frames: Sequence[Sequence[FloatArray]],
    *,
    width: float = 1.0,
) -> None:
    """One row of line strips a step: orange on the way, green at the last."""
    import rerun as rr

    counts = [len(strips) for strips in frames]
    last = len(frames) - 1
    colours = [GREEN if k == last else ORANGE for k, count in enumerate(counts) for _ in range(count)]
    strips = [_known(strip) for frame in frames for strip in frame]
    columns = [
        *rr.LineStrips2D.columns(
            strips=strips, colors=colours, radii=[rr.Radius.ui_points(width)] * len(strips)
        ).partition(counts),
    ]
    _send(recording, path, plan, columns)
    recording.log(path, rr.LineStrips2D.from_fields(draw_order=8.0), static=True, strict=True)


def _known(strip: FloatArray) -> FloatArray:
    """A strip without the points that are not known."""
    return strip[np.isfinite(strip).all(axis=1)]


def _send(recording: "rerun.RecordingStream", path: str, plan: DiscrepancyPlan, columns: Any) -> None:
    import rerun as rr

    index = [
        rr.TimeColumn(STEP, sequence=list(plan.step_numbers)),
        rr.TimeColumn(TIMELINE, duration=list(plan.step_times)),
    ]
    recording.send_columns(path, index, columns, strict=True)
