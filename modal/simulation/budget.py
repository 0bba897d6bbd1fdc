"""What a search may cost, in rows of states solved along the records: unlike time, the same on every machine."""

from contextvars import ContextVar

import numpy as np

__all__ = ["Budget", "add_work", "simulation_work", "work_done"]

OVERHEAD = 3000
"""What a call costs beside its rows, in rows of one state: a march in windows of a few steps is not cheap."""

SHORT = 33_000
"""Rows of states by which records count as longer: short ones are hardly cheaper, because calls cost most."""

SHARE_OF_A_STAGE = 0.7
"""Share of what is left for one model that its fits in observer form may cost; of the rest, that its free runs may."""

_done: ContextVar[float] = ContextVar("work done", default=0.0)


def add_work(n_times: int, n_states: int) -> None:
    """Count one solve of a linear recursion.

    Args:
        n_times: Its length.
        n_states: Its states; right-hand sides more than one are not counted.
    """
    _done.set(_done.get() + n_times * n_states + OVERHEAD)


def simulation_work(n_times: int, n_states: int) -> float:
    """What a simulation along records counts, by and large.

    Args:
        n_times: Steps of all records.
        n_states: States of the plant.
    """
    return float(n_times * n_states + SHORT)


def work_done() -> float:
    """What this thread has solved so far, in rows of states."""
    return _done.get()


class Budget:
    """An amount of work from now on, and whether anything was left undone for want of it.

    It remembers, so that who decides at last knows what a search deep below had to leave: one object for all searches
    of a model along the same records.

    Args:
        work: In rows of states, as `work_done`; unlimited unless given.
        whole: What is marked as well where this one is not enough.

    Example:
        >>> budget = Budget(1000.0)
        >>> budget.allows(), budget.spent
        (True, False)
        >>> add_work(n_times=4000, n_states=2)
        >>> budget.allows(), budget.spent
        (False, True)
    """

    def __init__(self, work: float = np.inf, *, whole: "Budget | None" = None) -> None:
        self._end = work_done() + work
        self._whole = whole
        self._untried, self._spent = np.inf, False

    @property
    def spent(self) -> bool:
        """Whether anything was left undone."""
        return self._spent

    @property
    def untried(self) -> float:
        """Effects of the smallest models that were left untried and might matter; infinite where there are none."""
        return self._untried

    @property
    def left(self) -> float:
        """Work left."""
        return max(self._end - work_done(), 0.0)

    def allows(self) -> bool:
        """Whether there is work left; who asks and gets False leaves something undone."""
        if self.left > 0.0:
            return True
        self.refuse()
        return False

    def part(self, share: float) -> "Budget":
        """A share of what is left now, on its own."""
        return Budget(share * self.left)

    def stage(self) -> "Budget":
        """The share of a stage of what is left now; where it is not enough, the whole is marked as well."""
        return Budget(SHARE_OF_A_STAGE * self.left, whole=self)

    def refuse(self, size: float = 0.0) -> None:
        """Mark that something is left undone.

        Args:
            size: Effects of the models that are left untried; infinite where others have made them matter no more.
        """
        self._spent = True
        self._untried = min(self._untried, size)
        if self._whole is not None:
            self._whole.refuse(size)
