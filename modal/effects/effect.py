"""What an effect is: a force law at a port, a change of an input, or a change of a sensor.

A force law is given with its derivatives, so that the simulation's Newton steps and every sensitivity are exact. All
arrays run over samples; parameter values arrive as a sequence with one entry a parameter, each a float or, where the
parameter has a value of its own in each record, an array over the samples: `values[j]` broadcasts either way.
Force laws stand on the left-hand side of the equation of motion: a positive force opposes positive motion.

A law with a corner gives Newton steps two slopes to jump between, so contact is smoothed; a width of 0 gives the sharp
law exactly.

A level that a flow calls back, h' = -s h, dies down by exp(-z) in a step dt, z = s dt. With the share theta of the flow
at the end of the step in its mean over the step it dies down by (1 - (1 - theta) z) / (1 + theta z). A line between
both ends, theta = 1/2, is right to second order, but of a brim as hard as a wall it makes -1: the flow rings from step
to step for ever. With

    theta(z) = 1 - 1 / (2 + z^2 / 2)

a soft flow has the line and a wall has all at the end (0: the level is held). In between z (1 - theta) is never more
than 1/2. So the level at the end of a step rises with that at its start however hard the brim, as long as the plant
itself keeps half of its level over a step; and Newton's method on the whole trajectory settles from any start.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from okid.arrays import FloatArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Motion:
    """Motion at a port, at n samples of one or several records laid end to end.

    Attributes:
        displacement: (n,); zeros where the port has none.
        velocity: (n,); zeros where the port has none.
        time: (n,) [s] since the start of each record.
        memory: (n, n_memory) states of the effect itself.
        displacement_scale: Standard deviation of the displacement over the records to fit, for smoothing and starts.
        velocity_scale: Likewise of the velocity.
        stiffness: Linear stiffness at the port (1.0 where it is not known).
        mass: Mass at the port (1.0 where it is not known).
        mobility: Velocity that a unit of force at the port gives within one step; 0: no steps, or not known.
        step_compliance: Displacement that a force of 1 takes away within a step, where it moves it at once (a flow);
            0 elsewhere.
        smoothing: Width over which sharp laws (sign, contact) are smoothed, as a share of the scale, for all samples
            or (n,) for each (a quiet record has a smaller width); 0: sharp.
    """

    displacement: FloatArray
    velocity: FloatArray
    time: FloatArray
    memory: FloatArray
    displacement_scale: float
    velocity_scale: float
    stiffness: float = 1.0
    mass: float = 1.0
    mobility: float = 0.0
    step_compliance: float = 0.0
    smoothing: float | FloatArray = 0.0


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Force:
    """A force law and its derivatives, each over n samples.

    Attributes:
        value: (n,).
        by_displacement: (n,).
        by_velocity: (n,).
        by_memory: (n, n_memory).
        by_parameter: (n, n_parameters).
    """

    value: FloatArray
    by_displacement: FloatArray
    by_velocity: FloatArray
    by_memory: FloatArray
    by_parameter: FloatArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class StepValue:
    """A value over each step and its derivatives by the motion that the law reads.

    Attributes:
        value: (n,).
        by_before: (n,) by the motion at the start of the step.
        by_after: (n,) by the motion at its end.
        by_parameter: (n, n_parameters).
    """

    value: FloatArray
    by_before: FloatArray
    by_after: FloatArray
    by_parameter: FloatArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class StepForce:
    """The straight line that stands for a force over each step, for laws that jump or stop the motion within it.

    Attributes:
        start: At the start of the step.
        end: At its end.
        lift: What a sensor at the start of the step hears of the force besides the law's own value there; None for
            nothing.
        reads: The motion that the law reads, and the derivatives are by.
    """

    start: StepValue
    end: StepValue
    lift: StepValue | None = None
    reads: Literal["displacement", "velocity"] = "velocity"


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Memory:
    """States of an effect one sample on, explicit in the states before and the motion before and after.

    Attributes:
        value: (n, n_memory).
        by_memory: (n, n_memory, n_memory), by the states one sample before.
        by_displacement_before: (n, n_memory).
        by_velocity_before: (n, n_memory).
        by_displacement_after: (n, n_memory).
        by_velocity_after: (n, n_memory).
        by_parameter: (n, n_memory, n_parameters).
    """

    value: FloatArray
    by_memory: FloatArray
    by_displacement_before: FloatArray
    by_velocity_before: FloatArray
    by_displacement_after: FloatArray
    by_velocity_after: FloatArray
    by_parameter: FloatArray


Values = Sequence[float | FloatArray] | FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterKind:
    """What a parameter of an effect is.

    Attributes:
        name: Its name.
        meaning: What it is, in a few words.
        dimension: Powers of (force, length, time) that make its unit; the length is that of the port's displacement
            (an angle at a rotary port), for sensors and inputs "force" is the channel's own unit.
        lower: Hard lower bound (0 forbids a negative friction, drag or gap).
        upper: Hard upper bound.
        role: "amplitude": the effect is proportional to its distance from the neutral value (of these together);
            "shape": it is not.
        local: Whether every record has a value of its own (the phase of a disturbance).
    """

    name: str
    meaning: str
    dimension: tuple[int, int, int]
    lower: float = -np.inf
    upper: float = np.inf
    role: Literal["amplitude", "shape"] = "amplitude"
    local: bool = False


N_PEAKS = 3
"""Try an effect with a frequency of its own at so many of the highest peaks of what the model leaves."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Situation:
    """What an effect may look at to propose values to start from.

    Attributes:
        motion: Motion at its port over the records to fit (of an input or a sensor: the signal as displacement).
        residual_frequencies: Frequencies [Hz] at which what the model leaves has its highest peaks, greatest first.
        dt: Sampling interval [s].
        longest: Duration of the longest record [s].
    """

    motion: Motion
    residual_frequencies: tuple[float, ...]
    dt: float
    longest: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Effect:
    """What every effect has.

    Class attributes:
        key: Key in the catalogue.
        law: The law in one line of plain text.
        parameters: Its parameters, in the order of `values`.
        neutral: Values at which the effect vanishes (amplitude 0, gain 1, delay 0, limit infinite); shapes any.
        family: Effects that may be taken for each other share a family; the search keeps the best of each.
        signature: How it shows in the data, in a few words.
        reference: Source of the law.
        n_memory: Number of states of its own.
        rate_independent: Whether these depend on where the motion went and not on how fast or when; a law that adds
            such a dependence to one without sets it to False.
        is_brim: Whether it is a flow that rises with the level alone, the steeper the higher (convex).
        limits: Keys of simpler laws that it turns into.
        contains: Keys of effects that it fits as well with more numbers: no rival of theirs unless it fits better.
        like_a_mass: Whether a wrong mass may be taken for it, so that it is tried where one explains the records.
    """

    key: ClassVar[str]
    law: ClassVar[str]
    parameters: ClassVar[tuple[ParameterKind, ...]]
    neutral: ClassVar[tuple[float, ...]]
    family: ClassVar[str]
    signature: ClassVar[str]
    reference: ClassVar[str]
    n_memory: ClassVar[int] = 0
    rate_independent: ClassVar[bool] = False
    is_brim: ClassVar[bool] = False
    limits: ClassVar[tuple[str, ...]] = ()
    contains: ClassVar[tuple[str, ...]] = ()
    like_a_mass: ClassVar[bool] = False

    def starts(self, situation: Situation) -> tuple[tuple[float, ...], ...]:  # noqa: ARG002 - for laws with shapes
        """Values to start from: one tuple for each shape worth a try, amplitudes of 1 (they enter linearly).

        Unless an effect has shapes to choose from, it is one start at its neutral shape.
        """
        neutral = zip(self.parameters, self.neutral, strict=True)
        return (tuple(1.0 if kind.role == "amplitude" else value for kind, value in neutral),)

    def over(self, motion: Motion) -> "Effect":  # noqa: ARG002 - for laws of unknown form
        """The effect for a motion such as this; laws of unknown form learn its range."""
        return self

    def with_values(self, values: Mapping[str, Any]) -> "Effect":  # noqa: ARG002 - likewise
        """The effect that these values by name belong to; a law of unknown form has as many points as there are."""
        return self

    def known_values(self, length_unit: str) -> tuple[float | None, ...]:  # noqa: ARG002 - for laws of angles
        """Value of each parameter that is known before any data, where the port's displacement has this unit.

        A parameter that is found at its known value was predicted, not fitted, and counts for nothing in a comparison
        with laws that have a free one.
        """
        return (None,) * len(self.parameters)


