"""A measured swing: from the file of a pendulum that dies away to what its bearing does.

An arm is lifted and let go, an angle is measured until it stands still, nothing else is known. The textbook says

    x'' + 2 z w x' + w^2 x = 0,

and the peaks then fall by the same share each half cycle. Dry friction takes the same *amount* each half cycle, so
that the peaks fall along a line and the arm stops away from where it would hang. A person with a ruler tells them
apart by the peaks: here this is `read_peaks`, with damping, friction or both. But peaks know nothing of what happens
between them, and the last ones of a bearing that creeps before it slides lie on neither: so
`modal.discrepancy.diagnose` compares the whole motion with the laws of the catalogue, on quarters of the swing that the
fit has not seen, down to a tenth of the first peak.

No torque is measured, so the inertia is 1 here, and a torque is told as the angle at which gravity makes it.

Run `python -m modal.examples.measured_pendulum FILE [FILE ...] --outputs NAME [-o DIR]`.

References:
    Den Hartog, Mechanical Vibrations, 4th ed., 1956, section 8.6 (peaks under dry friction).
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import scipy

from modal.discrepancy.diagnosis import diagnose
from modal.discrepancy.noise.spectral import FEWEST_ROWS
from modal.discrepancy.results import Diagnosis
from modal.effects.catalogue import CATALOGUE
from modal.examples.story import print_written, shrinking
from modal.report.writing import write_report
from modal.structure.structural_model import StructuralModel
from okid.arrays import FloatArray
from okid.errors import IdentificationError, InsufficientDataError
from okid.readers import read_record
from okid.record import Record

OF_A_PENDULUM = (
    "coulomb_friction", "stribeck_friction", "bouc_wen_hysteresis", "quadratic_drag", "smooth_damping",
    "sine_softening", "cubic_stiffness", "smooth_stiffness", "constant_force", "sensor_bias",
)  # fmt: skip
"""What a pendulum may have besides."""
A_CYCLE = 60
"""Rows of a cycle to keep: more tell little and take longer."""
SMALLEST = 0.1
"""Look at no swings below this share of the first: there a bearing creeps, or nothing moves."""
FEWEST_PEAKS = 5
"""Of a swing, to tell one law of its peaks from another."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Peaks:
    """Three laws of the peaks c +- A of a swing, A(n+1) = (A(n) - f) q - f, and what each leaves.

    Attributes:
        n_peaks: how many there are.
        left: rms of the peaks from the law with q alone, f alone, both [unit of the angle].
        friction: f of both, dry friction as the angle at which gravity makes as much.
        damping_ratio: z of both, with q = exp(-pi z / sqrt(1 - z^2)).
    """

    n_peaks: int
    left: tuple[float, float, float]
    friction: float
    damping_ratio: float


def swing_record(path: Path, *, angle: str) -> Record:
    """One file from its first turn to where it stands still, about where it then hangs."""
    record = read_record(path, inputs=[], outputs=[angle])
    seen = record.outputs[:, 0]
    there = np.flatnonzero(np.isfinite(seen))
    moves = np.flatnonzero(np.diff(seen[there]) != 0.0)
    if not len(moves):
        raise InsufficientDataError(f"{path.name}: {angle} never moves; give the file of a swing.")
    last = moves[-1] + 1  # it stands where it comes to
    rest = seen[there[last + 1 :]]
    level = np.median(rest) if len(rest) else np.mean(seen[there])
    return replace(record, outputs=record.outputs - level).samples(0, int(there[last]) + 1)


