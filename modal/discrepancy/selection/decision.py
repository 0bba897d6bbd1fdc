"""Decide what is missing: named, unresolved or none, from the models that the search has fitted.

`named` needs three things: within 1.5 of the noise floor on held-out data; every effect of the model earns its place
(without it the held-out mean square rises by a tenth and the likelihood falls); and a lead over every model with
another effect or place, other than those that by structure cannot be told apart. Anything less is a best guess.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from modal.discrepancy.fitting.estimation import (
    FAR_ABOVE,
    Problem,
    covariance,
)
from modal.discrepancy.fitting.nodes import (
    MOST_ON_FIT,
    SMALLEST_FALL,
    SMALLEST_GAIN,
    Node,
    Task,
    counts,
    explains_both,
    log_likelihood_gain,
    needed_masses,
)
from modal.discrepancy.fitting.observed_fits import CLEAR
from modal.discrepancy.results import EVEN, Finding, LackOfFit, LawCurve, masses_text, worst_left, worst_text
from modal.discrepancy.selection.beam import search_effects
from modal.discrepancy.selection.form_free import CurveSearch
from modal.discrepancy.selection.lack_of_fit import lack_of_fit, undecided_laws, what_is_left
from modal.discrepancy.selection.smaller_models import (
    AbsorbedGain,
    absorbed_gain,
    at_limits,
    doubted_gains,
    has_limit,
    sureness,
    undetermined,
    undriven_models,
    without,
)
from modal.discrepancy.setup import BY_MODEL, Setup, circumstances_of, with_coloured_floor, with_uncovered_floor
from modal.effects.ambiguity import ambiguous_with
from modal.effects.catalogue import effects_at
from modal.effects.effect import is_form_free
from modal.simulation import AT_FLOOR, NEAR_FLOOR, SURE, explained
from modal.simulation.assembly import EffectPlacement
from modal.simulation.scheme import Budget
from modal.structure.placed import possible_places
from modal.wording.text import listed, number, percent, times_floor_text
from okid.arrays import TINY, BoolArray
from okid.display import Displayed
from okid.record import Record

MOST_FIRM = 2
"""Name at most so many effects together without doubt: combinations of more were never proved."""

SAME = 1.05
"""Rank models by the likelihood of all records where their held-out mean squares differ by less than this."""

CLEAR_RISE = 3.0
"""Keep an effect without which the held-out mean square rises by this factor, however uncertain its size."""
LEAST_SURE = 5.0
"""Drop an effect nearer to none than so many standard deviations: 2 ln L of 30 is five and a half."""
SHARP_SHARE = 0.05
"""Count a parameter as found at its known value within three deviations of it, where these are below this share of
it."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Decision(Displayed):
    """What was decided.

    Attributes:
        status: "named", "unresolved" or "none".
        node: The model chosen (the calibrated linear model for "none").
        runners: For each effect of it, the best other model without that effect at that place, None if there is none.
        margins: 2 ln L by which the chosen model leads each runner-up.
        reasons: Why it is not firm, in words; empty for "named" and "none".
        even: For each effect of it, (key, place) of the effects that explain the data as well in its place.
        lack_of_fit: Tests of what the model chosen leaves, the least probable first.
        notes: What it leaves although it is firm, in words.
        findings: The effects found, as in a diagnosis.
        laws: All laws of the model, likewise.
    """

    status: Literal["named", "unresolved", "none"]
    node: Node
    runners: tuple[Node | None, ...]
    margins: tuple[float, ...]
    reasons: tuple[str, ...]
    even: tuple[tuple[tuple[str, str], ...], ...] = ()
    lack_of_fit: tuple[LackOfFit, ...] = ()
    notes: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    laws: tuple[LawCurve, ...] = ()


def search_and_decide(setup: Setup, as_given: Node, root: Node) -> tuple[Setup, tuple[Node, ...], Node, Decision]:
    """Search beside the calibrated model, look at the floor again, and choose.

    Returns:
        The setup by the floor that the search has shown, the models, the model as given, the decision.
    """
    curves = CurveSearch()
    nodes = search_effects(root, setup.task, curves=curves)
    setup, nodes, as_given = with_coloured_floor(*with_uncovered_floor(setup, nodes, as_given))
    setup.task.report("deciding", 0.9)
    found = decide_nodes(nodes, setup.task, setup.fit, curves)
    if BY_MODEL in setup.said and not found.lack_of_fit:  # then nothing tests the model
        found = replace(found, status="unresolved", reasons=(*found.reasons, BY_MODEL), notes=())
    return setup, nodes, as_given, found


