"""Frequency responses as a page shows them: measured, synthesised, and what the modes of the system make alone."""

import numpy as np

from modal.identification.result import Identification
from modal.modes.response_synthesis import MeasuredFrf, measured_frf, modal_frf
from modal.plots.responses import frequency_responses, model_grid
from modal.report.picture import Picture, readable
from okid.arrays import ComplexArray
from okid.errors import InsufficientDataError

__all__ = ["response_pictures", "synthesised_alone"]

MOST_PAIRS = 6


def response_pictures(result: Identification) -> dict[str, Picture]:
    """The picture "responses", or none where the records are too short for a measured response."""
    record = result.records[0]
    try:
        measured = measured_frf(result.records)
    except InsufficientDataError:
        return {}
    n_pairs = record.n_inputs * record.n_outputs
    which = "" if n_pairs <= MOST_PAIRS else f" The {MOST_PAIRS} strongest of {n_pairs} are shown."
    alone = synthesised_alone(result, measured)
    dashed = "" if alone is None else " Dashed: the modes of the system alone, without the poles that are not believed."
    figure = frequency_responses(
        measured,
        result.realisation,
        modes=alone,
        output_names=record.output_names,
        input_names=record.input_names,
        n_pairs=MOST_PAIRS,
    )
    return {
        "responses": readable(
            figure,
            "responses",
            "Frequency responses: quotient of measured spectra (mean of "
            f"{measured.n_averages} segments, so sharp peaks are smeared) and synthesised from the model.{dashed} "
            "Below each, the coherence of the output with all inputs; where it is below 0.5 the measured response is "
            "pale."
            f"{which}",
        )
    }


def synthesised_alone(result: Identification, measured: MeasuredFrf) -> ComplexArray | None:
    """(N_GRID, n_outputs, n_inputs) response of the modes of the system and the feedthrough, without any other pole.

    None without such modes, and where states for delays or integrators stand between the modes and the outputs.
    """
    model = result.fitted_model or result.realisation
    modes = result.modes.system
    if not modes or model.order != result.realisation.order:
        return None
    return np.asarray(modal_frf(modes, model_grid(measured), dt=model.dt).sum(axis=0) + model.D)
