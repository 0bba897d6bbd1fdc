"""The model looks ahead where a force moves between its samples, and nowhere else."""

import numpy as np
import pytest
import scipy
from noise_families import noise_record

import era
import modal
from modal.preparation.delay import choose_input_delay
from modal.preparation.lead import with_lead
from okid.record import Record

FINER = 16
FREQUENCIES, DAMPING = np.array([31.0, 74.0, 138.0]), np.array([0.008, 0.006, 0.01])
ABOVE = np.array([540.0, 790.0])
"""Modes above half the sampling frequency, of which filtered accelerations show the answer that follows the force."""
DT = 1 / 512


def band_limited(seed, *, above, held=False, n_rows=5000):
    """Accelerations of modes under one force, sampled behind the filter that force and motion share; and the truth.

    The force is white noise of 16 times the rate, or held over each sample of the record.
    """
    rng = np.random.default_rng(seed)
    frequencies = np.concatenate([FREQUENCIES, ABOVE if above else []])
    damping = np.concatenate([DAMPING, [0.01] * (len(frequencies) - 3)])
    force = np.repeat(rng.standard_normal(n_rows), FINER) if held else rng.standard_normal(n_rows * FINER)
    all_gains = rng.uniform(0.5, 1.0, (len(frequencies), 4)) * rng.choice([-1.0, 1.0], (len(frequencies), 4))
    motion = np.zeros((len(force), 4))
    for frequency, ratio, gain in zip(frequencies, damping, all_gains, strict=True):
        w = 2 * np.pi * frequency
        mode = scipy.signal.StateSpace(
            [[0.0, 1.0], [-(w**2), -2 * ratio * w]], [[0.0], [1.0]], [[-(w**2), -2 * ratio * w]], [[1.0]]
        )
        _, answer, _ = scipy.signal.lsim(mode, force, np.arange(len(force)) * DT / FINER, interp=not held)
        motion += np.outer(answer, gain)
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


@pytest.mark.parametrize("above", [False, True])
def test_a_force_that_moves_between_its_samples_is_looked_at_ahead_and_all_modes_are_right(above):
    record, gains = band_limited(1, above=above)
    result = modal.identify(record)
    assert 1 <= -result.input_delay[0] <= 20
    assert result.realisation.lead == -result.input_delay[0]
    found = result.modes.system
    assert len(found) == 3
    for mode, frequency, ratio in zip(found, FREQUENCIES, DAMPING, strict=True):
        assert abs(mode.frequency - frequency) < 4 * mode.frequency_std
        assert abs(mode.damping_ratio - ratio) < 4 * mode.damping_ratio_std
        assert mode.frequency_std < 1e-4 * frequency
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
    left = (used.outputs - run)[: -model.lead]
    assert (left.std(axis=0) < 0.012 * used.outputs.std(axis=0)).all()


def test_a_force_held_over_each_sample_is_not():
    assert lead_of(band_limited(2, above=True, held=True)[0]) == 0


@pytest.mark.parametrize("kind", ["white", "coloured", "wind", "hidden", "input", "loop"])
def test_nothing_else_is_taken_for_one(kind):
    for system in range(3300, 3304):
        case = noise_record(kind, system=system, record=0)
        assert lead_of(Record(case.inputs[:, :1], case.outputs, case.system.dt)) == 0
