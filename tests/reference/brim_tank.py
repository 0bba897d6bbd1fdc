"""A tank with a brim, by exact steps: below it h' = q - p h, above it h' = q - p h - rate (h - limit), q held.

Nothing here imports okid, era or modal.
"""

import numpy as np


def staircase(n, seed, *, low=0.2, high=2.0, shortest=20, longest=80):
    """Held inflows (n,) of random lengths and sizes."""
    rng = np.random.default_rng(seed)
    found = []
    while len(found) < n:
        found += [rng.uniform(low, high)] * int(rng.integers(shortest, longest))
    return np.array(found[:n])


def levels(inflow, dt, *, p, limit, rate, start=0.0):
    """Level at each sample, every crossing of the brim inside a step met exactly; rate infinite: held at the limit."""
    h, found = start, []
    for q in inflow:
        found.append(h)
        left = dt
        while left > 0.0:
            h, left = _until_the_brim(h, q, left, p=p, limit=limit, rate=rate)
    return np.array(found)


def _until_the_brim(h, q, left, *, p, limit, rate):
    """Level after the rest of a step, or at the brim with what is left of the step."""
    above = h > limit or (h == limit and q > p * limit)
    if above and np.isinf(rate):
        if q >= p * limit:
            return limit, 0.0
        h, above = limit, False
    pole = p + rate if above else p
    rest = (q + rate * limit) / pole if above else q / p
    end = rest + (h - rest) * np.exp(-pole * left)
    if h != limit and (h - limit) * (end - limit) < 0.0:
        spent = np.log((h - rest) / (limit - rest)) / pole
        return limit, left - spent
    return end, 0.0
