"""The page "Order": how many states the data carry, and which poles stay when there are more.

On the timeline "model_order" it plays: a row is an order, with the poles of all orders up to it, its own in front, its
fit, its singular value and a text. On the timeline "time" all poles stand there at once, and the text is that of the
order chosen.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from era.realisation import Realisation
from modal.identification.result import Identification, OrderEvidence
from modal.modes.response_synthesis import frf
from modal.plots.order import POLE_ROLES, colour_measure, order_fits, singular_values, stabilisation_diagram
from modal.plots.panels import STYLE, Curve, Panel
from modal.recording.figure import Palette, Pane, RecordingStream, log_chart, role_colour, rr, seen_at
from modal.recording.plan import Plan, known, log_table, table
from modal.recording.series import TIMELINE
from modal.verdict.stabilisation import StabilisationPoint
from okid.arrays import FloatArray

MODEL_ORDER: Final = "model_order"
ORDER_TEXT: Final = "order/text"


class Orders:
    """How the growing order is shown."""

    SURE: Final = 0.95
    """Count a pole as the same as another from this overlap on."""
    LISTED_POLES: Final = 24
    """List so many poles of an order."""
    POLES: Final = 20.0
    """Draw what plays on "model_order" over all lines of the chart."""


def is_repeatability_known(evidence: OrderEvidence) -> bool:
    """Whether the poles were looked for in halves of the data and with another observer as well."""
    return any(np.isfinite(point.repeatability) for point in evidence.stabilisation)


def orders_of(evidence: OrderEvidence) -> list[int]:
    """The orders of the stabilisation diagram, rising."""
    return sorted({point.order for point in evidence.stabilisation})


def log_poles(recording: RecordingStream, panel: Panel, evidence: OrderEvidence, plan: Plan) -> None:
    """All poles on "time"; on "model_order" those of the orders below, and those of the order in front of them."""
    low, high = panel.x.limits or (0.0, np.inf)
    points = sorted(evidence.stabilisation, key=lambda point: point.order)
    points = [point for point in points if low <= point.frequency <= high]
    if not points:
        return
    orders = np.array([point.order for point in points])
    places = seen_at(panel, [point.frequency for point in points], orders)
    colours = _pole_colours(points, evidence)
    texts = [_pole_label(point) for point in points]
    path, steps = STABILISATION.path, np.unique(orders)
    index = [rr.TimeColumn(MODEL_ORDER, sequence=steps)]
    own = [np.flatnonzero(orders == step) for step in steps]
    below = [np.flatnonzero(orders < step) for step in steps]
    for name, rows, radius in (("poles", below, STYLE.dot / 2), ("poles_now", own, STYLE.dot)):
        entity, chosen = f"{path}/{name}", np.concatenate(rows)
        now = name == "poles_now"
        columns = rr.Points2D.columns(
            positions=places[chosen], colors=colours[chosen], labels=[texts[i] for i in chosen] if now else None
        ).partition([len(row) for row in rows])
        recording.send_columns(entity, index, columns, strict=True)
        style = rr.Points2D.from_fields(
            radii=rr.Radius.ui_points(radius), show_labels=False, draw_order=Orders.POLES + 1.0 if now else Orders.POLES
        )
        recording.log(entity, style, static=True, strict=True)
    whole = rr.Points2D.columns(positions=places, colors=colours, labels=texts).partition([len(points)])
    recording.send_columns(f"{path}/poles", [rr.TimeColumn(TIMELINE, duration=[plan.data.start])], whole, strict=True)
    line = np.stack([seen_at(panel, [low, high], [step, step]) for step in steps])
    columns = rr.LineStrips2D.columns(strips=line)
    recording.send_columns(f"{path}/order_now", index, columns, strict=True)
    style = rr.LineStrips2D.from_fields(
        radii=rr.Radius.ui_points(STYLE.thin), colors=Palette.WHITE, draw_order=Orders.POLES - 1.0
    )
    recording.log(f"{path}/order_now", style, static=True, strict=True)


def _pole_colours(points: Sequence[StabilisationPoint], evidence: OrderEvidence) -> npt.NDArray[np.uint8]:
    """(n_points, 3) those of the class that each pole is of."""
    measure, classes, _ = colour_measure(evidence)
    shares = np.nan_to_num([getattr(point, measure) for point in points])
    number = np.searchsorted([below for _, below, _ in classes[:-1]], shares, side="right")
    return np.array([role_colour(role) for role in POLE_ROLES], dtype=np.uint8)[number]


def mark_orders(recording: RecordingStream, pane: Pane, panel: Panel, evidence: OrderEvidence) -> None:
    """On "model_order", a white dot on the plotted value of each order, and none at an order without a value."""
    at = np.array(orders_of(evidence), dtype=np.int64)
    values = {x: y for line in panel.lines if line.dot for x, y in line.corners.tolist()}
    heights = np.array([values.get(order, np.nan) for order in at.tolist()])
    there = np.isfinite(heights)
    if not there.any():
        return
    entity = f"{pane.path}/order_now"
    columns = rr.Points2D.columns(positions=seen_at(panel, at[there], heights[there])).partition(there.astype(int))
    index = [rr.TimeColumn(MODEL_ORDER, sequence=at)]
    recording.send_columns(entity, index, columns, strict=True)
    style = rr.Points2D.from_fields(radii=rr.Radius.ui_points(STYLE.dot), colors=Palette.WHITE, draw_order=Orders.POLES)
    recording.log(entity, style, static=True, strict=True)


def log_order_texts(evidence: OrderEvidence, recording: RecordingStream, plan: Plan) -> None:
    """What each order has, in words: on "model_order" all of them, on "time" the one chosen."""
    orders = orders_of(evidence) or [evidence.order]
    for timeline, shown in ((MODEL_ORDER, orders), (TIMELINE, [evidence.order])):
        texts = [order_text(evidence, order) for order in shown]
        columns = rr.TextDocument.columns(text=texts, media_type=[rr.MediaType.MARKDOWN] * len(texts))
        at = (
            rr.TimeColumn(timeline, duration=[plan.data.start])
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
        parts.append(_poles_sentence(points, found_again=is_repeatability_known(evidence)))
        parts.append(_poles_table(points, found_again=is_repeatability_known(evidence)))
    if evidence.stabilisation:
        parts.append(
            "Choose the timeline **model_order** at the bottom and drag it: the poles appear as the order grows. On "
            "the timeline **time** all of them are shown."
        )
    return "\n\n".join(parts)


def _poles_sentence(points: Sequence[StabilisationPoint], *, found_again: bool) -> str:
    sure = sum((point.repeatability if found_again else point.overlap) >= Orders.SURE for point in points)
    how = "were found again from halves of the data and with another observer"
    if not found_again:
        how = "continue a pole of the order below"
    return f"{sure} of its {len(points)} poles {how} (overlap {Orders.SURE:g} or more)."


def _poles_table(points: Sequence[StabilisationPoint], *, found_again: bool) -> str:
    head = ["f [Hz]", "ζ [%]", *(["again"] if found_again else []), "order below", "EMAC"]
    rows = [
        [
            f"{point.frequency:.5g}",
            f"{100 * point.damping_ratio:.2g}",
            *([known(point.repeatability, ".2f")] if found_again else []),
            known(point.overlap, ".2f"),
            known(point.emac, ".2f"),
        ]
        for point in points[: Orders.LISTED_POLES]
    ]
    left = f"\n\n{len(points) - Orders.LISTED_POLES} poles more." if len(points) > Orders.LISTED_POLES else ""
    return table(head, rows) + left


def _pole_label(point: StabilisationPoint) -> str:
    text = (
        f"order {point.order}: {point.frequency:.5g} Hz, damping {100 * point.damping_ratio:.2g} %, "
        f"overlap {point.overlap:.3f}"
    )
    return text + (f", found again {point.repeatability:.3f}" if np.isfinite(point.repeatability) else "")


SINGULAR_VALUES: Final = Pane("order/singular_values/plot", 480.0, 430.0)
ORDER_FIT: Final = Pane("order/fit/plot", 480.0, 370.0)
STABILISATION: Final = Pane("order/stabilisation/plot", 640.0, 630.0)
"""Draw in about the shape that the view has on a common screen."""


def log_order_page(identification: Identification, recording: RecordingStream, plan: Plan) -> None:
    """Singular values, cross-validated fit against order, stabilisation diagram over the measured spectrum."""
    evidence = identification.order_evidence
    _log_numbers(evidence, recording)
    log_order_texts(evidence, recording, plan)
    frequencies = np.linspace(0.0, 0.5 / identification.realisation.dt, 1024 + 1)[1:]
    _log_response(recording, frequencies, _response_size(identification, frequencies))
    for pane, chart in (
        (SINGULAR_VALUES, singular_values(evidence, limit=max(40, 4 * evidence.order))),
        (ORDER_FIT, order_fits(evidence)),
    ):
        log_chart(recording, pane, chart)
        mark_orders(recording, pane, chart.panels[0], evidence)
    chart = stabilisation_diagram(evidence, identification.modes, measured=identification.records)
    panel = chart.panels[0]
    none = np.zeros(0)  # the poles are of the key, but play
    panel.marks = [
        replace(mark, x=none, y=none) if isinstance(mark, Curve) and mark.dot else mark for mark in panel.marks
    ]
    log_chart(recording, STABILISATION, chart)
    log_poles(recording, panel, evidence, plan)


def _response_size(identification: Identification, frequencies: FloatArray) -> FloatArray:
    """Root mean square of the response over all pairs of channels, each measured by its own scale.

    Where no input was measured, the gain and the residual take the place of B and of the input.
    """
    model, markov = identification.fitted_model or identification.realisation, identification.markov
    into = markov.input_scale
    if not markov.n_inputs:
        if model.K is None:
            return np.full(frequencies.size, np.nan)
        into = markov.output_scale
        model = Realisation(model.A, model.K, model.C, np.eye(into.size), model.dt)
    with np.errstate(divide="ignore", invalid="ignore"):  # a pole on the unit circle: nan, left out of the plot
        response = frf(model, frequencies) * into / markov.output_scale[:, np.newaxis]
        size = np.sqrt(np.mean(np.abs(response) ** 2, axis=(1, 2)))
    return np.where(np.isfinite(size), size, np.nan)


def _log_numbers(evidence: OrderEvidence, recording: RecordingStream) -> None:
    values = evidence.singular_values
    index = np.arange(1, values.size + 1)
    kept = {"singular_value": values, "kept": index <= evidence.order}
    log_table(recording, "order/singular_values", MODEL_ORDER, index, kept)
    order = np.argsort(evidence.candidate_orders, kind="stable")
    fits = {"cross_validated_fit": evidence.candidate_fits[order]}
    log_table(recording, "order/fit", MODEL_ORDER, evidence.candidate_orders[order], fits)
    orders = sorted({point.order for point in evidence.stabilisation})
    # a column of nan would say nothing, and two recordings with nan in a cell never compare equal
    known = ("repeatability",) if is_repeatability_known(evidence) else ()
    poles = {
        name: [[getattr(p, name) for p in evidence.stabilisation if p.order == order] for order in orders]
        for name in ("frequency", "damping_ratio", "overlap", "emac", *known)
    }
    log_table(recording, "order/stabilisation", MODEL_ORDER, orders, poles)


def _log_response(recording: RecordingStream, frequencies: FloatArray, size: FloatArray) -> None:
    lines = np.arange(1, frequencies.size + 1)
    log_table(recording, "order/response", "frequency_line", lines, {"frequency": frequencies, "size": size})
