import numpy as np
import pytest

from modal.preparation.channel import channels_of, named, when
from modal.wording.text import percent
from okid.record import Record
from okid.scaling import channel_scaling


def test_channels_come_inputs_first_with_their_samples_and_numbers():
    rng = np.random.default_rng(0)
    inputs, outputs = rng.standard_normal((50, 2)), rng.standard_normal((50, 11))
    outputs[7, 3] = np.nan
    records = [Record(inputs, outputs, 0.1, start_time=2.0), Record(inputs[:20], outputs[:20], 0.1)]
    channels = list(channels_of(records, channel_scaling(records)))
    assert [channel.name for channel in channels] == [*records[0].input_names, *records[0].output_names]
    for channel in channels:
        values = (inputs if channel.role == "input" else outputs)[:, channel.index]
        both = np.concatenate([values, values[:20]])
        assert np.array_equal(channel.parts[0], values, equal_nan=True)
        assert np.array_equal(channel.parts[1], values[:20], equal_nan=True)
        assert channel.mean == pytest.approx(np.nanmean(both))
        assert channel.std == pytest.approx(np.nanstd(both))
        assert (channel.smallest, channel.largest) == (np.nanmin(both), np.nanmax(both))
        assert channel.n_missing == np.isnan(both).sum()
    assert channels[0].span(0, 3, 5) == (0, pytest.approx(2.3), pytest.approx(2.5))


def test_words_for_names_shares_and_times():
    assert named(["a"]) == "'a'"
    assert named(["a", "b", "c", "d", "e"]) == "'a', 'b', 'c', 'd' and 1 more"
    assert len(named("x" * 500)) < 50
    assert (percent(0.5), percent(0.999), percent(1.0)) == ("50 %", "99.9 %", "100 %")
    assert when([(1, 0.0, 2.0)], 2) == "0 to 2 s of record 2"
    assert when([], 1) == "whole record"
