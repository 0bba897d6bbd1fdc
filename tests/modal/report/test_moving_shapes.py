import json

import numpy as np
import pytest

from modal.geometry.sensors import Geometry, Sensor
from modal.report import pages as module
from modal.report.pages import SWING, moving_shapes
from modal.report.pictures import Setting


@pytest.fixture
def tower():
    """Four nodes on a mast 6 m high, each floor's sensor along Y."""
    return Geometry(
        node_names=("0", "1", "2", "3"),
        positions=[[1.0, 1.0, 2.0 * k] for k in range(4)],
        lines=((0, 1, 2, 3),),
        sensors=tuple(Sensor(name=f"floor_{k}", node=k, direction=[0, 1, 0]) for k in (1, 2, 3)),
        fixed=(0,),
    )


def test_nodes_and_deflections_are_those_of_the_geometry(identification, tower):
    document = json.loads(moving_shapes(identification, Setting(geometry=tower)))
    nodes = np.array(document["nodes"])
    np.testing.assert_allclose(nodes[:, 2], [-0.5, -1 / 6, 1 / 6, 0.5], atol=1e-4)
    assert document["lines"] == [[0, 1, 2, 3]]
    assert [mode["name"] for mode in document["modes"]] == ["3.67 Hz", "11.1 Hz", "16.6 Hz"]
    for number, mode in enumerate(document["modes"]):
        moved = np.array(mode["real"]) + 1j * np.array(mode["imaginary"])
        shape = identification.modes.system[number].shape
        np.testing.assert_allclose(moved[:, [0, 2]], 0, atol=1e-4)
        np.testing.assert_allclose(np.abs(moved[1:, 1]), SWING * np.abs(shape) / np.abs(shape).max(), atol=2e-4)
        assert not moved[0].any()


def test_sticks_are_seen_from_the_side_and_a_geometry_obliquely(identification, tower):
    assert json.loads(moving_shapes(identification, Setting()))["home"] == [0.0, 0.0]
    assert json.loads(moving_shapes(identification, Setting(geometry=tower)))["home"] == list(module.OBLIQUE)


def test_large_structures_have_fewer_modes_and_then_none(identification, tower, monkeypatch):
    monkeypatch.setattr(module, "MOST_DEFLECTIONS", 8)
    assert len(json.loads(moving_shapes(identification, Setting(geometry=tower)))["modes"]) == 2
    monkeypatch.setattr(module, "MOST_NODES", 3)
    assert moving_shapes(identification, Setting(geometry=tower)) == ""


def test_without_a_mode_nothing_moves(make_result):
    result = make_result()
    from dataclasses import replace

    assert moving_shapes(replace(result, modes=replace(result.modes, modes=result.modes.modes[3:])), Setting()) == ""
