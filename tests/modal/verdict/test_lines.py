"""What inputs that are a few tones can support, noise that is no error, and what no input leaves open."""

import numpy as np
import pytest
import scipy.signal
from hard_records import FAMILIES
from structures import random_excitation

from era.realisation import Realisation
from era.simulation import simulate
from modal.identification.pipeline import identify
from modal.modes.extraction import extract_modes
from modal.modes.mode import ModalModel, Mode
from modal.verdict.excitation import between_lines, beyond_inputs, line_doubt
from modal.verdict.probability import LEAST_HEIGHT, peak_doubt
from modal.verdict.resonance import standing_out
from okid.record import Record


def identified(family, seed, **changes):
    made = FAMILIES[family](seed, **changes)
    return made, identify(Record(made.inputs, made.outputs, made.dt))


def called(made, result):
    """How many of the true modes are called."""
    found = np.array([mode.frequency for mode in result.modes.system])
    return sum(bool((np.abs(found - f) < 0.01 * f).any()) for f in made.frequencies)


def test_tones_make_no_mode():
    _, result = identified("tones", 2, n_samples=3000)
    assert result.modes.system == ()
    assert any("hardly more than" in warning for warning in result.warnings)


def test_what_rings_between_the_tones_is_a_mode():
    made, result = identified("stepped_sine", 1, n_samples=4000)
    assert called(made, result) == made.frequencies.size == len(result.modes.system)


@pytest.mark.parametrize("seed", [pytest.param(0, marks=pytest.mark.slow), 1])
def test_noise_as_large_as_the_motion_takes_no_mode_away(seed):
    made, result = identified("low_fit", seed, n_samples=4000)
    assert result.fit.mean < 0.5
    assert called(made, result) == made.frequencies.size == len(result.modes.system)
    assert "The modes hold all the same: each is judged by itself" in " ".join(result.warnings)
    assert "no mode is certain" not in " ".join(result.warnings)


def test_noise_as_large_as_the_motion_takes_no_mode_away_where_no_input_was_measured():
    made = FAMILIES["ambient"](3, n_samples=5000)
    noise = np.random.default_rng(3).standard_normal(made.outputs.shape) * made.outputs.std(axis=0)
    result = identify(Record(made.inputs, made.outputs + noise, made.dt))
    assert result.fit.mean < 0.4
    assert called(made, result) >= made.frequencies.size - 1
    assert all(
        (np.abs(made.frequencies - mode.frequency) < 0.01 * mode.frequency).any() for mode in result.modes.system
    )
    assert "makes most of the outputs" in result.warnings[0]


def test_very_light_damping_is_called():
    made, result = identified("light_damping", 3, n_samples=2500)
    assert called(made, result) == made.frequencies.size


@pytest.fixture
def case():
    pole = 0.98 * np.exp(0.9j)
    A = np.array([[pole.real, pole.imag], [-pole.imag, pole.real]])
    model = Realisation(A, np.array([[0.4], [0.1]]), np.eye(2), np.zeros((2, 1)), 0.01)
    return model, extract_modes(model)


@pytest.mark.parametrize(
    "inputs",
    [
        lambda rng: rng.standard_normal((3000, 1)),
        lambda rng: random_excitation(rng, 3000, 1, kind="sweep", band=(0.05, 0.2)),
        lambda rng: np.tile(random_excitation(rng, 750, 1, kind="multisine", band=(0.05, 0.2)), (4, 1)),
        lambda rng: np.cumsum(rng.standard_normal((3000, 1)), axis=0),
        lambda rng: random_excitation(rng, 3000, 1, kind="hits", band=(0.05, 0.2)),
        lambda rng: rng.standard_normal((3000, 1)) + np.sin(np.arange(3000.0))[:, np.newaxis],
    ],
)
def test_a_broad_band_is_no_few_lines(case, inputs):
    _, modes = case
    force = inputs(np.random.default_rng(0))
    assert between_lines(modes, [Record(force, np.zeros((3000, 2)), 0.01)], [np.zeros((3000, 2))],
                         output_scale=np.ones(2)) is None  # fmt: skip


