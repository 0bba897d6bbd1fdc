"""One function a figure: each takes a result and gives a matplotlib figure, on axes of the caller where they are given.

The charts behind them are those of the report and the recording, so that a notebook shows what these show. Those draw
a `Chart` themselves: nothing but this file imports matplotlib, and only when a figure is asked for.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final, Literal, cast

import numpy as np

from modal.geometry.scene import comparable_shapes
from modal.identification.result import Identification
from modal.modes.mode import ModalModel, Mode
from modal.modes.response_synthesis import MeasuredFrf, frf, measured_frf, modal_frf, tabled_frf
from modal.modes.shape_comparison import assurance as mac
from modal.plots.chart import INCH, Chart, Key, one_panel
from modal.plots.histories import measured_against_simulated
from modal.plots.order import mark_modes, stabilisation_diagram
from modal.plots.panels import COLOURS, STYLE, Area, Curve, Mark, Panel, Role
from modal.plots.responses import model_grid, output_spectra, response_chart
from modal.plots.shapes import assurance_matrix, mode_shapes, shape_complexity
from modal.sections.discrepancy_stages import power_spectra
from okid.arrays import ComplexArray, FloatArray
from okid.errors import InvalidDataError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from modal.discrepancy.results import Diagnosis
    from modal.geometry.sensors import Geometry

_DASHES: Final = {"": "-", "dashed": "--", "dotted": ":"}
_ALONG: Final = {"start": "left", "middle": "center", "end": "right"}


def figure_of(chart: Chart, *, axes: "Axes | Sequence[Axes] | None" = None) -> "Figure":
    """Draw a chart with matplotlib, by its object interface: no window opens and no global state changes.

    Args:
        chart: of a function of `modal.plots`.
        axes: to draw on, one a panel, row by row; unless given, a figure of the size of the chart is made.

    Returns:
        The figure of the axes.

    Raises:
        InvalidDataError: there are not as many axes as panels.

    Example:
        >>> from modal.plots.chart import grid_of
        >>> chart = grid_of(1, 1, size=(4.0, 3.0))
        >>> chart.panels[0].line([0, 1, 2], [3, 4, 5], "measured", label="measured")
        >>> figure_of(chart).axes[0].lines[0].get_ydata().tolist()
        [3.0, 4.0, 5.0]
    """
    chart.arrange()
    given = _own_axes(chart) if axes is None else list(np.ravel(np.asarray(axes, dtype=object)))
    if len(given) != len(chart.panels):
        raise InvalidDataError(
            f"each panel needs axes of its own: the chart has {len(chart.panels)} panels, but {len(given)} axes are "
            "given; give one a panel, row by row, or none."
        )
    for panel, one in zip(chart.panels, given, strict=True):
        _draw(panel, one)
    figure = cast("Figure", given[0].figure)
    if chart.key is not None:
        keyed = given[chart.panels.index(chart.key.panel)]
        handles, names = keyed.get_legend_handles_labels()
        figure.legend(
            handles,
            names,
            loc="lower center" if chart.key.below else "upper right",
            ncols=len(names),
            borderaxespad=0.0,
            frameon=False,
            title=chart.key.title or None,
            fontsize=STYLE.tick,
            title_fontsize=STYLE.tick,
        )
    return figure


def _own_axes(chart: Chart) -> "list[Axes]":
    """Axes of a new figure, where the chart has its panels."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(chart.width / INCH, chart.height / INCH))
    size = np.array([chart.width, chart.height])
    boxes = [np.reshape(panel.box, (2, 2)) / size for panel in chart.panels]
    return [figure.add_axes((left, 1.0 - top - high, wide, high)) for (left, top), (wide, high) in boxes]


