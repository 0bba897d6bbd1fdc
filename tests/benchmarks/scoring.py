"""Scores of a state-space model against a known system or a record, the same for every contender.

Nothing here imports okid, era or modal: a contender's A, B, C, D are matrices (B and D may be missing), its modes are
those of A. Definitions: a mode is found when a claimed mode lies within 0.5 % of its frequency or half its half-power
bandwidth, one to one; a claimed mode is false when no true mode lies within 5 %; the continued fit is 1 - |error| /
|y - mean| of one free run, its initial state by least squares on earlier rows.
"""

from dataclasses import dataclass

import numpy as np
import scipy

LARGEST_DAMPING = 0.2
"""A peer has no verdict: each of its stable poles with less damping than this counts as claimed."""
WITHIN, NEAR = 0.005, 0.05
STATE_RIDGE = 1e-6
"""Of the initial state, relative to the energy that it has over the whole record."""
HUGE = 1e100


@dataclass(frozen=True, slots=True, kw_only=True)
class Claimed:
    """A mode that a contender claims; `certain` when it counts as false if it is."""

    frequency: float
    damping_ratio: float
    frequency_std: float = np.nan
    damping_ratio_std: float = np.nan
    certain: bool = True
    damping_resolved: bool = True


def matrix(stored):
    """A matrix from JSON: nested lists, or the real and imaginary parts of a complex one."""
    if isinstance(stored, dict):
        return np.array(stored["re"]) + 1j * np.array(stored["im"])
    return np.array(stored, dtype=float)


def modes_of_matrix(A, dt):
    """Every stable oscillatory pole of moderate damping, one of each pair."""
    poles = np.linalg.eigvals(A)
    poles = poles[(poles.imag > 1e-9) & (np.abs(poles) < 1.0) & (np.abs(poles) > 1e-3)]
    s = np.log(poles) / dt
    modes = [Claimed(frequency=abs(p) / (2 * np.pi), damping_ratio=-p.real / abs(p)) for p in s]
    return [mode for mode in modes if mode.damping_ratio < LARGEST_DAMPING]


def spectral_radius(A):
    return float(np.abs(np.linalg.eigvals(A)).max(initial=0.0))


def claimed_modes(model):
    """The modes that a contender gave itself, with its verdicts, or else those of its A."""
    if "modes" not in model:
        return modes_of_matrix(matrix(model["A"]), model["dt"])
    return [
        Claimed(
            frequency=mode["frequency"],
            damping_ratio=mode["damping_ratio"],
            frequency_std=mode["frequency_std"],
            damping_ratio_std=mode["damping_ratio_std"],
            certain=mode["verdict"] == "system",
            damping_resolved=mode["damping_resolved"],
        )
        for mode in model["modes"]
        if mode["verdict"] != "noise" and mode["kind"] == "oscillatory"
    ]


def tolerance(frequency, damping_ratio):
    return max(WITHIN, damping_ratio) * frequency


def match(claimed, frequencies, damping_ratios):
    """For each true mode the claimed one that is it, or None: one to one, as many as possible, nearest poles first."""
    found = [None] * len(frequencies)
    if not claimed:
        return found
    cost = np.full((len(frequencies), len(claimed)), 1e3)
    for i, (frequency, ratio) in enumerate(zip(frequencies, damping_ratios, strict=True)):
        for j, mode in enumerate(claimed):
            off = abs(mode.frequency - frequency)
            if off <= tolerance(frequency, ratio):
                # distance of the poles in the plane
                cost[i, j] = np.hypot(off / frequency, mode.damping_ratio - ratio)
    for i, j in zip(*scipy.optimize.linear_sum_assignment(cost), strict=True):
        if cost[i, j] < 1e3:
            found[i] = claimed[j]
    return found


def false_modes(claimed, frequencies):
    """Certain ones with no true mode within 5 % in frequency."""
    return [m for m in claimed if m.certain and np.abs(m.frequency / frequencies - 1).min() > NEAR]


# --- free run --------------------------------------------------------------------------------------------------------


def forced(A, B, C, D, inputs):
    """(n_samples, n_outputs) from rest; whatever grows beyond all numbers comes back as it is."""
    state = np.zeros(len(A), dtype=np.result_type(A, B, float))
    driven, outputs = inputs @ B.T, np.empty((len(inputs), len(C)), dtype=state.dtype)
    with np.errstate(all="ignore"):
        for k in range(len(inputs)):
            outputs[k] = C @ state
            state = A @ state + driven[k]
        return outputs + inputs @ D.T


def free_decays(A, C, n_samples):
    """(n_samples, n_outputs, n_states) C A^k, zero from where all of it has died out."""
    decays = np.zeros((n_samples, *C.shape), dtype=np.result_type(A, C))
    part = C
    with np.errstate(all="ignore"):
        limit = 1e-12 * np.abs(C).max()
        for k in range(n_samples):
            decays[k] = part
            part = part @ A
            if np.abs(part).max() < limit:
                break
    return decays


def continued_run(model, inputs, outputs, *, state_rows):
    """Outputs of one free run through the whole record; initial state from the rows given alone."""
    A, B, C, D = (matrix(model[name]) for name in "ABCD")
    run = forced(A, B, C, D, inputs)
    columns = free_decays(A, C, len(outputs))
    # beyond this the squares below are no numbers either
    if not (np.abs(run).max() < HUGE and np.abs(columns).max() < HUGE):
        return np.full(outputs.shape, np.nan)
    there = np.isfinite(outputs[state_rows])
    used = columns[state_rows][there]
    every = columns.reshape(-1, columns.shape[2])
    normal = used.conj().T @ used + STATE_RIDGE * (every.conj().T @ every)
    wanted = used.conj().T @ (outputs[state_rows] - run[state_rows])[there]
    state = np.linalg.pinv(normal, rcond=1e-14, hermitian=True) @ wanted
    return (run + columns @ state).real


def fit(outputs, run):
    """Mean over outputs of 1 - |y - y_run| / |y - mean(y)|; -inf where the run is no number."""
    if not np.isfinite(run).all():
        return -np.inf
    error = np.sqrt(np.nansum((outputs - run) ** 2, axis=0))
    size = np.sqrt(np.nansum((outputs - np.nanmean(outputs, axis=0)) ** 2, axis=0))
    return float(np.mean(1 - error / size))


def continued_fit(model, inputs, outputs, *, state_rows, scored_rows):
    """Of a model with B and D; nan for one without."""
    if model.get("B") is None or model.get("D") is None:
        return np.nan
    run = continued_run(model, inputs, outputs, state_rows=state_rows)
    return fit(outputs[scored_rows], run[scored_rows])
