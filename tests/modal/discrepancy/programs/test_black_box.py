"""A simulation program that lacks something: the truth is made by expm or a Runge-Kutta rule, never by modal."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import scipy
import systems

from modal.discrepancy.diagnosis import diagnose
from modal.discrepancy.programs.black_box import diagnose_callable
from modal.discrepancy.programs.program import CorrectedCallable
from modal.effects.catalogue import CATALOGUE
from modal.structure.placed import PlacedEffect
from okid.errors import InvalidDataError
from okid.record import Record

DT = 0.02


def storeys(masses, springs, dampers, dt=DT):
    """A chain that is driven at the second mass and seen at the first two."""
    matrices = systems.chain_matrices(masses, springs, dampers)
    return systems.structure(*matrices, force_dofs=[1], sensor_dofs=[0, 1], sensor_kinds="displacement", dt=dt)


def two_storeys(dt=DT):
    return storeys([1.0, 1.0], [400.0, 300.0], [0.8, 0.6], dt)


HUNG_ON = storeys([1.0, 1.0, 0.15], [400.0, 300.0, 45.0], [0.8, 0.6, 0.1])
"""A third mass of 0.15 hung on the second by a spring of 45, unknown to the program."""


def linear(inputs):
    return systems.simulate(two_storeys(), inputs)


def program(record):
    """The user's simulation: an independent loop over the exact sampling of the two storeys."""
    return replace(record, outputs=linear(record.inputs))


def spring(inputs, *, cubic=0.0, dt=DT, substeps=10):
    """x'' + 1.2 x' + 400 x + cubic x^3 = u, u held; the classical Runge-Kutta rule."""

    def pull(x, v, force):
        return force - 400.0 * x - 1.2 * v - cubic * x * x * x

    x, v, h, outputs = 0.0, 0.0, dt / substeps, np.empty((len(inputs), 1))
    for k, force in enumerate(inputs[:, 0].tolist()):  # plain numbers: a tenth of the time of arrays of two
        outputs[k] = x
        for _ in range(substeps):
            one = pull(x, v, force)
            x2, v2 = x + 0.5 * h * v, v + 0.5 * h * one
            two = pull(x2, v2, force)
            x3, v3 = x + 0.5 * h * v2, v + 0.5 * h * two
            three = pull(x3, v3, force)
            x4, v4 = x + h * v3, v + h * three
            four = pull(x4, v4, force)
            x += h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4)
            v += h / 6.0 * (one + 2.0 * two + 2.0 * three + four)
    return outputs


def late(inputs, n_samples):
    return np.concatenate([np.repeat(inputs[:1], n_samples, axis=0), inputs[:-n_samples]])


SOME = {key: CATALOGUE[key] for key in ("cubic_stiffness", "input_delay", "input_gain", "sensor_bias")}
"""Enough to be taken for each other, and few enough for a test; the search has its own."""


def measured(truth, *, seed, levels=(1.0, 3.0, 2.0), n_samples=500, noise=0.01):
    """Records of several levels, the last one held out."""
    rng = np.random.default_rng(seed)
    records = []
    for level in levels:
        inputs = level * rng.standard_normal((n_samples, 1))
        outputs = truth(inputs)
        size = np.sqrt(np.mean(outputs**2, axis=0))
        noisy = outputs + noise * size * rng.standard_normal(outputs.shape)
        records.append(Record(inputs, noisy, DT, name=f"level {level:g}"))
    return tuple(records[:-1]), tuple(records[-1:])


def diagnosed(simulator, records, catalogue=SOME):
    return diagnose_callable(
        simulator, *records, catalogue=catalogue, sensor_kind=None, progress=lambda what, share: None, notes=("a note",)
    )


def only(*keys):
    return {key: CATALOGUE[key] for key in keys}


def test_nothing_is_missing():
    records = measured(linear, seed=201)
    found = diagnosed(program, records)
    assert found.status == "none"
    assert found.findings == ()
    assert found.warnings[0] == "a note"
    assert found.detection_limits
    np.testing.assert_allclose(
        found.gap_after, np.std(records[1][0].outputs - linear(records[1][0].inputs), axis=0)[None], rtol=0.03
    )
    np.testing.assert_array_equal(found.gap_before, found.gap_after)
    fresh = measured(linear, seed=202)[0][0]
    np.testing.assert_array_equal(found.model(fresh).outputs, program(fresh).outputs)


