"""A structural model as a plant with ports, its linear parameters, and its elements.

    M x'' + C x' + K x + L w = F u - M iota a

States are the displacements x and the velocities v. A force w at a port with relative displacement d = b' x stands on
the left-hand side as b w, so E holds -M^-1 b. Where a DOF has no stiffness and no displacement sensor reads it, its
displacement is no state: nothing depends on it, and an integrator would drift for nothing.

Uncertain are the stiffness and the damping of the elements; where the elements do not make up K (or C), those of the
modes: K = M Phi diag(k) Phi' M with Phi' M Phi = I, of which each k may be wrong, the shapes may not. Masses are taken
as right until the records tell otherwise (`Plant.masses`): a common factor on M, C, K is an input gain, and with one
DOF one on M alone is one on C and K.

Elements are the springs and dampers between the degrees of freedom, and between them and ground. A spring network is a
stiffness matrix that is a sum over elements, K = sum k_e b_e b_e', where b_e picks the relative displacement of element
e. Off the diagonal K_ij = -k_ij, and what a row leaves over is its spring to ground. The same holds of C. A
finite-element matrix with rotations, or a damping matrix put together from modal damping, is no such sum.
"""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy

from modal.simulation import UNDAMPED_DEVIATION
from modal.simulation.plant import MASS, LinearParameter, Mass, Plant, Port
from okid.arrays import ROUNDED, FloatArray, real_number
from okid.display import Displayed
from okid.errors import InvalidDataError

