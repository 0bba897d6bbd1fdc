from types import SimpleNamespace

import numpy as np
import pytest
import scipy
from scipy.signal import chirp
from signals import random_inputs
from structures import random_record
from systems import initial_state, modal_system, simulate

from era.simulation import simulate as free_simulation
from modal.estimation.cross_validation import Trial
from modal.identification.final_model import fit_all_rows, with_deviations
from modal.identification.noise_model import _most_driven
from modal.identification.order_search import Search, search, search_limits
from modal.identification.pipeline import identify
from modal.modes.extraction import extract_modes
from modal.modes.modal_form import ModalBasis
from okid.errors import NumericalError
from okid.record import Record


def trial(observer_order, model_order, *, ridge=0.0, error=0.1):
    return Trial(
        observer_order=observer_order,
        ridge=ridge,
        model_order=model_order,
        squared_errors=np.ones((3, 1)),
        block_errors=np.ones(9),
        error=error,
    )


def found_of(record, *trials):
    limits = search_limits([record], observer_order=None, ridge=None, model_order=None)
    return Search(
        trials=trials, chosen=trials[0], power=np.ones((3, 1)), limits=limits, ground=SimpleNamespace(by="blocks")
    )


def growing(n_samples=600, *, radius=1.001):
    """An exact record of an oscillation that grows."""
    rng = np.random.default_rng(2)
    u, y = rng.standard_normal(n_samples), np.zeros(n_samples)
    a1, a2 = 2 * radius * np.cos(0.7), -(radius**2)
    for k in range(2, n_samples):
        y[k] = a1 * y[k - 1] + a2 * y[k - 2] + u[k - 1] + 0.3 * u[k]
    return Record(u, y, 0.1)


def spectral_radius(model):
    return np.abs(np.linalg.eigvals(model.A)).max()


def test_a_stable_choice_is_kept_and_exact():
    rng = np.random.default_rng(1)
    system = modal_system(rng, frequencies=[4.0, 19.0], damping_ratios=[0.02, 0.01])
    inputs = random_inputs(rng, 600, 2)
    outputs = simulate(system, inputs, initial_state=initial_state(rng, system, inputs))
    record = Record(inputs, outputs, system.dt)
    wanted = trial(8, 4)
    found, final = fit_all_rows([record], found_of(record, wanted, trial(8, 2)))
    assert found.chosen is wanted
    poles = np.linalg.eigvals(final.realisation.A)
    for pole in system.discrete_poles:
        assert np.abs(poles - pole).min() < 1e-9
    assert (final.observer.order, final.markov.observer_order) == (8, 8)
    assert final.decomposition.max_order >= 4


def test_an_order_above_the_rank_of_exact_data_becomes_the_rank():
    rng = np.random.default_rng(3)
    system = modal_system(rng, frequencies=[4.0], damping_ratios=[0.02])
    inputs = random_inputs(rng, 400, 2)
    record = Record(inputs, simulate(system, inputs), system.dt)
    _, final = fit_all_rows([record], found_of(record, trial(6, 12)))
    assert final.realisation.order == 2


def test_the_largest_order_of_the_search_still_has_higher_ones_for_the_verdict():
    rng = np.random.default_rng(4)
    u = rng.standard_normal(900)
    y = np.convolve(u, 0.97 ** np.arange(80) * rng.standard_normal(80))[:900] + 0.01 * rng.standard_normal(900)
    record = Record(u, y, 0.1).detrended()
    _, final = fit_all_rows([record], found_of(record, trial(100, 64), trial(100, 4)))
    assert final.decomposition.max_order >= 1.4 * 64


def test_an_unstable_choice_gives_way_to_the_next_best_stable_one():
    record = growing()
    first, second, third = trial(4, 2), trial(4, 1, error=0.2), trial(6, 1, error=0.3)
    found, final = fit_all_rows([record], found_of(record, first, second, third))
    assert found.chosen is second
    assert found.trials == (first, second, third)
    assert final.realisation.order == 1
    assert spectral_radius(final.realisation) < 1.0
    # and the one passed over is what a plain fit would give: unstable
    assert final.decomposition.A.shape[0] >= 2
    assert spectral_radius_of_corner(final.decomposition, 2) > 1.0


def spectral_radius_of_corner(decomposition, n):
    return np.abs(np.linalg.eigvals(decomposition.A[:n, :n])).max()


def test_nothing_stable_is_an_error_that_says_what_to_do():
    record = growing()
    with pytest.raises(NumericalError, match=r"all 2 models .* unstable on the whole.*longer record"):
        fit_all_rows([record], found_of(record, trial(4, 2), trial(5, 2)))


