"""Models with some effects, fitted and judged on held-out records: what the search goes from and comes to."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from modal.discrepancy.fitting.estimation import Estimate, Problem, estimate, simulate_at
from modal.discrepancy.fitting.held_out import judged
from modal.effects.effect import Effect, is_sharp
from modal.simulation.assembly import Unknowns
from modal.simulation.budget import Budget
from modal.simulation.trajectory import SHARP
from okid.arrays import FloatArray

__all__ = [
    "FINE_STEPS",
    "SMALLEST_FALL",
    "SMALLEST_GAIN",
    "Node",
    "Task",
    "counts",
    "log_likelihood_gain",
    "node_of",
    "on_other_floor",
    "polished",
]

SMALLEST_FALL = 0.1
SMALLEST_GAIN = 30.0
"""A step counts when the held-out mean square falls by a tenth and 2 ln L gains more than 30: over 32 cases without an
effect none fell by a tenth, while 69 % gained more than 30."""

SHARPER = tuple(SHARP / share for share in (1.0, 2.5, 5.0, 10.0, 20.0))
"""Small steps, because each trajectory must be near the next: from a first one of a fifth, half of the fits with a
second effect found none, and those that did took longer."""
NEARLY, BLUR = 2.0, 0.1
"""What is left is taken for smoothing below this level, or where it changes by this share of the excess with the
smoothing."""
FAR, MOSTLY = 30.0, 1.0
"""Above this level only where it rises by this share of the excess, as where smoothing makes a third of it: a motion
with impacts changes a little with anything."""
FINE_STEPS = 4
"""Steps a sample of the grid on which sharp laws are polished, at least."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Task:
    """What the search works on.

    Attributes:
        fit: The records to fit.
        held_out: The held-out records.
        upsampling: Steps of the simulation per sample.
        catalogue: The effects to try.
        report: Called with a sentence and the share done.
        fine_fit: The records to fit on a finer grid, for sharp laws.
        fine_held_out: The held-out records likewise.
        whole: Whether the records are whole, so that they may be cut into spans.
        budget: What the search may cost.
    """

    fit: Problem
    held_out: Problem
    upsampling: int
    catalogue: Mapping[str, Effect]
    report: Callable[[str, float], None]
    fine_fit: Problem
    fine_held_out: Problem
    whole: bool = False
    budget: Budget = field(default_factory=Budget)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Node:
    """A model with some effects, fitted.

    Attributes:
        fitted: The estimate on the records to fit, in free run.
        held_out: The same model on the held-out records, only their own unknowns fitted; None where it escapes.
        coarse: The estimate on the grid on which the search goes on.
    """

    fitted: Estimate
    held_out: Estimate | None
    coarse: Estimate

    @property
    def effects(self) -> tuple[tuple[str, str], ...]:
        """(effect, place) of each effect."""
        return tuple((item.effect.key, item.where) for item in self.fitted.assembly.placements)

    @property
    def fit_level(self) -> float:
        """Mean square of the residual on the records to fit, in units of the floor."""
        return self.fitted.level

    @property
    def held_out_level(self) -> float:
        """Likewise on the held-out records; infinite where the model escapes."""
        return np.inf if self.held_out is None else self.held_out.level


def log_likelihood_gain(before: Node, after: Node, task: Task) -> float:
    """2 ln L that `after` gains over `before` on all records, each record and output with its own noise variance."""
    if before.held_out is None or after.held_out is None:
        return np.inf if after.held_out is not None else -np.inf
    return _gain(before.fitted, after.fitted, task.fit) + _gain(before.held_out, after.held_out, task.held_out)


def _gain(before: Estimate, after: Estimate, problem: Problem) -> float:
    """The variance that is left but never below the floor: a fit below the floor is chance, not merit."""
    drive = problem.drive
    count = np.array([drive.present[drive.rows_of(record)].sum(axis=0) for record in range(drive.n_records)])
    ratio = np.maximum(before.mean_square, 0.5) / np.maximum(after.mean_square, 0.5)
    return float(np.nansum(count * np.log(ratio)))


