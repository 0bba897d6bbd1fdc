"""The pictures of a report as SVG text, each with the words that stand under it."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from era.realisation import Realisation
from modal.assurance import assurance
from modal.identification import Identification, OrderEvidence
from modal.mode import ModalModel
from okid.arrays import FloatArray
from okid.errors import InsufficientDataError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Picture", "draw_pictures", "shape_assurance"]

MOST_OUTPUTS = 6
MOST_SHAPES = 12
MOST_LAGS = 2000


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Picture:
    """One picture for a page.

    Attributes:
        svg: the `<svg>` element.
        caption: what there is to see.
    """

    svg: str
    caption: str


def draw_pictures(result: Identification) -> dict[str, Picture]:
    """All pictures that the result has the numbers for, by name."""
    from modal import plots

    with plots.house_style():
        return {**_order_pictures(result), **_fit_pictures(result), **_mode_pictures(result)}


def shape_assurance(modes: ModalModel) -> FloatArray:
    """(n_system, n_system) modal assurance of the system modes with one another."""
    return assurance(modes.shapes, modes.shapes)


def _order_pictures(result: Identification) -> dict[str, Picture]:
    from modal import plots

    evidence = result.order_evidence
    n_points = len(evidence.stabilisation)
    return {
        "stabilisation": _picture(
            plots.stabilisation_diagram(evidence, result.modes, measured=result.records),
            "stabilisation",
            f"Stabilisation diagram: the {n_points} poles of the models of all orders over the mean spectrum of the "
            f"measured outputs, coloured by {_colour_words(evidence)}. A mode of the system forms a column of green "
            "points; noise moves about.",
        ),
        "singular_values": _picture(
            plots.singular_values(evidence), "singular values", "Singular values of the scaled block Hankel matrix."
        ),
        "order_fits": _picture(
            plots.order_fits(evidence),
            "order fits",
            "Cross-validated fit against model order. An order without a point gave an unstable model.",
        ),
    }


def _colour_words(evidence: OrderEvidence) -> str:
    from modal.plots.order import colour_measure

    if colour_measure(evidence)[0] == "repeatability":
        return "how well each is found again from halves of the data and with another observer"
    return "the overlap of each with the pole of the next lower order"


def _fit_pictures(result: Identification) -> dict[str, Picture]:
    from modal import plots

    record, simulated = result.records[0], result.simulated[0]
    shown = _worst_outputs(result)
    which = "" if len(shown) == record.n_outputs else f" The {len(shown)} outputs with the least fit are shown."
    first = "" if len(result.records) == 1 else f" Record 1 of {len(result.records)}."
    detail = 10.0 / result.modes.frequencies[0] if result.modes.system else None
    modelled = "simulated from the inputs alone" if record.n_inputs else "predicted one step ahead"
    pulse = _pulse_response(result.fitted_model or result.realisation, min(result.markov.n_lags, MOST_LAGS))
    pictures = {
        "histories": _picture(
            plots.measured_against_simulated(
                record, simulated, outputs=shown, fits=result.fit.cross_validated, detail=detail
            ),
            "histories",
            f"Measured (blue) and {modelled} (orange).{first}{which}",
        ),
        "spectra": _picture(
            plots.output_spectra(
                result.records, result.simulated, frequencies=result.modes.frequencies.tolist(), outputs=shown
            ),
            "spectra",
            f"Power spectra of the outputs, measured and {modelled}; green lines are the modes of the system.{which}",
        ),
        "residuals": _picture(
            plots.residual_autocorrelation(result.residuals, output_names=record.output_names),
            "residuals",
            "Autocorrelation of the one-step residuals: white residuals stay within the band.",
        ),
    }
    if result.markov.n_inputs:
        pictures |= _response_pictures(result)
        pictures["markov"] = _picture(
            plots.markov_parameters(
                result.markov, pulse, output_names=record.output_names, input_names=record.input_names
            ),
            "markov",
            "Response to a pulse of one sample: as recovered from the observer, and as the chosen model has it.",
        )
    return pictures


def _response_pictures(result: Identification) -> dict[str, Picture]:
    from modal import plots
    from modal.synthesis import measured_frf

    record = result.records[0]
    try:
        measured = measured_frf(result.records)
    except InsufficientDataError:
        return {}
    return {
        "responses": _picture(
            plots.frequency_responses(
                measured, result.realisation, output_names=record.output_names, input_names=record.input_names
            ),
            "responses",
            "Frequency responses: quotient of measured spectra (mean of "
            f"{measured.n_averages} segments, so sharp peaks are smeared) and the model. Pale where the coherence of "
            "the output with all inputs is below 0.5.",
        )
    }


def _mode_pictures(result: Identification) -> dict[str, Picture]:
    from modal import plots

    system = result.modes.system
    shown = system[:MOST_SHAPES]
    if not shown:
        return {}
    names = result.records[0].output_names
    which = "" if len(shown) == len(system) else f" The first {len(shown)} of {len(system)} modes."
    units = set(result.records[0].output_units)
    mixed = "" if len(units) == 1 else " The outputs have different units: compare only components of the same unit."
    pictures = {
        "shapes": _picture(
            plots.mode_shapes(shown, output_names=names),
            "shapes",
            "Shapes of the modes of the system: sensors in the order of the record, greatest component 1, without the "
            f"geometry of the structure; dotted, the imaginary part where it exceeds 0.05.{mixed}{which}",
        ),
        "complexity": _picture(
            plots.shape_complexity(shown),
            "complexity",
            f"Shape components as phasors: those of a real mode lie on one line.{mixed}{which}",
        ),
    }
    if len(system) > 1:
        frequencies = result.modes.frequencies.tolist()
        pictures["assurance"] = _picture(
            plots.assurance_matrix(shape_assurance(result.modes), frequencies),
            "assurance",
            "Modal assurance of the system modes with one another: large numbers off the diagonal mean that the "
            "sensors can hardly tell the two shapes apart.",
        )
    return pictures


def _picture(figure: "Figure", name: str, caption: str) -> Picture:
    from modal import plots

    return Picture(svg=plots.svg_text(figure, name=name, description=caption), caption=caption)


def _worst_outputs(result: Identification) -> list[int]:
    fits = np.nan_to_num(result.fit.cross_validated, nan=-np.inf)
    return sorted(np.argsort(fits, kind="stable")[:MOST_OUTPUTS].tolist())


def _pulse_response(realisation: Realisation, n_lags: int) -> FloatArray:
    pulse = [realisation.D]
    state = realisation.B
    for _ in range(n_lags):
        pulse.append(realisation.C @ state)
        state = realisation.A @ state
    return np.array(pulse)
