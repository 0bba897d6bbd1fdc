"""One number a mode, the same on every page: in the report, in the recording, in the table for programs."""

from collections.abc import Iterable

from modal.modes.mode import Mode

__all__ = ["numbered"]

_RANK = {"system": 0, "doubtful": 1, "noise": 2}


def numbered(modes: Iterable[Mode]) -> tuple[tuple[int, Mode], ...]:
    """Every mode with its number, counted from 1: those of the system first, then the doubtful, then noise.

    Within a verdict the lower frequency comes first. What a reader quotes thus has the small numbers, and a pole that
    joins or leaves the noise does not move them.

    Args:
        modes: in any order.

    Example:
        >>> numbered(())
        ()
    """
    return tuple(enumerate(sorted(modes, key=lambda mode: (_RANK[mode.verdict], mode.frequency)), start=1))