def node_of(fitted: Estimate, task: Task, begun: Estimate | None = None) -> Node:
    """Judge a fitted model on the held-out records.

    Args:
        fitted: The model.
        task: Records.
        begun: A like model along the held-out records, from whose initial states to start.
    """
    return Node(fitted=fitted, held_out=judged(fitted, task.held_out, begun), coarse=fitted)


def polished(node: Node, task: Task) -> Node:
    """The node on a finer grid and sharper where a law of it is sharp and that may matter; as it is otherwise."""
    if node.fitted is not node.coarse or not any(is_sharp(item.effect) for item in node.coarse.assembly.placements):
        return node
    if not _blurred(node.coarse, task.fit):
        return node
    finer = _finer(node.coarse, node.coarse.unknowns, task.fit, task.fine_fit)
    if finer is None or finer.cost > node.coarse.cost:
        return node
    held_out = None
    if node.held_out is not None:
        unknowns = replace(finer.unknowns, local=node.held_out.unknowns.local)
        held_out = _finer(node.held_out, unknowns, task.held_out, task.fine_held_out)
    if held_out is None:
        held_out = judged(finer, task.fine_held_out)
    return Node(fitted=finer, held_out=held_out, coarse=node.coarse)


def _blurred(coarse: Estimate, problem: Problem) -> bool:
    """Whether what is left may come from smoothing: twice the smoothing leaves a good deal more."""
    if coarse.level <= NEARLY:
        return True
    twice = simulate_at(
        coarse.assembly,
        coarse.unknowns,
        problem,
        states=coarse.trajectory.states,
        smoothing=2.0 * coarse.smoothing,
        start="near",
    )
    if coarse.level > FAR:
        return twice is not None and twice.level - coarse.level > MOSTLY * (coarse.level - 1.0)
    return twice is None or abs(twice.level - coarse.level) > BLUR * (coarse.level - 1.0)


def on_other_floor(node: Node, fit_ratio: FloatArray, held_out_ratio: FloatArray) -> Node:
    """The node with its residuals in units of another floor, `ratio` times smaller (n_records, n_outputs)."""

    def scaled(one: Estimate, ratio: FloatArray) -> Estimate:
        return replace(one, mean_square=one.mean_square * ratio)

    return Node(
        fitted=scaled(node.fitted, fit_ratio),
        held_out=None if node.held_out is None else scaled(node.held_out, held_out_ratio),
        coarse=scaled(node.coarse, fit_ratio),
    )


def _finer(coarse: Estimate, unknowns: Unknowns, before: Problem, fine: Problem) -> Estimate | None:
    """The fit on the finer grid, sharper and sharper, from the coarse trajectory on; None where a step finds none."""
    drive = fine.drive
    states = np.concatenate(
        [
            _between(coarse.trajectory.states[before.drive.times_of(r)], drive.firsts[r + 1] - drive.firsts[r])
            for r in range(drive.n_records)
        ]
    )
    found = simulate_at(coarse.assembly, unknowns, fine, states=states, smoothing=SHARPER[0])
    for smoothing in SHARPER[1:]:
        if found is None:
            return None
        states = found.trajectory.states
        found = simulate_at(coarse.assembly, unknowns, fine, states=states, smoothing=smoothing)
    return None if found is None else estimate(found, fine, iterations=4)


def _between(states: FloatArray, n_times: int) -> FloatArray:
    at = np.linspace(0.0, len(states) - 1.0, n_times)
    columns = [np.interp(at, np.arange(len(states)), column) for column in states.T]
    return np.array(columns).reshape(-1, n_times).T  # a plant without dynamics has none


def counts(parent: Node, child: Node, task: Task) -> bool:
    """Whether a step is one: the held-out mean square falls by a tenth and the likelihood gains."""
    if not np.isfinite(child.held_out_level):
        return False
    falls = child.held_out_level <= (1.0 - SMALLEST_FALL) * parent.held_out_level
    return falls and log_likelihood_gain(parent, child, task) > SMALLEST_GAIN
