"""What is drawn is stored: the file is read back and compared with the identification, number by number."""

from dataclasses import replace

import numpy as np
import pytest

from modal.recording import save_recording
from modal.recording.plan import planned

NAMES = [
    *("frequency_std", "damping_ratio", "damping_ratio_std", "damping_resolved", "kind", "verdict", "reason"),
    *("amplitude_coherence", "phase_collinearity", "emac_output", "emac_input", "emac", "cmi", "msv", "mpd"),
    *("repeatability", "probability"),
]


def test_every_series_is_the_record_sample_by_sample(stored, identification):
    record = identification.records[0]
    for i, name in enumerate(record.input_names):
        times, values = stored.series(f"/data/input/{name}")
        np.testing.assert_allclose(times, record.time, atol=1e-9)
        np.testing.assert_array_equal(values, record.inputs[:, i])
    for i, name in enumerate(record.output_names):
        measured = stored.series(f"/data/output/{name}")[1]
        predicted = stored.series(f"/fit/output/{name}/model", 0)[1]
        simulated = stored.series(f"/fit/output/{name}/model", 1)[1]
        np.testing.assert_array_equal(measured, record.outputs[:, i])
        np.testing.assert_array_equal(simulated, identification.simulated[0].outputs[:, i])
        np.testing.assert_array_equal(predicted, identification.predicted[0].outputs[:, i])
        np.testing.assert_array_equal(stored.series(f"/fit/output/{name}/residual", 0)[1], measured - simulated)
        np.testing.assert_array_equal(stored.series(f"/fit/output/{name}/residual", 1)[1], measured - predicted)


def test_every_line_over_time_is_drawn_by_its_extremes(stored):
    # with any other policy the viewer averages what falls on one pixel: a vibration becomes a flat line
    lines = stored.entities("SeriesLines:names")
    assert len(lines) >= 2 + 4 * 3
    assert set(lines) == set(stored.entities("SeriesLines:aggregation_policy"))
    from rerun.components import AggregationPolicy

    for path in lines:
        policy = stored.static(path, "SeriesLines:aggregation_policy")
        assert policy == [AggregationPolicy.MinMax.value], path


def test_the_mode_table_holds_every_mode_with_every_indicator_system_first(stored, identification):
    table = stored.table("/modes/table", "mode")
    modes = identification.modes.modes
    assert len(table["mode"]) == len(modes) == 7
    by_frequency = {mode.frequency: mode for mode in modes}
    assert table["verdict"] == ["system"] * 3 + ["noise"] * 4
    for row, frequency in enumerate(table["frequency"]):
        mode = by_frequency.pop(frequency)
        for name in NAMES:
            assert table[name][row] == getattr(mode, name)
        assert complex(table["pole_real"][row], table["pole_imaginary"][row]) == mode.pole
    assert not by_frequency


@pytest.mark.parametrize("what", ["shape", "participation"])
def test_shapes_and_participations_are_stored_whole(stored, identification, what):
    rows = stored.rows(f"/modes/{what}s", "mode")
    plan = planned(identification)
    for number, mode in enumerate(plan.modes, start=1):
        parts = rows[number]
        np.testing.assert_array_equal(np.array(parts["real"]) + 1j * np.array(parts["imaginary"]), getattr(mode, what))


def test_assurance_is_that_of_the_shapes(stored, identification):
    rows = stored.rows("/modes/assurance/numbers", "mode")
    shapes = [mode.shape for mode in identification.modes.system]
    assert sorted(rows) == [1, 2, 3]
    for number, row in rows.items():
        for other, value in enumerate(row["assurance"]):
            a, b = shapes[number - 1], shapes[other]
            expected = abs(np.vdot(a, b)) ** 2 / (np.vdot(a, a).real * np.vdot(b, b).real)
            assert value == pytest.approx(expected, abs=1e-12)


def test_order_evidence_is_stored_by_model_order(stored, identification):
    evidence = identification.order_evidence
    values = stored.table("/order/singular_values", "model_order")
    np.testing.assert_array_equal(values["singular_value"], evidence.singular_values)
    assert sum(values["kept"]) == evidence.order
    fits = stored.table("/order/fit", "model_order")
    np.testing.assert_array_equal(fits["model_order"], evidence.candidate_orders)
    np.testing.assert_array_equal(fits["cross_validated_fit"], evidence.candidate_fits)
    poles = stored.rows("/order/stabilisation", "model_order")
    for order, row in poles.items():
        points = [point for point in evidence.stabilisation if point.order == order]
        for name in ("frequency", "damping_ratio", "overlap", "emac"):
            assert row[name] == [getattr(point, name) for point in points]
    assert sum(len(row["emac"]) for row in poles.values()) == len(evidence.stabilisation)
    assert not any("repeatability" in row for row in poles.values())  # nobody knows it here


