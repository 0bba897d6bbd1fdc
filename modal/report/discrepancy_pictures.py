"""The pictures of a diagnosis as SVG text, each with the words that stand under it."""

from collections.abc import Sequence

import numpy as np

from modal.discrepancy.results import Diagnosis
from modal.plots import discrepancy as plots
from modal.plots import discrepancy_law, discrepancy_levels
from modal.report.picture import Picture, drawn
from modal.sections.discrepancy_levels import level_lines
from modal.sections.discrepancy_stages import Stage, record_name, rows_of, stages_of, worst_outputs
from modal.sections.discrepancy_values import NAMED_WITHIN, found_hypothesis, found_word
from modal.wording.names import shorten, visible

__all__ = ["draw_diagnosis"]

MOST_OUTPUTS = 6
MOST_LAWS = 6


def draw_diagnosis(diagnosis: Diagnosis) -> dict[str, Picture]:
    """All pictures that the diagnosis has the numbers for, by name."""
    stages = stages_of(diagnosis)
    return {
        **_gap_pictures(stages),
        **_level_picture(diagnosis),
        **_step_pictures(diagnosis),
        **_law_pictures(diagnosis),
    }


def _gap_pictures(stages: Sequence[Stage]) -> dict[str, Picture]:
    if not stages:
        return {}
    first = stages[0].gap
    shown = worst_outputs(first, MOST_OUTPUTS)
    most = "output" if len(shown) == 1 else f"{len(shown)} outputs"
    which = "" if len(shown) == len(first.output_names) else f" Shown: the {most} with the largest gap."
    worst = int(np.argmax(np.nan_to_num(first.in_floors.mean(axis=1))))
    name = shorten(visible(record_name(first.measured[worst], worst)), 60)
    record = f" Held-out record {name!r}." if len(first.measured) > 1 else ""
    states = _states(stages)
    return {
        "histories": drawn(
            plots.gap_histories(stages, record=worst, outputs=shown),
            "gap histories",
            f"Measured minus simulated: {states}; grey, the band of the noise.{record}{which}",
        ),
        "spectra": drawn(
            plots.gap_spectra(stages, outputs=shown),
            "gap spectra",
            f"Spectra of the gap over that of the measured output (blue), mean over the held-out records: {states}. A "
            f"model that lacks nothing leaves a gap on the dashed line, the noise floor.{which}",
        ),
        "before_after": drawn(
            plots.before_and_after(rows_of(stages), stages),
            "before and after",
            f"The held-out gap part by part, in times of the noise floor: {states}. Points on the dashed line are "
            "noise and no more.",
        ),
    }


def _level_picture(diagnosis: Diagnosis) -> dict[str, Picture]:
    lines = level_lines(diagnosis)
    if not lines:
        return {}
    words = (
        "Each mode of the best linear model of each level, from the measured records alone, bars 95 %. A spring that "
        "hardens raises the frequency with the level, dry friction lowers the damping ratio, drag raises it; a mode "
        "that stays where it is belongs to a linear structure. Modes that are not known well enough are left out."
    )
    if any(line.name.startswith("pole") for line in lines):
        words += " Of a pole of first order the corner frequency is drawn: the faster, the more it is damped."
    return {"levels": drawn(discrepancy_levels.modes_against_level(lines), "modes against level", words)}


def _step_pictures(diagnosis: Diagnosis) -> dict[str, Picture]:
    pictures = {}
    if len(diagnosis.steps) > 1:
        pictures["steps"] = drawn(
            plots.shrinking_gap(diagnosis.steps),
            "the gap step by step",
            "What is left after each step. The held-out records were used in no fit.",
        )
    if diagnosis.hypotheses:
        shown = min(len(diagnosis.hypotheses), plots.MOST_BARS)
        rest = "" if shown == len(diagnosis.hypotheses) else f" The best {shown} of {len(diagnosis.hypotheses)}."
        mark = f"Green: {found_word(diagnosis)}. " if found_hypothesis(diagnosis) else ""
        pictures["hypotheses"] = drawn(
            plots.hypothesis_bars(diagnosis.hypotheses, chosen=found_hypothesis(diagnosis)),
            "hypotheses",
            f"What each set of effects leaves on held-out data. {mark}An effect is named only within "
            f"{NAMED_WITHIN:.2f} times the noise floor ({NAMED_WITHIN**2:.2g} in mean squares).{rest}",
        )
    return pictures


def _law_pictures(diagnosis: Diagnosis) -> dict[str, Picture]:
    laws = diagnosis.laws[:MOST_LAWS]
    if not laws:
        return {}
    parts = ["The law as found (green)"]
    if any(not law.loop_motion.size for law in laws):
        parts.append("with its 95 % band from the uncertainty of its parameters")
    if any(law.points_motion.size for law in laws):
        parts.append("over what the data ask for in bins of the motion, free of the law's form (blue, bars 95 %)")
    words = ", ".join(parts)
    loops = (
        " A law with memory is drawn as the loop along the loudest record; dashed, as it loads from rest."
        if any(x.loop_motion.size for x in laws)
        else ""
    )
    return {"laws": drawn(discrepancy_law.draw_laws(laws), "laws", f"{words}.{loops}")}


def _states(stages: Sequence[Stage]) -> str:
    colours = {"before": "red", "linear": "amber", "after": "green"}
    return ", ".join(f"{stage.name} ({colours[stage.kind]})" for stage in stages)
