"""Laws with memory against closed forms, the differential equation and energy."""

import itertools
from itertools import pairwise

import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st

from modal.effects.effect import Motion
from modal.effects.hysteresis import BoucWenHysteresis, SlackInHysteresis, bouc_wen_flow, stop_operator, turning_point

seeds = given(seed=st.integers(0, 2**32 - 1))


def moments(displacement, velocity, memory, smoothing=0.0):
    return Motion(
        displacement=np.asarray(displacement, dtype=float),
        velocity=np.asarray(velocity, dtype=float),
        time=np.zeros(len(displacement)),
        memory=np.asarray(memory, dtype=float)[:, None],
        displacement_scale=1.0,
        velocity_scale=1.0,
        smoothing=smoothing,
    )


def march(effect, values, displacement, *, velocity=None, dt=1.0, state=0.0, smoothing=0.0):
    """States and forces along motions (n_samples, n_motions) or (n_samples,), sample by sample from `state`."""
    velocity = np.zeros_like(displacement) if velocity is None else velocity
    states = np.empty_like(displacement)
    states[0] = state
    for k in range(1, len(displacement)):
        before, after = (
            moments(np.atleast_1d(displacement[i]), np.atleast_1d(velocity[i]), np.atleast_1d(states[k - 1]), smoothing)
            for i in (k - 1, k)
        )
        found = effect.advance(values, before, after, dt).value[:, 0]
        states[k] = found if states.ndim > 1 else found[0]
    force = effect.force(values, moments(displacement.ravel(), velocity.ravel(), states.ravel(), smoothing)).value
    return states, force.reshape(displacement.shape)


def equation(n):
    """The right-hand side as it stands in the catalogue, in units of the yield displacement, for unit velocity."""

    def rate(_, z, direction):
        return direction * (1.0 - 0.5 * (1.0 + np.sign(direction * z)) * np.abs(z) ** n)

    return rate


def integrated(state, stretch, n):
    if stretch == 0.0:
        return state
    crossing = -state if state < 0.0 else 0.0  # the equation's kink at z = 0, left to no step control
    for length in (min(crossing, stretch), max(stretch - crossing, 0.0)):
        if length > 0.0:
            run = scipy.integrate.solve_ivp(
                equation(n), (0.0, length), [state], args=(1.0,), method="DOP853", rtol=1e-11, atol=1e-12
            )
            state = run.y[0, -1]
    return state


@settings(deadline=None, max_examples=60)
@given(state=st.floats(-1.0, 0.999), stretch=st.floats(0.0, 12.0), n=st.floats(1.0, 10.0))
def test_bouc_wen_follows_its_equation(state, stretch, n):
    found = bouc_wen_flow(np.array([state]), np.array([stretch]), np.array([n])).value[0]
    assert abs(found - integrated(state, stretch, n)) < (3e-6 if n <= 3.0 else 5e-5)


@settings(deadline=None)
@given(start=st.floats(0.0, 0.99), stretch=st.floats(0.0, 50.0))
def test_bouc_wen_has_closed_forms_for_n_of_one_and_two(start, stretch):
    found = bouc_wen_flow(np.array([start] * 2), np.array([stretch] * 2), np.array([1.0, 2.0]))
    exact = [1.0 - (1.0 - start) * np.exp(-stretch), np.tanh(np.arctanh(start) + stretch)]
    np.testing.assert_allclose(found.value, exact, atol=1e-5)
    assert abs(found.value[0] - exact[0]) < 1e-12  # q moves at pace 1


