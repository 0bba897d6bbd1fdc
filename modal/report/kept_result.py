"""The result itself beside its report, so that it can be loaded, compared and drawn again."""

from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np

from modal.identification.result import Identification

__all__ = ["LARGEST_KEPT", "keep_result", "kept_size"]

LARGEST_KEPT = 1 << 27
"""Bytes: 128 MiB, a record of 8 channels and 700 000 samples with its two simulations. Above, the report's JSON keeps
every number but the time histories, which can be made again from the measured files."""


def kept_size(result: Identification) -> int:
    """Bytes of the arrays of a result, each counted once."""
    sizes: dict[int, int] = {}
    _add_sizes(result, sizes)
    return sum(sizes.values())


def keep_result(result: Identification, path: Path) -> Path | None:
    """Write the result with `Identification.save`; nothing where it would be larger than `LARGEST_KEPT`.

    Args:
        result: of `modal.identify`.
        path: of a file that is not there.

    Returns:
        The path, or None where nothing was written.

    Raises:
        InvalidDataError: the file exists or cannot be written.
    """
    return result.save(path) if kept_size(result) <= LARGEST_KEPT else None


def _add_sizes(value: object, sizes: dict[int, int]) -> None:
    if isinstance(value, np.ndarray):
        sizes[id(value)] = value.nbytes
    elif isinstance(value, tuple):
        for item in value:
            _add_sizes(item, sizes)
    elif is_dataclass(value):
        for field in fields(value):
            _add_sizes(getattr(value, field.name), sizes)
