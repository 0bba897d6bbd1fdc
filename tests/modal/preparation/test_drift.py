import numpy as np
import pytest
from containers import realisation_of
from signals import random_inputs, with_noise
from systems import initial_state, modal_system, sampled, simulate, structure

import era
from modal.preparation.drift import (
    CANDIDATES,
    choose_drift,
    held_out_squares,
    is_significant,
    slow_functions,
    slow_motion,
    summed_inputs,
    without_drift,
)
from modal.preparation.integrators import choose_integrators, given_integrators, with_integrators
from okid.errors import InvalidDataError
from okid.record import Record

N = 3000
TIME = np.linspace(-1.0, 1.0, N)


def drifting(seed, drift, *, size=1.0, noise=0.03, real_poles=()):
    """Two modes in three outputs, of which the last does not drift."""
    rng = np.random.default_rng(seed)
    system = modal_system(rng, frequencies=[6.0, 21.0], damping_ratios=[0.02, 0.015], real_poles=real_poles)
    inputs = random_inputs(rng, N, 2)
    outputs = with_noise(rng, simulate(system, inputs, initial_state=initial_state(rng, system, inputs)), noise)
    return Record(inputs, outputs + size * outputs.std(axis=0) * np.outer(drift, [1.0, -0.5, 0.0]), system.dt)


@pytest.mark.parametrize("size", [0.1, 0.5, 3.0])
def test_a_straight_line_is_found(size):
    found = choose_drift([drifting(1, TIME, size=size)])
    assert found.n_functions == 1
    assert found.choice.value == "a straight line"


def test_a_slow_wave_is_found():
    found = choose_drift([drifting(2, np.sin(5.0 * TIME + 1.0))])
    assert 3 <= found.n_functions <= max(CANDIDATES)
    assert "half-waves" in found.choice.value


@pytest.mark.parametrize("seed", range(4))
def test_what_the_inputs_explain_is_no_drift(seed):
    """Slow real poles and a free decay from the initial state are the system's own."""
    record = drifting(seed, 0.0 * TIME, noise=[0.02, 0.2][seed % 2], real_poles=[-0.5, -2.0])
    assert choose_drift([record]).n_functions == 0


def test_each_record_has_its_own_drift():
    lines = [drifting(5, TIME).samples(0, 1500), drifting(5, TIME).samples(1500)]
    assert choose_drift(lines).n_functions == 1


def test_without_inputs_nothing_is_taken_off_by_itself():
    found = choose_drift([drifting(1, TIME).select(inputs=[])])
    assert found.n_functions == 0
    assert "without inputs" in found.choice.reason


@pytest.mark.parametrize("n_functions", [0, 1, 2, 6])
def test_slow_functions_go_and_the_relation_stays(n_functions):
    """A static gain keeps its value exactly; a second pass changes nothing; gaps stay gaps."""
    rng = np.random.default_rng(6)
    force = rng.standard_normal(600)
    drift = slow_functions(600, n_functions) @ rng.standard_normal(1 + n_functions)
    position = 2.0 * force + 50.0 * drift
    freed = without_drift(Record(force, position, 0.1), n_functions)
    np.testing.assert_allclose(freed.outputs, 2.0 * freed.inputs, atol=1e-9)
    np.testing.assert_allclose(without_drift(freed, n_functions).outputs, freed.outputs, atol=1e-9)
    position[100:140] = np.nan
    gaps = without_drift(Record(0.0 * force + TIME[:600], position, 0.1), n_functions)
    assert np.isnan(gaps.outputs[:, 0]).sum() == 40


def test_slow_functions_are_polynomials_first():
    values = slow_functions(50, 2)
    for degree in range(3):
        power = np.arange(50.0) ** degree
        rest = power - values[:, : degree + 1] @ np.linalg.lstsq(values[:, : degree + 1], power, rcond=None)[0]
        assert np.abs(rest).max() < 1e-9 * max(1.0, power.max())


def test_short_records_get_fewer_functions():
    rng = np.random.default_rng(7)
    values = rng.standard_normal(60)
    short = without_drift(Record(values, values, 0.1), 12)
    expected = without_drift(Record(values, values, 0.1), 1)
    np.testing.assert_allclose(short.outputs, expected.outputs, atol=1e-12)


