"""Contact, sharp and smooth, and motion cut where the powers in a law would overflow.

A law with a corner gives Newton steps two slopes to jump between. A width of 0 gives the sharp law exactly.
"""

import numpy as np

from okid.arrays import FloatArray

__all__ = ["LARGEST", "cut_to_finite", "positive_part"]

LARGEST = 1e60
"""Motion beyond this is cut there: a run that diverges is rejected by its size, and no law overflows on the way."""


def cut_to_finite(motion: FloatArray) -> FloatArray:
    """Displacement or velocity, cut at +-`LARGEST` so that its powers stay finite."""
    return np.clip(motion, -LARGEST, LARGEST)


def positive_part(x: FloatArray, width: float | FloatArray) -> tuple[FloatArray, FloatArray]:
    """max(x, 0), a parabola within +-width of 0 with value and slope continuous, and its slope.

    Within the width the value is (x + width)^2 / (4 width), at most width / 4 above the sharp law.

    Args:
        x: (n,).
        width: Half the width of the parabola, in the unit of x, one for all or (n,); 0: the sharp law, with slope 1/2
            at 0.

    Returns:
        Value and slope, (n,) each.

    Example:
        >>> positive_part(np.array([-1.0, 0.0, 2.0]), 0.0)
        (array([0., 0., 2.]), array([0. , 0.5, 1. ]))
        >>> positive_part(np.array([-1.0, 0.0, 2.0]), 0.1)[0]
        array([0.   , 0.025, 2.   ])
    """
    if not np.any(np.asarray(width) > 0.0):
        return np.maximum(x, 0.0), np.heaviside(x, 0.5)
    share = np.clip(x, -width, width) / width
    slope = 0.5 * (1.0 + share)
    return np.where(x > width, x, 0.25 * width * (1.0 + share) ** 2), slope
