"""`identify` from end to end on small records of systems that are known."""

from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest
from signals import random_inputs, with_noise
from systems import initial_state, modal_system, simulate

from modal.identification.pipeline import identify
from modal.identification.result import Identification
from okid.errors import InsufficientDataError, InvalidDataError
from okid.record import Record

QUICK = {"observer_order": 20, "ridge": 1e-4, "order": 4}
"""Nothing to choose: tenths of a second."""


def small_system(seed):
    rng = np.random.default_rng(seed)
    return rng, modal_system(rng, frequencies=[5.0, 21.0], damping_ratios=[0.02, 0.01], n_inputs=2, n_outputs=2)


def record_of(rng, system, n_samples=2000, *, noise=0.03):
    inputs = random_inputs(rng, n_samples, system.n_inputs)
    outputs = simulate(system, inputs, initial_state=initial_state(rng, system, inputs))
    return Record(inputs, with_noise(rng, outputs, noise) if noise else outputs, system.dt)


def check_modes(result, system, *, frequency=0.003, damping=0.25):
    """Every true mode is there as a system mode, and no other pole is called one."""
    found = result.modes.system
    assert len(found) == len(system.poles), [(m.frequency, m.verdict, m.reason) for m in result.modes]
    for mode, true_frequency, true_damping in zip(found, system.frequencies, system.damping_ratios, strict=True):
        assert mode.frequency == pytest.approx(true_frequency, rel=frequency)
        assert mode.damping_ratio == pytest.approx(true_damping, rel=damping)


def spectral_radius(result):
    return np.abs(np.linalg.eigvals(result.realisation.A)).max()


def choice(result, what):
    (found,) = [choice for choice in result.choices if choice.what == what]
    return found


@pytest.fixture(scope="module")
def small():
    rng, system = small_system(1)
    return system, record_of(rng, system)


@pytest.fixture(scope="module")
def noisy(small):
    """Nothing given, everything chosen, and what was told on the way."""
    told = []
    result = identify(small[1], progress=lambda what, share: told.append((what, share)))
    return small[0], result, told


@pytest.fixture(scope="module")
def quick(small):
    return identify(small[1], **QUICK)


# --- nothing given ---------------------------------------------------------------------------------------------------


def test_all_modes_of_a_noisy_record_are_found(noisy):
    system, result, _ = noisy
    check_modes(result, system)
    assert spectral_radius(result) < 1.0
    # a fit cannot exceed the noise, 3 % of each output; held-out rows fit nearly as well as all
    assert 0.95 < result.fit.mean < 0.975
    np.testing.assert_allclose(result.fit.whole, 0.97, atol=0.01)
    assert result.warnings == ()


def test_every_choice_has_its_reason(noisy):
    _, result, _ = noisy
    assert [choice.what for choice in result.choices] == [
        "record kind",
        "mean",
        "frequency band",
        "integrators",
        "input delay",
        "drift",
        "observer order",
        "ridge",
        "model order",
        "refinement",
        "gain",
    ]
    assert choice(result, "observer order").value == str(result.observer.order)
    assert float(choice(result, "ridge").value) == pytest.approx(result.observer.ridge)
    assert choice(result, "model order").value == str(result.realisation.order)
    assert all(len(choice.reason) > 20 for choice in result.choices)


def test_progress_rises_to_the_end(noisy):
    _, _, told = noisy
    shares = [share for _, share in told]
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    assert len(told) > 8
    assert all(what for what, _ in told)


def writable_arrays(value, path=""):
    if isinstance(value, np.ndarray):
        return [path] if value.flags.writeable else []
    if is_dataclass(value):
        parts = [(f"{path}.{field.name}", getattr(value, field.name)) for field in fields(value)]
    elif isinstance(value, tuple):
        parts = [(f"{path}[{i}]", part) for i, part in enumerate(value)]
    else:
        return []
    return [found for name, part in parts for found in writable_arrays(part, name)]


def test_no_array_of_the_result_can_be_changed(noisy):
    _, result, _ = noisy
    assert isinstance(result, Identification)
    assert writable_arrays(result) == []


