import numpy as np
import pytest
import scipy.signal
from containers import realisation_of
from signals import random_inputs, with_noise
from systems import markov, random_system, simulate

from era.realisation import Realisation
from modal.modes.extraction import extract_modes
from modal.modes.response_synthesis import continuous_residue, frf, measured_frf, modal_frf
from okid.errors import InsufficientDataError, InvalidDataError
from okid.record import Record


@pytest.fixture
def truth():
    return random_system(np.random.default_rng(0), n_real_poles=1)


@pytest.fixture
def frequencies():
    return np.linspace(0, 50, 41)


def test_it_is_the_transfer_matrix_line_by_line(truth, frequencies):
    response = frf(realisation_of(truth), frequencies)
    for f, line in zip(frequencies, response, strict=True):
        z = np.exp(2j * np.pi * f * truth.dt)
        expected = truth.C @ np.linalg.solve(z * np.eye(truth.order) - truth.A, truth.B) + truth.D
        np.testing.assert_allclose(line, expected, rtol=1e-10, atol=1e-12)


def test_it_is_the_fourier_sum_of_the_pulse_response(frequencies):
    truth = random_system(np.random.default_rng(4), damping_range=(0.03, 0.06))
    h = markov(truth, 4000)
    phase = np.exp(-2j * np.pi * truth.dt * np.outer(frequencies, np.arange(4001)))
    expected = np.einsum("fk,kqm->fqm", phase, h)
    np.testing.assert_allclose(frf(realisation_of(truth), frequencies), expected, rtol=1e-7, atol=1e-9)


def test_repeated_poles_do_no_harm():
    A = np.array([[0.5, 1.0], [0.0, 0.5]])
    model = Realisation(A, np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]]), np.zeros((1, 1)), 0.1)
    z = np.exp(2j * np.pi * 1.3 * 0.1)
    assert frf(model, [1.3])[0, 0, 0] == pytest.approx(1 / (z - 0.5) ** 2)


def test_order_zero_is_the_feedthrough():
    D = np.array([[2.0, 3.0]])
    model = Realisation(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), D, 0.1)
    np.testing.assert_array_equal(frf(model, [0.0, 1.0]), [D, D])


def test_modes_add_up_to_the_whole(truth, frequencies):
    realisation = realisation_of(truth)
    parts = modal_frf(extract_modes(realisation).modes, frequencies, dt=truth.dt)
    assert parts.shape == (4, 41, 3, 2)
    np.testing.assert_allclose(parts.sum(axis=0) + truth.D, frf(realisation, frequencies), rtol=1e-9, atol=1e-10)


def test_no_modes_give_no_part(frequencies):
    assert modal_frf((), frequencies, dt=0.01).shape[:2] == (0, 41)


def test_continuous_residues_are_those_of_the_sampled_system():
    """x'' + 2 zeta w x' + w^2 x = F, zero-order hold: displacement residue 1 / (2 j w_d), exactly."""
    omega, zeta, dt = 2 * np.pi * 3, 0.05, 0.02
    A, B = np.array([[0, 1], [-(omega**2), -2 * zeta * omega]]), np.array([[0.0], [1.0]])
    block = np.zeros((3, 3))
    block[:2] = np.hstack([A, B]) * dt
    exact = scipy.linalg.expm(block)
    model = Realisation(exact[:2, :2], exact[:2, 2:], np.array([[1.0, 0.0]]), np.zeros((1, 1)), dt)
    (mode,) = extract_modes(model)
    expected = 1 / (2j * omega * np.sqrt(1 - zeta**2))
    assert continuous_residue(mode, dt)[0, 0] == pytest.approx(expected, rel=1e-9)


def test_the_continuous_residue_of_an_integrator():
    """x' = 2 F: B = 2 dt, residue 2."""
    model = Realisation(np.eye(1), np.full((1, 1), 2 * 0.02), np.eye(1), np.zeros((1, 1)), 0.02)
    (mode,) = extract_modes(model)
    assert continuous_residue(mode, 0.02)[0, 0] == pytest.approx(2)


# --- measured ---------------------------------------------------------------------------------------------------------


def record_of(truth, seed, n_samples=20_000, noise=0.0, kind="white"):
    rng = np.random.default_rng(seed)
    inputs = random_inputs(rng, n_samples, truth.n_inputs, kind=kind)
    outputs = simulate(truth, inputs)
    return Record(inputs, with_noise(rng, outputs, noise) if noise else outputs, truth.dt)


