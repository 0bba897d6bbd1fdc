"""What still drives a mode while it rings down is noise of its own, and neither hides nor makes another law.

The truth is an oscillator that wind shakes, step by step: the linear motion exactly, and half of the force of the law
and of the wind before and after it (Strang's splitting), in two outputs with a sensor's noise.
"""

import numpy as np
import pytest
import scipy.signal

import okid
from modal.verdict.decay import COLOUR, Decay, colour_of, directions, predictor
from modal.verdict.oscillator import modes_of, waves
from modal.verdict.ring_down import contest_of

DT, STEPS = 0.02, 12


def shaken(seed, *, n=700, w=2 * np.pi * 3.1, z=0.01, wind=0.02, friction=0.0, drag=0.0, cubic=0.0):
    """(n,) of x'' + 2 z w x' + w^2 (x + f sign(x') + drag x'|x'| / w^2 + cubic x^3) = force, released from 1.

    Args:
        wind: of the motion that it makes of the linear mode, root mean square.
    """
    pushes = (
        wind
        * np.sqrt(4 * z * w**3)
        * np.sqrt(DT / STEPS)
        * np.random.default_rng((3, seed)).standard_normal((n, STEPS))
    )
    h, turning, decay = DT / STEPS, w * np.sqrt(1 - z * z), z * w
    c, s, shrink = np.cos(turning * h), np.sin(turning * h) / turning, np.exp(-decay * h)
    x, v, seen = 1.0, 0.0, np.empty(n)

    def kicked(x, v, push):
        v += 0.5 * push - 0.5 * h * (drag * v * abs(v) + w**2 * cubic * x**3)
        most = 0.5 * h * w**2 * friction
        return 0.0 if abs(v) <= most and abs(x) <= friction else v - np.sign(v) * min(most, abs(v))

    for i in range(n):
        seen[i] = x
        for push in pushes[i]:
            v = kicked(x, v, push)
            x, v = shrink * ((c + decay * s) * x + s * v), shrink * ((c - decay * s) * v - w**2 * s * x)
            v = kicked(x, v, push)
    return seen


def asked(seed, *, noise=1e-3, **law):
    """What is found of two outputs, beside a linear model that leaves what the wind makes, and their noise."""
    x, calm = shaken(seed, **law), shaken(seed, **law | {"wind": 0.0})
    sensors = noise * np.random.default_rng((4, seed)).standard_normal((len(x), 2))
    seen, left = (one[:, np.newaxis] * [1.0, -0.6] + sensors for one in (x, x - calm))
    contest = contest_of([okid.Record([], seen, DT)], [left])
    assert contest is not None
    return contest.bent


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_a_mode_under_wind_is_not_accused(seed):
    """In white noise two of these three were."""
    assert asked(seed, wind=0.05) is None


@pytest.mark.parametrize(
    ("law", "like"),
    [
        ({"friction": 0.02}, "dry friction"),
        ({"drag": 0.05}, "under drag"),
        ({"cubic": 0.1}, "spring that is not linear"),
    ],
    ids=["friction", "drag", "cubic"],
)
def test_a_law_is_told_under_wind(law, like):
    found = asked(5, **law)
    assert found is not None
    assert like in found.sentence


def test_a_spring_that_hardens_is_told_with_its_size_under_wind():
    """By harmonic balance: w = w0 (1 + 3/8 cubic A^2), and no damping of its own."""
    found = asked(7, cubic=0.1, wind=0.01)
    assert found.frequency[0] / 3.1 == pytest.approx(1 + 0.375 * 0.1, abs=3e-3)
    assert found.frequency[1] / 3.1 == pytest.approx(1.0, abs=3e-3)
    assert found.damping_ratio == pytest.approx((0.01, 0.01), abs=3e-3)


CLOSE = ((0.1, 0.005), (0.12, 0.005), (0.14, 0.005))
"""Three slow, light modes side by side, whose product loses its digits in powers of q."""
SETS = [
    ((0.4, 0.01),),
    ((0.4, 0.01), (0.43, 0.002)),
    ((0.1, 0.2), (1.4, 0.03), (2.9, 1e-3)),
    CLOSE,
    ((0.3, 1e-6), (0.3001, 1e-6)),
]


