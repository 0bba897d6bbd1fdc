"""What may be wrong in the linear part of a state space: any linear force inside the structure.

A wrong stiffness or damping anywhere in a structure is a force that is linear in the state and that, as any force,
moves no displacement at once: A becomes A + N F with N spanning the directions that leave the measured displacements
where they are and F free. Poles and shapes change together, as they do in a structure; changing the poles alone would
leave a gap of several per cent of a response whose shapes are wrong by as much.
"""

from dataclasses import dataclass

import numpy as np

from modal.simulation.plant import LinearParameter
from modal.structure.motion_rows import OutputMotion
from okid.arrays import FloatArray

__all__ = ["INTERNAL_FORCE", "InternalChanges", "internal_changes"]

INTERNAL_FORCE = "internal force"
"""How the names of these parameters begin."""

MOST = 80
"""Entries of F at most; with more only the poles are calibrated."""

STILL = 1e-7
REACH = 10.0
"""Hard bounds, in standard deviations of the prior."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class InternalChanges:
    """Entries of F as linear parameters.

    Attributes:
        parameters: One an entry.
        slopes: (n_parameters, n_states + n_outputs, n_states) derivative of [A; C].
    """

    parameters: tuple[LinearParameter, ...]
    slopes: FloatArray


def internal_changes(
    A: FloatArray, free: FloatArray, motions: tuple[OutputMotion, ...], *, tolerance: float
) -> InternalChanges | None:
    """The entries of F, each zero in the model as given.

    Args:
        A: (n_states, n_states) in real modal form.
        free: (n_states, n_free) directions that leave the measured displacements where they are.
        motions: What the outputs show.
        tolerance: Standard deviation of the prior, as a share of the linear forces that the model has.

    Returns:
        The parameters; None for plants that are no structure, have rigid-body motion, or need more than 80 entries.
    """
    n_states, n_free = free.shape
    if n_states < 2 or n_states * n_free > MOST or any(one.nature != "mechanical" for one in motions):
        return None
    poles = np.abs(np.linalg.eigvals(A))
    if poles.min() <= STILL * poles.max():  # rigid-body motion: a spring to nowhere would be added
        return None
    direct = np.array([one.direct for one in motions])
    parameters, slopes = [], []
    for a in range(n_free):
        scale = tolerance * float(np.linalg.norm(free[:, a] @ A)) / np.sqrt(2.0)
        column = np.concatenate([free[:, a], direct @ free[:, a]])
        for b in range(n_states):
            change = np.zeros((len(column), n_states))
            change[:, b] = column
            slopes.append(change)
            parameters.append(
                LinearParameter(
                    name=f"{INTERNAL_FORCE} {a + 1} by modal state {b + 1}",
                    unit="1/s",
                    nominal=0.0,
                    deviation=scale,
                    lower=-REACH * scale,
                    upper=REACH * scale,
                )
            )
    return InternalChanges(parameters=tuple(parameters), slopes=np.array(slopes))
