"""The force of a law without memory, from its value and slopes."""

from collections.abc import Sequence

import numpy as np

from modal.effects.effect import Force, Motion
from okid.arrays import FloatArray

__all__ = ["memoryless"]


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
