"""Two results compared: matching, tests of shifts, words, and what a result reads back as."""

import itertools
import json
import math
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2
from systems import random_system, simulate

from modal.comparison import words
from modal.comparison.changes import compare_results
from modal.comparison.shifts import MOST_MODES, TOO_FAR, holm, match_modes, pair_costs, read_result, summary_of
from modal.identification.pipeline import identify
from modal.report.writing import keep_result
from okid.errors import InvalidDataError, UnreadableFileError
from okid.record import Record

STD = 0.001
"""Relative standard deviation of frequencies; that of damping ratios is ten times as large."""


@pytest.fixture
def result(identification):
    """The hand-made modes with standard deviations."""
    modes = tuple(
        replace(
            mode,
            frequency_std=STD * mode.frequency,
            damping_ratio_std=10 * STD * abs(mode.damping_ratio),
            shape_std=np.full(3, 0.01),
            damping_resolved=True,
            doubts=() if mode.verdict == "system" else (("data", "a record hardly explained"),),
        )
        for mode in identification.modes
    )
    return replace(identification, modes=replace(identification.modes, modes=modes))


def moved(mode, frequency=1.0, damping=1.0, **changes):
    """The mode with its frequency and damping ratio multiplied."""
    f, z = mode.frequency * frequency, mode.damping_ratio * damping
    omega = 2 * np.pi * f
    return replace(
        mode, frequency=f, damping_ratio=z, pole=complex(-z * omega, omega * math.sqrt(max(1 - z * z, 0))), **changes
    )


def with_modes(result, modes):
    return replace(result, modes=replace(result.modes, modes=tuple(modes)))


def other(result, index, *args, **changes):
    modes = list(result.modes.modes)
    modes[index] = moved(modes[index], *args, **changes)
    return with_modes(result, modes)


# --- matching --------------------------------------------------------------------------------------------------------


def test_a_result_compared_with_itself_has_every_mode_in_its_place(result):
    found = compare_results(result, result)
    assert [(pair.number_before, pair.number_after) for pair in found.pairs] == [(1, 1), (2, 2), (3, 3), (4, 4)]
    assert (found.lost, found.new, found.changed, found.same_data) == ((), (), False, True)
    assert all(shift.change == pytest.approx(0, abs=1e-12) for pair in found.pairs for shift in pair.shifts)
    assert {shift.verdict for pair in found.pairs for shift in pair.shifts} == {"within its interval"}
    assert found.differences == ()


def test_modes_of_close_frequency_are_matched_by_shape(result):
    """Two modes cross: the order by frequency turns round, the shapes stay."""
    first = list(result.modes.modes)
    first[1] = moved(first[1], 3.7 / first[1].frequency)
    second = list(first)
    second[0], second[1] = moved(first[0], 3.72 / first[0].frequency), moved(first[1], 3.66 / first[1].frequency)
    second[:2] = second[1], second[0]
    found = compare_results(with_modes(result, first), with_modes(result, second))
    assert [(pair.number_before, pair.number_after) for pair in found.pairs[:2]] == [(1, 2), (2, 1)]
    assert all(pair.assurance > 0.99 for pair in found.pairs)


def test_the_assignment_is_the_best_of_all(result):
    """Against every assignment tried one by one."""
    rng = np.random.default_rng(5)
    for _ in range(20):
        sides = []
        for _ in range(2):
            base = result.modes.modes[:4]
            modes = [
                moved(mode, float(rng.uniform(0.7, 1.4)), shape=rng.standard_normal(3) + 0j) for mode in base[:3]
            ] + [base[3]]
            sides.append(summary_of(with_modes(result, sorted(modes, key=lambda mode: mode.frequency))))
        found = match_modes(*sides)
        costs = np.minimum(pair_costs(sides[0].modes, sides[1].modes, found.assurance), TOO_FAR)
        best = min(sum(costs[i, j] for i, j in enumerate(order)) for order in itertools.permutations(range(4)))
        mine = sum(costs[pair] for pair in found.pairs) + TOO_FAR * len(found.lost)
        assert mine == pytest.approx(best)


