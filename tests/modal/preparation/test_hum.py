"""Mains in the cables of a structure, and modes that ring nearly as steadily."""

import numpy as np
import pytest
from systems import modal_system, simulate, three_modes

from modal.identification.pipeline import identify
from modal.preparation.drift import FreedTrials
from modal.preparation.hum import lines_beside_blows, lines_beside_forces
from okid.record import Record

FREQUENCIES = (13.0, 39.0)


def struck(rng, truth, *, starts, hum=0.0, noise=1e-3, n=3000, frequencies=FREQUENCIES):
    """A record of blows of three rows, and what hums in it; sizes relative to the largest output."""
    u = np.zeros((n, truth.n_inputs))
    for first in starts:
        u[first : first + 3] = np.outer([0.5, 1.0, 0.4], rng.uniform(0.5, 1.5, truth.n_inputs))
    y = simulate(truth, u)
    size = y.std()
    time = truth.dt * np.arange(n)[:, np.newaxis]
    standing = np.zeros_like(y)
    for share, frequency in zip((hum, 0.3 * hum), frequencies, strict=True):
        phases = rng.uniform(0.0, 2.0 * np.pi, truth.n_outputs)
        standing += (
            share * size * rng.uniform(0.5, 1.0, truth.n_outputs) * np.sin(2 * np.pi * frequency * time + phases)
        )
    y += standing + noise * size * rng.standard_normal(y.shape)
    return Record(u, y, truth.dt), standing, noise * size


def test_a_line_is_taken_off_as_exactly_as_noise_lets_it():
    """What is left of it is a fifth of the noise at most, beside modes, with few rows before the blow or many."""
    for seed in range(4):
        rng, truth = three_modes(seed)
        made = [struck(rng, truth, starts=starts, hum=0.03) for starts in ((60, 1400), (25,), (400, 1100, 2200))]
        found = lines_beside_blows([record for record, *_ in made])
        np.testing.assert_allclose(found.frequencies, FREQUENCIES, atol=2e-3)
        for freed, (record, standing, noise) in zip(found.records, made, strict=True):
            left = freed.outputs - (record.outputs - standing)
            assert np.sqrt(np.square(left).mean(axis=0)).max() < 0.2 * noise


@pytest.mark.parametrize("frequency", [6.3, 7.3])
@pytest.mark.parametrize("seed", range(4))
def test_a_line_beside_a_mode_is_told_from_it(seed, frequency):
    """Nothing stands out between what rings at 6 and 6.6 Hz, until between blows each mode rings as it may."""
    rng, truth = three_modes(seed)
    hums = {"hum": 0.03, "frequencies": (frequency, 39.0)}
    made = [struck(rng, truth, starts=starts, **hums) for starts in ((60, 1400), (200, 1100, 2200))]
    found = lines_beside_blows([record for record, *_ in made])
    for freed, (record, standing, noise) in zip(found.records, made, strict=True):
        left = freed.outputs - (record.outputs - standing)
        assert np.sqrt(np.square(left).mean(axis=0)).max() < 0.15 * noise


def test_records_without_a_line_stay_the_very_ones():
    rng, truth = three_modes(0)
    records = tuple(struck(rng, truth, starts=(60, 1400))[0] for _ in range(2))
    found = lines_beside_blows(records)
    assert found.records == records
    assert not found.choices


def test_a_mode_that_hardly_decays_is_no_line():
    """Nothing of it is there before the first blow, and each blow makes it another."""
    for seed in range(8):
        rng = np.random.default_rng(seed)
        truth = modal_system(rng, frequencies=(7.0, 17.0, 29.0), damping_ratios=(1e-3, 3e-5, 1e-4), n_outputs=2)
        starts = ((40,), (40, 1500), (12, 900, 1800), (0, 700, 2100))[seed % 4]
        record, *_ = struck(rng, truth, starts=starts)
        assert not lines_beside_blows([record]).frequencies.size, (seed, starts)


@pytest.mark.parametrize("seed", [6, 8, 21, 23])
def test_nor_is_one_that_several_blows_keep_going(seed):
    """It is there throughout, but each blow makes it another, and it falls until the next."""
    rng = np.random.default_rng(seed)
    truth = modal_system(rng, frequencies=(7.0, 17.0, 29.0), damping_ratios=(1e-3, 3e-5, 1e-4), n_outputs=2)
    records = [struck(rng, truth, starts=starts)[0] for starts in ((0, 700, 1400, 2100), (0, 1500))]
    assert not lines_beside_blows(records).frequencies.size


