"""The report on paper: the page printed by a browser that is installed already.

A browser was weighed against libraries that lay out HTML in Python. The page uses grids, custom properties and inline
SVG with clip paths; a browser of the Chromium family draws all of it exactly as on the screen, is installed on most
desks, and adds nothing to install. Libraries add dozens of megabytes and system libraries (Pango, Cairo), or download a
browser of their own, and draw parts of the page differently. So there is no extra package to install, and where no such
browser is found, one sentence says so; every browser prints the page by hand as well.

The file holds no clock: the browser's two dates are replaced by one fixed day, so the same page and the same browser
give the same bytes.
"""

import os
import re
import shutil
import subprocess
from pathlib import Path

from modal.report.folder import scratch_folder, sweep
from okid.errors import IdentificationError, InvalidDataError

BROWSERS = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "chrome",
    "microsoft-edge",
    "msedge",
    "brave-browser",
)
"""Commands of browsers that print without a window, in the order in which they are looked for."""

BROWSER_VARIABLE = "MODAL_REPORT_BROWSER"
"""Environment variable that names another browser of this family."""

LONGEST_WAIT = 180.0
"""Seconds after which the browser is taken to be stuck."""

_QUIET = (
    "--headless",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-pdf-header-footer",
)

_DATE = re.compile(rb"/(CreationDate|ModDate) \(D:\d{14}[^)]*\)")


class NoBrowserError(IdentificationError):
    """No browser was found that can print a page, or it failed to."""


def find_browser() -> str | None:
    """The browser that would print: that of the variable MODAL_REPORT_BROWSER, else the first installed one."""
    named = os.environ.get(BROWSER_VARIABLE, "")
    if named:
        return shutil.which(named)
    return next((found for name in BROWSERS if (found := shutil.which(name))), None)


def write_pdf(html: str | os.PathLike[str], pdf: str | os.PathLike[str]) -> Path:
    """Print a page of a report to A4.

    Args:
        html: the page, `report.html`.
        pdf: file to write; it appears once it is complete, in place of one of the same name.

    Returns:
        The path of the PDF.

    Raises:
        InvalidDataError: there is no such page, or the PDF cannot be written.
        NoBrowserError: no browser of the Chromium family is installed, or it failed.
    """
    page, target = Path(html).absolute(), Path(pdf)
    if not page.is_file():
        raise InvalidDataError(f"there is no page {str(page)!r} to print; write the report first.")
    browser = find_browser()
    if browser is None:
        raise NoBrowserError(
            "a PDF needs Chromium, Chrome or Edge, and none is installed (or name one in "
            f"{BROWSER_VARIABLE}); open {page.name} in any browser and print it to a file instead."
        )
    sweep(target.absolute().parent)
    try:
        with scratch_folder(target.absolute().parent) as folder:
            printed = folder / "report.pdf"
            _print(browser, page, printed)
            printed.write_bytes(_without_clock(printed.read_bytes()))
            printed.replace(target)
    except OSError as error:
        raise InvalidDataError(
            f"{str(target)!r} cannot be written ({error.strerror or error}); choose another folder for the PDF."
        ) from error
    return target


def _print(browser: str, page: Path, printed: Path) -> None:
    command = [browser, *_QUIET, f"--user-data-dir={printed.parent / 'profile'}"]
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        command.append("--no-sandbox")  # the sandbox of Chromium refuses to run for root, as in a container
    command += [f"--print-to-pdf={printed}", page.as_uri()]
    try:
        run = subprocess.run(command, capture_output=True, timeout=LONGEST_WAIT, check=False)  # noqa: S603 - no shell, our own page
    except subprocess.TimeoutExpired as error:
        raise NoBrowserError(
            f"{Path(browser).name} did not print {page.name} within {LONGEST_WAIT:.0f} s; print it from a window."
        ) from error
    if run.returncode or not printed.is_file():
        raise NoBrowserError(
            f"{Path(browser).name} could not print {page.name} (exit status {run.returncode}); print it from a window."
        )


def _without_clock(document: bytes) -> bytes:
    """The dates of the file exchanged for one day, without moving a byte: offsets in a PDF are counted.

    Example:
        >>> _without_clock(b"/CreationDate (D:20260504120000+00'00')")
        b"/CreationDate (D:20000101000000+00'00')"
    """
    return _DATE.sub(lambda date: re.sub(rb"D:\d{14}", b"D:20000101000000", date.group()), document)
