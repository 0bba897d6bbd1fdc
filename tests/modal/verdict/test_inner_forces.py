"""A spring of a struck chain that is not linear is told, with the modes of small motion; what is linear is not.

Records come from the Runge-Kutta rule of `nonlinear_chain`; the truth of small motion from the chain's matrices.
"""

import re
from dataclasses import replace

import numpy as np
import pytest
import scipy
from nonlinear_chain import no_force, run_chain
from systems import chain_matrices

import modal
from modal.modes.mode import ModalModel, Mode
from modal.verdict.inner_forces import InnerForces, inner_forces_of, told_of_inner_forces
from okid.record import Record

MASSES, STIFFNESSES, DAMPINGS = [1.0, 1.3, 0.8], [5200.0, 6100.0, 4300.0], [0.9, 0.7, 0.8]
DT = 0.008


def small_motion():
    """(n_modes,) poles [rad/s], above the real axis."""
    mass, damping, stiffness = chain_matrices(MASSES, STIFFNESSES, DAMPINGS)
    inverse = np.linalg.inv(mass)
    poles = scipy.linalg.eigvals(np.block([[np.zeros((3, 3)), np.eye(3)], [-inverse @ stiffness, -inverse @ damping]]))
    return sorted(poles[poles.imag > 0], key=abs)


def struck(*, cubic=0.0, quadratic=0.0, noise=0.003, blows=(20,), n=1600, seed=1, wind=0.0, element=1, start=None):
    """Displacements of a chain after short blows; forces of the spring are shares of its linear one at 6 mm."""
    rng = np.random.default_rng(seed)
    force = np.zeros((1, n))
    for i, blow in enumerate(blows):
        force[0, blow : blow + 3] += np.array([0.5, 1.0, 0.5]) * (45.0 if i % 2 == 0 else 25.0)
    k = STIFFNESSES[element]

    def law(d, v, t):
        return k * (quadratic * d * d / 0.006 + cubic * d**3 / 0.006**2)

    acting = force + wind * rng.standard_normal(force.shape)
    moved = run_chain(
        MASSES, STIFFNESSES, DAMPINGS, acting, DT, force_dof=2, law=law if cubic or quadratic else no_force,
        element=element, n_steps=8, start=start,
    )[0]  # fmt: skip
    outputs = moved + noise * moved.std(axis=0) * rng.standard_normal(moved.shape)
    return Record(force[0][:, np.newaxis] if blows else np.zeros((n, 0)), outputs, DT)


def said(result):
    return [words for words in result.warnings if "with an inner force" in words]


def off(mode, truth):
    """Stated deviations by which frequency and damping ratio are off those of a pole."""
    frequency, ratio = abs(truth) / (2 * np.pi), -truth.real / abs(truth)
    return (
        abs(mode.frequency - frequency) / mode.frequency_std,
        abs(mode.damping_ratio - ratio) / mode.damping_ratio_std,
    )


@pytest.fixture(scope="module")
def hardening():
    return modal.identify(struck(cubic=0.1))


def test_a_cubic_spring_of_several_masses_is_told(hardening):
    """Nothing was said, and up to eight modes of three were certain."""
    (words,) = said(hardening)
    assert words.startswith("Something is not linear: three modes")
    rings = [float(number) for number in re.findall(r"([0-9.]+) Hz [(]", words)]
    np.testing.assert_allclose(rings, [abs(pole) / (2 * np.pi) for pole in small_motion()], rtol=3e-3)


def test_only_modes_of_the_structure_stay_certain(hardening):
    certain = hardening.modes.system
    assert certain
    for mode in certain:
        nearest = min(small_motion(), key=lambda pole: abs(abs(pole) / (2 * np.pi) - mode.frequency))
        assert max(off(mode, nearest)) < 3.0
    assert len({round(mode.frequency) for mode in certain}) == len(certain)


def test_interval_and_table_say_the_same(hardening):
    stated = [mode.frequency_std for mode in hardening.modes.modes]
    np.testing.assert_array_equal(hardening.uncertainty.frequency_std, stated)


def test_a_linear_chain_is_not():
    result = modal.identify(struck(blows=(20, 700)))
    assert not said(result)
    assert len(result.modes.system) == 3


def modes_of(poles, n_outputs=3):
    rng = np.random.default_rng(0)
    return ModalModel(
        modes=tuple(
            Mode(
                pole=complex(pole), kind="oscillatory", frequency=abs(pole) / (2 * np.pi),
                damping_ratio=-pole.real / abs(pole), shape=rng.standard_normal(n_outputs) + 0j,
                participation=np.ones(1) + 0j, verdict="system", frequency_std=1e-3, damping_ratio_std=1e-4,
            )
            for pole in poles
        ),
        dt=DT,
        indicator_caution=0.1,
    )  # fmt: skip


