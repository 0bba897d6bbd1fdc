"""Each force of a model along a trajectory: its value, its line over the steps, its memory, and where it enters."""

from dataclasses import dataclass

import numpy as np

from modal.discrepancy.assembly import Assembly, Unknowns
from modal.discrepancy.drive import Drive, IndexArray
from modal.discrepancy.driven import per_time
from modal.discrepancy.effects.effect import Force, Memory
from modal.discrepancy.force_line import ForceLine, add_rows, force_line
from modal.discrepancy.plant import Port
from modal.discrepancy.port_motion import motion_at, one_on, step_compliance
from modal.discrepancy.scheme import Scheme
from okid.arrays import FloatArray

__all__ = ["ActingForce", "acting_forces"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ActingForce:
    """A force along a trajectory.

    Attributes:
        port: Its place.
        span: Where its own states stand among all states.
        force: The force at every time.
        line: The line that stands for it over every step.
        memory: Its own states one time on; None where it has none.
        E0: (n_states,) where the start of the line enters, the direction included.
        E1: (n_states,) where its end enters.
        G: (n_outputs,) what it does to the outputs directly.
    """

    port: Port
    span: slice
    force: Force
    line: ForceLine
    memory: Memory | None
    E0: FloatArray
    E1: FloatArray
    G: FloatArray

    def rows(self, times: IndexArray, n_all: int) -> FloatArray:
        """Dependence (n_rows, n_all) of the force at these times on the states."""
        found = np.zeros((len(times), n_all))
        n = len(self.E0)
        add_rows(found[:, :n], self.port, self.force.by_displacement[times], self.force.by_velocity[times])
        found[:, self.span] = self.force.by_memory[times]
        return found

    def add_memory(self, before: FloatArray, following: FloatArray) -> None:
        """Enter the own states one time on, and how they depend on the state at the start of the step."""
        if self.memory is None:
            return
        n = len(self.E0)
        following[:, self.span] = self.memory.value
        before[:, self.span, self.span] = self.memory.by_memory
        for own, state in enumerate(range(self.span.start, self.span.stop)):
            by_displacement = self.memory.by_displacement_before[:, own]
            add_rows(before[:, state, :n], self.port, by_displacement, self.memory.by_velocity_before[:, own])

    def add_memory_end(self, rows: FloatArray, n: int) -> None:
        """Enter how the own states depend on the motion at the end of the step, in rows (n_times, n_memory, n)."""
        if self.memory is None:
            return
        for own, state in enumerate(range(self.span.start, self.span.stop)):
            by_displacement = self.memory.by_displacement_after[:, own]
            add_rows(rows[:, state - n], self.port, by_displacement, self.memory.by_velocity_after[:, own])


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
            step_compliance=step_compliance(assembly.plant, port, direction, drive.dt),
        )
        after = one_on(motion)
        force = effect.force(values, motion)
        found.append(
            ActingForce(
                port=port,
                span=span,
                force=force,
                line=force_line(
                    effect, values, port, motion, after, force=force, dt=drive.dt, n_states=n, n_all=n_all, memory=span
                ),
                memory=effect.advance(values, motion, after, drive.dt) if effect.n_memory else None,
                E0=scheme.E0[:, columns] @ direction,
                E1=scheme.E1[:, columns] @ direction,
                G=scheme.G[:, columns] @ direction,
            )
        )
    return tuple(found)
