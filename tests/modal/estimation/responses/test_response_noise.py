"""What the errors of a table of several references are made of, against forces whose powers are known."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from response_tables import averaged, drawn_structure, held_response

from modal.estimation.responses.fit import lines_of, refined
from modal.estimation.responses.noise import (
    beyond_blocks,
    drawn_noise,
    lines_joined,
    noise_of,
    pole_deviations,
    residue_deviations,
    with_powers,
)
from modal.estimation.responses.order import first_weight, grown, weight_of
from okid.frequency_response import FrequencyResponse


@pytest.fixture(scope="module")
def driven():
    """A table of two references of rms 3 and 1 in blocks of 512 samples, and its model from the true poles."""
    f, damping, shapes = drawn_structure(np.random.default_rng([61701, 58]), 100.0)
    rng, points = np.random.default_rng(17), [2, 5]
    forces = rng.standard_normal((65536, 2)) * [3.0, 1.0]
    outputs = held_response(forces, f, damping, shapes, shapes[points], dt=0.01)
    outputs += 0.05 * outputs.std(axis=0) * rng.standard_normal(outputs.shape)
    response, coherence, n_averages = averaged(forces, outputs, "hann", 512)
    grid = np.arange(257) * 100.0 / 512
    table, _ = lines_of(
        FrequencyResponse(response, grid, coherence=coherence, n_averages=n_averages, window="hann"), "hann"
    )
    poles = np.exp(2 * np.pi * f * (-damping + 1j * np.sqrt(1 - damping**2)) * table.dt)
    inputs = shapes[points].T / table.input_scale
    inputs = inputs / np.take_along_axis(inputs, np.abs(inputs).argmax(axis=1)[:, np.newaxis], axis=1)
    fit = refined(table, (poles, np.ones(5, dtype=bool), inputs + 0j), first_weight(table), n_steps=8)
    return table, fit, n_averages


def test_how_strong_each_reference_was_is_told_by_the_scatter_of_its_responses(driven):
    table, fit, _ = driven
    power = with_powers(table, fit).power
    expected = np.array([9.0, 1.0]) / table.input_scale**2
    assert expected[1] / expected[0] < 0.02  # in the table's own scales
    assert power[1] / power[0] < 2 * expected[1] / expected[0]


def test_references_of_unlike_power_are_no_uneven_forces(driven):
    """Taken for equal they made the noise of a mode three times too large, and all modes of the table doubtful."""
    table, fit, n_averages = driven
    told = with_powers(table, fit)
    ratios = []
    for one in (table, told):
        best = refined(one, fit.start, weight_of(one, noise_of(one, fit)), n_steps=8)
        noise = noise_of(one, best)
        damping = -np.log(np.abs(best.poles)) / np.abs(np.log(best.poles))
        relative = pole_deviations(one, best, noise)[1] / damping
        ratios.append(beyond_blocks(one, best, noise, relative, n_averages))
    assert (ratios[0] != 1).any()
    np.testing.assert_array_equal(ratios[1], 1.0)


def test_deviations_of_shapes_and_masses_are_how_far_repeated_tests_scatter():
    """An analyser's tables of one structure, Hann blocks and two forces at once: masses had no deviation."""
    f, damping, shapes = drawn_structure(np.random.default_rng([61702, 58]), 100.0)
    f, damping, shapes = f[:3], damping[:3], shapes[:, :3]
    rng, points, grid = np.random.default_rng(23), [0, 2], np.arange(129) * 100.0 / 256
    of_shape, of_mass, told = [], [], []
    for _ in range(24):
        forces = rng.standard_normal((8192, 2))
        outputs = held_response(forces, f, damping, shapes, shapes[points], dt=0.01)
        outputs += 0.05 * outputs.std(axis=0) * rng.standard_normal(outputs.shape)
        response, coherence, n_averages = averaged(forces, outputs, "hann", 256)
        given = {"coherence": coherence, "n_averages": n_averages, "window": "hann"}
        table, _ = lines_of(FrequencyResponse(response, grid, **given), "hann")
        poles = np.exp(2 * np.pi * f * (-damping + 1j * np.sqrt(1 - damping**2)) * table.dt)
        inputs = shapes[points].T / table.input_scale
        inputs = inputs / np.take_along_axis(inputs, np.abs(inputs).argmax(axis=1)[:, np.newaxis], axis=1)
        fit = refined(table, (poles, np.ones(3, dtype=bool), inputs + 0j), first_weight(table), n_steps=8)
        table = with_powers(table, fit)
        fit = refined(table, fit.start, weight_of(table, noise_of(table, fit)), n_steps=8)
        told.append(residue_deviations(table, fit, noise_of(table, fit), range(3)))
        c, b = (fit.shapes * table.output_scale[:, np.newaxis]).T, fit.inputs / table.input_scale
        largest = c[np.arange(3), np.abs(shapes).argmax(axis=0)][:, np.newaxis]
        of_shape.append(c / largest)
        of_mass.append(np.log(np.abs(c[:, :, np.newaxis] / (largest**2)[..., np.newaxis] / b[:, np.newaxis])))
    stated = [np.sqrt(np.mean([[mode[part] ** 2 for mode in one] for one in told], axis=0)) for part in (0, 1)]
    for values, deviation in zip((of_shape, of_mass), stated, strict=True):
        scatter = np.std(values, axis=0, ddof=1)
        there = deviation > 0  # the largest component of a shape is 1
        assert scatter[~there] == pytest.approx(0.0, abs=1e-12)
        ratios = scatter[there] / deviation[there]
        assert np.sqrt(np.mean(ratios**2)) == pytest.approx(1.0, abs=0.15)
        assert (ratios < 1.7).all()


