"""What laws without memory share: force from value and slopes, contact, finite motion, the step of a stiff flow.

A law with a corner gives Newton steps two slopes to jump between, so contact is smoothed; a width of 0 gives the sharp
law exactly.

A level that a flow calls back, h' = -s h, dies down by exp(-z) in a step dt, z = s dt. With the share theta of the flow
at the end of the step in its mean over the step it dies down by (1 - (1 - theta) z) / (1 + theta z). A line between
both ends, theta = 1/2, is right to second order, but of a brim as hard as a wall it makes -1: the flow rings from step
to step for ever. With

    theta(z) = 1 - 1 / (2 + z^2 / 2)

a soft flow has the line and a wall has all at the end (0: the level is held). In between z (1 - theta) is never more
than 1/2. So the level at the end of a step rises with that at its start however hard the brim, as long as the plant
itself keeps half of its level over a step; and Newton's method on the whole trajectory settles from any start.
"""

from collections.abc import Sequence

import numpy as np

from modal.effects.effect import Force, Motion
from okid.arrays import FloatArray

__all__ = ["LARGEST", "WALL", "cut_to_finite", "least_length", "levels", "memoryless", "positive_part", "share_of_end"]


def memoryless(
    motion: Motion,
    value: FloatArray,
    by_parameter: Sequence[FloatArray],
    *,
    by_displacement: FloatArray | None = None,
    by_velocity: FloatArray | None = None,
) -> Force:
    """The force of a law that reads the motion of the moment only; slopes that are not given are 0.

    Args:
        motion: Motion at the port.
        value: (n,) force.
        by_parameter: One derivative (n,) for each parameter.
        by_displacement: (n,) derivative by the displacement.
        by_velocity: (n,) derivative by the velocity.

    Returns:
        The force with its derivatives; `by_memory` has no columns.
    """
    zeros = np.zeros_like(motion.displacement)
    return Force(
        value=value,
        by_displacement=zeros if by_displacement is None else by_displacement,
        by_velocity=zeros if by_velocity is None else by_velocity,
        by_memory=np.zeros((len(zeros), 0)),
        by_parameter=np.stack(by_parameter, axis=1),
    )


LARGEST = 1e60
"""Cut motion beyond this: a run that diverges is rejected by its size, and no law overflows on the way."""

SHORTEST = 1e-12
"""Count no length that shapes a law as less than this share of the scale: below it the law is at its limit."""


def cut_to_finite(motion: FloatArray) -> FloatArray:
    """Displacement or velocity, cut at +-`LARGEST` so that its powers stay finite."""
    return np.clip(motion, -LARGEST, LARGEST)


def least_length(scale: float) -> float:
    """The least length that shapes a law, for motion of this scale."""
    return max(SHORTEST * scale, 1.0 / LARGEST)


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


WALL = 1e4
"""Call a limit stiffer than this z a wall: the level over it is then less than a ten thousandth of what it would
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
