import re
from dataclasses import replace
from importlib import resources

import numpy as np
import pytest
from diagnosis_by_hand import hysteresis_law

from modal import plots
from modal.identification.result import OrderEvidence
from modal.modes.response_synthesis import measured_frf
from modal.plots import discrepancy
from modal.plots.order import OVERLAP_CLASSES, REPEATABILITY_CLASSES
from modal.plots.panels import COLOURS, envelope
from modal.sections.discrepancy_stages import power_spectra, rows_of, stages_of
from okid.record import Record


def all_figures(result):
    record = result.records[0]
    assurance = np.eye(len(result.modes.system))
    return {
        "singular values": plots.singular_values(result.order_evidence),
        "order fits": plots.order_fits(result.order_evidence),
        "stabilisation": plots.stabilisation_diagram(result.order_evidence, result.modes, measured=result.records),
        "histories": plots.measured_against_simulated(record, result.simulated[0]),
        "spectra": plots.output_spectra(result.records, result.simulated),
        "responses": plots.response_chart(measured_frf(result.records), result.realisation),
        "markov": plots.markov_parameters(result.markov, result.markov.system),
        "residuals": plots.residual_autocorrelation(result.residuals),
        "shapes": plots.mode_shapes(result.modes.system, output_names=record.output_names),
        "complexity": plots.shape_complexity(result.modes.modes),
        "assurance": plots.assurance_matrix(assurance, result.modes.frequencies.tolist()),
    }


def all_of_a_diagnosis(found):
    stages = stages_of(found)
    return {
        "gap histories": discrepancy.gap_histories(stages),
        "gap spectra": discrepancy.gap_spectra(stages),
        "before and after": discrepancy.before_and_after(rows_of(stages), stages),
        "hypotheses": discrepancy.hypothesis_bars(found.hypotheses, chosen=found.hypotheses[0]),
        "steps": discrepancy.shrinking_gap(found.steps),
        "laws": discrepancy.draw_laws((*found.laws, hysteresis_law(found.laws[0].where))),
    }


def written(figures, description=None):
    return {
        name: plots.svg_text(figure, name=name, description=description or name) for name, figure in figures.items()
    }


@pytest.fixture(scope="module")
def vector_texts(make_result, diagnosis):
    return written({**all_figures(make_result()), **all_of_a_diagnosis(diagnosis)})


def test_every_colour_of_a_picture_belongs_to_the_page(vector_texts):
    for name, text in vector_texts.items():
        bare = set(re.findall(r"(?:fill|stroke): (#[0-9a-f]{6})", text))
        assert not bare, f"{name} holds colours that no theme exchanges: {bare}"
        assert "var(--" in text


def test_a_picture_asks_for_nothing_from_outside(vector_texts):
    for text in vector_texts.values():
        assert "http" not in text
        assert all(target.startswith("#") for target in re.findall(r'href="([^"]*)"', text))
        assert all(target.startswith("#") for target in re.findall(r"url\(([^)]*)\)", text))


def test_every_reference_of_a_picture_is_in_it_and_in_no_other(vector_texts):
    seen = {}
    for name, text in vector_texts.items():
        ids = set(re.findall(r' id="([^"]*)"', text))
        wanted = set(re.findall(r'href="#([^"]*)"', text)) | set(re.findall(r"url\(#([^)]*)\)", text))
        assert wanted <= ids
        for identity in ids:
            assert seen.setdefault(identity, name) == name


def test_same_figure_same_bytes(make_result):
    def once():
        figure = plots.mode_shapes(make_result().modes.system, output_names=("a", "b", "c"))
        return plots.svg_text(figure, name="shapes", description="shapes")

    assert once() == once()


def test_every_colour_has_the_name_by_which_the_page_exchanges_it(vector_texts):
    page = resources.files("modal.report").joinpath("templates/page.css").read_text(encoding="utf-8")
    for text in vector_texts.values():
        for role, colour in set(re.findall(r"var\(--(\w+), (#[0-9a-f]{6})\)", text)):
            assert COLOURS[role] == colour
            assert f"--{role}: {colour}" in page


TAGS = {"svg", "g", "path", "defs", "style", "text", "tspan", "use", "clipPath", "rect"}


@pytest.mark.parametrize(
    "name", ["<script>alert(1)</script>", "a $\\frac{", "x" * 500, "قناة 加速度", "-->", '" onload="x']
)
def test_names_are_only_text_in_a_picture(identification, make_gap, name):
    shapes = plots.mode_shapes(identification.modes.system, output_names=(name, "b", "c"))
    figures = {"shapes": shapes, **all_of_a_diagnosis(make_gap(names=(name, "b"), where=name, n_effects=1))}
    for text in written(figures, description=name).values():
        assert set(re.findall(r"<([a-zA-Z]+)", text)) <= TAGS
        assert not re.search(r"<[^>]*\sonload=", re.sub(r'"[^"]*"', '""', text))


