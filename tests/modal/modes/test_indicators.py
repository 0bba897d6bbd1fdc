from dataclasses import replace

import numpy as np
import pytest
import scipy
from systems import markov, modal_system, random_system
from textbook_modal import textbook_era, textbook_indicators

from era.realisation import HankelFactors, Realisation
from modal.modes.extraction import (
    amplitude_coherence,
    evaluate,
    extended_amplitude_coherence,
    extract_modes,
    mean_phase_deviation,
    mode_singular_values,
    phase_collinearity,
)
from modal.modes.modal_form import modal_basis

NAMES = ("amplitude_coherence", "emac_output", "emac_input", "emac", "phase_collinearity", "cmi", "msv")


def realisation_from(model, dt=0.01):
    factors = HankelFactors(
        observability=model.observability,
        controllability=model.controllability,
        n_block_rows=model.n_rows,
        n_block_columns=model.n_columns,
        input_scale=np.ones(model.B.shape[1]),
        output_scale=np.ones(model.C.shape[0]),
        observer_order=None,
    )
    D = np.zeros((model.C.shape[0], model.B.shape[1]))
    return Realisation(model.A, model.B, model.C, D, dt, factors=factors)


def noisy_markov(seed, share, n_lags=80, **options):
    rng = np.random.default_rng(seed)
    h = markov(random_system(rng, **options), n_lags)
    return h + share * h.std() * rng.standard_normal(h.shape)


def matched(model, decay_limit):
    """Ours and the textbook's entry of the same pole, pole after pole."""
    textbook = textbook_indicators(model)
    ours = extract_modes(realisation_from(model), decay_limit=decay_limit)
    for mode in ours:
        pole = np.exp(mode.pole * 0.01)
        yield mode, min(textbook, key=lambda entry: abs(entry["pole"] - pole))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("share", [0.0, 0.01, 0.3])
@pytest.mark.parametrize(("n_rows", "n_columns"), [(40, 40), (20, 60)])
def test_they_are_the_textbooks_on_the_same_markov_parameters(seed, share, n_rows, n_columns):
    order = 6 if share == 0 else 20
    model = textbook_era(noisy_markov(seed, share), n_rows, n_columns, order)
    count = 0
    for mode, entry in matched(model, decay_limit=0.0):
        count += 1
        for name in NAMES:
            assert getattr(mode, name) == pytest.approx(entry[name], abs=1e-8), name
    assert count == len(textbook_indicators(model))


def test_modes_that_have_not_died_out_are_compared_at_the_last_block_by_default_too():
    kept = died = 0
    for mode, entry in matched(textbook_era(noisy_markov(5, 0.3, n_lags=160), 80, 80, 60), decay_limit=0.1):
        if abs(entry["pole"]) ** 79 >= 0.1:
            kept += 1
            assert mode.emac == pytest.approx(entry["emac"], abs=1e-8)
        elif abs(entry["pole"]) < 1:
            died += abs(mode.emac_output - entry["emac_output"]) > 1e-8
    assert kept > 2
    assert died > 2


def test_a_mode_that_has_died_out_is_compared_where_it_still_moves():
    truth = modal_system(np.random.default_rng(8), frequencies=[8, 21], damping_ratios=[0.3, 0.01])
    h = markov(truth, 160)
    h += 1e-5 * h.std() * np.random.default_rng(1).standard_normal(h.shape)
    realisation = realisation_from(textbook_era(h, 80, 80, 4))
    heavy = next(mode for mode in extract_modes(realisation, decay_limit=0.1) if mode.damping_ratio > 0.1)
    textbook = next(mode for mode in extract_modes(realisation) if mode.damping_ratio > 0.1)
    assert heavy.emac > 0.99
    assert textbook.emac < 0.9


