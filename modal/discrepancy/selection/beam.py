"""Beam search for the set of effects that a model lacks.

From a model each effect is screened at each place in observer form, the promising ones are fitted in observer form
(contractive: hardly any local minimum), then in free run, and judged on held-out records. Three distinct models are
carried on, best first and until one explains the data, because the best single effect may be a wrong one that stands
in for two. A step counts only where the held-out mean square falls by a tenth and the likelihood gains: with many
samples a criterion on the likelihood alone finds an effect in nearly every record without one. Where fewer than three
count, the beam has room for models that take away half of what is left on the records to fit: of two effects that
counteract each other, the right one alone may be worse than none on the held-out record.

The work is bounded, and the budget says what was left untried for want of it; beside models that another one with as
many effects has beaten by explaining the data, that does not matter.

A gap spring has a stiffness within the gap and one beyond it, and the element has a linear stiffness beside them: only
two of the three are determined. The one of the effect's that is nearer to zero is put to the linear stiffness and held
there, so that stops have no stiffness before contact and freeplay takes away all of the spring within the gap.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from modal.discrepancy.fitting.estimation import FAR_ABOVE, Estimate, estimate, simulate_at
from modal.discrepancy.fitting.nodes import (
    SMALLEST_FALL,
    Node,
    Task,
    counts,
    loaded,
    node_of,
    polished,
    rested,
    with_released_masses,
)
from modal.discrepancy.fitting.observed_fits import (
    CLEAR,
    MUCH_LESS,
    MUCH_WEAKER,
    SOFT,
    amplitudes,
    observed_fits,
    observed_form,
    scaled,
    weaker_form,
    within_reach,
)
from modal.discrepancy.fitting.observer_form import LOST, LostMotion, graded_run
from modal.discrepancy.selection.lack_of_fit import only_noise
from modal.discrepancy.selection.screening import Candidate, screen_candidates
from modal.discrepancy.selection.smaller_models import Law, is_limit, merged, simple_first
from modal.effects.effect import Effect, ForceEffect
from modal.simulation import AT_FLOOR, explained
from modal.simulation.assembly import Assembly, Unknowns
from modal.simulation.trajectory import SHARP

PLACES, SHAPES = 2, 2
LEAST_SHARE = 0.1
"""Follow a candidate, and a fit, that wins at least this share of what the best one wins."""

CONVINCING, FEWEST = 0.5, 4
"""Follow so many different effects in any case where the best one takes away less than the first share. Go on from a
model that takes away as much on the records to fit although the held-out record does not show it yet."""

TELLING = 1.5
"""Screen along a weaker gain where its best candidate takes away so many times the share that it does with the whole
one."""


def seen(node: Node, task: Task) -> tuple[Estimate, list[Candidate]]:
    """The model in observer form and what is worth a fit, with a weaker gain where that shows more.

    The outputs follow the records so closely under a strong gain that it hides what is narrow in frequency or acts on
    the outputs alone.

    Returns:
        The model along the records, and the candidates: the best first, of the others limits before richer laws.
    """
    observed = observed_form(node.coarse, task)
    screened = screen_candidates(observed, task.fit, task.catalogue)
    weaker = None if _convincing(screened) else weaker_form(observed, task)
    if weaker is not None and weaker.cost < node.coarse.cost:
        other = screen_candidates(weaker, task.fit, task.catalogue)
        if _most(other) > TELLING * _most(screened):
            return weaker, _in_order(_promising(other))
    return observed, _in_order(_promising(screened))


def _most(candidates: Sequence[Candidate]) -> float:
    """What the best of a screen takes away."""
    return candidates[0].fall if candidates else 0.0


def _convincing(candidates: Sequence[Candidate]) -> bool:
    return _most(candidates) >= CONVINCING


def _promising(candidates: Sequence[Candidate]) -> list[Candidate]:
    """The best places of each effect, the best shapes of each place."""
    kept: list[Candidate] = []
    least = LEAST_SHARE * _most(candidates)
    few = 1 if _convincing(candidates) else FEWEST
    for candidate in candidates:
        if candidate.fall < least and len({other.key for other in kept}) >= few:
            break
        same_effect = [other for other in kept if other.key == candidate.key]
        same_place = [other for other in same_effect if other.where == candidate.where]
        places = {other.where for other in same_effect}
        if len(same_place) < SHAPES and (candidate.where in places or len(places) < PLACES):
            kept.append(candidate)
    return kept


def _in_order(candidates: Sequence[Candidate]) -> list[Candidate]:
    """The best first, of the others limits before richer laws."""
    others = simple_first(
        candidates[1:], lambda one: (one.key, one.where), lambda simple, rich: simple.fall >= MUCH_LESS * rich.fall
    )
    return [*candidates[:1], *others]


def settled_stiffness(fitted: Estimate) -> tuple[Assembly, Unknowns] | None:
    """The model with the smallest of such stiffnesses moved to the linear one.

    Returns:
        The model and the values to start from; None where there is nothing to settle, or the linear stiffness would
        leave its bounds.
    """
    assembly, common = fitted.assembly, fitted.unknowns.common.copy()
    placements = list(assembly.placements)
    lower, upper = assembly.bounds()
    changed = False
    for i, item in enumerate(placements):
        shared = getattr(item.effect, "beside_stiffness", ())
        linear = assembly.stiffness_parameter(i) if shared else None
        if linear is None or item.held:
            continue
        names = [kind.name for kind in item.effect.parameters]
        index = {name: assembly.common_of(i).start + item.common.index(names.index(name)) for name in shared}
        smallest = min(index, key=lambda name: abs(common[index[name]]))
        moved = common[index[smallest]]
        if not lower[linear] <= common[linear] + moved <= upper[linear]:
            continue
        common[linear] += moved
        for name in shared:
            common[index[name]] -= moved
        placements[i] = replace(item, held=(names.index(smallest),))
        changed = True
    if not changed:
        return None
    settled = replace(assembly, placements=tuple(placements))
    lower, upper = settled.bounds()
    return settled, Unknowns(common=np.clip(common, lower, upper), local=fitted.unknowns.local)


RUNS = 8
"""Let at most so many fits run free, beside the best of each family."""
FINALISTS = 5
"""Sharpen at most so many free runs, beside the best of each family."""
NEAR = 20.0
"""Drop a fit whose cost is more than this factor above the best one's."""
FIRST_ITERATIONS, LAST_ITERATIONS = 15, 6
STANDSTILL = {FIRST_ITERATIONS: 3e-4, LAST_ITERATIONS: 3e-3}
"""End a finalist's fit when an iteration gains less than this share; the most promising one and its close rivals are
fitted longest."""
MOST_FREE, MOVING_FREE = 6, 0.03
"""End first fits in free run after so many iterations, or when one gains less than the second share."""
REACH, REACH_SHARP = 10.0, 2.0
"""Sharpen others, once a finalist explains the data, whose cost is within this factor of its own; the lower one where
the fits are sharp already."""
RIVAL = 1.5
"""Follow, once a model explains the data, others whose cost is within this factor of the best."""
RIVAL_SHARP = 1.03
"""Follow only rivals within this factor where the fits are sharp already: costs compare then."""


