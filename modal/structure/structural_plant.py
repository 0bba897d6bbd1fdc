"""A structural model as a plant with ports.

    M x'' + C x' + K x + L w = F u - M iota a

States are the displacements x and the velocities v. A force w at a port with relative displacement d = b' x stands on
the left-hand side as b w, so E holds -M^-1 b. Where a DOF has no stiffness and no displacement sensor reads it, its
displacement is no state: nothing depends on it, and an integrator would drift for nothing.
"""

import numpy as np

from modal.simulation.plant import Plant, Port
from modal.structure.elements import relative_vector
from modal.structure.structural_model import StructuralModel
from modal.structure.structural_parameters import changes_of
from okid.arrays import FloatArray

__all__ = ["place_name", "structural_plant"]


def structural_plant(model: StructuralModel) -> Plant:
    """The plant of a structural model, without its effects.

    Ports are its elements and its DOFs ("dof_0", ...; where an element joins the DOF and the ground, the two are one
    place, which keeps the element's name).

    Args:
        model: What to convert.

    Example:
        >>> model = StructuralModel.chain([2.0], [800.0], [1.0], force_dofs=0, sensor_dofs=0)
        >>> plant = structural_plant(model)
        >>> plant.system[0].round(3), [parameter.name for parameter in plant.parameters]
        (array([[ 0. ,  1. ,  0. ,  0. ],
               [ 0. ,  0. ,  0.5, -0.5],
               [ 1. ,  0. ,  0. ,  0. ]]), ['stiffness of element_0', 'damping of element_0'])
    """
    kept = _kept_displacements(model)
    places = _places(model)
    joins = np.array([relative_vector(ends, model.n_dofs) for _, ends in places]).T
    changes = changes_of(model)
    stiffness, damping = model.stiffness.copy(), model.damping.copy()
    for change in changes:
        if change.stiffness is not None:
            stiffness -= change.parameter.nominal * change.stiffness
        if change.damping is not None:
            damping -= change.parameter.nominal * change.damping
    constant = _assemble(model, kept, damping=damping, stiffness=stiffness, joins=joins)
    zero = np.zeros_like(model.mass)
    slopes = [
        _restoring(
            model,
            kept,
            damping=zero if change.damping is None else change.damping,
            stiffness=zero if change.stiffness is None else change.stiffness,
            shape=constant.shape,
        )
        for change in changes
    ]
    return Plant(
        system=np.stack([constant, *slopes]),
        n_states=len(kept) + model.n_dofs,
        n_inputs=model.n_inputs,
        parameters=tuple(change.parameter for change in changes),
        ports=tuple(_port(model, kept, index, name, ends) for index, (name, ends) in enumerate(places)),
        input_names=model.input_names,
        output_names=model.output_names,
        input_units=model.input_units,
        output_units=model.output_units,
    )


# --- matrices --------------------------------------------------------------------------------------------------------


def _kept_displacements(model: StructuralModel) -> tuple[int, ...]:
    """DOFs whose displacement is a state."""
    read = np.zeros(model.n_dofs, dtype=np.bool_)
    for row, kind in zip(model.sensor_map, model.sensor_kind, strict=True):
        if kind == "displacement":
            read |= row != 0
    return tuple(int(i) for i in np.flatnonzero(read | model.stiffness.any(axis=1)))