@dataclass(frozen=True, slots=True, kw_only=True)
class ForceEffect(Effect):
    """A force that the motion at a port calls up.

    Class attributes:
        needs: What the law reads ("displacement", "velocity", "stiffness"); a port without it is no place for the
            effect.
        acts_at: What a port must accept: "motion", "force", "mass" or "flow".
        has_corners: Whether the law bends at a point (contact, slip), so that where a step of time passes it matters.
        first_term: Whether the law is the first term of a series: laws with the next ones come as near as one likes.
        per_stiffness: Whether the force is proportional to the linear stiffness at the place.
        form_free: Whether it is any law of its motion: tried where no law with a name is enough.
        beside_stiffness: Parameters of which, where the linear stiffness at the place is free as well, only the
            differences are determined: the smallest is held at zero.
    """

    needs: ClassVar[frozenset[str]] = frozenset({"displacement"})
    acts_at: ClassVar[str] = "motion"
    has_corners: ClassVar[bool] = False
    first_term: ClassVar[bool] = False
    per_stiffness: ClassVar[bool] = False
    beside_stiffness: ClassVar[tuple[str, ...]] = ()
    form_free: ClassVar[bool] = False

    def force(self, values: Values, motion: Motion) -> Force:
        """The force and its derivatives."""
        raise NotImplementedError

    def step_force(self, values: Values, before: Motion, after: Motion) -> StepForce | None:  # noqa: ARG002 - most laws have none
        """The line that stands for the force over each step.

        None (most laws): the line between its values at the ends.
        """
        return None

    def screen_columns(self, values: Values, motion: Motion) -> FloatArray:
        """Force histories (n, n_columns) whose weighted sum is the effect at the shape in `values`.

        One column an amplitude, unless an effect says otherwise (a disturbance of unknown phase: sine and cosine).
        Where a parameter is local to a record, each record has weights of its own.
        """
        amplitudes = [index for index, kind in enumerate(self.parameters) if kind.role == "amplitude"]
        return self.force(values, motion).by_parameter[:, amplitudes]

    def from_screen(self, values: Values, weights: Sequence[float] | FloatArray) -> tuple[float, ...]:
        """Values for one record at the shape in `values` with these weights (n_columns,), within the sign bounds."""
        left = iter(weights)
        return tuple(
            min(max(float(next(left)), kind.lower), kind.upper) if kind.role == "amplitude" else float(value)
            for kind, value in zip(self.parameters, values, strict=True)
        )

    def advance(self, values: Values, before: Motion, after: Motion, dt: float) -> Memory:
        """The effect's own states one sample on (only where `n_memory` > 0)."""
        raise NotImplementedError

    def undriven(self, values: Values) -> "tuple[ForceEffect, tuple[float, ...], float] | None":  # noqa: ARG002 - most laws have none
        """The limit at which no motion reaches the law's own states, which go on by themselves from where they begin.

        Returns:
            That law, its values, and the factor on the own states; None (most laws) where there is no such limit.
        """
        return None


