"""A line whose frequency wanders has a steady size, a resonance under random forces has not."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.signal

from modal.identification.pipeline import identify
from modal.modes.mode import ModalModel, Mode
from modal.verdict.resonance import steady_lines, told_of_lines_beside, told_of_steady_lines
from okid.record import Record

DT = 0.01


def answer(rng, frequency, damping, n_samples):
    """A resonance of unit size under white noise."""
    pole = np.exp((-damping + 1j) * 2.0 * np.pi * frequency * DT)
    moved = scipy.signal.lfilter([1.0], [1.0, -2.0 * pole.real, abs(pole) ** 2], rng.standard_normal(n_samples + 4000))
    return moved[4000:] / moved[4000:].std()


def wandering(rng, frequency, share, n_samples, *, swing=0.0):
    """A sinusoid of unit size whose frequency wanders by this share of it within seconds, its size by `swing`."""
    slow = scipy.signal.filtfilt(*scipy.signal.butter(2, 0.005), rng.standard_normal(n_samples + 4000))[2000:-2000]
    phase = 2.0 * np.pi * DT * np.cumsum(frequency * (1.0 + share * slow / slow.std()))
    size = 1.0 + swing * np.sqrt(2.0) * np.sin(0.9 * DT * np.arange(n_samples))
    return np.sqrt(2.0) * size * np.cos(phase)


def system(*modes, gains=()):
    """A model of modes of the system: frequency, damping ratio, shape; of one input where there are gains."""
    made = [
        Mode(
            pole=2.0 * np.pi * f * (-z + 1j * np.sqrt(1.0 - z * z)), kind="oscillatory", frequency=f, damping_ratio=z,
            shape=np.array(shape), participation=np.array(gains[i : i + 1]), verdict="system", probability=0.99,
            reason="found again",
        )
        for i, (f, z, shape) in enumerate(modes)
    ]  # fmt: skip
    return ModalModel(modes=tuple(made), dt=DT, indicator_caution=0.1)


@pytest.mark.parametrize("share", [0.003, 0.01])
@pytest.mark.parametrize("swing", [0.0, 0.2])
def test_a_line_that_wanders_is_none_of_the_modes_beside_it(share, swing):
    rng = np.random.default_rng(1)
    outputs = np.outer(answer(rng, 11.0, 0.01, 12_000), [1.0, 0.5]) + 0.1 * rng.standard_normal((12_000, 2))
    outputs += np.outer(wandering(rng, 25.0, share, 12_000, swing=swing), [0.4, -1.0])
    # the one pole that stands on it is narrower than where it wanders
    model = system((11.0, 0.01, [1.0, 0.5]), (25.02, 0.0008, [0.4, -1.0]))
    told = told_of_steady_lines(model, [Record([], outputs, DT)])
    assert [mode.verdict for mode in told.modes] == ["system", "doubtful"]
    assert "a machine line" in told.modes.modes[1].reason
    assert told.modes.modes[1].probability < 0.8
    assert len(told.warnings) == 1
    assert "11" not in told.warnings[0]


def test_a_mode_with_such_a_line_within_stays():
    rng = np.random.default_rng(2)
    outputs = np.outer(answer(rng, 11.0, 0.01, 12_000), [1.0, 0.5]) + 0.1 * rng.standard_normal((12_000, 2))
    outputs += np.outer(wandering(rng, 11.05, 0.001, 12_000), [0.4, -1.0])
    model = system((11.0, 0.01, [1.0, 0.5]), (11.05, 0.0008, [0.4, -1.0]))
    (line,) = steady_lines(model, [Record([], outputs, DT)])
    assert line.modes == (1,)
    assert 10.9 < line.low < line.high < 11.2


def test_modes_under_random_forces_are_not_steady():
    """Light, close, of few independent values, in gusts, and in two records: at most one record in a hundred."""
    alarms = 0
    for seed in range(60):
        rng = np.random.default_rng([3, seed])
        parts = [
            answer(rng, f, z, 6000) for f, z in ((4.0, 0.0005), (9.0, 0.003), (9.1, 0.003), (21.0, 0.01), (33.0, 0.02))
        ]
        outputs = np.column_stack(parts) @ rng.standard_normal((5, 3)) + 0.1 * rng.standard_normal((6000, 3))
        if seed % 3 == 0:
            outputs *= np.exp(0.5 * np.sin(0.3 * DT * np.arange(6000)))[:, np.newaxis]
        shapes = rng.standard_normal((5, 3))
        frequencies, damping = (4.0, 9.0, 9.1, 21.0, 33.0), (0.0005, 0.003, 0.003, 0.01, 0.02)
        model = system(*zip(frequencies, damping, shapes, strict=True))
        record = Record([], outputs, DT)
        alarms += bool(steady_lines(model, [record] if seed % 2 else [record.samples(2500), record]))
    assert alarms <= 2  # of 60 with a chance of 0.01, five times in a thousand more


def test_a_record_of_few_independent_values_cannot_tell():
    rng = np.random.default_rng(4)
    model = system((5.0, 0.001, [1.0]))
    outputs = wandering(rng, 5.0, 0.001, 1500)[:, np.newaxis] + 0.5 * answer(rng, 5.0, 0.001, 1500)[:, np.newaxis]
    assert steady_lines(model, [Record([], outputs, DT)]) == ()


def test_a_machine_whose_speed_wanders_is_no_mode_of_the_system():
    """It was one, with probability 0.99."""
    rng = np.random.default_rng(5)
    outputs = np.outer(answer(rng, 11.0, 0.01, 8000), [1.0, 0.5]) + 0.1 * rng.standard_normal((8000, 2))
    outputs += np.outer(wandering(rng, 25.0, 0.003, 8000), [0.4, -1.0])
    result = identify(Record([], outputs, DT), observer_order=64, ridge=3e-5, order=8)
    assert [round(mode.frequency) for mode in result.modes.system] == [11]
    assert any("keeps its size" in words for words in result.warnings)
    assert not any(abs(mode.frequency - 25.0) < 1.0 and mode.probability > 0.6 for mode in result.modes)


def driven(rng, frequency, damping, force):
    """Answer of a resonance with the participation 1 to a force."""
    pole = np.exp(2.0 * np.pi * frequency * DT * (-damping + 1j * np.sqrt(1.0 - damping**2)))
    return 2.0 * scipy.signal.lfilter([0.0, 1.0], [1.0, -pole], force).real


def test_beside_measured_forces_a_line_that_wanders_is_none_of_their_modes():
    """It was in no sentence."""
    rng = np.random.default_rng(6)
    force = rng.standard_normal(12_000)
    motion = np.outer(driven(rng, 11.0, 0.01, force), [1.0, 0.5])
    left = 0.1 * rng.standard_normal((12_000, 2)) + 3.0 * np.outer(wandering(rng, 25.0, 0.003, 12_000), [0.4, -1.0])
    model = system((11.0, 0.01, [1.0, 0.5]), (25.02, 0.0008, [0.4, -1.0]), gains=[1.0, 0.01])
    told = told_of_lines_beside(model, [Record(force, motion + left, DT)], [left])
    assert [mode.verdict for mode in told.modes] == ["system", "doubtful"]
    assert told.modes.modes[1].reason.startswith("on a machine line")
    (said,) = told.warnings
    assert said.startswith("A line wanders over 24.")
    assert "11" not in said


@pytest.mark.parametrize("share", [0.0, 0.001])
def test_a_mode_that_the_forces_drive_stays_with_a_line_within(share):
    rng = np.random.default_rng(7)
    force = rng.standard_normal(12_000)
    motion = np.outer(driven(rng, 11.0, 0.01, force), [1.0, 0.5])
    left = 0.1 * rng.standard_normal((12_000, 2)) + np.outer(wandering(rng, 11.05, share, 12_000), [1.0, 0.5])
    model = system((11.0, 0.01, [1.0, 0.5]), (11.05, 0.0008, [1.0, 0.5]), gains=[1.0, 1e-3])
    told = told_of_lines_beside(model, [Record(force, motion + left, DT)], [left])
    assert [mode.verdict for mode in told.modes] == ["system", "doubtful"]
    assert len(told.warnings) == 1


def test_multiples_of_a_speed_are_named_beside_measured_forces():
    rng = np.random.default_rng(8)
    force, noise = rng.standard_normal(8000), 0.3 * rng.standard_normal((8000, 2))
    left = noise + sum(np.outer(wandering(rng, f, 0.0, 8000), [0.5, 1.0]) for f in (7.0, 14.0, 21.0))
    model = system((11.0, 0.01, [1.0, 0.5]), gains=[1.0])
    motion = np.outer(driven(rng, 11.0, 0.01, force), [1.0, 0.5])
    (said,) = told_of_lines_beside(model, [Record(force, motion + left, DT)], [left]).warnings
    assert said.startswith("Three lines stand at 7, 14 and 21 Hz (7, 14 and 21 Hz are multiples of 7 Hz)")


def test_what_follows_a_tone_of_the_forces_is_no_line():
    rng = np.random.default_rng(9)
    tone = np.sin(2.0 * np.pi * 11.2 * DT * np.arange(8000))
    force, noise = tone + 0.1 * rng.standard_normal(8000), 0.1 * rng.standard_normal((8000, 2))
    motion = np.outer(driven(rng, 11.0, 0.01, force), [1.0, 0.5])
    model = system((11.0, 0.01, [1.0, 0.5]), gains=[0.9])
    told = told_of_lines_beside(model, [Record(force, motion + noise, DT)], [0.1 * motion + noise])
    assert told.warnings == ()
    assert told.modes.modes == model.modes


def test_the_free_motion_of_a_driven_mode_that_hardly_decays_is_no_line():
    """What it moved with before the record begins is left beside what the forces make, and stays a sinusoid."""
    rng = np.random.default_rng(12)
    force, noise = rng.standard_normal(6000), 0.1 * rng.standard_normal((6000, 2))
    shape, damping = [1.0, 0.5], 1e-6
    free = 2.0 * np.cos(2.0 * np.pi * 11.0 * DT * np.arange(6000))
    left = noise + np.outer(free, shape)
    record = Record(force, np.outer(driven(rng, 11.0, damping, force), shape) + left, DT)
    told = told_of_lines_beside(system((11.0, damping, shape), gains=[1.0]), [record], [left])
    assert told.warnings == ()
    assert [mode.verdict for mode in told.modes] == ["system"]
    told = told_of_lines_beside(system((17.0, damping, shape), gains=[1.0]), [record], [left])
    assert told.warnings[0].startswith("A line stands at 11 Hz")


def test_a_line_that_an_uncertain_pole_follows_by_chance_is_one_all_the_same():
    """What that pole makes of the forces hides the line's steady size in what is left, and is no motion of a mode."""
    rng = np.random.default_rng(13)
    force, noise = rng.standard_normal(12_000), 0.1 * rng.standard_normal((12_000, 2))
    shape, line = [0.4, -1.0], wandering(rng, 25.0, 0.003, 12_000)
    made = np.outer(driven(rng, 25.02, 0.003, force), shape)
    seen = 0.7 * made.std() * np.outer(line, shape) + noise
    model = system((25.02, 0.003, shape), gains=[1.0])
    uncertain = replace(model, modes=(replace(model.modes[0], verdict="doubtful"),))
    (said,) = told_of_lines_beside(uncertain, [Record(force, seen, DT)], [seen - made]).warnings
    assert said.startswith("A line wanders over 24.")
    assert steady_lines(model, [Record([], seen - made, DT)], everywhere=True) == ()