def test_one_blow_in_the_first_row_leaves_a_line_alone():
    """A mode that does not decay would look the same, and nothing tells which of both it is."""
    rng, truth = three_modes(3)
    record, *_ = struck(rng, truth, starts=(0,), hum=0.03)
    assert not lines_beside_blows([record]).frequencies.size


def test_a_record_that_tells_a_line_tells_it_for_the_others():
    rng, truth = three_modes(4)
    made = [struck(rng, truth, starts=starts, hum=0.03) for starts in ((0,), (300,))]
    found = lines_beside_blows([record for record, *_ in made])
    first, (record, standing, noise) = found.records[0], made[0]
    assert np.abs(first.outputs - (record.outputs - standing)).std() < 0.2 * noise


def test_a_sensor_that_is_dead_or_rests_at_one_level_is_no_trouble():
    rng, truth = three_modes(5)
    record, *_ = struck(rng, truth, starts=(300, 1700))
    outputs = record.outputs.copy()
    outputs[:, 0] = 0.0
    step = 0.02 * outputs[:, 1].std()
    outputs[:, 1:] = step * np.round(outputs[:, 1:] / step)
    outputs[:, 2] += step * np.round(3.0 * np.sin(2 * np.pi * 0.13 * np.arange(3000.0)))
    with np.errstate(all="raise"):
        (freed,) = lines_beside_blows([Record(record.inputs, outputs, record.dt)]).records
    np.testing.assert_array_equal(freed.outputs[:, 0], 0.0)


def test_missing_samples_stay_missing():
    rng, truth = three_modes(5)
    record, standing, noise = struck(rng, truth, starts=(300, 1400), hum=0.03)
    outputs = record.outputs.copy()
    gone = rng.random(outputs.shape) < 0.01
    outputs[gone] = np.nan
    (freed,) = lines_beside_blows([Record(record.inputs, outputs, record.dt)]).records
    np.testing.assert_array_equal(np.isnan(freed.outputs), gone)
    left = (freed.outputs - (record.outputs - standing))[~gone]
    assert np.sqrt(np.square(left).mean()) < 0.5 * noise


def test_a_structure_struck_beside_mains_has_its_own_modes_alone():
    rng, truth = three_modes(6)
    records = [struck(rng, truth, starts=(first,), hum=0.03)[0] for first in (12, 60, 200)]
    result = identify(records, observer_order=8, ridge=0.0)
    assert np.round([mode.frequency for mode in result.modes.system], 1).tolist() == [6.0, 6.6, 21.0]
    assert result.realisation.order == 6
    assert [words for words in result.warnings if "stand" not in words] == []
    assert "13 and 39 Hz" in next(one.value for one in result.choices if one.what == "machine lines")


def driven(rng, truth, force, *, hum=0.0, noise=1e-3, frequencies=FREQUENCIES):
    """A record that a force (n, n_inputs) drives, which is in motion when it begins, and what hums in it."""
    y = simulate(truth, force)[500:]
    size, time = y.std(), truth.dt * np.arange(len(y))[:, np.newaxis]
    standing = np.zeros_like(y)
    for share, frequency in zip((hum, 0.3 * hum), frequencies, strict=True):
        phases, sizes = rng.uniform(0.0, 2.0 * np.pi, truth.n_outputs), rng.uniform(0.5, 1.0, truth.n_outputs)
        standing += share * size * sizes * np.sin(2 * np.pi * frequency * time + phases)
    y += standing + noise * size * rng.standard_normal(y.shape)
    return Record(force[500:], y, truth.dt), standing, noise * size


def forces(rng, truth, kind, n=4500):
    """White noise, a sweep beside it, or bursts of it."""
    force = rng.standard_normal((n, truth.n_inputs))
    if kind == "sweep":
        force[:, 0] = np.sin(0.5 * np.pi * np.arange(n) ** 2 / n)
        force[:, 1:] *= 0.1
    if kind == "bursts":
        force[np.arange(n) % 1000 > 600] = 0.0
    return force


