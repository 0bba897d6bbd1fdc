"""Modes from frequency responses: exact on exact tables, honest on measured ones, and all the way to the report."""

import dataclasses

import numpy as np
import pytest
import scipy.signal
from response_tables import averaged, distorted_chain, drawn_structure, held_response, table_of
from typer.testing import CliRunner

import modal
import okid
from modal.command.main import app
from modal.examples.demo import compare_with_truth, demo_record, demo_truth
from modal.identification import response_road
from modal.modes.mode import Mode
from modal.verdict.judgement import told_by_dips
from okid.errors import InvalidDataError
from okid.frequency_response import FrequencyResponse, estimate_response
from okid.readers.response import read_response
from okid.readers.uff import write_response

DT = 0.01
FREQUENCIES = np.array([5.0, 12.0, 20.0, 33.0])
DAMPING = np.array([0.002, 0.01, 0.005, 0.015])


def exact_table(n_samples=512, first=0):
    rng = np.random.default_rng(3)
    w = 2 * np.pi * FREQUENCIES
    poles = np.exp(DT * (-DAMPING * w + 1j * w * np.sqrt(1 - DAMPING**2)))
    residues = np.einsum(
        "rq,ri->rqi", *(rng.standard_normal((4, k)) + 1j * rng.standard_normal((4, k)) for k in (3, 2))
    )
    z = np.exp(2j * np.pi * np.arange(n_samples // 2 + 1) / n_samples)[:, None, None]
    lines = sum(r / (z - p) + r.conj() / (z - p.conj()) for r, p in zip(residues, poles, strict=True))
    grid = np.arange(z.size) / (n_samples * DT)
    return FrequencyResponse(
        lines[first:] + rng.standard_normal((3, 2)), grid[first:], window="periodic", output_units=["m"] * 3
    )


@pytest.fixture(scope="module")
def identified():
    return modal.identify(exact_table())


def test_exact_responses_give_exact_modes(identified):
    found = identified.modes.system
    np.testing.assert_allclose([mode.frequency for mode in found], FREQUENCIES, rtol=1e-10)
    np.testing.assert_allclose([mode.damping_ratio for mode in found], DAMPING, rtol=1e-10)
    again = modal.frequency_response(identified)
    table = exact_table()
    np.testing.assert_allclose(again.response, table.response, atol=1e-9 * np.abs(table.response).max())
    assert identified.records == ()
    assert identified.observer is None
    assert identified.source is identified.response
    assert identified.record_kind == "response"
    assert not identified.warnings


def test_force_over_motion_is_told_as_what_it_is():
    """Its poles are antiresonances of the free structure: right, but not what is usually asked for."""
    table = exact_table()
    held = dataclasses.replace(table, output_units=("N",) * 3, input_units=("m/s^2",) * 2)
    assert any("force over motion" in words for words in modal.identify(held, order=8).warnings)


def test_motions_are_powers_of_the_angular_frequency(identified):
    lines = np.array([0.0, 2.0, 7.0])
    position = modal.frequency_response(identified, lines)
    speed = modal.frequency_response(identified, lines, motion="velocity")
    np.testing.assert_allclose(speed.response, (2j * np.pi * lines)[:, None, None] * position.response)
    assert speed.output_units == ("m/s",) * 3
    with pytest.raises(InvalidDataError, match="half the sampling frequency"):
        modal.frequency_response(identified, [51.0])


def test_a_table_above_zero_and_one_off_the_grid_are_fitted_in_frequency():
    table = exact_table(first=18)  # from 3.5 Hz, below all modes
    found = modal.identify(table, order=8).modes
    np.testing.assert_allclose([mode.frequency for mode in found], FREQUENCIES, rtol=1e-6)
    exact = exact_table(1024)
    kept = np.flatnonzero(np.arange(exact.n_lines) % 7 != 3)
    uneven = FrequencyResponse(exact.response[kept], exact.frequencies[kept], window="periodic")
    found = modal.identify(uneven, order=8).modes
    np.testing.assert_allclose([mode.damping_ratio for mode in found], DAMPING, rtol=1e-6)


def given(test, *, outputs, window="hann"):
    """The table of a test with these outputs alone."""
    known = {"coherence": test.coherence[:, outputs], "n_averages": test.n_averages, "window": window}
    return FrequencyResponse(test.response[:, outputs], test.frequencies, **known)


EVEN, ODD = [0, 2, 4], [1, 3, 5]


@pytest.mark.parametrize("window", ["hann", "unknown"])
def test_damping_is_not_that_of_the_window(window):
    test = table_of(7, window="hann", n_samples=512)
    result = modal.identify(given(test, outputs=EVEN, window=window), order=10)
    found = result.modes.system
    assert len(found) == 5
    for mode, f, d in zip(found, test.true_frequencies, test.true_damping, strict=True):
        assert abs(mode.frequency - f) < 5 * mode.frequency_std
        assert abs(mode.damping_ratio - d) < 5 * mode.damping_ratio_std < d
    assert any("window of the blocks is not stated" in text for text in result.warnings) == (window == "unknown")


def test_lines_left_out_of_a_table_leave_its_window():
    """Every resonance had become two modes, with up to five times its damping."""
    test = table_of(7, window="hann", n_samples=512)
    kept = np.random.default_rng(1).random(len(test.frequencies)) < 0.6
    whole = given(test, outputs=EVEN)
    known = {"coherence": whole.coherence[kept], "n_averages": test.n_averages, "window": "hann"}
    result = modal.identify(FrequencyResponse(whole.response[kept], test.frequencies[kept], **known), order=10)
    assert result.response.n_lines == kept.sum()
    assert not result.warnings
    assert len(result.modes.system) == 5
    for mode, f, d in zip(result.modes.system, test.true_frequencies, test.true_damping, strict=True):
        assert abs(mode.frequency - f) < 4 * mode.frequency_std
        assert abs(mode.damping_ratio - d) < 4 * mode.damping_ratio_std


def interpolated(window):
    """Lines on no grid, from those of Hann windows."""
    test = table_of(7, window="hann", n_samples=512)
    grid = np.geomspace(2.0, 49.0, 300)
    lines = [np.interp(grid, test.frequencies, one) for one in test.response[:, EVEN].reshape(-1, 6).T]
    return FrequencyResponse(np.array(lines).T.reshape(300, 3, 2), grid, window=window)


def test_what_a_window_did_to_lines_on_no_grid_is_not_certain():
    """Seven modes of 0.7 to 2.8 % damping were certain where five of 0.2 to 0.4 % are."""
    result = modal.identify(interpolated("hann"), order=22)
    assert any("Export the lines as they were averaged" in words for words in result.warnings)
    assert not result.modes.system
    assert not any(mode.damping_resolved for mode in result.modes if "that of a hann window" in mode.reason)
    unknown = modal.identify(interpolated("unknown"), order=10)
    assert any("stepped" in words for words in unknown.warnings)


@pytest.mark.parametrize("tried", [("hann", "periodic"), pytest.param(response_road.TRIED, marks=pytest.mark.slow)])
def test_dips_of_the_force_are_no_window(tried, monkeypatch):
    """Where none was stated, whole periods were the most likely, and damping was certain at three times the truth."""
    monkeypatch.setattr(response_road, "TRIED", tried)
    test = table_of(3, n_samples=512, length=16384, kind="shaker")
    result = modal.identify(FrequencyResponse(test.response[:, [1, 3]], test.frequencies))
    assert next(choice.value for choice in result.choices if choice.what == "window") == "hann"
    assert len(result.modes.system) >= 2
    for mode in result.modes.system:
        nearest = np.abs(test.true_frequencies - mode.frequency).argmin()
        assert abs(mode.damping_ratio / test.true_damping[nearest] - 1) < 0.3


def identified_chain(seed, order="auto", **distortion):
    return modal.identify(given(distorted_chain(seed, **distortion), outputs=range(3)), order=order)


@pytest.mark.parametrize(
    ("seed", "distortion"),
    [
        pytest.param(2, {"cubic": 0.03, "n_samples": 1024}, marks=pytest.mark.slow),
        (2, {"cubic": 0.03, "order": 8}),
        (1, {"friction": 0.1, "order": 10}),
        (3, {"order": 8}),
    ],
)
def test_a_structure_that_is_not_linear_is_told_by_its_coherence(seed, distortion):
    """Without a word, a cubic spring made a fourth mode of three, p 0.98; in short blocks one far below the first."""
    result = identified_chain(seed, **{"n_samples": 512, **distortion})
    said = [words for words in result.warnings if "what does not follow the inputs" in words]
    assert len(said) == bool({"cubic", "friction"} & distortion.keys())
    assert all("not linear" in words for words in said)
    assert len(result.modes.system) <= 3


def stepped_sine(cubic, friction, *, n_lines=250, noise=0.003):
    """Two modes under a constant force, a spring and a joint at the first point by their describing functions."""
    frequencies, damping = np.array([9.0, 14.0]), np.array([0.005, 0.01])
    shapes = np.array([[1.0, 0.4], [-0.6, 1.0], [0.3, 0.8]])
    w = 2 * np.pi * frequencies
    grid = np.linspace(4.0, 20.0, n_lines)
    receptance = [shapes @ np.diag(1 / (w**2 - x**2 + 2j * damping * w * x)) @ shapes.T for x in 2 * np.pi * grid]
    largest = max(abs(one[0, 1]) for one in receptance)
    table, motion = np.empty((n_lines, 3), dtype=complex), 0j
    for line, one in enumerate(receptance):
        for _ in range(300):
            size = abs(motion) / largest
            stiffness = w[0] ** 2 * (cubic * size**2 + 1j * friction / max(size, 0.02))
            motion += 0.3 * (one[0, 1] / (1 + stiffness * one[0, 0]) - motion)
        table[line] = one[:, 1] - one[:, 0] * stiffness * motion
    rng = np.random.default_rng(8)
    spread = noise * np.sqrt((np.abs(table) ** 2).mean(axis=0) / 2)
    return FrequencyResponse(table + spread * (rng.standard_normal((n_lines, 3, 2)) @ [1, 1j]), grid, window="periodic")


@pytest.mark.parametrize(("cubic", "friction", "order"), [(0.02, 0.0, 8), (0.0, 0.003, 12), (0.0, 0.0, "auto")])
def test_a_resonance_that_depends_on_its_level_is_told_by_what_is_left_of_it(cubic, friction, order):
    result = modal.identify(stepped_sine(cubic, friction), order=order)
    assert any("runs on from line to line" in words for words in result.warnings) == (cubic + friction > 0)
    assert len(result.modes.system) == 2


@pytest.mark.parametrize("blocks", [{"n_samples": 512, "length": 16384}, pytest.param({}, marks=pytest.mark.slow)])
def test_several_shakers_whose_forces_dip_make_nothing_certain(blocks):
    """Dampings of 0.00 and +48 %, ten deviations off, were certain; so was a mode that does not exist."""
    test = table_of(31, kind="shakers", **blocks)
    result = modal.identify(given(test, outputs=EVEN), order=12)
    assert any("the measured forces fall there" in words for words in result.warnings)
    for mode in result.modes.system:
        nearest = np.abs(test.true_frequencies - mode.frequency).argmin()
        assert abs(mode.frequency - test.true_frequencies[nearest]) < 4 * mode.frequency_std
        assert abs(mode.damping_ratio - test.true_damping[nearest]) < 4 * mode.damping_ratio_std


def identified_shaker(seed, rounding=0.0):
    test = table_of(seed, window="hann", n_samples=1024, kind="shaker")
    rounded = 1 + rounding * np.random.default_rng(seed).standard_normal(test.response.shape)
    known = {"coherence": test.coherence, "n_averages": test.n_averages, "window": "hann"}
    return test, modal.identify(FrequencyResponse(test.response * rounded, test.frequencies, **known))


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "rounding"), [(341, 1e-12), (341, 0.0), (342, 0.0)])
def test_a_force_that_dips_at_resonances_widens_the_intervals(seed, rounding):
    """Deviations of a force that is white over a resonance are up to twenty times too small.

    Of tables that differ by rounding one had kept one mode of five.
    """
    test, result = identified_shaker(seed, rounding)
    assert any("force dips at the resonances" in text for text in result.warnings)
    pairs = [
        (min(result.modes, key=lambda mode: abs(mode.frequency - f)), f, d)
        for f, d in zip(test.true_frequencies, test.true_damping, strict=True)
    ]
    near = [(mode, f, d) for mode, f, d in pairs if abs(mode.frequency - f) < 0.005 * f and mode.verdict != "noise"]
    assert len(near) >= 3
    assert all(mode.frequency_std > 0 for mode in result.modes)
    for mode, f, d in near:
        assert abs(mode.frequency - f) < 4 * mode.frequency_std < 0.05 * f
        assert abs(mode.damping_ratio - d) < 4 * mode.damping_ratio_std


