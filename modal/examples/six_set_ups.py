"""Three accelerometers on a mast of eight storeys: six set-ups, one set of modes.

Two accelerometers stay on the fifth and the eighth floor, the third one roves over the six others; a shaker on the
roof is turned up and down from day to day by a factor of ten, as it happens. No record has seen more than three floors,
and none knows the scale of another but by the two that stay: `okid.join_setups` puts the records side by side on the
union of their channels, and `modal.identify` gives one modal model of all eight floors, fitted to each accelerometer
where it measured and to each set-up by its own noise.

The truth is known: the eigenvalue problem of the masses and springs, whose motion `scipy.signal.lsim` computes
(`modal.examples.story`).

Run `python -m modal.examples.six_set_ups [-o DIR]`; with a folder it writes the report and the recording.

References:
    Reynders, Magalhaes, De Roeck, Cunha, Merging strategies for multi-setup operational modal analysis, 27th
    International Modal Analysis Conference, 2009.
"""

from collections.abc import Sequence

import numpy as np

from modal.examples.demo import DemoTruth, compare_with_truth
from modal.examples.story import LinearStructure, command_line, print_written, random_forces
from modal.identification.pipeline import identify
from modal.identification.result import Identification
from modal.report.writing import write_report
from okid.record import Record
from okid.rows import join_setups

N_FLOORS, DT = 8, 1 / 64
STAY, ROVE = (4, 7), (0, 1, 2, 3, 5, 6)
"""Floors with an accelerometer in all set-ups, and the one more in each of them; floor 0 is the lowest."""
LEVELS = (100.0, 30.0, 10.0, 70.0, 20.0, 50.0)
"""Of the shaker [N]."""


def tall_mast() -> LinearStructure:
    """The truth: a shaker on the roof, an accelerometer on each floor.

    Example:
        >>> tall_mast().modes()[0].round(2).tolist()
        [2.18, 6.46, 10.52, 14.23, 17.45, 20.07, 22.01, 23.2]
    """
    storeys = 2 * np.eye(N_FLOORS) - np.eye(N_FLOORS, k=1) - np.eye(N_FLOORS, k=-1)
    storeys[-1, -1] = 1.0
    return LinearStructure(
        mass=200.0 * np.eye(N_FLOORS),
        stiffness=1.1e6 * storeys,
        damping_ratio=0.01,
        force_map=np.eye(N_FLOORS)[:, -1:],
        sensor_map=np.eye(N_FLOORS),
    )


def set_ups(rng: np.random.Generator, *, n_samples: int = 1024) -> tuple[Record, ...]:
    """Six records of three accelerometers each, with 2 % noise.

    Example:
        >>> [record.output_names[-1] for record in set_ups(np.random.default_rng(1), n_samples=64)]
        ['floor_1', 'floor_2', 'floor_3', 'floor_4', 'floor_6', 'floor_7']
    """
    structure, records = tall_mast(), []
    for number, (level, roving) in enumerate(zip(LEVELS, ROVE, strict=True), start=1):
        floors = [*STAY, roving]
        forces = random_forces(rng, n_samples, np.array([level]))
        outputs = structure.accelerations(forces, DT, np.zeros(2 * N_FLOORS))[:, floors]
        records.append(
            Record(
                forces,
                outputs + 0.02 * outputs.std(axis=0) * rng.standard_normal(outputs.shape),
                DT,
                input_names=("shaker",),
                output_names=tuple(f"floor_{floor + 1}" for floor in floors),
                input_units=("N",),
                output_units=("m/s^2",) * len(floors),
                input_hold="zero_order",
                name=f"set-up {number}",
            )
        )
    return tuple(records)


def summary(result: Identification) -> str:
    """Each mode beside the truth."""
    frequencies, shapes = tall_mast().modes()
    names = result.modes.output_names
    truth = DemoTruth(
        frequencies=frequencies,
        damping_ratios=np.full(N_FLOORS, tall_mast().damping_ratio),
        shapes=shapes[[int(name.removeprefix("floor_")) - 1 for name in names]].astype(np.complex128),
        output_names=names,
        heights=np.arange(1.0, len(names) + 1.0),
    )
    rows = compare_with_truth(truth, result.modes)
    found = sum(row.verdict == "system" for row in rows)
    lines = [f"{found} of {N_FLOORS} modes found, on {len(names)} floors from {len(LEVELS)} set-ups of 3 sensors."]
    lines.append("found Hz    true Hz   damping found     true   assurance of the shape")
    lines += [
        f"{row.found_frequency:>8.4f} {row.frequency:>10.4f} {100 * row.found_damping_ratio:>13.3f} % "
        f"{100 * row.damping_ratio:>6.3f} % {row.assurance:>24.5f}"
        for row in rows
    ]
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Identify the mast from its six set-ups.

    Returns:
        0 where all modes were found, 1 otherwise.
    """
    what = "A mast of eight storeys from six set-ups of three accelerometers."
    given = command_line(what, arguments, written="the report and the recording")
    result = identify(join_setups(set_ups(np.random.default_rng(given.seed))))
    print(summary(result))
    if given.output is not None:
        print_written(lambda: write_report(result, given.output))
    return 0 if len(result.modes.system) == N_FLOORS else 1


if __name__ == "__main__":
    raise SystemExit(main())
