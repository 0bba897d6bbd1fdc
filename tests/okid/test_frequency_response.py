"""Frequency responses: the type, their estimate from records, and the pulse response behind them."""

import numpy as np
import pytest
from scipy.signal import fftconvolve, lfilter, windows

from okid.errors import InsufficientDataError, InvalidDataError
from okid.frequency_response import FrequencyResponse, estimate_response, pulse_response, window_autocorrelation
from okid.record import Record

DT = 0.01
POLES = np.array([0.97 * np.exp(0.4j), 0.99 * np.exp(1.3j)])
RESIDUES = np.random.default_rng(5).standard_normal((2, 3, 2)) + 1j * np.random.default_rng(6).standard_normal(
    (2, 3, 2)
)
FEEDTHROUGH = np.array([[0.5, 0.0], [0.0, -1.0], [0.2, 0.3]])


def true_pulse(n_lags):
    lag = np.arange(1, n_lags)
    h = 2 * np.einsum("rqi,rk->kqi", RESIDUES, POLES[:, None] ** (lag - 1)).real
    return np.concatenate([FEEDTHROUGH[None], h])


def exact_table(n_samples):
    z = np.exp(2j * np.pi * np.arange(n_samples // 2 + 1) / n_samples)
    parts = [
        r[None] / (z - p)[:, None, None]
        for rs, ps in ((RESIDUES, POLES), (RESIDUES.conj(), POLES.conj()))
        for r, p in zip(rs, ps, strict=True)
    ]
    return FrequencyResponse(FEEDTHROUGH + sum(parts), np.arange(z.size) / (n_samples * DT), window="periodic")


def record_of(n_samples, rng, noise=0.0):
    inputs = rng.standard_normal((n_samples, 2))
    pulse = true_pulse(2500)
    outputs = np.array([sum(fftconvolve(inputs[:, i], pulse[:, q, i])[:n_samples] for i in range(2)) for q in range(3)])
    outputs += noise * outputs.std(axis=1, keepdims=True) * rng.standard_normal(outputs.shape)
    return Record(inputs, outputs.T, DT, output_units=["m"] * 3, input_units=["N"] * 2)


def test_whole_periods_give_the_wrapped_pulse_response_exactly():
    n = 256
    found = pulse_response(exact_table(n))
    long = true_pulse(40 * n)
    wrapped = np.add.reduce(long.reshape(40, n, 3, 2))
    assert found.dt == pytest.approx(DT, rel=1e-12)
    np.testing.assert_allclose(found.system, wrapped, atol=1e-10)


def test_an_exponential_window_is_taken_back_exactly():
    tau = 0.9
    n = 512
    weight = np.exp(-DT * np.arange(n) / tau)
    table = np.fft.rfft(true_pulse(n) * weight[:, None, None], axis=0)
    response = FrequencyResponse(
        table, np.arange(n // 2 + 1) / (n * DT), window="exponential", window_time_constant=tau
    )
    found = pulse_response(response)
    assert found.n_lags + 1 == int(np.ceil(tau * np.log(4) / DT))
    np.testing.assert_allclose(found.system, true_pulse(n)[: found.n_lags + 1], atol=1e-10)


@pytest.mark.parametrize("window", ["hann", "hamming", "flattop", "uniform"])
def test_the_window_of_the_blocks_is_divided_out(window):
    n = 128
    weight = {"hann": windows.hann, "hamming": windows.hamming, "flattop": windows.flattop, "uniform": windows.boxcar}[
        window
    ](n, sym=False)
    by_hand = np.array([(weight[: n - k] * weight[k:]).sum() for k in range(n)]) / (weight**2).sum()
    table = np.fft.rfft(true_pulse(n) * by_hand[:, None, None], axis=0)
    response = FrequencyResponse(table, np.arange(n // 2 + 1) / (n * DT), window=window)
    np.testing.assert_allclose(window_autocorrelation(response, n, window=window), by_hand, atol=1e-12)
    found = pulse_response(response)
    assert by_hand[found.n_lags] > 0.25 >= by_hand[found.n_lags + 1]
    np.testing.assert_allclose(found.system, true_pulse(n)[: found.n_lags + 1], atol=1e-10)


def test_blocks_of_records_are_what_the_window_says_in_the_mean():
    record = record_of(150_000, np.random.default_rng(1))
    table = estimate_response(record, n_samples=256, window="hann")
    found = pulse_response(table)
    error = np.abs(found.system - true_pulse(found.n_lags + 1)).max() / np.abs(true_pulse(100)).max()
    assert error < 0.05
    plain = np.abs(pulse_response(table, window="periodic").system[:100] - true_pulse(100)).max()
    assert plain > 5 * error


def test_estimators_bracket_the_response_when_both_sides_are_noisy():
    rng = np.random.default_rng(2)
    force = rng.standard_normal(60_000)
    truth = lfilter([0.0, 1.0], [1.0, -0.5], force)
    noisy = Record(
        force + 0.5 * rng.standard_normal(force.size), truth + 0.5 * truth.std() * rng.standard_normal(force.size), DT
    )
    gains = {
        kind: np.abs(estimate_response(noisy, estimator=kind, n_samples=64).response[8, 0, 0])
        for kind in ("H1", "H2", "Hv")
    }
    true = abs(1 / (np.exp(2j * np.pi * 8 / 64) - 0.5))
    assert gains["H1"] < 0.9 * true < 1.1 * true < gains["H2"]
    assert gains["Hv"] == pytest.approx(np.sqrt(gains["H1"] * gains["H2"]), rel=1e-9)
    clean = Record(force, truth, DT)
    for kind in ("H1", "H2", "Hv"):
        got = estimate_response(clean, estimator=kind, n_samples=64).response[8, 0, 0]
        assert abs(got) == pytest.approx(true, rel=0.02)


def test_coherence_says_how_much_is_noise():
    table = estimate_response(record_of(300_000, np.random.default_rng(3), noise=1.0), n_samples=4096)
    assert table.coherence.shape == (2049, 3)
    assert table.coherence.min() < 0.2
    assert table.coherence.max() > 0.98
    assert table.n_averages == 145
    one = estimate_response(record_of(4096, np.random.default_rng(3)), n_samples=2048, overlap=0.0)
    assert one.n_averages == 2
    assert one.coherence is None  # as many blocks as inputs explain everything


def test_hits_with_an_exponential_window_give_the_pulse_response():
    n, tau = 400, 1.2
    force = np.zeros((n, 1))
    force[3:6, 0] = [1.0, 2.0, 0.5]
    pulse = true_pulse(n)[:, :, :1]
    outputs = np.stack([np.convolve(force[:, 0], pulse[:, q, 0])[:n] for q in range(3)], axis=1)
    table = estimate_response(Record(force, outputs, DT), window="exponential", window_time_constant=tau)
    assert table.n_averages == 1
    found = pulse_response(table)
    np.testing.assert_allclose(found.system[:100], pulse[:100], atol=2e-2 * np.abs(pulse).max())


def test_a_table_above_zero_needs_dt_and_one_off_the_grid_is_refused():
    table = exact_table(256)
    above = FrequencyResponse(table.response[20:], table.frequencies[20:], window="periodic")
    with pytest.raises(InvalidDataError, match=r"begins at 7\.8125 Hz.*pass dt"):
        pulse_response(above)
    assert pulse_response(above, dt=DT).n_lags == 255
    with pytest.raises(InvalidDataError, match="do not belong together"):
        pulse_response(above, dt=0.02)
    moved = table.frequencies.copy()
    moved[7] += 0.1 * moved[1]
    with pytest.raises(InvalidDataError, match="line 7"):
        pulse_response(FrequencyResponse(table.response, moved, window="hann"))
    with pytest.raises(InvalidDataError, match="window of these responses is unknown"):
        pulse_response(FrequencyResponse(table.response, table.frequencies))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"coherence": 90 * np.ones((3, 1))}, "not in percent"),
        ({"coherence": np.ones((2, 1))}, "coherence must have shape"),
        ({"window": "hanning"}, "window must be one of"),
        ({"window": "exponential"}, "window_time_constant"),
        ({"n_averages": 0}, "n_averages"),
        ({"frequencies": [0.0, 2.0, 1.0]}, "increase"),
        ({"response": [1.0, np.inf, 0.0]}, "infinite"),
        ({"response": [np.nan] * 3}, "holds no number"),
        ({"output_names": ["input_0"]}, "unique"),
    ],
)
def test_what_cannot_be_a_table_is_refused(change, words):
    given = {"response": [1.0, 0.5j, 0.1], "frequencies": [0.0, 1.0, 2.0], **change}
    with pytest.raises(InvalidDataError, match=words):
        FrequencyResponse(given.pop("response"), given.pop("frequencies"), **given)


def test_estimates_refuse_what_they_cannot_answer():
    record = record_of(600, np.random.default_rng(1))
    with pytest.raises(InvalidDataError, match="H2 is defined for one input"):
        estimate_response(record, estimator="H2")
    with pytest.raises(InvalidDataError, match="the period of the input"):
        estimate_response(record, window="periodic")
    with pytest.raises(InsufficientDataError, match="at least 2 blocks"):
        estimate_response(record, n_samples=600)
    with pytest.raises(InvalidDataError, match="at least one input"):
        estimate_response(Record([], record.outputs, DT))
