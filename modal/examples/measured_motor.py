"""A measured motor: from the file of a test bench to friction, delay and time constant.

A voltage (a duty, a throttle) goes in, the speed is measured, nothing else is known. A first-order model

    J w' = kt u - b w

is what most people fit, and about one working point it fits well, whatever else goes on. Over several it does not: a
straight line through the steady speeds misses the origin, because the bearings and brushes take some of the voltage
before anything turns. Here `modal.identify` gives the time constant J/b, a straight line the gain kt/b, and
`modal.discrepancy.diagnose` says what such a motor lacks, on halves of the records that the fit has not seen.

No torque is measured, so J, kt and b are known up to a factor: J is 1 here, and a torque is told as the voltage that
makes it. An encoder that counts between two samples shows the mean speed over the last one, not the speed now. The
mean of what follows a held voltage is what follows the mean voltage, and that runs by lines from sample to sample:
`--counts` takes it so.

Run `python -m modal.examples.measured_motor FILE [FILE ...] --inputs NAME --outputs NAME [--counts] [-o DIR]`.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from modal.discrepancy.diagnosis import diagnose
from modal.discrepancy.results import Diagnosis, Finding
from modal.effects.catalogue import CATALOGUE
from modal.examples.story import print_written, shrinking
from modal.identification.pipeline import identify
from modal.report.writing import write_report
from modal.structure.given import simulate
from modal.structure.structural_model import StructuralModel
from okid.arrays import FloatArray
from okid.errors import IdentificationError, InsufficientDataError
from okid.readers import read_record
from okid.record import Record

OF_A_MOTOR = (
    "coulomb_friction", "stribeck_friction", "constant_force", "quadratic_drag", "smooth_damping", "input_delay",
    "actuator_lag", "sensor_lag", "input_saturation", "input_gain",
)  # fmt: skip
"""What a motor may have besides. An encoder has no zero that moves."""
SETTLED = 5.0
"""Read a steady speed after so many time constants, when less than a hundredth of the step is left."""
STALLED = 0.01
"""Take a speed below this share of the largest one for none."""
MOST_ROWS = 500
"""Of a half of a record: more rows tell little more and take longer."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FirstOrder:
    """rate w' = rate (gain u - w) + ...

    Attributes:
        rate: b/J, one over the time constant [1/s].
        gain: kt/b, speed for one unit of the input.
    """

    rate: float
    gain: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ByHand:
    """The straight line through the steady speeds, speed = gain (u - dead).

    Attributes:
        gain: speed for one unit of the input.
        dead: input that turns nothing yet.
        n_speeds: how many steady speeds there are.
    """

    gain: float
    dead: float
    n_speeds: int


def motor_record(path: Path, *, drive: str, speed: str, counts: bool = False) -> Record:
    """One file, its input held from sample to sample, or, of counts, its mean over the last sample by lines."""
    record = read_record(path, inputs=[drive], outputs=[speed], input_hold="zero_order")
    if not counts:
        return record
    return replace(record, inputs=np.vstack([record.inputs[:1], record.inputs[:-1]]), input_hold="linear")


def halves(record: Record) -> tuple[Record, Record]:
    """What is fitted and what is held out."""
    middle = record.n_samples // 2
    n_rows = min(MOST_ROWS, middle)
    return record.samples(0, n_rows), record.samples(middle, middle + n_rows)


def first_order(records: Sequence[Record]) -> FirstOrder:
    """Time constant and gain about the working points of the records.

    Raises:
        InsufficientDataError: the records show no motion that dies away by itself.
    """
    found = identify(list(records))
    rates = [-mode.pole.real for mode in found.modes.modes if mode.kind == "real" and mode.verdict == "system"]
    if not rates:
        raise InsufficientDataError(
            f"{len(records)} records show no speed that settles by itself, so there is no first-order model to start "
            "from; give files in which the input jumps and the speed follows it"
        )
    rate, tops, bottoms = min(rates), [], []
    for record in records:
        unit = structural_model(FirstOrder(rate=rate, gain=1.0), record)
        followed = _followed(unit, record)
        tops.append(record.outputs[:, 0] - np.nanmean(record.outputs[:, 0]))
        bottoms.append(followed - followed.mean())
    bottom, top = np.concatenate(bottoms), np.concatenate(tops)
    there = np.isfinite(top)
    bottom, top = bottom[there], top[there]
    return FirstOrder(rate=rate, gain=float(bottom @ top / (bottom @ bottom)))


def _followed(model: StructuralModel, record: Record) -> FloatArray:
    start = float(record.inputs[0, 0])  # steady there: a first-order model forgets it anyhow
    return simulate(model, record, initial_state=[start]).outputs[:, 0]


def structural_model(motor: FirstOrder, record: Record) -> StructuralModel:
    """The same as a shaft of inertia 1.

    Example:
        >>> record = Record([0.0, 1.0], [0.0, 0.5], 0.02, input_names=["u"], output_names=["speed"], input_units=["V"])
        >>> print(structural_model(FirstOrder(rate=20.0, gain=3.0), record).equations())
        Equations of motion; x0 [rad], forces [N m], ' is d/dt [1/s]
          DOF 0: x0'' + 20 x0' = 60 u
          speed [rad/s] = x0'
    """
    return StructuralModel(
        np.array([[1.0]]),
        np.array([[motor.rate]]),
        np.array([[0.0]]),
        force_map=np.array([[motor.rate * motor.gain]]),
        sensor_map=np.array([[1.0]]),
        sensor_kind=("velocity",),
        input_names=record.input_names,
        output_names=record.output_names,
        input_units=record.input_units,
        length_unit="rad",
        force_unit="N m",
    )


