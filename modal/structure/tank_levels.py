"""Levels that flows move, in a state space that does not oscillate: it may be one of several tanks.

A level at the end of a cascade answers to the inflow as a displacement answers to a force: not at once. So where no
pole oscillates an output may be either. What flows out of the last tank is p h with the tank's rate p, and what flows
in comes from the tank before it, whose level is therefore known without a sensor:

    h' = p (h_before - h),    h_before = h + h' / p

counted so that both levels are the same at rest. Which tank has which rate does not show in the linear model (the
cascade in the other order has the same response), so each rate that a pole shows gives a place.
"""

from dataclasses import replace

import numpy as np

from modal.structure.continuous_time import ContinuousSystem
from modal.structure.motion_rows import OutputMotion
from okid.arrays import FloatArray

__all__ = ["is_length", "tank_levels"]

_SWINGS = 0.1
"""Imaginary part of a pole, as a share of its real part, above which it oscillates; poles of equal tanks, identified
from noisy data, come out as a pair with a small one."""

_SAME_RATE = 0.05
"""Relative difference of two rates below which they are one."""

_LENGTHS = frozenset({"m", "mm", "cm", "um", "nm", "µm", "km", "in", "ft", "mil", "rad", "mrad", "deg", "°", "rev"})


def is_length(unit: str) -> bool:
    """Whether a unit is one of displacements or angles; one that is not known may be."""
    return unit in _LENGTHS or not unit


def tank_levels(
    system: ContinuousSystem, motions: tuple[OutputMotion, ...], names: tuple[str, ...]
) -> tuple[tuple[str, OutputMotion], ...]:
    """The levels: of each output that may be one, and of the tank before it.

    Args:
        system: Minimal, stable.
        motions: Of its outputs.
        names: Of its outputs.

    Returns:
        Name of each place ("output_0 level", "output_0 upstream", with numbers from the slowest rate on where there
        are several) and what moves there; none where a pole oscillates.
    """
    poles = np.linalg.eigvals(system.A).astype(np.complex128)
    if (np.abs(poles.imag) > _SWINGS * np.abs(poles.real)).any():
        return ()
    found: list[tuple[str, OutputMotion]] = []
    rates = _rates(-poles.real)
    for name, one, row in zip(names, motions, system.C, strict=True):
        if one.nature != "mechanical" or one.displacement is None or one.velocity is None or one.direct.any():
            continue
        level = replace(one, nature="flow", velocity=None, driven=row)
        found.append((f"{name} level", level))
        for number, rate in enumerate(rates, start=1):
            above = one.displacement + one.velocity / rate
            tail = "" if len(rates) == 1 else f" {number}"
            found.append((f"{name} upstream{tail}", replace(level, displacement=above, driven=above[: len(system.A)])))
    return tuple(found)


def _rates(decays: FloatArray) -> tuple[float, ...]:
    """The different rates [1/s], rising; an integrator has none."""
    kept: list[float] = []
    for rate in np.sort(decays):
        if rate > 0 and (not kept or rate > (1.0 + _SAME_RATE) * kept[-1]):
            kept.append(float(rate))
    return tuple(kept)
