"""A three-storey frame with a fan on its top floor: may the fan run at 720 turns a minute?

The question is one of acceptance: the drawing promises a first sway between 4.6 and 5.2 Hz, and no mode may lie within
11.5 to 12.5 Hz, where the fan runs. Two shakers push corners of the upper floors with random forces, three
accelerometers a floor look on, and a test file (`three_storey_frame.toml`, beside this script) says what the measured
file cannot: the nodes and lines of the frame, that its floors are rigid, and the limits.

Channels are named as in the field: `33Y-` is node 33, along negative Y. The floors are rigid, so three sensors tell
how all four corners of a floor move: the frame sways in X and Y and twists, nine modes in all. The fan stands in one
corner, so sway and twist mix a little.

The truth is known: the eigenvalue problem of the frame's masses and springs, whose motion `scipy.signal.lsim` computes
(`modal.examples.story`).

Run `python -m modal.examples.three_storey_frame [-o DIR]`; with a folder it writes the measured file, the test file and
the report with its recording.
"""

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from modal.acceptance.check import LimitOutcome, check_limits
from modal.acceptance.test_file import Specification, read_specification
from modal.examples.demo import DemoTruth, ModeComparison, compare_with_truth
from modal.examples.story import LinearStructure, command_line, print_written, random_forces
from modal.identification.pipeline import identify
from modal.identification.result import Identification
from modal.report.writing import write_report
from okid.arrays import FloatArray
from okid.record import Record

SENSORS = ("11X+", "11Y+", "13Y-", "21X+", "21Y+", "23Y-", "31X+", "31Y+", "33Y-")
SHAKERS = ("32X+", "23Y+")
CORNERS = {1: (-1, -1), 2: (1, -1), 3: (1, 1), 4: (-1, 1)}
"""Which way each corner lies from the middle of its floor; the last figure of a node's name."""
TEST_FILE = Path(__file__).with_suffix(".toml")


@dataclass(frozen=True, slots=True, kw_only=True)
class Parts:
    """What the frame is made of.

    Attributes:
        n_floors: number of floors.
        width: along X [m].
        depth: along Y [m].
        height: of a storey [m].
        mass: of a floor [kg].
        fan: mass of the fan, which stands over node 33 [kg].
        stiffness_x: of the four columns of a storey together [N/m].
        stiffness_y: the same along Y [N/m].
        dt: time between samples [s].
    """

    n_floors: int = 3
    width: float = 0.4
    depth: float = 0.3
    height: float = 0.35
    mass: float = 8
    fan: float = 0.8
    stiffness_x: float = 40_000
    stiffness_y: float = 56_000
    dt: float = 0.005


PARTS = Parts()


def frame() -> LinearStructure:
    """The truth: sway x, sway y and twist of each rigid floor, from the ground up.

    Example:
        >>> frame().modes()[0].round(2).tolist()
        [4.87, 5.76, 9.05, 13.82, 16.36, 20.18, 23.87, 26.22, 38.95]
    """
    # columns in the corners: what they do against twist follows from where they stand
    twist = PARTS.stiffness_x * (PARTS.depth / 2) ** 2 + PARTS.stiffness_y * (PARTS.width / 2) ** 2
    storeys = 2 * np.eye(PARTS.n_floors) - np.eye(PARTS.n_floors, k=1) - np.eye(PARTS.n_floors, k=-1)
    storeys[-1, -1] = 1.0
    floor = np.diag([PARTS.mass, PARTS.mass, PARTS.mass * (PARTS.width**2 + PARTS.depth**2) / 12])
    mass = np.kron(np.eye(PARTS.n_floors), floor)
    fan = np.array([_reading("33X+"), _reading("33Y+")])
    return LinearStructure(
        mass=mass + PARTS.fan * fan.T @ fan,
        stiffness=np.asarray(
            np.kron(storeys, np.diag([PARTS.stiffness_x, PARTS.stiffness_y, twist])), dtype=np.float64
        ),
        damping_ratio=0.008,
        force_map=np.stack([_reading(name) for name in SHAKERS], axis=1),
        sensor_map=np.stack([_reading(name) for name in SENSORS]),
    )


def truth() -> DemoTruth:
    """What an identification should find."""
    frequencies, shapes = frame().modes()
    return DemoTruth(
        frequencies=frequencies,
        damping_ratios=np.full(len(frequencies), frame().damping_ratio),
        shapes=shapes.astype(np.complex128),
        output_names=SENSORS,
        heights=PARTS.height * np.array([float(name[0]) for name in SENSORS]),
    )