def decide_nodes(
    nodes: Sequence[Node], task: Task, fits: Sequence[Record], curves: CurveSearch | None = None
) -> Decision:
    """Choose among the models that the search has fitted, the first being the linear one.

    Args:
        nodes: The models.
        task: What they were fitted to, and laws of unknown form for where none of them is enough.
        fits: The records to fit.
        curves: What the search has found of such laws.
    """
    root, curves = nodes[0], CurveSearch() if curves is None else curves
    earned = [node for node in nodes if node is root or counts(root, node, task)]
    best = _best(earned, root, task)
    if best is not root:
        best = _pruned(best, root, task)
        equals = [node for node in earned if _size(node) == _size(best)]
        equals = [node for node in equals if node.held_out_level <= max(SAME * best.held_out_level, 1.0)]
        if len(equals) > 1 and best.held_out_level <= FAR_ABOVE:
            best = min([best, *equals], key=lambda node: criterion(node, root, task))
        best = min([best, *at_limits(best, task)], key=lambda node: criterion(node, root, task))
    if best is root:
        nothing = _nothing(root, task)
        found = nothing.status == "none" or nothing.node is not root
        return nothing if found else _by_curve(nothing, nodes, task, fits, curves)
    if len(best.effects) == len(root.effects):
        return _only_masses(best, root, earned, task)
    others = [*nodes, best]
    return _by_curve(_judged(best, others, root, task, fits), others, task, fits, curves)


def _by_curve(
    named: Decision, others: Sequence[Node], task: Task, fits: Sequence[Record], curves: CurveSearch
) -> Decision:
    """The decision, or a law of unknown form where the one with a name leaves something that a curve does not."""
    root = others[0]
    if not task.form_free or (named.status != "named" and not _leaves(named, root)):
        return named
    if named.status == "named":
        return _cornered(named, root, task, curves)
    single = len(named.node.effects) - len(root.effects) == 1 and not _n_free(named.node)
    rivals = [node for node in others if node is not named.node]  # it was refused for what it leaves
    for parent in (*([] if _n_free(named.node) else [root]), *([named.node] if single else [])):
        task.report("fitting laws of unknown form", 0.92)
        known = [node for node in rivals if _n_free(node)] if parent is root else []
        fitted = known or curves(parent, root, task)
        found = [_judged(node, [*rivals, node], root, task, fits) for node in fitted]
        passed = [decision for decision in found if decision.status == "named"]
        if passed:
            return min(passed, key=lambda one: criterion(one.node, root, task))
    return named


def _cornered(named: Decision, root: Node, task: Task, curves: CurveSearch) -> Decision:
    """The decision; not firm where a smooth law does as well as one that bends at a point.

    A corner that the records do not resolve may be none: every hardening spring looks like a stop from far enough.
    """
    found = _found(named.node, root)
    if len(found) != 1 or found[0].effect.n_memory or not getattr(found[0].effect, "has_corners", False):
        return named
    even = [node for node in curves(root, root, task) if log_likelihood_gain(node, named.node, task) < EVEN]
    rival = _strongest(even, root, task)
    if rival is None:
        spent = not Budget().allows()  # the CPU time: no smooth law was tried to its end
        return replace(named, status="unresolved", reasons=(NO_CURVE_TRIED,), notes=()) if spent else named
    runner = _strongest([node for node in (named.runners[-1], rival) if node is not None], root, task)
    margin = min(named.margins[-1], log_likelihood_gain(rival, named.node, task))
    return replace(
        named,
        status="unresolved",
        runners=(*named.runners[:-1], runner),
        margins=(*named.margins[:-1], margin),
        reasons=(f"{_as_well(rival, named.node, task)}; motion well short of the corner and far beyond it would tell",),
        even=(*named.even[:-1], (*named.even[-1], *rival.effects[len(root.effects) :])),
        notes=(),
    )


NO_CURVE_TRIED = (
    "the budget was spent before a smooth law was tried in place of one that bends at a point, and from far enough "
    "every hardening spring looks like a stop; give more CPU seconds"
)


def _as_well(rival: Node, best: Node, task: Task) -> str:
    """That another model explains the data as well, in words."""
    margin = log_likelihood_gain(rival, best, task)
    other = effects_at(rival.effects) or listed(list(rival.masses))
    well = "as well (2 ln L lower" if margin >= 0.0 else "at least as well (2 ln L higher"
    return f"{other} explains the data {well} by {abs(margin):.0f})"


def _n_free(node: Node) -> int:
    """How many laws of unknown form a model has."""
    return sum(is_form_free(item.effect) for item in node.coarse.assembly.placements)