@pytest.mark.parametrize("lengths", [[50] * 700, [300] + [40] * 1000])
def test_hundreds_of_short_records_leave_groups_to_compare(lengths):
    """Two at least: a standard error needs as many."""
    rng = np.random.default_rng(8)
    left = slow_motion([rng.standard_normal((length, 2)) for length in lengths])
    assert held_out_squares(left, 1).size >= 2
    assert held_out_squares(left, 0).sum() > 0.0


def test_significance_knows_no_unit():
    gain = np.array([1.0, 1.2, 0.9, 1.1])
    with np.errstate(all="raise"):
        assert [is_significant(scale * gain, 3.0) for scale in (1.0, 1e300, 1e-300)] == [True] * 3
        assert not is_significant(1e300 * np.array([1.0, -1.2, 0.9, -1.1]), 3.0)
        assert not is_significant(np.zeros(4), 3.0)


def free_masses(sensor_kind):
    """Two masses joined by a spring, free in space: one mode at 8 Hz and a rigid body."""
    squared = (2 * np.pi * 8.0) ** 2
    stiffness = squared / 1.5 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    damping = stiffness * 0.04 / (2 * np.pi * 8.0)
    return structure(
        np.diag([1.0, 2.0]), damping, stiffness, force_dofs=[0], sensor_dofs=[0, 1], sensor_kinds=sensor_kind, dt=0.01
    )


def tank():
    """A mode, and a level that sums what flows in; both in both outputs."""
    squared = (2 * np.pi * 8.0) ** 2
    A = np.array([[0.0, 1.0, 0.0], [-squared, -2.0, 0.0], [0.0, 0.0, 0.0]])
    return sampled(
        A, np.array([[0.0], [squared], [20.0]]), np.array([[1.0, 0, 1], [0.5, 0, -0.3]]), np.zeros((2, 1)), dt=0.01
    )


def record_of(rng, system, noise=0.02):
    inputs = random_inputs(rng, 3000, system.n_inputs)
    return Record(inputs, with_noise(rng, simulate(system, inputs), noise), system.dt)


@pytest.mark.parametrize(
    ("system", "number"),
    [(free_masses("velocity"), 1), (free_masses("displacement"), 2), (free_masses("acceleration"), 0), (tank(), 1)],
)
def test_integrators_are_counted(system, number):
    assert choose_integrators([record_of(np.random.default_rng(1), system).detrended()]).number == number


@pytest.mark.parametrize("drift", [0.0, 2.0])
def test_a_stable_system_has_none_even_where_a_sensor_drifts(drift):
    rng = np.random.default_rng(3)
    system = modal_system(rng, frequencies=[6.0, 21.0], damping_ratios=[0.02, 0.015], real_poles=[-1.0])
    record = record_of(rng, system)
    outputs = record.outputs + drift * record.outputs.std(axis=0) * np.linspace(-1.0, 1.0, 3000)[:, np.newaxis]
    assert choose_integrators([Record(record.inputs, outputs, 0.01).detrended()]).number == 0


@pytest.mark.parametrize("number", [0, 1, 2])
def test_the_model_with_integrators_sums_its_inputs(number):
    rng = np.random.default_rng(4)
    system = modal_system(rng, frequencies=[6.0], damping_ratios=[0.02])
    inputs = random_inputs(rng, 100, 2)
    summed = inputs
    for _ in range(number):
        summed = np.cumsum(summed, axis=0)
    truth = simulate(system, summed)
    model = with_integrators(realisation_of(system), number)
    outputs = era.simulate(model, Record(inputs, truth, system.dt)).outputs
    np.testing.assert_allclose(outputs, truth, atol=1e-10 * np.abs(truth).max())
    assert model.order == system.order + 2 * number
    assert (np.abs(np.linalg.eigvals(model.A) - 1.0) < 1e-6).sum() == 2 * number


def test_sums_are_of_inputs_about_their_mean():
    inputs = np.random.default_rng(5).standard_normal((40, 2)) + 3.0
    record = Record(inputs, np.zeros(40), 0.1)
    np.testing.assert_allclose(summed_inputs(record, 1).inputs[-1], 0.0, atol=1e-12)
    np.testing.assert_allclose(np.diff(summed_inputs(record, 1).inputs, axis=0), (inputs - inputs.mean(axis=0))[1:])
    assert summed_inputs(record, 0) is record


def test_a_given_number_is_checked():
    assert given_integrators(2).number == 2
    with pytest.raises(InvalidDataError, match="at most 2 integrators"):
        given_integrators(3)
    with pytest.raises(InvalidDataError, match="integrators"):
        given_integrators(-1)
