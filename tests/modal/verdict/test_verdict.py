from dataclasses import replace

import numpy as np
import pytest
import scipy

import modal
import okid
from modal.modes.mode import ModalModel, Mode
from modal.verdict.excitation import BetweenLines
from modal.verdict.judgement import Rerun, Reruns, judge
from okid.excitation import Excitation

DT = 0.01
HELD_OUT = "of the responses of the other half of the averages: no mode of it is certain"
SHAPES = np.array([[1.0, 0.6, 0.3], [-0.7, 1.0, 0.4], [0.5, -0.8, 1.0]])


def vibration(frequency=5.0, damping=0.02, shape=SHAPES[0], size=1.0, **changes):
    omega = 2 * np.pi * frequency
    mode = Mode(
        pole=complex(-damping * omega, omega * np.sqrt(1 - damping**2)),
        kind="oscillatory" if damping > 0 else "unstable",
        frequency=frequency,
        damping_ratio=damping,
        shape=np.asarray(shape) + 0j,
        participation=np.array([size, 0.4 * size]) + 0j,
    )
    return replace(mode, **changes)


def on_real_axis(discrete):
    pole = complex(np.log(complex(discrete)) / DT)
    kind = "real" if discrete > 0 else "nyquist"
    return vibration(pole=pole, kind=kind, frequency=abs(pole) / (2 * np.pi), damping_ratio=-pole.real / abs(pole))


def model_of(*modes):
    return ModalModel(modes=modes, dt=DT, indicator_caution=0.1)


def reruns_of(*runs):
    return Reruns(
        runs=tuple(Rerun(label=change, change=change, modes=modes) for change, modes in runs),
        n_steps=300,
        output_scale=np.ones(3),
        input_scale=np.ones(2),
    )


def found_with(data=1.0, observer=1.0, order=1.0, **changes):
    """Reruns in which the vibration has these overlaps (a smaller pulse response overlaps by its size)."""
    at = {"data": data, "observer": observer, "lower order": order, "higher order": order}
    at.update(changes)
    runs = [("data", model_of(vibration(size=at["data"]))), ("data", model_of(vibration(size=at["data"])))]
    runs += [(change, model_of(vibration(size=at[change]))) for change in ("observer", "lower order", "higher order")]
    return reruns_of(*runs)


def judged(mode, reruns, **options):
    return judge(model_of(mode), reruns, **options).modes[0]


# --- repeatability, limits, probability -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("r", "verdict"), [(1.0, "system"), (0.77, "system"), (0.76, "doubtful"), (0.52, "doubtful"), (0.51, "noise")]
)
def test_the_verdict_follows_repeatability(r, verdict):
    mode = judged(vibration(), found_with(data=r, observer=r, order=r))
    assert mode.repeatability == pytest.approx(r)
    assert mode.verdict == verdict
    assert mode.probability == pytest.approx(1 / (1 + np.exp(12.0 - 17.5 * r)))


@pytest.mark.parametrize(
    ("ratio", "parts", "words"),
    [
        (1.0, {"data": 0.9, "observer": 0.6}, "found again, but what the inputs make it do may be chance (F ratio 1)"),
        (4.9, {"data": 0.9, "observer": 0.6}, "found again, but what the inputs make it do may be chance (F ratio 5)"),
        (1.0, {"data": 0.9, "observer": 0.49}, "depends on the observer order and ridge"),
        (5.1, {"data": 0.9, "observer": 0.3}, "depends on the observer order and ridge"),
    ],
)
def test_what_may_be_chance_is_said_where_all_find_it_again(ratio, parts, words):
    gain = ratio / (ratio + 5000 / 10)  # ten numbers of a pair of three outputs and two inputs
    mode = judged(vibration(), found_with(**parts), gain=np.array([gain]), n_values=5000)
    assert mode.verdict == "doubtful"
    assert mode.reason.startswith(words)


