"""The sentences of modes against level.

A mode's pole moves by d omega / omega along the imaginary axis and by d zeta along the real one, both relative to its
size. Only what is at least half of the larger of the two is said: where a resonance moves by more than its own width
within one level already, the damping ratio of a linear model of that level says nothing of energy.
"""

import numpy as np

from modal.localisation.levels import LevelMode, LevelModes
from modal.wording.numbers import percent
from modal.wording.statements import Statement, number

__all__ = ["mode_statements"]

MINOR = 0.5
"""Of the larger of the two movements, below which the other one is not mentioned."""


def mode_statements(modes: LevelModes) -> list[Statement]:
    """One sentence for each mode that moves with level, or one that none does.

    Args:
        modes: from `level_modes`.
    """
    if not modes.modes:
        return [Statement(subject="modes", text=f"Modes against level are not known: {modes.reason}.")]
    texts = [text for mode in modes.modes for text in _of_mode(mode)]
    if not texts and all(_rests(mode) for mode in modes.modes):
        texts = [f"No mode moves with level in frequency{_or_damping(modes)}."]
    return [Statement(subject="modes", text=text) for text in texts]


def _rests(mode: LevelMode) -> bool:
    return mode.frequency_tendency == "stays" and (mode.kind == "real" or mode.damping_tendency == "stays")


def _or_damping(modes: LevelModes) -> str:
    return " or damping" if any(mode.kind == "oscillatory" for mode in modes.modes) else ""


def _of_mode(mode: LevelMode) -> list[str]:
    first, last = (int(i) for i in np.flatnonzero(np.isfinite(mode.frequencies))[[0, -1]])
    span = f"from level {first + 1} to {last + 1}"
    if mode.kind == "real":
        return _of_real(mode, first, last, span)
    change = float(mode.frequencies[last] / mode.frequencies[first] - 1.0)
    damping = float(mode.damping_ratios[last] - mode.damping_ratios[first])
    name = f"mode {mode.number} ({number(float(mode.frequencies[first]))} Hz)"
    texts = []
    if mode.frequency_tendency in ("rises", "falls") and abs(change) >= MINOR * abs(damping):
        law = (
            "a spring that hardens, or play that closes"
            if mode.frequency_tendency == "rises"
            else "a spring that softens, yields or slips"
        )
        texts.append(f"Frequency of {name} {mode.frequency_tendency} by {percent(abs(change))} {span}: {law}.")
    if mode.damping_tendency in ("rises", "falls") and abs(damping) >= MINOR * abs(change):
        law = "drag-like, or a loop that grows" if mode.damping_tendency == "rises" else "friction-like"
        ends = [percent(float(mode.damping_ratios[i])) for i in (first, last)]
        texts.append(f"Damping of {name} {mode.damping_tendency} from {ends[0]} to {ends[1]} {span}: {law}.")
    return texts


def _of_real(mode: LevelMode, first: int, last: int, span: str) -> list[str]:
    if mode.frequency_tendency not in ("rises", "falls"):
        return []
    times = 1.0 / (2.0 * np.pi * mode.frequencies[[first, last]])
    moves, law = ("falls", "drag-like") if mode.frequency_tendency == "rises" else ("rises", "friction-like")
    return [
        f"Time constant of pole {mode.number} {moves} from {number(times[0])} to {number(times[1])} s {span}: {law}."
    ]