def test_without_inputs_the_model_must_have_a_stable_predictor():
    """What runs without inputs is the one-step predictor A - K C, not A."""
    rng = np.random.default_rng(5)
    noise, y = rng.standard_normal(1500), np.zeros(1500)
    for k in range(2, 1500):
        y[k] = 1.6 * y[k - 1] - 0.81 * y[k - 2] + noise[k]
    record = Record([], y, 0.1).detrended()
    _, final = fit_all_rows([record], found_of(record, trial(2, 2)))
    model = final.realisation
    assert spectral_radius(model) < 1.0
    assert np.abs(np.linalg.eigvals(model.A - model.K @ model.C)).max() < 1.0


def test_without_inputs_a_growing_model_is_refused_though_its_predictor_is_stable():
    rng = np.random.default_rng(7)
    noise, y = rng.standard_normal(500), np.zeros(500)
    for k in range(2, 500):
        y[k] = 1.6 * y[k - 1] - 1.01 * y[k - 2] + noise[k]
    record = Record([], y, 0.1)
    with pytest.raises(NumericalError, match="unstable on the whole"):
        fit_all_rows([record], found_of(record, trial(2, 2)))


def test_an_integrator_ends_with_a_stable_model():
    """Position from acceleration: on all rows the pole at 1 may fall on either side."""
    rng = np.random.default_rng(6)
    u = rng.standard_normal(800)
    y = np.zeros(800)
    for k in range(1, 800):
        y[k] = 0.999999 * y[k - 1] + u[k - 1]
    record = Record(u, y + 0.2 * rng.standard_normal(800), 0.1).detrended()
    found, final = fit_all_rows([record], search([record], observer_order=8))
    assert spectral_radius(final.realisation) < 1.0
    assert np.isfinite(free_simulation(final.realisation, record).outputs).all()
    assert found.chosen in found.trials


def test_the_noise_is_modelled_once_however_many_starts_fall_behind_their_folds():
    """Folds of a decay under wind promise what no model of the wind keeps: each start had its noise modelled."""
    rng = np.random.default_rng(9)
    system = modal_system(rng, frequencies=[4.0], damping_ratios=[0.02])
    inputs = random_inputs(rng, 500, 2)
    pushed = inputs + 0.3 * rng.standard_normal(inputs.shape)
    record = Record(inputs, simulate(system, pushed), system.dt)
    shares = []
    wanted = trial(8, 2, error=-1.0)  # which no start keeps
    found, final = fit_all_rows([record], found_of(record, wanted, trial(9, 2, error=-1.0)), progress=shares.append)
    assert found.chosen is wanted
    assert final.gain is not None
    assert shares == sorted(shares)


def test_rows_of_rest_in_front_of_a_blow_leave_the_noise_behind_it_to_be_modelled():
    """Red noise asks for a model; rows of rest hold none and are not asked."""
    rng = np.random.default_rng(8)
    u, noise = rng.standard_normal((2, 1200))
    pole = 0.97 * np.exp(0.5j)
    y = scipy.signal.lfilter([0, 1.0], [1, -2 * pole.real, abs(pole) ** 2], u)
    seen = y + scipy.signal.lfilter([1.0], [1.0, -0.9], noise)
    record = Record(np.r_[np.zeros(20), u], np.r_[np.zeros(20), seen], 0.1)
    _, final = fit_all_rows([record], search([record], observer_order=8), n_rest=20)
    assert final.noise is not None
    assert final.noise.covariance.item() == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("seed", [0, 2])
def test_exact_data_give_no_gain(seed):
    """There is no noise to learn it from: that of the observer belongs to another model, and may make this unstable."""
    rng = np.random.default_rng(seed)
    system = modal_system(
        rng, n_inputs=2, n_outputs=3, frequencies=[4.0, 11.0, 19.0], damping_ratios=[0.02, 0.01, 0.01]
    )
    u = random_inputs(rng, 1200, 2)
    record = Record(u, simulate(system, u), system.dt)
    assert not identify(record, observer_order=12, ridge=0.0, order=6).realisation.K.any()


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_no_deviation_is_finer_than_rounding_and_only_a_real_poles_damping_has_none(noise):
    """Poles 0.9 (real), -0.8 (half the sampling rate) and a pair; what the pole is off by bounds what may be stated."""
    rng = np.random.default_rng(4)
    dt, pair = 0.01, 0.97 * np.exp(0.9j)
    force = rng.standard_normal(3000)
    parts = [
        scipy.signal.lfilter([0.0, 1.0], row, force) for row in ([1, -0.9], [1, 0.8], np.poly([pair, pair.conj()]))
    ]
    outputs = np.array(parts).T @ rng.standard_normal((3, 3))
    record = Record(force, outputs + noise * outputs.std(axis=0) * rng.standard_normal(outputs.shape), dt)
    modes = identify(record, observer_order=12, ridge=0.0, order=4).modes
    for pole in (0.9, -0.8, pair):
        s = np.log(complex(pole)) / dt
        mode = min(modes, key=lambda mode: abs(mode.frequency - abs(s) / (2 * np.pi)))
        assert abs(mode.frequency - abs(s) / (2 * np.pi)) < 6 * mode.frequency_std
        assert mode.frequency_std > np.finfo(float).eps / (2 * np.pi * dt)
        if pole == 0.9:
            assert mode.damping_ratio_std == 0.0
        else:
            assert abs(mode.damping_ratio + s.real / abs(s)) < 6 * mode.damping_ratio_std


