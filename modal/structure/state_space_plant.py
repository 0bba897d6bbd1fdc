"""A general linear state space as a plant with ports.

A structure measured by displacement sensors has displacements d = C x; velocity sensors read the derivative of
C A^-1 x, accelerometers the second derivative of C A^-2 x. A force cannot move a displacement at once, so its direction
e in the state space is one with (displacement rows) e = 0: the null space of these rows. Half of the states of a
structure at most are displacements; the other half is what a force can drive.

Places are the outputs, and the differences of two of them (`state_space_ports`). Where the matrices show that the plant
is a structure with symmetric M, C, K (`reciprocity`) and all its modes are measured, a force at a place is known to act
along the sensor; else its direction is open, and a port has several columns. Forces are counted per effective mass at
the place, in length unit / s^2.

Where a displacement does not exist:
    - a plant whose displacement answers to an input at once (a level in a tank, a temperature: C B is not small) is of
      first order: its port takes flows in any direction of the states; its displacement row is the output itself.
      Where no pole oscillates a displacement may also be the level of one of several tanks: further ports, "output_0
      level" and "output_0 upstream", take flows (`modal.structure.tank_levels`); where its unit is no length either,
      the first port takes constant and periodic forces only.
    - velocity sensors of a shaft that nothing holds, or of a mass that only a damper holds: a constant force gives a
      constant velocity, not none. The port has a velocity only, and forces act in any direction of the states.
    - an integrator needs its displacement measured: an acceleration does not show it.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from modal.simulation.plant import Plant
from modal.structure.checks import matched_names, sensor_kinds, tolerance
from modal.structure.continuous_time import ContinuousSystem, continuous_system
from modal.structure.internal_changes import internal_changes
from modal.structure.modal_form import in_modal_coordinates
from modal.structure.motion_rows import OutputMotion, motion_of_outputs
from modal.structure.reciprocity import Structure, reciprocal_structure
from modal.structure.state_space_ports import ports_of
from modal.structure.static_plant import static_plant
from modal.structure.structural_model import SensorKind
from modal.structure.symmetric_changes import symmetric_changes
from okid.arrays import FloatArray
from okid.errors import InvalidDataError
from okid.record import InputHold, Record
from okid.record_checks import labels

__all__ = ["state_space_plant"]

_RANK = 1e-6
"""Singular values of the displacement rows below this share of the largest are rounding."""


def state_space_plant(
    system: Any,
    *,
    sensor_kind: SensorKind | Sequence[SensorKind],
    input_hold: InputHold = "zero_order",
    dt: float | None = None,
    records: Sequence[Record] = (),
    input_names: Sequence[str] = (),
    output_names: Sequence[str] = (),
    input_units: Sequence[str] = (),
    output_units: Sequence[str] = (),
    frequency_tolerance: float = 0.1,
    damping_tolerance: float = 0.5,
) -> Plant:
    """The plant of a state space, in real modal form.

    Uncertain are stiffness and damping of a structure, which stay symmetric (`symmetric_changes`); where no symmetry
    shows, all linear forces inside it (`internal_changes`), because a wrong stiffness changes shapes and static
    response as well as poles; of a plant that is no structure the real and imaginary part of each pole.

    Args:
        system: `control.StateSpace`, `era.Realisation`, or anything with A, B, C, D and dt; minimal and stable. Without
            states it is a plant of imposed motion and measured force, see `static_plant`.
        sensor_kind: "displacement", "velocity" or "acceleration", one word or one an output.
        input_hold: Of the records, to convert a discrete system by.
        dt: Time step of the records [s], to check the system's against.
        records: Only for a plant without states: what tells which input is the derivative of which.
        input_names: "input_0", ... unless given.
        output_names: "output_0", ... unless given.
        input_units: "" unless given.
        output_units: "" unless given.
        frequency_tolerance: Standard deviation of the prior on the imaginary part of a pole, as a share of |pole|.
        damping_tolerance: Relative standard deviation of the prior on the real part of a pole.

    Raises:
        InvalidDataError: No state space, an unstable one, one that no continuous-time system samples to, or an
            accelerometer on an integrator.
        NumericalError: The conversion to continuous time is not exact.

    Example:
        >>> import control
        >>> mass_on_spring = control.ss([[0.0, 1.0], [-100.0, -0.4]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])
        >>> plant = state_space_plant(mass_on_spring, sensor_kind="displacement")
        >>> [port.name for port in plant.ports], [parameter.name for parameter in plant.parameters]
        (['output_0'], ['stiffness of mode 1 (1.592 Hz)', 'damping of mode 1 (1.592 Hz)'])
    """
    continuous = continuous_system(system, input_hold=input_hold, dt=dt)
    n_outputs, n_inputs = continuous.D.shape
    names = matched_names(input_names, output_names, n_inputs=n_inputs, n_outputs=n_outputs)
    units = (
        labels(input_units, n_inputs, "input", named=False),
        labels(output_units, n_outputs, "output", named=False),
    )
    if len(continuous.A) == 0:
        return static_plant(continuous.D, records=records, names=names, units=units)
    _check_stable(continuous.A)
    form = in_modal_coordinates(
        continuous,
        frequency_tolerance=tolerance(frequency_tolerance, name="frequency_tolerance"),
        damping_tolerance=tolerance(damping_tolerance, name="damping_tolerance"),
    )
    kinds = sensor_kinds(sensor_kind, n_outputs)
    modal = form.system
    motions = motion_of_outputs(modal, kinds, units[1])
    free = _free_directions(motions, len(modal.A))
    structure = _structure(modal, motions, free)
    ports, forces, direct = ports_of(
        modal,
        motions,
        names[1],
        forces=free if structure is None else structure.forces,
        directions="any" if structure is None or free.shape[1] > structure.n_modes else "along_sensors",
    )
    constant = np.block([[modal.A, modal.B, forces], [modal.C, modal.D, direct]])
    n_states = len(modal.A)
    if structure is None:
        changes = internal_changes(modal.A, free, motions, tolerance=frequency_tolerance)
    else:
        changes = symmetric_changes(
            modal.A, structure, motions, frequency_tolerance=frequency_tolerance, damping_tolerance=damping_tolerance
        )
    parameters = form.parameters if changes is None else changes.parameters
    slopes = np.zeros((len(parameters), *constant.shape))
    if changes is None:
        slopes[:, :n_states, :n_states] = form.slopes
    else:
        slopes[:, :, :n_states] = changes.slopes
    constant -= np.tensordot(np.array([parameter.nominal for parameter in parameters]), slopes, axes=(0, 0))
    return Plant(
        system=np.concatenate([constant[None], slopes]),
        n_states=n_states,
        n_inputs=n_inputs,
        parameters=parameters,
        ports=ports,
        input_names=names[0],
        output_names=names[1],
        input_units=units[0],
        output_units=units[1],
    )


def _check_stable(A: FloatArray) -> None:
    poles = np.linalg.eigvals(A)
    worst = poles[poles.real.argmax()]
    # a double pole at zero comes out at the root of the rounding
    if worst.real > 1e-7 * np.abs(poles).max():
        raise InvalidDataError(
            f"a model must be stable, but this one has a pole at {worst.real:.4g} {worst.imag:+.4g}i 1/s; leave that "
            "mode out, or close the loop that holds it."
        )


def _structure(system: ContinuousSystem, motions: tuple[OutputMotion, ...], free: FloatArray) -> Structure | None:
    """The structure behind the state space, where all outputs show its motion; what never oscillates may be tanks."""
    rows = [one.displacement[: len(system.A)] for one in motions if one.displacement is not None]
    if len(rows) < len(motions) or any(one.nature != "mechanical" for one in motions):
        return None
    if not np.iscomplex(np.linalg.eigvals(system.A)).any():
        return None
    return reciprocal_structure(system, np.array(rows), free)


def _free_directions(motions: tuple[OutputMotion, ...], n_states: int) -> FloatArray:
    """(n_states, n_free) orthonormal directions that leave every measured displacement where it is."""
    rows = [
        one.displacement[:n_states] for one in motions if one.nature == "mechanical" and one.displacement is not None
    ]
    if not rows:
        return np.eye(n_states)
    scaled = np.array([row / np.linalg.norm(row) for row in rows if row.any()]).reshape(-1, n_states)
    _, sizes, right = np.linalg.svd(scaled)
    rank = min(int((sizes > _RANK * sizes.max(initial=0.0)).sum()), n_states // 2)
    return np.ascontiguousarray(right[rank:].T)
