"""A chart in a view of Rerun: every mark at its place, cut at the frame, its words readable and harmless."""

import numpy as np
import pytest
import rerun as rr

from modal.plots.chart import Key, grid_of
from modal.recording.figure import Pane, log_chart, role_colour, seen_at

PANE = Pane("page/plot", 600.0, 400.0)


@pytest.fixture
def drawn(tmp_path, read):
    """Draw a chart, and read the file back."""

    def draw(chart):
        stream = rr.RecordingStream("test", recording_id="chart")
        stream.save(tmp_path / "chart.rrd")
        log_chart(stream, PANE, chart)
        stream.disconnect()
        return read(tmp_path / "chart.rrd")

    return draw


@pytest.fixture
def chart():
    made = grid_of(1, 1, size=(1.0, 1.0))
    (panel,) = made.panels
    panel.x.limits, panel.y.limits = (0.0, 10.0), (1.0, 100.0)
    panel.y.log, panel.y.label, panel.x.label = True, "size [m]", "time [s]"
    return made


def strips(stored, name):
    return [np.array(strip) for strip in stored.static(f"/page/plot/{name}", "LineStrips2D:strips")]


def test_a_line_breaks_at_nan_and_ends_at_the_frame(chart, drawn):
    (panel,) = chart.panels
    panel.line([0, 1, 2, 3, 4, 5, 6, 20, 30], [2, 3, np.nan, 5, 9, 1e5, 1e6, 50, 60], "measured", label="A line")
    found = strips(drawn(chart), "a_line")
    assert [len(strip) for strip in found] == [2, 3]
    np.testing.assert_allclose(found[0], seen_at(panel, [0, 1], [2, 3]), rtol=1e-6)
    np.testing.assert_allclose(found[1][-1], seen_at(panel, 5, 100), rtol=1e-6)


def test_a_line_across_spans_the_frame_and_equal_labels_stay_apart(chart, drawn):
    (panel,) = chart.panels
    panel.across(10.0, "model", label="mark")
    panel.upright(5.0, "model", label="mark")
    stored = drawn(chart)
    (across,), (upright,) = strips(stored, "0_mark"), strips(stored, "1_mark")
    np.testing.assert_allclose(across, seen_at(panel, [0, 10], [10, 10]), rtol=1e-6)
    np.testing.assert_allclose(upright, seen_at(panel, [5, 5], [1, 100]), rtol=1e-6)


def test_a_dot_outside_is_left_out_and_one_inside_says_its_numbers(chart, drawn):
    chart.panels[0].dots([1.0, 11.0, np.nan], [10.0, 10.0, 10.0], "system", dot=4.0, label="dots")
    stored = drawn(chart)
    assert stored.static("/page/plot/dots", "Points2D:labels") == ["time 1: size 10"]


def test_an_opaque_box_is_strokes_side_by_side_and_a_pale_one_a_rim(chart, drawn):
    (panel,) = chart.panels
    panel.box_of((0.0, 5.0), (2.0, 20.0), "system", label="bar")
    panel.box_of((0.0, 5.0), (2.0, 20.0), "system", opacity=0.2, label="band")
    stored = drawn(chart)
    corners = seen_at(panel, [0.0, 5.0], [2.0, 20.0])
    strokes, radii = np.array(strips(stored, "bar")), np.array(stored.static("/page/plot/bar", "LineStrips2D:radii"))
    assert 2 * radii.sum() == pytest.approx(np.ptp(corners[:, 1]), rel=1e-6)
    lows, highs = strokes.min(axis=1) - radii[:, np.newaxis], strokes.max(axis=1) + radii[:, np.newaxis]
    np.testing.assert_allclose(lows.min(axis=0), corners.min(axis=0), rtol=1e-6)
    np.testing.assert_allclose(highs.max(axis=0), corners.max(axis=0), rtol=1e-6)
    (rim,) = strips(stored, "band")
    np.testing.assert_allclose(rim[0], rim[-1])


def test_all_words_lie_in_the_pane_and_a_long_key_says_how_many_more(chart, drawn):
    (panel,) = chart.panels
    for number in range(40):
        panel.line([0, 10], [2 + number, 3 + number], "measured", label=f"channel {number:02d}")
    chart.key = Key(panel=panel)
    stored = drawn(chart)
    texts = stored.static("/page/plot/words", "Points2D:labels")
    places = np.array(stored.static("/page/plot/words", "Points2D:positions"))
    assert {"size [m]", "time [s]", "1", "10", "100", "channel 00"} <= set(texts)
    n_named = sum(text.startswith("channel") for text in texts)
    assert f"{40 - n_named} more" in texts
    assert places.min() >= -20.0
    assert (places.max(axis=0) <= (PANE.width, PANE.height)).all()


def test_long_words_of_rows_stand_inside_and_no_letter_stops_the_viewer(chart, drawn):
    (panel,) = chart.panels
    panel.y.log, panel.y.limits = False, (1.5, -0.5)
    panel.y.ticks = [(0.0, "a very long name of what was tried, and where"), (1.0, "\N{ARABIC LETTER ALEF}")]
    stored = drawn(chart)
    texts = stored.static("/page/plot/words", "Points2D:labels")
    places = np.array(stored.static("/page/plot/words", "Points2D:positions"))
    assert places[texts.index(panel.y.ticks[0][1])][0] > panel.box[0]
    assert "\N{WHITE SQUARE}" in texts


def test_several_panels_are_apart():
    with rr.RecordingStream("test") as stream:
        several = grid_of(2, 1, size=(1.0, 1.0))
        log_chart(stream, PANE, several)
    upper, lower = (panel.box for panel in several.panels)
    assert upper[1] + upper[3] < lower[1]


def test_what_shines_through_lies_between_the_colour_and_the_ground():
    pale, full = np.array(role_colour("system", 0.3)), np.array(role_colour("system"))
    assert (pale < full).all()