@pytest.mark.parametrize(
    ("r", "ratio", "verdict"),
    [
        (0.9, 1e4, "system"),
        (0.9, 1.0, "doubtful"),
        (0.56, 1e5, "doubtful"),
        (0.59, 1e5, "system"),
        (0.4, 100.0, "noise"),
    ],
)
def test_what_the_inputs_hardly_drive_needs_more_repeatability(r, ratio, verdict):
    mode = vibration()
    numbers = 2 * (mode.shape.size + mode.participation.size)  # of a pair
    gain = ratio / (ratio + 5000 / numbers)
    mode = judged(mode, found_with(data=r, observer=r, order=r), gain=np.array([gain]), n_values=5000)
    assert mode.verdict == verdict
    assert mode.gain == gain
    assert mode.probability == pytest.approx(1 / (1 + np.exp(11.5 - 14.1 * r - 0.95 * np.log10(ratio))))


def test_a_pole_in_the_edge_of_the_decimation_filter_is_not_certain():
    sure = judged(vibration(), found_with(data=1.0, observer=1.0, order=1.0))
    edge = judged(vibration(), found_with(data=1.0, observer=1.0, order=1.0), edge=0.9 * sure.frequency)
    assert (sure.verdict, edge.verdict) == ("system", "doubtful")
    assert edge.probability == 0.55
    assert "filter" in edge.reason


def test_data_observer_and_order_have_equal_weight_whatever_their_number_of_runs():
    mode = judged(vibration(), found_with(data=0.9, observer=0.6, order=0.3))
    assert mode.repeatability == pytest.approx(0.6)


def test_a_kind_of_change_that_was_not_tried_does_not_count():
    runs = [("data", model_of(vibration(size=0.9))), ("observer", model_of(vibration(size=0.5)))]
    mode = judged(vibration(), reruns_of(*runs))
    assert mode.repeatability == pytest.approx(0.7)
    assert "other model orders" not in mode.reason


def test_without_reruns_nothing_is_judged():
    mode = judged(vibration(), reruns_of())
    assert mode.verdict == "doubtful"
    assert np.isnan(mode.repeatability)
    assert "not judged" in mode.reason


def test_an_empty_model_stays_empty():
    assert len(judge(model_of(), found_with())) == 0


# --- reasons ----------------------------------------------------------------------------------------------------------


def test_a_system_mode_shows_the_three_numbers():
    mode = judged(vibration(), found_with(data=0.98, observer=0.95, order=0.97))
    assert mode.reason == (
        "found again: halves of the data 0.98, other observer order and ridge 0.95, other model orders 0.97"
    )


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        (
            {"data": 0.2, "observer": 0.6, "order": 0.6},
            "the two halves of the data disagree about it (halves of the data 0.20,",
        ),
        ({"observer": 0.2, "data": 0.6}, "depends on the observer order and ridge"),
        ({"data": 0.4, "order": 0.1}, "appears only at high model order"),
        ({"data": 0.4, "lower order": 0.1, "higher order": 0.5}, "appears only at high model order"),
        ({"data": 0.4, "lower order": 0.5, "higher order": 0.1}, "is lost at higher model order"),
        ({"data": 0.09, "observer": 0.05, "order": 0.02}, "not found again"),
        ({"data": 0.11, "observer": 0.05, "order": 0.02}, "appears only at high model order"),
    ],
)
def test_the_smallest_part_is_named(parts, words):
    mode = judged(vibration(), found_with(**parts))
    assert mode.verdict != "system"
    assert mode.reason.startswith(words)


# --- kinds ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mode", "words"),
    [
        (vibration(damping=-0.01), "grows in time"),
        (on_real_axis(-0.9), "a negative real pole"),
        (vibration(60.0, 0.9), "a natural frequency above half of the sampling frequency (50 Hz)"),
    ],
)
def test_a_pole_that_cannot_be_a_mode_is_noise_however_well_it_repeats(mode, words):
    again = model_of(mode)
    result = judged(mode, reruns_of(("data", again), ("observer", again), ("lower order", again)))
    assert result.repeatability == pytest.approx(1)
    assert (result.verdict, result.probability) == ("noise", 0.0)
    assert result.reason.startswith(words)


