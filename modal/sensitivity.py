"""First derivatives of poles and shapes with respect to Markov parameters, through ERA.

With H(0) = O R cut at the model's order (O' O = R R' = S), left and right eigenvectors w, v of A (w v = 1),

    wt = w S^-1 O',  vt = R' S^-1 v:
    d lambda = wt (dH(1) - lambda dH(0)) vt
    d c = E' dH(0) vt + sum over the other poles m of  c_m  wt_m (dH(1) - lambda dH(0)) vt / (lambda - lambda_m)

c = C psi, E the first block column of the identity. They are exact at Markov parameters of exactly the model's order;
what the singular vectors that were cut off add is of second order in the noise.

Every such number is a sum  left' dH right  over one Hankel matrix with one block row more, so it is kept as a left and
a right sequence of blocks:  sum over i, j of  left[i]' dh[1 + i + j] right[j].

References:
    Juang, Pappa, "Effects of noise on modal parameters identified by the eigensystem realization algorithm", Journal of
    Guidance, Control, and Dynamics 9(3), 1986, 294-303, doi 10.2514/3.20106.
    Longman, Lew, Juang, "Variance and bias confidence criteria for ERA modal parameter identification", AIAA/AAS
    Astrodynamics Conference, 1988, doi 10.2514/6.1988-4312.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from era.realisation import Realisation
from modal.basis import INSEPARABLE, discrete_poles, largest_component
from modal.mode import Mode
from okid.arrays import BoolArray, ComplexArray
from okid.errors import InvalidDataError

__all__ = ["ModeSensitivities", "mode_sensitivities"]

SAME_POLE = 1e-6
"""Distance of discrete poles up to which a mode is one of the realisation: the way through ln and exp only rounds."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ModeSensitivities:
    """Left and right sequences of the modes, for Markov parameters of scaled channels.

    Attributes:
        poles: (n_modes,) discrete poles lambda.
        left: (n_modes, 1 + n_outputs, n_block_rows + 1, n_outputs): first those of d lambda, then those of each
            component of the shape (in output units, the largest component kept at 1).
        right: (n_modes, n_block_columns, n_channels), one for all numbers of a mode.
        separable: (n_modes,) False where a pole coincides with another one: its derivatives do not exist.
    """

    poles: ComplexArray
    left: ComplexArray
    right: ComplexArray
    separable: BoolArray


def mode_sensitivities(realisation: Realisation, modes: Sequence[Mode]) -> ModeSensitivities:
    """Derivatives of the poles and shapes of these modes.

    Args:
        realisation: with the Hankel factors that it was cut from.
        modes: of this realisation.

    Raises:
        InvalidDataError: no Hankel factors, or a mode of another realisation.
    """
    factors = realisation.factors
    if factors is None:
        raise InvalidDataError(
            "derivatives of modes need the Hankel factors that the realisation was cut from, but there are none; "
            "take the realisation of era.realise."
        )
    poles, vectors = (array.astype(np.complex128) for array in np.linalg.eig(realisation.A))
    rows = np.linalg.pinv(vectors) if np.linalg.cond(vectors) > 1e14 else np.linalg.inv(vectors)
    which = _matched(tuple(modes), poles, realisation.dt)
    values = np.square(factors.observability).sum(axis=0)
    q = factors.output_scale.size
    outer_left = (rows @ (factors.observability / values).T).reshape(poles.size, -1, q)
    outer_right = ((factors.controllability.T / values) @ vectors).T.reshape(poles.size, factors.n_block_columns, -1)
    shapes = realisation.C @ vectors
    left = np.zeros((which.size, 1 + q, factors.n_block_rows + 1, q), dtype=np.complex128)
    for row, i in enumerate(which):
        left[row] = _left_sequences(i, poles, outer_left, shapes, np.diag(factors.output_scale))
    condition = np.linalg.norm(rows, axis=1) * np.linalg.norm(vectors, axis=0)
    return ModeSensitivities(
        poles=poles[which], left=left, right=outer_right[which], separable=condition[which] < INSEPARABLE
    )


def _left_sequences(
    index: int, poles: ComplexArray, outer_left: ComplexArray, shapes: ComplexArray, output_scale: np.ndarray
) -> ComplexArray:
    """(1 + n_outputs, n_block_rows + 1, n_outputs) left sequences of the pole and of each component of its shape."""
    pole, shape = poles[index], shapes[:, index]
    apart = pole - poles
    share = np.divide(1.0, apart, out=np.zeros_like(apart), where=apart != 0)
    turned = np.tensordot(shapes * share, outer_left, axes=1)
    direct = output_scale.astype(np.complex128)
    # a shape is c / c_J: its derivative is that of c, less what it does to the largest component
    largest = int(np.abs(shape).argmax())
    size = largest_component(shape[:, np.newaxis])[0]
    relative = shape / size
    turned = (turned - relative[:, np.newaxis, np.newaxis] * turned[largest]) / size
    direct = (direct - relative[:, np.newaxis] * direct[largest]) / size
    of_first = np.concatenate([outer_left[index][np.newaxis], turned])
    left = np.zeros((of_first.shape[0], of_first.shape[1] + 1, of_first.shape[2]), dtype=np.complex128)
    left[:, 1:] = of_first
    left[:, :-1] -= pole * of_first
    left[1:, 0] += direct
    left[1 + largest] = 0.0  # 1 by definition; rounding left a few parts in 1e16
    return left


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
