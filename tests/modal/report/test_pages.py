import re
import shutil
import subprocess
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from modal.report.pages import html_text, markdown_text
from modal.report.pictures import draw_pictures
from modal.report.provenance import Provenance

VOID = {"meta", "br", "img", "input", "link", "hr"}


class Skeleton(HTMLParser):
    """The tags of a page with the names of their attributes, and its text outside pictures."""

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.tags, self.attributes, self.words, self.open = [], [], [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        if "svg" not in self.open:
            self.tags.append((tag, tuple(name for name, _ in attrs)))
        self.attributes += [(tag, name, value) for name, value in attrs]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.attributes += [(tag, name, value) for name, value in attrs]

    def handle_endtag(self, tag):
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


@pytest.fixture(scope="module")
def page(plain_files):
    return Skeleton(plain_files.html.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def nasty_page(nasty_files):
    return Skeleton(nasty_files.html.read_text(encoding="utf-8"))


def test_names_change_no_tag_of_the_page(page, nasty_page):
    assert nasty_page.tags == page.tags
    assert not nasty_page.open


def test_nothing_runs_and_nothing_is_loaded(page, nasty_page):
    for skeleton in (page, nasty_page):
        tags = {tag for tag, _, _ in skeleton.attributes} | {tag for tag, _ in skeleton.tags}
        assert not tags & {"script", "link", "iframe", "img", "object", "embed", "foreignobject"}
        for _, name, value in skeleton.attributes:
            assert not name.startswith("on")
            if name in ("href", "src", "xlink:href"):
                assert value.startswith("#")


def test_styles_load_nothing(plain_files):
    text = plain_files.html.read_text(encoding="utf-8")
    assert "@import" not in text
    assert all(target.startswith("#") for target in re.findall(r"url\(([^)]*)\)", text))


def test_every_link_leads_somewhere(page):
    identities = {value for _, name, value in page.attributes if name == "id"}
    links = {value[1:] for tag, name, value in page.attributes if tag == "a" and name == "href"}
    assert links
    assert links <= identities


def test_page_says_what_was_found(page):
    text = " ".join(page.words)
    for words in (
        "Three modes of the system were found",
        "Read this first",
        "Look at floor_1.",
        "grows in time",
        "11.1",
    ):
        assert words in text


def test_noise_modes_stand_apart_from_the_others(page):
    groups = [dict(attrs) for attrs in [[(n, v)] for t, n, v in page.attributes if t == "tr" and n == "class"]]
    order = [group["class"] for group in groups]
    assert order.index("group system") < order.index("group doubtful") < order.index("group noise")


def test_hidden_characters_reach_no_text(nasty_files):
    for path in (nasty_files.html, nasty_files.markdown, nasty_files.csv):
        text = path.read_text(encoding="utf-8")
        assert "\x1b" not in text
        assert "\x00" not in text
        assert "\N{RIGHT-TO-LEFT OVERRIDE}" not in text


def test_markdown_holds_no_tag_and_no_link_of_a_name(nasty_files):
    text = nasty_files.markdown.read_text(encoding="utf-8")
    outside_code = "\n".join(line for line in text.splitlines() if not line.startswith("    "))
    assert "<script" not in outside_code
    assert "<img" not in outside_code
    assert "](javascript" not in outside_code.replace("\\]", "")
    assert "http://" not in outside_code


def test_markdown_tables_have_equal_rows(nasty_files):
    width = None
    for line in nasty_files.markdown.read_text(encoding="utf-8").splitlines():
        if not line.startswith("|"):
            width = None
            continue
        cells = len(re.findall(r"(?<!\\)\|", line))
        assert width in (None, cells)
        width = cells


def test_page_without_system_modes(make_once):
    result = make_once()
    nothing = replace(result, modes=replace(result.modes, modes=result.modes.modes[3:]))
    page = Skeleton(html_text(nothing, Provenance(), {}))
    assert "No mode of the system was found." in " ".join(page.words)
    assert "None." in markdown_text(nothing, Provenance())


@pytest.mark.skipif(shutil.which("chromium") is None, reason="chromium is not installed")
def test_a_browser_has_nothing_to_complain_about(nasty_files, tmp_path):
    command = ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"]
    command += ["--disable-background-networking", "--disable-component-update", "--disable-sync"]
    command += ["--enable-logging=stderr", f"--user-data-dir={tmp_path}", "--dump-dom", nasty_files.html.as_uri()]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    assert "CONSOLE" not in run.stderr
    assert run.stdout.count("<svg") == nasty_files.html.read_text(encoding="utf-8").count("<svg")


@pytest.mark.parametrize("unit", ["m/s^2", "m"])
def test_shapes_of_mixed_units_are_said_to_be_mixed(make_once, unit):
    result = make_once()
    record = replace(result.records[0], output_units=("m/s^2", "m/s^2", unit))
    caption = draw_pictures(replace(result, records=(record,)))["shapes"].caption
    assert ("different units" in caption) == (unit == "m")


def test_without_inputs_no_picture_says_that_they_drove_the_model(make_once):
    result = make_once()
    alone = tuple(record.select(inputs=[]) for record in result.records)
    markov = replace(result.markov, system=result.markov.system[:, :, :0], input_scale=np.ones(0))
    pictures = draw_pictures(replace(result, records=alone, markov=markov))
    for name in ("histories", "spectra"):
        assert "predicted one step ahead" in pictures[name].caption
        assert "inputs alone" not in pictures[name].caption + pictures[name].svg
    assert "inputs alone" in draw_pictures(result)["histories"].caption


def test_what_stands_among_the_warnings_is_not_said_again(make_once):
    sentence = "input 'ground' moves in 20 % of the band."
    result = make_once(warnings=(sentence,))
    result = replace(result, excitation=replace(result.excitation, messages=(sentence,)))
    for text in (html_text(result, Provenance(), {}), markdown_text(result, Provenance())):
        assert text.count("of the band") == 1
        assert "among the" in text
        assert "The inputs move enough" not in text
