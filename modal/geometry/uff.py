"""Nodes, lines and axes out of a universal file.

Read are the data sets 15, 781 and 2411 (nodes), 82 (trace lines), 2412 (elements), 18 and 2420 (coordinate systems) and
164 (units). The file is read line by line; data sets of measurements, binary ones as well, are passed over, so a file
of any size costs little memory. Positions are divided by the length factor of set 164, as that set asks; without one
they are metres. Where a node's displacements are given in a coordinate system that the file holds, its X, Y and Z are
the axes of that system, for a cylindrical one the radial, tangential and axial direction at the node; a system that the
file does not hold counts as the global one. The nodes of set 15 may be given in such a system themselves, with angles
in degrees.

References:
    Structural Dynamics Research Corporation, Universal file datasets; University of Cincinnati, SDRL, Universal File
    Formats for Modal Analysis Testing.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final, Literal

import numpy as np

from modal.geometry.sensors import Geometry, GeometryLimits
from modal.wording.text import shorten
from okid.arrays import FloatArray
from okid.errors import InvalidDataError, UnreadableFileError, visible


def whole_numbers(line: str, at_least: int = 0) -> list[int]:
    """The whole numbers on a line, in fields of ten characters or parted by spaces.

    Raises:
        ValueError: fewer than `at_least`, or a field that is no whole number.

    Example:
        >>> whole_numbers("         1         2"), whole_numbers("12345678901234567890", 2)
        ([1, 2], [1234567890, 1234567890])
    """
    fields = line.split()
    if len(fields) < at_least or any(len(field) > 10 for field in fields):
        fields = _cut(line, 10)
    if len(fields) < at_least:
        raise ValueError(f"{len(fields)} whole numbers on a line that has {at_least}")
    try:
        return [int(_plain(field)) for field in fields]
    except ValueError:
        raise ValueError(f"{line.strip()[:40]!r} where whole numbers stand") from None


def numbers(line: str, count: int, *, width: int) -> list[float]:
    """The first `count` numbers on a line, in fields of `width` characters or parted by spaces; `D` marks an exponent.

    Raises:
        ValueError: fewer numbers, or a field that is none.

    Example:
        >>> numbers("  1.50000D+00 -2.00000D+00", 2, width=13)
        [1.5, -2.0]
    """
    fields = line.split()
    if len(fields) < count or any(len(field) > width for field in fields):
        fields = _cut(line, width)
    if len(fields) < count:
        raise ValueError(f"{len(fields)} numbers on a line that has {count}")
    try:
        found = [float(_plain(field).replace("D", "E").replace("d", "e")) for field in fields[:count]]
    except ValueError:
        raise ValueError(f"{line.strip()[:40]!r} where numbers stand") from None
    if not all(map(math.isfinite, found)):
        raise ValueError("a number that is not finite")
    return found


def _plain(field: str) -> str:
    """The field, unless only Python would take it for a number: "14_0", or digits of another script."""
    if "_" in field or not field.isascii():
        raise ValueError(field)
    return field


def _cut(line: str, width: int) -> list[str]:
    fields = [line[start : start + width].strip() for start in range(0, len(line), width)]
    return [field for field in fields if field]


KINDS: Final[tuple[Literal["cartesian", "cylindrical"], ...]] = ("cartesian", "cylindrical")
ROUND: Final = 1e-3
"""Refuse three axes that are further from right angles and unit length: the file is damaged."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CoordinateSystem:
    """Where a system stands in the global one.

    Attributes:
        kind: "cartesian" or "cylindrical".
        origin: (3,).
        axes: (3, 3) directions of X, Y and Z, one a row.

    Example:
        >>> around = CoordinateSystem(kind="cylindrical", origin=np.zeros(3), axes=np.eye(3))
        >>> around.position(np.array([2.0, 90.0, 1.0])).round(12).tolist()
        [0.0, 2.0, 1.0]
        >>> around.axes_at(np.array([0.0, 2.0, 1.0]))[0].round(12).tolist()
        [0.0, 1.0, 0.0]
    """

    kind: Literal["cartesian", "cylindrical"]
    origin: FloatArray
    axes: FloatArray

    def position(self, place: FloatArray) -> FloatArray:
        """Global position of x, y, z, or of radius, angle [deg] and height."""
        if self.kind == "cylindrical":
            angle = np.deg2rad(place[1])
            place = np.array([place[0] * np.cos(angle), place[0] * np.sin(angle), place[2]])
        return np.asarray(self.origin + place @ self.axes, dtype=np.float64)

    def axes_at(self, position: FloatArray) -> FloatArray:
        """(3, 3) the directions in which displacements are counted at a global position, one a row."""
        if self.kind == "cartesian":
            return self.axes
        x, y, _ = self.axes @ (position - self.origin)
        angle = np.arctan2(y, x)  # 0 on the axis itself, where no radius has a direction
        turn = np.array([[np.cos(angle), np.sin(angle), 0.0], [-np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
        return np.asarray(turn @ self.axes, dtype=np.float64)


def systems_of_set_18(lines: Sequence[str], known: Mapping[int, CoordinateSystem]) -> dict[int, CoordinateSystem]:
    """Systems given by an origin, a point on X and a point in the plane of X and Z.

    Args:
        lines: of the data set: four a system.
        known: systems that these may refer to.

    Raises:
        InvalidDataError: a system that is neither cartesian nor cylindrical, or whose axes are none.
        ValueError: a line without its numbers.
    """
    filled = [line for number, line in enumerate(lines) if number % 4 == 1 or line.strip()]
    found = dict(known)
    for start in range(0, len(filled) - 3, 4):
        label, kind, reference = whole_numbers(filled[start], 3)[:3]
        values = numbers(filled[start + 2], 6, width=13) + numbers(filled[start + 3], 3, width=13)
        points = np.array(values).reshape(3, 3)
        if reference in found:
            points = np.array([found[reference].position(point) for point in points])
        along, beside = points[1] - points[0], points[2] - points[0]
        across = np.cross(beside, along)  # Z x X = Y
        with np.errstate(invalid="ignore", divide="ignore"):
            x, y = along / np.linalg.norm(along), across / np.linalg.norm(across)
        found[label] = _system(label, kind, points[0], np.array([x, y, np.cross(x, y)]))
    return found


def systems_of_set_2420(lines: Sequence[str]) -> dict[int, CoordinateSystem]:
    """Systems given by three rows of axes and one of the origin.

    Args:
        lines: of the data set: two for the part, then six a system.

    Raises:
        InvalidDataError: a system that is neither cartesian nor cylindrical, or whose axes are none.
        ValueError: a line without its numbers.
    """
    found = {}
    for start in range(2, len(lines) - 5, 6):
        label, kind = whole_numbers(lines[start], 2)[:2]
        rows = np.array([numbers(line, 3, width=25) for line in lines[start + 2 : start + 6]])
        found[label] = _system(label, kind, rows[3], rows[:3])
    return found


def _system(label: int, kind: int, origin: FloatArray, axes: FloatArray) -> CoordinateSystem:
    if kind not in (0, 1):
        raise InvalidDataError(
            f"coordinate system {label} is of kind {kind}, and only cartesian (0) and cylindrical (1) ones are read; "
            "export the displacements in one of these."
        )
    if not np.abs(axes @ axes.T - np.eye(3)).max() < ROUND:
        raise InvalidDataError(
            f"the axes of coordinate system {label} are not of unit length and at right angles; export it again."
        )
    return CoordinateSystem(kind=KINDS[kind], origin=origin, axes=axes)


class GeometrySets:
    """Data sets that hold a geometry, and how much of them is read."""

    WANTED: Final = (15, 2411, 781, 82, 2412, 18, 2420, 164)
    """Read these data sets and pass over all others."""
    LONGEST_LINE: Final = 4096
    """Refuse a file with a line of so many bytes: universal files have lines of 80, and a hole never ends."""
    MOST_LINES: Final = 1_000_000
    """Refuse a file whose data sets of a geometry have more lines."""
    BEAMS: Final = (11, 21, 22, 23, 24)
    """Pass over a line for these elements of set 2412: it tells their orientation, before that of their nodes."""
    SHELLS: Final = range(40, 100)
    """Take these elements of set 2412 for surfaces."""


Set = tuple[int, list[str]]
Node = tuple[FloatArray, int, int]
"""Position, system it is given in, system of its displacements."""


def read_uff_geometry(path: Path) -> Geometry:
    """The geometry that a universal file holds; sensors follow from channel names such as `12X+`.

    Raises:
        UnreadableFileError: cut off, no universal file, no node in it, or a number that is none.
        InvalidDataError: a line to an unknown node, or a node given twice at different places.
    """
    name = shorten(visible(path.name), 80)
    try:
        sets = list(_sets(path, name))
        systems = _systems(sets)
        nodes = _nodes(sets)
        index = {label: position for position, label in enumerate(nodes)}
        factor = _length_factor(sets, name)
        lines, surfaces = _lines(sets, index, name) if nodes else ([], [])
    except (ValueError, IndexError, OverflowError) as error:
        if isinstance(error, InvalidDataError):
            raise
        raise UnreadableFileError(
            f"a data set of nodes, lines, axes or units in {name} is damaged ({str(error)[:80]}); export it again."
        ) from error
    if not nodes:
        held = ", ".join(map(str, sorted({kind for kind, _ in sets}))) or "none that describes a geometry"
        raise UnreadableFileError(
            f"{name} holds no nodes (data set 15 or 2411; its sets: {held}); export the geometry as well, or write the "
            "nodes into a TOML file."
        )
    labels = list(nodes)
    positions = np.array([_placed(nodes[label], systems) for label in labels]) / factor
    return Geometry(
        node_names=tuple(map(str, labels)),
        positions=positions,
        lines=tuple(lines),
        surfaces=tuple(surfaces),
        axes=_axes([nodes[label][2] for label in labels], positions * factor, systems),
    )


# --- the file as data sets -------------------------------------------------------------------------------------------


def _sets(path: Path, name: str) -> Iterator[Set]:
    """The data sets that say something of a geometry, as lines of text."""
    n_lines = 0
    size = path.stat().st_size
    with path.open("rb") as file:
        while line := _line(file, name):
            if line.strip() != b"-1":
                continue
            head = _line(file, name)
            kind = _kind(head, name)
            if head[6:7].lower() == b"b":
                _pass_binary(file, head, size, name)
            lines = []
            while (line := _line(file, name)).strip() != b"-1":
                if not line:
                    raise UnreadableFileError(
                        f"data set {kind} of {name} is not closed by the line -1: the file is cut off; copy or export "
                        "it again."
                    )
                if kind in GeometrySets.WANTED:
                    lines.append(line.decode("latin-1").rstrip("\r\n"))
                    n_lines += 1
                if n_lines > GeometrySets.MOST_LINES:
                    raise UnreadableFileError(
                        f"{name} describes a geometry in more than {GeometrySets.MOST_LINES} lines; "
                        "export fewer nodes (at most "
                        f"{GeometryLimits.MOST_NODES})."
                    )
            if kind in GeometrySets.WANTED:
                yield kind, lines


def _line(file: BinaryIO, name: str) -> bytes:
    line = file.readline(GeometrySets.LONGEST_LINE)
    if len(line) == GeometrySets.LONGEST_LINE:
        raise UnreadableFileError(
            f"{name} has a line of {GeometrySets.LONGEST_LINE} bytes or more; it is damaged or no "
            "universal file; export it again."
        )
    return line


def _kind(head: bytes, name: str) -> int:
    text = head[:6].strip()
    if not text.isdigit():
        raise UnreadableFileError(
            f"{name} has a data set that does not begin with its number; it is damaged or no universal file."
        )
    return int(text)


def _pass_binary(file: BinaryIO, head: bytes, size: int, name: str) -> None:
    """Set 58b says on its first line how many lines of text and bytes of numbers follow."""
    fields = head[7:].split()
    if len(fields) < 4 or not all(field.isdigit() for field in fields[:4]) or int(fields[3]) > size:
        raise UnreadableFileError(f"a binary data set of {name} does not state its length; export it again.")
    for _ in range(min(int(fields[2]), 100)):
        file.readline(GeometrySets.LONGEST_LINE)
    file.seek(int(fields[3]), 1)


# --- data sets as parts of a geometry --------------------------------------------------------------------------------


def _systems(sets: Sequence[Set]) -> dict[int, CoordinateSystem]:
    found: dict[int, CoordinateSystem] = {}
    for kind, lines in sets:
        if kind == 18:
            found |= systems_of_set_18(lines, found)
        if kind == 2420:
            found |= systems_of_set_2420(lines)
    return found


def _nodes(sets: Sequence[Set]) -> dict[int, Node]:
    found: dict[int, Node] = {}
    for kind, lines in sets:
        if kind in (15, 781, 2411):
            for label, node in _nodes_of_15(lines) if kind == 15 else _nodes_of_2411(lines):
                before = found.setdefault(label, node)
                if not np.allclose(before[0], node[0], rtol=1e-4, atol=0.0, equal_nan=True):
                    raise InvalidDataError(f"node {label} is given twice, at different places; export it once.")
                if len(found) > GeometryLimits.MOST_NODES:
                    raise InvalidDataError(
                        f"a geometry may have {GeometryLimits.MOST_NODES} nodes, and this file has "
                        "more; export those that carry "
                        "sensors and lines."
                    )
    return found


def _nodes_of_15(lines: Sequence[str]) -> Iterator[tuple[int, Node]]:
    for line in filter(str.strip, lines):
        label, given_in, moves_in = whole_numbers(line[:40], 4)[:3]
        yield label, (np.array(numbers(line[40:], 3, width=13)), given_in, moves_in)


def _nodes_of_2411(lines: Sequence[str]) -> Iterator[tuple[int, Node]]:
    filled = list(filter(str.strip, lines))
    if len(filled) % 2:
        raise ValueError("the last node has no position")
    for head, place in zip(filled[::2], filled[1::2], strict=True):
        label, _, moves_in = whole_numbers(head, 4)[:3]
        yield label, (np.array(numbers(place, 3, width=25)), 0, moves_in)


def _placed(node: Node, systems: dict[int, CoordinateSystem]) -> FloatArray:
    place, given_in, _ = node
    return systems[given_in].position(place) if given_in in systems else place


def _axes(moves_in: Sequence[int], positions: FloatArray, systems: dict[int, CoordinateSystem]) -> FloatArray | None:
    """Local axes of every node; None where all are those of the geometry."""
    if not set(moves_in) & set(systems):
        return None
    axes = np.repeat(np.eye(3)[np.newaxis], len(moves_in), axis=0)
    for node, (system, place) in enumerate(zip(moves_in, positions, strict=True)):
        if system in systems:
            axes[node] = systems[system].axes_at(place)
    return axes


def _length_factor(sets: Sequence[Set], name: str) -> float:
    factors = {numbers(lines[1], 1, width=25)[0] for kind, lines in sets if kind == 164 and len(lines) > 1}
    if len(factors) > 1:
        raise InvalidDataError(
            f"{name} states {len(factors)} different units of length (data set 164); export the geometry into a file "
            "of its own."
        )
    factor = factors.pop() if factors else 1.0
    if not 1e-9 < factor < 1e9:
        raise UnreadableFileError(f"{name} states {factor:g} units of length to a metre (data set 164); correct it.")
    return factor


def _lines(
    sets: Sequence[Set], index: dict[int, int], name: str
) -> tuple[list[tuple[int, ...]], list[tuple[int, ...]]]:
    """Lines from trace lines and two-node elements, surfaces from shells."""
    lines, surfaces = [], []
    for kind, text in sets:
        if kind == 82:
            lines += [_known(line, index, "a trace line", name) for line in _traces(text)]
        if kind == 2412:
            for descriptor, nodes in _elements(text):
                if len(nodes) == 2:
                    lines.append(_known(nodes, index, "an element", name))
                elif descriptor in GeometrySets.SHELLS and len(nodes) > 2:
                    surfaces.append(_known(nodes, index, "an element", name))
    return lines, surfaces


def _known(labels: Iterable[int], index: dict[int, int], what: str, name: str) -> tuple[int, ...]:
    missing = [label for label in labels if label not in index]
    if missing:
        raise InvalidDataError(
            f"{what} in {name} names node {missing[0]}, which is not among the {len(index)} nodes of the file; export "
            "all nodes."
        )
    return tuple(index[label] for label in labels)


def _traces(text: Sequence[str]) -> Iterator[list[int]]:
    """The stretches between the zeros, which lift the pen."""
    if not text:
        raise ValueError("a trace line without its head")
    n_places = whole_numbers(text[0], 3)[1]
    stretch: list[int] = []
    places = [place for line in text[2:] for place in whole_numbers(line)][: max(n_places, 0)]
    for place in [*places, 0]:
        if place != 0:
            stretch.append(abs(place))
        else:
            if len(stretch) > 1:
                yield stretch
            stretch = []


def _elements(text: Sequence[str]) -> Iterator[tuple[int, list[int]]]:
    lines = iter(list(filter(str.strip, text)))
    for head in lines:
        fields = whole_numbers(head, 6)
        descriptor, n_nodes = fields[1], fields[5]
        if descriptor in GeometrySets.BEAMS:
            next(lines, "")
        nodes: list[int] = []
        while len(nodes) < n_nodes and (line := next(lines, "")):
            nodes += whole_numbers(line)
        yield descriptor, nodes[: max(n_nodes, 0)]
