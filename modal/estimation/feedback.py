"""Does something feed the outputs back into the inputs? Then a model of the noise is not a matter of choice.

Output error is consistent whatever the colour of the noise as long as the inputs know nothing of it. Under feedback
they do: the past of an output then tells more about an input than its own past. With a share R of what that past leaves
of the input explained by the output's m last samples,

    (N - numbers - (m + 2) / 2) ln(1 / (1 - R))

is chi-square with m degrees of freedom (Bartlett's approximation) where there is no feedback. A controller has few
roads, so each pair of an input and an output is asked apart, and the least of so many p-values multiplied (Bonferroni).
An input that its own past foretells, a sweep or a tone, is foretold as well by whatever has filtered it, and not asked.
Where a part of the band is empty, an input is foretold as far as its sensor's noise lets it, and outputs, which know
the force without that noise, tell a little more: as much as that noise may hide is taken off R.

What feedback does to a model matters, not that it is there: the same regression with what a free run leaves in the
place of the outputs gives the part of the inputs that the noise has made, and that part gives the bias.

References:
    Granger, Econometrica 37(3), 1969, 424-438, doi 10.2307/1912791 (the past of one series in the other); Bartlett,
    Proceedings of the Cambridge Philosophical Society 34(1), 1938, 33-40, doi 10.1017/S0305004100019880; Forssell,
    Ljung, Automatica 35(7), 1999, 1215-1241, doi 10.1016/S0005-1098(99)00022-9 (bias of direct methods).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from modal.estimation.free_run import filled
from modal.estimation.prediction_error import ROWS_A_NUMBER
from okid.arrays import FloatArray
from okid.frequency_response import averaged_spectra
from okid.gram import LagGram, lag_gram
from okid.markov import solve_recursion
from okid.record import Record
from okid.scaling import ChannelScaling, channel_scaling

FALSE_ALARMS = 0.01
"""Speak of feedback where so few records without it would look as much like it."""
OWN_PAST = 40
"""Let an input know its own past over so many samples,"""
LONGER = (1, 2, 4)
"""or so many times as many where Schwarz's criterion prefers that: the edge of a steep filter takes 160 to foretell."""
MOST_NUMBERS = 2500
"""Make a Gram matrix of no more columns; of many channels the past is shorter."""
OTHER_PAST = 4
"""Look for so many samples of the outputs' past in it: a controller answers at once."""
OLD_PAST, OLD_RIDGE = 24, 1e-6
"""Foretell these, where older ones are asked, from so many of an output, twelve modes; with a ridge of this share of
their mean power, as what filters leave near half of the sampling frequency has next to none."""
SEGMENT = 256
"""Look for the floor of an input's spectrum in segments of so many samples: 128 lines show an empty part of it."""
EMPTY, LEAST_EMPTY = 1e-3, 0.05
"""Call a part of the band empty where an input has 30 dB less than its mean density there, from 5 % of the lines on:
its sensor's noise fills it; no controller of the tests' 15 loops leaves so little."""
LONGEST_MADE = 0.999
"""Let what errors make of the inputs live on by this a sample at most, a thousand samples."""
ROUNDING = float(np.sqrt(np.finfo(float).eps))
"""Take for rounding what so small a share of the size of an input is left of it."""
FORETOLD = 0.01
"""Ask nothing of inputs of which their own past leaves less than this share of the power, a tenth of their size."""


