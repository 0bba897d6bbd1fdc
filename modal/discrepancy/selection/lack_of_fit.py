"""Whether a model leaves something that is no noise, what kind of thing, where, and how large.

A score test against laws of no particular form. The model, linearised about its own free run, responds to unit forces
at every port along splines of the displacement, of the velocity and products of both, to forces that change with time,
and to smooth changes of every input and output. The residual of fit and held-out records is regressed on each group of
responses, after everything that the model could still adjust (all common unknowns, every initial state) is projected
out; the noise may be coloured: residual and responses pass the same autoregressive filter, fitted to each record and
output. Under the model the fall F of the sum of squares by a group of r columns has the F distribution with r and n - k
degrees of freedom. With J what the model could adjust and G the group,

    S = G' (I - J J+) G       v = G' (I - J J+) e       fall = v' S+ v       F = (fall / r) / ((e'e - fall) / (n - k))

Corners and jumps are seen badly by splines; so the correlation that is left in the held-out residual, corrected for the
parameters' own uncertainty, is tested as a whole. A wire that picks up the drive late leaves it where no motion and no
smooth change of an input is: the residual is tested against each input at the likeliest of all delays, too. A slow
force that nobody measured depends on nothing, but two outputs share it. The nearest neighbours of a smooth law f(x) are
f(x) |x|^e: the one direction f ln|x| sees a sinh in place of a cube where seven splines do not.

With many samples something is always left, so the size counts as well: the force of a group is compared with that of an
effect by what both do to the outputs, the rest of the model free to make up for them.

References:
    Rao, Large sample tests of statistical hypotheses, Math. Proc. Cambridge Phil. Soc. 44, 1948,
    https://doi.org/10.1017/S0305004100023987 (score test); Ljung, Box, On a measure of lack of fit in time series
    models, Biometrika 65, 1978, https://doi.org/10.1093/biomet/65.2.297; Schwarz 1978 (order of the filter);
    Brillinger, Time Series: Data Analysis and Theory, 1981.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations

import numpy as np
import scipy

from modal.discrepancy.fitting.estimation import Estimate, Problem
from modal.discrepancy.fitting.nodes import Node, Task
from modal.discrepancy.fitting.observed_fits import CLEAR
from modal.discrepancy.noise.spectral import (
    MOST_ORDER,
    colours_of,
    filter_by,
    log_chi_square_tail,
    log_f_tail,
    whitening_filter,
)
from modal.discrepancy.results import Follows, LackOfFit, ResidualKind, beyond_noise, something, worst_left
from modal.discrepancy.selection.smaller_models import run_without
from modal.effects.catalogue import effects_at
from modal.effects.effect import ForceEffect, is_sharp
from modal.simulation import SLIGHT
from modal.simulation.assembly import EffectPlacement
from modal.simulation.drive import Drive
from modal.simulation.plant import Port
from modal.simulation.trajectory import Source, force_response, respond, sensitivity
from modal.wording.text import NINETY_FIVE, number, percent
from okid.arrays import ROUNDED, TINY, BoolArray, FloatArray
from okid.residuals import WHITENESS_LAGS

N_SPLINES = 7
"""Give the form-free law of a motion so many cubic splines, four intervals: what is left is smooth, or the test of the
correlation sees it."""
INDISTINCT = 0.01
"""Leave out a direction of a group that the model can make up for but for this share of its response."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Whitened:
    """One record of an estimate, every output filtered to white noise of deviation 1, its own unknowns projected out.

    Attributes:
        rows: Its rows.
        filters: Of each output, 1 and the autoregression with its sign turned, over the noise's deviation.
        valid: Of each output, which rows have all that the filter reads.
        own: (n, n_local) orthonormal, what the record's own unknowns do.
        local: (n_local, n) what each of them does.
        shared: (n_common, n) what the common unknowns do.
        residual: (n,).
        held_out: Whether the record is held out.
    """

    rows: slice
    filters: tuple[FloatArray, ...]
    valid: tuple[BoolArray, ...]
    own: FloatArray
    local: FloatArray
    shared: FloatArray
    residual: FloatArray
    held_out: bool

    def filtered(self, columns: FloatArray) -> FloatArray:
        """Columns (n_columns, n_rows, n_outputs) of all records: those of this one, filtered, its own projected out."""
        flat = _flat(columns[:, self.rows], self.filters, self.valid)
        return np.asarray(flat - (flat @ self.own) @ self.own.T)

    def series(self, step: FloatArray) -> FloatArray:
        """(n_outputs, n_rows) the residual after a step of the common unknowns, zero where the filter lacks a value."""
        found = np.zeros((len(self.valid), len(self.valid[0])))
        found[np.array(self.valid)] = self.residual - step @ self.shared
        return found


