import io
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from modal.command.gap import show_diagnosis, show_diagnosis_files
from modal.command.stopping import Requests
from modal.command.terminal import (
    Shown,
    progress_bar,
    say_beforehand,
    show_comparison,
    show_files,
    show_result,
    time_left_text,
)
from modal.examples.demo import ModeComparison
from modal.report.folder import uninterrupted
from modal.report.writing import DiagnosisFiles, ReportFiles
from modal.wording.text import hertz


def printed(show, *arguments, **options):
    file = io.StringIO()
    show(Console(file=file, width=110, force_terminal=False, color_system=None), *arguments, **options)
    return file.getvalue()


def test_table_gives_verdict_and_reason_of_every_mode_that_may_be_one(identification):
    text = printed(show_result, identification)
    for words in ("Three modes of the system", "3.67", "1.20 %", "system", "doubtful", "noise", "disagree"):
        assert words in text
    assert text.index("the two halves of the data disagree") < text.index("Taken for noise")


def test_six_modes_with_their_files_take_at_most_25_lines_of_80_letters(identification):
    reason, shares = "found again: halves of the data 0.96", (("halves of the data", 0.96),)
    first = replace(identification.modes.modes[0], frequency_std=3e-5, damping_ratio_std=1e-5)
    first = replace(first, reappears=shares, reason=reason)
    modes = tuple(replace(first, frequency=first.frequency + i) for i in range(6))
    result = replace(identification, modes=replace(identification.modes, modes=modes))
    file = io.StringIO()
    console = Console(file=file, width=80, force_terminal=False, color_system=None)
    show_result(console, result)
    show_files(console, ReportFiles.in_folder(Path("result")))
    lines = file.getvalue().splitlines()
    assert len(lines) <= 25
    assert max(map(len, lines)) <= 80
    assert sum(line.split()[-1:] == ["system"] for line in lines) == 6


WARNINGS = (
    "No input was given: damping and shapes hold if what drives the system is broad-band, and the fit is one-step's.",
    "The model does not reproduce these outputs (fit to data kept aside): tip (0.32), root (0.41), flange 17 (0.21).",
    "Parts of the data fit very differently (0.31 to 0.92 over the folds): something not measured drives the system.",
)


@pytest.mark.parametrize("n_remarks", [0, 1, 40])
@pytest.mark.parametrize("n_warnings", [0, 1, 3])
def test_warnings_doubts_and_remarks_leave_six_modes_in_25_lines(identification, n_warnings, n_remarks):
    """An ambient record of a plate took 40 lines, a shaker whose six modes share one doubt 59."""
    doubt = "the inputs follow the outputs as in a loop, which may move it by several of its deviations"
    first = replace(identification.modes.modes[0], frequency_std=3e-5, verdict="doubtful", reason=f"{doubt}; and more")
    own = replace(first, verdict="system", reason="")
    modes = tuple(replace(one, frequency=one.frequency + i) for i, one in enumerate([own, *[first] * 4, own]))
    result = replace(identification, modes=replace(identification.modes, modes=modes), warnings=WARNINGS[:n_warnings])
    remarks = [
        f"channel {i}: its unit is not read, so that its numbers are taken as they stand" for i in range(n_remarks)
    ]
    file = io.StringIO()
    console = Console(file=file, width=80, force_terminal=False, color_system=None)
    show_result(console, result, remarks=remarks)
    show_files(console, ReportFiles.in_folder(Path("result")))
    lines = file.getvalue().splitlines()
    assert len(lines) <= 25
    assert max(map(len, lines)) <= 80
    text = " ".join(" ".join(lines).split())
    assert text.count(doubt) == 1
    assert f"3–6: {doubt}." in text
    assert all(warning[:60] in text for warning in WARNINGS[:n_warnings])
    assert ("whole in the report" in text) == ("…" in text or "remarks" in text)
    assert n_remarks == 0 or "channel 0" in text or f"{n_remarks} remarks" in text


def test_noise_poles_are_one_line(make_result, identification):
    noise = identification.modes.modes[4]
    modes = type(identification.modes)(
        modes=(*identification.modes.modes[:3], *[noise] * (Shown.MOST_NOISE + 2)), dt=0.01, indicator_caution=0.05
    )
    text = printed(show_result, make_result(modes=modes))
    named = ", ".join([hertz(noise.frequency)] * Shown.MOST_NOISE)
    assert f"Taken for noise: {Shown.MOST_NOISE + 2} poles ({named} Hz, 2 more); see the report." in text


def test_what_is_a_warning_is_not_printed_again(make_result, identification):
    sentence = "input 'ground' moves in 20 % of the band."
    result = make_result(warnings=(sentence,))
    text = printed(show_result, replace(result, excitation=replace(result.excitation, messages=(sentence,))))
    assert text.count("moves in 20 %") == 1