MOST_ELEMENTS = 64
"""Derive no more elements than so many from matrices: each is a place that every effect is tried at."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Element(Displayed):
    """A spring with a damper, between two degrees of freedom or between one and the ground.

    Its relative displacement is x[end] - x[start]; x[start] where it stands on the ground.

    Attributes:
        name: Name of the place.
        start: Degree of freedom at one end.
        end: Degree of freedom at the other end; None: the ground.
        stiffness: Of the spring, in force unit / length unit; 0 where there is none or it is not known.
        damping: Of the damper, in force unit s / length unit; 0 where there is none or it is not known.

    Example:
        >>> Element(name="joint", start=0, end=1, stiffness=2e4, damping=3.0).ends
        (0, 1)
    """

    name: str
    start: int
    end: int | None = None
    stiffness: float = 0.0
    damping: float = 0.0

    @property
    def ends(self) -> tuple[int, ...]:
        """The degrees of freedom that the element touches."""
        return (self.start,) if self.end is None else (self.start, self.end)


def is_numbered(element: Element) -> bool:
    """Whether nobody gave the element a name: it is called by its place in the matrices."""
    return element.name == _chain_name(element.ends)


def relative_vector(ends: Sequence[int], n_dofs: int) -> FloatArray:
    """(n_dofs,) the vector b with b' x the relative displacement over `ends` (one end: against the ground).

    Example:
        >>> relative_vector((0, 2), 3).tolist(), relative_vector((1,), 3).tolist()
        ([-1.0, 0.0, 1.0], [0.0, 1.0, 0.0])
    """
    vector = np.zeros(n_dofs)
    vector[ends[-1]] = 1.0
    if len(ends) == 2:
        vector[ends[0]] = -1.0
    return vector


def chain_elements(stiffnesses: FloatArray, dampings: FloatArray) -> tuple[Element, ...]:
    """The elements of a chain: element 0 joins DOF 0 and the ground, element e DOF e - 1 and DOF e."""
    return tuple(
        Element(
            name=f"element_{e}", start=max(e - 1, 0), end=e or None, stiffness=float(stiffness), damping=float(damping)
        )
        for e, (stiffness, damping) in enumerate(zip(stiffnesses, dampings, strict=True))
    )


def coupled_elements(stiffness: FloatArray, damping: FloatArray) -> tuple[Element, ...]:
    """The elements that stand in K and C.

    Every pair of DOFs that K couples is one, every DOF that K ties to the ground (what its row leaves over), and
    likewise for C where C is a network of dampers. Named as in a chain: "element_0" joins DOF 0 and the ground,
    "element_e" DOF e - 1 and DOF e; others are "element_i-j" and "ground_i". Where K is no network of springs, only
    the pairs are elements, of unknown stiffness.

    Raises:
        InvalidDataError: More than 64 of them.
    """
    springs, dampers = is_network(stiffness), is_network(damping)
    n_dofs = len(stiffness)
    found = []
    for ends in [*((i,) for i in range(n_dofs)), *((i, j) for j in range(n_dofs) for i in range(j))]:
        k = _coupling(stiffness, ends) if springs or len(ends) == 2 else 0.0
        c = _coupling(damping, ends) if dampers else 0.0
        if k != 0.0 or c != 0.0:
            found.append(
                Element(
                    name=_chain_name(ends),
                    start=ends[0],
                    end=ends[1] if len(ends) == 2 else None,
                    stiffness=k if springs else 0.0,
                    damping=c,
                )
            )
    if len(found) > MOST_ELEMENTS:
        raise InvalidDataError(
            f"the stiffness and damping matrices couple {len(found)} pairs of degrees of freedom, and at most "
            f"{MOST_ELEMENTS} can be searched; name those of interest, for example elements=[(0, None), (0, 1)], or "
            "pass elements=() for the degrees of freedom alone."
        )
    return tuple(sorted(found, key=lambda element: (element.ends[-1], -element.start)))


def is_network(matrix: FloatArray) -> bool:
    """Whether a stiffness or damping matrix is that of springs or dampers of positive size between DOFs and ground.

    Example:
        >>> is_network(np.array([[3.0, -1.0], [-1.0, 1.0]])), is_network(np.array([[12.0, 6.0], [6.0, 4.0]]))
        (True, False)
    """
    tolerance = ROUNDED * np.abs(matrix).max(initial=0.0)
    off_diagonal = matrix - np.diag(np.diag(matrix))
    return bool((off_diagonal <= tolerance).all() and (matrix.sum(axis=1) >= -len(matrix) * tolerance).all())


def named_elements(
    given: Iterable[Element | tuple[int | None, int | None]], stiffness: FloatArray, damping: FloatArray
) -> tuple[Element, ...]:
    """The elements as given, pairs (start, end) completed by a name and by what K and C couple there.

    Raises:
        InvalidDataError: An element that is no pair of DOFs, touches a DOF that is not there, or has a negative
            stiffness or damping; two of one name or of the same ends.
    """
    elements = tuple(_completed(one, stiffness, damping) for one in given)
    _check_unique("name", [element.name for element in elements])
    _check_unique("ends", [str(sorted(element.ends)) for element in elements])
    return elements


def _check_unique(what: str, keys: list[str]) -> None:
    double = sorted({key for key in keys if keys.count(key) > 1})
    if double:
        raise InvalidDataError(
            f"no two elements may have the same {what}, but {', '.join(double)} stand more than once; merge them."
        )


def _completed(one: Any, stiffness: FloatArray, damping: FloatArray) -> Element:
    n_dofs = len(stiffness)
    if isinstance(one, Element):
        ends = one.ends
    else:
        if isinstance(one, str) or not isinstance(one, Sequence) or len(one) != 2:
            raise InvalidDataError(
                f"an element must be modal.Element or a pair (start, end) of DOF numbers, end None for the ground, but "
                f"is {one!r}."
            )
        ends = tuple(end for end in one if end is not None)
    there = all(real_number(end).is_integer() and 0 <= end < n_dofs for end in ends)
    if not there or len(set(ends)) != len(ends) or not ends:
        raise InvalidDataError(
            f"an element joins two of the DOFs 0 to {n_dofs - 1}, or one of them and the ground (None), but {one!r} "
            "does not; number the DOFs from 0."
        )
    if isinstance(one, Element):
        if not all(np.isfinite(v := real_number(value)) and v >= 0 for value in (one.stiffness, one.damping)):
            raise InvalidDataError(
                f"the stiffness and damping of {one.name} must be finite and not negative, but are {one.stiffness} and "
                f"{one.damping}; leave them 0 where they are not known."
            )
        return one
    ends = tuple(sorted(int(end) for end in ends))
    return Element(
        name=_chain_name(ends),
        start=ends[0],
        end=ends[1] if len(ends) == 2 else None,
        stiffness=max(_coupling(stiffness, ends), 0.0) if is_network(stiffness) else 0.0,
        damping=max(_coupling(damping, ends), 0.0) if is_network(damping) else 0.0,
    )


def _coupling(matrix: FloatArray, ends: tuple[int, ...]) -> float:
    """What joins the ends in K or C: -K_ij, or what row i leaves over for the ground; 0 where it is rounding."""
    row = ends[0]
    value = -matrix[row, ends[1]] if len(ends) == 2 else matrix[row].sum()
    # a small element beside a large one: what counts as rounding is set by the row, not by the whole matrix
    small = ROUNDED * np.abs(matrix[row]).max(initial=0.0)
    return 0.0 if abs(value) <= small else float(value)


def _chain_name(ends: tuple[int, ...]) -> str:
    if ends == (0,):
        return "element_0"
    if len(ends) == 1:
        return f"ground_{ends[0]}"
    return f"element_{ends[1]}" if ends[1] == ends[0] + 1 else f"element_{ends[0]}-{ends[1]}"


if TYPE_CHECKING:
    from modal.structure.structural_model import StructuralModel

_MOST_MODES = 32
"""Make parameters of the stiffness and damping of so many modes at most, from the lowest."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Change:
    """A linear parameter and the derivative of C or K by it.

    Attributes:
        parameter: The parameter.
        damping: (n_dofs, n_dofs) derivative of C; None where it does not change C.
        stiffness: (n_dofs, n_dofs) derivative of K; None where it does not change K.
    """

    parameter: LinearParameter
    damping: FloatArray | None = None
    stiffness: FloatArray | None = None


