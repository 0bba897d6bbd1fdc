"""Whatever is wrong with a file: one sentence with rule, numbers and remedy, and nothing from the file is run."""

import builtins
import math
import os
import pickle
import subprocess
import sys
import zipfile

import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st

from okid.errors import IdentificationError, InvalidDataError, UnreadableFileError
from okid.readers import guard, read_record
from okid.readers.dispatch import READERS

VALUES = np.random.default_rng(5).standard_normal((500, 3))


class Bomb:
    """Unpickling it would call `pytest.fail`."""

    def __reduce__(self):
        return (pytest.fail, ("a pickle was loaded",))


def refused(path, match, **options):
    with pytest.raises(InvalidDataError, match=match) as caught:
        read_record(path, **options)
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < 600
    assert message.endswith((".", ")"))
    return caught.value


def test_no_such_file(tmp_path):
    refused(tmp_path / "nothing.csv", "does not exist; check the path")


def test_a_folder(tmp_path):
    refused(tmp_path, "is a folder; give the file")


def test_a_pipe_is_no_file(tmp_path):
    os.mkfifo(tmp_path / "a.csv")
    refused(tmp_path / "a.csv", "is a pipe or a device")


def test_a_name_too_long_for_the_system_is_cut(tmp_path):
    refused(tmp_path / ("x" * 5000 + ".csv"), "cannot be opened .File name too long.")


def test_a_file_without_channels_says_what_was_left_out(tmp_path):
    np.savez(tmp_path / "a.npz", time=np.arange(9.0), tip=1j * np.arange(9.0))
    refused(tmp_path / "a.npz", r"a\.npz holds time but no channel; 'tip' was left out: it is complex")
    (tmp_path / "b.csv").write_text("time [s]\n0\n1\n2\n")
    refused(tmp_path / "b.csv", r"b\.csv holds time but no channel; save each channel as a column")


@pytest.mark.parametrize("suffix", READERS)
def test_an_empty_file(tmp_path, suffix):
    (tmp_path / f"a{suffix}").touch()
    refused(tmp_path / f"a{suffix}", "is empty .0 bytes")


@pytest.mark.parametrize("name", ["a.xlsx", "a.pkl", "a", "a.h5"])
def test_an_unknown_type(tmp_path, name):
    (tmp_path / name).write_text("1,2\n")
    refused(tmp_path / name, r"which is not read; the types read are \.csv, \.txt")


def test_upper_case_extensions_are_known(tmp_path):
    (tmp_path / "A.CSV").write_text("time [s],y\n0,1\n1,2\n")
    assert read_record(tmp_path / "A.CSV").n_samples == 2


@pytest.mark.parametrize("suffix", READERS)
@settings(max_examples=25, deadline=None)
@given(junk=st.binary(min_size=1, max_size=400))
def test_any_bytes_are_a_record_or_one_of_our_errors(suffix, junk, tmp_path_factory):
    path = tmp_path_factory.mktemp("junk") / f"a{suffix}"
    path.write_bytes(junk)
    message = ""
    try:
        assert read_record(path, dt=1.0).n_samples > 0
    except IdentificationError as error:
        message = str(error)
    assert "\n" not in message
    assert len(message) < 700


def test_pickles_are_never_loaded(tmp_path):
    objects = np.array([Bomb()], dtype=object)
    np.savez(tmp_path / "a.npz", outputs=VALUES, dt=1.0, extra=objects)
    refused(tmp_path / "a.npz", "pickled Python objects, which are never loaded")
    np.save(tmp_path / "a.npy", objects, allow_pickle=True)
    refused(tmp_path / "a.npy", "pickled Python objects, which are never loaded")
    (tmp_path / "b.npy").write_bytes(pickle.dumps(Bomb()))
    refused(tmp_path / "b.npy", "pickled|damaged")
    with zipfile.ZipFile(tmp_path / "b.npz", "w") as archive:
        archive.writestr("outputs.npy", pickle.dumps(Bomb()))
    refused(tmp_path / "b.npz", "pickled|damaged|no array of samples")