def test_a_mode_that_moved_too_far_or_has_another_shape_is_lost_and_new(result):
    for changed in (
        other(result, 0, 1.4),
        other(result, 0, 1.0, shape=np.array([1, -0.5, 0.06 + 0.6j])),
        other(result, 0, 1.0, kind="real"),
    ):
        found = compare_results(result, changed)
        assert [one.number for one in found.lost] == [1]
        assert len(found.new) == 1
        assert found.changed
    assert compare_results(result, other(result, 0, 1.25)).lost == ()


def test_a_doubtful_second_pole_does_not_take_the_place_of_the_mode(result):
    modes = list(result.modes.modes)
    twin = moved(modes[0], 0.9999, verdict="doubtful")
    shifted = with_modes(result, [twin, moved(modes[0], 1.003), *modes[1:]])
    found = compare_results(result, shifted)
    assert found.pairs[0].after.verdict == "system"
    assert [one.mode.verdict for one in found.new] == ["doubtful"]
    assert not [one for one in found.lost if one.mode.verdict == "system"]


def test_a_lost_mode_tells_what_is_left_of_it(result):
    noise = compare_results(result, other(result, 0, 1.01, verdict="noise"))
    sentence = words.unmatched_sentence(noise.lost[0], present="a", absent="b")
    assert "a pole judged as noise at 3.707 Hz is all that is near" in sentence
    gone = compare_results(result, with_modes(result, result.modes.modes[1:]))
    assert "no pole there is near" in words.unmatched_sentence(gone.lost[0], present="a", absent="b")
    far = compare_results(result, other(result, 0, 1.06, verdict="noise"))
    assert far.lost[0].near is None


def test_a_verdict_that_changed_is_said(result):
    found = compare_results(result, other(result, 0, 1.0, verdict="doubtful"))
    assert words.verdict_change(found.pairs[0]) == "its verdict was system and is doubtful"
    assert words.verdict_change(found.pairs[1]) == ""


def test_channels_in_another_order_or_number_are_the_same_channels(result):
    (record,) = result.records
    order = [2, 0, 1]
    turned = replace(record, outputs=record.outputs[:, order], output_names=[record.output_names[i] for i in order])
    modes = [replace(mode, shape=mode.shape[order]) for mode in result.modes.modes]
    found = compare_results(result, replace(with_modes(result, modes), records=(turned,)))
    assert [pair.assurance for pair in found.pairs] == pytest.approx([1.0] * 4)
    assert found.differences == ()


def test_one_common_channel_tells_no_shape(result):
    (record,) = result.records
    single = replace(record, outputs=record.outputs[:, :1], output_names=["floor_1"], output_units=["m/s^2"])
    modes = [replace(mode, shape=mode.shape[:1], shape_std=None) for mode in result.modes.modes]
    fits = replace(result.fit, cross_validated=result.fit.cross_validated[:1])
    found = compare_results(result, replace(with_modes(result, modes), records=(single,), fit=fits))
    assert len(found.pairs) == 4
    assert {pair.shape.verdict for pair in found.pairs} == {"not known"}
    assert {(one.kind, one.what) for one in found.differences} >= {("channel", "output floor_2")}


def test_results_without_modes_can_be_compared(result):
    none = with_modes(result, ())
    assert words.comparison_headline(compare_results(none, none)).startswith("Neither result has a mode")
    assert len(compare_results(none, result).new) == 4
    assert words.comparison_headline(compare_results(result, none)) == "No mode is in both results: 3 lost."