def test_what_unmeasured_forces_make_is_no_line():
    """Of forces that were measured a tenth is missed; of as many records without a line hardly one may name one."""
    shapes = np.array([[1.0, 0.5], [0.4, -1.0], [-0.7, 0.6]])
    alarms = 0
    for seed in range(40):
        rng = np.random.default_rng([10, seed])
        forces = rng.standard_normal((2, 5000))
        both = [np.column_stack([driven(rng, f, 0.008, force) for f in (6.0, 13.0, 31.0)]) @ shapes for force in forces]
        left = 0.1 * both[0] + (0.5 if seed % 2 else 0.0) * both[1] + 0.1 * rng.standard_normal((5000, 2))
        model = system(*((f, 0.008, c) for f, c in zip((6.0, 13.0, 31.0), shapes, strict=True)), gains=[0.9] * 3)
        told = told_of_lines_beside(model, [Record(forces[0], both[0] + left, DT)], [left])
        alarms += bool(told.warnings) or any(mode.verdict != "system" for mode in told.modes)
    assert alarms == 0


def test_a_motor_beside_a_shaker_is_named():
    """Nothing was said of it."""
    rng = np.random.default_rng(11)
    force = rng.standard_normal(4000)
    outputs = np.outer(driven(rng, 11.0, 0.01, force), [1.0, 0.5]) + 0.1 * rng.standard_normal((4000, 2))
    outputs += 4.0 * np.outer(wandering(rng, 25.0, 0.003, 4000), [0.4, -1.0])
    result = identify(Record(force, outputs, DT), observer_order=91, ridge=3e-4, order=8)
    assert [round(mode.frequency) for mode in result.modes.system] == [11]
    assert any(words.startswith("A line wanders over 24.") for words in result.warnings)
