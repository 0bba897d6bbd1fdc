"""Residual spectra and quiet bands against plain loops and known noise."""

import numpy as np
import pytest

from modal.discrepancy.quiet_band import quiet_band, residual_spectrum


def undriven(values):
    return residual_spectrum(np.empty((len(values), 0)), values.reshape(len(values), -1))


@pytest.mark.parametrize(("n_inputs", "n_samples"), [(0, 700), (1, 901), (3, 1200), (2, 150)])
def test_levels_are_those_of_least_squares_in_each_window(n_inputs, n_samples):
    rng = np.random.default_rng(0)
    inputs, outputs = rng.standard_normal((n_samples, n_inputs)), rng.standard_normal((n_samples, 2))
    found = residual_spectrum(inputs, outputs)
    n_windows, width, _ = found.left.shape
    degree = found.transient_freedom - 1
    U = np.array(
        [
            [u @ np.exp(-2j * np.pi * k * np.arange(n_samples) / n_samples) for u in inputs.T]
            for k in range(n_samples // 2 + 1)
        ]
    )
    Y = np.array(
        [
            [y @ np.exp(-2j * np.pi * k * np.arange(n_samples) / n_samples) for y in outputs.T]
            for k in range(n_samples // 2 + 1)
        ]
    )
    assert found.first + n_windows * width == (n_samples - 1) // 2 + 1
    for i in range(n_windows):
        lines = np.arange(found.first + i * width, found.first + (i + 1) * width)
        columns = [(lines - lines.mean()) ** power for power in range(degree + 1)]
        columns += [column * U[lines, j] for j in range(n_inputs) for column in columns[: degree + 1]]
        X = np.stack(columns, axis=1) / [np.linalg.norm(column) for column in columns]
        theta = np.linalg.lstsq(X, Y[lines], rcond=None)[0]
        left = (np.abs(Y[lines] - X @ theta) ** 2).sum(axis=0) / n_samples
        np.testing.assert_allclose(found.level[i], left / (width - X.shape[1]), rtol=1e-9)
        alone = X[:, : degree + 1]
        rest = Y[lines] - alone @ np.linalg.lstsq(alone, Y[lines], rcond=None)[0]
        np.testing.assert_allclose(
            found.level_undriven[i], (np.abs(rest) ** 2).sum(axis=0) / n_samples / (width - degree - 1), rtol=1e-9
        )
        np.testing.assert_allclose(found.edges[i : i + 2] * n_samples, [lines[0] - 0.5, lines[-1] + 0.5])


def test_levels_of_white_noise_are_its_variance_whatever_the_inputs():
    rng = np.random.default_rng(1)
    levels = []
    for n_inputs in (0, 1, 2):
        for _ in range(10):
            inputs = rng.standard_normal((2000, n_inputs))
            levels.append(residual_spectrum(inputs, 0.3 * rng.standard_normal((2000, 1))).level.mean())
    assert abs(np.mean(levels) / 0.09 - 1) < 0.02


def test_an_input_that_does_nothing_in_a_window_makes_no_bias():
    """A multisine leaves most of the band empty, or full of rounding."""
    rng = np.random.default_rng(2)
    k = np.arange(2048)
    multisine = sum(np.cos(2 * np.pi * line * k / 2048 + line**2) for line in range(20, 120))
    levels = [
        residual_spectrum(multisine[:, np.newaxis], 0.1 * rng.standard_normal((2048, 1))).level.mean()
        for _ in range(20)
    ]
    assert abs(np.mean(levels) / 0.01 - 1) < 0.02


def test_choosing_the_quietest_stretch_makes_no_bias():
    """White noise alone: the quietest of all stretches would be some per cent too low, the cross-checked one is not."""
    rng = np.random.default_rng(3)
    found = [quiet_band(undriven(rng.standard_normal(1500)), 0) for _ in range(300)]
    assert abs(np.mean([band.variance for band in found]) - 1) < 0.01
    spread = np.std([band.variance for band in found])
    stated = np.median([band.standard_error for band in found])
    assert 0.6 * stated < spread < 1.3 * stated


def test_the_stretch_avoids_what_is_loud_and_says_where_it_lies():
    rng = np.random.default_rng(4)
    white = rng.standard_normal(4000)
    loud = np.fft.irfft(np.fft.rfft(white) * (np.fft.rfftfreq(4000) < 0.2) * 50.0, 4000)
    band = quiet_band(undriven(loud + 0.1 * rng.standard_normal(4000)), 0)
    assert band.low > 0.195
    assert band.high > 0.4
    assert abs(band.variance / 0.01 - 1) < 0.12
    assert band.driven_share == 0.0


def test_a_hum_in_the_quiet_band_is_left_out():
    rng = np.random.default_rng(5)
    k = np.arange(3000)
    ratios = []
    for _ in range(20):
        hum = np.sin(2 * np.pi * 0.317 * k) + 0.5 * np.sin(2 * np.pi * 0.4215 * k)
        ratios.append(quiet_band(undriven(hum + 0.1 * rng.standard_normal(3000)), 0).variance / 0.01)
    assert abs(np.mean(ratios) - 1) < 0.04
    assert max(ratios) < 1.25


def test_a_narrow_band_is_less_sure_than_a_wide_one_of_as_many_samples():
    rng = np.random.default_rng(6)

    def error(edge, n_samples):
        white = rng.standard_normal(n_samples)
        loud = np.fft.irfft(np.fft.rfft(white) * (np.fft.rfftfreq(n_samples) < edge) * 50.0, n_samples)
        band = quiet_band(undriven(loud + 0.1 * rng.standard_normal(n_samples)), 0)
        return band.standard_error, band.freedom

    wide, narrow = error(0.1, 2000), error(0.38, 8000)
    assert 0.6 < narrow[1] / wide[1] < 2.0
    assert narrow[0] > 4 * wide[0]
    assert narrow[0] > 0.3


def test_the_standard_error_is_that_of_flat_plus_tail():
    """Levels are gamma distributed about 1 + 0 * tail: the error of the first of two coefficients, by simulation."""
    rng = np.random.default_rng(7)
    found = undriven(rng.standard_normal(2000))
    band = quiet_band(found, 0)
    middle = 0.5 * (found.edges[1:] + found.edges[:-1])
    inside = (middle > band.low) & (middle < band.high)
    tail = 1 / (4 * np.sin(np.pi * np.maximum(middle[inside], 0.1)) ** 2)
    X = np.stack([np.ones(tail.size), tail], axis=1)
    draws = rng.gamma(found.freedom, 1 / found.freedom, (4000, tail.size))
    spread = np.linalg.lstsq(X, draws.T, rcond=None)[0][0].std()
    assert 0.8 * spread < band.standard_error < 1.6 * spread  # the halves may have chosen different stretches


def test_noise_that_rises_with_frequency_is_counted_as_a_whole():
    """Velocity from a rounded position: differences of white noise, four times its variance at the end."""
    rng = np.random.default_rng(8)
    ratios = []
    for _ in range(10):
        blue = np.diff(rng.standard_normal(6001))
        band = quiet_band(undriven(blue), 0)
        ratios.append(band.variance * band.rise / 2.0)
        assert band.rise > 1.3
    assert 0.75 < np.mean(ratios) < 1.1
    flat = [quiet_band(undriven(rng.standard_normal(3000)), 0).rise for _ in range(60)]
    assert np.mean(np.array(flat) == 1.0) > 0.9
    assert max(flat) < 1.15


def test_too_few_samples_make_no_spectrum():
    assert residual_spectrum(np.empty((40, 0)), np.zeros((40, 1))) is None
    assert residual_spectrum(np.zeros((200, 30)), np.zeros((200, 1))) is None
