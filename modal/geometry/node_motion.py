"""From what sensors saw to how nodes move: least squares at each node, and over each rigid body.

A node with sensors of directions d_i and readings y_i moves by v with d_i' v = y_i: the least-squares solution of least
size, so nothing is made up across the span of the directions. Directions within about 6 degrees of one another count as
one: their difference would be mostly noise.

A rigid body moves by t + r x (p - c). Readings at its nodes p_i give

    d_i' t + ((p_i - c) x d_i)' r = y_i    and, for a rotation about d_i,    d_i' r = y_i .

Translation comes first: of all solutions that fit equally well, the one with the least rotation r (so one sensor in X
and one in Y, wherever they are, move the body without turning it), and of these the one with the least t.
With A t + B r = y and the projection P = 1 - A A^+:  r = (P B)^+ P y,  t = A^+ (y - B r).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from okid.arrays import ComplexArray, FloatArray
from okid.errors import InvalidDataError

if TYPE_CHECKING:
    from modal.geometry.sensors import Geometry, Sensor

__all__ = ["RESOLVED", "Motions", "motion_of"]

RESOLVED: Final = 0.05
"""Singular values below this share of the largest are not used: two directions less than 5.7 degrees apart are one."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Block:
    """Nodes (m,) that move by matrix (m, 3, k) times the readings of outputs (k,)."""

    nodes: npt.NDArray[np.intp]
    outputs: npt.NDArray[np.intp]
    matrix: FloatArray
    is_body: bool


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Motions:
    """How the nodes of a geometry follow the outputs.

    Attributes:
        n_nodes: of the geometry.
        n_outputs: of the records.
        blocks: nodes, outputs and the matrix between them.
        used: indices of the outputs that move something.
    """

    n_nodes: int
    n_outputs: int
    blocks: tuple[_Block, ...]
    used: tuple[int, ...]

    def deflection(self, shape: ComplexArray) -> ComplexArray:
        """(n_nodes, 3) motion of every node in a shape (n_outputs,).

        Raises:
            InvalidDataError: the shape has not one component an output.
        """
        values = np.asarray(shape, dtype=np.complex128)
        if values.shape != (self.n_outputs,):
            raise InvalidDataError(
                f"a shape must have one component an output, ({self.n_outputs},), but has {values.shape}."
            )
        moved = np.zeros((self.n_nodes, 3), dtype=np.complex128)
        for block in self.blocks:
            moved[block.nodes] = block.matrix @ values[block.outputs]
        return moved

    @property
    def moving(self) -> npt.NDArray[np.intp]:
        """Nodes that can move, in rising order."""
        nodes = [block.nodes for block in self.blocks]
        return np.unique(np.concatenate(nodes)) if nodes else np.zeros(0, dtype=np.intp)

    @property
    def directions_seen(self) -> dict[int, int]:
        """Number of directions, 1 to 3, that sensors see at each measured node outside rigid bodies."""
        return {
            int(block.nodes[0]): int(np.linalg.matrix_rank(block.matrix[0], tol=1e-9))
            for block in self.blocks
            if not block.is_body
        }


def motion_of(geometry: "Geometry", sensors: "Sequence[Sensor | None]") -> Motions:
    """Solve every node and every rigid body once, for any shape.

    Args:
        geometry: the nodes.
        sensors: one an output; None for those that are not to be used.
    """
    at: dict[int, list[int]] = {}
    for output, sensor in enumerate(sensors):
        if sensor is not None:
            at.setdefault(sensor.node, []).append(output)
    bodies = [sorted(set(body)) for body in geometry.rigid]
    in_body = {node for body in bodies for node in body}
    fixed = set(geometry.fixed)
    blocks = []
    for node in sorted(set(at) - in_body - fixed):
        seen = [(output, one) for output in at[node] if (one := sensors[output]) is not None and one.motion == "along"]
        if seen:
            directions = np.array([one.direction for _, one in seen])
            matrix = np.linalg.pinv(directions, rcond=RESOLVED)[np.newaxis]
            blocks.append(_block([node], [output for output, _ in seen], matrix, is_body=False))
    for body in bodies:
        seen = [(output, one) for node in body for output in at.get(node, ()) if (one := sensors[output]) is not None]
        if seen:
            matrix = _body_matrix(geometry.positions, body, [one for _, one in seen])
            blocks.append(_block(body, [output for output, _ in seen], matrix, is_body=True))
    used = sorted(int(output) for block in blocks for output in block.outputs)
    return Motions(n_nodes=geometry.n_nodes, n_outputs=len(sensors), blocks=tuple(blocks), used=tuple(used))


def _block(nodes: Sequence[int], outputs: Sequence[int], matrix: FloatArray, *, is_body: bool) -> _Block:
    return _Block(
        nodes=np.array(nodes, dtype=np.intp), outputs=np.array(outputs, dtype=np.intp), matrix=matrix, is_body=is_body
    )


def _body_matrix(positions: FloatArray, body: Sequence[int], sensors: "Sequence[Sensor]") -> FloatArray:
    """(n_body_nodes, 3, n_sensors); rotations are counted in units of the body's size, so that all numbers compare."""
    centre = np.mean([positions[one.node] for one in sensors], axis=0)
    arms = positions[list(body)] - centre
    size = float(np.linalg.norm(arms, axis=1).max()) or 1.0
    along = np.array([one.motion == "along" for one in sensors])
    directions = np.array([one.direction for one in sensors])
    lever = (np.array([positions[one.node] for one in sensors]) - centre) / size
    to_translation = np.where(along[:, np.newaxis], directions, 0.0)
    to_rotation = np.where(along[:, np.newaxis], np.cross(lever, directions), directions)
    gain = np.where(along, 1.0, size)  # d' r = y becomes d' (size r) = size y
    inverse = np.linalg.pinv(to_translation, rcond=RESOLVED)
    left_over = np.eye(len(sensors)) - to_translation @ inverse
    seen = left_over @ to_rotation
    # what is left of a lever after translation has taken its part is judged against the whole body, not against itself
    rotation = _inverse_above(seen, RESOLVED) @ left_over
    translation = inverse @ (np.eye(len(sensors)) - to_rotation @ rotation)
    # r x arm, as a matrix that acts on r: rows of the cross product
    turn = np.cross(np.eye(3)[np.newaxis], arms[:, np.newaxis, :] / size).transpose(0, 2, 1)
    return np.asarray((translation[np.newaxis] + turn @ rotation) * gain, dtype=np.float64)


def _inverse_above(matrix: FloatArray, least: float) -> FloatArray:
    """Pseudo-inverse without the singular values below `least`."""
    left, values, right = np.linalg.svd(matrix, full_matrices=False)
    kept = values > least
    return np.asarray((right[kept].T / values[kept]) @ left[:, kept].T, dtype=np.float64)
