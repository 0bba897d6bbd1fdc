"""A result comes back from its file bit for bit; a file that is not one is refused in one sentence."""

import io
import json
import pickle
import zipfile
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from era.realisation import HankelFactors
from modal.identification import result as storage
from modal.identification.result import Identification
from okid.errors import InvalidDataError, UnreadableFileError


def assert_same(first, second, where="result"):
    """Equal types, equal bits."""
    if is_dataclass(first):
        assert type(first) is type(second), where
        for field in fields(first):
            assert_same(getattr(first, field.name), getattr(second, field.name), f"{where}.{field.name}")
    elif isinstance(first, tuple):
        assert isinstance(second, tuple), where
        assert len(first) == len(second), where
        for i, (one, other) in enumerate(zip(first, second, strict=True)):
            assert_same(one, other, f"{where}[{i}]")
    elif isinstance(first, np.ndarray):
        assert (first.dtype, first.shape) == (second.dtype, second.shape), where
        assert first.tobytes() == second.tobytes(), where
        assert not second.flags.writeable, where
    elif isinstance(first, float | complex):
        assert np.array(first).tobytes() == np.array(second).tobytes(), where
    else:
        assert first == second, where


@pytest.fixture
def awkward(identification):
    """Every kind of value that a text could lose: nan, both zeros, infinity, smallest numbers, None, other scripts."""
    mode = replace(
        identification.modes.modes[0],
        pole=complex(-0.0, 5e-324),
        frequency_std=float("nan"),
        damping_ratio_std=float("inf"),
        emac=0.1 + 0.2,
        reason="ζ – “doubtful”\n\t\\",
    )
    outputs = identification.records[0].outputs.copy()
    outputs[3, 0], outputs[4, 1] = np.nan, -0.0
    record = replace(identification.records[0], outputs=outputs)
    order = identification.realisation.order
    factors = HankelFactors(
        observability=np.ones((6, order)) / 3,
        controllability=np.ones((order, 4)) * np.pi,
        n_block_rows=2,
        n_block_columns=4,
        input_scale=np.ones(1),
        output_scale=np.ones(3),
        observer_order=None,
    )
    for name in ("observability", "controllability", "input_scale", "output_scale"):
        getattr(factors, name).flags.writeable = False
    return replace(
        identification,
        records=(record, identification.records[0]),
        modes=replace(identification.modes, modes=(mode, *identification.modes.modes[1:])),
        markov=replace(identification.markov, gain=None),
        realisation=replace(identification.realisation, K=None, factors=factors),
        warnings=(),
    )


def test_comes_back_bit_for_bit(awkward, identification, tmp_path):
    for i, result in enumerate((awkward, identification)):
        path = storage.save(result, tmp_path / f"{i}.npz")
        assert_same(result, storage.load(path))
    assert [entry.name for entry in sorted(tmp_path.iterdir())] == ["0.npz", "1.npz"]  # nothing unfinished is left


def test_the_folder_of_a_report_is_enough(identification, tmp_path):
    storage.save(identification, tmp_path / "result.npz")
    assert_same(identification, storage.load(tmp_path))
    with pytest.raises(UnreadableFileError, match="there is no file"):
        storage.load(tmp_path / "elsewhere")


def test_the_type_saves_itself_and_the_same_result_gives_the_same_bytes(identification, tmp_path):
    first, second = identification.save(tmp_path / "a.npz"), identification.save(str(tmp_path / "b.npz"))
    assert first.read_bytes() == second.read_bytes()


def test_arrays_can_be_read_by_numpy_alone(identification, tmp_path):
    path = identification.save(tmp_path / "a.npz")
    with np.load(path, allow_pickle=False) as archive:
        stored = [archive[name] for name in archive.files if name.startswith("array")]
    assert any(np.array_equal(array, identification.realisation.A) for array in stored)


def test_a_shared_array_is_stored_once(identification, tmp_path):
    once = identification.save(tmp_path / "a.npz").stat().st_size
    twice = replace(identification, records=identification.records * 2).save(tmp_path / "b.npz").stat().st_size
    assert twice - once < identification.records[0].inputs.nbytes


def test_a_small_archive_is_written_in_one_piece_and_a_large_one_as_numpy_writes_it(
    identification, tmp_path, monkeypatch
):
    written = []

    class Counted(io.FileIO):
        def write(self, data):
            written.append(len(data))
            return super().write(data)

    def counted(path, mode):
        return Counted(path, mode)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", counted)
        small = identification.save(tmp_path / "small.npz")
    assert written == [small.stat().st_size]
    monkeypatch.setattr(storage, "_AT_ONCE", 0)
    large = identification.save(tmp_path / "large.npz")
    assert large.read_bytes() == small.read_bytes()
    with zipfile.ZipFile(small) as archive:
        for name in archive.namelist()[1:]:
            stream = io.BytesIO()
            np.lib.format.write_array(stream, np.load(io.BytesIO(archive.read(name))))
            assert archive.read(name) == stream.getvalue()


def test_an_existing_file_is_kept_unless_told(identification, tmp_path):
    path = tmp_path / "a.npz"
    path.write_text("precious")
    with pytest.raises(InvalidDataError, match="exists already; choose another name"):
        identification.save(path)
    assert path.read_text() == "precious"
    assert_same(identification, storage.load(identification.save(path, existing="replace")))
    with pytest.raises(InvalidDataError, match="existing must be refuse or replace, but is 'yes'"):
        identification.save(path, existing="yes")
    with pytest.raises(InvalidDataError, match="does not exist; make it first"):
        identification.save(tmp_path / "nowhere" / "a.npz")
    with pytest.raises(InvalidDataError, match="exists already"):
        identification.save(tmp_path, existing="replace")


