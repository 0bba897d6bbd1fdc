"""A half of the record that inputs hardly drive, or whose observer they hardly determine, is no other answer."""

import numpy as np
import pytest
from scipy.signal import butter, chirp, lfilter, sosfilt, sosfiltfilt
from signals import with_noise
from systems import modal_system, simulate

from modal.identification.pipeline import identify
from modal.modes.mode import ModalModel, Mode
from modal.verdict.judgement import Rerun, Reruns, judge
from okid.record import Record

DT = 0.01
N_SAMPLES = 6000
FREQUENCIES = (5.0, 9.0, 21.0)


def answered(rng, u, *, frequencies=FREQUENCIES, damping_ratios=(0.006, 0.01, 0.008), noise=0.02):
    made = modal_system(
        rng, frequencies=frequencies, damping_ratios=damping_ratios, n_inputs=1, n_outputs=3, feedthrough=0.0, dt=DT
    )
    return Record(u[:, None], with_noise(rng, simulate(made, u[:, None]), noise), DT)


def of_system(result):
    return sorted(mode.frequency for mode in result.modes.system)


def halves(result):
    return [dict(mode.reappears)["halves of the data"] for mode in result.modes.system]


def test_a_sweep_with_harmonics_shows_each_mode_in_both_halves():
    """Each tenth of the record is swept through other frequencies; the halves gave 0.50."""
    rng, time = np.random.default_rng((0, 5)), DT * np.arange(N_SAMPLES)
    wave = chirp(time, 1.0, time[-1], 40.0)
    record = answered(rng, wave + 0.05 * wave**2 + 0.1 * wave**3)
    result = identify(record, observer_order=120, ridge=0.0, order=6, input_delay=0)
    assert of_system(result) == pytest.approx(FREQUENCIES, rel=1e-4)
    assert min(halves(result)) > 0.95
    assert all(mode.damping_resolved for mode in result.modes.system)


def in_half_of_the_band(seed):
    """Five periods of 294 sines up to half of the Nyquist frequency."""
    rng, lines = np.random.default_rng((seed, 6)), np.zeros(601, dtype=complex)
    lines[6:300] = np.exp(2j * np.pi * rng.random(294))
    wave = np.tile(np.fft.irfft(lines), 5)
    return answered(rng, wave / wave.std())


@pytest.mark.parametrize("order", [7, pytest.param(12, marks=pytest.mark.slow)])
def test_half_of_the_band_shows_its_modes_and_no_others_whatever_poles_are_left_over(order):
    """Halves and other orders were cut from what no input drives: none of the three modes was found again."""
    result = identify(in_half_of_the_band(1), observer_order=60, ridge=0.0, order=order, input_delay=0)
    assert of_system(result) == pytest.approx(FREQUENCIES, rel=1e-4)
    assert min(halves(result)) > 0.95


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_mode_that_one_part_alone_drives_does_not_take_the_others_with_it(seed):
    """The first seconds drive 6 Hz, all others 20 Hz; a fifth of noise hides what else they do."""
    rng = np.random.default_rng((seed, 7))
    white = rng.standard_normal(N_SAMPLES)
    force = sosfiltfilt(butter(8, [0.36, 0.5], "band", output="sos"), white)
    force[:350] = 0.2 * sosfiltfilt(butter(4, [0.1, 0.14], "band", output="sos"), white)[:350]
    record = answered(rng, force, frequencies=(6.0, 20.0), damping_ratios=(0.02, 0.01), noise=0.2)
    result = identify(record, observer_order=40, ridge=0.0, order=4, input_delay=0)
    *early, late = of_system(result)
    assert late == pytest.approx(20.0, rel=1e-3)
    assert early == pytest.approx([6.0][: len(early)], rel=5e-3)  # a mode, whether or not 350 rows make it certain
    assert halves(result)[-1] > 0.95


RATE = 500.0
TIGHT = (7.6, 11.7, 14.5, 18.7, 21.1)
TIGHT_DAMPING = (0.026, 0.01, 0.016, 0.024, 0.004)