def test_exact_data_give_the_exact_system():
    rng, system = small_system(2)
    record = record_of(rng, system, 1200, noise=0.0)
    result = identify(record)
    assert result.realisation.order == 4
    assert choice(result, "model order").value == "4"
    check_modes(result, system, frequency=1e-8, damping=1e-8)
    for mode, pole in zip(result.modes.system, system.poles, strict=True):
        assert abs(mode.pole - pole) < 1e-8 * abs(pole)
    np.testing.assert_allclose(result.fit.cross_validated, 1.0, atol=1e-6)
    np.testing.assert_allclose(result.fit.one_step, 1.0, atol=1e-5)


def test_several_records_gaps_offsets_and_units():
    """Two records of their own initial state and offset; lost outputs, an input gap; units a million apart."""
    rng, system = small_system(3)
    into, out = np.array([1e3, 1e-3]), np.array([1e-6, 1.0])
    records = []
    for offset in (0.0, 50.0):
        clean = record_of(rng, system, 1300)
        records.append(
            replace(clean, inputs=clean.inputs * into, outputs=(clean.outputs + offset * clean.outputs.std()) * out)
        )
    inputs, outputs = records[0].inputs.copy(), records[0].outputs.copy()
    inputs[700:704, 1] = outputs[200:215, 0] = outputs[950, 1] = np.nan
    records[0] = replace(records[0], inputs=inputs, outputs=outputs)
    result = identify(records, observer_order=32, ridge=1e-5, order=4)
    check_modes(result, system)
    assert [record.n_samples for record in result.records] == [700, 596, 1300]
    assert choice(result, "input gaps").value == "3 records from 2"
    for record, simulated in zip(result.records, result.simulated, strict=True):
        there = record.complete_rows()
        error = (record.outputs - simulated.outputs)[there]
        assert (np.sqrt(np.square(error).mean(axis=0)) < 0.05 * record.outputs[there].std(axis=0)).all()


def test_outputs_that_follow_nothing_have_no_system_mode():
    rng = np.random.default_rng(4)
    result = identify(Record(rng.standard_normal((1000, 1)), rng.standard_normal((1000, 2)), 0.01))
    assert result.modes.system == ()
    assert result.fit.mean < 0.1
    assert "reproduces 0 % of data kept aside" in result.warnings[0]
    assert "no mode is certain" in result.warnings[0]
    assert spectral_radius(result) < 1.0


def test_outputs_alone_give_frequencies():
    rng = np.random.default_rng(5)
    system = modal_system(rng, frequencies=[5.0, 21.0], damping_ratios=[0.02, 0.01], n_outputs=2, feedthrough=0.0)
    driven = record_of(rng, system, 4000, noise=0.02)
    result = identify(driven.select(inputs=[]))
    for frequency in system.frequencies:
        near = [
            mode for mode in result.modes if abs(mode.frequency / frequency - 1) < 0.02 and mode.damping_ratio < 0.05
        ]
        assert near
        assert near[0].verdict != "noise"
    assert any("No input was given" in words for words in result.warnings)
    assert result.excitation.persistency_order == 0
    assert spectral_radius(result) < 1.0


def test_an_integrator_beside_a_mode_is_taken_out_of_the_fit_and_put_back():
    """A pole so near to 1 that data put it on either side: the fitted model is stable, the whole one integrates."""
    rng, system = small_system(6)
    record = record_of(rng, system, 1500)
    drift = np.zeros(1500)
    for k in range(1, 1500):
        drift[k] = drift[k - 1] + 0.05 * record.outputs[:, 0].std() * record.inputs[k - 1, 0]
    outputs = record.outputs + np.column_stack([drift, 0.5 * drift])
    result = identify(replace(record, outputs=outputs), ridge=1e-5, observer_order=16)
    assert np.abs(np.linalg.eigvals(result.fitted_model.A)).max() < 1.0
    assert spectral_radius(result) == pytest.approx(1.0, abs=1e-12)
    for frequency in system.frequencies:
        assert min(abs(mode.frequency / frequency - 1) for mode in result.modes.system) < 0.01


# --- something given -------------------------------------------------------------------------------------------------


def test_what_is_given_is_kept(small, quick):
    system, record = small
    assert (quick.observer.order, quick.observer.ridge, quick.realisation.order) == (20, 1e-4, 4)
    for what in ("observer order", "ridge", "model order"):
        assert choice(quick, what).reason == "given as an argument"
    check_modes(quick, system)
    decimated = identify(record, **QUICK, decimation=2)
    assert decimated.realisation.dt == pytest.approx(2 * record.dt)
    assert choice(decimated, "frequency band").reason == "given as an argument"


