"""Score every effect at every place against what a model leaves: a score test on the model's own recursion.

The model, linearised about its trajectory, responds to each candidate's force; the residual is regressed on that
response after everything that the model could still adjust (linear parameters, effects already there, initial states)
is projected out. The fall of the residual's square is what a first Gauss-Newton step would win, so one screen ranks a
hundred candidates for the price of as many right-hand sides.

A law that is linear in its amplitudes gives one history an amplitude; what is not linear (a gap, a yield displacement,
a frequency, a delay) is tried at the values that the effect proposes from the motion at its place and from the peaks of
what the model leaves.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy

from modal.discrepancy.fitting.estimation import Estimate, Problem, weights_along
from modal.effects.effect import Effect, ForceEffect, InputEffect, Motion, SensorEffect, Situation, Values
from modal.simulation.assembly import Assembly, EffectPlacement, Unknowns, drive_inputs, initial_unknowns, place_effect
from modal.simulation.drive import Drive, IndexArray
from modal.simulation.forces import motion_at
from modal.simulation.scheme import Recursion
from modal.simulation.trajectory import Source, force_response, respond, sensitivity
from modal.structure.placed import possible_places
from okid.arrays import ROUNDED, TINY, BoolArray, FloatArray
from okid.display import Displayed

TRIES, MISS = 40, 1e-6
"""Give an effect's states up after so many iterations; end where the last change is this share of the largest state."""


def _memories_along(
    effect: ForceEffect, shapes: Sequence[Values], motion: Motion, drive: Drive
) -> list[FloatArray | None]:
    """The states (n_times, n_memory) of an effect that remembers, along a given motion; None where they do not settle.

    A rate-independent law goes straight through where the motion does not turn round: it depends on the turning points
    alone. These are solved for first, a small share of the samples, and all others follow from the last one before
    them. All its shapes are solved for together, as if each were a record of its own.
    """
    firsts = np.array(drive.firsts[:-1])
    if not effect.rate_independent:
        every = np.arange(drive.n_times)
        return [_solved(effect, [values], motion, nodes=every, firsts=firsts, dt=drive.dt)[0] for values in shapes]
    nodes = _nodes(motion, firsts)
    found = _solved(effect, shapes, motion, nodes=nodes, firsts=np.searchsorted(nodes, firsts), dt=drive.dt)
    # straight from the last node before each sample to all samples
    last = np.searchsorted(nodes, np.arange(drive.n_times), side="right") - 1
    straight = np.ones(len(last), dtype=np.bool_)
    begin, end = _taken(motion, nodes[last], straight), _taken(motion, np.arange(len(last)), straight)
    for i, at_nodes in enumerate(found):
        if at_nodes is not None:
            z = at_nodes[last]
            found[i] = effect.advance(shapes[i], replace(begin, memory=z), replace(end, memory=z), drive.dt).value
    return found


def _nodes(motion: Motion, firsts: IndexArray) -> IndexArray:
    """First and last samples of records, and those between which the motion may turn round."""
    way = np.sign(np.diff(motion.displacement))
    speed = np.sign(motion.velocity)
    same = (speed[:-1] * speed[1:] > 0.0) & (speed[:-1] == way)
    same[firsts[1:] - 1] = False
    inner = np.zeros(len(motion.displacement), dtype=np.bool_)
    inner[1:-1] = same[:-1] & same[1:] & (way[:-1] == way[1:])
    return np.flatnonzero(~inner)


