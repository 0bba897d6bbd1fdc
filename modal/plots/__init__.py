"""Pictures of a result: each function takes frozen types and returns a matplotlib Figure, nothing is shown or saved.

matplotlib lives behind this package alone, by its object interface; `pyplot` and its global state are never touched.
"""

from modal.plots.histories import measured_against_simulated, residual_autocorrelation
from modal.plots.order import order_fits, singular_values, stabilisation_diagram
from modal.plots.responses import frequency_responses, markov_parameters, output_spectra
from modal.plots.shapes import assurance_matrix, geometry_picture, mode_shapes, shape_complexity
from modal.plots.style import DARK, LIGHT, Theme, house_style
from modal.plots.vector import svg_text

__all__ = [
    "DARK",
    "LIGHT",
    "Theme",
    "assurance_matrix",
    "frequency_responses",
    "geometry_picture",
    "house_style",
    "markov_parameters",
    "measured_against_simulated",
    "mode_shapes",
    "order_fits",
    "output_spectra",
    "residual_autocorrelation",
    "shape_complexity",
    "singular_values",
    "stabilisation_diagram",
    "svg_text",
]
