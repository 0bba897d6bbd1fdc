"""First-order propagation against derivatives by differences, and Monte Carlo."""

from dataclasses import replace

import numpy as np
import pytest
import scipy
from systems import modal_system, random_system, simulate

from era.balanced import realise
from era.realisation import Realisation
from modal.estimation import propagation
from modal.estimation.propagation import propagated
from modal.modes.extraction import extract_modes
from okid.errors import InvalidDataError
from okid.markov import recover_markov
from okid.observer import fit_observer
from okid.record import Record


def observer_gain(system, radius=0.5):
    """A gain that puts the observer's poles at most that far out, so that the past is forgotten fast."""
    wanted = radius * np.linspace(-1.0, 1.0, system.order)
    return scipy.signal.place_poles(system.A.T, system.C.T, wanted).gain_matrix.T


def identified(records, *, p, ridge=0.0, n_lags=40, order=6):
    observer = fit_observer(records, order=p, ridge=ridge)
    markov = recover_markov(observer, n_lags=n_lags)
    realisation = realise(markov, order=order)
    return {"observer": observer, "markov": markov, "realisation": realisation}


def uncertain(records, parts):
    return propagated(records, **parts, modes=extract_modes(parts["realisation"]).modes)


# --- derivatives -----------------------------------------------------------------------------------------------------


def moved_by(observer, direction, step):
    """The observer with its coefficients of scaled channels moved along a direction."""
    into, out = observer.input_scale, observer.output_scale[:, np.newaxis]
    p, q, m = observer.order, observer.n_outputs, observer.n_inputs
    past = step * direction[1 + m :].reshape(p, m + q, q).transpose(0, 2, 1)
    return replace(
        observer,
        feedthrough=observer.feedthrough + step * direction[1 : 1 + m].T * out / into,
        input_coefficients=observer.input_coefficients + past[:, :, :m] * out / into,
        output_coefficients=observer.output_coefficients + past[:, :, m:] * out / observer.output_scale,
    )


def log_mass(mode, J):
    """(n_outputs, n_inputs) logarithm of the mass of the shape whose component J is 1, for each driving point."""
    residues = np.outer(mode.shape, mode.participation)
    return -np.log(np.abs(residues)) - 2 * np.log(np.abs(mode.shape[J] / mode.shape))[:, np.newaxis]


@pytest.mark.parametrize("n_inputs", [0, 2])
@pytest.mark.parametrize("seed", range(3))
def test_deviations_equal_central_differences_of_the_whole_chain(monkeypatch, seed, n_inputs):
    """One direction at Markov parameters of exactly the model's order: the deviation is the size of the derivative."""
    rng = np.random.default_rng(seed)
    system = random_system(rng, n_modes=2, n_real_poles=1, n_inputs=2, n_outputs=3)
    units = np.array([1.0, 20.0, 0.05])
    if n_inputs:
        inputs = rng.standard_normal((400, 2))
        record = Record(inputs * [3.0, 0.1], simulate(system, inputs) * units, system.dt)
        parts = identified(record, p=2, n_lags=60, order=5)
    else:  # the true predictor as the observer: its gain has the system's poles
        K = observer_gain(system)
        y = innovations_outputs(rng, system, np.zeros((400, 2)), K=K, size=np.ones(3), n_runs=1)[0] * units
        record = Record([], y, system.dt)
        observer = fit_observer(record, order=40)
        closed, betas, power = system.A - K @ system.C, [], np.eye(system.order)
        for _ in range(40):
            betas.append(system.C @ power @ K * units[:, np.newaxis] / units)
            power = power @ closed
        observer = replace(observer, output_coefficients=np.array(betas))
        markov = recover_markov(observer, n_lags=60)
        parts = {"observer": observer, "markov": markov, "realisation": realise(markov, order=5)}
    n_unknowns = 1 + n_inputs + parts["observer"].order * (n_inputs + 3)
    direction = 1e-2 * rng.standard_normal((n_unknowns, 3))
    monkeypatch.setattr(propagation, "block_deviations", lambda *_: direction[np.newaxis])
    known = uncertain(record, parts)
    step = 1e-5
    ahead, behind = (
        extract_modes(realise(recover_markov(moved_by(parts["observer"], direction, sign), n_lags=60), order=5)).modes
        for sign in (step, -step)
    )
    for i, mode in enumerate(extract_modes(parts["realisation"]).modes):
        J = np.abs(mode.shape).argmax()
        frequency = (ahead[i].frequency - behind[i].frequency) / (2 * step)
        damping = (ahead[i].damping_ratio - behind[i].damping_ratio) / (2 * step)
        shape = (ahead[i].shape / ahead[i].shape[J] - behind[i].shape / behind[i].shape[J]) / (2 * step)
        assert known.frequency_std[i] == pytest.approx(abs(frequency), rel=1e-5)
        assert known.damping_ratio_std[i] == pytest.approx(abs(damping), rel=1e-5, abs=1e-9)
        np.testing.assert_allclose(known.shape_std[i], np.abs(shape), rtol=1e-5, atol=1e-6 * np.abs(shape).max())
        if n_inputs:
            ends = (log_mass(ahead[i], J), log_mass(behind[i], J))
            mass = np.abs(ends[0] - ends[1]) / (2 * step)
            np.testing.assert_allclose(known.mass_std[i], mass, rtol=1e-4, atol=1e-5 * mass.max())
    if n_inputs:
        ends = [
            recover_markov(moved_by(parts["observer"], direction, sign), n_lags=60).system for sign in (step, -step)
        ]
        slope = np.abs(ends[0] - ends[1]) / (2 * step)
        np.testing.assert_allclose(known.markov_std, slope, rtol=1e-5, atol=1e-7 * slope.max())


