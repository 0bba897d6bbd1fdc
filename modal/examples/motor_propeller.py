"""A motor with a propeller: from a linear model to the drag that it lacked.

The builder of a quadcopter has the linear model

    J w' = kt u - b w

of a brushless motor: u the voltage that the controller sets [V], w the speed [rad/s]. The inertia J was swung, kt
follows from the speed constant on the label, b (what is lost to the wires and the bearings) is a guess, here 25 % too
low. The real motor turns a propeller, whose torque grows with the square of the speed, and so at full throttle it never
reaches the speed that the model promises, whatever b is put in:

    J w' = kt u - b w - c2 w |w|

It is integrated here by `scipy.integrate.solve_ivp` between the steps of the voltage; nothing of the workflow takes
part. The propeller is turning already when a record starts, and the tachometer has noise of 3 rad/s. Two runs are
fitted, slow and fast, and a third one is held out. One mean speed would not do: about it drag is one more viscous loss.

The torque of a propeller at rest is a fixed share of its thrust, so the square law can be seen in measured thrust and
speed too (`thrust_law`): two staircases of a 10 x 4.7 inch propeller, which are not part of this package and are read
only where their folder is given.

Run `python -m modal.examples.motor_propeller [--measured FOLDER] [-o DIR]`.

References:
    Leishman, Principles of Helicopter Aerodynamics, 2nd ed., Cambridge University Press 2006, section 2.3.

Thrust and speed of a measured propeller: is the law a square?

A staircase holds the command of a motor for 600 samples a step; columns `sample, command, rpm_raw, force_raw`. The
first half of each step is left out as transient. Speed and thrust follow from the raw columns as their author says
(`about.json` beside the files): rpm = raw 780/12; a mass of 0.5 kg on a lever of 88 mm gave the strain gauge v2, none
gave v1, and the motor pulls at 84 mm.

The thrust F = a w^p is fitted by least squares over the steps, p and a free. What the law leaves is mostly drift of the
gauge from step to step, not the noise of one sample, so the interval of p is drawn from what is left.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from modal.discrepancy.diagnosis import diagnose
from modal.discrepancy.results import Diagnosis
from modal.examples.story import options, parameter, shrinking, write_when_asked
from modal.structure.structural_model import StructuralModel
from okid.arrays import FloatArray
from okid.errors import UnreadableFileError
from okid.record import Record

__all__ = [
    "Motor",
    "ThrustLaw",
    "linear_model",
    "main",
    "measured_record",
    "read_staircase",
    "study",
    "summary",
    "thrust_law",
    "thrust_sentences",
]

GRAVITY = 9.81
MASS, MASS_LEVER, MOTOR_LEVER = 0.5, 0.088, 0.084
"""[kg], [m], [m] of the calibration."""
STAIRCASES = {"14.4": "tiger700_14p4V.csv", "15.0": "tiger700_15p0V.csv"}
"""Supply voltage and file."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ThrustLaw:
    """F = a w^p over the steps of one staircase.

    Attributes:
        n_steps: number of steps.
        largest: thrust of the fastest step [N].
        exponent: p.
        exponent_std: its standard deviation, from what the law leaves.
        left: root mean square of what the fitted law leaves [N].
        left_by_square: the same with p = 2 [N].
    """

    n_steps: int
    largest: float
    exponent: float
    exponent_std: float
    left: float
    left_by_square: float


def thrust_law(speeds: FloatArray, thrusts: FloatArray) -> ThrustLaw:
    """Fit F = a w^p by Gauss-Newton from p = 2.

    Args:
        speeds: (n_steps,) positive [rad/s].
        thrusts: (n_steps,) [N].

    Example:
        >>> speeds = np.linspace(100.0, 1000.0, 20)
        >>> law = thrust_law(speeds, 1e-5 * speeds**2.1)
        >>> round(law.exponent, 6), law.left < 1e-9 < law.left_by_square
        (2.1, True)
    """
    ratio = speeds / speeds.max()
    square = ratio**2
    factor, exponent = float(square @ thrusts / (square @ square)), 2.0
    by_square = thrusts - factor * square
    for _ in range(30):
        law = ratio**exponent
        slopes = np.stack([law, factor * law * np.log(ratio)], axis=1)
        step = np.linalg.lstsq(slopes, thrusts - factor * law, rcond=None)[0]
        factor, exponent = factor + float(step[0]), exponent + float(step[1])
    left = thrusts - factor * ratio**exponent
    spread = np.linalg.inv(slopes.T @ slopes) * (left @ left) / (len(thrusts) - 2)
    return ThrustLaw(
        n_steps=len(thrusts),
        largest=float(thrusts[speeds.argmax()]),
        exponent=exponent,
        exponent_std=float(np.sqrt(spread[1, 1])),
        left=float(np.sqrt(np.mean(left**2))),
        left_by_square=float(np.sqrt(np.mean(by_square**2))),
    )


