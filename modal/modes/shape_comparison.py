"""Overlap: how much of a mode's own pulse response another mode repeats, in closed form.

The pulse response of a mode with residue R = c b' and discrete pole lambda is h_k = 2 Re(R lambda^k) for a pair and
R lambda^k for a real pole, k = 0 ... L - 1. With w = 2 for a pair and 1 for a real pole,

    <1, 2> = sum over k of trace(h1_k' h2_k)
           = w1 w2 / 2 Re[(c1' c2)(b1' b2) g(l1 l2) + (c1* c2)(b1* b2) g(conj(l1) l2)],   g(x) = (1 - x^L) / (1 - x)
    overlap = <1, 2> / max(<1, 1>, <2, 2>)

(' transpose, * conjugate transpose). It is 1 for the same mode only: frequency, damping, shape, participation and size
all count, without a tolerance for any of them, and the scaling of eigenvectors cancels. Channels are made comparable
by the scales of the records, so a change of unit changes nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
import numpy.typing as npt

from modal.modes.modal_form import discrete_poles
from modal.modes.mode import Mode
from okid.arrays import BoolArray, ComplexArray, FloatArray

__all__ = [
    "Pulses",
    "Repeatability",
    "energies",
    "inner_products",
    "overlap_matrix",
    "pair_greatest_first",
    "pulses",
    "repeatability",
]


IndexArray = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Pulses:
    """Pulse responses of modes in scaled channels.

    Attributes:
        poles: (n_modes,) discrete poles.
        is_pair: (n_modes,) True where the conjugate belongs to the mode.
        outputs: (n_outputs, n_modes) c.
        inputs: (n_modes, n_inputs) b; one column of ones for a model without inputs (free responses).
    """

    poles: ComplexArray
    is_pair: BoolArray
    outputs: ComplexArray
    inputs: ComplexArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Repeatability:
    """How well modes are found again in other runs.

    Attributes:
        mean: (n_modes,) mean of `parts` over the runs, nan when there are none.
        parts: (n_runs, n_modes) overlap of each mode with its continuation in each run, 0 where it has none.
        continuation: (n_runs, n_modes) index of that mode in its run, -1 where it has none.
    """

    mean: FloatArray
    parts: FloatArray
    continuation: IndexArray


def pulses(
    modes: Sequence[Mode], *, dt: float, output_scale: FloatArray | None = None, input_scale: FloatArray | None = None
) -> Pulses:
    """Pulse responses of modes, outputs divided by `output_scale` and inputs by `input_scale` (ones unless given)."""
    modes = tuple(modes)
    poles, is_pair = discrete_poles(modes, dt)
    n_outputs, n_inputs = (modes[0].shape.size, modes[0].participation.size) if modes else (0, 0)
    outputs = np.array([mode.shape for mode in modes], dtype=np.complex128).reshape(len(modes), n_outputs).T
    inputs = np.array([mode.participation for mode in modes], dtype=np.complex128).reshape(len(modes), n_inputs)
    if modes and output_scale is not None:
        outputs = outputs / output_scale[:, np.newaxis]
    if modes and input_scale is not None and n_inputs:
        inputs = inputs * input_scale
    if n_inputs == 0:
        inputs = np.ones((len(modes), 1), dtype=np.complex128)
    return Pulses(poles=poles, is_pair=is_pair, outputs=outputs, inputs=inputs)


def overlap_matrix(first: Pulses, second: Pulses, *, n_steps: int) -> FloatArray:
    """Overlap of every mode of one set with every mode of another.

    Args:
        first: n_first modes.
        second: n_second modes, same channels and time step.
        n_steps: L, length of the pulse responses in samples (Hankel block rows + columns).

    Returns:
        (n_first, n_second) in [0, 1]: negative overlaps (opposite signs) count 0, and so does an unstable mode whose
        pulse response is too large for a float.

    Example:
        >>> mode = Mode(pole=-1 + 9j, kind="oscillatory", frequency=1.4, damping_ratio=0.1,
        ...             shape=np.ones(2), participation=np.ones(1))
        >>> same = pulses([mode], dt=0.01)
        >>> overlap_matrix(same, same, n_steps=100).round(12).tolist()
        [[1.0]]
    """
    if first.poles.size == 0 or second.poles.size == 0:
        return np.zeros((first.poles.size, second.poles.size))
    with np.errstate(over="ignore", invalid="ignore"):
        inner = inner_products(first, second, n_steps=n_steps)
        largest = np.maximum(energies(first, n_steps=n_steps)[:, np.newaxis], energies(second, n_steps=n_steps))
        share = np.divide(inner, largest, out=np.zeros_like(inner), where=largest > 0)
    return cast("FloatArray", np.clip(np.nan_to_num(share, nan=0.0), 0.0, 1.0))


def inner_products(first: Pulses, second: Pulses, *, n_steps: int) -> FloatArray:
    """(n_first, n_second) sums over k and channels of the products of two modes' pulse responses, see the module."""
    weight = np.where(first.is_pair, 2.0, 1.0)[:, np.newaxis] * np.where(second.is_pair, 2.0, 1.0) / 2
    with np.errstate(over="ignore", invalid="ignore"):
        plain = (first.outputs.T @ second.outputs) * (first.inputs @ second.inputs.T)
        turned = (first.outputs.conj().T @ second.outputs) * (first.inputs.conj() @ second.inputs.T)
        plain = plain * _geometric(first.poles[:, np.newaxis] * second.poles, n_steps)
        turned = turned * _geometric(first.poles.conj()[:, np.newaxis] * second.poles, n_steps)
        products: FloatArray = weight * (plain + turned).real
        return products


