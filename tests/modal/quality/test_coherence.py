import numpy as np
import pytest
import scipy.signal
from signals import answer

from modal.modes.response_synthesis import measured_frf
from modal.quality.coherence import explained_share, in_excess_of_chance, modelled_share
from okid.frequency_response import averaged_spectra, segment_length
from okid.record import Record


@pytest.mark.parametrize("n_inputs", [1, 3])
def test_unrelated_channels_are_explained_by_chance_only(n_inputs):
    rng = np.random.default_rng(0)
    record = Record(rng.standard_normal((40_000, n_inputs)), rng.standard_normal((40_000, 4)), 0.01)
    frf = measured_frf(record, n_per_segment=2048)
    power = averaged_spectra(record, n_per_segment=2048).power[:, n_inputs:]
    assert np.abs(explained_share(frf, power)).max() < 0.02
    assert frf.multiple_coherence.mean() > 0.02 * n_inputs  # what is taken off


def test_half_noise_is_half_explained():
    rng = np.random.default_rng(1)
    force = rng.standard_normal(60_000)
    tip = answer(force) + rng.standard_normal(60_000)
    record = Record(force, tip, 0.01)
    frf, spectra = measured_frf(record, n_per_segment=1024), averaged_spectra(record, n_per_segment=1024)
    assert explained_share(frf, spectra.power[:, 1:]) == pytest.approx([0.5], abs=0.03)
    assert modelled_share([record]) == pytest.approx([0.5], abs=0.05)
    assert in_excess_of_chance(np.array([1.0]), 9, 1) == pytest.approx([1.0])


@pytest.mark.parametrize(("noise", "level"), [(0.1, None), (0.6, "note"), (1.5, "doubtful"), (5.0, "bad")])
def test_the_words_follow_the_share(noise, level, found):
    """Explained shares of 99, 74, 31 and 4 %: the limits are 90, 50 and 10 %."""
    rng = np.random.default_rng(2)
    force = rng.standard_normal(20_000)
    slow_noise = scipy.signal.lfilter([1.0], [1.0, -0.9], rng.standard_normal(20_000))
    record = Record(force, answer(force) + noise * slow_noise / slow_noise.std(), 0.01)
    low = found(record, "low coherence")
    assert [finding.level for finding in low] == ([] if level is None else [level])
    if low:
        assert 1.0 - low[0].share == pytest.approx(1 / (1 + noise**2), abs=0.05)


def test_a_ringing_longer_than_the_segments_is_leakage_not_noise(found):
    force = np.random.default_rng(3).standard_normal(6000)
    record = Record(force, answer(force, damping=0.0005), 0.01)
    assert found(record, "low coherence") == []
    (finding,) = found(record, "leakage")
    assert finding.level == "note"


def test_the_bands_named_are_those_that_are_noisy(found):
    rng = np.random.default_rng(4)
    force = rng.standard_normal(60_000)
    hiss = scipy.signal.lfilter(*scipy.signal.butter(4, [0.5, 0.6], "band"), rng.standard_normal(60_000))
    record = Record(force, answer(force) + hiss / hiss.std(), 0.01)
    (finding,) = found(record, "low coherence")
    words = finding.sentence.split("least in ")[1].split(" Hz")[0].split(" to ")
    assert float(words[0]) == pytest.approx(25.0, abs=1.5)
    assert float(words[1]) == pytest.approx(30.0, abs=1.5)


def test_averaged_spectra_are_sums_over_whole_segments():
    rng = np.random.default_rng(5)
    inputs, outputs = rng.standard_normal((300, 2)), rng.standard_normal((300, 3))
    outputs[100, 0] = np.nan
    records = [Record(inputs, outputs, 0.1), Record(inputs[:70], outputs[:70], 0.1)]
    spectra = averaged_spectra(records, n_per_segment=32)
    both = np.hstack([inputs, outputs])
    starts = [range(0, 100 - 31, 16), range(101, 300 - 31, 16), range(0, 70 - 31, 16)]
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(32) / 32)
    segments = [both[k : k + 32] for part in starts for k in part]
    lines = [np.fft.rfft(window[:, None] * (s - s.mean(axis=0)), axis=0) for s in segments]
    full = sum(x[:, :, None] * x[:, None].conj() for x in lines)
    assert spectra.n_averages == len(segments)
    assert np.allclose(spectra.inputs, full[:, :2, :2])
    assert np.allclose(spectra.cross, full[:, 2:, :2])
    assert np.allclose(spectra.power, np.einsum("fii->fi", full).real)
    assert segment_length(records) == 32  # 369 whole rows, an eighth of them, a power of two


def test_the_density_of_white_noise_is_its_variance_over_the_band():
    rng = np.random.default_rng(6)
    record = Record(np.empty((50_000, 0)), 3.0 * rng.standard_normal((50_000, 1)), 0.01)
    spectra = averaged_spectra(record, n_per_segment=256)
    density = spectra.power[1:-1, 0] * spectra.to_density
    assert density.mean() == pytest.approx(9.0 / 50.0, rel=0.02)


def test_a_dead_output_takes_nothing_from_its_neighbours():
    force = np.random.default_rng(3).standard_normal(6000)
    outputs = np.column_stack([np.full(6000, 3.0), answer(force, damping=0.0005)])
    shares = modelled_share([Record(force, outputs, 0.01)])
    assert np.isnan(shares[0])
    assert shares[1] > 0.95
    dead = np.column_stack([force, np.zeros(6000)])
    assert modelled_share([Record(dead, outputs, 0.01)])[1] > 0.95
    assert np.isnan(modelled_share([Record(np.zeros(6000), outputs, 0.01)])).all()


def test_the_worst_of_leaking_outputs_is_named_with_their_number(found):
    force = np.random.default_rng(3).standard_normal(6000)
    outputs = np.column_stack([answer(force, damping=0.0005), answer(force, damping=0.001)])
    (finding,) = found(Record(force, outputs, 0.01), "leakage")
    assert "'output_0', the least of 2," in finding.sentence
    (alone,) = found(Record(force, outputs[:, :1], 0.01), "leakage")
    assert "least of" not in alone.sentence


@pytest.mark.parametrize(("every", "is_blamed"), [(1000, True), (20_000, False)])
def test_inputs_that_change_in_few_places_leave_the_share_to_chance(every, is_blamed, found):
    """Steps in twenty places, or in one."""
    rng = np.random.default_rng(6)
    force = np.repeat(rng.standard_normal(20_000 // every), every) if is_blamed else np.arange(20_000) > 9000
    hiss = scipy.signal.lfilter([1.0], [1.0, -0.9], rng.standard_normal(20_000))
    (finding,) = found(Record(force * 1.0, answer(force * 1.0) + hiss / hiss.std(), 0.01), "low coherence")
    assert ("the rest is noise" in finding.sentence) is is_blamed
    assert ("change in few places" in finding.sentence) is not is_blamed
