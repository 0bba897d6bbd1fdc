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

from modal.estimation.response_fit import LARGEST_SIZE, MOST_DAMPING, ResponseFit, ResponseLines, orthonormal
from okid.arrays import TINY, ComplexArray, FloatArray

STEP = 1e-7
"""Differentiate by steps of this size in the logarithm of a pole: a thousandth of the narrowest resonance's width."""
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
        weight_of: one over the deviations of the table's values about a model, as in `response_fit.fit_at`.
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


def _under_force(
    zeros: ComplexArray, own: ComplexArray, poles: ComplexArray, under_white: Callable[[ComplexArray], ComplexArray]
) -> ComplexArray:
    """(2, n_lines, n_poles) g of each pole, then of its conjugate, where the force has zeros and poles.

    S / (z - p) is a sum of 1 / (z - p), and of 1 / (z - q) and 1 / (1 / z - q) for every q; each through the window.

    Args:
        zeros: of the force, one of each pair.
        own: poles of the force, as many with their conjugates: one of each pair, and real ones.
        poles: (n_poles,) p.
        under_white: g of poles and of their conjugates for a white force.
    """
    pairs = own.imag > 0
    zeros, q = np.r_[zeros, zeros.conj()], np.r_[own, own[pairs].conj()]
    both = np.r_[poles, poles.conj()]
    apart = q[:, np.newaxis] - q
    np.fill_diagonal(apart, 1.0)
    at, each = q[:, np.newaxis], both[:, np.newaxis]
    rho = ((at - zeros) * (1 / at - zeros)).prod(axis=1) / (apart.prod(axis=1) * (1 / at - q).prod(axis=1))
    seen, mirrored = under_white(own)
    ahead, behind = np.hstack([seen, mirrored[:, pairs]]), np.hstack([mirrored, seen[:, pairs]]).conj()
    power = ((zeros / q).prod() + (rho / q).sum() + ahead @ rho + behind @ rho).real
    share = ((each - zeros) * (1 / each - zeros) / ((each - q) * (1 / each - q))).prod(axis=1)
    first, last = rho[:, np.newaxis] / (at - both), rho[:, np.newaxis] / (1 - both * at)
    values = share * np.hstack(list(under_white(poles))) + ahead @ first + behind @ (last * at) + last.sum(axis=0)
    return np.stack(np.split(values / power[:, np.newaxis], 2, axis=1))


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
        self.near: tuple[ComplexArray, ComplexArray, ComplexArray] | None = None

    def _seen(self, poles: ComplexArray) -> ComplexArray:
        """What the table makes of each pole, by its slope where it is next to one that is known."""
        if self.near is None:
            return self.table.values_of(poles)
        known, g, slopes = self.near
        nearest = np.abs(poles[:, np.newaxis] - known).argmin(axis=1)
        # of the conjugate, the logarithm moves by the conjugate
        moved = np.log(poles / known[nearest])
        return g[:, :, nearest] + slopes[:, :, nearest] * np.stack([moved, moved.conj()])[:, np.newaxis]

    def _force(self, at: _Unknowns) -> tuple[ComplexArray, ComplexArray]:
        """Zeros and poles of the force, 1 / (1 + sum b / (z - p) + the same of the conjugates); one of each pair."""
        zeros = at.poles[self.is_pair][self.dips]
        b = 1j * self.line * at.loads[self.dips] * zeros
        n = zeros.size
        A = np.block([[np.diag(zeros.real), np.diag(-zeros.imag)], [np.diag(zeros.imag), np.diag(zeros.real)]])
        A[:, :n] -= 2 * np.r_[b.real, b.imag][:, np.newaxis]
        own = np.asarray(np.linalg.eigvals(A), dtype=np.complex128)
        own = own[own.imag >= 0]
        own = np.where(np.abs(own) > 1, 1 / own.conj(), own)  # the spectrum is the same
        return zeros, _stable(own)

    def _columns(self, at: _Unknowns) -> FloatArray:
        """(2 n_lines, n_columns) real parts above imaginary ones."""
        with np.errstate(all="ignore"):  # what is no number is no candidate
            g, mirrored = _under_force(*self._force(at), at.poles, self._seen)
            mirrored = mirrored * self.is_pair
            turned = 1j * (g - mirrored)[:, self.is_pair]
        both = np.hstack([g + mirrored, turned, np.ones((len(g), 1))])
        return np.concatenate([both.real, both.imag])

    def _moved(self, at: _Unknowns, step: FloatArray) -> _Unknowns:
        """After a step: real parts of the poles' logarithms, imaginary ones of pairs, then the loads' parts."""
        n, pairs = at.poles.size, np.flatnonzero(self.is_pair)
        change = step[:n] + 0j
        change[pairs] += 1j * step[n : n + pairs.size]
        of_loads = step[n + pairs.size :].reshape(-1, int(self.dips.sum()))
        loads = at.loads.copy()
        loads[self.dips] *= np.exp(np.clip(of_loads[0], -1, 1) + (1j * of_loads[1] if len(of_loads) > 1 else 0.0))
        return _Unknowns(poles=_stable(at.poles * np.exp(np.clip(change.real, -1, 1) + 1j * change.imag)), loads=loads)

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
        at, n_first = point.unknowns, point.unknowns.poles.size + self.dips.size
        sizes = STEP * np.ones(n_first + (2 if phases else 1) * int(self.dips.sum()))
        known = np.r_[at.poles, self._force(at)[1]]
        self.near = (known, *self.table.basis(known))
        moved = [
            (self._columns(self._moved(at, step)) - point.columns) / size
            for step, size in zip(np.diag(sizes), sizes, strict=True)
        ]
        self.near = None
        parts = []
        for w, span, c in zip(self.weights, point.spans, point.coefficients, strict=True):
            part = w[:, np.newaxis] * np.stack([one @ c for one in moved], axis=1)
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
