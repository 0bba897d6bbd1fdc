"""The whole road, records to modes, by the public names alone: exact on exact data, complete on noisy data."""

from dataclasses import replace

import numpy as np
import pytest
from signals import random_inputs, with_noise
from systems import initial_state, markov, modal_system, random_chain, random_system, simulate

import era
import modal
import okid
from modal.examples.demo import compare_with_truth, demo_record, demo_truth


def record_of(rng, system, n_samples=1200, *, kind="white", noise=0.0, offset=0.0):
    """A record that starts from a state of the size of the response, as every real one does."""
    inputs = random_inputs(rng, n_samples, system.n_inputs, kind=kind)
    outputs = simulate(system, inputs, initial_state=initial_state(rng, system, inputs))
    if noise:
        outputs = with_noise(rng, outputs, noise)
    hold = "zero_order" if system.hold == "zero_order" else "linear"
    return okid.Record(inputs, outputs + offset * outputs.std(axis=0), system.dt, input_hold=hold)


CASES = {
    "close pair and weak mode, 2 in 3 out": random_system,
    "pair 1 % apart": lambda rng: random_system(rng, close_pair=0.01),
    "one in, one out": lambda rng: random_system(rng, n_inputs=1, n_outputs=1, n_modes=2),
    "one in, six out": lambda rng: random_system(rng, n_inputs=1, n_outputs=6, n_modes=4),
    "four in, two out": lambda rng: random_system(rng, n_inputs=4, n_outputs=2),
    "real poles": lambda rng: random_system(rng, n_modes=2, n_real_poles=2),
    "no feedthrough": lambda rng: random_system(rng, feedthrough=0.0),
    "joined by lines": lambda rng: random_system(rng, hold="linear"),
    "accelerometers on a chain": lambda rng: random_chain(rng, n_masses=3),
    "mixed sensors on a chain": lambda rng: random_chain(
        rng, n_masses=3, sensor_kinds=["displacement", "velocity", "acceleration"]
    ),
}


