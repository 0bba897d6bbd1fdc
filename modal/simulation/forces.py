"""Each force of a model along a trajectory: its value, its line over the steps, its memory, and where it enters."""

from dataclasses import dataclass

import numpy as np

from modal.effects.effect import Force, Memory, jumps
from modal.simulation.assembly import Assembly, Unknowns
from modal.simulation.drive import Drive, IndexArray
from modal.simulation.driven import per_time
from modal.simulation.force_line import ForceLine, force_line, port_rows
from modal.simulation.port_motion import motion_at, one_on, step_compliance, step_mobility
from modal.simulation.scheme import Scheme
from okid.arrays import FloatArray

__all__ = ["ActingForce", "Heard", "acting_forces"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Heard:
    """A force as the outputs hear it directly: its law, and while it sticks the mean over the steps on both sides.

    Attributes:
        value: (n_times,).
        slope: (n_times, n_parameters) derivative by each parameter.
        by_now: (n_coordinates, n_times) dependence on the coordinates of the port.
        by_next: (n_coordinates, n_times) dependence on those one time on; None where there is none.
    """

    value: FloatArray
    slope: FloatArray
    by_now: FloatArray
    by_next: FloatArray | None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ActingForce:
    """A force along a trajectory. What a step takes from it are lines: its start, its end, then each own state one on.

    Attributes:
        rows: (n_coordinates, n) the coordinates of its port over all states: displacement, velocity, own states.
        span: Where its own states stand among all states.
        force: The force at every time.
        line: The line that stands for it over every step.
        memory: Its own states one time on; None where it has none.
        E0: (n_states,) where the start of the line enters, the direction included.
        E1: (n_states,) where its end enters.
        G: (n_outputs,) what it does to the outputs directly.
    """

    rows: FloatArray
    span: slice
    force: Force
    line: ForceLine
    memory: Memory | None
    E0: FloatArray
    E1: FloatArray
    G: FloatArray

    @property
    def columns(self) -> FloatArray:
        """(n, n_lines) where the lines enter a step."""
        n_memory = self.span.stop - self.span.start
        found = np.zeros((self.rows.shape[1], 2 + n_memory))
        found[: len(self.E0), 0], found[: len(self.E0), 1] = self.E0, self.E1
        found[self.span, 2:] = np.eye(n_memory)
        return found

    @property
    def by_before(self) -> FloatArray:
        """(n_coordinates, n_lines, n_times) dependence of the lines on the coordinates at the start of the step."""
        if self.memory is None:
            return self.line.by_before
        of = self.memory
        own = np.stack([of.by_displacement_before.T, of.by_velocity_before.T, *of.by_memory.transpose(2, 1, 0)])
        return np.concatenate([self.line.by_before, own], axis=1)

    @property
    def by_after(self) -> FloatArray:
        """(n_coordinates, n_lines, n_times) dependence on the coordinates at the end of the step."""
        if self.memory is None:
            return self.line.by_after
        of = self.memory
        own = np.zeros((len(self.rows), of.value.shape[1], len(of.value)))
        own[0], own[1] = of.by_displacement_after.T, of.by_velocity_after.T
        return np.concatenate([self.line.by_after, own], axis=1)

    def law_alone(self) -> Heard:
        """The law at every time, as an observer hears it."""
        by_now = np.stack([self.force.by_displacement, self.force.by_velocity, *self.force.by_memory.T])
        return Heard(value=self.force.value, slope=self.force.by_parameter, by_now=by_now, by_next=None)

    def heard(self, lasts: IndexArray) -> Heard:
        """The force as the outputs hear it; nothing is known of the steps that would leave the last times."""
        law, lift = self.law_alone(), self.line.lift
        if lift is None or not self.G.any():
            return law
        known = np.ones(len(law.value))
        known[lasts] = 0.0
        return Heard(
            value=law.value + known * lift.value,
            slope=law.slope + known[:, None] * lift.slope,
            by_now=law.by_now + known * lift.by_before,
            by_next=known * lift.by_after,
        )


def acting_forces(
    assembly: Assembly, unknowns: Unknowns, drive: Drive, scheme: Scheme, states: FloatArray, *, smoothing: float
) -> tuple[ActingForce, ...]:
    """All forces of a model along a trajectory.

    Args:
        assembly: The plant and its effects.
        unknowns: Values of all unknowns.
        drive: Inputs after the effects at the inputs.
        scheme: Matrices of one step.
        states: The trajectory (n_times, n_states + n_memory).
        smoothing: Width of sharp laws, as a share of the motion's scale.

    Returns:
        One entry a force, in the order of `assembly.forces`.
    """
    n, n_all = assembly.plant.n_states, states.shape[1]
    found: list[ActingForce] = []
    first = n
    for i in assembly.forces:
        item = assembly.placements[i]
        effect, port = item.force_and_port
        span = slice(first, first + effect.n_memory)
        first = span.stop
        values = [per_time(value, drive) for value in unknowns.values(assembly, i)]
        at = assembly.stiffness_parameter(i)
        columns, direction = list(port.columns), unknowns.directions(assembly, i)
        motion = motion_at(
            item,
            states[:, :n],
            drive,
            states[:, span],
            smoothing * drive.level,
            stiffness=None if at is None else float(unknowns.common[at]),
            mobility=step_mobility(assembly.plant, port, drive.dt) if jumps(effect) else 0.0,
            step_compliance=step_compliance(assembly.plant, port, direction, drive.dt),
        )
        after = one_on(motion)
        force = effect.force(values, motion)
        found.append(
            ActingForce(
                rows=port_rows(port, n, n_all, span),
                span=span,
                force=force,
                line=force_line(effect, values, port, motion, after, force=force, dt=drive.dt),
                memory=effect.advance(values, motion, after, drive.dt) if effect.n_memory else None,
                E0=scheme.E0[:, columns] @ direction,
                E1=scheme.E1[:, columns] @ direction,
                G=scheme.G[:, columns] @ direction,
            )
        )
    return tuple(found)
