"""What must hold of the parts of a record; each check raises one sentence that says what to change."""

from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt

from okid.arrays import FloatArray, row_chunks, time_major
from okid.errors import InvalidDataError

__all__ = ["as_inputs", "channel_indices", "check_lengths", "check_names", "check_not_empty", "labels"]


def as_inputs(values: npt.ArrayLike, n_samples: int) -> FloatArray:
    """The inputs as an array; nothing at all means no inputs, (n_samples, 0)."""
    inputs = time_major(values, name="inputs")
    return inputs if inputs.size else time_major(np.empty((n_samples, 0)), name="inputs")


def check_lengths(inputs: FloatArray, outputs: FloatArray) -> None:
    """Raise unless there are samples and outputs, as many rows of both, and no more channels than rows."""
    if outputs.shape[1] == 0 or len(outputs) == 0:
        raise InvalidDataError(
            f"a record needs at least one output and one sample, but its outputs have the shape {outputs.shape}."
        )
    if inputs.shape[0] != outputs.shape[0]:
        raise InvalidDataError(
            f"inputs have {inputs.shape[0]} samples and outputs {outputs.shape[0]}; both must cover the same rows."
        )
    for kind, array in (("inputs", inputs), ("outputs", outputs)):
        n_samples, n_channels = array.shape
        if n_channels > n_samples:
            raise InvalidDataError(
                f"{kind} have {n_channels} channels but only {n_samples} samples; rows are samples, so pass {kind}.T."
            )


def labels(given: Sequence[str] | None, count: int, kind: str, *, named: bool) -> tuple[str, ...]:
    """The names or units of the channels: those given, else input_0, ... or empty units."""
    what = "names" if named else "units"
    if isinstance(given, str):
        given = (given,)
    if given is not None and not isinstance(given, Iterable):
        raise InvalidDataError(f"{kind} {what} must be a sequence of words, one for each channel, but are {given!r}.")
    given = () if given is None else tuple(given)
    if len(given) == 0:
        return tuple(f"{kind}_{i}" if named else "" for i in range(count))
    if len(given) != count:
        raise InvalidDataError(f"{len(given)} {kind} {what} were given for {count} {kind}s; give one for each channel.")
    return tuple(str(label) for label in given)


def check_names(names: tuple[str, ...]) -> None:
    """Raise if a channel name stands more than once."""
    double = sorted(name for name, count in Counter(names).items() if count > 1)
    if double:
        raise InvalidDataError(
            f"channel names must be unique, but {', '.join(map(repr, double))} stand more than once."
        )


def check_not_empty(array: FloatArray, names: tuple[str, ...], kind: str) -> None:
    """Raise if a channel is missing in every sample; a mapped file is read only as far as needed."""
    seen = np.zeros(array.shape[1], dtype=np.bool_)
    for rows in row_chunks(*array.shape):
        seen |= ~np.isnan(array[rows]).all(axis=0)
        if seen.all():
            return
    empty = ", ".join(repr(name) for name, any_number in zip(names, seen, strict=True) if not any_number)
    if empty:
        raise InvalidDataError(f"{kind} {empty} holds no number in any of its {array.shape[0]} samples; leave it out.")


def channel_indices(chosen: Sequence[str | int] | None, names: tuple[str, ...], kind: str) -> list[int]:
    """Indices of channels given by name or index; None means all."""
    if chosen is None:
        return list(range(len(names)))
    if isinstance(chosen, str):
        chosen = [chosen]
    indices = []
    for channel in chosen:
        if isinstance(channel, str) and channel in names:
            indices.append(names.index(channel))
        elif not isinstance(channel, str) and 0 <= channel < len(names):
            indices.append(int(channel))
        else:
            raise InvalidDataError(f"there is no {kind} {channel!r}; the {kind}s are {', '.join(names) or 'none'}.")
    return indices