@pytest.mark.slow
def test_a_force_that_dips_leaves_the_damping_of_every_mode():
    """The weakest mode had lost all its damping, and another was noise because its order was realised low."""
    test, result = identified_shaker(30003)
    assert len(result.modes.system) == 5
    for mode, d in zip(result.modes.system, test.true_damping, strict=True):
        assert abs(mode.damping_ratio / d - 1) < 0.12


def test_every_mode_under_a_force_that_dips_is_certain_and_its_intervals_hold():
    """The two above in short blocks of three outputs: of a white force deviations are up to nine times too small."""
    test = table_of(30003, n_samples=512, length=16384, kind="shaker")
    result = modal.identify(given(test, outputs=ODD))
    assert any("force dips at the resonances" in text for text in result.warnings)
    assert all(mode.frequency_std > 0 for mode in result.modes)
    for mode, f, d in zip(result.modes.system, test.true_frequencies, test.true_damping, strict=True):
        assert abs(mode.frequency - f) < 4 * mode.frequency_std < 0.05 * f
        assert abs(mode.damping_ratio - d) < 4 * mode.damping_ratio_std


def test_what_reruns_without_dips_lose_is_doubtful_where_its_place_is_known():
    """A true mode at 14.56 Hz, known to 0.006 Hz, was noise: no rerun found it beside the dips of stronger ones."""
    known, unknown, sure = (
        Mode(pole=-0.4 + 91j, kind="oscillatory", frequency=14.56, damping_ratio=0.005, shape=np.ones(1),
             participation=np.ones(1), frequency_std=std, probability=p, verdict=verdict)
        for std, p, verdict in ((0.006, 0.0, "noise"), (1.9, 0.0, "noise"), (0.006, 1.0, "system"))
    )  # fmt: skip
    told = told_by_dips(modal.ModalModel(modes=(known, unknown, sure), dt=0.01, indicator_caution=0.1))
    assert [mode.verdict for mode in told] == ["doubtful", "noise", "system"]
    assert "dips of the force" in told.modes[0].reason
    assert told.modes[2] is sure


