"""Force laws with a sharp sign, a sharp contact and a sharp stop: what the hidden truth obeys.

A law gives the force on the left-hand side of the equation of motion from the relative displacement d and velocity v
at its place, both (n_records, 1, 1), a state z of its own of the same shape and the time t [s] since the record began.
Nothing is smoothed. Coulomb friction stands apart (`hidden_integrator.py`): its force at rest is no function of the
motion.

Nothing here imports okid, era or modal.
"""

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Law:
    """A force that is a function of the motion at a place, of a state of its own, and of time."""

    has_rate = False  # z' = memory_rate(...)
    has_slider = False  # z is dragged along by d, at once

    def force(self, d, v, z, t):
        raise NotImplementedError

    def memory_rate(self, d, v, z, t):
        return np.zeros_like(z)

    def slid(self, d, z):
        """The state once d has dragged it along."""
        return z

    def for_record(self, index):
        """The law as one record alone sees it."""
        return self


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class NoForce(Law):
    def force(self, d, v, z, t):
        return np.zeros_like(d)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CubicStiffness(Law):
    k3: float

    def force(self, d, v, z, t):
        return self.k3 * d * d * d


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class QuadraticStiffness(Law):
    k2: float

    def force(self, d, v, z, t):
        return self.k2 * d * d


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class BilinearStiffness(Law):
    kb: float

    def force(self, d, v, z, t):
        return self.kb * np.maximum(d, 0.0)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class GapSpring(Law):
    """Stops (k_in = 0) or a loose joint (k_in < 0 takes stiffness away inside the gap)."""

    k_in: float
    k_out: float
    gap: float

    def force(self, d, v, z, t):
        return self.k_in * d + (self.k_out - self.k_in) * (d - np.minimum(np.maximum(d, -self.gap), self.gap))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Coulomb(Law):
    """Fc sign(v) where it slides; where it sticks, whatever holds it, up to Fc (`hidden_integrator.py`)."""

    Fc: float

    def force(self, d, v, z, t):
        raise NotImplementedError


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class QuadraticDrag(Law):
    c2: float

    def force(self, d, v, z, t):
        return self.c2 * v * np.abs(v)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class BoucWen(Law):
    """a z with z' = v (1 - (1 + sign(v z)) / 2 |z / yield_displacement|^n)."""

    a: float
    yield_displacement: float
    n: float
    has_rate = True

    def force(self, d, v, z, t):
        return self.a * z

    def memory_rate(self, d, v, z, t):
        return v * (1.0 - (v * z > 0.0) * np.abs(z / self.yield_displacement) ** self.n)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SineSoftening(Law):
    """k L (sin(d / L) - d / L) with L the length scale and k the linear stiffness: together k L sin(d / L)."""

    k: float
    length_scale: float

    def force(self, d, v, z, t):
        return self.k * (self.length_scale * np.sin(d / self.length_scale) - d)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SlackInHysteresis(Law):
    """An elastoplastic link (stiffness k, yields at a stretch of yield_displacement) in series with play of +-slack.

    z is the place of the slider: it rests while |d - z| < slack + yield_displacement and is dragged along beyond.
    """

    k: float
    yield_displacement: float
    slack: float
    has_slider = True

    def slid(self, d, z):
        reach = self.slack + self.yield_displacement
        return np.minimum(np.maximum(z, d - reach), d + reach)

    def force(self, d, v, z, t):
        stretch = d - self.slid(d, z)
        return self.k * (stretch - np.minimum(np.maximum(stretch, -self.slack), self.slack))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ConstantForce(Law):
    offset: float

    def force(self, d, v, z, t):
        return 0.0 * d + self.offset


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TimeVaryingStiffness(Law):
    """rate t d with t from the start of each record."""

    rate: float

    def force(self, d, v, z, t):
        return self.rate * t * d


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PeriodicDisturbance(Law):
    """amplitude sin(2 pi frequency t + phase), the phase another one in each record (n_records, 1, 1)."""

    amplitude: float
    frequency: float
    phases: np.ndarray

    def force(self, d, v, z, t):
        return self.amplitude * np.sin(2 * np.pi * self.frequency * t + self.phases)

    def for_record(self, index):
        return replace(self, phases=self.phases[index : index + 1])


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PowerLawFlow(Law):
    """coefficient |v|^exponent sign(v) - linear v: the outflow is a power of the level v, not a multiple of it."""

    coefficient: float
    exponent: float
    linear: float

    def force(self, d, v, z, t):
        return self.coefficient * np.sign(v) * np.abs(v) ** self.exponent - self.linear * v


LAWS = {
    "cubic_stiffness": CubicStiffness,
    "quadratic_stiffness": QuadraticStiffness,
    "bilinear_stiffness": BilinearStiffness,
    "gap_spring": GapSpring,
    "coulomb_friction": Coulomb,
    "quadratic_drag": QuadraticDrag,
    "bouc_wen_hysteresis": BoucWen,
    "sine_softening": SineSoftening,
    "slack_in_hysteresis": SlackInHysteresis,
    "constant_force": ConstantForce,
    "time_varying_stiffness": TimeVaryingStiffness,
    "periodic_disturbance": PeriodicDisturbance,
    "power_law_flow": PowerLawFlow,
}


def law_from(effect, **values):
    """The law of an effect's name with its parameter values."""
    return LAWS[effect](**values)