def updated_structure(model: "StructuralModel", linear: FloatArray, masses: Sequence[str] = ()) -> "StructuralModel":
    """The model with its stiffnesses, dampings and masses at other values; effects stay.

    Args:
        model: The model as it was given.
        linear: (n_parameters,) values in the order of `structural_plant(model).parameters`, then of the masses.
        masses: Names of the masses that were released, in the order of their values.

    Example:
        >>> from modal.structure.structural_model import StructuralModel
        >>> model = StructuralModel.chain([2.0], [800.0], [1.0], force_dofs=0, sensor_dofs=0)
        >>> updated_structure(model, np.array([810.0, 1.1])).stiffness
        array([[810.]])
    """
    changes = _stiffness_changes(model) + _damping_changes(model)
    stiffness, damping = model.stiffness.copy(), model.damping.copy()
    new = {change.parameter.name: float(value) for change, value in zip(changes, linear, strict=False)}
    for change, value in zip(changes, linear, strict=False):
        if change.stiffness is not None:
            stiffness += (value - change.parameter.nominal) * change.stiffness
        if change.damping is not None:
            damping += (value - change.parameter.nominal) * change.damping
    elements = tuple(
        replace(
            element,
            stiffness=new.get(f"stiffness of {element.name}", element.stiffness),
            damping=new.get(f"damping of {element.name}", element.damping),
        )
        for element in model.elements
    )
    mass = model.mass.copy()
    for name, value in zip(masses, linear[len(changes) :], strict=True):
        dof = _mass_names(model).index(name)
        mass[dof, dof] = value
    return replace(model, mass=mass, stiffness=stiffness, damping=damping, elements=elements)


_MASS_TOLERANCE = 0.1
"""Take masses of a structure to be known as well as its stiffnesses unless the user says how well."""


def _mass_names(model: "StructuralModel") -> list[str]:
    return [f"{MASS}dof_{i}" for i in range(model.n_dofs)]


