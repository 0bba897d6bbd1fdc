"""One BLAS thread while we work.

Our matrices have a few hundred rows. For them a second thread gains nothing, and on a busy machine the threads wait for
each other: an identification took 42 s of processor time instead of 5 s on two cores with a load of eight.
"""

from contextlib import AbstractContextManager

__all__ = ["one_blas_thread"]


def one_blas_thread() -> AbstractContextManager[object]:
    """A context in which numpy and scipy use one thread; what was set before is restored at its end.

    Example:
        >>> with one_blas_thread():
        ...     pass
    """
    import scipy.linalg  # noqa: F401  # scipy brings a BLAS of its own, which must be loaded before it can be limited
    from threadpoolctl import threadpool_limits

    limits: AbstractContextManager[object] = threadpool_limits(limits=1, user_api="blas")
    return limits
