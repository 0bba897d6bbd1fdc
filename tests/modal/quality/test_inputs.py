import numpy as np
import pytest
import scipy.signal

from modal.quality.check import check_quality
from modal.quality.inputs import excitation_findings, hit_findings, hits_of, is_hammer, ring_findings
from okid.record import Record


def found(record, what):
    return [finding for finding in check_quality(record).findings if finding.what == what]


def force(starts, n=4000, width=9, size=1.0):
    values = 1e-4 * np.random.default_rng(0).standard_normal(n)
    for start in starts:
        values[start : start + width] += size * np.hanning(width + 2)[1:-1]
    return values


def test_a_hammer_is_told_from_shakers_bursts_and_earthquakes(channel_of):
    rng = np.random.default_rng(0)
    k = np.arange(4000)
    assert is_hammer(channel_of(force([100, 2000]), role="input"))
    quake = np.where((k > 1000) & (k < 1100), rng.standard_normal(4000), 1e-3 * rng.standard_normal(4000))
    for values in (rng.standard_normal(4000), quake, np.sin(0.1 * k), np.where(k > 400, 1.0, 0.0)):
        assert not is_hammer(channel_of(values, role="input"))
    assert not is_hammer(channel_of(force([100, 2000]), role="output"))


def test_hits_are_found_where_they_are(channel_of):
    (hits,) = hits_of(channel_of(force([100, 2000]), role="input"))
    assert [start for start, _ in hits] == pytest.approx([101, 2001], abs=1)


@pytest.mark.parametrize(("gap", "n_found"), [(60, 1), (900, 0)])
def test_a_double_hit_is_one_soon_after_another(channel_of, gap, n_found):
    channel = channel_of(force([300, 300 + gap]), role="input")
    none = np.empty(0)
    doubles = [f for f in hit_findings(channel, none, none, 1) if f.what == "double hit"]
    assert len(doubles) == n_found
    if doubles:
        ((_, start, _),) = doubles[0].spans
        assert start == pytest.approx(3.0, abs=0.02)


def test_the_force_spectrum_ends_where_it_has_fallen_to_a_hundredth(channel_of):
    frequencies = np.linspace(0, 50, 101)
    channel = channel_of(force([300]), role="input")
    (finding,) = hit_findings(channel, frequencies, np.where(frequencies < 20.25, 1.0, 0.005), 1)
    assert "at 20.5 Hz" in finding.sentence
    assert hit_findings(channel, frequencies, np.where(frequencies < 20.25, 1.0, 0.02), 1) == []


@pytest.mark.parametrize(("decay", "n_found"), [(0.0005, 1), (0.005, 0)])
def test_an_answer_that_rings_on_is_noted(channel_of, decay, n_found):
    """Left of the level after 3600 samples: 17 % and nothing; the limit is 10 %."""
    k = np.arange(4000)
    ringing = np.where(k > 400, np.exp(-decay * (k - 400.0)) * np.sin(0.5 * k), 0.0)
    hammer = hits_of(channel_of(force([400]), role="input"))
    assert len(ring_findings(channel_of(ringing), [hammer], 1)) == n_found
    assert ring_findings(channel_of(ringing), [], 1) == []


def test_inputs_that_are_one_signal_are_bad_and_two_signals_are_not():
    rng = np.random.default_rng(1)
    first, second, tip = rng.standard_normal((3, 3000))
    same = Record(np.column_stack([first, -2 * first]), tip, 0.01)
    assert [f.level for f in excitation_findings([same])] == ["bad"]
    assert excitation_findings([Record(np.column_stack([first, second]), tip, 0.01)]) == []


@pytest.mark.parametrize(("own", "n_found"), [(0.05, 1), (1.0, 0)])
def test_inputs_that_move_together_are_doubtful(own, n_found):
    """Coherence of two inputs with a common part: 1 / (1 + own^2)^2, 0.995 and 0.25; the limit is 0.95."""
    common, a, b, noise = np.random.default_rng(2).standard_normal((4, 20_000))
    inputs = np.column_stack([common + own * a, common + own * b])
    tip = scipy.signal.lfilter([0, 1], [1, -1.5, 0.8], inputs.sum(axis=1)) + 0.01 * noise
    alike = found(Record(inputs, tip, 0.01), "inputs alike")
    assert [f.level for f in alike] == ["doubtful"] * n_found


def test_a_sine_is_poor_excitation():
    k = np.arange(3000)
    (finding,) = [f for f in excitation_findings([Record(np.sin(0.3 * k), np.cos(0.3 * k), 0.01)]) if f.level != "note"]
    assert finding.what == "poor excitation"
    assert "order 2" in finding.sentence


@pytest.mark.parametrize(("size", "n_found"), [(0.5, 1), (0.05, 0)])
def test_motion_where_no_input_moves_is_doubtful(size, n_found):
    """20 and 0.25 % of the power at 40 Hz, where the input, filtered at 10 Hz, does nothing; the limit is 5 %."""
    rng = np.random.default_rng(3)
    sos = scipy.signal.butter(8, 0.2, output="sos")
    drive = scipy.signal.sosfilt(sos, rng.standard_normal(20_000))
    tip = scipy.signal.lfilter([0, 1], [1, -1.8, 0.95], drive)
    other = scipy.signal.lfilter(*scipy.signal.butter(2, [0.78, 0.82], "band"), rng.standard_normal(20_000))
    undriven = found(Record(drive, tip / tip.std() + size * other / other.std(), 0.01), "undriven motion")
    assert len(undriven) == n_found


def test_without_inputs_that_is_said():
    (finding,) = excitation_findings([Record(np.empty((500, 0)), np.random.default_rng(0).standard_normal(500), 0.01)])
    assert (finding.level, finding.what) == ("note", "no input")


def test_a_dead_input_is_named_once():
    rng = np.random.default_rng(0)
    dead = check_quality(Record(np.zeros(3000), rng.standard_normal(3000).cumsum(), 0.01))
    assert [finding.what for finding in dead.findings if finding.what in {"constant", "poor excitation"}] == [
        "constant"
    ]
    sine = Record(np.sin(0.3 * np.arange(3000)), rng.standard_normal(3000), 0.01)
    assert "poor excitation" in {finding.what for finding in check_quality(sine).findings}
