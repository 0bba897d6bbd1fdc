"""The exact linear flow over one step, for whatever drives it in a straight line over the step.

    x[k+1] = Ad x[k] + B0 u_start + B1 u_end + E0 w[k] + E1 w[k+1]

Ad = exp(A dt), and with P1 = int_0^dt exp(A s) ds and P2 = 1/dt int_0^dt exp(A (dt - s)) s ds: B0 = (P1 - P2) B,
B1 = P2 B, likewise E. All three come from one exponential (Van Loan 1978, https://doi.org/10.1109/TAC.1978.1101743).
"""

from dataclasses import dataclass

import numpy as np
import scipy

from modal.simulation.plant import Plant, PlantMatrices, plant_matrices
from modal.simulation.tolerances import DIFFERENCE_STEP
from okid.arrays import FloatArray

__all__ = ["Scheme", "scheme_and_slopes"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Scheme:
    """Matrices of one step, or (from `scheme_and_slopes`) their derivatives by a linear parameter.

    Attributes:
        Ad: (n, n).
        B0: (n, n_inputs) for the input at the start of the step.
        B1: (n, n_inputs) for the input at its end.
        E0: (n, n_forces) for the force at the start.
        E1: (n, n_forces) for the force at the end.
        C: (n_outputs, n).
        D: (n_outputs, n_inputs).
        G: (n_outputs, n_forces).
    """

    Ad: FloatArray
    B0: FloatArray
    B1: FloatArray
    E0: FloatArray
    E1: FloatArray
    C: FloatArray
    D: FloatArray
    G: FloatArray


def scheme_and_slopes(plant: Plant, linear: FloatArray, dt: float) -> tuple[Scheme, tuple[Scheme, ...]]:
    """The scheme at `linear`, and its derivative by each linear parameter.

    Args:
        plant: The plant.
        linear: (n_parameters,) values of the linear parameters.
        dt: Step [s].

    Returns:
        The scheme and one derivative a parameter.
    """
    steps = [DIFFERENCE_STEP * max(parameter.deviation, abs(parameter.nominal)) for parameter in plant.parameters]
    points = [linear]
    for j, step in enumerate(steps):
        for sign in (1.0, -1.0):
            point = linear.copy()
            point[j] += sign * step
            points.append(point)
    matrices = [plant_matrices(plant, point) for point in points]
    flows = _flows(np.stack([item.A for item in matrices]), dt)
    schemes = [_scheme(item, *flow) for item, flow in zip(matrices, zip(*flows, strict=True), strict=True)]
    slopes = tuple(_slope(schemes[2 * j + 1], schemes[2 * j + 2], 2.0 * step) for j, step in enumerate(steps))
    return schemes[0], slopes


def _flows(A: FloatArray, dt: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    n_points, n, _ = A.shape
    block = np.zeros((n_points, 3 * n, 3 * n))
    block[:, :n, :n] = A * dt
    block[:, :n, n : 2 * n] = np.eye(n) * dt
    block[:, n : 2 * n, 2 * n :] = np.eye(n)
    whole = scipy.linalg.expm(block) if n else block
    return whole[:, :n, :n], whole[:, :n, n : 2 * n], whole[:, :n, 2 * n :]


def _scheme(matrices: PlantMatrices, Ad: FloatArray, P1: FloatArray, P2: FloatArray) -> Scheme:
    return Scheme(
        Ad=Ad,
        B0=(P1 - P2) @ matrices.B,
        B1=P2 @ matrices.B,
        E0=(P1 - P2) @ matrices.E,
        E1=P2 @ matrices.E,
        C=matrices.C,
        D=matrices.D,
        G=matrices.G,
    )


def _slope(above: Scheme, below: Scheme, width: float) -> Scheme:
    return Scheme(
        Ad=(above.Ad - below.Ad) / width,
        B0=(above.B0 - below.B0) / width,
        B1=(above.B1 - below.B1) / width,
        E0=(above.E0 - below.E0) / width,
        E1=(above.E1 - below.E1) / width,
        C=(above.C - below.C) / width,
        D=(above.D - below.D) / width,
        G=(above.G - below.G) / width,
    )