def test_envelope_keeps_the_peaks_of_a_long_record():
    values = np.zeros(100_000)
    values[[1234, 77_777]] = 5.0, -3.0
    time, thin = envelope(np.arange(100_000.0), values)
    assert thin.size <= 1700
    assert time.size == thin.size
    assert (thin.max(), thin.min()) == (5.0, -3.0)


def test_envelope_leaves_gaps_open():
    values = np.ones(10_000)
    values[2000:4000] = np.nan
    _, thin = envelope(np.arange(10_000.0), values, n_points=100)
    assert np.isnan(thin).sum() == 20
    assert np.nanmin(thin) == np.nanmax(thin) == 1.0


def test_power_spectrum_of_white_noise_integrates_to_its_variance():
    rng = np.random.default_rng(5)
    noise = 3.0 * rng.standard_normal((60_000, 2))
    frequency, power = power_spectra([Record([[]] * 60_000, noise, 0.01)])
    variance = power.sum(axis=0) * (frequency[1] - frequency[0])
    np.testing.assert_allclose(variance, 9.0, rtol=0.05)


def test_power_spectrum_finds_the_line_of_a_sine():
    time = 0.01 * np.arange(4000)
    frequency, power = power_spectra([Record([[]] * 4000, np.sin(2 * np.pi * 12.5 * time), 0.01)])
    assert abs(frequency[np.argmax(power[:, 0])] - 12.5) <= frequency[1] / 2 + 1e-12


@pytest.mark.parametrize("measure", ["overlap", "repeatability"])
def test_stabilisation_diagram_draws_every_pole_in_its_class(identification, measure):
    classes = {"overlap": OVERLAP_CLASSES, "repeatability": REPEATABILITY_CLASSES}[measure]
    evidence = identification.order_evidence
    if measure == "repeatability":
        again = np.linspace(0.0, 1.0, len(evidence.stabilisation)).tolist()
        points = tuple(
            replace(point, repeatability=value) for point, value in zip(evidence.stabilisation, again, strict=True)
        )
        evidence = replace(evidence, stabilisation=points)
    figure = plots.stabilisation_diagram(evidence, identification.modes)
    drawn = {line.label: len(line.x) for line in figure.panels[0].lines}
    for low, high, word in classes:
        assert drawn[word] == sum(low <= getattr(point, measure) < high for point in evidence.stabilisation)


def test_pictures_of_empty_evidence_say_so(identification):
    empty = OrderEvidence(
        singular_values=np.array([]),
        order=2,
        gap_order=2,
        candidate_orders=np.array([]),
        candidate_fits=np.array([]),
        stabilisation=(),
    )
    for draw in (plots.singular_values, plots.order_fits):
        assert draw(empty).panels[0].words
    none = replace(identification.modes, modes=())
    plots.stabilisation_diagram(empty, none, measured=identification.records)


def test_missing_samples_do_not_break_the_histories(identification):
    record = identification.records[0]
    outputs = np.array(record.outputs)
    outputs[100:200, 0] = np.nan
    gappy = replace(record, outputs=outputs)
    figure = plots.measured_against_simulated(gappy, identification.simulated[0])
    assert np.isnan(figure.panels[0].lines[0].y).any()
    plots.output_spectra([gappy], identification.simulated)


@pytest.mark.parametrize(("count", "labels"), [(3, 3), (30, 4)])
def test_crowded_modes_have_labels_on_few_lines(identification, count, labels):
    modes = tuple(replace(identification.modes.modes[0], frequency=5.0 + 0.001 * i) for i in range(count))
    crowd = replace(identification.modes, modes=modes)
    figure = plots.stabilisation_diagram(identification.order_evidence, crowd)
    assert len(figure.panels[0].words) == labels


def test_a_response_is_pale_where_the_coherence_is_low_and_the_strip_shows_it(identification):
    measured = measured_frf(identification.records)
    coherence = np.full_like(measured.multiple_coherence, 0.9)
    coherence[: coherence.shape[0] // 2] = 0.1
    figure = plots.response_chart(replace(measured, multiple_coherence=coherence), identification.realisation)
    above, strip = figure.rows[0][0], figure.rows[1][0]
    trusted = next(line for line in above.lines if line.label == "measured")
    hidden = np.isnan(trusted.y)
    np.testing.assert_array_equal(hidden, coherence[1:, 0] < 0.5)
    np.testing.assert_array_equal(strip.lines[0].y, coherence[1:, 0])
