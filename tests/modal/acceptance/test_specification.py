"""The test file: every key, every limit, and one sentence with the remedy for whatever is wrong."""

import datetime as dt
import math
import re
from pathlib import Path

import pytest

import modal.acceptance.test_file
from modal.acceptance.test_file import KEYS, Specification, TomlTable, limits_of, read_specification
from okid.errors import InvalidDataError, UnreadableFileError

WHOLE = """
article = "three-storey frame"
operator = "A. Tester"
place = "hall 2"
date = 2026-05-04
notes = "second floor bolted again"

[[sensors]]
channel = "tip"
kind = "accelerometer"
maker = "Maker"
model = "X1"
serial = 12345
sensitivity = "100 mV/g"
calibrated = "2026-01-10"
dof = "3X+"
note = "wax"

[[sensors]]
channel = "force"
"""

LIMITS = """
[[limits]]
kind = "mode"
name = "first bending"
frequency = [3, 3.9]
damping = [0.005, 0.02]
[[limits]]
kind = "no_mode"
frequency = [45, 55]
[[limits]]
kind = "n_modes"
at_least = 3
[[limits]]
kind = "damping"
at_least = 0.02
frequency = [0, 10]
[[limits]]
kind = "fit"
at_least = 0.9
[[limits]]
kind = "uncertainty"
frequency_at_most = 0.01
[[limits]]
kind = "settled"
[[limits]]
kind = "trust"
at_least = "with care"
"""


def read(tmp_path, text):
    path = tmp_path / "test.toml"
    path.write_text(text, encoding="utf-8")
    return read_specification(path)


def test_all_that_can_stand_in_a_test_file_is_read(tmp_path):
    found = read(tmp_path, WHOLE)
    assert (found.article, found.operator, found.place) == ("three-storey frame", "A. Tester", "hall 2")
    assert (found.date, found.notes) == (dt.date(2026, 5, 4), "second floor bolted again")
    tip, force = found.sensors
    assert (tip.channel, tip.kind, tip.maker, tip.model, tip.serial) == ("tip", "accelerometer", "Maker", "X1", "12345")
    assert (tip.sensitivity, tip.calibrated, tip.dof, tip.note) == ("100 mV/g", dt.date(2026, 1, 10), "3X+", "wax")
    assert (force.channel, force.kind, force.calibrated) == ("force", "", None)
    assert found.geometry is None
    assert found.limits == ()


def test_an_empty_file_is_a_specification_without_limits(tmp_path):
    assert read(tmp_path, "").limits == Specification().limits


def test_every_kind_of_limit_is_read(tmp_path):
    limits = read(tmp_path, LIMITS).limits
    assert [limit.kind for limit in limits] == list(KEYS)
    mode, forbidden, count, damping, fit, uncertainty, settled, trust = limits
    assert (mode.name, mode.frequency, mode.damping) == ("first bending", (3.0, 3.9), (0.005, 0.02))
    assert (forbidden.name, forbidden.frequency) == ("", (45.0, 55.0))
    assert (count.at_least, count.at_most) == (3, math.inf)
    assert (damping.at_least, damping.at_most, damping.frequency) == (0.02, math.inf, (0.0, 10.0))
    assert fit.at_least == 0.9
    assert (uncertainty.frequency_at_most, uncertainty.damping_at_most, uncertainty.frequency) == (0.01, None, None)
    assert settled.frequency is None
    assert trust.trust == "with care"


def test_the_geometry_is_a_table_or_a_file_beside(tmp_path):
    table = "[geometry]\nlines = [['1', '2']]\n[geometry.nodes]\n1 = [0, 0, 0]\n2 = [0, 0, 3]\n"
    assert read(tmp_path, table).geometry.n_nodes == 2
    (tmp_path / "frame.toml").write_text(table.replace("[geometry]\n", "").replace("geometry.", ""))
    assert read(tmp_path, 'geometry = "frame.toml"\n').geometry.n_nodes == 2
    with pytest.raises(InvalidDataError, match="nofile"):
        read(tmp_path, 'geometry = "nofile.toml"\n')


