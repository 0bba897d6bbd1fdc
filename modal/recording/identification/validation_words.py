"""The page "Validation" in words: what was run on which rows, and how much of each output is left over."""

from typing import Final

import numpy as np

from modal.identification.result import Identification
from modal.recording.evidence import Gathered
from modal.recording.names import cell
from modal.recording.words import UNKNOWN, table

__all__ = ["validation_text"]

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
