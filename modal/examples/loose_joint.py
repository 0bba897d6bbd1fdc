"""A three-storey frame with a loose joint, found from the accelerations of its floors.

The engineer has a linear model of the frame: three floors, three storeys, every joint tight. In the second storey a
brace that carries half of the stiffness is bolted with play: up to 1 mm either way it does nothing, beyond that it
takes up the load at once. At low level the frame is softer than the model, at high level almost as stiff, and no linear
model fits both:

    M x'' + C x' + sum over storeys b_e k_e (b_e' x) = F + b_2 k_brace clip(b_2' x, -play, play)

A shaker pushes the top floor with random forces (0.5 to 25 Hz, three levels to fit and a fourth one held out), three
accelerometers with noise of 0.02 m/s^2 look on, and nobody measured how the frame was moving when a record started.
The model's stiffnesses are 3 to 4 % off and its dampings 10 to 20 %. The motion is integrated by
`scipy.integrate.solve_ivp` with the sharp contact as it stands above; nothing of the workflow takes part.

Accelerometers see no play: they see the floors' answer to the forces that the brace does not carry. The workflow tries
every effect of the catalogue in every storey and names the one whose simulated answer closes the gap on a record that
it was not fitted to.

Run `python -m modal.examples.loose_joint [-o DIR]`.

References:
    Shaw and Holmes, "A periodically forced piecewise linear oscillator", Journal of Sound and Vibration 90(1), 1983,
    doi 10.1016/0022-460X(83)90407-8.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from modal.discrepancy.diagnosis import diagnose
from modal.discrepancy.results import Diagnosis
from modal.examples.story import options, parameter, shrinking, write_when_asked
from modal.structure.elements import Element
from modal.structure.structural_model import StructuralModel
from okid.arrays import FloatArray
from okid.record import Record

__all__ = ["Frame", "linear_model", "main", "measured_record", "study", "summary"]

DT = 1 / 256
"""Time between samples [s]."""
BAND, N_LINES = (0.5, 25.0), 120
"""Of the shaker [Hz], and the number of sines that make its random force."""
ACCELEROMETER_NOISE = 0.02
"""Standard deviation [m/s^2]."""
STOREYS = ("storey_1", "storey_2", "storey_3")
FLOORS = ("floor_1", "floor_2", "floor_3")
TOP = 2
ACROSS = np.eye(3) - np.diag(np.ones(2), -1)
"""Row e: motion of floor e against the one below it, from the motion of the floors."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Frame:
    """The truth, a frame of about two metres.

    Attributes:
        masses: of the floors [kg].
        stiffnesses: of the storeys with the brace engaged [N/m].
        dampings: of the storeys [N s/m].
        loose: number of the storey with the loose joint, from 0.
        brace: stiffness of its brace [N/m].
        play: of the joint, either way [m].
    """

    masses: tuple[float, ...] = (25.0, 25.0, 20.0)
    stiffnesses: tuple[float, ...] = (60e3, 60e3, 60e3)
    dampings: tuple[float, ...] = (25.0, 22.0, 20.0)
    loose: int = 1
    brace: float = 30e3
    play: float = 1e-3

    def acceleration(self, displacement: FloatArray, velocity: FloatArray, force: float) -> FloatArray:
        """(3,) accelerations of the floors [m/s^2] under a force on the top floor."""
        across = ACROSS @ displacement
        carried = np.array(self.stiffnesses) * across + np.array(self.dampings) * (ACROSS @ velocity)
        carried[self.loose] -= self.brace * min(max(across[self.loose], -self.play), self.play)
        loads = -ACROSS.T @ carried
        loads[TOP] += force
        found: FloatArray = loads / np.array(self.masses)
        return found


def linear_model(frame: Frame) -> StructuralModel:
    """What the engineer believes: every joint tight, the masses weighed, stiffness and damping from a drawing.

    Example:
        >>> linear_model(Frame()).natural_frequencies.round(2)
        array([ 3.7 , 10.24, 14.27])
    """
    stiffnesses = np.array(frame.stiffnesses) * [1.04, 0.97, 1.03]
    dampings = np.array(frame.dampings) * [1.2, 0.8, 0.9]
    return StructuralModel(
        np.diag(frame.masses),
        ACROSS.T @ np.diag(dampings) @ ACROSS,
        ACROSS.T @ np.diag(stiffnesses) @ ACROSS,
        force_map=np.eye(3)[:, [TOP]],
        sensor_map=np.eye(3),
        sensor_kind=("acceleration",) * 3,
        elements=tuple(
            Element(name=name, start=max(e - 1, 0), end=e or None, stiffness=float(k), damping=float(c))
            for e, (name, k, c) in enumerate(zip(STOREYS, stiffnesses, dampings, strict=True))
        ),
        input_names=("shaker",),
        output_names=FLOORS,
    )


