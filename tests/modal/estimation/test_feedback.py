"""Feedback is found where it is, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest
import scipy
from noise_families import noise_record

from era.realisation import Realisation
from modal.estimation.feedback import FALSE_ALARMS, feedback_p_value, from_outside
from modal.identification.covariance import feedback_bias, output_error_uncertainty
from modal.identification.noise_model import with_feedback
from modal.identification.order_search import MOST_STEPS
from modal.identification.pipeline import identify
from modal.identification.refined_search import refined_model
from modal.modes.extraction import extract_modes
from modal.preparation.band import FOLLOWS, chance_of_following
from okid.record import Record


def p_value(case):
    return feedback_p_value([Record(case.inputs, case.outputs, case.system.dt)])


def test_loops_are_found_all_that_are_strong_and_most_of_the_others():
    cases = [noise_record("loop", system=system, record=0) for system in range(3000, 3015)]
    found = np.array([p_value(case) < FALSE_ALARMS for case in cases])
    strong = np.array([case.fed_back > 0.3 for case in cases])
    assert strong.sum() > 2
    assert found[strong].all()
    assert found.mean() > 0.8


@pytest.mark.filterwarnings("error")
def test_without_a_whole_row_nothing_is_asked():
    """Of twenty outputs with a tenth of the samples missing."""
    rng = np.random.default_rng(1)
    outputs = np.where(rng.random((3000, 20)) < 0.1, np.nan, rng.standard_normal((3000, 20)))
    assert np.isnan(feedback_p_value([Record(rng.standard_normal((3000, 2)), outputs, 0.01)]))


@pytest.mark.parametrize("seed", range(4))
def test_a_force_that_fills_a_part_of_the_band_is_no_loop(seed):
    """Its past foretells it as far as the noise of its sensor allows, which the outputs do not have."""
    rng = np.random.default_rng(seed)
    n, lines = 16384, np.fft.rfftfreq(16384)
    force = np.fft.rfft(rng.standard_normal(n)) * ((lines > 0.02) & (lines < 0.37))
    answers = [lines**2 / (lines**2 - f**2 - 2j * z * f * lines) for f, z in ((0.1, 0.004), (0.2, 0.003), (0.3, 0.02))]
    outputs = np.fft.irfft(force * (rng.standard_normal((6, 3)) @ np.array(answers)), n).T
    outputs += 0.01 * outputs.std(axis=0) * rng.standard_normal(outputs.shape)
    force = np.fft.irfft(force, n)
    force += 0.002 * force.std() * rng.standard_normal(n)
    assert feedback_p_value([Record(force, outputs, 1e-3)]) > FALSE_ALARMS


def biased(kind, system):
    """Errors of the modes' damping by output error from the truth, their deviations, and what feedback does to them."""
    case = noise_record(kind, system=system, record=0)
    truth = case.system
    start = Realisation(truth.A, truth.B, truth.C, truth.D, truth.dt)
    model = refined_model([Record(case.inputs, case.outputs, truth.dt)], start, MOST_STEPS)
    modes = extract_modes(model.realisation).modes
    nearest = [np.abs(truth.frequencies - mode.frequency).argmin() for mode in modes]
    errors = [mode.damping_ratio - truth.damping_ratios[i] for mode, i in zip(modes, nearest, strict=True)]
    known = output_error_uncertainty(model, modes, n_lags=1).damping_ratio_std
    return np.abs(errors), known, feedback_bias(model, modes, n_lags=1).damping_ratio_std


def test_the_bias_by_feedback_is_what_the_estimate_is_off_by():
    errors, known, bias = np.hstack([biased("loop", system) for system in (7005, 7007, 7014, 7018, 7024)])
    assert (errors > 3.0 * known).sum() > 3
    assert (errors < 3.0 * np.hypot(known, bias)).all()
    far = bias > 2.8 * known
    assert far.any()
    assert not far.all()
    _, known, bias = np.hstack([biased("coloured", system) for system in (7100, 7101, 7102)])
    assert (bias < known).all()


def test_only_modes_that_feedback_moves_far_are_doubted(identification):
    known = tuple(replace(mode, frequency_std=0.01) for mode in identification.modes)
    modes = replace(identification.modes, modes=known)
    identification = replace(identification, modes=modes)
    system = [i for i, mode in enumerate(modes) if mode.verdict == "system"]
    moved = np.zeros(len(modes))
    harmless = with_feedback(identification, moved)
    assert harmless.modes is modes
    assert harmless.warnings == identification.warnings
    assert harmless.choices[-1].what == "feedback"
    moved[system[0]], moved[system[1]] = 5.0, 2.0
    result = with_feedback(identification, moved)
    verdicts = [mode.verdict for mode in result.modes]
    assert verdicts[system[0]] == "doubtful"
    assert [verdicts[i] for i in system[1:]] == ["system"] * (len(system) - 1)
    assert "as in a loop" in result.modes.modes[system[0]].reason
    assert [what for what, _ in result.modes.modes[system[0]].doubts] == ["data"]
    assert "2.2 times wider" in result.warnings[-1]


def loop(seed, reference, *, n_samples=6000):
    """A mode at 8 Hz under noise, fed back a sample later as it is seen, and moved by a reference of this size."""
    rng = np.random.default_rng(seed)
    pole = np.exp((-0.01 + 1j) * 2 * np.pi * 8.0 * 0.01)
    a, force = (-2 * pole.real, abs(pole) ** 2), 0.1 * rng.standard_normal(n_samples)
    r, seen = reference * rng.standard_normal(n_samples), 0.3 * rng.standard_normal(n_samples)
    u, y = np.zeros(n_samples), np.zeros(n_samples)
    for k in range(2, n_samples):
        u[k] = r[k] - 0.003 * (y[k - 1] + seen[k - 1])
        y[k] = -a[0] * y[k - 1] - a[1] * y[k - 2] + u[k - 1] + force[k]
    return Record(u, y + seen, 0.01)


