"""First-order propagation of an observer's uncertainty to modes and Markov parameters, by a Jacobian through ERA.

How far each pair of blocks of rows pulls the observer's coefficients (`okid.coefficient_covariance`) is a direction
dTheta; the squares of what all directions do to a number add up to its variance, whatever colour the residuals have. A
direction goes the way of the data: through the recursion of the Markov parameters,

    dh[k] = dalpha_k + sum_i dbeta_i h[k-i] + sum_i beta_i dh[k-i],

into the Hankel matrices. With H(0) = O R cut at the model's order (O' O = R R' = S), left and right eigenvectors W, V
of A (W V = 1), and the direction seen in modal coordinates, G(s) = W S^-1 O' dH(s) R' S^-1 V,

    d lambda_i = G(1)_ii - lambda_i G(0)_ii
    d c_i = E' dH(0) R' S^-1 v_i + sum over j != i of  c_j (G(1)_ji - lambda_i G(0)_ji) / (lambda_i - lambda_j)

c = C V, E the first block column of the identity. They are exact at Markov parameters of exactly the model's order;
what the singular vectors that were cut off add is of second order in the noise.

References:
    Juang, Pappa, "Effects of noise on modal parameters identified by the eigensystem realization algorithm", Journal of
    Guidance, Control, and Dynamics 9(3), 1986, 294-303, doi 10.2514/3.20106.
    Longman, Lew, Juang, "Variance and bias confidence criteria for ERA modal parameter identification", AIAA/AAS
    Astrodynamics Conference, 1988, doi 10.2514/6.1988-4312.
"""

from collections.abc import Sequence

import numpy as np

from era.hankel import BlockHankelOperator
from era.realisation import Realisation
from modal.modes.modal_form import INSEPARABLE, discrete_poles
from modal.modes.mode import Mode, Uncertainty
from okid.arrays import ComplexArray, FloatArray, require
from okid.coefficient_covariance import FEWEST_BLOCKS, block_deviations, block_grams, pair_freedom
from okid.errors import InvalidDataError
from okid.markov import MarkovParameters, solve_recursion
from okid.observer import ObserverFit
from okid.record import Record
from okid.rows import as_records
from okid.scaling import channel_scaling

__all__ = ["propagated"]

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
    frequency, damping, shape = _mode_deviations(realisation, modes, moved)
    scale = observer.output_scale[:, np.newaxis] / observer.input_scale
    return Uncertainty(
        method="propagation",
        frequency_std=frequency,
        damping_ratio_std=damping,
        shape_std=shape,
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
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Standard deviations of frequency [Hz], damping ratio and (n_modes, n_outputs) shape; nan where poles coincide."""
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
    for dh in moved:
        operator = BlockHankelOperator.of(dh, factors.n_block_rows + 1, factors.n_block_columns)
        answer = operator.times(to_right) @ right
        change = to_left @ answer[q:] - poles * (to_left @ answer[:-q])
        ds = change.diagonal() / (poles * realisation.dt)
        dc = shapes @ (change * share) + factors.output_scale[:, np.newaxis] * answer[:q]
        dc = (dc - relative * dc[place]) / shapes[place]
        dc[place] = 0.0
        growth = (s.conj() * ds).real / np.abs(s)
        damping = (s.real * growth / np.abs(s) - ds.real) / np.abs(s)
        squares += np.vstack([(growth / (2 * np.pi)) ** 2, damping**2, np.abs(dc) ** 2])
    deviations = np.sqrt(squares)
    deviations[:, np.linalg.norm(left, axis=1) * np.linalg.norm(right, axis=0) >= INSEPARABLE] = np.nan
    return deviations[0, which], deviations[1, which], deviations[2:, which].T


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
