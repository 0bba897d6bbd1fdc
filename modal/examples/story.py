"""What the stories share: their command line, how a missing effect is told, and a linear structure that is tested.

The structure's true modes come from the eigenvalue problem, its motion from `scipy.signal.lsim`. The masses and springs
are known, every mode has the same damping ratio:

    M x'' + C x' + K x = force_map F,   C = M V diag(2 zeta w) V' M,   K V = M V diag(w^2),  V' M V = 1

`lsim` is exact for forces that a converter holds from sample to sample. Nothing of the identification takes part in
either, so what it finds can be compared with the truth.
"""

import argparse
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy

from modal.discrepancy.results import Diagnosis, in_words
from modal.report.writing import write_report
from modal.sections.discrepancy_stages import step_text
from modal.wording.text import times_floor_text
from okid.arrays import FloatArray, frozen
from okid.errors import IdentificationError, InvalidDataError


def tell(
    what: str,
    arguments: Sequence[str] | None,
    *,
    study: Callable[[np.random.Generator], Diagnosis],
    summary: Callable[[Diagnosis], str],
) -> int:
    """Diagnose, print what was found beside what was hidden, and write the report where that is asked for.

    Args:
        what: the story, one sentence.
        arguments: of the command line, its own unless given.
        study: makes the records and diagnoses them.
        summary: of the diagnosis in words.

    Returns:
        0 when an effect was named, 1 otherwise.
    """
    given = command_line(what, arguments, written="the report and the recording")
    diagnosis = study(np.random.default_rng(given.seed))
    print(summary(diagnosis))
    if given.output is not None:
        print_written(lambda: write_report(diagnosis, given.output))
    return 0 if diagnosis.status == "named" else 1


def command_line(what: str, arguments: Sequence[str] | None, *, written: str, seed: int = 1) -> argparse.Namespace:
    """The options that every story has: `output`, a folder or None, and `seed`.

    Args:
        what: the story, one sentence.
        arguments: of the command line, its own unless given.
        written: what goes into the folder.
        seed: unless another one is given.

    Example:
        >>> command_line("A story.", [], written="the report").seed
        1
    """
    parser = argparse.ArgumentParser(description=what)
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", help=f"write {written} into DIR")
    words = f"of the noise, the excitation and the starts (default {seed})"
    parser.add_argument("--seed", type=int, default=seed, help=words)
    return parser.parse_args(arguments)


def print_written(write: Callable[[], Iterable[Path]]) -> None:
    """A line for each file that was written, or why there is none."""
    try:
        paths = list(write())
    except (IdentificationError, OSError) as error:
        print(f"not written: {error}")
    else:
        for path in paths:
            print(f"written: {path}")


def parameter(diagnosis: Diagnosis, effect: str, name: str) -> tuple[float, float]:
    """Value and standard deviation of a parameter of an effect that was found.

    Raises:
        InvalidDataError: it was not found.
    """
    for finding in diagnosis.findings:
        for one in finding.parameters if finding.effect == effect else ():
            if one.name == name:
                return one.value, one.std
    raise InvalidDataError(f"the diagnosis found no {effect} with a parameter {name}; look at its verdict.")


def shrinking(diagnosis: Diagnosis) -> str:
    """How the held-out gap shrinks from step to step, a line each, in times the noise floor."""
    names = [step_text(step.name) for step in in_words(diagnosis).steps]
    sizes = [times_floor_text(step.held_out_level) for step in diagnosis.steps]
    width = max(map(len, names))
    lines = (f"  {name:<{width}}  {size:>8}" for name, size in zip(names, sizes, strict=True))
    return "\n".join(["gap on held-out data, times the noise floor:", *lines])


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LinearStructure:
    """Masses on springs, with the places where they are pushed and where accelerometers sit.

    Attributes:
        mass: (n_coordinates, n_coordinates) [kg], or [kg m^2] for an angle.
        stiffness: (n_coordinates, n_coordinates) [N/m], or [N m] for an angle.
        damping_ratio: of every mode.
        force_map: (n_coordinates, n_inputs) load on each coordinate for a force of 1 N.
        sensor_map: (n_outputs, n_coordinates) reading of each accelerometer for 1 m/s^2, or 1 rad/s^2.
    """

    mass: FloatArray
    stiffness: FloatArray
    damping_ratio: float
    force_map: FloatArray
    sensor_map: FloatArray

    def __post_init__(self) -> None:
        for name in ("mass", "stiffness", "force_map", "sensor_map"):
            object.__setattr__(self, name, frozen(getattr(self, name), name=name))

    def modes(self) -> tuple[FloatArray, FloatArray]:
        """Undamped frequencies (n_modes,) rising [Hz], and shapes (n_outputs, n_modes), largest component 1.

        Example:
            >>> one = LinearStructure(mass=[[1.0]], stiffness=[[4.0]], damping_ratio=0.01, force_map=[[1.0]],
            ...                       sensor_map=[[1.0]])
            >>> one.modes()[0].round(5).tolist()
            [0.31831]
        """
        squares, vectors = scipy.linalg.eigh(self.stiffness, self.mass)
        shapes = self.sensor_map @ vectors
        largest = shapes[np.abs(shapes).argmax(axis=0), range(shapes.shape[1])]
        return np.sqrt(squares) / (2 * np.pi), shapes / largest

    def accelerations(self, forces: FloatArray, dt: float, start: FloatArray) -> FloatArray:
        """What the accelerometers see, without noise.

        Args:
            forces: (n_samples, n_inputs), each held for one time step [N].
            dt: time step [s].
            start: (2 n_coordinates,) positions and velocities at the first sample.

        Returns:
            (n_samples, n_outputs) [m/s^2].
        """
        from scipy.signal import lsim

        squares, vectors = scipy.linalg.eigh(self.stiffness, self.mass)
        carried = self.mass @ vectors
        damping = (carried * (2 * self.damping_ratio * np.sqrt(squares))) @ carried.T
        n = len(self.mass)
        moved = np.linalg.solve(self.mass, np.hstack([-self.stiffness, -damping, self.force_map]))
        A = np.vstack([np.eye(n, 2 * n, k=n), moved[:, : 2 * n]])
        B = np.vstack([np.zeros_like(self.force_map), moved[:, 2 * n :]])
        C, D = self.sensor_map @ A[n:], self.sensor_map @ B[n:]
        _, outputs, _ = lsim((A, B, C, D), forces, dt * np.arange(len(forces)), X0=start, interp=False)
        return np.asarray(outputs, dtype=np.float64).reshape(len(forces), len(C))


def random_forces(rng: np.random.Generator, n_samples: int, levels: FloatArray) -> FloatArray:
    """Low-passed random forces, (n_samples, n_inputs) [N].

    Args:
        rng: where they come from.
        n_samples: length of the record.
        levels: (n_inputs,) root mean square of each force [N].
    """
    white = rng.standard_normal((n_samples + 1, len(levels)))
    return np.asarray((white[1:] + 0.5 * white[:-1]) * levels / np.sqrt(1.25))
