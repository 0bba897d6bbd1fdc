"""The page in a headless browser: nothing to complain about, no request, and values that are those of the result."""

import re
import shutil
import subprocess

import numpy as np
import pytest

from modal.modes.response_synthesis import measured_frf
from modal.plots import order_fits, response_chart, svg_text
from modal.report.pages import html_text
from modal.report.pictures import Picture, readable
from modal.sections.validation import Provenance

pytestmark = pytest.mark.skipif(shutil.which("chromium") is None, reason="chromium is not installed")

LONGEST = 300
"""Seconds; a busy machine starts a browser slowly."""


@pytest.fixture
def browse(tmp_path):
    """A function of a page -> (its tree after the scripts have run, what the browser logged, its log of requests)."""

    def run(page, *options):
        log = tmp_path / "requests.json"
        command = ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"]
        command += ["--disable-background-networking", "--disable-component-update", "--disable-sync"]
        command += ["--disable-default-apps", "--enable-logging=stderr", "--v=0", f"--log-net-log={log}"]
        command += [f"--user-data-dir={tmp_path / 'profile'}", "--window-size=1400,1000", *options]
        done = subprocess.run(
            [*command, "--dump-dom", page.as_uri()], capture_output=True, text=True, timeout=LONGEST, check=True
        )
        return done.stdout, done.stderr, log.read_text(encoding="utf-8", errors="replace")

    return run


def asked_by_the_page(requests):
    """Addresses that a page from a file asked for; the browser's own errands (its clock, its updates) are not its."""
    own = [line for line in requests.splitlines() if '"network_isolation_key":"file:' in line]
    return {address for line in own for address in re.findall(r'"url":"((?:https?|wss?|ftp)://[^"]*)"', line)}


def test_a_request_of_a_page_would_be_seen(browse, tmp_path):
    page = tmp_path / "asking.html"
    page.write_text('<!DOCTYPE html><img src="http://127.0.0.1:9/x.png">', encoding="utf-8")
    assert asked_by_the_page(browse(page)[2]) == {"http://127.0.0.1:9/x.png"}


def test_nothing_to_complain_about_and_no_request(nasty_files, browse):
    tree, said, requests = browse(nasty_files.html)
    assert "CONSOLE" not in said
    assert not asked_by_the_page(requests)
    assert tree.count('class="tip"') == nasty_files.html.read_text(encoding="utf-8").count("data-chart=")
    assert not re.search(r"<figure[^>]*data-shapes[^>]*hidden", tree)  # the script ran and showed what moves


def test_a_script_that_is_not_ours_does_not_run(plain_files, browse, tmp_path):
    page = tmp_path / "changed.html"
    text = plain_files.html.read_text(encoding="utf-8")
    page.write_text(text.replace("</body>", "<script>document.title = 'taken'</script></body>"), encoding="utf-8")
    tree, said, _ = browse(page)
    assert "taken</title>" not in tree
    assert "Content Security Policy" in said


ACT = """
const figure = document.querySelector("figure[data-chart]");
const svg = figure.querySelector("svg");
const plot = figure.querySelector(".plot");
const say = (name, text) => document.documentElement.setAttribute(`data-${name}`, text);
const tip = () => [...figure.querySelectorAll(".tip b, .tip span")].map((one) => one.textContent).join("|");
const { box } = JSON.parse(figure.querySelector("script").textContent).panels[0];
const move = (across, down) => {
  const at = new DOMPoint(box[0] + across * box[2], box[1] + down * box[3]).matrixTransform(svg.getScreenCTM());
  svg.dispatchEvent(new PointerEvent("pointermove", { clientX: at.x, clientY: at.y, bubbles: true }));
};
const press = (key) => plot.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true }));
move(0.5, 0.5); say("middle", tip());
move(-0.2, 0.5); say("outside", String(figure.querySelector(".tip").hidden));
press("Home"); say("home", tip());
press("ArrowRight"); say("next", document.querySelector(".told").textContent);
press("Escape"); say("ended", String(figure.querySelector(".tip").hidden));
const button = figure.querySelector("button");
button.click(); say("pressed", button.getAttribute("aria-pressed"));
say("gone", String(figure.querySelectorAll("svg .off").length));
"""