# --- shifts ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("deviations", "verdict"),
    [(1.0, "within its interval"), (1.9, "within its interval"), (2.05, "perhaps chance"), (4.0, "beyond chance")],
)
def test_a_frequency_is_weighed_by_its_joint_deviation(result, deviations, verdict):
    """Of 13 tests, Holm's first needs p < 0.05 / 13: 2.89 standard deviations."""
    found = compare_results(result, other(result, 1, 1 + deviations * math.sqrt(2) * STD))
    shift = found.pairs[1].frequency
    assert shift.verdict == verdict
    assert shift.half_width == pytest.approx(1.96 * math.sqrt(2) * STD, rel=1e-3)
    assert found.changed == (verdict == "beyond chance")
    assert verdict.split()[0] in words.shift_sentence(shift) or verdict == "perhaps chance"


@pytest.mark.parametrize(
    ("doubts", "tested"),
    [
        ((("data", "hardly explained"),), True),
        ((), False),  # it does not come back at other orders
        ((("data", "hardly explained"), ("pole", "may be the colour of the forces")), False),
    ],
)
def test_a_pole_that_may_itself_be_no_mode_is_shown_and_not_tested(result, doubts, tested):
    """One pole where another record shows two modes lies far from either, whatever its deviation."""
    doubtful = other(result, 1, 1 + 9 * STD, verdict="doubtful", doubts=doubts)
    for found in (compare_results(result, doubtful), compare_results(doubtful, result)):
        pair = found.pairs[1]
        assert abs(pair.frequency.change) == pytest.approx(9 * STD, rel=0.01)
        assert pair.frequency.half_width == pytest.approx(1.96 * math.sqrt(2) * STD, rel=0.02)
        assert {shift.verdict != "not known" for shift in pair.shifts} == {tested}
        assert found.n_tests == (13 if tested else 10)
        assert found.changed == tested
        assert ("; of 1 it cannot be told" in words.comparison_headline(found)) != tested
        assert tested or "may be no mode" in words.shift_sentence(pair.frequency)
    alone = with_modes(doubtful, doubtful.modes.modes[1:2])
    found = compare_results(alone, alone)
    assert ("because each may be no mode in one of them" in words.comparison_headline(found)) != tested
    assert ("because each may be no mode in one of them" in words.how_sentence(found)) != tested


@pytest.mark.parametrize(("deviations", "beyond"), [(1.2, False), (2.2, True)])
def test_all_frequencies_that_moved_a_little_are_beyond_chance_together(result, deviations, beyond):
    """No one of 12 tests is remarkable, but chi^2 of four shifts of 2.2 deviations is 19.4, and by chance 0.07 %."""
    softer = with_modes(result, [moved(mode, 1 - deviations * math.sqrt(2) * STD) for mode in result.modes.modes])
    found = compare_results(result, softer)
    assert not any(pair.changed for pair in found.pairs)
    assert found.together == pytest.approx(chi2.sf(4 * deviations**2, 4), rel=0.02)
    assert (found.moved_together, found.changed) == (beyond, beyond)
    assert ("by itself, but the frequencies of all did together" in words.comparison_headline(found)) == beyond
    assert "the frequencies of all modes as one" in words.how_sentence(found)
    assert math.isnan(compare_results(*(with_modes(one, one.modes.modes[:1]) for one in (result, softer))).together)


def test_a_damping_ratio_that_shifted_is_seen_and_one_that_is_not_resolved_is_not_compared(result):
    found = compare_results(result, other(result, 0, 1.0, 1.1))
    assert found.pairs[0].damping.verdict == "beyond chance"
    assert found.pairs[0].frequency.verdict == "within its interval"
    blind = compare_results(result, other(result, 0, 1.0, 1.1, damping_resolved=False))
    assert blind.pairs[0].damping.verdict == "not known"
    assert "not resolved" in words.shift_sentence(blind.pairs[0].damping)


def test_a_shape_that_changed_is_seen(result):
    shape = result.modes.modes[0].shape
    for size, verdict in ((0.01, "within its interval"), (0.2, "beyond chance")):
        found = compare_results(result, other(result, 0, 1.0, shape=shape + size * np.array([1, -1, 0.0])))
        assert found.pairs[0].shape.verdict == verdict, size
        assert found.pairs[0].assurance < 1


