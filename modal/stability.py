"""The points of a stabilisation diagram: poles of every model order, each compared with those of the order below."""

from collections.abc import Iterable

import numpy as np

from era.realisation import Realisation
from modal.basis import ModalBasis, continuous_poles, modal_basis
from modal.identification import StabilisationPoint
from modal.indicators import extended_amplitude_coherence
from modal.overlap import Pulses, overlap_matrix, pair_greatest_first
from okid.arrays import FloatArray

__all__ = ["stabilisation"]


def stabilisation(realisations: Iterable[Realisation]) -> tuple[StabilisationPoint, ...]:
    """Poles of nested realisations, one of each conjugate pair, by rising order and frequency.

    A pole that belongs to the system stands at the same place in model after model: its overlap with the pole that it
    continues is near 1. Poles of every kind are given but deadbeat ones; a growing pole has a negative damping ratio,
    and a pole on the real axis a damping ratio of 1 (or, at half the sampling frequency, a frequency of at least
    that).

    Args:
        realisations: of rising order, from one SVD (`Realisation.truncated`), all with their Hankel factors.

    Returns:
        One point a pole; EMAC is nan for a realisation without Hankel factors.
    """
    points: list[StabilisationPoint] = []
    below: Pulses | None = None
    for realisation in sorted(realisations, key=lambda model: model.order):
        basis = modal_basis(realisation)
        here = _scaled(basis, realisation)
        overlap = np.zeros(basis.poles.size) if below is None else _continued(here, below, realisation)
        points += _points(realisation, basis, overlap)
        below = here
    return tuple(points)


def _scaled(basis: ModalBasis, realisation: Realisation) -> Pulses:
    outputs, inputs = basis.outputs, basis.inputs
    if realisation.factors is not None:
        outputs = outputs / realisation.factors.output_scale[:, np.newaxis]
        has_inputs = realisation.B.shape[1] > 0
        inputs = inputs * (realisation.factors.input_scale if has_inputs else realisation.factors.output_scale)
    return Pulses(poles=basis.poles, is_pair=basis.is_pair, outputs=outputs, inputs=inputs)


def _continued(here: Pulses, below: Pulses, realisation: Realisation) -> FloatArray:
    factors = realisation.factors
    n_steps = 200 if factors is None else factors.n_block_rows + factors.n_block_columns
    overlaps = overlap_matrix(here, below, n_steps=n_steps)
    partner = pair_greatest_first(overlaps)
    best = np.zeros(here.poles.size)
    found = np.flatnonzero(partner >= 0)
    best[found] = overlaps[found, partner[found]]
    return best


def _points(realisation: Realisation, basis: ModalBasis, overlap: FloatArray) -> list[StabilisationPoint]:
    poles = continuous_poles(basis.poles, realisation.dt)
    size = np.abs(poles)
    damping = np.divide(-poles.real, size, out=np.full(size.shape, np.nan), where=size > 0)
    emac = np.full(size.shape, np.nan)
    if realisation.factors is not None:
        output, into = extended_amplitude_coherence(realisation.factors, basis)
        emac = output * into
    columns = zip((size / (2 * np.pi)).tolist(), damping.tolist(), overlap.tolist(), emac.tolist(), strict=True)
    return [
        StabilisationPoint(
            order=realisation.order, frequency=frequency, damping_ratio=ratio, overlap=same, emac=coherence
        )
        for frequency, ratio, same, coherence in sorted(columns)
    ]
