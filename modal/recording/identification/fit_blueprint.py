"""How the page "Observer fit" opens; called by `modal.recording.blueprint`."""

from typing import Any, Final

import numpy as np

from modal.identification.result import Identification
from modal.recording.identification.fit import FIT_TEXT, MARKOV, WHITENESS
from modal.recording.names import label, name_with_unit
from modal.recording.plan import SHOWN_INPUTS, DataPlan, Plan
from modal.recording.views_blueprint import document_view, plot_view, series_view
from modal.wording.numbers import fit_text

__all__ = ["fit_page", "inputs_view", "run_view"]

DETAILED_OUTPUTS: Final = 4
"""Up to so many outputs, each has its window beside it on the first tab."""


def fit_page(identification: Identification, plan: Plan) -> Any:
    """Series to the left, a tab for all outputs and one for each; words, Markov parameters, whiteness to the right."""
    import rerun.blueprint as rrb

    left: list[Any] = [_everything(identification, plan)]
    if len(plan.data.shown_outputs) > 1:
        left += [_one_output(identification, plan, i) for i in plan.data.shown_outputs]
    series = rrb.Tabs(*left, active_tab=0, name="Outputs") if len(left) > 1 else left[0]
    words = [document_view(FIT_TEXT, "Fit")]
    if identification.markov.n_inputs or identification.markov.gain is not None:
        words.append(plot_view(MARKOV, "Markov parameters"))
    words.append(plot_view(WHITENESS, "Whiteness"))
    right = rrb.Vertical(*words, row_shares=[1.6, 1.05, 0.85][: len(words)], name="Fit in words")
    return rrb.Horizontal(series, right, column_shares=[2.15, 1.0], name="Observer fit")


def inputs_view(plan: DataPlan) -> list[Any]:
    """The inputs in one view; nothing where there is none."""
    if not plan.input_paths:
        return []
    n_inputs = len(plan.input_paths)
    name = "Input" if n_inputs == 1 else "Inputs"
    if n_inputs > SHOWN_INPUTS:
        name = f"Inputs, the first {SHOWN_INPUTS} of {n_inputs}"
    return [series_view(f"{plan.root}/input", name, list(plan.input_paths[:SHOWN_INPUTS]))]


def run_view(identification: Identification, plan: Plan, output: int, *, legend: bool = True) -> Any:
    """One output over the whole time: measured under predicted and simulated."""
    fit = identification.fit.cross_validated[output]
    first = identification.records[0]
    name = name_with_unit(first.output_names[output], first.output_units[output])
    title = f"{name}: fit {fit_text(fit)}" if np.isfinite(fit) else name
    return series_view(plan.fit_paths[output], title, _lines(plan, output), legend=legend)


def _everything(identification: Identification, plan: Plan) -> Any:
    """Inputs over all outputs: a few with their windows, many in two columns."""
    import rerun.blueprint as rrb

    outputs = plan.data.shown_outputs
    if len(outputs) == 1:
        return _one_output(identification, plan, 0)
    rows: list[Any] = inputs_view(plan.data)
    shares = [0.8] * len(rows)
    if len(outputs) <= DETAILED_OUTPUTS:
        for i in outputs:
            pair = (run_view(identification, plan, i, legend=i == 0), _window(identification, plan, i))
            rows.append(rrb.Horizontal(*pair, column_shares=[1.5, 1.0], name=label(_name(identification, i))))
        shares += [1.0] * len(outputs)
    else:
        views = [run_view(identification, plan, i, legend=i == 0) for i in outputs]
        rows.append(rrb.Grid(*views, grid_columns=2, name="Outputs"))
        shares = [0.5] * len(shares) + [0.75 * -(-len(outputs) // 2)]
    return rrb.Vertical(*rows, row_shares=shares, name="All outputs")


def _one_output(identification: Identification, plan: Plan, output: int) -> Any:
    import rerun.blueprint as rrb

    rows = [
        *inputs_view(plan.data),
        run_view(identification, plan, output),
        _window(identification, plan, output),
        series_view(plan.fit_paths[output], "Residual", ["$origin/residual/**"]),
    ]
    shares = [0.7, 1.2, 1.5, 0.8][-len(rows) :]
    return rrb.Vertical(*rows, row_shares=shares, name=label(_name(identification, output), 18))


def _window(identification: Identification, plan: Plan, output: int) -> Any:
    """The same close by: a window that follows the cursor."""
    import rerun.blueprint as rrb

    at = rrb.TimeRangeBoundary
    ends = (at.cursor_relative(seconds=-0.15 * plan.window), at.cursor_relative(seconds=0.85 * plan.window))
    title = f"{label(_name(identification, output))}: at the cursor"
    view = series_view(plan.fit_paths[output], title, _lines(plan, output), legend=False)
    view.properties["TimeAxis"] = rrb.TimeAxis(link="Independent", view_range=rrb.TimeRange(start=ends[0], end=ends[1]))
    return view


def _lines(plan: Plan, output: int) -> list[str]:
    return [plan.data.output_paths[output], "$origin/model/**"]


def _name(identification: Identification, output: int) -> str:
    return identification.records[0].output_names[output]