@settings(deadline=None)
@seeds
def test_bouc_wen_never_passes_its_yield_displacement_and_unloads_as_a_spring(seed):
    rng = np.random.default_rng(seed)
    n, limit = rng.uniform(1.0, 10.0), rng.uniform(0.1, 3.0)
    state = rng.uniform(-limit, limit, 300)
    start, stretch = rng.normal(size=300), rng.normal(size=300) * 10.0 ** rng.uniform(-3.0, 2.0, 300)
    found = BoucWenHysteresis().advance(
        (1.0, limit, n), moments(start, np.zeros(300), state), moments(start + stretch, np.zeros(300), state), 1.0
    )
    assert np.max(np.abs(found.value)) <= limit * (1.0 + 1e-12)
    unloading = (state * stretch < 0.0) & (np.abs(stretch) < np.abs(state))
    np.testing.assert_allclose(found.value[unloading, 0], (state + stretch)[unloading], atol=1e-10)
    np.testing.assert_allclose(found.by_memory[unloading, 0, 0], 1.0)


def test_a_state_beyond_its_bound_is_brought_back():
    found = BoucWenHysteresis().advance(
        (1.0, 0.5, 2.0), moments([0.0, 0.0], [0.0, 0.0], [3.0, -3.0]), moments([0.0, 0.1], [0.0, 0.0], [0.0, 0.0]), 1.0
    )
    np.testing.assert_allclose(found.value[:, 0], [0.5, -0.4], rtol=1e-12)


@pytest.mark.parametrize("n", [1.0, 1.5, 2.0, 3.0])
@pytest.mark.parametrize("level", [0.5, 3.0, 20.0])
def test_bouc_wen_at_thirty_samples_a_cycle_is_right_to_a_ten_thousandth_of_the_yield_displacement(n, level):
    """Between samples the displacement moves in a straight line; level is amplitude over yield displacement."""
    displacement = level * np.sin(0.3 + 2.0 * np.pi / 30.0 * np.arange(76))
    states, _ = march(BoucWenHysteresis(), (1.0, 1.0, n), displacement)
    exact = [0.0]
    for change in np.diff(displacement):
        way = 1.0 if change >= 0.0 else -1.0
        exact.append(way * integrated(way * exact[-1], abs(change), n))
    assert np.max(np.abs(states - exact)) < 1e-5


@pytest.mark.parametrize("level", [3.0, 10.0])
def test_a_smooth_motion_is_followed_through_its_peaks(level):
    """A sine, not a polygon: the velocity tells how far the motion went between the samples."""
    step = 2.0 * np.pi / 30.0
    time = 0.37 + step * np.arange(91)
    run = scipy.integrate.solve_ivp(
        lambda t, z: equation(2.0)(t, z, np.sign(np.cos(t))) * level * np.abs(np.cos(t)),
        (time[0], time[-1]),
        [0.0],
        t_eval=time,
        rtol=1e-9,
        atol=1e-10,
        max_step=0.01,
    )
    displacement, velocity = level * np.sin(time), level * np.cos(time)
    told, _ = march(BoucWenHysteresis(), (1.0, 1.0, 2.0), displacement, velocity=velocity, dt=step)
    polygon, _ = march(BoucWenHysteresis(), (1.0, 1.0, 2.0), displacement)
    assert np.max(np.abs(told - run.y[0])) < 1e-4 * level
    assert np.max(np.abs(polygon - run.y[0])) > 1e-3 * level


def play(displacement, half_width):
    """Position of a slider that is pushed by a gap of that half-width, by its definition."""
    position, found = 0.0, []
    for d in displacement:
        position = max(position, d - half_width) if d > position else min(position, d + half_width)
        found.append(position)
    return np.array(found)


@settings(deadline=None, max_examples=20)
@seeds
def test_slack_and_link_lie_between_the_displacement_and_a_slider(seed):
    rng = np.random.default_rng(seed)
    displacement = np.concatenate([[0.0], np.cumsum(rng.normal(size=150))])
    k, limit, slack = rng.uniform(0.2, 2.0, 3)
    states, force = march(SlackInHysteresis(), (k, limit, slack), displacement)
    slider = play(displacement, limit + slack)
    np.testing.assert_allclose(displacement - states, slider, atol=1e-10)
    reach = displacement - slider
    exact = [k * (abs(s) - slack) * np.sign(s) if abs(s) > slack else 0.0 for s in reach]
    np.testing.assert_allclose(force, exact, atol=1e-9)
    assert np.max(np.abs(force)) <= k * limit * (1.0 + 1e-9)
    moved = np.abs(np.diff(slider)) > 1e-12
    np.testing.assert_allclose(np.abs(force[1:][moved]), k * limit, rtol=1e-6)  # the slider moves under its slip force


