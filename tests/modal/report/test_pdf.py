import shutil
import stat

import pytest

from modal.report import folder
from modal.report.folder import NoBrowserError, find_browser, write_pdf
from okid.errors import InvalidDataError

PAGE = "<!DOCTYPE html><title>x</title><style>@page{size:A4} p{break-after:page}</style><p>one</p><p>two</p>"


@pytest.fixture
def page(tmp_path):
    path = tmp_path / "report.html"
    path.write_text(PAGE, encoding="utf-8")
    return path


@pytest.fixture
def browser(tmp_path, monkeypatch):
    """A function of a shell script -> the browser that runs it."""

    def make(script):
        path = tmp_path / "browser"
        path.write_text(f"#!/bin/sh\n{script}\n")
        path.chmod(path.stat().st_mode | stat.S_IXUSR)
        monkeypatch.setenv("MODAL_REPORT_BROWSER", str(path))

    return make


def test_without_a_browser_one_sentence_says_what_to_do(page, monkeypatch):
    monkeypatch.delenv("MODAL_REPORT_BROWSER", raising=False)
    monkeypatch.setattr(shutil, "which", lambda _name: None)
    with pytest.raises(NoBrowserError, match="none is installed") as caught:
        write_pdf(page, page.with_suffix(".pdf"))
    assert "print it to a file instead" in str(caught.value)
    assert [path.name for path in page.parent.iterdir()] == ["report.html"]


def test_browsers_are_looked_for_in_their_order(monkeypatch):
    monkeypatch.delenv("MODAL_REPORT_BROWSER", raising=False)
    monkeypatch.setattr(shutil, "which", lambda name: f"/bin/{name}" if name in ("chrome", "google-chrome") else None)
    assert find_browser() == "/bin/google-chrome"
    monkeypatch.setenv("MODAL_REPORT_BROWSER", "missing")
    assert find_browser() is None


def test_a_missing_page_is_said(tmp_path):
    with pytest.raises(InvalidDataError, match="write the report first"):
        write_pdf(tmp_path / "report.html", tmp_path / "report.pdf")


@pytest.mark.parametrize(("script", "words"), [("exit 3", "exit status 3"), ("exit 0", "exit status 0")])
def test_a_browser_that_fails_leaves_nothing(page, browser, script, words):
    browser(script)
    before = sorted(page.parent.iterdir())
    with pytest.raises(NoBrowserError, match=words):
        write_pdf(page, page.with_suffix(".pdf"))
    assert sorted(page.parent.iterdir()) == before


def test_a_browser_that_hangs_is_stopped(page, browser, monkeypatch):
    browser("exec sleep 30")
    monkeypatch.setattr(folder, "LONGEST_WAIT", 0.2)
    with pytest.raises(NoBrowserError, match="within 0 s"):
        write_pdf(page, page.with_suffix(".pdf"))


def test_dates_are_exchanged_without_moving_a_byte(page, browser):
    text = "%PDF /CreationDate (D:20260504120000+00'00') /ModDate (D:20260504120001+00'00')"
    browser(
        f'for a in "$@"; do case "$a" in --print-to-pdf=*) printf "%s" "{text}" > "${{a#*=}}";; esac; done'.replace(
            "%PDF", "PDF"
        )
    )
    written = write_pdf(page, page.with_suffix(".pdf")).read_bytes()
    assert written.count(b"D:20000101000000") == 2
    assert len(written) == len(text) - 1


@pytest.mark.skipif(find_browser() is None, reason="no browser that can print is installed")
def test_the_same_page_gives_the_same_bytes(page):
    first = write_pdf(page, page.with_suffix(".pdf")).read_bytes()
    assert first.startswith(b"%PDF")
    assert b"/Count 2" in first
    assert write_pdf(page, page.with_suffix(".pdf")).read_bytes() == first
