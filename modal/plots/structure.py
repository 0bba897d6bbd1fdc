"""A structure in parallel projection: lines, surfaces and nodes at rest and deflected, on flat axes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from modal.geometry.scene import Scene
from modal.plots.panels import Panel
from modal.plots.style import Role, text_width
from okid.arrays import FloatArray

__all__ = ["Viewport", "draw_lines", "draw_surfaces", "frame_of", "place_labels"]

MOST_SEGMENTS: Final = 3000
MOST_TRIANGLES: Final = 3000
"""Draw at most so many lines and triangles in one panel, so that a picture of thousands of nodes stays light."""
NAME_SIZE: Final = 7.5
"""Write the names of nodes so large [pt]."""


@dataclass(frozen=True, slots=True, eq=False)
class Viewport:
    """The part of the flat picture that holds everything.

    Attributes:
        low: (2,) left and bottom.
        high: (2,) right and top.
    """

    low: FloatArray
    high: FloatArray

    @property
    def aspect(self) -> float:
        """Height over width."""
        width, height = self.high - self.low
        return float(height / width)

    def put(self, panel: Panel) -> None:
        """Give the panel this range, equal scales, and nothing else."""
        (left, bottom), (right, top) = self.low.tolist(), self.high.tolist()
        panel.x.limits, panel.y.limits = (left, right), (bottom, top)
        panel.equal, panel.frame = True, False


def frame_of(scene: Scene, positions: Sequence[FloatArray]) -> Viewport:
    """A frame around nodes in several positions, each (n_nodes, 3), with a margin; never flatter than 1 to 4."""
    seen = scene.eye.seen(np.concatenate(positions))
    low, high = seen.min(axis=0), seen.max(axis=0)
    margin = 0.06 * max(float((high - low).max()), 1e-6)
    low, high = low - margin, high + margin
    least = 0.25 * float((high - low).max())
    short = np.maximum(least - (high - low), 0.0) / 2
    return Viewport(low - short, high + short)


def draw_lines(
    panel: Panel, scene: Scene, positions: FloatArray, role: Role, *, width: float, opacity: float = 1.0
) -> None:
    """The lines of the structure with its nodes at `positions` (n_nodes, 3)."""
    segments = scene.drawn_segments(MOST_SEGMENTS)
    if len(segments):
        seen = scene.eye.seen(positions)
        panel.segments(seen[segments], role, width=width, opacity=opacity)


def draw_surfaces(panel: Panel, scene: Scene, positions: FloatArray, role: Role, *, opacity: float) -> None:
    """The surfaces of the structure, those behind first."""
    triangles = scene.triangles[:: -(-len(scene.triangles) // MOST_TRIANGLES) or 1]
    if not len(triangles):
        return
    depth = (positions @ scene.eye.towards)[triangles].mean(axis=1)
    corners = scene.eye.seen(positions)[triangles[np.argsort(depth, kind="stable")]]
    panel.polygons(corners, role, opacity=opacity)


def place_labels(
    panel: Panel, frame: Viewport, places: FloatArray, texts: Sequence[str], *, size: tuple[float, float]
) -> None:
    """Names beside points, each where it covers no point and no other name; one that has no room is left out.

    Args:
        panel: to write into.
        frame: that it shows.
        places: (n, 2) points in the picture.
        texts: one a point.
        size: width and height of the panel [in].
    """
    points_per_unit = 72 * min(size / (frame.high - frame.low))
    taken: list[tuple[float, float, float, float]] = [
        (x - 2.0, y - 2.0, x + 2.0, y + 2.0) for x, y in (places * points_per_unit).tolist()
    ]
    sides: tuple[tuple[float, float], ...] = ((1, 0.6), (1, -0.6), (-1, 0.6), (-1, -0.6), (0, 1.4), (0, -1.4))
    for (x, y), text in zip((places * points_per_unit).tolist(), texts, strict=True):
        width, height = text_width(text, NAME_SIZE) + 2.0, 9.0
        for right, up in sides:
            left = x + 5.0 * right - width * (1 - right) / 2
            bottom = y + 7.0 * up - height / 2
            box = (left, bottom, left + width, bottom + height)
            if not any(box[0] < b[2] and b[0] < box[2] and box[1] < b[3] and b[1] < box[3] for b in taken):
                taken.append(box)
                centre = np.array([left + width / 2, bottom + height / 2]) / points_per_unit
                shift = (0.0, NAME_SIZE / 3)
                panel.word(
                    float(centre[0]), float(centre[1]), text, "muted", size=NAME_SIZE, anchor="middle", shift=shift
                )
                break