# --- Monte Carlo -----------------------------------------------------------------------------------------------------


def innovations_outputs(rng, system, inputs, *, K, size, n_runs):
    """x(k+1) = A x + B u + K e, y = C x + D u + e: the observer of K whitens, whatever its length beyond its memory."""
    state, outputs = np.zeros((system.order, n_runs)), np.empty((len(inputs), system.n_outputs, n_runs))
    for k, u in enumerate(inputs):
        e = size[:, np.newaxis] * rng.standard_normal((system.n_outputs, n_runs))
        drive = u[:, np.newaxis]
        outputs[k] = system.C @ state + system.D @ drive + e
        state = system.A @ state + system.B @ drive + K @ e
    return [outputs[:, :, run] for run in range(n_runs)]


@pytest.mark.parametrize(("seed", "ridge"), [(13, 0.0), (12, 1e-3)])
def test_standard_deviations_are_those_of_three_hundred_records(seed, ridge):
    """White residuals, and those of a ridge, which leaves part of the signal in them.

    300 records give a standard deviation to 4 %, so 0.85 to 1.15 is more than three of its own.
    """
    rng = np.random.default_rng(seed)
    system = modal_system(
        rng, frequencies=[6.0, 17.0], damping_ratios=[0.03, 0.02], n_inputs=2, n_outputs=2, mode_sizes=[1.0, 0.5]
    )
    u = rng.standard_normal((1500, 2))
    size = 0.03 * simulate(system, u).std(axis=0)
    outputs = innovations_outputs(rng, system, u, K=observer_gain(system), size=size, n_runs=300)
    records = [Record(u, y, system.dt) for y in outputs]
    found, claimed = [], []
    for run, record in enumerate(records):
        parts = identified(record, p=8, ridge=ridge, n_lags=60, order=4)
        modes = extract_modes(parts["realisation"]).modes
        assert [mode.kind for mode in modes] == ["oscillatory"] * 2
        shapes = np.array(
            [mode.shape / mode.shape[np.abs(true).argmax()] for mode, true in zip(modes, system.shapes.T, strict=True)]
        )
        numbers = [mode.frequency for mode in modes], [mode.damping_ratio for mode in modes]
        found.append((np.array(numbers), shapes, parts["markov"].system))
        if run % 15 == 0:
            known = propagated(record, **parts, modes=modes)
            claimed.append(
                (np.array([known.frequency_std, known.damping_ratio_std]), known.shape_std, known.markov_std)
            )
    ratios = [
        np.mean(said, axis=0)[there > 0] / there[there > 0]
        for said, there in zip(
            zip(*claimed, strict=True),
            (
                np.sqrt((np.abs(v - np.mean(v, axis=0)) ** 2).sum(axis=0) / 299)
                for v in map(np.array, zip(*found, strict=True))
            ),
            strict=True,
        )
    ]
    poles, shapes, markov = (ratio[np.isfinite(ratio) & (ratio > 0)] for ratio in ratios)
    assert ((poles > 0.85) & (poles < 1.15)).all()
    assert ((shapes > 0.85) & (shapes < 1.15)).all()
    assert 0.95 < np.median(markov) < 1.05
    assert (markov > 0.8).all()
    assert (markov < 1.2).all()


