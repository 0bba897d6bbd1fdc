"""The linear parameters of a structural model, and what each of them changes in C and K.

Uncertain are the stiffness and the damping of the elements; where the elements do not make up K (or C), those of the
modes: K = M Phi diag(k) Phi' M with Phi' M Phi = I, of which each k may be wrong, the shapes may not. Masses are taken
as right: a common factor on M, C, K is an input gain, and one on M alone is one on C and K.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy

from modal.simulation.plant import LinearParameter
from modal.simulation.tolerances import ROUNDING, UNDAMPED_DEVIATION
from modal.structure.elements import relative_vector
from modal.structure.structural_model import StructuralModel
from okid.arrays import FloatArray

__all__ = ["Change", "changes_of", "updated_structure"]

_MOST_MODES = 32
"""Modes whose stiffness and damping are parameters at most, from the lowest."""


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


def changes_of(model: StructuralModel) -> tuple[Change, ...]:
    """The linear parameters: stiffnesses first, then dampings."""
    return _stiffness_changes(model) + _damping_changes(model)


def updated_structure(model: StructuralModel, linear: FloatArray) -> StructuralModel:
    """The model with its stiffnesses and dampings at other values of its linear parameters; effects stay.

    Args:
        model: The model as it was given.
        linear: (n_parameters,) values in the order of `structural_plant(model).parameters`.

    Example:
        >>> model = StructuralModel.chain([2.0], [800.0], [1.0], force_dofs=0, sensor_dofs=0)
        >>> updated_structure(model, np.array([810.0, 1.1])).stiffness
        array([[810.]])
    """
    changes = changes_of(model)
    stiffness, damping = model.stiffness.copy(), model.damping.copy()
    new = {change.parameter.name: float(value) for change, value in zip(changes, linear, strict=True)}
    for change, value in zip(changes, linear, strict=True):
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
    return replace(model, stiffness=stiffness, damping=damping, elements=elements)


def _stiffness_changes(model: StructuralModel) -> tuple[Change, ...]:
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
    flexible = [mode for mode in range(model.n_dofs) if squares[mode] > ROUNDING * squares[-1]]
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


def _damping_changes(model: StructuralModel) -> tuple[Change, ...]:
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
        natural = math.sqrt(squares[mode]) if squares[mode] > ROUNDING * squares[-1] else 0.0
        size = float(shapes[:, mode] @ model.damping @ shapes[:, mode])
        name = f"modal damping of mode {mode + 1} ({natural / (2 * np.pi):.4g} Hz)"
        parameter = _damping_parameter(name, "1/s", size, 2 * natural, model.damping_tolerance)
        if parameter is not None:
            changes.append(Change(parameter=parameter, damping=np.outer(weighted[:, mode], weighted[:, mode])))
    return tuple(changes)


def _springs_make_up(model: StructuralModel) -> bool:
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
    if nominal > ROUNDING * critical:
        return _within(name, unit, nominal, tolerance)
    if critical == 0:
        return None
    deviation = UNDAMPED_DEVIATION * critical
    return LinearParameter(
        name=name, unit=unit, nominal=nominal, deviation=deviation, lower=0.0, upper=nominal + 3 * deviation
    )
