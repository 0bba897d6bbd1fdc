"""Beam search for the set of effects that a model lacks.

From a model each effect is screened at each place in observer form, the promising ones are fitted in observer form
(contractive: hardly any local minimum), then in free run, and judged on held-out records. Three distinct models are
carried on, best first and until one explains the data, because the best single effect may be a wrong one that stands
in for two. A step counts only where the held-out mean square falls by a tenth and the likelihood gains: with many
samples a criterion on the likelihood alone finds an effect in nearly every record without one. Where fewer than three
count, the beam has room for models that take away half of what is left on the records to fit: of two effects that
counteract each other, the right one alone may be worse than none on the held-out record.

The work is bounded, and the budget says what was left untried for want of it. Beside models that another one with as
many effects has beaten by explaining the data, that does not matter. A single fit that goes astray ends
early without a word.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from modal.discrepancy.fitting.nodes import Node, Task, counts
from modal.discrepancy.selection.expansion import expand
from modal.simulation.tolerances import AT_FLOOR

__all__ = ["search_effects"]

BEAM = 3
MOST_EFFECTS = 4
SHARE_OF_ONE = 0.6
"""Share of what is left of the budget that looking for effects beside one model may cost."""
LARGE_FALL = 0.5
"""Share of what a model leaves on the records to fit that a further effect must take away to be gone on from although
the held-out record does not show it yet."""


def search_effects(root: Node, task: Task, known: Sequence[Node] = ()) -> tuple[Node, ...]:
    """All models worth a look, from the calibrated one on.

    Args:
        root: The calibrated linear model.
        task: Records, catalogue.
        known: Models that an earlier search found, to go on from.

    Returns:
        Every model judged on held-out records, in the order found.
    """
    everything = list(known) if known else [root]
    front = _distinct([node for node in known if counts(root, node, task)])
    if known and not front:
        return tuple(everything)
    front, untried, cut = front or [root], np.inf, False
    for depth in range(max(len(node.effects) for node in front) - len(root.effects), MOST_EFFECTS):
        if min(node.held_out_level for node in front) <= AT_FLOOR and depth > 0:
            break
        children: list[Node] = []
        hopeful: list[Node] = []
        here = np.inf
        for position, node in enumerate(front):
            if task.budget.left <= 0.0:
                here, cut = depth + 1, True
                break
            share = (depth + position / len(front)) / MOST_EFFECTS
            task.report(f"looking for effect {depth + 1} beside {_named(node)}", share)
            part = task.budget.part(SHARE_OF_ONE)
            found = expand(node, replace(task, budget=part))
            everything += found
            children += [child for child in found if counts(node, child, task)]
            hopeful += [child for child in found if _hopeful(node, child)]
            cut = cut or part.spent
            if _explain(children):
                here = depth + 1 if part.spent else np.inf
                break
            here = depth + 1 if part.spent else here
        untried = min(untried, here)
        front = _distinct(children)
        front += _distinct([child for child in hopeful if _new(child, front)])[: BEAM - len(front)]
        if not front:
            break
    if cut:
        task.budget.refuse(untried)
    return tuple(everything)


def _explain(children: Sequence[Node]) -> bool:
    return any(child.held_out_level <= AT_FLOOR for child in children)


def _named(node: Node) -> str:
    return ", ".join(f"{effect} at {where}" for effect, where in node.effects) or "the linear model"


def _distinct(children: Sequence[Node]) -> list[Node]:
    kept: list[Node] = []
    for child in sorted(children, key=lambda node: node.held_out_level):
        if _new(child, kept):
            kept.append(child)
    return kept[:BEAM]


def _hopeful(node: Node, child: Node) -> bool:
    return bool(np.isfinite(child.held_out_level)) and child.fit_level <= (1.0 - LARGE_FALL) * node.fit_level


def _new(child: Node, front: Sequence[Node]) -> bool:
    return all(set(child.effects) != set(other.effects) for other in front)
