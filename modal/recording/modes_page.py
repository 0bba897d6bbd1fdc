"""The page "Modes": shapes, the table of all modes, how alike the shapes are, the choices in words."""

from typing import TYPE_CHECKING, Final

import numpy as np

from modal.assurance import assurance
from modal.identification import Identification
from modal.recording.palette import WHITE
from modal.recording.plan import Plan
from modal.recording.shapes import log_shape
from modal.recording.tables import log_table
from modal.recording.words import choices_text, modes_text
from okid.arrays import FloatArray

if TYPE_CHECKING:
    import rerun

__all__ = ["ASSURANCE", "CHOICES_TEXT", "FIELDS", "MODES_TABLE", "MODES_TEXT", "log_modes_page"]

MODES_TEXT: Final = "modes/text"
CHOICES_TEXT: Final = "modes/choices"
MODES_TABLE: Final = "modes/table"
ASSURANCE: Final = "modes/assurance"
FIELDS: Final = (
    "verdict",
    "frequency",
    "frequency_std",
    "damping_ratio",
    "damping_ratio_std",
    "damping_resolved",
    "amplitude_coherence",
    "phase_collinearity",
    "emac_output",
    "emac_input",
    "emac",
    "cmi",
    "msv",
    "mpd",
    "repeatability",
    "probability",
    "kind",
    "reason",
)
"""Fields of a mode that the table stores under their own names."""

NUMBERED_CELLS: Final = 12


def log_modes_page(identification: Identification, recording: "rerun.RecordingStream", plan: Plan) -> None:
    """Shapes that move, tables in words and in numbers, assurance matrix."""
    import rerun as rr

    first = identification.records[0]
    for number in plan.shapes:
        mode = plan.modes[number - 1]
        log_shape(mode, number, recording, plan, names=first.output_names, units=first.output_units)
    for path, text in ((MODES_TEXT, modes_text(identification, plan)), (CHOICES_TEXT, choices_text(identification))):
        recording.log(path, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True, strict=True)
    if plan.modes:
        _log_table(recording, plan)
    if plan.compared:
        _log_assurance(recording, plan)


def _log_table(recording: "rerun.RecordingStream", plan: Plan) -> None:
    """Every mode as numbers on the timeline "mode"."""
    modes = plan.modes
    index = np.arange(1, len(modes) + 1)
    columns: dict[str, list[object]] = {name: [getattr(mode, name) for mode in modes] for name in FIELDS}
    columns["pole_real"] = [mode.pole.real for mode in modes]
    columns["pole_imaginary"] = [mode.pole.imag for mode in modes]
    log_table(recording, MODES_TABLE, "mode", index, columns)
    for name in ("shape", "participation"):
        vectors = [getattr(mode, name) for mode in modes]
        parts = {"real": [vector.real for vector in vectors], "imaginary": [vector.imag for vector in vectors]}
        log_table(recording, f"modes/{name}s", "mode", index, parts)


def _log_assurance(recording: "rerun.RecordingStream", plan: Plan) -> None:
    import rerun as rr

    modes = [plan.modes[number - 1] for number in plan.shapes]
    shapes = np.column_stack([mode.shape for mode in modes])
    matrix = assurance(shapes, shapes)
    n = len(modes)
    image = rr.DepthImage(matrix.astype(np.float32), colormap="viridis", depth_range=(0.0, 1.0), meter=1.0)
    recording.log(f"{ASSURANCE}/matrix", image, static=True, strict=True)
    log_table(recording, f"{ASSURANCE}/numbers", "mode", plan.shapes, {"assurance": list(matrix)})
    rows, columns = np.mgrid[:n, :n]
    cells = np.column_stack([columns.ravel(), rows.ravel()]) + 0.5
    texts = [f"{value:.2f}" for value in matrix.ravel()]
    _log_texts(recording, f"{ASSURANCE}/values", cells, texts, n, show=n <= NUMBERED_CELLS)
    names = [str(number) for number in plan.shapes]
    along = np.arange(n) + 0.5
    margin = 0.09 * n**0.5
    _log_texts(recording, f"{ASSURANCE}/rows", np.column_stack([np.full(n, -margin), along]), names, n, show=True)
    _log_texts(recording, f"{ASSURANCE}/columns", np.column_stack([along, np.full(n, n + margin)]), names, n, show=True)


def _log_texts(
    recording: "rerun.RecordingStream", path: str, places: FloatArray, texts: list[str], n: int, *, show: bool
) -> None:
    import rerun as rr

    # a label hangs below its point: about 18 points on the screen, of about 400 for the whole matrix
    points = rr.Points2D(
        places - [0.0, 0.045 * n],
        radii=rr.Radius.ui_points(0.0),
        colors=WHITE,
        labels=texts,
        show_labels=show,
        draw_order=30.0,
    )
    recording.log(path, points, static=True, strict=True)
