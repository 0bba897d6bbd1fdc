"""Pictures of a result.

For a notebook: `stabilisation`, `modes`, `frequency_responses`, `assurance`, `complexity`, `spectra`, `fit`, `gap` and
`law` take a result and return a matplotlib figure.

For pages and recordings: the other functions take frozen types and return a `Chart`, which is numbers. `svg_text`
draws it for a page, without a plotting library: lines, areas and words in colours that the page exchanges itself.
`figure_of` makes a matplotlib figure of it.
"""

from modal.plots.chart import Chart, Notes, chart_text, svg_text
from modal.plots.histories import measured_against_simulated, residual_autocorrelation
from modal.plots.order import order_fits, singular_values, stabilisation_diagram
from modal.plots.responses import markov_parameters, output_spectra, response_chart
from modal.plots.results import (
    assurance,
    complexity,
    figure_of,
    fit,
    frequency_responses,
    gap,
    law,
    modes,
    spectra,
    stabilisation,
)
from modal.plots.shapes import assurance_matrix, geometry_picture, mode_shapes, shape_complexity

__all__ = [
    "Chart",
    "Notes",
    "assurance",
    "assurance_matrix",
    "chart_text",
    "complexity",
    "figure_of",
    "fit",
    "frequency_responses",
    "gap",
    "geometry_picture",
    "law",
    "markov_parameters",
    "measured_against_simulated",
    "mode_shapes",
    "modes",
    "order_fits",
    "output_spectra",
    "residual_autocorrelation",
    "response_chart",
    "shape_complexity",
    "singular_values",
    "spectra",
    "stabilisation",
    "stabilisation_diagram",
    "svg_text",
]
