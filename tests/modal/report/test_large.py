"""A large result stays a page that a browser opens at once."""

from dataclasses import replace

import numpy as np
import pytest
from large_result import N_MODES, N_OUTPUTS, make_large

from modal.geometry.sensors import Geometry, Sensor
from modal.report.machine import json_text
from modal.report.pages import html_text, markdown_text, moving_shapes
from modal.report.pictures import MOST_ASSURED, MOST_SHAPES, Setting, draw_pictures
from modal.sections.provenance import Provenance

BUDGET = 5_000_000
"""Bytes of the page of 60 outputs, 100 modes of the system and 30 records."""


@pytest.fixture(scope="module")
def large(make_result):
    return make_large(make_result())


@pytest.mark.slow
def test_the_page_stays_within_its_budget(large):
    pictures = draw_pictures(large)
    page = html_text(large, Provenance(), pictures)
    assert len(page.encode()) < BUDGET
    assert f"The first {MOST_SHAPES} of {N_MODES} modes." in pictures["shapes"].caption
    assert f"The first {MOST_ASSURED} of {N_MODES} modes." in pictures["assurance"].caption
    assert "are drawn, those of every second order or fewer" in pictures["stabilisation"].caption
    assert f"The 6 strongest of {4 * N_OUTPUTS} are shown" in pictures["responses"].caption
    assert page.count("other orders 1.00") == 2 * N_MODES  # the reason of every mode, once
    assert len(markdown_text(large, Provenance())) < 200_000


def test_the_numbers_of_sixty_channels_stay_below_a_megabyte(large):
    common = replace(large, records=large.records[:3], modes=replace(large.modes, modes=large.modes.modes[:60]))
    assert len(json_text(common, Provenance())) < 1_000_000


def test_a_mesh_of_many_nodes_moves_fewer_modes_than_a_small_structure(large):
    for n_nodes, n_modes in ((60, 24), (1200, 10)):
        geometry = Geometry(
            node_names=tuple(str(i) for i in range(n_nodes)),
            positions=np.column_stack([np.arange(n_nodes), np.arange(n_nodes) % 30, np.zeros(n_nodes)]),
            lines=tuple((i, i + 1) for i in range(n_nodes - 1)),
            sensors=tuple(
                Sensor(name=name, node=i, direction=[0, 0, 1]) for i, name in enumerate(large.records[0].output_names)
            ),
        )
        text = moving_shapes(large, Setting(geometry=geometry))
        assert text.count('"name"') == n_modes
        assert len(text) < 600_000


def test_a_small_result_leaves_nothing_out(make_result):
    small = make_result()
    several = replace(small, modes=replace(small.modes, modes=small.modes.modes[:3]))
    for picture in draw_pictures(several).values():
        assert "The first" not in picture.caption
        assert "are drawn, those of" not in picture.caption
        assert "strongest of" not in picture.caption
