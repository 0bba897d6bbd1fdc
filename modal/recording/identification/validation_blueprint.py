"""How the page "Validation" opens; called by `modal.recording.blueprint`."""

from typing import Any

from modal.identification.result import Identification
from modal.recording.evidence import Gathered
from modal.recording.identification.fit_blueprint import run_view
from modal.recording.identification.validation import VALIDATION_TEXT
from modal.recording.identification.validation_panes import (
    density_pane,
    drawn_inputs,
    magnitude_pane,
    overview_columns,
    response_pane,
)
from modal.recording.names import label
from modal.recording.plan import Plan
from modal.recording.views_blueprint import document_view, plot_view, series_view

__all__ = ["validation_page"]


def validation_page(identification: Identification, plan: Plan, evidence: Gathered) -> Any:
    """All outputs over frequency, then each over time and frequency; the words to the right."""
    import rerun.blueprint as rrb

    outputs = plan.data.shown_outputs
    tabs = [_one_output(identification, plan, evidence, i) for i in outputs]
    if len(outputs) > 1:
        tabs = [_everything(identification, plan, evidence), *tabs]
    left = rrb.Tabs(*tabs, active_tab=0, name="Outputs") if len(tabs) > 1 else tabs[0]
    words = document_view(VALIDATION_TEXT, "Validation in words")
    return rrb.Horizontal(left, words, column_shares=[2.4, 1.0], name="Validation")


def _everything(identification: Identification, plan: Plan, evidence: Gathered) -> Any:
    import rerun.blueprint as rrb

    views = [_overview(identification, plan, evidence, i) for i in plan.data.shown_outputs]
    return rrb.Grid(*views, grid_columns=overview_columns(len(views)), name="All outputs")


def _overview(identification: Identification, plan: Plan, evidence: Gathered, output: int) -> Any:
    sources = drawn_inputs(evidence, plan, output)
    name = label(_output(identification, output), 20)
    pane = magnitude_pane(output, len(plan.data.shown_outputs))
    if sources:
        return plot_view(pane, f"{name} / {_input(identification, sources[0], 20)}")
    if evidence.model_density.size:
        return plot_view(pane, f"Spectrum of {name}")
    return run_view(identification, plan, output, legend=output == 0)


def _one_output(identification: Identification, plan: Plan, evidence: Gathered, output: int) -> Any:
    """Over time to the left, with what is left over; over frequency to the right, a tab an input."""
    import rerun.blueprint as rrb

    name = label(_output(identification, output), 18)
    series = rrb.Vertical(
        run_view(identification, plan, output),
        series_view(plan.fit_paths[output], "Residual", ["$origin/residual/**"]),
        row_shares=[1.3, 1.0],
        name="Over time",
    )
    responses = [
        plot_view(response_pane(output, source), f"{name} / {_input(identification, source, 18)}")
        for source in drawn_inputs(evidence, plan, output)
    ]
    if evidence.model_density.size:
        responses = [plot_view(density_pane(output), f"Spectrum of {name}")]
    if not responses:
        return rrb.Vertical(series, name=name)
    right = rrb.Tabs(*responses, active_tab=0, name="Over frequency") if len(responses) > 1 else responses[0]
    return rrb.Horizontal(series, right, column_shares=[1.25, 1.0], name=name)


def _output(identification: Identification, output: int) -> str:
    return identification.records[0].output_names[output]


def _input(identification: Identification, source: int, longest: int) -> str:
    return label(identification.records[0].input_names[source], longest)
