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

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from modal.estimation.response_fit import LARGEST_SIZE, MOST_DAMPING, ResponseFit, ResponseLines, orthonormal
from okid.arrays import TINY, BoolArray, ComplexArray, FloatArray

STEP = 1e-7
"""Differentiate by steps of this size in the logarithm of a pole: a thousandth of the narrowest resonance's width."""
FIRST_STEPS, MOST_STEPS = 8, 24
"""Take so many Gauss-Newton steps from each start, and more where they found that there are dips."""
AWAY = 2.0 ** np.arange(9)
"""Start with the force's poles so many lines away from the structure's, whichever distance explains most."""
STANDS_STILL = 1e-4
"""Stop where a step lowers the squared error by a smaller share."""
NARROW = 8
"""See dips where the half-power band is no wider than so many lines: no window known here mixes lines further apart."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Unknowns:
    """Poles of the model and dips of its pairs: 1 / (q / p - 1) with q the force's pole.

    Infinite without a dip, and 0 where the force's pole is far away, through which it may change sides.
    """

    poles: ComplexArray
    dips: ComplexArray

    def moved(self, step: FloatArray, is_pair: BoolArray) -> "_Unknowns":
        """After a step: real parts of the poles' logarithms, imaginary ones of pairs, then the dips' parts."""
        n, pairs = self.poles.size, np.flatnonzero(is_pair)
        change = step[:n] + 0j
        change[pairs] += 1j * step[n : n + pairs.size]
        dips = self.dips + step[n + pairs.size : n + 2 * pairs.size] + 1j * step[n + 2 * pairs.size :]
        return _Unknowns(poles=_stable(self.poles * np.exp(np.clip(change.real, -1, 1) + 1j * change.imag)), dips=dips)

    def force(self, is_pair: BoolArray) -> ComplexArray:
        """(2, n) zeros and poles of the force, one of each pair."""
        there = np.isfinite(self.dips)
        zeros = self.poles[is_pair][there]
        dips = np.where(np.abs(self.dips[there]) < STEP, STEP, self.dips[there])
        own = zeros * (1 + 1 / dips)
        outside = np.abs(own) > 1
        # the spectrum is the same
        own[outside] = 1 / own[outside].conj()
        return np.array([zeros, _stable(own)])


def _stable(poles: ComplexArray) -> ComplexArray:
    return np.asarray(poles * np.minimum(1.0, LARGEST_SIZE / np.maximum(np.abs(poles), TINY)), dtype=np.complex128)


def moved_by_dips(
    table: ResponseLines, fit: ResponseFit, weight: FloatArray, evidence: Callable[[float, int], float]
) -> FloatArray:
    """(2, n_poles) how far dips of the force may move frequency [Hz] and damping ratio; 0 where none explain the table.

    Every fit with dips that is likelier than that without counts, those on the way to the best of a start as well: the
    shifts that they give belong to responses that look alike.

    Only one force is described: what several at once do to one another takes their cross spectra. Where a structure is
    driven, its poles and those of structure and shaker together take turns along the lines (Foster's theorem), so the
    force's are started all below the structure's, all above, and on neither side.

    Args:
        table: that was fitted.
        fit: of the table.
        weight: as in `modal.estimation.response_fit.fit_at`.
        evidence: of a squared error with so many unknowns; the least counts.
    """
    none = np.zeros((2, fit.poles.size))
    if table.values.shape[2] != 1 or not table.leaks:
        return none
    search = _Search(table, fit.is_pair, weight)
    pairs = fit.poles[fit.is_pair]
    line = 2 * np.pi / search.n_samples
    first, last = np.angle(table.z[[0, -1]])
    angles = np.angle(pairs)
    narrow = (angles > first) & (angles < last) & (-2 * np.log(np.maximum(np.abs(pairs), TINY)) < NARROW * line)
    if not narrow.any():
        return none
    found = []
    for side in (-1, 0, 1):
        gaps = side * (angles[:, np.newaxis] - angles)
        room = np.minimum(np.where(gaps < 0, -gaps, np.inf).min(axis=1), angles if side < 0 else np.pi - angles)
        tried = []
        for lines in AWAY:
            away = 1j * side * np.minimum(line * lines, 0.5 * room) if side else -line * lines * np.ones(pairs.size)
            dips = np.where(narrow, 1 / away, np.inf)
            tried.append(search.at(_Unknowns(poles=fit.poles, dips=dips)))
        found.append(search.path(min(tried, key=lambda one: one.error), FIRST_STEPS))
    n_more = 2 * int(narrow.sum())
    without = evidence(fit.error, fit.n_parameters)
    if not any(evidence(path[-1].error, fit.n_parameters + n_more) < without for path in found):
        return none
    found = [path + search.path(path[-1], MOST_STEPS - FIRST_STEPS) for path in found]
    likelier = [one for path in found for one in path if evidence(one.error, fit.n_parameters + n_more) < without]
    each = np.log([fit.poles, *(one.unknowns.poles for one in likelier)])
    size = np.maximum(np.abs(each), TINY)
    quantities = np.stack([size / (2 * np.pi * table.dt), -each.real / size])
    return np.asarray(np.abs(quantities[:, 1:] - quantities[:, :1]).max(axis=1), dtype=np.float64)


def _under_force(
    force: ComplexArray, poles: ComplexArray, under_white: Callable[[ComplexArray], ComplexArray]
) -> ComplexArray:
    """(2, n_lines, n_poles) g of each pole, then of its conjugate, where the force has zeros and poles.

    S / (z - p) is a sum of 1 / (z - p), and of 1 / (z - q) and 1 / (1 / z - q) for every q; each through the window.

    Args:
        force: (2, n) zeros and poles, one of each pair.
        poles: (n_poles,) p.
        under_white: g of poles and of their conjugates for a white force.
    """
    zeros, q = np.hstack([force, force.conj()])
    both = np.r_[poles, poles.conj()]
    apart = q[:, np.newaxis] - q
    np.fill_diagonal(apart, 1.0)
    at, own = q[:, np.newaxis], both[:, np.newaxis]
    rho = ((at - zeros) * (1 / at - zeros)).prod(axis=1) / (apart.prod(axis=1) * (1 / at - q).prod(axis=1))
    seen, mirrored = under_white(force[1])
    ahead, behind = np.hstack([seen, mirrored]), np.hstack([mirrored, seen]).conj()
    power = ((zeros / q).prod() + (rho / q).sum() + ahead @ rho + behind @ rho).real
    share = ((own - zeros) * (1 / own - zeros) / ((own - q) * (1 / own - q))).prod(axis=1)
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

    def __init__(self, table: ResponseLines, is_pair: BoolArray, weight: FloatArray) -> None:
        self.table, self.is_pair = table, is_pair
        self.weights = [np.tile(w, 2) for w in weight[:, :, 0].T]
        self.wanted = [np.r_[values.real, values.imag] for values in table.values[:, :, 0].T]
        self.n_samples = 2 * table.z.size if table.lags is None else table.lags.size
        self.known: dict[complex, ComplexArray] = {}

    def _seen(self, poles: ComplexArray) -> ComplexArray:
        """What the table makes of each pole, which most trials share."""
        new = np.array([pole for pole in poles.tolist() if pole not in self.known], dtype=np.complex128)
        if new.size:
            self.known.update(zip(new.tolist(), self.table.values_of(new).transpose(2, 0, 1), strict=True))
        return np.stack([self.known[pole] for pole in poles.tolist()], axis=2)

    def _columns(self, at: _Unknowns) -> FloatArray:
        """(2 n_lines, n_columns) real parts above imaginary ones."""
        force = at.force(self.is_pair)
        with np.errstate(all="ignore"):  # what is no number is no candidate
            g, mirrored = _under_force(force, at.poles, self._seen)
            mirrored = mirrored * self.is_pair
            turned = 1j * (g - mirrored)[:, self.is_pair]
        both = np.hstack([g + mirrored, turned, np.ones((len(g), 1))])
        return np.concatenate([both.real, both.imag])

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

    def _slopes(self, point: _Point) -> FloatArray:
        """(n_outputs * 2 n_lines, n_unknowns) of the model, what shapes and feedthrough can do projected out."""
        dips = np.where(np.isfinite(point.unknowns.dips), np.abs(point.unknowns.dips), 0.0)
        n_first = point.unknowns.poles.size + dips.size
        sizes = STEP * np.r_[np.ones(n_first), np.tile(np.maximum(1.0, dips), 2)]
        moved: list[FloatArray] = []
        for k, size in enumerate(sizes):
            step = np.zeros(sizes.size)
            step[k] = size
            moved.append((self._columns(point.unknowns.moved(step, self.is_pair)) - point.columns) / size)
        self.known.clear()
        parts = []
        for w, span, c in zip(self.weights, point.spans, point.coefficients, strict=True):
            part = w[:, np.newaxis] * np.stack([one @ c for one in moved], axis=1)
            parts.append(part - span @ (span.T @ part))
        return np.nan_to_num(np.concatenate(parts), posinf=0.0, neginf=0.0)

    def path(self, best: _Point, most: int) -> list[_Point]:
        """The point and those after damped Gauss-Newton steps, as long as the squared error falls."""
        path, damping = [best], 1e-3
        for _ in range(most if np.isfinite(best.error) else 0):
            slopes = self._slopes(best)
            curvature, slope = slopes.T @ slopes, slopes.T @ best.left.ravel()
            diagonal = np.maximum(np.diag(curvature), TINY)
            trial = best
            while damping < MOST_DAMPING and not trial.error < best.error:
                step = np.linalg.lstsq(curvature + np.diag(damping * diagonal), slope, rcond=None)[0]
                trial = self.at(best.unknowns.moved(np.asarray(step, dtype=np.float64), self.is_pair))
                damping *= 4
            if trial.error > (1 - STANDS_STILL) * best.error:
                break
            path.append(trial)
            best, damping = trial, damping / 12
        return path
