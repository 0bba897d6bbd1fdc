"""A smooth law and the linear part beside it, told apart at rest: against fits of fewer points to a force measured."""

from types import SimpleNamespace

import numpy as np
import pytest
import scipy

from modal.discrepancy.selection.form_free import split_at_rest
from modal.effects.smooth_law import SmoothDamping

POINTS = np.sign(np.linspace(-1.0, 1.0, 9)) * np.abs(np.linspace(-1.0, 1.0, 9)) ** 1.5


def measured(force, noise):
    """Speeds and forces."""
    rng = np.random.default_rng(5)
    speed = np.concatenate([[-1.0, 1.0], rng.uniform(-1.0, 1.0, 1200)])
    return speed, 2.0 * speed + force(speed) + noise * rng.standard_normal(len(speed))


def fitted_law(speed, force, noise):
    """What a fit of damping and curve is to `split_at_rest`, and its covariance."""
    law, span = SmoothDamping(span=(-1.0, 1.0)), (-1.0, 1.0)
    units = np.eye(len(law.parameters) - 2)
    columns = np.column_stack([speed, *(law.curve((*span, *unit), speed) for unit in units)])
    found = np.linalg.lstsq(columns, force)[0]
    spread = np.zeros((len(found) + 2,) * 2)
    kept = np.r_[0, 3 : len(spread)]
    spread[np.ix_(kept, kept)] = noise**2 * np.linalg.inv(columns.T @ columns)
    item = SimpleNamespace(effect=law, where="joint", common=range(len(law.parameters)))
    assembly = SimpleNamespace(
        placements=(item,),
        plant=SimpleNamespace(parameters=(SimpleNamespace(name="damping of joint"),)),
        n_common=len(spread),
        common_of=lambda _: slice(1, len(spread)),
    )
    unknowns = SimpleNamespace(common=np.array([found[0], *span, *found[1:]]))
    return SimpleNamespace(assembly=assembly, unknowns=unknowns), spread


def slope_at_rest(speed, force, n_pairs):
    """Of the spline through rest that has no point at `n_pairs` on either side of it, by B-splines."""
    inner = [POINTS[i] for i in range(2, 7) if i == 4 or abs(i - 4) > n_pairs]
    knots = np.array([-1.0] * 4 + inner + [1.0] * 4)
    order = np.argsort(speed)
    at = np.append(speed[order], 0.0)
    columns = scipy.interpolate.BSpline.design_matrix(at, knots, 3).toarray()
    columns[-1] *= 1e6  # no force at rest
    heights = np.linalg.lstsq(columns, np.append(force[order], 0.0))[0]
    return float(scipy.interpolate.BSpline(knots, heights, 3)(0.0, 1))


def moves_of(law, noise):
    """What `split_at_rest` finds, and the slopes at rest with all points, without a pair, without two."""
    speed, force = measured(law, noise)
    fitted, spread = fitted_law(speed, force, noise)
    slopes = [slope_at_rest(speed, force, n_pairs) for n_pairs in (0, 1, 2)]
    assert fitted.unknowns.common[0] == pytest.approx(slopes[0], rel=1e-6)
    return *split_at_rest(fitted, spread), slopes, np.sqrt(np.diag(spread))


def test_a_law_that_its_points_follow_moves_by_the_pair_next_to_rest_alone():
    moves, names, slopes, deviation = moves_of(lambda v: 3.0 * v**3, 0.01)
    assert names == ()
    assert moves[0] == pytest.approx(abs(slopes[1] - slopes[0]), rel=1e-4)
    assert moves[0] < 2.0 * deviation[0]


def test_moves_that_converge_count_by_the_sum_of_those_that_follow():
    moves, names, slopes, deviation = moves_of(lambda v: np.sinh(3.0 * v) - 3.0 * v, 2e-4)
    last, before = abs(slopes[1] - slopes[0]), abs(slopes[2] - slopes[1])
    assert before > 2.0 * last > 10.0 * deviation[0]
    assert names == ()
    assert moves[0] == pytest.approx(last * sum((last / before) ** k for k in range(1, 60)), rel=1e-3)


def test_a_law_without_a_curvature_at_rest_counts_what_two_pairs_move():
    moves, names, slopes, deviation = moves_of(lambda v: np.sign(v) * np.abs(v) ** 1.5, 0.01)
    assert names == ("damping of joint",)
    assert moves[0] == pytest.approx(abs(slopes[2] - slopes[0]), rel=1e-4)
    assert 10.0 * deviation[0] < abs(slopes[0] - 2.0) < 3.0 * moves[0]
    points = POINTS[[i for i in range(9) if i not in (4, 5)]]
    far = np.abs(points) > 0.5
    np.testing.assert_allclose(moves[3:][far], np.abs(points * moves[0])[far], rtol=0.3)
