"""Roving sensors and a roving hammer: one modal model over all set-ups, against a chain whose modes are known."""

import numpy as np
import pytest
import scipy

import modal
import okid
from okid.errors import InsufficientDataError, InvalidDataError

DT = 0.05
POLE_DAMPING = 0.015
FREQUENCIES = np.array([1.1, 3.0, 4.9])
SHAPES = np.array([[0.33, 0.59, 0.74], [0.74, 0.33, -0.59], [0.59, -0.74, 0.33]])
"""(n_modes, n_points) of a chain of three equal masses."""


def motion(force, point, sensors):
    """Exact answer of the modes to a held force at one point, by their recursions."""
    outputs = np.zeros((force.size, len(sensors)))
    for frequency, shape in zip(FREQUENCIES, SHAPES, strict=True):
        size = 2 * np.pi * frequency
        pole = size * complex(-POLE_DAMPING, np.sqrt(1.0 - POLE_DAMPING**2))
        discrete = np.exp(pole * DT)
        drive = (discrete - 1.0) / pole / pole.imag
        state = scipy.signal.lfilter([0, drive], [1, -discrete], force.astype(complex))
        outputs += np.outer(state.imag * shape[point], shape[list(sensors)])
    return outputs


def set_up(seed, point, sensors, *, level=1.0, n=900, noise=0.02):
    rng = np.random.default_rng(seed)
    force = level * rng.standard_normal(n)
    clean = motion(force, point, sensors)
    names = [f"y{k}" for k in sensors]
    values = clean + noise * clean.std(axis=0) * rng.standard_normal(clean.shape)
    return okid.Record(force, values, DT, input_names=["force"], output_names=names, name=f"set-up {seed}")


def assurance(first, second):
    return abs(np.vdot(first, second)) ** 2 / (np.vdot(first, first) * np.vdot(second, second)).real


def check_modes(result, points):
    assert len(result.modes.system) == 3
    for mode, frequency, shape in zip(result.modes.system, FREQUENCIES, SHAPES, strict=True):
        assert abs(mode.frequency - frequency) < 5 * mode.frequency_std < 0.01 * frequency
        assert abs(mode.damping_ratio - POLE_DAMPING) < 5 * mode.damping_ratio_std < POLE_DAMPING
        assert assurance(mode.shape, shape[list(points)]) > 0.999


def test_roving_sensors_give_one_model_with_the_deviations_of_all_set_ups():
    """Levels differ by 5; the second point is the reference."""
    records = [set_up(1, 2, [1, 0]), set_up(2, 2, [1, 2], level=5.0)]
    result = modal.identify(okid.join_setups(records))
    check_modes(result, [1, 0, 2])
    assert result.modes.output_names == ("y1", "y0", "y2")
    assert "set-up 1: y1, y0; set-up 2: y1, y2" in result.warnings[0]
    assert "set-ups" in [choice.what for choice in result.choices]
    alone = [modal.identify(record).modes.system for record in records]
    for joint, *own in zip(result.modes.system, *alone, strict=True):
        together = sum(mode.frequency_std**-2 for mode in own) ** -0.5
        assert joint.frequency_std == pytest.approx(together, rel=0.05)
        assert (joint.shape_std >= 0).all()


def test_a_roving_hammer_gives_all_modes():
    records = []
    for point in range(3):
        rng = np.random.default_rng(point)
        force = np.zeros(400)
        force[10] = 1.0
        clean = motion(force, point, [1, 2])
        values = clean + 1e-4 * np.abs(clean).max() * rng.standard_normal(clean.shape)
        records.append(
            okid.Record(force, values, DT, input_names=[f"hammer {point}"], output_names=["y1", "y2"], name=f"{point}")
        )
    result = modal.identify(okid.join_setups(records))
    check_modes(result, [1, 2])


def test_what_cannot_be_joined_is_refused():
    ambient = [
        okid.Record([], np.random.default_rng(k).standard_normal((200, 2)), DT, output_names=["r", f"y{k}"])
        for k in range(2)
    ]
    with pytest.raises(InvalidDataError, match="no input was measured"):
        modal.identify(okid.join_setups(ambient))
    both = [set_up(1, 2, [1, 0]), set_up(2, 2, [1, 2])]
    moved = okid.Record(both[1].inputs, both[1].outputs, DT, input_names=["other"], output_names=both[1].output_names)
    with pytest.raises(InvalidDataError, match="rove sensors or hammer"):
        modal.identify(okid.join_setups([both[0], moved]))
    nowhere = okid.Record(both[0].inputs, np.column_stack([both[0].outputs[:, 0], np.full(900, np.nan)]), DT)
    with pytest.raises((InvalidDataError, InsufficientDataError), match="output_1"):
        modal.identify(nowhere)
