"""What a page's script reads off a figure must be what the figure shows."""

import json
import math

import numpy as np
import pytest

from modal import plots
from modal.plots.charts import MOST_VALUES, Notes, chart_text, tag_lines
from modal.plots.style import LIGHT, new_figure


def chart_of(figure, *, notes=None):
    tag_lines(figure, "a picture")
    svg = plots.svg_text(figure, name="a picture", description="words")
    return json.loads(chart_text(figure, "a picture", notes=notes)), svg


def panel_with(*lines, log=False, head="left"):
    figure, axes = new_figure(1, 1, size=(6, 4), theme=LIGHT)
    axis = axes[0][0]
    for x, y, label, style in lines:
        axis.plot(x, y, style, label=label, color=LIGHT.measured)
    if log:
        axis.set_yscale("log")
    axis.set_title("a head", loc=head)
    axis.set_xlabel("frequency [Hz]")
    axis.set_ylabel("model order")
    return figure, axis


@pytest.mark.parametrize("log", [False, True])
def test_a_place_in_the_picture_follows_from_box_and_limits(log):
    x, y = np.array([1.0, 4.0, 7.0]), np.array([0.1, 3.0, 20.0])
    figure, axis = panel_with((x, y, "line", "-"), log=log)
    chart, _ = chart_of(figure)
    panel = chart["panels"][0]
    left, top, width, height = panel["box"]
    for point in zip(x, y, strict=True):
        pixels = axis.transData.transform(point) * 72.0 / figure.dpi
        low, high = panel["y"]["limits"]
        share = math.log(point[1] / low) / math.log(high / low) if log else (point[1] - low) / (high - low)
        across = (point[0] - panel["x"]["limits"][0]) / np.ptp(panel["x"]["limits"])
        assert left + across * width == pytest.approx(pixels[0], abs=0.05)
        assert top + (1 - share) * height == pytest.approx(72.0 * 4 - pixels[1], abs=0.05)
    assert panel["y"]["log"] is log
    assert (panel["x"]["what"], panel["x"]["unit"], panel["y"]["unit"]) == ("frequency", "Hz", "")


def test_values_and_identities_are_those_of_the_lines():
    figure, _ = panel_with(([0, 1, 2], [3.0, math.nan, 5.123456789], "measured", "-"), ([0, 2], [1, 2], "poles", "o"))
    chart, svg = chart_of(figure)
    line, points = chart["panels"][0]["series"]
    assert line["y"] == [3, None, 5.1235]
    assert (line["points"], points["points"]) == (False, True)
    assert points["x"] == [0, 2]
    for series in (line, points):
        assert svg.count(f'id="{series["id"]}"') == 1


@pytest.mark.parametrize(("x", "even"), [(np.linspace(0.0, 9.0, 500), True), (np.geomspace(1.0, 9.0, 500), False)])
def test_an_even_grid_is_kept_short_and_comes_back(x, even):
    figure, _ = panel_with((x, x, "line", "-"))
    kept = chart_of(figure)[0]["panels"][0]["series"][0]["x"]
    assert isinstance(kept, dict) is even
    again = kept["from"] + kept["step"] * np.arange(kept["n"]) if even else np.array(kept)
    np.testing.assert_allclose(again, x, rtol=1e-4)


@pytest.mark.parametrize(("size", "step"), [(MOST_VALUES, 1), (MOST_VALUES + 1, 2)])
def test_a_long_line_is_thinned(size, step):
    figure, _ = panel_with((np.arange(size), np.arange(size), "line", "-"))
    assert chart_of(figure)[0]["panels"][0]["series"][0]["y"][1] == step


def test_what_has_no_values_is_still_hidden_with_its_line():
    figure, axis = panel_with(([0, 1], [0, 1], "measured", "-"), ([0, 1], [1, 1], "_with measured", "-"))
    axis.axvline(0.5, label="a mark", color=LIGHT.system)
    axis.plot([0, 1], [2, 2], color=LIGHT.muted)
    series = chart_of(figure)[0]["panels"][0]["series"]
    assert [(one["name"], "y" in one) for one in series] == [("measured", True), ("measured", False), ("a mark", False)]


def test_notes_stand_beside_their_points():
    figure, _ = panel_with(([0, 1], [0, 1], "poles", "o"))
    notes = {"poles": Notes(columns=("damping [%]",), rows=((1.23456,), (math.nan,)))}
    series = chart_of(figure, notes=notes)[0]["panels"][0]["series"][0]
    assert (series["columns"], series["rows"]) == (["damping [%]"], [[1.2346], [None]])


def test_no_text_can_end_the_tag_around_it():
    bad = "</script><img src=x onerror=alert(1)>&\N{RIGHT-TO-LEFT OVERRIDE}"
    figure, axis = panel_with(([0, 1], [0, 1], bad, "-"))
    axis.set_title(bad, loc="left")
    tag_lines(figure, "x")
    plots.svg_text(figure, name="x", description="x")
    text = chart_text(figure, "x")
    assert not set("<>&") & set(text)
    assert text.isascii()
    assert json.loads(text)["panels"][0]["series"][0]["name"] == bad


def test_panels_that_are_not_seen_are_left_out():
    figure, axes = new_figure(1, 3, size=(6, 2), theme=LIGHT)
    for axis in axes[0][:2]:
        axis.plot([0, 1], [0, 1], label="line")
    axes[0][1].set_visible(False)
    assert len(chart_of(figure)[0]["panels"]) == 1


def test_lines_of_one_style_become_one_path_and_all_their_points_stay():
    from matplotlib.collections import LineCollection, PolyCollection

    figure, axes = new_figure(1, 1, size=(4, 3), theme=LIGHT)
    axis = axes[0][0]
    axis.set_axis_off()
    axis.add_collection(LineCollection([[(0.1 * k, 0), (0.1 * k, 1)] for k in range(8)], colors=LIGHT.system))
    axis.add_collection(LineCollection([[(0, 0.5), (1, 0.6)]], colors=LIGHT.noise))
    squares = [[(0.2 * k, 0), (0.2 * k + 0.1, 0), (0.2 * k, 1)] for k in range(3)]
    axis.add_collection(PolyCollection(squares, facecolors=LIGHT.model, edgecolors="none"))
    svg = plots.svg_text(figure, name="x", description="x")
    assert svg.count("<path") == 1 + 1 + 3 + 1  # the eight, the one, three filled ones and the clip's or the ground's
    assert svg.count("M") >= 8 + 1 + 3
