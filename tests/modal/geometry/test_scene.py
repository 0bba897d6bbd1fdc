"""What is drawn of a structure: the eye, the envelope, lines within a budget."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modal.geometry.placement import at_rest, placed
from modal.geometry.scene import comparable_shapes, comparison_words, complexity_words, envelope_of, phasors, scene_of
from modal.geometry.sensors import Geometry
from modal.modes.mode import Mode
from modal.modes.shape_comparison import assurance

HEIGHT = 2


def scene(positions, names, **changes):
    labels = tuple(str(k + 1) for k in range(len(positions)))
    geometry = Geometry(node_names=labels, positions=positions, **changes)
    return scene_of(placed(geometry, names, ["m"] * len(names)))


BEAM = [[x, 0, 0] for x in range(5)]
TOWER = [[0, 0, z] for z in range(5)]
PLATE = [[x, y, 0] for x in range(3) for y in range(3)]
WALL = [[x, 0, z] for x in range(3) for z in range(3)]
BOX = [[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]


def named(positions, axes):
    return [f"{k + 1}{axis}+" for k in range(len(positions)) for axis in axes]


@pytest.mark.parametrize(
    ("positions", "axes", "least"),
    [
        (BEAM, "Z", {0: 0.8, 2: 0.8}),
        (BEAM, "Y", {0: 0.8, 1: 0.55}),
        (TOWER, "X", {2: 0.8, 0: 0.8}),
        (TOWER, "XY", {2: 0.8, 0: 0.5, 1: 0.5}),
        (PLATE, "Z", {0: 0.55, 1: 0.55, 2: 0.7}),
        (WALL, "Y", {0: 0.6, 2: 0.8, 1: 0.4}),
        (BOX, "XYZ", {0: 0.6, 1: 0.6, 2: 0.6}),
    ],
    ids=["beam Z", "beam Y", "tower X", "tower XY", "plate", "wall", "box"],
)
def test_extent_and_motion_are_both_seen(positions, axes, least):
    eye = scene(positions, named(positions, axes)).eye
    seen = np.linalg.norm(eye.seen(np.eye(3)), axis=1)
    for axis, share in least.items():
        assert seen[axis] >= share, (axis, seen)
    assert eye.towards[HEIGHT] > 0.1  # from above the ground
    assert eye.towards[1] < 0  # from the front
    basis = np.array([eye.right, eye.up, eye.towards])
    np.testing.assert_allclose(basis @ basis.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(basis) == pytest.approx(1.0)
    assert eye.up[HEIGHT] > 0


def test_a_plate_shows_no_two_corners_in_one_place():
    found = scene(PLATE, named(PLATE, "Z"))
    seen = found.eye.seen(found.positions)
    apart = np.linalg.norm(seen[:, None] - seen[None], axis=2) + 9 * np.eye(len(seen))
    assert apart.min() > 0.15


def test_positions_are_centred_and_scaled():
    found = scene([[3, 0, 0], [9, 2, 0]], ["1Z+"])
    np.testing.assert_allclose(found.positions, [[-1, -1 / 3, 0], [1, 1 / 3, 0]], atol=1e-12)
    alone = scene([[3, 4, 5]], ["1Z+"])
    np.testing.assert_allclose(alone.positions, [[0, 0, 0]])


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_envelope_is_the_furthest_point_of_every_path(seed):
    rng = np.random.default_rng(seed)
    motion = rng.standard_normal((5, 3)) + 1j * rng.standard_normal((5, 3))
    motion[0] *= [1, 0, 0]
    found = np.linalg.norm(envelope_of(motion), axis=1)
    phases = np.exp(1j * np.linspace(0, 2 * np.pi, 2001))
    naive = np.linalg.norm((phases[:, None, None] * motion).real, axis=2).max(axis=0)
    np.testing.assert_allclose(found, naive, rtol=1e-5)


def test_the_envelope_stands_on_the_side_of_the_shape():
    motion = np.array([[0, 0, 0.5 + 0.1j], [0, 0, -0.8 - 0.3j], [0, 0, 0]])
    furthest = envelope_of(motion)
    assert (np.sign(furthest[:, 2]) == [1, -1, 0]).all()


def test_lines_become_segments_once_each():
    found = scene(BEAM, ["2Z+"], lines=((0, 1, 2), (2, 1), (3, 4), (4, 4)))
    assert found.segments.tolist() == [[0, 1], [1, 2], [3, 4]]


def test_surfaces_become_triangles():
    found = scene(PLATE, ["1Z+"], surfaces=((0, 1, 4, 3), (4, 5, 8)))
    assert found.triangles.tolist() == [[0, 1, 4], [0, 4, 3], [4, 5, 8]]


def test_of_many_lines_those_that_move_are_kept():
    n = 400
    found = scene([[x, 0, 0] for x in range(n)], ["200Z+"], lines=(tuple(range(n)),))
    kept = found.drawn_segments(40).tolist()
    assert len(kept) == 40
    assert [198, 199] in kept
    assert [199, 200] in kept
    assert len(found.drawn_segments(10_000)) == n - 1


def test_a_geometry_alone_is_a_scene_at_rest():
    geometry = Geometry(node_names=("1", "2"), positions=[[0, 0, 0], [1, 0, 0]])
    assert not scene_of(at_rest(geometry)).moving.any()


POLES = (-0.1 + 8.0j, -0.2 + 30.0j)
MOTION = np.random.default_rng(0).standard_normal((4, 2)) + 0j


def seen(orders, factors):
    """Modes as sensors of these derivatives and scales see one and the same motion."""
    return [
        SimpleNamespace(pole=pole, shape=MOTION[:, k] * pole ** np.array(orders) / np.array(factors))
        for k, pole in enumerate(POLES)
    ]


NAMES = ("a", "b", "c", "d")


@pytest.mark.parametrize(
    ("units", "orders", "factors"),
    [
        (("m", "m/s", "m/s^2", "m"), (0, 1, 2, 0), (1, 1, 1, 1)),
        (("mm", "m/s^2", "g", "m/s"), (0, 2, 2, 1), (1e-3, 1, 9.80665, 1)),
        (("rad", "rad/s", "deg", "rad/s^2"), (0, 1, 0, 2), (1, 1, np.pi / 180, 1)),
    ],
)
def test_sensors_of_any_kind_see_the_same_displacements(units, orders, factors):
    shapes = comparable_shapes(seen(orders, factors), NAMES, units)
    assert shapes == pytest.approx(MOTION, rel=1e-6)
    assert assurance(shapes, shapes) == pytest.approx(assurance(MOTION, MOTION), rel=1e-6)
    assert "made displacements" in comparison_words(NAMES, units)


@pytest.mark.parametrize(
    "units", [("m", "N", "m", "m"), ("m", "rad", "m", "m"), ("m", "", "m", "m"), ("m", "V", "m/s", "m")]
)
def test_what_cannot_be_made_displacements_stays_as_it_is_and_is_said(units):
    modes = seen((0, 0, 0, 0), (1, 1, 1, 1))
    assert np.array_equal(comparable_shapes(modes, NAMES, units), MOTION)
    assert "numbers as they are" in comparison_words(NAMES, units)


@pytest.mark.parametrize("unit", ["m/s^2", "counts", ""])
def test_one_unit_needs_nothing_and_no_words(unit):
    modes = seen((2, 2, 2, 2), (1, 1, 1, 1))
    raw = np.column_stack([mode.shape for mode in modes])
    assert np.array_equal(comparable_shapes(modes, NAMES, (unit,) * 4), raw)
    assert comparison_words(NAMES, (unit,) * 4) == ""


def test_no_modes_and_a_pole_at_zero_do_no_harm():
    assert comparable_shapes([], NAMES, ("m", "m/s", "m", "m")).shape == (4, 0)
    still = SimpleNamespace(pole=0j, shape=MOTION[:, 0])
    assert np.array_equal(comparable_shapes([still], NAMES, ("m", "m/s", "m", "m"))[:, 0], MOTION[:, 0])


def mode(shape, *, collinearity=0.99, deviation=2.0, pole=-0.4 + 12j):
    return Mode(
        pole=pole,
        kind="oscillatory",
        frequency=2.0,
        damping_ratio=0.03,
        shape=np.asarray(shape, dtype=complex),
        participation=np.ones(1),
        phase_collinearity=collinearity,
        mpd=deviation,
    )


@pytest.mark.parametrize(
    ("collinearity", "deviation", "words"),
    [
        (0.951, 9.9, "nearly real"),
        (0.949, 9.9, "complex"),
        (0.951, 10.1, "complex"),
        (0.51, 30.0, "complex"),
        (0.49, 30.0, "no common phase"),
        (np.nan, 3.0, "not known"),
        (0.99, np.nan, "not known"),
    ],
)
def test_words_follow_the_two_numbers(collinearity, deviation, words):
    assert complexity_words(mode([1, 0.5, 0.2], collinearity=collinearity, deviation=deviation)) == words


def test_one_sensor_has_no_complexity():
    assert complexity_words(mode([1.0])) == "one sensor"
    assert complexity_words(mode([1.0, 0.0])) != "one sensor"


def test_phasors_of_a_real_shape_lie_flat_whatever_its_phase():
    found = phasors(mode(np.array([0.5, -1.0, 0.2]) * np.exp(0.7j)), ["m"] * 3)
    np.testing.assert_allclose(found, [-0.5, 1.0, -0.2], atol=1e-12)


def test_displacements_beside_accelerations_keep_their_line():
    pole = -0.4 + 12j
    found = phasors(mode([0.5, -1.0 * pole**2], pole=pole), ["m", "m/s^2"])
    np.testing.assert_allclose(np.abs(found.imag), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.abs(found.real), 1.0)


def test_each_unit_has_its_own_largest():
    found = phasors(mode([1.0, 0.5, 1e-6]), ["m", "m", "rad"])
    np.testing.assert_allclose(np.abs(found), [1.0, 0.5, 1.0])
    assert np.isfinite(phasors(mode([1.0, 0.0], pole=0j), ["m", "m/s"])).all()
