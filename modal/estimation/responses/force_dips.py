"""How far the dips of a loaded shaker's force may move the modes of responses averaged over short blocks.

Where a structure resonates it gives way, and the force of a shaker that it loads falls: the force has zeros at the
structure's poles p and poles q of its own, those of structure and shaker together (Tomlinson, "Force distortion in
resonance testing of structures with electro-dynamic vibration exciters", J. Sound and Vibration 63(3), 1979, 337-350,
doi 10.1016/0022-460X(79)90678-3). Its spectrum is S = prod |(z - p) / (z - q)|^2, and responses H averaged through a
window W are not H through W then, but

    (W * (H S)) / (W * S)

with * a convolution over lines: a dip narrower than a line is filled by what leaks in from beside it, which shifts what
is left of the resonance by parts of a line. The responses alone tell that there are dips, but not surely where the
force's own poles lie: fits with them on either side are about as good, and put the modes at different places.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from modal.estimation.responses.fit import LARGEST_SIZE, MOST_DAMPING, ResponseFit, ResponseLines, orthonormal
from okid.arrays import TINY, ComplexArray, FloatArray

FIRST_STEPS, MOST_STEPS = 8, 24
"""Take so many Gauss-Newton steps from each start, and more where they found that there are dips."""
ROUNDS = 2
"""Weigh the table again by what the dips leave of its errors, and search again, so often."""
COMES_AFTER = 2
"""Let the poles come after another load for so many steps before it is judged. Eight lead to the same modes within a
deviation at 1.4 to 1.7 times the CPU, one and four likewise (shaker tables 41150 to 41153)."""
AWAY = 2.0 ** np.arange(9)
"""Start with the force's poles so many lines away from the structure's, whichever distance explains most."""
STANDS_STILL = 1e-4
"""Stop where a step lowers the squared error by a smaller share."""
NARROW = 8
"""See dips where the half-power band is no wider than so many lines: no window known here mixes lines further apart."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Unknowns:
    """Poles of the model, and loads of its pairs: how many lines below a resonance a dip alone puts the force's pole.

    A shaker that is a mass to the structure has loads that are real and positive, a spring negative ones.
    """

    poles: ComplexArray
    loads: ComplexArray


def _stable(poles: ComplexArray) -> ComplexArray:
    return np.asarray(poles * np.minimum(1.0, LARGEST_SIZE / np.maximum(np.abs(poles), TINY)), dtype=np.complex128)


def with_dips(
    table: ResponseLines,
    models: Sequence[ResponseFit],
    weight_of: Callable[[ResponseFit], FloatArray],
    evidence: Callable[[float, int], float],
) -> tuple[int, ResponseFit, FloatArray] | None:
    """Which of the models explains the table best under a force with dips, that fit of it, and how far it may be off.

    The damping is much the same wherever the force's own poles lie; the frequencies are not. No way to look for them is
    sure to end at the best, so (2, n_poles) is how far the ways that were tried lie from the best of them, in frequency
    [Hz] and damping ratio, at most: what to add to the deviations of one way. None where dips make nothing likelier.

    Only one force is described: what several at once do to one another takes their cross spectra. The force at a point
    falls as 1 / (Z + H) with H the structure's own response there, whose residues have one sign, and Z the shaker's
    (a mass below its stinger's resonance, a spring above): so loads are sought that are real, from a mass and a spring
    of every size, then for one mode after the other, and get their phases last.

    Args:
        table: that was fitted.
        models: of it without dips, the best first, then with fewer and fewer poles: what a pole did beside a resonance
            a dip may do better.
        weight_of: one over the deviations of the table's values about a model, as in `responses.fit.fit_at`.
        evidence: of a squared error with so many unknowns; the least counts.
    """
    if table.values.shape[2] != 1 or not table.leaks:
        return None
    least, weight = evidence(models[0].error, models[0].n_parameters), weight_of(models[0])
    number, points = -1, list[_Point]()
    for k, model in enumerate(models):
        search = _Search(table, model, weight)
        if not search.dips.any():
            break
        trial = [search.path(start, FIRST_STEPS, phases=False) for start in search.starts(model.poles)]
        best = min(evidence(point.error, search.n_parameters) for point in trial)
        if best < least:
            least, number, points = best, k, trial
    if number < 0:
        return None
    search = _Search(table, models[number], weight)
    best_point = min(points, key=lambda point: point.error)
    for _ in range(ROUNDS):
        search = _Search(table, models[number], weight_of(search.fit(best_point)))
        points = [search.path(search.at(point.unknowns), MOST_STEPS, phases=False) for point in points]
        best_point = min(points, key=lambda point: point.error)
        for k in np.flatnonzero(search.dips).tolist():
            points.append(search.path(search.elsewhere(best_point.unknowns, k), FIRST_STEPS, phases=False))
            best_point = min(best_point, points[-1], key=lambda point: point.error)
    points = [search.path(point, MOST_STEPS, phases=True) for point in points]
    best_point = min(points, key=lambda point: point.error)
    each = np.log([best_point.unknowns.poles, *(point.unknowns.poles for point in points)])
    size = np.maximum(np.abs(each), TINY)
    quantities = np.stack([size / (2 * np.pi * table.dt), -each.real / size])
    return number, search.fit(best_point), np.abs(quantities[:, 1:] - quantities[:, :1]).max(axis=1)


