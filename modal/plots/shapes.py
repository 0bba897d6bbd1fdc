"""Shapes of modes: as sticks over the order of the sensors, as phasors, and compared with one another.

A structure in parallel projection: lines, surfaces and nodes at rest and deflected, on flat axes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from modal.geometry.placement import at_rest, guessed_grid, placed, stated_dofs
from modal.geometry.scene import Scene, scene_of
from modal.geometry.sensors import Geometry
from modal.modes.mode import Mode
from modal.plots.chart import Chart, one_panel, row_of
from modal.plots.panels import STYLE, Panel, Role, text_width
from modal.wording.text import hertz, plot_label
from okid.arrays import ComplexArray, FloatArray


class ShapeLimits:
    """How much of a structure one picture shows."""

    MOST_SEGMENTS: Final = 3000
    """Draw at most so many lines in one panel, and as many triangles: a picture of thousands of nodes stays light."""
    MOST_COLUMNS: Final = 6
    """Stand so many panels in a row."""
    MOST_DOTS: Final = 1000
    """Show at most so many dots in one picture."""


NAME_SIZE: Final = 7.5
"""Write the names of nodes so large [pt]."""


@dataclass(frozen=True, slots=True, eq=False)
class Viewport:
    """The part of the flat picture that holds everything."""

    low: FloatArray
    high: FloatArray

    @property
    def aspect(self) -> float:
        """Height over width."""
        width, height = self.high - self.low
        return float(height / width)

    def put(self, panel: Panel) -> None:
        """Give the panel this range, equal scales, and nothing else."""
        (left, bottom), (right, top) = self.low.tolist(), self.high.tolist()
        panel.x.limits, panel.y.limits = (left, right), (bottom, top)
        panel.equal, panel.frame = True, False


def frame_of(scene: Scene, positions: Sequence[FloatArray]) -> Viewport:
    """A frame around nodes in several positions, each (n_nodes, 3), with a margin; never flatter than 1 to 4."""
    seen = scene.eye.seen(np.concatenate(positions))
    low, high = seen.min(axis=0), seen.max(axis=0)
    margin = 0.06 * max(float((high - low).max()), 1e-6)
    low, high = low - margin, high + margin
    least = 0.25 * float((high - low).max())
    short = np.maximum(least - (high - low), 0.0) / 2
    return Viewport(low - short, high + short)


def draw_lines(
    panel: Panel, scene: Scene, positions: FloatArray, role: Role, *, width: float, opacity: float = 1.0
) -> None:
    """The lines of the structure with its nodes at `positions` (n_nodes, 3)."""
    segments = scene.drawn_segments(ShapeLimits.MOST_SEGMENTS)
    if len(segments):
        seen = scene.eye.seen(positions)
        panel.segments(seen[segments], role, width=width, opacity=opacity)


def draw_surfaces(panel: Panel, scene: Scene, positions: FloatArray, role: Role, *, opacity: float) -> None:
    """The surfaces of the structure, those behind first."""
    triangles = scene.triangles[:: -(-len(scene.triangles) // ShapeLimits.MOST_SEGMENTS) or 1]
    if not len(triangles):
        return
    depth = (positions @ scene.eye.towards)[triangles].mean(axis=1)
    corners = scene.eye.seen(positions)[triangles[np.argsort(depth, kind="stable")]]
    panel.polygons(corners, role, opacity=opacity)


def place_labels(
    panel: Panel, frame: Viewport, places: FloatArray, texts: Sequence[str], *, size: tuple[float, float]
) -> None:
    """Names beside points, each where it covers no point and no other name; one that has no room is left out.

    Args:
        panel: to write into.
        frame: that it shows.
        places: (n, 2) points in the picture.
        texts: one a point.
        size: width and height of the panel [in].
    """
    points_per_unit = 72 * min(size / (frame.high - frame.low))
    taken: list[tuple[float, float, float, float]] = [
        (x - 2.0, y - 2.0, x + 2.0, y + 2.0) for x, y in (places * points_per_unit).tolist()
    ]
    sides: tuple[tuple[float, float], ...] = ((1, 0.6), (1, -0.6), (-1, 0.6), (-1, -0.6), (0, 1.4), (0, -1.4))
    for (x, y), text in zip((places * points_per_unit).tolist(), texts, strict=True):
        width, height = text_width(text, NAME_SIZE) + 2.0, 9.0
        for right, up in sides:
            left = x + 5.0 * right - width * (1 - right) / 2
            bottom = y + 7.0 * up - height / 2
            box = (left, bottom, left + width, bottom + height)
            if not any(box[0] < b[2] and b[0] < box[2] and box[1] < b[3] and b[1] < box[3] for b in taken):
                taken.append(box)
                centre = np.array([left + width / 2, bottom + height / 2]) / points_per_unit
                shift = (0.0, NAME_SIZE / 3)
                panel.word(
                    float(centre[0]), float(centre[1]), text, "muted", size=NAME_SIZE, anchor="middle", shift=shift
                )
                break


def mode_shapes(
    modes: Sequence[Mode],
    *,
    output_names: Sequence[str],
    output_units: Sequence[str] = (),
    geometry: Geometry | None = None,
) -> Chart:
    """Every mode on the geometry, at rest and at both ends of its motion, all seen from the same side.

    A shape is turned to its best real phase. Without a geometry, and where the names state no nodes, it is a stick
    picture: sensors from bottom to top in their order, deflection to both sides, what is left (imaginary) dotted.

    Raises:
        InvalidDataError: no output has a place in the geometry.
    """
    if geometry is None and not stated_dofs(output_names) and not guessed_grid(output_names, output_units):
        return _in_a_row(modes, output_names)
    scene = scene_of(placed(geometry, output_names, output_units))
    motions = [scene.motion(mode).real for mode in modes]
    rest = scene.positions
    frame = frame_of(scene, [rest] + [rest + sign * motion for motion in motions for sign in (1, -1)])
    most = _columns(frame.aspect)
    n_columns = -(-max(len(modes), 1) // -(-max(len(modes), 1) // most))  # rows of equal length
    height = STYLE.page / n_columns * frame.aspect + 0.25
    figure = row_of(len(modes), most_columns=n_columns, width=STYLE.page, height=height)
    for panel, mode, motion in zip(figure.panels, modes, motions, strict=False):
        draw_surfaces(panel, scene, rest + motion, mode.verdict, opacity=STYLE.faint)
        draw_lines(panel, scene, rest, "muted", width=STYLE.thin, opacity=STYLE.strong)
        draw_lines(panel, scene, rest - motion, mode.verdict, width=STYLE.thin, opacity=STYLE.half)
        draw_lines(panel, scene, rest + motion, mode.verdict, width=STYLE.thick)
        _draw_points(panel, scene, rest + motion, mode.verdict)
        frame.put(panel)
        panel.head, panel.centred = f"{hertz(mode.frequency)} Hz", True
    return figure


def geometry_picture(geometry: Geometry, *, output_names: Sequence[str] = ()) -> Chart:
    """The structure at rest: nodes with their names, lines, surfaces, and an arrow for each sensor.

    Raises:
        InvalidDataError: output names were given, and none of them has a place in the geometry.
    """
    names = list(output_names) or [sensor.name for sensor in geometry.sensors]
    scene = scene_of(placed(geometry, names) if names else at_rest(geometry))
    rest = scene.positions
    # half the largest extent is 1
    arrows = [(rest[one.node], 0.24 * one.direction) for one in scene.placement.sensors if one is not None]
    frame = frame_of(scene, [rest, *((tail + arrow)[np.newaxis] for tail, arrow in arrows)])
    width = float(np.clip(4.2 / frame.aspect, 2.6, 7.5))
    height = min(width * frame.aspect, 4.2)  # a page shows about 3.5 inches
    figure, panel = one_panel(width, height)
    draw_surfaces(panel, scene, rest, "measured", opacity=STYLE.faint)
    draw_lines(panel, scene, rest, "muted", width=STYLE.stroke)
    ends = [scene.eye.seen(np.array([tail, tail + arrow])) for tail, arrow in arrows[:300]]  # of more, the first
    panel.segments(ends, "model", arrows=True)
    _draw_points(panel, scene, rest, "measured")
    frame.put(panel)
    if geometry.n_nodes <= 120:  # more names would cover the picture
        texts = [plot_label(name, limit=12) for name in geometry.node_names]
        place_labels(panel, frame, scene.eye.seen(rest), texts, size=(width, height))
    return figure


def _columns(aspect: float) -> int:
    """Panels in a row, by height over width: upright structures stand side by side, flat ones have room."""
    for n_columns, least in ((6, 1.05), (4, 0.75)):
        if aspect >= least:
            return n_columns
    return 3


def _draw_points(panel: Panel, scene: Scene, positions: FloatArray, role: Role) -> None:
    """Measured nodes as dots, those known to stand still as squares."""
    seen = scene.eye.seen(positions)
    measured = sorted({one.node for one in scene.placement.sensors if one is not None})
    if len(measured) <= ShapeLimits.MOST_DOTS:
        panel.dots(
            seen[measured, 0],
            seen[measured, 1],
            role,
            dot=STYLE.dot if len(measured) <= 40 else 3.5,
        )
    fixed = list(scene.placement.geometry.fixed)
    if 0 < len(fixed) <= ShapeLimits.MOST_DOTS:
        panel.dots(seen[fixed, 0], seen[fixed, 1], "muted", dot=5.5, square=True)


def _in_a_row(modes: Sequence[Mode], output_names: Sequence[str]) -> Chart:
    height = float(np.clip(0.26 * len(output_names) + 1.4, 2.4, 6.5))
    figure = row_of(len(modes), most_columns=ShapeLimits.MOST_COLUMNS, width=STYLE.page, height=height)
    place = np.arange(1, len(output_names) + 1)
    labels = [(float(tick), plot_label(output_names[tick - 1], limit=14)) for tick in place.tolist()]
    for index, (panel, mode) in enumerate(zip(figure.panels, modes, strict=False)):
        shape = _best_phase(mode.shape)
        sides = np.stack([shape.real, place], axis=-1), np.stack([-shape.real, place], axis=-1)[::-1]
        panel.upright(0.0, "muted", width=STYLE.thin, dash="dashed")
        panel.polygons([np.concatenate(sides)], mode.verdict, opacity=STYLE.faint)
        panel.line(-shape.real, place, mode.verdict, width=STYLE.thin, opacity=STYLE.half)
        panel.line(shape.real, place, mode.verdict, width=STYLE.thick, dot=STYLE.dot)
        if np.abs(shape.imag).max() > 0.05:  # of the greatest component
            panel.line(shape.imag, place, "muted", dash="dotted")
        panel.head, panel.centred = f"{hertz(mode.frequency)} Hz", True
        panel.x.limits, panel.y.limits = (-1.18, 1.18), (0.4, len(output_names) + 0.6)
        panel.x.ticks = [(-1.0, "−1"), (0.0, "0"), (1.0, "1")]
        panel.y.ticks = labels[:: -(-len(labels) // 24)]
        panel.y.labelled, panel.edges = index % ShapeLimits.MOST_COLUMNS == 0, "below"
        panel.x.grid = panel.y.grid = False
    return figure


def shape_complexity(modes: Sequence[Mode]) -> Chart:
    """Every shape component as a phasor, greatest 1: a real mode lies on one line."""
    figure = row_of(len(modes), most_columns=ShapeLimits.MOST_COLUMNS, width=STYLE.page, height=2.1)
    circle = np.exp(2j * np.pi * np.linspace(0, 1, 97))
    for panel, mode in zip(figure.panels, modes, strict=False):
        tips = np.stack([(shape := _best_phase(mode.shape)).real, shape.imag], axis=-1)
        panel.line(circle.real, circle.imag, "grid", width=STYLE.thin)
        panel.segments([[[-1, 0], [1, 0]], [[0, -1], [0, 1]]], "grid", width=STYLE.thin)
        panel.segments(np.stack([np.zeros_like(tips), tips], axis=1), mode.verdict)
        panel.dots(tips[:, 0], tips[:, 1], mode.verdict, dot=STYLE.dot)
        panel.equal, panel.frame = True, False
        panel.x.limits = panel.y.limits = (-1.12, 1.12)
        spread = f"mean deviation {mode.mpd:.0f}°" if np.isfinite(mode.mpd) else ""
        panel.head, panel.centred = f"{hertz(mode.frequency)} Hz\n{spread}".strip(), True
    return figure


def assurance_matrix(matrix: FloatArray, frequencies: Sequence[float]) -> Chart:
    """Modal assurance of each pair of shapes, as depth of colour and as a number.

    Args:
        matrix: (n_modes, n_modes) in [0, 1].
        frequencies: (n_modes,) [Hz] to name the modes by.
    """
    n_modes = len(frequencies)
    side = float(np.clip(0.55 * n_modes + 1.3, 2.6, 7.5))
    figure, panel = one_panel(side + 0.3, side)
    for row in range(n_modes):
        for column in range(n_modes):
            value = float(np.clip(matrix[row, column], 0.0, 1.0))
            x, y = ((place - 0.47, place + 0.47) for place in (column, row))
            panel.box_of(x, y, "measured", opacity=0.75 * value)
            if n_modes <= 16:
                number = f"{value:.2f}".removeprefix("0") if value < 0.995 else "1"
                panel.word(column, row, number, "ink", size=8, anchor="middle", shift=(0.0, 8 / 3))
    panel.x.ticks = panel.y.ticks = [(float(place), hertz(one)) for place, one in enumerate(frequencies)]
    panel.x.upright, panel.equal = n_modes > 6, True
    panel.x.limits, panel.y.limits = (-0.5, n_modes - 0.5), (n_modes - 0.5, -0.5)
    panel.x.label = panel.y.label = "mode [Hz]"
    panel.x.grid = panel.y.grid = False
    panel.edges = "none"
    return figure


def _best_phase(shape: ComplexArray) -> ComplexArray:
    """The shape turned so that its real part carries as much as it can; its greatest component points right."""
    turned = shape * np.exp(-0.5j * np.angle(np.sum(shape**2)))
    largest = turned[np.argmax(np.abs(turned))]
    if largest.real < 0:
        turned = -turned
    size = np.abs(turned).max()
    return np.asarray(turned / size if size > 0 else turned, dtype=np.complex128)