def test_the_repeatability_of_the_poles_is_stored_and_colours_them(identification, tmp_path, read):
    evidence = identification.order_evidence
    again = np.linspace(0.0, 1.0, len(evidence.stabilisation)).tolist()
    points = tuple(
        replace(point, repeatability=value) for point, value in zip(evidence.stabilisation, again, strict=True)
    )
    changed = replace(identification, order_evidence=replace(evidence, stabilisation=points))
    stored = read(save_recording(changed, tmp_path / "a.rrd"))
    rows = stored.rows("/order/stabilisation", "model_order")
    for order, row in rows.items():
        assert row["repeatability"] == [point.repeatability for point in points if point.order == order]
    ((row,),) = [stored.rows("/order/stabilisation/plot/poles", "time").values()]
    colours = row["Points2D:colors"]
    assert len(colours) == len(points)
    assert colours[0] != colours[-1]


def test_the_response_behind_the_poles_is_that_of_the_model(stored, identification):
    table = stored.table("/order/response", "frequency_line")
    model = identification.realisation
    for line in (0, 100, 1023):
        z = np.exp(2j * np.pi * table["frequency"][line] * model.dt)
        response = model.D + model.C @ np.linalg.solve(z * np.eye(model.order) - model.A, model.B)
        assert table["size"][line] == pytest.approx(np.sqrt(np.mean(np.abs(response) ** 2)), rel=1e-9)
    assert table["frequency"][-1] == pytest.approx(0.5 / model.dt)


def test_markov_parameters_whiteness_and_fits_are_stored(stored, identification):
    lags, markov = stored.vectors("/fit/markov/numbers", "lag")
    assert lags == list(range(121))
    np.testing.assert_array_equal(markov, identification.markov.system.reshape(121, -1))
    _, whiteness = stored.vectors("/fit/whiteness/numbers", "lag")
    np.testing.assert_array_equal(whiteness, identification.residuals.autocorrelation)
    outputs = stored.table("/fit/outputs", "output")
    assert outputs["name"] == list(identification.records[0].output_names)
    for name in ("cross_validated", "whole", "one_step"):
        np.testing.assert_array_equal(outputs[name], getattr(identification.fit, name))


def test_a_moving_shape_starts_at_its_largest_and_stays_within_its_envelope(stored, identification):
    mode = identification.modes.system[0]
    frames = stored.frames("/modes/shape/01/heads", "Points3D:positions")
    heights = np.array(frames)[:, :, 2]
    scale = np.abs(heights[0]).max()
    np.testing.assert_allclose(heights[0] / scale, mode.shape.real, atol=1e-6)
    assert (np.abs(heights) <= np.abs(mode.shape) * scale + 1e-6).all()
    assert (heights.min(axis=0) < -0.99 * np.abs(mode.shape) * scale).all()


def test_words_name_what_was_found(stored, identification):
    text = stored.static("/fit/text", "TextDocument:text")[0]
    assert "### Three modes of the system were found, between 6.667 and 33.33 Hz." in text
    table = stored.static("/modes/text", "TextDocument:text")[0]
    assert table.count("| noise |") == 4
    assert table.count("| **system** |") == 3
    choices = stored.static("/modes/choices", "TextDocument:text")[0]
    for choice in identification.choices:
        assert choice.what in choices
    assert "None" in choices.split("Warnings")[1]


def test_a_warning_stands_on_the_first_page(build, tmp_path, read):
    path = save_recording(build(system=False), tmp_path / "run.rrd")
    text = read(path).static("/fit/text", "TextDocument:text")[0]
    assert text.startswith("### No mode of the system was found.")
    assert "below 0.5: no mode is certain" in text


def test_a_long_reason_is_cut_in_the_table_and_whole_below_it(identification, tmp_path, read):
    long = "; ".join(f"reason {k} of this verdict" for k in range(9))
    modes = identification.modes.modes
    changed = replace(identification.modes, modes=(replace(modes[0], reason=long), *modes[1:]))
    stored = read(save_recording(replace(identification, modes=changed), tmp_path / "run.rrd"))
    rows, below = stored.static("/modes/text", "TextDocument:text")[0].split("\n\n", 1)
    assert long not in rows
    assert "reason 0 of this verdict" in rows
    assert long in below
    assert modes[1].reason not in below


def test_assurance_of_outputs_in_several_units_is_that_of_displacements(identification, tmp_path, read):
    units = ("m", "m/s", "m/s^2", "m/s^2")
    records = tuple(replace(record, output_units=units) for record in identification.records)
    path = save_recording(replace(identification, records=records), tmp_path / "units.rrd")
    rows = read(path).rows("/modes/assurance/numbers", "mode")
    modes = {number: mode for number, mode in enumerate(planned(identification).modes, start=1) if number in rows}
    for number, row in rows.items():
        a = [part / modes[number].pole ** n for part, n in zip(modes[number].shape, (0, 1, 2, 2), strict=True)]
        for other, value in zip(rows, row["assurance"], strict=True):
            b = [part / modes[other].pole ** n for part, n in zip(modes[other].shape, (0, 1, 2, 2), strict=True)]
            assert value == pytest.approx(abs(np.vdot(a, b)) ** 2 / (np.vdot(a, a) * np.vdot(b, b)).real, abs=1e-9)
