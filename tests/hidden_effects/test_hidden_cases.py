"""The generators: what they promise about their cases, and that they know nothing of the product."""

import ast
from dataclasses import replace
from pathlib import Path

import hidden_cases
import numpy as np
import pytest
import scipy
from hidden_cases import bounded, cases, contact_reached, gap_beyond_linear, hidden_case, repeatable
from hidden_kinds import FAMILIES, KINDS, PAIRS, STRUCTURE
from hidden_truth import Experiment, TrueChain, Truth, clean_outputs
from hidden_types import HiddenEffect, NominalChain, NominalMotor, NominalStateSpace

FOLDER = Path(__file__).parent


@pytest.mark.parametrize("path", sorted(FOLDER.glob("hidden_*.py")), ids=lambda path: path.name)
def test_nothing_is_imported_but_numpy_scipy_and_the_standard_library(path):
    own = {file.stem for file in FOLDER.glob("hidden_*.py")}
    allowed = own | {"numpy", "scipy", "dataclasses"}
    tree = ast.parse(path.read_text())
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            roots = {name.name.split(".")[0] for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            roots = {node.module.split(".")[0]}
            assert node.level == 0
        else:
            continue
        assert roots <= allowed


LINEAR = {"input_gain", "input_saturation", "missing_mode", "sensor_gain", "overflow"}


def quick_seed(kind):
    """A seed whose effects need no small steps, if the kind has one."""
    linear = [i for i, effects in enumerate(KINDS[kind].effects) if set(effects) <= LINEAR]
    return linear[0] if linear else 0


@pytest.mark.parametrize("kind", KINDS)
def test_a_case_holds_what_it_promises(kind):
    seed = quick_seed(kind)
    first = next(cases(kind, [seed]))
    assert tuple(e.effect for e in first.effects) == KINDS[kind].effects[seed % len(KINDS[kind].effects)]
    assert len(first.fit) in (2, 3)
    assert len(first.held_out) == 1
    fitted, held = [r.level for r in first.fit], first.held_out[0].level
    assert min(fitted) < held < max(fitted)
    assert min(abs(held / level - 1) for level in fitted) > 0.1
    records = first.fit + first.held_out
    assert all(1500 <= len(r.outputs) <= 4096 and np.all(np.isfinite(r.outputs)) for r in records)
    low, high = KINDS[kind].noise
    for r in records:
        share = np.sqrt(r.noise_variance) / r.clean_outputs.std(axis=0)
        assert np.all((share > 0.999 * low) & (share < 1.001 * high))
        # and the noise that was added has that variance, within five deviations of an estimate from n samples
        found = np.var(r.outputs - r.clean_outputs, axis=0)
        np.testing.assert_allclose(found, r.noise_variance, rtol=5 * np.sqrt(2 / len(r.outputs)))
    assert len(first.gap_to_noise) == len(first.effects)
    assert min(first.gap_to_noise, default=1.0) > 0.5 - 0.001


def test_a_case_follows_from_its_seed():
    kind = "1dof_displacement"
    seed = quick_seed(kind)
    first, again, other = (hidden_case(kind, s) for s in (seed, seed, seed + len(KINDS[kind].effects)))
    for one, two in zip(first.fit + first.held_out, again.fit + again.held_out, strict=True):
        np.testing.assert_array_equal(one.outputs, two.outputs)
    assert not np.array_equal(other.fit[0].outputs[:9], first.fit[0].outputs[:9])


@pytest.mark.parametrize("seed", range(5))
def test_the_nominal_model_is_wrong_by_as_much_as_said_and_no_more(seed):
    case = hidden_case("3dof_displacement", 15 + 18 * seed)  # an input gain: quick
    nominal = case.nominal
    assert isinstance(nominal, NominalChain)
    np.testing.assert_array_equal(nominal.masses, case.truth["masses"])
    stiffness, damping = nominal.stiffnesses / case.truth["stiffnesses"], nominal.dampings / case.truth["dampings"]
    assert np.all(np.abs(stiffness - 1) <= 0.05)
    assert np.all(np.abs(damping - 1) <= 0.3)
    assert np.ptp(stiffness) > 0.001
    assert np.ptp(damping) > 0.01


def test_samples_a_period_and_an_empty_upper_band():
    for case in (hidden_case("3dof_displacement", seed) for seed in (15, 33, 51)):
        truth, record = case.truth, case.held_out[0]
        chain = TrueChain(
            masses=truth["masses"], stiffnesses=truth["stiffnesses"], dampings=truth["dampings"], force_dofs=(0,),
            sensor_dofs=(0,), sensor_kind="displacement",
        )  # fmt: skip
        samples = 2 * np.pi / chain.natural_frequencies / record.dt
        assert samples[0] >= 30
        assert samples[-1] > 11.99
        spectrum = np.abs(np.fft.rfft(record.inputs[:, 0] * np.hanning(len(record.inputs)))) ** 2
        assert spectrum[len(spectrum) // 2 :].sum() < 1e-6 * spectrum.sum()


def test_state_space_in_meaningless_coordinates_is_the_same_system_to_inputs_and_forces():
    """Poles of the nominal state space against its own chain, and the force per effective mass at a pair of outputs."""
    drawn, known = [], hidden_cases._as_named

    def watched(effect, plant, sort):
        drawn.append(effect)
        return known(effect, plant, sort)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(hidden_cases, "_as_named", watched)
        case = hidden_case("state_space", 17)  # a cubic spring between two outputs
    nominal, effect = case.nominal, case.effects[0]
    assert isinstance(nominal, NominalStateSpace)
    off = np.sort(np.abs(np.linalg.eigvals(nominal.A)))[::2]
    true = chain_of(case).natural_frequencies
    assert np.all(np.abs(off / true - 1) < 0.03)
    assert np.any(np.abs(off / true - 1) > 1e-4)
    assert effect.place == "output_1-output_2"
    masses = case.truth["masses"]
    assert drawn[0].place == "element_2"
    assert effect.parameters["k3"] == pytest.approx(drawn[0].parameters["k3"] * (1 / masses[1] + 1 / masses[2]))


def chain_of(case):
    return TrueChain(
        masses=case.truth["masses"], stiffnesses=case.truth["stiffnesses"], dampings=case.truth["dampings"],
        force_dofs=(0,), sensor_dofs=(0,), sensor_kind="displacement",
    )  # fmt: skip


def test_motor_and_tank():
    motor, tank = hidden_case("motor_propeller", 0), hidden_case("tank", 1)
    assert isinstance(motor.nominal, NominalMotor)
    assert not motor.nominal.is_flow
    assert tank.nominal.is_flow
    assert motor.truth["J"][0] == motor.nominal.J
    assert motor.nominal.b != motor.truth["b"][0]
    assert tank.effects[0].effect == "overflow"
    assert max(r.clean_outputs.max() for r in tank.fit) == tank.effects[0].parameters["limit"]
    assert min(r.clean_outputs.min() for r in tank.fit) > 0


def test_every_effect_and_pairs_of_every_family_take_turns():
    effects = KINDS["1dof_displacement"].effects
    assert {e for (e,) in effects} == set(STRUCTURE)
    assert len(STRUCTURE) == 18
    assert all(FAMILIES[a] != FAMILIES[b] for a, b in PAIRS)
    assert {FAMILIES[e] for pair in PAIRS[:60] for e in pair} == {FAMILIES[e] for pair in PAIRS for e in pair}


# --- guards ----------------------------------------------------------------------------------------------------------

ONE = TrueChain(
    masses=np.ones(1), stiffnesses=np.array([400.0]), dampings=np.array([0.4]), force_dofs=(0,), sensor_dofs=(0,),
    sensor_kind="displacement",
)  # fmt: skip


def experiment(size=10.0, n_samples=800):
    u = np.random.default_rng(0).standard_normal((2, n_samples, 1))
    u = size * scipy.signal.lfilter([0.1], [1, -0.9], u, axis=1) * np.array([1.0, 3.0])[:, np.newaxis, np.newaxis]
    return Experiment(inputs=u, starts=np.zeros((2, 2)), phases=np.zeros(2), dt=0.01, hold="zero_order")


def spring(effect, **values):
    return Truth(plant=ONE, effects=(HiddenEffect(effect=effect, place="element_0", parameters=values),))


def test_the_guard_sees_an_escape():
    linear, _ = clean_outputs(Truth(plant=ONE, effects=()), experiment())
    with np.errstate(all="ignore"):
        escaped, _ = clean_outputs(spring("cubic_stiffness", k3=-3e4), experiment())
    assert not bounded(escaped, linear)
    assert bounded(linear, linear)
    assert not bounded(np.where(np.arange(800)[:, np.newaxis] == 5, 7 * np.abs(linear).max(), linear), linear)


def test_the_guard_sees_chaos_and_lets_a_clock_pass():
    tame, wild = spring("cubic_stiffness", k3=2e3), spring("cubic_stiffness", k3=2e7)
    what = experiment(size=40.0)
    for truth, expected in ((tame, True), (wild, False)):
        outputs, _ = clean_outputs(truth, what)
        assert repeatable(truth, what, outputs, [1]) is expected


def test_the_guard_wants_contact_at_the_highest_level_only():
    stop = HiddenEffect(effect="gap_spring", place="element_0", parameters={"k_in": 0.0, "k_out": 1.0, "gap": 1.0})
    motion = np.array([0.9, 1.5])[:, np.newaxis, np.newaxis] * np.sin(np.linspace(0, 20, 500))[:, np.newaxis]
    assert contact_reached([stop], motion, 0, 1)
    assert not contact_reached([stop], 1.2 * motion, 0, 1)
    assert not contact_reached([stop], 0.8 * motion, 0, 1)
    loose = replace(stop, parameters={"k_in": -1.0, "k_out": 0.0, "gap": 1.0})
    assert contact_reached([loose], 1.2 * motion, 0, 1)


def test_what_a_wrong_stiffness_explains_is_no_gap():
    """A spring in parallel is a change of stiffness; a cubic spring of the same size is not."""
    what, noise = experiment(), np.full(1, 1e-6)
    plain, _ = clean_outputs(Truth(plant=ONE, effects=()), what)
    left = []
    for truth in (spring("gap_spring", k_in=0.3, k_out=0.3, gap=1.0), spring("cubic_stiffness", k3=3e3)):
        outputs, _ = clean_outputs(truth, what)
        raw = np.sqrt(np.mean((outputs[1] - plain[1]) ** 2 / noise))
        left.append(gap_beyond_linear(truth, what, outputs, noise, 1)[0] / raw)
    assert left[0] < 0.05
    assert 0.05 < left[1] <= 1
