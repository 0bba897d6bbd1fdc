"""A wrongly declared hold, with records that a simulation loop wrote down, as people do."""

import math
from dataclasses import replace

import numpy as np
import pytest
from nonlinear_chain import run_chain

import modal
import okid
from modal.discrepancy import CATALOGUE, diagnose
from modal.discrepancy.results import LackOfFit
from modal.discrepancy.validation.other_hold import hold_words
from modal.structure.structural_model import StructuralModel
from okid.record import Record

DT, SUBSTEPS, FRICTION = 0.02, 20, 0.5


def loop_record(sines, *, written, n=400, hold="zero_order"):
    """One mass of 1 kg on 100 N/m with friction, stepped by semi-implicit Euler under a held force.

    `written` "before" or "after" each step: after it, the output is a sample older than its input.
    """
    time = np.arange(n) * DT
    force = sum(size * np.sin(speed * time + start) for size, speed, start in sines)
    x = v = 0.0
    outputs = np.empty(n)
    for k, u in enumerate(force.tolist()):
        if written == "before":
            outputs[k] = x
        for _ in range(SUBSTEPS):
            v += DT / SUBSTEPS * (u - 0.4 * v - 100.0 * x - (math.copysign(FRICTION, v) if v else 0.0))
            x += DT / SUBSTEPS * v
        if written == "after":
            outputs[k] = x
    return Record(force, outputs, DT, input_names=["force"], output_names=["tip"], input_hold=hold)


def loop_diagnosis(written, hold):
    sines = (((3, 8.0, 1), (2, 12.3, 0)), ((6, 9.0, 1), (3, 5.1, 0)), ((4, 7.1, 1), (3, 11.2, 0)))
    *fit, held_out = (loop_record(one, written=written, hold=hold) for one in sines)
    model = StructuralModel.chain([1.0], [100.0], [0.4], force_dofs=[0], sensor_dofs=[0])
    rivals = ("coulomb_friction", "input_delay", "missing_mode")
    return diagnose(model, fit, held_out, catalogue={key: CATALOGUE[key] for key in rivals})


@pytest.mark.parametrize(("written", "samples"), [("after", -1.0)])
def test_friction_is_found_in_what_a_loop_wrote_down_and_how_early_its_outputs_are(written, samples):
    """Semi-implicit steps are half a step early by themselves, 0.5 ms here."""
    found = loop_diagnosis(written, "zero_order")
    values = {one.effect: one.parameters[0].value for one in found.findings}
    assert found.status == "named"
    assert set(values) == {"coulomb_friction", "input_delay"}
    assert values["coulomb_friction"] == pytest.approx(FRICTION, rel=0.003)
    assert values["input_delay"] == pytest.approx(samples * DT - 0.5 * DT / SUBSTEPS, abs=2e-5)
    assert any("before it is recorded" in words for words in found.warnings)


def test_a_wrong_hold_is_taken_back_instead_of_a_mode_that_stands_in_for_it():
    found = loop_diagnosis("before", "band_limited")
    assert found.status == "named"
    assert {one.effect for one in found.findings} == {"coulomb_friction", "input_delay"}
    assert 'declare input_hold="zero_order"' in found.warnings[1]
    assert all(record.input_hold == "zero_order" for record in (*found.fit, *found.held_out))


def test_a_hold_that_leaves_less_than_any_effect_is_taken_back_too():
    """Straight lines between samples, declared band limited: 0.2 % of the outputs at 250 samples a second."""
    rng, dt, steps = np.random.default_rng(1), 0.004, 4
    spectrum = np.fft.rfft(rng.standard_normal((3, 4000)))
    spectrum[:, np.fft.rfftfreq(4000, dt) > 18.0] = 0.0
    force = np.fft.irfft(spectrum, 4000)[:, :1500]
    force *= np.array([[20.0], [60.0], [40.0]]) / force.std(axis=1, keepdims=True)

    def slope(x, u):
        d, v = x.reshape(2, -1)
        return np.concatenate([v, (u - 4.0 * v - 4000.0 * d) / 3.0])

    x, found = np.zeros(6), np.empty((3, 1500))
    for k in range(1500):
        found[:, k] = slope(x, force[:, k])[3:]
        for i in range(steps if k < 1499 else 0):
            at = [force[:, k] + (i + part) / steps * (force[:, k + 1] - force[:, k]) for part in (0.0, 0.5, 1.0)]
            h = dt / steps
            a = slope(x, at[0])
            b = slope(x + h / 2 * a, at[1])
            c = slope(x + h / 2 * b, at[1])
            x = x + h / 6 * (a + 2 * b + 2 * c + slope(x + h * c, at[2]))
    found += 0.002 * found.std(axis=1, keepdims=True) * rng.standard_normal(found.shape)
    *fit, held_out = (Record(u, y, dt, input_hold="band_limited") for u, y in zip(force, found, strict=True))
    model = StructuralModel.chain([3.0], [4100.0], [3.5], force_dofs=[0], sensor_dofs=[0], sensor_kind="acceleration")
    few = {key: CATALOGUE[key] for key in ("cubic_stiffness", "input_delay")}
    diagnosis = diagnose(model, fit, held_out, catalogue=few)
    assert (diagnosis.status, diagnosis.findings) == ("none", ())
    assert 'declare input_hold="linear"' in diagnosis.warnings[0]
    assert diagnosis.detection_limits
    assert not any(words.startswith("Check the hold") for words in diagnosis.advice)
    left = LackOfFit(kind="input", where="force", p_value=1e-9, share=0.02, size=0.002)
    assert hold_words(replace(diagnosis, lack_of_fit=(left,))).startswith("Check the hold")


