import numpy as np
import pytest
import scipy.signal

from modal.quality.check import check_quality
from modal.quality.inputs import excitation_findings
from okid.record import Record


def found(record, what):
    return [finding for finding in check_quality(record).findings if finding.what == what]


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
