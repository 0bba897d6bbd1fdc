from dataclasses import replace

import numpy as np
import pytest
from differences import by_value, central, disagreement, force_disagreement
from hypothesis import given
from hypothesis import strategies as st

from modal.effects.effect import WALL, Motion, Situation
from modal.effects.flows import Overflow, PowerLawFlow

exponents = st.floats(0.06, 2.9)
rates = st.floats(0.01, 100.0)
seeds = st.integers(0, 2**31)


def tank(level, *, scale=None, smoothing=0.0):
    level = np.asarray(level, dtype=float)
    return Motion(
        displacement=level,
        velocity=np.zeros_like(level),
        time=np.arange(float(level.size)),
        memory=np.zeros((level.size, 0)),
        displacement_scale=float(np.std(level)) if scale is None else scale,
        velocity_scale=0.0,
        smoothing=smoothing,
    )


def random_level(seed, n=40):
    return 3.0 * np.random.default_rng(seed).standard_normal(n)


lines = st.floats(0.0, 10.0)


@given(seed=seeds, coefficient=rates, exponent=exponents, linear=lines, smoothing=st.sampled_from([0.05, 0.3]))
def test_power_law_derivatives_agree_with_differences(seed, coefficient, exponent, linear, smoothing):
    motion = tank(random_level(seed), smoothing=smoothing)
    assert max(force_disagreement(PowerLawFlow(), [coefficient, exponent, linear], motion).values()) < 1e-5


@given(seed=seeds, coefficient=rates, exponent=exponents, linear=lines, scale=st.floats(0.1, 10.0))
def test_without_smoothing_the_flow_is_the_power_law_less_the_line_on_any_record(
    seed, coefficient, exponent, linear, scale
):
    level = random_level(seed)
    flow = PowerLawFlow().force([coefficient, exponent, linear], tank(level, scale=scale)).value
    expected = [coefficient * np.sign(h) * abs(h) ** exponent - linear * h for h in level]
    np.testing.assert_allclose(flow, expected, rtol=1e-9, atol=1e-9 * (coefficient + linear))


@given(seed=seeds, coefficient=rates, smoothing=st.sampled_from([0.0, 0.1]))
def test_an_exponent_of_one_is_a_linear_outflow(seed, coefficient, smoothing):
    flow = PowerLawFlow().force([coefficient, 1.0, coefficient], tank(random_level(seed), smoothing=smoothing))
    np.testing.assert_allclose(flow.value, 0.0, atol=1e-10 * coefficient)


@given(seed=seeds, exponent=exponents, smoothing=st.sampled_from([0.0, 0.1]))
def test_the_power_law_is_odd_and_the_same_in_every_unit(seed, exponent, smoothing):
    level = random_level(seed)
    flow = PowerLawFlow().force([2.0, exponent, 0.3], tank(level, smoothing=smoothing)).value
    mirrored = PowerLawFlow().force([2.0, exponent, 0.3], tank(-level, smoothing=smoothing)).value
    # a flow of 2 at 1 m counted in millimetres is 2000 at 1000 mm: 2000 / 1000^exponent at 1 mm
    values = [2.0 * 1000.0 ** (1.0 - exponent), exponent, 0.3]
    in_millimetres = PowerLawFlow().force(values, tank(1000.0 * level, smoothing=smoothing)).value
    np.testing.assert_allclose(mirrored, -flow, rtol=1e-12)
    np.testing.assert_allclose(in_millimetres, 1000.0 * flow, rtol=1e-9, atol=1e-9)


@given(seed=seeds, weight=st.floats(0.1, 10.0))
def test_the_screen_scales_the_power_and_its_line_together(seed, weight):
    motion = tank(np.abs(random_level(seed)))
    for start in PowerLawFlow().starts(Situation(motion=motion, residual_frequencies=(), dt=1.0, longest=40.0)):
        column = PowerLawFlow().screen_columns(start, motion)[:, 0]
        whole = PowerLawFlow().force(PowerLawFlow().from_screen(start, [weight]), motion).value
        np.testing.assert_allclose(whole, weight * column, rtol=1e-9, atol=1e-12)
        assert abs(column @ motion.displacement) < 1e-9 * np.sum(motion.displacement**2)  # the nearest line is out
        assert PowerLawFlow().from_screen(start, [-weight])[0] == 0.0


@pytest.mark.parametrize("smoothing", [0.0, 0.01])
@pytest.mark.parametrize("exponent", [0.05, 0.5, 1.0, 3.0])
@pytest.mark.parametrize("scale", [0.0, 1e-9, 1.0, 1e9])
def test_empty_and_huge_levels_give_finite_flows_and_slopes(smoothing, exponent, scale):
    level = np.array([0.0, 1e-300, -1e-300, 1e-12, 1.0, 1e40, -1e40, 1e200])
    flow = PowerLawFlow().force([1.0, exponent, 1.0], tank(level, scale=scale, smoothing=smoothing))
    for part in (flow.value, flow.by_displacement, flow.by_velocity, flow.by_parameter):
        assert np.all(np.isfinite(part))
    assert flow.value[0] == 0.0


@given(seed=seeds, rate=rates, limit=st.floats(-3.0, 3.0), smoothing=st.sampled_from([0.05, 0.3]))
def test_overflow_derivatives_agree_with_differences(seed, rate, limit, smoothing):
    motion = tank(random_level(seed), smoothing=smoothing)
    assert max(force_disagreement(Overflow(), [rate, limit], motion).values()) < 1e-4  # its slope bends at two levels


