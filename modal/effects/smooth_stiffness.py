"""Smooth stiffness: a spring whose law has no form of its own."""

from dataclasses import dataclass

from modal.effects.smooth_law import SmoothLaw

__all__ = ["SmoothStiffness"]


@dataclass(frozen=True, slots=True, kw_only=True)
class SmoothStiffness(SmoothLaw):
    """A force that is some smooth function of the displacement, given by its values at points (`SmoothLaw`).

    In the data: whatever the curve makes of it.

    Confused with: every smooth law of the displacement that has a name, which it contains, so it is tried only where
    these fail the test of what they leave. Corners are rounded off.

    Parameters: low, high [length], the range that was seen; force_j [force] at the points between them.

    References:
        Noel, Schoukens, Grey-box state-space identification of nonlinear mechanical vibrations, Int. J. Control 91,
        2018, doi 10.1080/00207179.2017.1308557.
    """

    key = "smooth_stiffness"
    law = "f = smooth function of d through points"
    family = "stiffness of any form"
    signature = "any smooth law of the displacement"
    reads = "displacement"