@pytest.mark.parametrize(("size", "verdict"), [(1.0, "system"), (0.2, "noise")])
def test_a_real_pole_is_judged_and_named_as_a_real_pole(size, verdict):
    mode = on_real_axis(0.97)
    again = model_of(replace(mode, participation=size * mode.participation))
    result = judged(mode, reruns_of(("data", again), ("observer", again)))
    assert result.verdict == verdict
    assert result.reason.startswith("a real pole: overdamped or drift, not a vibration mode; ")


@pytest.mark.parametrize(("frequency", "remarked"), [(46.0, False), (48.0, True)])
def test_a_mode_next_to_nyquist_keeps_its_remark(frequency, remarked):
    again = model_of(vibration(frequency))
    result = judged(vibration(frequency), reruns_of(("data", again)))
    assert result.verdict == "system"
    assert ("Nyquist frequency" in result.reason) == remarked


# --- second poles -----------------------------------------------------------------------------------------------------


def pair(frequency, shape, size=0.5):
    model = model_of(vibration(16.6, 0.01), vibration(frequency, 0.05, shape=shape, size=size))
    return judge(model, reruns_of(("data", model), ("observer", model), ("lower order", model)))


def test_a_second_pole_of_a_mode_is_named_and_at_most_doubtful():
    first, second = pair(16.7, SHAPES[0])
    assert first.verdict == "system"
    assert second.verdict == "doubtful"
    assert second.reason.startswith("second pole of the mode at 16.6 Hz; found again")


@pytest.mark.parametrize(("frequency", "shape"), [(16.8, SHAPES[0]), (16.7, SHAPES[1])])
def test_a_close_mode_of_another_frequency_or_shape_is_a_mode_of_its_own(frequency, shape):
    assert [mode.verdict for mode in pair(frequency, shape)] == ["system", "system"]


def test_the_better_repeated_of_two_is_the_mode():
    weak = vibration(16.6, 0.01)
    model = model_of(weak, vibration(16.65, 0.011, size=3.0))
    again = model_of(replace(weak, participation=0.3 * weak.participation), model.modes[1])
    first, second = judge(model, reruns_of(("data", again), ("observer", again)))
    assert first.reason.startswith("second pole of the mode at 16.65 Hz")
    assert first.verdict == "noise"
    assert second.verdict == "system"


# --- a model that does not explain the data ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fit", "verdict", "words"),
    [
        (0.51, "system", "found again"),
        (np.nan, "system", "found again"),
        (0.499, "doubtful", f"the model repeats only 49 % {HELD_OUT}; found again"),
        (0.31, "doubtful", "the model repeats only 31 %"),
        (-2.0, "doubtful", "the model repeats nothing of the responses"),
    ],
)
def test_no_mode_of_a_table_that_is_hardly_repeated_is_certain(fit, verdict, words):
    mode = judged(vibration(), found_with(), fit=fit)
    assert mode.verdict == verdict
    assert mode.reason.startswith(words)


@pytest.mark.parametrize(("missed", "verdict"), [(np.nan, "system"), (0.49, "system"), (0.51, "doubtful")])
def test_a_model_that_leaves_most_of_what_the_inputs_explain_has_no_certain_mode(missed, verdict):
    mode = judged(vibration(), found_with(), missed=missed)
    assert mode.verdict == verdict
    assert (mode.probability >= 0.8) == (verdict == "system")


@pytest.mark.parametrize(
    ("duration", "verdict", "words"),
    [
        (1.7, "system", "found again"),  # 0.02 * 2 pi 5 Hz * 1.7 s = 1.07
        (1.5, "doubtful", "an undamped line, which decays by only 61 % over 1.5 s: periodic disturbance?; found again"),
        (np.nan, "system", "found again"),
    ],
)
def test_a_line_that_does_not_decay_within_the_record_is_not_certain(duration, verdict, words):
    mode = judged(vibration(5.0, 0.02), found_with(), duration=duration)
    assert mode.verdict == verdict
    assert mode.reason.startswith(words)


