"""The gap by part, against plain loops over samples."""

from dataclasses import replace

import numpy as np
import pytest
from levels_by_hand import HARDENS, LEVELS, POLE, RESTS, VAGUE, with_levels

from modal.plots.discrepancy import modes_against_level
from modal.report.discrepancy_writing import draw_diagnosis
from modal.sections.discrepancy_stages import (
    gap_density,
    held_out_floor,
    level_lines,
    rows_of,
    stages_of,
    telling,
    worst_outputs,
)


def by_hand(diagnosis, step):
    """(n_held_out, n_outputs) mean square in units of the noise, sample by sample."""
    variance = diagnosis.noise_floor.variance[len(diagnosis.fit) :]
    sizes = np.zeros_like(variance)
    for i, record in enumerate(diagnosis.held_out):
        for j in range(record.n_outputs):
            total = sum(
                (float(record.outputs[k, j]) - float(step.simulated[i][k, j])) ** 2 for k in range(record.n_samples)
            )
            sizes[i, j] = total / record.n_samples / variance[i, j]
    return sizes


@pytest.mark.parametrize(
    ("status", "n_effects", "kinds"),
    [
        ("named", 2, ["before", "linear", "after"]),
        ("named", 1, ["before", "linear", "after"]),
        ("none", 0, ["before", "after"]),
    ],
)
def test_the_stages_are_the_first_the_calibrated_and_the_last(diagnosis_of, status, n_effects, kinds):
    found = diagnosis_of(status, n_effects)
    stages = stages_of(found)
    assert [stage.kind for stage in stages] == kinds
    assert stages[0].step == 0
    assert stages[-1].step == len(found.steps) - 1
    assert stages[0].name == "as given"
    assert stages[-1].name == {0: "calibrated", 1: "with the effect", 2: "with the effects"}[n_effects]


def test_sizes_are_those_of_a_plain_loop(diagnosis):
    stages = stages_of(diagnosis)
    rows = rows_of(stages)
    for index, stage in enumerate(stages):
        sizes = by_hand(diagnosis, diagnosis.steps[stage.step])
        outputs = [row.sizes[index] for row in rows if row.part == "output"]
        np.testing.assert_allclose(outputs, np.sqrt(sizes.mean(axis=0)), rtol=1e-10)
        records = {row.name: row.sizes[index] for row in rows if row.part == "record"}
        assert records == pytest.approx(
            {record.name: float(np.sqrt(sizes[i].mean())) for i, record in enumerate(diagnosis.held_out)}
        )


def test_outputs_that_answer_a_drive_before_the_record_are_no_gap(diagnosis_of):
    """As in the fit, to which they are missing: with feedthrough they would be the largest of all."""
    found = diagnosis_of("named", 1)
    tau = replace(found.findings[0].parameters[0], name="tau", value=2 * found.held_out[0].dt, unit="s")
    late = replace(found.findings[0], effect="input_delay", where="input_0", parameters=(tau,))
    off = tuple(values + 0.0 for values in found.steps[-1].simulated)
    for values in off:
        values[:2] += 1e3
    wrong = replace(found, findings=(late,), steps=(*found.steps[:-1], replace(found.steps[-1], simulated=off)))
    here, there = (rows_of(stages_of(one))[0].sizes[-1] for one in (wrong, found))
    assert here == pytest.approx(there, rel=0.05)


def test_what_is_noise_has_size_one_in_every_band(diagnosis):
    rows = [row for row in rows_of(stages_of(diagnosis)) if row.part == "band"]
    assert len(rows) > 3
    assert all(row.sizes[-1] == pytest.approx(1.0, abs=0.35) for row in rows)
    assert max(row.sizes[0] for row in rows) > 20.0


def test_the_floor_is_that_of_the_held_out_records(diagnosis):
    variance = np.arange(8.0).reshape(4, 2) + 1.0
    changed = replace(diagnosis, noise_floor=replace(diagnosis.noise_floor, variance=variance))
    np.testing.assert_array_equal(held_out_floor(changed), variance[2:])


