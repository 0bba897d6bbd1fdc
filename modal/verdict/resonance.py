"""One resonance modelled by several poles: judged as what it is, one response in one narrow band.

A structure that is not quite linear, or whose resonance wanders during the record, is fitted best by two or three poles
side by side with the same shape. How the response is shared among them is chance, so none of them is found again alone;
their sum is. Modes within each other's half-power bandwidth that have the same shape form a group, led by the one with
the most energy, and the group's summed pulse response is compared with the sum of the same band in the other runs.
"""

from collections.abc import Sequence

import numpy as np

from modal.modes.mode import Mode
from modal.modes.overlap import Pulses, energies, inner_products
from modal.modes.shape_comparison import assurance
from okid.arrays import BoolArray, FloatArray

__all__ = ["group_overlaps", "groups"]

LEAST_BAND = 0.01
"""Poles closer than this share of the frequency belong to one resonance whatever their damping."""
LARGEST_BAND = 0.05
"""Poles further apart than this never do: a heavily damped pole would swallow its neighbours."""
SAME_SHAPE = 0.95


def groups(modes: Sequence[Mode], reference: Pulses, *, n_steps: int) -> dict[int, tuple[int, ...]]:
    """Leader and members (leader included) of each group of at least two oscillatory modes.

    Args:
        modes: of one model.
        reference: their pulse responses.
        n_steps: length of the pulse responses in samples.
    """
    found: dict[int, tuple[int, ...]] = {}
    free = {i for i, mode in enumerate(modes) if mode.kind == "oscillatory"}
    size = np.nan_to_num(energies(reference, n_steps=n_steps))
    for leader in sorted(free, key=lambda i: -size[i]):
        if leader not in free:
            continue
        near = _in_band(modes[leader], reference, leader, modes, reference)
        members = tuple(i for i in range(len(modes)) if near[i] and i in free)
        free -= set(members)
        if len(members) > 1:
            found[leader] = members
    return found


def group_overlaps(
    leader: int,
    members: Sequence[int],
    modes: Sequence[Mode],
    reference: Pulses,
    runs: Sequence[tuple[Sequence[Mode], Pulses]],
    *,
    n_steps: int,
) -> FloatArray:
    """(n_runs,) overlap of the group's summed pulse response with that of the same band and shape in each run."""
    group = np.array(members, dtype=np.intp)
    own = inner_products(reference, reference, n_steps=n_steps)[np.ix_(group, group)].sum()
    overlaps = np.zeros(len(runs))
    for i, (again, pulses_again) in enumerate(runs):
        if not again:
            continue
        near = np.flatnonzero(_in_band(modes[leader], reference, leader, again, pulses_again))
        theirs = inner_products(pulses_again, pulses_again, n_steps=n_steps)[np.ix_(near, near)].sum()
        both = inner_products(reference, pulses_again, n_steps=n_steps)[np.ix_(group, near)].sum()
        largest = max(own, theirs)
        overlaps[i] = np.clip(np.nan_to_num(both / largest), 0.0, 1.0) if largest > 0 else 0.0
    return overlaps


def _in_band(mode: Mode, reference: Pulses, index: int, others: Sequence[Mode], their_pulses: Pulses) -> BoolArray:
    """Which of the others lie within the half-power bandwidth of the mode (or it in theirs), with its shape."""
    frequency = np.array([other.frequency for other in others])
    damping = np.array([max(0.0, other.damping_ratio) for other in others])
    oscillatory = np.array([other.kind == "oscillatory" for other in others])
    band = np.clip(0.5 * (damping + max(0.0, mode.damping_ratio)), LEAST_BAND, LARGEST_BAND)
    same = assurance(reference.outputs[:, [index]], their_pulses.outputs)[0] >= SAME_SHAPE
    near: BoolArray = (np.abs(frequency - mode.frequency) <= band * mode.frequency) & same & oscillatory
    return near
