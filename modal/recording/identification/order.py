"""The page "Order": how many states the data carry, and which poles stay when there are more."""

from typing import TYPE_CHECKING, Final

import numpy as np

from era.realisation import Realisation
from modal.identification.result import Identification, OrderEvidence
from modal.modes.response_synthesis import frf
from modal.recording.axis import linear_axis, log_axis
from modal.recording.evidence import Gathered
from modal.recording.figure import Figure, Pane
from modal.recording.identification.order_scrub import (
    MODEL_ORDER,
    is_repeatability_known,
    log_order_texts,
    log_poles,
    mark_orders,
)
from modal.recording.palette import BLUE, DIM_BLUE, DIM_GREEN, GOLD, GREEN, GREY, RED
from modal.recording.plan import Plan
from modal.recording.tables import log_table
from modal.wording.numbers import hertz
from okid.arrays import FloatArray

if TYPE_CHECKING:
    import rerun

__all__ = ["ORDER_FIT", "SINGULAR_VALUES", "STABILISATION", "log_order_page"]

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
