"""Four modules on a rail, six records: which modes shifted after a bolt was loosened, and which bolt was it?

Four equal modules hang in a row between two walls, joined by five bolted joints. They were tested on three days; then
somebody worked on a bolt, and they were tested on three other days. No two records are alike: other levels of the
shaker, another start, other offsets, samples lost here and there. One joint may have lost one percent of its stiffness,
and no one sees that by eye: the largest change of a frequency is 0.2 percent.

1. **One identification over many records.** Each record keeps its own start and its own offsets; modes, order and
   uncertainty are those of all three together: `modal.identify` takes a list.
2. **Before against after**, every shift of frequency, damping and shape against its 95 % interval, all tested together
   so that twelve tests do not find something in nothing (`modal.compare_results`).
3. **Which bolt?** A joint e that loses the share a of its stiffness lowers the frequency of mode k by a w_ke / 2, where
   w_ke is the share of the mode's strain energy that the joint holds, known from the shapes that were found. Modes 1
   and 3 do not strain the middle joint at all: if they stand still while 2 and 4 shift, it can only be that one.

The truth is known: the eigenvalue problem of the masses and springs, whose motion `scipy.signal.lsim` computes
(`modal.examples.story`).

Run `python -m modal.examples.many_records [-o DIR]`; with a folder it writes the comparison and both results
(`modal-report diff before.npz after.npz` compares them anew).

References:
    Cawley and Adams, "The location of defects in structures from measurements of natural frequencies", Journal of
    Strain Analysis 14(2), 1979, doi 10.1243/03093247V142049.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from modal.comparison.changes import Comparison, compare_results
from modal.comparison.shifts import summary_of
from modal.comparison.words import comparison_headline, pair_sentence
from modal.examples.story import LinearStructure, command_line, print_written, random_forces
from modal.identification.pipeline import identify
from modal.identification.result import Identification
from modal.report.comparison import write_comparison
from modal.wording.text import NINETY_FIVE
from okid.arrays import FloatArray
from okid.record import Record


@dataclass(frozen=True, slots=True, kw_only=True)
class ModuleRow:
    """Four modules between two walls, and how they are tested.

    Attributes:
        n_modules: number of modules; there is one joint more.
        mass: of a module [kg].
        stiffness: of a joint [N/m].
        loosened: the joint whose bolt was loosened, counted from 0 at the left wall.
        loss: share of stiffness that it lost.
        levels: of the shaker on the three days [N].
        dt: time between samples [s].
    """

    n_modules: int = 4
    mass: float = 50
    stiffness: float = 500e3
    loosened: int = 2
    loss: float = 0.01
    levels: tuple[float, ...] = (60, 15, 150)
    dt: float = 1 / 128


ROW = ModuleRow()
ACROSS = np.eye(ROW.n_modules + 1, ROW.n_modules) - np.eye(ROW.n_modules + 1, ROW.n_modules, k=-1)
"""Row e: how far joint e is stretched, from the positions of the modules."""


def modules(*, loss: float = 0.0) -> LinearStructure:
    """The truth: a shaker on the first module, an accelerometer on each.

    Args:
        loss: share of its stiffness that the loosened joint has lost.

    Example:
        >>> modules().modes()[0].round(2).tolist(), modules(loss=0.01).modes()[0].round(2).tolist()
        ([9.84, 18.71, 25.75, 30.27], [9.84, 18.67, 25.75, 30.21])
    """
    joints = np.full(ROW.n_modules + 1, ROW.stiffness)
    joints[ROW.loosened] *= 1 - loss
    return LinearStructure(
        mass=ROW.mass * np.eye(ROW.n_modules),
        stiffness=ACROSS.T @ np.diag(joints) @ ACROSS,
        damping_ratio=0.008,
        force_map=np.eye(ROW.n_modules)[:, :1],
        sensor_map=np.eye(ROW.n_modules),
    )


def records_of(structure: LinearStructure, rng: np.random.Generator, *, n_samples: int = 2048) -> tuple[Record, ...]:
    """Three days of testing: each with its own level, start, offsets and lost samples.

    Example:
        >>> [record.name for record in records_of(modules(), np.random.default_rng(1), n_samples=256)]
        ['day 1', 'day 2', 'day 3']
    """
    records = []
    for day, level in enumerate(ROW.levels, start=1):
        forces = random_forces(rng, n_samples, np.array([level]))
        start = level * np.concatenate([1e-6 * rng.standard_normal(4), 1e-4 * rng.standard_normal(4)])
        outputs = structure.accelerations(forces, ROW.dt, start)
        outputs += outputs.std(axis=0) * (0.1 * rng.standard_normal(outputs.shape) + 0.3 * rng.uniform(-1, 1, 4))
        for channel in rng.integers(ROW.n_modules, size=2):  # a loose plug
            lost = rng.integers(n_samples // 8, 7 * n_samples // 8)
            outputs[lost : lost + rng.integers(2, 12), channel] = np.nan
        records.append(
            Record(
                forces,
                outputs,
                ROW.dt,
                input_names=("shaker",),
                output_names=tuple(f"module_{i + 1}" for i in range(ROW.n_modules)),
                input_units=("N",),
                output_units=("m/s^2",) * ROW.n_modules,
                input_hold="zero_order",
                name=f"day {day}",
            )
        )
    return tuple(records)


def compared(before: Identification, after: Identification) -> Comparison:
    """What changed between the two."""
    return compare_results(summary_of(before, name="before"), summary_of(after, name="after"))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Suspect:
    """A joint, and how well its loss of stiffness would explain the shifts of all frequencies.

    Attributes:
        joint: counted from 0 at the left wall.
        loss: share of its stiffness that fits best.
        loss_std: its standard deviation.
        misfit: root mean square of what it leaves unexplained, in standard deviations of the shifts.
    """

    joint: int
    loss: float
    loss_std: float
    misfit: float


def suspects(comparison: Comparison) -> tuple[Suspect, ...]:
    """Every joint as the suspect, the one that explains the shifts best first; all joints are alike on the drawing."""
    shifts = np.array([pair.frequency.change for pair in comparison.pairs])
    stds = np.array([pair.frequency.half_width for pair in comparison.pairs]) / NINETY_FIVE
    strains = np.array([np.abs(ACROSS @ pair.before.shape) ** 2 for pair in comparison.pairs])
    lowered: FloatArray = -0.5 * strains / strains.sum(axis=1, keepdims=True)
    found = []
    for joint, slope in enumerate(lowered.T):
        weight = 1.0 / float(np.sum((slope / stds) ** 2))
        loss = weight * float(np.sum(slope * shifts / stds**2))
        left = float(np.sqrt(np.mean(((shifts - loss * slope) / stds) ** 2)))
        found.append(Suspect(joint=joint, loss=loss, loss_std=float(np.sqrt(weight)), misfit=left))
    return tuple(sorted(found, key=lambda one: one.misfit))


def summary(comparison: Comparison) -> str:
    """What shifted, and the joint that explains it, beside the one that was hidden."""
    best, second = suspects(comparison)[:2]
    lines = [comparison_headline(comparison), *(f"  {pair_sentence(pair)}" for pair in comparison.pairs)]
    lines.append(
        f"joint {best.joint + 1} lost {100 * best.loss:.2f} ± {196 * best.loss_std:.2f} % of its stiffness; hidden: "
        f"joint {ROW.loosened + 1}, {100 * ROW.loss:.2f} %"
    )
    lines.append(
        f"  what it leaves of the shifts is {best.misfit:.1f} of their standard deviations; the next best, joint "
        f"{second.joint + 1}, leaves {second.misfit:.1f}"
    )
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Compare three days with three other days, and name the joint.

    Returns:
        0 where something changed beyond chance, 1 otherwise.
    """
    what = "A row of modules tested before and after somebody worked on a bolt: which one was loosened?"
    given = command_line(what, arguments, written="the comparison and both results")
    rng = np.random.default_rng(given.seed)
    states = [records_of(modules(loss=loss), rng) for loss in (0.0, ROW.loss)]
    before, after = (identify(records) for records in states)
    comparison = compared(before, after)
    print(summary(comparison))
    if given.output is not None:
        print_written(partial(_written, given.output, before, after, comparison))
    return 0 if comparison.changed else 1


def _written(folder: Path, before: Identification, after: Identification, comparison: Comparison) -> list[Path]:
    """The comparison as pages, and both results."""
    page = write_comparison(comparison, folder).html
    return [page, before.save(folder / "before.npz"), after.save(folder / "after.npz")]


if __name__ == "__main__":
    raise SystemExit(main())
