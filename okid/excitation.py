"""Before the fit: do the inputs move enough, and in enough different ways, for the answer to be in the data?"""

from dataclasses import dataclass

from okid.arrays import FloatArray

__all__ = ["Excitation"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Excitation:
    """What the inputs allow to be identified.

    Attributes:
        needed_order: order of persistent excitation that was asked for.
        persistency_order: largest order up to `needed_order` for which the input Hankel matrix has full numerical rank.
        condition: condition number of the scaled input Hankel matrix of `needed_order` block rows.
        excited_share: (n_inputs,) share of the band 0 to half the sampling frequency in which the input has power
            (within 60 dB of its largest spectral density).
        excited_bands: one tuple of (low, high) [Hz] pairs an input: where it moves.
        messages: findings in words; empty when the inputs carry all that was asked.
    """

    needed_order: int
    persistency_order: int
    condition: float
    excited_share: FloatArray
    excited_bands: tuple[tuple[tuple[float, float], ...], ...]
    messages: tuple[str, ...]
