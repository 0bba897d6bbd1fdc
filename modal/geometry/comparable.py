"""Shapes whose components are of one kind, so that an assurance does not hang on what was measured in which unit.

For a mode with pole s, velocity is s and acceleration s^2 times displacement. Where the outputs are displacements,
velocities and accelerations together, dividing by that power makes displacements of all of them, whatever the units.
"""

from collections.abc import Sequence

import numpy as np

from modal.geometry.placement import ROTATION, TRANSLATION
from modal.modes.mode import Mode
from okid.arrays import ComplexArray
from okid.readers.units import convert_unit

__all__ = ["comparable_shapes", "comparison_words"]


def comparable_shapes(modes: Sequence[Mode], output_names: Sequence[str], output_units: Sequence[str]) -> ComplexArray:
    """(n_outputs, n_modes) shapes as displacements where units differ and allow it, as they are otherwise.

    Args:
        modes: with shapes of n_outputs components.
        output_names: of the outputs.
        output_units: of the outputs.

    Example:
        >>> from types import SimpleNamespace
        >>> fast = SimpleNamespace(pole=10j, shape=np.array([1.0, -200.0]))
        >>> comparable_shapes([fast], ["a", "b"], ["m", "m/s^2"]).real.ravel().tolist()
        [1.0, 2.0]
    """
    if not modes:
        return np.empty((len(output_names), 0), dtype=np.complex128)
    shapes = np.column_stack([mode.shape for mode in modes]).astype(np.complex128)
    kinds = _kinds(output_names, output_units)
    if kinds is None:
        return shapes
    factors = np.array([factor for factor, _ in kinds])
    powers = np.array([order for _, order in kinds])
    poles = np.array([mode.pole or 1.0 for mode in modes], dtype=np.complex128)
    return np.asarray(shapes * factors[:, np.newaxis] / poles ** powers[:, np.newaxis], dtype=np.complex128)


def comparison_words(output_names: Sequence[str], output_units: Sequence[str]) -> str:
    """What was done to outputs of several units before shapes are compared; "" where they have one.

    Example:
        >>> comparison_words(["a", "b"], ["m", "m"])
        ''
    """
    if len(set(output_units)) < 2:
        return ""
    if _kinds(output_names, output_units) is None:
        return (
            "The assurance is that of the numbers as they are, so outputs in units with large numbers weigh more in it."
        )
    return (
        "The outputs have different units: for the assurance all are made displacements, velocities divided by the "
        "pole and accelerations by its square."
    )


def _kinds(names: Sequence[str], units: Sequence[str]) -> list[tuple[float, int]] | None:
    """SI units in one unit of each output and how often it is derived by time; None for one unit, or several kinds."""
    if len(set(units)) < 2:
        return None
    known = [convert_unit(name, unit) if unit else None for name, unit in zip(names, units, strict=True)]
    for kind in (TRANSLATION, ROTATION):
        if all(one is not None and one.unit in kind for one in known):
            return [(one.factor, kind[one.unit]) for one in known if one is not None]
    return None
