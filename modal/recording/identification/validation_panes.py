"""Where the page "Validation" draws what: a pane for each output, and one for each pair of output and input."""

from typing import Final

import numpy as np

from modal.recording.axis import Axis, log_axis
from modal.recording.evidence import Gathered
from modal.recording.figure import Pane
from modal.recording.plan import SHOWN_INPUTS, Plan
from okid.arrays import FloatArray

__all__ = [
    "DECADES",
    "density_pane",
    "drawn_inputs",
    "magnitude_pane",
    "overview_columns",
    "response_pane",
    "two_line_axis",
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
