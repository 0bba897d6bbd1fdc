"""The page "Discrepancy": spectrum of the gap, hypotheses, laws over the data, all drawn, and the verdict in words."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from modal.discrepancy.results import Diagnosis, LawCurve
from modal.recording.axis import Axis, linear_axis, log_axis
from modal.recording.discrepancy.discrepancy_levels import log_level_modes
from modal.recording.discrepancy.discrepancy_plan import DiscrepancyPlan
from modal.recording.discrepancy.discrepancy_words import gap_text, law_text, verdict_text
from modal.recording.discrepancy.series import STAGE_COLOURS, log_histories, log_tables, stage_part
from modal.recording.figure import Figure, Pane
from modal.recording.names import label
from modal.recording.palette import BLUE, DIM_BLUE, FRAME, GOLD, GREEN, GREY, PALE
from modal.recording.tables import log_table
from modal.sections.discrepancy_spectra import GapDensity, gap_density
from modal.sections.discrepancy_values import (
    NAMED_WITHIN,
    effect_text,
    effects_text,
    found_hypothesis,
    law_against,
    law_gives,
    times_floor,
    times_text,
)

if TYPE_CHECKING:
    import rerun

__all__ = ["GAP_TEXT", "HYPOTHESES", "LAW_TEXT", "VERDICT_TEXT", "law_panes", "log_discrepancy_page", "spectrum_pane"]

VERDICT_TEXT: Final = "discrepancy/verdict"
LAW_TEXT: Final = "discrepancy/law/text"
GAP_TEXT: Final = "discrepancy/gap_text"
HYPOTHESES: Final = Pane("discrepancy/hypotheses/plot", 520.0, 400.0)

SHOWN_HYPOTHESES: Final = 6
SHOWN_LAWS: Final = 6


def spectrum_pane(output: int) -> Pane:
    """Where the spectrum of an output's gap is drawn."""
    return Pane(f"discrepancy/spectrum/{output + 1:02d}/plot", 520.0, 400.0)


def law_panes(diagnosis: Diagnosis) -> tuple[Pane, ...]:
    """Where each law is drawn, in the shape that its view will have on a common screen."""
    n_laws = len(diagnosis.laws[:SHOWN_LAWS])
    width, height = {1: (900.0, 720.0), 2: (900.0, 370.0)}.get(n_laws, (480.0, 390.0))
    return tuple(Pane(f"discrepancy/law/{k + 1:02d}/plot", width, height) for k in range(n_laws))


def log_discrepancy_page(diagnosis: Diagnosis, recording: "rerun.RecordingStream", plan: DiscrepancyPlan) -> None:
    """Series, spectra, hypotheses, laws, words and tables."""
    import rerun as rr

    log_histories(diagnosis, recording, plan)
    log_tables(diagnosis, recording, plan)
    _log_spectra(diagnosis, recording, plan)
    _draw_hypotheses(diagnosis, recording)
    log_level_modes(diagnosis, recording)
    for number, law in enumerate(diagnosis.laws):
        _log_law(recording, law, number)
    for pane, law in zip(law_panes(diagnosis), diagnosis.laws, strict=False):
        _draw_law(recording, pane, law)
    documents = (
        (VERDICT_TEXT, verdict_text(diagnosis, plan)),
        (LAW_TEXT, law_text(diagnosis)),
        (GAP_TEXT, gap_text(diagnosis, plan)),
    )
    for path, text in documents:
        recording.log(path, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True, strict=True)


def _log_spectra(diagnosis: Diagnosis, recording: "rerun.RecordingStream", plan: DiscrepancyPlan) -> None:
    """All as numbers, those of the shown outputs as lines."""
    if not plan.stages:
        return
    density = gap_density([stage.gap for stage in plan.stages])
    lines = np.arange(1, density.frequency.size + 1)
    for output in range(diagnosis.held_out[0].n_outputs):
        columns = {
            "frequency": density.frequency,
            "measured": density.measured[:, output],
            "noise": np.full(density.frequency.size, density.noise[output]),
        }
        columns |= {
            f"gap_{stage_part(stage)[2:]}": gap[:, output] for stage, gap in zip(plan.stages, density.gaps, strict=True)
        }
        log_table(recording, f"discrepancy/spectrum/{output + 1:02d}/numbers", "frequency_line", lines, columns)
    x_axis = log_axis("frequency [Hz]", float(density.frequency[0]), float(density.frequency[-1]))
    for output in plan.shown_outputs:
        pane = spectrum_pane(output)
        figure = Figure(recording=recording, pane=pane, x=x_axis, y=density_axis(density, output, diagnosis))
        figure.frame()
        figure.line("0_measured", density.frequency, density.measured[:, output], DIM_BLUE, width=1.0, order=3.0)
        ends = [float(density.frequency[0]), float(density.frequency[-1])]
        figure.line("8_noise", ends, [density.noise[output]] * 2, GREY, width=0.9, order=4.0)
        for k, (stage, gap) in enumerate(zip(plan.stages, density.gaps, strict=True)):
            colour = STAGE_COLOURS[stage.kind]
            figure.line(f"1_{stage_part(stage)}", density.frequency, gap[:, output], colour, order=5.0 + k)
        entries = [(f"gap {stage.name}", STAGE_COLOURS[stage.kind]) for stage in plan.stages]
        figure.legend_inside([*entries, ("measured output", DIM_BLUE), ("noise floor", GREY)])


