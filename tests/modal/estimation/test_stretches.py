"""Long records: what is held out and what is run freely to score a candidate."""

import numpy as np
import pytest
from signals import random_inputs, with_noise
from systems import random_system, simulate

from modal.estimation.cross_validation import (
    BLOCKS,
    LONGEST_SCORED,
    STRETCH,
    folds_of,
    is_long,
    n_blocks_of,
    stretches_of,
)
from modal.identification.pipeline import identify
from okid.record import Record
from okid.rows import interleaved_folds, whole_record_folds


def record_of(n_samples):
    return Record([], np.arange(float(n_samples)), 0.01)


def test_short_records_are_scored_whole():
    records = [record_of(400), record_of(LONGEST_SCORED - 400)]
    assert not is_long(records)
    assert [(one.record, one.first, one.last, one.n_lead) for one in stretches_of(records)] == [
        (0, 0, 400, 0),
        (1, 0, LONGEST_SCORED - 400, 0),
    ]
    for mine, theirs in zip(folds_of(records), interleaved_folds(records), strict=True):
        assert all(np.array_equal(a, b) for a, b in zip(mine, theirs, strict=True))


@pytest.mark.parametrize(
    ("driven", "expected"),
    [
        ([(1, 1), (1, 1), (1, 1), (1, 1)], whole_record_folds),
        ([(1, 0), (0, 1), (1, 0), (1, 0)], interleaved_folds),  # no other record shows what the second input does
        ([(1, 0), (0, 1), (1, 0), (1, 0), (1, 0), (0, 1)], whole_record_folds),
    ],
)
def test_whole_records_are_held_out_only_where_others_show_every_input(driven, expected):
    rng = np.random.default_rng(0)
    records = [Record(rng.standard_normal((100, 2)) * on, rng.standard_normal((100, 1)), 0.01) for on in driven]
    for mine, theirs in zip(folds_of(records), expected(records), strict=True):
        assert all(np.array_equal(a, b) for a, b in zip(mine, theirs, strict=True))


def sweep(n_samples, duration, low, high):
    time = np.linspace(0.0, duration, n_samples, endpoint=False)
    return np.sin(2 * np.pi * (low * time + (high - low) * time**2 / (2 * duration)))


@pytest.mark.parametrize(("n_samples", "duration"), [(20_000, 40.0), (5_000, 10.0), (60_000, 120.0)])
def test_blocks_of_a_sweep_are_so_short_that_every_fold_trains_every_frequency(n_samples, duration):
    force = sweep(n_samples, duration, 3.0, 200.0)
    record = Record(force, force, duration / n_samples)
    n_blocks = n_blocks_of([record])
    assert 0.4 <= n_blocks / np.sqrt(197.0 * duration) <= 2.0
    every = np.square(np.abs(np.fft.rfft(force)))
    frequencies = np.fft.rfftfreq(n_samples, record.dt)
    for fold in folds_of([record]):
        left = np.square(np.abs(np.fft.rfft(np.where(fold[0], 0.0, force))))
        for low in np.arange(10.0, 190.0, 10.0):
            band = (frequencies >= low) & (frequencies < low + 10.0)
            assert left[band].sum() > 0.1 * every[band].sum()


def test_whole_records_that_each_sweep_their_own_band_do_not_stand_for_each_other():
    bands = [(2.0 + 10.0 * k, 12.0 + 10.0 * k) for k in range(4)]
    forces = [sweep(4000, 40.0, *band) for band in bands]
    assert n_blocks_of([Record(force, force, 0.01) for force in forces]) >= BLOCKS
    assert n_blocks_of([Record(forces[0], forces[0], 0.01)] * 4) == 0


def test_a_quake_is_held_out_in_long_blocks():
    """What is left moves at all its frequencies, if thirty times less; short blocks would leave short observers."""
    force = np.random.default_rng(0).standard_normal(4000) * np.where(np.arange(4000) // 400 == 3, 1.0, 0.03)
    assert n_blocks_of([Record(force, force, 0.01)]) == BLOCKS


@pytest.mark.parametrize("lengths", [(200_000,), (35_000,), (4_000,) * 12, (500, 120_000)])
def test_long_records_are_scored_on_a_bounded_number_of_rows_in_every_fold(lengths):
    records = [record_of(n) for n in lengths]
    stretches, folds = stretches_of(records), folds_of(records)
    n_scored = sum(one.last - one.first for one in stretches)
    assert 0.5 * LONGEST_SCORED <= n_scored <= 1.2 * LONGEST_SCORED
    assert all(one.last - one.first <= STRETCH for one in stretches)
    for fold in folds:
        counted = [int(one.held_out(fold).sum()) for one in stretches]
        assert sum(counted) >= 0.15 * n_scored
    # no row is in two folds, whatever is scored; a record too short for a block trains
    for i, length in enumerate(lengths):
        assert np.sum([fold[i] for fold in folds], axis=0).max() == (length > STRETCH // BLOCKS)


def test_the_first_block_of_a_stretch_never_counts():
    records = [record_of(200_000)]
    for fold in folds_of(records):
        for one in stretches_of(records):
            assert not one.held_out(fold)[: (one.last - one.first) // BLOCKS].any()


def test_a_long_record_gives_the_modes_and_says_what_was_scored():
    rng = np.random.default_rng(77)
    truth = random_system(rng, n_modes=2, n_inputs=1, n_outputs=1, weak_mode=None)
    inputs = random_inputs(rng, 40_000, 1)
    result = identify(
        Record(inputs, with_noise(rng, simulate(truth, inputs), 0.05), truth.dt), observer_order=60, ridge=0.0, order=4
    )
    np.testing.assert_allclose([mode.frequency for mode in result.modes.system], truth.frequencies, rtol=1e-3)
    assert [choice.value for choice in result.choices if choice.what == "scored rows"] == ["3 stretches, 30000 samples"]
    assert result.fit.mean == pytest.approx(0.95, abs=0.005)
