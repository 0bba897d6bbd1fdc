"""Mode shapes as a stick picture that moves: sensors in their order along a line, deflection sideways.

Without a geometry nothing more is known than the order of the sensors. Outputs of different units cannot share one
scale: each unit has a line of its own, one behind the other, scaled so that its largest deflection in this mode is 1;
the phase between them is kept, and so is the place of each sensor in the order of all.
Between two sensors the line is straight; nothing was measured there.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from modal.mode import Mode
from modal.recording.names import label
from modal.recording.palette import BLUE, CYCLE, DIM_BLUE, GREY, ORANGE, Colour
from modal.recording.plan import Plan
from modal.recording.series import TIMELINE
from okid.arrays import ComplexArray, FloatArray

if TYPE_CHECKING:
    import rerun

__all__ = ["HALF_LENGTH", "PERIODS", "SPACING", "Stick", "deflection", "log_shape", "shape_path", "sticks"]

PERIODS: Final = 12
"""Oscillations from the start of the record to its end, for every mode: at their own rates one would see a blur."""

FRAMES: Final = 32
"""Pictures a period."""

HALF_LENGTH: Final = 1.0
SPACING: Final = 0.7
NAMED_LETTERS: Final = 48
NAMED_SHAPES: Final = 4
"""Sensors carry their names where there is room: so many letters in all, in so many pictures."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Stick:
    """The outputs of one unit, along one line.

    Attributes:
        unit: what they are measured in, "" where unknown.
        outputs: their indices.
        rest: (n, 3) their places at rest.
        colour: of the deflected line.
    """

    unit: str
    outputs: tuple[int, ...]
    rest: FloatArray
    colour: Colour


def sticks(units: Sequence[str]) -> tuple[Stick, ...]:
    """One stick a unit, in the order in which units first appear.

    Example:
        >>> [(stick.unit, stick.outputs) for stick in sticks(["m", "rad", "m"])]
        [('m', (0, 2)), ('rad', (1,))]
    """
    kinds = list(dict.fromkeys(units))
    colours = (BLUE, *CYCLE[1:])
    places = np.linspace(-HALF_LENGTH, HALF_LENGTH, len(units)) if len(units) > 1 else np.zeros(1)
    found = []
    for k, unit in enumerate(kinds):
        outputs = tuple(i for i, u in enumerate(units) if u == unit)
        rest = np.zeros((len(outputs), 3))
        rest[:, 0] = [places[i] for i in outputs]
        rest[:, 1] = SPACING * (k - (len(kinds) - 1) / 2)
        found.append(Stick(unit=unit, outputs=outputs, rest=rest, colour=colours[k % len(colours)]))
    return tuple(found)


def deflection(n_shapes: int) -> float:
    """Height of the largest deflection, as a share of half the stick: less where many pictures make each one low."""
    return 0.7 if n_shapes <= 3 else 0.45


def shape_path(number: int) -> str:
    """The entity above the picture of one mode."""
    return f"modes/shape/{number:02d}"


def log_shape(
    mode: Mode,
    number: int,
    recording: "rerun.RecordingStream",
    plan: Plan,
    *,
    names: Sequence[str],
    units: Sequence[str],
) -> None:
    """One mode: rest line, envelope, and the moving line with its sensors, over the whole of the timeline.

    Args:
        mode: whose shape.
        number: its number in the plan.
        recording: the stream.
        plan: of the recording.
        names: of the outputs.
        units: of the outputs.
    """
    n_frames = PERIODS * FRAMES
    times = np.linspace(plan.start, max(plan.stop, plan.start + 1e-3), n_frames)
    phase = 2 * np.pi * np.arange(n_frames) / FRAMES
    for k, stick in enumerate(sticks(units)):
        amplitude = _amplitude(mode.shape, stick)
        path = f"{shape_path(number)}/{k}"
        _log_still(path, stick, recording, plan, size=np.abs(amplitude), names=[names[i] for i in stick.outputs])
        moving = np.repeat(stick.rest[np.newaxis], n_frames, axis=0)
        # real at phase 0, so that the first picture shows the shape as the table's numbers give it
        moving[:, :, 2] = deflection(len(plan.shapes)) * np.real(amplitude * np.exp(1j * phase)[:, np.newaxis])
        _log_moving(path, stick, times, moving, recording)


def _amplitude(shape: ComplexArray, stick: Stick) -> ComplexArray:
    """Largest deflection of the stick 1; all sticks turned alike, so that the largest of all starts at its maximum."""
    part = shape[list(stick.outputs)]
    size, largest = np.abs(part).max(), shape[np.abs(shape).argmax()]
    if not size > 0:
        return np.zeros_like(part)
    return np.asarray(part / size * (np.conj(largest) / np.abs(largest)))


def _log_still(
    path: str,
    stick: Stick,
    recording: "rerun.RecordingStream",
    plan: Plan,
    *,
    size: FloatArray,
    names: Sequence[str],
) -> None:
    import rerun as rr

    n = len(stick.outputs)
    texts = [label(name, 14) for name in names]
    reach = np.array([[0.12, 0.0, 0.0]]) if n == 1 else np.zeros((1, 3))
    ends = stick.rest[[0, -1]] + np.concatenate([-reach, reach])
    recording.log(
        f"{path}/rest", rr.LineStrips3D([ends], radii=rr.Radius.ui_points(1.0), colors=GREY), static=True, strict=True
    )
    recording.log(
        f"{path}/sensors",
        rr.Points3D(
            stick.rest,
            radii=rr.Radius.ui_points(2.5),
            colors=GREY,
            labels=texts,
            show_labels=len(plan.shapes) <= NAMED_SHAPES and sum(map(len, texts)) <= NAMED_LETTERS,
        ),
        static=True,
        strict=True,
    )
    lift = np.zeros((n, 3))
    lift[:, 2] = deflection(len(plan.shapes)) * size
    envelope = (
        [stick.rest + lift, stick.rest - lift] if n > 1 else [np.concatenate([stick.rest - lift, stick.rest + lift])]
    )
    recording.log(
        f"{path}/envelope",
        rr.LineStrips3D(envelope, radii=rr.Radius.ui_points(0.8), colors=DIM_BLUE),
        static=True,
        strict=True,
    )


def _log_moving(
    path: str, stick: Stick, times: FloatArray, moving: FloatArray, recording: "rerun.RecordingStream"
) -> None:
    import rerun as rr

    index = [rr.TimeColumn(TIMELINE, duration=times)]
    n_frames, n = moving.shape[:2]
    if n > 1:
        recording.send_columns(f"{path}/line", index, rr.LineStrips3D.columns(strips=moving), strict=True)
        style = rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(3.0), colors=stick.colour)
        recording.log(f"{path}/line", style, static=True, strict=True)
    stems = np.stack([np.broadcast_to(stick.rest, moving.shape), moving], axis=2).reshape(-1, 2, 3)
    columns = rr.LineStrips3D.columns(strips=stems).partition([n] * n_frames)
    recording.send_columns(f"{path}/stems", index, columns, strict=True)
    style = rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(1.2), colors=ORANGE)
    recording.log(f"{path}/stems", style, static=True, strict=True)
    heads = rr.Points3D.columns(positions=moving.reshape(-1, 3)).partition([n] * n_frames)
    recording.send_columns(f"{path}/heads", index, heads, strict=True)
    style = rr.Points3D.from_fields(radii=rr.Radius.ui_points(5.0), colors=ORANGE)
    recording.log(f"{path}/heads", style, static=True, strict=True)