def _masses(model: "StructuralModel", kept: tuple[int, ...], shape: tuple[int, ...]) -> tuple[Mass, ...]:
    """What may be wrong on the diagonal of the mass matrix, which stays positive definite within the bounds.

    With one DOF a wrong mass is a wrong gain beside a wrong stiffness and damping: only who says how well the mass is
    known lets it go.
    """
    tolerance = model.mass_tolerance
    if tolerance is None:
        tolerance = _MASS_TOLERANCE if model.n_dofs > 1 else 0.0
    if tolerance == 0.0 or model.n_dofs > _MOST_MODES:
        return ()
    sizes = np.diag(model.mass)
    definite = float(np.linalg.eigvalsh(model.mass / np.sqrt(np.outer(sizes, sizes)))[0])
    unit = f"{model.force_unit} s^2/{model.length_unit}"
    found = []
    for i, (name, size) in enumerate(zip(_mass_names(model), sizes, strict=True)):
        inertia, system = np.zeros((shape[0] - model.n_outputs,) * 2), np.zeros(shape)
        row = len(kept) + i
        inertia[row, row] = 1.0
        if model.base_motion is not None:
            system[row, len(inertia) : len(inertia) + model.n_inputs] = -model.base_motion[i]
        plain = _within(name, "kg" if unit == "N s^2/m" else unit, float(size), tolerance)
        parameter = replace(
            plain,
            deviation=definite * plain.deviation,
            lower=size - definite * (size - plain.lower),
            upper=size + definite * (plain.upper - size),
        )
        found.append(Mass(parameter=parameter, system=system, inertia=inertia))
    return tuple(found)


def _stiffness_changes(model: "StructuralModel") -> tuple[Change, ...]:
    by_element = [relative_vector(element.ends, model.n_dofs) for element in model.elements]
    sizes = [element.stiffness for element in model.elements]
    unit = f"{model.force_unit}/{model.length_unit}"
    if _springs_make_up(model):
        return tuple(
            Change(
                parameter=_within(f"stiffness of {element.name}", unit, size, model.stiffness_tolerance),
                stiffness=np.outer(vector, vector),
            )
            for element, vector, size in zip(model.elements, by_element, sizes, strict=True)
            if size > 0
        )
    squares, shapes = scipy.linalg.eigh(model.stiffness, model.mass)
    weighted = model.mass @ shapes
    flexible = [mode for mode in range(model.n_dofs) if squares[mode] > ROUNDED * squares[-1]]
    return tuple(
        Change(
            parameter=_within(
                f"modal stiffness of mode {mode + 1} ({np.sqrt(squares[mode]) / (2 * np.pi):.4g} Hz)",
                "1/s^2",
                float(squares[mode]),
                model.stiffness_tolerance,
            ),
            stiffness=np.outer(weighted[:, mode], weighted[:, mode]),
        )
        for mode in flexible[:_MOST_MODES]
    )


def _damping_changes(model: "StructuralModel") -> tuple[Change, ...]:
    by_element = [relative_vector(element.ends, model.n_dofs) for element in model.elements]
    sizes = [element.damping for element in model.elements]
    unit = f"{model.force_unit} s/{model.length_unit}"
    # without damping both hold: then the elements' dampers are sized by their springs, so these must be known
    if _make_up(model.damping, by_element, sizes) and (model.damping.any() or _springs_make_up(model)):
        changes = []
        for element, vector, size in zip(model.elements, by_element, sizes, strict=True):
            critical = 2 * math.sqrt(element.stiffness / float(vector @ np.linalg.solve(model.mass, vector)))
            parameter = _damping_parameter(f"damping of {element.name}", unit, size, critical, model.damping_tolerance)
            if parameter is not None:
                changes.append(Change(parameter=parameter, damping=np.outer(vector, vector)))
        return tuple(changes)
    squares, shapes = scipy.linalg.eigh(model.stiffness, model.mass)
    weighted = model.mass @ shapes
    changes = []
    for mode in range(min(model.n_dofs, _MOST_MODES)):
        natural = math.sqrt(squares[mode]) if squares[mode] > ROUNDED * squares[-1] else 0.0
        size = float(shapes[:, mode] @ model.damping @ shapes[:, mode])
        name = f"modal damping of mode {mode + 1} ({natural / (2 * np.pi):.4g} Hz)"
        parameter = _damping_parameter(name, "1/s", size, 2 * natural, model.damping_tolerance)
        if parameter is not None:
            changes.append(Change(parameter=parameter, damping=np.outer(weighted[:, mode], weighted[:, mode])))
    return tuple(changes)


