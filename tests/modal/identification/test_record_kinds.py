"""Struck and ringing records from records to modes: every mode called, none invented, nothing untrue said.

Larger runs with the same generator: `python tests/benchmarks/record_kinds.py`.
"""

import functools

import numpy as np
import pytest
import scipy
from field_records import random_records

import modal
from era.balanced import realise
from modal.identification import final_model
from modal.identification.words import fit_sentence
from okid.errors import InvalidDataError
from okid.markov import MarkovParameters
from okid.record import Record

UNTRUE = ("never moves", "not linear", "periodic disturbance", "too few frequencies", "samples late", "No input was")


def identified(truth, **options):
    return modal.identify([Record(u, y, truth.dt) for u, y in truth.records], **options)


@functools.cache
def searched(kind, seed, cell):
    """One record of this kind, and what is found of it where nothing is given."""
    truth = random_records(kind, seed, n_records=1, cell=cell)
    return truth, identified(truth)


def assert_told_right(result, truth, *, untrue=UNTRUE):
    for frequency, excitable in zip(truth.frequencies, truth.excitable, strict=True):
        mode = min(result.modes.system, key=lambda m: abs(m.frequency - frequency))
        assert not excitable or abs(mode.frequency - frequency) < 5 * mode.frequency_std < 0.05 * frequency
    for mode in result.modes.system:
        assert (np.abs(truth.frequencies - mode.frequency) < 0.05 * mode.frequency).any()
    said = " ".join((*result.warnings, *(m.reason for m in result.modes), *(c.value for c in result.choices)))
    assert not [words for words in untrue if words in said]


@pytest.mark.parametrize(("kind", "seed", "cell"), [("transient", 202, 0.005), ("decay", 207, 0.0)])
def test_every_mode_is_called_and_none_invented(kind, seed, cell):
    """Noise of the force sensor, `cell` of its peak, costs a struck structure no interval."""
    truth, result = searched(kind, seed, cell)
    assert result.record_kind == kind
    assert [c.value for c in result.choices if c.what == "force window"] == ["used"] * (cell > 0)
    assert_told_right(result, truth)
    ((_, outputs),) = truth.records  # what was measured comes back, after the row of a release
    (record,) = result.records
    measured = record.outputs[len(record.outputs) - len(outputs) :]
    assert record.n_samples - len(outputs) == (kind == "decay")
    np.testing.assert_allclose(measured - measured[0], outputs - outputs[0], atol=1e-9 * abs(outputs).max())


def test_a_blow_in_a_record_that_is_searched_in_a_part_of_it(monkeypatch):
    """Of more samples than that the folds run a part; the rows in which the blow acts are of that part, too."""
    monkeypatch.setattr("modal.estimation.cross_validation.LONGEST_SCORED", 8000)
    truth = random_records("transient", 202, n_records=1, cell=0.005)
    ((force, outputs),) = truth.records
    rng, n_more = np.random.default_rng(202), 8500 - len(force)
    rest = rng.standard_normal((n_more, force.shape[1])) * force[-200:].std(axis=0)
    quiet = rng.standard_normal((n_more, outputs.shape[1])) * truth.noise_std
    record = Record(
        np.concatenate([force, rest]), np.concatenate([outputs, outputs[-200:].mean(axis=0) + quiet]), truth.dt
    )
    assert_told_right(modal.identify(record, observer_order=64, ridge=1e-4), truth)


def test_all_rows_are_explained_as_well_as_the_folds_promised():
    """The observer of all rows leads astray here, those of the folds do not: one blow in a record of noise."""
    truth = random_records("transient", 5007)
    result = identified(truth, observer_order=183, ridge=0.0)
    assert np.mean(result.fit.whole) > result.fit.mean - 0.02
    first, second, _ = truth.frequencies
    for frequency in (first, second):
        assert any(abs(mode.frequency - frequency) < 5 * mode.frequency_std for mode in result.modes.system)