def _draw_hypotheses(diagnosis: Diagnosis, recording: "rerun.RecordingStream") -> None:
    shown = diagnosis.hypotheses[:SHOWN_HYPOTHESES]
    if not shown:
        return
    found = found_hypothesis(diagnosis)
    sizes = [times_floor(one.held_out_level) for one in shown]
    known = [size for size in sizes if np.isfinite(size) and size > 0]
    low, high = min([0.7, *(0.8 * size for size in known)]), max([3.0, *known])
    n_rows = len(shown)
    rows = Axis(title="what was tried, the best first", low=0.0, high=n_rows + 0.1, ticks=(), texts=())
    figure = Figure(
        recording=recording,
        pane=HYPOTHESES,
        x=log_axis("left on held-out data, times the noise floor", low, high * 2.0),
        y=rows,
    )
    figure.frame()
    start = 10.0**figure.x.low
    figure.bars("limits/0_floor", [[[1.0, 0.0], [1.0, n_rows]]], GREY, width=0.9, order=3.0)
    figure.bars("limits/1_named", [[[NAMED_WITHIN, 0.0], [NAMED_WITHIN, n_rows]]], GOLD, width=0.7, order=3.0)
    for k, (one, size) in enumerate(zip(shown, sizes, strict=True)):
        height = n_rows - k - 0.68
        colour = GREEN if one is found else DIM_BLUE
        end = size if np.isfinite(size) and size > 0 else high * 2.0
        figure.bars(f"bar/{k}", [[[start, height], [end, height]]], colour, width=7.0)
        figure.text_from(f"name/{k}", start, height + 0.42, label(effects_text(one.effects), 58), PALE)
        words = times_text(size) if np.isfinite(size) else "does not run through"
        figure.text_from(f"size/{k}", end, height, words, GREEN if one is found else PALE)
    figure.legend([("noise floor", GREY), (f"named only within {NAMED_WITHIN:.2f}", GOLD)])


def _log_law(recording: "rerun.RecordingStream", law: LawCurve, number: int) -> None:
    """The curve, the points and the loop as tables."""
    path = f"discrepancy/law/{number + 1:02d}"
    for name, timeline, columns in (
        ("curve", "grid", {"motion": law.motion, "force": law.force, "std": law.deviation}),
        ("points", "bin", {"motion": law.points_motion, "force": law.points_force, "std": law.points_deviation}),
        ("loop", "loop_point", {"motion": law.loop_motion, "force": law.loop_force}),
    ):
        log_table(recording, f"{path}/{name}", timeline, np.arange(1, columns["motion"].size + 1), columns)


def _draw_law(recording: "rerun.RecordingStream", pane: Pane, law: LawCurve) -> None:
    low, high = _span([law.motion, law.points_motion, law.loop_motion])
    bottom, top = _span([law.force, law.points_force, law.loop_force])
    figure = Figure(
        recording=recording,
        pane=pane,
        x=linear_axis(label(law_against(law), 44), low, high),
        y=linear_axis(label(law_gives(law), 44), bottom, top),
    )
    figure.frame()
    figure.bars("zero", [[[low, 0.0], [high, 0.0]], [[0.0, bottom], [0.0, top]]], FRAME, width=0.5, order=2.0)
    entries = [("law as found", GREEN)]
    if law.loop_motion.size:
        figure.line("1_loading", law.motion, law.force, PALE, width=0.8, order=5.0)
        figure.line("2_loop", law.loop_motion, law.loop_force, GREEN, width=1.3, order=6.0)
        entries = [("law as found, along the record", GREEN), ("loaded from rest", PALE)]
    else:
        for side, name in ((-1.96, "low"), (1.96, "high")):
            figure.line(f"1_band/{name}", law.motion, law.force + side * law.deviation, GREEN, width=0.5, order=4.0)
        figure.line("2_law", law.motion, law.force, GREEN, width=1.6, order=6.0)
        entries = [("law as found, thin: 95 %", GREEN)]
    if law.points_motion.size:
        width = 1.96 * law.points_deviation
        stack = zip(law.points_motion, law.points_force - width, law.points_force + width, strict=True)
        figure.bars("3_bars", [[[x, a], [x, b]] for x, a, b in stack], BLUE, width=0.8, order=7.0)
        figure.points("4_points", law.points_motion, law.points_force, BLUE, radius=3.5)
        entries.append(("from the data, bars 95 %", BLUE))
    figure.legend(entries)


def density_axis(density: GapDensity, output: int, diagnosis: Diagnosis) -> Axis:
    """The axis of the spectral density of an output."""
    unit = diagnosis.held_out[0].output_units[output]
    title = f"gap of {label(diagnosis.held_out[0].output_names[output])}"
    return log_axis(f"{title} [({label(unit, 12)})²/Hz]" if unit else title, *density.span(output))


def law_title(law: LawCurve) -> str:
    """What a law's view is called."""
    return f"{effect_text(law.effect)} at {label(law.where)}"


def _span(parts: Sequence[np.ndarray]) -> tuple[float, float]:
    values = np.concatenate([part[np.isfinite(part)] for part in parts])
    if not values.size:
        return -1.0, 1.0
    low, high = min(float(values.min()), 0.0), max(float(values.max()), 0.0)
    margin = 0.08 * (high - low) or 1.0
    return low - margin, high + margin
