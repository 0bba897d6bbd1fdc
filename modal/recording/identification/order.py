"""The page "Order": how many states the data carry, and which poles stay when there are more.

The page "Order", order by order: on the timeline "model_order" the poles appear as the order grows.

A row of the timeline is an order: the poles of all orders up to it, its own in front, its fit and its singular value,
and a text. On the timeline "time" all poles stand there at once, and the text is that of the order chosen.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from era.realisation import Realisation
from modal.identification.result import Identification, OrderEvidence
from modal.modes.response_synthesis import frf
from modal.recording.figure import (
    BLUE,
    DIM_BLUE,
    DIM_GREEN,
    GOLD,
    GREEN,
    GREY,
    RED,
    WHITE,
    Figure,
    Pane,
    by_share,
    linear_axis,
    log_axis,
)
from modal.recording.plan import Gathered, Plan
from modal.recording.series import TIMELINE
from modal.recording.tables import UNKNOWN, log_table, table
from modal.verdict.stabilisation import StabilisationPoint
from modal.wording.numbers import hertz
from okid.arrays import FloatArray

if TYPE_CHECKING:
    import rerun

__all__ = [
    "MODEL_ORDER",
    "ORDER_FIT",
    "ORDER_TEXT",
    "SINGULAR_VALUES",
    "STABILISATION",
    "is_repeatability_known",
    "log_order_page",
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


SINGULAR_VALUES: Final = Pane("order/singular_values/plot", 480.0, 430.0)
ORDER_FIT: Final = Pane("order/fit/plot", 480.0, 370.0)
STABILISATION: Final = Pane("order/stabilisation/plot", 840.0, 830.0)
RESPONSE_LINES: Final = 1024
RESPONSE_DECADES: Final = 4.0
TEXT_LEVELS: Final = (1.065, 1.11, 1.155)
TEXT_WIDTH: Final = 52.0


def log_order_page(
    identification: Identification, recording: "rerun.RecordingStream", plan: Plan, seen: Gathered
) -> None:
    """Singular values, cross-validated fit against order, stabilisation diagram over the measured response."""
    evidence = identification.order_evidence
    _log_numbers(evidence, recording)
    _draw_singular_values(evidence, recording)
    _draw_fits(evidence, recording)
    log_order_texts(evidence, recording, plan)
    frequencies = np.linspace(0.0, 0.5 / identification.realisation.dt, RESPONSE_LINES + 1)[1:]
    size = _response_size(identification, frequencies)
    _log_response(recording, frequencies, size)
    measured = _measured_size(identification, seen)
    _draw_stabilisation(identification, recording, plan, modelled=(frequencies, size), measured=measured)


def _measured_size(identification: Identification, seen: Gathered) -> tuple[FloatArray, FloatArray] | None:
    """Frequencies, and the root mean square over all pairs of channels of what was measured, by their scales.

    Of the responses; without inputs, of the square roots of the spectra.
    """
    markov, first = identification.markov, identification.records[0]
    if seen.measured is not None:
        scaled = np.abs(seen.measured.frf) * markov.input_scale / markov.output_scale[:, np.newaxis]
        with np.errstate(over="ignore"):  # what is no number is left out of the plot
            return seen.measured.frequencies[1:], np.sqrt(np.mean(scaled**2, axis=(1, 2)))[1:]
    if first.n_inputs or not seen.density_frequencies.size:
        return None
    scaled = seen.quality.densities[: seen.density_frequencies.size, first.n_inputs :] / markov.output_scale**2
    return seen.density_frequencies[1:], np.sqrt(np.mean(scaled, axis=1))[1:]


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


def _log_numbers(evidence: OrderEvidence, recording: "rerun.RecordingStream") -> None:
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


def _log_response(recording: "rerun.RecordingStream", frequencies: FloatArray, size: FloatArray) -> None:
    lines = np.arange(1, frequencies.size + 1)
    log_table(recording, "order/response", "frequency_line", lines, {"frequency": frequencies, "size": size})


def _draw_singular_values(evidence: OrderEvidence, recording: "rerun.RecordingStream") -> None:
    values = evidence.singular_values
    positive = values[values > 0]
    if not positive.size:
        return
    # below 1e-12 of the largest there is only rounding; showing it would flatten everything else
    lowest = max(float(positive.min()), 1e-12 * float(positive.max()))
    n_shown = int(min(values.size, max(40, 4 * evidence.order)))
    figure = Figure(
        recording=recording,
        pane=SINGULAR_VALUES,
        x=linear_axis("index", 0.0, n_shown + 1.0, whole=True),
        y=log_axis("Hankel singular value", lowest, float(positive.max())),
    )
    figure.frame()
    index = np.arange(1, n_shown + 1)
    shown = np.maximum(values[:n_shown], lowest)
    kept = index <= evidence.order
    texts = [f"{i}: {value:.4g}" for i, value in zip(index, values[:n_shown], strict=True)]
    for name, chosen, colour in (("dropped", ~kept, GREY), ("kept", kept, GREEN)):
        labels = [text for text, there in zip(texts, chosen, strict=True) if there]
        figure.points(name, index[chosen], shown[chosen], colour, radius=3.2, texts=labels)
    _order_line(figure, evidence.order + 0.5)
    entries = [("kept", GREEN), ("dropped", GREY), (f"order {evidence.order}", GOLD)]
    figure.legend(entries)
    by_order = dict(enumerate(shown.tolist(), start=1))
    mark_orders(figure, evidence, by_order)


def _order_line(figure: Figure, at: float) -> None:
    top, bottom = (
        (10.0**figure.y.high, 10.0**figure.y.low) if figure.y.scale == "log10" else (figure.y.high, figure.y.low)
    )
    figure.line("order", [at, at], [bottom, top], GOLD, width=0.7, order=8.0)


def _draw_fits(evidence: OrderEvidence, recording: "rerun.RecordingStream") -> None:
    order = np.argsort(evidence.candidate_orders, kind="stable")
    orders, fits = evidence.candidate_orders[order], evidence.candidate_fits[order]
    if not orders.size:
        return
    there = np.isfinite(fits)
    best = float(fits[there].max()) if there.any() else 1.0
    low = float(np.clip(fits[there].min() - 0.05, -0.2, 0.95 * best)) if there.any() else 0.0
    high = max(min(1.0, best + 0.25 * (best - low)), low + 0.02)
    figure = Figure(
        recording=recording,
        pane=ORDER_FIT,
        x=linear_axis("model order", 0.0, float(orders.max()) * 1.05 + 1.0, whole=True),
        y=linear_axis("cross-validated fit", low, high),
    )
    figure.frame()
    _order_line(figure, float(evidence.order))
    shown = np.where(there, np.maximum(fits, low), np.nan)
    figure.line("line", orders, shown, DIM_BLUE, width=1.2)
    texts = [f"order {o:g}: {fit:.4f}" for o, fit in zip(orders, fits, strict=True)]
    colours = np.where((orders == evidence.order)[:, np.newaxis], GREEN, BLUE).astype(np.uint8)
    figure.points("fits", orders, shown, colours, radius=3.5, texts=texts)
    mark_orders(figure, evidence, dict(zip(orders.tolist(), shown.tolist(), strict=True)))
    entries = [("chosen", GREEN), ("tried", BLUE)]
    if not there.all():
        figure.points("unstable", orders[~there], np.full((~there).sum(), low), RED, radius=3.5)
        entries.append(("unstable", RED))
    figure.legend(entries)


def _draw_stabilisation(
    identification: Identification,
    recording: "rerun.RecordingStream",
    plan: Plan,
    *,
    modelled: tuple[FloatArray, FloatArray],
    measured: tuple[FloatArray, FloatArray] | None,
) -> None:
    """The poles over what was measured, or over the model's response where nothing of the kind could be."""
    evidence = identification.order_evidence
    frequencies = modelled[0]
    highest = max([point.order for point in evidence.stabilisation], default=evidence.order)
    figure = Figure(
        recording=recording,
        pane=STABILISATION,
        x=linear_axis("frequency [Hz]", 0.0, float(frequencies[-1])),
        y=linear_axis("model order", 0.0, highest * 1.2 + 1.0, whole=True),
    )
    figure.frame()
    _draw_response(figure, *(measured or modelled))
    figure.line("chosen", [0.0, frequencies[-1]], [evidence.order] * 2, GOLD, width=0.5, order=4.0)
    _draw_modes(figure, plan, highest)
    log_poles(figure, evidence, plan)
    meaning = "found again" if is_repeatability_known(evidence) else "overlap with the order below"
    swatches = [(f"{meaning}: 0.95", GREEN), ("0.8", GOLD), ("0.5 and less", GREY)]
    response = "model's response"
    if measured:
        response = "measured response" if identification.records[0].n_inputs else "measured spectrum"
    figure.legend([*swatches, (f"order {evidence.order}", GOLD), (response, DIM_BLUE)])