def test_a_white_force_has_no_dips():
    f, damping, shapes = drawn_structure(np.random.default_rng(59), 100.0)
    rng = np.random.default_rng(60)
    force = rng.standard_normal((32768, 1))
    outputs = held_response(force, f, damping, shapes, shapes[:1], dt=0.01)[:, :3]
    outputs += 0.05 * outputs.std(axis=0) * rng.standard_normal(outputs.shape)
    response, coherence, n_averages = averaged(force, outputs, "hann", 512)
    grid = np.arange(257) * 100.0 / 512
    known = {"window": "hann", "coherence": coherence, "n_averages": n_averages}
    result = modal.identify(FrequencyResponse(response, grid, **known), order=12)
    assert not result.warnings
    assert all(mode.frequency_std < 1e-3 * mode.frequency for mode in result.modes.system)
    assert len(result.modes.system) >= 4


def test_the_low_pass_of_an_analyser_is_no_mode():
    """Its two poles of 71 % damping, one for each reference, were called modes of the system."""
    test = table_of(40000, window="hann", n_samples=512)
    _, filtered = scipy.signal.freqs(*scipy.signal.butter(2, 2 * np.pi * 25, analog=True), 2 * np.pi * test.frequencies)
    known = {"coherence": test.coherence[:, EVEN], "n_averages": test.n_averages, "window": "hann"}
    seen = test.response[:, EVEN] * filtered[:, None, None]
    modes = modal.identify(FrequencyResponse(seen, test.frequencies, **known), order=16).modes
    broad = [mode for mode in modes if mode.damping_ratio > 0.5 and mode.verdict != "noise"]
    assert broad
    assert all(mode.verdict == "doubtful" and "modes beyond the lines answer so" in mode.reason for mode in broad)
    assert all(mode.probability <= 0.55 for mode in broad)
    np.testing.assert_allclose([mode.frequency for mode in modes.system], test.true_frequencies, rtol=2e-3)


