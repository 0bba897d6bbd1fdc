"""The tables of the gap: what they must add up to, what they must not depend on, and what they refuse."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modal.localisation.bands import line_power, octave_bands
from modal.localisation.gap import excitation_levels, measure_gap
from okid.errors import InvalidDataError
from okid.record import Record

DT = 0.01


def pair(seed=0, *, n_records=3, n_samples=600, n_outputs=2, missing=0.0, dt=DT):
    rng = np.random.default_rng(seed)
    measured, simulated = [], []
    for i in range(n_records):
        force = (i + 1) * rng.standard_normal((n_samples, 1))
        run = (i + 1) * rng.standard_normal((n_samples, n_outputs)).cumsum(axis=0)
        seen = run + 0.3 + rng.standard_normal(run.shape)
        seen[rng.random(run.shape) < missing] = np.nan
        measured.append(Record(force, seen, dt))
        simulated.append(Record(force, run, dt))
    return measured, simulated


@pytest.mark.parametrize("missing", [0.0, 0.1])
@pytest.mark.parametrize("n_samples", [600, 601])
def test_bands_cells_and_windows_each_sum_to_the_mean_square(n_samples, missing):
    measured, simulated = pair(n_samples=n_samples, missing=missing)
    gap = measure_gap(measured, simulated, 1.0)
    truth = [np.nanmean((m.outputs - s.outputs) ** 2, axis=0) for m, s in zip(measured, simulated, strict=True)]
    np.testing.assert_allclose(gap.mean_square, truth, rtol=1e-12)
    np.testing.assert_allclose(gap.constant + gap.bands.power.sum(axis=1), truth, rtol=1e-10)
    np.testing.assert_allclose(gap.constant + gap.cells.gap.sum(axis=1), truth, rtol=1e-10)
    windows = gap.windows
    np.testing.assert_allclose(
        (windows.gap * windows.n_samples).sum(axis=1) / windows.n_samples.sum(axis=1), truth, rtol=1e-12
    )


def test_the_floor_is_shared_out_to_all_frequencies_but_the_constant():
    measured, simulated = pair(n_samples=600)
    floor = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])
    gap = measure_gap(measured, simulated, floor)
    np.testing.assert_allclose(gap.bands.floor.sum(axis=1), floor * (1 - 1 / 600), rtol=1e-12)
    np.testing.assert_allclose(gap.cells.floor.sum(axis=1), floor * (1 - 1 / 600), rtol=1e-12)
    assert gap.bands.n_lines.sum(axis=1).tolist() == [300, 300, 300]


def test_white_noise_of_the_floors_size_fills_every_band_to_its_floor():
    rng = np.random.default_rng(3)
    run = np.sin(np.arange(40_000)[:, np.newaxis] * 0.01)
    noise = 0.2 * rng.standard_normal(run.shape)
    gap = measure_gap(Record([], run + noise, DT), Record([], run, DT), 0.04)
    ratio = gap.bands.power[0, :, 0] / gap.bands.floor[0, :, 0]
    # a mean of n lines, each chi-square with two degrees of freedom, deviates by 1 / sqrt(n)
    assert (np.abs(ratio - 1.0) < 4.0 / np.sqrt(gap.bands.n_lines[0])).all()


def test_lines_are_those_of_the_textbook_transform():
    values = np.random.default_rng(1).standard_normal(9)
    constant, lines = line_power(values[:, np.newaxis])
    k = np.arange(9)
    for i in range(1, 5):
        a = 2 / 9 * (values * np.cos(2 * np.pi * i * k / 9)).sum()
        b = 2 / 9 * (values * np.sin(2 * np.pi * i * k / 9)).sum()
        assert lines[i - 1, 0] == pytest.approx((a**2 + b**2) / 2, rel=1e-12)
    assert constant[0] == pytest.approx(values.mean() ** 2, rel=1e-12)


def test_sizes_against_hand_calculation():
    time = np.arange(1000) * DT
    run = np.sin(2 * np.pi * 2 * time)
    extra = 0.3 * np.sin(2 * np.pi * 11 * time) + 0.1
    record, simulation = Record(run, run + extra, DT), Record(run, run, DT)
    gap = measure_gap(record, simulation, 0.01)
    assert gap.mean_square[0, 0] == pytest.approx(0.045 + 0.01)
    assert gap.rmse[0, 0] == pytest.approx(np.sqrt(0.055))
    assert gap.variance[0, 0] == pytest.approx(0.5 + 0.045)
    assert gap.relative[0, 0] == pytest.approx(np.sqrt(0.055 / 0.545))
    assert gap.in_floors[0, 0] == pytest.approx(5.5)
    assert gap.excess[0, 0] == pytest.approx(0.045 / 0.545)
    assert gap.constant[0, 0] == pytest.approx(0.01)
    own = [band.low < 11 <= band.high for band in gap.bands.bands]
    assert sum(own) == 1
    np.testing.assert_allclose(gap.bands.power[0, :, 0], np.where(own, 0.045, 0.0), atol=1e-15)


def test_a_line_on_the_edge_of_two_bands_belongs_to_the_lower():
    time = np.arange(1000) * DT
    edge = 0.125 / DT  # a quarter of the Nyquist frequency
    extra = np.sin(2 * np.pi * edge * time)
    gap = measure_gap(Record(extra, 2 * extra, DT), Record(extra, extra, DT), 0.0)
    own = [band.high == pytest.approx(edge) for band in gap.bands.bands]
    assert sum(own) == 1
    np.testing.assert_allclose(gap.bands.power[0, :, 0], np.where(own, 0.5, 0.0), atol=1e-15)


@settings(max_examples=15, deadline=None)
@given(st.floats(1e-6, 1e6), st.integers(0, 1000))
def test_units_change_nothing_that_is_relative(factor, seed):
    measured, simulated = pair(seed, n_samples=300)
    scaled = [
        [Record(r.inputs / factor, r.outputs * [1.0, factor], DT) for r in records] for records in (measured, simulated)
    ]
    one, other = measure_gap(measured, simulated, 0.5), measure_gap(*scaled, 0.5 * np.array([1.0, factor**2]))
    np.testing.assert_allclose(other.relative, one.relative, rtol=1e-9)
    np.testing.assert_allclose(other.in_floors, one.in_floors, rtol=1e-9)
    np.testing.assert_allclose(other.levels, one.levels, rtol=1e-9)
    np.testing.assert_allclose(other.trend.relative, one.trend.relative, rtol=1e-9)
    assert other.trend.slope == pytest.approx(one.trend.slope, rel=1e-6, abs=1e-9)
    assert other.trend.slope_std == pytest.approx(one.trend.slope_std, rel=1e-6)


@settings(max_examples=15, deadline=None)
@given(st.permutations(range(3)), st.integers(0, 1000))
def test_the_order_of_records_and_outputs_only_permutes(order, seed):
    measured, simulated = pair(seed, n_samples=300)
    gap = measure_gap(measured, simulated, 0.5)
    moved = measure_gap(
        [measured[i].select(outputs=[1, 0]) for i in order], [simulated[i].select(outputs=[1, 0]) for i in order], 0.5
    )
    np.testing.assert_allclose(moved.bands.power, gap.bands.power[list(order)][..., ::-1], rtol=1e-12)
    assert moved.level_numbers.tolist() == gap.level_numbers[list(order)].tolist()
    assert moved.trend.slope == pytest.approx(gap.trend.slope, rel=1e-9)
    assert moved.output_trends[0].slope == pytest.approx(gap.output_trends[1].slope, rel=1e-9)


def test_twice_the_time_step_halves_the_frequencies():
    slow = measure_gap(*pair(dt=2 * DT), 1.0)
    fast = measure_gap(*pair(dt=DT), 1.0)
    np.testing.assert_allclose(slow.cells.edges, fast.cells.edges / 2)
    np.testing.assert_allclose(slow.cells.gap, fast.cells.gap)


@pytest.mark.parametrize("n_samples", [400, 401, 5000])
def test_every_line_lies_within_its_cell(n_samples):
    time = np.arange(n_samples) * DT
    for k in (1, 7, n_samples // 4):
        frequency = k / (n_samples * DT)
        tone = np.sin(2 * np.pi * frequency * time)
        cells = measure_gap(Record(tone, 2 * tone, DT), Record(tone, tone, DT), 0.0).cells
        assert cells.edges.size == cells.gap.shape[1] + 1
        (own,) = np.flatnonzero(cells.gap[0, :, 0] > 1e-9)
        assert cells.edges[own] <= frequency <= cells.edges[own + 1]


def test_missing_samples_stay_missing_and_are_not_counted():
    measured, simulated = pair(n_records=1, n_samples=80)
    values = np.array(measured[0].outputs)
    values[:10, 0] = np.nan  # the whole first window of one output
    gap = measure_gap(Record(measured[0].inputs, values, DT), simulated, 1.0)
    assert np.isnan(gap.residuals[0][:10, 0]).all()
    assert np.isnan(gap.windows.gap[0, 0, 0])
    assert gap.windows.n_samples[0, 0].tolist() == [0, 10]
    left = (measured[0].outputs - simulated[0].outputs)[10:, 0]
    assert gap.mean_square[0, 0] == pytest.approx((left**2).mean())


def test_residuals_are_read_only_and_measured_less_simulated():
    measured, simulated = pair(n_records=1)
    gap = measure_gap(measured, simulated, 1.0)
    np.testing.assert_array_equal(gap.residuals[0], measured[0].outputs - simulated[0].outputs)
    assert not gap.residuals[0].flags.writeable


def test_an_output_at_rest_has_no_relative_gap():
    run = np.column_stack([np.sin(np.arange(100.0)), np.zeros(100)])
    gap = measure_gap(Record([], run, DT), Record([], run + 0.1, DT), 0.01)
    assert np.isnan(gap.relative[0, 1])
    assert gap.relative[0, 0] > 0.0


def test_equal_simulations_without_noise_stay_below_rounding():
    measured, _ = pair()
    assert (measure_gap(measured, measured, 0.0).in_floors == 0.0).all()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda m, s: (m, s[:2], 1.0), "there are 3 and 2"),
        (lambda m, s: (m, [r.samples(0, 500) for r in s], 1.0), "same samples"),
        (lambda m, s: (m, [Record(r.inputs, r.outputs, 0.02) for r in s], 1.0), "same time step"),
        (lambda m, s: (m, [r.select(outputs=[0]) for r in s], 1.0), "same output names"),
        (lambda m, s: (m, [Record(r.inputs, r.outputs, DT, output_units=["m", "m"]) for r in s], 1.0), "output units"),
        (lambda m, s: (m, s, np.ones((2, 2))), r"\(n_records, n_outputs\) = \(3, 2\)"),
        (lambda m, s: (m, s, -1.0), "at least 0"),
        (lambda m, s: (m, s, np.nan), "finite"),
    ],
)
def test_what_does_not_match_is_refused_in_one_sentence(change, words):
    with pytest.raises(InvalidDataError, match=words):
        measure_gap(*change(*pair()))


def test_an_output_without_a_common_sample_is_refused():
    first, second = np.arange(10.0), np.arange(10.0)
    first[:5], second[5:] = np.nan, np.nan
    with pytest.raises(InvalidDataError, match="no sample in common"):
        measure_gap(Record([], first, DT), Record([], second, DT), 1.0)


# --- levels ----------------------------------------------------------------------------------------------------------


def records_of(*inputs):
    return [Record(np.asarray(u, dtype=float), np.arange(float(len(u))), DT) for u in inputs]


def test_levels_are_rms_relative_to_the_loudest():
    levels, numbers, source = excitation_levels(records_of([1, -1], [4, 4], [2, -2]))
    np.testing.assert_allclose(levels, [0.25, 1.0, 0.5])
    assert (numbers.tolist(), source) == ([1, 3, 2], "inputs")


@pytest.mark.parametrize(("ratio", "n_levels"), [(1.09, 1), (1.11, 2)])
def test_records_within_ten_per_cent_are_of_one_level(ratio, n_levels):
    assert excitation_levels(records_of([1, -1], [ratio, -ratio]))[1].max() == n_levels


def test_inputs_of_other_units_count_alike():
    first = np.array([[1.0, 1e6], [-1.0, -1e6]])
    second = np.array([[2.0, 1e6], [-2.0, -1e6]])
    records = [Record(u, np.arange(2.0), DT) for u in (first, second)]
    # mean squares relative to their means: 1 / 2.5 + 1 and 4 / 2.5 + 1
    np.testing.assert_allclose(excitation_levels(records)[0], [np.sqrt(1.4 / 2.6), 1.0])


@pytest.mark.parametrize("inputs", [np.empty((4, 0)), np.zeros((4, 1))])
def test_without_an_input_that_moves_the_outputs_are_the_level(inputs):
    records = [Record(inputs, size * np.array([5.0, 6.0, 5.0, 6.0]), DT) for size in (1.0, 3.0)]
    levels, numbers, source = excitation_levels(records)
    np.testing.assert_allclose(levels, [1 / 3, 1.0])
    assert (numbers.tolist(), source) == ([1, 2], "outputs")


# --- bands -----------------------------------------------------------------------------------------------------------


def test_octaves_double():
    bands = octave_bands(50.0)
    assert len(bands) == 8
    assert [band.high / band.low for band in bands[1:]] == [2.0] * 7
    assert (bands[0].low, bands[-1].high) == (0.0, 50.0)
