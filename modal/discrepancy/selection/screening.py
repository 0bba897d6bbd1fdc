"""Score every effect at every place against what a model leaves: a score test on the model's own recursion.

The model, linearised about its trajectory, responds to each candidate's force; the residual is regressed on that
response after everything that the model could still adjust (linear parameters, effects already there, initial states)
is projected out. The fall of the residual's square is what a first Gauss-Newton step would win, so one screen ranks a
hundred candidates for the price of as many right-hand sides.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy

from modal.discrepancy.fitting.estimation import Estimate, Problem, weights_along
from modal.discrepancy.selection.screen_trials import TriedShape, trials_of
from modal.effects.effect import Effect, ForceEffect
from modal.simulation.assembly import EffectPlacement
from modal.simulation.drive import Drive
from modal.simulation.sensitivity import respond, sensitivity
from modal.simulation.tolerances import ROUNDING
from modal.structure.placed import possible_places
from okid.arrays import TINY, FloatArray

__all__ = ["Candidate", "screen_candidates"]

CHUNK = 48


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Candidate:
    """An effect at a place, with values to start from.

    Attributes:
        placement: The effect at its place.
        common: Start of its common unknowns (parameters, then directions).
        local: (n_records, n) start of the unknowns that each record has for itself.
        fall: Share of the residual's weighted square that it would take away, records and outputs alike; of a
            "turned" one the share at the amplitude that its sign forbids.
        significance: Fall of the weighted square over what chance gives a column, a chi-square per column.
        deviation: Standard deviation of the first amplitude (for the detection limit); nan where it has none.
    """

    placement: EffectPlacement
    common: FloatArray
    local: FloatArray
    fall: float
    significance: float
    deviation: float

    @property
    def key(self) -> str:
        """The effect's key."""
        return self.placement.effect.key

    @property
    def where(self) -> str:
        """The place's name."""
        return self.placement.where


def screen_candidates(
    current: Estimate,
    problem: Problem,
    catalogue: Mapping[str, Effect],
    *,
    smoothing: float = 0.05,
    signs: Literal["bounded", "free", "turned"] = "bounded",
) -> tuple[Candidate, ...]:
    """Score every effect of the catalogue at every place, each at a few shapes.

    Args:
        current: The model so far, in free run or in observer form.
        problem: The records to fit.
        catalogue: The effects.
        smoothing: Width of sharp laws in the screen, as a share of the motion's scale.
        signs: "bounded": candidates whose amplitudes would cross their sign bounds are left out; "free": none is;
            "turned": none is, and those start from the opposite amplitudes.

    Returns:
        Candidates, best first.
    """
    trials = [
        trial
        for effect in catalogue.values()
        for where in possible_places(current.assembly.plant, effect)
        for trial in trials_of(current, problem, effect, where, smoothing)
    ]
    nuisance = _Nuisance.of(current, problem)
    found: list[Candidate] = []
    for first in range(0, len(trials), CHUNK):
        part = trials[first : first + CHUNK]
        sources = [source for trial in part for source in trial.sources]
        _, outputs = respond(current.assembly, current.unknowns, current.trajectory, sources, gain=current.gain)
        columns = (outputs * nuisance.weights).reshape(len(sources), -1)
        used = 0
        for trial in part:
            n_columns = len(trial.sources)
            scored = _score(trial, columns[used : used + n_columns], nuisance, problem.drive, signs)
            used += n_columns
            if scored is not None:
                found.append(scored)
    return tuple(sorted(found, key=lambda candidate: -candidate.fall))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Nuisance:
    """What the model could still adjust: weighted columns, the factor of their Gram matrix, the residual left."""

    columns: FloatArray
    factor: tuple[FloatArray, bool]
    residual: FloatArray
    weights: FloatArray
    total: float

    @staticmethod
    def of(current: Estimate, problem: Problem) -> "_Nuisance":
        drive = problem.drive
        slopes = sensitivity(
            current.assembly,
            current.unknowns,
            drive,
            current.trajectory,
            current.scheme,
            slopes=current.slopes,
            gain=current.gain,
        )
        level = np.sqrt(np.maximum(np.nan_to_num(current.mean_square, nan=1.0), 1.0))
        weights = weights_along(problem, current.trajectory) / np.repeat(level, np.diff(drive.row_firsts), axis=0)
        blocks = [slopes.common * weights]
        for record in range(drive.n_records):
            own = np.zeros_like(slopes.local)
            own[:, drive.rows_of(record)] = slopes.local[:, drive.rows_of(record)]
            blocks.append(own * weights)
        columns = np.concatenate(blocks).reshape(-1, weights.size)
        residual = ((drive.outputs - current.trajectory.outputs) * weights).ravel()
        gram = columns @ columns.T
        centre, deviation = current.assembly.prior()
        diagonal = np.arange(len(centre))
        gram[diagonal, diagonal] += deviation**-2
        score = columns @ residual
        score[diagonal] += (centre - current.unknowns.common) * deviation**-2
        scale = np.maximum(np.diag(gram), 1e-12 * max(TINY, float(np.max(np.diag(gram), initial=0.0))))
        factor = scipy.linalg.cho_factor(gram + 1e-10 * np.diag(scale))
        left = residual - columns.T @ scipy.linalg.cho_solve(factor, score)
        return _Nuisance(
            columns=columns, factor=factor, residual=left, weights=weights, total=float(residual @ residual)
        )