@pytest.mark.parametrize(("std", "verdict", "words"), [(0.002, "system", "found again"), (0.02, "doubtful", "perhaps")])
def test_a_decay_that_may_be_none_is_not_called_an_undamped_line(std, verdict, words):
    """0.02 * 2 pi 5 Hz * 30 s = 18.8: nothing is left of it, unless its damping may be e^3 times smaller."""
    mode = judged(replace(vibration(5.0, 0.02), damping_ratio_std=std), found_with(), duration=30.0)
    assert mode.verdict == verdict
    assert mode.reason.startswith(words)
    assert ("may be as little as 61 %" in mode.reason) is (words == "perhaps")


def found_driven(first, second, mode):
    again = model_of(mode, vibration(30.0))
    halves = [Rerun(label="half", change="data", modes=again, gain=np.array([gain, 0.9])) for gain in (first, second)]
    return replace(reruns_of(("observer", again)), runs=(*halves, Rerun(label="", change="observer", modes=again)))


@pytest.mark.parametrize(
    ("gains", "duration", "verdict", "words"),
    [
        ((0.01, -0.005), np.nan, "system", "found again"),
        ((0.01, np.nan), np.nan, "system", "found again"),
        ((0.01, -0.02), np.nan, "doubtful", "the input does not drive it (held-out gain negative); found"),
        ((-0.3, -0.2), 150.0, "doubtful", "the input does not drive it (held-out gain negative); found"),
        (
            (-0.3, -0.2),
            1.5,
            "doubtful",
            "an undamped line that the input does not drive (held-out gain negative): periodic disturbance?",
        ),
        ((0.09, 0.10), 1.5, "doubtful", "an undamped line, which decays by only 61 %"),
        ((0.11, 0.12), 1.5, "system", "found again"),
    ],
)
def test_a_mode_that_the_input_does_not_drive_is_not_certain(gains, duration, verdict, words):
    mode = vibration(5.0, 0.02)
    result = judged(mode, found_driven(*gains, mode), duration=duration)
    assert result.verdict == verdict
    assert result.reason.startswith(words)


@pytest.mark.parametrize(
    ("frequency", "gain", "rings_down", "verdict", "words"),
    [
        (5.0, 0.9, False, "system", "found again"),
        (5.0, 0.9, True, "doubtful", "an undamped line, which decays by only 61 % over 1.5 s: periodic disturbance?"),
        (1.2, 0.9, True, "doubtful", "so slow that a drifting sensor makes it as well: it turns 1.8 times"),
        (1.2, 0.05, False, "doubtful", "so slow that a drifting sensor makes it as well: it turns 1.8 times"),
    ],
)
def test_a_release_drives_no_line(frequency, gain, rings_down, verdict, words):
    """It acts in one row, and explains hum and drift as well as what rings: the gain tells nothing."""
    mode = vibration(frequency, 0.02)
    result = judged(mode, found_driven(gain, gain, mode), duration=1.5, rings_down=rings_down)
    assert result.verdict == verdict
    assert result.reason.startswith(words)
    assert result.reason.count("drifting") <= 1


def test_where_the_held_out_gain_is_not_known_the_modes_own_counts():
    mode = vibration(5.0, 0.02)
    runs = found_driven(np.nan, np.nan, mode)
    driven, hum = (judged(mode, runs, duration=1.5, gain=np.array([gain]), n_values=5000) for gain in (0.4, 0.02))
    assert (driven.verdict, hum.verdict) == ("system", "doubtful")


def test_an_undriven_real_pole_is_no_periodic_disturbance():
    mode = on_real_axis(0.97)
    result = judged(mode, found_driven(-0.1, -0.1, mode))
    assert result.verdict == "doubtful"
    assert "the input does not drive it (held-out gain negative); found again" in result.reason