def _solved(
    effect: ForceEffect, shapes: Sequence[Values], motion: Motion, *, nodes: IndexArray, firsts: IndexArray, dt: float
) -> list[FloatArray | None]:
    """The states at the nodes for each shape, by Newton's method on all shapes; None where they do not settle."""
    n, n_shapes = len(nodes), len(shapes)
    following = np.minimum(np.arange(n) + 1, n - 1)
    straight = nodes[following] > nodes + 1
    values = shapes[0] if n_shapes == 1 else [np.repeat(column, n) for column in np.array(shapes).T]
    begin = _taken(motion, np.tile(nodes, n_shapes), np.tile(straight, n_shapes))
    end = _taken(motion, np.tile(nodes[following], n_shapes), np.tile(straight, n_shapes))
    starts = (firsts + n * np.arange(n_shapes)[:, None]).ravel()
    edges = np.append(starts, n * n_shapes)
    ahead = (following + n * np.arange(n_shapes)[:, None]).ravel()
    z = np.zeros((n * n_shapes, effect.n_memory))
    found: list[FloatArray | None] = [None] * n_shapes
    for _ in range(TRIES):
        step = effect.advance(values, replace(begin, memory=z), replace(end, memory=z[ahead]), dt)
        forcing = np.zeros((1, *z.shape))
        forcing[0, 1:] = (step.value - z[ahead])[:-1]
        forcing[0, starts] = -z[starts]
        change = Recursion.of(step.by_memory.transpose(1, 2, 0), tuple(edges.tolist())).solve(forcing)[0]
        z = z + change
        if not np.isfinite(z).all():  # one shape that escapes would take the others along
            one_by_one = [shapes[i : i + 1] for i in range(n_shapes) if found[i] is None]
            if n_shapes == 1:
                return found
            alone = iter([_solved(effect, one, motion, nodes=nodes, firsts=firsts, dt=dt)[0] for one in one_by_one])
            return [next(alone) if one is None else one for one in found]
        each = z.reshape(n_shapes, n, -1)
        size = np.maximum(np.abs(each).max(axis=(1, 2)), TINY)
        settled = np.abs(change).reshape(n_shapes, -1).max(axis=1) <= MISS * size
        found = [each[i] if one is None and settled[i] else one for i, one in enumerate(found)]
        if all(one is not None for one in found):
            break
    return found


def _taken(motion: Motion, rows: IndexArray, straight: BoolArray) -> Motion:
    """The motion at some samples; without a velocity a step is a straight line."""
    return replace(
        motion,
        displacement=motion.displacement[rows],
        velocity=np.where(straight, 0.0, motion.velocity[rows]),
        time=motion.time[rows],
        memory=motion.memory[rows],
        smoothing=np.broadcast_to(motion.smoothing, motion.displacement.shape)[rows],
    )


