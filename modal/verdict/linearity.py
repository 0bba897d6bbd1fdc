"""Is the system linear? What is not answers to squares and cubes of the motion, and a linear model leaves that behind.

The errors e of a linear system's one-step prediction know nothing of what was known before them, whatever drives it and
however that is distributed: with x(t) the motion that is predicted for t,

    E[ g(x(t), x(t - 1)) e(t) ] = 0,        for any g (a martingale difference).

Squares and cubes of x and of its increments are asked, beside all that is linear in what was known: inputs and
predictions, and errors of the rows before. A model that is an average of something not linear cannot have zero there.
One that is too small, or runs freely, leaves what is linear in what was known before, as long as the system remembers
it, and then the errors are no martingale difference. So where powers seem to make some of them, what powers do not
explain is asked by the same products whether it follows what was known further back: where it does, more of the past is
taken, and where no past that the rows can tell is enough, nothing is told. Inputs that were measured with noise are no
such knowledge: the errors follow the motion then, the more the quieter it is. So powers of the motion over its own
level are asked as well, with a gain that changes with that level, and the larger chance counts.

References:
    Billings, Voon, Int. J. Control 44(1), 1986, doi 10.1080/00207178608933593 (residuals against powers).
    Hotelling, Annals of Mathematical Statistics 2(3), 1931, doi 10.1214/aoms/1177732979.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from okid.arrays import TINY, BoolArray, FloatArray
from okid.record import Record
from okid.rows import spread_stretches

NOT_LINEAR = 1e-4
"""Say so where chance makes as much of it less often."""
MOST_MOTIONS, MOST_KNOWN = 2, 8
"""Take powers of so many independent motions at most, beside so many of predictions and inputs and so many errors;"""
LAGS, PAST, MOST_PAST = 2, 10, 80
"""powers at so many samples back, for what acts between two samples depends on both ends; what is known at so many, and
at twice as many as long as the errors follow what is further back, up to so many."""
FURTHER, NOT_WHITE = 10, 0.01
"""Ask so many samples further back, and say that errors follow them where chance makes as much of it less often."""
BEFORE, QUIETEST = 100, 1e-3
"""Take the level of the motion over so many rows, and for no less than this share of that of all."""
EXPLAINED = 1e-9
"""Ask nothing of a power or an error of which the rest explains all but such a share: that is rounding."""
BLOCKS, BLOCK = 200, 4
"""Tell the scatter of the products from so many blocks, each of so many rows at least."""
MOST_ROWS = 30_000
"""Ask so many rows at most, as the search for the order does: what they do not show moves no mode."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Powers:
    """What squares and cubes of the motion make of the errors of a prediction.

    Attributes:
        chance: how often those of a linear system follow them as well; 1 where nothing is told.
        share: of the power of the errors that they make, beyond chance, in the output that shows most.
    """

    chance: float = 1.0
    share: float = 0.0

    @property
    def told(self) -> bool:
        """Whether something is not linear."""
        return self.chance < NOT_LINEAR


