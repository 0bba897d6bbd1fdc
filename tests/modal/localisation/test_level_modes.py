"""Modes against level: linear truth, equivalent linear systems of nonlinear laws, and what is not known."""

from functools import cache

import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st
from nonlinear_chain import no_force, run_chain
from systems import chain_matrices

from modal.localisation.evidence import mode_statements
from modal.localisation.levels import LevelModes, decay_windows, level_modes, tendency
from okid.record import Record

DT, N = 0.03, 2048
LEVELS = (0.3, 1.0, 3.0)
ONE = ([1.0], [400.0], [0.8])
THREE = ([1.0, 1.2, 0.8], [900.0, 700.0, 800.0], [2.0, 2.0, 2.0])


@cache
def inputs(seed=1, n_records=3):
    rng = np.random.default_rng(seed)
    return np.array([10.0 * LEVELS[i % 3] * rng.standard_normal(N) for i in range(n_records)])


def records(runs, *, noise=0.01, seed=1, missing=0.0):
    rng = np.random.default_rng(9)
    seen = runs + noise * runs.std(axis=1, keepdims=True) * rng.standard_normal(runs.shape)
    seen[rng.random(seen.shape) < missing] = np.nan
    return [Record(u, y, DT) for u, y in zip(inputs(seed), seen, strict=True)]


NOISE = np.random.default_rng(7).standard_normal((2, N))


def cubic(d, v, t):
    return 100.0 * d**3


def sine_softening(d, v, t):
    return 300.0 * (np.sin(d / 0.5) * 0.5 - d)


def coulomb(d, v, t):
    return 0.4 * np.sign(v)


def drag(d, v, t):
    return 0.3 * v * np.abs(v)


@cache
def motions(system, seed):
    """One plain loop for all laws: three levels of each side by side."""
    laws = (no_force, cubic, sine_softening, coulomb, drag) if system == "one" else (no_force, drag)

    def together(d, v, t):
        return np.concatenate([law(d[3 * i : 3 * i + 3], v[3 * i : 3 * i + 3], t) for i, law in enumerate(laws)])

    force = np.tile(inputs(seed), (len(laws), 1))
    runs = run_chain(*(ONE if system == "one" else THREE), force, DT, law=together, n_steps=3)
    return {law: runs[3 * i : 3 * i + 3] for i, law in enumerate(laws)}


def motion(law=no_force, system="one", seed=1):
    return motions(system, seed)[law]


@cache
def found(law, system="one"):
    return level_modes(records(motion(law, system)))


def true_modes(masses, stiffnesses, dampings):
    mass, damping, stiffness = chain_matrices(masses, stiffnesses, dampings)
    n = len(masses)
    inverse = np.linalg.inv(mass)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ stiffness, -inverse @ damping]])
    poles = np.linalg.eigvals(A)
    poles = np.sort_complex(poles[poles.imag > 0])
    poles = poles[np.argsort(np.abs(poles))]
    return np.abs(poles) / (2 * np.pi), -poles.real / np.abs(poles)


@pytest.mark.parametrize(("system", "truth"), [("one", ONE), ("three", THREE)])
def test_a_linear_chain_stays(system, truth):
    modes = found(no_force, system)
    frequencies, dampings = true_modes(*truth)
    assert modes.reason == ""
    assert modes.order == 2 * len(truth[0])
    assert len(modes.modes) == len(truth[0])
    for mode, frequency, damping in zip(modes.modes, frequencies, dampings, strict=True):
        assert (np.abs(mode.frequencies - frequency) < 5 * mode.frequency_stds + 1e-4 * frequency).all()
        assert (np.abs(mode.damping_ratios - damping) < 5 * mode.damping_ratio_stds + 1e-2 * damping).all()
        assert (mode.frequency_tendency, mode.damping_tendency) == ("stays", "stays")
        assert (mode.assurances > 0.99).all()
    np.testing.assert_allclose(modes.left_over, 1e-4, rtol=0.2)  # 1 % noise
    assert [s.text for s in mode_statements(modes)] == ["No mode moves with level in frequency or damping."]


def test_without_noise_the_truth_is_found_to_many_digits():
    force = inputs()[:, :800]
    runs = run_chain(*THREE, force, DT, n_steps=12)
    exact = level_modes([Record(u, y, DT) for u, y in zip(force, runs, strict=True)])
    frequencies, dampings = true_modes(*THREE)
    # the integrator's own error is (omega h)^4 / 120 = 2e-6 for the third mode at a step of 2.5 ms
    assert exact.order == 6
    assert len(exact.modes) == 3
    for k, mode in enumerate(exact.modes):
        np.testing.assert_allclose(mode.frequencies, frequencies[k], rtol=5e-6)
        np.testing.assert_allclose(mode.damping_ratios, dampings[k], rtol=5e-4)
    assert all(mode.frequency_tendency == "stays" for mode in exact.modes)


