"""The kept result: read back as it was, counted once, and its summary where it would be very large."""

from dataclasses import replace

import numpy as np
import pytest

from modal.comparison.shifts import read_result
from modal.identification.result import load
from modal.report import writing as kept_result
from modal.report.writing import keep_result, kept_size
from okid.errors import UnreadableFileError


def test_it_is_the_result(tmp_path, identification):
    path = keep_result(identification, tmp_path / "result.npz")
    np.testing.assert_array_equal(load(path).records[0].outputs, identification.records[0].outputs)


def test_its_size_is_that_of_the_arrays_in_the_file(tmp_path, identification):
    path = keep_result(identification, tmp_path / "result.npz")
    with np.load(path, allow_pickle=False) as archive:
        assert kept_size(identification) == sum(archive[name].nbytes for name in archive.files if name != "result.json")


def test_an_array_that_is_shared_counts_once(identification):
    (record,) = identification.records
    apart = (replace(record, outputs=record.outputs + 0.0),)
    more = kept_size(replace(identification, predicted=apart)) - kept_size(identification)
    assert more >= record.outputs.nbytes
    assert kept_size(replace(identification, predicted=identification.records)) == kept_size(identification)


def test_of_one_that_is_too_large_the_summary_is_kept(tmp_path, identification, monkeypatch):
    monkeypatch.setattr(kept_result, "LARGEST_KEPT", kept_size(identification) - 1)
    path = keep_result(identification, tmp_path / "result.npz", files=["ab"])
    assert path.stat().st_size < 50_000
    summary = read_result(path)
    assert [mode.pole for mode in summary.modes] == [mode.pole for mode in identification.modes]
    assert summary.data == ("file ab",)
    with pytest.raises(UnreadableFileError, match="summary alone"):
        load(path)
