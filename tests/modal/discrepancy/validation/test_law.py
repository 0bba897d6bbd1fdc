"""Laws over the data: points free of the law's form lie on the true force, whatever law was fitted."""

import numpy as np
import pytest
import scipy
import scipy.interpolate
from nonlinear_chain import no_force, run_chain

from modal.discrepancy.fitting.estimation import Problem, covariance, estimate, simulate_at
from modal.discrepancy.validation.law_curves import law_curves, whole_reach
from modal.discrepancy.validation.law_points import bins_of
from modal.effects.catalogue import CATALOGUE
from modal.simulation.assembly import assemble, initial_unknowns, place_effect
from modal.simulation.drive import drive_of
from modal.structure.structural_model import StructuralModel
from modal.structure.structural_plant import structural_plant
from okid.record import Record

DT, N, K, C = 0.01, 1024, 1000.0, 2.0
NOISE = 0.01
N_DRAWS = 5


def excitations(rng, levels, n=N):
    frequencies = np.fft.rfftfreq(n, DT)
    lines = np.where((frequencies >= 1.0) & (frequencies <= 12.0), 1.0, 0.0)
    shape = np.fft.irfft(lines * np.exp(2j * np.pi * rng.random((len(levels), len(lines)))), n)
    return shape / shape.std(axis=1, keepdims=True) * np.array(levels)[:, None]


def measured(rng, inputs, outputs):
    spread = NOISE * outputs.std(axis=1, keepdims=True)
    noisy = outputs + spread * rng.standard_normal(outputs.shape)
    records = [
        Record(u[:, None], y[:, None], DT, input_hold="zero_order", input_units=("N",), output_units=("m",))
        for u, y in zip(inputs, noisy, strict=True)
    ]
    return records, spread**2


def fitted_to(records, floor, key, start, *, where="element_0", fine=1, smoothing=0.005, local=None):
    model = StructuralModel.chain([1.0], [1.03 * K], [0.9 * C], force_dofs=0, sensor_dofs=0, sensor_kind="displacement")
    plant = structural_plant(model)
    problem = Problem(drive=drive_of(records, fine), floor=floor)
    outputs = np.concatenate([record.outputs[:, 0] for record in records])
    item = place_effect(
        plant,
        CATALOGUE[key],
        where,
        displacement_scale=float(outputs.std()),
        velocity_scale=float(np.gradient(outputs, DT).std()),
    )
    assembly = assemble(plant, [item])
    unknowns = initial_unknowns(assembly, len(records))
    unknowns.common[assembly.n_linear :] = start
    if local is not None:
        unknowns.local[:, assembly.local_of(0)] = local
    begun = simulate_at(assembly, unknowns, problem, smoothing=smoothing)
    found = estimate(begun, problem, iterations=25, standstill=1e-8)
    return plant, problem, found


def curve_of(plant, problem, found):
    (curve,) = law_curves(found, problem, plant, covariance(found, problem))
    return curve


def chain(inputs, law, **options):
    return run_chain([1.0], [K], [C], inputs, DT, law=law, **{"n_steps": 10} | options)[:, :, 0]


def cubic(d, v, t):
    return 2e5 * d**3


def friction(d, v, t):
    return 0.3 * np.tanh(v / 2e-3)


def asymmetric(d, v, t):
    return 2e5 * d**3 + 3e3 * d**2


def scores(curve, force):
    """Departure of the points from a true force in standard deviations."""
    return (curve.points_force - force(curve.points_motion)) / curve.points_deviation


# --- a law of the right form ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("key", "law", "start", "levels", "options"),
    [
        ("cubic_stiffness", cubic, [1e5], [0.5, 1.0, 2.0], {}),
        ("coulomb_friction", friction, [0.2], [2.0, 5.0], {"fine": 4, "smoothing": 0.001}),
    ],
)
def test_points_scatter_about_the_true_law_as_their_bars_say(key, law, start, levels, options):
    found = []
    rng = np.random.default_rng(71)
    inputs = np.concatenate([excitations(rng, levels) for _ in range(N_DRAWS)])
    for u, y in zip(np.split(inputs, N_DRAWS), np.split(chain(inputs, law), N_DRAWS), strict=True):
        curve = curve_of(*fitted_to(*measured(rng, u, y), key, start, **options))
        found.append(scores(curve, lambda x: law(x, x, 0.0)))
        true = law(curve.motion, curve.motion, 0.0)
        # a friction force is determined to a thousandth, which the smoothed truth is not
        allowed = 4.0 * curve.deviation + 0.01 * np.abs(true).max()
        assert np.mean(np.abs(curve.force - true) <= allowed) > 0.95
    squares = np.mean(np.square(found))
    # 60 points, neighbours related: 3 sigma of a chi-square with half as many degrees of freedom
    assert 1.0 - 3.0 * np.sqrt(2.0 / 30.0) < squares < 1.0 + 3.0 * np.sqrt(2.0 / 30.0)