def _draw(panel: Panel, axes: "Axes") -> None:
    sides: tuple[Literal["x", "y"], ...] = ("x", "y")
    for side in sides:
        axis, ticks = (panel.x, panel.x_ticks()) if side == "x" else (panel.y, panel.y_ticks())
        scale = "log" if axis.log else "linear"
        axes.set(**{f"{side}scale": scale, f"{side}lim": axis.limits})
        (axes.set_xlabel if side == "x" else axes.set_ylabel)(axis.label, fontsize=STYLE.label, labelpad=1)
        texts = [text if axis.labelled else "" for _, text in ticks]
        numbers = axes.xaxis if side == "x" else axes.yaxis
        numbers.set_ticks([place for place, _ in ticks], texts, rotation=90 if axis.upright else 0)
        numbers.set_ticks([], minor=True)
        axes.tick_params(axis=side, pad=2, labelsize=STYLE.tick, labelcolor=COLOURS[axis.role])
        if axis.grid:
            axes.grid(visible=True, axis=side, color=COLOURS["grid"])
    axes.set_axisbelow(True)
    axes.set_aspect("equal" if panel.equal else "auto")
    axes.set_title(panel.head, loc="center" if panel.centred else "left", fontsize=STYLE.head)
    if not panel.frame:
        axes.set_axis_off()
    for mark in panel.marks:
        _mark(panel, mark, axes)
    for word in panel.words:
        axes.annotate(
            word.text,
            tuple(panel.within(np.array([word.x, word.y])).tolist()),
            xytext=(word.shift[0], -word.shift[1]),
            textcoords="offset points",
            color=COLOURS[word.role],
            fontsize=word.size,
            horizontalalignment=_ALONG[word.anchor],
        )
    if panel.key is not None and panel.keyed:
        axes.legend(loc=panel.key, fontsize=STYLE.tick)


def _mark(panel: Panel, mark: Mark, axes: "Axes") -> None:
    """A line, areas or pieces, in the order and the colours of the chart."""
    from matplotlib.collections import LineCollection, PolyCollection

    colour, name = COLOURS[mark.role], mark.label or None
    if isinstance(mark, Curve):
        axes.plot(
            *panel.within(mark.corners).T,
            color=colour,
            alpha=mark.opacity,
            linewidth=mark.width,
            linestyle=_DASHES[mark.dash] if mark.width else "",
            marker=("s" if mark.square else "o") if mark.dot else "",
            markersize=mark.dot,
            label=name,
        )
    elif isinstance(mark, Area):
        faces = [panel.within(polygon) for polygon in mark.polygons]
        axes.add_collection(PolyCollection(faces, facecolor=colour, alpha=mark.opacity, label=name), autolim=False)
    elif mark.arrows:
        for start, end in mark.ends.tolist():
            axes.annotate("", end, start, arrowprops={"arrowstyle": "->", "color": colour, "linewidth": mark.width})
    else:
        ends = [panel.within(pair) for pair in mark.ends]
        pieces = LineCollection(ends, colors=colour, linewidths=mark.width, alpha=mark.opacity, label=name)
        axes.add_collection(pieces, autolim=False)


class ResultLimits:
    """How much a picture of a result shows."""

    MOST_SHOWN: Final = 6
    """Draw so many outputs, laws or pairs of channels at most, the worst or the strongest of them."""


def stabilisation(result: Identification, *, axes: "Axes | Sequence[Axes] | None" = None) -> "Figure":
    """Poles of the models of all orders over the mean spectrum of the outputs.

    Args:
        result: of `modal.identify`.
        axes: of matplotlib to draw on; unless given, a figure is made.

    Raises:
        InvalidDataError: another number of axes than the figure has panels.
    """
    chart = stabilisation_diagram(result.order_evidence, result.modes, measured=result.records)
    return figure_of(chart, axes=axes)


def modes(
    result: Identification, *, geometry: "Geometry | None" = None, axes: "Axes | Sequence[Axes] | None" = None
) -> "Figure":
    """Shapes of the system modes, on a geometry where one is given; raises as `stabilisation`, and without a mode."""
    record = result.channels
    chart = mode_shapes(
        _system(result), output_names=record.output_names, output_units=record.output_units, geometry=geometry
    )
    return figure_of(chart, axes=axes)


