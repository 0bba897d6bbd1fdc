from dataclasses import replace

import numpy as np
import pytest
import scipy.signal
from systems import random_system, simulate

from era.realisation import Realisation
from modal.modes.extraction import extract_modes
from modal.modes.mode import ModalModel, Mode
from modal.verdict.constancy import sums_of_stronger
from modal.verdict.excitation import beyond_inputs, by_chance, driven_gain, ringing
from okid.record import Record


@pytest.fixture
def case():
    """A system with a real pole, its record from rest, 10 % noise, the last third held out."""
    rng = np.random.default_rng(0)
    truth = random_system(rng, n_real_poles=1)
    u = rng.standard_normal((1500, 2))
    u -= u.mean(axis=0)
    y = simulate(truth, u)
    y += 0.1 * y.std(axis=0) * rng.standard_normal(y.shape)
    realisation = Realisation(truth.A, truth.B, truth.C, truth.D, truth.dt)
    return realisation, extract_modes(realisation), Record(u, y, truth.dt), np.arange(1500) >= 1000


def rests(realisation, record):
    """What a run from rest leaves."""
    state, left = np.zeros(realisation.order), np.empty_like(record.outputs)
    for k, u in enumerate(record.inputs):
        left[k] = record.outputs[k] - realisation.C @ state - realisation.D @ u
        state = realisation.A @ state + realisation.B @ u
    return left


def gain_of(realisation, model, record, rows):
    return driven_gain(model, [record], [rests(realisation, record)], rows=[rows])


def naive(realisation, model, record, rows, memory=0.0):
    """One sample after the other, one mode's answer to the inputs left out at a time, free motion by least squares.

    The noise of each output remembers so much of its last sample.
    """

    def white(values, counted=rows):
        return (values[1:] - memory * values[:-1])[counted[1:]] if memory else values[counted]

    left = rests(realisation, record)
    scale = np.sqrt((white(left, np.ones_like(rows)) ** 2).mean(axis=0))
    gains = []
    for mode in model:
        part, free = np.zeros_like(record.outputs), np.ones((len(left), 3))
        state, pole = 0j, np.exp(mode.pole * model.dt)
        for k, u in enumerate(record.inputs):
            part[k] = (mode.shape * state).real * (2 if mode.kind == "oscillatory" else 1)
            free[k, 1:] = (pole**k).real, (pole**k).imag
            state = pole * state + mode.participation @ u
        mine = white(free / np.maximum(np.abs(free[rows]).max(axis=0), 1e-300))
        sizes = [
            ((values - mine @ np.linalg.lstsq(mine, values, rcond=1e-10)[0]) ** 2).sum()
            for values in (white(left) / scale, white(left + part) / scale)
        ]
        gains.append(1 - sizes[0] / sizes[1])
    return np.array(gains)


def test_a_line_that_a_fitted_state_explains_is_not_driven():
    """Hum as an undamped mode: its fitted state makes up for a driven part of chance, which explains nothing."""
    rng = np.random.default_rng(5)
    pole = 0.99999 * np.exp(0.5j)
    A = np.array([[pole.real, pole.imag], [-pole.imag, pole.real]])
    realisation = Realisation(A, np.array([[0.02], [0.0]]), np.eye(2), np.zeros((2, 1)), 0.01)
    u = rng.standard_normal((2000, 1))
    driven, k = rests(realisation, Record(u, np.zeros((2000, 2)), 0.01)), np.arange(2000)[:, None]
    wave = np.hstack([np.cos(0.5 * k), np.sin(0.5 * k)])
    hum = Record(u, 5.0 * wave + 0.1 * rng.standard_normal((2000, 2)), 0.01)
    # the run of a model whose state was fitted to the hum beside its driven part
    start = np.hstack([(pole**k).real, (pole**k).imag])
    run = -driven + start @ np.linalg.lstsq(start, hum.outputs + driven, rcond=None)[0]
    model = extract_modes(realisation)
    gain = driven_gain(model, [hum], [hum.outputs - run])
    assert gain[0] < 0.05


def test_it_is_the_loss_when_a_modes_answer_is_left_out(case):
    realisation, model, record, rows = case
    np.testing.assert_allclose(
        gain_of(realisation, model, record, rows), naive(realisation, model, record, rows), atol=1e-10
    )


