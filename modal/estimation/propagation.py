"""First-order propagation of an observer's uncertainty to modes and Markov parameters, by a Jacobian through ERA.

Sums over long blocks keep what single rows do not show: residuals that carry over from row to row, noise whose size
changes along the record, and what a ridge leaves unexplained. With W = V V' + penalty and Theta its solution,

    T_b = W^-1 (V_b Y_b' - V_b V_b' Theta - n_b / n penalty Theta),   sum of T_b = 0

and the sum of T_b[r, i] T_b[s, j] over blocks estimates cov(Theta[r, i], Theta[s, j]) whatever the residuals are, as
long as blocks are long against their memory and that of the regressors (covariance clustered by blocks).

W, with the regressors V of the rows that were fitted, is factored once: the ridge estimate moves by W^-1 times what
moves its right side, and the data and not the ridge decide trace(W^-1 V V') of its unknowns.

How far each pair of blocks pulls the coefficients is a direction dTheta; the squares of what all directions do to a
number add up to its variance. A direction goes the way of the data: through the recursion of the Markov parameters,

    dh[k] = dalpha_k + sum_i dbeta_i h[k-i] + sum_i beta_i dh[k-i],

into the Hankel matrices. With H(0) = O R cut at the model's order (O' O = R R' = S), left and right eigenvectors W, V
of A (W V = 1), and the direction seen in modal coordinates, G(s) = W S^-1 O' dH(s) R' S^-1 V,

    d lambda_i = G(1)_ii - lambda_i G(0)_ii
    d c_i = E' dH(0) R' S^-1 v_i + sum over j != i of  c_j (G(1)_ji - lambda_i G(0)_ji) / (lambda_i - lambda_j)

c = C V, E the first block column of the identity. They are exact at Markov parameters of exactly the model's order;
what the singular vectors that were cut off add is of second order in the noise.

References:
    Hoerl, Kennard, "Ridge regression: biased estimation for nonorthogonal problems", Technometrics 12(1), 1970,
    equation 2.8, doi 10.1080/00401706.1970.10488634.
    Liang, Zeger, "Longitudinal data analysis using generalized linear models", Biometrika 73(1), 1986, 13-22, doi
    10.1093/biomet/73.1.13.
    Juang, Pappa, "Effects of noise on modal parameters identified by the eigensystem realization algorithm", Journal of
    Guidance, Control, and Dynamics 9(3), 1986, 294-303, doi 10.2514/3.20106.
    Longman, Lew, Juang, "Variance and bias confidence criteria for ERA modal parameter identification", AIAA/AAS
    Astrodynamics Conference, 1988, doi 10.2514/6.1988-4312.
"""

import functools
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from era.hankel import BlockHankelOperator
from era.realisation import Realisation
from modal.modes.modal_form import INSEPARABLE, discrete_poles
from modal.modes.mode import Mode, Uncertainty
from okid.arrays import ComplexArray, FloatArray, require
from okid.errors import InsufficientDataError, InvalidDataError
from okid.gram import LagGram, lag_gram
from okid.least_squares import cholesky, normal_equations, triangular_solve
from okid.markov import MarkovParameters, solve_recursion
from okid.observer import ObserverFit
from okid.record import Record
from okid.rows import as_records
from okid.scaling import ChannelScaling, channel_scaling

