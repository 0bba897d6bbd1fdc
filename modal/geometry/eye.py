"""From where to look at a structure so that its extent and its motion are both seen.

Seen along the unit vector d, the plane of two axes i and j shows the share |d_k| of its area (k the third axis). With
weights w_k of the planes, the product of all shares to the power of their weights is largest at

    d_k^2 = w_k / (w_x + w_y + w_z),        w_x = s_y s_z,  w_y = s_z s_x,  w_z = s_x s_y

(Lagrange). s_i is how much of interest lies along axis i: extent and motion. A beam along X that moves in Z is so seen
from the front, a plate from above, a tower that moves in X and Y over its corner, a building like a box; a little less
from the right than that, since along a diagonal corners hide one another.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from modal.geometry.placement import Placement
from okid.arrays import FloatArray

__all__ = ["Eye", "chosen_eye"]

MOTION: Final = 0.45
"""Weight of the motion along an axis, as a share of that of the largest extent."""

LEAST: Final = 0.07
"""Weight of an axis without extent or motion: enough for a picture to look like one of space."""

ASIDE: Final = 0.72
"""Share of the way to the right that is gone: along a diagonal, corners and columns would hide one another."""

LOWEST: Final = 0.16
HIGHEST: Final = 0.62
"""Sine of the least and greatest height of the eye above the ground."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Eye:
    """A direction of view.

    Attributes:
        towards: (3,) unit vector from the structure to the eye.
        right: (3,) unit vector that points right in the picture.
        up: (3,) unit vector that points up in the picture.
    """

    towards: FloatArray
    right: FloatArray
    up: FloatArray

    def seen(self, points: FloatArray) -> FloatArray:
        """(n, 2) places in the picture, right and up, of (n, 3) points; without perspective."""
        return np.asarray(points @ np.column_stack([self.right, self.up]), dtype=np.float64)


def chosen_eye(placement: Placement) -> Eye:
    """The direction that shows most: from the front right, above the ground.

    Args:
        placement: extent by its nodes, motion by its sensors.

    Example:
        >>> from modal.geometry.placement import placed
        >>> chosen_eye(placed(None, ["a", "b", "c"])).towards.round(2).tolist()  # right, front, above
        [0.17, -0.92, 0.36]
    """
    positions = placement.geometry.positions
    extent = np.ptp(positions, axis=0)
    largest = float(extent.max())
    of_extent = extent / largest if largest > 0 else np.zeros(3)
    seen = np.zeros(3)
    for block in placement.motions.blocks:
        # how far each axis moves when every sensor of the block reads 1
        seen = np.maximum(seen, np.linalg.norm(block.matrix, axis=2).max(axis=0))
    of_motion = MOTION * np.minimum(seen, 1.0)
    size = np.maximum(np.hypot(of_extent, of_motion), LEAST)
    planes = np.array([size[1] * size[2], size[2] * size[0], size[0] * size[1]])
    return _eye(np.sqrt(planes / planes.sum()) * [ASIDE, -1.0, 1.0])


def _eye(towards: FloatArray) -> Eye:
    height = float(np.clip(towards[2], LOWEST, HIGHEST))
    level = towards[:2] / np.linalg.norm(towards[:2])
    towards = np.array([*(level * np.sqrt(1.0 - height**2)), height])
    right = np.array([-level[1], level[0], 0.0])
    return Eye(towards=towards, right=right, up=np.cross(towards, right))