def driven_frame(delay, *, n, fine=8, dt=0.01, level=(4.0, 15.0, 8.0)):
    """Two masses, a cubic spring between them, a force below 9 Hz; held between samples (delay None) or late by a time.

    A late force is the band-limited one itself, followed at `fine` steps a sample by the reference integrator.
    """
    rng, size = np.random.default_rng(6), fine * n
    spectrum = np.zeros((3, size // 2 + 1), dtype=complex)
    frequency = np.fft.rfftfreq(size, dt / fine)
    there = (frequency > 0.2) & (frequency < 9.0)
    spectrum[:, there] = np.exp(2j * np.pi * rng.random((3, there.sum())))
    forces = np.fft.irfft(spectrum, size)
    scale = np.array(level)[:, np.newaxis] / forces.std(axis=1, keepdims=True)
    force = scale * forces[:, ::fine]
    if delay is None:
        outputs = run_chain([1.2, 0.8], [420.0, 360.0], [0.8, 0.6], force, dt, law=cubic, element=1)
    else:
        late = np.fft.irfft(spectrum * np.exp(-2j * np.pi * frequency * (delay - dt / fine / 2)), size)
        outputs = run_chain([1.2, 0.8], [420.0, 360.0], [0.8, 0.6], scale * late, dt / fine, law=cubic, element=1)
        outputs = outputs[:, ::fine]
    outputs = outputs + 0.01 * outputs.std(axis=1, keepdims=True) * rng.standard_normal(outputs.shape)
    return [
        Record(u, y, dt, input_names=["force"], input_hold="band_limited") for u, y in zip(force, outputs, strict=True)
    ]


def cubic(d, _v, _t):
    return 25000.0 * d**3


def frame_diagnosis(delay, n=700):
    *fit, held_out = driven_frame(delay, n=n)
    model = StructuralModel.chain([1.2, 0.8], [400.0, 360.0], [0.8, 0.5], force_dofs=[0], sensor_dofs=[0, 1])
    return diagnose(model, fit, held_out, catalogue={key: CATALOGUE[key] for key in ("cubic_stiffness", "input_delay")})


def test_a_wrong_hold_is_no_delay_where_the_delay_leaves_something_of_the_input():
    found = frame_diagnosis(None)
    assert (found.status, [one.effect for one in found.findings]) == ("named", ["cubic_stiffness"])
    assert 'declare input_hold="zero_order" (in the command --hold zero_order)' in found.warnings[0]


def test_a_delay_of_half_a_sample_stays_a_delay_where_the_hold_is_right():
    found = frame_diagnosis(0.005, n=400)
    values = {one.effect: one.parameters[0].value for one in found.findings}
    assert values["input_delay"] == pytest.approx(0.005, rel=0.02)
    assert values["cubic_stiffness"] == pytest.approx(25000.0, rel=0.01)
    assert all(record.input_hold == "band_limited" for record in found.fit)


@pytest.mark.parametrize(("gain", "words"), [(1 / 9.80665, "looks like g taken for m/s^2"), (1.4, "")])
def test_a_gain_of_g_is_named_as_a_unit(gain, words):
    model = modal.StructuralModel.chain(
        [1.0, 1.5], [4000.0, 3000.0], [2.0, 2.0], force_dofs=[1], sensor_dofs=[0, 1], sensor_kind="acceleration"
    )
    records = []
    for seed in (1, 2):
        rng = np.random.default_rng(seed)
        force = rng.standard_normal(1500)
        drive = okid.Record(force, np.zeros((1500, 2)), 0.005, input_names=model.input_names, output_names=["a", "b"])
        clean = np.array(modal.simulate(model, drive).outputs)
        values = (clean + 0.01 * clean.std(axis=0) * rng.standard_normal(clean.shape)) * [gain, 1.0]
        records.append(okid.Record(force, values, 0.005, input_names=model.input_names, output_names=["a", "b"]))
    found = diagnose(model, records[0], records[1])
    assert [one.effect for one in found.findings] == ["sensor_gain"]
    said = [text for text in found.warnings if "unit" in text]
    assert [words in text for text in said] == [True] * bool(words)
