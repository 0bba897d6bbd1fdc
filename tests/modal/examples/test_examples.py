"""The struck mass against the figures of its source and against algebra; the demo against a general integrator."""

from xml.parsers import expat

import numpy as np
import pytest
import scipy
from typer.testing import CliRunner

from modal.command import run as job
from modal.command.main import app
from modal.examples import demo, struck_mass
from modal.examples.demo import demo_geometry
from modal.examples.struck_mass import (
    StruckMass,
    frequency_and_damping,
    full_order_model,
    hankel,
    measured_samples,
    reduced_model,
    sampled_pulse,
    singular_value_shares,
    step_response,
    study,
    truncated_model,
)
from modal.geometry.sensors import Geometry
from modal.modes.mode import ModalModel, Mode
from okid.errors import InsufficientDataError, InvalidDataError

TRUTH = StruckMass()
SEEDS = range(20)


def blow(n, seed, noise=0.027):
    return measured_samples(TRUTH, 2 * n + 1, noise=noise, rng=np.random.default_rng(seed))


def test_closed_form_of_the_sampled_mass_equals_the_matrix_exponential():
    A = np.array([[0, 1], [-TRUTH.stiffness / TRUTH.mass, -TRUTH.damping / TRUTH.mass]])
    exact = scipy.linalg.expm(np.block([[A, np.array([[0], [1 / TRUTH.mass]])], [np.zeros((1, 3))]]) * TRUTH.dt)
    np.testing.assert_allclose(TRUTH.model().A, exact[:2, :2], atol=1e-14)
    np.testing.assert_allclose(TRUTH.model().B, exact[:2, 2], atol=1e-14)


def test_a_push_of_one_tick_is_an_impulse_in_the_middle_of_the_tick():
    """A Dirac at t = 0 is about a tenth wrong at w0 dt = 0.2, one at dt / 2 only (w0 dt)^2 / 24 = 0.17 %."""
    natural, damped = TRUTH.angular_frequency, TRUTH.angular_frequency * np.sqrt(1 - TRUTH.damping_ratio**2)

    def dirac(at):
        time = TRUTH.dt * np.arange(1, 200) - at
        decay = np.exp(-TRUTH.damping_ratio * natural * time)
        return TRUTH.dt / (TRUTH.mass * damped) * decay * np.sin(damped * time)

    pulse = sampled_pulse(TRUTH.model(), 200)[1:]
    early, middle = (np.linalg.norm(dirac(at) - pulse) / np.linalg.norm(pulse) for at in (0.0, TRUTH.dt / 2))
    assert early == pytest.approx(0.099, abs=0.003)
    assert middle == pytest.approx(0.2**2 / 24, rel=0.1)


@pytest.mark.parametrize("seed", SEEDS)
def test_full_order_model_repeats_all_its_samples_noise_included(seed):
    """2N unknowns, 2N samples: N = 10, and N = 4 where even a bad matrix does not lose digits."""
    for n in (4, 10):
        samples = blow(n, seed)
        error = np.abs(sampled_pulse(full_order_model(samples), 2 * n + 1) - samples).max() / np.abs(samples).max()
        assert error < 1e-10 * np.linalg.cond(hankel(samples, 1))


def test_full_order_model_of_many_samples_has_growing_poles():
    """N = 40 and 100: many unstable poles; the reduced model of the same data is stable."""
    for n in (40, 100):
        results = [study(TRUTH, blow(n, seed)) for seed in range(5)]
        assert min(result.unstable_poles for result in results) > n // 5
        assert all(np.abs(np.linalg.eigvals(result.reduced.A)).max() < 1 for result in results)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("n", [10, 25, 100])
def test_nothing_changes_between_truncated_and_reduced_with_the_projector(n, seed):
    samples = blow(n, seed)
    for order in (1, 2, 5):
        reduced = sampled_pulse(reduced_model(samples, order), n)
        truncated = sampled_pulse(truncated_model(samples, order), n)
        np.testing.assert_allclose(truncated, reduced, atol=1e-11 * np.abs(reduced).max())


def test_something_changes_without_the_projector():
    """About 0.4 % on the noisy example, and nothing without noise, where two directions are all there are."""
    differences = []
    for seed in SEEDS:
        samples = blow(25, seed)
        reduced = sampled_pulse(reduced_model(samples, 2), 50)
        without = sampled_pulse(truncated_model(samples, 2, projector="none"), 50)
        differences.append(np.linalg.norm(without - reduced) / np.linalg.norm(reduced))
    assert 0.001 < np.median(differences) < 0.01
    clean = blow(25, 0, noise=0.0)
    np.testing.assert_allclose(
        sampled_pulse(truncated_model(clean, 2, projector="none"), 50), sampled_pulse(TRUTH.model(), 50), atol=1e-12
    )


