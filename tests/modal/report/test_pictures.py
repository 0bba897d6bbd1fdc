"""The words under the pictures: each follows from what is drawn."""

from dataclasses import replace

import numpy as np
import pytest

from modal.geometry.sensors import Geometry, Sensor
from modal.report.pictures import Setting, _geometry_picture, _mode_pictures, _n_drawn, _order_pictures, draw_pictures


@pytest.fixture
def mast():
    return Geometry(
        node_names=("0", "1", "2", "3"),
        positions=[[0.0, 0.0, k] for k in range(4)],
        lines=((0, 1, 2, 3),),
        sensors=tuple(Sensor(name=f"floor_{k}", node=k, direction=[1, 0, 0]) for k in (1, 2, 3)),
    )


def captions(pictures):
    return {name: picture.caption for name, picture in pictures.items()}


@pytest.mark.parametrize(("known", "said"), [(True, "halves of the data"), (False, "next lower order")])
def test_the_colours_of_the_poles_are_explained(identification, known, said):
    evidence = identification.order_evidence
    points = tuple(replace(one, repeatability=0.5 if known else np.nan) for one in evidence.stabilisation)
    result = replace(identification, order_evidence=replace(evidence, stabilisation=points))
    assert said in captions(_order_pictures(result))["stabilisation"]


def test_shapes_stand_on_a_geometry_or_in_the_order_of_the_record(identification, mast):
    alone = captions(_mode_pictures(identification, Setting()))["shapes"]
    placed = captions(_mode_pictures(identification, Setting(geometry=mast)))["shapes"]
    assert "without the geometry of the structure" in alone
    assert "on the geometry" in placed
    assert "without the geometry" not in placed


def test_the_structure_is_drawn_where_it_is_known(identification, mast):
    assert _geometry_picture(identification, Setting()) == {}
    picture = _geometry_picture(identification, Setting(geometry=mast))["geometry"]
    assert picture.svg.startswith("<svg")
    assert picture.chart == ""


def test_fewer_shapes_are_drawn_of_a_mesh(mast, monkeypatch):
    assert _n_drawn(Setting()) == _n_drawn(Setting(geometry=mast)) == 12
    monkeypatch.setattr("modal.report.pictures.MOST_PIECES", 20)
    assert _n_drawn(Setting(geometry=mast)) == 5
    monkeypatch.setattr("modal.report.pictures.MOST_PIECES", 1)
    assert _n_drawn(Setting(geometry=mast)) == 2


@pytest.mark.parametrize(
    ("fits", "said"),
    [([0.5, 0.9, 0.9], ""), ([0.5, np.nan, 0.9], " Tried too, but unstable: 4.")],
)
def test_an_order_that_was_not_tried_is_not_called_unstable(identification, fits, said):
    evidence = replace(
        identification.order_evidence, candidate_orders=np.array([2.0, 4.0, 12.0]), candidate_fits=np.array(fits)
    )
    caption = captions(_order_pictures(replace(identification, order_evidence=evidence)))["order_fits"]
    assert caption == f"Cross-validated fit against model order, a point for each order that was tried.{said}"


def test_a_pole_at_rest_does_not_stop_the_page(identification):
    """An integrator is a mode of the system with a frequency of 0: no ten periods of it fit any record."""
    modes = identification.modes
    still = replace(modes.modes[0], pole=0j, kind="real", frequency=0.0, damping_ratio=np.nan, verdict="system")
    for several in ((still,), (still, *modes.modes[1:])):
        result = replace(identification, modes=replace(modes, modes=several))
        assert "histories" in draw_pictures(result)
