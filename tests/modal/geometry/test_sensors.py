"""Nodes, sensors and the motion that follows: exact motions, a naive twin, and every refusal in one sentence."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modal.geometry.sensors import Dof, Geometry, GeometryLimits, Sensor, dof_of, motion_of
from okid.errors import InvalidDataError


def line(n=3, **changes):
    given = {"node_names": tuple(str(k + 1) for k in range(n)), "positions": [[0.0, 0.0, k] for k in range(n)]}
    return Geometry(**{**given, **changes})


def test_channels_find_their_node_by_name():
    geometry = line(3, sensors=(Sensor(name="top", node=2, direction=[0, 3, 0]),))
    found = geometry.sensors_of(["top", "2-X", "02Z", "beam:1:Y", "9X", "gauge"])
    assert [None if one is None else one.node for one in found] == [2, 1, 1, 0, None, None]
    assert [one.direction.tolist() for one in found[:4]] == [[0, 1, 0], [-1, 0, 0], [0, 0, 1], [0, 1, 0]]


def test_an_explicit_sensor_goes_before_what_its_name_states():
    geometry = line(3, sensors=(Sensor(name="1X+", node=2, direction=[0, 0, 1]),))
    assert geometry.sensors_of(["1X+"])[0].node == 2


def test_local_axes_turn_the_directions_that_names_state():
    axes = np.tile(np.eye(3), (3, 1, 1))
    axes[1] = [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]
    geometry = line(3, axes=axes)
    moved = geometry.deflection(np.array([1.0, 1.0]), ["1X+", "2X+"])
    assert moved[0].real.tolist() == [1, 0, 0]
    assert moved[1].real.tolist() == [0, 1, 0]


def test_nothing_moves_where_nothing_was_seen():
    moved = line(3).deflection(np.array([1.0 + 2j, 5.0]), ["2Y-", "elsewhere"])
    np.testing.assert_array_equal(moved, [[0, 0, 0], [0, -1 - 2j, 0], [0, 0, 0]])


def test_skew_sensors_are_solved_and_what_they_do_not_see_stays_zero():
    true = np.array([0.3, -0.7, 0.0])
    ways = np.array([[1.0, 1.0, 0.0], [1.0, -0.4, 0.0], [0.2, 1.0, 0.0]])
    sensors = tuple(Sensor(name=f"s{k}", node=1, direction=way) for k, way in enumerate(ways))
    geometry = line(3, sensors=sensors)
    readings = np.array([sensor.direction @ np.add(true, [0.0, 0.0, 9.0]) for sensor in sensors])
    moved = geometry.deflection(readings, ["s0", "s1", "s2"])
    np.testing.assert_allclose(moved[1], true, atol=1e-12)


@pytest.mark.parametrize(("degrees", "n_seen"), [(3.0, 1), (12.0, 2)])
def test_directions_that_nearly_agree_count_as_one(degrees, n_seen):
    angle = np.deg2rad(degrees)
    sensors = [
        Sensor(name="a", node=0, direction=[1, 0, 0]),
        Sensor(name="b", node=0, direction=[np.cos(angle), np.sin(angle), 0]),
    ]
    motions = motion_of(line(1), sensors)
    assert motions.directions_seen == {0: n_seen}
    # a difference of 1 % between the two must not become a motion across that is many times larger
    assert np.abs(motions.deflection(np.array([1.0, 1.01]))).max() < 1.2


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 5))
def test_each_node_repeats_its_readings_as_plain_least_squares_does(seed, n_sensors):
    rng = np.random.default_rng(seed)
    ways = rng.standard_normal((n_sensors, 3))
    sensors = [Sensor(name=str(k), node=0, direction=way) for k, way in enumerate(ways)]
    units = np.array([sensor.direction for sensor in sensors])
    if np.linalg.svd(units, compute_uv=False)[: min(3, n_sensors)].min() < 0.15 * np.sqrt(n_sensors):
        return  # nearly parallel directions are joined on purpose
    readings = rng.standard_normal(n_sensors) + 1j * rng.standard_normal(n_sensors)
    naive = np.linalg.lstsq(units.astype(complex), readings, rcond=None)[0]
    np.testing.assert_allclose(motion_of(line(1), sensors).deflection(readings)[0], naive, atol=1e-9)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_rigid_body_with_enough_sensors_is_followed_exactly(seed):
    rng = np.random.default_rng(seed)
    places = rng.standard_normal((7, 3)) * 10.0 ** rng.uniform(-3, 3) + rng.standard_normal(3)
    shift, turn = rng.standard_normal(3), rng.standard_normal(3) / np.ptp(places)
    true = shift + np.cross(turn, places)
    sensors = tuple(Sensor(name=f"s{k}", node=k % 6, direction=rng.standard_normal(3)) for k in range(14))
    gyro = Sensor(name="gyro", node=6, direction=rng.standard_normal(3), motion="about")
    geometry = line(7, positions=places, rigid=(range(7),), sensors=(*sensors, gyro))
    readings = [one.direction @ true[one.node] for one in sensors] + [gyro.direction @ turn]
    moved = geometry.deflection(np.array(readings), [one.name for one in geometry.sensors])
    np.testing.assert_allclose(moved, true, atol=1e-6 * np.abs(true).max())


def floor(names):
    corners = [[0, 0, 0], [4, 0, 0], [4, 3, 0], [0, 3, 0]]
    geometry = line(4, positions=corners, rigid=((0, 1, 2, 3),))
    return geometry, names


def test_a_floor_with_one_sensor_each_way_moves_without_turning():
    geometry, names = floor(["1X+", "3Y+"])
    moved = geometry.deflection(np.array([1.0, -2.0]), names)
    np.testing.assert_allclose(moved, np.tile([1.0, -2.0, 0.0], (4, 1)), atol=1e-12)


def test_a_floor_turns_where_two_sensors_show_it():
    geometry, names = floor(["1X+", "1Y+", "2Y+"])
    turn = 0.1
    true = np.cross([0, 0, turn], geometry.positions)
    moved = geometry.deflection(np.array([0.0, true[0, 1], true[1, 1]]), names)
    np.testing.assert_allclose(moved[:, 1], true[:, 1], atol=1e-12)  # what was measured is repeated
    np.testing.assert_allclose(moved[2] - moved[1], np.cross([0, 0, turn], [0, 3, 0]), atol=1e-12)


def test_a_rotation_outside_a_body_moves_nothing():
    sensors = (Sensor(name="gyro", node=0, direction=[0, 0, 1], motion="about"),)
    assert not line(3, sensors=sensors).deflection(np.array([5.0]), ["gyro"]).any()
    body = line(3, sensors=sensors, rigid=((0, 2),), positions=[[0, 0, 0], [1, 0, 0], [0, 2, 0]])
    np.testing.assert_allclose(body.deflection(np.array([5.0]), ["gyro"])[2], [-10, 0, 0], atol=1e-12)


def test_a_fixed_node_stays():
    assert not line(2, fixed=(1,)).deflection(np.array([1.0]), ["2X+"]).any()


REFUSED = {
    "no node": ({"node_names": (), "positions": np.zeros((0, 3))}, "at least 1 node"),
    "a name twice": ({"node_names": ("1", "2", "1")}, "node '1' is given twice"),
    "an empty name": ({"node_names": ("1", " ", "3")}, "needs a name"),
    "a position that is none": (
        {"positions": [[0, 0, 0], [0, np.nan, 1], [0, 0, 2]]},
        "node '2' stands at (0, nan, 1)",
    ),
    "far away": ({"positions": [[0, 0, 0], [0, 0, 1], [0, 0, 1e300]]}, "at most 1e+09 m, but node '3'"),
    "two coordinates": ({"positions": np.zeros((3, 2))}, "(3, 3), but have (3, 2)"),
    "no numbers": ({"positions": [["a", "b", "c"]] * 3}, "must be numbers"),
    "a short line": ({"lines": ((0, 1), (2,))}, "part 2 of lines has 1 node, but needs at least 2"),
    "an unknown node": (
        {"lines": ((0, 3),)},
        "part 1 of lines names node index 3, but the geometry has indices 0 to 2",
    ),
    "a flat surface": ({"surfaces": ((0, 1),)}, "needs at least 3"),
    "two bodies": ({"rigid": ((0, 1), (1, 2))}, "node '2' belongs to more than one"),
    "fixed and moving": ({"rigid": ((0, 1),), "fixed": (1,)}, "node '2' belongs to more than one"),
    "a channel twice": (
        {"sensors": (Sensor(name="a", node=0, direction=[1, 0, 0]), Sensor(name="a", node=1, direction=[1, 0, 0]))},
        "channel 'a' has two sensors",
    ),
    "a sensor nowhere": (
        {"sensors": (Sensor(name="a", node=7, direction=[1, 0, 0]),)},
        "sensor 'a' names node index 7",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_no_geometry_is_refused_in_one_sentence(case):
    changes, words = REFUSED[case]
    with pytest.raises(InvalidDataError) as caught:
        line(3, **changes)
    message = str(caught.value)
    assert words in message
    assert message.endswith(".")
    assert "\n" not in message


def test_sensors_without_a_direction_are_refused():
    for direction in ([0, 0, 0], [1, 0], [np.nan, 0, 0], [np.inf, 0, 0]):
        with pytest.raises(InvalidDataError):
            Sensor(name="a", node=0, direction=direction)
    with pytest.raises(InvalidDataError, match="along"):
        Sensor(name="a", node=0, direction=[1, 0, 0], motion="across")
    assert np.linalg.norm(Sensor(name="a", node=0, direction=[1e300, 1e300, 0]).direction) == pytest.approx(1.0)


def test_too_many_nodes_are_refused():
    with pytest.raises(InvalidDataError, match=str(GeometryLimits.MOST_NODES)):
        line(GeometryLimits.MOST_NODES + 1)


def test_a_shape_needs_one_component_an_output():
    with pytest.raises(InvalidDataError, match=r"\(2,\), but has \(3,\)"):
        line(3).deflection(np.ones(3), ["1X+", "2X+"])


def test_arrays_are_frozen():
    geometry = line(3)
    with pytest.raises(ValueError, match="read-only"):
        geometry.positions[0, 0] = 1.0


FORMS = {
    "12X+": ("12", 0, 1),
    "12+X": ("12", 0, 1),
    "12X": ("12", 0, 1),
    "12-X": ("12", 0, -1),
    "12x-": ("12", 0, -1),
    "7 Y-": ("7", 1, -1),
    "plate:3:+Z": ("plate:3", 2, 1),
    "plate:3Z": ("plate:3", 2, 1),
    "plate:3:-Z": ("plate:3", 2, -1),
    "tip Z": ("tip", 2, 1),
    "tip_z-": ("tip", 2, -1),
    "tip.Y": ("tip", 1, 1),
    "tip-Z": ("tip", 2, -1),
    "acc1z": ("acc1", 2, 1),
    "12X+ Acceleration": ("12", 0, 1),
}


@pytest.mark.parametrize("name", FORMS)
def test_each_form_names_node_axis_and_sign(name):
    node, axis, sign = FORMS[name]
    assert dof_of(name) == Dof(node=node, axis=axis, sign=sign, motion="along")
    assert dof_of(f"  {name} ") == dof_of(name)


@pytest.mark.parametrize("name", ["3RX+", "3+RX", "3:rx", "arm_RX"])
def test_an_r_before_the_axis_is_a_rotation(name):
    assert dof_of(name).motion == "about"
    assert dof_of(name).axis == 0


@pytest.mark.parametrize(
    "name", ["max", "flux", "X", "X+", "+X", "", " ", "floor_1", "12+X+", "tip--Z", "12X Acc", "12", "12W+", "motorRX"]
)
def test_other_names_state_nothing(name):
    assert dof_of(name) is None


@given(st.text(max_size=400))
def test_any_text_is_read_or_not_without_an_error(name):
    found = dof_of(name)
    if found is not None:
        assert found.node.strip()
        assert name.strip().startswith(found.node)


@given(st.integers(1, 10**6), st.sampled_from("XYZ"), st.sampled_from("+-"))
def test_the_sign_may_stand_on_either_side(node, axis, sign):
    assert dof_of(f"{node}{axis}{sign}") == dof_of(f"{node}{sign}{axis}")
    assert dof_of(f"{node}{axis}{sign}").sign == (1 if sign == "+" else -1)
