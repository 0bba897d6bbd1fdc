"""MAT files written by scipy (versions 4, 5, 7) and, laid out as MATLAB does it, by h5py (version 7.3)."""

import numpy as np
import pytest
import scipy

from okid.errors import InvalidDataError, UnreadableFileError
from okid.readers import describe_file, read_record

RNG = np.random.default_rng(8)
FORCE, TIPS = RNG.standard_normal(60), RNG.standard_normal((60, 3))


def write_73(path, contents):
    """What MATLAB writes with -v7.3: 512 bytes of its own, HDF5, columns first, texts as codes, cells as references."""
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:

        def put(group, name, value):
            if isinstance(value, dict):
                inner = group.create_group(name)
                inner.attrs["MATLAB_class"] = np.bytes_("struct")
                for key, each in value.items():
                    put(inner, key, each)
            elif isinstance(value, str):
                codes = group.create_dataset(name, data=np.array([[ord(letter)] for letter in value], dtype=np.uint16))
                codes.attrs["MATLAB_class"] = np.bytes_("char")
            elif isinstance(value, list):
                store = file.require_group("#refs#")
                references = []
                for index, text in enumerate(value):
                    put(store, f"{name}{index}", text)
                    references.append(store[f"{name}{index}"].ref)
                cells = group.create_dataset(name, (len(value), 1), dtype=h5py.ref_dtype)
                cells[:, 0] = references
                cells.attrs["MATLAB_class"] = np.bytes_("cell")
            else:
                data = group.create_dataset(name, data=np.atleast_2d(value).T)
                data.attrs["MATLAB_class"] = np.bytes_("double")

        for name, value in contents.items():
            put(file, name, value)
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, written for a test".ljust(116) + bytes(8) + b"\x00\x02IM")


def write_5(path, contents):
    cells = {
        name: np.array(value, dtype=object) if isinstance(value, list) else value for name, value in contents.items()
    }
    scipy.io.savemat(path, cells)


def write_7(path, contents):
    cells = {
        name: np.array(value, dtype=object) if isinstance(value, list) else value for name, value in contents.items()
    }
    scipy.io.savemat(path, cells, do_compression=True)


@pytest.fixture(params=[write_5, write_7, write_73], ids=["5", "7", "7.3"])
def write(request, tmp_path):
    def written(**contents):
        path = tmp_path / "record.mat"
        request.param(path, contents)
        return path

    return written


def test_vectors_are_channels_whichever_way_they_lie(write):
    path = write(dt=0.01, force=FORCE[np.newaxis, :], tip=TIPS[:, :1])
    record = read_record(path, inputs="force")
    assert (record.input_names, record.output_names, record.dt) == (("force",), ("tip",), 0.01)
    np.testing.assert_array_equal(record.inputs[:, 0], FORCE)
    np.testing.assert_array_equal(record.outputs[:, 0], TIPS[:, 0])


def test_roles_names_and_units(write):
    path = write(
        inputs=FORCE[:, np.newaxis],
        outputs=TIPS,
        Ts=0.5,
        input_names=["shaker"],
        output_names=["a", "b", "c"],
        output_units=["mm", "m", "counts"],
    )
    record = read_record(path)
    assert record.input_names == ("shaker",)
    assert record.output_names == ("a", "b", "c")
    assert record.output_units == ("m", "m", "counts")
    np.testing.assert_allclose(record.outputs, TIPS * [1e-3, 1, 1], rtol=1e-14)


def test_a_matrix_by_its_own_name_is_all_its_columns(write):
    forces = np.column_stack([FORCE, FORCE[::-1]])
    record = read_record(write(u=forces, y=TIPS, fs=50.0), inputs="u")
    assert (record.input_names, record.output_names) == (("u_0", "u_1"), ("y_0", "y_1", "y_2"))
    np.testing.assert_allclose(record.inputs, forces)


def test_fields_of_structures(write):
    path = write(run={"time": 0.1 * np.arange(60), "u": FORCE, "deep": {"y": TIPS}}, note="a remark")
    record = read_record(path, inputs="u")
    assert record.dt == pytest.approx(0.1)
    assert record.output_names == ("y_0", "y_1", "y_2")
    np.testing.assert_array_equal(record.outputs, TIPS)


def test_fields_of_one_name_keep_that_of_their_structure(write):
    path = write(dt=1.0, first={"y": FORCE}, second={"y": TIPS[:, 0]})
    assert read_record(path).output_names == ("first.y", "second.y")


