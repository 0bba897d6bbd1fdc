"""A structure in parallel projection: lines, surfaces and nodes at rest and deflected, on flat axes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection

from modal.plots.style import Theme
from modal.scene import Scene
from okid.arrays import FloatArray

__all__ = ["Frame", "draw_lines", "draw_surfaces", "frame_of", "place_labels"]

MOST_SEGMENTS: Final = 3000
MOST_TRIANGLES: Final = 3000
"""Drawn in one panel, so that a picture of thousands of nodes stays light."""


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
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

    def put(self, axis: Axes) -> None:
        """Give the axes this range, equal scales, and nothing else."""
        axis.set_xlim(self.low[0], self.high[0])
        axis.set_ylim(self.low[1], self.high[1])
        axis.set_aspect("equal")
        axis.set_axis_off()


def frame_of(scene: Scene, positions: Sequence[FloatArray]) -> Frame:
    """A frame around nodes in several positions, each (n_nodes, 3), with a margin; never flatter than 1 to 4."""
    seen = scene.eye.seen(np.concatenate(positions))
    low, high = seen.min(axis=0), seen.max(axis=0)
    margin = 0.06 * max(float((high - low).max()), 1e-6)
    low, high = low - margin, high + margin
    least = 0.25 * float((high - low).max())
    short = np.maximum(least - (high - low), 0.0) / 2
    return Frame(low - short, high + short)


def draw_lines(axis: Axes, scene: Scene, positions: FloatArray, *, colour: str, width: float, alpha: float) -> None:
    """The lines of the structure with its nodes at `positions` (n_nodes, 3)."""
    segments = scene.drawn_segments(MOST_SEGMENTS)
    if len(segments):
        seen = scene.eye.seen(positions)
        strips = LineCollection(list(seen[segments]), colors=colour, linewidths=width, alpha=alpha, capstyle="round")
        axis.add_collection(strips)


def draw_surfaces(axis: Axes, scene: Scene, positions: FloatArray, *, colour: str, alpha: float) -> None:
    """The surfaces of the structure, those behind first."""
    triangles = scene.triangles[:: -(-len(scene.triangles) // MOST_TRIANGLES) or 1]
    if not len(triangles):
        return
    depth = (positions @ scene.eye.towards)[triangles].mean(axis=1)
    corners = scene.eye.seen(positions)[triangles[np.argsort(depth, kind="stable")]]
    axis.add_collection(PolyCollection(list(corners), facecolors=colour, edgecolors="none", linewidths=0, alpha=alpha))


def place_labels(
    axis: Axes, frame: Frame, places: FloatArray, texts: Sequence[str], *, panel: tuple[float, float], theme: Theme
) -> None:
    """Names beside points, each where it covers no point and no other name; one that has no room is left out.

    Args:
        axis: of the panel.
        frame: that it shows.
        places: (n, 2) points in the picture.
        texts: one a point.
        panel: width and height of the panel [in].
        theme: colours.
    """
    points_per_unit = 72 * min(panel / (frame.high - frame.low))
    taken: list[tuple[float, float, float, float]] = [
        (x - 2.0, y - 2.0, x + 2.0, y + 2.0) for x, y in (places * points_per_unit).tolist()
    ]
    sides: tuple[tuple[float, float], ...] = ((1, 0.6), (1, -0.6), (-1, 0.6), (-1, -0.6), (0, 1.4), (0, -1.4))
    for (x, y), text in zip((places * points_per_unit).tolist(), texts, strict=True):
        width, height = 4.4 * len(text) + 2.0, 9.0
        for right, up in sides:
            left = x + 5.0 * right - width * (1 - right) / 2
            bottom = y + 7.0 * up - height / 2
            box = (left, bottom, left + width, bottom + height)
            if not any(box[0] < b[2] and b[0] < box[2] and box[1] < b[3] and b[1] < box[3] for b in taken):
                taken.append(box)
                centre = np.array([left + width / 2, bottom + height / 2]) / points_per_unit
                axis.text(
                    float(centre[0]),
                    float(centre[1]),
                    text,
                    ha="center",
                    va="center",
                    fontsize=7.5,
                    color=theme.muted,
                    clip_on=False,
                )
                break
