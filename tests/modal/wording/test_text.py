import csv
import io

import pytest
from hypothesis import given
from hypothesis import strategies as st

from modal.wording.text import csv_cell, escape_markdown, plot_label, shorten
from okid.errors import InvalidDataError, visible

RIGHT_TO_LEFT_OVERRIDE = "\N{RIGHT-TO-LEFT OVERRIDE}"


@pytest.mark.parametrize(
    "hidden", ["\x1b", "\x00", "\x07", "\x9b", RIGHT_TO_LEFT_OVERRIDE, "\N{ZERO WIDTH SPACE}", "\ud800"]
)
def test_hidden_characters_are_shown_as_one_sign(hidden):
    assert visible(f"a{hidden}b") == "a\N{REPLACEMENT CHARACTER}b"


def test_ordinary_unicode_is_left_alone():
    for text in ("étage 3", "加速度", "قناة", "Δx²", "floor_1 [m/s^2]"):
        assert visible(text) == text


@given(st.text())
def test_visible_text_is_one_encodable_line(text):
    shown = visible(text)
    assert len(shown.splitlines()) <= 1
    shown.encode("utf-8")


@given(st.text(max_size=60), st.integers(min_value=3, max_value=40))
def test_shortened_text_keeps_its_ends(text, limit):
    short = shorten(text, limit)
    assert len(short) <= max(limit, 1)
    assert short == text or (short[0] == text[0] and short[-1] == text[-1])


@pytest.mark.parametrize("formula", ["=1+1", "+1", "-1", "@SUM(A1)", " =1", "\t=1", "\n=1"])
def test_a_formula_does_not_start_a_cell(formula):
    cell = csv_cell(formula)
    assert cell.startswith("'")
    file = io.StringIO()
    csv.writer(file).writerow([cell])
    assert next(csv.reader(io.StringIO(file.getvalue()))) == [cell]


def test_a_name_is_not_quoted_for_nothing():
    assert csv_cell("floor-1") == "floor-1"


@pytest.mark.parametrize(
    "text",
    ["[a](javascript:alert(1))", "![a](http://x.y)", "<script>alert(1)</script>", "`code`", "*b*", "| a |", "_i_"],
)
def test_markdown_is_escaped(text):
    escaped = escape_markdown(text)
    for active in ("<", "http://"):
        assert active not in escaped
    for sign in "[]`*|":
        assert escaped.count(sign) == escaped.count("\\" + sign) == text.count(sign)


def test_underscores_within_a_word_stay():
    assert escape_markdown("floor_1 of_") == r"floor_1 of\_"


def test_a_picture_label_is_never_mathematics():
    assert plot_label("a\x1b[2J$") == "a\N{REPLACEMENT CHARACTER}[2J$"


def test_a_sentence_leaves_out_the_middle_of_what_is_too_long_to_be_read():
    long = InvalidDataError(
        f"the kind of 'a' is {'acc[' * 900!r}, and {'b c ' * 900!r} is the name of 'd'; use a word."
    )
    assert len(str(long)) < 420
    assert str(long).startswith("the kind of 'a' is 'acc[")
    assert str(long).endswith("c ' is the name of 'd'; use a word.")
    between = f"'a' {'of many short words ' * 20}'b'."
    assert str(InvalidDataError(between)) == between
