"""Where a mode could have been seen at all: below half the sampling frequency, and where some input moved."""

from collections.abc import Iterable

from modal.acceptance.limits import Range
from modal.acceptance.weighing import band_text
from modal.identification.result import Identification

__all__ = ["blind_part", "uncovered"]


def blind_part(result: Identification, band: Range) -> str:
    """Why a mode in the band could have been missed; "" where every part of it was seen.

    Args:
        result: of `modal.identify`.
        band: [Hz].
    """
    nyquist = 0.5 / result.records[0].dt
    if band[1] > nyquist:
        return f"the band reaches above {nyquist:.4g} Hz, half the sampling frequency of the identified record"
    if not result.records[0].n_inputs:
        return ""  # what drove the structure is not known; it is for the verdicts to doubt
    dark = uncovered(band, (pair for bands in result.excitation.excited_bands for pair in bands))
    return f"no input moved at {band_text(dark[0])}" if dark else ""


def uncovered(band: Range, pieces: Iterable[Range]) -> tuple[Range, ...]:
    """The parts of a band that no piece covers, from low to high.

    Example:
        >>> uncovered((1.0, 5.0), [(0.0, 2.0), (3.0, 4.0), (1.5, 2.5)])
        ((2.5, 3.0), (4.0, 5.0))
    """
    low, high = band
    parts = []
    for start, end in sorted(pieces):
        if start > low:
            parts.append((low, min(start, high)))
        low = max(low, end)
        if low >= high:
            break
    if low < high:
        parts.append((low, high))
    return tuple(parts)