def powers_of_motion(records: Sequence[Record], predicted: Sequence[Record]) -> Powers:
    """How often the errors of a linear system's prediction follow squares and cubes of what is predicted as well.

    Two principal motions give second and third Hermite polynomials, less what is known linearly. Their products with
    the errors of an output, summed over blocks, have the mean 0: by Hotelling's T squared, the least chance of all
    outputs times their number.

    Args:
        records: with inputs; of others nothing is told, nor of fewer rows than a few times what is known.
        predicted: each one step ahead.

    Example:
        >>> force, noise = np.random.default_rng(0).standard_normal((2, 8000, 1))
        >>> record = Record(force, force + 0.1 * force**3 + noise, 0.01)
        >>> found = powers_of_motion([record], [Record(force, 1.3 * force, 0.01)])
        >>> found.told, round(found.share, 2)  # of 0.1 (u^3 - 3 u), whose variance is 0.06
        (True, 0.05)
        >>> powers_of_motion([Record(force, force + noise, 0.01)], [Record(force, force, 0.01)]).told
        False
    """
    n_inputs, n_outputs = records[0].n_inputs, records[0].n_outputs
    both = [
        Record(np.hstack([record.inputs, run.outputs]), record.outputs - run.outputs, record.dt)
        for record, run in zip(records, predicted, strict=True)
        if record.n_samples > max(n_inputs + n_outputs, PAST)
    ]
    if n_inputs == 0 or not both:
        return Powers()
    asked = spread_stretches(both, MOST_ROWS)
    known, errors = (np.vstack([getattr(one, name) for one in asked]) for name in ("inputs", "outputs"))
    whole = np.isfinite(np.hstack([known, errors])).all(axis=1)
    if not whole.any():
        return Powers()
    size = known[whole].std(axis=0)  # what acts in rows of blows alone, that are not asked, tells nothing
    scaled = (known - known[whole].mean(axis=0)) / np.where(size > 0.0, size, np.inf)
    left = errors / np.maximum(np.sqrt(np.square(errors[whole]).mean(axis=0)), TINY)
    of_known, of_motion, of_errors = (
        _principal(values[whole], most)
        for values, most in ((scaled, MOST_KNOWN), (scaled[:, n_inputs:], MOST_MOTIONS), (left, MOST_KNOWN))
    )
    ends = np.cumsum([one.n_samples for one in asked])[:-1]
    parts = [
        _Part(known=values @ of_known, motion=values[:, n_inputs:] @ of_motion, past=own @ of_errors, errors=own)
        for values, own in zip(np.split(scaled, ends), np.split(left, ends), strict=True)
    ]
    past = PAST
    while past <= MOST_PAST:
        parts = [part for part in parts if len(part.errors) > past]
        forms = [_asked(parts, levelled=levelled, past=past) for levelled in (False, True)] if parts else []
        told = [form for form in forms if form is not None]
        if not told or len(told) < len(forms):
            break
        found = Powers(chance=max(one.powers.chance for one in told), share=max(one.powers.share for one in told))
        if not found.told or not any(_follow_further(parts, form, past) for form in told):
            return found
        past *= 2
    return Powers()


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Part:
    """(n_samples, ...) of a stretch: principal ones of predictions and inputs, of motion, of errors; and each error."""

    known: FloatArray
    motion: FloatArray
    past: FloatArray
    errors: FloatArray


