"""Shapes in motion: on a geometry and in a row, one phase for all, within their budget, all within their pane."""

from dataclasses import replace

import numpy as np
import pytest

from modal.geometry.placement import placed
from modal.geometry.scene import envelope_of, scene_of
from modal.geometry.sensors import Geometry
from modal.recording import save_recording
from modal.recording.identification.modes import ShapePanes, modes_page
from modal.recording.identification.shapes import Swinging, pace_of
from modal.recording.plan import planned
from okid.errors import InvalidDataError


def with_shape(found, *shapes):
    modes = list(found.modes.modes)
    for k, shape in enumerate(shapes):
        modes[k] = replace(modes[k], shape=np.asarray(shape, dtype=complex))
    return replace(found, modes=replace(found.modes, modes=tuple(modes)))


@pytest.fixture
def heads(build, tmp_path, read):
    """Positions (n_frames, n_sensors, 3) of the sensors of one mode."""

    def positions(shape, units, *, names=None, geometry=None):
        found = with_shape(build(n_modes=1, n_outputs=len(shape), units=units, n_noise=0, output_names=names), shape)
        path = save_recording(found, tmp_path / "run.rrd", existing="replace", geometry=geometry)
        return np.array(read(path).frames("/modes/shape/01/heads", "Points3D:positions"))

    return positions


def heights_of(frames):
    lifted = frames[:, :, 2]
    return lifted / np.abs(lifted).max()


def test_each_unit_has_its_own_scale_and_the_phase_between_units_is_kept(heads):
    found = heights_of(heads([1.0, 0.5, -0.001, 0.002], ["m/s^2", "m/s^2", "rad", "rad"]))
    np.testing.assert_allclose(found[0], [1.0, 0.5, -0.5, 1.0], atol=1e-6)
    found = heights_of(heads([1.0, 0.5, 0.001, -0.002], ["m/s^2", "m/s^2", "rad", "rad"]))
    np.testing.assert_allclose(found[0], [1.0, 0.5, 0.5, -1.0], atol=1e-6)


