"""Run a simulation program: a callable that takes a Record and returns one with simulated outputs.

What comes back is checked each time, because nothing else is known of the program: a wrong channel order, a missing
sample or a random number in it would pose as an effect.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from modal.simulation.tolerances import ROUNDING
from okid.arrays import FloatArray
from okid.errors import InvalidDataError
from okid.record import Record

__all__ = ["Simulator", "check_deterministic", "run_callable"]

Simulator = Callable[[Record], Record]
"""Simulates along the inputs of a record; what the record measured is for its start at most."""


def run_callable(simulator: Simulator, record: Record) -> Record:
    """The record with the simulated outputs in place of the measured ones.

    Args:
        simulator: Takes a Record and returns one.
        record: What it is to be run along.

    Raises:
        InvalidDataError: It fails, returns no Record or one of another size, time step or order of outputs, or numbers
            that are not finite.

    Example:
        >>> def gain(record: Record) -> Record:
        ...     return replace(record, outputs=2.0 * record.inputs)
        >>> run_callable(gain, Record([1.0, 2.0], [0.0, 0.0], 0.1)).outputs.ravel()
        array([2., 4.])
    """
    name = _named(record)
    try:
        found = simulator(record)
    except Exception as error:
        raise InvalidDataError(
            f"the callable must simulate every record, but failed on {name} ({type(error).__name__}: {error}); call it "
            "with that record by itself and mend it."
        ) from error
    if not isinstance(found, Record):
        raise InvalidDataError(
            f"the callable must return a Record, but returned {type(found).__name__} for {name}; return "
            "dataclasses.replace(record, outputs=simulated)."
        )
    if found.outputs.shape != record.outputs.shape:
        raise InvalidDataError(
            f"the callable must return outputs of shape {record.outputs.shape} for {name}, but returned "
            f"{found.outputs.shape}; return one row a sample and one column an output of the record."
        )
    if abs(found.dt - record.dt) > 1e-6 * record.dt:
        raise InvalidDataError(
            f"the callable must return {name} at its time step of {record.dt:.6g} s, but returned {found.dt:.6g} s; "
            "interpolate its outputs to the times of the record."
        )
    _check_order(found, record)
    bad = ~np.isfinite(found.outputs)
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise InvalidDataError(
            f"the callable must return finite outputs, but {record.output_names[column]!r} of {name} is "
            f"{found.outputs[row, column]} at sample {row} ({bad.sum()} such values); look for a motion that grows "
            "without bound or a division by zero."
        )
    return replace(record, outputs=found.outputs)


def check_deterministic(simulator: Simulator, record: Record, known: FloatArray) -> None:
    """Run it again along a record and compare.

    Args:
        simulator: Takes a Record and returns one.
        record: That it was run along.
        known: (n_samples, n_outputs) what it returned.

    Raises:
        InvalidDataError: It returns something else than before.
    """
    again = run_callable(simulator, record).outputs
    difference, size = float(np.abs(again - known).max()), float(np.abs(known).max())
    if difference > ROUNDING * size:
        raise InvalidDataError(
            f"the callable must return the same outputs each time, but two runs along {_named(record)} differ by "
            f"{difference:.3g} (largest output {size:.3g}); leave out simulated noise, or seed it in the callable."
        )


def _check_order(found: Record, record: Record) -> None:
    ours, theirs = record.output_names, found.output_names
    if ours != theirs and set(ours) == set(theirs):
        raise InvalidDataError(
            f"the callable must return the outputs in the order of the record ({', '.join(ours)}), but returned "
            f"{', '.join(theirs)}; return record.select(outputs=...) in that order."
        )


def _named(record: Record) -> str:
    return f"record {record.name!r}" if record.name else f"a record of {record.n_samples} samples"
