"""Time left in words, and requests to stop that are put off or answered."""

import signal
import subprocess
import sys

import pytest

from modal.command.stopping import Requests
from modal.command.terminal import progress_bar, time_left_text
from modal.report.folder import uninterrupted


@pytest.mark.parametrize(
    ("share", "elapsed", "text"),
    [
        (0.0, 100.0, ""),
        (0.04, 100.0, ""),
        (0.5, 1.0, ""),
        (1.0, 50.0, ""),
        (0.5, 4.0, "about 4 s left"),
        (0.9, 2.0, "about 1 s left"),
        (0.5, 41.0, "about 45 s left"),
        (0.1, 20.0, "about 3 min left"),
        (0.5, 5400.0, "about 1.5 h left"),
    ],
)
def test_time_left(share, elapsed, text):
    assert time_left_text(share, elapsed) == text


def test_no_bar_where_nobody_looks(capsys):
    with progress_bar() as tell:
        tell("reading", 0.5)
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == ("", "")


@pytest.fixture
def handlers():
    numbers = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]
    before = {number: signal.getsignal(number) for number in numbers}
    for number in numbers:  # a shell ignores the first for what runs in its background, nohup the last
        signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
    yield numbers
    for number, handler in before.items():
        signal.signal(number, handler)


def test_a_request_to_stop_waits_for_the_end_of_the_block(handlers):
    done = []

    def both_steps():
        with uninterrupted():
            signal.raise_signal(signal.SIGINT)
            done.append("both")

    with pytest.raises(KeyboardInterrupt):
        both_steps()
    assert done == ["both"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_block_without_a_request_changes_nothing(handlers):
    before = [signal.getsignal(number) for number in handlers]
    with uninterrupted():
        assert signal.getsignal(signal.SIGINT) is not before[0]
    assert [signal.getsignal(number) for number in handlers] == before


@pytest.mark.parametrize("terminal", [True, False])
def test_a_request_is_a_flag_that_the_next_step_answers(handlers, capfd, monkeypatch, terminal):
    monkeypatch.setattr("os.isatty", lambda _stream: terminal)
    for number in handlers:
        Requests.listen()
        signal.raise_signal(number)  # nothing is raised here
        with progress_bar() as tell, pytest.raises(KeyboardInterrupt):
            tell("the next step", 0.5)
        said = "stopping after this step; once more stops at once" in capfd.readouterr().err
        assert said == terminal
    Requests.asked = 0


def test_what_nohup_ignores_stays_ignored(handlers):
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    Requests.listen()
    assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN


@pytest.mark.parametrize("twice", [False, True])
def test_from_the_first_line_of_the_entry_point_on(tmp_path, twice):
    """The handler is there before anything is imported; the signals come while the imports go on."""
    again = "signal.raise_signal(signal.SIGTERM)" if twice else ""
    script = (
        "import importlib.abc, signal, sys\n"
        "class Asks(importlib.abc.MetaPathFinder):\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'modal.command.main':\n"
        f"            signal.raise_signal(signal.SIGINT); {again or 'pass'}\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # a shell ignores it for what it runs behind
        "from modal.command.entry import main\n"
        "sys.meta_path.insert(0, Asks())\n"
        f"sys.argv = ['modal-report', 'demo', '-o', {str(tmp_path / 'out')!r}]\n"
        "main()\n"
    )
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert run.returncode == 130
    assert "Traceback" not in run.stderr
    assert run.stderr.strip().endswith("stopped; nothing was left half-written.")
    assert not list(tmp_path.iterdir())