def read_staircase(folder: Path, voltage: str) -> tuple[FloatArray, FloatArray]:
    """Speed [rad/s] and thrust [N] of each step, settled.

    Args:
        folder: with the staircases and `about.json`.
        voltage: of the supply, a key of `STAIRCASES`.

    Raises:
        UnreadableFileError: a file is missing or is not what it should be.
    """
    try:
        about = json.loads((folder / "about.json").read_text(encoding="utf-8"))
        unloaded, loaded = (float(about["tiger700"]["calibration"][voltage][key]) for key in ("v1", "v2"))
        table = np.loadtxt(folder / STAIRCASES[voltage], delimiter=",", skiprows=1, ndmin=2)
        _, command, speed, force = table.T
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise UnreadableFileError(
            f"{folder} does not hold the staircase {STAIRCASES[voltage]} with its calibration in about.json "
            f"({type(error).__name__}); name the folder that does."
        ) from error
    steps = [np.flatnonzero(command == level) for level in np.unique(command)]
    settled = [rows[len(rows) // 2 :] for rows in steps]
    newton = MASS * GRAVITY * MASS_LEVER / MOTOR_LEVER / (loaded - unloaded)
    # single counts of the speed are wrong by thousands: the median does not see them
    speeds = np.array([np.median(speed[rows]) for rows in settled]) * (780 / 12) * (2 * np.pi / 60)
    thrusts = np.array([np.mean(force[rows]) - unloaded for rows in settled]) * newton
    return speeds, thrusts


def thrust_sentences(folder: Path | None) -> Sequence[str]:
    """What the measured staircases say of the square law, a sentence each; or that there are none.

    Args:
        folder: of the staircases, None where there is none.
    """
    if folder is None:
        return ("measured thrust: skipped, no folder of staircases was named (--measured FOLDER).",)
    sentences = []
    for voltage in STAIRCASES:
        try:
            law = thrust_law(*read_staircase(folder, voltage))
        except UnreadableFileError as error:
            return (f"measured thrust: skipped, {error}",)
        sentences.append(
            f"measured thrust at {voltage} V, {law.n_steps} steps up to {law.largest:.1f} N: exponent "
            f"{law.exponent:.2f} +- {1.96 * law.exponent_std:.2f} (95 %); a pure square leaves "
            f"{100 * law.left_by_square / law.largest:.1f} % of the largest thrust, the fitted power "
            f"{100 * law.left / law.largest:.1f} %"
        )
    return sentences


DT = 0.01
"""Time between samples [s]."""
SPEED_NOISE = 3.0
"""Standard deviation of the tachometer [rad/s]; its counts are 6.8 rad/s apart in the measured staircases."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Motor:
    """The truth: a motor of 700 rpm a volt with a wire resistance of 0.15 ohm, and a propeller of 10 inches.

    Attributes:
        inertia: J of rotor and propeller [kg m^2].
        torque: kt, torque at standstill for one volt [N m/V].
        loss: b, torque lost for one rad/s [N m s/rad].
        drag: c2 of the propeller [N m s^2/rad^2].
    """

    inertia: float = 8e-5
    torque: float = 0.0909
    loss: float = 1.24e-3
    drag: float = 2.4e-7

    def acceleration(self, speed: float, voltage: float) -> float:
        """Angular acceleration [rad/s^2] at a speed [rad/s] and a voltage [V]."""
        return (self.torque * voltage - self.loss * speed - self.drag * speed * abs(speed)) / self.inertia


def linear_model(motor: Motor) -> StructuralModel:
    """What the builder believes: no propeller torque, and a loss that is 25 % too low.

    Example:
        >>> print(linear_model(Motor()).equations())
        Equations of motion; x0 [rad], forces [N m], ' is d/dt [1/s]
          DOF 0: 8e-05 x0'' + 0.00093 x0' = 0.0909 voltage
          speed [rad/s] = x0'
    """
    return StructuralModel(
        np.array([[motor.inertia]]),
        np.array([[0.75 * motor.loss]]),
        np.array([[0.0]]),
        force_map=np.array([[motor.torque]]),
        sensor_map=np.array([[1.0]]),
        sensor_kind=("velocity",),
        input_names=("voltage",),
        output_names=("speed",),
        input_units=("V",),
        length_unit="rad",
        force_unit="N m",
    )


def measured_record(
    motor: Motor, rng: np.random.Generator, *, voltages: tuple[float, float], name: str, n_samples: int = 1500
) -> Record:
    """One run: the voltage jumps between random values and stays there for 0.1 to 0.6 s.

    Args:
        motor: the truth.
        rng: where voltages, start and noise come from.
        voltages: lowest and highest [V].
        name: of the record.
        n_samples: 100 a second.

    Example:
        >>> measured_record(Motor(), np.random.default_rng(1), voltages=(1.0, 4.0), name="slow", n_samples=200)
        Record('slow': 200 samples every 0.01 s, inputs ['voltage'], outputs ['speed'])
    """
    from scipy.integrate import solve_ivp

    inputs, outputs = np.empty(n_samples), np.empty(n_samples)
    speed, start = rng.uniform(50.0, 250.0), 0
    while start < n_samples:
        stop = min(start + int(rng.integers(10, 60)), n_samples)
        inputs[start:stop] = rng.uniform(*voltages)
        times = DT * np.arange(stop - start + 1)
        held = inputs[start]
        run = solve_ivp(
            lambda _, w, u=held: [motor.acceleration(w[0], u)],
            (0.0, times[-1]),
            [speed],
            t_eval=times,
            rtol=1e-9,
            atol=1e-9,
        )
        outputs[start:stop], speed = run.y[0, :-1], run.y[0, -1]
        start = stop
    return Record(
        inputs,
        outputs + SPEED_NOISE * rng.standard_normal(n_samples),
        DT,
        input_names=("voltage",),
        output_names=("speed",),
        input_units=("V",),
        output_units=("rad/s",),
        name=name,
    )


def study(motor: Motor, rng: np.random.Generator) -> Diagnosis:
    """Two runs to fit and one that is held out, against the linear model.

    Args:
        motor: the truth.
        rng: where the records come from.
    """
    slow = measured_record(motor, rng, voltages=(1.0, 4.0), name="slow")
    fast = measured_record(motor, rng, voltages=(3.0, 12.0), name="fast")
    middle = measured_record(motor, rng, voltages=(2.0, 8.0), name="middle")
    return diagnose(linear_model(motor), fit=[slow, fast], held_out=middle)


def summary(motor: Motor, diagnosis: Diagnosis) -> str:
    """What was found, beside what was hidden.

    Args:
        motor: the truth.
        diagnosis: of `study`.
    """
    lines = [diagnosis.verdict, shrinking(diagnosis)]
    if any(finding.effect == "quadratic_drag" for finding in diagnosis.findings):
        drag, drag_std = parameter(diagnosis, "quadratic_drag", "c2")
        loss = diagnosis.calibrated[0]
        found, given, hidden = (
            _top_speed(motor.torque, *pair)
            for pair in ((loss.value, drag), (loss.nominal, 0.0), (motor.loss, motor.drag))
        )
        rows = (
            ("c2 [1e-7 N m s^2/rad^2]", 1e7 * drag, 1e7 * drag_std, 0.0, 1e7 * motor.drag),
            ("b  [1e-3 N m s/rad]", 1e3 * loss.value, 1e3 * loss.std, 1e3 * loss.nominal, 1e3 * motor.loss),
        )
        lines += [
            f"{name:<24} found {value:.4f} +- {std:.4f}, given {start:.4f}, hidden {truth:.4f}"
            for name, value, std, start, truth in rows
        ]
        lines.append(f"speed at 12 V [rad/s]    found {found:.0f}, given {given:.0f}, hidden {hidden:.0f}")
    return "\n".join(lines)


def _top_speed(torque: float, loss: float, drag: float) -> float:
    """Steady speed [rad/s] at 12 V: the positive root of kt u = b w + c2 w^2, in a form that allows c2 = 0."""
    driven = 12.0 * torque
    return float(2 * driven / (loss + np.sqrt(loss**2 + 4 * drag * driven)))


def main(arguments: Sequence[str] | None = None) -> int:
    """Tell the story; write the report and the recording where that is asked for.

    Args:
        arguments: of the command line, its own unless given.

    Returns:
        0 when an effect was named, 1 otherwise.
    """
    parser = options("modal.examples.motor_propeller", "A linear motor model and the propeller drag that it lacks.")
    parser.add_argument("--measured", type=Path, metavar="FOLDER", help="of the measured thrust and speed staircases")
    given = parser.parse_args(arguments)
    motor = Motor()
    diagnosis = study(motor, np.random.default_rng(given.seed))
    print(summary(motor, diagnosis))
    for line in [*thrust_sentences(given.measured), *write_when_asked(diagnosis, given.output)]:
        print(line)
    return 0 if diagnosis.status == "named" else 1


if __name__ == "__main__":
    raise SystemExit(main())
