"""The model looks ahead where a force moves between its samples, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest
import scipy
from everyday_plate import EVERY, Plate, shaken
from noise_families import noise_record
from systems import modal_system, simulate

import era
import modal
import okid
from era.realisation import Realisation
from modal.estimation.feedback import FALSE_ALARMS, feedback_p_value
from modal.modes.response_synthesis import continuous_residue
from modal.preparation.delay import choose_input_delay, late_inputs, with_lead
from modal.preparation.steps import prepare
from modal.verdict.probability import delay_doubt
from okid.record import Record

FINER = 16
FREQUENCIES, DAMPING = np.array([31.0, 74.0, 138.0]), np.array([0.008, 0.006, 0.01])
ABOVE = np.array([540.0, 790.0])
"""Modes above half the sampling frequency, of which filtered accelerations show the answer that follows the force."""
DT = 1 / 512


def band_limited(seed, *, above, held=False, struck=False, n_rows=5000, structure=None):
    """Accelerations of modes under one force, sampled behind the filter that force and motion share; and the truth.

    The force is white noise of 16 times the rate, or held over each sample of the record, or one blow shorter than two
    samples, 60 rows after the record began. The structure is that of the seed, or of another one.
    """
    rng = np.random.default_rng(seed)
    drawn = np.random.default_rng([1, seed if structure is None else structure])
    frequencies = np.concatenate([FREQUENCIES, ABOVE if above else []])
    damping = np.concatenate([DAMPING, [0.01] * (len(frequencies) - 3)])
    force = np.repeat(rng.standard_normal(n_rows), FINER) if held else rng.standard_normal(n_rows * FINER)
    if struck:
        width, start = int(rng.integers(24, 33)), 160 * FINER + int(rng.integers(20 * FINER))
        force = np.zeros(n_rows * FINER)
        force[start : start + width] = np.sin(np.pi * (np.arange(width) + 0.5) / width)
    all_gains = drawn.uniform(0.5, 1.0, (len(frequencies), 4)) * drawn.choice([-1.0, 1.0], (len(frequencies), 4))
    motion = np.zeros((len(force), 4))
    for frequency, ratio, gain in zip(frequencies, damping, all_gains, strict=True):
        w = 2 * np.pi * frequency
        mode = scipy.signal.StateSpace(
            [[0.0, 1.0], [-(w**2), -2 * ratio * w]], [[0.0], [1.0]], [[-(w**2), -2 * ratio * w]], [[1.0]]
        )
        step = mode.to_discrete(DT / FINER, method="zoh" if held else "foh").to_tf()
        motion += np.outer(scipy.signal.lfilter(step.num.ravel(), step.den, force), gain)
    both = np.column_stack([force, motion])
    if not held:
        taps = scipy.signal.firwin(64 * FINER + 1, 0.9 / FINER, window=("kaiser", 8.0))
        both = scipy.signal.fftconvolve(both, taps[:, np.newaxis], mode="same", axes=0)
    kept = both[100 * FINER : -100 * FINER : FINER]
    outputs = kept[:, 1:] + 0.01 * kept[:, 1:].std(axis=0) * rng.standard_normal((len(kept), 4))
    return Record(kept[:, 0], outputs, DT, output_units=["m/s^2"] * 4, input_units=["N"]), all_gains


def lead_of(record):
    record = record.detrended()
    (delay,) = with_lead(choose_input_delay([record]), [record], [record]).samples
    return -delay


@pytest.mark.parametrize("above", [pytest.param(False, marks=pytest.mark.slow), True])
def test_a_force_that_moves_between_its_samples_is_looked_at_ahead_and_all_modes_are_right(above):
    record, gains = band_limited(1, above=above, n_rows=3000)
    result = modal.identify(record, observer_order=30, ridge=0.0)
    assert 1 <= -result.input_delay[0] < 20
    assert result.realisation.lead == -result.input_delay[0]
    found = result.modes.system
    assert len(found) == 3
    for mode, frequency, ratio, gain in zip(found, FREQUENCIES, DAMPING, gains, strict=False):
        assert abs(mode.frequency - frequency) < 4 * mode.frequency_std
        assert abs(mode.damping_ratio - ratio) < 4 * mode.damping_ratio_std
        assert mode.frequency_std < 1e-4 * frequency
        # residues of a force that acts at once: s^2 / (s^2 + 2 zeta w s + w^2) has p^2 / (2j Im p) at p
        scale = mode.pole**2 / (2j * mode.pole.imag)
        np.testing.assert_allclose(continuous_residue(mode, DT, hold="band_limited")[:, 0] / scale, gain, rtol=0.01)
    assert not [words for words in result.warnings if "feeds" in words]
    # what the force does to the outputs, modes above the sampling frequency too, is in the response of the whole
    lines = np.linspace(10.0, 200.0, 40)
    at = 2j * np.pi * lines[:, np.newaxis]
    w, ratios = 2 * np.pi * np.concatenate([FREQUENCIES, ABOVE]), np.concatenate([DAMPING, [0.01, 0.01]])
    truth = (at**2 / (at**2 + 2 * ratios * w * at + w**2))[:, : len(gains)] @ gains
    response = modal.frequency_response(result, lines).response[:, :, 0]
    assert np.abs(response - truth).max() < 0.02 * np.abs(truth).max()
    # and a free run of it leaves the noise, up to where the record ends before the inputs that it needs
    (used,), model = result.records, result.realisation
    run = era.simulate(model, used, initial_state=era.estimate_initial_state(model, used)).outputs
    assert np.isnan(run[-model.lead :]).all()
    by_stages = modal.extract_modes(model)
    for mode in found:
        again = min(by_stages, key=lambda other: abs(other.pole - mode.pole))
        np.testing.assert_allclose(again.participation, mode.participation, rtol=1e-6)
    left = (used.outputs - run)[: -model.lead]
    assert (left.std(axis=0) < 0.012 * used.outputs.std(axis=0)).all()


def test_blows_that_ring_before_they_fall_are_looked_at_ahead():
    """A force window took the ringing away, and what that left over was noise not understood."""
    records = [band_limited(seed, above=True, struck=True, n_rows=1000, structure=5)[0] for seed in range(80, 83)]
    result = modal.identify(records, observer_order=32, ridge=0.0)
    assert result.record_kind == "transient"
    assert 1 <= -result.input_delay[0] < 20
    assert not result.warnings
    assert result.fit.mean > 0.98
    found = result.modes.system
    assert len(found) == 3
    for mode, frequency, ratio in zip(found, FREQUENCIES, DAMPING, strict=True):
        assert abs(mode.frequency - frequency) < 4 * mode.frequency_std
        assert abs(mode.damping_ratio - ratio) < 4 * mode.damping_ratio_std
    # what is held over each sample, as in a simulation, does not ring
    held = [replace(record, inputs=np.where(np.arange(800) == 70, 1.0, 0.0)) for record in records]
    assert not min(prepare(held).input_delay) < 0


def test_a_record_too_short_to_look_ahead_in_forbids_it():
    record = band_limited(1, above=True)[0]
    assert prepare([record]).input_delay[0] < 0
    stub = band_limited(9, above=True, n_rows=300)[0].samples(0, 5)
    assert prepare([record, stub]).input_delay == (0,)


@pytest.mark.parametrize(("memory", "gain"), [(0.5, 0.3), (0.9, 0.3), (0.7, 0.5)])
def test_a_loop_that_soon_forgets_is_refused(memory, gain):
    """Its inputs follow the outputs, so those ahead tell of them, and nested regressions alone see 1 to 5 samples."""
    reference, noise = np.random.default_rng(1).standard_normal((2, 4000))
    inputs, outputs = np.zeros(4000), np.zeros(4000)
    for k in range(1, 4000):
        inputs[k] = reference[k] - gain * outputs[k - 1]
        outputs[k] = memory * outputs[k - 1] + inputs[k - 1] + noise[k]
    assert lead_of(Record(inputs, outputs, 0.1)) == 0


@pytest.mark.parametrize("seed", range(3))
def test_noise_that_grows_with_the_inputs_is_no_lead(seed):
    """Records of several levels, each with noise of its size: inputs 40 samples ahead tell as much, by chance."""
    rng = np.random.default_rng(seed)
    system = modal_system(rng, frequencies=[6.0, 21.0], damping_ratios=[0.02, 0.015], n_inputs=1, n_outputs=4)
    records = []
    for level in (0.2, 1.0, 5.0):
        force = level * rng.standard_normal((2000, 1))
        motion = simulate(system, force)
        motion += 0.2 * motion.std(axis=0) * rng.standard_normal(motion.shape)
        records.append(Record(force, motion, system.dt).detrended())
    assert with_lead(choose_input_delay(records), records, records).samples == (0,)


def test_a_force_held_over_each_sample_is_not():
    assert lead_of(band_limited(2, above=True, held=True)[0]) == 0


@pytest.mark.parametrize("kind", ["white", "coloured", "wind", "hidden", "input", "loop"])
def test_nothing_else_is_taken_for_one(kind):
    for system in range(3300, 3304):
        case = noise_record(kind, system=system, record=0)
        assert lead_of(Record(case.inputs[:, :1], case.outputs, case.system.dt)) == 0


def test_set_ups_look_ahead_together():
    """Each alone takes the lead that its noise lets it see, here 1 and 0; one model has one."""
    seen = ([0, 1], [0, 3])
    records = []
    for seed, outputs in zip((4, 5), seen, strict=True):
        record, gains = band_limited(seed, above=True, structure=4, n_rows=1500)
        names = [f"p{output}" for output in range(4)]
        record = replace(record, output_names=names, name=f"set-up {seed}")
        records.append(record.select(outputs=[names[output] for output in outputs]))
    assert [lead_of(record) for record in records] == [1, 0]
    result = modal.identify(okid.join_setups(records), observer_order=30, ridge=0.0, order=14)
    assert result.realisation.lead > 0
    found = result.modes.system
    assert len(found) == 3
    for mode, frequency, gain in zip(found, FREQUENCIES, gains[:, [0, 1, 3]], strict=False):
        assert abs(mode.frequency - frequency) < 4 * mode.frequency_std
        np.testing.assert_allclose(mode.shape / mode.shape[0], gain / gain[0], rtol=0.01)
        scale = mode.pole**2 / (2j * mode.pole.imag)
        np.testing.assert_allclose(continuous_residue(mode, DT, hold="band_limited")[:, 0] / scale, gain, rtol=0.02)


def test_the_edge_of_a_steep_filter_is_no_loop():
    """More of its own past foretells a force behind one than a controlled input: with 40 samples p is 8e-6."""
    rng = np.random.default_rng((12, 0))
    force, motion = shaken(rng, Plate(rng, n_above=0), 6000, EVERY)
    assert feedback_p_value(late_inputs([Record(force, motion, DT)], [-4])) > FALSE_ALARMS


def test_a_pole_that_dies_within_the_lead_may_be_of_the_input():
    modes = modal.extract_modes(Realisation([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.01)).modes
    assert delay_doubt(modes[0], 0.01) == ()
    (words,) = delay_doubt(modes[0], 0.01, ahead=4)
    assert "within the 4 samples that inputs are ahead and two more (50 % are left after one)" in words
