"""Roving sensors and a roving hammer: one modal model over all set-ups, against a chain whose modes are known."""

import re
from dataclasses import replace

import numpy as np
import pytest
import roving
import scipy

import modal
import okid
from modal.identification.set_ups import _averaged
from modal.modes.mode import Mode
from modal.modes.response_synthesis import continuous_residue
from modal.verdict.excitation import undriven_doubt
from okid.errors import IdentificationError, InvalidDataError

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
    """Levels differ by 5, the second recorder starts 4 samples early and its force amplifier says half; y1 is shared.

    Delay and gain belong to a set-up, so neither may be seen in the joint shapes and residues.
    """
    late = set_up(2, 2, [1, 2], level=5.0, n=904, noise=0.01)
    second = okid.Record(
        0.5 * late.inputs[4:],
        late.outputs[:-4],
        DT,
        input_names=["force"],
        output_names=late.output_names,
        name="set-up 2",
    )
    records = [set_up(1, 2, [1, 0], noise=0.01), second]
    orders = {"observer_order": 20, "ridge": 1e-6, "order": 6}
    result = modal.identify(okid.join_setups(records), **orders)
    assert any("set-up 2: force 4 samples" in choice.value for choice in result.choices)
    assert any(re.search(r"set-up 2 answers force (1\.99|2\.0)\d* times", text) for text in result.warnings)
    for mode, shape in zip(result.modes.system, SHAPES, strict=True):
        residue = 2j * mode.pole.imag * continuous_residue(mode, DT)[:, 0]
        np.testing.assert_allclose(residue, shape[2] * shape[[1, 0, 2]], atol=0.01)
    check_modes(result, [1, 0, 2])
    assert result.modes.output_names == ("y1", "y0", "y2")
    assert not any("filled" in text or "Not every" in text for text in result.warnings)  # it was meant so
    chosen = {choice.what: choice for choice in result.choices}
    assert chosen["set-ups"].value == "2: set-up 1: y1, y0; set-up 2: y1, y2"
    assert "given" not in chosen["input delay"].reason + chosen["frequency band"].reason
    alone = [modal.identify(record, **orders).modes.system for record in records]
    for joint, *own in zip(result.modes.system, *alone, strict=True):
        together = sum(mode.frequency_std**-2 for mode in own) ** -0.5
        assert 0.8 * together < joint.frequency_std < 1.02 * together  # surer: what y1 shows of a mode is common
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
    result = modal.identify(okid.join_setups(records), observer_order=20, ridge=1e-6, order=6)
    check_modes(result, [1, 2])


def test_what_cannot_be_joined_is_refused():
    noise = [
        okid.Record([], np.random.default_rng(k).standard_normal((200, 2)), DT, output_names=["r", f"y{k}"])
        for k in range(2)
    ]
    with pytest.raises(IdentificationError, match="no mode in common"):
        modal.identify(okid.join_setups(noise), observer_order=6, ridge=1e-3, order=4)
    both = [set_up(1, 2, [1, 0]), set_up(2, 2, [1, 2])]
    moved = okid.Record(both[1].inputs, both[1].outputs, DT, input_names=["other"], output_names=both[1].output_names)
    with pytest.raises(InvalidDataError, match="rove sensors or hammer"):
        modal.identify(okid.join_setups([both[0], moved]))


def test_ambient_set_ups_are_scaled_by_their_references(tmp_path):
    """Unknown forces at all points, seven times as large in the second set-up."""
    records = []
    for seed, sensors, level in ((1, [1, 0], 1.0), (2, [1, 2], 7.0)):
        rng = np.random.default_rng(seed)
        clean = sum(motion(level * rng.standard_normal(4000), point, sensors) for point in range(3))
        values = clean + 0.02 * clean.std(axis=0) * rng.standard_normal(clean.shape)
        names = [f"y{k}" for k in sensors]
        records.append(okid.Record([], values, DT, output_names=names, name=f"set-up {seed}"))
    result = modal.identify(okid.join_setups(records), observer_order=11, order=8)
    assert len(result.modes.system) == 3
    for mode, frequency, truth in zip(result.modes.system, FREQUENCIES, SHAPES, strict=True):
        assert abs(mode.frequency - frequency) < 3 * mode.frequency_std < 0.01 * frequency
        assert abs(mode.damping_ratio - POLE_DAMPING) < 3 * mode.damping_ratio_std < POLE_DAMPING
        shape = truth[[1, 0, 2]] / truth[[1, 0, 2]][np.abs(mode.shape).argmax()]
        assert (np.abs(mode.shape - shape) <= 5 * mode.shape_std + 1e-12).all()  # the largest is 1 to rounding
    (chosen,) = [choice for choice in result.choices if choice.what == "set-ups"]
    assert chosen.value == "2: set-up 1: y1, y0; set-up 2: y1, y2"
    assert not any("inputs" in choice.reason for choice in result.choices if choice.what == "input delay")
    assert not any("Not every" in text for text in result.warnings)
    assert (
        modal.load(result.save(tmp_path / "result.npz")).modes.system[0].frequency == result.modes.system[0].frequency
    )


def ambient_mode(damping, doubts=()):
    """A mode of one set-up, whose damping ratio has a variance in proportion to it, as what noise drives."""
    return Mode(
        pole=2 * np.pi * 4.6 * complex(-damping, np.sqrt(1 - damping**2)),
        kind="oscillatory",
        frequency=4.6,
        damping_ratio=damping,
        frequency_std=0.005,
        damping_ratio_std=float(np.sqrt(damping * 2e-6 / 2e-3)) * 0.6,
        shape=np.ones(2),
        participation=np.zeros(0),
        shape_std=np.array([0.0, 0.02]),
        repeatability=0.97,
        probability=0.55 if doubts else 0.99,
        verdict="doubtful" if doubts else "system",
        doubts=doubts,
    )


