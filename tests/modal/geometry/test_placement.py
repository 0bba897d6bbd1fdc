"""Outputs on a geometry: quantities made comparable, and words for what is not drawn, said and not said."""

import numpy as np
import pytest

from modal.geometry.placement import derivatives_of, guessed_grid, placed, turned
from modal.geometry.sensors import Geometry, Sensor
from modal.modes.mode import Mode
from okid.errors import InvalidDataError

POLE = complex(-0.7, 31.0)


def tower(**changes):
    given = {"node_names": ("1", "2", "3"), "positions": [[0, 0, 0], [0, 0, 1], [0, 0, 2]], "lines": ((0, 1, 2),)}
    return Geometry(**{**given, **changes})


def mode(shape, pole=POLE):
    return Mode(
        pole=pole,
        kind="oscillatory",
        frequency=abs(pole) / 2 / np.pi,
        damping_ratio=-pole.real / abs(pole) if pole else 0.0,
        shape=np.asarray(shape, dtype=complex),
        participation=np.ones(1),
    )


def test_accelerations_velocities_and_displacements_give_one_picture():
    true = np.array([0.2, -0.5, 1.0])
    shape = true * np.array([1.0, POLE, POLE**2])
    found = placed(tower(), ["1X+", "2X+", "3X+"], ["m", "m/s", "m/s^2"])
    np.testing.assert_allclose(found.deflection(mode(shape))[:, 0], true, atol=1e-12)
    assert any("divided by the pole" in sentence for sentence in found.sentences)


def test_one_unit_is_drawn_as_it_is():
    true = np.array([0.2, -0.5, 1.0 + 0.1j])
    found = placed(tower(), ["1X+", "2X+", "3X+"], ["m/s^2"] * 3)
    moved = found.deflection(mode(7.0 * true))[:, 0]
    np.testing.assert_allclose(moved / moved[2] * true[2], true, atol=1e-12)
    assert np.abs(moved).max() == pytest.approx(1.0)
    assert not any("divided by the pole" in sentence for sentence in found.sentences)


def test_units_of_another_size_are_made_comparable():
    found = placed(tower(), ["1X+", "2X+", "3X+"], ["mm", "m", "m"])
    moved = found.deflection(mode([1000.0, 1.0, 0.5]))[:, 0].real
    np.testing.assert_allclose(moved, [1.0, 1.0, 0.5], atol=1e-12)


def test_rotations_are_not_drawn_as_translation_but_turn_a_body():
    names, units = ["1X+", "2RZ+", "3X+"], ["m", "rad", "m"]
    found = placed(tower(), names, units)
    assert not found.deflection(mode([1.0, 50.0, 0.5]))[1].any()
    assert any("Rotations are not drawn as translations" in one and "2RZ+" in one for one in found.sentences)
    body = tower(rigid=((0, 1, 2),), positions=[[0, 0, 0], [2, 0, 0], [0, 0, 1]])
    found = placed(body, names, units)
    assert not any("Rotations" in sentence for sentence in found.sentences)
    moved = found.deflection(mode([0.0, 1.0, 0.0])).real
    # around the middle of the three sensors, at x = 2/3: nodes at 0 and 2 move by -2/3 and 4/3, and the largest is 1
    np.testing.assert_allclose(moved[:, 1], [-0.5, 1.0, -0.5], atol=1e-9)


def test_the_strongest_output_reads_positive_whichever_way_its_sensor_looks():
    found = placed(tower(), ["1X+", "2X-", "3X+"], ["m"] * 3)
    np.testing.assert_allclose(found.deflection(mode([0.5j, 1j, -0.2j]))[:, 0], [0.5, -1.0, -0.2], atol=1e-12)


def test_a_unit_of_rotation_makes_a_rotation_of_any_sensor():
    found = placed(tower(), ["1X+", "2X+"], ["m", "rad/s"])
    assert found.sensors[1] is None
    assert any("Rotations are not drawn" in sentence for sentence in found.sentences)