@pytest.mark.parametrize(("n", "share"), [(100, 0.55), (50, 0.75), (25, 0.87)])
def test_pareto_shares_are_those_measured_before(n, share):
    """Noise of 2.7 % of the peak: the share of the sum is an artefact of N; mean over seeds within 0.03 of THEORY 1."""
    shares = [singular_value_shares(blow(n, seed)) for seed in SEEDS]
    assert np.mean([s.sum_share[1] for s in shares]) == pytest.approx(share, abs=0.03)
    assert all(s.order == 2 for s in shares)
    if n == 100:
        assert np.mean([s.energy_share[1] for s in shares]) == pytest.approx(0.982, abs=0.005)
        assert np.mean([s.gap[1] for s in shares]) == pytest.approx(23, rel=0.1)


def test_exact_samples_give_the_exact_mode():
    frequency, damping_ratio = frequency_and_damping(reduced_model(blow(30, 0, noise=0.0), 2), TRUTH.dt)
    assert frequency == pytest.approx(TRUTH.frequency, rel=1e-10)
    assert damping_ratio == pytest.approx(TRUTH.damping_ratio, rel=1e-9)
    assert TRUTH.frequency == pytest.approx(0.31831, abs=5e-6)


def test_two_states_answer_better_than_the_noise():
    """Over 20 blows of N = 100 no response is as wrong as the noise of 2.7 %; frequency and damping are unbiased."""
    results = [study(TRUTH, blow(100, seed)) for seed in SEEDS]
    assert max(result.pulse_error for result in results) < 0.027
    assert max(result.step_error for result in results) < 0.027
    for name, true in (("frequency", TRUTH.frequency), ("damping_ratio", TRUTH.damping_ratio)):
        found = np.array([getattr(result, name) for result in results])
        assert abs(found.mean() - true) < 4 * found.std() / np.sqrt(len(found)) + 1e-3 * true
        assert np.abs(found / true - 1).max() < (0.01 if name == "frequency" else 0.06)


@pytest.mark.parametrize("seed", range(5))
def test_the_packages_find_the_same_mode(seed):
    """Order, frequency and damping of the few lines of the example, from the code for any number of channels."""
    samples = blow(100, seed)
    (mode,) = struck_mass.by_the_packages(TRUTH, samples)
    frequency, damping_ratio = frequency_and_damping(reduced_model(samples, 2), TRUTH.dt)
    assert mode.frequency == pytest.approx(frequency, rel=1e-10)
    assert mode.damping_ratio == pytest.approx(damping_ratio, rel=1e-9)


def test_step_is_the_sum_of_pulses():
    model, state, steps = TRUTH.model(), np.zeros(2), []
    for _ in range(50):
        steps.append(model.C @ state)
        state = model.A @ state + model.B
    np.testing.assert_allclose(step_response(model, 50), steps, atol=1e-14)


def test_too_few_samples_say_so():
    with pytest.raises(InsufficientDataError, match="needs 5 samples or more, but there are 4"):
        full_order_model(np.ones(4))


def test_struck_mass_runs_and_writes_its_pictures(tmp_path, capsys):
    assert struck_mass.main(["-o", str(tmp_path / "pictures")]) == 0
    pictures = sorted((tmp_path / "pictures").iterdir())
    assert [picture.name[0] for picture in pictures] == ["1", "2", "3", "4"]
    assert all(expat.ParserCreate().Parse(picture.read_bytes(), True) == 1 for picture in pictures)
    assert "true 0.3183" in capsys.readouterr().out


# --- the demo --------------------------------------------------------------------------------------------------------


def test_demo_is_integrated_right():
    """Against an adaptive Runge-Kutta of order 8 on M x'' + C x' + K x = F, interval by interval."""
    record = demo.demo_record(np.random.default_rng(3), n_samples=60, noise=0.0)
    mass, damping, stiffness, force_map = demo.tower_matrices()
    clean = demo.demo_record(np.random.default_rng(3), n_samples=60, noise=0.0)
    np.testing.assert_array_equal(clean.outputs, record.outputs)  # the same generator, the same record
    state = np.random.default_rng(8).standard_normal(12) * 1e-3
    outputs = []

    def motion(x, v, force):
        return np.linalg.solve(mass, force_map @ force - damping @ v - stiffness @ x)

    wanted = demo._integrate(record.inputs, state)
    for force in record.inputs:
        outputs.append([*motion(state[:6], state[6:], force)[:5], state[5] - state[4]])
        step = scipy.integrate.solve_ivp(
            lambda _, s, force=force: np.concatenate([s[6:], motion(s[:6], s[6:], force)]),
            (0.0, demo.TOWER.dt),
            state,
            method="DOP853",
            rtol=1e-11,
            atol=1e-13,
        )
        state = step.y[:, -1]
    size = np.abs(outputs).max(axis=0)
    np.testing.assert_allclose(wanted / size, np.array(outputs) / size, atol=1e-8)


