import numpy as np
import pytest
import scipy

from modal.identification.pipeline import identify
from modal.preparation.amplitude import (
    clipping_findings,
    constant_findings,
    distortion_power,
    repeat_findings,
    resolution_findings,
    resolution_of,
    stuck_findings,
)
from okid.record import Record


def noise(n=4000, width=30, seed=0):
    values = np.random.default_rng(seed).standard_normal(n)
    return values if width == 0 else np.convolve(values, np.hanning(width), "same")


@pytest.mark.parametrize("width", [0, 30])
@pytest.mark.parametrize("share", [0.01, 0.1])
def test_clipping_is_found_with_its_share(channel_of, width, share):
    values = noise(width=width)
    low, high = np.quantile(values, [share / 2, 1 - share / 2])
    clipped = np.clip(values, low, high)
    (finding,) = clipping_findings(channel_of(clipped))
    assert finding.level == "bad"
    assert finding.share == pytest.approx(share, rel=0.1)
    first = np.flatnonzero((clipped == low) | (clipped == high))[0]
    assert finding.spans[0][1] == pytest.approx(first * 0.01)


def test_one_side_alone_is_found(channel_of):
    values = np.minimum(noise(), 1.5 * noise().std())
    (finding,) = clipping_findings(channel_of(values))
    assert "-" not in finding.sentence.split(" of the samples")[0].split("limit")[1]


@pytest.mark.parametrize("width", [0, 30])
@pytest.mark.parametrize("bits", [8, 12, 16])
def test_converted_noise_is_not_clipped(channel_of, width, bits):
    values = noise(width=width)
    step = 2.6 * np.abs(values).max() / 2**bits
    assert clipping_findings(channel_of(step * np.round(values / step))) == []


@pytest.mark.parametrize("bits", [7, 10, 14])
def test_the_crests_of_a_converted_sine_are_not_clipped_but_those_of_a_clipped_one_are(channel_of, bits):
    sine = np.sin(np.linspace(0, 300, 20_000))
    step = 2.2 / 2**bits
    assert clipping_findings(channel_of(step * np.round(sine / step))) == []
    cut = np.clip(sine, -0.9, 0.9)
    assert [f.what for f in clipping_findings(channel_of(step * np.round(cut / step)))] == ["clipped"]


@pytest.mark.parametrize(
    "values",
    [
        np.sign(np.sin(np.linspace(0.1, 300, 5000))),
        np.random.default_rng(0).uniform(-1, 1, 5000),
        np.repeat(np.random.default_rng(1).choice([-1.0, 0.0, 1.0], 700), 7),
        np.tile(np.random.default_rng(2).standard_normal(500), 10),
        np.sin(2 * np.pi * np.arange(5000) / 10),
        1.0 - np.exp(-np.arange(20_000) / 200.0),
        np.round(1000 * (1.0 - np.exp(-np.arange(2500) / 200.0))),
        np.clip(np.round(9 * np.sin(np.linspace(0, 900, 5000))), -9, 7),
    ],
    ids=["square", "uniform", "three levels", "periodic", "ten samples a period", "settling", "settled", "few levels"],
)
@pytest.mark.parametrize("role", ["input", "output"])
def test_signals_that_are_bounded_by_nature_are_not_clipped(channel_of, values, role):
    assert clipping_findings(channel_of(values, role=role)) == []


def test_the_rest_of_a_hammer_is_no_lower_limit(channel_of):
    force = np.zeros(5000)
    for start in range(100, 5000, 600):
        force[start : start + 9] = np.hanning(11)[1:-1] * (1 + start / 5000)
    assert clipping_findings(channel_of(force, role="input")) == []


def test_a_clipped_input_is_only_noted(channel_of):
    (finding,) = clipping_findings(channel_of(np.clip(noise(width=0), -2, 2), role="input"))
    assert finding.level == "note"


@pytest.mark.parametrize(("jitter", "n_found"), [(1e-11, 1), (1e-4, 0)])
def test_a_limit_is_one_value_however_it_was_rounded(channel_of, jitter, n_found):
    """A unit that was converted in between leaves the last digits different; a limit that moves is none."""
    rng = np.random.default_rng(2)
    values = noise()
    limit = 1.5 * values.std()
    clipped = np.where(values >= limit, limit * (1.0 + jitter * rng.random(values.size)), values)
    assert len(clipping_findings(channel_of(clipped))) == n_found


def compare_by_hand(motion, seen, frequencies):
    """What is left of the distorted motion beside the motion itself, both of them known."""
    made = seen - (seen @ motion) / (motion @ motion) * motion
    lines, whole = scipy.signal.welch(seen, 100.0, nperseg=2048)
    _, by_hand = scipy.signal.welch(made, 100.0, nperseg=2048)
    shares = distortion_power([Record([], seen, 0.01)], frequencies, [0.3] * len(frequencies)).ravel()
    for f, share in zip(frequencies, shares, strict=True):
        band = np.abs(lines - f) <= 0.3
        assert share == pytest.approx(by_hand[band].sum() / whole[band].sum(), rel=0.2, abs=0.01)