@pytest.mark.parametrize(("floor", "shows"), [(0.0, False), (1e-3, True)])
def test_the_gain_beside_the_lines_is_that_of_the_rest_of_the_drive(case, floor, shows):
    """A tone and a true mode: what the tone does proves nothing, what the little noise beside it does proves all."""
    realisation, modes = case
    rng = np.random.default_rng(1)
    tone = np.sin(0.7 * np.arange(4000.0))[:, np.newaxis]
    force = tone + floor * rng.standard_normal(tone.shape)
    run = simulate(realisation, Record(force, np.zeros((4000, 2)), 0.01))
    noise = 1e-3 * rng.standard_normal((4000, 2))
    found = between_lines(modes, [run], [noise], output_scale=np.ones(2))
    assert found is not None
    np.testing.assert_allclose(found.lines, [0.7 / (2 * np.pi * 0.01)], atol=0.03)
    assert (found.gain[0] > 0.5) == shows
    ratio = found.n_values[0] * found.gain[0] / (1 - found.gain[0]) / 6
    assert bool(line_doubt(found, ratio)) == (not shows)


@pytest.mark.parametrize("size", [0.0, 0.5, 500.0])
def test_a_weak_line_upon_a_mode_is_no_evidence(case, size):
    """A multiple of the tone, weak or strong, in the mode's band; the rest of the measured force is the cell's own."""
    realisation, modes = case
    rng = np.random.default_rng(3)
    rows = np.arange(4000.0)[:, np.newaxis]
    cell = 1e-4
    force = np.sin(0.45 * rows) + size * cell * np.sin(0.9 * rows)
    truth = simulate(realisation, Record(force, np.zeros((4000, 2)), 0.01))
    measured = Record(force + cell * rng.standard_normal(force.shape), truth.outputs, 0.01)
    left = truth.outputs - simulate(realisation, measured).outputs + 1e-5 * rng.standard_normal((4000, 2))
    found = between_lines(modes, [measured], [left], output_scale=np.ones(2))
    assert found is not None
    assert not found.gain[0] > 0.3


def test_a_gap_leaves_the_lines_where_they_are(case):
    _, modes = case
    tone = np.sin(0.7 * np.arange(4000.0))[:, np.newaxis]
    left = np.random.default_rng(2).standard_normal((4000, 2))
    left[1000:1010] = np.nan
    found = between_lines(modes, [Record(tone, np.zeros((4000, 2)), 0.01)], [left], output_scale=np.ones(2))
    assert found is not None
    assert not found.gain[0] > 0.3


def shaken(rng, frequency, damping, n_samples):
    """Velocity of one mode under white noise, 100 samples a second, of deviation one."""
    pole = np.exp(2 * np.pi * 0.01 * frequency * (-damping + 1j))
    force = rng.standard_normal(n_samples + 1000)
    own = scipy.signal.lfilter([1.0, -1.0], [1.0, -2 * pole.real, abs(pole) ** 2], force)[1000:]
    return own / own.std()


def pole_at(frequency, damping, shape):
    pole = 2 * np.pi * frequency * complex(-damping, np.sqrt(1 - damping**2))
    return Mode(
        pole=pole, kind="oscillatory", frequency=frequency, damping_ratio=damping,
        shape=np.asarray(shape, dtype=complex), participation=np.empty(0),
    )  # fmt: skip


def test_a_resonance_stands_out_as_its_curve_says_and_noise_does_not():
    """1 / (1 + x^2) has a mean of 0.785 within its half-power bandwidth and of 0.137 from 1.5 to 4 half-widths off."""
    rng = np.random.default_rng(2)
    alone = shaken(rng, 20.0, 0.01, 400_000)[:, np.newaxis]
    model = ModalModel(modes=(pole_at(20.0, 0.01, [1.0]),), dt=0.01, indicator_caution=0.1)
    curve = np.pi / 4 / ((np.arctan(4.0) - np.arctan(1.5)) / 2.5)
    assert standing_out(model, [Record([], alone, 0.01)]) == pytest.approx([curve], rel=0.15)
    noise = rng.standard_normal((400_000, 1))
    assert standing_out(model, [Record([], noise, 0.01)]) == pytest.approx([1.0], rel=0.15)


