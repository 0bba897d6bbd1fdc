"""The points of a stabilisation diagram: poles of every model order, from one singular value decomposition.

Two questions are asked of each pole. Does it continue a pole of the order below (`overlap`)? That one needs no more
than the decomposition, and poles of a long observer answer it too well: all orders see the same data. Is it found
again from halves of the data and with another observer (`repeatability`)? That one needs the reruns of
`modal.verdict.repeatability`, which are there anyway for the verdict. Both are closed-form overlaps of pulse responses
(`modal.modes.shape_comparison`), paired one to one within an order.

A lower order is a corner of the highest one, so an order costs one eigenvalue decomposition of a small matrix. All
poles of all orders then stand in one modal basis, their vectors filled up with zeros to the highest order, and what
is asked of them (EMAC, energies, overlaps with a rerun) is asked in one product.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from era.realisation import Realisation
from modal.modes.extraction import extended_amplitude_coherence
from modal.modes.modal_form import ModalBasis, continuous_poles, largest_component, modal_basis
from modal.modes.shape_comparison import Pulses, energies, inner_products, pair_greatest_first, pulses
from modal.verdict.judgement import Change, Reruns
from okid.arrays import FloatArray, whole_number
from okid.display import Displayed

ASKED: tuple[Change, ...] = ("data", "observer")
"""Changes that the diagram's colour asks about, each with equal weight. The third one of the verdict, other model
orders, is the diagram's own vertical axis."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class StabilisationPoint(Displayed):
    """One pole of the model of one order, compared with the model of the next lower order.

    Attributes:
        order: model order.
        frequency: [Hz].
        damping_ratio: [-].
        overlap: closed-form overlap, in [0, 1], of its own pulse response with that of the pole it continues (0: new).
        emac: extended modal amplitude coherence.
        repeatability: mean overlap, in [0, 1], with its continuation in models of halves of the data and of another
            observer; nan where unknown.
    """

    order: int
    frequency: float
    damping_ratio: float
    overlap: float
    emac: float
    repeatability: float = math.nan


def stabilisation(
    realisation: Realisation, *, orders: Sequence[int] | None = None, reruns: Reruns | None = None
) -> tuple[StabilisationPoint, ...]:
    """Poles of the models of all orders, one of each conjugate pair, by rising order and frequency.

    A pole that belongs to the system stands at the same place in model after model (overlap near 1) and is found again
    when the data or the observer change (repeatability near 1). Poles of every kind are given but deadbeat ones; a
    growing pole has a negative damping ratio, and a pole on the real axis a damping ratio of 1 (or, at half the
    sampling frequency, a frequency of at least that).

    The reruns have the chosen model order: a weak mode that appears only at higher orders than theirs has little to be
    found again in, so a low repeatability there is no proof against it.

    Args:
        realisation: of the highest order, balanced: the lower ones are its corners.
        orders: to be shown; all from 1 to that of the realisation by default. A realisation without Hankel factors is
            not balanced and has but its own.
        reruns: from `modal.verdict.repeatability.repeat`; those that changed data or observer are asked. Without them
            repeatability is nan.

    Returns:
        One point a pole; EMAC is nan for a realisation without Hankel factors.

    Raises:
        InvalidDataError: an order above that of the realisation, or a lower one of a realisation that is not balanced.

    Example:
        >>> from era.balanced import realise
        >>> from okid.markov import MarkovParameters
        >>> lag = np.arange(1.0, 60.0)
        >>> pulse = 0.95**lag * np.cos(0.5 * lag) + 0.01 * np.random.default_rng(0).standard_normal(lag.size)
        >>> markov = MarkovParameters(system=np.r_[0.0, pulse].reshape(-1, 1, 1), dt=0.1)
        >>> points = stabilisation(realise(markov, order=4))
        >>> [(point.order, round(point.frequency, 2)) for point in points if point.overlap > 0.9]
        [(3, 0.8), (4, 0.8)]
    """
    if orders is None:
        orders = [realisation.order] if realisation.factors is None else range(1, realisation.order + 1)
    shown = sorted({whole_number(order, name="an order of the diagram", least=0) for order in orders})
    if not shown:
        return ()
    basis, levels = _all_orders(realisation, shown)
    emac = np.full(basis.poles.size, np.nan)
    if realisation.factors is not None:
        output, into = extended_amplitude_coherence(realisation.factors, basis)
        emac = output * into
    overlap = _overlap_with_the_order_below(realisation, basis, levels)
    again = np.full(overlap.size, np.nan) if reruns is None else _repeatability(realisation, basis, levels, reruns)
    poles = continuous_poles(basis.poles, realisation.dt)
    size = np.abs(poles)
    damping = np.divide(-poles.real, size, out=np.full(size.shape, np.nan), where=size > 0)
    columns = [column.tolist() for column in (size / (2 * np.pi), damping, overlap, emac, again)]
    rows = list(zip(*columns, strict=True))
    return tuple(
        StabilisationPoint(
            order=order, frequency=row[0], damping_ratio=row[1], overlap=row[2], emac=row[3], repeatability=row[4]
        )
        for order, here in zip(shown, levels, strict=True)
        for row in sorted(rows[here])
    )