def test_a_slow_real_pole_is_no_undamped_line():
    mode = on_real_axis(0.999)
    assert judged(mode, reruns_of(("data", model_of(mode))), duration=0.1).verdict == "system"


def test_a_poor_fit_does_not_make_noise_doubtful():
    assert judged(vibration(), found_with(data=0.1, observer=0.1, order=0.1), fit=0.2).verdict == "noise"


# --- damping ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "changes", "words"),
    [
        ({}, {}, None),
        ({"observer_order": 21}, {}, None),
        ({"ridge": 0.009}, {}, None),
        ({"ridge": 0.01}, {}, "a ridge of 0.01 without refinement biases it"),
        ({"ridge": 0.01, "refinement_steps": 3}, {}, None),
        ({}, {"damping_ratio_std": 0.0019}, None),
        ({}, {"damping_ratio_std": 0.0024}, "its standard deviation is 12 % of it"),
        ({}, {"damping_ratio_std": 9.0}, "its standard deviation is over 1000 % of it"),
    ],
)
def test_damping_is_resolved_or_it_is_said_why_not(options, changes, words):
    mode = judged(vibration(5.0, 0.02, **changes), found_with(), **options)
    assert mode.verdict == "system"
    assert mode.damping_resolved == (words is None)
    assert ("damping not resolved" in mode.reason) == (words is not None)
    if words:
        assert mode.reason.endswith(f"; damping not resolved: {words}")


@pytest.mark.parametrize(
    ("observer_order", "other", "resolved"), [(19, 0.0219, True), (19, 0.0221, False), (21, 0.0221, True)]
)
def test_a_short_observer_resolves_damping_only_where_every_rerun_agrees(observer_order, other, resolved):
    halves = [("data", model_of(vibration())), ("data", model_of(vibration(damping=other)))]
    again = reruns_of(*halves, ("observer", model_of(vibration())))
    mode = judged(vibration(), again, observer_order=observer_order)
    assert mode.damping_resolved == resolved
    assert mode.reason.endswith("the observer spans only 0.95 of its period") == (not resolved)


@pytest.mark.parametrize("change", ["data", "observer", "order"])
@pytest.mark.parametrize(("least", "verdict"), [(0.43, "system"), (0.41, "doubtful")])
def test_one_kind_of_change_that_loses_the_mode_is_enough_for_doubt(change, least, verdict):
    mode = judged(vibration(), found_with(**{change: least}))
    assert mode.repeatability > 0.71
    assert mode.verdict == verdict


@pytest.mark.parametrize(("persistency", "needed", "verdict"), [(2, 8, "system"), (1, 8, "doubtful"), (1, 1, "system")])
def test_a_model_larger_than_the_excitation_is_at_most_doubtful(persistency, needed, verdict):
    excitation = Excitation(
        needed_order=needed,
        persistency_order=persistency,
        condition=1.0,
        excited_share=np.ones(1),
        excited_bands=(((0.0, 50.0),),),
        messages=(),
    )
    mode = judged(vibration(), found_with(), excitation=excitation)
    assert mode.verdict == verdict
    assert ("excite order 1 only, too few for a model of 2 states" in mode.reason) == (verdict == "doubtful")


@pytest.mark.parametrize(
    ("bands", "verdict"),
    [
        ((((0.0, 4.0),), ((4.5, 50.0),)), "system"),  # the second input moves at 5 Hz
        ((((0.0, 4.0),), ((6.0, 50.0),)), "doubtful"),
        (((), ()), "system"),  # nothing is known of where the inputs move
    ],
)
def test_a_mode_where_no_input_moves_is_not_certain(bands, verdict):
    excitation = Excitation(
        needed_order=10, persistency_order=10, condition=1.0, excited_share=np.ones(2), excited_bands=bands, messages=()
    )
    mode = judged(vibration(5.0), found_with(), excitation=excitation)
    assert mode.verdict == verdict
    assert ("no input moves at 5 Hz" in mode.reason) == (verdict == "doubtful")
    assert (mode.probability <= 0.55) == (verdict == "doubtful")


