"""Shapes on a geometry as pictures: the same side for all, names that cover nothing, a bounded number of lines."""

import re
from dataclasses import replace

import numpy as np
import pytest

from modal import plots
from modal.geometry.placement import placed
from modal.geometry.scene import scene_of
from modal.geometry.sensors import Geometry, Sensor
from modal.plots.panels import Segments, text_width
from modal.plots.shapes import ShapeLimits
from okid.errors import InvalidDataError

NAMES = ("2X+", "3X+", "4Y-")
TOWER = Geometry(
    node_names=("1", "2", "3", "4"),
    positions=[[0, 0, 0], [0, 0, 1], [0, 0, 2], [0, 0, 3]],
    lines=((0, 1, 2, 3),),
    fixed=(0,),
)


@pytest.fixture(scope="module")
def modes(make_result):
    return make_result().modes.system


def deflected(figure, panel=0):
    """The lines of one panel, (n_lines, 2, 2) each: at rest, at one end of the motion, at the other."""
    return [mark.ends for mark in figure.panels[panel].marks if isinstance(mark, Segments)]


def test_a_shape_is_drawn_at_rest_and_at_both_ends(modes):
    figure = plots.mode_shapes(modes, output_names=NAMES, output_units=("m",) * 3, geometry=TOWER)
    scene = scene_of(placed(TOWER, NAMES, ("m",) * 3))
    for panel, mode in enumerate(modes):
        rest, below, above = deflected(figure, panel)
        moved = scene.positions + scene.motion(mode).real
        np.testing.assert_allclose(rest, scene.eye.seen(scene.positions)[scene.segments])
        np.testing.assert_allclose(above, scene.eye.seen(moved)[scene.segments])
        np.testing.assert_allclose(above + below, 2 * rest, atol=1e-9)
    limits = {(panel.x.limits, panel.y.limits) for panel in figure.panels}
    assert len(limits) == 1
    ((left, right), (low, high)) = limits.pop()
    every = np.concatenate([part.reshape(-1, 2) for panel in range(len(modes)) for part in deflected(figure, panel)])
    assert left < every[:, 0].min() < every[:, 0].max() < right
    assert low < every[:, 1].min() < every[:, 1].max() < high


def test_without_geometry_the_sticks_remain_unless_names_state_nodes(modes):
    sticks = plots.mode_shapes(modes, output_names=("a", "b", "c"))
    assert [text for _, text in sticks.panels[0].y_ticks()] == ["a", "b", "c"]
    assert len(deflected(plots.mode_shapes(modes, output_names=("1X+", "2X+", "2Y+")))) == 3


def test_a_geometry_that_fits_no_output_is_an_error(modes):
    with pytest.raises(InvalidDataError, match="has a place"):
        plots.mode_shapes(modes, output_names=("a", "b", "c"), geometry=TOWER)


def test_every_colour_belongs_to_the_page(modes):
    surfaced = replace(TOWER, surfaces=((0, 1, 2),))
    for figure in (
        plots.mode_shapes(modes, output_names=NAMES, geometry=surfaced),
        plots.geometry_picture(surfaced, output_names=NAMES),
    ):
        text = plots.svg_text(figure, name="shapes", description="shapes")
        assert "fill: var(--" in text
        assert not re.findall(r"(?:fill|stroke): (#[0-9a-f]{6})", text)


def boxes_of(figure):
    """(left, top, right, bottom) of the names in the figure, as wide as they are taken to be."""
    figure.arrange()
    panel, boxes = figure.panels[0], []
    for word in panel.words:
        x, y = panel.place(np.array([word.x, word.y]))
        half = text_width(word.text, word.size) / 2
        boxes.append((x - half, y - word.size / 2, x + half, y + word.size / 2))
    return boxes


def test_names_of_nodes_cover_neither_nodes_nor_each_other():
    n = 7
    positions = [[x, y, 0.0] for x in range(n) for y in range(n)]
    geometry = Geometry(node_names=tuple(f"node {k}" for k in range(n * n)), positions=positions)
    figure = plots.geometry_picture(geometry)
    boxes = np.array(boxes_of(figure))
    assert 10 < len(boxes) <= n * n
    low, high = boxes[:, :2], boxes[:, 2:]
    crossing = (low[:, None] < high[None]).all(axis=2) & (low[None] < high[:, None]).all(axis=2)
    assert crossing.sum() == len(boxes)  # each with itself alone


def n_arrows(figure):
    return sum(len(mark.ends) for mark in figure.panels[0].marks if isinstance(mark, Segments) and mark.arrows)


def test_every_node_of_a_small_structure_is_named_and_every_sensor_an_arrow():
    figure = plots.geometry_picture(TOWER, output_names=NAMES)
    assert {word.text for word in figure.panels[0].words} == {"1", "2", "3", "4"}
    assert n_arrows(figure) == 3
    own = replace(TOWER, sensors=(Sensor(name="top", node=3, direction=[1, 1, 0]),))
    assert n_arrows(plots.geometry_picture(own)) == 1


def test_names_from_a_file_are_harmless_in_a_picture():
    hostile = Geometry(node_names=("<script>", "$x$" * 40, "\u202egnp"), positions=np.eye(3))
    text = plots.svg_text(plots.geometry_picture(hostile), name="g", description="g")
    assert "<script" not in text
    assert "\u202e" not in text


def test_of_thousands_of_lines_a_bounded_number_is_drawn(modes):
    n = 9000
    many = Geometry(
        node_names=tuple(str(k) for k in range(n)),
        positions=np.column_stack([np.arange(n), np.arange(n) % 7, np.zeros(n)]),
        lines=(tuple(range(n)),),
    )
    figure = plots.mode_shapes(modes[:1], output_names=("5Z+", "6Z+", "800Z+"), geometry=many)
    assert all(len(part) <= ShapeLimits.MOST_SEGMENTS for part in deflected(figure))


def test_a_mast_is_drawn_no_taller_than_a_page_shows_it():
    """Its names would shrink beyond reading; and still the whole of it is in the picture."""
    mast = Geometry(
        node_names=("foot", "top"),
        positions=np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 9.0]]),
        lines=((0, 1),),
        sensors=(Sensor(name="tip", node=1, direction=[1, 0, 0]),),
    )
    figure = plots.geometry_picture(mast)
    assert figure.height <= 4.2 * 72
    (panel,) = figure.panels
    bottom, top = panel.y.limits
    for line in panel.lines:
        assert bottom <= np.min(line.y) <= np.max(line.y) <= top
    assert [word.text for word in panel.words] == ["foot", "top"]
