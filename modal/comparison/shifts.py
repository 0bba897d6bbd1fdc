"""Shifts of one mode between two results, with their standard deviations, tests and verdicts."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy

from modal.comparison.comparison_matching import common_outputs
from modal.comparison.source import ResultSummary
from modal.modes.mode import Mode
from okid.arrays import ComplexArray, FloatArray

__all__ = [
    "Shift",
    "ShiftVerdict",
    "damping_shift",
    "frequency_shift",
    "holm",
    "shape_shift",
    "with_verdicts",
]

ShiftVerdict = Literal["beyond chance", "perhaps chance", "within its interval", "not known"]

INTERVAL = 0.95

SURE_FROM = 1.5364
"""Ratio q / T from which P(Q > q) <= P(chi^2_1 > q / T) for every correlation (Szekely, Bakirov 2003)."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Shift:
    """How far one number of a mode moved.

    Attributes:
        what: the number.
        before: its value in the first result.
        after: its value in the second.
        change: relative to the first value, as a share; of a shape: the lost assurance, 1 - assurance.
        half_width: half the 95 % interval of the change; of a shape: the change up to which it is within its interval.
        p_value: chance of a shift of this size or more where nothing changed; nan where not known.
        verdict: "beyond chance" for the comparison as a whole; "perhaps chance": outside its own 95 % interval, but
            not remarkable among so many; "within its interval"; or "not known".
        remark: why it is not known.
    """

    what: Literal["frequency", "damping ratio", "shape"]
    before: float
    after: float
    change: float
    half_width: float
    p_value: float
    verdict: ShiftVerdict = "not known"
    remark: str = ""


def frequency_shift(before: Mode, after: Mode, freedom: tuple[float, float]) -> Shift:
    """Shift of the frequency.

    Args:
        before: the mode in the first result.
        after: the same in the second.
        freedom: degrees of freedom behind the standard deviations of the two.
    """
    return _shift(
        "frequency",
        (before.frequency, after.frequency),
        (before.frequency_std, after.frequency_std),
        freedom,
    )


def damping_shift(before: Mode, after: Mode, freedom: tuple[float, float]) -> Shift:
    """Shift of the damping ratio; not known where one of the two is not resolved, or for an overdamped pole."""
    remark = ""
    if before.kind != "oscillatory":
        remark = "an overdamped pole has no damping ratio of its own"
    elif not (before.damping_resolved and after.damping_resolved):
        remark = "the damping is not resolved in one of the results"
    deviations = (math.nan, math.nan) if remark else (before.damping_ratio_std, after.damping_ratio_std)
    shift = _shift("damping ratio", (before.damping_ratio, after.damping_ratio), deviations, freedom)
    return replace(shift, remark=remark) if remark else shift


def shape_shift(
    before: ResultSummary,
    after: ResultSummary,
    pair: tuple[int, int],
    shapes: tuple[ComplexArray, ComplexArray, FloatArray],
    assurance: float,
) -> Shift:
    """Change of the shape, tested for the worst correlation of its components.

    Args:
        before: the first result.
        after: the second.
        pair: indices of the mode in the two.
        shapes: of both results over the shared outputs, and the unit of each output.
        assurance: of the pair.
    """
    (i, j), (first, second, unit) = pair, shapes
    deviations = [
        None if mode.shape_std is None else mode.shape_std[outputs] / unit
        for mode, outputs in zip((before.modes[i], after.modes[j]), common_outputs(before, after), strict=True)
    ]
    blank = Shift(
        what="shape", before=1.0, after=assurance, change=1.0 - assurance, half_width=math.nan, p_value=math.nan
    )
    if not math.isfinite(assurance):
        return replace(blank, remark="fewer than two outputs are in both results")
    if deviations[0] is None or deviations[1] is None:
        return replace(blank, remark="the uncertainty of a shape is not known")
    a, b = first[:, i], second[:, j]
    scale = np.vdot(b, a) / np.vdot(b, b).real
    distance = float(np.sum(np.abs(a - scale * b) ** 2))
    spread = float(np.sum(deviations[0] ** 2) + abs(scale) ** 2 * np.sum(deviations[1] ** 2))
    if not spread > 0.0:
        return replace(blank, remark="the uncertainty of a shape is not known")
    ratio = distance / spread
    p_value = float(scipy.special.chdtrc(1.0, ratio)) if ratio >= SURE_FROM else 1.0
    # |a - scale b|^2 = |a|^2 (1 - assurance), so the interval of the distance is one of the lost assurance
    most = float(scipy.special.chdtri(1.0, 1.0 - INTERVAL)) * spread / float(np.vdot(a, a).real)
    return replace(blank, half_width=most, p_value=p_value)


