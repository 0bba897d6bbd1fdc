"""A geometry in TOML: what it says, and every mistake a hand may make in it."""

import numpy as np
import pytest

from modal.geometry.file import geometry_of_table, read_geometry
from modal.geometry.sensors import Geometry
from okid.errors import IdentificationError, InvalidDataError, UnreadableFileError

FRAME = """
unit = "mm"
lines = [[1, 2, 3], [3, "top right"]]
surfaces = [[1, 2, 3]]
fixed = [1]
rigid = [[3, "top right"]]

[nodes]
1 = [0, 0, 0]
2 = [0, 0, 350]
3 = [0, 0, 700.5]
"top right" = [500, 0, 700.5]

[sensors]
acc_top = "3-Y"
skew = { node = 2, direction = [1, 1, 0] }
gyro = { node = "top right", direction = [0, 0, 2], motion = "about" }
"""


def test_every_key_is_read(tmp_path):
    path = tmp_path / "frame.toml"
    path.write_text(FRAME, encoding="utf-8")
    geometry = read_geometry(path)
    assert geometry.node_names == ("1", "2", "3", "top right")
    np.testing.assert_allclose(geometry.positions[3], [0.5, 0.0, 0.7005])
    assert geometry.lines == ((0, 1, 2), (2, 3))
    assert (geometry.surfaces, geometry.fixed, geometry.rigid) == (((0, 1, 2),), (0,), ((2, 3),))
    top, skew, gyro = geometry.sensors
    assert (top.name, top.node, top.direction.tolist()) == ("acc_top", 2, [0, -1, 0])
    np.testing.assert_allclose(skew.direction, np.array([1, 1, 0]) / np.sqrt(2))
    assert (gyro.node, gyro.motion) == (3, "about")


def test_the_table_of_a_test_file_may_stand_alone(tmp_path):
    path = tmp_path / "frame.toml"
    path.write_text("[geometry]\nlines = [[1, 2]]\n[geometry.nodes]\n1 = [0, 0, 0]\n2 = [0, 0, 1]\n", encoding="utf-8")
    assert read_geometry(path).lines == ((0, 1),)


@pytest.mark.parametrize(("unit", "metres"), [("m", 1.0), ("cm", 0.01), ("in", 0.0254), ("ft", 0.3048), ("µm", 1e-6)])
def test_positions_become_metres(unit, metres):
    geometry = geometry_of_table({"unit": unit, "nodes": {"1": [0, 2, 0]}}, "here")
    assert geometry.positions[0, 1] == pytest.approx(2 * metres)


NODES = {"1": [0, 0, 0], "2": [0, 0, 1]}
MISTAKES = {
    "an unknown node in a line": ({"lines": [[1, 2], [2, 7]]}, "part 2 of lines in f.toml names node 7"),
    "a fixed node that is none": ({"fixed": ["x"]}, "fixed in f.toml names node 'x'"),
    "a line that is no list": ({"lines": ["1-2"]}, "part 1 of lines in f.toml must be a list"),
    "lines that are no list": ({"lines": {"a": [1, 2]}}, "lines in f.toml must be a list"),
    "true as a node": ({"lines": [[True, 2]]}, "names node True"),
    "two coordinates": ({"nodes": {"1": [0, 0]}}, "node '1' in f.toml must be three numbers"),
    "words as coordinates": ({"nodes": {"1": ["0", "0", "0"]}}, "must be three numbers"),
    "a coordinate without end": ({"nodes": {"1": [0, 0, 10**400]}}, "a number too large"),
    "nan": ({"nodes": {"1": [0, 0, float("nan")]}}, "node '1' stands at (0, 0, nan)"),
    "no nodes": ({"nodes": {}}, "needs a table [nodes]"),
    "nodes in a list": ({"nodes": [[0, 0, 0]]}, "needs a table [nodes]"),
    "an unknown key": ({"line": [[1, 2]]}, "has no key 'line'; the keys are unit, nodes, lines"),
    "an unknown unit": ({"unit": "parsec"}, "unit in f.toml must be one of m, mm"),
    "sensors in a list": ({"sensors": ["3X+"]}, "sensors in f.toml must be a table"),
    "a sensor without axis": ({"sensors": {"a": "2"}}, "sensor 'a' in f.toml must state a node and an axis"),
    "a sensor nowhere": ({"sensors": {"a": "9X"}}, "sensor 'a' in f.toml names node '9', which is not among the 2"),
    "a sensor without direction": ({"sensors": {"a": {"node": 1}}}, "or a table of node, direction"),
    "a misspelt key": ({"sensors": {"a": {"node": 1, "direction": [1, 0, 0], "way": 1}}}, "or a table of node"),
    "a number as sensor": ({"sensors": {"a": 3}}, "but is 3"),
    "no direction": ({"sensors": {"a": {"node": 1, "direction": [0, 0, 0]}}}, "direction (0, 0, 0)"),
    "another motion": ({"sensors": {"a": {"node": 1, "direction": [1, 0, 0], "motion": "x"}}}, "but not 'x'"),
}


@pytest.mark.parametrize("case", MISTAKES)
def test_a_mistake_is_told_in_one_sentence(case):
    changes, words = MISTAKES[case]
    with pytest.raises(InvalidDataError) as caught:
        geometry_of_table({"nodes": NODES, **changes}, "f.toml")
    message = str(caught.value)
    assert words in message
    assert message.endswith(".")
    assert "\n" not in message
    assert len(message) < 400


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\xff\xfe\x00",
        b"[nodes",
        b"nodes = 3",
        b"a = " + b"[" * 5000,
        b"x = " + b"9" * 6000,
        b"   -1\n",
        b"<html>",
    ],
    ids=["empty", "binary", "cut off", "a number", "deep", "long", "indented", "html"],
)
@pytest.mark.parametrize("ending", [".toml", ".unv", ".txt"])
def test_a_file_of_something_else_is_refused(tmp_path, content, ending):
    path = tmp_path / f"some{ending}"
    path.write_bytes(content)
    with pytest.raises(IdentificationError) as caught:
        read_geometry(path)
    assert "\n" not in str(caught.value)


def test_a_missing_file_and_a_folder_are_told(tmp_path):
    with pytest.raises(UnreadableFileError, match="does not exist"):
        read_geometry(tmp_path / "none.toml")
    with pytest.raises(UnreadableFileError, match="is a folder"):
        read_geometry(tmp_path)


def test_names_from_the_file_are_shown_short_and_visible():
    hostile = "\x1b[2J<script>" + "x" * 500
    with pytest.raises(InvalidDataError) as caught:
        geometry_of_table({"nodes": {"1": [0, 0, 0]}, "sensors": {hostile: hostile}}, "f.toml")
    assert "\x1b" not in str(caught.value)
    assert len(str(caught.value)) < 300
    assert isinstance(geometry_of_table({"nodes": {hostile: [0, 0, 0]}}, "f.toml"), Geometry)
