"""The noise floor against noise of known variance on nonlinear responses from an integrator of its own."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modal.discrepancy.noise.floor import lowered_floor, noise_floor
from okid.errors import InvalidDataError
from okid.record import Record

LAWS = ("none", "cubic", "coulomb", "stops", "drag", "bilinear")
SHARES = (0.005, 0.01, 0.02, 0.05)


@dataclass(frozen=True, slots=True, kw_only=True)
class Responses:
    """(n_cases, n_samples) each; one mass on a spring of 1 Hz, its law, 30 to 60 samples a period."""

    laws: list
    kinds: list
    dt: np.ndarray
    inputs: np.ndarray
    displacement: np.ndarray
    acceleration: np.ndarray


def force(rng, kind, n_samples, dt):
    """Multisine that is no whole number of periods, random steps at every sample, or held for five."""
    if kind == "multisine":
        period = int(1.3 * n_samples)
        frequency = np.arange(period // 2 + 1) / (period * dt)
        inside = (frequency > 0.2) & (frequency < 3.0)
        spectrum = np.where(inside, np.exp(2j * np.pi * rng.random(inside.size)), 0.0)
        values = np.fft.irfft(spectrum, period)[:n_samples]
    elif kind == "white":
        values = rng.standard_normal(n_samples)
    else:
        values = np.repeat(rng.standard_normal(-(-n_samples // 5)), 5)[:n_samples]
    return values / values.std()


def integrate(force, dt, restoring, friction, state):
    """Runge-Kutta in six parts a sample of a = u - restoring(d, v) - friction sign(v), with sticking (Karnopp).

    Where the mass nearly rests and friction can hold it, friction is what holds it.
    """
    d, v = state
    n_parts = 6
    h = dt / n_parts
    displacement, acceleration = np.empty_like(force), np.empty_like(force)

    def slope(d, v, u):
        other = u - restoring(d, v)
        held = np.abs(v) < 2.0 * h * friction
        a = other - np.where(held, np.clip(other, -friction, friction), friction * np.sign(v))
        return v, a

    for k in range(force.shape[1]):
        u = force[:, k]
        displacement[:, k], acceleration[:, k] = d, slope(d, v, u)[1]
        for _ in range(n_parts):
            d1, v1 = slope(d, v, u)
            d2, v2 = slope(d + 0.5 * h * d1, v + 0.5 * h * v1, u)
            d3, v3 = slope(d + 0.5 * h * d2, v + 0.5 * h * v2, u)
            d4, v4 = slope(d + h * d3, v + h * v3, u)
            d, v = d + h / 6 * (d1 + 2 * d2 + 2 * d3 + d4), v + h / 6 * (v1 + 2 * v2 + 2 * v3 + v4)
    return displacement, acceleration


def simulate(rng, laws, kinds, n_samples):
    """Laws as strong as the linear spring at the linear response's size, and weaker; a random start."""
    n = len(laws)
    dt = 1.0 / rng.uniform(30, 60, n)
    inputs = np.array([force(rng, kind, n_samples, step) for kind, step in zip(kinds, dt, strict=True)])
    k = (2 * np.pi) ** 2
    c = 2 * rng.uniform(0.005, 0.03, n) * 2 * np.pi
    rest = (np.zeros(n), np.zeros(n))
    linear, _ = integrate(inputs, dt, lambda d, v: k * d + c * v, np.zeros(n), rest)
    size = linear.std(axis=1)
    strength = rng.uniform(0.1, 1.0, n) * k

    def of(law):
        return np.array([name == law for name in laws])

    gap = rng.uniform(0.7, 1.5, n) * size

    def restoring(d, v):
        return (
            k * d
            + c * v
            + of("cubic") * strength * d**3 / size**2
            + of("stops") * 5 * k * np.sign(d) * np.maximum(np.abs(d) - gap, 0.0)
            + of("drag") * 0.1 * strength * v * np.abs(v) / (k * size)
            + of("bilinear") * strength * np.maximum(d, 0.0)
        )

    start = (rng.standard_normal(n) * size, np.zeros(n))
    displacement, acceleration = integrate(inputs, dt, restoring, of("coulomb") * 0.15 * strength * size, start)
    assert np.isfinite(acceleration).all()
    return Responses(laws=laws, kinds=kinds, dt=dt, inputs=inputs, displacement=displacement, acceleration=acceleration)


@pytest.fixture(scope="module")
def responses():
    pairs = [(law, kind) for law in LAWS for kind in ("multisine", "white", "held")]
    return simulate(np.random.default_rng(41), [p[0] for p in pairs], [p[1] for p in pairs], 1600)


