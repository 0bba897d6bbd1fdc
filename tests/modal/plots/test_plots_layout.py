"""Where panels, ticks and keys lie: inside the chart, beside each other, at round values."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from modal.plots.histories import frequencies_in_time, places_of_records
from modal.plots.layout import Key, grid_of, row_of
from modal.plots.panels import Panel, text_width, ticks_between
from modal.plots.vector import page_of, svg_text


def filled(n_rows, n_columns):
    chart = grid_of(n_rows, n_columns, size=(8, 5))
    for number, panel in enumerate(chart.panels):
        panel.line([0.0, 1.0], [-(10.0**number), 10.0**number], "measured", label="a line")
        panel.head, panel.x.label, panel.y.label = "head", "time [s]", "force [N]"
    chart.key = Key(panel=chart.panels[0])
    chart.title = "all of them"
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
    chart = frequencies_in_time(tracks, [31.0], clock=False)
    chart.arrange()
    above, below = chart.panels
    assert above.x.limits == below.x.limits
    assert above.place(np.array([31.0, 2.0]))[0] == pytest.approx(below.place(np.array([31.0, 0.0]))[0])
    assert chart.key is not None  # outside: no key hides a dot
    assert above.key is None
