"""Modal coordinates of a realisation: its poles, one of each conjugate pair, with their eigenvectors on both sides.

    A Psi = Psi diag(lambda),   system[k] = sum over poles of (C psi) (row of Psi^-1 B) lambda^(k-1)

Everything that `modal` says about a mode starts from these arrays: shapes, participation, indicators, overlaps.
"""

from dataclasses import dataclass
from typing import cast

import numpy as np

from era.realisation import Realisation
from modal.modes.mode import Mode, ModeKind
from okid.arrays import BoolArray, ComplexArray, FloatArray

DEADBEAT = 1e-3
"""A discrete pole this small against the largest (or against 1) dies by 60 dB within one sample: delay or deadbeat."""

UNSTABLE = 1e-8
"""Rounding allowed in |lambda| > 1: a growth of 1 % over a million samples."""

INSEPARABLE = 1e6
"""Condition number of an eigenvalue above which its eigenvectors cannot be told from those of a coinciding pole."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ModalBasis:
    """Poles of one realisation in modal coordinates; deadbeat poles are left out.

    Attributes:
        poles: (n_poles,) discrete poles lambda, imaginary part >= 0.
        is_pair: (n_poles,) True where the conjugate is a pole too.
        right: (order, n_poles) eigenvectors psi.
        left: (n_poles, order) the rows of Psi^-1 that go with them.
        outputs: (n_outputs, n_poles) C psi in output units.
        inputs: (n_poles, n_inputs) left B in 1 / input units; with no inputs the rows of left K, (n_poles, n_outputs).
        separable: (n_poles,) False where a pole coincides with another one and the two share an eigenvector, so that
            shape and participation of either have no meaning of their own.
    """

    poles: ComplexArray
    is_pair: BoolArray
    right: ComplexArray
    left: ComplexArray
    outputs: ComplexArray
    inputs: ComplexArray
    separable: BoolArray


def modal_basis(realisation: Realisation) -> ModalBasis:
    """Eigen-decomposition of a realisation, deadbeat poles left out.

    A pole is deadbeat when |lambda| <= 1e-3 max(1, largest |lambda|). Defective (repeated) poles do not fail: their
    left vectors are then those of the pseudo-inverse, and `separable` is False for them.

    Example:
        >>> model = Realisation(np.diag([0.5, 0.0]), np.ones((2, 1)), np.ones((1, 2)), np.zeros((1, 1)), 0.1)
        >>> modal_basis(model).poles.real.tolist()
        [0.5]
    """
    poles, vectors = (array.astype(np.complex128) for array in np.linalg.eig(realisation.A))
    rows = _inverse(vectors)
    size = np.abs(poles)
    kept = (poles.imag >= 0) & (size > DEADBEAT * max(1.0, size.max(initial=0.0)))
    poles, right, left = poles[kept], vectors[:, kept], rows[kept]
    poles = np.where(poles.imag == 0, poles.real + 0j, poles)
    condition = np.linalg.norm(left, axis=1) * np.linalg.norm(right, axis=0)
    drive = realisation.K if realisation.B.shape[1] == 0 and realisation.K is not None else realisation.B
    return ModalBasis(
        poles=poles,
        is_pair=cast("BoolArray", poles.imag > 0),
        right=right,
        left=left,
        outputs=realisation.C @ right,
        inputs=left @ drive,
        separable=cast("BoolArray", condition < INSEPARABLE),
    )


def _inverse(vectors: ComplexArray) -> ComplexArray:
    try:
        inverse = np.linalg.inv(vectors)
    except np.linalg.LinAlgError:
        inverse = np.full_like(vectors, np.nan)
    return cast("ComplexArray", inverse if np.isfinite(inverse).all() else np.linalg.pinv(vectors))


def continuous_poles(poles: ComplexArray, dt: float) -> ComplexArray:
    """Continuous poles s = ln(lambda) / dt [1/s], principal branch."""
    return cast("ComplexArray", np.log(poles) / dt)


def discrete_poles(modes: tuple[Mode, ...], dt: float) -> tuple[ComplexArray, BoolArray]:
    """Discrete poles exp(s dt) of modes, and which of them stand for a conjugate pair.

    A continuous pole on the real axis, or at the Nyquist frequency exactly, has a real discrete pole.
    """
    angles = np.array([mode.pole.imag for mode in modes]) * dt
    growth = np.exp(np.array([mode.pole.real for mode in modes]) * dt)
    is_nyquist = angles > np.pi * (1 - 1e-12)
    is_pair = (angles > 0) & ~is_nyquist
    poles = np.where(is_pair, growth * np.exp(1j * angles), np.where(is_nyquist, -growth, growth) + 0j)
    return poles, is_pair


def kind_of(pole: complex) -> ModeKind:
    """What a discrete pole is: unstable first, then on the negative or positive real axis, else oscillatory.

    Example:
        >>> [kind_of(pole) for pole in (0.9 + 0.1j, 0.9, -0.9, 1.1)]
        ['oscillatory', 'real', 'nyquist', 'unstable']
    """
    if abs(pole) > 1 + UNSTABLE:
        return "unstable"
    if complex(pole).imag != 0:
        return "oscillatory"
    return "real" if complex(pole).real > 0 else "nyquist"


def largest_component(shapes: ComplexArray) -> ComplexArray:
    """(n_poles,) the component of largest size of each column; 1 where a column is all zero.

    Args:
        shapes: (n_outputs, n_poles).
    """
    if shapes.shape[1] == 0:
        return np.ones(0, dtype=np.complex128)
    component = np.take_along_axis(shapes, np.abs(shapes).argmax(axis=0)[np.newaxis], axis=0)[0]
    return np.where(component == 0, 1.0 + 0j, component)


def norms(vectors: ComplexArray, axis: int) -> FloatArray:
    """Euclidean norms along an axis, 1 where it is empty (a model without inputs)."""
    if vectors.shape[axis] == 0:
        return np.ones(vectors.shape[1 - axis])
    return cast("FloatArray", np.linalg.norm(vectors, axis=axis))