def _score(trial: TriedShape, columns: FloatArray, nuisance: _Nuisance, drive: Drive, signs: str) -> Candidate | None:
    local = bool(trial.placement.local)
    if local:
        spread = np.repeat(np.arange(drive.n_records), np.diff(drive.row_firsts) * drive.outputs.shape[1])
        columns = np.concatenate([columns * (spread == record) for record in range(drive.n_records)])
    seen = nuisance.columns @ columns.T
    gram = columns @ columns.T - seen.T @ scipy.linalg.cho_solve(nuisance.factor, seen)
    score = columns @ nuisance.residual
    size = np.sqrt(np.maximum(np.diag(gram), TINY))
    if (
        not np.isfinite(gram).all()
        or not np.isfinite(score).all()
        or np.any(np.diag(gram) <= 1e-12 * np.sum(columns**2, axis=1))
    ):
        return None
    scaled = gram / np.outer(size, size)
    scaled[np.diag_indices_from(scaled)] += ROUNDING
    weights = np.linalg.solve(scaled, score / size) / size
    signed = weights if signs == "free" else _signed(trial, weights, gram, score, local=local)
    if signed is None and signs == "bounded":
        return None
    best = weights if signed is None else signed
    weights = -weights if signed is None else signed
    fall = float(2.0 * best @ score - best @ gram @ best)
    return replace(
        _candidate(trial, weights, drive, local=local),
        fall=fall / max(nuisance.total, TINY),
        significance=fall / len(weights),
        deviation=float(np.sqrt(np.linalg.inv(scaled)[0, 0]) / size[0]),
    )


def _signed(
    trial: TriedShape, weights: FloatArray, gram: FloatArray, score: FloatArray, *, local: bool
) -> FloatArray | None:
    """The weights within the sign bounds of the amplitudes: those that would cross are zero; None if none is left."""
    kinds = [kind for kind in trial.placement.effect.parameters if kind.role == "amplitude"]
    if not kinds:  # the column is the effect itself, so less than none of it is the opposite: hardening, more drive
        return weights if weights[0] > 0.0 else None
    if local or not isinstance(trial.placement.effect, ForceEffect):
        return weights
    if len(kinds) * (1 + trial.placement.n_directions) != len(weights):
        return weights
    kept = np.ones(len(weights), dtype=bool)
    for j, kind in enumerate(kinds):
        kept[j] = not (weights[j] < kind.lower or weights[j] > kind.upper)
    if kept.all():
        return weights
    if trial.placement.n_directions or not kept.any():
        return None
    found = np.zeros_like(weights)
    found[kept] = np.linalg.solve(gram[np.ix_(kept, kept)], score[kept])
    return found


def _candidate(trial: TriedShape, weights: FloatArray, drive: Drive, *, local: bool) -> Candidate:
    item, values = trial.placement, trial.values
    effect = item.effect
    own = np.zeros((drive.n_records, len(item.local)))
    directions = np.zeros(item.n_directions)
    if isinstance(effect, ForceEffect) and local:
        each = weights.reshape(drive.n_records, -1)
        n_columns = each.shape[1] // (1 + item.n_directions)
        starts = np.array([effect.from_screen(values, each[record, :n_columns]) for record in range(drive.n_records)])
        own[:] = starts[:, list(item.local)]
        started = tuple(np.mean(starts, axis=0))
    elif isinstance(effect, ForceEffect):
        n_columns = len(weights) // (1 + item.n_directions)
        started = effect.from_screen(values, weights[:n_columns])
        if item.n_directions and weights[0] != 0.0:
            directions = weights[n_columns::n_columns] / weights[0]
    else:
        amplitudes = [j for j, kind in enumerate(effect.parameters) if kind.role == "amplitude"]
        changed = list(values)
        for j, weight in zip(amplitudes, weights, strict=False):
            kind = effect.parameters[j]
            changed[j] = float(np.clip(effect.neutral[j] + weight, kind.lower, kind.upper))
        started = tuple(changed)
    return Candidate(
        placement=item,
        common=np.concatenate([[started[j] for j in item.common], directions]),
        local=own,
        fall=0.0,
        significance=0.0,
        deviation=np.nan,
    )