@settings(deadline=None)
@given(
    state=st.floats(-1.0, 1.0),
    stretch=st.floats(-5.0, 5.0),
    share=st.floats(0.0, 1.0),
    width=st.sampled_from([0.0, 0.2, 3.0]),
)
def test_the_stop_operator_may_be_split_anywhere(state, stretch, share, width):
    limit = np.ones(1)

    def move(start, by):
        return stop_operator(np.array([start]), np.array([by]), limit, width)[0].value[0]

    split = move(move(state, share * stretch), (1.0 - share) * stretch)
    np.testing.assert_allclose(split, move(state, stretch), atol=1e-12)


@settings(deadline=None)
@given(state=st.floats(-1.0, 1.0), stretch=st.floats(-5.0, 5.0), width=st.floats(0.0, 2.0))
def test_the_smooth_stop_keeps_its_limit_and_is_a_spring_before_its_knee(state, stretch, width):
    leg, _ = stop_operator(np.array([state]), np.array([stretch]), np.ones(1), width)
    way, knee = np.sign(stretch), min(width, 1.0)
    assert abs(leg.value[0]) <= 1.0
    assert way * leg.value[0] <= way * (state + stretch) + 1e-15
    if way * (state + stretch) <= 1.0 - knee:
        np.testing.assert_allclose(leg.value[0], state + stretch, atol=1e-15)
    if way * (state + stretch) > 1.0 + 40.0 * knee:
        np.testing.assert_allclose(leg.value[0], way, atol=1e-15)
    assert 0.0 <= leg.by_state[0] <= 1.0
    assert 0.0 <= leg.by_stretch[0] <= 1.0


def test_the_smooth_stop_follows_its_equation():
    width, states = 0.4, np.linspace(-1.0, 0.95, 14)
    for stretch in (0.1, 0.7, 2.5):
        leg, _ = stop_operator(states, np.full(14, stretch), np.ones(14), width)
        run = scipy.integrate.solve_ivp(
            lambda _, s: np.minimum(1.0, (1.0 - s) / width),
            (0.0, stretch),
            states,
            rtol=1e-9,
            atol=1e-11,
            max_step=0.01,
        )
        np.testing.assert_allclose(leg.value, run.y[:, -1], atol=1e-5)


def assert_leg_slopes(move, arguments, slopes, step=1e-6):
    """Derivatives of `move(*arguments)` against central differences, but for the few samples next to a corner."""
    for position, claimed in enumerate(slopes):
        below, above = (
            move(*(x + shift * (i == position) for i, x in enumerate(arguments))) for shift in (-step, step)
        )
        wrong = np.abs(claimed - (above - below) / (2.0 * step)) > 1e-4 * (1.0 + np.abs(claimed))
        assert np.mean(wrong) < 0.005


@pytest.mark.parametrize("width", [0.0, 0.3, 5.0])
def test_the_slopes_of_the_stop_operator_within_and_beyond_its_limit(width):
    rng = np.random.default_rng(11)
    arguments = 1.5 * rng.normal(size=1000), 2.0 * rng.normal(size=1000), rng.uniform(0.5, 1.5, 1000)
    leg, by_limit = stop_operator(*arguments, width)
    assert np.mean(np.abs(arguments[0]) > arguments[2]) > 0.3
    assert_leg_slopes(
        lambda *at: stop_operator(*at, width)[0].value, arguments, (leg.by_state, leg.by_stretch, by_limit)
    )


