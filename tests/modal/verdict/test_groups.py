"""Poles side by side: one resonance with one shape is one group, two modes with two shapes are not."""

import numpy as np
import pytest

from modal.modes.mode import Mode
from modal.modes.shape_comparison import overlap_matrix, pulses
from modal.verdict.judgement import LARGEST_BAND, LEAST_BAND, SAME_SHAPE, group_overlaps, groups

DT, STEPS = 0.01, 300
SHAPE = np.array([1.0, 0.6, -0.3])
OTHER = np.array([-0.5, 1.0, 0.4])


def mode(frequency, damping=0.02, shape=SHAPE, size=1.0, *, kind="oscillatory"):
    omega = 2 * np.pi * frequency
    return Mode(
        pole=complex(-damping * omega, omega * np.sqrt(1 - damping**2)),
        kind=kind,
        frequency=frequency,
        damping_ratio=damping,
        shape=np.asarray(shape) + 0j,
        participation=size * np.array([1.0, 0.4]) + 0j,
    )


def groups_of(*modes):
    return groups(modes, pulses(modes, dt=DT), n_steps=STEPS)


def pulse(modes):
    """The summed pulse response sample by sample, the definition: sum of 2 Re(c b' lambda^k)."""
    k = np.arange(STEPS)
    return sum(2 * np.real(np.exp(m.pole * DT) ** k[:, None, None] * np.outer(m.shape, m.participation)) for m in modes)


def test_a_resonance_shared_by_chance_is_one_group_and_found_again_as_one():
    """The truth is one mode; each run splits it among two poles in another way."""
    ours = [mode(10.00, size=0.7), mode(10.04, size=0.3), mode(25.0, shape=OTHER)]
    theirs = [mode(25.0, shape=OTHER), mode(10.04, size=0.65), mode(9.99, size=0.35)]
    found = groups_of(*ours)
    assert found == {0: (0, 1)}
    own, again = pulses(ours, dt=DT), pulses(theirs, dt=DT)
    alone = overlap_matrix(own, again, n_steps=STEPS)
    assert alone[:2].max() < 0.97
    together = group_overlaps(0, found[0], ours, own, [(theirs, again)], n_steps=STEPS)
    assert together[0] > 0.995
    assert together[0] > alone[0].max() + 0.02
    # and the closed form is the definition
    one, two = pulse(ours[:2]), pulse(theirs[1:])
    expected = (one * two).sum() / max((one**2).sum(), (two**2).sum())
    assert together[0] == pytest.approx(expected, rel=1e-9)


def test_a_sum_of_opposite_parts_is_judged_by_what_is_left():
    """Large parts that cancel, as a fit of two coincident poles gives: each differs wildly, their sum does not."""
    ours = [mode(10.00, size=5.0), mode(10.02, size=-4.0)]
    theirs = [mode(10.00, size=-8.0), mode(9.995, size=9.0)]
    own, again = pulses(ours, dt=DT), pulses(theirs, dt=DT)
    alone = overlap_matrix(own, again, n_steps=STEPS)
    together = group_overlaps(0, (0, 1), ours, own, [(theirs, again)], n_steps=STEPS)
    assert alone.max() < 0.8
    assert together[0] > 0.95


def test_close_modes_of_different_shape_are_two():
    assert groups_of(mode(10.0), mode(10.04, shape=OTHER)) == {}


@pytest.mark.parametrize(
    ("similarity", "grouped"), [(SAME_SHAPE + 0.005, True), (SAME_SHAPE - 0.005, False)], ids=["same", "other"]
)
def test_shapes_are_the_same_from_a_limit_on(similarity, grouped):
    across = OTHER - SHAPE * (SHAPE @ OTHER) / (SHAPE @ SHAPE)
    angle = np.arccos(np.sqrt(similarity))  # assurance is the squared cosine
    turned = np.cos(angle) * SHAPE / np.linalg.norm(SHAPE) + np.sin(angle) * across / np.linalg.norm(across)
    assert bool(groups_of(mode(10.0), mode(10.04, shape=turned))) is grouped


@pytest.mark.parametrize(
    ("damping", "limit"),
    [(0.001, LEAST_BAND), (0.03, 0.03), (0.2, LARGEST_BAND)],
    ids=["lightly damped", "half-power bandwidth", "heavily damped"],
)
def test_the_band_ends_on_both_sides(damping, limit):
    for side in (-1, 1):
        inside, outside = 10.0 * (1 + side * 0.99 * limit), 10.0 * (1 + side * 1.01 * limit)
        weak = {"damping": damping, "size": 0.01}
        assert groups_of(mode(10.0, damping), mode(inside, **weak)) == {0: (0, 1)}
        assert groups_of(mode(10.0, damping), mode(outside, **weak)) == {}


def test_the_most_energetic_pole_leads_and_no_pole_is_in_two_groups():
    modes = (mode(9.92, size=0.1), mode(10.0, size=1.0), mode(10.18, size=0.5), mode(10.3, size=0.2))
    assert groups_of(*modes) == {1: (0, 1, 2)}  # 10.3 lies outside the band of the leader, and its neighbour is taken
    assert groups_of(*modes[2:]) == {0: (0, 1)}


def test_only_oscillations_are_grouped():
    assert groups_of(mode(10.0), mode(10.0, kind="unstable"), mode(10.0, kind="real")) == {}


def test_a_run_without_the_resonance_overlaps_nothing():
    ours = [mode(10.0), mode(10.04, size=0.5)]
    own = pulses(ours, dt=DT)
    far = [mode(20.0)]
    runs = [([], pulses([], dt=DT)), (far, pulses(far, dt=DT)), (ours, own)]
    overlaps = group_overlaps(0, (0, 1), ours, own, runs, n_steps=STEPS)
    np.testing.assert_allclose(overlaps, [0.0, 0.0, 1.0], atol=1e-12)