def test_demo_truth_solves_the_quadratic_eigenvalue_problem():
    truth = demo.demo_truth()
    mass, damping, stiffness, _ = demo.tower_matrices()
    natural = 2 * np.pi * truth.frequencies
    poles = natural * (-truth.damping_ratios + 1j * np.sqrt(1 - truth.damping_ratios**2))
    for pole, shape in zip(poles, truth.shapes.T, strict=True):
        matrix = pole**2 * mass + pole * damping + stiffness
        assert np.linalg.svd(matrix, compute_uv=False)[-1] < 1e-9 * np.linalg.norm(matrix)
        positions = np.append(shape[:5] / pole**2, shape[5] + shape[4] / pole**2)
        assert np.linalg.norm(matrix @ positions) < 1e-9 * np.linalg.norm(matrix) * np.linalg.norm(positions)
    assert truth.frequencies[1] / truth.frequencies[0] < 1.1  # a close pair
    np.testing.assert_allclose(np.abs(truth.shapes).max(axis=0), 1.0)


def test_demo_record_is_what_its_story_says():
    record = demo.demo_record(np.random.default_rng(0), n_samples=4000)
    assert 0 < np.isnan(record.outputs).sum() < 0.001 * record.outputs.size
    assert not np.isnan(record.inputs).any()
    assert set(record.output_units) == {"m/s^2", "m"}
    spectrum = np.abs(np.fft.rfft(record.inputs, axis=0)) ** 2
    assert (spectrum[:400].mean(axis=0) > 4 * spectrum[-400:].mean(axis=0)).all()  # coloured, not white
    assert record.output_names == demo.demo_truth().output_names


def test_comparison_pairs_one_to_one_and_leaves_noise_out():
    truth = demo.demo_truth()

    def mode(frequency, shape, verdict="system"):
        return Mode(
            pole=complex(-0.01, 1.0) * 2 * np.pi * frequency,
            kind="oscillatory",
            frequency=frequency,
            damping_ratio=0.01,
            shape=shape,
            participation=np.ones(2, dtype=complex),
            verdict=verdict,
        )

    close = [mode(truth.frequencies[i] * 1.001, 2j * truth.shapes[:, i]) for i in (0, 1)]
    noise = mode(truth.frequencies[2], truth.shapes[:, 2], verdict="noise")
    found = demo.compare_with_truth(truth, ModalModel(modes=(*close, noise), dt=demo.TOWER.dt, indicator_caution=0.1))
    assert [row.verdict for row in found] == ["system", "system", None, None, None, None]
    assert found[1].found_frequency == pytest.approx(truth.frequencies[1] * 1.001)
    assert found[0].assurance == pytest.approx(1.0)
    assert np.isnan(found[2].found_frequency)


def test_the_floors_of_the_demo_stand_where_its_truth_says_and_move_as_their_sensors_do():
    geometry, truth = demo_geometry(), demo.demo_truth()
    heights = {sensor.name: geometry.positions[sensor.node, 2] for sensor in geometry.sensors}
    measured = [name for name in truth.output_names if name != "tuned_mass"]  # it moves relative to the roof: no node
    assert list(heights) == measured
    np.testing.assert_allclose([heights[name] for name in measured], truth.heights[: len(measured)])
    shape = truth.shapes[:, 3]
    moved = geometry.deflection(shape, truth.output_names)
    for floor, component in enumerate(np.append(0.0, shape[:5])):
        corners = np.flatnonzero(np.isclose(geometry.positions[:, 2], floor * demo.TOWER.height))
        assert len(corners) == 4
        np.testing.assert_allclose(moved[corners], [[component, 0, 0]] * 4, atol=1e-12)


def test_the_demo_is_reported_on_its_tower(monkeypatch, tmp_path, identification):
    """Unless a file names another geometry."""
    seen, other = [], Geometry(node_names=("1",), positions=[[0.0, 0.0, 0.0]])

    def write_report(_result, _folder, *, geometry, **_options):
        seen.append(geometry)
        raise InvalidDataError("no report is wanted.")

    monkeypatch.setattr("modal.command.run.identify", lambda _records, **_options: identification)
    monkeypatch.setattr("modal.command.run.write_report", write_report)
    for named in (None, other):
        monkeypatch.setattr(job, "read_setup", lambda _job, named=named: (None, named))
        result = CliRunner().invoke(app, ["demo", "-o", str(tmp_path)])
        assert "no report is wanted" in result.stderr
    assert seen[0].node_names == demo_geometry().node_names
    assert seen[1] is other
