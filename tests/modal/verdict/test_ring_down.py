"""What rings down under friction, drag or a spring that is not linear is told; what modes make is not.

The truth comes from `scipy.integrate.solve_ivp`, from reversal to reversal.
"""

from dataclasses import replace

import numpy as np
import pytest
import scipy
from scipy.integrate import solve_ivp

import modal
import okid
from modal.modes.mode import ModalModel, Mode
from modal.sections.words import next_sentences
from modal.verdict import ring_down
from modal.verdict.oscillator import motion, motions
from modal.verdict.ring_down import LATER, RINGS, RingDown, carried, contest_of, told_of_ring_down

DT = 0.02


def released(n_samples, *, w=2 * np.pi * 1.3, z=0.004, friction=0.0, drag=0.0, cubic=0.0, start=(1.0, 0.0)):
    """(n_samples,) displacement of x'' + 2 z w x' + w^2 (x + f sign(x') + d x'|x'| / w^2 + k x^3) = 0."""
    times, x = DT * np.arange(n_samples), np.empty(n_samples)
    t, (place, speed) = 0.0, start
    while t < times[-1]:
        way = np.sign(speed) if speed else -np.sign(place)
        if not speed and abs(place + cubic * place**3) <= friction:
            x[times >= t] = place
            break

        def slope(_, state, way=way):
            force = state[0] + cubic * state[0] ** 3 + way * friction + drag * state[1] * abs(state[1]) / w**2
            return [state[1], -2 * z * w * state[1] - w**2 * force]

        def turns(_, state):
            return state[1]

        turns.terminal, turns.direction = True, -way
        run = solve_ivp(
            slope, (t, times[-1] + DT), [place, speed], events=turns, rtol=1e-10, atol=1e-12, dense_output=True,
            first_step=1e-4,
        )  # fmt: skip
        there = (times >= t) & (times <= run.t[-1])
        x[there] = run.sol(times[there])[0]
        t, (place, speed) = run.t[-1], (run.y[0, -1], 0.0)
    return x


def asked(x, noise, *, seed=1, step=0.0, modes=()):
    """What is found of outputs (n, ...), with white noise or rounded to steps, beside a linear model that leaves it."""
    outputs = np.reshape(x, (len(x), -1))
    left = noise * np.random.default_rng(seed).standard_normal(outputs.shape)
    seen = outputs + left if not step else step * np.round(outputs / step)
    return bent([okid.Record([], seen, DT)], [left], modes)


def bent(records, left, modes=()):
    contest = contest_of(records, left, modes)
    return None if contest is None else contest.bent


def identified(x, noise=1e-3, *, seed=1, dt=DT, **given):
    outputs = np.reshape(x, (len(x), -1))
    outputs = outputs + noise * np.random.default_rng(seed).standard_normal(outputs.shape)
    return modal.identify(okid.Record([], outputs, dt), kind="decay", **given)


def told(result):
    return [text for text in result.warnings if "does not die away as a mode does" in text]


def line(said):
    """Frequency that a sentence names first [Hz]."""
    return float(said.split("rings at ")[1].split()[0])


@pytest.mark.parametrize(
    ("noise", "step"), [(1e-3, 0.0), pytest.param(1e-4, 0.0, marks=pytest.mark.slow), (1e-3, 2e-3)]
)
def test_dry_friction_is_told_with_its_size(noise, step):
    found = asked(released(500, friction=0.02, start=(0.6, 6.0)), noise, step=step)
    assert found is not None
    assert np.allclose(found.frequency, 1.3, rtol=2e-3)
    size = np.hypot(0.6, 6.0 / (2 * np.pi * 1.3))
    assert abs(found.friction * size - 0.02) < 1e-3
    assert found.damping_ratio[1] > 5 * found.damping_ratio[0]
    assert "dry friction" in found.sentence


