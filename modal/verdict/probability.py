"""The probability that a mode belongs to the system, from two pieces of evidence.

Found again: the repeatability r (`modal.verdict.judgement`). Driven: how much of the outputs the mode's answer to the inputs
explains for the k numbers that the mode brings; with g its gain (`modal.verdict.excitation`) on N measured values,
F = (N / k) g / (1 - g), the ratio that analysis of variance would test.

    p = 1 / (1 + exp(11.5 - 14.1 r - 0.95 log10 F)),   F clipped to [0.1, 1e6]

so that a tenfold F counts as much as 0.07 of r. Without inputs there is no F: p = 1 / (1 + exp(12.0 - 17.5 r)). The
numbers are by maximum likelihood on simulated structures; `modal/docs/verdict.md` has the reliability table and the
command.
"""

import numpy as np

from modal.modes.mode import Mode

__all__ = ["f_ratio", "probability"]

LEAST_RATIO, LARGEST_RATIO = 0.1, 1e6
"""Beyond these F ratios nothing more is learnt."""


def f_ratio(mode: Mode, gain: float, n_values: int) -> float:
    """(N / k) g / (1 - g) for the k numbers of a mode: its pole, its participation and its shape up to their scale.

    Example:
        >>> mode = Mode(pole=-1 + 9j, kind="oscillatory", frequency=1.44, damping_ratio=0.11,
        ...             shape=np.ones(2), participation=np.ones(1))
        >>> f_ratio(mode, 0.02, 6000)
        20.408163265306122
    """
    k = (mode.shape.size + mode.participation.size) * (2 if mode.pole.imag else 1)
    return n_values / k * gain / max(1 - gain, np.finfo(float).eps)


def probability(r: float, ratio: float = np.nan) -> float:
    """That a mode of repeatability r belongs to the system, its F ratio being known or not (nan).

    Example:
        >>> [round(probability(0.8, ratio), 2) for ratio in (1.0, 100.0, 10000.0)]
        [0.45, 0.84, 0.97]
    """
    if np.isnan(ratio):
        return float(1 / (1 + np.exp(12.0 - 17.5 * r)))
    evidence = np.log10(np.clip(ratio, LEAST_RATIO, LARGEST_RATIO))
    return float(1 / (1 + np.exp(11.5 - 14.1 * r - 0.95 * evidence)))