_EPS = float(np.finfo(np.float64).eps)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CoefficientCovariance:
    """Covariance of the coefficients of one equation for residuals of unit variance.

    Attributes:
        factor: (n_unknowns, n_unknowns) lower triangle L of W; None where W is singular to working precision.
        basis: (n_unknowns, n_kept) with W^+ = basis basis' where it is, None otherwise: directions without
            information were left out of the fit, and are left out here.
        penalty: (n_unknowns,) of the ridge.
    """

    factor: FloatArray | None
    basis: FloatArray | None
    penalty: FloatArray

    @property
    def effective_unknowns(self) -> float:
        """Trace of W^-1 V V', the unknowns that the data and not the ridge decide: their number without a ridge."""
        if self.factor is None:
            assert self.basis is not None
            return float(self.basis.shape[1] - np.square(np.sqrt(self.penalty)[:, np.newaxis] * self.basis).sum())
        n_unknowns = self.penalty.size
        if not (self.penalty > 0.0).any():
            return float(n_unknowns)
        shrunk = triangular_solve(self.factor, np.diag(np.sqrt(self.penalty)), transposed=False)
        return float(n_unknowns - np.square(shrunk).sum())

    def solve(self, right: FloatArray) -> FloatArray:
        """W^-1 right (W^+ where it is singular), (n_unknowns, n) to the same."""
        if self.factor is not None:
            half = triangular_solve(self.factor, right, transposed=False)
            return triangular_solve(self.factor, half, transposed=True)
        assert self.basis is not None
        solution: FloatArray = self.basis @ (self.basis.T @ right)
        return solution


def coefficient_covariance(gram: LagGram, ridge: float) -> CoefficientCovariance:
    """Covariance of the ridge estimate from these rows.

    Args:
        gram: Gram matrix of the rows that were fitted, of the observer's order.
        ridge: as in the fit.

    Example:
        >>> gram = LagGram(matrix=100.0 * np.eye(5), n_rows=100, order=1, n_inputs=1, n_outputs=1)
        >>> round(float(coefficient_covariance(gram, 0.0).solve(np.eye(4))[1, 1]), 12)  # variance of a mean of 100
        0.01
    """
    equations = normal_equations(gram, ridge)
    factor = cholesky(equations.matrix.copy(order="F"))
    if factor is not None:
        return CoefficientCovariance(factor=factor, basis=None, penalty=equations.penalty)
    values, vectors = scipy.linalg.eigh(equations.matrix, lower=True, check_finite=False, driver="evd")
    kept = values > 4.0 * values.size * _EPS * values[-1]
    return CoefficientCovariance(factor=None, basis=vectors[:, kept] / np.sqrt(values[kept]), penalty=equations.penalty)


FEWEST_BLOCKS = 20
"""Blocks from which on a standard deviation is known to 16 %."""


def block_grams(
    records: Sequence[Record], order: int, *, scaling: ChannelScaling, n_blocks: int
) -> tuple[LagGram, ...]:
    """Gram matrices of contiguous blocks of rows, about `n_blocks` in all; they add up to that of all rows.

    Args:
        records: of one system; each is cut into blocks of about the same length, at least one.
        order: observer order; the first rows of a block look back into the block before it.
        scaling: of the channels.
        n_blocks: over all records.

    Raises:
        InsufficientDataError: fewer than two blocks have a row without a gap.

    Example:
        >>> from okid.scaling import channel_scaling
        >>> record = Record(np.sin(np.arange(100.0)), np.cos(np.arange(100.0)), 0.1)
        >>> parts = block_grams([record], 4, scaling=channel_scaling([record]), n_blocks=20)
        >>> len(parts), sum(part.n_rows for part in parts)
        (20, 96)
    """
    total = sum(max(record.n_samples - order, 0) for record in records)
    parts = []
    for record in records:
        n_rows = record.n_samples - order
        if n_rows < 1:
            continue
        own = min(max(1, round(n_blocks * n_rows / total)), n_rows)
        edges = np.linspace(order, record.n_samples, own + 1).round().astype(int).tolist()
        for start, stop in itertools.pairwise(edges):
            part = lag_gram([record.samples(start - order, stop)], order, scaling=scaling)
            if part.n_rows:
                parts.append(part)
    if len(parts) < 2:
        raise InsufficientDataError(
            f"standard deviations need two blocks of rows that observer order {order} can be fitted to, but there are "
            f"{len(parts)}; use a lower order or a longer record."
        )
    return tuple(parts)


