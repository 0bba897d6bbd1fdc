"""What must not change modes and verdicts: the order of channels, their units, more noise, twice the data.

Nothing is given but the record, so every choice of `identify` takes part.
"""

import numpy as np
import pytest
from signals import random_inputs, with_noise
from systems import modal_system, simulate

from modal.identification.pipeline import identify
from okid.record import Record

FREQUENCIES, DAMPING = [5.0, 13.0, 21.0], [0.02, 0.01, 0.03]
OUTPUTS, INPUTS = [2, 0, 1], [1, 0]


def truth():
    rng = np.random.default_rng(3101)
    system = modal_system(rng, frequencies=FREQUENCIES, damping_ratios=DAMPING, n_inputs=2, n_outputs=3)
    inputs = random_inputs(rng, 3200, 2)
    return rng, inputs, simulate(system, inputs), system.dt


def record_of(n_samples=1600, noise=0.02):
    rng, inputs, outputs, dt = truth()
    return Record(inputs[:n_samples], with_noise(rng, outputs[:n_samples], noise), dt)


@pytest.fixture(scope="module")
def plain():
    return identify(record_of())


def numbers(result):
    return np.array([(mode.frequency, mode.damping_ratio, mode.probability) for mode in result.modes.system])


def verdicts(result):
    return [mode.verdict for mode in result.modes.system], [mode.damping_resolved for mode in result.modes.system]


def test_the_modes_are_the_true_ones(plain):
    found = numbers(plain)
    assert len(found) == 3
    np.testing.assert_allclose(found[:, 0], FREQUENCIES, rtol=0.003)
    np.testing.assert_allclose(found[:, 1], DAMPING, rtol=0.25)
    assert verdicts(plain) == (["system"] * 3, [True] * 3)


def test_order_and_units_of_the_channels_permute_and_scale_shapes_and_nothing_else(plain):
    """The first output in millimetres, the inputs in kilonewtons, all in another order."""
    record, units = record_of(), np.array([1e3, 1.0, 1.0])
    other = identify(Record(1e-3 * record.inputs[:, INPUTS], (record.outputs * units)[:, OUTPUTS], record.dt))
    assert verdicts(other) == verdicts(plain)
    np.testing.assert_allclose(numbers(other), numbers(plain), rtol=1e-5)
    for one, turned in zip(plain.modes.system, other.modes.system, strict=True):
        expected = (one.shape * units)[OUTPUTS]
        product = np.vdot(expected, turned.shape)
        assert abs(product) ** 2 == pytest.approx(
            np.vdot(expected, expected).real * np.vdot(turned.shape, turned.shape).real, rel=1e-6
        )


def within_their_deviations(one, other):
    for mode, again in zip(one.modes.system, other.modes.system, strict=True):
        for what in ("frequency", "damping_ratio"):
            spread = np.hypot(getattr(mode, f"{what}_std"), getattr(again, f"{what}_std"))
            assert abs(getattr(mode, what) - getattr(again, what)) < 5 * spread


def test_three_times_the_noise_leaves_the_verdicts_and_widens_the_deviations(plain):
    noisy = identify(record_of(noise=0.06))
    assert verdicts(noisy) == verdicts(plain)
    within_their_deviations(plain, noisy)
    wider = [
        again.frequency_std / one.frequency_std
        for one, again in zip(plain.modes.system, noisy.modes.system, strict=True)
    ]
    np.testing.assert_allclose(wider, 3.0, rtol=0.25)


def test_twice_the_data_leave_the_verdicts_and_narrow_the_deviations(plain):
    longer = identify(record_of(3200))
    assert verdicts(longer) == verdicts(plain)
    within_their_deviations(plain, longer)
    narrower = [
        again.frequency_std / one.frequency_std
        for one, again in zip(plain.modes.system, longer.modes.system, strict=True)
    ]
    np.testing.assert_allclose(narrower, np.sqrt(0.5), rtol=0.25)
