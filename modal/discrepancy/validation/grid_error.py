"""How far the parameters of a sharp law may be off because time and the law itself are taken in steps."""

import numpy as np

from modal.discrepancy.fitting.nodes import Node
from okid.arrays import FloatArray

__all__ = ["grid_error"]

LEAST_RATIO = 2.0
"""Where only the smoothing was sharpened, the grid's own error is as unknown as if it had been halved."""


def grid_error(node: Node) -> FloatArray:
    """Deviation of each common unknown that the steps of time may have left.

    Fitted on two grids, one `r` times as fine as the other, an unknown whose error is in proportion to the step still
    has 1 / (r - 1) of its change from one to the other as its error.

    Args:
        node: A fitted model.

    Returns:
        (n_common,) in the unknowns' units; zero where there was one grid only, and
        for what is held at a bound.

    References:
        Richardson, Gaunt, The deferred approach to the limit, Phil. Trans. R. Soc. A 226, 1927,
        https://doi.org/10.1098/rsta.1927.0008
    """
    fine, coarse = node.fitted, node.coarse
    change = np.where(fine.at_bounds, 0.0, np.abs(fine.unknowns.common - coarse.unknowns.common))
    ratio = coarse.trajectory.drive.dt / fine.trajectory.drive.dt
    return np.asarray(change / (max(ratio, LEAST_RATIO) - 1.0))
