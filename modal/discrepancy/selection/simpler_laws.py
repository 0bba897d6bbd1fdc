"""Laws that are the limit of a richer one: where the richer one explains the data, its limits are fitted as well.

A link that never slips is a gap spring, one that slips at once is dry friction. The search fits the most promising laws
first and may end with the richer one, whose further parameter then stands for nothing; only a fit of its limit at the
same place tells.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from modal.discrepancy.fitting.nodes import Node, Task
from modal.discrepancy.selection.smaller_models import instead
from modal.effects.catalogue import CATALOGUE
from modal.effects.effect import Effect
from modal.simulation.assembly import Assembly, EffectPlacement
from modal.structure.placed import possible_places
from okid.arrays import FloatArray

__all__ = ["LIMITS", "Law", "Limit", "has_limit", "is_limit", "simple_first", "with_limits", "with_twins"]

T = TypeVar("T")
Law = tuple[str, str]
"""An effect's key and its place."""

Values = Sequence[float] | FloatArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Limit:
    """A law that another one turns into.

    Attributes:
        law: Key of the simpler law.
        values: Its parameters by those of the richer one.
        near: Whether the richer one may be near it, by its parameters and the standard deviation of the displacement.
    """

    law: str
    values: Callable[[Values], tuple[float, ...]]
    near: Callable[[Values, float], bool]


LIMITS = {
    "slack_in_hysteresis": (
        # a link that seldom slips, and one that slips in most cycles
        Limit(law="gap_spring", values=lambda v: (0.0, v[0], v[2]), near=lambda v, size: v[1] + v[2] >= size),
        Limit(law="coulomb_friction", values=lambda v: (v[0] * v[1],), near=lambda v, size: v[1] + v[2] <= size),
    ),
    "bouc_wen_hysteresis": (
        Limit(law="coulomb_friction", values=lambda v: (v[0] * v[1],), near=lambda v, size: v[1] <= size),
    ),
}
"""The limits of each law that has one."""


def has_limit(law: str, simpler: str) -> bool:
    """Whether a law turns into a simpler one."""
    return any(limit.law == simpler for limit in LIMITS.get(law, ()))


def is_limit(simple: Law, rich: Law) -> bool:
    """Whether a law is a limit of another one at the same place."""
    return simple[1] == rich[1] and has_limit(rich[0], simple[0])


def simple_first(items: Sequence[T], law: Callable[[T], Law], near: Callable[[T, T], bool]) -> list[T]:
    """The items in their order, but a limit of a richer law before that law where it is near it.

    It is quick to fit, and where it explains the data the richer one need not be followed far.

    Args:
        items: In an order of their own.
        law: The law of an item and its place.
        near: Whether a limit (first) does nearly as well as the richer law (second).

    Returns:
        All of them.
    """
    ordered: list[T] = []
    for item in items:
        richer = [i for i, other in enumerate(ordered) if is_limit(law(item), law(other)) and near(item, other)]
        ordered.insert(min(richer, default=len(ordered)), item)
    return ordered


def with_limits(node: Node, task: Task) -> list[Node]:
    """The models with one of the node's effects replaced by a limit of it, at the same place.

    Args:
        node: A fitted model.
        task: Records and catalogue; a law that is not in the catalogue is not tried.

    Returns:
        One model a limit that is near and not there already.
    """
    assembly, common = node.coarse.assembly, node.coarse.unknowns.common
    found: list[Node] = []
    for i, item in enumerate(assembly.placements):
        values = common[assembly.common_of(i)][: len(item.common)]
        limits = [limit for limit in LIMITS.get(item.effect.key, ()) if limit.near(values, item.displacement_scale)]
        for limit in limits:
            law = task.catalogue.get(limit.law)
            there = (limit.law, item.where) in node.effects
            if law is CATALOGUE[limit.law] and not there and item.where in possible_places(assembly.plant, law):
                found.append(instead(node, i, _placed(assembly, i, law), limit.values(values), task))
    return found


def _softening_as_sine(values: Values, stiffness: float) -> tuple[float, ...] | None:
    return (float(np.sqrt(-stiffness / (6.0 * values[0]))),) if values[0] < 0.0 else None


def _sine_as_cubic(values: Values, stiffness: float) -> tuple[float, ...] | None:
    return (-stiffness / (6.0 * values[0] ** 2),)


TWINS = {
    "cubic_stiffness": ("sine_softening", _softening_as_sine),
    "sine_softening": ("cubic_stiffness", _sine_as_cubic),
}
"""Laws that are the same to third order: the other one, and its parameters beside a linear stiffness."""


def with_twins(node: Node, task: Task, fitted: Sequence[Node] = ()) -> list[Node]:
    """The models with one of the node's effects replaced by the law that is nearly the same.

    The search may have lost it on the way, and without it a name would lead for want of a rival.

    Args:
        node: A fitted model.
        task: Records and catalogue; a law that is not in the catalogue is not tried.
        fitted: Models that need not be fitted again.

    Returns:
        One model an effect that has such a law and stands beside a linear stiffness.
    """
    assembly, common = node.coarse.assembly, node.coarse.unknowns.common
    there = [set(one.effects) for one in fitted]
    found: list[Node] = []
    for i, item in enumerate(assembly.placements):
        key, as_twin = TWINS.get(item.effect.key, ("", None))
        law, linear = task.catalogue.get(key), assembly.stiffness_parameter(i)
        if as_twin is None or law is not CATALOGUE[key] or linear is None:
            continue
        if {*node.effects} - {node.effects[i]} | {(key, item.where)} in there:
            continue
        values = as_twin(common[assembly.common_of(i)], float(common[linear]))
        if values is not None:
            found.append(instead(node, i, _placed(assembly, i, law), values, task))
    return found


def _placed(assembly: Assembly, i: int, effect: Effect) -> EffectPlacement:
    """The law at the place, its first stiffness held at zero where the linear one stands for it."""
    item = assembly.placements[i]
    shared = getattr(effect, "beside_stiffness", ())
    held = (0,) if shared and assembly.stiffness_parameter(i) is not None else ()
    return EffectPlacement(
        effect=effect,
        where=item.where,
        port=item.port,
        displacement_scale=item.displacement_scale,
        velocity_scale=item.velocity_scale,
        held=held,
    )