def _springs_make_up(model: "StructuralModel") -> bool:
    vectors = [relative_vector(element.ends, model.n_dofs) for element in model.elements]
    return _make_up(model.stiffness, vectors, [element.stiffness for element in model.elements])


def _make_up(matrix: FloatArray, vectors: list[FloatArray], sizes: list[float]) -> bool:
    """Whether the matrix is the sum over elements."""
    total = sum((size * np.outer(b, b) for size, b in zip(sizes, vectors, strict=True)), np.zeros_like(matrix))
    return bool(np.abs(total - matrix).max() <= 1e-7 * np.abs(matrix).max())


def _within(name: str, unit: str, nominal: float, tolerance: float) -> LinearParameter:
    """A parameter that stays within a factor 1 + 3 tolerance of its nominal value."""
    factor = 1 + 3 * tolerance
    return LinearParameter(
        name=name,
        unit=unit,
        nominal=nominal,
        deviation=tolerance * nominal,
        lower=nominal / factor,
        upper=nominal * factor,
    )


def _damping_parameter(
    name: str, unit: str, nominal: float, critical: float, tolerance: float
) -> LinearParameter | None:
    """A damping, with room to grow from zero; None where there is neither damping nor stiffness to size it by."""
    if nominal > ROUNDED * critical:
        return _within(name, unit, nominal, tolerance)
    if critical == 0:
        return None
    deviation = UNDAMPED_DEVIATION * critical
    return LinearParameter(
        name=name, unit=unit, nominal=nominal, deviation=deviation, lower=0.0, upper=nominal + 3 * deviation
    )