def test_units_and_axis_follow_what_the_law_reads():
    rng = np.random.default_rng(3)
    inputs = excitations(rng, [1.5, 3.0])
    plant, problem, fitted = fitted_to(
        *measured(rng, inputs, chain(inputs, friction)), "coulomb_friction", [0.2], fine=4, smoothing=0.001
    )
    curve = curve_of(plant, problem, fitted)
    assert (curve.against, curve.motion_unit, curve.force_unit) == ("velocity", "m/s", "N")
    assert curve.effect == "coulomb_friction"
    assert curve.where == "element_0"
    assert curve.loop_motion.size == 0
    assert np.all(np.diff(curve.points_motion) > 0)
    np.testing.assert_allclose(curve.force, fitted.unknowns.common[-1] * np.sign(curve.motion), atol=1e-12)


# --- a law of the wrong form ------------------------------------------------------------------------------------------


def test_points_show_the_true_force_where_the_law_has_the_wrong_form():
    squares, plain, tilts = [], [], []
    for seed in range(3):
        rng = np.random.default_rng([72, seed])
        inputs = excitations(rng, [0.5, 1.0, 2.0])
        plant, problem, fitted = fitted_to(*measured(rng, inputs, chain(inputs, asymmetric)), "cubic_stiffness", [1e5])
        curve = curve_of(plant, problem, fitted)
        true = asymmetric(curve.points_motion, 0.0, 0.0)
        # a force in proportion to the displacement cannot be told from the stiffness: up to a tilt
        weighted = curve.points_motion / curve.points_deviation
        off = (curve.points_force - true) / curve.points_deviation
        tilt = off @ weighted / (weighted @ weighted)
        squares.append(np.sum((off - tilt * weighted) ** 2) / 11)
        tilts.append(tilt)
        as_fitted = np.interp(curve.points_motion, curve.motion, curve.force)
        plain.append(np.mean(((as_fitted - true) / curve.points_deviation) ** 2))
    assert np.max(np.abs(tilts)) < 1e-3 * K
    assert 0.3 < np.mean(squares) < 2.5
    assert np.min(plain) > 100.0


# --- other kinds ------------------------------------------------------------------------------------------------------


def test_a_limited_input_is_drawn_after_over_before():
    rng = np.random.default_rng(5)
    inputs = excitations(rng, [1.0, 2.0])
    outputs = chain(np.clip(inputs, -2.5, 2.5), no_force)
    curve = curve_of(
        *fitted_to(*measured(rng, inputs, outputs), "input_saturation", [3.0], where="input_0", smoothing=0.005)
    )
    assert (curve.against, curve.motion_unit, curve.force_unit) == ("input", "N", "N")
    off = scores(curve, lambda u: np.clip(u, -2.5, 2.5))
    assert 0.1 < np.mean(off**2) < 3.0


def test_a_sensors_drift_is_drawn_over_time():
    rng = np.random.default_rng(6)
    inputs = excitations(rng, [1.0, 2.0])
    outputs = chain(inputs, no_force)
    drift = 0.2 * outputs.std() * (1.0 + 0.1 * np.arange(N) * DT)
    records, floor = measured(rng, inputs, outputs + drift)
    curve = curve_of(*fitted_to(records, floor, "sensor_bias", [0.0, 0.0], where="output_0"))
    assert (curve.against, curve.motion_unit, curve.force_unit) == ("time", "s", "m")
    off = scores(curve, lambda t: 0.2 * outputs.std() * (1.0 + 0.1 * t))
    assert 0.1 < np.mean(off**2) < 3.0


def test_a_sine_is_drawn_over_one_period_of_all_records():
    rng = np.random.default_rng(7)
    inputs = excitations(rng, [1.0, 2.0])
    phases = np.array([0.4, 2.1])
    outputs = chain(inputs, lambda d, v, t: 0.5 * np.sin(2.0 * np.pi * 3.3 * t + phases))
    records, floor = measured(rng, inputs, outputs)
    curve = curve_of(*fitted_to(records, floor, "periodic_disturbance", [0.4, 3.29], local=np.array([[0.5], [2.2]])))
    assert curve.against == "time"
    np.testing.assert_allclose(curve.motion[-1], 1.0 / 3.3, rtol=1e-3)
    off = scores(curve, lambda t: 0.5 * np.sin(2.0 * np.pi * 3.3 * t))
    assert 0.1 < np.mean(off**2) < 3.0


def test_a_drifting_stiffness_is_drawn_over_time_at_one_deviation():
    rng = np.random.default_rng(8)
    inputs = excitations(rng, [1.0, 2.0])
    outputs = chain(inputs, lambda d, v, t: 8.0 * t * d)
    records, floor = measured(rng, inputs, outputs)
    plant, problem, fitted = fitted_to(records, floor, "time_varying_stiffness", [5.0])
    curve = curve_of(plant, problem, fitted)
    scale = fitted.assembly.placements[0].displacement_scale
    assert (curve.against, curve.motion_unit, curve.force_unit) == ("time", "s", "N")
    off = scores(curve, lambda t: 8.0 * t * scale)
    assert 0.1 < np.mean(off**2) < 3.0


