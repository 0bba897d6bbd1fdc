"""How the outputs depend on the states: the plant's C, and each force that they hear directly."""

from dataclasses import dataclass

import numpy as np

from modal.simulation.drive import IndexArray
from modal.simulation.forces import ActingForce, Heard
from okid.arrays import FloatArray

__all__ = ["OutputDependence"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class OutputDependence:
    """The outputs by small changes of the states.

        dy = factors (C dx + sum G (by_now R dx + by_next R dx one time on))

    Attributes:
        C: (n_outputs, n_states).
        acting: The forces.
        heard: Each as the outputs hear it.
        factors: (n_rows, n_outputs) of the sensors.
        rows: (n_rows,) times at which outputs are measured.
    """

    C: FloatArray
    acting: tuple[ActingForce, ...]
    heard: tuple[Heard, ...]
    factors: FloatArray
    rows: IndexArray

    def outputs(self, states: FloatArray) -> FloatArray:
        """Outputs (n_columns, n_rows, n_outputs) by changes (n_columns, n_times, n) of the states."""
        at_rows = states[:, self.rows]
        found = at_rows[:, :, : self.C.shape[1]] @ self.C.T
        for one, heard in zip(self.acting, self.heard, strict=True):
            if not one.G.any():
                continue
            force = np.einsum("ckm,mk->ck", at_rows @ one.rows.T, heard.by_now[:, self.rows])
            if heard.by_next is not None:
                following = np.minimum(self.rows + 1, states.shape[1] - 1)
                force += np.einsum("ckm,mk->ck", states[:, following] @ one.rows.T, heard.by_next[:, self.rows])
            found += force[:, :, None] * one.G
        return np.asarray(found * self.factors)

    def at_once(self, n_all: int) -> FloatArray:
        """(n, n_outputs, n_rows) dependence on the states at the row itself."""
        found = np.zeros((n_all, *self.factors.T.shape))
        found[: self.C.shape[1]] = self.C.T[:, :, None]
        for one, heard in zip(self.acting, self.heard, strict=True):
            by_state = np.tensordot(one.rows.T, heard.by_now[:, self.rows], axes=(1, 0))
            found += by_state[:, None, :] * one.G[:, None]
        return np.asarray(found * self.factors.T)