def _assemble(
    model: StructuralModel, kept: tuple[int, ...], *, damping: FloatArray, stiffness: FloatArray, joins: FloatArray
) -> FloatArray:
    """[[A, B, E], [C, D, G]] for the given C and K."""
    n_kept, n_dofs, n_inputs = len(kept), model.n_dofs, model.n_inputs
    n_states = n_kept + n_dofs
    system = np.zeros((n_states + model.n_outputs, n_states + n_inputs + joins.shape[1]))
    system[np.arange(n_kept), n_kept + np.array(kept, dtype=int)] = 1.0
    driven = np.linalg.solve(model.mass, np.hstack([model.force_map, -joins]))  # absolute acceleration by u and w
    system[n_kept:n_states, n_states:] = driven
    if model.base_motion is not None:
        system[n_kept:n_states, n_states : n_states + n_inputs] -= model.base_motion
    for output, (row, kind) in enumerate(zip(model.sensor_map, model.sensor_kind, strict=True)):
        if kind == "displacement":
            system[n_states + output, :n_kept] = row[list(kept)]
        elif kind == "velocity":
            system[n_states + output, n_kept:n_states] = row
        else:
            system[n_states + output, n_states:] = row @ driven
    return system + _restoring(model, kept, damping=damping, stiffness=stiffness, shape=system.shape)


def _restoring(
    model: StructuralModel,
    kept: tuple[int, ...],
    *,
    damping: FloatArray,
    stiffness: FloatArray,
    shape: tuple[int, ...],
) -> FloatArray:
    """What C and K put into [[A, B, E], [C, D, G]]; linear in them."""
    n_kept, n_states = len(kept), len(kept) + model.n_dofs
    system = np.zeros(shape)
    acceleration = -np.linalg.solve(model.mass, np.hstack([stiffness[:, list(kept)], damping]))
    system[n_kept:n_states, :n_states] = acceleration
    for output, (row, kind) in enumerate(zip(model.sensor_map, model.sensor_kind, strict=True)):
        if kind == "acceleration":
            system[n_states + output, :n_states] = row @ acceleration
    return system


# --- ports -----------------------------------------------------------------------------------------------------------


def place_name(model: StructuralModel, where: str) -> str:
    """The name of a place as the plant has it: that of the element where "dof_i" is the moving end of a grounded one.

    Example:
        >>> model = StructuralModel.chain([2.0], [800.0], [1.0], force_dofs=0, sensor_dofs=0)
        >>> place_name(model, "dof_0")
        'element_0'
    """
    return {f"dof_{one.start}": one.name for one in model.elements if one.end is None}.get(where, where)


def _places(model: StructuralModel) -> list[tuple[str, tuple[int, ...]]]:
    """Name and ends of each port: the elements, then the DOFs that no element joins to the ground."""
    grounded = {element.start for element in model.elements if element.end is None}
    elements = [(element.name, element.ends) for element in model.elements]
    return elements + [(f"dof_{i}", (i,)) for i in range(model.n_dofs) if i not in grounded]


def _port(model: StructuralModel, kept: tuple[int, ...], index: int, name: str, ends: tuple[int, ...]) -> Port:
    n_states = len(kept) + model.n_dofs
    join = relative_vector(ends, model.n_dofs)
    displacement, velocity = np.zeros(n_states + model.n_inputs), np.zeros(n_states + model.n_inputs)
    displacement[: len(kept)] = join[list(kept)]
    velocity[len(kept) : n_states] = join
    stiffness = next((element.stiffness for element in model.elements if element.ends == ends), 0.0)
    return Port(
        name=name,
        displacement=displacement if set(ends) <= set(kept) else None,
        velocity=velocity,
        columns=(index,),
        stiffness=stiffness if stiffness > 0 else None,
        mass=float(model.mass[ends[-1], ends[-1]]),
        length_unit=model.length_unit,
        force_unit=model.force_unit,
        accepts=_accepted(ends, is_element=index < len(model.elements)),
    )


def _accepted(ends: tuple[int, ...], *, is_element: bool) -> frozenset[str]:
    """What can act at a place: laws of the motion where an element is, absorbers on one DOF, forces anywhere.

    Friction or contact against the ground needs an element there, which may have no stiffness. An absorber hangs on one
    DOF; between two of them its force would have nothing to stand on.
    """
    accepted = {"force"}
    if is_element:
        accepted.add("motion")
    if len(ends) == 1:
        accepted.add("mass")
    return frozenset(accepted)
