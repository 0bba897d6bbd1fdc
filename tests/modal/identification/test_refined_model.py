"""The refined model as a state-space model: same pulse responses as its last step, factors kept, units, weights."""

from dataclasses import replace

import numpy as np
import pytest
from systems import initial_state, markov, modal_system, simulate, three_modes

from era.balanced import realise
from era.kalman import check_innovations
from era.realisation import Realisation
from modal.estimation.cross_validation import scaled_model, scaled_record
from modal.estimation.free_run import filled
from modal.estimation.modal_parameters import starting_parameters
from modal.estimation.modal_states import blocks_of
from modal.estimation.output_error import OutputError, refine
from modal.identification.covariance import judged_deviations, output_error_uncertainty
from modal.identification.order_search import MOST_STEPS
from modal.identification.pipeline import identify
from modal.identification.refined_search import refined_model
from modal.modes.extraction import extract_modes
from modal.modes.response_synthesis import continuous_residue
from okid.markov import MarkovParameters, recover_markov
from okid.observer import fit_observer
from okid.record import Record
from okid.scaling import channel_scaling


def records_of(rng, truth, lengths, *, noise=0.05):
    """Noise as a share of each output, one number or one an output."""
    records = []
    for n in lengths:
        u = rng.standard_normal((n, truth.n_inputs))
        y = simulate(truth, u, initial_state=initial_state(rng, truth, u))
        records.append(Record(u, y + noise * y.std(axis=0) * rng.standard_normal(y.shape), truth.dt))
    return records


def from_era(records, order, *, observer_order=30):
    observer = fit_observer(records, order=observer_order, ridge=1e-4)
    return realise(recover_markov(observer, n_lags=120), order=order)


def exact(truth):
    return Realisation(truth.A, truth.B, truth.C, truth.D, truth.dt)


def pulses(model, n_lags=80):
    """(n_lags + 1, n_outputs, n_inputs) of A, B, C, D, one power after the other."""
    found, columns = [model.D], model.B
    for _ in range(n_lags):
        found.append(model.C @ columns)
        columns = model.A @ columns
    return np.array(found)


def pulses_of_step(model, n_lags=80):
    """The same of poles, participations and shapes of the last step, in the units of the records."""
    step, scaling = model.step, model.scaling
    n, m = step.layout.n_poles, step.layout.n_inputs
    found = [step.linear.coefficients[2 * n : 2 * n + m].T]
    c, b = step.linear.shapes, step.parameters.inputs
    found += [((c * step.parameters.poles**k) @ b).real for k in range(n_lags)]
    return np.array(found) * scaling.output_scale[:, np.newaxis] / scaling.input_scale


