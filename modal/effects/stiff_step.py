"""How much of the force at the end of a step a stiff flow has over the step, so that it neither rings nor runs astray.

A level that a flow calls back, h' = -s h, dies down by exp(-z) in a step dt, z = s dt. With the share theta of the flow
at the end of the step in its mean over the step it dies down by (1 - (1 - theta) z) / (1 + theta z). A line between
both ends, theta = 1/2, is right to second order, but of a brim as hard as a wall it makes -1: the flow rings from step
to step for ever. With

    theta(z) = 1 - 1 / (2 + z^2 / 2)

a soft flow has the line and a wall has all at the end (0: the level is held). In between z (1 - theta) is never more
than 1/2. So the level at the end of a step rises with that at its start however hard the brim, as long as the plant
itself keeps half of its level over a step; and Newton's method on the whole trajectory settles from any start.
"""

import numpy as np

from okid.arrays import FloatArray

__all__ = ["WALL", "share_of_end"]

WALL = 1e4
"""Stiffness z beyond which a limit is a wall: the level over it is then less than a ten thousandth of what it would
have risen by in a step; at a hundred times that Newton's steps are lost in rounding."""


def share_of_end(z: float | FloatArray) -> tuple[FloatArray, FloatArray]:
    """The share theta(z) of the end of a step, and its slope.

    Args:
        z: Stiffness of a step, not negative.

    Returns:
        theta in [1/2, 1], and its derivative by z.

    Example:
        >>> share_of_end(0.0)[0].round(6), share_of_end(1e9)[0].round(6)
        (np.float64(0.5), np.float64(1.0))
    """
    rest = 1.0 / (2.0 + 0.5 * np.square(z))
    return np.asarray(1.0 - rest)[()], np.asarray(z * rest**2)[()]