def test_a_weak_mode_on_the_flank_of_a_strong_one_is_heard_in_its_direction():
    rng = np.random.default_rng(3)
    strong, weak = shaken(rng, 20.0, 0.01, 100_000), 0.1 * shaken(rng, 20.5, 0.01, 100_000)
    outputs = np.outer(strong, [1.0, 0.5]) + np.outer(weak, [0.5, -1.0])
    outputs += 0.01 * rng.standard_normal(outputs.shape)
    model = ModalModel(modes=(pole_at(20.6, 0.01, [0.5, -1.0]),), dt=0.01, indicator_caution=0.1)
    (height,) = standing_out(model, [Record([], outputs, 0.01)])
    assert height > 4.0
    (single,) = standing_out(
        ModalModel(modes=(pole_at(20.5, 0.01, [1.0]),), dt=0.01, indicator_caution=0.1),
        [Record([], outputs[:, :1], 0.01)],
    )
    assert single < LEAST_HEIGHT


def test_a_line_is_narrower_than_any_pole_of_some_damping():
    """A sinusoid under noise that a model follows by a pole of 0.1 % damping: of no such width is its peak."""
    rng = np.random.default_rng(4)
    time = 0.01 * np.arange(10_000)
    outputs = 0.8 * np.sin(2 * np.pi * 30.0 * time) + rng.standard_normal(time.size)
    outputs += shaken(rng, 12.0, 0.01, time.size)
    line, mode = poles = (pole_at(30.0, 0.001, [1.0]), pole_at(12.0, 0.01, [1.0]))
    heights = standing_out(ModalModel(modes=poles, dt=0.01, indicator_caution=0.1), [Record([], outputs, 0.01)])
    (words,) = peak_doubt(line, float(heights[0]), 100.0)
    assert "much narrower, an undamped line" in words
    assert peak_doubt(mode, float(heights[1]), 100.0) == ()
    assert peak_doubt(line, float(heights[0]), 10.0) == ()  # a tenth of the record tells no such width


def test_the_edge_of_a_filter_is_no_mode():
    """Ambient motion behind an elliptic filter: its edge was found again in every half, "system" at p 0.98."""
    rng = np.random.default_rng(1)
    motion = np.zeros((6000, 2))
    for frequency in (8.0, 22.0):
        pole = np.exp(2 * np.pi * 0.01 * frequency * (-0.01 + 1j))
        own = scipy.signal.lfilter([1.0], [1.0, -2 * pole.real, abs(pole) ** 2], rng.standard_normal(7000))[1000:]
        motion += np.outer(own / own.std(), rng.standard_normal(2))
    motion += 0.03 * rng.standard_normal(motion.shape)
    steep = scipy.signal.ellip(8, 0.1, 80.0, 0.66, output="sos")
    result = identify(Record([], scipy.signal.sosfilt(steep, motion, axis=0), 0.01))
    np.testing.assert_allclose([mode.frequency for mode in result.modes.system], [8.0, 22.0], rtol=0.01)
    assert any(mode.reason.startswith("no peak stands") for mode in result.modes)


def test_two_modes_side_by_side_that_one_sensor_hears_stand_out_together():
    """Each lies on the other's side, 2.5 half-widths off: with that alone for its side neither would be a peak."""
    rng = np.random.default_rng(6)
    outputs = shaken(rng, 20.0, 0.01, 100_000) + shaken(rng, 20.5, 0.01, 100_000)
    poles = (pole_at(20.0, 0.01, [1.0]), pole_at(20.5, 0.01, [1.0]))
    record = [Record([], outputs + 0.01 * rng.standard_normal(outputs.size), 0.01)]
    assert (standing_out(ModalModel(modes=poles, dt=0.01, indicator_caution=0.1), record) > LEAST_HEIGHT).all()
    noise = [Record([], rng.standard_normal(100_000), 0.01)]
    assert standing_out(ModalModel(modes=poles, dt=0.01, indicator_caution=0.1), noise) == pytest.approx(
        [1.0, 1.0], rel=0.3
    )


