"""Sets of shapes: joined by names, paired, read from files, and scaled to a known modal mass."""

import dataclasses

import numpy as np
import pytest
import scipy

import modal
from era.realisation import Realisation
from modal.modes.extraction import extract_modes
from okid.errors import InvalidDataError, UnreadableFileError

MASS = np.diag([2.0, 1.0, 3.0])
STIFFNESS = 1e4 * np.array([[3.0, -1.0, 0.0], [-1.0, 2.5, -1.5], [0.0, -1.5, 1.5]])
DAMPING = 0.3 * MASS + 2e-5 * STIFFNESS
UNITS = ("m", "m/s", "m/s^2")


def chain_model(units, *, dt=0.002):
    """Modes of three masses with forces on the first and the last, from the matrices alone: held force, exact."""
    inverse = np.linalg.inv(MASS)
    A = np.block([[np.zeros((3, 3)), np.eye(3)], [-inverse @ STIFFNESS, -inverse @ DAMPING]])
    B = np.vstack([np.zeros((3, 2)), inverse[:, [0, 2]]])
    rows = {"m": np.eye(3, 6), "m/s": np.eye(3, 6, 3), "m/s^2": A[3:]}
    C = np.array([rows[unit][place] for place, unit in enumerate(units)])
    D = np.array([B[3 + place] if unit == "m/s^2" else np.zeros(2) for place, unit in enumerate(units)])
    step = scipy.linalg.expm(dt * np.block([[A, B], [np.zeros((2, 8))]]))
    modes = extract_modes(Realisation(step[:6, :6], step[:6, 6:], C, D, dt))
    believed = tuple(dataclasses.replace(mode, verdict="system") for mode in modes)
    return dataclasses.replace(
        modes, modes=believed, output_names=("a", "b", "c"), output_units=units, input_names=("fa", "fc")
    )


@pytest.mark.parametrize("units", [("m",) * 3, ("m/s",) * 3, ("m/s^2",) * 3, UNITS])
@pytest.mark.parametrize("point", [("a", "fa"), ("c", "fc")])
def test_shapes_for_unit_modal_mass_are_those_of_the_matrices(units, point):
    scaled = modal.normalise_shapes(chain_model(units), driving_point=point)
    _, vectors = scipy.linalg.eigh(STIFFNESS, MASS)
    assert np.abs(scaled.shapes) == pytest.approx(np.abs(vectors), rel=1e-7)
    assert scaled.modal_mass == pytest.approx(1.0 / np.abs(vectors).max(axis=0) ** 2, rel=1e-7)


def test_a_pair_of_channels_that_is_no_driving_point_is_refused_where_it_shows():
    model = chain_model(UNITS)
    with pytest.raises(InvalidDataError, match="negative modal mass at c and fa"):
        modal.normalise_shapes(model, driving_point=("c", "fa"))
    with pytest.raises(InvalidDataError, match="no input 'f'; the inputs are fa, fc"):
        modal.normalise_shapes(model, driving_point=("a", "f"))
    with pytest.raises(InvalidDataError, match="needs a driving point"):
        modal.normalise_shapes(dataclasses.replace(model, input_names=()), driving_point=("a", "fa"))
    volts = dataclasses.replace(model, output_units=("V", "m", "m"))
    with pytest.raises(InvalidDataError, match="a is in V"):
        modal.normalise_shapes(volts, driving_point=("a", "fa"))


def test_a_mode_that_the_driving_point_does_not_show_has_no_mass_and_spoils_no_other():
    """At its node a residue is noise of either sign: known to 60 %, it refuses nothing; to 40 %, a sign is a sign."""
    model = chain_model(UNITS)
    fine, vague = np.full((3, 2), 0.01), np.full((3, 2), 0.6)
    known = [dataclasses.replace(mode, mass_std=fine) for mode in model.modes]
    known[1] = dataclasses.replace(known[1], mass_std=vague, participation=-known[1].participation)
    scaled = modal.normalise_shapes(dataclasses.replace(model, modes=tuple(known)), driving_point=("a", "fa"))
    whole = modal.normalise_shapes(model, driving_point=("a", "fa"))
    assert np.isnan(scaled.modal_mass).tolist() == [False, True, False]
    assert scaled.modal_mass[[0, 2]].tolist() == whole.modal_mass[[0, 2]].tolist()
    assert np.isnan(scaled.shapes).any(axis=0).tolist() == [False, True, False]
    known[1] = dataclasses.replace(known[1], mass_std=0.4 / 0.6 * vague)
    with pytest.raises(InvalidDataError, match="negative modal mass at a and fa"):
        modal.normalise_shapes(dataclasses.replace(model, modes=tuple(known)), driving_point=("a", "fa"))


