"""Is the system linear? What is not answers to squares and cubes of the motion, and a linear model leaves that behind.

The errors e of a linear system's one-step prediction know nothing of what was known before them, whatever drives it and
however that is distributed: with x(t) the motion that is predicted for t,

    E[ g(x(t), x(t - 1)) e(t) ] = 0,        for any g (a martingale difference).

Squares and cubes are asked. A model that is an average of something not linear cannot have zero there. Inputs that were
measured with noise are no such knowledge: the errors follow the motion then, the more the quieter it is. So powers of
the motion over its own level before are asked as well, with a gain that changes with that level, and the larger chance
counts. A model that is too small leaves what is linear in the motion long before: of normal motion its own Hermite
polynomials have nothing in common with that, those over a level have.

References:
    Billings, Voon, Int. J. Control 44(1), 1986, doi 10.1080/00207178608933593 (residuals against powers).
    Hotelling, Annals of Mathematical Statistics 2(3), 1931, doi 10.1214/aoms/1177732979.
"""

from collections.abc import Sequence

import numpy as np
import scipy

from okid.arrays import TINY, FloatArray
from okid.record import Record
from okid.rows import spread_stretches

NOT_LINEAR = 1e-4
"""Say so where chance makes as much of it less often."""
MOST_MOTIONS = 2
"""Take powers of so many independent motions at most."""
LAGS = 2
"""Take them at so many samples back: what acts between two samples depends on both ends."""
BEFORE, QUIETEST = 100, 1e-3
"""Take the level of the motion over so many rows before, and for no less than this share of that of all."""
EXPLAINED = 1e-9
"""Ask nothing of a power or an error of which the rest explains all but such a share: that is rounding."""
BLOCKS = 200
"""Tell the scatter of the products from so many blocks of rows: what is left need not be white within one."""
MOST_ROWS = 100_000
"""Ask so many rows at most: what they do not show moves no mode."""


def chance_of_powers(records: Sequence[Record], predicted: Sequence[Record]) -> float:
    """How often the errors of a linear system's prediction follow squares and cubes of what is predicted as well.

    Two principal motions give second and third Hermite polynomials, less what predictions and inputs explain of them
    linearly. Their products with the errors of an output, summed over blocks, have the mean 0: by
    Hotelling's T squared, the least chance of all outputs times their number.

    Args:
        records: with inputs; of others nothing is told, nor of fewer than four whole rows a block.
        predicted: each one step ahead.

    Example:
        >>> force, noise = np.random.default_rng(0).standard_normal((2, 8000, 1))
        >>> record = Record(force, force + 0.1 * force**3 + noise, 0.01)
        >>> chance_of_powers([record], [Record(force, 1.3 * force, 0.01)]) < 1e-9
        True
        >>> chance_of_powers([Record(force, force + noise, 0.01)], [Record(force, force, 0.01)]) > 0.01
        True
    """
    n_inputs, n_outputs = records[0].n_inputs, records[0].n_outputs
    both = [
        Record(np.hstack([record.inputs, run.outputs]), record.outputs - run.outputs, record.dt)
        for record, run in zip(records, predicted, strict=True)
        if record.n_samples > max(n_inputs + n_outputs, BEFORE)
    ]
    if n_inputs == 0 or not both:
        return 1.0
    asked = spread_stretches(both, MOST_ROWS)
    known = np.vstack([one.inputs for one in asked])
    middle, size = known.mean(axis=0), np.maximum(known.std(axis=0), TINY)
    scaled = ((known - middle) / size)[:, n_inputs:]
    axes = np.linalg.eigh(scaled.T @ scaled)[1][:, -MOST_MOTIONS:]
    axes = axes / np.maximum((scaled @ axes).std(axis=0), TINY)
    told = [((one.inputs - middle) / size, one.outputs[LAGS - 1 :]) for one in asked]
    motions = [values[:, n_inputs:] @ axes for values, _ in told]
    as_it_is = [np.ones((len(motion), 1)) for motion in motions]
    return max(_chance_of(told, motions, levels) for levels in (as_it_is, [_level(motion) for motion in motions]))


def _chance_of(
    parts: Sequence[tuple[FloatArray, FloatArray]], motions: Sequence[FloatArray], levels: Sequence[FloatArray]
) -> float:
    """The chance of parts of what is known and errors, with powers of motions over their levels."""
    linear, powers = [], []
    for (values, _), motion, level in zip(parts, motions, levels, strict=True):
        beside, loudness = _with_past(np.hstack([values, motion / level])), np.log(level[LAGS - 1 :])
        linear.append(np.hstack([beside, beside * loudness, beside * loudness**2, loudness, loudness**2]))
        own = motion / level
        powers.append(_with_past(np.hstack([own**2 - 1.0, own**3 - 3.0 * own])))
    causes, rest = np.hstack([np.vstack(powers), np.vstack(linear)]), np.vstack([errors for _, errors in parts])
    n = powers[0].shape[1]
    there = np.isfinite(rest).all(axis=1) & np.isfinite(causes).all(axis=1)
    if there.sum() < 4 * BLOCKS:
        return 1.0
    beside = np.hstack([causes[there, n:], np.ones((int(there.sum()), 1))])
    sought = np.hstack([causes[there, :n], rest[there]])
    left = sought - beside @ np.linalg.lstsq(beside, sought, rcond=None)[0]
    told = left.std(axis=0) > EXPLAINED * np.abs(sought).max(axis=0)  # else it is rounding
    if not told[:n].any():
        return 1.0
    own = left[:, :n][:, told[:n]]
    chances = [_chance(own * left[:, [n + o]]) for o in np.flatnonzero(told[n:])]
    return min(1.0, rest.shape[1] * min(chances, default=1.0))


def _level(motion: FloatArray) -> FloatArray:
    """(n_samples, 1) rms of the motions over the rows before."""
    sums = np.cumsum(np.concatenate([np.zeros(1), np.square(motion).mean(axis=1)]))
    last = np.maximum(np.arange(len(motion)), 1)
    first = np.maximum(last - BEFORE, 0)
    power = (sums[last] - sums[first]) / (last - first)
    level: FloatArray = np.sqrt(np.maximum(power, QUIETEST**2 * power.mean()))[:, np.newaxis]
    return np.maximum(level, TINY)


def _with_past(values: FloatArray) -> FloatArray:
    """(n_samples - LAGS + 1, LAGS n) values beside those before."""
    n = len(values) - LAGS + 1
    return np.hstack([values[LAGS - 1 - k :][:n] for k in range(LAGS)])


def _chance(products: FloatArray) -> float:
    """How often columns of the mean 0 have sums so far from it, by the scatter of their blocks (Hotelling)."""
    blocks = np.add.reduceat(products, np.linspace(0, len(products), BLOCKS, endpoint=False).astype(int), axis=0)
    blocks = blocks / np.maximum(np.sqrt(np.square(blocks).sum(axis=0)), TINY)
    sums, moments = blocks.sum(axis=0), blocks.T @ blocks
    values, vectors = np.linalg.eigh(moments)
    told = values > len(values) * np.finfo(float).eps * values.max()
    squared = float((np.square(vectors[:, told].T @ sums) / values[told]).sum())
    n, freedom = int(told.sum()), BLOCKS - int(told.sum())
    return float(scipy.special.fdtrc(n, freedom, squared / max(TINY, BLOCKS - squared) * freedom / n))
