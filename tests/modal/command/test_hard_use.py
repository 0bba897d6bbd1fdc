"""What a command does where the terminal, the memory, the file's name or the folder's name is poor."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from remembered import remembered

import modal.command.run
from modal.command.main import status
from modal.command.results import recording_of
from modal.discrepancy.setup import check_records
from modal.identification import pipeline
from modal.report import folder, writing
from okid import rows
from okid.errors import InvalidDataError, UnreadableFileError
from okid.readers import read_records
from okid.record import Record
from okid.rows import refuse_copies

HERE = Path(modal.command.run.__file__).parents[2]


@pytest.fixture
def data(tmp_path, monkeypatch):
    rng = np.random.default_rng(3)
    table = np.column_stack([0.01 * np.arange(400), rng.standard_normal((400, 2))])
    for name in ("a.csv", "b.csv"):
        np.savetxt(
            tmp_path / name, table, delimiter=",", header="time [s],force [N],Größe [µm]", comments="", encoding="utf-8"
        )
    monkeypatch.chdir(tmp_path)
    return tmp_path


def ran(*words, before="", environment=(), **streams):
    """The command in a process of its own, after some lines of Python."""
    return subprocess.run(
        [sys.executable, "-c", f"{before}from modal.command.entry import main; main()", *words],
        env={**os.environ, "PYTHONPATH": str(HERE), **dict(environment)},
        check=False,
        timeout=60,
        **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, **streams},
    )


identified = remembered(pipeline.identify)


@pytest.fixture
def known(monkeypatch):
    """The same records are identified once: what is asked is what the command does around that."""
    monkeypatch.setattr(modal.command.run, "identify", identified)


CHECK = ("check", "a.csv", "--inputs", "force")
CHOICES = ("--observer-order", "8", "--ridge", "0", "--order", "2")


@pytest.mark.parametrize("encoding", ["ascii", pytest.param("cp437", marks=pytest.mark.slow)])
def test_terminals_that_lack_letters_get_plain_ones(data, encoding):
    run = ran(*CHECK, environment={"PYTHONIOENCODING": encoding}, text=False)
    text = run.stdout.decode(encoding)
    assert run.returncode in (0, 1)
    assert run.stderr == b""
    assert ("Grosse" if encoding == "ascii" else "Größe") in text
    assert "?" not in text


@pytest.mark.parametrize(
    "command", [["run", "a.csv"], ["demo"], ["diff", "a", "b"], ["gap", "m.toml", "--fit", "a.csv"]]
)
def test_an_empty_name_is_no_folder(data, command, capsys):
    before = sorted(data.iterdir())
    assert status([*command, "-o", ""]) == 2
    assert "the name of the folder is empty; give one, such as -o result" in capsys.readouterr().err
    assert sorted(data.iterdir()) == before


def test_a_link_to_nowhere_is_no_folder(data, capsys):
    (data / "link").symlink_to(data / "gone")
    assert status(["run", "a.csv", "-o", "link"]) == 2
    assert "'link' is a link to a place that does not exist; make it, or remove it." in capsys.readouterr().err


@pytest.mark.parametrize("text", ["1_0", "ten"])
def test_a_step_is_a_number_as_everybody_writes_it(data, text, capsys):
    assert status(["check", "a.csv", "--dt", text]) == 2
    assert f"Invalid value for '--dt': {text!r} is no number; write seconds such as 0.001" in capsys.readouterr().err


def test_a_reader_that_leaves_changes_no_exit_status(data):
    """The head of a page is enough for many: what was done is done, and its status is that of the result."""
    read, write = os.pipe()
    os.close(read)
    left = ran(*CHECK, stdout=write)
    os.close(write)
    assert (left.returncode, left.stderr) == (0, "")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows removes no folder that somebody stands in")
def test_a_working_folder_that_was_removed_is_a_sentence(data):
    run = ran("check", "a.csv", before="import os; os.mkdir('g'); os.chdir('g'); os.rmdir('../g');")
    assert run.returncode == 2
    assert run.stderr == ("modal-report: the folder that this runs in was removed; change to one that is there (cd).\n")


@pytest.mark.skipif(sys.platform != "linux", reason="ulimit -v is of Linux")
@pytest.mark.parametrize(("command", "leaves", "needs"), [("check", 0.6, 1), ("run", 2.0, 3)])
def test_libraries_that_could_not_be_loaded_are_not_tried(data, command, leaves, needs):
    """They wait for memory for ever, or abort the process."""
    limit = f"import resource; resource.setrlimit(resource.RLIMIT_AS, ({int(leaves * 2**30)},) * 2);"
    run = ran(command, "a.csv", before=limit)
    assert run.returncode == 2
    assert f"ulimit -v allows {leaves:.2g} GiB to be mapped, and the libraries map up to {needs} GiB" in run.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="ulimit is of Unix")
def test_too_few_open_files_are_a_sentence(data):
    """The recording's library ends the process where it gets none."""
    limit = "import resource; resource.setrlimit(resource.RLIMIT_NOFILE, (8, 8));"
    run = ran("run", "a.csv", "--inputs", "force", before=limit)
    assert run.returncode == 2
    assert run.stderr == "modal-report: ulimit -n allows 8 open files, and the libraries need 16; raise it.\n"