def feedback_p_value(records: Sequence[Record], *, older: int = 0) -> float:
    """How often records without feedback look as much like it; nan where the inputs cannot be asked.

    Args:
        records: as measured: a filter that looks ahead makes the past of the outputs know the inputs.
        older: samples; of the outputs' last ones only what samples before these foretell is asked.

    Example:
        >>> rng = np.random.default_rng(1)
        >>> r, e, u, y = *rng.standard_normal((2, 2000)), np.zeros(2000), np.zeros(2000)
        >>> for k in range(1, 2000):
        ...     u[k] = r[k] - 0.3 * y[k - 1]
        ...     y[k] = 0.5 * y[k - 1] + u[k - 1] + e[k]
        >>> feedback_p_value([Record(u, y, 0.1)]) < 1e-3, feedback_p_value([Record(r, y, 0.1)]) > 1e-3
        (True, True)
    """
    told = _Told.of(records)
    if told is None:
        return float("nan")
    told = told.by_older(records, older) if older else told
    left, m, q = told.left, told.n_inputs, told.n_outputs
    power, n_rows = np.diag(left)[:m], told.n_rows - told.own * m - 1
    if n_rows <= told.own * m or (power <= FORETOLD * told.power).any():
        return float("nan")
    least, denoised = 1.0, told.denoised(records)
    for j in range(q):
        own = m + j + q * np.arange(OTHER_PAST)
        weights, _, rank, _ = np.linalg.lstsq(left[np.ix_(own, own)], left[own, :m], rcond=1e-12)
        if rank:  # of a loop that gives back one sample, all but the last of the outputs stand in the inputs' own past
            explained = (((left[own, :m] * weights).sum(axis=0) / power - denoised) / (1.0 - denoised)).max()
            ratio = -np.log(np.clip(1.0 - explained, np.finfo(float).tiny, 1.0))
            least = min(least, float(scipy.special.chdtrc(rank, (n_rows - (rank + 2) / 2) * ratio)))
    return min(1.0, m * q * least)


def inputs_made_by(errors: Sequence[FloatArray], records: Sequence[Record]) -> list[FloatArray]:
    """(n_samples, n_inputs) a record: the part of its inputs that the errors of the outputs made.

        u(k) = sum of a_i u(k - i) + sum of f_i e(k - i) + what comes from outside,

    by least squares, with the same lags as the test; run from rest on the errors alone. A loop that was recorded is
    stable: a recursion that grows is drawn into the unit circle.

    Args:
        errors: (n_samples, n_outputs) a record, NaN where there is none.
        records: with the inputs.
    """
    told = _Told.of([replace(record, outputs=error) for record, error in zip(records, errors, strict=True)])
    if told is None:
        return [np.full_like(record.inputs, np.nan) for record in records]
    m, q = told.n_inputs, told.n_outputs
    later = np.linalg.lstsq(told.left[m:, m:], told.left[m:, :m], rcond=1e-12)[0]
    own = (told.weights[1:, :m] - told.weights[1:, m:] @ later).reshape(told.own, m, m).transpose(0, 2, 1)
    radius = _radius(own)
    own *= min(1.0, LONGEST_MADE / radius) ** np.arange(1, told.own + 1)[:, np.newaxis, np.newaxis]
    made = []
    size, level = told.scaling.output_scale, told.scaling.output_mean
    for error in errors:
        scaled = np.nan_to_num((error - level) / size)
        forcing = np.zeros((len(error), m))
        for i in range(OTHER_PAST):
            forcing[i + 1 :] += scaled[: -i - 1] @ later[i * q : (i + 1) * q]
        made.append(solve_recursion(own, forcing[..., np.newaxis])[..., 0] * told.scaling.input_scale)
    return made