def _draw_modes(figure: Figure, plan: Plan, highest: float) -> None:
    """A line and its frequency above the poles for each mode of the system; neighbours' texts on different levels."""
    last, level = -np.inf, 0
    for number, mode in enumerate(plan.modes, start=1):
        share = float(figure.x.share(mode.frequency))
        if mode.verdict != "system" or not 0 < share < 1:
            continue
        level = (level + 1) % len(TEXT_LEVELS) if share - last < TEXT_WIDTH / figure.width else 0
        last = share
        figure.line(f"mode/{number}", [mode.frequency] * 2, [0.0, highest * 1.03], DIM_GREEN, width=0.5, order=3.0)
        figure.text(f"mode/{number}", mode.frequency, highest * TEXT_LEVELS[level], hertz(mode.frequency), GREEN)


def _draw_response(figure: Figure, frequencies: FloatArray, size: FloatArray) -> None:
    """The response on a logarithmic scale of its own, over the height of the frame, dim behind the poles."""
    there = np.isfinite(size) & (size > 0)
    if not there.any():
        return
    level = np.log10(np.where(there, size, np.nan))
    high = float(np.nanmax(level))
    low = max(float(np.nanmin(level)), high - RESPONSE_DECADES)
    share = (level - low) / (high - low) if high > low else np.where(there, 0.5, np.nan)
    figure.line(
        "response", frequencies, figure.y.low + (figure.y.high - figure.y.low) * 0.8 * share, DIM_BLUE, order=2.0
    )
