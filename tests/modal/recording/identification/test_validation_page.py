"""The page "Validation": the response of the model beside that of the data, and words that say what was run on what."""

from dataclasses import replace

import numpy as np
import pytest

from era.realisation import Realisation
from modal.recording import save_recording
from modal.recording.identification.fit import drawn_inputs
from modal.recording.plan import gather, planned, response_of
from okid.record import Record


def complex_column(rows, name):
    return np.array([row[f"{name}_real"] for row in rows.values()]) + 1j * np.array(
        [row[f"{name}_imaginary"] for row in rows.values()]
    )


def test_the_synthesised_response_is_that_of_the_model(stored, identification):
    rows = stored.rows("/validation/response/02/numbers", "frequency_line")
    made = complex_column(rows, "synthesised")
    model = identification.realisation
    for line in (3, 40, 100):
        z = np.exp(2j * np.pi * rows[line + 1]["frequency"][0] * model.dt)
        expected = model.D + model.C @ np.linalg.solve(z * np.eye(model.order) - model.A, model.B)
        np.testing.assert_allclose(made[line], expected[1], rtol=1e-9)


def test_measured_and_synthesised_agree_where_the_data_are_clean(build):
    found = build(noise=0.0, n_samples=20_000, n_inputs=1, n_modes=2)
    clean = gather(replace(found, simulated=found.records))
    seen, made = clean.measured.frf[5:-5, :, 0], clean.synthesised[5:-5, :, 0]
    assert np.median(np.abs(seen - made) / np.abs(made)) < 0.05
    assert np.nanmedian(clean.measured.multiple_coherence) > 0.95


def test_every_output_has_its_numbers_and_the_shown_ones_their_picture(stored, identification):
    paths = set(stored.entities("LineStrips2D:strips"))
    for output in range(1, 5):
        table = stored.rows(f"/validation/response/{output:02d}/numbers", "frequency_line")
        assert len(table[1]["ordinary_coherence"]) == 2
        assert f"/validation/overview/{output:02d}/plot/synthesised" in paths
        for source in (1, 2):
            plot = f"/validation/response/{output:02d}/{source:02d}/plot"
            parts = {f"{plot}/0/measured", f"{plot}/1/synthesised", f"{plot}/2/with_all_inputs"}
            assert parts <= paths
    assert identification.records[0].n_inputs == 2


def test_the_input_that_moves_an_output_most_is_drawn_first_and_many_pairs_are_bounded(build):
    found = build(n_outputs=12, n_inputs=4, n_modes=3, n_samples=2000)
    evidence, plan = gather(found), planned(found)
    rng = np.random.default_rng(3)
    coherence = rng.uniform(0.0, 0.1, evidence.measured.ordinary_coherence.shape)
    coherence[:, 5, 2] = 0.9
    evidence = replace(evidence, measured=replace(evidence.measured, ordinary_coherence=coherence))
    assert drawn_inputs(evidence, plan, 5)[0] == 2
    assert all(len(drawn_inputs(evidence, plan, output)) == 1 for output in range(12))


def test_without_inputs_the_spectrum_of_the_model_stands_beside_that_of_the_data(build):
    # white noise of variance r through y_k = a y_(k-1) + e_k: S(f) = 2 dt r / |1 - a exp(-2 pi i f dt)|^2
    a, r, dt, n = 0.8, 0.49, 0.01, 60_000
    rng = np.random.default_rng(5)
    e = np.sqrt(r) * rng.standard_normal(n)
    y = np.zeros(n)
    for k in range(1, n):
        y[k] = a * y[k - 1] + e[k]
    record = Record(np.zeros((n, 0)), y[:, np.newaxis], dt)
    one = np.ones((1, 1))
    model = Realisation(a * one, np.zeros((1, 0)), one, np.zeros((1, 0)), dt, K=a * one)
    found = replace(
        build(n_inputs=0, n_outputs=1, n_modes=1, n_samples=500),
        records=(record,),
        simulated=(record,),
        realisation=model,
        innovation_covariance=r * one,
    )
    evidence = gather(found)
    f = evidence.density_frequencies
    expected = 2 * dt * r / np.abs(1 - a * np.exp(-2j * np.pi * f * dt)) ** 2
    np.testing.assert_allclose(evidence.model_density[:, 0], expected, rtol=1e-9)
    measured = evidence.quality.densities[: f.size, 0]
    assert np.median(measured[3:-3] / expected[3:-3]) == pytest.approx(1.0, abs=0.1)


def test_inputs_that_cannot_be_told_apart_leave_cells_empty_and_recordings_equal(build, tmp_path, read):
    found = build()
    record = found.records[0]
    twice = np.column_stack([record.inputs[:, 0], record.inputs[:, 0]])
    found = replace(found, records=(replace(record, inputs=twice),))
    stored = read(save_recording(found, tmp_path / "run.rrd"))
    rows = stored.rows("/validation/response/01/numbers", "frequency_line")
    assert not any(row.get("measured_real") for row in rows.values())
    assert all(row["synthesised_real"] for row in rows.values())


def test_a_record_of_gaps_uses_shorter_segments(build):
    found = build(n_samples=4000)
    outputs = found.records[0].outputs.copy()
    outputs[::150] = np.nan
    measured = response_of((replace(found.records[0], outputs=outputs),))
    assert measured is not None
    assert measured.frequencies.size <= 65


def test_between_coarse_lines_the_model_is_drawn_and_stored_as_it_is(build, tmp_path, read):
    found = build(n_samples=600)
    evidence = gather(found)
    assert evidence.measured.frequencies.size < 100
    assert evidence.fine_frequencies.size >= 700
    step = (evidence.fine_frequencies.size - 1) // (evidence.measured.frequencies.size - 1)
    np.testing.assert_allclose(evidence.fine_frequencies[::step], evidence.measured.frequencies, atol=1e-9)
    np.testing.assert_array_equal(evidence.fine[::step], evidence.synthesised)
    stored = read(save_recording(found, tmp_path / "short.rrd"))
    rows = stored.rows("/validation/response/02/model", "frequency_line")
    model, made = found.realisation, complex_column(rows, "synthesised")
    for line in (1, 5, 77):
        z = np.exp(2j * np.pi * rows[line + 1]["frequency"][0] * model.dt)
        expected = model.D + model.C @ np.linalg.solve(z * np.eye(model.order) - model.A, model.B)
        np.testing.assert_allclose(made[line], expected[1], rtol=1e-9)
    drawn = stored.static("/validation/overview/02/plot/synthesised", "LineStrips2D:strips")
    assert sum(map(len, drawn)) > 3 * evidence.measured.frequencies.size
