"""Recorders' own files: TDMS and LVM of National Instruments, MDF 3 and 4 of ASAM, and sound files.

TDMS, LVM and MDF hold each channel with its unit and time step. A sound file holds shares of full scale at a
rate: what full scale means in volts or pascals stands nowhere in it, so its channels have no unit.
"""

import contextlib
import gc
import logging
import sys
import threading
from collections.abc import Iterator
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from okid.errors import InvalidDataError, UnreadableFileError
from okid.readers.clock import uniform_step
from okid.readers.guard import Damage, check_channel_count, check_memory, first_line, foreign, optional_package
from okid.readers.table import Column, LeftOut, Table, unique_names

END_OF_HEADER = "***End_of_Header***"

MEMORY_A_BYTE = 40.0
"""Bytes of memory that a byte of such a file may take: lists of cells, then numbers."""

FULL_SCALE = {"u1": 1 << 7, "i2": 1 << 15, "i4": 1 << 31}
"""Divide whole numbers of a sound file by this; those of 24 bits come in the upper bits of 32."""


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
        raise UnreadableFileError(
            f"{path.name} holds no channel of numbers (it has {len(found)} channels); save it again."
        )
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


def read_mdf(path: Path) -> Table:
    """The channels of numbers of an MDF file that share the time axis with the most values, in physical units.

    What was recorded at other rates, as buses do beside the fast channels, is left out and said.

    Raises:
        UnreadableFileError: damaged, or no channel of numbers.
    """
    asammdf = optional_package("asammdf", path, extra="mdf")
    check_memory(path, MEMORY_A_BYTE * path.stat().st_size)
    with foreign(path, "MDF file"), _opened_mdf(asammdf, path) as file:
        signals = [
            (number, file.get(group=number, index=index))
            for number, group in enumerate(file.groups)
            for index in range(len(group.channels))
            if index != file.masters_db.get(number)
        ]
    usable = [(number, one) for number, one in signals if _is_channel(one)]
    if not usable:
        raise UnreadableFileError(
            f"{path.name} holds no channel of numbers (it has {len(signals)} channels); save it again."
        )
    axes: dict[bytes, list[tuple[int, Any]]] = {}
    for number, one in usable:
        axes.setdefault(np.asarray(one.timestamps, np.float64).tobytes(), []).append((number, one))
    chosen = max(axes.values(), key=lambda group: len(group) * len(group[0][1]))
    check_channel_count(path, len(chosen))
    time = np.asarray(chosen[0][1].timestamps, np.float64)
    names = unique_names([one.name for _, one in chosen], [f"{one.name} {number}" for number, one in chosen])
    taken = {id(one) for _, one in chosen}
    return Table(
        path=path,
        format="MDF",
        columns=(
            Column(name="time", unit="s", header="time"),
            *(
                Column(name=name, unit=str(one.unit or "").strip(), header=name)
                for name, (_, one) in zip(names, chosen, strict=True)
            ),
        ),
        values=np.column_stack([time, *(np.asarray(one.samples, np.float64) for _, one in chosen)]),
        left_out=tuple(
            LeftOut(name=one.name, reason=_why_no_channel(one, len(time))) for _, one in signals if id(one) not in taken
        ),
    )


def _opened_mdf(asammdf: Any, path: Path) -> Any:
    """The file; the library's own clearing up after one that it cannot open prints nothing."""
    hook, sys.unraisablehook = sys.unraisablehook, lambda _: None
    try:
        try:
            return asammdf.MDF(path)
        except Exception as error:  # noqa: BLE001 - whatever a damaged file does to the library
            words = first_line(error)
        gc.collect()  # what it left half made
        raise Damage(words)
    finally:
        sys.unraisablehook = hook


def _is_channel(signal: Any) -> bool:
    return signal.samples.dtype.kind in "iuf" and signal.samples.ndim == 1 and len(signal) > 0


def _why_no_channel(signal: Any, n_samples: int) -> str:
    if not _is_channel(signal):
        return f"it holds {len(signal)} values of {signal.samples.dtype}"
    return (
        f"it has {len(signal)} samples at times of its own beside the {n_samples} of the channels read; one file is "
        "one record, so export it by itself"
    )


