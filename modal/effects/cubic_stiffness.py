"""Cubic stiffness: a spring that hardens (or softens) with the square of its stretch."""

from dataclasses import dataclass

import numpy as np

from modal.effects.effect import Force, ForceEffect, Motion, ParameterKind, Twin, Values
from modal.effects.memoryless import cut_to_finite, memoryless
from okid.arrays import FloatArray

__all__ = ["CubicStiffness"]


def _as_sine(values: FloatArray, stiffness: float) -> tuple[float, ...] | None:
    return (float(np.sqrt(-stiffness / (6.0 * values[0]))),) if values[0] < 0.0 else None


@dataclass(frozen=True, slots=True, kw_only=True)
class CubicStiffness(ForceEffect):
    """Cubic stiffness f = k3 d^3.

    In the data: an odd law, so a sine at f answers at 3 f and odd lines fill up while even ones stay empty; the
    resonance rises with the level where k3 > 0 (k + 3/4 k3 amplitude^2 to a first approximation) and falls where
    k3 < 0; the relative gap grows with the square of the level.

    Confused with: stops met now and then (one level beyond contact and one below tell them apart: below contact stops
    leave nothing) and sine softening (the same law to third order, k3 = -k / (6 length_scale^2): only motion beyond
    about one length scale tells).

    Parameters: k3 [force/length^3], of either sign.

    References:
        Duffing, Erzwungene Schwingungen bei veränderlicher Eigenfrequenz, Vieweg 1918; Kerschen et al., Past, present
        and future of nonlinear system identification in structural dynamics, Mech. Syst. Signal Process. 20(3), 2006,
        doi 10.1016/j.ymssp.2005.04.008.
    """

    key = "cubic_stiffness"
    law = "f = k3 d^3"
    parameters = (ParameterKind(name="k3", meaning="cubic stiffness", dimension=(1, -3, 0)),)
    neutral = (0.0,)
    family = "odd stiffness"
    signature = "odd lines, third harmonic; the resonance moves with the level"
    reference = "Kerschen et al. 2006, doi 10.1016/j.ymssp.2005.04.008"
    twin = Twin(law="sine_softening", values=_as_sine)

    def force(self, values: Values, motion: Motion) -> Force:
        """The force and its derivatives."""
        d = cut_to_finite(motion.displacement)
        square = d * d
        cube = square * d
        return memoryless(motion, values[0] * cube, (cube,), by_displacement=3.0 * values[0] * square)
