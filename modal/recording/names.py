"""Names from files are not to be trusted: as parts of entity paths, as titles of views, as cells of a table.

A channel may be called `<script>`, nothing at all, a thousand letters, or text that runs from right to left and
carries what follows along. What is shown goes through `modal.wording.names`; here are the paths, and the short forms.
"""

import unicodedata
from collections.abc import Sequence
from typing import Final

from modal.wording.names import escape_markdown, shorten, visible

__all__ = ["cell", "drawable", "label", "name_with_unit", "path_parts"]

LONGEST_PART: Final = 64
"""Letters of a channel name that are kept in an entity path."""

DRAWN: Final = (
    *((0x20, 0x7E), (0xA0, 0xAC), (0xAE, 0x148), (0x14A, 0x17F), (0x218, 0x21B)),  # Latin
    *((0x384, 0x38A), (0x38E, 0x3A1), (0x3A3, 0x3CF)),  # Greek
    *((0x401, 0x40C), (0x40E, 0x44F), (0x451, 0x45C), (0x490, 0x493)),  # Cyrillic
    *((0x1E80, 0x1E85), (0x1EA0, 0x1EF9)),  # more Latin
    *((0x2010, 0x2011), (0x2013, 0x2014), (0x2018, 0x2022), (0x2026, 0x2026), (0x2074, 0x207A), (0x2080, 0x2089)),
    *((0x2190, 0x2199), (0x2212, 0x2212), (0x221E, 0x221E), (0x2248, 0x2248), (0x2260, 0x2260), (0x2264, 0x2265)),
    (0x25A0, 0x25A1),
)
"""Code points that both fonts inside Rerun 0.41 (Inter, JetBrains Mono) can draw. The viewer looks for others among the
fonts of the machine, and where there are none it does not draw a box but stops: seen with Arabic, Han, U+FFFD."""

BOX: Final = "\N{WHITE SQUARE}"


def drawable(text: str) -> str:
    """The text with a box for each character that not every Rerun viewer can draw, or its plain form where it has one.

    Example:
        >>> drawable("h\N{LATIN SMALL LETTER E WITH ACUTE}t\N{DOUBLE-STRUCK CAPITAL R}")
        'hétR'
    """
    return "".join(letter if _is_drawn(letter) else _plain(letter) for letter in text)


def _is_drawn(letter: str) -> bool:
    return any(first <= ord(letter) <= last for first, last in DRAWN)


def _plain(letter: str) -> str:
    plain = unicodedata.normalize("NFKC", letter)
    return plain if all(map(_is_drawn, plain)) else BOX


def label(text: str, longest: int = 28) -> str:
    r"""One line of visible text, at most `longest` characters; "unnamed" where nothing would be seen.

    Example:
        >>> label("tip\nmass"), label("  ")
        ('tip mass', 'unnamed')
    """
    return shorten(" ".join(drawable(visible(text)).split()), longest) or "unnamed"


def name_with_unit(name: str, unit: str, longest: int = 28) -> str:
    """A name and its unit in brackets, where there is one.

    Example:
        >>> name_with_unit("tip", "m/s^2")
        'tip [m/s^2]'
    """
    return f"{label(name, longest)} [{label(unit, 12)}]" if unit else label(name, longest)


def cell(text: str, longest: int = 400) -> str:
    r"""The same for a Markdown table or sentence: nothing in it acts as Markdown or HTML.

    Example:
        >>> cell("<b>|x|")
        '&lt;b&gt;\\|x\\|'
    """
    return escape_markdown(label(text, longest))


def path_parts(names: Sequence[str]) -> tuple[str, ...]:
    r"""One part of an entity path a name, escaped as Rerun asks and all different.

    Names that would fall together, because of what was left out or cut off, get their position as a suffix.

    Example:
        >>> path_parts(["tip", "", " ", "a/b", "__secret"])
        ('tip', 'unnamed', 'unnamed_2', 'a\\/b', 'name__secret')
    """
    import rerun

    parts: list[str] = []
    for index, name in enumerate(names):
        part = label(name, longest=len(name) + len("unnamed"))[:LONGEST_PART]
        if part.startswith("__"):  # reserved by Rerun for its own entities
            part = "name" + part
        escaped = rerun.escape_entity_path_part(part)
        while escaped in parts:
            escaped = f"{escaped}_{index}"
        parts.append(escaped)
    return tuple(parts)
