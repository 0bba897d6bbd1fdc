"""Pictures of a result: each function takes frozen types and returns a `Chart`, which is numbers.

`svg_text` draws it for a page, without a plotting library: lines, areas and words in colours that the page exchanges
itself. `figure_of` makes a matplotlib figure of it.
"""

from modal.plots.figures import figure_of
from modal.plots.histories import measured_against_simulated, residual_autocorrelation
from modal.plots.layout import Chart
from modal.plots.order import order_fits, singular_values, stabilisation_diagram
from modal.plots.responses import frequency_responses, markov_parameters, output_spectra
from modal.plots.shapes import assurance_matrix, geometry_picture, mode_shapes, shape_complexity
from modal.plots.vector import Notes, chart_text, svg_text

__all__ = [
    "Chart",
    "Notes",
    "assurance_matrix",
    "chart_text",
    "figure_of",
    "frequency_responses",
    "geometry_picture",
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