def _size(node: Node) -> int:
    """How many effects and other masses a model has; a law of unknown form is two: two at one place are one law."""
    return node.size + _n_free(node)


def _leaves(decision: Decision, root: Node) -> bool:
    """Whether a model leaves something that is no noise."""
    if decision.node is root or not explains_both(decision.node):
        return True
    return bool(what_is_left(decision.lack_of_fit, decision.node, root)[0])


def _judged(best: Node, others: Sequence[Node], root: Node, task: Task, fits: Sequence[Record]) -> Decision:
    """A model that was chosen, against all others and against what it leaves."""
    runners, margins, even, reasons = [], [], [], []
    circumstances = circumstances_of(best.coarse.assembly.plant, fits, best)
    others = [*others, *undriven_models(best, task)]
    lowest = criterion(best, root, task)
    for effect in best.effects:
        rivals = [node for node in others if node is not root and _rivals(node, best, effect, task)]
        runner = _strongest(rivals, root, task)
        runners.append(runner)
        margins.append(np.inf if runner is None else log_likelihood_gain(runner, best, task))
        near = [node for node in rivals if _size(node) <= _size(best) and criterion(node, root, task) - lowest < EVEN]
        even.append(tuple(dict.fromkeys(other for node in near for other in node.effects if other not in best.effects)))
        same = {key for row in ambiguous_with(effect[0], circumstances=circumstances) for key in row.effects}
        rival = _strongest([node for node in near if same.isdisjoint(key for key, _ in node.effects)], root, task)
        if rival is not None:
            reasons.append(_as_well(rival, best, task))
    tests = lack_of_fit(best, task, known=len(root.effects))
    refused, notes = what_is_left(tests, best, root)
    if not explained(best.held_out_level):
        reasons.append(
            f"the held-out gap is still {times_floor_text(best.held_out_level)} times the noise floor (limit "
            f"{times_floor_text(NEAR_FLOOR)})"
        )
    elif best.held_out_level > AT_FLOOR and best.held_out_level - 1.0 > CLEAR * (root.held_out_level - 1.0):
        share = np.sqrt((best.held_out_level - 1.0) / max(root.held_out_level - 1.0, TINY))
        reasons.append(
            f"{percent(float(share))} of the held-out gap above the noise is left: noise of another colour, or a force "
            "that nobody measured"
        )
    reasons += _unproved(best, root) + undetermined(best, root, task, fits, circumstances)
    reasons += doubted_gains(best, root) + refused
    reasons += _untried(best, task, most=len(best.effects) - len(root.effects))
    reasons += [] if reasons else undecided_laws(best, task, known=len(root.effects))
    return Decision(
        status="unresolved" if reasons else "named",
        node=best,
        runners=tuple(runners),
        margins=tuple(float(margin) for margin in margins),
        reasons=tuple(reasons),
        even=tuple(even),
        lack_of_fit=tests,
        notes=tuple(notes) if not reasons else (),
    )


def _only_masses(best: Node, root: Node, nodes: Sequence[Node], task: Task) -> Decision:
    """Other masses explain the data: no effect is missing, unless one that is no more than they leads or comes near."""
    best = needed_masses(best, task) if explained(best.held_out_level) else best
    if not best.masses:
        return _nothing(root, task)
    most = criterion(best, root, task) + EVEN
    near = [node for node in nodes if _size(node) <= _size(best) and criterion(node, root, task) < most]
    near = [
        node for node in near if not _hung(node, best, root) or log_likelihood_gain(best, node, task) > SMALLEST_GAIN
    ]
    rivals = sorted({effects_at(node.effects) for node in near if len(node.effects) > len(root.effects)})
    others, far = masses_text(best.masses), not explained(best.held_out_level, best.fit_level)
    does = "comes as near to the data as" if far else "explains the data as well as"
    reasons = [f"{rival} {does} {others}" for rival in rivals]
    tests = lack_of_fit(best, task, known=len(root.effects))
    worst = worst_left(tests)
    if far:
        held = not explained(best.held_out_level)
        reasons.append(
            f"{others} {'is' if len(best.masses) == 1 else 'are'} not all: on the "
            f"{'held-out records' if held else 'records to fit'} the gap is still "
            f"{times_floor_text(best.held_out_level if held else best.fit_level)} times the noise floor"
        )
    elif worst is not None:
        reasons.append(f"beside {others}, {worst_text(worst)}")
    before = len(root.effects)
    return Decision(
        status="unresolved" if reasons else "none",
        node=best,
        runners=(None,) * before,
        margins=(float("inf"),) * before,
        reasons=tuple(reasons),
        lack_of_fit=tests,
        notes=(LIKE_NOISE,) if best.held_out_level > AT_FLOOR and not reasons else (),
    )