@pytest.mark.parametrize("share", [0.02, 0.5, 0.9, 0.999])
@pytest.mark.parametrize("compressed", [False, True])
def test_cut_off_npz(tmp_path, share, compressed):
    (np.savez_compressed if compressed else np.savez)(tmp_path / "a.npz", outputs=VALUES, dt=1.0)
    whole = (tmp_path / "a.npz").read_bytes()
    (tmp_path / "a.npz").write_bytes(whole[: int(share * len(whole))])
    refused(tmp_path / "a.npz", r"a\.npz is damaged, cut off or no \.npz file")


def test_damaged_inside_npz(tmp_path):
    np.savez(tmp_path / "a.npz", outputs=VALUES, dt=1.0)
    whole = bytearray((tmp_path / "a.npz").read_bytes())
    whole[3000] ^= 0xFF
    (tmp_path / "a.npz").write_bytes(whole)
    refused(tmp_path / "a.npz", "damaged.*CRC")


@pytest.mark.parametrize("share", [0.005, 0.5, 0.999])
def test_cut_off_npy(tmp_path, share):
    np.save(tmp_path / "a.npy", VALUES)
    whole = (tmp_path / "a.npy").read_bytes()
    (tmp_path / "a.npy").write_bytes(whole[: int(share * len(whole))])
    refused(tmp_path / "a.npy", "damaged")


def test_more_channels_than_samples(tmp_path):
    np.save(tmp_path / "a.npy", VALUES.T)
    refused(tmp_path / "a.npy", r"a\.npy holds 500 outputs but only 3 samples; .* save its transpose", dt=1.0)
    np.save(tmp_path / "b.npy", np.zeros((2, 5000)))
    refused(tmp_path / "b.npy", "4096", dt=1.0)


def test_nan_everywhere_and_infinity(tmp_path):
    (tmp_path / "a.csv").write_text("time [s],u,y\n" + "".join(f"{row},1,nan\n" for row in range(9)))
    refused(tmp_path / "a.csv", r"a\.csv: output 'y' holds no number in any of its 9 samples; leave it out", inputs="u")
    assert read_record(tmp_path / "a.csv", outputs="u").n_samples == 9
    assert np.isnan(read_record(tmp_path / "a.csv").outputs).all(axis=0).tolist() == [False, True]  # `identify` says so
    (tmp_path / "a.csv").write_text("time [s],y\n0,1\n1,inf\n2,3\n")
    refused(tmp_path / "a.csv", r"a\.csv: outputs must not hold infinite values, but sample 1 of channel 0")


def test_arrays_that_are_no_record(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros((4, 4, 4)))
    refused(tmp_path / "a.npy", "float64 with 3 axes", dt=1.0)
    np.save(tmp_path / "b.npy", np.array(["a", "b"]))
    refused(tmp_path / "b.npy", "an array of <U1", dt=1.0)
    scipy.io.savemat(tmp_path / "a.mat", {"note": "hello", "gain": 2.0})
    refused(tmp_path / "a.mat", r"no array of samples \(it holds 'note', 'gain'\)", dt=1.0)


def test_double_names(tmp_path):
    (tmp_path / "a.csv").write_text("time,y,y\n0,1,2\n1,2,3\n")
    refused(tmp_path / "a.csv", "more than one column called 'y'")


def test_a_text_is_read_where_its_table_fits_though_the_text_would_not(tmp_path, monkeypatch):
    """Eighteen figures a number: the text weighs three tables, and never stands in memory."""
    values = np.random.default_rng(2).standard_normal((40_000, 3))
    np.savetxt(tmp_path / "a.csv", values, delimiter=",")
    size, table = (tmp_path / "a.csv").stat().st_size, values.nbytes
    assert size > 3 * table
    monkeypatch.setattr(guard, "_machine", lambda: 1.7 * table)
    np.testing.assert_array_equal(read_record(tmp_path / "a.csv", dt=1.0).outputs, values)
    monkeypatch.setattr(guard, "_machine", lambda: 1.4 * table)
    refused(tmp_path / "a.csv", "needs about .* GiB, more than 80% .* save it as one .npy array")


