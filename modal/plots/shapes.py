"""Shapes of modes: as sticks over the order of the sensors, as phasors, and compared with one another."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from modal.mode import Mode
from modal.names import plot_label
from modal.plots.style import LIGHT, Theme, head, new_figure, new_panels
from modal.report.words import hertz
from okid.arrays import ComplexArray, FloatArray

__all__ = ["assurance_matrix", "mode_shapes", "shape_complexity"]

MOST_COLUMNS = 6


def mode_shapes(modes: Sequence[Mode], *, output_names: Sequence[str], title: str = "", theme: Theme = LIGHT) -> Figure:
    """A stick picture of each mode: sensors from bottom to top in their order, deflection to both sides.

    The shape is turned to its best real phase; what is left (imaginary) is drawn thin and dotted.
    """
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
