"""A chart as a matplotlib figure: the same numbers, axes, words and keys, and nothing of the caller's is touched."""

import dataclasses
import subprocess
import sys

import numpy as np
import pytest
from matplotlib.figure import Figure

from modal import plots
from modal.plots import figure_of
from modal.plots.chart import Key, grid_of
from modal.plots.panels import COLOURS
from okid.display import Displayed
from okid.errors import InvalidDataError


@pytest.fixture
def chart():
    made = grid_of(2, 1, size=(5.0, 4.0))
    upper, lower = made.panels
    upper.head, upper.y.label, upper.x.log = "above", "size [m]", True
    upper.line([1.0, 10.0, np.nan, 100.0], [1.0, 2.0, 3.0, 5.0], "measured", dash="dashed", label="measured")
    upper.dots([1.0, 10.0], [2.0, 3.0], "model", dot=4.0, square=True)
    upper.upright(10.0, "muted")
    upper.word(10.0, np.inf, "a mark", "ink", anchor="end")
    lower.box_of((-np.inf, np.inf), (-1.0, 1.0), "muted", opacity=0.2, label="band")
    lower.segments([[[0.0, 0.0], [1.0, 2.0]], [[2.0, 0.0], [3.0, 1.0]]], "system", label="pieces")
    lower.segments([[[0.0, 0.0], [1.0, 1.0]]], "system", arrows=True)
    lower.x.ticks, lower.y.limits, lower.key = [(0.0, "none"), (3.0, "three")], (3.0, -1.0), "upper right"
    made.key = Key(panel=upper, title="what it is")
    return made


def test_a_figure_shows_what_the_chart_holds(chart):
    figure = figure_of(chart)
    figure.draw_without_rendering()
    upper, lower = figure.axes
    curve, dots, upright = upper.lines
    np.testing.assert_array_equal(curve.get_xydata(), chart.panels[0].lines[0].corners)
    assert (curve.get_color(), curve.get_linestyle(), curve.get_label()) == (COLOURS["measured"], "--", "measured")
    assert (dots.get_linestyle(), dots.get_marker()) == ("None", "s")
    assert upright.get_ydata().tolist() == sorted(upper.get_ylim())
    assert (upper.get_xscale(), upper.get_ylabel(), upper.get_title(loc="left")) == ("log", "size [m]", "above")
    assert [text.get_text() for text in upper.texts] == ["a mark"]
    assert lower.get_ylim() == (3.0, -1.0)
    assert [text.get_text() for text in lower.get_xticklabels()] == ["none", "three"]
    band, pieces = lower.collections
    assert band.get_paths()[0].get_extents().x1 == lower.get_xlim()[1]
    np.testing.assert_array_equal(pieces.get_segments(), chart.panels[1].marks[1].ends)
    assert [text.get_text() for text in lower.get_legend().get_texts()] == ["band", "pieces"]
    assert figure.legends[0].get_title().get_text() == "what it is"


def test_panels_stand_where_the_chart_has_them(chart):
    figure = figure_of(chart)
    np.testing.assert_allclose(figure.get_size_inches(), (5.0, 4.0))
    for axes, panel in zip(figure.axes, chart.panels, strict=True):
        left, top, width, height = panel.box
        wanted = (left / chart.width, 1.0 - (top + height) / chart.height, width / chart.width, height / chart.height)
        np.testing.assert_allclose(axes.get_position().bounds, wanted)


def test_it_draws_on_axes_that_are_given(chart):
    own = Figure()
    axes = own.subplots(2, 1)
    assert figure_of(chart, axes=axes) is own
    assert all(one.lines or one.collections for one in axes)


def test_it_asks_for_axes_a_panel(chart):
    with pytest.raises(InvalidDataError, match=r"2 panels, but 1 axes"):
        figure_of(chart, axes=Figure().subplots())


def test_no_window_opens_and_modal_does_not_import_matplotlib():
    code = (
        "import sys, modal, modal.plots, modal.report, modal.recording\n"
        "assert 'matplotlib' not in sys.modules\n"
        "chart = modal.plots.chart.grid_of(1, 1, size=(1.0, 1.0))\n"
        "modal.plots.figure_of(chart)\n"
        "assert 'matplotlib' in sys.modules and 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)


@pytest.fixture(scope="module")
def forty_axes():
    return list(Figure().subplots(1, 40))


@pytest.mark.parametrize(
    "name", ["stabilisation", "modes", "frequency_responses", "assurance", "complexity", "spectra", "fit"]
)
def test_each_figure_of_an_identification_is_one_call(identification, forty_axes, name):
    figure = getattr(plots, name)(identification)
    assert isinstance(figure, Figure)
    figure.draw_without_rendering()
    assert any(axes.lines or axes.collections or axes.texts for axes in figure.axes)
    with pytest.raises(InvalidDataError, match="each panel needs axes of its own"):
        getattr(plots, name)(identification, axes=forty_axes)


@pytest.mark.parametrize("name", ["gap", "law"])
def test_each_figure_of_a_diagnosis_is_one_call(diagnosis, name):
    figure = getattr(plots, name)(diagnosis)
    assert isinstance(figure, Figure)
    figure.draw_without_rendering()


def test_a_figure_without_anything_to_draw_says_so(identification, diagnosis):
    nothing = dataclasses.replace(identification, modes=dataclasses.replace(identification.modes, modes=()))
    for name in ("modes", "assurance", "complexity"):
        with pytest.raises(InvalidDataError, match="no system mode"):
            getattr(plots, name)(nothing)
    with pytest.raises(InvalidDataError, match="found no effect"):
        plots.law(dataclasses.replace(diagnosis, laws=()))


def test_representations_of_results_are_short(identification, diagnosis):
    """Everything that a result holds, to any depth."""
    seen, queue = set(), [identification, diagnosis]
    while queue:
        one = queue.pop()
        if id(one) in seen:
            continue
        seen.add(id(one))
        if dataclasses.is_dataclass(one):
            if isinstance(one, Displayed):
                assert len(repr(one)) <= 2000
                assert repr(one).count("\n") < 20
                assert one._repr_html_().startswith("<table>")
            queue += [getattr(one, field.name) for field in dataclasses.fields(one)]
        elif isinstance(one, tuple):
            queue += list(one[:20])
    assert isinstance(identification, Displayed)
    assert isinstance(diagnosis, Displayed)