def test_noise_poles_are_below_one_because_the_data_are_asked_and_not_the_model():
    """Rebuilt from (A, B, C), as in mdof, every indicator would be 1 for every pole."""
    model = textbook_era(noisy_markov(2, 0.3), 40, 40, 20)
    realisation = realisation_from(model)
    truth = random_system(np.random.default_rng(2))
    rebuilt = realisation_from(
        replace(
            model,
            observability=np.vstack([model.C @ np.linalg.matrix_power(model.A, k) for k in range(40)]),
            controllability=np.hstack([np.linalg.matrix_power(model.A, k) @ model.B for k in range(40)]),
        )
    )
    noise = 0
    for mode, fault in zip(extract_modes(realisation), extract_modes(rebuilt), strict=True):
        if min(abs(mode.pole - truth.poles)) > 0.1 * abs(mode.pole):
            noise += 1
            for name in ("amplitude_coherence", "emac_output", "emac_input", "emac", "cmi"):
                assert getattr(mode, name) < 0.99, name
        assert fault.amplitude_coherence == pytest.approx(1, abs=1e-6)
        assert fault.emac == pytest.approx(1, abs=1e-6)
    assert noise > 4


def test_the_unit_of_a_channel_does_not_change_coherence_or_emac():
    h = noisy_markov(3, 0.1)
    output_scale, input_scale = np.array([1e3, 1.0, 1e-4]), np.array([20.0, 0.1])
    model = textbook_era(h, 40, 40, 10)
    plain = realisation_from(model)
    other = replace(
        plain,
        B=plain.B / input_scale,
        C=plain.C * output_scale[:, None],
        factors=replace(plain.factors, input_scale=input_scale, output_scale=output_scale),
    )
    for first, second in zip(extract_modes(plain), extract_modes(other), strict=True):
        for name in ("amplitude_coherence", "emac_output", "emac_input", "emac"):
            assert getattr(first, name) == pytest.approx(getattr(second, name), abs=1e-12)
        # the others belong to the published shape
        assert second.phase_collinearity == pytest.approx(float(phase_collinearity(second.shape[:, None])[0]))
        assert second.mpd == pytest.approx(float(mean_phase_deviation(second.shape[:, None])[0]))


# --- published numbers ------------------------------------------------------------------------------------------------

PYYETI = """
 2  1.37239  0.02610 0.833 0.927 0.990 1.000
 3  4.61109  0.08532 0.268 -     0.588 1.000
 4  6.48926  0.58299 0.257 -     0.549 1.000
 5  7.39420  0.07075 0.853 0.787 0.994 1.000
 6  9.54517  0.02778 0.203 0.124 0.007 1.000
 7 11.60875  0.02303 0.275 -     0.825 1.000
 8 13.84752  0.05013 1.000 0.698 0.997 1.000
 9 15.56279  0.01595 0.248 0.384 0.476 1.000
10 17.63534 -0.01207 0.151 -     0.105 1.000
11 20.28144  0.00245 0.264 0.669 0.952 1.000
12 21.84685  0.02069 0.208 0.176 0.376 1.000
13 24.08700  0.02537 0.258 0.141 0.584 1.000
14 26.42550  0.01341 0.258 0.083 0.394 1.000
15 28.37983  0.03076 0.232 -     0.827 1.000
16 29.67884  0.02676 0.279 -     0.116 1.000
17 32.23488  0.01671 0.216 0.000 0.696 1.000
18 34.27749  0.00929 0.296 0.204 0.844 1.000
19 36.09656  0.01530 0.274 -     0.631 1.000
20 38.51809  0.01280 0.232 -     0.129 1.000
21 40.13913  0.03768 0.224 -     0.370 1.000
22 42.11085  0.00934 0.247 0.001 0.790 1.000
23 44.01415  0.02820 0.264 -     0.189 1.000
24 46.19429  0.01336 0.290 0.000 0.254 1.000
25 48.18869  0.01835 0.252 -     0.041 1.000
"""
"""Mode, frequency, damping, MSV, EMAC, MPC, MAC: documentation of pyYeti's `era.ERA`, second example (3 masses, noise
of seed 1). Left out: mode 1 (two real poles printed as a pair) and, marked "-", the EMAC of modes that pyYeti
compares at the row of another mode: its `eigs_continuous` is not reordered with `eigs`, and done so here the printed
values of modes 6 to 25 come out to all digits. Mode 5 is that of its second table, where the row is its own."""