def test_a_mode_is_weighed_by_the_noise_beside_it(case):
    """Noise of low frequencies says little against a mode above it: all errors in one sum would say much.

    Rows are those of a half that is held out, every second pair: what stands before them is there to tell the noise.
    """
    realisation, model, record, _ = case
    rows = np.arange(record.n_samples) % 4 < 2
    rng = np.random.default_rng(3)
    noise = rng.standard_normal(record.outputs.shape)
    for k in range(1, len(noise)):
        noise[k] += 0.95 * noise[k - 1]
    clean = record.outputs - rests(realisation, record)
    red = replace(record, outputs=clean + clean.std(axis=0) * noise)
    gain = gain_of(realisation, model, red, rows)
    true, blind = (naive(realisation, model, red, rows, memory) for memory in (0.95, 0.0))
    np.testing.assert_allclose(gain, true, rtol=0.05, atol=2e-3)
    fastest = max(range(len(model)), key=lambda i: model.modes[i].frequency)
    assert gain[fastest] > 2 * blind[fastest]


def test_true_modes_gain_and_a_mode_driven_by_chance_loses(case):
    realisation, model, record, rows = case
    line = 0.9999 * np.exp(1.1j)
    A = np.zeros((9, 9))
    A[:7, :7], A[7:, 7:] = realisation.A, [[line.real, line.imag], [-line.imag, line.real]]
    with_line = Realisation(
        A,
        np.vstack([realisation.B, [[0.02, 0.01], [-0.01, 0.02]]]),
        np.hstack([realisation.C, np.ones((3, 2))]),
        realisation.D,
        realisation.dt,
    )
    k = np.arange(1500)[:, None]
    hum = Record(record.inputs, record.outputs + np.sin(1.1 * k + 0.4), record.dt)
    model = extract_modes(with_line)
    gain = gain_of(with_line, model, hum, rows)
    for mode, value in zip(model, gain, strict=True):
        is_line = mode.frequency == pytest.approx(1.1 / (2 * np.pi * 0.01), rel=1e-3)
        assert (value < 0) == is_line


@pytest.mark.parametrize("every", [2, 3, 4])
def test_missing_rows_leave_a_gain(case, every):
    """Between gaps there is no past to whiten with; what is there counts all the same."""
    realisation, model, record, _ = case
    left = rests(realisation, record)
    left += np.array(scipy.signal.lfilter([1.0], [1.0, -0.95], left, axis=0))
    left[::every, 0] = np.nan
    gain = driven_gain(model, [record], [left])
    assert np.isfinite(gain).all()
    assert gain.max() > 0.5


def test_several_records_add_up(case):
    realisation, model, record, rows = case
    left = rests(realisation, record)
    left[1:] += 0.9 * left[:-1]  # a colour that one record shows as well as two
    twice = driven_gain(model, [record, record], [left, left], rows=[rows, rows])
    np.testing.assert_allclose(twice, driven_gain(model, [record], [left], rows=[rows]))


def test_all_rows_count_unless_some_are_given(case):
    realisation, model, record, rows = case
    left = [rests(realisation, record)]
    np.testing.assert_array_equal(
        driven_gain(model, [record], left),
        gain_of(realisation, model, record, np.ones_like(rows)),
    )


def test_rows_with_a_missing_output_are_left_out(case):
    realisation, model, record, rows = case
    outputs = record.outputs.copy()
    outputs[1200:1210, 1] = np.nan
    holed = replace(record, outputs=outputs)
    whole = outputs.copy()
    whole[1200:1210] = np.nan
    fewer = rows & ~np.isnan(whole).any(axis=1)
    np.testing.assert_allclose(
        gain_of(realisation, model, holed, rows),
        gain_of(realisation, model, replace(record, outputs=whole), fewer),
    )


def test_growing_modes_have_no_gain_and_do_no_harm(case):
    realisation, model, record, rows = case
    grown = replace(model.modes[0], kind="unstable", pole=complex(300.0, model.modes[0].pole.imag))
    gain = gain_of(realisation, replace(model, modes=(grown, *model.modes[1:])), record, rows)
    assert np.isnan(gain[0])
    assert np.isfinite(gain[1:]).all()


