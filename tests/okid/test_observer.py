"""OKID on exact data: Markov parameters equal C A^(k-1) B whatever the initial state, units, offsets and gaps."""

import re
import warnings

import numpy as np
import pytest
from signals import random_inputs, with_noise
from systems import initial_state, markov, random_system, simulate

from okid.errors import IdentificationWarning, InsufficientDataError, InvalidDataError
from okid.markov import recover_markov
from okid.observer import fit_observer
from okid.record import Record

N_LAGS = 120


def exact_record(system, seed, n_samples=1200, *, offset=0.0, into=1.0, out=1.0):
    rng = np.random.default_rng(seed)
    u = random_inputs(rng, n_samples, system.n_inputs)
    y = simulate(system, u, initial_state=initial_state(rng, system, u))
    return Record(u * into + offset, y * out + offset, system.dt)


def relative_error(found, truth):
    return np.abs(found - truth).max() / np.abs(truth).max()


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("n_modes", "n_inputs", "n_outputs"), [(3, 2, 2), (4, 1, 1), (4, 3, 4)])
@pytest.mark.parametrize("spare", [0, 3, 25])
def test_markov_parameters_are_exact_at_minimal_and_at_spare_order(seed, n_modes, n_inputs, n_outputs, spare):
    rng = np.random.default_rng(seed)
    system = random_system(rng, n_modes=n_modes, n_inputs=n_inputs, n_outputs=n_outputs)
    records = [exact_record(system, seed + 10), exact_record(system, seed + 20, 500)]
    order = -(-system.order // n_outputs) + spare
    found = recover_markov(fit_observer(records, order=order), n_lags=N_LAGS)
    # At minimal order with one output the observer is deadbeat and its gain huge: the data's own rounding shows.
    assert relative_error(found.system, markov(system, N_LAGS)) < (1e-8 if spare == 0 else 1e-10)


def test_lags_do_not_depend_on_the_order():
    system = random_system(np.random.default_rng(1))
    fit = fit_observer(exact_record(system, 1), order=5)
    truth = markov(system, 300)
    for n_lags in (1, 3, 5, 300):
        assert relative_error(recover_markov(fit, n_lags=n_lags).system, truth[: n_lags + 1]) < 1e-10


def test_offsets_of_a_million_and_units_spread_over_nine_decades():
    system = random_system(np.random.default_rng(2), n_inputs=2, n_outputs=3)
    truth = markov(system, N_LAGS)
    shifted = recover_markov(fit_observer(exact_record(system, 3, offset=1e6), order=8), n_lags=N_LAGS)
    assert relative_error(shifted.system, truth) < 1e-7  # the samples themselves are rounded to 1e-10
    into, out = np.array([1e5, 1e-1]), np.array([1e-4, 1.0, 1e3])
    found = recover_markov(fit_observer(exact_record(system, 4, into=into, out=out), order=8), n_lags=N_LAGS)
    assert relative_error(found.system * into / out[:, np.newaxis], truth) < 1e-10


def test_the_constant_takes_up_offsets():
    system = random_system(np.random.default_rng(5))
    with_offset = exact_record(system, 6, offset=3.0)
    found = recover_markov(fit_observer(with_offset, order=4), n_lags=N_LAGS)
    assert relative_error(found.system, markov(system, N_LAGS)) < 1e-8


def test_missing_samples_drop_only_the_rows_they_touch():
    system = random_system(np.random.default_rng(7), n_outputs=3)
    record = exact_record(system, 8)
    u, y = np.array(record.inputs), np.array(record.outputs)
    y[[100, 101, 400], [0, 1, 2]] = np.nan
    u[700] = np.nan
    fit = fit_observer(Record(u, y, record.dt), order=4)
    assert fit.n_rows == 1200 - 4 - 6 - 5 - 5
    assert relative_error(recover_markov(fit, n_lags=N_LAGS).system, markov(system, N_LAGS)) < 1e-10


def equation_written_out(record, order):
    """Rows [1, u(k), u(k-1), y(k-1), u(k-2), y(k-2), ...] of the observer equation and the outputs y(k)."""
    u, y, n = record.inputs, record.outputs, record.n_samples
    columns = [np.ones((n - order, 1)), u[order:]]
    for lag in range(1, order + 1):
        columns += [u[order - lag : n - lag], y[order - lag : n - lag]]
    return np.hstack(columns), y[order:]


def test_all_of_a_fit_is_that_of_the_equation_written_out():
    """Coefficients, offset and residual covariance in the record's own units, against plain least squares."""
    rng = np.random.default_rng(21)
    u = random_inputs(rng, 900, 2) * [3.0, 0.2] + [5.0, -0.7]
    system = random_system(rng, n_modes=2, n_inputs=2, n_outputs=3)
    clean = simulate(system, u) * [10.0, 1.0, 0.1]
    y = with_noise(rng, clean, 0.2) + np.array([40.0, 0.0, -3.0])
    record = Record(u, y, system.dt)
    fit = fit_observer(record, order=3)
    rows, outputs = equation_written_out(record, 3)
    x, *_ = np.linalg.lstsq(rows, outputs, rcond=None)
    left = outputs - rows @ x
    lags = x[3:].reshape(3, 5, 3).transpose(0, 2, 1)
    np.testing.assert_allclose(fit.offset, x[0], rtol=1e-8)
    np.testing.assert_allclose(fit.feedthrough, x[1:3].T, rtol=1e-7, atol=1e-9 * np.abs(x).max())
    np.testing.assert_allclose(fit.input_coefficients, lags[:, :, :2], rtol=1e-7, atol=1e-9 * np.abs(x).max())
    np.testing.assert_allclose(fit.output_coefficients, lags[:, :, 2:], rtol=1e-7, atol=1e-9 * np.abs(x).max())
    assert (fit.n_rows, fit.n_parameters, fit.rank) == (897, 18, 18)
    np.testing.assert_allclose(fit.residual_covariance, left.T @ left / (897 - 18), rtol=1e-7)


def test_output_only_is_an_autoregression():
    rng = np.random.default_rng(9)
    y = np.zeros(4000)
    for k in range(2, 4000):
        y[k] = 1.5 * y[k - 1] - 0.8 * y[k - 2] + rng.standard_normal()
    fit = fit_observer(Record([], y, 0.1), order=2)
    assert fit.n_inputs == 0
    assert np.abs(fit.output_coefficients.ravel() - [1.5, -0.8]).max() < 4 / np.sqrt(4000)
    assert recover_markov(fit, n_lags=5).system.shape == (6, 1, 0)


def test_residual_covariance_is_that_of_the_noise():
    rng = np.random.default_rng(10)
    u, e = rng.standard_normal((2, 20_000))
    y = np.zeros(20_000)
    for k in range(1, 20_000):
        y[k] = 0.9 * y[k - 1] + 2.0 * u[k - 1] + 0.3 * e[k]
    fit = fit_observer(Record(u, y, 0.1), order=3)
    assert fit.residual_covariance[0, 0] == pytest.approx(0.09, rel=0.05)
    assert fit.method == "cholesky"


def test_a_ridge_shrinks_and_is_reported():
    system = random_system(np.random.default_rng(11))
    record = exact_record(system, 12)
    noisy = Record(record.inputs, with_noise(np.random.default_rng(13), record.outputs, 0.05), record.dt)
    plain, ridged = (fit_observer(noisy, order=10, ridge=ridge) for ridge in (0.0, 0.1))
    assert ridged.ridge == 0.1
    assert np.linalg.norm(ridged.output_coefficients) < np.linalg.norm(plain.output_coefficients)


class TestErrors:
    def test_order_too_large_says_what_would_do(self):
        rng = np.random.default_rng(0)
        record = Record(rng.standard_normal((1200, 2)), rng.standard_normal((1200, 2)), 0.1)
        text = (
            r"observer order 400 needs 2002 samples for 2 inputs and 2 outputs; the record has 1200\. "
            r"Use order <= 239 or a longer record\."
        )
        with pytest.raises(InsufficientDataError, match=text):
            fit_observer(record, order=400)
        assert fit_observer(record, order=239).order == 239

    def test_missing_samples_that_leave_too_little(self):
        rng = np.random.default_rng(1)
        y = rng.standard_normal(400)
        y[::12] = np.nan
        with pytest.raises(
            InsufficientDataError, match=r"order 11 needs 23 rows of 12 .* only 0 are left .* order <= \d"
        ):
            fit_observer(Record(rng.standard_normal(400), y, 0.1), order=11)

    @pytest.mark.parametrize("kind", ["input", "output"])
    def test_a_constant_channel_is_named(self, kind):
        moving, still = np.random.default_rng(2).standard_normal(100), np.full(100, 0.1)
        u, y = (still, moving) if kind == "input" else (moving, still)
        record = Record(u, y, 0.1, input_names=["force"], output_names=["tip"])
        with pytest.raises(InsufficientDataError, match=rf"every {kind} must move, but '(force|tip)' \(always 0.1\)"):
            fit_observer(record, order=2)

    def test_records_that_do_not_belong_together(self):
        rng = np.random.default_rng(3)
        u, y = rng.standard_normal((2, 100))
        first = Record(u, y, 0.1)
        with pytest.raises(
            InvalidDataError, match=r"same time step, but record 1 has 0\.2 s where record 0 has 0\.1 s"
        ):
            fit_observer([first, Record(u, y, 0.2)], order=2)
        with pytest.raises(InvalidDataError, match="same input names"):
            fit_observer([first, Record(u, y, 0.1, input_names=["other"])], order=2)
        with pytest.raises(InvalidDataError, match=r"okid\.Record .* but nothing was given"):
            fit_observer([], order=2)
        with pytest.raises(InvalidDataError, match=r"okid\.Record .* but NoneType was given"):
            fit_observer(None, order=2)

    def test_a_channel_of_which_only_the_last_digit_moves_is_constant(self):
        u, y = np.random.default_rng(4).standard_normal((2, 300))
        jitter = np.full(300, 0.1)
        jitter[::3] = np.nextafter(0.1, 1.0)
        with pytest.raises(InsufficientDataError, match=r"every input must move, but 'input_1' \(always 0\.1\)"):
            fit_observer(Record(np.column_stack([u, jitter]), y, 0.1), order=2)

    def test_values_whose_squares_are_no_numbers_are_named(self):
        u, y = np.random.default_rng(4).standard_normal((2, 100))
        with pytest.raises(InvalidDataError, match=r"'tip'.*larger unit"):
            fit_observer(Record(u, 1e170 * y, 0.1, output_names=["tip"]), order=2)

    @pytest.mark.parametrize("ridge", [-1.0, np.nan, True, "strong", [1.0]])
    def test_a_ridge_that_is_none(self, ridge):
        u, y = np.random.default_rng(4).standard_normal((2, 100))
        with pytest.raises(InvalidDataError, match="ridge must be a number of at least 0"):
            fit_observer(Record(u, y, 0.1), order=2, ridge=ridge)

    @pytest.mark.parametrize("order", [0, -1, 2.5, True, "best", None, np.nan, np.inf, [3]])
    def test_an_order_that_is_none(self, order):
        u, y = np.random.default_rng(4).standard_normal((2, 100))
        with pytest.raises(InvalidDataError, match="whole number"):
            fit_observer(Record(u, y, 0.1), order=order)


class TestWarnings:
    def test_an_input_that_moves_in_part_of_the_band_is_not_passed_over(self):
        rng = np.random.default_rng(5)
        system = random_system(rng, n_inputs=1)
        spectrum = np.fft.rfft(rng.standard_normal(4096))
        spectrum[int(0.6 * spectrum.size) :] = 0.0
        u = np.fft.irfft(spectrum)[:, np.newaxis]
        record = Record(u, simulate(system, u), system.dt)
        with pytest.warns(IdentificationWarning, match="inputs do not excite enough for observer order 30") as warned:
            fit_observer(record, order=30)
        assert warned[0].filename == __file__

    @pytest.mark.parametrize("ridge", [0.0, 1e-10])
    def test_the_condition_number_is_that_of_the_inputs_lags_less_their_means(self, ridge):
        rng = np.random.default_rng(15)
        u = rng.standard_normal(2000)
        u = np.column_stack([u + 7.0, u + 3e-5 * rng.standard_normal(2000)])
        y = np.convolve(u[:, 0], 0.9 ** np.arange(50))[:2000] + 0.1 * rng.standard_normal(2000)
        record = Record(u, y, 0.1)
        with pytest.warns(IdentificationWarning, match="do not excite enough") as warned:
            fit = fit_observer(record, order=4, ridge=ridge)
        lags = np.hstack([u[4 - lag : 2000 - lag] / fit.input_scale for lag in range(5)])
        extra = np.sqrt(ridge * len(lags) * np.repeat(np.arange(1.0, 6.0), 2))
        values = np.linalg.svd(np.vstack([lags - lags.mean(axis=0), np.diag(extra)]), compute_uv=False)
        said = re.search(r"their 5 lags have condition number ([0-9.e+]+)", str(warned[0].message)).group(1)
        assert said == f"{values[0] / values[-1]:.1e}"

    def test_an_input_twice_has_the_largest_condition_number_that_doubles_hold(self):
        u, y = np.random.default_rng(16).standard_normal((2, 500))
        with pytest.warns(IdentificationWarning, match="condition number 6.7e.07"):
            fit_observer(Record(np.column_stack([u, u]), y, 0.1), order=1)

    def test_outputs_that_repeat_each_other_are_reported(self):
        rng = np.random.default_rng(6)
        u = rng.standard_normal(2000)
        y = np.convolve(u, 0.9 ** np.arange(50))[:2000] + 0.1 * rng.standard_normal(2000)
        with pytest.warns(IdentificationWarning, match="nearly dependent") as warned:
            fit_observer(Record(u, np.column_stack([y, 2 * y]), 0.1), order=5)
        assert warned[0].filename == __file__
        assert "12 of 17 directions kept" in str(warned[0].message)

    def test_good_data_give_none(self):
        system = random_system(np.random.default_rng(7))
        record = exact_record(system, 8)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            fit_observer(record, order=30)
            for share in (1e-6, 1e-2, 0.3):
                noisy = with_noise(np.random.default_rng(9), record.outputs, share)
                fit_observer(Record(record.inputs, noisy, record.dt), order=30)
