"""Try every effect beside a model: screen, fit in observer form, let the promising ones run free, sharpen the best."""

from collections.abc import Mapping, Sequence

from modal.discrepancy.fitting.estimation import Estimate, estimate, simulate_at
from modal.discrepancy.fitting.graded import LOST, LostMotion, graded_run
from modal.discrepancy.fitting.held_out import rested
from modal.discrepancy.fitting.nodes import Node, Task, node_of, polished
from modal.discrepancy.fitting.observed_fits import CLEAR, SOFT, observed_fits
from modal.discrepancy.fitting.within_reach import amplitudes, scaled, within_reach
from modal.discrepancy.selection.promising import seen
from modal.discrepancy.selection.settling import settled_stiffness
from modal.discrepancy.selection.simpler_laws import Law, is_limit, simple_first
from modal.simulation.tolerances import AT_FLOOR
from modal.simulation.trajectory import SHARP

__all__ = ["expand"]


WORTH_A_TRY = 0.1
"""Beside a model that explains the data, effects are tried only where the screen promises a fall by this share."""

LEAST_SHARE = 0.1
"""A fit is followed while it wins at least this share of what the best one wins."""

RUNS = 8
FINALISTS = 5
NEAR = 20.0
FIRST_ITERATIONS, LAST_ITERATIONS = 15, 6
STANDSTILL = {FIRST_ITERATIONS: 3e-4, LAST_ITERATIONS: 3e-3}
"""The most promising finalist and its close rivals are fitted longest; a fit ends when an iteration gains less than
this share."""
MOST_FREE, MOVING_FREE = 6, 0.03
"""First fits in free run end when an iteration gains less than this share."""
POLISHED = 1.5
REACH, REACH_SHARP = 10.0, 2.0
"""Once a finalist explains the data, others are sharpened whose cost is within this factor of its own; the lower one
where the fits are sharp already."""
RIVAL = 1.5
"""Once a model explains the data, others are followed whose cost in observer form is within this factor of the best."""
NEARLY, RIVAL_SHARP = 1.5, 1.03
"""The same where the fits are sharp already: then a model that nearly explains the data is enough; costs compare."""

MUCH_WEAKER = 0.1
"""Share of a law's strength from which it starts again where no step leads anywhere from the whole."""


def expand(node: Node, task: Task) -> list[Node]:
    """Models with one effect more."""
    observed, candidates = seen(node, task)
    if not candidates:
        return []
    if node.held_out_level <= AT_FLOOR and candidates[0].fall < WORTH_A_TRY:
        return []
    found: list[Node] = []
    while candidates and not _clear(found, node):
        fits, candidates = observed_fits(node, observed, candidates, task)
        runs, known = _free_runs(_ordered(_leading(_worth(fits, observed), RUNS)), task, node)
        found += _judged(_leading(runs, FINALISTS), task, known, reach=REACH_SHARP if node.effects else REACH)
    return found


def _clear(found: Sequence[Node], node: Node) -> bool:
    """Whether one explains nearly everything in free run too: in observer form the outputs hide what is left."""
    return any(one.fit_level - 1.0 <= CLEAR * (node.fit_level - 1.0) for one in found)


def _judged(finalists: Sequence[Estimate], task: Task, known: Mapping[int, Node], *, reach: float) -> list[Node]:
    """Finalists sharpened and judged on held-out records; once one explains the data, only those in its reach.

    What needs a finer grid gets it where it is among the best, because it costs several times as much.
    """
    found: list[Node] = list(known.values())
    for fit in finalists:
        explaining = [node for node in found if node.held_out_level <= AT_FLOOR]
        far = explaining and fit.cost > reach * min(node.coarse.cost for node in explaining)
        if id(fit) not in known and not far and (not found or task.budget.allows()):
            found.append(_finished(fit, finalists[0], task))
    lowest = min((node.coarse.cost for node in found), default=0.0)
    return [polished(node, task) if node.coarse.cost <= POLISHED * lowest else node for node in found]


def _finished(fit: Estimate, best: Estimate, task: Task) -> Node:
    """A free run sharpened, longest where it is close to the best one, and judged on the held-out records."""
    iterations = FIRST_ITERATIONS if fit.cost <= RIVAL * best.cost else LAST_ITERATIONS
    return node_of(_sharpened(fit, task, iterations=iterations), task)


def _softness(node: Node, softness: float) -> float:
    """Smoothing of a first fit: soft beside a linear model, sharp where an effect is there already that may need it."""
    return SHARP if node.effects else softness


