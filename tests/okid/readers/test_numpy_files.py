"""NPY and NPZ written by numpy: large arrays stay on disk, nothing is unpickled."""

import os
import subprocess
import sys
import tempfile
import tracemalloc
from types import SimpleNamespace

import numpy as np
import pytest

from okid.errors import IdentificationWarning, InvalidDataError, UnreadableFileError
from okid.readers import arrays, describe_file, guard, read_record
from okid.readers.arrays import npz_contents

RNG = np.random.default_rng(7)
VALUES = RNG.standard_normal((50, 5))


def test_npy_columns_are_numbered(tmp_path):
    np.save(tmp_path / "a.npy", VALUES)
    record = read_record(tmp_path / "a.npy", inputs=["column_4", "column_1"], dt=0.5)
    np.testing.assert_array_equal(record.inputs, VALUES[:, [4, 1]])
    np.testing.assert_array_equal(record.outputs, VALUES[:, [0, 2, 3]])
    assert record.output_names == ("column_0", "column_2", "column_3")
    assert (record.name, record.dt, record.input_hold) == ("a", 0.5, "band_limited")


@pytest.mark.parametrize("dtype", [np.float32, np.int16, ">f8"])
def test_npy_of_other_numbers(tmp_path, dtype):
    values = (VALUES * 100).astype(dtype)
    np.save(tmp_path / "a.npy", values)
    np.testing.assert_array_equal(read_record(tmp_path / "a.npy", dt=1.0).outputs, values.astype(float))


def test_npy_in_columns_first_order_and_one_axis(tmp_path):
    np.save(tmp_path / "a.npy", np.asfortranarray(VALUES))
    np.testing.assert_array_equal(read_record(tmp_path / "a.npy", dt=1.0).outputs, VALUES)
    np.save(tmp_path / "b.npy", VALUES[:, 0])
    np.testing.assert_array_equal(read_record(tmp_path / "b.npy", dt=1.0).outputs, VALUES[:, :1])


def test_npy_with_fields(tmp_path):
    rows = np.zeros(20, dtype=[("time", "f8"), ("u", "f4"), ("y", "i4")])
    rows["time"] = 0.25 * np.arange(20)
    rows["y"] = np.arange(20) ** 2
    np.save(tmp_path / "a.npy", rows)
    record = read_record(tmp_path / "a.npy", inputs="u")
    assert record.dt == 0.25
    np.testing.assert_array_equal(record.outputs[:, 0], np.arange(20) ** 2)


def test_a_large_npy_stays_on_disk(tmp_path):
    np.save(tmp_path / "a.npy", RNG.standard_normal((62_500, 68)))  # 34 MB
    names = [f"column_{index}" for index in range(4)]
    tracemalloc.start()
    try:
        record = read_record(tmp_path / "a.npy", inputs=names, dt=0.01)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert record.outputs.shape == (62_500, 64)
    assert not record.outputs.flags.owndata
    assert peak < 8e6


def test_npz_is_unpacked_once_and_to_its_checksum(tmp_path):
    np.savez_compressed(tmp_path / "a.npz", outputs=np.zeros((200_000, 5)), dt=0.01)
    tracemalloc.start()
    outputs = npz_contents(tmp_path / "a.npz")["outputs"]
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1.5 * np.asarray(outputs).nbytes
    np.savez(tmp_path / "b.npz", outputs=np.arange(5000.0), dt=0.01)
    data = bytearray((tmp_path / "b.npz").read_bytes())
    data[data.index(np.float64(4999).tobytes())] ^= 1  # in the last number
    (tmp_path / "b.npz").write_bytes(data)
    with pytest.raises(UnreadableFileError, match="Bad CRC-32"):
        read_record(tmp_path / "b.npz")


def test_a_small_npy_is_its_own(tmp_path):
    """What is cut after it was read changes nothing: of a mapped file the process would die."""
    np.save(tmp_path / "a.npy", VALUES)
    record = read_record(tmp_path / "a.npy", dt=1.0)
    os.truncate(tmp_path / "a.npy", 100)
    np.testing.assert_array_equal(record.outputs, VALUES)


def test_npz_with_roles_names_and_units(tmp_path):
    np.savez(
        tmp_path / "a.npz",
        inputs=VALUES[:, :2],
        outputs=VALUES[:, 2:],
        dt=0.01,
        input_names=["shaker", "base"],
        input_units=["kN", "g"],
        output_names=["tip [mm]", "root", "mid"],
    )
    record = read_record(tmp_path / "a.npz")
    assert record.input_names == ("shaker", "base")
    assert record.input_units == ("N", "m/s^2")
    assert record.output_names == ("tip", "root", "mid")
    assert record.output_units == ("m", "", "")
    assert record.dt == 0.01
    np.testing.assert_allclose(record.inputs, VALUES[:, :2] * [1000, 9.80665], rtol=1e-14)
    np.testing.assert_allclose(record.outputs[:, 0], VALUES[:, 2] * 1e-3, rtol=1e-14)
    chosen = read_record(tmp_path / "a.npz", inputs="base", outputs=["root"])
    assert (chosen.input_names, chosen.output_names) == (("base",), ("root",))
    assert read_record(tmp_path / "a.npz", outputs=["root"]).n_inputs == 0


