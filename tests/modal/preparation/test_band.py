import numpy as np
import pytest
import scipy
from signals import random_inputs, with_noise
from systems import initial_state, modal_system, random_chain, simulate

from modal.preparation.band import COHERENT, FOLLOWS, chance_of_following, coherent_band
from okid.record import Record


def record_of(rng, system, n_samples=4000, *, noise=0.02):
    inputs = random_inputs(rng, n_samples, system.n_inputs)
    outputs = simulate(system, inputs, initial_state=initial_state(rng, system, inputs))
    return Record(inputs, with_noise(rng, outputs, noise), system.dt).detrended()


def oversampled(seed=1, n_samples=6000, *, noise=0.02):
    """Displacements of a chain whose highest mode lies at 4 % of the sampling frequency."""
    rng = np.random.default_rng(seed)
    system = random_chain(rng, sensor_kinds="displacement", highest_share=0.04, damping_ratio=0.03)
    return system, record_of(rng, system, n_samples, noise=noise)


def test_a_system_that_fills_the_band_is_not_decimated():
    rng = np.random.default_rng(1)
    system = modal_system(rng, frequencies=[4.0, 20.0, 41.0], damping_ratios=[0.02] * 3)
    band = coherent_band([record_of(rng, system)])
    assert band.factor == 1
    assert band.upper_frequency > 41.0
    assert "nothing to gain from decimation" in band.reason
    assert band.coherence.shape == (band.frequencies.size, 3)
    assert band.frequencies[-1] == pytest.approx(50.0)


def test_an_oversampled_record_is_decimated_and_keeps_every_mode():
    system, record = oversampled()
    band = coherent_band([record])
    assert band.factor >= 3
    # every mode below 0.8 of the new half sampling frequency: the promise of the factor
    assert system.frequencies.max() < band.upper_frequency <= 0.8 * 50.0 / band.factor
    assert f"decimated by {band.factor}" in band.reason
    assert f"below {band.upper_frequency:.4g} Hz" in band.reason
    assert "goes to 50 Hz" in band.reason


def test_a_short_record_keeps_its_samples():
    _, record = oversampled(n_samples=6000)
    assert coherent_band([record.samples(0, 1400)]).factor <= 2
    assert coherent_band([record.samples(0, 900)]).factor == 1


def test_several_records_are_one():
    _, record = oversampled()
    parts = record.split(0.3, 0.3)
    whole, apart = coherent_band([record]), coherent_band(parts)
    assert apart.factor == pytest.approx(whole.factor, abs=1)
    assert apart.factor > 1


def test_a_short_record_among_long_ones_does_not_spoil_the_resolution():
    _, record = oversampled()
    alone, together = coherent_band([record]), coherent_band([record, record.samples(0, 400)])
    assert together.frequencies.size == alone.frequencies.size
    # but many short ones set it
    assert coherent_band([record.samples(i, i + 100) for i in range(0, 6000, 100)]).frequencies.size == 51


@pytest.mark.parametrize("share", [0.05, 0.2])
def test_a_weak_mode_high_up_is_not_cut_off(share):
    """A mode that moves its output by more than 1 % stays in the band."""
    rng = np.random.default_rng(5)
    low = random_chain(rng, n_masses=2, sensor_kinds="displacement", highest_share=0.03, damping_ratio=0.05)
    high = modal_system(rng, frequencies=[33.0], damping_ratios=[0.005], n_outputs=2, feedthrough=0.0)
    inputs = random_inputs(rng, 6000, 2)
    slow, fast = simulate(low, inputs), simulate(high, inputs)
    fast *= share * slow.std(axis=0) / fast.std(axis=0)
    outputs = with_noise(rng, slow + fast, 0.002)
    without = coherent_band([Record(inputs, with_noise(rng, slow, 0.002), 0.01).detrended()])
    band = coherent_band([Record(inputs, outputs, 0.01).detrended()])
    assert without.upper_frequency < 25.0  # so it is the weak mode that keeps the band
    assert band.upper_frequency > 33.0
    assert band.factor == 1


