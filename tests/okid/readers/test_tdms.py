"""TDMS written by npTDMS."""

import numpy as np
import pytest

from okid.errors import UnreadableFileError
from okid.readers import read_record

nptdms = pytest.importorskip("nptdms")
VALUES = np.random.default_rng(6).standard_normal((40, 2))


def write(path, channels):
    with nptdms.TdmsWriter(str(path)) as writer:
        writer.write_segment(
            [nptdms.ChannelObject(group, name, values, properties=given) for group, name, values, given in channels]
        )
    return path


def test_channels_units_and_step(tmp_path):
    channels = [
        ("run", "shaker", VALUES[:, 0], {"wf_increment": 0.01, "unit_string": "kN"}),
        ("run", "tip", VALUES[:, 1], {"wf_increment": 0.01, "unit_string": "g"}),
    ]
    record = read_record(write(tmp_path / "a.tdms", channels), inputs="shaker")
    assert (record.dt, record.input_units, record.output_names) == (0.01, ("N",), ("tip",))
    np.testing.assert_allclose(record.outputs[:, 0], 9.80665 * VALUES[:, 1])


def test_one_name_in_two_groups(tmp_path):
    channels = [("a", "tip", VALUES[:, 0], {}), ("b", "tip", VALUES[:, 1], {})]
    assert read_record(write(tmp_path / "a.tdms", channels), dt=1.0).output_names == ("a/tip", "b/tip")


def test_channels_of_different_rates(tmp_path):
    channels = [("a", "x", VALUES[:, 0], {"wf_increment": 0.1}), ("a", "y", VALUES[:, 1], {"wf_increment": 0.2})]
    with pytest.raises(UnreadableFileError, match=r"different time axes .*40 samples at 0\.1 s"):
        read_record(write(tmp_path / "a.tdms", channels))


def test_damage(tmp_path):
    (tmp_path / "a.tdms").write_bytes(b"hello" * 10)
    with pytest.raises(UnreadableFileError, match="damaged, cut off or no TDMS"):
        read_record(tmp_path / "a.tdms")
