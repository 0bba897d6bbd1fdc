"""Do the outputs tell of inputs that lie ahead of them?

A model of samples holds its inputs from one to the next, or joins them by lines. What moves between its samples does
neither: a force limited to half of the sampling frequency is at every instant a sum over its samples, of those that
are still to come as well. A causal model leaves what they add, as an error that follows the input and rings in no mode,
and where modes lie above half of the sampling frequency it is many times the noise. With the inputs taken so many
samples early that the sum has died out, the model holds it.

Nested regressions tell how many. With p outputs and inputs of the past in the model, S_L what the inputs up to L
samples ahead leave of the outputs, and M samples looked at in all,

    (N - numbers - (n_outputs + 1) / 2) ln(det S_L / det S_M)

is chi-square with (M - L) n_inputs n_outputs degrees of freedom where the inputs beyond L tell nothing (Bartlett). One
Cholesky factor holds all S_L. Three things refuse a lead: a sum that has not died out half of the way; inputs that even
so follow the outputs, as a controller makes them do (it too makes the inputs ahead tell of what is now); and a first
model that comes no nearer.

References:
    Sims, American Economic Review 62(4), 1972, 540-552 (leads in a regression as a test of what drives what); Bartlett,
    Proceedings of the Cambridge Philosophical Society 34(1), 1938, 33-40, doi 10.1017/S0305004100019880.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy

from modal.estimation.cross_validation import LONGEST_SCORED, scaled_record, stretches_of
from modal.estimation.free_run import free_runs
from modal.preparation.delay import CHANCE, MOST_LEAD, RIDGE, ROUNDING, InputDelay, delay_words, late_inputs
from modal.preparation.feedback import feedback_p_value
from modal.preparation.quick_model import observer_order, quick_model
from okid.arrays import FloatArray
from okid.gram import lag_gram
from okid.record import Record
from okid.rows import spread_stretches
from okid.scaling import channel_scaling

BLOCKS = 40
"""Compare two models in so many blocks of rows."""


def with_lead(delay: InputDelay, records: Sequence[Record], measured: Sequence[Record]) -> InputDelay:
    """The same, inputs that act at once taken early where outputs tell of what lies ahead of them.

    Args:
        delay: that the pulse response shows.
        records: that are to be fitted, with inputs as they came.
        measured: the same before they were decimated: a filter that looks ahead makes inputs follow outputs.

    Example:
        >>> from modal.preparation.delay import choose_input_delay
        >>> rng = np.random.default_rng(0)
        >>> force, noise = rng.standard_normal((2, 4000))
        >>> record = Record(force[:-1], force[:-1] + 0.2 * force[1:] + 0.01 * noise[1:], 0.01)
        >>> with_lead(choose_input_delay([record]), [record], [record]).samples
        (-1,)
    """
    if any(not record.complete_rows().all() for record in records) or all(delay.samples):
        return delay  # a first model needs whole rows
    lead = _lead(late_inputs(records, delay.samples))
    if not lead:
        return delay
    early = tuple(d or -lead for d in delay.samples)
    factor = round(records[0].dt / measured[0].dt)
    if not feedback_p_value(late_inputs(measured, [factor * min(0, d) for d in early])) >= CHANCE:  # nor where nan
        return delay
    if not _comes_nearer(late_inputs(records, early), late_inputs(records, delay.samples)):
        return delay
    reason = (
        "outputs also tell of inputs that lie ahead of them, as of a force that moves between its samples; the model "
        "looks ahead as far as that lasts, its modes answer at once"
    )
    choice = replace(delay.choice, value=delay_words(early, records[0]), reason=reason)
    return replace(delay, samples=early, choice=choice)


def _lead(records: Sequence[Record]) -> int:
    """Samples ahead after which inputs tell nothing more; 0 where none do, or where that is not seen to end."""
    order, (m, q) = observer_order(records), (records[0].n_inputs, records[0].n_outputs)
    some = spread_stretches(records, LONGEST_SCORED)
    gram = lag_gram(some, order + MOST_LEAD, scaling=channel_scaling(some))
    n_numbers = 1 + order * (m + q) + (1 + MOST_LEAD) * m
    if gram.n_rows < 2 * n_numbers:
        return 0
    # the row asked of is MOST_LEAD samples old, so that the inputs ahead of it are known
    lags = 1 + (m + q) * np.arange(order + MOST_LEAD + 1)[:, np.newaxis]
    inputs, outputs = lags + np.arange(m), lags + m + np.arange(q)
    past = [[0], outputs[MOST_LEAD + 1 :].ravel(), inputs[MOST_LEAD:].ravel()]
    places = np.concatenate([*past, inputs[:MOST_LEAD][::-1].ravel(), outputs[MOST_LEAD]])
    matrix = gram.matrix[np.ix_(places, places)] / gram.n_rows
    factor = scipy.linalg.cholesky(matrix + RIDGE * np.eye(len(places)))[:, -q:]
    ahead, left = factor[-q - MOST_LEAD * m : -q].reshape(MOST_LEAD, m, q), factor[-q:]
    told = np.cumsum(np.einsum("lmi,lmj->lij", ahead, ahead)[::-1], axis=0)[::-1]  # by those from each lag on
    least = left.T @ left + ROUNDING * np.eye(q)
    ratio = np.linalg.slogdet(least + told).logabsdet - np.linalg.slogdet(least).logabsdet
    freedom = m * q * np.arange(MOST_LEAD, 0, -1)
    chance = scipy.special.chdtrc(freedom, (gram.n_rows - n_numbers - (q + 1) / 2) * ratio)
    lead = int(np.argmax(chance >= CHANCE)) if (chance >= CHANCE).any() else MOST_LEAD
    return lead if lead <= MOST_LEAD // 2 else 0


def _comes_nearer(early: Sequence[Record], late: Sequence[Record]) -> bool:
    """Whether the free run of a first model does with the inputs early, from block to block and beyond chance."""
    ahead, now = _block_errors(early), _block_errors(late)
    if ahead is None or now is None:
        return ahead is not None
    gained = now - ahead
    t = gained.mean() / max(gained.std(ddof=1) / np.sqrt(BLOCKS), np.finfo(float).tiny)
    return bool(scipy.special.stdtr(BLOCKS - 1, -t) < CHANCE)


def _block_errors(records: Sequence[Record]) -> FloatArray | None:
    """(BLOCKS,) squares that the free run of a first model leaves, channels of like size; None where there is none."""
    scaling = channel_scaling(records)
    scaled = [scaled_record(record, scaling) for record in records]
    model = quick_model(scaled)
    if model is None:
        return None
    compared = [scaled[one.record].samples(one.first, one.last) for one in stretches_of(scaled)]
    runs = zip(compared, free_runs(model.form, compared), strict=True)
    squares = np.concatenate([np.square(record.outputs - run).sum(axis=1) for record, run in runs])
    return np.array([block.sum() for block in np.array_split(squares, BLOCKS)])
