"""The live view: company that may be missing, may leave, and never keeps the work waiting."""

import contextlib
import importlib.util
import os
import signal
import socket
import subprocess
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rerun as rr

from modal.recording import live as under_test
from modal.recording.live import Relay, live_recording, log_progress, log_records, log_result
from okid.errors import IdentificationWarning, InvalidDataError


def free_port():
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


@contextlib.contextmanager
def server(home):
    """Rerun's own server, without a window."""
    package = importlib.util.find_spec("rerun_cli")
    if package is None:
        pytest.skip("rerun_cli, which brings the viewer's server, is not installed")
    program, port = Path(package.origin).parent / "rerun", free_port()
    process = subprocess.Popen(
        [program, "--serve-grpc", "--bind", "127.0.0.1", "--port", str(port)],
        env=os.environ | {"HOME": str(home), "RUST_LOG": "error"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        end = time.monotonic() + 20
        while time.monotonic() < end:
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=0.2):
                break
            time.sleep(0.05)
        yield program, port, process
    finally:
        process.terminate()
        process.wait(timeout=20)


def received(program, port, path, home):
    """What the server has, as a file."""
    caught = path.with_name("caught.rrd")
    saver = subprocess.Popen(
        [program, f"rerun+http://127.0.0.1:{port}/proxy", "--save", str(caught)],
        env=os.environ | {"HOME": str(home), "RUST_LOG": "error"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    size, end = -1, time.monotonic() + 20
    while time.monotonic() < end and (size <= 0 or caught.stat().st_size != size):
        size = caught.stat().st_size if caught.exists() else -1
        time.sleep(1.0)
    saver.terminate()
    saver.wait(timeout=20)
    # what was saved until then lacks the footer
    subprocess.run([program, "rrd", "merge", str(caught), "-o", str(path)], check=True, capture_output=True)


def test_without_a_viewer_one_sentence_and_the_work_goes_on(identification, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(under_test, "PORT", free_port())
    said = []
    began = time.perf_counter()
    with live_recording(tell=said.append) as live:
        log_records(identification.records, live)
        log_progress(live, "choosing the order", 0.3)
        log_result(identification, live)
    assert live is None
    assert time.perf_counter() - began < 2
    assert len(said) == 1
    assert said[0].endswith("the recording in the folder will show the same.")
    assert "no display" in said[0]


def test_an_address_where_nobody_listens_is_named_and_no_viewer_is_opened(monkeypatch):
    monkeypatch.setattr(under_test.subprocess, "Popen", lambda *_: pytest.fail("a viewer was opened"))
    port = free_port()
    with (
        pytest.warns(IdentificationWarning, match=f"No Rerun viewer listens at localhost:{port}"),
        live_recording(address=f"localhost:{port}") as live,
    ):
        assert live is None


def test_a_viewer_that_does_not_come_up_is_not_waited_for(monkeypatch):
    monkeypatch.setenv("DISPLAY", ":99")
    monkeypatch.setattr(under_test, "PORT", free_port())
    monkeypatch.setattr(under_test.Wait, "OPENING", 0.2)
    monkeypatch.setattr(under_test.subprocess, "Popen", lambda *_, **__: None)
    said = []
    with live_recording(tell=said.append) as live:
        assert live is None
    assert len(said) == 1
    assert "did not answer" in said[0]


def test_something_else_on_the_port_is_not_taken_for_a_viewer():
    said = []
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        threading.Thread(target=_silent, args=(other,), daemon=True).start()
        began = time.perf_counter()
        with live_recording(address=f"127.0.0.1:{other.getsockname()[1]}", tell=said.append) as live:
            assert live is None
        assert time.perf_counter() - began < 4
    assert len(said) == 1
    assert "does not answer as a Rerun viewer would" in said[0]


def _silent(listening):
    """Takes connections and never says a word."""
    kept = []
    with contextlib.suppress(OSError):
        while True:
            kept.append(listening.accept())


@pytest.mark.parametrize("address", ["", "://", "http://127.0.0.1:9876", "127.0.0.1:port"])
def test_a_wrong_address_is_one_sentence(address):
    with pytest.raises(InvalidDataError, match="host:port"), live_recording(address=address):
        pass


def test_pages_and_progress_reach_the_viewer(identification, tmp_path, read):
    said = []
    with server(tmp_path) as (program, port, _):
        with live_recording(address=f"127.0.0.1:{port}", tell=said.append) as live:
            log_progress(live, "reading", 0.0)
            log_records(identification.records, live)
            for share in (0.1, 0.2, 0.9):
                log_progress(live, "choosing the order" if share < 0.5 else "<b>refining</b>", share)
            log_result(identification, live)
        received(program, port, tmp_path / "got.rrd", tmp_path)
    assert said == []
    stored = read(tmp_path / "got.rrd")
    record = identification.records[0]
    np.testing.assert_array_equal(stored.series("/read/output/floor_1")[1], record.outputs[:, 0])
    np.testing.assert_array_equal(stored.series("/data/output/floor_1")[1], record.outputs[:, 0])
    assert stored.every("/progress/log", "TextLog:text") == ["reading", "choosing the order", "<b>refining</b>"]
    document = stored.static("/progress/text", "TextDocument:text")[0]
    assert "90 %" in document
    assert "<b>" not in document


def test_a_viewer_that_is_closed_on_the_way_stops_nothing(identification, tmp_path):
    said = []
    with server(tmp_path) as (_, port, process):
        began = None
        with live_recording(address=f"127.0.0.1:{port}", tell=said.append) as live:
            process.terminate()
            process.wait(timeout=20)
            log_records(identification.records, live)
            log_progress(live, "refining", 0.9)
            began = time.perf_counter()
        assert time.perf_counter() - began < 4
    assert len(said) == 1
    assert "went away" in said[0]


def test_a_viewer_that_stops_answering_is_left(identification, tmp_path):
    said = []
    with server(tmp_path) as (_, port, process):
        try:
            with live_recording(address=f"127.0.0.1:{port}", tell=said.append) as live:
                process.send_signal(signal.SIGSTOP)
                for k in range(12):  # more than the system keeps for a connection
                    columns = rr.Scalars.columns(scalars=np.random.default_rng(k).standard_normal(200_000))
                    time_column = rr.TimeColumn("time", duration=np.arange(200_000.0))
                    live.stream.send_columns(f"x/{k}", [time_column], columns)
                began = time.perf_counter()
            assert time.perf_counter() - began < 6
            live.stream.disconnect()  # what the end of the program does: no waiting there either
            assert time.perf_counter() - began < 7
        finally:
            process.send_signal(signal.SIGCONT)
    assert len(said) == 1
    assert "went away or fell behind" in said[0]


def test_the_wire_passes_bytes_both_ways_until_it_is_cut():
    with socket.create_server(("127.0.0.1", 0)) as other:
        wire = Relay(*other.getsockname())
        with socket.create_connection(("127.0.0.1", wire.port), timeout=5) as near:
            far, _ = other.accept()
            near.sendall(b"there")
            assert far.recv(5) == b"there"
            far.sendall(b"back")
            assert near.recv(4) == b"back"
            wire.cut()
            assert near.recv(1) == b""
            far.close()


def test_a_page_that_cannot_be_drawn_is_said_once_and_stops_nothing(identification, tmp_path):
    said = []
    with server(tmp_path) as (_, port, _), live_recording(address=f"127.0.0.1:{port}", tell=said.append) as live:
        broken = replace(identification, simulated=())
        log_result(broken, live)
        log_result(broken, live)
        log_progress(live, "on we go", 1.0)
    assert len(said) == 1
    assert said[0].startswith("The live view stopped (")


def test_a_connection_that_comes_while_the_relay_is_cut_is_closed():
    """It was left open, and warned of itself in whatever ran when it was collected."""
    with socket.create_server(("127.0.0.1", 0)) as other:
        wire = Relay(*other.getsockname())
        wire.cut()
        late = socket.socket()
        with pytest.raises(OSError, match=r"^$"):
            wire._kept(late)
        assert late.fileno() == -1