def expand(node: Node, task: Task, heavier: Sequence[Node] | None = None) -> list[Node]:
    """Models with one effect more, or with other masses, which are fitted unless they were before."""
    observed, candidates = seen(node, task)
    if node.held_out_level <= AT_FLOOR and (not candidates or candidates[0].fall < SMALLEST_FALL):
        return []
    found = list(_heavier(node, task) if heavier is None else heavier)
    if found and found[0].held_out_level <= AT_FLOOR and _clear(found, node):
        candidates = [one for one in candidates if one.placement.effect.like_a_mass]
    while candidates:
        fits, candidates = observed_fits(node, observed, candidates, task)
        fits = [fit for fit in fits if fit.level <= task.reached]
        runs, known = _free_runs(_ordered(_leading(_worth(fits, observed), RUNS)), task, node)
        found += _judged(_leading(runs, FINALISTS), task, known, reach=REACH_SHARP if node.effects else REACH)
        # far above the floor an effect that takes most away may stand for two: there all are tried beside the model
        if _clear(found, node) and (node.effects or _reached(found) <= FAR_ABOVE):
            break
    return found


def _heavier(node: Node, task: Task) -> list[Node]:
    """The model with other masses; none where no mass may be wrong."""
    found = with_released_masses(node, task)
    return [] if found is None else [found]


