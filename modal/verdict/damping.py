"""Existence is one statement, damping another: when a mode's damping ratio is not to be quoted, and why.

Nearly all modes that are accepted in error are true modes with a damping ratio that is far too high: smeared by a short
observer, by a ridge, or by noise.
"""

import math

from modal.modes.mode import Mode

__all__ = ["damping_doubt"]

SPREAD = 0.1
"""Relative standard deviation above which a damping ratio is not to be quoted."""
MOST_SPREAD = 1000
"""Per cent of a damping ratio, beyond which a standard deviation says nothing but that nothing is known."""
BIASING_RIDGE = 1e-2
"""Ridge that biases damping when no output-error refinement follows."""
HALVES_APART = 0.5
"""Difference of the two halves of the data, relative to the mode, that shows such a spread: 2.5 standard deviations of
a difference between halves of relative standard deviation sqrt(2) 0.1 each."""
OBSERVERS_APART = 0.3
"""Relative change with observer order and ridge that shows a bias by them. On 120 random systems (observer order 30 or
50, ridge 1e-5 to 1e-3, rerun with 0.7 of the order and 3 times the ridge) it marked 42 of the 50 damping ratios that
were off by more than half, and 22 of the 331 that were right to a quarter; the halves alone marked 12 and 30."""


def damping_doubt(
    mode: Mode, *, span: float, ridge: float, halves: tuple[float, ...], observers: tuple[float, ...]
) -> tuple[str, ...]:
    """The first reason not to quote the damping ratio of an oscillatory mode, in words; empty when there is none.

    Args:
        mode: its standard deviation is used where it is known.
        span: periods of the mode that the observer spans.
        ridge: of the observer fit, 0 when a refinement followed.
        halves: damping ratios of the same mode in halves of the data.
        observers: damping ratios of the same mode with other observer orders and ridges.

    Example:
        >>> import numpy as np
        >>> mode = Mode(pole=-1 + 9j, kind="oscillatory", frequency=1.44, damping_ratio=0.11,
        ...             shape=np.ones(1), participation=np.ones(1))
        >>> damping_doubt(mode, span=0.4, ridge=0.0, halves=(), observers=())
        ('damping not resolved: the observer spans only 0.4 of its period',)
    """
    if mode.kind != "oscillatory":
        return ()
    damping = mode.damping_ratio
    size = abs(damping)
    furthest = max(observers, key=lambda other: abs(other - damping), default=damping)
    if mode.damping_ratio_std > SPREAD * size:
        share = 100 * mode.damping_ratio_std / size if size else math.inf
        why = f"its standard deviation is {f'{share:.0f}' if share <= MOST_SPREAD else f'over {MOST_SPREAD}'} % of it"
    elif span < 1 and not _agree(damping, (*halves, *observers)):
        why = f"the observer spans only {span:.2g} of its period"
    elif ridge >= BIASING_RIDGE:
        why = f"a ridge of {ridge:.2g} without refinement biases it"
    elif len(halves) > 1 and max(halves) - min(halves) > HALVES_APART * size:
        why = f"the halves of the data give {_percent(min(halves))} and {_percent(max(halves))}"
    elif abs(furthest - damping) > OBSERVERS_APART * size:
        why = f"another observer order and ridge give {_percent(furthest)} instead of {_percent(damping)}"
    else:
        return ()
    return (f"damping not resolved: {why}",)


def _agree(damping: float, others: tuple[float, ...]) -> bool:
    """Found again with the same damping wherever it was looked for, so that even a short observer has resolved it."""
    return len(others) > 1 and all(abs(other - damping) <= SPREAD * abs(damping) for other in others)


def _percent(ratio: float) -> str:
    return f"{100 * ratio:.2g} %" if ratio < 0.995 else f"{100 * ratio:.0f} %"