def energies(modes: Pulses, *, n_steps: int) -> FloatArray:
    """(n_modes,) sum of squares of each mode's pulse response in scaled channels."""
    weight = np.where(modes.is_pair, 2.0, 1.0) ** 2 / 2
    with np.errstate(over="ignore", invalid="ignore"):
        plain = (modes.outputs**2).sum(axis=0) * (modes.inputs**2).sum(axis=1)
        turned = (np.abs(modes.outputs) ** 2).sum(axis=0) * (np.abs(modes.inputs) ** 2).sum(axis=1)
        plain = plain * _geometric(modes.poles**2, n_steps)
        turned = turned * _geometric(modes.poles.conj() * modes.poles, n_steps)
        products: FloatArray = weight * (plain + turned).real
        return products


def _geometric(ratio: ComplexArray, n_steps: int) -> ComplexArray:
    # 1 + x + ... + x^(L-1) = expm1(L log x) / (x - 1); written out so that neither x near 1 nor x = 0 loses digits.
    step = ratio - 1
    near_one = np.abs(step) < 0.5
    with np.errstate(divide="ignore"):
        growth = np.where(
            near_one, 0.5 * np.log1p(np.where(near_one, 2 * step.real + np.abs(step) ** 2, 0.0)), np.log(np.abs(ratio))
        )
    growth, angle = n_steps * growth, n_steps * np.angle(ratio)
    power = np.expm1(growth) * np.cos(angle) - 2 * np.sin(angle / 2) ** 2 + 1j * np.exp(growth) * np.sin(angle)
    alone = np.abs(step) < 1e-12
    return cast("ComplexArray", np.where(alone, n_steps + 0j, power / np.where(alone, 1.0, step)))


def pair_greatest_first(overlaps: FloatArray) -> IndexArray:
    """One-to-one pairing of rows with columns, the greatest overlap first; zeros are not paired.

    Returns:
        (n_rows,) column of each row, -1 where it has none.

    Example:
        >>> pair_greatest_first(np.array([[0.9, 0.8], [0.95, 0.1], [0.0, 0.0]])).tolist()
        [1, 0, -1]
    """
    n_rows, n_columns = overlaps.shape
    partner = np.full(n_rows, -1, dtype=np.intp)
    candidates = np.flatnonzero(overlaps > 0)
    taken: set[int] = set()
    for flat in candidates[np.argsort(-overlaps.ravel()[candidates], kind="stable")].tolist():
        row, column = divmod(flat, n_columns)
        if partner[row] < 0 and column not in taken:
            partner[row] = column
            taken.add(column)
            if len(taken) == min(n_rows, n_columns):
                break
    return partner


def repeatability(reference: Pulses, reruns: Sequence[Pulses], *, n_steps: int) -> Repeatability:
    """Overlap of each mode with its continuation in other runs, paired one to one, greatest first.

    Args:
        reference: the modes in question.
        reruns: the modes found again after a small change of the data, the observer or the model order.
        n_steps: length of the pulse responses in samples.
    """
    n_modes = reference.poles.size
    parts = np.zeros((len(reruns), n_modes))
    continuation = np.full((len(reruns), n_modes), -1, dtype=np.intp)
    for run, again in enumerate(reruns):
        overlaps = overlap_matrix(reference, again, n_steps=n_steps)
        partner = pair_greatest_first(overlaps)
        found = np.flatnonzero(partner >= 0)
        continuation[run] = partner
        parts[run, found] = overlaps[found, partner[found]]
    mean = parts.mean(axis=0) if len(reruns) else np.full(n_modes, np.nan)
    return Repeatability(mean=mean, parts=parts, continuation=continuation)
