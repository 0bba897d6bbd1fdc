"""What a generator hands over: plain arrays and words, nothing of okid, era or modal.

Names of places are those that the product gives: "element_1" joins degrees of freedom 0 and 1 ("element_0": degree of
freedom 0 and the ground), "dof_1" is a force on one degree of freedom, "input_0" and "output_0" are channels; in a
general state space a place is an output or a pair of them, "output_0-output_1".
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class NominalChain:
    """The linear model that the user has: masses right, stiffnesses off by up to 5 %, dampings by up to 30 %.

    Element e joins degree of freedom e - 1 and e, element 0 the ground. SI units.
    """

    masses: np.ndarray
    stiffnesses: np.ndarray
    dampings: np.ndarray
    force_dofs: tuple[int, ...]
    sensor_dofs: tuple[int, ...]
    sensor_kind: str


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class NominalStateSpace:
    """The linear model that the user has, in continuous time and in coordinates that mean nothing."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    sensor_kind: str


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class NominalMotor:
    """J w' = kt u - b w; w is measured. Also a tank: area level' = kt u - b level."""

    J: float
    b: float
    kt: float
    is_flow: bool


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class HiddenRecord:
    """One record: inputs (n_samples, n_inputs), measured and clean outputs (n_samples, n_outputs)."""

    inputs: np.ndarray
    outputs: np.ndarray
    clean_outputs: np.ndarray
    noise_variance: np.ndarray
    dt: float
    hold: str
    level: float
    starts_at_rest: bool
    name: str


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class HiddenEffect:
    """What was hidden: the name in the catalogue, where, and its parameters by name, SI units."""

    effect: str
    place: str
    parameters: dict[str, float]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class HiddenCase:
    """A wrong linear model, records that know better, and the truth.

    `gap_to_noise`: what the hidden effects (all of them; each by itself) add to the held-out outputs that no change of
    stiffness, damping or initial state explains, root mean square over the noise's deviation.
    `truth`: true linear numbers by name, for who wants to look.
    """

    kind: str
    seed: int
    nominal: NominalChain | NominalStateSpace | NominalMotor
    fit: tuple[HiddenRecord, ...]
    held_out: tuple[HiddenRecord, ...]
    effects: tuple[HiddenEffect, ...]
    gap_to_noise: tuple[float, ...]
    velocity_reverses: bool
    truth: dict[str, np.ndarray]
