"""A file that another thread is still writing: every row once, gaps and jumps said, the end said."""

import threading
import time

import numpy as np
import pytest
import scipy

import modal
from modal.command.main import status
from modal.tracking.live import growing_blocks
from okid.errors import InvalidDataError, UnreadableFileError

DT, N = 0.01, 1500
STAMPS = DT * np.arange(N)


def motion(frequency=5.0, damping=0.02, n=N):
    rng = np.random.default_rng(4)
    force = rng.standard_normal(n)
    pole = np.exp((-damping + 1j * np.sqrt(1 - damping**2)) * 2 * np.pi * frequency * DT)
    tip = scipy.signal.lfilter([0, 1.0], [1, -2 * pole.real, abs(pole) ** 2], force)
    return force, tip + 0.01 * tip.std() * rng.standard_normal(n)


def lines_of(stamps, force, tip):
    return [f"{t:.4f},{1e-3 * f:.9g},{y:.9g}\n" for t, f, y in zip(stamps, force, tip, strict=True)]


@pytest.fixture
def writer():
    """Append pieces in a thread of its own, cut anywhere."""
    threads = []

    def write(path, pieces, pause=0.005):
        def run():
            for piece in pieces:
                with path.open("ab") as file:
                    file.write(piece)
                time.sleep(pause)

        threads.append(threading.Thread(target=run))
        threads[-1].start()

    yield write
    for thread in threads:
        thread.join()


def cut(text, size=3001):
    data = text.encode()
    return [data[k : k + size] for k in range(0, len(data), size)]


def test_every_row_of_a_growing_table_comes_once_in_si(tmp_path, writer):
    force, tip = motion()
    path = tmp_path / "run.csv"
    path.write_text("Time (s),force [kN],tip [m]\n")
    writer(path, cut("".join(lines_of(STAMPS, force, tip))))
    said = []
    blocks = list(growing_blocks(path, inputs="force", block=1.0, patience=0.5, tell=said.append))
    np.testing.assert_allclose(np.vstack([one.inputs for one in blocks])[:, 0], force, rtol=1e-8)
    np.testing.assert_allclose(np.vstack([one.outputs for one in blocks])[:, 0], tip, rtol=1e-8)
    assert {one.n_samples for one in blocks} == {100}
    np.testing.assert_allclose([one.start_time for one in blocks], np.arange(15.0), atol=1e-9)
    assert blocks[0].input_units == ("N",)
    assert len(said) == 1
    assert "has not grown for 0.5 s" in said[0]


def test_gaps_and_jumps_of_the_clock_are_said_and_followed(tmp_path):
    force, tip = motion()
    stamps = STAMPS + np.where(np.arange(N) >= 430, 0.7, 0.0) - np.where(np.arange(N) >= 1000, 50.0, 0.0)
    path = tmp_path / "run.csv"
    path.write_text("time,force,tip\n" + "".join(lines_of(stamps, force, tip)))
    said = []
    blocks = list(growing_blocks(path, inputs="force", block=1.0, patience=0.0, tell=said.append))
    assert sum(one.n_samples for one in blocks) == N
    assert "0.7 s are missing before 5 s" in said[0]
    assert "the clock jumped back by 50 s" in said[1]
    for estimate in modal.follow(blocks, dt=DT, window=3.0, observer_order=4, order=2):
        assert estimate.modes.modes[0].frequency == pytest.approx(5.0, rel=0.01)


def test_rows_behind_an_array_header_are_followed(tmp_path, writer):
    values = np.column_stack(motion())
    path = tmp_path / "run.npy"
    np.save(path, values[:30])
    writer(path, [values[30:777].tobytes()[:-5], values[30:777].tobytes()[-5:], values[777:].tobytes()])
    blocks = list(growing_blocks(path, inputs="column_0", dt=DT, block=2.0, patience=0.5))
    np.testing.assert_array_equal(np.vstack([np.hstack([one.inputs, one.outputs]) for one in blocks]), values)
    with pytest.raises(InvalidDataError, match="--dt"):
        next(growing_blocks(path, inputs="column_0", block=2.0, patience=0.1))


@pytest.mark.parametrize(("name", "match"), [("run.mat", "cannot be followed"), ("none.csv", "does not exist")])
def test_what_cannot_be_followed_is_one_sentence(tmp_path, name, match):
    (tmp_path / "run.mat").write_bytes(b"MATLAB 5.0 MAT-file")
    with pytest.raises(UnreadableFileError, match=match):
        next(growing_blocks(tmp_path / name, inputs="force", block=1.0, patience=0.1))


def test_the_command_writes_modes_against_time_into_a_recording(tmp_path, writer, capsys):
    force, tip = motion()
    path = tmp_path / "run.csv"
    path.write_text("time,force,tip\n")
    writer(path, cut("".join(lines_of(STAMPS, 1e3 * force, tip))))
    options = ["--inputs", "force", "--window", "5", "--patience", "0.5", "--observer-order", "4", "--order", "2"]
    assert status(["live", str(path), *options, "--recording", str(tmp_path / "live.rrd")]) == 0
    shown = capsys.readouterr().out
    found = [float(line.split()[2]) for line in shown.splitlines() if " Hz " in line]
    assert len(found) >= 10
    np.testing.assert_allclose(found, 5.0, rtol=0.01)
    assert "has not grown" in shown
    assert (tmp_path / "live.rrd").stat().st_size > 1000
    assert status(["live", str(path), *options[:2], "--window", "100", "--patience", "0.2", *options[6:]]) == 1