def test_a_cubic_spring_raises_the_frequency_as_its_equivalent_linear_one():
    # Roberts, Spanos, Random Vibration and Statistical Linearization, 1990: k_eq = k + 3 k3 sigma_d^2
    (mode,) = found(cubic).modes
    sigma = motion(cubic)[:, :, 0].std(axis=1)
    expected = np.sqrt((400.0 + 3 * 100.0 * sigma**2) / 400.0) - 1.0
    change = mode.frequencies / true_modes(*ONE)[0][0] - 1.0
    assert mode.frequency_tendency == "rises"
    assert change[2] > 0.01
    np.testing.assert_allclose(change[2], expected[2], rtol=0.3)
    assert "spring that hardens" in mode_statements(found(cubic))[0].text


def test_a_sine_spring_lowers_the_frequency():
    # k_eq of k L sin(d / L) for Gaussian motion is k exp(-sigma^2 / (2 L^2)); 300 of the 700 N/m stay linear
    assert found(sine_softening).modes[0].frequency_tendency == "falls"
    (statement,) = mode_statements(found(sine_softening))[:1]
    assert "softens" in statement.text
    assert statement.text.startswith("Frequency of mode 1")


@pytest.mark.parametrize(
    ("law", "tendency_", "words", "extra"),
    [
        # Roberts and Spanos: c_eq = c + F sqrt(2 / pi) / sigma_v and c + c2 sqrt(8 / pi) sigma_v
        (coulomb, "falls", "friction-like", lambda sigma: 0.4 * np.sqrt(2 / np.pi) / sigma),
        (drag, "rises", "drag-like", lambda sigma: 0.3 * np.sqrt(8 / np.pi) * sigma),
    ],
)
def test_damping_follows_its_equivalent_linear_law(law, tendency_, words, extra):
    modes = found(law)
    (mode,) = modes.modes
    assert mode.damping_tendency == tendency_
    assert mode.frequency_tendency in ("stays", "unknown")
    velocity = np.gradient(motion(law)[:, :, 0], DT, axis=1).std(axis=1)
    expected = (0.8 + extra(velocity)) / (2 * 20.0)
    np.testing.assert_allclose(mode.damping_ratios, expected, rtol=0.25)
    (statement,) = mode_statements(modes)
    assert words in statement.text
    assert statement.text.startswith("Damping of mode 1")


def test_every_mode_of_a_chain_is_followed():
    modes = found(drag, "three")
    frequencies, _ = true_modes(*THREE)
    np.testing.assert_allclose([mode.frequencies[0] for mode in modes.modes], frequencies, rtol=0.01)
    # the third one moves little at the ground, where the drag is: by 3 %, less than what counts
    assert [mode.damping_tendency for mode in modes.modes] == ["rises", "rises", "stays"]
    assert [mode.number for mode in modes.modes] == [1, 2, 3]


def test_the_order_of_the_records_changes_nothing():
    given = records(motion(cubic))
    moved = level_modes([given[2], given[0], given[1]])
    np.testing.assert_allclose(moved.modes[0].frequencies, found(cubic).modes[0].frequencies, rtol=1e-9)


def test_records_of_one_level_are_fitted_together():
    modes = level_modes([half for record in records(motion(cubic)) for half in record.split(0.5)])
    assert modes.levels.size == 3
    assert modes.modes[0].frequencies.shape == (3,)
    assert modes.modes[0].frequency_tendency == "rises"


def test_missing_outputs_do_not_matter():
    modes = level_modes(records(motion(drag), missing=0.01))
    np.testing.assert_allclose(modes.modes[0].frequencies, found(drag).modes[0].frequencies, rtol=5e-3)
    assert modes.modes[0].damping_tendency == "rises"