def pyyeti_example():
    """Free velocities of three masses after a unit velocity of each, plus noise, exactly as in that documentation."""
    stiffness = np.array(
        [[4185.1498, 576.6947, 3646.8923], [576.6947, 2104.9252, -28.0450], [3646.8923, -28.0450, 3451.5583]]
    )
    damping = np.array(
        [
            [4.96765646, 0.97182432, 4.0162425],
            [0.97182432, 6.71403672, -0.86138453],
            [4.0162425, -0.86138453, 4.28850828],
        ]
    )
    step = scipy.linalg.expm(0.01 * np.block([[np.zeros((3, 3)), np.eye(3)], [-stiffness, -damping]]))
    state, velocities = np.r_[np.zeros(3), np.ones(3)], []
    for _ in range(100):
        velocities.append(state[3:])
        state = step @ state
    exact = np.array(velocities).T
    noise = np.random.RandomState(1).randn(*exact.shape)
    return exact.T, (exact + 0.05 * noise).T


def as_markov(response):
    """pyYeti's first sample is C B; a last one beyond the record counts zero."""
    return np.concatenate([np.zeros((1, 3)), response, np.zeros((1, 3))])[:, :, None]


def test_published_table_of_a_noisy_three_mass_example():
    _, noisy = pyyeti_example()
    # the published model shifts within 100 samples: its last block is sample 99, so 50 rows need no sample beyond
    modes = extract_modes(realisation_from(textbook_era(as_markov(noisy), 50, 50, 50))).modes
    checked = 0
    for line in PYYETI.split("\n")[1:-1]:
        _, frequency, damping, msv, emac, mpc, coherence = line.split()
        mode = min(modes, key=lambda mode: abs(mode.frequency - float(frequency)))
        assert mode.frequency == pytest.approx(float(frequency), abs=1e-5)
        assert mode.damping_ratio == pytest.approx(float(damping), abs=1e-5)
        assert mode.msv == pytest.approx(float(msv), abs=6e-4)
        assert mode.phase_collinearity == pytest.approx(float(mpc), abs=6e-4)
        assert mode.amplitude_coherence == pytest.approx(float(coherence), abs=6e-4)
        if emac != "-":
            assert mode.emac == pytest.approx(float(emac), abs=6e-4)
            checked += 1
    assert checked == 13


def test_published_table_of_the_exact_three_mass_example():
    """Same source, first example: 1.33603, 7.39083, 13.79671 Hz; 0.02, 0.075, 0.05; MSV 0.817, 0.839, 1."""
    exact, _ = pyyeti_example()
    modes = extract_modes(realisation_from(textbook_era(as_markov(exact), 50, 50, 6))).modes
    np.testing.assert_allclose([mode.frequency for mode in modes], [1.33603, 7.39083, 13.79671], atol=1e-4)
    np.testing.assert_allclose([mode.damping_ratio for mode in modes], [0.02, 0.075, 0.05], atol=1e-4)
    np.testing.assert_allclose([mode.msv for mode in modes], [0.817, 0.839, 1.0], atol=6e-4)


# --- one by one -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("shape", "value"),
    [
        ([1, 1, 1], 1.0),
        ([1, -2, 0.5], 1.0),
        ([1, 1j], 0.0),
        ([2, 1j], ((4 - 1) / 5) ** 2),
        ([1 + 1j, -2 - 2j], 1.0),
        ([3j], 1.0),
    ],
)
def test_phase_collinearity_by_hand(shape, value):
    assert phase_collinearity(np.array(shape, dtype=complex)[:, None])[0] == pytest.approx(value, abs=1e-14)