def twice(values):
    """For the mode and the one beside it."""
    return np.concatenate([values, values])


BROAD = vibration(5.0, 0.6)
SLOW = on_real_axis(0.9999)
"""Which takes a tenth of a turn in a hundred seconds."""


@pytest.mark.parametrize(
    ("mode", "told", "untold", "words"),
    [
        (BROAD, {"is_table": True}, {}, "damping 60 %: does not come back once"),
        (BROAD, {"ringing": np.array([99.0])}, {}, "damping 60 %: does not come back once"),
        (SLOW, {"rings_down": True}, {}, "so slow that a drifting sensor makes it as well"),
        (
            vibration(),
            {"beyond": (np.array([0.0]), np.array([300]))},
            {"beyond": (np.array([0.6]), np.array([300]))},
            "the inputs hardly move at 5 Hz, and nothing there follows them",
        ),
        (
            vibration(),
            {"clipped": np.full((1, 3), 0.6)},
            {"clipped": np.full((1, 3), 0.01)},
            "clipping or rounding alone makes 60 % of what moves at 5 Hz",
        ),
        (vibration(), {"clipped": np.full((1, 3), np.nan)}, {}, "is not steady, so nothing tells what their limits"),
        (vibration(), {"height": np.array([1.5])}, {"height": np.array([6.0])}, "no peak stands at 5 Hz"),
    ],
)
def test_what_repeats_perfectly_is_doubtful_for_each_reason(mode, told, untold, words):
    again = model_of(mode, vibration(20.0))
    runs = reruns_of(*((change, again) for change in ("data", "observer", "lower order", "higher order")))
    for options, verdict in ((told, "doubtful"), (untold, "system")):
        both = {
            name: value
            if value is True
            else twice(value)
            if isinstance(value, np.ndarray)
            else tuple(map(twice, value))
            for name, value in options.items()
        }
        result = judge(again, runs, duration=100.0, **both).modes[0]
        assert result.verdict == verdict
        assert (words in result.reason) == (verdict == "doubtful")


@pytest.mark.parametrize(
    ("std", "damping", "verdict"), [(1.0, 0.02, "doubtful"), (0.4, 0.02, "system"), (1.0, 0.3, "system")]
)
def test_a_mode_whose_interval_holds_the_next_one_is_doubtful(std, damping, verdict):
    """Half of it is 1.96 std: 1.96 Hz reaches from 6.5 to 5 Hz, 0.8 Hz does not; a resonance of 3.9 Hz is wider."""
    vague, known = replace(vibration(6.5, damping=damping), frequency_std=std), vibration(5.0)
    again = model_of(known, vague)
    runs = reruns_of(*((change, again) for change in ("data", "observer", "lower order", "higher order")))
    first, second = judge(again, runs).modes
    assert (first.verdict, second.verdict) == ("system", verdict)
    assert ("reaches the mode at 5 Hz" in second.reason) == (verdict == "doubtful")


@pytest.mark.parametrize(("gain", "verdict"), [(0.0, "doubtful"), (np.nan, "doubtful"), (0.6, "system")])
def test_a_mode_that_only_the_lines_of_the_inputs_show_is_not_certain(gain, verdict):
    """It repeats perfectly, as every fit to the same tones does."""
    lines = BetweenLines(lines=np.array([4.0]), gain=np.array([gain]), n_values=np.array([300]))
    mode = judged(vibration(5.0), found_with(), lines=lines)
    assert mode.verdict == verdict
    assert ("the inputs are one line (4 Hz), and beside" in mode.reason) == (verdict == "doubtful")


@pytest.mark.parametrize(("ringing", "verdict"), [(-1.0, "doubtful"), (4.0, "doubtful"), (6.0, "system")])
def test_a_mode_that_is_over_with_the_blow_is_not_certain(ringing, verdict):
    mode = judged(vibration(5.0), found_with(), ringing=np.array([ringing]))
    assert mode.verdict == verdict
    assert ("over with the blow" in mode.reason) == (verdict == "doubtful")


