from dataclasses import replace

import numpy as np
import pytest
from signals import random_inputs, with_noise
from systems import initial_state, modal_system, simulate

from era.balanced import decompose, realise
from modal.estimation.cross_validation import markov_lags
from modal.modes.extraction import extract_modes
from modal.verdict.repeatability import repeat
from okid.markov import recover_markov
from okid.observer import fit_observer
from okid.record import Record


def a_record(seed, n_samples=1500, *, noise=0.03):
    rng = np.random.default_rng(seed)
    system = modal_system(rng, frequencies=[5.0, 21.0], damping_ratios=[0.03, 0.02], n_inputs=1, n_outputs=2)
    inputs = random_inputs(rng, n_samples, 1)
    outputs = simulate(system, inputs, initial_state=initial_state(rng, system, inputs))
    return system, Record(inputs, with_noise(rng, outputs, noise), system.dt).detrended()


def repeated(records, *, observer_order=20, ridge=1e-4, model_order=4, **options):
    observer = fit_observer(records, order=observer_order, ridge=ridge)
    markov = recover_markov(observer, n_lags=markov_lags(observer.n_inputs, observer.n_outputs))
    return repeat(
        records,
        observer_order=observer_order,
        ridge=ridge,
        model_order=model_order,
        decomposition=decompose(markov, max_order=24),
        **options,
    )


def test_what_is_repeated():
    _, record = a_record(1)
    reruns = repeated([record])
    assert [(run.label, run.change) for run in reruns.runs] == [
        ("first half", "data"),
        ("second half", "data"),
        ("observer order 14, ridge 0.0003", "observer"),
        ("order 6", "higher order"),
    ]
    np.testing.assert_allclose(reruns.output_scale, record.outputs.std(axis=0), rtol=1e-12)
    np.testing.assert_allclose(reruns.input_scale, record.inputs.std(axis=0), rtol=1e-12)
    assert [len(run.modes) for run in reruns.runs[:3]] == [2, 2, 2]
    assert [run.gain is not None for run in reruns.runs] == [True, True, False, False]
    # the input drives both modes: left out, the held-out rows are told less
    assert all((run.gain > 0.1).all() for run in reruns.runs[:2])


def test_every_rerun_of_exact_data_is_exact():
    system, record = a_record(2, noise=0.0)
    for run in repeated([record], observer_order=8, ridge=0.0).runs:
        if run.change != "data":  # the observer's rerun has a ridge of 1e-6
            continue
        for pole in system.poles:
            assert min(abs(mode.pole - pole) / abs(pole) for mode in run.modes) < 1e-7


def test_a_half_sees_its_own_rows_only():
    """The first half is exact, the second lost: only the first can be repeated, and exactly."""
    system, record = a_record(3, noise=0.0)
    order = 8
    mine = np.arange(record.n_samples) * 10 // record.n_samples % 2 == 0  # ten blocks, every second one
    outputs = np.where(mine[:, np.newaxis], record.outputs, np.nan)
    runs = repeated([replace(record, outputs=outputs)], observer_order=order, ridge=0.0).runs
    assert [run.label for run in runs if run.change == "data"] == ["first half"]
    for pole in system.poles:
        assert min(abs(mode.pole - pole) / abs(pole) for mode in runs[0].modes) < 1e-7


def test_the_other_observer_can_hold_the_model():
    """Of an order below n / n_outputs no observer holds n poles: a longer one is asked."""
    _, record = a_record(4)
    labels = [run.label for run in repeated([record], observer_order=4, model_order=8).runs]
    assert "observer order 6, ridge 0.0003" in labels
    labels = [run.label for run in repeated([record], observer_order=10, ridge=0.0, model_order=4).runs]
    assert "observer order 7, ridge 1e-06" in labels


def test_an_observer_of_two_lags_is_not_shortened_below_what_one_mode_takes():
    """Outputs that see one mode alike tell in one lag where it is, not where it goes: a false mode of other damping."""
    rng = np.random.default_rng(6)
    system = modal_system(rng, frequencies=[11.0], damping_ratios=[0.02], n_inputs=1, n_outputs=1)
    inputs = random_inputs(rng, 1500, 1)
    seen = simulate(system, inputs) * [1.0, -0.4]
    record = Record(inputs, with_noise(rng, seen, 0.01), system.dt).detrended()
    (other,) = [
        run
        for run in repeated([record], observer_order=2, ridge=0.0, model_order=2, refinement_steps=8).runs
        if run.change == "observer"
    ]
    assert other.label == "observer order 3, ridge 1e-06"
    assert [mode.frequency for mode in other.modes.modes] == pytest.approx([11.0], rel=1e-3)


def test_a_half_gets_an_observer_that_its_rows_can_carry():
    """A long observer on half of a short record interpolates its noise; a weak mode would be lost in it."""
    rng = np.random.default_rng(6)
    system = modal_system(
        rng, frequencies=[5.0, 21.0], damping_ratios=[0.03, 0.02], mode_sizes=[1.0, 0.15], n_inputs=1, n_outputs=2
    )
    inputs = random_inputs(rng, 800, 1)
    record = Record(inputs, with_noise(rng, simulate(system, inputs), 0.03), system.dt).detrended()
    longest = 800 // (3 * 3)  # what the search allows: three rows an unknown of all rows
    for run in repeated([record], observer_order=longest, ridge=0.0).runs[:2]:
        for pole in system.poles:
            assert min(abs(mode.pole - pole) / abs(pole) for mode in run.modes) < 0.01


def test_the_other_observer_has_the_order_and_the_ridge_of_its_label():
    _, record = a_record(8)
    (run,) = [run for run in repeated([record], observer_order=20, ridge=0.03).runs if run.change == "observer"]
    assert run.label == "observer order 14, ridge 0.09"

    def poles(ridge):
        observer = fit_observer(record, order=14, ridge=ridge)
        model = realise(recover_markov(observer, n_lags=markov_lags(1, 2)), order=4)
        return np.array([mode.pole for mode in extract_modes(model)])

    found = np.array([mode.pole for mode in run.modes])
    # the rerun starts six rows later, as the whole record's observer does
    assert np.abs(found - poles(0.09)).max() < 0.2 * np.abs(found - poles(0.03)).max()


def test_what_grew_is_found_again_in_what_the_others_leave():
    """A short observer asked for all modes at once gives a pole of noise for the weak one."""
    rng = np.random.default_rng(5)
    both = {"frequencies": [5.0, 21.0, 33.0], "damping_ratios": [0.03, 0.02, 0.01], "mode_sizes": [1.0, 1.0, 0.03]}
    system = modal_system(rng, **both, n_inputs=1, n_outputs=2)
    inputs = rng.standard_normal((3000, 1))
    record = Record(inputs, with_noise(rng, simulate(system, inputs), 0.2), system.dt).detrended()
    found = {}
    for grown in ("", "half", "all"):
        runs = repeated([record], observer_order=10, ridge=1e-3, model_order=6, refinement_steps=8, grown=grown).runs
        (again,) = [run.modes for run in runs if run.change == "observer"]
        found[grown] = min(abs(mode.frequency - 33.0) for mode in again)
    assert max(found["half"], found["all"]) < 0.1
    assert found[""] > 1.0
