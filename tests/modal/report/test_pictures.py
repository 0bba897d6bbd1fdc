"""The words under the pictures: each follows from what is drawn."""

from dataclasses import replace

import numpy as np
import pytest

from modal.geometry.sensors import Geometry, Sensor
from modal.report.pictures import Setting, draw_pictures


@pytest.fixture
def mast():
    return Geometry(
        node_names=("0", "1", "2", "3"),
        positions=[[0.0, 0.0, k] for k in range(4)],
        lines=((0, 1, 2, 3),),
        sensors=tuple(Sensor(name=f"floor_{k}", node=k, direction=[1, 0, 0]) for k in (1, 2, 3)),
    )


def test_shapes_stand_on_the_geometry_where_there_is_one(identification, mast):
    alone, placed = draw_pictures(identification), draw_pictures(identification, Setting(geometry=mast))
    assert "without the geometry of the structure" in alone["shapes"].caption
    assert "on the geometry" in placed["shapes"].caption
    assert "geometry" not in alone
    assert placed["geometry"].svg.startswith("<svg")


@pytest.mark.parametrize(
    ("fits", "said"), [([0.5, 0.9, 0.9], ""), ([0.5, np.nan, 0.9], " Tried too, but unstable: 4.")]
)
def test_an_order_that_was_not_tried_is_not_called_unstable(identification, fits, said):
    evidence = replace(
        identification.order_evidence, candidate_orders=np.array([2.0, 4.0, 12.0]), candidate_fits=np.array(fits)
    )
    pictures = draw_pictures(replace(identification, order_evidence=evidence))
    assert (
        pictures["order_fits"].caption
        == f"Cross-validated fit against model order, a point for each order that was tried.{said}"
    )


def test_a_pole_at_rest_does_not_stop_the_page(identification):
    """An integrator is a mode of the system with a frequency of 0: no ten periods of it fit any record."""
    modes = identification.modes
    still = replace(modes.modes[0], pole=0j, kind="real", frequency=0.0, damping_ratio=np.nan, verdict="system")
    for several in ((still,), (still, *modes.modes[1:])):
        result = replace(identification, modes=replace(modes, modes=several))
        assert "histories" in draw_pictures(result)