def test_a_delay_is_proved_by_the_callable_itself():
    records = measured(lambda inputs: linear(late(inputs, 3)), seed=203)
    seen = []

    def spied(record):
        seen.append(record.inputs)
        return program(record)

    found = diagnosed(spied, records)
    assert [(one.effect, one.where) for one in found.findings] == [("input_delay", "input_0")]
    assert found.status == "named"
    assert found.findings[0].parameters[0].value == pytest.approx(3 * DT, rel=0.01)
    held = records[1][0]
    assert any(np.shape(one) == held.inputs.shape and np.abs(one - late(held.inputs, 3)).max() < 0.05 for one in seen)
    # the figure is that of the model that is returned
    left = held.outputs - found.model(held).outputs
    np.testing.assert_allclose(found.gap_after, np.sqrt(np.mean(left**2, axis=0))[None], rtol=0.05)
    assert (found.gap_before > 10 * found.gap_after).all()
    assert found.closed > 0.99
    for step, gap in ((found.steps[0], found.gap_before), (found.steps[-1], found.gap_after)):
        missed = np.sqrt(np.mean((held.outputs - step.simulated[0]) ** 2, axis=0))
        np.testing.assert_allclose(missed[None], gap, rtol=1e-10)


def test_a_gain_of_the_input():
    found = diagnosed(program, measured(lambda inputs: linear(1.15 * inputs), seed=204))
    assert [one.effect for one in found.findings] == ["input_gain"]
    assert found.findings[0].parameters[0].value == pytest.approx(1.15, rel=0.01)
    fresh = measured(linear, seed=205)[0][0]
    np.testing.assert_allclose(
        found.model(fresh).outputs, 1.15 * program(fresh).outputs, atol=0.01 * np.abs(program(fresh).outputs).max()
    )


def test_a_bias_of_a_sensor():
    records = measured(lambda inputs: linear(inputs) + np.array([0.004, 0.0]), seed=206)
    found = diagnosed(program, records)
    assert [(one.effect, one.where) for one in found.findings] == [("sensor_bias", "output_0")]
    assert found.status == "named"
    fresh = measured(linear, seed=207)[0][0]
    shift = found.model(fresh).outputs - program(fresh).outputs
    np.testing.assert_allclose(shift.mean(axis=0), [0.004, 0.0], atol=1e-4)


def test_a_force_inside_is_added_as_a_difference():
    records = measured(lambda inputs: spring(inputs, cubic=6e4), seed=208)
    found = diagnosed(lambda record: replace(record, outputs=spring(record.inputs)), records)
    assert found.status == "named"
    assert [(one.effect, one.where) for one in found.findings] == [("cubic_stiffness", "output_0")]
    assert found.findings[0].parameters[0].value == pytest.approx(6e4, rel=0.05)
    assert found.model.correction is not None
    assert "build what was found" in found.advice[0]
    fresh = measured(lambda inputs: spring(inputs, cubic=6e4), seed=209, noise=0.0)[1][0]
    before = np.std(fresh.outputs - spring(fresh.inputs))
    assert np.std(fresh.outputs - found.model(fresh).outputs) < 0.05 * before
    assert "cubic_stiffness" in found.model.equations()


def hung_on(inputs):
    return systems.simulate(HUNG_ON, inputs)


def test_what_no_effect_explains_gets_a_linear_model():
    records = measured(hung_on, seed=210)
    found = diagnosed(program, records, only("sensor_bias"))
    assert found.status == "unresolved"
    assert found.model.residual is not None
    assert any("takes away" in one for one in found.warnings)
    assert found.steps[-1].name == "linear model of what is left"
    assert (found.gap_after < 0.2 * found.gap_before).all()
    fresh = measured(hung_on, seed=211, noise=0.0)[1][0]
    left = fresh.outputs - found.model(fresh).outputs
    assert (left.std(axis=0) < 0.3 * (fresh.outputs - linear(fresh.inputs)).std(axis=0)).all()
    # 2.757 Hz is sqrt(45 / 0.15) / 2 pi: where the absorber takes the motion away, beside the program's own modes
    poles = np.log(np.linalg.eigvals(found.model.residual.A).astype(complex)) / DT
    nearest = [np.abs(poles - pole).min() / np.abs(pole) for pole in HUNG_ON.poles]
    assert min(nearest) < 0.01


def test_a_nonlinear_callable_that_is_right():
    records = measured(lambda inputs: spring(inputs, cubic=4e4), seed=212, levels=(1.0, 3.0, 1.5))
    found = diagnosed(lambda record: replace(record, outputs=spring(record.inputs, cubic=4e4)), records)
    assert found.status == "none"
    assert any("itself nonlinear" in one for one in found.warnings)


def test_a_nonlinear_callable_with_a_late_input():
    def truth(inputs):
        return spring(late(inputs, 3), cubic=4e4)

    records = measured(truth, seed=213, levels=(1.0, 2.0, 1.5))
    found = diagnosed(
        lambda record: replace(record, outputs=spring(record.inputs, cubic=4e4)),
        records,
        only("input_delay", "sensor_gain"),
    )
    assert [one.effect for one in found.findings] == ["input_delay"]
    assert found.findings[0].parameters[0].value == pytest.approx(3 * DT, rel=0.05)
    # the callable, run with the late input, knows its own cubic spring: nearer than any linear part of it
    assert found.steps[-1].held_out_level < 0.05 * found.steps[0].held_out_level


