"""The stick picture: places in sensor order, one scale a unit, one phase for all."""

from dataclasses import replace

import numpy as np
import pytest

from modal.recording import save_recording
from modal.recording.shapes import sticks


def test_sensors_keep_their_place_in_the_order_of_all():
    first, second = sticks(["m", "rad", "m"])
    assert (first.unit, first.outputs, second.outputs) == ("m", (0, 2), (1,))
    assert first.rest[:, 0].tolist() == [-1.0, 1.0]
    assert second.rest[:, 0].tolist() == [0.0]
    assert first.rest[0, 1] != second.rest[0, 1]
    assert np.abs(sticks(["m"])[0].rest).max() == 0


@pytest.fixture
def moving(build, tmp_path, read):
    def heights(shape, units):
        found = build(n_modes=1, n_outputs=4, units=units, n_noise=0)
        modes = replace(found.modes, modes=(replace(found.modes.modes[0], shape=np.asarray(shape, dtype=complex)),))
        stored = read(save_recording(replace(found, modes=modes), tmp_path / "run.rrd", existing="replace"))
        heads = [
            np.array(stored.frames(f"/modes/shape/01/{k}/heads", "Points3D:positions"))[:, :, 2]
            for k in range(len(set(units)))
        ]
        return [part / np.abs(part).max() for part in heads]

    return heights


def test_each_unit_has_its_own_scale_and_the_phase_between_units_is_kept(moving):
    accelerations, angles = moving([1.0, 0.5, -0.001, 0.002], ["m/s^2", "m/s^2", "rad", "rad"])
    np.testing.assert_allclose(accelerations[0], [1.0, 0.5], atol=1e-6)
    np.testing.assert_allclose(angles[0], [-0.5, 1.0], atol=1e-6)
    accelerations, angles = moving([1.0, 0.5, 0.001, -0.002], ["m/s^2", "m/s^2", "rad", "rad"])
    np.testing.assert_allclose(angles[0], [0.5, -1.0], atol=1e-6)


def test_a_quarter_period_of_phase_is_seen_as_one(moving):
    (heights,) = moving([1.0, 1.0j, -1.0, 0.0], ["m"] * 4)
    np.testing.assert_allclose(heights[0], [1.0, 0.0, -1.0, 0.0], atol=1e-6)
    # x(t) = Re(shape exp(i phase)): a quarter of a period later the second sensor is down
    np.testing.assert_allclose(heights[8], [0.0, -1.0, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(heights[32], heights[0], atol=1e-6)


def test_the_animation_spans_the_record(build, tmp_path, read):
    found = build(n_records=2)
    stored = read(save_recording(found, tmp_path / "run.rrd"))
    times = np.sort(
        np.concatenate(
            [
                batch.column("time").to_numpy(zero_copy_only=False).astype("timedelta64[ns]").astype(float) / 1e9
                for batch in stored.batches("/modes/shape/01/0/heads", static=False)
            ]
        )
    )
    series, _ = stored.series("/fit/output/floor_1/measured")
    assert times[0] == pytest.approx(series[0])
    assert times[-1] == pytest.approx(series[-1])


def test_poles_beyond_the_frame_are_not_drawn_but_stored(build, tmp_path, read):
    found = build()
    evidence = found.order_evidence
    fast = tuple(replace(point, frequency=51.0) for point in evidence.stabilisation[:3])  # half the sampling rate is 50
    changed = replace(found, order_evidence=replace(evidence, stabilisation=evidence.stabilisation + fast))
    drawn = []
    for k, result in enumerate((found, changed)):
        stored = read(save_recording(result, tmp_path / f"{k}.rrd"))
        drawn.append(len(stored.static("/order/stabilisation/plot/poles", "Points2D:positions")))
        poles = stored.rows("/order/stabilisation", "model_order")
        assert sum(len(row["emac"]) for row in poles.values()) == len(result.order_evidence.stabilisation)
    assert drawn[0] == drawn[1] == len(evidence.stabilisation)
