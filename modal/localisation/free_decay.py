"""Free decays: the level is the motion itself, and falls within one record.

A record that no input drives is cut into windows; each is the answer to a pulse at its first sample and to its own
initial state, so that ERA takes its outputs for Markov parameters and the refinement for any other record.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from okid.markov import MarkovParameters
from okid.record import Record

__all__ = ["decay_markov", "decay_windows"]

N_WINDOWS = 6
SHORTEST_WINDOW = 80
"""Samples: fewer hold too little of a slow mode beside its neighbours."""
LONGEST_RESPONSE = 800
"""Samples of a window that ERA takes: its cost grows with their cube."""


def decay_windows(records: Sequence[Record]) -> tuple[Record, ...]:
    """Windows of equal length, each with a pulse for an input; those with missing samples are left out.

    Args:
        records: that no input drives.

    Example:
        >>> decay = np.exp(-0.01 * np.arange(600)) * np.cos(np.arange(600))
        >>> windows = decay_windows([Record([], decay, 0.1)])
        >>> len(windows), windows[1].n_samples, windows[1].start_time
        (6, 100, 10.0)
    """
    windows = []
    for record in records:
        count = int(np.clip(record.n_samples // SHORTEST_WINDOW, 1, N_WINDOWS))
        bare = replace(record, inputs=np.empty((record.n_samples, 0)), input_names=(), input_units=())
        for part in bare.split(*[1.0 / count] * count):
            if np.isfinite(part.outputs).all() and np.ptp(part.outputs, axis=0).all():
                pulse = np.zeros((part.n_samples, 1))
                pulse[0] = 1.0
                windows.append(replace(part, inputs=pulse, input_names=("pulse",), input_units=("",)))
    return tuple(windows)


def decay_markov(windows: Sequence[Record]) -> MarkovParameters:
    """The outputs of the first window, as those of a pulse one sample before it.

    Args:
        windows: of one level, means removed.
    """
    answer = windows[0].outputs[:LONGEST_RESPONSE, :, np.newaxis]
    return MarkovParameters(system=np.concatenate([np.zeros_like(answer[:1]), answer]), dt=windows[0].dt)
