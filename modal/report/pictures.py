"""The pictures of a report: the SVG, the words that stand under it, and the numbers that a script reads off it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from era.realisation import Realisation
from modal import plots
from modal.acceptance.check import LimitOutcome, check_limits
from modal.acceptance.test_file import Specification
from modal.geometry.placement import guessed_grid
from modal.geometry.scene import comparison_words
from modal.geometry.sensors import Geometry
from modal.identification.result import Identification, OrderEvidence
from modal.modes.response_synthesis import MeasuredFrf, measured_frf, tabled_frf
from modal.plots.chart import Chart, Notes, chart_text, svg_text
from modal.plots.order import colour_measure, pole_classes
from modal.plots.results import (
    ResultLimits,
    doubtful_within,
    fit_chart,
    least_fitted,
    measured_responses,
    overview,
    shape_assurance,
    synthesised_alone,
)
from modal.quality import DataQuality, check_quality
from modal.wording.text import hertz
from okid.arrays import FloatArray
from okid.errors import InsufficientDataError


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Picture:
    """One picture for a page."""

    svg: str
    caption: str
    chart: str = ""


def drawn(figure: Chart, name: str, caption: str) -> Picture:
    """A picture that is looked at and no more."""
    return Picture(svg=svg_text(figure, name=name, description=caption), caption=caption)


def readable(figure: Chart, name: str, caption: str, *, notes: Mapping[str, Notes] | None = None) -> Picture:
    """A picture that a script can read values off and whose lines it can hide."""
    svg = svg_text(figure, name=name, description=caption)
    return Picture(svg=svg, caption=caption, chart=chart_text(figure, name, notes=notes))


def response_pictures(result: Identification) -> dict[str, Picture]:
    """The picture "responses", or none where the records are too short for a measured response."""
    record = result.channels
    try:
        measured = measured_frf(result.records) if result.response is None else tabled_frf(result.response)
    except InsufficientDataError:
        return {}
    n_pairs = record.n_inputs * record.n_outputs
    which = (
        ""
        if n_pairs <= ResultLimits.MOST_SHOWN
        else f" The {ResultLimits.MOST_SHOWN} strongest of {n_pairs} are shown."
    )
    alone = synthesised_alone(result, measured)
    dashed = "" if alone is None else " Dashed: the modes of the system alone, without the poles that are not believed."
    return {
        "responses": readable(
            measured_responses(result, measured),
            "responses",
            f"Frequency responses: {_measured_words(result, measured)} and synthesised from the model.{dashed} "
            "Below each, the coherence of the output with all inputs; where it is below 0.5 the measured response is "
            "pale."
            f"{which}",
        )
    }


def _measured_words(result: Identification, measured: MeasuredFrf) -> str:
    if result.response is None:
        return f"quotient of measured spectra (mean of {measured.n_averages} segments, so sharp peaks are smeared)"
    return "as they were given (through the window of their blocks, so sharp peaks are smeared)"


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Setting:
    """What stands in a report besides the result itself.

    Attributes:
        specification: article, operator, sensors and limits, None without a test file.
        geometry: nodes and sensors, None where shapes are drawn as sticks.
        quality: of the data; None where it was not looked at.
        quality_of: "as read" or "as used" (means removed, decimated to the band), as the quality was found.
        outcomes: of each acceptance limit.
    """

    specification: Specification | None = None
    geometry: Geometry | None = None
    quality: DataQuality | None = None
    quality_of: str = "as used"
    outcomes: tuple[LimitOutcome, ...] = ()


NOTHING_BESIDES = Setting()
"""For a report on the result alone."""


def setting_of(
    result: Identification,
    *,
    geometry: Geometry | None = None,
    specification: Specification | None = None,
    quality: DataQuality | None = None,
) -> Setting:
    """Look at the data, and hold the result against the limits."""
    known = specification.geometry if specification is not None and geometry is None else geometry
    return Setting(
        specification=specification,
        geometry=known,
        quality=check_quality(result.records, choices=result.choices)
        if quality is None and result.records
        else quality,
        quality_of="as used" if quality is None else "as read",
        outcomes=() if specification is None else check_limits(result, specification),
    )


class PictureLimits:
    """How much the pictures of a page show."""

    MOST_SHAPES: Final = 12
    """Draw so many shapes at most."""
    MOST_ASSURED: Final = 30
    """Shapes of the assurance matrix; the picture grows with the square of their number."""


def draw_pictures(result: Identification, setting: Setting = NOTHING_BESIDES) -> dict[str, Picture]:
    """All pictures that the result has the numbers for, by name."""
    return {
        **_overview_picture(result),
        **_geometry_picture(result, setting),
        **_order_pictures(result),
        **_fit_pictures(result),
        **_mode_pictures(result, setting),
    }


def _overview_picture(result: Identification) -> dict[str, Picture]:
    what = "Mean power spectrum of the outputs" if result.response is None else "Mean of the squared responses"
    found = ", ".join(f"{hertz(frequency)}" for frequency in result.modes.frequencies[: PictureLimits.MOST_ASSURED])
    marked = f" Green: the modes found, at {found} Hz." if found else " No mode of the system was found."
    chart = overview(result)
    band = None if chart.key is None else chart.key.panel.x.limits
    shown = band is not None and doubtful_within(result.modes, band)
    open_ = " Dashed: poles that the data do not settle." if shown else ""
    caption = f"{what}, measured and of the model.{marked}{open_}"
    return {"overview": readable(chart, "overview", caption)}


def _geometry_picture(result: Identification, setting: Setting) -> dict[str, Picture]:
    if setting.geometry is None:
        return {}
    figure = plots.geometry_picture(setting.geometry, output_names=result.channels.output_names)
    return {
        "geometry": drawn(figure, "geometry", "The structure as the geometry describes it; arrows are the sensors.")
    }


def _order_pictures(result: Identification) -> dict[str, Picture]:
    evidence = result.order_evidence
    n_points = sum(bool(np.isfinite(point.frequency)) for point in evidence.stabilisation)
    n_drawn = sum(len(points) for _, points in pole_classes(evidence))
    some = "" if n_drawn == n_points else f" {n_drawn:,} of them are drawn, those of every second order or fewer."
    return {
        "stabilisation": readable(
            plots.stabilisation_diagram(evidence, result.modes, measured=result.records),
            "stabilisation",
            f"Stabilisation diagram: the {n_points:,} poles of the models of all orders over the mean spectrum of the "
            f"measured outputs, coloured by {_colour_words(evidence)}. A mode of the system forms a column of green "
            f"points; noise moves about. The line across is the order chosen.{some}",
            notes=_pole_notes(evidence),
        ),
        "singular_values": readable(
            plots.singular_values(evidence), "singular values", "Singular values of the scaled block Hankel matrix."
        ),
        "order_fits": readable(
            plots.order_fits(evidence),
            "order fits",
            f"Cross-validated fit against model order, a point for each order that was tried.{_unstable(evidence)}",
        ),
    }


def _unstable(evidence: OrderEvidence) -> str:
    """Which of the orders that were tried have no point; "" where all have one."""
    orders = [int(n) for n in evidence.candidate_orders[~np.isfinite(evidence.candidate_fits)]]
    if not orders:
        return ""
    named = ", ".join(map(str, orders[:5])) + (f" and {len(orders) - 5} more" if len(orders) > 5 else "")
    return f" Tried too, but unstable: {named}."


def _pole_notes(evidence: OrderEvidence) -> dict[str, Notes]:
    """What each pole of the diagram is, for a reader who points at it."""
    return {
        word: Notes(
            columns=("damping [%]", "found again", "overlap with the order below", "EMAC"),
            rows=tuple((100 * one.damping_ratio, one.repeatability, one.overlap, one.emac) for one in points),
        )
        for word, points in pole_classes(evidence)
    }


def _colour_words(evidence: OrderEvidence) -> str:
    if colour_measure(evidence)[0] == "repeatability":
        return "how well each is found again from halves of the data and with another observer"
    return "the overlap of each with the pole of the next lower order"


def _fit_pictures(result: Identification) -> dict[str, Picture]:
    if not result.records:
        return {**response_pictures(result), **_markov_picture(result)}
    record = result.records[0]
    shown = least_fitted(result)
    which = "" if len(shown) == record.n_outputs else f" The {len(shown)} outputs with the least fit are shown."
    first = "" if len(result.records) == 1 else f" Record 1 of {len(result.records)}."
    modelled = "simulated from the inputs alone" if record.n_inputs else "predicted one step ahead"
    pictures = {
        "histories": drawn(
            fit_chart(result),
            "histories",
            f"Left, measured (blue) and what the model of all rows leaves of it (red); right, the strongest moment, "
            f"measured and {modelled} (orange). The fit beside each name is that to data kept aside.{first}{which}",
        ),
        "spectra": readable(
            plots.output_spectra(
                result.records, result.simulated, frequencies=result.modes.frequencies.tolist(), outputs=shown
            ),
            "spectra",
            f"Power spectra of the outputs, measured and {modelled}; green lines are the modes of the system.{which}",
        ),
    }
    if result.residuals is not None:
        pictures["residuals"] = drawn(
            plots.residual_autocorrelation(result.residuals, output_names=record.output_names),
            "residuals",
            "Autocorrelation of the one-step residuals: white residuals stay within the band.",
        )
    if result.markov.n_inputs:
        pictures |= {**response_pictures(result), **_markov_picture(result)}
    return pictures


def _markov_picture(result: Identification) -> dict[str, Picture]:
    names = result.channels
    pulse = _pulse_response(result.fitted_model or result.realisation, min(result.markov.n_lags, 2000))
    figure = plots.markov_parameters(
        result.markov, pulse, output_names=names.output_names, input_names=names.input_names
    )
    source = "recovered from the observer" if result.response is None else "the table gives it, its window divided out"
    words = f"Response to a pulse of one sample: as {source}, and as the chosen model has it."
    return {"markov": readable(figure, "markov", words)}


def _mode_pictures(result: Identification, setting: Setting) -> dict[str, Picture]:
    system = result.modes.system
    if not system:
        return {}
    record = result.channels
    drawn_on, shown = system[: _n_drawn(setting)], system[: PictureLimits.MOST_SHAPES]
    mixed = ""
    if len(set(record.output_units)) > 1:
        mixed = " The outputs have different units: compare only components of the same unit."
    guessed = guessed_grid(record.output_names, record.output_units) is not None
    pictures = {
        "shapes": drawn(
            plots.mode_shapes(
                drawn_on, output_names=record.output_names, output_units=record.output_units, geometry=setting.geometry
            ),
            "shapes",
            f"{_shape_words(setting, mixed, guessed=guessed)}{_first(drawn_on, system)}",
        ),
        "complexity": drawn(
            plots.shape_complexity(shown),
            "complexity",
            f"Shape components as phasors: those of a real mode lie on one line.{mixed}{_first(shown, system)}",
        ),
    }
    if len(system) > 1:
        frequencies = result.modes.frequencies[: PictureLimits.MOST_ASSURED].tolist()
        compared = comparison_words(record.output_names, record.output_units)
        pictures["assurance"] = drawn(
            plots.assurance_matrix(
                shape_assurance(result)[: PictureLimits.MOST_ASSURED, : PictureLimits.MOST_ASSURED], frequencies
            ),
            "assurance",
            "MAC (modal assurance criterion) of the modes with one another: large numbers off the diagonal mean that "
            f"the sensors can hardly tell the two shapes apart. {compared}".rstrip()
            + _first(frequencies, system),
        )
    return pictures


def _n_drawn(setting: Setting) -> int:
    """How many shapes are drawn: fewer on a geometry of very many lines and surfaces, so that the page stays small."""
    if setting.geometry is None:
        return PictureLimits.MOST_SHAPES
    pieces = sum(len(line) for line in setting.geometry.lines) + sum(len(face) for face in setting.geometry.surfaces)
    return int(np.clip(9000 // max(1, pieces), 2, PictureLimits.MOST_SHAPES))  # pieces in all shapes together


def _first(shown: Sequence[object], system: Sequence[object]) -> str:
    return "" if len(shown) == len(system) else f" The first {len(shown)} of {len(system)} modes."


def _shape_words(setting: Setting, mixed: str, *, guessed: bool) -> str:
    if setting.geometry is not None or guessed:
        where = "a grid guessed from the names of the outputs" if setting.geometry is None else "the geometry"
        return (
            f"Shapes of the modes of the system on {where}, greatest motion 1; thin, the structure at rest and at "
            "the other end of its motion."
        )
    return (
        "Shapes of the modes of the system: sensors in the order of the record, greatest component 1, without the "
        f"geometry of the structure; dotted, the imaginary part where it exceeds 0.05.{mixed}"
    )


def _pulse_response(realisation: Realisation, n_lags: int) -> FloatArray:
    pulse = [realisation.D]
    state = realisation.B
    for _ in range(n_lags):
        pulse.append(realisation.C @ state)
        state = realisation.A @ state
    return np.array(pulse)