def estimated(rng, responses, signals, shares=SHARES):
    """(n_cases, n_shares) estimate over truth, standard error, and the methods."""
    ratio, error = np.empty((len(signals), len(shares))), np.empty((len(signals), len(shares)))
    methods = []
    for i, signal in enumerate(signals):
        for j, share in enumerate(shares):
            std = share * signal.std()
            measured = signal + std * rng.standard_normal(signal.size)
            floor = noise_floor(Record(responses.inputs[i], measured, responses.dt[i]))
            ratio[i, j], error[i, j] = floor.variance[0, 0] / std**2, floor.standard_error[0, 0]
            methods.append((responses.kinds[i], floor.method[0]))
    return ratio, error, methods


def test_displacements_show_the_true_variance_under_every_law(responses):
    ratio, error, methods = estimated(np.random.default_rng(42), responses, responses.displacement)
    assert 0.97 < np.median(ratio) < 1.04  # the noise itself has a variance that is 3 % off
    assert ((ratio > 0.85) & (ratio < 1.15)).mean() > 0.88
    assert 0.75 < ratio.min() < ratio.max() < 1.3
    assert (np.abs(ratio - 1) < 3 * np.hypot(error, 0.03)).all()
    assert np.median(error) < 0.12
    assert all(method == "quiet band" for kind, method in methods if kind == "multisine")


def test_accelerations_of_smooth_laws_show_it_too_through_a_response_that_never_rolls_off(responses):
    smooth = [i for i, law in enumerate(responses.laws) if law in {"none", "cubic", "drag"}]
    signals = responses.acceleration[smooth]
    part = Responses(
        laws=[responses.laws[i] for i in smooth],
        kinds=[responses.kinds[i] for i in smooth],
        dt=responses.dt[smooth],
        inputs=responses.inputs[smooth],
        displacement=responses.displacement[smooth],
        acceleration=signals,
    )
    ratio, error, methods = estimated(np.random.default_rng(43), part, signals)
    assert 0.96 < np.median(ratio) < 1.06
    assert ((ratio > 0.85) & (ratio < 1.15)).mean() > 0.9
    assert (np.abs(ratio - 1) < 3 * np.hypot(error, 0.03)).all()
    assert all(method == "incoherent part" for kind, method in methods if kind == "white")


def test_what_friction_and_impacts_hide_from_an_accelerometer_is_said(responses):
    sharp = [i for i, law in enumerate(responses.laws) if law in {"coulomb", "stops"}]
    part = Responses(
        laws=[responses.laws[i] for i in sharp],
        kinds=[responses.kinds[i] for i in sharp],
        dt=responses.dt[sharp],
        inputs=responses.inputs[sharp],
        displacement=responses.displacement[sharp],
        acceleration=responses.acceleration[sharp],
    )
    ratio, error, _ = estimated(np.random.default_rng(44), part, part.acceleration)
    high = ratio > 1.3
    assert high.mean() > 0.2, "the case is meant to be hard"
    assert (error[high] > 0.15).all()
    assert np.median(error[high]) > 0.5
    assert ratio.min() > 0.7


def test_a_models_residual_uncovers_the_noise_below_friction(responses):
    i = responses.laws.index("coulomb")
    rng = np.random.default_rng(45)
    clean = responses.acceleration[i][:, np.newaxis]
    std = 0.005 * clean.std()
    record = Record(responses.inputs[i], clean + std * rng.standard_normal(clean.shape), responses.dt[i])
    floor = noise_floor(record)
    lower = lowered_floor(floor, record, [record.outputs - clean])
    assert floor.variance[0, 0] > 1.5 * std**2
    assert abs(lower.variance[0, 0] / std**2 - 1) < 0.15
    assert lower.standard_error[0, 0] < 0.15
    assert "a fitted model leaves" in lower.reason[0]
    # a model that explains nothing lowers nothing
    same = lowered_floor(floor, record, [record.outputs])
    np.testing.assert_array_equal(same.variance, floor.variance)


@pytest.mark.parametrize("kind", ["high", "low"])
def test_these_bounds_would_see_an_estimate_that_is_off_by_a_factor_1_3(kind, responses):
    ratio, error, _ = estimated(np.random.default_rng(42), responses, responses.displacement)
    wrong = ratio * (1.3 if kind == "high" else 1 / 1.3)
    assert not 0.97 < np.median(wrong) < 1.04
    assert not (np.abs(wrong - 1) < 3 * np.hypot(error, 0.03)).all()