@pytest.mark.slow
def test_no_deviation_is_zero():
    """The covariance of joined lines comes from a model of the leakage, and may have negative parts."""
    _, result = identified_shaker(310)
    assert all(mode.frequency_std > 0 for mode in result.modes)


def test_the_demo_comes_back_from_its_responses_in_a_file(tmp_path):
    record = demo_record(np.random.default_rng(5), n_samples=10_000)
    path = write_response(estimate_response(record, n_samples=1024), tmp_path / "frf.uff")
    result = CliRunner().invoke(app, ["run", str(path), "-o", str(tmp_path / "report"), "--order", "12"])
    assert result.exit_code == 0, result.output
    kept = modal.load(tmp_path / "report" / "result.npz")
    np.testing.assert_array_equal(kept.source.response, read_response(path).response)
    for row in compare_with_truth(demo_truth(), kept.modes):
        assert row.verdict == "system"
        assert abs(row.found_frequency / row.frequency - 1) < 2e-3
        assert row.assurance > 0.99
    page = (tmp_path / "report" / "report.html").read_text(encoding="utf-8")
    assert "as they were given" in page
    assert "frequency responses" in (tmp_path / "report" / "report.md").read_text(encoding="utf-8")
    assert modal.read_result(tmp_path / "report").n_samples == (513,)