def test_the_scale_and_phase_of_a_shape_are_no_change(result):
    shape = result.modes.modes[0].shape
    found = compare_results(result, other(result, 0, 1.0, shape=shape * (0.3 - 2j)))
    assert found.pairs[0].shape.verdict == "within its interval"
    assert found.pairs[0].assurance == pytest.approx(1.0)


def test_the_bound_on_shapes_holds_for_any_correlation():
    """Szekely and Bakirov: beyond 1.5364 times its trace no Gaussian form is more likely than that of one component."""
    rng = np.random.default_rng(0)
    from scipy.special import chdtrc

    for weights in ([1, 0, 0], [0.5, 0.5, 0], [1 / 3, 1 / 3, 1 / 3], [0.8, 0.15, 0.05]):
        forms = (rng.standard_normal((200_000, 3)) ** 2) @ np.array(weights)
        for ratio in (1.6, 2.5, 4.0):
            assert (forms > ratio).mean() <= chdtrc(1.0, ratio) + 0.003


def test_unknown_deviations_are_said(identification):
    found = compare_results(identification, other(identification, 0, 1.01))
    assert found.n_tests == 0
    assert {shift.verdict for pair in found.pairs for shift in pair.shifts} == {"not known"}
    assert words.how_sentence(found) == "No shift could be tested, because no uncertainty is known."
    assert "changed cannot be told" in words.comparison_headline(found)
    assert "beyond chance" not in words.comparison_headline(found)


def test_a_mode_that_could_not_be_tested_is_not_said_to_be_unchanged(result):
    modes = list(result.modes.modes)
    modes[0] = replace(modes[0], frequency_std=math.nan, damping_ratio_std=math.nan, shape_std=None)
    part = with_modes(result, modes)
    assert words.comparison_headline(compare_results(part, part)).endswith("; of 1 it cannot be told.")
    assert "cannot be told" not in words.comparison_headline(compare_results(result, result))


def test_few_degrees_of_freedom_widen_the_interval(result):
    summary = replace(summary_of(result), degrees_of_freedom=3.0)
    shift = compare_results(summary, summary).pairs[0].frequency
    assert shift.half_width == pytest.approx(2.447 * math.sqrt(2) * STD, rel=1e-3)  # t of 6 degrees of freedom


@given(st.lists(st.floats(0, 1), min_size=1, max_size=12))
def test_holm_lies_between_bonferroni_and_no_correction(p_values):
    rejected = holm(p_values, level=0.05)
    for p, found in zip(p_values, rejected, strict=True):
        if p <= 0.05 / len(p_values):
            assert found
        if found:
            assert p <= 0.05


def test_false_alarms_are_as_rare_as_they_are_said_to_be(result):
    """Estimates drawn around the same truth with the deviations they state: 5 % of comparisons at most."""
    rng = np.random.default_rng(11)
    summary = summary_of(result)

    def drawn():
        modes = [
            moved(mode, 1 + STD * rng.standard_normal(), 1 + 10 * STD * rng.standard_normal(), shape=_noisy(mode, rng))
            if mode.verdict != "noise"
            else mode
            for mode in summary.modes
        ]
        return replace(summary, modes=tuple(modes))

    comparisons = [compare_results(drawn(), drawn()) for _ in range(300)]
    alarms = sum(any(pair.changed for pair in one.pairs) for one in comparisons)
    outside = np.mean([pair.frequency.p_value < 0.05 for one in comparisons for pair in one.pairs])
    assert alarms <= 25  # 15 are expected at most; 26 or more has a chance of 0.5 %
    assert 0.03 < outside < 0.07
    assert not any(pair.shape.verdict == "beyond chance" for one in comparisons for pair in one.pairs)


def _noisy(mode, rng):
    noise = 0.01 / math.sqrt(2) * (rng.standard_normal(3) + 1j * rng.standard_normal(3))
    return mode.shape + noise * (np.abs(mode.shape) < np.abs(mode.shape).max())