def read_lvm(path: Path) -> Table:
    """The channels of a LabVIEW measurement file, a text with a header for the file and one for its segment.

    Raises:
        UnreadableFileError: another kind of text, several segments, or channels of different length or time step.
    """
    check_memory(path, MEMORY_A_BYTE * path.stat().st_size)
    with foreign(path, "LabVIEW measurement file"):
        text = path.read_bytes().decode("utf-8-sig", errors="replace")
        lines = text.splitlines()
        if not lines or not lines[0].startswith("LabVIEW Measurement"):
            raise Damage(f"it begins with {text[:30]!r} instead of 'LabVIEW Measurement'")
        ends = [at for at, line in enumerate(lines) if line.strip().startswith(END_OF_HEADER)]
        if len(ends) < 2:
            raise Damage(f"it has {len(ends)} of two headers")
        separator = (
            "," if any(line.replace(",", "\t").split("\t")[:2] == ["Separator", "Comma"] for line in lines) else "\t"
        )
        of_file = _fields(lines[: ends[0]], separator)
        segment = _fields(lines[ends[0] + 1 : ends[1]], separator)
    if len(ends) > 2:
        raise UnreadableFileError(
            f"{path.name} holds {len(ends) - 1} segments, each with a header of its own; one file is one record, so "
            "save each segment as a file, or write one header only."
        )
    with foreign(path, "LabVIEW measurement file"):
        n_channels = int(segment["Channels"][0])
        check_channel_count(path, n_channels)
        decimal = of_file.get("Decimal_Separator", ["."])[0]
        several = of_file.get("X_Columns", ["One"])[0] == "Multi"
        heads = lines[ends[1] + 1].split(separator)
        first = [k for k, head in enumerate(heads) if head.strip() not in ("X_Value", "Comment")][:n_channels]
        if len(first) != n_channels or (several and heads.count("X_Value") != n_channels):
            raise Damage(f"its header promises {n_channels} channels, its table has {len(first)}")
        steps, counts = (
            set(_numbers(segment.get("Delta_X", []), decimal)[:n_channels]),
            set(segment.get("Samples", [])[:n_channels]),
        )
        if len(steps) > 1 or len(counts) > 1:
            raise Damage(f"its channels have different time steps ({sorted(steps)}) or lengths ({sorted(counts)})")
        rows = [line.split(separator) for line in lines[ends[1] + 2 :] if line.strip()]
        values = np.array([_numbers([row[k] for k in first], decimal) for row in rows])
        promised = [int(count) for count in counts]
        if promised and len(values) != promised[0]:
            raise Damage(f"its header promises {promised[0]} samples, it has {len(values)}")
    names = [heads[k].strip() for k in first]
    units = [_lvm_unit(label) for label in segment.get("Y_Unit_Label", [])] + [""] * n_channels
    unique = unique_names(names, [f"{name} {k}" for k, name in enumerate(names)])
    step = steps.pop() if steps else None
    cells = [row[heads.index("X_Value")].replace(decimal, ".") for row in rows] if "X_Value" in heads else []
    counted, off, why = _step_of_lvm(cells) if any(map(str.strip, cells)) else (None, 0.0, "")
    stated = [("Delta_X", step)] if step else []
    if counted and abs(counted - (step or 0.0)) > off:
        stated.append(("X_Value", counted))
    return Table(
        path=path,
        format="LVM",
        steps=tuple(stated),
        columns=tuple(Column(name=name, unit=unit, header=name) for name, unit in zip(unique, units, strict=False)),
        values=values,
        dt=step or counted,
        start_time=next(iter(_numbers(segment.get("X0", []), decimal)), 0.0),
        left_out=(LeftOut(name="X_Value", reason=why),) if why and not step else (),
    )


def _step_of_lvm(cells: list[str]) -> tuple[float | None, float, str]:
    """The step of the column X_Value, how far its digits let it be off, and why it has none."""
    try:
        step, within = uniform_step(np.array(_numbers(cells)), 1.0, "X_Value")
    except ValueError as error:  # one of okid's says it in words
        return None, 0.0, str(error).rstrip(".") if isinstance(error, InvalidDataError) else "it holds text"
    last_digit = min(int(Decimal(cell.strip()).as_tuple().exponent) for cell in cells)
    return step, max(within, 10.0**last_digit / (len(cells) - 1)), ""


def _fields(lines: list[str], separator: str) -> dict[str, list[str]]:
    """The cells behind the first one of each line."""
    cells = [line.split(separator) for line in lines]
    return {row[0].strip(): [cell.strip() for cell in row[1:] if cell.strip()] for row in cells if len(row) > 1}


def _numbers(cells: list[str], decimal: str = ".") -> list[float]:
    return [float(cell.replace(decimal, ".")) if cell.strip() else np.nan for cell in cells]


def _lvm_unit(label: str) -> str:
    """LabVIEW writes whole words with a capital: Volts, Newtons."""
    return label.lower() if len(label) > 3 and label.isalpha() else label


def read_wav(path: Path) -> Table:
    """The channels of a sound file as shares of full scale.

    Raises:
        UnreadableFileError: damaged, cut off, or compressed.
    """
    check_memory(path, MEMORY_A_BYTE * path.stat().st_size)
    with foreign(path, "WAV file"):
        with path.open("rb") as file:
            head = file.read(12)
        if head[:4] not in (b"RIFF", b"RF64") or head[8:12] != b"WAVE":
            raise Damage(f"it begins with {head[:12]!r}")
        promised = int.from_bytes(head[4:8], "little") + 8
        if head[:4] == b"RIFF" and promised > path.stat().st_size:
            raise Damage(f"its header promises {promised} bytes, it has {path.stat().st_size}")
        from scipy.io import wavfile  # only where a sound file is read

        rate, samples = wavfile.read(path)
        values = np.asarray(samples).reshape(len(samples), -1)
        check_channel_count(path, values.shape[1])
        kind = values.dtype.str[1:]
        scaled = values.astype(np.float64)
        if kind in FULL_SCALE:
            scaled = (scaled - (FULL_SCALE[kind] if kind == "u1" else 0)) / FULL_SCALE[kind]
        elif values.dtype.kind != "f":
            raise Damage(f"its samples are {values.dtype}")
    columns = tuple(Column(name=f"channel_{k}") for k in range(scaled.shape[1]))
    return Table(path=path, format="WAV", columns=columns, values=scaled, dt=1.0 / rate)


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