def block_deviations(parts: Sequence[LagGram], ridge: float) -> FloatArray:
    """T_b of neighbouring blocks in pairs, (T_b + T_(b+1)) / sqrt(2), scaled so that squares add up to the variance.

    A pair counts what its two blocks have in common, so it may be half as long as a block would have to be, at the
    price of a third of the degrees of freedom (see `pair_freedom`). What a fit to the same rows takes off is put back:
    the T_b sum to 0, and residuals are smaller than the noise (as in the correction HC1 of MacKinnon, White, Journal of
    Econometrics 29(3), 1985, doi 10.1016/0304-4076(85)90158-7).

    Args:
        parts: Gram matrices of the blocks in the order of the rows, of the observer's order.
        ridge: as in the fit.

    Returns:
        (n_blocks + 1, n_unknowns, n_outputs) for scaled channels; the first and the last block stand alone once.

    References:
        Newey, West, Econometrica 55(3), 1987, 703-708, doi 10.2307/1913610: weights 1 and 1/2 of blocks and neighbours.

    Example:
        >>> from okid.scaling import channel_scaling
        >>> rng = np.random.default_rng(0)
        >>> record = Record(rng.standard_normal(400), rng.standard_normal(400), 0.1)
        >>> parts = block_grams([record], 2, scaling=channel_scaling([record]), n_blocks=20)
        >>> bool(np.abs(block_deviations(parts, 1e-3).sum(axis=0)).max() < 1e-12)
        True
    """
    # one after the other: of many channels twenty Gram matrices side by side are gigabytes
    matrix = functools.reduce(np.add, (part.matrix for part in parts))
    whole = replace(parts[0], matrix=matrix, n_rows=sum(part.n_rows for part in parts))
    equations = normal_equations(whole, ridge)
    covariance = coefficient_covariance(whole, ridge)
    solution = covariance.solve(equations.right)
    pulls = []
    for part in parts:
        own = normal_equations(part, 0.0)
        penalty = equations.penalty[:, np.newaxis] * (part.n_rows / whole.n_rows)
        pulls.append(own.right - own.matrix @ solution - penalty * solution)
    n_unknowns, n_outputs = solution.shape
    moved = covariance.solve(np.concatenate(pulls, axis=1)).reshape(n_unknowns, len(parts), n_outputs)
    alone = np.zeros((len(parts) + 2, n_unknowns, n_outputs))
    alone[1:-1] = moved.transpose(1, 0, 2)
    spare = whole.n_rows / max(whole.n_rows - covariance.effective_unknowns, 1.0)
    scale = np.sqrt(0.5 * spare * len(parts) / max(len(parts) - 2, 1))
    deviations: FloatArray = scale * (alone[1:] + alone[:-1])
    return deviations


def pair_freedom(n_blocks: int) -> float:
    """Degrees of freedom of a variance from blocks in pairs: n_blocks over the sum of the squared weights, 1 + 2 / 4.

    Example:
        >>> pair_freedom(30)
        20.0
    """
    return max(n_blocks / 1.5, 1.0)


SAME_POLE = 1e-6
"""Distance of discrete poles up to which a mode is one of the realisation: the way through ln and exp only rounds."""


