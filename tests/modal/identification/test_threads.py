"""Identifications at once, in threads or processes, give what one after the other gives, and change nothing else."""

import warnings
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from multiprocessing import get_context

import numpy as np
import pytest
import scipy

from modal.identification.pipeline import identify
from okid.record import Record


def record(seed):
    rng = np.random.default_rng(seed)
    force = rng.standard_normal(400)
    tip = sum(
        scipy.signal.lfilter([0.0, 1.0], [1.0, -2 * pole.real, abs(pole) ** 2], force)
        for pole in np.exp(2 * np.pi * 0.01 * np.array([-0.05 + 4j, -0.2 + 11j]))
    )
    return Record(force, tip + 0.02 * rng.standard_normal(400), 0.01)


searched = partial(identify, observer_order=20, ridge=0.0)
"""The model order is searched, and refined, as always; of one observer."""


def numbers(result):
    modes = [(mode.pole, mode.frequency, mode.damping_ratio, mode.verdict, mode.reason) for mode in result.modes]
    return modes, result.realisation.A.tobytes(), result.markov.system.tobytes(), str(result.choices), result.warnings


@pytest.fixture(scope="module")
def alone():
    """Records, and what one identification after the other gives."""
    records = [record(seed) for seed in range(2)]
    return records, [numbers(searched(one)) for one in records]


def test_four_threads_give_the_same_results(alone):
    records, expected = alone
    before = [one.outputs.copy() for one in records]
    filters, state, errors = list(warnings.filters), np.random.get_state()[1].copy(), np.geterr()  # noqa: NPY002
    with ThreadPoolExecutor(4) as pool:
        at_once = [numbers(one) for one in pool.map(searched, [*records, *records])]
    assert at_once == 2 * expected
    for one, outputs in zip(records, before, strict=True):
        np.testing.assert_array_equal(one.outputs, outputs)
    assert list(warnings.filters) == filters
    assert np.geterr() == errors
    np.testing.assert_array_equal(np.random.get_state()[1], state)  # noqa: NPY002


def test_a_process_of_its_own_gives_the_same_bytes(alone):
    """It hashes otherwise; two at once are asked by `test_executors_leave_the_same_bytes`."""
    records, expected = alone
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        assert [numbers(one) for one in pool.map(searched, records)] == expected