def test_npz_with_outputs_alone(tmp_path):
    np.savez_compressed(tmp_path / "a.npz", outputs=VALUES, fs=200.0)
    record = read_record(tmp_path / "a.npz")
    assert (record.n_inputs, record.n_outputs, record.dt) == (0, 5, 0.005)
    assert record.output_names[0] == "output_0"


def test_npz_with_named_channels_and_time(tmp_path):
    np.savez(tmp_path / "a.npz", time=3.0 + 0.1 * np.arange(50), force=VALUES[:, 0], acc=VALUES[:, 1:3], mass=2.5)
    record = read_record(tmp_path / "a.npz", inputs="force")
    assert record.output_names == ("acc_0", "acc_1")
    assert record.dt == pytest.approx(0.1)
    assert record.start_time == 3.0
    np.testing.assert_array_equal(record.outputs, VALUES[:, 1:3])
    assert any("mass left out: it is a single number" in remark for remark in describe_file(tmp_path / "a.npz").remarks)


def test_npz_arrays_of_other_lengths_are_left_out_and_said(tmp_path):
    np.savez(tmp_path / "a.npz", dt=1.0, u=VALUES[:, 0], y=VALUES[:, 1], turned=VALUES.T, z=1j * VALUES[:, 0])
    assert read_record(tmp_path / "a.npz", inputs="u", outputs="y").output_names == ("y",)
    with pytest.raises(InvalidDataError, match=r"'turned' .* \(5, 50\), but the record has 50 samples .*transpose"):
        read_record(tmp_path / "a.npz", inputs="turned")
    with pytest.raises(InvalidDataError, match=r"'z' .* complex"):
        read_record(tmp_path / "a.npz", inputs="z")


def test_npz_time_and_step_must_agree(tmp_path):
    np.savez(tmp_path / "a.npz", dt=0.2, time=0.1 * np.arange(50), y=VALUES[:, 0])
    with pytest.raises(InvalidDataError, match=r"step of 0\.1 s, but the file states 0\.2 s"):
        read_record(tmp_path / "a.npz")


@pytest.mark.parametrize("stated", [{"dt": 0.01, "fs": 50}, {"dt": 0.01, "Ts": 0.02}])
def test_npz_that_states_two_steps_is_not_guessed_at(tmp_path, stated):
    np.savez(tmp_path / "a.npz", y=VALUES[:, 0], **stated)
    with pytest.raises(InvalidDataError, match=r"more than one time step \(dt says 0\.01 s, (fs|Ts) says 0\.02 s\)"):
        read_record(tmp_path / "a.npz")
    assert read_record(tmp_path / "a.npz", dt=0.02).dt == 0.02
    np.savez(tmp_path / "b.npz", y=VALUES[:, 0], dt=0.02, fs=50)
    assert read_record(tmp_path / "b.npz").dt == 0.02


def test_npz_names_must_fit(tmp_path):
    np.savez(tmp_path / "a.npz", dt=0.2, outputs=VALUES, output_names=["a", "b"])
    with pytest.raises(InvalidDataError, match=r"output_names of a.npz holds 2 texts, but outputs has 5 columns"):
        read_record(tmp_path / "a.npz")


LARGE = np.arange(2.5e6).reshape(-1, 2)
"""20 MB: kept on disk."""


@pytest.mark.parametrize("order", ["C", "F"])
def test_a_large_npy_that_is_cut_or_written_anew_stays_what_it_was(tmp_path, order):
    """In a process of its own, which the system would end."""
    np.save(tmp_path / "a.npy", np.asarray(LARGE, order=order))
    script = (
        "import os, sys\n"
        "import numpy as np\n"
        "from okid.readers import read_record\n"
        "record = read_record(sys.argv[1], dt=1.0)\n"
        "os.truncate(sys.argv[1], 300)\n"
        "np.testing.assert_array_equal(record.outputs, np.arange(2.5e6).reshape(-1, 2))\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", script, tmp_path / "a.npy"], capture_output=True, text=True, check=False, timeout=60
    )
    assert (run.returncode, run.stderr) == (0, "")


def test_an_npy_that_is_written_to_while_it_is_read_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "a.npy"
    np.save(path, LARGE)
    with monkeypatch.context() as patch:
        patch.setattr(arrays.shutil, "copyfileobj", lambda _from, to: to.write(b"1" * 1000))
        with pytest.raises(UnreadableFileError, match="it was cut while it was read"):
            read_record(path, dt=1.0)

    def slowly(source, copy):
        copy.write(source.read())
        with path.open("r+b") as file:
            file.write(b"\x93")
        os.utime(path, ns=(1, 1))

    def replaced(source, copy):
        copy.write(source.read())
        np.save(tmp_path / "b.npy", LARGE)
        os.utime(tmp_path / "b.npy", ns=(path.stat().st_mtime_ns, path.stat().st_mtime_ns))
        (tmp_path / "b.npy").replace(path)

    for change in (slowly, replaced):
        monkeypatch.setattr(arrays.shutil, "copyfileobj", change)
        with pytest.raises(UnreadableFileError, match="it was written to while it was read"):
            read_record(path, dt=1.0)


