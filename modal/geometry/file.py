"""A geometry from a file: a small TOML that somebody writes by hand, or a universal file from an analyser.

    unit = "mm"                            # of the positions; "m" unless given
    lines = [[1, 2, 3], [4, 5, 6]]         # nodes along each line
    surfaces = [[1, 2, 5, 4]]              # corners in turn; may be left out
    fixed = [1]                            # nodes known to stand still
    rigid = [[2, 5], [3, 6]]               # nodes of each body that moves as one, such as a floor

    [nodes]
    1 = [0, 0, 0]
    2 = [0, 0, 350]

    [sensors]                              # only for channels that are not named like 2X+
    acc_top = "3X+"
    skew = { node = 3, direction = [1, 1, 0] }
    gyro = { node = 3, direction = [0, 0, 1], motion = "about" }

The same keys make the table [geometry] of a test file. Nodes are named by words or whole numbers. What is not known is
an error that says what was meant to stand there; nothing is guessed.
"""

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from modal.geometry.sensors import Geometry, GeometryLimits, Sensor, dof_of, node_numbers
from modal.geometry.uff import read_uff_geometry
from modal.wording.text import shorten
from okid.errors import InvalidDataError, UnreadableFileError, visible
from okid.readers.guard import check_file, first_line

MOST_TEXT: Final = 1 << 24
"""Refuse a file in TOML of more bytes: 16 MiB, a geometry of some hundred thousand nodes."""

UNITS: Final = {
    "m": 1.0,
    "mm": 1e-3,
    "cm": 1e-2,
    "km": 1e3,
    "um": 1e-6,
    "µm": 1e-6,
    "μm": 1e-6,
    "in": 0.0254,
    "ft": 0.3048,
}
"""Metres in one unit of length."""

UFF_ENDINGS: Final = (".uff", ".unv", ".uf", ".ufb", ".u58")
_KEYS: Final = ("unit", "nodes", "lines", "surfaces", "fixed", "rigid", "sensors")
_SENSOR_KEYS: Final = ("node", "direction", "motion")


def read_geometry(path: str | Path) -> Geometry:
    """Nodes, lines and sensors from a file.

    Args:
        path: of a TOML file, or of a universal file with data sets 15 or 2411 (nodes), and, where it holds them, 82
            (lines), 2412 (elements), 18 or 2420 (coordinate systems) and 164 (units). A file that ends in .uff, .unv,
            .uf, .ufb or .u58, or begins with the line -1, is a universal file.

    Raises:
        UnreadableFileError: no such file, too large, neither of the two formats, or a universal file without nodes.
        InvalidDataError: a key that is not known, a line to an unknown node, a channel twice, a position that is no
            finite number.
    """
    path = check_file(path)
    if _is_universal(path):
        return read_uff_geometry(path)
    name = shorten(visible(path.name), 80)
    if (size := path.stat().st_size) > MOST_TEXT:
        raise UnreadableFileError(
            f"{name} has {size} bytes, and a geometry in TOML at most {MOST_TEXT}; keep fewer nodes."
        )
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise UnreadableFileError(f"{name} cannot be read ({error.strerror or error}).") from error
    except (ValueError, RecursionError) as error:  # UnicodeDecodeError and TOMLDecodeError are ValueErrors
        raise UnreadableFileError(
            f"{name} is neither a universal file nor TOML ({first_line(error)}); correct it at that place."
        ) from error
    if set(table) == {"geometry"} and isinstance(table["geometry"], dict):
        table = table["geometry"]
    return geometry_of_table(table, name)


def _is_universal(path: Path) -> bool:
    if path.suffix.lower() in UFF_ENDINGS:
        return True
    with path.open("rb") as file:
        return file.read(256).lstrip(b"\xef\xbb\xbf\r\n").startswith(b"    -1")