def frequency_responses(result: Identification, *, axes: "Axes | Sequence[Axes] | None" = None) -> "Figure":
    """Measured frequency responses, those of the model, and those of its system modes alone; raises as `stabilisation`.

    Raises:
        InvalidDataError: no input was measured, or another number of axes than the figure has panels.
        InsufficientDataError: the records are too short for a measured response.
    """
    measured = measured_frf(result.records) if result.response is None else tabled_frf(result.response)
    return figure_of(measured_responses(result, measured), axes=axes)


def assurance(result: Identification, *, axes: "Axes | Sequence[Axes] | None" = None) -> "Figure":
    """MAC of the system modes with one another; raises as `modes`."""
    _system(result)
    return figure_of(assurance_matrix(shape_assurance(result), result.modes.frequencies.tolist()), axes=axes)


def complexity(result: Identification, *, axes: "Axes | Sequence[Axes] | None" = None) -> "Figure":
    """Components of each shape as phasors, which lie on one line for a real mode; raises as `modes`."""
    return figure_of(shape_complexity(_system(result)), axes=axes)


def spectra(result: Identification, *, axes: "Axes | Sequence[Axes] | None" = None) -> "Figure":
    """Power spectra of the outputs that fit least, measured and simulated; raises as `stabilisation`."""
    _with_records(result)
    frequencies = result.modes.frequencies.tolist()
    chart = output_spectra(result.records, result.simulated, frequencies=frequencies, outputs=least_fitted(result))
    return figure_of(chart, axes=axes)


def fit(result: Identification, *, axes: "Axes | Sequence[Axes] | None" = None) -> "Figure":
    """Outputs that fit least, measured and simulated; raises as `stabilisation`."""
    return figure_of(fit_chart(result), axes=axes)


def gap(diagnosis: "Diagnosis", *, axes: "Axes | Sequence[Axes] | None" = None) -> "Figure":
    """Measured minus simulated on the first held-out record, before and after.

    Args:
        diagnosis: of `modal.discrepancy.diagnose`.
        axes: of matplotlib to draw on; unless given, a figure is made.

    Raises:
        InvalidDataError: no model ran through, or another number of axes than the figure has panels.
    """
    # an identification is drawn without the cost of importing all of the diagnosis
    from modal.plots.discrepancy import gap_histories
    from modal.sections.discrepancy_stages import stages_of, worst_outputs

    stages = stages_of(diagnosis)
    if not stages:
        raise InvalidDataError("no model of this diagnosis ran through the held-out records: there is no gap to draw.")
    return figure_of(gap_histories(stages, outputs=worst_outputs(stages[0].gap, ResultLimits.MOST_SHOWN)), axes=axes)


def law(diagnosis: "Diagnosis", *, axes: "Axes | Sequence[Axes] | None" = None) -> "Figure":
    """The laws that were found, over what the data ask for; raises as `gap`, and where no effect was found."""
    from modal.plots.discrepancy import laws_found

    if not diagnosis.laws:
        raise InvalidDataError("this diagnosis found no effect, so there is no law to draw.")
    return figure_of(laws_found(diagnosis, ResultLimits.MOST_SHOWN), axes=axes)


def doubtful_within(modes: ModalModel, band: tuple[float, float]) -> list[Mode]:
    """The doubtful vibration modes that a picture of this band [Hz] shows."""
    return [
        mode
        for mode in modes
        if mode.verdict == "doubtful" and mode.kind == "oscillatory" and band[0] <= mode.frequency <= band[1]
    ]


