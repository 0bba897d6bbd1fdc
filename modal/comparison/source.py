"""What a comparison needs to know of a result, from memory or from the file that keeps it."""

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from modal.identification.result import Identification, load, read_part
from modal.identification.words import trust_of
from modal.modes.choice import Choice
from modal.modes.mode import Mode
from modal.wording.names import shorten, visible
from okid.display import Displayed
from okid.errors import UnreadableFileError

__all__ = ["PART", "ChannelName", "ResultSummary", "read_result", "summary_of"]

PART = "summary"
"""Name of a summary in the file of a result."""

MOST_MODES = 2000
"""Refuse a file with more modes than any identification has: each is weighed against every one of the other result."""

LONGEST_NAME = 200
"""Shorten names and messages of a stranger's file to so many letters."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class ChannelName(Displayed):
    """A channel of the records.

    Attributes:
        name: of the channel.
        unit: of its values.
    """

    name: str
    unit: str


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class ResultSummary(Displayed):
    """A result without its time histories and matrices.

    Attributes:
        name: for a reader, e.g. the folder it came from.
        modes: every mode, whatever its verdict.
        inputs: channels of the records.
        outputs: channels of the records, in the order of the shapes' components.
        dt: time step of the identified records [s].
        n_samples: of each record.
        choices: every setting, chosen or given.
        fit: cross-validated fit, mean over outputs.
        trust: "carried", "with care" or "not carried".
        degrees_of_freedom: of the residuals behind the standard deviations; infinite where not known.
        data: "file" or "samples", and the SHA-256 of each measured file or of each record's samples; empty where
            neither is known.
    """

    name: str
    modes: tuple[Mode, ...]
    inputs: tuple[ChannelName, ...]
    outputs: tuple[ChannelName, ...]
    dt: float
    n_samples: tuple[int, ...]
    choices: tuple[Choice, ...]
    fit: float
    trust: str
    degrees_of_freedom: float
    data: tuple[str, ...]


def summary_of(result: Identification, *, name: str = "", files: Sequence[str] = ()) -> ResultSummary:
    """The summary of a result in memory.

    Args:
        result: of `modal.identify` or `modal.load`.
        name: for a reader; that of its first record unless given.
        files: SHA-256 of each measured file, where it comes from files.
    """
    record = result.channels
    known, table = result.uncertainty, result.response
    return ResultSummary(
        name=name or record.name or "result",
        modes=result.modes.modes,
        inputs=_channels(record.input_names, record.input_units),
        outputs=_channels(record.output_names, record.output_units),
        dt=result.realisation.dt,
        n_samples=tuple(one.n_samples for one in result.records)
        or (() if result.response is None else (result.response.n_lines,)),
        choices=result.choices,
        fit=result.fit.mean,
        trust=trust_of(result).trust,
        degrees_of_freedom=math.inf if known is None else known.degrees_of_freedom,
        data=tuple(f"file {one}" for one in files)
        or tuple(f"samples {_digest(one.inputs, one.outputs)}" for one in result.records)
        or (() if table is None else (f"lines {_digest(table.frequencies, table.response)}",)),
    )


def read_result(path: str | Path) -> ResultSummary:
    """The summary of a result in a file or folder.

    Args:
        path: a folder that `modal-report run` wrote, or a saved result (.npz).

    Raises:
        UnreadableFileError: no such file, damaged, or no result.
    """
    path = Path(path)
    name, shown = _shown(path.resolve().name if path.name in ("", "..") else path.name), _shown(path)
    try:
        file = path / "result.npz" if path.is_dir() else path
        if not file.is_file():
            what = f"there is no {shown!r}" if file is path else f"{shown!r} holds no {file.name}"
            raise UnreadableFileError(f"{what}; give a folder that modal-report run wrote.")
    except OSError as error:
        raise UnreadableFileError(f"{shown!r} cannot be read ({error.strerror or error}).") from error
    try:
        kept: ResultSummary | None = read_part(file, PART, ResultSummary)
        summary = summary_of(load(file)) if kept is None else kept
        _check(summary)
    except ValueError as error:
        raise UnreadableFileError(
            f"{shown!r} is damaged or no result of modal-report run ({_shown(error).rstrip('.')}); give its folder or "
            "a saved result (.npz)."
        ) from error
    return replace(summary, name=name)


def _check(summary: ResultSummary) -> None:
    """Raise ValueError for what no identification has: a sound file of a stranger may hold anything."""
    n_outputs, n_modes = len(summary.outputs), len(summary.modes)
    if n_modes > MOST_MODES:
        raise ValueError(f"it has {n_modes} modes, more than {MOST_MODES}")
    if not all(np.isfinite([mode.pole, mode.frequency]).all() for mode in summary.modes):
        raise ValueError("a pole is not finite")
    shapes = [shape for mode in summary.modes for shape in (mode.shape, mode.shape_std) if shape is not None]
    if any(shape.shape != (n_outputs,) for shape in shapes):
        raise ValueError("a shape has not one component an output")


def _shown(text: object) -> str:
    return shorten(visible(str(text)), LONGEST_NAME)


def _channels(names: Sequence[str], units: Sequence[str]) -> tuple[ChannelName, ...]:
    return tuple(ChannelName(name=name, unit=unit) for name, unit in zip(names, units, strict=True))


def _digest(*arrays: Any) -> str:
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