N_PEAKS = 4
"""Propose frequencies from so many of the highest peaks of what the model leaves."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Trial:
    """An effect at a place, at one shape.

    Attributes:
        placement: The effect at its place.
        values: Its parameters; amplitudes stand at 1.
        sources: What each amplitude does by itself, for each column of the port.
    """

    placement: EffectPlacement
    values: tuple[float, ...]
    sources: tuple[Source, ...]


def _trials_of(
    current: Estimate, effect: Effect, where: str, smoothing: float, peaks: tuple[float, ...]
) -> list[_Trial]:
    """An effect at a place, at each shape worth a try: by the motion there, and the peaks of what the model leaves.

    None where the model has that effect there already, or none of its shapes shows.
    """
    assembly, trajectory = current.assembly, current.trajectory
    drive = trajectory.drive
    item = place_effect(assembly.plant, effect, where)
    if any(other.effect.key == effect.key and other.where == where for other in assembly.placements):
        return []
    if isinstance(effect, ForceEffect):
        states, memory = trajectory.states[:, : assembly.plant.n_states], np.zeros((drive.n_times, effect.n_memory))
        motion = motion_at(item, states, drive, memory, smoothing * drive.level)
    else:
        signal = drive.sample if isinstance(effect, InputEffect) else trajectory.linearisation.free
        time = drive.time if isinstance(effect, InputEffect) else drive.time[drive.rows]
        motion = _signal(signal[:, item.channel], time)
    motion = replace(
        motion,
        displacement_scale=max(float(np.std(motion.displacement)), TINY),
        velocity_scale=max(float(np.std(motion.velocity)), TINY),
    )
    effect = effect.over(motion)
    item = replace(
        item, effect=effect, displacement_scale=motion.displacement_scale, velocity_scale=motion.velocity_scale
    )
    situation = Situation(motion=motion, residual_frequencies=peaks, dt=drive.dt, longest=float(drive.time.max()))
    shapes = effect.starts(situation)
    motions: list[Motion | None] = [motion] * len(shapes)
    if isinstance(effect, ForceEffect) and effect.n_memory and shapes:
        memories = _memories_along(effect, shapes, motion, drive)
        motions = [None if memory is None else replace(motion, memory=memory) for memory in memories]
    found = []
    for values, moved in zip(shapes, motions, strict=True):
        sources = [] if moved is None else _sources(current, item, values, moved)
        if sources:
            found.append(_Trial(placement=item, values=values, sources=tuple(sources)))
    return found


def _signal(values: FloatArray, time: FloatArray) -> Motion:
    return Motion(
        displacement=values,
        velocity=np.zeros_like(values),
        time=time,
        memory=np.zeros((len(values), 0)),
        displacement_scale=1.0,
        velocity_scale=1.0,
    )


def _sources(current: Estimate, item: EffectPlacement, values: tuple[float, ...], motion: Motion) -> list[Source]:
    effect, drive, n = item.effect, current.trajectory.drive, current.assembly.plant.n_states
    n_all = current.trajectory.states.shape[1]
    if isinstance(effect, ForceEffect):
        histories = effect.screen_columns(values, motion)
        _, port = item.force_and_port
        return [
            force_response(drive, current.scheme, column, history, n_all)
            for column in port.columns
            for history in histories.T
        ]
    if isinstance(effect, SensorEffect):
        slopes = effect.screen_columns(values, motion.displacement, motion.time)
        found = []
        for slope in slopes.T:
            sensed = np.zeros_like(current.trajectory.outputs)
            sensed[:, item.channel] = slope
            found.append(Source(sensed=sensed))
        return found
    moved = values
    if values == effect.neutral:
        moved = tuple(value + 1.0 for value in values)
    lone = Assembly(plant=current.assembly.plant, placements=(item,))
    changed = drive_inputs(lone, _plain(lone, moved, drive.n_records), drive)
    flow = np.zeros((drive.n_times, n_all))
    flow[:, :n] = (changed.start - drive.start) @ current.scheme.B0.T + (changed.end - drive.end) @ current.scheme.B1.T
    direct = (changed.sample - drive.sample)[drive.rows] @ current.scheme.D.T
    if not flow.any() and not direct.any():
        return []
    return [Source(flow=flow, outputs=direct)]


def _plain(lone: Assembly, values: tuple[float, ...], n_records: int) -> Unknowns:
    unknowns = initial_unknowns(lone, n_records)
    unknowns.common[lone.n_linear :] = [values[j] for j in lone.placements[0].common]
    return unknowns


def _peaks(current: Estimate, problem: Problem) -> tuple[float, ...]:
    """Frequencies of the highest peaks of what the model leaves, outputs in units of their residual."""
    drive = problem.drive
    residual = np.where(drive.present, drive.outputs - current.trajectory.outputs, 0.0)
    length = min(drive.row_firsts[r + 1] - drive.row_firsts[r] for r in range(drive.n_records))
    power = np.zeros(length // 2 + 1)
    window = np.hanning(length)
    for record in range(drive.n_records):
        part = residual[drive.rows_of(record)][:length]
        scale = np.maximum(part.std(axis=0), TINY)
        power += np.sum(np.abs(np.fft.rfft((part - part.mean(axis=0)) / scale * window[:, None], axis=0)) ** 2, axis=1)
    dt = drive.dt * (int(drive.rows[1]) if len(drive.rows) > 1 else 1)
    frequencies = np.fft.rfftfreq(length, dt)
    inner = np.flatnonzero((power[1:-1] >= power[:-2]) & (power[1:-1] >= power[2:])) + 1
    order = inner[np.argsort(-power[inner])]
    chosen: list[int] = []
    for index in order:
        if index > 1 and all(abs(index - other) > 3 for other in chosen):
            chosen.append(int(index))
        if len(chosen) == N_PEAKS:
            break
    return tuple(float(frequencies[index]) for index in chosen)


CHUNK = 48
"""Respond to so many trials at once: more only cost memory."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Candidate(Displayed):
    """An effect at a place, with values to start from.

    Attributes:
        placement: The effect at its place.
        common: Start of its common unknowns (parameters, then directions).
        local: (n_records, n) start of the unknowns that each record has for itself.
        fall: Share of the residual's weighted square that it would take away, records and outputs alike.
        deviation: Standard deviation of the first amplitude (for the detection limit); nan where it has none.
    """

    placement: EffectPlacement
    common: FloatArray
    local: FloatArray
    fall: float
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
    signs: Literal["bounded", "free"] = "bounded",
) -> tuple[Candidate, ...]:
    """Score every effect of the catalogue at every place, each at a few shapes.

    Args:
        current: The model so far, in free run or in observer form.
        problem: The records to fit.
        catalogue: The effects.
        smoothing: Width of sharp laws in the screen, as a share of the motion's scale.
        signs: "bounded": candidates whose amplitudes would cross their sign bounds are left out; "free": none is.
    """
    peaks = _peaks(current, problem)
    trials = [
        trial
        for effect in catalogue.values()
        for where in possible_places(current.assembly.plant, effect)
        for trial in _trials_of(current, effect, where, smoothing, peaks)
    ]
    nuisance = _Nuisance.of(current, problem)
    found: list[Candidate] = []
    for first in range(0, len(trials), CHUNK):
        part = trials[first : first + CHUNK]
        sources = [source for trial in part for source in trial.sources]
        _, outputs = respond(
            current.assembly, current.unknowns, current.trajectory, sources, len(sources), gain=current.gain
        )
        columns = (outputs * nuisance.weights).reshape(len(sources), -1)
        projections = nuisance.projected(columns)
        used = 0
        for trial in part:
            own = slice(used, used + len(trial.sources))
            scored = _score(trial, columns[own], projections[:, own], nuisance, problem.drive, signs=signs)
            used = own.stop
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

    def projected(self, columns: FloatArray) -> FloatArray:
        """(n_nuisance, n_columns) what columns have in common with these, by orthonormal ones."""
        whole, lower = self.factor
        seen = self.columns @ columns.T
        return np.asarray(scipy.linalg.solve_triangular(whole, seen, trans=0 if lower else 1, lower=lower))

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