@pytest.mark.parametrize("limits", [(-1.5, 1.5), (-np.inf, 1.0), (-2.0, 1.2)])
def test_the_spectrum_of_what_limits_make_is_that_of_what_they_change(limits):
    rng = np.random.default_rng(6)
    force = rng.standard_normal(400_000)
    motion = sum(
        values / values.std()
        for f, z in ((7.0, 0.01), (11.0, 0.02))
        for values in [resonance(force * (1.0 if f < 9.0 else 0.7), f, z)]
    )
    motion /= motion.std()
    clipped = np.clip(motion, *limits)
    clipped -= clipped.mean()
    compare_by_hand(motion, clipped, [3.0, 4.0, 7.0, 14.0, 15.0, 18.0, 21.0, 25.0, 29.0, 33.0])


@pytest.mark.parametrize("step", [0.8, 1.5, 2.5])
def test_the_spectrum_of_what_coarse_levels_make_is_that_of_what_they_change(step):
    """Every odd harmonic and their sums, folded down, and not only the first few."""
    rng = np.random.default_rng(7)
    motion = resonance(rng.standard_normal(400_000), 36.4, 0.002)
    motion /= motion.std()
    motion += 0.1 * rng.standard_normal(motion.size)
    coarse = step * np.round(motion / step)
    # 36.4 and its odd harmonics, folded about 50 and 100 Hz
    compare_by_hand(motion, coarse, [3.0, 9.2, 18.0, 27.6, 36.4, 45.2])


def resonance(force, frequency, damping):
    pole = np.exp(2 * np.pi * frequency * 0.01 * complex(-damping, np.sqrt(1 - damping**2)))
    return scipy.signal.lfilter([0.0, 1.0], [1.0, -2 * pole.real, abs(pole) ** 2], force)


def test_what_is_not_clipped_makes_nothing():
    values = np.column_stack([noise(), np.clip(noise(seed=1), -1.0, 1.0)])
    shares = distortion_power([Record([], values, 0.01)], [3.0, 30.0], [0.5, 0.5])
    assert (shares[:, 0] == 0.0).all()
    assert (shares[:, 1] > 0.0).all()


def test_sums_and_differences_that_clipping_makes_are_no_modes():
    rng = np.random.default_rng([5, 1])
    frequencies, dampings = np.sort(rng.uniform(3.0, 40.0, 4)), rng.uniform(0.003, 0.02, 4)
    forces, weights, shapes = rng.standard_normal((9000, 3)), rng.standard_normal((4, 3)), rng.standard_normal((4, 4))
    each = [resonance(forces @ w, f, z) for w, f, z in zip(weights, frequencies, dampings, strict=True)]
    outputs = np.column_stack([values / values.std() for values in each]) @ shapes
    outputs += 0.01 * outputs.std(axis=0) * rng.standard_normal(outputs.shape)
    limits = 2.5 * outputs.std(axis=0)
    result = identify(Record([], np.clip(outputs, -limits, limits), 0.01), observer_order=30, ridge=1e-3, order=20)
    found = [mode.frequency for mode in result.modes.system]
    assert len(found) == 4
    assert all(np.abs(frequencies - one).min() < 0.01 * one for one in found)
    assert any("clipping or rounding alone makes" in mode.reason for mode in result.modes)


def struck(crest, *, noise=1e-3, seed=0, angle=0.25):
    """What a blow makes ring, noisy, cut off at so much of its peak."""
    k = np.arange(3000)
    rng = np.random.default_rng(seed)
    ringing = np.exp(-0.12 * angle * k) * np.sin(angle * k) + noise * rng.standard_normal(k.size)
    return np.minimum(np.r_[np.zeros(100), ringing], crest * ringing.max())


@pytest.mark.parametrize("crest", [0.95, 0.8, 0.7])
def test_a_crest_that_is_cut_off_once_is_clipped(channel_of, crest):
    (finding,) = clipping_findings(channel_of(struck(crest)))
    assert finding.spans[0][1] == pytest.approx(1.05, abs=0.05)


@pytest.mark.parametrize(("step", "noise", "seed"), [(1e-3, 0.0, 6), (3e-4, 1e-4, 2)])
def test_a_whole_crest_on_a_grid_is_not_clipped(channel_of, step, noise, seed):
    """Its outermost level occurs three or four times here, and the next fifteen once."""
    values = struck(1.0, noise=noise, seed=seed, angle=0.005 * (seed + 1))
    assert clipping_findings(channel_of(step * np.round(values / step))) == []


