"""The real modal form of a state space, and the linear parameters that change its poles.

A becomes block diagonal: [[s, w], [-w, s]] for a pair of poles s +- i w, s for a real pole. Each s and w is one number
that A depends on linearly, shapes and participations stay. Where poles coincide so that there are no independent
shapes (a free mass: two poles at zero) the real Schur form stands in: the same blocks, with couplings above them.
States are scaled so that each block's rows of B and columns of C are of one size.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from modal.simulation.plant import LinearParameter
from modal.simulation.tolerances import ROUNDING, UNDAMPED_DEVIATION
from modal.structure.continuous_time import ContinuousSystem
from okid.arrays import FloatArray

__all__ = ["ModalCoordinates", "in_modal_coordinates"]

_DEFECTIVE = 1e8
"""Condition of the shapes from which on they are taken for dependent."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ModalCoordinates:
    """A state space in real modal form.

    Attributes:
        system: In the new states.
        parameters: Real and imaginary part of each pair of poles, each real pole; not of poles at zero.
        slopes: (n_parameters, n_states, n_states) derivative of A by each.
    """

    system: ContinuousSystem
    parameters: tuple[LinearParameter, ...]
    slopes: FloatArray


def in_modal_coordinates(
    system: ContinuousSystem, *, frequency_tolerance: float, damping_tolerance: float
) -> ModalCoordinates:
    """Bring a system to real modal form.

    Args:
        system: A stable system with at least one state.
        frequency_tolerance: Standard deviation of the prior on an imaginary part, as a share of |pole|; hard bounds at
            3 of them.
        damping_tolerance: Relative standard deviation of the prior on a real part; it stays within a factor
            1 + 3 damping_tolerance of the nominal one, so the pole stays stable.

    Example:
        >>> pair = ContinuousSystem(A=np.array([[0.0, 1.0], [-4.0, -0.4]]), B=np.array([[0.0], [1.0]]),
        ...     C=np.array([[1.0, 0.0]]), D=np.zeros((1, 1)))
        >>> form = in_modal_coordinates(pair, frequency_tolerance=0.1, damping_tolerance=0.5)
        >>> form.system.A.round(3), [parameter.name for parameter in form.parameters]
        (array([[-0.2 ,  1.99],
               [-1.99, -0.2 ]]), ['real part of pole pair 1 (0.3183 Hz)', 'imaginary part of pole pair 1 (0.3183 Hz)'])
    """
    # states in mixed units would look dependent, and rounding would follow the largest
    balanced, (sizes, _) = scipy.linalg.matrix_balance(system.A, permute=False, separate=True)
    matrix, states = _block_diagonal(balanced)
    states = sizes[:, None] * states
    B = np.asarray(np.linalg.solve(states, system.B), dtype=np.float64)
    C = system.C @ states
    blocks = _blocks(matrix)
    scale = np.concatenate([np.full(len(block), _balance(B[block], C[:, block])) for block in blocks])
    matrix = matrix * scale / scale[:, None]
    largest = float(np.abs(np.linalg.eigvals(matrix)).max(initial=0.0))
    parameters: list[LinearParameter] = []
    slopes: list[FloatArray] = []
    tolerances = frequency_tolerance, damping_tolerance
    for number, block in enumerate(blocks, start=1):
        for parameter, slope in _block_parameters(matrix, block, number, largest, tolerances):
            parameters.append(parameter)
            slopes.append(slope)
    return ModalCoordinates(
        system=ContinuousSystem(A=matrix, B=B / scale[:, None], C=C * scale, D=system.D),
        parameters=tuple(parameters),
        slopes=np.array(slopes).reshape(len(slopes), *matrix.shape),
    )


def _block_diagonal(A: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The blocks by rising |pole|, and the columns of the states in them."""
    poles, vectors = np.linalg.eig(A)
    columns, chosen = [], []
    for index in np.argsort(np.abs(poles), kind="stable"):
        if poles[index].imag > 0:
            columns += [vectors[:, index].real, vectors[:, index].imag]
        elif poles[index].imag == 0:
            columns.append(vectors[:, index].real)
        chosen.append(index)
    states = np.array(columns).T
    states = states / np.linalg.norm(states, axis=0)
    if len(columns) < len(A) or np.linalg.cond(states) > _DEFECTIVE:
        schur, rotation = scipy.linalg.schur(A, output="real")
        return schur, rotation
    # pairs share one scale, or their blocks would lose their form
    states = np.array(columns).T
    matrix = np.zeros_like(A)
    row = 0
    for index in chosen:
        pole = poles[index]
        if pole.imag > 0:
            matrix[row : row + 2, row : row + 2] = [[pole.real, pole.imag], [-pole.imag, pole.real]]
            row += 2
        elif pole.imag == 0:
            matrix[row, row] = pole.real
            row += 1
    return matrix, states


def _blocks(matrix: FloatArray) -> list[list[int]]:
    """States of each diagonal block of a quasi-triangular matrix."""
    blocks, row = [], 0
    while row < len(matrix):
        size = 2 if row + 1 < len(matrix) and matrix[row + 1, row] != 0 else 1
        blocks.append(list(range(row, row + size)))
        row += size
    return blocks


def _balance(B: FloatArray, C: FloatArray) -> float:
    """Scale of the states at which the rows of B and the columns of C have one size."""
    into, out = float(np.linalg.norm(B)), float(np.linalg.norm(C))
    if into > 0 and out > 0:
        return float(np.sqrt(into / out))
    return into or (1 / out if out > 0 else 1.0)


def _block_parameters(
    matrix: FloatArray, block: list[int], number: int, largest: float, tolerances: tuple[float, float]
) -> list[tuple[LinearParameter, FloatArray]]:
    frequency_tolerance, damping_tolerance = tolerances
    first, last = block[0], block[-1]
    pole = complex(matrix[first, first], 0.0)
    if len(block) == 2:
        pole = complex(matrix[first, first], np.sqrt(-matrix[first, last] * matrix[last, first]))
    size = abs(pole)
    if size <= ROUNDING * largest:
        return []
    pair = f"of pole pair {number} ({size / (2 * np.pi):.4g} Hz)"
    by_real = np.zeros_like(matrix)
    by_real[block, block] = 1.0
    factor = 1 + 3 * damping_tolerance
    deviation, lower, upper = damping_tolerance * abs(pole.real), factor * pole.real, pole.real / factor
    if abs(pole.real) <= 1e-6 * size:
        deviation = UNDAMPED_DEVIATION * size
        lower, upper = pole.real - 3 * deviation, max(pole.real, 0.0)
    real = LinearParameter(
        name=f"real part {pair}" if len(block) == 2 else f"real pole {number} ({pole.real:.4g} 1/s)",
        unit="1/s",
        nominal=pole.real,
        deviation=deviation,
        lower=lower,
        upper=upper,
    )
    if len(block) == 1:
        return [(real, by_real)]
    by_imaginary = np.zeros_like(matrix)
    by_imaginary[first, last] = matrix[first, last] / pole.imag
    by_imaginary[last, first] = matrix[last, first] / pole.imag
    deviation = frequency_tolerance * size
    imaginary = LinearParameter(
        name=f"imaginary part {pair}",
        unit="1/s",
        nominal=pole.imag,
        deviation=deviation,
        lower=max(pole.imag - 3 * deviation, 1e-3 * pole.imag),
        upper=pole.imag + 3 * deviation,
    )
    return [(real, by_real), (imaginary, by_imaginary)]
