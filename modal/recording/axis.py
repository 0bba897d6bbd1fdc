"""Axes of drawn plots: a range of values, and ticks where a person would put them."""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from okid.arrays import FloatArray

__all__ = ["SHARE_AXIS", "Axis", "linear_axis", "log_axis"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Axis:
    """A range of values, its ticks, and what it is.

    Attributes:
        title: quantity and unit.
        low: value at the start (its logarithm for a logarithmic axis, as for the others below).
        high: value at the end.
        ticks: values that carry a grid line and a text.
        texts: one a tick.
        scale: "linear" or "log10".
    """

    title: str
    low: float
    high: float
    ticks: tuple[float, ...]
    texts: tuple[str, ...]
    scale: Literal["linear", "log10"] = "linear"

    def share(self, values: npt.ArrayLike) -> FloatArray:
        """Where values lie on the axis: 0 at its start, 1 at its end; nan for those that a log axis cannot show."""
        given = np.asarray(values, dtype=np.float64)
        if self.scale == "log10":
            given = np.log10(np.where(given > 0, given, np.nan))
        return np.asarray((given - self.low) / (self.high - self.low))


SHARE_AXIS: Final = Axis(title="coherence", low=0.0, high=1.04, ticks=(0.0, 0.5, 1.0), texts=("0", "0.5", "1"))
"""Of a coherence, in a low frame."""


def linear_axis(title: str, low: float, high: float, *, whole: bool = False) -> Axis:
    """An axis from `low` to `high` with ticks at round steps.

    Args:
        title: quantity and unit.
        low: start.
        high: end; a range without width is widened.
        whole: ticks at whole numbers only.

    Example:
        >>> linear_axis("order", 0, 42).texts
        ('0', '10', '20', '30', '40')
    """
    if not high > low:
        low, high = low - 0.5 - abs(low) / 2, low + 0.5 + abs(low) / 2
    raw = (high - low) / 5
    power = 10.0 ** np.floor(np.log10(raw))
    step = power * min((1, 2, 5, 10), key=lambda m: abs(np.log(m * power / raw)))
    if whole:
        step = max(1.0, np.round(step))
    first = np.ceil(low / step - 1e-9)
    ticks = step * np.arange(first, np.floor(high / step + 1e-9) + 1)
    ticks = np.where(np.abs(ticks) < step * 1e-9, 0.0, ticks)
    texts = tuple(f"{tick:.6g}" for tick in ticks)
    return Axis(title=title, low=low, high=high, ticks=tuple(ticks.tolist()), texts=texts)


def log_axis(title: str, low: float, high: float) -> Axis:
    """A logarithmic axis a little wider than `low` to `high`, both positive, with ticks at decades.

    Example:
        >>> log_axis("singular value", 0.03, 20).texts
        ('0.1', '1', '10')
    """
    start, stop = np.log10(low), np.log10(high)
    margin = max(0.08 * (stop - start), 0.15)
    start, stop = start - margin, stop + margin
    first, last = int(np.ceil(start)), int(np.floor(stop))
    if last <= first:  # at least two decades, or nothing can be read off
        first, last = min(first, last), max(first, last) + (first == last)
        start, stop = min(start, first), max(stop, last)
    step = max(1, -(-(last - first) // 7))
    decades = np.arange(first, last + 1, step)
    texts = tuple(f"{10.0**d:g}" if -4 < d < 5 else f"1e{d}" for d in decades.tolist())
    return Axis(title=title, low=start, high=stop, ticks=tuple(map(float, decades)), texts=texts, scale="log10")
