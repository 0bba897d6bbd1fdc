"""Errors of the prediction follow powers of the motion where something is not linear; noise does not."""

import numpy as np
import pytest
from noise_families import noise_record
from nonlinear_chain import run_chain
from scipy.signal import lfilter

import modal
from modal.verdict.linearity import NOT_LINEAR, powers_of_motion
from okid.record import Record

DT = 0.01
GIVEN = {"observer_order": 20, "ridge": 0.0, "input_delay": 0}
"""What a search would take about the same, where a test is not about it."""


def rung(force, frequency, ratio):
    pole = np.exp((-ratio + 1j * np.sqrt(1 - ratio**2)) * 2 * np.pi * frequency * DT)
    moved = lfilter([0, 1], [1, -2 * pole.real, abs(pole) ** 2], force, axis=0)
    return moved / moved.std()


def sprung(force, *, hardening, noise, rng):
    """A mass on a spring k x (1 + hardening x^2) at 2 Hz with 2 % of damping, x of size about 1."""
    k, c = (2 * np.pi * 2.0) ** 2, 2 * 0.02 * 2 * np.pi * 2.0
    gain = np.sqrt(2 * c * k / DT)
    moved = run_chain(
        [1.0], [k], [c], gain * force[np.newaxis], DT, law=lambda d, v, t: k * hardening * d**3, n_steps=8
    )[0, :, 0]
    return moved + noise * moved.std() * rng.standard_normal(len(force))


def chance_of_powers(records, predicted):
    return powers_of_motion(records, predicted).chance


def told(result):
    return [
        words for words in result.warnings if "Something is not linear: squares and cubes of the motion make" in words
    ]


def test_a_hardening_spring_is_said_to_be_not_linear():
    """Its mode was certain some per cent off, and nothing said why, or forces that were not measured were blamed."""
    rng = np.random.default_rng(1)
    force = rng.standard_normal(3000)
    outputs = sprung(force, hardening=0.1, noise=0.02, rng=rng)
    result = modal.identify(Record(force, outputs, DT), order=8, **GIVEN)
    assert told(result)
    assert not any("not measured make most" in words for words in result.warnings)
    assert not any(mode.frequency > 3.0 for mode in result.modes.system)  # 7.1 Hz, three times its own, was one


def test_the_same_mass_on_a_linear_spring_is_not():
    rng = np.random.default_rng(1)
    force = rng.standard_normal(3000)
    record = Record(force, sprung(force, hardening=0.0, noise=0.02, rng=rng), DT)
    assert not told(modal.identify(record, order=8, **GIVEN))