def test_a_short_answer_of_five_modes_is_found_mode_by_mode():
    """It is over after thirty rows, in which no observer sees more than two of its modes."""
    truth = random_records("transient", 7005)
    result = identified(truth)
    assert len(result.modes.system) == truth.poles.size
    assert_told_right(result, truth)
    errors = result.records[0].outputs - result.simulated[0].outputs
    assert np.sqrt(np.nanmean(errors**2)) < 1.05 * truth.noise_std[0]
    assert not [words for words in result.warnings if "observer" in words]


def test_no_longer_record_is_asked_for_where_rows_would_be_rest():
    """Its observer is as long as any that is tried, but what was let go has nothing to add."""
    _, result = searched("decay", 207, 0.0)
    assert result.observer.order == 256
    assert not any("longer" in words for words in result.warnings)
    assert not any("given" in choice.reason for choice in result.choices if choice.what != "record kind")


def test_the_drift_that_a_caller_gives_for_a_decay_is_called_his():
    result = identified(random_records("decay", 207, n_records=1), drift="linear", observer_order=40, order=4)
    reasons = {choice.what: choice.reason for choice in result.choices}
    assert reasons["drift"] == "given as an argument"
    assert "release" in reasons["input delay"]


def test_a_decay_is_never_worse_than_era_on_the_same_samples():
    truth = random_records("decay", 203, n_records=1)
    result = identified(truth, observer_order=91, order=8)
    (_, outputs) = truth.records[0]
    decay = (outputs - outputs[-200:].mean(axis=0))[:400, :, np.newaxis]
    markov = MarkovParameters(system=np.concatenate([np.zeros((1, *decay.shape[1:])), decay]), dt=truth.dt)
    plain = modal.extract_modes(realise(markov, order=2 * truth.poles.size))
    nearest = [[min(abs(m.frequency - f) for m in model) for f in truth.frequencies] for model in (result.modes, plain)]
    ours, theirs = np.linalg.norm(nearest / truth.frequency_std, axis=1)
    assert ours <= max(theirs, 2.0 * np.sqrt(truth.poles.size))
    assert "From the start of each record" in fit_sentence(result)
    assert [c.value for c in result.choices if c.what == "release"] == ["one a record"]


def test_gaps_in_a_decay():
    truth = random_records("decay", 204, n_records=1)
    rng = np.random.default_rng(0)
    records = []
    for u, y in truth.records:
        holed = y[:, ::3].copy()
        for start in rng.integers(50, len(y) - 60, 4):
            holed[start : start + 15] = np.nan
        records.append(Record(u, holed, truth.dt))
    assert_told_right(modal.identify(records, observer_order=32, order=6), truth)


def test_wind_beneath_a_decay_adds_no_mode_and_leaves_intervals_that_hold():
    """Output error followed it with four certain modes where there are two, one of them 58 deviations off."""
    rng = np.random.default_rng(0)
    poles, dt = np.array([0.99 * np.exp(0.3j), 0.985 * np.exp(0.9j)]), 0.01
    shapes = rng.standard_normal((2, 2))
    x, y = np.ones(2, dtype=complex), np.empty((600, 2))
    for row in y:
        row[:] = shapes @ x.real + 0.001 * rng.standard_normal(2)
        x = poles * x + 0.004 * rng.standard_normal(4).view(complex)
    first, second = modal.identify(Record([], y, dt)).modes.system
    for mode, s in zip((first, second), np.log(poles) / dt, strict=True):
        assert abs(mode.frequency - abs(s) / (2 * np.pi)) < 3 * mode.frequency_std < 0.03 * mode.frequency
        assert abs(mode.damping_ratio + s.real / abs(s)) < 3 * mode.damping_ratio_std < 0.5 * mode.damping_ratio


def test_a_blow_into_a_ringing_structure():
    rng = np.random.default_rng(5)
    decay, swing = np.exp(-0.004 * np.arange(3000)), np.arange(3000)
    first, second = decay * np.cos(0.31 * swing), decay**1.5 * np.sin(0.83 * swing)
    blow = np.zeros(3000)
    blow[900:903] = [0.5, 1.0, 0.5]
    tip = np.convolve(blow, first + second)[:3000] + 0.4 * first
    result = modal.identify(Record(blow, tip + 0.005 * rng.standard_normal(3000), 0.01), observer_order=176, order=5)
    assert [c.value for c in result.choices if c.what == "rest before the blow"] == ["not used"]
    found = sorted(2 * np.pi * 0.01 * mode.frequency for mode in result.modes.system)
    np.testing.assert_allclose(found, [np.hypot(0.31, 0.004), np.hypot(0.83, 0.006)], rtol=1e-3)