def test_an_epoch_that_is_no_number_is_a_sentence(data):
    run = ran(*CHECK, environment={"SOURCE_DATE_EPOCH": "abc"})
    assert (run.returncode, run.stdout) == (2, "")
    assert run.stderr == (
        "modal-report: SOURCE_DATE_EPOCH must be a whole number of seconds, but is 'abc'; correct it, or unset it.\n"
    )
    closed = ran(*CHECK, before="import sys; sys.stderr = None;", environment={"SOURCE_DATE_EPOCH": "abc"})
    assert (closed.returncode, closed.stdout, closed.stderr) == (2, "", "")


def test_a_terminal_of_no_columns_is_one_of_unknown_width(data):
    run = ran(*CHECK, environment={"COLUMNS": "0"})
    assert run.returncode == 0
    assert "1 input, 1 output" in run.stdout


@pytest.mark.skipif(sys.platform != "linux", reason="on_exit is of glibc")
def test_what_libraries_do_at_the_end_changes_no_exit_status(data):
    """Threads of a reader that still ran made its finaliser abort once in 240 runs, after all was said."""
    aborts = "import atexit, ctypes; c = ctypes.CDLL(None); c.on_exit(c.abort, None);"
    told = ran(*CHECK, before=f"{aborts} atexit.register(print, 'last');")
    assert told.returncode == 0
    assert told.stdout.endswith("last\n")
    assert told.stderr == ""


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="/dev/full is of Linux")
@pytest.mark.parametrize(("arguments", "status"), [(["nothing.csv"], 2), (["a.csv", "--inputs", "force"], 0)])
def test_a_log_without_room_changes_no_exit_status(data, arguments, status):
    """What is said beforehand of long work was the end of it, and 1 says that there is a result."""
    before = "import modal.command.terminal as terminal; terminal.Shown.LONG = -1.0;"
    with Path("/dev/full").open("w") as full:
        run = ran("check", *arguments, before=before, stderr=full)
    assert run.returncode == status
    assert ("1 input, 1 output" in run.stdout) == (status == 0)


def test_a_link_to_a_record_is_that_record(data):
    (data / "link.csv").symlink_to("a.csv")
    with pytest.raises(InvalidDataError, match=r"a\.csv, link\.csv is given more than once; a record counts once"):
        read_records(["a.csv", "link.csv"])
    assert len(read_records(["a.csv", "b.csv"])) == 2


def test_a_copy_of_a_record_is_that_record(data, capsys):
    """It halves every variance, and the copy of a row that is held out proves the row."""
    (data / "copy.csv").write_bytes((data / "a.csv").read_bytes())
    words = (data / "b.csv").read_text(encoding="utf-8").splitlines(keepends=True)
    (data / "b.csv").write_text("".join(words[:300]), encoding="utf-8")
    for command in ("run", "check"):
        assert status([command, "a.csv", "b.csv", "copy.csv", "--inputs", "force"]) == 2
        assert "records 'a' and 'copy' hold the same samples; a record counts once" in capsys.readouterr().err
    a, b = (read_records([f"{name}.csv"], inputs="force")[0] for name in "ab")
    check_records([a], [b])
    for fit, held_out in (([a, a], [b]), ([b], [a, a])):
        with pytest.raises(InvalidDataError, match="records 'a' and 'a' hold the same samples"):
            check_records(fit, held_out)


def test_only_copies_are_refused(data):
    a = read_records(["a.csv"], inputs="force")[0]
    outputs = np.array(a.outputs)
    outputs[5:9] = np.nan
    other = outputs.copy()
    other[1] += 1e-9
    gaps, again, near = (Record(-0.0 * a.inputs, values, a.dt) for values in (outputs, outputs, other))
    refuse_copies([a, gaps, near])
    with pytest.raises(InvalidDataError, match="records 1 and 3 hold the same samples"):
        refuse_copies([a, gaps, near, Record(0.0 * again.inputs, again.outputs, a.dt)])


def test_many_records_are_not_compared_each_with_each(data, monkeypatch):
    """A hundred records took seconds."""
    monkeypatch.setattr(rows, "same_samples", lambda *_records: pytest.fail("compared throughout"))
    rng = np.random.default_rng(3)
    refuse_copies([Record([], np.append(np.zeros(80), rng.standard_normal(20)), 0.1) for _ in range(50)])


