"""Every sentence from its rule, with data on both sides of it."""

from functools import cache

import numpy as np
import pytest
import scipy
from nonlinear_chain import no_force, run_chain

from modal.localisation.evidence import coherent_share, locate, narrowest_interval, single_line
from modal.localisation.gap import measure_gap
from modal.localisation.levels import level_modes
from modal.localisation.lines import measure_lines
from okid.record import Record

DT, N = 0.03, 2048
LEVELS = (0.3, 1.0, 3.0)
TIME = np.arange(N) * DT


def coloured(rng, n_columns=1):
    return scipy.signal.lfilter([1.0], [1.0, -0.9], rng.standard_normal((N, n_columns)), axis=0) * np.sqrt(1 - 0.81)


def made(error, *, levels=LEVELS, n_outputs=1, floor=1e-8, **names):
    """Simulated motion as large as the level; `error(level, motion, rng)` is the gap."""
    rng = np.random.default_rng(8)
    measured, simulated = [], []
    for level in levels:
        force = level * rng.standard_normal(N)
        run = level * coloured(rng, n_outputs)
        noise = np.sqrt(floor) * rng.standard_normal(run.shape)
        measured.append(Record(force, run + error(level, run, rng) + noise, DT, **names))
        simulated.append(Record(force, run, DT, **names))
    return measure_gap(measured, simulated, floor)


def text_of(gap, subject, **more):
    return " ".join(s.text for s in locate(gap, **more).statements if s.subject == subject)


# --- size ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("factor", "agrees"), [(1.0, True), (1.1, True), (1.6, False)])
def test_agreement_is_a_matter_of_the_floor(factor, agrees):
    gap = made(lambda level, run, rng: np.sqrt(factor - 1) * 0.1 * rng.standard_normal(run.shape), floor=0.01)
    location = locate(gap)
    assert location.agrees == agrees
    assert ("agree within the noise" in location.sentences[0]) == agrees
    assert (len(location.sentences) == 1) == agrees


def test_where_they_agree_nothing_else_is_said():
    gap = made(lambda level, run, rng: 0.0)
    location = locate(gap, modes=level_modes(gap.measured), lines=measure_lines(gap.measured))
    assert [statement.subject for statement in location.statements] == ["size"]
    assert location.output_shares.tolist() == [0.0]


def test_the_size_is_that_of_the_largest_and_counts_what_is_within_the_noise():
    def error(level, run, rng):
        return np.where([True, False], 0.2 * run, 0.0) * (level == 3.0)

    text = text_of(made(error, n_outputs=2, floor=1e-4), "size")
    assert "in 5 of 6 outputs and records it is within the noise" in text
    assert "largest in output_0 of record 3" in text
    assert "is 17 % of the size" in text  # 0.2 / 1.2


# --- output ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("other", "named"), [(0.02, True), (0.18, False)])
def test_an_output_is_named_when_it_holds_most(other, named):
    gap = made(lambda level, run, rng: np.array([other, 0.2]) * coloured(rng, 2) * level, n_outputs=2)
    location = locate(gap)
    assert location.output == 1
    assert ("spread over the outputs" in " ".join(location.sentences)) != named
    assert ("is in output_1" in text_of(gap, "band")) == named
    assert location.output_shares.sum() == pytest.approx(1.0)


def test_the_unit_of_an_output_does_not_draw_the_gap():
    gap = made(lambda level, run, rng: np.array([0.02, 0.2]) * coloured(rng, 2) * level, n_outputs=2)
    scaled = [
        [Record(r.inputs, r.outputs * [1e6, 1.0], DT) for r in records] for records in (gap.measured, gap.simulated)
    ]
    assert locate(measure_gap(*scaled, gap.floor * [1e12, 1.0])).output == 1


# --- band ------------------------------------------------------------------------------------------------------------


def band_noise(rng, low, high):
    spectrum = np.fft.rfft(rng.standard_normal((N, 1)), axis=0)
    f = np.fft.rfftfreq(N, DT)
    spectrum[(f < low) | (f > high)] = 0.0
    values = np.fft.irfft(spectrum, N, axis=0)
    return values / values.std()


@pytest.mark.parametrize(("low", "high", "narrow"), [(9.0, 12.0, True), (5.0, 5.3, True), (0.4, 14.0, False)])
def test_a_band_is_named_where_it_is_narrow(low, high, narrow):
    gap = made(lambda level, run, rng: 0.1 * level * band_noise(rng, low, high))
    text = text_of(gap, "band")
    assert ("between" in text) == narrow
    assert ("spread from" in text) != narrow
    found = narrowest_interval(gap, [0])
    assert low - 0.05 < found.low < found.high < high + 0.05
    assert 0.79 < found.share < 0.95
    edges, own = gap.cells.edges, gap.variance[:, 0]
    inside = (edges[:-1] >= found.low - 1e-9) & (edges[1:] <= found.high + 1e-9)
    power = gap.cells.simulated[..., 0].T / own
    expected = power[inside].sum() / power.sum()
    assert found.simulated_share == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(("offset", "constant"), [(0.3, True), (0.02, False)])