def test_kinds_that_cannot_be():
    truth = random_records("decay", 201, n_records=1)
    with pytest.raises(InvalidDataError, match='kind="driven"'):
        identified(truth, kind="driven")
    with pytest.raises(InvalidDataError, match="kind must be one of"):
        identified(truth, kind="free")


def test_what_grew_needs_none_of_its_observers_recovered(monkeypatch):
    """It came from none: with the observer that it stands beside gone astray on all rows it was thrown away."""
    truth, seen = random_records("transient", 7005), []
    decomposed = final_model._decomposed

    def first_diverges(records, trial):
        seen.append((trial.observer_order, trial.ridge))
        return None if seen[-1] == seen[0] else decomposed(records, trial)

    monkeypatch.setattr(final_model, "_decomposed", first_diverges)
    result = identified(truth)
    assert len(set(seen)) > 1
    assert len(result.modes.system) == truth.poles.size
    assert_told_right(result, truth)


def test_products_of_modes_are_no_modes():
    """A sensor that is not quite linear shows twice the lowest pole, and its sum with its conjugate at 0 Hz."""
    truth = random_records("transient", 12003, n_records=1)
    ((force, outputs),) = truth.records
    bent = outputs + 0.168 * outputs**2 / np.abs(outputs).max(axis=0)
    result = modal.identify(Record(force, bent, truth.dt), observer_order=23, order=10)
    twice = [mode for mode in result.modes if abs(mode.pole - 2.0 * truth.poles[0]) < 0.02 * abs(truth.poles[0])]
    assert twice
    assert all(mode.verdict == "doubtful" and "what is not quite linear makes such" in mode.reason for mode in twice)
    assert_told_right(result, truth, untrue=set(UNTRUE) - {"not linear"})


def test_the_high_pass_of_the_sensors_is_no_mode():
    truth = random_records("transient", 12004, n_records=1)
    ((force, outputs),) = truth.records
    corner = 0.3 * truth.frequencies.min()
    seen = scipy.signal.lfilter(*scipy.signal.butter(2, 2 * corner * truth.dt, "high"), outputs, axis=0)
    result = modal.identify(Record(force, seen, truth.dt), observer_order=8, order=10)
    filters = [mode for mode in result.modes if abs(mode.frequency - corner) < 0.1 * corner]
    assert filters
    assert all(mode.verdict == "doubtful" and "does not come back" in mode.reason for mode in filters)
    assert_told_right(result, truth)


def test_a_blow_of_one_sample_that_accelerometers_show_at_once():
    """Its row is no spike, and held out nothing would tell how the outputs answer in it."""
    rng, dt = np.random.default_rng(1), 0.001
    force = np.r_[np.zeros(300), 1.0, np.zeros(1699)]
    frequencies, dampings = np.array([40.0, 110.0, 190.0]), np.array([0.02, 0.015, 0.01])
    poles = 2.0 * np.pi * frequencies * (-dampings + 1j * np.sqrt(1.0 - dampings**2))
    answers = [scipy.signal.lfilter([0.0, 1.0], [1.0, -np.exp(pole * dt)], 1j * force).real for pole in poles]
    ringing = np.array(answers).T @ rng.standard_normal((3, 2))
    noise = 0.003 * np.abs(ringing).max(axis=0)
    outputs = ringing + np.outer(force, 3.0 * np.abs(ringing).max(axis=0)) + noise * rng.standard_normal(ringing.shape)
    result = modal.identify(Record(force, outputs, dt), observer_order=64, order=6)
    assert not result.warnings
    assert result.input_delay == (0,)
    for mode, frequency in zip(result.modes.system, frequencies, strict=True):
        assert abs(mode.frequency - frequency) < 5 * mode.frequency_std < 0.01 * frequency
    assert result.fit.mean > np.mean(result.fit.whole) - 0.01