def test_a_file_larger_than_memory_is_not_read(tmp_path, monkeypatch):
    monkeypatch.setattr(guard, "_machine", lambda: 10_000.0)
    np.savetxt(tmp_path / "a.csv", VALUES, delimiter=",")
    refused(tmp_path / "a.csv", "needs about .* GiB, more than 80% .* save it as one .npy array")
    np.savez_compressed(tmp_path / "a.npz", outputs=np.zeros((5000, 1)), dt=1.0)
    assert (tmp_path / "a.npz").stat().st_size < 2000
    refused(tmp_path / "a.npz", "needs about")
    scipy.io.savemat(tmp_path / "a.mat", {"y": np.zeros((5000, 1))}, do_compression=True)
    refused(tmp_path / "a.mat", "needs about")
    np.save(tmp_path / "a.npy", VALUES)
    assert read_record(tmp_path / "a.npy", dt=1.0).n_samples == 500  # mapped


def test_a_system_that_does_not_tell_its_memory(tmp_path, monkeypatch):
    for name in ("_machine", "_group", "_address_space"):
        monkeypatch.setattr(guard, name, lambda: math.inf)
    np.savez(tmp_path / "a.npz", outputs=VALUES, dt=1.0)
    assert read_record(tmp_path / "a.npz").n_samples == 500


def test_the_limit_of_a_container_counts(tmp_path, monkeypatch):
    """Both versions of control groups; the files that a group holds could go, and a group above may be tighter."""
    for version, root, files in (
        ("0::/outer/inner\n", tmp_path / "two", ("memory.max", "memory.current")),
        (
            "4:memory:/outer/inner\n1:cpu:/\n",
            tmp_path / "one" / "memory",
            ("memory.limit_in_bytes", "memory.usage_in_bytes"),
        ),
    ):
        inner = root / "outer" / "inner"
        inner.mkdir(parents=True)
        (inner / files[0]).write_text("max\n" if files[0] == "memory.max" else f"{1 << 62}\n")
        (inner.parent / files[0]).write_text(f"{3 << 30}\n")
        (inner.parent / files[1]).write_text(f"{2 << 30}\n")
        (inner.parent / "memory.stat").write_text(f"anon 7\ninactive_file {1 << 30}\n")
        (tmp_path / "cgroup").write_text(version)
        monkeypatch.setattr(guard, "CGROUPS", tmp_path / "cgroup")
        monkeypatch.setattr(guard, "CGROUP_ROOT", root.parent if root.name == "memory" else root)
        assert guard.memory_budget() == (2 << 30, "the container leaves")


@pytest.mark.skipif(sys.platform != "linux", reason="/proc and ulimit are of Linux")
def test_under_a_limit_on_the_address_space_a_file_is_refused_beforehand(tmp_path):
    np.savez_compressed(tmp_path / "a.npz", outputs=np.ones((3 << 20, 4)), dt=1.0)  # 96 MiB that weigh nothing
    script = (
        "import resource, sys\n"
        "from okid.errors import UnreadableFileError\n"
        "from okid.readers import read_record\n"
        "used = int(open('/proc/self/statm').read().split()[0]) * 4096\n"
        "resource.setrlimit(resource.RLIMIT_AS, (used + (200 << 20), used + (200 << 20)))\n"
        "try: read_record(sys.argv[1])\n"
        "except UnreadableFileError as error: print(error)\n"
    )
    run = subprocess.run([sys.executable, "-c", script, tmp_path / "a.npz"], capture_output=True, text=True, check=True)
    assert "needs about 0.2 GiB, more than 80% of the 0.2 GiB that ulimit leaves" in run.stdout


@pytest.mark.parametrize(("suffix", "library"), [(".uff", "pyuff"), (".tdms", "nptdms"), (".mat", "h5py")])
def test_a_missing_library_is_named_with_its_command(tmp_path, monkeypatch, suffix, library):
    (tmp_path / f"a{suffix}").write_bytes(b"\x89HDF\r\n\x1a\n" + b"    -1\n    -1\n")
    original = builtins.__import__

    def without(name, *arguments, **options):
        if name.partition(".")[0] == library:
            raise ModuleNotFoundError(name=name)
        return original(name, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", without)
    monkeypatch.setattr(guard.importlib, "import_module", without)
    refused(
        tmp_path / f"a{suffix}", rf'needs the library {library}, which is not installed; run: pip install "okid-modal'
    )


def test_errors_are_of_one_tree():
    assert issubclass(UnreadableFileError, InvalidDataError)
    assert issubclass(InvalidDataError, (IdentificationError, ValueError))
