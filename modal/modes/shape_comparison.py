"""Assurance: how alike two sets of mode shapes are, whatever their scaling.

The field calls it MAC, and calls the amplitude coherence of a single mode MAC too; here each has its own name.
"""

from typing import cast

import numpy as np

from okid.arrays import ComplexArray, FloatArray
from okid.errors import InvalidDataError

__all__ = ["assurance"]


def assurance(first: ComplexArray, second: ComplexArray) -> FloatArray:
    """Modal assurance |a^H b|^2 / (a^H a b^H b) of every shape of one set with every shape of another.

    Args:
        first: (n_outputs, n_first) shapes, one a column; real or complex.
        second: (n_outputs, n_second).

    Returns:
        (n_first, n_second) in [0, 1]; 0 for a shape of zeros.

    Raises:
        InvalidDataError: not two-dimensional, or different numbers of outputs.

    References:
        Allemang, Brown, A correlation coefficient for modal vector analysis, 1st International Modal Analysis
        Conference, 1982.

    Example:
        >>> assurance(np.array([[1.0], [1.0]]), np.array([[2.0, 1.0], [2.0, -1.0]])).round(12).tolist()
        [[1.0, 0.0]]
    """
    first, second = np.asarray(first), np.asarray(second)
    if first.ndim != 2 or second.ndim != 2 or first.shape[0] != second.shape[0]:
        raise InvalidDataError(
            f"shapes must stand in columns over the same outputs, but have shapes {first.shape} and {second.shape}; "
            "pass (n_outputs, n_modes) twice."
        )
    return cast("FloatArray", np.abs(_unit(first).conj().T @ _unit(second)) ** 2)


def _unit(shapes: ComplexArray) -> ComplexArray:
    length = np.linalg.norm(shapes, axis=0)
    return shapes / np.where(length > 0, length, 1.0)