@pytest.mark.parametrize(("other", "resolved"), [(0.0295, True), (0.0305, False)])
def test_halves_that_differ_by_half_of_the_damping_do_not_resolve_it(other, resolved):
    halves = [("data", model_of(vibration())), ("data", model_of(vibration(damping=other)))]
    mode = judged(vibration(), reruns_of(*halves, ("observer", model_of(vibration()))))
    assert mode.damping_resolved == resolved
    assert ("the halves of the data give" in mode.reason) == (not resolved)


@pytest.mark.parametrize(("other", "resolved"), [(0.0255, True), (0.0265, False), (0.0145, True), (0.0135, False)])
def test_damping_that_depends_on_the_observer_is_not_resolved(other, resolved):
    halves = [("data", model_of(vibration())), ("data", model_of(vibration()))]
    mode = judged(vibration(), reruns_of(*halves, ("observer", model_of(vibration(damping=other)))))
    assert mode.verdict == "system"
    assert mode.damping_resolved == resolved
    words = f"another observer order and ridge give {100 * other:.2g} % instead of 2 %"
    assert mode.reason.endswith(words) == (not resolved)


def test_a_real_pole_has_no_damping_to_resolve():
    mode = on_real_axis(0.999)
    assert judged(mode, reruns_of(("data", model_of(mode))), observer_order=2).damping_resolved


def test_indicators_and_everything_else_are_kept():
    mode = judged(vibration(emac=0.7, cmi=0.6), found_with())
    assert (mode.emac, mode.cmi, mode.frequency) == (0.7, 0.6, 5.0)


def test_a_pole_that_dies_within_two_samples_is_not_certain():
    # |lambda| = exp(-damping omega dt): 0.18, as a delay of four samples in 2 % noise gives again and again.
    fast = vibration(frequency=36.6, damping=0.734)
    runs = reruns_of(("data", model_of(fast)), ("observer", model_of(fast)), ("lower order", model_of(fast)))
    mode = judged(fast, runs)
    assert mode.verdict == "doubtful"
    assert mode.reason.startswith("dies within two samples (18 % are left after one): may be a delay")
    slower = vibration(frequency=20.0, damping=0.7)
    assert judged(slower, reruns_of(("data", model_of(slower)))).verdict == "system"


def test_a_pole_where_nothing_follows_the_inputs_is_no_mode_of_the_system():
    """In the edge of an anti-alias filter a struck plate had a mode that came back in every half."""
    assert judged(vibration(), found_with(), chance=np.array([1e-9])).verdict == "system"
    mode = judged(vibration(), found_with(), chance=np.array([0.4]))
    assert mode.verdict == "doubtful"
    assert "nothing follows the inputs at 5 Hz beyond chance" in mode.reason
    assert judged(vibration(), found_with(data=0.3), chance=np.array([1e-9])).verdict == "doubtful"
    assert judged(vibration(), found_with(data=0.3), chance=np.array([0.4])).verdict == "noise"


@pytest.mark.parametrize("follows", [True, False])
def test_three_hundred_samples_show_whether_a_mode_follows_the_force(follows):
    """Segments so short miss the answer in every second record; held-out rows do not."""
    pole = np.exp((-0.02 + 1j) * 2 * np.pi * 5.0 * 0.01)
    for seed in (1, 3, 6, 7):
        rng = np.random.default_rng(seed)
        force = rng.standard_normal(300)
        drives = force if follows else rng.standard_normal(800)
        tip = scipy.signal.lfilter([0, 1.0], [1, -2 * pole.real, abs(pole) ** 2], drives)[-300:]
        tip += 0.02 * tip.std() * rng.standard_normal(300)
        found = modal.identify(okid.Record(force, tip, 0.01), observer_order=10, order=2).modes.system
        assert len(found) == int(follows)