def by_hand(records: Sequence[Record], motor: FirstOrder) -> ByHand | None:
    """The line through the steady speeds, the same loss on both sides of zero; None where there are not two.

    Example:
        >>> volts, turns = np.repeat([-2.0, -1.0, 0.1, 1.0, 2.0], 20), np.repeat([-3.0, -1.0, 0.0, 1.0, 3.0], 20)
        >>> line = by_hand([Record(volts, turns, 0.1)], FirstOrder(rate=5.0, gain=2.0))
        >>> round(line.gain, 6), round(line.dead, 6), line.n_speeds
        (2.0, 0.5, 4)
    """
    levels: dict[float, list[float]] = {}
    for record in records:
        wait = int(np.ceil(SETTLED / (motor.rate * record.dt)))
        drive, speed = record.inputs[:, 0], record.outputs[:, 0]
        for row in range(wait, record.n_samples):
            if np.ptp(drive[row - wait : row + 1]) == 0.0 and np.isfinite(speed[row]):
                levels.setdefault(float(drive[row]), []).append(float(speed[row]))
    drives, speeds = np.array(list(levels)), np.array([np.mean(speeds) for speeds in levels.values()])
    turns = np.abs(speeds) > STALLED * np.abs(speeds).max(initial=0.0)
    drives, speeds = drives[turns], speeds[turns]
    if len(speeds) < 2:
        return None
    gain, lost = np.linalg.lstsq(np.column_stack([drives, -np.sign(speeds)]), speeds, rcond=None)[0]
    return ByHand(gain=float(gain), dead=float(lost / gain), n_speeds=len(speeds))


def study(records: Sequence[Record]) -> tuple[FirstOrder, Diagnosis]:
    """The first-order model of the first halves, and what it lacks on the second ones."""
    fits, helds = zip(*(halves(record) for record in records), strict=True)
    motor = first_order(fits)
    catalogue = {key: CATALOGUE[key] for key in OF_A_MOTOR}
    return motor, diagnose(structural_model(motor, records[0]), fits, helds, catalogue=catalogue)


def summary(motor: FirstOrder, diagnosis: Diagnosis, hand: ByHand | None, unit: str) -> str:
    """What was found, what a reading by hand gives, and what nobody can tell from such records."""
    rate = diagnosis.calibrated[0].value
    lines = [
        diagnosis.verdict,
        shrinking(diagnosis),
        f"time constant J/b   {1e3 / rate:.2f} ms",
        *lost_in_words(diagnosis.findings, motor, unit),
    ]
    if hand is not None:
        dead = f"{hand.dead:.4f} {unit}".rstrip()
        lines.append(f"by hand             {dead}, from the line through {hand.n_speeds} steady speeds")
    lines.append("not in these records: J, kt and b one by one, for no torque was measured")
    speeds = np.concatenate([record.outputs[:, 0] for record in (*diagnosis.fit, *diagnosis.held_out)])
    if np.nanmin(speeds) >= 0.0 or np.nanmax(speeds) <= 0.0:
        lines.append("nor whether what is lost would turn round with the motor, which always turned one way")
    return "\n".join(lines)


def lost_in_words(findings: Sequence[Finding], motor: FirstOrder, unit: str) -> list[str]:
    """Friction, constant loss and delay, a line each; torques as the voltage that makes them."""
    torque, lines = motor.rate * motor.gain, []
    for finding in findings:
        if finding.effect == "input_gain":
            torque *= finding.parameters[0].value
    for finding in findings:
        values = {one.name: (one.value, one.std) for one in finding.parameters}
        if finding.effect in ("coulomb_friction", "constant_force"):
            value, deviation = values["Fc" if finding.effect == "coulomb_friction" else "offset"]
            word = "friction" if finding.effect == "coulomb_friction" else "constant loss"
            size = f"{value / torque:.4f} +- {deviation / torque:.4f} {unit}".rstrip()
            told = "lost before it turns" if deviation < abs(value) else "which these records do not fix"
            lines.append(f"{word:<19} {size}, {told}")
        elif finding.effect == "input_delay":
            value, deviation = values["tau"]
            lines.append(f"delay               {1e3 * value:.2f} +- {1e3 * deviation:.2f} ms")
    return lines


def main(arguments: Sequence[str] | None = None) -> int:
    """Tell what the files say.

    Returns:
        0 when an effect was named, 1 when none was, 2 where a file cannot be used.
    """
    parser = argparse.ArgumentParser(description="A measured motor: its friction, its delay, its time constant.")
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE", help="records of one motor")
    parser.add_argument("--inputs", required=True, metavar="NAME", help="column of the voltage, duty or throttle")
    parser.add_argument("--outputs", required=True, metavar="NAME", help="column of the speed")
    parser.add_argument("--counts", action="store_true", help="the speed is counted between two samples")
    parser.add_argument("-o", "--folder", type=Path, metavar="DIR", help="write the report and the recording into DIR")
    given = parser.parse_args(arguments)
    try:
        records = [
            motor_record(path, drive=given.inputs, speed=given.outputs, counts=given.counts) for path in given.files
        ]
        motor, diagnosis = study(records)
    except (IdentificationError, OSError) as error:
        print(f"{error}")
        return 2
    print(summary(motor, diagnosis, by_hand(records, motor), records[0].input_units[0]))
    if given.folder is not None:
        print_written(lambda: write_report(diagnosis, given.folder))
    return 0 if diagnosis.status == "named" else 1


if __name__ == "__main__":
    raise SystemExit(main())