def _hung(node: Node, best: Node, root: Node) -> bool:
    """Whether a model has only masses on springs where the best one has other masses: these are its limit.

    Like any richer law it always fits about as well.
    """
    plant = best.coarse.assembly.plant
    if plant.inertia is None or not best.masses:
        return False
    moved: BoolArray = np.asarray(plant.inertia[-len(best.masses) :].any(axis=(0, 1)))
    return all(
        item.effect.key == "missing_mode"
        and item.port is not None
        and item.port.velocity is not None
        and not item.port.velocity[: len(moved)][~moved].any()
        for item in _found(node, root)
    )


def criterion(node: Node, root: Node, task: Task) -> float:
    """S = -2 ln L + k ln n + 2 ln(places tried), over the records to fit and the held-out ones, from the linear model.

    References:
        Schwarz, Estimating the dimension of a model, Ann. Statist. 6, 1978, https://doi.org/10.1214/aos/1176344136
    """
    plant = node.coarse.assembly.plant
    places = sum(np.log(len(possible_places(plant, item.effect))) for item in node.coarse.assembly.placements)
    return float(_cost_of_freedom(node, task) + 2.0 * places - log_likelihood_gain(root, node, task))


def _found(best: Node, root: Node) -> tuple[EffectPlacement, ...]:
    return best.coarse.assembly.placements[len(root.effects) :]


def _unproved(best: Node, root: Node) -> list[str]:
    """Why a model that explains the held-out records is still not firm."""
    reasons = []
    if explained(best.held_out_level) and best.fit_level > MOST_ON_FIT:
        reasons.append(
            f"on the records to fit the gap is still {times_floor_text(best.fit_level)} times the noise floor (limit "
            f"{times_floor_text(MOST_ON_FIT)})"
        )
    found, masses = len(best.effects) - len(root.effects), best.masses != root.masses
    if found + masses > MOST_FIRM:
        also = f" and {masses_text(best.masses)}" if masses else ""
        reasons.append(
            f"{found} effects{also} at once fit many a law that is none of them: {MOST_FIRM} at most are named firmly"
        )
    return reasons


def _untried(best: Node, task: Task, *, most: float) -> list[str]:
    """Whether models with no more effects were left untried, or any where the best does not explain the data."""
    if not task.budget.spent or (explained(best.held_out_level) and task.budget.untried > most):
        return []
    words = (
        "the search was ended before every effect was tried, because it cost as much as it may: what is missing may "
        "not be in the catalogue, or the motion is hard to follow; try fewer effects, or a part of the records"
    )
    return [words]


def _nothing(root: Node, task: Task) -> Decision:
    """No effect is found: nothing is missing where the linear model explains the data, and else what is stays open."""
    explains = explained(root.held_out_level, root.fit_level)
    absorbed = absorbed_gain(root, task) if explains else None
    if absorbed is not None:
        return _absorbed(root, absorbed)
    tests = lack_of_fit(root, task)
    worst = worst_left(tests)
    words = "" if worst is None else worst_text(worst)
    if explains:
        left = (f"no effect that was tried counts, but {words}",) if words else ()
        status: Literal["none", "unresolved"] = "unresolved" if left else "none"
        notes = (LIKE_NOISE,) if root.held_out_level > AT_FLOOR and not left else ()
        return Decision(status=status, node=root, runners=(), margins=(), reasons=left, lack_of_fit=tests, notes=notes)
    reasons = ("no effect that was tried brings the held-out error down by a tenth", *_untried(root, task, most=np.inf))
    if tests:
        reasons = (words or LIKE_NOISE, *reasons)
    return Decision(status="unresolved", node=root, runners=(), margins=(), reasons=reasons, lack_of_fit=tests)


LIKE_NOISE = (
    "what is left depends on no motion, input or output, as noise does: nothing need be missing if the noise is weaker "
    "in the quiet band, where the floor was read, than where the motion is; repeated records would tell"
)


def _absorbed(root: Node, found: AbsorbedGain) -> Decision:
    """A gain that only the model as given shows: never firm, because the records do not tell."""
    reason = (
        "the calibration explains the records as well without it, by internal forces further from the model as given "
        f"(2 ln L lower by {number(found.fall, 2)} with their prior); check the gain, or give a model whose structure "
        "is known (M, C and K)"
    )
    before = len(root.effects)
    return Decision(
        status="unresolved",
        node=found.node,
        runners=(*(None,) * before, found.without),
        margins=(*(float("inf"),) * before, found.fall),
        reasons=(reason,),
    )


