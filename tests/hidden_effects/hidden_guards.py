"""What a drawn case must pass before it may be used, or it is drawn again.

A softening structure escapes, a strongly hardening one may be chaotic (no simulation of it can be checked against a
record), and an effect may happen to do nothing that a slightly wrong stiffness could not do. Nothing here looks at what
any method would find; nothing here imports okid, era or modal.
"""

from dataclasses import replace

import numpy as np
from hidden_plants import TrueChain
from hidden_truth import Truth, clean_outputs

__all__ = ["bounded", "contact_reached", "gap_beyond_linear", "repeatable"]

DISTURBANCE = 1e-5
GROWTH = 30.0


def bounded(outputs, linear):
    """Finite, and nowhere beyond six times the largest linear output of its record."""
    with np.errstate(invalid="ignore"):
        return bool(
            np.all(np.isfinite(outputs)) and np.all(np.abs(outputs).max(1) <= 6 * np.abs(linear).max(1) + 1e-300)
        )


def repeatable(truth, experiment, outputs, rows):
    """Whether a start that is off by 1e-5 leads to the same record: not chaotic."""
    chosen = experiment.only(rows)
    scale = np.abs(chosen.starts).max(axis=0) + outputs[rows].std() * 1e-3
    moved = replace(chosen, starts=chosen.starts + DISTURBANCE * scale)
    again, _ = clean_outputs(truth, moved)
    last = slice(3 * outputs.shape[1] // 4, None)
    apart = (again - outputs[rows])[:, last].std(axis=1) / outputs[rows][:, last].std(axis=1)
    return bool(np.all(apart < GROWTH * DISTURBANCE))


def contact_reached(effects, motion, lowest, highest):
    """A stop is not touched at the lowest level and truly hit at the highest."""
    for effect, d in zip(effects, np.moveaxis(motion, -1, 0), strict=True):
        if effect.effect == "gap_spring":
            gap, stops = effect.parameters["gap"], effect.parameters["k_in"] == 0
            if (stops and np.abs(d[lowest]).max() >= gap) or np.abs(d[highest]).max() < 1.25 * gap:
                return False
    return True


def gap_beyond_linear(truth, experiment, outputs, noise_variance, row):
    """What each effect adds to one record, less what stiffness, damping and initial state could explain.

    Root mean square over all outputs, each over its noise's deviation; one number an effect, the others being there.
    """
    one = experiment.only([row])
    sizes = []
    explained = _linear_directions(truth, one) / np.sqrt(noise_variance)
    basis, _ = np.linalg.qr(explained.reshape(len(explained), -1).T)
    for effect in truth.effects:
        others, _ = clean_outputs(truth.without(effect), one)
        if not np.all(np.isfinite(others)):
            return [0.0]
        gap = ((outputs[row] - others[0]) / np.sqrt(noise_variance)).ravel()
        gap = gap - basis @ (basis.T @ gap)
        sizes.append(float(np.sqrt(np.mean(gap**2))))
    return sizes


def _linear_directions(truth, one):
    """(n_directions, n_samples, n_outputs) of the linear plant: each stiffness, each damping, each initial state."""
    plain = Truth(plant=truth.plant, effects=())
    base, _ = clean_outputs(plain, one)
    rows = []
    names = ("stiffnesses", "dampings") if isinstance(truth.plant, TrueChain) else ("b",)
    for name in names:
        values = np.atleast_1d(getattr(truth.plant, name))
        for i in range(len(values)):
            changed = np.array(values, dtype=float)
            changed[i] *= 1.001
            plant = replace(truth.plant, **{name: changed if name != "b" else float(changed[0])})
            rows.append((clean_outputs(replace(plain, plant=plant), one)[0] - base)[0] / 1e-3)
    quiet = replace(one, inputs=np.zeros_like(one.inputs))
    for i in range(one.starts.shape[1]):
        starts = np.zeros_like(one.starts)
        starts[0, i] = 1.0
        rows.append(clean_outputs(plain, replace(quiet, starts=starts))[0][0])
    rows = np.array(rows)
    return rows / (rows.std(axis=(1, 2), keepdims=True) + 1e-300)
