"""Modes of what the inputs leave, and modes added and dropped by hand: taken out exactly, said, with what is left."""

from dataclasses import replace

import numpy as np
import pytest
import scipy
from noise_families import noise_record
from nonlinear_chain import run_chain
from systems import modal_system, simulate

import modal
from era.realisation import Realisation
from modal.identification.more_modes import without_modes
from modal.modes.extraction import extract_modes
from modal.modes.mode import numbered
from modal.modes.response_synthesis import frf, modal_frf
from okid.errors import InvalidDataError
from okid.record import Record


@pytest.mark.parametrize("dropped", [[0], [1], [0, 2], [3], [0, 1, 2, 3]])
def test_a_mode_is_taken_out_and_no_other_changes(dropped):
    rng = np.random.default_rng(5)
    poles = [0.98 * np.exp(0.3j), 0.97 * np.exp(1.1j), 0.99 * np.exp(2.0j), 0.5]
    blocks = [np.array([[p.real, p.imag], [-p.imag, p.real]]) if np.iscomplex(p) else np.array([[p]]) for p in poles]
    A = np.zeros((7, 7))
    for k, block in enumerate(blocks):
        A[2 * k : 2 * k + len(block), 2 * k : 2 * k + len(block)] = block
    T = rng.standard_normal((7, 7))
    B, C, D = rng.standard_normal((7, 2)), rng.standard_normal((3, 7)), rng.standard_normal((3, 2))
    model = Realisation(
        T @ A @ np.linalg.inv(T), T @ B, C @ np.linalg.inv(T), D, 0.01, K=T @ rng.standard_normal((7, 3))
    )
    modes = extract_modes(model).modes
    by_pole = sorted(modes, key=lambda mode: mode.frequency if mode.kind == "oscillatory" else np.inf)
    gone = [by_pole[k] for k in dropped]
    left = without_modes(model, gone)
    frequencies = np.linspace(0.1, 49.0, 200)
    expected = frf(model, frequencies) - modal_frf(gone, frequencies, dt=0.01).sum(axis=0)
    assert frf(left, frequencies) == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert left.order == 7 - sum(1 if mode.kind == "real" else 2 for mode in gone)


def test_the_choice_of_the_user_is_said_and_costs_its_fit(identification):
    number = max(n for n, mode in numbered(identification.modes) if mode.verdict == "system")
    result = modal.with_modes(identification, drop=[number])
    assert len(result.modes.system) == len(identification.modes.system) - 1
    assert result.fit.whole.mean() < identification.fit.whole.mean()
    assert np.isnan(result.fit.cross_validated).all()
    assert result.choices[-1].what == "modes by hand"
    assert f"dropped {number}" in result.choices[-1].value
    assert any("dropped by hand" in mode.reason for mode in result.modes)


@pytest.mark.parametrize("delay", [7, -4])
def test_what_is_left_runs_with_the_delays_of_its_inputs(delay):
    rng = np.random.default_rng(3)
    both = modal_system(rng, frequencies=[6.0, 21.0], damping_ratios=[0.02, 0.015], n_inputs=1, n_outputs=2)
    force = rng.standard_normal((4000, 1))
    measured = np.roll(simulate(both, force), delay, axis=0)[10:-10]
    measured += 0.01 * measured.std(axis=0) * rng.standard_normal(measured.shape)
    result = modal.identify(
        Record(force[10:-10], measured, both.dt), input_delay=delay, observer_order=20, ridge=0.0, order=4
    )
    assert result.input_delay == (delay,)
    high = extract_modes(Realisation(both.A, both.B, both.C, both.D, both.dt)).modes[1]
    answer = np.zeros_like(force[:, 0], dtype=complex)
    pole = np.exp(high.pole * both.dt)
    answer[1:] = scipy.signal.lfilter([1.0], [1.0, -pole], force[:-1, 0])
    alone = 2 * (answer[:, np.newaxis] * high.shape * high.participation[0]).real
    left = measured - np.roll(alone, delay, axis=0)[10:-10]
    dropped = modal.with_modes(result, drop=[1])
    np.testing.assert_allclose(dropped.fit.whole, 1 - left.std(axis=0) / measured.std(axis=0), atol=0.01)
    assert all(run.n_samples == one.n_samples for run, one in zip(dropped.simulated, dropped.records, strict=True))


def test_what_is_left_runs_with_sums_of_the_inputs_of_integrators():
    """Without the sums the model of two inertias on a shaft fitted by 0.0003, whichever pole was dropped."""
    rng = np.random.default_rng(0)
    shaft = np.array([[0, 1, 0, 0], [-900, -0.5, 900, 0.5], [0, 0, 0, 1], [1500, 0.5 / 0.6, -1500, -0.5 / 0.6]])
    A, B, C, _, _ = scipy.signal.cont2discrete((shaft, np.eye(4)[:, 1:2], np.eye(4)[[1, 3]], np.zeros((2, 1))), 0.01)
    torque, speeds, state = rng.standard_normal(3000), np.zeros((3000, 2)), np.zeros(4)
    for row, pull in zip(speeds, torque, strict=True):
        row[:] = C @ state
        state = A @ state + B[:, 0] * pull
    record = Record(torque, speeds + 0.002 * rng.standard_normal(speeds.shape), 0.01)
    result = modal.identify(record, observer_order=64, ridge=0.0, order=5)
    assert next(choice.value for choice in result.choices if choice.what == "integrators") == "one"
    (shown,) = result.modes.system
    noise = [number for number, mode in numbered(result.modes) if mode.verdict == "noise" and mode.damping_ratio < 0.5]
    assert noise
    left = modal.with_modes(result, drop=noise)
    np.testing.assert_allclose(left.fit.whole, result.fit.whole, atol=0.01)
    without = modal.with_modes(result, drop=[number for number, mode in numbered(result.modes) if mode is shown])
    assert without.fit.whole.max() < 0.6