def test_a_callable_without_a_linear_part_stays_unresolved():
    def rectifier(record):
        return replace(record, outputs=np.sign(np.cumsum(record.inputs, axis=0)) * record.inputs**2)

    records = measured(lambda inputs: 2.0 * np.sign(np.cumsum(inputs, axis=0)) * inputs**2, seed=214)
    found = diagnosed(rectifier, records)
    assert found.status == "unresolved"
    assert found.findings == ()
    assert any("could not be identified" in one for one in found.warnings)
    assert isinstance(found.model, CorrectedCallable)


def test_no_warning_escapes_and_the_result_is_the_same_twice():
    records = measured(lambda inputs: linear(1.1 * inputs), seed=215)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        one, other = (diagnose(program, *records, catalogue=only("input_gain", "sensor_bias")) for _ in range(2))
    assert one.verdict == other.verdict
    np.testing.assert_array_equal(one.gap_after, other.gap_after)


def broken(record):
    raise RuntimeError("no licence")


def nan_at_seven(record):
    outputs = linear(record.inputs)
    outputs[7, 1] = np.nan
    return replace(record, outputs=outputs)


def swapped(record):
    return Record(
        record.inputs, linear(record.inputs), record.dt, output_names=record.output_names[::-1], name=record.name
    )


class Random:
    def __init__(self):
        self.rng = np.random.default_rng(0)

    def __call__(self, record):
        return replace(record, outputs=linear(record.inputs) + 1e-3 * self.rng.standard_normal(record.outputs.shape))


@pytest.mark.parametrize(
    ("simulator", "words"),
    [
        (broken, r"failed on record 'level 1' \(RuntimeError: no licence\)"),
        (nan_at_seven, r"'output_1' of record 'level 1' is nan at sample 7 \(1 such"),
        (lambda record: record.outputs, "must return a Record, but returned ndarray"),
        (
            lambda record: replace(record, outputs=linear(record.inputs)[:, :1], output_names=(), output_units=()),
            r"shape \(300, 2\).*returned \(300, 1\)",
        ),
        (lambda record: record.samples(0, 100), r"returned \(100, 2\)"),
        (lambda record: replace(program(record), dt=0.01), "time step of 0.02 s.*returned 0.01 s"),
        (swapped, "in the order of the record"),
        (Random(), "same outputs each time"),
    ],
)
def test_a_callable_that_does_not_simulate_is_told_so(simulator, words):
    records = measured(linear, seed=216, n_samples=300)
    with pytest.raises(InvalidDataError, match=words) as caught:
        diagnosed(simulator, records)
    assert str(caught.value).count(". ") == 0


def test_records_without_inputs_are_refused():
    decay = Record([], scipy.linalg.expm(np.zeros((1, 1))).repeat(300, axis=0), DT)
    with pytest.raises(InvalidDataError, match="the records have none"):
        diagnosed(program, ((decay,), (decay,)))


def test_a_delay_of_part_of_a_sample_has_the_mean_of_each_step():
    fine = two_storeys(DT / 5)
    rng = np.random.default_rng(217)
    inputs = rng.standard_normal((400, 1))
    found = diagnosed(
        program,
        measured(lambda u: systems.simulate(fine, late(np.repeat(u, 5, axis=0), 12))[::5], seed=218),
        only("input_delay", "sensor_bias"),
    )
    assert found.findings[0].parameters[0].value == pytest.approx(2.4 * DT, rel=0.01)
    record = Record(inputs, np.zeros((400, 2)), DT)
    changed = found.model.changed_inputs(record).inputs
    np.testing.assert_allclose(changed[5:], 0.6 * inputs[3:-2] + 0.4 * inputs[2:-3], atol=0.05)


def test_sensor_effects_follow_each_other():
    both = (
        PlacedEffect(effect="sensor_gain", where="output_1", names=("gain",), values=(2.0,)),
        PlacedEffect(effect="sensor_bias", where="output_1", names=("offset", "slope"), values=(1.0, 0.5)),
    )
    record = measured(linear, seed=219, n_samples=50)[0][0]
    plain, changed = program(record).outputs, CorrectedCallable(program, effects=both)(record).outputs
    np.testing.assert_array_equal(changed[:, 0], plain[:, 0])
    np.testing.assert_allclose(changed[:, 1], 2.0 * plain[:, 1] + 1.0 + 0.5 * DT * np.arange(50), rtol=1e-14)
