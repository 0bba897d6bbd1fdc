"""What must not change a diagnosis: the order of channels, their units, more noise, half the data."""

import functools
import warnings
from dataclasses import replace

import control
import hidden_scoring
import numpy as np
import pytest
from hidden_cases import hidden_case

import modal
import okid
from modal.discrepancy import diagnose

CASES = {
    "drag": ("motor_propeller", 3000),
    "delay": ("motor_propeller", 3001),
    "cubic": ("1dof_displacement", 3006),
    "nothing": ("motor_propeller", 3004),
}


def diagnosed(model, fit, held_out, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return diagnose(model, fit, held_out, **options)


def plainly(case):
    return diagnosed(hidden_scoring.model_of(case), *hidden_scoring.records_of(case))


def decided(found):
    return found.status, [(one.effect, one.where) for one in found.findings]


def values(found):
    return np.array([p.value for one in found.findings for p in one.parameters])


def deviations(found):
    return np.array([p.std for one in found.findings for p in one.parameters])


@functools.cache
def known(name):
    """(case, its diagnosis): what every change is held against."""
    case = hidden_case(*CASES[name])
    found = plainly(case)
    assert decided(found) == (
        "named" if case.effects else "none",
        [(effect.effect, effect.place) for effect in case.effects],
    )
    return case, found


def in_other_units(case):
    """The same motion in millimetres (or mrad) under inputs in thousands: a model and records."""
    nominal = case.nominal
    if hasattr(nominal, "J"):
        matrices = [[nominal.J]], [[nominal.b]], [[0.0]]
        maps = {"force_map": [[1e3 * nominal.kt]], "sensor_map": [[1e3]], "sensor_kind": "velocity"}
        model = modal.StructuralModel(*matrices, **maps, length_unit="rad", force_unit="N m")
    else:
        matrices = [nominal.masses], [nominal.dampings], [nominal.stiffnesses]
        maps = {"force_map": [[1e3]], "sensor_map": [[1e3]], "sensor_kind": nominal.sensor_kind}
        model = modal.StructuralModel(*matrices, **maps)
    fit, held_out = (
        [okid.Record(r.inputs / 1e3, 1e3 * r.outputs, r.dt, input_hold=r.hold) for r in records]
        for records in (case.fit, case.held_out)
    )
    return model, fit, held_out


@pytest.mark.parametrize("name", ["cubic", "drag", "nothing"])
def test_units_of_the_channels_leave_all(name):
    case, found = known(name)
    other = diagnosed(*in_other_units(case))
    assert decided(other) == decided(found)
    # parameters stay in those of the structure
    np.testing.assert_allclose(values(other), values(found), rtol=1e-3)
    np.testing.assert_allclose(deviations(other), deviations(found), rtol=0.02)
    np.testing.assert_allclose(other.gap_after, 1e3 * np.asarray(found.gap_after), rtol=1e-3)


@pytest.mark.parametrize("name", ["drag", "nothing"])
def test_twice_the_noise_leaves_the_decision_and_widens_the_deviations(name):
    case, found = known(name)
    rng = np.random.default_rng(3102)

    def noisier(record):
        extra = np.sqrt(3.0 * record.noise_variance) * rng.standard_normal(record.outputs.shape)
        return replace(record, outputs=record.outputs + extra, noise_variance=4.0 * record.noise_variance)

    louder = replace(case, fit=tuple(map(noisier, case.fit)), held_out=tuple(map(noisier, case.held_out)))
    other = plainly(louder)
    assert decided(other) == decided(found)
    assert (np.abs(values(other) - values(found)) < 5 * np.hypot(deviations(other), deviations(found))).all()
    np.testing.assert_allclose(deviations(other) / deviations(found), 2.0, rtol=0.3)


@pytest.mark.parametrize("name", ["cubic", "delay"])
def test_half_the_data_leave_the_decision_and_widen_the_deviations(name):
    case, found = known(name)

    def half(record):
        return replace(
            record, inputs=record.inputs[: len(record.inputs) // 2], outputs=record.outputs[: len(record.inputs) // 2]
        )

    other = plainly(replace(case, fit=tuple(map(half, case.fit)), held_out=tuple(map(half, case.held_out))))
    assert decided(other) == decided(found)
    assert (np.abs(values(other) - values(found)) < 5 * np.hypot(deviations(other), deviations(found))).all()
    assert (deviations(other) > deviations(found)).all()


def test_channels_in_another_order_only_permute():
    """Two masses, a bias in the second sensor; by a state space, whose outputs are as they come."""
    A = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-900.0, 500.0, -1.5, 0.5], [500.0, -500.0, 0.5, -0.5]])
    B, C = np.array([[0.0], [0.0], [0.0], [1.0]]), np.eye(4)[:2]
    rng, records = np.random.default_rng(3103), []
    exact = control.c2d(control.ss(A, B, C, 0), 0.01)
    for level in (1.0, 3.0, 2.0):
        u = level * rng.standard_normal(700)
        y = control.forced_response(exact, np.arange(700) * 0.01, u).outputs.T
        y = y * [1.0, 1.3] + 0.01 * y.std(axis=0) * rng.standard_normal(y.shape)
        records.append((u, y))
    system = control.ss(A, B, C, 0)
    turned = control.ss(A, B, C[::-1], 0)
    results = []
    for order, model in (([0, 1], system), ([1, 0], turned)):
        first, second, held_out = (okid.Record(u, y[:, order], 0.01) for u, y in records)
        results.append(diagnosed(model, [first, second], held_out, sensor_kind="displacement"))
    one, other = results
    assert one.status == other.status
    swap = {"output_0": "output_1", "output_1": "output_0"}
    assert [(f.effect, f.where) for f in one.findings] == [
        (f.effect, swap.get(f.where, f.where)) for f in other.findings
    ]
    assert ("sensor_gain", "output_1") in [(f.effect, f.where) for f in one.findings]
    np.testing.assert_allclose(values(other), values(one), rtol=1e-3)
    np.testing.assert_allclose(np.asarray(other.gap_after)[:, ::-1], one.gap_after, rtol=1e-3)