def overview(result: Identification) -> Chart:
    """Mean spectrum of the outputs (of a table, mean response), measured and of the model, with the modes found."""
    if result.response is None:
        frequency, measured = power_spectra(result.records)
        model = power_spectra(result.simulated)[1]
        low = frequency[1]
    else:
        table = tabled_frf(result.response)
        frequency, low = table.frequencies, table.frequencies[0]
        flat = (table.frf, frf(result.realisation, frequency))
        measured, model = ((np.abs(one) ** 2).reshape(len(frequency), -1) for one in flat)
    total = np.nansum(measured, axis=0)
    total[total == 0] = 1.0
    mean = [np.nanmean(power / total, axis=1) for power in (measured, model)]
    peak = max(float(np.nanmax(mean[0], initial=0.0)), np.finfo(float).tiny)
    figure, panel = one_panel(STYLE.page, 2.6)
    seen, lowest = frequency >= low, 0.0
    lines: tuple[tuple[FloatArray, Role, float], ...] = (
        (mean[0], "measured", STYLE.under),
        (mean[1], "model", STYLE.thin),
    )
    for power, role, width in lines:
        level = 10.0 * np.log10(np.maximum(power[seen] / peak, 1e-10))  # deeper lies the rounding of an empty spectrum
        lowest = min(lowest, float(np.nanmin(level, initial=0.0))) if role == "measured" else lowest
        panel.line(frequency[seen], level, role, width=width, label=role)
    band = (float(frequency[0]), float(frequency[-1]))
    for number, mode in enumerate(doubtful_within(result.modes, band)):
        named = ("", "doubtful") if number else ("doubtful", "")
        ends = [mode.frequency, mode.frequency], [-np.inf, np.inf]
        panel.line(*ends, "doubtful", width=STYLE.thin, dash="dashed", label=named[0], follows=named[1])
    mark_modes(panel, result.modes, 0.05 * (band[1] - band[0]))
    panel.x.limits, panel.y.limits = band, (lowest - 4.0, 4.0)
    panel.x.label, panel.y.label = "frequency [Hz]", "power [dB]"
    figure.key = Key(panel=panel)
    return figure


def fit_chart(result: Identification) -> Chart:
    """The chart of `fit`, of the first record."""
    _with_records(result)
    slowest = next((mode.frequency for mode in result.modes.system if mode.frequency > 0), None)  # an integrator has 0
    return measured_against_simulated(
        result.records[0],
        result.simulated[0],
        outputs=least_fitted(result),
        fits=result.fit.cross_validated,
        detail=None if slowest is None else 10.0 / slowest,  # periods of the slowest mode
    )


def measured_responses(result: Identification, measured: MeasuredFrf) -> Chart:
    """The chart of `frequency_responses`."""
    record = result.channels
    return response_chart(
        measured,
        result.realisation,
        modes=synthesised_alone(result, measured),
        output_names=record.output_names,
        input_names=record.input_names,
        n_pairs=ResultLimits.MOST_SHOWN,
    )


def synthesised_alone(result: Identification, measured: MeasuredFrf) -> ComplexArray | None:
    """(N_GRID, n_outputs, n_inputs) response of the modes of the system and the feedthrough, without any other pole.

    None without such modes, and where states for delays or integrators, or inputs ahead, stand between the modes and
    the outputs.
    """
    model = result.fitted_model or result.realisation
    system = result.modes.system
    if not system or model.order != result.realisation.order or result.realisation.lead:
        return None
    return np.asarray(modal_frf(system, model_grid(measured), dt=model.dt).sum(axis=0) + model.D)


def shape_assurance(result: Identification) -> FloatArray:
    """(n_system, n_system) MAC of the system modes; outputs of several units are made alike where they can be."""
    first = result.channels
    shapes = comparable_shapes(result.modes.system, first.output_names, first.output_units)
    return mac(shapes, shapes)


def least_fitted(result: Identification) -> list[int]:
    """Indices of the outputs that fit least, in the order of the record."""
    fits = np.nan_to_num(result.fit.cross_validated, nan=-np.inf)
    return sorted(np.argsort(fits, kind="stable")[: ResultLimits.MOST_SHOWN].tolist())


def _with_records(result: Identification) -> None:
    if not result.records:
        raise InvalidDataError("these are modes of frequency responses, so there is no record to draw.")


def _system(result: Identification) -> tuple[Mode, ...]:
    if not result.modes.system:
        raise InvalidDataError("this identification found no system mode, so there is no shape to draw.")
    return result.modes.system
