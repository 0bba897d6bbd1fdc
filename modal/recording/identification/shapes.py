"""Mode shapes that move on the structure: its lines at rest, the envelope, and lines, surfaces and sensors in motion.

Only what can move is stored for every moment; lines between nodes that no sensor sees stay with the structure at rest.
A recording of all shapes holds at most `MOST_POINTS` points in motion, about 12 bytes each, whatever the geometry: with
many of them a period has fewer pictures, then the record fewer periods, then fewer of the moving lines are drawn;
surfaces that would take more than a third of it are left out.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from modal.geometry.scene import Scene, envelope_of
from modal.modes.mode import Mode
from modal.recording.figure import Palette, RecordingStream, rr
from modal.recording.plan import Plan, label
from modal.recording.series import TIMELINE
from okid.arrays import ComplexArray, FloatArray


class Swinging:
    """How shapes swing along the timeline."""

    PERIODS: Final = 12
    """Swing so often from the start of the record to its end, in every mode: at their own rates one would see a
    blur."""
    FRAMES: Final = 32
    """Store so many pictures a period."""
    FEWEST_PERIODS: Final = 6
    FEWEST_FRAMES: Final = 10
    """Leave at least so many, whatever the geometry: then lines and surfaces are left out."""
    MOST_POINTS: Final = 2_000_000
    """Store so many points in motion at most, over all shapes and moments: 24 MB."""


class Still:
    """What is drawn beside a shape in motion."""

    SEGMENTS: Final = 20_000
    """Draw so many segments of the structure at rest: many more would make a viewer slow."""
    STEMS: Final = 16
    """Give up to so many measured nodes a stem from rest to where they are."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Pace:
    """How finely motion is stored.

    Attributes:
        periods: oscillations over the whole timeline.
        frames: pictures a period.
        segments: (n, 2) nodes at the ends of the lines that are drawn in motion.
        heads: measured nodes that are drawn in motion.
        surface: whether surfaces are drawn in motion.
    """

    periods: int
    frames: int
    segments: npt.NDArray[np.intp]
    heads: tuple[int, ...]
    surface: bool


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Moving:
    """Rest (n_nodes, 3), complex motion (n_nodes, 3), and the phase factor of every picture (n_frames,)."""

    rest: FloatArray
    motion: ComplexArray
    turn: ComplexArray

    def at(self, nodes: npt.NDArray[np.intp] | list[int]) -> npt.NDArray[np.float32]:
        """(n_frames, len(nodes), 3) where some nodes are."""
        turned = self.turn[:, np.newaxis, np.newaxis] * self.motion[nodes]
        return np.asarray(self.rest[nodes] + turned.real, dtype=np.float32)


def shape_path(number: int) -> str:
    """The entity above the picture of one mode."""
    return f"modes/shape/{number:02d}"


