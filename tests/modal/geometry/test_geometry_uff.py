"""A geometry in a universal file: written by pyuff or by hand, read without it."""

import numpy as np
import pytest

from modal.geometry.file import read_geometry
from okid.errors import IdentificationError, InvalidDataError, UnreadableFileError

NODES = {1: (0.0, 0.0, 0.0), 2: (0.0, 0.0, 0.4), 30: (0.3, -0.1, 0.4), 1004: (0.3, 0.0, 0.0)}


def data_set(kind, *lines):
    return "\n".join(["    -1", f"{kind:>6}", *lines, "    -1"]) + "\n"


def set_15(nodes=NODES, given_in=0, moves_in=0):
    rows = [f"{k:10d}{given_in:10d}{moves_in:10d}{11:10d}" + "".join(f"{x:13.5E}" for x in p) for k, p in nodes.items()]
    return data_set(15, *rows)


def set_2411(nodes=NODES, moves_in=1):
    rows = []
    for label, place in nodes.items():
        rows.append(f"{label:10d}{1:10d}{moves_in:10d}{11:10d}")
        rows.append("".join(f"{x:25.16E}".replace("E", "D") for x in place))
    return data_set(2411, *rows)


def set_82(*places):
    numbers = "".join(f"{k:10d}" for k in places)
    rows = [numbers[start : start + 80] for start in range(0, len(numbers), 80)]
    return data_set(82, f"{1:10d}{len(places):10d}{8:10d}", "all lines", *rows)


def set_164(factor):
    values = "".join(f"{x:25.17E}".replace("E", "D") for x in (factor, 1.0, 1.0))
    return data_set(164, f"{5:10d}mm (milli-newton)   {2:10d}", values, f"{273.15:25.17E}")


def read(tmp_path, text, name="geometry.unv"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode("latin-1"))
    return read_geometry(path)


@pytest.mark.parametrize("nodes", [set_15(), set_2411()], ids=["15", "2411"])
def test_nodes_and_lines_are_those_of_the_file(tmp_path, nodes):
    geometry = read(tmp_path, data_set(151, "model", "words") + nodes + set_82(1, 2, 30, 0, 30, 1004), "some.txt")
    assert geometry.node_names == ("1", "2", "30", "1004")
    np.testing.assert_allclose(geometry.positions, list(NODES.values()), atol=1e-6)
    assert geometry.lines == ((0, 1, 2), (2, 3))
    assert geometry.sensors_of(["1004Y-"])[0].direction.tolist() == [0, -1, 0]


def test_the_factor_of_set_164_makes_metres(tmp_path):
    nodes = {1: (0.0, 0.0, 0.0), 2: (0.0, 0.0, 400.0)}
    assert read(tmp_path, set_164(1000.0) + set_15(nodes)).positions[1, 2] == pytest.approx(0.4)
    assert read(tmp_path, set_15(nodes)).positions[1, 2] == pytest.approx(400.0)


def test_what_pyuff_writes_is_read(tmp_path):
    pyuff = pytest.importorskip("pyuff")
    path = tmp_path / "written.uff"
    file = pyuff.UFF(str(path))
    numbers = np.array(list(NODES))
    x, y, z = np.array(list(NODES.values())).T
    zero = np.zeros(len(numbers))
    file.write_sets(
        [
            {"type": 15, "node_nums": numbers, "def_cs": zero, "disp_cs": zero, "color": zero, "x": x, "y": y, "z": z},
            {
                "type": 82,
                "trace_num": 1,
                "n_nodes": 5,
                "color": 0,
                "id": "lines",
                "lines": None,
                "nodes": np.array([1, 2, 30, 0, 30, 1004]),
            },
        ],
        mode="overwrite",
    )
    geometry = read_geometry(path)
    np.testing.assert_allclose(geometry.positions, list(NODES.values()), atol=1e-5)
    assert geometry.lines[0] == (0, 1, 2)


