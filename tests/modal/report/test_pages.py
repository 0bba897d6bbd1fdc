import base64
import csv
import hashlib
import itertools
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from page_reader import Skeleton
from systems import random_system, simulate

from modal.acceptance.check import LimitOutcome
from modal.acceptance.test_file import SensorNote, Specification
from modal.identification.pipeline import identify
from modal.quality import ChannelQuality, ChannelStatistics, DataQuality, Finding
from modal.report import pages
from modal.report.pages import PageLimits, html_text, markdown_text
from modal.report.pictures import Setting, draw_pictures
from modal.sections.validation import Provenance, SourceFile
from modal.verdict.judgement import FOUND_AGAIN
from okid.record import Record

NASTY = "</style></script><script>alert(1)</script> {{ 7*7 }} {% raw %} |"


@pytest.fixture(scope="module")
def page(plain_files):
    return Skeleton(plain_files.html.read_text(encoding="utf-8"))


@pytest.fixture(scope="module", params=["identification", "diagnosis"])
def texts(request):
    """{names: (page, Markdown, CSV)} of the same result with plain and with nasty names."""
    if request.param == "diagnosis":
        return request.getfixturevalue("gap_texts")
    found = {names: request.getfixturevalue(f"{names}_files") for names in ("plain", "nasty")}
    return {
        names: [path.read_text(encoding="utf-8") for path in (files.html, files.markdown, files.csv)]
        for names, files in found.items()
    }


def test_names_change_no_tag_of_the_page(texts):
    plain, nasty = (Skeleton(texts[names][0]) for names in ("plain", "nasty"))
    assert nasty.tags == plain.tags
    assert not nasty.open


def test_nothing_is_loaded_and_every_link_leads_somewhere(texts):
    for text, *_ in texts.values():
        page = Skeleton(text)
        tags = {tag for tag, _, _ in page.attributes} | {tag for tag, _ in page.tags}
        assert not tags & {"link", "iframe", "img", "object", "embed", "foreignobject"}
        for _, name, value in page.attributes:
            assert not name.startswith("on")
            if name in ("href", "src", "xlink:href"):
                assert value.startswith("#")
        assert "@import" not in text
        assert all(target.startswith("#") for target in re.findall(r"url\(([^)]*)\)", text))
        identities = {value for _, name, value in page.attributes if name == "id"}
        links = {value[1:] for tag, name, value in page.attributes if tag == "a" and name == "href"}
        assert len(links) > 6
        assert links <= identities


def test_hidden_characters_reach_no_text(texts):
    for text in texts["nasty"]:
        assert not {"\x1b", "\x00", "\N{RIGHT-TO-LEFT OVERRIDE}"} & set(text)


def test_markdown_holds_no_tag_and_no_link_of_a_name_and_its_tables_have_equal_rows(texts):
    outside_code = [line for line in texts["nasty"][1].splitlines() if not line.startswith("    ")]
    for mark in ("<script", "<img", "http://"):
        assert mark not in "\n".join(outside_code)
    assert "](javascript" not in "\n".join(outside_code).replace("\\]", "")
    for is_table, lines in itertools.groupby(outside_code, lambda line: line.startswith("|")):
        assert not is_table or len({len(re.findall(r"(?<!\\)\|", line)) for line in lines}) == 1
    assert sum(line.startswith(("|--", "| --")) for line in outside_code) >= 7


def test_csv_starts_no_formula(texts):
    for row in csv.reader(texts["nasty"][2].splitlines()):
        for cell in row:
            if cell.startswith(("=", "+", "-", "@")):
                float(cell)  # a negative number, not a formula


def scripts_of(text):
    """(what runs, what is data) of a page."""
    found = re.findall(r"<script([^>]*)>(.*?)</script>", text, flags=re.DOTALL)
    return [body for kind, body in found if not kind], [body for kind, body in found if "application/json" in kind]


@pytest.mark.parametrize("files", ["plain_files", "nasty_files"])
def test_one_script_may_run_and_it_is_ours(files, request):
    text = request.getfixturevalue(files).html.read_text(encoding="utf-8")
    (running,), data = scripts_of(text)
    assert text.count("<script") == 1 + len(data)
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]*)"', text)[1]
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    digest = base64.b64encode(hashlib.sha256(running.encode("utf-8")).digest()).decode()
    assert rules["script-src"] == f"'sha256-{digest}'"
    assert rules["default-src"] == "'none'"
    assert not {"connect-src", "font-src", "frame-src"} & set(rules)
    for word in ("innerHTML", "eval(", "fetch(", "XMLHttpRequest", "import(", "document.write"):
        assert word not in running