def test_a_free_decay_needs_no_input():
    rng = np.random.default_rng(3)
    k = np.arange(2000)
    decay = np.exp(-0.002 * k) * np.cos(0.15 * k) + 0.4 * np.exp(-0.003 * k) * np.cos(0.41 * k)
    ratios = [
        noise_floor(Record([], decay + 0.01 * rng.standard_normal(2000), 0.01)).variance[0, 0] / 1e-4 for _ in range(40)
    ]
    assert abs(np.mean(ratios) - 1) < 0.03
    assert np.std(ratios) < 0.08


def repeats(rng, *, noise, n_repeats=2, n_samples=3000, damping=0.1):
    """Records of a linear oscillator with the same input and other starts; the noise is made by `noise(rng, shape)`."""
    pole = np.exp((-damping + 1j) * 0.15)
    force = rng.standard_normal(n_samples)
    records = []
    for _ in range(n_repeats):
        state, y = complex(rng.standard_normal(), rng.standard_normal()) * 5.0, np.empty(n_samples)
        for k in range(n_samples):
            y[k] = state.real
            state = pole * state + force[k]
        records.append(Record(force, y + noise(rng, n_samples), 0.01))
    return records


def red(rng, n_samples):
    """Noise of variance 0.3^2 / (1 - 0.9^2), 400 times as strong at the lowest as at the highest frequency."""
    e = rng.standard_normal(n_samples + 200)
    for k in range(1, e.size):
        e[k] += 0.9 * e[k - 1]
    return 0.3 * e[200:]


def test_repeated_records_show_noise_of_any_spectrum():
    rng = np.random.default_rng(7)
    floors = [noise_floor(repeats(rng, noise=red, n_repeats=2 + i % 2)) for i in range(24)]
    used = [floor for floor in floors if floor.method[0] == "repeated records"]
    assert len(used) > 20
    ratio = np.mean([floor.variance[0, 0] for floor in used]) * (1 - 0.81) / 0.09
    assert abs(ratio - 1) < 0.06
    assert all(set(floor.method) == {"repeated records"} for floor in used)
    np.testing.assert_array_equal(used[0].random, used[0].variance)
    assert "not white" in used[0].reason[0]
    # the level of white noise that would explain the quiet band is lower by this share
    assert used[0].standard_error[0, 0] > 0.85


def test_repeated_periods_show_it_and_the_transient_is_left_out():
    rng = np.random.default_rng(8)
    ratios = []
    for _ in range(20):
        force = np.tile(rng.standard_normal(400), 5)
        state, y = 200.0 + 0j, np.empty(2000)
        for k in range(2000):
            y[k] = state.real
            state = np.exp((-0.05 + 1j) * 0.15) * state + force[k]
        floor = noise_floor(Record(force, y + 0.1 * rng.standard_normal(2000), 0.01))
        assert floor.method == ("repeated periods",)
        assert "5 periods of 400 samples" in floor.reason[0]
        assert "transient" in floor.reason[0]
        ratios.append(floor.variance[0, 0] / 0.01)
    assert abs(np.mean(ratios) - 1) < 0.04
    assert np.std(ratios) < 0.12


def test_responses_that_never_repeat_are_not_noise():
    """Two records whose responses differ as a whole (chaos): the scatter is motion, the quiet band is believed."""
    rng = np.random.default_rng(9)
    smooth = np.convolve(rng.standard_normal((2100,)), np.hanning(60), "valid")[:2000]
    other = np.convolve(rng.standard_normal((2100,)), np.hanning(60), "valid")[:2000]
    force = rng.standard_normal(2000)
    records = [Record(force, one + 0.05 * rng.standard_normal(2000), 0.01) for one in (smooth, other)]
    floor = noise_floor(records)
    assert floor.method[0] != "repeated records"
    np.testing.assert_allclose(floor.variance, 0.0025, rtol=0.2)
    assert "differ by up to" in floor.reason[0]


def test_a_narrow_motion_that_does_not_repeat_is_not_noise():
    """A light resonance whose start was different, five times the noise: far from chaos, and yet no noise."""
    rng = np.random.default_rng(14)
    force, k = rng.standard_normal(3000), np.arange(3000)
    pulse = 0.97 ** k[:400] * np.sin(0.2 * k[:400])
    moved = np.convolve(force, pulse)[:3000]
    for _ in range(5):
        wander = [
            0.3 * np.convolve(rng.standard_normal(4000), np.exp(-0.003 * k) * np.cos(0.2 * k))[500:3500] / 18
            for _ in range(2)
        ]
        floor = noise_floor([Record(force, moved + one + 0.1 * rng.standard_normal(3000), 0.01) for one in wander])
        assert floor.method[0] != "repeated records"
        np.testing.assert_allclose(floor.variance, 0.01, rtol=0.25)


