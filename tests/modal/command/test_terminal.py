import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from modal.command.terminal import MOST_NOISE, say_beforehand, show_comparison, show_files, show_result
from modal.examples.demo import ModeComparison
from modal.report.writing import ReportFiles
from modal.wording.text import hertz


def printed(show, *arguments, **options):
    file = io.StringIO()
    show(Console(file=file, width=100, force_terminal=False, color_system=None), *arguments, **options)
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


def test_noise_poles_are_one_line(make_result, identification):
    noise = identification.modes.modes[4]
    modes = type(identification.modes)(
        modes=(*identification.modes.modes[:3], *[noise] * (MOST_NOISE + 2)), dt=0.01, indicator_caution=0.05
    )
    text = printed(show_result, make_result(modes=modes))
    named = ", ".join([f"{hertz(noise.frequency)} Hz"] * MOST_NOISE)
    assert f"Taken for noise: {MOST_NOISE + 2} poles ({named}, 2 more); the report says why." in " ".join(text.split())


def test_what_is_a_warning_is_not_printed_again(make_result, identification):
    sentence = "input 'ground' moves in 20 % of the band."
    result = make_result(warnings=(sentence,))
    text = printed(show_result, replace(result, excitation=replace(result.excitation, messages=(sentence,))))
    assert text.count("moves in 20 %") == 1


def test_one_pole_is_one_pole(make_result, identification):
    noise = identification.modes.modes[4]
    text = printed(show_result, make_result(modes=replace(identification.modes, modes=(noise,))))
    assert f"Taken for noise: one pole ({hertz(noise.frequency)} Hz); the report says why." in text
    assert "damping" not in text  # no head of a table without rows


@pytest.mark.parametrize("warnings", [(), ("Mind the gap.",)])
def test_warnings_are_printed_when_there_are_any(make_result, warnings):
    text = printed(show_result, make_result(warnings=warnings))
    assert ("Mind the gap." in text) == ("Warnings" in text) == bool(warnings)


def test_remarks_of_the_reader_are_printed(identification):
    assert "tip: g -> m/s^2" in printed(show_result, identification, remarks=("tip: g -> m/s^2",))


def test_names_are_not_obeyed_by_the_terminal(make_result):
    name = "\x1b[2J[bold red]x[/bold red][link=http://a.b]"
    text = printed(show_result, make_result(names=(name, "b", "c"), warnings=(f"{name} is odd.",)))
    assert "\x1b" not in text
    assert "[bold red]x[/bold red][link=http://a.b] is odd." in text


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


def test_paths_stay_on_one_line(tmp_path):
    folder = tmp_path / ("long" * 40)
    text = printed(show_files, ReportFiles.in_folder(folder))
    assert str(folder / "report.html") in text


def test_less_than_a_minute_is_no_minute_at_least(capsys):
    for seconds, time in (((18.0, 350.0), "up to 6"), ((100.0, 350.0), "2 to 6"), ((350.0, 360.0), "6")):
        say_beforehand(9000, 3, seconds, 2.0**30)
        assert f"expect {time} min of one processor" in capsys.readouterr().err