def test_a_weak_mode_beside_a_strong_one_stands_out_on_what_the_strong_one_leaves():
    """One sensor: the strong resonance fills one side of the weak one, and as much on the other side is no mode."""
    rng = np.random.default_rng(7)
    outputs = shaken(rng, 20.0, 0.01, 200_000) + 0.3 * shaken(rng, 21.0, 0.01, 200_000)
    outputs += 0.5 * rng.standard_normal(outputs.size)
    strong, weak, nothing = (pole_at(frequency, 0.01, [1.0]) for frequency in (20.0, 21.0, 19.0))

    def heights(*poles):
        model = ModalModel(modes=poles, dt=0.01, indicator_caution=0.1)
        return standing_out(model, [Record([], outputs, 0.01)])

    assert heights(weak)[0] < LEAST_HEIGHT
    found = heights(weak, strong, nothing)
    assert (found[:2] > LEAST_HEIGHT).all()
    assert found[2] < LEAST_HEIGHT


def sweep_and_answer(seed, end):
    """A logarithmic sweep from 0.5 Hz to `end` Hz, and three modes that answer, the last at 79.16 Hz."""
    rng, dt = np.random.default_rng(seed), 0.005
    force = scipy.signal.chirp(dt * np.arange(4000), 0.5, 4000 * dt, end, method="logarithmic", phi=-90)
    outputs = np.zeros((4000, 3))
    for frequency, size in ((12.0, 1.0), (40.0, 1.0), (79.16, 0.5)):
        pole = np.exp(2 * np.pi * frequency * dt * (-0.006 + 1j))
        motion = scipy.signal.lfilter([0.0, 1.0], [1.0, -2 * pole.real, abs(pole) ** 2], force)
        outputs += np.outer(size * motion / motion.std(), rng.standard_normal(3))
    return Record(force, outputs + 0.01 * outputs.std(axis=0) * rng.standard_normal(outputs.shape), dt)


def test_a_mode_that_a_sweep_passes_at_its_end_is_one():
    """The record is over before a window that fades out sees its answer: it was doubtful, "may be chance"."""
    result = identify(sweep_and_answer(3, 80.0))
    assert [round(mode.frequency, 1) for mode in result.modes.system] == [12.0, 40.0, 79.2]


def test_beyond_the_inputs_an_answer_is_told_of_where_the_window_sees_it():
    """White forces up to 20 Hz of 50 answer everywhere, a sweep that ends at 30 Hz at the end alone."""
    rng, dt, n = np.random.default_rng(0), 0.01, 4000
    spectrum = np.where(np.fft.rfftfreq(n, dt) < 20.0, np.fft.rfft(rng.standard_normal(n)), 0.0)
    even = np.fft.irfft(spectrum, n)
    swept = scipy.signal.chirp(dt * np.arange(n), 0.5, n * dt, 30.0, method="logarithmic")
    noise = 0.01 * rng.standard_normal((n, 1))
    for force, frequency, told in ((even, 30.0, True), (swept, 29.7, False)):
        mode = Mode(pole=2 * np.pi * frequency * (-0.003 + 1j), kind="oscillatory", frequency=frequency,
                    damping_ratio=0.003, shape=np.ones(1) + 0j, participation=np.ones(1) + 0j)  # fmt: skip
        model = ModalModel(modes=(mode,), dt=dt, indicator_caution=0.1)
        gain, _ = beyond_inputs(model, [Record(force, noise, dt)], [noise], output_scale=np.ones(1))
        assert bool(np.isfinite(gain[0])) is told