def _masses_first(front: Sequence[Node], task: Task) -> list[tuple[Node, list[Node] | None]]:
    """The models to go on from, each with itself with other masses: first those that these make explain the data.

    Of two laws beside a wrong mass the wrong one may lead, and another effect beside it costs many times what the
    masses do. A model without effects has no rival to go before.
    """
    if not any(node.effects for node in front):
        return [(node, None) for node in front]
    both: list[tuple[Node, list[Node] | None]] = []
    for i, node in enumerate(front):
        if task.budget.left <= 0.0 or node.held_out_level <= AT_FLOOR:
            both.append((node, None))
            continue
        task.report(f"other masses beside {_named(node)}", len(node.effects) / MOST_EFFECTS)
        heavier = _heavier(node, task)
        if _explain(heavier):
            return [(node, heavier), *both, *((other, None) for other in front[i + 1 :])]
        both.append((node, heavier))
    return both


def _clear(found: Sequence[Node], node: Node) -> bool:
    """Whether one explains nearly everything in free run too: in observer form the outputs hide what is left."""
    clear = [one for one in found if one.fit_level - 1.0 <= CLEAR * (node.fit_level - 1.0)]
    return any(not one.by_record or explained(one.held_out_level) for one in clear)


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
    return [polished(node, task) if node.coarse.cost <= RIVAL * lowest else node for node in found]


def _finished(fit: Estimate, best: Estimate, task: Task) -> Node:
    """A free run sharpened, longest where it is close to the best one, and judged on the held-out records."""
    iterations = FIRST_ITERATIONS if fit.cost <= RIVAL * best.cost else LAST_ITERATIONS
    return node_of(_sharpened(fit, task, iterations=iterations), task)


def _softness(node: Node) -> float:
    """Smoothing of a first fit: soft beside a linear model, sharp where an effect is there already that may need it."""
    return SHARP if node.effects else SOFT


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
        if _enough(fit, finished, node, task):
            continue
        if runs and not budget.allows():
            break
        run = _free_run(fit, task, _softness(node))
        if not (explained or _nearly(runs, node)):
            run = _found_again(run, fit, task, _softness(node))
        if run is None:
            continue
        if all(run.cost < other.cost for other in runs):
            finished[id(run)] = _finished(run, run, task)
        runs.append(run)
    return runs, finished


def _enough(fit: Estimate, finished: dict[int, Node], node: Node, task: Task) -> bool:
    """Whether a limit of the law leaves nothing but noise: then nothing is there for what the law has besides."""
    for run, one in finished.items():
        if is_limit(_law_of(one.coarse), _law_of(fit)):
            finished[run] = polished(one, task)
            if only_noise(finished[run], node, task):
                return True
    return False


def _nearly(runs: Sequence[Estimate], node: Node) -> bool:
    return any(explained(run.level) if node.effects else run.level <= AT_FLOOR for run in runs)


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
        again = None if run is None else loaded(run, task.fit)
        if again is not None and again is not run:
            run = estimate(again, task.fit, iterations=MOST_FREE, standstill=MOVING_FREE)
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
    """The fits, best first, but limits before richer laws: in observer form and soft, what these win tells little."""
    return simple_first(fits, _law_of, lambda _simple, _rich: True)


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


BEAM = 3
"""Carry on so many models from effect to effect."""
MOST_EFFECTS = 4
"""Look for at most so many effects."""
SHARE_OF_ONE = 0.6
"""Spend at most this share of what is left of the budget on effects beside one model."""
Curves = Callable[[Node, Node, Task], list[Node]]
"""Models with a law of unknown form beside the first model that leave nothing but noise; the second is the root."""