def test_the_same_question_has_the_same_answer(small, quick):
    again = identify(small[1], **QUICK)
    for name in "ABCDK":
        np.testing.assert_array_equal(getattr(again.realisation, name), getattr(quick.realisation, name))
    np.testing.assert_array_equal(again.simulated[0].outputs, quick.simulated[0].outputs)
    assert [(m.verdict, m.reason, m.repeatability) for m in again.modes] == [
        (m.verdict, m.reason, m.repeatability) for m in quick.modes
    ]


def test_outputs_in_another_order_give_shapes_in_that_order(small, quick):
    turned = identify(small[1].select(outputs=[1, 0]), **QUICK)
    for mode, again in zip(quick.modes, turned.modes, strict=True):
        assert again.pole == pytest.approx(mode.pole, rel=1e-6)
        np.testing.assert_allclose(again.shape[::-1], mode.shape, atol=1e-5)
        assert (again.verdict, again.repeatability) == (mode.verdict, pytest.approx(mode.repeatability, abs=1e-5))
    np.testing.assert_allclose(turned.fit.cross_validated[::-1], quick.fit.cross_validated, rtol=1e-6)


def test_an_input_in_another_unit_changes_its_columns_only(small, quick):
    """A thousand times the number: B and D a thousandth, nothing else."""
    record = small[1]
    scaled = identify(replace(record, inputs=record.inputs * [1e3, 1.0]), **QUICK)
    pulse = [result.markov.system for result in (quick, scaled)]
    np.testing.assert_allclose(pulse[1] * [1e3, 1.0], pulse[0], atol=1e-7 * np.abs(pulse[0]).max())
    for mode, again in zip(quick.modes, scaled.modes, strict=True):
        assert again.pole == pytest.approx(mode.pole, rel=1e-7)
        np.testing.assert_allclose(again.shape, mode.shape, atol=1e-6)
        np.testing.assert_allclose(again.participation * [1e3, 1.0], mode.participation, rtol=1e-5)
        assert (again.verdict, again.repeatability) == (mode.verdict, pytest.approx(mode.repeatability, abs=1e-6))
    np.testing.assert_allclose(scaled.fit.cross_validated, quick.fit.cross_validated, rtol=1e-6)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"observer_order": 0}, 'observer_order must be .* at least 1 or "auto", but is 0'),
        ({"observer_order": 2.5}, "observer_order must be"),
        ({"observer_order": True}, "observer_order must be"),
        ({"order": "four"}, "order must be .* but is 'four'"),
        ({"order": -1}, "order must be"),
        ({"decimation": 0}, "decimation must be"),
        ({"ridge": -1e-3}, "ridge must be .* at least 0, but is -0.001"),
        ({"ridge": np.nan}, "ridge must be"),
        ({"ridge": True}, "ridge must be"),
        ({"ridge": "much"}, "ridge must be"),
    ],
    ids=str,
)
def test_bad_arguments_are_told_in_a_sentence(small, options, words):
    with pytest.raises(InvalidDataError, match=words):
        identify(small[1], **options)


def test_what_the_data_cannot_carry_is_told(small):
    record = small[1]
    with pytest.raises(InsufficientDataError, match=r"observer order 1500 needs .* Use order <= "):
        identify(record, observer_order=1500)
    with pytest.raises(InsufficientDataError, match="model order 1000 was asked for"):
        identify(record, order=1000)
    with pytest.raises(InsufficientDataError, match="needs at least 40 samples in one record"):
        identify(record.samples(0, 30))
    for n_samples in (2, 3, 5, 6, 39):  # without inputs, a handful of samples is asked first whether it rings on
        with pytest.raises(InsufficientDataError, match=f"at least 40 samples .* the longest has {n_samples}:"):
            identify(Record(np.zeros((n_samples, 0)), record.samples(0, n_samples).outputs, record.dt))
    with pytest.raises(InvalidDataError, match=r"one okid\.Record or a sequence"):
        identify([])
    with pytest.raises(InvalidDataError, match="same output names"):
        identify([record, replace(record, output_names=["a", "b"])])
    with pytest.raises(InsufficientDataError, match="decimating by 200 needs"):
        identify(record, decimation=200)


def test_a_misspelt_option_is_refused(small):
    with pytest.raises(TypeError, match="obsever_order"):
        identify(small[1], obsever_order=20)