def _grown(x: ComplexArray, dx: ComplexArray, moves: tuple[tuple[ComplexArray, ComplexArray], ...]) -> ComplexArray:
    """(n_moves, n_x) change of the logarithm of S at x, from zeros and poles with their moves; x itself is left out."""
    changes = []
    for roots, d_roots in moves:
        apart, back = x[:, np.newaxis] - roots, 1 / x[:, np.newaxis] - roots
        ahead = (dx[..., np.newaxis] - d_roots[:, np.newaxis]) / np.where(apart == 0, 1.0, apart)
        behind = (dx[..., np.newaxis] / x[:, np.newaxis] ** 2 + d_roots[:, np.newaxis]) / back
        changes.append((ahead - behind).sum(axis=-1))
    return changes[0] - changes[1]


def _mixture(
    zeros: ComplexArray, q: ComplexArray, p: ComplexArray, moves: tuple[ComplexArray, ComplexArray, ComplexArray]
) -> tuple[ComplexArray, ComplexArray]:
    """How S / (z - p) of each pole p, and S last, add up from 1, 1 / (z - q), 1 / (1 / z - q) and 1 / (z - p).

    Args:
        zeros: (n_q,) of the force, with their conjugates.
        q: (n_q,) poles of the force, with their conjugates.
        p: (n_poles,) poles, with their conjugates.
        moves: (n_moves, n) of the zeros, of q and of p.

    Returns:
        (1 + 2 n_q + n_poles, n_poles + 1), and (n_moves, ...) by how much it changes with small moves.
    """
    dz, dq, dp = moves
    at, d_at = q[:, np.newaxis], dq[..., np.newaxis]
    apart = at - q
    np.fill_diagonal(apart, 1.0)
    rho = ((at - zeros) * (1 / at - zeros) / (apart * (1 / at - q))).prod(axis=1)
    of_rho = _grown(q, dq, ((zeros, dz), (q, dq)))
    each = p[:, np.newaxis]
    share = ((each - zeros) * (1 / each - zeros) / ((each - q) * (1 / each - q))).prod(axis=1)
    of_share = _grown(p, dp, ((zeros, dz), (q, dq)))
    far = 1 - at * p
    ahead, behind, const = rho[:, np.newaxis] / (at - p), rho[:, np.newaxis] * at / far, (zeros / q).prod()
    of_far = (at * dp[:, np.newaxis] + d_at * p) / far
    mixed, changes = (
        np.zeros((*n, 1 + 2 * q.size + p.size, p.size + 1), dtype=np.complex128) for n in ((), (len(dz),))
    )
    rows, diagonal = 1 + q.size, (1 + 2 * q.size + np.arange(p.size), np.arange(p.size))
    mixed[0] = np.r_[(behind / at).sum(axis=0), const + (rho / q).sum()]
    mixed[1:rows, :-1], mixed[rows : rows + q.size, :-1] = ahead, behind
    mixed[1 : rows + q.size, -1] = np.tile(rho, 2)
    mixed[diagonal] = share
    changes[:, 0, :-1] = (behind / at * (of_rho[..., np.newaxis] + of_far)).sum(axis=1)
    changes[:, 0, -1] = const * (dz / zeros - dq / q).sum(axis=1) + (rho / q * (of_rho - dq / q)).sum(axis=1)
    changes[:, 1:rows, :-1] = ahead * (of_rho[..., np.newaxis] - (d_at - dp[:, np.newaxis]) / (at - p))
    changes[:, rows : rows + q.size, :-1] = behind * (of_rho[..., np.newaxis] + d_at / at + of_far)
    changes[:, 1 : rows + q.size, -1] = np.tile(rho * of_rho, 2)
    changes[(slice(None), *diagonal)] = share * of_share
    return mixed, changes


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Point:
    """Unknowns with what they leave: (n_outputs, 2 n_lines) weighted; columns, their spans and coefficients."""

    unknowns: _Unknowns
    error: float
    left: FloatArray
    columns: FloatArray
    spans: tuple[FloatArray, ...]
    coefficients: tuple[FloatArray, ...]


