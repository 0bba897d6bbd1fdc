"""The time step of a table: from its time column, from what the file states, or from the caller."""

import numpy as np

from okid.arrays import FloatArray
from okid.errors import InsufficientDataError, InvalidDataError
from okid.readers.table import Table
from okid.readers.units import convert_unit

__all__ = ["stated_step", "time_step"]

JITTER = 0.1
"""How far a sample may lie off the uniform grid, in time steps."""

SHORTEST, LONGEST = 1e-12, 1e9
"""Time steps [s] that an experiment can have; beyond them the arithmetic of frequencies overflows."""

CONTRADICTION = 1e-3
"""Relative difference above which a given time step contradicts that of the file."""


def time_step(table: Table, dt: float | None) -> tuple[float, float]:
    """Time step and time of the first sample [s].

    Args:
        table: the file's table.
        dt: time step that the caller gives [s]; None to take the file's.

    Raises:
        InvalidDataError: neither the file nor the caller gives a time step, the two contradict each other, or the time
            column is no uniform grid.
    """
    if dt is not None and not (np.isfinite(dt) and dt > 0):
        raise InvalidDataError(f"dt must be a positive time step in seconds, but is {dt}.")
    if dt is not None and not SHORTEST <= dt <= LONGEST:
        raise InvalidDataError(
            f"dt must be a time step between {SHORTEST:g} and {LONGEST:g} s, but is {dt:g}; count the time in another "
            "unit."
        )
    stated, start_time = stated_step(table)
    if stated is None:
        if dt is None:
            raise InvalidDataError(
                f"{table.path.name} has no time column (its columns are {_listed(table.names)}), so the time step must "
                "be given: pass dt in seconds (--dt)."
            )
        return float(dt), start_time
    if dt is None:
        return stated, start_time
    if abs(dt - stated) > CONTRADICTION * stated:
        raise InvalidDataError(
            f"dt = {dt:.6g} s was given, but the time axis of {table.path.name} has {stated:.6g} s, which is "
            f"{abs(dt / stated - 1):.2%} off; leave dt out, or correct the file."
        )
    return float(dt), start_time


def stated_step(table: Table) -> tuple[float | None, float]:
    """Time step (None if the file gives none) and time of the first sample [s]; as `time_step` raises."""
    index = table.time_column()
    if index is None:
        if table.dt is not None and not (np.isfinite(table.dt) and table.dt > 0):
            raise InvalidDataError(
                f"{table.path.name} states a time step of {table.dt} s, which is none; correct it in the file."
            )
        return table.dt, table.start_time
    column = table.columns[index]
    conversion = convert_unit("time", column.unit)
    if conversion.unit not in {"s", ""}:
        raise InvalidDataError(
            f"column {column.name!r} of {table.path.name} is in {column.unit!r}, which is no unit of time; correct its "
            "header, or rename it if it is a channel."
        )
    name = f"the time column {column.name!r} of {table.path.name}"
    step = _uniform_step(np.asarray(table.values[:, index]) * conversion.factor, name)
    if table.dt is not None and abs(step - table.dt) > CONTRADICTION * step:
        raise InvalidDataError(
            f"{name} has a step of {step:.6g} s, but the file states {table.dt:.6g} s; correct one of them."
        )
    return step, float(table.values[0, index]) * conversion.factor


def _uniform_step(time: FloatArray, name: str) -> float:
    """Mean step over the whole span, checked to be a uniform grid."""
    n_samples = len(time)
    if n_samples < 2:
        raise InsufficientDataError(f"{name} holds {n_samples} sample; a time step needs at least 2.")
    bad = ~np.isfinite(time)
    if bad.any():
        raise InvalidDataError(
            f"{name} is missing in {int(bad.sum())} of {n_samples} rows, the first of them row {int(bad.argmax()) + 1};"
            " every sample needs its time."
        )
    step = float(time[-1] - time[0]) / (n_samples - 1)
    back = np.diff(time) <= 0
    if step <= 0 or back.any():
        row = int(back.argmax()) + 1
        raise InvalidDataError(
            f"{name} must increase, but goes from {time[row - 1]:.9g} s to {time[row]:.9g} s at row {row + 1} of "
            f"{n_samples}; sort the rows, or cut the file into one file a record."
        )
    off = np.abs(time - time[0] - step * np.arange(n_samples)) / step
    worst = int(off.argmax())
    if off[worst] > JITTER:
        raise InvalidDataError(
            f"{name} is not uniform: with the mean step of {step:.6g} s, row {worst + 1} of {n_samples} lies "
            f"{off[worst]:.3g} steps off the grid (at most {JITTER} is allowed); resample the record to a uniform "
            "step, or, if samples were lost, put the lost rows back with empty cells."
        )
    return step


def _listed(names: tuple[str, ...]) -> str:
    more = f" and {len(names) - 12} more" if len(names) > 12 else ""
    return ", ".join(names[:12]) + more
