"""The pictures of a page: their words follow from what is drawn, and a large result stays a page that opens at once."""

import json
from dataclasses import replace

import numpy as np
import pytest
from large_result import N_MODES, N_OUTPUTS, make_large

from era.realisation import Realisation
from modal.acceptance.test_file import AcceptanceLimit, Specification
from modal.geometry.sensors import Geometry, Sensor
from modal.modes.extraction import extract_modes
from modal.modes.response_synthesis import frf, measured_frf
from modal.plots.responses import model_grid
from modal.plots.results import synthesised_alone
from modal.report import pages, pictures
from modal.report.machine import json_text
from modal.report.pages import SWING, html_text, markdown_text, moving_shapes
from modal.report.pictures import PictureLimits, Setting, draw_pictures, response_pictures, setting_of
from modal.sections.validation import Provenance


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


def test_shapes_stand_on_the_geometry_where_there_is_one(identification, tower):
    alone, placed = draw_pictures(identification), draw_pictures(identification, Setting(geometry=tower))
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


def sensors_of_a_mast(height):
    return Geometry(
        node_names=("1", "2"),
        positions=[[0, 0, 0], [0, 0, height]],
        sensors=(Sensor(name="floor_1", node=1, direction=[1, 0, 0]),),
    )


def test_the_geometry_given_comes_before_that_of_the_test_file(identification):
    own, other = sensors_of_a_mast(1.0), sensors_of_a_mast(2.0)
    specification = Specification(geometry=own)
    quality = object()
    assert setting_of(identification, quality=quality).geometry is None
    assert setting_of(identification, specification=specification, quality=quality).geometry is own
    assert setting_of(identification, specification=specification, geometry=other, quality=quality).geometry is other


def test_the_data_are_looked_at_unless_somebody_has(identification, monkeypatch):
    quality = object()
    given = setting_of(identification, quality=quality)
    assert (given.quality, given.quality_of) == (quality, "as read")
    monkeypatch.setattr("modal.report.pictures.check_quality", lambda records, choices: (records, choices))
    found = setting_of(identification)
    assert found.quality == (identification.records, identification.choices)
    assert found.quality_of == "as used"


@pytest.mark.parametrize(("least", "state"), [(0.5, "met"), (0.999, "not met")])
def test_limits_are_weighed(identification, least, state):
    limits = (AcceptanceLimit(kind="fit", name="fit", at_least=least),)
    weighed = setting_of(identification, specification=Specification(limits=limits), quality=object())
    assert [one.state for one in weighed.outcomes] == [state]
    assert setting_of(identification, quality=object()).outcomes == ()
    assert pictures.NOTHING_BESIDES.outcomes == ()


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
    assert json.loads(moving_shapes(identification, Setting(geometry=tower)))["home"] == list(pages.OBLIQUE)


def test_large_structures_have_fewer_modes_and_then_none(identification, tower, monkeypatch):
    monkeypatch.setattr(pages.PageLimits, "MOST_DEFLECTIONS", 8)
    assert len(json.loads(moving_shapes(identification, Setting(geometry=tower)))["modes"]) == 2
    monkeypatch.setattr(pages.PageLimits, "MOST_NODES", 3)
    assert moving_shapes(identification, Setting(geometry=tower)) == ""


def test_without_a_mode_nothing_moves(make_result):
    result = make_result()
    from dataclasses import replace

    assert moving_shapes(replace(result, modes=replace(result.modes, modes=result.modes.modes[3:])), Setting()) == ""


@pytest.fixture
def believed(identification):
    """The hand-made model with its own modes, all of them believed."""
    model = extract_modes(identification.realisation)
    modes = tuple(replace(mode, verdict="system") for mode in model)
    return replace(identification, modes=replace(model, modes=modes))


def test_all_modes_together_are_the_model(believed):
    measured = measured_frf(believed.records)
    alone = synthesised_alone(believed, measured)
    np.testing.assert_allclose(alone, frf(believed.realisation, model_grid(measured)), atol=1e-10)


def test_a_mode_that_is_not_believed_is_left_out(believed):
    measured = measured_frf(believed.records)
    first, *others = believed.modes.modes
    doubted = replace(believed, modes=replace(believed.modes, modes=(replace(first, verdict="doubtful"), *others)))
    grid = model_grid(measured)
    lost = np.abs(frf(believed.realisation, grid) - synthesised_alone(doubted, measured))[:, 0, 0]
    assert grid[np.argmax(lost)] == pytest.approx(first.frequency, abs=0.1)


def test_nothing_is_synthesised_where_it_would_not_compare(believed):
    measured = measured_frf(believed.records)
    none = replace(believed, modes=replace(believed.modes, modes=()))
    assert synthesised_alone(none, measured) is None
    whole = believed.realisation
    part = Realisation(whole.A[:4, :4], whole.B[:4], whole.C[:, :4], whole.D, whole.dt)
    cut = replace(believed, fitted_model=part)  # the rest stands for delays
    assert synthesised_alone(cut, measured) is None
    same = replace(believed, fitted_model=believed.realisation)
    assert synthesised_alone(same, measured) is not None


def test_the_words_follow_what_is_drawn(believed):
    picture = response_pictures(believed)["responses"]
    assert "Dashed: the modes of the system alone" in picture.caption
    assert "strongest of" not in picture.caption
    none = replace(believed, modes=replace(believed.modes, modes=()))
    assert "Dashed" not in response_pictures(none)["responses"].caption


def test_a_doubtful_pole_beyond_the_picture_is_not_spoken_of(believed):
    first, *rest = believed.modes.modes
    for frequency, drawn in ((first.frequency, True), (0.6 / believed.modes.dt, False)):
        doubtful = replace(first, verdict="doubtful", kind="oscillatory", frequency=frequency)
        modes = (doubtful, *(mode for mode in rest if mode.verdict != "doubtful"))
        picture = draw_pictures(replace(believed, modes=replace(believed.modes, modes=modes)))["overview"]
        assert ("Dashed" in picture.caption) == drawn


def test_only_the_strongest_pairs_of_many_are_drawn(believed, monkeypatch):
    monkeypatch.setattr("modal.plots.results.ResultLimits.MOST_SHOWN", 2)
    assert "The 2 strongest of 3 are shown." in response_pictures(believed)["responses"].caption


def test_records_that_are_too_short_have_no_picture(believed):
    record = believed.records[0]
    short = (replace(record, inputs=record.inputs[:10], outputs=record.outputs[:10]),)
    assert response_pictures(replace(believed, records=short)) == {}


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
    assert f"The first {PictureLimits.MOST_SHAPES} of {N_MODES} modes." in pictures["shapes"].caption
    assert f"The first {PictureLimits.MOST_ASSURED} of {N_MODES} modes." in pictures["assurance"].caption
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