def geometry_of_table(mapping: Mapping[str, Any], where: str) -> Geometry:
    """The geometry that a table of plain values describes.

    Args:
        mapping: with the keys of the module's example; only nodes must be there.
        where: what to call the table in an error, such as a file name.

    Raises:
        InvalidDataError: see `read_geometry`.

    Example:
        >>> geometry_of_table({"unit": "mm", "nodes": {"1": [0, 0, 500]}}, "here").positions.tolist()
        [[0.0, 0.0, 0.5]]
    """
    if not isinstance(mapping, Mapping):
        raise InvalidDataError(f"the geometry in {where} must be a table, but is {_quoted(mapping)}.")
    unknown = [str(key) for key in mapping if key not in _KEYS]
    if unknown:
        raise InvalidDataError(
            f"the geometry in {where} has no key {_quoted(unknown[0])}; the keys are {', '.join(_KEYS)}."
        )
    unit = mapping.get("unit", "m")
    if not isinstance(unit, str) or unit not in UNITS:
        raise InvalidDataError(f"unit in {where} must be one of {', '.join(UNITS)}, but is {_quoted(unit)}.")
    nodes = mapping.get("nodes")
    if not isinstance(nodes, Mapping) or not nodes:
        raise InvalidDataError(f"the geometry in {where} needs a table [nodes] with lines such as 1 = [0, 0, 350].")
    if len(nodes) > GeometryLimits.MOST_NODES:
        raise InvalidDataError(
            f"the geometry in {where} has {len(nodes)} nodes, and may have {GeometryLimits.MOST_NODES}; keep fewer."
        )
    names = tuple(str(name) for name in nodes)
    positions = [_three_numbers(place, f"node {_quoted(name)} in {where}") for name, place in nodes.items()]
    find = _finder(names, where)
    without_sensors = Geometry(
        node_names=names,
        positions=UNITS[unit] * np.array(positions),
        lines=_parts(mapping, "lines", find, where),
        surfaces=_parts(mapping, "surfaces", find, where),
        fixed=tuple(find(node, "fixed") for node in _list(mapping.get("fixed", ()), "fixed", where)),
        rigid=_parts(mapping, "rigid", find, where),
    )
    sensors = mapping.get("sensors", {})
    if not isinstance(sensors, Mapping):
        raise InvalidDataError(
            f'sensors in {where} must be a table of channels, such as acc_top = "3X+", but is {_quoted(sensors)}.'
        )
    made = [_sensor(str(channel), given, without_sensors, find, where) for channel, given in sensors.items()]
    return replace(without_sensors, sensors=tuple(made))


def _finder(names: Sequence[str], where: str) -> Callable[[Any, str], int]:
    numbers = node_numbers(names)

    def find(node: Any, part: str) -> int:
        text = str(node) if isinstance(node, int | str) and not isinstance(node, bool) else None
        index = None if text is None else numbers.get(text)
        if index is None:
            raise InvalidDataError(
                f"{part} in {where} names node {_quoted(node)}, which is not among the {len(names)} nodes "
                f"({_some(names)}); add the node or correct its name."
            )
        return index

    return find


def _parts(
    mapping: Mapping[str, Any], key: str, find: Callable[[Any, str], int], where: str
) -> tuple[tuple[int, ...], ...]:
    parts = []
    for number, part in enumerate(_list(mapping.get(key, ()), key, where), start=1):
        place = f"part {number} of {key}"
        parts.append(tuple(find(node, place) for node in _list(part, place, where)))
    return tuple(parts)


def _list(value: Any, what: str, where: str) -> Sequence[Any]:
    if not isinstance(value, Sequence) or isinstance(value, str):
        raise InvalidDataError(f"{what} in {where} must be a list of nodes such as [1, 2, 3], but is {_quoted(value)}.")
    return value


def _sensor(channel: str, given: Any, geometry: Geometry, find: Callable[[Any, str], int], where: str) -> Sensor:
    place = f"sensor {_quoted(channel)}"
    if isinstance(given, str):
        dof = dof_of(given)
        if dof is None:
            raise InvalidDataError(
                f'{place} in {where} must state a node and an axis such as "3X+" or "3-Y", but is {_quoted(given)}.'
            )
        stated = geometry.sensors_of([given])[0]
        node = find(dof.node, place) if stated is None else stated.node
        direction = dof.sign * np.eye(3)[dof.axis] if stated is None else stated.direction
        return Sensor(name=channel, node=node, direction=direction, motion=dof.motion)
    if not isinstance(given, Mapping) or not {"node", "direction"} <= set(given) <= set(_SENSOR_KEYS):
        raise InvalidDataError(
            f'{place} in {where} must be a name such as "3X+", or a table of node, direction and, where needed, '
            f"motion, but is {_quoted(given)}."
        )
    direction = np.array(_three_numbers(given["direction"], f"the direction of {place} in {where}"))
    motion = given.get("motion", "along")
    return Sensor(name=channel, node=find(given["node"], place), direction=direction, motion=motion)


def _three_numbers(value: Any, what: str) -> list[float]:
    is_list = isinstance(value, Sequence) and not isinstance(value, str) and len(value) == 3
    if not is_list or not all(isinstance(part, int | float) and not isinstance(part, bool) for part in value):
        raise InvalidDataError(f"{what} must be three numbers such as [0, 0, 350], but is {_quoted(value)}.")
    try:
        return [float(part) for part in value]
    except OverflowError:
        raise InvalidDataError(f"{what} holds a number too large for a coordinate; correct it.") from None


def _quoted(value: object) -> str:
    """The value as a sentence may show it: visible, and of bounded length."""
    text = value if isinstance(value, str) else repr(value) if not isinstance(value, int) else str(value)[:60]
    return repr(shorten(visible(text), 60)) if isinstance(value, str) else shorten(visible(text), 60)


def _some(names: Sequence[str]) -> str:
    shown = [shorten(visible(name), 20) for name in names[:6]]
    return ", ".join(shown) + (", …" if len(names) > len(shown) else "")