def test_a_constant_gap_is_said_to_be_one(offset, constant):
    gap = made(lambda level, run, rng: offset + 0.1 * rng.standard_normal(run.shape), output_units=["mm"])
    assert ("is constant, measured minus simulated" in text_of(gap, "constant")) == constant
    assert (text_of(gap, "band") == "") == constant
    if constant:
        assert "0.297 to 0.302 mm" in text_of(gap, "constant")


@pytest.mark.parametrize(
    ("error", "one"),
    [
        (lambda level, run, rng: 0.2 * np.sin(2 * np.pi * 2.345 * TIME)[:, np.newaxis], True),
        (lambda level, run, rng: 0.2 * band_noise(rng, 2.0, 2.7), False),
    ],
)
def test_one_line_is_told_from_a_narrow_band(error, one):
    gap = made(error)
    line = single_line(gap, 0)
    assert (line is not None) == one
    assert ("is one line at" in text_of(gap, "line")) == one
    if line is not None:
        assert line.frequency == pytest.approx(2.345, abs=0.3 / (N * DT))
        np.testing.assert_allclose(line.amplitudes, 0.2, rtol=0.05)


def test_a_line_of_the_motion_itself_is_no_disturbance():
    sine = np.sin(2 * np.pi * 2.0 * TIME)[:, np.newaxis]
    rng = np.random.default_rng(1)
    simulated = [Record(a * sine, a * sine, DT) for a in LEVELS]
    measured = [Record(a * sine, a * sine + 0.1 * sine + 1e-4 * rng.standard_normal(sine.shape), DT) for a in LEVELS]
    assert single_line(measure_gap(measured, simulated, 1e-8), 0) is None


# --- level -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (lambda level, run, rng: 0.05 * level**2 * coloured(rng), "rises with level"),
        (lambda level, run, rng: 0.1 * level * coloured(rng), "stays with level"),
        (lambda level, run, rng: 0.1 * level**0.5 * coloured(rng), "falls with level"),
        (lambda level, run, rng: 0.1 * coloured(rng), "a disturbance, not a property of the structure"),
        (lambda level, run, rng: 0.1 * np.sin(9.0 * TIME)[:, np.newaxis], "a periodic disturbance"),
        (lambda level, run, rng: 0.1 + 0 * run, "an offset of a sensor or a constant force"),
        (lambda level, run, rng: 0.1 * run / level, "of it does), as of friction or of the play in a joint"),
        (lambda level, run, rng: 0.1 * level * coloured(rng) * (level == 3.0), "level 3 of 3 only: a contact, a limit"),
        (lambda level, run, rng: 0.1 * level * coloured(rng) * (level == 0.3), "level 1 of 3 only: a force that grows"),
    ],
)
def test_the_level_in_words(error, words):
    assert words in text_of(made(error), "level")


@pytest.mark.parametrize(("levels", "said"), [((1.0, 1.0), False), ((1.0, 3.0), True)])
def test_nothing_is_said_of_levels_where_there_is_one(levels, said):
    assert bool(text_of(made(lambda level, run, rng: 0.1 * coloured(rng), levels=levels), "level")) == said


@pytest.mark.parametrize(("means", "one"), [((0.1, 0.1, 0.1), True), ((0.1, -0.1, 0.12), False)])
def test_an_offset_that_differs_from_record_to_record_is_no_offset(means, one):
    by_level = dict(zip(LEVELS, means, strict=True))
    gap = made(lambda level, run, rng: by_level[level] + 0 * run, output_units=["mm"])
    assert ("is constant, measured" in text_of(gap, "constant")) == one
    assert ("not the same in all, measured" in text_of(gap, "constant")) != one
    assert ("an offset of a sensor" in text_of(gap, "level")) == one
    assert ("another rest point in each record" in text_of(gap, "level")) != one


def test_two_ends_that_read_the_same_are_said_once():
    same = text_of(made(lambda level, run, rng: 0.1 + 0 * run, output_units=["mm"]), "constant")
    assert "measured minus simulated 0.100 mm." in same


