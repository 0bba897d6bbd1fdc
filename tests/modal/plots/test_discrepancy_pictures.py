"""What the pictures of a diagnosis draw is what its numbers say."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_by_hand import hysteresis_law

from modal.plots import discrepancy
from modal.plots import discrepancy as discrepancy_law
from modal.plots.panels import Area, Segments
from modal.sections.discrepancy_stages import rows_of, stages_of


@pytest.fixture(scope="module")
def stages(diagnosis):
    return stages_of(diagnosis)


def test_histories_are_measured_minus_simulated_under_the_band_of_the_noise(diagnosis, stages):
    figure = discrepancy.gap_histories(stages, record=1)
    whole = figure.panels[2]  # row of the second output
    drawn = {line.label: line.y for line in whole.lines}
    measured = diagnosis.held_out[1].outputs[:, 1]
    for name, step in (("as given", diagnosis.steps[0]), ("with the effects", diagnosis.steps[-1])):
        np.testing.assert_array_equal(drawn[name], measured - step.simulated[1][:, 1])
    band = next(mark for mark in whole.marks if "noise" in mark.label)
    assert np.ptp(band.corners[:, 1]) == pytest.approx(4.0 * np.sqrt(diagnosis.noise_floor.variance[3, 1]))


def test_the_worst_moment_holds_the_greatest_gap(diagnosis, stages):
    figure = discrepancy.gap_histories(stages, record=1, outputs=[1])
    part = figure.panels[1].lines[0].y
    energy = (diagnosis.held_out[1].outputs - diagnosis.steps[0].simulated[1]) ** 2
    length = part.size
    best = max(range(1000 - length + 1), key=lambda k: energy[k : k + length].sum())
    expected = (diagnosis.held_out[1].outputs - diagnosis.steps[0].simulated[1])[best : best + length, 1]
    np.testing.assert_allclose(part, expected)


def test_the_dashed_line_of_a_spectrum_is_the_noise(diagnosis, stages):
    axis = discrepancy.gap_spectra(stages).panels[0]
    (line,) = (line for line in axis.lines if line.label == "noise floor")
    expected = 2.0 * diagnosis.held_out[0].dt * diagnosis.noise_floor.variance[2, 0]
    assert line.y[0] == pytest.approx(expected)


def test_points_of_before_and_after_are_the_sizes_of_the_rows(stages):
    rows = rows_of(stages)
    figure = discrepancy.before_and_after(rows, stages)
    assert len(figure.panels) == 3
    for axis, part in zip(figure.panels, ("output", "record", "band"), strict=True):
        group = [row for row in rows if row.part == part]
        assert [text for _, text in axis.y_ticks()] == [row.name for row in group]
        for index, stage in enumerate(stages):
            (line,) = (line for line in axis.lines if line.label == stage.name)
            assert line.x.tolist() == [row.sizes[index] for row in group]


def test_bars_end_at_what_is_left_and_the_found_one_is_green(diagnosis):
    figure = discrepancy.hypothesis_bars(diagnosis.hypotheses, chosen=diagnosis.hypotheses[0])
    bars = [mark for mark in figure.panels[0].marks if isinstance(mark, Area)]
    ends = [bar.corners[:, 0].max() for bar in bars]
    assert ends == pytest.approx([np.sqrt(one.held_out_level) for one in diagnosis.hypotheses])
    assert [bar.role for bar in bars] == ["system"] + ["noise"] * 3
    assert sorted(line.x[0] for line in figure.panels[0].lines) == pytest.approx([1.0, np.sqrt(1.5)])


def test_a_hypothesis_that_ran_away_is_told_and_not_measured(diagnosis):
    lost = replace(diagnosis.hypotheses[1], held_out_level=np.inf)
    axis = discrepancy.hypothesis_bars((diagnosis.hypotheses[0], lost)).panels[0]
    assert any("did not run through" in word.text for word in axis.words)
    assert not any("inf" in word.text or "nan" in word.text for word in axis.words)


def test_steps_are_drawn_on_both_kinds_of_records(diagnosis):
    axis = discrepancy.shrinking_gap(diagnosis.steps).panels[0]
    drawn = {line.label: line.y for line in axis.lines}
    np.testing.assert_allclose(drawn["on held-out records"], [np.sqrt(s.held_out_level) for s in diagnosis.steps])
    np.testing.assert_allclose(drawn["on the records fitted to"], [np.sqrt(s.fit_level) for s in diagnosis.steps])
    labels = [text for _, text in axis.x_ticks()]
    assert labels == ["as given", "calibrated", "+ cubic stiffness\nat element_1", "+ Coulomb friction\nat element_1"]


def test_a_law_is_drawn_with_its_band_and_the_points_with_their_bars(diagnosis):
    law = diagnosis.laws[0]
    axis = discrepancy_law.draw_laws([law]).panels[0]
    (curve,) = (line for line in axis.lines if line.label == "law as found")
    np.testing.assert_array_equal(curve.y, law.force)
    (points,) = (line for line in axis.lines if line.label == "from the data, 95 %")
    np.testing.assert_array_equal(points.y, law.points_force)
    (bars,) = (mark for mark in axis.marks if isinstance(mark, Segments))
    np.testing.assert_allclose(bars.ends[:, 1, 1] - bars.ends[:, 0, 1], 3.92 * law.points_deviation)
    (band,) = (mark for mark in axis.marks if isinstance(mark, Area))
    assert band.corners[:, 1].max() == pytest.approx((law.force + 1.96 * law.deviation).max())
    assert (axis.x.label, axis.y.label) == ("displacement [m]", "force [N]")


def test_a_law_with_memory_is_its_loop(diagnosis):
    law = hysteresis_law()
    axis = discrepancy_law.draw_laws([law]).panels[0]
    np.testing.assert_array_equal(axis.lines[0].y, law.loop_force)
    np.testing.assert_array_equal(axis.lines[1].y, law.force)
    assert not any(isinstance(mark, Area) for mark in axis.marks)