def test_deviations_of_a_model_with_its_noise_are_as_much_wider_as_samples_are_fewer():
    """What was filled holds no noise and counts as a sample: both make them too small by the measured share."""
    rng = np.random.default_rng(11)
    system = modal_system(rng, frequencies=[4.0], damping_ratios=[0.02])
    inputs = random_inputs(rng, 2000, 2)
    clean = simulate(system, inputs)
    noise = scipy.signal.lfilter([1.0], [1.0, -0.9], rng.standard_normal(clean.shape), axis=0)
    record = Record(inputs, clean + 0.1 * clean.std() / noise.std() * noise, system.dt)
    found = search([record])
    _, final = fit_all_rows([record], found)
    assert final.noise is not None
    modes = extract_modes(final.realisation)
    whole, half = (with_deviations(modes, final, [record], measured_share=share)[1] for share in (1.0, 0.5))
    for name in ("frequency_std", "damping_ratio_std", "shape_std", "markov_std", "mass_std"):
        np.testing.assert_allclose(getattr(half, name), 2.0 * getattr(whole, name), rtol=1e-6, atol=1e-14)


DT = 0.01


def basis_of(frequencies, damping_ratios, inputs, outputs):
    omega, z = 2 * np.pi * np.array(frequencies), np.array(damping_ratios)
    poles = np.exp(omega * DT * (-z + 1j * np.sqrt(1 - z**2)))
    every = np.ones(poles.size, dtype=bool)
    inputs, outputs = np.array(inputs, dtype=complex)[:, None], np.array(outputs, dtype=complex).T
    return ModalBasis(
        poles=poles, is_pair=every, right=outputs, left=inputs, outputs=outputs, inputs=inputs, separable=every
    )


@pytest.mark.parametrize("order", [4, 5])
def test_large_answers_that_cancel_where_no_input_moves_are_none_of_the_systems(order):
    """A sweep from 2 to 30 Hz: two poles at 42 Hz answer it much more than the mode at 4 Hz, but not together."""
    time = DT * np.arange(4000)
    shape = np.array([1.0, 0.5])
    made = basis_of(
        [4.0, 12.0, 42.0, 42.1], [0.01, 0.01, 0.02, 0.021], [0.1, 0.1, 100.0, -100.0], [shape, -shape, shape, shape]
    )
    sweep = chirp(time, 2.0, time[-1], 30.0)[:, None]
    assert _most_driven(made, order, [sweep]) == [0, 1]
    assert _most_driven(made, 8, [sweep]) == [0, 1, 2, 3]


def test_of_modes_alike_the_weakest_is_left_out():
    white = np.random.default_rng(3).standard_normal((4000, 1))
    shapes = np.array([[1.0, 0.5], [-0.5, 1.0], [1.0, -1.0]])
    made = basis_of([4.0, 12.0, 31.0], [0.01, 0.01, 0.01], [0.1, 0.001, 0.1], shapes)
    assert _most_driven(made, 4, [white]) == [0, 2]


@pytest.mark.parametrize("first", [0, 1])
def test_of_real_poles_that_which_tells_more_of_the_answer_is_the_systems(first):
    """These have no imaginary parts, and an input may be silent."""
    poles = np.array([0.694, 0.935] if first == 0 else [0.935, 0.694], dtype=complex)
    size = np.array([0.7, 0.012] if first == 0 else [0.012, 0.7], dtype=complex)
    inputs = np.stack([size, np.zeros(2)], axis=1)
    alone = np.zeros(2, dtype=bool)
    made = ModalBasis(
        poles=poles, is_pair=alone, right=np.eye(2), left=inputs, outputs=np.ones((1, 2), dtype=complex),
        inputs=inputs, separable=~alone,
    )  # fmt: skip
    white = np.random.default_rng(4).standard_normal((1500, 2)) * [1.0, 0.0]
    assert _most_driven(made, 1, [white]) == [first]


def test_a_predictor_that_strays_is_no_model_of_the_noise():
    """A sweep beside lines of hum: 19 states of the noise took the motion for it, and one of five modes was certain."""
    case = random_record(30013)
    result = identify(Record(case.inputs, case.outputs, case.structure.dt), observer_order=22, ridge=3e-5)
    (noise,) = (choice for choice in result.choices if choice.what == "noise")
    assert "leaves more in a free run than noise makes it" in noise.reason
    true = np.sort(case.structure.frequencies)
    for mode, frequency in zip(result.modes.system, true, strict=True):
        assert abs(mode.frequency - frequency) < 4.0 * mode.frequency_std < 0.01 * frequency