def measured_record(
    frame: Frame, rng: np.random.Generator, *, level: float, name: str, n_samples: int = 2048
) -> Record:
    """One run of the shaker.

    Args:
        frame: the truth.
        rng: where forces, start and noise come from.
        level: root mean square of the force [N].
        name: of the record.
        n_samples: 256 a second.

    Example:
        >>> measured_record(Frame(), np.random.default_rng(1), level=25.0, name="short", n_samples=64)
        Record('short': 64 samples every 0.00390625 s, inputs ['shaker'], outputs ['floor_1', 'floor_2', 'floor_3'])
    """
    from scipy.integrate import solve_ivp

    shaker, time = _shaker(rng, level), DT * np.arange(n_samples)
    start = level * np.concatenate([1e-5 * rng.standard_normal(3), 5e-4 * rng.standard_normal(3)])
    run = solve_ivp(
        lambda t, s: np.concatenate([s[3:], frame.acceleration(s[:3], s[3:], shaker(t))]),
        (0.0, time[-1]),
        start,
        method="DOP853",
        t_eval=time,
        max_step=DT,
        rtol=1e-8,
        atol=1e-11,
    )
    forces = np.array([shaker(t) for t in time])
    outputs = np.array([frame.acceleration(s[:3], s[3:], f) for s, f in zip(run.y.T, forces, strict=True)])
    return Record(
        forces,
        outputs + ACCELEROMETER_NOISE * rng.standard_normal(outputs.shape),
        DT,
        input_names=("shaker",),
        output_names=FLOORS,
        input_units=("N",),
        output_units=("m/s^2",) * 3,
        input_hold="band_limited",
        name=name,
    )


def _shaker(rng: np.random.Generator, level: float) -> Callable[[float], float]:
    """A random force of the level that is known between the samples too: sines of random frequency and phase."""
    pulses = 2 * np.pi * rng.uniform(*BAND, N_LINES)
    phases = rng.uniform(0.0, 2 * np.pi, N_LINES)
    size = level * np.sqrt(2 / N_LINES)
    return lambda t: float(size * np.sin(pulses * t + phases).sum())


def study(frame: Frame, rng: np.random.Generator, *, n_samples: int = 2048) -> Diagnosis:
    """Three levels to fit and a fourth one held out, against the linear model.

    Args:
        frame: the truth.
        rng: where the records come from.
        n_samples: of each record.
    """
    levels = (("quiet", 8.0), ("medium", 25.0), ("loud", 70.0), ("held out", 45.0))
    *fit, held_out = (
        measured_record(frame, rng, level=level, name=name, n_samples=n_samples) for name, level in levels
    )
    return diagnose(linear_model(frame), fit=fit, held_out=held_out)


def summary(frame: Frame, diagnosis: Diagnosis) -> str:
    """What was found, beside what was hidden.

    Args:
        frame: the truth.
        diagnosis: of `study`.
    """
    lines = [diagnosis.verdict, shrinking(diagnosis)]
    found = [finding for finding in diagnosis.findings if finding.effect == "gap_spring"]
    if found:
        (play, play_std), (inner, inner_std), (outer, _) = (
            parameter(diagnosis, "gap_spring", name) for name in ("gap", "k_in", "k_out")
        )
        storey = next(one for one in diagnosis.calibrated if one.name == f"stiffness of {found[0].where}")
        tight = frame.stiffnesses[frame.loose]
        rows = (
            ("play either way [mm]", 1e3 * play, 1e3 * play_std, 1e3 * frame.play),
            ("stiffness of the brace [kN/m]", (outer - inner) / 1e3, inner_std / 1e3, frame.brace / 1e3),
            ("storey within play [kN/m]", (storey.value + inner) / 1e3, np.nan, (tight - frame.brace) / 1e3),
            ("storey beyond play [kN/m]", (storey.value + outer) / 1e3, storey.std / 1e3, tight / 1e3),
        )
        lines.append(f"loose joint in {found[0].where}, hidden in {STOREYS[frame.loose]}")
        lines += [
            f"  {name:<30} found {value:.4f}{'' if np.isnan(std) else f' +- {std:.4f}'}, hidden {truth:.4f}"
            for name, value, std, truth in rows
        ]
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Tell the story; write the report and the recording where that is asked for.

    Args:
        arguments: of the command line, its own unless given.

    Returns:
        0 when an effect was named, 1 otherwise.
    """
    parser = options("modal.examples.loose_joint", "A frame's loose joint, found from floor accelerations.")
    given = parser.parse_args(arguments)
    frame = Frame()
    diagnosis = study(frame, np.random.default_rng(given.seed))
    print(summary(frame, diagnosis))
    for line in write_when_asked(diagnosis, given.output):
        print(line)
    return 0 if diagnosis.status == "named" else 1


if __name__ == "__main__":
    raise SystemExit(main())
