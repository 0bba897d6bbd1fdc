import numpy as np
import pytest

from modal.preparation.channel import gap_findings, length_findings, missing_findings, sharp_samples, spike_findings
from modal.quality import check_quality
from modal.quality.channels import is_steady, level_findings, offset_findings
from okid.record import Record


def record_of(n_samples, n_inputs=1, n_outputs=2):
    rng = np.random.default_rng(n_samples)
    return Record(rng.standard_normal((n_samples, n_inputs)), rng.standard_normal((n_samples, n_outputs)), 0.1)


@pytest.mark.parametrize(("n_samples", "level"), [(8, "bad"), (9, "doubtful"), (71, "doubtful"), (72, None)])
def test_an_observer_of_one_mode_needs_rows(n_samples, level):
    """Three channels, two of the past, and one input: 7 coefficients, so 7 rows to solve and 70 to trust."""
    found = length_findings([record_of(n_samples)], has_coherence=True)
    assert [finding.level for finding in found] == ([] if level is None else [level])
    assert all("record 72 samples or more" in finding.sentence for finding in found)


def test_each_record_loses_its_first_rows():
    assert length_findings([record_of(36), record_of(37)], has_coherence=True) != []
    assert length_findings([record_of(37), record_of(37)], has_coherence=True) == []


@pytest.mark.parametrize(("n_samples", "is_said"), [(60, True), (2000, False)])
def test_what_was_not_looked_at_is_said(n_samples, is_said):
    quality = check_quality(record_of(n_samples))
    assert ("no coherence" in {finding.what for finding in quality.findings}) is is_said


@pytest.mark.parametrize(
    ("absent", "why"),
    [
        ([(), ()], "the records are too short"),
        ([(), (1,)], "1 set-up of 2 measured every output, too briefly"),
        ([(0,), (1,)], "no set-up measured every output"),
    ],
)
def test_why_there_is_no_coherence_is_true(absent, why):
    whole = record_of(60)
    records = []
    for outputs in absent:
        values = whole.outputs.copy()
        values[:, list(outputs)] = np.nan
        records.append(Record(whole.inputs, values, 0.1))
    (finding,) = (f for f in length_findings(records, has_coherence=False) if f.what == "no coherence")
    assert finding.sentence.startswith(why)


def test_three_samples_are_not_called_good():
    assert check_quality(record_of(3)).level == "bad"
    assert check_quality(Record([], [0.0, 1.0, 0.5], 0.1)).level == "bad"


def test_a_change_of_level_counts_only_while_the_inputs_are_steady(channel_of):
    values = np.random.default_rng(0).standard_normal(5000)
    values[3000:] *= 6.0
    channel = channel_of(values)
    (finding,) = level_findings(channel, [True])
    assert finding.level == "doubtful"
    assert level_findings(channel, [True, False]) == []
    assert level_findings(channel, []) == []


@pytest.mark.parametrize("factor", [1.0, 3.0])
def test_a_level_that_changes_little_is_left_alone(channel_of, factor):
    values = np.random.default_rng(0).standard_normal(5000)
    values[3000:] *= factor
    assert level_findings(channel_of(values), [True]) == []


def test_white_noise_is_steady_but_no_sweep_staircase_or_burst(channel_of):
    k = np.arange(5000)
    assert is_steady(channel_of(np.random.default_rng(0).standard_normal(5000), role="input"))
    assert is_steady(channel_of(np.sin(0.3 * k), role="input"))
    for values in (np.sin(2e-5 * k**2), np.repeat(np.arange(50.0), 100), np.sin(0.3 * k) * (k < 3000)):
        assert not is_steady(channel_of(values, role="input"))


@pytest.mark.parametrize(("mean", "n_found"), [(-20.0, 1), (5.0, 0)])
def test_an_offset_is_noted_from_ten_times_the_motion(channel_of, mean, n_found):
    values = mean + np.random.default_rng(0).standard_normal(500)
    found = offset_findings(channel_of(values))
    assert [finding.level for finding in found] == ["note"] * n_found


@pytest.mark.parametrize(
    ("share", "level", "role"),
    [
        (0.0, None, "output"),
        (0.01, "note", "output"),
        (0.2, "doubtful", "input"),
        (0.7, "bad", "input"),
        (0.7, "doubtful", "output"),
    ],
)
def test_missing_samples_are_counted(channel_of, share, level, role):
    """Outputs count where they were measured; their page said "mend or replace the data, all modes are provisional"."""
    values = np.random.default_rng(0).standard_normal(2000)
    values[: round(share * 2000)] = np.nan
    found = missing_findings(channel_of(values, role=role))
    assert [finding.level for finding in found] == ([] if level is None else [level])
    for finding in found:
        assert ("counts where it was measured" in finding.sentence) == (role == "output")
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
    assert level_findings(channel_of(steady + ringing), [True]) == []
    assert len(level_findings(channel_of(np.where(k < 2500, 8.0, 1.0) * steady), [True])) == 1


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
    assert level_findings(channel_of(values), [True]) == []
    values[3000:] *= 8.0
    assert len(level_findings(channel_of(values), [True])) == (1 if missing.start == 2000 else 0)


def spikes(channel, hits=None):
    none = [np.zeros(channel.n_samples, dtype=bool)]
    return spike_findings(channel, np.nan, none if hits is None else hits)