@pytest.mark.parametrize("modes", SETS)
@pytest.mark.parametrize(("share", "slope"), [(-12.0, 0.0), (0.0, -0.9), (6.0, 0.5), (10.0, -0.98)])
def test_the_predictor_has_the_spectrum_of_modes_in_white_noise(modes, share, slope):
    rings, best = predictor(modes, share, slope)
    at = np.linspace(0.01, 3.0, 301)

    def power(sections):
        return np.prod([np.abs(np.polyval(one, np.exp(1j * at))) ** 2 for one in sections], axis=0)

    for (w, z), section in zip(modes, rings, strict=True):
        poles = [np.exp((-z + sign * 1j * np.sqrt(1 - z * z)) * w) for sign in (1, -1)]
        assert section == pytest.approx(np.poly(poles).real)
    shaken = np.exp(share) * (1.0 + slope * np.cos(at)) * sum(1.0 / power([pair]) for pair in rings)
    ratio = power(best) / (power(rings) * (1.0 + shaken))
    assert ratio == pytest.approx(np.full(301, ratio[0]), rel=1e-5)
    assert max(np.abs(np.roots(one)).max() for one in best) < 1.0


@pytest.mark.parametrize("last", [201, *(pytest.param(last, marks=pytest.mark.slow) for last in (180, 230))])
def test_an_output_that_falls_silent_takes_no_other_away(last):
    times = 0.05 * np.arange(400)
    x = np.exp(-0.02 * np.pi * times) * np.cos(2 * np.pi * times + 0.3)
    left = 2e-3 * np.random.default_rng(0).standard_normal((400, 2))
    seen = x[:, np.newaxis] * [1.0, -0.6] + left
    gone = np.where(np.arange(400)[:, np.newaxis] >= [400, last], np.nan, seen)
    assert contest_of([okid.Record([], gone, 0.05)], [np.where(np.isnan(gone), np.nan, left)]).bent is None


@pytest.mark.parametrize("gaps", [False, True])
def test_columns_side_by_side_leave_what_each_leaves_by_itself(gaps):
    rng = np.random.default_rng(6)
    seen, beside = rng.standard_normal((200, 3)), rng.standard_normal((200, 2))
    seen[100:130, 1] = np.nan if gaps else 0.0
    columns = rng.standard_normal((4, 200, 2))
    found = Decay.of(np.arange(200.0), seen, beside).left_of_each(columns)
    for i, own in enumerate(columns):
        everything = np.column_stack([np.ones(200), beside, own])
        for output in range(3):
            rows = np.isfinite(seen[:, output])
            sizes = np.linalg.lstsq(everything[rows], seen[rows, output], rcond=None)[0]
            left = np.where(rows, seen[:, output] - everything @ sizes, 0.0)
            assert found[i, :, output] == pytest.approx(left, abs=1e-12)


def test_only_the_past_is_filtered():
    rng = np.random.default_rng(8)
    times = np.delete(np.arange(60.0), [20, 21])
    (alike,) = Decay.of(times, rng.standard_normal((58, 1)), np.zeros((58, 0))).outputs
    above, below = np.array([[1.0, -1.5, 0.9], [1.0, 0.2, 0.1]]), np.array([[1.0, -1.6, 0.8], [1.0, 0.3, -0.2]])
    values, colour, even = rng.standard_normal((58, 2)), np.array([1.0, -0.4, 0.0, 0.2]), np.zeros((60, 2))
    even[times.astype(int)] = values
    whole = scipy.signal.lfilter(
        np.convolve(np.convolve(*above), colour), np.convolve(*below), even, axis=0
    )[times.astype(int)]  # fmt: skip
    assert alike.filtered(above, below, colour, values) == pytest.approx(whole, abs=1e-12)


def test_the_copy_of_an_output_is_no_other_direction():
    """What its difference from the first has is rounding, which outweighed all else: no few modes came near."""
    times = 0.05 * np.arange(400)
    x = np.exp(-0.02 * np.pi * times) * np.cos(2 * np.pi * times + 0.3)
    left = 2e-3 * np.random.default_rng(0).standard_normal((400, 2))
    seen = x[:, np.newaxis] * [1.0, -0.6] + left
    assert directions(seen[:, [0, 1, 0]], np.zeros((400, 0))).shape == (3, 2)
    assert contest_of([okid.Record([], seen[:, [0, 1, 0]], 0.05)], [left[:, [0, 1, 0]]]).few


