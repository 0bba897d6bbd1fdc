"""How far a shape is from real: its components in the complex plane, and what their phases say in words.

The components of a real mode lie on one line through 0: all sensors reach their extremes together. Phase collinearity
(1 on a line) and mean phase deviation (degrees from it) measure that; with few sensors both say little.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from modal.geometry.placement import derivatives_of, turned
from modal.geometry.sticks import rows_by_unit
from modal.modes.mode import Mode
from okid.arrays import ComplexArray

__all__ = ["complexity_words", "phasors"]

REAL_COLLINEARITY: Final = 0.95
REAL_DEVIATION: Final = 10.0
"""From this phase collinearity and up to this mean phase deviation [deg] a shape is called nearly real."""

MIXED_COLLINEARITY: Final = 0.5
"""Below this, no phase is common: a random shape of three sensors reaches it on average."""


def phasors(mode: Mode, output_units: Sequence[str]) -> ComplexArray:
    """Components of a shape, largest 1 in each unit, turned to the best real phase.

    Velocities and accelerations beside displacements are divided by the pole and its square, which brings their phases
    together.

    Args:
        mode: whose shape.
        output_units: of the outputs.

    Returns:
        (n_outputs,).
    """
    derivatives = derivatives_of(output_units)
    divisor = np.array([mode.pole**power if mode.pole else 1.0 for power in derivatives])
    values = np.asarray(mode.shape / divisor, dtype=np.complex128)
    for row in rows_by_unit(output_units):
        largest = np.abs(values[list(row)]).max()
        if largest > 0:
            values[list(row)] /= largest
    return turned(values)


def complexity_words(mode: Mode) -> str:
    """What collinearity and phase deviation of a shape say; the numbers are given with it.

    Example:
        >>> shape = np.array([1.0, -0.5])
        >>> mode = Mode(pole=-1 + 9j, kind="oscillatory", frequency=1.4, damping_ratio=0.1, shape=shape,
        ...             participation=np.ones(1), phase_collinearity=0.99, mpd=1.2)
        >>> complexity_words(mode)
        'nearly real'
    """
    if mode.shape.size < 2:
        return "one sensor"
    if not (np.isfinite(mode.phase_collinearity) and np.isfinite(mode.mpd)):
        return "not known"
    if mode.phase_collinearity >= REAL_COLLINEARITY and mode.mpd <= REAL_DEVIATION:
        return "nearly real"
    if mode.phase_collinearity < MIXED_COLLINEARITY:
        return "no common phase"
    return "complex"
