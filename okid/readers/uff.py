"""Universal files, data sets 58 and 58b: each time history in a file is one channel.

pyuff finds and decodes the data sets, but takes what it gets: it returns fewer values than a cut-off set announces, and
passes over a last set that is not closed. Both are checked here.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from okid.arrays import FloatArray
from okid.errors import UnreadableFileError
from okid.readers.guard import check_channel_count, check_memory, first_line, optional_package
from okid.readers.table import Column, LeftOut, Table
from okid.readers.units import convert_unit

__all__ = ["read_uff"]

MEMORY_A_BYTE = 8.0
TIME_RESPONSE = 1
ABSCISSA_TIME = 17
SET_58 = 58
SET_164 = 164
REAL_ORDINATES = (2, 4)

FUNCTION_TYPES = {
    0: "general function",
    1: "complex time response",
    2: "auto spectrum",
    3: "cross spectrum",
    4: "frequency response function",
    5: "transmissibility",
    6: "coherence",
    7: "auto correlation",
    8: "cross correlation",
    9: "power spectral density",
    10: "energy spectral density",
    12: "spectrum",
}
DIRECTIONS = ("", "X", "Y", "Z", "RX", "RY", "RZ")
SI_OF_DATA_TYPE = {8: "m", 11: "m/s", 12: "m/s^2", 13: "N", 15: "Pa"}
"""Unit in SI of the specific data types that are measured in a modal test."""

Set = Mapping[str, Any]
"""One data set as pyuff returns it."""


def read_uff(path: Path) -> Table:
    """The time histories of a universal file as channels, named by node and direction ("12X+").

    Raises:
        UnreadableFileError: cut off, no time history in it, or time histories of different length or time step.
    """
    pyuff = optional_package("pyuff", path)
    check_memory(path, MEMORY_A_BYTE * path.stat().st_size)
    _check_end(path)
    file = _guarded(path, lambda: pyuff.UFF(str(path)))
    kinds = [int(kind) for kind in file.get_set_types()]
    check_channel_count(path, kinds.count(SET_58))
    heads = {number: _read_set(file, number, path, header_only=True) for number in _numbers_of(kinds, SET_58)}
    chosen = [number for number, head in heads.items() if _is_time_history(head)]
    if not chosen:
        raise UnreadableFileError(_what_it_holds(path, kinds, list(heads.values())))
    sets = [_read_set(file, number, path, header_only=False) for number in chosen]
    ordinates = [_ordinate(each, path) for each in sets]
    names = _names(sets)
    _check_same_axis(sets, names, path)
    is_si = any(_states_si(_read_set(file, number, path, header_only=False)) for number in _numbers_of(kinds, SET_164))
    columns = [
        Column(name=name, unit=_unit(each, is_si=is_si), header=name) for name, each in zip(names, sets, strict=True)
    ]
    step, start_time = None, 0.0
    if sets[0]["abscissa_spacing"] == 1:
        factor = convert_unit("time", _label(sets[0], "abscissa_axis_units_lab")).factor
        step, start_time = factor * sets[0]["abscissa_inc"], factor * sets[0]["abscissa_min"]
    else:
        columns.insert(0, Column(name="time", unit=_label(sets[0], "abscissa_axis_units_lab"), header="time"))
        ordinates.insert(0, np.asarray(sets[0]["x"][: len(ordinates[0])], dtype=np.float64))
    left_out = [
        LeftOut(name=f"data set {number + 1}", reason=f"it is a {_kind(head)}, not a time history")
        for number, head in heads.items()
        if number not in chosen
    ]
    return Table(
        path=path,
        format="universal file",
        columns=tuple(columns),
        values=np.column_stack(ordinates),
        dt=step,
        start_time=start_time,
        left_out=tuple(left_out),
    )


def _guarded(path: Path, read: Callable[[], Any]) -> Any:
    try:
        return read()
    except Exception as error:  # pyuff raises bare Exception for everything
        raise UnreadableFileError(
            f"{path.name} is damaged or is no universal file ({first_line(error)}); export it again."
        ) from error


def _read_set(file: Any, number: int, path: Path, *, header_only: bool) -> Set:
    result: Set = _guarded(path, lambda: file.read_sets(number, header_only=header_only))
    return result


def _numbers_of(kinds: Sequence[int], kind: int) -> list[int]:
    return [number for number, each in enumerate(kinds) if each == kind]


def _check_end(path: Path) -> None:
    """A whole file ends with the line that closes its last data set."""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - 256))
        end = file.read().rstrip(b" \t\r\n\0\x1a")
    if not end.endswith(b"    -1"):
        raise UnreadableFileError(
            f"{path.name} does not end with the line -1 that closes a data set: it is cut off or no universal file; "
            "copy or export it again."
        )


def _kind(head: Set) -> str:
    return FUNCTION_TYPES.get(head["func_type"], f"function of type {head['func_type']}")


def _is_time_history(head: Set) -> bool:
    """Type 1, or a function of unknown type over time, as some analysers write."""
    over_time = head["func_type"] == 0 and head["abscissa_spec_data_type"] == ABSCISSA_TIME
    return head["ord_data_type"] in REAL_ORDINATES and (head["func_type"] == TIME_RESPONSE or over_time)


def _what_it_holds(path: Path, kinds: Sequence[int], heads: Sequence[Set]) -> str:
    if heads:
        counts = Counter(_kind(head) for head in heads)
        held = ", ".join(f"{count} of the kind {kind}" for kind, count in counts.items())
        return (
            f"{path.name} holds no time history, but {held}; identification needs the measured inputs and outputs "
            "themselves, so export the time histories (function type 1)."
        )
    sets = ", ".join(map(str, sorted(set(kinds)))) or "none"
    return f"{path.name} holds no data set 58 (its sets: {sets}), so no measurement; export time histories as set 58."


def _ordinate(data_set: Set, path: Path) -> FloatArray:
    announced, values = int(data_set["num_pts"]), np.asarray(data_set["data"], dtype=np.float64)
    if announced < 1 or len(values) < announced:
        raise UnreadableFileError(
            f"a data set of {path.name} announces {announced} samples but holds {len(values)}: the file is cut off or "
            "damaged; copy or export it again."
        )
    return values[:announced]  # line ends after binary data may look like one value more


def _check_same_axis(sets: Sequence[Set], names: Sequence[str], path: Path) -> None:
    first = sets[0]
    for other, name in zip(sets[1:], names[1:], strict=True):
        keys = ("num_pts", "abscissa_spacing", "abscissa_inc", "abscissa_min")
        differing = [key for key in keys if other[key] != first[key]]
        same_times = first["abscissa_spacing"] == 1 or np.array_equal(first["x"], other["x"])
        if differing or not same_times:
            key = differing[0] if differing else "x"
            words = {"num_pts": "samples", "abscissa_inc": "s as time step", "abscissa_min": "s as start"}
            numbers = f": {first[key]} and {other[key]} {words[key]}" if key in words else ""
            raise UnreadableFileError(
                f"channels {names[0]!r} and {name!r} of {path.name} have different time axes{numbers}; one file is one "
                "record, so export them with the same length and rate."
            )


def _names(sets: Sequence[Set]) -> list[str]:
    """The first way that tells all sets apart: node and direction, these and the quantity, entity, first line."""
    ways: list[list[str]] = [
        [_place(each) for each in sets],
        [_place(each) and f"{_place(each)} {_label(each, 'ordinate_axis_lab')}".strip() for each in sets],
        [_text(each["rsp_ent_name"]) for each in sets],
        [_text(each["id1"]) for each in sets],
    ]
    for names in ways:
        if all(names) and len(set(names)) == len(names):
            return names
    return [f"{_place(each) or 'channel'}_{number}" for number, each in enumerate(sets)]


def _place(data_set: Set) -> str:
    node, direction = int(data_set["rsp_node"]), int(data_set["rsp_dir"])
    if node <= 0 or not 0 <= abs(direction) < len(DIRECTIONS):
        return ""
    sign = "" if direction == 0 else "+" if direction > 0 else "-"
    return f"{node}{DIRECTIONS[abs(direction)]}{sign}"


def _text(value: object) -> str:
    text = "".join(letter if letter.isprintable() else " " for letter in str(value)).strip()
    return "" if text.upper() == "NONE" else text


def _label(data_set: Set, key: str) -> str:
    return _text(data_set.get(key, ""))


def _unit(data_set: Set, *, is_si: bool) -> str:
    """The axis label; without one the unit of the quantity, if the file says that its numbers are in SI."""
    label = _label(data_set, "ordinate_axis_units_lab")
    return label or (SI_OF_DATA_TYPE.get(int(data_set["ordinate_spec_data_type"]), "") if is_si else "")


def _states_si(units: Set) -> bool:
    return all(units.get(key) == 1.0 for key in ("length", "force"))
