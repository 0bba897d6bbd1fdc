"""First-order propagation against derivatives by differences, its formulas written out, and Monte Carlo."""

from dataclasses import replace

import numpy as np
import pytest
import scipy
from systems import markov as true_markov
from systems import modal_system, random_system, simulate

from era.balanced import realise
from era.hankel import block_hankel
from era.realisation import Realisation
from modal.extraction import extract_modes
from modal.noise_models import WhiteNoise
from modal.propagation import propagated
from modal.sensitivity import mode_sensitivities
from okid.coefficient_covariance import coefficient_covariance
from okid.errors import InvalidDataError
from okid.gram import LagGram
from okid.markov import MarkovParameters
from okid.observer import fit_observer
from okid.record import Record
from okid.recovery import recover_markov


def observer_gain(system, radius=0.5):
    """A gain that puts the observer's poles at most that far out, so that the past is forgotten fast."""
    wanted = radius * np.linspace(-1.0, 1.0, system.order)
    return scipy.signal.place_poles(system.A.T, system.C.T, wanted).gain_matrix.T


def discrete(modes, dt):
    return np.exp(np.array([mode.pole for mode in modes]) * dt)


def identified(records, *, p, ridge=0.0, n_lags=40, order=6, realise_on="system"):
    observer = fit_observer(records, order=p, ridge=ridge)
    markov = recover_markov(observer, n_lags=n_lags)
    realisation = realise(markov, order=order, realise_on=realise_on)
    return {"observer": observer, "markov": markov, "realisation": realisation}


def uncertain(records, parts, residuals="white"):
    return propagated(records, **parts, modes=extract_modes(parts["realisation"]).modes, residuals=residuals)


# --- derivatives -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_derivatives_equal_central_differences_at_exact_markov_parameters(seed):
    rng = np.random.default_rng(seed)
    system = random_system(rng, n_modes=2, n_real_poles=1)
    scales = {"input_scale": np.array([3.0, 0.1]), "output_scale": np.array([1.0, 20.0, 0.05])}
    h = true_markov(system, 60)
    direction = rng.standard_normal(h.shape) * scales["output_scale"][:, np.newaxis] / scales["input_scale"]

    def modes_at(step):
        realisation = realise(MarkovParameters(system=h + step * direction, dt=system.dt, **scales), order=5)
        return realisation, extract_modes(realisation).modes

    step = 1e-6 * np.abs(h).max()
    realisation, modes = modes_at(0.0)
    ahead, behind = modes_at(step)[1], modes_at(-step)[1]
    sensitivities = mode_sensitivities(realisation, modes)
    scaled = direction * scales["input_scale"] / scales["output_scale"][:, np.newaxis]
    hankel = block_hankel(scaled, sensitivities.left.shape[2], sensitivities.right.shape[1])
    slopes = (discrete(ahead, system.dt) - discrete(behind, system.dt)) / (2 * step)
    for i, mode in enumerate(modes):
        columns = hankel @ sensitivities.right[i].ravel()
        derivatives = sensitivities.left[i].reshape(4, -1) @ columns
        assert abs(derivatives[0] - slopes[i]) < 1e-6 * abs(slopes[i])
        largest = np.abs(mode.shape).argmax()
        change = ahead[i].shape / ahead[i].shape[largest] - behind[i].shape / behind[i].shape[largest]
        assert np.abs(derivatives[1:] - change / (2 * step)).max() < 1e-6 * np.abs(change / (2 * step)).max()