def storeys_record(rng: np.random.Generator, *, n_samples: int = 4000, noise: float = 0.05) -> Record:
    """The test: two random forces [N], nine accelerations [m/s^2]; the frame is moving already when it starts.

    Args:
        rng: where forces, start and noise come from.
        n_samples: 200 a second.
        noise: standard deviation of the noise as a share of what each sensor sees.

    Example:
        >>> storeys_record(np.random.default_rng(1), n_samples=400).output_names[:3]
        ('11X+', '11Y+', '13Y-')
    """
    forces = random_forces(rng, n_samples, np.array([20.0, 15.0]))
    start = np.concatenate([1e-4 * rng.standard_normal(9), 5e-3 * rng.standard_normal(9)])
    outputs = frame().accelerations(forces, PARTS.dt, start)
    return Record(
        forces,
        outputs + noise * outputs.std(axis=0) * rng.standard_normal(outputs.shape),
        PARTS.dt,
        input_names=tuple(f"force {name}" for name in SHAKERS),
        output_names=SENSORS,
        input_units=("N",) * len(SHAKERS),
        output_units=("m/s^2",) * len(SENSORS),
        input_hold="zero_order",
        name="frame",
    )


def _reading(name: str) -> FloatArray:
    """(9,) motion at a node and along an axis such as 33Y-, from sway and twist of its floor (small angles)."""
    side_x, side_y = CORNERS[int(name[1])]
    along = {"X": (1.0, 0.0, -side_y * PARTS.depth / 2), "Y": (0.0, 1.0, side_x * PARTS.width / 2)}[name[2]]
    reading = np.zeros(3 * PARTS.n_floors)
    first = 3 * (int(name[0]) - 1)
    reading[first : first + 3] = along
    return -reading if name[3] == "-" else reading


def study(record: Record) -> tuple[Identification, Specification, tuple[LimitOutcome, ...]]:
    """The modes of the record, the test file, and what became of each of its limits."""
    specification = read_specification(TEST_FILE)
    result = identify(record)
    return result, specification, check_limits(result, specification)


def summary(found: Sequence[ModeComparison], outcomes: Sequence[LimitOutcome]) -> str:
    """The answer, then each mode beside the truth."""
    n_met = sum(outcome.met for outcome in outcomes)
    answer = "yes, the fan may run" if n_met == len(outcomes) else "no, not as it stands"
    lines = [f"{n_met} of {len(outcomes)} limits are surely met: {answer}."]
    lines += [f"  {outcome.what}: {outcome.state}; {outcome.found}" for outcome in outcomes]
    lines.append("mode   found Hz    true Hz   damping found     true   assurance of the shape")
    lines += [
        f"{number:>4} {row.found_frequency:>10.4f} {row.frequency:>10.4f} {100 * row.found_damping_ratio:>13.3f} % "
        f"{100 * row.damping_ratio:>6.3f} % {row.assurance:>24.5f}"
        for number, row in enumerate(found, start=1)
    ]
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Test the frame and answer the question.

    Returns:
        0 where all limits are met, 1 otherwise.
    """
    what = "A three-storey frame: may the fan on its top floor run at 720 turns a minute?"
    given = command_line(what, arguments, written="the measured file, the test file, the report and the recording")
    record = storeys_record(np.random.default_rng(given.seed))
    result, specification, outcomes = study(record)
    print(summary(compare_with_truth(truth(), result.modes), outcomes))
    if given.output is not None:
        print_written(partial(_written, given.output, record, result, specification))
    return 0 if all(outcome.met for outcome in outcomes) else 1


def _written(folder: Path, record: Record, result: Identification, specification: Specification) -> list[Path]:
    """Report, measured file and test file."""
    paths = [*write_report(result, folder, specification=specification), folder / "frame.csv", folder / TEST_FILE.name]
    units = record.input_units + record.output_units
    header = [f"{name} [{unit}]" for name, unit in zip(record.input_names + record.output_names, units, strict=True)]
    table = np.hstack([record.time[:, None], record.inputs, record.outputs])
    np.savetxt(paths[-2], table, fmt="%.6g", delimiter=",", header=",".join(["time [s]", *header]), comments="")
    shutil.copyfile(TEST_FILE, paths[-1])
    return paths


if __name__ == "__main__":
    raise SystemExit(main())
