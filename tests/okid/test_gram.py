"""The structured Gram matrix against V V' written out, and its algebra."""

import os
import signal
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import okid
from okid import gram as gram_module
from okid.errors import ExecutorError, InvalidDataError
from okid.gram import chunked_gram, lag_gram, turn_gram
from okid.record import Record
from okid.scaling import channel_scaling


def naive_regressors(records, order, scaling, masks=None):
    """phi(k) row by row, as the definition says."""
    rows = []
    for number, record in enumerate(records):
        u = (record.inputs - scaling.input_mean) / scaling.input_scale
        y = (record.outputs - scaling.output_mean) / scaling.output_scale
        z = np.hstack([u, y])
        for k in range(order, len(z)):
            if masks is not None and not masks[number][k]:
                continue
            row = np.concatenate([[1.0], *[z[k - j] for j in range(order + 1)]])
            if not np.isnan(row).any():
                rows.append(row)
    return np.array(rows).reshape(len(rows), 1 + (order + 1) * (records[0].n_inputs + records[0].n_outputs))


def make(rng, n_samples, n_inputs, n_outputs, *, missing=0, missing_inputs=0):
    u = rng.standard_normal((n_samples, n_inputs)) * 3 + 100
    y = np.cumsum(rng.standard_normal((n_samples, n_outputs)), axis=0) - 1e4
    y[rng.integers(0, n_samples, missing), rng.integers(0, n_outputs, missing)] = np.nan
    if n_inputs:
        u[rng.integers(0, n_samples, missing_inputs), 0] = np.nan
    return Record(u, y, 0.1)


def assert_gram_is_naive(records, order, masks=None):
    scaling = channel_scaling(records)
    gram = lag_gram(records, order, scaling=scaling, rows=masks)
    V = naive_regressors(records, order, scaling, masks)
    expected = V.T @ V
    assert gram.n_rows == len(V)
    assert np.abs(gram.matrix - expected).max() <= 1e-12 * max(np.abs(expected).max(), 1.0)
    assert np.abs(gram.matrix - gram.matrix.T).max() <= 1e-13 * max(np.abs(expected).max(), 1.0)


