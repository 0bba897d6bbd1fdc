"""Folds of interleaved blocks, and set-ups of one system on the union of their channels."""

import numpy as np
import pytest

import okid
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


def test_too_short_is_refused():
    with pytest.raises(InsufficientDataError, match="need at least 40 samples in one record; there are 25"):
        interleaved_folds(records(25))


def record(inputs, outputs, *, dt=0.1, n=6, name="", units=None, hold="zero_order"):
    rng = np.random.default_rng(len(inputs) + 10 * len(outputs))
    return okid.Record(
        rng.standard_normal((n, len(inputs))),
        rng.standard_normal((n, len(outputs))),
        dt,
        input_names=inputs,
        output_names=outputs,
        output_units=units or [""] * len(outputs),
        input_hold=hold,
        name=name,
    )


def test_absent_inputs_rest_and_absent_outputs_are_missing():
    first, second = record(["h1"], ["ref", "a"], name="one"), record(["h2"], ["b", "ref"], name="two", n=8)
    joined = okid.join_setups([first, second])
    assert {one.input_names for one in joined} == {("h1", "h2")}
    assert {one.output_names for one in joined} == {("ref", "a", "b")}
    assert [one.name for one in joined] == ["one", "two"]
    np.testing.assert_array_equal(joined[0].inputs, np.column_stack([first.inputs[:, 0], np.zeros(6)]))
    np.testing.assert_array_equal(joined[1].inputs, np.column_stack([np.zeros(8), second.inputs[:, 0]]))
    np.testing.assert_array_equal(joined[0].outputs[:, :2], first.outputs)
    np.testing.assert_array_equal(joined[1].outputs[:, [2, 0]], second.outputs)
    assert np.isnan(joined[0].outputs[:, 2]).all()
    assert np.isnan(joined[1].outputs[:, 1]).all()


def test_alike_records_stay_as_they_are():
    first, second = record(["u"], ["a", "b"]), record(["u"], ["a", "b"])
    assert okid.join_setups([first, second]) == (first, second)


@pytest.mark.parametrize(
    ("others", "words"),
    [
        ([record(["u"], ["a"], units=["m"])], "'a' is in no unit in one set-up and in m"),
        ([record(["u"], ["a"], dt=0.2)], "same time step"),
        ([record(["a"], ["b"])], "'a' is an input in one set-up and an output in another"),
        ([record(["v"], ["b"], name="alone")], "alone shares no channel"),
        ([record(["u"], ["a"], hold="linear")], "one input_hold"),
        (["text"], "a sequence of okid.Record"),
    ],
)
def test_what_cannot_be_one_system_is_refused(others, words):
    with pytest.raises(InvalidDataError, match=words):
        okid.join_setups([record(["u"], ["a"]), *others])


def test_files_with_different_channels_are_set_ups(tmp_path):
    for name, header in (("one", "time,force,ref,a"), ("two", "time,force,b,ref")):
        values = np.column_stack([0.1 * np.arange(6), np.random.default_rng(1).standard_normal((6, 3))])
        np.savetxt(tmp_path / f"{name}.csv", values, delimiter=",", header=header, comments="")
    one, two = okid.read_records([tmp_path / "one.csv", tmp_path / "two.csv"], inputs="force")
    assert one.output_names == two.output_names == ("ref", "a", "b")
    assert np.isnan(one.outputs[:, 2]).all()
    assert one.outputs[:, 0].tolist() == two.outputs[:, 2].tolist()
    with pytest.raises(InvalidDataError, match="frce"):
        okid.read_records([tmp_path / "one.csv", tmp_path / "two.csv"], inputs="frce")
