"""What the model order was decided on: singular values, fit against order, and which poles stay when it grows."""

from collections.abc import Sequence
from typing import Final, Literal

import numpy as np

from modal.identification.result import OrderEvidence
from modal.modes.mode import ModalModel
from modal.plots.chart import Chart, Key, one_panel
from modal.plots.panels import STYLE, Panel, Role
from modal.sections.discrepancy_stages import power_spectra
from modal.verdict.stabilisation import StabilisationPoint
from modal.wording.text import hertz
from okid.arrays import ROUNDED, FloatArray
from okid.record import Record

OVERLAP_CLASSES = ((0.0, 0.5, "new"), (0.5, 0.8, "0.5 to 0.8"), (0.8, 0.95, "0.8 to 0.95"), (0.95, 1.01, "above 0.95"))
"""Overlap with the pole that it continues: (from, below, word)."""
REPEATABILITY_CLASSES = (
    (0.0, 0.4, "below 0.4"),
    (0.4, 0.7, "0.4 to 0.7"),
    (0.7, 0.9, "0.7 to 0.9"),
    (0.9, 1.01, "above 0.9"),
)
"""Repeatability over halves of the data and another observer: (from, below, word)."""

POLE_ROLES: Final[tuple[Role, ...]] = ("noise", "doubtful", "measured", "system")
"""Draw the poles of each class in these colours."""


def singular_values(evidence: OrderEvidence, *, limit: int = 120) -> Chart:
    """Singular values of the scaled block Hankel matrix on a log axis: kept, dropped, and where the widest gap is."""
    figure, panel = one_panel(5.2, 3.3)
    values = np.asarray(evidence.singular_values)[:limit]
    if not values.size or values.max() <= 0:
        panel.word(0.5, 0.5, "no singular values are known", "muted", anchor="middle")
        return figure
    relative = np.maximum(values / values.max(), 1e-17)
    index = np.arange(1, values.size + 1)
    kept = index <= evidence.order
    panel.y.log = True
    panel.dots(index[~kept], relative[~kept], "noise", dot=STYLE.dot, label="dropped")
    panel.dots(index[kept], relative[kept], "system", dot=STYLE.dot, label="kept")
    panel.upright(evidence.order + 0.5, "model", label=f"order {evidence.order} chosen")
    if evidence.gap_order != evidence.order and evidence.gap_order < values.size:
        gap = f"widest gap after {evidence.gap_order}"
        panel.upright(evidence.gap_order + 0.5, "muted", dash="dotted", label=gap)
    panel.x.label, panel.y.label = "number", "singular value / largest"
    panel.key = "upper right"
    return figure


def order_fits(evidence: OrderEvidence) -> Chart:
    """Cross-validated fit against model order; a very bad one stands at the edge, an unstable one has a mark there."""
    figure, panel = one_panel(5.2, 3.3)
    orders, fits = np.asarray(evidence.candidate_orders, dtype=float), np.asarray(evidence.candidate_fits, dtype=float)
    there = np.isfinite(fits)
    if not orders.size:
        panel.word(0.5, 0.5, "no fits were compared", "muted", anchor="middle")
        return figure
    best = float(fits[there].max(initial=-np.inf))
    floor = best - 0.5 if -np.inf < best <= 0 else -0.1
    shown, room = np.maximum(fits[there], floor), 0.03
    panel.line(orders[there], shown, "measured", dot=STYLE.dot, label="on rows not fitted to")
    panel.upright(evidence.order, "model", label=f"order {evidence.order} chosen")
    if not there.all():
        ends = [[[order, -np.inf], [order, floor + room]] for order in orders[~there]]
        panel.segments(ends, "residual", width=STYLE.dot, label="unstable")
    panel.y.limits = (floor - room, max(1.0, best) + room)
    panel.x.label, panel.y.label = "model order", "cross-validated fit"
    panel.key = "lower right"
    return figure


def stabilisation_diagram(evidence: OrderEvidence, modes: ModalModel, *, measured: Sequence[Record] = ()) -> Chart:
    """Every pole of every model order over the power of the measured outputs, coloured by how well it is found again.

    Args:
        evidence: holds the poles of all orders; where their repeatability is not known, the colour is the overlap with
            the pole of the next lower order. Of very many poles every second, third, ... order is drawn.
        modes: of the chosen order; the system modes are marked above.
        measured: records whose mean output spectrum is drawn behind.
    """
    figure, panel = one_panel(STYLE.page, 4.6)
    last = 0.5 / modes.dt
    if not measured:  # lines may end far below half the sampling frequency of their model
        last = min(last, max([point.frequency for point in evidence.stabilisation], default=last))
    highest = max([evidence.order, *(point.order for point in evidence.stabilisation)])
    frequency, power = _mean_spectrum(measured) if measured else (np.zeros(0), np.zeros(0))
    if power.any():
        level = 10.0 * np.log10(np.maximum(power, power.max() * 1e-8))
        height = (level - level.min()) / max(float(np.ptp(level)), ROUNDED)
        panel.area(frequency, 0, height * highest * 0.96, "measured", opacity=STYLE.faint)
        label = "mean spectrum of the outputs"
        panel.line(frequency, height * highest * 0.96, "measured", width=STYLE.thin, opacity=STYLE.half, label=label)
    for number, ((word, points), role) in enumerate(zip(pole_classes(evidence), POLE_ROLES, strict=True)):
        places = [point.frequency for point in points], [point.order for point in points]
        panel.dots(*places, role, dot=STYLE.dot if number else 2.4, label=word)
    panel.across(evidence.order, "model")
    mark_modes(panel, modes, 0.05 * last)
    panel.x.limits, panel.y.limits = (0.0, last), (0.0, highest * 1.05)
    panel.x.label, panel.y.label = "frequency [Hz]", "model order"
    figure.key = Key(panel=panel, below=True, title=colour_measure(evidence)[2])
    return figure


def mark_modes(panel: Panel, modes: ModalModel, room: float) -> None:
    """A line for each mode of the system, its frequency above where there is room."""
    for mode, level in zip(modes.system, _levels(modes.frequencies, room), strict=True):
        panel.upright(mode.frequency, "system", width=STYLE.thin, opacity=STYLE.half)
        if level < 4:  # where modes stand closer, some are left out
            up = STYLE.line * STYLE.tick * level + STYLE.gap
            panel.word(mode.frequency, np.inf, hertz(mode.frequency), "system", anchor="middle", shift=(0.0, -up))
            panel.rows_above = max(panel.rows_above, level + 1)


def pole_classes(evidence: OrderEvidence) -> tuple[tuple[str, tuple[StabilisationPoint, ...]], ...]:
    """(word, poles) of each class of the stabilisation diagram, from new to found again, as they are drawn.

    Of more than `MOST_POLES` poles only every second, third, ... order is kept, the highest always.
    """
    points = [point for point in evidence.stabilisation if np.isfinite(point.frequency)]
    orders = sorted({point.order for point in points}, reverse=True)
    step = -(-len(points) // 4000)  # of more, those of every second, third, ... order
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
