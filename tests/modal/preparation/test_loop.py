"""A loop is told from a force that moves between its samples, which outputs foretell in open loop as well."""

import numpy as np
import pytest
import scipy

from modal.estimation.feedback import FALSE_ALARMS, OLD_PAST, OLD_RIDGE, feedback_p_value
from modal.preparation.delay import choose_input_delay, lead_of, loop_p_value, with_lead
from okid.record import Record

FINER, N_ROWS = 8, 4000
FREQUENCIES = 2 * np.pi * np.array([0.06, 0.17, 0.31, 0.42, 0.54, 0.66, 0.83]) / FINER
"""[rad/step], of which the last three lie above half of the sampling frequency."""
DAMPING = np.array([0.008, 0.01, 0.006, 0.01, 0.006, 0.005, 0.01])


def sampled(seed, *, gain, taps=None):
    """Velocities and a force behind one filter, every eighth step; `gain` feeds the first of them back with a lag.

    A force of its own acts on each mode beside the measured one. The filter is a Butterworth of order 6 at 0.4 of the
    sampling frequency, or that of `taps`.
    """
    rng = np.random.default_rng((seed, 41))
    n, n_modes = (N_ROWS + 200) * FINER, len(FREQUENCIES)
    shapes = rng.uniform(0.5, 1.0, (n_modes, 4)) * rng.choice([-1.0, 1.0], (n_modes, 4))
    limit = scipy.signal.butter(6, 0.96 / FINER, output="sos")
    moved = scipy.signal.sosfilt(limit, rng.standard_normal((n, 1 + n_modes)), axis=0)
    reference, wind = moved[:, 0], 0.1 * moved[:, 1:]
    poles = np.exp((-DAMPING + 1j) * FREQUENCIES)
    states, lagged, lag = np.zeros(n_modes, dtype=complex), 0.0, np.exp(-2 * np.pi * 0.2 / FINER)
    force, motion = np.zeros(n), np.zeros((n, 4))
    for k in range(n):
        motion[k] = states.real @ shapes
        lagged = lag * lagged + (1 - lag) * gain * motion[k, 0]
        force[k] = reference[k] - lagged
        states = poles * states + shapes[:, 0] * force[k] + wind[k]
    both = np.column_stack([force, motion])
    if taps is None:
        both = scipy.signal.sosfilt(scipy.signal.butter(6, 0.8 / FINER, output="sos"), both, axis=0)
    else:
        both = scipy.signal.lfilter(taps, 1.0, both, axis=0)
    kept = both[200 * FINER :: FINER]
    outputs = kept[:, 1:] + 0.0005 * kept[:, 1:].std(axis=0) * rng.standard_normal((len(kept), 4))
    return Record(kept[:, 0], outputs, 0.01)


STEEP = scipy.signal.firwin(161, 0.86 / FINER, window=("kaiser", 7.0))


@pytest.mark.parametrize(("seed", "taps"), [(1, None), (4, STEEP), (7, None), (9, None)])
def test_outputs_that_know_a_force_between_its_samples_are_no_loop(seed, taps):
    record = sampled(seed, gain=0.0, taps=taps)
    assert feedback_p_value([record]) < FALSE_ALARMS / 5  # they foretell it
    assert lead_of([record]) > 0
    assert loop_p_value([record]) > FALSE_ALARMS


@pytest.mark.parametrize(("seed", "taps"), [(0, STEEP), (1, None), (2, STEEP), (3, None), (4, STEEP), (5, None)])
def test_a_loop_around_such_a_force_is_found_and_no_lead_hides_it(seed, taps):
    record = sampled(seed, gain=0.01, taps=taps)
    assert lead_of([record]) > 0
    assert loop_p_value([record]) < FALSE_ALARMS / 5
    assert with_lead(choose_input_delay([record]), [record], [record]).samples == (0,)


def test_a_force_that_fills_the_band_is_asked_of_all_outputs_beyond_the_lead():
    """A loop that forgets soon has a lead as well, but answers to no old outputs; two clocks have one, and no loop."""
    reference, noise = np.random.default_rng(1).standard_normal((2, 4000))
    inputs, outputs = np.zeros(4000), np.zeros(4000)
    for k in range(1, 4000):
        inputs[k] = reference[k] - 0.3 * outputs[k - 1]
        outputs[k] = 0.5 * outputs[k - 1] + inputs[k - 1] + noise[k]
    record = Record(inputs, outputs, 0.1)
    assert lead_of([record]) > 0
    assert feedback_p_value([record], older=6) > FALSE_ALARMS
    assert loop_p_value([record]) < FALSE_ALARMS
    early = Record(reference[:-1], reference[:-1] + 0.2 * reference[1:] + 0.01 * noise[1:], 0.1)
    assert feedback_p_value([early]) < 1e-6
    assert loop_p_value([early]) > FALSE_ALARMS


def test_what_older_outputs_foretell_is_asked_as_by_plain_regressions():
    own, older, n = 40, 7, 2500
    rng = np.random.default_rng(3)
    outside, seen = rng.standard_normal(n), 0.3 * rng.standard_normal(n)
    u, y = np.zeros(n), np.zeros(n)
    for k in range(2, n):
        u[k] = outside[k] - 0.02 * (y[k - 1] + seen[k - 1])
        y[k] = 1.7 * y[k - 1] - 0.97 * y[k - 2] + u[k - 1]
    y += seen
    u, y = ((one - one.mean()) / one.std() for one in (u, y))
    rows = np.arange(own, n)

    def past(channel, lags):
        return np.column_stack([channel[rows - lag] for lag in lags])

    known = np.column_stack([np.ones(len(rows)), past(u, range(1, own + 1))])
    last, old = past(y, range(1, 5)), past(y, range(older + 1, older + OLD_PAST + 1))
    left, last, old = (one - known @ np.linalg.lstsq(known, one, rcond=None)[0] for one in (u[rows], last, old))
    ridge = OLD_RIDGE * np.square(old).sum() / OLD_PAST
    foretold = old @ np.linalg.solve(old.T @ old + ridge * np.eye(OLD_PAST), old.T @ last)
    weights = np.linalg.lstsq(foretold, left, rcond=None)[0]
    share = (foretold @ weights) @ left / (left @ left)
    statistic = -(len(rows) - own - 1 - 3) * np.log(1.0 - share)
    expected = scipy.special.chdtrc(4, statistic)
    assert 1e-40 < expected < 1e-3
    assert np.isclose(np.log(feedback_p_value([Record(u, y, 0.1)], older=older)), np.log(expected), rtol=1e-6)