def chance(record):
    return float(chance_of_following(from_outside([record]), [8.0], [0.04])[0])


@pytest.mark.parametrize("seed", range(4))
def test_what_moves_the_inputs_from_outside_is_told_from_what_feeds_back(seed):
    assert chance(loop(seed, 0.1)) < 1e-6  # as strong as the noise
    for reference in (0.0, 1e-3):  # nothing, and what the noise drowns
        record = loop(seed, reference)
        assert feedback_p_value([record]) < FALSE_ALARMS
        assert chance_of_following([record], [8.0], [0.04])[0] < 1e-6  # the outputs follow the inputs all the same
        assert chance(record) > FOLLOWS


def test_a_smooth_force_comes_from_outside():
    """Outputs tell of what it does between its samples, and their present all of it; but their past does not."""
    rng = np.random.default_rng(3)
    fine = scipy.signal.sosfilt(scipy.signal.butter(8, 0.08, output="sos"), rng.standard_normal(80_000))
    pole = np.exp((-0.01 + 1j) * 2 * np.pi * 8.0 * 1e-3)
    y = scipy.signal.lfilter([1, -2, 1], [1, -2 * pole.real, abs(pole) ** 2], fine)[::10]
    assert chance(Record(fine[::10], y + 1e-3 * y.std() * rng.standard_normal(8000), 0.01)) < 1e-6


def test_only_modes_that_something_else_moves_are_allowed_for(identification):
    """The sentence said of every loop that the model of the noise allows for it."""
    free = identification.records
    rng = np.random.default_rng(0)
    nothing = [replace(record, inputs=rng.standard_normal(record.inputs.shape)) for record in identification.records]
    system = {i for i, mode in enumerate(identification.modes) if mode.verdict == "system"}
    allowed = with_feedback(identification, None, free)
    assert allowed.modes is identification.modes
    assert "allows for that as long as" in allowed.warnings[-1]
    for moved in (None, np.zeros(len(identification.modes))):
        alone = with_feedback(identification, moved, nothing)
        assert not any("allows" in words for words in alone.warnings)
        assert "may belong to the closed loop" in alone.warnings[-1]
        assert all(alone.modes.modes[i].verdict == "doubtful" for i in system)
        assert all("mode of the loop" in alone.modes.modes[i].reason for i in system)


@pytest.mark.parametrize("kind", ["white", "coloured", "wind", "hidden"])
def test_open_records_are_left_alone(kind):
    cases = [noise_record(kind, system=system, record=0) for system in range(2000, 2004)]
    assert all(p_value(case) > FALSE_ALARMS / 10 for case in cases)


def test_an_input_that_its_own_past_foretells_is_not_asked():
    time = np.arange(2000) * 0.01
    tone = np.sin(2 * np.pi * 3.0 * time)
    rng = np.random.default_rng(1)
    assert np.isnan(feedback_p_value([Record(tone, tone + rng.standard_normal(2000), 0.01)]))
    assert np.isnan(feedback_p_value([Record([], rng.standard_normal(2000), 0.01)]))


def smooth_force_record(n_inputs):
    """Accelerations of a structure in open loop under low-passed forces that move between their samples."""
    rng, dt, finer = np.random.default_rng((n_inputs, 5)), 0.01, 8
    frequency, ratio = np.array([10.5, 24.1]), np.array([0.02, 0.025])
    w = 2 * np.pi * frequency
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.diag(w**2), -np.diag(2 * ratio * w)]])
    B = np.vstack([np.zeros((2, n_inputs)), rng.standard_normal((2, n_inputs))])
    shapes = rng.standard_normal((3, 2))
    low_pass = scipy.signal.butter(4, 30.0 * 2 * dt / finer, output="sos")
    force = scipy.signal.sosfilt(low_pass, rng.standard_normal((finer * 6000, n_inputs)), axis=0)
    structure = scipy.signal.StateSpace(A, B, shapes @ A[2:], shapes @ B[2:])
    _, motion, _ = scipy.signal.lsim(structure, force, np.arange(len(force)) * dt / finer)
    return Record(force[8000::finer], motion[8000::finer], dt), frequency


@pytest.mark.parametrize("n_inputs", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_smooth_force_in_open_loop_is_no_feedback(n_inputs):
    record, frequency = smooth_force_record(n_inputs)
    assert feedback_p_value([record]) < FALSE_ALARMS  # outputs do know how the force moves between its samples
    result = identify(record, observer_order=8, ridge=1e-5, order=8)
    assert all("move between their samples" in words for words in result.warnings if "feeds them back" in words)
    assert all(np.abs(mode.frequency / frequency - 1.0).min() < 1e-3 for mode in result.modes.system)
    assert len(result.modes.system) == 2


def test_a_record_shorter_than_the_lags_tells_nothing_of_a_loop():
    rng = np.random.default_rng(6)
    r, e, u, y = *rng.standard_normal((2, 4000)), np.zeros(4000), np.zeros(4000)
    for k in range(1, 4000):
        y[k] = 0.5 * y[k - 1] + u[k - 1] + e[k]
        u[k] = r[k] - 0.3 * y[k - 1]
    free = from_outside([Record(u, y, 0.1), Record(u[:5], y[:5], 0.1)])
    alone = from_outside([Record(u, y, 0.1)])
    assert len(free) == len(alone) == 1
