"""Changes of K and C of a structure: what they hold, what they do not, and their priors."""

import numpy as np
import pytest
import scipy
from chains import Chain

from modal.discrepancy.motion_rows import motion_of_outputs
from modal.discrepancy.reciprocity import Structure, reciprocal_structure
from modal.discrepancy.symmetric_changes import symmetric_changes


def found_of(chain):
    return reciprocal_structure(chain.system, chain.system.C, chain.free)


def changes(chain, **tolerances):
    motions = motion_of_outputs(chain.system, ("displacement",) * len(chain.system.C), ("",) * len(chain.system.C))
    options = {"frequency_tolerance": 0.1, "damping_tolerance": 0.5, **tolerances}
    return symmetric_changes(chain.system.A, found_of(chain), motions, **options)


def in_chain_states(chain, slope):
    """d(M^-1 K) and d(M^-1 C) of one slope, from the lower half of [x; v]' = A [x; v]."""
    n = len(chain.masses)
    upper = slope[: 2 * n] @ chain.states
    change = np.linalg.solve(chain.states, upper)
    np.testing.assert_allclose(change[:n], 0.0, atol=1e-8 * np.abs(change).max())
    return -change[n:, :n] * chain.masses[:, None], -change[n:, n:] * chain.masses[:, None]


@pytest.mark.parametrize("sensors", [(0, 1, 2), (0, 2)])
def test_they_are_all_symmetric_changes_of_stiffness_and_damping_and_nothing_else(sensors):
    chain = Chain(1, 3, sensors, sensors[0])
    found = changes(chain)
    assert len(found.parameters) == 6 + 6
    stiffness, damping = zip(*(in_chain_states(chain, slope) for slope in found.slopes), strict=True)
    for matrices, still in ((stiffness[:6], damping[:6]), (damping[6:], stiffness[6:])):
        largest = max(np.abs(one).max() for one in matrices)
        for one, other in zip(matrices, still, strict=True):
            np.testing.assert_allclose(one, one.T, atol=1e-6 * largest)
            assert np.abs(other).max() < 1e-4 * largest * 10  # rad/s apart
        assert np.linalg.matrix_rank([one.ravel() for one in matrices], tol=1e-6 * largest) == 6


def test_the_gain_of_a_sensor_is_none_of_them():
    """In y' = g y the stiffness is G K G^-1: of all linear forces it is one, of symmetric ones it is not."""
    chain = Chain(2, 3, (0, 1, 2), 1)
    found = changes(chain)
    gains = np.diag([1.0, 1.0, 1.2])
    inverse = np.diag(1 / chain.masses)
    wanted = inverse @ chain.stiffness - gains @ inverse @ chain.stiffness @ np.linalg.inv(gains)
    basis = np.array([(inverse @ in_chain_states(chain, slope)[0]).ravel() for slope in found.slopes[:6]])
    weights, *_ = np.linalg.lstsq(basis.T, wanted.ravel(), rcond=None)
    left = wanted.ravel() - weights @ basis
    assert np.linalg.norm(left) > 0.3 * np.linalg.norm(wanted)


def test_the_prior_does_not_depend_on_the_coordinates_of_the_modes():
    """K^(-1/2) dK K^(-1/2) has independent entries, 0.2 on the diagonal: the share of a spring common to all has 0.2.

    A rotation of such a matrix has the same distribution, here by the variance of any quadratic form u' E u.
    """
    chain = Chain(3, 3, (0, 1, 2), 0)
    structure, found = found_of(chain), changes(chain)
    natural = np.sqrt(structure.stiffness)
    pairs = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
    spread = [
        one.deviation / (natural[a] * natural[b]) for one, (a, b) in zip(found.parameters[:6], pairs, strict=True)
    ]
    for u in scipy.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]:
        variance = sum((s * u[a] * u[b] * (1 if a == b else 2)) ** 2 for s, (a, b) in zip(spread, pairs, strict=True))
        assert np.sqrt(variance) == pytest.approx(0.2)


def test_nominal_values_and_bounds():
    chain = Chain(4, 2, (0, 1), 1)
    structure, found = found_of(chain), changes(chain)
    values = [one.nominal for one in found.parameters]
    np.testing.assert_allclose(values[:3], [structure.stiffness[0], 0.0, structure.stiffness[1]], atol=1e-9)
    np.testing.assert_allclose(values[3:], structure.damping[np.triu_indices(2)])
    names = [one.name.split(" (")[0] for one in found.parameters]
    assert names[0] == "stiffness of mode 1"
    assert names[1] == "stiffness between modes 1 and 2"
    assert names[5] == "damping of mode 2"
    for one in (found.parameters[0], found.parameters[2], found.parameters[3], found.parameters[5]):
        assert 0.0 <= one.lower < one.nominal < one.upper
    for word in (found.parameters[1], found.parameters[4]):  # never beyond what leaves the matrix positive by far
        assert word.upper - word.nominal == pytest.approx(3 * word.deviation)


def test_an_undamped_mode_may_be_damped():
    chain = Chain(5, 2, (0, 1), 0)
    given = found_of(chain)
    undamped = Structure(
        displacements=given.displacements, forces=given.forces, stiffness=given.stiffness, damping=np.zeros((2, 2))
    )
    motions = motion_of_outputs(chain.system, ("displacement",) * 2, ("",) * 2)
    found = symmetric_changes(chain.system.A, undamped, motions, frequency_tolerance=0.1, damping_tolerance=0.5)
    damping = found.parameters[3]
    assert damping.lower == 0.0
    assert damping.deviation == pytest.approx(2 * 0.02 * np.sqrt(given.stiffness[0]))


def test_many_modes_are_too_many():
    n = 9
    structure = Structure(
        displacements=np.eye(n, 2 * n), forces=np.eye(2 * n, n), stiffness=np.arange(1.0, n + 1), damping=np.eye(n)
    )
    assert symmetric_changes(np.eye(2 * n), structure, (), frequency_tolerance=0.1, damping_tolerance=0.5) is None