@pytest.mark.parametrize("step", [1e-9, 0.03, 5e6])
def test_the_step_of_a_converter_is_found_in_any_unit(channel_of, step):
    values = step * np.round(40 * np.random.default_rng(0).standard_normal(3000))
    assert resolution_of(channel_of(values)) == pytest.approx(step)


def test_values_on_no_grid_have_no_step(channel_of):
    assert np.isnan(resolution_of(channel_of(np.random.default_rng(0).standard_normal(3000))))


@pytest.mark.parametrize(("levels", "level"), [(8.0, None), (4.0, "doubtful"), (0.7, "bad")])
def test_few_levels_a_standard_deviation_are_doubtful_then_bad(channel_of, levels, level):
    """Rounding noise is 1 / (levels sqrt(12)): 3.6, 7.2 and 41 %."""
    values = np.round(levels * np.random.default_rng(0).standard_normal(3000)) / levels
    channel = channel_of(values)
    found = resolution_findings(channel, resolution_of(channel))
    assert [finding.level for finding in found] == ([] if level is None else [level])


def test_the_levels_of_an_input_are_what_they_are(channel_of):
    channel = channel_of(np.random.default_rng(0).choice([-1.0, 1.0], 500), role="input")
    assert resolution_findings(channel, resolution_of(channel)) == []


def stuck(channel, others=None):
    n = channel.n_samples
    others = np.random.default_rng(9).standard_normal(n) if others is None else others
    record = Record(others, channel.parts[0], channel.dt)
    return stuck_findings(channel, [record], np.nan)


@pytest.mark.parametrize("smooth", [False, True])
def test_a_frozen_stretch_is_found_where_it_is(channel_of, smooth):
    values = np.random.default_rng(1).standard_normal(3000)
    if smooth:
        values = np.convolve(values, np.hanning(40), "same")
    values[1000:1100] = values[1000]
    (finding,) = stuck(channel_of(values))
    assert finding.what == "stuck"
    assert finding.level == "bad"
    ((_, start, stop),) = finding.spans
    assert (start, stop) == pytest.approx((10.0, 11.0))
    assert finding.share == pytest.approx(100 / 3000)


@pytest.mark.parametrize(("n_equal", "levels"), [(1, []), (9, []), (11, ["doubtful"]), (31, ["bad"])])
def test_ten_equal_samples_are_doubtful_and_a_hundredth_of_the_record_is_bad(channel_of, n_equal, levels):
    values = np.random.default_rng(1).standard_normal(3000)
    values[1000 : 1000 + n_equal] = values[1000]
    assert [finding.level for finding in stuck(channel_of(values))] == levels


def test_a_body_that_comes_to_rest_and_starts_again_is_not_frozen(channel_of):
    t = np.linspace(0, 1, 400)
    swing = np.cos(np.pi * t)  # ends with no speed
    values = np.concatenate([swing, np.full(500, swing[-1]), swing[::-1]])
    assert stuck(channel_of(values)) == []
    frozen = np.concatenate([swing[:200], np.full(500, swing[199]), swing[200:]])  # stops at full speed
    assert [finding.what for finding in stuck(channel_of(frozen))] == ["stuck"]


def test_where_every_channel_rests_nothing_is_frozen(channel_of):
    rng = np.random.default_rng(2)
    values, force = rng.standard_normal((2, 3000))
    values[1000:1500] = 0.3
    force[1000:1500] = 0.0
    assert stuck(channel_of(values), force) == []


@pytest.mark.parametrize("bits", [6, 10, 14])
def test_the_crest_of_a_coarsely_converted_slow_sine_is_not_frozen(channel_of, bits):
    values = np.sin(np.linspace(0, 20, 20_000) + 0.3)
    step = 2.0 / 2**bits
    assert stuck(channel_of(step * np.round(values / step))) == []


def test_an_input_may_rest_at_zero_but_not_freeze_elsewhere(channel_of):
    values = np.random.default_rng(3).standard_normal(3000)
    burst = values.copy()
    burst[1000:2000] = 0.0
    assert stuck(channel_of(burst, role="input")) == []
    frozen = values.copy()
    frozen[1000:2000] = 0.7
    assert [finding.level for finding in stuck(channel_of(frozen, role="input"))] == ["doubtful"]


def test_a_constant_channel_is_dead_and_a_moving_one_is_not(channel_of):
    (finding,) = constant_findings(channel_of(np.full(100, 2.5)))
    assert finding.level == "bad"
    assert "2.5" in finding.sentence
    assert constant_findings(channel_of(np.r_[np.full(99, 2.5), 2.6])) == []


def test_repeated_samples_name_their_number(channel_of):
    values = np.random.default_rng(4).standard_normal(1000)
    (finding,) = repeat_findings(channel_of(np.repeat(values, 3)))
    assert "3 samples" in finding.sentence
    assert repeat_findings(channel_of(values)) == []