def test_only_a_lower_and_surer_residual_lowers_a_floor():
    rng = np.random.default_rng(15)
    force = rng.standard_normal(2000)
    record = Record(force, force + 0.1 * rng.standard_normal(2000), 0.01)
    floor = noise_floor(record)
    residual = [0.05 * rng.standard_normal((2000, 1))]
    unsure = replace(floor, standard_error=np.array([[2.0]]))
    assert abs(lowered_floor(unsure, record, residual).variance[0, 0] / 0.0025 - 1) < 0.2
    sure = replace(floor, standard_error=np.array([[0.001]]))
    assert lowered_floor(sure, record, residual).variance[0, 0] == floor.variance[0, 0]
    higher = replace(unsure, variance=np.array([[1e-4]]))
    assert lowered_floor(higher, record, residual).variance[0, 0] == 1e-4
    repeated = replace(unsure, method=("repeated records",))
    assert lowered_floor(repeated, record, residual).variance[0, 0] == floor.variance[0, 0]
    with_holes = [np.where(rng.random((2000, 1)) < 0.05, np.nan, residual[0])]
    assert abs(lowered_floor(unsure, record, with_holes).variance[0, 0] / 0.0025 - 1) < 0.2


def test_lines_that_the_input_leaves_out_show_the_distortion():
    k = np.arange(2048)
    force = np.sin(2 * np.pi * 5 * k / 512) + np.sin(2 * np.pi * 9 * k / 512)
    rng = np.random.default_rng(10)
    measured = force + 0.3 * force**2 + 0.01 * rng.standard_normal(2048)
    floor = noise_floor(Record(force, measured, 0.01))
    assert floor.method == ("repeated periods",)
    # (sin a + sin b)^2 = 1 - (cos 2a + cos 2b) / 2 + cos(a - b) - cos(a + b): lines of mean square 2/8 + 2/2
    # the mean is no line, and cos(2 b) lies at 18 of at most 3 * 9
    np.testing.assert_allclose(floor.distortion[0, 0], 0.09 * (2 / 8 + 2 / 2), rtol=0.02)
    np.testing.assert_allclose(floor.variance[0, 0], 1e-4, rtol=0.2)
    # the noise on those lines is taken off
    loud = [
        noise_floor(Record(force, force + 0.3 * force**2 + rng.standard_normal(2048), 0.01)).distortion[0, 0]
        for _ in range(30)
    ]
    np.testing.assert_allclose(np.mean(loud), 0.09 * (2 / 8 + 2 / 2), rtol=0.05)


def test_quantisation_is_the_least_that_a_floor_can_be():
    k = np.arange(3000)
    clean = 3.0 * np.sin(0.02 * k)
    floor = noise_floor(Record([], 0.5 * np.round(clean / 0.5), 0.01))
    assert floor.variance[0, 0] >= 0.25 / 12 * (1 - 1e-12)
    rng = np.random.default_rng(11)
    measured = 0.1 * np.round((clean + 0.05 * rng.standard_normal(3000)) / 0.1)
    truth = np.mean((measured - clean) ** 2)
    np.testing.assert_allclose(noise_floor(Record([], measured, 0.01)).variance[0, 0], truth, rtol=0.15)