def motion(n=4000, width=20):
    values = np.convolve(np.random.default_rng(0).standard_normal(n), np.hanning(width), "same")
    return values / values.std() + 1e-3 * np.random.default_rng(1).standard_normal(n)


def test_each_spike_is_found_where_it_is(channel_of):
    values = motion()
    places = [300, 1111, 2500, 2600]
    values[places] += [4.0, -0.5, 1.0, -3.0]
    (finding,) = spikes(channel_of(values))
    assert [round(start / 0.01) for _, start, _ in finding.spans] == places
    assert finding.level == "bad"  # one in a thousand
    assert spikes(channel_of(motion())) == []


@pytest.mark.parametrize(("size", "level"), [(4.0, "doubtful"), (0.7, "note")])
def test_one_spike_is_doubtful_and_one_smaller_than_the_motion_only_noted(channel_of, size, level):
    values = motion()
    values[300] += size
    (finding,) = spikes(channel_of(values))
    assert finding.level == level
    assert "one sample" in finding.sentence


@pytest.mark.parametrize("lost", [[299], [301], [298, 302], [301, 302, 303]])
def test_a_spike_beside_missing_samples_is_found(channel_of, lost):
    """The curve through its neighbours is not known there: it is off by more than the channel moves."""
    values = motion()
    values[300] += 12.0
    values[lost] = np.nan
    (finding,) = spikes(channel_of(values))
    assert [round(start / 0.01) for _, start, _ in finding.spans] == [300]


@pytest.mark.parametrize("kind", ["smooth", "white", "ringing", "held steps"])
def test_nothing_beside_missing_samples_is_taken_for_a_spike(channel_of, kind):
    rng, time = np.random.default_rng(5), np.arange(20_000)
    values = {
        "smooth": np.sin(0.3 * time) + 1e-3 * rng.standard_normal(time.size),
        "white": rng.standard_normal(time.size),
        "ringing": np.exp(-0.002 * (time % 4000)) * np.sin(0.7 * (time % 4000)),
        "held steps": np.repeat(rng.standard_normal(4000), 5),
    }[kind]
    values[rng.random(time.size) < 0.05] = np.nan
    assert spikes(channel_of(values)) == []


@pytest.mark.parametrize(
    "values",
    [
        np.repeat(np.random.default_rng(3).standard_normal(600), 7),
        np.where(np.arange(4000) > 2000, 1.0, 0.0),
        np.where(np.arange(4000) > 2000, np.exp(-0.01 * (np.arange(4000) - 2000)) * np.sin(0.4 * np.arange(4000)), 0.0),
        np.random.default_rng(0).standard_normal(250_000),
    ],
    ids=["held steps", "one step", "ringing from rest", "white"],
)
def test_steps_ringing_and_white_noise_are_no_spikes(channel_of, values):
    assert spikes(channel_of(values)) == []


def test_an_output_may_answer_a_hit_at_once(channel_of):
    values = motion()
    values[900] += 5.0
    hits = np.zeros(4000, dtype=bool)
    hits[901] = True
    assert spikes(channel_of(values), [hits]) == []
    hits[901], hits[910] = False, True
    assert len(spikes(channel_of(values), [hits])) == 1


def test_a_pulse_of_an_input_out_of_rest_is_a_hit_but_out_of_motion_a_spike(channel_of):
    hammer = 1e-4 * np.random.default_rng(5).standard_normal(4000)
    hammer[[500, 540, 2000]] = 1.0
    assert spikes(channel_of(hammer, role="input")) == []
    shaker = motion()
    shaker[500] += 5.0
    assert len(spikes(channel_of(shaker, role="input"))) == 1


def test_sharp_samples_are_the_hits(channel_of):
    hammer = 1e-4 * np.random.default_rng(5).standard_normal(4000)
    hammer[[500, 2000]] = 1.0
    (mask,) = sharp_samples(channel_of(hammer, role="input"))
    assert mask[500]
    assert mask[2000]
    assert mask.sum() <= 10


def test_hits_that_crowd_a_block_are_all_sharp(channel_of):
    hammer = 1e-4 * np.random.default_rng(5).standard_normal(4000)
    places = [1101, 1117, 1122, 1138]
    hammer[places] = 1.0
    (mask,) = sharp_samples(channel_of(hammer, role="input"))
    assert mask[places].all()


def test_gaps_do_not_make_what_is_usual_small(channel_of):
    values = np.random.default_rng(8).standard_normal(4000)
    values[::7] = np.nan
    assert spikes(channel_of(values)) == []
    smooth = motion()
    smooth[::7] = np.nan
    smooth[704] += 4.0  # its two neighbours on either side are there
    (finding,) = spikes(channel_of(smooth))
    assert [round(start / 0.01) for _, start, _ in finding.spans] == [704]


def test_a_burst_of_a_few_samples_stays_rough_and_is_no_spike(channel_of):
    values = motion()
    values[300:305] += [1.5, -3.0, 4.0, -3.0, 1.5]
    assert spikes(channel_of(values)) == []
    values[1300] += 4.0
    assert len(spikes(channel_of(values))[0].spans) == 1


def test_a_jump_that_falls_back_over_some_samples_is_no_spike(channel_of):
    values = motion()
    after = np.maximum(np.arange(4000) - 2000, 0)
    values += 3.0 * np.exp(-after) * (np.arange(4000) >= 2000)
    assert spikes(channel_of(values)) == []
