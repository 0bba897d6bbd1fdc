"""The kinds of cases: what the plant is, what is measured, how noisy, and which effects may be hidden in it.

Nothing here imports okid, era or modal.
"""

from dataclasses import dataclass

import numpy as np

MOTION = (
    "cubic_stiffness", "quadratic_stiffness", "bilinear_stiffness", "gap_spring", "coulomb_friction", "quadratic_drag",
    "bouc_wen_hysteresis", "sine_softening", "slack_in_hysteresis", "time_varying_stiffness", "missing_mode",
    "periodic_disturbance",
)  # fmt: skip
CHANNELS = ("input_delay", "input_saturation", "input_gain", "sensor_bias", "sensor_gain")
STRUCTURE = (*MOTION, "constant_force", *CHANNELS)
SEEN_BY_ACCELEROMETERS = (*MOTION, *CHANNELS)  # a constant force shows in no acceleration
UNKNOWN_STIFFNESS = tuple(e for e in STRUCTURE if e != "sine_softening")  # its law needs the stiffness of an element
FAMILIES = {
    "cubic_stiffness": "odd", "gap_spring": "odd", "sine_softening": "odd", "quadratic_stiffness": "even",
    "bilinear_stiffness": "even", "coulomb_friction": "damping", "quadratic_drag": "damping",
    "bouc_wen_hysteresis": "loop", "slack_in_hysteresis": "loop", "time_varying_stiffness": "time",
    "missing_mode": "line", "periodic_disturbance": "line", "constant_force": "offset", "sensor_bias": "offset",
    "input_delay": "delay", "input_saturation": "gain", "input_gain": "gain", "sensor_gain": "gain",
}  # fmt: skip
"""Two effects at once are of two families."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Kind:
    """One line of the confusion table. `plants`: drawn at random, (plant, n_dofs, sensor kind, n_sensors)."""

    number: int
    plants: tuple[tuple[str, int, str, int], ...]
    effects: tuple[tuple[str, ...], ...]
    noise: tuple[float, float]
    strength: float = 1.0
    levels: tuple[float, float, float] = (1.0, 2.5, 6.0)
    n_fit: tuple[int, ...] = (2, 2, 3)


def _each(effects):
    return tuple((effect,) for effect in effects)


ONE_DISPLACEMENT = (("chain", 1, "displacement", 1),)
ONE_ACCELEROMETER = (("chain", 1, "acceleration", 1),)
THREE_DISPLACEMENT = (("chain", 3, "displacement", 3),)
THREE_ACCELEROMETERS = (("chain", 3, "acceleration", 3), ("chain", 3, "acceleration", 2))
STATE_SPACE = (
    ("state_space", 2, "displacement", 2), ("state_space", 2, "acceleration", 2), ("state_space", 3, "displacement", 3),
    ("state_space", 3, "acceleration", 3), ("state_space", 3, "displacement", 2),
)  # fmt: skip
MOTOR = (("motor", 1, "velocity", 1),)
TANK = (("tank", 1, "velocity", 1),)
TWO = (
    ("chain", 1, "displacement", 1), ("chain", 1, "acceleration", 1), ("chain", 2, "displacement", 2),
    ("chain", 2, "acceleration", 2), ("chain", 3, "displacement", 3), ("chain", 3, "acceleration", 3),
)  # fmt: skip
ALL_PAIRS = tuple(
    (first, second)
    for i, first in enumerate(SEEN_BY_ACCELEROMETERS)
    for second in SEEN_BY_ACCELEROMETERS[i + 1 :]
    if FAMILIES[first] != FAMILIES[second]
)
PAIRS = tuple(ALL_PAIRS[i] for i in np.random.default_rng(0).permutation(len(ALL_PAIRS)))
"""In no order, so that any run of seeds holds pairs of every sort."""

KINDS = {
    "1dof_displacement": Kind(number=1, plants=ONE_DISPLACEMENT, effects=_each(STRUCTURE), noise=(0.01, 0.01)),
    "1dof_accelerometer": Kind(
        number=2, plants=ONE_ACCELEROMETER, effects=_each(SEEN_BY_ACCELEROMETERS), noise=(0.02, 0.02)
    ),
    "3dof_displacement": Kind(number=3, plants=THREE_DISPLACEMENT, effects=_each(STRUCTURE), noise=(0.01, 0.01)),
    "3dof_accelerometers": Kind(
        number=4, plants=THREE_ACCELEROMETERS, effects=_each(SEEN_BY_ACCELEROMETERS), noise=(0.02, 0.02)
    ),
    "state_space": Kind(number=5, plants=STATE_SPACE, effects=_each(UNKNOWN_STIFFNESS), noise=(0.01, 0.02)),
    "motor_propeller": Kind(
        number=6,
        plants=MOTOR,
        effects=(("quadratic_drag",), ("input_delay",), ("input_saturation",), ("quadratic_drag", "input_delay"), ()),
        noise=(0.005, 0.02),
    ),
    "motor_friction": Kind(
        number=7, plants=MOTOR, effects=(("coulomb_friction",),), noise=(0.005, 0.02), levels=(1.0, 1.7, 3.0)
    ),
    "tank": Kind(
        number=8,
        plants=TANK,
        effects=_each(("power_law_flow", "overflow")),
        noise=(0.005, 0.02),
        levels=(1.0, 1.6, 2.5),
    ),
    "two_effects": Kind(number=9, plants=TWO, effects=PAIRS, noise=(0.01, 0.02)),
    "weak_effects": Kind(
        number=10,
        plants=(*ONE_DISPLACEMENT, *THREE_DISPLACEMENT),
        effects=_each(STRUCTURE),
        noise=(0.01, 0.01),
        strength=0.2,
        n_fit=(3,),
    ),
    "none": Kind(
        number=11,
        plants=(
            *ONE_DISPLACEMENT,
            *ONE_ACCELEROMETER,
            *THREE_DISPLACEMENT,
            *THREE_ACCELEROMETERS,
            *STATE_SPACE,
            *MOTOR,
        ),
        effects=((),),
        noise=(0.005, 0.05),
    ),
}