def test_records_differ_in_length_noise_and_gaps():
    rng = np.random.default_rng(12)
    records, truth = [], []
    for n_samples, std in ((1500, 0.02), (4000, 0.1), (2500, 0.05)):
        force = rng.standard_normal(n_samples)
        moved = np.convolve(force, np.sin(0.2 * np.arange(200)) * 0.97 ** np.arange(200))[:n_samples]
        measured = np.stack([moved, 2 * moved], axis=1) + std * rng.standard_normal((n_samples, 2)) * [1.0, 3.0]
        measured[rng.random(n_samples) < 0.05, 0] = np.nan
        measured[: n_samples // 20, 1] = np.nan
        records.append(Record(force, measured, 0.01))
        truth.append([std**2, 9 * std**2])
    floor = noise_floor(records)
    assert floor.variance.shape == (3, 2)
    np.testing.assert_allclose(floor.variance, truth, rtol=0.25)
    assert "bridged" in floor.reason[0]


@given(seed=st.integers(0, 2**32 - 1), scale=st.floats(-6, 6), n_outputs=st.integers(1, 3), gaps=st.booleans())
@settings(max_examples=25, deadline=None)
def test_variance_follows_units_and_order_of_the_outputs(seed, scale, n_outputs, gaps):
    rng = np.random.default_rng(seed)
    force = rng.standard_normal((600, 1))
    response = np.convolve(force[:, 0], 0.8 ** np.arange(30))[:600, np.newaxis]
    measured = response * rng.uniform(0.5, 2, n_outputs) + 0.1 * rng.standard_normal((600, n_outputs))
    if gaps:
        measured[rng.random(measured.shape) < 0.03] = np.nan
    floor = noise_floor(Record(force, measured, 0.01))
    factor = 2.0 ** round(scale * 3)
    scaled = noise_floor(Record(3.0 * force, factor * measured, 0.2))
    np.testing.assert_allclose(scaled.variance, factor**2 * floor.variance, rtol=1e-6)
    np.testing.assert_allclose(scaled.standard_error, floor.standard_error, rtol=1e-6)
    order = rng.permutation(n_outputs)
    permuted = noise_floor(Record(force, measured[:, order], 0.01))
    np.testing.assert_allclose(permuted.variance, floor.variance[:, order], rtol=1e-9)
    several = noise_floor([Record(force, measured, 0.01), Record(-force, measured[::-1], 0.01)])
    np.testing.assert_allclose(several.variance[0], floor.variance[0], rtol=1e-9)


def test_wrong_residuals_are_refused():
    record = Record(np.arange(100.0), np.arange(100.0), 0.1)
    floor = noise_floor(record)
    with pytest.raises(InvalidDataError, match="residuals and floor"):
        lowered_floor(floor, record, [np.zeros((99, 1))])
    with pytest.raises(InvalidDataError, match="residuals and floor"):
        lowered_floor(floor, [record, record], [record.outputs, record.outputs])


def test_the_result_is_frozen_and_names_its_band():
    rng = np.random.default_rng(13)
    floor = noise_floor(Record([], rng.standard_normal(2000), 0.01, output_names=["tip"]))
    assert not floor.variance.flags.writeable
    assert "'tip'" in floor.reason[0]
    assert "Hz" in floor.reason[0]
    assert np.isnan(floor.random).all()
    assert np.isnan(floor.distortion).all()


@pytest.mark.slow
def test_print_the_distribution_of_estimate_over_truth():
    """The table in the docstring of `modal.discrepancy.noise.floor`."""
    rng = np.random.default_rng(2026)
    kinds = ("multisine", "white", "held")
    pairs = [(law, kinds[i % 3]) for law in LAWS for i in range(30)]
    responses = simulate(rng, [p[0] for p in pairs], [p[1] for p in pairs], 2048)
    shares = tuple(np.exp(rng.uniform(np.log(0.005), np.log(0.05), 2)))
    for sensor in ("displacement", "acceleration"):
        ratio, error, _ = estimated(rng, responses, getattr(responses, sensor), shares)
        for law in LAWS:
            rows = [i for i, name in enumerate(responses.laws) if name == law]
            r, sure = ratio[rows].ravel(), error[rows].ravel() < 0.15
            quartiles = "".join(f"{q:7.2f}" for q in np.quantile(r, [0.05, 0.25, 0.5, 0.75, 0.95]))
            print(
                f"{sensor:13s}{law:10s}{quartiles}  sure {sure.mean():.2f}, of these over 1.3: {(r[sure] > 1.3).sum()}"
            )
        if sensor == "displacement":
            assert ((ratio > 0.85) & (ratio < 1.15)).mean() > 0.95
        assert (ratio[error < 0.15] > 1.3).mean() < 0.04


def test_exact_repeats_on_one_channel_beside_noisy_ones_divide_by_nothing():
    """A channel that repeats to the last bit has no scatter; no bare warning of a library comes of it."""
    rng = np.random.default_rng(3)
    period = rng.standard_normal(256)
    force = np.tile(period, 8)
    exact = np.tile(np.convolve(np.tile(period, 2), [0.5, 0.3, -0.2])[256:512], 8)
    floor = noise_floor(Record(force, np.column_stack([exact, exact + 0.01 * rng.standard_normal(2048)]), 0.01))
    assert floor.method == ("repeated periods",)
    assert floor.variance[0, 1] == pytest.approx(1e-4, rel=0.2)
    assert floor.variance[0, 0] < 1e-12