def test_a_file_of_holes_is_refused_at_its_first_line_without_an_end(tmp_path):
    """It has any size that it likes, and takes no room."""
    for text in ("", set_15(), set_15() + "    -1\n   151\n"):
        path = tmp_path / "holes.uff"
        path.write_text(text)
        with path.open("r+b") as file:
            file.truncate(1 << 28)
        with pytest.raises(UnreadableFileError, match="a line of 4096 bytes or more"):
            read_geometry(path)


def test_fields_without_a_space_between_are_read_by_their_width(tmp_path):
    crowded = {1: (-1.0, -2.0, -3.0), 1234567890: (-1e-100, 2.0, -0.5)}
    geometry = read(tmp_path, set_15(crowded) + set_82(1, 1234567890))
    assert geometry.node_names == ("1", "1234567890")
    np.testing.assert_allclose(geometry.positions[0], [-1, -2, -3])
    assert geometry.lines == ((0, 1),)


def test_measurements_are_passed_over_even_binary_ones_that_look_like_an_end(tmp_path):
    block = b"\n    -1\n    15\n garbage\n" * 3
    head = f"    58b     1     2{11:12d}{len(block):12d}     0     0           0           0\n".encode()
    binary = b"    -1\n" + head + b"line\n" * 11 + block + b"\n    -1\n"
    geometry = read(tmp_path, binary + set_2411().encode())
    assert geometry.n_nodes == len(NODES)


def test_elements_give_lines_and_surfaces(tmp_path):
    beam = [f"{1:10d}{21:10d}{1:10d}{1:10d}{1:10d}{2:10d}", f"{0:10d}{0:10d}{0:10d}", f"{1:10d}{2:10d}"]
    shell = [f"{2:10d}{91:10d}{1:10d}{1:10d}{1:10d}{3:10d}", f"{1:10d}{2:10d}{30:10d}"]
    solid = [f"{3:10d}{111:10d}{1:10d}{1:10d}{1:10d}{4:10d}", f"{1:10d}{2:10d}{30:10d}{1004:10d}"]
    geometry = read(tmp_path, set_15() + data_set(2412, *beam, *solid, *shell))
    assert (geometry.lines, geometry.surfaces) == (((0, 1),), ((0, 1, 2),))


def set_2420(label, kind, axes, origin):
    rows = ["".join(f"{x:25.16E}".replace("E", "D") for x in row) for row in (*axes, origin)]
    return data_set(2420, f"{1:10d}", "part", f"{label:10d}{kind:10d}{8:10d}", "system", *rows)