def turns(record: Record) -> tuple[FloatArray, FloatArray]:
    """(n,) times [s] and angles of the turning points, each by a parabola through the rows about the largest angle.

    The largest is the first: before it the arm was held or lifted. Across missing rows it runs straight.
    """
    seen, dt, there = record.outputs[:, 0], record.dt, np.isfinite(record.outputs[:, 0])
    seen = np.interp(np.arange(len(seen)), np.flatnonzero(there), seen[there])
    crossed = np.flatnonzero(np.signbit(seen[:-1]) != np.signbit(seen[1:]))
    times, angles = [], []
    for begin, end in pairwise(crossed.tolist()):
        top = begin + 1 + int(np.argmax(np.abs(seen[begin + 1 : end + 1])))
        reach = max(1, (end - begin) // 8)
        if top - reach < 0 or top + reach >= len(seen):
            continue
        offsets = np.arange(-reach, reach + 1)
        a, b, c = np.polyfit(offsets, seen[top - reach : top + reach + 1], 2).tolist()
        at = float(np.clip(-b / (2 * a), -reach, reach)) if a else 0.0
        times.append((top + at) * dt)
        angles.append(float((a * at + b) * at + c))
    first = int(np.argmax(np.abs(angles))) if angles else 0
    return np.array(times[first:]), np.array(angles[first:])


def read_peaks(angles: FloatArray) -> Peaks:
    """What a ruler reads from the sizes of the turning points.

    Raises:
        InsufficientDataError: fewer than `FEWEST_PEAKS`.

    Example:
        >>> sizes = [0.1]
        >>> for _ in range(9):
        ...     sizes.append((sizes[-1] - 0.002) * 0.97 - 0.002)
        >>> found = read_peaks(np.array(sizes) * (-1.0) ** np.arange(10))
        >>> round(found.friction, 6), found.left[2] < 1e-7 < found.left[0]
        (0.002, True)
    """
    large = np.flatnonzero(np.abs(angles) > SMALLEST * np.abs(angles).max(initial=0.0))
    angles = angles[: large.max(initial=-1) + 1]
    if len(angles) < FEWEST_PEAKS:
        raise InsufficientDataError(
            f"the swing turns {len(angles)} times above a tenth of its size, and {FEWEST_PEAKS} are needed to tell "
            "friction from damping; give a file that begins at a larger angle."
        )
    largest = float(np.abs(angles).max())
    angles = angles / largest
    ways, first = np.sign(angles), float(np.abs(angles[0]))

    def left(some: FloatArray, chosen: list[int]) -> FloatArray:
        """Of start, centre, friction and share kept, some are free."""
        values = np.array([first, 0.0, 0.0, 1.0])
        values[chosen] = some
        size, centre, friction, kept = values.tolist()
        course = []
        for way in ways:
            course.append(centre + way * size)
            size = max(0.0, (size - friction) * kept - friction)
        return np.array(course) - angles

    start = np.array([first, 0.0, 0.25 * max(0.0, first - abs(angles[-1])) / len(angles), 0.99])
    low, high = np.array([0.0, -first, 0.0, 0.1]), np.array([np.inf, first, first, 1.0])
    scale = np.array([first, 0.1 * first, 0.1 * first, 0.1])
    fits = []
    for chosen in ([0, 1, 3], [0, 1, 2], [0, 1, 2, 3]):
        fit = scipy.optimize.least_squares(
            left, start[chosen], bounds=(low[chosen], high[chosen]), x_scale=scale[chosen], xtol=1e-12, args=(chosen,)
        )
        fits.append((float(np.sqrt(np.mean(fit.fun**2))), fit.x))
    _, _, friction, kept = fits[2][1]
    loss = -np.log(kept) / np.pi
    return Peaks(
        n_peaks=len(angles),
        left=(fits[0][0] * largest, fits[1][0] * largest, fits[2][0] * largest),
        friction=float(friction * largest),
        damping_ratio=float(loss / np.hypot(1.0, loss)),
    )


def small_swings(record: Record, *, angular: float, damping_ratio: float) -> StructuralModel:
    """The textbook's pendulum of small angles, with an inertia of 1."""
    return StructuralModel(
        np.array([[1.0]]),
        np.array([[2.0 * damping_ratio * angular]]),
        np.array([[angular**2]]),
        force_map=np.zeros((1, 0)),
        sensor_map=np.array([[1.0]]),
        sensor_kind="displacement",
        output_names=record.output_names,
        length_unit="rad",
        force_unit="N m",
    )


def quarters(record: Record, period: float) -> tuple[list[Record], list[Record]]:
    """What is fitted, the first and third quarter, and what is held out, some sixty rows a cycle."""
    step = max(1, min(int(period / (A_CYCLE * record.dt)), record.n_samples // (4 * FEWEST_ROWS)))
    thin = replace(record, inputs=record.inputs[::step], outputs=record.outputs[::step], dt=record.dt * step)
    cuts = [round(k * thin.n_samples / 4) for k in range(5)]
    parts = [thin.samples(begin, end) for begin, end in pairwise(cuts)]
    return parts[::2], parts[1::2]


def study(records: Sequence[Record]) -> tuple[list[Peaks], Diagnosis]:
    """The peaks of each swing, and what the textbook's pendulum lacks.

    Raises:
        InsufficientDataError: a swing with fewer than `FEWEST_PEAKS`, or too few rows.
    """
    read, periods, swings = [], [], []
    for record in records:
        times, angles = turns(record)
        read.append(read_peaks(angles))
        periods.append(2.0 * float(np.median(np.diff(times[: read[-1].n_peaks]))))
        begin, end = (int(times[k] / record.dt) for k in (0, read[-1].n_peaks - 1))
        if end - begin < 4 * FEWEST_ROWS:
            raise InsufficientDataError(
                f"the swing has {end - begin} rows from its first turn down to a tenth of its size, and "
                f"{4 * FEWEST_ROWS} are needed, {FEWEST_ROWS} in each quarter; sample it faster."
            )
        swings.append(record.samples(begin, end + 1))
    period = float(np.median(periods))
    fits, helds = zip(*(quarters(swing, period) for swing in swings), strict=True)
    ratio = max(float(np.median([one.damping_ratio for one in read])), 1e-3)
    model = small_swings(records[0], angular=2 * np.pi / period, damping_ratio=ratio)
    catalogue = {key: CATALOGUE[key] for key in OF_A_PENDULUM}
    return read, diagnose(
        model, [part for own in fits for part in own], [part for own in helds for part in own], catalogue=catalogue
    )


def summary(read: Sequence[Peaks], diagnosis: Diagnosis, unit: str) -> str:
    """What the peaks say, what the whole motion says, and what nobody can tell from a swing."""
    lines = [diagnosis.verdict, shrinking(diagnosis)]
    stiffness = diagnosis.calibrated[0].value
    lines.append(f"frequency           {np.sqrt(stiffness) / (2 * np.pi):.4f} Hz, of small swings that slide")
    for finding in diagnosis.findings:
        values = {one.name: (one.value, one.std) for one in finding.parameters}
        if finding.effect in ("coulomb_friction", "stribeck_friction"):
            value, deviation = values["Fc"]
            lines.append(
                f"friction            {value / stiffness:.3g} +- {deviation / stiffness:.2g} {unit} of gravity"
            )
        elif finding.effect == "bouc_wen_hysteresis":
            creep, deviation = values["yield_displacement"]
            lines.append(f"friction            {values['a'][0] * creep / stiffness:.3g} {unit} of gravity")
            size = f"{creep:.2g} +- {deviation:.2g} {unit}"
            held = "over which it holds as a spring" if deviation < creep else "which swings of this size do not fix"
            lines.append(f"creeps before       {size}, {held}")
    for number, one in enumerate(read, start=1):
        alone, dry, both = one.left
        lines.append(
            f"by hand, swing {number}    {one.n_peaks} peaks: damping alone leaves {alone:.2g} {unit}, friction alone "
            f"{dry:.2g}, both {both:.2g} (friction {one.friction:.3g} {unit} of gravity)"
        )
    lines.append("not in these records: inertia, length and mass one by one, for no torque was measured")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Tell what the files say.

    Returns:
        0 when an effect was named, 1 when none was, 2 where a file cannot be used.
    """
    parser = argparse.ArgumentParser(description="A measured swing: damping, dry friction, and what creeps before it.")
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE", help="swings of one pendulum")
    parser.add_argument("--outputs", required=True, metavar="NAME", help="column of the angle")
    parser.add_argument("-o", "--folder", type=Path, metavar="DIR", help="write the report and the recording into DIR")
    given = parser.parse_args(arguments)
    try:
        records = [swing_record(path, angle=given.outputs) for path in given.files]
        read, diagnosis = study(records)
    except (IdentificationError, OSError) as error:
        print(f"{error}")
        return 2
    print(summary(read, diagnosis, records[0].output_units[0] or "rad"))
    if given.folder is not None:
        print_written(lambda: write_report(diagnosis, given.folder))
    return 0 if diagnosis.status == "named" else 1


if __name__ == "__main__":
    raise SystemExit(main())
