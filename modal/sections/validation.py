"""What the model was tested against, and what a comparison with a simulation would add, in words."""

import shlex
from typing import TYPE_CHECKING

import numpy as np

from modal.identification.result import Identification
from modal.sections.provenance import Provenance
from modal.wording.numbers import LEAST_FIT, whole_percent

if TYPE_CHECKING:
    from modal.quality import DataQuality

__all__ = ["coherence_sentence", "gap_command", "gap_sentence", "validation_sentences"]

COHERENT = 0.8
"""Multiple coherence from which the inputs explain most of an output at a frequency."""


def validation_sentences(result: Identification) -> tuple[str, ...]:
    """How the fit on held-out rows was found, and how far it lies below that on all rows."""
    n_folds = int(np.size(result.fit.folds))
    inputs = result.records[0].n_inputs
    run = "a free run from the inputs alone" if inputs else "a prediction one step ahead, because no input was measured"
    sentences = [
        f"Tested by {run}: in {_folds(n_folds)} the model was fitted to the other rows and run over those held out."
        if n_folds
        else f"Tested by {run}; no rows were held out."
    ]
    held_out, whole = result.fit.mean, float(np.mean(result.fit.whole))
    if np.isfinite(held_out) and np.isfinite(whole):
        drop = whole - held_out
        if drop > 0.05:
            sentences.append(
                f"On all rows the fit is {whole:.2f}, {drop:.2f} more than on held-out rows: a sign that the model "
                "follows the noise of the rows that it was fitted to."
            )
        else:
            sentences.append(
                f"On all rows the fit is {whole:.2f}, on held-out rows {held_out:.2f}: no sign that the model "
                "follows the noise of the rows that it was fitted to."
            )
    low = [
        name
        for name, fit in zip(result.records[0].output_names, result.fit.cross_validated, strict=True)
        if fit < LEAST_FIT
    ]
    if low:
        sentences.append(
            f"{len(low)} of {result.records[0].n_outputs} outputs {'has' if len(low) == 1 else 'have'} a fit below "
            f"{LEAST_FIT}: what the modes say about {'it' if len(low) == 1 else 'them'} is not proved."
        )
    return tuple(sentences)


def coherence_sentence(quality: "DataQuality | None") -> str:
    """In how much of the band the inputs explain the outputs, without any model; "" where that is not known."""
    if quality is None or quality.coherence is None:
        return ""
    coherence = quality.coherence.multiple_coherence[1:]
    known = coherence[np.isfinite(coherence)]
    if not known.size:
        return ""
    share = float(np.mean(known >= COHERENT))
    return (
        f"Without any model, the inputs explain at least {100 * COHERENT:.0f} % of an output's power (coherence) at "
        f"{whole_percent(share)} of all frequencies and outputs."
    )


def gap_sentence(result: Identification) -> str:
    """That no simulation was compared, and what it takes."""
    if not result.records[0].n_inputs:
        return (
            "No simulation was compared with these records, and none can be: without a measured input there is nothing "
            "to drive it with."
        )
    if len(result.records) < 2:
        return (
            "No simulation was compared with this record. To learn what a simulation is missing, and where, give it "
            "with this record and a second one that is held out:"
        )
    return (
        "No simulation was compared with these records. To learn what a simulation is missing, and where, give it with "
        "some of the records and hold the others out:"
    )


def gap_command(result: Identification, provenance: Provenance) -> str:
    """The command that compares a simulation with the files of this result; "" where there is no input."""
    record = result.records[0]
    if not record.n_inputs:
        return ""
    files = list(provenance.sources) or ["FIRST.csv"]
    one_each = len(files) == len(result.records) > 1  # else the files are the channels of one record
    fit, held_out = (files[:-1], files[-1:]) if one_each else (files, ["SECOND.csv"])
    words = ["modal-report", "gap", "MODEL.toml", "--fit", *fit, "--held-out", *held_out]
    words += [] if provenance.dt is None else ["--dt", repr(provenance.dt)]
    return shlex.join([*words, "--hold", record.input_hold, "-o", "gap"])


def _folds(n_folds: int) -> str:
    return "the only fold" if n_folds == 1 else f"each of {n_folds} folds"