def test_blocks_hold_where_the_observer_is_too_short_to_whiten():
    """White sensor noise needs a long observer; with eight lags residuals carry over. 150 records."""
    rng = np.random.default_rng(14)
    system = modal_system(rng, frequencies=[9.0, 22.0], damping_ratios=[0.06, 0.05], n_inputs=1, n_outputs=2)
    u = rng.standard_normal((4000, 1))
    clean = simulate(system, u)
    numbers, claimed = [], []
    for run in range(150):
        record = Record(u, clean + 0.1 * clean.std(axis=0) * rng.standard_normal(clean.shape), system.dt)
        parts = identified(record, p=8, n_lags=60, order=4)
        modes = extract_modes(parts["realisation"]).modes
        numbers.append([[mode.frequency for mode in modes], [mode.damping_ratio for mode in modes]])
        if run % 10 == 0:
            known = propagated(record, **parts, modes=modes)
            claimed.append([known.frequency_std, known.damping_ratio_std])
            assert known.degrees_of_freedom == pytest.approx(20 / 1.5)
    ratio = np.mean(claimed, axis=0) / np.std(numbers, axis=0, ddof=1)
    assert ((ratio > 0.75) & (ratio < 1.35)).all()


# --- the ways a model can be made ------------------------------------------------------------------------------------


def test_units_and_the_order_of_channels_do_not_matter():
    rng = np.random.default_rng(5)
    system = random_system(rng, n_modes=2)
    u = rng.standard_normal((800, 2))
    y = simulate(system, u)
    y += 0.02 * y.std(axis=0) * rng.standard_normal(y.shape)
    known = uncertain(record := Record(u, y, system.dt), identified(record, p=12, order=4))
    into, out = np.array([1e3, 1e-4]), np.array([1e-6, 1.0, 1e5])
    turned = Record((u * into)[:, ::-1], (y * out)[:, [2, 0, 1]], 2 * system.dt)
    again = uncertain(turned, identified(turned, p=12, order=4))
    assert np.abs(again.frequency_std * 2 / known.frequency_std - 1).max() < 1e-6
    assert np.abs(again.damping_ratio_std / known.damping_ratio_std - 1).max() < 1e-6
    moved = (known.markov_std * out[:, np.newaxis] / into)[:, [2, 0, 1]][:, :, ::-1]
    assert np.abs(again.markov_std / moved - 1).max() < 1e-6


def test_output_only_records():
    """The gain in place of the system: 150 records, so 0.75 to 1.35 is more than three standard deviations."""
    rng = np.random.default_rng(6)
    system = modal_system(rng, frequencies=[8.0, 21.0], damping_ratios=[0.03, 0.02], n_inputs=1, n_outputs=2)
    u, size = np.zeros((1500, 1)), np.ones(2)
    numbers, claimed = [], []
    for y in innovations_outputs(rng, system, u, K=observer_gain(system), size=size, n_runs=150):
        record = Record([], y, system.dt)
        parts = identified(record, p=8, n_lags=60, order=4)
        modes = extract_modes(parts["realisation"]).modes
        numbers.append([[mode.frequency for mode in modes], [mode.damping_ratio for mode in modes]])
        if len(numbers) % 10 == 1:
            known = propagated(record, **parts, modes=modes)
            claimed.append([known.frequency_std, known.damping_ratio_std])
    ratio = np.mean(claimed, axis=0) / np.std(numbers, axis=0, ddof=1)
    assert ratio.shape == (2, 2)
    assert ((ratio > 0.75) & (ratio < 1.35)).all()


# --- what is refused -------------------------------------------------------------------------------------------------


def test_stages_that_do_not_belong_together_are_refused():
    rng = np.random.default_rng(7)
    system = random_system(rng, n_modes=2)
    u = rng.standard_normal((400, 2))
    record = Record(u, simulate(system, u) + 0.01 * rng.standard_normal((400, 3)), system.dt)
    parts = identified(record, p=6, order=4)
    modes = extract_modes(parts["realisation"]).modes
    with pytest.raises(InvalidDataError, match="records must be those"):
        propagated(record.samples(0, 300), **parts, modes=modes)
    with pytest.raises(InvalidDataError, match="poles of the realisation"):
        propagated(record, **parts, modes=[replace(modes[0], pole=modes[0].pole * 1.01)])
    found = parts["realisation"]
    bare = Realisation(found.A, found.B, found.C, found.D, found.dt)
    with pytest.raises(InvalidDataError, match="Hankel factors"):
        propagated(record, **(parts | {"realisation": bare}), modes=modes)
    with pytest.raises(InvalidDataError, match="takes an ObserverFit"):
        propagated(record, **(parts | {"observer": record}), modes=modes)


def test_no_modes_and_noise_free_data_have_no_spread():
    rng = np.random.default_rng(9)
    system = random_system(rng, n_modes=2)
    u = rng.standard_normal((500, 2))
    record = Record(u, simulate(system, u), system.dt)
    parts = identified(record, p=4, order=4)
    known = uncertain(record, parts)
    assert (known.frequency_std < 1e-6 * system.frequencies).all()
    assert propagated(record, **parts, modes=()).frequency_std.shape == (0,)
