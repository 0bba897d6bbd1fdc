import numpy as np
import pytest
import scipy.linalg  # noqa: F401  # loads scipy's own BLAS, which must be limited too
from threadpoolctl import threadpool_info, threadpool_limits

from okid.arrays import one_blas_thread


def blas_threads():
    np.eye(2) @ np.eye(2)
    return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]


def test_one_thread_inside_and_what_was_set_before_outside():
    with threadpool_limits(limits=2, user_api="blas"):
        before = blas_threads()
        assert before
        with one_blas_thread():
            assert blas_threads() == [1] * len(before)
        assert blas_threads() == before


def test_an_error_inside_restores_too():
    with threadpool_limits(limits=2, user_api="blas"):
        before = blas_threads()
        with pytest.raises(ZeroDivisionError), one_blas_thread():
            _ = 1 / 0
        assert blas_threads() == before


def test_every_worker_of_the_tests_keeps_one_blas_thread():
    assert set(blas_threads()) == {1}