@pytest.mark.parametrize("seed", [5, pytest.param(13, marks=pytest.mark.slow)])
def test_a_mode_whose_phase_four_outputs_share_is_no_dearer_than_the_oscillator(seed):
    """A linear mode under wind of 2 % of its start: each size was paid for twice, and it was accused."""
    rng = np.random.default_rng([seed, 4])
    turned = 2 * np.pi * 1.3 * DT
    once = np.exp(turned * (-0.01 + 1j * np.sqrt(1 - 0.01**2)))
    shape = rng.standard_normal(4)
    pushed = scipy.signal.lfilter([0.0, 1j], [1.0, -once], rng.standard_normal(1000))[400:].real
    ringing = (np.exp(1j * rng.uniform(0, 6.3)) * once ** np.arange(600)).real
    left = np.outer(0.02 * pushed / pushed.std(), shape) + 1e-3 * rng.standard_normal((600, 4))
    assert bent([okid.Record([], np.outer(ringing, shape) + left, DT)], [left]) is None


def test_the_half_cycles_are_those_of_the_equation():
    times = np.arange(500.0)
    parameters = np.array([2 * np.pi * 1.3 * DT, 0.004, 0.0, 0.02, *np.zeros(6)])
    x = released(500, friction=0.02)
    place, speed, acceleration = motion(parameters, times)
    assert np.abs(place - x).max() < 1e-8
    assert np.abs(np.gradient(place)[1:-1] - speed[1:-1]).max() < 2e-3
    slides = np.abs(np.diff(acceleration)) < 0.005  # not across a reversal
    assert np.abs((np.gradient(speed) - acceleration)[:-1][slides][1:-1]).max() < 2e-3


def test_oscillators_side_by_side_are_each_by_itself():
    """One begins at rest, one comes to rest, one turns more often than the others."""
    times = np.delete(np.arange(300.0), [40, 41, 170])
    laws = np.zeros((4, 10))
    laws[:, 0], laws[:, 1], laws[:, 2] = (0.16, 0.2, 0.17, 0.31), 0.004, (0.3, np.pi / 2, 0.0, 2.0)
    laws[1, 3:6], laws[2, 3], laws[3, 4:] = (0.9, 0.1, 0.1), 0.05, 0.05
    together = motions(laws, times)
    alone = [motion(law, times) for law in laws]
    assert np.ptp(alone[2][0][-50:]) == 0.0
    np.testing.assert_array_equal(together, np.swapaxes(alone, 0, 1))


def test_drag_is_told():
    dragged = asked(released(500, drag=0.06), 1e-3)
    assert "as under drag" in dragged.sentence
    assert dragged.damping_ratio[0] > 2 * dragged.damping_ratio[1]


def test_a_spring_that_hardens_is_told_beside_its_harmonics():
    result = identified(released(300, cubic=0.3), observer_order=45, ridge=0.001)
    (said,) = told(result)
    assert "spring that is not linear" in said
    assert not result.modes.system


@pytest.mark.parametrize(
    ("seed", "step"),
    [
        pytest.param(seed, step, marks=[pytest.mark.slow] * (seed % 2 == (step == 0.0)))
        for seed in range(6)
        for step in (0.0, 4e-3)
    ],
)
def test_modes_are_not_accused(seed, step):
    """One to six modes, close ones among them, in several outputs, with white noise or rounded."""
    rng = np.random.default_rng(seed)
    n_modes, n_outputs, k = seed + 1, 1 + seed % 3, np.arange(900)[:, np.newaxis]
    frequencies = 0.03 * np.array([1.0, 1.02, 2.2, 3.1, 3.15, 5.0])[:n_modes]
    dampings = rng.uniform(0.003, 0.03, n_modes)
    poles = 2 * np.pi * frequencies * (-dampings + 1j * np.sqrt(1 - dampings**2))
    sizes = rng.standard_normal((n_modes, n_outputs)) + 1j * rng.standard_normal((n_modes, n_outputs))
    x = (np.exp(k * poles) @ sizes).real
    assert asked(x, 2e-3, seed=seed, step=step) is None


