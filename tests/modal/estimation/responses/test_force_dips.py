"""Responses under a force whose spectrum has zeros and poles, against the products of their factors."""

import numpy as np
import pytest

from modal.estimation.responses.force_dips import _mixture


def both(values):
    return np.r_[values, values.conj()]


def factors(zeros, q, p, z):
    """S / (z - p) of every p, and S last."""
    power = np.prod((z - zeros) * (1 / z - zeros), axis=1) / np.prod((z - q) * (1 / z - q), axis=1)
    return np.hstack([power[:, np.newaxis] / (z - p), power[:, np.newaxis]])


@pytest.fixture
def force():
    """Zeros at two of three pairs of poles, poles of its own beside them."""
    p = 0.99 * np.exp(1j * np.array([0.3, 0.9, 1.7]))
    return both(p[:2]), both(p[:2] * np.exp([-0.01 - 0.02j, -0.03 + 0.04j])), both(p)


def at_lines(q, p, z):
    return np.hstack([np.ones_like(z), 1 / (z - q), 1 / (1 / z - q), 1 / (z - p)])


def test_a_white_force_through_its_zeros_and_poles_is_a_sum_of_fractions(force):
    zeros, q, p = force
    z = np.exp(1j * np.linspace(0.1, 3.0, 60))[:, np.newaxis]
    mixed, _ = _mixture(zeros, q, p, tuple(np.empty((0, x.size)) for x in force))
    truth = factors(zeros, q, p, z)
    assert np.abs(at_lines(q, p, z) @ mixed - truth).max() < 1e-10 * np.abs(truth).max()


def test_the_sum_moves_as_its_zeros_and_poles_do(force):
    rng = np.random.default_rng(3)
    moves = [both(0.01 * rng.standard_normal((len(x) // 2, 2)) @ [1, 1j]) for x in force]
    moves[0] = moves[2][[0, 1, 3, 4]]  # the force's zeros are at poles of the structure
    _, changes = _mixture(*force, tuple(x[np.newaxis] for x in moves))
    step = 1e-5
    ahead, behind = (
        _mixture(*(x + side * dx for x, dx in zip(force, moves, strict=True)), tuple(x[np.newaxis] for x in moves))[0]
        for side in (step, -step)
    )
    wanted = (ahead - behind) / (2 * step)
    assert np.abs(changes[0] - wanted).max() < 1e-7 * np.abs(wanted).max()