def test_without_inputs_or_rows_nothing_is_known(case):
    realisation, model, record, rows = case
    alone = Record([], record.outputs, record.dt)
    assert np.isnan(driven_gain(model, [alone], [record.outputs])).all()
    assert np.isnan(gain_of(realisation, model, record, np.zeros_like(rows))).all()


def model_of(*poles):
    one = {"shape": np.ones(1), "participation": np.ones(1)}
    modes = [
        Mode(
            pole=pole,
            kind="unstable" if pole.real > 0.0 else "oscillatory",
            frequency=abs(pole) / (2.0 * np.pi),
            damping_ratio=-pole.real / abs(pole),
            **one,
        )
        for pole in poles
    ]
    return ModalModel(modes=tuple(modes), dt=0.01, indicator_caution=0.1)


def test_only_what_rings_after_the_blow_tells_of_a_mode():
    """A pole on a zero of the blow's spectrum follows the blow as well as any, and is over with it."""
    rng, force = np.random.default_rng(3), np.zeros(4000)
    force[696:700] = 1.0  # nothing at a quarter of the sampling rate
    model = model_of(-1.0 + 60.0j, -0.01 + 0.5j * np.pi / 0.01, 4.0 + 50.0j)
    record, rest = Record(force, force, 0.01), Record(0.0 * force, force, 0.01)
    noise = 0.05 * rng.standard_normal((2, 4000, 1))
    found = ringing(model, [record, rest], list(noise))
    state, part = 0j, np.zeros(4000)
    for k, push in enumerate(force):
        part[k], state = 2 * state.real, np.exp(model.modes[0].pole * 0.01) * state + push
    errors = np.concatenate([noise[0, 700:, 0], noise[1, :, 0]])
    without = errors + np.r_[part[700:], np.zeros(4000)]
    expected = errors.size / 4 * ((without**2).sum() / (errors**2).sum() - 1)
    assert found[0] == pytest.approx(expected, rel=0.1)  # or what the errors at other times make of it, if more
    assert found[1] < 5.0
    assert np.isnan(found[2])  # what grows is no mode
    of_all_rows = driven_gain(model, [record, rest], list(noise))
    assert of_all_rows[1] > 0.1  # it does follow the blow


def test_of_no_mode_there_is_nothing_to_say():
    record = Record(np.eye(1, 100).ravel(), np.ones(100), 0.01)
    assert ringing(model_of(), [record], [np.ones((100, 1))]).shape == (0,)
    assert sums_of_stronger(model_of(), np.empty(0)) == ()


def test_of_modes_that_are_multiples_of_each_other_none_is_called_a_product():
    """A rod of 1 % damping: its weak modes lie where products would, and so do those too strong for one."""
    first = 2.0 * np.pi * 3.0 * (-0.01 + 1j)
    power = np.array([1.0, 0.3, 0.02, 0.01])
    gain = power / (1e-3 + power)
    rod = model_of(*(k * first for k in (1, 2, 3, 4)))
    assert sums_of_stronger(rod, gain) == ("", "", "", "")
    other = model_of(first, 2.17 * first, 3.17 * first, 4.34 * first)  # only the weak ones lie there
    assert sums_of_stronger(other, gain)[:2] == ("", "")
    assert all(sums_of_stronger(other, gain)[2:])


@pytest.mark.parametrize("light", [True, False])
def test_only_the_inputs_that_acted_drive_a_lightly_damped_mode(light):
    """Hum beside the frequency of a pole that never ends: the answer to any input wanders, and fits it in part."""
    rng, k = np.random.default_rng(7), np.arange(3000)
    u = rng.standard_normal((3000, 1))
    pole = np.exp(-1e-7 + 0.9j)
    state, driven = 0j, np.zeros((3000, 1))
    for i in k:
        driven[i], state = 2 * state.real, pole * state + u[i, 0]
    hum = 30.0 * np.cos(0.9003 * k + 0.4)[:, np.newaxis]
    model = model_of(np.log(pole) / 0.01, -3.0 + 40.0j)
    left = rng.standard_normal((3000, 1)) + (0.0 if light else hum - driven)
    found = by_chance(model, [Record(u, left + driven, 0.01)], [left])
    assert found.tolist() == [not light, False]  # a mode that is damped is not asked


