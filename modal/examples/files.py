"""The files that the commands of README and docs name, so that each command can be typed as it stands.

`modal-report demo --files -o FOLDER` writes them: a mast that is shaken at its tip, struck, released, or left to the
wind; its frequency responses, geometry and test file; 48 nights of it, in which a bolt comes loose; and the motor of
`modal.examples.motor_propeller` with its linear model. Nothing of the packages takes part in how the mast moves:
`scipy.signal.lsim` is exact for forces that a converter holds, and blows are given to it at eight times the rate.
"""

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import numpy as np

from modal.examples.motor_propeller import Motor, linear_model, measured_record
from modal.examples.story import LinearStructure, random_forces
from modal.report.folder import write_folder
from okid.arrays import FloatArray
from okid.readers.guard import Existing

MAST: Final = ("root", "middle", "tip")
"""Where the accelerometers of the mast sit."""

DT: Final = 0.01

FRAME: Final = """\
unit = "mm"
lines = [[0, 1, 2, 3]]
fixed = [0]

[nodes]
0 = [0, 0, 0]
1 = [0, 0, 400]
2 = [0, 0, 800]
3 = [0, 0, 1200]

[sensors]
root = "1X+"
middle = "2X+"
tip = "3X+"
"""

TEST: Final = """\
article = "mast with three masses"
place = "computed, not measured"

[[limits]]
name = "first bending"
kind = "mode"
frequency = [4.2, 4.8]

[[limits]]
name = "clear of the rotor"
kind = "no_mode"
frequency = [8.0, 11.0]
"""


def mast(*, stiffness: float = 1.0, root: float = 1.0) -> LinearStructure:
    """The truth: three masses of 2 kg in a row on springs of 8 kN/m, a force at the tip, three accelerometers.

    Args:
        stiffness: of all springs, relative.
        root: of the lowest one, relative.

    Example:
        >>> mast().modes()[0].round(2).tolist()
        [4.48, 12.55, 18.14]
    """
    springs = 8000.0 * stiffness * np.array([root, 1.0, 1.0])
    stretched = np.eye(3) - np.eye(3, k=-1)
    return LinearStructure(
        mass=2.0 * np.eye(3),
        stiffness=stretched.T @ np.diag(springs) @ stretched,
        damping_ratio=0.01,
        force_map=np.eye(3)[:, 2:],
        sensor_map=np.eye(3),
    )


def write_files(folder: Path, *, existing: Existing = "refuse") -> tuple[Path, ...]:
    """Write all of them, the same bytes every time.

    Args:
        folder: made if it does not exist.
        existing: "refuse" to touch a folder that holds one of the files, or "replace" those files.

    Raises:
        InvalidDataError: a file exists already, or the folder cannot be written.
    """
    parts = dict(_parts(np.random.default_rng(1)))

    def write(made: Path) -> None:
        for name, make in parts.items():
            make(made / name)

    write_folder(folder, tuple(parts), write, existing=existing)
    return tuple(folder / name for name in parts)


def _parts(rng: np.random.Generator) -> Iterator[tuple[str, Callable[[Path], object]]]:
    """Name and writer of each file."""
    level = np.array([20.0])  # N, root mean square
    yield "shaker.csv", _table(mast(), random_forces(rng, 6000, level), rng)
    for number, share in enumerate((1.0, 0.5), start=1):
        yield f"run_{number}.csv", _table(mast(), random_forces(rng, 3000, share * level), rng)
    yield "hammer.csv", _table(mast(), _struck(30.0, 8), rng, finer=8)
    yield "ambient.csv", _table(mast(), random_forces(rng, 12000, level), rng, inputs=())
    yield "decay.csv", _table(mast(), np.zeros((3000, 1)), rng, inputs=(), start=np.repeat([0.0, 1.0], 3))
    yield "responses.csv", _responses(mast(), rng)
    yield "frame.toml", _text(FRAME)
    yield "test.toml", _text(TEST)
    temperature = 10.0 + 5.0 * rng.standard_normal(48)
    for night in range(len(temperature)):
        built = mast(stiffness=1.0 - 0.001 * temperature[night], root=0.99 if night >= 30 else 1.0)
        yield f"night_{night + 1:02}.csv", _table(built, random_forces(rng, 600, level), rng)
    yield "weather.csv", _text("temperature [degC]\n" + "".join(f"{one:.2f}\n" for one in temperature))
    motor = Motor()
    yield "motor.toml", linear_model(motor).save
    for name, voltages in (("slow", (1, 4)), ("fast", (3, 12)), ("middle", (2, 8))):
        run = measured_record(motor, rng, voltages=voltages, name=name)
        columns = {"voltage [V]": run.inputs[:, 0], "speed [rad/s]": run.outputs[:, 0]}
        yield f"{name}.csv", _columns({"time [s]": run.time, **columns})


def _struck(duration: float, finer: int) -> FloatArray:
    """(n_fine, 1) three blows of a soft hammer, 40 ms each [N]."""
    time = DT / finer * np.arange(round(duration / DT) * finer)
    blows = np.sum(
        [
            peak * np.where(abs(time - at) < 0.02, np.cos(math.pi * (time - at) / 0.04) ** 2, 0.0)
            for at, peak in ((1.0, 300.0), (11.0, 180.0), (21.0, 250.0))
        ],
        axis=0,
    )
    return blows[:, None]


def _table(
    built: LinearStructure,
    force: FloatArray,
    rng: np.random.Generator,
    *,
    inputs: tuple[str, ...] = ("force",),
    finer: int = 1,
    start: FloatArray | None = None,
) -> Callable[[Path], None]:
    """What a logger writes of a mast: force and accelerations with noise of 1 %."""
    outputs = built.accelerations(force, DT / finer, np.zeros(6) if start is None else start)[::finer]
    outputs += 0.01 * outputs.std(axis=0) * rng.standard_normal(outputs.shape)
    time: FloatArray = DT * np.arange(len(outputs), dtype=np.float64)
    columns = {"time [s]": time, **{f"{name} [N]": force[::finer, 0] for name in inputs}}
    return _columns({**columns, **{f"{name} [m/s^2]": outputs[:, i] for i, name in enumerate(MAST)}})


def _responses(built: LinearStructure, rng: np.random.Generator) -> Callable[[Path], None]:
    """Accelerances to 40 Hz with noise of 0.2 % of the largest, from masses, springs and damping alone."""
    lines = np.arange(0.05, 40.0, 0.05)
    frequencies, shapes = built.modes()
    squares, masses = frequencies**2, (shapes.T @ built.mass @ shapes).diagonal()
    parts = -(lines[:, None] ** 2) / (
        squares - lines[:, None] ** 2 + 2j * built.damping_ratio * frequencies * lines[:, None]
    )
    answers = (parts / masses * shapes[-1]) @ shapes.T
    noise = rng.standard_normal(answers.shape) + 1j * rng.standard_normal(answers.shape)
    answers += 0.002 * np.abs(answers).max() * noise
    columns = {"frequency [Hz]": lines}
    for name, answer in zip(MAST, answers.T, strict=True):
        columns |= {f"{name}/force re [m/s^2/N]": answer.real, f"{name}/force im [m/s^2/N]": answer.imag}
    return _columns(columns)


def _columns(columns: dict[str, FloatArray]) -> Callable[[Path], None]:
    lines = np.stack(list(columns.values()), axis=1)

    def write(path: Path) -> None:
        np.savetxt(path, lines, delimiter=",", header=",".join(columns), comments="", fmt="%.7g")

    return write


def _text(text: str) -> Callable[[Path], object]:
    return lambda path: path.write_text(text, encoding="utf-8")
