"""The models of the struck mass, each a few lines of linear algebra on one pulse response; the story: `struck_mass`."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from okid.arrays import FloatArray, frozen
from okid.errors import InsufficientDataError

__all__ = [
    "LinearModel",
    "SingularValueShares",
    "frequency_and_damping",
    "full_order_model",
    "hankel",
    "reduced_model",
    "sampled_pulse",
    "singular_value_shares",
    "step_response",
    "truncated_model",
]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LinearModel:
    """x(k+1) = A x(k) + B u(k), y(k) = C x(k) + D u(k), with one input and one output.

    Attributes:
        A: (order, order).
        B: (order,).
        C: (order,).
        D: feedthrough.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: float

    def __post_init__(self) -> None:
        for name in ("A", "B", "C"):
            object.__setattr__(self, name, frozen(getattr(self, name), name=name))

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self.A)


def sampled_pulse(model: LinearModel, n_samples: int) -> FloatArray:
    """(n_samples,) answer to a push of one unit for one tick: D, C B, C A B, ...

    Args:
        model: any linear model.
        n_samples: how many, the one at the tick of the push included.
    """
    response, state = np.empty(n_samples), model.B
    response[0] = model.D
    for k in range(1, n_samples):
        response[k] = model.C @ state
        state = model.A @ state
    return response


def step_response(model: LinearModel, n_samples: int) -> FloatArray:
    """(n_samples,) answer to a push that stays: the running sum of the pulse response.

    Args:
        model: any linear model.
        n_samples: how many, the one at the tick of the first push included.
    """
    return np.asarray(np.cumsum(sampled_pulse(model, n_samples)))


def hankel(samples: FloatArray, first: int) -> FloatArray:
    """H(first), entry (i, j) = samples[first + i + j], square, as large as 2N + 1 samples allow for first = 1 and 2.

    Args:
        samples: (2N + 1,) pulse response from the tick of the push on.
        first: sample in the upper left corner.

    Raises:
        InsufficientDataError: fewer than five samples.

    Example:
        >>> hankel(np.arange(5.0), 1)
        array([[1., 2.], [2., 3.]])
    """
    size = (len(samples) - 1) // 2
    if size < 2:
        raise InsufficientDataError(
            f"a Hankel matrix needs 5 samples or more, but there are {len(samples)}; record more."
        )
    entries: FloatArray = samples[first + np.add.outer(np.arange(size), np.arange(size))]
    return entries


def full_order_model(samples: FloatArray) -> LinearModel:
    """A = H(2) H(1)^-1, B = H(1) e1, C = e1': repeats every sample that it was made from, noise and all.

    Args:
        samples: (2N + 1,) pulse response from the tick of the push on.
    """
    first, second = hankel(samples, 1), hankel(samples, 2)
    A = np.linalg.solve(first.T, second.T).T.astype(np.float64)
    return LinearModel(A=A, B=first[:, 0], C=np.eye(len(first))[0], D=float(samples[0]))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SingularValueShares:
    """The Pareto plot of the Hankel matrix, by three measures.

    Attributes:
        singular_values: (N,) of H(1), falling.
        sum_share: (N,) share that the first 1, 2, ... N have in the sum of all; an artefact of N.
        energy_share: (N,) the same of their squares.
        gap: (N - 1,) ratio of each to the next one; the order is where it is largest.
    """

    singular_values: FloatArray
    sum_share: FloatArray
    energy_share: FloatArray
    gap: FloatArray

    def __post_init__(self) -> None:
        for name in ("singular_values", "sum_share", "energy_share", "gap"):
            object.__setattr__(self, name, frozen(getattr(self, name), name=name))

    @property
    def order(self) -> int:
        """Where the gap is largest."""
        return int(np.argmax(self.gap)) + 1


def singular_value_shares(samples: FloatArray) -> SingularValueShares:
    """How much the first n directions of the Hankel matrix carry, for every n.

    Args:
        samples: (2N + 1,) pulse response from the tick of the push on.
    """
    values = np.linalg.svd(hankel(samples, 1), compute_uv=False).astype(np.float64)
    floor = np.maximum(values, np.finfo(float).eps * values[0])  # exact data: the gap is taken to rounding
    return SingularValueShares(
        singular_values=values,
        sum_share=np.cumsum(values) / values.sum(),
        energy_share=np.cumsum(values**2) / (values**2).sum(),
        gap=floor[:-1] / floor[1:],
    )


def truncated_model(samples: FloatArray, order: int, *, projector: Literal["left", "none"] = "left") -> LinearModel:
    """N states, but a Hankel matrix of which only `order` directions are kept: A = U U' H(2) Hr^+, B = Hr e1, C = e1'.

    Args:
        samples: (2N + 1,) pulse response from the tick of the push on.
        order: directions kept.
        projector: "left" carries U U' in A and equals the reduced model exactly; "none" leaves it out, to show that
            it is needed.
    """
    U, values, Vt = np.linalg.svd(hankel(samples, 1))
    U, values, Vt = U[:, :order], values[:order], Vt[:order]
    A = hankel(samples, 2) @ (Vt.T / values) @ U.T
    if projector == "left":
        A = U @ (U.T @ A)
    return LinearModel(A=A, B=(U * values) @ Vt[:, 0], C=np.eye(len(A))[0], D=float(samples[0]))


def reduced_model(samples: FloatArray, order: int) -> LinearModel:
    """ERA: A = S^-1/2 U' H(2) V S^-1/2, B = S^1/2 V' e1, C = e1' U S^1/2, with `order` states.

    Args:
        samples: (2N + 1,) pulse response from the tick of the push on.
        order: states kept.
    """
    U, values, Vt = np.linalg.svd(hankel(samples, 1))
    root = np.sqrt(values[:order])
    U, Vt = U[:, :order], Vt[:order]
    A = (U / root).T @ hankel(samples, 2) @ (Vt.T / root)
    return LinearModel(A=A, B=root * Vt[:, 0], C=U[0] * root, D=float(samples[0]))


def frequency_and_damping(model: LinearModel, dt: float) -> tuple[float, float]:
    """Frequency [Hz] and damping ratio of a model with one oscillating mode, from its poles s = ln(lambda) / dt.

    Args:
        model: with two states.
        dt: time between samples [s].

    Example:
        >>> A = np.array([[0.0, -0.25], [1.0, 0.0]])  # halves the state with every quarter turn
        >>> turn = LinearModel(A=A, B=np.array([1.0, 0.0]), C=np.array([1.0, 0.0]), D=0.0)
        >>> frequency, damping_ratio = frequency_and_damping(turn, dt=1.0)
        >>> f"{frequency:.4f} Hz, {damping_ratio:.3f}"
        '0.2733 Hz, 0.404'
    """
    discrete = np.linalg.eigvals(model.A).astype(complex)
    pole = np.log(discrete[np.argmax(discrete.imag)]) / dt
    return float(abs(pole) / (2 * np.pi)), float(-pole.real / abs(pole))
