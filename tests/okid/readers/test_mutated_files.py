"""A small run of `tests/benchmarks/fuzz.py`, and the faults that it found, one file each."""

import importlib.util
import logging
import struct
import sys
import threading
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest
import scipy

from okid.errors import InvalidDataError, UnreadableFileError, quiet
from okid.readers import read_record
from okid.readers.dispatch import read_table

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
TIPS = np.random.default_rng(4).standard_normal((30, 2))


@pytest.fixture(scope="module")
def fuzz():
    """The benchmark as a module; it imports its neighbour."""
    sys.path.insert(0, str(BENCHMARKS))
    try:
        spec = importlib.util.spec_from_file_location("fuzz", BENCHMARKS / "fuzz.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        yield module
    finally:
        sys.path.remove(str(BENCHMARKS))


@pytest.mark.parametrize("name", ["npy", "npz", "mat5", "mat73", "csv", "tdms"])
def test_mutated_files_are_read_right_or_refused(fuzz, name, tmp_path):
    fuzz.make_sound(name, tmp_path)
    counts, faults = fuzz.fuzz(name, tmp_path, seed=7, count=80)
    assert faults == []
    assert sum(counts.values()) == 80
    assert counts["refused"] >= 10


def test_the_fuzzer_sees_what_it_is_for(fuzz, tmp_path, monkeypatch):
    """A reader that loses a number, raises a foreign error, speaks or dies is found at once."""
    fuzz.make_sound("npy", tmp_path)
    (tmp_path / "sitecustomize.py").write_text(
        "import os, sys\n"
        "import okid.readers.dispatch as dispatch\n"
        "original, count = dispatch.READERS['.npy'], [0]\n"
        "def reader(path):\n"
        "    count[0] += 1\n"
        "    if count[0] == 8: raise KeyError('foreign')\n"
        "    if count[0] == 9: os.abort()\n"
        "    if count[0] == 10: print('words', file=sys.stderr)\n"
        "    return original(path)\n"
        "dispatch.READERS['.npy'] = reader\n"
    )
    monkeypatch.setattr(fuzz, "ROOT", f"{tmp_path}:{fuzz.ROOT}")
    _, faults = fuzz.fuzz("npy", tmp_path, seed=1, count=8)
    assert [outcome for _, outcome, _ in faults[:2]] == ["foreign", "dead"]


def refused(path, match):
    with pytest.raises(UnreadableFileError, match=match) as caught:
        read_table(path)
    assert str(caught.value).isprintable()


def test_an_npy_whose_header_leaves_bytes_over(tmp_path):
    np.save(tmp_path / "a.npy", TIPS)
    data = (tmp_path / "a.npy").read_bytes()
    (tmp_path / "a.npy").write_bytes(data.replace(b"(30, 2)", b"(20, 2)"))
    refused(tmp_path / "a.npy", "announces 320 bytes of float64 in shape .20, 2., and 480 follow")
    (tmp_path / "a.npy").write_bytes(data.replace(b"(30, 2), }", b"((30, 2),}"))
    refused(tmp_path / "a.npy", r"a\.npy is damaged, cut off or no \.npy file")


def test_archives_are_refused_by_what_they_claim(tmp_path):
    np.savez_compressed(tmp_path / "a.npz", tip=TIPS)
    data = bytearray((tmp_path / "a.npz").read_bytes())
    entry = data.rindex(b"PK\x01\x02")

    def written(offset, value):
        changed = bytearray(data)
        changed[entry + offset : entry + offset + len(value)] = value
        (tmp_path / "b.npz").write_bytes(changed)
        return tmp_path / "b.npz"

    refused(written(8, b"\x01\x00"), "is encrypted; save it without a password")
    refused(written(24, struct.pack("<I", 1 << 30)), "claims to unpack to more than it can hold")
    refused(written(20, struct.pack("<I", 1 << 30)), "its members overlap")
    refused(written(10, struct.pack("<H", 12)), "packed in a way that is not read")
    with zipfile.ZipFile(tmp_path / "c.npz", "w") as archive:
        for number in range(8200):
            archive.writestr(f"{number}.npy", b"")
    refused(tmp_path / "c.npz", "8200 members are more than 8192")


@pytest.mark.parametrize("big", [False, True])
def test_mat_5_as_scipy_reads_it(tmp_path, big):
    """Every kind of number, in both byte orders; a byte-swapped file is made by hand from MATLAB's format."""
    numbers = {kind: (100 * TIPS).astype(kind) for kind in ("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8")}
    if not big:
        scipy.io.savemat(tmp_path / "a.mat", {f"x_{kind}": value for kind, value in numbers.items()})
    else:
        (tmp_path / "a.mat").write_bytes(big_endian({f"x_{kind}": value for kind, value in numbers.items()}))
    table = read_table(tmp_path / "a.mat")
    known = scipy.io.loadmat(tmp_path / "a.mat")
    for index, column in enumerate(table.columns):
        name, _, number = column.name.rpartition("_")
        np.testing.assert_array_equal(table.values[:, index], known[name][:, int(number)])
    assert len(table.columns) == 20


def big_endian(arrays):
    kinds = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 9, "i8": 12, "u8": 13}
    classes = {"f8": 6, "f4": 7, "i1": 8, "u1": 9, "i2": 10, "u2": 11, "i4": 12, "u4": 13, "i8": 14, "u8": 15}

    def element(kind, data):
        return struct.pack(">II", kind, len(data)) + data + bytes(-len(data) % 8)

    out = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x01\x00MI"
    for name, value in arrays.items():
        kind = name[2:]
        parts = element(6, struct.pack(">II", classes[kind], 0)) + element(5, struct.pack(">ii", *value.shape))
        parts += element(1, name.encode()) + element(kinds[kind], value.astype(f">{kind}").tobytes(order="F"))
        out += element(14, parts)
    return out