def test_the_colour_is_that_of_each_outputs_own_rows():
    """Measured in turns, rows of one output lie two apart; where they stand nowhere side by side there is no colour."""
    rng = np.random.default_rng(5)
    noise = np.zeros(4000)
    for i in range(2, 4000):
        noise[i] = 0.5 * noise[i - 1] - 0.4 * noise[i - 2] + rng.standard_normal()
    in_turns = np.full((8000, 2), np.nan)
    in_turns[::2, 0], in_turns[1::2, 1] = noise, rng.standard_normal(4000)
    decay = Decay.of(np.arange(8000.0), in_turns, np.zeros((8000, 0)))
    assert decay.colours(np.nan_to_num(in_turns))[0, :3] == pytest.approx([1.0, -0.5, 0.4], abs=0.05)
    scattered = np.where(rng.random((4000, 1)) < 0.5, np.nan, noise[:, np.newaxis])
    decay = Decay.of(np.arange(4000.0), scattered, np.zeros((4000, 0)))
    assert not decay.colours(np.nan_to_num(scattered))[:, 1:].any()


def test_one_step_ahead_nothing_is_left_of_what_shakes_a_mode_but_white_noise():
    w, z = 2 * np.pi * 3.1 * DT, 0.01
    x = shaken(11, n=3000, wind=0.1)
    decay = Decay.of(np.arange(3000.0), x[:, np.newaxis], np.zeros((3000, 0)))
    fit = modes_of(decay, np.array([[w, z]]))
    modes = fit.parameters.reshape(1, 2)
    rest = decay.innovations(waves(modes, decay.times), modes, fit.noise)[:, 0]
    alike = [float(rest[lag:] @ rest[:-lag] / (rest @ rest)) for lag in range(1, 20)]
    assert np.abs(alike).max() < 4 / np.sqrt(3000)
    assert rest.std() < 0.3 * decay.left(waves(modes, decay.times)).std()
    assert modes[0] == pytest.approx([w, z], rel=0.003, abs=3 * np.sqrt(z / (3000 * w)))


def test_rows_after_what_was_not_measured_tell_nothing_of_noise():
    seen = np.random.default_rng(1).standard_normal((400, 2))
    seen[100:110, 1] = np.nan
    decay = Decay.of(np.arange(400.0), seen, np.zeros((400, 0)))
    assert decay.told[:, 0].all()
    assert np.flatnonzero(~decay.told[:, 1]).tolist() == list(range(100, 116))
    seen[::2, 1] = np.nan  # every second row is an even grid too
    assert Decay.of(np.arange(400.0), seen, np.zeros((400, 0))).told[:, 1].sum() > 180


def test_outputs_that_see_one_motion_have_one_direction():
    rng = np.random.default_rng(2)
    motion, drift = rng.standard_normal((500, 1)), np.linspace(-1.0, 3.0, 500)[:, np.newaxis]
    shape = np.array([1.0, -0.5, 0.2])
    seen = motion * shape + drift * [3.0, 0.0, 1.0] + 7.0 + 1e-3 * rng.standard_normal((500, 3))
    along = directions(seen, drift)
    assert along.T @ along == pytest.approx(np.eye(3), abs=1e-12)
    assert abs(along[:, 0] @ shape) / np.linalg.norm(shape) == pytest.approx(1.0, abs=1e-5)


def test_the_colour_of_noise_is_that_of_its_recursion():
    rng, true = np.random.default_rng(3), np.array([1.0, -1.2, 0.6])
    white, values = rng.standard_normal(4000), np.zeros(4000)
    for i in range(4000):
        values[i] = white[i] - true[1:] @ np.array([values[i - 1], values[i - 2]])
    found = colour_of(values, 4000)
    assert found.shape == (COLOUR + 1,)
    assert found[:3] == pytest.approx(true, abs=0.05)
    assert not found[3:].any()
    assert not colour_of(white, 4000)[1:].any()