def _best(nodes: Sequence[Node], root: Node, task: Task) -> Node:
    """The model with the fewest effects that explains the data, to fit and held out; among its equals the likeliest.

    Where none does, the guess is one of laws that all records share, if there is any: a number that each record has for
    itself, the held-out ones too, takes up what stays the same along a record, such as friction in one direction. Far
    above the floor what is left is no noise, and the likelihood counts it as if it were: there, of those with the
    fewest effects that leave about as much held out, the one with the fewest free numbers is the guess.
    """
    nodes = [node for node in nodes if explains_both(node)] or nodes
    if not any(explained(node.held_out_level) for node in nodes):
        nodes = [node for node in nodes if node is not root and not node.by_record] or nodes
    lowest = min(node.held_out_level for node in nodes)
    if not np.isfinite(lowest):
        return root
    enough = max(SAME * lowest, 1.0)
    good = [node for node in nodes if node.held_out_level <= enough]
    near = [node for node in nodes if node.held_out_level <= (1.0 + SMALLEST_FALL) * enough]
    within = [node for node in near if explained(node.held_out_level)]
    fewest = min(_size(node) for node in (within or good))
    equals = [node for node in (within or good) if _size(node) == fewest]
    if lowest > FAR_ABOVE:
        return min(equals, key=lambda node: (_cost_of_freedom(node, task), node.held_out_level))
    return min(equals, key=lambda node: criterion(node, root, task))


def _cost_of_freedom(node: Node, task: Task) -> float:
    """ln(n) a free parameter (Schwarz 1978); one that is found at the value known beforehand is not free."""
    assembly, problem = node.coarse.assembly, task.fit
    n_values = int(problem.drive.present.sum() + task.held_out.drive.present.sum())
    free, n_records = len(node.masses), problem.drive.n_records + task.held_out.drive.n_records
    for i, item in enumerate(assembly.placements):
        free += n_records * len(item.local) + len(item.common) + item.n_directions - len(item.held)
        free -= sum(kind.lower == kind.upper for kind in item.effect.parameters)
        known = item.effect.known_values("" if item.port is None else item.port.length_unit)
        if any(value is not None for value in known):
            free -= _found_as_known(node, i, known, problem)
    return free * float(np.log(n_values))


def _found_as_known(node: Node, i: int, known: Sequence[float | None], problem: Problem) -> int:
    """How many parameters of an effect came out at their known values, and sharply so."""
    item, span = node.coarse.assembly.placements[i], node.coarse.assembly.common_of(i)
    spread = np.sqrt(np.maximum(np.diag(covariance(node.coarse, problem)), 0.0))[span]
    values = node.coarse.unknowns.common[span]
    return sum(
        abs(value - wanted) <= SURE * deviation and deviation <= SHARP_SHARE * abs(wanted)
        for j, value, deviation in zip(item.common, values, spread, strict=False)
        if (wanted := known[j]) is not None
    )


def _strongest(nodes: Sequence[Node], root: Node, task: Task) -> Node | None:
    return max(nodes, key=lambda node: log_likelihood_gain(root, node, task), default=None)


def _pruned(best: Node, root: Node, task: Task) -> Node:
    """The model without effects that it does not need."""
    while len(best.effects) > 1:
        sure = sureness(best, task)
        smaller = [without(best, i, task) for i in range(len(best.effects))]
        needless = [
            node for node, z in zip(smaller, sure, strict=True) if not counts(node, best, task) or _weak(node, best, z)
        ]
        if not needless:
            return best
        best = min(needless, key=lambda node: node.held_out_level)
    if best is root or not counts(root, best, task):
        return root
    found = sureness(best, task)[len(root.effects) :]
    return root if found and _weak(root, best, max(found)) else best


def _rivals(node: Node, best: Node, effect: tuple[str, str], task: Task) -> bool:
    """Whether a model explains the data without an effect of the best one.

    A richer law of which the effect is a limit always fits about as well; it is a rival where it clearly fits better.
    """
    if effect in node.effects or not np.isfinite(node.held_out_level):
        return False
    contains = any(where == effect[1] and has_limit(key, effect[0]) for key, where in node.effects)
    return not contains or log_likelihood_gain(best, node, task) > SMALLEST_GAIN


def _weak(smaller: Node, best: Node, z: float) -> bool:
    """Whether an effect may be none by what it changes in the outputs, and the held-out error does not clearly need it.

    The size of a hard limit (a brim, a stop) is hardly known where anything large will do: only the error tells.
    """
    return z < LEAST_SURE and smaller.held_out_level < CLEAR_RISE * best.held_out_level