def test_one_pole_is_one_pole(make_result, identification):
    noise = identification.modes.modes[4]
    text = printed(show_result, make_result(modes=replace(identification.modes, modes=(noise,))))
    assert f"Taken for noise: one pole ({hertz(noise.frequency)} Hz); see the report." in text
    assert "damping" not in text  # no head of a table without rows


@pytest.mark.parametrize("warnings", [(), ("Mind the gap.",)])
@pytest.mark.parametrize("kind", ["identification", "diagnosis"])
def test_warnings_and_remarks_are_printed_when_there_are_any(request, kind, warnings):
    show = show_result if kind == "identification" else show_diagnosis
    text = printed(show, replace(request.getfixturevalue(kind), warnings=warnings), remarks=("tip: g -> m/s^2",))
    assert ("Mind the gap." in text) == ("Warnings" in text) == bool(warnings)
    assert "tip: g -> m/s^2" in text


def test_names_are_not_obeyed_by_the_terminal(make_result, make_gap):
    name = "\x1b[2J[bold red]x[/bold red][link=http://a.b]"
    result = make_result(names=(name, "b", "c"), warnings=(f"{name} is odd.",))
    for text, end in (
        (printed(show_result, result), " is odd."),
        (printed(show_diagnosis, make_gap(names=(name, "b"), where=name, n_effects=1)), ""),
    ):
        assert "\x1b" not in text
        assert "[bold red]x[/bold red][link=http://a.b]" + end in text.replace("\n", "")


def test_comparison_shows_true_beside_found_and_what_is_missing():
    found = ModeComparison(
        frequency=2.0,
        damping_ratio=0.01,
        found_frequency=2.01,
        found_damping_ratio=0.0103,
        assurance=0.999,
        verdict="system",
    )
    missed = ModeComparison(
        frequency=5.0,
        damping_ratio=0.02,
        found_frequency=np.nan,
        found_damping_ratio=np.nan,
        assurance=np.nan,
        verdict=None,
    )
    text = printed(show_comparison, (found, missed))
    for words in ("+0.500 %", "1.03 %", "0.999", "not found"):
        assert words in text


def test_less_than_a_minute_is_no_minute_at_least(capsys):
    for seconds, time in (((18.0, 350.0), "up to 6"), ((100.0, 350.0), "2 to 6"), ((350.0, 360.0), "6")):
        say_beforehand(9000, 3, seconds, 2.0**30)
        assert f"expect {time} min of one processor" in capsys.readouterr().err


def test_the_verdict_comes_first_then_values_with_their_deviations(diagnosis):
    text = printed(show_diagnosis, diagnosis)
    assert text.split("\n")[1] == "The simulation lacks cubic stiffness and Coulomb friction at the link lower-upper."
    assert "\ncubic stiffness at the link lower-upper\nk3  (2.013 ± 0.019)e5  N/m^3  95 %: (1.976 to 2.050)e5" in text
    assert "0.05960 ± 0.00060" in text
    assert "Runner-up: gap spring" in text
    assert "Add a record at twice the level" in text


def test_the_gap_stands_before_and_after(diagnosis):
    lines = printed(show_diagnosis, diagnosis).splitlines()
    (heading,) = (line for line in lines if "as given" in line and "calibrated" in line and "by" in line)
    assert heading.rstrip().endswith("with the effects")
    (row,) = (line for line in lines if line.startswith("output  upper"))
    first, _, last = (float(word) for word in row.split()[2:])
    assert first > 20.0
    assert last < 1.1


@pytest.mark.parametrize(
    ("status", "n_effects", "there", "missing"),
    [
        ("none", 0, ("Nothing missing.", "What the data could still hide", "k3 = 3100 N/m^3"), ("Why", "value ± std")),
        ("unresolved", 1, ("Not proved.", "Do not build on"), ("could still hide", "Simulate with")),
        ("unresolved", 0, ("no effect that was tried explains",), ("Why",)),
    ],
)
def test_each_status_prints_its_parts(diagnosis_of, status, n_effects, there, missing):
    text = printed(show_diagnosis, diagnosis_of(status, n_effects))
    assert all(words in text for words in there)
    assert not any(words in text for words in missing)


def test_paths_stay_on_one_line_and_a_missing_model_is_not_named(tmp_path):
    folder = tmp_path / ("long" * 40)
    text = printed(show_diagnosis_files, DiagnosisFiles.in_folder(folder))
    for one in (text, printed(show_files, ReportFiles.in_folder(folder))):
        assert str(folder / "report.html") in one
    assert "model.json" in text
    assert "model" not in printed(show_diagnosis_files, DiagnosisFiles.in_folder(tmp_path / "x", model=None)).replace(
        str(tmp_path), ""
    )


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
