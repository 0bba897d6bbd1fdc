"""Gap against level: exact powers, the deviation of a slope against its scatter, levels that show nothing."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modal.discrepancy.gap import measure_gap
from okid.record import Record

DT = 0.01
LEVELS = (0.3, 1.0, 3.0)


def coloured(rng, n_samples=1024):
    """White noise through a first-order filter: windows differ as those of a structure do."""
    values = rng.standard_normal(n_samples)
    for k in range(1, n_samples):
        values[k] += 0.95 * values[k - 1]
    return values * np.sqrt(1 - 0.95**2)


def gap_of_power(power, *, levels=LEVELS, floor=1e-6, seed=0, offset=0.0, scale=0.1):
    """The output is as large as the level, the gap as large as its power; every record another realisation."""
    rng = np.random.default_rng(seed)
    measured, simulated = [], []
    for level in levels:
        run = level * coloured(rng)
        error = scale * level**power * coloured(rng) + np.sqrt(floor) * rng.standard_normal(run.size) + offset
        measured.append(Record(level * rng.standard_normal(run.size), run + error, DT))
        simulated.append(Record(measured[-1].inputs, run, DT))
    return measure_gap(measured, simulated, floor)


def exact_gap(power, levels=LEVELS):
    shape, error = np.sin(np.arange(800) * 0.3), np.cos(np.arange(800) * 0.7)
    measured = [Record(a * shape, a * shape + 0.1 * a**power * error, DT) for a in levels]
    simulated = [Record(a * shape, a * shape, DT) for a in levels]
    return measure_gap(measured, simulated, 0.0)


@settings(max_examples=25, deadline=None)
@given(st.floats(-0.5, 3.0), st.floats(1.3, 10.0))
def test_a_power_law_gives_its_exponent(power, ratio):
    trend = exact_gap(power, levels=(1.0, ratio, ratio**2)).trend
    # the output that is measured holds the gap as well: |y|^2 = a^2 / 2 + gap^2, and the two grow alike for power 1
    assert trend.absolute_slope == pytest.approx(power, abs=1e-6)


def test_the_relative_slope_is_one_less_where_the_gap_is_small():
    for power in (0.0, 1.0, 2.0):
        trend = (
            exact_gap(power, levels=(0.01, 0.02, 0.04)).trend
            if power > 1
            else exact_gap(power, levels=(10, 20, 40)).trend
        )
        assert trend.slope == pytest.approx(power - 1.0, abs=1e-3)


@pytest.mark.parametrize(
    ("power", "direction"), [(0.0, "falls"), (0.5, "falls"), (1.0, "stays"), (2.0, "rises"), (3.0, "rises")]
)
def test_the_direction_of_laws(power, direction):
    gap = gap_of_power(power, scale=0.05)
    assert gap.trend.direction == direction
    assert gap.output_trends[0].direction == direction
    assert gap.trend.slope == pytest.approx(power - 1.0, abs=4 * gap.trend.slope_std)


@pytest.mark.parametrize(("power", "same"), [(0.0, True), (0.6, False), (1.0, False)])
def test_the_same_absolute_size_is_known_from_a_gap_that_grows(power, same):
    assert gap_of_power(power).trend.same_absolute_size == same


def test_levels_that_hardly_differ_are_not_said_to_show_one_size():
    assert not exact_gap(0.0, levels=(1.0, 1.2, 1.4)).trend.same_absolute_size
    assert exact_gap(0.0, levels=(1.0, 1.5, 2.0)).trend.same_absolute_size


def test_the_deviation_of_a_slope_is_that_of_its_scatter():
    rng = np.random.default_rng(11)
    # two levels: no scatter about a line widens the deviation
    trends = [gap_of_power(1.0, seed=int(seed), levels=(0.3, 3.0)).trend for seed in rng.integers(0, 2**31, 60)]
    scatter = np.std([trend.slope for trend in trends], ddof=1)
    said = np.sqrt(np.mean([trend.slope_std**2 for trend in trends]))
    # 60 slopes know their deviation to 9 %, the jackknife over eight windows is a little wide
    assert 0.65 < scatter / said < 1.4
    assert abs(np.mean([trend.slope for trend in trends])) < 4 * scatter / np.sqrt(60)


def test_directions_are_right_or_not_told():
    rng = np.random.default_rng(12)
    for power, wrong in ((0.0, {"rises", "stays"}), (1.0, {"rises", "falls"}), (2.0, {"falls", "stays"})):
        said = [gap_of_power(power, seed=int(seed)).trend.direction for seed in rng.integers(0, 2**31, 25)]
        assert not wrong & set(said)
        assert said.count("unknown") < 8


def test_one_level_has_no_slope():
    trend = gap_of_power(1.0, levels=(1.0, 1.0, 1.0)).trend
    assert np.isnan(trend.slope)
    assert np.isnan(trend.slope_std)
    assert trend.direction == "unknown"


def limited(levels, *, loud, floor=1e-4):
    """A gap in the loudest record alone, or in the quietest alone."""
    rng = np.random.default_rng(4)
    measured, simulated = [], []
    for level in levels:
        run = level * coloured(rng)
        there = level == (max(levels) if loud else min(levels))
        error = 0.3 * level * there * coloured(rng) + np.sqrt(floor) * rng.standard_normal(run.size)
        measured.append(Record(level * rng.standard_normal(run.size), run + error, DT))
        simulated.append(Record(measured[-1].inputs, run, DT))
    return measure_gap(measured, simulated, floor)


@pytest.mark.parametrize(("loud", "direction"), [(True, "rises"), (False, "falls")])
def test_a_gap_at_one_end_alone_has_a_direction_but_no_slope(loud, direction):
    trend = limited(LEVELS, loud=loud).trend
    assert np.isnan(trend.slope)
    assert trend.direction == direction
    assert trend.silent.tolist() == ([True, True, False] if loud else [False, True, True])


def test_noise_that_could_hide_as_large_a_gap_leaves_the_direction_open():
    trend = limited((0.01, 3.0), loud=True, floor=0.01).trend  # the quiet record is all noise
    assert trend.silent.tolist() == [True, False]
    assert trend.direction == "unknown"


def test_no_gap_no_trend():
    trend = gap_of_power(1.0, scale=0.0).trend
    assert trend.silent.all()
    assert trend.direction == "unknown"
    assert np.isnan(trend.relative).all()


def test_a_gap_in_one_output_is_its_own_trend():
    one, other = gap_of_power(0.0), gap_of_power(2.0, scale=0.05)
    both = [
        [
            Record(a.inputs, np.hstack([a.outputs, b.outputs]), DT)
            for a, b in zip(getattr(one, what), getattr(other, what), strict=True)
        ]
        for what in ("measured", "simulated")
    ]
    trends = measure_gap(*both, 1e-6).output_trends
    assert (trends[0].direction, trends[1].direction) == ("falls", "rises")