def _principal(values: FloatArray, most: int) -> FloatArray:
    """(n, at most `most`) sums of columns that move most, each of size 1."""
    axes = np.linalg.eigh(values.T @ values)[1][:, -most:]
    size = (values @ axes).std(axis=0)
    return np.asarray(axes / np.where(size > 0.0, size, np.inf), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Asked:
    """What powers make of the errors, and what neither they nor what is known linearly make of them.

    Attributes:
        powers: as told.
        there: (n_samples,) rows that are asked, of all but the first `past` of each stretch.
        causes: (n_rows, ...) powers and what is known linearly in these rows.
        rest: (n_rows, n_outputs) errors less what all of these make, of outputs that leave more than rounding.
    """

    powers: Powers
    there: BoolArray
    causes: FloatArray
    rest: FloatArray


def _asked(parts: Sequence[_Part], *, levelled: bool, past: int) -> _Asked | None:
    """What is made of the errors by powers of motions and their increments as they are or over their levels."""
    powers, linear = _causes(parts, levelled=levelled, past=past)
    sought = np.hstack([powers, np.vstack([part.errors[past:] for part in parts])])
    n, there = powers.shape[1], np.isfinite(np.hstack([sought, linear])).all(axis=1)
    n_rows = int(there.sum())
    n_blocks = min(BLOCKS, n_rows // BLOCK)
    if n_blocks < 2 * n or n_rows < 4 * (n + linear.shape[1]):
        return None
    sought, beside = sought[there], np.hstack([linear[there], np.ones((n_rows, 1))])
    left, told = _without(beside, sought)
    if not told[:n].any():
        return None
    own, errors = left[:, :n][:, told[:n]], left[:, n:]
    chances = [_chance(own * errors[:, [o]], n_blocks) for o in np.flatnonzero(told[n:])]
    made = _explained(own, errors)
    by_chance = own.shape[1] * np.square(errors - made).mean(axis=0)
    share = (np.square(made).sum(axis=0) - by_chance) / np.maximum(np.square(sought[:, n:]).sum(axis=0), TINY)
    return _Asked(
        powers=Powers(chance=min(1.0, errors.shape[1] * min(chances, default=1.0)), share=max(0.0, float(share.max()))),
        there=there,
        causes=np.hstack([beside, own]),
        rest=(errors - made)[:, told[n:]],
    )


def _causes(parts: Sequence[_Part], *, levelled: bool, past: int) -> tuple[FloatArray, FloatArray]:
    """(n_samples - past a stretch, ...) powers of the motion, and what is known linearly so many rows back."""
    steps = np.vstack([np.diff(part.motion, axis=0) for part in parts])
    paces = np.sqrt(np.nansum(np.square(steps), axis=0) / max(1, np.isfinite(steps[:, 0]).sum()))
    linear, powers = [], []
    for part in parts:
        step = np.diff(part.motion, axis=0, prepend=part.motion[:1]) / np.maximum(paces, TINY)
        level, pace = (_level(each) if levelled else np.ones((len(step), 1)) for each in (part.motion, step))
        moved = np.hstack([_with_past(part.motion / level, LAGS, past), (step / pace)[past:]])
        powers.append(np.hstack([moved**2 - 1.0, moved**3 - 3.0 * moved]))
        beside, loudness = np.hstack([_with_past(part.known, LAGS, past), moved]), np.log(level[past:])
        errors = _with_past(part.past, past + 1, past)[:, part.past.shape[1] :]
        known = _with_past(part.known, past + 1, past)
        linear.append(
            np.hstack([known, errors, beside, beside * loudness, beside * loudness**2, loudness, loudness**2])
        )
    return np.vstack(powers), np.vstack(linear)


def _follow_further(parts: Sequence[_Part], asked: _Asked, past: int) -> bool:
    """Whether the rest follows what was known before the past, which counts as nothing where it was not measured."""
    further = np.vstack([_further(np.hstack([part.known, part.past]), past) for part in parts])[asked.there]
    left, told = _without(asked.causes, further)
    n_sources, n_blocks = further.shape[1] // FURTHER, min(BLOCKS, len(further) // BLOCK)
    sources = [left[:, k::n_sources][:, told[k::n_sources]] for k in range(n_sources)]
    chances = [
        _chance(source * error[:, np.newaxis], n_blocks) for source in sources if source.size for error in asked.rest.T
    ]
    return len(chances) * min(chances, default=1.0) < NOT_WHITE


def _explained(causes: FloatArray, sought: FloatArray) -> FloatArray:
    """What columns make of others, by QR: a singular value decomposition need not converge."""
    cond = max(causes.shape) * np.finfo(float).eps
    found = scipy.linalg.lstsq(causes, sought, cond=cond, lapack_driver="gelsy", check_finite=False)[0]
    return np.asarray(causes @ found, dtype=np.float64)


def _without(beside: FloatArray, sought: FloatArray) -> tuple[FloatArray, BoolArray]:
    """What the rest does not explain of columns, and which of these are more than rounding."""
    left = sought - _explained(beside, sought)
    return left, np.asarray(left.std(axis=0) > EXPLAINED * np.abs(sought).max(axis=0))


def _level(motion: FloatArray) -> FloatArray:
    """(n_samples, 1) rms of the motions over the rows up to each, which bounds the powers."""
    sums = np.cumsum(np.concatenate([np.zeros(1), np.square(motion).mean(axis=1)]))
    last = np.arange(1, len(motion) + 1)
    first = np.maximum(last - BEFORE, 0)
    power = (sums[last] - sums[first]) / (last - first)
    level: FloatArray = np.sqrt(np.maximum(power, QUIETEST**2 * power.mean()))[:, np.newaxis]
    return np.maximum(level, TINY)


def _with_past(values: FloatArray, lags: int, past: int) -> FloatArray:
    """(n_samples - past, lags n) values of the row and of those before, from row `past` on."""
    return np.hstack([values[past - k : len(values) - k] for k in range(lags)])


def _further(values: FloatArray, past: int) -> FloatArray:
    """(n_samples - past, FURTHER n) values of the rows before the past of each, 0 where there are none."""
    padded = np.pad(np.nan_to_num(values), ((FURTHER, 0), (0, 0)))
    return np.hstack([padded[k : k + len(values) - past] for k in range(FURTHER)])


def _chance(products: FloatArray, n_blocks: int) -> float:
    """How often columns of the mean 0 have sums so far from it, by the scatter of their blocks (Hotelling)."""
    blocks = np.add.reduceat(products, np.linspace(0, len(products), n_blocks, endpoint=False).astype(int), axis=0)
    blocks = blocks / np.maximum(np.sqrt(np.square(blocks).sum(axis=0)), TINY)
    sums, moments = blocks.sum(axis=0), blocks.T @ blocks
    values, vectors = np.linalg.eigh(moments)
    told = values > len(values) * np.finfo(float).eps * values.max()
    squared = float((np.square(vectors[:, told].T @ sums) / values[told]).sum())
    n, freedom = int(told.sum()), n_blocks - int(told.sum())
    return float(scipy.special.fdtrc(n, freedom, squared / max(TINY, n_blocks - squared) * freedom / n))
