"""Shapes in the complex plane: a circle for each mode, and in it the components as phasors, largest 1.

The components of a real mode lie on one line; it lies flat here, since shapes are turned to their best real phase.
"""

from typing import TYPE_CHECKING, Final

import numpy as np

from modal.geometry.complexity import phasors
from modal.modes.mode import Mode
from modal.recording.figure import Pane
from modal.recording.names import label
from modal.recording.palette import BLUE, FRAME, GRID, ORANGE, PALE
from modal.recording.plan import Plan
from modal.recording.tables import log_table
from okid.arrays import ComplexArray, FloatArray
from okid.record import Record

if TYPE_CHECKING:
    import rerun

__all__ = ["COMPLEXITY", "complexity_pane", "log_complexity"]

COMPLEXITY: Final = "modes/complexity"
ROOM: Final = (390.0, 230.0)
"""Width and height of the plot, about those of its pane on a common screen: a view unit is a point of the screen."""

WORDS: Final = 24.0
"""Height of the words under a circle, in view units."""

GAP: Final = 7.0
"""Between two circles, in view units."""

MOST_COLUMNS: Final = 3
"""Circles in a row, so that the words under them have room."""


def complexity_pane(n_shapes: int) -> Pane:
    """Where the circles are stored, and the size of the plot."""
    n_columns, n_rows, _ = _cells(n_shapes)
    return Pane(COMPLEXITY, ROOM[0] * n_columns / MOST_COLUMNS, max(ROOM[1], 74.0 * n_rows))


def _cells(n_shapes: int) -> tuple[int, int, float]:
    """Columns, rows, and radius of the circles."""
    n_columns = min(max(n_shapes, 1), MOST_COLUMNS)
    n_rows = -(-max(n_shapes, 1) // n_columns)
    height = max(ROOM[1] / n_rows, 74.0)
    return n_columns, n_rows, min(ROOM[0] / MOST_COLUMNS, height - WORDS) / 2 - GAP


def log_complexity(recording: "rerun.RecordingStream", plan: Plan, record: Record) -> None:
    """One circle for each shape that is drawn, with collinearity and phase deviation in numbers and words.

    Args:
        recording: the stream.
        plan: of the recording.
        record: whose outputs they are.
    """
    pane, radius = complexity_pane(len(plan.shapes)), _cells(len(plan.shapes))[2]
    centres = _centres(len(plan.shapes), pane)
    circle = np.exp(2j * np.pi * np.linspace(0.0, 1.0, 65))
    rims = [_places(circle, centre, radius) for centre in centres]
    cross = [_places(np.array(ends), centre, radius) for centre in centres for ends in ((-1, 1), (-1j, 1j))]
    _strips(recording, "0_cross", cross, GRID, 0.6, order=0.0)
    _strips(recording, "1_circle", rims, FRAME, 0.8, order=1.0)
    found = [phasors(plan.modes[number - 1], record.output_units) for number in plan.shapes]
    arms, heads = [], []
    for values, centre in zip(found, centres, strict=True):
        ends = _places(values, centre, radius)
        arms += [np.array([centre, end]) for end in ends]
        heads.append(ends)
    _strips(recording, "2_arms", arms, BLUE, 1.2, order=5.0)
    _points(recording, "3_heads", np.concatenate(heads), list(record.output_names) * len(found))
    modes = [plan.modes[number - 1] for number in plan.shapes]
    words = [_words(number, mode) for number, mode in zip(plan.shapes, modes, strict=True)]
    _texts(recording, "4_words", np.add(centres, (0.0, radius)), words)
    parts = {"real": [one.real for one in found], "imaginary": [one.imag for one in found]}
    log_table(recording, f"{COMPLEXITY}/numbers", "mode", plan.shapes, parts)


def _centres(n_shapes: int, pane: Pane) -> list[FloatArray]:
    n_columns, n_rows, radius = _cells(n_shapes)
    width, height = pane.width / n_columns, pane.height / n_rows
    cells = [divmod(k, n_columns) for k in range(n_shapes)]
    return [np.array([width * (column + 0.5), height * row + GAP + radius]) for row, column in cells]


def _places(values: ComplexArray, centre: FloatArray, radius: float) -> FloatArray:
    """(n, 2) view coordinates; the view's second axis points down."""
    return np.asarray(centre + radius * np.column_stack([values.real, -values.imag]), dtype=np.float64)


def _words(number: int, mode: Mode) -> str:
    """Collinearity and phase deviation; in words they stand in the table of the modes."""
    known = [
        f"MPC {mode.phase_collinearity:.2f}" if np.isfinite(mode.phase_collinearity) else "",
        f"{mode.mpd:.0f}°" if np.isfinite(mode.mpd) else "",
    ]
    return f"{number}: {', '.join(filter(None, known)) or 'no indicator'}"


def _strips(
    recording: "rerun.RecordingStream",
    name: str,
    strips: list[FloatArray],
    colour: tuple[int, int, int],
    width: float,
    *,
    order: float,
) -> None:
    import rerun as rr

    lines = rr.LineStrips2D(strips, radii=rr.Radius.ui_points(width), colors=colour, draw_order=order)
    recording.log(f"{COMPLEXITY}/{name}", lines, static=True, strict=True)


def _points(recording: "rerun.RecordingStream", name: str, places: FloatArray, texts: list[str]) -> None:
    import rerun as rr

    points = rr.Points2D(
        places,
        radii=rr.Radius.ui_points(2.6),
        colors=ORANGE,
        labels=[label(text) for text in texts],
        show_labels=False,
        draw_order=10.0,
    )
    recording.log(f"{COMPLEXITY}/{name}", points, static=True, strict=True)


def _texts(recording: "rerun.RecordingStream", name: str, places: FloatArray, texts: list[str]) -> None:
    import rerun as rr

    points = rr.Points2D(
        places,  # a label hangs below its point
        radii=rr.Radius.ui_points(0.0),
        colors=PALE,
        labels=texts,
        show_labels=True,
        draw_order=30.0,
    )
    recording.log(f"{COMPLEXITY}/{name}", points, static=True, strict=True)
