"""Lengths to start from: where a share of the motion stays below."""

from collections.abc import Sequence

import numpy as np

from okid.arrays import FloatArray

__all__ = ["levels"]


def levels(motion: FloatArray, shares: Sequence[float]) -> tuple[float, ...]:
    """The lengths below which each share of the samples of |motion| stays, without doubles and zeros.

    Args:
        motion: (n,) displacement, velocity or input over the records to fit.
        shares: Shares between 0 and 1, rising.

    Returns:
        Positive lengths, rising; (1.0,) for a motion that is zero throughout.

    Example:
        >>> levels(np.linspace(-2.0, 2.0, 101), (0.25, 0.5))
        (0.52, 1.0)
        >>> levels(np.zeros(5), (0.25, 0.5))
        (1.0,)
    """
    found = np.unique(np.quantile(np.abs(motion), shares)) if motion.size else np.empty(0)
    return tuple(float(length) for length in found[found > 0.0]) or (1.0,)