def test_it_is_scipys_welch_quotient_for_one_input():
    truth = random_system(np.random.default_rng(1), n_inputs=1)
    record = record_of(truth, 2, 6000, noise=0.1)
    estimate = measured_frf(record, n_per_segment=512)
    options = {"fs": 100.0, "window": "hann", "nperseg": 512, "noverlap": 256, "detrend": "constant"}
    u = record.inputs[:, 0]
    for i, y in enumerate(record.outputs.T):
        f, cross = scipy.signal.csd(u, y, **options)
        power = scipy.signal.welch(u, **options)[1]
        coherence = scipy.signal.coherence(u, y, **options)[1]
        np.testing.assert_allclose(estimate.frequencies, f)
        np.testing.assert_allclose(estimate.frf[:, i, 0], cross / power, rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(estimate.ordinary_coherence[:, i, 0], coherence, rtol=1e-8)
        np.testing.assert_allclose(estimate.multiple_coherence[:, i], coherence, rtol=1e-8)


def test_several_inputs_are_told_apart_as_scipys_spectra_say():
    truth = random_system(np.random.default_rng(1), n_inputs=2)
    record = record_of(truth, 3, 6000, noise=0.1)
    mixed = Record(record.inputs @ [[1.0, 0.6], [0.0, 1.0]], record.outputs, record.dt)
    estimate = measured_frf(mixed, n_per_segment=512)
    options = {"fs": 100.0, "window": "hann", "nperseg": 512, "detrend": "constant"}
    u, y = mixed.inputs.T, mixed.outputs.T
    uu = np.array([[scipy.signal.csd(a, b, **options)[1] for b in u] for a in u])
    uy = np.array([[scipy.signal.csd(a, b, **options)[1] for b in y] for a in u])
    for f in range(1, 256, 17):
        response = np.linalg.solve(uu[:, :, f], uy[:, :, f]).T
        np.testing.assert_allclose(estimate.frf[f], response, rtol=1e-7)


@pytest.mark.parametrize("kind", ["white", "coloured"])
def test_it_finds_the_true_response_where_resonances_are_wider_than_a_line(kind):
    truth = random_system(np.random.default_rng(4), damping_range=(0.1, 0.15))
    estimate = measured_frf(record_of(truth, 5, kind=kind), n_per_segment=1024)
    exact = frf(realisation_of(truth), estimate.frequencies)
    inside = slice(5, 500)
    assert np.linalg.norm((estimate.frf - exact)[inside]) < 0.03 * np.linalg.norm(exact[inside])
    assert np.median(estimate.multiple_coherence[inside]) > 0.999
    assert np.median(estimate.ordinary_coherence[inside]) < 0.9


def test_noise_shows_in_the_coherence():
    truth = random_system(np.random.default_rng(4), damping_range=(0.03, 0.06))
    clean, noisy = (measured_frf(record_of(truth, 5, noise=share)) for share in (0.0, 1.0))
    assert np.median(noisy.multiple_coherence) < 0.8 < np.median(clean.multiple_coherence)


def test_missing_samples_and_other_records_add_segments_but_never_mix_them():
    truth = random_system(np.random.default_rng(1))
    first, second = record_of(truth, 2, 3000, noise=0.1), record_of(truth, 3, 2000, noise=0.1)
    holed = np.array(np.vstack([first.outputs, second.outputs]))
    inputs = np.vstack([first.inputs, second.inputs])
    apart = measured_frf([first.samples(0, 2999), second.samples(1)], n_per_segment=256)
    holed[2999:3001, 1] = np.nan
    one = measured_frf(Record(inputs, holed, truth.dt), n_per_segment=256)
    assert one.n_averages == apart.n_averages == (2999 - 256) // 128 + 1 + (1999 - 256) // 128 + 1
    np.testing.assert_allclose(one.frf, apart.frf)


def test_a_unit_does_not_change_the_coherence():
    truth = random_system(np.random.default_rng(1))
    record = record_of(truth, 2, 4000, noise=0.1)
    drive, units = np.array([1e6, 1e-6]), np.array([1e-6, 1.0, 1e6])
    plain = measured_frf(record, n_per_segment=256)
    other = measured_frf(Record(record.inputs * drive, record.outputs * units, record.dt), n_per_segment=256)
    np.testing.assert_allclose(other.multiple_coherence, plain.multiple_coherence, rtol=1e-9)
    np.testing.assert_allclose(other.frf, plain.frf * units[:, None] / drive, rtol=1e-9)


def test_inputs_that_are_one_and_the_same_cannot_be_told_apart():
    record = record_of(random_system(np.random.default_rng(1), n_inputs=1), 2, 4000)
    doubled = Record(np.repeat(record.inputs, 2, axis=1), record.outputs, record.dt)
    assert np.isnan(measured_frf(doubled).frf).all()


def test_a_line_without_input_power_is_not_a_number():
    record = record_of(random_system(np.random.default_rng(1), n_inputs=1), 2, 4096)
    sine = np.sin(2 * np.pi * 32 * np.arange(4096) / 512)
    estimate = measured_frf(Record(sine, record.outputs, record.dt), n_per_segment=512)
    assert np.isfinite(estimate.frf[32]).all()
    assert np.isnan(estimate.frf[100:]).all()


def test_the_automatic_segment_leaves_enough_averages():
    record = record_of(random_system(np.random.default_rng(1)), 2, 4000)
    estimate = measured_frf(record)
    assert 8 <= estimate.n_averages <= 40


def test_without_inputs_there_is_no_frequency_response():
    with pytest.raises(InvalidDataError, match="at least one input"):
        measured_frf(Record([], np.ones((100, 2)), 0.01))
    with pytest.raises(InvalidDataError, match="a sequence of them is needed, but nothing was given"):
        measured_frf([])


def test_too_few_segments_are_refused_with_their_number():
    record = record_of(random_system(np.random.default_rng(1)), 2, 600)
    with pytest.raises(InsufficientDataError, match="at least 3 segments; the records hold 1 of 512"):
        measured_frf(record, n_per_segment=512)


def test_records_of_different_channels_or_time_steps_are_refused():
    record = record_of(random_system(np.random.default_rng(1)), 2, 600)
    with pytest.raises(InvalidDataError, match=r"same time step, but record 1 has 0\.02 s"):
        measured_frf([record, Record(record.inputs, record.outputs, 0.02)])
