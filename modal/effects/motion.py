"""What a force law reads and what it gives back: the motion at a port, the force, its line over a step, its states."""

from dataclasses import dataclass
from typing import Literal

from okid.arrays import FloatArray

__all__ = ["Force", "Memory", "Motion", "StepForce", "StepLift"]


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
class StepLift:
    """What a sensor at the start of each step hears of a force besides the law's own value there.

    Attributes:
        value: (n,).
        by_before: (n,) derivative by the motion at the start of the step.
        by_after: (n,) derivative by the motion at its end.
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
        start: (n,) value at the start of the step.
        end: (n,) value at its end.
        start_by_before: (n,) derivative of `start` by the motion at the start of the step.
        start_by_after: (n,) derivative of `start` by the motion at its end.
        end_by_before: (n,) derivative of `end` by the motion at the start.
        end_by_after: (n,) derivative of `end` by the motion at the end.
        start_by_parameter: (n, n_parameters).
        end_by_parameter: (n, n_parameters).
        lift: What a sensor hears of the force besides the law's own value; None for nothing.
        reads: The motion that the law reads, and the derivatives are by.
    """

    start: FloatArray
    end: FloatArray
    start_by_before: FloatArray
    start_by_after: FloatArray
    end_by_before: FloatArray
    end_by_after: FloatArray
    start_by_parameter: FloatArray
    end_by_parameter: FloatArray
    lift: StepLift | None = None
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
