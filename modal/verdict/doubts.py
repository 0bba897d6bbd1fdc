"""What keeps a mode that was found again from being called a mode of the system, each in one function and one sentence.

Each returns its words, or nothing where there is no such doubt.
"""

import numpy as np

from modal.modes.mode import Mode
from okid.excitation import Excitation

__all__ = ["colour_doubt", "delay_doubt", "edge_doubt", "excitation_doubt", "poor_fit_doubt", "unexcited_doubt"]

LEAST_FIT = 0.5
"""Cross-validated fit below which the model does not explain the data."""
LARGEST_UNDRIVEN_DAMPING = 0.05
"""Damping ratio above which, without an input, a pole cannot be told from the colour of what drives the system."""
CLEAR_GAIN = 0.03
"""Gain from which a mode is excited beyond doubt: of 93 such poles that the rule without it doubted, 91 were true."""
FILTER_EDGE = 0.85
"""Share of the Nyquist frequency of a decimated record above which its anti-alias filter makes poles of its own."""
LEAST_MEMORY = 0.3
"""Magnitude of a discrete pole below which nine tenths of its response are over after two samples."""


def poor_fit_doubt(fit: float) -> tuple[str, ...]:
    """The model does not explain the data (nan: not known, no doubt).

    Example:
        >>> poor_fit_doubt(0.319)
        ("the model explains only 31 % of the outputs' motion on held-out data: no mode of it is certain",)
    """
    if not fit < LEAST_FIT:
        return ()
    share = "nothing" if fit < 0.01 else f"only {np.floor(100 * fit):.0f} %"
    return (f"the model explains {share} of the outputs' motion on held-out data: no mode of it is certain",)


def excitation_doubt(n_states: int, excitation: Excitation | None, gain: float = np.nan) -> tuple[str, ...]:
    """The inputs move in fewer ways than the model has states (None: no inputs, or not known).

    A sweep or a multisine that ends below half the sampling frequency moves in few ways, and yet shows every mode in
    its band. A mode whose gain is clear is excited, whatever the rest of the band may hold.
    """
    if gain >= CLEAR_GAIN or excitation is None:
        return ()
    if excitation.persistency_order >= min(n_states, excitation.needed_order):
        return ()
    words = f"the inputs excite order {excitation.persistency_order} only, too few for a model of {n_states} states"
    return (f"{words}: what they leave open is not in the data",)


def colour_doubt(mode: Mode) -> tuple[str, ...]:
    """Without an input, a heavily damped pole may describe the spectrum of what drives the system."""
    if mode.participation.size or mode.damping_ratio <= LARGEST_UNDRIVEN_DAMPING:
        return ()
    return (f"damping {100 * mode.damping_ratio:.0f} % and no input: may be the colour of what drives the system",)


def delay_doubt(mode: Mode, dt: float) -> tuple[str, ...]:
    """A pole that dies within two samples may describe a delay, or what happens between samples."""
    left = float(np.exp(mode.pole.real * dt))
    if left >= LEAST_MEMORY:
        return ()
    return (f"dies within two samples ({100 * left:.0f} % are left after one): may be a delay, not a mode",)


def edge_doubt(mode: Mode, edge: float) -> tuple[str, ...]:
    """A pole in the edge of the anti-alias filter of a decimated record, `edge` [Hz] and above."""
    if not mode.frequency > edge:
        return ()
    return (f"above {edge:.4g} Hz, in the edge of the filter of the decimated record: may belong to the filter",)


def unexcited_doubt(mode: Mode, excitation: Excitation | None) -> tuple[str, ...]:
    """No input moves at the mode's frequency, within 60 dB of where it moves most (None: no inputs, or not known)."""
    if excitation is None or not any(excitation.excited_bands):
        return ()
    if any(low <= mode.frequency <= high for bands in excitation.excited_bands for low, high in bands):
        return ()
    return (f"no input moves at {mode.frequency:.4g} Hz: what is seen there is leakage or a disturbance",)
