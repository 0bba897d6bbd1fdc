"""Derivatives of a law by central differences, and how far the law's own are from them.

Nothing here imports okid, era or modal: a law is anything with `force(values, motion)`, a motion is any dataclass with
`displacement`, `velocity` and `memory`.
"""

from dataclasses import replace

import numpy as np


def central(value_at, at, step=1e-6):
    """Central difference of `value_at` at the number `at`."""
    step *= max(abs(at), 1.0)
    return (value_at(at + step) - value_at(at - step)) / (2.0 * step)


def shifted(motion, moved, shift):
    """The motion with one field shifted; a number means that state of the memory."""
    if isinstance(moved, str):
        return replace(motion, **{moved: getattr(motion, moved) + shift})
    memory = motion.memory.copy()
    memory[:, moved] += shift
    return replace(motion, memory=memory)


def disagreement(derivative, difference):
    """Largest difference, by the largest entry (or by 1 where all are small)."""
    assert derivative.shape == difference.shape, (derivative.shape, difference.shape)
    assert np.all(np.isfinite(derivative))
    return float(
        np.max(np.abs(derivative - difference), initial=0.0) / max(np.max(np.abs(difference), initial=0.0), 1.0)
    )


def by_value(value_of, values, j):
    """Central difference of `value_of(values)` by value j."""
    return central(lambda value: value_of([*values[:j], value, *values[j + 1 :]]), values[j])


def force_disagreement(effect, values, motion):
    """How far each derivative of a force law is from central differences: {name: share}."""
    force = effect.force(values, motion)
    found = {
        f"by_{moved}": disagreement(
            getattr(force, f"by_{moved}"),
            central(lambda s, moved=moved: effect.force(values, shifted(motion, moved, s)).value, 0.0),
        )
        for moved in ("displacement", "velocity")
    }
    for m in range(motion.memory.shape[1]):
        difference = central(lambda s, m=m: effect.force(values, shifted(motion, m, s)).value, 0.0)
        found[f"by_memory {m}"] = disagreement(force.by_memory[:, m], difference)
    for j in range(len(values)):
        difference = by_value(lambda changed: effect.force(changed, motion).value, values, j)
        found[f"by_parameter {j}"] = disagreement(force.by_parameter[:, j], difference)
    return found
