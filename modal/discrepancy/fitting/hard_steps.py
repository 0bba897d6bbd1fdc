"""Steps of the size of a hard limit, in its reciprocal, up to that of a wall.

The level above a brim is flow / rate. In the rate it is all but flat once the brim is hard: a step of Gauss and Newton
then asks for many times the rate, and the levels that it predicts lie far below the brim, where nothing flows over and
the simulation has to start anew. In 1 / rate both are straight lines. A step `dr` in the rate r is one of -dr / r^2 in
1 / r, which leads to

    r / (1 - dr / r)

never negative, infinite at dr = r: a step goes up to a share of that. A brim that no step of the simulation can tell
from a wall is one, and its rate is held there.
"""

import numpy as np

from modal.effects.stiff_step import WALL
from modal.simulation.assembly import Assembly, Unknowns
from modal.simulation.port_motion import step_compliance
from okid.arrays import FloatArray

__all__ = ["moved_by_reciprocals", "reach_of", "walls"]

REACH = 0.9
"""Longest step as a share of the size: it makes a limit ten times as hard."""


def walls(assembly: Assembly, unknowns: Unknowns, dt: float) -> FloatArray:
    """(n_common,) the sizes at which hard limits are walls for steps of `dt`; infinite for all other unknowns."""
    found = np.full(assembly.n_common, np.inf)
    for i in assembly.forces:
        effect, port = assembly.placements[i].force_and_port
        if not effect.is_brim:
            continue
        compliance = step_compliance(assembly.plant, port, unknowns.directions(assembly, i), dt)
        begin = assembly.common_of(i).start
        for position, j in enumerate(assembly.placements[i].common):
            if effect.parameters[j].role == "amplitude" and compliance > 0.0:
                found[begin + position] = WALL / compliance
    return found


def reach_of(common: FloatArray, walls: FloatArray) -> FloatArray:
    """(n_common,) the longest step upwards: of a hard limit a share of its size, none at the wall; else infinite.

    A limit of no size yet goes as far as it likes.
    """
    found = np.full(len(common), np.inf)
    hard = np.isfinite(walls) & (common > 0.0)
    found[hard] = np.where(common[hard] < walls[hard], REACH * common[hard], 0.0)
    return found


def moved_by_reciprocals(common: FloatArray, step: FloatArray, walls: FloatArray) -> FloatArray:
    """The common unknowns after a step, sizes of hard limits moved in their reciprocal.

    Args:
        common: (n_common,) before.
        step: (n_common,) the step; within the reach of each (`reach_of`).
        walls: (n_common,) the sizes at which hard limits are walls; infinite for what is none.

    Returns:
        (n_common,) after.

    Example:
        >>> moved_by_reciprocals(np.array([2.0, 2.0, 2.0]), np.ones(3), np.array([np.inf, 1e4, 3.0]))
        array([3., 4., 3.])
    """
    after = common + step
    hard = np.isfinite(walls) & (common > 0.0)
    share = np.minimum(step[hard] / common[hard], REACH)
    after[hard] = np.minimum(common[hard] / (1.0 - share), walls[hard])
    return after