def structural_plant(model: "StructuralModel") -> Plant:
    """The plant of a structural model, without its effects.

    Ports are its elements and its DOFs ("dof_0", ...; where an element joins the DOF and the ground, the two are one
    place, which keeps the element's name).

    Example:
        >>> from modal.structure.structural_model import StructuralModel
        >>> model = StructuralModel.chain([2.0], [800.0], [1.0], force_dofs=0, sensor_dofs=0)
        >>> plant = structural_plant(model)
        >>> plant.system[0].round(3), [parameter.name for parameter in plant.parameters]
        (array([[ 0.,  1.,  0.,  0.],
               [ 0.,  0.,  1., -1.],
               [ 1.,  0.,  0.,  0.]]), ['stiffness of element_0', 'damping of element_0'])
    """
    kept = _kept_displacements(model)
    places = _places(model)
    joins = np.array([relative_vector(ends, model.n_dofs) for _, ends in places]).T
    changes = _stiffness_changes(model) + _damping_changes(model)
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
            kept,
            damping=zero if change.damping is None else change.damping,
            stiffness=zero if change.stiffness is None else change.stiffness,
            shape=constant.shape,
        )
        for change in changes
    ]
    inertia = np.zeros((1 + len(changes), len(kept) + model.n_dofs, len(kept) + model.n_dofs))
    inertia[0] = scipy.linalg.block_diag(np.eye(len(kept)), model.mass)
    rates = np.zeros((model.n_outputs, inertia.shape[1]))
    accelerations = [i for i, kind in enumerate(model.sensor_kind) if kind == "acceleration"]
    rates[accelerations, len(kept) :] = model.sensor_map[accelerations]
    return Plant(
        inertia=inertia,
        rates=rates if accelerations else None,
        masses=_masses(model, kept, constant.shape),
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


def _kept_displacements(model: "StructuralModel") -> tuple[int, ...]:
    """DOFs whose displacement is a state."""
    read = np.zeros(model.n_dofs, dtype=np.bool_)
    for row, kind in zip(model.sensor_map, model.sensor_kind, strict=True):
        if kind == "displacement":
            read |= row != 0
    return tuple(int(i) for i in np.flatnonzero(read | model.stiffness.any(axis=1)))


def _assemble(
    model: "StructuralModel", kept: tuple[int, ...], *, damping: FloatArray, stiffness: FloatArray, joins: FloatArray
) -> FloatArray:
    """[F; H] for the given C and K: rates of the displacements, forces on the DOFs, outputs but for accelerations."""
    n_kept, n_inputs = len(kept), model.n_inputs
    n_states = n_kept + model.n_dofs
    system = np.zeros((n_states + model.n_outputs, n_states + n_inputs + joins.shape[1]))
    system[np.arange(n_kept), n_kept + np.array(kept, dtype=int)] = 1.0
    system[n_kept:n_states, n_states:] = np.hstack([model.force_map, -joins])
    if model.base_motion is not None:
        system[n_kept:n_states, n_states : n_states + n_inputs] -= model.mass @ model.base_motion
    for output, (row, kind) in enumerate(zip(model.sensor_map, model.sensor_kind, strict=True)):
        if kind == "displacement":
            system[n_states + output, :n_kept] = row[list(kept)]
        elif kind == "velocity":
            system[n_states + output, n_kept:n_states] = row
        elif model.base_motion is not None:  # the absolute one
            system[n_states + output, n_states : n_states + n_inputs] = row @ model.base_motion
    return system + _restoring(kept, damping=damping, stiffness=stiffness, shape=system.shape)


def _restoring(
    kept: tuple[int, ...], *, damping: FloatArray, stiffness: FloatArray, shape: tuple[int, ...]
) -> FloatArray:
    """What C and K put into [F; H]; linear in them."""
    n_kept, n_states = len(kept), len(kept) + len(stiffness)
    system = np.zeros(shape)
    system[n_kept:n_states, :n_states] = -np.hstack([stiffness[:, list(kept)], damping])
    return system


# --- ports -----------------------------------------------------------------------------------------------------------


def place_name(model: "StructuralModel", where: str) -> str:
    """The name of a place as the plant has it: that of the element where "dof_i" is the moving end of a grounded one.

    Example:
        >>> from modal.structure.structural_model import StructuralModel
        >>> model = StructuralModel.chain([2.0], [800.0], [1.0], force_dofs=0, sensor_dofs=0)
        >>> place_name(model, "dof_0")
        'element_0'
    """
    return {f"dof_{one.start}": one.name for one in model.elements if one.end is None}.get(where, where)


def places_in_words(model: "StructuralModel") -> dict[str, str]:
    """What a reader calls the places that nobody named: the sensors of the DOFs that an element joins say which it is.

    Example:
        >>> from modal.structure.structural_model import StructuralModel
        >>> model = StructuralModel.chain(
        ...     [2.0, 1.0], [800.0, 800.0], [1.0, 1.0], force_dofs=0, sensor_dofs=1, output_names=["roof"]
        ... )
        >>> places_in_words(model)
        {'dof_1': 'roof', 'element_0': 'the link DOF 0-ground', 'element_1': 'the link DOF 0-roof'}
    """
    sensors: dict[int, str] = {}
    for name, row in zip(model.output_names, model.sensor_map, strict=True):
        read = np.flatnonzero(row)
        if len(read) == 1 and not re.fullmatch(r"output_\d+", name):
            sensors.setdefault(int(read[0]), name)
    words = {f"dof_{dof}": name for dof, name in sensors.items()}
    for element in model.elements:
        ends = [*(sensors.get(dof, f"DOF {dof}") for dof in element.ends), *(["ground"] if element.end is None else [])]
        if is_numbered(element):
            words[element.name] = f"the link {'-'.join(ends)}" if model.n_dofs > 1 else "the link to ground"
    return words


def _places(model: "StructuralModel") -> list[tuple[str, tuple[int, ...]]]:
    """Name and ends of each port: the elements, then the DOFs that no element joins to the ground."""
    grounded = {element.start for element in model.elements if element.end is None}
    elements = [(element.name, element.ends) for element in model.elements]
    return elements + [(f"dof_{i}", (i,)) for i in range(model.n_dofs) if i not in grounded]


def _port(model: "StructuralModel", kept: tuple[int, ...], index: int, name: str, ends: tuple[int, ...]) -> Port:
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
