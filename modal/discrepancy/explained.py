"""How much of each output the model explains on held-out data: a model that lacks nothing may still explain nothing.

Where an output is noise only, or has nothing to do with the inputs, no effect can be missing that the data could show.
"Nothing missing" is then no praise of the model, and must not read like it.
"""

from typing import TYPE_CHECKING

import numpy as np

from modal.wording.numbers import listed, percent
from okid.arrays import FloatArray

if TYPE_CHECKING:
    from modal.discrepancy.results import Diagnosis

__all__ = ["NOTHING", "explained_shares", "explained_words", "unexplained_outputs"]

NOTHING = 0.1
"""Share of an output's variance below which a model is said to explain nothing of it."""
MOST_NAMED = 4


def explained_shares(diagnosis: "Diagnosis") -> FloatArray:
    """(n_outputs,) share of each output's held-out variance that the updated model explains.

    1 - mean square of measured minus simulated over the variance of the measured output, over all held-out records;
    negative where the output would be nearer to its own mean; nan where the output rests.

    Args:
        diagnosis: What was found.
    """
    counts = np.array([np.isfinite(record.outputs).sum(axis=0) for record in diagnosis.held_out], dtype=float)
    variance = np.array([np.nanvar(record.outputs, axis=0) for record in diagnosis.held_out])
    total = (counts * variance).sum(axis=0)
    left = (counts * np.square(np.asarray(diagnosis.gap_after))).sum(axis=0)
    shares: FloatArray = np.where(total > 0.0, 1.0 - left / np.where(total > 0.0, total, 1.0), np.nan)
    return shares


def unexplained_outputs(diagnosis: "Diagnosis") -> tuple[str, ...]:
    """Names of the outputs of which the updated model explains nothing.

    Args:
        diagnosis: What was found.
    """
    names = diagnosis.held_out[0].output_names
    return tuple(name for name, share in zip(names, explained_shares(diagnosis), strict=True) if share < NOTHING)


def explained_words(diagnosis: "Diagnosis") -> str:
    """The warning that the model explains nothing of some outputs; "" where it explains something of each.

    Args:
        diagnosis: What was found.
    """
    outputs = unexplained_outputs(diagnosis)
    if not outputs:
        return ""
    rest = [f"{len(outputs) - MOST_NAMED} more"] if len(outputs) > MOST_NAMED else []
    shares = explained_shares(diagnosis)
    best = max(float(share) for share in shares if share < NOTHING)
    it = "it is" if len(outputs) == 1 else "they are"
    channel = "the channel is" if len(outputs) == 1 else "the channels are"
    no_proof = "; that nothing is missing there does not say that the model is right"
    proof = no_proof if diagnosis.status != "unresolved" else ""
    names, most = listed([*outputs[:MOST_NAMED], *rest]), percent(max(best, 0.0))
    return (
        f"the simulation explains nothing of {names} ({most} of the variance on held-out data): {it} noise, or "
        f"unrelated to the inputs, or {channel} dead or wrong{proof}"
    )