class _Search:
    """The squared error and its slopes, for one table, weight and sort of poles."""

    def __init__(self, table: ResponseLines, model: ResponseFit, weight: FloatArray) -> None:
        self.table, self.is_pair = table, model.is_pair
        self.weights = [np.tile(w, 2) for w in weight[:, :, 0].T]
        self.wanted = [np.r_[values.real, values.imag] for values in table.values[:, :, 0].T]
        self.line = 2 * np.pi / (2 * table.z.size if table.lags is None else table.lags.size)
        first, last = np.angle(table.z[[0, -1]])
        pairs = model.poles[model.is_pair]
        wide = -2 * np.log(np.maximum(np.abs(pairs), TINY)) >= NARROW * self.line
        self.dips = (np.angle(pairs) > first) & (np.angle(pairs) < last) & ~wide
        one, pair = np.eye(self.is_pair.size), np.diag(1.0 * self.is_pair)
        self.parts = np.block([[one, 1j * one[:, self.is_pair]], [pair, -1j * pair[:, self.is_pair]]])

    def _logarithms(self, steps: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Of poles and loads that dip, from their real parts and imaginary ones of pairs, and the same of the loads."""
        n, n_pairs, n_dips = self.is_pair.size, int(self.is_pair.sum()), int(self.dips.sum())
        of_poles, of_loads = steps[..., :n] + 0j, steps[..., n + n_pairs : n + n_pairs + n_dips] + 0j
        of_poles[..., self.is_pair] += 1j * steps[..., n : n + n_pairs]
        if steps.shape[-1] > n + n_pairs + n_dips:
            of_loads += 1j * steps[..., n + n_pairs + n_dips :]
        return np.asarray(of_poles, dtype=np.complex128), np.asarray(of_loads, dtype=np.complex128)

    def _force(self, at: _Unknowns, of_poles: ComplexArray, of_loads: ComplexArray) -> tuple[ComplexArray, ...]:
        """(n_q,) zeros and poles of the force, 1 / (1 + sum b / (z - p) + those of conjugates); how both move."""
        zeros = at.poles[self.is_pair][self.dips]
        n = zeros.size
        b = 1j * self.line * at.loads[self.dips] * zeros
        A = np.block([[np.diag(zeros.real), np.diag(-zeros.imag)], [np.diag(zeros.imag), np.diag(zeros.real)]])
        A[:, :n] -= 2 * np.r_[b.real, b.imag][:, np.newaxis]
        own = np.asarray(np.linalg.eigvals(A), dtype=np.complex128)
        own = own[own.imag >= 0]
        of_zeros = of_poles[:, self.is_pair][:, self.dips]
        zeros, b = np.r_[zeros, zeros.conj()], np.r_[b, b.conj()]
        dz = zeros * np.hstack([of_zeros, of_zeros.conj()])
        db = b * np.hstack([of_zeros + of_loads, (of_zeros + of_loads).conj()])
        near = 1 / (own[:, np.newaxis] - zeros)
        of_own = (db @ near.T + (b * dz) @ near.T**2) / (near**2 @ b) / own  # what keeps the sum at -1
        outside = np.abs(own) > 1  # the spectrum of the inverse is the same
        own, of_own = np.where(outside, 1 / own.conj(), own), np.where(outside, -of_own.conj(), of_own)
        of_own = np.where(np.abs(own) >= LARGEST_SIZE, 1j * of_own.imag, of_own)
        own, pairs = _stable(own), own.imag > 0
        q = np.r_[own, own[pairs].conj()]
        return zeros, q, dz, q * np.hstack([of_own, of_own[:, pairs].conj()])

    def _mixed(self, at: _Unknowns, of_poles: ComplexArray, of_loads: ComplexArray) -> tuple[ComplexArray, ...]:
        """Poles q of the force; the numbers of `_mixture` for real shapes, imaginary ones of pairs and its power.

        And the changes of the logarithms of q, of q again and of p, and of those numbers.
        """
        zeros, q, dz, dq = self._force(at, of_poles, of_loads)
        p, of_p = np.r_[at.poles, at.poles.conj()], np.hstack([of_poles, of_poles.conj()])
        mixed, changes = (
            np.concatenate([one[..., :-1] @ self.parts, one[..., -1:]], axis=-1)
            for one in _mixture(zeros, q, p, (dz, dq, p * of_p))
        )
        return q, mixed, np.hstack([dq / q, dq / q, of_p]), changes

    def _basis(self, g: ComplexArray, q: ComplexArray) -> ComplexArray:
        """(n_lines, 1 + 2 n_q + 2 n_poles) what a `_mixture` mixes, from g of q above the axis, then of p.

        As well its slopes by the logarithms of q, q again and p from those of g, but for the first column.
        """
        n, pairs = np.count_nonzero(q.imag >= 0), q[q.imag >= 0].imag > 0
        seen, mirrored = g[:, :, :n]
        ahead, behind = np.hstack([seen, mirrored[:, pairs]]), np.hstack([mirrored, seen[:, pairs]]).conj()
        return np.hstack([np.ones((len(seen), 1)), ahead, behind, *g[:, :, n:]])

    def _columns(self, at: _Unknowns) -> FloatArray:
        """(2 n_lines, n_columns) real parts above imaginary ones."""
        with np.errstate(all="ignore"):  # what is no number is no candidate
            q, mixed, _, _ = self._mixed(at, *self._logarithms(np.empty((0, self._n_unknowns(phases=False)))))
            values = self._basis(self.table.values_of(np.r_[q[q.imag >= 0], at.poles]), q) @ mixed
            columns = values / values[:, -1:].real
        columns[:, -1] = 1.0
        return np.concatenate([columns.real, columns.imag])

    def _n_unknowns(self, *, phases: bool) -> int:
        return self.is_pair.size + self.dips.size + (2 if phases else 1) * int(self.dips.sum())

    def _moved(self, at: _Unknowns, step: FloatArray) -> _Unknowns:
        of_poles, of_loads = self._logarithms(step)
        loads = at.loads.copy()
        loads[self.dips] *= np.exp(np.clip(of_loads.real, -1, 1) + 1j * of_loads.imag)
        poles = at.poles * np.exp(np.clip(of_poles.real, -1, 1) + 1j * of_poles.imag)
        return _Unknowns(poles=_stable(poles), loads=loads)

    def at(self, unknowns: _Unknowns) -> _Point:
        """With the best shapes and feedthrough."""
        columns = self._columns(unknowns)
        if not np.isfinite(columns).all():
            return _Point(unknowns=unknowns, error=np.inf, left=columns, columns=columns, spans=(), coefficients=())
        each = list(zip(self.weights, self.wanted, strict=True))
        spans, solved = [], []
        for w, y in each:
            span, mixed = orthonormal(w[:, np.newaxis] * columns)
            spans.append(span)
            solved.append(mixed @ (span.T @ (w * y)))
        left = np.array([w * (y - columns @ c) for (w, y), c in zip(each, solved, strict=True)])
        return _Point(
            unknowns=unknowns,
            error=float(np.square(left).sum()),
            left=left,
            columns=columns,
            spans=tuple(spans),
            coefficients=tuple(solved),
        )

    def _slopes(self, point: _Point, *, phases: bool) -> FloatArray:
        """(n_outputs * 2 n_lines, n_unknowns) of the model, what shapes and feedthrough can do projected out."""
        at, n_unknowns = point.unknowns, self._n_unknowns(phases=phases)
        shapes = np.pad(np.array(point.coefficients)[:, :-1].T, ((0, 1), (0, 1)))
        shapes[-1, -1] = 1.0  # of the power
        with np.errstate(all="ignore"):
            q, mixed, of_both, changes = self._mixed(at, *self._logarithms(np.eye(n_unknowns)))
            basis, turned = (self._basis(g, q) for g in self.table.basis(np.r_[q[q.imag >= 0], at.poles]))
            mixed = mixed @ shapes
            changes = np.hstack([changes @ shapes, of_both[..., np.newaxis] * mixed[1:]])
            values = basis @ mixed
            moved = np.hstack([basis, turned[:, 1:]]) @ changes.transpose(1, 2, 0).reshape(changes.shape[1], -1)
            moved = moved.reshape(*values.shape, n_unknowns).transpose(1, 0, 2)
            power = values[:, -1:].real
            moved = (moved[:-1] - (values[:, :-1] / power).T[..., np.newaxis] * moved[-1].real) / power
        parts = []
        for w, span, slopes in zip(self.weights, point.spans, np.hstack([moved.real, moved.imag]), strict=True):
            part = w[:, np.newaxis] * slopes
            parts.append(part - span @ (span.T @ part))
        return np.nan_to_num(np.concatenate(parts), posinf=0.0, neginf=0.0)

    def starts(self, poles: ComplexArray) -> list[_Point]:
        """With a mass and with a spring at the structure, each as large as explains most."""
        lines = np.angle(poles[self.is_pair]) / (2 * self.line)
        found = []
        for sizes in (AWAY[:, np.newaxis] * np.ones(lines.size), lines / AWAY[:, np.newaxis]):
            for side in (1, -1):
                tried = [
                    self.at(_Unknowns(poles=poles, loads=side * np.where(self.dips, one, 0) + 0j)) for one in sizes
                ]
                found.append(min(tried, key=lambda one: one.error))
        return found

    def elsewhere(self, at: _Unknowns, pair: int) -> _Point:
        """With another load of one pair, which explains most after the poles have come after it."""
        tried = []
        for lines in AWAY:
            loads = at.loads.copy()
            loads[pair] = lines
            tried.append(self.path(self.at(_Unknowns(poles=at.poles, loads=loads)), COMES_AFTER, phases=False))
        return min(tried, key=lambda one: one.error)

    @property
    def n_parameters(self) -> int:
        """Numbers that are fitted, linear ones included."""
        n_states = self.is_pair.size + int(self.is_pair.sum())
        return n_states + 2 * int(self.dips.sum()) + (n_states + 1) * self.table.values.shape[1]

    def fit(self, point: _Point) -> ResponseFit:
        """The model without the force's dips, its slopes those under them."""
        n_lines, n_outputs, _ = self.table.values.shape
        n_poles, pairs = point.unknowns.poles.size, np.flatnonzero(self.is_pair)
        found = np.array(point.coefficients)
        model = point.columns @ found.T
        rest = self.table.values[:, :, 0] - (model[:n_lines] + 1j * model[n_lines:])
        shapes = found[:, :n_poles] + 0j
        shapes[:, pairs] += 1j * found[:, n_poles : n_poles + pairs.size]
        return ResponseFit(
            poles=point.unknowns.poles,
            is_pair=self.is_pair,
            inputs=np.ones((n_poles, 1), dtype=np.complex128),
            shapes=np.asarray(shapes, dtype=np.complex128),
            feedthrough=found[:, -1:],
            error=point.error,
            left=np.where(self.table.known, rest[:, :, np.newaxis], 0.0),
            slopes=self._slopes(point, phases=True).reshape(n_outputs, 2, n_lines, 1, -1),
            inverse=np.empty((n_outputs, 0, 0)),
            answers=np.empty((n_outputs, 0, 0)),
        )

    def path(self, best: _Point, most: int, *, phases: bool) -> _Point:
        """The point after damped Gauss-Newton steps, as long as the squared error falls."""
        damping = 1e-3
        for _ in range(most if np.isfinite(best.error) else 0):
            slopes = self._slopes(best, phases=phases)
            curvature, slope = slopes.T @ slopes, slopes.T @ best.left.ravel()
            diagonal = np.maximum(np.diag(curvature), TINY)
            trial = best
            while damping < MOST_DAMPING and not trial.error < best.error:
                step = np.linalg.lstsq(curvature + np.diag(damping * diagonal), slope, rcond=None)[0]
                trial = self.at(self._moved(best.unknowns, np.asarray(step, dtype=np.float64)))
                damping *= 4
            if trial.error > (1 - STANDS_STILL) * best.error:
                return min(best, trial, key=lambda one: one.error)
            best, damping = trial, damping / 12
        return best