@pytest.mark.parametrize("n_outputs", [2, 3, 8])
def test_phase_collinearity_of_random_shapes_has_the_known_mean(n_outputs):
    """2 / (q + 1), THEORY 5.8; 40 000 shapes, so the standard error is below 0.002."""
    rng = np.random.default_rng(0)
    shapes = rng.standard_normal((n_outputs, 40_000)) + 1j * rng.standard_normal((n_outputs, 40_000))
    assert phase_collinearity(shapes).mean() == pytest.approx(2 / (n_outputs + 1), abs=0.006)


def test_mean_phase_deviation_is_that_of_the_fitted_line():
    """The line by the singular value decomposition of [Re, Im], Reynders et al. 2012."""
    rng = np.random.default_rng(1)
    shapes = rng.standard_normal((5, 20)) + 1j * rng.standard_normal((5, 20))
    for shape, ours in zip(shapes.T, mean_phase_deviation(shapes), strict=True):
        direction = np.linalg.svd(np.column_stack([shape.real, shape.imag]))[2][0]
        angles = np.arccos(np.abs(shape.real * direction[0] + shape.imag * direction[1]) / np.abs(shape))
        expected = np.degrees((np.abs(shape) * angles).sum() / np.abs(shape).sum())
        assert ours == pytest.approx(expected, abs=1e-6)


def test_shapes_of_zeros_are_not_known():
    assert np.isnan(phase_collinearity(np.zeros((3, 1)))).all()
    assert np.isnan(mean_phase_deviation(np.zeros((3, 1)))).all()


def test_mode_singular_values_of_unstable_and_undamped_poles_do_not_overflow():
    A = np.diag([1.5, 1.0, 0.5])
    basis = modal_basis(Realisation(A, np.ones((3, 1)), np.ones((1, 3)), np.zeros((1, 1)), 1.0))
    values = mode_singular_values(basis, n_steps=40)
    expected = np.array([np.sqrt(sum(pole**k for k in range(40))) for pole in basis.poles.real])
    np.testing.assert_allclose(values, expected / expected.max(), rtol=1e-12)
    assert np.isfinite(mode_singular_values(basis, n_steps=100_000)).all()


def test_an_unstable_pole_in_a_long_hankel_matrix_gives_numbers():
    h = noisy_markov(4, 0.5, n_lags=80)
    model = textbook_era(h, 40, 40, 24)
    realisation = realisation_from(replace(model, A=3.0 * model.A))
    values = evaluate(realisation.factors, modal_basis(realisation))
    assert np.isfinite(values.amplitude_coherence).all()
    assert ((values.emac >= 0) & (values.emac <= 1)).all()


def test_one_block_alone_has_nothing_to_compare():
    truth = random_system(np.random.default_rng(0), n_modes=1, n_outputs=3)
    model = textbook_era(markov(truth, 40), 1, 30, 2)
    realisation = realisation_from(model)
    output, into = extended_amplitude_coherence(realisation.factors, modal_basis(realisation))
    assert np.isnan(output).all()
    assert np.isfinite(into).all()
    model = textbook_era(markov(truth, 40), 30, 1, 2)
    realisation = realisation_from(model)
    assert np.isnan(amplitude_coherence(realisation.factors, modal_basis(realisation))).all()


@pytest.mark.parametrize(("n_columns", "known"), [(1, False), (2, True)])
def test_two_blocks_of_columns_are_enough_to_compare_and_one_pole_enough_to_judge(n_columns, known):
    """One real pole: its exact row of the block Hankel matrix is the geometric sequence itself."""
    h = 0.7 ** np.arange(-1.0, 12.0)[:, np.newaxis, np.newaxis]
    model = textbook_era(h, 4, n_columns, 1)
    found = realisation_from(model)
    coherence = amplitude_coherence(found.factors, modal_basis(found))
    assert coherence.shape == (1,)
    assert np.isnan(coherence[0]) != known
    if known:
        assert coherence[0] == pytest.approx(1.0, abs=1e-12)