def left_alone(kind, seed):
    """A linear record and its motion without the noise, which knows nothing of it."""
    rng = np.random.default_rng(seed)
    force, noise = rng.standard_normal(6000), rng.standard_normal((6000, 2))
    if kind == "gusts":
        level = np.exp(np.convolve(rng.standard_normal(6000), np.ones(300) / np.sqrt(300), "same"))
        force, noise = force * level, noise * level[:, np.newaxis]
    if kind == "narrow":
        noise = rung(noise, 6.0, 0.003) + rung(noise[::-1], 23.0, 0.005)
    if kind == "heavy tails":
        force, noise = rng.standard_t(2.5, 6000), rng.standard_t(2.5, (6000, 2))
    if kind == "bursts":
        force = force * ((np.arange(6000) // 700) % 2)
    if kind == "noisy input":  # what is measured is less to be believed where it is quiet
        force = force * np.repeat(np.exp(rng.standard_normal(30)), 200)
        true, force = force, force + 0.1 * force.std() * rng.standard_normal(6000)
        return Record(force, rung(true, 5.0, 0.05) + 0.02 * noise[:, 0], DT), rung(force, 5.0, 0.05)
    motion = np.column_stack([rung(force, 5.0, 0.01), rung(force, 5.0, 0.01) + rung(force, 17.0, 0.01)])
    return Record(force, motion + 0.3 * noise, DT), motion


@pytest.mark.parametrize("kind", ["white", "gusts", "narrow", "heavy tails", "bursts", "noisy input"])
def test_noise_that_knows_nothing_of_the_motion_is_not_accused(kind):
    """Gusts make noise and motion strong together; noise of narrow bands is far from white."""
    chances = []
    for seed in range(6):
        record, motion = left_alone(kind, seed)
        chances.append(chance_of_powers([record], [Record(record.inputs, motion, DT)]))
    assert min(chances) > NOT_LINEAR
    assert np.median(chances) > 0.1


def test_rounding_tells_nothing():
    force = np.random.default_rng(6).standard_normal(4000)
    record = Record(force, force, DT)
    for run in (force, 0.0 * force, force - 0.1):
        assert chance_of_powers([record], [Record(force, run, DT)]) == 1.0


def test_a_stub_of_a_record_tells_nothing():
    force, noise = np.random.default_rng(5).standard_normal((2, 4000, 1))
    for bent, least, most in ((0.1, 0.0, 1e-6), (0.0, 0.01, 1.0)):
        record = Record(force, force + bent * force**3 + noise, DT)
        run = Record(force, (1.0 + 3.0 * bent) * force, DT)
        stubs = [Record(one.inputs[:1], one.outputs[:1], DT) for one in (record, run)]
        assert least <= chance_of_powers([record, stubs[0]], [run, stubs[1]]) <= most
        assert chance_of_powers([stubs[0]], [stubs[1]]) == 1.0


def test_a_model_that_is_a_little_off_is_no_sign_of_powers():
    """What it leaves follows the motion, and so does the cube of a motion that is not normal, as that of two levels."""
    rng = np.random.default_rng(3)
    force = np.sign(rng.standard_normal(6000))
    record = Record(force, force + 0.1 * rng.standard_normal(6000), DT)
    assert chance_of_powers([record], [Record(force, 0.9 * force, DT)]) > NOT_LINEAR


def test_a_model_that_is_too_small_beside_hidden_forces_is_no_sign_of_powers():
    """It leaves what is linear in the motion long before, and powers of the motion over its level follow that."""
    case = noise_record("hidden", system=84004, record=0)
    record = Record(case.inputs, case.outputs, case.system.dt)
    assert not told(modal.identify(record, observer_order=8, ridge=3e-5, order=4))


def test_errors_that_last_longer_than_a_block_are_not_accused():
    """A position under a force, both sensor and force noise summed up: chances down to 9e-6 of 14 such records."""
    chances = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        force, drift, walk = rng.standard_normal((3, 5000))
        speed = np.cumsum(force) * DT
        motion = np.cumsum(speed + 0.2 * np.cumsum(rung(force, 3.0, 0.01)) * DT) * DT
        slow = lfilter([1.0], [1.0, -0.9995], drift + 0.1 * walk)
        record = Record(force, motion + 0.05 * motion.std() * slow / slow.std(), DT)
        chances.append(chance_of_powers([record], [Record(force, motion, DT)]))
    assert min(chances) > 1e-3


@pytest.mark.parametrize("echo", [30, 100])
def test_an_echo_that_the_model_lacks_is_linear(echo):
    """A periodic force has squares and cubes alike what it was 30 samples before: chances of 1e-12 and less."""
    told, follows, n_samples = 0, 0, 4000
    for seed in range(2):
        rng = np.random.default_rng(seed)
        force = np.tile(rng.standard_normal(200), n_samples // 200 + 2)
        motion = rung(force, 5.0, 0.01) + rung(force, 17.0, 0.01)
        outputs = motion + np.roll(force, echo) + 0.5 * rng.standard_normal(force.size)
        record, run = (Record(force[-n_samples:], moved[-n_samples:], DT) for moved in (outputs, motion))
        told += powers_of_motion([record], [run]).told
        bent = Record(record.inputs, record.outputs + 0.5 * run.outputs**2, DT)
        follows += powers_of_motion([bent], [run]).told
    assert told == 0
    assert bool(follows) == (echo < 80)  # what goes back further than can be asked hides it


def test_short_records_tell_too():
    """The level of rows before was that of one row where each record began, and a few rows ruled the test."""
    force, noise = np.random.default_rng(0).standard_normal((2, 60, 110))
    told = [Record(u, u + 0.3 * u**3 + e, DT) for u, e in zip(force, noise, strict=True)]
    assert chance_of_powers(told, [Record(u, 1.9 * u, DT) for u in force]) < NOT_LINEAR
    linear = [Record(u, u + e, DT) for u, e in zip(force, noise, strict=True)]
    assert chance_of_powers(linear, [Record(u, u, DT) for u in force]) > 1e-3


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("never", [True, False])
def test_outputs_that_share_no_row_tell_nothing(never):
    force, noise = np.random.default_rng(0).standard_normal((2, 3000, 1))
    outputs = np.hstack([force, force]) + noise
    outputs[::2, 0] = np.nan
    outputs[slice(None) if never else slice(1, None, 2), 1] = np.nan
    assert chance_of_powers([Record(force, outputs, DT)], [Record(force, np.hstack([force, force]), DT)]) == 1.0


def test_one_short_record_is_asked():
    """Of fewer than 800 rows nothing was told."""
    chances = []
    for force, noise in np.random.default_rng(0).standard_normal((8, 2, 780)):
        bent, straight = force + 0.3 * force**3 + noise, force + noise
        chances.append(chance_of_powers([Record(force, bent, DT)], [Record(force, 1.9 * force, DT)]))
        assert chance_of_powers([Record(force, straight, DT)], [Record(force, force, DT)]) > 1e-3
    assert np.median(chances) < 1e-3
    assert min(chances) < 1e-6


@pytest.mark.parametrize(("law", "size"), [("spring", 0.02), ("friction", 0.1)])
def test_what_is_weak_or_acts_on_the_velocity_is_told(law, size):
    """A spring of 2 % was certain 13 deviations off, friction of 10 % with damping 43 off, both without a word."""
    rng = np.random.default_rng(6)
    force, (k, c) = rng.standard_normal(5000), ((2 * np.pi * 4.0) ** 2, 2 * 0.01 * 2 * np.pi * 4.0)
    gain = np.sqrt(2 * c * k / DT)  # for motion of the size 1
    of = {"spring": lambda d, v, t: size * k * d**3, "friction": lambda d, v, t: size * k * np.tanh(10 * v / k**0.5)}
    moved = run_chain([1.0], [k], [c], gain * force[np.newaxis], DT, law=of[law], n_steps=8)[0, :, 0]
    outputs = moved + 0.02 * moved.std() * rng.standard_normal(5000)
    assert told(modal.identify(Record(force, outputs, DT), order=2, **GIVEN))


def test_rows_of_blows_that_are_not_asked_leave_no_force():
    """Then the force stands still in all rows that are: it is neither divided by nothing nor asked."""
    rng = np.random.default_rng(5)
    force = np.zeros((4000, 1))
    force[500::1000] = 1.0
    predicted = rung(force + 1e-3 * rng.standard_normal(force.shape), 2.0, 0.02)
    record = Record(force, predicted + 0.01 * rng.standard_normal(force.shape), DT)
    alone = Record(force, np.where(force > 0.0, np.nan, predicted), DT)
    with np.errstate(all="raise"):
        assert powers_of_motion([record], [alone]).chance > NOT_LINEAR
