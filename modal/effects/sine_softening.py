"""Sine softening: the restoring force of a pendulum, or of any spring that follows a sine."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modal.effects.effect import Force, ForceEffect, Motion, ParameterKind, Situation, Twin, Values
from modal.effects.memoryless import cut_to_finite, least_length, memoryless
from okid.arrays import FloatArray

__all__ = ["SineSoftening"]

LENGTHS = (1.0, 3.0)
"""Start from these length scales, in units of the largest displacement."""
STRAIGHT = 1e-2
"""Take sine less angle from its series below this d / length_scale."""


def _as_cubic(values: FloatArray, stiffness: float) -> tuple[float, ...] | None:
    return (float(-stiffness / (6.0 * values[0] ** 2)),)


@dataclass(frozen=True, slots=True, kw_only=True)
class SineSoftening(ForceEffect):
    """Sine softening f = k L (sin(d / L) - d / L), with which the spring k d of the model becomes k L sin(d / L).

    k is the linear stiffness at the place, L the length scale: 1 rad for a pendulum whose displacement is its angle,
    the length of the pendulum for the arc, the width of a magnet's pole for a magnetic spring.

    In the data: an odd law; the resonance falls with the level (a pendulum's by angle^2 / 16) and nothing is lost: the
    damping stays; the relative gap grows with the square of the level.

    Confused with: cubic stiffness with k3 = -k / (6 L^2), to third order in d / L; only motion beyond about one length
    scale tells. L is known beforehand more often than not (1 rad): a found L at the known value is evidence.

    Parameters: length_scale [length], not negative; infinite for no effect.

    References:
        Nelson, Olsson, The pendulum: rich physics from a simple system, Am. J. Phys. 54(2), 1986, doi 10.1119/1.14703.
    """

    key = "sine_softening"
    law = "f = k length_scale (sin(d/length_scale) - d/length_scale), k the linear stiffness"
    parameters = (
        ParameterKind(
            name="length_scale", meaning="displacement of one radian", dimension=(0, 1, 0), lower=0.0, role="shape"
        ),
    )
    neutral = (np.inf,)
    family = "odd stiffness"
    needs = frozenset({"displacement", "stiffness"})
    per_stiffness = True
    signature = "odd lines; the resonance falls with the square of the level, the damping stays"
    reference = "Nelson, Olsson 1986, doi 10.1119/1.14703"
    twin = Twin(law="cubic_stiffness", values=_as_cubic)

    def known_values(self, length_unit: str) -> tuple[float | None, ...]:
        """One radian, where the displacement is an angle."""
        return ({"rad": 1.0, "deg": 180.0 / np.pi}.get(length_unit),)

    def starts(self, situation: Situation) -> tuple[tuple[float, ...], ...]:
        """One start for each length scale, about as long as the motion and longer."""
        largest = float(np.max(np.abs(situation.motion.displacement), initial=0.0)) or 1.0
        return tuple((share * largest,) for share in LENGTHS)

    def force(self, values: Values, motion: Motion) -> Force:
        """The force and its derivatives."""
        d, k = cut_to_finite(motion.displacement), motion.stiffness
        length = np.maximum(values[0], least_length(motion.displacement_scale))
        angle = d / length
        missing = _sine_less_angle(angle)
        # length x missing, written so that an infinite length gives 0 and not infinity x 0
        share = np.divide(missing, angle, out=np.zeros_like(angle), where=angle != 0.0)
        return memoryless(
            motion,
            k * d * share,
            (k * (missing + angle * 2.0 * np.sin(0.5 * angle) ** 2),),
            by_displacement=-2.0 * k * np.sin(0.5 * angle) ** 2,
        )

    def screen_columns(self, values: Values, motion: Motion) -> FloatArray:
        """The force at the length scale in `values`: its shape is nearly the same at every greater one."""
        return self.force(values, motion).value[:, None]

    def from_screen(self, values: Values, weights: Sequence[float] | FloatArray) -> tuple[float, ...]:
        """The length scale whose cubic term is `weights[0]` times that at `values`; at most ten times as long."""
        return (float(values[0]) / float(np.sqrt(min(max(float(weights[0]), 0.01), 100.0))),)


def _sine_less_angle(angle: FloatArray) -> FloatArray:
    small = np.clip(angle, -STRAIGHT, STRAIGHT)
    square = small * small
    series = -small * square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0))
    return np.where(np.abs(angle) < STRAIGHT, series, np.sin(angle) - angle)
