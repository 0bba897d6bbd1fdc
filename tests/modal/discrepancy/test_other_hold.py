"""A wrongly declared hold: by hand, and with records that a simulation loop wrote down, as people do."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_by_hand import make_diagnosis

from modal.discrepancy.catalogue import CATALOGUE
from modal.discrepancy.other_hold import by_the_better_hold, half_a_sample, has_half_a_sample, other_hold
from modal.discrepancy.workflow import diagnose
from modal.structure import StructuralModel
from okid.record import Record

ALL = len(CATALOGUE)
DT, SUBSTEPS, FRICTION = 0.02, 20, 0.5


def loop_record(sines, *, written, n=700, hold="zero_order"):
    """One mass of 1 kg on 100 N/m with friction, stepped by semi-implicit Euler under a held force.

    `written` "before" or "after" each step: after it, the output is a sample older than its input.
    """
    time = np.arange(n) * DT
    force = sum(size * np.sin(speed * time + start) for size, speed, start in sines)
    x = v = 0.0
    outputs = np.empty(n)
    for k, u in enumerate(force):
        if written == "before":
            outputs[k] = x
        for _ in range(SUBSTEPS):
            v += DT / SUBSTEPS * (u - 0.4 * v - 100.0 * x - FRICTION * np.sign(v))
            x += DT / SUBSTEPS * v
        if written == "after":
            outputs[k] = x
    return Record(force, outputs, DT, input_names=["force"], output_names=["tip"], input_hold=hold)


def loop_diagnosis(written, hold):
    sines = (((3, 8.0, 1), (2, 12.3, 0)), ((6, 9.0, 1), (3, 5.1, 0)), ((4, 7.1, 1), (3, 11.2, 0)))
    *fit, held_out = (loop_record(one, written=written, hold=hold) for one in sines)
    model = StructuralModel.chain([1.0], [100.0], [0.4], force_dofs=[0], sensor_dofs=[0])
    return diagnose(model, fit, held_out)


@pytest.mark.parametrize(("written", "samples"), [("before", 0.0), ("after", -1.0)])
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


@pytest.mark.parametrize(
    ("samples", "said"),
    [(0.5, True), (-0.5, True), (3.3, True), (-1.6, True), (0.0, False), (0.2, False), (-1.0, False)],
)
def test_half_a_sample_off_whole_ones(samples, said):
    assert half_a_sample(samples * 0.01, 0.01) == said


# --- by hand ---------------------------------------------------------------------------------------------------------


def by_hand(hold, *, level, delay=None, n_effects=1):
    """A diagnosis of records with that hold, at `level` times the floor, with a delay in samples beside its effects."""
    found = make_diagnosis(status="named", n_effects=n_effects)
    fit, held_out = (tuple(replace(one, input_hold=hold) for one in some) for some in (found.fit, found.held_out))
    steps = (*found.steps[:-1], replace(found.steps[-1], held_out_level=level))
    findings = found.findings
    if delay is not None:
        tau = replace(findings[0].parameters[0], name="tau", value=delay * found.fit[0].dt, unit="s")
        findings = (*findings, replace(findings[0], effect="input_delay", where="force", parameters=(tau,)))
    return replace(found, fit=fit, held_out=held_out, steps=steps, findings=findings, warnings=())


def chosen(declared, other):
    """The hold that is taken, and whether the other one was tried."""
    tried = []

    def again(fit, held_out, catalogue):
        assert {one.input_hold for one in (*fit, *held_out)} == {other_hold(declared.fit[0].input_hold)}
        tried.append(set(catalogue))
        return other

    found = by_the_better_hold(declared, again, CATALOGUE)
    return found.fit[0].input_hold, [len(one) for one in tried]


def test_the_other_hold_is_tried_only_beside_half_a_sample_of_delay():
    other = by_hand("linear", level=1.0, n_effects=1)
    assert not has_half_a_sample(by_hand("zero_order", level=1.0))
    assert chosen(by_hand("zero_order", level=9.0), other) == ("zero_order", [])
    assert chosen(by_hand("zero_order", level=9.0, delay=1.0), other) == ("zero_order", [])
    assert chosen(by_hand("zero_order", level=9.0, delay=0.5), other) == ("linear", [ALL])


@pytest.mark.parametrize("declared", ["zero_order", "linear", "band_limited"])
@pytest.mark.parametrize(
    ("first", "second", "taken"),  # of each the level and how many effects beside the delay
    [
        ((1.0, 1), (1.0, 1), False),  # both explain, the delay is all that differs: what was declared stands
        ((1.0, 2), (1.0, 1), True),  # one effect fewer
        ((1.0, 1), (1.0, 2), False),
        ((9.0, 1), (1.0, 2), True),  # only the other explains
        ((9.0, 2), (8.0, 1), False),  # neither does
    ],
)
def test_the_hold_that_needs_less_is_taken(declared, first, second, taken):
    found = by_hand(declared, level=first[0], delay=0.5, n_effects=first[1])
    other = by_hand(other_hold(declared), level=second[0], n_effects=second[1])
    few = [first[1] + 1] if first[0] == 1.0 else []  # the same effects are enough where they explain the records
    hold = other_hold(declared) if taken else declared
    assert chosen(found, other) == (hold, [*few, *[ALL] * (taken or not few)])


def test_the_reader_is_told_which_hold_was_taken_and_why():
    found = by_the_better_hold(
        by_hand("linear", level=1.0, delay=-0.5, n_effects=2), lambda *_: by_hand("zero_order", level=1.0), CATALOGUE
    )
    assert "declared linear, but as zero_order" in found.warnings[0]
    assert 'declare input_hold="zero_order"' in found.warnings[0]
