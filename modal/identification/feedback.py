"""Does something feed the outputs back into the inputs? Then a model of the noise is not a matter of choice.

Output error is consistent whatever the colour of the noise as long as the inputs know nothing of it. Under feedback
they do: the past of the outputs then tells more about an input than its own past. Both regressions come from one Gram
matrix of lags; with R_0 and R_1 the covariances of what is left without and with the outputs' past, n_y m more numbers
for each of n_u inputs, the likelihood ratio

    (N - numbers - (n_u + n_y m + 1) / 2) ln(det R_0 / det R_1)

is chi-square with n_u n_y m degrees of freedom (Bartlett's approximation) where there is no feedback, and noncentral
by N times the share of an input that the outputs' past explains where there is some. Long records show any share,
however little it can do to the modes, so what is refused is that the share is negligible.
An input that its own past foretells, a sweep or a tone, is foretold as well by whatever has filtered it, and not asked.

References:
    Granger, Econometrica 37(3), 1969, 424-438, doi 10.2307/1912791 (the past of one series in the other); Bartlett,
    Proceedings of the Cambridge Philosophical Society 34(1), 1938, 33-40, doi 10.1017/S0305004100019880.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy

from modal.identification.result import Identification
from modal.verdict.judgement import DOUBTED
from okid.arrays import FloatArray
from okid.gram import lag_gram
from okid.record import Record
from okid.scaling import channel_scaling

__all__ = ["FALSE_ALARMS", "feedback_p_value", "with_feedback"]

FALSE_ALARMS = 0.01
"""Speak of feedback where so few records without it would look as much like it."""
OWN_PAST = 40
"""Let an input know its own past over so many samples."""
OTHER_PAST = 4
"""Look for so many samples of the outputs' past in it: a controller answers at once."""
ROWS_A_NUMBER = 10
"""Shorten both pasts where there are fewer rows for each number."""
NEGLIGIBLE = 0.002
"""Mind no feedback that explains less than this share of what an input's own past leaves; loops that move a mode's
frequency or damping noticeably explain ten times as much (`tests/reference/noise_families.py`, "loop")."""
FORETOLD = 0.01
"""Ask nothing of inputs of which their own past leaves less than this share of the power, a tenth of their size."""

BIASED = "the outputs are fed back into the inputs, which may bias it"


def feedback_p_value(records: Sequence[Record]) -> float:
    """How often records with at most negligible feedback look as much like it; nan where the inputs cannot be asked.

    Args:
        records: as measured: a filter that looks ahead makes the past of the outputs know the inputs.

    Example:
        >>> rng = np.random.default_rng(1)
        >>> r, e, u, y = *rng.standard_normal((2, 2000)), np.zeros(2000), np.zeros(2000)
        >>> for k in range(1, 2000):
        ...     u[k] = r[k] - 0.3 * y[k - 1]
        ...     y[k] = 0.5 * y[k - 1] + u[k - 1] + e[k]
        >>> feedback_p_value([Record(u, y, 0.1)]) < 1e-3, feedback_p_value([Record(r, y, 0.1)]) > 1e-3
        (True, True)
    """
    m, q = records[0].n_inputs, records[0].n_outputs
    n_rows = sum(record.n_samples for record in records)
    own = min(OWN_PAST, n_rows // (ROWS_A_NUMBER * (m + q)))
    if not m or own < OTHER_PAST:
        return float("nan")
    gram = lag_gram(records, own, scaling=channel_scaling(records))
    lags = 1 + (m + q) * np.arange(own + 1)
    inputs = (lags[:, np.newaxis] + np.arange(m)).ravel()
    outputs = (lags[1 : OTHER_PAST + 1, np.newaxis] + m + np.arange(q)).ravel()
    target, past = inputs[:m], np.concatenate([[0], inputs[m:]])
    without, rank = _left(gram.matrix, target, past)
    beside, more = _left(gram.matrix, target, np.concatenate([past, outputs]))
    foretold = np.diag(without) <= FORETOLD * np.diag(gram.matrix)[target]
    if more - rank < outputs.size or foretold.any():
        return float("nan")
    ratio = np.linalg.slogdet(without)[1] - np.linalg.slogdet(beside)[1]
    statistic = (gram.n_rows - rank - (m + outputs.size + 1) / 2) * ratio
    return float(1.0 - scipy.special.chndtr(max(statistic, 0.0), m * outputs.size, NEGLIGIBLE * gram.n_rows))


def with_feedback(result: Identification, *, unbiased: bool) -> Identification:
    """The result with the warning that there is feedback; where it may bias the modes none of them is certain.

    Args:
        result: of records with feedback.
        unbiased: whether the noise has a model of its own, which leaves white errors.
    """
    words = "The past of the outputs tells more about the inputs than their own does: something feeds them back"
    if unbiased:
        warning = f"{words}; the model was fitted with its noise, which allows for that."
        return replace(result, warnings=(*result.warnings, warning))
    warning = f"{words}, and no model of the noise leaves white errors: modes and damping may be biased."
    modes = tuple(
        replace(mode, verdict="doubtful", probability=min(mode.probability, DOUBTED), reason=f"{BIASED}; {mode.reason}")
        if mode.verdict == "system"
        else mode
        for mode in result.modes
    )
    return replace(result, modes=replace(result.modes, modes=modes), warnings=(*result.warnings, warning))


def _left(gram: FloatArray, target: np.ndarray, past: np.ndarray) -> tuple[FloatArray, int]:
    """(n_inputs, n_inputs) products of what the past leaves of the inputs, and the rank of the past."""
    cross = gram[np.ix_(past, target)]
    weights, _, rank, _ = np.linalg.lstsq(gram[np.ix_(past, past)], cross, rcond=1e-12)
    left: FloatArray = gram[np.ix_(target, target)] - cross.T @ weights
    return 0.5 * (left + left.T), int(rank)
