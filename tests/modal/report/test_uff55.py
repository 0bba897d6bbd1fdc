"""UFF 55 read back by pyuff: every number to the six digits of the format, nodes and directions as they should be."""

from dataclasses import replace

import numpy as np
import pytest
import pyuff

from modal.geometry.sensors import Geometry, Sensor
from modal.report.writing import node_labels, real_shape, uff55_text
from okid.errors import InvalidDataError


def read(tmp_path, text):
    path = tmp_path / "modes.uff"
    path.write_bytes(text.encode("ascii"))
    sets = pyuff.UFF(str(path)).read_sets()
    return sets if isinstance(sets, list) else [sets]


def printed(values):
    """As E13.5 keeps them."""
    values = np.atleast_1d(values)
    parts = [[float(f"{part:.5E}") for part in (value.real, value.imag)] for value in values]
    return np.array(parts) @ [1, 1j]


def renamed(result, names):
    record = replace(result.records[0], output_names=tuple(names))
    return replace(result, records=(record,))


def test_every_mode_of_the_system_is_a_dataset_with_its_pole_and_shape(tmp_path, identification):
    sets = read(tmp_path, uff55_text(renamed(identification, ("3X+", "3Y-", "12Z"))))
    system = identification.modes.system
    assert [one["type"] for one in sets] == [55] * len(system)
    for number, (one, mode) in enumerate(zip(sets, system, strict=True), start=1):
        assert (one["mode_n"], one["analysis_type"], one["data_type"], one["data_ch"]) == (number, 3, 5, 2)
        assert one["eig"] == printed(mode.pole)[0]
        assert (one["modal_a"], one["modal_b"]) == (0, 0)
        assert one["spec_data_type"] == 12
        assert list(one["node_nums"]) == [3, 12]
        shape = mode.shape / mode.shape[np.argmax(np.abs(mode.shape))]
        np.testing.assert_array_equal(one["r1"], [printed(shape[0])[0], 0])
        np.testing.assert_array_equal(one["r2"], [printed(-shape[1])[0], 0])
        np.testing.assert_array_equal(one["r3"], [0, printed(shape[2])[0]])


def test_a_channel_without_a_direction_has_a_node_of_its_own_and_says_so(tmp_path, identification):
    one = read(tmp_path, uff55_text(identification))[0]
    assert list(one["node_nums"]) == [1, 2, 3]
    assert "direction not known for 3 of 3 outputs" in one["id4"]
    np.testing.assert_array_equal(one["r1"], printed(_normalised(identification.modes.system[0].shape)))


def _normalised(shape):
    return shape / shape[np.argmax(np.abs(shape))]


def test_a_geometry_gives_nodes_lines_and_directions(tmp_path, identification):
    geometry = Geometry(
        node_names=("base", "7", "8", "roof"),
        positions=[[0, 0, 0], [0, 0, 3.5], [0, 0, 7.0], [0, 1e-3, 10.25]],
        lines=((0, 1, 2, 3),),
        surfaces=((0, 1, 2),),
        sensors=(
            Sensor(name="floor_1", node=1, direction=[1, 0, 0]),
            Sensor(name="floor_2", node=2, direction=[0, -2, 0]),
        ),
    )
    sets = read(tmp_path, uff55_text(identification, geometry))
    assert [one["type"] for one in sets] == [164, 15, 82, 82, 55, 55, 55]
    assert (sets[0]["units_code"], sets[0]["length"]) == (1, 1.0)
    assert list(sets[1]["node_nums"]) == [9, 7, 8, 10]
    np.testing.assert_array_equal(np.transpose([sets[1][axis] for axis in "xyz"]), geometry.positions)
    assert list(sets[2]["nodes"]) == [9, 7, 8, 10]
    assert list(sets[3]["nodes"]) == [9, 7, 8, 9]
    one, mode = sets[4], identification.modes.system[0]
    assert list(one["node_nums"]) == [7, 8]
    assert "1 of 3 outputs move no node" in one["id4"]
    shape = _normalised(mode.shape)
    np.testing.assert_array_equal(one["r1"], [printed(shape[0])[0], 0])
    np.testing.assert_array_equal(one["r2"], [0, printed(-shape[1])[0]])


def test_a_long_line_is_read_back_whole(tmp_path, identification):
    n = 21
    geometry = Geometry(node_names=tuple(map(str, range(1, n + 1))), positions=np.eye(n, 3), lines=(tuple(range(n)),))
    assert list(read(tmp_path, uff55_text(identification, geometry))[2]["nodes"]) == list(range(1, n + 1))


def test_normal_modes_have_frequency_damping_and_a_real_shape(tmp_path, identification):
    one = read(tmp_path, uff55_text(identification, form="normal"))[0]
    mode = identification.modes.system[0]
    assert (one["analysis_type"], one["data_type"]) == (2, 2)
    assert one["freq"] == printed(mode.frequency)[0].real
    assert one["modal_damp_vis"] == printed(mode.damping_ratio)[0].real
    assert np.isrealobj(one["r1"])
    np.testing.assert_allclose(one["r1"], mode.shape.real / mode.shape.real[2], atol=0.05)
    with pytest.raises(InvalidDataError, match="complex or normal"):
        uff55_text(identification, form="real")


def test_the_real_shape_is_the_one_closest_to_a_real_vector():
    rng = np.random.default_rng(3)
    shape = (rng.standard_normal(5) + 0.2j * rng.standard_normal(5)) * np.exp(0.7j)
    left = np.linalg.norm(shape) ** 2 - np.linalg.norm(real_shape(shape)) ** 2
    angles = np.linspace(0, np.pi, 2001)
    assert left <= min(np.linalg.norm((shape * np.exp(1j * angle)).imag) ** 2 for angle in angles) + 1e-12
    np.testing.assert_allclose(real_shape(shape), real_shape(-1j * shape), atol=1e-12)


def test_motions_of_several_kinds_become_displacement(tmp_path, identification):
    record = replace(identification.records[0], output_units=("m/s^2", "m/s", "m"))
    one = read(tmp_path, uff55_text(replace(identification, records=(record,))))[0]
    mode = identification.modes.system[0]
    moved = _normalised(mode.shape / np.array([mode.pole**2, mode.pole, 1]))
    assert one["spec_data_type"] == 8
    np.testing.assert_array_equal(one["r1"], printed(moved))
    other = replace(identification.records[0], output_units=("m/s^2", "V", "m"))
    unknown = read(tmp_path, uff55_text(replace(identification, records=(other,))))[0]
    assert unknown["spec_data_type"] == 0
    np.testing.assert_array_equal(unknown["r1"], printed(_normalised(mode.shape)))


def test_any_text_is_plain_and_short(tmp_path, identification):
    record = replace(
        identification.records[0], name="\u202e<script>\n    -1\n" + 300 * "x", output_names=("ä", "b", "c")
    )
    text = uff55_text(replace(identification, records=(record,)))
    assert max(map(len, text.splitlines())) <= 80
    assert len(read(tmp_path, text)) == 3


def test_without_a_mode_of_the_system_nothing_is_written(identification):
    modes = replace(identification.modes, modes=identification.modes.modes[3:])
    assert uff55_text(replace(identification, modes=modes)) == ""


def test_labels_are_whole_different_and_own_where_they_can_be():
    assert node_labels(["5", "a", "05", "0", "99999999999", "5x"]) == (5, 6, 7, 8, 9, 10)
