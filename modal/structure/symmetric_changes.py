"""What may be wrong in the linear part of a structure: its stiffness and its damping matrix, which stay symmetric.

A spring or damper pushes both its ends with the same force, so a wrong one, wherever it is, changes K or C by a
symmetric matrix. In coordinates of the undamped modes that is one number a mode and one a pair of modes. Without the
symmetry, that is with any linear force, a wrong gain of a sensor would be a change of the plant as well: in y' = g y
it multiplies a row of K by g and divides a column by it. So would a gain of an input, but for its driven place.
"""

from itertools import combinations_with_replacement

import numpy as np

from modal.simulation.plant import LinearParameter
from modal.simulation.tolerances import UNDAMPED_DEVIATION
from modal.structure.internal_changes import MOST, InternalChanges
from modal.structure.motion_rows import OutputMotion
from modal.structure.reciprocity import Structure
from okid.arrays import FloatArray

__all__ = ["symmetric_changes"]


_REACH, _DAMPING_REACH = 3.0, 10.0
"""Hard bounds, in standard deviations of the prior, and those of a mode's damping, which is often no more than a guess.
Beside the diagonal three deviations are about what leaves a damping matrix positive, sqrt(C_aa C_bb)."""

_UNDAMPED = 1e-6
"""Damping ratio below which a mode counts as undamped."""


def symmetric_changes(
    A: FloatArray,
    structure: Structure,
    motions: tuple[OutputMotion, ...],
    *,
    frequency_tolerance: float,
    damping_tolerance: float,
) -> InternalChanges | None:
    """The entries of the modal stiffness and damping matrices.

    The prior is that of a change whose entries, in units in which the matrix is one, are independent with a deviation
    smaller by sqrt(2) beside the diagonal: the one such prior that is the same in any coordinates of the modes.

    Args:
        A: (n_states, n_states) of the state space.
        structure: The structure behind it.
        motions: What the outputs show.
        frequency_tolerance: Standard deviation of the prior on a natural frequency, as a share of it.
        damping_tolerance: Relative standard deviation of the prior on a modal damping.

    Returns:
        The parameters; None where they would be more than 80.
    """
    n_modes = structure.n_modes
    if n_modes * (n_modes + 1) > MOST:
        return None
    natural = np.sqrt(structure.stiffness)
    damped = np.diag(structure.damping)
    damping = np.where(damped > 2 * _UNDAMPED * natural, damping_tolerance * damped, 2 * UNDAMPED_DEVIATION * natural)
    direct = np.array([one.direct for one in motions]) @ structure.forces
    entering = np.vstack([structure.forces, direct])
    kinds = (
        ("stiffness", "1/s^2", np.diag(structure.stiffness), 2 * frequency_tolerance * structure.stiffness, _REACH, 0),
        ("damping", "1/s", structure.damping, damping, _DAMPING_REACH, 1),
    )
    parameters, slopes = [], []
    for word, unit, matrix, spread, reach, power in kinds:
        rows = structure.displacements @ np.linalg.matrix_power(A, power)
        for a, b in combinations_with_replacement(range(n_modes), 2):
            change = np.outer(entering[:, a], rows[b])
            slopes.append(-change if a == b else -(change + np.outer(entering[:, b], rows[a])))
            where = f"of mode {a + 1} ({natural[a] / (2 * np.pi):.4g} Hz)"
            parameters.append(
                _entry(
                    f"{word} {where}" if a == b else f"{word} between modes {a + 1} and {b + 1}",
                    unit,
                    nominal=float(matrix[a, b]),
                    deviation=float(np.sqrt(spread[a] * spread[b]) * (1.0 if a == b else np.sqrt(0.5))),
                    reach=reach if a == b else _REACH,
                    least=0.0 if a == b else -np.inf,
                )
            )
    return InternalChanges(parameters=tuple(parameters), slopes=np.array(slopes))


def _entry(name: str, unit: str, *, nominal: float, deviation: float, reach: float, least: float) -> LinearParameter:
    """Within so many deviations of its nominal value, and what stands on the diagonal never negative."""
    return LinearParameter(
        name=name,
        unit=unit,
        nominal=nominal,
        deviation=deviation,
        lower=min(max(nominal - reach * deviation, least), nominal),
        upper=nominal + reach * deviation,
    )
