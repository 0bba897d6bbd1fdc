"""The page "Modes": shapes, their complexity and likeness, the table of all modes, the choices in words.

How the page "Modes" opens; called by `modal.recording.stream`.

The page "Modes" in words: the table of all modes with every indicator, and what the shapes leave out.

Shapes in the complex plane: a circle for each mode, and in it the components as phasors, largest 1.

The components of a real mode lie on one line; it lies flat here, since shapes are turned to their best real phase.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from modal.geometry.placement import Placement, placed
from modal.geometry.scene import (
    Scene,
    comparable_shapes,
    comparison_words,
    complexity_words,
    envelope_of,
    phasors,
    scene_of,
)
from modal.identification.result import Identification
from modal.identification.words import damping_text, mass_sentence, mass_text
from modal.modes.mode import Mode
from modal.modes.shape_comparison import assurance
from modal.recording.figure import Palette, Pane, RecordingStream, document_view, plot_view, rr, rrb
from modal.recording.identification.shapes import log_shape, shape_path
from modal.recording.plan import UNKNOWN, Plan, bullets, cell, choices_text, known, label, log_table, log_text, table
from modal.sections.words import remark_of
from modal.wording.text import NINETY_FIVE, hertz, ratio_text, with_interval
from okid.arrays import ComplexArray, FloatArray
from okid.frequency_response import FrequencyResponse
from okid.record import Record

COMPLEXITY: Final = "modes/complexity"


class Circles:
    """Places of the circles of complexity."""

    ROOM: Final = (390.0, 230.0)
    """Draw in this width and height, about those of the pane on a common screen: a view unit is a point of it."""
    GAP: Final = 7.0
    """Keep two circles so far apart, in view units."""
    MOST_COLUMNS: Final = 3
    """Set so many circles in a row, so that the words under them have room."""


def complexity_pane(n_shapes: int) -> Pane:
    """Where the circles are stored, and the size of the plot."""
    n_columns, n_rows, _ = _cells(n_shapes)
    return Pane(COMPLEXITY, Circles.ROOM[0] * n_columns / Circles.MOST_COLUMNS, max(Circles.ROOM[1], 74.0 * n_rows))


def _cells(n_shapes: int) -> tuple[int, int, float]:
    """Columns, rows, and radius of the circles."""
    n_columns = min(max(n_shapes, 1), Circles.MOST_COLUMNS)
    n_rows = -(-max(n_shapes, 1) // n_columns)
    height = max(Circles.ROOM[1] / n_rows, 74.0)
    # less the words under the circle
    return n_columns, n_rows, min(Circles.ROOM[0] / Circles.MOST_COLUMNS, height - 24.0) / 2 - Circles.GAP


def log_complexity(recording: RecordingStream, plan: Plan, record: Record | FrequencyResponse) -> None:
    """One circle for each shape that is drawn, with collinearity and phase deviation in numbers and words."""
    pane, radius = complexity_pane(len(plan.shapes)), _cells(len(plan.shapes))[2]
    centres = _centres(len(plan.shapes), pane)
    circle = np.exp(2j * np.pi * np.linspace(0.0, 1.0, 65))
    rims = [_places(circle, centre, radius) for centre in centres]
    cross = [_places(np.array(ends), centre, radius) for centre in centres for ends in ((-1, 1), (-1j, 1j))]
    _strips(recording, "0_cross", cross, Palette.GRID, 0.6, order=0.0)
    _strips(recording, "1_circle", rims, Palette.FRAME, 0.8, order=1.0)
    found = [phasors(plan.modes[number - 1], record.output_units) for number in plan.shapes]
    arms, heads = [], []
    for values, centre in zip(found, centres, strict=True):
        ends = _places(values, centre, radius)
        arms += [np.array([centre, end]) for end in ends]
        heads.append(ends)
    _strips(recording, "2_arms", arms, Palette.BLUE, 1.2, order=5.0)
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
    return [np.array([width * (column + 0.5), height * row + Circles.GAP + radius]) for row, column in cells]


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
    recording: RecordingStream,
    name: str,
    strips: list[FloatArray],
    colour: tuple[int, int, int],
    width: float,
    *,
    order: float,
) -> None:
    lines = rr.LineStrips2D(strips, radii=rr.Radius.ui_points(width), colors=colour, draw_order=order)
    recording.log(f"{COMPLEXITY}/{name}", lines, static=True, strict=True)


def _points(recording: RecordingStream, name: str, places: FloatArray, texts: list[str]) -> None:
    points = rr.Points2D(
        places,
        radii=rr.Radius.ui_points(2.6),
        colors=Palette.ORANGE,
        labels=[label(text) for text in texts],
        show_labels=False,
        draw_order=10.0,
    )
    recording.log(f"{COMPLEXITY}/{name}", points, static=True, strict=True)


def _texts(recording: RecordingStream, name: str, places: FloatArray, texts: list[str]) -> None:
    points = rr.Points2D(
        places,  # a label hangs below its point
        radii=rr.Radius.ui_points(0.0),
        colors=Palette.PALE,
        labels=texts,
        show_labels=True,
        draw_order=30.0,
    )
    recording.log(f"{COMPLEXITY}/{name}", points, static=True, strict=True)


REASON_LETTERS: Final = 90
"""Show so many letters of a reason beside the numbers; the whole of a longer one stands below the table."""

HEAD: Final = (
    *("", "f [Hz]", "ζ [%]", "mass [kg]", "verdict", "repeats", "P", "gain", "γ", "EMAC out", "EMAC in", "EMAC", "MPC"),
    *("MPD [°]", "shape", "CMI", "MSV", "kind", "why"),
)


def modes_text(identification: Identification, plan: Plan, placement: Placement | None) -> str:
    """The table of all modes, noise included, with every indicator, the verdict and its reason."""
    rows = [_row(number, mode) for number, mode in enumerate(plan.modes, start=1)]
    parts = [table(*_with_content(HEAD, rows)) if rows else "The model has no mode."]
    parts.append(_key(identification, plan))
    parts += bullets(
        [
            f"{number}, {mode.frequency:.5g} Hz, {mode.verdict}: {remark_of(mode)}"
            for number, mode in enumerate(plan.modes, start=1)
            if _start(remark_of(mode)) != remark_of(mode)
        ]
    )
    if identification.modes.indicators_missing:
        parts.append(f"Indicators are missing: {cell(identification.modes.indicators_missing)}")
    if placement is not None and plan.shapes:
        parts += ["**The shapes**", *bullets([*placement.sentences, *_assurance_words(identification, plan)])]
    return "\n\n".join(parts)


def _key(identification: Identification, plan: Plan) -> str:
    caution = identification.modes.indicator_caution
    spread = "±: 95 % interval. " if np.isfinite([mode.frequency_std for mode in plan.modes]).any() else ""
    return (
        f"{spread}f: frequency. ζ: damping ratio. repeats: mean overlap with the same mode found again from other "
        "data and orders, 1 is the same; it decides the verdict. P: probability that the mode belongs to the system. "
        "gain: share of the squared error without the mode that it removes. γ: amplitude coherence. EMAC: extended "
        "modal amplitude coherence. MPC: phase collinearity. MPD: mean phase deviation. CMI = EMAC · MPC. MSV: mode "
        "singular value over the largest. "
        f"n/(pq) = {known(caution, '.2f')}"
        + (": the indicators test the observer more than the data. " if caution > 0.3 else ". ")
        + mass_sentence(identification)
    )


def _assurance_words(identification: Identification, plan: Plan) -> list[str]:
    first = identification.channels
    words = comparison_words(first.output_names, first.output_units) if plan.compared else ""
    return [words] if words else []


def _row(number: int, mode: Mode) -> list[str]:
    strong = "**" if mode.verdict == "system" else ""
    resolved = mode.kind != "real" and mode.damping_resolved
    damping = f"{strong}{_interval(100 * mode.damping_ratio, 100 * NINETY_FIVE * mode.damping_ratio_std)}{strong}"
    return [
        str(number),
        f"{strong}{_frequency(mode)}{strong}",
        damping if resolved else damping_text(mode),
        mass_text(mode),
        f"{strong}{mode.verdict}{strong}",
        *[known(value, ".2f") for value in (mode.repeatability, mode.probability)],
        known(mode.gain, ".2g"),
        *[known(value, ".2f") for value in (mode.amplitude_coherence, mode.emac_output, mode.emac_input, mode.emac)],
        known(mode.phase_collinearity, ".2f"),
        known(mode.mpd, ".0f"),
        complexity_words(mode),
        known(mode.cmi, ".2f"),
        known(mode.msv, ".2f"),
        mode.kind,
        cell(_start(remark_of(mode))) if remark_of(mode) else UNKNOWN,
    ]


def _frequency(mode: Mode) -> str:
    if not np.isfinite(mode.frequency_std):
        return hertz(mode.frequency)
    return with_interval(mode.frequency, NINETY_FIVE * mode.frequency_std)


def _interval(value: float, half_width: float) -> str:
    return with_interval(value, half_width) if np.isfinite(half_width) else f"{value:#.3g}"


def _start(reason: str) -> str:
    """What fits beside the numbers on a common screen; the whole of a longer reason stands below the table."""
    return reason if len(reason) <= REASON_LETTERS else reason[: REASON_LETTERS - 1].rstrip() + "…"


def _with_content(head: Sequence[str], rows: Sequence[Sequence[str]]) -> tuple[list[str], list[list[str]]]:
    """Leave out columns that say nothing: no value in any row, or every pole oscillatory."""
    said = [k for k in range(len(head)) if {row[k] for row in rows} - {UNKNOWN, "oscillatory"}]
    return [head[k] for k in said], [[row[k] for k in said] for row in rows]


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
    "modal_mass",
    "modal_mass_std",
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


def placement_in(identification: Identification, plan: Plan) -> Placement:
    """The outputs on the plan's geometry, or in a row where it has none.

    Raises:
        InvalidDataError: no output has a place in the geometry.
    """
    first = identification.channels
    return placed(plan.geometry, first.output_names, first.output_units)


def log_modes_page(identification: Identification, recording: RecordingStream, plan: Plan) -> None:
    """Shapes that move, their complexity, tables in words and in numbers, assurance matrix.

    Raises:
        InvalidDataError: a geometry is given, and no output has a place in it.
    """
    placement = placement_in(identification, plan)
    if plan.shapes:
        scene = scene_of(placement)
        for number in plan.shapes:
            log_shape(plan.modes[number - 1], number, recording, plan, scene)
        log_complexity(recording, plan, identification.channels)
        _log_geometry(identification, recording, plan, placement)
    log_text(recording, MODES_TEXT, modes_text(identification, plan, placement))
    log_text(recording, CHOICES_TEXT, choices_text(identification))
    if plan.modes:
        _log_table(recording, plan)
    if plan.compared:
        _log_assurance(identification, recording, plan)


def _log_table(recording: RecordingStream, plan: Plan) -> None:
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


def _log_geometry(identification: Identification, recording: RecordingStream, plan: Plan, placement: Placement) -> None:
    """The structure as numbers: nodes, sensors, and the deflections that are drawn."""
    geometry, names = placement.geometry, identification.channels.output_names
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


def _log_assurance(identification: Identification, recording: RecordingStream, plan: Plan) -> None:
    modes = [plan.modes[number - 1] for number in plan.shapes]
    first = identification.channels
    shapes = comparable_shapes(modes, first.output_names, first.output_units)
    matrix = assurance(shapes, shapes)
    n = len(modes)
    image = rr.DepthImage(matrix.astype(np.float32), colormap="viridis", depth_range=(0.0, 1.0), meter=1.0)
    recording.log(f"{ASSURANCE}/matrix", image, static=True, strict=True)
    log_table(recording, f"{ASSURANCE}/numbers", "mode", plan.shapes, {"assurance": list(matrix)})
    rows, columns = np.mgrid[:n, :n]
    cells = np.column_stack([columns.ravel(), rows.ravel()]) + 0.5
    written = np.flatnonzero(matrix.ravel() >= (0.05 if n > 6 else 0.0))  # numbers would hide the colours
    texts = [_short(value) for value in matrix.ravel()[written]]
    _log_texts(recording, f"{ASSURANCE}/values", cells[written], texts, n, show=n <= 12)
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
    recording: RecordingStream, path: str, places: FloatArray, texts: list[str], n: int, *, show: bool
) -> None:
    # a label hangs below its point: about 18 points on the screen, of about 400 for the whole matrix
    points = rr.Points2D(
        places - [0.0, 0.045 * n],
        radii=rr.Radius.ui_points(0.0),
        colors=Palette.WHITE,
        labels=texts,
        show_labels=show,
        draw_order=30.0,
    )
    recording.log(path, points, static=True, strict=True)


class ShapePanes:
    """Panes of the shapes in three dimensions."""

    HALF_VIEW: Final = 0.52
    """Take half the height that a 3-D view shows at a distance of 1 as this."""
    ROOM: Final = (1000.0, 500.0)
    TITLE: Final = 28.0
    """Share this width and height among all shapes, less a title of each, in points of a common screen."""


def modes_page(identification: Identification, plan: Plan) -> Any:
    """Shapes beside their assurance and complexity, over the table in words and in numbers."""
    words: list[Any] = [document_view(MODES_TEXT, "Mode table"), document_view(CHOICES_TEXT, "Choices and warnings")]
    if plan.modes:
        columns = ["mode", *(f"/{MODES_TABLE}:{name}" for name in FIELDS)]
        query = rrb.archetypes.DataframeQuery(timeline="mode", select=columns)
        words.append(rrb.DataframeView(origin=MODES_TABLE, name="Numbers", query=query))
    below = rrb.Tabs(*words, active_tab=0, name="In words")
    if not plan.shapes:
        return rrb.Vertical(below, name="Modes")
    scene = scene_of(placement_in(identification, plan))
    points = _reached(scene, plan)
    n_columns, aspect = _grid(len(plan.shapes), scene, points)
    eye = _eye(scene, points, aspect)
    shapes = rrb.Grid(*[_shape(plan, number, eye) for number in plan.shapes], grid_columns=n_columns, name="Shapes")
    beside: list[Any] = [_assurance(len(plan.shapes))] if plan.compared else []
    beside.append(plot_view(complexity_pane(len(plan.shapes)), "Complexity of the shapes"))
    right = rrb.Vertical(*beside, row_shares=[1.2, 1.0][-len(beside) :], name="Compared")
    above = rrb.Horizontal(shapes, right, column_shares=[2.6, 1.0], name="Shapes")
    return rrb.Vertical(above, below, row_shares=[1.75, 1.0], name="Modes")


def _reached(scene: Scene, plan: Plan) -> FloatArray:
    """Every place that a node comes to in any of the shapes, (n, 3)."""
    places = [scene.positions]
    moving = scene.placement.motions.moving
    for number in plan.shapes:
        furthest = envelope_of(scene.motion(plan.modes[number - 1]))[moving]
        places += [scene.positions[moving] + furthest, scene.positions[moving] - furthest]
    return np.concatenate(places)


def _grid(n_views: int, scene: Scene, points: FloatArray) -> tuple[int, float]:
    """Columns of the grid of shapes and width over height of its panes: those that show the structure largest."""
    width, height = np.maximum(np.ptp(scene.eye.seen(points), axis=0), 0.3)
    sizes = {}
    for n_columns in range(1, min(n_views, 4) + 1):  # wide enough for a title
        pane = _pane(n_views, n_columns)
        sizes[n_columns] = min(pane[0] / width, pane[1] / height)
    n_columns = max(sizes, key=lambda one: (round(sizes[one], 6), -one))
    pane = _pane(n_views, n_columns)
    return n_columns, pane[0] / pane[1]


def _pane(n_views: int, n_columns: int) -> tuple[float, float]:
    return ShapePanes.ROOM[0] / n_columns, max(ShapePanes.ROOM[1] / -(-n_views // n_columns) - ShapePanes.TITLE, 20.0)


def _shape(plan: Plan, number: int, eye: Any) -> Any:
    mode = plan.modes[number - 1]
    resolved = mode.damping_resolved and mode.kind != "real"
    damping = ratio_text(mode.damping_ratio) if resolved else damping_text(mode).replace("not", "damping not")
    title = f"Mode {number}: {hertz(mode.frequency)} Hz, {damping}"  # the interval stands in the table
    if mode.verdict != "system":
        title = f"{mode.verdict.capitalize()} {number}: {hertz(mode.frequency)} Hz"
    return rrb.Spatial3DView(
        origin=shape_path(number),
        name=title,
        line_grid=rrb.LineGrid3D(visible=False),
        background=rrb.Background(Palette.BACKGROUND),
        eye_controls=eye,
    )


def _eye(scene: Scene, points: FloatArray, aspect: float) -> Any:
    """As near as the pane's shape allows, aimed at the middle of all that is seen; the same for every mode.

    At a distance D a point of depth z is seen at (x - x0) / (D - z); the aim x0 is moved until what is seen is centred.
    """
    eye = scene.eye
    seen = eye.seen(points)
    middle = (seen.min(axis=0) + seen.max(axis=0)) / 2
    depth = points @ eye.towards
    half = ShapePanes.HALF_VIEW * np.array([aspect, 1.0]) / 1.1
    distance = 1.0
    for _ in range(20):  # each time halving what is off
        needed = np.abs(seen - middle) / half + depth[:, np.newaxis]
        distance = max(float(needed.max()), float(depth.max()) + 0.5)
        on_screen = (seen - middle) / (distance - depth)[:, np.newaxis]
        middle = middle + 0.5 * distance * (on_screen.min(axis=0) + on_screen.max(axis=0)) / 2
    target = middle[0] * eye.right + middle[1] * eye.up
    return rrb.EyeControls3D(position=target + distance * eye.towards, look_target=target, eye_up=(0.0, 0.0, 1.0))


def _assurance(n_modes: int) -> Any:
    margin = 0.16 * n_modes
    return rrb.Spatial2DView(
        origin=ASSURANCE,
        name="MAC of the shapes, mode against mode",
        background=rrb.Background(Palette.BACKGROUND),
        visual_bounds=rrb.VisualBounds2D(
            x_range=(-margin, n_modes + 0.5 * margin), y_range=(-0.5 * margin, n_modes + margin)
        ),
    )