def averaged(modes):
    return _averaged(modes[0], modes, np.ones(2), np.full(2, 1e4), dt=0.01, duration=180.0)


def test_what_one_set_up_cannot_tell_from_a_line_all_may():
    """The lowest mode was lost in 8 of 12 chains of five: each set-up doubted it, all together had no cause to."""
    dampings = (0.0012, 0.002, 0.0028)
    modes = [ambient_mode(damping) for damping in dampings]
    lines = [undriven_doubt(mode, np.nan, 60.0) for mode in modes]
    assert lines[0]
    assert lines[1]
    doubted = [replace(m, **_doubted("pole", line[0])) if line else m for m, line in zip(modes, lines, strict=True)]
    joint = averaged(doubted)
    assert (joint.verdict, joint.doubts) == ("system", ())
    assert joint.probability > 0.9
    assert joint.damping_ratio == pytest.approx(3 / sum(1 / damping for damping in dampings))
    line = [replace(ambient_mode(2e-5 * k), **_doubted("pole", "a line")) for k in (1, 2, 3)]
    assert "an undamped line" in averaged(line).reason
    assert averaged(line).verdict == "doubtful"
    heard = [replace(mode, **_doubted("data", "no peak")) for mode in modes]
    assert averaged(heard).verdict == "doubtful"


def _doubted(what, words):
    return {"verdict": "doubtful", "probability": 0.55, "doubts": ((what, words),), "reason": words}


@pytest.mark.slow
def test_the_trigger_of_each_blow_leaves_modal_masses_alone():
    """Delays of 0, 2, 5 and 3 samples: every residue is that of the chain, real but for the pole."""
    sensors = [1, 3]
    result = modal.identify(okid.join_setups(roving.hammer_blows([0, 2, 5, 3], sensors=sensors, n=400)))
    assert result.input_delay == (0, 2, 5, 3)
    assert len(result.modes.system) == 4
    for mode, shape in zip(result.modes.system, roving.SHAPES.T, strict=True):
        residue = 2j * mode.pole.imag * continuous_residue(mode, roving.DT)
        np.testing.assert_allclose(residue, np.outer(shape[sensors], shape), atol=0.01)


def test_blows_at_several_points_under_one_name_are_told():
    """One mode of six was found, and nothing said why."""
    blows = roving.hammer_blows((0, 0), sensors=(0, 1, 2, 3), n=400)
    given = {"observer_order": 20, "order": 8, "ridge": 1e-4}
    roved = modal.identify([replace(blow, input_names=("hammer",)) for blow in blows], **given)
    assert any("name it after the point" in text for text in roved.warnings)
    fixed = [replace(blows[0], outputs=blows[0].outputs * (1 + 1e-3 * k), name=f"{k}") for k in range(2)]
    assert not any("belong together" in text for text in modal.identify(fixed, **given).warnings)


def test_loud_set_ups_do_not_draw_the_shapes_of_quiet_ones():
    """Forces from 0.5 to 10 and weak modes: a joint fit to simulated outputs gave a MAC of 0.964 here.

    Noise of 2 % is what no fit can explain; outputs that were simulated would make it look smaller.
    """
    rng = np.random.default_rng(90006)
    frequencies = np.sort(rng.uniform(3, 40, 4))
    damping, shapes = np.exp(rng.uniform(np.log(0.004), np.log(0.02), 4)), rng.standard_normal((32, 4)) / np.sqrt(32)
    rng = np.random.default_rng(5)
    records = []
    for k, level in enumerate((1.0, 10.0, 0.5, 4.0)):
        sensors = [0, 1, *range(2 + 4 * k, 6 + 4 * k)]
        force = level * rng.standard_normal(1200)
        outputs = np.zeros((1200, 6))
        for frequency, ratio, shape in zip(frequencies, damping, shapes.T, strict=True):
            pole = 2 * np.pi * frequency * complex(-ratio, np.sqrt(1 - ratio**2))
            discrete = np.exp(0.01 * pole)
            state = scipy.signal.lfilter([0, (discrete - 1) / pole], [1, -discrete], force.astype(complex))
            outputs += np.outer(state.real * shape[5], shape[sensors])
        outputs += 0.02 * outputs.std(axis=0) * rng.standard_normal(outputs.shape)
        names = [f"y{sensor}" for sensor in sensors]
        records.append(okid.Record(force, outputs, 0.01, input_names=["force"], output_names=names, name=f"{k}"))
    result = modal.identify(okid.join_setups(records), observer_order=32, ridge=0.0, order=8)
    assert 0.96 < result.fit.cross_validated.min() <= result.fit.cross_validated.max() < 0.983
    modes = result.modes
    order = [modes.output_names.index(f"y{k}") for k in range(18)]
    for frequency, ratio, shape in zip(frequencies, damping, shapes.T, strict=True):
        mode = min(modes.system, key=lambda one, f=frequency: abs(one.frequency - f))
        assert abs(mode.frequency - frequency) < 4 * mode.frequency_std
        assert abs(mode.damping_ratio - ratio) < 4 * mode.damping_ratio_std
        assert assurance(mode.shape[order], shape[:18]) > 0.99