def answers(identification, picture, browse, tmp_path):
    """What the page answers to a pointer, to keys and to a click."""
    text = html_text(identification, Provenance(), {"order_fits": picture})
    text = re.sub(r"script-src '[^']*'", "script-src 'unsafe-inline'", text)
    page = tmp_path / "acting.html"
    page.write_text(text.replace("</body>", f"<script>{ACT}</script></body>"), encoding="utf-8")
    tree, said, _ = browse(page)
    assert "CONSOLE" not in said
    root = re.search(r"<html[^>]*>", tree)[0]
    return dict(re.findall(r'data-(\w+)="([^"]*)"', root))


def test_values_are_read_with_pointer_and_keys(identification, browse, tmp_path):
    evidence = identification.order_evidence
    figure = order_fits(evidence)
    picture = readable(figure, "order fits", "words")
    limits = figure.panels[0].x.limits
    said = answers(identification, picture, browse, tmp_path)
    middle = sum(limits) / 2
    orders = [
        order for order, fit in zip(evidence.candidate_orders, evidence.candidate_fits, strict=True) if np.isfinite(fit)
    ]
    fits = [fit for fit in evidence.candidate_fits if np.isfinite(fit)]
    nearest = min(range(len(orders)), key=lambda i: abs(orders[i] - middle))
    assert said["middle"].startswith(f"model order {orders[nearest]:g}|")
    assert f"on rows not fitted to{float(f'{fits[nearest]:.5g}'):g}" in said["middle"]
    assert said["outside"] == said["ended"] == "true"
    assert said["home"].startswith(f"model order {orders[0]:g}|")
    assert said["next"].startswith(f"model order {orders[1]:g}, on rows not fitted to {fits[1]:g}")
    assert (said["pressed"], said["gone"]) == ("false", "1")


def test_a_response_is_read_together_with_its_coherence(identification, browse, tmp_path):
    measured = measured_frf(identification.records)
    figure = response_chart(measured, identification.realisation, input_names=["in"], output_names="abc")
    picture = readable(figure, "responses", "words")
    said = answers(identification, picture, browse, tmp_path)
    title, *rows = said["middle"].split("|")
    nearest = np.argmin(np.abs(measured.frequencies - measured.frequencies[-1] / 2))
    assert title.startswith("in → a, frequency ")
    assert title.endswith(" Hz")
    assert float(title.split()[-2]) == pytest.approx(measured.frequencies[-1] / 2, abs=measured.frequencies[1])
    values = dict(re.fullmatch(r"([a-z]+)(–|\d.*)", row).groups() for row in rows)
    assert set(values) == {"measured", "model", "coherence"}
    assert (values["measured"] == "–") is (float(values["coherence"]) < 0.5)
    assert float(values["coherence"]) == pytest.approx(measured.multiple_coherence[nearest, 0], abs=0.02)


def test_a_picture_without_numbers_stays_a_picture(identification, browse, tmp_path):
    svg = svg_text(order_fits(identification.order_evidence), name="order fits", description="words")
    page = tmp_path / "still.html"
    page.write_text(
        html_text(identification, Provenance(), {"order_fits": Picture(svg=svg, caption="words")}), encoding="utf-8"
    )
    tree, said, _ = browse(page)
    assert "CONSOLE" not in said
    assert 'class="tip"' not in tree


SEE = """
const say = (name, text) => document.documentElement.setAttribute(`data-${name}`, text);
const picture = document.querySelector(".top figure svg").getBoundingClientRect();
say("bottom", String(Math.round(picture.bottom)));
say("sideways", String(document.documentElement.scrollWidth - document.documentElement.clientWidth));
"""


@pytest.mark.parametrize("width", [500, 1280])
@pytest.mark.parametrize("page", ["identification", "gap"])
def test_a_picture_stands_on_the_first_screen(*, page, width, plain_files, gap_texts, browse, tmp_path):
    """On a narrow screen a dozen lines of reasons stood above it."""
    text = plain_files.html.read_text(encoding="utf-8") if page == "identification" else gap_texts["plain"][0]
    if width == 500:
        assert text.count('<div class="lede">') == 1
        text = text.replace('<div class="lede">', f'<div class="lede"><p>{"A reason to be careful. " * 60}</p>')
    text = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", text)
    path = tmp_path / "seen.html"
    path.write_text(text.replace("</body>", f"<script>{SEE}</script></body>"), encoding="utf-8")
    tree, _, _ = browse(path, f"--window-size={width},900")
    said = dict(re.findall(r'data-(\w+)="([^"]*)"', re.search(r"<html[^>]*>", tree)[0]))
    assert int(said["bottom"]) <= 900
    assert int(said["sideways"]) <= 0
