"""Random sizes of effects: forces of 10 to 40 % of the elastic or driving force at the middle level.

Contact, yielding and saturation are placed between the motion at the lowest and at the highest level. `strength`
scales an effect down (0.2: effects at 20 % of the strength).

Nothing here imports okid, era or modal.
"""

from dataclasses import dataclass

import numpy as np

__all__ = ["Surroundings", "draw_parameters"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Surroundings:
    """Where the effect will act: standard deviations at the middle level, of the linear model.

    `top`: ratio of the highest to the middle level.
    """

    displacement: float
    velocity: float
    input: float
    output: float
    force: float
    stiffness: float
    mass: float
    frequencies: np.ndarray
    dt: float
    duration: float
    top: float
    strength: float

    @property
    def elastic(self):
        return self.stiffness * self.displacement

    @property
    def driving(self):
        """The lesser of driving and elastic force: what friction may take away."""
        return min(self.force, self.elastic) if self.stiffness > 0 else self.force


def draw_parameters(effect, rng, at):
    """Parameter values by name."""
    return _DRAWS[effect](rng, at)


def _sign(rng, negative=0.5):
    return -1.0 if rng.random() < negative else 1.0


def _share(rng, at):
    return at.strength * rng.uniform(0.1, 0.4)


def _cubic(rng, at):
    return {"k3": _share(rng, at) * at.stiffness / (3.9 * at.displacement**2) * (0.5 if at.top > 2 else 1.0)}


def _quadratic(rng, at):
    escape = at.stiffness / (3.2 * at.top * at.displacement)
    return {"k2": _sign(rng) * at.strength * rng.uniform(0.25, 0.6) * escape}


def _bilinear(rng, at):
    sign = _sign(rng, 0.3)
    return {"kb": sign * at.strength * rng.uniform(0.15, 0.5 if sign > 0 else 0.35) * at.stiffness}


def _gap(rng, at):
    weaker = at.strength
    if rng.random() < 0.3:
        share = weaker * rng.uniform(0.3, 0.6)
        return {"k_in": -share * at.stiffness, "k_out": 0.0, "gap": rng.uniform(0.8, 1.6) * at.displacement}
    return {"k_in": 0.0, "k_out": weaker * rng.uniform(0.5, 2.5) * at.stiffness,
            "gap": rng.uniform(1.3, 2.0) * at.displacement}  # fmt: skip


def _coulomb(rng, at):
    return {"Fc": _share(rng, at) * at.driving}


def _drag(rng, at):
    return {"c2": _share(rng, at) * at.driving / (1.73 * at.velocity**2)}


def _bouc_wen(rng, at):
    limit = rng.uniform(0.4, 1.2) * at.displacement
    return {"a": _share(rng, at) * at.elastic / limit, "yield_displacement": limit, "n": rng.uniform(1.0, 3.0)}


def _sine(rng, at):
    highest = 3.2 * at.top * at.displacement
    return {"length_scale": highest / (rng.uniform(0.6, 1.1) * np.sqrt(at.strength))}


def _slack(rng, at):
    limit = rng.uniform(0.2, 0.6) * at.displacement
    return {"k": _share(rng, at) * at.elastic / limit, "yield_displacement": limit,
            "slack": rng.uniform(0.2, 0.6) * at.displacement}  # fmt: skip


def _constant(rng, at):
    return {"offset": _sign(rng) * 1.5 * _share(rng, at) * at.driving}


def _time_varying(rng, at):
    sign = _sign(rng)
    return {"rate": sign * at.strength * rng.uniform(0.12, 0.35) * at.stiffness / at.duration}


def _missing_mode(rng, at):
    return {"mass_ratio": at.strength * rng.uniform(0.02, 0.1), "damping": rng.uniform(0.01, 0.05),
            "frequency": rng.uniform(0.8, 1.3) * rng.choice(at.frequencies) / (2 * np.pi)}  # fmt: skip


def _delay(rng, at):
    return {"tau": at.strength * rng.uniform(0.6, 3.5) * at.dt}


def _saturation(rng, at):
    lowest, highest = (1.3, 2.0) if at.strength == 1 else (1.6, 2.0)
    if at.strength < 1:  # only the peaks of the highest level
        lowest, highest = lowest * at.top, highest * at.top
    return {"limit": rng.uniform(lowest, highest) * at.input}


def _gain(rng, at):
    return {"gain": 1.0 + _sign(rng) * at.strength * rng.uniform(0.1, 0.35)}


def _bias(rng, at):
    return {"offset": _sign(rng) * _share(rng, at) * at.output,
            "slope": _sign(rng) * at.strength * rng.uniform(0.2, 0.6) * at.output / at.duration}  # fmt: skip


def _periodic(rng, at):
    frequency = at.frequencies[0] / (2 * np.pi) * rng.uniform(0.4, 1.8)
    return {"amplitude": _share(rng, at) * at.driving, "frequency": frequency}


def _power_law(rng, at):
    return {"exponent": rng.uniform(0.4, 0.7)}


_DRAWS = {
    "cubic_stiffness": _cubic,
    "quadratic_stiffness": _quadratic,
    "bilinear_stiffness": _bilinear,
    "gap_spring": _gap,
    "coulomb_friction": _coulomb,
    "quadratic_drag": _drag,
    "bouc_wen_hysteresis": _bouc_wen,
    "sine_softening": _sine,
    "slack_in_hysteresis": _slack,
    "constant_force": _constant,
    "time_varying_stiffness": _time_varying,
    "missing_mode": _missing_mode,
    "input_delay": _delay,
    "input_saturation": _saturation,
    "input_gain": _gain,
    "sensor_bias": _bias,
    "sensor_gain": _gain,
    "periodic_disturbance": _periodic,
}
