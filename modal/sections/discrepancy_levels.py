"""Modes against level as drawn: the change of each frequency and the damping ratio, where they tell something."""

from dataclasses import dataclass

import numpy as np

from modal.discrepancy.results import Diagnosis
from modal.localisation.levels import LevelMode, LevelModes
from modal.wording.statements import number
from okid.arrays import FloatArray

__all__ = ["LevelLine", "level_lines", "telling"]

MOST_MODES = 5


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LevelLine:
    """One mode over the levels at which it was found.

    Attributes:
        name: "mode 1, 3.18 Hz", or "pole 1, 2.64 Hz" for one of first order.
        levels: (n,) of the excitation, relative to the loudest record.
        change: (n,) of the frequency from the lowest of these levels [%].
        change_std: (n,) standard deviation of each frequency [%].
        damping: (n,) damping ratio [%]; nan for a pole of first order.
        damping_std: (n,) its standard deviation [%].
    """

    name: str
    levels: FloatArray
    change: FloatArray
    change_std: FloatArray
    damping: FloatArray
    damping_std: FloatArray


def level_lines(diagnosis: Diagnosis) -> tuple[LevelLine, ...]:
    """The modes of the records to fit that are known to move with level, or known to stay.

    Args:
        diagnosis: whose location has modes against level.

    Returns:
        None where measurement and simulation agree anyway, or no mode is known well enough.
    """
    location = diagnosis.location
    modes: LevelModes | None = getattr(location, "modes", None)
    if modes is None or location.agrees:
        return ()
    chosen = [mode for mode in modes.modes if telling(mode)]
    return tuple(_line(mode, modes.levels) for mode in chosen[:MOST_MODES])


def telling(mode: LevelMode) -> bool:
    """Whether something is known of how a mode moves with level."""
    return mode.frequency_tendency != "unknown" or mode.damping_tendency != "unknown"


def _line(mode: LevelMode, levels: FloatArray) -> LevelLine:
    found = np.isfinite(mode.frequencies)
    frequency, deviation = mode.frequencies[found], mode.frequency_stds[found]
    damping, spread = mode.damping_ratios[found], mode.damping_ratio_stds[found]
    real = mode.kind == "real"
    return LevelLine(
        name=f"{'pole' if real else 'mode'} {mode.number}, {number(float(frequency[0]))} Hz",
        levels=levels[found],
        change=100.0 * (frequency / frequency[0] - 1.0),
        change_std=100.0 * deviation / frequency[0],
        damping=np.full(damping.shape, np.nan) if real else 100.0 * damping,
        damping_std=np.full(damping.shape, np.nan) if real else 100.0 * spread,
    )
