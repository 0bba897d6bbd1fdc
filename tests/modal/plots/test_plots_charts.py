"""What a page's script reads off a figure must be what the figure shows."""

import json
import math
import re

import numpy as np
import pytest

from modal import plots
from modal.plots.layout import grid_of
from modal.plots.vector import MOST_VALUES, Notes, chart_text


def chart_of(figure, *, notes=None):
    svg = plots.svg_text(figure, name="a picture", description="words")
    return json.loads(chart_text(figure, "a picture", notes=notes)), svg


def panel_with(*lines, log=False):
    figure = grid_of(1, 1, size=(6, 4))
    panel = figure.panels[0]
    for x, y, label, style in lines:
        panel.line(x, y, "measured", label=label, **({"width": 0.0, "dot": 4.0} if style == "o" else {}))
    panel.y.log, panel.head = log, "a head"
    panel.x.label, panel.y.label = "frequency [Hz]", "model order"
    return figure, panel


@pytest.mark.parametrize("log", [False, True])
def test_a_place_in_the_picture_follows_from_box_and_limits(log):
    x, y = np.array([1.0, 4.0, 7.0]), np.array([0.1, 3.0, 20.0])
    figure, _ = panel_with((x, y, "line", "-"), log=log)
    chart, svg = chart_of(figure)
    drawn = re.search(r'id="a-picture-p0-s0"><path d="M([^"]*)"', svg)[1]
    places = [tuple(map(float, place.split())) for place in drawn.split("L")]
    panel = chart["panels"][0]
    left, top, width, height = panel["box"]
    for point, place in zip(zip(x, y, strict=True), places, strict=True):
        low, high = panel["y"]["limits"]
        share = math.log(point[1] / low) / math.log(high / low) if log else (point[1] - low) / (high - low)
        across = (point[0] - panel["x"]["limits"][0]) / np.ptp(panel["x"]["limits"])
        assert left + across * width == pytest.approx(place[0], abs=0.05)
        assert top + (1 - share) * height == pytest.approx(place[1], abs=0.05)
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
    figure, panel = panel_with(([0, 1], [0, 1], "measured", "-"))
    panel.line([0, 1], [1, 1], "measured", follows="measured")
    panel.upright(0.5, "system", label="a mark")
    panel.line([0, 1], [2, 2], "muted")
    series = chart_of(figure)[0]["panels"][0]["series"]
    assert [(one["name"], "y" in one) for one in series] == [("measured", True), ("measured", False), ("a mark", False)]


def test_notes_stand_beside_their_points():
    figure, _ = panel_with(([0, 1], [0, 1], "poles", "o"))
    notes = {"poles": Notes(columns=("damping [%]",), rows=((1.23456,), (math.nan,)))}
    series = chart_of(figure, notes=notes)[0]["panels"][0]["series"][0]
    assert (series["columns"], series["rows"]) == (["damping [%]"], [[1.2346], [None]])


def test_no_text_can_end_the_tag_around_it():
    bad = "</script><img src=x onerror=alert(1)>&\N{RIGHT-TO-LEFT OVERRIDE}"
    figure, panel = panel_with(([0, 1], [0, 1], bad, "-"))
    panel.head = bad
    plots.svg_text(figure, name="x", description="x")
    text = chart_text(figure, "x")
    assert not set("<>&") & set(text)
    assert text.isascii()
    assert json.loads(text)["panels"][0]["series"][0]["name"] == bad


def test_panels_that_are_not_seen_are_left_out():
    figure = grid_of(1, 3, size=(6, 2))
    figure.rows[0][0].line([0, 1], [0, 1], "measured", label="line")
    figure.rows[0][1] = None
    assert len(chart_of(figure)[0]["panels"]) == 1


def test_lines_of_one_style_become_one_path_and_all_their_points_stay():
    figure = grid_of(1, 1, size=(4, 3))
    panel = figure.panels[0]
    panel.frame = False
    panel.segments([[(0.1 * k, 0), (0.1 * k, 1)] for k in range(8)], "system", width=1.0)
    panel.segments([[(0, 0.5), (1, 0.6)]], "noise", width=1.0)
    corners = np.array([[(0.2 * k, 0), (0.2 * k + 0.1, 0), (0.2 * k, 1)] for k in range(3)])
    panel.polygons(corners, "model", opacity=1.0)
    panel.polygons(corners, "model", opacity=0.5)
    panel.dots([0, 1, 2], [0, 1, 0], "measured", dot=4.0)
    svg = plots.svg_text(figure, name="x", description="x")
    assert svg.count("<path") == 1 + 1 + 1 + 3 + 1  # faces that are seen through stay apart: they darken each other
    assert svg.count("M") == 8 + 1 + 3 + 3 + 3
