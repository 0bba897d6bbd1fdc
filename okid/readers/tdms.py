"""TDMS of National Instruments: each channel with its unit and waveform step."""

import contextlib
import logging
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from okid.errors import UnreadableFileError
from okid.readers.guard import Damage, check_channel_count, check_memory, foreign, optional_package
from okid.readers.table import Column, LeftOut, Table, unique_names

__all__ = ["read_tdms"]


def read_tdms(path: Path) -> Table:
    """The channels of numbers of a TDMS file, of all its groups.

    Raises:
        UnreadableFileError: damaged, no channel of numbers, or channels of different length or time step.
    """
    nptdms = optional_package("nptdms", path)
    check_memory(path, 3.0 * path.stat().st_size)
    with foreign(path, "TDMS file"), _heard(nptdms) as said:
        found = [channel for group in nptdms.TdmsFile.read(path).groups() for channel in group.channels()]
        series = [(channel, np.asarray(channel[:])) for channel in found]
        if said:  # it would go on with what is left
            raise Damage(said[0])
    usable = [(channel, values) for channel, values in series if values.dtype.kind in "iuf" and values.size]
    if not usable:
        raise UnreadableFileError(f"{path.name} holds no channel of numbers (it has {len(found)} channels).")
    check_channel_count(path, len(usable))
    steps = {(len(values), channel.properties.get("wf_increment")) for channel, values in usable}
    if len(steps) > 1:
        listed = ", ".join(f"{length} samples at {step} s" for length, step in sorted(steps, key=str)[:4])
        raise UnreadableFileError(
            f"the channels of {path.name} have different time axes ({listed}); one file is one record, so export the "
            "channels of one rate."
        )
    ((_, step),) = steps
    return Table(
        path=path,
        format="TDMS",
        columns=_columns([channel for channel, _ in usable]),
        values=np.column_stack([values.astype(np.float64) for _, values in usable]),
        dt=float(step) if step else None,
        start_time=float(usable[0][0].properties.get("wf_start_offset", 0.0)),
        left_out=tuple(
            LeftOut(name=channel.name, reason=f"it holds {values.size} values of {values.dtype}")
            for channel, values in series
            if values.dtype.kind not in "iuf" or not values.size
        ),
    )


@contextlib.contextmanager
def _heard(nptdms: Any) -> Iterator[list[str]]:
    """What npTDMS says in its log in this thread, kept from the terminal: of damage it says no more than that."""
    said: list[str] = []
    thread = threading.get_ident()

    def keep(record: logging.LogRecord) -> bool:
        if record.thread != thread:
            return True
        said.append(record.getMessage())
        return False

    handler = nptdms.log.log_manager.console_handler
    handler.addFilter(keep)
    try:
        yield said
    finally:
        handler.removeFilter(keep)


def _columns(channels: list[Any]) -> tuple[Column, ...]:
    headers = [f"{channel.group_name}/{channel.name}" for channel in channels]
    names = unique_names([channel.name for channel in channels], headers)
    return tuple(
        Column(name=name, unit=str(channel.properties.get("unit_string", "")), header=header)
        for name, header, channel in zip(names, headers, channels, strict=True)
    )
