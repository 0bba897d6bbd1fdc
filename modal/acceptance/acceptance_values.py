"""Limits on the result as a whole: number of modes, fit, trust."""

import math

import numpy as np
import scipy

from modal.acceptance.limits import FitAtLeast, ModeCount, TrustAtLeast
from modal.acceptance.weighing import MAYBE, NO, YES, Answer, Weighed, inside
from modal.identification.result import Identification
from modal.identification.trust import trust_of
from modal.wording.numbers import fit_text

__all__ = ["check_count", "check_fit", "check_trust"]

_RANK = {"not carried": 0, "with care": 1, "carried": 2}


def check_count(limit: ModeCount, result: Identification) -> Weighed:
    """Number of vibration modes of the system; each doubtful pole may be one more."""
    n_sure = sum(mode.kind == "oscillatory" and mode.verdict == "system" for mode in result.modes)
    n_doubtful = sum(mode.kind == "oscillatory" and mode.verdict == "doubtful" for mode in result.modes)
    if limit.at_least <= n_sure and n_sure + n_doubtful <= limit.at_most:
        answer: Answer = YES
    elif n_sure + n_doubtful < limit.at_least or n_sure > limit.at_most:
        answer = NO
    else:
        answer = MAYBE
    poles = "pole" if n_doubtful == 1 else "poles"
    return Weighed(
        what="number of modes",
        required=_count_text(limit),
        found=f"{n_sure} of the system" + (f", {n_doubtful} doubtful {poles}" if n_doubtful else ""),
        answer=answer,
        reason="a doubtful pole may or may not be a mode" if answer == MAYBE else "",
    )


def check_fit(limit: FitAtLeast, result: Identification) -> Weighed:
    """Cross-validated fit; its interval is that of the mean over folds (Student's t)."""
    value, half_width = result.fit.mean, _fold_interval(result)
    answer = inside(value, half_width, (limit.at_least, math.inf))
    found = f"{fit_text(value)}" if math.isfinite(value) else "no fit on held-out data is known"
    if math.isfinite(half_width) and math.isfinite(value):
        found = f"{value:.4f} ± {half_width:.4f}"
    reason = "its interval over the folds straddles the limit" if answer == MAYBE else ""
    if answer == MAYBE and not math.isfinite(half_width):
        reason = "one fold alone tells no interval" if math.isfinite(value) else "there is no value to weigh"
    return Weighed(
        what="cross-validated fit",
        required=f"at least {limit.at_least:g}",
        found=found,
        answer=answer,
        reason=reason,
    )


def check_trust(limit: TrustAtLeast, result: Identification) -> Weighed:
    """How far the data carry the result as a whole."""
    judgement = trust_of(result)
    met = _RANK[judgement.trust] >= _RANK[limit.at_least]
    wanted = 'the data carry it ("carried")' if limit.at_least == "carried" else 'at least "with care"'
    return Weighed(
        what="trust in the result",
        required=wanted,
        found=f'"{judgement.trust}"',
        answer=YES if met else NO,
    )


def _count_text(limit: ModeCount) -> str:
    least, most = f"{limit.at_least:g}", f"{limit.at_most:g}"
    if math.isinf(limit.at_most):
        return f"at least {least}"
    if not limit.at_least:
        return f"at most {most}"
    return f"{least}" if limit.at_least == limit.at_most else f"{least} to {most}"


def _fold_interval(result: Identification) -> float:
    """Half the 95 % interval of the mean fit, from the spread over the folds; nan where there are fewer than two."""
    folds = result.fit.folds[np.isfinite(result.fit.folds)]
    if folds.size < 2:
        return math.nan
    return float(scipy.special.stdtrit(folds.size - 1, 0.975) * folds.std(ddof=1) / math.sqrt(folds.size))
