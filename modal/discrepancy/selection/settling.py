"""Settle what the data cannot: a stiffness that an effect and the linear model share.

A gap spring has a stiffness within the gap and one beyond it, and the element has a linear stiffness beside them: only
two of the three are determined. The one of the effect's that is nearer to zero is put to the linear stiffness and held
there, so that stops have no stiffness before contact and freeplay takes away all of the spring within the gap.
"""

from dataclasses import replace

import numpy as np

from modal.discrepancy.fitting.estimation import Estimate
from modal.simulation.assembly import Assembly, Unknowns

__all__ = ["settled_stiffness"]


def settled_stiffness(fitted: Estimate) -> tuple[Assembly, Unknowns] | None:
    """The model with the smallest of such stiffnesses moved to the linear one.

    Args:
        fitted: A fitted model.

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
