"""Gram matrices of rows that take turns: the same numbers as the sum over these rows one by one."""

import numpy as np
import pytest

from okid.gram import lag_gram, turn_gram
from okid.record import Record
from okid.scaling import channel_scaling


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