# --- what else differs -----------------------------------------------------------------------------------------------


def test_settings_channels_units_and_sampling_are_compared(result):
    (record,) = result.records
    changed = replace(
        result,
        realisation=replace(result.realisation, dt=0.02),
        modes=replace(result.modes, modes=tuple(replace(mode, verdict="doubtful") for mode in result.modes)),
        records=(replace(record, dt=0.02, output_units=["m/s^2", "m/s^2", "m"], input_names=["table"]),),
        choices=(*result.choices[:-1], replace(result.choices[-1], value="8")),
        fit=replace(result.fit, cross_validated=np.full(3, 0.3)),
    )
    found = compare_results(result, changed)
    differing = {(one.kind, one.what): (one.before, one.after) for one in found.differences}
    assert differing["sampling", "time step"] == ("0.01 s", "0.02 s")
    assert differing["unit", "output floor_3"] == ("m/s^2", "m")
    assert differing["channel", "input ground"] == ("measured", "")
    assert differing["channel", "input table"] == ("", "measured")
    assert differing["setting", "model order"] == ("6", "8")
    assert differing["fit", "trust"] == ("carried", "not carried")
    cautions = " ".join(words.caution_sentences(found))
    assert "is not reliable" in cautions
    assert "another unit" in cautions
    assert "same measured data" in cautions  # its samples are the same


def test_results_without_a_common_channel_or_mode_say_so(result):
    record = replace(result.records[0], output_names=["a", "b", "c"])
    elsewhere = replace(result, records=(record,))
    cautions = " ".join(words.caution_sentences(compare_results(result, elsewhere)))
    assert words.comparison_headline(compare_results(result, elsewhere)).startswith(
        "No output channel is in both results"
    )
    assert "no output channel in common (floor_1, floor_2, floor_3; a, b, c)" in cautions
    assert "in common" not in " ".join(words.caution_sentences(compare_results(result, result)))
    far = tuple(replace(mode, frequency=50 * mode.frequency, pole=50 * mode.pole) for mode in result.modes)
    other = compare_results(result, replace(result, modes=replace(result.modes, modes=far)))
    assert words.comparison_headline(other).startswith("No mode is in both results")
    assert words.how_sentence(other) == "No shift was tested, because no mode is in both results."


def test_independent_data_are_no_caution(result):
    (record,) = result.records
    fresh = replace(result, records=(replace(record, outputs=record.outputs + 1e-9),))
    found = compare_results(result, fresh)
    assert found.same_data is False
    assert words.caution_sentences(found) == ()
    unknown = replace(summary_of(result), data=())
    assert compare_results(unknown, result).same_data is None
    files = replace(summary_of(result), data=("file ab",))
    assert compare_results(files, result).same_data is None  # a hash of a file tells nothing of one of samples


def test_data_shared_in_part_are_not_said_to_be_the_same(result):
    (record,) = result.records
    fresh = replace(record, outputs=record.outputs + 1e-9)
    both = compare_results(result, replace(result, records=(record, fresh)))
    assert both.same_data
    (part,) = [one for one in words.caution_sentences(both) if "measured data" in one]
    assert "in part" in part
    assert "the work of the settings" not in part
    (whole,) = [one for one in words.caution_sentences(compare_results(result, result)) if "measured data" in one]
    assert "the work of the settings" in whole


# --- reading back ----------------------------------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path, result):
    """A folder with a result and the hash of the file that it comes from."""
    keep_result(result, tmp_path / "result.npz", files=["ab"])
    return tmp_path


