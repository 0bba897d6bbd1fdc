"""How the page "Record" opens; called by `modal.recording.blueprint`, and by `modal.recording.live` before any fit."""

from collections.abc import Sequence
from typing import Any, Final

from modal.quality.findings import DataQuality
from modal.recording.identification.fit_blueprint import inputs_view
from modal.recording.identification.record import OUTPUT_COLOURS, marked, marks_path, quality_path, spectra_pane
from modal.recording.names import name_with_unit
from modal.recording.plan import SHOWN_OUTPUTS, DataPlan
from modal.recording.views_blueprint import document_view, plot_view, series_view
from okid.record import Record

__all__ = ["record_page"]

ONE_COLUMN: Final = 4
"""Outputs stand one below the other up to so many, in two columns beyond."""


def record_page(records: Sequence[Record], plan: DataPlan, quality: DataQuality) -> Any:
    """Inputs, findings on the time axis, outputs; to the right the quality in words over spectra and coherence."""
    import rerun.blueprint as rrb

    rows = inputs_view(plan)
    shares = [1.0] * len(rows)
    marks = marked(quality)
    if marks:
        rows.append(_marks_view(plan, len(marks)))
        shares.append(0.5 + 0.09 * len(marks))
    rows += [_outputs(records, plan)]
    shares.append(0.9 * -(-len(plan.shown_outputs) // _columns(plan)))
    left = rrb.Vertical(*rows, row_shares=shares, name="Channels")
    words = [document_view(quality_path(plan), "Data quality")]
    if quality.frequencies.size:
        pane = spectra_pane(plan)
        words.append(plot_view(pane, "Spectra" if quality.coherence is None else "Spectra and coherence"))
    right = rrb.Vertical(*words, row_shares=[1.0, 1.9][: len(words)], name="Quality")
    return rrb.Horizontal(left, right, column_shares=[1.7, 1.0], name="Record")


def _columns(plan: DataPlan) -> int:
    return 1 if len(plan.shown_outputs) <= ONE_COLUMN else 2


def _outputs(records: Sequence[Record], plan: DataPlan) -> Any:
    import rerun.blueprint as rrb

    first = records[0]
    views = []
    for i in plan.shown_outputs:
        title = name_with_unit(first.output_names[i], first.output_units[i])
        view = series_view(plan.output_paths[i], title, ["$origin"], legend=False)
        view.visualizer_overrides[plan.output_paths[i]] = _thin(i)
        views.append(view)
    n_outputs = first.n_outputs
    name = "Outputs" if n_outputs <= SHOWN_OUTPUTS else f"Outputs, the first {SHOWN_OUTPUTS} of {n_outputs}"
    return rrb.Grid(*views, grid_columns=_columns(plan), name=name)


def _thin(output: int) -> Any:
    """The style on this page: the colour that the output has in the spectra, and a thin line."""
    import rerun as rr

    colour = OUTPUT_COLOURS[output % len(OUTPUT_COLOURS)]
    return rr.SeriesLines.from_fields(colors=colour, widths=1.0, aggregation_policy="MinMax")


def _marks_view(plan: DataPlan, n_marks: int) -> Any:
    import rerun.blueprint as rrb

    view = series_view(marks_path(plan), "What was found, and when", ["$origin/**"])
    view.properties["ScalarAxis"] = rrb.ScalarAxis(range=(-n_marks - 0.7, -0.3), zoom_lock=True)
    return view
