"""The sentences of odd and even lines."""

import numpy as np

from modal.localisation.lines import DOMINANT, Lines
from modal.wording.numbers import percent
from modal.wording.statements import Statement

__all__ = ["line_statements"]


def line_statements(lines: Lines) -> list[Statement]:
    """What the lines that are not excited show, one sentence; or why no record can show them.

    Args:
        lines: from `measure_lines`.
    """
    measured = lines.measured
    if not measured:
        reasons = list(dict.fromkeys(lines.reasons))
        return [Statement(subject="lines", text=f"Odd and even lines tell nothing here: {'; '.join(reasons)}.")]
    level = np.array([one.level for one in measured])  # (n_records, 2, n_outputs)
    has_odd, has_even = (any(one.counts[kind] for one in measured) for kind in (1, 2))
    odd, even = float(level[:, 0].max()), float(level[:, 1].max())
    if odd == 0.0 and even == 0.0:
        what = "lines that are not excited" if has_odd and has_even else f"{'odd' if has_odd else 'even'} lines"
        return [Statement(subject="lines", text=f"The {what} carry noise only: no nonlinearity shows on them.")]
    if even > DOMINANT * odd:
        text = f"Even lines carry {percent(np.sqrt(even))} of the amplitude of an excited line"
        text += f", odd ones {_size(odd)}" if has_odd else ""
        text += ": a law that is even in the motion (quadratic, bilinear, one-sided contact)."
    elif odd > DOMINANT * even:
        text = f"Odd lines that are not excited carry {percent(np.sqrt(odd))} of the amplitude of an excited line"
        text += f", even ones {_size(even)}" if has_even else ""
        text += ": a law that is odd in the motion (cubic, friction, drag, symmetric contact)."
    else:
        text = (
            f"Odd lines that are not excited carry {percent(np.sqrt(odd))} and even ones {percent(np.sqrt(even))} of "
            "the amplitude of an excited line: a law that is neither odd nor even, or two laws."
        )
    return [Statement(subject="lines", text=text)]


def _size(power: float) -> str:
    return percent(float(np.sqrt(power))) if power > 0.0 else "noise only"
