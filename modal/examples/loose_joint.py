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
from modal.examples.story import parameter, shrinking, tell
from modal.structure.structural_model import StructuralModel
from modal.structure.structural_plant import Element
from okid.arrays import FloatArray
from okid.record import Record

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
        band: of the shaker [Hz].
        n_lines: number of the sines that make its random force.
        noise: standard deviation of the accelerometers [m/s^2].
        dt: time between samples [s].
    """

    masses: tuple[float, ...] = (25, 25, 20)
    stiffnesses: tuple[float, ...] = (60_000, 60_000, 60_000)
    dampings: tuple[float, ...] = (25, 22, 20)
    loose: int = 1
    brace: float = 30_000
    play: float = 1e-3
    band: tuple[float, float] = (0.5, 25)
    n_lines: int = 120
    noise: float = 0.02
    dt: float = 1 / 256

    def acceleration(self, displacement: FloatArray, velocity: FloatArray, force: float) -> FloatArray:
        """(3,) accelerations of the floors [m/s^2] under a force on the top floor."""
        across = ACROSS @ displacement
        carried = np.array(self.stiffnesses) * across + np.array(self.dampings) * (ACROSS @ velocity)
        carried[self.loose] -= self.brace * min(max(across[self.loose], -self.play), self.play)
        loads = -ACROSS.T @ carried
        loads[TOP] += force
        found: FloatArray = loads / np.array(self.masses)
        return found


def frame_model(frame: Frame) -> StructuralModel:
    """What the engineer believes: every joint tight, the masses weighed, stiffness and damping from a drawing.

    Example:
        >>> frame_model(Frame()).natural_frequencies.round(2)
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


def frame_record(frame: Frame, rng: np.random.Generator, *, level: float, name: str, n_samples: int = 2048) -> Record:
    """One run of the shaker.

    Args:
        frame: the truth.
        rng: where forces, start and noise come from.
        level: root mean square of the force [N].
        name: of the record.
        n_samples: 256 a second.

    Example:
        >>> frame_record(Frame(), np.random.default_rng(1), level=25.0, name="short", n_samples=64)
        Record('short': 64 samples every 0.00390625 s, inputs ['shaker'], outputs ['floor_1', 'floor_2', 'floor_3'])
    """
    from scipy.integrate import solve_ivp

    shaker, time = _shaker(frame, rng, level), frame.dt * np.arange(n_samples)
    start = level * np.concatenate([1e-5 * rng.standard_normal(3), 5e-4 * rng.standard_normal(3)])
    run = solve_ivp(
        lambda t, s: np.concatenate([s[3:], frame.acceleration(s[:3], s[3:], shaker(t))]),
        (0.0, time[-1]),
        start,
        method="DOP853",
        t_eval=time,
        max_step=frame.dt,
        rtol=1e-8,
        atol=1e-11,
    )
    forces = np.array([shaker(t) for t in time])
    outputs = np.array([frame.acceleration(s[:3], s[3:], f) for s, f in zip(run.y.T, forces, strict=True)])
    return Record(
        forces,
        outputs + frame.noise * rng.standard_normal(outputs.shape),
        frame.dt,
        input_names=("shaker",),
        output_names=FLOORS,
        input_units=("N",),
        output_units=("m/s^2",) * 3,
        input_hold="band_limited",
        name=name,
    )


def _shaker(frame: Frame, rng: np.random.Generator, level: float) -> Callable[[float], float]:
    """A random force of the level that is known between the samples too: sines of random frequency and phase."""
    pulses = 2 * np.pi * rng.uniform(*frame.band, frame.n_lines)
    phases = rng.uniform(0.0, 2 * np.pi, frame.n_lines)
    size = level * np.sqrt(2 / frame.n_lines)
    return lambda t: float(size * np.sin(pulses * t + phases).sum())


def study(frame: Frame, rng: np.random.Generator, *, n_samples: int = 2048) -> Diagnosis:
    """Three levels to fit and a fourth one held out, against the linear model."""
    levels = (("quiet", 8), ("medium", 25), ("loud", 70), ("held out", 45))
    *fit, held_out = (frame_record(frame, rng, level=level, name=name, n_samples=n_samples) for name, level in levels)
    return diagnose(frame_model(frame), fit=fit, held_out=held_out)


def summary(frame: Frame, diagnosis: Diagnosis) -> str:
    """What was found, beside what was hidden."""
    lines = [diagnosis.verdict, shrinking(diagnosis)]
    found = [finding for finding in diagnosis.findings if finding.effect == "gap_spring"]
    if found:
        (play, play_std), (inner, inner_std), (outer, _) = (
            parameter(diagnosis, "gap_spring", name) for name in ("gap", "k_in", "k_out")
        )
        storey = next(one for one in diagnosis.calibrated if one.name == f"stiffness of {found[0].where}")
        tight = frame.stiffnesses[frame.loose]
        rows = (
            ("play either way [mm]", 1000, (play, play_std, frame.play)),
            ("stiffness of the brace [kN/m]", 1 / 1000, (outer - inner, inner_std, frame.brace)),
            ("storey within play [kN/m]", 1 / 1000, (storey.value + inner, np.nan, tight - frame.brace)),
            ("storey beyond play [kN/m]", 1 / 1000, (storey.value + outer, storey.std, tight)),
        )
        lines.append(f"loose joint in {found[0].where}, hidden in {STOREYS[frame.loose]}")
        for name, scale, values in rows:
            value, std, truth = (scale * number for number in values)
            within = "" if np.isnan(std) else f" +- {std:.4f}"
            lines.append(f"  {name:<30} found {value:.4f}{within}, hidden {truth:.4f}")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Tell the story; arguments and exit status as in `modal.examples.story.tell`."""
    frame = Frame()
    return tell(
        "A frame's loose joint, found from floor accelerations.",
        arguments,
        study=lambda rng: study(frame, rng),
        summary=lambda diagnosis: summary(frame, diagnosis),
    )


if __name__ == "__main__":
    raise SystemExit(main())