def written_out(records, parts):
    """Standard deviations from the full covariance of all coefficients, the recursion differentiated step by step."""
    observer, realisation = parts["observer"], parts["realisation"]
    p, q, m, n_lags = observer.order, observer.n_outputs, observer.n_inputs, parts["markov"].n_lags
    rows = [
        np.concatenate([[1.0], r.inputs[k], *[np.hstack([r.inputs[k - i], r.outputs[k - i]]) for i in range(1, p + 1)]])
        for r in records
        for k in range(p, r.n_samples)
        if np.isfinite(r.outputs[k - p : k + 1]).all()
    ]
    assert len(rows) == observer.n_rows
    V = np.array(rows)
    # the ridge is one of channels without mean and of unit size: write it in the units of the record
    scale = np.concatenate([[1.0], observer.input_scale, *[np.r_[observer.input_scale, observer.output_scale]] * p])
    mean = (
        np.concatenate([r.inputs for r in records]).mean(axis=0),
        np.nanmean(np.concatenate([r.outputs for r in records]), axis=0),
    )
    V[:, 1:] -= np.concatenate([mean[0], *[np.r_[mean[0], mean[1]]] * p])
    V /= scale
    lags = np.concatenate([np.zeros(m), np.repeat(np.arange(1, p + 1), m + q)])
    inverse = np.linalg.inv(V.T @ V + np.diag(np.r_[0.0, observer.ridge * (1 + lags) * len(V)]))
    P = (inverse @ V.T @ V @ inverse) / np.outer(scale, scale)
    covariance = np.kron(P, observer.residual_covariance)  # of Theta, row after row
    h, n_unknowns = parts["markov"].system, V.shape[1]
    dh = np.zeros((n_lags + 1, q, m, n_unknowns * q))
    for k in range(n_lags + 1):
        for index in range(n_unknowns * q):
            theta = np.zeros((n_unknowns, q))
            theta.flat[index] = 1.0
            past = theta[1 + m :].reshape(p, m + q, q)
            if k == 0:
                dh[k, ..., index] = theta[1 : 1 + m].T
            elif k <= p:
                dh[k, ..., index] = past[k - 1, :m].T
            for i in range(1, min(k, p) + 1):
                dh[k, ..., index] += (
                    past[i - 1, m:].T @ h[k - i] + observer.output_coefficients[i - 1] @ dh[k - i, ..., index]
                )
    factors = realisation.factors
    dh_scaled = dh * (observer.input_scale / observer.output_scale[:, np.newaxis])[..., np.newaxis]
    a, b = factors.n_block_rows, factors.n_block_columns
    dH = [np.array([block_hankel(dh_scaled[..., i], a, b, shift) for i in range(dh.shape[-1])]) for shift in (0, 1)]
    root = np.sqrt(np.square(factors.observability).sum(axis=0))
    U, Vt = factors.observability / root, factors.controllability / root[:, np.newaxis]
    poles, vectors = np.linalg.eig(realisation.A)
    frequency, damping, shape = [], [], []
    for pole in discrete(extract_modes(realisation).modes, realisation.dt):
        i = int(np.abs(poles - pole).argmin())
        left, right = np.linalg.inv(vectors), vectors[:, i]
        moved = np.array([(d1 - pole * d0) @ (Vt.T @ (right / root)) for d0, d1 in zip(*dH, strict=True)])
        inner = ((moved @ U) / root) @ left.T  # (n_coefficients, order)
        s = np.log(pole) / realisation.dt
        ds = inner[:, i] / (pole * realisation.dt)
        dw = (np.conj(s) * ds).real / abs(s)
        dz = -ds.real / abs(s) + s.real * dw / abs(s) ** 2
        others = [j for j in range(len(poles)) if j != i]
        c = realisation.C @ vectors
        dc = (inner[:, others] / (pole - poles[others])) @ c[:, others].T
        first = np.array([(d0 @ (Vt.T @ (right / root)))[:q] for d0 in dH[0]])
        dc = dc + first * observer.output_scale
        J = np.abs(c[:, i]).argmax()
        dshape = (dc - np.outer(dc[:, J], c[:, i] / c[J, i])) / c[J, i]
        frequency.append(np.sqrt(dw @ covariance @ dw) / (2 * np.pi))
        damping.append(np.sqrt(dz @ covariance @ dz))
        shape.append(np.sqrt(np.einsum("ij,ik,kj->j", dshape.conj(), covariance, dshape).real))
    flat = dh.reshape(-1, dh.shape[-1])
    deviations = np.sqrt(np.einsum("ij,jk,ik->i", flat, covariance, flat)).reshape(h.shape)
    return np.array(frequency), np.array(damping), np.array(shape), deviations


@pytest.mark.parametrize("ridge", [0.0, 1e-2])
def test_equals_the_formulas_written_out_for_two_records_with_gaps_and_any_units(ridge):
    rng = np.random.default_rng(4)
    system = random_system(rng, n_modes=2, n_inputs=2, n_outputs=2)
    records = []
    for n_samples in (220, 150):
        u = rng.standard_normal((n_samples, 2))
        y = simulate(system, u)
        y = (y + 0.05 * y.std(axis=0) * rng.standard_normal(y.shape)) * [1e3, 1e-2]
        y[60:63, 1] = np.nan
        records.append(Record(u * [1.0, 50.0], y, system.dt))
    parts = identified(records, p=4, ridge=ridge, n_lags=16, order=4)
    have = uncertain(records, parts)
    frequency, damping, shape, deviations = written_out(records, parts)
    assert np.abs(have.frequency_std / frequency - 1).max() < 1e-7
    assert np.abs(have.damping_ratio_std / damping - 1).max() < 1e-7
    assert np.abs(have.shape_std - shape).max() < 1e-7 * shape.max()
    assert np.abs(have.markov_std / deviations - 1).max() < 1e-7
    assert have.degrees_of_freedom == parts["observer"].n_rows - parts["observer"].rank