def swept_past(seed, *, frequencies=TIGHT, duration=10.0, ends=(3.0, 200.0), noise=0.007, n_outputs=2, colour=0.0):
    """A sweep up to 200 Hz that meets all modes in 7 % of the record; eight times oversampled, filtered, decimated."""
    rng, over = np.random.default_rng((seed, 8)), 8
    time = np.arange(int(over * RATE * duration)) / (over * RATE)
    force = chirp(time, ends[0], duration, ends[1]) * np.minimum(1.0, 10.0 * np.minimum(time, duration - time))
    motion = np.zeros((time.size, n_outputs))
    for frequency, damping in zip(frequencies, TIGHT_DAMPING, strict=False):
        w = 2 * np.pi * frequency
        pole = w * (-damping + 1j * np.sqrt(1 - damping**2))
        step = np.exp(pole / (over * RATE))
        state = lfilter([0.0, (step - 1) / pole], [1.0, -step], force.astype(complex))
        shape = rng.uniform(0.5, 1.0, n_outputs) * rng.choice([-1.0, 1.0], n_outputs)
        motion += np.outer((state / (1j * pole.imag)).real * w, shape)
    filtered = butter(6, 0.4 * RATE, fs=over * RATE, output="sos")
    u, y = (sosfilt(filtered, one, axis=0)[::over] for one in (force[:, None], motion))
    scatter = np.where(y.std(axis=0) > 0, noise * y.std(axis=0), 1.0)
    errors = lfilter([np.sqrt(1 - colour**2)], [1.0, -colour], rng.standard_normal(y.shape), axis=0)
    return Record(u, y + scatter * errors, 1 / RATE)


@pytest.mark.parametrize(
    ("seed", "ends", "observer"),
    [
        pytest.param(2, (200.0, 4.0), {}, marks=pytest.mark.slow),
        (4, (200.0, 4.0), {"observer_order": 91, "ridge": 1e-6}),
        (11, (3.0, 200.0), {"observer_order": 32, "ridge": 0.0}),
    ],
)
def test_modes_that_a_sweep_passes_in_one_tenth_of_the_record_are_found_in_both_halves(seed, ends, observer):
    """A fold or half of tenths held all five modes or none: up to five were not found, or called noise."""
    result = identify(swept_past(seed, ends=ends), **observer)
    assert of_system(result) == pytest.approx(TIGHT, rel=2e-3)
    assert min(halves(result)) > 0.75
    for mode, frequency in zip(sorted(result.modes.system, key=lambda mode: mode.frequency), TIGHT, strict=True):
        assert abs(mode.frequency - frequency) < 5.0 * mode.frequency_std


def test_a_sweep_that_nothing_follows_shows_no_mode():
    """A model of the noise without a state of the system ended in a traceback."""
    result = identify(swept_past(4, frequencies=(), duration=5.0, colour=0.8), observer_order=8, ridge=0.9)
    assert not of_system(result)


def lost_in_one_half(evidence):
    pole = 2 * np.pi * 5.0 * (-0.02 + 1j)
    mode = Mode(pole=pole, kind="oscillatory", frequency=5.0, damping_ratio=0.02, shape=np.ones(3) + 0j,
                participation=np.ones(1) + 0j)  # fmt: skip
    whole, nothing = (ModalModel(modes=modes, dt=DT, indicator_caution=0.1) for modes in ((mode,), ()))
    runs = [Rerun(label="half", change="data", modes=nothing, evidence=np.array([one])) for one in evidence] + [
        Rerun(label="observer", change="observer", modes=whole)
    ]
    found = Reruns(runs=tuple(runs), n_steps=300, output_scale=np.ones(3), input_scale=np.ones(1))
    return judge(whole, found, gain=np.array([0.5]), n_values=6000).modes[0].reason


def test_where_one_half_alone_was_driven_that_is_said_and_not_that_they_disagree():
    assert lost_in_one_half([500.0, 400.0]).startswith("the two halves of the data disagree about it")
    assert lost_in_one_half([500.0, 1.0]).startswith("only one part of the record drives it, so that it repeats cannot")
    assert lost_in_one_half([8.0, 1.0]).startswith("the two halves")  # noise: neither shows much
