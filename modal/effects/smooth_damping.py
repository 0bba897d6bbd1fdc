"""Smooth damping: a damper whose law has no form of its own."""

from dataclasses import dataclass

from modal.effects.smooth_law import SmoothLaw

__all__ = ["SmoothDamping"]


@dataclass(frozen=True, slots=True, kw_only=True)
class SmoothDamping(SmoothLaw):
    """A force that is some smooth function of the velocity, given by its values at points (`SmoothLaw`).

    In the data: whatever the curve makes of it.

    Confused with: every smooth law of the velocity that has a name, which it contains, so it is tried only where these
    fail the test of what they leave. A jump at rest is dry friction, an effect of its own.

    Parameters: low, high [length/time], the range that was seen; force_j [force] at the points between them.

    References:
        Noel, Schoukens, Grey-box state-space identification of nonlinear mechanical vibrations, Int. J. Control 91,
        2018, doi 10.1080/00207179.2017.1308557.
    """

    key = "smooth_damping"
    law = "f = smooth function of v through points"
    family = "damping of any form"
    signature = "any smooth law of the velocity"
    reads = "velocity"
    needs = frozenset({"velocity"})