def test_the_numbers_of_a_page_are_json(nasty_files):
    _, data = scripts_of(nasty_files.html.read_text(encoding="utf-8"))
    assert len(data) >= 5
    assert all(json.loads(body) for body in data)


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


def test_page_one_holds_the_response_what_to_do_and_the_shapes(plain_files):
    text = plain_files.html.read_text(encoding="utf-8")
    places = [
        text.index(mark) for mark in ("<h1>", "<b>Next:</b>", 'data-chart="overview"', 'id="modes"', 'id="shapes"')
    ]
    assert places == sorted(places)
    assert places[-1] < text.index('id="setup"')
    assert "the modes found, at 3.67, 11.1, 16.6 Hz" in text  # for those who cannot see the picture, and below it


def test_every_picture_has_words_and_one_legend(plain_files):
    text = plain_files.html.read_text(encoding="utf-8")
    pictures = re.findall(r"<svg [^>]*viewBox[^>]*>", text)
    assert pictures
    assert all(re.search(r'aria-label="[^"]{20,}"', one) for one in pictures)
    assert ".toggles + .plot .key { display: none; }" in text  # the buttons of a picture are its legend


def luminance(colour):
    parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    linear = [x / 12.92 if x <= 0.03928 else ((x + 0.055) / 1.055) ** 2.4 for x in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


@pytest.mark.parametrize("scheme", [0, 1])
@pytest.mark.parametrize(
    ("words", "ground"),
    [
        *(("ink", "paper"), ("muted", "paper"), ("muted", "ground"), ("muted", "noise-wash"), ("measured", "paper")),
        *((role, f"{role}-wash") for role in ("system", "doubtful", "residual")),
    ],
)
def test_words_stand_out_from_their_ground(plain_files, scheme, words, ground):
    text = plain_files.html.read_text(encoding="utf-8")  # light, then dark; WCAG 2.1, 1.4.3: 4.5 to 1 for text
    first, second = (luminance(re.findall(rf"--{role}: (#\w{{6}});", text)[scheme]) for role in (words, ground))
    assert (max(first, second) + 0.05) / (min(first, second) + 0.05) >= 4.5


def test_how_well_a_mode_reappears_is_a_bar_and_no_sentence_in_every_row(identification):
    shares = (("halves of the data", 0.91), ("other model orders", 0.83))
    modes = tuple(
        replace(mode, reappears=shares, reason=f"{FOUND_AGAIN}halves of the data 0.91, other model orders 0.83")
        for mode in identification.modes.modes[:3]
    )
    result = replace(identification, modes=replace(identification.modes, modes=modes))
    text = html_text(result, Provenance(), {})
    assert text.count("width:91%") == text.count("width:83%") == 3
    assert "found again: halves" not in text
    odd = replace(modes[0], reason=f"{modes[0].reason}; damping not resolved: a doubt")
    result = replace(result, modes=replace(result.modes, modes=(odd, *modes[1:])))
    assert html_text(result, Provenance(), {}).count("damping not resolved: a doubt") == 1


@pytest.mark.parametrize(("most", "said"), [(4, ""), (3, "1 more channel"), (2, "2 more channels")])
def test_channels_beyond_a_number_are_folded_and_none_is_lost(identification, monkeypatch, most, said):
    monkeypatch.setattr(pages.PageLimits, "MOST_CHANNELS", most)
    text = html_text(identification, Provenance(), {})
    assert (f"<summary>{said}</summary>" in text) is bool(said)
    assert ("<summary>" in text) is bool(said)
    rows = re.findall(r"<tr><td><bdi>(\w+)</bdi></td><td>(?:in|out)put", text)
    assert sorted(rows) == ["floor_1", "floor_2", "floor_3", "ground"]


def test_noise_modes_stand_apart_from_the_others(page):
    groups = [dict(attrs) for attrs in [[(n, v)] for t, n, v in page.attributes if t == "tr" and n == "class"]]
    order = [group["class"] for group in groups]
    assert order.index("group system") < order.index("group doubtful") < order.index("group noise")


def test_page_without_system_modes(make_result):
    result = make_result()
    nothing = replace(result, modes=replace(result.modes, modes=result.modes.modes[3:]))
    page = Skeleton(html_text(nothing, Provenance(), {}))
    assert "No mode of the system was found." in " ".join(page.words)
    assert "None." in markdown_text(nothing, Provenance())


@pytest.mark.parametrize("unit", ["m/s^2", "m"])
def test_shapes_of_mixed_units_are_said_to_be_mixed(make_result, unit):
    result = make_result()
    record = replace(result.records[0], output_units=("m/s^2", "m/s^2", unit))
    caption = draw_pictures(replace(result, records=(record,)))["shapes"].caption
    assert ("different units" in caption) == (unit == "m")


def test_without_inputs_no_picture_says_that_they_drove_the_model(make_result):
    result = make_result()
    alone = tuple(record.select(inputs=[]) for record in result.records)
    markov = replace(result.markov, system=result.markov.system[:, :, :0], input_scale=np.ones(0))
    pictures = draw_pictures(replace(result, records=alone, markov=markov))
    for name in ("histories", "spectra"):
        assert "predicted one step ahead" in pictures[name].caption
        assert "inputs alone" not in pictures[name].caption + pictures[name].svg
    assert "inputs alone" in draw_pictures(result)["histories"].caption


def test_what_stands_among_the_warnings_is_not_said_again(make_result):
    sentence = "input 'ground' moves in 20 % of the band."
    result = make_result(warnings=(sentence,))
    result = replace(result, excitation=replace(result.excitation, messages=(sentence,)))
    for text in (html_text(result, Provenance(), {}), markdown_text(result, Provenance())):
        assert text.count("of the band") == 1
        assert re.search(r"The (<a href=.#warnings.>)?warnings(</a>)? say what the inputs cannot show", text)
        assert "The inputs move enough" not in text


def with_setting(result, setting):
    return Skeleton(html_text(result, Provenance(), {}, setting)), markdown_text(result, Provenance(), setting)


def outcome(state):
    return LimitOutcome(what=NASTY, required="at least 1", found="none", state=state, sentence=f"{NASTY}: {state}.")


@pytest.mark.parametrize(
    ("states", "mark"),
    [
        (("met", "met"), "Limits met"),
        (("met", "not met"), "Limits not met"),
        (("cannot be told", "not met"), "Limits not met"),
        (("met", "cannot be told"), "Limits open"),
    ],
)
def test_limits_stand_on_the_first_page(identification, states, mark):
    page, text = with_setting(identification, Setting(outcomes=tuple(outcome(state) for state in states)))
    words = page.text
    assert [one for one in ("Limits met", "Limits not met", "Limits open") if one in words] == [mark]
    assert "## Acceptance limits" in text
    assert "<script" not in text.split("## Acceptance limits")[1].split("## Set-up")[0]
    assert words.count(f"{NASTY}: ") == sum(state != "met" for state in states)


def test_without_limits_none_are_spoken_of(identification):
    page, text = with_setting(identification, Setting())
    assert "imits" not in page.text.replace("usual limit", "")
    assert "Acceptance" not in text


def test_the_test_file_is_shown_and_harmless(identification):
    specification = Specification(
        article=NASTY,
        operator="\N{RIGHT-TO-LEFT OVERRIDE}x",
        notes="x" * 5000,
        sensors=(SensorNote(channel="floor_1", serial=NASTY),),
    )
    page, text = with_setting(identification, Setting(specification=specification))
    plain, _ = with_setting(
        identification,
        Setting(
            specification=Specification(
                article="a", operator="b", notes="c", sensors=(SensorNote(channel="floor_1", serial="d"),)
            )
        ),
    )
    assert page.tags == plain.tags
    assert NASTY in page.text
    for shown in (page.text, text):
        assert "\N{RIGHT-TO-LEFT OVERRIDE}" not in shown
    assert "<script" not in text.split("## Channels and quality of the data")[0]


def quality(*levels):
    findings = tuple(
        Finding(level=level, what="spikes", where=NASTY, sentence=f"Number {i}.", channels=("floor_1",))
        for i, level in enumerate(levels)
    )
    numbers = ChannelStatistics(
        n_samples=10,
        n_missing=0,
        mean=0.5,
        std=1.0,
        smallest=-1.0,
        largest=2.0,
        resolution=np.nan,
        noise_floor=0.1,
        signal_to_noise=20.0,
        explained=0.875,
    )
    channel = ChannelQuality(name=NASTY, role="output", unit="m", statistics=numbers, findings=findings)
    return DataQuality(
        channels=(channel,), findings=findings, coherence=None, frequencies=np.zeros(0), densities=np.zeros((0, 1))
    )


@pytest.mark.parametrize(
    ("levels", "word"), [((), "good"), (("note",), "good"), (("doubtful",), "doubtful"), (("bad", "note"), "bad")]
)
def test_the_quality_of_the_data_is_shown(identification, levels, word):
    found = quality(*levels)
    page, text = with_setting(identification, Setting(quality=found, quality_of="as read"))
    words = page.text
    n_serious = sum(level != "note" for level in levels)
    assert f"quality of the data {word} {n_serious or 'nothing'} to look at" in re.sub(r"\s+", " ", words)
    for shown in (words, text):
        assert found.verdict in shown
        assert "the records as read" in shown
        assert ("Number 0." in shown) is bool(levels)
    assert "<script" not in text.split("## Channels and quality of the data")[1].split("## Choices")[0]


@pytest.mark.parametrize(("count", "more"), [(PageLimits.MOST_FINDINGS, False), (PageLimits.MOST_FINDINGS + 2, True)])
def test_a_flood_of_findings_is_bounded(identification, count, more):
    page, text = with_setting(identification, Setting(quality=quality(*["note"] * count)))
    for shown in (page.text, text):
        assert ("2 more, of lesser weight" in shown) is more
        assert len(re.findall(r"Number \d+\.", shown)) == PageLimits.MOST_FINDINGS


def test_data_that_were_not_looked_at_are_not_judged(identification):
    page, text = with_setting(identification, Setting())
    assert "the records as" not in page.text + text


@pytest.mark.parametrize(
    ("count", "said"),
    [(PageLimits.MOST_SUMMED_UP, ""), (PageLimits.MOST_SUMMED_UP + 3, "the other 3 are listed under")],
)
def test_the_first_page_has_room_for_ten_modes(identification, count, said):
    modes = tuple(
        replace(identification.modes.modes[0], frequency=float(i + 1), reason=f"reason {i}.") for i in range(count)
    )
    result = replace(identification, modes=replace(identification.modes, modes=modes))
    words = Skeleton(html_text(result, Provenance(), {})).text
    assert ("are listed under" in words) is bool(said)
    assert said in words
    assert all(words.count(f"reason {i}.") == 1 for i in range(count))


def test_intervals_are_shown_where_they_may_be_quoted(identification):
    first, *others = identification.modes.modes
    sure = replace(first, frequency_std=0.01, damping_ratio_std=0.001)
    vague = replace(sure, damping_resolved=False)
    for mode, shown in ((sure, True), (vague, False)):
        result = replace(identification, modes=replace(identification.modes, modes=(mode, *others)))
        text = markdown_text(result, Provenance())
        assert ("1.20 ± 0.20 %" in text) is shown
        assert "3.670 ± 0.020" in text


def test_files_are_named_with_their_hashes(identification):
    provenance = Provenance(sources=("a.csv",), files=(SourceFile(name=NASTY, size=1234, sha256="ab" * 32),))
    words = Skeleton(html_text(identification, provenance, {})).text
    assert "1,234" in words
    assert "ab" * 32 in words
    assert NASTY in words
    assert "ab" * 32 not in Skeleton(html_text(identification, Provenance(sources=("a.csv",)), {})).text


def test_many_records_are_listed(identification):
    record = identification.records[0]
    several = replace(identification, records=(record, replace(record, name="second")))
    assert "The 2 records" in Skeleton(html_text(several, Provenance(), {})).text
    assert "The 1 records" not in Skeleton(html_text(identification, Provenance(), {})).text


def test_the_python_of_the_page_gives_what_was_given(identification):
    """A setting that was given must be given again; one that was chosen is chosen again."""
    rng = np.random.default_rng(1)
    system = random_system(rng, n_modes=1, n_inputs=1, n_outputs=1, weak_mode=None)
    u = rng.standard_normal((400, 1))
    record = Record(u, simulate(system, u) + 0.01 * rng.standard_normal((400, 1)), system.dt)
    given = identify(record, observer_order=8, ridge=0.0, order=2)
    assert "identify(records, observer_order=8, ridge=0.0, order=2)\n" in markdown_text(given, Provenance())
    part = identify(record, order=2)
    text = markdown_text(part, Provenance())
    assert "identify(records, order=2)  # it chose observer_order=" in text
    assert "modal.identify(records)  # it chose observer_order=" in markdown_text(identification, Provenance())
