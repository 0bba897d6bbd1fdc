"""A wrongly declared hold of the inputs poses as half a sample of delay or as damping: when to think of it.

Between a held and a straight or band-limited input lies half a sample, pi f dt in phase at the frequency f: that share
of the motion at most, a fifth of it at 16 samples a period. A gap that is larger is not due to the hold alone.
"""

import numpy as np

from modal.discrepancy.results import Diagnosis
from modal.discrepancy.validation.other_hold import has_half_a_sample, other_hold
from modal.simulation.tolerances import NEAR_FLOOR
from modal.wording.statements import number
from okid.arrays import FloatArray
from okid.record import Record

__all__ = ["highest_frequency", "hold_words"]

MOST_OF_IT = 0.95
"""Share of an output's power above the noise that lies below the highest frequency that matters."""


def highest_frequency(records: tuple[Record, ...], floor: FloatArray) -> float:
    """Frequency [Hz] below which nearly all of the outputs' power above the noise lies; 0 where there is none.

    Args:
        records: Measured.
        floor: (n_records, n_outputs) variance of the noise.
    """
    highest = 0.0
    for record, noise in zip(records, floor, strict=True):
        centred = np.nan_to_num(record.outputs - np.nanmean(record.outputs, axis=0))
        power = np.square(np.abs(np.fft.rfft(centred * np.hanning(len(centred))[:, np.newaxis], axis=0)))
        above = power / power.sum(axis=0).clip(min=np.finfo(float).tiny) * centred.var(axis=0) - noise / len(power)
        total = above.sum(axis=0)
        reached = np.cumsum(above, axis=0) >= MOST_OF_IT * total
        lines = np.argmax(reached, axis=0)[total > 0.0]
        highest = max(highest, float(lines.max(initial=0)) / (record.n_samples * record.dt))
    return highest


def hold_words(diagnosis: Diagnosis) -> str:
    """What to check of the declared hold; "" where it cannot matter or nothing is left that it could explain.

    Args:
        diagnosis: What was found.
    """
    first = diagnosis.fit[0]
    if not first.n_inputs:
        return ""
    frequency = highest_frequency(diagnosis.fit, np.asarray(diagnosis.noise_floor.variance)[: len(diagnosis.fit)])
    shift = np.pi * frequency * first.dt
    unexplained = _gap_remains(diagnosis) and not _left_over(diagnosis) > shift
    if shift == 0.0 or not (unexplained or has_half_a_sample(diagnosis)):
        return ""
    other = other_hold(first.input_hold)
    why = "was held by its source" if other == "zero_order" else "was measured rather than set"
    return (
        f"Check the hold: the motion reaches up to {number(frequency)} Hz, {number(1.0 / (frequency * first.dt), 2)} "
        f'samples a period, and the input is declared {first.input_hold}. If it {why}, declare input_hold="{other}": '
        "a wrong hold looks like half a sample of delay, or like damping."
    )


def _gap_remains(diagnosis: Diagnosis) -> bool:
    return not diagnosis.steps[-1].held_out_level <= NEAR_FLOOR


def _left_over(diagnosis: Diagnosis) -> float:
    """Size of the held-out gap above the noise, as a share of the motion's."""
    noise = np.asarray(diagnosis.noise_floor.variance)[len(diagnosis.fit) :]
    above = np.maximum(np.square(diagnosis.gap_after) - noise, 0.0)
    motion = np.array([np.nanvar(record.outputs, axis=0) for record in diagnosis.held_out])
    return float(np.sqrt(above.sum() / motion.sum()))