WRONG = [
    ('artcle = "x"', "did you mean article"),
    ('zzz = "x"', "the keys are article, operator"),
    ("article = [1]", "must be a text"),
    ("article = true", "must be a text"),
    ("date = 5", "date such as 2026-05-04"),
    ('date = "yesterday"', "date such as 2026-05-04"),
    ("sensors = 3", r"\[\[sensors\]\]"),
    ("sensors = [1]", r"\[\[sensors\]\]"),
    ("[[sensors]]\nkind = 'a'", "sensor 1 of test.toml needs channel"),
    ("[[sensors]]\nchannel = 'a'\nseral = 1", "did you mean serial"),
    ("[[sensors]]\nchannel = 'a'\n[[sensors]]\nchannel = 'a'", "two sensors of channel 'a'"),
    ("geometry = 3", "geometry"),
    ("[[limits]]\nfrequency = [1, 2]", "is missing"),
    ("[[limits]]\nkind = 'mod'", "did you mean mode"),
    ("[[limits]]\nkind = 3", "must be one of mode, no_mode"),
    ("[[limits]]\nkind = 'mode'", "needs frequency"),
    ("[[limits]]\nkind = 'mode'\nfrequency = 3", "two numbers"),
    ("[[limits]]\nkind = 'mode'\nfrequency = [3, 2]", "must rise"),
    ("[[limits]]\nkind = 'mode'\nfrequency = [3, 3.0]", "must rise"),
    ("[[limits]]\nkind = 'mode'\nfrequency = [-1, 2]", "at least 0"),
    ("[[limits]]\nkind = 'mode'\nfrequency = [1, nan]", "at least 0"),
    ("[[limits]]\nkind = 'mode'\nfrequency = [1, true]", "must be a number"),
    ("[[limits]]\nkind = 'mode'\nfrequency = [1, 2]\ndamping = [1, 2]", "write 2 % as 0.02"),
    ("[[limits]]\nkind = 'mode'\nfrequency = [1, 2]\nfrequncy = 1", "did you mean frequency"),
    ("[[limits]]\nkind = 'fit'\nat_least = 1.5", "at most 1"),
    ("[[limits]]\nkind = 'fit'\nat_least = 1" + 400 * "0", "at most 1"),
    ("[[limits]]\nkind = 'n_modes'", "needs at_least or at_most"),
    ("[[limits]]\nkind = 'n_modes'\nat_least = 3\nat_most = 2", "swap the two"),
    ("[[limits]]\nkind = 'damping'\nat_least = 2", "write 2 % as 0.02"),
    ("[[limits]]\nkind = 'uncertainty'", "needs frequency_at_most or damping_at_most"),
    ("[[limits]]\nkind = 'trust'\nat_least = 'not carried'", "carried, with care"),
    ("article = ", "no TOML"),
    ("a = " + 5000 * "[", "no TOML"),
    ("article = '" + 3000 * "x" + "'", "3000 characters"),
    ("[[limits]]\nkind='settled'\n" * 1001, "1001 limits"),
]


@pytest.mark.parametrize(("text", "words"), WRONG, ids=[text[:40].replace("\n", " ") for text, _ in WRONG])
def test_what_is_wrong_is_said_in_one_sentence(tmp_path, text, words):
    with pytest.raises(InvalidDataError, match=words) as caught:
        read(tmp_path, text)
    sentence = str(caught.value)
    assert sentence.endswith((".", "?"))
    assert "\n" not in sentence
    assert len(sentence) < 500


def test_a_strangers_text_is_shown_short_and_plain(tmp_path):
    with pytest.raises(InvalidDataError) as caught:
        read(tmp_path, '"\\u202e' + 900 * "k" + '\\u001b[2J" = 1')
    sentence = str(caught.value)
    assert len(sentence) < 300
    assert not {"\u202e", "\x1b"} & set(sentence)


def test_files_that_are_none(tmp_path):
    (tmp_path / "data.bin").write_bytes(b"\xff\xfe\x00data")
    with (tmp_path / "large.toml").open("wb") as file:
        file.truncate(20 << 20)
    for name, words in (
        ("no.toml", "^there is no file '.*no.toml'; give"),
        (".", "^there is no file"),
        ("x" * 5000, "cannot be read \\(File name too long\\).$"),
        ("data.bin", "no text in UTF-8"),
        ("large.toml", "^'[^']*large.toml' has 20971520 bytes, .* measured file\\?$"),
    ):
        with pytest.raises(UnreadableFileError, match=words):
            read_specification(tmp_path / name)


def test_the_page_on_the_test_file_is_right(tmp_path):
    """The example in the documentation reads, and its table names every kind with keys that are known."""
    page = (
        Path(modal.acceptance.test_file.__file__)
        .parents[1]
        .joinpath("docs", "test_file.md")
        .read_text(encoding="utf-8")
    )
    (tmp_path / "test.toml").write_text(page.split("```toml\n")[1].split("```")[0], encoding="utf-8")
    found = read_specification(tmp_path / "test.toml")
    assert found.sensors[0].dof == "3X+"
    assert found.geometry.node_names == ("1", "2", "3")
    assert [limit.kind for limit in found.limits] == ["mode", "no_mode", "fit"]
    rows = [re.findall(r"`([a-z_]+)`", line) for line in page.splitlines() if line.startswith("| `")]
    assert {kind for kind, *_ in rows} == set(KEYS)
    values = {"frequency": [1.0, 2.0], "damping": [0.01, 0.02], "at_least": 0.5, "at_most": 0.9}
    for kind, *keys in rows:
        told = {key: values.get(key, 0.1) for key in keys} | {"kind": kind}
        if kind == "trust":
            told["at_least"] = "carried"
        limits_of(TomlTable(values={"limits": [told]}, where="page"))