def with_verdicts(several: Sequence[tuple[Shift, ...]], *, level: float) -> list[tuple[Shift, ...]]:
    """The same shifts with their verdicts: Holm's test over all of them together.

    Args:
        several: the shifts of each pair.
        level: chance of a false "beyond chance" among all of them.
    """
    flat = [shift.p_value for shifts in several for shift in shifts]
    rejected = iter(holm(flat, level=level))
    return [
        tuple(replace(shift, verdict=_verdict(shift, beyond=next(rejected))) for shift in shifts) for shifts in several
    ]


def holm(p_values: Sequence[float], *, level: float) -> list[bool]:
    """Which hypotheses are rejected so that any false rejection at all has a chance of at most `level`.

    The k-th smallest of m p-values is compared with level / (m - k + 1), up to the first that is not below it; nan is
    no test.

    Example:
        >>> holm([0.04, 0.001, 0.02, float("nan")], level=0.05)
        [True, True, True, False]
        >>> holm([0.04, 0.001, 0.03], level=0.05)
        [False, True, False]
    """
    tested = sorted((p, index) for index, p in enumerate(p_values) if math.isfinite(p))
    rejected = [False] * len(p_values)
    for rank, (p, index) in enumerate(tested):
        if p > level / (len(tested) - rank):
            break
        rejected[index] = True
    return rejected


def _verdict(shift: Shift, *, beyond: bool) -> ShiftVerdict:
    if not math.isfinite(shift.p_value):
        return "not known"
    if beyond:
        return "beyond chance"
    return "within its interval" if shift.p_value >= 1.0 - INTERVAL else "perhaps chance"


def _shift(
    what: Literal["frequency", "damping ratio"],
    values: tuple[float, float],
    deviations: tuple[float, float],
    freedom: tuple[float, float],
) -> Shift:
    before, after = values
    size = abs(before) or math.nan
    variances = deviations[0] ** 2, deviations[1] ** 2
    std = math.sqrt(sum(variances))
    shift = Shift(
        what=what,
        before=before,
        after=after,
        change=(after - before) / size,
        half_width=math.nan,
        p_value=math.nan,
    )
    if not (math.isfinite(std) and std > 0.0):
        return replace(shift, remark=f"the uncertainty of the {what} is not known")
    joint = _joint_freedom(variances, freedom)
    statistic = abs(after - before) / std
    return replace(
        shift,
        half_width=_t_quantile(joint) * std / size,
        p_value=_t_tail(statistic, joint),
    )


def _joint_freedom(variances: tuple[float, float], freedom: tuple[float, float]) -> float:
    """Welch-Satterthwaite."""
    parts = sum(variance**2 / number for variance, number in zip(variances, freedom, strict=True))
    return sum(variances) ** 2 / parts if parts > 0 else math.inf


def _t_quantile(freedom: float) -> float:
    tail = 0.5 * (1.0 + INTERVAL)
    return float(scipy.special.ndtri(tail) if math.isinf(freedom) else scipy.special.stdtrit(freedom, tail))


def _t_tail(statistic: float, freedom: float) -> float:
    """Two-sided."""
    one = scipy.special.ndtr(-statistic) if math.isinf(freedom) else scipy.special.stdtr(freedom, -statistic)
    return float(2.0 * one)