@pytest.mark.parametrize("lack", ["room", "disk", "folder", "end"])
def test_without_room_for_a_copy_the_file_itself_is_mapped(tmp_path, monkeypatch, lack):
    """A copy would fill the disk, or take the memory that a mapped file is to spare."""
    np.save(tmp_path / "a.npy", LARGE)
    monkeypatch.setenv("TMPDIR", str(tmp_path / ("none" if lack == "folder" else "")))
    if lack == "room":
        monkeypatch.setattr(arrays.shutil, "disk_usage", lambda _folder: SimpleNamespace(free=30e6))
    if lack == "disk":
        device = tmp_path.stat().st_dev
        (tmp_path / "mounts").write_text(f"25 24 {os.major(device)}:{os.minor(device)} / /tmp rw - tmpfs tmpfs rw\n")
        monkeypatch.setattr(guard, "MOUNTS", tmp_path / "mounts")

    def full(_from, to):
        assert lack == "end", "it was copied"
        to.write(b"1" * 1000)
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(arrays.shutil, "copyfileobj", full)
    monkeypatch.setattr(guard, "memory_budget", lambda: (30e6, "the container leaves"))
    record = read_record(tmp_path / "a.npy", dt=1.0)
    assert not record.outputs.flags.owndata
    np.testing.assert_array_equal(record.outputs, LARGE)


@pytest.mark.skipif(sys.platform != "linux", reason="ulimit -v is of Linux")
def test_a_large_npy_beyond_what_may_be_mapped_is_not_called_damaged(tmp_path):
    with (tmp_path / "a.npy").open("wb") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": (1 << 30,)})
        file.truncate(file.tell() + (8 << 30))
    script = (
        "import resource, sys\n"
        "from okid.readers import arrays, read_record\n"
        "arrays.DISK_SHARE = 0.0\n"
        "resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30))\n"
        "read_record(sys.argv[1], dt=1.0)\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", script, tmp_path / "a.npy"], capture_output=True, text=True, check=False, timeout=60
    )
    assert "a.npy has 8589934720 bytes, more than this process may map; raise the limit (ulimit -v)" in run.stderr


def test_the_copy_lies_where_the_user_says_or_on_a_disk(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(arrays.shutil, "disk_usage", lambda folder: asked.append(folder) or SimpleNamespace(free=0.0))
    np.save(tmp_path / "a.npy", LARGE)
    for given, folder in (("", "/var/tmp"), (str(tmp_path), str(tmp_path))):  # noqa: S108 - as the reader has it
        monkeypatch.setenv("TMPDIR", given)
        read_record(tmp_path / "a.npy", dt=1.0)
        assert asked.pop() == (folder if os.access(folder, os.W_OK) else tempfile.gettempdir())


def test_what_a_large_npy_becomes_as_numbers_of_eight_bytes_is_in_the_budget(tmp_path, monkeypatch):
    np.save(tmp_path / "a.npy", np.zeros((1 << 24, 2), dtype=np.int8))
    monkeypatch.setattr(guard, "memory_budget", lambda: (2**28, "the container leaves"))
    with pytest.raises(
        UnreadableFileError, match=r"reading a\.npy needs about 0\.5 GiB, more than 80% of the 0\.2 GiB"
    ):
        read_record(tmp_path / "a.npy", dt=1.0)


def test_a_header_that_is_too_long_is_no_pickle_and_no_columns_are_no_channel(tmp_path):
    np.save(tmp_path / "a.npy", VALUES)
    data = (tmp_path / "a.npy").read_bytes()
    at = 10 + int.from_bytes(data[8:10], "little")
    header = data[10:at].rstrip() + b" " * 20_000 + b"\n"
    (tmp_path / "a.npy").write_bytes(data[:8] + len(header).to_bytes(2, "little") + header + data[at:])
    with pytest.raises(UnreadableFileError, match="Header info length"):
        read_record(tmp_path / "a.npy", dt=1.0)
    np.save(tmp_path / "b.npy", np.zeros((9, 0)))
    with pytest.raises(UnreadableFileError, match=r"b\.npy holds 9 samples of no channel"):
        read_record(tmp_path / "b.npy", dt=1.0)


def test_a_unit_in_the_name_of_a_matrix_is_warned_of(tmp_path):
    np.savez(tmp_path / "a.npz", acc_g=VALUES, dt=0.01)
    with pytest.warns(IdentificationWarning, match=r"acc_g_0, acc_g_1, .* .the name ends in 'g'"):
        assert read_record(tmp_path / "a.npz").output_units == ("",) * 5


def test_a_matrix_that_lies_on_its_side_is_missed_aloud(tmp_path):
    np.savez(tmp_path / "a.npz", u=VALUES[:, :1], y=VALUES.T, dt=0.01)
    with pytest.warns(IdentificationWarning, match=r"^y was left out: its shape is \(5, 50\).*save its transpose"):
        assert read_record(tmp_path / "a.npz").output_names == ("u",)
