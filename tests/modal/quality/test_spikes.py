import numpy as np
import pytest

from modal.preparation.samples import sharp_samples, spike_findings


def spikes(channel, hits=None):
    none = [np.zeros(channel.n_samples, dtype=bool)]
    return spike_findings(channel, np.nan, none if hits is None else hits, 1)


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


def test_one_spike_is_doubtful(channel_of):
    values = motion()
    values[300] += 4.0
    (finding,) = spikes(channel_of(values))
    assert finding.level == "doubtful"
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


def test_white_noise_has_no_spikes(channel_of):
    for seed in range(5):
        assert spikes(channel_of(np.random.default_rng(seed).standard_normal(50_000))) == []


@pytest.mark.parametrize(
    "values",
    [
        np.repeat(np.random.default_rng(3).standard_normal(600), 7),
        np.where(np.arange(4000) > 2000, 1.0, 0.0),
        np.where(np.arange(4000) > 2000, np.exp(-0.01 * (np.arange(4000) - 2000)) * np.sin(0.4 * np.arange(4000)), 0.0),
    ],
    ids=["held steps", "one step", "ringing from rest"],
)
def test_steps_and_ringing_are_no_spikes(channel_of, values):
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


def test_a_spike_smaller_than_the_motion_is_only_noted(channel_of):
    values = motion()
    values[300] += 0.7
    (finding,) = spikes(channel_of(values))
    assert finding.level == "note"


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
