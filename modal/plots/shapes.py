"""Shapes of modes: as sticks over the order of the sensors, as phasors, and compared with one another."""

from collections.abc import Sequence

import numpy as np

from modal.geometry.placement import at_rest, placed
from modal.geometry.scene import Scene, scene_of
from modal.geometry.sensors import Geometry
from modal.geometry.sticks import stated_dofs
from modal.modes.mode import Mode
from modal.plots.layout import Chart, grid_of, row_of
from modal.plots.panels import Panel
from modal.plots.structure import draw_lines, draw_surfaces, frame_of, place_labels
from modal.plots.style import STYLE, Role
from modal.wording.names import plot_label
from modal.wording.numbers import hertz
from okid.arrays import ComplexArray, FloatArray

__all__ = ["assurance_matrix", "geometry_picture", "mode_shapes", "shape_complexity"]

MOST_COLUMNS = 6
MOST_NAMES = 24
"""Stand so many panels in a row and so many names of outputs beside a stick."""
LEAST_IMAGINARY = 0.05
"""Draw the imaginary part of a shape where it exceeds this, of the greatest component."""
TALLEST = 4.2
"""Draw at most so tall [in]: a page shows a structure about 3.5 inches tall, and smaller names cannot be read."""
ARROW = 0.24
"""Draw a sensor's arrow this long, in half the largest extent."""
MOST_ARROWS = 300
MOST_DOTS = 1000
MOST_NAMED = 120
MOST_LARGE = 40
"""Show at most so many arrows, dots, names and large dots in one picture."""


def mode_shapes(
    modes: Sequence[Mode],
    *,
    output_names: Sequence[str],
    output_units: Sequence[str] = (),
    geometry: Geometry | None = None,
    title: str = "",
) -> Chart:
    """Every mode on the geometry, at rest and at both ends of its motion, all seen from the same side.

    A shape is turned to its best real phase. Without a geometry, and where the names state no nodes, it is a stick
    picture: sensors from bottom to top in their order, deflection to both sides, what is left (imaginary) dotted.

    Args:
        modes: one a panel.
        output_names: of the channels.
        output_units: of the channels; all alike unless given.
        geometry: where they are.
        title: above all.

    Raises:
        InvalidDataError: no output has a place in the geometry.
    """
    if geometry is None and not stated_dofs(output_names):
        return _in_a_row(modes, output_names=output_names, title=title)
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
    figure.title = plot_label(title, limit=80)
    return figure


def geometry_picture(geometry: Geometry, *, output_names: Sequence[str] = ()) -> Chart:
    """The structure at rest: nodes with their names, lines, surfaces, and an arrow for each sensor.

    Args:
        geometry: what to draw.
        output_names: channels whose sensors are drawn; those of the geometry's own sensors unless given.

    Raises:
        InvalidDataError: output names were given, and none of them has a place in the geometry.
    """
    names = list(output_names) or [sensor.name for sensor in geometry.sensors]
    scene = scene_of(placed(geometry, names) if names else at_rest(geometry))
    rest = scene.positions
    arrows = [(rest[one.node], ARROW * one.direction) for one in scene.placement.sensors if one is not None]
    frame = frame_of(scene, [rest, *((tail + arrow)[np.newaxis] for tail, arrow in arrows)])
    width = float(np.clip(4.2 / frame.aspect, 2.6, 7.5))
    height = min(width * frame.aspect, TALLEST)
    figure = grid_of(1, 1, size=(width, height))
    panel = figure.panels[0]
    draw_surfaces(panel, scene, rest, "measured", opacity=STYLE.faint)
    draw_lines(panel, scene, rest, "muted", width=STYLE.stroke)
    ends = [scene.eye.seen(np.array([tail, tail + arrow])) for tail, arrow in arrows[:MOST_ARROWS]]
    panel.segments(ends, "model", arrows=True)
    _draw_points(panel, scene, rest, "measured")
    frame.put(panel)
    if geometry.n_nodes <= MOST_NAMED:
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
    if len(measured) <= MOST_DOTS:
        panel.dots(seen[measured, 0], seen[measured, 1], role, dot=STYLE.dot if len(measured) <= MOST_LARGE else 3.5)
    fixed = list(scene.placement.geometry.fixed)
    if 0 < len(fixed) <= MOST_DOTS:
        panel.dots(seen[fixed, 0], seen[fixed, 1], "muted", dot=5.5, square=True)


def _in_a_row(modes: Sequence[Mode], *, output_names: Sequence[str], title: str) -> Chart:
    height = float(np.clip(0.26 * len(output_names) + 1.4, 2.4, 6.5))
    figure = row_of(len(modes), most_columns=MOST_COLUMNS, width=STYLE.page, height=height)
    place = np.arange(1, len(output_names) + 1)
    labels = [(float(tick), plot_label(output_names[tick - 1], limit=14)) for tick in place.tolist()]
    for index, (panel, mode) in enumerate(zip(figure.panels, modes, strict=False)):
        shape = _best_phase(mode.shape)
        sides = np.stack([shape.real, place], axis=-1), np.stack([-shape.real, place], axis=-1)[::-1]
        panel.upright(0.0, "muted", width=STYLE.thin, dash="dashed")
        panel.polygons([np.concatenate(sides)], mode.verdict, opacity=STYLE.faint)
        panel.line(-shape.real, place, mode.verdict, width=STYLE.thin, opacity=STYLE.half)
        panel.line(shape.real, place, mode.verdict, width=STYLE.thick, dot=STYLE.dot)
        if np.abs(shape.imag).max() > LEAST_IMAGINARY:
            panel.line(shape.imag, place, "muted", dash="dotted")
        panel.head, panel.centred = f"{hertz(mode.frequency)} Hz", True
        panel.x.limits, panel.y.limits = (-1.18, 1.18), (0.4, len(output_names) + 0.6)
        panel.x.ticks = [(-1.0, "−1"), (0.0, "0"), (1.0, "1")]
        panel.y.ticks = labels[:: -(-len(labels) // MOST_NAMES)]
        panel.y.labelled, panel.edges = index % MOST_COLUMNS == 0, "below"
        panel.x.grid = panel.y.grid = False
    figure.title = plot_label(title, limit=80)
    return figure


def shape_complexity(modes: Sequence[Mode]) -> Chart:
    """Every shape component as a phasor, greatest 1: a real mode lies on one line."""
    figure = row_of(len(modes), most_columns=MOST_COLUMNS, width=STYLE.page, height=2.1)
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
    figure = grid_of(1, 1, size=(side + 0.3, side))
    panel = figure.panels[0]
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