@pytest.mark.parametrize("kind", ["noise", "sweep", "bursts"])
@pytest.mark.parametrize(("frequencies", "most"), [(FREQUENCIES, 0.2), ((38.0, 39.0), 0.2), ((6.3, 39.0), 1.2)])
def test_a_line_beside_forces_is_taken_off_as_exactly_as_noise_lets_it(kind, frequencies, most):
    """A fifth of the noise at most is left of it, also of two that are near each other; beside two modes about all."""
    rng, truth = three_modes(1)
    made = [driven(rng, truth, forces(rng, truth, kind), hum=hum, frequencies=frequencies) for hum in (0.03, 0.03)]
    records = [record.detrended() for record, *_ in made]
    found = lines_beside_forces(records, FreedTrials.of(records))
    np.testing.assert_allclose(found.frequencies, frequencies, atol=2e-3)
    for freed, record, (_, standing, noise) in zip(found.records, records, made, strict=True):
        left = freed.outputs - (record.outputs - standing)
        assert np.sqrt(np.square(left).mean(axis=0)).max() < most * noise


def test_driven_records_without_a_line_stay_the_very_ones():
    rng, truth = three_modes(0)
    for kind in ("noise", "sweep", "bursts"):
        record = driven(rng, truth, forces(rng, truth, kind))[0]
        assert lines_beside_forces([record], FreedTrials.of([record])).records[0] is record


@pytest.mark.parametrize("seed", range(4))
def test_a_mode_that_rings_on_beside_forces_is_no_line(seed):
    """It is in motion when the record begins and hardly decays until its end."""
    rng = np.random.default_rng(seed)
    truth = modal_system(rng, frequencies=(7.0, 17.0, 29.0), damping_ratios=(1e-3, 2e-5, 5e-5), n_outputs=2)
    force = forces(rng, truth, ("noise", "sweep", "bursts")[seed % 3])
    force[:500] *= 30.0
    record, *_ = driven(rng, truth, force)
    assert not lines_beside_forces([record], FreedTrials.of([record])).frequencies.size


def test_multiples_of_a_tone_that_acts_are_no_lines():
    """They are what a system that is not linear makes of it."""
    rng, truth = three_modes(1)
    force = np.sin(2 * np.pi * 9.1 * truth.dt * np.arange(4500))[:, np.newaxis] * np.ones(truth.n_inputs)
    record, *_ = driven(rng, truth, force + 0.1 * rng.standard_normal(force.shape))
    cubic = Record(record.inputs, record.outputs + 0.03 * record.outputs**3 / record.outputs.std() ** 2, record.dt)
    assert not lines_beside_forces([cubic], FreedTrials.of([cubic])).frequencies.size


@pytest.mark.parametrize("seed", range(4))
def test_what_a_model_misses_of_a_tone_in_the_force_is_no_line(seed):
    """A first model has too few states for this one, and errs by a share of all that it makes."""
    rng = np.random.default_rng(seed)
    force = rng.standard_normal(9000) + 0.3 * np.sin(0.7 * np.arange(9000))
    answer = np.convolve(force, rng.standard_normal(300) * 0.99 ** np.arange(300))[:9000]
    record = Record(force, answer + 1e-3 * answer.std() * rng.standard_normal(9000), 0.01)
    assert not lines_beside_forces([record], FreedTrials.of([record])).frequencies.size


def test_missing_samples_beside_forces_stay_missing():
    """A strong line is as well known as if they were there: bridged by nothing, each would leave a part of it."""
    rng, truth = three_modes(5)
    record, standing, noise = driven(rng, truth, forces(rng, truth, "noise"), hum=1.0)
    outputs = record.outputs.copy()
    outputs[np.isin(np.arange(len(outputs)) % 500, (240, 245, 250, 255, 260)), 1] = np.nan
    holed = Record(record.inputs, outputs, record.dt)
    (freed,) = lines_beside_forces([holed], FreedTrials.of([holed])).records
    np.testing.assert_array_equal(np.isnan(freed.outputs), np.isnan(outputs))
    left = freed.outputs - (record.outputs - standing)
    assert np.sqrt(np.nanmean(np.square(left), axis=0)).max() < 0.2 * noise


def test_a_structure_that_is_shaken_beside_mains_has_its_own_modes_alone():
    rng, truth = three_modes(6)
    record, *_ = driven(rng, truth, forces(rng, truth, "noise"), hum=0.3)
    result = identify(record, observer_order=91, ridge=0.0)
    assert np.round([mode.frequency for mode in result.modes.system], 1).tolist() == [6.0, 6.6, 21.0]
    assert result.realisation.order == 6
    assert [words for words in result.warnings if "stand" not in words] == []
    assert "13 and 39 Hz" in next(one.value for one in result.choices if one.what == "machine lines")