def propagated(
    records: Record | Sequence[Record],
    *,
    observer: ObserverFit,
    markov: MarkovParameters,
    realisation: Realisation,
    modes: Sequence[Mode],
) -> Uncertainty:
    """Standard deviations of modes and Markov parameters from the noise that the observer left over.

    Clustered by contiguous blocks of rows: right for residuals of any colour where a twentieth of the record is long
    against their memory and that of the modes; where it is not, the deviations are too large. They are known to 20 %.

    An interval lacks the bias: that of a short observer or of a ridge (both damp too much), of neighbours that the
    model order merges, and of a mode so weak that first order is not enough.

    Args:
        records: that the observer was fitted to.
        observer: fitted to all their rows.
        markov: recovered from it.
        realisation: cut from them (without inputs: from their gain), not refined afterwards.
        modes: of the realisation.

    Raises:
        InvalidDataError: records that the observer was not fitted to, a realisation without Hankel factors, or modes of
            another one.
        InsufficientDataError: fewer than two blocks have a row to fit.

    Example:
        >>> from okid.observer import fit_observer
        >>> from okid.markov import recover_markov
        >>> from era.balanced import realise
        >>> from modal.modes.extraction import extract_modes
        >>> rng = np.random.default_rng(1)
        >>> force, tip = rng.standard_normal(2000), np.zeros(2000)
        >>> for k in range(2, 2000):
        ...     tip[k] = 1.6 * tip[k - 1] - 0.9 * tip[k - 2] + force[k - 1] + 0.1 * rng.standard_normal()
        >>> record = Record(force, tip, 0.01)
        >>> observer = fit_observer(record, order=2)
        >>> markov = recover_markov(observer)
        >>> model = realise(markov, order=2)
        >>> modes = extract_modes(model).modes
        >>> known = propagated(record, observer=observer, markov=markov, realisation=model, modes=modes)
        >>> half_width = known.interval_factor(0.95) * known.frequency_std[0]
        >>> print(f"{modes[0].frequency:.2f} Hz +- {half_width:.2f} Hz")
        9.07 Hz +- 0.02 Hz
    """
    require(observer, ObserverFit, where="propagated", made_by="okid.fit_observer")
    require(markov, MarkovParameters, where="propagated", made_by="okid.recover_markov")
    require(realisation, Realisation, where="propagated", made_by="era.realise")
    several = as_records(records)
    parts = block_grams(several, observer.order, scaling=channel_scaling(several), n_blocks=FEWEST_BLOCKS)
    have = (parts[0].n_inputs, parts[0].n_outputs, sum(part.n_rows for part in parts))
    want = (observer.n_inputs, observer.n_outputs, observer.n_rows)
    if have != want:
        raise InvalidDataError(
            f"the records must be those of the observer fit, with (inputs, outputs, rows) {want}, but have {have}."
        )
    moved = _moved_markov(observer, markov, block_deviations(parts, observer.ridge))
    frequency, damping, shape, mass = _mode_deviations(realisation, modes, moved)
    scale = observer.output_scale[:, np.newaxis] / observer.input_scale
    return Uncertainty(
        method="propagation",
        frequency_std=frequency,
        damping_ratio_std=damping,
        shape_std=shape,
        mass_std=mass,
        markov_std=np.sqrt(np.square(moved[..., : observer.n_inputs]).sum(axis=0)) * scale
        if observer.n_inputs
        else np.zeros((markov.n_lags + 1, observer.n_outputs, 0)),
        degrees_of_freedom=pair_freedom(len(parts)),
    )


def _moved_markov(observer: ObserverFit, markov: MarkovParameters, deviations: FloatArray) -> FloatArray:
    """(n_directions, n_lags + 1, n_outputs, n_channels) dh of scaled channels; without inputs that of the gain.

    Args:
        observer: whose coefficients move.
        markov: recovered from it.
        deviations: (n_directions, n_unknowns, n_outputs) of the coefficients of scaled channels.
    """
    size, into = observer.output_scale, observer.input_scale
    n_directions, _, q = deviations.shape
    m, p, n_lags = observer.n_inputs, observer.order, markov.n_lags
    h = markov.system * into / size[:, np.newaxis] if m or markov.gain is None else markov.gain * size / size[:, None]
    past = deviations[:, 1 + m :].reshape(n_directions, p, m + q, q)
    forcing = np.zeros((n_lags + 1, h.shape[2], n_directions, q))
    if m:
        forcing[0] = deviations[:, 1 : 1 + m].transpose(1, 0, 2)
        forcing[1 : p + 1] = past[:, :n_lags, :m].transpose(1, 2, 0, 3)
    for i in range(1, min(p, n_lags) + 1):
        forcing[i:] += np.tensordot(h[: n_lags + 1 - i], past[:, i - 1, m:], axes=(1, 1))
    columns = np.ascontiguousarray(forcing.transpose(0, 3, 2, 1)).reshape(n_lags + 1, q, -1)
    moved = solve_recursion(observer.output_coefficients * size / size[:, np.newaxis], columns)
    return moved.reshape(n_lags + 1, q, n_directions, -1).transpose(2, 0, 1, 3)


