"""Pictures of the struck mass, one a step of the story; see `modal.examples.struck_mass`."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from modal.examples.struck_mass import Study
from modal.examples.struck_mass_models import LinearModel, pulse_response, step_response, truncated_model
from modal.plots.style import LIGHT, house_style, new_figure

__all__ = ["draw_full_order", "draw_pareto", "draw_reduction", "draw_responses", "write_pictures"]


def draw_full_order(short: Study, *, n_beyond: int = 20) -> Figure:
    """Why a perfect fit proves nothing: the full-order model on its own samples, and just beyond them.

    Args:
        short: a study of few samples, so that rounding does not spoil the exact model.
        n_beyond: how many samples to go beyond those that were fitted.
    """
    n_fitted = len(short.samples)
    figure, ((inside, beyond),) = new_figure(1, 2, size=(10, 3.6), theme=LIGHT)
    tick = short.truth.dt * np.arange(n_fitted + n_beyond)
    clean = pulse_response(short.truth.model(), len(tick))
    full, reduced = pulse_response(short.full, len(tick)), pulse_response(short.reduced, len(tick))
    for axis, shown in ((inside, n_fitted), (beyond, len(tick))):
        axis.plot(tick[:shown], clean[:shown], color=LIGHT.noise, label="truth, no noise")
        axis.plot(tick[:n_fitted], short.samples, "o", color=LIGHT.measured, markersize=4, label="measured")
        axis.plot(tick[:shown], full[:shown], color=LIGHT.residual, label=f"full order, {short.full.order} states")
        axis.plot(
            tick[:shown], reduced[:shown], "--", color=LIGHT.model, label=f"reduced, {short.reduced.order} states"
        )
        axis.set(xlabel="time [s]", ylabel="position [m]")
    span = float(np.abs(clean).max())
    beyond.set(title="beyond them", ylim=(-2 * span, 2 * span))
    beyond.axvline(tick[n_fitted - 1], color=LIGHT.muted, linestyle=":")
    inside.set_title("the samples that were fitted")
    inside.legend(frameon=False, fontsize=8)
    return figure


def draw_pareto(result: Study) -> Figure:
    """Singular values with their share in the sum, their share in the energy, and the gap.

    Args:
        result: a study of many samples, on which the three measures disagree.
    """
    shares = result.shares
    number = np.arange(1, len(shares.singular_values) + 1)
    figure, ((left, right),) = new_figure(1, 2, size=(10, 3.6), theme=LIGHT)
    left.bar(number, shares.singular_values / shares.singular_values[0], color=LIGHT.noise, label="singular value")
    left.plot(number, shares.sum_share, color=LIGHT.residual, label="share of the sum")
    left.plot(number, shares.energy_share, color=LIGHT.system, label="share of the energy")
    left.axvline(shares.order, color=LIGHT.muted, linestyle=":")
    left.set(
        xlabel="number of singular values",
        ylabel="relative to the largest, share",
        ylim=(0, 1.05),
        title=f"the first {shares.order}: {shares.sum_share[shares.order - 1]:.0%} of the sum, "
        f"{shares.energy_share[shares.order - 1]:.1%} of the energy",
    )
    left.legend(frameon=False, fontsize=8, loc="center right")
    shown = min(20, len(shares.gap))
    colours = [LIGHT.system if i + 1 == shares.order else LIGHT.noise for i in range(shown)]
    right.bar(number[:shown], shares.gap[:shown], color=colours)
    right.set(
        xlabel="number of singular values",
        ylabel="ratio to the next",
        title=f"the gap says {shares.order} (first {shown})",
    )
    return figure


def draw_reduction(result: Study) -> Figure:
    """Truncated against reduced: equal to rounding with the left projector, not without it.

    Args:
        result: any study.
    """
    order, n_samples = result.reduced.order, len(result.samples)
    reduced = pulse_response(result.reduced, n_samples)
    models: tuple[tuple[str, LinearModel, str], ...] = (
        ("A = U U' H(2) Hr^+  (with the projector)", result.truncated, LIGHT.system),
        ("A = H(2) Hr^+  (without)", truncated_model(result.samples, order, projector="none"), LIGHT.residual),
    )
    figure, ((axis,),) = new_figure(1, 1, size=(7, 3.6), theme=LIGHT)
    tick = result.truth.dt * np.arange(n_samples)
    for label, model, colour in models:
        difference = np.abs(pulse_response(model, n_samples) - reduced) / np.abs(reduced).max()
        axis.semilogy(tick, np.maximum(difference, 1e-18), color=colour, label=label)
    axis.set(
        xlabel="time [s]", ylabel="difference, relative to the peak", title="N states less n states: nothing changed"
    )
    axis.legend(frameon=False, fontsize=8)
    return figure


def draw_responses(result: Study) -> Figure:
    """Pulse and step response: truth, measurement, reduced model.

    Args:
        result: any study.
    """
    n_samples = len(result.samples)
    tick = result.truth.dt * np.arange(n_samples)
    figure, ((pulse, step),) = new_figure(1, 2, size=(10, 3.6), theme=LIGHT)
    for axis, answer, measured in (
        (pulse, pulse_response, result.samples),
        (step, step_response, np.cumsum(result.samples)),
    ):
        axis.plot(tick, measured, ".", color=LIGHT.measured, markersize=3, label="measured")
        axis.plot(
            tick, answer(result.truth.model(), n_samples), color=LIGHT.noise, linewidth=2.5, label="truth, no noise"
        )
        label = f"reduced, {result.reduced.order} states"
        axis.plot(tick, answer(result.reduced, n_samples), "--", color=LIGHT.model, label=label)
        axis.set(xlabel="time [s]", ylabel="position [m]")
    pulse.set_title(f"pulse response: error {result.pulse_error:.1%}")
    step.set_title(f"step response: error {result.step_error:.1%} (noise of sums grows)")
    pulse.legend(frameon=False, fontsize=8)
    return figure


def write_pictures(short: Study, result: Study, folder: Path) -> tuple[Path, ...]:
    """Draw all four pictures as PNG files, and return their paths.

    Args:
        short: a study of few samples, for the full-order model.
        result: a study of many samples, for the rest.
        folder: made where it does not exist.
    """
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    with house_style():
        for name, figure in (
            ("1-full-order", draw_full_order(short)),
            ("2-pareto", draw_pareto(result)),
            ("3-truncated-reduced", draw_reduction(result)),
            ("4-responses", draw_responses(result)),
        ):
            paths.append(folder / f"{name}.png")
            figure.savefig(paths[-1], dpi=130)
    return tuple(paths)