def test_what_the_linear_model_leaves_far_below_is_not_the_oscillators():
    x = released(500, friction=0.02)
    with_more = np.stack([x, x], axis=1) + 0.2 * released(500, w=2 * np.pi * 4.1)[:, np.newaxis]
    assert asked(with_more, 1e-4) is None
    assert asked(np.stack([x, -0.4 * x], axis=1), 1e-4) is not None


def test_rows_that_are_driven_still_or_missing_tell_nothing():
    x = released(500, friction=0.02)
    noise = 1e-3 * np.random.default_rng(3).standard_normal((500, 1))
    outputs, blow = x[:, np.newaxis] + noise, np.zeros((500, 1))
    blow[0] = 1.0
    outputs[200:210] = np.nan
    found = bent([okid.Record(blow, outputs, DT)], [noise])
    assert abs(found.friction - 0.02) < 1e-3
    still = np.concatenate([outputs, np.full((3000, 1), outputs[-1])])
    (again,) = [bent([okid.Record([], still, DT)], [np.concatenate([noise, np.zeros((3000, 1))])])]
    assert abs(again.friction - 0.02) < 1e-3
    blow[-20] = 1.0
    assert bent([okid.Record(blow, outputs, DT)], [noise]) is None
    assert bent([okid.Record([], np.ones((200, 1)), DT)], [np.zeros((200, 1))]) is None


def test_no_mode_is_certain_in_a_decay_under_friction():
    x = released(343, w=2 * np.pi * 2.3, z=0.0022, friction=0.0514)
    seen = x + 2.6e-3 * np.random.default_rng(5).standard_normal(343)
    record = okid.Record([], seen, DT, output_names=["angle"], output_units=["rad"])
    found = modal.identify(record, observer_order=45, ridge=0.003)
    assert found.record_kind == "decay"
    assert not found.modes.system
    assert any("does not die away as a mode does" in words for words in found.warnings)
    assert not any("found again often enough" in words for words in found.warnings)
    assert [one.value for one in found.choices if one.what == RINGS] == ["not as modes do"]
    assert next_sentences(found)[0].startswith("Quote no damping")
    assert any("another damping or frequency at each level" in mode.reason for mode in found.modes.modes)
    assert all(mode.probability < 0.8 for mode in found.modes.modes)


def test_the_sentence_says_what_takes_most():
    plain = RingDown(level=LATER, frequency=(2.0, 2.0), damping_ratio=(0.02, 0.13), friction=0.02, drag=0.0, gain=3.0)
    assert "dry friction of 2 % of the spring's force" in plain.sentence
    assert "3 times as closely as two modes" in plain.sentence
    assert "explains the decay with fewer numbers than two modes do" in replace(plain, gain=0.99).sentence
    assert "explains the decay more closely than two modes do" in replace(plain, gain=1.01).sentence
    assert "damping 2 % at the start, 13 % at 10 %" in plain.sentence
    assert LATER == 0.1
    assert "as under drag" in replace(plain, friction=0.0, drag=0.015).sentence
    assert "not linear" in replace(plain, frequency=(2.2, 2.0), friction=0.0, drag=0.001).sentence


# --- what is certain is most of what rings ----------------------------------------------------------------------------


def modes_of(*told):
    """Modes (frequency [Hz], size, verdict) of 1 % damping in two outputs, released once."""
    made = [
        Mode(
            pole=2 * np.pi * frequency * complex(-0.01, 1.0),
            kind="oscillatory",
            frequency=frequency,
            damping_ratio=0.01,
            shape=np.array([1.0, 0.5], dtype=complex),
            participation=np.array([size], dtype=complex),
            verdict=verdict,
        )
        for frequency, size, verdict in told
    ]
    return ModalModel(modes=tuple(made), dt=DT, indicator_caution=0.1)


@pytest.mark.parametrize(
    ("size", "verdict", "share"), [(3.0, "noise", 0.1), (0.5, "doubtful", 0.8), (3.0, "system", 1.0)]
)
def test_modes_carry_their_share_of_the_energy(size, verdict, share):
    """Of two far apart, each as large as its size squared."""
    told = modes_of((5.0, 1.0, "system"), (5.0 * np.sqrt(2.0), size * 2**0.25, verdict))
    assert carried(told, n_steps=4000, output_scale=np.ones(2)) == pytest.approx(share, abs=0.01)


