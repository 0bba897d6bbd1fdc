"""Shapes of modes: as sticks over the order of the sensors, as phasors, and compared with one another."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from modal.geometry import Geometry
from modal.mode import Mode
from modal.names import plot_label
from modal.placement import at_rest, placed
from modal.plots.structure import draw_lines, draw_surfaces, frame_of, place_labels
from modal.plots.style import LIGHT, Theme, head, new_figure, new_panels
from modal.report.words import hertz
from modal.scene import Scene, scene_of
from modal.sticks import stated_dofs
from okid.arrays import ComplexArray, FloatArray

__all__ = ["assurance_matrix", "geometry_picture", "mode_shapes", "shape_complexity"]

MOST_COLUMNS = 6
WIDTH = 10.4
TALLEST = 4.2
"""Inches: a page shows a structure about 3.5 inches tall; drawn much taller, its names would shrink beyond reading."""
ARROW = 0.24
"""Length of a sensor's arrow, in half the largest extent."""
MOST_ARROWS = 300
MOST_DOTS = 1000
MOST_NAMED = 120
"""Arrows, dots and names that one picture can show."""


def mode_shapes(
    modes: Sequence[Mode],
    *,
    output_names: Sequence[str],
    output_units: Sequence[str] = (),
    geometry: Geometry | None = None,
    title: str = "",
    theme: Theme = LIGHT,
) -> Figure:
    """Every mode on the geometry, at rest and at both ends of its motion, all seen from the same side.

    A shape is turned to its best real phase. Without a geometry, and where the names state no nodes, it is a stick
    picture: sensors from bottom to top in their order, deflection to both sides, what is left (imaginary) dotted.

    Args:
        modes: one a panel.
        output_names: of the channels.
        output_units: of the channels; all alike unless given.
        geometry: where they are.
        title: above all.
        theme: colours.

    Raises:
        InvalidDataError: no output has a place in the geometry.
    """
    if geometry is None and not stated_dofs(output_names):
        return _in_a_row(modes, output_names=output_names, title=title, theme=theme)
    scene = scene_of(placed(geometry, output_names, output_units))
    motions = [scene.motion(mode).real for mode in modes]
    rest = scene.positions
    frame = frame_of(scene, [rest] + [rest + sign * motion for motion in motions for sign in (1, -1)])
    most = _columns(frame.aspect)
    n_columns = -(-max(len(modes), 1) // -(-max(len(modes), 1) // most))  # rows of equal length
    height = WIDTH / n_columns * frame.aspect + 0.25
    figure, axes = new_panels(len(modes), most_columns=n_columns, width=WIDTH, height=height, theme=theme)
    for axis, mode, motion in zip(axes, modes, motions, strict=True):
        colour = theme.verdict(mode.verdict)
        draw_surfaces(axis, scene, rest + motion, colour=colour, alpha=0.16)
        draw_lines(axis, scene, rest, colour=theme.muted, width=0.7, alpha=0.75)
        draw_lines(axis, scene, rest - motion, colour=colour, width=0.8, alpha=0.45)
        draw_lines(axis, scene, rest + motion, colour=colour, width=1.8, alpha=1.0)
        _draw_points(axis, scene, rest + motion, theme=theme, colour=colour)
        frame.put(axis)
        head(axis, f"{hertz(mode.frequency)} Hz", theme=theme, where="center")
    if title:
        figure.suptitle(plot_label(title, limit=80), color=theme.ink, fontsize=10)
    return figure


def geometry_picture(geometry: Geometry, *, output_names: Sequence[str] = (), theme: Theme = LIGHT) -> Figure:
    """The structure at rest: nodes with their names, lines, surfaces, and an arrow for each sensor.

    Args:
        geometry: what to draw.
        output_names: channels whose sensors are drawn; those of the geometry's own sensors unless given.
        theme: colours.

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
    figure, axes = new_figure(1, 1, size=(width, height), theme=theme)
    axis = axes[0][0]
    draw_surfaces(axis, scene, rest, colour=theme.measured, alpha=0.12)
    draw_lines(axis, scene, rest, colour=theme.muted, width=1.3, alpha=1.0)
    for tail, arrow in arrows[:MOST_ARROWS]:
        start, end = scene.eye.seen(np.array([tail, tail + arrow]))
        axis.annotate(
            "", xy=end, xytext=start, arrowprops={"arrowstyle": "-|>", "color": theme.model, "lw": 1.3, "shrinkA": 0}
        )
    _draw_points(axis, scene, rest, theme=theme, colour=theme.measured)
    frame.put(axis)
    if geometry.n_nodes <= MOST_NAMED:
        texts = [plot_label(name, limit=12) for name in geometry.node_names]
        place_labels(axis, frame, scene.eye.seen(rest), texts, panel=(width, height), theme=theme)
    return figure


def _columns(aspect: float) -> int:
    """Panels in a row, by height over width: upright structures stand side by side, flat ones have room."""
    for n_columns, least in ((6, 1.05), (4, 0.75)):
        if aspect >= least:
            return n_columns
    return 3


def _draw_points(axis: Axes, scene: Scene, positions: FloatArray, *, theme: Theme, colour: str) -> None:
    """Measured nodes as dots, those known to stand still as squares."""
    seen = scene.eye.seen(positions)
    measured = sorted({one.node for one in scene.placement.sensors if one is not None})
    if len(measured) <= MOST_DOTS:
        axis.plot(*seen[measured].T, "o", color=colour, ms=4.0 if len(measured) <= 40 else 2.5)
    fixed = list(scene.placement.geometry.fixed)
    if 0 < len(fixed) <= MOST_DOTS:
        axis.plot(*seen[fixed].T, "s", color=theme.muted, ms=4.5)


def _in_a_row(modes: Sequence[Mode], *, output_names: Sequence[str], title: str, theme: Theme) -> Figure:
    height = float(np.clip(0.26 * len(output_names) + 1.4, 2.4, 6.5))
    figure, axes = new_panels(len(modes), most_columns=MOST_COLUMNS, width=10.4, height=height, theme=theme)
    place = np.arange(1, len(output_names) + 1)
    for index, (axis, mode) in enumerate(zip(axes, modes, strict=True)):
        shape = _best_phase(mode.shape)
        colour = theme.verdict(mode.verdict)
        axis.axvline(0, color=theme.muted, lw=0.9, ls=(0, (4, 3)))
        axis.fill_betweenx(place, -shape.real, shape.real, color=colour, alpha=0.10, lw=0)
        axis.plot(-shape.real, place, color=colour, lw=0.8, alpha=0.4)
        axis.plot(shape.real, place, "-o", color=colour, lw=1.8, ms=5)
        if np.abs(shape.imag).max() > 0.05:
            axis.plot(shape.imag, place, ":", color=theme.muted, lw=1.1)
        head(axis, f"{hertz(mode.frequency)} Hz", theme=theme, where="center")
        axis.set_xlim(-1.18, 1.18)
        axis.set_ylim(0.4, len(output_names) + 0.6)
        axis.set_xticks([-1, 0, 1])
        axis.grid(visible=False)
        axis.spines["left"].set_visible(False)
        axis.set_yticks(place if len(place) <= 24 else place[:: -(-len(place) // 24)])
        labels = [plot_label(output_names[int(tick) - 1], limit=14) for tick in axis.get_yticks()]
        axis.set_yticklabels(labels if index % MOST_COLUMNS == 0 else [])
    if title:
        figure.suptitle(plot_label(title, limit=80), color=theme.ink, fontsize=10)
    return figure


def shape_complexity(modes: Sequence[Mode], *, theme: Theme = LIGHT) -> Figure:
    """Every shape component as a phasor, greatest 1: a real mode lies on one line."""
    figure, axes = new_panels(len(modes), most_columns=MOST_COLUMNS, width=10.4, height=2.1, theme=theme)
    circle = np.exp(2j * np.pi * np.linspace(0, 1, 97))
    for axis, mode in zip(axes, modes, strict=True):
        colour = theme.verdict(mode.verdict)
        axis.plot(circle.real, circle.imag, color=theme.grid, lw=0.9)
        axis.plot([-1, 1], [0, 0], color=theme.grid, lw=0.7)
        axis.plot([0, 0], [-1, 1], color=theme.grid, lw=0.7)
        for component in _best_phase(mode.shape):
            axis.plot([0, component.real], [0, component.imag], color=colour, lw=1.4)
            axis.plot(component.real, component.imag, "o", color=colour, ms=3.6)
        axis.set_aspect("equal")
        axis.set_xlim(-1.12, 1.12)
        axis.set_ylim(-1.12, 1.12)
        axis.set_axis_off()
        spread = f"mean deviation {mode.mpd:.0f}°" if np.isfinite(mode.mpd) else ""
        head(axis, f"{hertz(mode.frequency)} Hz\n{spread}".strip(), theme=theme, where="center")
    return figure


def assurance_matrix(matrix: FloatArray, frequencies: Sequence[float], *, theme: Theme = LIGHT) -> Figure:
    """Modal assurance of each pair of shapes, as depth of colour and as a number.

    Args:
        matrix: (n_modes, n_modes) in [0, 1].
        frequencies: (n_modes,) [Hz] to name the modes by.
        theme: colours.
    """
    n_modes = len(frequencies)
    side = float(np.clip(0.55 * n_modes + 1.3, 2.6, 7.5))
    figure, axes = new_figure(1, 1, size=(side + 0.3, side), theme=theme)
    axis = axes[0][0]
    for row in range(n_modes):
        for column in range(n_modes):
            value = float(np.clip(matrix[row, column], 0.0, 1.0))
            axis.fill_between(
                [column - 0.47, column + 0.47], row - 0.47, row + 0.47, alpha=0.75 * value, color=theme.measured, lw=0
            )
            if n_modes <= 16:
                number = f"{value:.2f}".removeprefix("0") if value < 0.995 else "1"
                axis.text(column, row, number, ha="center", va="center", fontsize=8, color=theme.ink)
    labels = [hertz(frequency) for frequency in frequencies]
    axis.set_xticks(range(n_modes), labels, rotation=90 if n_modes > 6 else 0)
    axis.set_yticks(range(n_modes), labels)
    axis.set_xlim(-0.5, n_modes - 0.5)
    axis.set_ylim(n_modes - 0.5, -0.5)
    axis.set_xlabel("mode [Hz]")
    axis.set_ylabel("mode [Hz]")
    axis.grid(visible=False)
    for spine in axis.spines.values():
        spine.set_visible(False)
    axis.set_aspect("equal")
    return figure


def _best_phase(shape: ComplexArray) -> ComplexArray:
    """The shape turned so that its real part carries as much as it can; its greatest component points right."""
    turned = shape * np.exp(-0.5j * np.angle(np.sum(shape**2)))
    largest = turned[np.argmax(np.abs(turned))]
    if largest.real < 0:
        turned = -turned
    size = np.abs(turned).max()
    return np.asarray(turned / size if size > 0 else turned, dtype=np.complex128)
