"""What is drawn of a structure: the eye, the envelope, lines within a budget."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modal.geometry.placement import at_rest, placed
from modal.geometry.scene import envelope_of, scene_of
from modal.geometry.sensors import Geometry

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