def test_a_quarter_period_of_phase_is_seen_as_one(heads):
    found = heights_of(heads([1.0, 1.0j, -1.0, 0.0], ["m"] * 4))
    np.testing.assert_allclose(found[0], [1.0, 0.0, -1.0, 0.0], atol=1e-6)
    # x(t) = Re(shape exp(i phase)): a quarter of a period later the second sensor is down
    np.testing.assert_allclose(found[8], [0.0, -1.0, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(found[32], found[0], atol=1e-6)


FRAME = Geometry(
    node_names=("1", "2", "3", "4"),
    positions=[[0, 0, 0], [0, 0, 2], [2, 0, 2], [2, 0, 0]],
    lines=((0, 1, 2, 3),),
    fixed=(0, 3),
)


def test_on_a_geometry_nodes_move_the_way_their_sensors_look(heads):
    frames = heads([1.0, -0.5], ["m/s^2"] * 2, names=["2X-", "3Y+"], geometry=FRAME)
    moved = frames - np.array([[-1, 0, 1], [1, 0, 1]])
    scale = np.linalg.norm(moved, axis=2).max()
    np.testing.assert_allclose(moved[0] / scale, [[-1, 0, 0], [0, -0.5, 0]], atol=1e-6)
    np.testing.assert_allclose(moved[Swinging.FRAMES // 2], -moved[0], atol=1e-6)


def test_what_is_drawn_is_stored_as_numbers(build, tmp_path, read):
    found = with_shape(build(n_modes=1, n_outputs=3, n_noise=0, output_names=["2X-", "3Y+", "gauge"]), [1.0, 0.5j, 9.0])
    stored = read(save_recording(found, tmp_path / "run.rrd", geometry=FRAME))
    nodes = stored.table("/modes/nodes", "node")
    assert (nodes["name"], nodes["z"]) == (["1", "2", "3", "4"], [0, 2, 2, 0])
    sensors = stored.rows("/modes/sensors", "output")
    assert [row["name"] for row in sensors.values()] == [["2X-"], ["3Y+"]]
    assert sensors[0]["direction"] == [-1, 0, 0]
    moved = stored.rows("/modes/deflections", "mode")[1]
    assert moved["nodes"] == [1, 2]
    np.testing.assert_allclose(moved["x_real"], [-1, 0], atol=1e-12)
    np.testing.assert_allclose(np.abs(moved["y_imaginary"]), [0, 0.5], atol=1e-12)
    words = stored.static("/modes/text", "TextDocument:text")[0]
    assert "Without a place in the geometry, so not drawn: gauge." in words


def test_a_geometry_that_fits_no_output_leaves_no_file(build, tmp_path):
    path = tmp_path / "run.rrd"
    with pytest.raises(InvalidDataError, match="has a place in the geometry"):
        save_recording(build(), path, geometry=FRAME)
    assert not list(tmp_path.iterdir())


def test_structure_envelope_sensors_and_surface_are_there(build, tmp_path, read):
    found = build(n_modes=2, n_outputs=2, n_noise=0, output_names=["2X+", "3X+"])
    surfaced = replace(FRAME, surfaces=((0, 1, 2, 3),))
    stored = read(save_recording(found, tmp_path / "run.rrd", geometry=surfaced))
    for part, component in {
        "rest": "LineStrips3D:strips",
        "envelope": "LineStrips3D:strips",
        "sensors": "Points3D:positions",
        "fixed": "Points3D:positions",
        "directions": "Arrows3D:vectors",
    }.items():
        assert stored.static(f"/modes/shape/02/{part}", component)
    assert len(stored.frames("/modes/shape/02/line", "LineStrips3D:strips")[0]) == 3
    assert len(stored.frames("/modes/shape/02/surface", "Mesh3D:vertex_positions")[0]) == 4


def test_the_animation_spans_the_record(build, tmp_path, read):
    found = build(n_records=2)
    stored = read(save_recording(found, tmp_path / "run.rrd"))
    times = np.sort(
        np.concatenate(
            [
                batch.column("time").to_numpy(zero_copy_only=False).astype("timedelta64[ns]").astype(float) / 1e9
                for batch in stored.batches("/modes/shape/01/heads", static=False)
            ]
        )
    )
    first, last = found.records
    assert times[0] == pytest.approx(first.start_time)
    assert times[-1] == pytest.approx(first.duration + last.duration, rel=0.05)
    assert times[-1] == pytest.approx(planned(found).data.stop)


def grid(n):
    """A plate of n x n nodes, each with a sensor."""
    names = tuple(str(k) for k in range(n * n))
    positions = [[x, y, 0] for x in range(n) for y in range(n)]
    lines = [tuple(range(n * k, n * k + n)) for k in range(n)] + [tuple(range(k, n * n, n)) for k in range(n)]
    corners = [(n * x + y, n * x + y + 1, n * x + n + y + 1, n * x + n + y) for x in range(n - 1) for y in range(n - 1)]
    found = Geometry(node_names=names, positions=positions, lines=tuple(lines), surfaces=tuple(corners))
    return found, [f"{name}Z+" for name in names]


@pytest.mark.parametrize(("n", "n_shapes"), [(5, 3), (20, 9), (40, 3), (70, 1), (70, 9)])
def test_motion_keeps_within_its_budget(n, n_shapes):
    geometry, names = grid(n)
    scene = scene_of(placed(geometry, names))
    pace = pace_of(scene, n_shapes)
    points = 2 * len(pace.segments) + len(pace.heads) + (n * n if pace.surface else 0)
    total = pace.periods * pace.frames * n_shapes * points
    assert total <= Swinging.MOST_POINTS
    assert pace.heads
    if len(pace.segments) < 2 * n * (n - 1):  # lines are left out only where the coarsest motion is too much
        assert (pace.periods, pace.frames) == (Swinging.FEWEST_PERIODS, Swinging.FEWEST_FRAMES)
        assert total > 0.8 * Swinging.MOST_POINTS
    assert ((pace.periods, pace.frames) == (Swinging.PERIODS, Swinging.FRAMES)) == (n == 5)
    assert (len(pace.segments) < 2 * n * (n - 1)) == (n == 70 and n_shapes == 9)
    assert pace.surface == (n * n * n_shapes < 12_000)


def view_of(page):
    import rerun.blueprint as rrb

    for part in page.contents:
        if isinstance(part, rrb.api.Container):
            yield from view_of(part)
        elif isinstance(part, rrb.Spatial3DView):
            yield part


@pytest.mark.parametrize("n_modes", [1, 3, 6])
@pytest.mark.parametrize(
    "geometry", [None, FRAME, replace(FRAME, positions=[[0, 0, 0], [0, 0, 9], [1, 0, 9], [1, 0, 0]])]
)
def test_every_shape_is_seen_whole_from_one_place(build, geometry, n_modes):
    found = build(n_modes=n_modes, n_outputs=2, n_noise=0, output_names=["2X+", "3Y+"])
    plan = planned(found, geometry)
    eyes = [view.properties["EyeControls3D"] for view in view_of(modes_page(found, plan))]
    assert len(eyes) == n_modes
    placing = {tuple(np.array(eye.position.as_arrow_array().to_pylist()).ravel().tolist()) for eye in eyes}
    assert len(placing) == 1
    position = np.array(placing.pop())
    target = np.array(eyes[0].look_target.as_arrow_array().to_pylist()).ravel()
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    scene = scene_of(placed(geometry, ["2X+", "3Y+"], ["m/s^2"] * 2))
    for mode in found.modes.system:
        furthest = envelope_of(scene.motion(mode))
        for points in (scene.positions + furthest, scene.positions - furthest):
            depth = (points - position) @ forward
            assert (depth > 0).all()
            assert (np.abs((points - position) @ up) <= ShapePanes.HALF_VIEW * depth).all()
            assert (np.abs((points - position) @ right) <= ShapePanes.HALF_VIEW * depth * 1050 / 170).all()


def test_poles_beyond_the_frame_are_not_drawn_but_stored(build, tmp_path, read):
    found = build()
    evidence = found.order_evidence
    fast = tuple(replace(point, frequency=51.0) for point in evidence.stabilisation[:3])  # half the sampling rate is 50
    changed = replace(found, order_evidence=replace(evidence, stabilisation=evidence.stabilisation + fast))
    drawn = []
    for k, result in enumerate((found, changed)):
        stored = read(save_recording(result, tmp_path / f"{k}.rrd"))
        ((row,),) = [stored.rows("/order/stabilisation/plot/poles", "time").values()]
        drawn.append(len(row["Points2D:positions"]))
        poles = stored.rows("/order/stabilisation", "model_order")
        assert sum(len(row["emac"]) for row in poles.values()) == len(result.order_evidence.stabilisation)
    assert drawn[0] == drawn[1] == len(evidence.stabilisation)