def test_no_input_keeps_the_band():
    _, record = oversampled()
    band = coherent_band([record.select(inputs=[])])
    assert (band.factor, band.upper_frequency) == (1, pytest.approx(50.0))
    assert "no input" in band.reason


def test_too_few_averages_are_said():
    rng = np.random.default_rng(2)
    band = coherent_band([Record(rng.standard_normal((40, 3)), rng.standard_normal(40), 0.01)])
    assert band.factor == 1
    assert "too short" in band.reason


def test_gaps_everywhere_are_said():
    _, record = oversampled()
    outputs = record.outputs.copy()
    outputs[::40, 0] = np.nan
    band = coherent_band([Record(record.inputs, outputs, record.dt)])
    assert band.factor == 1
    assert "between its gaps" in band.reason
    assert "0 averages" in band.reason


def test_outputs_that_follow_nothing_keep_the_band():
    rng = np.random.default_rng(3)
    band = coherent_band([Record(rng.standard_normal((3000, 2)), rng.standard_normal((3000, 2)), 0.01)])
    assert (band.factor, band.upper_frequency) == (1, pytest.approx(50.0))


def test_an_output_that_follows_nothing_does_not_hide_one_that_does():
    system, record = oversampled()
    noise = np.random.default_rng(4).standard_normal(record.n_samples)
    outputs = np.column_stack([record.outputs, noise])
    band = coherent_band([Record(record.inputs, outputs, record.dt)])
    assert band.upper_frequency > system.frequencies.max()


def test_coherence_is_that_of_the_known_noise():
    """y = u + v: coherence is 1 / (1 + var v), whatever the frequency; noise alone has none."""
    rng = np.random.default_rng(6)
    u, v, w = rng.standard_normal((3, 60000))
    band = coherent_band([Record(u, np.column_stack([u + 0.5 * v, w]), 0.01)])
    np.testing.assert_allclose(band.coherence[:, 0].mean(), 0.8, atol=0.02)
    assert band.coherence[:, 1].mean() < 0.02
    assert (band.coherence[:, 0] > COHERENT).all()


def test_chance_coherence_is_taken_off():
    """Two inputs explain a share 2 / n of pure noise in n averages: about 0.04 here."""
    rng = np.random.default_rng(7)
    band = coherent_band([Record(rng.standard_normal((3000, 2)), rng.standard_normal((3000, 3)), 0.01)])
    assert 0.0 < band.coherence.mean() < 0.03


def test_modes_buried_in_noise_follow_the_inputs_and_an_empty_band_does_not():
    told = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        system = modal_system(rng, frequencies=[4.0, 11.0, 20.0], damping_ratios=[0.005, 0.02, 0.01])
        inputs = random_inputs(rng, 20_000, system.n_inputs)
        lines = np.fft.rfftfreq(len(inputs), system.dt)
        inputs = np.fft.irfft(np.fft.rfft(inputs, axis=0) * (lines < 25.0)[:, None], len(inputs), axis=0)
        inputs += 0.003 * rng.standard_normal(inputs.shape)
        outputs = simulate(system, inputs)
        outputs = outputs + 3.0 * outputs.std(axis=0) * rng.standard_normal(outputs.shape)
        told.append(
            chance_of_following([Record(inputs, outputs, system.dt)], [4.0, 11.0, 20.0, 40.0], [0.02, 0.1, 0.1, 1.0])
        )
    told = np.array(told)
    assert (told[:, :3].min(axis=1) < 1e-4).all()
    assert (told[:, 3] > 0.01).sum() >= 11


@pytest.mark.parametrize("seed", range(6))
def test_segments_shorter_than_a_modes_memory_accuse_nothing(seed):
    """250 samples of a mode that rings for 130: its answer lies outside the segment of the force that made it."""
    rng = np.random.default_rng(seed)
    force = rng.standard_normal(250)
    pole = np.exp((-0.02 + 1j) * 2 * np.pi * 3.0 * 0.02)
    motion = scipy.signal.lfilter([0, 1.0], [1, -2 * pole.real, abs(pole) ** 2], force)
    outputs = np.outer(motion, (1.0, -0.5)) + 0.02 * rng.standard_normal((250, 2))
    assert chance_of_following([Record(force, outputs, 0.02)], [3.0], [0.03])[0] < FOLLOWS