@pytest.mark.parametrize("how", ["partly", "never ran"])
def test_a_step_that_ran_away_is_no_stage(diagnosis, how):
    lost = np.array(diagnosis.steps[0].simulated[1])
    lost[500:] = np.nan
    simulated = (diagnosis.steps[0].simulated[0], lost) if how == "partly" else ()
    first = replace(diagnosis.steps[0], simulated=simulated)
    stages = stages_of(replace(diagnosis, steps=(first, *diagnosis.steps[1:])))
    assert [stage.kind for stage in stages] == ["linear", "after"]
    assert rows_of(()) == ()


def test_worst_outputs_stand_in_the_order_of_the_record(diagnosis):
    gap = stages_of(diagnosis)[0].gap
    assert worst_outputs(gap, 2) == [0, 1]
    assert worst_outputs(gap, 1) == [1]


def test_densities_add_up_to_mean_squares(diagnosis):
    stages = stages_of(diagnosis)
    density = gap_density([stage.gap for stage in stages])
    width = density.frequency[1] - density.frequency[0]
    nyquist = 0.5 / diagnosis.held_out[0].dt
    np.testing.assert_allclose(density.noise * nyquist, diagnosis.noise_floor.variance[0], rtol=1e-12)
    after = density.gaps[-1].sum(axis=0) * width
    np.testing.assert_allclose(after, diagnosis.noise_floor.variance[0], rtol=0.2)
    low, high = density.span(1)
    assert low < density.noise[1] < density.gaps[0][:, 1].max() < high


def test_a_mode_tells_something_when_it_is_known_to_move_or_to_stay():
    assert [telling(mode) for mode in (HARDENS, RESTS, VAGUE, POLE)] == [True, True, False, True]


@pytest.mark.parametrize(
    ("modes", "agrees", "names"),
    [
        ((HARDENS, RESTS, VAGUE), False, ["mode 1, 3.00 Hz", "mode 2, 8.00 Hz"]),
        ((VAGUE,), False, []),
        ((HARDENS,), True, []),
        ((POLE,), False, ["pole 1, 0.500 Hz"]),
        ((), False, []),
    ],
)
def test_lines_are_those_of_modes_that_tell(diagnosis, modes, agrees, names):
    found = with_levels(diagnosis, *modes, agrees=agrees)
    assert [line.name for line in level_lines(found)] == names
    assert ("levels" in draw_diagnosis(found)) == bool(names)


def test_without_a_location_nothing_is_drawn(diagnosis):
    assert level_lines(diagnosis) == ()


def test_the_numbers_are_changes_from_the_lowest_level_in_percent(diagnosis):
    first, second = level_lines(with_levels(diagnosis, HARDENS, RESTS))
    np.testing.assert_allclose(first.change, [0.0, 2.0, 10.0])
    np.testing.assert_allclose(first.change_std, 100 * 0.001 * np.array([1.0, 1.02, 1.1]))
    np.testing.assert_allclose(first.damping, [1.0, 1.2, 1.1])
    np.testing.assert_allclose(second.levels, LEVELS[[0, 2]])  # not found at the middle one
    np.testing.assert_allclose(second.damping_std, [0.1, 0.1])


def test_the_picture_draws_the_numbers_and_a_tick_at_each_level(diagnosis):
    lines = level_lines(with_levels(diagnosis, HARDENS, RESTS))
    figure = modes_against_level(lines)
    left, right = figure.panels
    np.testing.assert_allclose(left.lines[0].y, lines[0].change)
    np.testing.assert_allclose(right.lines[1].y, lines[1].damping)
    np.testing.assert_allclose([value for value, _ in left.x_ticks()], LEVELS)
    assert [mark.label for mark in left.keyed] == [line.name for line in lines]


def test_poles_of_first_order_have_no_panel_of_damping(diagnosis):
    assert len(modes_against_level(level_lines(with_levels(diagnosis, POLE))).panels) == 1
    assert len(modes_against_level(level_lines(with_levels(diagnosis, POLE, HARDENS))).panels) == 2