def test_a_law_with_memory_has_a_loop_along_the_loudest_record():
    rng = np.random.default_rng(9)
    inputs = excitations(rng, [1.0, 4.0])
    records, floor = measured(rng, inputs, chain(inputs, no_force))
    plant, problem, _ = fitted_to(records, floor, "cubic_stiffness", [0.0])
    item = place_effect(
        plant, CATALOGUE["bouc_wen_hysteresis"], "element_0", displacement_scale=0.005, velocity_scale=0.1
    )
    assembly = assemble(plant, [item])
    unknowns = initial_unknowns(assembly, 2)
    unknowns.common[-3:] = 200.0, 0.003, 1.0
    fitted = simulate_at(assembly, unknowns, problem)
    curve = curve_of(plant, problem, fitted)
    assert 0 < curve.loop_motion.size <= 400
    assert curve.points_motion.size == 0
    second = problem.drive.times_of(1)
    at = np.flatnonzero(fitted.trajectory.states[second, 0] == curve.loop_motion[0])
    np.testing.assert_array_equal(
        fitted.trajectory.states[second, 0][at[0] : at[0] + curve.loop_motion.size], curve.loop_motion
    )
    # n = 1 loads from rest as dz/dd = 1 - z / y: an exponential
    loading = 200.0 * 0.003 * (1.0 - np.exp(-np.abs(curve.motion) / 0.003)) * np.sign(curve.motion)
    np.testing.assert_allclose(curve.force, loading, atol=4e-3 * np.abs(loading).max())  # stepped on the grid


# --- bins -------------------------------------------------------------------------------------------------------------


def test_bins_reach_from_end_to_end_and_hold_any_straight_line():
    motion = np.random.default_rng(1).standard_normal(5000)
    bins = bins_of(motion)
    assert bins.knots[0] == motion.min()
    assert bins.knots[-1] == motion.max()
    wide = np.linspace(-8.0, 8.0, 101)
    hats, slopes = bins.hats(wide)
    np.testing.assert_allclose(hats @ (3.0 + 2.0 * bins.knots), 3.0 + 2.0 * wide, atol=1e-9)
    np.testing.assert_allclose(slopes @ (3.0 + 2.0 * bins.knots), 2.0, atol=1e-9)
    np.testing.assert_allclose(bins.hats(bins.knots)[0], np.eye(12), atol=1e-12)


def test_periodic_bins_repeat():
    bins = bins_of(np.array([0.0]), period=0.25)
    at = np.linspace(0.0, 0.25, 40)
    np.testing.assert_allclose(bins.hats(at)[0], bins.hats(at + 1.5)[0], atol=1e-9)
    assert bins_of(np.ones(10)) is None


@pytest.mark.parametrize("period", [0.0, 0.7])
def test_the_hats_are_cubic_splines(period):
    """Of scipy; natural, or periodic; with values and slopes at the knots too."""
    bins = bins_of(np.random.default_rng(2).standard_normal(500), period=period)
    knots = np.append(bins.knots, period) if period else bins.knots
    heights = np.eye(12)[np.arange(len(knots)) % 12]
    kind = "periodic" if period else "natural"
    spline = scipy.interpolate.CubicSpline(knots, heights, bc_type=kind)
    at = np.concatenate([bins.knots, np.linspace(knots[0], knots[-1], 200)[:-1]])
    hats, slopes = bins.hats(at)
    np.testing.assert_allclose(hats, spline(at), atol=1e-10)
    np.testing.assert_allclose(slopes, spline(at, 1), atol=1e-10 * np.abs(slopes).max())


def test_the_same_model_gives_the_same_curves():
    rng = np.random.default_rng(11)
    inputs = excitations(rng, [0.5, 1.0, 2.0])
    plant, problem, fitted = fitted_to(*measured(rng, inputs, chain(inputs, cubic)), "cubic_stiffness", [1e5])
    spread = covariance(fitted, problem)
    (first,), (second,) = (law_curves(fitted, problem, plant, spread) for _ in range(2))
    np.testing.assert_array_equal(first.points_force, second.points_force)
    np.testing.assert_array_equal(first.points_deviation, second.points_deviation)
    assert scipy.stats.chi2.sf(np.sum(scores(first, lambda d: cubic(d, 0.0, 0.0)) ** 2), 12) > 1e-5


# --- the band of a law of unknown form: the whole curve at once -------------------------------------------------------


@pytest.mark.parametrize("n_points", [1, 4, 9, 15])
def test_a_band_of_its_reach_holds_a_whole_curve_in_ninety_five_of_a_hundred_draws(n_points):
    rng = np.random.default_rng([n_points, 5])
    at = np.linspace(-1.0, 1.0, 201)
    if n_points == 1:
        basis = at[:, np.newaxis] ** 2
    else:
        basis = scipy.interpolate.CubicSpline(np.linspace(-1.0, 1.0, n_points), np.eye(n_points))(at)
    root = rng.standard_normal((n_points, n_points))
    spread = root @ root.T
    curves = rng.standard_normal((20_000, n_points)) @ root.T @ basis.T
    deviation = np.sqrt(np.einsum("np,pq,nq->n", basis, spread, basis))
    held = np.mean(np.all(np.abs(curves) <= whole_reach(basis, spread) * deviation + 1e-12, axis=1))
    assert 0.94 < held < 0.97