@pytest.mark.parametrize(
    ("overlap", "share"),
    [(None, 0.5), *(pytest.param(one, one, marks=pytest.mark.slow) for one in (0.0, 0.75))],
)
def test_deviations_are_those_of_blocks_that_overlap(overlap, share):
    """What one block lacks of an answer the next one has: damping is told twice as well with half overlap, not 1.4."""
    f, damping, shape, n = np.array([20.3]), np.array([0.003]), np.array([1.0, 0.6]), 256
    rng, found, stated = np.random.default_rng(3), [], []
    pole = np.exp(2 * np.pi * f * (-damping + 1j * np.sqrt(1 - damping**2)) / 100.0)
    for _ in range(120):
        force = rng.standard_normal((8192, 1))
        outputs = held_response(force, f, damping, np.tile(shape, 3)[:, np.newaxis], np.ones((1, 1)), dt=0.01)[:, :2]
        outputs = outputs + 0.02 * outputs.std(axis=0) * rng.standard_normal(outputs.shape)
        response, coherence, n_averages = averaged(force, outputs, "hann", n, step=round(n * (1 - share)))
        grid = np.arange(n // 2 + 1) * 100.0 / n
        known = {"coherence": coherence, "n_averages": n_averages, "window": "hann", "overlap": overlap}
        table, _ = lines_of(FrequencyResponse(response, grid, **known), "hann")
        start = (pole, np.ones(1, dtype=bool), np.ones((1, 1), dtype=complex))
        fit = refined(table, start, first_weight(table), n_steps=8)
        fit = refined(table, fit, weight_of(table, noise_of(table, fit)), n_steps=8)
        s = np.log(fit.poles[0]) * 100.0
        found.append([abs(s) / (2 * np.pi), -s.real / abs(s)])
        stated.append(np.ravel(pole_deviations(table, fit, noise_of(table, fit))))
    ratio = np.sqrt(np.mean(np.square(stated), axis=0)) / np.std(found, axis=0)
    np.testing.assert_allclose(ratio, 1.0, atol=0.2)  # three standard errors of 120 draws


def test_deviations_of_shapes_do_not_hold_the_weights_of_all_modes_at_once(driven, monkeypatch):
    """20 outputs, 2 references, 513 lines and 12 poles took half a gigabyte, and 8193 lines would take eight."""
    table, fit, _ = driven
    noise = noise_of(table, fit)
    monkeypatch.setattr("modal.estimation.responses.noise.MOST_WEIGHTS", 1)
    tracemalloc.start()
    apart = residue_deviations(table, fit, noise, range(5))
    peaks = [tracemalloc.get_traced_memory()[1]]
    monkeypatch.undo()
    tracemalloc.reset_peak()
    together = residue_deviations(table, fit, noise, range(5))
    peaks.append(tracemalloc.get_traced_memory()[1])
    tracemalloc.stop()
    assert peaks[0] < 0.5 * peaks[1]
    for one, other in zip(apart, together, strict=True):
        for part in (0, 1):
            np.testing.assert_allclose(one[part], other[part], rtol=1e-9, atol=1e-15)


def test_blocks_that_overlap_almost_wholly_are_counted_on_a_grid(driven):
    """Each of 1000 blocks within the length of one cost as much as the first, and said nothing new."""
    table, fit, _ = driven
    stated = []
    for overlap in (0.95, 0.96, 0.9999):
        closer = replace(table, overlap=overlap)
        assert len(closer.shifts) < 64
        stated.append(pole_deviations(closer, fit, noise_of(closer, fit)))
    np.testing.assert_allclose(stated[1:], [stated[0]] * 2, rtol=1e-3)


def test_errors_of_hits_are_those_of_white_noise_that_the_exponential_window_weighs():
    """Drawn errors, and transforms of windowed noise: how far lines belong together."""
    n, tau, rng = 256, 0.4, np.random.default_rng(5)
    response = FrequencyResponse(
        np.full(n // 2 + 1, 1.0 + 0j),
        np.fft.rfftfreq(n, 0.01),
        window="exponential",
        window_time_constant=tau,
    )
    table, _ = lines_of(response, "exponential")
    weights = np.exp(-np.arange(n) * 0.01 / tau)
    measured = np.fft.rfft(weights * rng.standard_normal((4000, n)))[:, 1:-1]
    pole = np.array([np.exp(2j * np.pi * 10.0 * 0.01 - 0.1)])
    fit = refined(table, (pole, np.array([True]), np.ones((1, 1)) + 0j), first_weight(table), n_steps=0)
    noise = replace(noise_of(table, fit), variance=np.ones(table.values.shape))
    drawn = np.array([drawn_noise(table, fit, noise, rng)[1:-1, 0, 0] for _ in range(4000)])
    for lines, size in ((drawn, 1.0), (measured, np.sqrt(weights @ weights))):
        across = [np.mean(lines[:, m:] * lines[:, : lines.shape[1] - m].conj()) / size**2 for m in (0, 1, 3, 12, 30)]
        np.testing.assert_allclose(across, [table.joining()[m] for m in (0, 1, 3, 12, 30)], atol=0.02)
    assert lines_joined(table) == pytest.approx(n / (weights @ weights))


@pytest.mark.parametrize("share", [0.0, 0.01])
def test_scatter_tells_a_force_that_fades_from_noise_that_grows_with_the_response(share):
    """The noise of the former was taken for the latter: half of it at antiresonances, twice as much at peaks."""
    lines, rng = 0.125 * np.arange(1, 921), np.random.default_rng(11)
    f, damping = np.array([25.0, 40.0, 65.0]), 0.01
    s, w = 2j * np.pi * lines[:, np.newaxis], 2 * np.pi * f
    exact = (s**2 / (s**2 + 2 * damping * w * s + w**2)).sum(axis=1)
    fading = np.exp(0.15 * np.maximum(lines - 80, 0))
    deviation = share * np.abs(exact) if share else 0.01 * fading
    values = exact + deviation * (rng.standard_normal(920) + 1j * rng.standard_normal(920)) / np.sqrt(2)
    table, _ = lines_of(FrequencyResponse(values, lines, window="periodic"), "periodic", 4)
    poles = np.exp(w * (-damping + 1j * np.sqrt(1 - damping**2)) * table.dt)
    start = (poles, np.ones(3, dtype=bool), np.ones((3, 1)) + 0j)
    weight = np.where(table.known, (table.output_scale[0] / table.input_scale[0] / deviation)[:, None, None], 0.0)
    fit = refined(table, start, weight)
    stated = np.sqrt(noise_of(table, fit).variance[:, 0, 0]) * table.output_scale[0] / table.input_scale[0]
    inside = (lines > 15) & (lines < 75)
    assert np.quantile(np.abs(np.log(stated / deviation))[inside], 0.95) < np.log(1.4)


@pytest.mark.parametrize(("late", "noise", "n_more"), [(0.0, 0.002, 2), (0.02, 1e-6, 0)], ids=["two modes", "delay"])
def test_a_few_modes_are_found_in_what_is_left_but_none_in_what_no_pole_explains(late, noise, n_more):
    """A delay leaves what any pole explains a part of: a table of exact numbers grew to the largest order so."""
    lines, rng = 0.125 * np.arange(1, 921), np.random.default_rng(12)
    f, damping, sizes = np.array([25.0, 40.0, 55.0, 70.0]), 0.01, np.array([1.0, 0.02, 1.0, 0.02])
    sizes[[1, 3]] *= n_more > 0
    s, w = 2j * np.pi * lines[:, np.newaxis], 2 * np.pi * f
    exact = (sizes * s**2 / (s**2 + 2 * damping * w * s + w**2)).sum(axis=1) * np.exp(-2j * np.pi * lines * late)
    values = exact + noise * (rng.standard_normal(920) + 1j * rng.standard_normal(920)) / np.sqrt(2)
    table, _ = lines_of(FrequencyResponse(values, lines, window="periodic"), "periodic", 4)
    poles = np.exp(w[[0, 2]] * (-damping + 1j * np.sqrt(1 - damping**2)) * table.dt)
    scale = table.output_scale[0] / table.input_scale[0]
    weight = np.where(table.known, scale / noise, 0.0)
    fit = refined(table, (poles, np.ones(2, dtype=bool), np.ones((2, 1)) + 0j), weight)
    more = grown(table, fit, weight)
    assert more.poles.size == 2 + n_more
    found = np.sort(np.angle(more.poles)) / (2 * np.pi * table.dt)
    if n_more:
        np.testing.assert_allclose(found, f, rtol=2e-3)