@pytest.mark.parametrize("real_poles", [(), (-6.0,)])
@pytest.mark.parametrize("factors", ["kept", "none"])
def test_the_realisation_is_what_the_last_step_says(real_poles, factors):
    rng, truth = three_modes(1, real_poles=real_poles)
    records = records_of(rng, truth, (900, 500))
    start = from_era(records, truth.order) if factors == "kept" else exact(truth)
    found = refined_model(records, start, MOST_STEPS)
    assert found.realisation.order == start.order
    assert (found.realisation.factors is None) == (factors == "none")
    expected = pulses_of_step(found)
    np.testing.assert_allclose(pulses(found.realisation), expected, rtol=0, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("seed", [0, 1])
def test_it_comes_nearer_to_the_truth_and_its_indicators_stay(seed):
    rng, truth = three_modes(seed)
    records = records_of(rng, truth, (2500,), noise=0.1)
    start = from_era(records, truth.order)
    found = refined_model(records, start, MOST_STEPS).realisation
    expected = markov(truth, 80)
    left = [np.linalg.norm(pulses(model) - expected) for model in (start, found)]
    assert left[1] < 0.9 * left[0]
    modes = sorted(extract_modes(found).modes, key=lambda mode: mode.frequency)
    np.testing.assert_allclose([mode.frequency for mode in modes], truth.frequencies, rtol=2e-3)
    assert min(mode.emac for mode in modes) > 0.8
    assert np.all(np.isfinite([mode.amplitude_coherence for mode in modes]))
    # they compare the model with the data, and so are not 1 by construction
    assert max(mode.emac for mode in modes) < 1 - 1e-6


def test_indicators_stay_where_the_factors_have_another_scale():
    """Factors of an impulse test, whose channels are scaled by their pulses, and records in quite other units."""
    rng, truth = three_modes(12)
    out = np.array([1.0, 1e4, 1e-3])[:, np.newaxis]
    start = realise(MarkovParameters(system=markov(truth, 120) * out, dt=truth.dt), order=truth.order)
    records = [Record(r.inputs, r.outputs * out[:, 0], r.dt) for r in records_of(rng, truth, (1500,), noise=0.01)]
    found = refined_model(records, start, MOST_STEPS)
    assert np.ptp(np.log(found.scaling.output_scale / found.realisation.factors.output_scale)) > 0.1
    assert min(mode.emac for mode in extract_modes(found.realisation).modes) > 0.98


def test_a_wrong_model_has_low_indicators():
    """Factors of the data beside a model of something else: EMAC must tell."""
    rng, truth = three_modes(3)
    records = records_of(rng, truth, (1500,))
    start = from_era(records, truth.order)
    found = refined_model(records, start, MOST_STEPS).realisation
    slower = replace(found, A=0.8 * found.A)
    assert max(mode.emac for mode in extract_modes(slower).modes) < 0.2


def test_each_output_is_weighted_by_its_noise_where_it_is_white():
    rng, truth = three_modes(4)
    shares = np.array([0.05, 0.1, 0.15])
    records = records_of(rng, truth, (2500,), noise=shares)
    found = refined_model(records, exact(truth), MOST_STEPS)
    assert found.leaves_white_noise
    np.testing.assert_allclose(np.diag(found.weights), (shares.max() / shares) ** 2, rtol=0.2)
    early = refined_model(records, exact(truth), MOST_STEPS - 1)
    np.testing.assert_array_equal(early.weights, np.eye(truth.n_outputs))
    drifting = [
        replace(record, outputs=record.outputs + 0.1 * np.cumsum(rng.standard_normal(record.outputs.shape), axis=0))
        for record in records
    ]
    found = refined_model(drifting, exact(truth), MOST_STEPS)
    assert not found.leaves_white_noise
    np.testing.assert_array_equal(found.weights, np.eye(truth.n_outputs))


def test_as_many_steps_as_were_chosen():
    rng, truth = three_modes(5)
    records = records_of(rng, truth, (800,))
    scaling = channel_scaling(records)
    scaled = tuple(scaled_record(record, scaling) for record in filled(records))
    rows = (np.ones(800, dtype=bool),)
    data = OutputError(records=scaled, rows=rows, blocks=blocks_of(scaled, []))
    start = from_era(records, truth.order, observer_order=12)
    steps = refine(starting_parameters(scaled_model(start, scaling), data), data, n_steps=3)
    for n_steps in (1, 2, 3):
        found = refined_model(records, start, n_steps)
        np.testing.assert_allclose(found.step.parameters.poles, steps[n_steps].parameters.poles, rtol=1e-7)
    assert refined_model(records, start, 0) is None


def test_blocks_cover_all_rows_and_are_about_even():
    rng, truth = three_modes(6)
    for lengths in ((800,), (700, 120, 30), (60,) * 45):
        records = records_of(rng, truth, lengths)
        blocks = refined_model(records, exact(truth), 1).data.blocks
        for r, n in enumerate(lengths):
            own = [block for block in blocks if block.record == r]
            assert [block.first for block in own] == [0, *(block.last for block in own[:-1])]
            assert own[-1].last == n
        sizes = np.array([block.last - block.first for block in blocks])
        assert 0.9 * max(40, len(lengths)) <= len(blocks) <= max(42, len(lengths))
        assert np.median(np.abs(sizes - np.median(sizes))) <= 0.2 * np.median(sizes)


def test_units_and_offsets_do_not_matter():
    rng, truth = three_modes(7)
    records = records_of(rng, truth, (900,))
    first = refined_model(records, exact(truth), MOST_STEPS).realisation
    out, into = np.array([1e-7, 1.0, 1e9]), np.array([1e5, 1e-4])
    scaled = [Record(r.inputs * into + 3 * into, r.outputs * out + 50 * out, r.dt) for r in records]
    start = Realisation(truth.A, truth.B / into, truth.C * out[:, None], truth.D * out[:, None] / into, truth.dt)
    second = refined_model(scaled, start, MOST_STEPS).realisation
    expected = pulses(first)
    back = pulses(second) / out[:, np.newaxis] * into
    np.testing.assert_allclose(back, expected, rtol=0, atol=1e-5 * np.abs(expected).max())


def test_rows_with_a_gap_do_not_count():
    rng, truth = three_modes(8)
    (record,) = records_of(rng, truth, (1200,))
    outputs = record.outputs.copy()
    outputs[200:260, 1] = np.nan
    first = refined_model([replace(record, outputs=outputs)], exact(truth), MOST_STEPS)
    outputs[200:260] = np.nan
    second = refined_model([replace(record, outputs=outputs)], exact(truth), MOST_STEPS)
    assert not first.data.rows[0][200:260].any()
    poles = first.step.parameters.poles
    np.testing.assert_allclose(np.sort(poles), np.sort(second.step.parameters.poles), rtol=1e-4)
    nearest = np.abs(poles[:, np.newaxis] - truth.discrete_poles).argmin(axis=1)
    np.testing.assert_allclose(poles, truth.discrete_poles[nearest], rtol=5e-3)


def test_nothing_is_refined_where_nothing_is_left_or_nothing_runs():
    rng, truth = three_modes(9)
    records = records_of(rng, truth, (400,), noise=0.0)
    assert refined_model(records, exact(truth), MOST_STEPS) is None
    noisy = records_of(rng, truth, (400,))
    assert refined_model(noisy, replace(exact(truth), A=1.1 * truth.A), MOST_STEPS) is None


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("case", ["dead input", "input at rest in one record", "dead output", "tiny records", "spare"])
def test_hostile_records_end_in_a_stable_model(case):
    rng, truth = three_modes(10)
    records = records_of(rng, truth, (600, 400))
    start = exact(truth)
    if case == "dead input":
        records = [replace(r, inputs=r.inputs * [1.0, 0.0]) for r in records]
    elif case == "input at rest in one record":
        records = [records[0], replace(records[1], inputs=0 * records[1].inputs)]
    elif case == "dead output":
        records = [replace(r, outputs=r.outputs * [1.0, 0.0, 1.0]) for r in records]
    elif case == "tiny records":
        records = [records[0], *(records[1].samples(10 * i, 10 * i + 3) for i in range(12))]
    else:  # every pole twice, nearly
        twice = np.kron(np.diag([1.0, 1 - 1e-7]), truth.A)
        start = Realisation(twice, np.vstack([truth.B] * 2) / 2, np.hstack([truth.C] * 2), truth.D, truth.dt)
    found = refined_model(records, start, MOST_STEPS)
    assert np.all(np.abs(np.linalg.eigvals(found.realisation.A)) < 1)
    assert np.all(np.isfinite(pulses(found.realisation)))
    assert found.step.error <= np.inf


def test_an_identification_has_refined_modes_and_a_gain():
    rng, truth = three_modes(11, n_inputs=1, n_outputs=2)
    records = records_of(rng, truth, (1500,))
    found = identify(records, observer_order=30, ridge=1e-4, order=6)
    assert found.realisation.K is not None
    assert found.realisation.factors is not None
    assert found.uncertainty.method == "output error"
    plain = identify(records, observer_order=30, ridge=1e-4, order=6, refinement="none")
    assert plain.uncertainty.method == "propagation"
    errors = [np.abs(one.modes.frequencies / truth.frequencies - 1).max() for one in (found, plain)]
    assert errors[0] < errors[1]


def band_limited(rng, *, hold, noise=1e-3, n=4096, rate=256.0):
    """Accelerations of two modes under a force up to 0.45 of the rate, from the frequency response of time itself."""
    lines = np.fft.rfftfreq(n, 1.0 / rate)
    force = np.where(lines < 0.45 * rate, np.fft.rfft(rng.standard_normal(n)), 0.0)
    s = 2j * np.pi * lines
    shapes, poles = np.array([[1.0, 0.6], [0.7, -1.0]]), []
    motion, blocks = np.zeros((lines.size, 2), dtype=complex), []
    for f, zeta, shape in ((20.0, 0.01, shapes[0]), (62.0, 0.012, shapes[1])):
        w = 2 * np.pi * f
        motion += (force * s**2 / (s**2 + 2 * zeta * w * s + w**2))[:, np.newaxis] * shape * shape[0]
        pole = w * (-zeta + 1j * np.sqrt(1 - zeta**2))
        poles.append(pole)
        z = np.exp(1.01 * pole / rate)
        blocks.append([[z.real, z.imag], [-z.imag, z.real]])
    y = np.fft.irfft(motion, n, axis=0)
    y += noise * y.std(axis=0) * rng.standard_normal(y.shape)
    A = np.block([[np.array(blocks[0]), np.zeros((2, 2))], [np.zeros((2, 2)), np.array(blocks[1])]])
    C = np.column_stack([shapes[0], np.zeros(2), shapes[1], np.zeros(2)])
    start = Realisation(A, np.array([[1.0], [0.1], [1.0], [0.1]]), C, np.zeros((2, 1)), 1.0 / rate)
    residues = [shape[0] ** 2 * pole**2 / (2j * pole.imag) for shape, pole in zip(shapes, poles, strict=True)]
    return [Record(np.fft.irfft(force, n), y, 1.0 / rate, input_hold=hold)], start, residues


def test_what_a_measured_force_does_between_samples_is_no_part_of_the_residues():
    """Left in, it is made up for: the same record under a hold that it has not shows by how much."""
    errors = {}
    for hold in ("band_limited", "zero_order"):
        records, start, residues = band_limited(np.random.default_rng(5), hold=hold)
        modes = extract_modes(refined_model(records, start, MOST_STEPS).realisation)
        found = [continuous_residue(mode, modes.dt, hold="band_limited")[0, 0] for mode in modes]
        errors[hold] = np.abs(np.abs(np.array(found) / np.array(residues)) - 1.0)
    assert errors["band_limited"].max() < 4e-4
    assert errors["zero_order"].max() > 2.0 * errors["band_limited"].max()


def test_what_a_measured_force_does_between_samples_is_no_answer_that_the_model_leaves_over():
    """The test of what follows the inputs asks the data that the model was fitted to."""
    records, start, _ = band_limited(np.random.default_rng(5), hold="band_limited")
    model = refined_model(records, start, MOST_STEPS)
    without_gain = replace(model.realisation, K=np.zeros((model.realisation.order, 2)))
    came, asked = (check_innovations(without_gain, one) for one in (records, model.as_fitted(records)))
    assert asked.input_correlation_ratio < 1.5 < 0.1 * came.input_correlation_ratio


def unlike(rng, truth, sizes, *, roving=False):
    """A record a row of (n_records, n_outputs) noise sizes; roving, each driven by an input of its own."""
    records = []
    for number, size in enumerate(sizes):
        u = rng.standard_normal((500, truth.n_inputs))
        if roving:
            u[:, np.arange(truth.n_inputs) != number] = 0.0
        y = simulate(truth, u)
        records.append(Record(u, y + 0.02 * np.array(size) * rng.standard_normal(y.shape), truth.dt))
    return records


def test_records_that_share_some_outputs_are_compared_by_those():
    """Two loud ones and a quiet one share the first output; what only the loud ones measured is not loud for them."""
    rng, truth = three_modes(11)
    sizes = np.array([[10, 10, 10], [10, 10, 10], [1, 1, 1]])
    seen = np.array([[True, True, False], [True, True, False], [True, False, True]])
    records = unlike(rng, truth, sizes)
    measured = [np.tile(row, (record.n_samples, 1)) for row, record in zip(seen, records, strict=True)]
    model = refined_model(records, exact(truth), MOST_STEPS, measured=measured)
    np.testing.assert_allclose(model.record_scale[:2] / model.record_scale[2], 10.0, rtol=0.15)


@pytest.mark.parametrize("n_samples", [3, 4])
def test_a_stub_of_a_record_that_its_own_state_fits_does_not_outweigh_the_others(n_samples):
    """What is left of few rows, by a level and a state of their own, is no measure of their noise."""
    rng, truth = three_modes(11)
    whole = unlike(rng, truth, ((1, 1, 1),))
    stub = [replace(whole[0], inputs=whole[0].inputs[:n_samples], outputs=whole[0].outputs[:n_samples])]
    alone, together = (refined_model(those, exact(truth), MOST_STEPS) for those in (whole, whole + stub))
    assert together.record_scale[1] > 0.2 * together.record_scale[0]
    true = np.sort([mode.frequency for mode in extract_modes(exact(truth))])
    errors = [
        np.linalg.norm(np.array([mode.frequency for mode in extract_modes(model.realisation)]) / true - 1.0)
        for model in (alone, together)
    ]
    assert errors[1] < 1.5 * errors[0]


def test_a_stub_of_a_record_within_a_fold_hides_no_weak_mode_from_the_others():
    rng = np.random.default_rng(3)
    truth = modal_system(rng, frequencies=(3.0, 9.0), damping_ratios=(0.02, 0.01), n_inputs=1, n_outputs=1, dt=0.01)
    records = records_of(rng, truth, (60, 5, 2), noise=0.05)
    assert len(identify(records).records) == 3


def test_records_count_by_their_noise():
    """Two noisier records beside a quiet one do no harm: counted alike they make the error five times as large."""
    rng, truth = three_modes(11)
    true = np.sort([mode.frequency for mode in extract_modes(exact(truth))])
    alone, together = [], []
    for _ in range(12):
        records = unlike(rng, truth, ((1, 1, 1), (4, 4, 4), (16, 16, 16)))
        for those, errors in ((records[:1], alone), (records, together)):
            modes = extract_modes(refined_model(those, exact(truth), MOST_STEPS).realisation)
            errors.append(np.array([mode.frequency for mode in modes]) / true - 1.0)
    assert np.linalg.norm(together) < 1.2 * np.linalg.norm(alone)


def test_deviations_of_roving_inputs_are_those_of_the_noise_of_their_own_records():
    """What an input does is told by one record, whose outputs are each as noisy as they are there."""
    rng, truth = three_modes(11, n_inputs=3)

    def sizes_of(modes):
        largest = [int(np.abs(mode.shape).argmax()) for mode in modes]
        return np.array(
            [np.divide.outer(m.shape, m.participation) / m.shape[o] ** 2 for m, o in zip(modes, largest, strict=True)]
        )

    true = sizes_of(extract_modes(exact(truth)).modes)
    squares = []
    for _ in range(15):
        records = unlike(rng, truth, ((1, 1, 1), (1, 1, 1), (20, 20, 1)), roving=True)
        model = refined_model(records, exact(truth), MOST_STEPS)
        modes = extract_modes(model.realisation).modes
        known = output_error_uncertainty(replace(model, whiteness_ratio=1.0), modes, n_lags=1)
        squares.append(((sizes_of(modes) / true - 1.0).real / known.mass_std) ** 2)
    each = np.mean(squares, axis=(0, 1, 2))
    assert each == pytest.approx(np.ones(3), abs=0.5)


def test_noise_that_a_force_window_leaves_within_the_blow_widens_what_follows_from_the_force():
    rng, truth = three_modes(12, n_inputs=1)
    records = records_of(rng, truth, (800,), noise=0.02)
    model = refined_model(records, exact(truth), MOST_STEPS)
    modes = extract_modes(model.realisation).modes
    plain, *_ = judged_deviations(model, modes, n_lags=1, fed_back=False)
    noisy, *_ = judged_deviations(model.told_at_rest(np.array([[0.04]])), modes, n_lags=1, fed_back=False)
    assert (noisy.mass_std > plain.mass_std).all()
    assert (noisy.frequency_std >= plain.frequency_std).all()