def test_what_is_no_channel_is_said(write):
    path = write(dt=1.0, y=FORCE, gain=3.0, odd=np.ones(7), note="a remark")
    remarks = " ".join(describe_file(path).remarks)
    assert "gain left out: it is a single number" in remarks
    assert "odd left out: its shape is (7, 1), but the record has 60 samples" in remarks


def test_complex_arrays_are_refused_by_name(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"dt": 1.0, "y": FORCE, "frf": FORCE + 1j})
    with pytest.raises(InvalidDataError, match=r"'frf' .* complex"):
        read_record(tmp_path / "a.mat", outputs="frf")


def test_version_4(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"dt": 1.0, "y": TIPS}, format="4")
    np.testing.assert_array_equal(read_record(tmp_path / "a.mat").outputs, TIPS)


def test_links_out_of_the_file_are_not_followed(tmp_path):
    import h5py

    with h5py.File(tmp_path / "secret.h5", "w") as other:
        other["y"] = FORCE
    write_73(tmp_path / "a.mat", {"dt": 1.0, "x": FORCE})
    with h5py.File(tmp_path / "a.mat", "r+") as file:
        file["linked"] = h5py.ExternalLink(str(tmp_path / "secret.h5"), "/y")
        file.create_dataset("outside", (60,), "f8", external=[(str(tmp_path / "secret.h5"), 0, 480)])
    assert read_record(tmp_path / "a.mat").output_names == ("x",)


@pytest.mark.parametrize("kind", ["external", "virtual"])
def test_names_out_of_another_file_are_not_read(tmp_path, kind):
    """A cell array may refer to characters that lie elsewhere."""
    import h5py

    letters = np.array([[ord(letter)] for letter in "secret"], dtype=np.uint16)
    with h5py.File(tmp_path / "secret.h5", "w") as other:
        other["letters"] = letters
        offset = other["letters"].id.get_offset()
    write_73(tmp_path / "a.mat", {"dt": 1.0, "outputs": TIPS[:, :2]})
    with h5py.File(tmp_path / "a.mat", "r+") as file:
        place, path = file.require_group("#refs#"), str(tmp_path / "secret.h5")
        if kind == "external":
            place.create_dataset("a", letters.shape, "u2", external=[(path, offset, letters.nbytes)])
        else:
            layout = h5py.VirtualLayout(letters.shape, "u2")
            layout[:] = h5py.VirtualSource(path, "letters", letters.shape)
            place.create_virtual_dataset("a", layout)
        assert place["a"][0, 0] == ord("s")  # h5py itself follows it
        place["a"].attrs["MATLAB_class"] = np.bytes_("char")
        names = file.create_dataset("output_names", (2, 1), dtype=h5py.ref_dtype)
        names[:, 0] = [place["a"].ref] * 2
        names.attrs["MATLAB_class"] = np.bytes_("cell")
    assert read_record(tmp_path / "a.mat").output_names == ("output_0", "output_1")


def test_links_that_lead_back_and_texts_without_end_cost_nothing(tmp_path):
    import h5py

    write_73(tmp_path / "a.mat", {"dt": 1.0, "x": FORCE})
    with h5py.File(tmp_path / "a.mat", "r+") as file:
        for k in range(30):
            file[f"again{k}"] = file["/"]
        empty = file.require_group("#refs#").create_dataset("a", (1, 3 * 10**9), "u2", chunks=(1, 10**6))
        empty.attrs["MATLAB_class"] = np.bytes_("char")
        names = file.create_dataset("names", (1, 1), dtype=h5py.ref_dtype)
        names[0, 0] = empty.ref
        names.attrs["MATLAB_class"] = np.bytes_("cell")
    assert read_record(tmp_path / "a.mat").output_names == ("x",)
    with h5py.File(tmp_path / "a.mat", "r+") as file:
        for k in range(8200):
            file[f"number{k}"] = 0.0
    with pytest.raises(UnreadableFileError, match="more than 8192 arrays"):
        read_record(tmp_path / "a.mat")


@pytest.mark.parametrize("share", [0.1, 0.4, 0.7, 0.95])
def test_cut_off(write, share):
    path = write(dt=1.0, y=np.tile(TIPS, (100, 1)))
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(UnreadableFileError, match=r"record\.mat is damaged, cut off or no MAT file"):
        read_record(path)