def test_the_slopes_of_bouc_wen_within_and_beyond_its_bound():
    rng = np.random.default_rng(12)
    states, stretch = 1.5 * rng.normal(size=1000), 2.0 * rng.normal(size=1000)
    limit, n, zeros = rng.uniform(0.5, 1.5, 1000), rng.uniform(1.1, 4.0, 1000), np.zeros(1000)

    def moved(state, change, bound, power):
        before, after = moments(zeros, zeros, state), moments(change, zeros, state)
        return BoucWenHysteresis().advance((1.0, bound, power), before, after, 1.0)

    found = moved(states, stretch, limit, n)
    assert np.mean(np.abs(states) > limit) > 0.3
    assert_leg_slopes(
        lambda *at: moved(*at).value[:, 0],
        (states, stretch, limit, n),
        (
            found.by_memory[:, 0, 0],
            found.by_displacement_after[:, 0],
            found.by_parameter[:, 0, 1],
            found.by_parameter[:, 0, 2],
        ),
    )


def area(displacement, force):
    return float(np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(displacement)))


@pytest.mark.parametrize("slack", [0.0, 0.3])
def test_the_loop_of_an_elastoplastic_link_has_its_closed_area(slack):
    """The slider moves by amplitude - yield - slack to either side, under its slip force: 4 k yield times that."""
    k, limit, amplitude, n = 3.0, 0.5, 2.0, 200  # all corners of the loop fall on samples
    up = np.linspace(-amplitude, amplitude, 2 * n + 1)
    displacement = np.concatenate([up[n:], up[-2::-1], up[1:], up[-2::-1]])
    _, force = march(SlackInHysteresis(), (k, limit, slack), displacement)
    loop = slice(n, 5 * n + 1)
    exact = 4.0 * k * limit * (amplitude - limit - slack)
    np.testing.assert_allclose(area(displacement[loop], force[loop]), exact, rtol=1e-9)
    still = np.sum(np.abs(force[n : 3 * n + 1]) < 1e-9) - 1
    assert abs(still * amplitude / n - 2.0 * slack) < 1.1 * amplitude / n


def test_the_loop_closes_at_thirty_samples_a_cycle_as_it_does_in_truth():
    """The slider's path depends on the peaks, which the samples miss."""
    k, limit, slack, step = 1.0, 0.1, 0.05, 2.0 * np.pi / 30.0
    time = np.array([0.0, 0.05, 0.1, 0.17]) + step * np.arange(91)[:, None]
    fine = np.linspace(0.0, np.max(time), 200001)
    exact = np.sin(time) - np.interp(time, fine, play(np.sin(fine), limit + slack))
    states, _ = march(
        SlackInHysteresis(), (k, limit, slack), np.sin(time), velocity=np.cos(time), dt=step, state=exact[0]
    )
    assert np.max(np.abs(states - exact)) < 5e-5
    polygon, _ = march(SlackInHysteresis(), (k, limit, slack), np.sin(time), state=exact[0])
    assert np.max(np.abs(polygon - exact)) > 2e-3


@pytest.mark.parametrize(
    ("effect", "values"),
    [(BoucWenHysteresis(), (2.0, 0.4, 1.7)), (SlackInHysteresis(), (2.0, 0.4, 0.2))],
    ids=["bouc_wen_hysteresis", "slack_in_hysteresis"],
)
@pytest.mark.parametrize("smoothing", [0.0, 0.3])
def test_hysteresis_never_gives_back_more_than_it_took(effect, values, smoothing):
    rng = np.random.default_rng(21)
    angle = 2.0 * np.pi * np.arange(801)[:, None] / 400.0
    displacement = sum(
        rng.normal(size=50) * np.sin(order * angle + rng.uniform(0.0, 2.0 * np.pi, 50)) for order in (1, 2, 3)
    )
    _, force = march(effect, values, displacement, smoothing=smoothing)
    work = np.cumsum(0.5 * (force[1:] + force[:-1]) * np.diff(displacement, axis=0), axis=0)
    scale = values[0] * values[1] * np.ptp(displacement, axis=0)
    assert np.min(work / scale) > -1e-3  # from rest, at no moment
    assert np.min((work[799] - work[399]) / scale) > -1e-3  # nor over a closed cycle
    assert np.max((work[799] - work[399]) / scale) > 0.5