def _mode_deviations(
    realisation: Realisation, modes: Sequence[Mode], moved: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray | None]:
    """Standard deviations of frequency [Hz], damping ratio and (n_modes, n_outputs) shape; nan where poles coincide.

    With inputs also (n_modes, n_outputs, n_inputs) of the modal mass, relative, for each driving point.
    """
    factors = realisation.factors
    if factors is None:
        raise InvalidDataError(
            "derivatives of modes need the Hankel factors that the realisation was cut from, but there are none; "
            "take the realisation of era.realise."
        )
    poles, right = (array.astype(np.complex128) for array in np.linalg.eig(realisation.A))
    left = np.linalg.pinv(right) if np.linalg.cond(right) > 1e14 else np.linalg.inv(right)
    which = _matched(tuple(modes), poles, realisation.dt)
    values = np.square(factors.observability).sum(axis=0)
    to_left, to_right = left @ (factors.observability / values).T, factors.controllability.T / values
    shapes, q = realisation.C @ right, realisation.n_outputs
    apart = poles - poles[:, np.newaxis]
    share = np.divide(1.0, apart, out=np.zeros_like(apart), where=apart != 0)
    place = np.abs(shapes).argmax(axis=0), np.arange(poles.size)
    relative = shapes / shapes[place]
    s = np.log(poles) / realisation.dt
    squares = np.zeros((2 + q, poles.size))
    m = realisation.n_inputs
    fed, masses = left @ factors.controllability[:, :m], np.zeros((q, poles.size, m))
    first_column = np.eye(factors.controllability.shape[1], m)
    for dh in moved:
        operator = BlockHankelOperator.of(dh, factors.n_block_rows + 1, factors.n_block_columns)
        answer = operator.times(to_right) @ right
        change = to_left @ answer[q:] - poles * (to_left @ answer[:-q])
        ds = change.diagonal() / (poles * realisation.dt)
        dc = shapes @ (change * share) + factors.output_scale[:, np.newaxis] * answer[:q]
        if m:  # ln mass = ln c_d - 2 ln c_largest - ln b, d the driving point
            db = to_left @ operator.times(first_column)[:-q] - (to_left @ answer[:-q] + change * share) @ fed
            with np.errstate(divide="ignore", invalid="ignore"):
                moving = dc / shapes - 2.0 * dc[place] / shapes[place]
                masses += np.square((moving[..., np.newaxis] - db / fed).real)
        dc = (dc - relative * dc[place]) / shapes[place]
        dc[place] = 0.0
        growth = (s.conj() * ds).real / np.abs(s)
        damping = (s.real * growth / np.abs(s) - ds.real) / np.abs(s)
        squares += np.vstack([(growth / (2 * np.pi)) ** 2, damping**2, np.abs(dc) ** 2])
    deviations = np.sqrt(squares)
    masses = np.sqrt(masses)
    deviations[:, np.linalg.norm(left, axis=1) * np.linalg.norm(right, axis=0) >= INSEPARABLE] = np.nan
    masses[:, np.isnan(deviations[0])] = np.nan
    mass = masses[:, which].transpose(1, 0, 2) if m else None
    return deviations[0, which], deviations[1, which], deviations[2:, which].T, mass


def _matched(modes: tuple[Mode, ...], poles: ComplexArray, dt: float) -> np.ndarray:
    """Index of each mode's pole."""
    if not modes:
        return np.empty(0, dtype=np.intp)
    wanted, _ = discrete_poles(modes, dt)
    distance = np.abs(wanted[:, np.newaxis] - poles)
    if poles.size == 0 or distance.min(axis=1).max() > SAME_POLE:
        raise InvalidDataError(
            f"all {len(modes)} modes must be poles of the realisation of order {poles.size}, but at least one is none "
            "of them; take those of modal.extract_modes."
        )
    return distance.argmin(axis=1)