def linear_modes(extra=()):
    """The chain's own modes, with poles beside them that follow anything."""
    mass, damping, stiffness = chain_matrices(MASSES, STIFFNESSES, DAMPINGS)
    inverse = np.linalg.inv(mass)
    values, vectors = np.linalg.eig(
        np.block([[np.zeros((3, 3)), np.eye(3)], [-inverse @ stiffness, -inverse @ damping]])
    )
    model = modes_of([*small_motion(), *extra])
    own = [vectors[:3, np.abs(values - pole).argmin()] for pole in small_motion()]
    return replace(
        model,
        modes=tuple(replace(mode, shape=own[i]) if i < 3 else mode for i, mode in enumerate(model.modes)),
    )


def test_poles_of_small_motion_are_those_of_the_chain(hardening):
    """Whatever the linear model made of its spring: within 0.1 % for the first two, a tenth of their damping."""
    found = inner_forces_of(hardening.modes, [hardening.records[0]])
    assert found is not None
    assert found.n_linear > 3
    for pole, truth in zip(found.ordered, small_motion(), strict=True):
        assert abs(pole - truth) < 0.15 * abs(truth.real)


@pytest.mark.parametrize(
    "kind",
    [{}, {"noise": 0.02}, {"blows": (20, 700)}, {"wind": 0.1}, {"wind": 0.5}, {"noise": 1e-6}],
    ids=["one blow", "noisy", "two blows", "wind", "storm", "nearly exact"],
)
@pytest.mark.parametrize("seed", range(3))
def test_what_is_linear_needs_no_inner_forces(kind, seed):
    assert inner_forces_of(linear_modes(), [struck(seed=seed, **kind)]) is None


def test_a_linear_model_that_is_too_large_is_not_refused_for_inner_forces():
    """Forty poles that follow noise cost more numbers than two powers of a motion do; three modes cost least."""
    rng = np.random.default_rng(5)
    crowd = -rng.uniform(0.5, 3.0, 40) + 1j * rng.uniform(10.0, 370.0, 40)
    assert inner_forces_of(linear_modes(crowd), [struck()]) is None


def test_none_without_blows_or_without_rows():
    modes = linear_modes()
    record = struck(cubic=0.05)
    assert inner_forces_of(modes, [Record(np.zeros((1600, 0)), record.outputs, DT)]) is None
    assert inner_forces_of(modes, [record.samples(0, 40)]) is None
    assert inner_forces_of(replace(modes, modes=()), [record]) is None


def test_missing_samples_are_left_out(hardening):
    record = struck(cubic=0.1)
    holes = record.outputs.copy()
    holes[200:260, 0] = np.nan
    holes[900, :] = np.nan
    whole, found = (
        inner_forces_of(hardening.modes, [Record(record.inputs, one, DT)]) for one in (record.outputs, holes)
    )
    assert whole is not None
    assert found is not None
    np.testing.assert_allclose(np.sort_complex(found.poles), np.sort_complex(whole.poles), rtol=1e-3)


def test_a_release_is_asked_as_a_blow_is():
    """A chain that was let go of, its middle spring hardening: one line may be told before as an oscillator is."""
    start = np.array([[0.004, 0.01, 0.012, 0.0, 0.0, 0.0]])
    bent = modal.identify(struck(cubic=0.1, blows=(), start=start), kind="decay")
    assert any("not linear" in words for words in bent.warnings)


def test_modes_near_small_motion_stay_and_are_less_sure():
    poles = np.array([-0.5 + 40.0j, -0.7 + 41.0j, -0.4 + 90.0j, -0.3 + 130.0j])
    found = InnerForces(poles=np.array([-0.5 + 40.1j, -0.45 + 90.0j]), share=0.2, n_linear=4)
    answer = told_of_inner_forces(modes_of(poles), found)
    assert [mode.verdict for mode in answer.modes.modes] == ["system", "doubtful", "system", "doubtful"]
    first, _, third, _ = answer.modes.modes
    assert first.frequency_std == pytest.approx(0.1 / (2 * np.pi) / 1.96, rel=0.01)
    assert third.damping_ratio_std == pytest.approx(np.hypot(1e-4, 0.05 / 90 / 1.96), rel=0.01)
    assert "two modes with an inner force" in answer.warnings[0]