def test_displacements_in_a_cylindrical_system_are_radial_and_tangential(tmp_path):
    # X' = Y, Y' = Z, Z' = X, around the point (5, 0, 0)
    system = set_2420(7, 1, [[0, 1, 0], [0, 0, 1], [1, 0, 0]], [5, 0, 0])
    geometry = read(tmp_path, system + set_2411({1: (5.0, 0.0, 2.0), 2: (9.0, -3.0, 0.0)}, moves_in=7))
    radial, around, along = (geometry.sensors_of([f"1{axis}+"])[0].direction for axis in "XYZ")
    np.testing.assert_allclose([radial, around, along], [[0, 0, 1], [0, -1, 0], [1, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(geometry.sensors_of(["2X+"])[0].direction, [0, -1, 0], atol=1e-12)


def test_nodes_in_a_cylindrical_system_are_placed_by_radius_and_angle(tmp_path):
    rows = [f"{3:10d}{1:10d}{0:10d}{8:10d}{1:10d}", "around Z"]
    values = [0, 0, 1.0, 1, 0, 1.0, 1, 0, 2.0]  # origin, a point on X, a point in the plane of X and Z
    lines = ["".join(f"{x:13.5E}" for x in values[:6]), "".join(f"{x:13.5E}" for x in values[6:])]
    geometry = read(tmp_path, data_set(18, *rows, *lines) + set_15({1: (2.0, 90.0, 0.5)}, given_in=3))
    np.testing.assert_allclose(geometry.positions, [[0.0, 2.0, 1.5]], atol=1e-12)


def test_a_system_that_the_file_does_not_hold_is_the_global_one(tmp_path):
    geometry = read(tmp_path, set_2411(moves_in=1))
    assert geometry.axes is None


REFUSED = {
    "no nodes": (data_set(151, "model"), UnreadableFileError, "holds no nodes"),
    "cut off": (set_15()[:-10], UnreadableFileError, "cut off"),
    "no number of a set": ("    -1\nabc\n    -1\n", UnreadableFileError, "does not begin with its number"),
    "letters for a coordinate": (set_15().replace("E-01", "Q-01"), UnreadableFileError, "is damaged"),
    "nan": (set_2411().replace("4.0000000000000002D-01", "                   nan"), UnreadableFileError, "not finite"),
    "half a node": (data_set(2411, f"{1:10d}{1:10d}{1:10d}{11:10d}"), UnreadableFileError, "is damaged"),
    "an unknown node": (set_15() + set_82(1, 99), InvalidDataError, "a trace line in geometry.unv names node 99"),
    "a node twice": (set_15() + set_15({1: (9.0, 0, 0)}), InvalidDataError, "node 1 is given twice"),
    "two units": (set_164(1000.0) + set_164(1.0) + set_15(), InvalidDataError, "different units of length"),
    "no unit": (set_164(0.0) + set_15(), UnreadableFileError, "units of length to a metre"),
    "a spherical system": (
        set_2420(7, 2, np.eye(3), np.zeros(3)) + set_2411(moves_in=7),
        InvalidDataError,
        "coordinate system 7 is of kind 2",
    ),
    "axes that are none": (
        set_2420(7, 0, 2 * np.eye(3), np.zeros(3)) + set_2411(moves_in=7),
        InvalidDataError,
        "not of unit length",
    ),
    "a trace line without a head": (set_15() + data_set(82), UnreadableFileError, "a trace line without its head"),
    "letters in a trace line": (
        set_15() + set_82(1, 2).replace("         1         2", "         1    Wayne"),
        UnreadableFileError,
        "where whole numbers stand",
    ),
    "a whole number of Python's": (
        set_15() + set_82(1, 2).replace("    2\n", "  2_0\n"),
        UnreadableFileError,
        "whole numb",
    ),
    "a number of Python's": (
        set_15().replace("0.00000E+00", "0.0_000E+00"),
        UnreadableFileError,
        "where numbers stand",
    ),
    "letters for the unit": (set_15() + data_set(164, "", "metres"), UnreadableFileError, "'metres' where numbers"),
    "letters in an element": (set_15() + data_set(2412, "a b c d e f"), UnreadableFileError, "'a b c d e f' where"),
    "half a node more": (
        data_set(2411, *2 * [f"{1:10d}{1:10d}{1:10d}{11:10d}"], "0 0 0"),
        UnreadableFileError,
        "no position",
    ),
    "a block without length": ("    -1\n    58b     x\n    -1\n" + set_15(), UnreadableFileError, "state its length"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_file_that_cannot_be_read_is_refused_in_one_sentence(tmp_path, case):
    text, kind, words = REFUSED[case]
    with pytest.raises(kind) as caught:
        read(tmp_path, text)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_node_given_twice_in_one_place_is_one_node(tmp_path):
    assert read(tmp_path, set_15() + set_2411()).n_nodes == len(NODES)


def test_cutting_or_changing_a_file_anywhere_gives_a_geometry_or_one_of_our_errors(tmp_path):
    whole = (
        set_164(1000.0) + set_2420(7, 1, np.eye(3), np.zeros(3)) + set_2411(moves_in=7) + set_82(1, 2, 30)
    ).encode()
    rng = np.random.default_rng(5)
    for _ in range(300):
        text = bytearray(whole)
        for place in rng.integers(0, len(text), rng.integers(1, 6)):
            text[place] = rng.integers(0, 256)
        try:
            read(tmp_path, bytes(text[: rng.integers(len(text) // 2, len(text) + 1)]))
        except IdentificationError:
            continue


def test_too_many_lines_are_refused_without_reading_on(tmp_path, monkeypatch):
    monkeypatch.setattr("modal.geometry.uff.GeometrySets.MOST_LINES", 6)
    with pytest.raises(UnreadableFileError, match="more than 6 lines"):
        read(tmp_path, set_2411())
