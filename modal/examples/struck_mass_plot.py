"""Pictures of the struck mass, one a step of the story; see `modal.examples.struck_mass`."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from modal.examples.struck_mass_models import LinearModel, pulse_response, step_response, truncated_model
from modal.plots.layout import Chart, Key, grid_of
from modal.plots.style import Role
from modal.plots.vector import page_of, svg_text
from okid.arrays import FloatArray

if TYPE_CHECKING:
    from modal.examples.struck_mass import Study

__all__ = ["draw_full_order", "draw_pareto", "draw_reduction", "draw_responses", "write_pictures"]


def draw_full_order(short: "Study", *, n_beyond: int = 20) -> Chart:
    """Why a perfect fit proves nothing: the full-order model on its own samples, and just beyond them.

    Args:
        short: a study of few samples, so that rounding does not spoil the exact model.
        n_beyond: how many samples to go beyond those that were fitted.
    """
    n_fitted = len(short.samples)
    figure = grid_of(1, 2, size=(10, 3.6))
    inside, beyond = figure.panels
    tick = short.truth.dt * np.arange(n_fitted + n_beyond)
    clean = pulse_response(short.truth.model(), len(tick))
    full, reduced = pulse_response(short.full, len(tick)), pulse_response(short.reduced, len(tick))
    for panel, shown in ((inside, n_fitted), (beyond, len(tick))):
        panel.line(tick[:shown], clean[:shown], "noise", label="truth, no noise")
        panel.dots(tick[:n_fitted], short.samples, "measured", dot=5.0, label="measured")
        panel.line(tick[:shown], full[:shown], "residual", label=f"full order, {short.full.order} states")
        label = f"reduced, {short.reduced.order} states"
        panel.line(tick[:shown], reduced[:shown], "model", dash="dashed", label=label)
        panel.x.label, panel.y.label = "time [s]", "position [m]"
    span = float(np.abs(clean).max())
    inside.head, beyond.head = "the samples that were fitted", "beyond them"
    beyond.y.limits = (-2 * span, 2 * span)
    beyond.upright(tick[n_fitted - 1], "muted", dash="dotted")
    figure.key = Key(panel=inside)
    return figure


def draw_pareto(result: "Study") -> Chart:
    """Singular values with their share in the sum, their share in the energy, and the gap.

    Args:
        result: a study of many samples, on which the three measures disagree.
    """
    shares = result.shares
    number = np.arange(1.0, len(shares.singular_values) + 1.0)
    figure = grid_of(1, 2, size=(10, 3.6))
    left, right = figure.panels
    left.polygons(
        _bars(number, shares.singular_values / shares.singular_values[0]), "noise", opacity=1, label="singular value"
    )
    left.line(number, shares.sum_share, "residual", label="share of the sum")
    left.line(number, shares.energy_share, "system", label="share of the energy")
    left.upright(shares.order, "muted", dash="dotted")
    left.x.label, left.y.label = "number of singular values", "relative to the largest, share"
    left.y.limits = (0.0, 1.05)
    left.head = (
        f"the first {shares.order}: {shares.sum_share[shares.order - 1]:.0%} of the sum, "
        f"{shares.energy_share[shares.order - 1]:.1%} of the energy"
    )
    left.key = "best"
    shown = min(20, len(shares.gap))
    for i in range(shown):
        role: Role = "system" if i + 1 == shares.order else "noise"
        right.polygons(_bars(number[i : i + 1], shares.gap[i : i + 1]), role, opacity=1)
    right.x.label, right.y.label = "number of singular values", "ratio to the next"
    right.head = f"the gap says {shares.order} (first {shown})"
    return figure


def draw_reduction(result: "Study") -> Chart:
    """Truncated against reduced: equal to rounding with the left projector, not without it.

    Args:
        result: any study.
    """
    order, n_samples = result.reduced.order, len(result.samples)
    reduced = pulse_response(result.reduced, n_samples)
    models: tuple[tuple[str, LinearModel, Role], ...] = (
        ("A = U U' H(2) Hr^+  (with the projector)", result.truncated, "system"),
        ("A = H(2) Hr^+  (without)", truncated_model(result.samples, order, projector="none"), "residual"),
    )
    figure = grid_of(1, 1, size=(7, 3.6))
    panel = figure.panels[0]
    tick = result.truth.dt * np.arange(n_samples)
    for label, model, role in models:
        difference = np.abs(pulse_response(model, n_samples) - reduced) / np.abs(reduced).max()
        panel.line(tick, np.maximum(difference, 1e-18), role, label=label)
    panel.y.log, panel.x.label, panel.y.label = True, "time [s]", "difference, relative to the peak"
    panel.head = "N states less n states: nothing changed"
    figure.key = Key(panel=panel)
    return figure


def draw_responses(result: "Study") -> Chart:
    """Pulse and step response: truth, measurement, reduced model.

    Args:
        result: any study.
    """
    n_samples = len(result.samples)
    tick = result.truth.dt * np.arange(n_samples)
    figure = grid_of(1, 2, size=(10, 3.6))
    pulse, step = figure.panels
    for panel, answer, measured in (
        (pulse, pulse_response, result.samples),
        (step, step_response, np.cumsum(result.samples)),
    ):
        panel.dots(tick, measured, "measured", dot=2.5, label="measured")
        panel.line(tick, answer(result.truth.model(), n_samples), "noise", width=2.5, label="truth, no noise")
        label = f"reduced, {result.reduced.order} states"
        panel.line(tick, answer(result.reduced, n_samples), "model", dash="dashed", label=label)
        panel.x.label, panel.y.label = "time [s]", "position [m]"
    pulse.head = f"pulse response: error {result.pulse_error:.1%}"
    step.head = f"step response: error {result.step_error:.1%} (noise of sums grows)"
    figure.key = Key(panel=pulse)
    return figure


def _bars(place: FloatArray, height: FloatArray) -> list[FloatArray]:
    """A rectangle from zero up at each of (n,) places."""
    return [
        np.array([[x - 0.4, 0.0], [x + 0.4, 0.0], [x + 0.4, y], [x - 0.4, y]])
        for x, y in zip(place.tolist(), height.tolist(), strict=True)
    ]


def write_pictures(short: "Study", result: "Study", folder: Path) -> tuple[Path, ...]:
    """Draw all four pictures as SVG files, and return their paths.

    Args:
        short: a study of few samples, for the full-order model.
        result: a study of many samples, for the rest.
        folder: made where it does not exist.
    """
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, figure in (
        ("1-full-order", draw_full_order(short)),
        ("2-pareto", draw_pareto(result)),
        ("3-truncated-reduced", draw_reduction(result)),
        ("4-responses", draw_responses(result)),
    ):
        paths.append(folder / f"{name}.svg")
        paths[-1].write_text(page_of(svg_text(figure, name=name, description=name)), encoding="utf-8")
    return tuple(paths)