def test_too_little_memory_is_a_sentence(data, monkeypatch, capsys):
    def greedy(*_arguments, **_options):
        return np.empty(1 << 49)

    monkeypatch.setattr(modal.command.run, "identify", greedy)
    assert status(["run", "a.csv", "--inputs", "force", "-o", "out"]) == 2
    assert "there is not enough memory for this (Unable to allocate" in capsys.readouterr().err
    assert not (data / "out").exists()


@pytest.mark.parametrize("moment", ["identify", "write", "commit"])
def test_a_folder_that_is_removed_during_the_run_is_a_sentence(data, known, moment, monkeypatch, capsys):
    """Whenever it goes: nothing is made anew where it was, and nothing half-written is left."""
    (data / "disk").mkdir()
    where = {"write": writing, "commit": folder}.get(moment, modal.command.run)
    name = {"write": "keep_result", "commit": "_to_disk"}.get(moment, moment)
    real = getattr(where, name)

    def after(*given, **options):
        made = real(*given, **options)
        shutil.rmtree("disk", ignore_errors=True)
        return made

    monkeypatch.setattr(where, name, after)
    assert status(["run", "a.csv", "--inputs", "force", "-o", "disk/a/out", *CHOICES]) == 2
    said = capsys.readouterr().err
    assert "'disk/a/out' cannot be written (" in said
    assert said.count("\n") == 1
    assert not (data / "disk").exists()


def test_what_memory_cannot_hold_is_said_before_the_work(data, monkeypatch, capsys):
    monkeypatch.setattr("modal.identification.pipeline.memory_budget", lambda: (1e5, "the container leaves"))
    assert status(["run", "a.csv", "--inputs", "force", "-o", "out"]) == 2
    said = capsys.readouterr().err
    assert "identifying 400 samples of 2 channels needs about" in said
    assert "that the container leaves; give a stretch of the record" in said
    assert not (data / "out").exists()


@pytest.mark.parametrize(
    "error",
    [
        ImportError("libXau.so.6: failed to map segment from shared object"),
        OSError(12, "Cannot allocate memory"),
        RuntimeError("can't start new thread"),
        RuntimeError("Failed to spawn background thread 'batcher': Resource temporarily unavailable (os error 11)"),
    ],
)
def test_a_library_that_finds_no_room_is_the_same_sentence(data, known, monkeypatch, capsys, error):
    def full(*_arguments, **_options):
        raise error

    monkeypatch.setattr("modal.command.run.write_report", full)
    assert status(["run", "a.csv", "--inputs", "force", "-o", "out", *CHOICES]) == 2
    assert "there is not enough memory for this (" in capsys.readouterr().err


def test_a_file_name_that_is_no_text_is_a_record_like_any_other(data, capfd):
    shutil.copyfile("a.csv", os.fsdecode(b"\xff.csv"))
    assert status(["run", os.fsdecode(b"\xff.csv"), "--inputs", "force", "-o", "out", *CHOICES]) in (0, 1)
    assert (data / "out" / "recording.rrd").is_file()
    assert "WARN" not in capfd.readouterr().err


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_output_that_finds_no_room_is_a_sentence_and_the_result_is_whole(data):
    with Path("/dev/full").open("wb") as full:
        run = ran("run", "a.csv", "--inputs", "force", "-o", "out", *CHOICES, stdout=full)
    assert run.returncode == 2
    assert run.stderr.startswith("modal-report: what is printed or written finds no room (")
    assert run.stderr.count("\n") == 1
    assert (data / "out" / "result.npz").is_file()


def test_long_work_is_said_beforehand_in_one_line_and_short_work_is_not(data, known, monkeypatch, capsys):
    run = ["run", "a.csv", "--inputs", "force", "-o", "out", *CHOICES]
    for arguments, memory in ((run, 0.6), (["check", "a.csv"], 0.3)):
        monkeypatch.setattr("modal.command.terminal.Shown.LONG", 60.0)
        status(arguments)
        assert capsys.readouterr().err == ""
        monkeypatch.setattr("modal.command.terminal.Shown.LONG", 0.0)
        status([*arguments, *["--overwrite"] * (arguments[0] == "run")])
        said = capsys.readouterr().err
        assert said == f"400 samples of 2 channels: expect 1 min of one processor and up to {memory} GiB of memory.\n"


def test_what_is_expected_holds_what_was_measured():
    """CPU seconds and peak of whole runs of other sizes, on this machine."""
    for n_samples, seconds, peak in ((100_000, 13.5, 0.62), (1_000_000, 63.0, 1.28)):
        record = Record(np.zeros((n_samples, 2)), np.zeros((n_samples, 6)), 0.001)
        (least, most), n_bytes = pipeline.expected_work([record])
        assert least < seconds < most
        assert peak <= n_bytes / 2**30 < 2 * peak


