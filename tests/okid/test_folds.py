"""Folds of interleaved blocks."""

import numpy as np
import pytest

from okid.errors import InsufficientDataError, InvalidDataError
from okid.record import Record
from okid.rows import interleaved_folds


def records(*lengths):
    return [Record([], np.arange(float(n)), 0.1) for n in lengths]


@pytest.mark.parametrize("lengths", [(1000,), (500, 733, 61), (25, 25, 25, 25, 25)])
def test_every_row_is_held_out_at_most_once_and_the_start_never(lengths):
    data = records(*lengths)
    folds = interleaved_folds(data)
    for number, length in enumerate(lengths):
        times = sum(fold[number].astype(int) for fold in folds)
        assert times.max() <= 1
        assert times[: min(10, length // 3)].max() == 0
        assert all(fold[number].shape == (length,) for fold in folds)


def test_ten_blocks_one_trains_three_go_to_each_of_three_folds():
    folds = interleaved_folds(records(1000))
    held = [np.unique(np.flatnonzero(fold[0]) // 100).tolist() for fold in folds]
    assert held == [[1, 4, 7], [2, 5, 8], [3, 6, 9]]


def test_folds_stay_equally_large_over_many_short_records():
    folds = interleaved_folds(records(*[25] * 12))  # two blocks a record: one trains, one is held out
    sizes = [sum(int(mask.sum()) for mask in fold) for fold in folds]
    assert max(sizes) - min(sizes) <= 4


def test_records_shorter_than_two_blocks_go_to_a_fold_as_a_whole():
    folds = interleaved_folds(records(*[15] * 7))
    whole = [[bool(mask.all()) for mask in fold] for fold in folds]
    assert np.sum(whole, axis=0).tolist() == [0, 1, 1, 1, 1, 1, 1]
    assert np.sum(whole, axis=1).tolist() == [2, 2, 2]


def test_too_short_and_wrong_use_are_refused():
    with pytest.raises(InsufficientDataError, match="need at least 40 samples in one record; there are 25"):
        interleaved_folds(records(25))
    with pytest.raises(InvalidDataError, match="n_blocks > n_folds"):
        interleaved_folds(records(100), n_folds=5, n_blocks=5)