def test_an_added_mode_is_one_of_the_system(identification):
    others = [n for n, mode in numbered(identification.modes) if mode.verdict != "system"]
    if not others:
        pytest.skip("every mode of the example is one of the system")
    result = modal.with_modes(identification, add=others[:1])
    assert len(result.modes.system) == len(identification.modes.system) + 1
    assert result.realisation is identification.realisation


def test_what_the_user_decides_leaves_no_doubt_behind(identification):
    mode = identification.modes.system[0]
    doubted = replace(mode, verdict="doubtful", doubts=(("pole", "a line"),))
    modes = tuple(doubted if one is mode else one for one in identification.modes)
    before = replace(identification, modes=replace(identification.modes, modes=modes))
    number = next(n for n, one in numbered(before.modes) if one is doubted)
    for choice, verdict in (("add", "system"), ("drop", "noise")):
        after = modal.with_modes(before, **{choice: [number]}).modes
        [changed] = [one for one in after if one.frequency == mode.frequency]
        assert (changed.verdict, changed.doubts) == (verdict, ())


@pytest.mark.parametrize("numbers", [{"add": [0]}, {"drop": [10_000]}, {"add": [1], "drop": [1]}])
def test_numbers_that_are_none_are_refused(identification, numbers):
    with pytest.raises(InvalidDataError, match="numbered from 1"):
        modal.with_modes(identification, **numbers)


@pytest.fixture(scope="module")
def half_driven():
    """Four modes, of which the three measured forces hardly drive the last; two hidden ones make most of the motion."""
    case = noise_record("hidden", system=702, record=0)
    return case, modal.identify(Record(case.inputs, case.outputs, case.system.dt))


def test_a_mode_that_hidden_forces_drive_is_found_in_what_the_inputs_leave(half_driven):
    case, found = half_driven
    modes = found.modes.system
    assert len(modes) == 4
    for mode, frequency, damping in zip(modes, case.system.frequencies, case.system.damping_ratios, strict=True):
        assert abs(mode.frequency - frequency) < 4.0 * mode.frequency_std
        assert abs(mode.damping_ratio - damping) < 4.0 * mode.damping_ratio_std
    assert not modes[3].participation.any()
    assert "most of what drives it was not measured" in modes[3].reason
    assert found.choices[-1].what == "what the inputs leave"
    assert f"The mode at {modes[3].frequency:.4g} Hz was found in what the inputs leave" in found.warnings[-1]
    at = found.modes.modes.index(modes[3])
    assert found.uncertainty.frequency_std[at] == modes[3].frequency_std
    assert len(found.uncertainty.found) == len(found.modes)


def test_dropping_such_a_mode_leaves_the_model_alone(half_driven, tmp_path):
    _, found = half_driven
    number = {id(mode): number for number, mode in numbered(found.modes)}[id(found.modes.system[3])]
    dropped = modal.with_modes(found, drop=[number])
    assert dropped.realisation.order == found.realisation.order
    np.testing.assert_allclose(dropped.fit.whole, found.fit.whole, atol=1e-6)
    assert modal.load(found.save(tmp_path / "found.npz")).modes.system[3].frequency == found.modes.system[3].frequency


def test_what_is_not_linear_makes_no_modes_of_its_own():
    """A stop that the first mass meets half the time leaves most of the motion, at sums of frequencies."""
    rng = np.random.default_rng(3)
    force = rng.standard_normal((1, 5000))
    dampings, stiffnesses = [0.5, 0.5, 0.5], [1500.0, 1200.0, 1800.0]
    alone = run_chain([1.0, 1.2, 0.9], stiffnesses, dampings, force, 1 / 60, force_dof=2, n_steps=6)[0]
    gap = 0.5 * alone[:, 0].std()

    def stop(d, v, t):
        return 8e3 * np.maximum(0.0, d - gap)

    moved = run_chain([1.0, 1.2, 0.9], stiffnesses, dampings, force, 1 / 60, force_dof=2, law=stop, n_steps=6)[0]
    outputs = moved + 0.01 * moved.std(axis=0) * rng.standard_normal(moved.shape)
    found = modal.identify(Record(force[0], outputs, 1 / 60), observer_order=256, ridge=0.01)
    assert found.fit.mean < 0.5
    assert found.modes.system
    assert all(mode.participation.any() for mode in found.modes.system)
    made = [mode for mode in found.modes if not mode.participation.any()]
    assert made
    assert all("what is not linear" in mode.reason for mode in made)