def test_forces_and_strains_beside_motion_are_left_out_and_named():
    found = placed(tower(), ["1X+", "2X+", "3X+"], ["m/s^2", "N", ""])
    assert [one is None for one in found.sensors] == [False, True, True]
    assert any("Not in a unit of the motion" in one and "2X+, 3X+" in one for one in found.sentences)
    assert not any("Not in a unit" in sentence for sentence in placed(tower(), ["1X+"], ["m"]).sentences)


def test_without_any_unit_of_motion_the_most_common_one_is_drawn_and_said():
    found = placed(tower(), ["1X+", "2X+", "3X+"], ["V", "V", "N"])
    assert [one is None for one in found.sensors] == [False, False, True]
    assert any("The unit V is none of motion" in sentence for sentence in found.sentences)
    assert any("have no unit" in sentence for sentence in placed(tower(), ["1X+"]).sentences)
    assert not any("as if it were" in sentence for sentence in placed(tower(), ["1X+"], ["m"]).sentences)


def test_outputs_without_a_place_are_named():
    found = placed(tower(), ["1X+", "microphone"], ["m", "m"])
    assert "Without a place in the geometry, so not drawn: microphone." in found.sentences
    assert not any("Without a place" in sentence for sentence in placed(tower(), ["1X+"], ["m"]).sentences)


def test_nodes_without_a_sensor_are_counted():
    words = " ".join(placed(tower(), ["3X+", "3Y+"], ["m", "m"]).sentences)
    assert "Without a sensor, so drawn at rest: 2 of 3 nodes (1, 2)." in words
    assert "1 in two directions" in words
    every = " ".join(placed(tower(fixed=(0, 1)), ["3X+", "3Y+", "3Z-"], ["m"] * 3).sentences)
    assert "Without a sensor" not in every
    assert "directions" not in every


def test_sensors_at_fixed_nodes_are_named():
    found = placed(tower(fixed=(0,)), ["1X+", "2X+"], ["m", "m"])
    assert any("fixed, so not drawn: 1X+" in sentence for sentence in found.sentences)
    assert not any("fixed" in sentence for sentence in placed(tower(fixed=(0,)), ["2X+"], ["m"]).sentences)


def test_rigid_bodies_are_told():
    found = placed(tower(rigid=((1, 2),)), ["2X+"], ["m"])
    assert any("2 nodes of 1 body move as a whole" in sentence for sentence in found.sentences)
    assert not any("rigid" in sentence for sentence in placed(tower(), ["2X+"], ["m"]).sentences)


def test_a_geometry_that_fits_no_output_is_an_error_with_both_names():
    with pytest.raises(InvalidDataError) as caught:
        placed(tower(), [f"microphone {k}" for k in range(30)])
    message = str(caught.value)
    assert "none of the 30 outputs (microphone 0" in message
    assert "1, 2, 3" in message
    assert "[sensors]" in message
    assert len(message) < 500


def test_a_pole_at_zero_and_a_shape_of_zeros_are_drawn_at_rest():
    found = placed(tower(), ["1X+", "2X+"], ["m", "m/s^2"])
    assert np.isfinite(found.deflection(mode([1.0, 1.0], pole=0j))).all()
    assert not found.deflection(mode([0.0, 0.0])).any()


def test_in_a_row_each_unit_has_its_own_largest():
    found = placed(None, ["a", "b", "c", "d"], ["m", "rad", "m", "rad"])
    moved = found.deflection(mode([1.0, 0.01, -0.5, 0.02]))[:, 2].real
    np.testing.assert_allclose(np.abs(moved), [1.0, 0.5, 0.5, 1.0])
    assert not found.is_given
    assert "different units" in found.sentences[0]
    assert "different units" not in placed(None, ["a", "b"], ["m", "m"]).sentences[0]


def test_in_a_row_names_that_state_nodes_share_them():
    found = placed(None, ["1X+", "1Y+", "2X+", "2Y+"], ["m"] * 4)
    assert found.geometry.node_names == ("1", "2")
    assert np.ptp(found.geometry.positions, axis=0).tolist() == [0, 0, 2]
    moved = found.deflection(mode([0.5, 0.0, 0.0, -1.0]))
    np.testing.assert_allclose(np.abs(moved), [[0.5, 0, 0], [0, 1, 0]], atol=1e-12)


