"""How the page "Modes" opens; called by `modal.recording.blueprint`."""

from typing import Any, Final

import numpy as np

from modal.geometry.scene import Scene, envelope_of, scene_of
from modal.identification.result import Identification
from modal.identification.trust import damping_text
from modal.recording.identification.complexity import complexity_pane
from modal.recording.identification.modes import ASSURANCE, CHOICES_TEXT, FIELDS, MODES_TABLE, MODES_TEXT, placement_in
from modal.recording.identification.shapes import shape_path
from modal.recording.palette import BACKGROUND
from modal.recording.plan import Plan
from modal.recording.views_blueprint import document_view, plot_view
from modal.wording.numbers import hertz, ratio_text
from okid.arrays import FloatArray

__all__ = ["modes_page"]

HALF_VIEW: Final = 0.52
"""Half the height that a 3-D view shows, at a distance of 1."""

ROOM: Final = (1000.0, 500.0)
TITLE: Final = 28.0
"""Width and height of the room for all shapes on a common screen, and height of the title of each, in its points."""

MOST_COLUMNS: Final = 4
"""Panes side by side, so that each is wide enough for its title."""

MARGIN: Final = 1.1
AIMING: Final = 20
"""Steps of the search for the aim, each halving what is off."""


def modes_page(identification: Identification, plan: Plan) -> Any:
    """Shapes beside their assurance and complexity, over the table in words and in numbers."""
    import rerun.blueprint as rrb

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
    for n_columns in range(1, min(n_views, MOST_COLUMNS) + 1):
        pane = _pane(n_views, n_columns)
        sizes[n_columns] = min(pane[0] / width, pane[1] / height)
    n_columns = max(sizes, key=lambda one: (round(sizes[one], 6), -one))
    pane = _pane(n_views, n_columns)
    return n_columns, pane[0] / pane[1]


def _pane(n_views: int, n_columns: int) -> tuple[float, float]:
    return ROOM[0] / n_columns, max(ROOM[1] / -(-n_views // n_columns) - TITLE, 20.0)


def _shape(plan: Plan, number: int, eye: Any) -> Any:
    import rerun.blueprint as rrb

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
        background=rrb.Background(BACKGROUND),
        eye_controls=eye,
    )


def _eye(scene: Scene, points: FloatArray, aspect: float) -> Any:
    """As near as the pane's shape allows, aimed at the middle of all that is seen; the same for every mode.

    At a distance D a point of depth z is seen at (x - x0) / (D - z); the aim x0 is moved until what is seen is centred.
    """
    import rerun.blueprint as rrb

    eye = scene.eye
    seen = eye.seen(points)
    middle = (seen.min(axis=0) + seen.max(axis=0)) / 2
    depth = points @ eye.towards
    half = HALF_VIEW * np.array([aspect, 1.0]) / MARGIN
    distance = 1.0
    for _ in range(AIMING):
        needed = np.abs(seen - middle) / half + depth[:, np.newaxis]
        distance = max(float(needed.max()), float(depth.max()) + 0.5)
        on_screen = (seen - middle) / (distance - depth)[:, np.newaxis]
        middle = middle + 0.5 * distance * (on_screen.min(axis=0) + on_screen.max(axis=0)) / 2
    target = middle[0] * eye.right + middle[1] * eye.up
    return rrb.EyeControls3D(position=target + distance * eye.towards, look_target=target, eye_up=(0.0, 0.0, 1.0))


def _assurance(n_modes: int) -> Any:
    import rerun.blueprint as rrb

    margin = 0.16 * n_modes
    return rrb.Spatial2DView(
        origin=ASSURANCE,
        name="Assurance of the shapes",
        background=rrb.Background(BACKGROUND),
        visual_bounds=rrb.VisualBounds2D(
            x_range=(-margin, n_modes + 0.5 * margin), y_range=(-0.5 * margin, n_modes + margin)
        ),
    )
