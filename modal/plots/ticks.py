"""Where an axis has its ticks, and what stands beside them."""

import math

import numpy as np

__all__ = ["Tick", "ticks_between"]

Tick = tuple[float, str]

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def ticks_between(low: float, high: float, *, most: int, log: bool = False) -> list[Tick]:
    """Round values from `low` to `high` with their texts, about `most` of them.

    Example:
        >>> ticks_between(-0.3, 1.1, most=4)
        [(0.0, '0.0'), (0.5, '0.5'), (1.0, '1.0')]
        >>> ticks_between(2e-4, 30.0, most=3, log=True)
        [(0.001, '10⁻³'), (0.1, '10⁻¹'), (10.0, '10¹')]
        >>> ticks_between(0.5, 30.0, most=3, log=True)
        [(1.0, '1'), (10.0, '10')]
    """
    if not (math.isfinite(low) and math.isfinite(high) and high > low):
        return []
    if log:
        return _powers(low, high, most)
    step = _step((high - low) / most)
    values = step * np.arange(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)
    largest = float(np.abs(values).max(initial=step))
    power = math.floor(math.log10(largest))
    scaled = power > 4 or power < -3
    digits = max(0, (power if scaled else 0) - math.floor(math.log10(step) + 1e-9))
    unit = 10.0**power if scaled else 1.0
    tail = f"·{_power(power)}" if scaled else ""
    return [(float(value), f"{value / unit:.{digits}f}{tail if value else ''}".replace("-", "−")) for value in values]


def _powers(low: float, high: float, most: int) -> list[Tick]:
    """Powers of ten, every second, third ... of many; round values between them where there are few."""
    first, last = math.ceil(math.log10(low) - 1e-9), math.floor(math.log10(high) + 1e-9)
    if last - first < 1:
        between = [10.0**power * m for power in range(first - 1, last + 1) for m in (1, 2, 5)]
        kept = [value for value in between if low <= value <= high]
        return [(value, f"{value:.3g}") for value in kept] if len(kept) > 1 else ticks_between(low, high, most=most)
    every = max(1, -(-(last - first) // most))
    powers = range(first, last + 1, every)
    plain = powers[0] > -4 and powers[-1] < 5 and powers[-1] - powers[0] < 4
    return [(10.0**power, f"{10.0**power:g}" if plain else _power(power)) for power in powers]


def _power(power: int) -> str:
    return f"10{str(power).translate(_SUPERSCRIPTS)}"


def _step(least: float) -> float:
    """The smallest of 1, 2 and 5 times a power of ten that is at least `least`."""
    unit = 10.0 ** math.floor(math.log10(least))
    return next(unit * m for m in (1, 2, 5, 10) if unit * m >= least * (1.0 - 1e-9))