def test_folder_and_saved_result_tell_the_same(folder, result):
    result.save(folder / "saved.npz")
    for path in (folder, folder / "result.npz", folder / "saved.npz"):
        read = read_result(path)
        assert read.name == path.name
        for one, mode in zip(read.modes, result.modes, strict=True):
            for name in ("pole", "kind", "verdict", "reason", "frequency", "damping_ratio_std", "damping_resolved"):
                assert getattr(one, name) == getattr(mode, name)
            np.testing.assert_array_equal(one.shape, mode.shape)
            np.testing.assert_array_equal(one.shape_std, mode.shape_std)
        found = compare_results(read, result)
        assert (found.differences, found.changed, len(found.pairs)) == ((), False, 4)
    assert read_result(folder).data == ("file ab",)


SPOILED = [
    lambda one: one.pop("modes"),
    lambda one: one["modes"][0].pop("pole"),
    lambda one: one["modes"][0].update(pole=[1]),
    lambda one: one["modes"][0].update(pole=["nan", 1]),
    lambda one: one["modes"][0].update(frequency="high"),
    lambda one: one["modes"][0].update(frequency=None),
    lambda one: one["modes"][0].update(frequency=10**400),
    lambda one: one["modes"][0].update(verdict="sure"),
    lambda one: one["modes"][0].update(damping_resolved=[]),
    lambda one: one["modes"][0].update(shape={"array": "none"}),
    lambda one: one.update(outputs=one["outputs"][:2]),
    lambda one: one.update(modes=[1]),
    lambda one: one.update(modes=one["modes"] * (MOST_MODES // len(one["modes"]) + 1)),
    lambda one: one.update(choices=[{"what": "x"}]),
]


@pytest.mark.parametrize("spoil", SPOILED)
def test_a_spoiled_summary_is_one_sentence(folder, spoil):
    with zipfile.ZipFile(folder / "result.npz") as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    document = json.loads(members["result.json"])
    spoil(document["summary"])
    members["result.json"] = json.dumps(document).encode()
    with zipfile.ZipFile(folder / "result.npz", "w") as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    with pytest.raises(UnreadableFileError, match=r"damaged or no result.*\.$"):
        read_result(folder)


def test_a_saved_result_with_poles_that_are_none_is_refused(tmp_path, result):
    modes = (replace(result.modes.modes[0], pole=complex(math.nan, 1.0)), *result.modes.modes[1:])
    with_modes(result, modes).save(tmp_path / "bad.npz")
    with pytest.raises(UnreadableFileError, match="a pole is not finite"):
        read_result(tmp_path / "bad.npz")


def test_what_is_no_result_is_said(tmp_path):
    (tmp_path / "report.json").write_text("[1]")
    (tmp_path / "bad.npz").write_bytes(b"PK")
    for name in ("report.json", "bad.npz", "no.npz", "", "x" * 5000):
        with pytest.raises(UnreadableFileError):
            read_result(tmp_path / name)
    with pytest.raises(InvalidDataError, match="two results"):
        compare_results(3, 4)


# --- measured, not drawn ---------------------------------------------------------------------------------------------


def test_a_structure_measured_twice_is_the_same_and_a_changed_one_is_not():
    """Two records of one system with fresh noise; then one whose frequencies are all 1 % higher (a shorter dt)."""
    rng = np.random.default_rng(4)
    system = random_system(rng, n_modes=3, n_inputs=1, n_outputs=3, weak_mode=None)

    def measured(dt):
        u = rng.standard_normal((1500, 1))
        y = simulate(system, u)
        record = Record(u, y + 0.05 * y.std(axis=0) * rng.standard_normal(y.shape), dt)
        return identify(record, observer_order=20, ridge=1e-6, order=6)

    first, second, third = measured(system.dt), measured(system.dt), measured(system.dt / 1.01)
    same = compare_results(first, second)
    assert len(same.pairs) == 3
    assert not same.changed
    assert same.same_data is False
    changed = compare_results(first, third)
    assert [pair.frequency.verdict for pair in changed.pairs] == ["beyond chance"] * 3
    for pair in changed.pairs:
        assert abs(pair.frequency.change - 0.01) < 1.5 * pair.frequency.half_width
        assert pair.damping.verdict != "beyond chance"
        assert pair.shape.verdict != "beyond chance"
