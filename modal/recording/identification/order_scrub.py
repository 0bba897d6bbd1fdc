"""The page "Order", order by order: on the timeline "model_order" the poles appear as the order grows.

A row of the timeline is an order: the poles of all orders up to it, its own in front, its fit and its singular value,
and a text. On the timeline "time" all poles stand there at once, and the text is that of the order chosen.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from modal.identification.result import OrderEvidence, StabilisationPoint
from modal.recording.figure import Figure
from modal.recording.palette import WHITE, by_share
from modal.recording.plan import Plan
from modal.recording.series import TIMELINE
from modal.recording.words import UNKNOWN, table

if TYPE_CHECKING:
    import rerun

__all__ = [
    "MODEL_ORDER",
    "ORDER_TEXT",
    "is_repeatability_known",
    "log_order_texts",
    "log_poles",
    "mark_orders",
    "order_text",
    "orders_of",
]

MODEL_ORDER: Final = "model_order"
ORDER_TEXT: Final = "order/text"
SURE: Final = 0.95
"""Overlap from which a pole counts as the same as another."""

LISTED_POLES: Final = 24


def is_repeatability_known(evidence: OrderEvidence) -> bool:
    """Whether the poles were looked for in halves of the data and with another observer as well."""
    return any(np.isfinite(point.repeatability) for point in evidence.stabilisation)


def orders_of(evidence: OrderEvidence) -> list[int]:
    """The orders of the stabilisation diagram, rising."""
    return sorted({point.order for point in evidence.stabilisation})


def log_poles(figure: Figure, evidence: OrderEvidence, plan: Plan) -> None:
    """All poles on "time"; on "model_order" those of the orders below, and those of the order in front of them."""
    import rerun as rr

    points = sorted(evidence.stabilisation, key=lambda point: point.order)
    low, high = figure.x.low, figure.x.high
    points = [point for point in points if low <= point.frequency <= high]
    if not points:
        return
    orders = np.array([point.order for point in points])
    places = figure.place([point.frequency for point in points], orders)
    known = is_repeatability_known(evidence)
    colours = by_share([point.repeatability if known else point.overlap for point in points])
    texts = [_pole_label(point) for point in points]
    recording, path = figure.recording, figure.path
    steps = np.unique(orders)
    index = [rr.TimeColumn(MODEL_ORDER, sequence=steps)]
    own = [np.flatnonzero(orders == step) for step in steps]
    below = [np.flatnonzero(orders < step) for step in steps]
    for name, rows, radius in (("poles", below, 2.6), ("poles_now", own, 4.5)):
        entity, chosen = f"{path}/{name}", np.concatenate(rows)
        now = name == "poles_now"
        columns = rr.Points2D.columns(
            positions=places[chosen], colors=colours[chosen], labels=[texts[i] for i in chosen] if now else None
        ).partition([len(row) for row in rows])
        recording.send_columns(entity, index, columns, strict=True)
        style = rr.Points2D.from_fields(
            radii=rr.Radius.ui_points(radius), show_labels=False, draw_order=11.0 if now else 10.0
        )
        recording.log(entity, style, static=True, strict=True)
    whole = rr.Points2D.columns(positions=places, colors=colours, labels=texts).partition([len(points)])
    recording.send_columns(f"{path}/poles", [rr.TimeColumn(TIMELINE, duration=[plan.start])], whole, strict=True)
    line = np.stack([figure.place([low, high], [step, step]) for step in steps])
    columns = rr.LineStrips2D.columns(strips=line)
    recording.send_columns(f"{path}/order_now", index, columns, strict=True)
    style = rr.LineStrips2D.from_fields(radii=rr.Radius.ui_points(0.6), colors=WHITE, draw_order=4.5)
    recording.log(f"{path}/order_now", style, static=True, strict=True)


def mark_orders(figure: Figure, evidence: OrderEvidence, values: Mapping[int, float]) -> None:
    """On "model_order", a white dot on the plotted value of each order, and none at an order without a value.

    Args:
        figure: where orders stand along the horizontal axis.
        evidence: whose orders.
        values: that are plotted, by order; nan is none.
    """
    import rerun as rr

    at = np.array(orders_of(evidence), dtype=np.int64)
    heights = np.array([values.get(order, np.nan) for order in at.tolist()])
    there = np.isfinite(heights)
    if not there.any():
        return
    entity = f"{figure.path}/order_now"
    columns = rr.Points2D.columns(positions=figure.place(at[there], heights[there])).partition(there.astype(int))
    index = [rr.TimeColumn(MODEL_ORDER, sequence=at)]
    figure.recording.send_columns(entity, index, columns, strict=True)
    style = rr.Points2D.from_fields(radii=rr.Radius.ui_points(6.0), colors=WHITE, draw_order=9.0)
    figure.recording.log(entity, style, static=True, strict=True)


def log_order_texts(evidence: OrderEvidence, recording: "rerun.RecordingStream", plan: Plan) -> None:
    """What each order has, in words: on "model_order" all of them, on "time" the one chosen."""
    import rerun as rr

    orders = orders_of(evidence) or [evidence.order]
    for timeline, shown in ((MODEL_ORDER, orders), (TIMELINE, [evidence.order])):
        texts = [order_text(evidence, order) for order in shown]
        columns = rr.TextDocument.columns(text=texts, media_type=[rr.MediaType.MARKDOWN] * len(texts))
        at = (
            rr.TimeColumn(timeline, duration=[plan.start])
            if timeline == TIMELINE
            else rr.TimeColumn(timeline, sequence=shown)
        )
        recording.send_columns(ORDER_TEXT, [at], columns, strict=True)


def order_text(evidence: OrderEvidence, order: int) -> str:
    """One order in words: its fit, its singular values, its poles."""
    points = sorted((p for p in evidence.stabilisation if p.order == order), key=lambda p: p.frequency)
    parts = [f"### Order {order}" + (", chosen" if order == evidence.order else "")]
    fit = evidence.candidate_fits[evidence.candidate_orders == order]
    values = evidence.singular_values
    facts = []
    if fit.size:
        facts.append(f"cross-validated fit {fit[0]:.4f}" if np.isfinite(fit[0]) else "the free run is unstable")
    else:
        facts.append("not tried by cross-validation")
    if 0 < order < values.size and values[order] > 0:
        facts.append(f"singular value {values[order - 1] / values[order]:.3g} times the next")
    parts.append("; ".join(facts) + ".")
    if points:
        parts.append(_poles_sentence(points, known=is_repeatability_known(evidence)))
        parts.append(_poles_table(points, known=is_repeatability_known(evidence)))
    if evidence.stabilisation:
        parts.append(
            "Choose the timeline **model_order** at the bottom and drag it: the poles appear as the order grows. On "
            "the timeline **time** all of them are shown."
        )
    return "\n\n".join(parts)


def _poles_sentence(points: Sequence[StabilisationPoint], *, known: bool) -> str:
    sure = sum((point.repeatability if known else point.overlap) >= SURE for point in points)
    how = "were found again from halves of the data and with another observer"
    if not known:
        how = "continue a pole of the order below"
    return f"{sure} of its {len(points)} poles {how} (overlap {SURE:g} or more)."


def _poles_table(points: Sequence[StabilisationPoint], *, known: bool) -> str:
    head = ["f [Hz]", "ζ [%]", *(["again"] if known else []), "order below", "EMAC"]
    rows = [
        [
            f"{point.frequency:.5g}",
            f"{100 * point.damping_ratio:.2g}",
            *([_share(point.repeatability)] if known else []),
            _share(point.overlap),
            _share(point.emac),
        ]
        for point in points[:LISTED_POLES]
    ]
    left = f"\n\n{len(points) - LISTED_POLES} poles more." if len(points) > LISTED_POLES else ""
    return table(head, rows) + left


def _pole_label(point: StabilisationPoint) -> str:
    text = (
        f"order {point.order}: {point.frequency:.5g} Hz, damping {100 * point.damping_ratio:.2g} %, "
        f"overlap {point.overlap:.3f}"
    )
    return text + (f", found again {point.repeatability:.3f}" if np.isfinite(point.repeatability) else "")


def _share(value: float) -> str:
    return f"{value:.2f}" if np.isfinite(value) else UNKNOWN
