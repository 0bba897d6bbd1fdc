"""Where a refinement starts: exact on noise-free data, ridge least squares by an explicit matrix on noisy data."""

from dataclasses import replace

import numpy as np
import pytest
from systems import initial_state, random_system, simulate
from textbook_output_error import loop_run, loop_sensitivities, random_loop_model

from era.realisation import Realisation
from modal.estimation import free_run as initial_fit
from modal.estimation.modal_parameters import starting_parameters
from modal.estimation.modal_states import blocks_of
from modal.estimation.output_error import OutputError
from okid.record import Record

REGULARISATION = 1e-9


def data_of(records, rows=None, held_out=()):
    rows = [np.ones(record.n_samples, dtype=bool) for record in records] if rows is None else rows
    return OutputError(records=tuple(records), rows=tuple(rows), blocks=blocks_of(records, held_out))


@pytest.mark.parametrize("seed", range(4))
def test_the_true_model_starts_without_error(seed):
    """Several records, unknown initial states and levels, gaps, a real pole: nothing is left, and x(0) is the true."""
    rng = np.random.default_rng(seed)
    truth = random_system(rng, n_modes=2, n_real_poles=seed % 2, n_inputs=2, n_outputs=2, damping_range=(0.01, 0.05))
    records, rows, states = [], [], []
    for n in (300, 200):
        u = rng.standard_normal((n, 2))
        states.append(initial_state(rng, truth, u))
        y = simulate(truth, u, initial_state=states[-1]) + rng.standard_normal(2)
        rows.append(rng.random(n) > 0.1)
        y[~rows[-1]] = 1e3  # what does not count may be anything
        records.append(Record(u, y, truth.dt))
    data = data_of(records, rows)
    start = starting_parameters(Realisation(truth.A, truth.B, truth.C, truth.D, truth.dt), data)
    power = sum(np.square(record.outputs[there]).sum() for record, there in zip(records, rows, strict=True))
    assert start.error < 1e-13 * power
    order = np.argsort(np.abs(np.log(start.parameters.poles)))
    np.testing.assert_allclose(start.parameters.poles[order], truth.discrete_poles, rtol=1e-9)
    values, vectors = np.linalg.eig(truth.A)
    for r, state in enumerate(states):
        psi = np.linalg.solve(vectors, state)
        for i, pole in enumerate(start.parameters.poles):
            own = int(np.argmin(np.abs(values - pole)))
            residue = np.outer(truth.C @ vectors[:, own], psi[own]) * (2 if pole.imag > 0 else 1)
            found = start.linear.shapes[:, [i]] * start.parameters.states[r, i]
            np.testing.assert_allclose(found, residue, rtol=0, atol=1e-6 * np.abs(residue).max())


def test_poles_at_zero_only_cannot_start():
    """y(k) = u(k-1) has a mode that no refinement can move: there would be nothing to solve for."""
    u = np.random.default_rng(0).standard_normal((100, 1))
    data = data_of([Record(u, np.vstack([np.zeros((1, 1)), u[:-1]]), 0.01)])
    assert starting_parameters(Realisation([[0.0]], [[1.0]], [[1.0]], [[0.0]], 0.01), data) is None


@pytest.mark.parametrize("ridge", [REGULARISATION, 0.01])
@pytest.mark.parametrize("n_real", [0, 1])
def test_initial_states_are_ridge_least_squares_on_what_the_inputs_leave(monkeypatch, n_real, ridge):
    """Shapes and feedthrough held; the ridge relative to each free response's energy over the whole record."""
    if ridge != REGULARISATION:  # large enough to be seen
        monkeypatch.setattr(initial_fit, "STATE_REGULARISATION", ridge)
    rng = np.random.default_rng(7 + n_real)
    model = random_loop_model(rng, n_pairs=2, n_real=n_real, n_inputs=1, n_outputs=2, n_records=2)
    inputs = [rng.standard_normal((n, 1)) for n in (60, 40)]
    outputs = [loop_run(model, r, u) + 0.5 * rng.standard_normal((len(u), 2)) for r, u in enumerate(inputs)]
    records = [Record(u, y, 0.1) for u, y in zip(inputs, outputs, strict=True)]
    held_out = [[[(0, 25)], [(20, 30)]]]
    data = data_of(records, held_out=held_out)
    found = starting_parameters(Realisation(*model.realisation, 0.1), data, held_out=0)
    trained = [np.r_[25:60], np.r_[0:20, 30:40]]
    for r, (u, y) in enumerate(zip(inputs, outputs, strict=True)):
        n = model.poles.size
        rest = y - loop_run(_at_rest(model), r, u)
        free = loop_sensitivities(model, r, u)[:, 2 + r]
        columns = np.stack([model.c.T * free[..., np.newaxis], 1j * model.c.T * free[..., np.newaxis]]).real
        columns = columns.transpose(1, 3, 0, 2).reshape(len(u), 2, 2 * n)
        energy = 0.5 * np.tile(np.square(np.abs(model.c)).sum(axis=0) * np.square(np.abs(free)).sum(axis=0), 2)
        J = np.concatenate([columns[trained[r], o] for o in range(2)])
        e = np.concatenate([rest[trained[r], o] for o in range(2)])
        levels = np.kron(np.eye(2), np.ones((trained[r].size, 1)))
        # the level has the same ridge, relative to its own energy on the rows that count
        project = np.eye(e.size) - levels @ levels.T / ((1.0 + ridge) * trained[r].size)
        matrix = J.T @ project @ J + ridge * np.diag(energy)
        x = np.linalg.lstsq(matrix, J.T @ project @ e, rcond=1e-14)[0]
        expected = x[:n] + 1j * x[n:]
        for i, pole in enumerate(found.parameters.poles):
            own = int(np.argmin(np.abs(model.poles - pole)))
            # b of the start is that of the model times a factor, and so is the state
            factor = found.parameters.inputs[i, 0] / model.b[own, 0]
            np.testing.assert_allclose(found.parameters.states[r, i] / factor, expected[own], rtol=1e-6)


