"""Which effects cannot be told from which, when, and what would tell them apart: a fixed table.

Two kinds. By structure: no data of that kind of plant or record can separate the members (one number stands for both).
By experiment: these data hardly separate them, others would.
A change of linear stiffness or damping is in no class: it is a wrong parameter, never an effect.
"""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Literal

Circumstance = Literal[
    "one_dof",
    "unknown_masses",
    "other_masses",
    "one_drive",
    "one_output",
    "one_level",
    "one_way",
    "half_a_sample",
    "small_motion",
    "large_motion",
]
"""What may hold of a plant and its records: one degree of freedom; a structure given as a state space; one input and
masses that are not those of the model as given; one force that drives several masses, known to a tolerance at best; one
measured output; records of about one level; a velocity at the
place that never reverses; a delay that is half a sample off whole ones; motion small, or large, against the length that
shapes the law."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AmbiguityClass:
    """Effects, and other causes, that may be taken for each other.

    Attributes:
        effects: Their keys in the catalogue.
        besides: What else looks the same and is no effect of the catalogue, in words.
        circumstance: When it applies.
        when: The same in words.
        separates: What would tell them apart.
    """

    effects: tuple[str, ...]
    besides: tuple[str, ...] = ()
    circumstance: Circumstance
    when: str
    separates: str

    def others(self, effect: str) -> tuple[str, ...]:
        """All that `effect` may be taken for, keys first."""
        return (*(key for key in self.effects if key != effect), *self.besides)


AMBIGUOUS: tuple[AmbiguityClass, ...] = (
    AmbiguityClass(
        effects=("input_gain", "sensor_gain"),
        besides=("scale of mass, damping and stiffness together", "torque constant against inertia of a motor"),
        circumstance="one_dof",
        when="one input drives one degree of freedom: all of these are one number",
        separates="a second output (a sensor's gain changes one channel, an input's gain changes all), or a known mass "
        "added to the structure",
    ),
    AmbiguityClass(
        effects=("sensor_gain",),
        besides=("a wrong mass where the sensor is",),
        circumstance="unknown_masses",
        when="a state space does not tell its masses: a displacement counted g times as large is that of a mass g^2 "
        "times as light, with stiffnesses to match",
        separates="the mass there from the drawing or a scale, or a known mass added to it",
    ),
    AmbiguityClass(
        effects=("input_gain",),
        besides=("scale of all masses, stiffnesses and dampings",),
        circumstance="one_drive",
        when="one force drives a structure whose masses are known to a tolerance: a drive g times as strong is masses, "
        "stiffnesses and dampings g times as small",
        separates="one of the masses from the drawing or a scale, or a known mass added to the structure",
    ),
    AmbiguityClass(
        effects=("coulomb_friction", "constant_force"),
        circumstance="one_way",
        when="the velocity at the place never reverses, so that the friction never changes its sign",
        separates="a run in the other direction",
    ),
    AmbiguityClass(
        effects=("sensor_bias", "constant_force"),
        besides=("position of the rest point",),
        circumstance="one_output",
        when="one displacement is measured: its offset is the static deflection of a constant force",
        separates="a second output with M, C, K of the structure (a force then moves all in the proportions of the "
        "flexibility, while in a state space its direction may be open), or an accelerometer",
    ),
    AmbiguityClass(
        effects=("periodic_disturbance",),
        besides=("hum in the sensor or its cable",),
        circumstance="one_output",
        when="one output is measured: a sine in its cable is what a sine force of another size makes of it",
        separates="a second output, which hears nothing where a cable is to blame, or a sensor of the kind that rests",
    ),
    AmbiguityClass(
        effects=("actuator_lag", "sensor_lag"),
        circumstance="one_output",
        when="one output is measured: a lag before a linear structure and one behind it are the same",
        separates="a second output, which shows no lag where one sensor is to blame, or the force measured along",
    ),
    AmbiguityClass(
        effects=("input_delay",),
        besides=("a delay of the sensor",),
        circumstance="one_output",
        when="one output is measured: nothing but the clock tells what comes late, the drive or the reading",
        separates="a second output, which is not late where one sensor is to blame, or the force measured along",
    ),
    AmbiguityClass(
        effects=("input_delay",),
        besides=(
            "a wrongly declared hold of the input (half a sample)",
            "an output that is the mean over the sample before, as a speed by differences of counts is",
        ),
        circumstance="half_a_sample",
        when="the delay is about half a sample off whole ones",
        separates="the data sheet of the output stage, or the drive measured along with the outputs",
    ),
    AmbiguityClass(
        effects=("coulomb_friction", "quadratic_drag"),
        besides=("viscous damping",),
        circumstance="one_level",
        when="records of one level: both add damping (2 ln L margin 55 at one weak level, 5749 at three)",
        separates="a level at least three times lower: the relative gap of friction grows as the level falls, that of "
        "drag shrinks",
    ),
    AmbiguityClass(
        effects=("gap_spring", "cubic_stiffness"),
        circumstance="one_level",
        when="records of one level: stops and cubic stiffness both harden (2 ln L margin 133 at one weak level, 9437 "
        "at three)",
        separates="one level that stays within the gap and one beyond contact",
    ),
    AmbiguityClass(
        effects=("bilinear_stiffness", "quadratic_stiffness"),
        circumstance="one_level",
        when="records of one level: both give even harmonics (2 ln L margin 245 at one weak level, above 1658 at "
        "three)",
        separates="a second level: the relative gap of bilinear stiffness stays, that of quadratic stiffness grows",
    ),
    AmbiguityClass(
        effects=("input_saturation", "input_gain"),
        circumstance="one_level",
        when="records of one level: a drive that is often clipped is a weaker drive",
        separates="one level below the limit and one far above it",
    ),
    AmbiguityClass(
        effects=("missing_mode", "periodic_disturbance"),
        circumstance="one_level",
        when="records of one level: both leave a narrow band (2 ln L margin 8 at one weak level, 191 at three)",
        separates="a second level, or a record without drive: a mode scales with the drive, a disturbance does not",
    ),
    AmbiguityClass(
        effects=("power_law_flow", "overflow"),
        circumstance="one_level",
        when="the level stays in a narrow range: both let out more at its top",
        separates="records from nearly empty to overflowing",
    ),
    AmbiguityClass(
        effects=("sine_softening", "cubic_stiffness"),
        circumstance="small_motion",
        when="the motion stays below the length scale: the sine is a negative cubic, k3 = -k / (6 length_scale^2)",
        separates="a level at which the motion exceeds the length scale",
    ),
    AmbiguityClass(
        effects=("bouc_wen_hysteresis", "coulomb_friction", "slack_in_hysteresis"),
        circumstance="large_motion",
        when="the motion is far beyond yield displacement and slack: what is left of each loop is a rectangle",
        separates="a level at which the motion about equals the yield displacement",
    ),
)
"""The table of DISCREPANCY 6; margins are those of its prototypes."""


def ambiguous_with(
    effect: str, *, circumstances: Collection[Circumstance] = (), even_with: Collection[str] = ()
) -> tuple[AmbiguityClass, ...]:
    """The classes in which an effect stands under the circumstances of a plant and its records.

    Args:
        effect: Key in the catalogue.
        circumstances: What holds.
        even_with: Keys of effects for which the evidence is no weaker; the classes that they share with `effect` hold
            whatever the circumstances.

    Returns:
        The classes in the order of the table; empty where the effect cannot be taken for another.

    Example:
        >>> [found.others("input_gain") for found in ambiguous_with("input_gain", circumstances=["one_level"])]
        [('input_saturation',)]
        >>> ambiguous_with("input_gain")
        ()
        >>> [found.others("sensor_bias")[0] for found in ambiguous_with("sensor_bias", even_with=["constant_force"])]
        ['constant_force']
    """
    holds, even = set(circumstances), set(even_with) - {effect}
    return tuple(
        found
        for found in AMBIGUOUS
        if effect in found.effects and (found.circumstance in holds or not even.isdisjoint(found.effects))
    )
