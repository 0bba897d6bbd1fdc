"""The command `modal-report diff`: what it prints and writes, exit status, nothing left behind; its pages."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from page_reader import Skeleton

from modal.command.main import status as _status
from modal.comparison.changes import compare_results
from modal.comparison.shifts import summary_of
from modal.report.comparison import comparison_html, comparison_json, comparison_markdown, write_comparison
from okid.errors import InvalidDataError


def scaled(mode, factor):
    return replace(mode, frequency=factor * mode.frequency, pole=factor * mode.pole)


@pytest.fixture
def results(make_result):
    """Before and after: one frequency shifted, one mode lost, another channel name of a stranger."""
    names = ("<script>alert(1)</script>", "b\u202e", "c" * 300)
    before = make_result(names=names)
    modes = tuple(
        replace(mode, frequency_std=1e-3 * mode.frequency, shape_std=np.full(3, 0.01)) for mode in before.modes
    )
    before = replace(before, modes=replace(before.modes, modes=modes))
    changed = (scaled(modes[0], 0.97), modes[1], *modes[3:])
    other = replace(before.choices[-1], value="8 <b>| x")
    after = replace(before, modes=replace(before.modes, modes=changed), choices=(*before.choices[:-1], other))
    return before, after


@pytest.fixture
def data(tmp_path, results, monkeypatch):
    folder = tmp_path / "data"
    folder.mkdir()
    results[0].save(folder / "a.npz")
    results[1].save(folder / "b.npz")
    none = replace(results[0], modes=replace(results[0].modes, modes=()))
    none.save(folder / "none.npz")
    (folder / "empty").mkdir()
    monkeypatch.chdir(folder)
    return folder


def diff(capsys, *arguments):
    status = _status(["diff", *arguments])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def test_what_changed_is_printed(data, capsys):
    status, out, err = diff(capsys, "a.npz", "b.npz")
    assert (status, err) == (0, "")
    assert "1 of 3 matched modes changed beyond chance; of 1 it cannot be told; 1 lost." in out
    assert "-3.00 ± 0.28 % *" in out
    assert "* beyond chance" in out
    assert max(map(len, out.splitlines())) <= 80
    assert "16.6 Hz, a mode of the system in a.npz, has no partner in b.npz" in " ".join(out.split())
    assert "model order: 6 → 8 <b>| x" in out
    assert "same measured data" in out
    assert sorted(path.name for path in data.iterdir()) == ["a.npz", "b.npz", "empty", "none.npz"]


def test_the_pages_are_written_when_they_are_asked_for(data, capsys):
    status, out, _ = diff(capsys, "a.npz", "b.npz", "-o", "change")
    assert status == 0
    assert sorted(path.name for path in (data / "change").iterdir()) == [
        "comparison.html",
        "comparison.json",
        "comparison.md",
    ]
    assert "change/comparison.html" in out
    assert diff(capsys, "a.npz", "b.npz", "-o", "change")[0] == 2
    assert diff(capsys, "a.npz", "b.npz", "-o", "change", "--overwrite")[0] == 0


def test_a_result_without_modes_is_status_1(data, capsys):
    assert diff(capsys, "a.npz", "none.npz")[0] == 1


@pytest.mark.parametrize(
    "arguments",
    [
        ("a.npz",),
        ("a.npz", "no.npz"),
        ("empty", "a.npz"),
        ("a.npz", "b.npz", "--out"),
        ("a.npz", "b.npz", "-o", "a.npz"),
    ],
    ids=" ".join,
)
def test_wrong_use_is_one_sentence_and_nothing_is_written(data, capsys, arguments):
    before = sorted(data.iterdir())
    status, out, err = diff(capsys, *arguments)
    assert (status, out) == (2, "")
    assert len(err.strip().splitlines()) == 1
    assert err.startswith("modal-report: ")
    assert sorted(data.iterdir()) == before


# --- pages -----------------------------------------------------------------------------------------------------------


@pytest.fixture
def comparison(results):
    before = summary_of(results[0], name='<img src=x onerror="1">')
    return compare_results(before, summary_of(results[1], name="b\u202ename"))


def test_the_page_is_whole_and_harmless(comparison):
    text = comparison_html(comparison)
    page = Skeleton(text)
    assert page.open == []
    assert not {"script", "img", "link"} & {tag for tag, _ in page.tags}
    assert not {"src", "href"} & {name for _, name, _ in page.attributes}
    assert "<b>| x" not in text
    assert "\u202e" not in text
    assert "-3.00 ± 0.28 %" in text.replace("\N{NO-BREAK SPACE}", " ")


def test_a_bar_lies_where_the_interval_is(comparison):
    """The first shift is -3 % +- 0.28 %, and the longest of its column: its end lies at 100 - 92."""
    text = comparison_html(comparison)
    low, width, at = 8.0, 2 * 92 * 0.2772 / 3.2772, 100 - 92 * 3 / 3.2772
    found = text[text.index("<rect") :]
    assert f'x="{low}"' in found[: found.index("/>")]
    assert float(found.split('width="')[1].split('"')[0]) == pytest.approx(width, rel=1e-2)
    assert float(found.split('cx="')[1].split('"')[0]) == pytest.approx(at, rel=1e-2)


def test_markdown_has_a_row_a_mode_and_no_foreign_cell(comparison):
    text = comparison_markdown(comparison)
    rows = [line for line in text.splitlines() if line.startswith(("| 1", "| 2", "| 4 → 3"))]
    assert len(rows) == 3
    assert all(row.count("|") - row.count("\\|") == 8 for row in rows)
    (setting,) = [line for line in text.splitlines() if "model order" in line]
    assert setting.count("|") - setting.count("\\|") == 5
    assert "<b>" not in text


def test_json_has_every_number(comparison):
    document = json.loads(comparison_json(comparison))
    first, shift = document["pairs"][0], comparison.pairs[0].frequency
    assert first["frequency"]["change"] == shift.change
    assert first["frequency"]["verdict"] == "beyond chance"
    assert first["damping"]["p_value"] is None
    assert math.isclose(document["lost"][0]["frequency"], 16.6)
    assert document["before"]["name"] == comparison.before.name
    assert (document["same_data"], document["level"], document["changed"]) == (True, 0.05, True)


def test_the_same_comparison_gives_the_same_bytes(comparison, tmp_path):
    for folder in ("one", "two"):
        write_comparison(comparison, tmp_path / folder)
    for path in (tmp_path / "one").iterdir():
        assert path.read_bytes() == (tmp_path / "two" / path.name).read_bytes()
    with pytest.raises(InvalidDataError, match="already holds"):
        write_comparison(comparison, tmp_path / "one")
