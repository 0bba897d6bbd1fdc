"""A structure with effects run along a record: drive, trajectory, linearisation, sensitivities.

Here the numbers that several steps of a diagnosis decide by: each has one meaning, and one value, in all of them.
"""

NEAR_FLOOR = 1.5
"""Call data explained up to this mean square in units of the noise floor, which is an estimate itself."""
AT_FLOOR = 1.2
"""Look for nothing more below this mean square in units of the noise floor."""
SURE = 3.0
"""Believe what differs from zero by more standard deviations than this."""
UNLIKELY = 1e-3
"""Hold no chance responsible for what it does more rarely than this."""
DIFFERENCE_STEP = 1e-5
"""Move a parameter by this share of its size for a central difference: near the cube root of the rounding."""
UNDAMPED_DEVIATION = 0.02
"""Let a damping that is nominally zero be so much of the critical one, as a standard deviation."""
FOLLOWED = 1e-3
"""Count this share of an output, root mean square, as noise in any case: steps and smoothed corners leave as much."""
SLIGHT = 0.01
"""Overlook what is left below this share of the named effect's force, and a gain that is so near to one."""


def explained(*levels: float) -> bool:
    """Whether a model explains the data of which it leaves these mean squares, in units of the noise floor.

    Example:
        >>> explained(1.02), explained(1.02, 1.6), explained(float("nan"))
        (True, False, False)
    """
    return all(level <= NEAR_FLOOR for level in levels)