def test_mat_5_sizes_are_walked(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"tip": TIPS})
    data = bytearray((tmp_path / "a.mat").read_bytes())
    data[128 + 8 + 16 + 8 : 128 + 8 + 16 + 12] = struct.pack("<i", 29)  # rows
    (tmp_path / "a.mat").write_bytes(data)
    refused(tmp_path / "a.mat", r"an array of shape \(29, 2\) in 480 bytes")


def test_mat_5_sizes_are_walked_in_several_structures_too(tmp_path):
    """Several structures are passed over, but what they claim must be there."""
    several = np.zeros((2, 1), dtype=[("x", object)])
    several["x"] = [[1.5], ["a text"]]
    scipy.io.savemat(tmp_path / "a.mat", {"several": several, "tip": TIPS})
    np.testing.assert_array_equal(read_table(tmp_path / "a.mat").values, TIPS)
    data = bytearray((tmp_path / "a.mat").read_bytes())
    assert data[128 + 8 + 16 + 8] == 2
    data[128 + 8 + 16 + 8] = 9  # structures
    (tmp_path / "a.mat").write_bytes(data)
    refused(tmp_path / "a.mat", "parts are announced in|bytes are announced, and")


def test_a_damaged_hdf5_signature_is_told_from_mat_5(tmp_path):
    header = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116) + bytes(8) + b"\x00\x02IM"
    (tmp_path / "a.mat").write_bytes(header.ljust(512, b"\0") + b"\x88HDF\r\n\x1a\n" + bytes(600))
    refused(tmp_path / "a.mat", "its header says version 7.3, but the signature of HDF5 behind it is gone")


def test_hdf5_with_a_committed_data_type(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.mat", "w") as file:
        file["kind of number"] = np.dtype("<f4")
        file.create_dataset("tip", data=TIPS[:, 0], dtype=file["kind of number"])
    np.testing.assert_array_equal(read_record(tmp_path / "a.mat", dt=1.0).outputs[:, 0], TIPS[:, 0].astype("f4"))


def test_hdf5_that_claims_more_than_it_can_hold(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.mat", "w") as file:
        file.create_dataset("tip", (10**7, 2), dtype="f8", chunks=(100, 2), compression="gzip")
    refused(tmp_path / "a.mat", "160000000 bytes are announced in 0 that are there")


def test_a_damaged_first_row_is_no_header(tmp_path):
    (tmp_path / "a.csv").write_text("0.0x,1.5,2.5\n0.1,1.6,2.6\n0.2,1.7,2.7\n")
    refused(tmp_path / "a.csv", "line 1, column 'column_0' of a.csv holds '0.0x' where a number is expected")
    (tmp_path / "a.csv").write_text("time,1,2\n0.1,1.6,2.6\n0.2,1.7,2.7\n")
    assert read_record(tmp_path / "a.csv").output_names == ("1", "2")


def test_a_tdms_that_is_cut_off_is_refused_and_its_log_stays_off_the_terminal(tmp_path, capfd):
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(str(tmp_path / "a.tdms")) as writer:
        writer.write_segment([nptdms.ChannelObject("run", "tip", TIPS[:, 0])])
    data = (tmp_path / "a.tdms").read_bytes()
    (tmp_path / "a.tdms").write_bytes(data[:-50])
    refused(tmp_path / "a.tdms", "Last segment of file has less data than expected")
    logging.getLogger("nptdms.reader").warning("of somebody else")
    assert "Last segment" not in capfd.readouterr().err


def test_control_characters_of_a_file_are_shown_and_not_obeyed(tmp_path):
    (tmp_path / "\x1b[2Ja.csv").write_text("time,y\n0,1\n1,\x1b[31mred\n2,3\n")
    with pytest.raises(InvalidDataError) as caught:
        read_record(tmp_path / "\x1b[2Ja.csv")
    assert str(caught.value).isprintable()
    assert "\N{REPLACEMENT CHARACTER}[2Ja.csv" in str(caught.value)


def test_quiet_blocks_of_several_threads_leave_the_filters_as_they_were():
    before, inside, go = list(warnings.filters), threading.Event(), threading.Event()

    def other():
        with quiet():
            inside.set()
            go.wait(10)

    thread = threading.Thread(target=other)
    with quiet():
        thread.start()
        inside.wait(10)
        warnings.warn("not shown", stacklevel=1)
    warnings.warn("not shown either: the other block is open", stacklevel=1)
    go.set()
    thread.join()
    assert list(warnings.filters) == before
    with pytest.warns(UserWarning, match="shown again"):
        warnings.warn("shown again", stacklevel=1)