@pytest.mark.parametrize(
    ("names", "along"),
    [
        (["1Z+", "2Z+"], 0),
        (["1X+", "2X+"], 2),
        (["1X+", "2Y+"], 2),
        (["1X+", "2Z+"], 1),
        (["1Y-", "2Y+", "3Z+"], 0),
        (["1X+", "1Y+", "2Y+", "2Z+", "3Y+", "3X+"], 2),
    ],
)
def test_a_row_lies_where_least_is_measured(names, along):
    positions = placed(None, names, ["m"] * len(names)).geometry.positions
    assert np.flatnonzero(np.ptp(positions, axis=0)).tolist() == [along]


def test_outputs_without_a_visible_name_stand_in_the_row_as_well():
    found = placed(None, ["", " ", "unnamed 1", "a"], ["m"] * 4)
    assert found.geometry.node_names == ("unnamed 1'", "unnamed 2", "unnamed 1", "a")
    assert np.abs(found.deflection(mode([1.0, 0.5, 0.2, 0.1]))[:, 2]).tolist() == [1.0, 0.5, 0.2, 0.1]


def test_one_sensor_alone_is_a_node_that_moves():
    found = placed(None, ["tip"], ["m"])
    np.testing.assert_allclose(found.deflection(mode([1j])), [[0, 0, 1]], atol=1e-12)


def test_a_shape_is_turned_to_its_best_real_phase():
    rng = np.random.default_rng(3)
    shape = rng.standard_normal((6, 3)) + 1j * rng.standard_normal((6, 3))
    found = turned(shape)
    best = max(np.linalg.norm((shape * np.exp(1j * phase)).real) for phase in np.linspace(0, np.pi, 4001))
    assert np.linalg.norm(found.real) == pytest.approx(best, rel=1e-6)
    assert found.ravel()[np.abs(found).argmax()].real > 0
    circle = turned(np.array([0.5j, 1j, -1.0 * np.exp(0.1j) * 0.9]))
    assert np.isfinite(circle).all()
    assert turned(np.array([1.0, 1j])).tolist() == [1.0, 1j]


def test_powers_of_the_pole_are_needed_only_among_different_derivatives():
    assert derivatives_of(["m/s^2", "m", "N", "rad/s"]) == (2, 0, 0, 1)
    assert derivatives_of(["m/s^2", "N", "m/s^2"]) == (0, 0, 0)


def test_an_explicit_sensor_about_an_axis_in_metres_is_left_out():
    geometry = tower(sensors=(Sensor(name="g", node=0, direction=[0, 0, 1], motion="about"),))
    assert placed(geometry, ["g", "2X+"], ["m", "m"]).sensors[0] is None


@pytest.mark.parametrize("pattern", ["p{}{}", "x{}y{}", "r{}c{}", "acc_{}_{} top", "{}-{}"])
@pytest.mark.parametrize("start", [0, 1])
def test_names_that_count_rows_and_columns_are_a_grid(pattern, start):
    names = [pattern.format(i, j) for i in range(start, start + 3) for j in range(start, start + 4)]
    grid = guessed_grid(names, ["m/s^2"] * 12)
    first, last = grid.positions[0, :2], grid.positions[-1, :2]
    assert len(grid.lines) == 7
    assert np.abs(last - first).max() == pytest.approx(2.0)
    assert (first < last).tolist() == ([True, True] if pattern.startswith("x") else [True, False])
    assert "guessed from the names" in placed(None, names).sentences[0]


@pytest.mark.parametrize(
    "names",
    [
        [f"ch{k:02}" for k in range(20)],
        [f"ch{k}" for k in range(10, 30)],
        ["p11", "p12", "p21"],
        ["p11", "p12", "q21", "q22"],
        ["11X+", "12X+", "21X+", "22X+"],
        ["p11", "p12", "p21", "p31"],
        ["tip", "root"],
    ],
)
def test_names_that_count_channels_or_fill_no_grid_are_none(names):
    assert guessed_grid(names) is None


def test_a_grid_of_two_units_is_no_grid():
    assert guessed_grid(["p11", "p12", "p21", "p22"], ["m", "m", "m", "m/s^2"]) is None