def _all_orders(realisation: Realisation, orders: Sequence[int]) -> tuple[ModalBasis, tuple[slice, ...]]:
    """The poles of all orders in one basis of the states of the highest, and where each order stands in it."""
    highest = realisation.order
    if orders[-1] > highest or (realisation.factors is None and orders != [highest]):
        realisation.truncated(orders[-1] if orders[-1] > highest else orders[0])  # raises with the numbers
    bases = [modal_basis(_corner(realisation, order)) for order in orders]
    ends = np.cumsum([0, *(basis.poles.size for basis in bases)]).tolist()
    levels = tuple(slice(first, last) for first, last in pairwise(ends))
    right, left = np.zeros((highest, ends[-1]), dtype=np.complex128), np.zeros((ends[-1], highest), np.complex128)
    for order, basis, here in zip(orders, bases, levels, strict=True):
        right[:order, here], left[here, :order] = basis.right, basis.left
    whole = ModalBasis(
        poles=np.concatenate([basis.poles for basis in bases]),
        is_pair=np.concatenate([basis.is_pair for basis in bases]),
        right=right,
        left=left,
        outputs=np.concatenate([basis.outputs for basis in bases], axis=1),
        inputs=np.concatenate([basis.inputs for basis in bases]),
        separable=np.concatenate([basis.separable for basis in bases]),
    )
    return whole, levels


def _corner(realisation: Realisation, order: int) -> Realisation:
    """`Realisation.truncated` without the Hankel factors, whose copies would cost more than the eigenvalues."""
    full = realisation
    K = None if full.K is None else full.K[:order]
    return Realisation(full.A[:order, :order], full.B[:order], full.C[:, :order], full.D, full.dt, K=K)


def _responses(basis: ModalBasis, output_scale: FloatArray, input_scale: FloatArray | None) -> Pulses:
    """Pulse responses in scaled channels; without `input_scale` free responses."""
    outputs, inputs = basis.outputs, basis.inputs
    if input_scale is None:  # as `modal.modes.shape_comparison.pulses` has it for the modes of a rerun
        outputs = outputs / largest_component(outputs)
        inputs = np.ones((outputs.shape[1], 1), dtype=np.complex128)
    else:
        inputs = inputs * input_scale
    return Pulses(
        poles=basis.poles, is_pair=basis.is_pair, outputs=outputs / output_scale[:, np.newaxis], inputs=inputs
    )


def _part(whole: Pulses, chosen: slice) -> Pulses:
    return Pulses(
        poles=whole.poles[chosen],
        is_pair=whole.is_pair[chosen],
        outputs=whole.outputs[:, chosen],
        inputs=whole.inputs[chosen],
    )


def _overlap_with_the_order_below(realisation: Realisation, basis: ModalBasis, levels: Sequence[slice]) -> FloatArray:
    """Of each pole with the one that it continues; zeros for the lowest order."""
    factors, n_steps = realisation.factors, 200
    output_scale, input_scale = np.ones(realisation.n_outputs), np.ones(basis.inputs.shape[1])
    if factors is not None:
        n_steps = factors.n_block_rows + factors.n_block_columns
        output_scale = factors.output_scale
        input_scale = factors.input_scale if realisation.n_inputs else factors.output_scale
    whole = _responses(basis, output_scale, input_scale if basis.inputs.shape[1] else None)
    energy = energies(whole, n_steps=n_steps)
    result = np.zeros(energy.size)
    for below, here in pairwise(levels):
        inner = inner_products(_part(whole, here), _part(whole, below), n_steps=n_steps)
        result[here] = _best(_shares(inner, energy[here], energy[below]))
    return result


def _repeatability(realisation: Realisation, basis: ModalBasis, levels: Sequence[slice], reruns: Reruns) -> FloatArray:
    """Mean over the kinds of change of the overlap of each pole with its continuation in the reruns."""
    scales = {"output_scale": reruns.output_scale, "input_scale": reruns.input_scale}
    whole = _responses(basis, reruns.output_scale, reruns.input_scale if realisation.n_inputs else None)
    energy = energies(whole, n_steps=reruns.n_steps)
    by_change: dict[Change, list[FloatArray]] = {change: [] for change in ASKED}
    for run in reruns.runs:
        if run.change not in ASKED:
            continue
        found = np.zeros(energy.size)
        if run.modes.modes:
            again = pulses(run.modes.modes, dt=realisation.dt, **scales)
            inner = inner_products(whole, again, n_steps=reruns.n_steps)
            shares = _shares(inner, energy, energies(again, n_steps=reruns.n_steps))
            for here in levels:
                found[here] = _best(shares[here])
        by_change[run.change].append(found)
    means = [np.mean(parts, axis=0) for parts in by_change.values() if parts]
    return np.array(np.mean(means, axis=0)) if means else np.full(energy.size, np.nan)


def _shares(inner: FloatArray, first: FloatArray, second: FloatArray) -> FloatArray:
    """`modal.modes.shape_comparison.overlap_matrix` from inner products and energies that are known already."""
    largest = np.maximum(first[:, np.newaxis], second)
    with np.errstate(invalid="ignore"):  # a growing pole's pulse response may be too large for a float
        share = np.divide(inner, largest, out=np.zeros_like(inner), where=largest > 0)
    clipped: FloatArray = np.clip(np.nan_to_num(share, nan=0.0), 0.0, 1.0)
    return clipped


def _best(shares: FloatArray) -> FloatArray:
    """Share of each row with its partner, one to one, the greatest first; 0 where it has none."""
    partner = pair_greatest_first(shares)
    best = np.zeros(partner.size)
    found = np.flatnonzero(partner >= 0)
    best[found] = shares[found, partner[found]]
    return best