def _free_runs(fits: Sequence[Estimate], task: Task, node: Node) -> tuple[list[Estimate], dict[int, Node]]:
    """Free runs, the most promising first; once one explains the data, only its close rivals are followed.

    Returns:
        The runs, and the models of those that were the best of all when they came, finished at once, by `id` of the
        run: most often the first one explains the data and spares the others.
    """
    rival = RIVAL_SHARP if node.effects else RIVAL
    budget = task.budget.stage()
    lowest = min((fit.cost for fit in fits), default=0.0)
    runs: list[Estimate] = []
    finished: dict[int, Node] = {}
    for fit in fits:
        explained = any(one.held_out_level <= AT_FLOOR for one in finished.values())
        if (explained or _nearly(runs, node)) and fit.cost > rival * lowest:
            continue
        if runs and not budget.allows():
            break
        run = _free_run(fit, task, _softness(node, SOFT))
        if not (explained or _nearly(runs, node)):
            run = _found_again(run, fit, task, _softness(node, SOFT))
        if run is None:
            continue
        if all(run.cost < other.cost for other in runs):
            finished[id(run)] = _finished(run, run, task)
        runs.append(run)
    return runs, finished


def _nearly(runs: Sequence[Estimate], node: Node) -> bool:
    return any(run.level <= (NEARLY if node.effects else AT_FLOOR) for run in runs)


def _free_run(fit: Estimate, task: Task, smoothing: float) -> Estimate | None:
    """Let a model that was fitted in observer form run free, and fit it a little.

    From a law that is far too hard (a brim, a stop) no step may lead anywhere; then it starts again much weaker.
    """
    found: Estimate | None = None
    for share in (1.0, MUCH_WEAKER) if amplitudes(fit.assembly) else (1.0,):
        unknowns = scaled(fit.assembly, fit.unknowns, share)
        start = within_reach(fit.assembly, unknowns, task, fit.trajectory.states, smoothing=smoothing)
        start = None if start is None else rested(start, task.fit)
        run = None if start is None else estimate(start, task.fit, iterations=MOST_FREE, standstill=MOVING_FREE)
        if run is not None and (found is None or run.cost < found.cost):
            found = run
        if found is not None and found.iterations > 0:
            break
    return found


def _found_again(run: Estimate | None, fit: Estimate, task: Task, smoothing: float) -> Estimate | None:
    """The free run, or where that is lost, the one that is come to gain by gain.

    Raises:
        LostMotion: There is none, because the motion cannot be followed along whole records.
    """
    if run is not None and run.cost <= LOST * fit.cost:
        return run
    try:
        start = graded_run(fit, task.fit, smoothing=smoothing)
    except LostMotion:
        if task.whole:
            raise
        return run
    graded = None if start is None else estimate(start, task.fit, iterations=MOST_FREE, standstill=MOVING_FREE)
    return graded if run is None or (graded is not None and graded.cost < run.cost) else run


def _worth(fits: Sequence[Estimate], observed: Estimate) -> list[Estimate]:
    """The fits that win a good share of what the best one wins over the model without the effect."""
    most = max((observed.cost - fit.cost for fit in fits), default=0.0)
    good = [fit for fit in fits if observed.cost - fit.cost >= LEAST_SHARE * most]

    def astray(fit: Estimate) -> bool:
        """A richer law that does not even fit as well as its limit is followed through that."""
        return any(is_limit(_law_of(other), _law_of(fit)) and other.cost <= fit.cost for other in good)

    return [fit for fit in good if not astray(fit)]


def _ordered(fits: Sequence[Estimate]) -> list[Estimate]:
    """The fits, best first, but limits of richer laws before these where they fit nearly as well."""
    return simple_first(fits, _law_of, lambda simple, rich: simple.cost <= RIVAL * rich.cost)


def _law_of(fit: Estimate) -> Law:
    """A fit's last effect and its place."""
    item = fit.assembly.placements[-1]
    return item.effect.key, item.where


def _leading(fits: Sequence[Estimate], most: int) -> list[Estimate]:
    """The best fit of each effect at each place; of these the best ones, and of each family the best within reach."""
    ranked = sorted(fits, key=lambda fit: fit.cost)
    kept: list[Estimate] = []
    for fit in ranked:
        item = fit.assembly.placements[-1]
        twins = [other.assembly.placements[-1] for other in kept]
        if any(twin.effect.key == item.effect.key and twin.where == item.where for twin in twins):
            continue
        lone = all(twin.effect.family != item.effect.family for twin in twins)
        if (len(kept) < most or lone) and fit.cost <= NEAR * ranked[0].cost:
            kept.append(fit)
    return kept


def _sharpened(fit: Estimate, task: Task, *, iterations: int) -> Estimate:
    start = simulate_at(fit.assembly, fit.unknowns, task.fit, states=fit.trajectory.states, smoothing=SHARP)
    if start is None:
        return fit
    fitted = estimate(start, task.fit, iterations=iterations, standstill=STANDSTILL[iterations])
    settled = settled_stiffness(fitted)
    if settled is None:
        return fitted
    again = simulate_at(*settled, task.fit, states=fitted.trajectory.states, smoothing=SHARP)
    return fitted if again is None else estimate(again, task.fit, iterations=6)