def search_effects(
    root: Node, task: Task, known: Sequence[Node] = (), *, curves: Curves | None = None
) -> tuple[Node, ...]:
    """All models worth a look, from the calibrated one on.

    Where no single effect explains the data and a single law of unknown form does, pairs are tried of laws of its
    motion only: two of them at one place are one law, and may be what the curve is made of. Where the best model leaves
    nothing but noise, though more than the floor says, the search ends.

    Every model judged on held-out records, in the order found.
    """
    everything = list(known) if known else [root]
    front = _distinct([node for node in known if counts(root, node, task)])
    if known and not front:
        return tuple(everything)
    front, untried, cut = front or [root], np.inf, False
    for depth in range(max(len(node.effects) for node in front) - len(root.effects), MOST_EFFECTS):
        lowest = min(node.held_out_level for node in front)
        far = depth > 1 and lowest > FAR_ABOVE  # three are never firm: the best guess alone goes on
        front = front[:1] if far else front
        if (depth > 0 and lowest <= AT_FLOOR) or (far and not _worth_more(front[0], everything, root)):
            break
        children: list[Node] = []
        hopeful: list[Node] = []
        here = np.inf
        for position, (node, heavier) in enumerate(_masses_first(front, task)):
            if task.budget.left <= 0.0:
                here, cut = depth + 1, True
                break
            share = (depth + position / len(front)) / MOST_EFFECTS
            task.report(f"looking for effect {depth + 1} beside {_named(node)}", share)
            part = task.budget.part(SHARE_OF_ONE)
            beside = expand(node, replace(task, budget=part), heavier)
            simpler = (merged(child, task) for child in beside if counts(node, child, task))
            beside += [one for one in simpler if one is not None]
            everything += beside
            children += [child for child in beside if counts(node, child, task)]
            hopeful += [child for child in beside if _hopeful(node, child)]
            cut = cut or part.spent
            if _explain(children):
                here = depth + 1 if part.spent else np.inf
                break
            here = depth + 1 if part.spent else here
        untried = min(untried, here)
        if not _explain(children) and only_noise(_lowest(children, root), root, task):
            break
        wanted = depth == 0 and not _explain(children)
        found = curves(root, root, replace(task, reached=_reached(children))) if curves and wanted else []
        everything += found
        task = replace(task, catalogue=_laws_like(found, task))
        front = _distinct([child for child in children if not child.by_record])
        reached = _reached([*children, *hopeful])
        hopeful = [child for child in hopeful if (1.0 - CONVINCING) * child.fit_level <= reached]
        front += _distinct([child for child in hopeful if _new(child, front)])[: BEAM - len(front)]
        front += _distinct([child for child in children if child.by_record and _new(child, front)])[:1]
        if not front:
            break
    if cut:
        task.budget.refuse(untried)
    return tuple(everything)


def _worth_more(best: Node, everything: Sequence[Node], root: Node) -> bool:
    """Whether a third effect is sought beside two that are far above the floor: nothing else explains the data.

    Two that explain nearly all of the gap are no chance: a zero and the first term of a law leave its next one, many
    times the noise of a good circuit.
    """
    clear = best.held_out_level - 1.0 <= CLEAR * (root.held_out_level - 1.0)
    return clear and not _explain(everything)


def _laws_like(curves: Sequence[Node], task: Task) -> dict[str, Effect]:
    """The memoryless laws of the motions of some laws of unknown form; all effects where there are none."""
    if not curves:
        return dict(task.catalogue)
    last = [node.coarse.assembly.placements[-1].effect for node in curves]
    motions = [one.needs for one in last if isinstance(one, ForceEffect)]
    return {
        key: one
        for key, one in task.catalogue.items()
        if isinstance(one, ForceEffect) and one.needs in motions and not one.n_memory
    }


def _lowest(nodes: Sequence[Node], root: Node) -> Node:
    return min(nodes, key=lambda node: node.held_out_level, default=root)


def _reached(nodes: Sequence[Node]) -> float:
    """The lowest level on the records to fit."""
    return min((node.fit_level for node in nodes), default=np.inf)


def _explain(children: Sequence[Node]) -> bool:
    return any(child.held_out_level <= AT_FLOOR for child in children)


def _named(node: Node) -> str:
    names = [*(f"{effect} at {where}" for effect, where in node.effects), *node.masses]
    return ", ".join(names) or "the linear model"


def _distinct(children: Sequence[Node]) -> list[Node]:
    kept: list[Node] = []
    for child in sorted(children, key=lambda node: node.held_out_level):
        if _new(child, kept):
            kept.append(child)
    return kept[:BEAM]


def _hopeful(node: Node, child: Node) -> bool:
    return bool(np.isfinite(child.held_out_level)) and child.fit_level <= (1.0 - CONVINCING) * node.fit_level


def _new(child: Node, front: Sequence[Node]) -> bool:
    return all({*child.effects, *child.masses} != {*other.effects, *other.masses} for other in front)