def _score(
    trial: _Trial, columns: FloatArray, projection: FloatArray, nuisance: _Nuisance, drive: Drive, *, signs: str
) -> Candidate | None:
    local = bool(trial.placement.local)
    if local:
        spread = np.repeat(np.arange(drive.n_records), np.diff(drive.row_firsts) * drive.outputs.shape[1])
        columns = np.concatenate([columns * (spread == record) for record in range(drive.n_records)])
        projection = nuisance.projected(columns)
    gram = columns @ columns.T - projection.T @ projection
    score = columns @ nuisance.residual
    size = np.sqrt(np.maximum(np.diag(gram), TINY))
    if (
        not np.isfinite(gram).all()
        or not np.isfinite(score).all()
        or np.any(np.diag(gram) <= 1e-12 * np.sum(columns**2, axis=1))
    ):
        return None
    scaled = gram / np.outer(size, size)
    scaled[np.diag_indices_from(scaled)] += ROUNDED
    weights = np.linalg.solve(scaled, score / size) / size
    signed = weights if signs == "free" else _signed(trial, weights, gram, score, local=local)
    if signed is None:
        return None
    fall = float(2.0 * signed @ score - signed @ gram @ signed)
    return replace(
        _candidate(trial, signed, drive, local=local),
        fall=fall / max(nuisance.total, TINY),
        deviation=float(np.sqrt(np.linalg.inv(scaled)[0, 0]) / size[0]),
    )


def _signed(
    trial: _Trial, weights: FloatArray, gram: FloatArray, score: FloatArray, *, local: bool
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


def _candidate(trial: _Trial, weights: FloatArray, drive: Drive, *, local: bool) -> Candidate:
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
    elif local:
        own[:] = effect.neutral[item.local[0]] + weights.reshape(own.shape)
        started = values
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
        deviation=np.nan,
    )