def struck(seed, *, tops=(), n_samples=4000, noise=0.003, at=700, length=5):
    """One hit in a record of rest: slow modes, and others of the displacement's size that falls with 1 / f^2."""
    rng = np.random.default_rng(seed)
    frequencies = np.array([1.1, 1.7, 2.6, *tops])
    system = modal_system(rng, frequencies=frequencies, damping_ratios=[0.02] * frequencies.size, n_outputs=2)
    inputs = np.zeros((n_samples, system.n_inputs))
    inputs[at : at + length] = np.hanning(length + 2)[1:-1, np.newaxis]
    clean = simulate(system, inputs)
    outputs = clean + noise * np.abs(clean).max(axis=0) * rng.standard_normal(clean.shape)
    return Record(inputs, outputs, system.dt)


@pytest.mark.parametrize("seed", range(4))
def test_what_one_hit_carries_above_rest_stays_in_the_band(seed):
    """Averages over segments in which nothing acts hide it: their coherence is that of noise."""
    slow, fast = coherent_band([struck(seed)]), coherent_band([struck(seed, tops=(21.0,))])
    assert slow.factor >= 3
    assert "stands above the rest" in slow.reason
    assert fast.upper_frequency > 20.5
    assert fast.factor == 1


def test_a_mode_that_rings_through_the_whole_record_is_not_taken_for_rest():
    """Hit in the first row, no rest anywhere: the mode is as loud at the end as at the start."""
    rng = np.random.default_rng(3)
    inputs = np.zeros((4000, 1))
    inputs[:3, 0] = 1.0
    time = np.arange(4000) * 0.01
    low, high = np.exp(-0.7 * time) * np.sin(2 * np.pi * 1.5 * time), 0.05 * np.sin(2 * np.pi * 31.0 * time)
    outputs = low + high + 0.005 * rng.standard_normal(4000)
    assert coherent_band([Record(inputs, outputs, 0.01)]).upper_frequency > 30.5
    assert coherent_band([Record(inputs, outputs - high, 0.01)]).upper_frequency < 10.0


def test_the_units_of_channels_move_no_coherence():
    """A force in kN beside a shaft's speed in rpm: a floor common to all inputs hid what follows the small one."""
    rng = np.random.default_rng(5)
    inputs = rng.standard_normal((4000, 3))
    outputs = scipy.signal.lfilter([1.0], [1.0, -0.9], inputs @ rng.standard_normal((3, 2)), axis=0)
    outputs += 0.1 * rng.standard_normal(outputs.shape)
    units = 2.0 ** np.array([-20, 0, 20, -30, 13])
    first, second = (
        coherent_band([Record(inputs * many[:3], outputs * many[3:], 0.01)]) for many in (np.ones(5), units)
    )
    np.testing.assert_allclose(first.coherence, second.coherence, atol=1e-12)
    assert first.reason == second.reason


@pytest.mark.parametrize("seed", [3, 10, 11, 15])
def test_modes_that_ring_on_for_longer_than_a_segment_lie_in_the_band(seed):
    """A downward sweep passes them in the last seconds: what they go on to do follows nothing in later segments."""
    rng = np.random.default_rng(seed)
    truth = random_chain(
        rng,
        n_masses=5,
        n_inputs=1,
        sensor_kinds="displacement",
        highest_share=0.041,
        damping_ratio=0.006,
        dt=0.002,
    )
    time = truth.dt * np.arange(10_000)
    force = np.sin(2.0 * np.pi * (200.0 * time - 0.5 * (197.0 / time[-1]) * time**2))[:, np.newaxis]
    moved = simulate(truth, force)[:, :2]
    moved += 0.012 * moved.std(axis=0) * rng.standard_normal(moved.shape)
    band = coherent_band([Record(force, moved, truth.dt).detrended()])
    assert 0.5 / truth.dt / band.factor > 1.2 * 20.5