@given(seed=seeds, rate=rates, limit=st.floats(-3.0, 3.0))
def test_overflow_starts_at_the_limit_and_rises_with_the_rate(seed, rate, limit):
    level = random_level(seed)
    sharp = Overflow().force([rate, limit], tank(level))
    np.testing.assert_allclose(sharp.value, [rate * max(h - limit, 0.0) for h in level], rtol=1e-12)
    rounded = Overflow().force([rate, limit], tank(level, smoothing=0.1))
    width = 0.1 * np.std(level)
    off = np.abs(level - limit) > width
    np.testing.assert_array_equal(rounded.value[off], sharp.value[off])
    assert np.all(rounded.value >= sharp.value)
    assert np.all(rounded.value - sharp.value <= rate * width / 4 * (1 + 1e-9))


def test_a_large_rate_holds_the_level_at_the_brim():
    """h' = 1 - h / 10 - q by small Euler steps: without overflow to 10, with it to just above the limit."""
    level = 0.0
    for _ in range(20000):
        overflow = Overflow().force([100.0, 4.0], tank([level], scale=1.0)).value[0]
        level += 1e-3 * (1.0 - level / 10.0 - overflow)
    assert 4.0 < level < 4.0 + 1.0 / 100.0


def test_starts_of_the_overflow_lie_near_the_top_of_the_level():
    level = np.linspace(0.0, 10.0, 1001)
    motion = tank(level)
    starts = Overflow().starts(Situation(motion=motion, residual_frequencies=(), dt=1.0, longest=1000.0))
    assert [round(limit, 6) for _, limit in starts] == [9.5, 9.0, 8.0, 6.5]
    empty = replace(motion, displacement=np.empty(0))
    assert Overflow().starts(Situation(motion=empty, residual_frequencies=(), dt=1.0, longest=0.0)) == ()


def test_neither_flow_may_be_negative_by_its_bounds():
    assert PowerLawFlow.parameters[0].lower == 0.0
    assert (PowerLawFlow.parameters[1].lower, PowerLawFlow.parameters[1].upper) == (0.05, 3.0)
    assert Overflow.parameters[0].lower == 0.0
    for effect in (PowerLawFlow(), Overflow()):
        assert effect.acts_at == "flow"
        assert np.all(effect.force(effect.neutral, tank([1.0, 2.0])).value == 0.0)


# --- over a step -----------------------------------------------------------------------------------------------------


def about_the_brim(seed, compliance, smoothing=0.2):
    """Levels before and after a step, most within the rounded corner of a brim at 0.3."""
    rng = np.random.default_rng(seed)
    before, after = (tank(0.3 + rng.uniform(-0.4, 0.4, 30), scale=1.0, smoothing=smoothing) for _ in range(2))
    return replace(before, step_compliance=compliance), replace(after, step_compliance=compliance)


@given(seed=seeds, rate=st.floats(0.1, 10.0), compliance=st.floats(0.05, 2.0))
def test_the_line_over_a_step_has_the_derivatives_that_it_claims(seed, rate, compliance):
    before, after = about_the_brim(seed, compliance)

    def line(values=(rate, 0.3), shift=(0.0, 0.0)):
        start = replace(before, displacement=before.displacement + shift[0])
        end = replace(after, displacement=after.displacement + shift[1])
        return Overflow().step_force(values, start, end)

    here = line()
    assert here.reads == "displacement"
    for name in ("start", "end"):
        for which, shifted in (("before", lambda x: (x, 0.0)), ("after", lambda x: (0.0, x))):
            found = central(lambda x, name=name, shifted=shifted: getattr(line(shift=shifted(x)), name).value, 0.0)
            assert disagreement(getattr(getattr(here, name), f"by_{which}"), found) < 1e-4
        for j in range(2):
            found = by_value(lambda values, name=name: getattr(line(values), name).value, (rate, 0.3), j)
            assert disagreement(getattr(here, name).by_parameter[:, j], found) < 1e-4


@pytest.mark.parametrize("rate", [1e2, 1e4, 1e8, 1e15])
def test_a_step_onto_a_hard_brim_ends_at_the_brim_and_stays(rate):
    """One step of h' = 1 - q from below and one from the brim: h1 = h0 + dt - compliance x mean of the line."""
    dt, limit = 0.1, 1.0
    for start in (0.95, 1.0):

        def miss(end, start=start):
            motions = [replace(tank([h], scale=0.3, smoothing=0.005), step_compliance=dt) for h in (start, end)]
            line = Overflow().step_force([rate, limit], *motions)
            return end - (start + dt - dt * 0.5 * (line.start.value[0] + line.end.value[0]))

        low, high = 0.9, 1.2
        for _ in range(80):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if miss(middle) < 0.0 else (low, middle)
        assert abs(low - limit) < 2.0 / rate + dt / WALL


def test_the_corner_of_a_hard_brim_is_narrower():
    """Nine times as hard as a step is long: a tenth of the width."""
    level = np.linspace(-0.5, 0.5, 101)
    soft, hard = (replace(tank(level, scale=1.0, smoothing=0.305), step_compliance=c) for c in (0.0, 1.0))
    assert np.count_nonzero(Overflow().force([9.0, 0.0], soft).value) == 81
    assert np.count_nonzero(Overflow().force([9.0, 0.0], hard).value) == 54


def test_where_a_flow_moves_nothing_at_once_there_is_no_line_of_its_own():
    before, after = about_the_brim(0, 0.0)
    assert Overflow().step_force((2.0, 0.3), before, after) is None