def test_hysteresis_is_independent_of_pace():
    displacement = np.cumsum(np.random.default_rng(8).normal(size=(60, 5)), axis=0)
    slow = np.concatenate([displacement[:1], *(np.linspace(a, b, 8)[1:] for a, b in pairwise(displacement))])
    for effect, values in ((BoucWenHysteresis(), (1.0, 0.7, 2.0)), (SlackInHysteresis(), (1.0, 0.7, 0.3))):
        _, fast_force = march(effect, values, displacement)
        _, slow_force = march(effect, values, slow)
        np.testing.assert_allclose(slow_force[::7], fast_force, atol=2e-6)


def test_a_motion_that_has_escaped_stays_no_number_and_is_no_error():
    found = bouc_wen_flow(np.array([np.nan, 0.2, 0.1]), np.array([0.1, np.nan, np.inf]), np.full(3, 2.0))
    assert np.isnan(found.value[:2]).all()


def motion(displacement, velocity):
    n = len(displacement)
    return Motion(
        displacement=np.asarray(displacement, dtype=float),
        velocity=np.asarray(velocity, dtype=float),
        time=np.zeros(n),
        memory=np.zeros((n, 0)),
        displacement_scale=1.0,
        velocity_scale=1.0,
    )


@settings(deadline=None)
@given(
    start=st.floats(-5.0, 5.0), speed=st.floats(-5.0, 5.0), acceleration=st.floats(-50.0, 50.0), dt=st.floats(0.01, 1.0)
)
def test_the_peak_of_a_parabola_is_exact(start, speed, acceleration, dt):
    end, last = start + speed * dt + 0.5 * acceleration * dt**2, speed + acceleration * dt
    found = turning_point(motion([start], [speed]), motion([end], [last]), dt)
    peak = start - speed**2 / (2.0 * acceleration) if speed * last < 0.0 else start
    np.testing.assert_allclose(found.value, peak, rtol=1e-6, atol=1e-9)


def test_the_peak_of_a_sine_is_found_to_fourth_order_in_the_step():
    worst = []
    for samples in (15, 30, 60):
        step = 2.0 * np.pi / samples
        phase = 0.5 * np.pi - step * np.linspace(0.03, 0.97, 95)
        found = turning_point(
            motion(np.sin(phase), np.cos(phase)), motion(np.sin(phase + step), np.cos(phase + step)), step
        )
        assert found.turns.all()
        worst.append(np.max(np.abs(found.value - 1.0)))
    assert worst[1] < 3e-5  # the samples themselves miss the peak by up to 1 - cos(pi / 30) = 5.5e-3
    for coarse, fine in itertools.pairwise(worst):
        assert 14.0 < coarse / fine < 18.0


@settings(deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_turning_point_lies_beyond_both_ends_and_elsewhere_there_is_none(seed):
    rng = np.random.default_rng(seed)
    d0, d1, v0, v1 = rng.normal(size=(4, 200))
    found = turning_point(motion(d0, v0), motion(d1, v1), 0.8)
    assert 0 < np.sum(found.turns) < 200
    way = np.sign(v0[found.turns])
    assert np.all((found.value - d0)[found.turns] * way > 0.0)
    assert np.all((found.value - d1)[found.turns] * way > 0.0)
    assert np.all((v0 * v1)[found.turns] < 0.0)
    np.testing.assert_array_equal(found.value[~found.turns], d0[~found.turns])


def test_a_port_without_velocity_moves_in_straight_lines():
    found = turning_point(motion([0.0, 1.0], [0.0, 0.0]), motion([1.0, 0.0], [0.0, 0.0]), 0.1)
    assert not found.turns.any()
    np.testing.assert_array_equal(found.value, [0.0, 1.0])