def answer(force, pole, dt):
    """One sample after the other: a mode of unit shape and participation, from rest."""
    state, out = 0j, np.empty(len(force))
    for k, value in enumerate(force):
        out[k] = 2.0 * state.real
        state = np.exp(pole * dt) * state + value
    return out


def test_beyond_the_band_of_the_inputs_a_mode_must_show_where_it_is():
    """A force up to 30 Hz of 50 and its sensor's noise, which the structure does not feel: -60 dB of its density."""
    rng, n, dt = np.random.default_rng(6), 16_384, 0.01
    lines = np.fft.rfftfreq(n, dt)
    felt = np.fft.irfft(np.where(lines < 30.0, np.fft.rfft(rng.standard_normal(n)), 0.0), n)
    measured = felt + 1e-3 * rng.standard_normal(n)
    inside, edge = (2j * np.pi * f - 0.01 * 2 * np.pi * f for f in (12.0, 31.5))
    y = answer(felt, inside, dt)
    noise = 0.01 * y.std() * rng.standard_normal(n)
    model = ModalModel(
        modes=tuple(
            Mode(
                pole=pole,
                kind="oscillatory",
                frequency=abs(pole) / 2 / np.pi,
                damping_ratio=0.01,
                shape=np.ones(1),
                participation=np.full(1, size),
            )
            for pole, size in ((inside, 1.0), (edge, 0.003))
        ),
        dt=dt,
        indicator_caution=0.1,
    )

    def asked(outputs, left):
        record = Record(measured, outputs, dt)
        return beyond_inputs(model, [record], [left[:, np.newaxis]], output_scale=outputs.std(keepdims=True))

    # the pole at the edge fits the flank of the answer, and nothing where it stands itself
    gain, values = asked(y + noise, noise - 0.003 * answer(felt, edge, dt))
    assert np.isnan(gain[0])
    assert abs(gain[1]) * values[1] < 20.0
    # a mode whose answer to a faint force stands above the noise is one
    weak = felt + 2e-3 * rng.standard_normal(n)
    measured = weak
    strong = y + 0.1 * answer(weak, edge, dt)
    model = replace(model, modes=(model.modes[0], replace(model.modes[1], participation=np.full(1, 0.1))))
    quiet = 0.01 * noise
    gain, values = asked(strong + quiet, quiet)
    assert gain[1] > 0.5


def test_what_rings_after_a_blow_under_wind_is_told_from_wind():
    """Errors that ring as the mode does: a filter that makes them white takes the answer to the blow away as well."""
    n, dt, pole = 600, 0.01, np.exp(2j * np.pi * 0.07 * (1j - 0.012))
    blow = np.zeros(n)
    blow[40:43] = [0.4, 1.0, 0.4]
    shape = np.array([1.0, -0.6])
    mode = Mode(
        pole=np.log(pole) / dt, kind="oscillatory", frequency=7.0, damping_ratio=0.012, shape=shape + 0j,
        participation=np.array([0.05 + 0j]),
    )  # fmt: skip
    model, rng = ModalModel(modes=(mode,), dt=dt, indicator_caution=0.1), np.random.default_rng(8)
    answer = 2.0 * scipy.signal.lfilter([0.0, 0.05], [1.0, -pole], blow + 0j).real[:, None] * shape

    def asked(size, *, rings):
        force = size * (rng.standard_normal(n + 800) + 1j * rng.standard_normal(n + 800))
        wind = scipy.signal.lfilter([1.0], [1.0, -pole], force)[800:].real[:, None] * shape
        errors = wind + 0.3 * size * rng.standard_normal(wind.shape)
        record = Record(blow, errors + (answer if rings else 0.0), dt)
        return float(ringing(model, [record], [errors if rings else errors - answer])[0])

    of_wind = np.array([asked(0.004, rings=False) for _ in range(200)])
    assert (of_wind > 5.0).sum() <= 2
    assert min(asked(0.001, rings=True) for _ in range(20)) > 5.0