def pace_of(scene: Scene, n_shapes: int) -> Pace:
    """The finest motion within the budget."""
    room = Swinging.MOST_POINTS // (
        Swinging.FEWEST_PERIODS * Swinging.FEWEST_FRAMES * max(n_shapes, 1)
    )  # points a picture, at the least
    measured = measured_nodes(scene)
    heads = [measured[k] for k in np.linspace(0, len(measured) - 1, min(len(measured), room // 4)).astype(int)]
    corners = len(np.unique(scene.triangles))
    surface = bool(scene.moving.any()) and 0 < corners <= room // 3 and len(scene.triangles) <= Still.SEGMENTS
    beside = len(heads) * (3 if len(heads) <= Still.STEMS else 1) + (corners if surface else 0)
    movable = scene.segments[scene.moving[scene.segments].any(axis=1)]
    for periods, frames in (
        (Swinging.PERIODS, Swinging.FRAMES),
        (Swinging.PERIODS, Swinging.FRAMES // 2),
        (Swinging.FEWEST_PERIODS, Swinging.FRAMES // 2),
    ):
        if periods * frames * n_shapes * (beside + 2 * len(movable)) <= Swinging.MOST_POINTS:
            return Pace(periods=periods, frames=frames, segments=movable, heads=tuple(heads), surface=surface)
    kept = np.linspace(0, len(movable) - 1, min(len(movable), (room - beside) // 2)).astype(np.intp)
    return Pace(
        periods=Swinging.FEWEST_PERIODS,
        frames=Swinging.FEWEST_FRAMES,
        segments=movable[kept],
        heads=tuple(heads),
        surface=surface,
    )


def measured_nodes(scene: Scene) -> list[int]:
    """Nodes that carry a sensor which is drawn, in rising order."""
    return sorted({one.node for one in scene.placement.sensors if one is not None})


def log_shape(mode: Mode, number: int, recording: RecordingStream, plan: Plan, scene: Scene) -> None:
    """One mode: the structure at rest, the envelope, and the motion over the whole of the timeline."""
    path = shape_path(number)
    pace = pace_of(scene, len(plan.shapes))
    motion = scene.motion(mode)
    _log_structure(path, recording, scene, named=len(plan.shapes) <= 4)  # small pictures have no room for names
    _log_envelope(path, recording, scene, pace, envelope_of(motion))
    n_frames = pace.periods * pace.frames
    times = np.linspace(plan.data.start, max(plan.data.stop, plan.data.start + 1e-3), n_frames)
    moving = _Moving(
        rest=scene.positions,
        motion=motion,
        # real at phase 0, so that the first picture shows the shape as the table's numbers give it
        turn=np.exp(2j * np.pi * np.arange(n_frames) / pace.frames),
    )
    _log_motion(path, recording, scene, pace, times=times, moving=moving)


def _log_structure(path: str, recording: RecordingStream, scene: Scene, *, named: bool) -> None:
    """What stands still: lines, nodes with their names, fixed nodes, which way the sensors look."""
    rest, geometry = scene.positions, scene.placement.geometry
    segments = scene.drawn_segments(Still.SEGMENTS)
    if len(segments):
        lines = rr.LineStrips3D(
            rest[segments], radii=rr.Radius.ui_points(_width(len(segments), 1.0)), colors=Palette.GREY
        )
        recording.log(f"{path}/rest", lines, static=True, strict=True)
    measured = measured_nodes(scene)
    if measured:
        texts = [label(geometry.node_names[node], 14) for node in measured]
        points = rr.Points3D(
            rest[measured],
            radii=rr.Radius.ui_points(2.5),
            colors=Palette.GREY,
            labels=texts,
            show_labels=named and sum(map(len, texts)) <= 48,
        )
        recording.log(f"{path}/sensors", points, static=True, strict=True)
    if geometry.fixed:
        points = rr.Points3D(rest[list(geometry.fixed)], radii=rr.Radius.ui_points(6.0), colors=Palette.GREY)
        recording.log(f"{path}/fixed", points, static=True, strict=True)
    placed_ones = [one for one in scene.placement.sensors if one is not None]
    if scene.placement.is_given and 0 < len(placed_ones) <= 60:
        arrows = rr.Arrows3D(
            origins=rest[[one.node for one in placed_ones]],
            vectors=[0.16 * one.direction for one in placed_ones],  # half the largest extent is 1
            radii=rr.Radius.ui_points(0.9),
            colors=Palette.GOLD,
        )
        recording.log(f"{path}/directions", arrows, static=True, strict=True)


def _log_envelope(path: str, recording: RecordingStream, scene: Scene, pace: Pace, furthest: FloatArray) -> None:
    """Both ends of the motion; nodes on no line show the stretch on which they move."""
    rest = scene.positions
    strips = [(rest + sign * furthest)[pace.segments] for sign in (1.0, -1.0) if len(pace.segments)]
    alone = np.setdiff1d(np.flatnonzero(scene.moving), scene.segments)
    if alone.size:
        strips.append(np.stack([(rest - furthest)[alone], (rest + furthest)[alone]], axis=1))
    if strips:
        n_strips = sum(map(len, strips))
        lines = rr.LineStrips3D(
            np.concatenate(strips), radii=rr.Radius.ui_points(_width(n_strips, 0.8)), colors=Palette.DIM_BLUE
        )
        recording.log(f"{path}/envelope", lines, static=True, strict=True)


def _log_motion(
    path: str, recording: RecordingStream, scene: Scene, pace: Pace, *, times: FloatArray, moving: _Moving
) -> None:
    index = [rr.TimeColumn(TIMELINE, duration=times)]
    n_frames = len(times)
    if len(pace.segments):
        width = _width(len(pace.segments), 3.0)
        ends = moving.at(pace.segments.ravel()).reshape(n_frames, -1, 2, 3)
        _send_strips(f"{path}/line", recording, index, ends, colour=Palette.BLUE, width=width)
    measured = list(pace.heads)
    if pace.surface:
        _log_surface(f"{path}/surface", recording, index, scene, moving)
    if not measured:
        return
    heads_at = moving.at(measured)
    if len(measured) <= Still.STEMS:
        rest = np.broadcast_to(scene.positions[measured].astype(np.float32), (n_frames, len(measured), 3))
        stems = np.stack([rest, heads_at], axis=2)
        _send_strips(f"{path}/stems", recording, index, stems, colour=Palette.ORANGE, width=1.2)
    heads = rr.Points3D.columns(positions=heads_at.reshape(-1, 3)).partition([len(measured)] * n_frames)
    recording.send_columns(f"{path}/heads", index, heads, strict=True)
    radius = 5.0 if len(measured) <= Still.STEMS else 3.0 if len(measured) <= 200 else 1.5
    style = rr.Points3D.from_fields(radii=rr.Radius.ui_points(radius), colors=Palette.ORANGE)
    recording.log(f"{path}/heads", style, static=True, strict=True)


def _send_strips(
    path: str,
    recording: RecordingStream,
    index: object,
    strips: npt.NDArray[np.float32],
    *,
    colour: tuple[int, int, int],
    width: float,
) -> None:
    """Strips (n_frames, n_strips, n_places, 3), as many in every frame."""
    n_frames, n_strips, n_places, _ = strips.shape
    columns = rr.LineStrips3D.columns(strips=strips.reshape(-1, n_places, 3)).partition([n_strips] * n_frames)
    recording.send_columns(path, index, columns, strict=True)
    style = rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(width), colors=colour)
    recording.log(path, style, static=True, strict=True)


def _log_surface(path: str, recording: RecordingStream, index: object, scene: Scene, moving: _Moving) -> None:
    corners, triangles = np.unique(scene.triangles, return_inverse=True)
    moved = moving.at(corners)
    columns = rr.Mesh3D.columns(vertex_positions=moved.reshape(-1, 3)).partition([len(corners)] * len(moved))
    recording.send_columns(path, index, columns, strict=True)
    style = rr.Mesh3D.from_fields(
        triangle_indices=triangles.reshape(-1, 3), albedo_factor=(*Palette.DIM_BLUE, 90), face_rendering="DoubleSided"
    )
    recording.log(path, style, static=True, strict=True)


def _width(n_strips: int, few: float) -> float:
    """Thinner where there are many: 40 lines are drawn in full width, 400 in half, thousands in a third."""
    return few * (1.0 if n_strips <= 40 else 0.65 if n_strips <= 400 else 0.35)