def test_poles_that_cancel_carry_no_more_than_their_sum():
    told = modes_of((5.0, 1.0, "system"), (9.0, 100.0, "noise"), (9.0, -100.0, "noise"))
    assert carried(told, n_steps=400, output_scale=np.ones(2)) == pytest.approx(1.0)
    one_more = modes_of((9.0, 100.0, "system"), (9.0, -100.0, "noise"), (5.0, 1.0, "noise"))
    assert carried(one_more, n_steps=400, output_scale=np.ones(2)) < 0.0


def test_outputs_count_by_their_scale():
    """The second output is in another unit: what only it sees is large there alone."""
    told = modes_of((5.0, 1.0, "system"), (9.0, 1.0, "noise"))
    own = replace(told.modes[1], shape=np.array([0.0, 100.0], dtype=complex))
    told = replace(told, modes=(told.modes[0], own))
    assert carried(told, n_steps=400, output_scale=np.array([1.0, 1.0])) < 0.1
    assert carried(told, n_steps=400, output_scale=np.array([1.0, 1e3])) > 0.9


@pytest.mark.parametrize(("reason", "share"), [("second pole of the mode at 5 Hz; found again: 1.00", 1.0), ("", 0.01)])
def test_the_second_pole_of_a_resonance_was_found_again(reason, share):
    told = modes_of((5.0, 0.1, "system"), (9.0, 1.0, "doubtful"))
    told = replace(told, modes=(told.modes[0], replace(told.modes[1], reason=reason)))
    assert carried(told, n_steps=4000, output_scale=np.ones(2)) == pytest.approx(share, abs=0.02)


@pytest.mark.parametrize(
    ("frequency", "doubts", "share"), [(20.0, (("data", "a line"),), 1.0), (20.0, (), 0.1), (0.01, (), 1.0)]
)
def test_hum_that_is_doubted_and_drift_count_on_neither_side(frequency, doubts, share):
    """Both are stronger than what rings, and no part of it."""
    told = modes_of((5.0, 1.0, "system"), (frequency, 3.0 * np.sqrt(frequency / 5.0), "doubtful"))
    told = replace(told, modes=(told.modes[0], replace(told.modes[1], doubts=doubts)))
    assert carried(told, n_steps=4000, output_scale=np.ones(2)) == pytest.approx(share, abs=0.01)


def swing(angle, n_samples):
    times = DT * np.arange(n_samples)

    def slope(_, state):
        return [state[1], -((2 * np.pi * 1.3) ** 2) * np.sin(state[0]) - 0.15 * state[1]]

    return solve_ivp(slope, (0.0, times[-1]), [angle, 0.0], t_eval=times, rtol=1e-9, atol=1e-11).y[0]


@pytest.mark.parametrize(
    ("frequency", "size", "shape", "certain"),
    [
        (5.06, 0.8, (1.0, 0.5), False),  # side by side, and alike
        (5.06, 0.8j, (1.0, 0.5), False),  # at whatever phase
        (5.06, 0.8, (0.5, -1.0), True),  # of another shape
        (5.06, 0.1, (1.0, 0.5), True),  # too weak to take half of it
        (7.0, 50.0, (1.0, 0.5), True),  # far away, however strong
    ],
)
def test_poles_side_by_side_are_not_certain_where_what_is_left_dies_away(frequency, size, shape, certain):
    """What is left shows that no sum of modes rings: what pole has which part of one answer is chance."""
    modes = modes_of((5.0, 1.0, "system"), (frequency, size, "noise"))
    modes = replace(modes, modes=(modes.modes[0], replace(modes.modes[1], shape=np.array(shape, dtype=complex))))
    record = okid.Record(np.eye(4000, 1), np.zeros((4000, 2)), DT)
    left = [np.ones((4000, 2))]
    as_it_was = told_of_ring_down(modes, [record], left, output_scale=np.ones(2), is_decay=False)
    assert (as_it_was.modes, as_it_was.warnings) == (modes, ())
    found = told_of_ring_down(modes, [record], left, output_scale=np.ones(2), is_decay=False, times=2.5)
    assert "dies away after each blow" in found.warnings[0]
    assert "2.5 times as large" in found.warnings[0]
    assert "deviations are larger by that" in found.warnings[0]
    assert found.times == 2.5
    far = told_of_ring_down(modes, [record], left, output_scale=np.ones(2), is_decay=False, times=9.0)
    assert "no interval is given" in far.warnings[0]
    assert [mode.verdict for mode in found.modes] == ["system" if certain else "doubtful", "noise"]