def test_what_no_line_tells_is_not_said():
    gap = made(lambda level, run, rng: 0.1 * coloured(rng))
    silent = measure_lines(gap.measured)
    assert not silent.measured
    assert text_of(gap, "lines", lines=silent) == ""
    period = np.random.default_rng(3).standard_normal(256)
    spectrum = np.fft.rfft(period) * (np.arange(129) % 2)
    force = np.tile(np.fft.irfft(spectrum, 256), 8)
    noise = 1e-3 * np.random.default_rng(4).standard_normal(2048)
    seen = measure_lines(Record(force, force + 0.1 * force**2 + noise, DT))
    assert text_of(gap, "lines", lines=seen).startswith("Even lines")


def test_between_following_and_not_following_both_are_named():
    def error(level, run, rng):
        return 0.1 * (0.58 * run / level + coloured(rng))

    gap = made(error)
    assert 0.2 < coherent_share(gap)[0] < 0.3
    assert "friction, play or a disturbance" in text_of(gap, "level")


@pytest.mark.parametrize(
    ("error", "low", "high"),
    [
        (lambda level, run, rng: coloured(rng), -0.1, 0.1),
        (lambda level, run, rng: 0.3 * run, 0.97, 1.01),
        (lambda level, run, rng: 0.3 * np.roll(run, 3, axis=0), 0.9, 1.01),
        (lambda level, run, rng: run / level + coloured(rng), 0.35, 0.65),
    ],
)
def test_the_coherent_share(error, low, high):
    assert low < coherent_share(made(error))[0] < high


def test_a_record_too_short_has_no_coherence():
    run = np.sin(np.arange(100.0))
    assert np.isnan(coherent_share(measure_gap(Record(run, 2 * run, DT), Record(run, run, DT), 0.0))[0])


# --- time ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        (TIME / TIME[-1] + 0.01, "grows in time"),
        (np.exp(-TIME / 10.0) + 0.01, "falls in time"),
        (np.abs(TIME / TIME[-1] - 0.5) + 0.02, "smallest in the middle"),
        (np.ones(N), ""),
    ],
)
def test_the_time_in_words(shape, words):
    text = text_of(made(lambda level, run, rng: 0.1 * level * shape[:, np.newaxis] * coloured(rng)), "time")
    assert (words in text) if words else text == ""


# --- structures: from the equation of motion to the sentence --------------------------------------------------------


def cubic(d, v, t):
    return 100.0 * d**3


def coulomb(d, v, t):
    return 0.3 * np.sign(v)


def drag(d, v, t):
    return 0.3 * v * np.abs(v)


def stiffer(d, v, t):
    return 8.0 * d


PLANTS = (no_force, cubic, coulomb, drag, stiffer)


@cache
def structures():
    rng = np.random.default_rng(21)
    force = np.array([10.0 * level * rng.standard_normal(N) for level in LEVELS])

    def together(d, v, t):
        return np.concatenate([law(d[3 * i : 3 * i + 3], v[3 * i : 3 * i + 3], t) for i, law in enumerate(PLANTS)])

    runs = run_chain([1.0], [400.0], [0.8], np.tile(force, (len(PLANTS), 1)), DT, law=together, n_steps=3)
    return force, {law: runs[3 * i : 3 * i + 3] for i, law in enumerate(PLANTS)}


def location_of(law):
    force, runs = structures()
    rng = np.random.default_rng(2)
    sigma = 0.01 * runs[law].std(axis=1)
    seen = runs[law] + sigma[:, np.newaxis] * rng.standard_normal(runs[law].shape)
    measured, simulated = ([Record(u, y, DT) for u, y in zip(force, ys, strict=True)] for ys in (seen, runs[no_force]))
    gap = measure_gap(measured, simulated, sigma**2)
    return locate(gap, modes=level_modes(measured), lines=measure_lines(measured))


@pytest.mark.parametrize(
    ("law", "said", "unsaid"),
    [
        (cubic, ["rises with level", "Frequency of mode 1", "a spring that hardens:"], ["friction", "drag-like"]),
        (coulomb, ["as of friction", "Damping of mode 1 (3.18 Hz) falls"], ["drag", "hardens", "disturbance"]),
        (drag, ["rises with level", "Damping of mode 1", "drag-like"], ["friction", "a spring that hardens:"]),
        (stiffer, ["stays with level", "No mode moves with level"], ["friction", "drag", "hardens"]),
    ],
)
def test_structures_in_words(law, said, unsaid):
    location = location_of(law)
    whole = " ".join(location.sentences)
    for words in said:
        assert words.rstrip(":") in whole
    for words in unsaid:
        assert words.rstrip(":") not in whole or words == "a spring that hardens:"
    assert "in time" not in whole


def test_the_true_model_agrees():
    assert location_of(no_force).agrees
