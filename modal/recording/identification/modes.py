"""The page "Modes": shapes, their complexity and likeness, the table of all modes, the choices in words."""

from typing import TYPE_CHECKING, Final

import numpy as np

from modal.geometry.comparable import comparable_shapes
from modal.geometry.complexity import complexity_words
from modal.geometry.placement import Placement, placed
from modal.geometry.scene import scene_of
from modal.identification.result import Identification
from modal.modes.shape_comparison import assurance
from modal.recording.identification.complexity import log_complexity
from modal.recording.identification.modes_words import modes_text
from modal.recording.identification.shapes import log_shape
from modal.recording.palette import WHITE
from modal.recording.plan import Plan
from modal.recording.tables import log_table
from modal.recording.words import choices_text
from okid.arrays import FloatArray

if TYPE_CHECKING:
    import rerun

__all__ = ["ASSURANCE", "CHOICES_TEXT", "FIELDS", "MODES_TABLE", "MODES_TEXT", "log_modes_page", "placement_in"]

MODES_TEXT: Final = "modes/text"
CHOICES_TEXT: Final = "modes/choices"
MODES_TABLE: Final = "modes/table"
ASSURANCE: Final = "modes/assurance"
NODES_TABLE: Final = "modes/nodes"
SENSORS_TABLE: Final = "modes/sensors"
DEFLECTIONS_TABLE: Final = "modes/deflections"
FIELDS: Final = (
    "verdict",
    "frequency",
    "frequency_std",
    "damping_ratio",
    "damping_ratio_std",
    "damping_resolved",
    "repeatability",
    "probability",
    "gain",
    "amplitude_coherence",
    "emac_output",
    "emac_input",
    "emac",
    "phase_collinearity",
    "mpd",
    "cmi",
    "msv",
    "kind",
    "reason",
)
"""Fields of a mode that the table stores under their own names."""

NUMBERED_CELLS: Final = 12
CROWDED: Final = 6
SMALL: Final = 0.05
"""Up to so many shapes every cell has its number; with more of them, numbers below this would only hide the colours."""


def placement_in(identification: Identification, plan: Plan) -> Placement:
    """The outputs on the plan's geometry, or in a row where it has none.

    Raises:
        InvalidDataError: no output has a place in the geometry.
    """
    first = identification.records[0]
    return placed(plan.geometry, first.output_names, first.output_units)


def log_modes_page(identification: Identification, recording: "rerun.RecordingStream", plan: Plan) -> None:
    """Shapes that move, their complexity, tables in words and in numbers, assurance matrix.

    Raises:
        InvalidDataError: a geometry is given, and no output has a place in it.
    """
    import rerun as rr

    placement = placement_in(identification, plan)
    if plan.shapes:
        scene = scene_of(placement)
        for number in plan.shapes:
            log_shape(plan.modes[number - 1], number, recording, plan, scene)
        log_complexity(recording, plan, identification.records[0])
        _log_geometry(identification, recording, plan, placement)
    words = modes_text(identification, plan, placement)
    for path, text in ((MODES_TEXT, words), (CHOICES_TEXT, choices_text(identification))):
        recording.log(path, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True, strict=True)
    if plan.modes:
        _log_table(recording, plan)
    if plan.compared:
        _log_assurance(identification, recording, plan)


def _log_table(recording: "rerun.RecordingStream", plan: Plan) -> None:
    """Every mode as numbers on the timeline "mode"."""
    modes = plan.modes
    index = np.arange(1, len(modes) + 1)
    columns: dict[str, list[object]] = {name: [getattr(mode, name) for mode in modes] for name in FIELDS}
    columns["pole_real"] = [mode.pole.real for mode in modes]
    columns["pole_imaginary"] = [mode.pole.imag for mode in modes]
    columns["complexity"] = [complexity_words(mode) for mode in modes]
    log_table(recording, MODES_TABLE, "mode", index, columns)
    for name in ("shape", "participation"):
        vectors = [getattr(mode, name) for mode in modes]
        parts = {"real": [vector.real for vector in vectors], "imaginary": [vector.imag for vector in vectors]}
        log_table(recording, f"modes/{name}s", "mode", index, parts)


def _log_geometry(
    identification: Identification, recording: "rerun.RecordingStream", plan: Plan, placement: Placement
) -> None:
    """The structure as numbers: nodes, sensors, and the deflections that are drawn."""
    geometry, names = placement.geometry, identification.records[0].output_names
    places = {axis: geometry.positions[:, k].tolist() for k, axis in enumerate("xyz")}
    log_table(
        recording, NODES_TABLE, "node", np.arange(geometry.n_nodes), {"name": list(geometry.node_names), **places}
    )
    drawn = [(output, one) for output, one in enumerate(placement.sensors) if one is not None]
    columns: dict[str, list[object]] = {
        "name": [names[output] for output, _ in drawn],
        "node": [one.node for _, one in drawn],
        "motion": [one.motion for _, one in drawn],
        "direction": [one.direction for _, one in drawn],
    }
    log_table(recording, SENSORS_TABLE, "output", [output for output, _ in drawn], columns)
    nodes = placement.motions.moving
    deflections = [placement.deflection(plan.modes[number - 1])[nodes] for number in plan.shapes]
    parts: dict[str, list[object]] = {"nodes": [nodes] * len(deflections)}
    for k, axis in enumerate("xyz"):
        parts[f"{axis}_real"] = [one[:, k].real for one in deflections]
        parts[f"{axis}_imaginary"] = [one[:, k].imag for one in deflections]
    log_table(recording, DEFLECTIONS_TABLE, "mode", plan.shapes, parts)


def _log_assurance(identification: Identification, recording: "rerun.RecordingStream", plan: Plan) -> None:
    import rerun as rr

    modes = [plan.modes[number - 1] for number in plan.shapes]
    first = identification.records[0]
    shapes = comparable_shapes(modes, first.output_names, first.output_units)
    matrix = assurance(shapes, shapes)
    n = len(modes)
    image = rr.DepthImage(matrix.astype(np.float32), colormap="viridis", depth_range=(0.0, 1.0), meter=1.0)
    recording.log(f"{ASSURANCE}/matrix", image, static=True, strict=True)
    log_table(recording, f"{ASSURANCE}/numbers", "mode", plan.shapes, {"assurance": list(matrix)})
    rows, columns = np.mgrid[:n, :n]
    cells = np.column_stack([columns.ravel(), rows.ravel()]) + 0.5
    written = np.flatnonzero(matrix.ravel() >= (SMALL if n > CROWDED else 0.0))
    texts = [_short(value) for value in matrix.ravel()[written]]
    _log_texts(recording, f"{ASSURANCE}/values", cells[written], texts, n, show=n <= NUMBERED_CELLS)
    names = [str(number) for number in plan.shapes]
    along = np.arange(n) + 0.5
    margin = 0.09 * n**0.5
    _log_texts(recording, f"{ASSURANCE}/rows", np.column_stack([np.full(n, -margin), along]), names, n, show=True)
    _log_texts(recording, f"{ASSURANCE}/columns", np.column_stack([along, np.full(n, n + margin)]), names, n, show=True)


def _short(value: float) -> str:
    """Two decimals without the 0 before them: many numbers stand side by side."""
    if value >= 0.995:
        return "1"
    return f"{value:.2f}".removeprefix("0") if value >= 0.005 else "0"


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
