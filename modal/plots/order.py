"""What the model order was decided on: singular values, fit against order, and which poles stay when it grows."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from modal.identification import OrderEvidence, StabilisationPoint
from modal.mode import ModalModel
from modal.plots.spectra import power_spectra
from modal.plots.style import LIGHT, Theme, key, new_figure
from modal.report.words import hertz
from okid.arrays import FloatArray
from okid.record import Record

__all__ = ["colour_measure", "order_fits", "pole_classes", "singular_values", "stabilisation_diagram"]

MOST_POLES = 4000
"""Poles of all orders that a stabilisation diagram draws; with more of them, only every second, third, ... order."""

MOST_LEVELS = 4
"""Lines of labels above the diagram; where modes stand closer than that, some have no label."""

OVERLAP_CLASSES = ((0.0, 0.5, "new"), (0.5, 0.8, "0.5 to 0.8"), (0.8, 0.95, "0.8 to 0.95"), (0.95, 1.01, "above 0.95"))
"""Overlap with the pole that it continues: (from, below, word)."""
REPEATABILITY_CLASSES = (
    (0.0, 0.4, "below 0.4"),
    (0.4, 0.7, "0.4 to 0.7"),
    (0.7, 0.9, "0.7 to 0.9"),
    (0.9, 1.01, "above 0.9"),
)
"""Repeatability over halves of the data and another observer: (from, below, word)."""


def singular_values(evidence: OrderEvidence, *, theme: Theme = LIGHT, limit: int = 120) -> Figure:
    """Singular values of the scaled block Hankel matrix on a log axis: kept, dropped, and where the widest gap is."""
    figure, axes = new_figure(1, 1, size=(5.2, 3.3), theme=theme)
    axis = axes[0][0]
    values = np.asarray(evidence.singular_values)[:limit]
    if not values.size or values.max() <= 0:
        axis.text(0.5, 0.5, "no singular values are known", ha="center", color=theme.muted, transform=axis.transAxes)
        return figure
    relative = np.maximum(values / values.max(), 1e-17)
    index = np.arange(1, values.size + 1)
    kept = index <= evidence.order
    axis.semilogy(index[~kept], relative[~kept], "o", ms=3.6, color=theme.noise, label="dropped")
    axis.semilogy(index[kept], relative[kept], "o", ms=4.6, color=theme.system, label="kept")
    axis.axvline(evidence.order + 0.5, color=theme.model, lw=1.2, label=f"order {evidence.order} chosen")
    if evidence.gap_order != evidence.order and evidence.gap_order < values.size:
        gap = f"widest gap after {evidence.gap_order}"
        axis.axvline(evidence.gap_order + 0.5, color=theme.muted, lw=1.0, ls=":", label=gap)
    axis.set_xlabel("number")
    axis.set_ylabel("singular value / largest")
    axis.margins(x=0.02)
    key(axis, theme=theme, where="upper right")
    return figure


def order_fits(evidence: OrderEvidence, *, theme: Theme = LIGHT) -> Figure:
    """Cross-validated fit against model order; an unstable one has no point, a very bad one stands at the edge."""
    figure, axes = new_figure(1, 1, size=(5.2, 3.3), theme=theme)
    axis = axes[0][0]
    orders, fits = np.asarray(evidence.candidate_orders, dtype=float), np.asarray(evidence.candidate_fits, dtype=float)
    there = np.isfinite(fits)
    if not there.any():
        axis.text(0.5, 0.5, "no fits were compared", ha="center", color=theme.muted, transform=axis.transAxes)
        return figure
    floor = min(-0.1, 0.0) if fits[there].max() > 0 else float(fits[there].max()) - 0.5
    shown = np.maximum(fits[there], floor)
    axis.plot(orders[there], shown, "-o", ms=3.6, lw=1.1, color=theme.measured, label="on rows not fitted to")
    axis.axhline(0.5, color=theme.doubtful, lw=1.0, ls="--", label="0.5: below it no mode is certain")
    axis.axvline(evidence.order, color=theme.model, lw=1.2, label=f"order {evidence.order} chosen")
    axis.set_ylim(floor - 0.03, max(1.0, float(shown.max()) + 0.03))
    axis.set_xlabel("model order")
    axis.set_ylabel("cross-validated fit")
    key(axis, theme=theme, where="lower right")
    return figure


def stabilisation_diagram(
    evidence: OrderEvidence,
    modes: ModalModel,
    *,
    measured: Sequence[Record] = (),
    theme: Theme = LIGHT,
) -> Figure:
    """Every pole of every model order over the power of the measured outputs, coloured by how well it is found again.

    Args:
        evidence: holds the poles of all orders; where their repeatability is not known, the colour is the overlap with
            the pole of the next lower order. Of very many poles every second, third, ... order is drawn.
        modes: of the chosen order; the system modes are marked above.
        measured: records whose mean output spectrum is drawn behind.
        theme: colours.
    """
    figure, axes = new_figure(1, 1, size=(10.4, 4.6), theme=theme)
    axis = axes[0][0]
    nyquist = 0.5 / modes.dt
    highest = max([evidence.order, *(point.order for point in evidence.stabilisation)])
    if measured:
        frequency, power = _mean_spectrum(measured)
        level = 10.0 * np.log10(np.maximum(power, power.max() * 1e-8))
        height = (level - level.min()) / max(float(np.ptp(level)), 1e-9)
        axis.fill_between(frequency, 0, height * highest * 0.96, color=theme.measured, alpha=0.10, lw=0)
        axis.plot(frequency, height * highest * 0.96, color=theme.measured, lw=0.8, alpha=0.45)
    colours = (theme.noise, theme.doubtful, theme.measured, theme.system)
    for number, ((word, points), colour) in enumerate(zip(pole_classes(evidence), colours, strict=True)):
        axis.plot(
            [point.frequency for point in points],
            [point.order for point in points],
            "o",
            ms=4.2 if number else 2.4,
            mew=0,
            color=colour,
            label=word,
        )
    axis.axhline(evidence.order, color=theme.model, lw=1.0)
    _mark_modes(axis, modes, 0.05 * nyquist, highest, theme)
    axis.set_xlim(0, nyquist)
    axis.set_ylim(0, highest * 1.05)
    axis.set_xlabel("frequency [Hz]")
    axis.set_ylabel("model order")
    legend = figure.legend(
        loc="outside lower center",
        ncols=5,
        frameon=False,
        fontsize=8.5,
        labelcolor=theme.muted,
        title=colour_measure(evidence)[2],
        title_fontsize=8.5,
    )
    legend.get_title().set_color(theme.muted)
    return figure


def _mark_modes(axis: Axes, modes: ModalModel, room: float, highest: int, theme: Theme) -> None:
    """A line for each mode of the system, its frequency above where there is room."""
    for mode, level in zip(modes.system, _levels(modes.frequencies, room), strict=True):
        axis.axvline(mode.frequency, color=theme.system, lw=0.8, alpha=0.55)
        if level < MOST_LEVELS:
            height = highest * (1.055 + 0.05 * level)
            label = hertz(mode.frequency)
            axis.text(mode.frequency, height, label, color=theme.system, fontsize=8, ha="center", va="bottom")


def pole_classes(evidence: OrderEvidence) -> tuple[tuple[str, tuple[StabilisationPoint, ...]], ...]:
    """(word, poles) of each class of the stabilisation diagram, from new to found again, as they are drawn.

    Of more than `MOST_POLES` poles only every second, third, ... order is kept, the highest always.
    """
    points = [point for point in evidence.stabilisation if np.isfinite(point.frequency)]
    orders = sorted({point.order for point in points}, reverse=True)
    step = -(-len(points) // MOST_POLES)
    kept = set(orders[:: max(1, step)])
    measure, classes, _ = colour_measure(evidence)
    return tuple(
        (
            word,
            tuple(
                point
                for point in points
                if point.order in kept and low <= np.nan_to_num(getattr(point, measure)) < high
            ),
        )
        for low, high, word in classes
    )


def colour_measure(
    evidence: OrderEvidence,
) -> tuple[Literal["repeatability", "overlap"], tuple[tuple[float, float, str], ...], str]:
    """What colours the poles: the field of a point, its classes (from, below, word), and its meaning for a reader."""
    if any(np.isfinite(point.repeatability) for point in evidence.stabilisation):
        return "repeatability", REPEATABILITY_CLASSES, "found again: halves of the data, another observer"
    return "overlap", OVERLAP_CLASSES, "overlap with the pole of the next lower order"


def _mean_spectrum(records: Sequence[Record]) -> tuple[FloatArray, FloatArray]:
    frequency, power = power_spectra(records)
    total = power.sum(axis=0)
    share = power / np.where(total > 0, total, 1.0)
    return frequency, share.mean(axis=1)


def _levels(frequencies: FloatArray, room: float) -> list[int]:
    """On which line the label of each mode stands, so that no two labels nearer than `room` share one."""
    ends: list[float] = []
    levels = []
    for frequency in frequencies.tolist():
        level = next((level for level, end in enumerate(ends) if frequency - end >= room), len(ends))
        ends[level : level + 1] = [frequency]
        levels.append(level)
    return levels
