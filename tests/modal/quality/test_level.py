import numpy as np
import pytest

from modal.preparation.samples import gap_findings, missing_findings
from modal.quality.channels import is_steady, level_findings, offset_findings
from okid.record import Record


def test_a_change_of_level_counts_only_while_the_inputs_are_steady(channel_of):
    values = np.random.default_rng(0).standard_normal(5000)
    values[3000:] *= 6.0
    channel = channel_of(values)
    (finding,) = level_findings(channel, [True], 1)
    assert finding.level == "doubtful"
    assert level_findings(channel, [True, False], 1) == []
    assert level_findings(channel, [], 1) == []


@pytest.mark.parametrize("factor", [1.0, 3.0])
def test_a_level_that_changes_little_is_left_alone(channel_of, factor):
    values = np.random.default_rng(0).standard_normal(5000)
    values[3000:] *= factor
    assert level_findings(channel_of(values), [True], 1) == []


def test_white_noise_is_steady_but_no_sweep_staircase_or_burst(channel_of):
    k = np.arange(5000)
    assert is_steady(channel_of(np.random.default_rng(0).standard_normal(5000), role="input"))
    assert is_steady(channel_of(np.sin(0.3 * k), role="input"))
    for values in (np.sin(2e-5 * k**2), np.repeat(np.arange(50.0), 100), np.sin(0.3 * k) * (k < 3000)):
        assert not is_steady(channel_of(values, role="input"))


@pytest.mark.parametrize(("mean", "n_found"), [(-20.0, 1), (5.0, 0)])
def test_an_offset_is_noted_from_ten_times_the_motion(channel_of, mean, n_found):
    values = mean + np.random.default_rng(0).standard_normal(500)
    found = offset_findings(channel_of(values), 1)
    assert [finding.level for finding in found] == ["note"] * n_found


@pytest.mark.parametrize(("share", "level"), [(0.0, None), (0.01, "note"), (0.2, "doubtful"), (0.7, "bad")])
def test_missing_samples_are_counted(channel_of, share, level):
    values = np.random.default_rng(0).standard_normal(2000)
    values[: round(share * 2000)] = np.nan
    found = missing_findings(channel_of(values), 1)
    assert [finding.level for finding in found] == ([] if level is None else [level])
    for finding in found:
        assert finding.share == pytest.approx(share)
        assert finding.spans == ((0, 0.0, pytest.approx(share * 20.0)),)


@pytest.mark.parametrize(("every", "level"), [(200, None), (60, "doubtful"), (20, "bad")])
def test_gaps_that_leave_no_whole_past_are_told(every, level):
    """Of each 200 rows 51 lie within 50 samples after a gap; of each 60 rows 10 do not; of each 20 none."""
    values = np.random.default_rng(0).standard_normal((4000, 2))
    values[::every, 1] = np.nan
    found = gap_findings([Record(np.empty((4000, 0)), values, 0.01)])
    assert [finding.level for finding in found] == ([] if level is None else [level])


def test_a_start_that_dies_out_is_no_change_of_level(channel_of):
    k = np.arange(5000)
    steady = np.random.default_rng(0).standard_normal(5000)
    ringing = 60.0 * np.exp(-k / 700.0) * np.sin(0.7 * k)
    assert level_findings(channel_of(steady + ringing), [True], 1) == []
    assert len(level_findings(channel_of(np.where(k < 2500, 8.0, 1.0) * steady), [True], 1)) == 1


def test_a_block_without_a_sample_says_nothing_of_steadiness(channel_of):
    values = np.random.default_rng(0).standard_normal(5000)
    values[500:1600] = np.nan  # the whole second block
    assert is_steady(channel_of(values, role="input"))
    values[3000:] += 30.0
    assert not is_steady(channel_of(values, role="input"))


@pytest.mark.parametrize("missing", [slice(3500, 5000), slice(2000, 3000)])
def test_a_channel_that_is_missing_for_blocks_changed_no_level(channel_of, missing):
    values = np.random.default_rng(0).standard_normal(5000)
    values[missing] = np.nan
    assert level_findings(channel_of(values), [True], 1) == []
    values[3000:] *= 8.0
    assert len(level_findings(channel_of(values), [True], 1)) == (1 if missing.start == 2000 else 0)