@dataclass(frozen=True, slots=True, kw_only=True)
class InputEffect(Effect):
    """A change of an input before it drives the plant.

    The input is piecewise linear: `start` and `end` (n_steps,) are its values at both ends of each step.
    """

    def apply(self, values: Values, start: FloatArray, end: FloatArray, dt: float) -> tuple[FloatArray, FloatArray]:
        """Start and end of each step after the change, (n_steps,) each; one record at a time."""
        raise NotImplementedError

    def at_samples(
        self,
        values: Values,
        sample: FloatArray,
        start: FloatArray,  # noqa: ARG002 - for changes that do not act at each moment by itself
        end: FloatArray,  # noqa: ARG002 - likewise
        dt: float,
    ) -> FloatArray:
        """The input at each time itself, as it reaches the outputs directly, (n_times,); one record at a time.

        `sample`, `start` and `end` are those before the change. A change that acts at each moment by itself is applied
        to the samples.
        """
        return self.apply(values, sample, sample, dt)[0]

    def unheard(self, values: Values, dt: float) -> tuple[int, int]:  # noqa: ARG002 - most changes act at once
        """Times at the start and at the end of a record whose drive lies outside of it, and is not known."""
        return 0, 0

    def by_parameter(
        self, values: Values, sample: FloatArray, start: FloatArray, end: FloatArray, dt: float
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Derivatives of start and end of each step and of the samples, (n_parameters, n_times) each.

        Central differences, unless an effect knows better: where a parameter has a bend or a jump (a delay of whole
        steps), it gives those of one side, because differences across a jump have no bound.
        """

        def changed(at: list[float]) -> FloatArray:
            return np.stack([*self.apply(at, start, end, dt), self.at_samples(at, sample, start, end, dt)])

        found = []
        given = [float(value) for value in values]
        for j, kind in enumerate(self.parameters):
            width = 1e-5 * max(abs(given[j]), dt if kind.dimension == (0, 0, 1) else 1e-2)
            above, below = ([*given[:j], given[j] + step, *given[j + 1 :]] for step in (width, -width))
            found.append((changed(above) - changed(below)) / (2.0 * width))
        by_start, by_end, by_sample = np.moveaxis(np.array(found), 1, 0)
        return by_start, by_end, by_sample


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorEffect(Effect):
    """A change of an output after the plant: y becomes gain(values) y + offset(values, time).

    One that remembers (`n_memory` > 0) has `force` and `advance` as a force has, of which the displacement is the
    output: the "force" is what the sensor shows less the output.
    """

    def force(self, values: Values, motion: Motion) -> Force:
        """What the sensor shows less the output, and its derivatives (only where `n_memory` > 0)."""
        raise NotImplementedError

    def advance(self, values: Values, before: Motion, after: Motion, dt: float) -> Memory:
        """The effect's own states one sample on (likewise)."""
        raise NotImplementedError

    def changed(self, values: Values, output: FloatArray, time: FloatArray) -> FloatArray:
        """The output of one record, (n,), as the sensor shows it."""
        return self.gain(values) * output + self.offset(values, time)

    def screen_columns(self, values: Values, output: FloatArray, time: FloatArray) -> FloatArray:  # noqa: ARG002 - linear in the parameters
        """Changes of an output whose weighted sum is the effect, (n, n_columns)."""
        return self.by_parameter(self.neutral, output, time)

    def gain(self, values: Values) -> float | FloatArray:  # noqa: ARG002 - for changes of the gain
        """Factor on the output; 1 unless an effect says otherwise."""
        return 1.0

    def offset(self, values: Values, time: FloatArray) -> FloatArray:  # noqa: ARG002 - for offsets
        """What is added, (n,); nothing unless an effect says otherwise."""
        return np.zeros_like(time)

    def by_parameter(self, values: Values, output: FloatArray, time: FloatArray) -> FloatArray:
        """Derivative (n, n_parameters) for the true output `output` (n,)."""
        raise NotImplementedError


def jumps(effect: Effect) -> bool:
    """Whether an effect is a force that changes all at once and brings its own line over a step (friction, a brim)."""
    return isinstance(effect, ForceEffect) and type(effect).step_force is not ForceEffect.step_force


def is_form_free(effect: Effect) -> bool:
    """Whether an effect is a law of unknown form."""
    return isinstance(effect, ForceEffect) and effect.form_free


def is_sharp(effect: Effect) -> bool:
    """Whether the grid of time and the smoothing limit how well an effect is known: it jumps or has corners."""
    return jumps(effect) or (isinstance(effect, ForceEffect) and effect.has_corners)


def memoryless(
    motion: Motion,
    value: FloatArray,
    by_parameter: Sequence[FloatArray],
    *,
    by_displacement: FloatArray | None = None,
    by_velocity: FloatArray | None = None,
) -> Force:
    """The force of a law that reads the motion of the moment only; slopes that are not given are 0.

    Args:
        motion: Motion at the port.
        value: (n,) force.
        by_parameter: One derivative (n,) for each parameter.
        by_displacement: (n,) derivative by the displacement.
        by_velocity: (n,) derivative by the velocity.

    Returns:
        The force with its derivatives; `by_memory` has no columns.
    """
    zeros = np.zeros_like(motion.displacement)
    return Force(
        value=value,
        by_displacement=zeros if by_displacement is None else by_displacement,
        by_velocity=zeros if by_velocity is None else by_velocity,
        by_memory=np.zeros((len(zeros), 0)),
        by_parameter=np.stack(by_parameter, axis=1),
    )


LARGEST = 1e60
"""Cut motion beyond this: a run that diverges is rejected by its size, and no law overflows on the way."""

SHORTEST = 1e-12
"""Count no length that shapes a law as less than this share of the scale: below it the law is at its limit."""


def cut_to_finite(motion: FloatArray) -> FloatArray:
    """Displacement or velocity, cut at +-`LARGEST` so that its powers stay finite."""
    return np.clip(motion, -LARGEST, LARGEST)


def least_length(scale: float) -> float:
    """The least length that shapes a law, for motion of this scale."""
    return max(SHORTEST * scale, 1.0 / LARGEST)


def positive_part(x: FloatArray, width: float | FloatArray) -> tuple[FloatArray, FloatArray]:
    """max(x, 0), a parabola within +-width of 0 with value and slope continuous, and its slope.

    Within the width the value is (x + width)^2 / (4 width), at most width / 4 above the sharp law.

    Args:
        x: (n,).
        width: Half the width of the parabola, in the unit of x, one for all or (n,); 0: the sharp law, with slope 1/2
            at 0.

    Returns:
        Value and slope, (n,) each.

    Example:
        >>> positive_part(np.array([-1.0, 0.0, 2.0]), 0.0)
        (array([0., 0., 2.]), array([0. , 0.5, 1. ]))
        >>> positive_part(np.array([-1.0, 0.0, 2.0]), 0.1)[0]
        array([0.   , 0.025, 2.   ])
    """
    if not np.any(np.asarray(width) > 0.0):
        return np.maximum(x, 0.0), np.heaviside(x, 0.5)
    share = np.clip(x, -width, width) / width
    slope = 0.5 * (1.0 + share)
    return np.where(x > width, x, 0.25 * width * (1.0 + share) ** 2), slope


def levels(motion: FloatArray, shares: Sequence[float]) -> tuple[float, ...]:
    """The lengths below which each share of the samples of |motion| stays, without doubles and zeros.

    Args:
        motion: (n,) displacement, velocity or input over the records to fit.
        shares: Shares between 0 and 1, rising.

    Returns:
        Positive lengths, rising; (1.0,) for a motion that is zero throughout.

    Example:
        >>> levels(np.linspace(-2.0, 2.0, 101), (0.25, 0.5))
        (0.52, 1.0)
        >>> levels(np.zeros(5), (0.25, 0.5))
        (1.0,)
    """
    found = np.unique(np.quantile(np.abs(motion), shares)) if motion.size else np.empty(0)
    return tuple(float(length) for length in found[found > 0.0]) or (1.0,)


WALL = 1e4
"""Call a limit stiffer than this z a wall: the level over it is then less than a ten thousandth of what it would
have risen by in a step; at a hundred times that Newton's steps are lost in rounding."""


def share_of_end(z: float | FloatArray) -> tuple[FloatArray, FloatArray]:
    """The share theta(z) of the end of a step, and its slope.

    Args:
        z: Stiffness of a step, not negative.

    Returns:
        theta in [1/2, 1], and its derivative by z.

    Example:
        >>> share_of_end(0.0)[0].round(6), share_of_end(1e9)[0].round(6)
        (np.float64(0.5), np.float64(1.0))
    """
    rest = 1.0 / (2.0 + 0.5 * np.square(z))
    return np.asarray(1.0 - rest)[()], np.asarray(z * rest**2)[()]
