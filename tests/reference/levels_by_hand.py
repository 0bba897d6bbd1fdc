"""Modes against level filled in by hand, for those who show them."""

from dataclasses import replace

import numpy as np

from modal.localisation.evidence import Location
from modal.localisation.levels import LevelMode, LevelModes
from modal.wording.text import Statement

LEVELS = np.array([0.127, 0.4, 1.0])


def mode(number, frequencies, damping_ratios, *, tendencies=("unknown", "unknown"), kind="oscillatory"):
    frequency, damping = np.array(frequencies), np.array(damping_ratios)
    return LevelMode(
        number=number,
        kind=kind,
        frequencies=frequency,
        frequency_stds=0.001 * frequency,
        damping_ratios=damping,
        damping_ratio_stds=0.05 * damping,
        assurances=np.ones(3),
        frequency_tendency=tendencies[0],
        damping_tendency=tendencies[1],
    )


HARDENS = mode(1, [3.0, 3.06, 3.3], [0.01, 0.012, 0.011], tendencies=("rises", "unknown"))
RESTS = mode(2, [8.0, np.nan, 8.01], [0.02, np.nan, 0.02], tendencies=("stays", "stays"))
VAGUE = mode(3, [12.0, 12.5, 11.0], [0.03, 0.02, 0.05])
POLE = mode(1, [0.5, 0.6, 0.8], [1.0, 1.0, 1.0], tendencies=("rises", "unknown"), kind="real")


def with_levels(diagnosis, *modes, agrees=False):
    """The diagnosis with these modes at three levels of the records to fit."""
    n_outputs = diagnosis.held_out[0].n_outputs
    found = LevelModes(levels=LEVELS, modes=modes, left_over=np.zeros((3, n_outputs)), order=8, reason="")
    location = Location(
        statements=(Statement(subject="size", text="The gap lies in upper."),),
        agrees=agrees,
        output=0,
        output_shares=np.zeros(n_outputs),
        coherent=np.zeros(n_outputs),
        modes=found,
    )
    return replace(diagnosis, location=location)
