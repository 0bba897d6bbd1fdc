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

Run `python -m modal.examples.motor_propeller [-o DIR]`.

References:
    Leishman, Principles of Helicopter Aerodynamics, 2nd ed., Cambridge University Press 2006, section 2.3.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modal.discrepancy.diagnosis import diagnose
from modal.discrepancy.results import Diagnosis
from modal.examples.story import parameter, shrinking, tell
from modal.structure.structural_model import StructuralModel
from okid.record import Record


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Motor:
    """The truth: a motor of 700 rpm a volt with a wire resistance of 0.15 ohm, and a propeller of 10 inches.

    Attributes:
        inertia: J of rotor and propeller [kg m^2].
        torque: kt, torque at standstill for one volt [N m/V].
        loss: b, torque lost for one rad/s [N m s/rad].
        drag: c2 of the propeller [N m s^2/rad^2].
        noise: standard deviation of the tachometer [rad/s].
        dt: time between samples [s].
    """

    inertia: float = 8e-5
    torque: float = 0.0909
    loss: float = 1.24e-3
    drag: float = 2.4e-7
    noise: float = 3
    dt: float = 0.01

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
    speed, start = rng.uniform(50, 250), 0
    while start < n_samples:
        stop = min(start + int(rng.integers(10, 60)), n_samples)
        inputs[start:stop] = rng.uniform(*voltages)
        times = motor.dt * np.arange(stop - start + 1)
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
        outputs + motor.noise * rng.standard_normal(n_samples),
        motor.dt,
        input_names=("voltage",),
        output_names=("speed",),
        input_units=("V",),
        output_units=("rad/s",),
        name=name,
    )


def study(motor: Motor, rng: np.random.Generator) -> Diagnosis:
    """Two runs to fit and one that is held out, against the linear model."""
    slow = measured_record(motor, rng, voltages=(1, 4), name="slow")
    fast = measured_record(motor, rng, voltages=(3, 12), name="fast")
    middle = measured_record(motor, rng, voltages=(2, 8), name="middle")
    return diagnose(linear_model(motor), fit=[slow, fast], held_out=middle)


def summary(motor: Motor, diagnosis: Diagnosis) -> str:
    """What was found, beside what was hidden."""
    lines = [diagnosis.verdict, shrinking(diagnosis)]
    if any(finding.effect == "quadratic_drag" for finding in diagnosis.findings):
        drag, drag_std = parameter(diagnosis, "quadratic_drag", "c2")
        loss = diagnosis.calibrated[0]
        found, given, hidden = (
            _top_speed(motor.torque, *pair)
            for pair in ((loss.value, drag), (loss.nominal, 0.0), (motor.loss, motor.drag))
        )
        rows = (
            ("c2 [1e-7 N m s^2/rad^2]", 1e7, (drag, drag_std, 0.0, motor.drag)),
            ("b  [1e-3 N m s/rad]", 1e3, (loss.value, loss.std, loss.nominal, motor.loss)),
        )
        for name, scale, values in rows:
            value, std, start, truth = (scale * number for number in values)
            lines.append(f"{name:<24} found {value:.4f} +- {std:.4f}, given {start:.4f}, hidden {truth:.4f}")
        lines.append(f"speed at 12 V [rad/s]    found {found:.0f}, given {given:.0f}, hidden {hidden:.0f}")
    return "\n".join(lines)


def _top_speed(torque: float, loss: float, drag: float) -> float:
    """Steady speed [rad/s] at 12 V: the positive root of kt u = b w + c2 w^2, in a form that allows c2 = 0."""
    driven = 12 * torque
    return float(2 * driven / (loss + np.sqrt(loss**2 + 4 * drag * driven)))


def main(arguments: Sequence[str] | None = None) -> int:
    """Tell the story; arguments and exit status as in `modal.examples.story.tell`."""
    motor = Motor()
    return tell(
        "A linear motor model and the propeller drag that it lacks.",
        arguments,
        study=lambda rng: study(motor, rng),
        summary=lambda diagnosis: summary(motor, diagnosis),
    )


if __name__ == "__main__":
    raise SystemExit(main())