def test_a_first_order_plant_has_a_time_constant():
    # J w' = u - b w - c2 w |w|
    rng = np.random.default_rng(4)
    force = np.array([level * np.repeat(rng.standard_normal(N // 8), 8) for level in (1.0, 10.0)])
    speed = np.zeros((2, N))
    for k in range(1, N):
        w = speed[:, k - 1]
        for _ in range(4):
            w = w + 0.25 * DT * (force[:, k - 1] - 1.0 * w - 0.5 * w * np.abs(w))
        speed[:, k] = w
    noise = 0.005 * speed.std(axis=1, keepdims=True) * rng.standard_normal(speed.shape)
    modes = level_modes([Record(u, y, DT) for u, y in zip(force, speed + noise, strict=True)])
    assert modes.modes[0].kind == "real"
    assert modes.modes[0].frequency_tendency == "rises"
    assert modes.modes[0].damping_tendency == "unknown"
    (statement,) = mode_statements(modes)[:1]
    assert statement.text.startswith("Time constant of pole 1 falls")
    assert "drag-like" in statement.text


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        (lambda: records(motion())[:1], "one level"),
        (lambda: [Record([], np.sin(np.arange(100.0)), DT)], "one level"),
        (lambda: [Record(a * NOISE[0], a * NOISE[1], DT) for a in (1, 3)], "at no level do the outputs follow"),
        (lambda: [Record(r.inputs[:30], r.outputs[:30], DT) for r in records(motion())], ""),
    ],
)
def test_where_modes_are_not_known_a_sentence_says_why(given, reason):
    modes = level_modes(given())
    if reason:
        assert reason in modes.reason
        assert modes.order == 0
        assert np.isnan(modes.left_over).all()
    assert isinstance(modes, LevelModes)
    assert (modes.modes == ()) == (modes.reason != "")
    if modes.reason:
        (statement,) = mode_statements(modes)
        assert modes.reason in statement.text


def test_the_same_records_give_the_same_numbers():
    first, second = level_modes(records(motion(cubic))), level_modes(records(motion(cubic)))
    assert first.modes[0].frequencies.tolist() == second.modes[0].frequencies.tolist()
    assert first.modes[0].frequency_stds.tolist() == second.modes[0].frequency_stds.tolist()


# --- tendency --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("values", "deviation", "expected"),
    [
        ([1.0, 1.02, 1.05], 0.001, "rises"),
        ([1.05, 1.02, 1.0], 0.001, "falls"),
        ([1.0, 1.05, 1.0], 0.001, "mixed"),
        ([1.0, 1.0005, 1.0], 0.0001, "stays"),
        ([1.0, 1.0005, 1.0], 0.01, "unknown"),
        ([1.0, 1.02, 1.05], 0.02, "unknown"),
        ([1.0, np.nan, 1.05], 0.001, "rises"),
        ([1.0, np.nan, np.nan], 0.001, "unknown"),
    ],
)
def test_tendencies(values, deviation, expected):
    assert tendency(np.array(values), np.full(3, deviation), counts=2e-3) == expected


@pytest.mark.parametrize(
    ("deviations", "expected"),
    [
        ([0.02, 1e-4, 1e-4, 1e-4], "stays"),  # one level that could not have shown a change
        ([0.02, 0.02, 1e-4, 1e-4], "unknown"),  # half of them
        ([0.02, 1e-4], "unknown"),
    ],
)
def test_a_level_known_far_less_neither_shows_nor_refuses_a_change(deviations, expected):
    values = np.full(len(deviations), 1.0)
    assert tendency(values, np.array(deviations), counts=2e-3) == expected


@settings(max_examples=100, deadline=None)
@given(st.lists(st.floats(0.5, 2.0), min_size=2, max_size=5), st.floats(1e-6, 0.5), st.floats(0.1, 1e3))
def test_a_tendency_turns_with_the_order_and_not_with_the_unit(values, deviation, factor):
    values, deviations = np.array(values), np.full(len(values), deviation)
    other = {"rises": "falls", "falls": "rises"}
    said = tendency(values, deviations, counts=1e-2)
    assert tendency(values[::-1], deviations, counts=1e-2) == other.get(said, said)
    assert tendency(factor * values, factor * deviations, counts=1e-2) == said


def test_chance_seldom_moves_a_mode():
    rng = np.random.default_rng(3)
    said = [tendency(1 + 0.01 * rng.standard_normal(3), np.full(3, 0.01), counts=1e-3) for _ in range(2000)]
    # three differences at four deviations each: 3 x 6e-5 at most
    assert sum(word in ("rises", "falls", "mixed") for word in said) <= 3


# --- deviations ------------------------------------------------------------------------------------------------------


def test_deviations_are_those_of_realisations_of_a_nonlinear_structure():
    # the size of the motion of a lightly damped mode differs from record to record, and with it the frequency (cubic)
    # or the damping (drag): the curvature of the output error alone says 5 to 12 and 4 to 7 times less than that
    rng = np.random.default_rng(77)
    white = np.tile(rng.standard_normal((16, N)) * np.repeat([5.0, 20.0], 8)[:, np.newaxis], (2, 1))

    def law(d, v, t):
        return np.concatenate([200.0 * d[:16] ** 3, 0.5 * v[16:] * np.abs(v[16:])])

    runs = run_chain([1.0] * 3, [400.0] * 3, [0.8] * 3, white, DT, law=law, n_steps=3)
    runs = runs + 0.01 * runs.std(axis=1, keepdims=True) * rng.standard_normal(runs.shape)
    for first, values, deviations in (
        (0, "frequencies", "frequency_stds"),
        (16, "damping_ratios", "damping_ratio_stds"),
    ):
        sets = [(first + k, first + 8 + k) for k in range(8)]
        modes = [level_modes([Record(white[i], runs[i], DT) for i in one]).modes[0] for one in sets]
        scatter = np.std([getattr(mode, values) for mode in modes], axis=0, ddof=1)
        said = np.sqrt(np.mean([getattr(mode, deviations) ** 2 for mode in modes], axis=0))
        assert (scatter / said < 3.5).all()
        assert (scatter / said > 0.15).all()


# --- free decays -----------------------------------------------------------------------------------------------------


@cache
def decays():
    """Let go at 60 degrees, 1 Hz, 25 samples a second: a pendulum, a linear spring with drag, a linear oscillator."""
    omega, dt, steps = 2 * np.pi, 0.04, 4
    state = np.array([[1.05, 0.0]] * 3)
    result = np.empty((3, 1500))

    def slope(x):
        angle, speed = x.T
        pull = np.array([np.sin(angle[0]), angle[1], angle[2]])
        brake = np.array([0.02, 0.02, 0.04]) * speed
        brake[1] += 0.02 * speed[1] * abs(speed[1])
        return np.column_stack([speed, -(omega**2) * pull - brake])

    h = dt / steps
    for k in range(result.shape[1]):
        result[:, k] = state[:, 0]
        for _ in range(steps):
            a = slope(state)
            b = slope(state + 0.5 * h * a)
            c = slope(state + 0.5 * h * b)
            state = state + h / 6.0 * (a + 2 * b + 2 * c + slope(state + h * c))
    noise = 1e-3 * np.random.default_rng(3).standard_normal(result.shape)
    return [Record([], values, dt, output_names=["angle"]) for values in result + noise]


def test_a_pendulum_swings_slower_the_wider_it_swings():
    modes = level_modes(decays()[0])
    (mode,) = modes.modes
    assert mode.frequency_tendency == "falls"
    assert mode.damping_tendency in ("stays", "unknown")
    # exact: the period of amplitude a is 2 / pi K(sin^2(a / 2)) times that of small swings; the amplitude of a window
    # is that of its rms, from which the mean over the window differs little
    loudest = np.sqrt(2.0) * max(part.outputs.std() for part in decays()[0].split(*[1 / 6] * 6))
    amplitudes = loudest * modes.levels
    truth = np.pi / 2 / scipy.special.ellipk(np.sin(amplitudes / 2) ** 2)
    np.testing.assert_allclose(mode.frequencies, truth, rtol=2e-3)
    assert "softens" in mode_statements(modes)[0].text


def test_a_decay_with_drag_is_damped_more_where_it_is_large():
    # what sweeps through a window may take a second pole, which is known far less
    mode = min(level_modes(decays()[1]).modes, key=lambda mode: np.nanmean(mode.frequency_stds))
    assert mode.damping_tendency == "rises"
    # the spring is linear, 1 Hz; where pulse and initial state explain the same, one level knows it far less
    assert mode.frequency_tendency == "stays"
    seen = np.isfinite(mode.frequencies)
    assert seen.sum() >= len(seen) - 1
    assert np.abs(mode.frequencies[seen] - 1.0).max() < 2e-3


def test_a_linear_decay_stays():
    (mode,) = level_modes(decays()[2]).modes
    assert (mode.frequency_tendency, mode.damping_tendency) == ("stays", "stays")
    np.testing.assert_allclose(mode.frequencies, 1.0, rtol=1e-3)
    np.testing.assert_allclose(mode.damping_ratios, 0.04 / (4 * np.pi), rtol=0.1)


def test_inputs_that_never_move_are_as_good_as_none():
    record = decays()[0]
    resting = Record(np.ones(record.n_samples), record.outputs, record.dt)
    one, other = level_modes(record), level_modes(resting)
    np.testing.assert_array_equal(other.modes[0].frequencies, one.modes[0].frequencies)


def test_windows_that_miss_samples_are_left_out():
    values = np.array(decays()[0].outputs)
    values[10] = np.nan
    windows = decay_windows([Record([], values, 0.04)])
    assert len(windows) == 5
    assert windows[0].start_time == pytest.approx(250 * 0.04)
