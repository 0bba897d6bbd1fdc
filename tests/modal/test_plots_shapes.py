"""Shapes on a geometry as pictures: the same side for all, names that cover nothing, a bounded number of lines."""

import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.text import Annotation

from modal import plots
from modal.geometry import Geometry, Sensor
from modal.placement import placed
from modal.plots.structure import MOST_SEGMENTS
from modal.scene import scene_of
from okid.errors import InvalidDataError

NAMES = ("2X+", "3X+", "4Y-")
TOWER = Geometry(
    node_names=("1", "2", "3", "4"),
    positions=[[0, 0, 0], [0, 0, 1], [0, 0, 2], [0, 0, 3]],
    lines=((0, 1, 2, 3),),
    fixed=(0,),
)


@pytest.fixture(scope="module")
def modes(make_once):
    return make_once().modes.system


def deflected(figure, panel=0):
    """The lines of one panel, (n_lines, 2, 2) each: at rest, at one end of the motion, at the other."""
    found = [part for part in figure.axes[panel].collections if isinstance(part, LineCollection)]
    return [np.array(part.get_segments()) for part in found]


def test_a_shape_is_drawn_at_rest_and_at_both_ends(modes):
    figure = plots.mode_shapes(modes, output_names=NAMES, output_units=("m",) * 3, geometry=TOWER)
    scene = scene_of(placed(TOWER, NAMES, ("m",) * 3))
    for panel, mode in enumerate(modes):
        rest, below, above = deflected(figure, panel)
        moved = scene.positions + scene.motion(mode).real
        np.testing.assert_allclose(rest, scene.eye.seen(scene.positions)[scene.segments])
        np.testing.assert_allclose(above, scene.eye.seen(moved)[scene.segments])
        np.testing.assert_allclose(above + below, 2 * rest, atol=1e-9)
    limits = {(axis.get_xlim(), axis.get_ylim()) for axis in figure.axes if axis.get_visible()}
    assert len(limits) == 1
    ((left, right), (low, high)) = limits.pop()
    every = np.concatenate([part.reshape(-1, 2) for panel in range(len(modes)) for part in deflected(figure, panel)])
    assert left < every[:, 0].min() < every[:, 0].max() < right
    assert low < every[:, 1].min() < every[:, 1].max() < high


def test_without_geometry_the_sticks_remain_unless_names_state_nodes(modes):
    sticks = plots.mode_shapes(modes, output_names=("a", "b", "c"))
    assert [text.get_text() for text in sticks.axes[0].get_yticklabels()] == ["a", "b", "c"]
    assert len(deflected(plots.mode_shapes(modes, output_names=("1X+", "2X+", "2Y+")))) == 3


def test_a_geometry_that_fits_no_output_is_an_error(modes):
    with pytest.raises(InvalidDataError, match="has a place"):
        plots.mode_shapes(modes, output_names=("a", "b", "c"), geometry=TOWER)


@pytest.mark.parametrize("theme", [plots.LIGHT, plots.DARK], ids=["light", "dark"])
def test_every_colour_belongs_to_the_theme(modes, theme):
    surfaced = replace(TOWER, surfaces=((0, 1, 2),))
    for figure in (
        plots.mode_shapes(modes, output_names=NAMES, geometry=surfaced, theme=theme),
        plots.geometry_picture(surfaced, output_names=NAMES, theme=theme),
    ):
        if theme is plots.LIGHT:
            with plots.house_style():
                text = plots.svg_text(figure, name="shapes", description="shapes")
            assert not re.findall(r"(?:fill|stroke): (#[0-9a-f]{6})", text)
        else:
            assert figure.get_facecolor()[:3] == pytest.approx(
                [int(theme.paper[k : k + 2], 16) / 255 for k in (1, 3, 5)]
            )


def boxes_of(figure):
    figure.canvas.draw()
    return [text.get_window_extent().extents for text in figure.axes[0].texts if text.get_text()]


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


def test_every_node_of_a_small_structure_is_named_and_every_sensor_an_arrow():
    figure = plots.geometry_picture(TOWER, output_names=NAMES)
    words = {text.get_text() for text in figure.axes[0].texts}
    assert {"1", "2", "3", "4"} <= words
    arrows = [text for text in figure.axes[0].texts if isinstance(text, Annotation)]
    assert len(arrows) == 3
    own = replace(TOWER, sensors=(Sensor(name="top", node=3, direction=[1, 1, 0]),))
    assert len([one for one in plots.geometry_picture(own).axes[0].texts if isinstance(one, Annotation)]) == 1


def test_names_from_a_file_are_harmless_in_a_picture():
    hostile = Geometry(node_names=("<script>", "$x$" * 40, "\u202egnp"), positions=np.eye(3))
    with plots.house_style():
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
    assert all(len(part) <= MOST_SEGMENTS for part in deflected(figure))


def test_a_mast_is_drawn_no_taller_than_a_page_shows_it():
    """Its names would shrink beyond reading; and still the whole of it is in the picture."""
    mast = Geometry(
        node_names=("foot", "top"),
        positions=np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 9.0]]),
        lines=((0, 1),),
        sensors=(Sensor(name="tip", node=1, direction=[1, 0, 0]),),
    )
    figure = plots.geometry_picture(mast)
    assert figure.get_size_inches()[1] <= 4.2
    (axis,) = figure.axes
    bottom, top = axis.get_ylim()
    for line in axis.lines:
        assert bottom <= np.min(line.get_ydata()) <= np.max(line.get_ydata()) <= top
    assert [text.get_text() for text in axis.texts if text.get_text()] == ["foot", "top"]