@pytest.mark.parametrize(
    ("sizes", "n_inputs", "n_outputs", "order", "missing", "missing_inputs"),
    [
        ([400], 2, 3, 7, 0, 0),
        ([400], 1, 1, 1, 0, 0),
        ([500], 2, 2, 8, 3, 3),
        ([300, 200, 9, 3], 2, 2, 6, 0, 0),  # one record shorter than the order
        ([600, 300], 2, 2, 5, 12, 0),
        ([300], 0, 2, 4, 3, 0),
        ([900], 3, 5, 40, 4, 0),
    ],
)
def test_equals_regressors_written_out(sizes, n_inputs, n_outputs, order, *, missing, missing_inputs):
    rng = np.random.default_rng(len(sizes) * 100 + order)
    lost = {"missing": missing, "missing_inputs": missing_inputs}
    records = [make(rng, n, n_inputs, n_outputs, **(lost if n > 50 else {})) for n in sizes]
    assert_gram_is_naive(records, order)
    assert_gram_is_naive(records, order, [rng.random(n) < 0.7 for n in sizes])
    blocks = [np.repeat(rng.random(-(-n // 50)) < 0.5, 50)[:n] for n in sizes]
    assert_gram_is_naive(records, order, blocks)


def test_hundreds_of_short_runs_are_folded_in_several_batches(monkeypatch):
    monkeypatch.setattr("okid.gram._EDGE_VALUES", 200)
    assert_gram_is_naive([make(np.random.default_rng(5), 800, 1, 2, missing=60)], 3)


def test_chunks_of_one_block_give_the_same(monkeypatch):
    monkeypatch.setattr("okid.gram.CACHE_VALUES", 1)
    rng = np.random.default_rng(6)
    assert_gram_is_naive([make(rng, 1500, 2, 2, missing=5)], 6, [rng.random(1500) < 0.9])


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**31), n_samples=st.integers(12, 300), order=st.integers(1, 10), n_channels=st.integers(1, 4)
)
def test_any_shape_and_any_mask(seed, n_samples, order, n_channels):
    rng = np.random.default_rng(seed)
    record = make(rng, n_samples, n_channels - 1, 1, missing=int(rng.integers(0, 4)))
    assert_gram_is_naive([record], order, [rng.random(n_samples) < rng.random()])


def test_disjoint_masks_add_up_to_the_whole():
    rng = np.random.default_rng(7)
    records = [make(rng, 300, 2, 2), make(rng, 200, 2, 2)]
    scaling = channel_scaling(records)
    mask = [rng.random(record.n_samples) < 0.4 for record in records]
    whole = lag_gram(records, 5, scaling=scaling)
    part = lag_gram(records, 5, scaling=scaling, rows=mask)
    rest = lag_gram(records, 5, scaling=scaling, rows=[~m for m in mask])
    assert (whole - part).n_rows == rest.n_rows
    assert (part + rest).n_rows == whole.n_rows
    assert np.abs((whole - part).matrix - rest.matrix).max() < 1e-11 * whole.n_rows
    assert np.abs((part + rest).matrix - whole.matrix).max() < 1e-11 * whole.n_rows


def test_truncated_is_the_leading_part():
    record = make(np.random.default_rng(8), 200, 1, 2)
    scaling = channel_scaling([record])
    gram = lag_gram([record], 6, scaling=scaling)
    V = naive_regressors([record], 6, scaling)[:, : 1 + 3 * 3]
    assert gram.truncated(2).n_rows == 194
    assert np.abs(gram.truncated(2).matrix - V.T @ V).max() < 1e-11 * 194
    assert np.array_equal(gram.truncated(6).matrix, gram.matrix)
    assert np.array_equal(gram.truncated(0).matrix, gram.matrix[:4, :4])
    with pytest.raises(InvalidDataError, match="holds orders 0 to 6, not 7"):
        gram.truncated(7)


def test_a_mapped_file_gives_what_the_array_gives(tmp_path):
    rng = np.random.default_rng(9)
    values = rng.standard_normal((5000, 3))
    path = tmp_path / "samples.npy"
    np.save(path, values)
    mapped = np.load(path, mmap_mode="r")
    on_disk, in_memory = Record(mapped[:, :1], mapped[:, 1:], 0.1), Record(values[:, :1], values[:, 1:], 0.1)
    matrices = [lag_gram([r], 10, scaling=channel_scaling([r])).matrix for r in (on_disk, in_memory)]
    assert np.abs(matrices[0] - matrices[1]).max() < 1e-10


def test_masks_must_fit():
    record = make(np.random.default_rng(10), 50, 1, 1)
    with pytest.raises(InvalidDataError, match=r"lengths \[50\], but have shapes \[\(49,\)\]"):
        lag_gram([record], 2, scaling=channel_scaling([record]), rows=[np.ones(49, bool)])


@pytest.mark.parametrize("offset", [0.0, 1e6, -1e9])
def test_scaling_keeps_its_digits_beside_a_large_mean(offset):
    rng = np.random.default_rng(11)
    drift = np.linspace(0, 5, 40_000)
    values = np.column_stack([rng.standard_normal(40_000) + drift, rng.standard_normal(40_000)])
    values[7, 0] = np.nan
    shifted = values + offset
    scaling = channel_scaling([Record([], shifted[:15_000], 0.1), Record([], shifted[15_000:], 0.1)])
    exact = shifted - offset  # what rounding left of the values
    assert np.allclose(scaling.output_scale, np.nanstd(exact, axis=0), rtol=1e-12)
    assert np.allclose(scaling.output_mean - offset, np.nanmean(exact, axis=0), atol=1e-15 * abs(offset) + 1e-12)


def test_a_constant_channel_has_scale_one_and_is_listed():
    scaling = channel_scaling([Record(np.full(1000, 0.1), np.arange(1000.0), 0.1)])
    assert scaling.constant_inputs == (0,)
    assert scaling.constant_outputs == ()
    assert scaling.input_scale.tolist() == [1.0]


@pytest.mark.parametrize("n_turns", [2, 3])
@pytest.mark.parametrize("order", [1, 4, 5, 17])
def test_rows_that_take_turns(order, n_turns):
    rng = np.random.default_rng(order)
    records = [Record(rng.standard_normal((n, 2)), rng.standard_normal((n, 3)), 0.1) for n in (301, 200, 4)]
    scaling = channel_scaling(records)
    first = n_turns * -(-(order + 1) // n_turns) - 1  # earlier rows have no whole past of so many samples
    for turn in range(n_turns):
        rows = [(np.arange(r.n_samples) % n_turns == turn) & (np.arange(r.n_samples) >= first) for r in records]
        plain = lag_gram(records, order, scaling=scaling, rows=rows)
        found = turn_gram(records, order, scaling=scaling, n_turns=n_turns, turn=turn)
        assert (found.n_rows, found.n_inputs, found.n_outputs) == (plain.n_rows, 2, 3)
        np.testing.assert_allclose(found.matrix, plain.matrix, atol=1e-10)


def test_gaps_leave_out_the_rows_that_they_touch():
    rng = np.random.default_rng(0)
    outputs = rng.standard_normal(300)
    outputs[100] = np.nan
    record = Record(rng.standard_normal(300), outputs, 0.1)
    found = turn_gram([record], 5, scaling=channel_scaling([record]), n_turns=3, turn=1)
    assert np.isfinite(found.matrix).all()
    assert found.n_rows == sum(k % 3 == 1 and k >= 5 and not 100 <= k <= 105 for k in range(300))


# --- chunks ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("missing", [0, 9])
def test_chunks_by_an_executor_give_the_same_sums(monkeypatch, missing):
    """More chunks than are handed out at once; a record as long as the order and a shorter one have no rows."""
    monkeypatch.setattr(gram_module, "SENT_VALUES", 100)
    rng = np.random.default_rng(22000)
    records = [make(rng, n, 2, 3, missing=missing * (n > 7)) for n in (1001, 7, 4, 333)]
    scaling = channel_scaling(records)
    V = naive_regressors(records, 7, scaling)
    with ThreadPoolExecutor(3) as executor:
        gram = chunked_gram(records, 7, scaling=scaling, executor=executor)
        with pytest.raises(ExecutorError, match="the executor broke"):
            chunked_gram(records, 7, scaling=scaling, executor=Broken(executor, after=5))
    assert gram.n_rows == len(V)
    assert np.abs(gram.matrix - V.T @ V).max() <= 1e-12 * np.abs(V.T @ V).max()


class Broken(Executor):
    """Breaks after some tasks."""

    def __init__(self, executor, after):
        self.executor, self.left = executor, after

    def submit(self, function, *arguments):
        self.left -= 1
        if self.left >= 0:
            return self.executor.submit(function, *arguments)
        lost = Future()
        lost.set_exception(RuntimeError("lost"))
        return lost


class Counting(Executor):
    """Hands tasks on and weighs them; ends a process at one of them."""

    def __init__(self, executor, end_at=None):
        self.executor, self.end_at, self.sizes = executor, end_at, []

    def submit(self, function, *arguments):
        self.sizes.append(sum(getattr(part, "nbytes", 0) for part in arguments[0]))
        if len(self.sizes) == self.end_at:
            self.executor.submit(os.kill, next(iter(self.executor._processes)), signal.SIGKILL)
        return self.executor.submit(function, *arguments)


def test_a_mapped_file_is_summed_where_it_lies_and_a_broken_pool_is_a_sentence(monkeypatch, tmp_path):
    """Inputs and outputs are columns of one file with a header; no values are sent."""
    monkeypatch.setattr(gram_module, "SENT_VALUES", 5000)
    rng = np.random.default_rng(22001)
    np.save(tmp_path / "a.npy", rng.standard_normal((9000, 5)).cumsum(axis=0))
    mapped = np.load(tmp_path / "a.npy", mmap_mode="r")
    record = okid.Record(mapped[100:, :2], mapped[100:, 2:], 0.1)
    scaling = channel_scaling([record])
    whole = lag_gram([record], 6, scaling=scaling)
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        counting = Counting(pool)
        gram = chunked_gram([record], 6, scaling=scaling, executor=counting)
        assert counting.sizes == [0] * 9
        assert gram.n_rows == whole.n_rows
        assert np.abs(gram.matrix - whole.matrix).max() <= 1e-12 * np.abs(whole.matrix).max()
        fit, alone = okid.fit_observer(record, order=6, executor=pool), okid.fit_observer(record, order=6)
        np.testing.assert_allclose(fit.output_coefficients, alone.output_coefficients, atol=1e-9)
        with pytest.raises(ExecutorError, match=r"the executor broke \(BrokenProcessPool: .*modal\.batch\.Workers"):
            chunked_gram([record], 6, scaling=scaling, executor=Counting(pool, end_at=3))


@pytest.mark.parametrize("n_rows", [9000, 30])
def test_a_mapped_file_that_was_replaced_is_not_read_again(monkeypatch, tmp_path, n_rows):
    """The map still shows the old rows; the path leads to others."""
    monkeypatch.setattr(gram_module, "SENT_VALUES", 5000)
    rng = np.random.default_rng(22002)
    np.save(tmp_path / "a.npy", rng.standard_normal((9000, 3)))
    mapped = np.load(tmp_path / "a.npy", mmap_mode="r")
    record = okid.Record(mapped[:, :1], mapped[:, 1:], 0.1)
    np.save(tmp_path / "new.npy", rng.standard_normal((n_rows, 3)))
    (tmp_path / "new.npy").replace(tmp_path / "a.npy")
    scaling = channel_scaling([record])
    with ThreadPoolExecutor(1) as executor:
        gram = chunked_gram([record], 6, scaling=scaling, executor=executor)
    whole = lag_gram([record], 6, scaling=scaling)
    assert np.abs(gram.matrix - whole.matrix).max() <= 1e-12 * np.abs(whole.matrix).max()
