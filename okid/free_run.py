"""Free run of an observer's own difference equation: it sees the inputs and its own past, never the measured outputs.

The one-step error of an observer is small even where the model is useless; the free run shows it. All of it works in
scaled channels, in which every output weighs the same. A run starts from measured outputs, then goes on alone.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from okid.arrays import BoolArray, ComplexArray, FloatArray
from okid.coefficients import ObserverCoefficients
from okid.record import Record
from okid.recursion import solve_recursion
from okid.rows import complete_rows, scaled_block, usable_rows
from okid.scaling import ChannelScaling

__all__ = ["FreeRuns", "free_run", "held_out_errors", "prepare_free_runs"]

_DIVERGED = 1e6
"""Standard deviations beyond which a run is given up."""
_LONGEST_RUN = 10_000
_MOST_RUNS = 10
"""A long record is cut into runs that go side by side; of more than these, evenly spread ones stand for all."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FreeRuns:
    """What free runs of any observer up to an order need: all that does not depend on the coefficients.

    Attributes:
        outputs: (n_steps, n_outputs, n_runs) scaled measured outputs, NaN where missing or beyond the end of a run.
        history: (order, n_outputs, n_runs) scaled outputs before the first step.
        input_spectrum: (n_frequencies, n_runs, n_inputs) of the scaled inputs from `order` samples before the first
            step; an input gap counts as the input's mean.
        length: FFT length of `input_spectrum`.
        places: (record number, first row) of each run.
    """

    outputs: FloatArray
    history: FloatArray
    input_spectrum: ComplexArray
    length: int
    places: tuple[tuple[int, int], ...]

    @property
    def order(self) -> int:
        """Largest observer order that can be run."""
        return self.history.shape[0]


def prepare_free_runs(records: Sequence[Record], scaling: ChannelScaling, order: int) -> FreeRuns | None:
    """Cut the records into runs, each begun where `order` samples without a gap stand before it; None: nowhere.

    Args:
        records: of one system.
        scaling: mean and size of every channel.
        order: largest observer order that will be run.
    """
    pieces = []
    for number, record in enumerate(records):
        n_pieces = -(-record.n_samples // (_LONGEST_RUN + order))
        edges = np.linspace(0, record.n_samples, n_pieces + 1).round().astype(int).tolist()
        pieces += [(number, start, stop) for start, stop in itertools.pairwise(edges)]
    chosen = np.unique(
        np.linspace(0, len(pieces) - 1, min(len(pieces), max(_MOST_RUNS, len(records)))).round().astype(int)
    )
    blocks, places = [], []
    for number, start, stop in (pieces[i] for i in chosen):
        record = records[number]
        block = np.empty((stop - start, record.n_inputs + record.n_outputs))
        begin = order
        if not scaled_block(record, start, stop, scaling, out=block):
            usable = np.flatnonzero(usable_rows(complete_rows(block), order - 1))
            begin = int(usable[0]) + 1 if usable.size else block.shape[0]
        if begin < block.shape[0]:
            blocks.append(block[begin - order :])
            places.append((number, start + begin))
    if not blocks:
        return None
    n_inputs = records[0].n_inputs
    longest = max(block.shape[0] for block in blocks)
    padded = np.full((longest, len(blocks), blocks[0].shape[1]), np.nan)
    for run, block in enumerate(blocks):
        padded[: block.shape[0], run] = block
    # Twice nothing would wrap: the forcing is read from `order` samples on, where a circular convolution is exact.
    length = 1 << (longest - 1).bit_length()
    inputs = np.nan_to_num(padded[:, :, :n_inputs])
    return FreeRuns(
        outputs=np.ascontiguousarray(padded[order:, :, n_inputs:].transpose(0, 2, 1)),
        history=np.ascontiguousarray(padded[:order, :, n_inputs:].transpose(0, 2, 1)),
        input_spectrum=np.fft.rfft(inputs, n=length, axis=0),
        length=length,
        places=tuple(places),
    )


def free_run(observer: ObserverCoefficients, runs: FreeRuns) -> FloatArray:
    """(n_steps, n_outputs, n_runs) scaled outputs of the observer alone; infinite from where it diverges.

    Args:
        observer: of an order up to that of `runs`.
        runs: from `prepare_free_runs`.
    """
    n_steps, n_outputs, n_runs = runs.outputs.shape
    forcing = np.empty((n_steps, n_outputs, n_runs))
    forcing[:] = observer.offset[:, np.newaxis]
    n_inputs = observer.feedthrough.shape[1]
    if n_inputs:
        pulse = np.concatenate([observer.feedthrough[np.newaxis], observer.input_coefficients])
        spectrum = np.fft.rfft(pulse, n=runs.length, axis=0)
        forced = np.matmul(spectrum, runs.input_spectrum.transpose(0, 2, 1))
        forcing += np.fft.irfft(forced, n=runs.length, axis=0)[runs.order : runs.order + n_steps]
    history = runs.history[runs.order - observer.order :]
    with np.errstate(over="ignore", invalid="ignore"):
        return solve_recursion(observer.output_coefficients, forcing, history, limit=_DIVERGED)


def held_out_errors(
    observer: ObserverCoefficients, runs: FreeRuns, held_out: Sequence[BoolArray]
) -> tuple[float, float]:
    """Sum of squared errors of the free run, and of the outputs themselves, over held-out rows.

    Args:
        observer: fitted without the held-out rows.
        runs: from `prepare_free_runs`.
        held_out: one mask a record.
    """
    scored = np.zeros(runs.outputs.shape, dtype=np.bool_)
    for run, (number, first) in enumerate(runs.places):
        rows = held_out[number][first : first + runs.outputs.shape[0]]
        scored[: rows.size, :, run] = rows[:, np.newaxis]
    scored &= ~np.isnan(runs.outputs)
    measured = runs.outputs[scored]
    simulated = free_run(observer, runs)[scored]
    if not np.isfinite(simulated).all():
        return np.inf, float(measured @ measured)
    error = simulated - measured
    return float(error @ error), float(measured @ measured)