def from_outside(records: Sequence[Record]) -> tuple[Record, ...]:
    """The records with what moves the inputs from outside a loop in the place of the inputs: what feeds back leaves it.

        v(k) = u(k) - sum of a_i u(k - i) - sum of f_i y(k - i),   i from 1,

    by least squares. Whatever feeds the outputs back a sample later or more, v knows nothing of the noise in them, so
    outputs that follow v do so through the system alone. (A loop that answers within the sample cannot be told from a
    system that does.) Where a reference moves the inputs it is in v; without one v is rounding, which is
    zero here, or the noise of the inputs' own sensors, which no output follows.

    Args:
        records: as measured, with inputs.

    Returns:
        The records, shorter by the lags, without those that are no longer; as they came where too few for the sums.

    Example:
        >>> rng = np.random.default_rng(1)
        >>> r, e, u, y = *rng.standard_normal((2, 4000)), np.zeros(4000), np.zeros(4000)
        >>> for k in range(1, 4000):
        ...     y[k] = 0.5 * y[k - 1] + u[k - 1] + e[k]
        ...     u[k] = r[k] - 0.3 * y[k - 1]
        >>> (free,) = from_outside([Record(u, y, 0.1)])
        >>> bool(np.corrcoef(free.inputs[:, 0], r[-len(free.inputs) :])[0, 1] > 0.9)
        True
    """
    told = _Told.of(records)
    if told is None:
        return tuple(records)
    m, q, scaling = told.n_inputs, told.n_outputs, told.scaling
    n_rows = sum(record.n_samples for record in records)
    own = max(1, min(told.own, n_rows // (ROWS_A_NUMBER * (m + q))))
    gram = lag_gram(records, own, scaling=scaling)
    known = np.r_[0, 1 + m + q : len(gram.matrix)]
    weights = np.linalg.lstsq(gram.matrix[np.ix_(known, known)], gram.matrix[known, 1 : 1 + m], rcond=1e-12)[0]
    free = []
    for record in filled([one for one in records if one.n_samples > own]):
        inputs = (np.nan_to_num(record.inputs) - scaling.input_mean) / scaling.input_scale
        both = np.hstack([inputs, (record.outputs - scaling.output_mean) / scaling.output_scale])
        n = len(both) - own
        made = np.tile(weights[0], (n, 1))
        for i in range(1, own + 1):
            made += both[own - i : own - i + n] @ weights[1 + (i - 1) * (m + q) : 1 + i * (m + q)]
        left = inputs[own:] - made
        there = np.sqrt(np.square(left).mean(axis=0)) > ROUNDING
        free.append(replace(record.samples(own), inputs=np.where(there, left, 0.0)))
    return tuple(free or records)


def _radius(own: FloatArray) -> float:
    """Growth a sample of u(k) = sum of own[i] u(k - 1 - i)."""
    n_lags, m, _ = own.shape
    companion = np.eye(n_lags * m, k=-m)
    companion[:m] = own.transpose(1, 0, 2).reshape(m, -1)
    return float(np.abs(np.linalg.eigvals(companion)).max())


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Told:
    """What the inputs' own past leaves of the inputs and of the past of the outputs.

    Attributes:
        left: (n_inputs + n_outputs OTHER_PAST, same) products of what is left.
        weights: (1 + n_inputs own, same) of the level and the inputs' own past.
        power: (n_inputs,) squares of the inputs themselves.
        n_rows: summed over.
        own: lags of the inputs' own past.
        n_inputs: of the records.
        n_outputs: of the records.
        scaling: of the channels.
    """

    left: FloatArray
    weights: FloatArray
    power: FloatArray
    n_rows: int
    own: int
    n_inputs: int
    n_outputs: int
    scaling: ChannelScaling

    def denoised(self, records: Sequence[Record]) -> FloatArray:
        """(n_inputs,) share of what is left that the sensor's noise in an input's own past may have put there.

        With the weights a of that past and white noise of the density in the empty part of the band, var sum of a^2;
        nothing where no part is empty.
        """
        longest = max(record.n_samples for record in records)
        spectra = averaged_spectra(records, n_per_segment=min(SEGMENT, longest))
        density = spectra.power[1:-1, : self.n_inputs]
        if spectra.n_averages == 0 or not density.size:
            return np.zeros(self.n_inputs)
        level = np.maximum(density.mean(axis=0), np.finfo(float).tiny)
        empty = density < EMPTY * level
        floor = [
            float(np.median(one[there])) if there.mean() > LEAST_EMPTY else 0.0
            for one, there in zip((density / level).T, empty.T, strict=True)
        ]
        m = self.n_inputs
        own = self.weights[1:, :m].reshape(self.own, m, m)[:, np.arange(m), np.arange(m)]
        share = (
            np.array(floor)
            * self.power
            * np.square(own).sum(axis=0)
            / np.maximum(np.diag(self.left)[:m], np.finfo(float).tiny)
        )
        return np.asarray(np.minimum(share, 0.99), dtype=np.float64)

    @classmethod
    def of(cls, records: Sequence[Record]) -> "_Told | None":
        """None where there are no inputs, or too few rows."""
        m, q = records[0].n_inputs, records[0].n_outputs
        n_rows = sum(record.n_samples for record in records)
        least = min(OWN_PAST, n_rows // (ROWS_A_NUMBER * (m + q)))
        if not m or least < OTHER_PAST:
            return None
        most = max(least, min(n_rows // (ROWS_A_NUMBER * m), MOST_NUMBERS // (m + q)))
        scaling = channel_scaling(records)
        longest = lag_gram(records, min(most, LONGER[-1] * OWN_PAST), scaling=scaling)
        told = [
            cls._from(longest.truncated(own), scaling, own=own, lags_asked=range(1, OTHER_PAST + 1))
            for own in (min(times * least, longest.order) for times in LONGER)
        ]
        told = [one for one in told if one.n_rows > 2 * len(one.weights)]  # where samples are missing few are whole
        return min(told, key=lambda one: one.criterion, default=None)

    def by_older(self, records: Sequence[Record], older: int) -> "_Told":
        """With what the samples of each output before the last `older` foretell of its last ones in their place."""
        m, q, scaling = self.n_inputs, self.n_outputs, self.scaling
        gram = lag_gram(records, max(self.own, older + OLD_PAST), scaling=scaling)
        lags_asked = [*range(1, OTHER_PAST + 1), *range(older + 1, older + OLD_PAST + 1)]
        told = self._from(gram, scaling, own=self.own, lags_asked=lags_asked)
        foretell = np.zeros((m + q * OTHER_PAST, len(told.left)))
        foretell[:m, :m] = np.eye(m)
        for j in range(q):
            last = m + j + q * np.arange(OTHER_PAST)
            old = m + j + q * np.arange(OTHER_PAST, OTHER_PAST + OLD_PAST)
            within, onto = told.left[np.ix_(old, old)], told.left[np.ix_(old, last)]
            ridge = max(OLD_RIDGE * np.trace(within) / OLD_PAST, np.finfo(float).tiny)
            foretell[np.ix_(last, old)] = np.linalg.solve(within + ridge * np.eye(OLD_PAST), onto).T
        return replace(told, left=foretell @ told.left @ foretell.T)

    @classmethod
    def _from(cls, gram: LagGram, scaling: ChannelScaling, *, own: int, lags_asked: Sequence[int]) -> "_Told":
        m, q = gram.n_inputs, gram.n_outputs
        lags = 1 + (m + q) * np.arange(gram.order + 1)[:, np.newaxis]
        inputs = (lags[: own + 1] + np.arange(m)).ravel()
        asked = np.concatenate([inputs[:m], (lags[list(lags_asked)] + m + np.arange(q)).ravel()])
        past = np.concatenate([[0], inputs[m:]])
        cross = gram.matrix[np.ix_(past, asked)]
        weights = np.linalg.lstsq(gram.matrix[np.ix_(past, past)], cross, rcond=1e-12)[0]
        left = gram.matrix[np.ix_(asked, asked)] - cross.T @ weights
        return cls(
            left=0.5 * (left + left.T),
            weights=weights,
            power=np.diag(gram.matrix)[inputs[:m]],
            n_rows=gram.n_rows,
            own=own,
            n_inputs=m,
            n_outputs=q,
            scaling=scaling,
        )

    @property
    def criterion(self) -> float:
        """Schwarz's, of what their own past leaves of the inputs."""
        of_inputs = self.left[: self.n_inputs, : self.n_inputs] / self.n_rows
        numbers = self.n_inputs**2 * self.own
        return float(self.n_rows * np.linalg.slogdet(of_inputs).logabsdet + numbers * np.log(self.n_rows))
