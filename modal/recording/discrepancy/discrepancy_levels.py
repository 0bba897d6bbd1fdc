"""Modes against level in the recording: change of frequency and damping ratio, drawn where they tell something."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from modal.discrepancy.results import Diagnosis
from modal.recording.axis import Axis, linear_axis
from modal.recording.figure import Figure, Pane
from modal.recording.names import label
from modal.recording.palette import CYCLE, FRAME
from modal.sections.discrepancy_levels import LevelLine, level_lines
from okid.arrays import FloatArray

if TYPE_CHECKING:
    import rerun

__all__ = ["LEVEL_DAMPING", "LEVEL_FREQUENCY", "level_panes", "log_level_modes"]

LEVEL_FREQUENCY: Final = Pane("discrepancy/levels/frequency/plot", 700.0, 520.0)
LEVEL_DAMPING: Final = Pane("discrepancy/levels/damping/plot", 700.0, 520.0)
NINETY_FIVE: Final = 1.96

Values = Callable[[LevelLine], tuple[FloatArray, FloatArray]]


def level_panes(diagnosis: Diagnosis) -> tuple[Pane, ...]:
    """The plots that there is something to draw in."""
    lines = level_lines(diagnosis)
    damped = any(np.isfinite(line.damping).any() for line in lines)
    return (*([LEVEL_FREQUENCY] if lines else []), *([LEVEL_DAMPING] if damped else []))


def log_level_modes(diagnosis: Diagnosis, recording: "rerun.RecordingStream") -> None:
    """Both plots; nothing where nothing is known of how modes move with level."""
    lines = level_lines(diagnosis)
    panes = level_panes(diagnosis)
    if LEVEL_FREQUENCY in panes:
        title = "change of frequency [%]"
        _draw(recording, LEVEL_FREQUENCY, lines, title, lambda line: (line.change, line.change_std))
    if LEVEL_DAMPING in panes:
        _draw(recording, LEVEL_DAMPING, lines, "damping ratio [%]", lambda line: (line.damping, line.damping_std))


def _draw(recording: "rerun.RecordingStream", pane: Pane, lines: Sequence[LevelLine], title: str, of: Values) -> None:
    shown = [(line, *of(line)) for line in lines if np.isfinite(of(line)[0]).any()]
    ends = [values + side * NINETY_FIVE * np.nan_to_num(std) for _, values, std in shown for side in (-1.0, 1.0)]
    low, high = min(0.0, float(np.min(np.concatenate(ends)))), max(0.0, float(np.max(np.concatenate(ends))))
    margin = 0.08 * (high - low) or 1.0
    figure = Figure(
        recording=recording, pane=pane, x=_level_axis(lines), y=linear_axis(title, low - margin, high + margin)
    )
    figure.frame()
    span = [10.0**figure.x.low, 10.0**figure.x.high]
    figure.bars("0_zero", [[[span[0], 0.0], [span[1], 0.0]]], FRAME, width=0.6, order=2.0)
    entries = []
    for k, (line, values, std) in enumerate(shown):
        colour, width = CYCLE[k % len(CYCLE)], NINETY_FIVE * np.nan_to_num(std)
        figure.line(f"1_line/{k}", line.levels, values, colour, width=1.2, order=5.0)
        stack = zip(line.levels.tolist(), (values - width).tolist(), (values + width).tolist(), strict=True)
        figure.bars(f"2_bars/{k}", [[[x, a], [x, b]] for x, a, b in stack], colour, width=0.8, order=6.0)
        figure.points(f"3_points/{k}", line.levels, values, colour, radius=4.0)
        entries.append((label(line.name, 24), colour))
    figure.legend_row(entries)


def _level_axis(lines: Sequence[LevelLine]) -> Axis:
    """A logarithmic axis with a tick at each level: nothing is known between them."""
    levels = sorted({level for line in lines for level in line.levels.tolist()})
    places = tuple(float(np.log10(level)) for level in levels)
    margin = max(0.08 * (places[-1] - places[0]), 0.03)
    return Axis(
        title="level of the excitation, relative to the loudest record",
        low=places[0] - margin,
        high=places[-1] + margin,
        ticks=places,
        texts=tuple(f"{level:.2g}" for level in levels),
        scale="log10",
    )