def test_the_fit_to_all_rows_tells_of_each_step_and_never_steps_back(data):
    told = []
    rng = np.random.default_rng(8)
    force = rng.standard_normal(2000)
    tip, noise = np.zeros(2000), 0.1 * rng.standard_normal(2000)
    for k in range(2, 2000):
        tip[k] = 1.8 * tip[k - 1] - 0.97 * tip[k - 2] + force[k - 1]
        noise[k] += 0.9 * noise[k - 1]  # white noise needs no model, so no step would be told of
    pipeline.identify(
        Record(force, tip + noise, 0.01),
        observer_order=8,
        ridge=0.0,
        order=2,
        progress=lambda what, share: told.append((what, share)),
    )
    shares = [share for _, share in told]
    assert shares == sorted(shares)
    fitting = [share for what, share in told if what == "fitting all rows"]
    assert any(pipeline.FITTING < share < pipeline.FITTED for share in fitting)


def test_stretches_stand_for_a_record_that_is_too_long(monkeypatch):
    """Ten, spread evenly, without the one in which the sensor was off; what was struck is never cut."""
    rng = np.random.default_rng(8)
    force, tip = rng.standard_normal(30_000), np.zeros(30_000)
    for k in range(2, force.size):
        tip[k] = 1.8 * tip[k - 1] - 0.97 * tip[k - 2] + force[k - 1]
    tip += 0.01 * rng.standard_normal(tip.size)
    tip[9000:11_000] = 0.0
    record = Record(force, tip, 0.01)
    monkeypatch.setattr(pipeline, "MOST_MEMORY", pipeline.COPIES * 16 * 15_000)
    result = pipeline.identify(record, observer_order=8, ridge=0.0, order=2, refinement="none")
    assert [one.n_samples for one in result.records] == [1500] * 9
    assert result.records[0].name == "record, rows 0 to 1499"
    assert result.records[-1].name == "record, rows 28500 to 29999"
    assert any("Of 30000 samples 13500 are used, 9 stretches" in text for text in result.warnings)
    assert result.modes.system[0].frequency == pytest.approx(np.angle(np.roots([1, -1.8, 0.97])[0]) * 50 / np.pi, 1e-3)
    monkeypatch.setattr(pipeline, "memory_budget", lambda: (1e6, "the container leaves"))
    with pytest.raises(InvalidDataError, match=r"identifying 30000 samples of 2 channels needs about 0\.0 GiB"):
        pipeline.identify(record)


def test_a_mapped_file_may_be_larger_than_the_memory(tmp_path, monkeypatch):
    rng = np.random.default_rng(48_500)
    force, tip = rng.standard_normal(30_000), np.zeros(30_000)
    for k in range(2, force.size):
        tip[k] = 1.8 * tip[k - 1] - 0.97 * tip[k - 2] + force[k - 1]
    np.save(tmp_path / "a.npy", np.column_stack([force, tip]))
    table = np.load(tmp_path / "a.npy", mmap_mode="r")
    monkeypatch.setattr(pipeline, "MOST_MEMORY", pipeline.COPIES * 16 * 1500)
    monkeypatch.setattr(pipeline, "memory_budget", lambda: (table.nbytes, "this machine has"))
    in_memory, mapped = (Record(one[:, :1], one[:, 1:], 0.01) for one in (np.array(table), table))
    with pytest.raises(InvalidDataError, match="identifying 30000 samples of 2 channels needs about"):
        pipeline.identify(in_memory)
    result = pipeline.identify(mapped, observer_order=8, ridge=0.0, order=2, refinement="none")
    assert [one.n_samples for one in result.records] == [150] * 10
    assert sum(one.n_samples for one in pipeline.used_rows([mapped], "driven")) == 1500
    assert pipeline.used_rows([mapped], "transient") == (mapped,)


def test_a_recording_that_is_cut_off_is_a_sentence(data):
    head = b"RRF2\x00\x29\x00\x00" + bytes(100)
    (data / "a.rrd").write_bytes(head + b"RRF2FOOT\x01\x00\x00\x00")
    assert recording_of("a.rrd") == Path("a.rrd")
    (data / "a.rrd").write_bytes(head)
    with pytest.raises(UnreadableFileError, match=r"'a\.rrd' is cut off or damaged"):
        recording_of("a.rrd")


@pytest.mark.parametrize("what", ["result.npz", "folder"])
def test_a_damaged_result_is_a_sentence(data, what, capsys):
    (data / "result").mkdir()
    (data / "result" / "result.npz").write_bytes(b"PK\x03\x04 and no more")
    place = "result" if what == "folder" else "result/result.npz"
    assert status(["diff", place, place]) == 2
    assert "is damaged" in capsys.readouterr().err