def spare_order(system):
    """Twice what p q >= n asks for: at the limit itself the observer's gain is huge."""
    return 2 * -(-system.order // system.n_outputs) + 2


def realised(system, records, n_lags=150):
    observer = okid.fit_observer(records, order=spare_order(system), ridge=0.0)
    found = okid.recover_markov(observer, n_lags=n_lags)
    return found, era.realise(found, order=system.order)


def check_exact(system, found, realisation, *, tolerance=1e-10):
    truth = markov(system, found.n_lags)
    np.testing.assert_allclose(found.system, truth, atol=tolerance * np.abs(truth).max(), rtol=0)
    again = markov(replace(system, A=realisation.A, B=realisation.B, C=realisation.C, D=realisation.D), found.n_lags)
    np.testing.assert_allclose(again, truth, atol=tolerance * np.abs(truth).max(), rtol=0)
    modes = modal.extract_modes(realisation)
    assert len(modes) == len(system.poles)
    for pole, shape, participation in zip(system.poles, system.shapes.T, system.participation.T, strict=True):
        mode = min(modes, key=lambda mode: abs(mode.pole - pole))
        assert abs(mode.pole - pole) < tolerance * abs(pole)
        residue = np.outer(shape, participation)
        error = np.abs(np.outer(mode.shape, mode.participation) - residue).max()
        # modes a percent apart share their residues: the parts are known less well than their sum
        assert error < 100 * tolerance * np.abs(residue).max() + tolerance * np.abs(truth).max()
    return modes


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("seed", range(3))
def test_exact_data_give_the_exact_system(case, seed):
    rng = np.random.default_rng([seed, *case.encode()])
    system = CASES[case](rng)
    found, realisation = realised(system, record_of(rng, system))
    modes = check_exact(system, found, realisation)
    alive = np.abs(np.exp(np.array([mode.pole for mode in modes]) * system.dt)) ** found.n_lags > 1e-4
    for mode, lives in zip(modes, alive, strict=True):
        if lives:
            for name in ("amplitude_coherence", "emac_output", "emac_input", "emac"):
                assert getattr(mode, name) == pytest.approx(1.0, abs=1e-9), name


@pytest.mark.parametrize("kind", ["white", "coloured", "sweep", "multisine", "hits", "steps"])
def test_any_input_that_moves_enough_will_do(kind):
    rng = np.random.default_rng(11)
    system = random_system(rng)
    found, realisation = realised(system, record_of(rng, system, kind=kind))
    check_exact(system, found, realisation)


def test_several_records_are_stacked_not_joined():
    rng = np.random.default_rng(12)
    system = random_system(rng)
    records = [
        record_of(rng, system, n_samples=n, kind=kind) for n, kind in ((300, "white"), (150, "hits"), (220, "steps"))
    ]
    check_exact(system, *realised(system, records))


def test_lost_samples_and_offsets_cost_no_exactness():
    rng = np.random.default_rng(13)
    system = random_system(rng)
    record = record_of(rng, system, offset=3.0)
    outputs, inputs = record.outputs.copy(), record.inputs.copy()
    outputs[100:110, 0] = outputs[500, 2] = inputs[800:805, 1] = np.nan
    check_exact(system, *realised(system, replace(record, outputs=outputs, inputs=inputs)))


def test_channels_of_any_size_cost_no_exactness():
    """Newtons beside micrometres: a million apart."""
    rng = np.random.default_rng(14)
    system = random_system(rng)
    record = record_of(rng, system)
    into, out = np.array([1e3, 1e-3]), np.array([1e-6, 1.0, 1e3])
    found, _ = realised(system, replace(record, inputs=record.inputs * into, outputs=record.outputs * out))
    truth = markov(system, found.n_lags)
    np.testing.assert_allclose(found.system / out[:, np.newaxis] * into, truth, atol=1e-8 * np.abs(truth).max(), rtol=0)


@pytest.mark.parametrize("seed", range(5))
def test_the_order_of_exact_data_is_seen_in_the_gap(seed):
    rng = np.random.default_rng([15, seed])
    system = random_system(rng)
    observer = okid.fit_observer(record_of(rng, system), order=spare_order(system), ridge=0.0)
    assert era.realise(okid.recover_markov(observer, n_lags=150), order="auto").order == system.order


def test_a_free_run_repeats_exact_data():
    rng = np.random.default_rng(16)
    system = random_system(rng)
    record = record_of(rng, system)
    _, realisation = realised(system, record)
    inputs = random_inputs(rng, 500, 2, kind="coloured")
    other = okid.Record(inputs, simulate(system, inputs), system.dt)
    again = era.simulate(realisation, other, initial_state=np.zeros(system.order))
    np.testing.assert_allclose(again.outputs, other.outputs, atol=1e-8 * np.abs(other.outputs).max(), rtol=0)


WELL_POSED = {
    "pair 4 % apart, 5 % noise": ((5.0, 5.2, 14.0), (0.006, 0.008, 0.02), 0.05),
    "five modes, 10 % noise": ((2.5, 6.0, 11.0, 19.0, 30.0), (0.02, 0.01, 0.01, 0.015, 0.02), 0.10),
}


@pytest.mark.parametrize("case", WELL_POSED)
def test_identify_finds_all_modes_of_a_well_posed_system(case):
    """Found as MEASURES.md defines it; no system mode where none is; damping right where it is said to be resolved."""
    frequencies, damping_ratios, noise = WELL_POSED[case]
    rng = np.random.default_rng(len(frequencies))
    system = modal_system(rng, frequencies=frequencies, damping_ratios=damping_ratios, n_outputs=4)
    result = modal.identify(record_of(rng, system, 3000, kind="coloured", noise=noise, offset=0.5))
    kept = [mode for mode in result.modes if mode.verdict != "noise"]
    for frequency, damping_ratio in zip(system.frequencies, system.damping_ratios, strict=True):
        mode = min(kept, key=lambda mode: abs(mode.frequency - frequency))
        assert abs(mode.frequency / frequency - 1) < max(0.005, damping_ratio)
        wrong = abs(mode.damping_ratio - damping_ratio)
        assert wrong < max(0.5 * damping_ratio, 0.004) or not mode.damping_resolved
        kept.remove(mode)  # one to one
    for mode in result.modes.system:
        assert np.abs(mode.frequency / system.frequencies - 1).min() < 0.05
    assert result.fit.mean > 1 - 2 * noise - 0.05
    assert all(choice.reason for choice in result.choices)


def test_identify_finds_the_tower_of_the_demo_and_its_file_is_the_same(tmp_path):
    truth = demo_truth()
    result = modal.identify(demo_record(np.random.default_rng(20), n_samples=4500))
    for row in compare_with_truth(truth, result.modes):
        assert row.verdict == "system"
        assert row.found_frequency == pytest.approx(row.frequency, rel=0.005)
        assert row.assurance > 0.95
    assert len(result.modes.system) == len(truth.frequencies)
    first = result.save(tmp_path / "first.npz")
    again = modal.load(first)
    assert again.save(tmp_path / "second.npz").read_bytes() == first.read_bytes()
    assert [mode.pole for mode in again.modes] == [mode.pole for mode in result.modes]