def test_a_failed_write_leaves_the_old_file_and_nothing_else(identification, tmp_path, monkeypatch):
    path = identification.save(tmp_path / "a.npz")
    before = path.read_bytes()

    def full_disk(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(storage, "_header", full_disk)
    with pytest.raises(InvalidDataError, match="cannot be written"):
        identification.save(path, existing="replace")
    assert path.read_bytes() == before
    assert len(list(tmp_path.iterdir())) == 1


def test_no_such_file(tmp_path):
    with pytest.raises(UnreadableFileError, match="there is no file"):
        storage.load(tmp_path / "a.npz")


def test_cut_or_changed_files_are_refused(identification, tmp_path):
    whole = identification.save(tmp_path / "a.npz").read_bytes()
    rng = np.random.default_rng(0)
    bad = tmp_path / "bad.npz"
    spots = [len(whole) // 3, *rng.integers(0, len(whole), 60)]
    refused = 0
    for i, spot in enumerate(spots):
        if i % 2:
            changed = whole[:spot]
        else:
            changed = bytearray(whole)
            changed[spot] ^= 0xFF
            changed = bytes(changed)
        bad.write_bytes(changed)
        problem = ""
        try:
            assert_same(identification, storage.load(bad))  # a byte that carries nothing: a date, a padding
        except UnreadableFileError as error:
            problem = str(error)
        assert "\n" not in problem
        assert problem == "" or problem.endswith("save or copy it again.")
        refused += bool(problem)
    assert refused > len(spots) / 2


@pytest.mark.parametrize("content", [b"", b"text", b"PK\x03\x04 nothing", pickle.dumps([1, 2])])
def test_other_files_are_refused(content, tmp_path):
    path = tmp_path / "a.npz"
    path.write_bytes(content)
    with pytest.raises(UnreadableFileError, match="is damaged, cut off or no saved identification"):
        storage.load(path)


def rewritten(path, change, target):
    """The archive with another text and more members; checksums are right, so only the content is wrong."""
    with zipfile.ZipFile(path) as archive, zipfile.ZipFile(target, "w") as result:
        for info in archive.infolist():
            data = archive.read(info)
            data = change(info.filename, data)
            result.writestr(info.filename, data)
    return target


def in_text(change):
    def apply(name, data):
        if name != "result.json":
            return data
        document = json.loads(data)
        change(document)
        return json.dumps(document).encode()

    return apply


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d["result"].pop("modes"),
        lambda d: d["result"].update(more=1),
        lambda d: d["result"].update(warnings="text"),
        lambda d: d["result"]["observer"].update(ridge="large"),
        lambda d: d["result"]["observer"].update(method="guess"),
        lambda d: d["result"]["observer"].update(rank=1.5),
        lambda d: d["result"]["observer"].update(feedthrough={"array": "../../etc/passwd"}),
        lambda d: d["result"]["observer"].update(feedthrough=[1.0]),
        lambda d: d["result"]["records"][0].update(dt=-1.0),
        lambda d: d["result"].update(records={"array": "array_0"}),
        lambda d: d.pop("result"),
        lambda d: d["result"].update(fit=None),
    ],
)
def test_wrong_content_with_right_checksums_is_refused(change, identification, tmp_path):
    path = identification.save(tmp_path / "a.npz")
    with pytest.raises(UnreadableFileError, match=r"is damaged.* or no saved identification") as caught:
        storage.load(rewritten(path, in_text(change), tmp_path / "b.npz"))
    assert "\n" not in str(caught.value)


def test_another_version_says_so(identification, tmp_path):
    path = identification.save(tmp_path / "a.npz")
    target = rewritten(path, in_text(lambda document: document.update(schema=99)), tmp_path / "b.npz")
    with pytest.raises(UnreadableFileError, match="schema version 99, this program reads 1"):
        storage.load(target)


def test_nothing_is_unpickled(identification, tmp_path):
    """An array of objects would run code when read; so would any pickle."""
    path = identification.save(tmp_path / "a.npz")
    harm = tmp_path / "harm"

    class Harm:
        def __reduce__(self):
            return (type(harm).touch, (harm,))

    member = tmp_path / "member.npy"
    np.save(member, np.array([Harm()], dtype=object), allow_pickle=True)
    target = rewritten(
        path, lambda name, data: member.read_bytes() if name == "array_0.npy" else data, tmp_path / "b.npz"
    )
    with pytest.raises(UnreadableFileError):
        storage.load(target)
    assert not harm.exists()


def test_no_file_asks_for_more_memory_than_its_size(identification, tmp_path):
    """A header that claims a terabyte, and a member that unpacks to a hundred times its size."""
    path = identification.save(tmp_path / "a.npz")

    def huge(name, data):
        if name != "array_0.npy":
            return data
        header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (137438953472, 1), }"
        return b"\x93NUMPY\x01\x00" + (len(header) + 1).to_bytes(2, "little") + header + b"\n" + b"\0" * 64

    with pytest.raises(UnreadableFileError, match="is not what its header says"):
        storage.load(rewritten(path, huge, tmp_path / "b.npz"))
    with zipfile.ZipFile(tmp_path / "c.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("result.json", " " * 10_000_000)
    with pytest.raises(UnreadableFileError, match="compressed or too large"):
        storage.load(tmp_path / "c.npz")


def test_what_is_no_result_cannot_be_saved(identification, tmp_path):
    for change in ({"warnings": {"a": 1}}, {"fit": np.array(["text"])}):
        with pytest.raises(InvalidDataError, match="cannot be saved"):
            storage.save(replace(identification, **change), tmp_path / "a.npz")
    assert not list(tmp_path.iterdir())
    assert isinstance(identification, Identification)