def test_many_outputs_take_the_other_way_to_the_same_numbers():
    """With more numbers than steps the triangular solve is done on the steps: each number alone says the same."""
    rng = np.random.default_rng(8)
    n_unknowns, n_steps, n_outputs = 13, 9, 3
    regressors = rng.standard_normal((n_unknowns, n_steps)) + 1j * rng.standard_normal((n_unknowns, n_steps))
    weights = rng.standard_normal((7, n_steps, n_outputs)) + 1j * rng.standard_normal((7, n_steps, n_outputs))
    rows = rng.standard_normal((40, n_unknowns + n_outputs))
    gram = LagGram(matrix=rows.T @ rows, n_rows=40, order=2, n_inputs=2, n_outputs=n_outputs)
    noise = WhiteNoise(
        covariance=coefficient_covariance(gram, 1e-2), root=rng.standard_normal((3, 3)), degrees_of_freedom=30.0
    )
    first, second = noise.products(regressors, weights)
    for i in range(7):
        alone = noise.products(regressors, weights[i : i + 1])
        assert alone[0][0] == pytest.approx(first[i], rel=1e-10)
        assert alone[1][0] == pytest.approx(second[i], rel=1e-10)


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


@pytest.mark.parametrize(
    ("seed", "ridge", "residuals"), [(11, 0.0, "white"), (13, 0.0, "blocks"), (12, 1e-3, "blocks")]
)
def test_standard_deviations_are_those_of_three_hundred_records(seed, ridge, residuals):
    """White residuals; with a ridge, which leaves part of the signal in them, blocks are needed.

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
            known = propagated(record, **parts, modes=modes, residuals=residuals)
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
    numbers, claimed = [], {"white": [], "blocks": []}
    for run in range(150):
        record = Record(u, clean + 0.1 * clean.std(axis=0) * rng.standard_normal(clean.shape), system.dt)
        parts = identified(record, p=8, n_lags=60, order=4)
        modes = extract_modes(parts["realisation"]).modes
        numbers.append([[mode.frequency for mode in modes], [mode.damping_ratio for mode in modes]])
        if run % 10 == 0:
            for residuals, rows in claimed.items():
                known = propagated(record, **parts, modes=modes, residuals=residuals)
                rows.append([known.frequency_std, known.damping_ratio_std])
            assert known.degrees_of_freedom == pytest.approx(20 / 1.5)
    white, blocks = (np.mean(rows, axis=0) / np.std(numbers, axis=0, ddof=1) for rows in claimed.values())
    assert white.max() > 1.5
    assert ((blocks > 0.75) & (blocks < 1.35)).all()


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


@pytest.mark.parametrize("realise_on", ["system", "system_and_gain"])
def test_output_only_and_joint_realisations(realise_on):
    """Output only (the gain in place of the system), and both in one Hankel matrix: 150 records each."""
    rng = np.random.default_rng(6)
    system = modal_system(rng, frequencies=[8.0, 21.0], damping_ratios=[0.03, 0.02], n_inputs=1, n_outputs=2)
    n_inputs = 0 if realise_on == "system" else 1
    u = n_inputs * rng.standard_normal((1500, 1))
    size = np.full(2, 0.05 if n_inputs else 1.0)
    numbers, claimed = [], []
    for y in innovations_outputs(rng, system, u, K=observer_gain(system), size=size, n_runs=150):
        record = Record(u[:, :n_inputs], y, system.dt)
        parts = identified(record, p=8, n_lags=60, order=4, realise_on=realise_on)
        modes = extract_modes(parts["realisation"]).modes
        numbers.append([[mode.frequency for mode in modes], [mode.damping_ratio for mode in modes]])
        if len(numbers) % 10 == 1:
            known = propagated(record, **parts, modes=modes, residuals="white")
            claimed.append([known.frequency_std, known.damping_ratio_std])
    ratio = np.mean(claimed, axis=0) / np.std(numbers, axis=0, ddof=1)
    assert ratio.shape == (2, 2)
    assert ((ratio > 0.8) & (ratio < 1.25)).all()


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
    with pytest.raises(InvalidDataError, match="residuals must be"):
        propagated(record, **parts, modes=modes, residuals="coloured")
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