def _at_rest(model):
    return replace(model, starts=np.zeros_like(model.starts), levels=np.zeros_like(model.levels))


def test_held_out_outputs_do_not_count():
    rng = np.random.default_rng(3)
    truth = random_system(rng, n_modes=2, n_inputs=1, n_outputs=2)
    u = rng.standard_normal((300, 1))
    y = simulate(truth, u, initial_state=initial_state(rng, truth, u)) + 0.1 * rng.standard_normal((300, 2))
    other = y.copy()
    other[100:150] += 1e3
    model = Realisation(truth.A, truth.B, truth.C, truth.D, truth.dt)
    both = [data_of([Record(u, values, truth.dt)], held_out=[[[(100, 150)]]]) for values in (y, other)]
    first, second = (starting_parameters(model, data, held_out=0) for data in both)
    np.testing.assert_array_equal(first.parameters.states, second.parameters.states)
    np.testing.assert_array_equal(first.linear.coefficients, second.linear.coefficients)


def test_a_response_that_no_training_row_shows_stays_small():
    """A strongly damped mode is over before the first row that counts: its initial state is not made up."""
    rng = np.random.default_rng(4)
    pole = 0.3
    u = rng.standard_normal((100, 1))
    model = Realisation([[pole]], [[1.0]], [[1.0]], [[0.0]], 0.1)
    y, x = np.empty((100, 1)), 0.0
    for k in range(100):
        y[k] = x + 0.1 * rng.standard_normal()
        x = pole * x + u[k, 0]
    start = starting_parameters(model, data_of([Record(u, y, 0.1)], held_out=[[[(0, 30)]]]), held_out=0)
    assert np.abs(start.parameters.states).max() < 1e-3


def test_what_cannot_start():
    u = np.sin(np.arange(40.0))[:, np.newaxis]
    data = data_of([Record(u, u, 0.1)])
    one, zero = np.ones((1, 1)), np.zeros((1, 1))
    for pole in (1.0, -1.0, 1.5):
        assert starting_parameters(Realisation(pole * one, one, one, zero, 0.1), data) is None
    rotation = np.array([[np.cos(1.0), -np.sin(1.0)], [np.sin(1.0), np.cos(1.0)]])
    growing = Realisation(1.001 * rotation, np.ones((2, 1)), np.ones((1, 2)), zero, 0.1)
    assert starting_parameters(growing, data) is None
    assert starting_parameters(Realisation(np.zeros((0, 0)), one[:0], one[:, :0], zero, 0.1), data) is None


def test_deadbeat_poles_and_undriven_modes_are_no_harm():
    rng = np.random.default_rng(5)
    u = rng.standard_normal((80, 1))
    y = np.roll(u, 1, axis=0) + 0.1 * rng.standard_normal((80, 1))
    delay = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.8]])
    model = Realisation(delay, [[0.0], [1.0], [0.0]], [[1.0, 0.0, 1.0]], [[0.0]], 0.1)
    start = starting_parameters(model, data_of([Record(u, y, 0.1)]))
    np.testing.assert_allclose(start.parameters.poles, [0.8], rtol=1e-6)
    assert np.all(np.isfinite(start.linear.coefficients))
