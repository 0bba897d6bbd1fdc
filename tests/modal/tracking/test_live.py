"""A sliding window: equal to the fit of its rows, stamped in its middle, with gaps, jumps and drifts said."""

import numpy as np
import pytest

import modal
from era.balanced import realise
from modal.modes.extraction import extract_modes
from okid.errors import InvalidDataError
from okid.markov import recover_markov
from okid.observer import fit_observer
from okid.record import Record

DT, N = 0.01, 6000


def driven(frequency, *, damping=0.01, n_samples=N, noise=0.0, seed=3):
    """A mode whose frequency [Hz] may be an array over the samples: modal state, turned sample by sample."""
    rng = np.random.default_rng(seed)
    frequency = np.broadcast_to(frequency, n_samples)
    force, state, tip = rng.standard_normal(n_samples), 0j, np.empty((n_samples, 2))
    for k in range(n_samples):
        tip[k] = state.real, 0.4 * state.imag + 0.2 * state.real
        state = np.exp((-damping + 1j) * 2 * np.pi * frequency[k] * DT) * (state + force[k])
    return force, tip + noise * tip.std(axis=0) * rng.standard_normal(tip.shape)


def blocks_of(force, tip, n_rows=150, start=0.0):
    return [
        Record(force[k : k + n_rows], tip[k : k + n_rows], DT, start_time=start + k * DT)
        for k in range(0, len(force) - n_rows + 1, n_rows)
    ]


@pytest.mark.parametrize("n_rows", [150, 4])
def test_each_window_is_the_fit_of_its_own_rows(n_rows):
    force, tip = driven(4.0, noise=0.05)
    force, tip = force[: 1500 + 30 * n_rows], tip[: 1500 + 30 * n_rows]
    blocks = blocks_of(force, tip, n_rows)
    found = list(modal.follow(blocks, dt=DT, window=15.0, observer_order=10, order=2, ridge=0.0))
    assert len(found) == 31
    for estimate in found[::7]:
        middle = round(estimate.time / DT)
        rows = slice(max(0, middle - 750 - 10 * (middle > 750)), middle + 750)
        observer = fit_observer(Record(force[rows], tip[rows], DT), order=10)
        (alone,) = extract_modes(realise(recover_markov(observer), order=2)).modes
        assert estimate.modes.modes[0].frequency == pytest.approx(alone.frequency, rel=1e-5)
        assert estimate.modes.modes[0].damping_ratio == pytest.approx(alone.damping_ratio, rel=1e-3)


def test_a_drift_is_followed_at_the_middle_of_the_window():
    truth = 4.0 * (1.0 + 0.01 / 60.0 * DT * np.arange(4 * N))  # 1 % a minute
    force, tip = driven(truth, n_samples=4 * N, damping=0.005)
    for estimate in modal.follow(blocks_of(force, tip), dt=DT, window=10.0, observer_order=8, order=2):
        (mode,) = estimate.modes.modes
        assert mode.frequency == pytest.approx(truth[round(estimate.time / DT)], rel=5e-4)
        assert estimate.warnings == ()


def test_a_mode_that_moves_within_the_window_is_smeared():
    force, tip = driven(np.where(np.arange(N) < N // 2, 4.0, 4.6))
    found = list(modal.follow(blocks_of(force, tip), dt=DT, window=10.0, observer_order=8, order=2))
    said = [estimate for estimate in found if estimate.warnings]
    assert "is smeared" in said[0].warnings[0]
    assert all(abs(estimate.time - 30.0) < 16.0 for estimate in said)
    assert found[-1].warnings == ()


def test_rows_after_a_gap_do_not_look_across_it():
    force, tip = driven(4.0)
    blocks = blocks_of(force, tip)
    del blocks[20:23]
    for estimate in modal.follow(blocks, dt=DT, window=15.0, observer_order=6, order=2):
        assert estimate.modes.modes[0].frequency == pytest.approx(4.0002, rel=1e-3)
        assert estimate.modes.modes[0].damping_ratio == pytest.approx(0.01, rel=1e-3)


def test_a_clock_that_jumps_starts_a_new_window():
    force, tip = driven(4.0)
    blocks = blocks_of(force[:3000], tip[:3000]) + blocks_of(force[3000:], tip[3000:], start=0.0)
    times = [estimate.time for estimate in modal.follow(blocks, dt=DT, window=15.0, observer_order=6, order=2)]
    assert times == pytest.approx([*np.arange(7.5, 22.6, 1.5), *np.arange(7.5, 22.6, 1.5)])


def test_missing_samples_and_channels_at_rest_do_not_stop_it():
    force, tip = driven(4.0)
    tip[2000:2040, 1] = np.nan
    force[3000:] = 0.0
    found = list(modal.follow(blocks_of(force, tip), dt=DT, window=10.0, observer_order=6, order=2))
    dampings = [one.modes.modes[0].damping_ratio for one in found if one.time < 25.0]
    assert dampings == pytest.approx([0.01] * len(dampings), rel=1e-3)
    assert "does not" in found[-1].warnings[0]
    assert len(found[-1].modes) == 0


@pytest.mark.parametrize("spike", [1e9, 1e149])
def test_a_spike_leaves_nothing_behind_once_it_is_out_of_the_window(spike):
    force, tip = driven(4.0, noise=0.05)
    spiked = tip.copy()
    spiked[2000, 0] = spike
    options = {"dt": DT, "window": 10.0, "observer_order": 8, "order": 2}
    without, found = (list(modal.follow(blocks_of(force, some), **options)) for some in (tip, spiked))
    for one, other in zip(without, found, strict=True):
        if other.time > 20.0 + 10.0 / 2 + 1.5:
            for mode, like in zip(one.modes.modes, other.modes.modes, strict=True):
                assert like.frequency == pytest.approx(mode.frequency, rel=1e-6)
                assert like.damping_ratio == pytest.approx(mode.damping_ratio, rel=1e-4)


def test_values_without_a_square_are_refused_in_words():
    force, tip = driven(4.0)
    tip[2000, 0] = 1e308
    with pytest.raises(InvalidDataError, match=r"squares of all values .* those of the block at 19\.5 s do not"):
        list(modal.follow(blocks_of(force, tip), dt=DT, window=10.0, observer_order=8, order=2))


def test_a_window_without_a_complete_row_says_so():
    force, tip = driven(4.0)
    tip[3000::2, 0] = tip[3001::2, 1] = np.nan
    *_, last = modal.follow(blocks_of(force, tip), dt=DT, window=10.0, observer_order=8, order=2)
    assert (len(last.modes), last.n_rows) == (0, 0)
    assert "no row of the window" in last.warnings[0]


def test_a_window_too_short_for_the_observer_says_what_it_needs():
    force, tip = driven(4.0, n_samples=300)
    with pytest.raises(InvalidDataError, match=r"window of at least 0\.82 s"):
        next(modal.follow(blocks_of(force, tip), dt=DT, window=0.3, observer_order=20))
    with pytest.raises(InvalidDataError, match="time step"):
        next(modal.follow([Record(force, tip, 0.02)], dt=DT, window=2.0, observer_order=5))


@pytest.mark.parametrize("block", [3, None, (np.zeros(9),), (np.zeros(9), np.zeros(9), 0.1)])
def test_a_block_that_is_no_pair_is_a_sentence(block):
    with pytest.raises(InvalidDataError, match=r"a block must be a record or a pair \(inputs, outputs\); give one"):
        next(modal.follow([block], dt=DT, window=2.0, observer_order=5))