def about_one_mode(n_lines, *, relative=0.0):
    """So many lines about 20 Hz, the one mode of 1 % damping of three outputs, and noise."""
    rng = np.random.default_rng(n_lines)
    lines = (np.arange(n_lines) - n_lines // 2 + 102) / 5.12
    pole, z = np.exp(DT * 40 * np.pi * (-0.01 + 1j * np.sqrt(1 - 1e-4))), np.exp(2j * np.pi * lines * DT)
    response = (1j / (z - pole) - 1j / (z - pole.conj()))[:, None] * [1.0, -0.6, 0.3]
    noise = rng.standard_normal(response.shape) + 1j * rng.standard_normal(response.shape)
    return FrequencyResponse(response + relative * np.abs(response).mean() * noise, lines, window="periodic")


@pytest.mark.parametrize("n_lines", [4, 5, 6, 12])
def test_a_few_lines_are_not_given_as_many_numbers_as_they_hold(n_lines):
    """A model of as many numbers left nothing: a wrong mode was certain, with a deviation of a rounding error."""
    (exact,) = modal.identify(about_one_mode(n_lines)).modes.system
    assert abs(exact.frequency - 20) < 1e-3
    (noisy,) = modal.identify(about_one_mode(n_lines, relative=0.01)).modes.system
    assert 1e-4 < noisy.frequency_std < 0.1
    assert abs(noisy.frequency - 20) < 4 * noisy.frequency_std


@pytest.mark.parametrize("n_lines", [2, 3])
def test_too_few_lines_for_a_model_are_refused_in_a_sentence(n_lines):
    table = FrequencyResponse(exact_table().response[:n_lines, :1, :1], np.arange(n_lines) / 5.12)
    with pytest.raises(okid.InsufficientDataError, match="give more lines"):
        modal.identify(table)


def test_a_conjugated_table_is_turned_round():
    """Damping of 0.00 % was that of certain modes, and the structure said to be not linear."""
    table = exact_table()
    turned = FrequencyResponse(table.response.conj(), table.frequencies, window="periodic")
    result = modal.identify(turned, order=8)
    np.testing.assert_allclose([mode.frequency for mode in result.modes.system], FREQUENCIES, rtol=1e-10)
    assert ["exp(-2 pi j f t)" in text for text in result.warnings] == [True]


def test_a_coherence_of_chance_is_named_as_what_leaves_no_lines():
    table = exact_table()
    none = np.full((table.n_lines, 3), 0.005)
    known = {"coherence": none, "n_averages": 100, "window": "hann"}
    with pytest.raises(okid.InsufficientDataError, match="coherence is no greater than chance gives at"):
        modal.identify(FrequencyResponse(table.response, table.frequencies, **known))


def test_an_output_that_is_dead_says_nothing_against_the_modes():
    """Its fit of 0 made every mode doubtful, the model explaining nothing."""
    table = exact_table()
    response = np.concatenate([table.response, np.zeros((table.n_lines, 1, 2))], axis=1)
    result = modal.identify(FrequencyResponse(response, table.frequencies, window="periodic"), order=8)
    np.testing.assert_allclose([mode.frequency for mode in result.modes.system], FREQUENCIES, rtol=1e-10)
    assert any("'output_3' are 0 at every line" in text for text in result.warnings)
    assert result.modes.output_names == ("output_0", "output_1", "output_2")


def test_what_is_for_records_alone_is_refused():
    with pytest.raises(InvalidDataError, match="is for records in time"):
        modal.identify(exact_table(), kind="driven")


def plate_table(seed, *, relative=0.01, last=300.0):
    """Accelerances as an analyser prints them: exact in continuous time, modes beyond the lines, noise like them."""
    rng = np.random.default_rng(seed)
    f = np.array([62.0, 118.0, 197.0, 200.0, 241.0, 730.0, 950.0])
    zeta = np.array([0.01, 0.004, 0.003, 0.004, 0.02, 0.01, 0.01])
    shapes = np.sin(np.outer([1.1, 2.0, 2.9, 3.7], np.arange(1, 8)) + np.arange(7))
    lines = np.arange(50, 2 * last + 1) / 2
    s, w = 2j * np.pi * lines[:, None, None], 2 * np.pi * f
    response = (s**2 / (s**2 + 2 * zeta * w * s + w**2) * shapes * shapes[0]).sum(axis=2)
    noise = rng.standard_normal(response.shape) + 1j * rng.standard_normal(response.shape)
    return response * (1 + relative / np.sqrt(2) * noise), lines, f[:5], zeta[:5]


def test_a_table_of_motion_between_samples_with_noise_like_itself_gives_its_damping():
    """Such noise made a window that leaks the likeliest, and modes beyond the lines poles near the last one."""
    response, lines, f, zeta = plate_table(4)
    table = FrequencyResponse(response, lines, output_units=["m/s^2"] * 4, input_units=["N"])
    result = modal.identify(table, order=14)
    assert next(one.value for one in result.choices if one.what == "window") == "periodic"
    found = result.modes.system
    assert len(found) == 5
    for mode, true, damping in zip(found, f, zeta, strict=True):
        assert abs(mode.frequency - true) < 3.5 * mode.frequency_std < 1e-3 * true
        assert abs(mode.damping_ratio - damping) < 3.5 * mode.damping_ratio_std < 0.05 * damping
    beyond = [mode for mode in result.modes if mode.frequency > 320.0]
    assert beyond
    assert all(mode.verdict == "noise" and "outside the lines" in mode.reason for mode in beyond)


def test_a_driving_point_in_a_table_gives_modal_mass():
    """A result of responses had no channels at its modes, so that the force was said to be missing."""
    response, lines, *_ = plate_table(5, relative=1e-3)
    table = FrequencyResponse(response, lines, window="periodic", output_units=["m/s^2"] * 4, input_units=["N"])
    result = modal.identify(table, order=14)
    assert result.modes.input_names == ("input_0",)
    shapes = np.sin(np.outer([1.1, 2.0, 2.9, 3.7], np.arange(1, 8)) + np.arange(7))[:, :5]
    scaled = modal.normalise_shapes(result.modes, driving_point=("output_0", "input_0"))
    # mass-normalised shapes in; where the largest component is 1, a mode's mass is one over its square
    np.testing.assert_allclose(scaled.modal_mass[:5], 1 / np.abs(shapes).max(axis=0) ** 2, rtol=5e-3)


def test_a_peak_beyond_the_last_line_is_not_certain():
    """Three modes in the lines, and one whose broad flank alone reaches into them."""
    rng, lines = np.random.default_rng(1), np.arange(1, 401) * 0.125
    s = 2j * np.pi * lines[:, np.newaxis]
    response = np.zeros((lines.size, 3), dtype=complex)
    for frequency, damping, size in ((8.0, 0.01, 1.0), (17.0, 0.012, 1.0), (31.0, 0.008, 1.0), (72.0, 0.42, 6.0)):
        w = 2 * np.pi * frequency
        response += size * w**2 * rng.standard_normal(3) / (s**2 + 2 * damping * w * s + w**2)
    noise = rng.standard_normal((2, *response.shape))
    response += 0.01 * np.median(np.abs(response)) * (noise[0] + 1j * noise[1])
    table = FrequencyResponse(response[:, :, np.newaxis], lines, window="periodic")
    modes = modal.identify(table, order=8).modes
    assert [mode.frequency for mode in modes.system] == pytest.approx([8.0, 17.0, 31.0], rel=1e-3)
    (beyond,) = [mode for mode in modes.modes if mode.frequency > 50.0 and mode.verdict == "doubtful"]
    assert "its peak lies outside the lines" in beyond.reason
    for nothing in (1.0, np.nan):  # the coherence of one average, and that of an empty column
        coherence = np.full(table.response.shape, nothing)
        again = modal.identify(
            FrequencyResponse(table.response, lines, window="periodic", coherence=coherence, n_averages=30), order=8
        )
        assert [mode.frequency for mode in again.modes.system] == [mode.frequency for mode in modes.system]
        assert not again.warnings


def test_a_window_that_takes_more_poles_must_be_likelier_by_what_they_cost(monkeypatch):
    """Exact lines of the demo were taken for uniform blocks: two poles more beat the right model by 3 in ln L."""
    search = response_road._search

    def searched(response, window, _order, _finer=1):
        found = search(response, "periodic", 4 if window == "uniform" else 2)
        table = dataclasses.replace(found.table, window=window)
        return dataclasses.replace(found, table=table, likelihood=3.0 if window == "uniform" else 0.0)

    monkeypatch.setattr(response_road, "_search", searched)
    monkeypatch.setattr(response_road, "_under_dips", lambda found: found)
    unknown = dataclasses.replace(exact_table(64), window="unknown")
    chosen = {choice.what: choice.value for choice in modal.identify(unknown).choices}
    assert chosen["window"] != "uniform"


@pytest.mark.parametrize("seed", [0, 6])
def test_noise_of_sensors_under_an_exponential_window_is_no_mode(seed):
    """It dies out with the window, as a mode would: taken for independent lines it made up to seven certain modes."""
    f, n, tau = np.array([12.0, 31.0, 57.0]), 1024, 0.8
    time = np.arange(n) / 200
    pulse = np.exp(2 * np.pi * np.outer(time, f * (-0.01 + 1j * np.sqrt(1 - 0.01**2)))).imag.sum(axis=1)
    noise = 0.02 * np.random.default_rng(seed).standard_normal((8, n))
    blows = np.fft.rfft(np.exp(-time / tau) * (pulse + noise))
    mean, power = blows.mean(axis=0), np.square(np.abs(blows)).mean(axis=0)
    table = FrequencyResponse(
        mean,
        np.fft.rfftfreq(n, 1 / 200),
        coherence=(np.abs(mean) ** 2 / power)[:, np.newaxis],
        n_averages=8,
        window="exponential",
        window_time_constant=tau,
    )
    result = modal.identify(table)
    assert not any("runs on from line to line" in text for text in result.warnings)
    assert len(result.modes.system) == 3
    for mode, true in zip(result.modes.system, f, strict=True):
        assert abs(mode.frequency - true) < 4 * mode.frequency_std
        assert abs(mode.damping_ratio - 0.01) < 4 * mode.damping_ratio_std < 0.002


def faded():
    """Lines, responses of eight blows that move little above 80 Hz, frequencies and damping."""
    rng, f = np.random.default_rng(0), np.array([10.6, 37.0, 38.4, 71.0])
    damping, sizes = np.array([0.015, 0.019, 0.0125, 0.0155]), np.array([0.07, 1.0, 7.0, 7.0])
    lines = 0.125 * np.arange(921)
    s, w = 2j * np.pi * lines[:, np.newaxis], 2 * np.pi * f
    exact = (sizes * s**2 / (s**2 + 2 * damping * w * s + w**2)).sum(axis=1)
    deviation = 0.1 * np.exp(0.15 * np.maximum(lines - 80, 0))
    each = exact + 2 * deviation * (rng.standard_normal((8, 921)) + 1j * rng.standard_normal((8, 921)))
    return lines, each, f, damping


@pytest.mark.parametrize("averaged_blows", [True, False], ids=["coherence", "no coherence"])
def test_a_mode_below_the_noise_of_other_lines_is_found_and_spoils_no_other(averaged_blows):
    """No realisation held the first mode; without coherence the second was merged with the third, 18 deviations off."""
    lines, each, f, damping = faded()
    mean = each.mean(axis=0)
    coherence = np.abs(mean) ** 2 / np.square(np.abs(each)).mean(axis=0)
    stated = {"coherence": coherence[:, np.newaxis], "n_averages": 8} if averaged_blows else {}
    result = modal.identify(FrequencyResponse(mean, lines, window="periodic", **stated))
    assert len(result.modes.system) == 4
    for mode, true, of_true in zip(result.modes.system, f, damping, strict=True):
        assert abs(mode.frequency - true) < 4 * mode.frequency_std
        assert abs(mode.damping_ratio - of_true) < 4 * mode.damping_ratio_std < of_true / 4
    assert not any("scatter about the model" in text for text in result.warnings)
