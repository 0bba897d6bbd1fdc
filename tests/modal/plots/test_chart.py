"""Where panels, ticks and keys lie: inside the chart, beside each other, at round values."""

import json
import math
import re
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from modal import plots
from modal.plots.chart import MOST_VALUES, Key, Notes, chart_text, grid_of, page_of, row_of, svg_text
from modal.plots.histories import frequencies_in_time, places_of_records
from modal.plots.panels import Panel, text_width, ticks_between


def filled(n_rows, n_columns):
    chart = grid_of(n_rows, n_columns, size=(8, 5))
    for number, panel in enumerate(chart.panels):
        panel.line([0.0, 1.0], [-(10.0**number), 10.0**number], "measured", label="a line")
        panel.head, panel.x.label, panel.y.label = "head", "time [s]", "force [N]"
    chart.key = Key(panel=chart.panels[0])
    return chart


@pytest.mark.parametrize(("n_rows", "n_columns"), [(1, 1), (3, 2), (2, 4)])
def test_panels_lie_within_the_chart_and_beside_each_other(n_rows, n_columns):
    chart = filled(n_rows, n_columns)
    chart.arrange()
    boxes = np.array([panel.box for panel in chart.panels])
    low, high = boxes[:, :2], boxes[:, :2] + boxes[:, 2:]
    assert (low > 0).all()
    assert (high < [chart.width, chart.height]).all()
    assert (boxes[:, 2:] > 20).all()
    crossing = (low[:, None] < high[None]).all(axis=2) & (low[None] < high[:, None]).all(axis=2)
    assert crossing.sum() == len(boxes)  # each with itself alone


def test_arranging_again_changes_nothing():
    chart = filled(2, 3)
    assert svg_text(chart, name="x", description="x") == svg_text(chart, name="x", description="x")


def test_no_words_leave_the_chart():
    chart = filled(2, 2)
    svg = svg_text(chart, name="x", description="x")
    pattern = r'<text x="([\d.-]+)" y="([\d.-]+)" style="font-size: ([\d.]+)px[^"]*?(middle|end|)">([^<]*)'
    upright = re.findall(pattern, svg)
    assert len(upright) > 20
    for x, y, size, anchor, words in upright:
        width = text_width(words, float(size))
        left = float(x) - {"middle": 0.5, "end": 1.0, "": 0.0}[anchor] * width
        assert left >= -0.5
        assert left + width <= chart.width + 0.5
        assert float(size) / 2 <= float(y) <= chart.height


@given(low=st.floats(-1e6, 1e6), span=st.floats(1e-3, 1e6), most=st.integers(2, 9))
def test_ticks_are_even_inside_and_read_as_they_stand(low, span, most):
    ticks = ticks_between(low, low + span, most=most)
    values = np.array([value for value, _ in ticks])
    room = 1e-6 * (abs(low) + span)
    assert len(ticks) <= most + 1
    assert ((values >= low - room) & (values <= low + span + room)).all()
    if len(ticks) > 2:
        np.testing.assert_allclose(np.diff(values), values[1] - values[0], rtol=1e-6)
    for value, text in ticks:
        assert float(read(text)) == pytest.approx(value, abs=0.51 * 10 ** -decimals(text) * scale(text))
    assert len({text for _, text in ticks}) == len(ticks)


SUPERSCRIPTS = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")


def read(text):
    return text.replace("−", "-").replace("·10", "e").translate(SUPERSCRIPTS)


def decimals(text):
    return len(text.partition("·")[0].partition(".")[2])


def scale(text):
    return 10.0 ** int(text.partition("·10")[2].translate(SUPERSCRIPTS) or 0)


@pytest.mark.parametrize(
    ("low", "high", "texts"),
    [
        (1e-7, 1e3, ["10⁻⁷", "10⁻⁴", "10⁻¹", "10²"]),
        (0.2, 3.0, ["0.2", "0.5", "1", "2"]),
        (1.1, 1.4, ["1.1", "1.2", "1.3", "1.4"]),
    ],
)
def test_ticks_of_a_logarithmic_axis(low, high, texts):
    assert [text for _, text in ticks_between(low, high, most=4, log=True)] == texts


@pytest.mark.parametrize("log", [False, True])
def test_an_axis_without_values_or_with_one_has_a_range(log):
    for values in ([], [np.nan], [3.0], [0.0]):
        panel = Panel()
        panel.y.log = log
        panel.line(values, values, "measured")
        panel.fix_limits()
        low, high = panel.y.limits
        assert np.isfinite([low, high]).all()
        assert low < high


def test_what_is_not_finite_breaks_a_line_and_an_area():
    chart = grid_of(1, 1, size=(4, 3))
    panel = chart.panels[0]
    panel.line([0, 1, 2, 3, 4], [0, 1, np.nan, 1, 0], "measured", label="a")
    panel.area([0, 1, 2, 3, 4], 0.0, [1, 1, np.nan, 1, 1], "model", opacity=0.5)
    svg = svg_text(chart, name="x", description="x")
    assert re.search(r'id="x-p0-s0"><path d="([^"]*)"', svg)[1].count("M") == 2
    assert svg.count("fill-opacity: 0.5") == 2
    assert "nan" not in svg


def test_panels_that_are_not_needed_are_left_out():
    chart = row_of(4, most_columns=3, width=9, height=2)
    assert len(chart.panels) == 4
    assert [sum(panel is not None for panel in row) for row in chart.rows] == [3, 1]


def test_a_picture_is_a_file_of_its_own_with_a_name_space():
    text = page_of(svg_text(filled(1, 1), name="x", description="x"))
    assert text.startswith('<svg xmlns="http://www.w3.org/2000/svg"')
    assert text.endswith("</svg>\n")


def test_records_that_failed_keep_their_numbers_and_the_panels_of_tracks_share_their_axis():
    places, along = places_of_records(np.zeros(3), [1, 2, 4])
    assert (places.tolist(), along) == ([1.0, 2.0, 4.0], "record")
    times = np.arange(1.0, 41.0)
    tracks = [SimpleNamespace(frequency=f + 0 * times, times=times, left=0.01 * times) for f in (2.0, 5.0)]
    chart = frequencies_in_time(tracks, [(31.0, np.array([-0.01, np.nan]))], clock=False)
    chart.arrange()
    above, below = chart.panels
    assert above.x.limits == below.x.limits
    assert above.place(np.array([31.0, 2.0]))[0] == pytest.approx(below.place(np.array([31.0, 0.0]))[0])
    levels = [mark.y for mark in below.marks if len(mark.y) == 2 and np.isfinite(mark.y).all()]
    np.testing.assert_allclose(levels, 100 * np.log1p([[0.0] * 2, [-0.01] * 2, [0.0] * 2, [0.0] * 2]))
    assert chart.key is not None  # outside: no key hides a dot
    assert above.key is None


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
