"""Checks of single numbers that every stage takes: counts, orders, time steps.

They take what a caller may hold (Python or numpy, 3 or 3.0) and refuse the rest in one sentence, whatever its type.
"""

import math
import operator
from typing import Any

from okid.errors import InvalidDataError

__all__ = ["real_number", "time_step", "whole_number"]


def real_number(value: Any) -> float:
    """The value as a float; nan where it is no single real number (text, a list, a truth value, None).

    Example:
        >>> real_number(3), real_number("3"), real_number(True)
        (3.0, nan, nan)
    """
    if isinstance(value, bool | str | bytes | bytearray) or getattr(value, "ndim", 0) != 0:
        return math.nan
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return math.nan


def whole_number(value: Any, *, name: str, least: int, otherwise: str = "") -> int:
    """The value as an int of at least `least`.

    Args:
        value: 3, 3.0 or a numpy scalar.
        name: what to call it in an error.
        least: smallest value allowed.
        otherwise: what else the argument may be, for the message, e.g. 'or "auto"'.

    Raises:
        InvalidDataError: no number, no whole number, or one below `least`.

    Example:
        >>> whole_number(3.0, name="n_lags", least=1)
        3
    """
    number = real_number(value)
    if math.isfinite(number) and number == math.floor(number) and number >= least:
        # An integer beyond 2^53 is not what its float says.
        return operator.index(value) if hasattr(value, "__index__") else int(number)
    options = f" {otherwise}" if otherwise else ""
    raise InvalidDataError(f"{name} must be a whole number of at least {least}{options}, but is {value!r}.")


def time_step(value: Any) -> float:
    """A time step in seconds as a float.

    Raises:
        InvalidDataError: no number, or one that is not positive and finite.

    Example:
        >>> time_step(0.01)
        0.01
    """
    step = real_number(value)
    if not (math.isfinite(step) and step > 0):
        raise InvalidDataError(f"dt must be a positive time step in seconds, but is {value!r}.")
    return step