def test_sets_are_joined_by_the_names_of_their_channels():
    model = chain_model(("m",) * 3)
    names = ("c", "extra", "a", "b")
    turned = model.shapes[[2, 0, 0, 1]][:, [2, 0]] * np.array([2j, -3.0])
    other = modal.Shapes(turned, names, model.frequencies[[2, 0]])
    assert modal.assurance(model, other)[[2, 0], [0, 1]] == pytest.approx(1.0)
    found = modal.pair_modes(model, other)
    assert found.pairs == ((0, 1), (2, 0))
    assert found.only_first == (1,)
    assert found.only_second == ()
    assert modal.coordinate_assurance(model, other) == pytest.approx(1.0)
    with pytest.raises(InvalidDataError, match="no channel in common"):
        modal.assurance(model, modal.Shapes([[1.0]], ["elsewhere"]))


def test_a_channel_whose_sign_is_turned_in_one_mode_shows_in_its_coordinate_assurance():
    model = chain_model(("m",) * 3)
    wrong = model.shapes.copy()
    wrong[0, 1] *= -1
    found = modal.coordinate_assurance(model, modal.Shapes(wrong, ("a", "b", "c"), model.frequencies))
    assert found.argmin() == 0


@pytest.mark.parametrize("ending", [".csv", ".npz"])
def test_shapes_come_back_from_a_file(tmp_path, ending):
    shapes, names, frequencies = np.array([[1.0, 0.5 - 0.25j], [0.1j, 1.0]]), ("12X+", "3Z+"), np.array([1.5, 20.0])
    path = tmp_path / f"shapes{ending}"
    if ending == ".npz":
        np.savez(path, shapes=shapes, names=np.array(names), frequencies=frequencies)
    else:
        rows = ["channel,1.5 Hz,20 Hz"]
        rows += [
            ",".join([name, *(f"{z.real}{z.imag:+}j" for z in row)]) for name, row in zip(names, shapes, strict=True)
        ]
        path.write_text("\n".join(rows))
    found = modal.read_shapes(path)
    assert found.names == names
    assert found.frequencies.tolist() == frequencies.tolist()
    assert np.array_equal(found.shapes, shapes)


@pytest.mark.parametrize(
    "content", [b"", b"a,b\nc,not a number\n", b"\x00\xff\x00", b"channel,1 Hz\na,1\na,2\n", b"channel,1 Hz\na,1_0\n"]
)
def test_a_file_without_shapes_is_told_in_one_sentence(tmp_path, content):
    for ending in (".csv", ".npz", ".uff"):
        path = tmp_path / f"broken{ending}"
        path.write_bytes(content)
        with pytest.raises(UnreadableFileError):
            modal.read_shapes(path)


def test_a_shape_without_end_is_refused_by_us_and_not_warned_of_by_the_reader(tmp_path):
    """One of 10 000 damaged files: the library multiplies before we look, and numpy said so on stderr."""
    pyuff = pytest.importorskip("pyuff")
    path = tmp_path / "shapes.uff"
    one = pyuff.prepare_55(
        model_type=1,
        analysis_type=3,
        data_ch=3,
        spec_data_type=8,
        data_type=5,
        load_case=1,
        mode_n=1,
        eig=-0.1 + 6j,
        modal_a=0.5 + 0.5j,
        modal_b=0.5 + 0.5j,
        node_nums=np.array([1]),
        **{f"r{axis}": np.array([12345.0 + 12345.0j]) for axis in (1, 2, 3)},
    )
    pyuff.UFF(str(path)).write_sets([one], "overwrite")
    path.write_text(path.read_text().replace("1.23450e+04", "        inf"))
    with pytest.raises(UnreadableFileError, match="must be finite numbers"):
        modal.read_shapes(path)


def test_the_table_of_modes_has_a_row_a_mode_and_its_shape():
    model = chain_model(UNITS)
    table = model.to_table()
    assert table.column("frequency").to_pylist() == sorted(mode.frequency for mode in model)
    shape = table.column("shape").to_pylist()[0]
    assert [complex(z["real"], z["imaginary"]) for z in shape] == model.modes[0].shape.tolist()
    assert table.schema.field("shape").metadata[b"output_names"] == b"a\nb\nc"
