"""How the recording of a diagnosis opens; beside `modal.recording.blueprint`, from which its views come."""

from typing import TYPE_CHECKING, Any

from modal.discrepancy.results import Diagnosis
from modal.recording.blueprint import show_whole_record
from modal.recording.discrepancy.discrepancy_levels import LEVEL_DAMPING, LEVEL_FREQUENCY, level_panes
from modal.recording.discrepancy.discrepancy_plan import DiscrepancyPlan
from modal.recording.discrepancy.discrepancy_steps import STEP_GAP, STEP_PARTS, STEP_SPECTRUM, STEP_TEXT
from modal.recording.discrepancy.page import (
    GAP_TEXT,
    HYPOTHESES,
    LAW_TEXT,
    VERDICT_TEXT,
    law_panes,
    law_title,
    spectrum_pane,
)
from modal.recording.discrepancy.series import diagnosis_tables
from modal.recording.names import label, name_with_unit
from modal.recording.series import TIMELINE
from modal.recording.views_blueprint import document_view, plot_view, series_view

if TYPE_CHECKING:
    import rerun.blueprint

__all__ = ["diagnosis_blueprint"]

SECONDS_A_STEP = 1.5
"""How long a step stands while the page plays."""


def diagnosis_blueprint(diagnosis: Diagnosis, plan: DiscrepancyPlan) -> "rerun.blueprint.Blueprint":
    """The whole layout for one diagnosis."""
    import rerun.blueprint as rrb

    pages = [_discrepancy_page(diagnosis, plan)]
    if plan.step_gaps:
        pages.append(_steps_page(diagnosis, plan))
    pages += [
        _law_page(diagnosis),
        *_levels_page(diagnosis),
        _outputs_page(diagnosis, plan),
        _numbers_page(diagnosis, plan),
    ]
    speed = max(plan.stop - plan.start, 1e-6) / (SECONDS_A_STEP * max(1, len(plan.step_gaps) - 1))
    return rrb.Blueprint(
        rrb.Tabs(*pages, active_tab=0),
        rrb.TimePanel(
            timeline=TIMELINE,
            state="collapsed",
            play_state="paused",
            loop_mode="all",
            playback_speed=speed,
            fps=1.0 / (SECONDS_A_STEP * speed),  # of the timeline "step", to which the speed applies as well
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )


def _discrepancy_page(diagnosis: Diagnosis, plan: DiscrepancyPlan) -> Any:
    """Gap over time on the whole width; below it spectrum, hypotheses, verdict."""
    import rerun.blueprint as rrb

    outputs = _in_front(plan)
    above = [_gap_view(diagnosis, plan, output) for output in outputs]
    verdict = document_view(VERDICT_TEXT, "Verdict")
    below: list[Any] = []
    if plan.stages:
        below.append(_tabs([plot_view(spectrum_pane(i), _spectrum_name(diagnosis, i)) for i in outputs], "Spectra"))
    if diagnosis.hypotheses:
        below.append(plot_view(HYPOTHESES, "What was tried"))
    lower = rrb.Horizontal(*below, verdict, column_shares=[1.0] * len(below) + [1.15], name="What is missing")
    page = rrb.Vertical(_tabs(above, "Outputs"), lower, row_shares=[1.0, 1.25], name="Discrepancy")
    show_whole_record(page, plan)
    return page


def _steps_page(diagnosis: Diagnosis, plan: DiscrepancyPlan) -> Any:
    import rerun.blueprint as rrb

    name = label(diagnosis.held_out[0].output_names[plan.output])
    below = rrb.Horizontal(
        plot_view(STEP_SPECTRUM, f"Spectrum of the gap of {name}"),
        plot_view(STEP_PARTS, "Gap by part"),
        document_view(STEP_TEXT, "This step"),
        column_shares=[1.0, 1.0, 0.9],
        name="By part",
    )
    above = plot_view(STEP_GAP, f"Gap of {name}: press play")
    return rrb.Vertical(above, below, row_shares=[1.0, 1.25], name="Step by step")


def _law_page(diagnosis: Diagnosis) -> Any:
    import rerun.blueprint as rrb

    words = document_view(LAW_TEXT, "Findings")
    views = [plot_view(pane, law_title(law)) for pane, law in zip(law_panes(diagnosis), diagnosis.laws, strict=False)]
    if not views:
        return rrb.Vertical(words, name="Laws")
    grid = rrb.Grid(*views, grid_columns=1 if len(views) < 3 else 2, name="Laws over the data")
    return rrb.Horizontal(grid, words, column_shares=[1.9, 1.0], name="Laws")


def _levels_page(diagnosis: Diagnosis) -> list[Any]:
    """Modes against level, where they tell something; else no page."""
    import rerun.blueprint as rrb

    titles = {LEVEL_FREQUENCY: "Frequency of each mode against level", LEVEL_DAMPING: "Damping against level"}
    views = [plot_view(pane, titles[pane]) for pane in level_panes(diagnosis)]
    return [rrb.Horizontal(*views, name="Levels")] if views else []


def _outputs_page(diagnosis: Diagnosis, plan: DiscrepancyPlan) -> Any:
    import rerun.blueprint as rrb

    first = diagnosis.held_out[0]
    views = [
        series_view(
            f"{plan.output_paths[i]}/run", name_with_unit(first.output_names[i], first.output_units[i]), ["$origin/**"]
        )
        for i in plan.shown_outputs
    ]
    grid = rrb.Grid(*views, grid_columns=1 if len(views) < 4 else 2, name="Measured and simulated")
    words = document_view(GAP_TEXT, "Gap in numbers")
    return rrb.Horizontal(grid, words, column_shares=[1.9, 1.0], name="Outputs")


def _numbers_page(diagnosis: Diagnosis, plan: DiscrepancyPlan) -> Any:
    import rerun.blueprint as rrb

    views = []
    for table in diagnosis_tables(diagnosis, plan):
        columns = [table.timeline, *(f"/{table.path}:{name}" for name in table.columns)]
        query = rrb.archetypes.DataframeQuery(timeline=table.timeline, select=columns)
        views.append(rrb.DataframeView(origin=table.path, name=table.title, query=query))
    return rrb.Tabs(*views, active_tab=0, name="Numbers")


def _in_front(plan: DiscrepancyPlan) -> list[int]:
    """The shown outputs, the one with the largest gap first."""
    return [plan.output, *(i for i in plan.shown_outputs if i != plan.output)]


def _gap_view(diagnosis: Diagnosis, plan: DiscrepancyPlan, output: int) -> Any:
    first = diagnosis.held_out[0]
    name = name_with_unit(first.output_names[output], first.output_units[output])
    return series_view(f"{plan.output_paths[output]}/gap", f"Measured minus simulated: {name}", ["$origin/**"])


def _spectrum_name(diagnosis: Diagnosis, output: int) -> str:
    return f"Gap over frequency: {label(diagnosis.held_out[0].output_names[output], 18)}"


def _tabs(views: list[Any], name: str) -> Any:
    import rerun.blueprint as rrb

    return rrb.Tabs(*views, active_tab=0, name=name) if len(views) > 1 else views[0]