@pytest.mark.slow
@pytest.mark.parametrize("angle", [1.6, 1.8, 2.0])
def test_the_frequency_of_a_pendulum_is_told_at_its_level(angle):
    """Poles side by side followed it, and up to ten of them were certain without a word."""
    result = identified(swing(angle, 600), seed=2)
    (said,) = told(result)
    assert not result.modes.system
    at_start = 1.3 * np.pi / (2 * scipy.special.ellipk(np.sin(angle / 2) ** 2))
    assert line(said) == pytest.approx(at_start, rel=0.02)
    assert "spring that is not linear" in said


def test_no_mode_is_certain_beside_what_neither_few_modes_nor_an_oscillator_describe():
    """From 2.6 rad; the modes that are certain carry little of it, the rest was not found again."""
    left = 1e-3 * np.random.default_rng(2).standard_normal((600, 2))
    record = okid.Record([], np.outer(swing(2.6, 600), [1.0, 0.5]) + left, DT)
    modes = modes_of((1.1, 0.1, "system"), (1.2, 1.0, "noise"))
    found = told_of_ring_down(modes, [record], [left], output_scale=np.ones(2), is_decay=True)
    assert not found.modes.system
    assert "described only by poles that were not found again" in found.warnings[0]
    assert [(one.what, one.value) for one in found.choices] == [(RINGS, "not as modes do")]
    driven = told_of_ring_down(modes, [record], [left], output_scale=np.ones(2), is_decay=False)
    assert (driven.modes, driven.warnings) == (modes, ())
    carrying = modes_of((1.1, 1.0, "system"), (1.2, 0.1, "noise"))
    certain = told_of_ring_down(carrying, [record], [left], output_scale=np.ones(2), is_decay=True)
    assert certain.modes.system


@pytest.mark.slow
def test_no_mode_is_certain_of_a_pendulum_that_swings_far():
    """From 2.6 rad no law of a few powers of the level follows it: before, three poles of the system side by side."""
    found = identified(swing(2.6, 1200), seed=2)
    assert not found.modes.system
    assert any("described only by poles that were not found again" in text for text in found.warnings)
    assert [one.value for one in found.choices if one.what == RINGS] == ["not as modes do"]
    assert next_sentences(found)[0].startswith("Quote no damping")


def rings(n_samples, *modes, dt=0.01):
    """(n_samples,) sum of modes (frequency [Hz], damping ratio, size, phase)."""
    turned = 2 * np.pi * dt * np.arange(n_samples)
    return sum(size * np.exp(-z * f * turned) * np.cos(f * turned + phase) for f, z, size, phase in modes)


def test_a_close_pair_takes_no_certainty_from_another_mode():
    """One of the two poles of a pair is called the second of one resonance, although it was found again."""
    close = rings(1000, (4.751, 0.008, 1.0, 0.3), (4.799, 0.012, 1.0, 2.0), (27.367, 0.01, 0.5, 1.0))
    result = identified(close, 5e-3, dt=0.01, observer_order=23, ridge=0.001)
    assert min(abs(mode.frequency - 27.367) for mode in result.modes.system) < 0.05
    assert not told(result)