def _flat(columns: FloatArray, filters: Sequence[FloatArray], valid: Sequence[BoolArray]) -> FloatArray:
    parts = [
        filter_by(taps, columns[:, :, output])[:, kept]
        for output, (taps, kept) in enumerate(zip(filters, valid, strict=True))
    ]
    return np.concatenate(parts, axis=1)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Part:
    """The records to fit or the held-out ones.

    Attributes:
        run: The model along them.
        problem: The same records, as they were measured.
        records: Those of which something is measured.
    """

    run: Estimate
    problem: Problem
    records: tuple[_Whitened, ...]

    def responses(self, sources: Sequence[Source]) -> FloatArray:
        """(n_sources, n_rows, n_outputs) of the linearised model."""
        run = self.run
        return respond(run.assembly, run.unknowns, run.trajectory, sources, len(sources), gain=run.gain)[1]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Left:
    """What is left of a model's residual, as normal equations of the common unknowns.

    Attributes:
        parts: Records to fit, and held-out ones.
        inverse: (n_common, n_common) inverse of their Gram matrix.
        step: (n_common,) step of the common unknowns that the residual asks for.
        squares: Sum of squares after that step.
        freedom: Values less unknowns.
    """

    parts: tuple[_Part, ...]
    inverse: FloatArray
    step: FloatArray
    squares: float
    freedom: int

    def tested(self, columns: Sequence[FloatArray]) -> tuple[float, float, int]:
        """What a group of responses, one array a part, takes away.

        Returns:
            log p, the fall, and the degrees of freedom of the group.
        """
        gram, plain, score = self.reduced(columns)
        size = np.sqrt(np.maximum(np.diag(plain), TINY))
        metric = plain / np.outer(size, size) + ROUNDED * np.eye(len(size))
        if not (np.isfinite(gram).all() and np.isfinite(score).all()):
            return 0.0, 0.0, 0
        share, directions = scipy.linalg.eigh(gram / np.outer(size, size), metric)
        kept = share >= INDISTINCT
        along = directions[:, kept].T @ (score / size)
        fall, rank = float(np.sum(along**2 / share[kept])), int(kept.sum())
        freedom = self.freedom - rank
        if not rank or freedom <= 0:
            return 0.0, 0.0, 0
        ratio = (fall / rank) / max((self.squares - fall) / freedom, TINY)
        return log_f_tail(ratio, rank, freedom), fall, rank

    def weight(self, columns: Sequence[FloatArray], held: Sequence[int]) -> float:
        """Square of one response, the common unknowns but those `held` free to make up for it; 0 where they do."""
        left, whole, _ = self.reduced(columns, held=held)
        return float(left[0, 0]) if left[0, 0] > ROUNDED * whole[0, 0] else 0.0

    def reduced(
        self, columns: Sequence[FloatArray], *, held: Sequence[int] = ()
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Gram matrix less what the common unknowns can do, as it is, and the score of a group."""
        n = len(columns[0])
        plain, crossed, seen = np.zeros((n, n)), np.zeros((n, len(self.inverse))), np.zeros(n)
        for part, all_columns in zip(self.parts, columns, strict=True):
            for one in part.records:
                own = one.filtered(all_columns)
                plain += own @ own.T
                crossed += own @ one.shared.T
                seen += own @ one.residual
        inverse = self.inverse
        if held:
            free = np.setdiff1d(np.arange(len(inverse)), held)
            inverse = np.zeros_like(inverse)
            whole = sum(one.shared[free] @ one.shared[free].T for part in self.parts for one in part.records)
            inverse[np.ix_(free, free)] = _inverse(np.asarray(whole).reshape(len(free), len(free)))[0]
        return plain - crossed @ inverse @ crossed.T, plain, seen - crossed @ self.step


def _inverse(gram: FloatArray) -> tuple[FloatArray, int]:
    """Inverse and rank of a Gram matrix, by columns of size 1."""
    size = np.sqrt(np.maximum(np.diag(gram), TINY))
    inverse, rank = scipy.linalg.pinvh(gram / np.outer(size, size), rtol=ROUNDED, return_rank=True)
    return np.asarray(inverse / np.outer(size, size)), int(rank)


def lack_of_fit(node: Node, task: Task, *, known: int = 0) -> tuple[LackOfFit, ...]:
    """Test what a model leaves against laws of no particular form.

    Args:
        node: The model, fitted and judged.
        task: Records to fit and held-out ones.
        known: Number of effects that the model had from the start: the share is that of the least of the others.

    Returns:
        One test for each kind of thing at each place, the least probable first. `p_value` counts all tests together.
    """
    left = _left_of(node, task)
    if left is None:
        return ()
    effects = range(known, len(node.effects))
    found: list[tuple[ResidualKind, str, float, float, Follows]] = []
    groups = (
        (kind, where, [part.responses(own) for part, own in zip(left.parts, sources, strict=True)])
        for kind, where, sources in _groups(left.parts)
    )
    powers = ((*power, node.effects[i][1]) for i in effects if (power := _other_power(left, i)) is not None)
    for kind, where, responses in chain(groups, ((kind, where, seen) for kind, seen, where in powers)):
        log_p, fall, rank = left.tested(responses)
        if rank:
            found.append((kind, where, log_p, fall, ""))
    found += _correlations(left) + _in_common(left)
    named = min((weight for i in effects if (weight := _effect_weight(left, i)) is not None), default=None)
    outputs = [
        (part, np.where((drive := part.run.trajectory.drive).present, drive.outputs, 0.0)) for part in left.parts
    ]
    signal = sum(float(np.sum(one.filtered(every[None]) ** 2)) for part, every in outputs for one in part.records)
    return tuple(
        LackOfFit(
            kind=kind,
            where=where,
            p_value=float(min(np.exp(min(log_p + np.log(len(found)), 0.0)), 1.0)),
            share=np.nan if named is None else float(np.sqrt(fall / named)) if named > 0.0 else np.inf,
            size=float(np.sqrt(fall / max(signal, TINY))),
            follows=follows,
        )
        for kind, where, log_p, fall, follows in sorted(found, key=lambda one: (one[2], -one[3]))
    )


def _left_of(node: Node, task: Task) -> _Left | None:
    runs = [(node.fitted, task.fit, task.fine_fit)]
    if node.held_out is not None:
        runs.append((node.held_out, task.held_out, task.fine_held_out))
    parts = []
    for run, coarse, fine in runs:
        problem = coarse if len(coarse.drive.time) == len(run.trajectory.drive.time) else fine
        held_out = run is not node.fitted
        parts.append(_Part(run=run, problem=problem, records=tuple(_records(run, problem, held_out=held_out))))
    every = [one for part in parts for one in part.records]
    if not every:
        return None
    gram = sum(one.shared @ one.shared.T for one in every)
    score = sum(one.shared @ one.residual for one in every)
    inverse, rank = _inverse(np.asarray(gram))
    step = inverse @ score
    squares = sum(float(np.sum((one.residual - step @ one.shared) ** 2)) for one in every)
    freedom = sum(len(one.residual) - one.own.shape[1] for one in every) - rank
    if freedom <= 0 or not np.isfinite(squares):
        return None
    return _Left(parts=tuple(parts), inverse=inverse, step=step, squares=squares, freedom=freedom)


def _records(run: Estimate, problem: Problem, *, held_out: bool) -> Iterator[_Whitened]:
    drive = run.trajectory.drive
    slopes = sensitivity(
        run.assembly, run.unknowns, problem.drive, run.trajectory, run.scheme, slopes=run.slopes, gain=run.gain
    )
    residual = np.where(drive.present, drive.outputs - run.trajectory.outputs, 0.0)
    if not all(np.isfinite(one).all() for one in (residual, slopes.local, slopes.common)):
        return  # along a motion that hardly stays within numbers nothing is known
    for record in range(drive.n_records):
        rows = drive.rows_of(record)
        present = drive.present[rows]
        fitted = [whitening_filter(residual[rows, j], present[:, j]) for j in range(residual.shape[1])]
        filters, valid = tuple(one[0] for one in fitted), tuple(one[1] for one in fitted)
        own = _flat(slopes.local[:, rows], filters, valid)
        basis = _basis(own)
        shared, error = _flat(slopes.common[:, rows], filters, valid), _flat(residual[None, rows], filters, valid)[0]
        if len(error) <= basis.shape[1] + MOST_ORDER:
            continue
        yield _Whitened(
            rows=rows,
            filters=filters,
            valid=valid,
            own=basis,
            local=own,
            shared=shared - (shared @ basis) @ basis.T,
            residual=error - basis @ (basis.T @ error),
            held_out=held_out,
        )


def _basis(rows: FloatArray) -> FloatArray:
    """(n, rank) orthonormal, of the space of rows (n_rows, n)."""
    size = np.sqrt(np.sum(rows**2, axis=1))
    basis, sizes, _ = np.linalg.svd((rows / np.maximum(size, TINY)[:, None]).T, full_matrices=False)
    return np.asarray(basis[:, sizes > ROUNDED * max(float(sizes.max(initial=0.0)), TINY)])


Sources = list[list[Source]]
"""Those of a group, one list a part."""


def _groups(parts: Sequence[_Part]) -> Iterator[tuple[ResidualKind, str, Sources]]:
    plant = parts[0].run.assembly.plant
    for port in plant.ports:
        yield from _port_groups(parts, port)
    for channel, name in enumerate(plant.input_names):
        yield "input", name, [_input_sources(part.run, channel) for part in parts]
    for channel, name in enumerate(plant.output_names):
        yield "output", name, [_output_sources(part.run, channel) for part in parts]


def _port_groups(parts: Sequence[_Part], port: Port) -> Iterator[tuple[ResidualKind, str, Sources]]:
    """Forces of the displacement, of the velocity, of both, and of the time."""
    motions = [_motion(part.run, port) for part in parts]
    d_all, v_all = (np.concatenate([motion[k] for motion in motions]) for k in (0, 1))
    d_size, v_size = (max(float(np.std(one)), TINY) for one in (d_all, v_all))
    by_d = [_splines(d, d_all) for d, _, _ in motions]
    by_v = [_splines(v, v_all) for _, v, _ in motions]
    by_both, by_time = [], []
    for d, v, t in ((d / d_size, v / v_size, t) for d, v, t in motions):
        by_both.append(
            np.array([d * v, d * d * v, d * v * v, np.abs(d) * v, np.abs(v) * d, d**3 * v, np.abs(d) * np.sign(v)])
        )
        by_time.append(np.array([t, t * d, t * v, t * t * d]))
    has_d, has_v = port.displacement is not None, port.velocity is not None
    groups: list[tuple[ResidualKind, list[FloatArray], bool]] = [
        ("displacement", by_d, has_d),
        ("velocity", by_v, has_v),
        ("velocity", by_both, has_d and has_v),
        ("time", by_time, has_d or has_v),
    ]
    for kind, histories, possible in groups:
        if possible:
            yield (
                kind,
                port.name,
                [_force_sources(part.run, port, history) for part, history in zip(parts, histories, strict=True)],
            )


def _motion(run: Estimate, port: Port) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Displacement, velocity and time [shares of the longest record] along a run."""
    drive, n = run.trajectory.drive, run.assembly.plant.n_states
    states, none = run.trajectory.states[:, :n], np.zeros(drive.n_times)
    d, v = (
        none if row is None else states @ row[:n] + drive.sample @ row[n:] for row in (port.displacement, port.velocity)
    )
    return d, v, drive.time / max(float(drive.time.max()), TINY)


def _splines(motion: FloatArray, every: FloatArray) -> FloatArray:
    """(n_splines, n) cubic splines over the range of a motion; nothing where it rests."""
    low, high = float(every.min()), float(every.max())
    if not high - low > ROUNDED * max(abs(low), abs(high)):
        return np.zeros((0, len(motion)))
    knots = np.concatenate([[low] * 3, np.linspace(low, high, N_SPLINES - 2), [high] * 3])
    at = np.clip(motion, low, np.nextafter(high, low))
    splines: FloatArray = ((knots[:-1, np.newaxis] <= at) & (at < knots[1:, np.newaxis])).astype(np.float64)
    for degree in range(1, 4):  # the recursion of Cox and de Boor
        start, stop = knots[: -degree - 1, np.newaxis], knots[degree + 1 :, np.newaxis]
        rise, fall = knots[degree:-1, np.newaxis] - start, stop - knots[1:-degree, np.newaxis]
        splines = np.divide(at - start, rise, out=np.zeros_like(splines[:-1]), where=rise > 0) * splines[:-1] + (
            np.divide(stop - at, fall, out=np.zeros_like(splines[1:]), where=fall > 0) * splines[1:]
        )
    return splines


def _force_sources(run: Estimate, port: Port, histories: FloatArray) -> list[Source]:
    drive, n_all = run.trajectory.drive, run.trajectory.states.shape[1]
    return [force_response(drive, run.scheme, column, one, n_all) for column in port.columns for one in histories]


def _input_sources(run: Estimate, channel: int) -> list[Source]:
    """What an input's change by a delay, by a bend in time and by its own size adds."""
    drive, n = run.trajectory.drive, run.assembly.plant.n_states
    scale = max(float(np.std(drive.sample[:, channel])), TINY)
    signals = [one[:, channel] / scale for one in (drive.start, drive.end, drive.sample)]
    changed = np.array([_input_changes(one, drive) for one in signals])
    found = []
    for start, end, sample in changed.transpose(1, 0, 2):
        flow = np.zeros_like(run.trajectory.states)
        flow[:, :n] = np.outer(start, run.scheme.B0[:, channel]) + np.outer(end, run.scheme.B1[:, channel])
        found.append(Source(flow=flow, outputs=np.outer(sample[drive.rows], run.scheme.D[:, channel])))
    return found


def _input_changes(signal: FloatArray, drive: Drive) -> list[FloatArray]:
    step = int(drive.rows[1]) if len(drive.rows) > 1 else 1
    late, later = signal.copy(), signal.copy()
    for record in range(drive.n_records):
        times = drive.times_of(record)
        late[times] = np.concatenate([signal[times][:step], signal[times][:-step]])
        later[times] = np.concatenate([late[times][:step], late[times][:-step]])
    return [signal - late, signal - 2.0 * late + later, signal, signal**2, signal**3]


def _output_sources(run: Estimate, channel: int) -> list[Source]:
    drive = run.trajectory.drive
    y, t = run.trajectory.linearisation.free[:, channel], drive.time[drive.rows]
    y, t = y / max(float(np.std(y)), TINY), t / max(float(t.max()), TINY)
    slope = np.concatenate([np.gradient(y[rows]) for rows in map(drive.rows_of, range(drive.n_records))])
    found = []
    for one in (np.ones_like(t), t, y, y**2, y**3, t * y, slope):
        sensed = np.zeros_like(run.trajectory.outputs)
        sensed[:, channel] = one
        found.append(Source(sensed=sensed))
    return found


def _correlations(left: _Left) -> list[tuple[ResidualKind, str, float, float, Follows]]:
    """What is left of each output, the parameters' own step taken first, as a series: it follows an input, or itself.

    The latter is asked of held-out records by Ljung and Box's test; the former of all, at any delay.
    """
    found: list[tuple[ResidualKind, str, float, float, Follows]] = []
    for part in left.parts:
        plant, drive = part.run.assembly.plant, part.run.trajectory.drive
        for one in part.records:
            inputs = drive.sample[drive.rows[one.rows]].T
            for output, (taps, series) in enumerate(zip(one.filters, one.series(left.step), strict=True)):
                count = int(one.valid[output].sum())
                if count <= 2 * WHITENESS_LAGS:
                    continue
                for name, signal in zip(plant.input_names, inputs, strict=True):
                    found.append(("input", name, *_late(series, filter_by(taps, signal)), ""))
                if not one.held_out:
                    continue
                total = max(float(series @ series), TINY)
                sizes = [count - lag for lag in range(1, WHITENESS_LAGS + 1)]
                shares = [float(series[lag:] @ series[:-lag]) / total for lag in range(1, WHITENESS_LAGS + 1)]
                q = count * (count + 2) * sum(r * r / m for r, m in zip(shares, sizes, strict=True))
                log_p = log_chi_square_tail(q, WHITENESS_LAGS - (len(taps) - 1))
                found.append(("output", plant.output_names[output], log_p, q, "past"))
    return found


def _in_common(left: _Left) -> list[tuple[ResidualKind, str, float, float, Follows]]:
    """What two outputs share of what is left of them above the floor (Brillinger 1981, 8.5): noise of sensors does not.

    Each line of the spectrum counts by how much of it is above the floor; a force reaches the two alike in all records.
    """
    names = left.parts[0].run.assembly.plant.output_names
    crosses, sizes = np.zeros((len(names),) * 2, dtype=np.complex128), np.zeros((len(names),) * 2)
    for part in left.parts:
        drive = part.run.trajectory.drive
        rows_of = [drive.rows_of(record) for record in range(drive.n_records)]
        for one in part.records if len(names) > 1 else ():
            n = len(one.valid[0])
            lines = np.fft.fft(one.series(left.step))[:, 1 : (n + 1) // 2] / np.sqrt(n)
            floor = part.problem.floor[rows_of.index(one.rows)]
            above = np.sqrt(np.maximum(1.0 - floor[:, np.newaxis] / colours_of(one.filters, n).T, 0.0))
            crosses += (above * lines) @ (above * lines).conj().T
            sizes += above**2 @ above.T**2
    falls = 2.0 * np.abs(crosses) ** 2 / np.maximum(sizes, TINY)
    each = [(f"{names[i]} and {names[j]}", falls.item(i, j)) for i, j in combinations(range(len(names)), 2)]
    return [("output", where, -0.5 * fall, fall, "other output") for where, fall in each]


def _late(white: FloatArray, signal: FloatArray) -> tuple[float, float]:
    """Log p and the fall of the delay, up to half of the record, at which white noise of deviation 1 follows most."""
    n, n_delays = len(white), len(white) // 2
    seen = np.fft.irfft(np.fft.rfft(white, 2 * n) * np.fft.rfft(signal, 2 * n).conj(), 2 * n)[:n_delays]
    energy = np.cumsum(signal**2)[::-1][:n_delays]  # of what has arrived
    fall = float(np.max(seen**2 / np.maximum(energy, TINY + ROUNDED * energy[0])))
    return min(float(np.log(2.0 * n_delays) + scipy.special.log_ndtr(-np.sqrt(fall))), 0.0), fall


def _effect_weight(left: _Left, placement: int) -> float | None:
    """Square of what an effect does to the outputs, all but its own parameters free to make up for it."""
    changes = []
    for part in left.parts:
        run = part.run
        item, assembly = run.assembly.placements[placement], run.assembly
        if isinstance(item.effect, ForceEffect):
            changes.append(part.responses([_force_of(run, placement, np.ones(len(run.trajectory.states)))]))
            continue
        off = run_without(run, placement, part.problem, smoothing=run.smoothing)
        if off is None or not np.isfinite(off.trajectory.outputs).all():
            return None
        changes.append((run.trajectory.outputs - off.trajectory.outputs)[None])
    assembly = left.parts[0].run.assembly
    mine = assembly.local_of(placement)
    if mine.stop > mine.start:
        return _own_weight(left, changes, mine)
    own = assembly.common_of(placement)
    return left.weight(changes, held=range(own.start, own.stop))


def _force_of(run: Estimate, placement: int, factor: FloatArray) -> Source:
    """The force of an effect along a run, times a factor (n_times,)."""
    one = run.trajectory.linearisation.acting[run.assembly.forces.index(placement)]
    flow = np.zeros_like(run.trajectory.states)
    line = replace(one.line, start=one.line.start * factor, end=one.line.end * np.roll(factor, -1))
    flow[:, : run.assembly.plant.n_states] = line.flow(one.E0, one.E1)
    return Source(flow=flow, outputs=np.outer((one.force.value * factor)[run.trajectory.drive.rows], one.G))


def _other_power(left: _Left, placement: int) -> tuple[ResidualKind, list[FloatArray]] | None:
    """What a smooth law of one motion does more where its force grows with a power more of it; None for others."""
    item = left.parts[0].run.assembly.placements[placement]
    effect = item.effect
    if not isinstance(effect, ForceEffect) or effect.form_free or is_sharp(effect) or effect.n_memory:
        return None
    kinds: list[ResidualKind] = [kind for kind in ("displacement", "velocity") if kind in effect.needs]
    own = any(kind.role == "shape" and not any(kind.dimension) for kind in effect.parameters)  # an exponent
    if own or item.port is None or item.channel >= 0 or len(kinds) != 1:
        return None
    motions = [np.abs(_motion(part.run, item.port)[kinds[0] == "velocity"]) for part in left.parts]
    largest = max(float(motion.max()) for motion in motions)
    return kinds[0], [
        part.responses([_force_of(part.run, placement, np.log(np.maximum(motion / largest, TINY)))])
        for part, motion in zip(left.parts, motions, strict=True)
    ]


def undecided_laws(node: Node, task: Task, *, known: int) -> list[str]:
    """Smooth laws that the records do not tell from their neighbours, of another power of the motion, in words.

    Within the 95 % interval of that power these may differ from a law by what refuses a name, and from the first term
    of a series, whose next ones hardly show, by what is overlooked.
    """
    left, reasons = _left_of(node, task), []
    for i, item in enumerate(node.fitted.assembly.placements[known:], start=known):
        power = None if left is None else _other_power(left, i)
        if left is None or power is None or not (named := _effect_weight(left, i)):
            continue
        seen, _, score = (one.item(0) for one in left.reduced(power[1]))
        spread, unit = float(np.sqrt(1.0 / max(seen, TINY))), float(np.sqrt(max(seen, TINY) / named))
        change = score * spread**2
        most = (abs(change) + NINETY_FIVE * spread) * unit
        limit = SLIGHT if getattr(item.effect, "first_term", False) else MUCH
        if not most <= limit:
            reasons.append(
                f"a law that grows with another power of the {power[0]} ({number(change, 2)} +- {number(spread, 2)} "
                f"more) fits as well as {effects_at([node.effects[i]])}, up to {percent(most)} of its force apart "
                f"(limit {percent(limit)}): records with less noise, or levels further apart, would tell"
            )
    return reasons


def _own_weight(left: _Left, changes: Sequence[FloatArray], mine: slice) -> float:
    """Likewise of an effect with unknowns of each record: the record's others alone are free to make up for it."""
    total = 0.0
    for part, change in zip(left.parts, changes, strict=True):
        for one in part.records:
            flat = _flat(change[:, one.rows], one.filters, one.valid)
            others = _basis(np.delete(one.local, np.r_[mine], axis=0))
            total += float(np.sum((flat - (flat @ others) @ others.T) ** 2))
    return total


MUCH = 0.1
"""Name nothing firmly above this share of the named effect's force, whatever it depends on."""


def only_noise(node: Node, root: Node, task: Task) -> bool:
    """Whether a model explains nearly everything, and what it leaves depends on nothing: noise, of whatever colour."""
    if node is root or not node.held_out_level - 1.0 <= CLEAR * (root.held_out_level - 1.0):
        return False
    tests = lack_of_fit(node, task, known=len(root.effects))
    return bool(tests) and worst_left(tests) is None


def what_is_left(tests: Sequence[LackOfFit], best: Node, root: Node) -> tuple[list[str], list[str]]:
    """Why a model is not firm for what it leaves, and what must be said beside a firm name."""
    found = best.coarse.assembly.placements[len(root.effects) :]
    left = [one for one in beyond_noise(tests) if one.share > SLIGHT]
    for one in left:
        if one.share > MUCH or any(_same_motion(one, item) for item in found):
            more = "" if one.follows else f"{_how_much(one, found)}: the law is another one, or has company"
            return [f"{something(one)} is left{more}"], []
    return [], [f"besides, {something(one)} is left{_how_much(one, found)}" for one in left[:1]]


def _how_much(test: LackOfFit, found: Sequence[EffectPlacement]) -> str:
    """The size of what is left, in words: by the least of the effects where the rest of the model cannot replace it."""
    if test.follows or not np.isfinite(test.share):
        return "" if test.follows else f", {percent(test.size)} of the outputs"
    least = {1: "", 2: "the weaker of "}.get(len(found), "the weakest of ")
    names = effects_at([(item.effect.key, item.where) for item in found])
    forces = all(isinstance(item.effect, ForceEffect) and item.channel < 0 for item in found)
    does = f"the force of {least}{names}" if forces else f"what {least}{names} does to the outputs"
    return f", {percent(test.share)} of {does}"


def _same_motion(test: LackOfFit, item: EffectPlacement) -> bool:
    """Whether what is left depends on what an effect depends on, at its place."""
    if test.where != item.where or not isinstance(item.effect, ForceEffect):
        return test.where == item.where
    return test.kind in item.effect.needs or item.effect.n_memory > 0