@pytest.mark.parametrize("kind", ["octave", "sensor"])
def test_a_close_pair_with_something_at_its_octave_is_not_accused(kind):
    """The oscillator alone had harmonics, so a beat with a weak mode near 2 f was called friction in half the cases."""
    pair = rings(600, (5.583, 0.004, 1.0, 0.3), (5.657, 0.003, 0.3, 2.0))
    seen = pair + (rings(600, (11.127, 0.008, 0.03, 1.0)) if kind == "octave" else 0.02 * pair**2)
    assert asked(seen, 4e-3) is None


def test_friction_is_told_beside_a_mode():
    turned = 2 * np.pi * 9 * DT * np.arange(500)
    other = 0.3 * np.exp(-0.01 * turned) * np.cos(turned)
    (mode,) = modes_of((9.0, 0.3, "system"))
    found = asked(released(500, w=2 * np.pi * 2.1, friction=0.03) + other, 2e-3, modes=(mode,))
    assert "dry friction of 3 %" in found.sentence
    assert found.frequency[0] == pytest.approx(2.1, rel=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("beside", ["hum", "drift", "mode"])
def test_friction_is_told_beside_what_else_is_there(beside):
    times = DT * np.arange(500)
    other = {
        "hum": 0.02 * np.sin(2 * np.pi * 17 * times),
        "drift": 0.5 * times / times[-1],
        "mode": 0.3 * np.exp(-0.01 * 2 * np.pi * 9 * times) * np.cos(2 * np.pi * 9 * times),
    }
    result = identified(released(500, w=2 * np.pi * 2.1, friction=0.03) + other[beside], 2e-3)
    (said,) = told(result)
    assert "dry friction of 3 %" in said
    assert line(said) == pytest.approx(2.1, rel=2e-3)
    assert not result.modes.system


def test_poles_that_gain_no_more_than_chance_are_too_many():
    """Two modes, noise, and six poles near them that are about to be certain."""
    x = rings(600, (6.4, 0.01, 1.0, 0.3), (7.1, 0.02, 0.6, 2.0), dt=DT)
    left = 2e-3 * np.random.default_rng(4).standard_normal((600, 1))
    crowded = modes_of(*((frequency, 1.0, "system") for frequency in (5.8, 6.3, 6.5, 7.0, 7.2, 7.6))).modes
    contest = contest_of([okid.Record([], x[:, np.newaxis] + left, DT)], [left], crowded)
    assert contest.crowd == 6
    assert contest.few
    long = rings(3000, (6.4, 0.0002, 1.0, 0.3), (7.1, 0.0002, 0.6, 2.0), dt=DT)  # 400 cycles, of which 100 are asked
    noise = 2e-3 * np.random.default_rng(5).standard_normal((3000, 1))
    assert contest_of([okid.Record([], long[:, np.newaxis] + noise, DT)], [noise], crowded).crowd == 0
    third = x + rings(600, (8.2, 0.015, 0.4, 1.0), dt=DT)
    contest = contest_of([okid.Record([], third[:, np.newaxis] + left, DT)], [left], crowded)
    assert contest.crowd == 0
    assert not contest.few


# --- rows, gaps, silent channels --------------------------------------------------------------------------------------


@pytest.mark.parametrize("n_samples", [810, 1300])
def test_of_long_records_every_so_manieth_row_tells_the_same(n_samples, monkeypatch):
    """The frequency is per sample, whatever rows are taken."""
    monkeypatch.setattr(ring_down, "MOST_ROWS", 400)
    slow, _, _ = motion(np.array([2 * np.pi * 1.3 * 0.01, 0.004, 0.3, 0.02, *np.zeros(6)]), np.arange(float(n_samples)))
    noise = 1e-3 * np.random.default_rng(1).standard_normal((n_samples, 1))
    found = bent([okid.Record([], slow[:, np.newaxis] + noise, 0.01)], [noise])
    assert found is not None
    assert np.allclose(found.frequency, 1.3, rtol=2e-3)
    assert found.friction == pytest.approx(0.02, rel=0.03)


@pytest.mark.parametrize("kept", [slice(None, None, 2), "half"])
def test_rows_that_are_missing_stretch_no_frequency(kept):
    friction = released(500, friction=0.02, start=(0.6, 6.0))
    there = np.zeros(500, dtype=bool)
    there[kept if kept != "half" else np.random.default_rng(1).random(500) < 0.5] = True
    found = asked(np.where(there, friction, np.nan), 1e-3)
    assert found is not None
    assert np.allclose(found.frequency, 1.3, rtol=2e-3)


def test_a_record_too_short_for_the_question_silences_no_other():
    long = released(500, friction=0.02, start=(0.6, 6.0))[:, np.newaxis]
    records = [okid.Record([], part, DT) for part in (long[:20], long, np.ones((100, 1)))]
    left = [1e-3 * np.random.default_rng(1).standard_normal(record.outputs.shape) for record in records]
    records = [
        replace(record, outputs=record.outputs + errors) for record, errors in zip(records[:2], left[:2], strict=True)
    ]
    assert bent([*records, okid.Record([], np.ones((100, 1)), DT)], left) is not None
    assert bent(records[:1], left[:1]) is None


def test_nothing_is_asked_of_an_output_that_stands_still():
    still = np.ones((200, 1))
    still[150] = np.nan
    assert bent([okid.Record([], still, DT)], [np.zeros_like(still)]) is None


def test_a_dead_output_changes_no_number():
    friction = released(500, friction=0.02, start=(0.6, 6.0))
    alone, beside = asked(friction, 5e-3), asked(np.column_stack([friction, np.zeros(500)]), 5e-3)
    assert alone is not None
    assert beside is not None
    assert beside.friction == pytest.approx(alone.friction, rel=0.05)
    assert beside.frequency == pytest.approx(alone.frequency, rel=2e-3)


@pytest.mark.parametrize(
    ("ratio", "apart", "size", "other"),
    [(0.0037, 1.01, 0.106, 0.003), (0.01, 1.05, 0.05, 0.04), (0.003, 0.93, 0.4, 0.003), (0.002, 1.004, 0.3, 0.02)],
)
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_close_pairs_are_not_accused(ratio, apart, size, other, seed):
    """A weak mode, or a heavily damped one, beside another within a few of its widths."""
    turned = 2 * np.pi * 0.02 * np.arange(800.0)
    x = np.exp(-ratio * turned) * np.cos(turned + 0.7) + size * np.exp(-other * apart * turned) * np.cos(apart * turned)
    assert asked(x, 2e-3, seed=seed) is None


def test_harmonics_alone_are_no_ring_down():
    """A plucked string has them of its own, a sensor that is not linear makes them of one mode."""
    turned = 0.15 * np.arange(500.0)
    at = np.array([0.2, 0.4, 0.7])
    string = sum(
        (np.exp(-0.005 * k * turned) * np.cos(k * turned))[:, np.newaxis] * np.sin(k * np.pi * at) / k**2
        for k in (1, 2, 3)
    )
    assert asked(string, 1e-3) is None
    one = np.exp(-0.005 * turned) * np.cos(turned)
    assert asked(one + 0.05 * one**2, 1e-3) is None


def test_damping_is_told_at_a_level_that_is_reached():
    """Friction of a quarter of the spring's force stops it far above a tenth."""
    found = asked(released(300, friction=0.25, start=(1.0, 0.0)), 1e-3)
    assert found is not None
    assert found.level == pytest.approx(0.5, rel=0.1)
    assert max(found.damping_ratio) < 0.4
    assert "% at 5" in found.sentence


@pytest.mark.parametrize(("missing", "seed"), [pytest.param(0.2, 0, marks=pytest.mark.slow), (0.5, 1)])
def test_samples_that_were_filled_are_no_evidence(missing, seed):
    """They come from a linear model, and so would say that a mode rings."""
    rng = np.random.default_rng(seed)
    outputs = released(343, w=2 * np.pi * 2.3, friction=0.0514, start=(1.0, 0.0)) + 2.6e-3 * rng.standard_normal(343)
    outputs[rng.random(343) < missing] = np.nan
    outputs[0] = 1.0
    found = modal.identify(okid.Record([], outputs, DT), kind="decay", observer_order=64, ridge=3e-6)
    assert not [mode for mode in found.modes.modes if mode.verdict == "system"]
    (said,) = told(found)
    assert line(said) == pytest.approx(2.3, rel=2e-3)


def test_outputs_are_asked_in_rows_that_they_do_not_share():
    outputs = released(450, w=2 * np.pi * 2.1, friction=0.02)[:, np.newaxis] * [1.0, 0.6]
    outputs[np.arange(450) % 20 != 0, 1] = np.nan
    found = asked(outputs, 2e-3)
    assert found is not None
    assert np.allclose(found.frequency, 2.1, rtol=3e-3)
    assert found.friction == pytest.approx(0.02, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(("missing", "n_samples"), [("every 20th row", 450), ("55 % of three", 900)])
def test_outputs_tell_what_they_were_asked_in_rows_that_they_do_not_share(missing, n_samples):
    """Only rows common to all outputs were asked: the line was an alias of them, 0.4 Hz for 2.1 Hz."""
    rng = np.random.default_rng(2)
    outputs = released(n_samples, w=2 * np.pi * 2.1, friction=0.02)[:, np.newaxis] * [1.0, 0.6, -0.4]
    outputs += 2e-3 * rng.standard_normal(outputs.shape)
    if missing == "every 20th row":
        outputs = outputs[:, :2]
        outputs[np.arange(n_samples) % 20 != 0, 1] = np.nan
    else:
        outputs[rng.random(outputs.shape) < 0.55] = np.nan
        outputs[0] = [1.0, 0.6, -0.4]
    (said,) = told(modal.identify(okid.Record([], outputs, DT), kind="decay"))
    assert line(said) == pytest.approx(2.1, rel=3e-3)
    assert "dry friction of 2 %" in said


@pytest.mark.slow
@pytest.mark.parametrize("beside", ["hum", "drift"])
def test_hum_and_drift_take_no_mode_of_a_decay_away(beside):
    """They are stronger than what rings, and no part of it."""
    rng, times = np.random.default_rng(2), 0.002 * np.arange(4000)
    rings = [(7.3, 0.02, (1.0, 0.6)), (19.1, 0.015, (-0.5, 0.7)), (43.0, 0.01, (0.3, -0.2))]
    outputs = 2e-3 * rng.standard_normal((4000, 2))
    for frequency, ratio, shape in rings:
        turned = 2 * np.pi * frequency * times
        outputs += (np.exp(-ratio * turned) * np.cos(turned + frequency))[:, np.newaxis] * shape
    other = np.sin(2 * np.pi * 50 * times) if beside == "hum" else 2 * np.sin(2 * np.pi * 0.06 * times + 0.3)
    outputs += other[:, np.newaxis] * [0.5, 0.4]
    found = modal.identify(okid.Record([], outputs, 0.002), kind="decay")
    seen = [mode.frequency for mode in found.modes.modes if mode.verdict == "system"]
    assert seen == pytest.approx([7.3, 19.1, 43.0], rel=2e-3)


def still_driven(seed, n=1200, w=2 * np.pi * 1.3, z=0.005):
    """A mode released from 1 and driven by white noise that makes it move by 2 % of that."""
    rng = np.random.default_rng((7, seed))
    pole = np.exp((-z + 1j * np.sqrt(1 - z**2)) * w * DT)
    pushes = rng.standard_normal(n + 4000) + 1j * rng.standard_normal(n + 4000)
    driven = scipy.signal.lfilter([1.0], [1.0, -pole], pushes).real[4000:]
    driven *= 0.02 / driven.std()
    return (pole ** np.arange(n)).real + driven


@pytest.mark.parametrize("seed", [pytest.param(0, marks=pytest.mark.slow), 9])
def test_a_mode_that_is_still_driven_while_it_rings_down_is_no_other_oscillator(seed):
    """Errors that ring with the mode: taken for white noise they accused 7 of the seeds 0 to 23, these among them."""
    assert asked(still_driven(seed), 0.01, seed=seed) is None
